"""Scene.simulator: bitwise equal to simulate step by step, for one state and batches, resets, errors, copies."""

from __future__ import annotations

import copy
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import at_once, join, random_states
from tolerances import assert_near, assert_same_bits, product

import phipsi
from phipsi import errors

METHODS = ("semi-implicit-euler", "rk4", "implicit-euler", "rosenbrock-2", "rosenbrock-3")
FORMS = ("auto", "covariance")

of_start = pytest.mark.filterwarnings("ignore:q. found joint .* limit:phipsi.errors.LimitWarning")
"""Random states may be outside of the joint limits, where the stops act from the first step."""


def acting(scene: phipsi.Scene, batch: tuple[int, ...] = ()) -> dict[str, Any]:
    """All options of simulate and simulator."""
    target = random_states(scene, 9, batch).q
    return {
        "dt": 1e-3, "pd": phipsi.PD(np.full(scene.nv, 2.0), np.full(scene.nv, 0.1), target), "armature": 0.3, "damping": 0.2, "stiffness": 3.0, "rest": scene.neutral(),
        "friction": 0.1, "friction_speed": 0.5,
    }  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("batch", [(), (1,), (21,), (2, 3), (0,)])
def test_steps_have_the_bits_of_simulate(mixed: phipsi.Scene, method: str, form: str, batch: tuple[int, ...]) -> None:
    q, qd, tau = random_states(mixed, 1, batch)
    given = {"method": method, "form": form, **acting(mixed, batch)}
    path = mixed.simulate(q, qd, steps=6, tau=tau, **given)
    simulator = mixed.simulator(q, qd, **given)
    assert (simulator.batch, simulator.steps, simulator.dt, simulator.method) == (batch, 0, 1e-3, method)
    assert simulator.scene is mixed
    assert_same_bits(simulator.q, q)
    done = 0
    for steps in (1, 1, 0, 3, 1):
        simulator.step(tau, steps)
        done += steps
        assert_same_bits(simulator.q, path.q[..., done, :])
        assert_same_bits(simulator.qd, path.qd[..., done, :])
        assert_near(simulator.t, np.full(batch, path.t[done]), product(1, 1.0))
    assert simulator.steps == 6
    assert simulator.q.flags.c_contiguous and simulator.q.flags.writeable


@of_start
def test_torques_broadcast_and_none_is_zero(arm: phipsi.Scene) -> None:
    q, qd, tau = random_states(arm, 2, (3, 4))
    for given in (None, np.zeros(7), tau, tau[0], tau[:, :1], tau[0, 0], tau[0, 0].tolist(), dict(zip(arm.joint_names, tau[0, 0], strict=True))):
        simulator = arm.simulator(q, qd, dt=1e-3)
        simulator.step() if given is None else simulator.step(given)
        full = np.zeros(7) if given is None or isinstance(given, dict) else np.asarray(given)
        full = tau[0, 0] if isinstance(given, dict) else full
        assert_same_bits(simulator.q, arm.simulate(q, qd, dt=1e-3, steps=1, tau=full).q[..., -1, :])


def test_axes_of_the_batch_are_those_of_state_and_targets(arm: phipsi.Scene) -> None:
    assert arm.simulator(np.zeros((3, 1, 7)), np.zeros((4, 7)), dt=1e-3).batch == (3, 4)
    assert arm.simulator(np.zeros(7), dt=1e-3, pd=phipsi.PD(1.0, 1.0, np.zeros((5, 7)))).batch == (5,)
    simulator = arm.simulator(np.zeros(7), dt=1e-3)
    assert_same_bits(simulator.qd, np.zeros(7))
    assert isinstance(simulator.t, float)
    assert repr(simulator) == "<phipsi.Simulator: one state, 0 steps of 0.001 s by auto>"
    assert "6 states" in repr(arm.simulator(np.zeros((2, 3, 7)), dt=1e-3))


