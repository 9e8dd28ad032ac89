"""Run a study that compares phipsi with other programs; used by `make numerics` and `make motion`.

    python benches/study.py stability [-o DIR] [--markdown FILE] [--quick] [--seed N]
    python benches/study.py motion [-o DIR] [--markdown FILE] [--quick]

It uses the installed version of phipsi with the extras report and motion, and compares it with the programs in the
same environment; .venv-peers has all of them.
"""

import argparse
from pathlib import Path

from phipsi.report.progress import reporter
from rich.console import Console
from studies import motion, stability

STUDIES = {"stability": stability, "motion": motion}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder for the page, its numbers and its plots")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="the page as Markdown, plots beside it")
    parser.add_argument("--quick", action="store_true", help="fewer states, steps and turns")
    parser.add_argument("--seed", type=int, default=0, help="of the states of the stability study; default: %(default)s")
    options = parser.parse_args()
    if options.output is None and options.markdown is None:
        parser.error("-o DIR, --markdown FILE or both are needed")
    study = STUDIES[options.study]
    seed = {"seed": options.seed} if options.study == "stability" else {}
    with reporter(Console(stderr=True)) as says:
        found = study.collect(says, quick=options.quick, **seed)
        for page in study.write(found, options.output, options.markdown, says):
            print(page)


if __name__ == "__main__":
    main()
