"""Results of a scene are preserved by pickle and copy; builders and scenes are in test_changed_scenes.py."""

from __future__ import annotations

import copy
import inspect
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


def test_motion_plans(arm: phipsi.Scene, remade: Remade) -> None:
    control = phipsi.control
    costs = [control.Effort(10.0), control.EffortRate(100.0), control.Terminal(phipsi.tasks.Position(arm.link_names[-1], (0.3, 0.1, 0.4)))]
    plan = arm.optimize(arm.neutral() + 0.1, dt=0.02, steps=10, costs=costs)
    again, unsure = remade(plan), phipsi.estimation.MotionUncertainty(torque_noise=1e-3)
    for name in ("q", "qd", "tau", "gains"):
        assert_same_bits(getattr(again, name), getattr(plan, name))
    assert_same_bits(again.expected(unsure).covariance, plan.expected(unsure).covariance)
    assert_same_bits(again.resume(plan.q[1], plan.qd[1]).tau, plan.resume(plan.q[1], plan.qd[1]).tau)


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


def gyro_and_encoder(scene: phipsi.Scene, history: int, batch: tuple[int, ...]) -> phipsi.estimation.Observer:
    """With a delay, a bias and a wrench, and an uncertain state."""
    sensors = [phipsi.estimation.Encoder(noise=1e-4), phipsi.estimation.Gyro(link="link6", noise=1e-3, delay=3, bias=0.1)]
    wrench = phipsi.estimation.ExternalWrench("link6", density=1.0)
    return scene.observer(2e-3, sensors, q=np.full((*batch, 6), 0.5), torque_noise=1e-3, wrenches=[wrench], history=history)


def observed(observer: phipsi.estimation.Observer, steps: range) -> list[np.ndarray]:
    """Results of steps with readings of the given indices."""
    found: list[np.ndarray] = []
    for k in steps:
        gyro = None if k % 3 else np.full(3, 1e-3 * np.sin(k))
        estimate = observer.step(np.full(6, 0.1 * np.cos(k)), {"encoder": 0.5 + 1e-4 * np.sin(k + np.arange(6)), "gyro": gyro})
        found += [estimate.q, estimate.covariance, np.asarray(estimate.nis), estimate.wrenches["link6"], estimate.biases["gyro"]]
    return found


@pytest.mark.filterwarnings("ignore::phipsi.errors.DivergenceWarning")
@pytest.mark.parametrize(("history", "batch", "steps"), [(20, (), 30), (0, (2,), 5), (1000, (2, 1), 2), (20, (), 0), (0, (), 130)])
def test_observers(remade: Remade, history: int, batch: tuple[int, ...], steps: int) -> None:
    """In their state: the next steps, the smoother and the tests of divergence have the same bits."""
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    observer = gyro_and_encoder(scene, history, batch)
    observed(observer, range(steps))
    again = remade(observer)
    assert (again.names, again.dt) == (observer.names, observer.dt)
    if history and steps:
        assert_same_bits(again.smooth().covariance, observer.smooth().covariance)
    for one, other in zip(observed(again, range(steps, steps + 4)), observed(observer, range(steps, steps + 4)), strict=True):
        assert_same_bits(one, other)
    assert again._filter.window() == observer._filter.window()
    assert np.array_equal(again._filter.window_without(0, 0), observer._filter.window_without(0, 0), equal_nan=True)


def test_observers_of_other_settings_are_refused() -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    observer, other = gyro_and_encoder(scene, 5, ()), gyro_and_encoder(scene, 2, ())
    observed(observer, range(9))
    state = observer._filter.numbers()
    for numbers in (state, state[:-1], np.append(state, 0.0), np.full(len(state), -1.0), np.zeros(0)):
        with pytest.raises(phipsi.errors.ArgumentError, match="pickled observer: found data of another observer; expected the data that pickle wrote"):
            (other if numbers is state else gyro_and_encoder(scene, 5, ()))._filter.resume(numbers)


def test_observers_of_momentum(arm: phipsi.Scene, remade: Remade) -> None:
    observer = arm.momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0)
    q, qd, tau = random_states(arm, 0)
    for _ in range(3):
        observer.step(q, qd, tau)
    again = remade(observer)
    assert_same_bits(again.step(q, qd, tau)[0], observer.step(q, qd, tau)[0])


def test_errors_pickle(arm: phipsi.Scene) -> None:
    with pytest.raises(phipsi.errors.NotFiniteError) as found:
        arm.mass_matrix(np.full((3, 7), np.nan))
    again = pickle.loads(pickle.dumps(found.value))
    assert (str(again), again.argument, again.state) == (str(found.value), "q", 0)


@pytest.mark.parametrize("name", [name for name, of in inspect.signature(phipsi.Scene.simulator).parameters.items() if isinstance(of.default, float)])
def test_every_number_of_a_simulation_is_kept(remade: Remade, name: str) -> None:
    scene = phipsi.scenes.chain(2).to_builder().contact("tip", "link1", friction=0.5, xyz=(0.1, 0.1, 0.3), offset=-9.0).build()
    simulator = scene.simulator([0.3, 0.2], dt=1e-3, **{name: 0.25})  # type: ignore[arg-type]
    _, (_, _, _, keywords, *_) = remade(simulator).__reduce__()
    assert keywords[name] == 0.25


@pytest.mark.parametrize("given", ["armature", "damping", "stiffness", "friction", "rest", "nothing"])
def test_simulators_of_mimic_joints_keep_every_bit(remade: Remade, given: str) -> None:
    builder = phipsi.SceneBuilder().link("base")
    for i, (parent, mimic) in enumerate((("base", {}), ("l0", {}), ("l1", {"mimic": "j0", "mimic_multiplier": -1.3, "mimic_offset": 0.1}))):
        builder.link(f"l{i}", 1.0, (0.05, 0.02, 0.2), np.diag([0.02, 0.03, 0.01]))
        losses = {"armature": 0.03, "damping": 0.2, "friction": 0.3, "stiffness": 1.7, "rest": 0.2}
        builder.joint(f"j{i}", "revolute", parent, f"l{i}", xyz=(0.1, 0, 0.3), axis=(0.3 * i, 1, 0.2), **losses, **mimic)
    scene = builder.build(mimic="couple")
    own = {} if given == "nothing" else {given: np.array([0.11, 0.23])}
    simulator = scene.simulator([0.1, 0.4], [1.0, -2.0], dt=2e-3, friction_speed=0.05, **own)
    simulator.step(steps=5)
    again = remade(simulator)
    for one in (simulator, again):
        one.step(steps=60)
    assert_same_bits(again.q, simulator.q)
    assert_same_bits(again.qd, simulator.qd)
