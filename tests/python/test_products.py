"""Jacobians of the dynamics times vectors, and vectors times them: compared with dense derivatives, with differences,
and as calls.
"""

from __future__ import annotations

import numpy as np
import pytest
from conftest import random_scene, random_states
from tolerances import assert_near, assert_same_bits, inverse, recursion

import phipsi
from phipsi.errors import ArgumentError, BadStateWarning, NotFiniteError, ShapeError

SEEDS = range(8)


def a_scene(seed: int) -> phipsi.Scene:
    return random_scene(seed, 6, floating_base=seed % 2 == 1)


def largest(*arrays: np.ndarray) -> float:
    return max(float(np.max(np.abs(values), initial=0.0)) for values in arrays)


def condition(scene: phipsi.Scene, q: np.ndarray) -> float:
    return float(np.linalg.cond(scene.mass_matrix(q)))


def wrenches_of(scene: phipsi.Scene, random: np.random.Generator) -> dict[str, np.ndarray]:
    """One on every second link, including those on fixed joints and on the base."""
    return {link: random.uniform(-3.0, 3.0, 6) for link in scene.link_names[::2]}


@pytest.mark.parametrize("seed", SEEDS)
def test_of_torques_as_dense_derivatives(seed: int) -> None:
    scene, random = a_scene(seed), np.random.default_rng(seed)
    q, qd, qdd = random_states(scene, seed)
    wrenches = wrenches_of(scene, random)
    dense = scene.inverse_dynamics_derivatives(q, qd, qdd, wrenches=wrenches)
    scale = scene.nv * largest(*dense, scene.inverse_dynamics(q, qd, qdd, wrenches=wrenches))
    direction, cotangent = random.uniform(-1, 1, (3, scene.nv)), random.uniform(-1, 1, scene.nv)
    found = scene.inverse_dynamics_jvp(q, qd, qdd, *direction, wrenches=wrenches)
    expected = sum(matrix @ along for matrix, along in zip(dense, direction, strict=True))
    assert_near(found, expected, recursion(scene.nv, scale))
    for asked in (False, True):
        gradients = scene.inverse_dynamics_vjp(q, qd, qdd, cotangent, wrenches=wrenches, parameters=asked)
        for one, matrix in zip(gradients[:3], dense, strict=True):
            assert_near(one, cotangent @ matrix, recursion(scene.nv, scale))
        assert list(gradients.wrenches) == list(wrenches)
        assert all((gradients[i] is None) == (not asked) for i in (4, 5, 6))
        for link, one in gradients.wrenches.items():
            assert_near(one, -scene.jacobian(q, link) @ cotangent, recursion(scene.nv, scale))
    plain = scene.inverse_dynamics_vjp(q, qd, qdd, cotangent)
    assert plain.wrenches is None and plain.parameters is None


@pytest.mark.parametrize("form", ["auto", "covariance", "square-root"])
@pytest.mark.parametrize("seed", SEEDS)
def test_of_accelerations_as_dense_derivatives(seed: int, form: str) -> None:
    scene, random = a_scene(seed), np.random.default_rng(seed)
    q, qd, tau = random_states(scene, seed)
    wrenches = wrenches_of(scene, random)
    dense = scene.forward_dynamics_derivatives(q, qd, tau, wrenches=wrenches)
    qdd = scene.forward_dynamics(q, qd, tau, wrenches=wrenches)
    scale, cond = scene.nv * largest(*dense, qdd), condition(scene, q)
    direction, cotangent = random.uniform(-1, 1, (3, scene.nv)), random.uniform(-1, 1, scene.nv)
    found = scene.forward_dynamics_jvp(q, qd, tau, *direction, form=form, wrenches=wrenches)
    expected = sum(matrix @ along for matrix, along in zip(dense, direction, strict=True))
    assert_near(found, expected, inverse(cond, scale))
    gradients = scene.forward_dynamics_vjp(q, qd, tau, cotangent, form=form, wrenches=wrenches)
    for one, matrix in zip(gradients[:3], dense, strict=True):
        assert_near(one, cotangent @ matrix, inverse(cond, scale))
    for link, one in gradients.wrenches.items():
        of_torque = scene.jacobian(q, link) @ gradients.tau
        assert_near(one, of_torque, inverse(cond, max(scale, largest(of_torque))))


def parameters_of(link: phipsi.Link) -> np.ndarray:
    """(m, m c, I) about the link origin."""
    m, c = link.mass, link.com
    about = link.inertia + m * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([m, *(m * c), about[0, 0], about[0, 1], about[1, 1], about[0, 2], about[1, 2], about[2, 2]])


