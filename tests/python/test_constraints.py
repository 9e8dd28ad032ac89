"""Closed loops: compared with Pinocchio's constraintDynamics and MuJoCo's equality constraints, batches, pickles,
simulation, and refused arguments.
"""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from conftest import random_rotation, random_scene
from hypothesis import given, settings
from hypothesis import strategies as st

import phipsi
from phipsi.errors import ArgumentError, ConstraintError, SceneError, ShapeError, SimulationError
from tolerances import assert_near, product


def bars(builder: phipsi.SceneBuilder | None = None) -> phipsi.SceneBuilder:
    """A four-bar linkage about y, cut between the coupler and the rocker."""
    builder = builder or phipsi.SceneBuilder().link("ground")
    for name, parent, at, length in (
        ("crank", "ground", (0, 0, 0), 0.2),
        ("coupler", "crank", (0, 0, 0.2), 0.4),
        ("rocker", "ground", (0.3, 0, 0), 0.3),
    ):
        builder.link(name, mass=1.0, com=(0, 0, length / 2), inertia=np.diag([length**2 / 12] * 2 + [1e-3]))
        builder.joint(name, "revolute", parent, name, xyz=at, axis=(0, 1, 0), lower=-9, upper=9, velocity=9, effort=9)
    return builder


ENDS = {"xyz": (0, 0, 0.4), "other_xyz": (0, 0, 0.3)}


def linkage(kind: str = "axis") -> phipsi.Scene:
    axis = {"axis": (0, 1, 0)} if kind == "axis" else {}
    return bars().connect("pin", kind, "coupler", "rocker", **ENDS, **axis).build()


