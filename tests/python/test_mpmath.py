"""Comparison with 60 digits (mpmath) on random trees with all types of joints: branching, armature, velocities and
wrenches together.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from oracle_mpmath import CONTEXT, KINDS, State, derivative, exact, identity, moved, random_tree, rounded
from tolerances import EPS, recursion, solve

SEEDS = range(16)
worst: dict[str, dict[str, float]] = {"n eps": {}, "cond eps": {}, "eps": {}}
"""By unit and quantity: largest error of the tests so far, relative to the magnitude of the quantity."""


class Case:
    """A scene, one state, and the oracle's results for both."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        kinds = tuple(np.roll(KINDS, seed))
        floating_base = seed % 5 == 4
        self.tree = random_tree(
            random, 7, kinds=kinds, armature=0.3 * (seed % 2), floating_base=floating_base, branching=0.5
        )
        self.scene = self.tree.scene()
        n = self.scene.nv
        assert n == self.tree.nv <= 12
        self.q = self.scene.integrate(self.scene.neutral(), random.uniform(-2.5, 2.5, n))
        self.qd, self.qdd, self.tau = random.uniform(-2.0, 2.0, (3, n))
        self.tau *= 5.0
        self.wrenches = {link: random.uniform(-3.0, 3.0, 6) for link in self.scene.link_names[::2]}
        self.state = State(self.tree, self.q, self.qd)
        self.condition = float(np.linalg.cond(rounded(self.state.mass_matrix)))


@functools.cache
def case_of(seed: int) -> Case:
    return Case(seed)


@pytest.fixture(params=SEEDS)
def case(request: pytest.FixtureRequest) -> Case:
    return case_of(request.param)


def error(found: object, expected: object) -> tuple[float, float]:
    """Largest difference, computed with 60 digits, and largest entry."""
    expected = np.asarray(expected, dtype=object)
    found = np.asarray(found)
    assert found.shape == expected.shape
    assert np.all(np.isfinite(found))
    off = rounded(exact(found) - expected)
    return float(np.max(np.abs(off), initial=0.0)), float(np.max(np.abs(rounded(expected)), initial=0.0))


def assert_recursion(case: Case, name: str, found: object, expected: object, scale: float = 0.0) -> None:
    """To n eps of the largest entry, or of the scale if that is larger."""
    off, largest = error(found, expected)
    scale = max(scale, largest)
    assert off <= recursion(case.scene.nv, scale), f"{name}: {off / (EPS * scale * case.scene.nv):.3g} n eps"
    note("n eps", name, off / (EPS * scale * case.scene.nv))


def assert_solve(case: Case, name: str, found: object, expected: object, scale: float = 0.0) -> None:
    """To cond(M) eps of the largest entry."""
    off, largest = error(found, expected)
    scale = max(scale, largest)
    assert off <= solve(case.condition, scale), f"{name}: {off / (EPS * scale * case.condition):.3g} cond eps"
    note("cond eps", name, off / (EPS * scale * case.condition))
    note("eps", name, off / (EPS * scale))


def note(unit: str, name: str, ratio: float) -> None:
    worst[unit][name] = max(worst[unit].get(name, 0.0), ratio)


def test_the_cases_cover_everything() -> None:
    joints = [joint for seed in SEEDS for joint in case_of(seed).tree.joints]
    assert {joint.kind for joint in joints} == set(KINDS)
    for kind in KINDS:
        # Inside a tree and not only at its root.
        assert any(joint.kind == kind and joint.parent != "base" for joint in joints), kind
        assert kind == "fixed" or any(joint.kind == kind and joint.armature > 0.0 for joint in joints), kind
    parents = [joint.parent for joint in case_of(0).tree.joints]
    assert len(set(parents)) < len(parents)
    assert any(case_of(seed).tree.floating_base for seed in SEEDS)
    assert {case_of(seed).scene.nv for seed in SEEDS} <= set(range(5, 13))


def test_order_is_the_oracle_s(case: Case) -> None:
    assert case.scene.joint_names == tuple(joint.name for joint in case.tree.order if joint.nv)


def test_geometry(case: Case) -> None:
    placements = case.scene.placements(case.q)
    for link in case.scene.link_names:
        assert_recursion(case, "placements", placements[link], case.state.placement(link))
        assert_recursion(case, "Jacobian", case.scene.jacobian(case.q, link), case.state.jacobian(link), 1.0)


def test_inverse_dynamics(case: Case) -> None:
    found = case.scene.inverse_dynamics(case.q, case.qd, case.qdd, wrenches=case.wrenches)
    assert_recursion(case, "inverse dynamics", found, case.state.inverse_dynamics(case.qdd, case.wrenches))
    assert_recursion(case, "bias", case.scene.bias_torque(case.q, case.qd), case.state.bias_torque)