@pytest.mark.parametrize("seed", SEEDS)
def test_torques_are_linear_in_parameters(seed: int) -> None:
    """The products of parameters and their gradients, including armature, sum up to cotangent . tau: for links without
    fixed children.
    """
    scene = random_scene(seed, 6, kinds=("revolute", "prismatic", "spherical"), floating_base=seed % 2 == 1)
    q, qd, qdd = random_states(scene, seed)
    cotangent = np.random.default_rng(seed).uniform(-1, 1, scene.nv)
    found = scene.inverse_dynamics_vjp(q, qd, qdd, cotangent, parameters=True)
    own = np.stack([parameters_of(scene.link(name)) for name in scene.body_names])
    assert found.parameters.shape == own.shape
    total = np.sum(found.parameters * own) + found.armature @ scene.armature
    expected = cotangent @ scene.inverse_dynamics(q, qd, qdd)
    assert_near(total, expected, recursion(10 * scene.nv, largest(found.parameters * own, expected)))
    # Gravity is an acceleration of all bodies in the opposite direction.
    still = np.zeros(scene.nv)
    held = scene.inverse_dynamics_vjp(q, still, still, cotangent, parameters=True)
    weight = cotangent @ scene.bias_torque(q, still)
    assert_near(held.gravity @ scene.gravity, weight, recursion(10 * scene.nv, largest(held.gravity * scene.gravity, weight)))


@pytest.mark.parametrize("seed", SEEDS)
def test_hessians_as_differences(seed: int) -> None:
    """To the two thirds of the digits that differences in float64 preserve."""
    scene, random = a_scene(seed), np.random.default_rng(seed)
    q, qd, u = random_states(scene, seed)
    direction, cotangent = random.uniform(-1, 1, (3, scene.nv)), random.uniform(-1, 1, scene.nv)
    step = 6e-6
    for hvp, vjp in ((scene.inverse_dynamics_hvp, scene.inverse_dynamics_vjp), (scene.forward_dynamics_hvp, scene.forward_dynamics_vjp)):
        found = hvp(q, qd, u, cotangent, *direction)
        assert found[3:] == (None,) * 4
        ahead, back = (
            vjp(scene.integrate(q, h * direction[0]), qd + h * direction[1], u + h * direction[2], cotangent)
            for h in (step, -step)
        )
        for one, a, b in zip(found[:3], ahead, back, strict=False):
            scale = largest(*found[:3], *ahead[:3]) * condition(scene, q)
            assert_near(one, (a - b) / (2 * step), 1e-8 * scale)


def test_batches_and_single_states(mixed: phipsi.Scene) -> None:
    q, qd, u = random_states(mixed, 3, (4, 5))
    cotangent = random_states(mixed, 8)[1]
    found = mixed.forward_dynamics_vjp(q, qd, u, cotangent, wrenches={mixed.link_names[-1]: np.ones((5, 6))}, parameters=True)
    assert found.parameters.shape == (4, 5, len(mixed.body_names), 10)
    assert found.gravity.shape == (4, 5, 3) and found.armature.shape == found.q.shape == (4, 5, mixed.nv)
    assert found.wrenches[mixed.link_names[-1]].shape == (4, 5, 6)
    one = mixed.forward_dynamics_vjp(
        q[2, 3], qd[2, 3], u[2, 3], cotangent, wrenches={mixed.link_names[-1]: np.ones(6)}, parameters=True
    )
    for name in ("q", "qd", "tau", "parameters", "armature", "gravity"):
        assert_same_bits(getattr(found, name)[2, 3], getattr(one, name))
    along = mixed.inverse_dynamics_jvp(q, qd, u, qd[0, 0], qd, 0 * qd)
    assert along.shape == (4, 5, mixed.nv)
    assert_same_bits(along[1, 2], mixed.inverse_dynamics_jvp(q[1, 2], qd[1, 2], u[1, 2], qd[0, 0], qd[1, 2], 0 * qd[0, 0]))


def test_bad_arguments(arm: phipsi.Scene) -> None:
    q, qd, u = random_states(arm, 1)
    arm.forward_dynamics_vjp(q, qd, u, qd)
    with pytest.raises(ShapeError, match="cotangent"):
        arm.forward_dynamics_vjp(q, qd, u, qd[:3])
    with pytest.raises(ShapeError, match="dqd"):
        arm.inverse_dynamics_jvp(q, qd, u, qd, qd[:3], u)
    with pytest.raises(NotFiniteError, match="cotangent"):
        arm.inverse_dynamics_vjp(q, qd, u, np.full(7, np.nan))
    with pytest.raises(NotFiniteError, match="dtau"):
        arm.forward_dynamics_jvp(q, qd, u, qd, qd, np.full(7, np.inf))
    with pytest.raises(NotFiniteError, match="dqdd"):
        arm.inverse_dynamics_hvp(q, qd, u, qd, qd, qd, np.full(7, np.inf))
    with pytest.raises(ArgumentError, match="form"):
        arm.forward_dynamics_vjp(q, qd, u, qd, form="none")
    with pytest.raises(ArgumentError, match="wrenches"):
        arm.forward_dynamics_vjp(q, qd, u, qd, wrenches=[1.0])
    with pytest.raises(ArgumentError, match="wrenches"):
        arm.forward_dynamics_vjp(q, qd, u, qd, wrenches={"nothing": np.zeros(6)})


