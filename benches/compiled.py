"""Forward and inverse dynamics, and their derivatives, of robots compiled for themselves (phipsi.compile) beside the scene's own calls, in one run.

Usage: python benches/compiled.py [--markdown FILE]; `make compiled`.

Batches run on one thread; one state is timed in C, by a loop around the function, for from Python the way there is longer than the function. Times are the least of some turns, which
take each other's place. The compiler and its flags are those of phipsi.compile.
"""

import argparse
import subprocess
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
import phipsi
import pinocchio as pin
from in_turns import least, write

ROBOTS = Path(pin.__file__).resolve().parents[4] / "share/example-robot-data/robots"
#: File, and whether its base floats.
CASES = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", False),
    "panda": ("panda_description/urdf/panda.urdf", False),
    "solo12": ("solo_description/robots/solo12.urdf", True),
    "g1": ("g1_description/urdf/g1_29dof_rev_1_0.urdf", True),
}
FUNCTIONS = ("forward_dynamics", "inverse_dynamics", "forward_dynamics_derivatives", "inverse_dynamics_derivatives")
STATES, TURNS = 4096, 15


def load(file: str, floating_base: bool) -> phipsi.Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return phipsi.Scene.from_urdf(ROBOTS / file, floating_base=floating_base)


def in_c(scene: phipsi.Scene, q: np.ndarray) -> list[float]:
    """The least time of one state of each function, ns, in C."""
    states = np.ascontiguousarray(q[:32])
    numbers = ", ".join(repr(float(x)) for x in states.ravel())

    def call(function: str) -> str:
        results = [f"out + {at * scene.nv**2}" for at in range(3 if function.endswith("derivatives") else 1)]
        return f"robot_{function}(q + i * {scene.nq}, q + i, q + 2 * i, {', '.join(results)})"

    calls = "\n".join(
        f"        begin = now(); for (int i = 0; i < 32; i++) {call(function)}; spent = now() - begin; if (spent < least[{k}]) least[{k}] = spent;"
        for k, function in enumerate(FUNCTIONS)
    )
    main = f"""
#define _POSIX_C_SOURCE 199309L
#include "robot.h"
#include <stdio.h>
#include <time.h>
static double now(void) {{ struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t); return 1e9 * t.tv_sec + t.tv_nsec; }}
static const double q[] = {{{numbers}}};
static double out[{3 * scene.nv**2}];
int main(void)
{{
    double least[] = {{{", ".join("1e18" for _ in FUNCTIONS)}}}, begin, spent;
    for (int turn = 0; turn < 2000; turn++) {{
{calls}
    }}
    for (int k = 0; k < {len(FUNCTIONS)}; k++) printf("%.17g ", least[k] / 32);
    return out[0] != out[0];
}}
"""
    with tempfile.TemporaryDirectory() as directory:
        scene.to_c(directory, functions=FUNCTIONS)
        (Path(directory) / "main.c").write_text(main)
        flags = ["-std=c99", "-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno"]
        subprocess.run(["cc", *flags, "main.c", "robot.c", "-lm", "-o", "main"], cwd=directory, check=True)
        said = subprocess.run([str(Path(directory) / "main")], check=True, capture_output=True, text=True).stdout
    return [float(x) for x in said.split()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--markdown", type=Path)
    given = parser.parse_args()
    phipsi.set_num_threads(1)
    lines = [
        "| robot | function | scene, batches, ns a state | compiled | times | compiled, one state in C, ns | largest difference | compiling, s |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    random = np.random.default_rng(0)
    for name, (file, floating_base) in CASES.items():
        scene = load(file, floating_base)
        with tempfile.TemporaryDirectory() as cache:
            begin = time.perf_counter()
            fast = phipsi.compile(scene, FUNCTIONS, cache=cache)
            compiling = time.perf_counter() - begin
            q = scene.integrate(scene.neutral(), random.uniform(-1, 1, (STATES, scene.nv)))
            qd, u = random.uniform(-1, 1, (2, STATES, scene.nv))
            singles = in_c(scene, q)
            for function, single in zip(FUNCTIONS, singles, strict=True):
                own, compiled = getattr(scene, function), getattr(fast, function)
                form = {"form": "covariance"} if function.startswith("forward") else {}
                expected, found = np.asarray(own(q, qd, u, **form)), np.asarray(compiled(q, qd, u))
                apart = float(np.max(np.abs(found - expected)) / np.max(np.abs(expected)))
                ours, theirs = (1e9 * t / STATES for t in least(TURNS, lambda own=own, form=form: own(q, qd, u, **form), lambda compiled=compiled: compiled(q, qd, u)))
                said = function.replace("_", " ")
                lines.append(f"| {name} | {said} | {ours:.0f} | {theirs:.0f} | {ours / theirs:.1f} | {single:.0f} | {apart:.0e} | {compiling:.1f} |")
                print(lines[-1], flush=True)
    how = "The scene's own calls are in form `covariance`, as what is compiled. Both take the same arrays from Python, on one thread; the checks of arguments and results are in both."
    write(
        given.markdown,
        "Compiled robots: times",
        [
            f"Written by `make compiled` (benches/compiled.py). {how} One state is timed in C, where no library is on the way.",
        ],
        lines,
        "other programs that write code, threads. The code of a large robot is long: beyond some dozens of joints it is read from memory for every chunk of states.",
    )


if __name__ == "__main__":
    main()
