"""Extreme numbers in observers, alarms and consistency tests: results are finite, or the error names the argument."""

from __future__ import annotations

import numpy as np
import phipsi
import pytest
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError
from phipsi.estimation import Encoder, ExternalWrench, Gyro, alarm_threshold, consistency_bounds, mean_time_to_alarm, nees
from tolerances import assert_same_bits

HUGE = [1e155, 1e160, 1e300]


@pytest.mark.parametrize("size", HUGE)
@pytest.mark.parametrize("what", ["reading", "torque", "velocity", "initial", "torque noise", "wrench", "bias"])
def test_numbers_that_overflow_are_errors_of_an_observer(what: str, size: float) -> None:
    """No result is infinite or NaN, and the observer remains usable."""
    scene = phipsi.scenes.chain(3)
    tip, one = scene.link_names[-1], np.ones(3)
    arguments = {
        "velocity": {"qd": size * one},
        "initial": {"initial": (size, size)},
        "torque noise": {"torque_noise": size},
        "wrench": {"wrenches": [ExternalWrench(tip, density=size)]},
        "bias": {"sensors": [Encoder(noise=1e-3), Gyro(link=tip, noise=1e-3, bias=size)]},
    }.get(what, {})
    scale = {"reading": (1.0, size), "torque": (size, 1.0)}.get(what, (1.0, 1.0))
    given = {"sensors": [Encoder(noise=1e-3)], "q": 0.1 * one, "torque_noise": 0.1} | arguments
    readings = {"encoder": scale[1] * one} | ({"gyro": one} if what == "bias" else {})
    try:
        observer = scene.observer(1e-3, given.pop("sensors"), **given)
        for _ in range(3):
            found = observer.step(scale[0] * one, readings)
            parts = [found.q, found.qd, found.covariance, found.nis, *found.wrenches.values(), *found.biases.values()]
            assert all(np.isfinite(part).all() for part in parts)
        smoothed = observer.smooth()
        assert all(np.isfinite(part).all() for part in (smoothed.q, smoothed.qd, smoothed.covariance))
    except NotFiniteError as error:
        assert "overflow" in str(error) or "found" in str(error)


@pytest.mark.parametrize("size", HUGE)
@pytest.mark.parametrize("with_load", [False, True])
def test_numbers_that_overflow_are_errors_of_a_momentum_observer(size: float, with_load: bool) -> None:
    scene = phipsi.scenes.chain(3)
    load = (scene.link_names[-1], (0.1, 0.0, 0.0)) if with_load else None
    for at in range(3):
        observer, states = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0, load=load), [np.full(3, 0.1) for _ in range(3)]
        observer.step(*states)
        states[at] = np.full(3, size)
        before = observer.joint_torque
        try:
            torque, alarm = observer.step(*states)
        except NotFiniteError:
            assert np.array_equal(observer.joint_torque, before)
        else:
            assert np.isfinite(torque).all() and isinstance(alarm, bool)


@pytest.mark.parametrize("change", [
    {"bandwidth": 1e300}, {"bandwidth": 1e-300}, {"dt": 1e300}, {"dt": 1e-300}, {"torque_noise": 1e308, "bandwidth": 1e5}, {"torque_noise": 5e-324},
    {"false_alarms_per_hour": 1e300}, {"false_alarms_per_hour": 1e-300}, {"bandwidth": np.nan}, {"bandwidth": np.inf},
], ids=str)  # fmt: skip
def test_a_momentum_observer_that_cannot_filter_is_refused(change: dict[str, float]) -> None:
    given = {"dt": 1e-3, "torque_noise": 0.01, "bandwidth": 10.0} | change
    with pytest.raises(ArgumentError, match="|".join([*change, "bandwidth"])):
        phipsi.scenes.chain(3).momentum_observer(given.pop("dt"), **given)


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf, 1e300])
@pytest.mark.parametrize(("name", "at"), [("false_alarms_per_hour", 0), ("rate", 1), ("dt", 2), ("size", 3)])
def test_a_threshold_of_extreme_numbers_is_refused(name: str, at: int, wrong: float) -> None:
    arguments = [1.0, 10.0, 1e-3, 6]
    arguments[at] = wrong
    with pytest.raises(ArgumentError, match=f"{name}|false_alarms_per_hour"):
        alarm_threshold(*arguments)
    if at in (1, 3) and wrong != 1e300:
        with pytest.raises(ArgumentError, match=name):
            mean_time_to_alarm(6.0, *arguments[1::2])
    if not wrong <= 32.0:
        with pytest.raises(ArgumentError, match="threshold"):
            mean_time_to_alarm(wrong, 10.0, 6)


