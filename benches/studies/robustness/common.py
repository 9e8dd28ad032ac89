"""Common helpers of the sections: robots, initial states, runs with the default method, and Markdown tables."""

from __future__ import annotations

import functools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import phipsi
from robots import ROBOTS, load

Array = NDArray[np.float64]

#: A run whose joint velocities exceed this, rad/s or m/s, counts as failed, in every program.
SPEED = 1e6
#: A passive run whose total energy rises by more than this share of its energy range counts as gaining energy.
RISE = 0.02
#: Energy range of a robot that hardly moves, J, which gains are compared with.
LEAST_RANGE = 1e-6
#: Arguments that disable joint stops; versions without an energy audit have no stops.
NO_STOPS: dict[str, str] = {"limits": "report"} if hasattr(phipsi.Trajectory, "energy_audit") else {}
#: Files that `--quick` uses.
QUICK = ("a1", "allegro_right_hand", "centauro", "panda", "romeo", "so100", "talos_left_arm", "talos_reduced", "xarm7", "z1")


@dataclass(frozen=True)
class Options:
    """Options of one run of the bench."""

    method: str
    """Value of `method` in the runs that measure the default."""
    quick: bool


class Finding(NamedTuple):
    """One row of the table at the top of the page."""

    quantity: str
    found: str
    aim: str
    met: bool | None
    """None: not measured, or without an aim."""


class Section(NamedTuple):
    """One section of the page."""

    title: str
    text: str
    findings: list[Finding]


class Run(NamedTuple):
    """One simulation; the trajectory is None if it failed."""

    trajectory: phipsi.Trajectory | None
    failure: str


def progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table whose first column is aligned left."""
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


@functools.cache
def files() -> dict[str, str]:
    """URDF files of example-robot-data by a short name: the stem, with the folder in front if two files have the same stem."""
    names: dict[str, str] = {}
    for path in sorted(ROBOTS.rglob("*.urdf")):
        file = path.relative_to(ROBOTS).as_posix()
        name = path.stem if path.stem not in names else f"{file.split('_description')[0]} {path.stem}"
        names[name] = file
    return names


@functools.cache
def robots(quick: bool, floating: bool = False) -> dict[str, phipsi.Scene]:
    """Every robot that loads and has a joint, by name."""
    found = {}
    for name, file in files().items():
        if quick and name not in QUICK:
            continue
        try:
            scene = load(file, floating)
        except phipsi.errors.SceneError:
            continue
        if scene.nv > (6 if floating else 0):
            found[name] = scene
    return found


def lacks_inertia(scene: phipsi.Scene) -> bool:
    """Whether forward dynamics at rest raises because a joint moves no inertia."""
    zero = np.zeros(scene.nv)
    try:
        scene.forward_dynamics(scene.neutral(), zero, zero)
    except phipsi.errors.SingularJointError:
        return True
    return False


def bounds(scene: phipsi.Scene) -> tuple[Array, Array]:
    """Position limits, (nv,) each; -1 and 1 for joints without limits."""
    lower, upper = scene.limits.lower, scene.limits.upper
    bounded = np.isfinite(lower) & np.isfinite(upper)
    return np.where(bounded, lower, -1.0), np.where(bounded, upper, 1.0)


def random_poses(scene: phipsi.Scene, count: int, seed: int = 0) -> Array:
    """Random configurations of a fixed-base robot in the middle half of the limits, (count, nq)."""
    lower, upper = bounds(scene)
    return 0.5 * (lower + upper) + 0.25 * (upper - lower) * np.random.default_rng(seed).uniform(-1, 1, (count, scene.nv))


def run(scene: phipsi.Scene, q: Array, qd: Array, method: str, *, dt: float, duration: float, rows: int = 50, **more: Any) -> Run:
    """Simulate, with recorded rows at the start, at the end and at about `rows` times between; return the reason of a
    failure.
    """
    steps = round(duration / dt)
    every = next(k for k in range(max(1, steps // rows), 0, -1) if steps % k == 0)
    try:
        found = scene.simulate(q, qd, dt=dt, steps=steps, method=method, record_every=every, **more)
    except (phipsi.errors.SimulationError, phipsi.errors.SingularJointError) as error:
        where = f"joint {error.joint}, " if error.joint else ""
        return Run(None, f"{where}step {getattr(error, 'step', 0)}" if where else str(error).split("\n")[0][:120])
    if not np.all(np.abs(found.qd) <= SPEED):
        return Run(None, f"a joint velocity exceeds {SPEED:g}")
    return Run(found, "")


def distance(scene: phipsi.Scene, first: Array, second: Array) -> Array:
    """Largest entry of the difference of configurations in the tangent space, rad or m."""
    return np.asarray(np.max(np.abs(scene.difference(first, second)), axis=-1))


def energy_rise(kinetic: Array, potential: Array) -> tuple[Array, Array]:
    """Largest gain of total energy between two rows, J, and the energy range that it is compared with, J; rows are the last axis.

    The range is the largest kinetic energy or the range of the potential energy, whichever is larger, and at least LEAST_RANGE.
    """
    total = kinetic + potential
    rise = np.max(total - np.minimum.accumulate(total, axis=-1), axis=-1)
    return rise, np.maximum(np.maximum(np.max(kinetic, axis=-1), np.ptp(potential, axis=-1)), LEAST_RANGE)


def relative(error: float) -> str:
    """An error for a table."""
    return f"{error:.1e}" if np.isfinite(error) else "failed"


def listed(failures: dict[str, list[str]]) -> str:
    """Failures by robot as a Markdown list; "none" if there are none."""
    return "".join(f"\n- {name}: {'; '.join(each)}" for name, each in failures.items()) or " none."
