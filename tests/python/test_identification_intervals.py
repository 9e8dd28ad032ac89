"""Intervals of identification: they hold for residuals of stated spectra, and the jackknife is that of refits. benches/estimation.py has the long runs."""

from __future__ import annotations

import numpy as np
import pytest
from logs import NOISES, STEP, arm_of_three, first_order, fourier, residuals
from test_identify import arm, like, states
from tolerances import assert_near, size

import phipsi
from phipsi.errors import ArgumentError, IdentificationWarning
from phipsi.estimation import Accumulator
from phipsi.estimation._student import student_quantile

FIT = ("armature", "damping", "friction")
LOGS = 40


@pytest.fixture(scope="module")
def log() -> tuple[phipsi.Scene, tuple[np.ndarray, ...], np.ndarray]:
    """An arm, a motion of 10 s, and its torques without noise."""
    scene = arm_of_three()
    q, qd, qdd = fourier(STEP * np.arange(2000))
    tau = scene.inverse_dynamics(q, qd, qdd) + scene.damping * qd + scene.friction * qd / np.sqrt(qd**2 + 0.01**2)
    return scene, (q, qd, qdd), tau


@pytest.mark.parametrize("kind", NOISES)
def test_intervals_hold_whatever_the_spectrum(kind: str, log: tuple[phipsi.Scene, tuple[np.ndarray, ...], np.ndarray]) -> None:
    """Of base parameters, over logs: and those that assume independent residuals do not hold where residuals are correlated."""
    scene, motion, tau = log
    draw = np.random.default_rng(NOISES.index(kind))
    held, white = [], []
    for _ in range(LOGS):
        found = scene.identify(*motion, tau + 0.3 * residuals(kind, 2000, 3, draw), fit=FIT, noise=0.3)
        truth = found.base.model
        low, high = found.base.interval(0.95)
        held.append((low <= truth) & (truth <= high))
        alone = Accumulator(scene, fit=FIT, block_length=2000).add(*motion, tau).identify(noise=0.3)
        assert alone.blocks == 1
        white.append(np.abs(found.base.values - truth) <= 1.96 * alone.base.deviations)
    # The parameters of a log are correlated: the spread over logs counts.
    shares = np.mean(held, axis=1)
    assert abs(np.mean(shares) - 0.95) < 4.0 * max(np.std(shares), 0.03) / np.sqrt(LOGS)
    if kind != "white":
        assert np.mean(white) < 0.7


def test_intervals_of_single_parameters_hold_where_the_data_decide(log: tuple[phipsi.Scene, tuple[np.ndarray, ...], np.ndarray]) -> None:
    """Of the last body, the others being known; with a prior that is off by some tenths."""
    scene, motion, _ = log
    built, draw, held = like(scene, 4), np.random.default_rng(8), []
    others = scene.with_inertias({"link3": _inertial(built, "link3")})
    truth = others.inertial_parameters[2]
    tau = others.inverse_dynamics(*motion) + scene.damping * motion[1] + scene.friction * motion[1] / np.sqrt(motion[1] ** 2 + 0.01**2)
    for _ in range(LOGS):
        found = scene.identify(*motion, tau + 0.05 * residuals("AR(1) 0.25 s", 2000, 3, draw), keep=["link1", "link2"], noise=0.05)
        low, high = found.interval(0.95)
        decided = found.share[2] > 0.9
        held.append(np.mean(((low[2] <= truth) & (truth <= high[2]))[decided]))
        assert decided.sum() >= 6
    assert abs(np.mean(held) - 0.95) < 4.0 * max(np.std(held), 0.05) / np.sqrt(LOGS)


def _inertial(scene: phipsi.Scene, name: str) -> tuple[float, np.ndarray, np.ndarray]:
    link = scene.links[name]
    return link.mass, link.com, link.inertia


