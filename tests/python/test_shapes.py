"""Shapes of links from code: what is drawn, their inertias, and arguments that are not valid."""

from __future__ import annotations

import copy
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import phipsi
import pytest
from phipsi.errors import ArgumentError, InertiaWarning
from phipsi.shapes import Box, Capsule, Cylinder, Mesh, Sphere
from tolerances import assert_near, product, size

TURN = (0.3, -0.4, 0.5)
SHAPES = (Box((0.1, 0.2, 0.3), (1, 2, 3), TURN), Sphere(0.2, (0, 0, 1)), Cylinder(0.1, 0.5, (0, 1, 0), TURN), Capsule(0.1, 0.5, rpy=TURN, color="red"))


def scene_of(*shapes: Any) -> phipsi.Scene:
    builder = phipsi.SceneBuilder().link("base").link("arm", mass=1.0, inertia=np.eye(3), shape=shapes)
    return builder.joint("hinge", "revolute", "base", "arm", axis=(0, 1, 0)).build()


def test_shapes_change_no_result() -> None:
    builder = phipsi.SceneBuilder().link("base").link("arm", mass=1.0, inertia=np.eye(3))
    bare = builder.joint("hinge", "revolute", "base", "arm", axis=(0, 1, 0)).build()
    assert np.array_equal(bare.mass_matrix([0.3]), scene_of(*SHAPES).mass_matrix([0.3]))


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_inertias_are_those_of_fine_meshes(shape: Any) -> None:
    trimesh = pytest.importorskip("trimesh")
    match shape:
        case Box():
            mesh = trimesh.creation.box(extents=shape.size)
        case Sphere():
            mesh = trimesh.creation.icosphere(radius=shape.radius, subdivisions=5)
        case Cylinder():
            mesh = trimesh.creation.cylinder(radius=shape.radius, height=shape.length, sections=512)
        case _:
            mesh = trimesh.creation.capsule(radius=shape.radius, height=shape.length, count=[256, 256])
    mesh.apply_translation(-mesh.center_mass)
    if not isinstance(shape, Sphere):
        mesh.apply_transform(trimesh.transformations.euler_matrix(*shape.rpy))
    mesh.density = 3.0 / mesh.volume
    assert_near(shape.inertia(3.0), mesh.moment_inertia, 2e-3 * size(mesh.moment_inertia))


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_a_link_with_mass_and_shape_is_a_uniform_body(shape: Any) -> None:
    link = link_of(3.0, shape=shape)
    assert_near(link.inertia, shape.inertia(3.0), product(3, size(shape.inertia(3.0))))
    assert_near(link.com, shape.xyz, product(1, size(np.array(shape.xyz))))
    # An inertia that is given remains, and so does a point mass without shapes.
    assert np.array_equal(link_of(3.0, inertia=np.eye(3), shape=shape).inertia, np.eye(3))
    assert not np.any(link_of(3.0).inertia)
    assert link_of(0.0, shape=shape).mass == 0.0


def test_a_rod_on_a_hinge_at_its_end() -> None:
    rod = Cylinder(0.01, 0.4, xyz=(0, 0, -0.2))
    builder = phipsi.SceneBuilder().link("base").link("rod", mass=1.25, com=(0, 0, -0.2), shape=rod)
    scene = builder.joint("hinge", "revolute", "base", "rod", axis=(0, 1, 0)).build()
    assert_near(scene.mass_matrix([0.3])[0, 0], 1.25 * (0.4**2 / 3.0 + 0.01**2 / 4.0), product(3, 1.0))


def test_several_shapes_are_one_uniform_body() -> None:
    """A box in two halves of unequal length."""
    whole, short, long = Box((0.1, 0.2, 0.9), TURN), Box((0.1, 0.2, 0.3), (0.3, -0.4, 0.2)), Box((0.1, 0.2, 0.6), (0.3, -0.4, 0.65))
    link = link_of(2.0, shape=[short, long])
    assert_near(link.inertia, whole.inertia(2.0), product(9, size(whole.inertia(2.0))))
    assert_near(link.com, (0.3, -0.4, 0.5), product(9, 1.0))


def test_a_center_of_mass_that_is_not_that_of_the_shape() -> None:
    shape = Box((0.1, 0.2, 0.3), xyz=(0, 0, 0.15))
    with pytest.warns(InertiaWarning, match=r"link 'arm': found com \[0.0, 0.0, 0.1\], and the center of its shapes is \[0.0, 0.0, 0.15\]; .* moved to com"):
        link = link_of(2.0, com=(0, 0, 0.1), shape=shape)
    assert_near(link.inertia, shape.inertia(2.0), product(3, 1.0))
    assert link.com.tolist() == [0.0, 0.0, 0.1]
    assert link_of(2.0, com=(0, 0, 0.15), shape=shape).com.tolist() == [0.0, 0.0, 0.15]


def test_a_mesh_is_a_point_mass_with_a_warning(tmp_path: Path) -> None:
    file = tmp_path / "hand.stl"
    file.write_text("solid\nendsolid\n")
    with pytest.warns(InertiaWarning, match="link 'arm': the inertia of a Mesh is not computed, and the link is a point mass"):
        assert not np.any(link_of(2.0, shape=[Mesh(file), Sphere(0.1)]).inertia)


def link_of(mass: float, **arguments: Any) -> Any:
    builder = phipsi.SceneBuilder().link("base").link("arm", mass, **arguments)
    return builder.joint("free", "floating", "base", "arm").build().link("arm")


