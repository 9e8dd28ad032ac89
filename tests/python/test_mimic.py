"""Coupled joints, mimic="couple": compared with 60 digits and with Pinocchio, which reduces coordinates too; and
operations on such scenes.
"""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from oracle_mpmath import State, Tree, exact, random_tree, rounded, zeros
from oracle_pinocchio import ROBOTS, Oracle, urdf_files
from tolerances import STEP, assert_near, assert_same_bits, central_difference, inverse, product, recursion, size

import phipsi
from phipsi.errors import ArgumentError, MimicWarning, NotFiniteError, SceneError, ShapeError

ONE_AXIS = ("revolute", "continuous", "prismatic", "screw")
FILES = [file for file in urdf_files() if "<mimic" in (ROBOTS / file).read_text(encoding="utf-8", errors="replace")]
BROKEN = {"alex_description/urdf/alex_psyonic_hands.urdf": "index_q1"}
"""Files whose mimic joints refer to joints that do not exist."""


def builder_of(tree: Tree, follows: dict[str, tuple[str, float, float]]) -> phipsi.SceneBuilder:
    """A tree with coupled joints: names to (joint, multiplier, offset)."""
    builder = phipsi.SceneBuilder()
    for link in tree.links:
        builder.link(link.name, link.mass, link.com, link.inertia)
    for j in tree.joints:
        mimic, multiplier, offset = follows.get(j.name, (None, 1.0, 0.0))
        builder.joint(
            j.name, j.kind, j.parent, j.child, xyz=j.xyz, rotation=j.rotation, axis=j.axis, pitch=j.pitch, armature=j.armature,
            mimic=mimic, mimic_multiplier=multiplier, mimic_offset=offset,
        )  # fmt: skip
    return builder


class Case:
    """A random tree with followers, its scene, the scene of the tree, and q = G q' + o."""

    def __init__(self, seed: int, joints: int = 9, **how: object) -> None:
        random = np.random.default_rng(seed)
        kinds = (*ONE_AXIS, *ONE_AXIS, "spherical", "fixed")
        self.tree = random_tree(random, joints, kinds=kinds, most=14, armature=0.2, floating_base=bool(seed % 3 == 0), **how)
        one = [j.name for j in self.tree.joints if j.kind in ONE_AXIS]
        order = list(random.permutation(one))
        # The first joint is a leader; the next ones follow a previous joint, possibly a follower.
        self.follows: dict[str, tuple[str, float, float]] = {}
        for at, name in enumerate(order[1:], 1):
            if random.uniform() < 0.6:
                ratio, offset = random.uniform(-2.0, 2.0), random.uniform(-0.5, 0.5)
                self.follows[name] = (str(order[random.integers(at)]), float(ratio), float(offset))
        builder = builder_of(self.tree, self.follows)
        make = {"floating_base": self.tree.floating_base, "gravity": self.tree.gravity}
        self.scene = builder.build(mimic="couple", **make)
        self.free = self.tree.scene()
        self.g, self.o = self.reduction()
        self.q = self.scene.integrate(self.scene.neutral(), random.uniform(-1.5, 1.5, self.scene.nv))
        self.qd, self.qdd, self.tau = random.uniform(-1.5, 1.5, (3, self.scene.nv))
        self.wrenches = {link: random.uniform(-3.0, 3.0, 6) for link in self.scene.link_names[::2]}
        self.m = self.scene.mass_matrix(self.q)
        self.condition = float(np.linalg.cond(self.m))

    def source(self, name: str) -> tuple[str, object, object]:
        ratio, offset = exact([1.0])[0], exact([0.0])[0]
        while name in self.follows:
            name, k, o = self.follows[name]
            offset, ratio = offset + ratio * exact([o])[0], ratio * exact([k])[0]
        return name, ratio, offset

    def reduction(self) -> tuple[np.ndarray, np.ndarray]:
        """G (nv of the tree x nv) and o, by coordinate of one-axis joints, with 60 digits."""
        g, o = zeros(self.free.nv, self.scene.nv), zeros(self.free.nv)
        for name in self.free.joint_names:
            of_tree = self.free.v_index(name)
            source, ratio, offset = self.source(name)
            own = self.scene.v_index(source)
            for i in range(of_tree.stop - of_tree.start):
                g[of_tree.start + i, own.start + i] = ratio
            o[of_tree.start] = offset
        return g, o

    def expanded(self, q: np.ndarray) -> np.ndarray:
        full = zeros(self.free.nq)
        for name in self.free.joint_names:
            source, ratio, offset = self.source(name)
            values = exact(q[self.scene.q_index(source)])
            full[self.free.q_index(name)] = values if source == name else ratio * values + offset
        return full

    def state(self) -> State:
        return State(self.tree, self.expanded(self.q), self.g @ exact(self.qd))

    def exact_accelerations(self) -> np.ndarray:
        state = self.state()
        m = self.g.T @ state.mass_matrix @ self.g
        right = exact(self.tau) - self.g.T @ (state.bias_torque - state.applied(self.wrenches))
        return rounded(solved(m, right))


