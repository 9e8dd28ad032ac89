"""Derivatives of the dynamics: compared with Pinocchio on real robots, with 60 digits on random trees, and as calls."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pytest
from conftest import State as Random
from conftest import random_states
from oracle_mpmath import KINDS, State, derivative, exact, identity, moved, random_tree, rounded
from oracle_pinocchio import Oracle, load
from test_pinocchio import bases, regular_robots, robots
from tolerances import EPS, assert_near, assert_same_bits, inverse, product, recursion, size, solve

import phipsi
from phipsi.errors import ArgumentError, BadStateWarning, NotFiniteError, ShapeError, SingularJointError

G1 = "g1_description/urdf/g1_29dof_rev_1_0.urdf"
worst: dict[str, float] = {}
"""Largest error of the tests so far, by reference, in units of n eps or cond eps of the magnitude of the quantity."""


def note(name: str, off: float, unit: float) -> None:
    worst[name] = max(worst.get(name, 0.0), off / unit if unit else off)


def largest(values: np.ndarray) -> float:
    return float(np.max(np.abs(values), initial=0.0))


def real_state(scene: phipsi.Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """A random state with a wrench on every third link, including merged ones."""
    random = np.random.default_rng(scene.nv)
    q = scene.integrate(scene.neutral(), random.uniform(-np.pi, np.pi, scene.nv))
    qd, u = random.uniform(-2.0, 2.0, (2, scene.nv))
    return q, qd, u, {link: random.uniform(-3.0, 3.0, 6) for link in scene.link_names[::3]}


@functools.cache
def robot(file: str, floating_base: bool) -> tuple[phipsi.Scene, Oracle]:
    scene, _ = load(file, floating_base)
    return scene, Oracle(file, floating_base, scene)


@bases
@robots
def test_of_torques_as_pinocchio(file: str, floating_base: bool) -> None:
    """To n eps, including singular models."""
    scene, oracle = robot(file, floating_base)
    q, qd, qdd, wrenches = real_state(scene)
    found = scene.inverse_dynamics_derivatives(q, qd, qdd, wrenches=wrenches)
    expected = oracle.inverse_dynamics_derivatives(q, qd, qdd, wrenches)
    scale = largest(scene.inverse_dynamics(q, qd, qdd, wrenches=wrenches))
    for name, one, other in zip(found._fields, found, expected, strict=True):
        of = max(scale, largest(other))
        assert_near(one, other, recursion(scene.nv, of))
        note(f"{name} beside Pinocchio, n eps", largest(one - other), scene.nv * EPS * of)


@bases
@regular_robots
def test_of_accelerations_as_pinocchio(file: str, floating_base: bool) -> None:
    """To cond(M) eps."""
    scene, oracle = robot(file, floating_base)
    q, qd, tau, wrenches = real_state(scene)
    condition = float(np.linalg.cond(scene.mass_matrix(q))) if scene.nv else 1.0
    found = scene.forward_dynamics_derivatives(q, qd, tau, wrenches=wrenches)
    expected = oracle.forward_dynamics_derivatives(q, qd, tau, wrenches)
    scale = largest(scene.forward_dynamics(q, qd, tau, wrenches=wrenches))
    for name, one, other in zip(found._fields, found, expected, strict=True):
        of = max(scale, largest(other))
        assert_near(one, other, inverse(condition, of))
        note(f"{name} beside Pinocchio, cond eps", largest(one - other), condition * EPS * of)


@bases
@regular_robots
def test_robots_need_no_second_look(file: str, floating_base: bool) -> None:
    """The error estimate of form "auto" is below 1e-9, above which it would recompute: in motion, passive and in static
    equilibrium.
    """
    scene, _ = robot(file, floating_base)
    q, qd, tau, _ = real_state(scene)
    still = np.zeros(scene.nv)
    for rates, torques in ((qd, tau), (still, still), (still, scene.bias_torque(q, still))):
        *found, minv = scene.forward_dynamics_derivatives(q, rates, torques)
        of_torques = scene.inverse_dynamics_derivatives(q, rates, scene.forward_dynamics(q, rates, torques))
        row = np.abs(minv).max(axis=1, initial=0.0)
        for name, one, other in zip(("dqdd_dq", "dqdd_dqd"), found, of_torques, strict=False):
            lost = EPS * largest(row @ np.abs(other))
            assert lost <= 1e-9 * largest(one)
            note(f"{name} lost on robots, estimate", lost, largest(one))


@pytest.mark.parametrize("seed", range(8))
def test_against_60_digits(seed: int) -> None:
    random = np.random.default_rng(seed)
    kinds = tuple(np.roll(KINDS, seed))
    tree = random_tree(random, 6, kinds=kinds, most=9, armature=0.3 * (seed % 2), floating_base=seed % 3 == 2, branching=0.5)
    scene = tree.scene()
    n = scene.nv
    q = scene.integrate(scene.neutral(), random.uniform(-2.5, 2.5, n))
    qd, qdd, tau = random.uniform(-2.0, 2.0, (3, n))
    wrenches = {link: random.uniform(-3.0, 3.0, 6) for link in scene.link_names[::2]}
    here, at_q, rates = State(tree, q, qd), exact(q), exact(qd)

    def torques(accelerations: np.ndarray) -> list[np.ndarray]:
        """Derivatives with respect to q and qd at these accelerations."""

        def along(unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            by_q = derivative(lambda h: State(tree, moved(tree, at_q, unit, h), rates).inverse_dynamics(accelerations, wrenches))
            by_qd = derivative(lambda h: State(tree, at_q, rates + unit * h).inverse_dynamics(accelerations, wrenches))
            return by_q, by_qd

        return [np.stack(columns, axis=1) for columns in zip(*map(along, identity(n)), strict=True)]

    found = scene.inverse_dynamics_derivatives(q, qd, qdd, wrenches=wrenches)
    expected = [*torques(exact(qdd)), here.mass_matrix]
    scale = largest(rounded(here.inverse_dynamics(qdd, wrenches)))
    for name, one, other in zip(found._fields, found, expected, strict=True):
        off, of = largest(rounded(exact(one) - other)), max(scale, largest(rounded(other)))
        assert off <= recursion(n, of), f"{name}: {off / (n * EPS * of):.3g} n eps"
        note(f"{name} beside 60 digits, n eps", off, n * EPS * of)

    condition = float(np.linalg.cond(rounded(here.mass_matrix)))
    found = scene.forward_dynamics_derivatives(q, qd, tau, wrenches=wrenches)
    accelerations = here.forward_dynamics(tau, wrenches)
    expected = [*(-here.inverse @ matrix for matrix in torques(accelerations)), here.inverse]
    scale = largest(rounded(accelerations))
    for name, one, other in zip(found._fields, found, expected, strict=True):
        off, of = largest(rounded(exact(one) - other)), max(scale, largest(rounded(other)))
        assert off <= solve(condition, of), f"{name}: {off / (condition * EPS * of):.3g} cond eps"
        note(f"{name} beside 60 digits, cond eps", off, condition * EPS * of)


def test_far_from_the_origin_no_digit_is_lost() -> None:
    """A floating robot at a distance of 1,000 km, where one common frame loses eleven digits."""
    scene, _ = robot(G1, True)
    q, qd, qdd, _ = real_state(scene)
    near = scene.inverse_dynamics_derivatives(q, qd, qdd)
    q[:3] = 1e6, -2e6, 1.5e6
    for name, one, other in zip(near._fields, scene.inverse_dynamics_derivatives(q, qd, qdd), near, strict=True):
        assert_near(one, other, product(1, largest(other)))
        note(f"{name} 1,000 km away, eps", largest(one - other), EPS * largest(other))


@bases
@robots
def test_coriolis_matrix_as_pinocchio(file: str, floating_base: bool) -> None:
    """And dM/dt = C + C^T; compared with Pinocchio's C to n eps of its terms."""
    scene, oracle = robot(file, floating_base)
    q, qd, _, _ = real_state(scene)
    coriolis, rate = scene.coriolis_matrix(q, qd), scene.mass_matrix_derivative(q, qd)
    expected = oracle.coriolis_matrix(q, qd)
    scale = max(largest(expected), largest(scene.mass_matrix(q)) * largest(qd))
    assert_near(coriolis, expected, recursion(scene.nv, scale))
    assert_near(rate, coriolis + coriolis.T, recursion(scene.nv, scale))
    note("C beside Pinocchio, n eps", largest(coriolis - expected), scene.nv * EPS * scale)


