"""Steps of closed loops compared with those of the tree, of a standing quadruped and of shapes that touch compared with
MuJoCo, and gradients compared with their simulation, in one run.

Usage: python benches/loops_and_contacts.py [--markdown FILE]; `make loops-and-contacts`.

Loops: solo12 with its feet connected to the ground, and the same robot without these connections. Contacts: solo12 on
spheres at its feet with springs and damping in its joints, at rest and pushed. Both programs have the same bodies,
joints, springs, damping, spheres and plane; steps follow each other, so that each solve starts from the previous one.
Alone is one state and many steps per call, in batches is many states on one thread. Times are the minimum of several
interleaved timings.

The residual of the contact law is computed here for both programs from the velocities at the end of a step and the
impulses in it (function `residual`): the largest violation of 0 <= u_n + gap/h, p_n >= 0, u_n p_n = 0 and Coulomb
friction, relative to the largest velocity of a contact without impulses.
"""

import argparse
import os
import warnings
from collections.abc import Callable
from pathlib import Path

import mujoco
import mujoco.rollout
import numpy as np
import phipsi
import phipsi.mujoco
from in_turns import least, write
from robots import load

ROBOT, FEET = "solo_description/robots/solo12.urdf", ["FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"]
#: Steps of one state and of each state of a batch.
DT, STEPS, IN_BATCHES, STATES, TURNS = 1e-3, 200, 50, 64, 9
RADIUS, FRICTION, STIFFNESS, DAMPING = 0.016, 0.6, 30.0, 0.5
#: Edges of a brick, and the distance of bricks beside each other, m.
BRICK, APART = (0.2, 0.1, 0.06), 1e-3
#: Tolerances of MuJoCo's solver.
TOLERANCES = [1e-8, 1e-10, 1e-14]


def legs(scene: phipsi.Scene) -> np.ndarray:
    """A configuration with bent legs."""
    q = scene.neutral()
    for joint in scene.joint_names:
        sign = 1.0 if joint.startswith("F") else -1.0
        angle = {"HFE": 0.8, "KFE": -1.6}.get(joint[-3:])
        if angle is not None:
            q[scene.q_index(joint)] = sign * angle
    return q


def connected(states: int | None = None) -> tuple[phipsi.Scene, tuple[np.ndarray, np.ndarray]]:
    """The robot with its feet connected to the ground, and states of it."""
    builder = load(ROBOT, floating_base=True).to_builder()
    for foot in FEET:
        builder.connect(foot, "point", foot)
    loops = builder.build()
    random, shape = np.random.default_rng(0), (loops.nv,) if states is None else (states, loops.nv)
    q = loops.integrate(loops.neutral(), random.uniform(-0.05, 0.05, shape))
    found = loops.loops.project(q, random.uniform(-0.2, 0.2, shape))
    return loops, (found.q, found.qd)


def in_loops(lines: list[str]) -> None:
    tree = load(ROBOT, floating_base=True)
    loops, (q, qd) = connected(STATES)

    def run(scene: phipsi.Scene, method: str, states: slice | int, steps: int) -> Callable[[], object]:
        return lambda: scene.simulate(q[states], qd[states], dt=DT, steps=steps, record_every=steps, method=method, limits="report")

    for method in ("rk4", "rosenbrock-2"):
        kinds = [(0, STEPS), (slice(None), IN_BATCHES)]
        calls = [run(scene, method, states, 1 + more) for scene in (tree, loops) for states, steps in kinds for more in (0, steps)]
        times = least(TURNS, *calls)
        one, many, one_loops, many_loops = (1e6 * (times[i + 1] - times[i]) for i in (0, 2, 4, 6))
        one, one_loops = one / STEPS, one_loops / STEPS
        many, many_loops = many / IN_BATCHES / STATES, many_loops / IN_BATCHES / STATES
        path = loops.simulate(q[0], qd[0], dt=DT, steps=1000, record_every=1000, method=method, limits="report")
        error = np.abs(loops.loops.error(path.q[-1])).max()
        lines.append(f"| solo12 on four points, {method} | {one:.1f} | {one_loops:.1f} | {one_loops / one:.1f} | {many:.2f} | {many_loops:.2f} | {many_loops / many:.1f} | {error:.0e} |")
        print(lines[-1], flush=True)


