"""The same MJCF model in phipsi and in MuJoCo: motions, contact impulses and times per step."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import mujoco
import numpy as np
import phipsi
import phipsi.mujoco
from in_turns import least
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Softness(NamedTuple):
    """Parameters of MuJoCo's contacts and of its solver."""

    name: str
    solref: tuple[float, float] | None
    """None: MuJoCo's default."""
    solimp: tuple[float, float, float, float, float] | None
    impratio: float
    iterations: int
    tolerance: float


DEFAULT = Softness("default", None, None, 1.0, 100, 1e-8)


def hard(dt: float) -> Softness:
    """The shortest time constant that MuJoCo allows, nearly rigid: solref twice the step, solimp up to 0.9999."""
    return Softness("hard", (2 * dt, 1.0), (0.99, 0.9999, 1e-4, 0.5, 2.0), 100.0, 300, 1e-12)


def elastic(dt: float) -> Softness:
    """Without damping, and with a contact of ten steps: the nearest to a restitution of 1."""
    return Softness("elastic", (-((np.pi / (10 * dt)) ** 2), 0.0), (0.9999, 0.9999, 1e-4, 0.5, 2.0), 100.0, 300, 1e-12)


@dataclass(frozen=True)
class Scenario:
    """A model and the motion to simulate, in the coordinates of MuJoCo."""

    name: str
    spec: mujoco.MjSpec
    qpos: Array
    qvel: Array
    duration: float
    force: Array | None = None
    """Generalized forces of MuJoCo, (nv,) or (steps, nv) for the step `dt`."""
    scene: phipsi.Scene | None = None
    """The scene of phipsi, if it differs from the model: MuJoCo has no coefficient of restitution."""
    options: dict[str, object] = field(default_factory=dict)
    """Further arguments of simulate."""
    batch: int = 1
    """Number of states of the scene that phipsi simulates in place of one model with all bodies."""


class Motion(NamedTuple):
    """A simulated motion in phipsi's coordinates, and impulses and velocities of contacts in all steps."""

    q: Array
    qd: Array
    gaps: Array
    """(rows, contacts), m."""
    pushes: Array
    """Contacts with an impulse, (n, 7): impulse and velocity (normal, two tangents) at the end of a step, friction."""
    root: Array
    """Sum of the contact impulses on all bodies, (steps, 3), N s."""


class Law(NamedTuple):
    signorini: float
    """Largest |normal impulse x normal velocity|, J."""
    dissipation: float
    """Largest mu p_n |v_t| + p_t v_t, J: what friction could dissipate in addition."""


def law(motion: Motion) -> Law:
    if not len(motion.pushes):
        return Law(0.0, 0.0)
    p, v, mu = motion.pushes[:, :3], motion.pushes[:, 3:6], motion.pushes[:, 6]
    power = mu * p[:, 0] * np.linalg.norm(v[:, 1:], axis=1) + np.sum(p[:, 1:] * v[:, 1:], axis=1)
    return Law(float(np.max(np.abs(p[:, 0] * v[:, 0]))), float(np.max(np.abs(power))))


def compiled(scenario: Scenario, dt: float, softness: Softness, integrator: str = "EULER") -> mujoco.MjModel:
    spec = scenario.spec.copy()
    spec.option.timestep, spec.option.cone, spec.option.impratio = dt, mujoco.mjtCone.mjCONE_ELLIPTIC, softness.impratio
    spec.option.iterations, spec.option.tolerance = softness.iterations, softness.tolerance
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    for geom in spec.geoms:
        if softness.solref:
            geom.solref, geom.solimp = softness.solref, softness.solimp
    model = spec.compile()
    model.jnt_limited[:] = False
    return model


def scene_of(scenario: Scenario) -> phipsi.Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", phipsi.errors.ModelWarning)
        scene = phipsi.Scene.from_mujoco(scenario.spec.copy().compile(), contacts="plane")
    if scenario.scene is None or scenario.batch > 1:
        return scenario.scene or scene
    q = start(scenario, scene)[0]
    assert np.allclose(scenario.scene.mass_matrix(q), scene.mass_matrix(q), rtol=1e-12, atol=1e-12)
    # Contacts with planes come first; pairs of balls are those of MuJoCo's collision detection.
    floor, *balls = scene.collider_names
    planes = scene.distances(q, pairs=[(floor, ball) for ball in balls]).distance
    assert np.allclose(scenario.scene.contacts.gaps(q)[: len(planes)], planes, rtol=1e-12, atol=1e-12)
    return scenario.scene


