"""The scenarios of SimBenchmark and ContactBench, as far as contacts with planes can represent them."""

from __future__ import annotations

import mujoco
import numpy as np
import phipsi
from robots import ROBOTS

from .programs import Scenario

G = 9.81
#: Only pairs with the floor can touch: bodies have contype 1, the floor has conaffinity 1.
FLOOR = '<geom name="floor" type="plane" size="100 100 1" contype="0" conaffinity="1" {more}/>'
BODY = '<body name="{name}" pos="0 0 0"><freejoint/><geom name="{name}" type="{kind}" size="{size}" mass="{mass}" contype="1" conaffinity="0" {more}/></body>'


def spec_of(bodies: list[str], *, floor: str = "", gravity: tuple[float, float, float] = (0, 0, -G)) -> mujoco.MjSpec:
    text = "\n".join([FLOOR.format(more=floor), *bodies])
    down = " ".join(repr(float(each)) for each in gravity)
    return mujoco.MjSpec.from_string(f'<mujoco><option gravity="{down}"/><worldbody>{text}</worldbody></mujoco>')


def body(name: str, kind: str, size: str, mass: float, friction: float) -> str:
    more = f'friction="{friction} 0 0"' if friction else 'condim="1"'
    return BODY.format(name=name, kind=kind, size=size, mass=mass, more=more)


def free(*positions: tuple[float, ...]) -> np.ndarray:
    """Coordinates of free bodies: their positions, and quaternions (w, x, y, z) where given."""
    return np.concatenate([[*position, 1.0, 0.0, 0.0, 0.0] if len(position) == 3 else position for position in positions])


# ContactBench: a cube of 0.2 m and 1 kg, friction 0.4 (Q. Le Lidec and others, Contact Models in Robotics, 2023).

MU, DURATION = 0.4, 1.098


def cube(name: str, qpos: np.ndarray, qvel: np.ndarray, force: np.ndarray | None = None) -> Scenario:
    spec = spec_of([body("cube", "box", "0.1 0.1 0.1", 1.0, MU)], floor='friction="0 0 0"')
    return Scenario(name, spec, qpos, qvel, DURATION, force)


def sliding_cube() -> Scenario:
    return cube("sliding cube", free((0, 0, 0.1)), np.array([0, 1.0, 0, 0, 0, 0]))


def dragged_cube(dt: float) -> Scenario:
    """The force along y increases until it is 4.5 times the friction bound."""
    time = dt * np.arange(round(DURATION / dt))
    force = np.zeros((len(time), 6))
    force[:, 1] = np.minimum(0.9 * G * 2, time * 4 * G)
    return cube("dragged cube", free((0, 0, 0.1)), np.zeros(6), force)


def dropped_cube(seed: int) -> Scenario:
    """From 0.2 m, in a random orientation."""
    turn = np.random.default_rng(seed).normal(size=4)
    return cube("dropped cube", free((0, 0, 0.2, *(turn / np.linalg.norm(turn)))), np.zeros(6))


# SimBenchmark (ETH Zurich, Robotic Systems Lab).


def rolling() -> Scenario:
    """A box of 10 kg and 25 balls of 1 kg, pushed by 15 N per kg along the floor."""
    along = 15.0 * np.array([0.5, 0.866025403784439])
    bodies = [body("box", "box", "10 10 0.5", 10.0, 0.4), *(body(f"ball{i}", "sphere", "0.5", 1.0, 0.8) for i in range(25))]
    spec = spec_of(bodies, floor='friction="0 0 0"', gravity=(*along, -G))
    at = [(0.0, 0.0, 0.5), *((2.0 * i - 4, 2.0 * j - 4, 0.5) for i in range(5) for j in range(5))]
    return Scenario("rolling", spec, free(*at), np.zeros(6 * 26), 4.0)


def balls(count: int, restitution: float) -> tuple[mujoco.MjSpec, phipsi.Scene]:
    """Balls of 10 kg and 0.1 m without friction."""
    builder = phipsi.SceneBuilder().link("world")
    for i in range(count):
        builder.link(f"ball{i}", mass=10.0, inertia=0.4 * 10.0 * 0.1**2 * np.eye(3)).joint(f"joint{i}", "floating", "world", f"ball{i}")
        builder.contact(f"ball{i}", f"ball{i}", radius=0.1, friction=0.0, restitution=restitution)
    return spec_of([body(f"ball{i}", "sphere", "0.1", 10.0, 0.0) for i in range(count)], floor='condim="1"'), builder.build()


def bouncing() -> Scenario:
    """49 balls fall from 5 m, with a restitution of 1."""
    spec, scene = balls(49, 1.0)
    at = [(2.0 * i, 2.0 * j, 5.0) for i in range(7) for j in range(7)]
    return Scenario("bouncing", spec, free(*at), np.zeros(6 * 49), 20.0, scene=scene)


