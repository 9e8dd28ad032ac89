"""Scene.linearize: the linear system of the motion that simulate computes, with springs and damping, compared with
differences of forward dynamics under the torques of the definition, and with short simulations.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import phipsi
import pytest
from conftest import KINDS
from phipsi.errors import BadStateWarning, NotFiniteError, ShapeError
from tolerances import STEP, assert_near, assert_same_bits, central_difference, product, size

Torque = Callable[[np.ndarray, np.ndarray], np.ndarray]
#: A scene, a state (q, qd, tau), and the torque of springs and damping by definition.
Case = tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray, Torque]


def rotation_vector(rest: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The rotation by at most pi from one quaternion (x, y, z, w) to another, in the frame of both ends."""
    q = q if rest @ q > 0.0 else -q
    vector = rest[3] * q[:3] - q[3] * rest[:3] - np.cross(rest[:3], q[:3])
    scalar = float(rest @ q)
    sine = float(np.linalg.norm(vector))
    return 2.0 * np.arctan2(sine, scalar) / sine * vector


def rotated_back(q: np.ndarray, x: np.ndarray) -> np.ndarray:
    """x in the axes of the child of a rotation q."""
    return x - 2.0 * q[3] * np.cross(q[:3], x) + 2.0 * np.cross(q[:3], np.cross(q[:3], x))


def displacement(kind: str, rest: np.ndarray, q: np.ndarray) -> np.ndarray:
    """From the rest position, as documented for springs: in the child frame for spherical and free joints."""
    if kind == "spherical":
        return rotation_vector(rest, q)
    if kind == "floating":
        return np.concatenate([rotated_back(q[3:], q[:3] - rest[:3]), rotation_vector(rest[3:], q[3:])])
    return q - rest


