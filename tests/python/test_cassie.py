"""A biped whose legs are loops of rods, like Cassie's: dynamics compared with a dense solution with 60 digits and with
Pinocchio's constraintDynamics, and simulation.

Each leg has seven hinges from the hip to the foot and one to the foot crank, with a spring at the shin, and two rods.
The achilles rod is attached to the thigh by a ball joint and ends at the tarsus: a body, or a distance without mass.
The plantar rod connects the foot crank with the foot: a planar loop, two of whose three constraints are independent.
Dimensions and masses are similar to Cassie's.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
import pytest
from oracle_mpmath import Joint, Link, State, Tree, exact, mpf, rounded, skew, zeros
from tolerances import assert_near, assert_same_bits, inverse, size

import phipsi

SIDES = {"left": 1.0, "right": -1.0}
#: Actuated joints of each leg.
MOTORS = ("roll", "yaw", "pitch", "knee", "foot")
#: Stiffness of the shin springs, N m/rad.
STIFFNESS = 1500.0

#: Whether achilles rods are bodies, and the number of independent constraints.
RODS = pytest.mark.parametrize(("are_bodies", "rank"), [(True, 10), (False, 6)], ids=["bodies", "distances"])


def about_z(degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def axes(x: tuple[int, int, int], y: tuple[int, int, int]) -> np.ndarray:
    """Rotation to the frame with these axes."""
    return np.column_stack([x, y, np.cross(x, y)]).astype(float)


def bar(mass: float, length: float, thickness: float) -> np.ndarray:
    """The inertia of a bar along x."""
    across = mass * (length**2 + thickness**2) / 12
    return np.diag([mass * thickness**2 / 6, across, across])


class Leg:
    """Positions in a leg, by side: +1 left, -1 right."""

    def __init__(self, side: float) -> None:
        #: Hinges from thigh to knee, knee to shin and shin to tarsus, each in the frame of the previous link.
        self.knee, self.shin, self.tarsus = (0.12, 0.0, 0.0045 * side), (0.061, 0.047, 0.0), (0.435, 0.02, 0.0)
        #: Ends of the achilles rod, in the frames of thigh and tarsus.
        self.ball, self.heel = np.array([0.0, 0.0, 0.045 * side]), np.array([-0.12, -0.03, 0.001 * side])
        #: The achilles rod in the configuration with all joints at zero, in the thigh frame.
        self.rod = np.array(self.knee) + about_z(-45) @ (np.array(self.shin) + np.array(self.tarsus) + about_z(58) @ self.heel) - self.ball
        self.length = float(np.linalg.norm(self.rod))


@cache
def tree(are_bodies: bool) -> Tree:
    """The joints without the connections of the rods, which are closed with all joints at zero."""
    links = [Link("pelvis", 10.3, np.array([0.05, 0.0, 0.03]), np.diag([0.09, 0.05, 0.09]))]
    joints: list[Joint] = []
    straight = np.eye(3)
    for name, side in SIDES.items():
        leg = Leg(side)
        across = np.cross([0.0, 0.0, 1.0], leg.rod)
        along = np.column_stack([v / np.linalg.norm(v) for v in (leg.rod, across, np.cross(leg.rod, across))])
        for joint, parent, child, xyz, rotation, armature, mass, com, shape in (
            ("roll", "pelvis", "hip", (0.02, 0.135 * side, 0.0), axes((0, 0, -1), (0, 1, 0)), 0.04, 1.8, (-0.02, 0.0, -0.04), (0.1, 0.1)),
            ("yaw", "hip", "upper thigh", (0.0, 0.0, -0.07), axes((0, 0, 1), (0, 1, 0)), 0.04, 1.2, (0.0, 0.0, -0.03), (0.1, 0.1)),
            ("pitch", "upper thigh", "thigh", (0.0, 0.0, -0.09), axes((0, 0, -1), (1, 0, 0)), 0.09, 5.5, (0.06, 0.0, -0.036 * side), (0.2, 0.12)),
            ("ball", "thigh", "achilles", leg.ball, along, 0.0, 0.16, (0.25, 0.0, 0.0), (0.5, 0.01)),
            ("knee", "thigh", "lower thigh", leg.knee, about_z(-45), 0.09, 0.9, (0.03, 0.04, 0.0), (0.1, 0.05)),
            ("spring", "lower thigh", "shin", leg.shin, straight, 0.0, 0.6, (0.18, 0.0, 0.0), (0.43, 0.05)),
            ("ankle", "shin", "tarsus", leg.tarsus, about_z(58), 0.0, 0.9, (0.11, -0.03, -0.001 * side), (0.42, 0.05)),
            ("crank hinge", "tarsus", "crank", (0.058, -0.034, 0.023 * side), about_z(-35), 0.0, 0.13, (0.005, 0.0, -0.002 * side), (0.05, 0.02)),
            ("rod hinge", "crank", "plantar", (0.055, 0.0, -0.008 * side), about_z(35), 0.0, 0.12, (0.18, 0.0, 0.0), (0.35, 0.01)),
            ("foot", "tarsus", "sole", (0.408, -0.04, 0.0), straight, 0.012, 0.15, (0.005, 0.027, 0.0), (0.1, 0.03)),
        ):
            kind = "spherical" if joint == "ball" else "continuous"
            if joint == "ball" and not are_bodies:
                continue
            links.append(Link(f"{name} {child}", mass, np.array(com), bar(mass, *shape)))
            before = parent if parent == "pelvis" else f"{name} {parent}"
            joints.append(Joint(f"{name} {joint}", kind, before, f"{name} {child}", np.array(xyz), rotation, armature=armature))
    return Tree(tuple(links), tuple(joints), floating_base=True)


@cache
def biped(are_bodies: bool) -> phipsi.Scene:
    builder = tree(are_bodies).scene().to_builder()
    for name, side in SIDES.items():
        leg = Leg(side)
        builder.connect(f"{name} plantar", "point", f"{name} plantar", f"{name} sole", xyz=(0.35, 0.0, 0.0))
        if are_bodies:
            builder.connect(f"{name} achilles", "point", f"{name} achilles", f"{name} tarsus", xyz=(leg.length, 0.0, 0.0), other_xyz=leg.heel)
        else:
            builder.connect(f"{name} achilles", "distance", f"{name} thigh", f"{name} tarsus", xyz=leg.ball, other_xyz=leg.heel)
    return builder.build()


def moving(scene: phipsi.Scene, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A state that satisfies the connections, and the torques of motors and springs."""
    random = np.random.default_rng(seed)
    q = scene.integrate(scene.neutral(), random.uniform(-0.2, 0.2, scene.nv))
    q, qd, _ = scene.loops.project(q, random.uniform(-1.0, 1.0, scene.nv))
    assert qd is not None
    tau = np.zeros(scene.nv)
    for side in SIDES:
        for motor in MOTORS:
            tau[scene.v_index(f"{side} {motor}")] = random.uniform(-10.0, 10.0)
        tau[scene.v_index(f"{side} spring")] = -STIFFNESS * q[scene.q_index(f"{side} spring")]
    return q, qd, tau


