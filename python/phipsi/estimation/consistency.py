"""Consistency of an estimator: whether its errors have the covariances that it states."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ArgumentError, ShapeError, of_argument
from ._chi_square import chi_square_quantile

__all__ = ["consistency_bounds", "nees", "nis"]


def nees(error: ArrayLike, covariance: ArrayLike) -> NDArray[np.float64]:
    """The normalized estimation error squared e* P^-1 e: chi-square with n degrees of freedom if the covariance P is right.

    Parameters
    ----------
    error : (..., n)
        Errors of the estimate in the tangent space of the estimate: truth = estimate (+) error. `scene.difference(estimate, truth)` gives that of q.
    covariance : (..., n, n)
        The covariance that the estimator states.

    Returns
    -------
    array (...)
        e* P^-1 e.

    Raises
    ------
    ShapeError
        Shapes that do not fit each other.
    ArgumentError
        A covariance that is singular or has a negative eigenvalue: in such directions P holds only what the prior held.

    Examples
    --------
    >>> import numpy as np
    >>> from phipsi.estimation import consistency_bounds, nees
    >>> rng = np.random.default_rng(1)
    >>> covariance = np.diag([1.0, 4.0])
    >>> errors = rng.normal(size=(1000, 2)) * [1.0, 2.0]
    >>> low, high = consistency_bounds(2, 1000)
    >>> bool(low < nees(errors, covariance).mean() < high)
    True
    """
    e, p = np.asarray(error, float), np.asarray(covariance, float)
    if e.ndim < 1 or p.ndim < 2 or p.shape[-2:] != (e.shape[-1], e.shape[-1]):
        raise of_argument(ShapeError, "covariance", f"found shapes {e.shape} of the error and {p.shape}; expected (..., n) and (..., n, n)")
    # Units differ: each component in its own standard deviations first.
    scale = np.sqrt(np.maximum(np.diagonal(p, axis1=-2, axis2=-1), 0.0))
    if not np.all(scale > 0.0):
        raise of_argument(ArgumentError, "covariance", "found a variance that is zero, negative or NaN; expected positive ones: leave out components that are known exactly")
    try:
        root = np.linalg.cholesky(p / (scale[..., :, None] * scale[..., None, :]))
    except np.linalg.LinAlgError:
        raise of_argument(ArgumentError, "covariance", "found a matrix that is not positive definite; expected one that is: leave out components that depend on others") from None
    white = np.linalg.solve(root, (e / scale)[..., None])[..., 0]
    return np.asarray(np.sum(white**2, axis=-1))


def nis(innovation: ArrayLike, covariance: ArrayLike) -> NDArray[np.float64]:
    """The normalized innovation squared e* S^-1 e: chi-square with m degrees of freedom, and independent from step to step, if the filter is right.

    Parameters
    ----------
    innovation : (..., m)
        Readings less predicted readings.
    covariance : (..., m, m)
        The covariance of the innovations that the filter states.

    Returns
    -------
    array (...)
        e* S^-1 e.

    Examples
    --------
    >>> from phipsi.estimation import nis
    >>> float(nis([1.0, 2.0], [[1.0, 0.0], [0.0, 4.0]]))
    2.0
    """
    return nees(innovation, covariance)


def consistency_bounds(size: int, count: int = 1, level: float = 0.95) -> tuple[float, float]:
    """The interval in which the mean of `count` independent NEES or NIS of `size` components is with probability `level` if the estimator is right.

    Parameters
    ----------
    size : int
        Number of components n of one error, or m of one innovation.
    count : int
        Number of independent values that the mean is of: runs for NEES (steps of one run are correlated), all steps of all runs for NIS.
    level : float
        Probability, between 0 and 1.

    Returns
    -------
    low, high : float
        Quantiles of chi-square with `count * size` degrees of freedom, over `count`. Their middle is about `size`.

    Examples
    --------
    >>> from phipsi.estimation import consistency_bounds
    >>> low, high = consistency_bounds(6, 100)
    >>> round(low, 2), round(high, 2)
    (5.34, 6.7)
    """
    for name, value in (("size", size), ("count", count)):
        if not (value == int(value) and value >= 1):
            raise of_argument(ArgumentError, name, f"found {value}; expected a whole number, at least 1")
    if not 0.0 < level < 1.0:
        raise of_argument(ArgumentError, "level", f"found {level}; expected a probability between 0 and 1")
    tail = 0.5 * (1.0 - level)
    return chi_square_quantile(tail, count * size) / count, chi_square_quantile(1.0 - tail, count * size) / count
