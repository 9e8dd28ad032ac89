"""Results of a scene are preserved by pickle and copy; builders and scenes are in test_changed_scenes.py."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import random_scene, random_states
from tolerances import assert_same_bits

import phipsi

Remade = Callable[[Any], Any]
WAYS: dict[str, Remade] = {
    **{f"pickle {protocol}": lambda x, p=protocol: pickle.loads(pickle.dumps(x, p)) for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1)},  # type: ignore[misc]
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
}


@pytest.fixture(params=WAYS)
def remade(request: pytest.FixtureRequest) -> Remade:
    return WAYS[request.param]


FORMS = ("auto", "covariance", "square-root")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("batch", [(), (3,), (2, 2), (0,)])
def test_factors(remade: Remade, form: Any, batch: tuple[int, ...]) -> None:
    scene = random_scene(2, 6, floating_base=True, armature=0.1)
    q, _, tau = random_states(scene, 0, batch)
    factor = scene.factor(q, form=form)
    again = remade(factor)
    assert isinstance(again, phipsi.Factor)
    assert (again.nv, again.batch, repr(again)) == (factor.nv, factor.batch, repr(factor))
    assert_same_bits(again.solve(tau), factor.solve(tau))
    assert_same_bits(again.mul(tau), factor.mul(tau))
    assert_same_bits(np.asarray(again.log_det), np.asarray(factor.log_det))
    assert_same_bits(again.K.toarray(), factor.K.toarray())


@pytest.mark.parametrize("form", FORMS)
def test_factors_that_were_updated(arm: phipsi.Scene, remade: Remade, form: Any) -> None:
    q, _, tau = random_states(arm, 0)
    factor = arm.factor(q, form=form)
    moved = q + np.r_[np.zeros(6), 0.3]
    factor.update(moved)
    again = remade(factor)
    assert_same_bits(again.solve(tau), factor.solve(tau))
    # The copies are independent.
    before = factor.solve(tau)
    again.update(q)
    assert_same_bits(factor.solve(tau), before)
    assert_same_bits(again.solve(tau), arm.factor(q, form=form).solve(tau))


OPERATORS: dict[str, Callable[[phipsi.Factor], phipsi.Operator]] = {
    **{name: lambda f, name=name: getattr(f, name) for name in ("I", "D", "K", "L", "M", "M_inv", "H", "phi", "psi", "P", "g", "Lambda", "S")},  # type: ignore[misc]
    "inverse of D": lambda f: f.D.inv(),
    "transpose": lambda f: f.K.T,
    "sum": lambda f: 1 + f.K,
    "scaled": lambda f: -2.0 * f.L,
    "(4.1)": lambda f: (f.I - f.L.T) @ f.D.inv() @ (f.I - f.L),
}


@pytest.mark.parametrize("name", OPERATORS)
def test_operators(arm: phipsi.Scene, remade: Remade, name: str) -> None:
    operator = OPERATORS[name](arm.factor(random_states(arm, 0).q))
    again = remade(operator)
    x = np.random.default_rng(0).normal(size=operator.shape[1])
    y = np.random.default_rng(1).normal(size=operator.shape[0])
    assert (again.shape, str(again), repr(again)) == (operator.shape, str(operator), repr(operator))
    assert_same_bits(again @ x, operator @ x)
    assert_same_bits(again.T @ y, operator.T @ y)
    assert_same_bits(again.toarray(), operator.toarray())


def test_operators_keep_their_factor(arm: phipsi.Scene) -> None:
    q = random_states(arm, 0).q
    factor = arm.factor(q)
    again, operator = pickle.loads(pickle.dumps((factor, factor.K)))
    again.update(q + 0.1)
    assert_same_bits(operator.toarray(), arm.factor(q + 0.1).K.toarray())


@pytest.mark.parametrize("with_rates", [False, True])
def test_random_models(arm: phipsi.Scene, remade: Remade, with_rates: bool) -> None:
    q, qd, _ = random_states(arm, 0)
    model = arm.random_model(q, qd if with_rates else None, acceleration_variance=2.5)
    again = remade(model)
    assert (again.nv, again.dimension, again.acceleration_variance) == (model.nv, model.dimension, 2.5)
    for one, other in zip(again.sample(5, seed=3), model.sample(5, seed=3), strict=True):
        assert_same_bits(one, other)
    assert_same_bits(again.mass_matrix(method="sigma-points").mass_matrix, model.mass_matrix(method="sigma-points").mass_matrix)


def test_plans(mixed: phipsi.Scene, remade: Remade) -> None:
    plan = mixed.lock(["joint1"], mixed.neutral()).plan()
    again = remade(plan)
    assert again == plan and hash(again) == hash(plan) and repr(again) == repr(plan)
    assert (again.bodies, again.links) == (plan.bodies, plan.links)
    fields = ("what", "switch", "operations", "count", "names", "why", "saved")
    for one, other in zip(again.items, plan.items, strict=True):
        assert [getattr(one, field) for field in fields] == [getattr(other, field) for field in fields]
        assert remade(other) == other
    assert plan != mixed.plan()


def test_other_results(arm: phipsi.Scene, remade: Remade) -> None:
    q, qd, tau = random_states(arm, 0)
    path = arm.simulate(q, qd, dt=1e-3, steps=3)
    assert_same_bits(remade(path).q, path.q)
    assert_same_bits(remade(path).energy().total, path.energy().total)
    assert_same_bits(remade(arm.estimate(q, qd, tau)).acceleration, arm.estimate(q, qd, tau).acceleration)
    assert_same_bits(remade(arm.limits).lower, arm.limits.lower)
    ode = arm.ode(tau=tau)
    y = np.concatenate([np.zeros(7), qd])
    assert_same_bits(remade(ode).rhs(0.0, y), ode.rhs(0.0, y))
    case = phipsi.scenes.extreme("heavy-tip")
    again = remade(case)
    assert_same_bits(again.scene.forward_dynamics(*again[1:4]), case.scene.forward_dynamics(*case[1:4]))


def test_errors_pickle(arm: phipsi.Scene) -> None:
    with pytest.raises(phipsi.errors.NotFiniteError) as found:
        arm.mass_matrix(np.full((3, 7), np.nan))
    again = pickle.loads(pickle.dumps(found.value))
    assert (str(again), again.argument, again.state) == (str(found.value), "q", 0)
