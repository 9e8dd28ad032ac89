"""Forms of the recursion from Python: equal results, and typed errors if a form is not applicable."""

import numpy as np
import phipsi
import pytest
from conftest import random_scene, random_states
from phipsi.errors import ArgumentError, SingularJointError
from tolerances import assert_near, inverse, size

FORMS = ("auto", "covariance", "square-root")


@pytest.fixture(params=range(4))
def case(request: pytest.FixtureRequest) -> tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray]:
    seed = request.param
    scene = random_scene(seed, 7, armature=0.2 * (seed % 2), floating_base=seed > 1)
    state = random_states(scene, seed, (5,))
    return scene, state.q, state.qd, state.tau


Case = tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray]


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_dense_answer(form: str, case: Case) -> None:
    scene, q, qd, tau = case
    m = scene.mass_matrix(q)
    dense = np.linalg.solve(m, (tau - scene.bias_torque(q, qd))[..., None])[..., 0]
    condition = float(np.linalg.cond(m).max())
    assert_near(scene.forward_dynamics(q, qd, tau, form=form), dense, inverse(condition, size(dense)))
    m_inv = np.linalg.inv(m)
    assert_near(scene.mass_matrix_inverse(q, form=form), m_inv, inverse(condition, size(m_inv)))
    factor = scene.factor(q, form=form)
    assert_near(factor.solve(tau), np.linalg.solve(m, tau[..., None])[..., 0], inverse(condition, size(dense)))
    assert_near(factor.log_det, np.linalg.slogdet(m)[1], inverse(condition, 1.0))
    link = scene.link_names[-1]
    j = scene.jacobian(q, link)
    omega = j @ m_inv @ np.swapaxes(j, -1, -2)
    assert_near(scene.operational_inverse_inertia(q, link, form=form), omega, inverse(condition, size(omega)))


@pytest.mark.parametrize("form", FORMS)
def test_an_inertia_about_one_axis_needs_a_force_outside_of_its_root(form: str) -> None:
    builder = phipsi.SceneBuilder().link("base")
    for k, (inertia, axis) in enumerate([((0.2, 0.3, 0.25), (0, 0, 1)), ((0.1, 0.2, 0.2), (0, 1, 0.4)), ((0.3, 0.0, 0.0), (1, 0, 0.2))]):
        builder.link(f"link{k}", 1.5, (0.1, 0.2, -0.1), np.diag(inertia))
        builder.joint(f"joint{k}", "revolute", f"link{k - 1}" if k else "base", f"link{k}", xyz=(0.3, 0.1, 0.2), rpy=(0.3, -0.2, 0.5), axis=axis)
    with pytest.warns(phipsi.errors.InertiaWarning, match="link2"):
        scene = builder.build()
    q, qd, tau = np.array([0.3, -0.7, 0.4]), np.array([2.0, -3.0, 1.5]), np.array([0.5, 1.0, -0.2])
    dense = np.linalg.solve(scene.mass_matrix(q), tau - scene.bias_torque(q, qd))
    assert_near(scene.forward_dynamics(q, qd, tau, form=form), dense, inverse(float(np.linalg.cond(scene.mass_matrix(q))), size(dense)))


def test_forms_are_different_programs(case: Case) -> None:
    scene, q, qd, tau = case
    found = {scene.forward_dynamics(q, qd, tau, form=form).tobytes() for form in FORMS[1:]}
    assert len(found) == 2


@pytest.mark.parametrize("form", ["Square-Root", "", "kalman", "joseph"])
def test_unknown_form(form: str, arm: phipsi.Scene) -> None:
    zero = np.zeros(7)
    for call in (
        lambda: arm.forward_dynamics(zero, zero, zero, form=form),
        lambda: arm.mass_matrix_inverse(zero, form=form),
        lambda: arm.factor(zero, form=form),
        lambda: arm.operational_inverse_inertia(zero, "link6", form=form),
        lambda: arm.operational_inertia(zero, "link6", form=form),
    ):
        with pytest.raises(ArgumentError, match='form: found .* one of "auto", "covariance", "square-root"'):
            call()


def test_an_inertia_without_a_root_names_its_link() -> None:
    builder = phipsi.SceneBuilder().link("base").link("odd", 1.0, (0.1, 0, 0), np.diag([-0.1, 1.0, 1.0]))
    with pytest.warns(phipsi.errors.InertiaWarning):
        scene = builder.joint("hinge", "revolute", "base", "odd").build()
    zero = np.zeros(1)
    with pytest.raises(ArgumentError, match="odd"):
        scene.forward_dynamics(zero, zero, zero, form="square-root")
    assert np.isfinite(scene.forward_dynamics(zero, zero, zero)).all()


@pytest.mark.parametrize("form", FORMS)
def test_singular_joints_are_named_in_every_form(form: str) -> None:
    builder = phipsi.SceneBuilder().link("base").link("arm", mass=1.0, com=(0.1, 0, 0)).link("ghost")
    scene = (
        builder.joint("shoulder", "revolute", "base", "arm").joint("finger", "revolute", "arm", "ghost").build()
    )
    zero = np.zeros((2, 2))
    with pytest.raises(SingularJointError, match="finger") as caught:
        scene.forward_dynamics(zero, zero, zero, form=form)
    assert (caught.value.joint, caught.value.state) == ("finger", 0)
