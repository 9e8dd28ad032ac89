"""Linear-quadratic regulators: constant ones, and those that follow a path."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arguments import numbers
from .._summary import summarized
from ..errors import ArgumentError, ShapeError, of_argument
from ._plan import MotionPlan, optimize
from ._terms import Effort, State, Terminal

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["Regulator", "lqr", "tracking"]

_Array = NDArray[np.float64]

#: Largest number of doublings; the error squares in each.
DOUBLINGS = 60
#: Largest relative change of the solution after the last doubling.
SETTLED = 1e-13


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
    Structure-preserving doubling (E. K.-W. Chu, H.-Y. Fan, W.-W. Lin and C.-S. Wang, Int. J. Control 77, 2004, 767-788),
    for continuous time after a Cayley transform.

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
    identity = np.eye(len(a))
    if dt is not None:
        if not (np.isfinite(dt) and dt > 0.0):
            raise of_argument(ArgumentError, "dt", f"found {dt}; expected a positive time, or None for continuous time")
        a, b = _held(a, b, dt)
        q, r = q * dt, r * dt
        value = _doubled(a, b @ np.linalg.solve(r, b.T), q)
        gains = np.linalg.solve(r + b.T @ value @ b, b.T @ value @ a)
    else:
        g = b @ np.linalg.solve(r, b.T)
        shift = max(float(np.linalg.norm(a)), 1e-3) * 1.1
        for _ in range(20):
            shifted = a - shift * identity
            inner = shifted.T + q @ np.linalg.solve(shifted, g)
            if min(np.linalg.cond(shifted), np.linalg.cond(inner)) < 1e8:
                break
            shift *= 1.7
        inverse = np.linalg.inv(inner)
        first = identity + 2.0 * shift * inverse.T
        middle = 2.0 * shift * np.linalg.solve(shifted, g) @ inverse
        last = 2.0 * shift * inverse @ q @ np.linalg.inv(shifted)
        value = _doubled(first, _symmetric(middle), _symmetric(last))
        value = _newton(a, g, q, value)
        gains = np.linalg.solve(r, b.T @ value)
    poles = np.linalg.eigvals(a - b @ gains)
    size = np.abs(poles) if dt is not None else np.exp(poles.real)
    if not (np.isfinite(value).all() and (size < 1.0).all()):
        raise of_argument(ArgumentError, "A, B", "found a system that these controls do not stabilize; expected one whose unstable motions B reaches and Q sees")
    return Regulator(np.asarray(gains, np.float64), value, np.asarray(poles, np.complex128))


def _system(A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike) -> tuple[_Array, _Array, _Array, _Array]:
    a, b = numbers("A", A), numbers("B", B)
    if a.ndim != 2 or a.shape[0] != a.shape[1]:
        raise of_argument(ShapeError, "A", f"found shape {a.shape}; expected (n, n)")
    if b.ndim != 2 or len(b) != len(a):
        raise of_argument(ShapeError, "B", f"found shape {b.shape}; expected ({len(a)}, m)")
    weights = []
    for name, given, width, least in (("Q", Q, len(a), 0.0), ("R", R, b.shape[1], np.finfo(float).tiny)):
        array = numbers(name, given)
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


def _doubled(a: _Array, g: _Array, q: _Array) -> _Array:
    """The stabilizing solution X of X = A^T X (1 + G X)^-1 A + Q."""
    identity = np.eye(len(a))
    with np.errstate(all="ignore"):
        for _ in range(DOUBLINGS):
            if not all(np.isfinite(of).all() for of in (a, g, q)):
                break
            middle = np.linalg.inv(identity + g @ q)
            new = _symmetric(q + a.T @ q @ middle @ a)
            g = _symmetric(g + a @ middle @ g @ a.T)
            a = a @ middle @ a
            change, q = np.abs(new - q).max(initial=0.0), new
            if change <= SETTLED * np.abs(q).max(initial=0.0):
                break
    return q


def _newton(a: _Array, g: _Array, q: _Array, value: _Array) -> _Array:
    """Newton steps of the continuous equation, which remove the rounding of the transform: Lyapunov equations by their
    eigenvectors.
    """
    for _ in range(2):
        closed = a - g @ value
        rest = a.T @ value + value @ a - value @ g @ value + q
        poles, vectors = np.linalg.eig(closed)
        if np.linalg.cond(vectors) > 1e6:
            break
        inner = vectors.T @ rest @ vectors
        solved = -inner / (poles[:, None] + poles[None, :])
        inverse = np.linalg.inv(vectors)
        value = _symmetric(value + (inverse.T @ solved @ inverse).real)
    return value


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
    path, rates, efforts = numbers("q", q), numbers("qd", qd), numbers("tau", tau)
    steps = len(efforts)
    for name, array, shape in (("q", path, (steps + 1, scene.nq)), ("qd", rates, (steps + 1, scene.nv)), ("tau", efforts, (steps, scene.nv))):
        if array.shape != shape:
            raise of_argument(ShapeError, name, f"found shape {array.shape}; expected {shape}")
    way = State(path[:-1], rates[:-1], position, velocity)
    goal = Terminal(State(path[-1], rates[-1], numbers("position", position) * end, numbers("velocity", velocity) * end))
    costs = [Effort(effort, efforts), way, goal]
    start = (path[1:], rates[1:], efforts)
    return optimize(scene, path[0], rates[0], dt=dt, steps=steps, costs=costs, start=start, iterations=0, limits=False, effort=None)
