"""Calls of every method with a size that exceeds the memory, and the child process that makes one of them.

``python large_calls.py NAME`` prepares the call, limits the memory of this process to slightly more than it uses,
makes the call, and prints the error as JSON. The process must not crash.
"""

from __future__ import annotations

from operator import attrgetter
import json
import pickle
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import phipsi
from phipsi import _core

MEGABYTE = 2**20

Call = Callable[[], object]


class Large(NamedTuple):
    """A call that needs too much memory."""

    argument: str
    """Name that the error must contain."""
    prepare: Callable[[phipsi.Scene], Call]
    """The call, with all arguments created."""
    room: int = 200
    """Additional memory of the process, megabytes."""
    covers: tuple[str, ...] = ()
    """Tested parameters, as "method.parameter"."""


OF_THREE = ("forward_dynamics", "inverse_dynamics", "estimate", "acceleration", "acceleration_derivatives", "center_of_mass_acceleration")
"""Methods with the arguments q, qd and a third one."""


def broadcast(method: str, second: str = "nv", **options: Any) -> Callable[[phipsi.Scene], Call]:
    """Two small arguments that broadcast to a large batch."""

    def prepare(scene: phipsi.Scene) -> Call:
        first, other = np.zeros((2**14, 1, scene.nq)), np.zeros((2**14, scene.nv if second == "nv" else scene.nq))
        others = {"forward_dynamics_jvp": 4, "inverse_dynamics_jvp": 4}
        third = [np.zeros(scene.nv)] * others.get(method, 1 if method in OF_THREE else 0)
        return lambda: getattr(scene, method)(first, other, *third, **options)

    return prepare


def in_float32(states: int, call: Callable[..., object]) -> Callable[[phipsi.Scene], Call]:
    """One argument with many states, of which there is a copy in float64: for what reads states in blocks."""

    def prepare(scene: phipsi.Scene) -> Call:
        q = np.zeros((states, scene.nq), np.float32)
        return lambda: call(scene, q)

    return prepare


def batch(states: int, call: Callable[..., object], **options: Any) -> Callable[[phipsi.Scene], Call]:
    """One argument with many states."""

    def prepare(scene: phipsi.Scene) -> Call:
        q = np.zeros((states, scene.nq))
        return lambda: call(scene, q, **options)

    return prepare


def looped(scene: phipsi.Scene) -> phipsi.Scene:
    """The same chain, with its tip connected to a point of the world."""
    return scene.to_builder().connect("tip", "point", scene.link_names[-1], xyz=(0, 0, 0.3)).build()


def through_connections(method: str, arrays: int, states: int = 10**6, **options: Any) -> Callable[[phipsi.Scene], Call]:
    """A method on a scene with connections, with q and that many arrays of joint velocities."""

    def prepare(scene: phipsi.Scene) -> Call:
        closed, q = looped(scene), np.zeros((states, scene.nq))
        return lambda: attrgetter(method)(closed)(q, *[np.zeros(scene.nv)] * arrays, **options)

    return prepare


def on_the_ground(method: str, arrays: int, states: int) -> Callable[[phipsi.Scene], Call]:
    """A method on the same chain with a contact at its tip, with q and that many arrays of joint velocities."""

    def prepare(scene: phipsi.Scene) -> Call:
        touching = scene.to_builder().contact("tip", scene.link_names[-1], xyz=(0.1, 0, 0.3), friction=0.5).build()
        q = np.broadcast_to(np.zeros(scene.nq), (states, scene.nq))
        return lambda: attrgetter(method)(touching)(q, *[np.zeros(scene.nv)] * arrays)

    return prepare


