"""What links look like: the shapes of a URDF or a MuJoCo model, and capsules of their inertia where it has none."""

from __future__ import annotations

import io
import logging
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
import yourdfpy
from numpy.typing import NDArray

from .._core import Scene
from .._load import root_of
from .._mjcf import Names, compiled
from .._xacro import expanded_again
from ..errors import ArgumentError, MeshWarning
from ..mujoco import rotation

_Array = NDArray[np.float64]

#: Red, green, blue, opacity: of shapes without a colour, of capsules, of what joins the joints.
GREY, MASS, BONE = (0.72, 0.75, 0.78, 1.0), (0.93, 0.65, 0.13, 0.7), (0.25, 0.38, 0.55, 1.0)
#: Of a robot with arrows of forces, which are inside it as a rule.
OPACITY = 0.5
#: What `package://` and `model://` may be looked up in, beside the folders above the URDF.
SEARCHED = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "GZ_SIM_RESOURCE_PATH")
#: Width of what joins two joints, of the size of the robot.
THIN = 0.012
#: The longest and the thickest capsule, of the size of the robot: an inertia that is wrong is seen, and leaves the others to be seen.
LONGEST, THICKEST = 4.0, 0.2


class Shape(NamedTuple):
    """A mesh on a link."""

    link: str
    mesh: trimesh.Trimesh
    place: _Array
    """Homogeneous matrix, mesh to link, (4, 4)."""


def shapes_of(scene: Scene, urdf: str | os.PathLike[str] | None) -> list[Shape]:
    """The shapes of all links: those of the file; where it gives none, or there is no file, capsules of inertias and rods from joint to joint."""
    # Where any link has a shape, one without is a frame, or a motor inside another link.
    return of_file(scene, urdf) or stand_ins(scene)


def of_file(scene: Scene, urdf: str | os.PathLike[str] | None) -> list[Shape]:
    """The shapes of the file that is asked for, or of the one that the scene comes from if it is still there."""
    file = scene.file if urdf is None else Path(urdf)
    if file is None or (urdf is None and not file.is_file()):
        return []
    if not file.is_file():
        raise ArgumentError(f"urdf: found {str(urdf)[:100]!r}, which is no file; expected the path of a URDF or MJCF, or None for the scene's own")
    text = file.read_text(encoding="utf-8", errors="replace")
    if root_of(text) == "mujoco":
        return list(of_mujoco(scene, file))
    expanded = expanded_again(file, text)
    return [] if expanded is None else list(_of_file(scene, file, expanded))


def stand_ins(scene: Scene) -> list[Shape]:
    """Capsules of inertias, and rods from joint to joint."""
    size = robot_size(scene)
    return [*_rods(scene, size), *_capsules(scene, size)]


def robot_size(scene: Scene) -> float:
    """The largest extent of the frames and mass centres at the neutral configuration, m; 1 where all are at one place."""
    placements, links = scene.placements(scene.neutral()), scene.links
    points = [place[:3, 3] for place in placements.values()]
    points += [(place @ np.append(links[name].com, 1.0))[:3] for name, place in placements.items()]
    return float(np.ptp(np.array(points), axis=0).max()) or 1.0


# Shapes of a file


def _of_file(scene: Scene, urdf: Path, text: str) -> Iterator[Shape]:
    """The visual shapes of links that the scene has; warns, once, of meshes that cannot be found or read."""
    try:
        robot = yourdfpy.URDF.load(io.BytesIO(text.encode()), build_scene_graph=False, load_meshes=False).robot
    except Exception as error:  # whatever its XML readers raise
        raise ArgumentError(f"urdf: found {str(urdf)!r}, which cannot be read ({error}); expected a URDF, or None for the scene's own") from None
    colours = {material.name: material.color for material in robot.materials if material.color is not None}
    known, lost = set(scene.link_names), []
    for link in robot.links:
        if link.name not in known:
            continue
        for visual in link.visuals:
            try:
                meshes = list(_meshes(visual.geometry, urdf))
            except (OSError, ValueError) as error:
                lost.append(f"{link.name}: {error}")
                continue
            place = np.eye(4) if visual.origin is None else np.asarray(visual.origin, float)
            for mesh in meshes:
                _paint(mesh, visual.material, colours)
                yield Shape(link.name, mesh, place)
    if lost:
        more = f", and {len(lost) - 1} more" if len(lost) > 1 else ""
        text = f"shapes that are not drawn: {lost[0]}{more}; expected files that can be read, beside the URDF or in a folder of {', '.join(SEARCHED)}"
        warnings.warn(text, MeshWarning, stacklevel=2)


