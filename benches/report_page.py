"""docs/benchmarks.md from the measurements of report.py. Ratios are the peer's time relative to phipsi's: above 1
phipsi
is faster.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import report_plots
from compare import BATCH, INTO_GIVEN

Row = dict[str, Any]

THREADS = ", 2 threads"
TITLES = {
    "forward_dynamics": "Forward dynamics",
    "inverse_dynamics": "Inverse dynamics",
    "mass_matrix": "Mass matrix",
    "mass_matrix_inverse": "Inverse of the mass matrix",
    "inverse_dynamics_derivatives": "Derivatives of inverse dynamics",
    "forward_dynamics_derivatives": "Derivatives of forward dynamics",
}
#: Target ratios to Pinocchio in C++ on these models: by group, and the instruction set of the group.
AIMED_AT = ("chain_7", "g1", "talos")
AIMS = {
    "forward_dynamics": 4.0,
    "forward_dynamics/square-root": 1.5,
    "inverse_dynamics": 4.0,
    "mass_matrix": 2.0,
    "mass_matrix_inverse": 3.0,
    "inverse_dynamics_derivatives": 3.0,
    "forward_dynamics_derivatives": 3.0,
    "forward_dynamics_batch": 25.0,
    "forward_dynamics_batch/avx2": 14.0,
    "inverse_dynamics_batch": 20.0,
    "mass_matrix_batch": 20.0,
    "mass_matrix_inverse_batch": 20.0,
    "inverse_dynamics_derivatives_batch": 10.0,
    "forward_dynamics_derivatives_batch": 10.0,
}
#: Targets from Python, on one core, relative to a loop over Pinocchio; and for one state per call relative to
#: pin.aba, chain of 7.
AIM_PYTHON_BATCH, AIM_PYTHON_CALL = 30.0, 2.0

LIMITS = """\
- One machine, on one day. Two machines need not agree on a ratio; minimum and maximum say how steady this one was.
- Who else uses a shared host's core does not slow both sides alike, so that ratios move with it even where they are taken in turns. What is
  counted is the median; the ratio of the shortest times comes nearest to a machine of one's own, where both sides had such a moment.
- Against Pinocchio in C++ phipsi is called as from any Rust program, by `scene.evaluate`: it looks at the lengths of all arguments, for NaN and
  infinity in arguments and results, at quaternions and pivots. Pinocchio looks at lengths.
- From Python everything is in: the call, the checks, the new array for the result; for Drake and MuJoCo also what sets the state.
- `mj_step` and `mujoco.rollout` do a step, with more kinematics than accelerations need; `mj_forward` and `mj_inverse` too. MuJoCo fuses
  fixed links, as phipsi does; contacts, limits and other constraints are off.
