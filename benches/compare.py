#!/usr/bin/env python3
"""Replays graphs with Evergraph and GTSAM's ISAM2 in turn, in one run, and writes a table into README.md.

usage: EVERGRAPH_DATA=FOLDER python benches/compare.py [--full-estimate] [--repeats N]

Builds Evergraph, looks for the named data sets below $EVERGRAPH_DATA, and writes between the comments
`replay:begin` and `replay:end` of benches/README.md; with --full-estimate, where both sides give
everyone's estimate after each step instead of the newest pose's, between `full:begin` and `full:end`.
With FILEs it replays those and only prints.

GTSAM is used if the Python that runs this has it (pip install gtsam==4.3.0 numpy). Each program runs
pinned to one core, the two alternating; the table has medians over the repeats. Errors are without
the prior, both by Evergraph's evaluator (`evergraph info`) at the estimates that each wrote.
"""
import argparse
import json
import os
import shlex
import statistics
import subprocess
import sys
import tempfile

from peers import harness

NAMES = """manhattanOlson3500.txt input_M3500_g2o.g2o city10000.txt intel.g2o kitti_00.g2o sphere2500.g2o
parking-garage.g2o victoriaPark.txt manhattan.g2o MIT.g2o""".split()
# Seconds that iSAM 1.7 took on a machine of this kind, where GTSAM's script has no say (landmarks).
ISAM = {"victoriaPark.txt": 9.1}


def replay_evergraph(evergraph, path, full_estimate, output):
    report = evergraph.report("replay", path, "--output", output, *["--full-estimate"] * full_estimate)
    return {**report["time"], "peak_rss_mb": report["peak_rss_mb"]}


def replay_gtsam(path, full_estimate, output):
    script = os.path.join(harness.PEERS, "gtsam_replay.py")
    command = [sys.executable, script, path, "--output", output, *["--full-estimate"] * full_estimate]
    try:
        return json.loads(harness.pinned(command))
    except subprocess.CalledProcessError:
        return {"failed": "reading"}


def error_at(evergraph, graph, vertices):
    """The error of the graph's edges where the other file's vertices are."""
    with tempfile.NamedTemporaryFile("w", suffix=".g2o") as file:
        file.writelines(line for line in open(vertices) if line.startswith("VERTEX"))
        file.writelines(line for line in open(graph) if not line.startswith("VERTEX"))
        file.flush()
        return evergraph.report("info", file.name)["at_vertices"]["error"]


def compare(evergraph, path, gtsam, full_estimate, repeats):
    """Runs of Evergraph and of GTSAM, and the errors at the end of each; nothing where GTSAM has not run."""
    ours, theirs = [], []
    with tempfile.TemporaryDirectory() as folder:
        our_map, their_map = os.path.join(folder, "ours.g2o"), os.path.join(folder, "theirs.g2o")
        for _ in range(repeats):
            ours.append(replay_evergraph(evergraph, path, full_estimate, our_map))
            if gtsam:
                theirs.append(replay_gtsam(path, full_estimate, their_map))
        error = error_at(evergraph, our_map, our_map)
        their_error = error_at(evergraph, our_map, their_map) if os.path.exists(their_map) else None
    return ours, theirs, error, their_error


def row(table, path, ours, theirs, error, their_error, other):
    """`other` stands in place of GTSAM's total where GTSAM has none."""
    median = lambda runs, field: statistics.median(run[field] for run in runs)
    if theirs and "failed" in theirs[0]:
        theirs, other = [], f"fails at {theirs[0]['failed']}"
    cells = [os.path.basename(path), harness.spread([run["update_s"] for run in ours], 3)]
    if theirs:
        cells += [harness.spread([run["update_s"] for run in theirs], 3)]
        cells += [f"{median(theirs, 'update_s') / median(ours, 'update_s'):.1f}"]
    elif other in ISAM.values():
        cells += [f"iSAM 1.7: {other}", f"{other / median(ours, 'update_s'):.1f}"]
    else:
        cells += [other, ""]
    for field in ("p99_ms", "max_ms"):
        cells += [f"{median(ours, field):.2f}", "", ""]
        if theirs:
            cells[-2:] = f"{median(theirs, field):.2f}", f"{median(theirs, field) / median(ours, field):.1f}"
    cells += [f"{error:.8g}", f"{their_error:.8g}" if theirs else ""]
    cells += [f"{median(ours, 'peak_rss_mb'):.0f}", f"{median(theirs, 'peak_rss_mb'):.0f}" if theirs else ""]
    table.row(*cells)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full-estimate", action="store_true", help="all estimates after each step, on both sides")
    harness.evergraph_arguments(parser)
    arguments = parser.parse_args()
    named = not arguments.files
    files = harness.data_files(NAMES) if named else arguments.files
    table = harness.Table("full" if arguments.full_estimate else "replay", write=named and not arguments.print)
    evergraph = harness.Evergraph(arguments.evergraph)
    gtsam = harness.gtsam_version()

    table.line(harness.circumstances(evergraph, f"GTSAM {gtsam}" if gtsam else "GTSAM not installed"))
    table.line(f"Medians of {arguments.repeats} runs (least..most), alternating, each pinned to one core.")
    table.line("")
    table.header(
        *("data set", "total, s", "GTSAM, s", "ratio", "p99, ms", "GTSAM", "ratio", "max, ms", "GTSAM", "ratio"),
        *("error", "GTSAM", "peak, MB", "GTSAM"),
    )
    for path in files:
        isam = None if arguments.full_estimate else ISAM.get(os.path.basename(path))
        landmarks = os.path.basename(path) in ISAM
        try:
            result = compare(evergraph, path, gtsam and not landmarks, arguments.full_estimate, arguments.repeats)
        except subprocess.CalledProcessError as error:
            print(f"{path}: skipped, failed: {shlex.join(error.cmd)}", file=sys.stderr)
            continue
        row(table, path, *result, other=isam or ("" if landmarks else "not installed"))
    table.close()


main()
