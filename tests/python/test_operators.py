"""The equations of the paper, operators compared with their definitions, and operators in SciPy."""

import inspect
from typing import Any

import numpy as np
import phipsi
import pytest
import scipy.sparse.linalg
from conftest import random_scene, random_states
from tolerances import inverse

NAMES = ("phi", "Phi", "psi", "E", "H", "Q", "R", "P", "P_plus", "D", "g", "K", "L", "M", "M_inv", "A", "Psi_A", "A_Psi", "Lambda", "Lambda_plus", "S", "G")


@pytest.fixture(params=range(4))
def case(request: pytest.FixtureRequest) -> tuple[phipsi.Scene, np.ndarray]:
    scene = random_scene(request.param, 6, armature=0.1 * (request.param % 2))
    return scene, random_states(scene, request.param).q


def bound(scene: phipsi.Scene, q: np.ndarray, scale: float) -> float:
    return inverse(float(np.linalg.cond(scene.mass_matrix(q))), scale)


def test_equation_4_1_as_typed(case: tuple[phipsi.Scene, np.ndarray]) -> None:
    scene, q = case
    f = scene.factor(q)
    tau = np.linspace(-3.0, 5.0, scene.nv)
    typed = (f.I - f.L.T) @ (f.D.inv() @ ((f.I - f.L) @ tau))
    dense = np.linalg.solve(scene.mass_matrix(q), tau)
    assert np.abs(typed - dense).max() <= bound(scene, q, float(np.abs(dense).max()))
    assert np.abs(f.solve(tau) - dense).max() <= bound(scene, q, float(np.abs(dense).max()))


@pytest.mark.parametrize("name", NAMES)
def test_operator_is_its_definition(name: str, case: tuple[phipsi.Scene, np.ndarray]) -> None:
    scene, q = case
    operator = getattr(scene.factor(q), name)
    matrix = operator.toarray()
    assert matrix.shape == operator.shape
    assert np.abs(matrix).max() > 0.0
    swept = operator @ np.eye(operator.shape[1])
    assert np.abs(swept - matrix).max() <= bound(scene, q, float(np.abs(matrix).max()))
    transposed = operator.T @ np.eye(operator.shape[0])
    assert np.abs(transposed - matrix.T).max() <= bound(scene, q, float(np.abs(matrix).max()))


def test_k_and_l_are_unit_upper_triangular(case: tuple[phipsi.Scene, np.ndarray]) -> None:
    scene, q = case
    f = scene.factor(q)
    assert np.all(np.tril(f.K @ np.eye(scene.nv)) == 0.0)
    assert np.all(np.tril(f.L @ np.eye(scene.nv)) == 0.0)


@pytest.mark.parametrize("typed", ["f.I + f.K", "f.I - f.L", "f.phi", "f.M", "f.D", "(f.I + f.K.T)", "(f.I + f.K) @ f.D"])
def test_inverses(typed: str, case: tuple[phipsi.Scene, np.ndarray]) -> None:
    scene, q = case
    operator = eval(typed, {"f": scene.factor(q)})
    x = np.linspace(1.0, 2.0, operator.shape[1])
    assert np.abs(operator.inv() @ (operator @ x) - x).max() <= bound(scene, q, 2.0)
    assert np.abs(operator.inv().toarray() @ operator.toarray() - np.eye(len(x))).max() <= bound(scene, q, 1.0)


def test_log_det_and_mul(case: tuple[phipsi.Scene, np.ndarray]) -> None:
    scene, q = case
    f, m = scene.factor(q), scene.mass_matrix(q)
    a = np.linspace(-1.0, 1.0, scene.nv)
    assert np.abs(f.mul(a) - m @ a).max() <= bound(scene, q, float(np.abs(m).max()))
    assert abs(f.log_det - np.linalg.slogdet(m)[1]) <= bound(scene, q, 1.0)


def test_batched_factor_is_each_factor(case: tuple[phipsi.Scene, np.ndarray]) -> None:
    scene, q = case
    batch = np.concatenate([q[None], random_states(scene, 7, (2,)).q])
    tau = random_states(scene, 8, (3,)).tau
    f = scene.factor(batch)
    assert f.batch == (3,) and f.log_det.shape == (3,)
    for i in range(3):
        assert np.array_equal(f.solve(tau)[i], scene.factor(batch[i]).solve(tau[i]))
        assert np.array_equal((f.K @ tau[0])[i], scene.factor(batch[i]).K @ tau[0])
    matrices = f.M @ np.eye(scene.nv)
    assert matrices.shape == (3, scene.nv, scene.nv)
    assert np.abs(matrices - scene.mass_matrix(batch)).max() <= bound(scene, q, float(np.abs(matrices).max()))


