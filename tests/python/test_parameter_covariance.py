"""One covariance of the parameters of bodies and joints: against its definition, against refits with truths of their own,
and in everything that accepts it.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from capabilities import Case, _moving, build
from logs import STEP, arm_of_three, fourier
from test_identify import arm, like, states
from tolerances import assert_near, central_difference, inverse, product, size

import phipsi
from phipsi.errors import ArgumentError, IdentificationWarning, LogWarning, NotFiniteError, ShapeError
from phipsi.estimation import MotionUncertainty, ParameterCovariance
from phipsi.estimation._bodies import to_moments, to_parameters
from phipsi.report import motion

FIT = ("armature", "damping", "friction")


def sliding(v: np.ndarray) -> np.ndarray:
    return v / np.sqrt(v**2 + 0.01**2)


def drawn(scene: phipsi.Scene, draw: np.random.Generator) -> phipsi.Scene:
    """A robot whose second moments of mass have the Wishart distribution of 15 degrees with the mode of the model."""
    found = []
    for own in scene.inertial_parameters:
        root = np.linalg.cholesky(to_moments(own) / 10.0) @ draw.standard_normal((4, 15))
        found.append(to_parameters(root @ root.T))
    return scene.with_inertial_parameters(np.array(found))


@pytest.mark.parametrize("trust", [1.0, 1e-4])
def test_predicted_torques_are_off_by_their_stated_deviation(trust: float) -> None:
    """Robots of their own, with armature, damping and friction that the model lacks."""
    scene = arm_of_three().with_properties(armature=0.0, damping=0.0, friction=0.0)
    draw, errors, variances = np.random.default_rng(0), [], []
    log, new = fourier(8 * STEP * np.arange(1000)), tuple(np.random.default_rng(1).uniform(-2, 2, (3, 40, 3)))
    for _ in range(25):
        built, own = drawn(scene, draw), draw.uniform(0.2, 1.2, (3, 3))

        def measured(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, built: phipsi.Scene = built, own: np.ndarray = own) -> np.ndarray:
            return built.inverse_dynamics(q, qd, qdd) + own[0] * qdd + own[1] * qd + own[2] * sliding(qd)

        with warnings.catch_warnings():
            # Some of these robots have twice the masses of the model.
            warnings.simplefilter("ignore", LogWarning)
            found = scene.identify(*log, measured(*log) + 0.3 * draw.standard_normal((1000, 3)), fit=FIT, trust=trust)
        errors.append(found.torques(*new) - measured(*new))
        variances.append(found.scene.inverse_dynamics_variance(*new, parameters=found))
    ratio = np.sqrt(np.mean(variances, axis=0) / np.mean(np.square(errors), axis=0))
    low, high = np.quantile(ratio, [0.05, 0.95])
    assert 0.8 < low < high < 1.5, (low, high)
    # With the bodies alone, as if joints were known and did not correlate with them.
    alone = np.mean([found.scene.inverse_dynamics_variance(*new, parameters=found.covariance)], axis=0)
    assert np.quantile(np.sqrt(alone) / np.sqrt(np.mean(np.square(errors), axis=0)), 0.95) > 2.0


def test_it_is_the_inverse_of_the_second_derivative_of_the_definition() -> None:
    """One block of time: the residuals count as independent. The model has damping, and lacks friction."""
    scene = arm(4, bodies=2, damping=0.5)
    q, qd, qdd = states(scene, 40)
    draw, trust = np.random.default_rng(0), 2.5
    tau = like(scene, 5).inverse_dynamics(q, qd, qdd) + 0.7 * qd + 0.4 * sliding(qd) + 0.1 * draw.standard_normal((40, 2))
    accumulator = phipsi.estimation.Accumulator(scene, fit=["damping", "friction"], block_length=40)
    found = accumulator.add(q, qd, qdd, tau).identify(noise=0.1, trust=trust)
    rows = np.concatenate([scene.regressor(q, qd, qdd).reshape(40, 2, 20), qd[..., None] * np.eye(2), sliding(qd)[..., None] * np.eye(2)], axis=2)
    hessian = np.einsum("kia,kib->ab", rows, rows) / 0.1**2
    units = np.array([to_moments(unit) for unit in np.eye(10)])
    for at, own in enumerate(found.parameters):
        part = slice(10 * at, 10 * at + 10)
        changes = np.linalg.solve(to_moments(own), units)
        hessian[part, part] += 0.5 * trust * np.einsum("aij,bji->ab", changes, changes)
    # The prior of friction, which the model lacks, has at most the weight 1.
    for at, (kind, weight) in enumerate((("damping", trust), ("friction", 1.0))):
        values = np.array(list(found.joints[kind].values()))
        rest = np.arange(20 + 2 * at, 22 + 2 * at)
        hessian[rest, rest] += 0.5 * weight / values**2
    scale = np.sqrt(np.diag(hessian))
    unit = hessian / np.outer(scale, scale)
    covariance = found.parameter_covariance
    root = np.concatenate([covariance.columns.reshape(-1, 20), covariance.extras], axis=1) * scale
    assert_near(root.T @ root, np.linalg.inv(unit), inverse(float(np.linalg.cond(unit)), size(np.linalg.inv(unit))))
    assert_near(root[:, :20].T @ root[:, :20], found.covariance * np.outer(scale, scale)[:20, :20], product(60, size(root.T @ root)))
    assert covariance.names == tuple((joint, kind) for kind in ("damping", "friction") for joint in scene.joint_names)


def fitted(scene: phipsi.Scene, fit: tuple[str, ...], **how: Any) -> tuple[phipsi.estimation.Identification, tuple[np.ndarray, ...]]:
    """An identification, and other states."""
    draw = np.random.default_rng(3)
    q = scene.integrate(np.broadcast_to(scene.neutral(), (120, scene.nq)), draw.uniform(-1, 1, (120, scene.nv)))
    qd, qdd = draw.uniform(-1, 1, (2, 120, scene.nv))
    if scene.loops.names:
        q, qd, qdd = _moving(Case("loop", False), 120, 3)
    tau = scene.inverse_dynamics(q, qd, qdd) + 0.3 * qd + 0.2 * qdd + 0.4 * sliding(qd) + 0.1 * draw.standard_normal(qd.shape)
    with warnings.catch_warnings():
        # Torques of joints, also with a transmission, and friction of free joints: only the algebra is tested.
        for kind in (IdentificationWarning, LogWarning):
            warnings.simplefilter("ignore", kind)
        found = scene.identify(q, qd, qdd, tau, fit=fit, noise=0.1, **how)
    return found, (q[:5], qd[:5], qdd[10:15])


ROBOTS = {
    "arm": lambda: arm(9, bodies=3),
    "floating": lambda: arm(13, 3, base=True),
    "contacts": lambda: build("tree", True),
    "mimic": lambda: build("mimic", False),
    "loop": lambda: build("loop", False),
}


@pytest.mark.parametrize("trust", [1.0, 1e-4])
@pytest.mark.parametrize("kind", ROBOTS)
def test_it_is_dense_algebra_wherever_it_is_accepted(kind: str, trust: float) -> None:
    """W Sigma W^T with rows written out, and M^-1 W Sigma W^T M^-1 at the acceleration of the state."""
    found, (q, qd, qdd) = fitted(ROBOTS[kind](), FIT, trust=trust)
    scene, covariance = found.scene, found.parameter_covariance
    nv = scene.nv

    def dense(qdd: np.ndarray) -> tuple[np.ndarray, float]:
        of_kind = {"armature": qdd, "damping": qd, "friction": sliding(qd)}
        columns = np.einsum("kibp,sbp->ksi", scene.regressor(q, qd, qdd), covariance.columns)
        for (joint, name), column in zip(covariance.names, covariance.extras.T, strict=True):
            rows = scene.v_index(joint)
            columns[:, :, rows] += column[:, None] * of_kind[name][:, None, rows]
        terms = np.abs(scene.regressor(q, qd, qdd)).max() * np.abs(covariance.columns).max()
        return np.einsum("ksi,ksj->kij", columns, columns), float(terms) ** 2

    whole, terms = dense(qdd)
    bound = product(60 * nv, max(size(whole), 1e-12 * terms))
    variances = np.diagonal(whole, axis1=-2, axis2=-1)
    assert np.all(variances[:, -1] > 0.0)
    assert_near(scene.inverse_dynamics_variance(q, qd, qdd, parameters=found), variances, bound)
    if kind != "loop":
        assert_near(found.torques_variance(q, qd, qdd), variances, bound)
    with_noise = scene.inverse_dynamics_variance(q, qd, qdd, parameters=found, torque=0.5, joints={"offset": 0.25})
    assert_near(with_noise, variances + 0.75, bound)
    at = scene.forward_dynamics(q, qd, qdd)
    inverse_mass = scene.loops.mass_matrix_inverse(q) if kind == "loop" else np.linalg.inv(scene.mass_matrix(q))
    moved, terms = dense(at)
    of_joints = inverse_mass @ moved @ np.swapaxes(inverse_mass, -1, -2)
    bound = inverse(float(np.max(np.linalg.cond(scene.mass_matrix(q)))) ** 2, max(size(of_joints), 1e-12 * terms))
    result = scene.forward_dynamics_variance(q, qd, qdd, parameters=found, links=scene.link_names[-1:])
    assert_near(result.joints, np.diagonal(of_joints, axis1=-2, axis2=-1), bound)
    jacobian = scene.jacobian(q, scene.link_names[-1])
    of_link = jacobian @ of_joints @ np.swapaxes(jacobian, -1, -2)
    assert_near(result.links[scene.link_names[-1]], of_link, bound * size(jacobian) ** 2)
    observer = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0, parameters=found)
    observer.step(q, qd, qdd)
    if kind != "loop":
        assert_near(observer.covariance - np.diag(observer._variance), moved, product(60 * nv, size(moved, 1e-12 * terms)))


def test_states_that_fail_are_nan_among_others() -> None:
    found, (q, qd, qdd) = fitted(arm(9, bodies=3), FIT)
    q[1, 0] = np.nan
    for call in (found.scene.inverse_dynamics_variance, found.scene.forward_dynamics_variance):
        with pytest.warns(phipsi.errors.BadStateWarning):
            variances = call(q, qd, qdd, parameters=found, errors="nan")
        assert np.isnan(variances[1]).all() and np.isfinite(variances[[0, 2, 3, 4]]).all()


#: Motor 3 moves by the sum of two rates.
COUPLED = np.array([[1.0, 0.0, 0.0], [0.0, -2.0, 0.0], [0.0, 1.0, 1.0]])


def test_motors_that_move_several_joints() -> None:
    fit = ("armature", "damping", "offset")
    found, (q, qd, qdd) = fitted(arm(9, bodies=3), fit, transmission=COUPLED)
    covariance, scene = found.parameter_covariance, found.scene
    kinds = {"armature": qdd @ COUPLED.T, "damping": qd @ COUPLED.T, "offset": np.ones((5, 3))}
    columns = np.einsum("kibp,sbp->ksi", scene.regressor(q, qd, qdd), covariance.columns)
    motors = ["joint1", "joint2", "joint2+joint3"]
    for (motor, kind), column in zip(covariance.names, covariance.extras.T, strict=True):
        at = motors.index(motor)
        columns += column[None, :, None] * kinds[kind][:, at, None, None] * COUPLED[at]
    assert_near(scene.inverse_dynamics_variance(q, qd, qdd, parameters=found), np.sum(columns**2, axis=1), product(100, size(columns) ** 2))
    of_motors = columns @ np.linalg.inv(COUPLED)
    assert_near(found.torques_variance(q, qd, qdd), np.sum(of_motors**2, axis=1), product(100, size(columns) ** 2))
    scene = scene.with_properties(friction_offset=0.0)
    with pytest.raises(ArgumentError, match=r"parameters: found armature of 'joint2\+joint3'; expected armature, damping, friction and offsets of single joints"):
        scene.simulate(q[0], qd[0], dt=1e-3, steps=5, covariance=found)


def test_bands_are_those_of_perturbed_simulations() -> None:
    """Each column of the root is a robot that is off by one standard deviation in bodies and joints at once."""
    found, _ = fitted(arm(9, bodies=2), FIT)
    scene = found.scene
    small = ParameterCovariance._of_root(found.columns, 0.05 * found.own_root)
    how: dict[str, Any] = {"dt": 5e-3, "steps": 20, "tau": [1.0, -0.5], "friction_speed": 0.01, "method": "semi-implicit-euler"}
    bands = scene.simulate([0.3, 0.2], [1.0, -0.5], **how, covariance=small).bands
    of_joints, step, spread = small._joints(2), 1e-4, []
    for bodies, joints in zip(small.columns, of_joints, strict=True):
        ends = []
        for sign in (step, -step):
            changed = scene.with_inertial_parameters(found.parameters + sign * bodies)
            properties = {name: getattr(scene, name) + sign * joints[:, at] for at, name in enumerate(FIT)}
            path = changed.with_properties(**properties).simulate([0.3, 0.2], [1.0, -0.5], **how)
            ends.append(np.concatenate([path.q[-1], path.qd[-1]]))
        spread.append((ends[0] - ends[1]) / (2.0 * step))
    expected = np.transpose(spread) @ np.array(spread)
    assert_near(bands.covariance[-1], expected, 1e3 * central_difference(size(expected)))
    assert np.all(np.diag(expected) > 1e-9)
    # The correlation counts.
    alone = scene.simulate([0.3, 0.2], [1.0, -0.5], **how, covariance=0.05**2 * found.covariance).bands
    assert np.max(np.abs(alone.qd[-1] / bands.qd[-1] - 1.0)) > 0.2


def test_files_have_all_of_it(tmp_path: Path) -> None:
    found, (q, qd, qdd) = fitted(arm(9, bodies=3), FIT, friction_speed=0.02)
    np.savez(tmp_path / "unsure.npz", **found.parameter_covariance.arrays())
    unsure = motion.read_uncertainty(tmp_path / "unsure.npz", None, found.scene)
    expected = found.scene.inverse_dynamics_variance(q, qd, qdd, parameters=found)
    assert isinstance(unsure, MotionUncertainty)
    assert_near(found.scene.inverse_dynamics_variance(q, qd, qdd, parameters=unsure.parameters), expected, 0.0)
    np.savez(tmp_path / "unsure.npz", **found.parameter_covariance.arrays(), parameters=found.covariance)
    with pytest.raises(ArgumentError, match="found 'root' and 'parameters'"):
        motion.read_uncertainty(tmp_path / "unsure.npz", None, found.scene)


def test_bad_arguments() -> None:
    found, (q, qd, qdd) = fitted(arm(9, bodies=3), FIT)
    scene, arrays = found.scene, found.parameter_covariance.arrays()
    with pytest.raises(ArgumentError, match="joints: found variances of damping, which parameters has too; expected one of them"):
        scene.inverse_dynamics_variance(q, qd, qdd, parameters=found, joints={"damping": 0.1})
    with pytest.raises(ArgumentError, match="parameters: found the covariance of a robot with the bodies link1, link2, link3; expected link1, link2"):
        arm(9, bodies=2).inverse_dynamics_variance(q[:, :2], qd[:, :2], qdd[:, :2], parameters=found)
    with pytest.raises(ShapeError, match=r"root: found shape \(2, 3\); expected \(number, 39\)"):
        ParameterCovariance.from_arrays(scene, arrays | {"root": np.zeros((2, 3))})
    with pytest.raises(NotFiniteError, match="root: found NaN at index 0"):
        ParameterCovariance.from_arrays(scene, arrays | {"root": np.full((1, 39), np.nan)})
    with pytest.raises(ShapeError, match="q: found leading axes"):
        found.torques_variance(q, qd[:2], qdd)
