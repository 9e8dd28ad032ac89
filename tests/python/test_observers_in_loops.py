"""Observers of scenes with mimic joints and connections, against dense algebra that reads nothing of phipsi."""

from __future__ import annotations

from collections.abc import Callable

import capabilities
import numpy as np
import phipsi
import pytest
from conftest import random_rotation
from phipsi.errors import SingularTaskError
from phipsi.estimation import Accelerometer, Contact, Encoder, ExternalWrench, Gyro, Observer, TorqueSensor
from phipsi.estimation._records import Record, State
from tolerances import assert_near


def on_rows(kind: str, dt: float) -> tuple[Observer, capabilities.Case]:
    """An observer of a mechanism with a joint that follows another, or with a pin, with sensors and a wrench on its links."""
    case = capabilities.Case(kind, False)
    turn = random_rotation(np.random.default_rng(0))
    sensors = [
        Encoder(noise=1e-3),
        Gyro(link="rocker", noise=1e-3, bias=0.1, rotation=turn),
        Accelerometer(link="pendulum", noise=1e-2, xyz=(0.1, 0.2, 0.3), rotation=turn),
        TorqueSensor(noise=0.1),
        Contact(link="rocker", noise=0.1, xyz=(0.3, 0.2, 0.1)),
    ]
    wrenches = [ExternalWrench("rocker", density=1.0, correlation_time=0.5)]
    return case.scene.observer(dt, sensors, q=case.q, qd=case.qd, torque_noise=0.1, wrenches=wrenches), case


def along_rows(observer: Observer, case: capabilities.Case, d: np.ndarray) -> Callable[[float], tuple[State, np.ndarray]]:
    """States and torque noise along a direction of (motion, wrenches and biases, torque noise) that the pin allows."""
    prior, free = observer._prior, case.free
    rest = np.random.default_rng(1).normal(size=prior.rest.shape)

    def at(by: float) -> tuple[State, np.ndarray]:
        q, qd = case.state(case.u + by * d[:free], case.ud + by * d[free : 2 * free])
        n = 2 * free + len(rest)
        return prior._replace(q=q, qd=qd, rest=rest + by * d[2 * free : n]), by * d[n:]

    return at


@pytest.mark.parametrize(("kind", "dt"), [("mimic", 1e-2), ("loop", 1e-2), ("loop", 1e-3)])
def test_steps_and_sensors_are_linearized_along_rows(kind: str, dt: float) -> None:
    observer, case = on_rows(kind, dt)
    scene, tau, size = observer.scene, case.tau, observer._prior.root.shape[-1]
    nv = scene.nv
    for d in np.random.default_rng(3).normal(size=(4, 2 * case.free + size - 2 * nv + nv)):
        at = along_rows(observer, case, d)
        base, _ = at(0.0)
        tangent = capabilities.slope(lambda by, at=at: np.concatenate([*at(by)[0][:3], at(by)[1]]))

        def after(by: float, at: object = at) -> tuple[np.ndarray, np.ndarray]:
            record = Record(tau, {})
            record.root = np.zeros((size + nv, size + nv))
            found = observer._predict(*at(by), record)
            return np.concatenate([found.q, found.qd, found.rest]), record.flow

        expected = capabilities.slope(lambda by: after(by)[0])
        # The step leaves the pin to third order, and the projection is linearized where it ends.
        bound = 1e-8 if kind == "mimic" else 100.0 * dt**3
        assert_near(after(0.0)[1] @ tangent, expected, bound * float(np.max(np.abs(expected))))
        if kind == "loop":
            tree = case.tree(after(0.0)[0][:nv], after(0.0)[0][nv : 2 * nv])
            error, jacobian, _ = case.rows(tree)
            assert_near(np.append(error, jacobian @ tree.xd), np.zeros(4), 1e-12)
        qdd, flow = observer._flow(base, tau)
        for sensor in observer.sensors:

            def reading(by: float, at: object = at, sensor: object = sensor) -> np.ndarray:
                here, noise = at(by)
                found = sensor.predict(scene, observer._groups, (here.q, here.qd, observer._flow(here, tau + noise)[0]), tau)
                return found.value + (0.0 if found.by_noise is None else found.by_noise @ noise)

            found = sensor.predict(scene, observer._groups, (base.q, base.qd, qdd), tau)
            rows = np.zeros((len(found.value), size + nv))
            rows[:, :nv], rows[:, nv : 2 * nv] = found.by_q, found.by_qd
            if found.by_qdd is not None:
                rows += found.by_qdd @ flow
            if found.by_noise is not None:
                rows[:, size:] += found.by_noise
            expected = capabilities.slope(reading)
            assert_near(rows @ tangent, expected, 1e-7 * max(1.0, float(np.max(np.abs(expected)))))


