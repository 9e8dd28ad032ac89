"""Operations, time and fraction of the machine's measured peak of each algorithm: docs/measured/roofline.md, the program
of `make roofline`.

Usage: .venv/bin/python benches/roofline.py [--seconds S] [--write-only] [-o docs/measured/roofline.md]

Needs matplotlib and phipsi with the extra `report`. It builds and runs the bench roofline.rs, which takes S seconds
for each of about 130 values, and stores its output in target/roofline.json, so that --write-only can rewrite the
page.
"""

import argparse
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from phipsi.report.plotting import FAINT, INK
from static import STYLE, finished

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "benches" / "peers"))

from compare import FEATURES, describe_machine

Row = dict[str, Any]

KEPT = ROOT / "target" / "roofline.json"
BUILD = ["cargo", "bench", "--locked", "--features", FEATURES, "--bench", "roofline", "--"]
INSTRUCTIONS = ROOT / "benches" / "instructions" / "expected.json"
#: Names of the algorithms in the instruction bench.
COUNTED_AS = {
    "forward dynamics, covariance": "forward_dynamics/covariance",
    "forward dynamics, auto": "forward_dynamics/auto",
    "forward dynamics, square-root": "forward_dynamics/square-root",
    "inverse dynamics": "inverse_dynamics",
    "mass matrix": "mass_matrix",
    "inverse of the mass matrix": "mass_matrix_inverse/covariance",
}
COLORS = ("#0072b2", "#56b4e9", "#d55e00", "#009e73", "#aa3377", "#b8860b")
MARKERS = "osD^v"
#: For one state, four columns share a register, if registers have four lanes.
BY_COLUMNS = ("mass matrix", "inverse of the mass matrix")
#: A limit that explains at least this fraction of the time is reported as the bound.
MOST = 0.5

TERMS = """\
- Operations are counted by running the generic code with a scalar type that counts (`phipsi::scalar::Traced`): a multiply-add is two operations, a
  division one, a sine with its cosine 52, as in the polynomials of phipsi. The baseline calls the standard library instead.
- A batch is 4096 states, computed in chunks of one state per lane. One state uses one lane per register; M and M^-1 use four.
- Peak: independent multiply-adds on twelve registers with the same instruction set, the fastest of many measurements. For one state it is the
  peak of one lane (except for M and M^-1); with AVX-512 it is that of AVX2, whose registers are as wide as those that one state uses. The baseline has no fused multiply-add; its peak is a multiplication and an addition,
  which the compiler may vectorize in pairs ([performance.md](../performance.md#values-for-the-next-body-stay-in-registers)).
- Bytes (kB): arguments, intermediate values and results of one state, and its part of the constants of the scene, which the states of a chunk share; each array
  is counted once. Bandwidth: values read, changed and written back, in L1 or L2, depending on the size of the chunk.
- The limit is the largest of four times that are lower bounds for any code with the same number of values per register: operations at the peak; divisions at the
  measured rate of independent divisions; bytes at the bandwidth; and for batches whose results do not fit in L2, the results at the bandwidth of main memory.
  If the largest is less than half of the measured time, none of these bounds it: the remaining time is spent on dependent operations and on instructions that are not arithmetic.
"""
MACHINE = (
    "arm",
    "numbers a register",
    "peak, Gflop/s",
    "dependent multiply-add, ns",
    "a division, ns",
    "L1, GB/s",
    "L2, GB/s",
    "beyond, GB/s",
)
CASES = ("algorithm", "arm", "flop", "kB", "ns per state", "Gflop/s", "of peak", "largest limit", "of time", "bound by")
COUNTED = ("algorithm", "arm", "instructions a call", "instructions an operation", "instructions a cycle")
COUNTS = """\
Results for the chain of 7, for which `make instructions` has counted the same calls (with few states, whereas 256 are timed here; for `auto` the
work differs slightly). Operations are those counted above, with a multiply-add as one and a sine with its cosine as one; the other
instructions move values between registers and memory, or are branches. Current processors start at most four to six instructions per cycle.
"""


