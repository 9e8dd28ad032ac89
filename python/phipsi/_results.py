"""Results with several fields."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from ._motion_parts import ContactGradients, ModeChange
from ._description import Joint, Limits, Link, Mimic, Simplification, Plan, joint_of
from ._summary import summarized

__all__ = [
    "Accuracy",
    "ConstrainedDynamics",
    "ConstrainedInverseDynamics",
    "Distances",
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
    "Simplification",
    "Plan",
    "Projection",
    "RolloutGradients",
    "Samples",
    "joint_of",
]


@summarized
class Accuracy(NamedTuple):
    """Error estimate of forward dynamics, one entry per state: scalars for one state, arrays of the shape of the batch
    otherwise.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> qdd, accuracy = scene.forward_dynamics(q, zero, zero, return_info=True)
    >>> accuracy.form, bool(accuracy.error < 1e-9)
    ('covariance', True)
    """

    form: NDArray[np.str_] | str
    """Form that computed the accelerations: "covariance" or "square-root"; "double-double" if the error
    estimate of form "auto" or "square-root" exceeded the tolerance and the state was recomputed in double-double
    arithmetic.
    """
    error: NDArray[np.float64] | float
    """Estimated error of the largest acceleration, rad/s^2 or m/s^2, typically five to ten times the true error. Of
    10,000 random scenes, ordinary and extreme, one estimate was too small by more than a factor of 20, none by more
    than 1000. NaN if there is no estimate. The rounding of results to float32 is not included.
    """
    bound: NDArray[np.str_] | str
    """Criterion that the error meets: "tolerance", relative to the largest acceleration; "sensitivity", a multiple of
    the change of the accelerations if the forces change by one unit in the last place; "pivots", the bound that the
    pivots and gains of the square-root form give independently of the estimate; "neither", if no form met a
    criterion; "unknown", if there is no estimate.
    """


@summarized
class ConstrainedDynamics(NamedTuple):
    """Joint accelerations of a scene with connections, and the forces of the connections.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> arm = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> tip = arm.placement(q, "link6")[:3, 3]
    >>> loop = arm.to_builder().connect("tip", "point", "link6", other_xyz=tip).build()
    >>> found = loop.loops.dynamics(q, zero, zero)
    >>> found.forces["tip"].shape, found.rank
    ((3,), 3)
    """

    qdd: NDArray[np.float64]
    """Joint accelerations, (..., nv), rad/s^2 or m/s^2."""
    forces: dict[str, NDArray[np.float64]]
    """Force of each connection on its link, by name, (..., rows), N m and N, at the origin of the first frame of the
    connection and expressed in that frame.
    """
    rank: NDArray[np.int64] | int
    """Number of independent constraints: an integer for one state, an array of the shape of the batch otherwise."""
    residual: NDArray[np.float64] | float
    """Largest remaining entry of J qdd + J' qd, rad/s^2 or m/s^2."""


@summarized
class ConstrainedInverseDynamics(NamedTuple):
    """Joint torques of a scene with connections, and the forces of the connections.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> arm = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> tip = arm.placement(q, "link6")[:3, 3]
    >>> loop = arm.to_builder().connect("tip", "point", "link6", other_xyz=tip).build()
    >>> found = loop.loops.inverse_dynamics(q, zero, zero)
    >>> found.tau.shape, found.rank
    ((6,), 3)
    """

    tau: NDArray[np.float64]
    """Joint torques, (..., nv), N m or N; zero at joints without an actuator."""
    forces: dict[str, NDArray[np.float64]]
    """Force of each connection, by name, (..., rows), as in ConstrainedDynamics."""
    rank: NDArray[np.int64] | int
    """Number of independent constraints."""
    residual: NDArray[np.float64] | float
    """Largest entry of J qdd + J' qd, rad/s^2 or m/s^2. A value above rounding shows that the requested accelerations
    violate the constraints.
    """


@summarized
class Projection(NamedTuple):
    """State that satisfies the connections.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> arm = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> tip = arm.placement(q, "link6")[:3, 3]
    >>> loop = arm.to_builder().connect("tip", "point", "link6", other_xyz=tip).build()
    >>> loop.loops.project(q + 1e-3).q.shape
    (6,)
    """

    q: NDArray[np.float64]
    """Configurations, (..., nq)."""
    qd: NDArray[np.float64] | None
    """Joint velocities, (..., nv); None if none were given."""
    rank: NDArray[np.int64] | int
    """Number of independent constraints in this configuration."""


