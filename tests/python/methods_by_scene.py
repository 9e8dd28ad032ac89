"""Behavior of each public method of a scene with connections, contacts or coupled joints: one call of each, and the
table of docs/measured/methods-by-scene.md.

`python tests/python/methods_by_scene.py docs/measured/methods-by-scene.md` writes the page.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import capabilities
import numpy as np
import phipsi

KINDS = ("connections", "contacts", "mimic")


class State(NamedTuple):
    """One state of a scene, and directions."""

    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray
    qdd: np.ndarray


Call = Callable[[phipsi.Scene, State], Any]


def _tip(scene: phipsi.Scene) -> str:
    return scene.link_names[-1]


def _target(scene: phipsi.Scene, state: State) -> phipsi.tasks.Position:
    return phipsi.tasks.Position("coupler", scene.placement(state.q, "coupler")[:3, 3] + [0.01, 0.0, -0.01])


def _vjp(scene: phipsi.Scene, s: State) -> Any:
    path = scene.simulate(s.q, s.qd, tau=s.tau, dt=1e-3, steps=3)
    return scene.simulate_vjp(path.q, path.qd, np.ones((4, scene.nv)), np.ones((4, scene.nv)), tau=s.tau, dt=1e-3, steps=3)


def _on_a_foot(scene: phipsi.Scene) -> phipsi.Scene:
    """A scene with connections, with a contact too."""
    return scene if not scene.loops.names else scene.to_builder().contact("foot", "rocker", xyz=(0, 0, 0.3), friction=0.5).build(mimic="couple")


def _extras(scene: phipsi.Scene) -> tuple[Any, ...]:
    """Properties that a derived scene must keep."""
    return scene.loops.names, scene.contacts.names, scene.nv, scene.link_names


def _identify(scene: phipsi.Scene, s: State) -> Any:
    random = np.random.default_rng(5)
    q, qd, qdd = (s.q + 0.1 * random.normal(size=(40, scene.nq)), *random.normal(size=(2, 40, scene.nv)))
    return scene.identify(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd) + 0.01 * random.normal(size=(40, scene.nv))).parameters


def _parameters(scene: phipsi.Scene) -> np.ndarray:
    """Parameter covariance: masses with a standard deviation of 0.1 kg."""
    covariance = np.zeros((len(scene.body_names), 10, 10))
    covariance[:, 0, 0] = 0.01
    return covariance


#: A call of each method that takes a state of the scene, or returns another scene.
CALLS: dict[str, Call] = {
    "acceleration": lambda scene, s: scene.acceleration(s.q, s.qd, s.qdd, _tip(scene)),
    "acceleration_derivatives": lambda scene, s: scene.acceleration_derivatives(s.q, s.qd, s.qdd, _tip(scene)),
    "bias_torque": lambda scene, s: scene.bias_torque(s.q, s.qd),
    "center_of_mass": lambda scene, s: scene.center_of_mass(s.q),
    "center_of_mass_acceleration": lambda scene, s: scene.center_of_mass_acceleration(s.q, s.qd, s.qdd),
    "center_of_mass_jacobian": lambda scene, s: scene.center_of_mass_jacobian(s.q),
    "center_of_mass_velocity": lambda scene, s: scene.center_of_mass_velocity(s.q, s.qd),
    "centroidal_momentum_matrix": lambda scene, s: scene.centroidal_momentum_matrix(s.q),
    "centroidal_momentum_derivatives": lambda scene, s: scene.centroidal_momentum_derivatives(s.q, s.qd),
    "centroidal_momentum_matrix_rate": lambda scene, s: scene.centroidal_momentum_matrix_rate(s.q, s.qd),
    "loops.dynamics": lambda scene, s: scene.loops.dynamics(s.q, s.qd, s.tau).qdd,
    "loops.inverse_dynamics": lambda scene, s: scene.loops.inverse_dynamics(s.q, s.qd, s.qdd).tau,
    "loops.mass_matrix_inverse": lambda scene, s: scene.loops.mass_matrix_inverse(s.q),
    "loops.bias": lambda scene, s: scene.loops.bias(s.q, s.qd),
    "loops.error": lambda scene, s: scene.loops.error(s.q),
    "loops.jacobian": lambda scene, s: scene.loops.jacobian(s.q),
    "contacts.gaps": lambda scene, s: scene.contacts.gaps(s.q),
    "contacts.velocities": lambda scene, s: scene.contacts.velocities(s.q, s.qd),
    "contacts.gram": lambda scene, s: _on_a_foot(scene).contacts.gram(s.q),
    "coriolis_matrix": lambda scene, s: scene.coriolis_matrix(s.q, s.qd),
    "distances": lambda scene, s: scene.distances(s.q, pairs=("rod", "wall")),
    "difference": lambda scene, s: scene.difference(s.q, scene.neutral()),
    "energy": lambda scene, s: scene.energy(s.q, s.qd),
    "estimate": lambda scene, s: scene.estimate(s.q, s.qd, s.tau, noise=0.1).acceleration,
    "factor": lambda scene, s: scene.factor(s.q).solve(s.tau),
    "forward_dynamics": lambda scene, s: scene.forward_dynamics(s.q, s.qd, s.tau),
    "forward_dynamics_derivatives": lambda scene, s: scene.forward_dynamics_derivatives(s.q, s.qd, s.tau),
    "forward_dynamics_hvp": lambda scene, s: scene.forward_dynamics_hvp(s.q, s.qd, s.tau, s.qdd, s.qd, s.qdd, s.tau),
    "forward_dynamics_jvp": lambda scene, s: scene.forward_dynamics_jvp(s.q, s.qd, s.tau, s.qd, s.qdd, s.tau),
    "forward_dynamics_variance": lambda scene, s: scene.forward_dynamics_variance(s.q, s.qd, s.tau, parameters=_parameters(scene), torque=0.1),
    "forward_dynamics_vjp": lambda scene, s: scene.forward_dynamics_vjp(s.q, s.qd, s.tau, s.qdd),
    "gravity_torque": lambda scene, s: scene.gravity_torque(s.q),
    "identify": _identify,
    "integrate": lambda scene, s: scene.integrate(s.q, s.qd),
    "inverse_dynamics": lambda scene, s: scene.inverse_dynamics(s.q, s.qd, s.qdd),
    "inverse_dynamics_derivatives": lambda scene, s: scene.inverse_dynamics_derivatives(s.q, s.qd, s.qdd),
    "inverse_dynamics_hvp": lambda scene, s: scene.inverse_dynamics_hvp(s.q, s.qd, s.qdd, s.tau, s.qd, s.qdd, s.tau),
    "inverse_dynamics_jvp": lambda scene, s: scene.inverse_dynamics_jvp(s.q, s.qd, s.qdd, s.qd, s.qdd, s.tau),
    "inverse_dynamics_variance": lambda scene, s: scene.inverse_dynamics_variance(s.q, s.qd, s.qdd, parameters=_parameters(scene), torque=0.1),
    "inverse_dynamics_vjp": lambda scene, s: scene.inverse_dynamics_vjp(s.q, s.qd, s.qdd, s.tau),
    "inverse_kinematics": lambda scene, s: scene.inverse_kinematics(_target(scene, s), s.q, seed=1).q,
    "inverse_kinematics_rates": lambda scene, s: scene.inverse_kinematics_rates(_target(scene, s), s.q, dt=0.01),
    "jacobian": lambda scene, s: scene.jacobian(s.q, _tip(scene)),
    "jacobian_derivatives": lambda scene, s: scene.jacobian_derivatives(s.q, _tip(scene)),
    "jacobian_rate": lambda scene, s: scene.jacobian_rate(s.q, s.qd, _tip(scene)),
    "jacobian_rate_product": lambda scene, s: scene.jacobian_rate_product(s.q, s.qd, _tip(scene)),
    "kinetic_energy": lambda scene, s: scene.kinetic_energy(s.q, s.qd),
    "potential_energy": lambda scene, s: scene.potential_energy(s.q),
    "linearize": lambda scene, s: scene.linearize(s.q, s.qd, s.tau),
    "lock": lambda scene, s: _extras(scene.lock([scene.joint_names[1]], s.q)),
    "mass_matrix": lambda scene, s: scene.mass_matrix(s.q),
    "mass_matrix_derivative": lambda scene, s: scene.mass_matrix_derivative(s.q, s.qd),
    "mass_matrix_inverse": lambda scene, s: scene.mass_matrix_inverse(s.q),
    "momentum": lambda scene, s: scene.momentum(s.q, s.qd),
    "momentum_observer": lambda scene, s: _observed(scene, s),
    "observer": lambda scene, s: scene.observer(1e-3, [phipsi.estimation.Encoder(noise=1e-3)], q=s.q, torque_noise=0.1).step(s.tau, {"encoder": s.q}).covariance,
    "optimize": lambda scene, s: scene.optimize(s.q, dt=1e-3, steps=3, costs=phipsi.control.Effort(1.0), iterations=2, limits=False).q,
    "ode": lambda scene, s: scene.ode(tau=s.tau).solve(s.q, s.qd, (0.0, 0.01)).qd[-1],
    "operational_inertia": lambda scene, s: scene.operational_inertia(s.q, _tip(scene), directions=np.eye(6)[1:2]),
    "operational_inverse_inertia": lambda scene, s: scene.operational_inverse_inertia(s.q, _tip(scene)),
    "placement": lambda scene, s: scene.placement(s.q, _tip(scene)),
    "placements": lambda scene, s: scene.placements(s.q),
    "plan": lambda scene, s: scene.plan(),
    "poses": lambda scene, s: scene.poses(s.q),
    "loops.project": lambda scene, s: scene.loops.project(s.q + 0.01, s.qd),
    "regressor": lambda scene, s: scene.regressor(s.q, s.qd, s.qdd),
    "random_model": lambda scene, s: scene.random_model(s.q, s.qd).sample_torque(3, seed=1),
    "simulate": lambda scene, s: scene.simulate(s.q, s.qd, tau=s.tau, dt=1e-3, steps=3).qd,
    "simulate_vjp": _vjp,
    "simulator": lambda scene, s: _stepped(scene, s),
    "to_c": lambda scene, s: scene.to_c(functions=["forward_dynamics"]),
    "to_cuda": lambda scene, s: scene.to_cuda(functions=["forward_dynamics"]),
    "to_rust": lambda scene, s: scene.to_rust(functions=["forward_dynamics"]),
    "to_urdf": lambda scene, s: scene.to_urdf(),
    "to_builder": lambda scene, s: _extras(scene.to_builder().build(mimic="couple")),
    "rerooted": lambda scene, s: _extras(scene.rerooted(scene.link_names[0])),
    "subtree": lambda scene, s: _extras(scene.subtree(scene.link_names[0])),
    "with_inertial_parameters": lambda scene, s: _extras(scene.with_inertial_parameters(2.0 * scene.inertial_parameters)),
    "with_inertias": lambda scene, s: _extras(scene.with_inertias({_tip(scene): (2.0, (0, 0, 0.1), np.eye(3))})),
    "with_payload": lambda scene, s: _extras(scene.with_payload(_tip(scene), 1.0, (0, 0, 0.1))),
    "with_properties": lambda scene, s: _extras(scene.with_properties(damping=2.0)),
    "velocity": lambda scene, s: scene.velocity(s.q, s.qd, _tip(scene)),
    "velocity_derivatives": lambda scene, s: scene.velocity_derivatives(s.q, s.qd, _tip(scene)),
}


def _observed(scene: phipsi.Scene, s: State) -> np.ndarray:
    observer = scene.momentum_observer(1e-3, torque_noise=0.1, bandwidth=10.0)
    observer.step(s.q, s.qd, s.tau)
    return observer.step(s.q, s.qd, s.tau).joint_torque


def _stepped(scene: phipsi.Scene, s: State) -> np.ndarray:
    simulator = scene.simulator(s.q, s.qd, dt=1e-3)
    simulator.step(s.tau, steps=3)
    return simulator.qd


def _links(builder: phipsi.SceneBuilder, mimic: dict[str, Any] | None = None) -> phipsi.SceneBuilder:
    """A crank, a coupler and a rocker in a plane, all unbalanced; the rocker is coupled to another joint if `mimic` is
    given.
    """
    for name, parent, at, length in (("crank", "ground", (0, 0, 0), 0.2), ("coupler", "crank", (0, 0, 0.2), 0.4), ("rocker", "ground", (0.3, 0, 0), 0.3)):
        builder.link(name, 1.0, (0.01, 0, 0.4 * length), np.diag([0.01, 0.012, 0.003]))
        builder.joint(name, "revolute", parent, name, xyz=at, axis=(0, 1, 0), lower=-3.0, upper=3.0, damping=0.1, **(mimic or {} if name == "rocker" else {}))
    # They cannot touch: simulations are those without them.
    ball = phipsi.shapes.Sphere(0.05)
    return builder.collider("rod", ball, link="coupler", groups=0, mask=0).collider("wall", ball, groups=0, mask=0)


def scene_of(kind: str) -> tuple[phipsi.Scene, phipsi.Scene, State]:
    """A scene of a kind, the corresponding tree, and a state."""
    builder = _links(phipsi.SceneBuilder().link("ground"))
    q = np.array([0.5, 0.8, 0.2])
    if kind == "mimic":
        tree = builder.build()
        scene = _links(phipsi.SceneBuilder().link("ground"), mimic={"mimic": "crank", "mimic_multiplier": -0.5, "mimic_offset": 0.1}).build(mimic="couple")
        q = q[: scene.nq]
    elif kind == "connections":
        builder.connect("pin", "axis", "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.3), axis=(0, 1, 0))
        scene = builder.build()
        tree, q = scene.without_constraints(), scene.loops.project(q, np.zeros(3))[0]
    else:
        builder.contact("foot", "rocker", xyz=(0, 0, 0.3), friction=0.5)
        scene = builder.build()
        tree = scene.without_contacts()
        q[2] = np.pi / 2
    qd = np.linspace(0.3, -0.2, scene.nv)
    if kind == "contacts":
        # The foot lands.
        qd[2] = 0.2
    if kind == "connections":
        qd = scene.loops.project(q, qd)[1]
    return scene, tree, State(q, qd, np.linspace(-2.0, 1.0, scene.nv), np.linspace(0.5, 1.0, scene.nv))


def outcome(name: str, kind: str) -> tuple[str, str]:
    """Behavior of a method, one of the keys of MEANING, and the message of an error."""
    scene, tree, state = scene_of(kind)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = CALLS[name](scene, state)
        except (ValueError, phipsi.errors.PhipsiError) as error:
            return "error", f"{type(error).__name__}: {error}"
        if kind == "mimic":
            return "supported", ""
        try:
            of_tree = CALLS[name](tree, state)
        except (ValueError, phipsi.errors.PhipsiError) as error:
            return "included", f"the tree: {error}"
    return ("tree" if _same(found, of_tree) else "included"), ""


def _same(found: Any, expected: Any) -> bool:
    if isinstance(found, tuple | list):
        return len(found) == len(expected) and all(map(_same, found, expected))
    if isinstance(found, np.ndarray | float | np.floating):
        return np.shape(found) == np.shape(expected) and bool(np.allclose(found, expected, rtol=1e-9, atol=1e-12))
    return str(found) == str(expected)


#: Methods without a state: constructors, names and indices, pictures. `check` and `identify` have separate tests.
WITHOUT_STATE = frozenset(
    ["check", "loops.rows", "excitation", "from_mujoco", "from_pinocchio", "from_urdf", "initial", "initial_velocity", "joint", "link", "neutral", "q_index", "random_configuration", "show", "v_index", "without_constraints", "without_contacts"]
)

MEANING = {
    "included": "the result includes their effect",
    "tree": "the quantity depends on the tree of joints only: the result is that of the same scene without them",
    "supported": "the method works with the independent coordinates, one for each joint that does not follow another",
    "error": "the method raises an error that names them",
}

#: Behavior of each method for connections, contacts, coupled joints, in this order; default: "tree", "tree", "supported".
EXPECTED: dict[str, tuple[str, str, str]] = {
    **dict.fromkeys(["loops.dynamics", "loops.inverse_dynamics", "loops.mass_matrix_inverse", "loops.bias"], ("included", "tree", "error")),
    **dict.fromkeys(["loops.error", "loops.jacobian", "loops.project"], ("included", "tree", "error")),
    **dict.fromkeys(["contacts.gaps", "contacts.velocities", "distances"], ("tree", "included", "supported")),
    "contacts.gram": ("included", "included", "supported"),
    **dict.fromkeys(["to_c", "to_cuda", "to_rust"], ("included", "tree", "supported")),
    **dict.fromkeys(["forward_dynamics", "forward_dynamics_derivatives", "forward_dynamics_jvp", "forward_dynamics_vjp", "linearize"], ("included", "tree", "supported")),
    **dict.fromkeys(["inverse_kinematics", "inverse_kinematics_rates", "optimize", "plan"], ("included", "tree", "supported")),
    **dict.fromkeys(["simulate", "simulator"], ("included", "included", "supported")),
    **dict.fromkeys(["lock", "rerooted", "subtree", "to_builder", "with_inertial_parameters", "with_inertias", "with_payload", "with_properties"], ("included", "included", "supported")),
    "estimate": ("error", "tree", "error"),
    **dict.fromkeys(["forward_dynamics_hvp", "forward_dynamics_variance", "identify", "momentum_observer", "observer"], ("included", "tree", "supported")),
    **dict.fromkeys(["operational_inertia", "operational_inverse_inertia"], ("included", "tree", "supported")),
    **dict.fromkeys(["factor", "random_model"], ("tree", "tree", "error")),
    "ode": ("error", "error", "supported"),
    "simulate_vjp": ("included", "included", "supported"),
    "to_urdf": ("error", "error", "supported"),
}


def expected(name: str, kind: str) -> str:
    """Behavior of a method in scenes of a kind."""
    return EXPECTED.get(name, ("tree", "tree", "supported"))[KINDS.index(kind)]


def page() -> str:
    """The page docs/measured/methods-by-scene.md."""
    lines = [
        "# Methods by kind of scene",
        "",
        "The behavior of each method of a scene with [connections](../how-to/closed-loops.md), [contacts](../how-to/contacts.md) and [coupled joints](../how-to/mimic.md) (`mimic=\"couple\"`). "
        "Written by `python tests/python/methods_by_scene.py docs/measured/methods-by-scene.md`; a test calls every method and compares the result with the table.",
        "",
        *(f"- **{word}**: {meaning}." for word, meaning in MEANING.items()),
        "",
        "Kinematics, momentum, energy, the mass matrix and inverse dynamics are quantities of the tree of joints, which connections and contacts do not change. `loops.mass_matrix_inverse` and "
        "`loops.inverse_dynamics` are the corresponding methods that include connections. Only `simulate`, `simulate_vjp` and simulators include contacts.",
        "",
        "| method | connections | contacts | coupled joints |",
        "| --- | --- | --- | --- |",
        *(f"| `{name}` | {' | '.join(expected(name, kind) for kind in KINDS)} |" for name in sorted(CALLS)),
        "",
        f"Methods without a state of the scene: {', '.join(f'`{name}`' for name in sorted(WITHOUT_STATE))}.",
        "",
        "## Capabilities",
        "",
        "Each cell is a test against dense algebra that reads nothing of phipsi: a mechanism of four bodies as a tree, with a joint that follows another, and closed by a pin, each without and with a contact 100 m out of reach. "
        "With the contact, results must have the same bits as without it (gradients and covariances of a simulation: the same to rounding). A cell that is refused raises an error with these words.",
        "",
        *capabilities.table(),
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
