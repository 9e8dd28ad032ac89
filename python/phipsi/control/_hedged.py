"""Plans of least expected cost: the motion of least cost is moved to where errors cost less."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..estimation.trajectories import MotionUncertainty
from ._expected import closed_loop, constant_errors, linearized, noise_of
from ._terms import During, Effort, State

if TYPE_CHECKING:
    from .._core import _Optimizer
    from ._plan import MotionPlan

_Array = NDArray[np.float64]

#: Largest number of changes of the motion, and of those in sequence that do not decrease the expected cost.
ROUNDS = 100
FAILURES = 6
#: Difference of q (rad or m), qd (rad/s or m/s) and torques (their largest magnitude) between two linearizations: the
#: error of first derivatives is its square, that of second ones the rounding divided by it.
STEP = 1e-4
#: Curvatures of coordinates below this share of the largest are raised to it.
FLAT = 1e-6


class Gradient(NamedTuple):
    """Derivatives of the expected cost beyond that of the motion, by the coordinates of the knots."""

    by_q: _Array
    by_qd: _Array
    by_tau: _Array
    curvature: tuple[_Array, ...]
    """Magnitudes of the second derivatives by each coordinate of each knot."""


def hedged(
    plan: MotionPlan,
    given: MotionUncertainty,
    search: Callable[[MotionPlan, list[Any]], MotionPlan],
    tolerance: float,
) -> MotionPlan:
    """The plan of least expected cost near a plan.

    search: a plan from a plan, with further terms. The excess of
    the expected cost is replaced by its gradient and a bound on its curvature, which are targets for states and
    torques; a round is a search with these. Rounds that increase the expected cost are made again with more curvature.
    """
    free = plan._problem.free()
    best = plan.cost + closed_loop(plan, given, free).excess()
    stiffness, failures, reason = 1.0, 0, "the largest number of rounds"
    gradient = gradient_of(plan, given, free)
    for _ in range(ROUNDS):
        moved = search(plan, _terms(plan, gradient, stiffness))
        # The law about the new motion, without the further terms.
        moved = plan._problem.solve((moved.q[0], moved.qd[0]), moved.tau, (moved.q[1:], moved.qd[1:]), 0)
        found = moved.cost + closed_loop(moved, given, free).excess()
        if not found < best:
            stiffness, failures = 4.0 * stiffness, failures + 1
            if failures > FAILURES:
                reason = "no change of the motion decreases the expected cost"
                break
            continue
        decrease, best, plan = best - found, found, moved
        if decrease <= tolerance * abs(best):
            reason = "the expected cost has no further decrease"
            break
        stiffness, failures = 0.5 * stiffness, 0
        gradient = gradient_of(plan, given, free)
    else:
        return dataclasses.replace(plan, converged=False, reason=reason)
    return dataclasses.replace(plan, converged=True, reason=reason)


def _terms(plan: MotionPlan, gradient: Gradient, stiffness: float) -> list[Any]:
    """g x + c x^2 / 2 of the deviations from a motion, as costs of states and torques."""
    scene, steps = plan.scene, len(plan.tau)
    c_q, c_qd, c_tau = (_raised(stiffness * c, g) for c, g in zip(gradient.curvature, gradient[:3], strict=True))
    q = scene.integrate(plan.q, -gradient.by_q / c_q)
    qd, tau = plan.qd - gradient.by_qd / c_qd, plan.tau - gradient.by_tau / c_tau
    terms: list[Any] = []
    for k in range(1, steps + 1):
        scale = plan.dt if k < steps else 1.0
        terms.append(During(State(q[k], qd[k], np.sqrt(scale / c_q[k]), np.sqrt(scale / c_qd[k])), k, k))
    return terms + [During(Effort(np.sqrt(plan.dt / c_tau[k]), tau[k]), k, k) for k in range(steps)]


def _raised(curvature: _Array, gradient: _Array) -> _Array:
    """Curvatures that are positive: those of coordinates without any are small against their gradient."""
    least = max(FLAT * float(curvature.max(initial=0.0)), float(np.abs(gradient).max(initial=0.0)), float(np.finfo(float).tiny) ** 0.5)
    return np.where(curvature > FLAT * curvature.max(initial=0.0), curvature, least)


def gradient_of(plan: MotionPlan, given: MotionUncertainty, free: _Optimizer) -> Gradient:
    """Gradient of the expected excess.

    The excess depends on a knot through A, B, the noise and the Hessian there. With the covariance before it and the
    second derivatives P of the excess after it (the value of the closed loop), its change is that of
    tr(P (A - B K) S (A - B K)*) / 2 and of similar terms: differences of linearizations. The gains are those of least
    cost under noise, so that their change has no effect on its part; that of errors which are constant along the motion
    has, by the adjoint of the Riccati recursion.
    """
    scene, nv = plan.scene, plan.scene.nv
    loop = closed_loop(plan, given, free)
    steps, n, _ = loop.b.shape
    laws, whole = loop.laws(), loop.whole()
    value, co_state = np.zeros((steps + 1, n, n)), np.zeros((steps + 1, n, loop.sensitivity.shape[2]))
    weights = np.swapaxes(laws, 1, 2) @ loop.hessian @ laws
    for k in reversed(range(steps + 1)):
        value[k], co_state[k] = weights[k], weights[k] @ loop.sensitivity[k]
        if k < steps:
            closed = loop.a[k] - loop.b[k] @ loop.gains[k]
            value[k] += closed.T @ value[k + 1] @ closed
            co_state[k] += closed.T @ co_state[k + 1]
    spread = laws @ whole @ np.swapaxes(laws, 1, 2)
    of_gains, of_value = _through_gains(loop, laws, value, co_state)

    def excess(system: tuple[_Array, ...], motion: tuple[_Array, _Array, _Array]) -> _Array:
        """Parts of the excess that depend on each knot, (steps + 1,)."""
        a, b, by_torque, hessian = system
        closed, noise = a - b @ loop.gains, noise_of(plan, given, by_torque)
        parts: _Array = 0.5 * np.sum(hessian * spread, axis=(1, 2))
        parts[:-1] += 0.5 * np.sum(value[1:] * (closed @ loop.covariance[:-1] @ np.swapaxes(closed, 1, 2)), axis=(1, 2))
        parts[:-1] += 0.5 * np.sum((value[1:, : 2 * nv, : 2 * nv] @ noise) * noise, axis=(1, 2))
        constant = constant_errors(plan, given, motion, by_torque, n)
        parts[:-1] += np.sum(co_state[1:] * (closed @ loop.sensitivity[:-1] + constant), axis=(1, 2))
        if of_value.any():
            by_law = hessian @ laws
            parts += np.sum(of_value * (np.swapaxes(laws, 1, 2) @ by_law), axis=(1, 2))
            ahead = value[1:] @ closed
            parts[:-1] += np.sum(of_value[:-1] * (np.swapaxes(closed, 1, 2) @ ahead), axis=(1, 2))
            parts[:-1] += np.sum(of_gains * (by_law[:-1, n:] + np.swapaxes(b, 1, 2) @ ahead), axis=(1, 2))
        return parts

    middle = excess((loop.a, loop.b, loop.by_torque, loop.hessian), (plan.q[:-1], plan.qd[:-1], plan.qd[1:]))
    by = [np.zeros((steps + 1, nv)), np.zeros((steps + 1, nv)), np.zeros((steps + 1, nv))]
    second = [np.zeros((steps + 1, nv)) for _ in range(3)]
    for which, column, size, knots in _directions(plan):
        found = []
        for sign in (size, -size):
            q, qd, tau = plan.q.copy(), plan.qd.copy(), plan.tau.copy()
            step = np.zeros(nv)
            step[column] = sign
            before = knots[knots < steps]
            if which == 0:
                q[knots] = scene.integrate(q[knots], step)
            elif which == 1:
                qd[knots, column] += sign
            else:
                tau[before, column] += sign
            # The velocities after the step, which A and B contain through friction and rotations.
            after = loop.by_torque[before, nv:, column] if which == 2 else loop.a[before, nv : 2 * nv, which * nv + column]
            qd[before + 1] += sign * after
            motion = q[:-1].copy(), qd[:-1].copy(), plan.qd[1:].copy()
            motion[2][before] = qd[before + 1]
            found.append(excess(linearized(free, q, qd, tau), motion)[knots])
        by[which][knots, column] = (found[0] - found[1]) / (2.0 * size)
        second[which][knots, column] = (found[0] + found[1] - 2.0 * middle[knots]) / size**2
    return Gradient(by[0], by[1], by[2][:-1], (np.abs(second[0]), np.abs(second[1]), np.abs(second[2][:-1])))


def _through_gains(loop: Any, laws: _Array, value: _Array, co_state: _Array) -> tuple[_Array, _Array]:
    """Cotangents of (H law)_u + B* P (A - B K) of each step, (steps, m, n), and of P of each knot, (steps + 1, n, n), by
    the effect of the gains on the part of the excess by constant errors.
    """
    steps, n, m = loop.b.shape
    of_gains, of_value = np.zeros((steps, m, n)), np.zeros((steps + 1, n, n))
    if not co_state.shape[2]:
        return of_gains, of_value
    for k in range(steps):
        a, b, gains, s = loop.a[k], loop.b[k], loop.gains[k], loop.sensitivity[k]
        closed = a - b @ gains
        slope = -(loop.hessian[k, n:] @ laws[k] @ s + b.T @ co_state[k + 1]) @ s.T
        # Controls at a limit have no gains.
        moves = np.flatnonzero(gains.any(axis=1))
        curvature = loop.hessian[k, n:, n:] + b.T @ value[k + 1] @ b
        of_gains[k, moves] = np.linalg.solve(curvature[np.ix_(moves, moves)], slope[moves])
        more = b @ of_gains[k] @ closed.T
        of_value[k + 1] = closed @ of_value[k] @ closed.T + 0.5 * (more + more.T)
    return of_gains, of_value


def _directions(plan: MotionPlan) -> Iterator[tuple[int, int, float, NDArray[np.intp]]]:
    """Coordinates (0: q, 1: qd, 2: torques), their index, the size of the step, and every other knot: the velocity after
    a step belongs to the next one. The state of the start is fixed.
    """
    steps = len(plan.tau)
    efforts = STEP * max(float(np.abs(plan.tau).max(initial=0.0)), 1.0)
    for column in range(plan.scene.nv):
        for first in (1, 2):
            for which in (0, 1):
                yield which, column, STEP, np.arange(first, steps + 1, 2)
    for column in plan._problem.driven.tolist():
        for first in (0, 1):
            yield 2, column, efforts, np.arange(first, steps, 2)