def solved(m: np.ndarray, b: np.ndarray) -> np.ndarray:
    """m^-1 b by elimination, m positive definite."""
    m, b = m.copy(), b.copy()
    n = len(b)
    for k in range(n):
        for i in range(k + 1, n):
            ratio = m[i, k] / m[k, k]
            m[i, k:] = m[i, k:] - ratio * m[k, k:]
            b[i] = b[i] - ratio * b[k]
    for k in reversed(range(n)):
        b[k] = (b[k] - m[k, k + 1 :] @ b[k + 1 :]) / m[k, k]
    return b


@pytest.fixture(params=range(24))
def case(request: pytest.FixtureRequest) -> Case:
    return Case(request.param)


def test_coordinates_are_fewer(case: Case) -> None:
    assert case.scene.nv == case.free.nv - len(case.follows)
    assert set(case.scene.joint_names) == set(case.free.joint_names) - set(case.follows)
    assert case.scene.link_names == case.free.link_names
    assert np.linalg.matrix_rank(rounded(case.g)) == case.scene.nv


def test_m_is_g_m_g_in_60_digits(case: Case) -> None:
    m = case.g.T @ case.state().mass_matrix @ case.g
    assert_near(case.m, rounded(m), product(case.free.nv, size(case.m)))
    inverted = case.scene.mass_matrix_inverse(case.q)
    unit = np.eye(case.scene.nv)
    columns = np.stack([rounded(solved(m, exact(column))) for column in unit], axis=1)
    assert_near(inverted, columns, inverse(case.condition, size(columns)))
    assert_same_bits(inverted, inverted.T)


def test_torques_in_60_digits(case: Case) -> None:
    state, qdd = case.state(), case.g @ exact(case.qdd)
    tau = rounded(case.g.T @ state.inverse_dynamics(qdd, case.wrenches))
    found = case.scene.inverse_dynamics(case.q, case.qd, case.qdd, wrenches=case.wrenches)
    assert_near(found, tau, recursion(case.free.nv, size(tau)))
    bias = rounded(case.g.T @ state.bias_torque)
    assert_near(case.scene.bias_torque(case.q, case.qd), bias, recursion(case.free.nv, size(bias)))


@pytest.mark.parametrize("form", ["auto", "covariance", "square-root"])
def test_accelerations_in_60_digits(case: Case, form: str) -> None:
    qdd = case.exact_accelerations()
    found = case.scene.forward_dynamics(case.q, case.qd, case.tau, wrenches=case.wrenches, form=form)
    assert_near(found, qdd, inverse(case.condition, size(qdd)))


def test_links_move_as_those_of_the_tree(case: Case) -> None:
    full = rounded(case.expanded(case.q))
    rates = rounded(case.g @ exact(case.qd))
    bound = product(case.free.nv, 4.0)
    for link, placement in case.free.placements(full).items():
        assert_near(case.scene.placement(case.q, link), placement, bound)
        jacobian = case.free.jacobian(full, link) @ rounded(case.g)
        assert_near(case.scene.jacobian(case.q, link), jacobian, 4 * bound)
        velocity = case.free.velocity(full, rates, link)
        assert_near(case.scene.velocity(case.q, case.qd, link), velocity, 16 * bound)
    for name in ("center_of_mass_velocity", "momentum"):
        here, there = getattr(case.scene, name)(case.q, case.qd), getattr(case.free, name)(full, rates)
        assert_near(here, there, 16 * bound * size(there))
    assert_near(case.scene.centroidal_momentum_matrix(case.q) @ case.qd, case.free.centroidal_momentum_matrix(full) @ rates, 64 * bound)
    assert_near(
        np.asarray(case.scene.energy(case.q, case.qd)), np.asarray(case.free.energy(full, rates)), 64 * bound * size(case.m)
    )


