"""Form `auto` in typical states of robots, and the error estimate of forward dynamics."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from conftest import random_scene
from oracle_pinocchio import ROBOTS, urdf_files
from tolerances import EPS, ESTIMATE_SPREAD

import phipsi
from phipsi import scenes
from phipsi.errors import ArgumentError, BadStateWarning, SingularJointError
from phipsi.report import kinds

STATES = 4
#: Files without a moving joint, or with joints that move no mass.
LEFT_OUT = {"ur_description/urdf/ur3.urdf", "romeo_description/urdf/romeo.urdf", "romeo_description/urdf/romeo_laas_small.urdf"}
#: With impossible inertias only the covariance form works.
NO_ROOT = {"icub_description/robots/icub.urdf"}


def load(file: str, *, floating: bool) -> phipsi.Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return phipsi.Scene.from_urdf(ROBOTS / file, floating_base=floating)


@pytest.mark.parametrize("floating", [False, True], ids=["fixed", "free"])
@pytest.mark.parametrize("file", [file for file in urdf_files() if file not in LEFT_OUT])
def test_robots_stay_in_the_covariance_form_in_the_states_that_they_are_in(file: str, floating: bool) -> None:
    scene = load(file, floating=floating)
    if scene.nv == 0:
        pytest.skip("nothing moves")
    drawn = kinds.draw(scene, STATES, seed=0)
    for kind in kinds.KINDS:
        q, qd, tau = kinds.state(scene, drawn, kind)
        _, info = scene.forward_dynamics(q, qd, tau, return_info=True)
        assert np.all(info.form == "covariance"), f"{kind}: {info}"
        assert file in NO_ROOT or np.all(info.error >= 0.0), f"{kind}: {info}"


def states(scene: phipsi.Scene, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return kinds.state(scene, kinds.draw(scene, count, seed=1), kinds.RANDOM)


def test_the_accelerations_are_those_without_it_bit_by_bit() -> None:
    scene = random_scene(3, 12)
    q, qd, tau = states(scene, 37)
    for form in ("auto", "covariance", "square-root"):
        qdd, info = scene.forward_dynamics(q, qd, tau, form=form, return_info=True)
        np.testing.assert_array_equal(qdd, scene.forward_dynamics(q, qd, tau, form=form))
        assert info.form.shape == info.error.shape == (37,)
        assert set(info.form) == {"covariance" if form == "auto" else form}
        assert np.all(info.error > 0.0)
        assert np.all(info.error <= 1e-9 * np.abs(qdd).max(axis=-1))


def test_one_state_is_told_in_plain_values() -> None:
    scene = scenes.chain(5)
    q, qd, tau = (x[0] for x in states(scene, 1))
    qdd, info = scene.forward_dynamics(q, qd, tau, return_info=True)
    assert qdd.shape == (5,) and isinstance(info, phipsi.Accuracy)
    assert info.form == "covariance" and isinstance(info.form, str) and isinstance(info.error, float)


def test_leading_axes_are_those_of_the_batch_and_out_is_filled() -> None:
    scene = scenes.chain(4)
    q, qd, tau = states(scene, 6)
    out = np.empty((2, 3, 4))
    given = (x.reshape(2, 3, 4) for x in (q, qd, tau))
    qdd, info = scene.forward_dynamics(*given, out=out, return_info=True)
    assert qdd is out and info.form.shape == info.error.shape == (2, 3)


def test_what_was_refined_is_visible_state_by_state() -> None:
    scene = scenes.extreme("heavy-tip", 1e12).scene
    q, qd, tau = states(scene, 8)
    qdd, info = scene.forward_dynamics(q, qd, tau, return_info=True)
    assert set(info.form) <= {"square-root", "double-double"}
    largest = np.abs(qdd).max(axis=-1)
    assert np.all(info.error <= 1e-12 * largest)
    alone, covariance = scene.forward_dynamics(q, qd, tau, form="covariance", return_info=True)
    off = np.abs(alone - qdd).max(axis=-1)
    assert np.all(off > 1e-9 * largest), "the covariance form loses precision here"
    assert np.all(off <= ESTIMATE_SPREAD * covariance.error), "its error estimate is too small"


def test_refined_states_stand_among_others_of_a_batch() -> None:
    scene = scenes.extreme("heavy-tip", 1e3).scene
    q, qd, tau = states(scene, 64)
    _, info = scene.forward_dynamics(q, qd, tau, return_info=True)
    one_by_one = [scene.forward_dynamics(*state, return_info=True)[1] for state in zip(q, qd, tau, strict=True)]
    assert [one.form for one in one_by_one] == list(info.form)
    np.testing.assert_allclose([one.error for one in one_by_one], info.error, rtol=0.5)


def test_the_estimate_of_float32_results_is_that_before_rounding() -> None:
    scene = scenes.chain(7)
    q, qd, tau = states(scene, 64)
    expected, before = scene.forward_dynamics(q, qd, tau, return_info=True)
    qdd, info = scene.forward_dynamics(q, qd, tau, dtype=np.float32, return_info=True)
    assert np.array_equal(qdd, expected.astype(np.float32)) and np.array_equal(info.error, before.error)


def test_a_bad_state_has_no_estimate() -> None:
    scene = scenes.chain(3)
    q, qd, tau = states(scene, 5)
    tau[2, 1] = np.nan
    with pytest.warns(BadStateWarning):
        qdd, info = scene.forward_dynamics(q, qd, tau, errors="nan", return_info=True)
    assert np.isnan(info.error[2]) and np.all(np.isnan(qdd[2])) and np.all(info.error[[0, 1, 3, 4]] > 0.0)


def test_an_empty_batch_has_empty_answers() -> None:
    scene = scenes.chain(3)
    qdd, info = scene.forward_dynamics(*(np.empty((0, 3)),) * 3, return_info=True)
    assert qdd.shape == (0, 3) and info.form.shape == info.error.shape == (0,)


def test_faults_raise_as_without_it() -> None:
    builder = phipsi.SceneBuilder()
    builder.link("base").link("tip", 1.0, (0.0, 0.0, 0.0), np.zeros((3, 3)))
    builder.joint("spin", "revolute", "base", "tip", axis=(0.0, 0.0, 1.0))
    with pytest.raises(SingularJointError):
        builder.build().forward_dynamics([0.0], [0.0], [1.0], return_info=True)
    with pytest.raises(ArgumentError, match="form"):
        scenes.chain(1).forward_dynamics([0.0], [0.0], [1.0], form="best", return_info=True)
