"""Compare phipsi with the peers as called from Python, with one state per call and with batches, on this machine.

Usage: .venv-peers/bin/python benches/peers/python_peers.py [--passes N] [--seconds S] [MODEL...]

All contestants are interleaved in one process, in an order that rotates with every pass. phipsi on two threads runs
in a second process, because rayon creates its pool once per process. Before a call is timed, its result for the last
state must agree with phipsi's square-root form (mass matrix: with the first contestant); a call that does not agree
is reported and not timed. Prints a table, writes target/peers/python.json.
"""

import argparse
import contextlib
import gc
import importlib.metadata
import logging
import multiprocessing
import os
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

# Before phipsi creates its pool: the first process uses one core.
os.environ["RAYON_NUM_THREADS"] = os.environ.get("PHIPSI_BENCH_THREADS", "1")
# Otherwise the threads of pin.abaInParallel continue to spin on the core of the next contestant.
os.environ["OMP_WAIT_POLICY"] = "passive"

import batches
import contestants
import numpy as np
from compare import Spread, describe_machine, write_report
from contestants import Entry, Refused
from problems import BATCH_STATES, MODELS, ONE_STATES, Problem, problem

#: Tolerance of the results relative to the largest entry; the robots are not extreme.
AGREEMENT = 1e-8
#: Call of phipsi that the ratios of an operation refer to, if there are two.
REFERENCE = ", auto"


@dataclass
class Timed:
    """One call on one model."""

    model: str
    operation: str
    library: str
    call: str
    states: int
    measure: Callable[[float], float]
    """Time per state, ns, from a measurement of at least that many seconds."""
    ns: list[float] = field(default_factory=list)


def nanoseconds(loop: Callable[[], Any], states: int, seconds: float) -> float:
    """Time per state, over as many loops as necessary."""
    loops, start = 0, time.perf_counter()
    while True:
        loop()
        loops += 1
        elapsed = time.perf_counter() - start
        if elapsed >= seconds:
            return elapsed * 1e9 / (loops * states)


def answer(entry: Entry) -> np.ndarray:
    """Run the loop once, which is also the warm-up."""
    return np.asarray(entry.ours(entry.loop()), dtype=float)


class SecondProcess:
    """phipsi on more threads: the same batches in a separate process, interleaved."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        os.environ["PHIPSI_BENCH_THREADS"] = str(threads)
        self.process = context.Process(target=serve, args=(theirs, threads), daemon=True)
        self.process.start()
        del os.environ["PHIPSI_BENCH_THREADS"]

    def ask(self, *question: Any) -> Any:
        self.pipe.send(question)
        return self.pipe.recv()

    def entries(self, model: str, states: int) -> Iterator[tuple[Entry, Callable[[float], float]]]:
        """Calls of phipsi in this process, with their timing functions there."""
        for index, (operation, library, call, scale) in enumerate(self.ask("load", model, states)):

            def loop(index: int = index) -> Any:
                return self.ask("answer", index)

            def measure(seconds: float, index: int = index) -> float:
                return float(self.ask("time", index, seconds))

            yield Entry(operation, library, call, loop, np.asarray, scale), measure


def serve(pipe: Any, threads: int) -> None:
    """The second process."""
    entries: list[Entry] = []
    states = 0
    with contextlib.suppress(EOFError):
        while True:
            match pipe.recv():
                case ("load", model, count):
                    states = count
                    entries = list(batches.of_phipsi(problem(model, states), threads))
                    pipe.send([(entry.operation, entry.library, entry.call, entry.scale) for entry in entries])
                case ("answer", index):
                    pipe.send(answer(entries[index]))
                case ("time", index, seconds):
                    pipe.send(nanoseconds(entries[index].loop, states, seconds))


class Table:
    """Timed calls, and calls that are not timed, with the reason."""

    def __init__(self) -> None:
        self.timed: list[Timed] = []
        self.refused: list[dict[str, str]] = []

    def refuse(self, model: str, library: str, reason: str) -> None:
        reason = textwrap.shorten(reason, 240, placeholder=" ...")
        row = {"model": model, "library": library, "reason": reason}
        if row not in self.refused:
            self.refused.append(row)
            print(f"{model}: {library}: {row['reason']}", file=sys.stderr)

    def add(self, model: Problem, entry: Entry, expected: dict[str, np.ndarray], measure: Any = None) -> None:
        """Time this call from now on, if its result is correct."""
        states = len(model)
        found = answer(entry)
        known = expected.setdefault(entry.operation, found)
        off = float(np.max(np.abs(found - known)) / max(np.max(np.abs(known)), entry.scale))
        if not off <= AGREEMENT:
            self.refuse(model.name, entry.library, f"{entry.call}: off by {off:.1e}, not timed")
            return
        measure = measure or (lambda seconds: nanoseconds(entry.loop, states, seconds))
        self.timed.append(Timed(model.name, entry.operation, entry.library, entry.call, states, measure))


def expected_of(model: Problem) -> dict[str, np.ndarray]:
    """Accelerations in the square-root form; other results are compared with phipsi's own, which come first."""
    state = (model.q[-1], model.qd[-1], model.tau[-1])
    forward = model.scene.forward_dynamics(*state, form="square-root")
    inverse = model.scene.mass_matrix_inverse(model.q[-1], form="square-root")
    matrix = np.linalg.inv(inverse)
    each = {"forward_dynamics": forward, "mass_matrix": matrix, "mass_matrix_inverse": inverse}
    return each | {f"{operation}_batch": value for operation, value in each.items()}


