"""The random model from Python: sampling (1.1 to 1.6), and M from the covariance of T (5.1)."""

import concurrent.futures

import numpy as np
import phipsi
import pytest
from conftest import random_states
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError
from tolerances import SIGMAS, assert_near, assert_same_bits, product, size


@pytest.fixture(params=["mixed", "floating", "arm"])
def case(request: pytest.FixtureRequest) -> tuple[phipsi.Scene, np.ndarray, np.ndarray]:
    scene = request.getfixturevalue(request.param)
    state = random_states(scene, 5)
    return scene, state.q, state.qd


Case = tuple[phipsi.Scene, np.ndarray, np.ndarray]


def test_samples_obey_the_state_space_model(case: Case) -> None:
    scene, q, qd = case
    f = scene.factor(q)
    w, x, t = scene.random_model(q, qd).sample(100, seed=3)
    assert w.shape == x.shape == (100, scene.nv, 6) and t.shape == (100, scene.nv)
    x_flat = x.reshape(100, -1)
    assert_near(f.phi.matvec(w.reshape(100, -1)), x_flat, product(6 * scene.nv, size(x)))
    measured = f.H.matvec(x_flat)
    noisy = np.abs(measured - t).max(axis=0) > product(6, size(x))
    armature = np.diagonal(scene.mass_matrix(q)) - np.diagonal((f.H @ f.R @ f.H.T).toarray()) > 1e-3
    assert np.array_equal(noisy, armature)


def test_mean_is_the_bias(case: Case) -> None:
    scene, q, qd = case
    t = scene.random_model(q, qd, acceleration_variance=4.0).sample_torque(20_000, seed=1)
    standard_error = np.sqrt(4.0 * np.diagonal(scene.mass_matrix(q)) / len(t))
    assert np.all(np.abs(t.mean(axis=0) - scene.bias_torque(q, qd)) <= SIGMAS * standard_error)
    centerd = scene.random_model(q).sample_torque(20_000, seed=1)
    assert np.all(np.abs(centerd.mean(axis=0)) <= SIGMAS * standard_error / 2.0)


def test_three_ways_to_m(case: Case) -> None:
    scene, q, _ = case
    m, model = scene.mass_matrix(q), scene.random_model(q)
    exact = model.mass_matrix(method="sigma-points")
    assert_near(exact.mass_matrix, m, product(6 * scene.nv, size(m)))
    assert (exact.standard_error, exact.low, exact.high, exact.confidence) == (None,) * 4
    assert exact.samples == 2 * model.dimension
    for estimate in (
        model.mass_matrix(40_000, seed=2),
        model.mass_matrix(2**15, seed=2, method="sobol", replicates=16),
    ):
        off = np.abs(estimate.mass_matrix - m)
        # Student's quantile at six standard deviations and 15 degrees of freedom is 10.
        assert np.all(off <= 2 * SIGMAS * estimate.standard_error)
        assert np.all((estimate.low <= estimate.mass_matrix) & (estimate.mass_matrix <= estimate.high))
        assert np.array_equal(estimate.mass_matrix, estimate.mass_matrix.T)
        assert off.max() > 0.0
        assert estimate.confidence == 0.95


def test_sobol_beats_plain_sampling(arm: phipsi.Scene) -> None:
    q = random_states(arm, 0).q
    m, model = arm.mass_matrix(q), arm.random_model(q)
    plain = model.mass_matrix(2**16, seed=1).mass_matrix - m
    sobol = model.mass_matrix(2**16, seed=1, method="sobol").mass_matrix - m
    assert np.linalg.norm(sobol) < 0.2 * np.linalg.norm(plain)


def test_samples_by_number(case: Case) -> None:
    scene, q, _ = case
    model = scene.random_model(q)
    t = model.sample_torque(200, seed=8)
    assert_same_bits(model.sample_torque(50, seed=8, first=99), t[99:149])
    assert_same_bits(model.sample(200, seed=8).torque, t)
    assert not np.array_equal(model.sample_torque(200, seed=9), t)
    assert np.isfinite(model.sample_torque(1, seed=2**64 - 1, first=2**40)).all()


def test_threads_draw_the_same(arm: phipsi.Scene) -> None:
    model = arm.random_model(random_states(arm, 0).q)
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        all_of_them = list(pool.map(lambda _: model.mass_matrix(20_000, seed=3).mass_matrix, range(8)))
    for found in all_of_them[1:]:
        assert_same_bits(found, all_of_them[0])


def test_nothing_moves(welded: phipsi.Scene) -> None:
    model = welded.random_model([])
    assert model.sample_torque(3, seed=0).shape == (3, 0)
    assert model.sample(3, seed=0).force.shape == (3, 0, 6)
    assert model.mass_matrix(10, seed=0).mass_matrix.shape == (0, 0)


@pytest.mark.parametrize("seed", [-1, 1.5, "7", None, True, 2**64, np.float64(3.0)], ids=repr)
def test_bad_seed(seed: object, arm: phipsi.Scene) -> None:
    with pytest.raises(ArgumentError, match="seed"):
        arm.random_model(np.zeros(7)).sample(10, seed=seed)  # type: ignore[arg-type]


@pytest.mark.parametrize("samples", [0, -5, 2.0, "10", True, 2**50], ids=repr)
def test_bad_count(samples: object, arm: phipsi.Scene) -> None:
    with pytest.raises(ArgumentError, match="samples"):
        arm.random_model(np.zeros(7)).mass_matrix(samples, seed=1)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("keywords", "name"),
    [
        ({"samples": 100}, "seed"),
        ({"seed": 1}, "samples"),
        ({"samples": 100, "seed": 1, "method": "magic"}, "method"),
        ({"samples": 100, "seed": 1, "confidence": 1.0}, "confidence"),
        ({"samples": 100, "seed": 1, "method": "sobol"}, "samples"),
        ({"samples": 128, "seed": 1, "method": "sobol", "replicates": 1}, "replicates"),
    ],
)
def test_bad_estimate(keywords: dict[str, object], name: str, arm: phipsi.Scene) -> None:
    with pytest.raises(ArgumentError, match=name) as caught:
        arm.random_model(np.zeros(7)).mass_matrix(**keywords)  # type: ignore[arg-type]
    assert caught.value.argument == name


def test_bad_model(arm: phipsi.Scene) -> None:
    with pytest.raises(ShapeError, match="q"):
        arm.random_model(np.zeros(6))
    with pytest.raises(NotFiniteError, match="qd"):
        arm.random_model(np.zeros(7), np.full(7, np.nan))
    with pytest.raises(ArgumentError, match="acceleration_variance"):
        arm.random_model(np.zeros(7), acceleration_variance=-1.0)


def test_seed_from_numpy(arm: phipsi.Scene) -> None:
    model = arm.random_model(np.zeros(7))
    assert_same_bits(model.sample_torque(5, seed=np.int64(4)), model.sample_torque(5, seed=4))


def test_indefinite_inertia_names_the_link() -> None:
    builder = phipsi.SceneBuilder().link("base").link("odd", 1.0, inertia=np.diag([-0.1, 1.0, 1.0]))
    with pytest.warns(phipsi.errors.InertiaWarning):
        scene = builder.joint("hinge", "revolute", "base", "odd").build()
    with pytest.raises(ArgumentError, match="odd"):
        scene.random_model([0.0])
