"""Measure everything and write docs/measured/benchmarks.md with its plots: the program of `make bench`.

Usage: .venv-peers/bin/python benches/report.py [--passes N] [--quick] [--write-only]

It runs in the environment of the peers, in which `make bench` has installed the wheel of phipsi (with the extra
`report`) and matplotlib, because python_peers.py needs all of them in one process. The order is: auto_states.py;
criterion's groups without peers; compare.py, which interleaves phipsi in Rust and Pinocchio in C++; python_peers.py;
kinematics.py; motion_peers.py. The results are stored in target/peers/run.json, so that --write-only can rewrite the page. --quick
uses few repetitions, as a test.
"""

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NoReturn

import tomllib

ROOT = Path(__file__).resolve().parents[1]
PEERS = ROOT / "target" / "peers"
sys.path.insert(0, str(ROOT / "benches" / "peers"))

from compare import BATCH, FEATURES, OPERATIONS

import report_page

#: Criterion has these groups too, but does not interleave them with the peers.
COMPARED = [operation + suffix for operation in OPERATIONS for suffix in ("", BATCH)]
#: Output of benches/auto_states.py.
AUTO_STATES = "auto_states.md"
#: Options of criterion for quick runs; and for all others, a median of a hundred samples.
QUICK = ("--warm-up-time", "0.1", "--measurement-time", "0.2", "--sample-size", "10")
SHORT = ("--warm-up-time", "1", "--measurement-time", "2")


def fail(message: str) -> NoReturn:
    sys.exit(f"report.py: {message}")


def run(command: list[str], *, capture: bool = False) -> str:
    """Output of the command, if it is captured."""
    print(f"$ {shlex.join(command)}", file=sys.stderr, flush=True)
    try:
        done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE if capture else None, text=True, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        fail(str(error))
    return done.stdout or ""


def cargo_bench() -> list[str]:
    """Names of the benches, because the tests of the library do not accept criterion's options."""
    benches = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))["bench"]
    return ["cargo", "bench", "--features", FEATURES, *(part for one in benches for part in ("--bench", one["name"]))]


def groups_of(bench: list[str]) -> list[str]:
    """Criterion's groups, as listed by the benches."""
    lines = run([*bench, "--", "--list"], capture=True).splitlines()
    found = [line.removesuffix(": benchmark").split("/")[0] for line in lines if line.endswith(": benchmark")]
    return list(dict.fromkeys(found))


def only(groups: list[str]) -> str:
    """A filter for these groups."""
    return f"^({'|'.join(map(re.escape, groups))})/"


def measure(passes: int | None, quick: bool) -> dict[str, Any]:
    """Run everything; return the commands and the start time."""
    began = time.time() - 1.0
    bench = cargo_bench()
    others = [group for group in groups_of(bench) if group not in COMPARED]
    alone = [*bench, "--", only(["growth"] if quick else others), *(QUICK if quick else SHORT)]
    few = ["--passes", "3", "--seconds", "0.001"] if quick else []
    wanted = ["--passes", str(passes)] if passes else few[:2]
    compare = [sys.executable, "benches/peers/compare.py", *wanted, *few[2:]]
    python = [sys.executable, "benches/peers/python_peers.py", *few]
    little = [*few, "--states", "512"] if quick else []
    motion = [sys.executable, "benches/peers/motion_peers.py", *little]
    # Before the others load the machine.
    auto = [sys.executable, "benches/auto_states.py", *(["--quick"] if quick else [])]
    kinematics = [sys.executable, "benches/kinematics.py", *(["--quick"] if quick else [])]
    commands = {"auto": auto, "alone": alone, "compare": compare, "python": python, "kinematics": kinematics, "motion": motion}
    PEERS.mkdir(parents=True, exist_ok=True)
    for name, command in commands.items():
        printed = run(command, capture=name == "auto")
        if name == "auto":
            print(printed)
            (PEERS / AUTO_STATES).write_text(printed, encoding="utf-8")
    # As a user would enter it.
    written = {name: shlex.join(command).replace(f"{ROOT}/", "") for name, command in commands.items()}
    return {"began": began, "quick": quick, "commands": written}


def criterion(folder: Path, since: float) -> list[dict[str, Any]]:
    """Every estimate written after `since`: full id, median in ns, and number of elements per iteration."""
    found = []
    for benchmark in folder.glob("**/new/benchmark.json"):
        estimates = benchmark.with_name("estimates.json")
        if not estimates.exists() or estimates.stat().st_mtime < since:
            continue
        about = json.loads(benchmark.read_text())
        median = json.loads(estimates.read_text())["median"]
        interval = median["confidence_interval"]
        found.append(
            {
                "group": about["group_id"],
                "id": about["full_id"],
                "elements": (about["throughput"] or {}).get("Elements"),
                "ns": median["point_estimate"],
                "low": interval["lower_bound"],
                "high": interval["upper_bound"],
            }
        )
    # Numeric order.
    return sorted(
        found, key=lambda row: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", row["id"])]
    )


def load(name: str) -> dict[str, Any]:
    path = PEERS / name
    if not path.exists():
        fail(f"no {path}: run without --write-only first")
    content: dict[str, Any] = json.loads(path.read_text())
    return content


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--passes", type=int, help="of compare.py; default: as it has, with --quick 3")
    parser.add_argument("--quick", action="store_true", help="few repeats: no figure counts")
    parser.add_argument("--write-only", action="store_true", help="measure nothing, write the page again")
    parser.add_argument(
        "-o", "--output", type=Path, default=ROOT / "docs" / "measured" / "benchmarks.md", help="default: %(default)s"
    )
    options = parser.parse_args()
    if not options.write_only:
        missing = [path for path in (PEERS / "pinocchio_bench", PEERS / "models") if not path.exists()]
        if missing:
            fail(f"not there: {', '.join(map(str, missing))}; run `make peers`")
        ran = measure(options.passes, options.quick)
        (PEERS / "run.json").write_text(json.dumps(ran, indent=1) + "\n")
    ran = load("run.json")
    folder = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "criterion"
    alone = [row for row in criterion(folder, ran["began"]) if row["group"] not in COMPARED]
    names = ("comparison", "python", "motion", "kinematics")
    compared, python, motion, kinematics = (load(f"{name}.json") for name in names)
    states = PEERS / AUTO_STATES
    if not states.exists():
        fail(f"no {states}: run without --write-only first")
    report_page.write(options.output, ran, compared, python, motion, alone, states.read_text(encoding="utf-8"), kinematics)
    print(f"written: {options.output}")


if __name__ == "__main__":
    main()