def standing() -> tuple[phipsi.Scene, np.ndarray]:
    tree = load(ROBOT, floating_base=True)
    builder = tree.to_builder()
    for foot in FEET:
        builder.contact(f"{foot}_ground", foot, friction=FRICTION, radius=RADIUS)
    scene = builder.build()
    scene = scene.with_properties(armature=np.zeros(scene.nv))
    q = legs(scene)
    q[2] -= scene.contacts.gaps(q).min()
    return scene, q


def gains(scene: phipsi.Scene, target: np.ndarray) -> tuple[np.ndarray, ...]:
    """Joints with springs and dampers toward the target."""
    of_joints = np.zeros((2, scene.nv))
    of_joints[:, 6:] = [[STIFFNESS], [DAMPING]]
    return of_joints[0], of_joints[1], target


def simulator(scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray, target: np.ndarray) -> phipsi.Simulator:
    return scene.simulator(q, qd, dt=DT, pd=gains(scene, target))


def theirs(scene: phipsi.Scene, q: np.ndarray, tolerance: float) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The same robot in MuJoCo: contacts between the feet and the plane only, elliptic cones, Newton's method."""
    spec = mujoco.MjSpec.from_string(scene.without_contacts().to_urdf())
    for geom in list(spec.geoms):
        spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    spec.body("base_link").add_freejoint()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 1], friction=[FRICTION, 0, 0], condim=3)
    for foot in FEET:
        spec.body(foot).add_geom(name=foot, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0], mass=0.0, friction=[FRICTION, 0, 0], condim=3)
    spec.option.timestep, spec.option.tolerance = DT, tolerance
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model = spec.compile()
    model.jnt_stiffness[1:], model.dof_damping[6:], model.dof_armature[:] = STIFFNESS, DAMPING, 0.0
    model.qpos_spring[:] = phipsi.mujoco.from_state(scene, q)[0]
    # Only contacts of a sphere with the plane.
    model.geom_contype[:], model.geom_conaffinity[:] = 1, 0
    model.geom_conaffinity[0] = 1
    return model, mujoco.MjData(model)


def residual(scene: phipsi.Scene, q: np.ndarray, after: np.ndarray, impulses: np.ndarray) -> float:
    """|F| / r of Alart and Curnier, the largest of a contact, relative to the largest velocity without impulses."""
    jacobian = scene.contacts.velocities(np.broadcast_to(q, (scene.nv, len(q))), np.eye(scene.nv)).reshape(scene.nv, -1).T
    delassus = jacobian @ scene.mass_matrix_inverse(q) @ jacobian.T
    gap = np.maximum(scene.contacts.gaps(q), 0.0)
    u, p, worst = jacobian @ after, impulses.ravel(), 0.0
    scale = np.abs(u - delassus @ p).max()
    for i in range(len(gap)):
        own = slice(3 * i, 3 * i + 3)
        r = 3.0 / np.trace(delassus[own, own])
        x = p[own] - r * (u[own] + [0, 0, gap[i] / DT])
        normal = max(x[2], 0.0)
        length = np.hypot(*x[:2])
        tangent = x[:2] * (min(FRICTION * normal / length, 1.0) if length > 0 else 1.0)
        worst = max(worst, float(np.linalg.norm(p[own] - [*tangent, normal])) / r / scale)
    return worst


