"""Shapes that touch in simulations: scenes with exact answers, laws, and metamorphic tests."""

from __future__ import annotations

import pickle

import numpy as np
import phipsi
import pytest
from phipsi import shapes
from phipsi._motion_parts import contact_wrenches

G = 9.81
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def free(name, shape, mass=1.0, friction=1.0, builder=None):
    """A builder with a body that moves freely."""
    builder = builder or phipsi.SceneBuilder().link("world")
    builder = builder.link(name, mass=mass, shape=shape, collide=True, friction=friction)
    return builder.joint(f"{name} joint", "floating", "world", name)


def on_ground(*bodies, friction=1.0, ground=None):
    """A scene of free bodies (name, shape) above the plane z = 0."""
    builder = phipsi.SceneBuilder().link("world").collider("ground", ground or shapes.HalfSpace(), friction=friction)
    for name, shape in bodies:
        builder = free(name, shape, friction=friction, builder=builder)
    return builder.build()


def at(*places):
    """q of free bodies at (x, y, z), or (x, y, z, quaternion)."""
    return np.concatenate([np.r_[place, UPRIGHT] if len(place) == 3 else place for place in places])


def heights(path):
    """z of all bodies in the last row."""
    return path.q[-1].reshape(-1, 7)[:, 2]


CUBE = shapes.Box((0.2, 0.2, 0.2))


def test_cubes_with_flush_edges_stay_on_each_other():
    scene = on_ground(("a", CUBE), ("b", CUBE), ("c", CUBE))
    q = at((0, 0, 0.1), (0, 0, 0.3), (0, 0, 0.5))
    path = scene.simulate(q, np.zeros(18), dt=2e-3, steps=50)
    assert np.abs(path.q[-1] - q).max() < 1e-9
    assert path.contacts.converged


def test_bricks_of_a_row_that_are_flush_stay():
    scene = on_ground(*((f"b{i}", CUBE) for i in range(3)))
    q = at((0, 0, 0.1), (0.2, 0, 0.1), (0.1, 0, 0.3))
    path = scene.simulate(q, np.zeros(18), dt=2e-3, steps=50)
    assert np.abs(path.q[-1] - q).max() < 1e-9


@pytest.mark.parametrize(("clearance", "hits"), [(1e-3, False), (-1e-3, True)])
def test_a_ball_that_passes_a_box_is_not_deflected(clearance, hits):
    scene = free("ball", shapes.Sphere(0.05), builder=phipsi.SceneBuilder().link("world").collider("box", shapes.Box((0.2, 0.2, 0.2)))).build()
    q, qd = at((-0.493, 0.0, 0.0)), np.array([20.0, 0, 0, 0, 0, 0])
    # Beside the box, at a height between its faces.
    q[1] = 0.1 + 0.05 + clearance
    path = scene.simulate(q, qd, dt=1e-3, steps=50)
    expected = [-0.493 + 20.0 * 0.05, q[1], -0.5 * G * 0.05**2]
    assert (np.abs(path.q[-1, :3] - expected).max() < 1e-9) is not hits
    assert (len(path.contacts.shapes.row) > 0) is hits


def test_a_cylinder_rolls_two_meters_in_two_seconds():
    scene = on_ground(("wheel", shapes.Cylinder(0.1, 0.05, rpy=(np.pi / 2, 0, 0))))
    path = scene.simulate(at((0, 0, 0.1)), [1.0, 0, 0, 0, 10.0, 0], dt=2e-3, steps=1000)
    assert np.allclose(path.q[-1, :3], [2.0, 0.0, 0.1], rtol=0, atol=1e-6)


@pytest.mark.parametrize("shape", [shapes.Sphere(0.1), shapes.Capsule(0.1, 0.3, rpy=(np.pi / 2, 0, 0))])
def test_round_shapes_roll_without_loss(shape):
    scene = on_ground(("body", shape))
    path = scene.simulate(at((0, 0, 0.1)), [1.0, 0, 0, 0, 10.0, 0], dt=2e-3, steps=200)
    assert np.allclose(path.q[-1, :3], [0.4, 0.0, 0.1], rtol=0, atol=1e-6)


