"""Gradients of functions of trajectories: compared with dense Jacobians of every step, with differences, and
with closed forms; and as calls.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest
from conftest import random_scene, random_states
from tolerances import STEP, assert_near, assert_same_bits, central_difference, inverse, product, size

import phipsi
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError, SimulationError

METHODS = ("semi-implicit-euler", "rk4", "implicit-euler", "rosenbrock-2", "rosenbrock-3")


def spring(**joint: object) -> phipsi.Scene:
    """One mass on a horizontal prismatic joint, so that its motion is linear."""
    builder = phipsi.SceneBuilder().link("base").link("mass", 2.0, (0, 0, 0))
    return builder.joint("slide", "prismatic", "base", "mass", axis=(1, 0, 0), **joint).build()  # type: ignore[arg-type]


def cotangents(path: phipsi.Trajectory, seed: int = 3) -> np.ndarray:
    random = np.random.default_rng(seed)
    return random.uniform(-1, 1, (2, *path.q.shape[:-1], path.scene.nv))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("steps", [1, 7, 700])
@pytest.mark.parametrize("every", [1, 1000])
def test_of_a_linear_motion_is_the_power_of_a_step(method: str, steps: int, every: int) -> None:
    scene = spring(stiffness=3.0, damping=0.7)
    every = min(every, steps)
    ways = {"method": method, "dt": 0.02}
    zero = scene.simulate([0.0], [0.0], steps=1, **ways)
    once = [scene.simulate(*start, steps=1, **ways) for start in ([[1.0], [0.0]], [[0.0], [1.0]])]
    step = np.array([[path.q[-1, 0] - zero.q[-1, 0], path.qd[-1, 0] - zero.qd[-1, 0]] for path in once]).T
    path = scene.simulate([0.3], [-0.2], steps=steps, record_every=every, **ways)
    of_end = np.array([0.4, -1.3])
    rows = np.zeros((2, len(path), 1))
    rows[:, -1, 0] = of_end
    found = path.vjp(*rows)
    expected = np.linalg.matrix_power(step, steps).T @ of_end
    assert_near([found.q[0], found.qd[0]], expected, product(4 * steps, 1.0))


def jacobians(scene: phipsi.Scene, method: str, dt: float, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of one explicit step with respect to (q, qd) and tau, from the dense derivatives of its stages; for
    additive coordinates.
    """
    nv = scene.nv
    into, by_tau = np.eye(2 * nv), np.zeros((2 * nv, nv))

    def rate(at: np.ndarray, along: np.ndarray, along_tau: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x, v = at[:nv], at[nv:]
        by_q, by_qd, minv = scene.forward_dynamics_derivatives(x, v, tau)
        f = np.concatenate([v, scene.forward_dynamics(x, v, tau)])
        of_state = np.block([[np.zeros((nv, nv)), np.eye(nv)], [by_q, by_qd]])
        return f, of_state @ along, of_state @ along_tau + np.vstack([np.zeros((nv, nv)), minv])

    y = np.concatenate([q, qd])
    if method == "rk4":
        sums = [np.zeros(2 * nv), 0 * into, 0 * by_tau]
        stage = [y, into, by_tau]
        for weight, share in ((1 / 6, 0.5), (1 / 3, 0.5), (1 / 3, 1.0), (1 / 6, 0.0)):
            k = rate(*stage)
            sums = [total + weight * part for total, part in zip(sums, k, strict=True)]
            stage = [start + dt * share * part for start, part in zip((y, into, by_tau), k, strict=True)]
        return into + dt * sums[1], by_tau + dt * sums[2]
    _, along, along_tau = rate(y, into, by_tau)
    faster = np.vstack([np.zeros((nv, 2 * nv)), along[nv:]])
    moved = np.eye(2 * nv) + np.block([[np.zeros((nv, nv)), dt * np.eye(nv)], [np.zeros((nv, nv)), np.zeros((nv, nv))]])
    return moved @ (into + dt * faster), moved @ (dt * np.vstack([np.zeros((nv, nv)), along_tau[nv:]]))


@pytest.mark.parametrize("method", ["semi-implicit-euler", "rk4"])
@pytest.mark.parametrize("seed", range(3))
def test_of_explicit_steps_as_the_product_of_dense_jacobians(seed: int, method: str) -> None:
    scene = random_scene(seed, 5, kinds=("revolute", "prismatic", "screw", "planar", "fixed"))
    q, qd, _ = random_states(scene, seed)
    steps, dt, nv = 12, 0.01, scene.nv
    tau = np.random.default_rng(seed).uniform(-2, 2, (steps, nv))
    path = scene.simulate(q, qd, dt=dt, steps=steps, tau_steps=tau, method=method, limits="report")
    by_q, by_qd = cotangents(path)
    found = path.vjp(by_q, by_qd)
    bar, of_tau = np.concatenate([by_q[-1], by_qd[-1]]), np.zeros((steps, nv))
    for n in reversed(range(steps)):
        of_state, of_torque = jacobians(scene, method, dt, path.q[n], path.qd[n], tau[n])
        of_tau[n] = bar @ of_torque
        bar = bar @ of_state + np.concatenate([by_q[n], by_qd[n]])
    condition = np.linalg.cond(scene.mass_matrix(q))
    assert_near(np.concatenate([found.q, found.qd]), bar, inverse(steps * condition, size(bar)))
    assert_near(found.tau, of_tau, inverse(steps * condition, size(of_tau)))


def everything(scene: phipsi.Scene, q: np.ndarray, seed: int) -> dict[str, object]:
    """All forces that can act at the joints."""
    random = np.random.default_rng(seed)
    near = lambda: scene.integrate(q, random.uniform(-0.4, 0.4, scene.nv))  # noqa: E731
    some = lambda scale: random.uniform(0.1, 1.0, scene.nv) * scale  # noqa: E731
    pd = phipsi.PD(some(3.0), some(0.5), near(), random.uniform(-0.3, 0.3, scene.nv))
    return {
        "pd": pd, "armature": some(0.3), "damping": some(0.5), "stiffness": some(3.0), "friction": some(0.3), "friction_speed": 0.5,
        "rest": near(),
    }  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("every", [1, 3])
def test_of_every_kind_of_joint_beside_differences(method: str, every: int) -> None:
    scene = random_scene(4, 6, floating_base=True)
    q, qd, _ = random_states(scene, 4)
    tau = np.random.default_rng(1).uniform(-2, 2, (9, scene.nv))
    given = {"dt": 0.02, "steps": 9, "method": method, "record_every": every, **everything(scene, q, 2)}
    path = scene.simulate(q, qd, tau_steps=tau, **given)
    by_q, by_qd = cotangents(path)
    found = path.vjp(by_q, by_qd)

    def value(q: np.ndarray = q, qd: np.ndarray = qd, tau: np.ndarray = tau, **changed: object) -> float:
        other = scene.simulate(q, qd, tau_steps=tau, **{**given, **changed})
        # The difference from the previous position is the tangent there, to first order.
        return float(np.sum(by_q * scene.difference(path.q, other.q)) + np.sum(by_qd * other.qd))

    def along(change: Callable[[float], float]) -> float:
        return (change(STEP) - change(-STEP)) / (2 * STEP)

    bound = central_difference(100 * size(*found[:3]))
    for i, unit in enumerate(np.eye(scene.nv)):
        assert_near(found.q[i], along(lambda h: value(q=scene.integrate(q, h * unit))), bound)  # noqa: B023
        assert_near(found.qd[i], along(lambda h: value(qd=qd + h * unit)), bound)  # noqa: B023
        for name in ("armature", "damping", "stiffness", "friction"):
            by_one = along(lambda h: value(**{name: given[name] + h * unit}))  # noqa: B023
            assert_near(getattr(found, name)[i], by_one, bound)
        for n in (0, 4, 8):
            change = np.zeros_like(tau)
            change[n] = unit
            assert_near(found.tau[n, i], along(lambda h: value(tau=tau + h * change)), bound)  # noqa: B023


def test_of_what_is_not_there_beside_differences(mixed: phipsi.Scene) -> None:
    """Zero springs, damping and friction have gradients."""
    q, qd, _ = random_states(mixed, 5)
    given = {"dt": 0.02, "steps": 5, "method": "rosenbrock-2", "rest": mixed.integrate(q, np.full(mixed.nv, 0.3))}
    # Any exact friction causes an event when a joint reverses.
    given["friction_speed"] = 0.5
    path = mixed.simulate(q, qd, **given)
    by_q, by_qd = cotangents(path)
    found = path.vjp(by_q, by_qd)
    for name in ("damping", "stiffness", "friction"):
        assert np.all(getattr(found, name) != 0.0)
        for i, unit in enumerate(np.eye(mixed.nv)):
            # One-sided, because negative values raise.
            values = []
            for h in (0.0, STEP, 2 * STEP):
                other = mixed.simulate(q, qd, **given, **{name: h * unit})
                values.append(float(np.sum(by_q * mixed.difference(path.q, other.q)) + np.sum(by_qd * other.qd)))
            slope = (4 * values[1] - 3 * values[0] - values[2]) / (2 * STEP)
            assert_near(getattr(found, name)[i], slope, central_difference(100 * size(getattr(found, name))))


def test_of_parameters_beside_heavier_links() -> None:
    def scene(heavier: float = 0.0) -> phipsi.Scene:
        builder = phipsi.SceneBuilder().link("base")
        for k, name in enumerate(("arm", "hand", "tool")):
            builder.link(name, 1.0 + k + (heavier if name == "tool" else 0.0), (0.1, 0.05 * k, 0.3), np.diag([0.1, 0.12, 0.05]))
        builder.joint("a", "revolute", "base", "arm", axis=(0, 1, 0), xyz=(0, 0, 0.1))
        builder.joint("b", "revolute", "arm", "hand", axis=(1, 0, 0), xyz=(0, 0.1, 0.4))
        return builder.joint("weld", "fixed", "hand", "tool", xyz=(0.1, 0.2, 0.3), rpy=(0.3, -0.2, 0.5)).build()

    own = scene()
    path = own.simulate([0.3, -0.4], [0.5, 0.2], dt=0.01, steps=20)
    by_q, by_qd = cotangents(path)
    found = path.vjp(by_q, by_qd, parameters=True)
    assert found.parameters is not None and found.parameters.shape == (2, 10)

    def value(heavier: float) -> float:
        other = scene(heavier).simulate([0.3, -0.4], [0.5, 0.2], dt=0.01, steps=20)
        return float(np.sum(by_q * other.q) + np.sum(by_qd * other.qd))

    # A fixed link is part of the hand: its mass is that of a point at its center of mass, moved by the fixed joint.
    place = own.placements([0.0, 0.0])
    at = np.linalg.inv(place["hand"]) @ place["tool"] @ [0.1, 0.1, 0.3, 1.0]
    x, y, z = at[:3]
    point = np.array([1.0, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    slope = (value(STEP) - value(-STEP)) / (2 * STEP)
    assert_near(found.parameters[1] @ point, slope, central_difference(100 * size(found.parameters)))


def test_more_checkpoints_change_nothing_but_rounding(mixed: phipsi.Scene) -> None:
    """In long simulations some steps are stored, and the others recomputed from these."""
    q, qd, _ = random_states(mixed, 6)
    tau = np.random.default_rng(2).uniform(-1, 1, (600, mixed.nv))
    found = []
    for every in (1, 40, 200, 600):
        path = mixed.simulate(q, qd, dt=1e-3, steps=600, tau_steps=tau, record_every=every, damping=0.3)
        last = np.zeros((len(path), mixed.nv))
        last[-1] = np.linspace(-1, 1, mixed.nv)
        found.append(path.vjp(last, -last))
    for other in found[1:]:
        for one, same in zip(found[0][:7], other[:7], strict=True):
            assert_same_bits(one, same)


@pytest.mark.parametrize("method", ["semi-implicit-euler", "rosenbrock-3"])
def test_one_state_a_batch_and_threads_have_the_same_bits(mixed: phipsi.Scene, method: str) -> None:
    q, qd, tau = random_states(mixed, 2, (21,))
    given = {"dt": 1e-3, "steps": 8, "method": method, **everything(mixed, q[0], 3)}
    path = mixed.simulate(q, qd, tau=tau, **given)
    by_q, by_qd = cotangents(path)
    before = phipsi.get_num_threads()
    try:
        several = []
        for threads in (1, 2, 5):
            phipsi.set_num_threads(threads)
            several.append(path.vjp(by_q, by_qd, parameters=True))
    finally:
        phipsi.set_num_threads(before)
    for other in several[1:]:
        for one, same in zip(several[0][:8], other[:8], strict=True):
            assert_same_bits(one, same)
    for i in (0, 7, 20):
        alone = mixed.simulate(q[i], qd[i], tau=tau[i], **given).vjp(by_q[i], by_qd[i], parameters=True)
        for one, all_of_them in zip(alone[:8], several[0][:8], strict=True):
            assert_near(one, all_of_them[i], product(mixed.nv * 64, size(all_of_them[i])))


def test_in_doubt_as_the_product_of_dense_jacobians() -> None:
    """A mass at the tip for which the covariance form loses precision: the adjoint of steps whose error
    estimate exceeds the tolerance is recomputed in double-double arithmetic.
    """
    case = phipsi.scenes.extreme("heavy-tip", 1e10, bodies=6)
    scene, dt, steps = case.scene, 1e-3, 4
    path = scene.simulate(case.q, case.qd, dt=dt, steps=steps, tau=case.tau, method="semi-implicit-euler")
    by_q, by_qd = cotangents(path)
    found = path.vjp(by_q, by_qd)
    bar = np.concatenate([by_q[-1], by_qd[-1]])
    for n in reversed(range(steps)):
        bar = bar @ jacobians(scene, "semi-implicit-euler", dt, path.q[n], path.qd[n], case.tau)[0] + np.concatenate([by_q[n], by_qd[n]])
    assert_near(np.concatenate([found.q, found.qd]), bar, 1e-9 * size(bar))


def test_at_rest_held_and_falling(arm: phipsi.Scene) -> None:
    """Typical states: the adjoint of a small change is the effect of that change."""
    floating = random_scene(1, 5, kinds=("revolute",), floating_base=True)
    for scene, tau in ((arm, None), (arm, arm.bias_torque(np.full(arm.nq, 0.4), np.zeros(arm.nv))), (floating, None)):
        q = scene.neutral() if scene is floating else np.full(scene.nq, 0.4)
        path = scene.simulate(q, np.zeros(scene.nv), dt=1e-3, steps=20, tau=tau)
        by_q, by_qd = cotangents(path)
        found = path.vjp(by_q, by_qd)
        d = np.random.default_rng(3).uniform(-1, 1, scene.nv)
        ends = [scene.simulate(scene.integrate(q, h * d), h * d, dt=1e-3, steps=20, tau=tau) for h in (STEP, -STEP)]
        moved = [np.sum(by_q * scene.difference(path.q, end.q)) + np.sum(by_qd * end.qd) for end in ends]
        assert_near(d @ (found.q + found.qd), (moved[0] - moved[1]) / (2 * STEP), central_difference(1e3 * size(*found[:2])))


def test_shapes_and_what_broadcasts(mixed: phipsi.Scene) -> None:
    q, qd, tau = random_states(mixed, 1, (3, 1))
    path = mixed.simulate(q, qd[0, 0], dt=1e-3, steps=10, tau=np.zeros((2, mixed.nv)), record_every=3)
    found = path.vjp(np.ones((4, mixed.nv)))
    assert all(part.shape == (3, 2, mixed.nv) for part in found[:7]) and found.parameters is None
    of_steps = mixed.simulate(q, qd, dt=1e-3, steps=10, tau_steps=np.zeros((10, mixed.nv))).vjp(None, np.ones((11, mixed.nv)))
    assert of_steps.tau.shape == (3, 1, 10, mixed.nv)
    nothing = path.vjp()
    assert not any(np.any(part) for part in nothing[:7])


def test_steps_after_the_last_row_change_nothing(mixed: phipsi.Scene) -> None:
    q, qd, _ = random_states(mixed, 1)
    tau = np.ones((10, mixed.nv))
    path = mixed.simulate(q, qd, dt=1e-3, steps=10, tau_steps=tau, record_every=4)
    found = path.vjp(np.ones((3, mixed.nv)))
    assert np.all(found.tau[:8] != 0.0) and not np.any(found.tau[8:])


def test_no_steps(mixed: phipsi.Scene) -> None:
    q, qd, _ = random_states(mixed, 1)
    found = mixed.simulate(q, qd, dt=1e-3, steps=0).vjp(np.ones((1, mixed.nv)), np.full((1, mixed.nv), 2.0))
    assert_same_bits(found.q, np.ones(mixed.nv))
    assert_same_bits(found.qd, np.full(mixed.nv, 2.0))
    assert not np.any(found.tau)


def test_torques_that_change_later_are_those_of_the_run(arm: phipsi.Scene) -> None:
    tau = np.full((5, arm.nv), 0.3)
    path = arm.simulate(np.zeros(arm.nq), np.zeros(arm.nv), dt=1e-2, steps=5, tau_steps=tau)
    before = path.vjp(np.ones((6, arm.nv)))
    tau[:] = 50.0
    assert_same_bits(path.vjp(np.ones((6, arm.nv))).q, before.q)
    again = pickle.loads(pickle.dumps(path))
    assert_same_bits(again.vjp(np.ones((6, arm.nv))).q, before.q)


def test_a_valid_call_by_arrays(arm: phipsi.Scene) -> None:
    path = arm.simulate(np.zeros(arm.nq), np.zeros(arm.nv), dt=1e-2, steps=4)
    cotangent = np.ones((5, arm.nv))
    found = arm.simulate_vjp(path.q, path.qd, cotangent, cotangent, dt=1e-2, steps=4)
    assert_same_bits(found.q, path.vjp(cotangent, cotangent).q)


def test_rows_that_are_not_those_recorded(arm: phipsi.Scene) -> None:
    path = arm.simulate(np.zeros(arm.nq), np.zeros(arm.nv), dt=1e-2, steps=4)
    with pytest.raises(ShapeError, match=r"cotangent_q: found shape \(4, \d\); expected \(\.\.\., 5, \d\)"):
        path.vjp(np.ones((4, arm.nv)))


def test_a_cotangent_that_is_not_finite(arm: phipsi.Scene) -> None:
    path = arm.simulate(np.zeros(arm.nq), np.zeros(arm.nv), dt=1e-2, steps=4)
    with pytest.raises(NotFiniteError, match="by_qd|cotangent_qd"):
        path.vjp(None, np.full((5, arm.nv), np.nan))


def test_a_torque_that_was_a_function(arm: phipsi.Scene) -> None:
    path = arm.simulate(np.zeros(arm.nq), np.zeros(arm.nv), dt=1e-2, steps=4, tau=lambda t, q, qd: -qd)
    pickle.dumps(path)
    with pytest.raises(ArgumentError, match="tau: found a function.* tau_steps"):
        path.vjp()


def test_a_torque_that_is_a_function(arm: phipsi.Scene) -> None:
    path = arm.simulate(np.zeros(arm.nq), np.zeros(arm.nv), dt=1e-2, steps=4)
    with pytest.raises(ArgumentError, match="tau: found a function.* tau_steps"):
        arm.simulate_vjp(path.q, path.qd, np.ones((5, arm.nv)), np.ones((5, arm.nv)), dt=1e-2, steps=4, tau=lambda t, q, qd: qd)


def test_where_a_simulator_went(arm: phipsi.Scene) -> None:
    simulator = arm.simulator(np.zeros(arm.nq), dt=0.5, limits="report")
    with pytest.raises(SimulationError) as caught:
        simulator.step(np.full(arm.nv, 1e300), 1000)
    with pytest.raises(ArgumentError, match="trajectory: found the trajectory of a Simulator"):
        caught.value.trajectory.vjp()