@pytest.mark.parametrize("wrong", [0, -1, 0.5, np.nan, np.inf, 1e300, 10**30, "2", None])
def test_bounds_of_no_number_of_components_are_refused(wrong: object) -> None:
    with pytest.raises(ArgumentError, match="size: found .*; expected a whole number, at least 1|count: found .*degrees of freedom"):
        consistency_bounds(wrong)
    with pytest.raises(ArgumentError, match="count: found"):
        consistency_bounds(2, wrong)
    with pytest.raises(ArgumentError, match="count: found 1000000 values of 1000 components; expected at most 1e.08"):
        consistency_bounds(1000, 10**6)


def test_normalized_errors_that_overflow_are_errors() -> None:
    with pytest.raises(NotFiniteError, match="normalized error squared .*overflow"):
        nees([1e200, 1.0], np.eye(2))
    with pytest.raises(ArgumentError, match="covariance: found a variance that is .* not finite"):
        nees([1.0, 1.0], np.diag([np.inf, 1.0]))
    assert np.isnan(nees([np.nan, 1.0], np.eye(2)))


@pytest.mark.parametrize(("at", "name", "number"), [(1, "momentum", 1e200), (2, "tau", np.inf), (2, "tau", np.nan)])
@pytest.mark.parametrize("step", [0, 3])
def test_numbers_that_a_momentum_observer_refuses_leave_it_unchanged(at: int, name: str, number: float, step: int) -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    random, q = np.random.default_rng(0), np.full(6, 0.3)
    own, other = (scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0, velocity_noise=1e-3) for _ in range(2))
    for k in range(6):
        given = [q, 1e-3 * random.normal(size=6), scene.gravity_torque(q)]
        if k == step:
            with pytest.raises(NotFiniteError, match=f"^{name}"):
                other.step(*given[:at], np.full(6, number), *given[at + 1 :])
        assert_same_bits(other.step(*given).joint_torque, own.step(*given).joint_torque)


@pytest.mark.parametrize("name", ["q", "qd"])
def test_starts_of_a_wrong_shape_are_named(name: str) -> None:
    scene = phipsi.scenes.chain(3)
    given = {"q": np.zeros(3), "qd": np.zeros(3)} | {name: np.zeros(2)}
    with pytest.raises(ShapeError, match=rf"^{name}: found shape \(2,\); expected \(\.\.\., 3\)"):
        scene.observer(1e-3, [phipsi.estimation.Encoder(noise=1e-3)], torque_noise=0.1, **given)


def test_momentum_observers_need_a_joint() -> None:
    with pytest.raises(ArgumentError, match="^scene: found no degrees of freedom"):
        phipsi.SceneBuilder().link("only", 1.0).build().momentum_observer(1e-3, torque_noise=1.0, bandwidth=10.0)


@pytest.mark.parametrize("wrong", ["x", True, [1.0, 2.0]])
def test_a_step_that_is_no_number_is_refused(wrong: object) -> None:
    with pytest.raises(ArgumentError, match="^dt: found"):
        phipsi.scenes.chain(2).momentum_observer(wrong, torque_noise=1.0, bandwidth=10.0)  # type: ignore[arg-type]
