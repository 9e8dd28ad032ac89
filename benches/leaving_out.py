"""What each switch saves, in instructions: writes the table of docs/leaving-out.md (`make leaving-out`).

Builds examples/leaving_out.rs, runs it under callgrind on the arm `baseline` with everything left out and with everything but one thing, and takes
the difference of 110 and 10 calls: building the scene is not in it. valgrind must be there (Debian: apt-get install valgrind).
"""

import concurrent.futures
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).with_name("instructions")))

from callgrind import ROOT, a_call, output  # noqa: E402

PAGE = ROOT / "docs" / "leaving-out.md"
BEGIN, END = "<!-- written by benches/leaving_out.py -->", "<!-- to here -->"
CALLS = (10, 110)

#: switch, what is left out, rates and gravity of the call, and the kind of scene where it is not the usual one.
SWITCHES = (
    ("fixed_joints", "fixed joints: two links are one body; off, the child is a body without rows", "moving", "weight", ""),
    ("base_links", "links that cannot move; off, one body", "moving", "weight", ""),
    ("renamed_axes", "rotation matrices of joints that turn about an axis of the parent's frame, or slide along one", "moving", "weight", ""),
    ("tilted_axes", "rotation matrices of the other joints that turn or slide, where axes are tilted", "moving", "weight", "tilted"),
    ("zero_velocity", "velocities and what they cause, where all rates are zero", "rest", "weight", ""),
    ("zero_gravity", "the rest of the bias, where there is no gravity either", "rest", "weightless", ""),
)


def counted(case: tuple[str, str, str, str]) -> int | None:
    """Instructions of one call with this switch off."""
    switch, rates, gravity, kind = case
    program = [str(ROOT / "target/release/examples/leaving_out"), switch, rates, gravity]
    few, many = ([*program, str(calls), *([kind] if kind else [])] for calls in CALLS)
    return a_call(few, many, CALLS[1] - CALLS[0], "baseline")


def table() -> str:
    cases = [(switch, *call) for switch, _, *call in SWITCHES]
    everything = [("none", *call) for _, *call in cases]
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        off, on = pool.map(counted, cases), pool.map(counted, everything)
        rows = [
            f"| `{switch}` | {what} | {rates}, {gravity} | {with_it} | {without} | {100 * (1 - with_it / without):.1f} % |"
            for (switch, what, rates, gravity, _), without, with_it in zip(SWITCHES, list(off), list(on), strict=True)
        ]
    head = ["| switch | what is left out | rates, gravity | instructions, on | off | saved |", "|---|---|---|---|---|---|"]
    commit = output(["git", "rev-parse", "--short", "HEAD"]).strip()
    return "\n".join([BEGIN, f"Counted at commit {commit}.", "", *head, *rows, END])


def main() -> None:
    features = "urdf,parallel,dense,stochastic"
    output(["cargo", "build", "--release", "--locked", "--features", features, "--example", "leaving_out"])
    text = PAGE.read_text(encoding="utf-8")
    begin, end = text.index(BEGIN), text.index(END) + len(END)
    PAGE.write_text(text[:begin] + table() + text[end:], encoding="utf-8")
    print(f"written: {PAGE}")


if __name__ == "__main__":
    main()
