"""phipsi.smooth: the smoother is dense Gaussian estimation, the zero-phase filter of its bandwidth, and reports faults of logs by name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tolerances import SIGMAS, assert_near

import phipsi
from phipsi.errors import ArgumentError, LogWarning, ShapeError


def dense(time: np.ndarray, q: np.ndarray, sigma: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of (q, qd, qdd) at all times from the definition: start with a flat prior, increments of integrated white jerk, least squares in mpmath."""
    import mpmath

    mpmath.mp.dps = 40
    count = len(time)
    # All states as a linear function of the start (no prior) and of the jerk's increments, by the information matrix of the chain.
    information, target = mpmath.zeros(3 * count), mpmath.zeros(3 * count, 1)
    for k in range(count - 1):
        h = mpmath.mpf(float(time[k + 1])) - mpmath.mpf(float(time[k]))
        move = mpmath.matrix([[1, h, h**2 / 2], [0, 1, h], [0, 0, 1]])
        noise = mpmath.matrix([[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]]) * density
        rows = mpmath.zeros(3, 3 * count)
        for i in range(3):
            rows[i, 3 * (k + 1) + i] = 1
            for j in range(3):
                rows[i, 3 * k + j] = -move[i, j]
        information += rows.T * noise**-1 * rows
    for k in range(count):
        if np.isfinite(q[k]):
            information[3 * k, 3 * k] += 1 / mpmath.mpf(sigma) ** 2
            target[3 * k] += mpmath.mpf(float(q[k])) / mpmath.mpf(sigma) ** 2
    covariance = information**-1
    mean = covariance * target
    values = np.array([float(mean[i]) for i in range(3 * count)]).reshape(count, 3)
    return values, np.array([float(covariance[i, i]) for i in range(3 * count)]).reshape(count, 3)


@pytest.mark.parametrize("sigma", [1e-3, 1e-6, 1e-8])
def test_it_is_dense_estimation_at_any_spacing(sigma: float) -> None:
    """From the first to the last time: where the motion starts there is no prior, and no digits are lost to one."""
    draw, cutoff = np.random.default_rng(0), 8.0
    time = np.cumsum(draw.uniform(0.002, 0.05, 18))
    q = np.sin(5 * time) + sigma * draw.standard_normal(18)
    q[[4, 9, 10]] = np.nan
    found = phipsi.smooth(time, q, noise=sigma, cutoff=cutoff)
    seen = time[np.isfinite(q)]
    step = (seen[-1] - seen[0]) / (len(seen) - 1)
    mean, variance = dense(time, q, sigma, (2 * np.pi * cutoff) ** 6 * sigma**2 * step)
    for at, values in enumerate((found.q, found.qd, found.qdd)):
        scale = np.max(np.abs(mean[:, at]))
        assert_near(values[:, 0] / scale, mean[:, at] / scale, 1e-8)
        assert_near(found.variances[at, :, 0] / variance[:, at], np.ones(18), 1e-6)


def test_it_is_the_zero_phase_filter_in_the_middle() -> None:
    step, cutoff, sigma = 0.001, 20.0, 1e-3
    time = np.arange(0.0, 4.0, step)
    for hertz in (5.0, 20.0, 40.0):
        q = np.sin(2 * np.pi * hertz * time)
        found = phipsi.smooth(time, q, noise=sigma, cutoff=cutoff)
        middle = slice(1500, 2500)
        gain = 1.0 / (1.0 + (hertz / cutoff) ** 6)
        # The step is finite: the discrete smoother differs by (2 pi cutoff h)^2 / 12, at most.
        assert_near(found.q[middle, 0], gain * q[middle], 2e-3)
    # Variances: var h (wc/3, wc^3/6, wc^5/3), of which noise passes (5 wc/18, wc^3/12, wc^5/18).
    wc = 2 * np.pi * cutoff
    expected = sigma**2 * step * np.array([wc / 3, wc**3 / 6, wc**5 / 3])
    assert_near(found.variances[:, 2000, 0] / expected, np.ones(3), 0.01)
    assert_near(found.acceleration_noise / np.sqrt(sigma**2 * step * wc**5 / 18), np.ones(1), 1e-12)