def test_scipy_takes_operators(case: tuple[phipsi.Scene, np.ndarray]) -> None:
    scene, q = case
    f = scene.factor(q)
    tau = np.linspace(-1.0, 2.0, scene.nv)
    m = scipy.sparse.linalg.aslinearoperator(f.M)
    inverse = scipy.sparse.linalg.aslinearoperator(f.M_inv)
    # The argument is tol before SciPy 1.12.
    relative = "rtol" if "rtol" in inspect.signature(scipy.sparse.linalg.cg).parameters else "tol"
    solution, code = scipy.sparse.linalg.cg(m, tau, atol=0.0, M=inverse, **{relative: 1e-10})
    assert code == 0
    assert np.abs(solution - f.solve(tau)).max() <= 1e-8 * np.abs(solution).max()


def test_residuals_of_check_are_rounding(case: tuple[phipsi.Scene, np.ndarray]) -> None:
    scene, q = case
    residuals = scene.check(q)
    assert len(residuals) >= 15
    for name, value in residuals.items():
        assert value <= bound(scene, q, 100.0), name


def test_wrong_length_names_both(case: tuple[phipsi.Scene, np.ndarray]) -> None:
    scene, q = case
    with pytest.raises(phipsi.errors.ShapeError, match=rf"x: found shape .*{scene.nv + 1}.* expected \(\.\.\., {scene.nv}\)"):
        scene.factor(q).solve(np.ones(scene.nv + 1))


def test_shapes_that_do_not_compose(case: tuple[phipsi.Scene, np.ndarray]) -> None:
    scene, q = case
    f = scene.factor(q)
    with pytest.raises(phipsi.errors.ShapeError, match="inner sizes"):
        _ = f.H @ f.K
    with pytest.raises(phipsi.errors.ShapeError, match="equal shapes"):
        _ = f.H + f.phi


def test_numbers_are_identities(case: tuple[phipsi.Scene, np.ndarray]) -> None:
    scene, q = case
    f = scene.factor(q)
    one = np.eye(scene.nv)
    k, closed = f.K.toarray(), (f.g @ f.H).toarray()
    assert np.array_equal((1 + f.K).toarray(), one + k)
    assert np.array_equal((f.K - 2.5).toarray(), k - 2.5 * one)
    assert np.abs((1 - f.g @ f.H).toarray() - (np.eye(6 * scene.nv) - closed)).max() == 0.0
    assert np.abs((1 - f.g @ f.H).toarray() - f.A.toarray()).max() <= bound(scene, q, 1.0 + float(np.abs(closed).max()))
    tau = np.linspace(-3.0, 5.0, scene.nv)
    assert np.array_equal((1 + f.K).inv() @ tau, (1 - f.L) @ tau)
    with pytest.raises(phipsi.errors.ShapeError, match="square"):
        _ = 1 - f.H
    with pytest.raises(TypeError):
        _ = "1" - f.K  # type: ignore[operator]


def test_no_inverse_says_which_have_one(case: tuple[phipsi.Scene, np.ndarray]) -> None:
    scene, q = case
    with pytest.raises(phipsi.errors.ArgumentError, match="I \\+ K"):
        scene.factor(q).K.inv()


def test_singular_joint_in_a_batch_is_named() -> None:
    builder = phipsi.SceneBuilder().link("base").link("arm", mass=1.0, com=(0.1, 0, 0)).link("ghost")
    scene = (
        builder.joint("shoulder", "revolute", "base", "arm").joint("finger", "revolute", "arm", "ghost").build()
    )
    with pytest.raises(phipsi.errors.SingularJointError, match="finger") as caught:
        scene.factor(np.zeros((2, 2)))
    assert (caught.value.joint, caught.value.state) == ("finger", 0)


def test_an_operator_of_ones_own_needs_both_products() -> None:
    class Half(phipsi.Operator):
        def matvec(self, x: Any) -> Any:
            return 0.5 * np.asarray(x)

        def toarray(self) -> Any:
            return 0.5 * np.eye(2)

    with pytest.raises(NotImplementedError, match="rmatvec"):
        Half((2, 2)).T @ np.ones(2)
