"""Linear-quadratic regulators: constant ones, and those that follow a path."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arguments import finite
from .._summary import summarized
from ..errors import ArgumentError, ShapeError, of_argument
from ..estimation._values import positive
from ._plan import MotionPlan, optimize
from ._terms import Effort, State, Terminal, weights

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["Regulator", "lqr", "tracking"]

_Array = NDArray[np.float64]

#: Largest number of doublings; the error squares in each.
DOUBLINGS = 60
#: Largest number of steps of Newton's method, and largest relative change of the gains in the last one.
STEPS = 20
SETTLED = 1e-6


@summarized
class Regulator(NamedTuple):
    """Constant gains of a linear-quadratic regulator.

    Examples
    --------
    >>> import numpy as np
    >>> from phipsi import control
    >>> found = control.lqr([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], np.eye(2), [[1.0]])
    >>> found.gains.round(6)
    array([[1.      , 1.732051]])
    """

    gains: _Array
    """Gains K of the law u = -K x, (m, n)."""
    value: _Array
    """Matrix P of the cost 1/2 x^T P x of the motion from x, (n, n)."""
    poles: NDArray[np.complex128]
    """Eigenvalues of the closed loop, (n,): of A - B K, 1/s, or of its step."""


def lqr(A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike, *, dt: float | None = None) -> Regulator:
    """Gains that minimize the integral of 1/2 (x^T Q x + u^T R u) for dx/dt = A x + B u.

    Parameters
    ----------
    A : (n, n) array_like
        System; Scene.linearize returns A and B.
    B : (n, m) array_like
        Effect of the controls.
    Q : (n, n), (n,) or scalar array_like
        Weights of the state, positive semidefinite, or their diagonal.
    R : (m, m), (m,) or scalar array_like
        Weights of the controls, positive definite, or their diagonal.
    dt : float, optional
        Time step, s: the control is constant during each step, and the sum over the steps of the cost at their starts,
        times dt, is minimized. None: continuous time.

    Returns
    -------
    regulator : Regulator
        gains, value and poles.

    Raises
    ------
    ShapeError
        Shapes that do not fit.
    ArgumentError
        Weights that are not positive, and systems that no control stabilizes.

    Notes
    -----
    From the stable subspace of the Hamiltonian, with the steps of Kleinman (IEEE Trans. Autom. Control 13, 1968, 114-115)
    until rounding is reached: a solution whose gains rounding changes by more than 1e-6 raises the error.

    Examples
    --------
    >>> import numpy as np, phipsi
    >>> from phipsi import control
    >>> scene = phipsi.scenes.chain(3)
    >>> q, zero = np.array([0.3, 0.2, 0.1]), np.zeros(3)
    >>> system = scene.linearize(q, zero, scene.gravity_torque(q))
    >>> found = control.lqr(system.A, system.B, np.ones(6), np.ones(3))
    >>> bool((found.poles.real < 0.0).all())
    True
    """
    a, b, q, r = _system(A, B, Q, R)
    # Results that overflow are found by their values.
    with np.errstate(all="ignore"):
        if dt is not None:
            a, b = _held(a, b, positive("dt", dt))
            q, r = q * dt, r * dt
        try:
            found = _solved(a, b, q, r, dt is not None)
        except np.linalg.LinAlgError:
            found = None
    if found is None:
        raise of_argument(
            ArgumentError,
            "A, B",
            "found a system that these controls do not stabilize, to rounding; expected one whose unstable motions B reaches and whose"
            " undamped ones Q sees, with weights that do not differ by many orders of magnitude",
        )
    value, gains = found
    return Regulator(gains, value, np.asarray(np.linalg.eigvals(a - b @ gains), np.complex128))


def _system(A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike) -> tuple[_Array, _Array, _Array, _Array]:
    a, b = finite("A", A), finite("B", B)
    if a.ndim != 2 or a.shape[0] != a.shape[1]:
        raise of_argument(ShapeError, "A", f"found shape {a.shape}; expected (n, n)")
    if b.ndim != 2 or len(b) != len(a):
        raise of_argument(ShapeError, "B", f"found shape {b.shape}; expected ({len(a)}, m)")
    weights = []
    for name, given, width, least in (("Q", Q, len(a), 0.0), ("R", R, b.shape[1], np.finfo(float).tiny)):
        array = finite(name, given)
        array = np.diag(np.full(width, array) if array.ndim == 0 else array) if array.ndim < 2 else array
        if array.shape != (width, width):
            raise of_argument(ShapeError, name, f"found shape {np.shape(given)}; expected ({width},) or ({width}, {width}), or one number")
        array = _symmetric(array)
        smallest = np.linalg.eigvalsh(array).min() if width else np.inf
        rounding = 1e-12 * np.abs(array).max() if least == 0.0 and width else 0.0
        if not smallest >= least - rounding:
            expected = "positive semidefinite" if least == 0.0 else "positive definite"
            raise of_argument(ArgumentError, name, f"found the eigenvalue {smallest:g}; expected weights that are {expected}")
        weights.append(array)
    return a, b, weights[0], weights[1]


def _symmetric(matrix: _Array) -> _Array:
    half: _Array = 0.5 * (matrix + matrix.T)
    return half


def _held(a: _Array, b: _Array, dt: float) -> tuple[_Array, _Array]:
    """The step of a system with constant control, by the exponential series of a scaled matrix."""
    n, m = b.shape
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = a * dt, b * dt
    halvings = max(0, int(np.ceil(np.log2(max(float(np.linalg.norm(whole, 1)), 1e-300)))) + 4)
    scaled = whole / 2.0**halvings
    power = result = np.eye(n + m)
    for k in range(1, 15):
        power = power @ scaled / k
        result = result + power
    for _ in range(halvings):
        result = result @ result
    return result[:n, :n], result[:n, n:]


def _solved(a: _Array, b: _Array, q: _Array, r: _Array, is_discrete: bool) -> tuple[_Array, _Array] | None:
    """The stabilizing solution of the Riccati equation and its gains; None if rounding or the system leave none."""
    n, g, one = len(a), b @ np.linalg.solve(r, b.T), np.eye(len(a))
    if is_discrete:
        # The pencil M - s L after a Cayley transform, which maps the unit circle to the imaginary axis.
        m, last = np.block([[a, 0.0 * one], [-q, one]]), np.block([[one, g], [0.0 * one, a.T]])
        flow = np.linalg.solve(m + last, m - last)
    else:
        flow = np.block([[a, -g], [-q, -a.T]])
    values, vectors = np.linalg.eig(flow)
    stable = vectors[:, np.argsort(values.real)[:n]]
    value = _symmetric(np.linalg.solve(stable[:n].T, stable[n:].T).T.real)
    best: tuple[_Array, _Array] | None = None
    least, before = SETTLED, np.full(b.T.shape, np.inf)
    for _ in range(STEPS):
        on, by = (r + b.T @ value @ b, b.T @ value @ a) if is_discrete else (r, b.T @ value)
        gains = np.asarray(np.linalg.solve(on, by), np.float64)
        closed = a - b @ gains
        poles = np.asarray(np.linalg.eigvals(closed), np.complex128)
        if not (np.isfinite(value).all() and ((np.abs(poles) < 1.0) if is_discrete else (poles.real < 0.0)).all()):
            break
        # The step of Newton's method is the error of the solution before.
        error = float(np.abs(gains - before).max(initial=0.0) / max(np.abs(gains).max(initial=0.0), 1e-300))
        if error <= least:
            best, least = (value, gains), error
        elif best is not None:
            break
        if error == 0.0:
            break
        before, rest = gains, q + gains.T @ r @ gains
        rest = closed.T @ value @ closed - value + rest if is_discrete else closed.T @ value + value @ closed + rest
        value = _symmetric(value + _lyapunov(closed, _symmetric(rest), poles, is_discrete))
    return best


def _lyapunov(a: _Array, rest: _Array, poles: NDArray[np.complex128], is_discrete: bool) -> _Array:
    """Solution X of A^T X A - X + rest = 0, or of A^T X + X A + rest = 0 after a Cayley transform, by doubling."""
    if not is_discrete and len(a):
        sizes, one = np.abs(poles), np.eye(len(a))
        shift = np.sqrt(sizes.min() * sizes.max())
        inverse = np.linalg.inv(a - shift * one)
        a, rest = inverse @ (a + shift * one), 2.0 * shift * inverse.T @ rest @ inverse
    for _ in range(DOUBLINGS):
        more = a.T @ rest @ a
        rest, a = _symmetric(rest + more), a @ a
        if not np.abs(more).max(initial=0.0) > 1e-16 * np.abs(rest).max(initial=0.0):
            break
    return rest


def tracking(
    scene: Scene,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    *,
    dt: float,
    position: ArrayLike,
    velocity: ArrayLike,
    effort: ArrayLike,
    end: float = 1.0,
) -> MotionPlan:
    """Time-varying regulator along a path: gains that keep the robot near it.

    Parameters
    ----------
    scene : Scene
        Robot.
    q : (steps + 1, nq) array_like
        Configurations of the path.
    qd : (steps + 1, nv) array_like
        Joint velocities of the path.
    tau : (steps, nv) array_like
        Joint torques along the path, as from inverse_dynamics.
    dt : float
        Time step, s.
    position : float or (nv,) array_like
        Deviation of q that costs as much as `effort`, rad or m.
    velocity : float or (nv,) array_like
        The same of qd, rad/s or m/s.
    effort : float or (nv,) array_like
        Deviation of the torques, N m or N.
    end : float, default 1
        Deviations at the end of the path, relative to these, per square root of a second.

    Returns
    -------
    plan : MotionPlan
        The path with its gains; its policy is the regulator.

    Raises
    ------
    ShapeError, NotFiniteError
        Invalid arguments.

    Notes
    -----
    One pass of the filter from the end of the path to its start: O(steps nv^3). Limits of effort hold no joint.

    Examples
    --------
    >>> import numpy as np, phipsi
    >>> from phipsi import control
    >>> scene = phipsi.scenes.chain(3)
    >>> q, zero = np.full((21, 3), 0.3), np.zeros((21, 3))
    >>> tau = scene.gravity_torque(q[:-1])
    >>> plan = control.tracking(scene, q, zero, tau, dt=0.01, position=0.1, velocity=1.0, effort=5.0)
    >>> plan.gains.shape
    (20, 3, 6)
    """
    steps = len(np.atleast_2d(finite("tau", tau)))
    path, rates = finite("q", q, (steps + 1, scene.nq)), finite("qd", qd, (steps + 1, scene.nv))
    efforts = finite("tau", tau, (steps, scene.nv))
    deviations = (("position", position), ("velocity", velocity), ("effort", effort))
    near, slow, weak = (1.0 / weights(name, given, scene.nv) for name, given in deviations)
    last = positive("end", end)
    way, goal = State(path[:-1], rates[:-1], near, slow), Terminal(State(path[-1], rates[-1], near * last, slow * last))
    costs = [Effort(weak, efforts), way, goal]
    start = (path[1:], rates[1:], efforts)
    return optimize(scene, path[0], rates[0], dt=dt, steps=steps, costs=costs, start=start, iterations=0, limits=False, effort=None)
