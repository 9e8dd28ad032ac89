"""Scene.distances: certificates of nearest points, penetration depths by enumeration, MuJoCo, and gradients by
differences.
"""

from __future__ import annotations

from itertools import combinations, product as pairs_of
from typing import Any

import mujoco
import numpy as np
import phipsi
import pytest
from phipsi import shapes
from phipsi.errors import ArgumentError, BadStateWarning, NotFiniteError, ShapeError
from tolerances import ITERATED, SMOOTH_NORMAL, SMOOTH_POINT, STEP, assert_near, assert_same_bits, central_difference

_HULL = np.random.default_rng(3).normal(size=(12, 3)) * [0.1, 0.15, 0.2]
CORES: dict[str, tuple[Any, np.ndarray, float]] = {
    "sphere": (shapes.Sphere(0.15), np.zeros((1, 3)), 0.15),
    "capsule": (shapes.Capsule(0.08, 0.3), np.array([[0, 0, -0.15], [0, 0, 0.15]]), 0.08),
    "box": (shapes.Box((0.2, 0.3, 0.4)), np.array(list(pairs_of((-0.1, 0.1), (-0.15, 0.15), (-0.2, 0.2)))), 0.0),
    "hull": (shapes.Hull(_HULL), _HULL, 0.0),
}
CYLINDER = shapes.Cylinder(0.1, 0.3)


def bodies(*given: Any) -> phipsi.Scene:
    """Free bodies, each with one shape."""
    builder = phipsi.SceneBuilder().link("world")
    for at, shape in enumerate(given):
        builder.link(f"link{at}", mass=1.0, inertia=np.eye(3)).joint(f"free{at}", "floating", "world", f"link{at}")
        builder.collider(f"shape{at}", shape, link=f"link{at}")
    return builder.build()


def poses(count: int, states: int, reach: float, seed: int) -> np.ndarray:
    """Random configurations of free bodies."""
    random = np.random.default_rng(seed)
    each = random.normal(size=(states, count, 7))
    each[..., :3] = random.uniform(-reach, reach, (states, count, 3))
    each[..., 3:] /= np.linalg.norm(each[..., 3:], axis=-1, keepdims=True)
    return each.reshape(states, -1)


def support(name: str, pose: np.ndarray, direction: np.ndarray) -> float:
    """The largest value of direction . x over a shape."""
    inside = direction @ pose[:3, :3]
    if name == "cylinder":
        return float(np.hypot(inside[0], inside[1]) * 0.1 + abs(inside[2]) * 0.15 + direction @ pose[:3, 3])
    _, core, radius = CORES[name]
    return float((core @ inside).max() + radius + direction @ pose[:3, 3])


@pytest.mark.parametrize("names", list(combinations([*CORES, "cylinder", "box", "capsule"], 2)), ids="-".join)
def test_nearest_points_of_shapes_that_are_apart_have_a_certificate(names: tuple[str, str]) -> None:
    # The distance of points is an upper bound, the gap of supporting planes is a lower one.
    scene = bodies(*(CYLINDER if name == "cylinder" else CORES[name][0] for name in names))
    q = poses(2, 200, 0.6, 5)
    found = scene.distances(q)
    assert found.pairs == (("shape0", "shape1"),) and found.distance.shape == (200, 1) and found.normal.shape == (200, 1, 3)
    places = [scene.placement(q, link) for link in ("link0", "link1")]
    bound = ITERATED if "cylinder" in names else 1e-9
    apart = 0
    for state in range(200):
        d, n, x, y = (of[state, 0] for of in (found.distance, found.normal, found.first, found.second))
        assert_near(np.linalg.norm(n), 1.0, 1e-12)
        assert_near(y - x, d * n, bound)
        gap = -support(names[1], places[1][state], -n) - support(names[0], places[0][state], n)
        assert_near(gap, d, bound)
        if d > 0.0:
            apart += 1
            for name, place, point in zip(names, (places[0][state], places[1][state]), (x, y), strict=True):
                for direction in np.random.default_rng(state).normal(size=(30, 3)):
                    unit = direction / np.linalg.norm(direction)
                    assert unit @ point <= support(name, place, unit) + (SMOOTH_POINT if "cylinder" in names else bound)
    assert 100 <= apart < 200


