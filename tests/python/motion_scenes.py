"""Small robots with friction, damping and joint stops for the tests of simulation."""

from __future__ import annotations

import numpy as np

import phipsi

GRAVITY = 9.81
ROD_INERTIA = 0.08 + 0.25
"""Inertia of the pendulum about its hinge, kg m^2."""
ROD_WEIGHT = GRAVITY * 0.5
"""Largest gravity torque of the pendulum, N m."""


def slide(mass: float = 2.0, axis: tuple[float, float, float] = (1.0, 0.0, 0.0), **joint: object) -> phipsi.Scene:
    """A mass on a prismatic joint, horizontal by default."""
    builder = phipsi.SceneBuilder().link("base").link("block", mass)
    return builder.joint("slide", "prismatic", "base", "block", axis=axis, **joint).build()  # type: ignore[arg-type]


def pendulum(**joint: object) -> phipsi.Scene:
    """A rod whose stable equilibrium is q = 0."""
    builder = phipsi.SceneBuilder().link("base").link("rod", 1.0, (0, 0, -0.5), np.diag([0.08, 0.08, 0.001]))
    return builder.joint("hinge", "revolute", "base", "rod", axis=(0, 1, 0), **joint).build()  # type: ignore[arg-type]


def robot(seed: int, *, joints: int = 3, range_of_motion: float = 3.0, friction: float = 0.3, damping: float = 0.3, floating_base: bool = False) -> phipsi.Scene:
    """A chain of revolute joints with random axes, friction and damping up to the given values, and symmetric limits."""
    random = np.random.default_rng(seed)
    builder = phipsi.SceneBuilder().link("base", 2.0, (0, 0, 0.05), 0.02 * np.eye(3))
    for k in range(joints):
        center = (*random.uniform(-0.05, 0.05, 2), 0.2)
        builder.link(f"link{k}", random.uniform(0.5, 1.5), center, np.diag(random.uniform(0.015, 0.025, 3)))
        bound = range_of_motion * random.uniform(0.7, 1.0)
        builder.joint(
            f"joint{k}", "revolute", f"link{k - 1}" if k else "base", f"link{k}", xyz=(0, 0, 0.4), rpy=random.uniform(-0.5, 0.5, 3), axis=random.normal(size=3),
            lower=-bound, upper=bound, friction=friction * random.uniform(0.1, 1.0), damping=damping * random.uniform(0.0, 1.0),
        )  # fmt: skip
    return builder.build(floating_base=floating_base)


def start(scene: phipsi.Scene, seed: int, *, away: float = 0.25, speed: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """A configuration near the neutral one, and joint velocities."""
    random = np.random.default_rng([seed, 7])
    return scene.integrate(scene.neutral(), random.uniform(-away, away, scene.nv)), random.uniform(-speed, speed, scene.nv)
