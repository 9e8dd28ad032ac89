"""Bands of simulations with rows: connections, mimic joints and contacts, compared with differences and samples of whole simulations; and warnings where contacts change their mode."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import phipsi
import pytest
import test_loop_gradients as loops
from phipsi.errors import ArgumentError, UncertaintyWarning
from phipsi.estimation import MotionUncertainty
from phipsi.estimation.trajectories import with_bands
from scipy.stats import chi2
from tolerances import assert_near, slope_of_order_4

#: Differences with respect to a start move contacts below their surface.
pytestmark = pytest.mark.filterwarnings("ignore::phipsi.errors.ContactWarning")

JOINTS = {"armature": 1e-4, "damping": 4e-4, "friction": 1e-4, "offset": 9e-4}
NOISE = 0.3


@dataclass
class Case:
    """A scene, a start, and the arguments of a simulation."""

    scene: phipsi.Scene
    q: np.ndarray
    qd: np.ndarray
    given: dict[str, Any] = field(default_factory=dict)
    #: Degrees of freedom of q and qd whose start has errors; None: all.
    free: tuple[int, ...] | None = None
    #: Size of the errors of the start.
    size: float = 0.1

    @property
    def root(self) -> np.ndarray:
        """Columns of errors of the start, which connections need not allow."""
        nv = self.scene.nv
        root = self.size * np.random.default_rng(2).normal(size=(2 * nv, 3))
        if self.free is not None:
            root[[i for i in range(2 * nv) if i % nv not in self.free]] = 0.0
        return root

    def run(self, *, start: np.ndarray | None = None, scene: phipsi.Scene | None = None, **changed: Any) -> phipsi.Trajectory:
        """A simulation from a start that is moved by (q, qd), then projected onto the connections."""
        scene, q, qd = scene or self.scene, self.q, self.qd
        if start is not None:
            q, qd = scene.integrate(q, start[: scene.nv]), qd + start[scene.nv :]
            if scene.loops.names and not self.given.get("compliance"):
                q, qd, _ = self.scene.loops.project(q, qd)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UncertaintyWarning)
            return scene.simulate(q, qd, **self.given | changed)

    def columns(self, at: Callable[[float], phipsi.Trajectory], step: float = 1e-4) -> np.ndarray:
        """Derivative of the rows by a change, (rows, 2 nv)."""
        path = self.run()

        def rows(by: float) -> np.ndarray:
            moved = at(by)
            return np.concatenate([self.scene.difference(path.q, moved.q), moved.qd - path.qd], axis=-1)

        return slope_of_order_4(rows, step)


def heavier(scene: phipsi.Scene, name: str, by: float) -> phipsi.Scene:
    """A link that is heavier by a share."""
    link = scene.link(name)
    return scene.with_inertias({name: (link.mass * (1.0 + by), np.asarray(link.com), np.asarray(link.inertia) * (1.0 + by))})


def share(scene: phipsi.Scene, name: str) -> np.ndarray:
    """Change of the parameters of a link that is twice as heavy."""
    link = scene.link(name)
    com = np.asarray(link.com)
    about = np.asarray(link.inertia) + link.mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.array([link.mass, *(link.mass * com), about[0, 0], about[0, 1], about[1, 1], about[0, 2], about[1, 2], about[2, 2]])


def linkage(name: str, **given: Any) -> Case:
    scene = loops.SCENES[name]()
    q, qd = loops.start(scene)
    rng = np.random.default_rng(4)
    held = np.array([0.0 if joint == "root_joint" else 1.0 for joint in scene.joint_names for _ in range(*scene.v_index(joint).indices(scene.nv))])
    forces = {"armature": 0.1, "damping": 0.3, "stiffness": 0.4 * held, "pd": phipsi.PD(3.0 * held, 0.2 * held, scene.neutral()), "friction": 0.2, "friction_speed": 0.1}
    return Case(scene, q, qd, {"dt": 2e-3, "steps": 6, "tau": rng.normal(size=scene.nv)} | forces | given)


def gripper(contacts: bool = False, **given: Any) -> Case:
    """A wrist with two fingers, one of which follows the other."""
    builder = phipsi.SceneBuilder().link("base").link("palm", 1.0, (0.02, 0, 0.05), np.diag([4e-3, 5e-3, 2e-3]))
    builder.joint("wrist", "continuous", "base", "palm", axis=(0, 1, 0), armature=0.01)
    for name, axis in (("left", 1), ("right", -1)):
        builder.link(name, 0.3, (0.0, 0.01 * axis, 0.06), np.diag([5e-4, 6e-4, 1e-4]))
        mimic = {"mimic": "left_finger", "mimic_multiplier": 0.8, "mimic_offset": 0.05} if name == "right" else {}
        builder.joint(f"{name}_finger", "continuous", "palm", name, xyz=(0, 0.03 * axis, 0.1), axis=(axis, 0.2, 0), armature=1e-3, **mimic)
    if contacts:
        builder.contact("tip", "right", xyz=(0, 0, 0.12), friction=0.3, offset=-0.26, normal=(0, 0, -1))
    how = {"dt": 2e-3, "steps": 6, "tau": np.array([0.3, -0.1]), "damping": 0.02, "friction": 0.01, "friction_speed": 0.1}
    return Case(builder.build(mimic="couple"), np.array([0.2, 0.3]), np.array([0.5, -0.7]), how | given)


def block(friction: float = 0.3, speed: float = 1.0, **given: Any) -> Case:
    """A puck on three legs that slides."""
    builder = phipsi.SceneBuilder().link("puck", mass=1.0, com=(0.01, 0, 0.02), inertia=np.diag([0.01, 0.01, 0.02]))
    for i, (x, y) in enumerate([(0.1, 0.0), (-0.05, 0.08), (-0.05, -0.08)]):
        builder.contact(f"leg{i}", "puck", xyz=(x, y, 0.0), friction=friction)
    scene = builder.build(floating_base=True)
    qd = np.array([speed, 0.2 * speed, 0, 0, 0, 0.5 * speed])
    return Case(scene, scene.neutral(), qd, {"dt": 2e-3, "steps": 6, "tau": np.array([0.3, 0, 0, 0, 0, 0]), "armature": 0.1, "damping": 0.3} | given, free=(0, 1, 5), size=1e-6)


CASES: dict[str, Callable[[], Case]] = {
    "four-bar": lambda: linkage("four-bar"),
    "redundant, sparse rows": lambda: linkage("redundant", record_every=3),
    "tangle": lambda: linkage("tangle", method="semi-implicit-euler", steps=4),
    "floating": lambda: linkage("floating", friction=0.0, steps=3),
    "compliance": lambda: linkage("four-bar", compliance=1e-3),
    "gripper": gripper,
    "gripper, sparse rows": lambda: gripper(method="rosenbrock-2", record_every=2),
    "block": block,
    "block, sparse rows": lambda: block(record_every=3),
}


@pytest.mark.parametrize("name", CASES)
def test_bands_are_those_of_differences_of_whole_simulations(name: str) -> None:
    """Errors of the start move through the projection; those of parameters, joints and torques as they act."""
    case = CASES[name]()
    scene, given = case.scene, case.given
    nv, steps, link = scene.nv, given["steps"], scene.body_names[-1]
    sigma = np.zeros((len(scene.body_names), 10, 10))
    sigma[-1] = 0.01 * np.outer(share(scene, link), share(scene, link))
    rows = sorted({0, nv - 1})
    uncertain = np.isin(np.arange(nv), rows)
    joints = {kind: value for kind, value in JOINTS.items() if kind != "friction" or given.get("friction")}
    of_joints = {kind: value * uncertain for kind, value in joints.items()}
    unsure = MotionUncertainty(parameters=sigma, initial=case.root @ case.root.T, joints=of_joints, torque_noise=NOISE * uncertain)
    bands = case.run(covariance=unsure).bands
    tau = np.tile(given["tau"], (steps, 1))
    own = {kind: np.broadcast_to(np.asarray(given.get(kind, getattr(scene, kind, 0.0)), float), (nv,)) for kind in JOINTS}

    def pushed(step: int | slice, row: int, by: float) -> phipsi.Trajectory:
        other = tau.copy()
        other[step, row] += by
        return case.run(tau=None, tau_steps=other)

    def changed(kind: str, row: int, by: float) -> phipsi.Trajectory:
        return case.run(**{kind: own[kind] + by * np.eye(nv)[row]})

    columns = [case.columns(lambda by, column=column: case.run(start=by * column / case.size), 1e-4) * case.size for column in case.root.T]
    columns += [0.1 * case.columns(lambda by: case.run(scene=heavier(scene, link, by)))]
    for kind, value in joints.items():
        for row in rows:
            column = case.columns(lambda by, row=row: pushed(slice(None), row, -by)) if kind == "offset" else case.columns(lambda by, row=row, kind=kind: changed(kind, row, by))
            columns.append(np.sqrt(value) * column)
    columns += [np.sqrt(NOISE / given["dt"]) * case.columns(lambda by, step=step, row=row: pushed(step, row, by), 1e-3) for step in range(steps) for row in rows]
    expected = np.einsum("crx,cry->rxy", columns, columns)
    assert_near(bands.covariance, expected, 1e-7 * float(np.max(np.abs(expected))))


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("make", [lambda: linkage("four-bar", steps=50), lambda: gripper(steps=50), lambda: block(steps=50)], ids=["four-bar", "gripper", "block"])
def test_samples_have_the_covariance_of_the_bands(make: Callable[[], Case], seed: int) -> None:
    """The sum of squares of sampled errors, in the covariance of the bands, is chi-squared."""
    case, samples, density = make(), 100, 1e-8
    scene, nv, steps = case.scene, case.scene.nv, case.given["steps"]
    case.size = min(case.size, 1e-4)
    path = case.run(covariance=MotionUncertainty(initial=case.root @ case.root.T, torque_noise=density))
    random = np.random.default_rng(seed)
    starts = random.normal(size=(samples, 3)) @ case.root.T
    q, qd = scene.integrate(case.q, starts[:, :nv]), case.qd + starts[:, nv:]
    if scene.loops.names:
        q, qd, _ = scene.loops.project(q, qd)
    tau = case.given["tau"] + np.sqrt(density / case.given["dt"]) * random.normal(size=(samples, steps, nv))
    found = scene.simulate(q, qd, **case.given | {"tau": None, "tau_steps": tau})
    errors = np.concatenate([scene.difference(path.q[-1], found.q[:, -1]), found.qd[:, -1] - path.qd[-1]], axis=-1)
    deviations = np.sqrt(np.diagonal(path.bands.covariance[-1]))
    scale = np.where(deviations > 1e-6 * deviations.max(), deviations, np.inf)
    values, vectors = np.linalg.eigh(path.bands.covariance[-1] / np.outer(scale, scale))
    kept = values > 1e-8
    assert np.count_nonzero(kept) >= 2
    total = np.sum((errors / scale @ vectors[:, kept]) ** 2 / values[kept])
    low, high = chi2.ppf([1e-4, 1 - 1e-4], samples * np.count_nonzero(kept))
    assert low < total < high, (low, total, high)


@pytest.mark.parametrize("make", [lambda: linkage("four-bar", steps=25), gripper, block], ids=["four-bar", "gripper", "block"])
def test_checks_by_samples_agree(make: Callable[[], Case]) -> None:
    case = make()
    case.size = min(case.size, 1e-4)
    scene = case.scene
    sigma = np.zeros((len(scene.body_names), 10, 10))
    sigma[-1] = 1e-6 * np.outer(share(scene, scene.body_names[-1]), share(scene, scene.body_names[-1]))
    unsure = {"parameters": sigma, "initial": case.root @ case.root.T, "joints": {"offset": 1e-10, "damping": 1e-10}}
    ratio = case.run(covariance=MotionUncertainty(**unsure, check="unscented")).bands.ratio[-1]
    known = np.isfinite(ratio)
    assert np.count_nonzero(known) >= 4
    assert_near(ratio[known], np.ones(np.count_nonzero(known)), 1e-2)
    ratio = case.run(covariance=MotionUncertainty(**unsure, torque_noise=1e-9, check="monte-carlo", samples=60)).bands.ratio[-1]
    low, high = chi2.ppf([1e-5, 1 - 1e-5], 59) / 59
    assert np.all((low < ratio) & (ratio < high) | np.isnan(ratio)), ratio


def ball() -> phipsi.Scene:
    ball = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
    return ball.contact("foot", "ball", friction=0.5, radius=0.1, restitution=0.5).build(floating_base=True)


class TestContacts:
    """First-order bands hold within the modes of contacts."""

    def test_an_impact_at_another_time_is_reported(self) -> None:
        initial = np.zeros(12)
        initial[2] = 1e-6
        start = [0, 0, 0.12, 0, 0, 0, 1.0], np.zeros(6)
        given = {"dt": 2e-3, "steps": 40}
        with pytest.warns(UncertaintyWarning, match=r"covariance: found contact 'foot'.*at t = 0\.0[56].* s.*monte-carlo"):
            bands = ball().simulate(*start, **given, covariance=MotionUncertainty(initial=initial)).bands
        # The derivative of the height after a rebound at t* = sqrt(2 h/g): (e (t - 2 t*) + t - t*)/t*.
        t, impact, e = 0.08, np.sqrt(2 * 0.02 / 9.81), 0.5
        slope = abs(e * (t - 2 * impact) + t - impact) / impact
        assert_near(bands.q[-1, 2], 1e-3 * slope, 1e-9)
        ratio = ball().simulate(*start, **given, covariance=MotionUncertainty(initial=initial, check="unscented")).bands.ratio[-1]
        # The change of the time of the impact is part of the first order.
        assert abs(ratio[2] - 1.0) < 0.02
        # Errors along the plane, and those that move the impact by less than a step, do not warn.
        for at, variance, by in ((0, 1e-4, 1.0), (2, 1e-18, slope)):
            bands = ball().simulate(*start, **given, covariance=MotionUncertainty(initial=variance * np.eye(12)[at])).bands
            assert_near(bands.q[-1, at], by * np.sqrt(variance), 1e-5 * np.sqrt(variance))

    def test_a_block_that_friction_holds_has_no_error_until_torques_overcome_friction(self) -> None:
        case = block(speed=0.0, steps=20, tau=np.array([1.0, 0, 0, 0, 0, 0]))
        weak, strong = ([density, 0, 0, 0, 0, 0] for density in (1e-6, 1e-2))
        bands = case.scene.simulate(case.q, case.qd, **case.given, covariance=MotionUncertainty(torque_noise=weak)).bands
        assert_near(bands.q, np.zeros((21, 6)), 1e-15)
        with pytest.warns(UncertaintyWarning, match=r"contact 'leg\d'.*at t = 0\.002 s"):
            case.scene.simulate(case.q, case.qd, **case.given, covariance=MotionUncertainty(torque_noise=strong))
        for density, moves in ((weak, False), (strong, True)):
            ratio = case.run(covariance=MotionUncertainty(torque_noise=density, check="monte-carlo", samples=20)).bands.ratio[-1]
            assert np.isposinf(ratio[0]) if moves else np.isnan(ratio[0])

    def test_smoothed_contacts_have_no_modes(self) -> None:
        start = [0, 0, 0.12, 0, 0, 0, 1.0], np.zeros(6)
        smooth = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3)).contact("foot", "ball", friction=0.5, radius=0.1).build(floating_base=True)
        unsure = MotionUncertainty(initial=1e-12 * np.eye(12)[2])
        bands = smooth.simulate(*start, dt=2e-3, steps=40, smoothing=1e-3, covariance=unsure).bands
        assert np.isfinite(bands.covariance).all() and float(bands.q[-1, 2]) > 0.0

    def test_a_step_that_its_start_does_not_determine_is_refused(self) -> None:
        case = block()
        path = case.run()
        path.qd[3] += 1e-3
        with pytest.raises(ArgumentError, match="covariance: found a step with contacts that its initial state does not determine"):
            with_bands(path, MotionUncertainty(torque_noise=1e-8))

    def test_bands_are_the_same_with_sparse_rows(self) -> None:
        case = block()
        unsure = MotionUncertainty(initial=case.root @ case.root.T, torque_noise=[1e-8, 0, 0, 0, 0, 0])
        every, sparse = (case.run(record_every=record, covariance=unsure).bands.covariance for record in (1, 4))
        assert_near(sparse, every[::4], 1e-12 * float(np.max(every)))

    def test_a_batch_has_the_bands_of_its_states(self, monkeypatch: pytest.MonkeyPatch) -> None:
        case = block()
        qd = case.qd + 0.1 * np.arange(3)[:, None] * np.eye(6)[0]
        unsure = MotionUncertainty(initial=case.root @ case.root.T, torque_noise=[1e-8, 0, 0, 0, 0, 0])
        monkeypatch.setattr("phipsi.estimation.trajectories.VALUES", 3000)  # several calls
        whole = case.scene.simulate(np.tile(case.q, (3, 1)), qd, **case.given, covariance=unsure).bands.covariance
        for at in range(3):
            own = case.scene.simulate(case.q, qd[at], **case.given, covariance=unsure).bands.covariance
            assert_near(whole[at], own, 1e-12 * float(np.max(own)))


class TestConnections:
    def test_an_error_that_the_connections_allow_stays(self) -> None:
        """The first band is the projection of the given errors; projecting it again changes nothing."""
        case = linkage("tangle", steps=1)
        given = case.root @ case.root.T
        first = case.run(covariance=MotionUncertainty(initial=given)).bands.covariance[0]
        again = case.run(covariance=MotionUncertainty(initial=first)).bands.covariance[0]
        assert_near(again, first, 1e-9 * float(np.max(first)))
        assert float(np.max(np.abs(first - given))) > 0.1 * float(np.max(given))
        jacobian = case.scene.loops.jacobian(case.q)
        nv = case.scene.nv
        assert_near(jacobian @ first[:nv, :nv], np.zeros((len(jacobian), nv)), 1e-9 * float(np.max(first)))

    def test_a_batch_has_the_bands_of_its_states(self, monkeypatch: pytest.MonkeyPatch) -> None:
        case = linkage("four-bar")
        q, qd, _ = case.scene.loops.project(case.q + 0.1 * np.arange(3)[:, None], case.qd)
        unsure = MotionUncertainty(initial=case.root @ case.root.T, torque_noise=0.1)
        monkeypatch.setattr("phipsi.estimation.trajectories.VALUES", 1000)  # several calls
        whole = case.scene.simulate(q, qd, **case.given, covariance=unsure).bands.covariance
        for at in range(3):
            own = case.scene.simulate(q[at], qd[at], **case.given, covariance=unsure).bands.covariance
            assert_near(whole[at], own, 1e-11 * float(np.max(own)))

    def test_compliance_of_some_rows_is_refused_with_errors_of_the_start(self) -> None:
        case = linkage("four-bar", steps=2, compliance=[0.0, 0.0, 0.0, 1e-3, 1e-3])
        case.run(covariance=MotionUncertainty(torque_noise=0.1))
        with pytest.raises(ArgumentError, match="initial.*compliance of all rows"):
            case.run(covariance=MotionUncertainty(initial=1e-6 * np.ones(6)))
