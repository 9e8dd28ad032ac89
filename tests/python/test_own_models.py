"""A model per state: inertias and armature that differ between the states of a batch, against one scene per state."""

import numpy as np
import pytest

import phipsi
import tolerances
from conftest import OF_MASS

from phipsi.errors import ArgumentError, BadStateWarning, NotFiniteError, SceneError, ShapeError, SimulationError
from phipsi.estimation import MotionUncertainty

BATCH = 9


def joints_of_all_kinds():
    builder = phipsi.SceneBuilder()
    builder.link("base")
    kinds = [
        ("revolute", (0, 0, 1)),
        ("prismatic", (0.6, 0, 0.8)),
        ("revolute", (0.48, 0.6, 0.64)),
        ("planar", (1, 0, 0)),
        ("spherical", None),
        ("continuous", (0, 1, 0)),
    ]
    rng = np.random.default_rng(5)
    for i, (kind, axis) in enumerate(kinds):
        com = rng.normal(size=3) * 0.1
        builder.link(f"l{i}", mass=1.0 + i, com=com, inertia=np.diag([0.1, 0.12, 0.15]) * (1 + i))
        parent = "base" if i == 0 else f"l{(i - 1) // 2}"
        more = {} if axis is None else {"axis": axis}
        builder.joint(f"j{i}", kind, parent, f"l{i}", xyz=rng.normal(size=3) * 0.4, rpy=rng.normal(size=3), **more)
    builder.link("tool", mass=0.5, com=(0.1, 0.0, 0.2), inertia=np.eye(3) * 0.01)
    builder.joint("weld", "fixed", "l5", "tool", xyz=(0.1, 0.2, 0.0), rpy=(0.3, 0.2, 0.1))
    return builder.build(gravity=(0.3, -0.2, -9.81))


SCENES = {
    "chain": lambda: phipsi.scenes.chain(7),
    "arm": lambda: phipsi.load(phipsi.BUNDLED_ARM),
    "floating": lambda: phipsi.load(phipsi.BUNDLED_ARM, floating_base=True),
    "all kinds": joints_of_all_kinds,
}


def population(scene, count, seed=0):
    """Physical inertias and armatures that differ between states: masses, centers and moments scaled and moved."""
    rng = np.random.default_rng(seed)
    inertias = np.repeat(np.array(scene.inertial_parameters)[None], count, axis=0)
    for state in inertias:
        for body in state:
            mass, moment, tensor = body[0] * rng.uniform(0.5, 2.0), body[1:4], np.zeros((3, 3))
            tensor[np.tril_indices(3)] = body[4:]
            tensor = tensor + np.tril(tensor, -1).T
            if not body[0]:
                continue
            com = moment / body[0]
            central = tensor - body[0] * (com @ com * np.eye(3) - np.outer(com, com))
            com = com + rng.normal(size=3) * 0.02
            tensor = central * rng.uniform(0.5, 2.0) + mass * (com @ com * np.eye(3) - np.outer(com, com))
            body[0], body[1:4], body[4:] = mass, mass * com, tensor[np.tril_indices(3)]
    return inertias, rng.uniform(0.0, 0.3, (count, scene.nv))


def one_scene(scene, inertias):
    """The scene with these inertias by its builder; links fixed to the links of body_names become massless."""
    changes = {name: (0.0, (0, 0, 0), np.zeros((3, 3))) for name in scene.link_names}
    for name, (mass, *moment, xx, xy, yy, xz, yz, zz) in zip(scene.body_names, inertias, strict=True):
        tensor, com = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), np.array(moment) / (mass or 1.0)
        changes[name] = (mass, com, tensor - mass * (com @ com * np.eye(3) - np.outer(com, com)))
    return scene.with_inertias(changes)


def of_links(scene, name):
    """Second moments of mass of a link and those fixed to it, (4, 4), in its frame, from the links and their poses."""
    poses, moments = scene.placements(scene.neutral()), np.zeros((4, 4))
    for link in scene.links.values():
        body = link.name
        while body is not None and body not in scene.body_names:
            body = scene.links[body].parent
        if body == name:
            place, own = np.linalg.solve(poses[name], poses[link.name]), np.zeros((4, 4))
            own[:3, :3] = 0.5 * np.trace(link.inertia) * np.eye(3) - link.inertia + link.mass * np.outer(link.com, link.com)
            own[:3, 3] = own[3, :3] = link.mass * np.asarray(link.com)
            own[3, 3] = link.mass
            moments += place @ own @ place.T
    return moments


@pytest.mark.parametrize("name", SCENES)
def test_inertial_parameters_are_the_moments_of_the_links(name):
    scene = SCENES[name]()
    for link, (mass, *moment, xx, xy, yy, xz, yz, zz) in zip(scene.body_names, scene.inertial_parameters, strict=True):
        expected = of_links(scene, link)
        tensor = np.trace(expected[:3, :3]) * np.eye(3) - expected[:3, :3]
        bound = tolerances.product(10, tolerances.size(expected))
        tolerances.assert_near([mass, *moment], [expected[3, 3], *expected[:3, 3]], bound)
        tolerances.assert_near([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], tensor, bound)


def states(scene, count, seed=1):
    rng = np.random.default_rng(seed)
    q = scene.integrate(scene.neutral(), rng.normal(size=(count, scene.nv)))
    return q, *rng.normal(size=(2, count, scene.nv))


def dense(scene, q, qd, inertias, armature):
    """The mass matrix and the bias by the regressor, which is linear in the parameters."""
    nv, still = scene.nv, np.zeros(scene.nv)

    def torque(qd, qdd):
        return np.tensordot(scene.regressor(q, qd, qdd), inertias, 2)

    weight = torque(still, still)
    columns = np.stack([torque(still, unit) - weight for unit in np.eye(nv)], axis=1)
    return columns + np.diag(armature), torque(qd, still)