Call = Callable[..., tuple[np.ndarray, ...]]


def calls(scene: phipsi.Scene) -> dict[str, Call]:
    return {
        "inverse": scene.inverse_dynamics_derivatives,
        "forward": scene.forward_dynamics_derivatives,
        "linear": scene.linearize,
    }


names = pytest.mark.parametrize("name", ["inverse", "forward", "linear"])


@names
def test_a_valid_call(mixed: phipsi.Scene, name: str) -> None:
    n = mixed.nv
    found = calls(mixed)[name](*random_states(mixed, 1))
    shapes = [(2 * n, 2 * n), (2 * n, n)] if name == "linear" else [(n, n)] * 3
    fields = {
        "inverse": ("dtau_dq", "dtau_dqd", "mass_matrix"),
        "forward": ("dqdd_dq", "dqdd_dqd", "mass_matrix_inverse"),
        "linear": ("A", "B"),
    }
    assert found._fields == fields[name]  # type: ignore[attr-defined]
    assert [part.shape for part in found] == shapes
    assert all(part.flags.c_contiguous and part.flags.writeable and np.all(np.isfinite(part)) for part in found)


@names
def test_batches_broadcast_with_the_bits_of_single_states(floating: phipsi.Scene, name: str) -> None:
    call = calls(floating)[name]
    q, qd, u = random_states(floating, 2, (40, 1))
    qd, u = qd[0], np.broadcast_to(u, (40, 3, floating.nv))
    link = floating.link_names[-1]
    pushed = np.random.default_rng(3).normal(size=(3, 6))
    found = call(q, qd, u, wrenches={link: pushed})
    for i, j in ((0, 0), (17, 1), (39, 2)):
        alone = call(q[i, 0], qd[0], u[i, j], wrenches={link: pushed[j]})
        for part, one in zip(found, alone, strict=True):
            assert part.shape == (40, 3, *one.shape)
            assert_same_bits(part[i, j], one)