def gaps_of(scene: phipsi.Scene, q: Array) -> Array:
    """Signed distances of contacts, or of shapes that overlap (infinite for others), (rows, contacts or pairs), m."""
    if scene.contacts.names or not scene._touching():
        return scene.contacts.gaps(q)
    return scene.distances(q, limit=0.0).distance


def start(scenario: Scenario, scene: phipsi.Scene) -> tuple[Array, Array]:
    if scenario.batch == 1:
        return phipsi.mujoco.to_state(scene, scenario.qpos, scenario.qvel)
    return phipsi.mujoco.to_state(scene, scenario.qpos.reshape(scenario.batch, -1), scenario.qvel.reshape(scenario.batch, -1))


def forces(scenario: Scenario, scene: phipsi.Scene, steps: int) -> dict[str, Array]:
    """Arguments of simulate for the forces, on bodies that do not rotate: phipsi's act along the axes of the body."""
    if scenario.force is None:
        return {}
    given = np.broadcast_to(scenario.force, (steps, scene.nv)) if scenario.force.ndim == 1 else scenario.force
    return {"tau_steps": np.ascontiguousarray(given)}


def free_joints(scene: phipsi.Scene) -> list[int]:
    spans = [scene.v_index(name).indices(scene.nv) for name in scene.joint_names]
    return [first for first, last, _ in spans if last - first == 6]


def turned(vectors: Array, by: Array) -> Array:
    """Vectors rotated by rotation vectors, (..., 3)."""
    angle = np.linalg.norm(by, axis=-1, keepdims=True)
    once = np.cross(by, vectors)
    return vectors + np.sinc(angle / np.pi) * once + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * np.cross(by, once)


def own(scenario: Scenario, scene: phipsi.Scene, dt: float) -> Motion:
    steps = round(scenario.duration / dt)
    path = scene.simulate(*start(scenario, scene), dt=dt, steps=steps, limits="report", **forces(scenario, scene, steps), **scenario.options)
    if path.contacts is None:
        return Motion(path.q, path.qd, np.zeros((steps + 1, 0)), np.zeros((0, 7)), np.zeros((steps, 3)))
    end, moved = path.qd[1:].copy(), scene.difference(path.q[:-1], path.q[1:])
    for i in free_joints(scene):
        # In the axes at the start of the step.
        end[:, i : i + 3] = turned(end[:, i : i + 3], moved[:, i + 3 : i + 6])
    if scene.collider_names:
        pushes, root = of_shapes(scene, path, end)
        return Motion(path.q, path.qd, gaps_of(scene, path.q), pushes, root)
    velocity = scene.contacts.velocities(path.q[:-1], end)
    velocity[..., 2] += np.maximum(scene.contacts.gaps(path.q[:-1]), 0.0) / dt
    held = np.stack([path.contacts.force[name][1:] * dt for name in scene.contacts.names], axis=1)
    struck = np.stack([path.contacts.impulse[name][1:] for name in scene.contacts.names], axis=1)
    friction = np.array([contact[6] for contact in scene._contacts()])
    near = held[..., 2] > 0
    order = [2, 0, 1]
    pushes = np.concatenate([held[near][:, order], velocity[near][:, order], np.broadcast_to(friction, near.shape)[near][:, None]], axis=1)
    return Motion(path.q, path.qd, gaps_of(scene, path.q), pushes, np.sum(held + struck, axis=1))


