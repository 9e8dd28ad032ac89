"""Host functions of phipsi.jax and phipsi.torch: derivatives with respect to the entries of q, including quaternions of
any norm.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from tolerances import EPS, assert_near, product, size

import phipsi
from phipsi import _calls, tasks
from phipsi._chart import skew
from phipsi._coordinates import Coordinates, right_jacobian, rotation_vector
from phipsi.errors import ArgumentError, ShapeError

#: Step of differences of fourth order, and their error for a function of similar magnitude: rounding relative to the
#: step, and truncation.
STEP = 2e-3
LEFT = 64.0 * EPS / STEP + 64.0 * STEP**4


def floating() -> phipsi.Scene:
    """A floating body with a spherical joint, a prismatic joint and a hinge."""
    builder = phipsi.SceneBuilder()
    for name in ("body", "ball", "slider", "arm"):
        builder.link(name, mass=1.3, com=(0.05, -0.02, 0.1), inertia=np.diag([0.2, 0.3, 0.25]))
    builder.joint("shoulder", "spherical", "body", "ball", xyz=(0.1, 0.0, 0.2))
    builder.joint("slide", "prismatic", "ball", "slider", xyz=(0.0, 0.1, 0.1), axis=(0.6, 0.0, 0.8))
    builder.joint("elbow", "revolute", "slider", "arm", xyz=(0.0, 0.0, 0.3), axis=(0, 1, 0))
    return builder.build(floating_base=True)


SCENES: dict[str, Callable[[], phipsi.Scene]] = {"chain": lambda: phipsi.scenes.chain(3), "floating": floating}
CALLS: dict[str, Callable[[phipsi.Scene], _calls.Call]] = {
    "forward_dynamics": lambda scene: _calls.forward_dynamics(scene, "auto"),
    "inverse_dynamics": _calls.inverse_dynamics,
    "integrate": _calls.integrate,
    "placement": lambda scene: _calls.placement(scene, scene.link_names[-1]),
    "jacobian": lambda scene: _calls.jacobian(scene, scene.link_names[-1]),
    "jacobian, world": lambda scene: _calls.jacobian(scene, scene.link_names[-1], "world"),
    "mass_matrix": _calls.mass_matrix,
    "center_of_mass": _calls.center_of_mass,
    "bias_torque": _calls.bias_torque,
    "task_residual": lambda scene: _calls.task_residual(scene, every_task(scene)),
}


def every_task(scene: phipsi.Scene) -> list[tasks.Task]:
    """Each kind of task with residuals, with points beside the origin and relative to another link."""
    goal = phipsi.pose((0.3, -0.2, 0.5), rpy=(0.4, -0.3, 1.2))
    first, last = scene.link_names[-2:]
    return [
        tasks.Pose(last, goal, at=(0.1, 0.2, 0.3)),
        tasks.Position(last, (0.1, 0.2, 0.3), at=(0.3, 0.0, -0.1)),
        tasks.Pose(last, goal, relative_to=first),
        tasks.Orientation(first, goal[:3, :3]),
        tasks.Direction(last, (0.1, -0.5, 0.3), axis=(0.6, 0.0, 0.8), relative_to=first),
        tasks.Direction(first, (0.1, 0.5, 0.3)),
        tasks.LookAt(last, (0.7, -1.1, 0.4), axis=(0, 1, 0), at=(0.1, 0.2, 0.3)),
        tasks.LookAt(last, (0.7, -1.1, 0.4), relative_to=first),
        tasks.CenterOfMass((0.1, 0.0, 0.2)),
        tasks.JointPosition(scene.joint_names[-1], 0.3),
    ]


def arguments(scene: phipsi.Scene, call: _calls.Call, turn: float = 1.0) -> list[np.ndarray]:
    random = np.random.default_rng(5)
    q = scene.integrate(scene.neutral(), random.uniform(-1, 1, scene.nv))
    return [q, *(random.uniform(-turn, turn, width) for width in call.widths[1:])]


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("norm", [1.0, 1.7])
def test_derivatives_are_differences(kind: str, name: str, norm: float) -> None:
    scene = SCENES[kind]()
    call = CALLS[name](scene)
    given = arguments(scene, call)
    for turn, _ in Coordinates(scene).turns:
        given[0][turn] *= norm
    value = call.value(*given)
    for which, found in enumerate(call.derivatives(*given)):
        columns = []
        for unit in np.eye(len(given[which])):
            ahead = [call.value(*given[:which], given[which] + h * STEP * unit, *given[which + 1 :]) for h in (1, -1, 2, -2)]
            columns.append((8 * (ahead[0] - ahead[1]) - (ahead[2] - ahead[3])) / (12 * STEP))
        assert_near(found, np.stack(columns, axis=-1), LEFT * (size(found) + size(value)) * size(found))


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("name", CALLS)
def test_batches_are_their_states(kind: str, name: str) -> None:
    scene = SCENES[kind]()
    call = CALLS[name](scene)
    given = arguments(scene, call)
    many = [np.stack([given[0]] * 3), *(np.stack([argument, -argument, 0.5 * argument]) for argument in given[1:])]
    for i in range(3):
        alone = call.derivatives(*(argument[i] for argument in many))
        for found, expected in zip(call.derivatives(*many), alone, strict=True):
            assert_near(found[i], expected, product(scene.nv, size(expected)))


def test_changes_and_tangents_are_inverses() -> None:
    scene = floating()
    q = arguments(scene, _calls.integrate(scene))[0]
    coordinates = Coordinates(scene)
    assert_near(coordinates.by_entries(q, np.eye(scene.nv)) @ coordinates.changes(q), np.eye(scene.nv), product(scene.nv, 1.0))


@pytest.mark.parametrize("angle", [0.0, 1e-8, 1e-3, 0.499999, 0.500001, 2.0, np.pi])
def test_either_way_to_the_right_jacobian_is_its_series(angle: float) -> None:
    """At the identity, at half a turn, and on both sides of the transition to the closed form."""
    axis = np.array([0.48, -0.6, 0.64])
    turning, moving = -skew(angle * axis), -skew(np.array([0.3, -1.1, 0.7]))
    bracket = np.block([[turning, moving], [np.zeros((3, 3)), turning]])
    series = power = np.eye(6)
    for i in range(2, 60):
        power = power @ bracket / i
        series = series + power
    assert_near(right_jacobian(bracket, np.asarray(angle)), series, product(60, np.exp(angle)))


@pytest.mark.parametrize("angle", [0.0, 1e-9, np.pi])
def test_a_step_that_turns_by_nothing_or_by_half_a_turn(angle: float) -> None:
    scene = floating()
    call = _calls.integrate(scene)
    q, v = arguments(scene, call)
    for _, angular in Coordinates(scene).turns:
        v[angular] *= angle / np.linalg.norm(v[angular])
    _, found = call.derivatives(q, v)
    columns = [(call.value(q, v + STEP * unit) - call.value(q, v - STEP * unit)) / (2 * STEP) for unit in np.eye(scene.nv)]
    assert_near(found, np.stack(columns, axis=-1), 8 * STEP**2 * size(found))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.0, np.pi - 1e-9, np.pi])
def test_rotation_vectors_are_logarithms(angle: float) -> None:
    """The exponential of the cross product matrix, by its series, is the rotation again."""
    vector = angle * np.array([0.48, -0.6, 0.64])
    turn = power = np.eye(3)
    for i in range(1, 40):
        power = power @ skew(vector) / i
        turn = turn + power
    found = rotation_vector(turn)
    # At half a turn both directions of the axis have the same rotation.
    assert_near(found if found @ vector >= 0.0 else -found, vector, product(40, np.exp(angle)))
    assert angle > 3.1 or found @ vector >= 0.0


def test_residuals_of_reached_tasks_are_zero() -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    q = np.array([0.3, -0.6, 0.9, 0.1, 0.4, 0.2])
    goal = scene.placement(q, "flange")
    wanted = [tasks.Pose("flange", goal), tasks.CenterOfMass(scene.center_of_mass(q)), tasks.JointPosition("joint2", -0.6)]
    assert_near(_calls.task_residual(scene, wanted).value(q), np.zeros(10), product(6, 1.0))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.0, np.pi - 1e-9, np.pi])
def test_residuals_of_directions_are_angles(angle: float) -> None:
    scene = phipsi.scenes.chain(2)
    q = np.array([0.4, angle])
    turn = scene.placement(q, "link1")[:3, :3]
    away = np.array([np.sin(angle), 0.0, np.cos(angle)])
    found = _calls.task_residual(scene, tasks.Direction("link1", 3.0 * turn @ away)).value(q)
    assert_near(np.linalg.norm(found), angle, product(8, np.pi))


def test_a_direction_without_length() -> None:
    with pytest.raises(ArgumentError, match="tasks.0..target: found an axis without direction"):
        _calls.task_residual(phipsi.scenes.chain(2), tasks.Direction("link1", (0, 0, 0)))


def test_a_task_with_a_batch_of_targets() -> None:
    with pytest.raises(ShapeError, match="expected the target of one state"):
        _calls.task_residual(phipsi.scenes.chain(2), tasks.Position("link1", np.zeros((5, 3))))