@names
def test_the_same_bits_for_any_number_of_threads(floating: phipsi.Scene, name: str) -> None:
    before = phipsi.get_num_threads()
    states = random_states(floating, 4, (300,))
    results = []
    try:
        for threads in (1, 2, 3):
            phipsi.set_num_threads(threads)
            results.append(calls(floating)[name](*states))
    finally:
        phipsi.set_num_threads(before)
    for other in results[1:]:
        for one, part in zip(results[0], other, strict=True):
            assert_same_bits(part, one)


@names
def test_without_degrees_of_freedom_or_states(welded: phipsi.Scene, arm: phipsi.Scene, name: str) -> None:
    assert all(part.size == 0 for part in calls(welded)[name]([], [], []))
    found = calls(arm)[name](np.zeros((0, 7)), np.zeros(7), np.zeros(7))
    assert all(part.shape[0] == 0 and part.ndim == 3 for part in found)


def test_the_linear_system_is_made_of_the_derivatives(mixed: phipsi.Scene) -> None:
    state, n = random_states(mixed, 5, (4,)), mixed.nv
    a, b = mixed.linearize(*state)
    by_q, by_qd, minv = mixed.forward_dynamics_derivatives(*state)
    assert_same_bits(a[:, n:, :n], by_q)
    assert_same_bits(a[:, n:, n:], by_qd)
    assert_same_bits(b[:, n:], minv)
    assert np.all(a[:, :n, n:] == np.eye(n)) and np.all(b[:, :n] == 0.0)
    assert np.max(np.abs(a[:, :n, :n])) > 0.1


def test_at_rest_neighbors_do_not_part(mixed: phipsi.Scene) -> None:
    q, qd, tau = random_states(mixed, 6)
    a, _ = mixed.linearize(q, 0.0 * qd, tau)
    assert np.all(a[: mixed.nv, : mixed.nv] == 0.0)