def test_nothing_that_moves_and_no_states(welded: phipsi.Scene, arm: phipsi.Scene) -> None:
    still = welded.simulator([], [], dt=1e-3)
    still.step([], 3)
    assert still.q.shape == (0,) and still.steps == 3
    none = arm.simulator(np.zeros((0, 7)), dt=1e-3)
    none.step(np.zeros((0, 7)))
    none.reset(np.zeros((0, 7)))
    assert none.q.shape == (0, 7) and none.t.shape == (0,)


@pytest.mark.parametrize("batch", [(), (1,), (0,), (2, 3)])
def test_batches_of_scenes_without_joints(welded: phipsi.Scene, batch: tuple[int, ...]) -> None:
    nothing = np.zeros((*batch, 0))
    path = welded.simulate(nothing, nothing, dt=1e-3, steps=3)
    assert path.q.shape == (*batch, 4, 0) and path.substeps.shape == batch
    assert path.vjp(path.q).q.shape == (*batch, 0)
    still = welded.simulator(nothing, dt=1e-3)
    still.step(nothing, 3)
    assert still.q.shape == (*batch, 0) and np.shape(still.t) == batch
    assert np.all(still.t == 3e-3)
    assert pickle.loads(pickle.dumps(still)).batch == batch


def test_results_are_copies(arm: phipsi.Scene) -> None:
    for q in (np.zeros(7), np.zeros((3, 7))):
        simulator = arm.simulator(q, dt=1e-3)
        q[:] = 9.0
        for got in (simulator.q, simulator.qd):
            got[:] = 5.0
        assert not simulator.q.any() and not simulator.qd.any()


@of_start
def test_any_number_of_threads_gives_the_same_bits(arm: phipsi.Scene) -> None:
    q, qd, tau = random_states(arm, 3, (3000,))
    found = []
    before = phipsi.get_num_threads()
    try:
        for threads in (1, 2, 4):
            phipsi.set_num_threads(threads)
            simulator = arm.simulator(q, qd, dt=1e-3)
            for steps in (1, 4):
                simulator.step(tau, steps)
            found.append(simulator.q)
    finally:
        phipsi.set_num_threads(before)
    assert_same_bits(found[1], found[0])
    assert_same_bits(found[2], found[0])
    assert_same_bits(found[0], arm.simulate(q, qd, dt=1e-3, steps=5, tau=tau, record_every=5).q[:, -1])


SELECTED: dict[str, tuple[object, list[int]]] = {
    "mask": (np.array([[False, True, False], [False, True, True]]), [1, 4, 5]),
    "mask as a list": ([[False, True, False], [False, True, True]], [1, 4, 5]),
    "nothing": (np.zeros((2, 3), dtype=bool), []),
    "index": ((1, 0), [3]),
    "a row": (1, [3, 4, 5]),
    "slice": (slice(0, 1), [0, 1, 2]),
    "indices": (([0, 1], [2, 0]), [2, 3]),
    "all": (None, [0, 1, 2, 3, 4, 5]),
}


@of_start
@pytest.mark.parametrize("name", SELECTED)
def test_a_reset_begins_what_it_selects_anew_and_nothing_else(floating: phipsi.Scene, name: str) -> None:
    selected, chosen = SELECTED[name]
    q, qd, _ = random_states(floating, 4, (2, 3))
    new = random_states(floating, 5, (2, 3))
    given: dict[str, Any] = {"dt": 1e-3}
    simulator = floating.simulator(q, qd, **given)
    simulator.step(steps=2)
    every = slice(None) if selected is None else tuple(selected) if isinstance(selected, tuple) else np.asarray(selected) if isinstance(selected, list) else selected
    simulator.reset(new.q[every], new.qd[every], states=selected)
    is_new = np.isin(np.arange(6), chosen).reshape(2, 3)
    assert_same_bits(simulator.q[is_new], new.q[is_new])
    assert_same_bits(simulator.t, np.where(is_new, 0.0, 2 * 1e-3))
    simulator.step(steps=3)
    old = floating.simulator(q, qd, **given)
    old.step(steps=5)
    fresh = floating.simulator(new.q, new.qd, **given)
    fresh.step(steps=3)
    for got, one, other in ((simulator.q, fresh.q, old.q), (simulator.qd, fresh.qd, old.qd), (simulator.t, fresh.t, old.t)):
        assert_same_bits(got, np.where(is_new.reshape(2, 3, *[1] * (got.ndim - 2)), one, other))
    assert simulator.steps == 5