# Oracle


def ends(scene: phipsi.Scene) -> list[tuple[str, str, str, str, np.ndarray, np.ndarray]]:
    """Name, kind, both links and both points of each connection, from the pickle of the scene."""
    description = scene.__reduce__()[1][0]
    return [(name, kind, link, other, np.array(first[1]), np.array(second[1])) for name, kind, _, _, _, link, other, first, second in description[-1][1]]


def rows(state: State, scene: phipsi.Scene) -> tuple[np.ndarray, np.ndarray, dict[str, slice]]:
    """J, and J qdd for velocities that satisfy the constraints: of the second end relative to the first link, or of the
    distance of the ends.
    """

    def point(link: str, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose, Jacobian and acceleration for qdd = 0, in the base frame."""
        lever = state.rotation[link] @ exact(at)
        omega, alpha = state.angular[link] @ state.qd, state.angular_bias[link]
        bias = state.linear_bias[link] + skew(alpha) @ lever + skew(omega) @ (skew(omega) @ lever)
        return state.position[link] + lever, state.linear[link] - skew(lever) @ state.angular[link], bias

    jacobians, right, where, at = [], [], {}, 0
    for name, kind, link, other, first, second in ends(scene):
        (here, moves, bias), (there, moves_other, bias_other) = point(link, first), point(other, second)
        apart, relative, drift = there - here, moves_other - moves, bias_other - bias
        if kind == "point":
            # The first link rotates, which changes vectors expressed in its frame.
            omega, alpha = state.angular[link] @ state.qd, state.angular_bias[link]
            relative = relative + skew(apart) @ state.angular[link]
            drift = drift - skew(alpha) @ apart - skew(omega) @ (skew(omega) @ apart + 2 * (relative @ state.qd))
            jacobians.append(state.rotation[link].T @ relative)
            right.append(-(state.rotation[link].T @ drift))
        else:
            distance = np.sqrt(apart @ apart)
            along, rate = apart / distance, relative @ state.qd
            jacobians.append((along @ relative)[None, :])
            right.append(np.array([-(along @ drift) - (rate @ rate - (along @ rate) ** 2) / distance]))
        where[name] = slice(at, at + len(jacobians[-1]))
        at = where[name].stop
    return np.concatenate(jacobians), np.concatenate(right), where


def solved(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, int]:
    """A solution of A x = b, with A symmetric positive semidefinite, and the rank of A: elimination with the largest
    pivots, down to the rounding error of 60 digits.
    """
    a, b, kept = a.copy(), b.copy(), []
    largest = max(abs(a[i, i]) for i in range(len(b)))
    while True:
        pivot = max((i for i in range(len(b)) if i not in kept), key=lambda i: a[i, i], default=None)
        if pivot is None or a[pivot, pivot] < largest * mpf(10) ** -40:
            break
        kept.append(pivot)
        for i in range(len(b)):
            if i not in kept:
                factor = a[i, pivot] / a[pivot, pivot]
                a[i], b[i] = a[i] - factor * a[pivot], b[i] - factor * b[pivot]
    x = zeros(len(b))
    for at in reversed(kept):
        x[at] = (b[at] - sum(a[at, j] * x[j] for j in kept if j != at)) / a[at, at]
    return x, len(kept)


@RODS
@pytest.mark.parametrize("seed", range(3))
def test_accelerations_and_forces_are_those_of_dense_algebra(are_bodies: bool, rank: int, seed: int) -> None:
    scene = biped(are_bodies)
    q, qd, tau = moving(scene, seed)
    state = State(tree(are_bodies), q, qd)
    jacobian, right, where = rows(state, scene)
    free = state.inverse @ (exact(tau) - state.bias_torque)
    through = state.inverse @ jacobian.T
    forces, expected_rank = solved(jacobian @ through, right - jacobian @ free)
    qdd = free + through @ forces
    # It satisfies the system, including redundant rows.
    assert max(abs(x) for x in jacobian @ qdd - right) < mpf(10) ** -35
    found = scene.loops.dynamics(q, qd, tau)
    assert found.rank == expected_rank == rank

    singular = np.linalg.svd(rounded(jacobian @ through), compute_uv=False)[:rank]
    condition = float(singular[0] / singular[-1])
    assert_near(found.qdd, rounded(qdd), inverse(condition, size(rounded(qdd))))
    for name, kind, *_ in ends(scene):
        # For a point, the force of the first link on the second has the opposite sign.
        expected = rounded(forces[where[name]]) * (-1.0 if kind == "point" else 1.0)
        assert_near(found.forces[name], expected, inverse(condition, size(rounded(forces))))
    assert found.residual < inverse(condition, size(rounded(qdd), tau))
    assert_same_bits(scene.forward_dynamics(q, qd, tau), found.qdd)


def of_pinocchio(scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Accelerations of Pinocchio, whose joints have the order of the tree."""
    pin = pytest.importorskip("pinocchio")
    model, ids = pin.Model(), {"": 0}
    model.gravity.linear[:] = scene.gravity
    robot = tree(True)
    inertias = {link.name: pin.Inertia(link.mass, link.com, link.inertia) for link in robot.links}
    kinds = {"floating": pin.JointModelFreeFlyer, "spherical": pin.JointModelSpherical, "continuous": pin.JointModelRZ}
    for joint in robot.order:
        ids[joint.child] = model.addJoint(ids[joint.parent], kinds[joint.kind](), pin.SE3(joint.rotation, joint.xyz), joint.name)
        model.appendBodyToJoint(ids[joint.child], inertias[joint.child], pin.SE3.Identity())
        at = model.joints[ids[joint.child]].idx_v
        model.armature[at : at + joint.nv] = joint.armature
    contacts, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for _, _, link, other, *points in ends(scene):
        parts = [part for body, point in zip((link, other), points, strict=True) for part in (ids[body], pin.SE3(np.eye(3), point))]
        contacts.append(pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, *parts, pin.ReferenceFrame.LOCAL))
        datas.append(contacts[-1].createData())
    data = model.createData()
    pin.initConstraintDynamics(model, data, contacts, datas)
    return np.array(pin.constraintDynamics(model, data, q, qd, tau, contacts, datas, pin.ProximalSettings(1e-15, 1e-15, 1e-8, 30)))


