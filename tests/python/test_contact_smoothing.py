"""smoothing= of the contact law: its definition, gap at rest, slip and limit; gradients through changes of mode compared
with differences; energy; the reported bias compared with the exact law in numpy; refusals.
"""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from contact_robots import Robot, Run, arm, ball, block, contact, parameters, quadruped
from tolerances import CONTACT, CONTACT_GRADIENT, SMOOTHED_ENERGY, SMOOTHED_LAW, SMOOTHED_REST, assert_same_bits

import phipsi
from phipsi.errors import ArgumentError, ContactWarning

G = 9.81
DOWN = (0.0, 0.0, -G)


def puck(friction: float = 0.5, mass: float = 2.0, gravity: tuple[float, ...] = DOWN, **given: Any) -> Robot:
    """A body on three legs whose centroid is below its center of mass."""
    legs = {f"leg{i}": contact("puck", (*xy, 0.0), friction, **given) for i, xy in enumerate([(0.1, 0.0), (-0.05, 0.08), (-0.05, -0.08)])}
    return Robot({"puck": parameters(mass, (0, 0, 0), np.diag([0.01, 0.012, 0.02]))}, legs, gravity=gravity)


def floating(*xyz: float) -> np.ndarray:
    return np.array([*xyz, 0, 0, 0, 1.0])


def near(found: Any, expected: Any, relative: float, size: float = 0.0) -> None:
    found, expected = np.broadcast_arrays(found, expected)
    off = np.abs(found - expected)
    assert np.all(off <= relative * np.maximum(np.abs(expected), size)), f"{found} {expected}"