def test_kinetic_energy_is_that_of_m(case: Case) -> None:
    assert_near(case.scene.kinetic_energy(case.q, case.qd), 0.5 * case.qd @ case.m @ case.qd, product(case.free.nv, 4 * size(case.m)))


def differences(case: Case, function: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray], u: np.ndarray) -> list[np.ndarray]:
    """Derivatives with respect to the tangent of q, qd and u, by column."""
    n, found = case.scene.nv, []
    for which in range(3):
        columns = []
        for j in range(n):
            step = STEP * np.eye(n)[j]
            ends = []
            for sign in (1.0, -1.0):
                q = case.scene.integrate(case.q, sign * step) if which == 0 else case.q
                qd = case.qd + sign * step * (which == 1)
                ends.append(function(q, qd, u + sign * step * (which == 2)))
            columns.append((ends[0] - ends[1]) / (2 * STEP))
        found.append(np.stack(columns, axis=1))
    return found


@pytest.mark.parametrize("seed", range(8))
def test_derivatives_are_those_of_differences(seed: int) -> None:
    case = Case(seed)
    inverses = case.scene.inverse_dynamics_derivatives(case.q, case.qd, case.qdd, wrenches=case.wrenches)
    by_hand = differences(case, lambda q, qd, u: case.scene.inverse_dynamics(q, qd, u, wrenches=case.wrenches), case.qdd)
    for one, other in zip(inverses, by_hand, strict=True):
        assert_near(one, other, central_difference(16 * size(other)))
    forward = case.scene.forward_dynamics_derivatives(case.q, case.qd, case.tau, wrenches=case.wrenches)
    by_hand = differences(case, lambda q, qd, u: case.scene.forward_dynamics(q, qd, u, wrenches=case.wrenches), case.tau)
    for one, other in zip(forward, by_hand, strict=True):
        assert_near(one, other, central_difference(16 * case.condition * size(other)))


@pytest.mark.parametrize("seed", range(8))
def test_products_are_those_of_the_matrices(seed: int) -> None:
    case = Case(seed)
    n = case.scene.nv
    dq, dqd, du, cotangent = np.random.default_rng(seed).uniform(-1.0, 1.0, (4, n))
    for kind, u in (("inverse", case.qdd), ("forward", case.tau)):
        by_q, by_qd, by_u = getattr(case.scene, f"{kind}_dynamics_derivatives")(case.q, case.qd, u)
        jvp = getattr(case.scene, f"{kind}_dynamics_jvp")(case.q, case.qd, u, dq, dqd, du)
        vjp = getattr(case.scene, f"{kind}_dynamics_vjp")(case.q, case.qd, u, cotangent)
        scale = inverse(case.condition, n * size(by_q, by_qd, by_u))
        assert_near(jvp, by_q @ dq + by_qd @ dqd + by_u @ du, scale)
        for one, matrix in zip(vjp[:3], (by_q, by_qd, by_u), strict=True):
            assert_near(one, cotangent @ matrix, scale)