@pytest.mark.parametrize("names", list(pairs_of([*CORES, "cylinder"], repeat=2)), ids="-".join)
def test_shapes_that_just_touch_or_overlap_have_the_normal_of_the_largest_gap(names: tuple[str, str]) -> None:
    # Offsets for which faces, edges and axes meet exactly.
    random = np.random.default_rng(19)
    half = np.sqrt(0.5)
    turns = [[0, 0, 0, 1], [1, 0, 0, 0], [half, 0, 0, half], [0, half, 0, half], [0.5, 0.5, 0.5, 0.5]]
    scene = bodies(*(CYLINDER if name == "cylinder" else CORES[name][0] for name in names))
    q = np.array([[0, 0, 0, 0, 0, 0, 1, *random.choice([0, 1e-9, 0.05, -0.1, 0.15, -0.2, 0.25, 0.3, -0.35, 0.4], 3), *turns[random.integers(5)]] for _ in range(120)])
    found = scene.distances(q)
    bound = ITERATED if "cylinder" in names else 1e-8
    places = [scene.placement(q, link) for link in ("link0", "link1")]
    for state in range(120):
        d, n = found.distance[state, 0], found.normal[state, 0]
        place = [of[state] for of in places]
        others = np.vstack([place[0][:3, :3].T, place[1][:3, :3].T, random.normal(size=(40, 3)), n + 1e-2 * random.normal(size=(20, 3))])
        others /= np.linalg.norm(others, axis=1, keepdims=True)
        gaps = [-support(names[1], place[1], -of) - support(names[0], place[0], of) for of in [n, *others, *-others]]
        assert_near(gaps[0], d, bound)
        assert max(gaps) <= d + bound


