#!/usr/bin/env python3
"""Replays a pose graph through GTSAM's ISAM2, as `evergraph replay` does through Evergraph.

usage: python gtsam_replay.py [--full-estimate] [--output VERTICES.g2o] FILE
                                                       (pip install gtsam==4.3.0 numpy)

Same order: pose k arrives with every edge whose larger pose is k and starts from the current
estimate of the other end of its odometry edge. Same clock: one update() per pose and the newest
pose's estimate, or with --full-estimate everyone's; making factors and values in Python is not timed.
GTSAM's defaults: relinearize beyond 0.1 every 10 updates, Cholesky, wildfire threshold 0.001. Prints
one line of JSON; `error` is graph.error() without the prior.
"""
import argparse
import json
import time

import gtsam
import numpy as np

from gtsam_graph import PoseGraph, peak_rss_mb


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("file")
    arguments.add_argument("--full-estimate", action="store_true", help="ask for all estimates after each step")
    arguments.add_argument("--output", help="write the last estimate as VERTEX lines of g2o")
    arguments = arguments.parse_args()

    data = PoseGraph(arguments.file)
    steps = [[] for _ in data.ids]
    for edge in data.edges:
        steps[max(edge[:2])].append(edge)
    settings = gtsam.ISAM2Params()
    settings.setRelinearizeThreshold(0.1)
    settings.relinearizeSkip = 10
    settings.setFactorization("CHOLESKY")
    isam = gtsam.ISAM2(settings)
    estimate = isam.calculateEstimatePose3 if data.pose is gtsam.Pose3 else isam.calculateEstimatePose2
    file = gtsam.NonlinearFactorGraph()
    times = []
    for k, step in enumerate(steps):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if k == 0:
            graph.add(data.prior(data.pose()))
            values.insert(0, data.pose())
        else:
            i, j, z, _ = max(step, key=lambda edge: min(edge[:2]))
            values.insert(k, estimate(i).compose(z) if j == k else estimate(j).compose(z.inverse()))
        for i, j, z, noise in step:
            factor = data.between(i, j, z, noise)
            graph.add(factor)
            file.add(factor)
        start = time.perf_counter()
        try:
            isam.update(graph, values)
            if arguments.full_estimate:
                isam.calculateEstimate()
            else:
                estimate(k)
        except RuntimeError:
            print(json.dumps({"failed": f"pose {k}"}))
            return
        times.append(1e3 * (time.perf_counter() - start))
    peak = peak_rss_mb()
    last = isam.calculateEstimate()
    if arguments.output:
        data.write_vertices(arguments.output, last)
    print(
        json.dumps(
            {
                "update_s": sum(times) / 1e3,
                "p99_ms": float(np.percentile(times, 99)),
                "max_ms": max(times),
                "error": file.error(last),
                "peak_rss_mb": peak,
            }
        )
    )


main()