@pytest.mark.parametrize("solved_for", ["forward", "inverse"])
def test_gradients_by_constants_are_those_of_the_tree(case: Case, solved_for: str) -> None:
    """By dense algebra: c . qdd' has the gradients of -x . tau of the tree at G qdd', with x = G (G^T M G)^-1 c."""
    c = np.random.default_rng(3).uniform(-1.0, 1.0, case.scene.nv)
    g, q, qd = rounded(case.g), rounded(case.expanded(case.q)), rounded(case.g @ exact(case.qd))
    if solved_for == "forward":
        qdd, co_state = case.exact_accelerations(), -np.linalg.solve(case.m, c)
        found = case.scene.forward_dynamics_vjp(case.q, case.qd, case.tau, c, wrenches=case.wrenches, parameters=True)
    else:
        qdd, co_state = case.qdd, c
        found = case.scene.inverse_dynamics_vjp(case.q, case.qd, case.qdd, c, wrenches=case.wrenches, parameters=True)
    of_tree = case.free.inverse_dynamics_vjp(q, qd, g @ qdd, g @ co_state, wrenches=case.wrenches, parameters=True)
    scale = inverse(64 * case.condition, size(qdd) * size(co_state))
    for name in ("q", "qd"):
        assert_near(getattr(found, name), getattr(of_tree, name) @ g, scale * size(getattr(of_tree, name)))
    # The order of the links may differ.
    order = [case.free.body_names.index(name) for name in case.scene.body_names]
    assert_near(found.parameters, of_tree.parameters[order], scale * size(of_tree.parameters))
    assert_near(found.gravity, of_tree.gravity, scale * size(of_tree.gravity))
    assert_near(found.armature, co_state * qdd, scale * size(co_state * qdd))
    for link in case.wrenches:
        assert_near(found.wrenches[link], of_tree.wrenches[link], scale * size(of_tree.wrenches[link]))


@pytest.mark.parametrize("solved_for", ["forward", "inverse"])
def test_changes_of_constants_are_those_of_the_gradients(case: Case, solved_for: str) -> None:
    random = np.random.default_rng(4)
    u, n, bodies = case.tau if solved_for == "forward" else case.qdd, case.scene.nv, len(case.scene.body_names)
    c, zero, dq, dqd, du, darmature = *random.uniform(-1.0, 1.0, (1, n)), np.zeros(n), *random.uniform(-1.0, 1.0, (4, n))
    dparameters, dgravity = random.uniform(-1.0, 1.0, (bodies, 10)), random.uniform(-1.0, 1.0, 3)
    dwrenches = {link: random.uniform(-1.0, 1.0, 6) for link in case.wrenches}
    vjp, jvp = (getattr(case.scene, f"{solved_for}_dynamics_{kind}") for kind in ("vjp", "jvp"))
    by = vjp(case.q, case.qd, u, c, wrenches=case.wrenches, parameters=True)
    of_wrenches = [(by.wrenches[link], change) for link, change in dwrenches.items()]
    pairs = {
        "dparameters": [(by.parameters, dparameters)], "darmature": [(by.armature, darmature)], "dgravity": [(by.gravity, dgravity)],
        "dwrenches": of_wrenches,
    }  # fmt: skip
    changes = {"dparameters": dparameters, "darmature": darmature, "dgravity": dgravity, "dwrenches": dwrenches}
    scale = inverse(64 * case.condition, size(*by[:3], by.parameters, by.armature, by.gravity, *by.wrenches.values()) * 100)
    for name, change in changes.items():
        along = jvp(case.q, case.qd, u, zero, zero, zero, wrenches=case.wrenches, **{name: change})
        assert_near(c @ along, sum(np.sum(gradient * of) for gradient, of in pairs[name]), scale)
    along = jvp(case.q, case.qd, u, dq, dqd, du, wrenches=case.wrenches, **changes)
    of_state = sum(np.dot(gradient, of) for gradient, of in zip(by[:3], (dq, dqd, du), strict=True))
    assert_near(c @ along, of_state + sum(np.sum(gradient * of) for of_name in pairs.values() for gradient, of in of_name), scale)


@pytest.mark.parametrize("seed", range(8))
def test_hessian_products_are_those_of_differences(seed: int) -> None:
    case = Case(seed)
    c, dq, dqd, du = np.random.default_rng(seed).uniform(-1.0, 1.0, (4, case.scene.nv))
    for kind, u in (("inverse", case.qdd), ("forward", case.tau)):
        hvp, vjp = (getattr(case.scene, f"{kind}_dynamics_{name}") for name in ("hvp", "vjp"))
        found = hvp(case.q, case.qd, u, c, dq, dqd, du, wrenches=case.wrenches)
        ends = []
        for sign in (1.0, -1.0):
            q = case.scene.integrate(case.q, sign * STEP * dq)
            ends.append(vjp(q, case.qd + sign * STEP * dqd, u + sign * STEP * du, c, wrenches=case.wrenches))
        for name in ("q", "qd", ("tau" if kind == "forward" else "qdd")):
            by_hand = (getattr(ends[0], name) - getattr(ends[1], name)) / (2 * STEP)
            # The third derivatives are as large as the square of the condition number.
            assert_near(getattr(found, name), by_hand, central_difference(64 * case.condition**2 * size(by_hand)))


