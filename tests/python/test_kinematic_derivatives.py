"""Derivatives of velocities, accelerations and Jacobians of links, and of the centroidal momentum: compared with
Pinocchio, with differences on scenes with all types of joints, and with identities.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from conftest import POINT, random_scene, random_states
from oracle_pinocchio import SWAP, Oracle, load
from test_kinematic_quantities import FRAMES
from test_mimic import Case
from tolerances import EPS, assert_near, product, recursion, size, slope_of_order_4

import phipsi
from phipsi.errors import ArgumentError, ShapeError

ROBOTS = {"ur5": ("ur_description/urdf/ur5_robot.urdf", False), "anymal": ("anymal_b_simple_description/robots/anymal.urdf", True)}
#: Step of differences of order 4, whose errors are of the size of step^4 and eps/step.
STEP = EPS ** (1 / 5)


def slopes(scene: phipsi.Scene, q: np.ndarray, value: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Derivatives of value(q) along the tangent space of q, on a new last axis."""
    units = np.eye(scene.nv)
    columns = [slope_of_order_4(lambda h, unit=unit: value(scene.integrate(q, h * unit)), STEP) for unit in units]
    return np.stack(columns, axis=-1)


def assert_slope(found: np.ndarray, expected: np.ndarray) -> None:
    assert_near(found, expected, 2e3 * STEP**4 * size(expected))


@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_links_as_differences(seed: int, floating: bool) -> None:
    scene = random_scene(seed, 7, floating_base=floating)
    q, qd, qdd = random_states(scene, seed)
    link = scene.link_names[-1]
    for frame in FRAMES:
        for given in ({"frame": frame}, {"frame": frame, "at": POINT}):
            velocity = scene.velocity_derivatives(q, qd, link, **given)
            assert_slope(velocity[0], slopes(scene, q, lambda q: scene.velocity(q, qd, link, **given)))
            assert_near(velocity[1], scene.jacobian(q, link, **given), product(scene.nv, size(velocity)))
            hessian = scene.jacobian_derivatives(q, link, **given)
            assert_slope(hessian, slopes(scene, q, lambda q: scene.jacobian(q, link, **given)))
            for kind in ("spatial", "classical"):
                found = scene.acceleration_derivatives(q, qd, qdd, link, kind=kind, **given)

                def acceleration(q: np.ndarray, qd: np.ndarray, kind: str = kind, given: Any = given) -> np.ndarray:
                    return scene.acceleration(q, qd, qdd, link, kind=kind, **given)

                assert_slope(found[0], slopes(scene, q, lambda q: acceleration(q, qd)))
                # Quadratic in qd, for which these differences are exact.
                by_qd = [slope_of_order_4(lambda h, unit=unit: acceleration(q, qd + h * unit), 0.1) for unit in np.eye(scene.nv)]
                assert_near(found[1], np.stack(by_qd, axis=-1), 100 * product(scene.nv, size(found)))
                assert_near(found[2], scene.jacobian(q, link, **given), product(scene.nv, size(found)))
                assert size(found[0]) > 0.1 and size(found[1]) > 0.1


@pytest.mark.parametrize("floating", [False, True])
def test_identities(floating: bool) -> None:
    """dJ qd is J', and the velocity is J qd: two products of one Hessian."""
    scene = random_scene(5, 9, floating_base=floating)
    q, qd, qdd = random_states(scene, 5)
    link = scene.link_names[-2]
    for frame in FRAMES:
        given = {"frame": frame, "at": POINT}
        hessian = scene.jacobian_derivatives(q, link, **given)
        bound = product(scene.nv, size(hessian) * size(qd)) * scene.nv
        assert_near(hessian @ qd, scene.jacobian_rate(q, qd, link, **given), bound)
        by_q = scene.velocity_derivatives(q, qd, link, **given)[0]
        assert_near(np.einsum("ijk,j->ik", hessian, qd), by_q, bound)
        if frame != "local-world-aligned":
            by_qd = scene.acceleration_derivatives(q, qd, qdd, link, **given)[1]
            assert_near(by_qd, scene.jacobian_rate(q, qd, link, **given) + by_q, bound)


