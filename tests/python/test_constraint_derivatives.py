"""Derivatives of forward dynamics with connections: compared with differences, products compared with matrices, and
refused arguments.
"""

from __future__ import annotations

from operator import attrgetter
import numpy as np
import pytest
from conftest import random_scene
from tolerances import STEP, assert_near, assert_same_bits, central_difference, inverse, size

import phipsi
from phipsi.errors import ArgumentError, ConstraintError


def bar(builder: phipsi.SceneBuilder, name: str, parent: str, at: tuple[float, float, float], length: float) -> None:
    builder.link(name, 1.0, (0.01, 0.02, length / 2), np.diag([length**2 / 12, length**2 / 12, 1e-3]))
    builder.joint(f"{name}_joint", "continuous", parent, name, xyz=at, axis=(0, 1, 0), armature=1e-3)


def four_bar(kind: str) -> tuple[phipsi.Scene, np.ndarray]:
    builder = phipsi.SceneBuilder().link("ground")
    bar(builder, "crank", "ground", (0, 0, 0), 0.2)
    bar(builder, "coupler", "crank", (0, 0, 0.2), 0.4)
    bar(builder, "rocker", "ground", (0.3, 0, 0), 0.3)
    if kind == "weld":
        # The rocker is attached to the coupler, and its foot is welded to a hinge on the ground.
        builder = phipsi.SceneBuilder().link("ground")
        bar(builder, "foot", "ground", (0.3, 0, 0), 0.1)
        bar(builder, "crank", "ground", (0, 0, 0), 0.2)
        bar(builder, "coupler", "crank", (0, 0, 0.2), 0.4)
        bar(builder, "rocker", "coupler", (0, 0, 0.4), 0.3)
        builder.connect("pin", "weld", "rocker", "foot", xyz=(0, 0, 0.3), other_xyz=(0, 0, 0.0))
        start = np.array([0.3, 0.5, 0.8, 1.9])
    elif kind == "distance":
        builder.connect("pin", "distance", "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0.0, 0.25), length=0.1)
        start = np.array([0.5, 0.8, 0.2])
    else:
        how = {"rpy": (np.pi / 2, 0, 0), "other_rpy": (np.pi / 2, 0, 0)} if kind == "axis" else {}
        builder.connect("pin", kind, "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.3), **how)
        start = np.array([0.5, 0.8, 0.2])
    scene = builder.build()
    return scene, start


def on_it(scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = scene.loops.project(q, qd)
    return found.q, found.qd


def tied(seed: int) -> phipsi.Scene:
    """A random tree with all types of joints and three connections between its links and the world."""
    tree = random_scene(seed, 9, branching=0.6, armature=0.1, floating_base=bool(seed % 2))
    builder, links = tree.to_builder(), tree.link_names
    random = np.random.default_rng(seed)
    # Frames that coincide in the neutral configuration; the last two links of the tree are not rigidly attached.
    builder.connect("ball", "point", links[-1], xyz=random.uniform(-0.2, 0.2, 3))
    builder.connect("rod", "distance", links[-2], links[2], xyz=random.uniform(-0.2, 0.2, 3), other_xyz=random.uniform(-0.2, 0.2, 3))
    return builder.build()


CASES = [*(("four-bar", kind) for kind in ("point", "axis", "weld", "distance")), *(("tree", seed) for seed in range(6))]


@pytest.fixture(params=CASES, ids=str)
def case(request: pytest.FixtureRequest) -> tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray]:
    which, of = request.param
    if which == "four-bar":
        scene, q = four_bar(of)
    else:
        scene = tied(of)
        q = scene.integrate(scene.neutral(), 0.1 * np.random.default_rng(of).uniform(-1.0, 1.0, scene.nv))
    random = np.random.default_rng(5)
    qd, tau = random.uniform(-0.5, 0.5, (2, scene.nv))
    return (scene, *on_it(scene, q, qd), tau)


def test_matrices_are_those_of_differences(case: tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray]) -> None:
    scene, q, qd, tau = case
    wrenches = {scene.link_names[-1]: np.array([0.1, -0.2, 0.3, 1.0, 2.0, -1.0])}

    def accelerations(*state: np.ndarray) -> np.ndarray:
        return scene.forward_dynamics(*state, wrenches=wrenches)

    found = scene.forward_dynamics_derivatives(q, qd, tau, wrenches=wrenches)
    scale = size(accelerations(q, qd, tau))
    for which in range(3):
        columns = []
        for unit in np.eye(scene.nv):
            ends = []
            for sign in (STEP, -STEP):
                state = [q, qd, tau]
                state[which] = scene.integrate(q, sign * unit) if which == 0 else state[which] + sign * unit
                ends.append(accelerations(*state))
            columns.append((ends[0] - ends[1]) / (2 * STEP))
        expected = np.stack(columns, axis=1)
        assert_near(found[which], expected, central_difference(3e3 * max(scale, size(expected))))
    assert np.any(found.dqdd_dq) and np.any(found.dqdd_dqd)


def test_the_third_is_the_inverse_through_the_connections(case: tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray]) -> None:
    scene, q, qd, tau = case
    found = scene.forward_dynamics_derivatives(q, qd, tau).mass_matrix_inverse
    assert_near(found, scene.loops.mass_matrix_inverse(q), 1e-12 * size(found))
    jacobian = scene.loops.jacobian(q)
    assert_near(jacobian @ found, np.zeros((len(jacobian), scene.nv)), inverse(1e4, size(jacobian) * size(found)))


