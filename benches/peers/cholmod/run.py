#!/usr/bin/env python3
"""Factorizes the Gauss-Newton systems of 2D g2o files with CHOLMOD on one core; a line of JSON for each.

usage: python benches/peers/cholmod/run.py FILE.g2o...
       python benches/peers/cholmod/run.py MATRIX.mtx RIGHT_SIDE.mtx

Builds the program here (apt install libsuitesparse-dev libopenblas-dev). The systems of g2o files are
made by hessian.py, which wants numpy.
"""
import json
import os
import subprocess
import sys
import tempfile

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.dirname(HERE))

import harness  # noqa: E402


def factorize(*system):
    program = os.path.join(harness.PEERS, "target", "cholmod", "peer-cholmod")
    return json.loads(harness.pinned([program, *system]))


def main():
    files = sys.argv[1:]
    if not files:
        sys.exit(__doc__)
    try:
        subprocess.run(["make", "-s", "-C", HERE], check=True)
    except (OSError, subprocess.CalledProcessError):
        sys.exit("CHOLMOD: skipped, it does not build; apt install make g++ libsuitesparse-dev libopenblas-dev")
    if files[0].endswith(".mtx"):
        print(json.dumps({"data set": os.path.basename(files[0]), **factorize(*files)}))
        return
    for path in files:
        with tempfile.TemporaryDirectory() as folder:
            system = [os.path.join(folder, name) for name in ("matrix.mtx", "right.mtx")]
            try:
                subprocess.run([sys.executable, os.path.join(HERE, "hessian.py"), path, *system], check=True)
                print(json.dumps({"data set": os.path.basename(path), **factorize(*system)}), flush=True)
            except subprocess.CalledProcessError:
                print(f"{path}: skipped", file=sys.stderr)


main()
