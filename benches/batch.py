#!/usr/bin/env python3
"""Solves graphs at once with Evergraph and its peers, in one run, and writes a table into README.md.

usage: EVERGRAPH_DATA=FOLDER python benches/batch.py [--repeats N] [--json FILE]

Builds Evergraph and the peers below benches/peers (Ceres, factrs, apex-solver; GTSAM if the Python
that runs this has it); what does not build or is not installed is skipped with a line that says so.
Looks for the named data sets below $EVERGRAPH_DATA and writes between the comments `batch:begin` and
`batch:end` of benches/README.md. With FILEs it solves those and only prints.

Each starts from the file's vertices and minimizes 1/2 sum r^T I r, on one core and one thread, all
alternating. A peer runs on to full convergence and tells its error over time; its time is where the
error first is within 1e-9 relative of where it ended. Evergraph's `optimize` tells no times between,
so it is stopped after the fewest linearizations that are within 1e-9 of its own end. Parsing and the
making of factors are in nobody's time, but Evergraph's includes the insertion of factors and
variables into its graph, and the peers' the first ordering and symbolic factorization, as its own.
"""
import argparse
import json
import math
import os
import statistics
import subprocess
import sys

from peers import harness

NAMES = "input_M3500_g2o.g2o sphere2500.g2o parking-garage.g2o intel.g2o".split()
WITHIN = 1e-9
# As in the peers.
MAX_ITERATIONS = 100
BUILT = os.path.join(harness.PEERS, "target")


def cargo(name):
    folder = os.path.join(harness.PEERS, name)
    return ["cargo", "build", "--release", "--locked", "--manifest-path", os.path.join(folder, "Cargo.toml")] + [
        "--target-dir",
        os.path.join(BUILT, name),
    ]


class Peer:
    def __init__(self, title, build, command):
        #: As in the table; what builds it, if anything; what it runs with FILE in the place of None.
        self.title, self.build, self.command = title, build, command

    def trace(self, path):
        """(seconds, error) of each iteration, the start first, and what the peer says of the end."""
        result = json.loads(harness.pinned([path if word is None else word for word in self.command]))
        return [(seconds, math.nan if error is None else error) for seconds, error in result["trace"]], result["status"]


def peers():
    ceres = os.path.join(BUILT, "ceres", "peer-ceres")
    make = ["make", "-C", os.path.join(harness.PEERS, "ceres")]
    factrs = os.path.join(BUILT, "factrs", "release", "peer-factrs")
    apex = os.path.join(BUILT, "apex", "release", "peer-apex")
    listed = [
        Peer("Ceres 2.1, gn", make, [ceres, None, "log", "gn"]),
        Peer("Ceres 2.1, lm", make, [ceres, None, "log", "lm"]),
        Peer("Ceres 2.1, its example's residual, gn", make, [ceres, None, "example", "gn"]),
        Peer("factrs 0.3, gn", cargo("factrs"), [factrs, None, "gn"]),
        Peer("factrs 0.3, lm", cargo("factrs"), [factrs, None, "lm"]),
        Peer("apex-solver 1.5, gn", cargo("apex"), [apex, None, "gn"]),
        Peer("apex-solver 1.5, lm", cargo("apex"), [apex, None, "lm"]),
    ]
    gtsam = harness.gtsam_version()
    if gtsam:
        script = [sys.executable, os.path.join(harness.PEERS, "gtsam_batch.py"), None]
        listed += [Peer(f"GTSAM {gtsam}, {method}", None, [*script, method]) for method in ("gn", "lm")]
    return [peer for peer in listed if built(peer)]