def test_the_jackknife_is_that_of_refits(log: tuple[phipsi.Scene, tuple[np.ndarray, ...], np.ndarray]) -> None:
    """Least squares on independent columns without each block, written out."""
    scene, motion, tau = log
    measured = tau + 0.3 * residuals("low pass 10 Hz", 2000, 3, np.random.default_rng(1))
    found = scene.identify(*motion, measured, fit=FIT, noise=0.3)
    columns = found.columns
    rows, known = columns.rows(*motion)
    whole = np.zeros((2000, 3, columns.width))
    for motor, (block, used) in enumerate(zip(rows, columns.used, strict=True)):
        whole[:, motor, used] = block
    at = [columns.names().index(name) for name in found.base.names]

    def fitted(keep: np.ndarray) -> np.ndarray:
        return np.linalg.lstsq(whole[keep][:, :, at].reshape(-1, len(at)), (measured - known)[keep].ravel(), rcond=None)[0]

    every = np.arange(2000)
    assert_near(found.base.values, fitted(every), 1e-8 * size(found.base.values))
    without = np.array([fitted(every[every // 100 != block]) for block in range(20)])
    off = without - without.mean(axis=0)
    assert_near(found.base.covariance / (19 / 20 * off.T @ off), np.ones((len(at), len(at))), 1e-5)
    assert found.base.degrees == 19 and found.blocks == 20


def test_for_independent_residuals_the_covariance_is_that_of_the_hessian() -> None:
    """The two parts, by data and by the prior, add up to the inverse of the second derivative, up to the sampling of 20 blocks."""
    scene = arm(1)
    q, qd, qdd = states(scene, 4000)
    tau = like(scene, 2).inverse_dynamics(q, qd, qdd) + 0.1 * np.random.default_rng(0).standard_normal((4000, 6))
    found = scene.identify(q, qd, qdd, tau, noise=0.1)
    white = Accumulator(scene, block_length=4000).add(q, qd, qdd, tau).identify(noise=0.1)
    ratio = found.deviations / white.deviations
    assert np.all((0.3 < ratio) & (ratio < 2.0)) and 0.85 < np.median(ratio) < 1.15
    assert np.median(np.abs(found.share - white.share)) < 0.05
    assert_near(np.diagonal(found.covariance).reshape(6, 10), found.deviations**2, 1e-12 * size(found.covariance))
    assert np.linalg.eigvalsh(found.covariance)[0] > -1e-12 * size(found.covariance)


def test_where_data_decide_nothing_the_share_says_so() -> None:
    scene = arm(1)
    q, qd, qdd = states(scene, 500)
    tau = scene.inverse_dynamics(q, qd, qdd) + 0.1 * np.random.default_rng(0).standard_normal((500, 6))
    found = scene.identify(q, qd, qdd, tau, noise=0.1)
    # The first link rotates about a fixed axis: its mass has no effect.
    assert found.share[0, 0] < 0.01 and ("link1", "m") in found.undecided()
    alone = scene.identify(q, qd, qdd, tau, noise=0.1, keep=[f"link{at}" for at in range(1, 6)])
    assert np.all(alone.share[5] > 0.9) and np.all(np.isnan(alone.share[:5]))
    low, high = alone.interval()
    truth = scene.inertial_parameters[5]
    assert np.mean((low[5] <= truth) & (truth <= high[5])) >= 0.8
    with pytest.raises(ArgumentError, match=r"level: found 95; expected a probability"):
        alone.interval(95)


@pytest.mark.parametrize("kept", [0, 5])
def test_correlated_residuals_decide_less(kept: int) -> None:
    """Rows whose residuals are correlated are fewer independent ones: the prior is weighed against those."""
    scene, log, decided, inflation = arm(1), fourier(4 * STEP * np.arange(500), 6), [], []
    for correlation in (0.0, 1.0):
        draw, count = np.random.default_rng(0), []
        for _ in range(3):
            noise = draw.standard_normal((500, 6))
            noise = first_order(noise, correlation / 4) if correlation else noise
            found = scene.identify(*log, scene.inverse_dynamics(*log) + 0.5 * noise, keep=scene.body_names[:kept])
            count.append(int(np.sum(found.share > 0.9)))
            inflation.append(found.inflation)
        decided.append(np.mean(count))
    assert np.all(np.array(inflation) >= 1.0) and np.max(inflation[:3]) < 2.0 and np.min(inflation[3:]) > 4.0
    assert decided[0] > 9.0 if kept else decided[0] < 1.0
    assert decided[1] < max(0.8 * decided[0], 1.0)
    assert "states of joint" in str(found) and found.scene.nv == 6


def test_the_inflation_is_that_of_the_scores() -> None:
    """With one column the score is a sum of residuals times it: its variance for an autoregression, from the definition."""
    scene = phipsi.scenes.chain(1).with_properties(damping=0.0)
    time = 0.02 * np.arange(6000)
    q, qd, qdd = np.sin(time)[:, None], np.cos(time)[:, None], -np.sin(time)[:, None]
    tau, keep = scene.inverse_dynamics(q, qd, qdd) + 0.5 * qd, np.exp(-0.02 / 0.1)
    lag = np.arange(-400, 401)
    # At the frequency of the motion, 1 rad/s.
    expected = np.sum(keep ** np.abs(lag) * np.cos(0.02 * lag))
    draw, found = np.random.default_rng(0), []
    for _ in range(20):
        residual = first_order(draw.standard_normal((6000, 1)), 0.1 * STEP / 0.02)
        found.append(scene.identify(q, qd, qdd, tau + 0.1 * residual, fit=["damping"], keep=scene.body_names).inflation[0])
    assert abs(np.mean(found) / expected - 1.0) < 4.0 * np.std(found) / expected / np.sqrt(20) + 0.05


def test_joints_without_information_are_marked() -> None:
    """Armature of a joint that hardly accelerates, and friction of one that does not move at all."""
    scene = arm(9, bodies=3)
    draw = np.random.default_rng(0)
    q, qd, qdd = states(scene, 600)
    qdd[:, 1] *= 1e-4
    q[:, 2], qd[:, 2], qdd[:, 2] = 0.3, 0.0, 0.0
    tau = scene.inverse_dynamics(q, qd, qdd) + 1.14 * qdd + 0.3 * qd + 0.5 * draw.standard_normal((600, 3))
    found = scene.identify(q, qd, qdd, tau, fit=["armature", "damping"])
    assert found.joint_share["armature"]["joint2"] < 0.1 and found.joint_share["damping"]["joint1"] > 0.9
    undecided = found.undecided()
    assert ("joint2", "armature") in undecided and ("joint3", "damping") in undecided and ("joint1", "damping") not in undecided
    assert "joint3" not in found.joints["damping"]
    low, high = found.joint_interval()["damping"]["joint1"]
    assert low < 0.3 < high and high - low < 0.2
    bodies, joints = found.marks()
    assert joints["armature"]["joint2"].startswith("*") and joints["damping"]["joint1"] == ""
    below = found.interval()[0] < 0.0
    assert [("!" in mark) for mark in bodies[:, 0]] == below[:, 0].tolist() and below[:, 0].any()
    assert "!" not in bodies[0, 1] and "*" in bodies[0, 0]
    assert f"{int(below[:, 0].sum())} of 3 intervals of masses reach below zero" in str(found)
    with pytest.raises(ArgumentError, match=r"level: found 95; expected a probability"):
        found.joint_interval(95)


def test_quantiles_of_students_distribution() -> None:
    stats = pytest.importorskip("scipy.stats")
    for level in (0.5, 0.683, 0.95, 0.999):
        for degrees in (1.0, 2.5, 4.0, 19.0, 200.0, np.inf):
            expected = stats.norm.ppf(0.5 + level / 2) if np.isinf(degrees) else stats.t.ppf(0.5 + level / 2, degrees)
            assert abs(student_quantile(level, degrees) / expected - 1.0) < 1e-5, (level, degrees)


# Streams


def test_a_stream_is_the_whole_log_in_any_parts_and_order_of_merging() -> None:
    scene = arm(3)
    q, qd, qdd = states(scene, 6000)
    tau = scene.inverse_dynamics(q, qd, qdd) + 0.1 * np.random.default_rng(0).standard_normal((6000, 6))
    tau[::7, 2] = np.nan
    whole = scene.identify(q, qd, qdd, tau, fit=FIT, noise=0.1)
    stream = Accumulator(scene, fit=FIT)
    for begin, end in ((0, 1), (1, 777), (777, 778), (778, 4001), (4001, 6000)):
        stream.add(q[begin:end], qd[begin:end], qdd[begin:end], tau[begin:end])
    assert 20 <= len(stream.blocks()) < 40 and stream.states == 6000
    parts = [Accumulator(scene, fit=FIT).add(*(one[begin : begin + 2000] for one in (q, qd, qdd, tau))) for begin in (0, 2000, 4000)]
    merged = [parts[0].merge(parts[1]).merge(parts[2]), parts[0].merge(parts[1].merge(parts[2]))]
    for other in (stream, *merged):
        found = other.identify(noise=0.1)
        assert_near((found.base.values - whole.base.values) / whole.base.deviations, np.zeros(len(whole.base.names)), 1e-8)
        # The blocks differ, so the effective numbers of states do, against which the prior is weighed.
        assert_near((found.parameters - whole.parameters) / whole.deviations, np.zeros((6, 10)), 1e-2)
        assert_near(found.after, whole.after, 1e-5)
        assert found.states == whole.states
    # The blocks differ, so intervals do, a little.
    ratio = merged[0].identify(noise=0.1).base.deviations / whole.base.deviations
    assert 0.7 < np.median(ratio) < 1.4


def test_what_is_left_over_at_the_end_is_not_dropped() -> None:
    scene = arm(3, bodies=2)
    q, qd, qdd = states(scene, 21)
    stream = Accumulator(scene, blocks=2, block_length=10).add(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd))
    assert [block.states for block in stream.blocks()] == [10, 11]
    assert stream.states == 21


def test_memory_does_not_grow_with_the_log() -> None:
    scene = arm(3, bodies=2)
    q, qd, qdd = states(scene, 1000)
    tau = scene.inverse_dynamics(q, qd, qdd)
    stream, sizes = Accumulator(scene, block_length=50), []
    for _ in range(20):
        stream.add(q, qd, qdd, tau)
        sizes.append(sum(triangle.nbytes for block in stream.blocks() for triangle in block.triangles))
    assert max(sizes[2:]) <= 2 * sizes[2]


def test_accumulators_of_other_columns_do_not_merge() -> None:
    scene = arm(3, bodies=2)
    with pytest.raises(ArgumentError, match="other: found an accumulator of other columns"):
        Accumulator(scene).merge(Accumulator(scene, fit=["damping"]))
    with pytest.raises(ArgumentError, match="q: found no states"):
        Accumulator(scene).identify()
    with pytest.raises(ArgumentError, match="blocks: found 1; expected a whole number, at least 2"):
        Accumulator(scene, blocks=1)


# Noise in the regressor


def test_bias_by_noisy_accelerations_is_predicted_and_instruments_remove_it() -> None:
    scene, bias, deviations, cured = arm_of_three().with_properties(damping=0.0, friction=0.0), [], [], []
    reference = fourier(STEP * np.arange(2000))
    exact = scene.inverse_dynamics(*reference)
    draw, sigma = np.random.default_rng(0), 0.7
    predicted: list[np.ndarray] = []
    for _ in range(25):
        tau = exact + 0.1 * draw.standard_normal(exact.shape)
        q, qd, qdd = reference[0], reference[1], reference[2] + sigma * draw.standard_normal(exact.shape)
        with pytest.warns(IdentificationWarning, match=r"acceleration_noise: predicts a bias of .* standard deviations of .*; give instruments="):
            found = scene.identify(q, qd, qdd, tau, noise=0.1, acceleration_noise=sigma)
        again = scene.identify(q, qd, qdd, tau, noise=0.1, acceleration_noise=sigma, instruments=reference)
        bias.append(found.base.values - found.base.model)
        deviations.append(found.base.deviations)
        predicted.append(found.base.bias)
        cured.append(again.base.values - again.base.model)
    mean, spread = np.mean(bias, axis=0), np.std(bias, axis=0)
    large = np.abs(mean) > 3.0 * spread
    assert large.sum() >= 3
    ratio = np.mean(predicted, axis=0)[large] / mean[large]
    assert np.all((0.7 < ratio) & (ratio < 1.3))
    # Of instruments: within four standard errors of the mean over the logs.
    assert np.all(np.abs(np.mean(cured, axis=0)) < 4.5 * np.std(cured, axis=0) / np.sqrt(25))
