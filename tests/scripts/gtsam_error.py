#!/usr/bin/env python3
"""GTSAM's graph.error() at the vertices of g2o files, to compare Evergraph's with.

usage: python gtsam_error.py FILE...        (pip install gtsam==4.3.0 numpy)

Only EDGE_SE2 and EDGE_SE3:QUAT count, no prior. Quaternions are normalized first, because GTSAM
does not; information matrices are permuted from g2o's order (translation first) to GTSAM's
(rotation first in 3D).
"""
import sys

import gtsam
import numpy as np

ROTATION_FIRST = [3, 4, 5, 0, 1, 2]


def symmetric(entries, n):
    m = np.zeros((n, n))
    m[np.triu_indices(n)] = entries
    return m + np.triu(m, 1).T


def pose3(numbers):
    q = np.array(numbers[3:7])
    q /= np.linalg.norm(q)
    return gtsam.Pose3(gtsam.Rot3.Quaternion(q[3], q[0], q[1], q[2]), np.array(numbers[:3]))


def error(path):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for line in open(path):
        fields = line.split()
        if not fields:
            continue
        tag, numbers = fields[0], [float(x) for x in fields[1:]]
        if tag == "VERTEX_SE2":
            values.insert(int(fields[1]), gtsam.Pose2(*numbers[1:4]))
        elif tag == "VERTEX_SE3:QUAT":
            values.insert(int(fields[1]), pose3(numbers[1:8]))
        elif tag == "EDGE_SE2":
            noise = gtsam.noiseModel.Gaussian.Information(symmetric(numbers[5:11], 3), False)
            graph.add(gtsam.BetweenFactorPose2(int(fields[1]), int(fields[2]), gtsam.Pose2(*numbers[2:5]), noise))
        elif tag == "EDGE_SE3:QUAT":
            information = symmetric(numbers[9:30], 6)[np.ix_(ROTATION_FIRST, ROTATION_FIRST)]
            noise = gtsam.noiseModel.Gaussian.Information(information, False)
            graph.add(gtsam.BetweenFactorPose3(int(fields[1]), int(fields[2]), pose3(numbers[2:9]), noise))
    return graph.error(values)


for path in sys.argv[1:]:
    print(f"{path} {error(path):.15g}")
