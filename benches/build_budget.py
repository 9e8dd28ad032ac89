#!/usr/bin/env python3
"""CPU time of the release build of the Python module, and what its code consists of: by crate, feature and kernel.

Usage: python benches/build_budget.py [--markdown FILE] [--features python,avx512]; `make build-budget`.
Needs cargo and the binutils (nm, c++filt).

The module is built in an empty target folder. Cargo calls this file in place of rustc: it measures the CPU time of each
crate, and names the instances of generic functions in full. Code is that of the functions in the library; functions
that are inlined everywhere are part of their callers.
"""

import argparse
import os
import platform
import re
import resource
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: The file to which the compiler's times are added; set for the calls in place of rustc.
LOG = "PHIPSI_BUILD_BUDGET"
#: Features by the module of the crate that they add.
FEATURES = {
    "dynamics::derivatives": "derivatives",
    "motion": "motion",
    "contact": "motion",
    "estimation": "estimation",
    "inverse_kinematics": "inverse-kinematics",
    "control": "control",
    "operators": "operators",
    "codegen": "codegen",
    "report": "report",
    "collision": "collision",
    "scene::urdf": "urdf",
    "stochastic": "stochastic",
    "python": "python",
}
#: Instruction sets by what the name of an instance contains, the widest first.
SETS = {"x86::v4::V4": "AVX-512", "x86::v3::V3": "AVX2", "Neon": "NEON"}
#: Number of kernels and of crates in the tables.
MOST = 30


def compile_crate(command: list[str]) -> int:
    """Runs rustc and adds its time to the log, in place of Cargo."""
    name = command[command.index("--crate-name") + 1] if "--crate-name" in command else ""
    if name == "phipsi":
        command = [*command, "-C", "symbol-mangling-version=v0"]
    # With the open files of the job server.
    code = subprocess.run(command, check=False, close_fds=False).returncode
    if name not in ("", "___"):
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        with Path(os.environ[LOG]).open("a", encoding="utf-8") as log:
            log.write(f"{name} {used.ru_utime + used.ru_stime}\n")
    return code


def built(features: str, python: str, target: Path) -> tuple[dict[str, float], Path]:
    """CPU seconds by crate, and the library."""
    log = target / "times"
    environment = {**os.environ, "CARGO_TARGET_DIR": str(target), "CARGO_INCREMENTAL": "0", "PYO3_PYTHON": python}
    environment |= {LOG: str(log), "RUSTC_WRAPPER": str(Path(__file__).resolve())}
    command = ["cargo", "rustc", "--release", "--locked", "--lib", "--crate-type", "cdylib", "--features", features]
    subprocess.run(command, cwd=ROOT, env=environment, check=True)
    times: dict[str, float] = defaultdict(float)
    for line in log.read_text(encoding="utf-8").splitlines():
        name, seconds = line.split()
        times[name] += float(seconds)
    return times, next((target / "release").glob("libphipsi.*[oy]*"))


def functions(library: Path) -> list[tuple[str, int]]:
    """Name and size of each function."""
    listed = subprocess.run(["nm", "-S", "--defined-only", library], capture_output=True, text=True, check=True)
    named = subprocess.run(["c++filt"], input=listed.stdout, capture_output=True, text=True, check=True).stdout
    # Without the numbers of the crates.
    lines = re.sub(r"\[[0-9a-f]+\]", "", named).splitlines()
    found = (re.fullmatch(r"\w+ (\w+) [tT] (.*)", line) for line in lines)
    return [(match[2], int(match[1], 16)) for match in found if match]


def without_arguments(name: str) -> str:
    """A name without generic arguments, which can be nested; `<T as Trait>` at its beginning is kept."""
    depth, kept = 0, []
    for i, letter in enumerate(name):
        opens = letter == "<" and (depth > 0 or name[max(i - 2, 0) : i] == "::")
        depth += opens
        if depth == 0:
            kept.append(letter)
        depth -= letter == ">" and depth > 0 and name[i - 1] != "-"
    return "".join(kept).replace("::::", "::").removesuffix("::")


