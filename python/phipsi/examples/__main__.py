"""`python -m phipsi.examples`: list the examples, run one, or write its picture."""

from __future__ import annotations

import ast
import contextlib
import io
import re
import runpy
import sys
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from ..errors import ArgumentError

USAGE = """python -m phipsi.examples                          list the examples
python -m phipsi.examples NAME                     run one; most of them write a page of the motion into this folder
python -m phipsi.examples NAME --picture FILE      write the motion as a picture: FILE.webp, FILE.png or FILE.html
python -m phipsi.examples NAME --source            print the script"""
#: Exit code of wrong arguments.
WRONG = 2


def scripts() -> dict[str, Path]:
    """The scripts by name."""
    return {path.stem: path for path in sorted(Path(__file__).parent.glob("[!_]*.py"))}


def summary(path: Path) -> str:
    """The first sentence of a script, and the packages that it needs."""
    text = " ".join((ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n\n")[0].split())
    sentence, _, rest = text.partition(": ")
    needs = re.search(r" \(needs [^)]*\)", rest)
    return sentence.rstrip(".") + (needs[0] if needs else "")


def picture(path: Path, file: str) -> str:
    """Run a script and write its motion."""
    # An imported script writes no page.
    with contextlib.redirect_stdout(io.StringIO()):
        found: dict[str, Any] = runpy.run_path(str(path), run_name="__picture__")
    if "scene" not in found or not {"path", "q"} & set(found):
        raise SystemExit(f"{path.stem}: this example has no motion that can be drawn; run it without --picture")
    motion = {} if "path" in found else {"t": found["t"]}
    return str(found["scene"].show(found["path" if "path" in found else "q"], **motion, to=file))


def main(arguments: list[str]) -> int | str:
    """Run the command; the result is the exit code or a message of an error."""
    known = scripts()
    if not arguments or arguments[0] in ("-h", "--help", "list"):
        print(USAGE, end="\n\n")
        width = max(map(len, known))
        print("\n".join(f"{name:{width}}  {summary(path)}" for name, path in known.items()))
        return 0
    name, *rest = arguments
    if name not in known:
        near = get_close_matches(name, known, n=1)
        print(f"{name}: found no such example{f'; did you mean {near[0]}?' if near else ''}\nThe examples: {', '.join(known)}", file=sys.stderr)
        return WRONG
    try:
        if rest[:1] == ["--source"]:
            print(known[name].read_text(encoding="utf-8"), end="")
        elif rest[:1] == ["--picture"]:
            print("written:", picture(known[name], rest[1] if len(rest) > 1 else f"{name}.webp"))
        elif rest and "argparse" not in known[name].read_text(encoding="utf-8"):
            print(f"{name}: found {rest[0]!r}; expected no argument, --picture FILE or --source", file=sys.stderr)
            return WRONG
        else:
            sys.argv = [str(known[name]), *rest]
            runpy.run_path(str(known[name]), run_name="__main__")
    except (ArgumentError, FileNotFoundError, ImportError) as error:
        # A picture of an unknown kind, a robot or a package that is not installed.
        print(f"{name}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
