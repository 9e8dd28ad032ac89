"""Shapes of links: those of a URDF, a MuJoCo model or SceneBuilder.link; without shapes, capsules that represent the
inertias.
"""

from __future__ import annotations

import io
import logging
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from html import unescape
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import trimesh
import yourdfpy
from numpy.typing import NDArray

from .._core import Scene
from .._files import SEARCHED, find
from .._load import root_of
from .._mjcf import compiled
from .._mjcf_geoms import Geoms, of_element, of_model
from .._pose import angles
from .._xacro import COMMENT, expanded_again
from ..errors import ArgumentError, MeshWarning, warn
from ..mujoco import rotation
from ..shapes import FROM_MJCF, has_text, texts_of

_Array = NDArray[np.float64]

#: Red, green, blue, opacity of shapes without color, of capsules, and of rods.
GRAY, MASS, BONE = (0.72, 0.75, 0.78, 1.0), (0.93, 0.65, 0.13, 0.7), (0.25, 0.38, 0.55, 1.0)
#: The same of colliders.
COLLIDER = (0.35, 0.6, 0.45, 1.0)
#: Name of the base among the links.
BASE = ""
#: Name of a robot in URDF or MJCF.
NAME = re.compile(r"""<\s*(robot|mujoco)\b[^>]*?\s(?:name|model)\s*=\s*["']([^"']*)["']""")
#: Opacity of a robot with force arrows, which are usually inside it.
OPACITY = 0.5
#: Radius of the rods, relative to the size of the robot.
THIN = 0.012
#: Largest length and radius of a capsule, relative to the size of the robot, so that a wrong inertia does not hide the other links.
LONGEST, THICKEST = 4.0, 0.2

#: Number of rows for the height of the ground.
LOOKS = 16
#: Largest workspace, relative to the size of the robot, that the camera shows completely.
FAR = 3.0
#: A camera follows a robot that moves horizontally by more than this multiple of its size; the motion of the camera is a mean over so many frames.
FOLLOWED, SMOOTHED = 0.7, 15
#: Direction from the robot to the first position of the camera, and its vertical field of view, rad.
TOWARD, FIELD = np.array([1.15, 0.85, 0.6]) / np.linalg.norm([1.15, 0.85, 0.6]), np.radians(50.0)
_RIGHT = np.array([-TOWARD[1], TOWARD[0], 0.0]) / np.linalg.norm(TOWARD[:2])
#: Directions to the right, up, and toward the camera.
AXES = np.array([_RIGHT, np.cross(TOWARD, _RIGHT), TOWARD])
#: Extent of the visible space, relative to that of the robot.
MARGIN = 1.15
#: Number of vertices of a mesh that count for the extent.
VERTICES = 200


class Shape(NamedTuple):
    """A mesh on a link."""

    link: str
    mesh: trimesh.Trimesh
    place: _Array
    """Pose of the mesh in the link frame, homogeneous matrix (4, 4)."""


def shapes_of(scene: Scene, urdf: str | os.PathLike[str] | None, collision: bool = False) -> list[Shape]:
    """Shapes of all links: those of the file; if there are none, or no file, capsules of the inertias and rods between
    the joints. collision: the colliders instead. Colliders of the base, such as tables and stairs, are always shown.
    """
    # If any link has a shape, links without shapes are frames, or motors inside other links.
    drawn = [] if collision else of_file(scene, urdf) or stand_ins(scene)
    return [*drawn, *of_colliders(scene, fixed_only=not collision)]


def poses(scene: Scene, q: _Array) -> dict[str, _Array]:
    """Poses of all links, and that of the base under the name BASE."""
    return {**scene.placements(q), BASE: np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))}


def of_colliders(scene: Scene, fixed_only: bool) -> list[Shape]:
    """Shapes of the colliders, without half spaces; fixed_only: of those on the base."""
    made = []
    for _, link, (turn, origin), (kind, numbers, points), *_ in scene._collisions()[0]:
        place = np.eye(4)
        place[:3, :3], place[:3, 3] = np.reshape(turn, (3, 3)), origin
        if kind != "half space" and not (fixed_only and link is not None):
            made.append(Shape(BASE if link is None else link, color_mesh(_solid_mesh(kind, numbers, points), COLLIDER), place))
    return made


