"""The axis of bodies: its entries are the links of Scene.body_names in all arguments and results, also with joints
that follow others.
"""

from __future__ import annotations

import numpy as np
import phipsi
import pytest
from phipsi.errors import ShapeError
from tolerances import STEP, assert_near, central_difference, size


def gripper() -> phipsi.Scene:
    """Two joints, and one that follows on another branch, between them in the order of the file."""
    builder = phipsi.SceneBuilder().link("base")
    for name, parent, ratio in (("palm", "base", None), ("left", "palm", None), ("right", "palm", -0.7), ("tip", "left", None)):
        builder.link(name, 1.0, (0.1, 0.02, 0.2), np.diag([0.03, 0.04, 0.02]))
        how = {"mimic": "left", "mimic_multiplier": ratio} if ratio else {}
        builder.joint(name, "revolute", parent, name, xyz=(0.1, 0.0, 0.3), axis=(0, 1, 0.3), **how)
    return builder.build(mimic="couple")


def heavier(scene: phipsi.Scene, name: str, by: float) -> phipsi.Scene:
    link = scene.link(name)
    return scene.with_inertias({name: (link.mass * (1.0 + by), link.com, link.inertia * (1.0 + by))})


def test_names_of_bodies_are_those_of_the_rows_of_parameters() -> None:
    scene = gripper()
    assert scene.joint_names == ("palm", "left", "tip")
    assert scene.body_names == ("palm", "left", "tip", "right")
    q, qd, weights = np.array([0.3, 0.5, -0.2]), np.array([0.5, -1.0, 0.2]), np.array([1.0, 2.0, -0.5])

    def end(robot: phipsi.Scene) -> float:
        return float(weights @ robot.simulate(q, qd, dt=1e-3, steps=40, method="rk4").q[-1])

    path = scene.simulate(q, qd, dt=1e-3, steps=40, method="rk4")
    bar = np.zeros_like(path.qd)
    bar[-1] = weights
    found = path.vjp(bar, parameters=True).parameters
    assert found is not None and len(found) == len(scene.body_names)
    sizes = []
    for name, row in zip(scene.body_names, found, strict=True):
        link = scene.link(name)
        about = link.inertia + link.mass * (link.com @ link.com * np.eye(3) - np.outer(link.com, link.com))
        own = np.array([link.mass, *(link.mass * link.com), about[0, 0], about[0, 1], about[1, 1], about[0, 2], about[1, 2], about[2, 2]])
        h = STEP
        expected = (end(heavier(scene, name, h)) - end(heavier(scene, name, -h))) / (2.0 * h)
        assert_near(row @ own, expected, central_difference(10.0 * size(q)))
        sizes.append(abs(expected))
    # No two rows can be exchanged unnoticed.
    assert np.min(np.abs(np.diff(np.sort(sizes)))) > 100.0 * central_difference(10.0)


@pytest.mark.parametrize("shape", [(2, 10), (3, 10), (4, 10)])
def test_arguments_by_bodies_have_the_same_rows(shape: tuple[int, ...]) -> None:
    scene, zero = gripper(), np.zeros(3)
    fits = shape[0] == len(scene.body_names)
    product = lambda changes: scene.inverse_dynamics_jvp(zero, zero, zero, zero, zero, zero, dparameters=changes)  # noqa: E731
    if not fits:
        with pytest.raises(ShapeError, match=r"expected \(..., 4, 10\)"):
            product(np.zeros(shape))
    if fits:
        assert not scene.inverse_dynamics_variance(zero, zero, zero, parameters=np.zeros((*shape, 10))).any()
        for row, name in enumerate(scene.body_names):
            changes = np.zeros(shape)
            changes[row] = scene.inertial_parameters[row]
            ends = [heavier(scene, name, h).inverse_dynamics(zero, zero, zero) for h in (STEP, -STEP)]
            assert np.max(np.abs(product(changes))) > 0.1
            assert_near(product(changes), (ends[0] - ends[1]) / (2.0 * STEP), central_difference(size(ends[0])))
        return
    with pytest.raises(ShapeError, match=r"expected \(4, 10, 10\)"):
        scene.inverse_dynamics_variance(zero, zero, zero, parameters=np.zeros((*shape, 10)))
