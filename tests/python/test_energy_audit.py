"""Energy balance of a trajectory: works of all forces, no energy gain of passive robots, error control, and the error
estimate of fixed steps.
"""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from conftest import KINDS, random_scene, random_states
from motion_scenes import pendulum, robot, slide, start
from tolerances import AUDIT, assert_near, assert_same_bits, product, size

import phipsi
from phipsi.errors import ArgumentError

LONG = 20
"""Timeout of subprocesses that might not end, s."""


def shares(path: phipsi.Trajectory) -> dict[str, float]:
    """Works of a single-state trajectory, J."""
    audit = path.energy_audit()._asdict()
    return {kind: float(value) for kind, value in audit.items() if kind not in ("change", "remainder", "relative_error")}


def test_the_work_of_every_cause_and_nothing_else() -> None:
    """All causes at once, then each alone: only its work is nonzero."""
    scene, q, qd = robot(3, range_of_motion=0.35), *start(robot(3), 3)
    law, tau = phipsi.PD(5.0, 0.2, np.full(3, 0.1)), np.array([0.3, -0.2, 0.4])
    nothing = {"damping": 0.0, "friction": 0.0, "limits": "report"}
    given = {"dt": 1e-3, "steps": 1500, "record_every": 10}
    path = scene.simulate(q, qd, tau=tau, pd=law, **given)
    works = shares(path)
    assert path.stops and all(works[kind] != 0.0 for kind in ("torque", "damping", "friction", "control", "stops")) and works["contacts"] == 0.0
    assert works["damping"] < 0.0 and works["friction"] < 0.0 and works["stops"] < 0.0
    assert path.energy_audit().relative_error < AUDIT
    with pytest.raises(AttributeError, match="'share'; it was renamed to 'relative_error'"):
        _ = path.energy_audit().share
    causes = {
        "torque": {"tau": tau},
        "damping": {"damping": 0.3},
        "friction": {"friction": 0.1},
        "control": {"pd": law},
        "stops": {"limits": "stop"},
    }
    for kind, cause in causes.items():
        path = scene.simulate(q, qd, **given, **{**nothing, **cause})
        works = shares(path)
        assert [name for name, work in works.items() if work != 0.0] == [kind]
        assert path.energy_audit().relative_error < AUDIT, kind
    still = scene.simulate(q, qd, **given, **nothing)
    assert not any(shares(still).values()) and still.energy_audit().relative_error < 1e-9


@pytest.mark.parametrize("dt", [1e-3, 4e-3])
def test_the_remainder_is_small_in_batches_and_falls_with_the_step(dt: float) -> None:
    scene = robot(5, range_of_motion=0.4)
    starts = [start(scene, seed) for seed in range(16)]
    q, qd = (np.stack(values) for values in zip(*starts, strict=True))
    path = scene.simulate(q, qd, dt=dt, steps=round(1.0 / dt), pd=phipsi.PD(3.0, 0.1, np.zeros(3)), tau=np.full(3, 0.2))
    audit = path.energy_audit()
    assert audit.relative_error.shape == (16,) and np.all(audit.relative_error < AUDIT)
    assert_near(audit.torque + audit.damping + audit.friction + audit.control + audit.stops + audit.remainder, audit.change, product(6, size(*audit)))
    alone = scene.simulate(q[3], qd[3], dt=dt, steps=round(1.0 / dt), pd=phipsi.PD(3.0, 0.1, np.zeros(3)), tau=np.full(3, 0.2)).energy_audit()
    assert_near(alone.remainder, audit.remainder[3], product(6, size(*audit)))


def test_the_audit_counts_every_step_whether_it_has_a_row_or_not() -> None:
    scene = robot(4, range_of_motion=0.4)
    q, qd = start(scene, 4)
    every, some = (scene.simulate(q, qd, dt=1e-3, steps=1000, record_every=rows) for rows in (1, 300))
    assert_same_bits(np.array(every.works), np.array(some.works))
    assert_near(some.energy_audit().remainder, every.energy_audit().remainder, product(6, size(*every.energy_audit())))


