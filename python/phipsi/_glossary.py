"""Names of other libraries and of textbooks, for the messages about unknown attributes and keywords; docs/glossary.md lists the same names for readers."""

from __future__ import annotations

import inspect
import sys
from pathlib import Path
from typing import Any, NoReturn

from . import _core

__all__ = ["HINTS", "KEYWORDS", "METHODS", "REMOVED", "RENAMED", "Elsewhere", "missing", "of_keyword", "teach", "unknown_keywords"]

#: Former and present names of attributes of a scene.
RENAMED = {
    "parameters": "inertial_parameters",
    "without_connections": "without_constraints",
    "tolerance": "loops.tolerance",
    "project": "loops.project",
    **{f"{of}_{name}": f"loops.{name}" for name in ("names", "rows") for of in ("connection", "constraint")},
    **{f"constraint_{name}": f"loops.{name}" for name in ("error", "jacobian", "bias")},
    **{f"constrained_{name}": f"loops.{name}" for name in ("dynamics", "inverse_dynamics", "mass_matrix_inverse")},
    **{f"contact_{name}": f"contacts.{name}" for name in ("names", "gaps", "velocities", "gram")},
}
#: Names of methods elsewhere, as they are spelled there, and the attributes of a scene.
METHODS = {
    attribute: tuple(names.split())
    for attribute, names in {
        "forward_dynamics": "aba mj_forward fd forwardDynamics articulatedBodyAlgorithm CalcForwardDynamics get_acceleration",
        "inverse_dynamics": "rnea mj_inverse id inverseDynamics CalcInverseDynamics newton_euler recursive_newton_euler",
        "mass_matrix": "crba mj_fullM M massMatrix joint_space_inertia inertia_matrix getMassMatrix CalcMassMatrix",
        "mass_matrix_inverse": "Minv minverse computeMinverse inverse_mass_matrix inv_mass_matrix",
        "bias_torque": "nle nonLinearEffects nonlinear_effects qfrc_bias bias_force bias_forces h CalcBiasTerm",
        "gravity_torque": "gravity_compensation computeGeneralizedGravity gravity_vector gravity_force gravity_forces generalized_gravity gravload g",
        "coriolis_matrix": "coriolis C computeCoriolisMatrix",
        "placement": "fk forwardKinematics forward_kinematics fkine framesForwardKinematics oMf oMi xpos CalcPoseInWorld transform link_pose frame_pose get_pose get_link_pose pose",
        "placements": "frames_placements all_poses link_poses transforms",
        "jacobian": "computeFrameJacobian getFrameJacobian mj_jacBody jac jacob0 frame_jacobian",
        "jacobian_rate": "getFrameJacobianTimeVariation jdot jacobian_dot jacobian_derivative",
        "jacobian_rate_product": "jdot_qd bias_acceleration",
        "velocity_derivatives": "getFrameVelocityDerivatives",
        "acceleration_derivatives": "getFrameAccelerationDerivatives",
        "jacobian_derivatives": "getFrameKinematicHessian getJointKinematicHessian kinematic_hessian",
        "center_of_mass": "com centerOfMass subtree_com center_of_mass_position cog centre_of_mass",
        "center_of_mass_jacobian": "jacobianCenterOfMass jcom com_jacobian",
        "centroidal_momentum_matrix": "ccrba Ag computeCentroidalMap cmm",
        "centroidal_momentum_derivatives": "computeCentroidalDynamicsDerivatives",
        "energy": "computeKineticEnergy computePotentialEnergy",
        "simulate": "mj_step step rollout integrate_dynamics run AdvanceTo sim odeint",
        "simulator": "simulation make_data data",
        "inverse_kinematics": "ik solve_ik ikine compute_ik",
        "inverse_kinematics_rates": "differential_ik diff_ik resolved_rates",
        "operational_inertia": "operational_space_inertia task_space_inertia lambda_matrix",
        "regressor": "computeJointTorqueRegressor joint_torque_regressor",
        "show": "display view viewer visualize render plot animate meshcat draw",
        "total_mass": "mass computeTotalMass body_mass",
        "joint_names": "names actuated_names joint_name actuated_joint_names",
        "link_names": "bodies body_name frames frame_names",
        "limits": "jnt_range joint_limits lowerPositionLimit upperPositionLimit pos_limits",
        "neutral": "zero neutral_configuration",
        "initial": "qpos0 q0 home start default_configuration initial_configuration mj_resetDataKeyframe key_qpos",
        "keyframes": "key keys nkey referenceConfigurations",
        "random_configuration": "randq sample random_state randomConfiguration",
        "nv": "dof ndof dofs num_dof njoints degrees_of_freedom num_velocities",
        "nq": "num_positions",
        "armature": "rotorInertia rotor_inertia reflected_inertia",
        "lock": "with_locked lock_joints fix_joints freeze buildReducedModel build_reduced_model reduced_model",
        "with_payload": "add_payload attach_payload",
        "to_c": "code codegen generate_code ccode",
        "forward_dynamics_vjp": "products",
    }.items()
}
#: The hint in the error of each of these names.
HINTS = {name: f"use {attribute!r}" for attribute, names in METHODS.items() for name in names} | {name: f"it was renamed to {present!r}" for name, present in RENAMED.items()}
#: Keywords elsewhere, and those that stand for them here.
KEYWORDS = {
    "T": ("duration", "steps"), "t_end": ("duration",), "tf": ("duration",), "t_final": ("duration",), "time": ("duration",), "horizon": ("steps",),
    "n": ("steps",), "n_steps": ("steps",), "num_steps": ("steps",), "nsteps": ("steps",), "timestep": ("dt",), "time_step": ("dt",), "h": ("dt",),
    "q0": ("q",), "v0": ("qd",), "qd0": ("qd",), "v": ("qd",), "dq": ("qd",), "qdot": ("qd",), "qvel": ("qd",), "qpos": ("q",),
    "u": ("tau",), "torque": ("tau",), "torques": ("tau", "tau_steps"), "ctrl": ("tau",), "control": ("tau",), "controller": ("pd", "tau"), "gains": ("pd",), "kp": ("pd",), "kd": ("pd",),
    "integrator": ("method",), "solver": ("method",), "cog": ("com",), "center_of_mass": ("com",), "centre_of_mass": ("com",), "m": ("mass",),
    "payload": ("mass",), "I": ("inertia",), "inertias": ("inertia",), "body": ("link",), "frame": ("link",), "origin": ("xyz",), "position": ("xyz",),
    "translation": ("xyz",), "pos": ("xyz",), "euler": ("rpy",), "orientation": ("rpy", "rotation"), "joint_type": ("type",), "kind": ("type",), "parent_link": ("parent",),
    "child_link": ("child",), "min": ("lower",), "max": ("upper",), "lower_limit": ("lower",), "upper_limit": ("upper",), "max_velocity": ("velocity",),
    "max_effort": ("effort",), "max_torque": ("effort",), "geometry": ("shape",), "rng": ("seed",), "random_state": ("seed",), "visual": ("shape",), "every": ("record_every",), "tol": ("tolerance",),
}  # fmt: skip
#: The model of each state, for methods that have one for all, and what replaces it.
MODELS = {"inertias": "with_inertial_parameters(inertias)", "armature": "with_properties(armature=armature)"}
#: Former keywords, and what replaces them.
REMOVED = {"baumgarte": "each step is projected onto the connections"}


