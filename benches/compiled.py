"""Forward and inverse dynamics, and their derivatives, of robots compiled for themselves (phipsi.compile) beside the scene's own calls and beside code that CasADi writes, in one run.

Usage: python benches/compiled.py [--markdown FILE]; `make compiled`.

With --quick only UR5 and few turns, to see that it works.

Batches run on one thread; one state is timed in C, by a loop around the function, for from Python the way there is longer than the function. Times are the least of some turns, which
take each other's place. The compiler and its flags are those of phipsi.compile.
"""

import argparse
import subprocess
import sys
import tempfile
import time
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import phipsi
import compiled_states
import pinocchio as pin
from in_turns import least, write
from robots import ROBOTS, load

sys.path.insert(0, str(Path(__file__).parent / "peers"))
import casadi_code

#: File, and whether its base floats.
CASES = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", False),
    "panda": ("panda_description/urdf/panda.urdf", False),
    "solo12": ("solo_description/robots/solo12.urdf", True),
    "g1": ("g1_description/urdf/g1_29dof_rev_1_0.urdf", True),
}
FUNCTIONS = ("forward_dynamics", "inverse_dynamics", "forward_dynamics_derivatives", "inverse_dynamics_derivatives")
STATES, TURNS = 4096, 15
#: What is not asked of CasADi: derivatives by the coordinates of a free joint, which are more than its degrees of freedom.
NOT_ASKED = {(robot, f"{way}_dynamics_derivatives") for robot in ("solo12", "g1") for way in ("forward", "inverse")}
#: As many as what is compiled takes, in a register.
LANES = 8 if "avx512f" in Path("/proc/cpuinfo").read_text() else 4
ABOUT_STATES = (
    "Forward dynamics, from Python on one thread; the scene in form `auto` and in form `covariance`. *In doubt*: states whose margin is below zero, which the scene does once more; their time is in *compiled, watched*. "
    "Drawn are joints from -1 to 1 around the neutral posture, rates and torques too."
)
ABOUT_WATCH = (
    "In form `auto` the scene's own calls watch too. Of derivatives and products the compiled watch is a function of its own, which goes through the factor of the mass matrix once more and gives its margin; of forward dynamics and the inverse itself it is a few lines more."
)
ABOUT_CALLS = (
    "The way from Python to machine code is longer than that to the scene: *as fast at* says from how many states on it is worth it, of "
    f"{', '.join(map(str, compiled_states.COUNTS))} that were tried; fewer than *used from* are done by the scene. Form `auto`. *Compiled, one state*: the scene's call and what finds that it is to be taken. *Machine code, 8 states*: if it were not."
)


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


def beside(scene: phipsi.Scene, file: str, floating_base: bool) -> tuple[pin.Model, list[int], list[int]]:
    """Pinocchio's model of the robot, which CasADi's code is written from, and where its coordinates and rates are in the scene's."""
    free = (pin.JointModelFreeFlyer(),) if floating_base else ()
    model = pin.buildModelFromUrdf(str(ROBOTS / file), *free)
    names = list(model.names)[1:]
    return model, [i for name in names for i in _indices(scene.q_index(name))], [i for name in names for i in _indices(scene.v_index(name))]


def _indices(at: slice) -> range:
    return range(at.start, at.stop)


