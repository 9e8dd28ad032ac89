"""Laws of mechanics on trees drawn by hypothesis: all types of joints, branching, armature, velocities and wrenches
together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from oracle_mpmath import KINDS, Joint, Link, Tree
from tolerances import STEP, assert_near, assert_same_bits, central_difference, inverse, product, size

import phipsi

law = settings(
    deadline=None, derandomize=True, database=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow]
)


def rotation(random: np.random.Generator) -> np.ndarray:
    q, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def body(random: np.random.Generator, name: str) -> Link:
    a, b, c = random.uniform(0.01, 0.05, 3)
    frame = rotation(random)
    inertia = frame @ np.diag([b + c, a + c, a + b]) @ frame.T
    return Link(name, random.uniform(0.5, 2.0), random.uniform(-0.3, 0.3, 3), 0.5 * (inertia + inertia.T))


@dataclass
class Case:
    """A tree, its scene, and a state; its string representation is the input for shrinking."""

    tree: Tree
    seed: int

    def __post_init__(self) -> None:
        self.scene = self.tree.scene()
        self.random = np.random.default_rng(self.seed)
        n = self.scene.nv
        self.q = self.scene.integrate(self.scene.neutral(), self.random.uniform(-2.0, 2.0, n))
        self.qd, self.qdd, self.tau = self.random.uniform(-2.0, 2.0, (3, n))
        self.wrenches = {link: self.random.uniform(-3.0, 3.0, 6) for link in self.scene.link_names[::2]}
        self.m = self.scene.mass_matrix(self.q)
        self.condition = float(np.linalg.cond(self.m)) if n else 1.0

    def __repr__(self) -> str:
        joints = ", ".join(f"{j.kind} {j.parent} -> {j.child}{' armature' * (j.armature > 0)}" for j in self.tree.joints)
        return f"Case({joints}; floating_base={self.tree.floating_base}, seed={self.seed})"

    def accelerations(self) -> np.ndarray:
        return self.scene.forward_dynamics(self.q, self.qd, self.tau, wrenches=self.wrenches)

    def torques(self) -> np.ndarray:
        return self.scene.inverse_dynamics(self.q, self.qd, self.qdd, wrenches=self.wrenches)

    def pushed(self) -> np.ndarray:
        """Joint torques of the wrenches."""
        torques = [self.scene.jacobian(self.q, link).T @ wrench for link, wrench in self.wrenches.items()]
        return np.sum(torques, axis=0)

    def moved(self, qdd: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        """The state a short time later; the error of the configuration is of third order in a central difference."""
        return self.scene.integrate(self.q, h * self.qd), self.qd + h * qdd

    def third_derivative(self, qdd: np.ndarray) -> float:
        """Bound for a function of the state along `moved`, relative to the function: three velocities, or two
        changes of velocities.
        """
        return size(self.qd) ** 3 + size(qdd) ** 2

    def torque_scale(self) -> float:
        return size(self.tau, self.scene.bias_torque(self.q, self.qd), self.pushed(), self.m * size(self.qdd))

    def acceleration_bound(self, *qdd: np.ndarray) -> float:
        """Bound for accelerations; cond(M) does not include the cancellation of torques, such as those of gravity and a
        motor.
        """
        spread = float(np.linalg.norm(np.linalg.inv(self.m), 2)) * self.torque_scale()
        return max(inverse(self.condition, size(*qdd)), product(1, spread))


@st.composite
def cases(
    draw: st.DrawFn, floating_base: bool | None = None, gravity: tuple[float, float, float] = (0.3, -0.5, -9.6)
) -> Case:
    """Up to seven joints of any type, each on any previous link; the values come from a seed."""
    kinds = draw(st.lists(st.sampled_from(KINDS), min_size=1, max_size=7))
    parents = [draw(st.integers(0, k)) for k in range(len(kinds))]
    seed = draw(st.integers(0, 2**16))
    armature = draw(st.booleans())
    floating = draw(st.booleans()) if floating_base is None else floating_base
    random = np.random.default_rng(seed)
    links = [body(random, f"link{k}") for k in range(len(kinds) + 1)]
    joints = [
        Joint(
            f"joint{k}", kind, f"link{parent}", f"link{k + 1}", random.uniform(-0.5, 0.5, 3), rotation(random),
            random.normal(size=3), 0.2 if kind == "screw" else None,
            random.uniform(0.1, 0.5) if armature and kind != "fixed" else 0.0,
        )
        for k, (kind, parent) in enumerate(zip(kinds, parents, strict=True))
    ]  # fmt: skip
    case = Case(Tree(tuple(links), tuple(joints), gravity, floating), seed)
    assume(case.scene.nv > 0)
    return case


def of_quaternion(q: np.ndarray) -> np.ndarray:
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The product of quaternions (x, y, z, w)."""
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(vector, a[3] * b[3] - a[:3] @ b[:3])


