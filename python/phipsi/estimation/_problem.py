"""Accumulated measurements as a problem of least squares, in coordinates relative to the prior."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..errors import ArgumentError, of_argument
from ._accumulator import Accumulator, Block, _halved, merged_triangles
from ._allowed import mobility
from ._bodies import prior_of_bodies
from ._columns import SIGNED
from ._values import each

__all__ = ["UNKNOWN", "Problem"]

_Array = NDArray[np.float64]

#: Relative singular value below which a combination of parameters counts as not determined by the motion.
UNKNOWN = 1e-8
#: Prior mode of armature, damping and friction that the model lacks, relative to the value that alone would explain the
#: torques; scale of offsets; and smallest motion for that value, relative to the joint that moves most. The prior has a
#: mean of three modes: a much smaller mode would pull a parameter that the motion hardly excites toward zero.
SHARE, OFFSET, SLOWEST = 0.1, 0.05, 0.01
#: Lower bound of the noise relative to the torques. It is a multiple of the rounding error of the regressor, which a
#: smaller noise would treat as information.
ROUNDING = 2.0**-36


class Rows(NamedTuple):
    """Least-squares problem of some rows: information left^T right, score left^T (y - right x).

    Without instruments, left equals right.
    """

    left: _Array
    right: _Array
    target: _Array


class Problem:
    """Accumulated measurements, in coordinates z relative to the prior."""

    def __init__(self, accumulator: Accumulator) -> None:
        columns = accumulator.columns
        self.accumulator, self.columns = accumulator, columns
        self.blocks: list[Block] = _for_jackknife(accumulator)
        if not self.blocks:
            raise of_argument(ArgumentError, "q", "found no states; expected some (Accumulator.add)")
        self.counts = np.sum([block.counts for block in self.blocks], axis=0)
        if not self.counts.any():
            raise of_argument(ArgumentError, "tau", "found no measured torque: all are NaN; expected finite torques")
        self.whole = [
            merged_triangles([block.triangles[motor] for block in self.blocks]) for motor in range(columns.motors)
        ]
        matrices, self.model = prior_of_bodies(columns.scene, columns.free)
        self.bodies = len(columns.free)
        scales, places, model, lacking = [], [], [], []
        moved = [self._moved(at) for at in range(len(columns.extras))]
        largest = {
            kind: max(size for size, extra in zip(moved, columns.extras, strict=True) if extra.kind == kind)
            for kind in {extra.kind for extra in columns.extras}
        }
        for at, extra in enumerate(columns.extras):
            # The parameters of a motor at rest cannot be identified.
            if moved[at] == 0.0:
                continue
            rows = list(extra.rows)
            torque = float(np.sqrt(np.sum(accumulator._squares[rows]) / max(np.sum(self.counts[rows]), 1.0)))
            alone = torque / max(moved[at], SLOWEST * largest[extra.kind])
            scale = OFFSET * torque if extra.kind in SIGNED else extra.model or SHARE * alone
            if scale == 0.0:
                continue
            signs = (1.0, -1.0) if extra.kind in SIGNED else (1.0,)
            scales += [sign * scale for sign in signs]
            places += [10 * self.bodies + at] * len(signs)
            model += [extra.model / scale] if len(signs) == 1 else [1.0, 1.0]
            lacking += [extra.model == 0.0 or len(signs) == 2] * len(signs)
        #: True for variables after the bodies whose prior is not the model's.
        self.lacking = np.array(lacking, dtype=bool)
        self.to_own = np.zeros((columns.width, 10 * self.bodies + len(scales)))
        for at, matrix in enumerate(matrices):
            self.to_own[10 * at : 10 * at + 10, 10 * at : 10 * at + 10] = matrix
        for z, (place, scale) in enumerate(zip(places, scales, strict=True), 10 * self.bodies):
            self.to_own[place, z] = scale
        self.fitted = sorted(set(places))
        self.model = np.append(self.model, model)
        if not self.to_own.shape[1]:
            raise of_argument(
                ArgumentError,
                "keep",
                "found all bodies, and no joint parameter that the motion determines; expected at least one parameter"
                " to identify",
            )
        self.projections = (
            [self._projection(motor) for motor in range(columns.motors)] if accumulator.instruments else None
        )

    def _moved(self, extra: int) -> float:
        """Root mean square of the column of a motor parameter."""
        rows, column = self.columns.extras[extra].rows, 10 * self.bodies + extra
        count = max(float(np.sum(self.counts[list(rows)])), 1.0)
        return float(np.sqrt(sum(self._column_norm(motor, column) ** 2 for motor in rows) / count))

    def _column_norm(self, motor: int, column: int) -> float:
        used = self.columns.used[motor]
        (at,) = np.nonzero(used == column)
        first = len(used) if self.accumulator.instruments else 0
        return float(np.linalg.norm(self.whole[motor][:, first + at[0]])) if len(at) else 0.0

    def _plain(self, triangle: _Array, motor: int) -> _Array:
        """[W y] of a triangle, without instruments."""
        return triangle[:, len(self.columns.used[motor]) :] if self.accumulator.instruments else triangle

    def _projection(self, motor: int) -> _Array:
        """Least-squares coefficients of the columns in terms of the instruments."""
        size = len(self.columns.used[motor])
        triangle = self.whole[motor]
        instruments, columns = triangle[:, :size], triangle[:, size : 2 * size]
        norms = np.linalg.norm(instruments, axis=0)
        norms[norms == 0.0] = 1.0
        return np.asarray(np.linalg.lstsq(instruments / norms, columns, rcond=UNKNOWN)[0] / norms[:, None])

    def rows(self, triangles: list[_Array], weights: _Array, only: int | None = None) -> Rows:
        """All rows, or those of one motor, divided by their standard deviations, in physical parameters."""
        lefts: list[_Array] = []
        rights: list[_Array] = []
        targets: list[_Array] = []
        for motor, (triangle, weight, used) in enumerate(zip(triangles, weights, self.columns.used, strict=True)):
            if not (self.counts[motor] and len(triangle)) or only not in (None, motor):
                continue
            plain = self._plain(triangle, motor) / weight
            left = (
                plain[:, :-1]
                if self.projections is None
                else triangle[:, : len(used)] @ self.projections[motor] / weight
            )
            for to, part in ((lefts, left), (rights, plain[:, :-1])):
                whole = np.zeros((len(plain), self.columns.width))
                whole[:, used] = part
                to.append(whole)
            targets.append(plain[:, -1])
        if not targets:
            empty = np.zeros((0, self.columns.width))
            return Rows(empty, empty, np.zeros(0))
        return Rows(np.concatenate(lefts), np.concatenate(rights), np.concatenate(targets))

    def least_squares(self, weights: _Array) -> tuple[_Array, _Array]:
        """Matrix A and vector b of min |b - A x|^2 in physical parameters; with instruments, two-stage least
        squares."""
        rows = self.rows(self.whole, weights)
        if self.projections is None:
            return rows.right, rows.target
        # left^T (y - right x) = 0, and left^T right = left^T left: b is the component of y in the span of the projected
        # columns.
        orthogonal, singular, right = np.linalg.svd(rows.left, full_matrices=False)
        keep = singular > UNKNOWN * singular.max(initial=0.0)
        return (singular[:, None] * right)[keep], orthogonal.T[keep] @ rows.target

    def residual(self, own: _Array) -> _Array:
        """Root mean square residual of each motor, (motors,); NaN for motors without measured torques."""
        norms = [
            np.linalg.norm(self._plain(triangle, motor) @ np.append(own[used], -1.0))
            for motor, (triangle, used) in enumerate(zip(self.whole, self.columns.used, strict=True))
        ]
        return self._mean(norms)

    def _mean(self, norms: list[Any]) -> _Array:
        return np.asarray(np.where(self.counts > 0, np.array(norms) / np.sqrt(np.maximum(self.counts, 1)), np.nan))

    def least(self) -> _Array:
        """Lower bound of the noise, (motors,): rounding error of the torques and of their terms."""
        own = self.to_own @ self.model
        norms = [
            np.linalg.norm(self._plain(triangle, motor) * np.append(own[used], 1.0))
            for motor, (triangle, used) in enumerate(zip(self.whole, self.columns.used, strict=True))
        ]
        found = ROUNDING * self._mean(norms)
        # A torque that does not depend on any parameter has the largest of the bounds.
        return np.where(found == 0.0, max(float(np.nanmax(found)), float(np.finfo(float).tiny)), found)

    def checked_noise(self, noise: ArrayLike) -> _Array:
        """Standard deviations given by the user, (motors,)."""
        found, motors = np.asarray(_core._numbers("noise", noise)), self.columns.motors
        refused = "found {least}; expected finite standard deviations above zero"
        found = each("noise", found, motors, refused, positive=True)
        if self.columns.connected and np.any(found != found[0]):
            message = f"found different ones in a scene with connections, which determine sums of the torques: {found}"
            raise of_argument(ArgumentError, "noise", f"{message}; expected one number")
        least = self.least()
        if np.any(below := found < least):
            at = int(np.argmax(below))
            message = (
                f"found {found[at]:g} at index {at}; expected at least {least[at]:.1e}, the rounding error of the"
                " torques"
            )
            raise of_argument(ArgumentError, "noise", message)
        return found

    def deviation(self) -> _Array:
        """Standard deviation of the torques, (motors,), from the residuals of unconstrained least squares.

        NaN for motors without measured torques.
        """
        least, measured = self.least(), int(np.sum(self.counts))
        if self.columns.connected:
            # Of the rows of a state, as many are independent as there are motions.
            measured = round(measured * mobility(self.columns.scene) / self.columns.motors)
        if np.nanmax(least) <= np.finfo(float).tiny:
            message = (
                "found states at which no torque depends on any parameter, and torques of zero; expected states that"
                " move, or noise, the standard deviation of the torques"
            )
            raise of_argument(ArgumentError, "q", message)
        weights = np.where(self.counts > 0, 1.0, np.nan)
        for _ in range(2):
            rows, target = self.least_squares(weights)
            z, _, rank, _ = np.linalg.lstsq(rows @ self.to_own, target, rcond=UNKNOWN)
            if measured < 2 * rank:
                found = f"{measured} measured torques for {rank} combinations of parameters"
                raise of_argument(
                    ArgumentError,
                    "tau",
                    f"found {found}; expected at least {2 * rank}, or noise, their standard deviation",
                )
            residual = self.residual(self.to_own @ z)
            if self.columns.connected:
                residual = np.full_like(residual, np.sqrt(np.sum(self.counts * residual**2) / measured))
            weights = np.maximum(np.sqrt(measured / (measured - rank)) * residual, least)
        return weights


def _for_jackknife(accumulator: Accumulator) -> list[Block]:
    """Blocks of the accumulator, merged to about the requested number."""
    found = accumulator.blocks()
    while 2 * len(found) >= 3 * accumulator.wanted:
        found = _halved(found)
    return found