@pytest.mark.parametrize("robot", ROBOTS)
def test_as_pinocchio(robot: str) -> None:
    file, floating = ROBOTS[robot]
    scene, _ = load(file, floating)
    oracle = Oracle(file, floating, scene)
    model, data, n = oracle.model, oracle.data, scene.nv
    random = np.random.default_rng(1)
    q = scene.integrate(scene.neutral(), random.uniform(-2.0, 2.0, n))
    qd, qdd = random.uniform(-2.0, 2.0, (2, n))
    there = oracle.configuration(q), oracle.there(qd), oracle.there(qdd)
    link = max(scene.link_names, key=lambda name: int(scene.jacobian(q, name).any(axis=0).sum()))
    index = oracle.frame(link)
    pin.computeForwardKinematicsDerivatives(model, data, *there)
    pin.computeJointKinematicHessians(model, data, there[0])
    pin.updateFramePlacements(model, data)
    for name, frame in FRAMES.items():
        given = {"frame": name}
        jacobian = scene.jacobian(q, link, **given)

        def at_moving_origin(by_q: np.ndarray, motion: np.ndarray, name: str = name, jacobian: np.ndarray = jacobian) -> np.ndarray:
            """Pinocchio's derivative in LOCAL_WORLD_ALIGNED is that at a fixed point; its own velocity is at the origin, which moves."""
            if name == "local-world-aligned":
                by_q[3:] += np.cross(motion[:3], jacobian[3:].T).T
            return by_q

        expected = np.stack([oracle.here(part)[SWAP] for part in pin.getFrameVelocityDerivatives(model, data, index, frame)])
        at_moving_origin(expected[0], scene.velocity(q, qd, link, **given))
        assert_near(scene.velocity_derivatives(q, qd, link, **given), expected, recursion(n, size(expected)))
        parts = pin.getFrameAccelerationDerivatives(model, data, index, frame)
        # The first is dv/dq.
        expected = np.stack([oracle.here(part)[SWAP] for part in parts[1:]])
        at_moving_origin(expected[0], scene.acceleration(q, qd, qdd, link, **given))
        found = scene.acceleration_derivatives(q, qd, qdd, link, **given)
        assert_near(found, expected, recursion(n, size(expected)))
        assert size(expected) > 1.0
    for name, frame in FRAMES.items():
        # The numbers of Pinocchio's array are column by column, its strides are not.
        hessian = np.ravel(pin.getFrameKinematicHessian(model, data, index, frame)).reshape(6, n, n, order="F")
        expected = hessian[np.ix_(SWAP, oracle.v_order, oracle.v_order)]
        assert_near(scene.jacobian_derivatives(q, link, frame=name), expected, recursion(n, size(expected)))
    by_q, *_ = pin.computeCentroidalDynamicsDerivatives(model, data, *there)
    found = scene.centroidal_momentum_derivatives(q, qd)
    expected = oracle.here(by_q)[SWAP]
    assert_near(found[0], expected, recursion(n, size(expected, oracle.mass)))
    assert_near(found[1], scene.centroidal_momentum_matrix(q), recursion(n, oracle.mass))


@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_the_momentum_as_differences(seed: int, floating: bool) -> None:
    scene = random_scene(seed, 7, floating_base=floating)
    q, qd, _ = random_states(scene, seed)
    by_q, by_qd = scene.centroidal_momentum_derivatives(q, qd)
    assert_slope(by_q, slopes(scene, q, lambda q: scene.centroidal_momentum_matrix(q) @ qd))
    assert_near(by_qd, scene.centroidal_momentum_matrix(q), product(scene.nv, size(by_qd)))
    assert size(by_q) > 0.1


