"""Expected cost and error bands of the closed loop of a plan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._arguments import numbers
from .._summary import summarized
from ..errors import ArgumentError, ShapeError, of_argument
from ..estimation.trajectories import MotionUncertainty
from ..estimation.uncertainty import ParameterCovariance, _joint_covariance, _per_joint, covariance_root

if TYPE_CHECKING:
    from .._core import _Optimizer
    from ._plan import MotionPlan

__all__ = ["Expected", "expected"]

_Array = NDArray[np.float64]


@summarized
class Expected(NamedTuple):
    """Cost and motion of the closed loop under uncertainty, to first order in the deviations.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi import control, estimation
    >>> scene = phipsi.scenes.chain(3)
    >>> goal = control.Terminal(control.State([0.5] * 3, position=0.01, velocity=0.1))
    >>> plan = scene.optimize([0.0] * 3, dt=0.02, steps=50, costs=[control.Effort(10.0), goal])
    >>> found = plan.expected(estimation.MotionUncertainty(torque_noise=1e-3))
    >>> bool(found.cost > plan.cost), found.q.shape
    (True, (51, 3))
    """

    cost: float
    """Expected cost of the motion under the feedback law, in which no limit of effort is reached."""
    q: _Array
    """Standard deviations of q in its tangent space, (steps + 1, nv), rad or m."""
    qd: _Array
    """Standard deviations of qd, (steps + 1, nv), rad/s or m/s."""
    tau: _Array
    """Standard deviations of the joint torques of the law, (steps, nv), N m or N."""
    covariance: _Array
    """Covariance of (q in its tangent space, qd), (steps + 1, 2 nv, 2 nv)."""


class _Loop(NamedTuple):
    """The closed loop of a plan to first order, x = (q in its tangent space, qd, torques of the step before with a cost
    of their rate): x' = A x + B u, u = -K x, with noise and with errors that are constant along the motion.
    """

    a: _Array
    b: _Array
    by_torque: _Array
    hessian: _Array
    """Second derivatives of the cost by (x, u), (steps + 1, n + m, n + m)."""
    gains: _Array
    covariance: _Array
    """Of x by the start and by noise, (steps + 1, n, n)."""
    sensitivity: _Array
    """x for each column of the root of the covariance of the constant errors, (steps + 1, n, r)."""

    def whole(self) -> _Array:
        """Covariance of x, (steps + 1, n, n)."""
        return self.covariance + self.sensitivity @ np.swapaxes(self.sensitivity, 1, 2)

    def laws(self) -> _Array:
        """(x, u) by x, (steps + 1, n + m, n); u is zero at the end."""
        steps, n, m = self.b.shape
        laws = np.zeros((steps + 1, n + m, n))
        laws[:, :n] = np.eye(n)
        laws[:-1, n:] = -self.gains
        return laws

    def excess(self) -> float:
        """Expected cost beyond that of the motion."""
        laws = self.laws()
        return 0.5 * float(np.sum(self.hessian * (laws @ self.whole() @ np.swapaxes(laws, 1, 2))))


def read_uncertainty(uncertainty: Any) -> MotionUncertainty:
    """An uncertainty as the user gives it."""
    given = uncertainty if isinstance(uncertainty, MotionUncertainty) else MotionUncertainty(parameters=uncertainty)
    if given.check is not None:
        raise of_argument(ArgumentError, "uncertainty", f"found check={given.check!r}; expected None: simulate noisy runs to check a plan")
    return given


def linearized(free: _Optimizer, q: _Array, qd: _Array, tau: _Array) -> tuple[_Array, ...]:
    """A, B, the derivatives by torques and the Hessians about knots that need not follow each other."""
    free.solve((q[0], qd[0]), tau, (np.ascontiguousarray(q[1:]), np.ascontiguousarray(qd[1:])), 0)
    a, b, by_torque, hessian = free.linearization()[0]
    return a, b, by_torque, hessian


def closed_loop(plan: MotionPlan, given: MotionUncertainty, free: _Optimizer) -> _Loop:
    """The closed loop of a plan; free: an optimizer of its costs without limits, whose weights are not part of the cost."""
    driven = plan._problem.driven
    a, b, by_torque, hessian = linearized(free, plan.q, plan.qd, plan.tau)
    steps, n, nv = len(a), a.shape[1], plan.scene.nv
    gains = plan.gains[:, driven, :]
    if plan.rate_gains is not None:
        gains = np.concatenate([gains, plan.rate_gains[:, driven][:, :, driven]], axis=2)
    noise = noise_of(plan, given, by_torque)
    constant = constant_errors(plan, given, (plan.q[:-1], plan.qd[:-1], plan.qd[1:]), by_torque, n)
    covariance = np.zeros((steps + 1, n, n))
    covariance[0, : 2 * nv, : 2 * nv] = _initial(given, nv)
    sensitivity = np.zeros((steps + 1, n, constant.shape[2]))
    for k in range(steps):
        closed = a[k] - b[k] @ gains[k]
        covariance[k + 1] = closed @ covariance[k] @ closed.T
        covariance[k + 1, : 2 * nv, : 2 * nv] += noise[k] @ noise[k].T
        sensitivity[k + 1] = closed @ sensitivity[k] + constant[k]
    return _Loop(a, b, by_torque, hessian, gains, covariance, sensitivity)


def expected(plan: MotionPlan, uncertainty: Any) -> Expected:
    """MotionPlan.expected."""
    loop, nv = closed_loop(plan, read_uncertainty(uncertainty), plan._problem.free()), plan.scene.nv
    whole = loop.whole()
    deviations = np.sqrt(np.maximum(np.diagonal(whole, axis1=1, axis2=2), 0.0))
    efforts = np.zeros((len(plan.tau), nv))
    of_law = loop.gains @ whole[:-1] @ np.swapaxes(loop.gains, 1, 2)
    efforts[:, plan._problem.driven] = np.sqrt(np.maximum(np.diagonal(of_law, axis1=1, axis2=2), 0.0))
    states = np.ascontiguousarray(whole[:, : 2 * nv, : 2 * nv])
    return Expected(plan.cost + loop.excess(), deviations[:, :nv], deviations[:, nv : 2 * nv], efforts, states)


def noise_of(plan: MotionPlan, given: MotionUncertainty, by_torque: _Array) -> _Array:
    """Root of the covariance that a step adds to (q, qd), (..., 2 nv, nv)."""
    spread: _Array = by_torque * np.sqrt(_per_joint(plan.scene, "torque_noise", given.torque_noise) / plan.dt)
    return spread


def _initial(given: MotionUncertainty, nv: int) -> _Array:
    """Covariance of the initial state."""
    if given.initial is None:
        return np.zeros((2 * nv, 2 * nv))
    array = numbers("initial", given.initial)
    array = np.diag(array) if array.shape == (2 * nv,) else array
    if array.shape != (2 * nv, 2 * nv):
        raise of_argument(ShapeError, "initial", f"found shape {array.shape}; expected {(2 * nv, 2 * nv)}, or {(2 * nv,)} for variances")
    root = covariance_root("initial", array)
    return root @ root.T


def constant_errors(
    plan: MotionPlan, given: MotionUncertainty, motion: tuple[_Array, _Array, _Array], by_torque: _Array, n: int
) -> _Array:
    """Change of the next x by errors that are constant along the motion, for each column of the root of their
    covariance, (steps, n, r); motion: q and qd before and qd after each step.
    """
    scene, nv, (q, qd, after) = plan.scene, plan.scene.nv, motion
    steps, accelerations = len(q), (after - qd) / plan.dt
    torques: list[_Array] = []
    parameters = ParameterCovariance(scene, given.parameters)
    if len(parameters.columns):
        by_parameters = scene.regressor(q, qd, accelerations)
        torques.append(np.einsum("kibp,cbp->kic", by_parameters, parameters.columns))
        torques[0] += np.moveaxis(np.broadcast_to(parameters._extra_torques(q, qd, accelerations), (len(parameters.columns), steps, nv)), 0, 2)
    joints = _joint_covariance(scene, given.joints, parameters)
    if joints is not None:
        # Armature, damping and friction at the end of the step, and offset.
        chord = 1.0 / np.hypot(qd, plan._problem.friction_speed)
        effects = np.stack([accelerations, after, after * chord, np.ones_like(qd)], axis=-1)
        for row in range(nv):
            root = covariance_root(f"joints[{row}]", joints[row])
            torque = np.zeros((steps, nv, root.shape[1]))
            torque[:, row] = effects[:, row] @ root
            torques.append(torque)
    result = np.zeros((steps, n, sum(torque.shape[2] for torque in torques)))
    if torques:
        result[:, : 2 * nv] = -by_torque @ np.concatenate(torques, axis=2)
    return result
