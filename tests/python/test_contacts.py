"""Contacts with friction: closed forms, comparison with MuJoCo, batches, pickles, reported values, and refused
arguments.
"""

from __future__ import annotations

import copy
import pickle
import warnings

import numpy as np
import pytest

import phipsi
from phipsi.errors import ArgumentError, BadStateWarning, ContactWarning, NotFiniteError, SceneError, ShapeError, SimulationError

G = 9.81
EDGES = np.array([0.4, 0.3, 0.2])


def box(friction: float = 0.5, restitution: float = 0.0, gravity: tuple[float, ...] = (0, 0, -G)) -> phipsi.Scene:
    """2 kg, floating, with its eight corners above z = 0."""
    inertia = 2.0 / 12 * np.diag([EDGES[1] ** 2 + EDGES[2] ** 2, EDGES[0] ** 2 + EDGES[2] ** 2, EDGES[0] ** 2 + EDGES[1] ** 2])
    builder = phipsi.SceneBuilder().link("box", mass=2.0, inertia=inertia)
    for i in range(8):
        side = np.array([i & 1, i >> 1 & 1, i >> 2 & 1]) - 0.5
        builder.contact(f"corner{i}", "box", xyz=side * EDGES, friction=friction, restitution=restitution)
    return builder.build(floating_base=True, gravity=gravity)


def ball(friction: float, restitution: float = 0.0) -> phipsi.Scene:
    builder = phipsi.SceneBuilder().link("ball", mass=0.5, inertia=0.4 * 0.5 * 0.1**2 * np.eye(3))
    return builder.contact("ground", "ball", radius=0.1, friction=friction, restitution=restitution).build(floating_base=True)


def at(x: float = 0.0, y: float = 0.0, z: float = 0.1) -> np.ndarray:
    return np.array([x, y, z, 0, 0, 0, 1.0])


def along(*v: float) -> np.ndarray:
    return np.array([*v, *[0.0] * (6 - len(v))])


def pendulum(friction: float, restitution: float, offset: float) -> phipsi.Scene:
    """Two rods in a plane without gravity: Kane's example, in which Newton's restitution with friction increases the
    energy.
    """
    builder = phipsi.SceneBuilder().link("base")
    for name, parent, z in (("upper", "base", 0.0), ("lower", "upper", -1.0)):
        builder.link(name, mass=1.0, com=(0, 0, -0.5), inertia=np.diag([1 / 12, 1 / 12, 1e-4]))
        builder.joint(name, "continuous", parent, name, xyz=(0, 0, z), axis=(0, 1, 0))
    builder.contact("tip", "lower", xyz=(0, 0, -1), friction=friction, restitution=restitution, offset=offset)
    return builder.build(gravity=(0, 0, 0))


def biped(friction: float = 0.7, restitution: float = 0.0) -> phipsi.Scene:
    """A trunk on two legs with six joints each and four points per foot."""
    builder = phipsi.SceneBuilder().link("trunk", mass=15.0, com=(0, 0, 0.2), inertia=np.diag([0.5, 0.4, 0.2]))
    for side, y in (("left", 0.1), ("right", -0.1)):
        parent = "trunk"
        joints = (
            ("yaw", (0, 0, 1), (0, y, 0), 0.5, 0.05), ("roll", (1, 0, 0), (0, 0, 0), 0.5, 0.05), ("thigh", (0, 1, 0), (0, 0, 0), 4.0, 0.4),
            ("shank", (0, 1, 0), (0, 0, -0.4), 3.0, 0.4), ("ankle", (0, 1, 0), (0, 0, -0.4), 0.3, 0.05), ("foot", (1, 0, 0), (0, 0, 0), 1.0, 0.1),
        )  # fmt: skip
        for part, axis, xyz, mass, length in joints:
            name = f"{side}_{part}"
            builder.link(name, mass=mass, com=(0, 0, -length / 2), inertia=mass * (length**2 / 12 + 2e-3) * np.eye(3))
            builder.joint(name, "revolute", parent, name, xyz=xyz, axis=axis, lower=-9, upper=9, velocity=99, effort=999)
            parent = name
        for i, (x, dy) in enumerate([(-0.08, -0.04), (-0.08, 0.04), (0.14, -0.04), (0.14, 0.04)]):
            builder.contact(f"{side}{i}", f"{side}_foot", xyz=(x, dy, -0.1), friction=friction, restitution=restitution)
    return builder.build(floating_base=True)