- Pinocchio fills the upper triangle of the mass matrix and of its inverse, with derivatives too; phipsi fills both. Factoring the mass matrix is not compared.
- A loop over Pinocchio is a Python loop that stores each result; `pin.abaInParallel` is its own batch, which it has for two algorithms.
- Drake's and dynibo's calls from C++ and Rust are faster than from Python; so is phipsi's.
- Models without shapes and damping; mimic joints are joints of their own. Gravity is 9.80665 m/s^2 in all calls from Python: dynibo has no other.
- Caches are warm, and 256 states (batches: 4096, of derivatives 256) are drawn beforehand and taken in turn.
"""


class Comparison(NamedTuple):
    """phipsi compared with a peer."""

    where: str
    operation: str
    model: str
    ours: float
    peer: str
    theirs: float
    ratio: float
    further: bool
    """Another form or instruction set than the default."""


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    body = [f"| {' | '.join(row)} |" for row in rows]
    if not body:
        return "None.\n"
    return "\n".join([f"| {' | '.join(head)} |", f"|{'---|' * len(head)}", *body]) + "\n"


def command(text: str) -> str:
    return f"Made by\n\n```\n{text}\n```\n"


def title(group: str) -> str:
    """Description, with form and instruction set if the group has them."""
    operation, *variant = group.split("/")
    return ", ".join([TITLES.get(operation.removesuffix(BATCH), operation), *variant])


def number(ns: float) -> str:
    return f"{ns:.0f}" if ns >= 100 else f"{ns:.3g}"


def spread(one: Row) -> str:
    if one["passes"] == 1:
        return number(one["median"])
    return f"{number(one['median'])} ({number(one['min'])} to {number(one['max'])})"


def times(one: Row, digits: int = 1) -> str:
    """Ratios: median, minimum and maximum."""
    median, low, high = (f"{one[name]:.{digits}f}" for name in ("median", "min", "max"))
    return f"{median} ({low} to {high})"


# Cases in which a peer is faster


def comparisons(compared: Sequence[Row], python: Sequence[Row], motion: Sequence[Row]) -> list[Comparison]:
    """Every pair: in Rust, covariance on the instruction set of the process, and all others marked; from Python, the
    default form on the same number of threads.
    """
    found = []
    for row in compared:
        operation, _, variant = row["group"].partition("/")
        where = "C++ and Rust" + (", batch" if operation.endswith(BATCH) else "") + (f", {variant}" if variant else "")
        ours, theirs = row["phipsi_ns"]["median"], row["pinocchio_ns"]["median"]
        peer = f"Pinocchio, {row['pinocchio_algorithm']}"
        ratio = row["ratio"]["median"]
        found.append(Comparison(where, operation, row["model"], ours, peer, theirs, ratio, bool(variant)))
    for row in python:
        if not row["library"].startswith("phipsi") and row["ratio"]:
            where = "Python, batch" if row["operation"].endswith(BATCH) else "Python"
            theirs, ratio = row["ns"]["median"], row["ratio"]
            peer = f"{row['library']}, {row['call']}"
            found.append(Comparison(where, row["operation"], row["model"], theirs / ratio, peer, theirs, ratio, False))
    for row in motion:
        what, peer = f"{row['call']}, {row['method']}, {row['form']}", f"{row['peer']}, {row['peer_call']}"
        ours, theirs, ratio = row["ns"]["median"], row["peer_ns"]["median"], row["ratio"]["median"]
        found.append(Comparison("Python, motion", what, row["model"], ours, peer, theirs, ratio, False))
    return found


def lost(one: Comparison) -> bool:
    return one.ratio < 1.0


def losses_table(chosen: Sequence[Comparison]) -> str:
    """Number of pairs of each kind, then those in which the peer is faster, in ascending order of the ratio."""
    kinds = {one.where: [other for other in chosen if other.where == one.where] for one in chosen}
    counts = [(where, str(len(all_of)), str(sum(map(lost, all_of)))) for where, all_of in kinds.items()]
    head = ("from", "operation", "model", "phipsi, ns", "the peer", "ns", "the peer is faster by")
    rows = [
        (
            one.where,
            title(one.operation),
            one.model,
            number(one.ours),
            one.peer,
            number(one.theirs),
            f"{1.0 / one.ratio:.2f}",
        )
        for one in sorted(filter(lost, chosen), key=lambda one: one.ratio)
    ]
    return f"{table(('from', 'comparisons', 'phipsi is slower in'), counts)}\n{table(head, rows)}"


def losses_text(every: Sequence[Comparison], arm: str) -> str:
    counted = [one for one in every if not one.further]
    further = [one for one in every if one.further]
    return (
        f"Of {len(counted)} comparisons phipsi is the slower one in {sum(map(lost, counted))}, the worst first. From Python it is the default form"
        f" (`auto`), on as many threads as the peer, and median beside median; in Rust it is the covariance form on the arm `{arm}`, and there, and"
        f" in motion, the ratio is the median of those within a pass.\n\n{losses_table(counted)}\n### Other forms, and AVX2\n\n"
        f"Not counted above: {len(further)} further comparisons in Rust, of which phipsi is the slower one in {sum(map(lost, further))}."
        f"\n\n{losses_table(further)}"
    )


def aim_of(group: str, arm: str) -> float | None:
    """If this is the widest instruction set of a machine, its batches have the target of that instruction set."""
    return AIMS.get(f"{group}/{arm}", AIMS.get(group))


def aims_text(compared: Sequence[Row], python: Sequence[Row], arm: str) -> str:
    """Measured targets that are not reached."""
    rows = []
    measured = 0

    def check(what: str, model: str, found: float, shown: str, best: float, aim: float) -> None:
        nonlocal measured
        measured += 1
        if found < aim:
            rows.append((what, model, shown, f"{best:.2f}", f"{aim:g}"))

    for row in compared:
        aim = aim_of(row["group"], arm)
        if aim and row["model"] in AIMED_AT:
            what = f"{title(row['group'])}, {'a state of a batch' if BATCH in row['group'] else 'one state'}, Rust"
            check(what, row["model"], row["ratio"]["median"], times(row["ratio"], 2), row["ratio_of_best"], aim)
    # The loop of a peer allocates its array, so calls with a given output are not compared.
    ours = [row for row in python if row["library"] == "phipsi" and not row["call"].endswith(INTO_GIVEN)]
    for row in python:
        single = row["call"] == "pin.aba" and row["model"] == "chain_7"
        if not single and not row["call"].startswith("loop over"):
            continue
        for mine in ours:
            if (mine["model"], mine["operation"]) == (row["model"], row["operation"]):
                what = f"{mine['call']}, {'one state' if single else 'batch, one core'}, from Python"
                aim = AIM_PYTHON_CALL if single else AIM_PYTHON_BATCH
                found, best = (row["ns"][which] / mine["ns"][which] for which in ("median", "min"))
                check(what, row["model"], found, f"{found:.2f}", best, aim)
    head = ("what", "model", "times faster than Pinocchio", "by the shortest times", "aim")
    return (
        f"Of {measured} figures with an aim (issue 5: {', '.join(AIMED_AT)} in Rust, here on the arm `{arm}`; batches from Python on every model)"
        f" these {len(rows)} fall short; in Rust with minimum and maximum over the passes:\n\n{table(head, rows)}\n{threads_text(python)}"
    )


def threads_text(python: Sequence[Row]) -> str:
    """Speedup of phipsi's batches by a second thread; the target is near 2."""
    by_call = {(row["library"], row["model"], row["operation"], row["call"]): row["ns"]["median"] for row in python}
    gains = [
        ns / by_call["phipsi" + THREADS, *key]
        for (library, *key), ns in by_call.items()
        if library == "phipsi" and ("phipsi" + THREADS, *key) in by_call
    ]
    if not gains:
        return "Two threads were not measured: there is one core.\n"
    return (
        f"Two threads are {min(gains):.2f} to {max(gains):.2f} times as fast as one on batches from Python (all models and calls);"
        " the aim is near 2.\n"
    )