def law(path: phipsi.Trajectory, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Impulses, velocities u at the end with the gap of the start over dt, G in the same axes, and J v without contacts, of the
    first step of robots of one tree without free joints, on horizontal planes.
    """
    scene, found = path.scene, path.contacts
    assert found is not None
    p = dt * np.stack([found.force[name][..., 1, :] for name in scene.contacts.names], axis=-2)
    u = scene.contacts.velocities(path.q[..., 0, :], path.qd[..., 1, :])
    gram = scene.contacts.gram(path.q[..., 0, :]).reshape(*p.shape[:-2], 3 * p.shape[-2], -1)
    free = u - (gram @ p.reshape(*p.shape[:-2], -1, 1)).reshape(u.shape)
    u[..., 2] += scene.contacts.gaps(path.q[..., 0, :]) / dt
    return p, u, gram, free


def tips(random: np.random.Generator, count: int) -> tuple[Robot, np.ndarray, np.ndarray]:
    """Arms whose tip is above or on a table."""
    robot = replace(arm(0.4), gravity=DOWN)
    q = random.uniform(-1.1, 1.1, (40_000, 3))
    gaps = robot.build().contacts.gaps(q)[:, 0]
    q = q[(gaps > 1e-5) & (gaps < 3e-3)][:count]
    assert len(q) == count
    return robot, q, random.uniform(-2, 2, q.shape)


# --- the law ---


def test_the_law_holds_by_its_definition() -> None:
    s, dt = 1e-3, 2e-3
    robot, q, qd = tips(np.random.default_rng(1), 150)
    path = robot.build().simulate(q, qd, dt=dt, steps=1, limits="report", smoothing=s)
    p, u, _, _ = law(path, dt)
    share = G * path.scene.total_mass
    near(p[..., 2] * u[..., 2], s * share, SMOOTHED_LAW)
    inside = (0.4 * p[..., 2]) ** 2 - (p[..., :2] ** 2).sum(axis=-1)
    assert (inside > 0).all() and (p[..., 2] > 0).all()
    slip = -np.sqrt(G * s) * share * dt * 0.4 * p[..., :2] / inside[..., None]
    near(u[..., :2], slip, SMOOTHED_LAW, np.abs(u).max())
    assert path.contacts is not None and path.contacts.converged.all() and (path.contacts.residual <= CONTACT).all()


def test_impulses_are_the_root_in_mpmath() -> None:
    """The dense equations of one contact with 30 digits, from G and the velocities without contacts."""
    s, dt, mu = 1e-3, 2e-3, 0.4
    robot, q, qd = tips(np.random.default_rng(9), 12)
    path = robot.build().simulate(q, qd, dt=dt, steps=1, limits="report", smoothing=s)
    found, u, gram, _ = law(path, dt)
    c = u[:, 0] - np.einsum("nij,nj->ni", gram, found[:, 0])
    energy, creep = s * G * path.scene.total_mass, np.sqrt(G * s) * G * path.scene.total_mass * dt * mu
    with mp.workdps(30):
        for i in range(len(q)):
            g, free = mp.matrix(gram[i].tolist()), mp.matrix(c[i].tolist())

            def equations(*p: Any, g: Any = g, free: Any = free) -> Any:
                slow = creep / ((mu * p[2]) ** 2 - p[0] ** 2 - p[1] ** 2)
                return g * mp.matrix(p) + free + mp.matrix([slow * p[0], slow * p[1], -energy / p[2]])

            root = mp.findroot(equations, tuple(found[i, 0] * [0.99, 0.99, 1.0]))
            near(found[i, 0], np.array([float(x) for x in root]), SMOOTHED_LAW, np.abs(found[i, 0]).max())


def test_the_reported_bias_is_the_residual_of_the_exact_law() -> None:
    s, dt, mu = 1e-4, 2e-3, 0.4
    robot, q, qd = tips(np.random.default_rng(2), 150)
    path = robot.build().simulate(q, qd, dt=dt, steps=1, limits="report", smoothing=s)
    p, u, gram, free = law(path, dt)
    r = 3 / np.trace(gram, axis1=-2, axis2=-1)[:, None]
    target = p[:, 0] - r * u[:, 0]
    normal = np.maximum(0.0, target[:, 2:])
    length = np.linalg.norm(target[:, :2], axis=-1, keepdims=True)
    tangent = target[:, :2] * np.minimum(1.0, mu * normal / length)
    off = np.linalg.norm(p[:, 0] - np.hstack([tangent, normal]), axis=-1) / r[:, 0] / np.abs(free).max(axis=(-1, -2))
    assert path.contacts is not None
    near(path.contacts.bias, off, SMOOTHED_LAW)
    assert (off > 0).all()


@pytest.mark.parametrize("s", [1e-5, 1e-3])
def test_a_body_at_rest_hovers_by_the_length(s: float) -> None:
    path = puck().build().simulate(floating(0, 0, s), np.zeros(6), dt=1e-3, steps=1500, smoothing=s)
    assert path.contacts is not None
    for name in path.contacts.gap:
        near(path.contacts.gap[name][-1], s, SMOOTHED_REST)
        near(path.contacts.force[name][-1, 2], 2.0 * G / 3, SMOOTHED_REST)
    near(path.contacts.hover, s, 2 * SMOOTHED_REST)


def test_gap_times_force_is_length_times_share() -> None:
    """A bar whose center of mass is nearer to one end: contacts share its weight by the levers."""
    s = 1e-4
    feet = {name: contact("bar", (x, y, 0), 0.5) for name, x, y in (("near", 0.1, 0), ("far", -0.3, 0.1), ("far too", -0.3, -0.1))}
    bar = Robot({"bar": parameters(1.5, (0, 0, 0), np.diag([0.01, 0.02, 0.02]))}, feet, gravity=DOWN)
    path = bar.build().simulate(floating(0, 0, s), np.zeros(6), dt=1e-3, steps=3000, smoothing=s)
    assert path.contacts is not None
    for name, part in (("near", 0.75), ("far", 0.125), ("far too", 0.125)):
        near(path.contacts.force[name][-1, 2], part * 1.5 * G, 2e-3)
        near(path.contacts.gap[name][-1] * path.contacts.force[name][-1, 2], s * 1.5 * G / 3, SMOOTHED_REST)


@pytest.mark.parametrize("pull", [0.3, 0.95])
def test_a_contact_that_would_stick_creeps_by_the_formula(pull: float) -> None:
    s = 1e-5
    scene = puck(0.5, radius=0.0).build()
    tau = np.array([pull * 0.5 * 2.0 * G, 0, 0, 0, 0, 0])
    path = scene.simulate(floating(0, 0, s), np.zeros(6), dt=1e-3, steps=3000, tau=tau, smoothing=s)
    speed = np.sqrt(G * s) * pull / (1 - pull**2)
    near(path.qd[-1, 0], speed, SMOOTHED_REST)
    assert path.contacts is not None
    if pull < 0.9:
        near(path.contacts.creep, speed, SMOOTHED_REST)
    assert path.contacts.state["leg0"][-1] == (phipsi.ContactState.STICKING if pull < 0.9 else phipsi.ContactState.SLIDING)


def test_small_lengths_converge_to_the_exact_law() -> None:
    """The gap is of first order in the length, the slip of order one half."""
    scene = puck(0.3).build()
    start, rates = floating(0, 0, 0.02), np.array([1.0, 0, -0.5, 0, 0, 0.5])
    given: dict[str, Any] = {"dt": 1e-3, "steps": 1000}
    exact = scene.simulate(start, rates, **given)
    lengths = np.array([1e-4, 1e-6, 1e-8])
    off = []
    for s in lengths:
        path = scene.simulate(start, rates, smoothing=s, **given)
        off.append([np.linalg.norm(path.q[-1, :2] - exact.q[-1, :2]), abs(path.q[-1, 2] - exact.q[-1, 2])])
    slopes = np.diff(np.log10(off), axis=0) / np.diff(np.log10(lengths))[:, None]
    assert np.all(np.abs(slopes[:, 1] - 1.0) <= 0.1), off
    assert np.all(slopes[:, 0] >= 0.4), off
    assert off[-1][0] <= 2e-3


def test_without_smoothing_nothing_changes() -> None:
    scene = puck().build()
    start, rates = floating(0, 0, 0.01), np.array([1.0, 0, -0.5, 0, 0, 0.5])
    path, same = scene.simulate(start, rates, dt=1e-3, steps=50), scene.simulate(start, rates, dt=1e-3, steps=50, smoothing=0.0)
    assert_same_bits(path.q, same.q)
    assert path.contacts is not None and path.contacts.bias == path.contacts.hover == path.contacts.creep == 0.0


def test_a_penetration_is_removed_slowly() -> None:
    s = 1e-4
    scene = Robot({"ball": parameters(0.5, (0, 0, 0), np.eye(3) * 2e-3)}, {"ground": contact("ball", (0, 0, 0), 0.3, radius=0.1)}, gravity=DOWN).build()
    with pytest.warns(ContactWarning, match='"ground" 0.010000 m deep; the steps move them out slowly'):
        path = scene.simulate(floating(0, 0, 0.09), np.zeros(6), dt=1e-3, steps=2000, smoothing=s)
    assert path.contacts is not None
    gap = path.contacts.gap["ground"]
    # Below the plane, the force is that of a gap of dt times the speed beyond sqrt(g s), which settles at s.
    assert (path.qd[:, 2][gap < 0] <= np.sqrt(G * s) + s / 1e-3).all() and (np.diff(gap[gap < 0]) > 0).all()
    near(gap[-1], s, SMOOTHED_REST)
    assert 0.009 < path.contacts.depth <= 0.01


# --- energy ---


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_the_sum_of_all_energies_does_not_rise(friction: float) -> None:
    """With the potential of the relaxed law, -s F log(gap), for bodies whose gaps are linear in their motion."""
    s = 1e-3
    on = {"ground": contact("ball", (0, 0, 0), friction, radius=0.1), "wall": contact("ball", (0, 0, 0), friction, radius=0.1, normal=np.array([-1.0, 0, 0.2]), offset=-0.5)}
    robot = Robot({"ball": parameters(0.5, (0, 0, 0), 2e-3 * np.eye(3))}, on, gravity=DOWN)
    path = robot.build().simulate(floating(0, 0, 0.3), np.array([2.0, 0.1, 0, 1.0, -2.0, 0.5]), dt=1e-3, steps=1500, smoothing=s)
    assert path.contacts is not None
    total = 0.25 * (path.qd[:, :3] ** 2).sum(axis=-1) + 1e-3 * (path.qd[:, 3:] ** 2).sum(axis=-1) + 0.5 * G * path.q[:, 2]
    for gap in path.contacts.gap.values():
        assert (gap > 0).all()
        total = total - s * 0.5 * G / 2 * np.log(gap)
    assert (np.diff(total) <= SMOOTHED_ENERGY).all(), np.diff(total).max()
    assert total[-1] < total[0] - 0.1
    # The audit has the energy that contacts dissipate, up to the error of the integrator.
    audit = path.energy_audit()
    assert abs(audit.remainder) <= 0.1 * abs(audit.contacts)


# --- gradients ---


@pytest.mark.parametrize(
    ("robot", "limits"),
    [(block(0.4, corners=(0, 1, 2)), None), (ball(0.3), None), (quadruped(0.6), None), (arm(0.3), "report"), (puck(0.0), None)],
    ids=["block", "ball", "quadruped", "arm", "without friction"],
)
def test_gradients_beside_differences_through_landings(robot: Robot, limits: str | None) -> None:
    """Random states that land within the run, which the exact law does in modes."""
    random = np.random.default_rng(3)
    scene, s = robot.build(), 2e-3
    if robot.floating:
        q = scene.integrate(np.tile(scene.neutral(), (12, 1)), random.normal(size=(12, scene.nv)) * 0.1)
        for _ in range(3):
            q[..., 2] += random.uniform(1e-3, 6e-3, 12) - scene.contacts.gaps(q).min(axis=-1)
        qd = random.normal(size=(12, scene.nv)) * 0.3
        qd[:, 2] -= 1.0
    else:
        _, q, qd = tips(random, 12)
    given = {"dt": 2e-3, "steps": 8, "smoothing": s, "limits": limits, "tau": random.uniform(-1, 1, scene.nv)}
    given |= {name: random.uniform(0.05, 0.2, scene.nv) for name in ("armature", "damping", "stiffness")}
    run = Run(robot, q, qd, given)
    force = np.stack([force[..., 2] for force in run.path.contacts.force.values()])
    assert force[:, :, 1:].max() > 8 * np.median(force[:, :, 1]), "no state lands"
    for name, found, (slopes, doubt) in run.compared():
        scale = np.maximum(1.0, np.abs(slopes).max())
        assert np.abs(slopes).max() > 1e-6 or (name in ("friction", "contact friction")), name
        sure = doubt <= 0.3 * CONTACT_GRADIENT * scale
        assert np.mean(sure) >= 0.9, f"{name}: {np.mean(sure)}"
        off = np.abs(found - slopes)[sure] / scale
        assert np.all(off <= CONTACT_GRADIENT), f"{name}: {off.max()}"


def test_a_push_at_the_threshold_of_slip_has_one_derivative() -> None:
    """The exact law has another derivative on each side: zero below, and that of sliding above."""
    s, scene, threshold = 1e-4, puck(0.5).build(), 0.5 * 2.0 * G
    start, given = floating(0, 0, s), {"dt": 1e-3, "steps": 100}

    def at(push: float, **more: Any) -> phipsi.Trajectory:
        return scene.simulate(start if more else floating(0, 0, 0), np.zeros(6), tau=np.array([push, 0, 0, 0, 0, 0]), **given, **more)

    by_q = np.zeros((101, 6))
    by_q[-1, 0] = 1.0

    def slope(push: float, step: float, **more: Any) -> float:
        once, twice = ((at(push + k * step, **more).q[-1, 0] - at(push - k * step, **more).q[-1, 0]) / (2 * k * step) for k in (1, 2))
        return float(4 * once - twice) / 3

    sides = [at(threshold + side).vjp(by_q).tau[0] for side in (-0.1, 0.1)]
    assert abs(sides[0]) <= 1e-12 and sides[1] > 2e-3
    for push in (threshold - 2, threshold, threshold + 2):
        found = at(push, smoothing=s).vjp(by_q)
        near(found.tau[0], slope(push, 1e-3, smoothing=s), CONTACT_GRADIENT, sides[1])
        assert found.tau[0] > 0.01 * sides[1]
        assert found.mode_changes == [] and all(np.isinf(leg.margin) for leg in found.contacts.values())


def test_a_ball_that_misses_a_plane_has_a_gradient() -> None:
    one = Robot({"ball": parameters(0.5, (0, 0, 0), 2e-3 * np.eye(3))}, {"ground": contact("ball", (0, 0, 0), 0.3, radius=0.1)}, gravity=(0, 0, 0))
    scene = one.build()
    start, rates = floating(0, 0, 0.11), np.array([1.0, 0, 0, 0, 0, 0])
    by_qd = np.zeros((201, 6))
    by_qd[-1, 2] = 1.0
    exact = scene.simulate(start, rates, dt=1e-3, steps=200).vjp(cotangent_qd=by_qd)
    assert exact.q[2] == 0.0 and exact.contacts["ground"].offset == 0.0
    path = scene.simulate(start, rates, dt=1e-3, steps=200, smoothing=1e-4)
    found = path.vjp(cotangent_qd=by_qd)
    # The force s F / gap falls with the gap, and its derivative by the height is negative.
    assert found.q[2] < -1e-3 and found.contacts["ground"].offset > 1e-3
    assert path.qd[-1, 2] > 1e-3

    def at(height: float) -> float:
        return float(scene.simulate(floating(0, 0, height), rates, dt=1e-3, steps=200, smoothing=1e-4).qd[-1, 2])

    step = 1e-5
    once, twice = ((at(0.11 + k * step) - at(0.11 - k * step)) / (2 * k * step) for k in (1, 2))
    near(found.q[2], (4 * once - twice) / 3, CONTACT_GRADIENT)


def test_the_gradient_is_that_of_the_smoothing_of_the_run() -> None:
    scene = puck().build()
    given: dict[str, Any] = {"dt": 1e-3, "steps": 20}
    path = scene.simulate(floating(0, 0, 1e-3), np.array([1.0, 0, -0.2, 0, 0, 0]), smoothing=1e-3, **given)
    bar = np.random.default_rng(4).normal(size=path.qd.shape)
    found = scene.simulate_vjp(path.q, path.qd, bar, bar, smoothing=1e-3, **given)
    assert_same_bits(path.vjp(bar, bar).q, found.q)
    with pytest.raises(ArgumentError, match="recomputed"):
        scene.simulate_vjp(path.q, path.qd, bar, bar, **given)


def leg(friction: float = 0.8, offset: float = 0.0) -> phipsi.Scene:
    """A leg on a rail, whose knee is driven by a rod."""
    builder = phipsi.SceneBuilder().link("world").link("hip", mass=3.0, inertia=0.02 * np.eye(3))
    builder.joint("rail", "prismatic", "world", "hip", axis=(0, 0, 1))
    for name, parent, xyz, length in (("thigh", "hip", (0, 0, 0), 0.3), ("shank", "thigh", (0, 0, -0.3), 0.4), ("crank", "hip", (0.1, 0, 0), 0.3)):
        builder.link(name, mass=0.5, com=(0, 0, -length / 2), inertia=0.5 * length**2 / 12 * np.diag([1, 1, 0.02]))
        builder.joint(name, "continuous", parent, name, xyz=xyz, axis=(0, 1, 0), damping=0.05)
    builder.connect("rod", "distance", "crank", "shank", xyz=(0, 0, -0.3), other_xyz=(0.1, 0, 0.02), length=0.06)
    return builder.contact("foot", "shank", xyz=(0, 0, -0.4), friction=friction, offset=offset).build()


def test_a_closed_loop_stands_at_the_length() -> None:
    s, scene = 1e-4, leg()
    bent, _, _ = scene.loops.project([0.0, -0.4, 0.7, -0.35])
    bent[0] -= scene.contacts.gaps(bent)[0] - s
    gains = np.array([0.0, 400.0, 0.0, 400.0])
    path = scene.simulate(bent, np.zeros(4), dt=1e-3, steps=500, pd=phipsi.PD(gains, gains / 20, bent), smoothing=s)
    assert path.contacts is not None and path.drift.max() <= 1e-12
    near(path.contacts.gap["foot"][-1] * path.contacts.force["foot"][-1, 2], s * scene.total_mass * G, 3 * SMOOTHED_REST)


def test_gradients_on_connections_beside_differences() -> None:
    s, scene = 2e-3, leg()
    bent, _, _ = scene.loops.project([0.0, -0.4, 0.7, -0.35])
    bent[0] -= scene.contacts.gaps(bent)[0] - 3e-3
    rates, tau = np.array([-1.0, 0, 0, 0]), np.array([0.0, 2.0, 0, -1.0])
    given: dict[str, Any] = {"dt": 2e-3, "steps": 8, "smoothing": s}
    path = scene.simulate(bent, rates, tau=tau, **given)
    assert path.contacts is not None and path.contacts.force["foot"][:, 2].max() > 3 * path.contacts.force["foot"][1, 2]
    bar = np.random.default_rng(6).normal(size=path.qd.shape)
    found = path.vjp(cotangent_qd=bar)

    def slope(at: Any, step: float) -> float:
        once, twice = ((at(k * step) - at(-k * step)) / (2 * k * step) for k in (1, 2))
        return float(4 * once - twice) / 3

    def value(scene: phipsi.Scene, tau: np.ndarray) -> float:
        return float((bar * scene.simulate(bent, rates, tau=tau, **given).qd).sum())

    size = np.abs(found.tau).max()
    near(found.tau, [slope(lambda d, e=e: value(scene, tau + d * e), 1e-3) for e in np.eye(4)], CONTACT_GRADIENT, size)
    near(found.contacts["foot"].friction, slope(lambda d: value(leg(0.8 + d), tau), 1e-4), CONTACT_GRADIENT, size)
    near(found.contacts["foot"].offset, slope(lambda d: value(leg(offset=d), tau), 1e-6), CONTACT_GRADIENT)


def balls() -> phipsi.Scene:
    """Two balls on one line, without gravity."""
    builder = phipsi.SceneBuilder().link("world")
    for name, mass in (("left", 3.0), ("right", 1.0)):
        builder.link(name, mass=mass, inertia=0.01 * np.eye(3)).joint(name, "prismatic", "world", name, axis=(1, 0, 0))
    return builder.contact("pair", "left", radius=0.1, friction=0.0, other="right", other_radius=0.1).build(gravity=(0, 0, 0))


def test_gradients_of_a_contact_between_links_beside_differences() -> None:
    scene, start, rates = balls(), np.array([0.0, 0.25]), np.array([1.0, -1.0])
    given: dict[str, Any] = {"dt": 1e-3, "steps": 60, "smoothing": 1e-3}
    path = scene.simulate(start, rates, **given)
    bar = np.random.default_rng(8).normal(size=path.qd.shape)
    found = path.vjp(cotangent_qd=bar)

    def value(q: np.ndarray, qd: np.ndarray) -> float:
        return float((bar * scene.simulate(q, qd, **given).qd).sum())

    for name, step in (("q", 1e-6), ("qd", 1e-5)):
        for e, bar_of in zip(np.eye(2), getattr(found, name), strict=True):
            at = (lambda d, e=e: value(start + d * e, rates)) if name == "q" else (lambda d, e=e: value(start, rates + d * e))
            once, twice = ((at(k * step) - at(-k * step)) / (2 * k * step) for k in (1, 2))
            near(bar_of, (4 * once - twice) / 3, CONTACT_GRADIENT, np.abs(getattr(found, name)).max())


# --- the same by other ways ---


def test_a_simulator_and_batches_have_the_same_bits(tmp_path: Path) -> None:
    robot = quadruped(0.6)
    scene, s = robot.build(), 1e-3
    random = np.random.default_rng(5)
    q = scene.integrate(np.tile(scene.neutral(), (5, 1)), random.normal(size=(5, scene.nv)) * 0.1)
    q[:, 2] += 1e-3 - scene.contacts.gaps(q).min(axis=-1)
    qd = random.normal(size=(5, scene.nv)) * 0.3
    path = scene.simulate(q, qd, dt=1e-3, steps=30, smoothing=s)
    assert_same_bits(scene.simulate(q[3], qd[3], dt=1e-3, steps=30, smoothing=s).q, path.q[3])
    simulator = scene.simulator(q, qd, dt=1e-3, smoothing=s)
    simulator.step(steps=10)
    simulator = pickle.loads(pickle.dumps(simulator))
    simulator.step(steps=20)
    assert_same_bits(simulator.q, path.q[:, -1])
    assert path.contacts is not None
    assert_same_bits(simulator.contacts.bias, path.contacts.bias)
    path.save(tmp_path / "path.npz")
    loaded = phipsi.Trajectory.load(tmp_path / "path.npz", scene)
    for figure in ("bias", "hover", "creep"):
        assert_same_bits(getattr(loaded.contacts, figure), getattr(path.contacts, figure))
    assert_same_bits(loaded.vjp(path.qd).q, path.vjp(path.qd).q)


def test_contacts_between_links_are_smoothed() -> None:
    """Two balls that approach each other: the smaller share of the two weights is the reference force of their contact."""
    s, dt, scene = 1e-3, 1e-3, balls()
    path = scene.simulate([0.0, 0.25], [1.0, -1.0], dt=dt, steps=200, smoothing=s)
    assert path.contacts is not None
    gap, force = path.contacts.gap["pair"], -path.contacts.force["pair"][:, 0]
    # Without gravity, weights are those at 9.80665 m/s^2.
    near(gap[1:] * force[1:], s * 1.0 * 9.80665, SMOOTHED_LAW)
    near(path.qd @ [3.0, 1.0], 2.0, 1e-12)
    assert (gap > 0).all() and path.qd[-1, 0] < path.qd[-1, 1]


# --- refusals ---


@pytest.mark.parametrize("length", [-1e-3, np.nan, np.inf])
def test_a_length_that_is_none_is_refused(length: float) -> None:
    scene = puck().build()
    with pytest.raises(ArgumentError, match="smoothing.*a length in m, zero or positive"):
        scene.simulate(floating(0, 0, 0.1), np.zeros(6), dt=1e-3, steps=1, smoothing=length)


def test_a_scene_without_contacts_is_refused() -> None:
    with pytest.raises(ArgumentError, match="smoothing.*without contacts"):
        puck().build().without_contacts().simulate(floating(0, 0, 0.1), np.zeros(6), dt=1e-3, steps=1, smoothing=1e-3)


def test_a_contact_that_rebounds_is_refused_by_its_name() -> None:
    scene = ball(0.3, 0.5).build()
    with pytest.raises(ArgumentError, match='smoothing.*"ground" of restitution 0.5.*expected 0'):
        scene.simulator(floating(0, 0, 0.3), np.zeros(6), dt=1e-3, smoothing=1e-3)


def test_stops_are_refused_by_the_name_of_the_joint() -> None:
    scene = arm(0.3).build()
    with pytest.raises(ArgumentError, match='smoothing.*"j0".*limits="report"'):
        scene.simulate(np.zeros(3), np.zeros(3), dt=1e-3, steps=1, smoothing=1e-3)
    bent = np.array([1.0, -0.5, 0.8])
    assert scene.simulate(bent, np.zeros(3), dt=1e-3, steps=1, smoothing=1e-3, limits="report").q.shape == (2, 3)