def test_the_inverse_of_m_is_symmetric(case: Case) -> None:
    third = case.scene.forward_dynamics_derivatives(case.q, case.qd, case.tau).mass_matrix_inverse
    assert_same_bits(third, third.T)
    assert_near(third, case.scene.mass_matrix_inverse(case.q), inverse(case.condition, size(third)))


def test_linearize_has_the_blocks(case: Case) -> None:
    n = case.scene.nv
    a, b = case.scene.linearize(case.q, case.qd, case.tau)
    by_q, by_qd, minv = case.scene.forward_dynamics_derivatives(case.q, case.qd, case.tau)
    assert_same_bits(a[n:], np.hstack([by_q, by_qd]))
    assert_same_bits(b[n:], minv)
    assert_same_bits(a[:n, n:], np.eye(n))
    spherical = [name for name in case.scene.joint_names if case.scene.joint(name).type == "spherical"]
    assert bool(np.any(a[:n, :n])) == bool(spherical or case.tree.floating_base)


def test_coriolis_matrix(case: Case) -> None:
    c = case.scene.coriolis_matrix(case.q, case.qd)
    rate = case.scene.mass_matrix_derivative(case.q, case.qd)
    assert_near(rate, c + c.T, product(case.free.nv, size(c)))
    weightless = case.scene.bias_torque(case.q, case.qd) - case.scene.gravity_torque(case.q)
    assert_near(c @ case.qd, weightless, recursion(case.free.nv, 16 * size(weightless, case.scene.gravity_torque(case.q))))


def test_batches_are_their_states(case: Case) -> None:
    random = np.random.default_rng(1)
    rates = random.uniform(-1.0, 1.0, (3, 11, case.scene.nv))
    q = case.scene.integrate(case.scene.neutral(), rates[0])
    for name in ("forward_dynamics", "inverse_dynamics", "inverse_dynamics_derivatives", "forward_dynamics_derivatives"):
        method = getattr(case.scene, name)
        many = np.asarray(method(q, rates[1], rates[2]))
        each = np.stack([np.asarray(method(q[i], rates[1, i], rates[2, i])) for i in range(11)])
        each = each if many.shape == each.shape else np.swapaxes(each, 0, 1)
        # Fused multiply-add may be used in lanes and not for one state.
        assert_near(many, each, inverse(1e3 * case.condition, size(each)))


def test_products_of_batches_are_those_of_their_states(case: Case) -> None:
    random = np.random.default_rng(2)
    q = case.scene.integrate(case.scene.neutral(), random.uniform(-1.0, 1.0, (11, case.scene.nv)))
    given = random.uniform(-1.0, 1.0, (5, 11, case.scene.nv))
    for name, count in (("mass_matrix_inverse", 0), ("forward_dynamics_vjp", 3), ("forward_dynamics_jvp", 5)):
        method = getattr(case.scene, name)
        results = [method(q, *given[:count]), *(method(q[i], *given[:count, i]) for i in range(11))]
        many, *each = [np.hstack([np.asarray(x).reshape(len(q) if i == 0 else 1, -1) for x in (r[:3] if isinstance(r, tuple) else [r])]) for i, r in enumerate(results)]
        assert_near(many, np.vstack(each), inverse(1e3 * case.condition, size(many)))


def test_float32(case: Case) -> None:
    found = case.scene.inverse_dynamics(case.q, case.qd, case.qdd, dtype=np.float32)
    expected = case.scene.inverse_dynamics(case.q, case.qd, case.qdd)
    assert found.dtype == np.float32 and np.array_equal(found, expected.astype(np.float32))


# Real robots