# Tables


def compared_text(rows: Sequence[Row]) -> str:
    head = ("operation", "model", "phipsi, ns a state", "Pinocchio, ns", "by", "ratio", "of the shortest")
    cells = [
        (
            title(row["group"]),
            row["model"],
            spread(row["phipsi_ns"]),
            spread(row["pinocchio_ns"]),
            row["pinocchio_algorithm"],
            times(row["ratio"], 2),
            f"{row['ratio_of_best']:.2f}",
        )
        for row in rows
    ]
    return table(head, cells)


def python_text(rows: Sequence[Row]) -> str:
    """A table per operation: one row per call, one column per model."""
    parts = []
    for operation in dict.fromkeys(row["operation"] for row in rows):
        chosen = [row for row in rows if row["operation"] == operation]
        models = list(dict.fromkeys(row["model"] for row in chosen))
        calls = list(dict.fromkeys((row["library"], row["call"]) for row in chosen))
        by_place = {(row["library"], row["call"], row["model"]): row for row in chosen}
        cells = []
        for library, call in calls:
            line = [library, call]
            for model in models:
                row = by_place.get((library, call, model))
                ratio = f"{row['ratio']:.2f}" if row and row["ratio"] else "-"
                line.append(f"{spread(row['ns'])}: {ratio}" if row else "-")
            cells.append(line)
        parts.append(f"### {title(operation)}\n\n{table(('library', 'call', *models), cells)}")
    return "\n".join(parts)


