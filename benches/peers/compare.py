"""Compare phipsi's benchmarks with Pinocchio's algorithms on the same models, on this machine, now.

Usage: .venv-peers/bin/python benches/peers/compare.py [--passes N] [--rerun "cargo bench --bench dynamics"]

The phipsi side is what criterion has stored: target/criterion/GROUP/MODEL/new/estimates.json, median, where GROUP is
one of OPERATIONS below, or one of them with "_batch" behind it, and MODEL is one of MODELS. A bench that declares
Throughput::Elements(n) works on n states an iteration; its time is divided by n. The Pinocchio side is
target/peers/pinocchio_bench (`make peers` builds it), run once a pass.

A shared machine drifts by tens of per cent within minutes. With --rerun the two sides take turns, pass by pass, and
both have a minimum, median and maximum over the passes; without it criterion's figures are as old as they are, and
the table says how old. Prints a table, writes target/peers/comparison.json.
"""

import argparse
import json
import os
import platform
import shlex
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NoReturn, TextIO

ROOT = Path(__file__).resolve().parents[2]
PEERS = ROOT / "target" / "peers"

MODELS = ("chain_7", "chain_16", "chain_30", "chain_64", "ur5", "panda", "anymal", "g1", "talos")

# criterion's group: the algorithms of pinocchio_bench that answer the same question. The fastest one is the peer.
OPERATIONS = {
    "forward_dynamics": ("aba_local", "aba_world", "crba_forward_dynamics"),
    "inverse_dynamics": ("rnea",),
    "mass_matrix": ("crba_local", "crba_world"),
    "factor": ("crba_local_cholesky", "crba_world_cholesky"),
    "mass_matrix_inverse": ("minverse",),
}
# Pinocchio has no batches on one core: its peer is the same call, one state at a time. Not missed when absent.
BATCH = "_batch"

STALE_SECONDS = 600.0

Report = dict[str, Any]  # JSON


@dataclass(frozen=True)
class Spread:
    """Nanoseconds a state, over the passes."""

    min: float
    median: float
    max: float
    passes: int

    @classmethod
    def of(cls, values: list[float]) -> "Spread":
        return cls(min(values), statistics.median(values), max(values), len(values))

    def __str__(self) -> str:
        if self.passes == 1:  # no spread was measured, so none is shown
            return f"{self.median:.0f}"
        return f"{self.median:.0f} ({self.min:.0f} to {self.max:.0f})"


@dataclass(frozen=True)
class Row:
    group: str
    model: str
    phipsi_ns: Spread | None
    pinocchio_ns: Spread
    pinocchio_algorithm: str

    @property
    def ratio(self) -> float | None:
        """How many times faster phipsi is, median by median."""
        return self.pinocchio_ns.median / self.phipsi_ns.median if self.phipsi_ns else None


def fail(message: str) -> NoReturn:
    sys.exit(f"compare.py: {message}")