@pytest.mark.parametrize("file", FILES)
def test_real_robots_as_pinocchio(file: str) -> None:
    if file in BROKEN:
        with pytest.raises(SceneError, match=f'{BROKEN[file]}", which does not exist'):
            phipsi.Scene.from_urdf(ROBOTS / file, mimic="couple")
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = phipsi.Scene.from_urdf(ROBOTS / file, mimic="couple")
        free = phipsi.Scene.from_urdf(ROBOTS / file)
    followers = [name for name in free.joint_names if free.joint(name).mimic is not None]
    # Some files have fixed joints with a mimic element, which has no meaning.
    assert scene.nv == free.nv - len(followers)
    try:
        oracle = Oracle(file, False, scene, mimic=True)
    except ValueError as error:
        # Pinocchio requires the leader to be inboard; phipsi does not.
        assert "not in the kinematic tree" in str(error)
        return
    assert oracle.model.nv == scene.nv
    random = np.random.default_rng(scene.nv)
    q, qd, qdd = random.uniform(-1.0, 1.0, (3, scene.nv))
    there = oracle.configuration(q)
    order = oracle.v_order
    moved = np.empty((2, scene.nv))
    moved[:, order] = qd, qdd
    tau = pin.rnea(oracle.model, oracle.data, there, *moved)[order]
    assert_near(scene.inverse_dynamics(q, qd, qdd), tau, recursion(free.nv, size(tau)))
    upper = np.triu(pin.crba(oracle.model, oracle.data, there))
    m = (upper + np.triu(upper, 1).T)[np.ix_(order, order)]
    assert_near(scene.mass_matrix(q), m, product(free.nv, size(m)))
    condition = float(np.linalg.cond(m))
    if condition < 1e12:
        solution = np.linalg.solve(m, tau - scene.bias_torque(q, qd))
        assert_near(scene.forward_dynamics(q, qd, tau), solution, inverse(condition, 4 * size(solution)))


def test_some_real_robots_are_compared() -> None:
    assert len(FILES) >= 10


# Meaning


def test_a_mimic_of_a_mimic_is_a_mimic(case: Case) -> None:
    direct = {name: (source, float(ratio), float(offset)) for name in case.follows for source, ratio, offset in [case.source(name)]}
    make = {"floating_base": case.tree.floating_base, "gravity": case.tree.gravity}
    scene = builder_of(case.tree, direct).build(mimic="couple", **make)
    assert scene.joint_names == case.scene.joint_names
    assert_near(scene.mass_matrix(case.q), case.m, product(case.free.nv, 4 * size(case.m)))


def test_a_multiplier_of_zero_locks(case: Case) -> None:
    held = {name: (source, 0.0, 0.25) for name, (source, _, _) in case.follows.items()}
    make = {"floating_base": case.tree.floating_base, "gravity": case.tree.gravity}
    scene = builder_of(case.tree, held).build(mimic="couple", **make)
    q = case.free.neutral()
    for name in held:
        q[case.free.q_index(name)] = 0.25
    locked = case.free.lock(list(held), q)
    at = scene.neutral()
    rates = np.linspace(-1.0, 1.0, scene.nv)
    found, expected = scene.forward_dynamics(at, rates, rates), locked.forward_dynamics(at, rates, rates)
    # Rotors of locked joints are at rest in both.
    condition = float(np.linalg.cond(locked.mass_matrix(at)))
    assert_near(found, expected, inverse(condition, size(expected)))


def test_locking_a_joint_locks_its_followers(case: Case) -> None:
    name = next(iter({source for source, _, _ in map(case.source, case.follows)}), None)
    if name is None:
        pytest.skip("nothing follows")
    locked = case.scene.lock([name], case.q)
    assert locked.nv == case.scene.nv - 1
    kept = [i for i in range(case.scene.nv) if i != case.scene.v_index(name).start]
    q = np.concatenate([case.q[case.scene.q_index(j)] for j in locked.joint_names])
    assert_near(locked.mass_matrix(q), case.m[np.ix_(kept, kept)], product(case.free.nv, 16 * size(case.m)))


def test_scenes_remember(case: Case) -> None:
    make = case.scene.to_builder()
    for scene in (pickle.loads(pickle.dumps(case.scene)), make.build(), case.scene.with_properties(damping=0.1)):
        assert scene.nv == case.scene.nv
        assert_same_bits(scene.mass_matrix(case.q), case.m)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MimicWarning)
        assert make.build(mimic="free").nv == case.free.nv


