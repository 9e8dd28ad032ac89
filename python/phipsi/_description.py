"""Properties of a scene: limits, links, joints and simplifications."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Joint", "Limits", "Link", "Mimic", "Simplification", "Plan", "joint_of"]


UNLIMITED = np.array(np.inf)
UNLIMITED.flags.writeable = False


class Limits(NamedTuple):
    """Limits of each degree of freedom, (nv,) each; infinite if there is no limit.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> scene.limits.lower.shape
    (6,)
    """

    lower: NDArray[np.float64]
    """Lower limit of the position, rad or m."""
    upper: NDArray[np.float64]
    """Upper limit of the position, rad or m."""
    velocity: NDArray[np.float64]
    """Limit of the speed, rad/s or m/s."""
    effort: NDArray[np.float64]
    """Limit of the torque or force, N m or N."""
    acceleration: NDArray[np.float64] = UNLIMITED
    """Limit of an acceleration that increases the speed, rad/s^2 or m/s^2."""
    deceleration: NDArray[np.float64] = UNLIMITED
    """Limit of an acceleration that decreases the speed, rad/s^2 or m/s^2."""
    jerk: NDArray[np.float64] = UNLIMITED
    """Limit of the rate of the acceleration, rad/s^3 or m/s^3."""


class Link(NamedTuple):
    """Properties of a link as given by the robot description, without links that are fixed or locked to it. Arrays are
    copies.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> scene.link("link1").parent
    'base'
    """

    name: str
    """Name of the link."""
    mass: float
    """Mass, kg; zero for a link that is only a frame."""
    com: NDArray[np.float64]
    """Center of mass in the link frame, (3,), m."""
    inertia: NDArray[np.float64]
    """Rotational inertia about the center of mass, (3, 3), kg m^2; axes parallel to the link frame."""
    parent: str | None
    """Name of the parent link (inboard); None for the root link."""
    joint: str | None
    """Name of the joint between the parent and this link, fixed or not; None for the root link of a fixed base."""


class Mimic(NamedTuple):
    """Relation that a joint should follow, and does not: multiplier times the coordinate of the other joint, plus
    offset.

    Examples
    --------
    >>> import phipsi
    >>> phipsi.Mimic("finger", multiplier=-1.0, offset=0.0).joint
    'finger'
    """

    joint: str
    """Name of the other joint."""
    multiplier: float
    """Ratio of the coordinates."""
    offset: float
    """Coordinate when the other joint is at zero, rad or m."""


class Joint(NamedTuple):
    """Properties of a joint as given by the robot description; the fields are the arguments of SceneBuilder.joint.
    Arrays are copies.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> scene.joint("joint1").type
    'revolute'
    """

    name: str
    """Name of the joint."""
    type: str
    """"fixed", "revolute", "continuous", "prismatic", "screw", "planar", "universal", "spherical" or "floating"; a locked joint is "fixed"."""
    parent: str | None
    """Name of the parent link (inboard); None for the free joint of a floating base."""
    child: str
    """Name of the child link (outboard)."""
    xyz: NDArray[np.float64]
    """Origin of the child frame at the zero configuration, in the parent frame, (3,), m."""
    rotation: NDArray[np.float64]
    """Rotation matrix from the child frame at the zero configuration to the parent frame, (3, 3)."""
    axis: NDArray[np.float64] | None
    """Unit vector in the child frame, (3,); None if the joint has no axis."""
    pitch: float | None
    """Pitch of a screw joint, m/rad; None for other joints."""
    armature: float
    """Rotor inertia at each degree of freedom, kg m^2 or kg."""
    damping: float
    """Viscous damping, N m s/rad or N s/m."""
    friction: float
    """Coulomb friction, N m or N."""
    stiffness: float
    """Stiffness of the joint spring, N m/rad or N/m."""
    rest: NDArray[np.float64]
    """Joint coordinates at which the spring is at rest, in the layout of q."""
    lower: float
    """Lower limit of the position, rad or m; -inf if there is none."""
    upper: float
    """Upper limit of the position, rad or m; inf if there is none."""
    velocity: float
    """Limit of the speed, rad/s or m/s; inf if there is none."""
    effort: float
    """Limit of the torque or force, N m or N; inf if there is none."""
    acceleration: float
    """Limit of an acceleration that increases the speed, rad/s^2 or m/s^2; inf if there is none."""
    deceleration: float
    """Limit of an acceleration that decreases the speed, rad/s^2 or m/s^2; inf if there is none."""
    jerk: float
    """Limit of the rate of the acceleration, rad/s^3 or m/s^3; inf if there is none."""
    mimic: Mimic | None
    """Relation to another joint that the joint should follow; None if there is none."""
    friction_offset: float = 0.0
    """Half of the difference between friction in the positive and in the negative direction, N m or N."""
    stribeck: float = 0.0
    """Excess of friction at rest over Coulomb friction, N m or N."""
    stribeck_speed: float = 0.1
    """Speed at which that part has decreased to 1/e, rad/s or m/s."""
    load_friction: float = 0.0
    """Friction per torque that the joint transmits."""


def joint_of(described: tuple[Any, ...], has_axis: bool) -> Joint:
    """A joint from the tuple of names and values that pickles contain."""
    name, kind, pitch, parent, child, (rotation, xyz), axis, losses, limits, mimic, (stiffness, rest) = described
    place = np.array(xyz), np.array(rotation).reshape(3, 3), np.array(axis) if has_axis else None
    at_rest = np.array(rest, float)
    losses, terms = losses[:3], losses[3:]
    numbers = pitch, *losses, stiffness, at_rest, *limits
    for array in (*place, at_rest):
        if array is not None:
            array.setflags(write=False)
    return Joint._make((name, kind, parent or None, child, *place, *numbers, Mimic(*mimic) if mimic else None, *terms))


@dataclass(frozen=True)
class Simplification:
    """A simplification of a scene: a computation that is skipped because the results do not depend on it.

    Examples
    --------
    >>> import phipsi
    >>> items = phipsi.load(phipsi.BUNDLED_ARM).plan().items
    >>> all(item.count > 0 for item in items)
    True
    """

    what: str
    """Short description."""
    switch: str | None
    """Name of the simplification in the argument leave_out; None if it cannot be switched."""
    operations: int
    """Number of floating-point operations (multiply-add counts as two) saved in forward dynamics of one state in
    covariance form.

    Zero if the operations were not counted. For simplifications of factor calls, `saved` describes what was counted.
    """
    count: int
    """Number of occurrences."""
    names: tuple[str, ...]
    """Names of the joints or links concerned, if any."""
    why: str
    """Reason why the results do not change."""
    saved: str
    """Computation that is saved."""

    def __repr__(self) -> str:
        return f"<{self.count} {self.what}>"


@dataclass(frozen=True)
class Plan:
    """Simplifications of a scene; its string representation is a list.

    Examples
    --------
    >>> import phipsi
    >>> plan = phipsi.load(phipsi.BUNDLED_ARM).plan()
    >>> plan.bodies, plan.links
    (6, 8)
    """

    bodies: int
    """Number of moving bodies that the sweeps visit."""
    links: int
    """Number of links of the robot description."""
    items: tuple[Simplification, ...]
    """Simplifications that apply to this scene."""

    def __repr__(self) -> str:
        lines = [f"{self.bodies} bodies from {self.links} links; simplifications:"]
        for item in self.items:
            counted = f", {item.operations} operations per call" if item.operations else ""
            lines.append(f"  {item.count} {item.what}: {item.why}; saved {item.saved}{counted}")
        return "\n".join(lines)
