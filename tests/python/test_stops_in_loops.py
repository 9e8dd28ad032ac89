"""Joint stops in scenes with contacts and in scenes with connections."""

from __future__ import annotations

import numpy as np
import pytest
from tolerances import EPS

import phipsi


def two_blocks(*, upper: float, closed: bool, floor: bool = False) -> phipsi.Scene:
    """Blocks of 2 and 3 kg on horizontal prismatic joints; `closed`: coupled, so that they move together; `floor`: the
    second is in contact with a point of a third body.
    """
    builder = phipsi.SceneBuilder().link("base").link("left", 2.0).link("right", 3.0)
    builder.joint("left", "prismatic", "base", "left", axis=(1, 0, 0), lower=-1.0, upper=1.0)
    builder.joint("right", "prismatic", "base", "right", axis=(1, 0, 0), lower=-upper, upper=upper)
    if closed:
        builder.couple("together", "left", "right")
    if floor:
        builder.link("ball", 1.0, inertia=0.01 * np.eye(3)).joint("ball", "floating", "base", "ball")
        builder.contact("ground", "ball", radius=0.1, friction=0.5)
    return builder.build()


def four_bar(lower: float, upper: float, offset: float = 0.0) -> phipsi.Scene:
    """The linkage of docs/how-to/closed-loops.md, with a limit of its rocker."""

    def bar(name: str, parent: str, at: tuple[float, float, float], length: float, **joint: float) -> None:
        builder.link(name, 1.0, (0, 0, length / 2), np.diag([length**2 / 12] * 2 + [1e-3]))
        kind = "revolute" if joint else "continuous"
        builder.joint(name, kind, parent, name, xyz=at, axis=(0, 1, 0), **joint)

    builder = phipsi.SceneBuilder().link("ground")
    bar("crank", "ground", (offset, 0, 0), 0.2)
    bar("coupler", "crank", (0, 0, 0.2), 0.4)
    bar("rocker", "ground", (offset + 0.3, 0, 0), 0.3, lower=lower, upper=upper)
    builder.connect("pin", "axis", "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.3), axis=(0, 1, 0))
    return builder.build()


def test_a_stop_of_one_joint_stops_what_is_coupled_to_it() -> None:
    scene = two_blocks(upper=0.2505, closed=True)
    path = scene.simulate(np.zeros(2), np.ones(2), dt=1e-3, steps=500)
    assert path.limits == "stop"
    assert np.array_equal(path.q[-1], [0.2505, 0.2505]) or np.abs(path.q[-1] - 0.2505).max() < 1e-12
    assert np.abs(path.qd[-1]).max() < 1e-12 and path.violations() == []
    [impact] = path.stops
    assert (impact.joint, impact.limit) == ("right", "upper")
    assert abs(impact.time - 0.251) < 1e-9 and abs(impact.speed - 1.0) < 1e-9 and abs(impact.impulse + 5.0) < 1e-9
    assert abs(path.works[4] + 0.5 * 5.0) < 1e-9


@pytest.mark.parametrize("restitution", [0.5, 1.0])
def test_rebounds_of_coupled_joints_have_the_restitution(restitution: float) -> None:
    path = two_blocks(upper=0.25, closed=True).simulate(np.zeros(2), np.ones(2), dt=1e-3, steps=300, restitution=restitution)
    assert np.abs(path.qd[-1] + restitution).max() < 1e-9 and abs(path.stops[0].impulse + 5.0 * (1 + restitution)) < 1e-9


def test_a_pushed_linkage_rests_exactly_on_its_stop() -> None:
    free = four_bar(-10.0, 10.0)
    q, _, _ = free.loops.project([0.5, 0.8, 0.2], np.zeros(3))
    passed = free.simulate(q, np.zeros(3), tau=[-8.0, 0, 0], dt=1e-3, steps=400, damping=0.05)
    bound = float(0.5 * (passed.q[:, 2].min() + q[2]))
    scene = four_bar(bound, 10.0)
    path = scene.simulate(q, np.zeros(3), tau=[-8.0, 0, 0], dt=1e-3, steps=2000, damping=0.05)
    assert path.q[:, 2].min() >= bound - 1e-5 and abs(path.q[-1, 2] - bound) < 1e-9 and np.abs(path.qd[-1]).max() < 1e-9
    assert path.drift.max() < 1e-12 and path.stops and all((s.joint, s.limit) == ("rocker", "lower") for s in path.stops)
    reported = scene.simulate(q, np.zeros(3), tau=[-8.0, 0, 0], dt=1e-3, steps=400, damping=0.05, limits="report")
    assert np.array_equal(reported.q, passed.q) and reported.violations()[0].joint == "rocker"


def pendulum_beside(builder: phipsi.SceneBuilder) -> phipsi.Scene:
    """Add a double pendulum to a scene, with a heavy first link."""
    builder.link("upper", 2.0, (0, 0, -0.2), 0.03 * np.eye(3)).link("lower", 1.0, (0, 0, -0.2), 0.01 * np.eye(3))
    builder.joint("shoulder", "continuous", "ground", "upper", xyz=(0, 2, 0), axis=(0, 1, 0))
    builder.joint("elbow", "continuous", "upper", "lower", xyz=(0, 0, -0.4), axis=(0, 1, 0))
    return builder.build()


@pytest.mark.parametrize("held_by", ["stop", "friction"])
def test_a_robot_beside_a_held_linkage_moves_as_if_it_were_alone(held_by: str) -> None:
    """From rest, in few substeps, with the order of the method: a row that holds has no part in the error."""
    q = four_bar(-10.0, 10.0).loops.project([0.5, 0.8, 0.2], np.zeros(3))[0]
    friction = (20.0 if held_by == "friction" else 0.0) * np.array([1.0, 1.0, 1.0, 0.0, 0.0])
    linkage = four_bar(q[2], 10.0) if held_by == "stop" else four_bar(-10.0, 10.0)
    scene = pendulum_beside(linkage.to_builder()).with_properties(friction=friction)
    alone = pendulum_beside(phipsi.SceneBuilder().link("ground"))
    start, names = np.zeros(scene.nq), ("shoulder", "elbow")
    own = np.r_[tuple(scene.q_index(name) for name in names)]
    for name, angle in zip(linkage.joint_names, q, strict=False):
        start[scene.q_index(name)] = angle
    start[own] = [1.0, -0.5]
    tau = np.zeros(scene.nv)
    tau[scene.v_index("crank")] = -8.0
    path = scene.simulate(start, np.zeros(scene.nv), tau=tau, dt=1e-3, steps=500)
    other = alone.simulate(start[own], np.zeros(2), dt=1e-3, steps=500)
    assert path.events > 0 and path.substeps <= 4
    assert np.abs(path.q[:, own] - other.q).max() < 1e-9 and np.abs(other.q[-1] - other.q[0]).max() > 0.1
    rest = np.delete(path.q[-1] - start, own)
    assert np.abs(rest).max() < 1e-9


@pytest.mark.parametrize("restitution", [0.0, 0.7, 1.0])
def test_stops_give_a_linkage_no_energy(restitution: float) -> None:
    q, qd, _ = four_bar(-10.0, 10.0).loops.project([0.5, 0.8, 0.2], [4.0, 0.0, 0.0])
    path = four_bar(q[2] - 0.2, q[2] + 0.2).simulate(q, qd, dt=2e-4, steps=5000, restitution=restitution)
    energy = path.energy().total
    assert path.stops and energy.max() <= energy[0] + 1e-3 * np.ptp(path.energy().kinetic)
    assert abs(path.energy_audit().remainder) < 0.02 * np.ptp(path.energy().kinetic)


@pytest.mark.parametrize("closed", [True, False])
def test_a_passive_linkage_conserves_energy_as_its_tree(closed: bool) -> None:
    """Fast bars with long steps, for 10 s."""
    linkage = four_bar(-1e3, 1e3)
    scene = linkage if closed else linkage.without_constraints()
    q, qd, _ = linkage.loops.project([0.5, 0.8, 0.2], [10.0, 0.0, 0.0])
    path = scene.simulate(q, qd, dt=5e-3, steps=2000, record_every=20, limits="report")
    energy = path.energy()
    assert path.substeps > 4 and np.ptp(energy.total) < 1e-5 * np.max(energy.kinetic)


def blocks_that_move_together(upper: float, mimic: bool) -> phipsi.Scene:
    """The blocks of `two_blocks` on a connection or as mimic joints, with friction of 2 and 4 N."""
    if not mimic:
        return two_blocks(upper=upper, closed=True).with_properties(friction=np.array([2.0, 4.0]))
    builder = phipsi.SceneBuilder().link("base").link("left", 2.0).link("right", 3.0)
    builder.joint("left", "prismatic", "base", "left", axis=(1, 0, 0), lower=-1.0, upper=1.0, friction=2.0)
    builder.joint("right", "prismatic", "base", "right", axis=(1, 0, 0), lower=-upper, upper=upper, friction=4.0, mimic="left")
    return builder.build(mimic="couple")


@pytest.mark.parametrize("mimic", [True, False])
@pytest.mark.parametrize("accuracy", [1e-4, 1e-7])
@pytest.mark.parametrize(("upper", "restitution"), [(1.0, 0.0), (0.2, 0.0), (0.2, 0.5)])
def test_error_control_with_friction_and_stops_of_joints_that_move_together(upper: float, restitution: float, accuracy: float, mimic: bool) -> None:
    """Closed form: blocks of 5 kg that friction of 6 N brings to rest, before or after a stop."""
    scene = blocks_that_move_together(upper, mimic)
    path = scene.simulate(np.zeros(scene.nq), np.ones(scene.nv), dt=0.1, steps=20, accuracy=accuracy, restitution=restitution)
    slowing, speed = 6.0 / 5.0, np.sqrt(max(1.0 - 2 * 1.2 * upper, 0.0))
    time = (1.0 - speed) / slowing
    rest = 0.5 / slowing if upper == 1.0 else upper - (restitution * speed) ** 2 / (2 * slowing)
    assert np.abs(path.q[-1] - rest).max() <= 10.0 * path.estimated_error + 1e-13 and path.estimated_error <= 50.0 * accuracy
    assert not path.qd[-1].any() and path.q.max() <= upper
    assert [abs(stop.time - time) < 1e-2 * accuracy + 1e-8 for stop in path.stops] == [True] * (upper < 1.0)


def test_error_control_of_a_loop_while_a_stop_holds_it() -> None:
    """A step in which a stop holds a joint is of order 1: the error falls with the root of the bound."""
    linkage, bound = four_bar(-10.0, 10.0), 0.15

    def run(**given: float) -> phipsi.Trajectory:
        scene = four_bar(bound, 10.0)
        q, _, _ = linkage.loops.project([0.5, 0.8, 0.2], np.zeros(3))
        return scene.simulate(q, np.zeros(3), tau=[-8.0, 0.0, 0.0], dt=0.1, steps=4, damping=0.05, **given)

    coarse, fine = run(accuracy=1e-4), run(accuracy=1e-8)
    for path in (coarse, fine):
        assert abs(path.q[-1, 2] - bound) <= 1e-12 and not path.qd[-1].any() and path.q[:, 2].min() >= bound - 1e-12
        assert len(path.stops) == 1 and path.estimated_error < 1e-2
    assert abs(coarse.stops[0].time - fine.stops[0].time) <= 10 * coarse.estimated_error


def test_a_linkage_that_starts_outside_of_a_limit_returns_slowly() -> None:
    q, _, _ = four_bar(-10.0, 10.0).loops.project([0.5, 0.8, 0.2], np.zeros(3))
    scene = four_bar(q[2] + 0.05, 10.0)
    with pytest.warns(phipsi.errors.LimitWarning, match="rocker"):
        path = scene.simulate(q, np.zeros(3), dt=1e-3, steps=600, tau=[-4.0, 0, 0], damping=0.2)
    assert 0.5e-3 < np.diff(path.q[:, 2]).max() < 1.001e-3 and abs(path.q[-1, 2] - q[2] - 0.05) < 1e-6 and path.drift.max() < 1e-12


def test_stops_act_beside_a_contact() -> None:
    with_floor, alone = (two_blocks(upper=0.25, closed=False, floor=floor) for floor in (True, False))
    q, qd = np.concatenate([np.zeros(4), [0.1, 0, 0, 0, 1.0]]), np.array([0.5, 1.0, 0, 0, 0, 0, 0, 0])
    for restitution in (0.0, 0.5):
        path = with_floor.simulate(q, qd, dt=1e-3, steps=400, restitution=restitution)
        other = alone.simulate(q[:2], qd[:2], dt=1e-3, steps=400, restitution=restitution)
        assert (path.limits, path.integrator) == ("stop", "rk4")
        assert np.abs(path.q[:, :2] - other.q).max() < 2e-3 and np.abs(path.qd[-1, :2] - other.qd[-1]).max() < 1e-9
        [impact], [expected] = path.stops, other.stops
        assert (impact.joint, impact.limit) == ("right", "upper") and abs(impact.impulse - expected.impulse) < 1e-9
        assert abs(impact.speed - 1.0) < 1e-9 and abs(path.works[4] - other.works[4]) < 1e-9
        assert np.allclose(path.contacts.force["ground"][-1], [0, 0, 9.81])


def leg(upper: float) -> phipsi.Scene:
    """A body on a foot with a knee with the given upper limit, above the floor; a prismatic joint keeps it upright."""
    builder = phipsi.SceneBuilder().link("base").link("body", 4.0, inertia=0.05 * np.eye(3))
    builder.link("thigh", 1.0, (0, 0, -0.15), 0.01 * np.eye(3)).link("shin", 0.7, (0, 0, -0.15), 0.007 * np.eye(3))
    builder.joint("rail", "prismatic", "base", "body", axis=(0, 0, 1))
    builder.joint("hip", "revolute", "body", "thigh", axis=(0, 1, 0), lower=-1.5, upper=1.5)
    builder.joint("knee", "revolute", "thigh", "shin", xyz=(0, 0, -0.3), axis=(0, 1, 0), lower=0.0, upper=upper)
    return builder.contact("foot", "shin", xyz=(0, 0, -0.3), friction=0.0).build()


def test_a_leg_folds_to_the_stop_of_its_knee_and_stays_there() -> None:
    scene = leg(1.2)
    q = np.array([0.3 * np.cos(0.4) + 0.3 * np.cos(0.4), -0.4, 0.8])
    path = scene.simulate(q, np.zeros(3), dt=1e-3, steps=3000, damping=[0.0, 2.0, 2.0])
    assert path.q[:, 2].max() <= 1.2 and path.q[-1, 2] == 1.2 and path.qd[-1, 2] == 0.0
    assert path.contacts.converged and path.contacts.depth < 1e-4 and scene.contacts.gaps(path.q[-1])[0] > -1e-9
    assert {("knee", "upper")} <= {(s.joint, s.limit) for s in path.stops} and len(path.stops) < 10
    # In equilibrium the foot carries the weight.
    assert np.allclose(path.contacts.force["foot"][-1], [0, 0, 5.7 * 9.81], atol=0.5)
    audit = path.energy_audit()
    assert audit.stops < 0.0 and audit.relative_error < 0.02
    reported = scene.simulate(q, np.zeros(3), dt=1e-3, steps=3000, damping=[0.0, 2.0, 2.0], limits="report")
    assert reported.q[:, 2].max() > 1.3 and reported.stops == []


@pytest.mark.filterwarnings("ignore:q. found contact .* 0.0000:phipsi.errors.ContactWarning")
def test_simulators_and_batches_stop_as_single_runs_do() -> None:
    q = np.array([[0.5526, -0.4, 0.8], [0.6, -0.3, 0.5], [0.7, 0.1, 0.2]])
    scene = leg(0.9)
    batch = scene.simulate(q, np.zeros((3, 3)), dt=1e-3, steps=700)
    assert [impact.state for impact in batch.stops] == sorted(impact.state for impact in batch.stops)
    simulator = scene.simulator(q, np.zeros((3, 3)), dt=1e-3)
    simulator.step(steps=300)
    simulator.step(steps=400)
    stops = simulator.take_stops()
    assert np.array_equal(simulator.q, batch.q[:, -1]) and stops == batch.stops and simulator.take_stops() == []
    for k in range(3):
        single = scene.simulate(q[k], np.zeros(3), dt=1e-3, steps=700)
        assert np.array_equal(single.q, batch.q[k]) and [s.impulse for s in single.stops] == [s.impulse for s in batch.stops if s.state == k]


def test_a_stop_and_momentum_of_a_floating_robot_with_contacts() -> None:
    """Without contact, stops are internal forces, so that momentum is conserved."""
    builder = phipsi.SceneBuilder().link("hull", 2.0, inertia=0.1 * np.eye(3)).link("arm", 1.0, (0.3, 0, 0), 0.02 * np.eye(3))
    builder.joint("arm", "revolute", "hull", "arm", axis=(0, 1, 0), lower=-0.5, upper=0.5).contact("ground", "hull", radius=0.2, friction=0.5)
    scene = builder.build(floating_base=True, gravity=(0, 0, 0))
    q = np.array([0, 0, 5.0, 0, 0, 0, 1.0, 0.0])
    path = scene.simulate(q, [0, 0, 0, 0, 0, 0, 3.0], dt=1e-3, steps=400)
    assert path.q[:, 7].max() == 0.5 and abs(path.qd[-1, 6]) <= 16 * EPS and len(path.stops) == 1
    momentum = scene.momentum(path.q, path.qd)
    assert np.abs(momentum[-1] - momentum[0]).max() < 2e-2 * np.abs(momentum[0]).max()  # a first-order step


def test_limits_are_checked_by_name() -> None:
    with pytest.raises(phipsi.errors.ArgumentError, match='limits: found "bounce"; expected "stop" or "report"'):
        two_blocks(upper=1.0, closed=True).simulate(np.zeros(2), np.zeros(2), dt=1e-3, steps=1, limits="bounce")




def test_a_joint_outside_of_its_limit_returns_beside_a_contact() -> None:
    scene = two_blocks(upper=0.25, closed=False, floor=True)
    q, tau = np.array([0.0, 0.35, 0, 0, 0.1, 0, 0, 0, 1.0]), np.array([0, 2.0, 0, 0, 0, 0, 0, 0])
    with pytest.warns(phipsi.errors.LimitWarning, match="right"):
        path = scene.simulate(q, np.zeros(8), tau=tau, dt=1e-3, steps=1000, damping=[0, 30.0, *[0.0] * 6])
    assert 0.5e-3 < -np.diff(path.q[:, 1]).min() < 1.001e-3 and path.q[-1, 1] == 0.25 and path.qd[-1, 1] == 0.0


@pytest.mark.parametrize("friction", [(20.0, 0.0, 0.0), (0.0, 0.0, 20.0), (5.0, 5.0, 5.0)])
def test_dry_friction_holds_a_linkage_exactly(friction: tuple[float, float, float]) -> None:
    """One held joint, or three that share the load, for 10 s: in simulations, batches and simulators."""
    scene = four_bar(-10.0, 10.0).with_properties(friction=np.array(friction))
    q, _, _ = scene.loops.project([0.5, 0.8, 0.2], np.zeros(3))
    held = scene.simulate(q, np.zeros(3), dt=0.05, steps=200, record_every=200)
    assert held.friction_speed == 0.0 and np.array_equal(held.q[-1], q) and not held.qd.any()
    held = scene.simulate(np.stack([q, q]), np.zeros((2, 3)), dt=0.05, steps=10, friction_speed=0.0)
    assert held.friction_speed == 0.0 and np.array_equal(held.q[:, -1], [q, q]) and not held.qd.any()
    simulator = scene.simulator(q, dt=0.05)
    simulator.step(steps=20)
    assert np.array_equal(simulator.q, q) and not simulator.qd.any()
    creeping = scene.simulate(q, np.zeros(3), dt=0.05, steps=20, friction_speed=0.01)
    assert np.abs(creeping.q[-1] - q).max() > 1e-4
    # More than friction can hold.
    pushed = scene.simulate(q, np.zeros(3), dt=1e-3, steps=20, tau=[60.0, 0, 0])
    assert pushed.q[-1, 0] > q[0] + 1e-4 and pushed.drift.max() < 1e-12


def test_friction_of_coupled_joints_stops_their_sum() -> None:
    """Blocks of 2 and 3 kg that move together slide with (2 + 4) N / 5 kg to their rest."""
    scene = two_blocks(upper=1.0, closed=True).with_properties(friction=np.array([2.0, 4.0]))
    path = scene.simulate(np.zeros(2), np.ones(2), dt=1e-3, steps=1000)
    sliding = path.t < 0.83
    assert np.abs(path.q[sliding] - (path.t - 0.6 * path.t**2)[sliding, None]).max() < 1e-12
    assert np.abs(path.q[-1] - 0.5 / 1.2).max() < 1e-5 and not path.qd[-100:].any() and np.array_equal(path.q[-100], path.q[-1])
    assert np.allclose(path.works[2], -2.5, atol=1e-3)
    # A push of 5 N is held, one of 7 N is not.
    assert not scene.simulate(np.zeros(2), np.zeros(2), dt=1e-3, steps=100, tau=[5.0, 0.0]).qd.any()
    moved = scene.simulate(np.zeros(2), np.zeros(2), dt=1e-3, steps=100, tau=[7.0, 0.0])
    assert np.abs(moved.qd[-1] - 0.02).max() < 1e-3
    # With stops: the rest of the speed, and rebounds.
    for restitution in (0.0, 0.5):
        stop = two_blocks(upper=0.2, closed=True).with_properties(friction=np.array([2.0, 4.0]))
        path = stop.simulate(np.zeros(2), np.ones(2), dt=1e-4, steps=2500, restitution=restitution)
        speed = np.sqrt(1.0 - 2 * 1.2 * 0.2)
        assert len(path.stops) == 1 and abs(path.stops[0].speed - speed) < 1e-3 and path.q.max() <= 0.2 + 1e-12
        time = path.stops[0].time
        assert np.abs(path.qd[-1] + max(restitution * speed - 1.2 * (0.25 - time), 0.0)).max() < 1e-3


def test_sliding_and_sticking_friction_in_loops_has_gradients() -> None:
    scene = two_blocks(upper=1.0, closed=True).with_properties(friction=np.array([2.0, 4.0]))
    last = np.zeros((101, 2))
    last[-1, 0] = 1.0
    found = scene.simulate(np.zeros(2), np.ones(2), dt=1e-3, steps=100).vjp(last)
    assert np.allclose(found.friction, -0.5 * 0.1**2 / 5, rtol=1e-9) and np.allclose(found.tau.sum(), 0.1**2 / 5, rtol=1e-9)
    held = scene.simulate(np.zeros(2), np.zeros(2), dt=1e-3, steps=100).vjp(last)
    assert np.abs(held.tau).max() < 1e-15 and not held.friction.any() and abs(held.q.sum() - 1.0) < 1e-9


@pytest.mark.parametrize("beyond", [0.02, 1e-3])
@pytest.mark.parametrize("crank", [-2.801755737285684, -2.8017, -2.79])
def test_a_joint_beyond_its_stop_at_a_dead_center_ends_no_simulation(crank: float, beyond: float) -> None:
    """Crank and coupler are aligned, or nearly, so that the rocker is at its extreme and cannot return to its limit."""
    q, _, _ = four_bar(-10.0, 10.0).loops.project([crank, np.pi, -0.89], np.zeros(3))
    scene = four_bar(-10.0, float(q[2]) - beyond)
    with pytest.warns(phipsi.errors.LimitWarning) as caught:
        path = scene.simulate(q, np.zeros(3), dt=1e-3, steps=100)
    assert "joint \"rocker\" at a stop that the connections or contacts prevent" in str(caught[-1].message) and len(caught) == 2
    assert path.drift.max() < 1e-11 and np.ptp(path.energy().total) < 0.15 and np.abs(path.qd).max() < 5.0
    with pytest.warns(phipsi.errors.LimitWarning, match="beyond its upper limit"):
        simulator = scene.simulator(np.stack([q, q]), dt=1e-3)
    with pytest.warns(phipsi.errors.LimitWarning, match="prevent"):
        simulator.step(steps=100)
    assert np.array_equal(simulator.q, path.q[[100, 100]])


@pytest.mark.parametrize("beyond", [0.02, 1e-3])
@pytest.mark.parametrize("crank", [-2.801755737285684, -2.8017, -2.79])
def test_a_stop_at_a_dead_center_adds_no_energy_while_a_contact_acts(crank: float, beyond: float) -> None:
    """A ball that rests on the ground makes all steps those with contacts."""
    q, _, _ = four_bar(-10.0, 10.0).loops.project([crank, np.pi, -0.89], np.zeros(3))
    builder = four_bar(-10.0, float(q[2]) - beyond).to_builder().link("ball", 1.0, inertia=0.01 * np.eye(3)).joint("ball", "floating", "ground", "ball")
    scene = builder.contact("ground", "ball", radius=0.1, friction=0.5).build()
    q = np.concatenate([q, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]])
    with pytest.warns(phipsi.errors.LimitWarning) as caught:
        path = scene.simulate(q, np.zeros(scene.nv), dt=1e-3, steps=30)
    last = str(caught[-1].message)
    assert "joint \"rocker\" at a stop that the connections or contacts prevent" in last and "of 30 steps" in last
    assert path.drift.max() < 1e-11 and np.ptp(path.energy().total) < 1.0 and np.abs(path.qd).max() < 10.0