def test_properties_are_those_of_the_coordinate() -> None:
    builder = phipsi.SceneBuilder().link("base").link("a", 1.0, (0.1, 0.0, 0.0)).link("b", 1.0, (0.2, 0.0, 0.0))
    builder.joint("a_joint", "revolute", "base", "a", armature=0.5, damping=1.0, friction=2.0, stiffness=3.0, rest=0.1)
    builder.joint(
        "b_joint", "revolute", "base", "b", mimic="a_joint", mimic_multiplier=-2.0, mimic_offset=0.3, armature=0.25, damping=0.5,
        friction=1.0, stiffness=2.0, rest=-0.4,
    )  # fmt: skip
    scene = builder.build(mimic="couple")
    assert_near(scene.armature, [0.5 + 4 * 0.25], 1e-15)
    assert_near(scene.damping, [1.0 + 4 * 0.5], 1e-15)
    assert_near(scene.friction, [2.0 + 2 * 1.0], 1e-15)
    assert_near(scene.stiffness, [3.0 + 4 * 2.0], 1e-15)
    assert_near(scene.rest, [(3.0 * 0.1 + 2.0 * -2.0 * (-0.4 - 0.3)) / 11.0], 1e-15)
    assert repr(scene).count("and 1 that follow") == 1


# In simulation


@pytest.mark.parametrize("method", ["semi-implicit-euler", "rk4", "implicit-euler", "rosenbrock-2", "rosenbrock-3"])
def test_simulation_converges(method: str) -> None:
    """Compared with fine RK4 steps on the accelerations, at the order of the method or better."""
    case = Case(1)
    scene = case.scene.with_properties(damping=0.3)
    end, order = 0.2, {"rk4": 4, "rosenbrock-2": 2, "rosenbrock-3": 3}.get(method, 1)
    exact_end = scene.simulate(case.q, case.qd, tau=case.tau, dt=end / 1024, steps=1024, method="rk4").q[-1]
    errors = []
    for steps in (32, 64):
        run = scene.simulate(case.q, case.qd, tau=case.tau, dt=end / steps, steps=steps, method=method)
        assert run.q.shape == (steps + 1, scene.nq)
        errors.append(float(np.max(np.abs(scene.difference(run.q[-1], exact_end)))))
    assert errors[1] < errors[0] * 0.5 ** (order - 0.4) or errors[1] < 1e-11, errors


def test_energy_is_kept() -> None:
    case = Case(2)
    motion = case.scene.simulate(case.q, case.qd, dt=1e-3, steps=500)
    total = motion.energy().total
    assert np.max(np.abs(total - total[0])) < 1e-6 * max(abs(total[0]), 1.0)


def test_simulators_batches_and_functions_agree() -> None:
    case = Case(4)
    q = case.scene.integrate(case.q, np.random.default_rng(1).uniform(-0.1, 0.1, (5, case.scene.nv)))
    tau = 0.1 * case.tau
    run = case.scene.simulate(q, case.qd, tau=tau, dt=1e-3, steps=20)
    assert run.q.shape == (5, 21, case.scene.nq) and run.qd.shape == (5, 21, case.scene.nv)
    one = case.scene.simulate(q[3], case.qd, tau=tau, dt=1e-3, steps=20)
    assert_same_bits(run.q[3], one.q)
    asked = case.scene.simulate(q, case.qd, tau=lambda t, q, qd: np.broadcast_to(tau, qd.shape), dt=1e-3, steps=20)
    assert_same_bits(asked.q, run.q)
    steps = case.scene.simulate(q, case.qd, tau_steps=np.broadcast_to(tau, (20, case.scene.nv)), dt=1e-3, steps=20)
    assert_same_bits(steps.q, run.q)
    simulator = case.scene.simulator(q, case.qd, dt=1e-3)
    simulator.step(tau, steps=12)
    copied = pickle.loads(pickle.dumps(simulator))
    for moving in (simulator, copied):
        moving.step(tau, steps=8)
        assert_same_bits(moving.q, run.q[:, -1])
        assert_same_bits(moving.qd, run.qd[:, -1])
    simulator.reset(case.q, states=2)
    assert_same_bits(simulator.q[2], case.q)
    assert_same_bits(simulator.q[1], run.q[1, -1])