@pytest.mark.parametrize(("friction", "moves"), [(0.55, True), (0.6, False)])
def test_a_block_slides_above_the_angle_of_friction(friction, moves):
    angle = np.radians(30.0)  # tan = 0.577
    ramp = shapes.HalfSpace(rpy=(0.0, angle, 0.0))
    scene = on_ground(("block", shapes.Box((0.2, 0.2, 0.1))), friction=friction, ground=ramp)
    normal = np.array([np.sin(angle), 0.0, np.cos(angle)])
    q = np.r_[0.05 * normal, 0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2)]
    path = scene.simulate(q, np.zeros(6), dt=1e-3, steps=200)
    down = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    way = float((path.q[-1, :3] - q[:3]) @ down)
    expected = 0.5 * G * (np.sin(angle) - friction * np.cos(angle)) * 0.2**2 if moves else 0.0
    # Order 1 in the step.
    assert abs(way - expected) < (1e-2 * expected if moves else 1e-9)


@pytest.mark.parametrize(("overhang", "falls"), [(0.09, False), (0.11, True)])
def test_a_box_over_an_edge_tips_beyond_its_center(overhang, falls):
    table = shapes.Box((0.4, 0.4, 0.2), xyz=(-0.2, 0.0, -0.1))
    scene = free("box", CUBE, builder=phipsi.SceneBuilder().link("world").collider("table", table)).build()
    path = scene.simulate(at((overhang - 0.1, 0.0, 0.1)), np.zeros(6), dt=2e-3, steps=250)
    turned = float(2.0 * np.arccos(min(abs(path.q[-1, 6]), 1.0)))
    assert (turned > 0.1) is falls
    if not falls:
        assert turned < 1e-9


def test_forces_equal_the_weight_and_are_equal_springs():
    scene = on_ground(("box", shapes.Box((0.4, 0.2, 0.1))))
    path = scene.simulate(at((0, 0, 0.05)), np.zeros(6), dt=1e-3, steps=4)
    of = path.contacts.shapes
    last = of.row == 4
    assert np.allclose(of.force[last].sum(axis=0) * (-1 if of.pair[last][0, 0] == 0 else 1), [0, 0, G], rtol=0, atol=1e-9)
    assert np.allclose(np.abs(of.force[last][:, 2]), G / 4, rtol=0, atol=1e-9) and last.sum() == 4
    assert of.pairs() == [("ground", "box")]


def test_far_from_the_origin_a_box_rests_as_well():
    ground = shapes.HalfSpace(xyz=(1000.0, -1000.0, 500.0))
    scene = on_ground(("box", CUBE), ground=ground)
    q = at((1000.0, -1000.0, 500.1))
    path = scene.simulate(q, np.zeros(6), dt=1e-3, steps=100)
    assert np.abs(path.q[-1] - q).max() < 1e-8


def test_a_shape_out_of_reach_leaves_the_bits_of_a_motion():
    arm = phipsi.scenes.chain(4)
    builder = arm.to_builder().collider("tip", shapes.Sphere(0.05), link=arm.link_names[-1])
    scene = builder.collider("wall", shapes.HalfSpace(xyz=(0, 0, -100.0))).build()
    q, qd = np.array([0.3, -0.2, 0.5, 0.1]), np.array([1.0, 2.0, -1.0, 0.5])
    with_wall, without = (one.simulate(q, qd, dt=2e-3, steps=100) for one in (scene, arm))
    assert np.array_equal(with_wall.q, without.q) and np.array_equal(with_wall.qd, without.qd)


def test_energy_does_not_rise_while_boxes_fall_on_each_other():
    scene = on_ground(("a", CUBE), ("b", shapes.Box((0.3, 0.1, 0.15))), friction=0.5)
    turned = np.array([0.2, 0.1, 0.3, 0.9]) / np.linalg.norm([0.2, 0.1, 0.3, 0.9])
    q = at((0, 0, 0.15), np.r_[0.05, 0.02, 0.5, turned])
    path = scene.simulate(q, np.zeros(12), dt=2e-3, steps=150)
    total = path.energy().total
    # Semi-implicit steps of order 1: m g^2 h^2 per step in free fall.
    assert np.diff(total).max() < 2 * G**2 * 2e-3**2
    assert total[-1] < total[0] - 1.0


def test_batches_have_the_bits_of_single_states():
    scene = on_ground(("a", CUBE), ("b", shapes.Sphere(0.1)))
    rng = np.random.default_rng(3)
    q = np.stack([at((0, 0, 0.1), (0.02 * i, 0.01, 0.31)) for i in range(5)])
    qd = 0.3 * rng.standard_normal((5, 12))
    batch = scene.simulate(q, qd, dt=2e-3, steps=30)
    for i in range(5):
        one = scene.simulate(q[i], qd[i], dt=2e-3, steps=30)
        assert np.array_equal(batch.q[i], one.q)
        own, of = one.contacts.shapes, batch.contacts.shapes
        assert np.array_equal(of.force[of.state == i], own.force)


