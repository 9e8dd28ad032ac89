"""The tolerance of form `auto`: an argument of every call with a form, which determines the recomputed states."""

from __future__ import annotations

import copy
import inspect
import pickle

import method_page
import numpy as np
import pytest
from conftest import random_scene

import phipsi
from phipsi import _compile, scenes
from phipsi.errors import ArgumentError


def four_bar() -> phipsi.Scene:
    """Three bars of 0.3 m about parallel axes, the last pinned to the base."""
    builder = phipsi.SceneBuilder().link("base")
    for k in range(3):
        builder.link(f"bar{k}", 1.0, (0.15, 0.0, 0.0), np.diag([0.001, 0.01, 0.01]))
        parent = "base" if k == 0 else f"bar{k - 1}"
        xyz = (0.0 if k == 0 else 0.3, 0.0, 0.0)
        builder.joint(f"joint{k}", "revolute", parent, f"bar{k}", xyz=xyz, axis=(0.0, 0.0, 1.0))
    builder.connect("pin", "axis", "bar2", xyz=(0.3, 0.0, 0.0), other_xyz=(0.3, 0.0, 0.0), axis=(0.0, 0.0, 1.0))
    return builder.build()


SCENE = random_scene(3, 5)
N = SCENE.nv
LOOP = four_bar()
START = LOOP.loops.project([np.pi / 2, -np.pi / 2, -np.pi / 2]).q
ONES = np.ones(N)
Q = SCENE.neutral()
BALL = phipsi.SceneBuilder().link("ball", 1.0, inertia=np.eye(3)).contact("foot", "ball", friction=0.5, xyz=(0.1, 0.0, 0.0)).build(floating_base=True)
LINK = SCENE.link_names[-1]

CALLS = {
    "forward_dynamics": lambda **k: SCENE.forward_dynamics(Q, ONES, ONES, **k),
    "mass_matrix_inverse": lambda **k: SCENE.mass_matrix_inverse(Q, **k),
    "forward_dynamics_derivatives": lambda **k: SCENE.forward_dynamics_derivatives(Q, ONES, ONES, **k),
    "linearize": lambda **k: SCENE.linearize(Q, ONES, ONES, **k),
    "forward_dynamics_jvp": lambda **k: SCENE.forward_dynamics_jvp(Q, ONES, ONES, ONES, ONES, ONES, **k),
    "forward_dynamics_vjp": lambda **k: SCENE.forward_dynamics_vjp(Q, ONES, ONES, ONES, **k),
    "forward_dynamics_hvp": lambda **k: SCENE.forward_dynamics_hvp(Q, ONES, ONES, ONES, ONES, ONES, ONES, **k),
    "operational_inverse_inertia": lambda **k: SCENE.operational_inverse_inertia(Q, LINK, **k),
    "operational_inertia": lambda **k: SCENE.operational_inertia(Q, LINK, directions=np.eye(6)[:1], **k),
    "loops.dynamics": lambda **k: LOOP.loops.dynamics(START, np.zeros(3), np.ones(3), **k).qdd,
    "loops.inverse_dynamics": lambda **k: LOOP.loops.inverse_dynamics(START, np.zeros(3), np.zeros(3), **k).tau,
    "loops.mass_matrix_inverse": lambda **k: LOOP.loops.mass_matrix_inverse(START, **k),
    "contacts.gram": lambda **k: BALL.contacts.gram(BALL.neutral(), **k),
    "factor": lambda **k: SCENE.factor(Q, **k).solve(ONES),
    "simulate": lambda **k: SCENE.simulate(Q, ONES, dt=1e-3, steps=3, **k).q,
    "simulate_vjp": lambda **k: SCENE.simulate_vjp(
        np.broadcast_to(Q, (4, len(Q))), np.zeros((4, N)), np.ones((4, N)), np.ones((4, N)), dt=1e-3, steps=3, **k
    ).q,
    "simulator": lambda **k: SCENE.simulator(Q, ONES, dt=1e-3, **k).q,
}