def test_known_works() -> None:
    """A sliding mass stopped by friction; an actuated mass; one stopped by a spring of the control law."""
    path = slide(2.0, friction=3.0).simulate([0.0], [1.5], dt=1e-3, steps=2000)
    assert_near(path.energy_audit().friction, -0.5 * 2.0 * 1.5**2, 1e-5)
    assert_near(path.q[-1], [0.5 * 2.0 * 1.5**2 / 3.0], 1e-5)
    path = slide(2.0).simulate([0.0], [0.0], dt=1e-3, steps=1000, tau=[4.0])
    assert_near(path.energy_audit().torque, 4.0 * path.q[-1, 0], 1e-9)
    path = slide(2.0, damping=2.0).simulate([0.0], [1.0], dt=1e-3, steps=1000)
    assert_near(path.energy_audit().damping, -1.0 + np.exp(-2.0), 1e-6)
    path = slide(2.0).simulate([0.0], [1.0], dt=1e-3, steps=1000, pd=phipsi.PD(8.0, 0.0, [0.0]))
    assert_near(path.energy_audit().control, -0.5 * 8.0 * path.q[-1, 0] ** 2, 1e-4)


def test_the_work_of_contacts() -> None:
    builder = phipsi.SceneBuilder().link("ball", 2.0, inertia=0.01 * np.eye(3))
    scene = builder.contact("ground", "ball", radius=0.1, friction=0.5, restitution=0.5).build(floating_base=True)
    q = scene.neutral()
    q[2] = 0.5
    path = scene.simulate(q, [1.0, 0, 0, 0, 0, 0], dt=1e-3, steps=1500)
    works = shares(path)
    assert works.pop("contacts") < 0.0 and not any(works.values())
    assert path.energy_audit().relative_error < 0.1 * AUDIT


def test_a_robot_at_rest_exchanges_no_energy() -> None:
    """Rounding is not counted as integration error: for a loop that cannot move, and for an arm that friction keeps at
    rest.
    """
    builder = phipsi.SceneBuilder().link("base")
    for name, parent, z in (("a", "base", 0.0), ("b", "a", -0.5)):
        builder.link(name, 1.0, (0, 0, -0.25), 0.02 * np.eye(3))
        builder.joint(name, "revolute", parent, name, xyz=(0, 0, z), axis=(0, 1, 0), friction=0.1, damping=0.05)
    loop = builder.connect("pin", "point", "b", xyz=(0, 0, -0.5), other_xyz=(0.5, 0, -0.5)).build()
    q, qd, _ = loop.loops.project([0.3, 0.5], [0.1, 0.0])
    for path in (loop.simulate(q, qd, dt=1e-3, steps=200), pendulum(friction=9.0).simulate([0.5], [0.0], dt=1e-3, steps=200)):
        assert path.energy_audit().relative_error < AUDIT


def test_friction_takes_energy_where_a_joint_returns_to_its_limit() -> None:
    scene = pendulum(lower=-0.2, upper=0.5, friction=0.5)
    with pytest.warns(phipsi.errors.LimitWarning):
        path = scene.simulate([0.7], [0.0], dt=1e-3, steps=50)
    assert shares(path)["friction"] < 0.0