@pytest.mark.parametrize("seed", range(6))
def test_accelerations_are_those_of_pinocchio(seed: int) -> None:
    scene = biped(True)
    q, qd, tau = moving(scene, seed)
    found, expected = scene.loops.dynamics(q, qd, tau).qdd, of_pinocchio(scene, q, qd, tau)
    error = np.abs(found - expected).max() / np.abs(expected).max()
    print(f"{seed}: {error:.1e}")
    assert error < 1e-11


@RODS
def test_its_legs_stay_closed_as_it_moves(are_bodies: bool, rank: int) -> None:
    """In free fall, with springs at the shins: energy is conserved, and the center of mass moves like a point mass."""
    scene = biped(are_bodies)
    scene = scene.with_properties(stiffness={f"{side} spring": STIFFNESS for side in SIDES})
    q, qd, _ = moving(scene, 7)
    path = scene.simulate(q, qd, dt=2e-4, steps=500, record_every=100, method="rk4")
    assert path.drift.max() < 1e-13
    energy = path.energy().total
    assert np.abs(energy - energy[0]).max() < 1e-6 * size(scene.kinetic_energy(q, qd))
    push = scene.momentum(q, qd)[3:] / scene.total_mass
    times = path.t[:, None]
    fall = push * times + np.array(scene.gravity) * times**2 / 2
    assert_near(scene.center_of_mass(path.q) - scene.center_of_mass(q), fall, 1e-9)
    assert np.abs(path.q[-1] - q).max() > 0.1
    assert scene.loops.dynamics(path.q[-1], path.qd[-1], np.zeros(scene.nv)).rank == rank


