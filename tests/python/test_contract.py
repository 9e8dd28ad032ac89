"""Names, orders, shapes and objects of the Python interface."""

from __future__ import annotations

import copy
import doctest
import importlib.metadata
import inspect

import numpy as np
import pytest
from conftest import KINDS, random_scene, random_states
from tolerances import assert_near, inverse

import phipsi

SIZES = {"fixed": (0, 0), "planar": (3, 3), "spherical": (4, 3), "floating": (7, 6)}


def tree() -> phipsi.SceneBuilder:
    """base - (a: left - (fixed) - palm - (c: finger), b: right), the joint of right before that of finger."""
    builder = phipsi.SceneBuilder()
    for name in ("base", "left", "palm", "finger", "right"):
        builder.link(name, mass=1.0, inertia=np.eye(3))
    builder.joint("a", "spherical", "base", "left")
    builder.joint("b", "prismatic", "base", "right", lower=-1, upper=2, velocity=3, effort=4)
    builder.joint("weld", "fixed", "left", "palm")
    return builder.joint("c", "revolute", "palm", "finger")


def test_version_is_the_distribution_s() -> None:
    assert phipsi.__version__ == importlib.metadata.version("phipsi")


def test_joints_are_depth_first_siblings_in_file_order() -> None:
    scene = tree().build()
    assert scene.joint_names == ("a", "c", "b")
    assert scene.body_names == ("left", "finger", "right")
    assert scene.link_names == ("base", "left", "palm", "finger", "right")
    assert (scene.nq, scene.nv) == (6, 5)
    assert scene.q_index("c") == slice(4, 5, 1)
    assert scene.v_index("b") == slice(4, 5, 1)
    np.testing.assert_array_equal(scene.neutral(), [0, 0, 0, 1, 0, 0])


def test_a_floating_base_has_a_root_joint() -> None:
    scene = tree().build(floating_base=True)
    assert scene.joint_names[0] == "root_joint"
    assert scene.body_names[0] == "base"
    assert scene.q_index("root_joint") == slice(0, 7, 1)
    assert scene.v_index("root_joint") == slice(0, 6, 1)
    np.testing.assert_array_equal(scene.neutral()[:7], [0, 0, 0, 0, 0, 0, 1])


@pytest.mark.parametrize("kind", KINDS)
def test_sizes_of_the_joint_kinds(kind: str) -> None:
    scene = random_scene(0, 1, kinds=(kind,))
    assert (scene.nq, scene.nv) == SIZES.get(kind, (1, 1))
    q, qd, tau = random_states(scene, 1)
    assert scene.forward_dynamics(q, qd, tau).shape == (scene.nv,)


def test_limits_are_by_degree_of_freedom() -> None:
    limits = tree().build().limits
    assert limits._fields[:4] == ("lower", "upper", "velocity", "effort")
    np.testing.assert_array_equal(limits.lower, [-np.inf] * 4 + [-1])
    np.testing.assert_array_equal(limits.upper, [np.inf] * 4 + [2])
    np.testing.assert_array_equal(limits.velocity, [np.inf] * 4 + [3])
    np.testing.assert_array_equal(limits.effort, [np.inf] * 4 + [4])


def test_gravity_is_a_property_with_a_default() -> None:
    np.testing.assert_array_equal(tree().build().gravity, [0, 0, -9.81])
    scene = tree().build(gravity=[1, 2, 3])
    with pytest.raises(ValueError, match="read-only"):
        scene.gravity[0] = 5.0
    np.testing.assert_array_equal(scene.gravity, [1, 2, 3])


def test_repr_says_what_it_is() -> None:
    text = repr(tree().build(floating_base=True))
    for part in ("nq=13", "nv=11", "1 spherical", "1 floating", "5 links", "1 merged", "floating base", "-9.81"):
        assert part in text
    assert repr(tree()) == "<phipsi.SceneBuilder: 5 links, 4 joints>"


def test_scenes_hash_and_compare_by_identity() -> None:
    one, other = tree().build(), tree().build()
    assert one == one and one != other
    assert len({one, one, other}) == 2


def test_copies_are_the_scene_itself() -> None:
    scene = tree().build()
    assert copy.copy(scene) is scene
    assert copy.deepcopy([scene])[0] is scene


def test_scenes_are_immutable() -> None:
    scene = tree().build()
    with pytest.raises(AttributeError):
        scene.nq = 3  # type: ignore[misc]


def test_one_state_gives_numpy_scalars_of_energy(arm: phipsi.Scene) -> None:
    q, qd, _ = random_states(arm, 0)
    energy = arm.energy(q, qd)
    assert isinstance(energy, phipsi.Energy)
    assert isinstance(energy.kinetic, np.float64) and isinstance(energy.potential, np.float64)


def test_placements_are_arrays_of_their_own(mixed: phipsi.Scene) -> None:
    q = random_states(mixed, 0, (5,)).q
    placements = mixed.placements(q)
    assert tuple(placements) == mixed.link_names
    for placement in placements.values():
        assert placement.shape == (5, 4, 4)
        assert placement.flags.c_contiguous and placement.flags.owndata and placement.flags.writeable


def test_plan_tells_merged_joints() -> None:
    plan = tree().build().plan()
    assert (plan.bodies, plan.links) == (3, 5)
    assert ("weld",) in [item.names for item in plan.items]
    assert all(item.what and item.why and item.saved and item.count for item in plan.items)


def test_form_names_that_work(arm: phipsi.Scene) -> None:
    q, qd, tau = random_states(arm, 0)
    ordinary = arm.forward_dynamics(q, qd, tau)
    for form in ("auto", "covariance", "square-root"):
        found = arm.forward_dynamics(q, qd, tau, form=form)
        bound = inverse(float(np.linalg.cond(arm.mass_matrix(q))), float(np.abs(ordinary).max()))
        assert_near(found, ordinary, bound)


@pytest.mark.parametrize("owner", [phipsi.Scene, phipsi.SceneBuilder])
def test_everything_public_is_documented(owner: type) -> None:
    assert inspect.getdoc(owner)
    for name in vars(owner):
        if not name.startswith("_") and hasattr(owner, name):
            assert inspect.getdoc(getattr(owner, name)), f"{owner.__name__}.{name}"


def test_the_example_of_the_package_runs() -> None:
    example = doctest.DocTestParser().get_doctest(phipsi.__doc__ or "", dict(vars(phipsi)), "phipsi", None, None)
    outcome = doctest.DocTestRunner().run(example)
    assert outcome.attempted and not outcome.failed


def test_armature_is_on_the_diagonal_of_m() -> None:
    builder = phipsi.SceneBuilder().link("base").link("a", 1.0, (0, 0.5, 0)).link("b", 1.0, (0, 0.5, 0))
    builder.joint("one", "revolute", "base", "a", armature=0.25).joint("two", "spherical", "a", "b", armature=0.5)
    scene = builder.build()
    assert scene.armature.tolist() == [0.25, 0.5, 0.5, 0.5]
    with pytest.raises(ValueError, match="read-only"):
        scene.armature[:] = 7.0
    assert scene.armature.tolist() == [0.25, 0.5, 0.5, 0.5]