def on_the_ground(lines: list[str]) -> None:
    scene, q = standing()
    rest = simulator(scene, q, np.zeros(scene.nv), q)
    rest.step(steps=3000)
    random = np.random.default_rng(1)
    push = np.zeros((STATES, scene.nv))
    push[:, :2] = random.uniform(-0.6, 0.6, (STATES, 2))
    push[:, 6:] = random.uniform(-0.5, 0.5, (STATES, scene.nv - 6))
    cases = {
        "standing at rest": (np.repeat(rest.q[None], STATES, 0), np.repeat(rest.qd[None], STATES, 0)),
        "pushed": (np.repeat(rest.q[None], STATES, 0), push),
    }
    for name, (q0, qd0) in cases.items():
        one, batch = (simulator(scene, *start, q) for start in ((q0[0], qd0[0]), (q0, qd0)))

        def alone(steps: int, one: phipsi.Simulator = one, start: tuple[np.ndarray, np.ndarray] = (q0[0], qd0[0])) -> None:
            one.reset(*start)
            one.step(steps=steps)

        def together(steps: int, batch: phipsi.Simulator = batch, start: tuple[np.ndarray, np.ndarray] = (q0, qd0)) -> None:
            batch.reset(*start)
            batch.step(steps=steps)

        calls = [lambda: alone(1), lambda: alone(1 + STEPS), lambda: together(1), lambda: together(1 + IN_BATCHES)]
        others = []
        for tolerance in TOLERANCES:
            model, data = theirs(scene, q, tolerance)
            states = np.array([np.r_[0.0, np.concatenate(phipsi.mujoco.from_state(scene, a, b))] for a, b in zip(q0, qd0, strict=True)])
            warm = settled(model, data, states[0]) if name == "standing at rest" else states[0]
            starts = np.repeat(warm[None], STATES, 0) if name == "standing at rest" else states
            others.append((model, data, starts))
            calls += [
                lambda model=model, data=data, start=starts[0]: their_steps(model, data, start, 1),
                lambda model=model, data=data, start=starts[0]: their_steps(model, data, start, 1 + STEPS),
                lambda model=model, data=data, starts=starts: mujoco.rollout.rollout(model, data, starts, nstep=1),
                lambda model=model, data=data, starts=starts: mujoco.rollout.rollout(model, data, starts, nstep=1 + IN_BATCHES),
            ]
        times = least(TURNS, *calls)
        per_step = [1e6 * (times[i + 1] - times[i]) / STEPS for i in range(0, len(times), 4)]
        in_batch = [1e6 * (times[i + 3] - times[i + 2]) / IN_BATCHES / STATES for i in range(0, len(times), 4)]
        own = [own_residual(scene, (q0[i], qd0[i]), q) for i in range(8)]
        lines.append(f"| {name} | phipsi, 1e-10 | {per_step[0]:.1f} | {in_batch[0]:.1f} | {max(own):.0e} | {float(np.max(batch.contacts.residual)):.0e} |")
        print(lines[-1], flush=True)
        for (model, data, starts), tolerance, one, many in zip(others, TOLERANCES, per_step[1:], in_batch[1:], strict=True):
            found = [their_residual(scene, model, data, starts[i]) for i in range(8)]
            law, gradient = np.max(found, axis=0)
            lines.append(f"| {name} | MuJoCo {mujoco.__version__}, {tolerance:.0e} | {one:.1f} | {many:.1f} | {law:.0e} | {gradient:.0e} |")
            print(lines[-1], flush=True)


def their_steps(model: mujoco.MjModel, data: mujoco.MjData, start: np.ndarray, steps: int) -> None:
    mujoco.mj_resetData(model, data)
    data.qpos[:], data.qvel[:] = start[1 : 1 + model.nq], start[1 + model.nq :]
    mujoco.mj_step(model, data, nstep=steps)


def settled(model: mujoco.MjModel, data: mujoco.MjData, start: np.ndarray) -> np.ndarray:
    """MuJoCo's own rest, at which its feet are below the plane."""
    their_steps(model, data, start, 3000)
    return np.r_[0.0, data.qpos, data.qvel]


def own_residual(scene: phipsi.Scene, start: tuple[np.ndarray, np.ndarray], target: np.ndarray, steps: int = 20) -> float:
    """The largest residual of a few steps. The velocities at the end are in the axes at the end, and the law holds in
    those at the start."""
    one, worst = simulator(scene, *start, target), 0.0
    for _ in range(steps):
        before = one.q.copy()
        one.step()
        after = one.qd.copy()
        after[:3] = scene.placement(before, "base_link")[:3, :3].T @ scene.placement(one.q, "base_link")[:3, :3] @ after[:3]
        impulses = DT * np.array([one.contacts.force[name] for name in scene.contacts.names])
        worst = max(worst, residual(scene, before, after, impulses))
    return worst


def their_residual(scene: phipsi.Scene, model: mujoco.MjModel, data: mujoco.MjData, start: np.ndarray, steps: int = 20) -> tuple[float, float]:
    """The residual of the law at MuJoCo's forces and velocities, and the gradient of its own problem."""
    their_steps(model, data, start, 1)
    worst, gradient, force = 0.0, 0.0, np.zeros(6)
    for _ in range(steps):
        q, _ = phipsi.mujoco.to_state(scene, data.qpos, data.qvel)
        mujoco.mj_step1(model, data)
        mujoco.mj_step2(model, data)
        impulses = np.zeros((len(FEET), 3))
        for i in range(data.ncon):
            mujoco.mj_contactForce(model, data, i, force)
            contact = data.contact[i]
            foot = FEET.index(model.geom(contact.geom2).name)
            # The force on the second geom in the axes of the contact, whose first one is the normal.
            impulses[foot] = DT * (contact.frame.reshape(3, 3).T @ force[:3])
        _, after = phipsi.mujoco.to_state(scene, phipsi.mujoco.from_state(scene, q)[0], data.qvel)
        worst = max(worst, residual(scene, q, after, impulses))
        if data.solver_niter[0] > 0:
            gradient = max(gradient, float(data.solver[data.solver_niter[0] - 1].gradient))
    return worst, gradient


