"""Plans: motions with the feedback law about them."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arguments import finite, has_followers, numbers, whole
from ..errors import ArgumentError, PlanWarning, ShapeError, of_argument, warn
from ._expected import Expected, expected, read_uncertainty
from ._hedged import hedged
from ._terms import read

if TYPE_CHECKING:
    from .._core import Scene, _Optimizer

__all__ = ["Iteration", "MotionPlan", "optimize"]

_Array = NDArray[np.float64]

#: Overlap of shapes and error of connections without a warning, m or rad.
CLOSE = 1e-3


class Iteration(NamedTuple):
    """An iteration of Scene.optimize."""

    cost: float
    """Cost after it, without that of inequalities."""
    expected: float
    """Decrease of the quadratic model for the whole step."""
    length: float
    """Step length; 0 if no length decreased the cost."""
    damping: float
    """Share of the curvature of the efforts that is added to it in the next iteration."""
    defects: float
    """Sum of the magnitudes of all defects after it: 0 for a motion that follows its efforts."""
    violation: float
    """Largest violation of an inequality after it."""
    array_stages: int
    """Steps whose law was computed in array form, because of rounding in the covariance form."""


@dataclass(frozen=True, eq=False)
class MotionPlan:
    """Motion of Scene.optimize with the feedback law about it.

    Attributes
    ----------
    dt : float
        Time step, s.
    q : (steps + 1, nq) ndarray
        Configurations of the knots.
    qd : (steps + 1, nv) ndarray
        Joint velocities of the knots.
    tau : (steps, nv) ndarray
        Joint torques of the steps, N m or N.
    gains : (steps, nv, 2 nv) ndarray
        Gains K of the law tau - K (q minus the plan's q in its tangent space, qd minus the plan's qd). Rows of joints
        without a control, and of those that a limit of effort holds, are zero.
    rate_gains : (steps, nv, nv) ndarray or None
        With a cost of EffortRate, gains of the deviation of the torques of the step before.
    cost : float
        Cost of the motion.
    converged : bool
        True if the quadratic model has no further decrease, the motion follows its efforts and the inequalities
        hold.
    reason : str
        Why the search ended.
    history : list of Iteration
        Cost, expected decrease and step length of each iteration.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi import control
    >>> scene = phipsi.scenes.chain(3)
    >>> goal = control.Terminal(control.State([0.5, 0.5, 0.5], position=0.01, velocity=0.1))
    >>> plan = scene.optimize([0.0] * 3, dt=0.02, steps=50, costs=[control.Effort(10.0), goal])
    >>> plan.converged, plan.q.shape, plan.gains.shape
    (True, (51, 3), (50, 3, 6))
    """

    dt: float
    q: _Array
    qd: _Array
    tau: _Array
    gains: _Array
    rate_gains: _Array | None
    cost: float
    converged: bool
    reason: str
    history: list[Iteration] = field(repr=False)
    scene: Scene = field(repr=False)
    effort: _Array = field(repr=False)
    _problem: _Problem = field(repr=False)

    def __repr__(self) -> str:
        state = "converged" if self.converged else f"not converged: {self.reason}"
        return f"<phipsi.MotionPlan: {len(self.tau)} steps of {self.dt:g} s, cost {self.cost:.6g}, {self.iterations} iterations, {state}>"

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self.history)

    @property
    def t(self) -> _Array:
        """Times of the knots, (steps + 1,), s."""
        return np.arange(len(self.q), dtype=np.float64) * self.dt

    def policy(self, k: int, q: ArrayLike, qd: ArrayLike, *, before: ArrayLike | None = None) -> _Array:
        """Joint torques of the feedback law at step k, within the limits of effort.

        Parameters
        ----------
        k : int
            Step, 0 to steps - 1.
        q : (nq,) array_like
            Measured configuration.
        qd : (nv,) array_like
            Measured joint velocities.
        before : (nv,) array_like, optional
            Torques of the step before, for a cost of EffortRate; None: those of the plan.

        Returns
        -------
        tau : (nv,) ndarray
            Joint torques, N m or N.

        Raises
        ------
        ArgumentError
            A step that the plan does not have.
        ShapeError, NotFiniteError
            Invalid arguments.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> from phipsi import control
        >>> scene = phipsi.scenes.chain(3)
        >>> plan = scene.optimize([0.1] * 3, dt=0.02, steps=10, costs=control.Effort(1.0))
        >>> np.allclose(plan.policy(4, plan.q[4], plan.qd[4]), plan.tau[4])
        True
        """
        k = whole("k", k, 0, f"a step of 0 to {len(self.tau) - 1}", len(self.tau) - 1)
        q, qd = _state(self.scene, q, qd, ("q", "qd"))
        deviation = np.concatenate([self.scene.difference(self.q[k], q), qd - self.qd[k]])
        tau: _Array = self.tau[k] - self.gains[k] @ deviation
        applied = None if before is None else finite("before", before, (self.scene.nv,))
        if applied is not None and self.rate_gains is not None and k > 0:
            tau = tau - self.rate_gains[k] @ (applied - self.tau[k - 1])
        return np.clip(tau, *self.effort)

    def shift(self, steps: int = 1) -> tuple[_Array, _Array, _Array]:
        """First guess of the plan that begins `steps` steps later: (q, qd, tau) for Scene.optimize(start=...).

        Parameters
        ----------
        steps : int, default 1
            Number of steps that have passed.

        Returns
        -------
        start : tuple of ndarray
            q (steps, nq) and qd (steps, nv) of the knots after the start, and tau (steps, nv); the last entries are
            repeated.

        Raises
        ------
        ArgumentError
            More steps than the plan has.

        Examples
        --------
        >>> import phipsi
        >>> from phipsi import control
        >>> scene = phipsi.scenes.chain(3)
        >>> plan = scene.optimize([0.1] * 3, dt=0.02, steps=10, costs=control.Effort(1.0))
        >>> q, qd, tau = plan.shift()
        >>> bool((tau[:-1] == plan.tau[1:]).all())
        True
        """
        steps = whole("steps", steps, 0, f"a number of steps of 0 to {len(self.tau)}", len(self.tau))

        def moved(array: _Array, skipped: int) -> _Array:
            last = np.repeat(array[-1:], min(skipped, len(array)), axis=0)
            return np.concatenate([array[skipped:], last])[: len(self.tau)]

        return moved(self.q[1:], steps), moved(self.qd[1:], steps), moved(self.tau, steps)

    def resume(
        self, q: ArrayLike, qd: ArrayLike, *, costs: Any = None, steps: int = 1, iterations: int = 1
    ) -> MotionPlan:
        """MotionPlan from a measured state, beginning with this plan shifted: the loop of model predictive control.

        The memory of the search is kept, so this plan can be resumed once at a time. It is faster than
        Scene.optimize because nothing is set up again. The new plan is one of least cost, also if this one is of least
        expected cost.

        Parameters
        ----------
        q : (nq,) array_like
            Measured configuration.
        qd : (nv,) array_like
            Measured joint velocities.
        costs : optional
            Terms with new targets, as many and of the same kinds as before; None: those of this plan.
        steps : int, default 1
            Number of steps that have passed since this plan.
        iterations : int, default 1
            Largest number of iterations.

        Returns
        -------
        plan : MotionPlan
            The new plan.

        Raises
        ------
        ArgumentError
            Terms of other kinds.
        ShapeError, NotFiniteError
            Invalid arguments.

        Examples
        --------
        >>> import phipsi
        >>> from phipsi import control
        >>> scene = phipsi.scenes.chain(3)
        >>> plan = scene.optimize([0.1] * 3, dt=0.02, steps=10, costs=control.Effort(1.0))
        >>> plan.resume(plan.q[1], plan.qd[1]).q.shape
        (11, 3)
        """
        state = _state(self.scene, q, qd, ("q", "qd"))
        problem = self._problem if costs is None else replace(self._problem, terms=read(self.scene, costs, len(self.tau), state))
        return problem.solve(state, self.shift(steps)[2], None, whole("iterations", iterations, 0))

    def expected(self, uncertainty: Any) -> Expected:
        """Expected cost and error bands of the motion under the feedback law, to first order.

        Parameters
        ----------
        uncertainty : phipsi.estimation.MotionUncertainty or covariance
            Uncertainty of the start, the parameters and the torques, or the covariance of the inertial parameters
            alone, as in Scene.simulate(covariance=...).

        Returns
        -------
        expected : Expected
            Expected cost, and standard deviations of q, qd and tau.

        Raises
        ------
        ArgumentError
            A matrix that is not a covariance; check, which needs simulations.
        ShapeError, NotFiniteError
            Invalid arguments.

        Notes
        -----
        Errors of parameters are constant along the motion, torque noise is white. The expected excess of the cost is
        half the trace of its second derivatives (those of Gauss and Newton) times the covariance of (x, u) under the
        law u = -K x. No limit of effort may be reached by it. O(steps nv^3).

        Examples
        --------
        >>> import phipsi
        >>> from phipsi import control, estimation
        >>> scene = phipsi.scenes.chain(3)
        >>> goal = control.Terminal(control.State([0.5] * 3, position=0.01, velocity=0.1))
        >>> plan = scene.optimize([0.0] * 3, dt=0.02, steps=50, costs=[control.Effort(10.0), goal])
        >>> found = plan.expected(estimation.MotionUncertainty(torque_noise=1e-3))
        >>> bool(found.cost > plan.cost)
        True
        """
        return expected(self, uncertainty)

    def trajectory(self) -> Any:
        """The motion as a Trajectory of Scene.simulate.

        With connections, the simulation projects each step onto them; the steps of the plan leave them a little.

        Returns
        -------
        trajectory : Trajectory
            Times, q and qd of the knots.

        Examples
        --------
        >>> import phipsi
        >>> from phipsi import control
        >>> scene = phipsi.scenes.chain(3)
        >>> plan = scene.optimize([0.1] * 3, dt=0.02, steps=10, costs=control.Effort(1.0))
        >>> plan.trajectory().q.shape
        (11, 3)
        """
        if self._problem.smoothing:
            raise of_argument(ArgumentError, "smoothing", f"found a plan with smoothing={self._problem.smoothing:g}, whose steps are not those of simulate; expected plan.q and plan.qd, or a loop of plan.policy and simulate")
        # Springs and damping of joints that follow others act at the start of a step.
        return self.scene.simulate(
            self.q[0],
            self.qd[0],
            dt=self.dt,
            steps=len(self.tau),
            tau_steps=self.tau,
            method="semi-implicit-euler" if has_followers(self.scene) else "implicit-euler",
            limits="report",
            friction_speed=self._problem.friction_speed,
        )

    def show(self, **options: Any) -> Any:
        """Show the motion in the browser, as Scene.show.

        Parameters
        ----------
        options
            Options of Scene.show.

        Returns
        -------
        view
            As Scene.show.

        Examples
        --------
        >>> import pathlib, phipsi, tempfile
        >>> from phipsi import control
        >>> scene = phipsi.scenes.chain(3)
        >>> plan = scene.optimize([0.1] * 3, dt=0.02, steps=10, costs=control.Effort(1.0))
        >>> path = pathlib.Path(tempfile.mkdtemp(), "plan.html")
        >>> page = plan.show(to=path)
        >>> path.exists()
        True
        """
        return self.scene.show(self.q, t=self.t, **options)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the arrays of the plan to a file of NumPy (.npz).

        Parameters
        ----------
        path : path-like
            File.

        Examples
        --------
        >>> import numpy as np, pathlib, phipsi, tempfile
        >>> from phipsi import control
        >>> scene = phipsi.scenes.chain(3)
        >>> plan = scene.optimize([0.1] * 3, dt=0.02, steps=10, costs=control.Effort(1.0))
        >>> path = pathlib.Path(tempfile.mkdtemp(), "plan.npz")
        >>> plan.save(path)
        >>> np.load(path)["gains"].shape
        (10, 3, 6)
        """
        np.savez(path, t=self.t, q=self.q, qd=self.qd, tau=self.tau, gains=self.gains, cost=self.cost, converged=self.converged)


