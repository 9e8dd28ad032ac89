"""What a scene leaves out: switches by name, the same results with and without, and the plan that lists it."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import tolerances
from conftest import random_states

import phipsi
from phipsi.errors import ArgumentError
from phipsi.report import left_out, states
from phipsi.report.structure import tree_of

SWITCHES = ("fixed_joints", "base_links", "exact_zeros", "massless_bodies", "zero_velocity", "zero_gravity")


def builder() -> phipsi.SceneBuilder:
    """base - (column) - a: arm - (weld) - hand - b: sledge (planar), every link with mass."""
    builder = phipsi.SceneBuilder()
    for name in ("base", "column", "arm", "hand", "sledge"):
        builder.link(name, mass=1.5, com=(0.1, 0.2, -0.1), inertia=np.diag((0.2, 0.3, 0.25)))
    builder.joint("column", "fixed", "base", "column", xyz=(0, 0, 1))
    builder.joint("a", "revolute", "column", "arm", xyz=(0.2, 0, 0.1), rpy=(0.3, -0.2, 0.1), axis=(1, 2, 3))
    builder.joint("weld", "fixed", "arm", "hand", xyz=(0.3, 0.1, 0.0), rpy=(1.0, 0.5, 0.2))
    return builder.joint("b", "planar", "hand", "sledge", xyz=(0.0, 0.2, 0.3), axis=(0, 1, 1))


def but(switch: str) -> list[str]:
    return [name for name in SWITCHES if name != switch]


@pytest.mark.parametrize("leave_out", [*(but(switch) for switch in SWITCHES), [], set(SWITCHES)])
@pytest.mark.parametrize("gravity", [(0.1, 0.2, -9.8), (0, 0, 0)])
def test_results_are_the_same(leave_out: list[str], gravity: tuple[float, ...]) -> None:
    scene = builder().build(gravity=gravity)
    other = builder().build(gravity=gravity, leave_out=leave_out)
    q, qd, tau = random_states(scene, 3, (7,))
    mass = scene.mass_matrix(q)
    condition = np.linalg.cond(mass).max()
    for rates in (qd, np.zeros_like(qd)):
        wrenches = {"base": np.ones(6), "hand": np.ones(6)}
        for expected, found in (
            (mass, other.mass_matrix(q)),
            (scene.mass_matrix_inverse(q), other.mass_matrix_inverse(q)),
            (scene.inverse_dynamics(q, rates, tau), other.inverse_dynamics(q, rates, tau)),
            (scene.forward_dynamics(q, rates, tau), other.forward_dynamics(q, rates, tau)),
            (
                scene.forward_dynamics(q, rates, tau, wrenches=wrenches),
                other.forward_dynamics(q, rates, tau, wrenches=wrenches),
            ),
        ):
            # Terms of a torque: weights and forces of some bodies at levers of some metres.
            size = 100.0 + np.abs(expected).max()
            np.testing.assert_allclose(found, expected, rtol=0, atol=tolerances.inverse(condition, size))


def test_the_plan_lists_what_was_left_out() -> None:
    items = {item.switch: item for item in builder().build(gravity=(0, 0, 0)).plan().items}
    assert set(SWITCHES) < set(items)
    assert items["fixed_joints"].names == ("column", "weld")
    assert items["base_links"].names == ("base", "column")
    assert items["massless_bodies"].count == 2
    assert all(items[switch].operations > 0 for switch in SWITCHES)
    assert "operations a call" in repr(builder().build().plan())
    kept = builder().build(leave_out=()).plan()
    assert all(item.switch is None for item in kept.items)
    # The base, the column, the hand.
    assert kept.bodies == builder().build().plan().bodies + 3


def test_from_urdf_takes_the_names_too() -> None:
    urdf = """<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="1"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="a" type="continuous"><parent link="base"/><child link="arm"/></joint></robot>"""
    assert phipsi.Scene.from_urdf(urdf).plan().bodies == 1
    assert phipsi.Scene.from_urdf(urdf, leave_out=["fixed_joints"]).plan().bodies == 2


def test_pickles_and_locked_scenes_leave_out_the_same() -> None:
    scene = builder().build(leave_out=["base_links"])
    for other in (pickle.loads(pickle.dumps(scene)), scene.lock([], scene.neutral())):
        assert {item.switch for item in other.plan().items} == {"base_links", None}


def test_operators_need_bodies_that_move() -> None:
    scene = builder().build(leave_out=[])
    with pytest.raises(ArgumentError, match="fixed_joints"):
        scene.factor(scene.neutral())


@pytest.mark.parametrize("leave_out", ["fixed_joints", ["nothing"], 3, [1]])
def test_other_names_raise(leave_out: object) -> None:
    with pytest.raises(ArgumentError, match="leave_out"):
        builder().build(leave_out=leave_out)  # type: ignore[arg-type]


def test_the_report_times_what_is_left_out() -> None:
    scene = builder().build()
    times = left_out.measured(scene, states.draw(scene, tree_of(scene), 8, 0))
    assert set(times) == {item.switch for item in scene.plan().items if item.switch}
    assert all(np.isfinite(row).all() and min(row) > 0 for row in times.values())
    kept = {item.switch for item in left_out.without(scene, "base_links").plan().items}
    assert kept == {item.switch for item in scene.plan().items} - {"base_links"}
