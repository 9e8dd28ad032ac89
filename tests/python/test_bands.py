"""Trajectories with bands: columns against differences of simulations, torque noise against a sum over steps, checks by runs, and what is refused."""

from __future__ import annotations

import numpy as np
import phipsi
import pytest
from conftest import random_scene
from phipsi.errors import ArgumentError, ShapeError, UncertaintyWarning
from phipsi.estimation import MotionUncertainty
from phipsi.report.run import Run, over_time
from phipsi.report.structure import tree_of
from tolerances import assert_near

STEP = 1e-4
HOW = {"dt": 2e-3, "steps": 40, "method": "semi-implicit-euler", "limits": "report"}
METHODS = ("auto", "semi-implicit-euler", "rk4", "dormand-prince-5", "implicit-euler", "rosenbrock-2", "rosenbrock-3")


def differences(function: object) -> np.ndarray:
    """The derivative of a function of a number at zero, by central differences of fourth order."""
    return (8.0 * (function(STEP) - function(-STEP)) - (function(2.0 * STEP) - function(-2.0 * STEP))) / (12.0 * STEP)


def scene_and_start(floating_base: bool) -> tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray]:
    scene = random_scene(3, 6, kinds=("revolute", "spherical", "planar", "prismatic"), floating_base=floating_base, armature=0.1)
    rng = np.random.default_rng(1)
    q = scene.integrate(scene.neutral(), 0.5 * rng.normal(size=scene.nv))
    return scene, q, rng.normal(size=scene.nv), rng.normal(size=scene.nv)


@pytest.mark.parametrize(("floating_base", "method"), [(True, "semi-implicit-euler"), (True, "auto"), *((False, method) for method in METHODS)])
def test_the_start_is_propagated_exactly(floating_base: bool, method: str) -> None:
    scene, q, qd, tau = scene_and_start(floating_base)
    nv, how = scene.nv, HOW | {"method": method}
    rng = np.random.default_rng(2)
    root = 0.1 * rng.normal(size=(2 * nv, 2 * nv))
    # A floating base has no gains.
    held = np.arange(nv) >= (6 if floating_base else 0)
    law = phipsi.PD(3.0 * held, 0.2 * held, scene.neutral())
    forces = {"tau": tau, "damping": 0.3, "friction": 0.2, "friction_speed": 0.1, "stiffness": 0.4, "pd": law}
    path = scene.simulate(q, qd, **how, **forces, covariance=MotionUncertainty(initial=root @ root.T))

    def end(column: np.ndarray, by: float) -> np.ndarray:
        moved = scene.simulate(scene.integrate(q, by * column[:nv]), qd + by * column[nv:], **how, **forces)
        return np.concatenate([scene.difference(path.q[-1], moved.q[-1]), moved.qd[-1] - path.qd[-1]])

    columns = np.stack([differences(lambda by, column=column: end(column, by)) for column in root.T], axis=-1)
    expected = columns @ columns.T
    assert_near(path.bands.covariance[-1], expected, 1e-8 * float(np.max(np.abs(expected))))
    assert_near(path.bands.covariance[0], root @ root.T, 1e-12)
    assert_near(path.bands.q[-1], np.sqrt(np.diag(expected))[:nv], 1e-8 * float(np.max(expected)) ** 0.5)


