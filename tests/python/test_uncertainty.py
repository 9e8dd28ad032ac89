"""Variances through the dynamics: against dense algebra at 60 digits, against each other, and bad arguments by name."""

from __future__ import annotations

import numpy as np
import phipsi
import pytest
from conftest import random_scene, random_states
from oracle_mpmath import State, exact, random_tree, rounded, skew, zeros
from phipsi._arguments import has_followers
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError
from phipsi.estimation import ParameterCovariance
from tolerances import assert_near, inverse, product

ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


def covariance_of(random: np.random.Generator, bodies: int, rank: int = 10) -> np.ndarray:
    """Of parameters in units of their sizes."""
    size = np.array([0.1, 0.02, 0.02, 0.02, *(0.005 * np.ones(6))])
    root = random.normal(size=(bodies, 10, rank)) * size[:, None]
    return root @ root.transpose(0, 2, 1)


def regressor(state: State, scene: phipsi.Scene, qdd: np.ndarray) -> np.ndarray:
    """dtau/dpi of each link of body_names, (nv, bodies, 10), from the definition in the base frame at 60 digits."""
    columns = []
    for name in scene.body_names:
        turn, jw, jv = state.rotation[name], state.angular[name], state.linear[name]
        omega, alpha = jw @ state.qd, jw @ qdd + state.angular_bias[name]
        a = jv @ qdd + state.linear_bias[name] - state.gravity
        spin = skew(alpha) + skew(omega) @ skew(omega)
        own = [jv.T @ a]
        for i in range(3):
            h = turn[:, i]
            own.append(jv.T @ (spin @ h) + jw.T @ (skew(h) @ a))
        for i, j in ENTRIES:
            unit = zeros(3, 3)
            unit[i, j] = unit[j, i] = exact(np.array(1.0)).item()
            inertia = turn @ unit @ turn.T
            own.append(jw.T @ (inertia @ alpha + skew(omega) @ (inertia @ omega)))
        columns.append(np.array(own, dtype=object).T)
    return np.array(columns, dtype=object).transpose(1, 0, 2)


@pytest.mark.parametrize("seed", range(10))
def test_variances_are_those_of_dense_algebra_at_60_digits(seed: int) -> None:
    random = np.random.default_rng(seed)
    tree = random_tree(random, 6, armature=0.3 * (seed % 2), floating_base=seed % 5 == 4, branching=0.5)
    scene = tree.scene()
    n, bodies = scene.nv, len(scene.body_names)
    q = scene.integrate(scene.neutral(), random.uniform(-2.5, 2.5, n))
    # Large torques: the regressor is taken at the acceleration, not at rest.
    qd, tau = random.uniform(-2.0, 2.0, n), 50.0 * random.normal(size=n)
    sigma = covariance_of(random, bodies, 10 if seed % 3 else 1)
    torque = random.uniform(0.0, 2.0, n)
    root = random.normal(size=(n, 4, 4)) * [0.02, 0.1, 0.1, 0.1]
    joints = root @ root.transpose(0, 2, 1)
    state = State(tree, q, qd)
    qdd = state.forward_dynamics(tau, {})
    y = regressor(state, scene, qdd)
    x = zeros(n, n)
    for body in range(bodies):
        x = x + y[:, body] @ exact(sigma[body]) @ y[:, body].T
    own = rounded(qdd)
    weights = np.stack([own, qd, qd / np.sqrt(qd**2 + 0.01**2), np.ones(n)], axis=-1)
    t = torque + np.einsum("ni,nij,nj->n", weights, joints, weights)
    x = x + np.diag(exact(t))
    expected = rounded(state.inverse @ x @ state.inverse.T)
    condition = float(np.linalg.cond(rounded(state.mass_matrix)))
    found = scene.forward_dynamics_variance(q, qd, tau, parameters=sigma, joints=joints, torque=torque, links=scene.link_names)
    assert_near(found.joints, np.diag(expected), inverse(condition, float(np.max(np.diag(expected)))))
    for name, covariance in found.links.items():
        jacobian = scene.jacobian(q, name)
        of_link = jacobian @ expected @ jacobian.T
        assert_near(covariance, of_link, inverse(condition, float(np.max(np.abs(expected))) * float(np.max(np.abs(jacobian), initial=1.0)) ** 2))
    torques = scene.inverse_dynamics_variance(q, qd, own, parameters=sigma, joints=joints, torque=torque)
    assert_near(torques, rounded(np.diag(x)), product(30 * n, float(np.max(rounded(np.diag(x))))))