def gather(table: Table, name: str, more: SecondProcess) -> None:
    """All contestants on one model."""
    for states, makers in ((ONE_STATES, contestants.ONE_STATE), (BATCH_STATES, batches.BATCHES)):
        model = problem(name, states)
        expected = expected_of(model)
        for library, make in makers.items():
            try:
                for entry in make(model):
                    table.add(model, entry, expected)
            except Refused as refused:
                table.refuse(name, library, str(refused))
            if make is batches.of_phipsi and more.threads > 1:
                for entry, measure in more.entries(name, states):
                    table.add(model, entry, expected, measure)


def turns(timed: list[Timed], passes: int, seconds: float) -> None:
    """All contestants once per pass; the order rotates, so that none always follows the same one."""
    gc.collect()
    gc.disable()
    for number in range(passes):
        first = number * len(timed) // passes
        for one in timed[first:] + timed[:first]:
            one.ns.append(one.measure(seconds))
    gc.enable()


def rows_of(timed: list[Timed]) -> list[dict[str, Any]]:
    """Median, minimum and maximum, and the ratio to phipsi's time on the same number of threads, by medians."""
    ours: dict[tuple[str, str, str], float] = {}
    for one in timed:
        name, _, threads = one.library.partition(", ")
        key = (one.model, one.operation, threads)
        if name == "phipsi" and (key not in ours or one.call.endswith(REFERENCE)):
            ours[key] = Spread.of(one.ns).median
    rows = []
    for one in timed:
        spread, threads = Spread.of(one.ns), one.library.partition(", ")[2]
        base = ours.get((one.model, one.operation, threads))
        ratio = spread.median / base if base else None
        rows.append(
            {"model": one.model, "operation": one.operation, "library": one.library, "call": one.call,
             "states": one.states, "ns": asdict(spread), "ratio": ratio}
        )  # fmt: skip
    return rows


def print_table(rows: list[dict[str, Any]]) -> None:
    header = ("operation", "model", "library", "call", "ns per state", "over phipsi")
    cells = [header]
    for row in rows:
        ratio = f"{row['ratio']:.2f}" if row["ratio"] else "-"
        ns = str(Spread(**row["ns"]))
        cells.append((row["operation"], row["model"], row["library"], row["call"], ns, ratio))
    widths = [max(len(line[column]) for line in cells) for column in range(len(header))]
    for line in cells:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def versions() -> dict[str, str]:
    names = ("phipsi", "pin", "mujoco", "drake", "dynibo", "numpy", "example-robot-data")
    return {name: importlib.metadata.version(name) for name in names}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="*", metavar="MODEL", help=f"default: {' '.join(MODELS)}")
    parser.add_argument("--passes", type=int, default=15, help="default: %(default)s")
    parser.add_argument("--seconds", type=float, default=0.01, help="at least, a call and pass; default: %(default)s")
    options = parser.parse_args()
    if options.passes < 1 or options.seconds < 0:
        parser.error("--passes must be at least 1, --seconds not negative")

    logging.getLogger("drake").setLevel(logging.ERROR)  # suppresses hundreds of lines on unknown tags
    machine = describe_machine(os.getloadavg()[0]) | {"python": sys.version.split()[0], "versions": versions()}
    more = SecondProcess(min(2, len(os.sched_getaffinity(0))))
    table = Table()
    for name in options.models or MODELS:
        print(f"{name}", file=sys.stderr)
        begin = len(table.timed)
        gather(table, name, more)
        turns(table.timed[begin:], options.passes, options.seconds)
    rows = rows_of(sorted(table.timed, key=lambda one: one.operation))
    print_table(rows)
    print(f"\nNanoseconds a state: median (minimum to maximum) over {options.passes} passes.")
    print("The ratio is to phipsi's default form on as many threads: above 1 phipsi is faster.")
    for row in table.refused:
        print(f"not timed: {row['model']}: {row['library']}: {row['reason']}")
    report = {"machine": machine, "passes": options.passes, "command": sys.argv, "rows": rows, "refused": table.refused}
    write_report("python.json", report)


if __name__ == "__main__":
    main()
