"""Models and states that python_peers.py passes to every library, and the mapping of their coordinates.

phipsi's coordinates are the reference: q of a free joint is (x, y, z, qx, qy, qz, qw), its velocities are (linear,
angular) in the base frame. A peer may order joints differently, put the angular part first, or use the world frame.
"""

import sys
import warnings
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import dump_models
import numpy as np
import phipsi
from phipsi.report import kinds

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from studies.programs.model import World

#: Gravity of dynibo, which cannot be changed; therefore all programs use it.
GRAVITY = (0.0, 0.0, -9.80665)
#: Kinds of states for form "auto" in addition to random ones.
KINDS = (kinds.HELD, kinds.REST, kinds.FALLING)
MODELS = ("chain_7", "ur5", "panda", "g1", "talos")
ONE_STATES, BATCH_STATES = 256, 4096

Array = np.ndarray


@dataclass(frozen=True)
class Problem:
    """A model as a scene of phipsi and as URDF text without shapes, damping and transmissions; and states."""

    name: str
    floating: bool
    scene: phipsi.Scene
    urdf: str
    q: Array
    qd: Array
    tau: Array
    qdd: Array

    def __len__(self) -> int:
        return len(self.q)

    def at(self, kind: str) -> "tuple[Array, Array, Array]":
        """q, qd and tau of states of a kind, at the same configurations."""
        drawn = kinds.of(self.scene, self.q, self.qd, self.tau, np.random.default_rng(2))
        return kinds.state(self.scene, drawn, kind)

    @property
    def first(self) -> int:
        """Number of degrees of freedom of the base."""
        return 6 if self.floating else 0

    @property
    def joints(self) -> list[str]:
        """Joints without the free joint."""
        return list(self.scene.joint_names)[1 if self.floating else 0 :]


def chain_urdf(scene: phipsi.Scene) -> str:
    """dump_models.chain as URDF, with the names of phipsi's chain."""
    ixx, iyy, izz = dump_models.LINK_INERTIA
    base, *links = ["base", *scene.body_names]
    lines = [f'<link name="{base}"/>']
    for k, (joint, parent, child) in enumerate(zip(scene.joint_names, [base, *links], links, strict=False)):
        roll = repr(np.pi / 2) if k % 2 == 1 else "0"
        offset = dump_models.LINK_LENGTH if k > 0 else 0.0
        lines.append(
            f'<link name="{child}"><inertial><origin xyz="0 0 {dump_models.LINK_LENGTH / 2}"/>'
            f'<mass value="{dump_models.LINK_MASS}"/>'
            f'<inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/></inertial></link>'
            f'<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 0 {offset}" rpy="{roll} 0 0"/><axis xyz="0 0 1"/>'
            '<limit lower="-1e9" upper="1e9" effort="1e9" velocity="1e9"/></joint>'
        )
    return '<robot name="chain">' + "".join(lines) + "</robot>"


def robot_urdf(relative: str) -> str:
    """The file of the robot without elements that do not affect the dynamics, and without damping, which phipsi uses
    only in simulation.
    """
    root = ET.parse(dump_models.urdf_path(relative)).getroot()
    unwanted = {"link": ("visual", "collision"), "joint": ("dynamics", "safety_controller", "calibration")}
    for child in list(root):
        if child.tag not in unwanted:
            root.remove(child)
            continue
        for tag in unwanted[child.tag]:
            for element in child.findall(tag):
                child.remove(element)
    return ET.tostring(root, encoding="unicode")


def problem(name: str, states: int) -> Problem:
    """Random states: velocities, torques and accelerations within (-1, 1), configurations displaced by that much from
    the neutral one.
    """
    if name.startswith("chain_"):
        floating = False
        scene = phipsi.scenes.chain(int(name.removeprefix("chain_")))
        urdf = chain_urdf(scene)
        rebuild, ((version, _, *rest),) = scene.__reduce__()
        scene = rebuild((version, list(GRAVITY), *rest))
    else:
        relative, base = next((path, base) for known, path, base in dump_models.ROBOTS if known == name)
        floating = base == "floating"
        urdf = robot_urdf(relative)
        with warnings.catch_warnings():  # mimic joints are independent, inertias are those of the file
            warnings.simplefilter("ignore", UserWarning)
            scene = phipsi.Scene.from_urdf(urdf, floating_base=floating, gravity=GRAVITY)
    rng = np.random.default_rng(1)

    def draw() -> Array:
        return rng.uniform(-1.0, 1.0, (states, scene.nv))

    q = scene.integrate(np.tile(scene.neutral(), (states, 1)), draw())
    return Problem(name, floating, scene, urdf, q, draw(), draw(), draw())


@dataclass(frozen=True)
class Coordinates:
    """Relation of a peer's vectors of degrees of freedom to phipsi's: theirs = turn @ ours, an orthogonal matrix."""

    problem: Problem
    at: Array
    """Index of each of phipsi's joints in the peer's vectors, without the free joint."""
    angular_first: bool = False
    world: str = ""
    """Parts of the velocity of the base that the peer expresses in the world frame: "linear", "angular" or both."""

    def turn(self, state: int) -> Array:
        """Matrix for that state."""
        problem = self.problem
        first, nv = problem.first, problem.scene.nv
        turn = np.zeros((nv, nv))
        turn[first + self.at, first + np.arange(nv - first)] = 1.0
        if first:
            rotation = World.of(problem.q[state], problem.qd[state]).rotation
            linear, angular = (3, 0) if self.angular_first else (0, 3)
            turn[linear : linear + 3, :3] = rotation if "linear" in self.world else np.eye(3)
            turn[angular : angular + 3, 3:6] = rotation if "angular" in self.world else np.eye(3)
        return turn

    def extra(self, state: int) -> Array:
        """Acceleration of the origin of the base minus the derivative of its velocity in the base frame; phipsi's
        order.
        """
        extra = np.zeros(self.problem.scene.nv)
        if self.problem.first and "linear" in self.world:
            extra[:3] = np.cross(self.problem.qd[state, 3:6], self.problem.qd[state, :3])
        return extra

    def positions(self, state: int) -> Array:
        """q of the joints in the peer's order, without the free joint."""
        q = np.empty(len(self.at))
        q[self.at] = self.problem.q[state, 7 if self.problem.first else 0 :]
        return q

    def base(self, state: int) -> Array:
        """(x, y, z, qw, qx, qy, qz) of the base; empty for a fixed base."""
        return self.problem.q[state, [0, 1, 2, 6, 3, 4, 5]] if self.problem.first else np.empty(0)

    def rates(self, state: int) -> Array:
        """qd in the peer's convention."""
        return self.turn(state) @ self.problem.qd[state]

    def forces(self, state: int) -> Array:
        """tau in the peer's convention."""
        return self.turn(state) @ self.problem.tau[state]

    def accelerations(self, state: int) -> Array:
        """qdd in the peer's convention."""
        return self.turn(state) @ (self.problem.qdd[state] + self.extra(state))

    def our_accelerations(self, theirs: Array, state: int) -> Array:
        """Acceleration in phipsi's convention."""
        return self.turn(state).T @ theirs - self.extra(state)

    def our_forces(self, theirs: Array, state: int) -> Array:
        """Torque in phipsi's convention."""
        return self.turn(state).T @ theirs

    def our_matrix(self, theirs: Array, state: int) -> Array:
        """Mass matrix or its inverse in phipsi's convention."""
        turn = self.turn(state)
        return turn.T @ theirs @ turn
