"""Samples of models from a covariance: their moments, that they are physical, and the spread of what they compute."""

import numpy as np
import phipsi
import pytest
import tolerances
from phipsi.errors import ArgumentError
from phipsi.estimation import ParameterCovariance


def pseudo_inertias(inertias):
    mass, first = inertias[..., 0], inertias[..., 1:4]
    xx, xy, yy, xz, yz, zz = np.moveaxis(inertias[..., 4:], -1, 0)
    tensor = np.stack([np.stack(row, -1) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))], -2)
    found = np.zeros((*mass.shape, 4, 4))
    found[..., :3, :3] = 0.5 * np.trace(tensor, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - tensor
    found[..., :3, 3] = found[..., 3, :3] = first
    found[..., 3, 3] = mass
    return found


def covariance_of(scene, relative):
    """Independent errors of every parameter, relative to the size of its body."""
    inertias = np.array(scene.inertial_parameters)
    scale = np.where(np.arange(10) < 1, inertias[:, :1], np.abs(inertias).max(axis=1, keepdims=True))
    scale[:, 4:] = inertias[:, [4, 6, 9]].min(axis=1, keepdims=True)
    scale[:, 1:4] = np.sqrt(inertias[:, :1] * scale[:, 4:5])
    return np.stack([np.diag(row) for row in (relative * scale) ** 2])


def test_small_errors_have_the_mean_and_the_covariance_to_sampling_error():
    scene, n = phipsi.load(phipsi.BUNDLED_ARM), 20000
    given = covariance_of(scene, 1e-5)
    models = ParameterCovariance(scene, given).sample(n, seed=1)
    assert set(models) == {"inertias"} and models["inertias"].shape == (n, 6, 10)
    off = models["inertias"] - scene.inertial_parameters
    for body in range(6):
        deviation = np.sqrt(np.diag(given[body]))
        unit = off[:, body] / deviation
        assert np.abs(unit.mean(axis=0)).max() < tolerances.SIGMAS / np.sqrt(n)
        assert np.abs(np.cov(unit.T) - np.eye(10)).max() < tolerances.SIGMAS * np.sqrt(2.0 / n)


def test_large_errors_are_physical_where_a_gaussian_is_not():
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    given = covariance_of(scene, 0.5)
    models = ParameterCovariance(scene, given).sample(500, seed=2)["inertias"]
    assert np.linalg.eigvalsh(pseudo_inertias(models)).min() > 0.0
    assert (models[..., 0].std(axis=0) < 3.0 * np.sqrt(given[:, 0, 0])).all()
    plain = scene.inertial_parameters + np.random.default_rng(3).normal(size=(500, 6, 10)) * np.sqrt(np.diagonal(given, axis1=1, axis2=2))
    assert np.mean(np.linalg.eigvalsh(pseudo_inertias(plain)).min(axis=(-1, -2)) < 0.0) > 0.5


def test_the_spread_of_accelerations_is_that_of_the_first_order():
    scene, n = phipsi.load(phipsi.BUNDLED_ARM), 20000
    given, rng = covariance_of(scene, 2e-3), np.random.default_rng(4)
    q, qd, tau = rng.uniform(-0.7, 0.7, (3, scene.nv))
    qdd = scene.forward_dynamics(q, qd, tau, **ParameterCovariance(scene, given).sample(n, seed=5))
    expected = scene.forward_dynamics_variance(q, qd, tau, parameters=given)
    assert np.abs(qdd.var(axis=0) / expected - 1.0).max() < 0.02 + tolerances.SIGMAS * np.sqrt(2.0 / n)


def test_an_identification_gives_a_population_with_its_intervals():
    scene = phipsi.scenes.chain(2)
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.normal(size=(3, 400, 2))
    tau = scene.inverse_dynamics(q, qd, qdd) + 0.2 * qd + 0.05 * rng.normal(size=(400, 2))
    found = scene.identify(q, qd, qdd, tau, fit=["damping"], noise=0.05)
    models = found.sample(4000, seed=1)
    assert set(models) == {"inertias", "damping"} and (models["damping"] > 0.0).all()
    covariance = ParameterCovariance(found.scene, found)
    deviation = np.sqrt((covariance.extras**2).sum(axis=0))
    spread = models["damping"].std(axis=0)
    assert np.abs(spread / deviation - 1.0).max() < tolerances.SIGMAS * np.sqrt(0.5 / 4000)
    same = found.sample(4000, seed=1)
    tolerances.assert_same_bits(models["inertias"], same["inertias"])
    path = found.scene.simulate([0.1, 0.2], [0.0, 0.0], dt=1e-2, steps=20, **{k: v[:50] for k, v in models.items()})
    assert path.q.shape == (50, 21, 2) and path.q[:, -1].std(axis=0).min() > 0.0


def test_what_cannot_be_sampled_is_named():
    point = phipsi.SceneBuilder().link("base").link("bob", 1.0, (0, 0, -1)).joint("hinge", "revolute", "base", "bob", axis=(1, 0, 0)).build()
    covariance = ParameterCovariance(point, np.diag([0.01] + [0.0] * 9)[None])
    with pytest.raises(ArgumentError, match="bob"):
        covariance.sample(3)
    scene = phipsi.scenes.chain(2)
    covariance = ParameterCovariance(scene, np.diag(([0.01] + [0.0] * 9) * 2))
    with pytest.raises(ArgumentError, match="n: found 0"):
        covariance.sample(0)
    with pytest.raises(ArgumentError, match="seed"):
        covariance.sample(3, seed="seed")