@summarized
class Distances(NamedTuple):
    """Signed distances of k pairs of colliders, in the order of the pairs.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
    >>> builder = builder.collider("ball", phipsi.shapes.Sphere(0.1), link="ball")
    >>> scene = builder.collider("ground", phipsi.shapes.HalfSpace()).build(floating_base=True)
    >>> found = scene.distances([0, 0, 0.3, 0, 0, 0, 1])
    >>> found.first.round(3), found.second.round(3)
    (array([[0. , 0. , 0.2]]), array([[0., 0., 0.]]))
    """

    pairs: tuple[tuple[str, str], ...]
    """Names of the first and the second collider of each pair."""
    distance: NDArray[np.float64]
    """Distance, (..., k), m; negative for penetration, infinite beyond the limit."""
    first: NDArray[np.float64]
    """Nearest point of the first collider in the base frame, (..., k, 3), m; NaN beyond the limit. Nearest points of
    parallel faces are not unique.
    """
    second: NDArray[np.float64]
    """Nearest point of the second collider in the base frame, (..., k, 3), m; NaN beyond the limit."""
    normal: NDArray[np.float64]
    """Unit normal from the first collider to the second in the base frame, (..., k, 3), also for colliders that overlap:
    second - first = distance * normal. NaN beyond the limit.
    """
    gradient: NDArray[np.float64]
    """Derivative of the distance in the tangent space of q, (..., k, nv): n . (J2 - J1) for the Jacobians of the nearest
    points. Zero beyond the limit. Exact where the distance is differentiable.
    """


@summarized
class Energy(NamedTuple):
    """Energy, J: NumPy scalars for one state, arrays of the shape of the batch otherwise.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> round(float(scene.energy(q, zero).kinetic), 3)
    0.0
    """

    kinetic: NDArray[np.float64] | np.float64
    """Kinetic energy qd* M qd / 2, armature included."""
    potential: NDArray[np.float64] | np.float64
    """Potential energy of gravity: minus gravity times the first moment of mass; zero if the center of mass is at the
    origin of the base.
    """


@summarized
class Estimate(NamedTuple):
    """Forces, accelerations and torques, and optionally their covariances, estimated from measured joint torques
    y.

    Blocks of six are (moment, force) in body frames, one per degree of freedom as in phipsi.Factor: reshaped to
    6 nv they are the vectors that the operators of a factor apply to.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> zero = np.zeros(6)
    >>> scene.estimate(zero, zero, zero).force.shape
    (6, 6)
    """

    acceleration: NDArray[np.float64]
    """E(a|y), (..., nv), rad/s^2 or m/s^2 (2.8)."""
    torque: NDArray[np.float64]
    """E(T|y), (..., nv), N m or N, of all joints, measured or not."""
    force: NDArray[np.float64]
    """E(X|y), (..., nv, 6): spatial force through each joint, repeated for all degrees of freedom of a body (2.1)."""
    process: NDArray[np.float64]
    """E(W|y), (..., nv, 6): force that the motion of each body requires, at its outermost degree of freedom;
    zero at the others (2.7).
    """
    log_likelihood: NDArray[np.float64] | np.float64
    """Logarithm of the probability density of the measured torques, (...); zero if none is measured."""
    acceleration_variance: NDArray[np.float64] | None = None
    """Variances of the accelerations, (..., nv), (rad/s^2)^2."""
    torque_variance: NDArray[np.float64] | None = None
    """Variances of the torques, (..., nv), (N m)^2."""
    force_covariance: NDArray[np.float64] | None = None
    """Covariance blocks of the forces, (..., nv, 6, 6) (2.6)."""
    process_covariance: NDArray[np.float64] | None = None
    """Covariance blocks of W, (..., nv, 6, 6) (2.11)."""


if TYPE_CHECKING:

    class _EstimateWithCovariance(Estimate):
        """The result with covariance=True, for type checkers."""

        acceleration_variance: NDArray[np.float64]
        torque_variance: NDArray[np.float64]
        force_covariance: NDArray[np.float64]
        process_covariance: NDArray[np.float64]


@summarized
class InverseDynamicsDerivatives(NamedTuple):
    """Derivatives of joint torques, (..., nv, nv) each; row i belongs to tau_i.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> scene.inverse_dynamics_derivatives(q, zero, zero).dtau_dq.shape
    (6, 6)
    """

    dtau_dq: NDArray[np.float64]
    """Derivatives with respect to the tangent of q: column j is the derivative along integrate(q, v) with respect to
    v_j.
    """
    dtau_dqd: NDArray[np.float64]
    """Derivatives with respect to qd."""
    mass_matrix: NDArray[np.float64]
    """Derivatives with respect to qdd: the mass matrix, full and symmetric, armature included."""

    @property
    def M(self) -> NDArray[np.float64]:
        """Another name of mass_matrix."""
        return self.mass_matrix


