"""Scenes from code: supported, refused and warned arguments of the builder."""

from __future__ import annotations

import math
import re
import warnings
from typing import Any

import numpy as np
import pytest
from tolerances import EPS, assert_near

import phipsi
from phipsi.errors import (
    ArgumentError,
    InertiaWarning,
    LimitWarning,
    MimicWarning,
    NotFiniteError,
    SceneError,
    ShapeError,
    UnitsWarning,
    UnknownTagWarning,
)

BODY = {"mass": 1.0, "com": (0.1, 0.2, 0.3), "inertia": np.diag([2.0, 3.0, 4.0])}


def pendulum(link: dict[str, Any] | None = None, **joint: Any) -> phipsi.SceneBuilder:
    """A base and a rod; keywords replace those of the rod and the joint."""
    arguments = {"name": "hinge", "type": "revolute", "parent": "base", "child": "rod"} | joint
    name, kind, parent, child = (arguments.pop(key) for key in ("name", "type", "parent", "child"))
    builder = phipsi.SceneBuilder().link("base").link("rod", **(BODY | (link or {})))
    return builder.joint(name, kind, parent, child, **arguments)


def test_chained_calls_give_the_builder() -> None:
    builder = phipsi.SceneBuilder()
    assert builder.link("base") is builder
    assert builder.link("rod").joint("hinge", "fixed", "base", "rod") is builder


def test_a_builder_can_build_twice() -> None:
    builder = pendulum()
    first = builder.build()
    builder.link("tool", mass=1.0).joint("grip", "fixed", "rod", "tool")
    assert first.link_names == ("base", "rod")
    assert builder.build().link_names == ("base", "rod", "tool")


def test_inertia_is_about_the_center_of_mass() -> None:
    scene = pendulum(axis=(0, 0, 1)).build()
    assert_near(scene.mass_matrix([0.0]), [[4.0 + 0.1**2 + 0.2**2]], 8 * EPS)


def test_without_inertia_a_link_is_a_point_mass() -> None:
    scene = phipsi.SceneBuilder().link("base").link("bob", 2.0, (0, 3, 0)).joint("hinge", "revolute", "base", "bob")
    assert_near(scene.build().mass_matrix([0.0]), [[18.0]], 64 * EPS)


def test_rpy_is_yaw_after_pitch_after_roll() -> None:
    def turn(axis: int, angle: float) -> np.ndarray:
        i, j = (axis + 1) % 3, (axis + 2) % 3
        rotation = np.eye(3)
        rotation[[i, j], [i, j]] = math.cos(angle)
        rotation[j, i] = math.sin(angle)
        rotation[i, j] = -math.sin(angle)
        return rotation

    expected = turn(2, 0.3) @ turn(1, 0.2) @ turn(0, 0.1)
    by_angles = pendulum(rpy=(0.1, 0.2, 0.3), xyz=[1, 2, 3]).build().placements([0.0])["rod"]
    by_matrix = pendulum(rotation=expected, xyz=[1, 2, 3]).build().placements([0.0])["rod"]
    assert_near(by_angles[:3, :3], expected, 8 * EPS)
    assert_near(by_matrix, by_angles, 8 * EPS)
    assert_near(by_angles[:3, 3], [1, 2, 3], 0.0)


