#!/usr/bin/env python3
"""What removing nodes costs: writes the tables of docs/removal.md.

usage: python benches/removal.py [--evergraph PROGRAM] [--print] [TABLE...]

TABLEs are `loss`, `prices`, `isam`, `exact`, `consistency`, `time` and `edges` here, and `window`, `cut`, `live` and `sweep` of the
benchmark in Rust (benches/removal); all but `sweep` by default, which takes an hour. Finds the data sets by
EVERGRAPH_DATA, and builds Evergraph unless a PROGRAM is named.
"""
import argparse
import math
import os
import statistics
import subprocess
import sys

from peers import harness

PAGE = os.path.join(harness.ROOT, "docs", "removal.md")
MANHATTAN = "manhattanOlson3500.txt"
GRAPHS = [MANHATTAN, "input_M3500_g2o.g2o", "intel.g2o", "parking-garage.g2o", "sphere2500.g2o", "duderstadt.g2o"]
CUTS = {
    "input_M3500_g2o.g2o": 2400,
    "intel.g2o": 1150,
    "parking-garage.g2o": 1100,
    "sphere2500.g2o": 1670,
    "duderstadt.g2o": 425,
}
SEEDS = range(1, 6)
LIVE = GRAPHS + ["sphere2500.txt", "city10000.txt", "victoriaPark.txt"]
# Every graph of the data sets that can be read, but sphere2500.g2o.outliers, which takes too long.
SWEPT = [
    "tinyGrid3D.g2o", "pose2example.txt", "toyExample.g2o", "pose3example.txt", "noisyToyGraph.txt",
    "optimizedNoisyToyGraph.txt", "orientationsNoisyToyGraph.txt", "example_with_vertices.g2o", "example.graph",
    "w100.graph", "robot_a.g2o", "robot_b.g2o", "blocks_world_4robots_fullGraph.g2o", "flat_duderstadt.g2o",
    "duderstadt.g2o", "MIT.g2o", "ring.g2o", "ring_groundtruth.g2o", "ringCity.g2o", "ringCity_groundtruth.g2o",
    "kitti_00.g2o", "kitti_06.g2o", "kitti_07.g2o", "intel.g2o", "intel_943.g2o", "input_INTEL_g2o.g2o",
    "killian-small.toro", "killian.g2o", MANHATTAN, "input_M3500_g2o.g2o", "input_M3500b_g2o.g2o", "manhattan.g2o",
    "Bovisa04_GT_GPS.g2o", "Bovisa04_odometry_bow_tr.g2o", "Bicocca25b_GT_GPS.g2o", "B25b_0.500.g2o",
    "B25b_0.000.g2o", "city10000.txt", "smallGrid3D.g2o", "sphere400.txt", "sphere2500.txt", "sphere2500.g2o",
    "sphere2500_groundtruth.txt", "sphere_mednoise.graph", "torus2000Points.txt", "parking-garage.g2o",
    "world-2000-full.g2o", "world-2000-noassoc.g2o", "victoriaPark.txt", "victoriaPark-full.g2o", "mrclam5a.pyfg",
    "single_drone.pyfg", "plaza1.pyfg",
]
# iSAM 1.7's own figures on manhattanOlson3500, from its own build.
ISAM = {"random 50 %": "0.022 to 0.024", "random 90 %": "0.078 to 0.084", "every second": "0.034"}


def file_of(name):
    found = harness.data_files([name])
    if not found:
        sys.exit(f"{name} is needed for this table")
    return found[0]


def short(x):
    """Three digits that matter."""
    if x is None or not math.isfinite(x):
        return "-"
    return f"{x:.3g}" if x == 0 or 1e-3 <= abs(x) < 1e4 else f"{x:.1e}"


def loss(evergraph, table):
    """The loss of each order, in nats for each kept dimension."""
    table.header("graph", "removed", "random, mean of 5", "least..most", "min-degree", "min-loss", "random's prices / KLD", "min-loss's prices / KLD")
    for name in GRAPHS:
        for percent in (10, 50, 90):
            def run(order, seed=1):
                # A price costs more than a removal, in 3D ten times as much.
                price = ["--no-price"] if seed > 1 or order == "min-degree" else []
                return evergraph.report(
                    "remove", file_of(name), "--fraction", str(percent / 100), "--order", order, "--seed", str(seed),
                    "--topology", "tree", *price)

            random = [run("random", seed) for seed in SEEDS]
            degree, least = run("min-degree"), run("min-loss")
            each = [report["kld_covariance_per_dof"] for report in random]

            def ratio(report):
                return short(report["price_sum"] / report["kld_covariance"]) if report["price_sum"] else "-"

            table.row(
                name, f"{percent} %", short(statistics.mean(each)), f"{short(min(each))}..{short(max(each))}",
                short(degree["kld_covariance_per_dof"]), short(least["kld_covariance_per_dof"]),
                ratio(random[0]), ratio(least))