def test_a_control_law_holds_the_coordinates() -> None:
    case = Case(5)
    target = case.scene.integrate(case.q, np.full(case.scene.nv, 0.1))
    motion = case.scene.simulate(case.q, 0 * case.qd, pd=phipsi.PD(1e5, 1e4, target), dt=1e-2, steps=600, method="implicit-euler")
    assert np.max(np.abs(case.scene.difference(motion.q[-1], target))) < 1e-2


def test_inverse_kinematics_moves_followers_too() -> None:
    for seed in (1, 2, 4, 7):
        case = Case(seed)
        link = case.scene.link_names[-1]
        target = case.scene.placement(case.q, link)
        found = case.scene.inverse_kinematics(phipsi.tasks.Pose(link, target), case.scene.integrate(case.q, np.full(case.scene.nv, 0.02)))
        assert found.reached
        assert_near(case.scene.placement(found.q, link), target, 1e-7)


# Refused arguments


def two(**follow: object) -> phipsi.SceneBuilder:
    builder = phipsi.SceneBuilder().link("base").link("a", 1.0, (0.1, 0.0, 0.0)).link("b", 1.0, (0.2, 0.0, 0.0))
    builder.joint("a_joint", "revolute", "base", "a", mimic=follow.pop("first", None))
    return builder.joint("b_joint", str(follow.pop("kind", "revolute")), "a", "b", **follow)


def test_free_is_the_default_and_warns() -> None:
    with pytest.warns(MimicWarning, match="b_joint"):
        assert two(mimic="a_joint").build().nv == 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert two(mimic="a_joint").build(mimic="couple").nv == 1


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"mimic": "c_joint"}, "b_joint.*c_joint.*does not exist.*mimic"),
        ({"mimic": "b_joint"}, "cycle"),
        ({"mimic": "a_joint", "first": "b_joint"}, "cycle"),
        ({"mimic": "a_joint", "kind": "spherical"}, "several coordinates"),
    ],
)
def test_a_bad_mimic_is_named(how: dict[str, object], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        two(**how).build(mimic="couple")


def test_a_mimic_of_a_fixed_joint_is_named() -> None:
    builder = phipsi.SceneBuilder().link("base").link("a").link("b", 1.0, (0.1, 0.0, 0.0))
    builder.joint("a_joint", "fixed", "base", "a").joint("b_joint", "revolute", "a", "b", mimic="a_joint")
    with pytest.raises(SceneError, match="does not move"):
        builder.build(mimic="couple")


def test_an_unknown_word_is_refused() -> None:
    with pytest.raises(ArgumentError, match="mimic.*couple.*free"):
        two(mimic="a_joint").build(mimic="follow")
    with pytest.raises(ArgumentError, match="mimic"):
        phipsi.Scene.from_urdf("<robot name='r'><link name='a'/></robot>", mimic="coupled")


def test_bad_states_are_named() -> None:
    scene = two(mimic="a_joint").build(mimic="couple")
    with pytest.raises(ShapeError, match="q"):
        scene.forward_dynamics(np.zeros(2), np.zeros(1), np.zeros(1))
    with pytest.raises(NotFiniteError, match="tau"):
        scene.forward_dynamics(np.zeros(1), np.zeros(1), np.array([np.nan]))
    with pytest.raises(NotFiniteError, match="state 1"):
        scene.inverse_dynamics(np.zeros((2, 1)), np.array([[0.0], [np.inf]]), np.zeros(1))


BEYOND: dict[str, Callable[[phipsi.Scene, np.ndarray], object]] = {
    "factor": lambda scene, q: scene.factor(q),
    "estimate": lambda scene, q: scene.estimate(q, q, q),
    "random_model": lambda scene, q: scene.random_model(q),
    "check": lambda scene, q: scene.check(q),
}


@pytest.mark.parametrize("name", BEYOND)
def test_what_has_no_form_says_so(name: str) -> None:
    scene = two(mimic="a_joint").build(mimic="couple")
    with pytest.raises(ArgumentError, match='follow others.*mimic="free"'):
        BEYOND[name](scene, np.zeros(1))


def test_pages_and_files(tmp_path: Path) -> None:
    scene = two(mimic="a_joint").build(mimic="couple")
    again = phipsi.Scene.from_urdf(scene.to_urdf(tmp_path / "robot.urdf"), mimic="couple")
    assert again.nv == 1
    assert scene.plan()