def run(command: list[str], stdout: int | TextIO) -> str:
    """What the command prints, when stdout is a pipe. Its errors are on the terminal already."""
    try:
        done = subprocess.run(command, cwd=ROOT, stdout=stdout, text=True, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        fail(str(error))
    return done.stdout


def run_harness() -> Report:
    """One pass of Pinocchio over all models."""
    harness = PEERS / "pinocchio_bench"
    models = [PEERS / "models" / f"{name}.bin" for name in MODELS]
    absent = [str(path) for path in (harness, *models) if not path.exists()]
    if absent:
        fail(f"not there: {', '.join(absent)}; run `make peers`")
    report: Report = json.loads(run([str(harness), "--json", *map(str, models)], stdout=subprocess.PIPE))
    return report


def states_an_iteration(benchmark: Path) -> int:
    """From the throughput that the bench declared; one state where it declared none."""
    match json.loads(benchmark.read_text())["throughput"]:
        case None:
            return 1
        case {"Elements": int(states)} if states > 0:
            return states
        case other:
            fail(f"{benchmark}: throughput {other}; expected Throughput::Elements(number of states) or none")


def groups() -> Iterator[tuple[str, tuple[str, ...]]]:
    for operation, algorithms in OPERATIONS.items():
        yield operation, algorithms
        yield operation + BATCH, algorithms


def read_criterion(folder: Path, since: float) -> tuple[dict[tuple[str, str], float], float | None]:
    """(group, model) -> ns a state, of the estimates written after `since`; and the time of the oldest of them."""
    found, oldest = {}, None
    for group, _ in groups():
        for model in MODELS:
            new = folder / group / model / "new"
            estimates = new / "estimates.json"
            if not estimates.exists() or estimates.stat().st_mtime < since:
                continue
            median = json.loads(estimates.read_text())["median"]["point_estimate"]
            found[group, model] = median / states_an_iteration(new / "benchmark.json")
            written = estimates.stat().st_mtime
            oldest = written if oldest is None else min(oldest, written)
    return found, oldest


def first_line(*command: str) -> str:
    """Of what the command prints; "unknown" where it is not installed or fails: it only labels the figures."""
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


def describe_machine(load_at_start: float) -> Report:
    return {
        "date": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "processor": processor(),
        "cores": os.cpu_count(),
        "load_at_start": round(load_at_start, 2),
        "commit": first_line("git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"),
        "rustc": first_line("rustc", "--version"),
        "rustflags": os.environ.get("RUSTFLAGS", ""),
    }


def describe(harness: Report, load_at_start: float) -> Report:
    return describe_machine(load_at_start) | {
        "cxx": f"{harness['compiler']} {harness['flags']}",
        "pinocchio": harness["pinocchio"],
        "eigen": harness["eigen"],
    }


def pinocchio_spreads(passes: list[Report]) -> dict[tuple[str, str], Spread]:
    """(model, algorithm) -> ns a call."""
    values: dict[tuple[str, str], list[float]] = {}
    for one in passes:
        for entry in one["models"]:
            for algorithm, ns in entry["ns"].items():
                values.setdefault((entry["model"], algorithm), []).append(ns)
    return {key: Spread.of(ns) for key, ns in values.items()}


def make_rows(pinocchio: dict[tuple[str, str], Spread], phipsi_passes: list[dict[tuple[str, str], float]]) -> list[Row]:
    rows = []
    for group, algorithms in groups():
        for model in MODELS:
            ours = [one[group, model] for one in phipsi_passes if (group, model) in one]
            if group.endswith(BATCH) and not ours:
                continue
            fastest = min(algorithms, key=lambda algorithm: pinocchio[model, algorithm].median)
            rows.append(Row(group, model, Spread.of(ours) if ours else None, pinocchio[model, fastest], fastest))
    return rows


def print_table(rows: list[Row], machine: Report, passes: int, age: float | None) -> None:
    header = ("operation", "model", "phipsi ns", "Pinocchio ns", "by", "ratio")
    cells = [header]
    for row in rows:
        ours = str(row.phipsi_ns) if row.phipsi_ns else "not measured"
        ratio = f"{row.ratio:.2f}" if row.ratio else "-"
        cells.append((row.group, row.model, ours, str(row.pinocchio_ns), row.pinocchio_algorithm, ratio))
    widths = [max(len(line[column]) for line in cells) for column in range(len(header))]
    for line in cells:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())

    print(f"\nNanoseconds a state: median (minimum to maximum) over {passes} passes. Ratio: Pinocchio / phipsi.")
    for key, value in machine.items():
        print(f"{key}: {value}")
    for operation in OPERATIONS:
        missing = [row.model for row in rows if row.group == operation and row.phipsi_ns is None]
        if missing:
            print(f"not measured: {operation}/{{{','.join(missing)}}}")
    if age is not None and age > STALE_SECONDS:
        print(
            f"WARNING: the oldest of phipsi's figures was {age / 60:.0f} minutes old when Pinocchio was first timed. "
            "The ratios are only as good as this machine is steady; --rerun makes the two sides take turns."
        )


def write_report(name: str, report: dict[str, Any]) -> None:
    """What was measured, as JSON where report_page.py looks for it."""
    PEERS.mkdir(parents=True, exist_ok=True)
    path = PEERS / name
    path.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n")
    print(f"written: {path}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--passes", type=int, default=5, help="default: %(default)s")
    parser.add_argument("--rerun", metavar="COMMAND", help="run this (cargo bench ...) before each pass of Pinocchio")
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    parser.add_argument("--criterion", type=Path, default=target / "criterion", help="default: %(default)s")
    options = parser.parse_args()
    if options.passes < 1:
        parser.error("--passes must be at least 1")

    start, load = time.time(), os.getloadavg()[0]
    phipsi_passes, pinocchio_passes = [], []
    age = None
    if not options.rerun:
        found, oldest = read_criterion(options.criterion, since=0.0)
        phipsi_passes.append(found)
        age = start - oldest if oldest is not None else None
    for number in range(1, options.passes + 1):
        print(f"pass {number} of {options.passes}", file=sys.stderr)
        if options.rerun:
            # A whole second of slack: some file systems cut the time of writing to that. Older estimates are left
            # out, because a bench that was renamed or filtered leaves its last ones behind.
            began = time.time() - 1.0
            run(shlex.split(options.rerun), stdout=sys.stderr)
            found, _ = read_criterion(options.criterion, since=began)
            if not found:
                fail(f"`{options.rerun}` wrote no estimates of a known group and model below {options.criterion}")
            phipsi_passes.append(found)
        pinocchio_passes.append(run_harness())

    pinocchio = pinocchio_spreads(pinocchio_passes)
    rows = make_rows(pinocchio, phipsi_passes)
    machine = describe(pinocchio_passes[0], load)
    print_table(rows, machine, options.passes, age)

    report = {
        "machine": machine,
        "passes": options.passes,
        "phipsi_passes": len(phipsi_passes),
        "rerun": options.rerun,
        "phipsi_age_seconds": age,
        "rows": [asdict(row) | {"ratio": row.ratio} for row in rows],
        "pinocchio_ns": [
            {"model": model, "algorithm": algorithm} | asdict(spread)
            for (model, algorithm), spread in pinocchio.items()
        ],
    }
    write_report("comparison.json", report)


if __name__ == "__main__":
    main()