def test_products_are_those_of_the_matrices(case: tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray]) -> None:
    scene, q, qd, tau = case
    dq, dqd, dtau, cotangent = np.random.default_rng(2).uniform(-1.0, 1.0, (4, scene.nv))
    matrices = scene.forward_dynamics_derivatives(q, qd, tau)
    bound = 1e-12 * size(*matrices) * scene.nv
    along = sum(matrix @ x for matrix, x in zip(matrices, (dq, dqd, dtau), strict=True))
    assert_near(scene.forward_dynamics_jvp(q, qd, tau, dq, dqd, dtau), along, bound)
    for one, matrix in zip(scene.forward_dynamics_vjp(q, qd, tau, cotangent)[:3], matrices, strict=True):
        assert_near(one, cotangent @ matrix, bound)


def test_products_of_a_batch_are_those_of_its_states(case: tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray]) -> None:
    """With the same bits, in lanes and in batches that do not fill them."""
    scene, q, qd, tau = case
    random = np.random.default_rng(8)
    states = [on_it(scene, scene.integrate(q, 0.05 * random.uniform(-1.0, 1.0, scene.nv)), qd) for _ in range(7)]
    many_q, many_qd = (np.array(of) for of in zip(*states, strict=True))
    dq, dqd, dtau, cotangent = random.uniform(-1.0, 1.0, (4, 7, scene.nv))
    wrench = random.uniform(-1.0, 1.0, (7, 6))
    link = scene.link_names[-1]
    along = scene.forward_dynamics_jvp(many_q, many_qd, tau, dq, dqd, dtau, wrenches={link: wrench})
    found = scene.forward_dynamics_vjp(many_q, many_qd, tau, cotangent, wrenches={link: wrench}, parameters=True)
    for i in range(7):
        state = many_q[i], many_qd[i], tau
        assert_same_bits(along[i], scene.forward_dynamics_jvp(*state, dq[i], dqd[i], dtau[i], wrenches={link: wrench[i]}))
        one = scene.forward_dynamics_vjp(*state, cotangent[i], wrenches={link: wrench[i]}, parameters=True)
        for name in ("q", "qd", "tau", "armature", "gravity", "parameters"):
            assert_same_bits(getattr(found, name)[i], getattr(one, name))
        assert_same_bits(found.wrenches[link][i], one.wrenches[link])