@pytest.mark.parametrize("floating_base", [False, True])
def test_correlated_bodies_are_columns(floating_base: bool) -> None:
    random = np.random.default_rng(3)
    scene = random_scene(5, 8, floating_base=floating_base, armature=0.1)
    bodies = len(scene.body_names)
    q, qd, tau = random_states(scene, 1, (3,))
    blocks = covariance_of(random, bodies)
    full = np.zeros((10 * bodies, 10 * bodies))
    for body in range(bodies):
        full[10 * body : 10 * body + 10, 10 * body : 10 * body + 10] = blocks[body]
    links = [scene.link_names[-1]]
    block = scene.forward_dynamics_variance(q, qd, tau, parameters=blocks, torque=0.3, links=links)
    assert ParameterCovariance(scene, full).blocks is not None
    same = scene.forward_dynamics_variance(q, qd, tau, parameters=full, torque=0.3)
    assert_near(same, block.joints, 0.0)
    # A correlation that is nothing but rounding takes the other path.
    beside = full.copy()
    beside[0, 10] = beside[10, 0] = 1e-300
    assert ParameterCovariance(scene, beside).blocks is None
    condition = float(np.max(np.linalg.cond(scene.mass_matrix(q))))
    columns = scene.forward_dynamics_variance(q, qd, tau, parameters=beside, torque=0.3, links=links)
    assert_near(columns.joints, block.joints, inverse(condition, float(np.max(block.joints))))
    assert_near(columns.links[links[0]], block.links[links[0]], inverse(condition, float(np.max(np.abs(block.links[links[0]])))))
    torques = scene.inverse_dynamics_variance(q, qd, tau, parameters=blocks)
    assert_near(scene.inverse_dynamics_variance(q, qd, tau, parameters=beside), torques, product(200, float(np.max(torques))))


def test_full_correlation_of_all_bodies_cancels_or_adds() -> None:
    # Two equal columns of the same body at two places: the variance of a sum, not the sum of variances.
    scene = phipsi.scenes.chain(2)
    mass = np.zeros((20, 20))
    mass[np.ix_([0, 10], [0, 10])] = 0.01
    q, qd, qdd = [0.4, 0.3], [0.0, 0.0], [0.0, 0.0]
    single = [np.sqrt(scene.inverse_dynamics_variance(q, qd, qdd, parameters=np.diag(np.eye(20)[at]) * 0.01)) for at in (0, 10)]
    both = scene.inverse_dynamics_variance(q, qd, qdd, parameters=mass)
    assert_near(both, (single[0] + single[1]) ** 2, product(20, float(np.max(both))))


def test_a_batch_is_its_states() -> None:
    scene = random_scene(2, 9)
    random = np.random.default_rng(0)
    sigma = covariance_of(random, len(scene.body_names), 2)
    q, qd, tau = random_states(scene, 4, (40,))
    whole = scene.forward_dynamics_variance(q, qd, tau, parameters=sigma, torque=0.1)
    assert whole.shape == (40, scene.nv)
    for at in (0, 17, 39):
        assert_near(whole[at], scene.forward_dynamics_variance(q[at], qd[at], tau[at], parameters=sigma, torque=0.1), 0.0)


def test_no_call_depends_on_the_one_before() -> None:
    """A scene keeps kernels and roots of covariances: each call in turn has the bits of that on a new scene."""
    random = np.random.default_rng(3)
    q, qd, u = random_states(random_scene(2, 5), 4, (3,))
    bodies = len(random_scene(2, 5).body_names)
    one, other = covariance_of(random, bodies, 2), covariance_of(random, bodies, 10)
    calls = [
        lambda scene: scene.forward_dynamics_variance(q, qd, u, parameters=one, torque=0.1),
        lambda scene: scene.forward_dynamics_variance(q, qd, u, parameters=other, torque=0.1),
        lambda scene: scene.forward_dynamics_variance(q, qd, u, parameters=other, links="link3").links["link3"],
        lambda scene: scene.forward_dynamics_variance(q, qd, u, parameters=one, torque=0.2, joints={"friction": 0.1}),
        lambda scene: scene.inverse_dynamics_variance(q, qd, u, parameters=one),
    ]
    expected = [call(random_scene(2, 5)) for call in calls]
    assert all(np.any(found != expected[0]) for found in expected[1:2])
    scene = random_scene(2, 5)
    for at in (0, 1, 0, 2, 3, 4, 0, 3, 2, 1):
        assert_near(calls[at](scene), expected[at], 0.0)


def test_a_fixed_joint_with_mimic_needs_no_dense_matrices() -> None:
    text = """<robot name="r"><link name="base"/><link name="a"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
    <link name="b"/><joint name="j" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
    <joint name="k" type="fixed"><parent link="a"/><child link="b"/><mimic joint="j"/></joint></robot>"""
    scene = phipsi.load(text)
    assert scene.joints["k"].mimic is not None and not has_followers(scene)
    builder = phipsi.SceneBuilder().link("base").link("a", 1.0).link("b", 1.0).joint("j", "revolute", "base", "a")
    builder.joint("k", "revolute", "a", "b", mimic="j")
    assert has_followers(builder.build(mimic="couple"))


