"""Random scenes with all types of joints, and states of them, from a seed."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pytest

import phipsi

KINDS = ("revolute", "prismatic", "continuous", "screw", "planar", "spherical", "floating", "fixed")


def random_rotation(random: np.random.Generator) -> np.ndarray:
    rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return rotation * np.sign(np.linalg.det(rotation))


def random_scene(
    seed: int,
    joints: int,
    *,
    kinds: Sequence[str] = KINDS,
    branching: float = 0.4,
    armature: float = 0.0,
    floating_base: bool = False,
    gravity: Sequence[float] = (0.3, -0.5, -9.6),
) -> phipsi.Scene:
    """A tree that contains each type of joint at least once; bodies of about 1 kg and 0.3 m."""
    random = np.random.default_rng(seed)
    builder = phipsi.SceneBuilder()

    def link(name: str) -> None:
        frame = random_rotation(random)
        a, b, c = random.uniform(0.01, 0.05, 3)
        inertia = frame @ np.diag([b + c, a + c, a + b]) @ frame.T
        builder.link(name, random.uniform(0.5, 2.0), random.uniform(-0.3, 0.3, 3), 0.5 * (inertia + inertia.T))

    link("base")
    order = list(random.permutation(len(kinds)))
    for k in range(joints):
        parent = f"link{k - 1}" if k else "base"
        if k and random.uniform() < branching:
            parent = f"link{random.integers(k)}"
        kind = kinds[order[k]] if k < len(order) else kinds[random.integers(len(kinds))]
        builder.joint(
            f"joint{k}",
            kind,
            parent,
            f"link{k}",
            xyz=random.uniform(-0.5, 0.5, 3),
            rotation=random_rotation(random),
            axis=random.normal(size=3),
            pitch=0.2 if kind == "screw" else None,
            armature=armature * random.uniform(0.1, 1.0),
            lower=-1.0 - k,
            upper=2.0 + k,
            velocity=3.0 + k,
            effort=4.0 + k,
        )
        link(f"link{k}")
    return builder.build(floating_base=floating_base, gravity=gravity)


class State(NamedTuple):
    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray


def at_once(work: Callable[[int], None], count: int) -> None:
    """Run work(0), work(1), ... on one thread each, and wait for all."""
    threads = [threading.Thread(target=work, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def random_states(scene: phipsi.Scene, seed: int, batch: tuple[int, ...] = ()) -> State:
    """States with unit quaternions, all C-contiguous float64."""
    random = np.random.default_rng(seed)
    step, qd, tau = random.uniform(-2.0, 2.0, (3, *batch, scene.nv))
    return State(scene.integrate(scene.neutral(), step), np.ascontiguousarray(qd), np.ascontiguousarray(5.0 * tau))


@pytest.fixture
def c_compiler() -> str:
    """Command of the C compiler; skips the test if there is none."""
    compiler = os.environ.get("CC", "cc")
    if shutil.which(compiler) is None:
        pytest.skip("no C compiler here")
    return compiler


@pytest.fixture(scope="session")
def mixed() -> phipsi.Scene:
    """All types of joints, branching, a fixed base."""
    return random_scene(1, 10, armature=0.1)


@pytest.fixture(scope="session")
def floating() -> phipsi.Scene:
    """All types of joints on a floating base, without armature."""
    return random_scene(2, 9, floating_base=True)


@pytest.fixture(scope="session")
def arm() -> phipsi.Scene:
    """A chain of seven revolute joints."""
    return random_scene(3, 7, kinds=("revolute",), branching=0.0)


@pytest.fixture(scope="session")
def welded() -> phipsi.Scene:
    """Two links and no movable joint: nv = 0."""
    builder = phipsi.SceneBuilder().link("base", mass=1.0).link("mast", mass=2.0)
    return builder.joint("weld", "fixed", "base", "mast", xyz=(0, 0, 1)).build()


Method = Callable[..., object]

POINT = (0.3, -0.2, 0.1)
"""A point on a link, m."""

OF_MASS = {
    "center_of_mass": 1,
    "center_of_mass_velocity": 2,
    "center_of_mass_acceleration": 3,
    "center_of_mass_jacobian": 1,
    "centroidal_momentum_matrix": 1,
    "centroidal_momentum_matrix_rate": 2,
}
"""Methods for the center of mass, and their numbers of arguments of q, qd and qdd."""


def methods(scene: phipsi.Scene, state: State) -> dict[str, tuple[Method, tuple[np.ndarray, ...]]]:
    """All methods that take batches, with their array arguments; results as arrays."""
    q, qd, tau = state
    link = scene.link_names[-1]

    def placements(q: np.ndarray) -> np.ndarray:
        return np.stack(list(scene.placements(q).values()), axis=-3)

    def energy(q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return np.stack(scene.energy(q, qd), axis=-1)

    def pushed(q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> np.ndarray:
        return scene.forward_dynamics(q, qd, tau, wrenches={link: np.arange(6.0), scene.link_names[0]: np.ones(6)})

    def estimate(q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> np.ndarray:
        noise = np.resize([0.0, 0.5, np.inf], scene.nv)
        found = scene.estimate(q, qd, tau, noise=noise, covariance=True, wrenches={link: np.ones(6)})
        blocks = found.force, found.process, found.force_covariance, found.process_covariance
        # One row per block, so that axes are preserved without states.
        flat = [block[..., i] if block.ndim == found.force.ndim else block[..., i, 0] for block in blocks for i in range(6)]
        return np.concatenate([found.acceleration, found.torque, found.acceleration_variance, found.torque_variance, *flat], axis=-1)

    def stacked(method: Callable[..., tuple[np.ndarray, ...]]) -> Method:
        """The matrices of the result, stacked vertically."""
        return lambda *state: np.concatenate(method(*state), axis=-2)

    def gradients(method: Callable[..., tuple[np.ndarray, ...]]) -> Method:
        """The parts of the result that concern the state; the arguments of the state serve as cotangent and
        direction.
        """
        return lambda q, qd, tau: np.concatenate(method(q, qd, tau, qd)[:3], axis=-1)

    def hessian(method: Callable[..., tuple[np.ndarray, ...]]) -> Method:
        return lambda q, qd, tau: np.concatenate(method(q, qd, tau, qd, tau, qd, tau)[:3], axis=-1)

    return {
        "forward_dynamics": (scene.forward_dynamics, (q, qd, tau)),
        "forward_dynamics with wrenches": (pushed, (q, qd, tau)),
        "inverse_dynamics": (scene.inverse_dynamics, (q, qd, tau)),
        "bias_torque": (scene.bias_torque, (q, qd)),
        "mass_matrix": (scene.mass_matrix, (q,)),
        "mass_matrix_inverse": (scene.mass_matrix_inverse, (q,)),
        "inverse_dynamics_derivatives": (stacked(scene.inverse_dynamics_derivatives), (q, qd, tau)),
        "forward_dynamics_derivatives": (stacked(scene.forward_dynamics_derivatives), (q, qd, tau)),
        "coriolis_matrix": (scene.coriolis_matrix, (q, qd)),
        "mass_matrix_derivative": (scene.mass_matrix_derivative, (q, qd)),
        "inverse_dynamics_jvp": (lambda q, qd, tau: scene.inverse_dynamics_jvp(q, qd, tau, qd, tau, qd), (q, qd, tau)),
        "forward_dynamics_jvp": (lambda q, qd, tau: scene.forward_dynamics_jvp(q, qd, tau, qd, tau, qd), (q, qd, tau)),
        "inverse_dynamics_vjp": (gradients(scene.inverse_dynamics_vjp), (q, qd, tau)),
        "forward_dynamics_vjp": (gradients(scene.forward_dynamics_vjp), (q, qd, tau)),
        "inverse_dynamics_hvp": (hessian(scene.inverse_dynamics_hvp), (q, qd, tau)),
        "forward_dynamics_hvp": (hessian(scene.forward_dynamics_hvp), (q, qd, tau)),
        "placements": (placements, (q,)),
        "gravity_torque": (scene.gravity_torque, (q,)),
        "placement": (lambda q: scene.placement(q, link), (q,)),
        "placement of several": (lambda q: scene.placement(q, [link, scene.link_names[0]]), (q,)),
        "velocity": (lambda q, qd: scene.velocity(q, qd, link, frame="world"), (q, qd)),
        "acceleration": (lambda q, qd, qdd: scene.acceleration(q, qd, qdd, link, at=POINT, kind="classical"), (q, qd, tau)),
        "jacobian": (lambda q: scene.jacobian(q, link), (q,)),
        "jacobian at a point": (lambda q: scene.jacobian(q, link, frame="local-world-aligned", at=POINT), (q,)),
        "jacobian_rate": (lambda q, qd: scene.jacobian_rate(q, qd, link, frame="world"), (q, qd)),
        "jacobian_rate_product": (lambda q, qd: scene.jacobian_rate_product(q, qd, link), (q, qd)),
        **{name: (getattr(scene, name), (q, qd, tau)[:count]) for name, count in OF_MASS.items()},
        "kinetic_energy": (scene.kinetic_energy, (q, qd)),
        "potential_energy": (scene.potential_energy, (q,)),
        "energy": (energy, (q, qd)),
        "momentum": (scene.momentum, (q, qd)),
        "integrate": (scene.integrate, (q, qd)),
        "estimate": (estimate, (q, qd, tau)),
        "difference": (lambda q: scene.difference(scene.neutral(), q), (q,)),
    }


METHODS = (
    "forward_dynamics",
    "forward_dynamics with wrenches",
    "inverse_dynamics",
    "bias_torque",
    "mass_matrix",
    "mass_matrix_inverse",
    "inverse_dynamics_derivatives",
    "forward_dynamics_derivatives",
    "coriolis_matrix",
    "mass_matrix_derivative",
    "inverse_dynamics_jvp",
    "forward_dynamics_jvp",
    "inverse_dynamics_vjp",
    "forward_dynamics_vjp",
    "inverse_dynamics_hvp",
    "forward_dynamics_hvp",
    "placements",
    "gravity_torque",
    "placement",
    "placement of several",
    "velocity",
    "acceleration",
    "jacobian",
    "jacobian at a point",
    "jacobian_rate",
    "jacobian_rate_product",
    *OF_MASS,
    "kinetic_energy",
    "potential_energy",
    "energy",
    "momentum",
    "integrate",
    "estimate",
    "difference",
)


@pytest.fixture(params=METHODS)
def method(request: pytest.FixtureRequest) -> str:
    """Name of each method that takes batches."""
    return str(request.param)