class Elsewhere:
    """An attribute that a class does not have: its error names the attribute that was probably meant.

    A `__getattr__` would know every name, but CPython calls the methods of a class that has one in 0.12 us more.
    """

    __slots__ = ("error", "hint")

    def __init__(self, owner: type, name: str, hint: str) -> None:
        self.error, self.hint = (f"{owner.__name__!r} object has no attribute {name!r}; {hint}", name), hint

    def __get__(self, instance: object, owner: type) -> NoReturn:
        message, name = self.error
        raise AttributeError(message, name=name, obj=owner if instance is None else instance)

    def __repr__(self) -> str:
        return self.hint


def teach(scene: type) -> None:
    """Give the class of scenes the names elsewhere and its former names, which `dir` of a scene does not list."""
    known = dir(scene)
    for name, hint in HINTS.items():
        setattr(scene, name, Elsewhere(scene, name, hint))
    setattr(scene, "__dir__", lambda _: known)  # noqa: B010
    setattr(scene, "__new__", _no_constructor)  # noqa: B010


def _no_constructor(scene: type, *given: Any, **named: Any) -> NoReturn:
    raise TypeError(f"cannot create {scene.__name__!r} instances; use phipsi.load(file), or phipsi.SceneBuilder for a scene from code")


def missing(name: str) -> NoReturn:
    """Raise AttributeError for an attribute that phipsi does not have; methods of a scene and modules are named."""
    hint, found = "", vars(_core.Scene).get(name)
    if not name.startswith("_"):
        # An import of a module calls this function too.
        if Path(__file__).with_name(f"{name}.py").is_file() or Path(__file__).with_name(name).is_dir():
            hint = f"; write import phipsi.{name}"
        elif isinstance(found, Elsewhere):
            hint = f"; {found.hint} of a scene"
        elif callable(found):
            hint = f"; it is a method of a scene: phipsi.load(file).{name}"
    raise AttributeError(f"module 'phipsi' has no attribute {name!r}{hint}", name=name, obj=sys.modules["phipsi"])


def of_keyword(method: str, name: str) -> str:
    """The end of the message about an unknown keyword of a method of a compiled class."""
    import difflib  # takes a millisecond, which only errors need

    if name in REMOVED:
        return f"; it was removed: {REMOVED[name]}"
    known = _keywords(method)
    likely = [one for one in KEYWORDS.get(name, ()) if one in known]
    if name in MODELS and method.startswith("Scene.") and not likely:
        return f"; it has one model for all states, that of the scene: use scene.{MODELS[name]}"
    likely = likely or difflib.get_close_matches(name, known, 1)
    return f"; use {' or '.join(map(repr, likely))}" if likely else ""


def unknown_keywords(method: str, given: dict[str, Any] | None) -> dict[str, Any]:
    """The given keywords that a method of a compiled class does not have."""
    known = _keywords(method)
    return {name: value for name, value in (given or {}).items() if name not in known}


def _keywords(method: str) -> list[str]:
    of: Any = _core
    for part in method.split("."):
        of = getattr(of, part)
    return [one for one in inspect.signature(of).parameters if one != "self"]
