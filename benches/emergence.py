"""docs/emergence.png: error of the mass matrix from samples against run time, for the bundled arm, as on the page of
`phipsi report`.

    python benches/emergence.py [-o docs/emergence.png] [--quick]

It uses the installed version of phipsi with the extra report, needs matplotlib, and takes a minute.
"""

import argparse
from pathlib import Path

import phipsi
from phipsi.report.progress import reporter
from phipsi.report.robot import Report
from phipsi.report.sections.emergence import collect
from phipsi.report.sections.emergence_plots import error_against_time
from rich.console import Console

import static


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/emergence.png"), metavar="FILE")
    parser.add_argument("--quick", action="store_true", help="fewer samples")
    options = parser.parse_args()
    scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    with reporter(Console(stderr=True)) as says:
        found = collect(Report(options.quick, "PUMA 560", "", scene), says)
    options.output.write_bytes(static.draw(error_against_time(found)))
    print(options.output)


if __name__ == "__main__":
    main()
