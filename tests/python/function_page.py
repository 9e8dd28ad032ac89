"""The page docs/reference/functions.md, from the table of functions. `python function_page.py PAGE` writes it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from phipsi._functions import TABLE

HEAD = """# Table of functions

Written by `python tests/python/function_page.py docs/reference/functions.md` from the table in `src/algorithm.rs`, which the evaluator, the argument checks and the code generators read.

Shapes are those of one state; leading axes broadcast. nq is the number of coordinates, nv the number of degrees of freedom. Functions with code are those of `phipsi.compile`, `to_c`, `to_rust` and `to_cuda`;
functions of a link take its name too. Derivatives with respect to q are in its tangent space.

| function | arguments | results of one state | derivative of | code | |
|---|---|---|---|---|---|
"""


def page() -> str:
    """The page."""
    rows = [row for row in TABLE.values() if not row["name"].endswith("_watched")]
    return HEAD + "".join(map(_line, rows))


def _line(row: dict[str, Any]) -> str:
    names = [*row["arguments"], *(["link"] if row["of_link"] else [])]
    results = ", ".join(f"{name} ({_axes(axes)})" if axes else name for name, axes in row["results"].items())
    source = f"`{row['derivative_of']}`" if row["derivative_of"] else ""
    return f"| `{row['name']}` | {', '.join(names)} | {results} | {source} | {'yes' if row['few'] else ''} | {row['summary']}. |\n"


def _axes(axes: tuple[str | int, ...]) -> str:
    return ", ".join(map(str, axes))


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