def test_an_object_with_a_covariance_is_taken_as_it_is() -> None:
    scene = phipsi.scenes.chain(3)

    class Found:
        covariance = covariance_of(np.random.default_rng(1), 3)

    state = ([0.1] * 3, [0.2] * 3, [0.3] * 3)
    assert_near(scene.forward_dynamics_variance(*state, parameters=Found()), scene.forward_dynamics_variance(*state, parameters=Found.covariance), 0.0)


def test_a_long_chain_is_linear_in_memory_and_agrees_with_columns() -> None:
    scene = phipsi.scenes.chain(300)
    rng = np.random.default_rng(2)
    q, qd, tau = 0.3 * rng.normal(size=300), 0.1 * rng.normal(size=300), rng.normal(size=300)
    sigma = np.zeros((300, 10, 10))
    sigma[[3, 250], 0, 0] = 0.01
    found = scene.forward_dynamics_variance(q, qd, tau, parameters=sigma)
    columns = np.zeros((2, 300, 10))
    columns[[0, 1], [3, 250], 0] = 0.1
    zero = np.zeros(300)
    moved = scene.forward_dynamics_jvp(q, qd, tau, zero, zero, zero, dparameters=columns)
    assert_near(found, np.sum(moved**2, axis=0), 1e-9 * float(np.max(found)))


def test_nothing_uncertain_is_no_variance() -> None:
    scene = phipsi.scenes.chain(3)
    assert_near(scene.forward_dynamics_variance([0.1] * 3, [0.2] * 3, [0.3] * 3), np.zeros(3), 0.0)
    empty = phipsi.SceneBuilder().link("only", 1.0).build()
    assert empty.forward_dynamics_variance([], [], []).shape == (0,)


class TestArguments:
    scene = phipsi.scenes.chain(2)
    state = ([0.1] * 2, [0.2] * 2, [0.3] * 2)

    def test_a_covariance_of_another_shape(self) -> None:
        with pytest.raises(ShapeError, match=r"parameters.*\(2, 10, 10\).*\(20, 20\)"):
            self.scene.forward_dynamics_variance(*self.state, parameters=np.zeros((3, 10, 10)))

    def test_a_covariance_that_is_not_symmetric(self) -> None:
        sigma = np.tile(np.eye(10), (2, 1, 1))
        sigma[1, 0, 1] = 0.5
        with pytest.raises(ArgumentError, match=r"parameters\[1\].*not symmetric"):
            self.scene.forward_dynamics_variance(*self.state, parameters=sigma)

    def test_a_negative_eigenvalue(self) -> None:
        sigma = np.tile(np.eye(10), (2, 1, 1))
        sigma[0, 0, 1] = sigma[0, 1, 0] = 2.0
        with pytest.raises(ArgumentError, match=r"parameters\[0\].*eigenvalue of -1"):
            self.scene.inverse_dynamics_variance(*self.state, parameters=sigma)

    def test_a_nan(self) -> None:
        with pytest.raises(NotFiniteError, match="parameters.*NaN"):
            self.scene.forward_dynamics_variance(*self.state, parameters=np.full((2, 10, 10), np.nan))

    def test_a_negative_torque_variance(self) -> None:
        with pytest.raises(ArgumentError, match="torque.*negative"):
            self.scene.forward_dynamics_variance(*self.state, torque=-1.0)

    def test_an_unknown_joint_parameter(self) -> None:
        with pytest.raises(ArgumentError, match="joints.*'stiction'.*armature"):
            self.scene.forward_dynamics_variance(*self.state, joints={"stiction": 1.0})

    @pytest.mark.parametrize("speed", [0.0, -1.0, np.nan])
    @pytest.mark.parametrize("kind", ["chain", "connections"])
    def test_a_friction_speed_that_is_not_positive(self, kind: str, speed: float) -> None:
        scene = self.scene if kind == "chain" else self.scene.to_builder().connect("fixed", "point", "link1").build()
        for method in (scene.forward_dynamics_variance, scene.inverse_dynamics_variance):
            with pytest.raises(ArgumentError, match="^friction_speed: found"):
                method(*self.state, joints={"friction": 1.0}, friction_speed=speed)

    def test_an_unknown_link(self) -> None:
        with pytest.raises(ArgumentError, match="nowhere"):
            self.scene.forward_dynamics_variance(*self.state, links="nowhere")

    def test_a_bad_state_of_a_batch(self) -> None:
        q = np.zeros((3, 2))
        q[1, 0] = np.nan
        with pytest.raises(NotFiniteError, match="q"):
            self.scene.forward_dynamics_variance(q, [0.0] * 2, [0.0] * 2)
        with pytest.warns(phipsi.errors.BadStateWarning):
            found = self.scene.forward_dynamics_variance(q, [0.0] * 2, [0.0] * 2, torque=1.0, errors="nan")
        assert np.isnan(found[1]).all() and np.isfinite(found[[0, 2]]).all()
