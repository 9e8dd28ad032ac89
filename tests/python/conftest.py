"""Random scenes with all types of joints, and states of them, from a seed; what every run of the tests does: it ends, and
it records the tests that were skipped.
"""

from __future__ import annotations

import faulthandler
import json
import os
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import phipsi

#: Time of one test, s, after which the run ends with the stack of each thread. Waits in tests have timeouts of their own;
#: this one also ends a test whose compiled code does not return. Processor load of other programs counts.
HANGING = 1800
#: Environment variable: a folder for one file per run of the tests, which .ci/check_skips.py reads: why each test was
#: skipped, or "" if it ran.
OUTCOMES = "PHIPSI_TEST_OUTCOMES"


class Outcomes:
    """Records the reason of each skip, also of files that are skipped as a whole."""

    def __init__(self, folder: Path) -> None:
        self.file, self.reasons = folder / f"{Path(sys.prefix).name}-{os.getpid()}.json", dict[str, str]()

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.skipped:
            self.reasons[report.nodeid] = report.longrepr[2]  # type: ignore[index]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.skipped and not hasattr(report, "wasxfail"):
            self.reasons[report.nodeid] = report.longrepr[2]  # type: ignore[index]
        else:
            self.reasons.setdefault(report.nodeid, "")

    def pytest_sessionfinish(self) -> None:
        self.file.parent.mkdir(parents=True, exist_ok=True)
        self.file.write_text(json.dumps(self.reasons, indent=1), encoding="utf-8")


STDERR = pytest.StashKey[int]()


def pytest_configure(config: pytest.Config) -> None:
    # A duplicate of stderr, because the tests run while it is redirected.
    with config.pluginmanager.getplugin("capturemanager").global_and_fixture_disabled():
        config.stash[STDERR] = os.dup(2)
    if folder := os.environ.get(OUTCOMES):
        config.pluginmanager.register(Outcomes(Path(folder)))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    faulthandler.dump_traceback_later(HANGING, exit=True, file=item.config.stash[STDERR])
    try:
        return (yield)
    finally:
        faulthandler.cancel_dump_traceback_later()


@pytest.fixture
def interruptible() -> Iterator[None]:
    """SIGINT raises KeyboardInterrupt: a background process of a shell, or one under nohup, may inherit that it is
    ignored.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


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
            lower=-1.0 - k % 18,  # larger whole numbers look like degrees
            upper=2.0 + k % 18,
            velocity=3.0 + k,
            effort=4.0 + k,
        )
        link(f"link{k}")
    return builder.build(floating_base=floating_base, gravity=gravity)


class State(NamedTuple):
    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray


#: Time after which a test does not wait any longer for another thread or process, s, on a busy machine.
PATIENCE = 300.0


def join(thread: threading.Thread) -> None:
    """Wait for a thread, which is a daemon so that Python can end without it."""
    thread.join(PATIENCE)
    assert not thread.is_alive(), f"{thread.name} did not end in {PATIENCE} s"


def at_once(work: Callable[[int], None], count: int) -> None:
    """Run work(0), work(1), ... on one thread each, and wait for all."""
    threads = [threading.Thread(target=work, args=(number,), daemon=True) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        join(thread)


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
    "centroidal_momentum_derivatives": 2,
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
        "poses": (scene.poses, (q,)),
        "gravity_torque": (scene.gravity_torque, (q,)),
        "placement": (lambda q: scene.placement(q, link), (q,)),
        "placement of several": (lambda q: scene.placement(q, [link, scene.link_names[0]]), (q,)),
        "velocity": (lambda q, qd: scene.velocity(q, qd, link, frame="world"), (q, qd)),
        "acceleration": (lambda q, qd, qdd: scene.acceleration(q, qd, qdd, link, at=POINT, kind="classical"), (q, qd, tau)),
        "jacobian": (lambda q: scene.jacobian(q, link), (q,)),
        "jacobian at a point": (lambda q: scene.jacobian(q, link, frame="local-world-aligned", at=POINT), (q,)),
        "jacobian_rate": (lambda q, qd: scene.jacobian_rate(q, qd, link, frame="world"), (q, qd)),
        "jacobian_rate_product": (lambda q, qd: scene.jacobian_rate_product(q, qd, link), (q, qd)),
        "velocity_derivatives": (lambda q, qd: scene.velocity_derivatives(q, qd, link, frame="world"), (q, qd)),
        "acceleration_derivatives": (
            lambda q, qd, qdd: scene.acceleration_derivatives(q, qd, qdd, link, at=POINT, kind="classical"),
            (q, qd, tau),
        ),
        "jacobian_derivatives": (lambda q: scene.jacobian_derivatives(q, link, frame="local-world-aligned"), (q,)),
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
    "poses",
    "gravity_torque",
    "placement",
    "placement of several",
    "velocity",
    "acceleration",
    "jacobian",
    "jacobian at a point",
    "jacobian_rate",
    "jacobian_rate_product",
    "velocity_derivatives",
    "acceleration_derivatives",
    "jacobian_derivatives",
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