def _solid_mesh(kind: str, numbers: Sequence[float], points: Sequence[Sequence[float]] = ()) -> trimesh.Trimesh:
    """Mesh of a shape, from the kind and the numbers of a collider."""
    match kind:
        case "sphere":
            return trimesh.creation.icosphere(subdivisions=3, radius=numbers[0])
        case "capsule":
            return trimesh.creation.capsule(radius=numbers[0], height=numbers[1])
        case "cylinder":
            return trimesh.creation.cylinder(radius=numbers[0], height=numbers[1])
        case "box":
            return trimesh.creation.box(extents=numbers)
        case "hull":
            return trimesh.convex.convex_hull(np.asarray(points, float))
    columns, (x, y), heights = int(numbers[0]), numbers[1:3], np.asarray(numbers[3:])
    rows = len(heights) // columns
    grid = np.stack([*np.meshgrid(np.linspace(-x / 2, x / 2, columns), np.linspace(-y / 2, y / 2, rows))], axis=-1).reshape(-1, 2)
    at = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    faces = np.concatenate([np.stack([at, at + 1, at + columns], axis=1), np.stack([at + 1, at + columns + 1, at + columns], axis=1)])
    return trimesh.Trimesh(np.column_stack([grid, heights]), faces, process=False)


def of_file(scene: Scene, urdf: str | os.PathLike[str] | None) -> list[Shape]:
    """Shapes of the given file; None: those of the file of the scene, if it still exists, of its text, and of its
    builder.
    """
    if urdf is not None:
        return _of_path(scene, Path(urdf))
    file = scene.file
    found = [] if file is None or not file.is_file() or has_text(scene) else _of_path(scene, file)
    for source, text in texts_of(scene):
        if text.startswith(FROM_MJCF):
            found += _of_geoms(scene, *of_element(ElementTree.fromstring(text), None))
            continue
        # Paths in a text without a file are relative to the working directory.
        found += _of_urdf(scene, source or Path("urdf").absolute(), text)
    return found


def name_of(scene: Scene) -> str:
    """Name of the robot in its description, or of its file; "phipsi" for a scene from code."""
    texts = [text for _, text in texts_of(scene)]
    if scene.file is not None and scene.file.is_file():
        texts.insert(0, scene.file.read_text(encoding="utf-8", errors="replace"))
    for text in texts:
        if (found := NAME.search(COMMENT.sub("", text))) and found[2].strip():
            return unescape(found[2].strip())
    return "phipsi" if scene.file is None else scene.file.stem


def _of_path(scene: Scene, file: Path) -> list[Shape]:
    """Shapes of a URDF, xacro or MJCF file."""
    if not file.is_file():
        raise ArgumentError(f"urdf: found {str(file)[:100]!r}, which is not a file; expected the path of a URDF or MJCF, or None for the file of the scene")
    text = file.read_text(encoding="utf-8", errors="replace")
    if root_of(text) == "mujoco":
        return list(_of_geoms(scene, of_model(compiled(file)[0])))
    expanded = expanded_again(file, text)
    return [] if expanded is None else list(_of_urdf(scene, file, expanded))


def stand_ins(scene: Scene) -> list[Shape]:
    """Capsules of the inertias, and rods between the joints."""
    size = robot_size(scene)
    return [*_rods(scene, size), *_capsules(scene, size)]


def robot_size(scene: Scene) -> float:
    """Largest extent of the link origins and centers of mass at the neutral configuration, m; 1 if it is zero."""
    placements, links = scene.placements(scene.neutral()), scene.links
    points = [place[:3, 3] for place in placements.values()]
    points += [(place @ np.append(links[name].com, 1.0))[:3] for name, place in placements.items()]
    return float(np.ptp(np.array(points), axis=0).max()) or 1.0


# The camera