def test_a_simulator_makes_the_steps_of_simulate():
    scene = on_ground(("a", CUBE))
    q = at((0, 0, 0.13))
    path = scene.simulate(q, np.zeros(6), dt=2e-3, steps=80)
    simulator = scene.simulator(q, np.zeros(6), dt=2e-3)
    for _ in range(80):
        simulator.step()
    assert np.array_equal(simulator.q, path.q[-1])
    own = simulator.contacts.shapes
    last = path.contacts.shapes.row == 80
    assert np.array_equal(own.force, path.contacts.shapes.force[last]) and len(own.force) == 4


def test_gradients_are_those_of_differences_inside_a_mode():
    scene = on_ground(("a", CUBE), ("b", shapes.Sphere(0.1)), friction=0.4)
    q, qd = at((0, 0, 0.1), (0.03, 0.02, 0.3)), np.zeros(12)
    qd[0], qd[6] = 1.0, 0.5
    kept = {"dt": 1e-3, "steps": 20}
    rng = np.random.default_rng(0)
    bar_q, bar_qd = rng.standard_normal((2, 12))
    path = scene.simulate(q, qd, **kept)
    got = path.vjp(np.stack([np.zeros((12))] * 20 + [bar_q]), np.stack([np.zeros(12)] * 20 + [bar_qd]))

    def end(dq, dqd):
        path = scene.simulate(scene.integrate(q, dq), qd + dqd, **kept)
        return path.q[-1], path.qd[-1]

    def difference(d, h):
        (qp, vp), (qm, vm) = end(h * d[0], h * d[1]), end(-h * d[0], -h * d[1])
        return bar_q @ scene.difference(qm, qp) / (2 * h) + bar_qd @ (vp - vm) / (2 * h)

    for along in range(3):
        d = rng.standard_normal((2, 12))
        if along == 0:
            d[1] = 0.0
        # Only motion along the ground and velocities: heights leave the mode.
        d[0][[2, 3, 4, 8, 9, 10]] = 0.0
        d[1][[2, 3, 4, 8]] = 0.0
        # Steps so long that the tolerance of the contact law, 1e-10, does not matter, and an extrapolation to zero.
        change = (4 * difference(d, 5e-4) - difference(d, 1e-3)) / 3
        expected = got.q @ d[0] + got.qd @ d[1]
        assert abs(change - expected) < 3e-6 * max(1.0, abs(change))


def test_colliders_survive_copies_and_locks():
    scene = on_ground(("a", CUBE), ("b", CUBE))
    for copy in (pickle.loads(pickle.dumps(scene)), scene.to_builder().build(), scene.with_payload("a", 0.5, (0, 0, 0), 0.01 * np.eye(3))):
        assert copy.collider_names == ("ground", "a", "b")
    locked = scene.lock(["a joint"], at((0, 0, 0.1), (0, 0, 0.3)))
    path = locked.simulate(at((0, 0, 0.3)), np.zeros(6), dt=2e-3, steps=20)
    assert abs(path.q[-1, 2] - 0.3) < 1e-9 and path.contacts.shapes.pairs() == [("a", "b")]
    assert scene.without_contacts().collider_names == ()


@pytest.mark.parametrize("name", ["accuracy", "smoothing"])
def test_options_that_shapes_do_not_have_are_refused_by_name(name):
    scene = on_ground(("a", CUBE))
    with pytest.raises(phipsi.errors.ArgumentError, match=name):
        scene.simulate(at((0, 0, 0.2)), np.zeros(6), dt=2e-3, steps=2, **{name: 1e-3})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda b: b.collider("a", CUBE), "duplicate"),
        (lambda b: b.collider("c", shapes.HalfSpace(), link="a"), "moves"),
        (lambda b: b.collider("c", shapes.Hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])), "volume"),
        (lambda b: b.collider("c", CUBE, link="nothing"), "does not exist"),
        (lambda b: b.collider("c", CUBE, friction=-1.0), "friction"),
        (lambda b: b.collider("c", CUBE, restitution=2.0), "restitution"),
        (lambda b: b.collider_pair("a", "nothing"), "nothing"),
        (lambda b: b.collider_pair("a", "ground", margin=-1.0), "margin"),
        (lambda b: b.exclude("a", "nothing"), "nothing"),
    ],
)
def test_a_scene_names_what_is_wrong_with_a_collider(change, message):
    builder = phipsi.SceneBuilder().link("world").collider("ground", shapes.HalfSpace())
    with pytest.raises(phipsi.errors.SceneError, match=message):
        change(free("a", CUBE, builder=builder)).build()