def prices(evergraph, table):
    """Whether the sum of the prices tells which of two removals loses more."""
    table.header("graph", "runs", "rank correlation", "prices / KLD, random 10 %", "50 %", "90 %")
    for name in GRAPHS:
        sums, losses, ratio = [], [], {}
        for percent in (10, 30, 50, 70, 90):
            for order, seed in (("random", 1), ("random", 2), ("min-degree", 1), ("min-loss", 1)):
                report = evergraph.report(
                    "remove", file_of(name), "--fraction", str(percent / 100), "--order", order, "--seed", str(seed),
                    "--topology", "tree")
                price, loss = report["price_sum"], report["kld_covariance"]
                if order == "random":
                    ratio[percent] = price / loss
                # What costs nothing is rounding, which has no order.
                if loss > 1e-6:
                    sums.append(price)
                    losses.append(loss)
        table.row(
            name, str(len(sums)), f"{statistics.correlation(ranks(sums), ranks(losses)):.3f}",
            *(f"{ratio[percent]:.2f}" for percent in (10, 50, 90)))


def ranks(numbers):
    order = sorted(numbers)
    return [order.index(number) for number in numbers]


def isam(evergraph, table):
    """Our tree against iSAM's rules, on the same nodes in the same order: means of five seeds where it is random."""
    table.header("nodes", "default", "iSAM's rules", "ratio", "iSAM 1.7's own program")
    for label, choice, seeds in [
        ("random 50 %", ["--fraction", "0.5", "--order", "random"], SEEDS),
        ("random 90 %", ["--fraction", "0.9", "--order", "random"], SEEDS),
        ("every second", ["--keep-every", "2", "--order", "given"], [1]),
    ]:
        def mean(mode):
            reports = [evergraph.report(
                "remove", file_of(MANHATTAN), *choice, "--seed", str(seed), "--mode", mode,
                "--topology", "tree", "--no-price")
                for seed in seeds]
            return statistics.mean(report["kld_covariance_per_dof"] for report in reports)

        ours, theirs = mean("default"), mean("isam")
        table.row(label, f"{ours:.5f}", f"{theirs:.5f}", f"{ours / theirs:.4f}", ISAM[label])


def exact(evergraph, table):
    """What stays where it was."""
    table.header("removed", "topology", "recovery", "offset", "KLD covariance", "shift, rms m", "max m", "factors", "largest blanket", "kept")
    cases = [(percent, "dense", "random") for percent in (10, 50)] + [(90, "dense", "min-degree")]
    cases += [(percent, "tree", "random") for percent in (10, 50, 90)]
    for percent, topology, order in cases:
        for recovery in ("glc", "nonlinear"):
            if topology == "dense" and recovery == "nonlinear":
                continue  # a clique has no relative measurements to be made of
            for offset in ("gradient", "paper"):
                report = evergraph.report(
                    "remove", file_of(MANHATTAN), "--fraction", str(percent / 100), "--order", order,
                    "--topology", topology, "--recovery", recovery, "--offset", offset, "--no-price")
                table.row(
                    f"{percent} %, {order}", topology, recovery, offset, short(report["kld_covariance"]),
                    short(report["rms_shift_m"]), short(report["max_shift_m"]),
                    f"{report['factors_before']} to {report['factors_after']}", str(report["largest_blanket"]),
                    str(len(report["kept"])))


def time(evergraph, table):
    """Time for a node."""
    table.header("graph", "removed", "plan p50, ms", "p99", "apply p50, ms", "p99", "both p99", "max")
    for name in GRAPHS + ["city10000.txt", "victoriaPark.txt"]:
        report = evergraph.report("remove", file_of(name), "--fraction", "0.5", "--topology", "tree", "--no-price")
        plan, apply, both = report["plan_ms"], report["apply_ms"], report["time_per_node_ms"]
        table.row(
            name, "50 %", f"{plan['p50']:.3f}", f"{plan['p99']:.3f}", f"{apply['p50']:.3f}", f"{apply['p99']:.3f}",
            f"{both['p99']:.3f}", f"{both['max']:.2f}")