def test_at_rest_only_the_jacobian_is_left(arm: phipsi.Scene) -> None:
    q, still = np.full(arm.nq, 0.3), np.zeros(arm.nv)
    by_q, jacobian = arm.velocity_derivatives(q, still, "link6")
    assert not by_q.any() and jacobian.any()
    found = arm.acceleration_derivatives(q, still, still, "link6", kind="classical")
    assert not found[:2].any() and np.array_equal(found[2], jacobian)
    assert not arm.velocity_derivatives(q, still, arm.link_names[0])[1].any()


def test_far_from_the_origin_no_digits_are_lost() -> None:
    scene = random_scene(2, 9, floating_base=True, kinds=("revolute", "prismatic", "spherical"))
    q, qd, qdd = random_states(scene, 1)
    away = q.copy()
    away[:3] += 1e6
    link = scene.link_names[-1]
    for call in (
        lambda q: scene.centroidal_momentum_derivatives(q, qd),
        lambda q: scene.acceleration_derivatives(q, qd, qdd, link, frame="local-world-aligned", at=POINT, kind="classical"),
        lambda q: scene.jacobian_derivatives(q, link),
    ):
        expected = call(q)
        assert_near(call(away), expected, product(1, size(expected)))


BROKEN: dict[str, tuple[str, tuple[Any, ...], type[Exception], str]] = {
    "link": ("jacobian_derivatives", ("hand",), ArgumentError, 'link: found "hand"; expected one of'),
    "qd": ("velocity_derivatives", (np.zeros(6), "link6"), ShapeError, "qd: found shape"),
    "qdd": ("acceleration_derivatives", (np.zeros(7), np.zeros(6), "link6"), ShapeError, "qdd: found shape"),
    "momentum": ("centroidal_momentum_derivatives", (np.zeros(6),), ShapeError, "qd: found shape"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_arguments(arm: phipsi.Scene, case: str) -> None:
    method, rest, error, message = BROKEN[case]
    with pytest.raises(error, match=message):
        getattr(arm, method)(np.zeros(7), *rest)


@pytest.mark.parametrize("seed", range(4))
def test_joints_that_follow_others(seed: int) -> None:
    """Beside differences along the independent coordinates; batches are their states."""
    case = Case(seed)
    scene, q, qd, qdd = case.scene, case.q, case.qd, case.qdd
    assert scene.nv < case.free.nv
    q, qd, qdd = (np.stack([x, y]) for x, y in ((q, scene.integrate(q, qd)), (qd, qdd), (qdd, qd)))
    link = list(case.follows)[-1]
    link = next(joint.child for joint in case.tree.joints if joint.name == link)
    given: dict[str, Any] = {"frame": "world", "at": POINT}
    velocity = scene.velocity_derivatives(q, qd, link, **given)
    acceleration = scene.acceleration_derivatives(q, qd, qdd, link, **given)
    hessian = scene.jacobian_derivatives(q, link, **given)
    momentum = scene.centroidal_momentum_derivatives(q, qd)
    for i in range(2):
        v, a = qd[i], qdd[i]
        assert_slope(velocity[i, 0], slopes(scene, q[i], lambda q, v=v: scene.velocity(q, v, link, **given)))
        assert_near(velocity[i, 1], scene.jacobian(q[i], link, **given), product(case.free.nv, size(velocity)))
        assert_slope(acceleration[i, 0], slopes(scene, q[i], lambda q, v=v, a=a: scene.acceleration(q, v, a, link, **given)))
        assert_near(acceleration[i, 2], velocity[i, 1], product(case.free.nv, size(velocity)))
        assert_slope(hessian[i], slopes(scene, q[i], lambda q: scene.jacobian(q, link, **given)))
        assert_slope(momentum[i, 0], slopes(scene, q[i], lambda q, v=v: scene.centroidal_momentum_matrix(q) @ v))
        bound = product(case.free.nv, size(momentum))
        assert_near(momentum[i, 1], scene.centroidal_momentum_matrix(q[i]), bound)
        assert_near(scene.centroidal_momentum_derivatives(q[i], v), momentum[i], bound)
        assert_near(scene.jacobian_derivatives(q[i], link, **given), hessian[i], product(case.free.nv, size(hessian)))
    assert size(hessian) > 0.1
