"""Scene.identify: parameters that explain the torques are found, minimize the objective, and are physically
possible.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from tolerances import SIGMAS, assert_near, product, recursion, size

import phipsi
from phipsi.estimation._bodies import to_moments, to_parameters
from phipsi.errors import ArgumentError, InertiaWarning, LogWarning, NotFiniteError, PhipsiError, ShapeError


def arm(seed: int, bodies: int = 6, base: bool = False, **joints: float) -> phipsi.Scene:
    """A generic arm: oblique axes, bodies of any orientation, a tool fixed on its hand."""
    draw = np.random.default_rng(seed)
    builder = phipsi.SceneBuilder().link("link0", mass=5.0 * base, inertia=0.1 * np.eye(3) if base else None)
    for at in range(1, bodies + 1):
        axes, _ = np.linalg.qr(draw.standard_normal((3, 3)))
        moments = draw.uniform(0.02, 0.03, 3)
        builder.link(f"link{at}", mass=draw.uniform(1, 3), com=draw.uniform(-0.1, 0.1, 3), inertia=axes @ np.diag(moments) @ axes.T)
        place = {"xyz": draw.uniform(-0.3, 0.3, 3), "rpy": draw.uniform(-1, 1, 3), "axis": draw.standard_normal(3)}
        builder.joint(f"joint{at}", "continuous", f"link{at - 1}", f"link{at}", **place, **joints)
    builder.link("tool", mass=0.4, com=(0.0, 0.01, 0.1), inertia=np.diag([0.002, 0.002, 0.001]))
    return builder.joint("mount", "fixed", f"link{bodies}", "tool", xyz=(0.0, 0.0, 0.1), rpy=(0.3, 0.2, 0.1)).build(floating_base=base)


def like(scene: phipsi.Scene, seed: int) -> phipsi.Scene:
    """The robot as built: each inertia differs by some tenths."""
    draw = np.random.default_rng(seed)
    spread = {
        name: (link.mass * draw.uniform(0.7, 1.3), link.com + draw.uniform(-0.02, 0.02, 3), link.inertia * draw.uniform(0.7, 1.3))
        for name, link in scene.links.items()
        if link.mass
    }
    return scene.with_inertias(spread)


def states(scene: phipsi.Scene, count: int, seed: int = 5) -> tuple[np.ndarray, ...]:
    q, qd, qdd = np.random.default_rng(seed).uniform(-2, 2, (3, count, scene.nv))
    return q, qd, qdd


def test_parameters_of_a_body_have_what_is_fixed_onto_it() -> None:
    scene = arm(0)
    q, qd, qdd = states(scene, 5)
    rows = scene.inverse_dynamics_vjp(q[:, None], qd[:, None], qdd[:, None], np.eye(6), parameters=True).parameters
    assert rows is not None
    tau = np.einsum("kibp,bp->ki", rows, scene.inertial_parameters)
    assert_near(tau, scene.inverse_dynamics(q, qd, qdd), recursion(6, size(tau)))


def test_exact_torques_are_explained_and_predicted() -> None:
    scene = arm(1)
    built = like(scene, 2)
    q, qd, qdd = states(scene, 100)
    found = scene.identify(q, qd, qdd, built.inverse_dynamics(q, qd, qdd), noise=1e-3)
    assert np.all(found.before > 0.05)
    assert np.all(found.after < 1e-3)
    # Of 60 parameters, 3 of the first body and 7 of each other one are identifiable.
    assert found.known == 3 + 5 * 7
    new = states(scene, 50, seed=6)
    off = found.scene.inverse_dynamics(*new) - built.inverse_dynamics(*new)
    assert np.max(np.abs(off)) < 3e-3
    assert found.scene.link_names == scene.link_names


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_estimated_and_averaged(seed: int) -> None:
    scene = arm(seed)
    built, sigma = like(scene, seed + 10), np.array([0.5, 0.3, 0.2, 0.1, 0.05, 0.02])
    q, qd, qdd = states(scene, 1000)
    tau = built.inverse_dynamics(q, qd, qdd) + sigma * np.random.default_rng(seed).standard_normal((1000, 6))
    found = scene.identify(q, qd, qdd, tau)
    # Standard deviations of standard deviations: s / sqrt(2 k).
    assert np.all(np.abs(found.noise / sigma - 1.0) < SIGMAS / np.sqrt(2 * 1000))
    new = states(scene, 200, seed=7)
    off = found.scene.inverse_dynamics(*new) - built.inverse_dynamics(*new)
    # 38 parameters from 6000 values: the torques have an error of about sqrt(38 / 6000) of the noise.
    assert np.sqrt(np.mean((off / sigma) ** 2)) < 3.0 * np.sqrt(38 / 6000)


def test_it_is_the_least_value_of_its_definition() -> None:
    """The objective, implemented independently with the ten parameters of each body as variables."""
    scene = arm(4, bodies=3)
    built = like(scene, 5)
    q, qd, qdd = states(scene, 30)
    draw = np.random.default_rng(0)
    noise, trust = np.array([0.1, 0.2, 0.3]), 2.5
    tau = built.inverse_dynamics(q, qd, qdd) + noise * draw.standard_normal((30, 3))
    found = scene.identify(q, qd, qdd, tau, noise=noise, trust=trust)
    prior = [np.linalg.inv(to_moments(one)) for one in scene.inertial_parameters]
    rows = scene.inverse_dynamics_vjp(q[:, None], qd[:, None], qdd[:, None], np.eye(3), parameters=True).parameters
    assert rows is not None

    def value(x: np.ndarray) -> float:
        left = (tau - np.einsum("kibp,bp->ki", rows, x)) / (noise * np.sqrt(found.inflation))
        moments = [to_moments(one) for one in x]
        return float(0.5 * np.sum(left**2) + 0.5 * trust * sum(np.trace(a @ b) - np.linalg.slogdet(b)[1] for a, b in zip(prior, moments, strict=True)))

    least = value(found.parameters)
    curvatures = []
    for _ in range(40):
        step = draw.standard_normal((3, 10)) * found.deviations
        ahead, behind = (value(found.parameters + h * step) for h in (1e-3, -1e-3))
        curvature = (ahead + behind - 2.0 * least) / 1e-6
        assert curvature > 0.0
        # Gradient divided by curvature: distance to the minimum in units of the standard deviations.
        assert abs((ahead - behind) / 2e-3) / curvature < 1e-4
        curvatures.append(curvature)
    assert np.median(curvatures) > 1.0


@pytest.mark.parametrize("seed", range(4))
def test_bodies_stay_bodies_where_data_are_poor(seed: int) -> None:
    """Few states, much noise: least squares gives physically impossible bodies."""
    scene = arm(seed)
    q, qd, qdd = states(scene, 12, seed)
    tau = like(scene, seed + 20).inverse_dynamics(q, qd, qdd) + np.random.default_rng(seed).standard_normal((12, 6))
    found = scene.identify(q, qd, qdd, tau, noise=1.0, trust=0.1)
    assert all(np.linalg.eigvalsh(to_moments(one))[0] > 0.0 for one in found.parameters)
    assert np.all(np.isfinite(found.deviations)) and np.all(found.deviations > 0.0)
    rows = scene.inverse_dynamics_vjp(q[:, None], qd[:, None], qdd[:, None], np.eye(6), parameters=True).parameters
    assert rows is not None
    least = np.linalg.lstsq(rows.reshape(72, 60), tau.ravel(), rcond=None)[0].reshape(6, 10)
    assert min(np.linalg.eigvalsh(to_moments(one))[0] for one in least) < 0.0


def distance(scene: phipsi.Scene, given: Any, found: Any, trust: float) -> float:
    """Distance to the minimum in standard deviations: Newton's step from the result, with an independent implementation
    of the rows and the prior.
    """
    q, qd, qdd, tau = given
    rows = scene.inverse_dynamics_vjp(q[:, None], qd[:, None], qdd[:, None], np.eye(scene.nv), parameters=True).parameters
    assert rows is not None
    # Rows count as n_eff of them.
    noise = found.noise * np.sqrt(found.inflation)
    left, columns, pulls = (tau - np.einsum("kibp,bp->ki", rows, found.parameters)) / noise, [], []
    for at, own in enumerate(scene.inertial_parameters):
        root = np.linalg.cholesky(to_moments(found.parameters[at]))
        pull = root.T @ np.linalg.solve(to_moments(own), root) - np.eye(4)
        for i, j in zip(*np.triu_indices(4), strict=True):
            unit = np.zeros((4, 4))
            unit[i, j] = unit[j, i] = 1.0 if i == j else np.sqrt(0.5)
            columns.append((rows[:, :, at] @ to_parameters(root @ unit @ root.T) / noise).ravel())
            pulls.append(np.sum(pull * unit))
    half = np.sqrt(0.5 * trust)
    matrix = np.concatenate([np.transpose(columns), half * np.eye(len(pulls))])
    step = np.linalg.lstsq(matrix, np.concatenate([left.ravel(), -half * np.array(pulls)]), rcond=-1)[0]
    return float(np.linalg.norm(matrix @ step))


@pytest.mark.parametrize("noise", [0.05, 0.005, 1e-6])
@pytest.mark.parametrize("mass", [0.0, 1.0, 30.0])
@pytest.mark.parametrize("trust", [1.0, 1e-3])
def test_bodies_far_from_the_model(noise: float, mass: float, trust: float) -> None:
    """A payload many times heavier than its body: the minimum is far from the prior."""
    scene = arm(7)
    light = scene.with_inertias({"link6": (0.015, (0.0, 0.0, 0.01), 2e-6 * np.eye(3)), "tool": (0.0, np.zeros(3), None)})
    built = light.with_payload("tool", mass=mass, com=(0.0, 0.0, 0.1)) if mass else light
    q, qd, qdd = states(scene, 100)
    tau = built.inverse_dynamics(q, qd, qdd) + noise * np.random.default_rng(1).standard_normal((100, 6))
    found = light.identify(q, qd, qdd, tau, trust=trust)
    assert np.all(np.abs(found.noise / noise - 1.0) < SIGMAS / np.sqrt(2 * 100))
    assert all(np.linalg.eigvalsh(to_moments(one))[0] > 0.0 for one in found.parameters)
    assert distance(light, (q, qd, qdd, tau), found, trust) < 1e-3


def test_torques_that_no_robot_gives() -> None:
    """Errors far beyond the stated noise: still the minimum, with physically possible bodies."""
    scene = arm(7)
    q, qd, qdd = states(scene, 8)
    tau = scene.inverse_dynamics(q, qd, qdd) + 30.0 * np.random.default_rng(1).standard_normal((8, 6))
    with pytest.warns(LogWarning, match="tau: found torques of 'joint.' that no bodies of positive mass explain: residuals of"):
        found = scene.identify(q, qd, qdd, tau, noise=0.01, trust=1e-3)
    assert all(np.linalg.eigvalsh(to_moments(one))[0] > 0.0 for one in found.parameters)
    assert np.all(found.after > 100.0 * found.noise)
    assert distance(scene, (q, qd, qdd, tau), found, 1e-3) < 1e-3


PENDULUMS = {"pendulum": lambda: phipsi.scenes.chain(1), "chain": lambda: phipsi.scenes.chain(5), "arm": lambda: arm(3), "floating": lambda: arm(13, 4, base=True)}


@pytest.mark.parametrize("kind", PENDULUMS)
@pytest.mark.parametrize("is_like", [False, True])
def test_torques_without_noise(kind: str, is_like: bool) -> None:
    scene = PENDULUMS[kind]()
    built = like(scene, 3) if is_like else scene
    draw = np.random.default_rng(4)
    q = scene.integrate(np.broadcast_to(scene.neutral(), (200, scene.nq)), draw.uniform(-1, 1, (200, scene.nv)))
    qd, qdd = draw.uniform(-1, 1, (2, 200, scene.nv))
    tau = built.inverse_dynamics(q, qd, qdd)
    found = scene.identify(q, qd, qdd, tau)
    assert np.all(found.noise > 0.0) and np.all(found.noise < 1e-9 * size(tau))
    assert np.all(found.after <= found.noise)
    assert_near(found.scene.inverse_dynamics(q, -qd, qdd), built.inverse_dynamics(q, -qd, qdd), 1e-6 * size(tau))
    if not is_like:
        assert_near(found.parameters, scene.inertial_parameters, 1e-4 * size(found.parameters))


def test_a_joint_without_measured_torques_has_no_noise() -> None:
    scene = arm(11)
    q, qd, qdd = states(scene, 200)
    tau = scene.inverse_dynamics(q, qd, qdd) + 0.1 * np.random.default_rng(2).standard_normal((200, 6))
    tau[:, 2] = np.nan
    found = scene.identify(q, qd, qdd, tau)
    assert np.isnan(found.noise[2]) and np.isnan(found.after[2])
    assert np.all(np.abs(found.noise[[0, 1, 3, 4, 5]] / 0.1 - 1.0) < SIGMAS / np.sqrt(2 * 200))


def test_torques_that_contradict_all_bodies_are_reported() -> None:
    """Without noise and with the wrong sign: 1e10 standard deviations from any possible body."""
    scene = arm(9, bodies=3)
    q, qd, qdd = states(scene, 60)
    with pytest.warns(LogWarning), pytest.raises(PhipsiError, match="identify: found no minimum in .* steps .*expected torques in N m or N with the signs of inverse_dynamics, or noise"):
        scene.identify(q, qd, qdd, -10.0 * scene.inverse_dynamics(q, qd, qdd))


def test_states_that_tell_nothing() -> None:
    """A prismatic joint perpendicular to gravity, at rest."""
    scene = phipsi.SceneBuilder().link("base").link("cart", 1.0, (0, 0, 0), np.eye(3)).joint("slide", "prismatic", "base", "cart", axis=(1, 0, 0)).build()
    zero = np.zeros((20, 1))
    with pytest.raises(ArgumentError, match="q: found states at which no torque depends on any parameter"):
        scene.identify(zero, zero, zero, zero)
    found = scene.identify(zero, zero, zero, zero, noise=1.0)
    assert found.known == 0
    assert_near(found.parameters, scene.inertial_parameters, 1e-12)


def test_joints_alone() -> None:
    scene = arm(9)
    q, qd, qdd = states(scene, 100)
    found = scene.identify(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd) + 0.3 * qd, fit=["damping"], keep=scene.body_names)
    assert_near(list(found.joints["damping"].values()), np.full(6, 0.3), 1e-9)


@pytest.mark.parametrize("scale", [-10.0, -0.01, 1.0, 1e3, 1e6, 1e-6])
@pytest.mark.parametrize("trust", [1e-3, 1.0, 1e9])
def test_data_of_other_units_and_signs(scale: float, trust: float) -> None:
    """With the noise of good sensors the minimum is found, independent of its distance from the model."""
    scene = arm(9, bodies=3)
    q, qd, qdd = states(scene, 60)
    tau = scale * scene.inverse_dynamics(q, qd, qdd)
    tau += 1e-3 * size(tau) * np.random.default_rng(0).standard_normal(tau.shape)
    with warnings.catch_warnings() if scale in (1.0, 1e-6) else pytest.warns(LogWarning, match="tau: found torques (proportional to those of the model|of the opposite sign of the model's, with the factors 'joint1': -)"):
        found = scene.identify(q, qd, qdd, tau, trust=trust)
    assert all(np.linalg.eigvalsh(to_moments(one))[0] > 0.0 for one in found.parameters)
    assert np.all(np.isfinite(found.deviations)) and np.all(np.isfinite(found.after))


def test_blocks_of_states_are_one_problem() -> None:
    """More states than are processed at once: the same result as with the rows in one matrix."""
    scene = arm(5, bodies=3)
    q, qd, qdd = states(scene, 1000)
    tau = like(scene, 6).inverse_dynamics(q, qd, qdd) + 0.1 * np.random.default_rng(0).standard_normal((1000, 3))
    tau[::7, 1] = np.nan
    rows = scene.inverse_dynamics_vjp(q[:, None], qd[:, None], qdd[:, None], np.eye(3), parameters=True).parameters
    assert rows is not None
    seen = np.isfinite(tau)
    found = scene.identify(q, qd, qdd, tau, noise=0.1)
    for parameters, value in ((scene.inertial_parameters, found.before), (found.parameters, found.after)):
        left = np.where(seen, tau - np.einsum("kibp,bp->ki", rows, parameters), 0.0)
        assert_near(value, np.sqrt(np.sum(left**2, axis=0) / seen.sum(axis=0)), 1e-12 * size(left))
    assert found.known == 3 + 2 * 7


def test_without_news_the_model_stays() -> None:
    scene = arm(8)
    q, qd, qdd = states(scene, 50)
    found = scene.identify(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd), noise=0.1)
    assert_near(found.parameters, scene.inertial_parameters, 1e-9)


def test_what_acts_at_the_joints() -> None:
    scene = arm(9, armature=0.05, damping=0.3, stiffness=2.0)
    values = {"armature": 0.12, "damping": 0.7, "friction": 0.4}
    built = like(scene, 10).with_properties(**values)
    q, qd, qdd = states(scene, 400)
    own = values["damping"] * qd + values["friction"] * qd / np.sqrt(qd**2 + 0.01**2) + 2.0 * q
    tau = built.inverse_dynamics(q, qd, qdd) + own
    found = scene.identify(q, qd, qdd, tau, fit=list(values), noise=1e-3)
    for name, value in values.items():
        assert list(found.joints[name]) == list(scene.joint_names)
        # The armature of a joint is distinguished from the inertia about its axis by the inboard joints, except for
        # the first.
        got = np.array(list(found.joints[name].values()))[1 if name == "armature" else 0 :]
        assert np.max(np.abs(got - value)) < 0.01
        assert_near(getattr(found.scene, name), list(found.joints[name].values()), product(1, 1.0))
    assert np.all(found.after < 2e-3)
    # The losses and springs of the model are part of the torques if they are not fitted.
    left = scene.identify(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd) + 0.3 * qd + 2.0 * q, noise=0.1)
    assert np.max(left.before) < 1e-9


def test_torques_that_were_not_measured() -> None:
    scene = arm(11)
    built = like(scene, 12)
    q, qd, qdd = states(scene, 200)
    tau = built.inverse_dynamics(q, qd, qdd)
    tau[:, 2], tau[::3, 4] = np.nan, np.nan
    found = scene.identify(q, qd, qdd, tau, noise=1e-3)
    assert np.isnan(found.before[2]) and np.isnan(found.after[2])
    assert np.all(found.after[[0, 1, 3, 4, 5]] < 1e-3)


def test_a_floating_base_has_torques_of_zero() -> None:
    scene = arm(13, base=True)
    built = like(scene, 13)
    draw = np.random.default_rng(3)
    q = np.stack([scene.integrate(scene.neutral(), draw.uniform(-1, 1, scene.nv)) for _ in range(200)])
    qd, tau = draw.uniform(-1, 1, (2, 200, scene.nv))
    tau[:, :6] = 0.0
    found = scene.identify(q, qd, built.forward_dynamics(q, qd, tau), tau, noise=1e-3, fit=["damping"])
    assert np.all(found.after < 2e-3)
    assert "root_joint" not in found.joints["damping"]


def test_bodies_that_are_kept() -> None:
    scene = arm(14)
    built = scene.with_payload("tool", mass=0.8, com=(0.0, 0.0, 0.05))
    q, qd, qdd = states(scene, 60)
    keep = [name for name in scene.body_names if name != "link6"]
    found = scene.identify(q, qd, qdd, built.inverse_dynamics(q, qd, qdd), noise=1e-3, keep=keep)
    assert_near(found.parameters[:5], scene.inertial_parameters[:5], 0.0)
    assert np.all(found.deviations[:5] == 0.0)
    # All ten parameters of the hand are identifiable.
    assert found.known == 10
    assert_near(found.parameters[5], built.inertial_parameters[5], 1e-4)
    assert found.scene.links["link1"].mass == scene.links["link1"].mass


GOOD: dict[str, Any] = {"noise": 0.1}


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"trust": 0.0}, ArgumentError, "trust: found 0.0; expected a finite number above zero"),
        ({"noise": -1.0}, ArgumentError, "noise: found -1.0; expected finite standard deviations above zero"),
        ({"noise": [1.0, 2.0]}, ShapeError, r"noise: found shape \(2,\)"),
        ({"fit": ["dampening"]}, ArgumentError, "fit: found 'dampening'; expected names of armature, damping, friction, offset, stribeck, load"),
        ({"keep": ["elbow"]}, ArgumentError, "keep: found 'elbow'"),
        ({"keep": [f"link{at}" for at in range(1, 7)]}, ArgumentError, "keep: found all bodies"),
        ({"q": np.zeros(6)}, ShapeError, r"q: found shape \(6,\); expected \(k, 6\)"),
        ({"qdd": np.zeros((3, 6))}, ShapeError, r"qdd: found shape \(3, 6\); expected \(k, 6\)"),
        ({"qd": np.full((10, 6), np.inf)}, NotFiniteError, "qd"),
        ({"tau": np.full((10, 6), np.inf)}, ArgumentError, "tau: found an infinity"),
        ({"tau": np.full((10, 6), np.nan)}, ArgumentError, "tau: found no measured torque: all are NaN"),
        ({"tau": np.full((10, 6), 1e150)}, ArgumentError, "tau: found 1e.150; expected torques below 1e.100"),
        ({"tau": np.full((10, 6), True)}, ArgumentError, "tau: found dtype bool"),
        ({"noise": 1e-15}, ArgumentError, r"noise: found 1e-15 at index 0; expected at least \d\.\de-\d+"),
        ({"noise": np.nan}, ArgumentError, "noise: found nan"),
        ({"noise": None}, ArgumentError, r"tau: found 60 measured torques for \d+ combinations of parameters"),
    ],
)
def test_bad_arguments(change: dict[str, Any], kind: type[Exception], message: str) -> None:
    scene = arm(15)
    q, qd, qdd = states(scene, 10)
    given = GOOD | {"q": q, "qd": qd, "qdd": qdd, "tau": scene.inverse_dynamics(q, qd, qdd)} | change
    with pytest.raises(kind, match=message):
        scene.identify(**given)


INERTIAS: dict[str, Any] = {
    "triangle": (1.0, (0.1, 0.0, 0.02), np.diag([0.01, 0.01, 0.05])),
    "negative": (1.0, (0.1, 0.0, 0.02), np.diag([0.01, -0.01, 0.02])),
    "point": (1.0, (0.0, 0.0, 0.0), None),
}


@pytest.mark.parametrize("kind", INERTIAS)
def test_a_body_that_cannot_be(kind: str) -> None:
    """The prior is a body near it; the torques before identification are those of the given model."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = arm(16).with_inertias({"link2": INERTIAS[kind]})
    q, qd, qdd = states(scene, 60)
    built = arm(16)
    with pytest.warns(InertiaWarning, match="scene: found inertias of 'link2' that no body can have; identification starts from the nearest"):
        found = scene.identify(q, qd, qdd, built.inverse_dynamics(q, qd, qdd), noise=1e-3)
    assert all(np.linalg.eigvalsh(to_moments(one))[0] > 0.0 for one in found.parameters)
    off = scene.inverse_dynamics(q, qd, qdd) - built.inverse_dynamics(q, qd, qdd)
    assert_near(found.before, np.sqrt(np.mean(off**2, axis=0)), 1e-10 * size(off))
    assert np.all(found.after < 2e-3)
    kept = scene.identify(q, qd, qdd, built.inverse_dynamics(q, qd, qdd), noise=1.0, keep=["link2"])
    assert_near(kept.parameters[1], scene.inertial_parameters[1], 0.0)