@pytest.mark.parametrize("name", SCENES)
def test_torques_accelerations_and_mass_matrices_are_those_of_the_regressor(name):
    scene = SCENES[name]()
    inertias, armature = population(scene, BATCH)
    q, qd, tau = states(scene, BATCH)
    own = {"inertias": inertias, "armature": armature}
    mass, inverse = scene.mass_matrix(q, **own), scene.mass_matrix_inverse(q, **own)
    qdd, bias = scene.forward_dynamics(q, qd, tau, **own), scene.bias_torque(q, qd, **own)
    torque = scene.inverse_dynamics(q, qd, tau, **own)
    for i in range(BATCH):
        M, h = dense(scene, q[i], qd[i], inertias[i], armature[i])
        scale, condition = tolerances.size(M), np.linalg.cond(M)
        tolerances.assert_near(mass[i], M, tolerances.recursion(scene.nv, scale))
        tolerances.assert_near(bias[i], h, tolerances.recursion(scene.nv, tolerances.size(h, scale)))
        tolerances.assert_near(torque[i], M @ tau[i] + h, tolerances.recursion(scene.nv, tolerances.size(h, M @ tau[i])))
        tolerances.assert_near(inverse[i] @ M, np.eye(scene.nv), tolerances.inverse(condition, 10.0))
        expected = np.linalg.solve(M, tau[i] - h)
        tolerances.assert_near(qdd[i], expected, tolerances.inverse(condition, 10 * tolerances.size(expected)))
    assert np.abs(qdd - scene.forward_dynamics(q, qd, tau)).max() > 0.1


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize(
    "method",
    [
        "forward_dynamics",
        "inverse_dynamics",
        "mass_matrix",
        "mass_matrix_inverse",
        "bias_torque",
        "gravity_torque",
        "forward_dynamics_derivatives",
        "inverse_dynamics_derivatives",
        "coriolis_matrix",
        "mass_matrix_derivative",
        "linearize",
        "forward_dynamics_jvp",
        "forward_dynamics_vjp",
        "inverse_dynamics_jvp",
        "inverse_dynamics_vjp",
    ],
)
def test_every_function_of_a_batch_of_models_is_that_of_one_scene_per_model(name, method):
    scene = SCENES[name]()
    inertias, armature = population(scene, BATCH)
    q, qd, u = states(scene, BATCH)
    more = np.random.default_rng(3).normal(size=(3, BATCH, scene.nv))
    arguments = {
        "mass_matrix": [q],
        "mass_matrix_inverse": [q],
        "gravity_torque": [q],
        "bias_torque": [q, qd],
        "coriolis_matrix": [q, qd],
        "mass_matrix_derivative": [q, qd],
    }.get(method, [q, qd, u] + ([*more] if "jvp" in method else [more[0]] if "vjp" in method else []))
    found = getattr(scene, method)(*arguments, inertias=inertias)
    for i in range(BATCH):
        expected = getattr(one_scene(scene, inertias[i]), method)(*[argument[i] for argument in arguments])
        pairs = [(found[i], expected)] if isinstance(found, np.ndarray) else [(a[i], b) for a, b in zip(found, expected, strict=False) if a is not None]
        for one, other in pairs:
            tolerances.assert_near(one, other, 1e-9 * tolerances.size(other, 1.0))


#: Number of the arrays q, qd and qdd that each quantity reads.
QUANTITIES = {"energy": 2, "kinetic_energy": 2, "potential_energy": 1, "momentum": 2, **OF_MASS}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("method", QUANTITIES)
def test_every_quantity_of_a_batch_of_models_is_that_of_one_scene_per_model(name, method):
    scene = SCENES[name]()
    inertias, _ = population(scene, BATCH)
    arguments, quantity = states(scene, BATCH)[: QUANTITIES[method]], getattr(scene, method)
    found, bare = np.asarray(quantity(*arguments, inertias=inertias)), np.asarray(quantity(*arguments))
    found, bare = (of.T if method == "energy" else of for of in (found, bare))
    for i in range(BATCH):
        alone = [argument[i] for argument in arguments]
        expected = getattr(one_scene(scene, inertias[i]), method)(*alone)
        tolerances.assert_near(found[i], expected, tolerances.recursion(scene.nv, tolerances.size(expected)))
        tolerances.assert_same_bits(quantity(*alone, inertias=inertias[i]), found[i])
    assert np.abs(found - bare).max() > 1e-3 * np.abs(bare).max()
    tolerances.assert_same_bits(quantity(*arguments), getattr(SCENES[name](), method)(*arguments))


@pytest.mark.parametrize("name", SCENES)
def test_quantities_with_models_are_the_sums_over_the_links(name):
    scene = SCENES[name]()
    inertias, armature = population(scene, BATCH)
    q, qd, _ = states(scene, BATCH)
    kinetic, potential = scene.energy(q, qd, inertias=inertias, armature=armature)
    center, momentum = scene.center_of_mass(q, inertias=inertias), scene.momentum(q, qd, inertias=inertias)
    velocity, matrix = scene.center_of_mass_velocity(q, qd, inertias=inertias), scene.centroidal_momentum_matrix(q, inertias=inertias)
    for i in range(BATCH):
        mass = dense(scene, q[i], qd[i], inertias[i], armature[i])[0]
        bound = tolerances.recursion(scene.nv, tolerances.size(mass, qd[i]) ** 2)
        tolerances.assert_near(kinetic[i], qd[i] @ mass @ qd[i] / 2, bound)
        alone = scene.kinetic_energy(q[i], qd[i], inertias=inertias[i], armature=armature[i])
        tolerances.assert_same_bits(alone, kinetic[i])
        poses, linear, moment, angular = scene.placements(q[i]), np.zeros(3), np.zeros(3), np.zeros(3)
        for link, (m, *mc, xx, xy, yy, xz, yz, zz) in zip(scene.body_names, inertias[i], strict=True):
            tensor, (turn, place) = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), (poses[link][:3, :3], poses[link][:3, 3])
            spin, speed = np.split(scene.velocity(q[i], qd[i], link), 2)
            of_link = turn @ (m * speed + np.cross(spin, mc))
            moment += m * place + turn @ mc
            linear += of_link
            angular += turn @ (tensor @ spin + np.cross(mc, speed)) + np.cross(place, of_link)
        total = inertias[i, :, 0].sum()
        tolerances.assert_near(center[i], moment / total, bound)
        tolerances.assert_near(potential[i], -np.dot(scene.gravity, moment), bound)
        tolerances.assert_near(momentum[i], [*angular, *linear], bound)
        tolerances.assert_near(velocity[i], linear / total, bound)
        tolerances.assert_near(matrix[i] @ qd[i], [*(angular - np.cross(moment / total, linear)), *linear], bound)


def test_models_give_mass_to_a_scene_without_mass():
    builder = phipsi.SceneBuilder().link("base").link("arm").joint("turn", "revolute", "base", "arm", axis="z", armature=1.0)
    scene, point = builder.build(), np.array([[2.0, 1.0, 0, 0, 0, 0, 0.5, 0, 0, 0.5]])
    tolerances.assert_near(scene.center_of_mass([0.0], inertias=point), [0.5, 0, 0], tolerances.product(1, 1.0))
    with pytest.raises(ArgumentError, match="mass"):
        scene.center_of_mass([0.0], inertias=np.zeros((1, 10)))
    with pytest.warns(BadStateWarning, match="mass"):
        found = scene.center_of_mass([0.0], inertias=np.stack([point, 0.0 * point]), errors="nan")
    tolerances.assert_near(found[0], [0.5, 0, 0], tolerances.product(1, 1.0))
    assert np.isnan(found[1]).all()


@pytest.mark.parametrize(
    ("own", "error", "match"),
    [
        ({"inertias": np.zeros((2, 10))}, ShapeError, "inertias"),
        ({"inertias": np.zeros((2, 3, 9))}, ShapeError, "inertias"),
        ({"inertias": np.full((3, 10), np.nan)}, NotFiniteError, "inertias"),
        ({"inertias": np.full((3, 10), -1.0)}, ArgumentError, "link0"),
        ({"inertias": np.zeros((4, 3, 10))}, ShapeError, "inertias"),
        ({"armature": np.zeros((2, 4))}, ShapeError, "armature"),
        ({"armature": [0.1, -0.1, 0.1]}, ArgumentError, "j1"),
        ({"armature": np.nan}, NotFiniteError, "armature"),
    ],
)
def test_what_is_wrong_in_a_model_of_a_quantity_is_named(own, error, match):
    scene = phipsi.scenes.chain(3)
    q, qd, _ = states(scene, 2)
    with pytest.raises(error, match=match):
        scene.energy(q, qd, **own)


