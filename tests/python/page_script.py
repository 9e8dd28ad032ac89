"""The Python code of a page, its hidden checks, and the output that the page shows.

A page has code in blocks ```` ```python ````. A block ```` ```text ```` directly below such a block is what the code prints. Checks that a reader does
not need are in comments ``<!-- checks ... -->``, code for the picture of the page in one comment ``<!-- picture ... -->``. After a block of text,
``<!-- numbers within 20 % -->`` sets the relative tolerance of its numbers, which is 1 % otherwise.

Usage: ``python tests/python/page_script.py docs/how-to/lqr.md ...`` runs pages and writes their output into them.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

CHECKS, PICTURE, END = "<!-- checks", "<!-- picture", "-->"
#: Printed after each block.
MARK = "\x1e"
NUMBER = re.compile(r"[-+]?(?:\d+\.\d*|\.\d+|\d+)(?:[eE][-+]?\d+)?")
TOLERANCE = re.compile(r"\s*<!-- numbers within (\d+) % -->")


class Block(NamedTuple):
    """A block of Python code; numbers of lines from zero."""

    end: int
    """The line of its closing fence."""
    text: tuple[int, int] | None
    """First line of the text that it prints and the line of the closing fence, if the page shows it."""
    within: float
    """Relative tolerance of the numbers of this text."""


def parts(lines: list[str]) -> tuple[list[str], list[str], list[Block]]:
    """The script with the line numbers of the page, the lines of the picture, and the blocks."""
    code, picture, blocks = [], list[str](), list[Block]()
    kind = ""
    for number, line in enumerate(lines):
        shown = ""
        if kind == "":
            kind = "python" if line == "```python" else "fence" if line.startswith("```") else line if line in (CHECKS, PICTURE) else ""
        elif kind in (CHECKS, PICTURE):
            if line == END:
                kind = ""
            elif kind == CHECKS:
                shown = line
            else:
                picture.append(line)
        elif line.startswith("```"):
            if kind == "python":
                blocks.append(_block(lines, number))
                # Not in the processes that a page starts, which import it.
                shown = f'__name__ == "__main__" and print("{MARK.encode("unicode_escape").decode()}")'
            kind = ""
        elif kind == "python":
            shown = line
        code.append(shown)
    return code, picture, blocks


def _block(lines: list[str], end: int) -> Block:
    after = end + 1
    while after < len(lines) and not lines[after].strip():
        after += 1
    if lines[after : after + 1] != ["```text"]:
        return Block(end, None, 0.01)
    last = next(number for number in range(after + 1, len(lines)) if lines[number].startswith("```"))
    within = TOLERANCE.match("\n".join(lines[last + 1 : last + 3]))
    return Block(end, (after + 1, last), 0.01 if within is None else float(within[1]) / 100)


def script(text: str) -> str:
    """The Python code of a page with its checks, or nothing if there is none."""
    code, _, blocks = parts(text.splitlines())
    return "\n".join(code) if blocks else ""


def printed(text: str, output: str) -> list[tuple[Block, str]]:
    """The blocks of a page, each with what it printed."""
    _, _, blocks = parts(text.splitlines())
    outputs = [one.strip("\n") for one in output.split(MARK)]
    return list(zip(blocks, outputs, strict=False))


def differences(text: str, output: str, every: bool) -> list[str]:
    """Lines of output that differ from those on the page; with every, output that the page does not show is a difference too."""
    lines = text.splitlines()
    found = []
    for block, out in printed(text, output):
        if block.text is None:
            found += [f"line {block.end + 1}: the page does not show the output {out[:200]!r}"] if every and out else []
            continue
        first, last = block.text
        shown, came = "\n".join(lines[first:last]).strip("\n"), out
        if not same(shown, came, block.within):
            found.append(f"line {first + 1}: the page shows\n{shown}\nfound\n{came}")
    return found


def same(shown: str, came: str, within: float) -> bool:
    """Whether two texts are equal apart from spaces and from differences of numbers within a tolerance or a unit of their last digit."""
    words = [re.sub(r"\s+", "", NUMBER.sub("#", text)) for text in (shown, came)]
    pairs = list(zip(NUMBER.findall(shown), NUMBER.findall(came), strict=False))
    return words[0] == words[1] and all(abs(float(a) - float(b)) <= within * abs(float(a)) + max(unit(a), unit(b)) for a, b in pairs)


def unit(number: str) -> float:
    """One unit in the last digit of a printed number; nothing for an integer, which must be equal."""
    mantissa, _, exponent = number.lower().partition("e")
    digits = len(mantissa.partition(".")[2])
    return 10.0 ** (int(exponent or 0) - digits) * 1.01 if "." in mantissa or exponent else 0.0


def run(text: str, folder: Path, name: str, strict: bool = True) -> subprocess.CompletedProcess[str]:
    """Run the script of a page in a process of its own."""
    file = folder / f"{name.replace('-', '_')}_page.py"
    file.write_text(text, encoding="utf-8")
    # Idle BLAS threads would take processor time from other threads.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"}
    # Warnings of Dask in its own threads are ignored.
    command = [sys.executable, *(["-W", "error"] if strict and "distributed" not in text else []), str(file)]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, encoding="utf-8", timeout=300, check=False)


def written(text: str, output: str) -> str:
    """A page with the output of its blocks."""
    lines = text.splitlines()
    for block, out in reversed(printed(text, output)):
        if block.text is not None and out:
            lines[block.text[0] : block.text[1]] = out.splitlines()
        elif block.text is None and out:
            lines[block.end + 1 : block.end + 1] = ["", "```text", *out.splitlines(), "```"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    for path in map(Path, sys.argv[1:]):
        page = path.read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as directory:
            done = run(script(page), Path(directory), path.stem)
        if done.returncode:
            sys.exit(f"{path}: {done.stderr[-3000:]}")
        path.write_text(written(page, done.stdout), encoding="utf-8")
        print(f"written: {path}")