def candidates(name: str, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals of faces, and directions of edges, of a box or hull."""
    if name == "box":
        return pose[:3, :3].T, pose[:3, :3].T
    from scipy.spatial import ConvexHull

    hull = ConvexHull(_HULL)
    edges = np.array([_HULL[a] - _HULL[b] for face in hull.simplices for a, b in combinations(face, 2)])
    return hull.equations[:, :3] @ pose[:3, :3].T, edges @ pose[:3, :3].T


@pytest.mark.parametrize("names", [("box", "box"), ("box", "hull"), ("hull", "hull")], ids="-".join)
def test_penetration_is_the_least_over_faces_and_edges(names: tuple[str, str]) -> None:
    scene = bodies(*(CORES[name][0] for name in names))
    q = poses(2, 60, 0.12, 7)
    found = scene.distances(q)
    deep = 0
    for state in range(60):
        place = [scene.placement(q[state], link) for link in ("link0", "link1")]
        (faces, edges), (others, ends) = (candidates(name, pose) for name, pose in zip(names, place, strict=True))
        crosses = np.cross(edges[:, None], ends[None]).reshape(-1, 3)
        size = np.linalg.norm(crosses, axis=1)
        normals = np.vstack([faces, others, crosses[size > 1e-9] / size[size > 1e-9, None]])
        normals = np.vstack([normals, -normals])
        gap = max(-support(names[1], place[1], -n) - support(names[0], place[0], n) for n in normals)
        if gap < 0.0:
            deep += 1
            assert_near(found.distance[state, 0], gap, 1e-9)
    assert deep >= 40


def test_spheres_and_capsules_are_exact_also_where_their_lines_meet() -> None:
    scene = bodies(shapes.Sphere(0.1), shapes.Sphere(0.2))
    for d in (0.0, 1e-9, 0.05, 0.3, 5.0):
        found = scene.distances([0, 0, 0, 0, 0, 0, 1, d, 0, 0, 0, 0, 0, 1])
        assert_near(found.distance, [d - 0.3], 1e-15)
        assert_near(np.linalg.norm(found.normal), 1.0, 1e-12)
        if d > 0.0:
            assert_near(found.normal, [[1, 0, 0]], 1e-6)
    crossed = bodies(shapes.Capsule(0.1, 1.0), shapes.Capsule(0.2, 1.0))
    half = np.sqrt(0.5)
    for turn in ([half, 0, 0, half], [np.sin(0.1), 0, 0, np.cos(0.1)], [0, 0, 0, 1]):
        for y in (0.0, 1e-12, 1e-6, 0.2, 0.4):
            # One line is along z, the other crosses it in the plane x = 0, at a distance along x.
            found = crossed.distances([0, 0, 0, 0, 0, 0, 1, y, 0.05, 0, *turn])
            across = turn[0] != 0.0
            assert_near(found.distance, [(y if across else np.hypot(y, 0.05)) - 0.3], 1e-12)
            assert_near(found.second - found.first, found.distance[..., None] * found.normal, 1e-12)


def test_a_sphere_in_a_box_is_as_deep_as_its_nearest_face() -> None:
    scene = bodies(shapes.Box((0.2, 0.3, 0.4)), shapes.Sphere(0.05))
    for at in np.random.default_rng(2).uniform(-1, 1, (50, 3)) * [0.1, 0.15, 0.2]:
        found = scene.distances([0, 0, 0, 0, 0, 0, 1, *at, 0, 0, 0, 1])
        assert_near(found.distance, [np.max(np.abs(at) - [0.1, 0.15, 0.2]) - 0.05], 1e-12)


GEOMS = {
    "sphere": 'type="sphere" size="0.15"', "capsule": 'type="capsule" size="0.08 0.15"', "box": 'type="box" size="0.1 0.15 0.2"',
    "cylinder": 'type="cylinder" size="0.1 0.15"', "hull": 'type="mesh" mesh="hull"',
}  # fmt: skip


def test_distances_are_those_of_mujoco() -> None:
    names = list(GEOMS)
    vertices = " ".join(map(repr, _HULL.ravel().tolist()))
    free = "".join(f'<body><freejoint/><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><geom {GEOMS[name]}/></body>' for name in names)
    text = f'<mujoco><option ccd_tolerance="1e-12" ccd_iterations="500"/><asset><mesh name="hull" vertex="{vertices}"/></asset><worldbody>{free}</worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    scene = bodies(*(CYLINDER if name == "cylinder" else CORES[name][0] for name in names))
    q = poses(len(names), 40, 0.5, 11)
    found = scene.distances(q)
    for state in range(40):
        each = q[state].reshape(-1, 7)
        data.qpos = np.column_stack([each[:, :3], each[:, 6], each[:, 3:6]]).ravel()
        mujoco.mj_kinematics(model, data)
        for k, (first, second) in enumerate(found.pairs):
            i, j = int(first[-1]), int(second[-1])
            expected = mujoco.mj_geomDistance(model, data, i, j, 10.0, None)
            assert_near(found.distance[state, k], expected, 2e-5 if expected < 0 else 1e-5)


def arm(*, mimic: bool = False) -> phipsi.SceneBuilder:
    """An arm of four links with shapes, above a table, beside a post."""
    builder = phipsi.SceneBuilder().link("ground")
    builder.collider("floor", shapes.HalfSpace(xyz=(0, 0, -0.2))).collider("post", shapes.Box((0.1, 0.1, 1.0), xyz=(0.4, 0.2, 0.3)))
    parent = "ground"
    for at, (shape, axis) in enumerate([
        (shapes.Capsule(0.05, 0.3, xyz=(0, 0, 0.15)), (0, 1, 0)),
        (shapes.Box((0.06, 0.08, 0.3), xyz=(0, 0, 0.15)), (0.6, 0.8, 0)),
        (shapes.Cylinder(0.04, 0.3, xyz=(0, 0, 0.15)), (1, 0, 0)),
        (shapes.Hull(0.5 * _HULL, xyz=(0, 0, 0.1)), (0, 0.6, 0.8)),
    ]):  # fmt: skip
        follows = {"mimic": "joint0", "mimic_multiplier": -0.7, "mimic_offset": 0.2} if mimic and at == 2 else {}
        name = f"arm{at}"
        builder.link(name, mass=1.0, inertia=0.01 * np.eye(3)).joint(f"joint{at}", "revolute", parent, name, xyz=(0, 0, 0.35), axis=axis, lower=-3, upper=3, **follows)
        builder.collider(name, shape, link=name)
        parent = name
    return builder


def differences(scene: phipsi.Scene, q: np.ndarray, step: float) -> np.ndarray:
    """Derivatives of the distances by central differences, (k, nv)."""
    ahead, behind = (scene.distances(scene.integrate(q, sign * step * np.eye(scene.nv))).distance for sign in (1, -1))
    return np.array((ahead - behind).T / (2 * step))


@pytest.mark.parametrize("kind", ["arm", "floating", "mimic"])
def test_gradients_are_those_of_differences(kind: str) -> None:
    scene = arm(mimic=kind == "mimic").build(floating_base=kind == "floating", **({"mimic": "couple"} if kind == "mimic" else {}))
    random = np.random.default_rng(4)
    smooth = total = 0
    for _ in range(20):
        q = scene.integrate(scene.neutral(), random.uniform(-1.2, 1.2, scene.nv) * (0.3 if kind == "floating" else 1.0))
        found = scene.distances(q)
        assert found.gradient.shape == (len(found.pairs), scene.nv)
        # Where two steps agree, the nearest points do not change to another feature between them.
        near, far = differences(scene, q, 1e-4), differences(scene, q, 2e-4)
        is_smooth = np.abs(near - far).max(axis=1) <= 1e-5
        total, smooth = total + is_smooth.size, smooth + np.count_nonzero(is_smooth)
        is_round = np.array(["arm2" in pair for pair in found.pairs])
        for of, bound in ((is_round, SMOOTH_NORMAL), (~is_round, 1e-4)):
            assert_near(found.gradient[is_smooth & of], near[is_smooth & of], bound)
    assert smooth >= 0.9 * total


def test_gradients_of_spheres_are_exact() -> None:
    scene = bodies(shapes.Sphere(0.1), shapes.Box((0.2, 0.3, 0.4)), shapes.Capsule(0.05, 0.2))
    for q in poses(3, 20, 0.5, 13):
        found = scene.distances(q)
        assert_near(found.gradient, differences(scene, q, STEP), central_difference(1e2))


def test_batches_limits_and_pairs() -> None:
    scene = arm().build()
    q = np.random.default_rng(5).uniform(-1, 1, (3, 4, scene.nq))
    found = scene.distances(q)
    k = len(found.pairs)
    assert found.distance.shape == (3, 4, k) and found.first.shape == (3, 4, k, 3) and found.gradient.shape == (3, 4, k, scene.nv)
    alone = scene.distances(q[1, 2])
    assert all(np.array_equal(one, batch[1, 2]) for one, batch in zip(alone[1:], found[1:], strict=True))
    # Neighbors on the arm do not touch, others do, and the first link moves against the base.
    assert ("arm0", "arm1") not in found.pairs and ("arm0", "arm2") in found.pairs and ("floor", "arm0") in found.pairs and ("floor", "post") not in found.pairs

    near = scene.distances(q, limit=0.3)
    close = found.distance <= 0.3
    assert 0 < np.count_nonzero(close) < close.size
    for all_of, of in zip(found[1:], near[1:], strict=True):
        assert np.array_equal(all_of[close], of[close])
    assert np.isposinf(near.distance[~close]).all() and np.isnan(near.normal[~close]).all() and not near.gradient[~close].any()

    swapped = scene.distances(q, pairs=[("arm3", "post"), ("arm0", "arm1")])
    at = found.pairs.index(("post", "arm3"))
    assert swapped.pairs == (("arm3", "post"), ("arm0", "arm1"))
    assert_near(swapped.distance[..., 0], found.distance[..., at], 1e-9)
    assert_near(swapped.normal[..., 0, :], -found.normal[..., at, :], 1e-6)
    assert scene.distances(q, pairs=("arm3", "post")).pairs == (("arm3", "post"),)
    assert scene.distances(q, pairs=[]).distance.shape == (3, 4, 0)

    bad = q.copy()
    bad[1, 1, 0] = np.nan
    with pytest.warns(BadStateWarning):
        partly = scene.distances(bad, errors="nan")
    assert np.isnan(partly.distance[1, 1]).all() and np.array_equal(partly.distance[0], found.distance[0])
    with pytest.raises(NotFiniteError, match="q"):
        scene.distances(bad)


def test_refused_arguments_are_named() -> None:
    scene = arm().build()
    q = scene.neutral()
    for pairs, message in [
        ([("arm0", "arm9")], "arm9.*does not exist.*arm0"), ([("arm0", "arm0")], "twice"), ("arm0", "sequence of such pairs"),
        ([("arm0", "arm1", "arm2")], "sequence of such pairs"), (3, "sequence of such pairs"), ({"arm0": "arm1"}, "sequence of such pairs"),
    ]:  # fmt: skip
        with pytest.raises(ArgumentError, match=f"pairs: .*{message}"):
            scene.distances(q, pairs=pairs)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="limit"):
        scene.distances(q, limit=np.nan)
    with pytest.raises(ShapeError, match="q"):
        scene.distances(q[:2])
    two = phipsi.SceneBuilder().link("a", mass=1.0, inertia=np.eye(3)).collider("a", shapes.Sphere(0.1), link="a")
    two.collider("floor", shapes.HalfSpace()).collider("wall", shapes.HalfSpace(rpy=(0, 1.5, 0)))
    with pytest.raises(ArgumentError, match="at most one half space"):
        two.build(floating_base=True).distances([0, 0, 1, 0, 0, 0, 1], pairs=("floor", "wall"))
    with pytest.raises(ArgumentError, match=r"SceneBuilder\.collider"):
        phipsi.load(phipsi.BUNDLED_ARM).distances(np.zeros(6))


def test_pairs_that_cannot_touch_have_distances() -> None:
    builder = phipsi.SceneBuilder().link("rail").link("slide", mass=1.0).joint("x", "prismatic", "rail", "slide", axis="x")
    builder.collider("slide", shapes.Sphere(0.1), link="slide").collider("wall", shapes.Sphere(0.1), groups=0, mask=0)
    scene = builder.build()
    found = scene.distances([0.5], pairs=("wall", "slide"))
    assert_near(found.distance, [0.3], 1e-15)
    assert_near(found.gradient, [[1.0]], 1e-15)
    with pytest.raises(ArgumentError, match="cannot|without colliders that can touch"):
        scene.distances([0.5])


def test_half_spaces_and_height_fields() -> None:
    builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
    builder.collider("ball", shapes.Sphere(0.1), link="ball").collider("slope", shapes.HalfSpace(xyz=(0, 0, -1), rpy=(0.3, 0, 0)))
    builder.collider("hills", shapes.HeightField(np.zeros((4, 5)), size=(3.0, 4.0), xyz=(0, 0, -2)))
    scene = builder.build(floating_base=True)
    normal = np.array([0, -np.sin(0.3), np.cos(0.3)])
    for at in np.random.default_rng(8).uniform(-1, 1, (20, 3)):
        found = scene.distances([*at, 0, 0, 0, 1])
        values = dict(zip(found.pairs, zip(found.distance, found.normal, strict=True), strict=True))
        d, n = values["ball", "slope"]
        assert_near(d, normal @ (at + [0, 0, 1]) - 0.1, 1e-14)
        assert_near(n, -normal, 1e-15)
        d, n = values["ball", "hills"]
        assert_near(d, at[2] + 1.9, 1e-12)
        assert_near(n, [0, 0, -1], 1e-9)


def test_distances_do_not_depend_on_the_distance_from_the_origin() -> None:
    scene = bodies(CORES["box"][0], CORES["capsule"][0], CYLINDER)
    q = poses(3, 30, 0.4, 17)
    away = q.copy()
    away.reshape(30, 3, 7)[..., :3] += [1000.0, -2000.0, 500.0]
    assert_near(scene.distances(away).distance, scene.distances(q).distance, ITERATED)


def test_batches_have_the_bits_of_single_states_on_all_threads() -> None:
    scene = arm().build()
    q = np.random.default_rng(9).uniform(-1, 1, (300, scene.nq))
    together = scene.distances(q)
    for at in (0, 17, 299):
        one = scene.distances(q[at])
        assert_same_bits(one.distance, together.distance[at])
        assert_same_bits(one.gradient, together.gradient[at])
