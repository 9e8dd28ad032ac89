"""Long chains: time of form "auto", and the error of each form compared with 34 digits; prints a part of
docs/measured/auto-states.md.

Usage: python benches/long_chains.py [--most N]

The reference is that of tests/python (mpmath, O(N), 4 ms per link). auto_states.py writes this part into its page.
"""

import argparse
import statistics
import sys
import time
from pathlib import Path

import numpy as np

import phipsi

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "python"))

import oracle_recursive
from test_long_chains import chain_of, state_of

SIZES = (100, 1_000, 10_000, 100_000)
FORMS = ("auto", "covariance", "square-root")
HEAD = """## Long chains

Chains of n links of about 1 kg and 0.3 m on revolute joints about axes of any direction, at random configurations with joint velocities up to 0.1 rad/s. Times of one state from Python, medians. Errors are relative to the
largest acceleration, compared with a reference of 34 digits, in units of sqrt(n) eps; *double-double* is form `square-root` with `tolerance=1e-15`. *Estimate* is `info.error` of `auto` in units of n eps, *bound* the criterion that it meets."""


def seconds(call: object, least: float = 0.2) -> float:
    """Median time per call."""
    times: list[float] = []
    while len(times) < 5 or (sum(times) < least and len(times) < 200):
        begin = time.perf_counter()
        call()  # type: ignore[operator]
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def row(links: int) -> str:
    tree = chain_of(("revolute",), links, seed=1)
    scene = tree.scene()
    state = state_of(scene, 2)
    times = {form: seconds(lambda form=form: scene.forward_dynamics(*state, form=form)) for form in FORMS}
    exact = oracle_recursive.forward_dynamics(tree, *state)
    largest = max(abs(exact))
    unit = float(np.finfo(float).eps) * np.sqrt(links)
    found = {form: scene.forward_dynamics(*state, form=form) for form in FORMS}
    found["double-double"] = scene.forward_dynamics(*state, form="square-root", tolerance=1e-15)
    errors = [float(max(abs(oracle_recursive.exact(qdd) - exact)) / largest) / unit for qdd in found.values()]
    _, info = scene.forward_dynamics(*state, return_info=True)
    estimate = info.error / float(largest) / unit / np.sqrt(links)
    ratios = [times[form] / times["covariance"] for form in ("auto", "square-root")]
    cells = [f"{links:,}", f"{1e6 * times['covariance']:,.0f}", *(f"{x:.2f}" for x in ratios), *(f"{x:.2f}" for x in errors)]
    return f"| {' | '.join(cells)} | {estimate:.2f} | {info.form}, {info.bound} |"


def section(most: int = SIZES[-1]) -> str:
    """The part of the page."""
    columns = ("n", "covariance, us", "time of auto", "of square-root", "error of auto", "covariance", "square-root", "double-double", "estimate", "form of auto, bound")
    head = [f"| {' | '.join(columns)} |", "| " + " | ".join(["---:"] * 9 + ["---"]) + " |"]
    return "\n".join([HEAD, "", *head, *(row(links) for links in SIZES if links <= most)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--most", type=int, default=SIZES[-1], metavar="N", help="largest number of links; default: %(default)s")
    print(f"phipsi {phipsi.__version__}\n\n{section(parser.parse_args().most)}")


if __name__ == "__main__":
    main()
