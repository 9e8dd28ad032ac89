"""Results of several parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Accuracy",
    "ConstrainedDynamics",
    "ConstrainedInverseDynamics",
    "Energy",
    "Estimate",
    "ForwardDynamicsDerivatives",
    "ForwardDynamicsGradients",
    "InverseDynamicsDerivatives",
    "InverseDynamicsGradients",
    "Joint",
    "Limits",
    "LinearSystem",
    "Link",
    "MassEstimate",
    "Mimic",
    "Omission",
    "Plan",
    "Projection",
    "RolloutGradients",
    "Samples",
]


class Accuracy(NamedTuple):
    """What forward dynamics knows of its own accuracy: one entry a state, plain values for one state, arrays of the batch's shape for many."""

    form: NDArray[np.str_] | str
    """The form that gave the accelerations: "covariance" or "square-root", or "double-double" where form "auto" or "square-root"
    was still in doubt and did the state once more with twice the digits."""
    error: NDArray[np.float64] | float
    """The estimated error of the largest acceleration, rad/s^2 or m/s^2: as a rule five to ten times the true one. Of 10,000 random
    scenes, ordinary and extreme, one is off by more than 20 times it, none by more than 1000 times; NaN where there is no estimate (float32, but for "auto")."""
    bound: NDArray[np.str_] | str
    """The bound that the error meets: "tolerance", relative to the largest acceleration; "sensitivity", some times what one unit in the last place of the forces makes of the accelerations;
    "pivots", of the square-root form, whose pivots and gains bound its rounding whatever the estimate; "neither", where there was nothing better; "unknown", where there is no estimate."""


class ConstrainedDynamics(NamedTuple):
    """Accelerations through connections, and what the connections do for it."""

    qdd: NDArray[np.float64]
    """Joint accelerations, (..., nv), rad/s^2 or m/s^2."""
    forces: dict[str, NDArray[np.float64]]
    """Of each connection by name, (..., rows): what it does to its link, N m and N, at the origin of its first frame and in that frame's axes."""
    rank: NDArray[np.int64] | int
    """How many rows are independent: a number for one state, an array of the batch's shape for many."""
    residual: NDArray[np.float64] | float
    """The largest entry of J qdd + J' qd that is left, rad/s^2 or m/s^2."""


class ConstrainedInverseDynamics(NamedTuple):
    """Torques through connections, and what the connections do for it."""

    tau: NDArray[np.float64]
    """Joint torques, (..., nv), N m or N; zero at joints that are not actuated."""
    forces: dict[str, NDArray[np.float64]]
    """Of each connection by name, (..., rows), as in ConstrainedDynamics."""
    rank: NDArray[np.int64] | int
    """How many rows are independent."""
    residual: NDArray[np.float64] | float
    """The largest entry of J qdd + J' qd, rad/s^2 or m/s^2: what is no rounding no torques can give."""


class Projection(NamedTuple):
    """A state that meets the connections."""

    q: NDArray[np.float64]
    """Configurations, (..., nq)."""
    qd: NDArray[np.float64] | None
    """Rates, (..., nv); None where none were given."""
    rank: NDArray[np.int64] | int
    """How many rows are independent there."""


class Energy(NamedTuple):
    """Energy, J: NumPy scalars for one state, arrays of the batch's shape for many."""

    kinetic: NDArray[np.float64] | np.float64
    """Half of qd M qd, armature included."""
    potential: NDArray[np.float64] | np.float64
    """Minus gravity times the first moment of mass; zero with the mass centre at the base's origin."""