def of_shapes(scene: phipsi.Scene, path: phipsi.Trajectory, end: Array) -> tuple[Array, Array]:
    """Impulses of shapes on the floor, which is the first collider, as in Motion; end: velocities at the end of steps in
    the axes at their start, (steps, nv).
    """
    assert path.contacts is not None
    of, before = path.contacts.shapes, path.contacts.shapes.row - 1
    colliders = {index: (link, frame, solid[0]) for index, (_, link, frame, solid, *_) in enumerate(scene._collisions()[0])}
    friction = {names[1]: value for names, value, *_ in scene._touching()}
    pushes, root = np.zeros((len(of.row), 7)), np.zeros((path.steps, 3))
    np.add.at(root, before, -(of.force * path.dt + of.impulse))
    for body in np.unique(of.pair[:, 1]):
        which = np.flatnonzero(of.pair[:, 1] == body)
        (link, (_, center), kind), step, row = colliders[body], before[which], of.row[which]
        places = scene.placement(path.q, link)
        turn, origin = places[..., :3, :3], places[..., :3, 3]
        # Fixed to the body: the center of a sphere, or a corner.
        local = np.einsum("kji,kj->ki", turn[row], of.point[which] - origin[row])
        if kind == "sphere":
            local[:] = center
        first, last = (np.einsum("kij,kj->ki", turn[at], local) + origin[at] for at in (step, row))
        arm = of.point[which] - last + first - origin[step]
        twist = scene.velocity(path.q[step], end[step], link, frame="local-world-aligned")
        normal = -of.normal[which]
        gap = of.gap[which] - np.sum(normal * (last - first), axis=1)
        velocity = twist[:, 3:] + np.cross(twist[:, :3], arm) + np.maximum(gap, 0.0)[:, None] / path.dt * normal
        # The floor is horizontal.
        pushes[which, :3], pushes[which, 3:6] = -path.dt * of.force[which][:, [2, 0, 1]], velocity[:, [2, 0, 1]]
        pushes[which, 6] = friction[scene.collider_names[body]]
    return pushes[pushes[:, 0] > 0], root


def theirs(scenario: Scenario, scene: phipsi.Scene, dt: float, softness: Softness, integrator: str = "EULER") -> Motion:
    model = compiled(scenario, dt, softness, integrator)
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    data, steps = mujoco.MjData(model), round(scenario.duration / dt)
    data.qpos[:], data.qvel[:] = scenario.qpos, scenario.qvel
    qpos, qvel = np.empty((steps + 1, model.nq)), np.empty((steps + 1, model.nv))
    qpos[0], qvel[0] = data.qpos, data.qvel
    pushes, root = [np.zeros((0, 7))], np.zeros((steps, 3))
    for step in range(steps):
        if scenario.force is not None:
            data.qfrc_applied[:] = scenario.force if scenario.force.ndim == 1 else scenario.force[step]
        mujoco.mj_step(model, data)
        qpos[step + 1], qvel[step + 1] = data.qpos, data.qvel
        first = data.contact.efc_address[: data.ncon]
        dims = data.contact.dim[: data.ncon]
        live = first >= 0
        if not live.any():
            continue
        # Rows of a contact: normal and, with friction, two tangents.
        jacobian = data.efc_J.reshape(-1, model.nv)
        push = np.zeros((int(live.sum()), 7))
        for k, contact in enumerate(np.flatnonzero(live)):
            rows = slice(first[contact], first[contact] + dims[contact])
            push[k, : dims[contact]], push[k, 3 : 3 + dims[contact]] = data.efc_force[rows] * dt, jacobian[rows] @ data.qvel
            push[k, 6] = data.contact.friction[contact, 0] if dims[contact] > 1 else 0.0
            root[step] += data.contact.frame[contact].reshape(3, 3).T @ push[k, :3]
        pushes.append(push[push[:, 0] > 0])
    q, qd = phipsi.mujoco.to_state(scene, qpos, qvel)
    return Motion(q, qd, gaps_of(scene, q), np.concatenate(pushes), root)


def times(scenario: Scenario, scene: phipsi.Scene, dt: float, softness: tuple[Softness, ...], steps: int, turns: int) -> list[float]:
    """Time of one step of phipsi, then of MuJoCo with each softness, us: all steps in one call, from the same start."""
    constant = scenario if scenario.force is None or scenario.force.ndim == 1 else replace(scenario, force=scenario.force[0])
    at, more = start(constant, scene), forces(constant, scene, steps)

    def ours() -> object:
        return scene.simulate(*at, dt=dt, steps=steps, record_every=steps, limits="report", **more, **scenario.options)

    calls = [ours]
    for each in softness:
        model = compiled(constant, dt, each)
        data = mujoco.MjData(model)

        def run(model: mujoco.MjModel = model, data: mujoco.MjData = data) -> None:
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = constant.qpos, constant.qvel
            data.qfrc_applied[:] = 0.0 if constant.force is None else constant.force
            mujoco.mj_step(model, data, nstep=steps)

        calls.append(run)
    return [1e6 * seconds / steps for seconds in least(turns, *calls)]
