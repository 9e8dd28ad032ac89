"""Robustness of simulation: completed runs, errors, energy and run time, compared with MuJoCo, as a Markdown page.

Usage: python benches/motion_robustness.py [--quick] [--only NAME ...] [--method METHOD] [--markdown FILE]

Needs the packages of the tests (mujoco, pin with its example-robot-data, scipy): run it with .venv, after make test.
One thread, one process. The table at the top of the page compares each target of issue 45 with the result; `--quick`
runs a few robots and steps in less than a minute, and `--only` some sections.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import time
import traceback
import warnings
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path

import phipsi
from phipsi.report import machine
from studies.robustness import energy, finishing, friction, stability_map, times
from studies.robustness.common import Finding, Options, Section, progress, table

SECTIONS = {
    "robots": finishing.real_robots,
    "laws": finishing.pd_laws,
    "friction": friction.silent_errors,
    "energy": energy.passive,
    "held": friction.held_arms,
    "spin": energy.spinning,
    "times": times.error_against_time,
    "accuracy": times.error_controlled,
    "cost": times.cost,
    "map": stability_map.maps,
}
LIMITS = """## Limitations

- One thread on one machine. Only ratios of times within one run are meaningful.
- MuJoCo runs with its default solver, `solref` and `solimp`. Its joint limits and dry friction are soft constraints by design.
- A run that finishes is not necessarily accurate; the sections on friction, time and the map measure errors.
- Contacts and closed loops are not covered.
"""


def commit() -> str:
    """The commit of the working tree; "unknown" outside a repository."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        return subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def head(options: argparse.Namespace, load: float) -> str:
    known = machine.describe()
    trial = "\n\n**A trial with few robots and steps (`--quick`).**" if options.quick else ""
    return (
        "# Robustness of simulation\n\n"
        f"{known['cpu']}, {known['cores']} cores, one used, load at the start {load:.2f}; phipsi {phipsi.__version__} at commit {commit()}; Python {known['python']}, NumPy {known['numpy']}, "
        f"SciPy {version('scipy')}, MuJoCo {version('mujoco')}, example-robot-data of pin {version('pin')}; {datetime.now(timezone.utc).isoformat(timespec='seconds')}. "
        f"Made by `python {shlex.join(['benches/motion_robustness.py', *sys.argv[1:]])}`. The default is `method=\"{options.method}\"`. "
        f"Methods are described in [motion.md](../motion.md).{trial}"
    )


def overview(findings: list[Finding]) -> str:
    marks = {True: "yes", False: "**no**", None: "not measured"}
    return table(["quantity", "found", "aim", "met"], [[finding.quantity, finding.found, finding.aim, marks[finding.met]] for finding in findings])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few robots, steps and turns")
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=list(SECTIONS), metavar="NAME", help=f"sections: {', '.join(SECTIONS)}")
    parser.add_argument("--method", default="auto", help="the method measured as the default; default: %(default)s")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the page to this file")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    phipsi.set_num_threads(1)
    load, options = os.getloadavg()[0], Options(given.method, given.quick)
    sections, failed = [], False
    for name in given.only:
        begin = time.perf_counter()
        try:
            sections.append(SECTIONS[name](options))
        except Exception as error:  # the other sections still count
            traceback.print_exc()
            failed = True
            sections.append(Section(f"Section `{name}`", f"Not measured: {error}", [Finding(f"section `{name}`", "failed", "", False)]))
        progress(f"{name}: {time.perf_counter() - begin:.1f} s")
    findings = [finding for section in sections for finding in section.findings]
    page = "\n\n".join([head(given, load), overview(findings), *(f"## {section.title}\n\n{section.text}" for section in sections), LIMITS.strip()])
    if given.markdown is None:
        print(page)
    else:
        given.markdown.write_text(f"{page}\n", encoding="utf-8")
    sys.exit(failed)


if __name__ == "__main__":
    main()