def test_products_through_a_row_given_twice() -> None:
    """The kernels leave dependent rows to the checked method."""
    (scene, start), random = four_bar("point"), np.random.default_rng(9)
    builder = scene.to_builder()
    builder.connect("again", "point", "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.3))
    twice = builder.build()
    q, qd = on_it(scene, start, random.uniform(-0.5, 0.5, 3))
    tau, cotangent = random.uniform(-1.0, 1.0, (2, 3))
    for one, other in zip(scene.forward_dynamics_vjp(q, qd, tau, cotangent)[:3], twice.forward_dynamics_vjp(q, qd, tau, cotangent)[:3], strict=True):
        assert_near(one, other, 1e-10 * size(one))
        assert np.any(one)


def test_a_batch_is_its_states() -> None:
    scene, q = four_bar("point")
    q, qd = on_it(scene, q, np.array([0.3, 0.1, -0.2]))
    many = scene.forward_dynamics_derivatives(np.tile(q, (5, 1)), qd, np.zeros(3))
    one = scene.forward_dynamics_derivatives(q, qd, np.zeros(3))
    for of_many, of_one in zip(many, one, strict=True):
        assert of_many.shape == (5, 3, 3)
        assert_near(of_many[4], of_one, 1e-14 * size(of_one))


def test_hessian_products_are_differences_of_gradients(case: tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray]) -> None:
    scene, q, qd, tau = case
    dq, dqd, dtau, cotangent = np.random.default_rng(7).uniform(-1.0, 1.0, (4, scene.nv))
    wrenches = {scene.link_names[-1]: np.array([0.1, -0.2, 0.3, 1.0, 2.0, -1.0])}

    def gradients(sign: float) -> list[np.ndarray]:
        moved = scene.integrate(q, sign * STEP * dq), qd + sign * STEP * dqd, tau + sign * STEP * dtau
        return list(scene.forward_dynamics_vjp(*moved, cotangent, wrenches=wrenches)[:3])

    found = scene.forward_dynamics_hvp(q, qd, tau, cotangent, dq, dqd, dtau, wrenches=wrenches)[:3]
    expected = [(ahead - behind) / (2 * STEP) for ahead, behind in zip(gradients(1.0), gradients(-1.0), strict=True)]
    scale = size(*gradients(0.0), *expected)
    for one, other in zip(found, expected, strict=True):
        assert_near(one, other, central_difference(3e3 * scale))
        assert np.any(one)


