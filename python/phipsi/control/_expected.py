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


def expected(plan: MotionPlan, uncertainty: Any) -> Expected:
    """MotionPlan.expected."""
    given = uncertainty if isinstance(uncertainty, MotionUncertainty) else MotionUncertainty(parameters=uncertainty)
    if given.check is not None:
        raise of_argument(ArgumentError, "uncertainty", f"found check={given.check!r}; expected None: simulate noisy runs to check a plan")
    (a, b, by_torque, hessian), driven = plan._problem.optimizer.linearization()
    steps, n, m = b.shape
    nv = plan.scene.nv
    gains = plan.gains[:, driven, :]
    if plan.rate_gains is not None:
        gains = np.concatenate([gains, plan.rate_gains[:, driven][:, :, driven]], axis=2)
    noise = np.zeros((steps, n, nv))
    noise[:, : 2 * nv] = by_torque * np.sqrt(_per_joint(plan.scene, "torque_noise", given.torque_noise) / plan.dt)
    constant = _constant(plan, given, by_torque, n)
    covariance = np.zeros((n, n))
    covariance[: 2 * nv, : 2 * nv] = _initial(given, nv)
    sensitivity = np.zeros((n, constant.shape[2]))
    excess, states, efforts = 0.0, [], []
    for k in range(steps + 1):
        whole = covariance + sensitivity @ sensitivity.T
        states.append(whole[: 2 * nv, : 2 * nv])
        law = np.concatenate([np.eye(n), -gains[k] if k < steps else np.zeros((m, n))])
        excess += 0.5 * float(np.sum(hessian[k] * (law @ whole @ law.T)))
        if k == steps:
            break
        spread = np.zeros(nv)
        spread[driven] = np.sqrt(np.maximum(np.diagonal(gains[k] @ whole @ gains[k].T), 0.0))
        efforts.append(spread)
        closed = a[k] - b[k] @ gains[k]
        covariance = closed @ covariance @ closed.T + noise[k] @ noise[k].T
        sensitivity = closed @ sensitivity + constant[k]
    all_states = np.array(states)
    deviations = np.sqrt(np.maximum(np.diagonal(all_states, axis1=1, axis2=2), 0.0))
    return Expected(plan.cost + excess, deviations[:, :nv], deviations[:, nv:], np.array(efforts), all_states)


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


def _constant(plan: MotionPlan, given: MotionUncertainty, by_torque: _Array, n: int) -> _Array:
    """Change of the next state by errors that are constant along the motion, for each column of the root of their
    covariance, (steps, n, r).
    """
    scene, steps, nv = plan.scene, len(plan.tau), plan.scene.nv
    q, qd, after = plan.q[:-1], plan.qd[:-1], plan.qd[1:]
    accelerations = (after - qd) / plan.dt
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