REFUSED: dict[str, tuple[dict[str, Any], type[Exception], str]] = {
    "type": ({"type": "hinge"}, SceneError, r'joint "hinge": found type "hinge"; expected one of fixed, revolute, .*screw'),
    "screw without pitch": ({"type": "screw"}, SceneError, r'joint "hinge".*without a pitch'),
    "pitch of no screw": ({"pitch": 0.1}, SceneError, r'joint "hinge".*pitch 0\.1 for a revolute'),
    "parent": ({"parent": "floor"}, SceneError, r'"hinge".*parent link "floor".*"base", "rod"'),
    "child": ({"child": "stick"}, SceneError, r'"hinge".*child link "stick"'),
    "xyz": ({"xyz": (1, 2)}, ShapeError, r'xyz of joint "hinge": found shape \(2,\); expected \(3,\)'),
    "xyz dtype": ({"xyz": "abc"}, ArgumentError, r'xyz of joint "hinge": found dtype'),
    "xyz finite": ({"xyz": (1, 2, math.nan)}, SceneError, r'joint "hinge".*NaN'),
    "rpy": ({"rpy": [[1, 2, 3]]}, ShapeError, r'rpy of joint "hinge": found shape \(1, 3\)'),
    "rotation": ({"rotation": np.eye(4)}, ShapeError, r'rotation of joint "hinge".*\(3, 3\)'),
    "no rotation": ({"rotation": 2 * np.eye(3)}, SceneError, r'joint "hinge".*rotation'),
    "rpy and rotation": ({"rpy": (0, 0, 0), "rotation": np.eye(3)}, ArgumentError, r"rpy and rotation"),
    "axis": ({"axis": (0, 0, 0)}, SceneError, r'joint "hinge".*axis'),
    "armature": ({"armature": -1.0}, SceneError, r'joint "hinge".*armature -1'),
    "damping": ({"damping": math.inf}, SceneError, r'joint "hinge".*damping inf'),
    "friction": ({"friction": -1.0}, SceneError, r'joint "hinge".*friction -1'),
    "stiffness": ({"stiffness": -1.0}, SceneError, r'joint "hinge".*stiffness -1'),
    "rest": ({"rest": (1, 2)}, ShapeError, r'rest of joint "hinge": found shape \(2,\)'),
    "rest finite": ({"rest": math.nan}, SceneError, r'joint "hinge".*rest NaN'),
    "limits": ({"lower": 2.0, "upper": 1.0}, SceneError, r'joint "hinge".*limits from 2 to 1'),
    "velocity": ({"velocity": -1.0}, SceneError, r'joint "hinge".*velocity'),
    "effort": ({"effort": -1.0}, SceneError, r'joint "hinge".*effort'),
    "mass": ({"link": {"mass": -1.0}}, SceneError, r'link "rod".*mass -1'),
    "com": ({"link": {"com": (1, 2)}}, ShapeError, r'com of link "rod".*\(2,\).*\(3,\)'),
    "com dtype": ({"link": {"com": (1j, 2, 3)}}, ArgumentError, r'com of link "rod": found dtype complex128'),
    "inertia": ({"link": {"inertia": np.ones(6)}}, ShapeError, r'inertia of link "rod".*\(6,\).*\(3, 3\)'),
    "asymmetric": ({"link": {"inertia": np.triu(np.ones((3, 3)))}}, ArgumentError, r'inertia of link "rod".*triangles'),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_by_name(case: str) -> None:
    arguments, error, message = REFUSED[case]
    with pytest.raises(error, match=message):
        pendulum(**arguments).build()


def test_scenes_are_trees_of_unique_names() -> None:
    with pytest.raises(SceneError, match=r'link "rod".*duplicate name'):
        pendulum().link("rod").build()
    with pytest.raises(SceneError, match=r'joint "hinge".*duplicate name'):
        pendulum().link("tool").joint("hinge", "fixed", "rod", "tool").build()
    with pytest.raises(SceneError, match=r'link "rod".*two parent joints, "hinge" and "other"'):
        pendulum().joint("other", "fixed", "base", "rod").build()
    with pytest.raises(SceneError, match=r'link "tool".*second root'):
        pendulum().link("tool").build()
    with pytest.raises(SceneError, match=r'link "base".*cycle'):
        pendulum().joint("back", "fixed", "rod", "base").build()
    with pytest.raises(SceneError, match=r"no link"):
        phipsi.SceneBuilder().build()


@pytest.mark.parametrize(
    ("gravity", "error", "message"),
    [
        ((0, 0), ShapeError, r"gravity: found shape \(2,\); expected \(3,\)"),
        ((0, 0, math.inf), SceneError, r"gravity.*inf"),
        (None, None, ""),
    ],
)
def test_gravity(gravity: Any, error: type[Exception] | None, message: str) -> None:
    if error is None:
        assert pendulum().build(gravity=gravity).gravity[2] == -9.81
        return
    with pytest.raises(error, match=message):
        pendulum().build(gravity=gravity)


def test_an_unphysical_inertia_warns_at_the_line_that_built_it() -> None:
    builder = pendulum({"inertia": np.diag([1.0, 1.0, 3.0])})
    with pytest.warns(InertiaWarning, match=r'link "rod".*triangle') as caught:
        scene = builder.build()
    assert [warning.filename for warning in caught] == [__file__]
    with pytest.raises(SceneError, match=r'link "rod".*strict'):
        builder.build(strict=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert scene.lock(["hinge"], [0.0]).nv == 0


def test_a_mimic_joint_warns_and_stays_free() -> None:
    builder = pendulum().link("tool", mass=1.0, com=(1, 0, 0)).joint("grip", "revolute", "rod", "tool", mimic="hinge")
    with pytest.warns(MimicWarning, match=r'joint "grip": mimics "hinge"'):
        assert builder.build().nv == 2


def test_a_warning_turned_error_raises() -> None:
    builder = pendulum({"inertia": np.diag([1.0, 1.0, 3.0])})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InertiaWarning):
            builder.build()


def test_error_classes() -> None:
    for error in (SceneError, ShapeError, ArgumentError, NotFiniteError):
        assert issubclass(error, ValueError) and issubclass(error, phipsi.errors.PhipsiError)
    assert issubclass(phipsi.errors.SingularJointError, ArithmeticError)
    for warning in (InertiaWarning, LimitWarning, MimicWarning, UnknownTagWarning):
        assert issubclass(warning, UserWarning)


def test_names_from_anywhere() -> None:
    """Names are data: quotes, other scripts and zero bytes are unchanged in messages."""
    name = 'ра"м\0a'
    builder = phipsi.SceneBuilder().link("base").link(name, 1.0, (0, 0, 0), np.diag([1.0, 1.0, 3.0]))
    with pytest.warns(InertiaWarning, match=re.escape("ра")):
        scene = builder.joint("j", "revolute", "base", name).build()
    assert scene.body_names == (name,)
    assert scene.jacobian([0.0], name).shape == (6, 1)


def test_a_universal_joint_is_two_hinges() -> None:
    universal = pendulum(type="universal", rpy=(0.3, -0.2, 0.5)).build()
    cross = phipsi.SceneBuilder().link("base").link("cross").link("rod", **BODY)
    cross.joint("x", "revolute", "base", "cross", rpy=(0.3, -0.2, 0.5), axis=(1, 0, 0))
    hinges = cross.joint("y", "revolute", "cross", "rod", axis=(0, 1, 0)).build()
    assert universal.q_index("hinge") == universal.v_index("hinge") == slice(0, 2, 1)
    q, qd, tau = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 5, 2))
    for name in ("forward_dynamics", "inverse_dynamics"):
        assert_near(getattr(universal, name)(q, qd, tau), getattr(hinges, name)(q, qd, tau), 1e-12)
    assert_near(universal.placements(q)["rod"], hinges.placements(q)["rod"], 8 * EPS)
    assert_near(universal.difference(q, universal.integrate(q, qd)), qd, 8 * EPS)


