"""The page docs/reference/methods.md: all methods and properties of Scene by task. `python method_page.py PAGE` writes it."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import phipsi

#: Groups of methods, and their classes.
GROUPS: dict[str, type] = {"loops": phipsi.Loops, "contacts": phipsi.Contacts}
REFERENCE = Path(__file__).parents[2] / "docs" / "reference"
HEAD = """# All methods of a scene

Written by `python tests/python/method_page.py docs/reference/methods.md` from the docstrings. The names lead to the arguments and results. For names of other libraries, see the [glossary](../glossary.md).
"""
#: Names by task.
TASKS = {
    "Read a robot": ("from_urdf", "from_mujoco", "from_pinocchio", "file", "to_urdf", "to_builder"),
    "Names and sizes": ("nq", "nv", "joint_names", "body_names", "link_names", "q_index", "v_index", "joint", "joints", "link", "links", "plan"),
    "Properties": ("gravity", "limits", "actuators", "armature", "damping", "friction", "friction_terms", "stiffness", "rest", "total_mass", "inertial_parameters"),
    "Modified copies": ("with_properties", "with_payload", "with_inertias", "with_inertial_parameters", "lock", "subtree", "rerooted", "without_constraints", "without_contacts"),
    "Configurations": ("neutral", "initial", "initial_velocity", "keyframes", "random_configuration", "integrate", "difference"),
    "Forward kinematics: where is a link, such as the end effector": ("placement", "poses", "placements"),
    "Velocities, accelerations and Jacobians of links": (
        "velocity", "acceleration", "jacobian", "jacobian_rate", "jacobian_rate_product", "velocity_derivatives", "acceleration_derivatives",
        "jacobian_derivatives",
    ),
    "Center of mass and momentum": (
        "center_of_mass", "center_of_mass_velocity", "center_of_mass_acceleration", "center_of_mass_jacobian", "momentum", "centroidal_momentum_matrix",
        "centroidal_momentum_matrix_rate", "centroidal_momentum_derivatives",
    ),
    "Inverse kinematics": ("inverse_kinematics", "inverse_kinematics_rates"),
    "Joint torques and accelerations": ("forward_dynamics", "inverse_dynamics", "bias_torque", "gravity_torque", "coriolis_matrix"),
    "Mass matrix and operational space": (
        "mass_matrix", "mass_matrix_inverse", "mass_matrix_derivative", "operational_inertia", "operational_inverse_inertia", "factor", "random_model",
    ),
    "Energy": ("energy", "kinetic_energy", "potential_energy"),
    "Simulation and pictures": ("simulate", "simulator", "ode", "show"),
    "Derivatives and gradients": (
        "forward_dynamics_derivatives", "inverse_dynamics_derivatives", "linearize", "forward_dynamics_jvp", "forward_dynamics_vjp", "forward_dynamics_hvp",
        "inverse_dynamics_jvp", "inverse_dynamics_vjp", "inverse_dynamics_hvp", "simulate_vjp",
    ),
    "Closed loops": (
        "loops", "loops.names", "loops.rows", "loops.tolerance", "loops.project", "loops.error", "loops.jacobian", "loops.bias", "loops.dynamics",
        "loops.inverse_dynamics", "loops.mass_matrix_inverse",
    ),
    "Contacts": ("contacts", "contacts.names", "contacts.gaps", "contacts.velocities", "contacts.gram", "collider_names", "distances"),
    "Identification, estimation and observers": (
        "identify", "regressor", "excitation", "estimate", "observer", "momentum_observer", "forward_dynamics_variance", "inverse_dynamics_variance",
    ),
    "Optimal control": ("optimize",),
    "Checks": ("check",),
    "Code of one robot": ("to_c", "to_rust", "to_cuda"),
}  # fmt: skip


def page() -> str:
    """The page."""
    where = {
        name.removeprefix("scene."): path.name
        for path in sorted(REFERENCE.glob("*.md"))
        for name in map(str.lower, re.findall(r"^::: phipsi\.((?:Scene|Loops|Contacts)\.\w+)$", path.read_text(encoding="utf-8"), re.MULTILINE))
    }
    parts = [HEAD]
    for task, names in TASKS.items():
        rows = "".join(f"| [`{name}`]({where[name]}) | {_summary(name)} |\n" for name in names)
        parts.append(f"\n## {task}\n\n| name | |\n|---|---|\n{rows}")
    return "".join(parts)


def public() -> set[str]:
    """Public names of a scene and of its groups."""
    scene = phipsi.scenes.chain(1)
    groups = {f"{group}.{name}" for group in GROUPS for name in dir(getattr(scene, group)) if not name.startswith("_")}
    return groups | {name for name in dir(scene) if not name.startswith("_")}


def member(name: str) -> Any:
    """The method or property of this name."""
    group, _, of = name.rpartition(".")
    return getattr(GROUPS.get(group, phipsi.Scene), of)


def _summary(name: str) -> str:
    """First sentence of the docstring."""
    paragraph = " ".join((member(name).__doc__ or "").split("\n\n")[0].split())
    # The period of an abbreviation, such as in (eq. 5.1), ends no sentence.
    return re.split(r"(?<!\beq\.)(?<!\be\.g\.)(?<=\.) ", paragraph)[0].replace("|", r"\|")


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
