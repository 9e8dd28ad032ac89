"""Scene.from_pinocchio compared with Pinocchio: every joint that both support, robots of example-robot-data, refused
models.
"""

from __future__ import annotations

import numpy as np
import pytest
from tolerances import assert_near, inverse, product, recursion, size

import phipsi
import phipsi.pinocchio
from phipsi.errors import ArgumentError, SceneError, ShapeError

pin = pytest.importorskip("pinocchio")

AXIS = np.array([0.48, -0.6, 0.64])
JOINTS = {
    "RX": lambda: pin.JointModelRX(),
    "RZ": lambda: pin.JointModelRZ(),
    "oblique": lambda: pin.JointModelRevoluteUnaligned(AXIS),
    "unbounded": lambda: pin.JointModelRUBY(),
    "PY": lambda: pin.JointModelPY(),
    "slide": lambda: pin.JointModelPrismaticUnaligned(AXIS),
    "screw": lambda: pin.JointModelHelicalUnaligned(AXIS, 0.3),
    "planar": lambda: pin.JointModelPlanar(),
    "ball": lambda: pin.JointModelSpherical(),
    "translation": lambda: pin.JointModelTranslation(),
    "free": lambda: pin.JointModelFreeFlyer(),
}


def of(*kinds: str, seed: int = 0) -> pin.Model:
    """A chain of joints of these types, with a side arm at each second body."""
    pin.seed(seed)
    draw = np.random.default_rng(seed)
    model = pin.Model()
    parent = 0
    for at, kind in enumerate(kinds):
        joint = model.addJoint(parent, JOINTS[kind](), pin.SE3.Random(), f"{kind}{at}")
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(*draw.uniform(0.2, 1.0, 4)), pin.SE3.Random())
        model.addBodyFrame(f"link{at}", joint, pin.SE3.Identity(), 0)
        if at % 2 == 0:
            parent = joint
    # Armature of planar joints is refused.
    armature = [0.0 if joint.shortname() == "JointModelPlanar" else draw.uniform(0, 0.1) for joint in model.joints[1:]]
    model.armature[:] = np.repeat(armature, [joint.nv for joint in model.joints[1:]])
    model.gravity.linear[:] = [0.3, -0.4, -9.0]
    return model


def beside(scene: phipsi.Scene, model: pin.Model, seed: int = 1) -> None:
    """A random state of both."""
    pin.seed(seed)
    draw = np.random.default_rng(seed)
    data = model.createData()
    q_there = pin.integrate(model, pin.neutral(model), draw.standard_normal(model.nv))
    v_there = draw.standard_normal(model.nv)
    q, qd = phipsi.pinocchio.to_state(scene, model, q_there, v_there)
    pin.forwardKinematics(model, data, q_there, v_there)
    # Pinocchio's kinetic energy does not include all of the armature behind joints with oblique axes.
    mass = np.triu(pin.crba(model, data, q_there))
    energy = 0.5 * v_there @ (mass + np.triu(mass, 1).T) @ v_there
    assert_near(0.5 * qd @ scene.mass_matrix(q) @ qd, energy, recursion(scene.nv, size(energy)))
    back = phipsi.pinocchio.from_state(scene, model, q, qd)
    assert_near(back[0], q_there, product(1, size(q_there)))
    assert_near(back[1], v_there, product(1, size(v_there)))
    for joint in range(1, model.njoints):
        name = phipsi.pinocchio._own_links(model)[joint]
        assert_near(scene.placement(q, name), data.oMi[joint].homogeneous, recursion(scene.nv, size(data.oMi[joint].translation)))


def order(scene: phipsi.Scene, model: pin.Model) -> np.ndarray:
    """Index of each of phipsi's velocities in those of Pinocchio."""
    return phipsi.pinocchio.to_state(scene, model, pin.neutral(model), np.arange(model.nv, dtype=float))[1].astype(int)