def built(peer, failed=set()):
    """Builds it; says so once if that does not work."""
    if peer.build is None or not failed.isdisjoint([tuple(peer.build)]):
        return peer.build is None
    try:
        subprocess.run(peer.build, check=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        return True
    except (OSError, subprocess.CalledProcessError) as error:
        failed.add(tuple(peer.build))
        reason = getattr(error, "stdout", None) or str(error)
        reason = next((line for line in reason.splitlines() if "error" in line.lower()), reason.splitlines()[0])
        print(f"{peer.title.split(',')[0]}: skipped, it does not build: {reason.strip()}", file=sys.stderr)
        return False


def reached(errors):
    """The place of the first error within WITHIN of the least."""
    least = min((error for error in errors if math.isfinite(error)), default=math.nan)
    return next((place for place, error in enumerate(errors) if error <= least * (1 + WITHIN)), None)


def optimize(evergraph, path, linearizations):
    return evergraph.report("optimize", path, "--max-iterations", str(linearizations))


def enough(evergraph, path):
    """Evergraph's end, and the fewest linearizations after which its error is within WITHIN of that."""
    end = optimize(evergraph, path, MAX_ITERATIONS)
    errors = [optimize(evergraph, path, limit)["error"] for limit in range(end["iterations"])] + [end["error"]]
    return end, reached(errors)


def compare(evergraph, listed, path, repeats):
    """For each program a title, seconds, iterations and the error in the end, and what is wrong with it, if so."""
    end, limit = enough(evergraph, path)
    ours, theirs = [], [[] for _ in listed]
    for _ in range(repeats):
        ours.append(optimize(evergraph, path, limit)["time"]["update_s"])
        for peer, runs in zip(listed, theirs):
            try:
                runs.append(peer.trace(path))
            except subprocess.CalledProcessError as error:
                runs.append(([], f"exit code {error.returncode}"))
    wrong = None if end["status"] == "converged" else end["status"]
    # The insertion solves once, too.
    rows = [{"program": "Evergraph", "seconds": ours, "iterations": limit + 1, "error": end["error"], "wrong": wrong}]
    for peer, runs in zip(listed, theirs):
        trace, status = runs[-1]
        errors = [error for _, error in trace]
        place = reached(errors)
        row = {"program": peer.title, "iterations": place, "error": errors[-1] if errors else math.nan, "wrong": None}
        # Some go on in the rounding until the iterations are used up; but they were there long before.
        if not place or not math.isfinite(row["error"]) or place >= MAX_ITERATIONS - 1:
            row["wrong"] = status
        row["seconds"] = [run[place][0] for run, _ in runs if place and place < len(run)]
        rows.append(row)
    best = min(row["error"] for row in rows if not row["wrong"] or row["program"] == "Evergraph")
    for row in rows:
        # Another objective has another optimum, but not one that far off.
        if not row["wrong"] and row["error"] > 1.1 * best:
            row["wrong"] = "ends elsewhere"
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="FILE", help="write every run's seconds, too")
    harness.evergraph_arguments(parser)
    parser.set_defaults(repeats=5)
    arguments = parser.parse_args()
    named = not arguments.files
    files = harness.data_files(NAMES) if named else arguments.files
    table = harness.Table("batch", write=named and not arguments.print)
    evergraph = harness.Evergraph(arguments.evergraph)
    listed = peers()

    table.line(harness.circumstances(evergraph))
    table.line(f"Medians of {arguments.repeats} runs (least..most), alternating, each pinned to one core.")
    table.line("")
    table.header("data set", "program", f"to {WITHIN:g}, ms", "beside Evergraph", "iterations", "ms each", "error")
    everything = {}
    for path in files:
        name = os.path.basename(path)
        everything[name] = rows = compare(evergraph, listed, path, arguments.repeats)
        for row in rows:
            error = f"{row['error']:.10g}"
            if row["wrong"]:
                table.row(name, row["program"], f"does not get there: {row['wrong']}", "", "", "", error)
                continue
            milliseconds = [1e3 * seconds for seconds in row["seconds"]]
            median = statistics.median(milliseconds)
            ratio = f"{statistics.median(row['seconds']) / statistics.median(rows[0]['seconds']):.1f}"
            each = f"{median / row['iterations']:.2f}"
            table.row(name, row["program"], harness.spread(milliseconds, 1), ratio, str(row["iterations"]), each, error)
    table.close()
    if arguments.json:
        with open(arguments.json, "w") as file:
            json.dump(everything, file, indent=2)


main()