def test_a_loop_starts_and_stays_on_its_pin() -> None:
    """The first covariance is that of independent errors given the pin; smoothed states satisfy it, and the last is the filter's."""
    case = capabilities.Case("loop", False)
    scene, rest = case.scene, np.zeros(4)
    observer = scene.observer(5e-3, [Encoder(noise=1e-3)], q=case.q, qd=case.qd, torque_noise=0.01, initial=(0.01, 0.05))
    start = observer._prior.root @ observer._prior.root.T
    tangent = np.stack([capabilities.slope(lambda by, d=d: np.concatenate(case.state(case.u + by * d[:2], case.ud + by * d[2:]))) for d in np.eye(4)], axis=1)
    precision = tangent.T @ np.diag(np.repeat([0.01, 0.05], 4) ** -2.0) @ tangent
    assert_near(start, tangent @ np.linalg.solve(precision, tangent.T), 1e-8 * float(np.max(start)))
    path = case.path(case.q, case.qd, np.zeros((20, 4)), 5e-3)[:, :4]
    random = np.random.default_rng(4)
    for q in path:
        last = observer.step(rest, {"encoder": q + 1e-3 * random.normal(size=4)})
    smoothed = observer.smooth()
    assert_near(smoothed.q[-1], last.q, 1e-12)
    assert_near(smoothed.covariance[-1], last.covariance, 1e-12)
    assert all(np.max(np.abs(case.rows(case.tree(q, rest))[0])) < 1e-9 for q in smoothed.q)
    assert np.all(np.diagonal(smoothed.covariance[0])[:4] < np.diagonal(start)[:4])
    off = smoothed.q - path
    spread = np.sqrt(np.diagonal(smoothed.covariance, axis1=-2, axis2=-1))[:, :4]
    assert np.all(np.abs(off) < 6.0 * spread) and float(np.mean(np.square(off / spread))) < 3.0


def test_a_start_that_leaves_the_pin_is_refused() -> None:
    case = capabilities.Case("loop", False)
    with pytest.raises(phipsi.errors.ConstraintError, match="pin"):
        case.scene.observer(5e-3, [Encoder(noise=1e-3)], q=case.q + 0.1, torque_noise=0.01)


def test_wrenches_of_a_loop_are_found_from_its_motions() -> None:
    """Six independent motions are not there: the wrench is refused by name, and a load is weighed through the pin."""
    case = capabilities.Case("loop", False)
    point, mass, rest = (0.0, 0.05, -0.1), 0.3, np.zeros(4)
    loaded = case.scene.with_payload("pendulum", mass, com=point)
    path = loaded.simulate(case.q, rest, dt=1e-3, steps=300, damping=2.0)
    observer = case.scene.momentum_observer(1e-3, torque_noise=1e-6, bandwidth=200.0, load=("pendulum", point))
    sigma = np.zeros((4, 10, 10))
    sigma[1, 0, 0] = 0.01
    uncertain = case.scene.momentum_observer(1e-3, torque_noise=1e-6, bandwidth=200.0, parameters=sigma)
    for q, qd in zip(path.q, path.qd, strict=True):
        found = observer.step(q, qd, -2.0 * qd)
        uncertain.step(q, qd, -2.0 * qd)
    assert found.alarm and abs(float(observer.mass) - mass) < 0.05 * mass, observer.mass
    motions, qdd = case.motions(q), case.forward(q, qd, -2.0 * qd + uncertain.joint_torque)
    moved = case.regressor(q, qd, qdd)[:, 1, 0]
    projector = motions @ np.linalg.solve(motions.T @ motions, motions.T)
    expected = projector @ (np.diag(observer._variance) + 0.01 * np.outer(moved, moved)) @ projector
    assert_near(uncertain.covariance, expected, 1e-9 * float(np.max(np.abs(expected))))
    with pytest.raises(SingularTaskError):
        uncertain.wrench("pendulum")