class Estimate(NamedTuple):
    """What measured joint torques y tell of forces, accelerations and torques: conditional means, and covariances if asked for.

    Blocks of six are (moment, force) in body frames, one a degree of freedom as in phipsi.Factor: reshaped to 6 nv they are what
    its operators apply to.
    """

    acceleration: NDArray[np.float64]
    """E(a|y), (..., nv), rad/s^2 or m/s^2 (2.8)."""
    torque: NDArray[np.float64]
    """E(T|y), (..., nv), N m or N: all joints, measured or not."""
    force: NDArray[np.float64]
    """E(X|y), (..., nv, 6): the spatial force through each joint, a body's own at all its degrees of freedom (2.1)."""
    process: NDArray[np.float64]
    """E(W|y), (..., nv, 6): what each body's own motion needs, at its outermost degree of freedom, zeros elsewhere (2.7)."""
    log_likelihood: NDArray[np.float64] | np.float64
    """log of the density of the measured torques, (...); zero where none is measured."""
    acceleration_variance: NDArray[np.float64] | None = None
    """Variances of the accelerations, (..., nv), (rad/s^2)^2."""
    torque_variance: NDArray[np.float64] | None = None
    """Variances of the torques, (..., nv), (N m)^2."""
    force_covariance: NDArray[np.float64] | None = None
    """Covariance blocks of the forces, (..., nv, 6, 6) (2.6)."""
    process_covariance: NDArray[np.float64] | None = None
    """Covariance blocks of W, (..., nv, 6, 6) (2.11)."""


class InverseDynamicsDerivatives(NamedTuple):
    """Derivatives of joint torques, (..., nv, nv) each: row i is tau_i."""

    dtau_dq: NDArray[np.float64]
    """By the tangent of q: column j is the derivative along integrate(q, v) by v_j."""
    dtau_dqd: NDArray[np.float64]
    """By qd."""
    M: NDArray[np.float64]
    """By qdd: the mass matrix, full and symmetric, armature on its diagonal."""


class ForwardDynamicsDerivatives(NamedTuple):
    """Derivatives of joint accelerations, (..., nv, nv) each: row i is qdd_i."""

    dqdd_dq: NDArray[np.float64]
    """By the tangent of q: column j is the derivative along integrate(q, v) by v_j."""
    dqdd_dqd: NDArray[np.float64]
    """By qd."""
    Minv: NDArray[np.float64]
    """By tau: the inverse of the mass matrix, full and symmetric."""


class InverseDynamicsGradients(NamedTuple):
    """Gradients of a scalar of joint torques, or how they change along a direction; what was not asked for is None."""

    q: NDArray[np.float64]
    """By q, in its tangent space, (..., nv): entry j along integrate(q, v) by v_j."""
    qd: NDArray[np.float64]
    """By qd, (..., nv)."""
    qdd: NDArray[np.float64]
    """By qdd, (..., nv): M times the cotangent."""
    wrenches: dict[str, NDArray[np.float64]] | None = None
    """By each wrench that was given, (..., 6): (moment, force), in its link's frame."""
    parameters: NDArray[np.float64] | None = None
    """By (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) of each link of body_names, (..., bodies, 10), I about the link's origin, all in the link's frame."""
    armature: NDArray[np.float64] | None = None
    """By the armature of each degree of freedom, (..., nv)."""
    gravity: NDArray[np.float64] | None = None
    """By gravity in the base frame, (..., 3)."""


class ForwardDynamicsGradients(NamedTuple):
    """Gradients of a scalar of joint accelerations, or how they change along a direction; what was not asked for is None."""

    q: NDArray[np.float64]
    """By q, in its tangent space, (..., nv): entry j along integrate(q, v) by v_j."""
    qd: NDArray[np.float64]
    """By qd, (..., nv)."""
    tau: NDArray[np.float64]
    """By tau, (..., nv): M^-1 times the cotangent."""
    wrenches: dict[str, NDArray[np.float64]] | None = None
    """By each wrench that was given, (..., 6): (moment, force), in its link's frame."""
    parameters: NDArray[np.float64] | None = None
    """By (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) of each link of body_names, (..., bodies, 10), I about the link's origin, all in the link's frame."""
    armature: NDArray[np.float64] | None = None
    """By the armature of each degree of freedom, (..., nv)."""
    gravity: NDArray[np.float64] | None = None
    """By gravity in the base frame, (..., 3)."""