@law
@given(cases())
def test_forward_undoes_inverse_and_inverse_undoes_forward(case: Case) -> None:
    scene, q, qd = case.scene, case.q, case.qd
    qdd = case.accelerations()
    tau = scene.inverse_dynamics(q, qd, qdd, wrenches=case.wrenches)
    assert_near(tau, case.tau, inverse(case.condition, case.torque_scale()))
    back = scene.forward_dynamics(q, qd, case.torques(), wrenches=case.wrenches)
    assert_near(back, case.qdd, case.acceleration_bound(case.qdd, qdd))


@law
@given(cases())
def test_the_mass_matrix_is_a_covariance(case: Case) -> None:
    """Symmetric and positive definite, like the inverse; larger than the armature alone."""
    n, m, inverted = case.scene.nv, case.m, case.scene.mass_matrix_inverse(case.q)
    assert_same_bits(m, m.T)
    assert_same_bits(inverted, inverted.T)
    smallest, largest = np.linalg.eigvalsh(m)[[0, -1]]
    armature = [joint.armature for joint in case.tree.order for _ in range(joint.nv)]
    assert smallest > 0.0
    assert smallest >= min(armature) - product(n, largest)
    assert np.linalg.eigvalsh(inverted)[0] > 0.0
    assert_near(m @ inverted, np.eye(n), inverse(case.condition, 1.0))


@law
@given(cases())
def test_energy_changes_by_the_power_of_torques_and_wrenches(case: Case) -> None:
    qdd = case.accelerations()
    after, before = (sum(case.scene.energy(*case.moved(qdd, h))) for h in (STEP, -STEP))
    power = case.qd @ (case.tau + case.pushed())
    scale = size(*case.scene.energy(case.q, case.qd)) * case.third_derivative(qdd)
    assert_near((after - before) / (2 * STEP), power, central_difference(scale))


@law
@given(cases(floating_base=True, gravity=(0.0, 0.0, 0.0)))
def test_momentum_of_a_free_system_changes_by_the_wrenches_alone(case: Case) -> None:
    case.tau[:6] = 0.0
    qdd = case.accelerations()
    after, before = (case.scene.momentum(*case.moved(qdd, h)) for h in (STEP, -STEP))
    expected = np.zeros(6)
    for link, at in case.scene.placements(case.q).items():
        if link in case.wrenches:
            moment, force = at[:3, :3] @ case.wrenches[link][:3], at[:3, :3] @ case.wrenches[link][3:]
            expected += np.concatenate([moment + np.cross(at[:3, 3], force), force])
    scale = size(case.scene.momentum(case.q, case.qd), expected) * case.third_derivative(qdd)
    assert_near((after - before) / (2 * STEP), expected, central_difference(scale))


@law
@given(cases(), st.integers(1, 9))
def test_batches_are_singles(case: Case, states: int) -> None:
    """Bitwise, independent of lanes and threads of a batch."""
    scene, n = case.scene, case.scene.nv
    q = scene.integrate(scene.neutral(), case.random.uniform(-2.0, 2.0, (states, n)))
    qd, x = case.random.uniform(-2.0, 2.0, (2, states, n))
    wrenches = {link: case.random.uniform(-3.0, 3.0, (states, 6)) for link in scene.link_names[::2]}
    batch = [
        scene.forward_dynamics(q, qd, x, wrenches=wrenches),
        scene.inverse_dynamics(q, qd, x, wrenches=wrenches),
        scene.mass_matrix(q),
        scene.mass_matrix_inverse(q),
        scene.momentum(q, qd),
    ]
    for i in range(states):
        each = {link: wrench[i] for link, wrench in wrenches.items()}
        singles = [
            scene.forward_dynamics(q[i], qd[i], x[i], wrenches=each),
            scene.inverse_dynamics(q[i], qd[i], x[i], wrenches=each),
            scene.mass_matrix(q[i]),
            scene.mass_matrix_inverse(q[i]),
            scene.momentum(q[i], qd[i]),
        ]
        for whole, single in zip(batch, singles, strict=True):
            assert_same_bits(whole[i], single, f"state {i}")