def dynamics(scene: phipsi.Scene, model: pin.Model) -> None:
    """M, bias and accelerations, for velocities that differ only in their order."""
    data, draw, rows = model.createData(), np.random.default_rng(5), order(scene, model)
    q_there = pin.integrate(model, pin.neutral(model), draw.standard_normal(model.nv))
    v_there, tau_there = draw.standard_normal((2, model.nv))
    q, qd = phipsi.pinocchio.to_state(scene, model, q_there, v_there)
    mass = np.triu(pin.crba(model, data, q_there))
    mass = (mass + np.triu(mass, 1).T)[np.ix_(rows, rows)]
    bias = pin.nonLinearEffects(model, data, q_there, v_there)[rows]
    qdd = pin.aba(model, data, q_there, v_there, tau_there)[rows]
    assert_near(scene.mass_matrix(q), mass, recursion(scene.nv, size(mass)))
    assert_near(scene.bias_torque(q, qd), bias, recursion(scene.nv, size(bias)))
    assert_near(scene.forward_dynamics(q, qd, tau_there[rows]), qdd, inverse(float(np.linalg.cond(mass)), size(qdd)))


@pytest.mark.parametrize("kind", JOINTS)
def test_each_joint(kind: str) -> None:
    model = of("RX", kind, "RZ")
    scene = phipsi.Scene.from_pinocchio(model)
    assert scene.nv == model.nv
    assert np.array_equal(scene.gravity, [0.3, -0.4, -9.0])
    beside(scene, model)
    if kind != "planar":
        dynamics(scene, model)


def test_all_at_once() -> None:
    model = of(*JOINTS, seed=3)
    scene = phipsi.load(model)
    beside(scene, model)
    dynamics(phipsi.Scene.from_pinocchio(of(*(kind for kind in JOINTS if kind != "planar"))), of(*(kind for kind in JOINTS if kind != "planar")))


@pytest.mark.parametrize("file", ["ur_description/urdf/ur5_robot.urdf", "anymal_b_simple_description/robots/anymal.urdf", "talos_data/robots/talos_reduced.urdf"])
def test_robots(file: str) -> None:
    from oracle_pinocchio import ROBOTS

    model = pin.buildModelFromUrdf(str(ROBOTS / file), pin.JointModelFreeFlyer())
    scene = phipsi.Scene.from_pinocchio(model)
    beside(scene, model)
    dynamics(scene, model)
    bodies = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    assert set(scene.link_names) >= bodies
    data, q = model.createData(), pin.neutral(model)
    pin.framesForwardKinematics(model, data, q)
    here = scene.placements(phipsi.pinocchio.to_state(scene, model, q)[0])
    for name in bodies:
        there = data.oMf[model.getFrameId(name, pin.FrameType.BODY)].homogeneous
        assert_near(here[name], there, recursion(scene.nv, size(there)))


def test_limits_and_losses() -> None:
    model = of("RX", "slide")
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = [-1.0, -0.2], [2.0, 0.3]
    model.damping[:] = [0.5, 0.6]
    scene = phipsi.Scene.from_pinocchio(model, gravity=(0, 0, 0))
    assert [(joint.lower, joint.upper, joint.damping) for joint in (scene.joints["RX0"], scene.joints["slide1"])] == [(-1.0, 2.0, 0.5), (-0.2, 0.3, 0.6)]
    assert not np.any(scene.gravity)


@pytest.mark.parametrize("kind", ["JointModelSphericalZYX", "JointModelEllipsoid", "JointModelComposite"])
def test_joints_that_phipsi_has_not(kind: str) -> None:
    if not hasattr(pin, kind):
        pytest.skip(f"this Pinocchio has no {kind}")
    joint = getattr(pin, kind)()
    if kind == "JointModelComposite":
        joint.addJoint(pin.JointModelRX(), pin.SE3.Identity())
    model = pin.Model()
    model.addJoint(0, joint, pin.SE3.Identity(), "strange")
    with pytest.raises(SceneError, match=f"model: found joint 'strange' of type {kind}"):
        phipsi.Scene.from_pinocchio(model)


def test_what_is_no_model() -> None:
    with pytest.raises(ArgumentError, match="model: found str; expected pinocchio.Model"):
        phipsi.Scene.from_pinocchio("robot.urdf")


def test_unequal_numbers_of_one_joint_are_refused() -> None:
    model = of("ball")
    model.armature[:] = [0.1, 0.2, 0.3]
    with pytest.raises(SceneError, match=r"model: found armature \[0.1, 0.2, 0.3\] at the joint 'ball0'"):
        phipsi.Scene.from_pinocchio(model)


def test_a_state_of_another_length() -> None:
    model = of("RX")
    with pytest.raises(ShapeError, match=r"q: found shape \(2,\); expected \(..., 1\)"):
        phipsi.pinocchio.to_state(phipsi.Scene.from_pinocchio(model), model, np.zeros(2))


