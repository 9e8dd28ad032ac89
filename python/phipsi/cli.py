"""The command `phipsi` with the subcommands info, view, simulate, ik, identify, codegen, compare, report, check, bench
and completion. Pages need the extra `report`, and `view` needs the extra `view`.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec

#: Packages that all commands need.
REQUIRED = ("click", "rich")
#: Exit code of a command that Ctrl-C ends, as in shells.
INTERRUPTED = 130


def main() -> None:
    """Run the command line."""
    missing = [name for name in REQUIRED if find_spec(name) is None]
    if missing:
        print(f"phipsi: found no {', '.join(missing)}; install with: pip install {' '.join(missing)}", file=sys.stderr)
        raise SystemExit(2)
    try:
        from .report import codegen, compare, completion, identify, ik, info, simulate, view_robot  # noqa: F401  # the imports register the commands
        from .report.commands import group
    except KeyboardInterrupt:
        print("phipsi: interrupted.", file=sys.stderr)
        raise SystemExit(INTERRUPTED) from None
    group(prog_name="phipsi")


if __name__ == "__main__":
    main()