def test_quaternions_of_urdf_are_drawn_and_exported() -> None:
    pytest.importorskip("viser")
    from phipsi.view.shapes import shapes_of

    # A rotation by pi about (1, 1, 0) / sqrt(2).
    text = """<robot name="r" version="1.1"><link name="base"><visual><origin xyz="1 2 3" quat_xyzw="0.7071 0.7071 0 0"/>
        <geometry><capsule radius="0.1" length="0.5"/></geometry></visual></link></robot>"""
    scene = phipsi.Scene.from_urdf(text)
    for of in (scene, phipsi.Scene.from_urdf(scene.to_urdf())):
        (shape,) = shapes_of(of, None)
        assert_near(shape.place[:3, :3], np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), product(9, 1.0))
        assert_near(shape.mesh.extents, [0.2, 0.2, 0.7], 1e-2)
    assert '<robot name="robot" version="1.1">' in scene.to_urdf()
    assert 'version="1.1"' in scene_of(Capsule(0.1, 0.5)).to_urdf() and "version" not in scene_of(Box((1, 1, 1))).to_urdf().split("?>")[1]


def test_shapes_are_drawn_where_they_are() -> None:
    pytest.importorskip("viser")
    from phipsi.view.shapes import shapes_of

    found = shapes_of(scene_of(*SHAPES), None)
    assert [shape.link for shape in found] == ["arm"] * 4
    assert_near(found[0].mesh.extents, [0.1, 0.2, 0.3], product(3, 1.0))
    assert_near(found[3].mesh.extents, [0.2, 0.2, 0.7], 1e-2)
    assert_near(found[0].place[:3, 3], [1, 2, 3], product(3, 3.0))
    # R = Rz(yaw) Ry(pitch) Rx(roll), as the inertia of the shape has it.
    turn = found[0].place[:3, :3]
    moments = np.diag(Box((0.1, 0.2, 0.3)).inertia(1.0).diagonal())
    assert_near(turn @ moments @ turn.T, SHAPES[0].inertia(1.0), product(9, 0.1))
    assert found[3].mesh.visual.material.baseColorFactor[:3].tolist() == [196, 51, 46]


def test_shapes_survive_copies_pickles_and_urdf(tmp_path: Path) -> None:
    scene = scene_of(*SHAPES)
    builder = copy.copy(scene.to_builder()).link("more", shape=Sphere(0.1)).joint("weld", "fixed", "arm", "more")
    for one, count in ((pickle.loads(pickle.dumps(scene)), 4), (scene.lock(["hinge"], [0.2]), 4), (builder.build(), 5), (phipsi.Scene.from_urdf(scene.to_urdf()), 4)):
        assert len(re.findall("<visual>", one.to_urdf())) == count
    scene.to_urdf(tmp_path / "arm.urdf")
    assert len(re.findall("<visual>", phipsi.Scene.from_urdf(tmp_path / "arm.urdf").to_urdf())) == 4


def test_the_bundled_arm_has_shapes() -> None:
    pytest.importorskip("viser")
    from phipsi.view.shapes import name_of, shapes_of

    scene = phipsi.load(phipsi.BUNDLED_ARM)
    assert {shape.link for shape in shapes_of(scene, None)} == set(scene.link_names)
    assert name_of(scene) == "puma560" and name_of(phipsi.scenes.chain(2)) == "phipsi"


def test_a_mesh_of_a_link(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("viser")
    from phipsi.view.shapes import shapes_of

    trimesh.creation.box(extents=(100, 200, 300)).export(str(tmp_path / "part.stl"))
    (found,) = shapes_of(scene_of(Mesh(tmp_path / "part.stl", scale=0.001)), None)
    assert_near(found.mesh.extents, [0.1, 0.2, 0.3], 1e-6)


BAD = {
    "size of Box: found .*; expected 3 finite numbers": Box((0.1, 0.2)),
    "size of Box: found .*; expected positive values": Box((0.1, 0.2, 0.0)),
    "radius of Sphere: found nan; expected a finite number": Sphere(float("nan")),
    "length of Cylinder: found -1.0; expected positive values": Cylinder(0.1, -1.0),
    "radius of Capsule: found 'x'; expected a finite number": Capsule("x", 1.0),  # type: ignore[arg-type]
    "xyz of Box: found .*; expected 3 finite numbers": Box((1, 1, 1), (0, 0)),
    "rpy of Capsule: found 1; expected 3 finite numbers": Capsule(0.1, 1.0, rpy=1),
    "color of Sphere: found 'pink'; expected 'black', 'blue'": Sphere(0.1, color="pink"),
    r"color of Sphere: found \(0, 0, 2\); expected a name, or three or four numbers from 0 to 1": Sphere(0.1, color=(0, 0, 2)),
    "file of Mesh: found 'no.stl', which is not a file": Mesh("no.stl"),
    "scale of Mesh: found .*; expected positive values": Mesh(__file__, scale=(1, 1, 0)),
    "found str; expected a Box, Sphere, Cylinder, Capsule or Mesh": "box",
    "found int; expected a Box, Sphere, Cylinder, Capsule or Mesh": 3,
    "found HalfSpace; expected a Box, .*: SceneBuilder.collider takes others": phipsi.shapes.HalfSpace(),
    "found Hull; expected a Box, .*: SceneBuilder.collider takes others": phipsi.shapes.Hull(((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))),
}


@pytest.mark.parametrize("message", BAD)
def test_a_shape_that_is_not_valid_is_refused(message: str) -> None:
    with pytest.raises(ArgumentError, match=f"shape of link 'arm': .*{message}"):
        phipsi.SceneBuilder().link("arm", shape=BAD[message])