def test_armature_of_states_adds_the_kinetic_energy_of_the_rotors():
    scene = phipsi.scenes.chain(4).with_properties(armature=0.3)
    q, qd, _ = states(scene, BATCH)
    armature = population(scene, BATCH)[1]
    found, bare = scene.kinetic_energy(q, qd, armature=armature), scene.kinetic_energy(q, qd)
    expected = bare + ((armature - 0.3) * qd**2).sum(axis=-1) / 2
    tolerances.assert_near(found, expected, tolerances.recursion(4, tolerances.size(expected)))
    inertias = scene.inertial_parameters
    again = scene.kinetic_energy(q, qd, inertias=inertias)
    tolerances.assert_near(again, bare, tolerances.recursion(4, tolerances.size(bare)))
    tolerances.assert_same_bits(scene.energy(q, qd, armature=armature).kinetic, found)


def test_armature_is_no_argument_of_quantities_without_it():
    with pytest.raises(TypeError, match="armature"):
        phipsi.scenes.chain(3).momentum(np.zeros(3), np.zeros(3), armature=1.0)


def test_one_armature_for_all_states_and_one_inertia_for_all_states_broadcast():
    scene = phipsi.scenes.chain(5)
    inertias, armature = population(scene, BATCH)
    q, qd, tau = states(scene, BATCH)
    found = scene.forward_dynamics(q, qd, tau, armature=0.2)
    expected = scene.with_properties(armature=0.2).forward_dynamics(q, qd, tau)
    tolerances.assert_near(found, expected, tolerances.recursion(50, tolerances.size(expected)))
    found = scene.forward_dynamics(q, qd, tau, inertias=inertias[0])
    expected = one_scene(scene, inertias[0]).forward_dynamics(q, qd, tau)
    tolerances.assert_near(found, expected, 1e-9 * tolerances.size(expected))
    many = scene.forward_dynamics(q[0], qd[0], tau[0], inertias=inertias, armature=armature)
    assert many.shape == (BATCH, 5) and np.ptp(many, axis=0).min() > 1e-3
    again = scene.forward_dynamics(q, qd, tau)
    tolerances.assert_same_bits(again, phipsi.scenes.chain(5).forward_dynamics(q, qd, tau))


def test_armature_of_some_states_only_counts_in_these():
    scene = phipsi.scenes.chain(4)
    q, qd, tau = states(scene, BATCH)
    armature = np.zeros((BATCH, 4))
    armature[::3, 1] = 0.5
    found, bare = scene.forward_dynamics(q, qd, tau, armature=armature), scene.forward_dynamics(q, qd, tau)
    heavy = scene.with_properties(armature={"j1": 0.5}).forward_dynamics(q, qd, tau)
    expected = np.where(armature[:, 1:2] > 0.0, heavy, bare)
    tolerances.assert_near(found, expected, tolerances.recursion(50, tolerances.size(expected)))


def test_states_with_the_inertias_of_the_scene_have_the_results_of_the_scene():
    for make in SCENES.values():
        scene = make()
        q, qd, tau = states(scene, BATCH)
        own = {"inertias": scene.inertial_parameters}
        found, expected = scene.forward_dynamics(q, qd, tau, **own), scene.forward_dynamics(q, qd, tau)
        tolerances.assert_near(found, expected, 1e-10 * tolerances.size(expected))
        same = scene.with_inertial_parameters(scene.inertial_parameters)
        tolerances.assert_near(same.inertial_parameters, scene.inertial_parameters, tolerances.product(10, 1.0))
        assert same.total_mass == pytest.approx(scene.inertial_parameters[:, 0].sum(), rel=1e-12)


def test_constrained_dynamics_with_models_and_square_root_form():
    loop = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
    inertias, armature = population(loop, BATCH)
    q, qd, tau = states(loop, BATCH)
    closed = loop.loops.project(q, qd)
    found = loop.loops.dynamics(closed.q, closed.qd, tau, inertias=inertias, armature=armature)
    for i in range(BATCH):
        own = one_scene(loop, inertias[i]).with_properties(armature=armature[i])
        expected = own.loops.dynamics(closed.q[i], closed.qd[i], tau[i])
        tolerances.assert_near(found.qdd[i], expected.qdd, 1e-9 * tolerances.size(expected.qdd))
        tolerances.assert_near(found.forces["gear"][i], expected.forces["gear"], 1e-9 * tolerances.size(expected.forces["gear"]))
    tree = phipsi.scenes.chain(3)
    by_roots = tree.forward_dynamics(q, qd, tau, form="square-root", inertias=inertias, armature=armature)
    by_covariances = tree.forward_dynamics(q, qd, tau, form="covariance", inertias=inertias, armature=armature)
    tolerances.assert_near(by_roots, by_covariances, 1e-9 * tolerances.size(by_roots))


def arm_with(**properties):
    return phipsi.scenes.chain(4).with_properties(**properties)


PATHS = {
    "free": lambda: arm_with(),
    "damped springs": lambda: arm_with(damping=0.3, stiffness=4.0),
    "friction": lambda: arm_with(friction=0.2, damping=0.1),
    "stops": lambda: phipsi.load(phipsi.BUNDLED_ARM),
    "loop": lambda: phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build(),
    "ground": lambda: phipsi.scenes.chain(3).to_builder().contact("tip", "link2", friction=0.5, xyz=(0, 0, 0.3), offset=-0.6).build(),
}


@pytest.mark.parametrize("name", PATHS)
def test_a_simulated_population_is_one_simulation_per_model(name):
    scene = PATHS[name]()
    count, rng = 5, np.random.default_rng(7)
    inertias, armature = population(scene, count)
    q, qd, tau = states(scene, count)
    q, qd = 0.2 * q, 0.5 * qd
    if name == "loop":
        q, qd = scene.loops.project(q, qd)[:2]
    own = {
        "inertias": inertias,
        "armature": armature,
        "damping": scene.damping * rng.uniform(0.5, 2.0, (count, scene.nv)),
        "stiffness": scene.stiffness * rng.uniform(0.5, 2.0, (count, scene.nv)),
        "friction": scene.friction * rng.uniform(0.0, 2.0, (count, scene.nv)),
    }
    run = {"dt": 2e-3, "steps": 100, "method": "auto" if name == "ground" else "rosenbrock-2"}
    path = scene.simulate(q, qd, tau=tau, **run, **own)
    mover = scene.simulator(q, qd, **{k: v for k, v in run.items() if k != "steps"}, **own)
    mover.step(tau, steps=100)
    tolerances.assert_same_bits(mover.q, path.q[:, -1])
    audit = path.energy_audit()
    for i in range(count):
        member = one_scene(scene, inertias[i])
        alone = {key: value[i] for key, value in own.items() if key != "inertias"}
        one = member.simulate(q[i], qd[i], tau=tau[i], **run, **alone)
        tolerances.assert_near(path.q[i], one.q, 1e-7)
        tolerances.assert_near(path.energy().total[i] - path.energy().total[i, 0], one.energy().total - one.energy().total[0], 1e-6)
        assert audit.remainder[i] == pytest.approx(one.energy_audit().remainder, abs=1e-6)
    assert np.ptp(path.q[:, -1] - path.q[:, 0], axis=0).max() > 0.05