def test_a_stop_that_a_contact_contradicts_acts_as_soon_as_it_can() -> None:
    """A wall blocks the return of a puck that is beyond the limit of its joint; the puck returns past the end of the wall."""
    builder = phipsi.SceneBuilder().link("world").link("rail", 1.0).link("puck", 1.0)
    builder.joint("along", "prismatic", "world", "rail", axis=(0, 1, 0)).joint("across", "prismatic", "rail", "puck", axis=(1, 0, 0), lower=-1.0, upper=-0.01)
    wall = {"other_xyz": (-0.15, 0.0, 0.0), "other_size": (0.2, 0.4, 1.0)}
    scene = builder.contact("wall", "puck", radius=0.05, friction=0.0, **wall).build(gravity=(0, 0, 0))
    with pytest.warns(phipsi.errors.LimitWarning) as caught:
        path = scene.simulate([0.0, 0.0], [1.0, 0.0], dt=1e-3, steps=400)
    assert "joint \"across\" at a stop that the connections or contacts prevent" in str(caught[-1].message)
    beside = path.q[:, 0] < 0.199
    assert np.abs(path.q[beside, 1]).max() < 1e-9 and np.abs(path.qd[beside, 1]).max() < 1e-9
    assert path.q[-1, 1] <= -0.01 and scene.contacts.gaps(path.q).min() > -1e-9


def test_exact_friction_beside_contacts_warns() -> None:
    scene = two_blocks(upper=1.0, closed=False, floor=True).with_properties(friction=np.array([1.0, 0, 0, 0, 0, 0, 0, 0]))
    q = np.concatenate([np.zeros(4), [0.1, 0, 0, 0, 1.0]])
    for run in (scene.simulate, scene.simulator):
        given = {"steps": 1} if run == scene.simulate else {}
        with pytest.warns(phipsi.errors.FrictionWarning, match="joint \"left\".*in which contacts act"):
            run(q, np.zeros(8), dt=1e-3, friction_speed=0.0, **given)