@pytest.mark.parametrize(("method", "record_every"), [("semi-implicit-euler", 1), ("auto", 8), ("rk4", 1), ("rosenbrock-3", 5)])
def test_parameters_and_joints_are_propagated_exactly(method: str, record_every: int) -> None:
    scene, q, qd, tau = scene_and_start(False)
    how = HOW | {"method": method, "record_every": record_every}
    sigma = np.zeros((len(scene.body_names), 10, 10))
    # A change of the mass with its first moments and inertia: a link that is heavier by a share.
    link = scene.link(scene.body_names[-1])
    com = np.asarray(link.com)
    about = np.asarray(link.inertia) + link.mass * (com @ com * np.eye(3) - np.outer(com, com))
    share = 0.1 * np.array([link.mass, *(link.mass * com), about[0, 0], about[0, 1], about[1, 1], about[0, 2], about[1, 2], about[2, 2]])
    sigma[-1] = np.outer(share, share)
    joints = {"armature": 1e-4, "damping": 4e-4, "friction": 1e-4, "offset": 9e-4}
    forces = {"friction": 0.2, "friction_speed": 0.1, "damping": 0.3}
    path = scene.simulate(q, qd, **how, **forces, tau=tau, covariance=MotionUncertainty(parameters=sigma, joints=joints))

    def end(name: str, row: int, by: float) -> np.ndarray:
        own = {"armature": scene.armature.copy(), "damping": np.full(scene.nv, 0.3), "friction": np.full(scene.nv, 0.2), "friction_speed": 0.1}
        other, torque = scene, tau.copy()
        if name == "mass":
            other = scene.with_inertias({link.name: (link.mass * (1.0 + 0.1 * by), com, np.asarray(link.inertia) * (1.0 + 0.1 * by))})
        elif name == "offset":
            torque[row] -= by * 0.03
        else:
            own[name][row] += by * np.sqrt(joints[name])
        moved = other.simulate(q, qd, **how, **own, tau=torque)
        return np.concatenate([scene.difference(path.q[-1], moved.q[-1]), moved.qd[-1] - path.qd[-1]])

    places = [("mass", 0), *((name, row) for name in joints for row in range(scene.nv))]
    columns = np.stack([differences(lambda by, name=name, row=row: end(name, row, by)) for name, row in places], axis=-1)
    expected = columns @ columns.T
    assert_near(path.bands.covariance[-1], expected, 1e-7 * float(np.max(np.abs(expected))))


@pytest.mark.parametrize(("method", "record_every"), [("semi-implicit-euler", 1), ("rk4", 2), ("auto", 6)])
def test_torque_noise_is_a_sum_over_steps(method: str, record_every: int) -> None:
    scene, q, qd, tau = scene_and_start(False)
    how = HOW | {"steps": 6, "method": method, "record_every": record_every}
    torques = np.tile(tau, (6, 1))
    density = 0.3
    path = scene.simulate(q, qd, **how, tau_steps=torques, covariance=MotionUncertainty(torque_noise=density))

    def end(step: int, row: int, by: float) -> np.ndarray:
        other = torques.copy()
        other[step, row] += by
        moved = scene.simulate(q, qd, **how, tau_steps=other)
        return np.concatenate([scene.difference(path.q[-1], moved.q[-1]), moved.qd[-1] - path.qd[-1]])

    places = [(step, row) for step in range(6) for row in range(scene.nv)]
    columns = np.stack([differences(lambda by, step=step, row=row: end(step, row, by)) for step, row in places], axis=-1)
    expected = columns @ columns.T * density / how["dt"]
    assert_near(path.bands.covariance[-1], expected, 1e-8 * float(np.max(np.abs(expected))))