def measured(seconds: float) -> Row:
    command = [*BUILD, "measure", str(seconds)]
    print(f"$ {shlex.join(command)}", file=sys.stderr, flush=True)
    machine = describe_machine(os.getloadavg()[0])
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    machine["load_at_end"] = round(os.getloadavg()[0], 2)
    found: Row = json.loads(done.stdout)
    return found | {"machine": machine, "caches": caches(), "command": f"benches/roofline.py --seconds {seconds:g}"}


def caches() -> list[int]:
    """Bytes of L1 (data) and L2, if the system reports them; otherwise typical values."""
    sizes = {1: 32 << 10, 2: 1 << 20}
    for entry in sorted(Path("/sys/devices/system/cpu/cpu0/cache").glob("index*")):
        level, kind, size = ((entry / name).read_text().strip() for name in ("level", "type", "size"))
        if kind != "Instruction" and int(level) in sizes:
            sizes[int(level)] = int(size.removesuffix("K")) << 10
    return [sizes[1], sizes[2]]


def roof(arms: Sequence[Row], name: str, states: int) -> Row:
    """Instruction set of the peak: with AVX-512, one state uses registers that are no wider than those of AVX2."""
    wanted = "avx2" if name == "avx512" and states == 1 else name
    return next(arm for arm in arms if arm["name"] == wanted)


def judged(found: Row) -> list[Row]:
    """Each case with its fraction of the peak and its bound."""
    rows = []
    for case in found["cases"]:
        arm, ns = roof(found["arms"], case["arm"], case["states"]), case["ns"]
        # Fraction of a register that is used.
        unused = arm["lanes"] if case["states"] == 1 and case["algorithm"] not in BY_COLUMNS else 1
        case["bytes"] = case["of_state"] + case["of_scene"] / case["lanes"]
        peak = arm["gflops"] / unused
        # At the rate of full registers, which one value per register cannot reach.
        divisions = case["operations"]["divisions"] * arm["division_ns"]
        level = "l1" if case["bytes"] * case["lanes"] <= found["caches"][0] else "l2"
        bandwidth = arm[f"{level}_update"] / unused
        limits = {
            "operations": case["flops"] / peak,
            "divisions": divisions,
            f"{level.upper()} bandwidth": case["bytes"] / bandwidth,
        }
        if case["results"] * case["states"] > found["caches"][1]:
            # A cache line is read before it is written.
            limits["results to memory"] = 2 * case["results"] / arm["far_update"]
        name = max(limits, key=lambda limit: limits[limit])
        rows.append(
            case
            | {
                "gflops": case["flops"] / ns,
                "share": case["flops"] / ns / peak,
                "limit": name,
                "of_limit": limits[name] / ns,
                "bound": name if limits[name] / ns >= MOST else "none of these",
            }
        )
    return rows


def instructions_a_cycle(found: Row) -> list[list[str]]:
    """Results of benches/instructions for the same cases: instructions, instructions per operation, and per cycle."""
    counted = json.loads(INSTRUCTIONS.read_text(encoding="utf-8")) if INSTRUCTIONS.exists() else {}
    rows = []
    for case in found["cases"]:
        key = f"{case['arm']}/{case['lanes']}/{COUNTED_AS[case['algorithm']]}"
        count = counted.get("instructions a call", {}).get(key)
        if count is None or case["scene"] != counted["scene"]:
            continue
        done = sum(case["operations"].values())
        a_cycle = count / (case["ns"] * case["lanes"] * found["clock_ghz"])
        rows.append([case["algorithm"], where(case), f"{count:,}", f"{count / done:.1f}", f"{a_cycle:.1f}"])
    return rows


