"""Consistency tests of an estimator: comparison of its errors with its covariances."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arguments import check_result, numbers, whole
from ..errors import ArgumentError, ShapeError, of_argument
from ._chi_square import chi_square_quantile

__all__ = ["consistency_bounds", "nees", "nis"]

#: Largest number of degrees of freedom, for which a quantile takes about a second.
MOST = 10**8


def nees(error: ArrayLike, covariance: ArrayLike) -> NDArray[np.float64]:
    """Normalized estimation error squared, e* P^-1 e.

    It has a chi-square distribution with n degrees of freedom if the covariance P is correct.

    Parameters
    ----------
    error : (..., n)
        Errors in the tangent space of the estimate: truth = estimate (+) error. For q: `scene.difference(estimate,
        truth)`.
    covariance : (..., n, n)
        Covariance reported by the estimator.

    Returns
    -------
    array (...)
        e* P^-1 e; NaN for an error with NaN.

    Raises
    ------
    ShapeError
        Inconsistent shapes.
    NotFiniteError
        A result that overflows.
    ArgumentError
        A covariance that is not positive definite.

    Examples
    --------
    >>> import phipsi
    >>> import numpy as np
    >>> from phipsi.estimation import consistency_bounds, nees
    >>> rng = np.random.default_rng(1)
    >>> covariance = np.diag([1.0, 4.0])
    >>> errors = rng.normal(size=(1000, 2)) * [1.0, 2.0]
    >>> low, high = consistency_bounds(2, 1000)
    >>> bool(low < nees(errors, covariance).mean() < high)
    True
    """
    e, p = numbers("error", error), numbers("covariance", covariance)
    if e.ndim < 1 or p.ndim < 2 or p.shape[-2:] != (e.shape[-1], e.shape[-1]):
        raise of_argument(
            ShapeError,
            "covariance",
            f"found shapes {e.shape} of the error and {p.shape}; expected (..., n) and (..., n, n)",
        )
    # Components have different units: normalize each by its standard deviation.
    scale = np.sqrt(np.maximum(np.diagonal(p, axis1=-2, axis2=-1), 0.0))
    if not np.all((scale > 0.0) & np.isfinite(scale)):
        raise of_argument(
            ArgumentError,
            "covariance",
            "found a variance that is zero, negative or not finite; expected positive ones: omit components that are"
            " known exactly",
        )
    try:
        root = np.linalg.cholesky(p / (scale[..., :, None] * scale[..., None, :]))
    except np.linalg.LinAlgError:
        raise of_argument(
            ArgumentError,
            "covariance",
            "found a matrix that is not positive definite; expected a positive definite one: omit components that"
            " depend on others",
        ) from None
    with np.errstate(over="ignore", invalid="ignore"):
        white = np.linalg.solve(root, (e / scale)[..., None])[..., 0]
        squares = np.asarray(np.sum(white**2, axis=-1))
    check_result("normalized error squared", np.where(np.isnan(e).any(axis=-1), 0.0, squares))
    return squares


def nis(innovation: ArrayLike, covariance: ArrayLike) -> NDArray[np.float64]:
    """Normalized innovation squared, e* S^-1 e.

    If the filter is correct, it has a chi-square distribution with m degrees of freedom, independent between steps.

    Parameters
    ----------
    innovation : (..., m)
        Readings minus predicted readings.
    covariance : (..., m, m)
        Covariance of the innovations reported by the filter.

    Returns
    -------
    array (...)
        e* S^-1 e.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi.estimation import nis
    >>> float(nis([1.0, 2.0], [[1.0, 0.0], [0.0, 4.0]]))
    2.0
    """
    return nees(innovation, covariance)


def consistency_bounds(size: int, count: int = 1, level: float = 0.95) -> tuple[float, float]:
    """Acceptance interval of the mean of `count` independent NEES or NIS values of `size` components.

    The mean is in the interval with probability `level` if the estimator is correct.

    Parameters
    ----------
    size : int
        Number of components n of one error, or m of one innovation.
    count : int
        Number of independent values in the mean: runs for NEES (the steps of a run are correlated), all steps of all
        runs for NIS.
    level : float
        Probability, between 0 and 1.

    Returns
    -------
    low, high : float
        Quantiles of chi-square with `count * size` degrees of freedom, divided by `count`. Their mean is about `size`.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi.estimation import consistency_bounds
    >>> low, high = consistency_bounds(6, 100)
    >>> round(low, 2), round(high, 2)
    (5.34, 6.7)
    """
    size, count = whole("size", size, 1), whole("count", count, 1)
    if count * size > MOST:
        found = f"found {count} values of {size} components"
        raise of_argument(ArgumentError, "count", f"{found}; expected at most {MOST:g} degrees of freedom in all")
    if not 0.0 < level < 1.0:
        raise of_argument(ArgumentError, "level", f"found {level}; expected a probability between 0 and 1")
    tail = 0.5 * (1.0 - level)
    return chi_square_quantile(tail, count * size) / count, chi_square_quantile(1.0 - tail, count * size) / count