def bricks(rows: int, columns: int) -> tuple[phipsi.Scene, np.ndarray, mujoco.MjModel]:
    """A tower or a wall of bricks with half bricks at its ends, in both programs, and a configuration."""
    builder = phipsi.SceneBuilder().link("world").collider("ground", phipsi.shapes.HalfSpace())
    spec, q = mujoco.MjSpec(), []
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 1], condim=3)
    for row in range(rows):
        halved = columns > 1 and row % 2 == 1
        for column in range(columns + 1 if halved else columns):
            size = np.array([BRICK[0] / 2 if halved and column in (0, columns) else BRICK[0], *BRICK[1:]])
            x = column * (BRICK[0] + APART) - (BRICK[0] / 2 if halved else 0.0)
            x += {0: BRICK[0] / 4, columns: -BRICK[0] / 4}.get(column, 0.0) if halved else 0.0
            at, name, mass = [x, 0.0, BRICK[2] * (row + 0.5)], f"brick{len(q)}", size[0] / BRICK[0]
            builder.link(name, mass=mass, shape=phipsi.shapes.Box(size), collide=True).joint(f"of_{name}", "floating", "world", name)
            body = spec.worldbody.add_body(name=name, pos=at)
            body.add_freejoint()
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size / 2, mass=mass, condim=3)
            q.append([*at, 0, 0, 0, 1])
    return builder.build(), np.concatenate(q), compiled(spec)


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    spec.option.timestep, spec.option.cone, spec.option.tolerance = DT, mujoco.mjtCone.mjCONE_ELLIPTIC, TOLERANCES[0]
    return spec.compile()


def prism(corners: int) -> tuple[phipsi.Scene, np.ndarray, mujoco.MjModel]:
    """A prism on a face with many corners."""
    angles = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    points = [[0.1 * np.cos(angle), 0.1 * np.sin(angle), z] for angle in angles for z in (-0.05, 0.05)]
    builder = phipsi.SceneBuilder().link("world").collider("ground", phipsi.shapes.HalfSpace())
    builder.link("prism", mass=1.0, inertia=np.diag([3e-3, 3e-3, 5e-3])).joint("free", "floating", "world", "prism")
    builder.collider("prism", phipsi.shapes.Hull(points), link="prism")
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 1], condim=3)
    spec.add_mesh(name="prism", uservert=np.ravel(points))
    body = spec.worldbody.add_body(pos=[0, 0, 0.05])
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="prism", mass=1.0, condim=3)
    return builder.build(), np.array([0, 0, 0.05, 0, 0, 0, 1.0]), compiled(spec)


def shapes(lines: list[str]) -> None:
    cases = {"one brick": bricks(1, 1), "tower of 10": bricks(10, 1), "tower of 30": bricks(30, 1), "wall of 105": bricks(10, 10), "prism on a face of 2,000 corners": prism(2000)}
    for name, (scene, q, model) in cases.items():
        steps = 3 if scene.nv > 200 else 100
        path = scene.simulate(q, np.zeros(scene.nv), dt=DT, steps=steps)
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, nstep=1000)
        rest = np.r_[0.0, data.qpos, data.qvel]
        calls = [lambda more=more: scene.simulate(q, np.zeros(scene.nv), dt=DT, steps=1 + more, record_every=1 + more) for more in (0, steps)]
        calls += [lambda more=more: their_steps(model, data, rest, 1 + more) for more in (0, 100)]
        times = least(TURNS if steps > 3 else 2, *calls)
        own, other = 1e6 * (times[1] - times[0]) / steps, 1e6 * (times[3] - times[2]) / 100
        touching = path.contacts.shapes
        count = int((touching.row == steps).sum())
        lines.append(f"| {name} | {count} | {own:.0f} | {data.ncon} | {other:.0f} | {own / other:.1f} | {float(path.contacts.residual):.0e} |")
        print(lines[-1], flush=True)


