"""Faults of measured torques, found by comparison with the model and with least squares, and the clock of the torques.

The torque of motor m is compared with the model as y_m = f i_m + b g_m + nuisances. i is the torque of the model from
accelerations and velocities, g the one from gravity; the nuisances are armature, damping, friction and offset of the
motor. A log and a model that fit each other have f = b = 1. LogWarnings name the motor, the numbers found and
expected, and the fix.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import LogWarning, warn
from ._checks import shifted
from ._columns import Columns
from ._student import student_quantile

__all__ = ["BEYOND", "Clock", "beyond_bodies", "warn_of_bodies", "warn_of_faults"]

_Array = NDArray[np.float64]

#: Number of states used.
SAMPLED = 3000
#: Factor between measured and model torques of all motors beyond which their unit is suspected; least correlation of
#: them, without nuisances, or share of the variance, for a suspicion; largest ratio of factors above one that are those
#: of a unit.
FACTOR, OPPOSED, SPREAD = 1.6, 0.8, 3.0
#: Least share of the variance of a torque that is a term, and largest share of the unexplained variance that remains
#: when two torques are exchanged; least number of states.
BETTER, FEWEST = 0.25, 20
#: Gravity is missing if its coefficient is below this number, and that of the other torques not below 1.5 times it.
MISSING = 0.4
#: Share of the variance of the accelerations that is noise, and largest coefficient of the noise in the torques
#: relative to that of the accelerations at all frequencies.
NOISY, FOLLOWED = 4e-3, 0.3
#: Number of blocks of time for standard deviations; false positives of a test of one parameter of one motor; least
#: decrease of the variance of the residuals by this parameter, and least torque of it relative to that of the motor,
#: and to the given noise.
BLOCKS, UNLIKELY, EXPLAINED, SMALL, SMALL_NOISE = 20, 1e-6, 0.03, 1e-4, 0.1
#: Least share of a column that other parameters do not explain; least number of blocks in which it is not zero.
COLLINEAR, FEWEST_BLOCKS = 0.1, 5.0
#: Stribeck friction is looked for above this multiple of the speed below which friction is viscous in the columns, and
#: reported above this share of the dry friction: a sign that is not smooth has about half of it.
ABOVE, EXCESS = 2.0, 0.15
#: Maximum delay between the clocks, s, as a share of the log, and in samples of the fine search; minimum relative
#: reduction of the residual variance, and of standard deviations, for a warning.
LONGEST, OF_LOG, LAGS, REDUCED, CERTAIN = 1.0, 0.1, 40, 0.03, 4.0
#: Delay, s, from which the residuals of noise alone have several minima, and minimum reduction there.
NEAR, REDUCED_FAR = 0.05, 0.1
#: Largest step between the states, s.
SLOWEST = 0.008
#: Maximum number of matrix entries for the comparison with least squares.
ENTRIES = 5_000_000
#: Residual of possible bodies, in standard deviations of the noise, beyond that of least squares, for a warning.
BEYOND = 1.0
#: Least scale of the torques of a motor relative to the largest one, for motors without torques.
LEAST = 1e-6


class Clock(NamedTuple):
    """Delay of the torques relative to q, s, and its standard deviation; NaN if they are not known."""

    offset: float
    deviation: float


def warn_of_faults(
    columns: Columns,
    used: NDArray[np.intp],
    time: _Array | None,
    arrays: tuple[_Array, _Array, _Array, _Array],
    noise: _Array | None,
    differences: bool,
) -> tuple[Clock, bool]:
    """Warn about torques that contradict the model or the motion.

    Return the clock of the torques, and whether there was no warning. `arrays` are q, qd, qdd and the torques, `used`
    the independent columns, `noise` the given standard deviations of the torques, (motors,). With `differences`, noise
    of the accelerations is looked for.
    """
    found = _compared(columns, arrays)
    texts = _of_model(columns, found)
    clock = Clock(float("nan"), float("nan"))
    if not texts and columns.motors:
        squares = np.where(np.isfinite(arrays[3]), arrays[3], 0.0) ** 2
        scales = np.sqrt(squares.mean(axis=0))
        scales = np.maximum(scales, LEAST * (scales.max() or 1.0))
        scales[~np.isfinite(arrays[3]).any(axis=0)] = np.nan
        least = _LeastSquares(columns, used, time, arrays, scales)
        if len(least.residual) > 2 * len(used):
            clock, delay = least.clock()
            gain, friction = least.of_friction(np.zeros(columns.motors) if noise is None else noise)
            texts = delay if least.gain > gain else []
            texts = texts or (_of_accelerations(columns, arrays) if differences else []) or friction
    for text in texts:
        warn(text, LogWarning)
    return clock, not texts


class _Compared(NamedTuple):
    """Comparison of the measured torques with those of the model."""

    explained: _Array
    """Share of the variance of the measured torque of motor i that model torque and nuisances of motor j explain,
    (motors, motors); zero without measured torques."""
    correlation: _Array
    """Correlation of measured and model torque of each motor without its nuisances, (motors,); zero if one of them is
    rounding."""
    factor: _Array
    """Least-squares factor between them, (motors,); NaN if one of them is rounding."""
    size: _Array
    """Root mean square of the model torque without nuisances, (motors,)."""
    opposed: NDArray[np.bool_]
    """Motors whose largest torque is armature, damping or friction with a negative coefficient."""
    parts: list[tuple[_Array, _Array]]
    """For each motor (i, g) without nuisances, (k, 2), and the measured torque without nuisances, (k,)."""


def _compared(columns: Columns, arrays: tuple[_Array, _Array, _Array, _Array]) -> _Compared:
    some = slice(None, None, max(1, len(arrays[0]) // SAMPLED))
    q, qd, qdd, tau = (one[some] for one in arrays)
    scene, motors = columns.scene, columns.motors
    # Without armature, which is a nuisance.
    whole = columns.measured(q, columns.to_motors(scene.inverse_dynamics(q, qd, qdd) - scene.armature * qdd))
    gravity = columns.measured(q, columns.to_motors(scene.gravity_torque(q)))
    springs = scene.stiffness * scene.difference(np.broadcast_to(scene.rest, q.shape), q)
    tau = tau - columns.measured(q, columns.to_motors(springs))
    v, a = columns.rates(qd), columns.rates(qdd)
    sliding = v / np.sqrt(v**2 + columns.slow**2)
    rounding = 1e-6 * float(np.sqrt(np.mean(whole**2))) if whole.size else 0.0
    explained, correlation, factor, size = np.zeros((motors, motors)), *np.zeros((3, motors))
    factor[:] = np.nan
    opposed, parts = np.zeros(motors, bool), [(np.zeros((0, 2)), np.zeros(0))] * motors
    for motor in range(motors):
        seen = np.isfinite(tau[:, motor])
        if seen.sum() < FEWEST:
            continue
        torque = tau[seen, motor]
        variance = float(np.sum((torque - torque.mean()) ** 2))
        if variance <= 1e-20 * float(torque @ torque):
            continue
        for other in range(motors):
            model = np.column_stack([whole[seen, other] - gravity[seen, other], gravity[seen, other]])
            nuisances = np.column_stack([np.ones(len(torque)), v[seen, other], sliding[seen, other], a[seen, other]])
            rest = _without(nuisances, np.column_stack([model, torque]))
            of_model, own = rest[:, 0] + rest[:, 1], rest[:, 2]
            squares = float(of_model @ of_model)
            value = float(own @ of_model) / squares if squares > len(torque) * rounding**2 else 0.0
            explained[motor, other] = 1.0 - float(np.sum((own - value * of_model) ** 2)) / variance
            if other != motor:
                continue
            parts[motor], size[motor] = (rest[:, :2], own), np.sqrt(squares / len(torque))
            if value != 0.0:
                factor[motor], correlation[motor] = value, value * np.sqrt(squares / float(own @ own))
            sure = value if abs(correlation[motor]) > OPPOSED else 0.0
            terms = nuisances[:, 1:] * _solution(nuisances, torque - sure * model.sum(axis=1))[1:]
            most = int(np.argmax(np.std(terms, axis=0)))
            larger = np.std(terms[:, most]) > max(abs(sure) * size[motor], np.sqrt(BETTER * variance / len(torque)))
            opposed[motor] = (
                larger and explained[motor, motor] > OPPOSED and terms[:, most] @ nuisances[:, 1 + most] < 0.0
            )
    return _Compared(explained, correlation, factor, size, opposed, parts)


def _solution(rows: _Array, values: _Array) -> _Array:
    """Least-squares coefficients of columns of any units."""
    norms = np.linalg.norm(rows, axis=0)
    norms[norms == 0.0] = 1.0
    scaled = np.linalg.lstsq(rows / norms, values, rcond=1e-8)[0]
    return np.asarray((scaled.T / norms).T)


def _without(nuisances: _Array, values: _Array) -> _Array:
    """Values, (k, n), projected on the complement of the nuisances."""
    return np.asarray(values - nuisances @ _solution(nuisances, values))


def _of_model(columns: Columns, found: _Compared) -> list[str]:
    """Torques of another sign, joint or unit than the model's, and torques without gravity."""
    names, own, cross = columns.motor_names, np.diag(found.explained), found.explained
    measured = [at for at in range(columns.motors) if len(found.parts[at][1])]
    pairs = {
        (i, j): cross[i, j] + cross[j, i]
        for i in measured
        for j in measured
        if i < j
        and max(cross[i, j], cross[j, i]) > OPPOSED
        and 2.0 - cross[i, j] - cross[j, i] < BETTER * (2.0 - own[i] - own[j])
    }
    if pairs:
        i, j = max(pairs, key=lambda pair: pairs[pair])
        return [
            f"tau: found torques of {names[i]!r} and {names[j]!r} of which the model explains {100 * own[i]:.2g} and"
            f" {100 * own[j]:.2g} %, and {100 * cross[i, j]:.2g} and {100 * cross[j, i]:.2g} % when they are exchanged;"
            f" expected the order {', '.join(names)}: exchange the two columns of tau"
        ]
    decided = (np.abs(found.correlation) > OPPOSED) | found.opposed
    opposed = np.flatnonzero(np.where(np.abs(found.correlation) > OPPOSED, found.factor < 0.0, found.opposed))
    if len(opposed):
        listed = ", ".join(
            f"{names[at]!r}: {'negative friction or armature' if found.opposed[at] else f'{found.factor[at]:.2g}'}"
            for at in opposed
        )
        of_all = 2 * len(opposed) > decided.sum()
        of = "tau" if of_all else " and ".join(repr(names[at]) for at in opposed)
        return [
            f"tau: found torques of the opposite sign of the model's, with the factors {listed}; expected 1, torques"
            f" that accelerate a joint in the direction of q: change the sign of {of}{'' if of_all else ' in tau'}"
        ]
    alike = np.flatnonzero(found.correlation > OPPOSED)
    factors, sizes = found.factor[alike], found.size[alike] ** 2
    most = len(alike) and sizes.sum() > 0.5 * np.sum(found.size**2)
    for beyond in (factors > FACTOR, factors < 1.0 / FACTOR):
        # An unknown payload has other factors at each joint, all above one.
        if (
            most
            and sizes[beyond].sum() > 0.8 * sizes.sum()
            and 3 * beyond.sum() >= 2 * len(alike)
            and (factors[beyond].max() < 1.0 or factors[beyond].max() < SPREAD * factors[beyond].min())
        ):
            listed = ", ".join(f"{names[at]!r}: {found.factor[at]:.3g}" for at in alike)
            return [
                f"tau: found torques proportional to those of the model with the factors {listed}, probably motor"
                " currents; expected N m or N, with factors of about 1: multiply by torque constant and gear ratio, or"
                " correct the masses of the model (Scene.with_inertias)"
            ]
    return _of_gravity(columns, found)