@pytest.mark.parametrize("cutoff", [6.0, 25.0])
def test_noise_that_passes_is_as_predicted(cutoff: float) -> None:
    draw, sigma, step = np.random.default_rng(2), 1e-3, 0.005
    time = np.arange(0.0, 60.0, step)
    found = phipsi.smooth(time, sigma * draw.standard_normal((len(time), 2)), noise=sigma, cutoff=cutoff)
    inner = found.qdd[400:-400]
    independent = 2 * inner.shape[0] * step * cutoff * 2
    assert np.all(np.abs(np.std(inner) / found.acceleration_noise - 1.0) < SIGMAS / np.sqrt(2 * independent) + 0.02)


@pytest.mark.parametrize("seed", range(3))
def test_noise_and_bandwidth_are_estimated(seed: int) -> None:
    """A log drawn from the model: white jerk, white noise."""
    draw, step, sigma, cutoff = np.random.default_rng(seed), 0.005, 2e-4, 12.0
    density = (2 * np.pi * cutoff) ** 6 * sigma**2 * step
    root = np.linalg.cholesky(density * np.array([[step**5 / 20, step**4 / 8, step**3 / 6], [step**4 / 8, step**3 / 3, step**2 / 2], [step**3 / 6, step**2 / 2, step]]))
    move, x = np.array([[1, step, step**2 / 2], [0, 1, step], [0, 0, 1]]), np.zeros((2000, 3))
    for k in range(1, 2000):
        # Pulled back weakly, so that the log stays within some rad.
        x[k] = move @ x[k - 1] + root @ draw.standard_normal(3) - 0.02 * step * np.array([0.0, x[k - 1, 1], 100 * x[k - 1, 2]])
    found = phipsi.smooth(step * np.arange(2000), x[:, 0] + sigma * draw.standard_normal(2000))
    assert 0.93 < found.noise[0] / sigma < 1.07
    assert 0.9 < found.cutoff[0] / cutoff < 1.1
    off = (found.qd[50:-50, 0] - x[50:-50, 1]) / np.sqrt(found.variances[1, 50:-50, 0])
    assert 0.8 < np.std(off) < 1.2


def test_noise_is_estimated_at_a_given_bandwidth() -> None:
    """Far above the frequency of the motion, and not taken for what a narrower filter delays."""
    time = np.arange(0.0, 10.0, 0.01)
    q = 2.0 * np.sin(2 * np.pi * 0.5 * time) + 1e-5 * np.random.default_rng(0).standard_normal(1000)
    assert 0.9e-5 < phipsi.smooth(time, q, cutoff=6.0).noise[0] < 1.1e-5


def test_the_steps_of_an_encoder_are_its_noise() -> None:
    time, quantum = np.arange(0.0, 4.0, 0.002), 1e-3
    truth = np.sin(2 * time)
    found = phipsi.smooth(time, quantum * np.round(truth / quantum))
    assert found.noise[0] >= quantum / np.sqrt(12) * 0.999
    assert np.max(np.abs(found.q[:, 0] - truth)) < quantum
    assert np.max(np.abs(found.qd[100:-100, 0] - 2 * np.cos(2 * time[100:-100]))) < 0.05


def test_the_prior_does_not_pull() -> None:
    """Far from zero, and fast at the start."""
    time = np.arange(0.0, 1.0, 0.01)
    q = 1000.0 + 50.0 * time - 4.0 * time**2
    found = phipsi.smooth(time, q, noise=1e-3, cutoff=5.0)
    assert_near(found.q[:, 0], q, 1e-6)
    assert_near(found.qd[:, 0], 50.0 - 8.0 * time, 1e-5)
    assert_near(found.qdd[:, 0], np.full(100, -8.0), 1e-4)


@pytest.mark.parametrize("at", [0.0, 0.3, 1e-200])
@pytest.mark.parametrize("cutoff", [None, 5.0])
def test_a_joint_at_rest(at: float, cutoff: float | None) -> None:
    """Also one whose positions are all zero."""
    time = np.arange(0.0, 1.0, 0.01)
    found = phipsi.smooth(time, np.full(100, at), cutoff=cutoff)
    assert_near(found.q, np.full((100, 1), at), 1e-15)
    assert_near(found.qd, np.zeros((100, 1)), 1e-12)
    assert_near(found.qdd, np.zeros((100, 1)), 1e-12)
    assert np.all(found.noise > 0.0) and np.all(found.noise < 1e-15) and np.all(found.variances >= 0.0)