def gradients(lines: list[str]) -> None:
    """Gradients of 200 steps of one state by everything that acts in them, with inertial parameters."""
    quadruped, q = standing()
    block = phipsi.SceneBuilder().link("block", 0.5, inertia=np.diag([1e-3, 2e-3, 2.5e-3]))
    for i, (x, y) in enumerate([(-0.1, -0.05), (0.1, -0.05), (-0.1, 0.05), (0.1, 0.05)]):
        block.contact(f"corner{i}", "block", xyz=(x, y, -0.03), friction=0.3)
    free = block.build(floating_base=True)
    push = np.zeros(quadruped.nv)
    push[:2] = [0.3, -0.2]
    loops, on_points = connected()
    cases = {
        "block that slides on four corners": (free, np.array([0, 0, 0.03, 0, 0, 0, 1.0]), np.array([1.5, 0.2, 0, 0, 0, 2.0]), {}),
        "solo12 on its feet, pushed": (quadruped, q, push, {"pd": gains(quadruped, q)}),
        "solo12 on four points, rk4": (loops, *on_points, {"method": "rk4", "limits": "report"}),
    }
    for name, (scene, q0, qd0, more) in cases.items():
        keywords = {"dt": DT, "steps": STEPS, **more}
        path = scene.simulate(q0, qd0, **keywords)
        by_q = np.zeros((STEPS + 1, scene.nv))
        by_q[-1] = 1.0
        calls = [lambda: scene.simulate(q0, qd0, **keywords), lambda: path.vjp(by_q), lambda: path.vjp(by_q, parameters=True)]
        forward, backward, with_parameters = (1e3 * time for time in least(TURNS, *calls))
        lines.append(f"| {name} | {forward:.2f} | {backward:.2f} | {with_parameters:.2f} | {backward / forward:.1f} | {with_parameters / forward:.1f} |")
        print(lines[-1], flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--markdown", type=Path)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    phipsi.set_num_threads(1)
    lines = [
        "| steps | tree alone, us | loops alone, us | ratio | tree in batches, us per state | loops | ratio | error after 1000 steps |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    in_loops(lines)
    lines += [
        "",
        "| solo12 on its feet | program, tolerance | alone, us per step | in batches, us per step and state | residual of the law | residual that the program reports |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    on_the_ground(lines)
    lines += [
        "",
        "| shapes at rest | points in touch | phipsi, us per step | points in touch in MuJoCo | MuJoCo, us per step | ratio | residual of the law |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    shapes(lines)
    lines += [
        "",
        f"| gradient of {STEPS} steps of one state | simulation, ms | gradient, ms | with inertial parameters, ms | gradient over simulation | with parameters |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    gradients(lines)
    load_now = ", ".join(f"{load:.1f}" for load in os.getloadavg())
    write(
        given.markdown,
        "Closed loops and contacts: times of steps",
        [
            f"Written by `make loops-and-contacts` (benches/loops_and_contacts.py): steps of {DT} s on one thread, {STATES} states in batches, minimum of {TURNS} interleaved timings on {os.cpu_count()} processors; load of the machine during the last 1, 5 and 15 minutes: {load_now}. Friction {FRICTION}.",
            "**Loops**: feet connected to the ground by points, compared with the same robot without them. **Contacts**: spheres at the feet; MuJoCo with elliptic cones, `impratio` 10, Newton's method and `implicitfast`, its own settled state for `standing at rest`.",
            "**Shapes**: bricks of 0.2 x 0.1 x 0.06 m on each other, 1 mm apart beside each other, and a convex hull; MuJoCo at its own rest, with a tolerance of 1e-8.",
            "**Gradients**: of a function of the last row by the start, torques, joint properties and contacts (`Trajectory.vjp`), and by inertial parameters too; steps that are differentiated are recomputed. Alone, all steps recorded.",
            "The residual of the law is computed by the bench in the same way for both programs, from velocities and impulses: the largest violation of non-penetration, complementarity and Coulomb friction of a contact, relative to the largest contact velocity without impulses. "
            "MuJoCo's contacts are soft: its forces solve a regularized problem, so that this residual does not decrease with its tolerance. At rest a soft contact has no velocity and meets the law at its penetration; during motion the two programs cannot be compared at equal residual of the law. "
            "The last column is the residual of the problem that each program solves: of the law for phipsi, the scaled gradient of its own cost for MuJoCo.",
        ],
        lines,
        "contacts that rebound, several threads.",
    )


if __name__ == "__main__":
    main()