def with_shapes(states: int) -> Callable[[phipsi.Scene], Call]:
    """Distances of the same chain with a ball at its tip above the ground."""

    def prepare(scene: phipsi.Scene) -> Call:
        builder = scene.to_builder().collider("tip", phipsi.shapes.Sphere(0.1), link=scene.link_names[-1])
        shaped = builder.collider("ground", phipsi.shapes.HalfSpace(xyz=(0, 0, -10.0))).build()
        q = np.broadcast_to(np.zeros(scene.nq), (states, scene.nq))
        return lambda: shaped.distances(q)

    return prepare


def of_model(call: Callable[[phipsi.RandomModel], object]) -> Callable[[phipsi.Scene], Call]:
    def prepare(scene: phipsi.Scene) -> Call:
        model = scene.random_model(np.zeros(scene.nq))
        return lambda: call(model)

    return prepare


def of_factor(states: int, call: Callable[[phipsi.Factor, np.ndarray], object]) -> Callable[[phipsi.Scene], Call]:
    def prepare(scene: phipsi.Scene) -> Call:
        q = np.full((states, scene.nq), 0.2)
        factor = scene.factor(q)
        return lambda: call(factor, q)

    return prepare


def of_long_chain(call: Callable[[phipsi.Scene, np.ndarray], object]) -> Callable[[phipsi.Scene], Call]:
    """An existing scene for whose intermediate results there is no memory."""

    def prepare(scene: phipsi.Scene) -> Call:
        long = phipsi.scenes.chain(30_000)
        return lambda: call(long, np.zeros(long.nq))

    return prepare


def unpickled(scene: phipsi.Scene) -> Call:
    rebuild, arguments = phipsi.scenes.chain(30_000).__reduce__()
    return lambda: rebuild(*arguments)


def pickled(scene: phipsi.Scene) -> Call:
    long = phipsi.scenes.chain(30_000)
    return lambda: pickle.dumps(long)


def built(scene: phipsi.Scene) -> Call:
    builder = phipsi.SceneBuilder().link("base")
    for k in range(40_000):
        builder.link(f"l{k}", 1.0, (1, 0, 0)).joint(f"j{k}", "revolute", "base", f"l{k}")
    return builder.build


def of_text(scene: phipsi.Scene) -> Call:
    text = '<robot name="r">' + "".join(f'<link name="l{k}"/>' for k in range(100_000)) + "</robot>"
    return lambda: phipsi.Scene.from_urdf(text)


def exact_of(scene: phipsi.Scene) -> _core.Exact:
    zero = np.full(scene.nv, 0.1)
    return _core.Exact(scene, "forward dynamics", zero, zero, zero)


def measured(scene: phipsi.Scene, repeats: int) -> object:
    states = np.full((2, scene.nv), 0.1)
    reference = _core.reference(scene, states, states, states)
    return _core.measure(scene, "covariance", states, states, states, reference, repeats)


def in_steps(scene: phipsi.Scene) -> Call:
    tau = np.broadcast_to(np.zeros(scene.nv), (10**7, scene.nv))
    return lambda: scene.simulate(np.zeros(scene.nq), np.zeros(scene.nv), dt=1e-3, steps=10**7, tau_steps=tau, record_every=10**7)


def rates(q: np.ndarray) -> np.ndarray:
    return np.zeros(q.shape[-1])


def observed(robots: int = 1) -> Callable[[phipsi.Scene], Call]:
    """An observer of a chain of 1000 joints, or of many robots, with its covariances."""

    def prepare(scene: phipsi.Scene) -> Call:
        own = phipsi.scenes.chain(1000) if robots == 1 else scene
        q, readings = np.zeros((robots, own.nq)), {"encoder": np.zeros(own.nq)}

        def call() -> None:
            observer = own.observer(1e-3, [phipsi.estimation.Encoder(noise=1e-3)], q=q, torque_noise=0.1, history=0)
            while True:
                observer.step(np.zeros(own.nv), readings)

        return call

    return prepare


