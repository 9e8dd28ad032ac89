"""Loads and drive gains from two logs. The truth is Pinocchio's recursion for a robot with other inertias and friction."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from logs import COM, INERTIA, LINK, MASS, Motion, fourier, loaded_arm, stribeck
from tolerances import assert_near

import phipsi
from phipsi.errors import ArgumentError
from phipsi.estimation import Accumulator, Payload

pytest.importorskip("pinocchio")

FIT = ["damping", "friction"]
ORIGIN = INERTIA + MASS * (COM @ COM * np.eye(3) - np.outer(COM, COM))
#: Parameters of the load in the frame of the link, I about the origin.
TRUTH = np.array([MASS, *MASS * COM, *(ORIGIN[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))])

Robot = tuple[phipsi.Scene, Callable[[Motion, bool], np.ndarray]]


@pytest.fixture(scope="module")
def robot() -> Robot:
    return loaded_arm()


def accumulated(scene: phipsi.Scene, motion: Motion, tau: np.ndarray, **options: Any) -> Accumulator:
    return Accumulator(scene, **({"fit": FIT, "block_length": len(tau) // 20} | options)).add(*motion, tau)


def identified(scene: phipsi.Scene, motions: list[Motion], torques: list[np.ndarray], draw: np.random.Generator, noise: float) -> Payload:
    logs = [accumulated(scene, motion, tau + noise * draw.standard_normal(tau.shape)) for motion, tau in zip(motions, torques, strict=True)]
    return logs[1].identify_payload(LINK, without=logs[0])


@pytest.mark.parametrize("same_motion", [True, False])
def test_intervals_of_a_load_contain_it(robot: Robot, same_motion: bool) -> None:
    scene, of = robot
    time = 0.01 * np.arange(1000)
    empty = fourier(time)
    motions = [empty, empty if same_motion else fourier(time, seed=7)]
    # Friction beyond the model cancels in logs of the same motion alone.
    friction = stribeck if same_motion else (lambda qd: 2.0 * qd + 3.0 * qd / np.sqrt(qd**2 + 0.01**2))
    torques = [of(motion, bool(at)) + friction(motion[1]) for at, motion in enumerate(motions)]
    draw, held, off = np.random.default_rng(0), [], []
    for _ in range(60):
        found = identified(scene, motions, torques, draw, 0.3)
        low, high = found.interval(0.95)
        held.append((low <= TRUTH) & (high >= TRUTH))
        off.append((found.parameters - TRUTH) / found.deviations)
    # 600 dependent intervals.
    assert 0.90 <= np.mean(held) <= 0.99
    assert 0.8 < np.sqrt(np.mean(np.square(off))) < 1.3
    assert np.abs(np.mean([found.mass]) - MASS) < 0.05 and found.deviations[0] < 0.02
    assert found.blocks >= 8 and np.all(np.abs(found.com - COM) < 0.01)


def test_errors_of_the_model_cancel_and_a_single_log_keeps_them(robot: Robot) -> None:
    scene, of = robot
    motion = fourier(0.01 * np.arange(600))
    torques = [of(motion, loaded) + stribeck(motion[1]) for loaded in (False, True)]
    found = identified(scene, [motion, motion], torques, np.random.default_rng(0), 0.0)
    # The load acts on torques of up to 100 N m.
    assert_near(found.parameters, TRUTH, 1e-9)
    assert_near(found.com, COM, 1e-9)
    assert_near(found.inertia, INERTIA, 1e-8)
    assert np.max(found.deviations) < 1e-8
    assert_near(scene.with_payload(LINK, found.mass, found.com, found.inertia).total_mass, scene.total_mass + MASS, 1e-9)
    # With the robot's links as known.
    rows = scene.regressor(*motion)[:, :, 2].reshape(-1, 10)
    known = torques[1] - scene.inverse_dynamics(*motion) - stribeck(motion[1])
    assert abs(np.linalg.lstsq(rows, known.ravel(), rcond=None)[0][0] - MASS) > 0.1


def test_a_transmission_and_logs_of_other_lengths() -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    B = np.eye(6)
    B[5, 4] = 1.0
    logs = []
    for count, robot in ((700, scene), (400, scene.with_payload("flange", MASS, COM, INERTIA))):
        motion = fourier(0.01 * np.arange(count), 6, seed=count)
        tau = robot.inverse_dynamics(*motion) @ np.linalg.inv(B)
        logs.append(accumulated(scene, motion, tau, transmission=B, block_length=35))
    found = logs[1].identify_payload("flange", without=logs[0], noise=0.01)
    assert_near(found.parameters, TRUTH, 1e-7)


def test_what_a_motion_does_not_determine_is_unknown() -> None:
    scene = phipsi.scenes.chain(2)
    q = np.linspace(-1.0, 1.0, 200)[:, None] * [1.0, 0.3]
    at_rest = (q, np.zeros_like(q), np.zeros_like(q))
    link = scene.body_names[1]
    logs = [accumulated(scene, at_rest, robot.gravity_torque(q), fit=(), block_length=10) for robot in (scene, scene.with_payload(link, 1.0, (0.1, 0.0, 0.1)))]
    found = logs[1].identify_payload(link, without=logs[0], noise=0.01)
    assert np.isnan(found.parameters[4:]).all() and np.isinf(found.deviations[4:]).all()


def test_gains_of_drives(robot: Robot) -> None:
    scene, of = robot
    gains, time, draw = np.array([12.0, -6.0, 4.0]), 0.01 * np.arange(600), np.random.default_rng(0)
    motions = [fourier(time), fourier(time, seed=7)]
    torques = [of(motion, bool(at)) + 2.0 * motion[1] + 3.0 * motion[1] / np.sqrt(motion[1] ** 2 + 0.01**2) for at, motion in enumerate(motions)]
    held, off = [], []
    for _ in range(40):
        logs = [accumulated(scene, motion, (tau + 0.1 * draw.standard_normal(tau.shape)) / gains) for motion, tau in zip(motions, torques, strict=True)]
        found = logs[1].identify_gains(LINK, MASS, COM, INERTIA, without=logs[0])
        low, high = found.interval()
        held.append((low <= gains) & (high >= gains))
        off.append((1.0 / found.gains - 1.0 / gains) * found.gains**2 / found.deviations)
    assert 0.86 <= np.mean(held)
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.5
    assert np.all(np.abs(found.gains / gains - 1.0) < 0.1) and found.names == scene.joint_names


def test_gains_of_motors_that_the_load_does_not_reach() -> None:
    scene = phipsi.scenes.chain(3).with_properties(damping=0.0)
    motion = fourier(0.01 * np.arange(300), 3)
    link = scene.body_names[1]
    logs = [accumulated(scene, motion, robot.inverse_dynamics(*motion) / 8.0, fit=(), block_length=15) for robot in (scene, scene.with_payload(link, 2.0, (0.1, 0.0, 0.2)))]
    found = logs[1].identify_gains(link, 2.0, (0.1, 0.0, 0.2), without=logs[0])
    assert_near(found.gains[:2], np.full(2, 8.0), 1e-6)
    assert np.isnan(found.gains[2]) and np.isinf(found.deviations[2])
    assert np.all(np.isinf(np.array(found.interval())[:, 2]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"link": "nowhere"}, "link: found 'nowhere'; expected a link of"),
        ({"link": "base"}, "link: found 'base', which does not move"),
        ({"keep": ["link6"]}, "link: found 'flange' on 'link6', a link in keep"),
        ({"fit": ["load"]}, "fit: found friction by load, which changes with the load"),
        ({"fit_without": ["damping"]}, "without: found an accumulator of other columns"),
        ({"block_length": 300}, "without: found logs of 1 blocks of time; expected at least 4"),
        ({"noise": 0.0}, "noise: found 0.0"),
        ({"gains": True}, "fit: found armature of the scene, which is not fitted; expected 'armature' in fit"),
        ({"gains": True, "keep": ["link1"]}, "keep: found 'link1'; expected none"),
    ],
)
def test_bad_arguments(change: dict[str, Any], message: str) -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    motion = fourier(0.01 * np.arange(300), 6)
    tau = scene.inverse_dynamics(*motion)
    options = {name: value for name, value in change.items() if name in ("keep", "fit", "block_length")} | ({} if "fit" in change else {"fit": ()})
    loaded, empty = accumulated(scene, motion, tau, **options), accumulated(scene, motion, tau, **(options | {"fit": change.get("fit_without", options["fit"])}))
    with pytest.raises(ArgumentError, match=message):
        if "gains" in change:
            loaded.identify_gains("flange", 1.0, without=empty)
        else:
            loaded.identify_payload(change.get("link", "flange"), without=empty, noise=change.get("noise", 0.1))
