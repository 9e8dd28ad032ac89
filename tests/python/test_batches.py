"""Batches: bitwise equality with single states, broadcasting, no states, no joints."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import OF_MASS, State, methods, random_scene, random_states
from hypothesis import given, settings
from hypothesis import strategies as st
from tolerances import assert_same_bits

import phipsi
from phipsi.errors import ArgumentError, ShapeError


TWO = random_scene(4, 2, kinds=("revolute", "prismatic"))


@pytest.mark.parametrize("states", [1, 2, 5, 600])
def test_a_batch_has_the_bits_of_its_states(mixed: phipsi.Scene, method: str, states: int) -> None:
    state = random_states(mixed, states, (states,))
    evaluate, arguments = methods(mixed, state)[method]
    together = np.asarray(evaluate(*arguments))
    assert len(together) == states
    for i in range(0, states, max(1, states // 50)):
        assert_same_bits(together[i], evaluate(*(argument[i] for argument in arguments)))


def test_rank_in_is_rank_out(floating: phipsi.Scene, method: str) -> None:
    state = random_states(floating, 0, (2, 3, 4))
    evaluate, arguments = methods(floating, state)[method]
    grid = np.asarray(evaluate(*arguments))
    flat = np.asarray(evaluate(*(argument.reshape(24, -1) for argument in arguments)))
    one = np.asarray(evaluate(*(argument[0, 0, 0] for argument in arguments)))
    assert grid.shape == (2, 3, 4, *one.shape)
    assert_same_bits(grid.reshape(flat.shape), flat)


SHAPES = [
    ((3, 1), (4,), (3, 4)),
    ((), (2, 3), (2, 3)),
    ((5, 1, 2), (4, 1), (5, 4, 2)),
    ((1, 1), (1,), (1, 1)),
    ((2, 3), (2, 3), (2, 3)),
]


@pytest.mark.parametrize(("of_q", "of_qd", "batch"), SHAPES)
@pytest.mark.parametrize("swapped", [False, True])
def test_leading_axes_broadcast(
    mixed: phipsi.Scene, of_q: tuple[int, ...], of_qd: tuple[int, ...], batch: tuple[int, ...], swapped: bool
) -> None:
    if swapped:
        of_q, of_qd = of_qd, of_q
    q, qd, tau = random_states(mixed, 0, of_q).q, random_states(mixed, 1, of_qd).qd, random_states(mixed, 2).tau
    wrench = random_states(mixed, 3, of_q).q[..., :6]
    full = State(
        np.broadcast_to(q, (*batch, mixed.nq)).copy(),
        np.broadcast_to(qd, (*batch, mixed.nv)).copy(),
        np.broadcast_to(tau, (*batch, mixed.nv)).copy(),
    )
    pushed = {"link4": np.broadcast_to(wrench, (*batch, 6)).copy()}
    assert_same_bits(
        mixed.forward_dynamics(q, qd, tau, wrenches={"link4": wrench}), mixed.forward_dynamics(*full, wrenches=pushed)
    )
    assert_same_bits(mixed.inverse_dynamics(q, qd, tau), mixed.inverse_dynamics(*full))
    assert_same_bits(mixed.bias_torque(q, qd), mixed.bias_torque(full.q, full.qd))
    assert_same_bits(np.array(mixed.energy(q, qd)), np.array(mixed.energy(full.q, full.qd)))
    assert_same_bits(mixed.integrate(q, qd), mixed.integrate(full.q, full.qd))


AXES = st.lists(st.integers(0, 3), max_size=4).map(tuple)


@settings(max_examples=300, deadline=None)
@given(st.tuples(AXES, AXES, AXES, AXES))
def test_leading_axes_broadcast_by_numpy_s_rule(axes: tuple[tuple[int, ...], ...]) -> None:
    scene = TWO
    q, qd, tau, wrench = (np.random.default_rng(k).normal(size=(*own, 6 if k == 3 else 2)) for k, own in enumerate(axes))
    try:
        batch = np.broadcast_shapes(*axes)
    except ValueError:
        with pytest.raises(ShapeError, match="leading axes that broadcast with"):
            scene.forward_dynamics(q, qd, tau, wrenches={"link1": wrench})
        return
    found = scene.forward_dynamics(q, qd, tau, wrenches={"link1": wrench})
    assert found.shape == (*batch, 2)
    full = [np.broadcast_to(x, (*batch, x.shape[-1])) for x in (q, qd, tau, wrench)]
    for i in np.ndindex(batch):
        one = scene.forward_dynamics(full[0][i], full[1][i], full[2][i], wrenches={"link1": full[3][i]})
        assert_same_bits(found[i], one)


def test_a_wrench_alone_can_make_a_batch(arm: phipsi.Scene) -> None:
    q, qd, tau = random_states(arm, 0)
    wrenches = np.arange(18.0).reshape(3, 6)
    together = arm.forward_dynamics(q, qd, tau, wrenches={"link6": wrenches})
    assert together.shape == (3, 7)
    for found, wrench in zip(together, wrenches, strict=True):
        assert_same_bits(found, arm.forward_dynamics(q, qd, tau, wrenches={"link6": wrench}))


@pytest.mark.parametrize("batch", [(0,), (3, 0), (0, 2)])
def test_no_states(mixed: phipsi.Scene, method: str, batch: tuple[int, ...]) -> None:
    state = State(np.zeros((*batch, mixed.nq)), np.zeros((*batch, mixed.nv)), np.zeros((*batch, mixed.nv)))
    evaluate, arguments = methods(mixed, state)[method]
    single, one = methods(mixed, random_states(mixed, 0))[method]
    assert np.asarray(evaluate(*arguments)).shape == (*batch, *np.asarray(single(*one)).shape)


def test_no_states_broadcast(arm: phipsi.Scene) -> None:
    q, qd, tau = random_states(arm, 0)
    assert arm.forward_dynamics(np.zeros((0, 7)), qd, tau).shape == (0, 7)
    assert arm.forward_dynamics(q, np.zeros((0, 7)), np.zeros((1, 7))).shape == (0, 7)


@pytest.mark.parametrize("batch", [(), (3,), (2, 2), (0,)])
def test_no_joints(welded: phipsi.Scene, method: str, batch: tuple[int, ...]) -> None:
    nothing = np.zeros((*batch, 0))
    shapes = {"mass_matrix": (0, 0), "mass_matrix_inverse": (0, 0), "jacobian": (6, 0), "momentum": (6,), "energy": (2,)}
    shapes["placements"] = shapes["poses"] = shapes["placement of several"] = (2, 4, 4)
    shapes.update({"placement": (4, 4), "velocity": (6,), "acceleration": (6,), "kinetic_energy": (), "potential_energy": ()})
    shapes.update({"jacobian at a point": (6, 0), "jacobian_rate": (6, 0), "jacobian_rate_product": (6,)})
    shapes.update({"velocity_derivatives": (2, 6, 0), "acceleration_derivatives": (3, 6, 0), "jacobian_derivatives": (6, 0, 0)})
    shapes["coriolis_matrix"] = shapes["mass_matrix_derivative"] = (0, 0)
    shapes["inverse_dynamics_derivatives"] = shapes["forward_dynamics_derivatives"] = (0, 0)
    evaluate, arguments = methods(welded, State(nothing, nothing, nothing))[method]
    if method in OF_MASS:
        with pytest.raises(ArgumentError, match="scene: found moving links with a total mass of 0 kg"):
            evaluate(*arguments)
        return
    if method == "difference":
        assert welded.difference(nothing, nothing).shape == (*batch, 0)
    found = np.asarray(evaluate(*arguments))
    assert found.shape == (*batch, *shapes.get(method, (0,)))


def test_no_joints_has_names_and_numbers(welded: phipsi.Scene) -> None:
    assert (welded.nq, welded.nv) == (0, 0)
    assert welded.joint_names == welded.body_names == ()
    assert welded.neutral().shape == (0,)
    assert welded.limits.lower.shape == (0,)
    assert welded.placements([])["mast"][2, 3] == 1.0
    assert welded.energy([], []) == (0.0, 0.0)
