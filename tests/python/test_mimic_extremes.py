"""Coupled joints, mimic="couple": extreme mass ratios, compared with 60 digits, and joints without mass."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest
from oracle_mpmath import Joint, Link, Tree
from test_mimic import Case
from tolerances import EPS, assert_near, inverse, size

import phipsi
from phipsi.errors import MimicWarning, SingularJointError


def gripper(ratio: float, armature: float = 0.0) -> phipsi.SceneBuilder:
    """An arm of three joints with two fingers that close together, the second with `ratio` times the mass of the
    arm.
    """
    builder = phipsi.SceneBuilder().link("base")
    parent = "base"
    for k in range(3):
        builder.link(f"arm{k}", 1.0, (0.1, 0.02, 0.3), np.diag([0.02, 0.03, 0.01]))
        builder.joint(f"joint{k}", "revolute", parent, f"arm{k}", xyz=(0.0, 0.1, 0.5), axis=(1.0, 0.3 * k, 0.2), armature=armature)
        parent = f"arm{k}"
    for side in (1.0, -1.0):
        name = "left" if side > 0 else "right"
        mass = 0.1 if side > 0 else ratio
        builder.link(name, mass, (0.01 * side, 0.0, 0.1), mass * np.diag([1e-3, 2e-3, 1e-3]))
        follow = {} if side > 0 else {"mimic": "left_finger", "mimic_multiplier": -1.0}
        builder.joint(f"{name}_finger", "prismatic", "arm2", name, xyz=(0.05 * side, 0.0, 0.2), axis=(1.0, 0.0, 0.0), **follow)
    return builder


def heavy_tip(ratio: float, joints: int = 8) -> phipsi.SceneBuilder:
    """A chain whose last link has `ratio` times the mass of the others, and follows the first."""
    random = np.random.default_rng(1)
    builder, parent = phipsi.SceneBuilder().link("base"), "base"
    for k in range(joints):
        mass = ratio if k == joints - 1 else 1.0
        builder.link(f"link{k}", mass, (0.1, 0.02, 0.3), mass * np.diag([0.02, 0.03, 0.01]))
        follow = {"mimic": "joint0", "mimic_multiplier": 0.7} if k == joints - 1 else {}
        builder.joint(f"joint{k}", "revolute", parent, f"link{k}", xyz=(0.05, 0.1, 0.5), axis=random.normal(size=3), **follow)
        parent = f"link{k}"
    return builder


class Extreme(Case):
    def __init__(self, builder: phipsi.SceneBuilder) -> None:
        self.scene, self.free = builder.build(mimic="couple"), builder.build(mimic="free")
        links = tuple(Link(name, link.mass, link.com, link.inertia) for name, link in self.free.links.items())
        child = {link.joint: name for name, link in self.free.links.items()}
        joints = self.free.joints
        self.tree = Tree(links, tuple(Joint(n, j.type, j.parent, child[n], j.xyz, j.rotation, j.axis) for n, j in joints.items()))
        self.follows = {name: tuple(joint.mimic) for name, joint in joints.items() if joint.mimic is not None}
        self.g, self.o = self.reduction()
        self.q, self.qd, self.tau = np.random.default_rng(3).uniform(-1.0, 1.0, (3, self.scene.nv))
        self.wrenches = {}


@pytest.mark.filterwarnings("ignore::phipsi.errors.MimicWarning")
@pytest.mark.parametrize("ratio", [1e-9, 1e-4, 1e4, 1e8, 1e12])
@pytest.mark.parametrize("make", [gripper, heavy_tip])
@pytest.mark.parametrize("form", ["auto", "square-root"])
def test_mass_ratios_keep_their_digits(ratio: float, make: Callable[[float], phipsi.SceneBuilder], form: str) -> None:
    """The bound is the effect of a change of q, qd and tau by 2^-40, not the condition number of M: in square-root form
    by 2^-52; in auto, which falls back to it if a pivot lost five digits, by 2^-40.
    """
    case = Extreme(make(ratio))
    qdd = case.exact_accelerations()
    found = case.scene.forward_dynamics(case.q, case.qd, case.tau, form=form)
    changed = 0.0
    for name in ("q", "tau", "qd"):
        of = getattr(case, name)
        for i in range(len(of)):
            kept = of[i]
            of[i] = kept * (1 + 2**-40)
            changed = max(changed, float(np.max(np.abs(case.exact_accelerations() - qdd))))
            of[i] = kept
    assert_near(found, qdd, (64 * 2**-12 if form == "square-root" else 64) * changed + 64 * EPS * size(qdd))


@pytest.mark.filterwarnings("ignore::phipsi.errors.MimicWarning")
def test_covariance_form_loses_what_auto_keeps() -> None:
    case = Extreme(heavy_tip(1e10))
    qdd = case.exact_accelerations()
    lost = np.max(np.abs(case.scene.forward_dynamics(case.q, case.qd, case.tau, form="covariance") - qdd))
    found, info = case.scene.forward_dynamics(case.q, case.qd, case.tau, return_info=True)
    assert np.max(np.abs(found - qdd)) < 1e-6 * lost
    assert str(info.form) == "double-double"


def test_a_finger_without_mass_follows() -> None:
    """Its own pivot is zero, that of the sum is not: with an independent joint, this robot is singular."""
    text = gripper(0.0)
    scene = text.build(mimic="couple")
    state = np.full(4, 0.3)
    assert np.isfinite(scene.forward_dynamics(state, state, state)).all()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MimicWarning)
        free = text.build()
    with pytest.raises(SingularJointError, match="right_finger"):
        free.forward_dynamics(np.full(5, 0.3), np.zeros(5), np.zeros(5))


def light(side: str) -> phipsi.SceneBuilder:
    """Two arms that follow each other, of which one has no mass, and a leg."""
    builder = phipsi.SceneBuilder().link("base")
    builder.link("leg", 1.0, (0.1, 0.0, 0.2), 0.02 * np.eye(3)).joint("hip", "revolute", "base", "leg", axis=(0, 1, 0), xyz=(0, 0, 1))
    for name, other in (("left", None), ("right", "left")):
        mass = 0.0 if name == side else 0.5
        builder.link(name, mass, (0.2, 0.0, 0.0), 0.1 * mass * np.eye(3))
        builder.joint(name, "revolute", "leg", name, axis=(0, 1, 0.5), xyz=(0, 0, -0.3), mimic=other, mimic_multiplier=-1.5)
    return builder


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_leader_or_a_follower_without_mass_has_the_motion_of_the_other(side: str) -> None:
    scene = light(side).build(mimic="couple")
    q, qd, tau = np.random.default_rng(2).uniform(-1.0, 1.0, (3, 20, scene.nv))
    m = scene.mass_matrix(q)
    expected = np.linalg.solve(m, (tau - scene.bias_torque(q, qd))[..., None])[..., 0]
    condition = float(np.max(np.linalg.cond(m)))
    assert_near(scene.forward_dynamics(q, qd, tau), expected, inverse(condition, size(expected)))
    assert_near(scene.forward_dynamics(q[0], qd[0], tau[0]), expected[0], inverse(condition, size(expected)))
    assert_near(scene.mass_matrix_inverse(q), np.linalg.inv(m), inverse(condition, size(np.linalg.inv(m))))
    moved = scene.simulate(q[0], qd[0], dt=1e-3, steps=100)
    energy = moved.energy().total
    assert np.max(np.abs(energy - energy[0])) < 1e-9
    # Steps with contacts, of order 1.
    touching = light(side).contact("foot", "leg", xyz=(0.1, 0.0, -0.3), friction=0.5, offset=-100.0).build(mimic="couple")
    ends = [touching.simulate(q[0], qd[0], dt=0.1 / n, steps=n, method="contact").q[-1] - moved.q[-1] for n in (100, 200)]
    assert_near(2 * ends[1] - ends[0], 0.0 * ends[0], 1e-4)


def test_large_coordinates_are_followed() -> None:
    """The coordinate of the follower is rounded as the row is."""
    builder = phipsi.SceneBuilder().link("base").link("a", 1.0).link("b", 1.0).joint("a", "prismatic", "base", "a", axis=(1, 0, 0))
    scene = builder.joint("b", "prismatic", "base", "b", axis=(1, 0, 0), mimic="a", mimic_multiplier=0.1, mimic_offset=0.3).build(mimic="couple")
    assert_near(scene.forward_dynamics([1e15 / 3], [0.0], [1.01]), [1.0], 4 * EPS)


def test_a_sum_without_mass_is_singular() -> None:
    builder = phipsi.SceneBuilder().link("base").link("arm", 1.0, (0.1, 0.0, 0.0)).link("a").link("b")
    builder.joint("arm_joint", "revolute", "base", "arm").joint("a_joint", "revolute", "arm", "a", xyz=(0.1, 0.0, 0.0))
    builder.joint("b_joint", "revolute", "arm", "b", mimic="a_joint")
    scene = builder.build(mimic="couple")
    with pytest.raises(SingularJointError, match="b_joint|a_joint"):
        scene.forward_dynamics(np.zeros(2), np.zeros(2), np.zeros(2))
