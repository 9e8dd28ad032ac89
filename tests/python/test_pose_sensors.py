"""Poses of links as readings of an observer, and wrenches that act only in contact."""

from __future__ import annotations

import warnings

import numpy as np
import phipsi
import pytest
import scipy.spatial.transform
from conftest import random_rotation, random_scene
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError
from phipsi.estimation import Encoder, ExternalWrench, Gyro, Pose, nees
from test_observers import slider
from tolerances import EPS, assert_near, assert_same_bits


def deviation(scene: phipsi.Scene, link: str, mount: np.ndarray, at: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(rotation, position) of the frame at q in its axes at another state."""
    here, there = scene.placement(at, link) @ mount, scene.placement(q, link) @ mount
    turned = scipy.spatial.transform.Rotation.from_matrix(here[:3, :3].T @ there[:3, :3]).as_rotvec()
    return np.concatenate([turned, here[:3, :3].T @ (there[:3, 3] - here[:3, 3])])


@pytest.mark.parametrize("given", ["noise", "covariance"])
def test_an_update_is_that_of_the_linear_problem(given: str) -> None:
    """One reading, with rows by differences of the placement, against the equations of Kalman; the base is free."""
    random = np.random.default_rng(0)
    scene = random_scene(7, 4, floating_base=True, kinds=("revolute", "spherical"))
    nv, link, mount = scene.nv, scene.link_names[-1], np.eye(4)
    mount[:3, :3], mount[:3, 3] = random_rotation(random), [0.1, 0.2, -0.1]
    q = scene.integrate(scene.neutral(), random.normal(size=nv))
    root = random.normal(size=(6, 6))
    covariance = 1e-6 * (root @ root.T + np.eye(6)) if given == "covariance" else np.diag(np.arange(1, 7) ** 2 * 1e-6)
    noise = {"covariance": covariance} if given == "covariance" else {"noise": 1e-3 * np.arange(1, 7)}
    sensor = Pose(link=link, xyz=mount[:3, 3], rotation=mount[:3, :3], **noise)
    observer = scene.observer(1e-3, [sensor], q=q, torque_noise=0.1, initial=(1e-3, 0.1))
    step = 1e-4
    difference = lambda e: (8 * (deviation(scene, link, mount, q, scene.integrate(q, e)) - deviation(scene, link, mount, q, scene.integrate(q, -e)))
                            - (deviation(scene, link, mount, q, scene.integrate(q, 2 * e)) - deviation(scene, link, mount, q, scene.integrate(q, -2 * e)))) / (12 * step)  # fmt: skip
    rows = np.stack([difference(step * unit) for unit in np.eye(nv)], axis=-1)
    prior = 1e-6 * np.eye(nv)
    truth = scene.integrate(q, 1e-3 * random.normal(size=nv))
    found = observer.step(np.zeros(nv), {"pose": scene.placement(truth, link) @ mount})
    error = deviation(scene, link, mount, q, truth)
    of_error = rows @ prior @ rows.T + covariance
    gain = np.linalg.solve(of_error, rows @ prior).T
    assert_near(scene.difference(q, found.q), gain @ error, 1e-6 * float(np.max(np.abs(gain @ error))))
    assert_near(found.nis, error @ np.linalg.solve(of_error, error), 1e-6 * float(found.nis))
    # The error is in the tangent space of the corrected q, to first order in the correction.
    assert_near(found.covariance[:nv, :nv], prior - gain @ of_error @ gain.T, 5e-3 * 1e-6)
    assert found.nis_size == 6


def test_errors_are_those_that_the_filter_states() -> None:
    """A rotating free body is observed by poses with a covariance alone; the truth is exact without torques on a sphere."""
    builder = phipsi.SceneBuilder().link("world").link("ball", 2.0, (0, 0, 0), 0.1 * np.eye(3)).joint("root", "floating", "world", "ball")
    scene, runs, dt = builder.build(gravity=(0.0, 0.0, 0.0)), 60, 0.02
    random, root = np.random.default_rng(3), np.diag([0.02, 0.03, 0.01, 0.005, 0.004, 0.003])
    root[3, 0], root[5, 1] = 0.004, -0.002
    neutral = np.tile(scene.neutral(), (runs, 1))
    observer = scene.observer(dt, [Pose(link="ball", covariance=root @ root.T)], q=neutral, torque_noise=0.0, initial=(0.05, 1.0), history=30)
    e = np.repeat([0.05, 1.0], 6) * random.normal(size=(runs, 12))
    q, qd, truth = scene.integrate(neutral, e[:, :6]), e[:, 6:], []
    for _ in range(30):
        pose = scene.placement(q, "ball")
        noise = random.normal(size=(runs, 6)) @ root.T
        measured = pose.copy()
        measured[:, :3, 3] += np.einsum("nij,nj->ni", pose[:, :3, :3], noise[:, 3:])
        measured[:, :3, :3] = pose[:, :3, :3] @ scipy.spatial.transform.Rotation.from_rotvec(noise[:, :3]).as_matrix()
        estimate = observer.step(np.zeros(6), {"pose": measured})
        truth.append((q, qd))
        # A constant angular velocity, and a linear velocity that is constant in the base frame: both in the body frame.
        q = scene.integrate(q, np.zeros_like(qd))
        turn = scipy.spatial.transform.Rotation.from_rotvec(dt * qd[:, 3:])
        before, after = pose[:, :3, :3], pose[:, :3, :3] @ turn.as_matrix()
        q = np.concatenate([q[:, :3] + dt * np.einsum("nij,nj->ni", before, qd[:, :3]), scipy.spatial.transform.Rotation.from_matrix(after).as_quat()], axis=-1)
        qd = np.concatenate([np.einsum("nji,njk,nk->ni", after, before, qd[:, :3]), qd[:, 3:]], axis=-1)
    q, qd = truth[-1]
    values = nees(np.concatenate([scene.difference(estimate.q, q), qd - estimate.qd], axis=-1), estimate.covariance) / 12
    assert 0.8 <= np.mean(values) <= 1.2, np.mean(values)
    smoothed = observer.smooth()
    q, qd = truth[15]
    values = nees(np.concatenate([scene.difference(smoothed.q[15], q), qd - smoothed.qd[15]], axis=-1), smoothed.covariance[15]) / 12
    assert 0.8 <= np.mean(values) <= 1.2, np.mean(values)


def test_rotation_vectors_are_scipys() -> None:
    random, sensor = np.random.default_rng(1), Pose(link="tool", noise=1e-3)
    vectors = np.concatenate([random.uniform(-1.5, 1.5, size=(20, 3)), [[0.0, 0.0, 0.0], [1e-9, 0.0, 0.0], [np.pi - 1e-7, 0.0, 0.0], [0.0, -3.1, 0.0]]])
    poses = np.tile(np.eye(4), (len(vectors), 1, 1))
    poses[:, :3, :3] = scipy.spatial.transform.Rotation.from_rotvec(vectors).as_matrix()
    assert_near(sensor._vector(poses)[:, :3], vectors, 1e-8)


@pytest.mark.parametrize("half_turn", [False, True])
@pytest.mark.parametrize("off", [0.0, 1e-15, 1e-9, 1e-8, 1e-7, 1e-4])
def test_predicted_rotations_are_scipys_near_zero_and_half_turns(half_turn: bool, off: float) -> None:
    scene = phipsi.SceneBuilder().link("box", 1.0, (0, 0, 0.1), 0.02 * np.eye(3)).build(floating_base=True)
    random, rotations = np.random.default_rng(5), scipy.spatial.transform.Rotation
    for axis in [*np.eye(3), np.array([1.0, -1.0, 0.0]), *random.normal(size=(50, 3))]:
        wanted = axis / np.linalg.norm(axis) * (np.pi - off if half_turn else off)
        q = np.concatenate([np.zeros(3), rotations.from_rotvec(wanted).as_quat()])
        found = Pose(link="box", noise=1.0).predict(scene, np.zeros((1, 2), int), (q, np.zeros(6), None), np.zeros(6)).value[:3]
        # Both signs of a half turn are the same rotation.
        apart = (rotations.from_rotvec(found).inv() * rotations.from_quat(q[3:])).as_rotvec()
        assert_near(apart, np.zeros(3), 16 * EPS * (np.pi if half_turn else max(off, EPS)))


def test_a_reading_equal_to_the_prediction_is_processed() -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    tool, random = scene.link_names[-1], np.random.default_rng(6)
    for q in random.uniform(-2.0, 2.0, (100, 6)):
        observer = scene.observer(0.01, [Pose(link=tool, noise=0.01)], q=q, torque_noise=0.01)
        estimate = observer.step(scene.gravity_torque(q), {"pose": scene.placement(q, tool)})
        assert_near(estimate.q, q, 1e4 * EPS)
        assert abs(float(estimate.nis)) < 1e-20


def test_missing_and_bad_poses() -> None:
    scene = phipsi.scenes.chain(2)
    tip = scene.link_names[-1]
    one, other = (scene.observer(1e-3, [Pose(link=tip, noise=1e-3, gate=0.999), Encoder(noise=1e-3)], q=np.zeros(2), torque_noise=0.1) for _ in range(2))
    pose = scene.placement(np.zeros(2), tip)
    bad, far = pose.copy(), pose.copy()
    bad[0, 3], far[2, 3] = np.nan, 5.0
    encoder = {"encoder": np.zeros(2)}
    for reading, rejected in ((bad, False), (None, False), (far, True)):
        found = one.step(np.zeros(2), encoder | {"pose": reading})
        assert_same_bits(found.covariance, other.step(np.zeros(2), encoder).covariance)
        assert found.nis_size == 2 and np.all(found.rejected["pose"] == rejected)
    assert one.step(np.zeros(2), encoder | {"pose": pose}).nis_size == 8
    with pytest.raises(ShapeError, match=r"readings\['pose'\]: found shape \(3,\); expected \(\.\.\., 4, 4\)"):
        one.step(np.zeros(2), {"pose": [0.0, 0.0, 0.0]})
    with pytest.raises(ArgumentError, match=r"readings\['pose'\]: found a matrix whose axes are no rotation"):
        one.step(np.zeros(2), {"pose": 2.0 * pose})
    with pytest.raises(NotFiniteError, match="infinity"):
        one.step(np.zeros(2), {"pose": np.full((4, 4), np.inf)})
    with pytest.raises(ArgumentError, match="covariance of 'pose'.*positive definite"):
        scene.observer(1e-3, [Pose(link=tip, covariance=np.zeros((6, 6)))], q=np.zeros(2), torque_noise=0.1)
    with pytest.raises(ShapeError, match=r"covariance of 'pose': found shape \(3, 3\); expected \(6, 6\)"):
        scene.observer(1e-3, [Pose(link=tip, covariance=np.eye(3))], q=np.zeros(2), torque_noise=0.1)


def test_wrenches_that_act_in_contact_are_the_posterior() -> None:
    """Two sliders, linear: the wrench is zero without contact and a new random walk in each; against dense least squares."""
    scene, dt, steps, random = slider(), 0.05, 24, np.random.default_rng(6)
    acts = (np.arange(steps) >= 5) & (np.arange(steps) < 12) | (np.arange(steps) >= 16)
    size = np.array([0, 0, 0, 1.0, 0, 0])
    observer = scene.observer(dt, [Encoder(noise=0.02)], q=[0.1, -0.2], torque_noise=0.01, wrenches=[ExternalWrench("second", 0.5 * size, deviation=0.8 * size)], initial=(0.2, 0.3))
    inverse = np.linalg.inv(scene.mass_matrix([0.0, 0.0]))
    by_force = inverse @ np.ones(2)
    # Independent numbers: the start of (q, qd), and of each step the start of the wrench, torque noise, growth, within, and readings.
    per = 1 + 2 + 1 + 1 + 2
    count = 4 + per * steps
    sigma, x, w, rows, states = [0.2, 0.2, 0.3, 0.3], np.zeros((4, count)), np.zeros(count), [], []
    x[:, :4] = np.eye(4)
    for k in range(steps):
        own = np.eye(count)[4 + per * k : 4 + per * (k + 1)]
        begins = acts[k] and (k == 0 or not acts[k - 1])
        w = own[0] if begins else w if acts[k] else np.zeros(count)
        growth = np.sqrt(0.5 * dt) * acts[k]
        sigma += [0.8, *(2 * [np.sqrt(0.01 / dt)]), 1.0, 1.0, 0.02, 0.02]
        states.append(np.concatenate([x, w[None]]))
        rows.append(x[:2] + own[5:7])
        after = w + growth * own[3]
        a = inverse @ own[1:3] + np.outer(by_force, 0.5 * (w + after) + growth / np.sqrt(12.0) * own[4])
        x, w = np.concatenate([x[:2] + dt * (x[2:] + 0.5 * dt * a), x[2:] + dt * a]), after
    sigma, rows = np.array(sigma), np.concatenate(rows)
    mean = np.concatenate([[0.1, -0.2], np.zeros(count - 2)])
    # The mean of q propagates as a state.
    start = np.zeros(count)
    start[:2] = mean[:2]
    values = rows @ (start + sigma * random.normal(size=count))
    p = np.diag(sigma**2)
    gain = np.linalg.solve(rows @ p @ rows.T, rows @ p).T
    expected, posterior = start + gain @ (values - rows @ start), p - gain @ rows @ p
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for k in range(steps):
            found = observer.step([0.0, 0.0], {"encoder": values[2 * k : 2 * k + 2]}, acting={"second": bool(acts[k])})
            if not acts[k]:
                assert not found.wrenches["second"].any() and not found.covariance[4:].any()
    smoothed = observer.smooth()
    pick = [0, 1, 2, 3, 7]
    means = np.stack([s @ expected for s in states])
    covariances = np.stack([s @ posterior @ s.T for s in states])
    state = np.concatenate([smoothed.q, smoothed.qd, smoothed.wrenches["second"][:, 3:4]], axis=-1)
    assert_near(state, means, 1e-9 * float(np.max(np.abs(means))))
    assert_near(smoothed.covariance[:, pick][:, :, pick], covariances, 1e-9 * float(np.max(np.abs(covariances))))


def test_flags_of_wrenches() -> None:
    scene = phipsi.scenes.chain(2)
    tip = scene.link_names[-1]
    observer = scene.observer(1e-3, [Encoder(noise=1e-3), Gyro(link=tip, noise=0.1)], q=np.zeros((2, 2)), torque_noise=0.1, wrenches=[ExternalWrench(tip, 1.0, deviation=2.0)])
    found = observer.step(np.zeros(2), {}, acting={tip: [True, False]})
    assert_near(np.diagonal(found.covariance, axis1=-2, axis2=-1)[:, 4:], [[4.0] * 6, [0.0] * 6], 1e-12)
    found = observer.step(np.zeros(2), {}, acting={tip: np.array([False, True])})
    assert_near(np.diagonal(found.covariance, axis1=-2, axis2=-1)[:, 4:], [[0.0] * 6, [4.0] * 6], 1e-12)
    with pytest.raises(ArgumentError, match="acting: found 'nowhere'; expected links of wrenches"):
        observer.step(np.zeros(2), {}, acting={"nowhere": True})
    with pytest.raises(ArgumentError, match=r"acting\[.*\]: found 0.5; expected True or False"):
        observer.step(np.zeros(2), {}, acting={tip: 0.5})
    with pytest.raises(ShapeError, match=r"acting\[.*\]: found shape \(3,\); expected one that broadcasts to \(2,\)"):
        observer.step(np.zeros(2), {}, acting={tip: [True, False, True]})
