"""Simulation from Python: shapes, recorded rows, torques, errors with the completed steps; adaptive compared with fixed
steps.
"""

from __future__ import annotations

import os
import pickle
import signal
import threading

import numpy as np
import phipsi
import pytest
from conftest import PATIENCE, join, random_scene, random_states
from phipsi import errors
from tolerances import assert_near, assert_same_bits, inverse, product, size

METHODS = ("semi-implicit-euler", "rk4", "implicit-euler", "rosenbrock-2", "rosenbrock-3")


def pendulum(**joint: object) -> phipsi.Scene:
    builder = phipsi.SceneBuilder().link("base").link("rod", 1.0, (0, 0, -0.5), np.diag([0.08, 0.08, 0.001]))
    return builder.joint("hinge", "revolute", "base", "rod", axis=(0, 1, 0), **joint).build()  # type: ignore[arg-type]


@pytest.mark.parametrize("method", METHODS)
def test_shapes_times_and_the_row_at_the_start(mixed: phipsi.Scene, method: str) -> None:
    q, qd, tau = random_states(mixed, 1, (3, 1))
    path = mixed.simulate(q, qd[0, 0], dt=1e-3, steps=10, tau=np.zeros((2, mixed.nv)), method=method, record_every=3)
    assert path.q.shape == (3, 2, 4, mixed.nq) and path.qd.shape == (3, 2, 4, mixed.nv)
    assert_near(path.t, [0.0, 0.003, 0.006, 0.009], product(4, 0.01))
    assert_same_bits(path.q[:, 1, 0], q[:, 0])
    assert (len(path), path.steps, path.dt, path.method) == (4, 10, 1e-3, method)
    assert path.q.flags.c_contiguous and path.qd.flags.c_contiguous


def test_one_state_a_batch_and_pieces_have_the_same_bits(mixed: phipsi.Scene) -> None:
    q, qd, tau = random_states(mixed, 2, (21,))
    whole = mixed.simulate(q, qd, dt=1e-3, steps=8, tau=tau)
    for i in (0, 7, 20):
        alone = mixed.simulate(q[i], qd[i], dt=1e-3, steps=8, tau=tau[i])
        assert_same_bits(alone.q, whole.q[i])
    again = mixed.simulate(whole.q[:, 4], whole.qd[:, 4], dt=1e-3, steps=4, tau=tau)
    assert_same_bits(again.qd, whole.qd[:, 4:])


@pytest.mark.parametrize("method", METHODS)
def test_quaternions_stay_unit(floating: phipsi.Scene, method: str) -> None:
    q, qd, _ = random_states(floating, 3)
    path = floating.simulate(q, qd, dt=1e-3, steps=200, method=method)
    for joint in floating.joint_names:
        at = floating.q_index(joint)
        if at.stop - at.start in (4, 7):
            norm = np.linalg.norm(path.q[:, at.stop - 4 : at.stop], axis=-1)
            assert_near(norm, np.ones_like(norm), product(4, 1.0))


