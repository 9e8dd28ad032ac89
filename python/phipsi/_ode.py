"""The equations of motion for SciPy's adaptive integrators, in tangent coordinates whose center moves with the
configuration.

Relative to a center q0 the configuration is q = q0 * x, with x of nv entries: a joint with one axis adds its entry; a
spherical joint rotates by the rotation vector w, R = R0 exp(w); a free joint is moved to p0 + R0 a and rotated
likewise.
With v the velocity of the body,

    da/dt = exp(w) v_linear,    dw/dt = B(w) v_angular (see _chart).

The state (x, v) is therefore a vector, the error control of the integrator acts on the manifold, and no
quaternion norm is integrated. The coordinates are valid for |w| < 2 pi; after a step that ends beyond 1 rad,
they are centered at its end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core, errors
from ._arguments import check_tree
from ._chart import (
    by_quaternion,
    by_vector,
    by_vector_derivative,
    carried_back,
    carried_back_derivative,
    carried_back_matrix,
    rotation,
    skew,
    tangent,
)
from ._coordinates import Coordinates
from ._friction import check_coulomb
from ._install import command
from ._motion import PD, Trajectory
from ._motion_parts import of_motors
from ._recorded import torques
from ._signals import by_handler

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["Ode"]

_Array = NDArray[np.float64]
_Torque = Callable[[float, _Array, _Array], ArrayLike]
#: Time, configuration, joint velocities.
_Row = tuple[float, _Array, _Array]

#: Rotation from the center, rad, beyond which the coordinates get a new center.
TURNED = 1.0
#: Default bound of the number of steps: minutes of motion of an arm with DOP853.
MAX_STEPS = 100_000
#: Relative step of the central differences, which balances truncation and rounding errors.
DIFFERENCE = float(np.finfo(np.float64).eps) ** (1 / 3)


class Ode:
    """Equations of motion dy/dt = f(t, y) and their Jacobian, for y = (x, qd) with x the tangent coordinates; returned
    by Scene.ode.

    `rhs` and `jacobian` can be passed to scipy.integrate.solve_ivp (also with vectorized=True). `solve`
    integrates and moves the center of the coordinates as needed.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> ode = phipsi.scenes.chain(3).ode()
    >>> ode.rhs(0.0, np.zeros(6)).shape, ode.jacobian(0.0, np.zeros(6)).shape
    ((6,), (6, 6))
    """

    def __init__(
        self,
        scene: Scene,
        *,
        tau: ArrayLike | _Torque | None = None,
        pd: PD | tuple[ArrayLike, ...] | None = None,
        damping: ArrayLike | None = None,
        stiffness: ArrayLike | None = None,
        rest: ArrayLike | None = None,
        friction: ArrayLike | None = None,
        friction_speed: float = 0.01,
    ) -> None:
        check_tree(scene, "ode")
        check_coulomb(scene, "ode")
        self.scene = scene
        nv = scene.nv

        def rates(name: str, given: ArrayLike | None, default: ArrayLike, *, signed: bool = False) -> _Array:
            value = _core._numbers(name, default if given is None else given, scene)
            if value.ndim == 0:
                value = np.full(nv, value)
            if value.shape != (nv,):
                raise errors.of_argument(errors.ShapeError, name, f"found shape {value.shape}; expected () or ({nv},)")
            if not np.all(np.isfinite(value)):
                raise errors.of_argument(errors.NotFiniteError, name, f"found {value}; expected finite numbers")
            if not signed and np.any(value < 0):
                raise errors.of_argument(errors.ArgumentError, name, f"found {value}; expected zero or positive values")
            return value

        self._damping = rates("damping", damping, scene.damping)
        self._stiffness = rates("stiffness", stiffness, scene.stiffness)
        self._friction = rates("friction", friction, scene.friction)
        if not (np.isfinite(friction_speed) and friction_speed > 0):
            message = f"found {friction_speed}; expected a finite positive speed"
            raise errors.of_argument(errors.ArgumentError, "friction_speed", message)
        self._speed = float(friction_speed)
        self._rest = self._configuration("rest", scene.rest if rest is None else rest)
        self._tau = tau if callable(tau) else rates("tau", tau, 0.0, signed=True)
        #: Exception of tau, if it raised.
        self._raised: Exception | None = None
        self._pd: tuple[_Array, _Array, _Array, _Array] | None = None
        if pd is not None:
            law = PD(*pd)
            if law.no_load_speed is not None or (law.effort is not None and law.effort is not False):
                raise errors.of_argument(errors.ArgumentError, "pd.effort", "found limits of effort; expected None: Scene.simulate has them")
            kp, kd = (rates(name, of_motors(scene, gain), 0.0) for name, gain in (("pd.kp", law.kp), ("pd.kd", law.kd)))
            if law.target is None and kp.any():
                raise errors.of_argument(errors.ArgumentError, "pd.target", "found None; expected a target configuration")
            self._pd = (
                kp,
                kd,
                self._configuration("pd.target", scene.neutral() if law.target is None else law.target),
                rates("pd.target_rate", law.target_rate, 0.0, signed=True),
            )
        #: Entries of rotations, and of the translations of free joints.
        coordinates = Coordinates(scene)
        self._turns, self._moves = coordinates.turns, coordinates.moves
        self._center = scene.neutral()

    def _configuration(self, name: str, value: ArrayLike) -> _Array:
        q = _core._numbers(name, value, self.scene, True)
        if q.shape != (self.scene.nq,):
            raise errors.of_argument(errors.ShapeError, name, f"found shape {q.shape}; expected ({self.scene.nq},)")
        return self.scene.integrate(q, np.zeros(self.scene.nv))

    def __getattr__(self, name: str) -> NoReturn:
        """Name the new attribute where an old one is read."""
        new = {"centre": "center", "centre_at": "center_at"}.get(name)
        renamed = f"; it was renamed to {new!r}" if new else ""
        raise AttributeError(f"'Ode' object has no attribute {name!r}{renamed}", name=name, obj=self)

    @property
    def center(self) -> _Array:
        """Center of the tangent coordinates, a configuration (nq,)."""
        return self._center.copy()

    def center_at(self, q: ArrayLike) -> None:
        """Set the center of the tangent coordinates, where x is zero.

        Parameters
        ----------
        q : array_like, (nq,)
            Configuration.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            If q is not a valid configuration.

        Examples
        --------
        >>> import phipsi
        >>> ode = phipsi.scenes.chain(3).ode()
        >>> ode.center_at([0.1, 0.2, 0.3])
        >>> ode.center.tolist()
        [0.1, 0.2, 0.3]
        """
        self._center = self._configuration("q", q)

    def configuration(self, x: ArrayLike) -> _Array:
        """Configuration of tangent coordinates.

        Parameters
        ----------
        x : array_like, (..., nv)
            Tangent coordinates.

        Returns
        -------
        array
            Configurations, (..., nq).

        Examples
        --------
        >>> import phipsi
        >>> phipsi.scenes.chain(3).ode().configuration([0.1, 0.2, 0.3]).tolist()
        [0.1, 0.2, 0.3]
        """
        x = np.asarray(x, dtype=np.float64)
        step = x.copy()
        for _, _, linear, _ in self._moves:
            step[..., linear] = 0.0
        q = self.scene.integrate(self._center, step)
        for place, turn, linear, _ in self._moves:
            q[..., place] = self._center[place] + by_quaternion(self._center[turn], x[..., linear])
        return q

    def torque(self, t: float, q: _Array, v: _Array) -> _Array:
        """Sum of all joint torques: given torques, damping, friction, springs and control law.

        Parameters
        ----------
        t : float
            Time, s.
        q : array, (..., nq)
            Configurations.
        v : array, (..., nv)
            Joint velocities, rad/s or m/s.

        Returns
        -------
        array
            Joint torques, (..., nv), N m or N.

        Examples
        --------
        >>> import numpy as np
        >>> import phipsi
        >>> phipsi.scenes.chain(3).ode(tau=1.0).torque(0.0, np.zeros(3), np.zeros(3)).tolist()
        [1.0, 1.0, 1.0]
        """
        u = self._given(t, q, v) - self._damping * v
        u = u - self._friction * v / np.hypot(v, self._speed)
        if self._stiffness.any():
            u = u - self._stiffness * self._away(self._rest, q)
        if self._pd is not None:
            kp, kd, target, rate = self._pd
            u = u + kd * (rate - v) - kp * self._away(target, q)
        return u

    def _given(self, t: float, q: _Array, v: _Array) -> _Array:
        """The given torques."""
        if not callable(self._tau):
            return self._tau
        try:
            return torques(self._tau, self.scene, t, q, v)
        except Exception as error:
            self._raised = error
            raise

    def _away(self, rest: _Array, q: _Array) -> _Array:
        away = self.scene.difference(rest, q)
        for place, turn, linear, _ in self._moves:
            away[..., linear] = by_quaternion(q[..., turn], q[..., place] - rest[place], -1.0)
        return away

    def _away_derivative(self, rest: _Array, q: _Array) -> _Array:
        """Derivative of _away with respect to the tangent of q, (nv, nv)."""
        away, change = self._away(rest, q), np.eye(self.scene.nv)
        for _, angular in self._turns:
            change[angular, angular] = carried_back_matrix(away[angular])
        for _, _, linear, angular in self._moves:
            change[linear, angular] = skew(away[linear])
        return change

    def rhs(self, t: float, y: ArrayLike) -> _Array:
        """Right-hand side dy/dt.

        Parameters
        ----------
        t : float
            Time, s.
        y : array_like, (2 nv,) or (2 nv, k)
            State (x, qd), or several states as with vectorized=True of SciPy.

        Returns
        -------
        array
            Time derivatives, of the shape of y.

        Examples
        --------
        >>> import numpy as np
        >>> import phipsi
        >>> phipsi.scenes.chain(3).ode().rhs(0.0, np.zeros((6, 2))).shape
        (6, 2)
        """
        y = np.asarray(y, dtype=np.float64)
        x, v = np.split(np.ascontiguousarray(y.T), 2, axis=-1)
        q = self.configuration(x)
        rates = v.copy()
        for _, angular in self._turns:
            rates[..., angular] = carried_back(x[..., angular], v[..., angular])
        for _, _, linear, angular in self._moves:
            rates[..., linear] = by_vector(x[..., angular], v[..., linear])
        accelerations = self.scene.forward_dynamics(q, v, self.torque(t, q, v))
        return np.ascontiguousarray(np.concatenate([rates, accelerations], axis=-1).T)

    def jacobian(self, t: float, y: ArrayLike) -> _Array:
        """Exact Jacobian df/dy: the derivatives of forward dynamics, with the chain rule for the coordinates and the
        torques.

        Parameters
        ----------
        t : float
            Time, s.
        y : array_like, (2 nv,)
            State (x, qd).

        Returns
        -------
        array
            Jacobian, (2 nv, 2 nv).

        Notes
        -----
        With T(x) from x to the tangent of q, dx/dt = R(x) v, and u the torques of torque(),

            df/dy = [[d(R v)/dx, R], [(dqdd/dq + M^-1 du/dq) T, dqdd/dqd + M^-1 du/dv]]

        If tau is a function, its derivatives are computed by central differences, with 4 nv calls.

        Examples
        --------
        >>> import numpy as np
        >>> import phipsi
        >>> phipsi.scenes.chain(3).ode().jacobian(0.0, np.zeros(6)).shape
        (6, 6)
        """
        x, v = np.split(np.asarray(y, dtype=np.float64), 2)
        q = self.configuration(x)
        moved, rates_x, rates_v = np.eye(self.scene.nv), np.zeros((self.scene.nv, self.scene.nv)), np.eye(self.scene.nv)
        for _, angular in self._turns:
            w, own = x[angular], (angular, angular)
            moved[own], rates_v[own] = tangent(w), carried_back_matrix(w)
            rates_x[own] = carried_back_derivative(w, v[angular])
        for _, _, linear, angular in self._moves:
            w, own = x[angular], (linear, linear)
            rates_v[own] = rotation(w)
            moved[own] = rates_v[own].T
            rates_x[linear, angular] = by_vector_derivative(w, v[linear])
        dynamics = self.scene.forward_dynamics_derivatives(q, v, self.torque(t, q, v))
        by_q, by_v = self._torque_derivatives(q, v)
        accelerations = np.hstack([(dynamics.dqdd_dq + dynamics.mass_matrix_inverse @ by_q) @ moved, dynamics.dqdd_dqd + dynamics.mass_matrix_inverse * by_v])
        if callable(self._tau):
            accelerations += dynamics.mass_matrix_inverse @ self._tau_differences(t, x, v)
        return np.vstack([np.hstack([rates_x, rates_v]), accelerations])

    def _torque_derivatives(self, q: _Array, v: _Array) -> tuple[_Array, _Array]:
        """Derivatives of the torques of damping, friction, springs and control law: with respect to the tangent of q,
        (nv, nv), and with respect to v, a diagonal, (nv,).
        """
        by_q = np.zeros((self.scene.nv, self.scene.nv))
        by_v = -self._damping - self._friction * self._speed**2 / np.hypot(v, self._speed) ** 3
        if self._stiffness.any():
            by_q -= self._stiffness[:, None] * self._away_derivative(self._rest, q)
        if self._pd is not None:
            kp, kd, target, _ = self._pd
            by_q -= kp[:, None] * self._away_derivative(target, q)
            by_v = by_v - kd
        return by_q, by_v

    def _tau_differences(self, t: float, x: _Array, v: _Array) -> _Array:
        """Derivatives of a function for tau with respect to (x, v), by central differences, (nv, 2 nv)."""
        y = np.concatenate([x, v])
        step = DIFFERENCE * np.maximum(1.0, np.abs(y))
        ahead, behind = y + np.diag(step), y - np.diag(step)

        def given(state: _Array) -> _Array:
            x, v = np.split(state, 2)
            return np.broadcast_to(self._given(t, self.configuration(x), v), x.shape)

        changes = [given(a) - given(b) for a, b in zip(ahead, behind, strict=True)]
        return np.asarray(np.reshape(changes, (len(y), len(x))).T / (ahead - behind).diagonal())

    def solve(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        t_span: tuple[float, float],
        *,
        method: str = "DOP853",
        rtol: float = 1e-9,
        atol: float = 1e-9,
        t_eval: ArrayLike | None = None,
        max_step: float = np.inf,
        max_steps: int = MAX_STEPS,
        progress: Callable[[float, float], object] | None = None,
    ) -> Trajectory:
        """Integrate from (q, qd) over t_span with a method of scipy.integrate.solve_ivp; implicit methods use the
        Jacobian.

        Parameters
        ----------
        q : array_like, (nq,)
            Initial configuration.
        qd : array_like, (nv,)
            Initial joint velocities, rad/s or m/s.
        t_span : tuple of float
            Start and end time, s.
        method : {"RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA"}
            Method of SciPy. If springs are much faster than the motion, use "Radau" or "BDF".
        rtol, atol : float
            Bounds of the relative and absolute error of a step in (x, qd).
        t_eval : array_like, optional
            Times of the rows, ascending, s; None: those of the steps of the integrator.
        max_step : float
            Largest step, s.
        max_steps : int
            Largest number of steps.
        progress : callable, optional
            Called after every step with the current time and the end time, s.

        Returns
        -------
        Trajectory
            The solution. Its dt is NaN; its steps are those of the integrator.

        Raises
        ------
        SimulationError
            If the integrator fails or reaches max_steps, or tau raises; `trajectory` has the rows before.
        ShapeError, NotFiniteError, ArgumentError
            If an argument is invalid.
        ImportError
            If SciPy is not installed.

        Examples
        --------
        >>> import phipsi
        >>> path = phipsi.scenes.chain(3).ode().solve([0.1, 0.2, 0.3], [0.0] * 3, (0.0, 0.1), t_eval=[0.0, 0.1])
        >>> path.q.shape
        (2, 3)
        """
        try:
            from scipy import integrate  # type: ignore[import-untyped,unused-ignore]
        except ImportError:
            raise ImportError(f"Ode.solve needs SciPy; install it with: {command('motion')}") from None
        methods = {name: getattr(integrate, name) for name in ("RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA")}
        if method not in methods:
            names = ", ".join(f'"{name}"' for name in methods)
            raise errors.of_argument(errors.ArgumentError, "method", f'found "{method}"; expected one of {names}')
        start, end = (float(t) for t in t_span)
        if not (np.isfinite(start) and np.isfinite(end) and end > start):
            raise errors.of_argument(errors.ArgumentError, "t_span", f"found ({start}, {end}); expected finite times, the second one larger")
        for name, bound in (("rtol", rtol), ("atol", atol), ("max_step", max_step)):
            if not np.all(np.asarray(_core._numbers(name, bound)) > 0.0):
                raise errors.of_argument(errors.ArgumentError, name, f"found {bound}; expected a number above zero")
        if isinstance(max_steps, bool) or not isinstance(max_steps, int | np.integer) or max_steps < 1:
            raise errors.of_argument(errors.ArgumentError, "max_steps", f"found {max_steps!r}; expected a whole number, at least 1")
        wanted = None if t_eval is None else _core._numbers("t_eval", t_eval)
        if wanted is not None and not (
            wanted.ndim == 1 and np.all(np.diff(wanted) > 0) and np.all((wanted >= start) & (wanted <= end))
        ):
            raise errors.of_argument(errors.ArgumentError, "t_eval", "found times outside t_span or not ascending; expected ascending times within t_span")
        v = _core._numbers("qd", qd, self.scene)
        if v.shape != (self.scene.nv,):
            raise errors.of_argument(errors.ShapeError, "qd", f"found shape {v.shape}; expected ({self.scene.nv},)")
        self.center_at(q)
        rows: list[_Row] = []
        if wanted is None or (len(wanted) and wanted[0] == start):
            rows.append(self._row(start, np.concatenate([np.zeros(self.scene.nv), v])))
        steps, t, first_step = 0, start, None
        while t < end:
            options: dict[str, Any] = {"rtol": rtol, "atol": atol, "max_step": max_step}
            if first_step is not None:
                options["first_step"] = min(first_step, end - t)
            if method in ("Radau", "BDF", "LSODA"):
                options["jac"] = self.jacobian
            y = np.concatenate([np.zeros(self.scene.nv), v])
            with self._guarded(rows, method, steps, t):
                solver = methods[method](self.rhs, t, y, end, **options)
            while solver.status == "running":
                if steps == max_steps:
                    raise self._failed(rows, method, steps, solver.t, self._bound(method, end))
                with self._guarded(rows, method, steps, solver.t):
                    message = solver.step()
                if solver.status == "failed":
                    raise self._failed(rows, method, steps, solver.t, message)
                steps += 1
                rows += self._rows(solver, wanted)
                if progress is not None:
                    progress(float(solver.t), end)
                if self._is_turned(solver.y):
                    break
            first_step = solver.step_size
            t, v = float(solver.t), solver.y[self.scene.nv :]
            self.center_at(self.configuration(solver.y[: self.scene.nv]))
        return self._trajectory(rows, method, steps)

    def _is_turned(self, y: _Array) -> bool:
        return any(np.linalg.norm(y[angular]) > TURNED for _, angular in self._turns)

    def _row(self, t: float, y: _Array) -> _Row:
        x, v = np.split(y, 2)
        return float(t), self.configuration(x), np.array(v)

    def _rows(self, solver: Any, wanted: _Array | None) -> list[_Row]:
        """Rows of the last step of the solver: its end, or the requested times within it."""
        if wanted is None:
            return [self._row(solver.t, solver.y)]
        due = wanted[(wanted > solver.t_old) & (wanted <= solver.t)]
        dense: Any = solver.dense_output() if len(due) else None
        return [self._row(t, solver.y if t == solver.t else dense(t)) for t in due]

    def _trajectory(self, rows: list[_Row], method: str, steps: int) -> Trajectory:
        t = np.array([row[0] for row in rows], dtype=np.float64)
        widths = (self.scene.nq, self.scene.nv)
        q, qd = (np.reshape([row[at] for row in rows], (len(rows), width)) for at, width in enumerate(widths, 1))
        return Trajectory(
            self.scene, t, q, qd, np.nan, steps, method, self.scene.armature, self._stiffness.copy(), self._rest.copy()
        )

    @staticmethod
    def _bound(method: str, end: float) -> str:
        """Error message if max_steps is reached."""
        stiff = "" if method in ("Radau", "BDF", "LSODA") else 'method="Radau" for stiff gains, '
        return f"found max_steps steps before the end, {end:g} s; expected {stiff}larger rtol and atol, or a larger max_steps"

    @contextmanager
    def _guarded(self, rows: list[_Row], method: str, steps: int, t: float) -> Iterator[None]:
        """Raise errors of the dynamics and of tau as SimulationError, and those of signal handlers unchanged."""
        self._raised = None
        try:
            yield
        except Exception as cause:
            if by_handler(cause) or not (cause is self._raised or isinstance(cause, errors.NotFiniteError | errors.SingularJointError)):
                raise
            by_tau = f"{type(cause).__name__}: " if cause is self._raised else ""
            raise self._failed(rows, method, steps, t, f"{by_tau}{cause}") from cause

    def _failed(self, rows: list[_Row], method: str, steps: int, t: float, message: str | None) -> errors.SimulationError:
        error = errors.SimulationError(f"{errors.place_in_time(steps, t)}: {method}: {message}")
        error.trajectory, error.step = self._trajectory(rows, method, steps), steps
        return error
