"""errors="nan": the results of the good states of a batch do not depend on the bad ones, which are NaN and reported."""

from __future__ import annotations

import pickle
import warnings
from typing import Any

import numpy as np
import pytest
from conftest import random_scene, random_states
from tolerances import assert_same_bits

import phipsi
from phipsi.errors import ArgumentError, BadStateWarning, NotFiniteError, ShapeError, SingularJointError, SingularTaskError

BATCH = 300
BAD = (0, 17, 18, 130, 299)


def calls(scene: phipsi.Scene) -> dict[str, Any]:
    """All methods that take `errors`, from (q, qd, tau) to one array."""
    link = scene.link_names[-1]

    def stacked(arrays: Any, axis: int) -> np.ndarray:
        return np.stack([np.asarray(array) for array in arrays], axis=axis)

    return {
        "forward_dynamics": lambda q, qd, tau, **e: scene.forward_dynamics(q, qd, tau, **e),
        "square-root": lambda q, qd, tau, **e: scene.forward_dynamics(q, qd, tau, form="square-root", **e),
        "with wrenches": lambda q, qd, tau, **e: scene.forward_dynamics(q, qd, tau, wrenches={link: np.arange(6.0)}, **e),
        "float32": lambda q, qd, tau, **e: scene.forward_dynamics(q, qd, tau, dtype=np.float32, **e),
        "inverse_dynamics": lambda q, qd, tau, **e: scene.inverse_dynamics(q, qd, tau, **e),
        "bias_torque": lambda q, qd, tau, **e: scene.bias_torque(q, qd, **e),
        "mass_matrix": lambda q, qd, tau, **e: scene.mass_matrix(q, **e),
        "mass_matrix_inverse": lambda q, qd, tau, **e: scene.mass_matrix_inverse(q, **e),
        "poses": lambda q, qd, tau, **e: scene.poses(q, **e),
        "placements": lambda q, qd, tau, **e: stacked(scene.placements(q, **e).values(), -3),
        "gravity_torque": lambda q, qd, tau, **e: scene.gravity_torque(q, **e),
        "placement": lambda q, qd, tau, **e: scene.placement(q, link, **e),
        "placement of several": lambda q, qd, tau, **e: scene.placement(q, scene.link_names, **e),
        "velocity": lambda q, qd, tau, **e: scene.velocity(q, qd, link, **e),
        "acceleration": lambda q, qd, tau, **e: scene.acceleration(q, qd, tau, link, **e),
        "jacobian": lambda q, qd, tau, **e: scene.jacobian(q, link, **e),
        "jacobian_rate": lambda q, qd, tau, **e: scene.jacobian_rate(q, qd, link, **e),
        "jacobian_rate_product": lambda q, qd, tau, **e: scene.jacobian_rate_product(q, qd, link, **e),
        "velocity_derivatives": lambda q, qd, tau, **e: scene.velocity_derivatives(q, qd, link, **e),
        "acceleration_derivatives": lambda q, qd, tau, **e: scene.acceleration_derivatives(q, qd, tau, link, **e),
        "jacobian_derivatives": lambda q, qd, tau, **e: scene.jacobian_derivatives(q, link, **e),
        "center_of_mass": lambda q, qd, tau, **e: scene.center_of_mass(q, **e),
        "center_of_mass_velocity": lambda q, qd, tau, **e: scene.center_of_mass_velocity(q, qd, **e),
        "center_of_mass_acceleration": lambda q, qd, tau, **e: scene.center_of_mass_acceleration(q, qd, tau, **e),
        "center_of_mass_jacobian": lambda q, qd, tau, **e: scene.center_of_mass_jacobian(q, **e),
        "centroidal_momentum_matrix": lambda q, qd, tau, **e: scene.centroidal_momentum_matrix(q, **e),
        "centroidal_momentum_matrix_rate": lambda q, qd, tau, **e: scene.centroidal_momentum_matrix_rate(q, qd, **e),
        "centroidal_momentum_derivatives": lambda q, qd, tau, **e: scene.centroidal_momentum_derivatives(q, qd, **e),
        "kinetic_energy": lambda q, qd, tau, **e: scene.kinetic_energy(q, qd, **e)[..., None],
        "energy": lambda q, qd, tau, **e: stacked(scene.energy(q, qd, **e), -1),
        "momentum": lambda q, qd, tau, **e: scene.momentum(q, qd, **e),
        "forward_dynamics_variance": lambda q, qd, tau, **e: scene.forward_dynamics_variance(q, qd, tau, torque=0.1, **e),
        "inverse_dynamics_variance": lambda q, qd, tau, **e: scene.inverse_dynamics_variance(q, qd, tau, joints={"armature": 0.1}, **e),
        "variances of links of correlated bodies": lambda q, qd, tau, **e: scene.forward_dynamics_variance(
            q, qd, tau, parameters=1e-4 * np.ones((10 * len(scene.body_names),) * 2), links=link, **e
        ).links[link],
        "inverse_dynamics_variance of correlated bodies": lambda q, qd, tau, **e: scene.inverse_dynamics_variance(
            q, qd, tau, parameters=1e-4 * np.ones((10 * len(scene.body_names),) * 2), **e
        ),
        "integrate": lambda q, qd, tau, **e: scene.integrate(q, qd, **e),
        "difference": lambda q, qd, tau, **e: scene.difference(scene.neutral(), q, **e),
        "inverse_kinematics": lambda q, qd, tau, **e: scene.inverse_kinematics(
            phipsi.tasks.Position(link, (0.1, 0.2, 0.3)), q, starts=1, iterations=3, **e
        ).q,
        "inverse_kinematics_rates": lambda q, qd, tau, **e: scene.inverse_kinematics_rates(
            phipsi.tasks.Position(link, (0.1, 0.2, 0.3)), q, dt=0.1, **e
        ),
        "estimate": lambda q, qd, tau, **e: scene.estimate(q, qd, tau, **e).acceleration,
        "operational_inverse_inertia": lambda q, qd, tau, **e: scene.operational_inverse_inertia(q, link, **e),
        "operational_inertia": lambda q, qd, tau, **e: scene.operational_inertia(q, link, directions=np.eye(6)[:1], **e),
    }