def test_torques_as_constant_array_and_function_are_the_same(arm: phipsi.Scene) -> None:
    q, qd, tau = random_states(arm, 4, (5,))
    steps = np.random.default_rng(1).uniform(-1, 1, (5, 6, arm.nv))
    seen = []

    def function(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        seen.append((t, q.copy(), qd.copy()))
        return steps[:, len(seen) - 1]

    one = arm.simulate(q, qd, dt=1e-3, steps=6, tau_steps=steps, limits="report")
    other = arm.simulate(q, qd, dt=1e-3, steps=6, tau=function, limits="report")
    assert_same_bits(one.q, other.q)
    assert len(seen) == 6
    for i, (t, q_seen, qd_seen) in enumerate(seen):
        assert_near(t, i * 1e-3, product(1, 1.0))
        assert_same_bits(q_seen, one.q[:, i])
        assert_same_bits(qd_seen, one.qd[:, i])
    held = arm.simulate(q, qd, dt=1e-3, steps=6, tau=tau, limits="report")
    again = arm.simulate(q, qd, dt=1e-3, steps=6, tau_steps=np.repeat(tau[:, None], 6, axis=1), limits="report")
    assert_same_bits(held.q, again.q)


def test_properties_come_from_the_builder_and_a_call_may_override_them() -> None:
    scene = pendulum(damping=0.3, friction=0.2, stiffness=5.0, rest=0.4)
    assert (scene.damping, scene.friction, scene.stiffness, scene.rest) == ([0.3], [0.2], [5.0], [0.4])
    copy = pickle.loads(pickle.dumps(scene))
    assert (copy.stiffness, copy.rest) == ([5.0], [0.4])
    bare = pendulum()
    one = scene.simulate([0.1], [1.0], dt=1e-3, steps=20)
    other = bare.simulate([0.1], [1.0], dt=1e-3, steps=20, damping=0.3, friction=[0.2], stiffness=5.0, rest=[0.4])
    assert_same_bits(one.q, other.q)
    heavy = bare.simulate([0.1], [1.0], dt=1e-3, steps=20, armature=0.7)
    assert_same_bits(heavy.q, pendulum(armature=0.7).simulate([0.1], [1.0], dt=1e-3, steps=20).q)


def test_properties_come_from_urdf() -> None:
    text = """<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="continuous">
    <parent link="a"/><child link="b"/><dynamics damping="0.5" friction="0.25" armature="2" stiffness="3" rest="0.1"/></joint></robot>"""
    scene = phipsi.Scene.from_urdf(text)
    assert [scene.damping, scene.friction, scene.armature, scene.stiffness, scene.rest] == [[0.5], [0.25], [2], [3], [0.1]]


def test_energy_is_kept_by_rk4_and_taken_by_damping() -> None:
    scene = pendulum(stiffness=5.0, rest=0.4, armature=0.1)
    path = scene.simulate([1.0], [0.0], dt=1e-3, steps=2000, method="rk4")
    total = path.energy().total
    assert_near(total, np.full_like(total, total[0]), 1e-11 * size(total))
    damped = scene.simulate([1.0], [0.0], dt=1e-3, steps=2000, method="rk4", damping=0.5).energy().total
    assert np.all(np.diff(damped) < 1e-12)
    rotor = scene.simulate([1.0], [0.0], dt=1e-3, steps=2000, method="rk4", armature=0.4).energy().total
    assert_near(rotor, np.full_like(rotor, rotor[0]), 1e-11 * size(rotor))


def test_pd_goes_to_its_target_however_stiff(arm: phipsi.Scene) -> None:
    target = np.linspace(-0.5, 0.5, arm.nv)
    law = phipsi.PD(1e8, 1e6, target)
    path = arm.simulate(arm.neutral(), np.zeros(arm.nv), dt=1e-2, steps=500, method="implicit-euler", pd=law)
    assert_near(path.q[-1], target, 1e-5)
    assert_near(arm.simulate(arm.neutral(), np.zeros(arm.nv), dt=1e-2, steps=500, pd=law).q[-1], target, 1e-5)
    with pytest.raises(errors.SimulationError, match="diverged"):
        arm.simulate(arm.neutral(), np.zeros(arm.nv), dt=1e-2, steps=500, method="rk4", pd=law, limits="report")


def test_limits_are_reported_and_not_enforced_with_limits_report() -> None:
    scene = pendulum(lower=-0.2, upper=0.5, velocity=1.0)
    path = scene.simulate([0.6], [0.0], dt=1e-3, steps=1000, method="rk4", limits="report")
    found = {violation.limit: violation for violation in path.violations()}
    assert set(found) == {"lower", "upper", "velocity"}
    assert found["upper"].time == 0.0 and found["upper"].worst == 0.6
    assert found["lower"].worst == path.q.min() and found["lower"].joint == "hinge"
    assert abs(found["velocity"].worst) == np.abs(path.qd).max()
    first = np.argmax(path.q[:, 0] < -0.2)
    assert found["lower"].time == path.t[first] and found["lower"].rows == np.count_nonzero(path.q < -0.2)
    assert scene.simulate([0.0], [0.0], dt=1e-3, steps=5).violations() == []


BAD = {
    "dt zero": ({"dt": 0.0}, errors.ArgumentError, "dt: found 0"),
    "dt negative": ({"dt": -1.0}, errors.ArgumentError, "dt: found -1"),
    "dt NaN": ({"dt": np.nan}, errors.ArgumentError, "dt: found NaN"),
    "steps negative": ({"steps": -1}, errors.ArgumentError, "steps: found -1"),
    "steps not whole": ({"steps": 1.5}, errors.ArgumentError, "steps: found 1.5"),
    "steps beyond memory": ({"steps": 10**15}, MemoryError, "steps: no room for 1000000000000001 rows"),
    "steps beyond addresses": ({"steps": 2**63 - 1}, MemoryError, "steps: no room"),
    "record_every": ({"record_every": 0}, errors.ArgumentError, "record_every: found 0"),
    "method": ({"method": "euler"}, errors.ArgumentError, "rosenbrock-3"),
    "form": ({"form": "square-root"}, errors.ArgumentError, "form"),
    "tau": ({"tau": np.zeros(2)}, errors.ShapeError, r"tau: found shape \(2,\); expected \(..., 7\)"),
    "tau not finite": ({"tau": np.full(7, np.inf)}, errors.NotFiniteError, "tau"),
    "tau_steps": ({"tau_steps": np.zeros((9, 7))}, errors.ShapeError, r"tau_steps: found shape \(9, 7\); expected \(..., 10, 7\)"),
    "two torques": ({"tau": np.zeros(7), "tau_steps": np.zeros((10, 7))}, errors.ArgumentError, "either tau or tau_steps"),
    "batches": ({"tau": np.zeros((3, 7)), "q": np.zeros((2, 7))}, errors.ShapeError, "broadcast"),
    "pd": ({"pd": 3}, errors.ArgumentError, "PD"),
    "pd target": ({"pd": (1, 1, np.zeros(3))}, errors.ShapeError, "pd.target"),
    "pd gain": ({"pd": (-1, 1, np.zeros(7))}, errors.ArgumentError, "pd.kp"),
    "damping": ({"damping": -1.0}, errors.ArgumentError, "damping"),
    "stiffness": ({"stiffness": np.zeros(3)}, errors.ShapeError, "stiffness"),
    "rest": ({"rest": np.zeros(3)}, errors.ShapeError, "rest"),
    "friction_speed": ({"friction_speed": -0.1}, errors.ArgumentError, "friction_speed"),
    "q": ({"q": np.full(7, np.nan)}, errors.NotFiniteError, "q"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_arguments_are_named(arm: phipsi.Scene, case: str) -> None:
    change, kind, words = BAD[case]
    arguments = {"q": np.zeros(7), "qd": np.zeros(7), "dt": 1e-3, "steps": 10, **change}
    with pytest.raises(kind, match=words):
        arm.simulate(arguments.pop("q"), arguments.pop("qd"), **arguments)


def test_a_function_that_raises_keeps_the_finished_steps(arm: phipsi.Scene) -> None:
    calls = []

    def torque(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        calls.append(t)
        if len(calls) > 5:
            raise LookupError("no plan for that")
        return np.zeros(7)

    with pytest.raises(errors.SimulationError, match="step 5 .*LookupError: no plan") as caught:
        arm.simulate(np.zeros((2, 7)), np.zeros(7), dt=1e-3, steps=100, tau=torque, record_every=2)
    error = caught.value
    assert isinstance(error.__cause__, LookupError)
    assert (error.step, error.joint, error.state) == (5, "", None)
    kept = arm.simulate(np.zeros((2, 7)), np.zeros(7), dt=1e-3, steps=5, record_every=2)
    assert_same_bits(error.trajectory.q, kept.q)


def test_divergence_is_told_with_step_joint_and_state(arm: phipsi.Scene) -> None:
    q = np.zeros((2, 3, 7))
    q[1, 2, 4] = 0.5
    with pytest.raises(errors.SimulationError) as caught:
        arm.simulate(q, np.zeros(7), dt=1e-2, steps=1000, stiffness=[0, 0, 0, 0, 1e6, 0, 0], method="rk4", limits="report")
    error = caught.value
    assert error.state == (1, 2) and error.joint in arm.joint_names and error.joint in str(error)
    assert len(error.trajectory) == error.step + 1
    assert np.all(np.isfinite(error.trajectory.q))


def test_a_lost_pivot_is_a_cause_with_its_joint() -> None:
    builder = phipsi.SceneBuilder().link("base").link("tip", 1.0)
    scene = builder.joint("spin", "revolute", "base", "tip").build()
    with pytest.raises(errors.SimulationError, match="armature") as caught:
        scene.simulate([0.0], [0.0], dt=1e-3, steps=3)
    assert isinstance(caught.value.__cause__, errors.SingularJointError)
    assert (caught.value.joint, caught.value.step) == ("spin", 0)
    assert np.isfinite(scene.simulate([0.0], [0.0], dt=1e-3, steps=3, damping=1.0, method="implicit-euler").q).all()


@pytest.mark.skipif(os.name == "nt", reason="signals to oneself")
def test_ctrl_c_keeps_what_was_computed(arm: phipsi.Scene, interruptible: None) -> None:
    started = threading.Event()
    # Not sent without the call: it would end the run of the tests.
    timer = threading.Thread(target=lambda: started.wait(PATIENCE) and os.kill(os.getpid(), signal.SIGINT), daemon=True)
    timer.start()
    with pytest.raises(KeyboardInterrupt) as caught:
        arm.simulate(
            np.zeros(7), np.zeros(7), dt=1e-6, steps=10**9, record_every=10**4, progress=lambda done, steps: started.set()
        )
    join(timer)
    assert isinstance(caught.value, errors.SimulationInterrupted)
    path = caught.value.trajectory
    assert len(path) == caught.value.step // 10**4 + 1 and np.all(np.isfinite(path.q))


def test_progress_is_told_to_the_end(arm: phipsi.Scene) -> None:
    told: list[tuple[int, int]] = []
    arm.simulate(np.zeros(7), np.zeros(7), dt=1e-3, steps=20, progress=lambda done, steps: told.append((done, steps)))
    assert told[-1] == (20, 20)


def test_no_states_no_joints_and_no_steps(welded: phipsi.Scene, arm: phipsi.Scene) -> None:
    assert welded.simulate([], [], dt=1e-3, steps=4).q.shape == (5, 0)
    assert arm.simulate(np.zeros((0, 7)), np.zeros(7), dt=1e-3, steps=4).q.shape == (0, 5, 7)
    none = arm.simulate(np.ones(7), np.zeros(7), dt=1e-3, steps=0)
    assert_same_bits(none.q, np.ones((1, 7)))


@pytest.mark.parametrize(("seed", "kinds"), [(2, None), (5, ("revolute", "prismatic")), (6, ("spherical", "floating"))])
def test_adaptive_and_fixed_steps_agree(seed: int, kinds: tuple[str, ...] | None) -> None:
    pytest.importorskip("scipy")
    options = {} if kinds is None else {"kinds": kinds}
    scene = random_scene(seed, 4, floating_base=kinds is None, armature=0.2, **options)
    q, qd, tau = random_states(scene, 1)
    joints = {"damping": 0.1, "stiffness": 2.0, "friction": 0.1, "friction_speed": 0.5}
    law = phipsi.PD(np.full(scene.nv, 1.0), np.full(scene.nv, 0.1), scene.neutral())
    path = scene.simulate(q, qd, dt=2e-4, steps=2000, tau=tau, method="rk4", record_every=1000, pd=law, **joints)
    found = scene.ode(tau=tau, pd=law, **joints).solve(q, qd, (0.0, 0.4), rtol=1e-12, atol=1e-12, t_eval=path.t)
    bound = 1e-9 * size(path.qd)
    assert_near(found.t, path.t, 0.0)
    assert_near(scene.difference(found.q, path.q), np.zeros_like(path.qd), bound)
    assert_near(found.qd, path.qd, bound)


def test_new_centers_change_nothing_and_quaternions_stay_unit() -> None:
    pytest.importorskip("scipy")
    # A free body that makes three turns: its angular velocity about a principal axis is constant.
    builder = phipsi.SceneBuilder().link("top", 1.0, (0, 0, 0), np.diag([0.2, 0.3, 0.4]))
    scene = builder.build(floating_base=True, gravity=(0, 0, 0))
    rates = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 20.0])
    path = scene.ode().solve(scene.neutral(), rates, (0.0, 1.0), rtol=1e-11, atol=1e-11)
    # In the body frame the velocity of the center of mass rotates backward.
    assert_near(path.momentum(), np.broadcast_to(path.momentum()[0], path.momentum().shape), 1e-8)
    assert_near(np.linalg.norm(path.q[:, 3:], axis=-1), np.ones(len(path)), product(4, 1.0))
    assert_near(path.q[-1, :3], [1.0, 0.0, 0.0], 1e-8)
    assert_near(path.q[-1, 3:] * np.sign(path.q[-1, 6] * np.cos(10.0)), [0, 0, np.sin(10.0), np.cos(10.0)], 1e-8)


def test_the_jacobian_is_that_of_the_right_side_and_stiff_methods_take_it() -> None:
    pytest.importorskip("scipy")
    scene = pendulum(stiffness=1e6, damping=1e4)
    ode = scene.ode()
    y = np.array([0.2, 0.3])
    jacobian = ode.jacobian(0.0, y)
    # One joint: dv/dt = (m g l sin - k x - d v) / I.
    inertia, weight = scene.mass_matrix([0.0])[0, 0], 9.81 * 0.5
    expected = [[0.0, 1.0], [-(1e6 + weight * np.cos(0.2)) / inertia, -1e4 / inertia]]
    assert_near(jacobian, expected, 1e-7 * 1e7)
    stiff = ode.solve([0.2], [0.0], (0.0, 1.0), method="Radau", rtol=1e-6, atol=1e-9)
    assert ode.solve([0.2], [0.0], (0.0, 1.0), t_eval=[]).q.shape == (0, 1)
    assert_near(stiff.q[-1], [0.0], 1e-4)
    both = ode.rhs(0.0, np.stack([y, -y], axis=-1))
    assert_near(both[:, 0], ode.rhs(0.0, y), product(4, 1e7))
    for change, kind in (({"method": "Euler"}, errors.ArgumentError), ({"t_eval": [2.0]}, errors.ArgumentError)):
        with pytest.raises(kind):
            ode.solve([0.2], [0.0], (0.0, 1.0), **change)
    with pytest.raises(errors.ShapeError, match="q: found"):
        ode.solve([0.2, 0.1], [0.0], (0.0, 1.0))
    with pytest.raises(errors.ArgumentError, match="t_span"):
        ode.solve([0.2], [0.0], (1.0, 1.0))
    with pytest.raises(errors.ShapeError, match="damping"):
        scene.ode(damping=[1.0, 2.0])


@pytest.mark.parametrize("speed", [1e70, -1e200])
def test_messages_have_short_numbers(speed: float) -> None:
    """With exponents if all digits would be long."""
    with pytest.raises(errors.SimulationError, match=f"from {speed:g}; expected".replace("+", "")) as found:
        phipsi.scenes.chain(2).simulate(np.zeros(2), [speed, 0.0], dt=1e-3, steps=5)
    assert len(str(found.value)) < 300
    with pytest.raises(errors.ArgumentError, match="dt: found -1e70; expected"):
        phipsi.scenes.chain(2).simulate(np.zeros(2), np.zeros(2), dt=-1e70, steps=5)
    assert errors.place_in_time(3, 3e60) == "step 3 (t = 3e+60 s)"