def where(case: Row) -> str:
    return f"{case['arm']}, {'one state' if case['states'] == 1 else 'batch'}"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    rows = list(rows)
    numeric = [all(row[i][:1].isdigit() for row in rows) for i in range(len(head))]
    rule = "|".join("---:" if right else "---" for right in numeric)
    return "\n".join([f"| {' | '.join(head)} |", f"|{rule}|", *(f"| {' | '.join(row)} |" for row in rows)]) + "\n"


def page(found: Row, rows: Sequence[Row]) -> str:
    machine = found["machine"]
    text = ["# Roofline\n", "Operations and time of each algorithm, and the fraction of this machine's measured peak.\n"]
    bound = [row for row in rows if row["bound"] != "none of these"]
    best = max((row for row in rows if row["states"] > 1), key=lambda row: row["share"])
    text.append(
        f"In {len(rows) - len(bound)} of {len(rows)} cases neither operations, divisions nor memory account for half of the time. "
        f"The largest fraction of the peak in a batch is {best['share']:.0%}, of {best['algorithm']}, {best['scene']}, "
        f"{where(best)}.\n"
    )
    cycles = instructions_a_cycle(found)
    if cycles:
        each, a_cycle = ([float(row[i]) for row in cycles] for i in (3, 4))
        text.append(
            "On the chain of 7 much of the time is spent on instructions that are not arithmetic: there are "
            f"{min(each):.1f} to {max(each):.1f} instructions per operation, and {min(a_cycle):.1f} to {max(a_cycle):.1f} instructions per "
            "cycle (last table).\n"
        )
    text.append(
        f"{machine['processor']}, {machine['cores']} cores, one used; {machine['rustc']}; commit {machine['commit']}; "
        f"{machine['date']}. Load at the start {machine['load_at_start']}, at the end {machine['load_at_end']}. Written by `make roofline` "
        f"(`{found['command']}`).\n"
    )
    if max(machine["load_at_start"], machine["load_at_end"]) > 1.5:
        text.append("**Measured on a machine with other load: times are too long, fractions too small.**\n")
    text.append("![Gflop/s against operations per byte](roofline.png)\n")
    text += ["## Measured quantities\n", TERMS]
    text.append("## Machine\n")
    text.append(
        table(
            MACHINE,
            [
                (
                    arm["name"],
                    str(arm["lanes"]),
                    f"{arm['gflops']:.1f}",
                    f"{arm['dependent_ns']:.2f}",
                    f"{arm['division_ns']:.2f}",
                    f"{arm['l1_update']:.0f}",
                    f"{arm['l2_update']:.0f}",
                    f"{arm['far_update']:.0f}",
                )
                for arm in found["arms"]
            ],
        )
    )
    text.append(
        f"Clock {found['clock_ghz']:.2f} GHz, if an integer multiplication takes three cycles. L1 {found['caches'][0] >> 10} KiB, "
        f"L2 {found['caches'][1] >> 10} KiB.\n"
    )
    for scene in dict.fromkeys(row["scene"] for row in rows):
        text.append(f"## {scene[:1].upper()}{scene[1:]}\n")
        here = [row for row in rows if row["scene"] == scene]
        text.append(
            table(
                CASES,
                [
                    (
                        row["algorithm"],
                        where(row),
                        f"{row['flops']:,.0f}",
                        f"{row['bytes'] / 1e3:.1f}",
                        f"{row['ns']:,.0f}",
                        f"{row['gflops']:.1f}",
                        f"{row['share']:.0%}",
                        row["limit"],
                        f"{row['of_limit']:.0%}",
                        row["bound"],
                    )
                    for row in here
                ],
            )
        )
    if cycles:
        text.append("## Instructions\n")
        text += [COUNTS, table(COUNTED, cycles)]
    return "\n".join(text)