def follower() -> phipsi.Scene:
    """A floating chain in which two joints follow others."""
    builder, random, last = phipsi.SceneBuilder().link("base", 2.0, (0, 0, 0.1), 0.05 * np.eye(3)), np.random.default_rng(4), "base"
    for k in range(4):
        builder.link(f"l{k}", 1.0, tuple(random.uniform(-0.1, 0.1, 3)), 0.02 * np.eye(3))
        follows = {"mimic": f"j{k - 2}", "mimic_multiplier": 1.5, "mimic_offset": 0.1} if k > 1 else {}
        builder.joint(f"j{k}", "revolute", last, f"l{k}", xyz=(0.1, 0, 0.2), axis=tuple(random.normal(size=3)), **follows)  # type: ignore[arg-type]
        last = f"l{k}"
    return builder.build(floating_base=True, mimic="couple")


SCENES = {"independent": lambda: random_scene(2, 9, floating_base=True), "mimic": follower}
CASES = [(kind, name) for kind in SCENES for name in calls(random_scene(2, 9, floating_base=True)) if (kind, name) != ("mimic", "estimate")]


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_good_states_come_back_and_bad_ones_are_nan(kind: str, name: str) -> None:
    scene = SCENES[kind]()
    call = calls(scene)[name]
    q, qd, tau = random_states(scene, 0, (BATCH,))
    expected = call(q, qd, tau)
    q[list(BAD), 4] = np.nan
    with pytest.raises(NotFiniteError):
        call(q, qd, tau)
    with pytest.raises(NotFiniteError):
        call(q, qd, tau, errors="raise")
    with pytest.warns(BadStateWarning, match=rf"^{len(BAD)} of {BATCH} states could not be computed and are NaN: ") as caught:
        found = call(q, qd, tau, errors="nan")
    good = np.setdiff1d(np.arange(BATCH), BAD)
    assert_same_bits(found[good], expected[good])
    assert np.isnan(found[list(BAD)]).all()
    (warning,) = caught
    assert warning.filename == __file__
    assert isinstance(warning.message, BadStateWarning)
    assert warning.message.states == BAD
    assert [(reason.argument, reason.index) for reason in warning.message.reasons] == [({"difference": "q1", "inverse_kinematics": "q0"}.get(name, "q"), 4)] * len(BAD)
    assert [reason.state for reason in warning.message.reasons] == list(BAD)


@pytest.mark.parametrize("name", ["forward_dynamics", "energy"])
def test_nothing_is_told_where_all_is_well(floating: phipsi.Scene, name: str) -> None:
    call, state = calls(floating)[name], random_states(floating, 0, (20,))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_same_bits(call(*state, errors="nan"), call(*state))


