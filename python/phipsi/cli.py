"""The command `phipsi`: info, view, simulate, ik, identify, codegen, report, check, bench, completion. Needs the extra: pip install "phipsi[report]"."""

from __future__ import annotations

import sys
from importlib.util import find_spec

#: What the extra brings.
EXTRA = ("click", "rich", "plotly", "jinja2")


def main() -> None:
    """Runs the command line."""
    missing = [name for name in EXTRA if find_spec(name) is None]
    if missing:
        print(f'phipsi: found no {", ".join(missing)}; install with: pip install "phipsi[report]"', file=sys.stderr)
        raise SystemExit(2)
    from .report import codegen, completion, identify, ik, info, simulate, view_robot  # noqa: F401  # register their commands
    from .report.commands import group

    group(prog_name="phipsi")


if __name__ == "__main__":
    main()
