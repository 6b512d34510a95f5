#!/usr/bin/env python3
"""Replays a pose graph through GTSAM's ISAM2, as `evergraph replay` does through Evergraph.

usage: python gtsam_replay.py FILE        (pip install gtsam==4.3.0 numpy)

Same order: pose k arrives with every edge whose larger pose is k and starts from the current
estimate of the other end of its odometry edge. Same clock: one update() per pose and the newest
pose's estimate; making factors and values in Python is not timed. GTSAM's defaults: relinearize
beyond 0.1 every 10 updates, Cholesky, wildfire threshold 0.001. Prints one line of JSON; `error` is
graph.error() without the prior.
"""
import json
import sys
import time

import gtsam
import numpy as np

ROTATION_FIRST = [3, 4, 5, 0, 1, 2]


def upper(entries, n):
    m = np.zeros((n, n))
    m[np.triu_indices(n)] = entries
    return m


def symmetric(entries, n):
    m = upper(entries, n)
    return m + np.triu(m, 1).T


def read(path):
    """Edges (i, j, measurement, noise), poses numbered 0, 1, ... by id."""
    edges = []
    model = gtsam.noiseModel.Gaussian
    for line in open(path):
        fields = line.split()
        if not fields or fields[0][0] == "#" or fields[0].startswith("VERTEX"):
            continue
        tag, i, j = fields[0], int(fields[1]), int(fields[2])
        x = [float(field) for field in fields[3:]]
        if tag == "EDGE_SE2":
            z, noise = gtsam.Pose2(*x[:3]), model.Information(symmetric(x[3:9], 3), True)
        elif tag in ("ODOMETRY", "EDGE2"):
            z, noise = gtsam.Pose2(*x[:3]), model.SqrtInformation(upper(x[3:9], 3), True)
        elif tag == "EDGE_SE3:QUAT":
            q = np.array(x[3:7]) / np.linalg.norm(x[3:7])
            z = gtsam.Pose3(gtsam.Rot3.Quaternion(q[3], q[0], q[1], q[2]), np.array(x[:3]))
            noise = model.Information(symmetric(x[7:28], 6)[np.ix_(ROTATION_FIRST, ROTATION_FIRST)], True)
        elif tag == "EDGE3":
            root = upper(x[6:27], 6)
            z = gtsam.Pose3(gtsam.Rot3.RzRyRx(*x[3:6]), np.array(x[:3]))
            noise = model.Information((root.T @ root)[np.ix_(ROTATION_FIRST, ROTATION_FIRST)], True)
        else:
            sys.exit(f"{path}: {tag} lines are not for this script")
        edges.append((i, j, z, noise))
    number = {pose: n for n, pose in enumerate(sorted({i for e in edges for i in e[:2]}))}
    return [(number[i], number[j], z, noise) for i, j, z, noise in edges], len(number)


def main():
    edges, poses = read(sys.argv[1])
    three_d = isinstance(edges[0][2], gtsam.Pose3)
    pose, between, prior, dim = (
        (gtsam.Pose3, gtsam.BetweenFactorPose3, gtsam.PriorFactorPose3, 6)
        if three_d
        else (gtsam.Pose2, gtsam.BetweenFactorPose2, gtsam.PriorFactorPose2, 3)
    )
    steps = [[] for _ in range(poses)]
    for edge in edges:
        steps[max(edge[:2])].append(edge)
    isam = gtsam.ISAM2(gtsam.ISAM2Params())
    estimate = isam.calculateEstimatePose3 if three_d else isam.calculateEstimatePose2
    file = gtsam.NonlinearFactorGraph()
    times = []
    for k, step in enumerate(steps):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if k == 0:
            graph.add(prior(0, pose(), gtsam.noiseModel.Isotropic.Sigma(dim, 0.01)))
            values.insert(0, pose())
        else:
            i, j, z, _ = max(step, key=lambda edge: min(edge[:2]))
            values.insert(k, estimate(i).compose(z) if j == k else estimate(j).compose(z.inverse()))
        for i, j, z, noise in step:
            factor = between(i, j, z, noise)
            graph.add(factor)
            file.add(factor)
        start = time.perf_counter()
        try:
            isam.update(graph, values)
            estimate(k)
        except RuntimeError:
            print(json.dumps({"failed": f"pose {k}"}))
            return
        times.append(1e3 * (time.perf_counter() - start))
    print(
        json.dumps(
            {
                "update_s": sum(times) / 1e3,
                "p99_ms": float(np.percentile(times, 99)),
                "max_ms": max(times),
                "error": file.error(isam.calculateEstimate()),
            }
        )
    )


main()
