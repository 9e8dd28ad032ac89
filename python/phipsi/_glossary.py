"""Names of other libraries and of textbooks, for the messages about unknown attributes and keywords; docs/glossary.md lists the same names for readers."""

from __future__ import annotations

import difflib
import inspect
from typing import Any

from . import _core

__all__ = ["KEYWORDS", "METHODS", "REMOVED", "RENAMED", "of_attribute", "of_keyword"]

#: Former and present names of attributes of a scene.
RENAMED = {"connection_names": "constraint_names", "connection_rows": "constraint_rows", "without_connections": "without_constraints"}
#: Names of methods elsewhere, in lower case and without underscores, and the attributes of a scene.
METHODS = {
    attribute: tuple(names.split())
    for attribute, names in {
        "forward_dynamics": "aba mjforward fd articulatedbodyalgorithm calcforwarddynamics getacceleration",
        "inverse_dynamics": "rnea mjinverse id calcinversedynamics newtoneuler recursivenewtoneuler",
        "mass_matrix": "crba mjfullm m jointspaceinertia inertiamatrix getmassmatrix calcmassmatrix",
        "mass_matrix_inverse": "minv minverse computeminverse inversemassmatrix invmassmatrix",
        "bias_torque": "nle nonlineareffects qfrcbias biasforce biasforces h calcbiasterm",
        "gravity_torque": "gravitycompensation computegeneralizedgravity gravityvector gravityforce gravityforces generalizedgravity gravload g",
        "coriolis_matrix": "coriolis c computecoriolismatrix",
        "placement": "fk forwardkinematics fkine framesforwardkinematics omf omi xpos calcposeinworld transform linkpose framepose getpose getlinkpose",
        "placements": "framesplacements allposes linkposes transforms",
        "jacobian": "computeframejacobian getframejacobian mjjacbody jac jacob0 framejacobian",
        "jacobian_rate": "getframejacobiantimevariation jdot jacobiandot jacobianderivative",
        "jacobian_rate_product": "jdotqd biasacceleration",
        "velocity_derivatives": "getframevelocityderivatives",
        "acceleration_derivatives": "getframeaccelerationderivatives",
        "jacobian_derivatives": "getframekinematichessian getjointkinematichessian kinematichessian",
        "center_of_mass": "com subtreecom centerofmassposition cog centreofmass",
        "center_of_mass_jacobian": "jacobiancenterofmass jcom comjacobian",
        "centroidal_momentum_matrix": "ccrba ag computecentroidalmap cmm",
        "centroidal_momentum_derivatives": "computecentroidaldynamicsderivatives",
        "energy": "kineticenergy potentialenergy computekineticenergy computepotentialenergy",
        "simulate": "mjstep step rollout integratedynamics run advanceto sim odeint",
        "simulator": "simulation makedata data",
        "inverse_kinematics": "ik solveik ikine computeik",
        "inverse_kinematics_rates": "differentialik diffik resolvedrates",
        "operational_inertia": "operationalspaceinertia taskspaceinertia lambdamatrix",
        "regressor": "computejointtorqueregressor jointtorqueregressor",
        "show": "display view viewer visualize render plot animate meshcat draw",
        "total_mass": "mass computetotalmass bodymass",
        "joint_names": "names actuatednames jointname actuatedjointnames",
        "link_names": "bodies bodyname frames framenames",
        "limits": "jntrange jointlimits lowerpositionlimit upperpositionlimit poslimits",
        "neutral": "zero neutralconfiguration",
        "initial": "qpos0 q0 home start defaultconfiguration initialconfiguration mjresetdatakeyframe keyqpos",
        "keyframes": "key keys nkey referenceconfigurations",
        "random_configuration": "randq sample randomstate",
        "nv": "dof ndof dofs numdof njoints degreesoffreedom numvelocities",
        "nq": "numpositions",
        "armature": "rotorinertia reflectedinertia",
        "to_c": "codegen generatecode ccode toccode",
    }.items()
}
#: Keywords elsewhere, and those that stand for them here.
KEYWORDS = {
    "T": ("duration", "steps"), "t_end": ("duration",), "tf": ("duration",), "t_final": ("duration",), "time": ("duration",), "horizon": ("steps",),
    "n": ("steps",), "n_steps": ("steps",), "num_steps": ("steps",), "nsteps": ("steps",), "timestep": ("dt",), "time_step": ("dt",), "h": ("dt",),
    "q0": ("q",), "v0": ("qd",), "qd0": ("qd",), "v": ("qd",), "dq": ("qd",), "qdot": ("qd",), "qvel": ("qd",), "qpos": ("q",),
    "u": ("tau",), "torque": ("tau",), "torques": ("tau", "tau_steps"), "ctrl": ("tau",), "control": ("tau",), "controller": ("pd", "tau"), "gains": ("pd",),
    "integrator": ("method",), "solver": ("method",), "cog": ("com",), "center_of_mass": ("com",), "centre_of_mass": ("com",), "m": ("mass",),
    "payload": ("mass",), "I": ("inertia",), "inertias": ("inertia",), "body": ("link",), "frame": ("link",), "origin": ("xyz",), "position": ("xyz",),
    "translation": ("xyz",), "pos": ("xyz",), "euler": ("rpy",), "orientation": ("rpy", "rotation"), "joint_type": ("type",), "kind": ("type",), "parent_link": ("parent",),
    "child_link": ("child",), "min": ("lower",), "max": ("upper",), "lower_limit": ("lower",), "upper_limit": ("upper",), "max_velocity": ("velocity",),
    "max_effort": ("effort",), "max_torque": ("effort",), "geometry": ("shape",), "visual": ("shape",), "every": ("record_every",), "tol": ("tolerance",),
}  # fmt: skip
#: Former keywords, and what replaces them.
REMOVED = {"baumgarte": "each step is projected onto the connections"}


def of_attribute(name: str) -> str:
    """The end of the message about an unknown attribute of a scene: what was probably meant, or nothing."""
    if name in RENAMED:
        return f"; it was renamed to {RENAMED[name]!r}"
    if name.startswith("_"):
        return ""
    plain = name.replace("_", "").lower()
    own = (attribute for attribute in dir(_core.Scene) if attribute.replace("_", "") == plain)
    found = next(own, next((attribute for attribute, names in METHODS.items() if plain in names), None))
    return "" if found is None else f"; use {found!r}"


def of_keyword(method: str, name: str) -> str:
    """The end of the message about an unknown keyword of a method of a compiled class."""
    if name in REMOVED:
        return f"; it was removed: {REMOVED[name]}"
    of: Any = _core
    for part in method.split("."):
        of = getattr(of, part)
    known = [one for one in inspect.signature(of).parameters if one != "self"]
    likely = [one for one in KEYWORDS.get(name, ()) if one in known] or difflib.get_close_matches(name, known, 1)
    return f"; use {' or '.join(map(repr, likely))}" if likely else ""