def kernel_of(name: str) -> str:
    """The function that a name stands for: that of the work, where pulp compiles it for lanes."""
    if "::vectorize" in name and (work := re.search(r"(?:Job|Dispatched)<(phipsi::[\w:]+)", name)):
        return work[1].removesuffix("::Call")
    return without_arguments(name)


def feature_of(kernel: str) -> str:
    """The feature that adds a function; the dynamics are there without one."""
    at = kernel.find("phipsi::")
    if at < 0:
        return "other crates"
    path = kernel[at + len("phipsi::") :]
    return next((feature for module, feature in FEATURES.items() if path.startswith(module + "::")), "none (dynamics)")


def set_of(name: str) -> str:
    """The instruction set of an instance."""
    return next((label for part, label in SETS.items() if part in name), "baseline")


def table(head: list[str], rows: list[list[str]]) -> str:
    rule = ["---"] + ["---:"] * (len(head) - 1)
    return "\n".join("| " + " | ".join(row) + " |" for row in [head, rule, *rows])


def written(features: str, times: dict[str, float], library: Path) -> str:
    """The page."""
    code = functions(library)
    own, whole = times["phipsi"], sum(times.values())
    by_feature: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    by_set: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    kernels: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for name, size in code:
        kernel = kernel_of(name)
        for sums in (by_feature[feature_of(kernel)], by_set[set_of(name)], kernels[kernel]):
            sums[0] += 1
            sums[1] += size
    total = sum(size for _, size in code)

    def rows(sums: dict[str, list[int]]) -> list[list[str]]:
        ordered = sorted(sums.items(), key=lambda one: -one[1][1])
        figures = lambda count, size: [f"{count:,}", f"{size / 1e3:,.0f}", f"{own * size / total:.0f}"]
        return [[name, *figures(count, size)] for name, (count, size) in ordered]

    largest = [[f"`{name}`", *figures[:2]] for name, *figures in rows(kernels)[:MOST]]
    crates = sorted(((name, time) for name, time in times.items() if name != "phipsi"), key=lambda one: -one[1])
    rustc = subprocess.run(["rustc", "--version"], capture_output=True, text=True, check=True).stdout.strip()
    head = ["functions", "code, kB", "CPU time, s"]
    return f"""# Budget of the build

Written by `make build-budget` (benches/build_budget.py) with {rustc} on {platform.machine()}: the release build of the
Python module with the features `{features}` in an empty target folder. It took {whole:.0f} s of CPU time, {own:.0f} s of
it for this crate, whose library has {total / 1e6:.1f} MB of code in {len(code):,} functions. The CPU time of this crate is
divided in proportion to the code. A function that is inlined is part of its caller.

## By feature

{table(["feature that adds it", *head], rows(by_feature))}

## By instruction set

Every kernel is compiled for each instruction set, for one state and for one state per lane.

{table(["instruction set", *head], rows(by_set))}

## The largest functions

With the number of their instances: by scalar, instruction set and whatever else they are generic over.

{table(["function", "instances", "code, kB"], largest)}

## Other crates

{table(["crate", "CPU time, s"], [[name, f"{time:.1f}"] for name, time in crates[:MOST]])}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the page to this file")
    parser.add_argument("--features", default="python", help="default: %(default)s")
    parser.add_argument("--python", default=sys.executable, help="the interpreter that the module is built for")
    parser.add_argument("--target", type=Path, help="keep what is built in this folder, which must be empty or missing")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        target = options.target or Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        page = written(options.features, *built(options.features, options.python, target))
    if options.markdown:
        options.markdown.write_text(page, encoding="utf-8")
    else:
        print(page)


if __name__ == "__main__":
    if LOG in os.environ:
        sys.exit(compile_crate(sys.argv[1:]))
    main()