def test_a_body_without_mass() -> None:
    scene = arm(16).with_inertias({"link2": (0.0, (0, 0, 0), None)})
    q, qd, qdd = states(scene, 10)
    with pytest.raises(ArgumentError, match="scene: found no mass of the body 'link2'.*keep"):
        scene.identify(q, qd, qdd, np.zeros((10, 6)), noise=0.1)
    assert scene.identify(q, qd, qdd, np.zeros((10, 6)), noise=10.0, keep=["link2"]).deviations.shape == (6, 10)


@pytest.mark.parametrize("size", [1e-300, 1e75, 1e120, 1e160, 1e300])
@pytest.mark.parametrize("name", ["q", "qd", "qdd", "tau", "noise", "acceleration_noise", "trust", "friction_speed", "stribeck_speed"])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_huge_and_tiny_numbers_are_identified_or_refused(name: str, size: float, capfd: pytest.CaptureFixture[str]) -> None:
    """Errors are those of phipsi, and LAPACK writes nothing."""
    scene = arm(15)
    q, qd, qdd = states(scene, 60)
    given: dict[str, Any] = {"q": q, "qd": qd, "qdd": qdd, "tau": scene.inverse_dynamics(q, qd, qdd), "fit": ("friction", "stribeck")}
    given[name] = given[name] * size if name in given else size
    try:
        found = scene.identify(**given)
    except PhipsiError:
        pass
    else:
        assert np.isfinite(found.parameters).all() and np.isfinite(found.covariance).all()
    assert capfd.readouterr() == ("", "")