#: Angle of the knees with all joints at zero, in MuJoCo's coordinates, rad.
ZERO = -0.7


def of_mujoco() -> str:
    """The biped with rods as bodies, as MJCF."""
    robot, scene = tree(True), biped(True)
    links = {link.name: link for link in robot.links}

    def numbers(values: Iterable[float]) -> str:
        return " ".join(repr(float(x)) for x in values)

    def body(joint: Joint) -> str:
        link = links[joint.child]
        axes_of = numbers([*joint.rotation[:, 0], *joint.rotation[:, 1]])
        moments = numbers(link.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        kind = {"floating": "free", "spherical": "ball", "continuous": "hinge"}[joint.kind]
        zero = f'ref="{ZERO}"' if joint.name.endswith("knee") else ""
        inside = "".join(body(other) for other in robot.order if other.parent == joint.child)
        return (
            f'<body name="{joint.child}" pos="{numbers(joint.xyz)}" xyaxes="{axes_of}"><joint name="{joint.name}" type="{kind}" armature="{joint.armature}" {zero}/>'
            f'<inertial pos="{numbers(link.com)}" mass="{link.mass}" fullinertia="{moments}"/>{inside}</body>'
        )

    ties = "".join(f'<connect name="{name}" body1="{link}" body2="{other}" anchor="{numbers(first)}"/>' for name, _, link, other, first, _ in ends(scene))
    return f'<mujoco><compiler angle="radian"/><worldbody>{body(robot.order[0])}</worldbody><equality>{ties}</equality></mujoco>'


def test_it_is_read_from_mujoco() -> None:
    """The same accelerations as dense algebra with MuJoCo's mass matrix and constraints, at rest."""
    mujoco = pytest.importorskip("mujoco")
    import phipsi.mujoco

    scene, text = biped(True), of_mujoco()
    read = phipsi.Scene.from_mujoco(text)
    assert read.joint_names == scene.joint_names and read.loops.names == scene.loops.names
    q, qd, tau = moving(scene, 11)
    there = q.copy()
    for side in SIDES:
        there[scene.q_index(f"{side} knee")] += ZERO
    expected = scene.loops.dynamics(q, qd, tau)
    found = read.loops.dynamics(there, qd, tau)
    assert found.rank == 10
    assert_near(found.qdd, expected.qdd, 1e-11 * size(expected.qdd))

    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:], _ = phipsi.mujoco.from_state(read, there, np.zeros(read.nv))
    mujoco.mj_forward(model, data)
    mass, jacobian = np.zeros((model.nv, model.nv)), np.zeros((data.nefc, model.nv))
    mujoco.mj_fullM(model, data, mass)
    if mujoco.mj_isSparse(model):
        mujoco.mju_sparse2dense(jacobian, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    else:
        jacobian[:] = data.efc_J.reshape(jacobian.shape)
    assert len(jacobian) == 12
    free = np.linalg.solve(mass, phipsi.mujoco.from_forces(read, there, tau) - data.qfrc_bias)
    through = np.linalg.solve(mass, jacobian.T)
    dense = free - through @ np.linalg.lstsq(jacobian @ through, jacobian @ free, rcond=1e-10)[0]
    ours = phipsi.mujoco.from_accelerations(read, there, np.zeros(read.nv), read.loops.dynamics(there, np.zeros(read.nv), tau).qdd)
    assert_near(ours, dense, 1e-9 * size(dense))
