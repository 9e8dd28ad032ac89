"""Square-root information form of the least-squares problem of a log, in time blocks.

For each motor, a block of rows [Z W y] is stored as its triangular factor R. Z holds the instruments, if any, W the
columns and y the torques. Triangles merge by QR factorization, in any order and on any machine. When the number of
blocks reaches twice the requested number, neighbors are merged. The memory therefore is O(blocks p^2) for logs of any
length, and one pass over the data suffices.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..errors import ArgumentError, OutOfMemoryError, ShapeError, of_argument
from ._columns import Columns
from ._values import each

if TYPE_CHECKING:
    from .._core import Scene
    from ._identification import Identification
    from ._payload import DriveGains, Payload

__all__ = ["Accumulator", "Block"]

_Array = NDArray[np.float64]

#: Number of regressor entries computed per chunk; minimum and maximum number of states per chunk.
AT_ONCE, FEWEST, MOST = 1 << 19, 64, 4096
#: Default number of states per block.
FIRST = 256
#: Largest accepted torque; its square does not overflow.
LARGEST = 1e100
#: Minimum number of states for rotations on several threads.
THREADED = 256
#: Number of states per call at which the effect of acceleration noise is computed.
SAMPLED = 100


class Block(NamedTuple):
    """Rows of a log, as triangles."""

    states: int
    counts: _Array
    """Number of measured torques of each motor."""
    triangles: list[_Array]
    """Triangular factor of [Z W y] of each motor, (rows, width), with rows <= width."""


class Accumulator:
    """Measured motion and torques, reduced to triangular factors.

    The memory does not grow with the log, and parts of logs can be accumulated on different machines.

    Parameters
    ----------
    scene : phipsi.Scene
        The model.
    fit, keep, friction_speed, stribeck_speed, transmission
        As in Scene.identify.
    load_model : phipsi.Scene, optional
        Model whose torques the friction of "load" is proportional to; None: `scene`. Scene.identify uses the result of
        a first identification.
    instruments : bool
        True if `add` receives instruments.
    acceleration_noise : array_like, optional
        Standard deviation of the noise in qdd, (nv,), as in Scene.identify.
    blocks : int
        Minimum number of time blocks for the jackknife of the intervals, if there are that many states.
    block_length : int
        Initial number of states per block.

    Raises
    ------
    ArgumentError
        Unknown names, a singular transmission.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> from phipsi.estimation import Accumulator
    >>> scene = phipsi.scenes.chain(3)
    >>> q, qd, qdd = np.random.default_rng(0).uniform(-1, 1, (3, 1000, 3))
    >>> tau = scene.inverse_dynamics(q, qd, qdd)
    >>> first = Accumulator(scene).add(q[:500], qd[:500], qdd[:500], tau[:500])
    >>> second = Accumulator(scene).add(q[500:], qd[500:], qdd[500:], tau[500:])
    >>> first.merge(second).states
    1000
    """

    def __init__(
        self,
        scene: Scene,
        *,
        fit: Collection[str] = (),
        keep: Collection[str] = (),
        friction_speed: float = 0.01,
        stribeck_speed: float = 0.1,
        transmission: ArrayLike | None = None,
        load_model: Scene | None = None,
        instruments: bool = False,
        acceleration_noise: ArrayLike | None = None,
        blocks: int = 20,
        block_length: int = FIRST,
    ) -> None:
        for name, value, least in (("blocks", blocks, 2), ("block_length", block_length, 1)):
            if not (isinstance(value, (int, np.integer)) and value >= least):
                raise of_argument(ArgumentError, name, f"found {value!r}; expected a whole number, at least {least}")
        self.columns = Columns(scene, fit, keep, friction_speed, stribeck_speed, transmission, load_model)
        self.instruments, self.wanted, self.length = bool(instruments), int(blocks), int(block_length)
        self.acceleration_noise = None if acceleration_noise is None else _deviations(scene, acceleration_noise)
        motors = self.columns.motors
        self._widths = [(1 + self.instruments) * len(used) + 1 for used in self.columns.used]
        self._closed: list[Block] = []
        self._open = self._empty()
        #: Sums of squares of the measured torques of each motor, and triangles of the effect of acceleration noise.
        self._squares = np.zeros(motors)
        self._noise = [np.zeros((0, len(used) + 1)) for used in self.columns.used]

    @property
    def scene(self) -> Scene:
        """The model."""
        return self.columns.scene

    @property
    def states(self) -> int:
        """Number of added states."""
        return self._open.states + sum(block.states for block in self._closed)

    def add(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        tau: ArrayLike,
        *,
        instruments: tuple[ArrayLike, ArrayLike, ArrayLike] | None = None,
    ) -> Accumulator:
        """Add measured states in the order of time.

        Parameters
        ----------
        q : (k, nq) array_like
            Joint positions, rad or m.
        qd : (k, nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (k, nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        tau : (k, motors) array_like
            Measured torques, N m or N; NaN: not measured.
        instruments : tuple of (q, qd, qdd), optional
            Commanded trajectory at the same times.

        Returns
        -------
        accumulator : Accumulator
            The same accumulator.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument. The message names it.
        OutOfMemoryError
            Too many states or bodies for the memory.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> tau = scene.inverse_dynamics(q, qd, qdd)
        >>> phipsi.estimation.Accumulator(scene).add(q, qd, qdd, tau).states
        50
        """
        try:
            return self._add(q, qd, qdd, tau, instruments)
        except MemoryError:
            size = 8 * (sum(width**2 for width in self._widths) + len(np.asarray(q)) * 4 * self.scene.nv)
            error = of_argument(
                OutOfMemoryError, "q", f"no room for {size} bytes; expected fewer states, or fewer bodies (Scene.lock)"
            )
            error.bytes = size
            raise error from None

    def _add(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        tau: ArrayLike,
        instruments: tuple[ArrayLike, ArrayLike, ArrayLike] | None,
    ) -> Accumulator:
        scene, columns = self.scene, self.columns
        q, qd, qdd, tau = _log(scene, q, qd, qdd, tau)
        count = len(q)
        if (instruments is not None) != self.instruments:
            found = "none" if instruments is None else "some"
            raise of_argument(
                ArgumentError,
                "instruments",
                f"found {found}; expected as in the constructor: instruments={self.instruments}",
            )
        reference = None
        if instruments is not None:
            if not (
                isinstance(instruments, (tuple, list))
                and len(instruments) == 3
                and all(len(np.asarray(one)) == count for one in instruments)
            ):
                raise of_argument(
                    ShapeError,
                    "instruments",
                    f"found no three arrays of {count} states; expected (q, qd, qdd) of the commanded"
                    " trajectory at the same times",
                )
            reference = _log(scene, *instruments, tau, prefix="instruments: ")[:3]
        chunk = int(min(max(AT_ONCE // max(scene.nv * len(scene.body_names) * 10, 1), FEWEST), MOST))
        if self.acceleration_noise is not None:
            every = max(1, count // SAMPLED)
            self._add_noise(q[::every], qd[::every], qdd[::every], float(every))
        for begin in range(0, count, chunk):
            part = slice(begin, begin + chunk)
            with np.errstate(over="ignore", invalid="ignore"):
                parts = columns.parts(q[part], qd[part], qdd[part])
            _check_size("q, qd, qdd", parts.of_bodies, *parts.of_motors, parts.known)
            of_reference = (
                None
                if reference is None
                else columns.rows(reference[0][part], reference[1][part], reference[2][part])[0]
            )
            _check_size("instruments", *(of_reference or ()), np.zeros(0))
            measured = columns.measured(q[part], tau[part])
            seen = np.isfinite(measured)
            torque = measured - parts.known
            last = [np.column_stack([own, torque[:, motor]]) for motor, own in enumerate(parts.of_motors)]
            self._squares += np.sum(np.where(seen, measured, 0.0) ** 2, axis=0)
            at = 0
            while at < len(torque):
                upto = min(len(torque), at + self.length - self._open.states)
                self._rotate(slice(at, upto), (parts.of_bodies, last), of_reference, seen)
                self._open = self._open._replace(states=self._open.states + upto - at)
                at = upto
                if self._open.states == self.length:
                    self._close()
        return self

    def _rotate(
        self, part: slice, rows: tuple[_Array, list[_Array]], reference: list[_Array] | None, seen: NDArray[np.bool_]
    ) -> None:
        """Rotate the rows of each motor into its triangle of the open block, on several threads for many rows."""

        def rotate(motor: int) -> None:
            measured, chosen, triangle = seen[part, motor], self.columns.chosen[motor], self._open.triangles[motor]
            wide, own = rows[0][part], rows[1][motor][part]
            if reference is None and measured.all():
                _core._rotate_chosen(triangle, wide, chosen.tolist(), own)
            else:
                before = [] if reference is None else [reference[motor][part]]
                _core._rotate_rows(
                    triangle, np.ascontiguousarray(np.concatenate([*before, wide[:, chosen], own], axis=1)[measured])
                )
            self._open.counts[motor] += int(measured.sum())

        # The widest triangles first, for load balancing.
        motors = sorted(range(len(self._widths)), key=lambda motor: -self._widths[motor])
        threads = min(_core.get_num_threads(), len(motors))
        if threads > 1 and part.stop - part.start >= THREADED:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(rotate, motors))
        else:
            for motor in motors:
                rotate(motor)

    def merge(self, other: Accumulator) -> Accumulator:
        """Merge two accumulators of the same model and settings.

        Parameters
        ----------
        other : Accumulator
            Accumulator of later states.

        Returns
        -------
        accumulator : Accumulator
            A new accumulator with the states of this one, followed by the states of `other`.

        Raises
        ------
        ArgumentError
            Accumulators of different models or settings.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> tau = scene.inverse_dynamics(q, qd, qdd)
        >>> first = phipsi.estimation.Accumulator(scene).add(q[:20], qd[:20], qdd[:20], tau[:20])
        >>> second = phipsi.estimation.Accumulator(scene).add(q[20:], qd[20:], qdd[20:], tau[20:])
        >>> first.merge(second).states
        50
        """
        if not (
            isinstance(other, Accumulator)
            and self.columns.same_as(other.columns)
            and self.instruments == other.instruments
        ):
            raise of_argument(
                ArgumentError,
                "other",
                "found an accumulator of other columns; expected the same scene, fit, keep, transmission and"
                " instruments",
            )
        found = self._like()
        parts = [self, other]
        found.length = (
            max(one.length for one in parts if one.states) if any(one.states for one in parts) else self.length
        )
        for one in parts:
            blocks, length = one.blocks(), one.length
            while length < found.length:
                blocks, length = _halved(blocks), 2 * length
            found._closed += blocks
            found._squares = found._squares + one._squares
            found._noise = [_triangle(np.concatenate(both)) for both in zip(found._noise, one._noise, strict=True)]
        found._coarsen()
        return found

    def blocks(self) -> list[Block]:
        """Blocks of states in the order of time.

        Returns
        -------
        blocks : list of Block
            Named tuples (states, counts, triangles): number of states, number of measured torques of each motor, and
            triangular factor of each motor. A last block of less than half the length is merged with its neighbor.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> tau = scene.inverse_dynamics(q, qd, qdd)
        >>> accumulator = phipsi.estimation.Accumulator(scene, block_length=20).add(q, qd, qdd, tau)
        >>> [block.states for block in accumulator.blocks()]
        [20, 20, 10]
        """
        found = list(self._closed)
        if self._open.states:
            last = self._trimmed(self._open)
            if found and 2 * last.states < self.length:
                found[-1] = _joined(found[-1], last)
            else:
                found.append(last)
        return found

    def identify(
        self,
        *,
        noise: ArrayLike | None = None,
        trust: float | Mapping[str, float] | ArrayLike = 1.0,
        total_mass: tuple[float, float] | None = None,
    ) -> Identification:
        """Identify the parameters from all added states.

        Parameters
        ----------
        noise : float or (motors,) array_like, optional
            Standard deviation of the torques, N m or N, as in Scene.identify.
        trust : float, dict of float or (bodies,) array_like, default 1
            Weight of the parameters of the scene, as in Scene.identify.
        total_mass : (float, float), optional
            Mass of the robot and its standard deviation, kg, as in Scene.identify.

        Returns
        -------
        identification : Identification
            As in Scene.identify.

        Raises
        ------
        ArgumentError, ShapeError
            As in Scene.identify.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> tau = scene.inverse_dynamics(q, qd, qdd)
        >>> accumulator = phipsi.estimation.Accumulator(scene).add(q, qd, qdd, tau)
        >>> accumulator.identify(noise=0.01).parameters.shape
        (2, 10)
        """
        from ._identification import solved

        return solved(self, noise, trust, total_mass=total_mass)

    def identify_payload(self, link: str, *, without: Accumulator, noise: ArrayLike | None = None) -> Payload:
        """Identify the load of a link from the states of this log, with it, and of another one, without it.

        Parameters
        ----------
        link : str
            Link that carries the load, for instance the flange.
        without : Accumulator
            States of the robot without the load, with the same scene, fit, keep and transmission.
        noise : float or (motors,) array_like, optional
            Standard deviation of the torques, N m or N. None: that of the residuals of both logs.

        Returns
        -------
        payload : Payload
            Mass, center of mass and inertia of the load with their covariance, from the errors of both logs.

        Raises
        ------
        ArgumentError, ShapeError
            Accumulators of different models or of fewer than four blocks of time; a link that does not move or is in
            keep; friction by load. The message names it.

        Notes
        -----
        Least squares of both logs together, with the parameters of the robot and of the load, without a prior. Errors
        of the inertias of the scene do not affect the load. If both logs have the same motion, errors of its friction
        do not either. Blocks of both logs are deleted in pairs (jackknife).

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> from phipsi.estimation import Accumulator
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 400, 6))
        >>> tau = [one.inverse_dynamics(q, qd, qdd) for one in (scene, scene.with_payload("flange", 0.5))]
        >>> empty, loaded = (Accumulator(scene, block_length=20).add(q, qd, qdd, one) for one in tau)
        >>> round(loaded.identify_payload("flange", without=empty).mass, 6)
        0.5
        """
        from ._payload import identify_payload

        return identify_payload(self, link, without, noise)

    def identify_gains(
        self,
        link: str,
        mass: float,
        com: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike | None = None,
        *,
        without: Accumulator,
    ) -> DriveGains:
        """Identify the gain of each drive, torque = gain current, from logs of currents with and without a known load.

        Parameters
        ----------
        link : str
            Link that carries the load in this log.
        mass : float
            Mass of the load, kg.
        com : (3,) array_like, optional
            Its center of mass in the frame of the link, m.
        inertia : (3, 3) array_like, optional
            Its inertia about the center of mass, in the axes of the link, kg m^2. None: a point mass.
        without : Accumulator
            States without the load, with the same scene, fit and transmission.

        Returns
        -------
        gains : DriveGains
            Gain of each motor with its standard deviation and interval.

        Raises
        ------
        ArgumentError, ShapeError
            As identify_payload; a scene with armature, damping, friction or springs that are not fitted, links in keep,
            connections.

        Notes
        -----
        The states are added with currents as `tau`, A. A log alone determines ratios of parameters and gains; the known
        load is the scale. Each motor has parameters of its own, so that its gain does not depend on other drives. A
        scene has no gains: multiply currents by them, for `tau` of identify.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> from phipsi.estimation import Accumulator
        >>> scene = phipsi.scenes.chain(3)
        >>> link, com, draw = scene.body_names[2], (0.1, 0.0, 0.2), np.random.default_rng(0)
        >>> q, qd, qdd = draw.normal(size=(3, 200, 3))
        >>> torques = [one.inverse_dynamics(q, qd, qdd) for one in (scene, scene.with_payload(link, 2.0, com))]
        >>> empty, loaded = (Accumulator(scene, block_length=10).add(q, qd, qdd, one / 8.0) for one in torques)
        >>> loaded.identify_gains(link, 2.0, com, without=empty).gains.round(6)
        array([8., 8., 8.])
        """
        from ._payload import identify_gains

        return identify_gains(self, (link, mass, com, inertia), without)

    def _like(self) -> Accumulator:
        """An empty accumulator of the same columns."""
        found = Accumulator.__new__(Accumulator)
        found.__dict__.update(self.__dict__)
        found._closed, found._open = [], found._empty()
        found._squares = np.zeros_like(self._squares)
        found._noise = [np.zeros((0, len(used) + 1)) for used in self.columns.used]
        return found

    def _empty(self) -> Block:
        return Block(0, np.zeros(len(self._widths)), [np.zeros((width, width)) for width in self._widths])

    def _close(self) -> None:
        self._closed.append(self._trimmed(self._open))
        self._open = self._open._replace(states=0, counts=np.zeros_like(self._open.counts))
        for triangle in self._open.triangles:
            triangle.fill(0.0)
        self._coarsen()

    def _coarsen(self) -> None:
        while len(self._closed) >= 2 * self.wanted:
            self._closed, self.length = _halved(self._closed), 2 * self.length

    @staticmethod
    def _trimmed(block: Block) -> Block:
        return Block(block.states, block.counts.copy(), [_trimmed(triangle) for triangle in block.triangles])

    def _add_noise(self, q: _Array, qd: _Array, qdd: _Array, weight: float) -> None:
        """Accumulate the change of the columns and of the known torques by acceleration noise."""
        assert self.acceleration_noise is not None
        for joint, deviation in enumerate(self.acceleration_noise):
            changed = [np.sqrt(weight) * deviation * more for more in self.columns.sensitivity(q, qd, qdd, joint)]
            _check_size("acceleration_noise", *changed)
            self._noise = [
                _triangle(np.concatenate([had, more])) for had, more in zip(self._noise, changed, strict=True)
            ]


def _log(
    scene: Scene, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, tau: ArrayLike, prefix: str = ""
) -> tuple[_Array, _Array, _Array, _Array]:
    """The arrays of a log, checked."""
    q, qd, qdd = (
        np.asarray(_core._numbers(*one))
        for one in ((prefix + "q", q, scene, True), (prefix + "qd", qd, scene), (prefix + "qdd", qdd, scene))
    )
    tau = np.asarray(_core._numbers("tau", tau, scene))
    count = len(q) if q.ndim == 2 else 0
    for name, array, size in (("q", q, scene.nq), ("qd", qd, scene.nv), ("qdd", qdd, scene.nv), ("tau", tau, scene.nv)):
        if array.shape != (count, size) or count == 0:
            raise of_argument(
                ShapeError,
                prefix + name if name != "tau" else name,
                f"found shape {array.shape}; expected (k, {size}), as many states as q has",
            )
    if np.any(np.isinf(tau)):
        raise of_argument(
            ArgumentError, "tau", "found an infinity; expected numbers, NaN where a torque was not measured"
        )
    # Reports what is not finite, by the index of the state.
    for begin in range(0, count, MOST):
        part = slice(begin, begin + MOST)
        if not all(np.isfinite(one[part]).all() for one in (q, qd, qdd)):
            scene.inverse_dynamics(q, qd, qdd)
    largest = max(float(np.nanmax(tau, initial=0.0)), -float(np.nanmin(tau, initial=0.0)))
    if largest > LARGEST:
        raise of_argument(ArgumentError, "tau", f"found {largest:g}; expected torques below {LARGEST:g}, in N m or N")
    return q, qd, qdd, tau


def _check_size(name: str, *arrays: _Array) -> None:
    """Refuse columns of torques whose products overflow."""
    largest = max(float(np.abs(array).max(initial=0.0)) for array in arrays)
    if not largest <= LARGEST:
        found = f"found a motion with columns of torques up to {largest:g}"
        raise of_argument(ArgumentError, name, f"{found}; expected below {LARGEST:g}, with motion in rad, m and s")


def _deviations(scene: Scene, noise: ArrayLike) -> _Array:
    found = np.asarray(_core._numbers("acceleration_noise", noise))
    refused = "found {least}; expected finite standard deviations, not negative"
    return each("acceleration_noise", found, scene.nv, refused)


def _halved(blocks: list[Block]) -> list[Block]:
    """Neighbors merged; one that is left over joins the pair before it."""
    found = [_joined(one, other) for one, other in zip(blocks[0::2], blocks[1::2], strict=False)]
    if len(blocks) % 2:
        if found:
            found[-1] = _joined(found[-1], blocks[-1])
        else:
            found.append(blocks[-1])
    return found


def _joined(one: Block, other: Block) -> Block:
    merged = [merged_triangles([mine, its]) for mine, its in zip(one.triangles, other.triangles, strict=True)]
    return Block(one.states + other.states, one.counts + other.counts, merged)


def merged_triangles(parts: list[_Array]) -> _Array:
    """Triangular factor of the concatenated rows."""
    width = parts[0].shape[1]
    found = np.zeros((width, width))
    for part in parts:
        _core._rotate_rows(found, np.ascontiguousarray(part))
    return _trimmed(found)


def _trimmed(triangle: _Array) -> _Array:
    """Remove trailing zero rows."""
    rows = np.flatnonzero(triangle.any(axis=1))
    return triangle[: rows[-1] + 1 if len(rows) else 0].copy()


def _triangle(rows: _Array) -> _Array:
    return merged_triangles([rows])
