"""The geoms of a MuJoCo model that are drawn, also as text: a scene from XML or a model has no file to read them from again."""

from __future__ import annotations

import base64
import io
import json
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ._coordinates import rotation
from ._mjcf import Names, compiled

if TYPE_CHECKING:
    import mujoco

#: Groups of geoms that MuJoCo shows; the others are for collisions.
SHOWN = (0, 1, 2)
#: Color of a geom that has none. Like MuJoCo, use the color of the material only then.
UNSET = np.array([0.5, 0.5, 0.5, 1.0], np.float32)
#: Factors from the sizes of a geom to the lengths of a shape, as in the numbers of a collider, by its kind.
FACTORS: dict[str, tuple[float, ...]] = {"sphere": (1,), "capsule": (1, 2), "cylinder": (1, 2), "box": (2, 2, 2), "ellipsoid": (1, 1, 1), "mesh": ()}


class Geom(NamedTuple):
    """A shape of a body."""

    link: str
    """Name of the body."""
    kind: str
    """A key of FACTORS."""
    lengths: list[float]
    """Lengths in m; those of an ellipsoid are its semi-axes."""
    mesh: int
    """Number of the mesh; -1: none."""
    origin: list[float]
    """Origin in the frame of the body, m."""
    rotation: list[list[float]]
    """Rotation matrix."""
    color: list[float]
    """Red, green, blue and opacity."""


class Geoms(NamedTuple):
    """The shapes of a model."""

    shapes: list[Geom]
    """The shapes, without planes and height fields."""
    meshes: dict[int, tuple[NDArray[Any], NDArray[Any]]]
    """Vertices, (n, 3), m, and triangles, (m, 3), by the number of the mesh."""


def of_model(model: mujoco.MjModel) -> Geoms:
    """The geoms that MuJoCo shows."""
    import mujoco

    bodies = Names(model).bodies
    found = Geoms([], {})
    for at in np.flatnonzero(np.isin(model.geom_group, SHOWN)).tolist():
        kind = mujoco.mjtGeom(model.geom_type[at]).name.removeprefix("mjGEOM_").lower()
        if kind not in FACTORS:
            continue
        mesh = int(model.geom_dataid[at]) if kind == "mesh" else -1
        if mesh >= 0 and mesh not in found.meshes:
            vertex, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
            vertices = model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]]
            found.meshes[mesh] = np.array(vertices), np.array(model.mesh_face[face : face + model.mesh_facenum[mesh]])
        material, color = model.geom_matid[at], model.geom_rgba[at]
        color = color if material < 0 or np.any(color != UNSET) else model.mat_rgba[material]
        lengths = [factor * size for factor, size in zip(FACTORS[kind], model.geom_size[at].tolist(), strict=False)]
        place = model.geom_pos[at].tolist(), rotation(np.roll(model.geom_quat[at], -1)).tolist()
        found.shapes.append(Geom(bodies[model.geom_bodyid[at]], kind, lengths, mesh, *place, color.tolist()))
    return found


def to_text(geoms: Geoms) -> str:
    """An element like that of an attached MJCF file, without a file, with the shapes as data."""
    arrays = [array for mesh in geoms.meshes.values() for array in mesh]
    np.savez(stream := io.BytesIO(), np.array(json.dumps([geoms.shapes, [*geoms.meshes]])), *arrays)
    element = ElementTree.Element("mujoco", file="", prefix="")
    # Larger levels take ten times as long, and save a tenth.
    element.text = base64.b64encode(zlib.compress(stream.getvalue(), 1)).decode()
    return ElementTree.tostring(element, encoding="unicode")


def from_text(data: str) -> Geoms:
    """The shapes of the content of that element."""
    with np.load(io.BytesIO(zlib.decompress(base64.b64decode(data)))) as arrays:
        text, *rest = (arrays[name] for name in arrays.files)
    shapes, numbers = json.loads(str(text))
    return Geoms([Geom(*shape) for shape in shapes], dict(zip(numbers, zip(rest[::2], rest[1::2], strict=True), strict=True)))


def of_element(root: ElementTree.Element, source: Path | None) -> tuple[Geoms, str]:
    """The shapes of an MJCF file by its root element, of an attached file or of to_text, and the prefix of its links."""
    if data := root.text if "file" in root.attrib else None:
        return from_text(data), root.get("prefix", "")
    file = Path(root.get("file", "")) if source is None else source
    return of_model(compiled(file)[0]) if file.is_file() else Geoms([], {}), root.get("prefix", "")