class RolloutGradients(NamedTuple):
    """Gradients of a function of a trajectory, of each state by itself."""

    q: NDArray[np.float64]
    """By q at the start, in its tangent space, (..., nv): entry j along integrate(q, v) by v_j."""
    qd: NDArray[np.float64]
    """By qd at the start, (..., nv)."""
    tau: NDArray[np.float64]
    """By the torques: (..., steps, nv) where tau_steps was given, else (..., nv), all steps together."""
    armature: NDArray[np.float64]
    """By the armature of each degree of freedom, (..., nv)."""
    damping: NDArray[np.float64]
    """By its damping, (..., nv)."""
    stiffness: NDArray[np.float64]
    """By its spring's stiffness, (..., nv)."""
    friction: NDArray[np.float64]
    """By its friction, (..., nv)."""
    parameters: NDArray[np.float64] | None = None
    """By (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) of each link of body_names, (..., bodies, 10), I about the link's origin, all in the link's frame; None where not asked for."""


class LinearSystem(NamedTuple):
    """dx/dt = A x + B u for small deviations x = (tangent of q, change of qd) and changes u of tau."""

    A: NDArray[np.float64]
    """(..., 2 nv, 2 nv)."""
    B: NDArray[np.float64]
    """(..., 2 nv, nv)."""


class Limits(NamedTuple):
    """Limits by degree of freedom, (nv,) each; infinite where there is none."""

    lower: NDArray[np.float64]
    """Smallest position, rad or m."""
    upper: NDArray[np.float64]
    """Largest position, rad or m."""
    velocity: NDArray[np.float64]
    """Largest speed, rad/s or m/s."""
    effort: NDArray[np.float64]
    """Largest torque or force, N m or N."""


class Link(NamedTuple):
    """A link as it was given; what is locked or fixed onto it is not in its numbers. Arrays are copies."""

    name: str
    """Its name."""
    mass: float
    """Mass, kg; zero for a link that is a mere frame."""
    com: NDArray[np.float64]
    """Mass centre in the link's frame, (3,), m."""
    inertia: NDArray[np.float64]
    """Rotational inertia about the mass centre, axes parallel to the link's frame, (3, 3), kg m^2."""
    parent: str | None
    """Name of the link on the base's side; None for the root link."""
    joint: str | None
    """Name of the joint that carries it, fixed or not; None for the root link of a fixed base."""


class Mimic(NamedTuple):
    """What a joint should follow: multiplier times the other's coordinate, plus offset. It is not followed."""

    joint: str
    """Name of the other joint."""
    multiplier: float
    """Ratio of the coordinates."""
    offset: float
    """Coordinate where the other is at zero, rad or m."""


class Joint(NamedTuple):
    """A joint as it was given, by the names of SceneBuilder.joint. Arrays are copies."""

    name: str
    """Its name."""
    type: str
    """"fixed", "revolute", "continuous", "prismatic", "screw", "planar", "universal", "spherical" or "floating"; a locked joint is "fixed"."""
    parent: str | None
    """Name of the link on the base's side; None for the free joint of a floating base."""
    child: str
    """Name of the link that it carries."""
    xyz: NDArray[np.float64]
    """Origin of the child's frame at zero configuration, in the parent's frame, (3,), m."""
    rotation: NDArray[np.float64]
    """Axes of the child's frame there, (3, 3): the columns in the parent's frame."""
    axis: NDArray[np.float64] | None
    """Unit vector in the child's frame, (3,); None where the joint has no axis."""
    pitch: float | None
    """Advance of a screw, m/rad; None for others."""
    armature: float
    """Inertia of the rotor at each degree of freedom, kg m^2 or kg."""
    damping: float
    """Viscous damping, N m s/rad or N s/m."""
    friction: float
    """Coulomb friction, N m or N."""
    stiffness: float
    """Stiffness of the spring, N m/rad or N/m."""
    rest: NDArray[np.float64]
    """The joint's coordinates where the spring is at rest, as many as it has in q."""
    lower: float
    """Smallest position, rad or m; -inf where there is none."""
    upper: float
    """Largest position, rad or m; inf where there is none."""
    velocity: float
    """Largest speed, rad/s or m/s; inf where there is none."""
    effort: float
    """Largest torque or force, N m or N; inf where there is none."""
    mimic: Mimic | None
    """The joint that it should follow; None for most."""


def joint_of(described: tuple[Any, ...], has_axis: bool) -> Joint:
    """A joint from the numbers and names that it was given, as pickles have them."""
    name, kind, pitch, parent, child, (rotation, xyz), axis, losses, limits, mimic, (stiffness, rest) = described
    place = np.array(xyz), np.array(rotation).reshape(3, 3), np.array(axis) if has_axis else None
    numbers = pitch, *losses, stiffness, np.array(rest, float), *limits
    return Joint._make((name, kind, parent or None, child, *place, *numbers, Mimic(*mimic) if mimic else None))