def closed(scene: phipsi.Scene, states: tuple[int, ...] = (), seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """States that satisfy the connections, near a given one."""
    random = np.random.default_rng(seed)
    q = np.array([0.5, 0.8, 0.2]) + random.uniform(-0.1, 0.1, (*states, 3))
    found = scene.loops.project(q, random.uniform(-1, 1, (*states, 3)))
    return found.q, found.qd


def tangle(seed: int, kinds: tuple[str, ...], joints: int = 8, floating_base: bool = False) -> phipsi.Scene:
    """A random tree with points and welds that are satisfied at zero."""
    random = np.random.default_rng(seed)
    scene = random_scene(seed, joints, kinds=kinds, floating_base=floating_base)
    builder = scene.to_builder()
    links = [f"link{k}" for k in range(joints)]
    for name, kind, link, other in (("loop", "point", links[-1], links[1]), ("held", "weld", links[-2], None)):
        if link != other:
            builder.connect(name, kind, link, other, xyz=random.uniform(-0.3, 0.3, 3), rotation=random_rotation(random))
    return builder.build()


def near(scene: phipsi.Scene, seed: int, size: float = 0.05) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A state that satisfies the connections, near the neutral one, and torques."""
    random = np.random.default_rng(seed)
    q = scene.integrate(scene.neutral(), random.uniform(-size, size, scene.nv))
    found = scene.loops.project(q, random.uniform(-1, 1, scene.nv))
    return found.q, found.qd, random.uniform(-5, 5, scene.nv)


def of_pinocchio(scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, floating_base: bool) -> np.ndarray:
    """Accelerations by Pinocchio's constraintDynamics."""
    pin = pytest.importorskip("pinocchio")
    tree = scene.without_constraints()
    root = (pin.JointModelFreeFlyer(),) if floating_base else ()
    model = pin.buildModelFromXML(tree.to_urdf(), *root)
    model.gravity.linear[:] = scene.gravity
    there, at = np.empty(model.nv, dtype=int), np.empty(model.nq, dtype=int)
    for name in scene.joint_names:
        joint = model.joints[model.getJointId(name)]
        there[joint.idx_v : joint.idx_v + joint.nv] = np.arange(scene.nv)[scene.v_index(name)]
        at[joint.idx_q : joint.idx_q + joint.nq] = np.arange(scene.nq)[scene.q_index(name)]
    joint_of = {joint.child: model.getJointId(name) for name, joint in scene.joints.items() if name in scene.joint_names}
    contacts = pin.StdVec_RigidConstraintModel()
    for name, kind, link, other, first, second in placed(scene):
        kinds = {"point": pin.ContactType.CONTACT_3D, "weld": pin.ContactType.CONTACT_6D}
        ends = [(joint_of[link], first), (0 if other is None else joint_of[other], second)]
        frames = [part for joint, (rotation, xyz) in ends for part in (joint, pin.SE3(rotation, xyz))]
        contacts.append(pin.RigidConstraintModel(kinds[kind], model, *frames, pin.ReferenceFrame.LOCAL))
    data = model.createData()
    datas = pin.StdVec_RigidConstraintData()
    datas.extend([contact.createData() for contact in contacts])
    pin.initConstraintDynamics(model, data, contacts, datas)
    proximal = pin.ProximalSettings(1e-15, 1e-15, 1e-8, 30)
    qdd = pin.constraintDynamics(model, data, q[at], qd[there], tau[there], contacts, datas, proximal)
    here = np.empty(model.nv)
    here[there] = qdd
    return here


def placed(scene: phipsi.Scene) -> list[tuple]:
    """Connections of a scene, from its pickle."""
    description = scene.__reduce__()[1][0]
    shift = lambda frame: (np.reshape(frame[0], (3, 3)), np.array(frame[1]))  # noqa: E731
    return [(name, kind, link, other, shift(first), shift(second)) for name, kind, _, _, _, link, other, first, second in description[-1][1]]


@pytest.mark.parametrize("seed", range(6))
def test_accelerations_are_those_of_pinocchio(seed: int) -> None:
    floating = seed % 2 == 1
    scene = tangle(seed, ("revolute", "prismatic"), 14, floating)
    q, qd, tau = near(scene, seed)
    found = scene.loops.dynamics(q, qd, tau)
    expected = of_pinocchio(scene, q, qd, tau, floating)
    error = np.abs(found.qdd - expected).max() / np.abs(expected).max()
    print(f"{seed}: {error:.1e}, residual {found.residual:.1e}, rank {found.rank}")
    assert error < 1e-9


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_random_loops_obey_their_definition(seed: int) -> None:
    scene = tangle(seed, ("revolute", "prismatic", "spherical", "floating"), 9)
    try:
        q, qd, tau = near(scene, seed)
    except ConstraintError:
        return
    found = scene.loops.dynamics(q, qd, tau)
    jacobian = scene.loops.jacobian(q)
    load = sum(jacobian[scene.loops.rows(name)].T @ force for name, force in found.forces.items())
    size = np.abs(found.qdd).max() + np.abs(load).max() + 10
    assert np.allclose(scene.inverse_dynamics(q, qd, found.qdd), tau + load, atol=1e-9 * size)
    assert np.abs(jacobian @ found.qdd + scene.loops.bias(q, qd)).max() < 1e-9 * size
    assert found.rank <= len(jacobian) and found.residual < 1e-9 * size


def test_forward_dynamics_goes_through_connections_and_batches_are_as_singles() -> None:
    scene = linkage()
    q, qd = closed(scene, (4, 3))
    tau = np.random.default_rng(1).uniform(-1, 1, (3, 3))
    found = scene.loops.dynamics(q, qd, tau)
    assert found.qdd.shape == (4, 3, 3) and found.forces["pin"].shape == (4, 3, 5) and found.rank.shape == found.residual.shape == (4, 3)
    assert np.array_equal(scene.forward_dynamics(q, qd, tau), found.qdd) and np.all(found.rank == 2)
    for index in np.ndindex(4, 3):
        one = scene.loops.dynamics(q[index], qd[index], tau[index[1]])
        assert np.array_equal(one.qdd, found.qdd[index]) and np.array_equal(one.forces["pin"], found.forces["pin"][index])
        assert isinstance(one.rank, int) and isinstance(one.residual, float)
    many = scene.loops.dynamics(np.tile(q, (100, 1, 1, 1)), qd, tau)
    assert np.array_equal(many.qdd[57], found.qdd)
    with pytest.raises(ArgumentError, match="without_constraints"):
        scene.estimate(q[0, 0], qd[0, 0], tau[0])
    with pytest.raises(ArgumentError, match="without_constraints"):
        scene.ode()
    with pytest.raises(ArgumentError, match="without_constraints"):
        scene.to_urdf()


def test_wrenches_and_forces_are_in_their_frames() -> None:
    # A rod on a hinge, welded to the world: the weld and the hinge share the load.
    builder = phipsi.SceneBuilder().link("ground").link("rod", mass=2.0, com=(0, 0, 0.5), inertia=np.diag([0.1, 0.1, 0.01]))
    builder.joint("hinge", "revolute", "ground", "rod", axis=(0, 1, 0), lower=-9, upper=9, velocity=9, effort=9)
    scene = builder.connect("rope", "rod", "rod", xyz=(0, 0, 1.0), other_xyz=(1.0, 0, 1.0)).build()
    # A horizontal massless rod from the tip to a wall: with 3 N at the middle it transmits 1.5 N of compression.
    found = scene.loops.dynamics([0.0], [0.0], [0.0], wrenches={"rod": [0, 0.5 * 3, 0, 3, 0, 0]})
    assert np.allclose(found.forces["rope"], [1.5], atol=1e-12) and found.rank == 1
    welded = builder.build().to_builder().connect("weld", "weld", "rod", xyz=(0, 0, 1.0)).build()
    assert welded.loops.names == ("rope", "weld")


def test_rows_that_give_way_are_measurements_with_noise() -> None:
    scene = tangle(3, ("revolute", "prismatic"))
    q, qd, tau = near(scene, 1)
    (jacobian, gamma), (m, nv) = (scene.loops.jacobian(q), scene.loops.bias(q, qd)), (9, scene.nv)
    compliance = np.random.default_rng(0).uniform(0.0, 2.0, m)
    compliance[2] = 0.0
    system = np.block([[scene.mass_matrix(q), -jacobian.T], [jacobian, np.diag(compliance)]])
    exact = np.linalg.solve(system, np.concatenate([tau - scene.bias_torque(q, qd), -gamma]))
    scale = 1e-13 * np.linalg.cond(system)
    for form in ("auto", "covariance", "square-root"):
        found = scene.loops.dynamics(q, qd, tau, compliance=compliance, form=form)  # type: ignore[arg-type]
        forces = np.concatenate([found.forces[name] for name in scene.loops.names])
        assert np.max(np.abs(found.qdd - exact[:nv])) <= scale * np.max(np.abs(exact[:nv]))
        assert np.max(np.abs(forces - exact[nv:])) <= scale * np.max(np.abs(exact[nv:]))
        left = jacobian @ found.qdd + gamma
        assert found.rank == m and abs(found.residual - np.max(np.abs(left))) <= 1e-9 * np.max(np.abs(left))
        assert np.max(np.abs(left + compliance * forces)) <= 1e-9 * np.max(np.abs(left))
    # One value per state, and one value for all constraints; with nearly zero compliance the constraints are
    # satisfied.
    many = scene.loops.dynamics(q, qd, tau, compliance=np.stack([compliance, np.full(m, 0.5)]))
    alone = scene.loops.dynamics(q, qd, tau, compliance=0.5)
    np.testing.assert_allclose(many.qdd[1], alone.qdd, rtol=1e-9, atol=1e-9)
    assert np.max(np.abs(many.qdd[0] - many.qdd[1])) > 1e-3 * np.max(np.abs(alone.qdd))
    held = scene.loops.dynamics(q, qd, tau)
    nearly = scene.loops.dynamics(q, qd, tau, compliance=1e-12)
    np.testing.assert_allclose(nearly.qdd, held.qdd, rtol=1e-6, atol=1e-6 * float(np.max(np.abs(held.qdd))))
    for bad, error, message in ((-1.0, ArgumentError, "zero or above"), (np.zeros(4), ShapeError, "9")):
        with pytest.raises(error, match=message):
            scene.loops.dynamics(q, qd, tau, compliance=bad)


def test_contradicting_rows_that_give_way_get_a_compromise() -> None:
    builder = bars().connect("pin", "point", "coupler", "rocker", **ENDS)
    builder.connect("rival", "point", "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.35))
    scene = builder.build()
    q, qd, zero = np.array([0.5, 0.8, 0.2]), np.array([1.0, -2.0, 0.5]), np.zeros(3)
    with pytest.raises(ConstraintError, match="rival"):
        scene.loops.dynamics(q, qd, zero)
    found = scene.loops.dynamics(q, qd, zero, compliance=0.1)
    jacobian, gamma = scene.loops.jacobian(q), scene.loops.bias(q, qd)
    system = np.block([[scene.mass_matrix(q), -jacobian.T], [jacobian, 0.1 * np.eye(6)]])
    exact = np.linalg.solve(system, np.concatenate([-scene.bias_torque(q, qd), -gamma]))
    np.testing.assert_allclose(found.qdd, exact[:3], rtol=1e-10)
    assert found.residual > 0.1


def test_projection_goes_to_the_nearest() -> None:
    scene = linkage("point")
    q = np.array([0.5, 0.8, 0.2])
    found = scene.loops.project(q)
    assert found.qd is None and found.rank == 2 and np.abs(scene.loops.error(found.q)).max() < 1e-14
    assert np.abs(found.q - q).max() < 0.5
    q2, qd2, rank = scene.loops.project(found.q, [1.0, 2.0, 3.0])
    assert np.array_equal(q2, found.q) and np.abs(scene.loops.jacobian(q2) @ qd2).max() < 1e-14
    far = bars().connect("far", "distance", "coupler", "ground", length=9.0).build()
    with pytest.raises(ConstraintError, match="connection \"far\"") as caught:
        far.loops.project(np.tile(q, (3, 1)))
    assert caught.value.connections == ("far",) and caught.value.residual > 8 and caught.value.state == 0
    with pytest.warns(phipsi.errors.BadStateWarning):
        assert np.isnan(far.loops.project(q, errors="nan").q).all()


def test_inverse_dynamics_and_the_inverse_mass_matrix() -> None:
    scene = linkage()
    q, qd = closed(scene)
    qdd = scene.loops.dynamics(q, qd, [7.0, 0.0, 0.0]).qdd
    found = scene.loops.inverse_dynamics(q, qd, qdd, actuated=["crank"])
    assert np.allclose(found.tau, [7.0, 0.0, 0.0], atol=1e-12) and found.residual < 1e-10
    assert np.array_equal(scene.loops.inverse_dynamics(q, qd, qdd, actuated=[True, False, False]).tau, found.tau)
    every = scene.loops.inverse_dynamics(q, qd, qdd).tau
    assert np.allclose(scene.loops.dynamics(q, qd, every).qdd, qdd, atol=1e-10)
    with pytest.raises(ArgumentError, match="not actuated"):
        scene.loops.inverse_dynamics(q, qd, qdd, actuated=[])
    with pytest.raises(ArgumentError, match="actuated: found 'krank'|actuated.*krank"):
        scene.loops.inverse_dynamics(q, qd, qdd, actuated=["krank"])
    inverse, jacobian = scene.loops.mass_matrix_inverse(q), scene.loops.jacobian(q)
    assert np.abs(jacobian @ inverse).max() < 1e-13 * np.abs(inverse).max() and np.linalg.matrix_rank(inverse, 1e-10) == 1
    step = scene.loops.dynamics(q, qd, [8.0, 0.0, 0.0]).qdd - qdd
    assert np.allclose(inverse[:, 0], step, atol=1e-10)


def test_motion_stays_closed() -> None:
    scene = linkage()
    q, qd = closed(scene, (5,))
    path = scene.simulate(q, qd, dt=1e-3, steps=500, record_every=100)
    assert path.drift.shape == (5, 6) and path.drift.max() < 1e-13
    energy = path.energy().total
    assert np.abs(energy - energy[:, :1]).max() < 1e-5
    simulator = scene.simulator(q, qd, dt=1e-3)
    simulator.step(steps=500)
    assert np.array_equal(simulator.q, path.q[:, -1])
    again = pickle.loads(pickle.dumps(scene.simulator(q, qd, dt=1e-3, method="rosenbrock-2")))
    again.step(steps=3)
    with pytest.raises(ConstraintError, match=r"\"pin\".*scene.loops.project"):
        scene.simulate(q + [1e-3, 0, 0], qd, dt=1e-3, steps=1)
    with pytest.raises(ConstraintError, match=r"\"pin\".*scene.loops.project"):
        simulator.reset(q, qd + 1.0)
    for run in (scene.simulate, scene.simulator):
        with pytest.raises(TypeError, match=r"'baumgarte'.*each step is projected onto the connections"):
            run(q, qd, dt=1e-3, baumgarte=20.0)  # type: ignore[call-overload, operator]
    assert linkage().without_constraints().simulate(q, qd, dt=1e-3, steps=2).drift.max() == 0.0


def test_a_step_that_tears_a_linkage_ends_the_motion() -> None:
    scene = linkage()
    q, qd = closed(scene)
    with pytest.raises(SimulationError) as caught:
        scene.simulate(q, 100 * qd, dt=0.5, steps=50, tau=[1e4, 0, 0], method="semi-implicit-euler", limits="report")
    assert caught.value.trajectory.steps < 50


def test_connections_belong_to_the_scene() -> None:
    scene = linkage()
    q, qd = closed(scene)
    expected = scene.loops.error(q + 0.1)
    for other in (
        pickle.loads(pickle.dumps(scene)),
        copy.deepcopy(scene),
        scene.to_builder().build(),
        pickle.loads(pickle.dumps(scene.to_builder())).build(),
        scene.with_properties(armature=0.1),
        scene.with_payload("rocker", 1.0),
        scene.with_inertias({"rocker": (1.0, (0, 0, 0.1), None)}),
    ):
        assert other.loops.names == ("pin",) and np.array_equal(other.loops.error(q + 0.1), expected)
    assert scene.without_constraints().loops.names == () and "1 connections" in repr(scene)
    assert np.abs(scene.lock(["crank"], q).loops.error(q[1:])).max() < 1e-14
    assert scene.loops.rows("pin") == slice(0, 5, 1)
    with pytest.raises(ArgumentError, match="one of \"pin\""):
        scene.loops.rows("pim")


def test_a_second_frame_that_is_not_given_is_where_the_first_is_at_zero() -> None:
    scene = bars().connect("pin", "weld", "coupler", "rocker", xyz=(0.1, 0.2, 0.3), rpy=(0.1, 0.2, 0.3)).build()
    assert np.abs(scene.loops.error(np.zeros(3))).max() < 1e-15
    rod = bars().connect("rod", "rod", "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.3)).build()
    assert np.abs(rod.loops.error(np.zeros(3))).max() < 1e-15
    geared = bars().couple("gear", "crank", "rocker", multiplier=-2.0, offset=0.1).build()
    assert np.allclose(geared.loops.error([0.5, 0.0, 0.3]), [0.5 + 0.6 - 0.1])
    assert np.array_equal(geared.loops.jacobian(np.zeros(3)), [[1.0, 0.0, 2.0]])


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (("pin", "pont", "coupler"), {}, 'kind "pont"'),
        (("pin", "point", "coupler"), {"axis": (0, 0, 1)}, "axis for kind"),
        (("pin", "point", "coupler"), {"length": 1.0}, "length for kind"),
        (("pin", "point", "copler"), {}, '"copler"'),
        (("pin", "point", "coupler", "coupler"), {}, "itself"),
        (("pin", "weld", "ground"), {}, "rigidly attached"),
        (("pin", "distance", "coupler"), {"length": -1.0}, "length -1"),
        (("pin", "axis", "coupler"), {"axis": (0, 0, 0)}, "axis"),
        (("pin", "point", "coupler"), {"rotation": 2 * np.eye(3)}, "rotation"),
        (("pin", "point", "coupler"), {"other_rotation": -np.eye(3)}, "rotation"),
        (("pin", "point", "coupler"), {"xyz": (np.nan, 0, 0)}, "not finite|finite"),
    ],
)
def test_broken_connections_are_refused_by_name(arguments: tuple[str, ...], options: dict[str, object], message: str) -> None:
    with pytest.raises((SceneError, ArgumentError), match=message) as caught:
        bars().connect(*arguments, **options).build()
    assert "pin" in str(caught.value)


def test_broken_arguments_are_refused() -> None:
    with pytest.raises(ShapeError, match="other_xyz of connection 'pin'|other_xyz of connection \"pin\""):
        bars().connect("pin", "point", "coupler", other_xyz=(0, 0))
    with pytest.raises(SceneError, match="duplicate name"):
        bars().connect("pin", "point", "coupler").connect("pin", "weld", "rocker").build()
    for joints, message in ((("crank", "nobody"), "nobody"), (("crank", "crank"), "itself")):
        with pytest.raises(SceneError, match=message):
            bars().couple("gear", *joints).build()
    scene = linkage()
    q, qd = closed(scene)
    with pytest.raises(ShapeError, match="tau"):
        scene.loops.dynamics(q, qd, [0.0])
    with pytest.raises(ArgumentError, match="form"):
        scene.loops.dynamics(q, qd, qd, form="none")


def test_scenes_without_connections_have_no_rows(mixed: phipsi.Scene) -> None:
    q, qd, tau = mixed.neutral(), np.ones(mixed.nv), np.ones(mixed.nv)
    found = mixed.loops.dynamics(q, qd, tau)
    assert found.forces == {} and found.rank == 0 and found.residual == 0.0
    assert np.allclose(found.qdd, mixed.forward_dynamics(q, qd, tau), rtol=1e-12)
    assert mixed.loops.error(q).shape == (0,) and mixed.loops.jacobian(np.stack([q, q])).shape == (2, 0, mixed.nv)
    moved = mixed.loops.project(q, qd)
    assert np.array_equal(moved.q, q) and np.array_equal(moved.qd, qd) and moved.rank == 0
    assert np.allclose(mixed.loops.mass_matrix_inverse(q), mixed.mass_matrix_inverse(q), rtol=1e-12, atol=1e-14)
    assert np.allclose(mixed.loops.inverse_dynamics(q, qd, qd).tau, mixed.inverse_dynamics(q, qd, qd))


def test_a_rod_along_its_hinge_moves_nothing() -> None:
    builder = phipsi.SceneBuilder().link("ground").link("rod", mass=1.0, com=(0, 0, 0.5), inertia=np.diag([0.1, 0.1, 0.01]))
    builder.joint("hinge", "continuous", "ground", "rod", axis=(0, 1, 0))
    scene = builder.connect("stay", "rod", "rod", xyz=(0, 0, 1.0), other_xyz=(0, 0, 0)).build()
    for angle in (0.0, 0.3, np.pi / 2):
        found = scene.loops.dynamics([angle], [0.0], [1.0])
        assert found.rank == 0 and found.forces["stay"] == 0.0 and found.residual < 1e-12
        assert np.allclose(found.qdd, scene.without_constraints().forward_dynamics([angle], [0.0], [1.0]))


def test_contradicting_connections_are_named() -> None:
    builder = bars()
    for name, xyz in (("one", (0, 0, 0.1)), ("other", (0, 0, 0.3))):
        builder.connect(name, "point", "coupler", xyz=xyz)
    with pytest.raises(ConstraintError) as caught:
        builder.build().loops.dynamics(np.zeros((2, 3)), [1.0, 1.0, 0.0], np.zeros(3))
    assert caught.value.connections == ("one", "other") and caught.value.state == 0 and caught.value.residual > 0.1


MODEL = """<mujoco><option timestep="1e-3"><flag contact="disable"/></option><worldbody>
<body name="crank"><joint name="a" axis="0 1 0"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.2"/>
<body name="coupler" pos="0 0 0.2"><joint name="b" axis="0 1 0"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.4"/><site name="tip" pos="0 0 0.4"/></body></body>
<body name="rocker" pos="0.3 0 0"><joint name="c" axis="0 1 0"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.3"/><site name="top" pos="0 0 0.3"/></body>
</worldbody><equality>{}</equality></mujoco>"""


def test_equality_constraints_of_mujoco_are_connections() -> None:
    mujoco = pytest.importorskip("mujoco")
    stiff = 'solref="2e-5 1" solimp="0.99999 0.99999 0.001"'
    sites = f'<connect name="pin" site1="tip" site2="top" {stiff}/>'
    scene = phipsi.Scene.from_mujoco(MODEL.format(sites))
    assert scene.loops.names == ("pin",)
    q, qd = closed(scene)
    model = mujoco.MjModel.from_xml_string(MODEL.format(sites))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, qd, [0.3, -0.2, 0.1]
    mujoco.mj_forward(model, data)
    found = scene.loops.dynamics(q, qd, [0.3, -0.2, 0.1]).qdd
    print(found, data.qacc)
    assert np.allclose(data.qacc, found, rtol=1e-3, atol=1e-3 * np.abs(found).max())


@pytest.mark.parametrize(
    ("element", "kind"),
    [
        ('<connect body1="coupler" body2="rocker" anchor="0 0 0.4"/>', 3),
        ('<weld body1="coupler" body2="rocker" relpose="0.1 0.2 0.3 0.8 0.6 0 0" anchor="0.1 0 0.2"/>', 6),
        ('<weld body1="coupler"/>', 6),
        ('<weld site1="tip" site2="top"/>', 6),
        ('<joint joint1="a" joint2="c" polycoef="0.2 0.5 0 0 0"/>', 1),
        ('<joint joint1="a" joint2="c" polycoef="0.2 0.5 -0.3 0.2 0.1"/>', 1),
        ('<joint joint1="a" polycoef="0.2 0 0 0 0"/>', 1),
    ],
)
def test_rows_of_mujoco_are_those_of_the_scene(element: str, kind: int) -> None:
    mujoco = pytest.importorskip("mujoco")
    scene = phipsi.Scene.from_mujoco(MODEL.format(element))
    assert scene.loops.names == ("equality 0",) and len(scene.loops.error(np.zeros(3))) == kind
    model = mujoco.MjModel.from_xml_string(MODEL.format(element))
    data = mujoco.MjData(model)
    data.qpos[:] = [0.3, 0.4, 0.2]
    mujoco.mj_forward(model, data)
    ours = scene.loops.error(data.qpos)
    theirs = data.efc_pos[:kind]
    # In other frames, and with scaled torsions: magnitudes.
    if kind == 6:
        assert np.isclose(np.linalg.norm(ours[3:]), np.linalg.norm(theirs[:3]))
    else:
        assert np.isclose(np.linalg.norm(ours), np.linalg.norm(theirs))


def test_a_rod_whose_ends_coincide_but_for_rounding_has_no_length() -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        builder = phipsi.SceneBuilder().link("base").link("a", 1.0).link("b", 1.0)
        for name, parent in (("a", "base"), ("b", "a")):
            builder.joint(name, "revolute", parent, name, xyz=rng.normal(size=3), rpy=rng.normal(size=3), axis=rng.normal(size=3))
        with pytest.raises(SceneError, match="origins coincide"):
            builder.connect("rod", "rod", "b", "base", xyz=rng.normal(size=3)).build()


@pytest.mark.parametrize("tilt", [0.0, 1e-12, 1e-9, 1e-8, 1e-6, 1.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_hinge_turns_about_its_axis_however_small_its_tilt(tilt: float, sign: float) -> None:
    axis = np.array([tilt, -0.5 * tilt, sign])
    box = phipsi.SceneBuilder().link("box", mass=1.0, inertia=np.eye(3))
    scene = box.connect("hinge", "axis", "box", axis=axis).build(floating_base=True)
    half = 0.6 * axis / np.linalg.norm(axis)
    q = np.concatenate([np.zeros(3), np.sin(0.6) * half / 0.6, [np.cos(0.6)]])
    assert_near(scene.loops.error(q), np.zeros(5), product(9, 1.0) * max(tilt, 1e-2))
    # Across the axis it does not turn.
    q[3:] = [np.sin(0.05), 0.0, 0.0, np.cos(0.05)]
    assert np.abs(scene.loops.error(q)).max() > 0.05