def _of_gravity(columns: Columns, found: _Compared) -> list[str]:
    """Torques without those of gravity: the coefficients of all motors together, with standard deviations of blocks."""
    sums, right, largest = np.zeros((BLOCKS, 2, 2)), np.zeros((BLOCKS, 2)), np.zeros(columns.motors)
    for motor, (parts, own) in enumerate(found.parts):
        if not len(own) or not parts[:, 1].any():
            continue
        values = np.linalg.lstsq(parts, own, rcond=1e-8)[0]
        noise = np.sqrt(np.mean((own - parts @ values) ** 2)) + 1e-6 * np.sqrt(np.mean(parts**2))
        largest[motor] = np.sqrt(np.mean(parts[:, 1] ** 2))
        for block, rows in enumerate(np.array_split(np.arange(len(own)), BLOCKS)):
            scaled = parts[rows] / noise
            sums[block] += scaled.T @ scaled
            right[block] += scaled.T @ own[rows] / noise
    whole = sums.sum(axis=0)
    if whole[1, 1] == 0.0 or np.linalg.cond(whole) > 1e12:
        return []
    factor, coefficient = np.linalg.solve(whole, right.sum(axis=0))
    spread = np.sqrt(BLOCKS * np.sum((right - sums @ np.array([factor, coefficient])) ** 2, axis=0) / (BLOCKS - 1))
    of_factor, deviation = np.abs(np.linalg.inv(whole)) @ spread
    if abs(coefficient) + 3.0 * deviation > MISSING or factor + 3.0 * of_factor < 1.5 * MISSING:
        return []
    name = columns.motor_names[int(np.argmax(largest))]
    text = (
        f"tau: found torques with {coefficient:.2f} of the gravity torque of the model, which is {largest.max():.3g}"
        f" N m or N at {name!r}; expected 1: add scene.gravity_torque(q) if the drive leaves gravity out, or use a"
        " scene with the gravity of the log"
    )
    return [text]