@of_start
def test_a_reset_broadcasts_and_stands_still_if_not_told(arm: phipsi.Scene) -> None:
    q, qd, _ = random_states(arm, 6, (4,))
    simulator = arm.simulator(q, qd, dt=1e-3)
    simulator.reset(np.full(7, 0.25), states=np.array([True, False, True, False]))
    assert_same_bits(simulator.q[[0, 2]], np.full((2, 7), 0.25))
    assert_same_bits(simulator.qd[[0, 2]], np.zeros((2, 7)))
    assert_same_bits(simulator.q[[1, 3]], q[[1, 3]])
    one = arm.simulator(q[0], qd[0], dt=1e-3)
    one.step()
    one.reset(q[1], qd[1])
    assert_same_bits(one.q, q[1])
    assert one.t == 0.0


BAD = {
    "dt": ({"dt": 0.0}, errors.ArgumentError, "dt: found 0"),
    "method": ({"method": "euler"}, errors.ArgumentError, "rosenbrock-3"),
    "form": ({"form": "square-root"}, errors.ArgumentError, "form"),
    "pd": ({"pd": 3}, errors.ArgumentError, "PD"),
    "pd target": ({"pd": (1, 1, np.zeros(3))}, errors.ShapeError, "pd.target"),
    "damping": ({"damping": -1.0}, errors.ArgumentError, "damping"),
    "stiffness": ({"stiffness": np.zeros(3)}, errors.ShapeError, "stiffness"),
    "rest": ({"rest": np.zeros(3)}, errors.ShapeError, "rest"),
    "friction_speed": ({"friction_speed": -0.1}, errors.ArgumentError, "friction_speed"),
    "q": ({"q": np.full((2, 7), np.nan)}, errors.NotFiniteError, "q: found NaN"),
    "q's width": ({"q": np.zeros(3)}, errors.ShapeError, r"q: found shape \(3,\); expected \(..., 7\)"),
    "qd": ({"qd": np.full(7, np.inf)}, errors.NotFiniteError, "qd"),
    "axes": ({"q": np.zeros((2, 7)), "qd": np.zeros((3, 7))}, errors.ShapeError, "broadcast"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_arguments_are_named(arm: phipsi.Scene, case: str) -> None:
    change, kind, words = BAD[case]
    arguments: dict[str, Any] = {"q": np.zeros(7), "qd": np.zeros(7), "dt": 1e-3, **change}
    with pytest.raises(kind, match=words):
        arm.simulator(arguments.pop("q"), arguments.pop("qd"), **arguments)


BAD_CALLS: dict[str, tuple[Callable[[phipsi.Simulator], object], type[Exception], str]] = {
    "tau's width": (lambda s: s.step(np.zeros(3)), errors.ShapeError, r"tau: found shape \(3,\); expected \(..., 7\)"),
    "tau's axes": (lambda s: s.step(np.zeros((2, 7))), errors.ShapeError, "tau"),
    "tau NaN": (lambda s: s.step(np.full(7, np.nan)), errors.NotFiniteError, "tau"),
    "tau NaN, a batch": (lambda s: s.step(np.full((3, 7), np.nan)), errors.NotFiniteError, "tau"),
    "tau a function": (lambda s: s.step(lambda t, q, qd: q), errors.ArgumentError, "tau"),
    "steps": (lambda s: s.step(None, -1), errors.ArgumentError, "steps: found -1"),
    "steps None": (lambda s: s.step(None, None), errors.ArgumentError, "steps: found None"),  # type: ignore[arg-type]
    "steps a truth value": (lambda s: s.step(None, True), errors.ArgumentError, "steps"),
    "q": (lambda s: s.reset(np.full((3, 7), np.nan)), errors.NotFiniteError, "q: found NaN .* in state 0"),
    "q of some": (lambda s: s.reset(np.full(7, np.nan), states=[2]), errors.NotFiniteError, "q: found NaN .* in state 2"),
    "qd": (lambda s: s.reset(np.zeros(7), np.full(7, np.inf)), errors.NotFiniteError, "qd: found inf"),
    "q's axes": (lambda s: s.reset(np.zeros((3, 7)), states=[0, 1]), errors.ShapeError, "q"),
    "states beyond": (lambda s: s.reset(np.zeros(7), states=[3]), errors.ArgumentError, "states: found"),
    "states of text": (lambda s: s.reset(np.zeros(7), states="all"), errors.ArgumentError, "states: found"),
    "mask of another shape": (lambda s: s.reset(np.zeros(7), states=np.ones(4, dtype=bool)), errors.ArgumentError, "states: found"),
}


@pytest.mark.parametrize("case", BAD_CALLS)
def test_what_is_refused_changes_nothing(arm: phipsi.Scene, case: str) -> None:
    call, kind, words = BAD_CALLS[case]
    q, qd, _ = random_states(arm, 7, (3,))
    simulator = arm.simulator(q, qd, dt=1e-3)
    simulator.step()
    before = simulator.q, simulator.qd, simulator.t, simulator.steps
    with pytest.raises(kind, match=words):
        call(simulator)
    for one, other in zip(before, (simulator.q, simulator.qd, simulator.t, simulator.steps), strict=True):
        assert_same_bits(one, other)


def test_after_an_error_it_is_where_the_last_good_step_was(arm: phipsi.Scene) -> None:
    q = np.zeros((2, 3, 7))
    q[1, 2, 4] = 0.5
    given: dict[str, Any] = {"dt": 1e-2, "stiffness": [0, 0, 0, 0, 1e6, 0, 0], "method": "rk4", "limits": "report"}
    with pytest.raises(errors.SimulationError) as caught:
        arm.simulate(q, np.zeros(7), steps=1000, **given)
    expected = caught.value
    simulator = arm.simulator(q, **given)
    with pytest.raises(errors.SimulationError, match="diverged") as caught:
        simulator.step(steps=1000)
    error = caught.value
    assert str(error) == str(expected)
    assert (error.step, error.state, error.joint) == (expected.step, (1, 2), expected.joint)
    assert simulator.steps == error.step
    assert_same_bits(simulator.q, expected.trajectory.q[..., -1, :])
    assert_same_bits(error.trajectory.q[..., 0, :], simulator.q)
    assert_near(error.trajectory.t, expected.trajectory.t[-1:], product(1, 1.0))
    assert error.trajectory.energy().total.shape == (2, 3, 1)
    # Once more; and continued without that state.
    with pytest.raises(errors.SimulationError) as caught:
        simulator.step()
    assert caught.value.step == error.step
    simulator.reset(np.zeros(7), states=error.state)
    simulator.step()
    assert simulator.steps == error.step + 1


def test_a_lost_pivot_is_a_cause_with_its_joint() -> None:
    scene = phipsi.SceneBuilder().link("base").link("tip", 1.0).joint("spin", "revolute", "base", "tip").build()
    simulator = scene.simulator([0.0], dt=1e-3)
    with pytest.raises(errors.SimulationError, match="armature") as caught:
        simulator.step()
    assert isinstance(caught.value.__cause__, errors.SingularJointError)
    assert (caught.value.joint, caught.value.step, caught.value.state) == ("spin", 0, None)


WAYS: dict[str, Callable[[Any], Any]] = {
    "pickle": lambda x: pickle.loads(pickle.dumps(x)),
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
}


@of_start
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("batch", [(), (5,), (0,)])
def test_copies_go_on_by_themselves_with_the_same_bits(floating: phipsi.Scene, way: str, batch: tuple[int, ...]) -> None:
    q, qd, _ = random_states(floating, 10, batch)
    damping = np.r_[np.zeros(6), np.full(floating.nv - 6, 0.2)]
    gains = np.r_[np.zeros(6), np.ones(floating.nv - 6)]
    pd = phipsi.PD(gains, 0.1 * gains, random_states(floating, 11, batch).q)
    given: dict[str, Any] = {"dt": 1e-3, "method": "rosenbrock-2", "form": "covariance", "damping": damping, "pd": pd}
    simulator = floating.simulator(q, qd, **given)
    simulator.step(steps=3)
    if batch == (5,):
        simulator.reset(q[0], qd[0], states=2)
        simulator.step()
    again = WAYS[way](simulator)
    assert isinstance(again, phipsi.Simulator) and repr(again) == repr(simulator)
    assert_same_bits(again.t, simulator.t)
    simulator.step(steps=4)
    assert again.steps == simulator.steps - 4
    again.step(steps=4)
    assert_same_bits(again.q, simulator.q)
    assert_same_bits(again.qd, simulator.qd)


def test_a_pickle_of_other_numbers_is_refused(arm: phipsi.Scene) -> None:
    rebuild, (scene, q, qd, keywords, numbers, begun, steps, method) = arm.simulator(np.zeros((2, 7)), dt=1e-3).__reduce__()
    for parts in ((numbers[1:], begun, steps), (numbers, begun[1:], steps), (numbers, [3, 0], 2)):
        with pytest.raises(errors.ArgumentError, match="pickled simulator"):
            rebuild(scene, q, qd, keywords, *parts, method)


def test_threads_step_simulators_of_their_own(mixed: phipsi.Scene) -> None:
    q, qd, tau = random_states(mixed, 12, (4,))
    found: list[Any] = [None] * 4

    def work(number: int) -> None:
        simulator = mixed.simulator(q[number], qd[number], dt=1e-3)
        for _ in range(50):
            simulator.step(tau[number])
        found[number] = simulator.q

    at_once(work, 4)
    assert_same_bits(np.stack(found), mixed.simulate(q, qd, dt=1e-3, steps=50, tau=tau, record_every=50).q[:, -1])


def test_two_calls_at_once_are_refused_and_not_mixed(arm: phipsi.Scene) -> None:
    simulator = arm.simulator(np.zeros((64, 7)), dt=1e-6)
    stop = threading.Event()

    def work() -> None:
        while not stop.is_set():
            simulator.step(steps=200)

    other = threading.Thread(target=work, daemon=True)
    other.start()
    try:
        deadline = time.monotonic() + 60
        with pytest.raises(errors.ArgumentError, match="simulator: found a call during another call .*; .* copy.copy"):
            while time.monotonic() < deadline:
                _ = simulator.q
    finally:
        stop.set()
        join(other)
    assert simulator.steps % 200 == 0


@of_start
@pytest.mark.skipif(os.name == "nt", reason="signals to oneself")
def test_ctrl_c_leaves_it_at_a_step(arm: phipsi.Scene, interruptible: None) -> None:
    q, qd, tau = random_states(arm, 13, (2,))
    simulator = arm.simulator(q, qd, dt=1e-6)
    timer = threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT))
    timer.start()
    try:
        with pytest.raises(errors.SimulationInterrupted) as caught:
            simulator.step(tau, steps=10**9)
    finally:
        join(timer)
    assert caught.value.step == simulator.steps > 0
    assert_same_bits(caught.value.trajectory.q[:, 0], simulator.q)
    assert np.isfinite(simulator.q).all()
    again = arm.simulator(q, qd, dt=1e-6)
    again.step(tau, steps=min(simulator.steps, 2000))
    if simulator.steps <= 2000:
        assert_same_bits(again.q, simulator.q)
    simulator.step(tau)


def test_no_step_is_an_error_that_names_it(mixed: phipsi.Scene) -> None:
    q = mixed.neutral()
    mixed.simulator(q, dt=1e-3)
    for dt in (None, 0.0, -1.0, np.nan):
        with pytest.raises(errors.ArgumentError, match="^dt: found .*; expected a step in s, finite and positive"):
            mixed.simulator(q, dt=dt)  # type: ignore[arg-type]
