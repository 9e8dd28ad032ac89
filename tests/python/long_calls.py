"""Long calls, and the child process that is interrupted during one of them.

``python long_calls.py NAME`` starts the call, sends itself SIGINT shortly afterwards, and prints as JSON the
processor time until the call ended, and its outcome. Processor time is independent of other load on the machine.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable

import numpy as np

import phipsi
from phipsi import _core

Call = Callable[[], object]

#: Time between the start of a call and the signal, s.
BEFORE = 0.1


def chain(n: int) -> phipsi.Scene:
    return phipsi.scenes.chain(n)


def states(scene: phipsi.Scene, count: int) -> np.ndarray:
    return np.random.default_rng(1).uniform(-1.0, 1.0, (count, scene.nq))


def batch(bodies: int, count: int, call: Callable[[phipsi.Scene, np.ndarray], object]) -> Callable[[], Call]:
    def prepare() -> Call:
        scene = chain(bodies)
        q = states(scene, count)
        return lambda: call(scene, q)

    return prepare


def of_model(call: Callable[[phipsi.RandomModel], object], bodies: int = 7) -> Callable[[], Call]:
    def prepare() -> Call:
        model = chain(bodies).random_model(np.full(bodies, 0.3))
        return lambda: call(model)

    return prepare


def of_factor(bodies: int, count: int, call: Callable[[phipsi.Factor, np.ndarray], object]) -> Callable[[], Call]:
    def prepare() -> Call:
        scene = chain(bodies)
        q = states(scene, count)
        factor = scene.factor(q)
        return lambda: call(factor, q)

    return prepare


def of_one(bodies: int, call: Callable[[phipsi.Scene, np.ndarray], object]) -> Callable[[], Call]:
    def prepare() -> Call:
        scene = chain(bodies)
        return lambda: call(scene, np.full(bodies, 0.2))

    return prepare


def looped(count: int, call: Callable[[phipsi.Scene, np.ndarray], object]) -> Callable[[], Call]:
    def prepare() -> Call:
        tree = chain(30)
        scene = tree.to_builder().connect("tip", "point", "link29", xyz=(0, 0, 0.3)).build()
        q = np.tile(scene.loops.project(states(scene, 1)[0] * 0.1).q, (count, 1))
        return lambda: call(scene, q)

    return prepare


def on_the_ground(count: int, call: Callable[[phipsi.Scene, np.ndarray], object]) -> Callable[[], Call]:
    def prepare() -> Call:
        scene = chain(30).to_builder().contact("tip", "link29", xyz=(0.1, 0, 0.3), friction=0.5).build()
        q = states(scene, count)
        return lambda: call(scene, q)

    return prepare


def with_shapes(count: int) -> Callable[[], Call]:
    def prepare() -> Call:
        builder = chain(30).to_builder().collider("tip", phipsi.shapes.Sphere(0.1), link="link29")
        scene = builder.collider("ground", phipsi.shapes.HalfSpace(xyz=(0, 0, -100.0))).build()
        q = states(scene, count)
        return lambda: scene.distances(q)

    return prepare


def in_doubt() -> Call:
    """States that take a thousand times the expected time."""
    case = phipsi.scenes.extreme("heavy-tip", 1e12, bodies=30)
    many = np.tile(case.q, (100_000, 1))
    return lambda: case.scene.forward_dynamics(many, case.qd, case.tau)


def urdf() -> Call:
    links = "".join(f'<link name="l{k}"/>' for k in range(100_000))
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l0"/><child link="l{k}"/><limit effort="1" velocity="1"/></joint>'
        for k in range(1, 100_000)
    )
    text = f'<robot name="r">{links}{joints}</robot>'
    return lambda: phipsi.Scene.from_urdf(text)


def built() -> Call:
    builder = phipsi.SceneBuilder().link("base")
    for k in range(150_000):
        builder.link(f"l{k}", 1.0, (1, 0, 0)).joint(f"j{k}", "revolute", "base", f"l{k}")
    return builder.build


def reported() -> Call:
    scene = chain(7)
    q = states(scene, 64)
    reference = _core.reference(scene, q, q, q)
    return lambda: _core.measure(scene, "covariance", q, q, q, reference, 10**7)


def exact() -> _core.Exact:
    one = np.full(7, 0.3)
    return _core.Exact(chain(7), "forward dynamics", one, one, one)


def moving(scene: phipsi.Scene, q: np.ndarray, steps: int) -> phipsi.Trajectory:
    return scene.simulate(q, np.zeros(scene.nv), dt=1e-6, steps=steps, record_every=steps)


def many_resets(scene: phipsi.Scene, q: np.ndarray) -> None:
    simulator = scene.simulator(q, dt=1e-3)
    for _ in range(50):
        simulator.reset(q)


def backward(record_every: int) -> Callable[[], Call]:
    def prepare() -> Call:
        scene = chain(30)
        q = states(scene, 2000)
        path = scene.simulate(q, np.zeros_like(q), dt=1e-6, steps=200, record_every=record_every)
        cotangents = np.ones((2, *path.qd.shape))
        return lambda: path.vjp(*cotangents)

    return prepare


LONG: dict[str, Callable[[], Call]] = {
    "forward_dynamics": batch(30, 300_000, lambda scene, q: scene.forward_dynamics(q, q, q, form="square-root")),
    "forward_dynamics, auto": batch(30, 500_000, lambda scene, q: scene.forward_dynamics(q, q, q)),
    "forward_dynamics, in doubt": in_doubt,
    "forward_dynamics, errors=nan": batch(
        30, 300_000, lambda scene, q: scene.forward_dynamics(q, q, q, form="square-root", errors="nan")
    ),
    "inverse_dynamics": batch(300, 200_000, lambda scene, q: scene.inverse_dynamics(q, q, q)),
    "bias_torque": batch(300, 200_000, lambda scene, q: scene.bias_torque(q, q)),
    "mass_matrix": batch(100, 15_000, lambda scene, q: scene.mass_matrix(q)),
    "mass_matrix_inverse": batch(100, 15_000, lambda scene, q: scene.mass_matrix_inverse(q)),
    "inverse_dynamics_derivatives": batch(300, 400, lambda scene, q: scene.inverse_dynamics_derivatives(q, q, q)),
    "forward_dynamics_derivatives": batch(300, 200, lambda scene, q: scene.forward_dynamics_derivatives(q, q, q)),
    "forward_dynamics_derivatives, one": of_one(1500, lambda scene, q: scene.forward_dynamics_derivatives(q, q, q)),
    "coriolis_matrix": batch(300, 800, lambda scene, q: scene.coriolis_matrix(q, q)),
    "mass_matrix_derivative": batch(300, 800, lambda scene, q: scene.mass_matrix_derivative(q, q)),
    "inverse_dynamics_jvp": batch(300, 200_000, lambda scene, q: scene.inverse_dynamics_jvp(q, q, q, q, q, q)),
    "forward_dynamics_jvp": batch(30, 100_000, lambda scene, q: scene.forward_dynamics_jvp(q, q, q, q, q, q)),
    "inverse_dynamics_vjp": batch(300, 200_000, lambda scene, q: scene.inverse_dynamics_vjp(q, q, q, q)),
    "forward_dynamics_vjp": batch(30, 100_000, lambda scene, q: scene.forward_dynamics_vjp(q, q, q, q)),
    "forward_dynamics_vjp, parameters": batch(
        30, 50_000, lambda scene, q: scene.forward_dynamics_vjp(q, q, q, q, parameters=True)
    ),
    "inverse_dynamics_hvp": batch(30, 50_000, lambda scene, q: scene.inverse_dynamics_hvp(q, q, q, q, q, q, q)),
    "forward_dynamics_hvp": batch(30, 30_000, lambda scene, q: scene.forward_dynamics_hvp(q, q, q, q, q, q, q)),
    "poses": batch(7, 400_000, lambda scene, q: scene.poses(q)),
    "placements": batch(7, 400_000, lambda scene, q: scene.placements(q)),
    "jacobian": batch(30, 300_000, lambda scene, q: scene.jacobian(q, "link29")),
    "gravity_torque": batch(300, 200_000, lambda scene, q: scene.gravity_torque(q)),
    "placement": batch(30, 300_000, lambda scene, q: scene.placement(q, "link29")),
    "acceleration": batch(30, 300_000, lambda scene, q: scene.acceleration(q, q, q, "link29")),
    "jacobian_rate": batch(30, 300_000, lambda scene, q: scene.jacobian_rate(q, q, "link29")),
    "acceleration_derivatives": batch(30, 100_000, lambda scene, q: scene.acceleration_derivatives(q, q, q, "link29")),
    "jacobian_derivatives": batch(30, 20_000, lambda scene, q: scene.jacobian_derivatives(q, "link29")),
    "centroidal_momentum_matrix_rate": batch(30, 200_000, lambda scene, q: scene.centroidal_momentum_matrix_rate(q, q)),
    "energy": batch(100, 300_000, lambda scene, q: scene.energy(q, q)),
    "momentum": batch(100, 300_000, lambda scene, q: scene.momentum(q, q)),
    "integrate": batch(300, 200_000, lambda scene, q: scene.integrate(q, q)),
    "difference": batch(300, 200_000, lambda scene, q: scene.difference(q, q)),
    "estimate": batch(7, 150_000, lambda scene, q: scene.estimate(q, q, q, covariance=True)),
    "estimate, dense": batch(30, 2_000, lambda scene, q: scene.estimate(q, q, q, covariance=True, method="batch")),
    "estimate, dense, one": of_one(300, lambda scene, q: scene.estimate(q, q, q, covariance=True, method="batch")),
    "distances": with_shapes(1_000_000),
    "contacts.gaps": on_the_ground(3_000_000, lambda scene, q: scene.contacts.gaps(q)),
    "contacts.velocities": on_the_ground(1_000_000, lambda scene, q: scene.contacts.velocities(q, np.zeros(30))),
    "contacts.gram": on_the_ground(100_000, lambda scene, q: scene.contacts.gram(q)),
    "loops.error": looped(1_000_000, lambda scene, q: scene.loops.error(q)),
    "loops.jacobian": looped(300_000, lambda scene, q: scene.loops.jacobian(q)),
    "loops.bias": looped(1_000_000, lambda scene, q: scene.loops.bias(q, np.zeros(30))),
    "loops.dynamics": looped(100_000, lambda scene, q: scene.loops.dynamics(q, np.zeros(30), np.zeros(30))),
    "loops.project": looped(100_000, lambda scene, q: scene.loops.project(q + 0.01)),
    "loops.inverse_dynamics": looped(100_000, lambda scene, q: scene.loops.inverse_dynamics(q, np.zeros(30), np.zeros(30))),
    "loops.mass_matrix_inverse": looped(30_000, lambda scene, q: scene.loops.mass_matrix_inverse(q)),
    "simulate through connections": looped(1_000, lambda scene, q: moving(scene, q, 10**5)),
    "operational_inverse_inertia": batch(30, 300_000, lambda scene, q: scene.operational_inverse_inertia(q, "link29")),
    "operational_inertia": batch(30, 300_000, lambda scene, q: scene.operational_inertia(q, "link29")),
    "operational_inverse_inertia of many links": of_one(
        100, lambda scene, q: scene.operational_inverse_inertia(q, list(scene.link_names) * 10)
    ),
    "check": of_one(200, lambda scene, q: [scene.check(q) for _ in range(20)]),
    "factor": batch(7, 300_000, lambda scene, q: scene.factor(q)),
    "factor.update": of_factor(7, 10_000, lambda factor, q: [factor.update(q + shift) for shift in np.linspace(0, 1, 500)]),
    "factor.solve": of_factor(300, 100, lambda factor, q: factor.solve(np.ones((2000, 1, 300)))),
    "operator @ x": of_factor(300, 100, lambda factor, q: factor.K.matvec(np.ones((2000, 1, 300)))),
    "operator.toarray": of_factor(30, 1000, lambda factor, q: factor.phi.toarray()),
    "operator.toarray, one": of_factor(300, 1, lambda factor, q: factor.S.toarray()),
    "simulate": batch(7, 3, lambda scene, q: moving(scene, q, 10**9)),
    "simulate, long steps": batch(300, 30_000, lambda scene, q: moving(scene, q, 10)),
    "simulate_vjp": backward(1),
    "simulate_vjp, few rows": backward(200),
    "simulator": batch(300, 100_000, lambda scene, q: [scene.simulator(q, dt=1e-3) for _ in range(10)]),
    "simulator.step": batch(7, 3, lambda scene, q: scene.simulator(q, dt=1e-6).step(steps=10**9)),
    "simulator.step, long steps": batch(300, 30_000, lambda scene, q: scene.simulator(q, dt=1e-6).step(steps=10)),
    "simulator.reset": batch(300, 50_000, lambda scene, q: many_resets(scene, q)),
    "sample": of_model(lambda model: model.sample(10**6, seed=1)),
    "sample_torque": of_model(lambda model: model.sample_torque(3 * 10**7, seed=1)),
    "sample_torque of a long chain": of_model(lambda model: model.sample_torque(2000, seed=1), bodies=20_000),
    "mass_matrix by samples": of_model(lambda model: model.mass_matrix(10**9, seed=1)),
    "mass_matrix by many samples": of_model(lambda model: model.mass_matrix(2**40, seed=1)),
    "mass_matrix by Sobol points": of_model(lambda model: model.mass_matrix(2**33, seed=1, method="sobol")),
    "mass_matrix by sigma points": of_model(lambda model: model.mass_matrix(method="sigma-points"), bodies=1500),
    "chain": lambda: lambda: chain(400_000),
    "extreme": lambda: lambda: [phipsi.scenes.extreme("heavy-tip", bodies=100_000) for _ in range(20)],
    "build": built,
    "from_urdf": urdf,
    "inverse_kinematics": of_one(
        6, lambda scene, q: scene.inverse_kinematics(phipsi.tasks.Position(scene.link_names[-1], (99.0, 0.0, 0.0)), starts=10**7)
    ),
    "inverse_kinematics of a long chain": of_one(
        300, lambda scene, q: scene.inverse_kinematics(phipsi.tasks.Position(scene.link_names[-1], (999.0, 0.0, 0.0)), starts=10**4)
    ),
    "lock": of_one(5_000, lambda scene, q: scene.lock(scene.joint_names, q)),
    "growth": lambda: lambda: _core.growth(1000, 10**6),
    "operator_growth": lambda: lambda: _core.operator_growth(1000, 10**5),
    "emergence": lambda: lambda: _core.emergence(chain(7), np.zeros(7), "monte-carlo", 10**9, 1, 5),
    "measure": reported,
    "reference": batch(30, 100_000, lambda scene, q: _core.reference(scene, q, q, q)),
    "exact.sensitivity": lambda: lambda: exact().sensitivity(10**7),
    "exact.time": lambda: lambda: exact().time("covariance form", 10**7),
}


def main(name: str) -> None:
    # A background process of a shell inherits ignored SIGINT.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    began = time.process_time()
    chain(2000)
    found: dict[str, object] = {"raised": None, "pace": time.process_time() - began}
    call = LONG[name]()
    sent: list[float] = []

    def send() -> None:
        time.sleep(BEFORE)
        sent.append(time.process_time())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Thread(target=send)
    timer.start()
    try:
        # Repeated if a fast machine completed before the signal. A signal between two calls raises here.
        while not sent:
            call()
        time.sleep(1.0)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    except KeyboardInterrupt as error:
        found.update(raised=type(error).__name__, late=time.process_time() - sent[0])
    timer.join(timeout=60)
    # An interrupted call can be repeated.
    small = chain(3)
    found["after"] = bool(np.isfinite(small.forward_dynamics(np.zeros((100, 3)), np.zeros(3), np.zeros(3))).all())
    print(json.dumps(found), flush=True)
    # No cleanup is necessary.
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1])