class _Search:
    """The optimizer of a problem, with the terms that it has now; it is created when it is needed, also after a copy."""

    def __init__(self, scene: Scene, times: tuple[float, int], effort: _Array, limits: bool, settings: tuple[float, float, float, float]) -> None:
        self.arguments = scene, times, effort, limits, settings
        self.terms: list[Any] = []
        self.optimizer: _Optimizer | None = None

    def of(self, terms: list[Any]) -> _Optimizer:
        """The optimizer with these terms."""
        from .._core import _Optimizer

        if self.optimizer is None:
            scene, times, effort, limits, settings = self.arguments
            self.optimizer = _Optimizer(scene, times, terms, effort.tolist(), limits, settings)
        elif terms is not self.terms:
            self.optimizer.retarget(terms)
        self.terms = terms
        return self.optimizer

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"optimizer": None}


@dataclass(frozen=True)
class _Problem:
    """A problem with the memory of its search, which plans of other targets share."""

    terms: list[Any]
    search: _Search

    @property
    def optimizer(self) -> _Optimizer:
        """The optimizer with the terms of this problem."""
        return self.search.of(self.terms)

    @property
    def effort(self) -> _Array:
        """Smallest and largest torques, (2, nv)."""
        return self.search.arguments[2]

    @property
    def friction_speed(self) -> float:
        """Speed below which friction is viscous."""
        return self.search.arguments[4][2]

    @property
    def smoothing(self) -> float:
        """Length by which the contact law is relaxed."""
        return self.search.arguments[4][3]

    def free(self) -> _Optimizer:
        """A new optimizer of the costs alone, without limits and inequalities."""
        scene, times, effort, _, settings = self.search.arguments
        unlimited = np.copysign(np.where(effort == 0.0, 0.0, np.inf), effort)
        return _Search(scene, times, unlimited, False, settings).of([term for term in self.terms if not term[3]])

    @property
    def driven(self) -> NDArray[np.intp]:
        """Degrees of freedom with a control: those that have a limit of effort other than zero."""
        return np.flatnonzero((self.effort != 0.0).any(axis=0))

    def solve(
        self, state: tuple[_Array, _Array], tau: _Array | None, states: tuple[_Array, _Array] | None, iterations: int
    ) -> MotionPlan:
        (q, qd, tau, gains), converged, cost, reason, history = self.optimizer.solve(state, tau, states, iterations)
        scene, (dt, _) = self.search.arguments[:2]
        nv, rate_gains = scene.nv, None
        if gains.shape[2] > 2 * nv:
            rate_gains = np.zeros((len(tau), nv, nv))
            rate_gains[:, :, self.driven] = gains[:, :, 2 * nv :]
        each = [Iteration._make([*row[:-1], int(row[-1])]) for row in history.tolist()]
        plan_gains = np.ascontiguousarray(gains[:, :, : 2 * nv])
        return MotionPlan(dt, q, qd, tau, plan_gains, rate_gains, cost, converged, reason, each, scene, self.effort, self)


