"""Base parameters: the combinations of parameters that torques depend on.

Columns of W depend on each other: W = W_b [1 K], up to the order of columns, with the largest set of independent columns W_b. Torques are W_b x_b with
x_b = x_i + K x_d, the base parameters. The set follows from the structure of the robot; it is found at random states, where dependence holds to rounding.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ._columns import Columns
from ._student import student_quantile

__all__ = ["BaseParameters", "Combinations", "combinations"]

_Array = NDArray[np.float64]

#: A column depends on those before where this share of it, at most, is independent of them. Rounding leaves 1e-13; right angles that a file has as 1.5708 leave 4e-6, which
#: no log can determine; independent columns of robots have 1e-2 and more.
DEPENDENT = 2e-5
#: Coefficients below this are those of rounding.
COEFFICIENT = 1e-9


class Combinations(NamedTuple):
    """Which columns are independent, and how the base parameters depend on all parameters."""

    columns: NDArray[np.intp]
    """Those that are independent, (base,)."""
    matrix: _Array
    """Base parameters = matrix @ parameters, (base, width)."""


class BaseParameters(NamedTuple):
    """The combinations of parameters that torques depend on, by least squares without a prior."""

    names: tuple[str, ...]
    """The parameter that each combination is named after: its coefficient is 1, and it is in no other one."""
    matrix: _Array
    """The combinations, (base, parameters): base = matrix @ parameters, with the parameters in the order of `parameter_names`."""
    parameter_names: tuple[str, ...]
    """Names of the parameters: those of bodies that were not kept, then those of motors."""
    values: _Array
    """The estimates, (base,); those that the log does not determine are of the least norm."""
    model: _Array
    """Those of the scene, (base,)."""
    covariance: _Array
    """By the delete-one-block jackknife, (base, base); infinite on the diagonal where the log does not determine one."""
    degrees: float
    """Degrees of freedom of Student's distribution for the intervals: blocks - 1."""
    bias: _Array
    """Predicted bias by noise in the accelerations, (base,); NaN where no acceleration_noise was given."""

    @property
    def deviations(self) -> _Array:
        """Standard deviations, (base,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def interval(self, level: float = 0.95) -> tuple[_Array, _Array]:
        """Lower and upper ends of the interval of each base parameter at a level, (base,) each."""
        half = student_quantile(level, self.degrees) * self.deviations
        return self.values - half, self.values + half

    def combination(self, index: int) -> str:
        """A base parameter, written out as a combination of parameters."""
        terms = [
            f"{coefficient:+.4g} {name}" if abs(coefficient - 1.0) > COEFFICIENT else f"+ {name}"
            for coefficient, name in zip(self.matrix[index], self.parameter_names, strict=True)
            if abs(coefficient) > COEFFICIENT
        ]
        return " ".join(terms).removeprefix("+ ")


def combinations(columns: Columns) -> Combinations:
    """The independent columns, and what depends on them."""
    scene, width = columns.scene, columns.width
    draw = np.random.default_rng(1)
    count = max(50, 3 * width // max(columns.motors, 1))
    q = scene.integrate(np.broadcast_to(scene.neutral(), (count, scene.nq)), draw.uniform(-2, 2, (count, scene.nv)))
    rows, _ = columns.rows(q, *draw.standard_normal((2, count, scene.nv)))
    matrix = np.zeros((columns.motors * count, width))
    for at, (block, used) in enumerate(zip(rows, columns.used, strict=True)):
        matrix[at * count : (at + 1) * count, used] = block
    norms = np.linalg.norm(matrix, axis=0)
    matrix = matrix / np.where(norms > 0.0, norms, 1.0)
    basis = np.zeros((width, len(matrix)))
    found: list[int] = []
    # From the tip to the base, so that parameters are regrouped into those of bodies further inward; twice, for orthogonality to rounding.
    for at in _order(columns):
        column = matrix[:, at]
        if norms[at] == 0.0:
            continue
        for _ in range(2):
            column = column - basis[: len(found)].T @ (basis[: len(found)] @ column)
        size = float(np.linalg.norm(column))
        if size > DEPENDENT:
            basis[len(found)] = column / size
            found.append(at)
    independent = np.array(sorted(found), dtype=np.intp)
    coefficients = np.linalg.lstsq(matrix[:, independent], matrix, rcond=None)[0]
    coefficients = coefficients * norms / norms[independent][:, None]
    coefficients[np.abs(coefficients) < COEFFICIENT * np.abs(coefficients).max(initial=1.0)] = 0.0
    coefficients[:, independent] = np.eye(len(independent))
    return Combinations(independent, coefficients)


def _order(columns: Columns) -> list[int]:
    """Motors first, whose parameters are of interest as such; then bodies, moments before the mass."""
    bodies = len(columns.free)
    entries = (1, 2, 3, 5, 7, 8, 4, 6, 9, 0)
    return [10 * bodies + at for at in range(len(columns.extras))] + [10 * at + entry for at in range(bodies) for entry in entries]