class Samples(NamedTuple):
    """Samples of the spatially random model, in body frames, a block of six a degree of freedom as in Factor."""

    process: NDArray[np.float64]
    """W, (samples, nv, 6): the force w(k) at the outermost degree of freedom of a body, zero at its others."""
    force: NDArray[np.float64]
    """X = phi W, (samples, nv, 6): the force transmitted there."""
    torque: NDArray[np.float64]
    """T = H X + v, (samples, nv), N m or N."""


class MassEstimate(NamedTuple):
    """The mass matrix as the covariance of sampled torques (5.1); all but the first and samples are None for sigma points."""

    mass_matrix: NDArray[np.float64]
    """The estimate, (nv, nv), symmetric."""
    standard_error: NDArray[np.float64] | None
    """Standard error of each entry."""
    low: NDArray[np.float64] | None
    """Lower ends of the confidence intervals; each holds its entry with the stated confidence, not all at once."""
    high: NDArray[np.float64] | None
    """Upper ends."""
    samples: int
    """Points that were used."""
    confidence: float | None
    """Of each interval."""


@dataclass(frozen=True)
class Omission:
    """One thing that a scene does not need and that was left out."""

    what: str
    """What, in a few words."""
    switch: str | None
    """The name in leave_out that stands for it; None where there is one way to compute only."""
    operations: int
    """Floating-point operations (a product with a sum is two) that forward dynamics of one state in covariance form does less.

    In a call that needs nothing of this; 0 where nothing was counted. Items of calls on the factor say beside what they count.
    """
    count: int
    """How many."""
    names: tuple[str, ...]
    """The joints or links, where they have names."""
    why: str
    """Why the results are the same without it."""
    saved: str
    """What that saved."""

    def __repr__(self) -> str:
        return f"<{self.count} {self.what}>"


@dataclass(frozen=True)
class Plan:
    """What a scene does not need, and what leaving it out saved; printed, it is a list."""

    bodies: int
    """Moving bodies that the sweeps visit."""
    links: int
    """Links that the scene was built from."""
    items: tuple[Omission, ...]
    """What was left out; only what this scene had."""

    def __repr__(self) -> str:
        lines = [f"{self.bodies} bodies from {self.links} links; left out:"]
        for item in self.items:
            counted = f", {item.operations} operations a call" if item.operations else ""
            lines.append(f"  {item.count} {item.what}: {item.why}; saved {item.saved}{counted}")
        return "\n".join(lines)


def _parts(numbers: NDArray[np.float64], nv: int, rows: dict[str, slice]) -> tuple[Any, ...]:
    """The vector, the forces by name, rank and residual of (..., nv + m + 2) numbers; a bad state has rank zero."""
    vector, forces, rank, residual = numbers[..., :nv], numbers[..., nv:-2], numbers[..., -2], numbers[..., -1]
    by_name = {name: forces[..., of].copy() for name, of in rows.items()}
    return vector.copy(), by_name, _count(rank), float(residual) if residual.ndim == 0 else residual.copy()


def _count(numbers: NDArray[np.float64]) -> NDArray[np.int64] | int:
    whole = np.nan_to_num(numbers).astype(np.int64)
    return int(whole) if whole.ndim == 0 else whole


def constrained_dynamics(numbers: NDArray[np.float64], nv: int, rows: dict[str, slice]) -> ConstrainedDynamics:
    return ConstrainedDynamics(*_parts(numbers, nv, rows))


def constrained_inverse_dynamics(numbers: NDArray[np.float64], nv: int, rows: dict[str, slice]) -> ConstrainedInverseDynamics:
    return ConstrainedInverseDynamics(*_parts(numbers, nv, rows))


def projection(numbers: NDArray[np.float64], nq: int, is_moving: bool) -> Projection:
    q, qd, rank = numbers[..., :nq].copy(), numbers[..., nq:-1].copy(), numbers[..., -1]
    return Projection(q, qd if is_moving else None, _count(rank))