class Extent(NamedTuple):
    """Space that a robot occupies."""

    low: float
    """Height of its lowest point, m."""
    middle: _Array
    """Center of its bounding box, (3,), m."""
    points: _Array
    """Points of its surface relative to the center, to the right, up, and toward the camera, (n, 3), m."""

    def camera(self, aspect: float) -> _Array:
        """Position of a camera from which the robot fits in a window with this ratio of width to height."""
        half = np.tan(FIELD / 2.0) / MARGIN
        x, y, toward = np.abs(self.points[:, 0]), np.abs(self.points[:, 1]), self.points[:, 2]
        return np.asarray(self.middle + float(np.max(toward + np.maximum(x / (half * aspect), y / half))) * TOWARD)


def travel(scene: Scene, rows: _Array) -> _Array:
    """Horizontal displacement that a camera follows, (k, 3), m: of the center of mass, smoothed; zero if it is short."""
    if not len(scene.links):
        return np.zeros((len(rows), 3))
    # The center of mass of a robot with massless bodies only does not exist.
    moved = scene.center_of_mass(rows) if scene.total_mass > 0.0 else np.zeros((len(rows), 3))
    moved = (moved - moved[0]) * [1.0, 1.0, 0.0]
    if not np.linalg.norm(moved, axis=1).max() > FOLLOWED * robot_size(scene):
        return np.zeros_like(moved)
    # Steps and jumps of the robot do not shake the camera.
    width = min(SMOOTHED, len(moved))
    padded = np.concatenate([np.repeat(moved[:1], width // 2, axis=0), moved, np.repeat(moved[-1:], width - 1 - width // 2, axis=0)])
    return np.stack([np.convolve(padded[:, axis], np.full(width, 1.0 / width), mode="valid") for axis in range(3)], axis=1)


def extent(scene: Scene, shapes: Sequence[Shape], rows: _Array, shift: _Array | None = None) -> Extent:
    """Extent over some of the rows, (k, nq), or for the first row if the robot moves far; relative to a camera that moves by shift, (k, 3), m."""
    size = robot_size(scene)
    chosen = np.unique(np.linspace(0, len(rows) - 1, LOOKS).astype(int))
    some = rows[chosen]
    placements = poses(scene, some)
    if shift is not None:
        for place in (placements := {link: np.array(place) for link, place in placements.items()}).values():
            place[:, :3, 3] -= shift[chosen]
    corners = [place[:, None, :3, 3] for link, place in placements.items() if link != BASE or len(placements) == 1]
    fixed = list[_Array]()
    for shape in shapes:
        place, vertices = placements[shape.link] @ shape.place, np.asarray(shape.mesh.vertices)
        found = vertices[:: len(vertices) // VERTICES + 1]
        moved = found @ place[:, :3, :3].swapaxes(-1, -2) + place[:, None, :3, 3]
        (fixed if shape.link == BASE else corners).append(moved)
    points = np.concatenate(corners, axis=1)
    if np.ptp(points, axis=(0, 1)).max() > FAR * max(size, np.ptp(points[0], axis=0).max()):
        points = points[:1]
    points = points.reshape(-1, 3)
    if fixed:
        # Of a large table or height field, only the surroundings of the robot count.
        low, high = points.min(axis=0), points.max(axis=0)
        room = max(size, float((high - low).max()))
        points = np.concatenate([points, *(np.clip(of[0], low - room, high + room) for of in fixed)])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, box = (low + high) / 2, size / 8 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    # A point, for instance a robot without links, has a size too.
    return Extent(float(low[2]), middle, np.concatenate([points - middle, box]) @ AXES.T)


# Shapes of a file


def _of_urdf(scene: Scene, urdf: Path, text: str) -> Iterator[Shape]:
    """Visual shapes of the links of the scene; one warning for meshes that cannot be found or read."""
    text, capsules = _of_first_version(text)
    try:
        robot = yourdfpy.URDF.load(io.BytesIO(text.encode()), build_scene_graph=False, load_meshes=False).robot
    except Exception as error:  # the XML readers raise many types
        raise ArgumentError(f"urdf: found {str(urdf)!r}, which cannot be read ({error}); expected a URDF, or None for the file of the scene") from None
    colors = {material.name: material.color for material in robot.materials if material.color is not None}
    known, lost = set(scene.link_names), []
    for link in robot.links:
        if link.name not in known:
            continue
        for at, visual in enumerate(link.visuals):
            try:
                meshes = capsules.get((link.name, at)) or list(_meshes(visual.geometry, urdf))
            except (OSError, ValueError) as error:
                lost.append(f"{link.name}: {error}")
                continue
            place = np.eye(4) if visual.origin is None else np.asarray(visual.origin, float)
            for mesh in meshes:
                _paint(mesh, visual.material, colors)
                yield Shape(link.name, mesh, place)
    if lost:
        more = f", and {len(lost) - 1} more" if len(lost) > 1 else ""
        text = f"shapes that are not drawn: {lost[0]}{more}; expected readable files relative to the URDF or in a folder of {', '.join(SEARCHED)}"
        warn(text, MeshWarning)


def _of_first_version(text: str) -> tuple[str, dict[tuple[str, int], list[trimesh.Trimesh]]]:
    """Text for yourdfpy, which reads URDF 1.0: angles stand for quaternions and spheres for capsules, of URDF 1.1; and
    the capsules by link and index of the visual element.
    """
    if "<capsule" not in text and "quat_xyzw" not in text:
        return text, {}
    try:
        robot = ElementTree.fromstring(text)
    except ElementTree.ParseError:
        return text, {}
    for origin in robot.iter("origin"):
        if quaternion := origin.attrib.pop("quat_xyzw", None):
            x, y, z, w = map(float, quaternion.split())
            origin.set("rpy", " ".join(map(repr, map(float, angles(rotation((w, x, y, z)))))))
    found = {}
    for link in robot.iter("link"):
        for at, geometry in enumerate(link.findall("visual/geometry")):
            for capsule in geometry.findall("capsule"):
                radius, length = (float(capsule.get(name, "0")) for name in ("radius", "length"))
                found[link.get("name", ""), at] = [trimesh.creation.capsule(radius=radius, height=length)]
    for capsule in robot.iter("capsule"):
        capsule.tag, capsule.attrib = "sphere", {"radius": "1"}
    return ElementTree.tostring(robot, encoding="unicode"), found


def _meshes(geometry: Any, urdf: Path) -> Iterator[trimesh.Trimesh]:
    if geometry.box is not None:
        yield trimesh.creation.box(extents=geometry.box.size)
    elif geometry.cylinder is not None:
        yield trimesh.creation.cylinder(radius=geometry.cylinder.radius, height=geometry.cylinder.length)
    elif geometry.sphere is not None:
        yield trimesh.creation.icosphere(radius=geometry.sphere.radius, subdivisions=3)
    elif geometry.mesh is not None:
        file = find(geometry.mesh.filename, urdf)
        # Suppresses messages about files that are read successfully.
        with _quiet(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                found = trimesh.load(str(file), force="scene").dump(concatenate=False)
            except Exception as error:  # each reader raises different exceptions
                raise ValueError(f"{geometry.mesh.filename!r} cannot be read ({type(error).__name__}: {' '.join(str(error).split())[:200]})") from error
        meshes = [mesh for mesh in found if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
        if not meshes:
            raise ValueError(f"{geometry.mesh.filename!r} has no triangles")
        for mesh in meshes:
            if geometry.mesh.scale is not None:
                mesh.apply_scale(geometry.mesh.scale)
            yield mesh


class _quiet:
    """Suppresses the log messages of trimesh."""

    def __enter__(self) -> None:
        self._logger = logging.getLogger("trimesh")
        self._level = self._logger.level
        self._logger.setLevel(logging.CRITICAL)

    def __exit__(self, *_: object) -> None:
        self._logger.setLevel(self._level)


def _paint(mesh: trimesh.Trimesh, material: Any, colors: dict[str, Any]) -> None:
    """Apply the color of the URDF, or gray, to a mesh without color."""
    if mesh.visual.defined and mesh.visual.kind is not None:
        return
    color = None
    if material is not None:
        color = material.color or colors.get(material.name)
    rgba = GRAY if color is None else tuple(np.asarray(color.rgba, float))
    color_mesh(mesh, rgba)


def color_mesh(mesh: trimesh.Trimesh, rgba: tuple[float, ...]) -> trimesh.Trimesh:
    """The mesh in one color."""
    bytes_of = tuple(int(round(255 * min(max(part, 0.0), 1.0))) for part in rgba)
    mode = "OPAQUE" if rgba[3] == 1.0 else "BLEND"
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=bytes_of, metallicFactor=0.1, roughnessFactor=0.7, alphaMode=mode)
    mesh.visual = trimesh.visual.TextureVisuals(material=material)
    return mesh


def translucent(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A translucent copy, so that arrows inside are visible."""
    clear = mesh.copy()
    if clear.visual.kind != "texture":
        return color_mesh(clear, (*(np.asarray(clear.visual.main_color[:3]) / 255.0), OPACITY))
    material = clear.visual.material
    material = material.copy() if isinstance(material, trimesh.visual.material.PBRMaterial) else material.to_pbr()
    color = np.full(4, 255.0) if material.baseColorFactor is None else np.array(material.baseColorFactor, float)
    color[3] *= OPACITY
    material.baseColorFactor, material.alphaMode = color.astype(np.uint8), "BLEND"
    clear.visual.material = material
    return clear


# Shapes of a MuJoCo model

def _of_geoms(scene: Scene, geoms: Geoms, prefix: str = "") -> Iterator[Shape]:
    """Shapes of the links of the scene; prefix: of the names of these links."""
    known = set(scene.link_names)
    for geom in geoms.shapes:
        if prefix + geom.link not in known:
            continue
        if geom.kind == "mesh":
            mesh = trimesh.Trimesh(*geoms.meshes[geom.mesh], process=False)
        elif geom.kind == "ellipsoid":
            mesh = _solid_mesh("sphere", [1.0]).apply_scale(geom.lengths)
        else:
            mesh = _solid_mesh(geom.kind, geom.lengths)
        place = np.eye(4)
        place[:3, :3], place[:3, 3] = geom.rotation, geom.origin
        yield Shape(prefix + geom.link, color_mesh(mesh, tuple(geom.color)), place)


# Shapes of inertias


def _rods(scene: Scene, size: float) -> Iterator[Shape]:
    """A rod on each link from its joint to those of its children, and a sphere at each movable joint."""
    radius = THIN * size
    for joint in scene.joints.values():
        if joint.type != "fixed" and joint.parent is not None:
            yield Shape(joint.child, color_mesh(trimesh.creation.icosphere(radius=2.0 * radius, subdivisions=2), BONE), np.eye(4))
        if joint.parent is None or np.linalg.norm(joint.xyz) < radius:
            continue
        rod = trimesh.creation.cylinder(radius=radius, segment=np.array([np.zeros(3), joint.xyz]))
        yield Shape(joint.parent, color_mesh(rod, BONE), np.eye(4))


def _capsules(scene: Scene, size: float) -> Iterator[Shape]:
    """A capsule for the inertia of each link, with the dimensions of the uniform box that has this inertia."""
    for link in scene.links.values():
        if link.mass <= 0.0:
            continue
        moments, axes = np.linalg.eigh(link.inertia)
        sides = np.sqrt(np.maximum(6.0 * (moments.sum() - 2.0 * moments) / link.mass, 0.0))
        # The smallest moment belongs to the longest side, which comes first.
        length, radius = min(float(sides[0]), LONGEST * size), 0.25 * float(sides[1] + sides[2])
        radius = min(max(radius, THIN * size), THICKEST * size)
        place = np.eye(4)
        # The capsule is along z; the other two axes are arbitrary, but right-handed.
        place[:3, :3] = np.column_stack([axes[:, 1], np.cross(axes[:, 0], axes[:, 1]), axes[:, 0]])
        place[:3, 3] = link.com
        capsule = trimesh.creation.capsule(height=max(length - 2.0 * radius, 0.0), radius=radius)
        yield Shape(link.name, color_mesh(capsule, MASS), place)
