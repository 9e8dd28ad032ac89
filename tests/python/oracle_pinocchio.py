"""Comparison of Pinocchio (the wheel ``pin``) with phipsi: one URDF read by both, and conversion of states and results.

Pinocchio orders siblings by name and phipsi by the file, so that joints are matched by name. Pinocchio represents a
continuous joint as (cos, sin), and spatial vectors linear first. Its local convention, the more accurate one, is used
throughout.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin

import phipsi

ROBOTS = Path(pin.__file__).resolve().parents[4] / "share/example-robot-data/robots"

SWAP = np.r_[3:6, 0:3]
"""Angular first to linear first, and back."""


def urdf_files() -> list[str]:
    """All URDF files of example-robot-data, as paths below its folder of robots."""
    return sorted(path.relative_to(ROBOTS).as_posix() for path in ROBOTS.rglob("*.urdf"))


def load(file: str, floating_base: bool, *, strict: bool = False) -> tuple[phipsi.Scene, list[warnings.WarningMessage]]:
    """phipsi's scene of a file of example-robot-data, and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        return phipsi.Scene.from_urdf(ROBOTS / file, floating_base=floating_base, strict=strict), caught


class Oracle:
    """Pinocchio's model of a file, with results in phipsi's order and conventions."""

    def __init__(self, file: str, floating_base: bool, scene: phipsi.Scene, *, mimic: bool = False) -> None:
        path = str(ROBOTS / file)
        root = (pin.JointModelFreeFlyer(),) if floating_base else ()
        self.model = pin.buildModelFromUrdf(path, *root, *((True,) if mimic else ()))
        self.model.gravity.linear[:] = scene.gravity
        self.data = self.model.createData()
        # Mimic joints are joints of Pinocchio, but not of a scene with coupled joints.
        names = [name for name in self.model.names[1:] if not mimic or name in scene.joint_names]
        assert sorted(names) == sorted(scene.joint_names)
        assert self.model.nv == scene.nv
        self.mass = pin.computeTotalMass(self.model)
        self.scene = scene
        # Entry i of phipsi's velocity is entry v_order[i] of Pinocchio's.
        self.v_order = np.empty(scene.nv, dtype=int)
        for name in names:
            joint = self.model.joints[self.model.getJointId(name)]
            at = scene.v_index(name)
            assert at.stop - at.start == joint.nv
            self.v_order[at] = joint.idx_v + np.arange(joint.nv)

    def configuration(self, q: np.ndarray) -> np.ndarray:
        """phipsi's q in Pinocchio's convention."""
        there = np.empty(self.model.nq)
        for name in self.scene.joint_names:
            joint = self.model.joints[self.model.getJointId(name)]
            values = q[self.scene.q_index(name)]
            if joint.nq == 2 and joint.nv == 1:
                values = np.array([np.cos(values[0]), np.sin(values[0])])
            assert joint.nq == len(values)
            there[joint.idx_q : joint.idx_q + joint.nq] = values
        return there

    def there(self, v: np.ndarray) -> np.ndarray:
        """A velocity, acceleration or torque of phipsi in Pinocchio's order."""
        moved = np.empty(self.model.nv)
        moved[self.v_order] = v
        return moved

    def here(self, v: np.ndarray) -> np.ndarray:
        """A vector, or the columns of a matrix, of Pinocchio in phipsi's order."""
        return np.asarray(v)[..., self.v_order]

    def symmetric(self, upper: np.ndarray) -> np.ndarray:
        """A symmetric matrix of Pinocchio with a valid upper triangle, in phipsi's order."""
        full = np.triu(upper) + np.triu(upper, 1).T
        return full[np.ix_(self.v_order, self.v_order)]

    def frame(self, link: str) -> int:
        index = self.model.getFrameId(link, pin.FrameType.BODY)
        assert index < self.model.nframes, link
        return index

    def joint_forces(self, wrenches: Mapping[str, np.ndarray]) -> pin.StdVec_Force:
        """Wrenches on links, (moment, force) in their frames, as forces on joints."""
        forces = pin.StdVec_Force([pin.Force.Zero() for _ in range(self.model.njoints)])
        for link, wrench in wrenches.items():
            frame = self.model.frames[self.frame(link)]
            forces[frame.parentJoint] += frame.placement.act(pin.Force(wrench[3:], wrench[:3]))
        return forces

    def inverse_dynamics(
        self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, wrenches: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        arguments = (self.configuration(q), self.there(qd), self.there(qdd), self.joint_forces(wrenches))
        return self.here(pin.rnea(self.model, self.data, *arguments))

    def forward_dynamics(
        self, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, wrenches: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        arguments = (self.configuration(q), self.there(qd), self.there(tau), self.joint_forces(wrenches))
        return self.here(pin.aba(self.model, self.data, *arguments, pin.Convention.LOCAL))

    def bias_torque(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return self.here(pin.nonLinearEffects(self.model, self.data, self.configuration(q), self.there(qd)))

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        return self.symmetric(pin.crba(self.model, self.data, self.configuration(q), pin.Convention.LOCAL))

    def mass_matrix_inverse(self, q: np.ndarray) -> np.ndarray:
        return self.symmetric(pin.computeMinverse(self.model, self.data, self.configuration(q)))

    def placements(self, q: np.ndarray) -> dict[str, np.ndarray]:
        pin.framesForwardKinematics(self.model, self.data, self.configuration(q))
        return {link: self.data.oMf[self.frame(link)].homogeneous for link in self.scene.link_names}

    def jacobian(self, q: np.ndarray, link: str) -> np.ndarray:
        q = self.configuration(q)
        found = pin.computeFrameJacobian(self.model, self.data, q, self.frame(link), pin.ReferenceFrame.LOCAL)
        return self.here(found)[SWAP]

    def energy(self, q: np.ndarray, qd: np.ndarray) -> tuple[float, float]:
        q, qd = self.configuration(q), self.there(qd)
        kinetic = pin.computeKineticEnergy(self.model, self.data, q, qd)
        return kinetic, pin.computePotentialEnergy(self.model, self.data, q)

    def momentum(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """(angular, linear) about the origin of the base; Pinocchio's is about the center of mass."""
        q, qd = self.configuration(q), self.there(qd)
        pin.ccrba(self.model, self.data, q, qd)
        linear, angular = self.data.hg.linear, self.data.hg.angular
        return np.concatenate([angular + np.cross(self.data.com[0], linear), linear])

    def square(self, matrix: np.ndarray) -> np.ndarray:
        """A matrix of Pinocchio, rows and columns in phipsi's order."""
        return np.reshape(matrix, (self.model.nv, self.model.nv))[np.ix_(self.v_order, self.v_order)]

    def inverse_dynamics_derivatives(
        self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, wrenches: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives with respect to q and qd, and M without armature."""
        arguments = (self.configuration(q), self.there(qd), self.there(qdd), self.joint_forces(wrenches))
        by_q, by_qd, mass = pin.computeRNEADerivatives(self.model, self.data, *arguments)
        return self.square(by_q), self.square(by_qd), self.symmetric(np.reshape(mass, (self.model.nv, self.model.nv)))

    def coriolis_matrix(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return self.square(pin.computeCoriolisMatrix(self.model, self.data, self.configuration(q), self.there(qd)))

    def forward_dynamics_derivatives(
        self, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, wrenches: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives with respect to q, qd and tau."""
        arguments = (self.configuration(q), self.there(qd), self.there(tau), self.joint_forces(wrenches))
        by_q, by_qd, inverse = pin.computeABADerivatives(self.model, self.data, *arguments)
        return self.square(by_q), self.square(by_qd), self.symmetric(np.reshape(inverse, (self.model.nv, self.model.nv)))