def test_rules_say_which_shapes_touch():
    def touches(builder):
        q = at((0, 0, 0.1))
        path = builder.build().simulate(q, np.zeros(6), dt=2e-3, steps=20)
        return abs(path.q[-1, 2] - 0.1) < 1e-9

    def made(groups=1, mask=1):
        builder = phipsi.SceneBuilder().link("world").collider("ground", shapes.HalfSpace(), link="world")
        builder = builder.link("a", mass=1.0, inertia=0.01 * np.eye(3)).joint("j", "floating", "world", "a")
        return builder.collider("a", CUBE, link="a", groups=groups, mask=mask)

    assert touches(made())
    assert not touches(made(groups=2, mask=2))
    assert touches(made(groups=2, mask=1)) and touches(made(groups=1, mask=4))
    assert touches(made(groups=2, mask=2).collider_pair("a", "ground"))
    assert not touches(made().exclude("a", "world"))
    assert touches(made().exclude("a", "world").collider_pair("ground", "a"))


def sliding(batch=()):
    """A cube that slides on the ground, at 0.5 m/s and more."""
    scene = on_ground(("a", CUBE), friction=0.2)
    qd = np.zeros((*batch, 6))
    qd[..., 0] = 0.5 + 0.1 * np.arange(int(np.prod(batch))).reshape(batch)
    return scene, np.broadcast_to(at((0, 0, 0.1)), (*batch, 7)), qd


@pytest.mark.parametrize("batch", [(), (2, 3)])
@pytest.mark.parametrize("compact", [False, True])
def test_archives_and_pickles_keep_the_contacts_of_shapes(tmp_path, batch, compact):
    scene, q, qd = sliding(batch)
    path = scene.simulate(q, qd, dt=1e-3, steps=20, record_every=4)
    own = path.contacts.shapes
    assert len(own.row) == 4 * 5 * int(np.prod(batch))
    assert np.array_equal(np.unique(own.state), np.arange(int(np.prod(batch)))) and np.array_equal(np.unique(own.row), np.arange(1, 6))
    if compact:
        np.savez(tmp_path / "a.npz", **path._archive(compact=True))
    else:
        path.save(tmp_path / "a.npz")
    for other in (phipsi.Trajectory.load(tmp_path / "a.npz", scene), pickle.loads(pickle.dumps(path))):
        of = other.contacts.shapes
        assert of.names == own.names == ("ground", "a")
        for name in ("state", "row", "pair", "point", "normal", "gap", "force", "impulse"):
            found, expected = getattr(of, name), getattr(own, name)
            assert found.dtype == expected.dtype and np.array_equal(found, expected), name
        assert np.array_equal(other.contacts.lost_in_friction, path.contacts.lost_in_friction)


def test_archives_without_contacts_of_shapes_are_read(tmp_path):
    scene, q, qd = sliding()
    q = at((0, 0, 5.0))
    path = scene.simulate(q, qd, dt=1e-3, steps=4)
    path.save(tmp_path / "a.npz")
    assert len(phipsi.Trajectory.load(tmp_path / "a.npz", scene).contacts.shapes.row) == 0


def test_tables_have_the_states_of_a_scene_with_shapes(tmp_path):
    pandas = pytest.importorskip("pandas")
    scene, q, qd = sliding()
    path = scene.simulate(q, qd, dt=1e-3, steps=5)
    path.to_csv(tmp_path / "a.csv")
    for table in (path.to_pandas(), pandas.read_csv(tmp_path / "a.csv", index_col="t")):
        assert np.array_equal(table["q:a joint[0]"], path.q[:, 0]) and np.array_equal(table.index, path.t)