def arrays(found: object) -> list[np.ndarray]:
    return [np.asarray(x) for x in found if x is not None] if isinstance(found, tuple) else [np.asarray(found)]


def test_every_call_that_takes_a_form_takes_a_tolerance() -> None:
    methods = {name: method_page.member(name) for name in method_page.public()}
    takes = {name: set(inspect.signature(of).parameters) for name, of in methods.items() if callable(of)}
    forms = {name for name, parameters in takes.items() if "form" in parameters}
    assert forms == set(CALLS)
    assert all("tolerance" in takes[name] for name in forms)
    assert "tolerance" in inspect.signature(phipsi.compile).parameters


@pytest.mark.parametrize("call", CALLS)
def test_a_loose_tolerance_changes_nothing_where_the_usual_one_is_met(call: str) -> None:
    for usual, loose in zip(arrays(CALLS[call]()), arrays(CALLS[call](tolerance=0.1)), strict=True):
        np.testing.assert_array_equal(usual, loose)


@pytest.mark.parametrize("tolerance", [0.0, -1e-9, 1.0, np.nan, np.inf])
@pytest.mark.parametrize("call", CALLS)
def test_what_is_no_tolerance_is_refused_by_name(call: str, tolerance: float) -> None:
    with pytest.raises(ArgumentError, match="above 0 and below 1") as caught:
        CALLS[call](tolerance=tolerance)
    assert caught.value.argument == "tolerance"


@pytest.mark.parametrize("call", CALLS)
def test_a_form_that_takes_its_result_as_it_is_refuses_a_tolerance(call: str) -> None:
    with pytest.raises(ArgumentError, match='form "auto", or no tolerance') as caught:
        CALLS[call](form="covariance", tolerance=1e-9)
    assert caught.value.argument == "tolerance"


def test_joints_that_follow_others_refuse_a_tolerance() -> None:
    builder = phipsi.SceneBuilder().link("base").link("a", 1.0, (0.1, 0.0, 0.0), np.eye(3)).link("b", 1.0, (0.1, 0.0, 0.0), np.eye(3))
    builder.joint("first", "revolute", "base", "a", axis=(0.0, 0.0, 1.0))
    builder.joint("second", "revolute", "a", "b", axis=(0.0, 0.0, 1.0), mimic="first", mimic_multiplier=2.0)
    scene = builder.build(mimic="couple")
    for call in (
        lambda: scene.forward_dynamics([0.1], [0.0], [1.0], tolerance=1e-9),
        lambda: scene.simulate([0.1], [0.0], dt=1e-3, steps=1, tolerance=1e-9),
    ):
        with pytest.raises(ArgumentError, match="mimic") as caught:
            call()
        assert caught.value.argument == "tolerance"


def test_the_tolerance_decides_what_is_recomputed() -> None:
    case = scenes.extreme("heavy-tip", 1e3)
    given = (case.q, case.qd, case.tau)
    _, usual = case.scene.forward_dynamics(*given, return_info=True)
    _, loose = case.scene.forward_dynamics(*given, tolerance=1e-9, return_info=True)
    exact, tight = case.scene.forward_dynamics(*given, tolerance=1e-15, return_info=True)
    assert (usual.form, usual.bound) == ("square-root", "pivots")
    assert (loose.form, loose.bound) == ("covariance", "tolerance")
    assert (tight.form, tight.bound) == ("double-double", "tolerance")
    assert loose.error <= 1e-9 * np.max(np.abs(exact)) and tight.error <= 1e-15 * np.max(np.abs(exact))
    _, rooted = case.scene.forward_dynamics(*given, form="square-root", tolerance=1e-15, return_info=True)
    assert rooted == tight