@pytest.mark.parametrize("of", ["point", "axis", "weld", "distance"])
def test_gradients_by_what_is_constant(of: str) -> None:
    """Wrenches and armature compared with differences; and accelerations do not change if inertias, torques, wrenches
    and armature are scaled together.
    """
    scene, start = four_bar(of)
    random = np.random.default_rng(3)
    qd, tau, cotangent = random.uniform(-0.5, 0.5, (3, scene.nv))
    q, qd = on_it(scene, start, qd)
    wrench = random.uniform(-1.0, 1.0, 6)
    found = scene.forward_dynamics_vjp(q, qd, tau, cotangent, wrenches={"coupler": wrench}, parameters=True)
    assert found.wrenches is not None and found.parameters is not None and found.armature is not None

    def weighed(wrench: np.ndarray, scene: phipsi.Scene = scene) -> float:
        return float(cotangent @ scene.forward_dynamics(q, qd, tau, wrenches={"coupler": wrench}))

    scale = size(scene.forward_dynamics(q, qd, tau, wrenches={"coupler": wrench}))
    expected = [(weighed(wrench + STEP * unit) - weighed(wrench - STEP * unit)) / (2 * STEP) for unit in np.eye(6)]
    assert_near(found.wrenches["coupler"], expected, central_difference(100 * scale))
    step = 1e-3 * STEP
    ends = [[weighed(wrench, scene.with_properties(armature={name: 1e-3 + sign * step})) for name in scene.joint_names] for sign in (1, -1)]
    by_armature = (np.array(ends[0]) - np.array(ends[1])) / (2 * step)
    assert_near(found.armature, by_armature, central_difference(1e6 * scale) + 1e-6 * size(by_armature))

    in_gravity = [scene.to_builder().build(gravity=scene.gravity + unit) for unit in np.eye(3)]
    by_gravity = [weighed(wrench, heavier) - weighed(wrench) for heavier in in_gravity]
    assert_near(found.gravity, by_gravity, inverse(1e4, 10 * scale))

    own = []
    for name in scene.body_names:
        link = scene.link(name)
        about = link.inertia + link.mass * (link.com @ link.com * np.eye(3) - np.outer(link.com, link.com))
        own.append([link.mass, *(link.mass * link.com), *about[np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])]])
    parts = [found.parameters * own, found.armature * scene.armature, found.tau * tau, found.wrenches["coupler"] * wrench]
    total = sum(float(np.sum(part)) for part in parts)
    assert_near(total, 0.0, inverse(1e3, size(*parts)))

    changes = {"dwrenches": {"coupler": wrench}, "darmature": random.uniform(size=scene.nv), "dgravity": random.uniform(size=3)}
    dparameters = random.uniform(size=found.parameters.shape)
    dq, dqd, dtau = random.uniform(-1.0, 1.0, (3, scene.nv))
    along = scene.forward_dynamics_jvp(q, qd, tau, dq, dqd, dtau, wrenches={"coupler": wrench}, dparameters=dparameters, **changes)
    pairs = [(found.q, dq), (found.qd, dqd), (found.tau, dtau), (found.wrenches["coupler"], wrench), (found.armature, changes["darmature"])]
    pairs += [(found.gravity, changes["dgravity"]), (found.parameters, dparameters)]
    terms = [np.asarray(gradient) * np.asarray(change) for gradient, change in pairs]
    assert_near(cotangent @ along, sum(float(np.sum(term)) for term in terms), inverse(1e3, size(*terms)))


@pytest.mark.parametrize("call", ["loops.dynamics", "forward_dynamics", "loops.inverse_dynamics", "forward_dynamics_derivatives", "linearize"])
def test_states_off_the_connections_are_refused(call: str) -> None:
    scene, q = four_bar("point")
    q, qd = on_it(scene, q, np.array([0.3, 0.1, -0.2]))
    method, zero = attrgetter(call)(scene), np.zeros(3)
    method(q, qd, zero)
    method(np.tile(q, (5, 1)), qd + 1e-5, zero)
    off = np.array([0.0, 0.1, 0.0])
    for argument, state in (("qd", (q, qd + off)), ("q", (q + off, qd))):
        with pytest.raises(ConstraintError, match=rf'"pin": found an error of .* at {argument}; .*scene.loops.project'):
            method(*state, zero)
        with pytest.raises(ConstraintError, match=f" in state 3: found an error of .* at {argument}"):
            method(np.stack([q, q, q, state[0]]), np.stack([qd, qd, qd, state[1]]), zero)


def test_a_coupling_that_is_not_met_is_refused() -> None:
    builder = phipsi.scenes.chain(3).to_builder()
    names = phipsi.scenes.chain(3).joint_names
    scene = builder.couple("gears", names[1], names[2], multiplier=2.0, offset=0.1).build()
    q, qd, zero = np.array([0.3, 0.5, 0.2]), np.array([0.2, 0.4, 0.2]), np.zeros(3)
    scene.loops.dynamics(np.tile(q, (5, 1)), qd, zero)
    for argument, state in (("q", (q + [0.0, 0.01, 0.0], qd)), ("qd", (q, qd + [0.0, 0.01, 0.0]))):
        with pytest.raises(ConstraintError, match=f'"gears": found an error of 1.0e-2 .* at {argument}'):
            scene.loops.dynamics(*state, zero)
        scene.loops.dynamics(*state, zero, compliance=0.1)