def torque_of(scene: phipsi.Scene) -> Torque:
    """-k (q - rest) - d qd, joint by joint."""

    def torque(q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        found = -scene.damping * qd
        for name in scene.joint_names:
            v, of_q = scene.v_index(name), scene.q_index(name)
            found[v] -= scene.stiffness[v] * displacement(scene.joint(name).type, scene.rest[of_q], q[of_q])
        return found

    return torque


def tree(floating_base: bool = False) -> Case:
    """All types of joints with springs, rest positions and damping."""
    random = np.random.default_rng(3)
    builder = phipsi.SceneBuilder().link("base", 2.0, inertia=np.eye(3) * 0.2)
    for k, kind in enumerate(kind for kind in (*KINDS, "universal") if kind != "fixed"):
        rest = random.uniform(-0.5, 0.5, {"spherical": 4, "planar": 3, "universal": 2, "floating": 7}.get(kind, 1))
        if kind in ("spherical", "floating"):
            rest[-4:] /= np.linalg.norm(rest[-4:])
        axis = {} if kind in ("spherical", "floating", "universal") else {"axis": random.normal(size=3)}
        builder.link(f"link{k}", random.uniform(0.5, 2.0), random.uniform(-0.2, 0.2, 3), np.diag(random.uniform(0.03, 0.05, 3)))
        builder.joint(
            f"joint{k}", kind, f"link{random.integers(k)}" if k else "base", f"link{k}", xyz=random.uniform(-0.4, 0.4, 3),
            pitch=0.2 if kind == "screw" else None, damping=random.uniform(0.1, 0.5), stiffness=random.uniform(1.0, 5.0), rest=rest, **axis,
        )  # fmt: skip
    scene = builder.build(floating_base=floating_base)
    if floating_base:
        scene = scene.with_properties(damping={"root_joint": 0.3}, stiffness={"root_joint": 2.0})
    q = scene.integrate(scene.neutral(), random.uniform(-1.0, 1.0, scene.nv))
    return scene, q, *random.uniform(-1.0, 1.0, (2, scene.nv)), torque_of(scene)


def mimic() -> Case:
    """Two joints follow the first of four, which have springs and damping, also the followers."""
    builder = phipsi.SceneBuilder().link("link0")
    follows = {2: (-0.5, 0.1), 3: (2.0, 0.0)}
    for k in range(1, 5):
        ratio, offset = follows.get(k, (1.0, 0.0))
        builder.link(f"link{k}", 1.0, (0.1, 0.0, 0.2), np.diag([0.03, 0.04, 0.02]))
        builder.joint(
            f"joint{k}", "revolute", f"link{k - 1}", f"link{k}", xyz=(0.1, 0, 0.3), axis=(0, 1, 0.2 * k), damping=0.1 * k, stiffness=1.0 + k, rest=0.2 * k,
            mimic="joint1" if k in follows else None, mimic_multiplier=ratio, mimic_offset=offset,
        )  # fmt: skip
    g = np.array([[1.0, 0.0], [-0.5, 0.0], [2.0, 0.0], [0.0, 1.0]])
    offsets, k = np.array([0.0, 0.1, 0.0, 0.0]), np.arange(1.0, 5.0)

    def torque(q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return -g.T @ ((1.0 + k) * (g @ q + offsets - 0.2 * k) + 0.1 * k * (g @ qd))

    return builder.build(mimic="couple"), np.array([0.3, -0.4]), np.array([0.5, 1.0]), np.array([0.2, -0.3]), torque


def loop() -> Case:
    """A four-bar linkage whose joints have springs and damping."""
    builder = phipsi.SceneBuilder().link("ground")
    for k, (name, parent, at, length) in enumerate((("crank", "ground", (0, 0, 0), 0.2), ("coupler", "crank", (0, 0, 0.2), 0.4), ("rocker", "ground", (0.3, 0, 0), 0.3))):
        builder.link(name, 1.0, (0.01, 0.02, length / 2), np.diag([length**2 / 12, length**2 / 12, 1e-3]))
        builder.joint(f"{name}_joint", "continuous", parent, name, xyz=at, axis=(0, 1, 0), armature=1e-3, damping=0.1 + 0.1 * k, stiffness=2.0 + k, rest=0.1 * k)
    builder.connect("pin", "point", "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.3))
    scene = builder.build()
    found = scene.loops.project([0.5, 0.8, 0.2], [0.3, -0.2, 0.1])
    return scene, found.q, found.qd, np.array([0.2, -0.1, 0.3]), torque_of(scene)


CASES = {"tree": tree, "floating base": lambda: tree(floating_base=True), "mimic": mimic, "loop": loop}


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]()


def differences(scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray, of: Torque) -> np.ndarray:
    """The derivatives of a function by q, in its tangent space, and by qd, concatenated."""
    columns = []
    for unit in STEP * np.eye(scene.nv):
        columns.append(of(scene.integrate(q, unit), qd) - of(scene.integrate(q, -unit), qd))
    for unit in STEP * np.eye(scene.nv):
        columns.append(of(q, qd + unit) - of(q, qd - unit))
    return np.stack(columns, axis=-1) / (2.0 * STEP)


def test_springs_and_damping_are_part_of_the_system(case: Case) -> None:
    scene, q, qd, tau, torque = case
    a, b = scene.linearize(q, qd, tau)
    expected = differences(scene, q, qd, lambda q, qd: scene.forward_dynamics(q, qd, tau + torque(q, qd)))
    scale = size(scene.forward_dynamics(q, qd, tau + torque(q, qd)), expected)
    assert_near(a[scene.nv :], expected, central_difference(1e3 * scale))
    bare = scene.linearize(q, qd, tau, springs_and_damping=False)
    assert_same_bits(b, bare.B)
    for block in (slice(None, scene.nv), slice(scene.nv, None)):
        # Both the springs and the damping change entries by much more than the bound.
        assert size(a[scene.nv :, block] - bare.A[scene.nv :, block]) > 1.0 + central_difference(1e3 * scale)


def test_without_them_it_is_that_of_forward_dynamics(case: Case) -> None:
    scene, q, qd, tau, _ = case
    n = scene.nv
    a, b = scene.linearize(q, qd, tau, springs_and_damping=False)
    by_q, by_qd, inverse = scene.forward_dynamics_derivatives(q, qd, tau)
    assert_same_bits(a[n:], np.hstack([by_q, by_qd]))
    assert_same_bits(b[n:], inverse)
    if len(scene.body_names) == len(scene.joint_names):  # the properties of followers cannot be changed
        plain = scene.with_properties(damping=0.0, stiffness=0.0)
        assert_same_bits(plain.linearize(q, qd, tau).A, a)


@pytest.mark.parametrize("which", ["tree", "floating base", "mimic"])
def test_it_is_the_linearization_of_simulate(which: str) -> None:
    scene, q, qd, tau, _ = CASES[which]()

    def change(h: float) -> Torque:
        return lambda q, qd: (scene.simulate(q, qd, tau=tau, dt=h, steps=1, method="rk4", limits="report").qd[-1] - qd) / h

    h = 2e-4
    # The mean acceleration of a step and that at its start differ by a term proportional to h.
    expected = 2.0 * differences(scene, q, qd, change(h / 2)) - differences(scene, q, qd, change(h))
    found = scene.linearize(q, qd, tau).A[scene.nv :]
    assert_near(found, expected, central_difference(1e5 * size(expected)))


def test_a_batch_is_its_states_and_keeps_broadcasting(case: Case) -> None:
    scene, q, qd, tau, _ = case
    wrenches = {scene.link_names[-1]: np.random.default_rng(1).normal(size=(2, 1, 6))}
    found = scene.linearize(q, qd, np.stack([tau, 2.0 * tau, -tau]), wrenches=wrenches)
    assert found.A.shape == (2, 3, 2 * scene.nv, 2 * scene.nv) and found.B.shape == (2, 3, 2 * scene.nv, scene.nv)
    one = scene.linearize(q, qd, -tau, wrenches={name: w[1, 0] for name, w in wrenches.items()})
    assert_near(found.A[1, 2], one.A, product(10, size(one.A)))


def test_states_that_cannot_be_computed() -> None:
    scene, q, qd, tau, _ = tree()
    with pytest.raises(ShapeError, match="tau: found shape"):
        scene.linearize(q, qd, tau[:-1])
    broken = np.stack([q, q, q])
    broken[1, 0] = np.nan
    with pytest.raises(NotFiniteError, match="q"):
        scene.linearize(broken, qd, tau)
    with pytest.warns(BadStateWarning, match="1 of 3 states") as caught:
        found = scene.linearize(broken, qd, tau, errors="nan")
    assert len(caught) == 1
    assert np.isnan(found.A[1]).all() and np.isnan(found.B[1]).all() and np.isfinite(found.A[[0, 2]]).all()
    with pytest.raises(NotFiniteError, match="tau with springs and damping"):
        phipsi.scenes.chain(1).with_properties(damping=1e200).linearize([0.1], [1e200], [0.0])
