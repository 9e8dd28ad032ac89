"""The section on kinematics of docs/measured/benchmarks.md, from the measurements of kinematics.py. Unlike the others it
can be measured alone, so that it has its own machine; the counts at the top of the page include it.
"""

import re
from statistics import median
from typing import Any

from readme import cells, table

HEADING = "## Kinematics from Python"
#: Its name in the counts, and the section before which it is inserted.
WHERE, NEXT = "Python, kinematics", "## From Python, batches of 4096"
COUNTS = "## Comparisons in which a peer is faster"
#: Head of the table of lost comparisons.
LOST = ("from", "operation", "model", "phipsi, ns", "the peer", "ns", "the peer is faster by")

Row = dict[str, Any]


def ratios(row: Row) -> list[float]:
    """Pinocchio's time relative to phipsi's, by turns."""
    return [peer / ours for ours, peer in zip(row["ours"], row["peer"], strict=True)]


def lost(measured: Row) -> list[Row]:
    return sorted((row for row in measured["rows"] if median(ratios(row)) < 1.0), key=lambda row: median(ratios(row)))


def section(measured: Row) -> str:
    """The section, with its heading."""
    rows, machine = measured["rows"], measured["machine"]
    robots = list(dict.fromkeys(row["robot"] for row in rows))
    quantities = {row["quantity"]: row["peer_call"] for row in rows}
    found = {(row["quantity"], row["robot"]): row for row in rows}

    def ratio(row: Row) -> str:
        of = ratios(row)
        return f"{median(of):.2f} ({min(of):.2f} to {max(of):.2f})"

    def times(row: Row) -> str:
        return f"{median(row['ours']):.0f}, {median(row['peer']):.0f}"

    def body(cell: Any, *more: dict[str, str]) -> list[list[str]]:
        return [[what, *(names[what] for names in more), *(cell(found[what, robot]) for robot in robots)] for what in quantities]

    worst = [f"{what} {min(median(ratios(found[what, robot])) for robot in robots):.2f}" for what in quantities]
    versions = machine["versions"]
    parts = [
        HEADING,
        "**A test with few repetitions (`--quick`): the results of this section are not valid.**" if measured["quick"] else "",
        f"One state per call, {', '.join(robots)} of example-robot-data, and the link with the most joints between it and the base. Both programs agree to 1e-10."
        " Each call of phipsi checks its arguments and returns a new array; Pinocchio's are the wheel `pin`, and results of its"
        " `forwardKinematics`, `framesForwardKinematics` and `updateFramePlacement` remain in its `data`, without arrays.",
        f"phipsi is slower in {len(lost(measured))} of {len(rows)} comparisons. Worst ratios: {', '.join(worst)}.",
        f"{machine['date']}, {machine['processor']}, instructions `{machine['instructions']}`, load {machine['load_at_start']}, commit {machine['commit']}, Python {machine['python']},"
        f" Pinocchio {versions['pin']}, NumPy {versions['numpy']}. Made by\n\n```\n{measured['command']}\n```",
        "Pinocchio's time relative to phipsi's, median of the ratios within a turn, with minimum and maximum:",
        table(["quantity", *robots], body(ratio)),
        "ns per call, medians, phipsi and Pinocchio:",
        table(["quantity", "Pinocchio's calls", *robots], body(times, quantities)),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def counted(text: str, measured: Row) -> str:
    """The section on lost comparisons, up to its first heading, with those of kinematics."""
    of_others = [row for row in cells(text)[2:] if row[0] != WHERE]
    counts = [*of_others, [WHERE, str(len(measured["rows"])), str(len(lost(measured)))]]
    after = text.split(table(["from", "comparisons", "phipsi is slower in"], [["x"] * 3]).splitlines()[0], 1)[1].split("\n\n", 1)[1]
    others = [] if after.startswith("None.") else [row for row in cells(after)[2:] if row[0] != WHERE]
    losses = [
        [WHERE, row["quantity"], row["robot"], f"{median(row['ours']):.0f}", f"Pinocchio, {row['peer_call']}", f"{median(row['peer']):.0f}", f"{1 / median(ratios(row)):.2f}"]
        for row in lost(measured)
    ]
    total, slower = (sum(int(row[k]) for row in counts) for k in (1, 2))
    text = re.sub(r"slower than a peer in \d+ of \d+ comparisons", f"slower than a peer in {slower} of {total} comparisons", text)
    both = sorted([*others, *losses], key=lambda row: -float(row[-1]))
    first = text.split("\n|", 1)[0].rstrip()
    return "\n\n".join([first, table(["from", "comparisons", "phipsi is slower in"], counts), table(LOST, both) if both else "None.", ""])


def with_kinematics(page: str, measured: Row) -> str:
    """The page with these measurements in place of those of kinematics that it has, if any."""
    before, rest = page.split(COUNTS, 1)
    counts, rest = rest.split("\n### ", 1)
    page = f"{before}{COUNTS}{counted(counts, measured)}\n### {rest}"
    page = re.sub(f"{HEADING}\n.*?(?=^## )", "", page, flags=re.DOTALL | re.MULTILINE)
    return page.replace(NEXT, f"{section(measured)}\n{NEXT}", 1)