def results_of(function: str, found: np.ndarray, rates: list[int]) -> np.ndarray:
    """CasADi's results in the order of the scene's."""
    back = np.argsort(rates)
    if not function.endswith("derivatives"):
        return found[:, back]
    n = len(rates)
    return found.reshape(len(found), 3, n, n)[..., back, :][..., back].transpose(1, 0, 2, 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--markdown", type=Path)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    cases, turns = (dict(list(CASES.items())[:1]), 3) if given.quick else (CASES, TURNS)
    phipsi.set_num_threads(1)
    lines = [
        "| robot | function | scene, ns a state | compiled | compiled, watched | CasADi | compiled, one state | CasADi, one state | compiling, s | CasADi | kB | CasADi | largest difference |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    random = np.random.default_rng(0)
    for name, (file, floating_base) in cases.items():
        scene = load(file, floating_base)
        model, coordinates, rates = beside(scene, file, floating_base)
        q = scene.integrate(scene.neutral(), random.uniform(-1, 1, (STATES, scene.nv)))
        qd, u = random.uniform(-1, 1, (2, STATES, scene.nv))
        theirs = [np.ascontiguousarray(array) for array in (q[:, coordinates], qd[:, rates], u[:, rates])]
        singles = in_c(scene, q)
        for function, single in zip(FUNCTIONS, singles, strict=True):
            with tempfile.TemporaryDirectory() as directory, warnings.catch_warnings():
                warnings.simplefilter("ignore", phipsi.errors.LongCodeWarning)
                begin = time.perf_counter()
                fast = phipsi.compile(scene, [function], form="covariance", cache=directory)
                compiling, bytes_of_ours = time.perf_counter() - begin, fast.library.stat().st_size
                form = {"form": "covariance"} if function.startswith("forward") else {}
                own, compiled = partial(getattr(scene, function), q, qd, u, **form), partial(getattr(fast, function), q, qd, u)
                calls = [own, compiled]
                if function.startswith("forward"):
                    calls.append(partial(getattr(phipsi.compile(scene, [function], cache=directory), function), q, qd, u))
                expected = np.asarray(own())
                apart = [np.asarray(compiled())]
                other = None
                if (name, function) not in NOT_ASKED:
                    other = casadi_code.compiled(model, function, Path(directory), LANES)
                    calls.append(partial(other.batch, *theirs))
                    apart.append(results_of(function, other.batch(*theirs), rates))
                times = [f"{1e9 * t / STATES:.0f}" for t in least(turns, *calls)]
                if not function.startswith("forward"):
                    times.insert(2, "")
                if other is None:
                    times.append("")
                difference = max(float(np.max(np.abs(found - expected))) for found in apart) / float(np.max(np.abs(expected)))
                beside_it = [f"{other.least(*(array[:32] for array in theirs)):.0f}", f"{other.seconds:.1f}", f"{other.bytes / 1000:.0f}"] if other else ["", "", ""]
                cells = [name, function.replace("_", " "), *times, f"{single:.0f}", beside_it[0], f"{compiling:.1f}", beside_it[1], f"{bytes_of_ours / 1000:.0f}", beside_it[2], f"{difference:.0e}"]
                lines.append(f"| {' | '.join(cells)} |")
                print(lines[-1], flush=True)
    scenes = {name: load(*cases[name]) for name in compiled_states.ROBOTS if name in cases}
    for title, about, rows in (
        ("In the states that robots are in", ABOUT_STATES, compiled_states.by_state(scenes, STATES, turns)),
        ("What the watch costs", ABOUT_WATCH, compiled_states.of_watch(scenes, STATES, turns)),
        ("What a call costs", ABOUT_CALLS, compiled_states.of_calls(scenes, turns)),
    ):
        lines += ["", f"## {title}", "", about, ""]
        for row in rows:
            lines.append(row)
            print(row, flush=True)
    write(
        given.markdown,
        "Compiled robots: times",
        [
            "Written by `make compiled` (benches/compiled.py). The scene's own calls are in form `covariance`, as what is compiled; *watched* is `phipsi.compile` in form `auto`, where the scene's own calls take longer too. All take the same arrays "
            "from Python, on one thread; the scene and what is compiled check arguments and results, CasADi's code does not. CasADi "
            f"{casadi_code.ca.__version__}: the usual recursions on its symbols, derivatives by its automatic differentiation, its C compiled with `{' '.join(casadi_code.FLAGS[:3])}`, {LANES} states in a register "
            "(benches/peers/casadi_code.py). One state is timed in C, where no library is on the way. Compiling is of this function alone, written, compiled and loaded. CasADi is not asked for derivatives of robots on a free joint.",
        ],
        lines,
        "threads. Of large robots the derivatives of thousands of states are more than the caches hold; one of some hundreds takes less than one of these 4096.",
    )


if __name__ == "__main__":
    main()
