"""Print the time of form "auto" relative to "covariance" by kind of state, as Markdown.

Usage: python benches/auto_states.py [--quick] [--seed N] [--markdown FILE] [NAME|ROBOT.urdf ...]

Default: ur5, panda, anymal, g1 and talos of example-robot-data if this interpreter has it, otherwise the bundled arm.
It measures the installed version of phipsi, including older ones: the kinds of states are those of this repository,
and everything else uses public names.
"""

import argparse
import importlib
import sys
import types
from pathlib import Path

import phipsi

FOLDER = Path(__file__).resolve().parents[1] / "python" / "phipsi" / "report"

HEAD = """# Cost of form `auto` by kind of state

Time of `form="auto"` relative to `form="covariance"`. Written by `make auto-states`; times differ between machines, ratios by a few percent.
[numerics.md](numerics.md#error-estimates-and-fallbacks) describes the error estimate of `auto`. The page does not show states with a loss of precision, which `auto` recomputes in a more accurate form.
"""


def markdown(auto_cost: types.ModuleType, costs: dict) -> str:
    """Both tables as Markdown, with the times of the worst case and the definitions of the kinds."""
    parts = [f"phipsi {phipsi.__version__}: {auto_cost.TITLE}"]
    for batch, title in auto_cost.SIZES.items():
        robots, rows = auto_cost.table(costs, batch)
        lines = [[title, *robots], ["---"] + ["---:"] * len(robots), *rows]
        parts.append("\n".join(f"| {' | '.join(line)} |" for line in lines))
    every = [(row, base, robot) for (base, robot), rows in costs.items() for row in rows]
    row, base, robot = max(every, key=lambda one: one[0].ratio)
    size = f"a batch of {row.batch}" if row.batch > 1 else "one state a call"
    parts.append(
        f"Worst: {robot}, {base}, {row.kind}, {size}: auto {row.auto:.0f} ns per state, covariance {row.covariance:.0f}."
    )
    parts.append("\n".join(f"- {kind}: {meaning}" for kind, meaning in auto_cost.kinds.MEANING.items()))
    return "\n\n".join(parts)


def main() -> None:
    # Imported under another name, because the installed package may be older and lack this module.
    package = types.ModuleType("states_of_this_repository")
    package.__path__ = [str(FOLDER)]
    sys.modules[package.__name__] = package
    auto_cost = importlib.import_module(f"{package.__name__}.auto_cost")

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", metavar="ROBOT")
    parser.add_argument("--quick", action="store_true", help="fewer turns")
    parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write a page instead, like make auto-states")
    options = parser.parse_args()
    known = auto_cost.example_robots()
    sources = {Path(robot).stem: known.get(robot, Path(robot)) for robot in options.robots}
    sources = sources or known or {"PUMA 560 (bundled)": phipsi.BUNDLED_ARM}
    table = markdown(auto_cost, auto_cost.of_robots(sources, quick=options.quick, seed=options.seed))
    if options.markdown is None:
        print(table)
    else:
        import long_chains  # needs mpmath, as the tests do

        options.markdown.write_text(f"{HEAD}\n{table}\n\n{long_chains.section()}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