def standing(scene: phipsi.Scene) -> tuple[np.ndarray, np.ndarray, phipsi.PD]:
    q = scene.neutral()
    q[2] = 0.9
    gains = np.concatenate([np.zeros(6), np.full(scene.nv - 6, 3000.0)])
    return q, np.zeros(scene.nv), phipsi.PD(gains, gains / 20, q)


def test_a_sliding_block_slows_by_mu_g_and_stops() -> None:
    mu, v0, dt = 0.5, 2.0, 1e-3
    path = box(mu).simulate(at(), along(v0), dt=dt, steps=800)
    slides = np.arange(400)
    assert np.abs(path.qd[slides, 0] - (v0 - mu * G * path.t[slides])).max() < 1e-9
    assert np.abs(path.qd[-1]).max() < 1e-9
    assert abs(path.q[-1, 0] - (v0**2 / (2 * mu * G) - dt * v0 / 2)) < 1e-5
    told = path.contacts
    force = sum(told.force.values())
    assert np.allclose(force[1:401], [-mu * 2 * G, 0, 2 * G], atol=1e-6) and np.allclose(force[-1], [0, 0, 2 * G], atol=1e-6)
    state = told.state["corner0"]
    assert state.dtype == np.int8 and state.shape == (801,) and state[0] == phipsi.ContactState.OPEN
    assert (state[1:408] == phipsi.ContactState.SLIDING).all() and (state[409:] == phipsi.ContactState.STICKING).all()
    assert (told.state["corner4"] == phipsi.ContactState.OPEN).all()
    assert told.converged and told.residual <= 1e-10 and told.iterations > 0 and told.depth < 1e-9 and told.expansion_kept == 1.0
    assert np.isclose(told.lost_in_friction, 0.5 * 2 * v0**2, rtol=5e-3) and told.lost_in_impacts == 0.0


@pytest.mark.parametrize(("tan", "slides"), [(0.3, False), (0.49997, False), (0.50003, True), (0.7, True)])
def test_a_block_sticks_on_an_incline_up_to_the_friction_angle(tan: float, slides: bool) -> None:
    angle = np.arctan(tan)
    scene = box(0.5, gravity=(G * np.sin(angle), 0, -G * np.cos(angle)))
    speed = scene.simulate(at(), along(0), dt=1e-3, steps=500).qd[-1, 0]
    assert abs(speed - slides * G * (np.sin(angle) - 0.5 * np.cos(angle)) * 0.5) < 1e-9


def test_a_ball_bounces_to_e_squared_of_its_height() -> None:
    path = ball(0.0, 0.8).simulate(at(z=1.1), along(0), dt=2e-4, steps=11000)
    height = path.q[:, 2] - 0.1
    peaks = height[1:-1][(height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:])]
    assert np.allclose(peaks[:3], 0.8 ** np.array([2, 4, 6]), atol=2e-3)
    told = path.contacts
    struck = told.impulse["ground"][:, 2]
    first = struck[struck > 0][0]
    assert np.isclose(first, 0.5 * 1.8 * np.sqrt(2 * G), rtol=1e-3)
    assert np.array_equal(told.state["ground"] != phipsi.ContactState.OPEN, struck > 0)
    assert told.lost_in_impacts > 0.5 * G * (1 - 0.64) and (told.gap["ground"] > -1e-9).all()


def test_a_dropped_box_loses_energy_in_every_step_and_rests() -> None:
    for restitution in (0.0, 0.4):
        path = box(0.6, restitution).simulate(at(z=0.5), np.array([0.3, -0.2, 0, 1.5, 2.0, 0.7]), dt=1e-3, steps=4000)
        energy = path.energy().total
        assert np.diff(energy).max() < 1e-9
        height = path.q[-1, 2]
        assert min(abs(height - EDGES / 2)) < 1e-7 and np.abs(path.qd[-1]).max() < 1e-7
        assert np.isclose(energy[-1], 2 * G * height) and np.isclose(sum(path.contacts.force.values())[-1, 2], 2 * G)
        assert path.contacts.depth < 1e-3
        ends = [int(state[-1]) for state in path.contacts.state.values()]
        assert sorted(ends) == [phipsi.ContactState.OPEN] * 4 + [phipsi.ContactState.STICKING] * 4