def pile(side: int) -> Scenario:
    """A cube of side^3 balls of 10 kg and 0.1 m without friction or restitution, dropped: any two balls can touch."""
    count = side**3
    builder = phipsi.SceneBuilder().link("world")
    names = [f"ball{i}" for i in range(count)]
    for name in names:
        builder.link(name, mass=10.0, inertia=0.4 * 10.0 * 0.1**2 * np.eye(3)).joint(f"joint {name}", "floating", "world", name)
        builder.contact(name, name, radius=0.1, friction=0.0)
    for i, one in enumerate(names):
        for other in names[:i]:
            builder.contact(f"{one} {other}", one, radius=0.1, friction=0.0, other=other, other_radius=0.1)
    bodies = [body(name, "sphere", "0.1", 10.0, 0.0).replace('conaffinity="0"', 'conaffinity="1"') for name in names]
    layer = 0.21 * np.arange(side)
    x, y, z = np.meshgrid(layer, layer, layer + 0.15, indexing="ij")
    at = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1) + 0.001 * np.random.default_rng(42).uniform(size=(count, 3))
    return Scenario(f"pile of {count} balls", spec_of(bodies, floor='condim="1"'), free(*map(tuple, at)), np.zeros(6 * count), 1.0, scene=builder.build())


def falling_balls() -> np.ndarray:
    """Positions of 1,000 balls of 0.1 m in a cube of ten layers, (1000, 3)."""
    random = np.random.default_rng(42)
    layer = 0.21 * np.arange(10)
    x, y, z = np.meshgrid(layer, layer, layer + 0.101, indexing="ij")
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1) + 0.001 * random.uniform(size=(1000, 3))


def thousand_balls() -> Scenario:
    """Without restitution; MuJoCo has all balls in one model, phipsi has a batch of 1,000 states of one ball."""
    _, ball = balls(1, 0.0)
    spec = spec_of([body(f"ball{i}", "sphere", "0.1", 10.0, 0.0) for i in range(1000)], floor='condim="1"')
    return Scenario("thousand balls", spec, free(*map(tuple, falling_balls())), np.zeros(6000), 2.0, scene=ball, batch=1000)


FEET = ("LF_FOOT", "RF_FOOT", "LH_FOOT", "RH_FOOT")
#: The configuration of SimBenchmark, by joint.
STANCE = {f"{leg}_{joint}": sign * angle for leg, signs in {"LF": (1, 1), "RF": (-1, 1), "LH": (1, -1), "RH": (-1, -1)}.items()
          for joint, sign, angle in (("HAA", signs[0], 0.03), ("HFE", signs[1], 0.4), ("KFE", -signs[1], 0.8))}  # fmt: skip


def anymal(name: str, height: float, duration: float, *, gravity: float = G, friction: float | None = None, spring: float = 0.0, damper: float = 0.0,
           speeds: np.ndarray | None = None, wall: bool = False) -> Scenario:  # fmt: skip
    """ANYmal B of example-robot-data on the spheres of its feet; without friction for None, and without a floor for gravity and no wall."""
    spec = mujoco.MjSpec.from_file(str(ROBOTS / "anymal_b_simple_description/robots/anymal.urdf"))
    spec.compiler.fusestatic = False
    for geom in list(spec.geoms):
        if geom.parent.name not in FEET:
            spec.delete(geom)
            continue
        geom.name, geom.contype, geom.conaffinity = geom.parent.name, 1, 0
        geom.condim = 1 if friction is None else 3
        geom.friction = [friction or 0.0, 0, 0]
    if friction is not None or wall:
        floor = spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[100, 100, 1], contype=0, conaffinity=1)
        floor.condim, floor.friction = (1 if friction is None else 3), [0, 0, 0]
    # The file gives the inertia of the trunk to a link of its own, and the base 1e-6 kg without inertia, which MuJoCo rejects.
    base, trunk = spec.body("base"), spec.body("base_inertia")
    base.mass, base.ipos, base.fullinertia = trunk.mass, trunk.ipos, trunk.fullinertia
    spec.delete(trunk)
    base.add_freejoint(name="root")
    spec.option.gravity = [0, 0, -gravity]
    for joint in spec.joints:
        if joint.name in STANCE:
            joint.springref, joint.frictionloss, joint.armature = STANCE[joint.name], 0.0, 0.0
            # MuJoCo 4 has polynomials of degree 3.
            joint.stiffness, joint.damping = (value if np.ndim(before) == 0 else [value, 0, 0] for value, before in ((spring, joint.stiffness), (damper, joint.damping)))
    model = spec.copy().compile()
    qpos, qvel = np.zeros(model.nq), np.zeros(model.nv)
    qpos[2:4] = height, 1.0
    for joint, angle in STANCE.items():
        qpos[model.joint(joint).qposadr[0]] = angle
    if speeds is not None:
        qvel[:] = speeds
    return Scenario(name, spec, qpos, qvel, duration)


def standing() -> Scenario:
    """Springs and dampers with the gains of SimBenchmark's controller, friction 0.8."""
    return anymal("ANYmal, PD control", 0.54, 10.0, friction=0.8, spring=40.0, damper=1.0)


def thrown() -> Scenario:
    """Thrown up with moving joints, in free flight."""
    random = np.random.default_rng(0)
    return anymal("ANYmal, energy", 2.0, 2.0, speeds=np.concatenate([[0, 0, G], random.uniform(-1, 1, 3), random.uniform(-5, 5, 12)]))


def colliding() -> Scenario:
    """Without gravity and friction, thrown onto the floor."""
    return anymal("ANYmal, momentum", 1.0, 1.0, gravity=0.0, speeds=np.array([2.0, 1.0, -5.0, 0.3, -0.2, 0.5] + [0.0] * 12), wall=True)
