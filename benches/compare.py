#!/usr/bin/env python3
"""Replays graphs with Evergraph and GTSAM in turn, in one run, and prints a Markdown table.

usage: python benches/compare.py [--repeats N] FILE...

Needs `cargo build --release`, and GTSAM in the Python that runs this (pip install gtsam==4.3.0
numpy). Each program runs pinned to one core, the two alternating; the table has medians over the
repeats. Errors are without the prior, by each program's own evaluator (they agree to 1e-9, see
tests/tests/gtsam_error.rs).
"""
import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile

HERE = os.path.dirname(os.path.abspath(__file__))
TARGET = os.environ.get("CARGO_TARGET_DIR", os.path.join(HERE, "..", "target"))


def pinned(command, **options):
    return subprocess.run(["taskset", "-c", str(max(os.sched_getaffinity(0)))] + command, check=True, **options)


def evergraph(path):
    with tempfile.NamedTemporaryFile(suffix=".json") as report:
        program = os.path.join(TARGET, "release", "evergraph")
        pinned([program, "replay", path, "--quiet", "--threads", "1", "--report", report.name], stdout=subprocess.DEVNULL)
        result = json.load(open(report.name))
    return {**result["time"], "error": result["error"]}


def gtsam(path):
    script = os.path.join(HERE, "peers", "gtsam_replay.py")
    return json.loads(pinned([sys.executable, script, path], stdout=subprocess.PIPE).stdout)


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("files", nargs="+")
    arguments.add_argument("--repeats", type=int, default=3)
    arguments = arguments.parse_args()
    print("| data set | total, s | GTSAM, s | ratio | p99, ms | GTSAM | max, ms | GTSAM | error | GTSAM |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for path in arguments.files:
        runs = [(evergraph(path), gtsam(path)) for _ in range(arguments.repeats)]
        median = lambda who, field: statistics.median(run[who][field] for run in runs)
        ours = {field: median(0, field) for field in ("update_s", "p99_ms", "max_ms", "error")}
        row = f"| {os.path.basename(path)} | {ours['update_s']:.3f} "
        if "failed" in runs[0][1]:
            failed = runs[0][1]["failed"]
            row += f"| fails at {failed} | | {ours['p99_ms']:.2f} | | {ours['max_ms']:.1f} | | {ours['error']:.6g} | |"
        else:
            theirs = {field: median(1, field) for field in ("update_s", "p99_ms", "max_ms", "error")}
            row += f"| {theirs['update_s']:.3f} | {theirs['update_s'] / ours['update_s']:.1f} "
            row += f"| {ours['p99_ms']:.2f} | {theirs['p99_ms']:.2f} | {ours['max_ms']:.1f} | {theirs['max_ms']:.1f} "
            row += f"| {ours['error']:.8g} | {theirs['error']:.8g} |"
        print(row, flush=True)


main()