def test_the_energy_balance_of_shapes_closes():
    """m v^2 / 2 is lost by friction alone, and a landing loses m v^2 / 2 of its speed."""
    scene, q, qd = sliding((2,))
    audit = scene.simulate(q, qd, dt=1e-3, steps=1000).energy_audit()
    assert np.allclose(audit.contacts, -0.5 * qd[:, 0] ** 2, rtol=1e-12, atol=0) and np.all(np.abs(audit.remainder) < 1e-12)
    drop = scene.simulate(at((0, 0, 0.2)), np.zeros(6), dt=1e-4, steps=2000)
    assert abs(drop.energy_audit().contacts + G * 0.1) < 1e-2 * G * 0.1
    assert abs(drop.contacts.lost_in_impacts + drop.contacts.lost_in_friction + drop.energy_audit().contacts) < 1e-12


def test_torques_with_the_forces_of_shapes_hold_a_robot_at_rest():
    """An arm whose tip leans on the ground, and holds a cube on its back: inverse dynamics with the wrenches of the
    contacts returns the torques.
    """
    builder = phipsi.SceneBuilder().link("base").link("arm", mass=1.0, com=(0.3, 0, 0), inertia=0.01 * np.eye(3))
    builder = builder.joint("hinge", "revolute", "base", "arm", axis=(0, 1, 0), xyz=(0.1, 0.2, 0.3))
    builder = builder.collider("tip", shapes.Sphere(0.05), link="arm").collider("plate", shapes.Box((0.4, 0.4, 0.1)), link="arm")
    # Fixed pillar under the plate, and a cube upon it.
    builder = builder.collider("pillar", shapes.Box((0.1, 0.1, 0.2), xyz=(0.25, 0.2, 0.15)))
    builder = builder.link("cube", mass=2.0, shape=shapes.Box((0.1, 0.1, 0.1)), collide=True, friction=1.0)
    scene = builder.joint("free", "floating", "base", "cube").build()
    q = np.zeros(scene.nq)
    q[scene.q_index("free")] = [0.2, 0.2, 0.4, 0, 0, 0, 1]
    tau = np.zeros(scene.nv)
    tau[scene.v_index("hinge")] = 0.7
    path = scene.simulate(q, np.zeros(scene.nv), dt=1e-3, steps=10, tau=tau)
    assert np.abs(path.qd).max() < 1e-9 and set(map(frozenset, path.contacts.shapes.pairs())) == {frozenset(("pillar", "plate")), frozenset(("plate", "cube"))}
    wrenches = contact_wrenches(scene, path.q, path.contacts)
    assert set(wrenches) == {"arm", "cube"}
    rest = np.zeros_like(path.qd)
    needed = scene.inverse_dynamics(path.q[1:], rest[1:], rest[1:], wrenches={name: of[1:] for name, of in wrenches.items()})
    assert np.abs(needed - path.torques()[1:]).max() < 1e-8


def test_wrenches_of_shapes_in_a_batch_are_those_of_its_states():
    scene, q, qd = sliding((2, 2))
    path = scene.simulate(q, qd, dt=1e-3, steps=6)
    found = contact_wrenches(scene, path.q, path.contacts)["a"]
    assert found.shape == (2, 2, 7, 6) and not found[..., 0, :].any()
    # Friction along -x in the axes of the cube, and the weight; the moment about its center keeps it upright.
    assert np.allclose(found[..., 1:, 3:], [-0.2 * G, 0.0, G], rtol=0, atol=1e-9)
    assert np.allclose(found[..., 1:, :3], 0.0, rtol=0, atol=1e-9)


def test_simulators_with_shapes_survive_pickles():
    scene, q, qd = sliding((2,))
    one = scene.simulator(q, qd, dt=1e-3)
    one.step(steps=7)
    other = pickle.loads(pickle.dumps(one))
    for _ in range(5):
        one.step()
        other.step()
    assert np.array_equal(one.q, other.q) and np.array_equal(one.qd, other.qd)
    assert np.array_equal(one.contacts.shapes.force, other.contacts.shapes.force) and len(other.contacts.shapes.force) == 8
    assert np.array_equal(one.q, scene.simulate(q, qd, dt=1e-3, steps=12).q[:, -1])


