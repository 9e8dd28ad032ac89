"""Long chains with every type of joint compared with 34 digits: each form within 8 sqrt(n) eps, and form `auto`
uses the covariance form.
"""

from __future__ import annotations

import functools

import numpy as np
import oracle_recursive
import pytest
from conftest import random_rotation
from oracle_mpmath import Joint, Link, State, Tree, exact, random_tree, rounded
from tolerances import EPS, chain, recursion

import phipsi

LONG = {"revolute": 500, "prismatic": 150, "spherical": 150, "mixed": 150}
KINDS = {"mixed": ("revolute", "screw", "prismatic", "spherical")}
FORMS = ("auto", "covariance", "square-root")


def link_of(random: np.random.Generator, name: str) -> Link:
    frame = random_rotation(random)
    mass = random.uniform(0.5, 2.0)
    inertia = mass * (frame @ np.diag(random.uniform(0.02, 0.03, 3)) @ frame.T)
    return Link(name, mass, random.uniform(-0.2, 0.2, 3), 0.5 * (inertia + inertia.T))


def chain_of(kinds: tuple[str, ...], links: int, seed: int) -> Tree:
    """Links of about 1 kg and 0.3 m, joints about axes of any direction."""
    random = np.random.default_rng(seed)
    found, joints = [Link("base", 0.0, np.zeros(3), np.zeros((3, 3)))], []
    for k in range(links):
        kind = kinds[k % len(kinds)]
        parent = found[-1].name
        found.append(link_of(random, f"link{k}"))
        pitch = 0.1 if kind == "screw" else None
        xyz, axis = random.uniform(-0.3, 0.3, 3), random.normal(size=3)
        joints.append(Joint(f"joint{k}", kind, parent, f"link{k}", xyz, random_rotation(random), axis, pitch))
    return Tree(tuple(found), tuple(joints))


def state_of(scene: phipsi.Scene, seed: int, rate: float = 0.1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    q = scene.integrate(scene.neutral(), random.uniform(-3.0, 3.0, scene.nv))
    return q, random.uniform(-rate, rate, scene.nv), random.uniform(-1.0, 1.0, scene.nv)


@functools.cache
def case(kind: str) -> tuple[phipsi.Scene, tuple[np.ndarray, ...], np.ndarray]:
    """A scene, a state, and its accelerations with 34 digits."""
    tree = chain_of(KINDS.get(kind, (kind,)), LONG[kind], seed=1)
    scene = tree.scene()
    state = state_of(scene, 2)
    return scene, state, oracle_recursive.forward_dynamics(tree, *state)


def off(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest error relative to the largest entry."""
    difference = oracle_recursive.exact(found) - expected
    return float(max(abs(difference)) / max(abs(expected)))


def test_the_reference_is_the_dense_one() -> None:
    random = np.random.default_rng(3)
    for floating in (False, True):
        tree = random_tree(
            random, 7, kinds=("revolute", "prismatic", "screw", "spherical", "fixed"), armature=0.2, floating_base=floating
        )
        q, qd, tau = state_of(tree.scene(), 4, rate=1.0)
        expected = State(tree, q, qd).forward_dynamics(tau, {})
        found = oracle_recursive.forward_dynamics(tree, q, qd, tau)
        assert np.max(np.abs(rounded(found - expected))) <= 1e-29 * np.max(np.abs(rounded(expected)))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", LONG)
def test_each_form_is_within_the_rounding_of_its_length(kind: str, form: str) -> None:
    scene, state, expected = case(kind)
    qdd, info = scene.forward_dynamics(*state, form=form, return_info=True)
    # Screw and prismatic joints among revolute ones lose more precision in covariance form; the error is within the
    # tolerance of `auto`.
    loses = kind == "mixed" and form != "square-root"
    assert off(qdd, expected) <= (4.0 * scene.nv * EPS if loses else chain(scene.nv))
    if form == "auto":
        assert info.form == "covariance" and info.bound in ("tolerance", "sensitivity")


@pytest.mark.parametrize("kind", LONG)
def test_double_double_is_no_worse_than_what_it_replaces(kind: str) -> None:
    scene, state, expected = case(kind)
    qdd, info = scene.forward_dynamics(*state, form="square-root", tolerance=1e-15, return_info=True)
    assert info.form == "double-double" and info.bound == "tolerance"
    assert off(qdd, expected) <= chain(scene.nv)


def test_rotations_too_long_and_too_short_by_half_an_eps_give_the_same_answer() -> None:
    tree = chain_of(("revolute",), 300, seed=5)
    answers = []
    for stretch in (1.0 - 0.5 * EPS, 1.0 + EPS):
        joints = []
        for joint in tree.joints:
            # Smaller than the rounding error of the entry: a product with 1 + eps/2 would not change it.
            longer = np.nextafter(joint.rotation, np.sign(joint.rotation) * (2.0 if stretch > 1.0 else 0.0))
            joints.append(Joint(joint.name, joint.kind, joint.parent, joint.child, joint.xyz, longer, joint.axis))
        scene = Tree(tree.links, tuple(joints)).scene()
        state = state_of(scene, 6)
        answers.append([scene.forward_dynamics(*state, form="covariance")])
        answers[-1].append(scene.forward_dynamics(*state, form="square-root", tolerance=1e-15))
    largest = np.max(np.abs(answers[0][-1]))
    for short, long in zip(*answers, strict=True):
        assert np.max(np.abs(short - long)) <= chain(300) * largest


def test_stored_rotations_change_no_length_on_average() -> None:
    """Neither the given ones, nor compositions of many fixed joints."""
    random = np.random.default_rng(7)
    defects = []
    for _ in range(30):
        builder = phipsi.SceneBuilder().link("base")
        for k in range(10):
            builder.link(f"link{k}", 1.0, (0.1, 0.0, 0.0), np.eye(3))
            kind = "revolute" if k == 0 else "fixed"
            axis = {"axis": random.normal(size=3)} if k == 0 else {}
            parent = "base" if k == 0 else f"link{k - 1}"
            builder.joint(f"joint{k}", kind, parent, f"link{k}", rpy=random.uniform(-3.0, 3.0, 3), **axis)
        scene = builder.build()
        for placement in scene.placement(np.zeros(1), scene.link_names[1:]):
            wide = exact(placement[:3, :3])
            defects.append(float(np.sum(wide * wide) - 3) / (3.0 * EPS))
    assert abs(np.mean(defects)) <= 0.2
    # Ten in series are not longer than one.
    assert np.max(np.abs(defects)) <= recursion(1, 1.0) / EPS