@pytest.mark.parametrize("form", ["covariance", "square-root"])
def test_every_form_gives_the_same(mixed: phipsi.Scene, form: str) -> None:
    state = random_states(mixed, 7)
    condition = float(np.linalg.cond(mixed.mass_matrix(state.q)))
    found = mixed.forward_dynamics_derivatives(*state, form=form)  # type: ignore[arg-type]
    for one, other in zip(found, mixed.forward_dynamics_derivatives(*state), strict=True):
        assert_near(one, other, inverse(condition, size(other)))


def broken(state: Random, **changes: object) -> tuple[object, ...]:
    return tuple(state._replace(**changes))  # type: ignore[arg-type]


@names
def test_a_short_q(mixed: phipsi.Scene, name: str) -> None:
    state = random_states(mixed, 1)
    with pytest.raises(ShapeError, match="^q: found shape"):
        calls(mixed)[name](*broken(state, q=state.q[1:]))


@names
def test_a_rate_that_is_not_finite(mixed: phipsi.Scene, name: str) -> None:
    q, qd, tau = random_states(mixed, 1, (5,))
    qd[3, 2] = np.nan
    with pytest.raises(NotFiniteError, match="^qd: found NaN at index 2 in state"):
        calls(mixed)[name](q, qd, tau)


@names
def test_a_third_of_another_batch(mixed: phipsi.Scene, name: str) -> None:
    q, qd, tau = random_states(mixed, 1, (5,))
    third = "qdd" if name == "inverse" else "tau"
    with pytest.raises(ShapeError, match=third):
        calls(mixed)[name](q, qd, tau[:3])


@names
def test_a_wrench_on_no_link(mixed: phipsi.Scene, name: str) -> None:
    with pytest.raises(ArgumentError, match='^wrenches: found "elbow"'):
        calls(mixed)[name](*random_states(mixed, 1), wrenches={"elbow": np.zeros(6)})


@pytest.mark.parametrize("name", ["forward", "linear"])
def test_a_form_that_there_is_not(mixed: phipsi.Scene, name: str) -> None:
    with pytest.raises(ArgumentError, match='^form: found "best"'):
        calls(mixed)[name](*random_states(mixed, 1), form="best")


@pytest.mark.parametrize("name", ["forward", "linear"])
def test_a_joint_that_moves_nothing(name: str) -> None:
    builder = phipsi.SceneBuilder().link("base").link("arm", 1.0, (0, 0.5, 0)).link("nothing")
    scene = builder.joint("turn", "revolute", "base", "arm").joint("idle", "revolute", "arm", "nothing").build()
    with pytest.raises(SingularJointError) as caught:
        calls(scene)[name](np.zeros((2, 2)), np.ones(2), np.ones(2))
    assert (caught.value.joint, caught.value.state) == ("idle", 0)


@names
def test_a_bad_state_becomes_nan_where_that_is_asked_for(mixed: phipsi.Scene, name: str) -> None:
    q, qd, tau = random_states(mixed, 1, (5,))
    qd[3] = np.inf
    with pytest.warns(BadStateWarning) as caught:
        found = calls(mixed)[name](q, qd, tau, errors="nan")
    assert caught[0].message.states == (3,)  # type: ignore[union-attr]
    for part in found:
        assert np.all(np.isnan(part[3])) and np.all(np.isfinite(np.delete(part, 3, axis=0)))


@names
def test_a_scene_too_large_for_dense_matrices(name: str) -> None:
    scene = phipsi.scenes.chain(4001)
    zeros = np.zeros(4001)
    with pytest.raises(ArgumentError, match="at most 4000"):
        calls(scene)[name](zeros, zeros, zeros)


def test_summary(capsys: pytest.CaptureFixture[str]) -> None:
    """Print the largest errors of the tests above."""
    with capsys.disabled():
        print()
        print("derivatives, largest errors: " + ", ".join(f"{name} {ratio:.2g}" for name, ratio in worst.items()))
