"""Scenes of the comparison, and their initial states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phipsi import Scene, SceneBuilder
from .slow import at_rest

Array = NDArray[np.float64]

#: Stiffness, N m/rad.
SPRINGS = (1e3, 1e5, 1e7, 1e9)


@dataclass(frozen=True)
class Case:
    """A scene, its initial state, and the duration of the motion."""

    name: str
    what: str
    """Description in one sentence."""
    scene: Scene
    q: Array
    qd: Array
    time: float
    """Duration, s."""
    first: int
    """Number of steps of the coarsest run; the others have 2, 4, 8, ... times as many."""
    stiff: bool = False
    rings: bool = False
    """Whether the initial state is off the slow manifold."""

    @property
    def omega(self) -> float:
        """Largest rate of springs and dampers in the initial state, rad/s or 1/s; zero without them.

        It is the largest eigenvalue of M^-1 D, or the square root of that of M^-1 K.
        """
        mass = self.scene.mass_matrix(self.q)
        squares, rates = (
            float(np.max(np.linalg.eigvals(np.linalg.solve(mass, np.diag(values))).real, initial=0.0))
            for values in (self.scene.stiffness, self.scene.damping)
        )
        return max(float(np.sqrt(squares)), rates)

    @property
    def conserves(self) -> bool:
        """Whether energy is conserved."""
        return not np.any(self.scene.damping)


def _rod(builder: SceneBuilder, name: str, mass: float, along: tuple[float, float, float]) -> None:
    """A slender body from its joint to that point, with a thickness of a twentieth of its length."""
    line = np.array(along)
    length = float(np.linalg.norm(line))
    direction = line / length
    across = np.eye(3) - np.outer(direction, direction)
    inertia = mass * length**2 / 12 * (across + np.eye(3) / 400)
    builder.link(name, mass, 0.5 * line, inertia)


def pendulum(
    springs: Sequence[float], masses: Sequence[float], length: float, *,
    armature: Sequence[float] | None = None, damping: Sequence[float] | None = None,
) -> Scene:
    """Rods in series, all rotating about y."""
    builder = SceneBuilder().link("base")
    for i, (spring, mass) in enumerate(zip(springs, masses, strict=True)):
        _rod(builder, f"rod{i}", mass, (0.0, 0.0, -length))
        builder.joint(
            f"hinge{i}", "revolute", f"rod{i - 1}" if i else "base", f"rod{i}", axis=(0, 1, 0),
            xyz=(0.0, 0.0, -length if i else 0.0), stiffness=spring, armature=armature[i] if armature else 0.0,
            damping=damping[i] if damping else 0.0,
        )  # fmt: skip
    return builder.build()


def double_pendulum() -> Case:
    """Two equal rods."""
    scene = pendulum((0.0, 0.0), (1.0, 1.0), 0.5)
    what = "two rods of 1 kg and 0.5 m from rest, high enough to be chaotic"
    return Case("double pendulum", what, scene, np.array([2.0, 1.0]), np.zeros(2), 1.0, 80)


def arm() -> Case:
    """Seven joints with axes along z and y alternately, rotor inertias of 0.02 kg m^2."""
    builder = SceneBuilder().link("base")
    for i in range(7):
        _rod(builder, f"link{i}", 4.0 - 0.5 * i, (0.03, 0.0, 0.2))
        builder.joint(
            f"joint{i}", "revolute", f"link{i - 1}" if i else "base", f"link{i}", axis=(0, i % 2, 1 - i % 2),
            xyz=(0.03, 0.0, 0.2) if i else (0.0, 0.0, 0.0), armature=0.02,
        )  # fmt: skip
    scene = builder.build()
    q = np.array([0.0, 1.2, 0.3, -0.8, 0.2, 0.6, 0.0])
    qd = np.array([1.0, 0.0, -0.5, 0.0, 1.0, 0.0, 2.0])
    return Case("arm", "seven revolute joints, 1.4 m, passive under gravity", scene, q, qd, 0.5, 40)


def floating_tree() -> Case:
    """A free body with two arms of three joints, without gravity."""
    builder = SceneBuilder().link("body", 5.0, (0.02, -0.01, 0.03), np.diag([0.15, 0.2, 0.1]))
    axes = ((0, 0, 1), (0, 1, 0), (1, 0, 0))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for i in range(3):
            _rod(builder, f"{side}{i}", 1.0 - 0.2 * i, (0.0, 0.3 * sign, 0.05))
            builder.joint(
                f"{side}-joint{i}", "revolute", f"{side}{i - 1}" if i else "body", f"{side}{i}", axis=axes[i],
                xyz=(0.0, 0.3 * sign, 0.05) if i else (0.0, 0.2 * sign, 0.0),
            )  # fmt: skip
    scene = builder.build(floating_base=True, gravity=(0, 0, 0))
    q, qd = scene.neutral(), np.zeros(scene.nv)
    q[7:] = [0.3, -0.2, 0.5, -0.4, 0.1, 0.2]
    qd[:6] = [0.2, -0.1, 0.3, 1.0, -1.5, 0.8]
    qd[6:] = [1.0, -2.0, 0.5, -1.0, 1.5, 2.0]
    return Case("floating tree", "a rotating free body with two arms of three joints, without gravity", scene, q, qd, 0.5, 40)


def long_chain() -> Case:
    """Sixty-four links, axes along x and y alternately."""
    links = 64
    builder = SceneBuilder().link("base")
    for i in range(links):
        _rod(builder, f"link{i}", 0.2, (0.0, 0.0, -0.1))
        builder.joint(
            f"joint{i}", "revolute", f"link{i - 1}" if i else "base", f"link{i}", axis=(i % 2, 1 - i % 2, 0),
            xyz=(0.0, 0.0, -0.1 if i else 0.0),
        )  # fmt: skip
    scene = builder.build()
    q = 0.05 * np.sin(0.4 * np.arange(links))
    q[0] = 1.2
    what = "64 links of 0.1 m with alternating axes, released from a curved configuration"
    return Case("chain of 64", what, scene, q, np.zeros(links), 0.2, 40)


def springs(stiffness: float) -> Case:
    """A pendulum of three rods with springs at two joints, at rest on the slow manifold."""
    scene = pendulum((0.0, stiffness, stiffness), (1.0, 1.0, 1.0), 0.4)
    q = at_rest(scene, np.array([1.0, 0.0, 0.0]), scene.stiffness > 0.0)
    size = f"{stiffness:.0e}".replace("e+0", "e")
    what = f"a pendulum of three rods, joints 2 and 3 with springs of {size} N m/rad, on the slow manifold"
    return Case(f"springs {size}", what, scene, q, np.zeros(3), 0.2, 50, stiff=True)


def held(stiffness: float, *, ringing: bool) -> Case:
    """Two rods with a spring between them; at rest on the slow manifold, or with the spring unloaded."""
    scene = pendulum((0.0, stiffness), (1.0, 1.0), 0.4)
    q = np.array([1.0, 0.0])
    if not ringing:
        q = at_rest(scene, q, scene.stiffness > 0.0)
    return Case(f"held {stiffness:.3g}", "two rods with a spring between them", scene, q, np.zeros(2), 0.1, 50, stiff=True, rings=ringing)


def struck() -> Case:
    """The same, released with unloaded springs, so that they oscillate."""
    scene = pendulum((0.0, 1e5, 1e5), (1.0, 1.0, 1.0), 0.4)
    what = "the same with 1e5 N m/rad, released with unloaded springs: off the slow manifold, so that they oscillate"
    return Case("struck springs", what, scene, np.array([1.0, 0.0, 0.0]), np.zeros(3), 0.1, 50, stiff=True, rings=True)


def dampers() -> Case:
    """A pendulum of three rods with dampers at two joints."""
    scene = pendulum((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.4, damping=(0.0, 1e3, 1e3))
    what = "a pendulum of three rods, joints 2 and 3 with dampers of 1e3 N m s/rad and no springs"
    return Case("dampers", what, scene, np.array([1.0, 0.0, 0.0]), np.zeros(3), 0.2, 50, stiff=True)


def light_on_heavy() -> Case:
    """Rods of 100 kg to 0.1 g."""
    scene = pendulum((0.0, 1e3, 1e3, 1e3), (100.0, 1.0, 1e-2, 1e-4), 0.4)
    q = at_rest(scene, np.array([1.0, 0.0, 0.0, 0.0]), scene.stiffness > 0.0)
    what = "rods of 100 kg, 1 kg, 10 g and 0.1 g, springs of 1e3 N m/rad, on the slow manifold"
    return Case("light on heavy", what, scene, q, np.zeros(4), 0.2, 50, stiff=True)


def armatures() -> Case:
    """Armatures from two thousand times the inertia of a link to zero."""
    scene = pendulum((1e4, 1e6, 1e6, 1e6), (1.0, 1.0, 1.0, 1.0), 0.4, armature=(1e2, 1.0, 1e-3, 0.0))
    fast = np.array([False, True, True, True])
    q = at_rest(scene, np.array([0.5, 0.0, 0.0, 0.0]), fast)
    what = (
        "four rods of 1 kg, armatures 100, 1, 1e-3 and 0 kg m^2, springs of 1e4 N m/rad on the first joint and 1e6 on the others,"
        " the latter on the slow manifold"
    )
    return Case("armature ratios", what, scene, q, np.zeros(4), 0.2, 50, stiff=True)


def cases() -> list[Case]:
    """All cases, the smooth ones first."""
    smooth = [double_pendulum(), arm(), floating_tree(), long_chain()]
    return [*smooth, *(springs(k) for k in SPRINGS), struck(), dampers(), light_on_heavy(), armatures()]