def of_gear(found):
    return found.tau, found.forces["gear"]


#: Tasks of inverse kinematics, and options by which results depend on the metric.
REACH, BALANCE = phipsi.tasks.Position("flange", (0.3, 0.2, 0.4)), phipsi.tasks.CenterOfMass((0.1, 0.1, 0.1))
STEPS = {"iterations": 3, "starts": 1, "limits": False}

#: Functions that compute one state after another: a scene, and the results for q and six arrays of rates.
ONE_AFTER_ANOTHER = {
    "inverse hvp": ("free", lambda scene, q, v, inertias, armature: scene.inverse_dynamics_hvp(q, *v, inertias=inertias)[:3]),
    "forward hvp": ("free", lambda scene, q, v, **own: scene.forward_dynamics_hvp(q, *v, **own)[:3]),
    "hvp of a loop": ("loop", lambda scene, q, v, **own: scene.forward_dynamics_hvp(q, *v, form="covariance", **own)[:3]),
    "inverse inertia": ("stops", lambda scene, q, v, **own: [scene.operational_inverse_inertia(q, ["flange", "link3"], **own)]),
    "inertia": ("stops", lambda scene, q, v, **own: [scene.operational_inertia(q, "flange", directions=np.eye(6)[3:], **own)]),
    "gram": ("ground", lambda scene, q, v, **own: [scene.contacts.gram(q, **own)]),
    "inverse of a loop": ("loop", lambda scene, q, v, **own: [scene.loops.mass_matrix_inverse(q, **own)]),
    "torques of a loop": ("loop", lambda scene, q, v, **own: of_gear(scene.loops.inverse_dynamics(q, v[0], v[1], actuated=["j0", "j1"], **own))),
    "estimate": ("free", lambda scene, q, v, **own: scene.estimate(q, *v[:2], noise=0.1, covariance=True, **own)),
    "projection": ("loop", lambda scene, q, v, **own: scene.loops.project(q + 0.05 * v[2], v[3], **own)[:2]),
    "inverse kinematics": ("stops", lambda scene, q, v, **own: [scene.inverse_kinematics(REACH, q, metric="mass", **STEPS, **own).q]),
    "center of mass": ("stops", lambda scene, q, v, **own: [scene.inverse_kinematics(BALANCE, q, **STEPS, **own).q]),
    "rates": ("stops", lambda scene, q, v, inertias, armature: [scene.inverse_kinematics_rates(BALANCE, q, dt=0.1, inertias=inertias)]),
    "dense estimate": ("free", lambda scene, q, v, **own: scene.estimate(q, *v[:2], noise=0.1, method="batch", **own)[:3]),
}


@pytest.mark.parametrize("name", ONE_AFTER_ANOTHER)
def test_functions_of_one_state_after_another_with_models_are_those_of_one_scene_per_model(name):
    of, function = ONE_AFTER_ANOTHER[name]
    scene = PATHS[of]()
    inertias, armature = population(scene, BATCH)
    q, *v = states(scene, BATCH)
    v += [*np.random.default_rng(4).normal(size=(4, BATCH, scene.nv))]
    if of == "loop":
        q, v[0] = scene.loops.project(q, v[0])[:2]
        v[1] = scene.loops.project(q, v[1]).qd if name == "torques of a loop" else v[1]
    found, bare = function(scene, q, v, inertias=inertias, armature=armature), function(scene, q, v, inertias=None, armature=None)
    for i in range(BATCH):
        alone, own = (q[i], [rates[i] for rates in v]), {"inertias": inertias[i], "armature": armature[i]}
        one = one_scene(scene, inertias[i]).with_properties(armature=armature[i])
        expected, again = function(one, *alone, inertias=None, armature=None), function(scene, *alone, **own)
        for of_all, of_scene, of_state in zip(found, expected, again, strict=True):
            tolerances.assert_near(of_all[i], of_scene, 1e-9 * tolerances.size(of_scene))
            tolerances.assert_same_bits(of_state, of_all[i])
    assert max(np.abs(one - other).max() for one, other in zip(found, bare, strict=True)) > 1e-3
    again = function(scene, q[0], [rates[0] for rates in v], inertias=inertias, armature=armature)
    assert again[0].shape == found[0].shape


def test_the_operational_inertia_of_models_is_that_of_their_mass_matrices():
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    inertias, armature = population(scene, BATCH)
    q = states(scene, BATCH)[0]
    found = scene.operational_inverse_inertia(q, "flange", inertias=inertias, armature=armature)
    for i in range(BATCH):
        mass, J = dense(scene, q[i], np.zeros(6), inertias[i], armature[i])[0], scene.jacobian(q[i], "flange")
        tolerances.assert_near(found[i], J @ np.linalg.solve(mass, J.T), tolerances.inverse(np.linalg.cond(mass), tolerances.size(found[i])))


@pytest.mark.parametrize(
    ("own", "error", "match"),
    [
        ({"inertias": np.zeros((2, 10))}, ShapeError, "inertias"),
        ({"inertias": np.full((3, 10), np.nan)}, NotFiniteError, "inertias"),
        ({"inertias": np.full((3, 10), -1.0)}, ArgumentError, "link0"),
        ({"armature": [0.1, -0.1, 0.1]}, ArgumentError, "j1"),
        ({"armature": np.zeros((2, 4))}, ShapeError, "armature"),
    ],
)
def test_what_is_wrong_in_a_model_of_one_state_is_named(own, error, match):
    scene = phipsi.scenes.chain(3)
    q = states(scene, 2)[0]
    with pytest.raises(error, match=match):
        scene.operational_inverse_inertia(q, "link2", **own)


def test_a_model_that_is_wrong_makes_its_state_invalid_alone():
    scene = phipsi.scenes.chain(3)
    q, inertias = states(scene, 3)[0], np.repeat(np.array(scene.inertial_parameters)[None], 3, axis=0)
    inertias[1, 2, 0] = -1.0
    with pytest.warns(BadStateWarning, match="link2"):
        found = scene.operational_inverse_inertia(q, "link2", inertias=inertias, errors="nan")
    expected = scene.operational_inverse_inertia(q, "link2")
    assert np.isnan(found[1]).all()
    tolerances.assert_near(found[::2], expected[::2], 1e-9 * tolerances.size(expected))


