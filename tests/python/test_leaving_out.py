"""Simplifications of a scene: switches by name, equal results with and without, and the plan that lists them."""

from __future__ import annotations

import pickle
import time

import numpy as np
import pytest
import tolerances
from conftest import random_states

import phipsi
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError, SingularJointError
from phipsi.report import states
from phipsi.report.sections import plan as left_out

SWITCHES = (
    "fixed_joints",
    "base_links",
    "permuted_axes",
    "oblique_axes",
    "zero_velocity",
    "zero_gravity",
)


def builder() -> phipsi.SceneBuilder:
    """base - (column) - a: arm - (weld) - hand - c: flap - d: tip - b: sledge (planar), every link with mass; c and d
    are parallel.
    """
    builder = phipsi.SceneBuilder()
    for name in ("base", "column", "arm", "hand", "flap", "tip", "sledge"):
        builder.link(name, mass=1.5, com=(0.1, 0.2, -0.1), inertia=np.diag((0.2, 0.3, 0.25)))
    builder.joint("column", "fixed", "base", "column", xyz=(0, 0, 1))
    builder.joint("a", "revolute", "column", "arm", xyz=(0.2, 0, 0.1), rpy=(0.3, -0.2, 0.1), axis=(1, 2, 3))
    builder.joint("weld", "fixed", "arm", "hand", xyz=(0.3, 0.1, 0.0), rpy=(1.0, 0.5, 0.2))
    builder.joint("c", "revolute", "hand", "flap", xyz=(0.1, 0.0, 0.2), axis=(0, 1, 0))
    builder.joint("d", "revolute", "flap", "tip", xyz=(0.2, 0.1, 0.0), axis=(0, 1, 0))
    return builder.joint("b", "planar", "tip", "sledge", xyz=(0.0, 0.2, 0.3), axis=(0, 1, 1))


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
            # Terms of a torque: weights and forces of several bodies at offsets of several meters.
            size = 100.0 + np.abs(expected).max()
            np.testing.assert_allclose(found, expected, rtol=0, atol=tolerances.inverse(condition, size))


def test_the_plan_lists_what_was_left_out() -> None:
    items = {item.switch: item for item in builder().build(gravity=(0, 0, 0)).plan().items}
    assert set(SWITCHES) < set(items)
    assert items["fixed_joints"].names == ("column", "weld")
    assert items["base_links"].names == ("base", "column")
    assert all(items[switch].operations > 0 for switch in SWITCHES)
    assert "operations per call" in repr(builder().build().plan())
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


@pytest.mark.parametrize("leave_out", ["nothing", ["nothing"], ["planar"], 3, [1]])
def test_other_names_raise(leave_out: object) -> None:
    with pytest.raises(ArgumentError, match="leave_out"):
        builder().build(leave_out=leave_out)  # type: ignore[arg-type]


def test_the_report_times_what_is_left_out() -> None:
    scene = builder().build()
    times = left_out.measured(scene, states.draw(scene, 8, 0))
    switches = {item.switch for item in scene.plan().items if item.switch}
    # On a chain all bodies are inboard of the last joint, and an update saves nothing.
    assert set(times) == switches | {"the factor of M, in calls that share q"}
    assert all(np.isfinite(row.ns_on) and row.ns_on > 0 and np.isfinite(row.ns_off) and row.ns_off > 0 for row in times.values())
    kept = {item.switch for item in left_out.without(scene, "base_links").plan().items}
    assert kept == {item.switch for item in scene.plan().items} - {"base_links"}


def arms_on_a_cart() -> phipsi.SceneBuilder:
    """Two arms on a cart, in the plane perpendicular to y."""
    builder = phipsi.SceneBuilder().link("base")
    builder.link("cart", mass=3.0)
    builder.joint("slide", "prismatic", "base", "cart", axis=(1, 0, 0), armature=0.1)
    for arm in "ab":
        parent = "cart"
        for k in range(3):
            builder.link(f"{arm}{k}", mass=1.0, com=(0.1, 0.05, 0.2), inertia=np.diag((0.03, 0.02, 0.04)))
            turned = {"rpy": (np.pi / 2, 0, 0), "axis": (0, 0, -1)} if arm == "b" and k == 0 else {"axis": (0, 1, 0)}
            turned = {"axis": (0, 0, 1)} if arm == "b" and k > 0 else turned
            builder.joint(f"{arm}{k}", "revolute", parent, f"{arm}{k}", xyz=(0.1, 0.2, 0.3), **turned)  # type: ignore[arg-type]
            parent = f"{arm}{k}"
    return builder


@pytest.mark.parametrize("form", ["covariance", "auto", "square-root"])
def test_an_updated_factor_is_a_new_one(form: str) -> None:
    scene = arms_on_a_cart().build()
    q = random_states(scene, 3, (4,)).q
    factor = scene.factor(q, form=form)
    gains = factor.K
    tau = np.linspace(-1.0, 1.0, scene.nv)
    bodies = 4 * scene.plan().bodies
    whole = form in ("auto", "square-root")
    # The path of the last joint of arm b contains three bodies and the cart; that of the prismatic joint only its
    # own.
    for joint, count in (("b2", 4 * 4), ("slide", 4 * 1)):
        q = q.copy()
        q[:, scene.q_index(joint)] += 0.3
        assert factor.update(q) == (bodies if whole else count)
        new = scene.factor(q, form=form)
        np.testing.assert_array_equal(factor.solve(tau), new.solve(tau))
        np.testing.assert_array_equal(factor.log_det, new.log_det)
        np.testing.assert_array_equal(gains @ tau, new.K @ tau)
        np.testing.assert_array_equal(factor.M.toarray(), new.M.toarray())
    assert factor.update(q) == (bodies if whole else 0)