def test_a_scene_of_another_model() -> None:
    with pytest.raises(ArgumentError, match="scene: found no joint 'RX0'"):
        phipsi.pinocchio.to_state(phipsi.Scene.from_pinocchio(of("RZ")), of("RX"), np.zeros(1))


def test_planar_joints_in_motion() -> None:
    """With equal armature elsewhere: forces rotate with the body frame, and accelerations with the frame and its
    rotation.
    """
    model = of("RX", "planar", "RZ")
    scene, data, draw = phipsi.Scene.from_pinocchio(model), model.createData(), np.random.default_rng(4)
    q_there = pin.integrate(model, pin.neutral(model), draw.standard_normal(model.nv))
    v_there, tau_there = draw.standard_normal((2, model.nv))
    joint = model.joints[2]
    rows = slice(joint.idx_v, joint.idx_v + 3)
    acceleration = pin.aba(model, data, q_there, v_there, tau_there)
    u, v, turn = v_there[rows]
    acceleration[rows] += [-turn * v, turn * u, 0.0]
    q, qd = phipsi.pinocchio.to_state(scene, model, q_there, v_there)
    tau = phipsi.pinocchio.to_state(scene, model, q_there, tau_there)[1]
    expected = phipsi.pinocchio.to_state(scene, model, q_there, acceleration)[1]
    assert_near(scene.forward_dynamics(q, qd, tau), expected, inverse(float(np.linalg.cond(scene.mass_matrix(q))), size(expected)))


@pytest.mark.parametrize("what", ["armature", "friction"])
def test_planar_joints_with_losses_along_axes_of_the_body_are_refused(what: str) -> None:
    model = of("planar")
    model.armature[:] = 0.0
    assert phipsi.Scene.from_pinocchio(model).nv == 3
    if what == "armature":
        model.armature[:] = 0.1
    else:
        model.upperDryFrictionLimit[:], model.lowerDryFrictionLimit[:] = 0.1, -0.1
    with pytest.raises(SceneError, match=f"{what} 0.1 at the planar joint 'planar0'; expected zero, or the joints PX, PY and RZ"):
        phipsi.Scene.from_pinocchio(model)


def test_dry_friction_of_two_sizes_has_an_offset() -> None:
    model = of("RX")
    if not hasattr(model, "lowerDryFrictionLimit"):
        pytest.skip("this Pinocchio has one limit of dry friction")
    model.upperDryFrictionLimit[:], model.lowerDryFrictionLimit[:] = 0.2, -0.1
    joint = phipsi.Scene.from_pinocchio(model).joint("RX0")
    assert_near([joint.friction + joint.friction_offset, joint.friction - joint.friction_offset], [0.2, 0.1], 1e-15)


def test_made_up_names_do_not_clash() -> None:
    """A translation becomes three joints and two additional links; fixed bodies get a joint."""
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "move")
    second = model.addJoint(first, pin.JointModelRX(), pin.SE3.Identity(), "move_x")
    third = model.addJoint(second, pin.JointModelRX(), pin.SE3.Identity(), "tip/fixed")
    for joint in (first, second, third):
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.2, 0.3, 0.4), pin.SE3.Random())
    model.addBodyFrame("move/move_y", first, pin.SE3.Identity(), 0)
    model.addBodyFrame("move_x", first, pin.SE3.Random(), 0)
    model.addBodyFrame("move", third, pin.SE3.Random(), 0)
    model.addBodyFrame("tip", third, pin.SE3.Random(), 0)
    scene = phipsi.Scene.from_pinocchio(model)
    assert scene.joint_names == ("move_x_", "move_y", "move_z", "move_x", "tip/fixed")
    assert {"tip", "move", "move_x"} <= set(scene.link_names)
    q, _ = phipsi.pinocchio.to_state(scene, model, np.arange(5.0))
    assert q.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_operational_frames_are_links() -> None:
    model = of("RX", "RZ")
    frame = pin.Frame("tool", 2, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME)
    model.addFrame(frame)
    scene, data, q = phipsi.Scene.from_pinocchio(model), model.createData(), np.array([0.3, -0.4])
    pin.framesForwardKinematics(model, data, q)
    there = data.oMf[model.getFrameId("tool")].homogeneous
    assert_near(scene.placement(q, "tool"), there, recursion(scene.nv, size(there)))
