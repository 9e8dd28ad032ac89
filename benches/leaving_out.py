"""Instructions that each simplification saves: writes the table of docs/leaving-out.md (`make leaving-out`).

Builds examples/leaving_out.rs, runs it under callgrind on the arm `baseline` with all simplifications and with all but one, and takes the
difference of 110 and 10 calls, so that building the scene is not counted. Needs valgrind (Debian: apt-get install valgrind).
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

#: Switch, skipped computation, velocities and gravity of the call, and the kind of scene if it is not the usual one.
SWITCHES = (
    ("fixed_joints", "fixed joints: two links form one body; if off, the child is a body without rows", "moving", "weight", ""),
    ("base_links", "links fixed to the base; if off, they form one body", "moving", "weight", ""),
    ("renamed_axes", "rotation matrices of joints that rotate about or translate along an axis of the parent frame", "moving", "weight", ""),
    ("tilted_axes", "rotation matrices of revolute and prismatic joints with tilted axes", "moving", "weight", "tilted"),
    ("zero_velocity", "velocity terms, if all joint velocities are zero", "rest", "weight", ""),
    ("zero_gravity", "the remaining bias, if gravity is zero too", "rest", "weightless", ""),
)


def counted(case: tuple[str, str, str, str]) -> int | None:
    """Instructions per call without this simplification."""
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
    head = ["| switch | skipped computation | velocities, gravity | instructions, on | off | saved |", "|---|---|---|---|---|---|"]
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
