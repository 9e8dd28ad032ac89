"""Compare phipsi in Rust with Pinocchio in C++ on the same models, on this machine.

Usage: .venv-peers/bin/python benches/peers/compare.py [--passes N] [--seconds S] [MODEL...]

Two programs measure one case per request: benches/turns.rs, built here if necessary, and target/peers/pinocchio_bench
(`make peers` builds it). The speed of a shared machine drifts by a factor within minutes. Therefore the requests are
interleaved: a burst of phipsi and, directly before or after it, a burst of each of Pinocchio's algorithms for the
same result; then the next case; all cases are repeated in every pass, in rotated order. Ratios are computed within a
pass, relative to the algorithm that is fastest on that model by its median over all passes. Prints a table, writes
target/peers/comparison.json.
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NoReturn

ROOT = Path(__file__).resolve().parents[2]
PEERS = ROOT / "target" / "peers"

MODELS = ("chain_7", "chain_16", "chain_30", "chain_64", "ur5", "panda", "anymal", "g1", "talos")

#: Features of the benches: those of `make check`, so that nothing is compiled again.
FEATURES = "urdf,parallel,dense,stochastic,avx512"

#: Groups of phipsi, and the algorithms of pinocchio_bench for the same result. The fastest one is the peer.
OPERATIONS = {
    "forward_dynamics": ("aba_local", "aba_world", "crba_forward_dynamics"),
    "inverse_dynamics": ("rnea",),
    "mass_matrix": ("crba_local", "crba_world"),
    "mass_matrix_inverse": ("minverse",),
    "inverse_dynamics_derivatives": ("rnea_derivatives",),
    "forward_dynamics_derivatives": ("aba_derivatives",),
}
#: Pinocchio has no batches on one core: its peer is the same call with one state at a time.
BATCH = "_batch"
#: Suffix of calls from Python that write into an array of the caller.
INTO_GIVEN = ", out="
#: Forms that are measured in addition to covariance.
FORMS = {"forward_dynamics": ("auto", "square-root"), "mass_matrix_inverse": ("auto",), "forward_dynamics_derivatives": ("auto",)}
#: States for form "auto" in addition to random ones: names of python/phipsi/report/kinds.py, with a hyphen for a
#: space.
STATES = ("held", "at-rest", "falling")
#: Instruction set for an additional measurement of batches, if the machine has a wider one.
NARROWER = "avx2"

Report = dict[str, Any]  # JSON


@dataclass(frozen=True)
class Spread:
    """Nanoseconds per state, over the passes."""

    min: float
    median: float
    max: float
    passes: int

    @classmethod
    def of(cls, values: list[float]) -> "Spread":
        return cls(min(values), statistics.median(values), max(values), len(values))

    def __str__(self) -> str:
        if self.passes == 1:  # no spread was measured
            return f"{self.median:.0f}"
        return f"{self.median:.0f} ({self.min:.0f} to {self.max:.0f})"


@dataclass
class Case:
    """A group of benches/turns.rs on a model, and the times of its contestants by pass."""

    group: str
    operation: str
    model: str
    ours: list[float] = field(default_factory=list)
    theirs: dict[str, list[float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Row:
    group: str
    model: str
    phipsi_ns: Spread
    pinocchio_ns: Spread
    pinocchio_algorithm: str
    ratio: Spread
    """Ratio of the times (peer to phipsi), by pass."""
    ratio_of_best: float
    """Ratio of the shortest times, which other load affects least."""
    pinocchio_all_ns: dict[str, Spread]


def fail(message: str) -> NoReturn:
    sys.exit(f"compare.py: {message}")


class Server:
    """A program whose first line describes it, and which answers each further line with nanoseconds."""

    def __init__(self, *command: str) -> None:
        self.name = Path(command[0]).name
        environment = os.environ | {"RAYON_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            command, cwd=ROOT, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self.about: Report = json.loads(self.read("when it was started"))

    def read(self, when: str) -> str:
        assert self.process.stdout
        line: str = self.process.stdout.readline()
        if not line:
            fail(f"{self.name} ended {when}, why is above; pinocchio_bench of another tree: run `make peers`")
        return line

    def ask(self, *question: object) -> float:
        assert self.process.stdin
        line = " ".join(map(str, question))
        self.process.stdin.write(f"{line}\n")
        return float(self.read(f"when asked for {line}"))

    def end(self) -> None:
        assert self.process.stdin
        self.process.stdin.close()
        try:
            self.process.wait(timeout=60)
        except subprocess.TimeoutExpired:
            self.process.kill()


def turns_bench() -> str:
    """Path of benches/turns.rs, after building it."""
    command = ["cargo", "bench", "--locked", "--no-run", "--message-format=json-render-diagnostics"]
    command += ["--features", FEATURES, "--bench", "turns"]
    try:
        done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        fail(str(error))
    for message in map(json.loads, done.stdout.splitlines()):
        if message["reason"] == "compiler-artifact" and message["target"]["name"] == "turns":
            return str(message["executable"])
    fail("cargo does not say where it put the bench")


def start() -> tuple[Server, Server]:
    """phipsi, Pinocchio."""
    harness = PEERS / "pinocchio_bench"
    models = [PEERS / "models" / f"{name}.bin" for name in MODELS]
    absent = [str(path) for path in (harness, *models) if not path.exists()]
    if absent:
        fail(f"not there: {', '.join(absent)}; run `make peers`")
    return Server(turns_bench(), "serve"), Server(str(harness), "--serve", *map(str, models))


def groups(arm: str, arms: Sequence[str]) -> Iterator[tuple[str, str]]:
    """The measured group with its operation; on this instruction set unless the group specifies another one."""
    for operation in OPERATIONS:
        for group in (operation, operation + BATCH):
            yield group, operation
            for form in FORMS.get(operation, ()):
                yield f"{group}/{form}", operation
            if operation == "forward_dynamics":
                for state in STATES:
                    yield f"{group}/auto/{state}", operation
        if arm != NARROWER and NARROWER in arms:
            yield f"{operation}{BATCH}/{NARROWER}", operation


def take_turns(cases: Sequence[Case], servers: tuple[Server, Server], passes: int, seconds: float) -> None:
    """All contestants once per pass; both orders rotate, so that none always follows the same one."""
    phipsi, pinocchio = servers
    for number in range(passes):
        print(f"pass {number + 1} of {passes}", file=sys.stderr)
        first = number * len(cases) // passes
        for case in (*cases[first:], *cases[:first]):
            contestants = ["", *OPERATIONS[case.operation]]
            first_of_case = number % len(contestants)
            for algorithm in contestants[first_of_case:] + contestants[:first_of_case]:
                if algorithm:
                    ns = pinocchio.ask(case.model, algorithm, seconds)
                    case.theirs.setdefault(algorithm, []).append(ns)
                else:
                    case.ours.append(phipsi.ask(case.group, case.model, seconds))


def rows_of(cases: Sequence[Case]) -> list[Row]:
    """The fastest peer; it is the same algorithm for all groups of an operation on a model, so all of its bursts
    count.
    """
    every: dict[tuple[str, str], dict[str, list[float]]] = {}
    for case in cases:
        for algorithm, ns in case.theirs.items():
            every.setdefault((case.operation, case.model), {}).setdefault(algorithm, []).extend(ns)
    rows = []
    for case in cases:
        bursts = every[case.operation, case.model]
        fastest = min(bursts, key=lambda algorithm: statistics.median(bursts[algorithm]))
        theirs = case.theirs[fastest]
        ratio = Spread.of([their / our for their, our in zip(theirs, case.ours, strict=True)])
        best = min(theirs) / min(case.ours)
        spreads = {algorithm: Spread.of(ns) for algorithm, ns in case.theirs.items()}
        rows.append(Row(case.group, case.model, Spread.of(case.ours), Spread.of(theirs), fastest, ratio, best, spreads))
    return rows


def first_line(*command: str) -> str:
    """Output of the command; "unknown" if it is not installed or fails, because it only labels the results."""
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip().split("\n")[0]


def processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def rustflags() -> str:
    """Compiler flags of cargo."""
    return os.environ.get("RUSTFLAGS", "")


def describe_machine(load_at_start: float) -> Report:
    return {
        "date": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "processor": processor(),
        "cores": os.cpu_count(),
        "load_at_start": round(load_at_start, 2),
        "commit": first_line("git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"),
        "rustc": first_line("rustc", "--version"),
        "rustflags": rustflags(),
    }


def describe(phipsi: Server, pinocchio: Server, load_at_start: float) -> Report:
    harness = pinocchio.about
    return describe_machine(load_at_start) | {
        "arm": phipsi.about["arm"],
        "cxx": f"{harness['compiler']} {harness['flags']}",
        "pinocchio": harness["pinocchio"],
        "eigen": harness["eigen"],
    }


def print_table(rows: list[Row], machine: Report, passes: int) -> None:
    header = ("group", "model", "phipsi ns", "Pinocchio ns", "by", "ratio", "of the best")
    cells = [header]
    for row in rows:
        ratio = f"{row.ratio.median:.2f} ({row.ratio.min:.2f} to {row.ratio.max:.2f})"
        times = str(row.phipsi_ns), str(row.pinocchio_ns)
        cells.append((row.group, row.model, *times, row.pinocchio_algorithm, ratio, f"{row.ratio_of_best:.2f}"))
    widths = [max(len(line[column]) for line in cells) for column in range(len(header))]
    for line in cells:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())

    print(f"\nNanoseconds a state: median (minimum to maximum) over {passes} passes.")
    print("Ratio: Pinocchio / phipsi within a pass, of these median (minimum to maximum); and of the shortest times.")
    for key, value in machine.items():
        print(f"{key}: {value}")


def write_report(name: str, report: dict[str, Any]) -> None:
    """The results, as JSON in the file that report_page.py reads."""
    PEERS.mkdir(parents=True, exist_ok=True)
    path = PEERS / name
    path.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n")
    print(f"written: {path}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="*", metavar="MODEL", help=f"default: {' '.join(MODELS)}")
    parser.add_argument("--passes", type=int, default=15, help="default: %(default)s")
    parser.add_argument("--seconds", type=float, default=0.02, help="about, a burst; default: %(default)s")
    options = parser.parse_args()
    if options.passes < 1 or not options.seconds >= 0:
        parser.error("--passes must be at least 1, --seconds not negative")

    load = os.getloadavg()[0]
    phipsi, pinocchio = servers = start()
    measured = list(groups(phipsi.about["arm"], phipsi.about["arms"]))
    cases = [Case(group, operation, model) for model in options.models or MODELS for group, operation in measured]
    take_turns(cases, servers, options.passes, options.seconds)
    for server in servers:
        server.end()
    # By group, then by model.
    order = [group for group, _ in measured]
    rows = sorted(rows_of(cases), key=lambda row: order.index(row.group))
    machine = describe(phipsi, pinocchio, load)
    print_table(rows, machine, options.passes)
    report = {
        "machine": machine,
        "passes": options.passes,
        "seconds": options.seconds,
        "rows": [asdict(row) for row in rows],
    }
    write_report("comparison.json", report)


if __name__ == "__main__":
    main()
