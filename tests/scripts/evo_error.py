#!/usr/bin/env python3
"""evo's errors of trajectories that tests/tests/evo.rs wrote, beside ours.

usage: python evo_error.py FOLDER > evo_error.txt   (pip install evo==1.38.1; FOLDER is target/tmp/evo)

For each NAME.estimate.tum of the folder, prints a line of evo's values in the order of the test, and
ends with an error when one of NAME.ours.txt differs by more than 1e-9 relative. Where there are
KITTI files, evo must say the same of them.
"""
import copy
import pathlib
import sys

from evo.core import metrics, sync
from evo.tools import file_interface as files

TRANSLATION = metrics.PoseRelation.translation_part
ROTATION = metrics.PoseRelation.rotation_angle_rad
STATISTICS = ["rmse", "mean", "median", "std", "min", "max", "sse"]


def statistics(metric, truth, estimate):
    metric.process_data((truth, estimate))
    values = metric.get_all_statistics()
    return [float(values[name]) for name in STATISTICS]


def errors(truth, estimate):
    values = [float(truth.num_poses)]
    values += statistics(metrics.APE(TRANSLATION), truth, estimate)
    for with_scale in (False, True):
        aligned = copy.deepcopy(estimate)
        aligned.align(truth, correct_scale=with_scale)
        values += statistics(metrics.APE(TRANSLATION), truth, aligned)
        if not with_scale:
            values += statistics(metrics.APE(ROTATION), truth, aligned)
    for delta, all_pairs in ((1, False), (10, False), (10, True)):
        for relation in (TRANSLATION, ROTATION):
            metric = metrics.RPE(relation, delta, metrics.Unit.frames, all_pairs=all_pairs)
            values.append(statistics(metric, truth, estimate)[0])
    return values


def compare(name, what, evo, other):
    apart = [k for k, (a, b) in enumerate(zip(evo, other, strict=True)) if abs(a - b) > 1e-9 * abs(a) + 1e-12]
    for k in apart:
        print(f"{name}, value {k}: evo {evo[k]!r}, {what} {other[k]!r}", file=sys.stderr)
    return not apart


agree = True
folder = pathlib.Path(sys.argv[1])
for path in sorted(folder.glob("*.estimate.tum")):
    name = path.name.removesuffix(".estimate.tum")
    truth = files.read_tum_trajectory_file(folder / f"{name}.truth.tum")
    estimate = files.read_tum_trajectory_file(path)
    evo = errors(*sync.associate_trajectories(truth, estimate, max_diff=0.01))
    print(name, *map(repr, evo))
    ours = [float(line) for line in open(folder / f"{name}.ours.txt")]
    agree &= compare(name, "ours", evo, ours)
    kitti = [folder / f"{name}.{end}.kitti" for end in ("truth", "estimate")]
    if kitti[0].exists():
        agree &= compare(name, "evo by KITTI", evo, errors(*map(files.read_kitti_poses_file, kitti)))
sys.exit(0 if agree else "evo and Evergraph differ")