LARGE: dict[str, Large] = {
    "observer of a long chain": Large("scene", observed()),
    "observer of many robots": Large("q", observed(robots=20_000)),
    "inverse kinematics of a long chain": Large(
        "scene", of_long_chain(lambda scene, q: scene.inverse_kinematics(phipsi.tasks.Position(scene.link_names[-1], (1, 0, 0))))
    ),
    "forward_dynamics": Large("q, qd", broadcast("forward_dynamics")),
    "inverse_dynamics": Large("q, qd", broadcast("inverse_dynamics")),
    "bias_torque": Large("q, qd", broadcast("bias_torque")),
    "energy": Large("q, qd", broadcast("energy")),
    "momentum": Large("q, qd", broadcast("momentum")),
    "integrate": Large("q, v", broadcast("integrate")),
    "difference": Large("q0, q1", broadcast("difference", "nq")),
    "estimate of a product": Large("q, qd", broadcast("estimate")),
    "estimate": Large("q", batch(50_000, lambda scene, q: scene.estimate(q, rates(q), rates(q), covariance=True))),
    "estimate, dense": Large(
        "q", batch(50_000, lambda scene, q: scene.estimate(q, rates(q), rates(q), covariance=True, method="batch"))
    ),
    "inverse_dynamics_derivatives": Large(
        "q", batch(300_000, lambda scene, q: scene.inverse_dynamics_derivatives(q, rates(q), rates(q)))
    ),
    "forward_dynamics_derivatives": Large(
        "q", batch(300_000, lambda scene, q: scene.forward_dynamics_derivatives(q, rates(q), rates(q)))
    ),
    "coriolis_matrix": Large("q", batch(10**6, lambda scene, q: scene.coriolis_matrix(q, rates(q)))),
    "mass_matrix_derivative": Large("q", batch(10**6, lambda scene, q: scene.mass_matrix_derivative(q, rates(q)))),
    "inverse_dynamics_jvp": Large("q, qd", broadcast("inverse_dynamics_jvp")),
    "forward_dynamics_jvp": Large("q, qd", broadcast("forward_dynamics_jvp")),
    "inverse_dynamics_hvp": Large(
        "q", batch(10**6, lambda scene, q: scene.inverse_dynamics_hvp(q, rates(q), *[rates(q)] * 5))
    ),
    "forward_dynamics_hvp": Large(
        "q", batch(10**6, lambda scene, q: scene.forward_dynamics_hvp(q, rates(q), *[rates(q)] * 5))
    ),
    "inverse_dynamics_vjp": Large(
        "q", batch(2 * 10**6, lambda scene, q: scene.inverse_dynamics_vjp(q, rates(q), rates(q), rates(q)))
    ),
    "forward_dynamics_vjp": Large(
        "q", batch(10**6, lambda scene, q: scene.forward_dynamics_vjp(q, rates(q), rates(q), rates(q), parameters=True))
    ),
    "forward_dynamics_variance": Large(
        "q, qd",
        lambda scene: lambda: scene.forward_dynamics_variance(
            np.zeros((30_000, 1, scene.nq)), np.zeros((30_000, scene.nv)), np.zeros(scene.nv), torque=1.0
        ),
    ),
    "inverse_dynamics_variance": Large(
        "q, qd",
        lambda scene: lambda: scene.inverse_dynamics_variance(
            np.zeros((30_000, 1, scene.nq)), np.zeros((30_000, scene.nv)), np.zeros(scene.nv), torque=1.0
        ),
    ),
    "regressor": Large("q", batch(10**6, lambda scene, q: scene.regressor(q, rates(q), rates(q)))),
    "identify": Large("q", in_float32(8_000_000, lambda scene, q: scene.identify(q, q, q, q))),
    "inverse_kinematics": Large(
        "q0",
        batch(10**6, lambda scene, q: scene.inverse_kinematics(phipsi.tasks.Position("link6", np.ones(3)), q, covariance=True)),
    ),
    "inverse_kinematics_rates": Large(
        "q",
        batch(10**6, lambda scene, q: scene.inverse_kinematics_rates(phipsi.tasks.Position("link6", np.ones(3)), q, dt=0.1)),
        room=40,
    ),
    "linearize": Large("q", batch(150_000, lambda scene, q: scene.linearize(q, rates(q), rates(q)))),
    "mass_matrix": Large("q", batch(10**6, lambda scene, q: scene.mass_matrix(q))),
    "mass_matrix, float32": Large("q", batch(2 * 10**6, lambda scene, q: scene.mass_matrix(q, dtype=np.float32))),
    "mass_matrix_inverse": Large("q", batch(10**6, lambda scene, q: scene.mass_matrix_inverse(q))),
    "poses": Large("q", batch(10**6, lambda scene, q: scene.poses(q))),
    "placements": Large("q", batch(10**6, lambda scene, q: scene.placements(q))),
    "jacobian": Large("q", batch(10**6, lambda scene, q: scene.jacobian(q, "link3"))),
    "gravity_torque": Large("q", batch(10**6, lambda scene, q: scene.gravity_torque(q)), room=40),
    "placement": Large("q", batch(10**6, lambda scene, q: scene.placement(q, "link3")), room=80),
    "placement of many links": Large("link", lambda scene: lambda: scene.placement(np.zeros(7), ["link3"] * 3 * 10**5), room=40),
    "velocity": Large("q, qd", broadcast("velocity", link="link3")),
    "acceleration": Large("q, qd", broadcast("acceleration", link="link3")),
    "jacobian_rate": Large("q, qd", broadcast("jacobian_rate", link="link3")),
    "jacobian_rate_product": Large("q, qd", broadcast("jacobian_rate_product", link="link3")),
    "velocity_derivatives": Large("q, qd", broadcast("velocity_derivatives", link="link3")),
    "acceleration_derivatives": Large("q, qd", broadcast("acceleration_derivatives", link="link3")),
    "jacobian_derivatives": Large("q", batch(10**6, lambda scene, q: scene.jacobian_derivatives(q, "link3"))),
    "center_of_mass": Large("q", batch(2 * 10**6, lambda scene, q: scene.center_of_mass(q)), room=30),
    "center_of_mass_velocity": Large("q, qd", broadcast("center_of_mass_velocity")),
    "center_of_mass_acceleration": Large("q, qd", broadcast("center_of_mass_acceleration")),
    "center_of_mass_jacobian": Large("q", batch(10**6, lambda scene, q: scene.center_of_mass_jacobian(q)), room=100),
    "centroidal_momentum_matrix": Large("q", batch(10**6, lambda scene, q: scene.centroidal_momentum_matrix(q))),
    "centroidal_momentum_matrix_rate": Large("q, qd", broadcast("centroidal_momentum_matrix_rate")),
    "centroidal_momentum_derivatives": Large("q, qd", broadcast("centroidal_momentum_derivatives")),
    "kinetic_energy": Large("q, qd", broadcast("kinetic_energy")),
    "potential_energy": Large("q", batch(4 * 10**6, lambda scene, q: scene.potential_energy(q)), room=20),
    "loops.error": Large("q", through_connections("loops.error", 0, 10**7), room=100),
    "loops.jacobian": Large("q", through_connections("loops.jacobian", 0, 2 * 10**6)),
    "loops.bias": Large("q", through_connections("loops.bias", 1, 10**7), room=100),
    "distances": Large("q", with_shapes(3 * 10**7), room=100),
    "contacts.gaps": Large("q", on_the_ground("contacts.gaps", 0, 3 * 10**7), room=100),
    "contacts.velocities": Large("q", on_the_ground("contacts.velocities", 1, 10**7), room=100),
    "contacts.gram": Large("q", on_the_ground("contacts.gram", 0, 3 * 10**6), room=100),
    "loops.dynamics": Large("q", through_connections("loops.dynamics", 2, 3 * 10**6)),
    "loops.project": Large("q", through_connections("loops.project", 0, 5 * 10**6)),
    "loops.inverse_dynamics": Large("q", through_connections("loops.inverse_dynamics", 2, 3 * 10**6)),
    "loops.mass_matrix_inverse": Large("q", through_connections("loops.mass_matrix_inverse", 0)),
    "operational_inverse_inertia": Large("q", batch(10**6, lambda scene, q: scene.operational_inverse_inertia(q, "link3"))),
    "operational_inertia": Large("q", batch(10**6, lambda scene, q: scene.operational_inertia(q, "link6"))),
    "many links": Large(
        "links",
        lambda scene: lambda: scene.operational_inverse_inertia(np.zeros(7), ["link3"] * 10_000),
        covers=("operational_inverse_inertia.links",),
    ),
    "inertia of many links": Large(
        "links",
        lambda scene: lambda: scene.operational_inertia(np.zeros(7), ["link3"] * 10_000),
        covers=("operational_inertia.links",),
    ),
    "many directions": Large(
        "directions",
        lambda scene: lambda: scene.operational_inertia(np.zeros(7), "link3", directions=np.ones((10_000, 6))),
        covers=("operational_inertia.directions",),
    ),
    "numbers to convert": Large("q", batch(10**6, lambda scene, q: scene.bias_torque(q[:, ::-1], rates(q))), room=40),
    "numbers in a list": Large("q", lambda scene: lambda: scene.bias_torque([[0.0] * 7] * 10**6, np.zeros(7)), room=40),
    "simulate": Large(
        "steps",
        lambda scene: lambda: scene.simulate(np.zeros(7), np.zeros(7), dt=1e-3, steps=10**12),
        covers=("simulate.steps", "simulate.record_every"),
    ),
    "optimize": Large(
        "steps",
        lambda scene: lambda: scene.optimize(np.zeros(7), dt=1e-3, steps=10**11, costs=phipsi.control.Effort(1.0)),
        covers=("optimize.steps",),
    ),
    "some steps": Large("steps", lambda scene: lambda: scene.simulate(np.zeros(7), np.zeros(7), dt=1e-3, steps=4 * 10**6)),
    "simulate, a batch": Large(
        "q, qd", batch(10**6, lambda scene, q: scene.simulate(q, rates(q), dt=1e-3, steps=1, record_every=2))
    ),
    "simulate, torques": Large("tau_steps", in_steps),
    "simulate_vjp": Large(
        "q",
        batch(10**6, lambda scene, q: scene.simulate_vjp(q[:, None], *np.zeros((3, 1, 7)), dt=1e-3, steps=0)),
        covers=("simulate_vjp.steps", "simulate_vjp.record_every"),
    ),
    "simulator": Large("q, qd", batch(10**6, lambda scene, q: scene.simulator(q, rates(q), dt=1e-3))),
    "factor": Large("q", batch(50_000, lambda scene, q: scene.factor(q))),
    "factor.update": Large("q", of_factor(4_000, lambda factor, q: factor.update(q + 0.1)), room=15),
    "factor.solve": Large("x", of_factor(200, lambda factor, q: factor.solve(np.zeros((2**15, 1, 7))))),
    "factor.mul": Large("x", of_factor(200, lambda factor, q: factor.mul(np.zeros((2**15, 1, 7))))),
    "operator @ x": Large("x", of_factor(200, lambda factor, q: factor.phi.matvec(np.zeros((2**12, 1, 42))))),
    "operator, Lambda": Large("q", of_factor(4_000, lambda factor, q: factor.Lambda.matvec(np.zeros(42))), room=8),
    "operator.toarray": Large("q", of_factor(4_000, lambda factor, q: factor.phi.toarray()), room=40),
    "sample": Large("samples", of_model(lambda model: model.sample(10**10, seed=1)), covers=("sample.samples",)),
    "some samples": Large("samples", of_model(lambda model: model.sample(10**6, seed=1))),
    "sample_torque": Large(
        "samples", of_model(lambda model: model.sample_torque(10**11, seed=1)), covers=("sample_torque.samples",)
    ),
    "some sampled torques": Large("samples", of_model(lambda model: model.sample_torque(10**7, seed=1))),
    "random_model.mass_matrix": Large(
        "replicates",
        of_model(lambda model: model.mass_matrix(2**35, seed=1, method="sobol", replicates=2**35)),
        covers=("mass_matrix.samples", "mass_matrix.replicates"),
    ),
    "mass matrix of a long chain": Large(
        "scene", of_long_chain(lambda scene, q: scene.random_model(q).mass_matrix(method="sigma-points"))
    ),
    "chain": Large("n", lambda scene: lambda: phipsi.scenes.chain(10**11), covers=("chain.n",)),
    "random_configuration": Large(
        "size", lambda scene: lambda: scene.random_configuration(0, size=10**11), covers=("random_configuration.size",)
    ),
    "some links": Large("n", lambda scene: lambda: phipsi.scenes.chain(200_000)),
    "extreme": Large(
        "bodies", lambda scene: lambda: phipsi.scenes.extreme("heavy-tip", bodies=100_000), covers=("extreme.bodies",)
    ),
    "extreme.value": Large("bodies", lambda scene: lambda: phipsi.scenes.extreme("long-chain", 1e5)),
    "build": Large("links", built, room=50),
    "from_urdf": Large("source", of_text, room=8),
    "unpickled": Large("pickled scene", unpickled, room=60),
    "pickled": Large("scene", pickled, room=60),
    "a long chain": Large("scene", of_long_chain(lambda scene, q: scene.forward_dynamics(q, q, q))),
    "a long chain's mass": Large("scene", of_long_chain(lambda scene, q: scene.estimate(q, q, q))),
    "growth": Large("bodies", lambda scene: lambda: _core.growth(10**11, 1), covers=("growth.bodies",)),
    "growth.repeats": Large("repeats", lambda scene: lambda: _core.growth(2, 10**13), covers=("growth.repeats",)),
    "operator_growth": Large("bodies", lambda scene: lambda: _core.operator_growth(10**11, 1), covers=("operator_growth.bodies",)),
    "operator_growth.repeats": Large(
        "repeats", lambda scene: lambda: _core.operator_growth(2, 10**13), covers=("operator_growth.repeats",)
    ),
    "emergence": Large(
        "repeats",
        lambda scene: lambda: _core.emergence(scene, np.zeros(7), "recursion", 1, 0, 10**13),
        covers=("emergence.repeats",),
    ),
    "measure": Large("repeats", lambda scene: lambda: measured(scene, 10**13), covers=("measure.repeats",)),
    "reference": Large("q", batch(10**6, lambda scene, q: _core.reference(scene, q, q, q)), room=80),
    "exact.time": Large(
        "repeats", lambda scene: lambda: exact_of(scene).time("covariance form", 10**13), covers=("time.repeats",)
    ),
}

#: Parameters that determine computing time, or select elements, but do not determine memory.
NO_MEMORY = {"compare.states", "connect.length", "emergence.samples", "sensitivity.draws", "step.steps", "reset.states", "with_inertias.links", "forward_dynamics_variance.links"}


def main(name: str) -> None:
    import resource

    large = LARGE[name]
    # Threads need additional address space.
    phipsi.set_num_threads(1)
    call = large.prepare(phipsi.scenes.chain(7))
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + large.room * MEGABYTE, resource.RLIM_INFINITY))
    try:
        call()
    except (MemoryError, phipsi.errors.ArgumentError) as error:
        found = {"class": type(error).__name__, "text": str(error), "argument": getattr(error, "argument", None)}
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        # Small calls still work after any error.
        small = phipsi.scenes.chain(2)
        found["after"] = small.forward_dynamics(np.zeros(2), np.zeros(2), np.zeros(2)).shape == (2,)
        print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1])
