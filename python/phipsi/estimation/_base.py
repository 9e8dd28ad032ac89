"""Base parameters: the combinations of parameters that torques depend on.

The columns of W are linearly dependent: W = W_b [1 K], up to the order of columns, with a maximal set of independent
columns W_b. Torques are W_b x_b with the base parameters x_b = x_i + K x_d. The set depends on the structure of the
robot only. It is determined at random states, at which the dependence holds within rounding.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._summary import summarized
from ._columns import Columns
from ._student import student_quantile

__all__ = ["BaseParameters", "Combinations", "combinations"]

_Array = NDArray[np.float64]

#: A column counts as dependent on the preceding ones if its relative residual is below this value. Rounding causes
#: 1e-13. Right angles written as 1.5708 in a file cause 4e-6, which no log can determine. Independent columns of robots
#: have 1e-2 or more.
DEPENDENT = 2e-5
#: Coefficients below this value are rounding errors.
COEFFICIENT = 1e-9


class Combinations(NamedTuple):
    """Independent columns, and base parameters as combinations of all parameters."""

    columns: NDArray[np.intp]
    """Indices of the independent columns, (base,)."""
    matrix: _Array
    """Base parameters = matrix @ parameters, (base, width)."""


@summarized
class BaseParameters(NamedTuple):
    """Combinations of parameters that torques depend on, estimated by least squares without a prior."""

    names: tuple[str, ...]
    """Name of each combination: the parameter with the coefficient 1, which no other combination contains."""
    matrix: _Array
    """Coefficients, (base, parameters): base = matrix @ parameters, with parameters in the order of
    `parameter_names`."""
    parameter_names: tuple[str, ...]
    """Names of the parameters: first of the bodies that were not kept, then of the motors."""
    values: _Array
    """Estimates, (base,). The estimates that the log does not determine have minimum norm."""
    model: _Array
    """Values of the scene, (base,)."""
    covariance: _Array
    """Covariance by the delete-one-block jackknife, (base, base); infinite variances for undetermined estimates."""
    degrees: float
    """Degrees of freedom of Student's distribution for the intervals: blocks - 1."""
    bias: _Array
    """Predicted bias caused by acceleration noise, (base,); NaN without acceleration_noise."""

    @property
    def deviations(self) -> _Array:
        """Standard deviations, (base,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def interval(self, level: float = 0.95) -> tuple[_Array, _Array]:
        """Confidence intervals of the base parameters.

        Parameters
        ----------
        level : float, default 0.95
            Probability that the interval contains the parameter.

        Returns
        -------
        lower, upper : (base,) ndarray
            Ends of the intervals.

        Raises
        ------
        ArgumentError
            A level that is not between 0 and 1.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> base = scene.identify(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd), noise=0.01).base
        >>> lower, upper = base.interval()
        >>> bool((lower < upper).all())
        True
        """
        half = student_quantile(level, self.degrees) * self.deviations
        return self.values - half, self.values + half

    def combination(self, index: int) -> str:
        """Format a base parameter as a combination of parameters.

        Parameters
        ----------
        index : int
            Index of the base parameter.

        Returns
        -------
        combination : str
            Sum of parameters with their coefficients.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> base = scene.identify(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd), noise=0.01).base
        >>> base.names[0] in base.combination(0)
        True
        """
        terms = [
            f"{coefficient:+.4g} {name}" if abs(coefficient - 1.0) > COEFFICIENT else f"+ {name}"
            for coefficient, name in zip(self.matrix[index], self.parameter_names, strict=True)
            if abs(coefficient) > COEFFICIENT
        ]
        return " ".join(terms).removeprefix("+ ")


def combinations(columns: Columns) -> Combinations:
    """Determine the independent columns, and the other columns as combinations of them."""
    width = columns.width
    # Connections determine fewer rows per state.
    wanted = (9 if columns.connected else 3) * width // max(columns.motors, 1)
    states = columns.states(max(50, wanted), 2.0, np.random.default_rng(1))
    rows, _ = columns.rows(*states)
    count = len(states[0])
    matrix = np.zeros((columns.motors * count, width))
    for at, (block, used) in enumerate(zip(rows, columns.used, strict=True)):
        matrix[at * count : (at + 1) * count, used] = block
    norms = np.linalg.norm(matrix, axis=0)
    matrix = matrix / np.where(norms > 0.0, norms, 1.0)
    basis = np.zeros((width, len(matrix)))
    found: list[int] = []
    # From the tip to the base, so that parameters are regrouped into parameters of bodies closer to the base. Two
    # passes of Gram-Schmidt ensure orthogonality within rounding.
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
    """Order of the columns: motors first, so that their parameters stay independent; then bodies, moments before
    mass."""
    bodies = len(columns.free)
    entries = (1, 2, 3, 5, 7, 8, 4, 6, 9, 0)
    return [10 * bodies + at for at in range(len(columns.extras))] + [
        10 * at + entry for at in range(bodies) for entry in entries
    ]