def test_a_biped_stands_and_the_forces_are_its_weight() -> None:
    scene = biped()
    q, qd, law = standing(scene)
    path = scene.simulate(q, qd, dt=1e-3, steps=3000, pd=law, record_every=100)
    force = sum(path.contacts.force.values())
    weight = scene.total_mass * G
    assert np.abs(path.qd[-1]).max() < 1e-5 and path.q[-1, 2] > 0.88
    assert np.allclose(force[-1], [0, 0, weight], atol=1e-4 * weight) and path.contacts.converged


def test_a_sliding_ball_ends_up_rolling() -> None:
    scene = ball(0.3)
    path = scene.simulate(at(), along(2.0), dt=1e-3, steps=6000, record_every=1000)
    assert abs(np.linalg.norm(path.qd[-1, :3]) - 2.0 * 5 / 7) < 1e-9
    assert np.abs(scene.contacts.velocities(path.q[-1], path.qd[-1])).max() < 1e-9
    assert np.abs(path.contacts.slip["ground"][-1]).max() < 1e-9


def test_impacts_never_raise_the_energy() -> None:
    random = np.random.default_rng(0)
    struck = 0
    for _ in range(50):
        mu, e, angle = random.uniform(0, 1.2), random.uniform(0, 1), random.uniform(-1.3, 1.3, 2)
        tip = -np.cos(angle[0]) - np.cos(angle.sum())
        scene = pendulum(mu, e, tip - 1e-9)
        rates = random.uniform(-3, 3, (100, 2))
        path = scene.simulate(np.tile(angle, (100, 1)), rates, dt=1e-6, steps=1)
        kinetic = path.energy().kinetic
        assert (kinetic[:, 1] <= kinetic[:, 0] * (1 + 1e-9)).all()
        struck += int((path.contacts.lost_in_impacts > 0).sum())
        assert path.contacts.converged.all()
    assert struck > 1000


