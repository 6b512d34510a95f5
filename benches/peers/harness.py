"""What the comparisons have in common: where things are, how programs run, where tables go."""
import datetime
import importlib.metadata
import json
import os
import platform
import re
import shutil
import statistics
import subprocess
import sys
import tempfile

PEERS = os.path.dirname(os.path.abspath(__file__))
BENCHES = os.path.dirname(PEERS)
ROOT = os.path.dirname(BENCHES)
README = os.path.join(BENCHES, "README.md")

# Every program has one core and knows it.
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1"}
CORE = max(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None


def pinned(command):
    """Runs it on one core and returns what it printed; CalledProcessError if it fails."""
    if CORE is not None and shutil.which("taskset"):
        command = ["taskset", "-c", str(CORE), *command]
    return subprocess.run(command, check=True, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True).stdout


class Evergraph:
    """The program; built from this clone unless another is named."""

    def __init__(self, program=None):
        #: For the record.
        self.version = "built elsewhere"
        if program is None:
            sources = ("--", "crates", "Cargo.toml", "Cargo.lock")
            self.version = output("git", "log", "-1", "--format=%h", *sources)
            if output("git", "status", "--porcelain", *sources):
                self.version += " with changes"
            subprocess.run(["cargo", "build", "--release", "--locked"], cwd=ROOT, check=True)
            target = os.environ.get("CARGO_TARGET_DIR", os.path.join(ROOT, "target"))
            program = os.path.join(ROOT, target, "release", "evergraph")
        self.program = program

    def report(self, *arguments):
        """Runs a subcommand on one thread and one core and returns its report."""
        with tempfile.TemporaryDirectory() as folder:
            report = os.path.join(folder, "report.json")
            pinned([self.program, *arguments, "--quiet", "--threads", "1", "--report", report])
            with open(report) as file:
                return json.load(file)


def evergraph_arguments(parser):
    parser.add_argument("--evergraph", metavar="PROGRAM", help="a program that is built already")
    parser.add_argument("--repeats", type=int, metavar="N", help="runs of each [default: %(default)s]", default=3)
    parser.add_argument("--print", action="store_true", help="leave README.md as it is")
    parser.add_argument("files", nargs="*", metavar="FILE", help="these, and leave README.md as it is")


def data_files(names):
    """Those of the names that are below $EVERGRAPH_DATA, in that order."""
    folder = os.environ.get("EVERGRAPH_DATA")
    if not folder:
        sys.exit("EVERGRAPH_DATA does not say where the data sets are (see README.md); or name FILEs, as data/*.g2o")
    found = {}
    for parent, _, files in os.walk(folder):
        for name in set(files) & set(names):
            found[name] = os.path.join(parent, name)
    for name in names:
        if name not in found:
            print(f"{name}: skipped, it is not below {folder}", file=sys.stderr)
    return [found[name] for name in names if name in found]


def version(package):
    """Of a Python package, or None if it is not installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def gtsam_version():
    """None, with a line that says so, if GTSAM is not there."""
    found = version("gtsam") and version("numpy") and version("gtsam")
    if not found:
        print(f"GTSAM: skipped, not installed; {sys.executable} -m pip install gtsam==4.3.0 numpy", file=sys.stderr)
    return found


def circumstances(evergraph, *programs):
    """One line: day, machine, what else it was doing, versions."""
    versions = [output("rustc", "--version").split(" (")[0], *programs, f"Python {platform.python_version()}"]
    machine = f"{processor()}, {os.cpu_count()} cores, {platform.system()} {platform.release()}"
    # A table that was made beside other work should say so.
    load = f"load {os.getloadavg()[0]:.1f} before"
    return f"{datetime.date.today()}; {machine}, {load}; {', '.join(versions)}; Evergraph {evergraph.version}."


def output(*command):
    try:
        return subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return f"{command[0]}: unknown"


def processor():
    try:
        with open("/proc/cpuinfo") as info:
            return next(line.split(":")[1].strip() for line in info if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def spread(values, digits):
    """Median (least..most)."""
    return f"{statistics.median(values):.{digits}f} ({min(values):.{digits}f}..{max(values):.{digits}f})"


class Table:
    """Markdown that appears line by line, and in the end between two comments of a page."""

    def __init__(self, marker, write, page=README):
        self.marker, self.write, self.lines, self.page = marker, write, [], page
        self.pattern = re.compile(f"(<!-- {marker}:begin -->\n).*?(<!-- {marker}:end -->)", re.DOTALL)
        if write and not self.pattern.search(open(page).read()):
            sys.exit(f"{page} has no place for this table: <!-- {marker}:begin --> and <!-- {marker}:end -->")

    def line(self, text):
        print(text, flush=True)
        self.lines.append(text)

    def header(self, *cells):
        self.row(*cells)
        self.line("|" + "---|" * len(cells))

    def row(self, *cells):
        self.line("| " + " | ".join(cells) + " |")

    def close(self):
        if self.write:
            text = open(self.page).read()
            body = "\n".join(self.lines) + "\n"
            with open(self.page, "w") as file:
                file.write(self.pattern.sub(lambda match: match[1] + "\n" + body + "\n" + match[2], text))
