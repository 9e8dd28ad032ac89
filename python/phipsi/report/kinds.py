"""Kinds of states for benchmarks: random states, and states that occur in the use of robots.

The benchmarks import this file, and benches/auto_states.py runs it with older wheels. Therefore it uses only
numpy and public names of phipsi.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phipsi import Scene

Array = NDArray[np.float64]

#: Torque (N m or N) or velocity (rad/s or m/s) that is small compared with gravity.
SMALL = 1e-9
#: Velocity of a joint that moves alone, rad/s or m/s.
RATE = 1.0

RANDOM = "random"
HELD = "held"
PUSHED = "held and pushed"
REST = "at rest"
FALLING = "falling"
ONE_TORQUE = "one small torque"
ONE_RATE = "one small rate"
MOVING = "one joint moving"

#: Definition of each kind.
MEANING: dict[str, str] = {
    RANDOM: "random velocities and torques",
    HELD: "static equilibrium: qd = 0, tau = bias(q, 0)",
    PUSHED: f"static equilibrium, and {SMALL:g} N m more at one joint",
    REST: "passive, at rest: qd = 0, tau = 0",
    FALLING: "passive, in motion: random velocities, tau = 0",
    ONE_TORQUE: f"qd = 0, tau = {SMALL:g} N m at one joint, else 0",
    ONE_RATE: f"tau = 0, qd = {SMALL:g} rad/s at one joint, else 0",
    MOVING: f"tau = 0, qd = {RATE:g} rad/s at one joint, else 0",
}
#: Order of the tables: random states first.
KINDS = tuple(MEANING)


@dataclass(frozen=True)
class Drawn:
    """Random configurations, joint velocities and torques, one per row, that states of every kind are made from."""

    q: Array
    """(n, nq)."""
    qd: Array
    """(n, nv)."""
    tau: Array
    """(n, nv)."""
    joint: NDArray[np.int64]
    """(n,): degree of freedom that is perturbed or moves alone; not one of a free base if there are others."""


def first_joint(scene: Scene) -> int:
    """Number of degrees of freedom of a free base that precede those of the joints; 0 without a free base, or if there
    are no others.
    """
    names = scene.joint_names
    if not names:
        return 0
    at, coordinates = scene.v_index(names[0]), scene.q_index(names[0])
    free = (at.stop - at.start, coordinates.stop - coordinates.start) == (6, 7)
    return 6 if free and scene.nv > 6 else 0


def draw(scene: Scene, count: int, seed: int) -> Drawn:
    """Configurations, joint velocities and torques within (-1, 1), reproducible by seed."""
    generator = np.random.default_rng(seed)

    def numbers() -> Array:
        return generator.uniform(-1.0, 1.0, (count, scene.nv))

    q = np.asarray(scene.integrate(np.tile(scene.neutral(), (count, 1)), numbers()))
    return of(scene, q, numbers(), numbers(), generator)


def of(scene: Scene, q: Array, qd: Array, tau: Array, generator: np.random.Generator) -> Drawn:
    """The same for given states: (n, nq), (n, nv), (n, nv)."""
    return Drawn(q, qd, tau, generator.integers(first_joint(scene), scene.nv, len(q)))


def state(scene: Scene, drawn: Drawn, kind: str) -> tuple[Array, Array, Array]:
    """q, qd and tau of one of KINDS, (n, nq) and (n, nv)."""
    zero = np.zeros_like(drawn.qd)
    one = np.zeros_like(drawn.qd)
    one[np.arange(len(one)), drawn.joint] = 1.0
    if kind == RANDOM:
        return drawn.q, drawn.qd, drawn.tau
    if kind in (HELD, PUSHED):
        holding = np.asarray(scene.bias_torque(drawn.q, zero))
        return drawn.q, zero, holding + SMALL * one if kind == PUSHED else holding
    rates = {REST: zero, FALLING: drawn.qd, ONE_TORQUE: zero, ONE_RATE: SMALL * one, MOVING: RATE * one}
    return drawn.q, rates[kind], SMALL * one if kind == ONE_TORQUE else zero
