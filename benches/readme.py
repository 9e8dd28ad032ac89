"""Write the results in README.md between their markers, from the generated pages docs/measured/benchmarks.md and
docs/measured/numerics.md; and PACKAGE.md, the version for package indices.

Usage: python benches/readme.py. `make bench` and `make numerics` run it; tests/python/test_docs.py fails if the files
are not up to date.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
README, PACKAGE = ROOT / "README.md", ROOT / "PACKAGE.md"
END = "<!-- to here -->"
#: Build instructions in a clone, and their replacement on a package index.
CLONE = "<!-- in a clone -->"
INSTALL = """```sh
pip install "phipsi[view,report]"
phipsi report robot.urdf -o report      # then open report/index.html; --quick takes a few seconds
```"""

Row = dict[str, str]

MODELS = {"ur5": "ur5", "g1": "g1", "talos": "talos"}
PARTS = {"One state, compared with Pinocchio in C++": "one state", "Batches on one core, compared with Pinocchio in C++": "batches"}
#: Operations in the table, in this order.
OPERATIONS = ("Forward dynamics", "Inverse dynamics", "Mass matrix", "Derivatives of inverse dynamics", "Derivatives of forward dynamics")
#: Operations that are called from Python, both libraries, with Pinocchio's functions; and kinematics, which has no batches there.
CALLED = {"Forward dynamics": "pin.aba", "Inverse dynamics": "pin.rnea", "Mass matrix": "pin.crba"}
KINEMATICS = ("Pose of one link", "Poses of all links", "Jacobian of one link")
METHODS = {
    "auto": "phipsi, `form=\"auto\"` (default)",
    "square-root form": "phipsi, `form=\"square-root\"`",
    "covariance form": "phipsi, `form=\"covariance\"`",
    "Pinocchio, local": "Pinocchio",
    "Drake": "Drake",
    "MuJoCo": "MuJoCo",
}
#: Masses of the last link in the table, kg.
MASSES = ("1", "1000", "1e6", "1e9", "1e12")


def page(name: str) -> str:
    return (ROOT / "docs" / "measured" / f"{name}.md").read_text(encoding="utf-8")


def section(text: str, heading: str) -> str:
    """Text under a heading."""
    return re.split(r"^#+ ", text.split(f"# {heading}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]


def cells(text: str) -> list[list[str]]:
    """First table of a text: its head, a line of dashes, its rows."""
    lines = re.search(r"(^\|.*\n)+", text, flags=re.MULTILINE)
    if lines is None:
        raise ValueError(f"no table in {text[:80]!r}")
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in lines[0].splitlines()]


def rows(text: str) -> list[Row]:
    """The same, one dict per row."""
    head, _, *body = cells(text)
    return [dict(zip(head, row, strict=True)) for row in body]


def table(head: Sequence[str], body: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *body))


def compact(markdown: str) -> str:
    """A table without the spaces beside its bars."""
    return re.sub(r" ?\| ?", "|", markdown)


def median(cell: str) -> float:
    """First number of a cell such as 291 (290 to 469)."""
    return float(cell.split()[0])


def benchmarks() -> str:
    text = page("benchmarks")
    machine = dict(cells(section(text, "Benchmarks"))[2:])
    shown: dict[tuple[str, str, str], str] = {}
    for heading, part in PARTS.items():
        for row in rows(section(text, heading)):
            shown[row["operation"], part, row["model"]] = f"{median(row['ratio']):.2g}"
    head = ["", *(f"{name}, {part}" for part in PARTS.values() for name in MODELS.values())]
    body = [[what, *(shown[what, part, model] for part in PARTS.values() for model in MODELS)] for what in OPERATIONS]
    parts = (("From Python, one state per call", ""), ("From Python, batches of 4096", "loop over "))
    body += [[f"{what}, from Python", *(one for heading, loop in parts for one in called(text, heading, what, f"{loop}{call}"))] for what, call in CALLED.items()]
    measured = section(text, "Kinematics from Python")
    kinematics = {row["quantity"]: row for row in rows(measured)}
    body += [[f"{what}, from Python", *(f"{median(kinematics[what][model]):.2g}" for model in MODELS), *[""] * len(MODELS)] for what in KINEMATICS]
    [of_kinematics] = re.findall(r"Z, (.+?), load", measured)
    return f"{compact(table(head, body))}\n\n{machine['processor']}, instructions `{machine['arm']}`, Pinocchio {machine['pinocchio']}; poses and Jacobians: {of_kinematics}."


def called(text: str, heading: str, what: str, call: str) -> list[str]:
    """Ratios of a call of Pinocchio from Python, in a part of the page."""
    part = section(text.split(f"## {heading}\n", 1)[1], what)
    [row] = [row for row in rows(part) if (row["library"], row["call"]) == ("Pinocchio", call)]
    return [f"{float(row[model].rsplit(': ', 1)[1]):.2g}" for model in MODELS]


def numerics() -> str:
    found = [row for row in rows(section(page("numerics"), "heavy-tip")) if row["value"] in MASSES]
    body = ([name, *(row[method] for row in found)] for method, name in METHODS.items())
    return table(["last link, kg", *(row["value"] for row in found)], body)


FIGURES: dict[str, Callable[[], str]] = {"benchmarks": benchmarks, "numerics": numerics}


def written(text: str) -> str:
    """The text with the results of the current pages between its markers."""
    for name, figures in FIGURES.items():
        begin = f"<!-- {name}: written by benches/readme.py -->"
        before, after = text.split(begin, 1)
        text = f"{before}{begin}\n{figures()}\n{END}{after.split(END, 1)[1]}"
    return text


def packaged(text: str) -> str:
    """README.md for a package index, which has no other files: with installation from there, without pictures, and with
    file names instead of links to files.
    """
    parts = re.compile(f"{CLONE}.*?{END}\n", re.DOTALL)
    text = parts.sub("", parts.sub(f"{INSTALL}\n", text, count=1))
    text = re.sub(r"<!--.*?-->\n", "", text)
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)\n+", "", text)
    text = re.sub(r"\[([^\]]*)\]\((?!https?://)[^)]*\)", r"\1", text)
    return re.sub(r"\n{3,}", "\n\n", text)


if __name__ == "__main__":
    text = written(README.read_text(encoding="utf-8"))
    README.write_text(text, encoding="utf-8")
    PACKAGE.write_text(packaged(text), encoding="utf-8")
    print(f"written: {README}, {PACKAGE}")