def test_each_state_of_a_batch_has_the_bits_and_the_bound_that_it_has_alone() -> None:
    case = scenes.extreme("heavy-tip", 1e3)
    random = np.random.default_rng(1)
    q, qd, tau = random.uniform(-1.0, 1.0, (3, 9, case.scene.nv))
    before, _ = case.scene.forward_dynamics(q, qd, tau, return_info=True)
    for tolerance in (1e-15, 1e-13, 1e-6):
        qdd, info = case.scene.forward_dynamics(q, qd, tau, tolerance=tolerance, return_info=True)
        for i in range(9):
            one, alone = case.scene.forward_dynamics(q[i], qd[i], tau[i], tolerance=tolerance, return_info=True)
            np.testing.assert_array_equal(one, qdd[i])
            assert (alone.form, alone.bound) == (info.form[i], info.bound[i])
    # And the next call has the default again.
    np.testing.assert_array_equal(case.scene.forward_dynamics(q, qd, tau), before)


def test_the_bound_of_a_state_near_equilibrium_is_the_sensitivity() -> None:
    scene = scenes.chain(7)
    q, rest = np.array([0.3, -0.7, 0.5, 0.9, -0.4, 0.6, 0.2]), np.zeros(7)
    tau = scene.bias_torque(q, rest)
    tau[3] *= 1.0 + 1e-10
    _, info = scene.forward_dynamics(q, rest, tau, return_info=True)
    assert (info.form, info.bound) == ("covariance", "sensitivity")


def test_factors_and_simulators_keep_their_tolerance() -> None:
    case = scenes.extreme("heavy-tip", 1e3)
    right = np.ones(case.scene.nv)
    loose = case.scene.factor(case.q, tolerance=1e-6)
    expected = case.scene.factor(case.q, form="covariance").solve(right)
    assert np.any(case.scene.factor(case.q).solve(right) != expected)
    for factor in (loose, copy.copy(loose), pickle.loads(pickle.dumps(loose))):
        np.testing.assert_array_equal(factor.solve(right), expected)
        factor.update(case.q + 0.1)
        factor.update(case.q)
        np.testing.assert_array_equal(factor.solve(right), expected)
    simulator = case.scene.simulator(case.q, case.qd, dt=1e-4, tolerance=1e-6)
    again = pickle.loads(pickle.dumps(simulator))
    for each in (simulator, again):
        each.step(steps=5)
    np.testing.assert_array_equal(simulator.q, again.q)


def test_trajectories_give_their_tolerance_to_their_gradients() -> None:
    case = scenes.extreme("heavy-tip", 1e3)
    path = case.scene.simulate(case.q, case.qd, dt=1e-4, steps=3, tolerance=1e-6)
    ones = np.ones_like(path.qd)
    made = case.scene.simulate_vjp(path.q, path.qd, ones, ones, dt=1e-4, steps=3, tolerance=1e-6)
    np.testing.assert_array_equal(path.vjp(ones, ones).q, made.q)


def test_compiled_functions_hand_over_by_their_tolerance(tmp_path: object) -> None:
    if _compile.shutil.which("cc") is None:
        pytest.skip("no C compiler")
    case = scenes.extreme("heavy-tip", 1e3)
    random = np.random.default_rng(2)
    q, qd, tau = random.uniform(-1.0, 1.0, (3, 64, case.scene.nv))
    for tolerance in (None, 1e-6):
        robot = phipsi.compile(case.scene, ["forward_dynamics"], tolerance=tolerance, cache=str(tmp_path), flags=("-O1",))
        expected = case.scene.forward_dynamics(q, qd, tau, tolerance=tolerance)
        largest = np.max(np.abs(expected))
        assert np.max(np.abs(robot.forward_dynamics(q, qd, tau) - expected)) <= (1e-6 if tolerance else 1e-13) * largest


@pytest.mark.parametrize(("accuracy", "tolerance"), [(1e-6, 1e-10), (1e-9, 1e-13)])
def test_error_control_accepts_accelerations_as_exact_as_its_substeps_need(accuracy: float, tolerance: float) -> None:
    case = scenes.extreme("heavy-tip", 1e3)

    def end(**given: float) -> np.ndarray:
        return case.scene.simulate(case.q, case.qd, dt=0.01, steps=20, accuracy=accuracy, **given).q[-1]

    usual, exact = end(), end(tolerance=1e-15)
    np.testing.assert_array_equal(usual, end(tolerance=tolerance))
    assert np.any(usual != exact)
    assert np.max(np.abs(usual - exact)) <= accuracy