def _meshes(geometry: Any, urdf: Path) -> Iterator[trimesh.Trimesh]:
    if geometry.box is not None:
        yield trimesh.creation.box(extents=geometry.box.size)
    elif geometry.cylinder is not None:
        yield trimesh.creation.cylinder(radius=geometry.cylinder.radius, height=geometry.cylinder.length)
    elif geometry.sphere is not None:
        yield trimesh.creation.icosphere(radius=geometry.sphere.radius, subdivisions=3)
    elif geometry.mesh is not None:
        file = find(geometry.mesh.filename, urdf)
        # What the readers say of files that they read all the same is nothing for a user of phipsi.
        with _quiet(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                found = trimesh.load(str(file), force="scene").dump(concatenate=False)
            except Exception as error:  # each format has a reader with exceptions of its own
                raise ValueError(f"{geometry.mesh.filename!r} cannot be read ({type(error).__name__}: {' '.join(str(error).split())[:200]})") from error
        meshes = [mesh for mesh in found if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
        if not meshes:
            raise ValueError(f"{geometry.mesh.filename!r} has no triangles")
        for mesh in meshes:
            if geometry.mesh.scale is not None:
                mesh.apply_scale(geometry.mesh.scale)
            yield mesh


class _quiet:
    """Without the messages of trimesh."""

    def __enter__(self) -> None:
        self._logger = logging.getLogger("trimesh")
        self._level = self._logger.level
        self._logger.setLevel(logging.CRITICAL)

    def __exit__(self, *_: object) -> None:
        self._logger.setLevel(self._level)


def find(name: str, urdf: Path) -> Path:
    """The file of a mesh: an absolute path, one beside the URDF, or in a package above it or in a folder of the environment."""
    scheme, colon, rest = name.partition("://")
    if not colon or scheme == "file":
        file = urdf.parent / (rest if colon else name)
        if file.is_file():
            return file
        raise FileNotFoundError(f"no file {name!r}")
    package, _, inside = rest.partition("/")
    above = urdf.resolve().parents
    folders = [Path(folder) for variable in SEARCHED for folder in os.environ.get(variable, "").split(os.pathsep) if folder]
    candidates = [folder / inside for folder in (*above, *folders) if folder.name == package]
    candidates += [folder / package / inside for folder in (*above, *folders)]
    candidates += [folder / "share" / package / inside for folder in (*above, *folders)]
    # A robot that was taken out of its package.
    candidates += [folder / inside for folder in list(above)[:3]]
    for file in candidates:
        if file.is_file():
            return file
    raise FileNotFoundError(f"no file {name!r}")


def _paint(mesh: trimesh.Trimesh, material: Any, colours: dict[str, Any]) -> None:
    """The colour of the URDF, or grey, on a mesh that brings none."""
    if mesh.visual.defined and mesh.visual.kind is not None:
        return
    colour = None
    if material is not None:
        colour = material.color or colours.get(material.name)
    rgba = GREY if colour is None else tuple(np.asarray(colour.rgba, float))
    colour_mesh(mesh, rgba)


def colour_mesh(mesh: trimesh.Trimesh, rgba: tuple[float, ...]) -> trimesh.Trimesh:
    """The mesh, in one colour."""
    bytes_of = tuple(int(round(255 * min(max(part, 0.0), 1.0))) for part in rgba)
    mode = "OPAQUE" if rgba[3] == 1.0 else "BLEND"
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=bytes_of, metallicFactor=0.1, roughnessFactor=0.7, alphaMode=mode)
    mesh.visual = trimesh.visual.TextureVisuals(material=material)
    return mesh


def translucent(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A copy that lets arrows inside be seen."""
    clear = mesh.copy()
    if clear.visual.kind != "texture":
        return colour_mesh(clear, (*(np.asarray(clear.visual.main_color[:3]) / 255.0), OPACITY))
    material = clear.visual.material
    material = material.copy() if isinstance(material, trimesh.visual.material.PBRMaterial) else material.to_pbr()
    colour = np.full(4, 255.0) if material.baseColorFactor is None else np.array(material.baseColorFactor, float)
    colour[3] *= OPACITY
    material.baseColorFactor, material.alphaMode = colour.astype(np.uint8), "BLEND"
    clear.visual.material = material
    return clear


# Shapes of a MuJoCo model

#: The groups of shapes that MuJoCo shows; those beyond are for collisions.
SHOWN = (0, 1, 2)


def of_mujoco(scene: Scene, file: Path) -> Iterator[Shape]:
    """The shapes of bodies that the scene has, but for planes and height fields."""
    import mujoco

    kinds = mujoco.mjtGeom
    model, _ = compiled(file)
    known, bodies = set(scene.link_names), Names(model).bodies
    for at in range(model.ngeom):
        link, (x, y, z) = bodies[model.geom_bodyid[at]], model.geom_size[at]
        if model.geom_group[at] not in SHOWN or link not in known:
            continue
        kind = model.geom_type[at]
        if kind == kinds.mjGEOM_SPHERE:
            mesh = trimesh.creation.icosphere(radius=x, subdivisions=3)
        elif kind == kinds.mjGEOM_CAPSULE:
            mesh = trimesh.creation.capsule(radius=x, height=2.0 * y)
        elif kind == kinds.mjGEOM_ELLIPSOID:
            mesh = trimesh.creation.icosphere(subdivisions=3).apply_scale([x, y, z])
        elif kind == kinds.mjGEOM_CYLINDER:
            mesh = trimesh.creation.cylinder(radius=x, height=2.0 * y)
        elif kind == kinds.mjGEOM_BOX:
            mesh = trimesh.creation.box(extents=[2.0 * x, 2.0 * y, 2.0 * z])
        elif kind == kinds.mjGEOM_MESH:
            mesh = _mesh(model, model.geom_dataid[at])
        else:
            continue
        material = model.geom_matid[at]
        place = np.eye(4)
        place[:3, :3], place[:3, 3] = rotation(model.geom_quat[at]), model.geom_pos[at]
        yield Shape(link, colour_mesh(mesh, tuple(model.geom_rgba[at] if material < 0 else model.mat_rgba[material])), place)


def _mesh(model: Any, mesh: int) -> trimesh.Trimesh:
    vertex, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]]
    return trimesh.Trimesh(np.array(vertices), np.array(model.mesh_face[face : face + model.mesh_facenum[mesh]]), process=False)


# Shapes of inertias


def _rods(scene: Scene, size: float) -> Iterator[Shape]:
    """A rod on each link from its own joint to those of its children, and a ball at each joint that moves."""
    radius = THIN * size
    for joint in scene.joints.values():
        if joint.type != "fixed" and joint.parent is not None:
            yield Shape(joint.child, colour_mesh(trimesh.creation.icosphere(radius=2.0 * radius, subdivisions=2), BONE), np.eye(4))
        if joint.parent is None or np.linalg.norm(joint.xyz) < radius:
            continue
        rod = trimesh.creation.cylinder(radius=radius, segment=np.array([np.zeros(3), joint.xyz]))
        yield Shape(joint.parent, colour_mesh(rod, BONE), np.eye(4))


def _capsules(scene: Scene, size: float) -> Iterator[Shape]:
    """The capsule of about a link's inertia: as long and as thick as the box of even density that has it."""
    for link in scene.links.values():
        if link.mass <= 0.0:
            continue
        moments, axes = np.linalg.eigh(link.inertia)
        sides = np.sqrt(np.maximum(6.0 * (moments.sum() - 2.0 * moments) / link.mass, 0.0))
        # The smallest moment is about the longest side, which comes first.
        length, radius = min(float(sides[0]), LONGEST * size), 0.25 * float(sides[1] + sides[2])
        radius = min(max(radius, THIN * size), THICKEST * size)
        place = np.eye(4)
        # The capsule is along its z; the other two axes do not matter, but for their hand.
        place[:3, :3] = np.column_stack([axes[:, 1], np.cross(axes[:, 0], axes[:, 1]), axes[:, 0]])
        place[:3, 3] = link.com
        capsule = trimesh.creation.capsule(height=max(length - 2.0 * radius, 0.0), radius=radius)
        yield Shape(link.name, colour_mesh(capsule, MASS), place)