@pytest.mark.parametrize("parameters", [False, True])
def test_bad_states_become_nan(arm: phipsi.Scene, parameters: bool) -> None:
    q, qd, u = random_states(arm, 1, (5,))
    cotangent = np.array(qd)
    cotangent[2, 3] = np.nan
    with pytest.warns(BadStateWarning) as caught:
        found = arm.forward_dynamics_vjp(q, qd, u, cotangent, parameters=parameters, errors="nan")
    assert caught[0].message.states == (2,)
    bad = np.isnan(found.q).all(axis=-1)
    assert bad.tolist() == [False, False, True, False, False]
    assert np.isfinite(found.tau[~bad]).all()


@pytest.mark.parametrize("form", ["auto", "square-root"])
@pytest.mark.parametrize("seed", range(4))
def test_along_what_is_constant_as_the_adjoint_has_it(seed: int, form: str) -> None:
    """<c, J d> = <J* c, d> for wrenches, parameters, armature and gravity, all together and one by one."""
    scene, random = a_scene(seed), np.random.default_rng(seed)
    q, qd, u = random_states(scene, seed)
    wrenches = wrenches_of(scene, random)
    c, zero = random.uniform(-1, 1, scene.nv), np.zeros(scene.nv)
    direction = random.uniform(-1, 1, (3, scene.nv))
    changes = {
        "dwrenches": wrenches_of(scene, random),
        "dparameters": 0.01 * random.uniform(-1, 1, (len(scene.body_names), 10)),
        "darmature": random.uniform(-1, 1, scene.nv),
        "dgravity": random.uniform(-1, 1, 3),
    }
    calls = (
        (scene.inverse_dynamics_jvp, scene.inverse_dynamics_vjp, {}, 1.0),
        (scene.forward_dynamics_jvp, scene.forward_dynamics_vjp, {"form": form}, condition(scene, q)),
    )
    for jvp, vjp, more, allowed in calls:
        gradients = vjp(q, qd, u, c, wrenches=wrenches, parameters=True, **more)
        parts = {
            "dwrenches": sum(float(one @ changes["dwrenches"][link]) for link, one in gradients.wrenches.items()),
            **{f"d{name}": float(np.sum(getattr(gradients, name) * changes[f"d{name}"])) for name in ("parameters", "armature", "gravity")},
        }
        of_state = sum(float(one @ along) for one, along in zip(gradients[:3], direction, strict=True))
        terms = scene.nv * largest(*gradients[:3], gradients.parameters, gradients.armature, gradients.gravity, np.ones(1))
        bound = inverse(scene.nv * allowed, terms)
        both = c @ jvp(q, qd, u, *direction, wrenches=wrenches, **changes, **more)
        assert_near(both, of_state + sum(parts.values()), bound)
        for name, part in parts.items():
            assert_near(c @ jvp(q, qd, u, zero, zero, zero, wrenches=wrenches, **{name: changes[name]}, **more), part, bound)
            assert part != 0.0


def test_changes_of_what_is_constant_broadcast() -> None:
    scene = a_scene(1)
    q, qd, u = random_states(scene, 1, (3, 1))
    zero, change = np.zeros(scene.nv), np.random.default_rng(2).uniform(-1, 1, (2, len(scene.body_names), 10))
    found = scene.inverse_dynamics_jvp(q, qd, u, zero, zero, zero, dparameters=change)
    assert found.shape == (3, 2, scene.nv)
    alone = scene.inverse_dynamics_jvp(q[2, 0], qd[2, 0], u[2, 0], zero, zero, zero, dparameters=change[1])
    assert_same_bits(found[2, 1], alone)


BAD_CHANGES = {
    "dwrenches": {"nowhere": np.zeros(6)},
    "dparameters": np.zeros((1, 10)),
    "darmature": np.zeros(2),
    "dgravity": np.zeros(4),
}


@pytest.mark.parametrize("name", BAD_CHANGES)
def test_a_bad_change_is_named(name: str) -> None:
    scene = a_scene(0)
    q, qd, u = random_states(scene, 0)
    with pytest.raises((ShapeError, ArgumentError), match=name):
        scene.inverse_dynamics_jvp(q, qd, u, qd, qd, qd, **{name: BAD_CHANGES[name]})