@law
@given(cases(), st.integers(-12, 12))
def test_units_of_mass_cancel(case: Case, power: int) -> None:
    """All masses, inertias, armatures, torques and wrenches times 4^k: bitwise equal accelerations."""
    factor = 4.0**power
    links = tuple(replace(link, mass=factor * link.mass, inertia=factor * link.inertia) for link in case.tree.links)
    joints = tuple(replace(joint, armature=factor * joint.armature) for joint in case.tree.joints)
    scene = replace(case.tree, links=links, joints=joints).scene()
    wrenches = {link: factor * wrench for link, wrench in case.wrenches.items()}
    qdd = scene.forward_dynamics(case.q, case.qd, factor * case.tau, wrenches=wrenches)
    assert_same_bits(qdd, case.accelerations())
    tau = scene.inverse_dynamics(case.q, case.qd, case.qdd, wrenches=wrenches)
    assert_same_bits(tau, factor * case.torques())
    assert_same_bits(scene.mass_matrix(case.q), factor * case.m)


@law
@given(cases(), st.randoms(use_true_random=False))
def test_the_order_in_the_file_does_not_matter(case: Case, shuffler: object) -> None:
    joints, links = list(case.tree.joints), list(case.tree.links)
    shuffler.shuffle(joints)  # type: ignore[attr-defined]
    shuffler.shuffle(links)  # type: ignore[attr-defined]
    scene = replace(case.tree, links=tuple(links), joints=tuple(joints)).scene()
    assert set(scene.joint_names) == set(case.scene.joint_names)
    rows = np.concatenate([np.r_[case.scene.v_index(name)] for name in scene.joint_names])
    q = case.q[np.concatenate([np.r_[case.scene.q_index(name)] for name in scene.joint_names])]
    n = scene.nv
    m = case.m[np.ix_(rows, rows)]
    assert_near(scene.mass_matrix(q), m, product(n, size(m)))
    tau = case.torques()[rows]
    found = scene.inverse_dynamics(q, case.qd[rows], case.qdd[rows], wrenches=case.wrenches)
    assert_near(found, tau, product(n, case.torque_scale()))
    qdd = case.accelerations()[rows]
    found = scene.forward_dynamics(q, case.qd[rows], case.tau[rows], wrenches=case.wrenches)
    assert_near(found, qdd, case.acceleration_bound(qdd))


@law
@given(cases(), st.integers(0, 2**16))
def test_the_frame_of_the_base_does_not_matter(case: Case, seed: int) -> None:
    """Base and gravity rotated and moved together: equal torques and accelerations."""
    random = np.random.default_rng(seed)
    turn = random.normal(size=4)
    turn /= np.linalg.norm(turn)
    matrix, step = of_quaternion(turn), random.uniform(-1.0, 1.0, 3)
    joints, q = case.tree.joints, case.q.copy()
    if case.tree.floating_base:
        q[:3], q[3:7] = matrix @ q[:3] + step, times(turn, q[3:7])
    else:
        root = case.tree.links[0].name
        joints = tuple(
            replace(joint, rotation=matrix @ joint.rotation, xyz=matrix @ joint.xyz + step) if joint.parent == root else joint
            for joint in joints
        )
    gravity = tuple(float(g) for g in matrix @ case.tree.gravity)
    scene = replace(case.tree, joints=joints, gravity=gravity).scene()
    # A wrench on the root of a fixed base has no effect, so that its frame does not matter.
    tau = scene.inverse_dynamics(q, case.qd, case.qdd, wrenches=case.wrenches)
    assert_near(tau, case.torques(), product(scene.nv, case.torque_scale()))
    qdd = scene.forward_dynamics(q, case.qd, case.tau, wrenches=case.wrenches)
    assert_near(qdd, case.accelerations(), case.acceleration_bound(qdd))
    assert_near(scene.mass_matrix(q), case.m, product(scene.nv, size(case.m)))


