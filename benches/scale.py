#!/usr/bin/env python3
"""Replays simulated cities of growing size and writes the curve docs/scale.svg and the table of docs/scale.md.

usage: python benches/scale.py [--max 100000] [--limit SECONDS] [--evergraph PROGRAM]

Builds Evergraph unless a PROGRAM is named. Makes worlds with `evergraph simulate city`, which grows with
its poses so that places are visited about as often in each: `city` as it comes (about two edges a pose)
and `trail`, the same walk with no loop closures. Replays each on one thread and one core: the city with
the default relinearization and without any, which is what the factorization alone costs; the trail with
the default. Then a batch of the whole city, and what the program takes to only read it.

A replay that takes longer than --limit is ended, and counts with the steps that it got to. Where steps
are summed up, they are those of the second half: of a run to n poses, while the graph held n/2 to n.
A city of a million poses takes some 25 GB of memory, the trail 3 GB and 200 MB of disk (below --folder;
by default in a temporary one).
"""
import argparse
import csv
import glob
import json
import math
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time

from peers import harness

DOCS = os.path.join(harness.ROOT, "docs")
PAGE, PICTURE = os.path.join(DOCS, "scale.md"), os.path.join(DOCS, "scale.svg")
MB = 1e6


class Run:
    """One replay: its steps, and what is known of it all."""

    def __init__(self, world, policy, poses, steps, report, peak):
        self.world, self.policy, self.poses = world, policy, poses
        #: Lines of --steps; the report, or nothing where the time limit ended the run; bytes.
        self.steps, self.report, self.peak = steps, report, peak

    @property
    def reached(self):
        return len(self.steps)

    def second_half(self, *kinds):
        return [step for step in self.steps[self.reached // 2 :] if step["kind"] in kinds]

    def total(self):
        return sum(step["ms"] for step in self.steps) / 1e3


def quantile(values, q):
    """By linear interpolation, as the reports of `evergraph` have it; NaN of nothing."""
    ordered = sorted(values)
    if not ordered:
        return math.nan
    place = q * (len(ordered) - 1)
    below = int(place)
    return ordered[below] + (place - below) * (ordered[min(below + 1, len(ordered) - 1)] - ordered[below])


def timed(command, limit=math.inf):
    """Runs it on one core; whether it ended in time, and its peak memory in bytes as last seen."""
    if harness.CORE is not None:
        command = ["taskset", "-c", str(harness.CORE), *command]
    process = subprocess.Popen(command, env=harness.ENVIRONMENT, stderr=subprocess.DEVNULL)
    # What the system says of the resources of a child that has ended counts this program's memory, too.
    peak, end = 0, time.monotonic() + limit
    while process.poll() is None:
        if time.monotonic() > end:
            process.terminate()
            process.wait()
            return False, peak
        try:
            with open(f"/proc/{process.pid}/status") as status:
                lines = [line.split() for line in status if line.startswith("VmHWM:")]
            peak = int(lines[0][1]) * 1024 if lines else peak
        except OSError:
            pass
        time.sleep(0.002 if peak < 64 * MB else 0.05)
    if process.returncode != 0:
        raise subprocess.CalledProcessError(process.returncode, command)
    return True, peak


def simulate(program, folder, world, poses):
    path = os.path.join(folder, f"{world}{poses}.g2o")
    if not os.path.exists(path):
        options = ["--closure-probability", "0"] if world == "trail" else []
        timed([program, "simulate", "city", "--poses", str(poses), *options, "--quiet", "-o", path])
    return path


def replay(program, path, world, policy, poses, limit):
    folder = tempfile.mkdtemp(prefix="scale")
    steps, report = os.path.join(folder, "steps.csv"), os.path.join(folder, "report.json")
    command = [program, "replay", path, "--threads", "1", "--quiet", "--relinearize", policy]
    finished, peak = timed([*command, "--steps", steps, "--report", report], limit)
    if not finished:
        # What it has written so far, next to where the whole would be.
        steps = glob.glob(os.path.join(folder, ".steps.csv.*"))[0]
    with open(steps) as file:
        lines = file.readlines()
    lines = lines if finished else lines[:-1]
    rows = [
        {"kind": row["kind"], "ms": float(row["update_ms"]), "cliques": int(row["cliques_eliminated"])}
        | {"moved": int(row["variables_relinearized"]), "factors": int(row["factors"])}
        for row in csv.DictReader(lines)
    ]
    if finished:
        with open(report) as file:
            report = json.load(file)
        # Before the program looks, on a copy of everything, whether the estimate has converged.
        peak = report["peak_rss_mb"] * 2**20
    else:
        report = None
    for left in glob.glob(os.path.join(folder, "*")) + glob.glob(os.path.join(folder, ".s*")):
        os.remove(left)
    os.rmdir(folder)
    run = Run(world, policy, poses, rows, report, peak)
    print(f"{world} {poses}, {policy}: {run.reached} steps in {run.total():.1f} s, {peak / MB:.0f} MB", flush=True)
    return run


def batch(program, path):
    """Seconds per linearization, and the report of the shorter optimization."""
    reports = []
    with tempfile.TemporaryDirectory() as folder:
        report = os.path.join(folder, "report.json")
        for iterations in (1, 11):
            command = [program, "optimize", path, "--method", "lm", "--threads", "1", "--quiet"]
            timed([*command, "--max-iterations", str(iterations), "--report", report])
            with open(report) as file:
                reports.append(json.load(file))
    more = reports[1]["iterations"] - reports[0]["iterations"]
    seconds = reports[1]["time"]["update_s"] - reports[0]["time"]["update_s"]
    return (seconds / more if more > 0 else math.nan), reports[0]


# --- The table -------------------------------------------------------------------------------


def number(value, digits=2):
    """So many significant digits, without an exponent."""
    if value is None or math.isnan(value):
        return ""
    if value == 0:
        return "0"
    return f"{value:,.{max(digits - 1 - math.floor(math.log10(abs(value))), 0)}f}"


def table(header, rows):
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return lines + ["| " + " | ".join(row) + " |" for row in rows] + [""]


def times(runs):
    """Microseconds of steps, by kind."""
    header = ["world", "relinearize", "poses", "ended at step", "edges a pose", "total, s", "explore, µs"]
    header += ["p99", "after explore", "p99", "loop, µs", "p99", "cliques", "p99", "factor, numbers a pose"]
    rows = []
    for run in runs:
        explore = [1e3 * step["ms"] for step in run.second_half("explore")]
        pairs = zip(run.steps[run.reached // 2 :], run.steps[run.reached // 2 + 1 :])
        plain = [1e3 * b["ms"] for a, b in pairs if a["kind"] == b["kind"] == "explore"]
        loop = [1e3 * step["ms"] for step in run.second_half("loop")]
        cliques = [step["cliques"] for step in run.second_half("loop")]
        row = [run.world, run.policy, f"{run.poses:,}", "" if run.report else f"{run.reached:,}"]
        row += [f"{run.steps[-1]['factors'] / run.reached:.2f}", number(run.total(), 3)]
        for values in (explore, plain, loop, cliques):
            row += [number(quantile(values, 0.5)), number(quantile(values, 0.99))]
        row += [f"{run.report['factor_nnz'] / run.poses:.0f}" if run.report else ""]
        rows.append(row)
    return table(header, rows)


def memory(runs, documents, batches):
    header = ["world", "relinearize", "poses", "peak, MB", "reading alone, MB", "bytes a pose", "reading alone"]
    header += ["batch, s a linearization", "batch peak, MB", "batch factor, numbers a pose"]
    rows, least = [], {}
    for run in runs:
        read = documents[run.world, run.poses]
        start = least.setdefault((run.world, run.policy), (run.peak, read, run.reached))
        more = run.reached - start[2]
        each = lambda now, then: f"{(now - then) / more:,.0f}" if more else ""
        row = [run.world, run.policy, f"{run.reached:,}", f"{run.peak / MB:,.0f}"]
        whole = run.reached == run.poses
        row += [f"{read / MB:,.0f}", each(run.peak, start[0]), each(read, start[1])] if whole else ["", "", ""]
        seconds, report = batches.get((run.world, run.poses), (None, None)) if run.policy == "both" else (None, None)
        row += [number(seconds)]
        row += [f"{report['peak_rss_mb'] * 2**20 / MB:,.0f}", f"{report['factor_nnz'] / run.poses:.0f}"] if report else ["", ""]
        rows.append(row)
    return table(header, rows)


# --- The picture -----------------------------------------------------------------------------

PANEL, LEFT, TOP, HEIGHT, GAP = 400, 80, 70, 420, 40
COLORS = {"explore": "#1b7f4d", "loop": "#c0392b", "batch": "#34495e"}


class Axes:
    """Logarithmic scales over whole decades."""

    def __init__(self, xs, ys):
        self.x0, self.x1 = math.floor(math.log10(min(xs))), math.ceil(math.log10(max(xs)) - 1e-9)
        self.y0, self.y1 = math.floor(math.log10(min(ys))), math.ceil(math.log10(max(ys)) - 1e-9)

    def x(self, value, left):
        return left + PANEL * (math.log10(value) - self.x0) / (self.x1 - self.x0)

    def y(self, value):
        return TOP + HEIGHT * (1 - (math.log10(value) - self.y0) / (self.y1 - self.y0))


def text(x, y, words, size=13, anchor="middle", color="#222", more=""):
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" text-anchor="{anchor}" fill="{color}"{more}>{words}</text>'


def milliseconds(exponent):
    return {-3: "1 µs", -2: "10 µs", -1: "100 µs", 0: "1 ms", 1: "10 ms", 2: "100 ms", 3: "1 s", 4: "10 s"}.get(
        exponent, f"10^{exponent} ms"
    )


def curve(axes, left, points, color, dashes):
    """A line through what was measured whole; what was ended early is a circle beside it."""
    line, marks = [], []
    for x, y, is_whole in sorted(points):
        x, y = axes.x(x, left), axes.y(y)
        line += [f"{'L' if line else 'M'}{x:.1f} {y:.1f}"] * is_whole
        fill = color if is_whole else "white"
        marks.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{fill}" stroke="{color}"/>')
    dash = f' stroke-dasharray="{dashes}"' if dashes else ""
    return [f'<path d="{" ".join(line)}" fill="none" stroke="{color}" stroke-width="2"{dash}/>', *marks] if line else marks


def picture(runs, batches):
    panels = [("city, default relinearization", "city", "both"), ("city, no relinearization", "city", "never")]
    panels += [("no loop closures", "trail", "both")]
    curves = {}
    for panel, (_, world, policy) in enumerate(panels):
        for run in runs:
            if (run.world, run.policy) != (world, policy):
                continue
            for kind in ("explore", "loop"):
                values = [step["ms"] for step in run.second_half(kind)]
                # A percentile of a handful says nothing.
                for name, q, least in (("median", 0.5, 20), ("p99", 0.99, 200)):
                    if len(values) >= least:
                        curves.setdefault((panel, kind, name), []).append(
                            (run.reached, quantile(values, q), run.report is not None)
                        )
    for (world, poses), (seconds, _) in batches.items():
        # So short that noise has made a difference of less than nothing of it, or no difference at all.
        if world == "city" and seconds > 0:
            curves.setdefault((0, "batch", "linearization"), []).append((poses, 1e3 * seconds, True))
    points = [point for some in curves.values() for point in some]
    axes = Axes([point[0] for point in points], [point[1] for point in points])
    width = LEFT + len(panels) * (PANEL + GAP)
    height = TOP + HEIGHT + 105
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
        " font-family=\"'DejaVu Sans',Verdana,sans-serif\">",
        '<rect width="100%" height="100%" fill="white"/>',
        text(LEFT, 28, "Time of a step against the size of the graph, one thread", 18, "start"),
        text(22, TOP + HEIGHT / 2, "time of a step", more=f' transform="rotate(-90 22 {TOP + HEIGHT / 2})"'),
    ]
    for panel, (title, _, _) in enumerate(panels):
        left = LEFT + panel * (PANEL + GAP)
        out.append(text(left + PANEL / 2, TOP - 12, title, 14))
        for exponent in range(axes.y0, axes.y1 + 1):
            y = axes.y(10.0**exponent)
            out.append(f'<path d="M{left} {y:.1f}h{PANEL}" stroke="#ddd"/>')
            if panel == 0:
                out.append(text(left - 8, y + 4, milliseconds(exponent), 12, "end"))
        for exponent in range(axes.x0, axes.x1 + 1):
            x = axes.x(10.0**exponent, left)
            out.append(f'<path d="M{x:.1f} {TOP}v{HEIGHT}" stroke="#ddd"/>')
            power = f'10<tspan dy="-6" font-size="9">{exponent}</tspan>'
            out.append(text(x, TOP + HEIGHT + 20, power, 12))
        out.append(f'<rect x="{left}" y="{TOP}" width="{PANEL}" height="{HEIGHT}" fill="none" stroke="#888"/>')
        out.append(text(left + PANEL / 2, TOP + HEIGHT + 42, "poses in the graph"))
        for (at, kind, name), some in curves.items():
            if at == panel:
                dashes = {"median": "", "p99": "6 4"}.get(name, "2 3")
                out += curve(axes, left, some, COLORS[kind], dashes)
    entries = [("exploration, median", "explore", ""), ("exploration, p99", "explore", "6 4")]
    entries += [("loop closure, median", "loop", ""), ("loop closure, p99", "loop", "6 4")]
    entries += [("batch, one linearization", "batch", "2 3"), ("ended early", None, "")]
    y = TOP + HEIGHT + 78
    for at, (words, kind, dashes) in enumerate(entries):
        x = LEFT + at * (width - LEFT - GAP) / len(entries)
        dash = f' stroke-dasharray="{dashes}"' if dashes else ""
        if kind:
            out.append(f'<path d="M{x:.1f} {y}h36" stroke="{COLORS[kind]}" stroke-width="2"{dash}/>')
        fill, line = (COLORS[kind],) * 2 if kind else ("white", "#666")
        out.append(f'<circle cx="{x + 18:.1f}" cy="{y}" r="3.5" fill="{fill}" stroke="{line}"/>')
        out.append(text(x + 44, y + 4, words, 13, "start"))
    with open(PICTURE, "w") as file:
        file.write("\n".join([*out, "</svg>", ""]))


def into_page(lines):
    pattern = re.compile("(<!-- scale:begin -->\n).*?(<!-- scale:end -->)", re.DOTALL)
    with open(PAGE) as file:
        page = file.read()
    if not pattern.search(page):
        sys.exit(f"{PAGE} has no place for the table: <!-- scale:begin --> and <!-- scale:end -->")
    with open(PAGE, "w") as file:
        file.write(pattern.sub(lambda match: match[1] + "\n" + "\n".join(lines) + "\n" + match[2], page))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--max", type=int, default=100_000, metavar="POSES", help="largest graph [default: %(default)s]")
    parser.add_argument("--limit", type=float, default=1500, metavar="SECONDS", help="longest replay [default: %(default)s]")
    parser.add_argument("--evergraph", metavar="PROGRAM", help="a program that is built already")
    parser.add_argument("--built-from", metavar="COMMIT", help="what PROGRAM was built from, for the record")
    parser.add_argument("--folder", help="where the graphs are kept for another time")
    arguments = parser.parse_args()
    evergraph = harness.Evergraph(arguments.evergraph)
    evergraph.version = arguments.built_from or evergraph.version
    program = os.path.abspath(evergraph.program)
    circumstances = harness.circumstances(evergraph)
    sizes = [lead * 10**exponent for exponent in range(3, 9) for lead in (1, 3) if lead * 10**exponent <= arguments.max]
    runs, documents, batches = [], {}, {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or temporary
        stopped = set()
        for world, policy in (("trail", "both"), ("city", "never"), ("city", "both")):
            for poses in sizes:
                # What did not end in time will not end in time when it is larger.
                if (world, policy) in stopped:
                    continue
                path = simulate(program, folder, world, poses)
                if (world, poses) not in documents:
                    documents[world, poses] = timed([program, "info", path, "--threads", "1", "--quiet"])[1]
                runs.append(replay(program, path, world, policy, poses, arguments.limit))
                if runs[-1].report is None:
                    stopped.add((world, policy))
                elif world == "city" and policy == "never":
                    batches[world, poses] = batch(program, path)
    lines = [circumstances, f"A replay was ended after {arguments.limit:.0f} s.", ""]
    lines += ["### Time", "", *times(runs), "### Memory, and a batch of the whole", "", *memory(runs, documents, batches)]
    into_page(lines)
    picture(runs, batches)


main()