@pytest.mark.parametrize("method", ["semi-implicit-euler", "rk4"])
def test_a_batch_has_the_bands_of_its_states(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, how = phipsi.scenes.chain(3), HOW | {"method": method}
    q, target = 0.3 * np.random.default_rng(0).normal(size=(2, 4, 3))
    unsure = MotionUncertainty(initial=1e-4 * np.eye(6), torque_noise=0.1)
    monkeypatch.setattr("phipsi.estimation.trajectories.VALUES", 3000)  # several calls
    whole = scene.simulate(q, np.zeros(3), **how, pd=phipsi.PD(5.0, 0.5, target, 0.1 * target), covariance=unsure)
    for at in range(4):
        own = scene.simulate(q[at], np.zeros(3), **how, pd=phipsi.PD(5.0, 0.5, target[at], 0.1 * target[at]), covariance=unsure)
        assert_near(whole.bands.covariance[at], own.bands.covariance, 1e-13)


def test_the_default_simulation_has_bands_with_exact_friction_and_stops() -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    q, push = np.array([0.3, -0.6, 0.9, 0.1, 0.4, 0.0]), np.array([30.0, 0.0, 0.0, 2.0, 0.0, 0.0])
    friction = np.array([0.0, 5.0, 5.0, 1.0, 1.0, 1.0])
    given = {"dt": 2e-3, "steps": 50, "tau": scene.gravity_torque(q) + push, "friction": friction}
    unsure = MotionUncertainty(initial=np.full(12, 1e-8), joints={"friction": np.where(np.arange(6) == 3, 1e-4, 0.0)}, check="unscented")
    path = scene.simulate(q, np.zeros(6), **given, covariance=unsure)
    assert (path.limits, path.friction_speed, path.integrator) == ("stop", 0.0, "rk4")
    # The first and fourth joints slide; the others are held by friction, so that errors of their velocity vanish.
    assert_near(path.bands.ratio[-1, [0, 3, 6, 9]], np.ones(4), 1e-3)
    assert_near(path.bands.qd[-1, [1, 2, 4, 5]], np.zeros(4), 0.0)
    assert np.isnan(path.bands.ratio[-1, [7, 8, 10, 11]]).all()


def test_a_joint_that_friction_holds_is_reported() -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    q = np.array([0.3, -0.6, 0.9, 0.1, 0.4, 0.0])
    given = {"dt": 2e-3, "steps": 5, "tau": scene.gravity_torque(q), "friction": 1.0}
    with pytest.warns(UncertaintyWarning, match=f"covariance: found joint '{scene.joint_names[0]}' held by friction.*monte-carlo"):
        path = scene.simulate(q, np.zeros(6), **given, covariance=MotionUncertainty(torque_noise=0.1))
    assert_near(path.bands.qd, np.zeros((6, 6)), 0.0)
    # Sampled torques overcome friction: the variance of the bands is zero, that of the samples is not.
    unsure = MotionUncertainty(torque_noise=0.1, check="monte-carlo", samples=20)
    assert np.isposinf(scene.simulate(q, np.zeros(6), **given, covariance=unsure).bands.ratio[-1]).all()


def test_several_calls_give_the_bands_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    sigma = np.zeros((6, 10, 10))
    sigma[:, 0, 0] = 0.01
    # A fast motion: "auto" divides steps.
    given = {"dt": 0.05, "steps": 10, "limits": "report", "friction": 0.0, "covariance": MotionUncertainty(parameters=sigma, torque_noise=0.01)}
    whole = scene.simulate(np.full(6, 0.2), np.full(6, 3.0), **given)
    monkeypatch.setattr("phipsi.estimation.trajectories.VALUES", 1)
    assert_near(scene.simulate(np.full(6, 0.2), np.full(6, 3.0), **given).bands.covariance, whole.bands.covariance, 0.0)
    assert whole.substeps > 1


def pendulum() -> phipsi.Scene:
    """Two rods that swing in one plane."""
    builder = phipsi.SceneBuilder().link("base")
    for name, parent in (("upper", "base"), ("lower", "upper")):
        builder.link(name, 1.0, (0, 0, -0.25), np.diag([0.03, 0.03, 0.001]))
        builder.joint(f"to_{name}", "revolute", parent, name, xyz=(0, 0, -0.5), axis=(0, 1, 0))
    return builder.build()


def test_small_errors_have_a_ratio_of_one_and_large_ones_do_not() -> None:
    scene = pendulum()
    how = HOW | {"steps": 300}

    def ratio(size: float, check: str) -> np.ndarray:
        unsure = MotionUncertainty(initial=np.diag([size**2, size**2, 0.0, 0.0]), check=check, samples=400, seed=1)
        return scene.simulate([0.5, 0.4], [0.0, 0.0], **how, covariance=unsure).bands.ratio[-1]

    assert_near(ratio(1e-3, "unscented"), np.ones(4), 1e-3)
    # A variance of 400 draws: a standard error of 7 %.
    assert_near(ratio(1e-3, "monte-carlo"), np.ones(4), 0.4)
    assert float(np.max(np.abs(ratio(0.8, "unscented") - 1.0))) > 0.1


def test_a_covariance_of_parameters_is_taken_alone() -> None:
    scene = pendulum()
    sigma = np.zeros((2, 10, 10))
    sigma[:, 0, 0] = 1e-4
    given = scene.simulate([0.5, 0.4], [0.0, 0.0], **HOW, covariance=sigma).bands
    named = scene.simulate([0.5, 0.4], [0.0, 0.0], **HOW, covariance=MotionUncertainty(parameters=sigma)).bands
    assert_near(given.covariance, named.covariance, 0.0)
    assert given.ratio is None and float(given.q[-1].min()) > 0.0
    assert scene.simulate([0.5, 0.4], [0.0, 0.0], **HOW).bands is None


def test_the_page_of_a_simulation_draws_the_bands() -> None:
    scene = pendulum()
    path = scene.simulate([0.5, 0.4], [0.0, 0.0], **HOW, covariance=MotionUncertainty(torque_noise=0.1))
    plain = scene.simulate([0.5, 0.4], [0.0, 0.0], **HOW)
    with_bands, without = (over_time(Run(False, "pendulum", one, tree_of(scene), np.zeros_like(one.qd))).panels for one in (path, plain))
    assert [len(one.series) - len(other.series) for one, other in zip(with_bands, without, strict=True)] == [4, 4, 0]
    upper = next(one for one in with_bands[0].series if one.name == "95 % band of to_lower")
    assert_near(np.asarray(upper.y)[-1], path.q[-1, 1] + 1.96 * path.bands.q[-1, 1], 1e-12)


class TestArguments:
    scene = phipsi.scenes.chain(2)
    unsure = MotionUncertainty(torque_noise=0.1)

    def run(self, **changed: object) -> object:
        given = HOW | {"covariance": self.unsure} | changed
        return given.pop("scene", self.scene).simulate([0.5, 0.4], [0.0, 0.0], **given)

    def test_error_control(self) -> None:
        with pytest.raises(ArgumentError, match="accuracy.*expected None"):
            self.run(method="auto", accuracy=1e-6)

    def test_a_function_for_torques(self) -> None:
        with pytest.raises(ArgumentError, match="tau.*function"):
            self.run(tau=lambda t, q, qd: qd)

    def test_a_start_of_another_shape(self) -> None:
        with pytest.raises(ShapeError, match=r"initial.*\(4, 4\)"):
            self.run(covariance=MotionUncertainty(initial=np.eye(3)))

    def test_an_unknown_check(self) -> None:
        with pytest.raises(ArgumentError, match="check.*monte-carlo"):
            self.run(covariance=MotionUncertainty(check="twice"))

    def test_sigma_points_of_torque_noise(self) -> None:
        with pytest.raises(ArgumentError, match="check.*monte-carlo"):
            self.run(covariance=MotionUncertainty(torque_noise=0.1, check="unscented"))

    def test_stops(self) -> None:
        scene = phipsi.SceneBuilder().link("base").link("rod", 1.0, (0, 0, 0.5), np.eye(3)).joint("hinge", "revolute", "base", "rod", axis=(0, 1, 0), upper=0.1, lower=-1.0).build()
        with pytest.raises(ArgumentError, match="limits.*report"):
            scene.simulate([0.05], [3.0], dt=2e-3, steps=100, method="semi-implicit-euler", limits="stop", covariance=self.unsure)


@pytest.mark.parametrize("batch", [(0,), (2, 0)])
@pytest.mark.parametrize("kind", ["tree", "contact", "every second row"])
def test_no_states_have_no_bands(batch: tuple[int, ...], kind: str) -> None:
    scene = phipsi.scenes.chain(3)
    if kind == "contact":
        scene = scene.to_builder().contact("far", "link2", friction=0.5, xyz=(0, 0, 0.3), offset=-100.0).build()
    how = HOW | {"steps": 4, "record_every": 2 if kind == "every second row" else 1}
    for check in (None, "monte-carlo"):
        unsure = MotionUncertainty(initial=np.full(6, 1e-6), torque_noise=1e-4, check=check, samples=2)
        bands = scene.simulate(np.zeros((*batch, 3)), np.zeros(3), covariance=unsure, **how).bands
        assert bands is not None
        assert bands.covariance.shape == (*batch, 4 // how["record_every"] + 1, 6, 6)