@pytest.mark.parametrize("name", ["free", "friction", "loop"])
def test_gradients_of_a_simulated_population_are_those_of_each_model(name):
    scene, count = PATHS[name](), 3
    inertias, armature = population(scene, count)
    q, qd, tau = states(scene, count)
    q, qd = 0.2 * q, 0.5 * qd
    if name == "loop":
        q, qd = scene.loops.project(q, qd)[:2]
    run = {"dt": 2e-3, "steps": 30, "method": "rosenbrock-2"}
    path = scene.simulate(q, qd, tau=tau, inertias=inertias, armature=armature, **run)
    weight = np.zeros_like(path.q)
    weight[:, -1] = 1.0
    found = path.vjp(weight, parameters=True)
    for i in range(count):
        one = one_scene(scene, inertias[i]).simulate(q[i], qd[i], tau=tau[i], armature=armature[i], **run).vjp(weight[i], parameters=True)
        for field in ("q", "qd", "tau", "armature", "parameters"):
            expected = getattr(one, field)
            tolerances.assert_near(getattr(found, field)[i], expected, 1e-6 * tolerances.size(expected))
    assert np.abs(found.parameters).max() > 1e-4


def test_a_population_in_a_file_and_a_pickle(tmp_path):
    import pickle

    scene = phipsi.scenes.chain(3)
    inertias, armature = population(scene, 4)
    q, qd, _ = states(scene, 4)
    path = scene.simulate(q, qd, dt=1e-3, steps=20, inertias=inertias, armature=armature)
    mover = scene.simulator(q, qd, dt=1e-3, inertias=inertias, armature=armature)
    mover.step(steps=10)
    again = pickle.loads(pickle.dumps(mover))
    again.step(steps=10)
    mover.step(steps=10)
    tolerances.assert_same_bits(again.q, mover.q)
    tolerances.assert_near(path.error_estimate(), np.zeros((4, 21)), 1e-3)
    file = tmp_path / "population.npz"
    path.save(file)
    loaded = phipsi.Trajectory.load(file, scene)
    tolerances.assert_same_bits(loaded.inertias, inertias)
    tolerances.assert_same_bits(loaded.energy().total, path.energy().total)
    tolerances.assert_same_bits(loaded.vjp(path.q, parameters=True).parameters, path.vjp(path.q, parameters=True).parameters)
    expected = scene.energy(path.q, path.qd, inertias=inertias[:, None], armature=armature[:, None])
    tolerances.assert_near(path.energy().kinetic, expected.kinetic, tolerances.recursion(3, tolerances.size(expected.kinetic)))


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("way", ["wrenches", "target"])
@pytest.mark.filterwarnings("ignore::phipsi.errors.LimitWarning")
def test_what_a_call_of_a_simulator_changes_acts_on_every_model(name, way):
    import pickle

    scene, count, rng = PATHS[name](), 3, np.random.default_rng(4)
    inertias, _ = population(scene, count)
    q, qd, tau = (0.2 * of for of in states(scene, count))
    if name == "loop":
        q, qd = scene.loops.project(q, qd)[:2]
    given = {
        "wrenches": {"wrenches": {scene.link_names[-1]: rng.normal(size=(count, 6))}, "frame": "world"},
        "target": {"target": rng.normal(size=(count, scene.nq)), "target_rate": rng.normal(size=(count, scene.nv))},
    }[way]
    # The method is chosen by the scene of all, or by that of one.
    law, how = phipsi.PD(3.0, 0.3, scene.neutral()) if way == "target" else None, {"dt": 2e-3, "method": "rosenbrock-2"}
    mover = scene.simulator(q, qd, pd=law, inertias=inertias, **how)
    mover.step(tau, steps=10)
    mover = pickle.loads(pickle.dumps(mover))
    mover.step(tau, steps=20, **given)
    for i in range(count):
        one = scene.with_inertial_parameters(inertias[i]).simulator(q[i], qd[i], pd=law, **how)
        one.step(tau[i], steps=10)
        before = one.q
        one.step(tau[i], steps=20, **{key: {link: of[i] for link, of in value.items()} if key == "wrenches" else value if key == "frame" else value[i] for key, value in given.items()})
        tolerances.assert_near(mover.q[i], one.q, 1e-9)
        assert np.abs(one.q - before).max() > 1e-3


@pytest.mark.parametrize("own", ["inertias", "damping"])
def test_exact_friction_holds_every_model_with_a_contact_out_of_reach(own):
    builder = phipsi.SceneBuilder().link("base").link("rod", 1.0, (0, 0, -0.5)).joint("hinge", "revolute", "base", "rod", axis="y", friction=2.0)
    scene = builder.contact("far", "rod", friction=0.5, xyz=(0, 0, -1), offset=-100.0).build()
    models = {"inertias": scene.inertial_parameters * [[[0.9]], [[1.1]]], "damping": [[0.0], [0.1]]}[own]
    path = scene.simulate([0.3], [0.0], dt=1e-3, steps=300, **{own: models})
    tolerances.assert_same_bits(path.q, np.full((2, 301, 1), 0.3))
    moving = scene.simulate([0.3], [2.0], dt=1e-3, steps=300, **{own: models})
    tree = scene.without_contacts().simulate([0.3], [2.0], dt=1e-3, steps=300, **{own: models})
    tolerances.assert_same_bits(moving.q, tree.q)


def test_the_trajectory_of_a_population_that_stopped_has_its_energies():
    scene = phipsi.scenes.chain(3)
    inertias, _ = population(scene, 2)
    mover = scene.simulator(np.full((2, 3), 0.3), np.zeros(3), dt=1e-2, inertias=inertias)
    with pytest.raises(SimulationError) as stopped:
        mover.step(np.full((2, 3), 1e200), steps=10)
    path = stopped.value.trajectory
    expected = scene.potential_energy(path.q, inertias=inertias[:, None])
    tolerances.assert_same_bits(path.energy().potential, expected)
    assert np.abs(expected - scene.potential_energy(path.q)).max() > 0.1


def test_what_is_wrong_names_the_link_and_the_joint():
    scene = phipsi.scenes.chain(3)
    q, qd, tau = states(scene, 2)
    inertias = np.repeat(np.array(scene.inertial_parameters)[None], 2, axis=0)
    bad = inertias.copy()
    bad[1, 2, 0] = -1.0
    with pytest.raises(ArgumentError, match="link2"):
        scene.forward_dynamics(q, qd, tau, inertias=bad)
    with pytest.raises(ArgumentError, match="link2"):
        scene.simulate(q, qd, dt=1e-3, steps=1, inertias=bad)
    bad[1, 2, 0] = np.nan
    with pytest.raises(NotFiniteError, match="inertias"):
        scene.mass_matrix(q, inertias=bad)
    with pytest.raises(ShapeError, match="inertias"):
        scene.mass_matrix(q, inertias=inertias[:, :2])
    with pytest.raises(ArgumentError, match="j1"):
        scene.mass_matrix(q, armature=[0.1, -0.1, 0.1])
    with pytest.raises(ShapeError, match="armature"):
        scene.mass_matrix(q, armature=np.zeros((2, 4)))
    with pytest.raises(ArgumentError, match="link2"):
        scene.with_inertial_parameters(np.where(np.isnan(bad[1]), -1.0, bad[1]))
    with pytest.warns(BadStateWarning):
        found = scene.forward_dynamics(q, qd, tau, inertias=bad, errors="nan")
    assert np.isnan(found[1]).all() and np.isfinite(found[0]).all()


