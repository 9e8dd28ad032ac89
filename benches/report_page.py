"""docs/measured/benchmarks.md from the measurements of report.py. Ratios are the peer's time relative to phipsi's: above
1 phipsi is faster.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import report_plots
from compare import BATCH, INTO_GIVEN
from kinematics_page import with_kinematics

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
- The results are those of one machine on one day. Ratios differ between machines; the minimum and maximum show the variation on this one.
- On a shared host, other load does not slow down both programs equally, so that ratios vary even with interleaved timing. The results are
  medians; the ratio of the shortest times is closest to that on an idle machine.
- In the comparison with Pinocchio in C++, phipsi is called by `scene.evaluate`, which checks the lengths of all arguments, NaN and
  infinity in arguments and results, quaternions and pivots. Pinocchio checks the lengths.
- Times from Python include the call, the checks, and the allocation of the result; for Drake and MuJoCo also setting the state.
- `mj_step` and `mujoco.rollout` compute a step with more kinematics than accelerations need, as do `mj_forward` and `mj_inverse`. MuJoCo fuses
  fixed links, like phipsi; contacts, limits and other constraints are disabled.
- Pinocchio fills the upper triangle of the mass matrix and of its inverse, also in derivatives; phipsi fills both triangles. The factorization of the mass matrix is not compared.
- A loop over Pinocchio is a Python loop that stores each result; `pin.abaInParallel` is its own batch function, available for two algorithms.
- Calls of Drake and dynibo from C++ and Rust are faster than from Python, as are those of phipsi.
- The models have no shapes and no damping; mimic joints are independent. Gravity is 9.80665 m/s^2 in all calls from Python, because that of dynibo is fixed.
- Caches are warm; 256 states (batches: 4096, for derivatives 256) are drawn before the timing and used in turn.
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
        f"phipsi is slower than a peer in {sum(map(lost, counted))} of {len(counted)} comparisons. From Python the comparison uses the default form"
        f" (`auto`), on the same number of threads as the peer, and the ratio of medians. In Rust it uses the covariance form with the instruction set `{arm}`; there and"
        f" for simulation the ratio is the median of the ratios within a pass.\n\n{losses_table(counted)}\n### Other forms, and AVX2\n\n"
        f"There are {len(further)} further comparisons in Rust; phipsi is slower in {sum(map(lost, further))} of them."
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
        f"Of {measured} results with a target (issue 5: {', '.join(AIMED_AT)} in Rust, here with the instruction set `{arm}`; batches from Python on every model)"
        f" these {len(rows)} miss it; in Rust with minimum and maximum over the passes:\n\n{table(head, rows)}\n{threads_text(python)}"
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
        return "Two threads were not measured, because there is one core.\n"
    return (
        f"For batches from Python (all models and calls), two threads are {min(gains):.2f} to {max(gains):.2f} times as fast as one;"
        " the target is near 2.\n"
    )


# Tables


def compared_text(rows: Sequence[Row]) -> str:
    head = ("operation", "model", "phipsi, ns per state", "Pinocchio, ns", "by", "ratio", "of the shortest")
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
    "steps": "One core, ns per step and state",
    "rollouts": "Two cores, ns per step and state of a rollout of 200 steps",
    "one": "One core, UR5, one state, ns per step, one torque and one step per call from Python",
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
        f"`{mppi['command']}`: {median} ({low} to {high}) thousand states per second, including its cost function and the motion of the arm;"
        f" the target, {aim / 1e3:.0f} thousand, is {'reached' if rate['median'] >= aim else 'missed'}.\n\n"
        f"Of {len(aimed)} ratios with a target (issues 6 and 32) these miss it:\n\n{table(head, short)}"
    )


def machine_text(compared: Row, python: Row) -> str:
    known = compared["machine"] | {"python": python["machine"]["python"]}
    known |= {name: number for name, number in python["machine"]["versions"].items() if name != "pin"}
    return table(("", ""), ((name, str(value) or "none") for name, value in known.items()))


def write(
    path: Path, ran: Row, compared: Row, python: Row, motion: Row, alone: Sequence[Row], auto_states: str, kinematics: Row
) -> None:
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
        f"Bursts of phipsi and of each algorithm of Pinocchio alternate, in {compared['passes']} passes over all cases, about"
        f" {1e3 * compared['seconds']:g} ms each. The ratio is that within a pass: median, minimum and maximum; the ratio of the shortest times follows. {command(commands['compare'])}"
    )
    refused = [(row["model"], row["library"], row["reason"]) for row in python["refused"]]
    warning = "**A test with few repetitions (`--quick`): the results on this page are not valid.**\n\n" if ran["quick"] else ""
    sections = [
        (
            "# Benchmarks",
            f"{warning}This page is generated by `make bench` (`benches/report.py`) from measurements. Ratios are the time of the peer relative to that of phipsi: above 1"
            f" phipsi is faster. Times are medians over the passes of one run in which all programs"
            f" are interleaved, with minimum and maximum.\n\n{machine_text(compared, python)}",
        ),
        ("## Comparisons in which a peer is faster", losses_text(every, arm)),
        ("## Missed targets", aims_text(rows, called, arm)),
        ("## Limitations of the measurements", LIMITS),
        (
            "## One state, compared with Pinocchio in C++",
            f"phipsi in the covariance form. {in_turns}\n{pictures.get('one-state', '')}\n{compared_text(one)}\n"
            f"### One state, other forms\n\n{compared_text(other_one)}",
        ),
        (
            "## Batches on one core, compared with Pinocchio in C++",
            f"Time per state in batches of 4096, covariance form, with the instruction set `{arm}`. Pinocchio has no batches on one core, so its time is that for one state."
            f" {in_turns}\n{pictures.get('batches', '')}\n{compared_text(batches)}\n"
            f"### Batches, other forms, and AVX2\n\n{compared_text(other_batches)}",
        ),
        (
            "## From Python, one state per call",
            f"ns per call, and ratio to phipsi's default form. {command(commands['python'])}\n"
            f"{pictures.get('python', '')}\n{python_text(calls)}",
        ),
        (
            "## From Python, batches of 4096",
            f"ns per state, and ratio to phipsi's default form on the same number of threads. {command(commands['python'])}\n"
            f"{pictures.get('python-batches', '')}\n{python_text(arrays)}",
        ),
        (
            "## Form auto by kind of state",
            f"Time from Python, relative to that of the covariance form. {command(commands['auto'])}\n{auto_states}",
        ),
        (
            "## Motion",
            f"A batch of {motion['states']} arms, {motion['model']}, steps of {motion['dt']:g} s, called from Python; ratios are taken within a pass."
            f" MuJoCo's steps are a loop in C over one state, its rollouts are `mujoco.rollout`; the faster of two functions counts. One step of every"
            f" integrator, and all rows of the rollouts, agree within {max(motion['agreement'].values()):.1e}. MuJoCo has no Rosenbrock method; they are compared"
            f" with its RK4. With springs, its implicitfast evaluates damping at the end of a step and springs at its start; phipsi evaluates both at the end."
            f" {command(commands['motion'])}\n{motion_text(motion)}",
        ),
        (
            "## Not timed",
            "Libraries that refuse a model, with their messages, or whose result differs from that of phipsi.\n\n"
            + table(("model", "library", "reason"), refused),
        ),
        ("## Growth with the number of bodies", f"{command(commands['alone'])}\n{pictures.get('growth', '')}"),
        ("## All other groups", f"{command(commands['alone'])}\n{alone_text(alone)}"),
    ]
    page = "\n".join(f"{heading}\n\n{text}" for heading, text in sections)
    path.write_text(with_kinematics(page, kinematics), encoding="utf-8")