def test_one_state(arm: phipsi.Scene) -> None:
    q, qd, tau = random_states(arm, 0)
    assert_same_bits(arm.forward_dynamics(q, qd, tau, errors="nan"), arm.forward_dynamics(q, qd, tau))
    qd[3] = np.inf
    with pytest.warns(BadStateWarning, match="1 of 1 states could not be computed and is NaN: qd: found inf at index 3;") as caught:
        found = arm.forward_dynamics(q, qd, tau, errors="nan")
    assert found.shape == (7,) and np.isnan(found).all()
    assert caught[0].message.states == ((),)  # type: ignore[union-attr]
    assert caught[0].message.reasons[0].state is None  # type: ignore[union-attr]


def test_all_states_of_a_batch_and_of_two_axes(arm: phipsi.Scene) -> None:
    q, qd, tau = random_states(arm, 0, (3, 40))
    tau[1, 7, 2] = tau[2, 39, 0] = np.nan
    with pytest.warns(BadStateWarning) as caught:
        found = arm.forward_dynamics(q, qd, tau, errors="nan")
    assert caught[0].message.states == ((1, 7), (2, 39))  # type: ignore[union-attr]
    assert np.isnan(found).any(axis=-1).sum() == 2
    with pytest.warns(BadStateWarning, match=r"120 of 120 states .*; \.\.\. \(\.states and \.reasons of this warning list all\)"):
        found = arm.forward_dynamics(np.full(7, np.nan), qd, tau, errors="nan")
    assert np.isnan(found).all()


@pytest.mark.parametrize("states", [1, 2, 9, 4096])
def test_out_is_filled_and_returned(arm: phipsi.Scene, states: int) -> None:
    q, qd, tau = random_states(arm, 0, (states,))
    q[-1] = np.inf
    out = np.zeros((states, 7))
    with pytest.warns(BadStateWarning):
        assert arm.forward_dynamics(q, qd, tau, errors="nan", out=out) is out
    assert np.isnan(out[-1]).all()
    assert_same_bits(out[:-1], arm.forward_dynamics(q[:-1], qd[:-1], tau[:-1]))


def test_the_same_bits_on_any_number_of_threads(arm: phipsi.Scene) -> None:
    q, qd, tau = random_states(arm, 0, (20_000,))
    bad = np.random.default_rng(0).random(len(q)) < 0.1
    q[bad, 2] = np.nan
    before = phipsi.get_num_threads()
    found = []
    try:
        for threads in (1, 4):
            phipsi.set_num_threads(threads)
            with pytest.warns(BadStateWarning) as caught:
                found.append(arm.forward_dynamics(q, qd, tau, errors="nan"))
            assert caught[0].message.states == tuple(np.flatnonzero(bad))  # type: ignore[union-attr]
    finally:
        phipsi.set_num_threads(before)
    assert_same_bits(found[0], found[1])
    assert_same_bits(found[0][~bad], arm.forward_dynamics(q[~bad], qd[~bad], tau[~bad]))


def test_every_kind_of_bad_state() -> None:
    scene = random_scene(2, 9, floating_base=True)
    q, qd, tau = random_states(scene, 0, (40,))
    q[3, 3:7] *= 1.1
    q[5, 0] = -np.inf
    qd[8] *= 1e200
    tau[11, 4] = np.nan
    wrench = np.zeros((40, 6))
    wrench[20, 1] = np.inf
    link = scene.link_names[-1]
    with pytest.warns(BadStateWarning) as caught:
        found = scene.forward_dynamics(q, qd, tau, wrenches={link: wrench}, errors="nan")
    message = caught[0].message
    assert isinstance(message, BadStateWarning)
    assert message.states == (3, 5, 8, 11, 20)
    assert [type(reason) for reason in message.reasons] == [ArgumentError, *[NotFiniteError] * 4]
    for text, reason in zip(("quaternion", "q: found", "overflow", "tau: found", f'wrenches["{link}"]: found'), message.reasons, strict=True):
        assert text in str(reason)
    assert np.isnan(found[list(message.states)]).all()
    assert np.isfinite(np.delete(found, message.states, axis=0)).all()