def fingers(right=0.4):
    """An arm with two fingers; the second follows the first, and the last link follows the first joint."""
    builder = phipsi.SceneBuilder().link("base")
    bodies = [("upper", "base", 1.0, None), ("lower", "upper", 0.7, None), ("left", "lower", 0.3, None), ("right", "lower", right, ("left", -1.3)), ("tip", "right", 0.2, ("upper", 0.5))]
    for i, (name, parent, mass, follows) in enumerate(bodies):
        mimic = {"mimic": follows[0], "mimic_multiplier": follows[1], "mimic_offset": 0.1} if follows else {}
        builder.link(name, mass, (0.05, 0.02, 0.2), mass * np.diag([0.02, 0.03, 0.01]))
        builder.joint(name, "revolute", parent, name, xyz=(0.1, 0.0, 0.3), axis=(0.3 * i, 1.0, 0.2), armature=0.05, **mimic)
    return builder.build(mimic="couple")


def reduced(scene, inertias, armature):
    """The scene of one state: `armature` at the independent joints and none at those which follow."""
    follows = {name: 0.0 for name, joint in scene.joints.items() if joint.mimic is not None}
    builder = scene.with_inertial_parameters(inertias).to_builder()
    assert set(follows) == {"right", "tip"}
    free = builder.build(mimic="free").with_properties(armature={**follows, **dict(zip(scene.joint_names, armature))})
    return free.to_builder().build(mimic="couple")


@pytest.mark.filterwarnings("ignore::phipsi.errors.MimicWarning")
@pytest.mark.parametrize("form", ["auto", "square-root"])
def test_mimic_joints_with_models_are_scenes_of_these(form):
    scene = fingers()
    inertias, _ = population(scene, BATCH)
    rng = np.random.default_rng(2)
    armature = rng.uniform(0.0, 0.5, (BATCH, scene.nv))
    q, qd, u, c = rng.uniform(-1.0, 1.0, (4, BATCH, scene.nv))
    own = {"inertias": inertias, "armature": armature}
    calls = {
        "forward_dynamics": (q, qd, u), "inverse_dynamics": (q, qd, u), "mass_matrix": (q,), "mass_matrix_inverse": (q,),
        "forward_dynamics_derivatives": (q, qd, u), "forward_dynamics_vjp": (q, qd, u, c), "forward_dynamics_jvp": (q, qd, u, c, u, q),
        "inverse_dynamics_vjp": (q, qd, u, c),
    }  # fmt: skip
    for name, given in calls.items():
        more = {"form": form} if name.startswith("forward") or name == "mass_matrix_inverse" else {}
        found = getattr(scene, name)(*given, **own, **more)
        parts = found[:3] if isinstance(found, tuple) else [found]
        for i in range(BATCH):
            alone = reduced(scene, inertias[i], armature[i])
            tolerances.assert_near(alone.armature, armature[i], 1e-15)
            expected = getattr(alone, name)(*(x[i] for x in given), **more)
            condition = np.linalg.cond(alone.mass_matrix(q[i]))
            for part, of in zip(parts, expected[:3] if isinstance(expected, tuple) else [expected], strict=True):
                tolerances.assert_near(part[i], of, tolerances.inverse(condition, tolerances.size(of)))


@pytest.mark.parametrize("armature", [0.0, 0.3])
def test_models_of_mimic_joints_without_mass(armature):
    """A follower without mass and armature has no pivot of its own: it gets armature of the joint that it follows."""
    scene = fingers(right=0.0)
    inertias = np.array(scene.inertial_parameters)
    inertias[scene.body_names.index("tip")] = 0.0
    light = scene.with_inertial_parameters(inertias)
    q, qd, tau = np.random.default_rng(3).uniform(-1.0, 1.0, (3, 5, scene.nv))
    # In the second scene, torques act at the right finger, which has 2^-20 of the inertia in this state.
    for of, own, lost in ((light, {}, 1), (scene, {"inertias": inertias}, 2**20)):
        m = of.mass_matrix(q, armature=armature, **own)
        expected = np.linalg.solve(m, (tau - of.bias_torque(q, qd, **own))[..., None])[..., 0]
        found = of.forward_dynamics(q, qd, tau, armature=armature, **own)
        bound = tolerances.inverse(np.max(np.linalg.cond(m)), tolerances.size(expected))
        tolerances.assert_near(found, expected, lost * bound)


def test_what_is_wrong_with_models_of_mimic_joints_names_the_joint():
    scene = fingers()
    q = np.zeros(scene.nv)
    with pytest.raises(ArgumentError, match="-0.1 for joint \"left\""):
        scene.forward_dynamics(q, q, q, armature=[0.1, 0.1, -0.1])
    with pytest.raises(ShapeError, match="armature"):
        scene.mass_matrix(q, armature=np.zeros(5))
    inertias = np.array(scene.inertial_parameters)
    inertias[scene.body_names.index("tip"), 0] = -1.0
    with pytest.raises(ArgumentError, match="tip"):
        scene.forward_dynamics_vjp(q, q, q, q, inertias=inertias)


def test_quantities_of_mimic_joints_with_models_are_those_of_scenes():
    scene = phipsi.SceneBuilder().link("a").link("b", 1.0).link("c", 1.0).joint("one", "revolute", "a", "b", axis=(1, 0, 0))
    scene = scene.joint("two", "revolute", "b", "c", axis=(1, 0, 0), xyz=(0, 0, 1), mimic="one").build(mimic="couple")
    q, qd, inertias = [0.1], [0.4], np.stack([scale * scene.inertial_parameters for scale in (1.0, 2.0, 3.0)])
    for method, arguments in {"energy": [q, qd], "center_of_mass_jacobian": [q], "momentum": [q, qd]}.items():
        found = np.asarray(getattr(scene, method)(*arguments, inertias=inertias))
        expected = [getattr(scene.with_inertial_parameters(own), method)(*arguments) for own in inertias]
        tolerances.assert_near(found, np.stack(expected, axis=-1 if method == "energy" else 0), tolerances.product(3, tolerances.size(found)))
    # Of the independent joint.
    added = scene.kinetic_energy(q, qd, armature=0.1) - scene.kinetic_energy(q, qd)
    tolerances.assert_near(added, 0.05 * 0.4**2, tolerances.product(3, tolerances.size(scene.kinetic_energy(q, qd))))


def sliding(friction=0.5, restitution=0.2, shape=True):
    """A block on a floor: by a collider, or by four named points."""
    builder = phipsi.SceneBuilder().link("block", 1.0, inertia=0.01 * np.eye(3))
    if shape:
        builder.collider("floor", phipsi.shapes.HalfSpace(), friction=0.0)
        builder.collider("box", phipsi.shapes.Box((0.2, 0.2, 0.2)), link="block", friction=friction, restitution=restitution)
    else:
        for i, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)]):
            builder.contact(f"p{i}", "block", xyz=(0.1 * x, 0.1 * y, -0.1), friction=friction, restitution=restitution)
    return builder.build(floating_base=True)