@summarized
class ForwardDynamicsDerivatives(NamedTuple):
    """Derivatives of joint accelerations, (..., nv, nv) each; row i belongs to qdd_i.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> scene.forward_dynamics_derivatives(q, zero, zero).mass_matrix_inverse.shape
    (6, 6)
    """

    dqdd_dq: NDArray[np.float64]
    """Derivatives with respect to the tangent of q: column j is the derivative along integrate(q, v) with respect to
    v_j.
    """
    dqdd_dqd: NDArray[np.float64]
    """Derivatives with respect to qd."""
    mass_matrix_inverse: NDArray[np.float64]
    """Derivatives with respect to tau: the inverse of the mass matrix, full and symmetric."""

    @property
    def Minv(self) -> NoReturn:
        """The former name of mass_matrix_inverse: raises AttributeError."""
        raise AttributeError("Minv: found the former name of a field; expected mass_matrix_inverse", name="Minv", obj=self)


@summarized
class InverseDynamicsGradients(NamedTuple):
    """Gradients of a scalar function of joint torques (vjp), or directional derivatives (jvp); fields that were not
    requested are None.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> scene.inverse_dynamics_vjp(q, zero, zero, np.ones(6)).qdd.shape
    (6,)
    """

    q: NDArray[np.float64]
    """With respect to q, in its tangent space, (..., nv): entry j is the derivative along integrate(q, v) with respect
    to v_j.
    """
    qd: NDArray[np.float64]
    """With respect to qd, (..., nv)."""
    qdd: NDArray[np.float64]
    """With respect to qdd, (..., nv): M times the cotangent."""
    wrenches: dict[str, NDArray[np.float64]] | None = None
    """With respect to each given wrench, (..., 6): (moment, force), in the link frame."""
    parameters: NDArray[np.float64] | None = None
    """With respect to the inertial parameters (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) of each link of
    body_names, (..., bodies, 10); I is about the link origin, in the link frame.
    """
    armature: NDArray[np.float64] | None = None
    """With respect to the armature of each degree of freedom, (..., nv)."""
    gravity: NDArray[np.float64] | None = None
    """With respect to gravity in the base frame, (..., 3)."""


@summarized
class ForwardDynamicsGradients(NamedTuple):
    """Gradients of a scalar function of joint accelerations (vjp), or directional derivatives (jvp); fields that were
    not requested are None.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> scene.forward_dynamics_vjp(q, zero, zero, np.ones(6)).tau.shape
    (6,)
    """

    q: NDArray[np.float64]
    """With respect to q, in its tangent space, (..., nv): entry j is the derivative along integrate(q, v) with respect
    to v_j.
    """
    qd: NDArray[np.float64]
    """With respect to qd, (..., nv)."""
    tau: NDArray[np.float64]
    """With respect to tau, (..., nv): M^-1 times the cotangent."""
    wrenches: dict[str, NDArray[np.float64]] | None = None
    """With respect to each given wrench, (..., 6): (moment, force), in the link frame."""
    parameters: NDArray[np.float64] | None = None
    """With respect to the inertial parameters (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) of each link of
    body_names, (..., bodies, 10); I is about the link origin, in the link frame.
    """
    armature: NDArray[np.float64] | None = None
    """With respect to the armature of each degree of freedom, (..., nv)."""
    gravity: NDArray[np.float64] | None = None
    """With respect to gravity in the base frame, (..., 3)."""


