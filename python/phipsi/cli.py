"""The command `phipsi` with the subcommands info, view, simulate, ik, identify, codegen, report, check, bench and
completion. It needs the extra: pip install "phipsi[report]".
"""

from __future__ import annotations

import sys
from importlib.util import find_spec

#: Packages of the extra.
EXTRA = ("click", "rich", "plotly", "jinja2")


def main() -> None:
    """Run the command line."""
    missing = [name for name in EXTRA if find_spec(name) is None]
    if missing:
        print(f'phipsi: found no {", ".join(missing)}; install with: pip install "phipsi[report]"', file=sys.stderr)
        raise SystemExit(2)
    from .report import codegen, completion, identify, ik, info, simulate, view_robot  # noqa: F401  # the imports register the commands
    from .report.commands import group

    group(prog_name="phipsi")


if __name__ == "__main__":
    main()