def optimize(
    scene: Scene,
    q0: ArrayLike,
    qd0: ArrayLike | None = None,
    *,
    dt: float,
    steps: int,
    costs: Any,
    tau: ArrayLike | None = None,
    start: Any = None,
    effort: Any = True,
    limits: bool = True,
    iterations: int = 100,
    tolerance: float = 1e-6,
    limit_tolerance: float = 1e-6,
    friction_speed: float = 0.2,
    smoothing: float = 0.0,
    uncertainty: Any = None,
) -> MotionPlan:
    """Scene.optimize."""
    steps = whole("steps", steps, 1)
    state = _state(scene, q0, np.zeros(scene.nv) if qd0 is None else qd0, ("q0", "qd0"))
    given = read(scene, costs, steps, state)
    bounds = _effort(scene, effort)
    settings = float(tolerance), float(limit_tolerance), float(friction_speed), float(smoothing)
    times, iterations = (float(dt), steps), whole("iterations", iterations, 0)

    def problem_of(terms: list[Any]) -> _Problem:
        return _Problem(terms, _Search(scene, times, bounds, bool(limits), settings))

    first, states = _start(scene, tau, start, steps)
    plan = problem_of(given).solve(state, first, states, iterations)
    if uncertainty is not None:
        unsure = read_uncertainty(uncertainty)
        if iterations == 0:
            raise of_argument(ArgumentError, "iterations", "found 0 with an uncertainty, whose plan is found by a search; expected at least 1, or plan.expected(uncertainty)")

        def search(near: MotionPlan, more: list[Any]) -> MotionPlan:
            problem = problem_of([*given, *read(scene, more, steps, state)])
            return problem.solve(state, near.tau, (near.q[1:], near.qd[1:]), iterations)

        plan = hedged(plan, unsure, search, float(tolerance))
    _warn_of_motion(plan)
    return plan


