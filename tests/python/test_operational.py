"""Operational space: the inverse inertia of frames compared with dense algebra and with the effect of forces, and its
inverse.
"""

from __future__ import annotations

import math
import pickle
import re
from typing import Any

import numpy as np
import pytest
from conftest import random_rotation, random_scene, random_states
from tolerances import assert_near, assert_same_bits, inverse, size

import phipsi
from phipsi.errors import (
    ArgumentError,
    NotFiniteError,
    PhipsiError,
    ShapeError,
    SingularJointError,
    SingularTaskError,
)


def stacked(scene: phipsi.Scene, q: np.ndarray, links: list[str], xyz: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """The Jacobians of task frames, stacked: w' = R^T w and v' = R^T (v + w x l)."""
    rows = []
    for link, lever, turn in zip(links, xyz, rotation, strict=True):
        own = scene.jacobian(q, link)
        angular = own[:3]
        linear = own[3:] + np.cross(angular, lever, axisa=0, axisb=0, axisc=0)
        rows += [turn.T @ angular, turn.T @ linear]
    return np.concatenate(rows)


def random_task(scene: phipsi.Scene, seed: int, count: int) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Links, possibly repeated, and a frame on each."""
    random = np.random.default_rng(seed)
    links = [scene.link_names[i] for i in random.integers(len(scene.link_names), size=count)]
    return links, random.normal(size=(count, 3)), np.stack([random_rotation(random) for _ in range(count)])


def bound(scene: phipsi.Scene, q: np.ndarray, jacobian: np.ndarray) -> float:
    mass = scene.mass_matrix(q)
    reach = size(float(np.sum(jacobian**2)))
    return inverse(float(np.linalg.cond(mass)), reach / float(np.linalg.eigvalsh(mass)[0]))


@pytest.mark.parametrize("fixture", ["mixed", "floating", "arm"])
@pytest.mark.parametrize("count", [1, 2, 4])
def test_frames_match_dense_algebra(fixture: str, count: int, request: pytest.FixtureRequest) -> None:
    scene = request.getfixturevalue(fixture)
    for seed in range(5):
        q = random_states(scene, seed).q
        links, xyz, rotation = random_task(scene, 10 * seed + count, count)
        jacobian = stacked(scene, q, links, xyz, rotation)
        exact = jacobian @ np.linalg.solve(scene.mass_matrix(q), jacobian.T)
        found = scene.operational_inverse_inertia(q, links, at=xyz, rotation=rotation)
        assert_near(found, exact, bound(scene, q, jacobian))
        assert_same_bits(found, found.T)


def test_a_bare_name_is_the_link_s_own_frame(mixed: phipsi.Scene) -> None:
    q = random_states(mixed, 3).q
    link = mixed.body_names[-1]
    own = mixed.operational_inverse_inertia(q, link)
    assert own.shape == (6, 6)
    assert_same_bits(own, mixed.operational_inverse_inertia(q, [link]))
    assert_same_bits(own, mixed.operational_inverse_inertia(q, (link,), at=np.zeros(3), rotation=np.eye(3)))
    jacobian = mixed.jacobian(q, link)
    assert_near(own, jacobian @ np.linalg.solve(mixed.mass_matrix(q), jacobian.T), bound(mixed, q, jacobian))


def test_one_frame_serves_all_links(arm: phipsi.Scene) -> None:
    q = random_states(arm, 4).q
    links, xyz, rotation = ["link2", "link6"], np.array([0.1, 0.2, 0.3]), random_rotation(np.random.default_rng(1))
    shared = arm.operational_inverse_inertia(q, links, at=xyz, rotation=rotation)
    each = arm.operational_inverse_inertia(q, links, at=[xyz, xyz], rotation=[rotation, rotation])
    assert_same_bits(shared, each)
    # The frame has an effect, and so has each of its parts.
    for other in ({}, {"at": xyz}, {"rotation": rotation}):
        assert np.max(np.abs(shared - arm.operational_inverse_inertia(q, links, **other))) > 1e-3 * np.max(np.abs(shared))


def test_the_same_link_twice_repeats_blocks(arm: phipsi.Scene) -> None:
    q = random_states(arm, 5).q
    once = arm.operational_inverse_inertia(q, "link4")
    twice = arm.operational_inverse_inertia(q, ["link4", "link4"])
    assert_near(twice, np.tile(once, (2, 2)), inverse(1.0, size(once)))
    with pytest.raises(SingularTaskError) as found:
        arm.operational_inertia(q, ["link4", "link4"])
    assert (found.value.rank, found.value.directions, found.value.links) == (5, 12, ("link4", "link4"))


def test_batches_broadcast_and_are_states_in_turn(mixed: phipsi.Scene) -> None:
    q = random_states(mixed, 6, (3, 2)).q
    links, xyz, rotation = random_task(mixed, 7, 3)
    found = mixed.operational_inverse_inertia(q, links, at=xyz, rotation=rotation)
    assert found.shape == (3, 2, 18, 18)
    # Two directions in which the end of the tree moves independently.
    link = mixed.body_names[-1]
    directions = np.random.default_rng(8).normal(size=(2, 6))
    inertia = mixed.operational_inertia(q, link, directions=directions)
    assert inertia.shape == (3, 2, 2, 2)
    for at in np.ndindex(3, 2):
        assert_same_bits(found[at], mixed.operational_inverse_inertia(q[at], links, at=xyz, rotation=rotation))
        assert_same_bits(inertia[at], mixed.operational_inertia(q[at], link, directions=directions))


def test_large_batches_on_threads_give_the_same_bits(arm: phipsi.Scene) -> None:
    q = random_states(arm, 9, (500,)).q
    found = arm.operational_inverse_inertia(q, ["link3", "link6"])
    for at in (0, 123, 499):
        assert_same_bits(found[at], arm.operational_inverse_inertia(q[at], ["link3", "link6"]))


@pytest.mark.parametrize("batch", [(0,), (2, 0)])
def test_empty_batches(arm: phipsi.Scene, batch: tuple[int, ...]) -> None:
    q = np.zeros((*batch, 7))
    assert arm.operational_inverse_inertia(q, ["link1", "link2"]).shape == (*batch, 12, 12)
    assert arm.operational_inertia(q, "link1", directions=np.eye(6)[:2]).shape == (*batch, 2, 2)
    with pytest.raises(ArgumentError, match="link: found"):
        arm.operational_inverse_inertia(q, "hand")


def test_nothing_moves_without_joints(welded: phipsi.Scene) -> None:
    assert_same_bits(welded.operational_inverse_inertia(np.zeros(0), "mast"), np.zeros((6, 6)))
    with pytest.raises(SingularTaskError) as found:
        welded.operational_inertia(np.zeros(0), "mast")
    assert found.value.rank == 0


@pytest.mark.parametrize("fixture", ["mixed", "floating", "arm"])
def test_a_wrench_accelerates_frames_by_the_inverse_inertia(fixture: str, request: pytest.FixtureRequest) -> None:
    """A wrench on one link changes the accelerations of that link and of another one by Omega w."""
    scene = request.getfixturevalue(fixture)
    random = np.random.default_rng(11)
    live = 0
    for seed in range(8):
        q, qd, tau = random_states(scene, 20 + seed)
        pushed, watched = (scene.link_names[i] for i in random.integers(1, len(scene.link_names), size=2))
        wrench = random.normal(size=6)
        free = scene.forward_dynamics(q, qd, tau)
        change = scene.forward_dynamics(q, qd, tau, wrenches={pushed: wrench}) - free
        omega = scene.operational_inverse_inertia(q, [pushed, watched])
        for rows, link in ((omega[:6], pushed), (omega[6:], watched)):
            jacobian = scene.jacobian(q, link)
            expected = rows[:, :6] @ wrench
            # The subtracted accelerations are larger than their difference.
            scale = size(np.max(np.abs(free))) * size(np.sum(np.abs(jacobian)))
            both = np.concatenate([jacobian, scene.jacobian(q, pushed)])
            tolerance = inverse(float(np.linalg.cond(scene.mass_matrix(q))), scale) + bound(scene, q, both) * size(wrench)
            assert_near(jacobian @ change, expected, tolerance)
            live += bool(np.max(np.abs(expected)) > 1e4 * tolerance)
    assert live >= 4


def test_at_rest_and_balanced_the_wrench_is_all_there_is(arm: phipsi.Scene) -> None:
    q = random_states(arm, 30).q
    still, wrench = np.zeros(7), np.array([0.3, -0.2, 0.1, 2.0, -1.0, 3.0])
    qdd = arm.forward_dynamics(q, still, arm.bias_torque(q, still), wrenches={"link6": wrench})
    jacobian = arm.jacobian(q, "link6")
    assert_near(
        jacobian @ qdd, arm.operational_inverse_inertia(q, "link6") @ wrench, bound(arm, q, jacobian) * size(wrench) * 10
    )


def test_the_inertia_is_the_inverse(arm: phipsi.Scene) -> None:
    q = random_states(arm, 40, (6,)).q
    links, xyz, rotation = ["link6"], np.array([[0.1, 0.0, 0.3]]), random_rotation(np.random.default_rng(2))[None]
    omega = arm.operational_inverse_inertia(q, links, at=xyz, rotation=rotation)
    directions = np.random.default_rng(41).normal(size=(4, 6))
    for s, found in (
        (np.eye(6), arm.operational_inertia(q, links, at=xyz, rotation=rotation)),
        (directions, arm.operational_inertia(q, links, at=xyz, rotation=rotation, directions=directions)),
    ):
        for one, other in zip(found, omega, strict=True):
            product = s @ other @ s.T
            assert_same_bits(one, one.T)
            assert np.all(np.linalg.eigvalsh(one) > 0)
            assert_near(one @ product, np.eye(len(s)), inverse(float(np.linalg.cond(product)), 1.0))


def planar() -> phipsi.Scene:
    """Three links of a meter, in a plane."""
    builder = phipsi.SceneBuilder().link("base")
    for k in range(3):
        builder.link(f"link{k}", 1.0, (0.5, 0, 0), np.eye(3) * 0.1)
        builder.joint(f"joint{k}", "revolute", f"link{k - 1}" if k else "base", f"link{k}", xyz=(1.0 * (k > 0), 0, 0))
    return builder.link("tool").joint("weld", "fixed", "link2", "tool", xyz=(1, 0, 0)).build()


IN_PLANE = np.eye(6)[[2, 3, 4]]


def test_a_stretched_arm_is_singular_along_itself() -> None:
    scene = planar()
    bent, stretched = np.array([0.3, 0.5, -0.7]), np.array([0.3, 0.0, 0.0])
    assert scene.operational_inertia(bent, "tool", directions=IN_PLANE).shape == (3, 3)
    # The inverse inertia exists, and the link does not move in that direction.
    omega = scene.operational_inverse_inertia(stretched, "tool")
    assert abs(omega[3, 3]) <= inverse(1.0, 1.0) < omega[4, 4]
    q = np.stack([bent, bent, stretched, bent]).reshape(2, 2, 3)
    with pytest.raises(SingularTaskError, match=r'task of link "tool" in state 2: found an inverse inertia of rank 2') as found:
        scene.operational_inertia(q, "tool", directions=IN_PLANE)
    error = found.value
    assert isinstance(error, PhipsiError) and isinstance(error, ArithmeticError)
    assert (error.links, error.rank, error.directions, error.state) == (("tool",), 2, 3, (1, 0))
    assert "operational_inverse_inertia" in str(error) and "remove directions" in str(error)
    # Without the dependent direction the inertia exists.
    assert scene.operational_inertia(q, "tool", directions=IN_PLANE[[0, 2]]).shape == (2, 2, 2, 2)
    with pytest.raises(SingularTaskError) as found:
        scene.operational_inertia(stretched, ["tool"], directions=IN_PLANE)
    assert found.value.state is None


def test_directions_that_depend_on_each_other_are_singular(arm: phipsi.Scene) -> None:
    q = random_states(arm, 50).q
    for directions in (np.ones((2, 6)), np.zeros((1, 6)), np.vstack([np.eye(6), np.ones(6)])):
        with pytest.raises(SingularTaskError) as found:
            arm.operational_inertia(q, "link6", directions=directions)
        assert found.value.rank == np.linalg.matrix_rank(directions)
        assert found.value.directions == len(directions)


def test_a_joint_without_inertia_is_told() -> None:
    builder = phipsi.SceneBuilder().link("base").link("needle").joint("tip", "revolute", "base", "needle")
    with pytest.raises(SingularJointError, match='"tip"'):
        builder.build().operational_inverse_inertia([0.1], "needle")


def test_pickled_errors_keep_their_words() -> None:
    with pytest.raises(SingularTaskError) as found:
        planar().operational_inertia(np.zeros(3), "tool", directions=IN_PLANE)
    again = pickle.loads(pickle.dumps(found.value))
    assert (again.rank, again.links, str(again)) == (2, ("tool",), str(found.value))


def inertia(scene: phipsi.Scene, **replaced: Any) -> np.ndarray:
    valid = {"q": np.full(7, 0.3), "links": ["link3", "link6"], "directions": np.eye(12)[[5, 11]]}
    return scene.operational_inertia(**(valid | replaced))


def test_the_call_is_valid(arm: phipsi.Scene) -> None:
    assert np.isfinite(inertia(arm)).all()
    assert np.isfinite(inertia(arm, at=np.ones((2, 3)), rotation=np.eye(3))).all()
    assert np.isfinite(inertia(arm, links=(name for name in ("link3", "link6")))).all()


ROTATION = np.array([[math.cos(0.5), -math.sin(0.5), 0], [math.sin(0.5), math.cos(0.5), 0], [0, 0, 1]])

BROKEN: dict[str, tuple[dict[str, Any], type[Exception], str]] = {
    "q": ({"q": np.zeros(6)}, ShapeError, "q: found shape (6,); expected (..., 7)"),
    "q NaN": ({"q": [math.nan] * 7}, NotFiniteError, "q: found NaN at index 0"),
    "links a number": ({"links": 3}, ArgumentError, "links: found 3; expected the name of a link, or a sequence of names"),
    "links of numbers": ({"links": ["link1", 3]}, ArgumentError, "links: found ['link1', 3]; expected the name of a link"),
    "unknown link": ({"links": ["link3", "hand"]}, ArgumentError, 'link: found "hand"; expected one of "base"'),
    "no link": ({"links": []}, ArgumentError, "links: found none; expected at least one link"),
    "the former name": ({"xyz": [1.0, 2.0, 3.0]}, ArgumentError, "xyz: found a value; expected at, the present name"),
    "at too short": ({"at": [1.0, 2.0]}, ShapeError, "at: found shape (2,); expected (3,) or (2, 3)"),
    "at of three links": ({"at": np.zeros((3, 3))}, ShapeError, "at: found shape (3, 3); expected (3,) or (2, 3)"),
    "at text": ({"at": "far"}, ArgumentError, "at: found dtype"),
    "at NaN": (
        {"at": [0, 0, math.inf]},
        NotFiniteError,
        'xyz of the task frame on link "link3": found inf at index 2; expected finite numbers',
    ),
    "rotation flat": ({"rotation": np.eye(3)[0]}, ShapeError, "rotation: found shape (3,); expected (3, 3) or (2, 3, 3)"),
    "rotation of one": (
        {"rotation": np.eye(3)[None]},
        ShapeError,
        "rotation: found shape (1, 3, 3); expected (3, 3) or (2, 3, 3)",
    ),
    "rotation scaled": (
        {"rotation": [np.eye(3), ROTATION * (1 + 1e-8)]},
        ArgumentError,
        'rotation of the task frame on link "link6": found a matrix R for which R^T R differs from the identity by 2.0e-8',
    ),
    "rotation mirrored": (
        {"rotation": np.diag([1, 1, -1])},
        ArgumentError,
        'rotation of the task frame on link "link3": found a reflection (determinant -1); expected a rotation matrix',
    ),
    "rotation NaN": (
        {"rotation": np.where(np.eye(3, k=1) > 0, np.nan, np.eye(3))},
        NotFiniteError,
        'rotation of the task frame on link "link3": found NaN at index 1',
    ),
    "directions of one link": (
        {"directions": np.eye(6)},
        ShapeError,
        "directions: found shape (6, 6); expected (k, 12), k at least 1",
    ),
    "directions flat": ({"directions": np.ones(12)}, ShapeError, "directions: found shape (12,); expected (k, 12)"),
    "no directions": ({"directions": np.zeros((0, 12))}, ShapeError, "directions: found shape (0, 12); expected (k, 12)"),
    "directions NaN": ({"directions": np.full((1, 12), math.nan)}, NotFiniteError, "directions: found NaN at index 0"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_one_broken_argument(arm: phipsi.Scene, case: str) -> None:
    replaced, error, message = BROKEN[case]
    with pytest.raises(error, match=re.escape(message)):
        inertia(arm, **replaced)
    if "directions" not in replaced:
        arguments = {"q": np.full(7, 0.3), "links": ["link3", "link6"]} | replaced
        with pytest.raises(error, match=re.escape(message)):
            arm.operational_inverse_inertia(**arguments)


def test_the_check_has_a_residual_of_operational_space(mixed: phipsi.Scene) -> None:
    q = random_states(mixed, 60).q
    residuals = {name: value for name, value in mixed.check(q).items() if "operational space" in name}
    assert len(residuals) == 1
    condition = float(np.linalg.cond(mixed.mass_matrix(q)))
    assert all(0 < value <= inverse(condition, 1.0) for value in residuals.values())
