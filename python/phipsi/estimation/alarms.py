"""Mean time between false alarms of a correlated test, and the threshold for a specified rate."""

from __future__ import annotations

import math

import numpy as np

from .._arguments import whole
from ..errors import ArgumentError, of_argument
from ._chi_square import chi_square_cdf
from ._values import positive

__all__ = ["alarm_threshold", "mean_time_to_alarm"]

#: Correction of a threshold for sampling, -zeta(1/2) / sqrt(2 pi), in standard deviations of the change between two
#: samples (Siegmund).
SAMPLING = 0.5826
#: Quadrature points per standard deviation.
POINTS = 40
#: Largest threshold, standard deviations, and largest number of components: the mean time to an alarm does not overflow.
LARGEST, LARGEST_SIZE = 32.0, 10**6


def mean_time_to_alarm(threshold: float, rate: float, size: int) -> float:
    """Mean first-exit time of an Ornstein-Uhlenbeck process from a ball, with start at the center.

    The process has d = `size` independent components of unit variance. With the threshold c and the rate K,
    T = (1/K) int_0^c e^(x^2/2) x^(1-d) int_0^x z^(d-1) e^(-z^2/2) dz dx.

    Parameters
    ----------
    threshold : float
        Radius c in standard deviations.
    rate : float
        Rate K, 1/s: the autocorrelation of the process is e^(-K t).
    size : int
        Number of components d.

    Returns
    -------
    float
        Mean time, s.

    Raises
    ------
    ArgumentError
        A rate that is not positive, a size below 1, or a threshold above 32.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi.estimation import mean_time_to_alarm
    >>> 3000 < mean_time_to_alarm(6.19, 10.0, 6) < 4000
    True
    """
    rate, size = positive("rate", rate), whole("size", size, 1, most=LARGEST_SIZE)
    if not threshold <= LARGEST:
        raise of_argument(ArgumentError, "threshold", f"found {threshold}; expected at most {LARGEST:g} standard deviations")
    if threshold <= 0.0:
        return 0.0
    panels = max(1, math.ceil(threshold))
    nodes, weights = np.polynomial.legendre.leggauss(POINTS)
    width = threshold / panels
    x = (width * (np.arange(panels)[:, None] + 0.5 * (nodes + 1.0))).ravel()
    # The inner integral is 2^(d/2-1) Gamma(d/2) times the distribution function of chi-square at x^2.
    inner = np.exp(
        0.5 * x**2 + (1.0 - size) * np.log(x) + (0.5 * size - 1.0) * math.log(2.0) + math.lgamma(0.5 * size)
    ) * chi_square_cdf(x**2, size)
    return float(np.sum(0.5 * width * np.tile(weights, panels) * inner) / rate)


def alarm_threshold(false_alarms_per_hour: float, rate: float, dt: float, size: int) -> float:
    """Threshold, in standard deviations, for a given rate of false alarms of a sampled process.

    The process has unit covariance; see mean_time_to_alarm.

    Parameters
    ----------
    false_alarms_per_hour : float
        Number of alarms per hour; the process restarts from zero after each alarm.
    rate : float
        Rate K, 1/s: the correlation between two successive samples is e^(-K dt).
    dt : float
        Time between two samples, s.
    size : int
        Number of components.

    Returns
    -------
    float
        Threshold. It is lower than the threshold in continuous time by 0.5826 sqrt(2 K dt), because an excursion
        between two samples is not detected.

    Raises
    ------
    ArgumentError
        A number that is not positive, or a rate of alarms that no threshold up to 32 gives.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi.estimation import alarm_threshold
    >>> round(alarm_threshold(1.0, 10.0, 1e-3, 6), 2)
    6.11
    """
    wanted = 3600.0 / positive("false_alarms_per_hour", false_alarms_per_hour)
    rate, dt = positive("rate", rate), positive("dt", dt)
    low, high = 0.0, 1.0
    while mean_time_to_alarm(high, rate, size) < wanted:
        high *= 2.0
        if high > LARGEST:
            raise of_argument(
                ArgumentError,
                "false_alarms_per_hour",
                f"found {false_alarms_per_hour:g}, which requires a threshold above 32 standard deviations; expected"
                " more",
            )
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if mean_time_to_alarm(middle, rate, size) < wanted else (low, middle)
    threshold = high - SAMPLING * math.sqrt(2.0 * rate * dt)
    if not threshold > 0.5:
        found = (
            f"found {false_alarms_per_hour:g}: one alarm per {wanted:g} s, close to the time constant of the observer,"
            f" {1.0 / rate:g} s"
        )
        raise of_argument(ArgumentError, "false_alarms_per_hour", f"{found}; expected fewer")
    return threshold