@pytest.mark.parametrize(("name", "axis"), [("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1)), ("-x", (-1, 0, 0)), ("-y", (0, -1, 0)), ("-z", (0, 0, -1))])
def test_an_axis_has_a_name(name: str, axis: tuple[int, int, int]) -> None:
    builder = phipsi.SceneBuilder().link("base").link("rod", mass=1.0, com=(0.1, 0.2, 0.3))
    scene = builder.joint("hinge", "revolute", "base", "rod", axis=name).build()
    assert_near(scene.joints["hinge"].axis, axis, 0.0)


def test_an_axis_of_another_name() -> None:
    with pytest.raises(ArgumentError, match='axis of joint "hinge": found "up"; expected one of "x", "y", "z", "-x", "-y", "-z"'):
        phipsi.SceneBuilder().joint("hinge", "revolute", "base", "rod", axis="up")


@pytest.mark.parametrize(("type", "lower", "upper", "warns"), [
    ("revolute", -90, 90, True), ("revolute", -180, 180, True), ("revolute", 0, 45, True), ("revolute", -1.57, 120, True),
    ("revolute", -6.28, 6.28, False), ("revolute", -31.4159, 31.4159, False), ("revolute", -1e9, 1e9, False), ("revolute", -20, 20, False),
    ("revolute", -math.inf, math.inf, False), ("prismatic", -90, 90, False),
])  # fmt: skip
def test_limits_in_degrees_warn(type: str, lower: float, upper: float, warns: bool) -> None:
    builder = phipsi.SceneBuilder().link("base").link("rod", mass=1.0, com=(0.1, 0.2, 0.3))
    builder.joint("hinge", type, "base", "rod", lower=lower, upper=upper)
    if not warns:
        builder.build(strict=True)
        return
    with pytest.warns(UnitsWarning, match='joint "hinge": limits from .* rad, which look like degrees; limits are in rad'):
        scene = builder.build()
    assert scene.limits.upper == upper
    with pytest.raises(SceneError, match='joint "hinge".*limits in rad'):
        builder.build(strict=True)