def test_mass_matrix(case: Case) -> None:
    assert_recursion(case, "M", case.scene.mass_matrix(case.q), case.state.mass_matrix)


def test_energy_and_momentum(case: Case) -> None:
    kinetic, potential = case.scene.energy(case.q, case.qd)
    weight = float(np.linalg.norm(case.tree.gravity)) * sum(link.mass for link in case.tree.links)
    assert_recursion(case, "kinetic energy", kinetic, case.state.energy[0])
    assert_recursion(case, "potential energy", potential, case.state.energy[1], weight)
    assert_recursion(case, "momentum", case.scene.momentum(case.q, case.qd), case.state.momentum)


def test_forward_dynamics(case: Case) -> None:
    found = case.scene.forward_dynamics(case.q, case.qd, case.tau, wrenches=case.wrenches)
    assert_solve(case, "forward dynamics", found, case.state.forward_dynamics(case.tau, case.wrenches))


def test_mass_matrix_inverse_and_determinant(case: Case) -> None:
    assert_solve(case, "M^-1", case.scene.mass_matrix_inverse(case.q), case.state.inverse)
    assert_solve(case, "log det M", case.scene.factor(case.q).log_det, case.state.log_det, 1.0)


def test_the_factor_is_the_unique_one(case: Case) -> None:
    """K, D and L by the filter compared with the Cholesky factorization of M from its last row."""
    factor, n = case.scene.factor(case.q), case.scene.nv
    one_plus_k, pivots = case.state.factors
    k, l = one_plus_k - identity(n), identity(n) - case.state.unit_inverse  # noqa: E741 - the paper's letter
    found_d = factor.D @ np.eye(n)
    assert np.all(found_d == np.diag(np.diag(found_d)))
    assert_solve(case, "D", np.diag(found_d), pivots)
    for name, operator, expected in (("K", factor.K, k), ("L", factor.L, l)):
        assert_solve(case, name, operator @ np.eye(n), expected, 1.0)
        assert_solve(case, f"{name} by definition", operator.toarray(), expected, 1.0)
        assert_solve(case, f"{name} transposed", operator.T @ np.eye(n), expected.T, 1.0)
    assert_solve(case, "factor.solve", factor.solve(case.tau), case.state.inverse @ exact(case.tau))
    assert_recursion(case, "factor.mul", factor.mul(case.tau), case.state.mass_matrix @ exact(case.tau))


# The oracle itself, with 60 digits: compared with Lagrange's equations and the power balance, by differences with a
# step of 1e-20.


@pytest.mark.parametrize("seed", range(3))
def test_oracle_obeys_lagrange(seed: int) -> None:
    kinds = ("revolute", "prismatic", "screw", "planar")
    tree = random_tree(np.random.default_rng(seed), 4, kinds=kinds, armature=0.2, branching=0.5)
    random = np.random.default_rng(seed)
    q, qd = (exact(random.uniform(-2.0, 2.0, tree.nv)) for _ in range(2))
    expected = derivative(lambda h: State(tree, moved(tree, q, qd, h), qd).mass_matrix) @ qd
    for i in range(tree.nv):
        along = identity(tree.nv)[i]

        def lagrangian(h: object, along: np.ndarray = along) -> object:
            kinetic, potential = State(tree, moved(tree, q, along, h), qd).energy
            return kinetic - potential

        expected[i] -= derivative(lagrangian)
    assert all(abs(x) <= CONTEXT.mpf(10) ** -30 for x in State(tree, q, qd).bias_torque - expected)


@pytest.mark.parametrize("seed", [0, 4, 9])
def test_oracle_balances_power(seed: int) -> None:
    case = case_of(seed)
    q, qd, qdd = exact(case.q), case.state.qd, exact(case.qdd)

    def total(h: object) -> object:
        return sum(State(case.tree, moved(case.tree, q, qd, h), qd + h * qdd).energy)

    power = qd @ case.state.inverse_dynamics(case.qdd, {})
    assert abs(derivative(total) - power) <= CONTEXT.mpf(10) ** -30 * abs(power)


def test_summary(capsys: pytest.CaptureFixture[str]) -> None:
    """Print the largest error of each quantity in the tests above."""
    lines = [", ".join(f"{name} {ratio:.2g}" for name, ratio in worst[unit].items()) for unit in worst]
    with capsys.disabled():
        print()
        for unit, line in zip(worst, lines, strict=True):
            print(f"random trees, largest errors against 60 digits, in {unit}: {line}")