def test_a_bad_update_changes_nothing() -> None:
    """Two prismatic joints, the second with all the mass: along one line, the first has no inertia of its own."""
    builder = phipsi.SceneBuilder().link("base").link("carriage").link("wheel").link("weight", mass=1.0)
    builder.joint("first", "prismatic", "base", "carriage", axis=(1, 0, 0))
    builder.joint("turn", "revolute", "carriage", "wheel", armature=0.1)
    builder.joint("last", "prismatic", "wheel", "weight", axis=(1, 0, 0))
    scene = builder.build()
    q = np.array([[0.0, 0.5, 0.1], [0.0, 1.0, 0.2]])
    factor = scene.factor(q, form="covariance")
    before = factor.solve(np.ones(3))
    bad = np.array([[0.3, 0.6, 0.2], [0.0, 0.0, 0.2]])
    with pytest.raises(SingularJointError) as caught:
        factor.update(bad)
    assert (caught.value.joint, caught.value.state) == ("first", 1)
    np.testing.assert_array_equal(factor.solve(np.ones(3)), before)
    for wrong, error in ((q[0], ShapeError), (np.full((2, 3), np.nan), NotFiniteError)):
        with pytest.raises(error):
            factor.update(wrong)
    np.testing.assert_array_equal(factor.solve(np.ones(3)), before)


def test_a_locked_arm_is_one_body_and_is_listed() -> None:
    scene = arms_on_a_cart().build()
    q, qd, tau = random_states(scene, 3, ())
    names = ["b0", "b1", "b2"]
    locked = scene.lock(names, q)
    assert locked.plan().bodies == scene.plan().bodies - 3
    rows = [i for i in range(scene.nv) if i not in range(scene.v_index("b0").start, scene.v_index("b2").stop)]
    qd[[i for i in range(scene.nv) if i not in rows]] = 0.0
    mass, bias = scene.mass_matrix(q)[np.ix_(rows, rows)], scene.bias_torque(q, qd)[rows]
    expected = np.linalg.solve(mass, tau[rows] - bias)
    bound = tolerances.inverse(float(np.linalg.cond(mass)), 100.0 + np.abs(expected).max())
    for form in ("auto", "covariance", "square-root"):
        found = locked.forward_dynamics(q[rows], qd[rows], tau[rows], form=form)  # type: ignore[arg-type]
        np.testing.assert_allclose(found, expected, rtol=0, atol=bound)
    for each in (locked, pickle.loads(pickle.dumps(locked))):
        item = next(item for item in each.plan().items if "locked" in item.what)
        assert (item.count, item.names, item.switch) == (3, ("b0", "b1", "b2"), None)
        assert item.operations > 0 and "3 bodies" in item.saved
    assert all("locked" not in item.what for item in scene.plan().items)


def test_the_plan_lists_calls_and_outputs() -> None:
    scene = arms_on_a_cart().build()
    items = {item.what: item for item in scene.plan().items}
    shared = items["the factor of M, in calls that share q"]
    branch = items["bodies that are not on the path to the base, in a factor of which only the last joint has moved"]
    outputs = items["outputs that are not asked for"]
    assert branch.count == 3
    assert min(shared.operations, branch.operations, outputs.operations) > 0
    assert "its inverse" in outputs.saved
    compiled = items["operations that are constant for this robot, in code compiled for it"]
    left, _, asked = (compiled.saved.split()[i] for i in (0, 5, 7))
    assert 0 < int(left) < int(asked) and compiled.operations == int(asked) - int(left)
    times = left_out.measured(scene, states.draw(scene, 8, 0))
    assert {shared.what, branch.what} <= set(times)


def many_links(count: int) -> phipsi.Scene:
    """A hinge with that many links on fixed joints, and as many on the base."""
    builder = phipsi.SceneBuilder().link("base").link("rod", 1.0, inertia=np.eye(3)).joint("hinge", "revolute", "base", "rod")
    for k in range(count):
        for carrier in ("base", "rod"):
            builder.link(f"{carrier} {k}", 0.01, inertia=np.eye(3)).joint(f"on {carrier} {k}", "fixed", carrier, f"{carrier} {k}")
    return builder.build()


def test_the_plan_takes_time_in_proportion_to_the_links() -> None:
    """Eight times the links took sixty times as long when each was searched among all."""
    scenes = [many_links(count) for count in (1_000, 8_000)]
    times = [np.inf, np.inf]
    # In turns, because other work slows a machine down for a while.
    for _ in range(20):
        for i, scene in enumerate(scenes):
            begin = time.perf_counter()
            scene.plan()
            times[i] = min(times[i], time.perf_counter() - begin)
    assert times[1] < 24 * times[0]