@law
@given(cases(), st.integers(0, 2**16))
def test_a_link_cut_in_two_and_welded_is_the_link(case: Case, seed: int) -> None:
    """Half of each link moved to a new one on a fixed joint: the merged body is the same."""
    random = np.random.default_rng(seed)
    links, joints = [], list(case.tree.joints)
    for link in case.tree.links:
        frame, xyz = rotation(random), random.uniform(-0.5, 0.5, 3)
        links.append(replace(link, mass=0.5 * link.mass, inertia=0.5 * link.inertia))
        inertia = 0.5 * frame.T @ link.inertia @ frame
        half = Link(f"{link.name}b", 0.5 * link.mass, frame.T @ (link.com - xyz), 0.5 * (inertia + inertia.T))
        links.append(half)
        joints.append(Joint(f"{link.name} weld", "fixed", link.name, half.name, xyz, frame))
    scene = replace(case.tree, links=tuple(links), joints=tuple(joints)).scene()
    assert scene.joint_names == case.scene.joint_names
    assert_near(scene.mass_matrix(case.q), case.m, product(scene.nv, size(case.m)))
    tau = scene.inverse_dynamics(case.q, case.qd, case.qdd, wrenches=case.wrenches)
    assert_near(tau, case.torques(), product(scene.nv, case.torque_scale()))
    qdd = scene.forward_dynamics(case.q, case.qd, case.tau, wrenches=case.wrenches)
    assert_near(qdd, case.accelerations(), case.acceleration_bound(qdd))


@law
@given(cases())
def test_accelerations_superpose(case: Case) -> None:
    """Forward dynamics is affine in the torques, with slope M^-1."""
    scene, q, qd = case.scene, case.q, case.qd
    first, second, both, none = scene.forward_dynamics(
        q, qd, np.stack([case.tau, case.qdd, case.tau + case.qdd, np.zeros(scene.nv)])
    )
    bound = case.acceleration_bound(first, second, both, none)
    assert_near(both + none, first + second, bound)
    assert_near(first - none, scene.mass_matrix_inverse(q) @ case.tau, bound)


@law
@given(cases())
def test_integrate_follows_one_motion(case: Case) -> None:
    scene, q, n = case.scene, case.q, case.scene.nv
    v = case.random.uniform(-1.0, 1.0, n)
    reached = scene.integrate(q, v)
    bound = product(n, size(q, reached))
    assert_near(scene.difference(q, reached), v, bound)
    assert_near(scene.difference(q, scene.integrate(q, np.zeros(n))), np.zeros(n), bound)
    # Twice half of the displacement, and back again; quaternions may have changed their sign.
    assert_near(scene.difference(scene.integrate(scene.integrate(q, 0.5 * v), 0.5 * v), reached), np.zeros(n), bound)
    assert_near(scene.difference(scene.integrate(reached, -v), q), np.zeros(n), bound)
    other = scene.integrate(scene.neutral(), case.random.uniform(-2.0, 2.0, n))
    arrived = scene.integrate(q, scene.difference(q, other))
    assert_near(scene.difference(arrived, other), np.zeros(n), product(n, 4.0 * size(q, other)))
    for joint in case.tree.order:
        if joint.nq != joint.nv:
            quaternion = arrived[scene.q_index(joint.name)][-4:]
            assert_near(np.linalg.norm(quaternion), 1.0, product(1, 1.0))


@law
@given(cases())
def test_scenes_survive_locking_nothing(case: Case) -> None:
    """A scene with no locked joint computes bitwise equal results: its description is complete."""
    scene = case.scene.lock([], case.q)
    assert isinstance(scene, phipsi.Scene)
    assert_same_bits(
        scene.forward_dynamics(case.q, case.qd, case.tau, wrenches=case.wrenches), case.accelerations()
    )