@pytest.mark.parametrize("every", [1, 5])
def test_bands_of_a_sliding_cube_are_exact_and_warn_of_modes(every):
    """x = x0 + v0 t - mu g t^2 / 2."""
    scene, q, qd = sliding()
    variance = np.zeros(12)
    variance[0], variance[6] = 1e-6, 1e-4
    unsure = phipsi.estimation.MotionUncertainty(initial=variance)
    with pytest.warns(phipsi.errors.UncertaintyWarning, match="shapes that touch \\('ground' and 'a'\\).*monte-carlo"):
        path = scene.simulate(q, qd, dt=1e-3, steps=50, record_every=every, covariance=unsure)
    assert np.allclose(path.bands.q[:, 0], np.sqrt(1e-6 + 1e-4 * path.t**2), rtol=1e-9)
    sampled = phipsi.estimation.MotionUncertainty(initial=variance, check="unscented")
    ratio = scene.simulate(q, qd, dt=1e-3, steps=50, record_every=every, covariance=sampled).bands.ratio
    assert np.allclose(ratio[1:, 0], 1.0, rtol=1e-4)


def test_shapes_do_not_act_on_dynamics_and_linearizations():
    scene = on_ground(("a", CUBE))
    bare, q = scene.without_contacts(), at((0, 0, 0.1))
    qd, tau = np.arange(6.0), np.arange(6.0)[::-1]
    assert np.array_equal(scene.forward_dynamics(q, qd, tau), bare.forward_dynamics(q, qd, tau))
    for ours, theirs in zip(scene.linearize(q, qd, tau), bare.linearize(q, qd, tau), strict=True):
        assert np.array_equal(ours, theirs)


HULL = shapes.Hull([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])


@pytest.mark.parametrize("shape", [CUBE, shapes.Sphere(0.1), shapes.Cylinder(0.1, 0.2), shapes.Capsule(0.05, 0.1), HULL])
@pytest.mark.parametrize("ground", [shapes.HalfSpace(), shapes.Box((2.0, 2.0, 1.0), xyz=(0, 0, -0.5)), shapes.HeightField(np.zeros((3, 3)), (2.0, 2.0))])
def test_a_start_in_penetration_names_pair_and_depth(shape, ground):
    """Every shape reaches 0.1 m below its center. The first step moves it out, without a velocity."""
    builder = phipsi.SceneBuilder().link("a", mass=1.0, inertia=0.01 * np.eye(3))
    scene = builder.collider("ground", ground).collider("a", shape, link="a").build(floating_base=True)
    with pytest.warns(phipsi.errors.ContactWarning, match='colliders "ground" and "a" 0.030000 m deep'):
        path = scene.simulate(at((0.0, 0.0, 0.07)), np.zeros(6), dt=1e-3, steps=2)
    assert np.abs(path.q[-1, :3] - [0.0, 0.0, 0.1]).max() < 1e-8 and np.abs(path.qd).max() < 1e-6
    assert abs(path.contacts.depth - 0.03) < 1e-8


def test_the_deepest_pair_of_a_batch_is_named_first():
    scene = on_ground(("a", CUBE), ("b", CUBE))
    q = np.stack([at((0, 0, 0.1), (1, 0, 0.1)), at((0, 0, 0.09), (0.17, 0, 0.09))])
    message = 'colliders "a" and "b" 0.030000 m deep and 2 more'
    with pytest.warns(phipsi.errors.ContactWarning, match=message):
        scene.simulate(q, np.zeros((2, 12)), dt=1e-3, steps=1)
    simulator = scene.simulator(q[0], np.zeros(12), dt=1e-3)
    with pytest.warns(phipsi.errors.ContactWarning, match=message):
        simulator.reset(q[1], np.zeros(12))


def test_forces_of_connections_and_shapes_carry_a_body_together():
    """A beam on the ground, held up at one end: both forces are the weight."""
    builder = phipsi.SceneBuilder().link("beam", mass=2.0, inertia=0.02 * np.eye(3)).collider("ground", shapes.HalfSpace())
    builder = builder.collider("beam", shapes.Box((0.4, 0.2, 0.2)), link="beam")
    scene = builder.connect("hook", "point", "beam", xyz=(0.2, 0, 0), other_xyz=(0.2, 0, 0.1)).build(floating_base=True)
    path = scene.simulate(at((0, 0, 0.1)), np.zeros(6), dt=1e-3, steps=20)
    hook, of = path.constraint_forces()["hook"], path.contacts.shapes
    assert of.pairs() == [("ground", "beam")]
    for row in range(1, 21):
        on_ground_force = of.force[of.row == row].sum(axis=0)
        assert np.allclose(hook[row] - on_ground_force, [0.0, 0.0, 2.0 * G], rtol=0, atol=1e-6) and hook[row, 2] > 1.0