def edges(evergraph, table):
    """Pairs of poses that share information, exactly and on trees."""
    table.header("graph", "poses", "edges", "left", "edges, dense", "edges, tree", "largest blanket, dense")
    for name in ("intel_943.g2o", "input_INTEL_g2o.g2o"):
        for left in (349, 250):
            def run(topology):
                # All but one can go: the fraction is of those.
                report = evergraph.report("info", file_of(name))
                free = report["variables"] - 1 if "variables" in report else report["poses"] - 1
                fraction = (free + 1 - left) / free
                return evergraph.report("remove", file_of(name), "--fraction", repr(fraction), "--topology", topology, "--no-price")

            def pairs(report, when):
                # The upper triangle of the information: 6 numbers for a pose, 9 for a pair.
                return (report[f"nnz_{when}"] - 6 * report[f"variables_{when}"]) // 9

            dense, tree = run("dense"), run("tree")
            table.row(
                name, str(dense["variables_before"]), str(pairs(dense, "before")), str(dense["variables_after"]),
                str(pairs(dense, "after")), str(pairs(tree, "after")), str(dense["largest_blanket"]))


def consistency(evergraph, table):
    """Trees with and without a bound, and the default."""
    table.header("graph", "removed", "order", "KLD, tree", "conservative", "scaled", "auto", "eigenvalue - 1, tree", "conservative",
                 "marginals too small, tree", "conservative", "plan p50, ms", "factor (R), tree", "auto")
    for name in GRAPHS:
        for percent, order in [(p, o) for p in (10, 50, 90) for o in ("random", "min-degree")] + [(50, "min-loss")]:
            def run(*options):
                return evergraph.report(
                    "remove", file_of(name), "--fraction", str(percent / 100), "--order", order, "--no-price", *options)

            tree = run("--topology", "tree")
            bounded = run("--topology", "tree", "--consistency", "conservative")
            scaled = run("--topology", "tree", "--consistency", "scaled")
            auto = run()

            def excess(report):
                return f"{report['consistency']['largest_eigenvalue'] - 1:.1e}"

            def share(report):
                return f"{100 * report['consistency']['overconfident'] / report['consistency']['variables']:.0f} %"

            table.row(
                name, f"{percent} %", order, *(short(r["kld_covariance"]) for r in (tree, bounded, scaled, auto)),
                excess(tree), excess(bounded), share(tree), share(bounded), f"{bounded['plan_ms']['p50']:.3f}",
                str(tree["factor_nnz_after"]), str(auto["factor_nnz_after"]))


def window(_, table):
    for line in bench("window", ["200000"]):
        table.line(line)


def bench(mode, files):
    """Runs the benchmark in Rust and hands its lines on."""
    command = ["cargo", "bench", "-q", "-p", "evergraph-benches", "--bench", "removal", "--", mode, *files]
    with subprocess.Popen(command, cwd=harness.ROOT, stdout=subprocess.PIPE, text=True) as process:
        yield from (line.rstrip("\n") for line in process.stdout)
    if process.returncode:
        print(f"{mode}: not all went well", file=sys.stderr)


def cut(_, table):
    for line in bench("cut", [f"{file_of(name)}:{poses}" for name, poses in CUTS.items()]):
        table.line(line)


def live(_, table):
    for line in bench("live", [file_of(name) for name in LIVE]):
        table.line(line)


def sweep(_, table):
    for line in bench("sweep", harness.data_files(SWEPT)):
        table.line(line)


TABLES = {
    "loss": loss, "prices": prices, "isam": isam, "exact": exact, "time": time, "edges": edges, "cut": cut,
    "consistency": consistency, "window": window,
    "live": live, "sweep": sweep,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--evergraph", metavar="PROGRAM", help="a program that is built already")
    parser.add_argument("--print", action="store_true", help=f"leave {os.path.basename(PAGE)} as it is")
    parser.add_argument("tables", nargs="*", choices=[*TABLES, []], metavar="TABLE")
    arguments = parser.parse_args()
    evergraph = harness.Evergraph(arguments.evergraph)
    for name in arguments.tables or [name for name in TABLES if name != "sweep"]:
        table = harness.Table(name, not arguments.print, PAGE)
        table.line(harness.circumstances(evergraph))
        table.line("")
        TABLES[name](evergraph, table)
        table.close()


if __name__ == "__main__":
    main()