@summarized
class RolloutGradients(NamedTuple):
    """Gradients of a scalar function of a trajectory, independently for each state of the batch.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> path = scene.simulate(q, zero, dt=1e-3, steps=10)
    >>> path.vjp(np.ones_like(path.qd)).q.shape
    (6,)
    """

    q: NDArray[np.float64]
    """With respect to the initial q, in its tangent space, (..., nv): entry j is the derivative along integrate(q, v)
    with respect to v_j.
    """
    qd: NDArray[np.float64]
    """With respect to the initial qd, (..., nv)."""
    tau: NDArray[np.float64]
    """With respect to the torques: (..., steps, nv) if tau_steps was given; otherwise (..., nv), summed over all
    steps.
    """
    armature: NDArray[np.float64]
    """With respect to the armature of each degree of freedom, (..., nv)."""
    damping: NDArray[np.float64]
    """With respect to the damping of each degree of freedom, (..., nv)."""
    stiffness: NDArray[np.float64]
    """With respect to the spring stiffness of each degree of freedom, (..., nv)."""
    friction: NDArray[np.float64]
    """With respect to the friction of each degree of freedom, (..., nv)."""
    parameters: NDArray[np.float64] | None = None
    """With respect to the inertial parameters (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) of each link of
    body_names, (..., bodies, 10); I is about the link origin, in the link frame; None if they were not requested.
    """
    contacts: dict[str | tuple[str, str], ContactGradients] = {}  # noqa: RUF012 - never changed
    """With respect to the contacts, by their names, and to pairs of shapes that could touch, by the names of their
    colliders; empty without contacts.
    """
    mode_changes: list[ModeChange] = []  # noqa: RUF012 - never changed
    """Contacts that open, close, stick or slide between two steps, in the order of states and steps. The gradients are
    those of the modes of this trajectory: where a margin of a contact is zero, they are one-sided.
    """
    target: NDArray[np.float64] | None = None
    """With respect to the target of pd, in its tangent space: (..., steps, nv) if targets was given; otherwise (..., nv),
    summed over all steps. None without a control law.
    """
    target_rate: NDArray[np.float64] | None = None
    """With respect to its target velocity, likewise with target_rates."""
    control: NDArray[np.float64] | None = None
    """With respect to the controls, of the shape in which they were given, after the axes of the batch; NaN for
    actuators whose gains depend on the control. None without control.
    """
    wrenches: dict[str, NDArray[np.float64]] | None = None
    """With respect to the wrench on each link, of the shape in which it was given, after the axes of the batch: (..., 6),
    summed over all steps, or (..., steps, 6); in the axes of the wrenches. None without wrenches.
    """


@summarized
class LinearSystem(NamedTuple):
    """Linearization dx/dt = A x + B u, with x = (tangent of q, change of qd) and u the change of tau.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q, zero = np.full(6, 0.3), np.zeros(6)
    >>> system = scene.linearize(q, zero, zero)
    >>> system.A.shape, system.B.shape
    ((12, 12), (12, 6))
    """

    A: NDArray[np.float64]
    """State matrix, (..., 2 nv, 2 nv)."""
    B: NDArray[np.float64]
    """Input matrix, (..., 2 nv, nv)."""


@summarized
class Samples(NamedTuple):
    """Samples of the random model, in body frames, with one block of six per degree of freedom as in Factor.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> scene.random_model(np.zeros(6)).sample(100, seed=1).torque.shape
    (100, 6)
    """

    process: NDArray[np.float64]
    """W, (samples, nv, 6): the force w(k) at the outermost degree of freedom of each body; zero at the others."""
    force: NDArray[np.float64]
    """X = phi W, (samples, nv, 6): the transmitted force."""
    torque: NDArray[np.float64]
    """T = H X + v, (samples, nv), N m or N."""


@summarized
class MassEstimate(NamedTuple):
    """Mass matrix estimated from sampled joint torques, whose covariance it is (5.1).

    For sigma points, all fields except mass_matrix and samples are None.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> model = scene.random_model(np.zeros(6))
    >>> model.mass_matrix(1000, seed=1).samples
    1000
    """

    mass_matrix: NDArray[np.float64]
    """Estimated mass matrix, (nv, nv), symmetric."""
    standard_error: NDArray[np.float64] | None
    """Standard error of each entry."""
    low: NDArray[np.float64] | None
    """Lower bounds of the confidence intervals; the confidence applies to each entry separately, not to all jointly."""
    high: NDArray[np.float64] | None
    """Upper bounds of the confidence intervals."""
    samples: int
    """Number of samples or sigma points."""
    confidence: float | None
    """Confidence level of each interval."""


def _parts(numbers: NDArray[np.float64], nv: int, rows: dict[str, slice]) -> tuple[Any, ...]:
    """Vector, forces by name, rank and residual from (..., nv + m + 2) values; a bad state has rank zero."""
    return by_connection(numbers[..., :nv].copy(), numbers[..., nv:-2], numbers[..., -2], numbers[..., -1], rows)


def by_connection(
    vector: NDArray[np.float64], forces: NDArray[np.float64], rank: NDArray[np.float64], residual: NDArray[np.float64], rows: dict[str, slice]
) -> tuple[Any, ...]:
    """Vector, forces by name, rank and residual."""
    by_name = {name: forces[..., of].copy() for name, of in rows.items()}
    return vector, by_name, _count(rank), float(residual) if residual.ndim == 0 else residual.copy()


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


def distances_of(pairs: tuple[tuple[str, str], ...], numbers: NDArray[np.float64]) -> Distances:
    first, second, normal = (numbers[..., at : at + 3].copy() for at in (1, 4, 7))
    return Distances(pairs, numbers[..., 0].copy(), first, second, normal, numbers[..., 10:].copy())