def alone_text(rows: Sequence[Row]) -> str:
    def cells(row: Row) -> tuple[str, ...]:
        each = number(row["ns"] / row["elements"]) if row["elements"] else "-"
        return row["id"], f"{number(row['ns'])} ({number(row['low'])} to {number(row['high'])})", each

    return table(("criterion's id", "median, ns (95 % interval)", "ns an element"), map(cells, rows))


# Simulation

PARTS = {
    "steps": "One core, ns a step and state",
    "rollouts": "Two cores, ns a step and state of a rollout of 200 steps",
    "one": "One core, UR5, one state, ns a step, a torque and a step a call from Python",
}


def joints_of(row: Row) -> str:
    joints: str = row["joints"]
    return {"": "free", "springs": "springs, damping"}.get(joints, joints)


def motion_text(motion: Row) -> str:
    """Simulation steps: MPPI, missed targets, and one table per part."""

    def cells(row: Row) -> tuple[str, ...]:
        peer = row["peer"] if row["peer"] == "Pinocchio" else f"{row['peer']}, {row['integrator']}"
        ours = row["method"], row["form"], joints_of(row), row["call"], spread(row["ns"])
        return *ours, f"{peer}: {row['peer_call']}", spread(row["peer_ns"]), times(row["ratio"])

    head = ("method", "form", "joints", "call", "phipsi, ns", "beside", "ns", "times faster")
    parts = [motion_aims_text(motion)]
    for part, heading in PARTS.items():
        rows = [row for row in motion["pairs"] if row["part"] == part]
        parts.append(f"### {heading}\n\n{table(head, map(cells, rows))}")
    return "\n".join(parts)


def motion_aims_text(motion: Row) -> str:
    aimed = [row for row in motion["pairs"] if row["aim"]]
    short = [
        (row["call"], row["method"], row["form"], joints_of(row), times(row["ratio"]), f"{row['aim']:g}")
        for row in aimed
        if row["ratio"]["median"] < row["aim"]
    ]
    mppi = motion["mppi"]
    rate, aim = mppi["states_a_second"], mppi["aim"]
    low, median, high = (f"{rate[name] / 1e3:.0f}" for name in ("min", "median", "max"))
    head = ("call", "method", "form", "joints", "times faster than MuJoCo", "aim")
    return (
        f"`{mppi['command']}`: {median} ({low} to {high}) thousand states a second, its cost function and the arm's own motion in the time;"
        f" the aim, {aim / 1e3:.0f} thousand, is {'reached' if rate['median'] >= aim else 'missed'}.\n\n"
        f"Of {len(aimed)} ratios with an aim (issues 6 and 32) these fall short:\n\n{table(head, short)}"
    )


def machine_text(compared: Row, python: Row) -> str:
    known = compared["machine"] | {"python": python["machine"]["python"]}
    known |= {name: number for name, number in python["machine"]["versions"].items() if name != "pin"}
    return table(("", ""), ((name, str(value) or "none") for name, value in known.items()))