def test_singular_joints_are_bad_states() -> None:
    """Two hinges through one point mass: the outer one is singular if the mass is on its axis."""
    builder = phipsi.SceneBuilder().link("base").link("frame").link("mass", 1.0, (1.0, 0, 0))
    builder.joint("inner", "revolute", "base", "frame", axis=(0, 0, 1), armature=1.0)
    builder.joint("outer", "revolute", "frame", "mass", axis=(0, 1, 0))
    scene = builder.build().to_builder().link("tip", 1.0).joint("last", "prismatic", "mass", "tip", axis=(1, 0, 0)).build()
    massless = phipsi.SceneBuilder().link("base").link("mass", 1.0).joint("hinge", "revolute", "base", "mass").build()
    with pytest.warns(BadStateWarning, match='joint "hinge"') as caught:
        found = massless.mass_matrix_inverse(np.zeros((4, 1)), errors="nan")
    assert np.isnan(found).all() and found.shape == (4, 1, 1)
    assert isinstance(caught[0].message, BadStateWarning)
    assert all(isinstance(reason, SingularJointError) and reason.joint == "hinge" for reason in caught[0].message.reasons)
    assert np.isfinite(scene.mass_matrix_inverse(np.zeros((4, 3)))).all()


def test_singular_tasks_are_bad_states() -> None:
    builder = phipsi.SceneBuilder().link("base")
    for k in range(2):
        builder.link(f"link{k}", 1.0, (0.5, 0, 0), np.eye(3) * 0.1)
        builder.joint(f"joint{k}", "revolute", f"link{k - 1}" if k else "base", f"link{k}", xyz=(1.0 if k else 0, 0, 0))
    scene = builder.build()
    q = np.array([[0.1, 0.5], [0.2, 0.0], [0.3, -0.7]])
    plane = np.eye(6)[3:5]
    with pytest.warns(BadStateWarning) as caught:
        found = scene.operational_inertia(q, "link1", at=(1, 0, 0), directions=plane, errors="nan")
    assert isinstance(caught[0].message, BadStateWarning)
    assert caught[0].message.states == (1,)
    assert isinstance(caught[0].message.reasons[0], SingularTaskError)
    assert np.isfinite(found[[0, 2]]).all() and np.isnan(found[1]).all()


BROKEN: dict[str, tuple[dict[str, Any], type[Exception], str]] = {
    "shape": ({"q": np.zeros(6)}, ShapeError, "q: found shape"),
    "axes": ({"q": np.zeros((3, 7)), "tau": np.zeros((2, 7))}, ShapeError, "tau: found shape"),
    "object": ({"tau": None}, ArgumentError, "tau: found dtype object"),
    "errors": ({"errors": "ignore"}, ArgumentError, 'errors: found "ignore"; expected one of "raise", "nan"'),
    "form": ({"form": "best"}, ArgumentError, "form: found"),
    "link": ({"wrenches": {"hand": np.zeros(6)}}, ArgumentError, 'wrenches: found "hand"'),
}


@pytest.mark.parametrize("case", BROKEN)
def test_what_is_wrong_with_the_call_raises(arm: phipsi.Scene, case: str) -> None:
    replaced, error, message = BROKEN[case]
    valid: dict[str, Any] = {**random_states(arm, 0)._asdict(), "errors": "nan"}
    with pytest.raises(error, match=message):
        arm.forward_dynamics(**(valid | replaced))


def test_what_is_wrong_with_the_scene_or_the_call_raises() -> None:
    with pytest.warns(phipsi.errors.InertiaWarning):
        scene = phipsi.SceneBuilder().link("a").link("b", 1.0, (1, 0, 0), -np.eye(3) * 0.1).joint("j", "revolute", "a", "b").build()
    for call in (
        lambda: scene.forward_dynamics(np.zeros((2, 1)), np.zeros(1), np.zeros(1), form="square-root", errors="nan"),
        lambda: scene.mass_matrix_inverse(np.zeros((2, 1)), form="square-root", errors="nan"),
    ):
        with pytest.raises(ArgumentError, match='inertia of link "b"'):
            call()
    arm = random_scene(3, 3, kinds=("revolute",))
    state = random_states(arm, 0, (2,))
    with pytest.raises(ArgumentError, match="acceleration_variance"):
        arm.estimate(*state, acceleration_variance=-1.0, errors="nan")
    with pytest.raises(NotFiniteError, match="directions"):
        arm.operational_inertia(state.q, "link2", directions=[[np.nan, 0, 0, 0, 0, 0]], errors="nan")


def test_a_filter_can_raise_it(arm: phipsi.Scene) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", BadStateWarning)
        with pytest.raises(BadStateWarning) as found:
            arm.bias_torque(np.full((2, 7), np.nan), np.zeros(7), errors="nan")
    again = pickle.loads(pickle.dumps(found.value))
    assert again.states == (0, 1)
    assert [str(reason) for reason in again.reasons] == [str(reason) for reason in found.value.reasons]
