"""MuJoCo models of URDF files, with the states of phipsi's scene of the same file."""

from __future__ import annotations

from xml.etree import ElementTree

import mujoco
import numpy as np

import phipsi
from .common import SPEED, Array

INTEGRATORS = {
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    # (M + h D + h^2 K) v' = M v + h f, with damping and stiffness of joints and actuators.
    "discrete": mujoco.mjtIntegrator.mjINT_DISCRETE,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
}
#: Options of MuJoCo's compiler, tried in this order: the unchanged file, then with modified inertias that MuJoCo
#: accepts.
REPAIRS: tuple[dict[str, str], ...] = ({}, {"balanceinertia": "true"}, {"balanceinertia": "true", "boundmass": "1e-6", "boundinertia": "1e-9"})
DIVERGED = [int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{what}")) for what in ("QPOS", "QVEL", "QACC")]
#: Steps between two checks for divergence.
CHUNK = 100

mujoco.set_mju_user_warning(lambda _: None)


class Peer:
    """A MuJoCo model without geometry, loops or effort limits, and one state of it.

    Raises ValueError if MuJoCo does not accept the file even with modified inertias.
    """

    def __init__(self, urdf: str, scene: phipsi.Scene, *, floating: bool = False, constraints: bool = True, actuators: bool = False) -> None:
        robot = ElementTree.fromstring(urdf)
        for parent in list(robot.iter()):
            for child in list(parent):
                if child.tag in ("visual", "collision", "mimic", "mujoco", "transmission", "gazebo"):
                    parent.remove(child)
        joints = [name for name in scene.joint_names if len(range(*scene.v_index(name).indices(scene.nv))) == 1]
        self.repaired = False
        for repair in REPAIRS:
            text = self._with_compiler(robot, {"fusestatic": "false" if floating else "true", **repair})
            try:
                self.model = self._compile(text, joints if actuators else [], floating)
                break
            except ValueError as error:
                self.repaired, failure = True, error
        else:
            raise failure
        self.floating = floating
        self.model.jnt_actfrclimited[:] = 0
        self.model.opt.gravity[:] = scene.gravity
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        if not constraints:
            self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self.data = mujoco.MjData(self.model)
        ids = [self.model.joint(name).id for name in joints]
        self.q_there, self.v_there = self.model.jnt_qposadr[ids], self.model.jnt_dofadr[ids]
        self.q_here = np.array([scene.q_index(name).start for name in joints])
        self.v_here = np.array([scene.v_index(name).start for name in joints])

    @staticmethod
    def _with_compiler(robot: ElementTree.Element, options: dict[str, str]) -> str:
        for old in robot.findall("mujoco"):
            robot.remove(old)
        ElementTree.SubElement(ElementTree.SubElement(robot, "mujoco"), "compiler", options)
        return ElementTree.tostring(robot, encoding="unicode")

    @staticmethod
    def _compile(text: str, actuated: list[str], floating: bool) -> mujoco.MjModel:
        spec = mujoco.MjSpec.from_string(text)
        if floating:
            spec.worldbody.bodies[0].add_freejoint()
        for name in actuated:
            actuator = spec.add_actuator()
            actuator.target, actuator.trntype = name, mujoco.mjtTrn.mjTRN_JOINT
            actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        return spec.compile()

    def integrate_with(self, integrator: str, dt: float) -> None:
        self.model.opt.integrator, self.model.opt.timestep = INTEGRATORS[integrator], dt

    def set_gains(self, kp: Array, kd: Array) -> None:
        """Torques of the actuators become ctrl - kp q - kd v; gains are (nv,) in phipsi's order."""
        self.model.actuator_gainprm[:, 0] = 1.0
        self.model.actuator_biasprm[:, 1], self.model.actuator_biasprm[:, 2] = -kp[self.v_here], -kd[self.v_here]

    def set_target(self, kp: Array, kd: Array, q: Array, qd: Array) -> None:
        self.data.ctrl[:] = kp[self.v_here] * q[self.q_here] + kd[self.v_here] * qd[self.v_here]

    def start(self, q: Array, qd: Array, tau: float = 0.0) -> None:
        """Set the state of the one-axis joints; a floating base starts at MuJoCo's own pose, at rest."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self.q_there], self.data.qvel[self.v_there] = q[self.q_here], qd[self.v_here]
        self.data.qfrc_applied[self.v_there] = tau

    def state(self) -> tuple[Array, Array]:
        """Positions and velocities of a robot with a fixed base, in phipsi's order."""
        q, qd = np.zeros(len(self.q_here)), np.zeros(len(self.v_here))
        q[self.q_here], qd[self.v_here] = self.data.qpos[self.q_there], self.data.qvel[self.v_there]
        return q, qd

    def advance(self, steps: int) -> bool:
        """Make the steps; False if MuJoCo warns of divergence or a velocity exceeds the bound of all programs."""
        while steps > 0:
            mujoco.mj_step(self.model, self.data, nstep=min(CHUNK, steps))
            steps -= CHUNK
            if any(self.data.warning.number[DIVERGED]) or not np.all(np.abs(self.data.qvel) <= SPEED):
                return False
        return True

    def rows(self, steps: int, every: int) -> tuple[Array, Array] | None:
        """States at the start and after every `every` steps, (rows, nv) each; None if the motion diverges."""
        states = [self.state()]
        for _ in range(steps // every):
            if not self.advance(every):
                return None
            states.append(self.state())
        q, qd = zip(*states, strict=True)
        return np.array(q), np.array(qd)