@pytest.mark.parametrize("floating_base", [False, True])
@pytest.mark.parametrize("restitution", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("dt", [1e-3, 4e-3])
def test_passive_robots_do_not_gain_energy(dt: float, restitution: float, floating_base: bool) -> None:
    """Chains with friction, damping and stops; some lack one of them."""
    for seed in range(30):
        scene = robot(seed, range_of_motion=0.4 if seed % 2 else 3.0, friction=0.3 * (seed % 5 > 0), damping=0.3 * (seed % 3 > 0), floating_base=floating_base)
        q, qd = start(scene, seed)
        path = scene.simulate(q, qd, dt=dt, steps=round(1.0 / dt), restitution=restitution)
        energy, works = path.energy(), shares(path)
        gained = np.max(energy.total - np.minimum.accumulate(energy.total))
        # Elastic impacts of order 1 gain or lose the work of gravity in a substep.
        assert gained <= 1e-3 * size(energy.kinetic), f"robot {seed}"
        # Torques of stops are accurate to 1e-11.
        assert max(works.values()) <= 1e-11 * size(energy.kinetic), f"robot {seed}"
        # Impacts with rebound make steps first-order.
        assert path.energy_audit().relative_error < (AUDIT if restitution == 0.0 else 3 * AUDIT), f"robot {seed}"


@pytest.mark.parametrize("restitution", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("gap", [0.0, 1e-4])
def test_an_impact_that_drives_another_joint_into_its_stop_does_not_gain_energy(gap: float, restitution: float) -> None:
    """A light carriage leaves its stop while the heavy block on it reaches its own."""
    builder = phipsi.SceneBuilder().link("base").link("carriage", 0.1).link("block", 1.0)
    builder.joint("one", "prismatic", "base", "carriage", axis=(1, 0, 0), lower=-1.0, upper=0.0)
    scene = builder.joint("two", "prismatic", "carriage", "block", axis=(1, 0, 0), lower=-1.0, upper=0.0).build(gravity=(0, 0, 0))
    path = scene.simulate([-gap, 0.0], [-2.9, 3.0], dt=1e-3, steps=5, restitution=restitution)
    kinetic = path.energy().kinetic
    assert np.all(np.diff(kinetic) <= product(2, kinetic[0])) and path.stops


def controlled_and_fine(scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray, accuracy: float, **given: object) -> float:
    """Error after half a second with error control, compared with a simulation with a thousandth of the bound, relative
    to the bound.
    """
    path, fine = (scene.simulate(q, qd, duration=0.5, dt=0.05, accuracy=bound, **given) for bound in (accuracy, 1e-3 * accuracy))
    assert len(path) == 11
    off = np.abs(scene.difference(fine.q[-1], path.q[-1])).max(), np.abs(path.qd[-1] - fine.qd[-1]).max() / size(fine.qd)
    return float(max(off)) / accuracy


@pytest.mark.parametrize("accuracy", [1e-4, 1e-6, 1e-8])
def test_error_control_meets_its_bound_on_smooth_motion(accuracy: float) -> None:
    for seed in range(4):
        for kinds, floating_base in ((("revolute", "prismatic"), False), (KINDS, True)):
            scene = random_scene(seed, 5, kinds=kinds, floating_base=floating_base, armature=0.1)
            q, qd, tau = random_states(scene, seed)
            for law in ({}, {"damping": 1.0, "stiffness": 20.0}, {"pd": phipsi.PD(np.full(scene.nv, 300.0), np.full(scene.nv, 10.0), scene.neutral())}):
                assert controlled_and_fine(scene, q, 0.5 * qd, accuracy, tau=0.2 * tau, limits="report", **law) < 100.0


def check_stops(accuracy: float, restitution: float) -> None:
    """Robots that reach their stops."""
    impacts = 0
    for seed in range(8):
        scene = robot(seed, range_of_motion=0.35)
        q, qd = start(scene, seed)
        assert controlled_and_fine(scene, q, qd, accuracy, restitution=restitution) < 100.0, f"robot {seed}"
        impacts += len(scene.simulate(q, qd, duration=0.5, accuracy=1e-6, restitution=restitution).stops)
    assert impacts > 8


@pytest.mark.parametrize("accuracy", [1e-4, 1e-6, 1e-8])
def test_error_control_meets_its_bound_with_stops_and_friction(accuracy: float) -> None:
    check_stops(accuracy, 0.0)


def test_rows_of_error_control_are_where_they_are_asked_for() -> None:
    scene = robot(1, range_of_motion=0.35)
    q, qd = start(scene, 1)
    path = scene.simulate(q, qd, duration=0.4, accuracy=1e-7)
    assert_near(path.t, np.linspace(0.0, 0.4, 1001), product(1, 1.0))
    some = scene.simulate(q, qd, dt=0.1, steps=4, accuracy=1e-7)
    assert_near(some.t, [0.0, 0.1, 0.2, 0.3, 0.4], product(1, 1.0))
    assert_near(some.q, path.q[::250], 1e-5)
    assert 0.0 < some.estimated_error < 1e-4 and some.integrator in ("dormand-prince-5", "rosenbrock-3")
    several = scene.simulate(np.stack([q, q]), np.stack([qd, 0.5 * qd]), dt=0.1, steps=4, accuracy=1e-7)
    assert several.estimated_error.shape == several.substeps.shape == (2,)
    assert_same_bits(several.q[0], some.q)
    simulator = scene.simulator(q, qd, dt=0.1, accuracy=1e-7)
    for steps in (1, 2, 1):
        simulator.step(steps=steps)
    assert_same_bits(simulator.q, some.q[-1])


def test_what_error_control_refuses() -> None:
    scene = robot(1)
    q, qd = start(scene, 1)
    path = scene.simulate(q, qd, duration=0.1, accuracy=1e-6)
    with pytest.raises(ArgumentError, match="accuracy: found a simulation with error control"):
        path.vjp(np.ones((len(path), 3)))
    with pytest.raises(ArgumentError, match="accuracy: found a simulation with error control"):
        path.error_estimate()
    with pytest.raises(ArgumentError, match="accuracy: found error control with a fixed method"):
        scene.simulate(q, qd, duration=0.1, accuracy=1e-6, method="rk4")


def in_time(code: str) -> None:
    """Run a program that must end."""
    program = f"import warnings, sys\nwarnings.simplefilter('ignore')\nsys.path.insert(0, {str(Path(__file__).parent)!r})\nfrom motion_scenes import *\n{code}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=LONG, check=False)
    assert done.returncode == 0, done.stderr


def test_error_control_returns_a_joint_to_its_limit_in_time() -> None:
    in_time("pendulum(lower=-0.2, upper=0.5).simulate([0.51], [0.0], dt=1e-3, steps=100, accuracy=1e-6)")


def test_error_control_meets_its_bound_with_rebounds_in_time() -> None:
    in_time("from test_energy_audit import check_stops\ncheck_stops(1e-6, 0.5)")


def test_error_control_ends_bounces_that_become_ever_shorter() -> None:
    in_time("pendulum(lower=-0.2, upper=0.5).simulate([0.5], [0.1], dt=2e-3, steps=100, tau=[9.0], accuracy=1e-6, restitution=0.5)")


def bounced(start: tuple[float, float], gravity: float, stiffness: float, restitution: float, duration: float) -> tuple[float, float]:
    """Position and velocity of a unit mass on a spring from 1 m, or without a spring, after its bounces on a stop at zero: closed form from impact to impact."""
    (x, v), left = start, duration
    w, center = np.sqrt(stiffness), 1.0 + gravity / stiffness if stiffness else 0.0

    def at(t: float) -> tuple[float, float]:
        if not stiffness:
            return x + v * t + 0.5 * gravity * t * t, v + gravity * t
        c, s = np.cos(w * t), np.sin(w * t)
        return center + (x - center) * c + v / w * s, v * c - w * (x - center) * s

    for _ in range(1000):
        if stiffness:
            # Zero with a negative velocity: the phase where the cosine is -center/amplitude, rising from the start.
            amplitude, phase = np.hypot(x - center, v / w), np.arctan2(-v / w, x - center)
            hit = (np.arccos(np.clip(-center / amplitude, -1.0, 1.0)) - phase) % (2 * np.pi) / w if amplitude >= center else np.inf
        else:
            square = v * v - 2 * gravity * x
            hit = -(v + np.sqrt(square)) / gravity if gravity < 0 or (square >= 0 and v < 0) else np.inf
        if not hit < left:
            break
        x, v, left = 0.0, -restitution * at(hit)[1], left - hit
        if v < 1e-13 and gravity + stiffness < 0:
            return 0.0, 0.0
    return at(left)


@pytest.mark.parametrize("dt", [0.01, 0.5])
@pytest.mark.parametrize("accuracy", [1e-4, 1e-8])
@pytest.mark.parametrize("restitution", [0.0, 0.3, 0.9])
def test_the_estimate_of_error_control_has_the_effect_of_rebounds(restitution: float, accuracy: float, dt: float) -> None:
    """A stop that is reached fast, slowly, or only grazed within a substep, by a mass that gravity or a spring returns to it or takes away from it."""
    for gravity, stiffness, start in [(g, 0.0, start) for g in (-9.81, -0.01, 0.5, 3.0, 9.81) for start in ((0.3, -1.0), (0.01, -np.sqrt(0.02 * abs(g)) - 1e-3))] + [
        (0.0, 30.0, (2.001, 0.0)), (0.0, 30.0, (2.3, 0.0)), (-20.0, 30.0, (0.7, 0.2)),
    ]:  # fmt: skip
        builder = phipsi.SceneBuilder().link("base").link("mass", 1.0)
        scene = builder.joint("slide", "prismatic", "base", "mass", axis=(1, 0, 0), lower=0.0, upper=50.0, stiffness=stiffness).build(gravity=(gravity, 0, 0))
        path = scene.simulate([start[0]], [start[1]], dt=dt, duration=1.0, accuracy=accuracy, restitution=restitution, rest=[1.0])
        x, v = bounced(start, gravity, stiffness, restitution, 1.0)
        error = max(abs(path.q[-1, 0] - x), abs(path.qd[-1, 0] - v) / max(1.0, abs(v)))
        assert error <= 10.0 * path.estimated_error + 1e-13, (gravity, stiffness, start)
        # Repeated impacts amplify errors.
        assert path.estimated_error <= 50.0 * accuracy, (gravity, stiffness, start)


def errors_and_estimates(range_of_motion: float, friction: float) -> tuple[np.ndarray, np.ndarray]:
    """At the end of 40 simulations with a step of 4 ms: the error compared with error control, and the estimate."""
    found = []
    for seed in range(40):
        scene = robot(seed, range_of_motion=range_of_motion, friction=friction)
        q, qd = start(scene, seed)
        path = scene.simulate(q, qd, dt=4e-3, steps=100, record_every=50)
        fine = scene.simulate(q, qd, dt=0.2, steps=2, accuracy=1e-9)
        estimate = path.error_estimate()
        assert estimate.shape == (3,) and estimate[0] == 0.0
        found.append((np.abs(scene.difference(fine.q[-1], path.q[-1])).max(), estimate[-1]))
    off, estimates = np.array(found).T
    return off, estimates


@pytest.mark.parametrize(("range_of_motion", "friction"), [(3.0, 0.0), (3.0, 0.3), (0.4, 0.0), (0.4, 0.3)])
def test_the_error_estimate_bounds_the_error_of_most_runs(range_of_motion: float, friction: float) -> None:
    off, estimates = errors_and_estimates(range_of_motion, friction)
    bounded = off <= 3.0 * estimates + 1e-12
    assert np.mean(bounded) >= 0.9, f"{np.sum(~bounded)} of {len(off)}, up to {np.max(off / np.maximum(estimates, 1e-300)):.1e} times the estimate"
    # The estimate is not much larger.
    assert np.median(estimates / np.maximum(off, 1e-12)) < 30.0


def jammed(seed: int) -> tuple[phipsi.Scene, np.ndarray, np.ndarray, dict[str, float | np.ndarray]]:
    """A chain with a rough tip, or two, that strikes the ground; some joints have stops, and strong torques reverse it."""
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 4))
    chain = phipsi.SceneBuilder().link("world")
    for k in range(count):
        limits = {"lower": -0.6, "upper": 0.6} if random.random() < 0.5 else {}
        chain.link(f"l{k}", 1.0, (0, 0, -0.25), np.diag([0.01, 0.01, 0.002]))
        axis = (0, 1, 0) if random.random() < 0.7 else (1, 0, 0)
        chain.joint(f"j{k}", "revolute", f"l{k - 1}" if k else "world", f"l{k}", xyz=(0, 0, -0.5 if k else 0), axis=axis, damping=0.05, **limits)
    of_tips = {"friction": random.uniform(0.3, 5), "restitution": float(random.choice([0, 0.5]))}
    for i, xyz in enumerate([(0, 0, -0.5), (0.1, 0.1, -0.45)][: int(random.integers(1, 3))]):
        chain.contact(f"tip{i}", f"l{count - 1}", xyz=xyz, offset=-0.5 * count * random.uniform(0.8, 0.99), **of_tips)
    tau = random.normal(size=count) * random.choice([0, 10, 50])
    qd = random.normal(size=count) * random.choice([3, 10])
    return chain.build(), random.uniform(-0.6, 0.6, count), qd, {"dt": float(random.choice([1e-3, 4e-3])), "tau": tau}


@pytest.mark.parametrize("seed", [22, 33, 55, 73, 146])
def test_friction_of_contacts_takes_energy_also_in_jams(seed: int) -> None:
    scene, q, qd, given = jammed(seed)
    with warnings.catch_warnings():
        # A start below the ground can wedge a joint outside of its limits.
        warnings.simplefilter("ignore", phipsi.errors.LimitWarning)
        warnings.simplefilter("ignore", phipsi.errors.ContactWarning)
        path = scene.simulate(q, qd, steps=250, **given)
    assert path.contacts is not None and path.contacts.converged
    assert path.contacts.lost_in_friction >= -1e-12 and path.contacts.lost_in_impacts >= 0.0