def _of_accelerations(columns: Columns, arrays: tuple[_Array, _Array, _Array, _Array]) -> list[str]:
    """Noise of accelerations at high frequencies that the torques do not follow, as that of differences of q.

    The coefficient of the inertial torque of the model is compared with that for fourth differences in time.
    """
    first = max(0, (len(arrays[0]) - SAMPLED) // 2)
    q, qd, qdd, tau = (one[first : first + SAMPLED] for one in arrays)
    if len(q) < 50 or columns.connected:
        return []
    scene = columns.scene
    gravity, inertial = scene.gravity_torque(q), scene.inverse_dynamics(q, np.zeros_like(qd), qdd)
    moving, v = scene.inverse_dynamics(q, qd, np.zeros_like(qdd)) - gravity, columns.rates(qd)
    parts = [columns.to_motors(inertial - gravity), columns.to_motors(gravity), columns.to_motors(moving), v]
    parts += [v / np.sqrt(v**2 + columns.slow**2), np.ones_like(v)]
    texts = []
    for motor, name in enumerate(columns.motor_names):
        torque, rows = tau[:, motor], np.column_stack([one[:, motor] for one in parts])
        fast, rows_fast = np.diff(torque, 4) / np.sqrt(70.0), np.diff(rows, 4, axis=0) / np.sqrt(70.0)
        variance = float(np.var(rows[:, 0]))
        if not np.isfinite(torque).all() or variance <= 1e-12 * float(np.mean(torque**2)):
            continue
        share = float(np.mean(rows_fast[:, 0] ** 2)) / variance
        if share <= NOISY:
            continue
        (slope, _), (slope_fast, deviation) = _coefficient(rows, torque), _coefficient(rows_fast[:, :-1], fast)
        if slope_fast + 3.0 * deviation < FOLLOWED * slope:
            noise = float(np.sqrt(np.mean(np.diff(columns.rates(qdd)[:, motor], 4) ** 2) / 70.0))
            found = (
                f"{name!r} of about {noise:.2g} rad/s^2 or m/s^2, {100.0 * np.sqrt(share):.2g} % of the inertial torque"
            )
            texts.append((share, found))
    if not texts:
        return []
    return [
        f"qdd: found noise at {max(texts)[1]}, which the torques do not follow; expected less than"
        f" {100.0 * np.sqrt(NOISY):.2g} %, because it biases the estimates: use phipsi.smooth(time, q) instead of"
        " differences, or give instruments=(q, qd, qdd) of the commanded trajectory"
    ]


def _coefficient(rows: _Array, values: _Array) -> tuple[float, float]:
    """Least-squares coefficient of the first column, and its standard deviation for independent residuals."""
    rest = _without(rows[:, 1:], np.column_stack([rows[:, 0], values]))
    size = float(rest[:, 0] @ rest[:, 0])
    if size == 0.0:
        return 0.0, float("inf")
    value = float(rest[:, 0] @ rest[:, 1]) / size
    return value, float(np.sqrt(np.mean((rest[:, 1] - value * rest[:, 0]) ** 2) / size))


class _LeastSquares:
    """Residuals of least squares in the base parameters, at some states of a log."""

    def __init__(
        self,
        columns: Columns,
        used: NDArray[np.intp],
        time: _Array | None,
        arrays: tuple[_Array, _Array, _Array, _Array],
        weights: _Array,
    ) -> None:
        self.columns, self.time, self.arrays, self.used = columns, time, arrays, used
        most = int(min(SAMPLED, max(10 * LAGS, ENTRIES // (columns.motors * columns.width))))
        self.at = self._chosen(len(arrays[0]), most)
        self.known_at = np.isfinite(weights)
        self.scale = np.where(self.known_at, weights, 1.0)
        rows, self.known = self._rows(self.at)
        matrix = rows.reshape(-1, rows.shape[2])
        norms = np.linalg.norm(matrix, axis=0)
        self.norms = np.where(norms > 0.0, norms, 1.0)
        left, singular, self.right = np.linalg.svd(matrix / self.norms, full_matrices=False)
        self.kept = singular > 1e-8 * singular.max(initial=0.0)
        self.orthogonal, self.singular = left[:, self.kept], singular[self.kept]
        self.target = self._target(self.torques[self.at])
        self.residual = self._free(self.target)
        #: Share of the variance of the residuals that the delay explains.
        self.gain = 0.0

    def _chosen(self, count: int, most: int) -> NDArray[np.intp]:
        """States at which delayed torques are those of the log. They lie in windows, in which the samples of different
        delays are the same; the torques are means around them."""
        self.step, self.longest, self.torques = 0.0, 0.0, self.arrays[3]
        if self.time is None or count < 2 or (step := float(np.median(np.diff(self.time)))) <= 0.0:
            return np.arange(count)[:: max(1, -(-count // most))]
        self.step, stride = step, max(1, round(SLOWEST / step))
        longest = min(LONGEST, OF_LOG * float(self.time[-1] - self.time[0]))
        inner = np.flatnonzero((self.time >= self.time[0] + longest) & (self.time <= self.time[-1] - longest))
        if len(inner) < 0.5 * count:
            inner = np.arange(count)
        else:
            self.longest = longest
        if stride > 1:
            wide = np.lib.stride_tricks.sliding_window_view(self.torques, 2 * stride + 1, axis=0).mean(axis=-1)
            self.torques = self.torques.copy()
            self.torques[stride : stride + len(wide)] = wide
        inner = inner[::stride]
        windows = np.array_split(inner, BLOCKS)
        return np.concatenate([one[: max(1, most // BLOCKS)] for one in windows]) if len(inner) > most else inner

    def _rows(self, at: NDArray[np.intp]) -> tuple[_Array, _Array]:
        """Independent columns over the scales, (motors, k, base), and known torques, (k, motors)."""
        q, qd, qdd, tau = (one[at] for one in self.arrays)
        rows, known = self.columns.rows(q, qd, qdd)
        found = np.zeros((self.columns.motors, len(at), self.columns.width))
        for motor, (block, of) in enumerate(zip(rows, self.columns.used, strict=True)):
            if self.known_at[motor]:
                found[motor][:, of] = (
                    np.where(np.isfinite(tau[:, motor]), 1.0, 0.0)[:, None] * block / self.scale[motor]
                )
        return found[:, :, self.used], known

    def _target(self, tau: _Array) -> _Array:
        """Torques minus the known ones over the scales, (motors k,); zero where a torque was not measured."""
        torque = tau - self.known
        return np.asarray((np.where(np.isfinite(torque) & self.known_at, torque, 0.0) / self.scale).T.ravel())

    def _free(self, values: _Array) -> _Array:
        """Values, (motors k,), projected on the complement of the columns."""
        return np.asarray(values - self.orthogonal @ (self.orthogonal.T @ values))

    def _solved(self, target: _Array) -> _Array:
        """Least-squares estimate of the base parameters."""
        return np.asarray(self.right[self.kept].T @ ((self.orthogonal.T @ target) / self.singular) / self.norms)

    def _of_blocks(self, free: _Array) -> tuple[float, float]:
        """Coefficient of a further column, projected on the complement of the columns, and its standard deviation by
        blocks of time."""
        size = float(free @ free)
        if size <= 1e-12:
            return 0.0, np.inf
        value = float(free @ self.residual) / size
        score = (free * (self.residual - value * free)).reshape(self.columns.motors, -1).sum(axis=0)
        sums = np.array([part.sum() for part in np.array_split(score, BLOCKS)])
        return value, float(np.sqrt(BLOCKS / (BLOCKS - 1) * np.sum(sums**2))) / size

    def _blocks_of(self, free: _Array) -> float:
        """Effective number of blocks of time in which a column is not zero."""
        sums = [part.sum() for part in np.array_split((free**2).reshape(self.columns.motors, -1).sum(axis=0), BLOCKS)]
        return float(np.sum(sums) ** 2 / max(np.sum(np.square(sums)), 1e-300))

    def _dry_friction(self) -> _Array:
        """Fitted dry friction of each motor, or that of the scene; zero if it is not known."""
        columns, solution = self.columns, self._solved(self.target)
        found = np.zeros(columns.motors) if columns.transmission is not None else columns.scene.friction.copy()
        for at, extra in enumerate(columns.extras, 10 * len(columns.free)):
            if extra.kind == "friction":
                found[list(extra.rows)] = solution[self.used == at].sum()
        return np.asarray(found)

    def of_friction(self, noise: _Array) -> tuple[float, list[str]]:
        """Residuals that a parameter of a motor explains that is not fitted.

        Return the largest share of the variance of all residuals that one kind of parameter explains, and texts.
        """
        columns = self.columns
        if columns.connected:
            return 0.0, []
        squares = np.sum(self.residual.reshape(columns.motors, -1) ** 2, axis=1)
        kinds = [kind for kind in ("friction", "stribeck", "damping", "armature") if kind not in columns.fit]
        q, qd, qdd, _ = (one[self.at] for one in self.arrays)
        all_columns = columns.of_motors(q, qd, qdd, kinds)
        quantile, dry = float(student_quantile(1.0 - UNLIKELY, BLOCKS - 1.0)), self._dry_friction()
        own = {"armature": columns.scene.armature, "damping": columns.scene.damping, "friction": columns.scene.friction}
        found, gains = [], dict.fromkeys(kinds, 0.0)
        for kind in kinds:
            for motor, name in enumerate(columns.motor_names):
                if not (self.known_at[motor] and squares[motor] > 0.0):
                    continue
                column = np.zeros((columns.motors, len(self.at)))
                if kind == "stribeck":
                    all_columns[kind][np.abs(columns.rates(qd)) < ABOVE * columns.slow] = 0.0
                column[motor] = all_columns[kind][:, motor] / self.scale[motor]
                free = self._free(column.ravel())
                if float(free @ free) < COLLINEAR * float(np.sum(column**2)) or self._blocks_of(free) < FEWEST_BLOCKS:
                    continue
                value, deviation = self._of_blocks(free)
                torque = abs(value) * float(np.linalg.norm(free))
                least = max(SMALL, SMALL_NOISE * noise[motor] / self.scale[motor])
                # The smooth sign of the columns is not exact: only excess friction at low speed is Stribeck friction.
                if kind == "stribeck":
                    value = value if value > EXCESS * dry[motor] else 0.0
                if (
                    abs(value) > quantile * deviation
                    and torque**2 > EXPLAINED * squares[motor]
                    and torque > least * np.sqrt(len(self.at))
                ):
                    total = value + (own[kind][motor] if kind in own and columns.transmission is None else 0.0)
                    found.append((torque**2 / squares[motor], kind, name, value, deviation, total))
                    gains[kind] += torque**2
        texts = []
        for name in dict.fromkeys(one[2] for one in sorted(found, reverse=True)):
            share, kind, _, value, deviation, total = max(one for one in found if one[2] == name)
            impossible = kind in own and columns.transmission is None and total < -3.0 * deviation
            fix = (
                f"check the sign of tau at {name!r}, because {kind} is not negative"
                if impossible
                else f"add {kind!r} to fit"
            )
            texts.append(
                f"fit: found residuals of {name!r} that {kind} of {value:.3g} +- {deviation:.2g} explains beyond that"
                f" of the scene, {100.0 * min(share, 1.0):.2g} % of their variance; expected none: {fix}"
            )
        return max(gains.values(), default=0.0) / max(float(squares.sum()), 1e-300), texts

    def clock(self) -> tuple[Clock, list[str]]:
        """Estimate the delay of the torques, which minimizes the residual; warn if it is significant."""
        unknown = Clock(float("nan"), float("nan"))
        if self.longest == 0.0 or len(self.arrays[0]) < 20 * LAGS:
            return unknown, []
        step, tau = self.step, self.torques

        def residual(delay: float) -> float:
            target = self._target(shifted(tau, self.time, delay)[self.at])  # type: ignore[arg-type]
            return float(target @ target - np.sum((self.orthogonal.T @ target) ** 2)) / max(len(target), 1)

        # Whole samples, because interpolation between them reduces noise. First all delays, then around the best.
        last = int(self.longest / step)
        coarse = max(1, -(-last // LAGS))
        lags = coarse * np.arange(-(last // coarse), last // coarse + 1)
        zero = residual(0.0)
        while True:
            values = np.array([residual(lag * step) for lag in lags])
            best = int(np.argmin(values))
            if best in (0, len(lags) - 1):
                return unknown, []
            if coarse == 1:
                break
            nearest, width, coarse = lags[best], coarse, max(1, coarse // LAGS)
            lags = np.arange(nearest - width - coarse, nearest + width + 2 * coarse, coarse)
        before, here, after = values[best - 1 : best + 2]
        self.gain = 1.0 - here / zero if zero > 0.0 else 0.0
        bend = before - 2.0 * here + after
        offset = float((lags[best] + (0.5 * (before - after) / bend if bend > 0.0 else 0.0)) * step)
        deviation = self._deviation(lags[best] * step)
        least = REDUCED if abs(offset) < NEAR else REDUCED_FAR
        if zero > (1.0 + least) * here and abs(offset) > max(0.5 * step, CERTAIN * deviation):
            text = (
                f"tau: found torques that {'lag' if offset > 0.0 else 'lead'} q by {abs(1e3 * offset):.3g} +-"
                f" {1e3 * deviation:.2g} ms: this delay reduces the variance of the residuals by"
                f" {100 * (1 - here / zero):.2g} %; expected one clock for q and tau: tau_delay={offset:.3g} corrects"
                " it"
            )
            return Clock(offset, deviation), [text]
        return Clock(offset, deviation), []

    def _deviation(self, delay: float) -> float:
        """Standard deviation of the delay, by blocks of time: that of the coefficient of the rate of the torques."""
        assert self.time is not None
        target = self._target(shifted(self.torques, self.time, delay)[self.at])
        solution = self._solved(target)
        ahead, behind = (np.clip(self.at + one, 0, len(self.time) - 1) for one in (1, -1))
        (rows, known), (rows_before, known_before) = self._rows(ahead), self._rows(behind)
        change = (rows - rows_before) @ solution + ((known - known_before) / self.scale).T
        own, self.residual = self.residual, self._free(target)
        rate = change / np.maximum(self.time[ahead] - self.time[behind], 1e-300)
        deviation = self._of_blocks(self._free(rate.ravel()))[1]
        self.residual = own
        return deviation


def beyond_bodies(weights: _Array, free: _Array, after: _Array) -> _Array:
    """Residual that bodies of positive mass leave beyond that of least squares, in standard deviations, (motors,)."""
    return np.asarray(np.nan_to_num(np.sqrt(np.maximum(after**2 - free**2, 0.0)) / np.fmax(weights, free)))


def warn_of_bodies(names: list[str], beyond: _Array, free: _Array, after: _Array) -> None:
    """Warn about torques that no bodies explain."""
    at = int(np.argmax(beyond))
    text = (
        f"tau: found torques of {names[at]!r} that no bodies of positive mass explain: residuals of {after[at]:.3g} N m"
        f" or N, {free[at]:.3g} by unconstrained least squares; expected about the same"
    )
    warn(
        f"{text}: check sign, joint order, unit and gravity of tau, the friction in fit, the bodies in keep, and the axes of the model",
        LogWarning,
    )