@pytest.mark.parametrize("at", [0.0, 0.3])
def test_the_noise_of_a_joint_at_rest_is_the_given_one(at: float) -> None:
    """At the ends too: the prior is wide compared with the noise."""
    time = np.cumsum(np.full(18, 0.01))
    found = phipsi.smooth(time, np.full(18, at), noise=1e-3, cutoff=8.0)
    _, variance = dense(time, np.full(18, at), 1e-3, (2 * np.pi * 8.0) ** 6 * 1e-6 * 0.01)
    for row in range(3):
        assert_near(found.variances[row, :, 0] / variance[:, row], np.ones(18), 1e-5)


def test_repeated_times_are_one_update_each() -> None:
    time = np.array([0.0, 0.1, 0.1, 0.2, 0.3, 0.4])
    q = np.array([0.0, 0.11, 0.09, 0.2, 0.3, 0.4])
    with pytest.warns(LogWarning, match="time: found 1 repeated times, the first 0.1 at row 2"):
        found = phipsi.smooth(time, q, noise=1e-2, cutoff=2.0)
    assert_near(found.q[1], found.q[2], 1e-12)
    assert_near(found.qdd[1], found.qdd[2], 1e-9)


def test_a_gap_is_reported_and_uncertain() -> None:
    time = np.concatenate([np.arange(0.0, 1.0, 0.01), np.arange(3.0, 4.0, 0.01)])
    q = np.sin(time)
    with pytest.warns(LogWarning, match="time: found 1 gaps, the longest of 2.01 s after 0.99 s"):
        found = phipsi.smooth(time, q, noise=1e-4, cutoff=3.0)
    assert found.variances[2, 99, 0] > 3 * found.variances[2, 50, 0]


def test_a_jump_by_a_revolution_is_reported() -> None:
    time = np.arange(0.0, 4.0, 0.01)
    q = np.angle(np.exp(1j * 2.0 * time))
    with pytest.warns(LogWarning, match="q: found a jump of 6.26 in column 0 at row 158, a revolution; np.unwrap"):
        phipsi.smooth(time, q, noise=1e-3, cutoff=3.0)


GOOD: dict[str, Any] = {"time": 0.1 * np.arange(20.0), "q": np.sin(np.arange(20.0)), "noise": 0.1, "cutoff": 1.0}


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"time": np.arange(19.0)}, ShapeError, r"time: found shape \(19,\); expected \(20,\)"),
        ({"time": -np.arange(20.0)}, ArgumentError, "time: found -1 after -?0 at row 1; expected times that rise: sort all arrays"),
        ({"time": np.full(20, np.nan)}, ArgumentError, "time: found nan at row 0"),
        ({"q": np.full(20, np.nan)}, ArgumentError, "q: found 0 measured positions in column 0; expected at least three"),
        ({"q": np.full(20, np.inf)}, ArgumentError, "q: found an infinity"),
        ({"q": np.zeros((20, 2, 2))}, ShapeError, r"q: found shape \(20, 2, 2\)"),
        ({"noise": 0.0}, ArgumentError, "noise: found 0.0; expected finite numbers above zero"),
        ({"noise": [1.0, 2.0]}, ShapeError, r"noise: found shape \(2,\)"),
        ({"cutoff": -1.0}, ArgumentError, "cutoff: found -1.0"),
    ],
)
def test_bad_arguments(change: dict[str, Any], kind: type[Exception], message: str) -> None:
    given = GOOD | change
    with pytest.raises(kind, match=message):
        phipsi.smooth(given["time"], given["q"], noise=given["noise"], cutoff=given["cutoff"])


def test_warnings_are_the_callers() -> None:
    time = np.arange(0.0, 4.0, 0.01)
    with pytest.warns(LogWarning) as caught:
        phipsi.smooth(np.append(time, 9.0), np.append(np.angle(np.exp(2j * time)), 0.0), noise=1e-3, cutoff=3.0)
    assert len(caught) == 2 and all(one.filename == __file__ for one in caught)