@pytest.mark.parametrize("shape", [True, False])
def test_contacts_of_each_state_have_its_friction_and_restitution(shape):
    scene, count = sliding(shape=shape), 4
    width = 2 if shape else 4
    friction, restitution = np.array([0.0, 0.2, 0.5, 1.0]), np.array([0.0, 0.3, 0.0, 0.6])
    each = {"contact_friction": np.repeat(friction[:, None], width, axis=1), "contact_restitution": np.repeat(restitution[:, None], width, axis=1)}
    if shape:
        each["contact_friction"][:, 0] = 0.0
        each["contact_restitution"][:, 0] = 0.0
    start, speed = np.array([0, 0, 0.12, 0, 0, 0, 1.0]), np.array([1.0, 0, 0, 0, 0, 0])
    run = {"dt": 2e-3, "steps": 150}
    path = scene.simulate(start, speed, **run, **each)
    for i in range(count):
        one = sliding(friction[i], restitution[i], shape).simulate(start, speed, **run)
        tolerances.assert_near(path.q[i], one.q, 1e-9)
    assert path.q[0, -1, 0] - path.q[3, -1, 0] > 0.05 and np.ptp(path.q[:, :, 2].max(axis=1)) >= 0.0
    mover = scene.simulator(np.repeat(start[None], count, axis=0), speed, dt=2e-3, **each)
    mover.step(steps=150)
    tolerances.assert_same_bits(mover.q, path.q[:, -1])
    same = scene.simulate(start, speed, contact_friction=0.5, contact_restitution=0.2, **run)
    if not shape:
        tolerances.assert_near(same.q, scene.simulate(start, speed, **run).q, 1e-9)


def test_smoothed_contacts_of_a_population_carry_the_weight_of_each_model():
    scene, count, run = sliding(restitution=0.0, shape=False), 4, {"dt": 2e-3, "smoothing": 1e-3}
    inertias, _ = population(scene, count)
    friction, weight = np.repeat([[0.1], [0.3], [0.5], [1.0]], 4, axis=1), np.random.default_rng(2).normal(size=6)
    start, speed = np.array([0, 0, 0.1005, 0, 0, 0, 1.0]), np.array([0.3, 0, 0, 0, 0, 0])
    path = scene.simulate(start, speed, steps=20, inertias=inertias, contact_friction=friction, **run)
    cotangents = np.zeros((21, 6))
    cotangents[-1] = weight
    found = path.vjp(cotangents, parameters=True)
    for i in range(count):
        member = one_scene(sliding(friction[i, 0], 0.0, shape=False), inertias[i])
        one = member.simulate(start, speed, steps=20, **run)
        tolerances.assert_near(path.q[i], one.q, 1e-9)
        expected = one.vjp(cotangents, parameters=True)
        for field in ("q", "qd", "parameters"):
            of = getattr(expected, field)
            tolerances.assert_near(getattr(found, field)[i], of, 1e-6 * tolerances.size(of))
    inertias[:, :, 1:4] = 0.0
    rest = scene.simulate(start, np.zeros(6), steps=600, record_every=600, inertias=inertias, **run)
    tolerances.assert_near(scene.contacts.gaps(rest.q[:, -1]), np.full((count, 4), 1e-3), 1e-5)
    with pytest.raises(ArgumentError, match="restitution 0.2 in state 1"):
        scene.simulate(start, speed, steps=1, contact_restitution=np.repeat([[0.0], [0.2]], 4, axis=1), **run)


def test_coefficients_of_contacts_are_checked():
    scene = sliding(shape=False)
    start, still = scene.neutral(), np.zeros(6)
    with pytest.raises(SceneError, match="p0"):
        scene.simulate(start, still, dt=1e-3, steps=1, contact_friction=-1.0)
    with pytest.raises(ShapeError, match="contact_friction"):
        scene.simulate(start, still, dt=1e-3, steps=1, contact_friction=[0.1, 0.2])
    with pytest.raises(ArgumentError, match="contact_restitution"):
        phipsi.scenes.chain(2).simulate([0, 0], [0, 0], dt=1e-3, steps=1, contact_restitution=0.1)


#: Functions with one model for all states.
OF_ONE_MODEL = {
    "factor": lambda scene, q, own: scene.factor(q, **own),
    "random_model": lambda scene, q, own: scene.random_model(q, **own),
    "ode": lambda scene, q, own: scene.ode(**own),
    "optimize": lambda scene, q, own: scene.optimize(q, dt=0.01, steps=2, costs=[], **own),
    "observer": lambda scene, q, own: scene.observer(1e-3, [], q=q, torque_noise=0.1, **own),
    "momentum_observer": lambda scene, q, own: scene.momentum_observer(1e-3, torque_noise=0.1, bandwidth=1.0, **own),
    "identify": lambda scene, q, own: scene.identify(q, q, q, q, **own),
    "excitation": lambda scene, q, own: scene.excitation(1.0, **own),
}


@pytest.mark.parametrize("name", OF_ONE_MODEL)
def test_functions_of_one_model_name_the_scene_of_a_model(name):
    scene = phipsi.scenes.chain(3)
    for own, instead in (({"inertias": scene.inertial_parameters}, "with_inertial_parameters"), ({"armature": 0.1}, "with_properties")):
        (keyword,) = own
        with pytest.raises(TypeError, match=rf"Scene.{name}\(\) got an unexpected keyword argument '{keyword}'; .* scene.{instead}\({keyword}"):
            OF_ONE_MODEL[name](scene, np.zeros(3), own)


def spread(scene):
    """Covariance of the inertial parameters: each body is heavier by 1 %, independently of the others."""
    return 1e-4 * np.einsum("bi,bj->bij", scene.inertial_parameters, scene.inertial_parameters)


#: Further cases of bands: a scene, and arguments of states that differ in more than bodies and joints.
BANDS = PATHS | {"mimic": lambda: fingers(), "sliding": lambda: sliding(shape=False), "smooth": lambda: sliding(restitution=0.0, shape=False)}