def draw(found: Row, rows: Sequence[Row]) -> bytes:
    """Two panels on the widest instruction set: one state, and batches."""
    arms = found["arms"]
    widest = arms[-1]
    algorithms = list(dict.fromkeys(row["algorithm"] for row in rows))
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.2, 4.3), layout="constrained")
        panels = figure.subplots(1, 2, sharey=True, sharex=True)
        chosen = [
            ("one state", roof(arms, widest["name"], 1), [r for r in rows if r["arm"] == widest["name"] and r["states"] == 1]),
            ("batches", widest, [r for r in rows if r["arm"] == widest["name"] and r["states"] > 1]),
        ]
        for axes, (title, arm, here) in zip(panels, chosen, strict=True):
            roofs(axes, arm, [row["flops"] / row["bytes"] for row in rows])
            for row in here:
                axes.plot(
                    row["flops"] / row["bytes"],
                    row["gflops"],
                    MARKERS[scenes.index(row["scene"]) % len(MARKERS)],
                    color=COLORS[algorithms.index(row["algorithm"]) % len(COLORS)],
                    markersize=5.5,
                    markeredgecolor="white",
                    markeredgewidth=0.5,
                )
            axes.set_title(f"{title}, {widest['name']}", loc="left", fontsize=9)
            axes.set_xlabel("operations a byte")
        panels[0].set_ylabel("Gflop/s")
        handles = [
            *(Line2D([], [], marker="s", ls="", color=COLORS[i % len(COLORS)], label=name) for i, name in enumerate(algorithms)),
            *(Line2D([], [], marker=MARKERS[i % len(MARKERS)], ls="", color="#555b61", label=name) for i, name in enumerate(scenes)),
        ]
        figure.legend(handles=handles, loc="outside right center", frameon=False)
        return finished(figure)


def roofs(axes: Axes, arm: Row, intensities: Sequence[float]) -> None:
    """Peak of a full register, of one lane, of dependent operations; and the slopes of L1 and L2."""
    low, high = min(intensities) / 2.5, max(intensities) * 7.0
    axes.set(xscale="log", yscale="log", xlim=(low, high))
    axes.xaxis.set_major_locator(FixedLocator([0.25, 0.5, 1, 2, 4, 8, 16]))
    axes.yaxis.set_major_locator(FixedLocator([1, 2, 5, 10, 20, 50, 100]))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.grid(True, which="major", color=FAINT, linewidth=0.5)
    axes.set_axisbelow(True)
    width = arm["lanes"]
    lines = {
        **({f"peak, {width} lanes per register": arm["gflops"]} if width > 1 else {}),
        "peak, one lane per register": arm["gflops"] / width,
        "one after another, waiting": 2.0 / arm["dependent_ns"],
    }
    for name, height in lines.items():
        axes.plot((low, high), (height, height), color=INK, linewidth=0.9, ls="-" if "peak" in name else ":")
        axes.annotate(name, (high, height), xytext=(-3, 2), textcoords="offset points", ha="right", fontsize=7, color=INK)
    for level, style in (("l1", "--"), ("l2", "-.")):
        bandwidth = arm[f"{level}_update"]
        end = min(high, arm["gflops"] / bandwidth)
        if end > low:
            axes.plot((low, end), (low * bandwidth, end * bandwidth), color=INK, linewidth=0.9, ls=style)
            axes.annotate(
                f"{level.upper()}", (low, low * bandwidth), xytext=(3, 6), textcoords="offset points", fontsize=7, color=INK
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=0.3, help="for each value; default: %(default)s")
    parser.add_argument("--write-only", action="store_true", help="rewrite the page without measurements")
    parser.add_argument(
        "-o", "--output", type=Path, default=ROOT / "docs" / "measured" / "roofline.md", help="default: %(default)s; the plot is in the same folder"
    )
    options = parser.parse_args()
    if not options.write_only:
        KEPT.parent.mkdir(exist_ok=True)
        KEPT.write_text(json.dumps(measured(options.seconds), indent=1) + "\n", encoding="utf-8")
    found = json.loads(KEPT.read_text(encoding="utf-8"))
    rows = judged(found)
    options.output.write_text(page(found, rows), encoding="utf-8")
    options.output.with_suffix(".png").write_bytes(draw(found, rows))
    print(f"written: {options.output}")


if __name__ == "__main__":
    main()
