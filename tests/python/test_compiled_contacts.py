"""J M^-1 J^T of contact points: compared with dense algebra; gaps, velocities and J M^-1 J^T in compiled code, compared
with the methods of the scene.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import random_scene
from test_codegen import FUNCTIONS, Recorder
from test_constraints import bars
from test_mimic import Case
from tolerances import assert_near, inverse, product, size

import phipsi
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError

COMPILER = os.environ.get("CC", "cc")
CONTACTS = ["contact_gaps", "contact_velocities", "contact_gram"]


def scene_of(seed: int, joints: int = 8) -> phipsi.Scene:
    """A random tree with points and spheres on inclined planes; two contacts are on the same link."""
    random = np.random.default_rng(seed)
    scene = random_scene(seed, joints, floating_base=seed % 2 == 1)
    moving = [name for name in scene.link_names if np.abs(scene.jacobian(scene.neutral(), name)).max() > 0]
    builder = scene.to_builder()
    for at, link in enumerate([moving[-1], moving[-1], moving[len(moving) // 2], moving[0]]):
        builder.contact(f"foot{at}", link, friction=0.5, xyz=random.uniform(-0.3, 0.3, 3), radius=0.1 * (at % 2), normal=random.uniform(-1, 1, 3), offset=random.uniform(-1, 1))
    return builder.build(floating_base=seed % 2 == 1)


def states(scene: phipsi.Scene, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(1)
    return scene.integrate(scene.neutral(), random.uniform(-1, 1, (*shape, scene.nv))), random.uniform(-1, 1, (*shape, scene.nv))


@pytest.mark.parametrize("form", ["auto", "covariance", "square-root"])
@pytest.mark.parametrize("seed", range(4))
def test_the_gram_matrix_of_contacts_is_that_of_its_definition(seed: int, form: Any) -> None:
    """J has the velocities for a unit velocity of each degree of freedom."""
    scene = scene_of(seed)
    q, _ = states(scene, (5,))
    columns = scene.contacts.velocities(q[:, None], np.broadcast_to(np.eye(scene.nv), (5, scene.nv, scene.nv)))
    expected = np.einsum("sjia,sjk,skbc->siabc", columns, scene.mass_matrix_inverse(q), columns)
    found = scene.contacts.gram(q, form=form)
    bound = inverse(float(np.max(np.linalg.cond(scene.mass_matrix(q)))), size(expected))
    assert_near(found, expected, bound)
    assert_near(scene.contacts.gram(q[3], form=form), found[3], bound)
    m = 3 * len(scene.contacts.names)
    square = found.reshape(5, m, m)
    np.testing.assert_array_equal(square, square.swapaxes(-1, -2))
    assert np.linalg.eigvalsh(square).min() >= -bound


def test_the_gram_matrix_of_a_ball() -> None:
    """1/m in each direction, and r^2/I more along the plane."""
    builder = phipsi.SceneBuilder().link("ball", mass=2.0, inertia=0.004 * np.eye(3))
    scene = builder.contact("foot", "ball", friction=0.5, radius=0.1).build(floating_base=True)
    q = scene.integrate(scene.neutral(), np.random.default_rng(0).uniform(-1, 1, (3, 6)))
    expected = np.diag([0.5 + 0.01 / 0.004] * 2 + [0.5])
    assert_near(scene.contacts.gram(q)[:, 0, :, 0], np.broadcast_to(expected, (3, 3, 3)), product(6, 3.0))


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"q": np.zeros(3)}, ShapeError, "q: "),
        ({"q": np.full(8, np.nan)}, NotFiniteError, "q: "),
        ({"form": "none"}, ArgumentError, "form: "),
        ({"tolerance": 2.0}, ArgumentError, "tolerance: "),
        ({"errors": "none"}, ArgumentError, "errors: "),
    ],
)
def test_broken_arguments_of_the_gram_matrix(change: dict[str, Any], error: type[Exception], message: str) -> None:
    scene = scene_of(0)
    change = {key: value if key != "q" or value.size == 3 else np.full(scene.nq, np.nan) for key, value in change.items()}
    given: dict[str, Any] = {"q": scene.neutral()}
    assert scene.contacts.gram(**given).shape == (4, 3, 4, 3)
    with pytest.raises(error, match=message):
        scene.contacts.gram(**{**given, **change})


def expected_gram(scene: phipsi.Scene, q: np.ndarray, inverse_mass: np.ndarray) -> np.ndarray:
    columns = np.stack([scene.contacts.velocities(q, unit) for unit in np.eye(scene.nv)])
    return np.einsum("jia,jk,kbc->iabc", columns, inverse_mass, columns)


def test_the_gram_matrix_through_connections() -> None:
    """M^-1 on the connections, from the projection in dense algebra."""
    assert bars().build().contacts.gram(np.zeros(3)).shape == (0, 3, 0, 3)
    loop = bars().connect("pin", "point", "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.3))
    scene = loop.contact("foot", "coupler", friction=0.5, xyz=(0.1, 0, 0.2)).contact("hand", "rocker", friction=0.5, other="crank").build()
    q = scene.loops.project(np.array([0.5, 0.8, 0.2]), np.zeros(3))[0]
    m, jacobian = scene.mass_matrix(q), scene.loops.jacobian(q)
    free = np.linalg.svd(jacobian)[2][np.linalg.matrix_rank(jacobian) :].T
    inverse_mass = free @ np.linalg.inv(free.T @ m @ free) @ free.T
    found, bound = scene.contacts.gram(np.stack([q, q])), inverse(float(np.linalg.cond(m)), 100.0)
    assert_near(found[1], expected_gram(scene, q, inverse_mass), bound)
    assert size(found) > 0.1 and np.array_equal(found[0], found[1])
    tree = scene.without_constraints().contacts.gram(q)
    assert np.all(np.linalg.eigvalsh((tree - found[0]).reshape(6, 6)) > -bound) and size(tree - found[0]) > 0.1


@pytest.mark.parametrize("seed", range(3))
def test_the_gram_matrix_of_joints_that_follow_others(seed: int) -> None:
    case = Case(seed)
    builder = case.scene.to_builder()
    links = [joint.child for joint in case.tree.joints if joint.kind != "fixed"]
    builder.contact("foot", links[-1], friction=0.5, radius=0.1, normal=(1, 2, 3)).contact("hand", links[-2], friction=0.5, xyz=(0.1, 0.2, 0.3))
    scene = builder.build(mimic="couple", floating_base=case.tree.floating_base)
    bound = inverse(case.condition, 100.0)
    assert_near(scene.contacts.gram(case.q), expected_gram(scene, case.q, np.linalg.inv(case.m)), bound)


def test_the_gram_matrix_of_contacts_between_links() -> None:
    """Impulses are opposite on both links: two balls that touch have 1/m1 + 1/m2."""
    builder = phipsi.SceneBuilder().link("world")
    for name, mass in (("a", 2.0), ("b", 4.0)):
        builder.link(name, mass=mass, inertia=0.004 * np.eye(3)).joint(name, "floating", "world", name)
    scene = builder.contact("balls", "a", friction=0.0, radius=0.1, other="b", other_radius=0.1).build()
    q = scene.neutral()
    q[2] = 0.2
    expected = np.diag([0.75 + 2 * 0.01 / 0.004] * 2 + [0.75])
    assert_near(scene.contacts.gram(q)[0, :, 0], expected, inverse(1000.0, 6.0))


@pytest.fixture
def _small_batches(c_compiler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("phipsi._compile.FEW", dict.fromkeys(phipsi._compile.FEW, 16))


@pytest.mark.usefixtures("_small_batches")
@pytest.mark.parametrize("form", ["auto", "covariance"])
@pytest.mark.parametrize("seed", range(2))
def test_compiled_contacts_are_those_of_the_scene(seed: int, form: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(seed)
    fast = phipsi.compile(scene, CONTACTS, form=form, flags=["-O0"], cache=tmp_path)  # type: ignore[call-overload]
    for shape in ((20,), (4, 5)):
        q, qd = states(scene, shape)
        expected = [scene.contacts.gaps(q), scene.contacts.velocities(q, qd), scene.contacts.gram(q, form=form)]
        asked: list[tuple[str, int]] = []
        with monkeypatch.context() as patched:
            patched.setattr(fast, "scene", Recorder(scene, asked))
            found = [fast.contact_gaps(q), fast.contact_velocities(q, qd), fast.contact_gram(q)]
        assert asked == []
        cond = float(np.max(np.linalg.cond(scene.mass_matrix(q))))
        for one, other in zip(found, expected, strict=True):
            assert_near(one, other, inverse(cond, size(other)))
    q[0, 0, 0] = np.nan
    with pytest.raises(NotFiniteError, match="q"):
        fast.contact_gram(q)


@pytest.mark.usefixtures("_small_batches")
def test_all_functions_of_a_scene_with_contacts(tmp_path: Path) -> None:
    fast = phipsi.compile(scene_of(1, 3), flags=["-O0"], cache=tmp_path)
    assert fast.functions == (*FUNCTIONS, *CONTACTS)


def test_contacts_of_scenes_without_have_no_code() -> None:
    for function in CONTACTS:
        with pytest.raises(ArgumentError, match=f"functions: found {function} for a scene without contacts"):
            phipsi.scenes.chain(2).to_c(functions=[function])  # type: ignore[list-item]


@pytest.mark.usefixtures("c_compiler")
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_the_c_code_of_contacts_passes_its_test(dtype: Any, tmp_path: Path) -> None:
    scene_of(1).to_c(tmp_path, functions=CONTACTS, dtype=dtype, batches=True)  # type: ignore[arg-type]
    made = subprocess.run(["make", "-s", "test", f"CC={COMPILER}", "CFLAGS=-std=c99 -O0"], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert made.returncode == 0, made.stdout + made.stderr