def test_beside_mujoco() -> None:
    mujoco = pytest.importorskip("mujoco")
    text = """<mujoco><option timestep="0.0005" cone="elliptic" impratio="100"/>
      <worldbody><geom type="plane" size="5 5 1" friction="0.5" solref="0.004 1"/>
      <body pos="0 0 0.1"><freejoint/><geom type="box" size="0.2 0.15 0.1" mass="2" friction="0.5" solref="0.004 1"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qvel[0] = 2.0
    for _ in range(2000):
        mujoco.mj_step(model, data)
    path = box(0.5).simulate(at(), along(2.0), dt=5e-4, steps=2000, record_every=2000)
    assert abs(path.q[-1, 0] - data.qpos[0]) < 3e-3 and abs(path.q[-1, 2] - data.qpos[2]) < 1e-3


def test_batches_are_the_same_as_singles_and_blocks() -> None:
    scene = box(0.5, 0.3)
    random = np.random.default_rng(1)
    q = np.stack([at(z=z) for z in random.uniform(0.3, 0.6, 6)]).reshape(2, 3, 7)
    qd = random.uniform(-1, 1, (2, 3, 6))
    path = scene.simulate(q, qd, dt=2e-3, steps=400, record_every=20)
    assert path.contacts.force["corner3"].shape == (2, 3, 21, 3) and path.contacts.gap["corner3"].shape == (2, 3, 21)
    assert path.contacts.state["corner3"].shape == (2, 3, 21) and set(np.unique(path.contacts.state["corner3"])) <= set(phipsi.ContactState)
    assert path.contacts.residual.shape == (2, 3) and path.contacts.converged.all()
    simulator = scene.simulator(q, qd, dt=2e-3)
    for _ in range(50):
        simulator.step(steps=8)
    assert np.array_equal(simulator.q, path.q[..., -1, :]) and np.array_equal(simulator.qd, path.qd[..., -1, :])
    for i in np.ndindex(2, 3):
        one = scene.simulate(q[i], qd[i], dt=2e-3, steps=400, record_every=20)
        assert np.array_equal(one.q, path.q[i]) and np.array_equal(one.contacts.force["corner3"], path.contacts.force["corner3"][i])
        assert one.contacts.residual == path.contacts.residual[i]
    assert np.allclose(scene.contacts.gaps(path.q)[..., 3], path.contacts.gap["corner3"], atol=1e-15)
    slip = scene.contacts.velocities(path.q, path.qd)[..., 3, :] * [1, 1, 0]
    assert np.allclose(slip, path.contacts.slip["corner3"], atol=1e-13)
    now = simulator.contacts
    assert np.array_equal(now.force["corner3"], path.contacts.force["corner3"][..., -1, :])
    assert np.array_equal(now.state["corner3"], path.contacts.state["corner3"][..., -1])
    assert np.allclose(now.impulse["corner3"], path.contacts.impulse["corner3"].sum(axis=-2))


def test_forces_and_impulses_are_the_change_of_momentum() -> None:
    scene = box(0.5, 0.5)
    path = scene.simulate(at(z=0.3), np.array([0.5, 0, 0, 0.4, 0.3, 0.2]), dt=2e-3, steps=300)
    told = path.contacts
    given = sum(told.force.values()).sum(axis=0) * 2e-3 + sum(told.impulse.values()).sum(axis=0)
    change = path.momentum()[-1, 3:] - path.momentum()[0, 3:] - np.array([0, 0, -2 * G * 0.6])
    assert np.allclose(given, change, atol=1e-9)


def test_simulators_pickle_and_reset() -> None:
    scene = box(0.5, 0.3)
    simulator = scene.simulator(at(z=0.3), np.array([0.3, 0, 0, 1, 0, 0]), dt=2e-3)
    simulator.step(steps=150)
    for other in (pickle.loads(pickle.dumps(simulator)), copy.copy(simulator)):
        assert other.method == "auto"
        other.step(steps=100)
        again = pickle.loads(pickle.dumps(simulator))
        again.step(steps=100)
        assert np.array_equal(other.q, again.q) and np.array_equal(other.qd, again.qd)
        assert other.contacts.lost_in_impacts == again.contacts.lost_in_impacts
    simulator.reset(at(z=1.0))
    assert simulator.contacts.lost_in_impacts == 0.0 and not simulator.contacts.force["corner0"].any()


def test_contacts_belong_to_the_scene() -> None:
    scene = box(0.5)
    q = at(0.1, 0.2, 0.4)
    expected = scene.contacts.gaps(q)
    for other in (
        pickle.loads(pickle.dumps(scene)),
        copy.deepcopy(scene),
        scene.to_builder().build(),
        pickle.loads(pickle.dumps(scene.to_builder())).build(),
        scene.with_properties(damping=0.1),
        scene.with_payload("box", 1.0),
    ):
        assert other.contacts.names == scene.contacts.names and np.array_equal(other.contacts.gaps(q), expected)
    assert "8 contacts" in repr(scene) and "8 contacts" in repr(scene.to_builder())
    tree = scene.without_contacts()
    assert tree.contacts.names == () and tree.contacts.gaps(q).shape == (0,) and tree.simulate(q, along(0), dt=0.1, steps=1).contacts is None
    assert tree.simulator(q, dt=0.1).contacts is None
    assert np.array_equal(scene.forward_dynamics(q, along(1), along(2)), tree.forward_dynamics(q, along(1), along(2)))


def test_starts_under_a_plane_are_moved_out_and_told() -> None:
    with pytest.warns(ContactWarning, match="0.010000 m deep"):
        path = box(0.5).simulate(at(z=0.09), along(0), dt=1e-3, steps=10)
    assert np.isclose(path.contacts.depth, 0.01) and abs(path.q[-1, 2] - 0.1) < 1e-9 and np.abs(path.qd[-1]).max() < 1e-9


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"link": "bax"}, '"bax"'),
        ({"normal": (0, 0, 0)}, "normal"),
        ({"normal": (0, np.nan, 0)}, "normal|finite"),
        ({"xyz": (np.inf, 0, 0)}, "point|finite"),
        ({"offset": np.nan}, "offset"),
        ({"radius": -0.1}, "radius"),
        ({"friction": -1.0}, "friction"),
        ({"friction": np.nan}, "friction"),
        ({"restitution": 1.5}, "restitution"),
        ({"restitution": -0.1}, "restitution"),
    ],
)
def test_broken_contacts_are_refused_by_name(options: dict[str, object], message: str) -> None:
    builder = phipsi.SceneBuilder().link("box", mass=1.0, inertia=np.eye(3))
    with pytest.raises((SceneError, ArgumentError), match=message) as caught:
        builder.contact("foot", **{"link": "box", "friction": 0.5, **options}).build(floating_base=True)
    assert "foot" in str(caught.value)


def test_what_cannot_have_contacts_is_refused() -> None:
    builder = phipsi.SceneBuilder().link("box", mass=1.0, inertia=np.eye(3)).contact("foot", "box", friction=0.5)
    with pytest.raises(SceneError, match="cannot move"):
        builder.build()
    with pytest.raises(SceneError, match="duplicate name"):
        builder.contact("foot", "box", friction=0.5).build(floating_base=True)
    with pytest.raises(ShapeError, match="xyz of contact"):
        phipsi.SceneBuilder().contact("foot", "box", friction=0.5, xyz=(0, 0))
    with pytest.raises(TypeError, match="friction"):
        phipsi.SceneBuilder().contact("foot", "box")


def test_methods_and_scenes_belong_together() -> None:
    scene = box()
    assert scene.simulate(at(), along(0), dt=1e-3, steps=1).method == "auto"
    for method in ("contact", "rk4", "implicit-euler"):
        path = scene.simulate(at(), along(0), dt=1e-3, steps=1, method=method)
        assert path.method == path.integrator == scene.simulator(at(), dt=1e-3, method=method).method == method
    tree = scene.without_contacts()
    assert tree.simulate(at(), along(0), dt=1e-3, steps=1).method == "auto"
    with pytest.raises(ArgumentError, match="no contacts"):
        tree.simulate(at(), along(0), dt=1e-3, steps=1, method="contact")


def test_solvers_are_refused_by_name() -> None:
    scene = box()
    with pytest.raises(ArgumentError, match="without_contacts"):
        scene.ode()


def test_broken_arguments_are_refused() -> None:
    scene = box()
    with pytest.raises(ShapeError, match="q"):
        scene.contacts.gaps(np.zeros(3))
    with pytest.raises(NotFiniteError, match="qd"):
        scene.contacts.velocities(at(), np.full(6, np.nan))
    with pytest.raises(SimulationError, match="velocity of joint") as caught:
        scene.simulate(at(z=1.0), along(0), dt=1e-3, steps=10, tau=along(0, 0, 1e16), record_every=1)
    assert caught.value.step == 0 and len(caught.value.trajectory) == 1
    assert caught.value.trajectory.contacts.gap["corner0"].shape == (1,)
    with pytest.warns(BadStateWarning):
        assert np.isnan(scene.contacts.gaps(np.full((2, 7), np.nan), errors="nan")).all()


@pytest.mark.parametrize("friction", [3.0, 10.0, 1000.0])
def test_friction_of_any_size_ends_no_run(friction: float) -> None:
    random = np.random.default_rng(3)
    for restitution in (0.0, 0.4):
        qd = random.uniform(-2, 2, (4, 6))
        path = box(friction, restitution).simulate(np.tile(at(z=0.4), (4, 1)), qd, dt=1e-3, steps=800)
        assert (path.contacts.residual < 1e-5).all() and (path.contacts.iterations < 3e4).all()
        assert np.diff(path.energy().total).max() < 1e-8


def test_a_step_without_impulses_that_meet_the_law_is_an_error_that_names_it() -> None:
    # Friction beyond the precision of float64: the solver does not converge and reports it.
    scene = box(1e12)
    with pytest.raises(SimulationError, match=r"step \d+ .*contacts? \"corner.*residual") as caught:
        scene.simulate(at(z=0.5), np.array([0.3, -0.2, 0, 1.5, 2.0, 0.7]), dt=1e-3, steps=2000)
    path = caught.value.trajectory
    assert 0 < caught.value.step < 2000 and len(path) == caught.value.step + 1 == len(path.contacts.gap["corner0"])
    assert len(path.contacts.state["corner0"]) == len(path)


def test_a_start_below_the_surface_warns_with_names_and_depth() -> None:
    scene = box()
    with pytest.warns(ContactWarning, match=r'q: found contact "corner0" 0.300000 m deep and 7 more; the first step moves them out at once, as far as the joints can; .*such as scene.initial'):
        simulator = scene.simulator(at(z=-0.2), dt=1e-3)
    with pytest.warns(ContactWarning, match='contact "corner0" 0.050000 m deep and 3 more'):
        scene.simulate(np.stack([at(), at(z=0.05)]), along(), dt=1e-3, steps=1)
    with pytest.warns(ContactWarning, match='contact "corner0" 0.000010 m deep and 3 more'):
        simulator.reset(at(z=0.1 - 1e-5))
    # On the surface to within rounding, and above it.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for z in (0.1, 0.1 - 1e-7, 0.2):
            scene.simulate(at(z=z), along(), dt=1e-3, steps=1)
            simulator.reset(at(z=z))