def _warn_of_motion(plan: MotionPlan) -> None:
    """Warn of what the plan touches, and of connections that its steps leave."""
    scene, q = plan.scene, plan.q
    found = ""
    if scene.contacts.names and not plan._problem.smoothing:
        gaps = scene.contacts.gaps(q)
        knot, at = np.unravel_index(np.argmin(gaps), gaps.shape)
        if gaps[knot, at] < -CLOSE:
            found = f"contact {scene.contacts.names[at]!r} {1e3 * -gaps[knot, at]:.3g} mm below its surface at step {knot}"
    apart = None
    if not found and scene.collider_names and not plan._problem.smoothing:
        # Colliders of which no two can touch are refused.
        with contextlib.suppress(ArgumentError):
            apart = scene.distances(q, limit=0.0)
    if apart is not None:
        if apart.distance.size and apart.distance.min() < -CLOSE:
            knot, at = np.unravel_index(np.argmin(apart.distance), apart.distance.shape)
            pair = " and ".join(repr(name) for name in apart.pairs[at])
            found = f"shapes {pair} that overlap by {1e3 * -apart.distance[knot, at]:.3g} mm at step {knot}"
    if found:
        warn(f"plan: found {found}; expected a motion that touches nothing, by tasks.Distance, connections for points that stay in contact, or smoothing", PlanWarning)
    if scene.loops.names:
        error = np.abs(scene.loops.error(q)).max(axis=1)
        if error.max() > CLOSE:
            warn(f"plan: found an error of the connections of {error.max():.2g} (m or rad) at step {error.argmax()}; expected at most {CLOSE:g}: shorter steps", PlanWarning)