def write(path: Path, ran: Row, compared: Row, python: Row, motion: Row, alone: Sequence[Row], auto_states: str) -> None:
    """The page and its plots."""
    commands = ran["commands"]
    rows, called, arm = compared["rows"], python["rows"], compared["machine"]["arm"]
    one, batches, other_one, other_batches = (
        [row for row in rows if (BATCH in row["group"], "/" in row["group"]) == kind]
        for kind in ((False, False), (True, False), (False, True), (True, True))
    )
    calls, arrays = ([row for row in called if row["operation"].endswith(BATCH) == batch] for batch in (False, True))
    growth = [row for row in alone if row["group"] == "growth"]
    pictures = {}
    path.parent.mkdir(parents=True, exist_ok=True)
    for plot in report_plots.draw(one, batches, calls, arrays, growth):
        target = path.with_name(f"{path.stem}-{plot.name}.png")
        target.write_bytes(plot.png)
        pictures[plot.name] = f"![{plot.name.replace('-', ' ')}]({target.name})\n"
    every = comparisons(rows, called, motion["pairs"])
    in_turns = (
        f"A burst of phipsi's and one of each of Pinocchio's ways right after one another, {compared['passes']} times over all cases, about"
        f" {1e3 * compared['seconds']:g} ms each. The ratio is that within a pass: median, minimum and maximum; beside it that of the shortest times. {command(commands['compare'])}"
    )
    refused = [(row["model"], row["library"], row["reason"]) for row in python["refused"]]
    warning = "**A trial with few repeats (`--quick`): no figure on this page counts.**\n\n" if ran["quick"] else ""
    sections = [
        (
            "# Benchmarks",
            f"{warning}Generated by `make bench` (`benches/report.py`) from what it measured; nothing on this page is written by hand but these"
            f" words. Ratios are the peer's time over phipsi's: above 1 phipsi is faster. Times are medians over the passes of one run in which"
            f" all take turns, with minimum and maximum.\n\n{machine_text(compared, python)}",
        ),
        ("## Where we lose", losses_text(every, arm)),
        ("## Short of the aims", aims_text(rows, called, arm)),
        ("## What the figures do not show", LIMITS),
        (
            "## One state, against Pinocchio in C++",
            f"phipsi in the covariance form. {in_turns}\n{pictures.get('one-state', '')}\n{compared_text(one)}\n"
            f"### One state, other forms\n\n{compared_text(other_one)}",
        ),
        (
            "## Batches on one core, against Pinocchio in C++",
            f"Time a state of 4096, covariance form, on the arm `{arm}`; Pinocchio has no batches on one core, so it is its time for one state."
            f" {in_turns}\n{pictures.get('batches', '')}\n{compared_text(batches)}\n"
            f"### Batches, other forms, and AVX2\n\n{compared_text(other_batches)}",
        ),
        (
            "## From Python, one state a call",
            f"ns a call: ratio to phipsi's default form. {command(commands['python'])}\n"
            f"{pictures.get('python', '')}\n{python_text(calls)}",
        ),
        (
            "## From Python, batches of 4096",
            f"ns a state: ratio to phipsi's default form on as many threads. {command(commands['python'])}\n"
            f"{pictures.get('python-batches', '')}\n{python_text(arrays)}",
        ),
        (
            "## Form auto in the states that robots are in",
            f"From Python: its time over that of the covariance form. {command(commands['auto'])}\n{auto_states}",
        ),
        (
            "## Motion",
            f"A batch of {motion['states']} arms, {motion['model']}, steps of {motion['dt']:g} s, called from Python; ratios are taken within a pass."
            f" MuJoCo's steps are a loop in C over one state, its rollouts are `mujoco.rollout`; of two ways the faster one. One step of every"
            f" integrator, and all rows of the rollouts, agree within {max(motion['agreement'].values()):.1e}. MuJoCo has no Rosenbrock method: its RK4"
            f" stands beside them. With springs its implicitfast takes damping at the step's end and springs at its start; phipsi takes both at its end."
            f" {command(commands['motion'])}\n{motion_text(motion)}",
        ),
        (
            "## Not timed",
            "A library that refuses a model, in its own words; or whose answer differs from phipsi's.\n\n"
            + table(("model", "library", "reason"), refused),
        ),
        ("## Growth with the number of bodies", f"{command(commands['alone'])}\n{pictures.get('growth', '')}"),
        ("## All other groups", f"{command(commands['alone'])}\n{alone_text(alone)}"),
    ]
    path.write_text("\n".join(f"{heading}\n\n{text}" for heading, text in sections), encoding="utf-8")
