#!/usr/bin/env python3
"""Optimizes a g2o file with GTSAM, from the file's vertices to full convergence.

usage: python gtsam_batch.py FILE.g2o gn|lm            (pip install gtsam==4.3.0 numpy)

GTSAM's default settings (multifrontal Cholesky, COLAMD), iterated by hand until rounding ends it; a
prior of 0.01 m and rad holds the first pose. Prints one line of JSON: `trace` has the error, of the
prior too, over the seconds that the optimizer has taken so far, its ordering included.
"""
import json
import math
import sys
import time
from importlib.metadata import version

import gtsam

from gtsam_graph import PoseGraph

OPTIMIZERS = {
    "gn": (gtsam.GaussNewtonOptimizer, gtsam.GaussNewtonParams),
    "lm": (gtsam.LevenbergMarquardtOptimizer, gtsam.LevenbergMarquardtParams),
}
MAX_ITERATIONS = 100
# Relative; where rounding ends a run's progress.
CONVERGED = 1e-13


def main():
    if len(sys.argv) != 3 or sys.argv[2] not in OPTIMIZERS:
        sys.exit("usage: python gtsam_batch.py FILE.g2o gn|lm")
    path, method = sys.argv[1:]
    data = PoseGraph(path)
    if not data.start:
        sys.exit(f"{path}: no vertices to start from")
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(data.prior(data.start[0]))
    for n, pose in enumerate(data.start):
        start.insert(n, pose)
    for i, j, z, noise in data.edges:
        graph.add(data.between(i, j, z, noise))
    trace, status = optimize(graph, start, *OPTIMIZERS[method])
    result = {"peer": "GTSAM", "version": version("gtsam"), "method": method, "status": status, "trace": trace}
    print(json.dumps(result))


def optimize(graph, start, Optimizer, Settings):
    took = -time.perf_counter()
    optimizer = Optimizer(graph, start, Settings())
    took += time.perf_counter()
    trace = [(took, optimizer.error())]
    for _ in range(MAX_ITERATIONS):
        took -= time.perf_counter()
        try:
            optimizer.iterate()
        except RuntimeError as error:
            return trace, str(error).split("\n")[0]
        took += time.perf_counter()
        before, error = trace[-1][1], optimizer.error()
        trace.append((took, error))
        if not math.isfinite(error):
            return trace, "diverged"
        if abs(before - error) <= CONVERGED * before:
            return trace, "converged"
    return trace, "iterations used up"


main()