@pytest.mark.parametrize("name", BANDS)
@pytest.mark.filterwarnings("ignore::phipsi.errors.UncertaintyWarning", "ignore::phipsi.errors.MimicWarning", "ignore::phipsi.errors.LimitWarning")
def test_bands_of_a_population_are_those_of_each_model(name):
    scene, count, rng = BANDS[name](), 3, np.random.default_rng(9)
    inertias, armature = population(scene, count)
    q, qd, tau = states(scene, count)
    q, qd = 0.2 * q, 0.5 * qd
    run = {"dt": 2e-3, "steps": 12, "method": "rosenbrock-2", "friction_speed": 0.1}
    own = {"armature": 0.05 + armature, "damping": rng.uniform(0.1, 0.5, (count, scene.nv)), "friction": rng.uniform(0.1, 0.5, (count, scene.nv))}
    joints = {"armature": 1e-6, "damping": 1e-4, "offset": 1e-4}
    if name == "loop":
        q, qd = scene.loops.project(q, qd)[:2]
    elif name == "stops":
        run["limits"] = "report"
    elif name == "ground":
        run = {"dt": 2e-3, "steps": 6, "friction_speed": 0.1}
    elif name in ("sliding", "smooth"):
        q, qd = np.tile([0, 0, 0.1, 0, 0, 0, 1.0], (count, 1)), np.tile([1.0, 0.1, 0, 0, 0, 0.2], (count, 1))
        run, tau, joints = {"dt": 2e-3, "steps": 6, "record_every": 2}, 0.01 * tau, {"offset": 1e-6}
        own = {"contact_friction": np.repeat([[0.2], [0.3], [0.0]], 4, axis=1)}
        if name == "smooth":
            run["smoothing"] = 1e-3
    # Errors of the height and the tilt of a block change the modes of its contacts.
    free = np.isin(np.arange(2 * scene.nv) % scene.nv, (0, 1, 5)) if scene.nq > scene.nv else 1.0
    unsure = {
        "parameters": spread(scene),
        "initial": 1e-10 * rng.uniform(1.0, 2.0, 2 * scene.nv) * free,
        "joints": joints,
    }
    for more in ({"torque_noise": 1e-6}, {"check": "unscented"}):
        uncertainty = MotionUncertainty(**unsure, **more)
        path = scene.simulate(q, qd, tau=tau, inertias=inertias, covariance=uncertainty, **run, **own)
        for i in range(count):
            alone = {key: value[i] for key, value in own.items()}
            one = scene.with_inertial_parameters(inertias[i]).simulate(q[i], qd[i], tau=tau[i], covariance=uncertainty, **run, **alone)
            tolerances.assert_near(path.q[i], one.q, 1e-9)
            expected = one.bands.covariance
            tolerances.assert_near(path.bands.covariance[i], expected, 1e-6 * tolerances.size(expected))
            if "check" in more:
                sampled = one.bands.ratio[1:] * np.diagonal(expected[1:], axis1=-2, axis2=-1)
                found = path.bands.ratio[i, 1:] * np.diagonal(path.bands.covariance[i, 1:], axis1=-2, axis2=-1)
                tolerances.assert_near(np.nan_to_num(found), np.nan_to_num(sampled), 1e-5 * tolerances.size(expected))
    assert np.ptp(path.bands.qd[:, -1], axis=0).max() > 1e-2 * path.bands.qd.max()


def test_bands_of_one_model_that_is_not_that_of_the_scene():
    scene = phipsi.scenes.chain(3)
    inertias, armature = population(scene, 1)
    q, qd, _ = states(scene, 2)
    run, unsure = {"dt": 1e-3, "steps": 5}, MotionUncertainty(parameters=spread(scene))
    found = scene.simulate(q, qd, inertias=inertias[0], armature=armature[0], covariance=unsure, **run).bands
    expected = one_scene(scene, inertias[0]).simulate(q, qd, armature=armature[0], covariance=unsure, **run).bands
    tolerances.assert_near(found.covariance, expected.covariance, 1e-9 * tolerances.size(expected.covariance))


def correlated(scene, count=3):
    root = np.random.default_rng(8).normal(size=(10 * len(scene.body_names), count))
    return 1e-4 * root @ root.T


#: Scenes with uncertain parameters: of independent bodies, of correlated ones, with rows by dense matrices.
UNSURE = {
    **{name: (make, spread) for name, make in SCENES.items()},
    "correlated": (SCENES["chain"], correlated),
    "loop": (PATHS["loop"], correlated),
    "mimic": (lambda: fingers(), spread),
}


@pytest.mark.parametrize("name", UNSURE)
@pytest.mark.filterwarnings("ignore::phipsi.errors.MimicWarning")
def test_variances_with_models_are_those_of_one_scene_per_model(name):
    make, uncertain = UNSURE[name]
    scene = make()
    inertias, armature = population(scene, BATCH)
    armature[::4, -1] = 0.0
    for joint in scene.joint_names:
        armature[:, scene.v_index(joint)] = armature[:, scene.v_index(joint)][:, -1:]
    q, qd, u = states(scene, BATCH)
    if name == "loop":
        q, qd = scene.loops.project(q, qd)[:2]
    wrenches = {scene.link_names[-1]: np.random.default_rng(6).normal(size=(BATCH, 6))}
    given = {"parameters": uncertain(scene), "torque": 0.1, "joints": {"armature": 1e-4, "friction": 0.1}}
    more, own = {"links": scene.body_names[-2:]}, {"inertias": inertias, "armature": armature}
    forward = scene.forward_dynamics_variance(q, qd, u, wrenches=wrenches, **given, **more, **own)
    inverse = scene.inverse_dynamics_variance(q, qd, u, **given, **own)
    for i in range(BATCH):
        if name == "mimic":
            one = reduced(scene, inertias[i], armature[i])
        else:
            one = scene.with_inertial_parameters(inertias[i]).with_properties(armature=armature[i])
        condition = np.linalg.cond(one.mass_matrix(q[i]))
        expected = one.forward_dynamics_variance(q[i], qd[i], u[i], wrenches={link: of[i] for link, of in wrenches.items()}, **given, **more)
        tolerances.assert_near(forward.joints[i], expected.joints, tolerances.inverse(condition, 10 * tolerances.size(expected.joints)))
        for link, of_link in expected.links.items():
            tolerances.assert_near(forward.links[link][i], of_link, tolerances.inverse(condition, 10 * tolerances.size(of_link)))
        of_torques = one.inverse_dynamics_variance(q[i], qd[i], u[i], **given)
        tolerances.assert_near(inverse[i], of_torques, tolerances.recursion(scene.nv, tolerances.size(of_torques)))
    assert np.abs(forward.joints - scene.forward_dynamics_variance(q, qd, u, **given)).max() > 1e-3 * forward.joints.max()
    many = scene.forward_dynamics_variance(q[0], qd[0], u[0], **given, **own)
    assert many.shape == (BATCH, scene.nv)
    assert scene.inverse_dynamics_variance(q[0], qd[0], u[0], **given, **own).shape == (BATCH, scene.nv)


def test_a_model_that_is_wrong_makes_the_variance_of_its_state_invalid_alone():
    scene = phipsi.scenes.chain(3)
    (q, qd, tau), inertias = states(scene, 5), np.repeat(np.array(scene.inertial_parameters)[None], 5, axis=0)
    inertias[1, 2, 0] = -1.0
    for variance in (scene.forward_dynamics_variance, scene.inverse_dynamics_variance):
        with pytest.raises(ArgumentError, match="link2"):
            variance(q, qd, tau, torque=0.1, inertias=inertias)
        with pytest.warns(BadStateWarning, match="link2"):
            found = variance(q, qd, tau, torque=0.1, inertias=inertias, errors="nan")
        expected = variance(q, qd, tau, torque=0.1)
        assert np.isnan(found[1]).all()
        tolerances.assert_near(found[[0, 2, 3, 4]], expected[[0, 2, 3, 4]], 1e-9 * tolerances.size(expected))
        with pytest.raises(ShapeError, match="armature"):
            variance(q, qd, tau, armature=np.zeros((2, 4)))
