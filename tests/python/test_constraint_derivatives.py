"""Derivatives of forward dynamics through connections: against differences, products against matrices, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import random_scene
from tolerances import STEP, assert_near, central_difference, inverse, size

import phipsi
from phipsi.errors import ArgumentError


def bar(builder: phipsi.SceneBuilder, name: str, parent: str, at: tuple[float, float, float], length: float) -> None:
    builder.link(name, 1.0, (0.01, 0.02, length / 2), np.diag([length**2 / 12, length**2 / 12, 1e-3]))
    builder.joint(f"{name}_joint", "continuous", parent, name, xyz=at, axis=(0, 1, 0), armature=1e-3)


def four_bar(kind: str) -> tuple[phipsi.Scene, np.ndarray]:
    builder = phipsi.SceneBuilder().link("ground")
    bar(builder, "crank", "ground", (0, 0, 0), 0.2)
    bar(builder, "coupler", "crank", (0, 0, 0.2), 0.4)
    bar(builder, "rocker", "ground", (0.3, 0, 0), 0.3)
    if kind == "weld":
        # The rocker hangs on the coupler, and its foot is welded to a hinge of the ground.
        builder = phipsi.SceneBuilder().link("ground")
        bar(builder, "foot", "ground", (0.3, 0, 0), 0.1)
        bar(builder, "crank", "ground", (0, 0, 0), 0.2)
        bar(builder, "coupler", "crank", (0, 0, 0.2), 0.4)
        bar(builder, "rocker", "coupler", (0, 0, 0.4), 0.3)
        builder.connect("pin", "weld", "rocker", "foot", xyz=(0, 0, 0.3), other_xyz=(0, 0, 0.0))
        start = np.array([0.3, 0.5, 0.8, 1.9])
    elif kind == "distance":
        builder.connect("pin", "distance", "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0.0, 0.25), length=0.1)
        start = np.array([0.5, 0.8, 0.2])
    else:
        how = {"rpy": (np.pi / 2, 0, 0), "other_rpy": (np.pi / 2, 0, 0)} if kind == "axis" else {}
        builder.connect("pin", kind, "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.3), **how)
        start = np.array([0.5, 0.8, 0.2])
    scene = builder.build()
    return scene, start


def on_it(scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = scene.project(q, qd)
    return found.q, found.qd


def tied(seed: int) -> phipsi.Scene:
    """A random tree of all kinds of joints with three connections between its links and the world."""
    tree = random_scene(seed, 9, branching=0.6, armature=0.1, floating_base=bool(seed % 2))
    builder, links = tree.to_builder(), tree.link_names
    random = np.random.default_rng(seed)
    # Frames where they meet in the neutral configuration; the last two links of the tree are not rigidly attached.
    builder.connect("ball", "point", links[-1], xyz=random.uniform(-0.2, 0.2, 3))
    builder.connect("rod", "distance", links[-2], links[2], xyz=random.uniform(-0.2, 0.2, 3), other_xyz=random.uniform(-0.2, 0.2, 3))
    return builder.build()


CASES = [*(("four-bar", kind) for kind in ("point", "axis", "weld", "distance")), *(("tree", seed) for seed in range(6))]


@pytest.fixture(params=CASES, ids=str)
def case(request: pytest.FixtureRequest) -> tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray]:
    which, of = request.param
    if which == "four-bar":
        scene, q = four_bar(of)
    else:
        scene = tied(of)
        q = scene.integrate(scene.neutral(), 0.1 * np.random.default_rng(of).uniform(-1.0, 1.0, scene.nv))
    random = np.random.default_rng(5)
    qd, tau = random.uniform(-0.5, 0.5, (2, scene.nv))
    return (scene, *on_it(scene, q, qd), tau)


def test_matrices_are_those_of_differences(case: tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray]) -> None:
    scene, q, qd, tau = case
    wrenches = {scene.link_names[-1]: np.array([0.1, -0.2, 0.3, 1.0, 2.0, -1.0])}

    def accelerations(*state: np.ndarray) -> np.ndarray:
        return scene.forward_dynamics(*state, wrenches=wrenches)

    found = scene.forward_dynamics_derivatives(q, qd, tau, wrenches=wrenches)
    scale = size(accelerations(q, qd, tau))
    for which in range(3):
        columns = []
        for unit in np.eye(scene.nv):
            ends = []
            for sign in (STEP, -STEP):
                state = [q, qd, tau]
                state[which] = scene.integrate(q, sign * unit) if which == 0 else state[which] + sign * unit
                ends.append(accelerations(*state))
            columns.append((ends[0] - ends[1]) / (2 * STEP))
        expected = np.stack(columns, axis=1)
        assert_near(found[which], expected, central_difference(3e3 * max(scale, size(expected))))
    assert np.any(found.dqdd_dq) and np.any(found.dqdd_dqd)


def test_the_third_is_the_inverse_through_the_connections(case: tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray]) -> None:
    scene, q, qd, tau = case
    found = scene.forward_dynamics_derivatives(q, qd, tau).Minv
    assert_near(found, scene.constrained_mass_matrix_inverse(q), 1e-12 * size(found))
    jacobian = scene.constraint_jacobian(q)
    assert_near(jacobian @ found, np.zeros((len(jacobian), scene.nv)), inverse(1e4, size(jacobian) * size(found)))


def test_products_are_those_of_the_matrices(case: tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray]) -> None:
    scene, q, qd, tau = case
    dq, dqd, dtau, cotangent = np.random.default_rng(2).uniform(-1.0, 1.0, (4, scene.nv))
    matrices = scene.forward_dynamics_derivatives(q, qd, tau)
    bound = 1e-12 * size(*matrices) * scene.nv
    along = sum(matrix @ x for matrix, x in zip(matrices, (dq, dqd, dtau), strict=True))
    assert_near(scene.forward_dynamics_jvp(q, qd, tau, dq, dqd, dtau), along, bound)
    for one, matrix in zip(scene.forward_dynamics_vjp(q, qd, tau, cotangent)[:3], matrices, strict=True):
        assert_near(one, cotangent @ matrix, bound)


def test_a_batch_is_its_states() -> None:
    scene, q = four_bar("point")
    q, qd = on_it(scene, q, np.array([0.3, 0.1, -0.2]))
    many = scene.forward_dynamics_derivatives(np.tile(q, (5, 1)), qd, np.zeros(3))
    one = scene.forward_dynamics_derivatives(q, qd, np.zeros(3))
    for of_many, of_one in zip(many, one, strict=True):
        assert of_many.shape == (5, 3, 3)
        assert_near(of_many[4], of_one, 1e-14 * size(of_one))


def test_what_has_no_form_says_so() -> None:
    scene, q = four_bar("point")
    q, qd = on_it(scene, q, np.zeros(3))
    with pytest.raises(ArgumentError, match="second derivatives.*without_connections"):
        scene.forward_dynamics_hvp(q, qd, qd, qd, qd, qd, qd)
    with pytest.raises(ArgumentError, match="constants.*without_connections"):
        scene.forward_dynamics_vjp(q, qd, qd, qd, parameters=True)