def _state(scene: Scene, q: ArrayLike, qd: ArrayLike, names: tuple[str, str]) -> tuple[_Array, _Array]:
    return finite(names[0], q, (scene.nq,)), finite(names[1], qd, (scene.nv,))


def _effort(scene: Scene, effort: Any) -> _Array:
    """Smallest and largest torques, (2, nv)."""
    limit = scene.limits.effort if effort is True else np.full(scene.nv, np.inf)
    bounds = np.stack([-limit, limit])
    if effort is not True and effort is not None:
        given = numbers("effort", effort)
        if given.shape not in {(), (scene.nv,), (2, scene.nv)}:
            raise of_argument(ShapeError, "effort", f"found shape {given.shape}; expected True, None, a number, ({scene.nv},) or (2, {scene.nv})")
        if given.shape != (2, scene.nv) and not (given >= 0.0).all():
            raise of_argument(ArgumentError, "effort", f"found {given.min()}; expected limits that are zero (no control) or positive")
        bounds = given.copy() if given.shape == (2, scene.nv) else np.stack(np.broadcast_arrays(-given, given, limit)[:2])
    for joint in scene.joint_names:
        if scene.joint(joint).type == "floating":
            bounds[:, scene.v_index(joint)] = 0.0
    return bounds


def _start(scene: Scene, tau: Any, start: Any, steps: int) -> tuple[_Array | None, tuple[_Array, _Array] | None]:
    """First efforts and states."""
    states: tuple[_Array, _Array] | None = None
    if start is not None:
        if isinstance(start, MotionPlan):
            start = start.shift(0)
        if not isinstance(start, tuple) or len(start) not in (2, 3):
            raise of_argument(ArgumentError, "start", f"found {type(start).__name__}; expected a plan, plan.shift(), or (q, qd) of the knots after the start")
        states = finite("start", start[0], (steps, scene.nq)), finite("start", start[1], (steps, scene.nv))
        if len(start) == 3 and tau is None:
            tau = start[2]
    if tau is None:
        return None, states
    first = numbers("tau", tau)
    if first.shape not in {(scene.nv,), (steps, scene.nv)}:
        raise of_argument(ShapeError, "tau", f"found shape {first.shape}; expected ({scene.nv},) or ({steps}, {scene.nv})")
    return np.ascontiguousarray(np.broadcast_to(first, (steps, scene.nv))), states
