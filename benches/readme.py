"""Writes the figures of README.md between their markers, from the generated pages docs/benchmarks.md and docs/numerics.md.

Usage: python benches/readme.py. `make bench` and `make numerics` run it; tests/python/test_readme.py fails where README.md is not up to date.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
END = "<!-- to here -->"

Row = dict[str, str]

MODELS = {"chain_7": "chain of 7", "g1": "g1", "talos": "talos"}
PARTS = {"One state, against Pinocchio in C++": "one state a call", "Batches on one core, against Pinocchio in C++": "batches"}
METHODS = {
    "square-root form": '`form="square-root"`',
    "covariance form": '`form="covariance"`',
    "dense LDLT (faer)": "dense LDLT of M (faer)",
    "Pinocchio, local": "Pinocchio, local convention",
    "dynibo": "dynibo",
    "Drake": "Drake",
    "MuJoCo": "MuJoCo",
}


def page(name: str) -> str:
    return (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")


def section(text: str, heading: str) -> str:
    """What stands under a heading."""
    return re.split(r"^#+ ", text.split(f"# {heading}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]


def cells(text: str) -> list[list[str]]:
    """The first table of a text: its head, a line of dashes, its rows."""
    lines = re.search(r"(^\|.*\n)+", text, flags=re.MULTILINE)
    if lines is None:
        raise ValueError(f"no table in {text[:80]!r}")
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in lines[0].splitlines()]


def rows(text: str) -> list[Row]:
    """The same, a dict a row."""
    head, _, *body = cells(text)
    return [dict(zip(head, row, strict=True)) for row in body]


def table(head: Sequence[str], body: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *body))


def median(cell: str) -> float:
    """The first number of a cell like 291 (290 to 469)."""
    return float(cell.split()[0])


def times(row: Row) -> str:
    """Microseconds of both, and the ratio."""
    ours, theirs = (f"{median(row[name]) / 1e3:.3g}" for name in ("phipsi, ns a state", "Pinocchio, ns"))
    return f"{ours} / {theirs}, **{median(row['ratio']):.2g}**"


def benchmarks() -> str:
    text = page("benchmarks")
    machine = dict(cells(section(text, "Benchmarks"))[2:])
    parts = []
    for heading, name in PARTS.items():
        found = rows(section(text, heading))
        shown = {(row["operation"], row["model"]): times(row) for row in found}
        operations = dict.fromkeys(row["operation"] for row in found)
        body = ([what, *(shown[what, model] for model in MODELS)] for what in operations)
        parts.append(table([name, *MODELS.values()], body))
    slower = re.search(r"Of \d+ comparisons phipsi is the slower one in \d+", section(text, "Where we lose"))
    short = re.search(r"Of (\d+) figures with an aim.* these (\d+) fall short", section(text, "Short of the aims"))
    if slower is None or short is None:
        raise ValueError("docs/benchmarks.md does not say where phipsi is slower, or which aims are missed")
    parts.append(
        f"{machine['processor']}, arm `{machine['arm']}`, Pinocchio {machine['pinocchio']}, commit {machine['commit']}. {slower[0]};"
        f" of {short[1]} aims {short[2]} are missed."
    )
    return "\n\n".join(parts)


def numerics() -> str:
    found = rows(section(page("numerics"), "heavy-tip"))
    sensitivity = [max(row["state"], row["parameters"], key=float) for row in found]
    body = [
        ["sensitivity: the effect of one unit in the last place of the problem's numbers", *sensitivity],
        *([name, *(row[method] for row in found)] for method, name in METHODS.items()),
    ]
    return table(["last link, kg", *(row["value"] for row in found)], body)


FIGURES: dict[str, Callable[[], str]] = {"benchmarks": benchmarks, "numerics": numerics}


def written(text: str) -> str:
    """The text with the figures of today's pages between its markers."""
    for name, figures in FIGURES.items():
        begin = f"<!-- {name}: written by benches/readme.py -->"
        before, after = text.split(begin, 1)
        text = f"{before}{begin}\n{figures()}\n{END}{after.split(END, 1)[1]}"
    return text


if __name__ == "__main__":
    README.write_text(written(README.read_text(encoding="utf-8")), encoding="utf-8")
    print(f"written: {README}")
