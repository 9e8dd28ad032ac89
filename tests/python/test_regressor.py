"""Scene.regressor: torques are linear in the parameters; as the definition and as Pinocchio's."""

from __future__ import annotations

import numpy as np
import pytest
from test_identify import arm, like, states
from tolerances import assert_near, recursion, size

import phipsi
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError
from phipsi.estimation._base import combinations
from phipsi.estimation._columns import Columns


def mixed() -> phipsi.Scene:
    """A tree with joints of all kinds on a floating base."""
    draw = np.random.default_rng(3)
    builder = phipsi.SceneBuilder().link("base", 2.0, (0.1, 0.0, 0.0), 0.1 * np.eye(3))
    parents = ["base", "base", "a", "a", "c", "d"]
    kinds = ["revolute", "spherical", "prismatic", "revolute", "planar", "continuous"]
    for name, parent, kind in zip("abcdef", parents, kinds, strict=True):
        axes, _ = np.linalg.qr(draw.standard_normal((3, 3)))
        builder.link(name, draw.uniform(1, 2), draw.uniform(-0.1, 0.1, 3), axes @ np.diag(draw.uniform(0.02, 0.03, 3)) @ axes.T)
        axis = {} if kind == "spherical" else {"axis": draw.standard_normal(3)}
        builder.joint(f"to_{name}", kind, parent, name, xyz=draw.uniform(-0.3, 0.3, 3), rpy=draw.uniform(-1, 1, 3), **axis)
    return builder.build(floating_base=True)


SCENES = {"arm": lambda: arm(2), "floating": lambda: arm(3, base=True), "mixed": mixed, "chain": lambda: phipsi.scenes.chain(7)}


def moving(scene: phipsi.Scene, count: int) -> tuple[np.ndarray, ...]:
    draw = np.random.default_rng(1)
    q = scene.integrate(np.broadcast_to(scene.neutral(), (count, scene.nq)), draw.uniform(-1, 1, (count, scene.nv)))
    qd, qdd = draw.uniform(-1, 1, (2, count, scene.nv))
    return q, qd, qdd


@pytest.mark.parametrize("kind", SCENES)
def test_torques_are_the_regressor_times_the_parameters(kind: str) -> None:
    """Of this robot, and of another one with the same joints: Y does not depend on the parameters."""
    scene = SCENES[kind]()
    given = moving(scene, 4)
    rows = scene.regressor(*given)
    assert rows.shape == (4, scene.nv, len(scene.body_names), 10)
    for robot in (scene, like(scene, 5)):
        tau = robot.with_properties(armature=0.0).inverse_dynamics(*given)
        assert_near(np.einsum("kibp,bp->ki", rows, robot.inertial_parameters), tau, 4 * recursion(scene.nv, size(tau)))


def test_entries_are_zero_where_the_link_is_not_outboard() -> None:
    scene = mixed()
    rows = scene.regressor(*moving(scene, 1))[0]
    at = {name: place for place, name in enumerate(scene.body_names)}
    for joint, outboard in {"to_a": "acdef", "to_b": "b", "to_c": "ce", "to_f": "f"}.items():
        of = rows[scene.v_index(joint)]
        for link in "abcdef":
            assert np.any(of[:, at[link]] != 0.0) == (link in outboard), (joint, link)


def test_as_pinocchios() -> None:
    pin = pytest.importorskip("pinocchio")
    scene = arm(4)
    model = pin.buildModelFromXML(scene.to_urdf())
    q, qd, qdd = states(scene, 3)
    # Continuous joints are (cos, sin) there.
    found = scene.regressor(q, qd, qdd)
    data = model.createData()
    order = [model.getJointId(name) - 1 for name in scene.joint_names]
    for k in range(3):
        configuration = np.concatenate([[np.cos(a), np.sin(a)] for a in q[k]]) if model.nq == 12 else q[k]
        theirs = pin.computeJointTorqueRegressor(model, data, configuration, qd[k], qdd[k]).reshape(6, 6, 10)[:, order]
        assert_near(found[k], theirs, recursion(6, 10 * size(theirs)))


@pytest.mark.parametrize("kind", ["bundled", "arm", "floating"])
def test_base_parameters_are_the_rank_of_pinocchios_regressor(kind: str) -> None:
    """And torques are those of the base parameters alone. benches/estimation.py has larger robots."""
    pin = pytest.importorskip("pinocchio")
    scene = {"bundled": lambda: phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM), "arm": lambda: arm(4), "floating": lambda: arm(5, 4, base=True)}[kind]()
    floating = kind == "floating"
    text = scene.to_urdf()
    model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer()) if floating else pin.buildModelFromXML(text)
    data, draw = model.createData(), np.random.default_rng(0)
    drawn = [(pin.integrate(model, pin.neutral(model), draw.uniform(-2, 2, model.nv)), *draw.standard_normal((2, model.nv))) for _ in range(40)]
    stacked = np.concatenate([pin.computeJointTorqueRegressor(model, data, *state).copy() for state in drawn])
    singular = np.linalg.svd(stacked / np.maximum(np.linalg.norm(stacked, axis=0), 1e-12), compute_uv=False)
    found = combinations(Columns(scene))
    assert len(found.columns) == np.sum(singular > 1e-6 * singular[0])
    given = moving(scene, 10)
    tau = scene.with_properties(armature=0.0).inverse_dynamics(*given)
    columns = scene.regressor(*given).reshape(10, scene.nv, -1)[:, :, found.columns]
    assert_near(columns @ (found.matrix @ scene.inertial_parameters.ravel()), tau, 1e-9 * size(tau))


def test_batches_broadcast_and_are_those_of_single_states() -> None:
    scene = arm(6)
    q, qd, qdd = states(scene, 5)
    whole = scene.regressor(q[:, None], qd, qdd)
    assert whole.shape == (5, 5, 6, 6, 10)
    for i, j in ((0, 0), (3, 1), (4, 4)):
        np.testing.assert_array_equal(whole[i, j], scene.regressor(q[i], qd[j], qdd[j]))


def test_bad_arguments() -> None:
    scene = arm(7)
    q, qd, qdd = states(scene, 2)
    with pytest.raises(ShapeError, match=r"qd: found shape \(2, 5\)"):
        scene.regressor(q, qd[:, :5], qdd)
    qdd[1, 2] = np.nan
    with pytest.raises(NotFiniteError, match="qdd"):
        scene.regressor(q, qd, qdd)
    assert np.isnan(scene.regressor(q, qd, np.where(np.isnan(qdd), 1.0, qdd), errors="nan")).sum() == 0
    with pytest.raises(ArgumentError, match="errors"):
        scene.regressor(q, qd, qd, errors="ignore")
