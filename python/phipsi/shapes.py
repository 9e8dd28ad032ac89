"""Shapes of links for `SceneBuilder.link(shape=...)`: how `show` draws a link, and the inertia of a uniform body.

>>> import phipsi
>>> plate = phipsi.shapes.Box((0.4, 0.2, 0.02), color="orange")
>>> plate.inertia(mass=2.0).diagonal().round(4).tolist()
[0.0067, 0.0267, 0.0333]

A link with a mass and shapes, and without an inertia, has the inertia of a uniform body.
Each shape is centered at `xyz` in the link frame and rotated by `rpy`. Sizes are in meters.
"""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._files import find
from ._install import command
from ._pose import from_rpy
from ._xacro import expanded_again
from .errors import ArgumentError, InertiaWarning

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["Box", "Capsule", "ColliderShape", "Color", "Cylinder", "HalfSpace", "HeightField", "Hull", "Mesh", "Shape", "Sphere"]


def __dir__() -> list[str]:
    return __all__


_Array = NDArray[np.float64]

ORIGIN = (0.0, 0.0, 0.0)
#: Largest distance of a given center of mass from the center of the shapes, relative to the radius of gyration.
OFF_CENTER = 1e-3
#: Colors by name: red, green, blue, from 0 to 1.
COLORS = {
    "black": (0.1, 0.1, 0.12), "blue": (0.17, 0.33, 0.52), "gray": (0.72, 0.75, 0.78), "green": (0.2, 0.55, 0.33), "orange": (0.9, 0.45, 0.1),
    "purple": (0.45, 0.3, 0.6), "red": (0.77, 0.2, 0.18), "white": (0.93, 0.92, 0.89), "yellow": (0.95, 0.77, 0.2),
}  # fmt: skip
#: A color: a name of COLORS, or red, green, blue and, optionally, opacity, each from 0 to 1.
Color: TypeAlias = "str | Sequence[float]"


class Box(NamedTuple):
    """Box with edges along the axes.

    Examples
    --------
    >>> import phipsi
    >>> phipsi.shapes.Box((0.1, 0.2, 0.3)).inertia(12.0).diagonal().round(3).tolist()
    [0.13, 0.1, 0.05]
    """

    size: ArrayLike
    """Lengths of the edges along x, y and z, (3,), m."""
    xyz: ArrayLike = ORIGIN
    """Center in the link frame, (3,), m."""
    rpy: ArrayLike = ORIGIN
    """Orientation in the link frame, rad: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    color: Color = "gray"
    """Color: a name of phipsi.shapes.COLORS, or red, green, blue and, optionally, opacity, each from 0 to 1."""

    def inertia(self, mass: float) -> _Array:
        """Inertia of a uniform box about its center, with axes parallel to the link frame, (3, 3), kg m^2.

        Parameters
        ----------
        mass : float
            Mass, kg.

        Returns
        -------
        inertia : (3, 3) ndarray
            Inertia about the center of the shape, for the argument `inertia` of SceneBuilder.link, kg m^2.

        Raises
        ------
        ArgumentError
            If a size of the shape is not positive.

        Examples
        --------
        >>> import phipsi
        >>> round(float(phipsi.shapes.Box((0.1, 0.2, 0.3)).inertia(12.0)[0, 0]), 4)
        0.13
        """
        x, y, z = _positive(self, "size", self.size, 3) ** 2
        return _turned(self, mass / 12.0 * np.array([y + z, x + z, x + y]))


class Sphere(NamedTuple):
    """Sphere.

    Examples
    --------
    >>> import phipsi
    >>> phipsi.shapes.Sphere(0.5).inertia(10.0).diagonal().tolist()
    [1.0, 1.0, 1.0]
    """

    radius: float
    """Radius, m."""
    xyz: ArrayLike = ORIGIN
    """Center in the link frame, (3,), m."""
    color: Color = "gray"
    """Color, as in Box."""

    def inertia(self, mass: float) -> _Array:
        """Inertia of a uniform sphere about its center, (3, 3), kg m^2.

        Parameters
        ----------
        mass : float
            Mass, kg.

        Returns
        -------
        inertia : (3, 3) ndarray
            Inertia about the center of the shape, for the argument `inertia` of SceneBuilder.link, kg m^2.

        Raises
        ------
        ArgumentError
            If a size of the shape is not positive.

        Examples
        --------
        >>> import phipsi
        >>> round(float(phipsi.shapes.Sphere(0.5).inertia(10.0)[0, 0]), 4)
        1.0
        """
        (radius,) = _positive(self, "radius", self.radius, 1)
        return np.array(0.4 * mass * radius**2 * np.eye(3))


class Cylinder(NamedTuple):
    """Cylinder along z.

    Examples
    --------
    >>> import phipsi
    >>> phipsi.shapes.Cylinder(radius=0.1, length=0.6).inertia(2.0).diagonal().round(3).tolist()
    [0.065, 0.065, 0.01]
    """

    radius: float
    """Radius, m."""
    length: float
    """Length along z, m."""
    xyz: ArrayLike = ORIGIN
    """Center in the link frame, (3,), m."""
    rpy: ArrayLike = ORIGIN
    """Orientation in the link frame, as in Box."""
    color: Color = "gray"
    """Color, as in Box."""

    def inertia(self, mass: float) -> _Array:
        """Inertia of a uniform cylinder about its center, with axes parallel to the link frame, (3, 3), kg m^2.

        Parameters
        ----------
        mass : float
            Mass, kg.

        Returns
        -------
        inertia : (3, 3) ndarray
            Inertia about the center of the shape, for the argument `inertia` of SceneBuilder.link, kg m^2.

        Raises
        ------
        ArgumentError
            If a size of the shape is not positive.

        Examples
        --------
        >>> import phipsi
        >>> round(float(phipsi.shapes.Cylinder(0.1, 0.6).inertia(2.0)[2, 2]), 4)
        0.01
        """
        radius, length = _lengths(self)
        across = (3.0 * radius**2 + length**2) / 12.0
        return _turned(self, mass * np.array([across, across, 0.5 * radius**2]))


class Capsule(NamedTuple):
    """Capsule along z: a cylinder with a hemisphere at each end.

    Examples
    --------
    >>> import phipsi
    >>> phipsi.shapes.Capsule(radius=0.05, length=0.3).inertia(1.0).diagonal().round(4).tolist()
    [0.0119, 0.0119, 0.0012]
    """

    radius: float
    """Radius, m."""
    length: float
    """Length of the cylindrical part, m; the capsule is longer by twice the radius."""
    xyz: ArrayLike = ORIGIN
    """Center in the link frame, (3,), m."""
    rpy: ArrayLike = ORIGIN
    """Orientation in the link frame, as in Box."""
    color: Color = "gray"
    """Color, as in Box."""

    def inertia(self, mass: float) -> _Array:
        """Inertia of a uniform capsule about its center, with axes parallel to the link frame, (3, 3), kg m^2.

        Parameters
        ----------
        mass : float
            Mass, kg.

        Returns
        -------
        inertia : (3, 3) ndarray
            Inertia about the center of the shape, for the argument `inertia` of SceneBuilder.link, kg m^2.

        Raises
        ------
        ArgumentError
            If a size of the shape is not positive.

        Examples
        --------
        >>> import phipsi
        >>> round(float(phipsi.shapes.Capsule(0.05, 0.3).inertia(1.0)[2, 2]), 4)
        0.0012
        """
        radius, length = _lengths(self)
        # Masses of the cylinder and of both hemispheres.
        tube = mass * length / (length + 4.0 / 3.0 * radius)
        ends = mass - tube
        across = tube * (radius**2 / 4.0 + length**2 / 12.0) + ends * (0.4 * radius**2 + length**2 / 4.0 + 0.375 * length * radius)
        return _turned(self, np.array([across, across, 0.5 * tube * radius**2 + 0.4 * ends * radius**2]))


class Mesh(NamedTuple):
    """Triangles of a file that trimesh reads, such as STL, OBJ, PLY, DAE or GLB.

    Examples
    --------
    >>> import phipsi
    >>> phipsi.shapes.Mesh("hand.stl", scale=0.001).scale
    0.001
    """

    file: str | os.PathLike[str]
    """Path of the file."""
    scale: ArrayLike = 1.0
    """Factor from the unit of the file to m, or three factors, (3,)."""
    xyz: ArrayLike = ORIGIN
    """Origin of the mesh in the link frame, (3,), m."""
    rpy: ArrayLike = ORIGIN
    """Orientation in the link frame, as in Box."""
    color: Color = "gray"
    """Color, as in Box, if the file has no colors."""


class Hull(NamedTuple):
    """Convex hull of points, for colliders.

    Examples
    --------
    >>> import phipsi
    >>> len(phipsi.shapes.Hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]).points)
    4
    """

    points: ArrayLike
    """Points, (n, 3), m; at least four, not in one plane."""
    xyz: ArrayLike = ORIGIN
    """Origin of the points in the link frame, (3,), m."""
    rpy: ArrayLike = ORIGIN
    """Orientation in the link frame, as in Box."""


class HalfSpace(NamedTuple):
    """Everything below the plane z = 0 of its frame, for colliders that cannot move.

    Examples
    --------
    >>> import phipsi
    >>> phipsi.shapes.HalfSpace(xyz=(0, 0, -0.5)).xyz
    (0, 0, -0.5)
    """

    xyz: ArrayLike = ORIGIN
    """A point of the plane in the link frame, (3,), m."""
    rpy: ArrayLike = ORIGIN
    """Orientation in the link frame, as in Box; z is the normal of the plane."""


class HeightField(NamedTuple):
    """Ground below the heights of a grid of points, for colliders that cannot move: two triangles per cell, whose common
    edge connects the corner with the larger x and the one with the larger y.

    Examples
    --------
    >>> import phipsi
    >>> phipsi.shapes.HeightField([[0.0, 0.1], [0.0, 0.2]], size=(2.0, 2.0)).size
    (2.0, 2.0)
    """

    heights: ArrayLike
    """Heights along z, (rows, columns), m: x increases along a row, y from row to row."""
    size: ArrayLike
    """Lengths of the grid along x and y, (2,), m; its center is the origin."""
    xyz: ArrayLike = ORIGIN
    """Center of the grid in the link frame, (3,), m."""
    rpy: ArrayLike = ORIGIN
    """Orientation in the link frame, as in Box."""


Shape: TypeAlias = "Box | Sphere | Cylinder | Capsule | Mesh"
#: A shape that touches others.
ColliderShape: TypeAlias = "Shape | Hull | HalfSpace | HeightField"


def solid_of(subject: str, shape: ColliderShape) -> tuple[Any, tuple[str, list[float], list[list[float]]]]:
    """Frame (rotation by rows, origin) and numbers (kind, lengths, points) of a shape, for SceneBuilder.collider."""
    points: list[list[float]] = []
    numbers: list[float] = []
    try:
        match shape:
            case Box():
                kind, numbers = "box", _positive(shape, "size", shape.size, 3).tolist()
            case Sphere():
                kind, numbers = "sphere", _positive(shape, "radius", shape.radius, 1).tolist()
            case Cylinder() | Capsule():
                kind, numbers = type(shape).__name__.lower(), list(_lengths(shape))
            case HalfSpace():
                kind = "half space"
            case HeightField():
                heights, (x, y) = np.asarray(shape.heights, float), np.asarray(shape.size, float)
                if heights.ndim != 2:
                    raise ArgumentError(f"heights of HeightField: found the shape {heights.shape}; expected (rows, columns)")
                kind, numbers = "height field", [float(heights.shape[1]), float(x), float(y), *heights.ravel().tolist()]
            case Hull():
                kind, points = "hull", _points("points of Hull", shape.points)
            case Mesh():
                kind, points = "hull", _points("vertices of Mesh", vertices_of(shape))
            case _:
                raise ArgumentError(f"found {type(shape).__name__}; {COLLIDERS}")
        rpy = ORIGIN if isinstance(shape, Sphere) else shape.rpy
        frame = from_rpy(_numbers(shape, "rpy", rpy, 3)), _numbers(shape, "xyz", shape.xyz, 3)
    except (TypeError, ValueError) as error:
        if not isinstance(error, ArgumentError):
            error = ArgumentError(f"found {type(shape).__name__} with {error}; {COLLIDERS}")
        raise ArgumentError(f"shape of {subject}: {error}") from None
    return (frame[0].ravel().tolist(), frame[1].tolist()), (kind, numbers, points)


def _points(name: str, value: ArrayLike) -> list[list[float]]:
    """Points, (n, 3)."""
    found = np.asarray(value, float)
    if found.ndim != 2 or found.shape[1] != 3:
        raise ArgumentError(f"{name}: found the shape {found.shape}; expected (n, 3)")
    return np.unique(found, axis=0).tolist() if len(found) else []


def vertices_of(shape: Mesh) -> _Array:
    """Vertices of all triangles of a mesh, scaled, (n, 3)."""
    try:
        import trimesh
    except ImportError:
        raise ImportError(f"shape: found a mesh and no package trimesh; install it with: {command('view')}") from None
    file = Path(shape.file)
    if not file.is_file():
        raise ArgumentError(f"file of Mesh: found {str(shape.file)[:100]!r}, which is not a file; expected the path of a mesh")
    try:
        # Processing would remove vertices that are not finite.
        loaded = trimesh.load(file, force="mesh", process=False)
    except Exception as error:  # trimesh raises many types
        raise ArgumentError(f"file of Mesh: {file.name} cannot be read ({' '.join(str(error).split())[:200]})") from error
    if not len(loaded.faces) or not np.isfinite(loaded.vertices).all():
        found = "a vertex that is not finite" if len(loaded.faces) else "no triangles"
        raise ArgumentError(f"file of Mesh: found {found} in {file.name}; expected a mesh of triangles with finite vertices")
    return np.asarray(loaded.vertices, float) * np.broadcast_to(_positive(shape, "scale", shape.scale, None), 3)


def listed(shape: ColliderShape | Sequence[ColliderShape]) -> list[ColliderShape]:
    """Shapes as a list."""
    return [shape] if isinstance(shape, Box | Sphere | Cylinder | Capsule | Mesh | Hull | HalfSpace | HeightField) else list(shape)


def to_urdf(link: str, shape: Shape | Sequence[Shape]) -> str:
    """Robot with one link as the text of a URDF, for SceneBuilder.link."""
    shapes = [shape] if isinstance(shape, Box | Sphere | Cylinder | Capsule | Mesh) else shape
    robot = ElementTree.Element("robot", name="")
    element = ElementTree.SubElement(robot, "link", name=link)
    try:
        for one in shapes:
            _visual(element, one)
    except (TypeError, ValueError) as error:
        if isinstance(shape, Hull | HalfSpace | HeightField):
            error = ArgumentError(f"found {type(shape).__name__}; {EXPECTED}: SceneBuilder.collider takes others")
        elif not isinstance(error, ArgumentError):
            error = ArgumentError(f"found {type(shape).__name__}; {EXPECTED}")
        raise ArgumentError(f"shape of link {link!r}: {error}") from None
    return ElementTree.tostring(robot, encoding="unicode")


def uniform_body(
    link: str, mass: float, com: tuple[float, float, float] | None, shape: Shape | Sequence[Shape]
) -> tuple[list[float], list[float]] | None:
    """Center of mass, (3,), and inertia about it (xx, xy, xz, yy, yz, zz) of a uniform body, for SceneBuilder.link;
    None if the shapes do not determine them. The body is moved to `com`, if that is not None.
    """
    shapes = [shape] if isinstance(shape, Box | Sphere | Cylinder | Capsule | Mesh) else shape
    bodies = [(one, _volume(one), _numbers(one, "xyz", one.xyz, 3)) for one in shapes if not isinstance(one, Mesh)]
    if not bodies or len(bodies) < len(shapes):
        if shapes:
            text = f"link {link!r}: the inertia of a Mesh is not computed, and the link is a point mass; expected inertia="
            warnings.warn(text, InertiaWarning, stacklevel=2)
        return None
    total = sum(volume for _, volume, _ in bodies)
    center = np.asarray(sum(volume / total * xyz for _, volume, xyz in bodies))
    inertia = np.zeros((3, 3))
    for one, volume, xyz in bodies:
        part, lever = mass * volume / total, xyz - center
        inertia += one.inertia(part) + part * (lever @ lever * np.eye(3) - np.outer(lever, lever))
    if com is not None:
        radius = np.sqrt(abs(np.trace(inertia) / mass))
        if np.linalg.norm(center - com) > OFF_CENTER * radius:
            text = (
                f"link {link!r}: found com {np.asarray(com).tolist()}, and the center of its shapes is {center.tolist()}; the inertia is that of "
                "a uniform body about its center, moved to com; expected inertia=, or no com"
            )
            warnings.warn(text, InertiaWarning, stacklevel=2)
        center = np.asarray(com)
    return center.tolist(), inertia[np.triu_indices(3)].tolist()


def _volume(shape: Box | Sphere | Cylinder | Capsule) -> float:
    """Volume of a shape, m^3."""
    if isinstance(shape, Box):
        return float(np.prod(_positive(shape, "size", shape.size, 3)))
    (radius,) = _positive(shape, "radius", shape.radius, 1)
    ball = 0.0 if isinstance(shape, Cylinder) else 4.0 / 3.0 * np.pi * radius**3
    tube = 0.0 if isinstance(shape, Sphere) else np.pi * radius**2 * _lengths(shape)[1]
    return float(ball + tube)


def texts_of(scene: Scene) -> list[tuple[Path | None, str]]:
    """URDF texts with the shapes of a scene, each with the file that its mesh paths are relative to: the text that the
    scene was read from, if it has shapes, and links from code. A scene from a file has no text, unless it was expanded
    by xacro.
    """
    return [(None if text.startswith((FROM_CODE, FROM_MJCF)) else scene.file, text) for text in scene._shapes]


def has_text(scene: Scene) -> bool:
    """Whether the scene has the text that it was read from."""
    return any(not text.startswith((FROM_CODE, FROM_MJCF)) for text in scene._shapes)


def prefixed(scene: Scene, prefix: str) -> list[str]:
    """URDF texts with the shapes of a scene, whose links have a prefix and whose mesh files are absolute paths. For an MJCF
    model, an element with its path or its shapes (`_mjcf_geoms`), and the prefix.
    """
    given = texts_of(scene)
    file = scene.file
    if file is not None and file.is_file() and not has_text(scene):
        text = file.read_text(encoding="utf-8", errors="replace")
        if (expanded := expanded_again(file, text)) is not None:
            given.append((file, expanded))
    found = []
    for source, text in given:
        robot = ElementTree.fromstring(text)
        if robot.tag == "mujoco":
            named = robot.get("file", "" if source is None else str(source.absolute()))
            if named or robot.text:
                part = ElementTree.Element("mujoco", file=named, prefix=prefix + robot.get("prefix", ""))
                part.text = robot.text if "file" in robot.attrib else None
                found.append(ElementTree.tostring(part, encoding="unicode"))
            continue
        for part in [part for part in robot if part.tag not in ("link", "material")]:
            robot.remove(part)
        for link in robot.iter("link"):
            link.set("name", prefix + link.get("name", ""))
            for part in [part for part in link if part.tag != "visual"]:
                link.remove(part)
        for mesh in robot.iter("mesh"):
            with contextlib.suppress(FileNotFoundError):
                mesh.set("filename", str(find(mesh.get("filename", ""), source or Path("urdf").absolute())))
        robot.attrib = {"name": ""}
        found.append(ElementTree.tostring(robot, encoding="unicode"))
    return found


#: Begin of the texts of to_urdf, and of those of an attached MJCF file or of an MJCF model without a file.
FROM_CODE, FROM_MJCF = '<robot name="">', "<mujoco file="
COLLIDERS = "expected a Box, Sphere, Cylinder, Capsule, Mesh, Hull, HalfSpace or HeightField of phipsi.shapes"
EXPECTED = "expected a Box, Sphere, Cylinder, Capsule or Mesh of phipsi.shapes, or a sequence of them"


def _visual(link: ElementTree.Element, shape: Any) -> None:
    """Append the <visual> element of a shape."""
    visual = ElementTree.SubElement(link, "visual")
    geometry = ElementTree.SubElement(visual, "geometry")
    match shape:
        case Box():
            ElementTree.SubElement(geometry, "box", size=_text(_positive(shape, "size", shape.size, 3)))
        case Sphere():
            ElementTree.SubElement(geometry, "sphere", radius=_text(_positive(shape, "radius", shape.radius, 1)))
        case Cylinder() | Capsule():
            radius, length = _lengths(shape)
            ElementTree.SubElement(geometry, type(shape).__name__.lower(), radius=_text(radius), length=_text(length))
        case Mesh():
            scale = np.broadcast_to(_positive(shape, "scale", shape.scale, None), 3)
            file = Path(shape.file).absolute()
            if not file.is_file():
                raise ArgumentError(f"file of Mesh: found {str(shape.file)[:100]!r}, which is not a file; expected the path of a mesh")
            ElementTree.SubElement(geometry, "mesh", filename=str(file), scale=_text(scale))
        case _:
            raise ArgumentError(f"found {type(shape).__name__}; {EXPECTED}")
    rpy = ORIGIN if isinstance(shape, Sphere) else shape.rpy
    ElementTree.SubElement(visual, "origin", xyz=_text(_numbers(shape, "xyz", shape.xyz, 3)), rpy=_text(_numbers(shape, "rpy", rpy, 3)))
    material = ElementTree.SubElement(visual, "material", name="")
    ElementTree.SubElement(material, "color", rgba=_text(_rgba(shape)))


def _rgba(shape: Shape) -> _Array:
    """Red, green, blue and opacity of a shape."""
    color: Any = shape.color
    if isinstance(color, str):
        if color not in COLORS:
            raise ArgumentError(f"color of {type(shape).__name__}: found {color!r}; expected {', '.join(map(repr, COLORS))}, or red, green and blue from 0 to 1")
        color = COLORS[color]
    try:
        found = np.array(color, float)
    except (TypeError, ValueError):
        found = np.array(np.nan)
    if found.shape not in ((3,), (4,)) or not np.all((found >= 0.0) & (found <= 1.0)):
        raise ArgumentError(f"color of {type(shape).__name__}: found {shape.color!r}; expected a name, or three or four numbers from 0 to 1")
    return np.append(found, 1.0)[:4]


def _numbers(shape: ColliderShape, name: str, value: ArrayLike, size: int | None) -> _Array:
    """Finite numbers, (size,); None: one or three."""
    expected = "one or three finite numbers" if size is None else "a finite number" if size == 1 else f"{size} finite numbers"
    try:
        found = np.atleast_1d(np.array(value, float))
    except (TypeError, ValueError):
        found = np.array(np.nan)
    if found.shape not in ((1,), (3,)) or (size is not None and found.size != size) or not np.isfinite(found).all():
        raise ArgumentError(f"{name} of {type(shape).__name__}: found {value!r}; expected {expected}")
    return found


def _positive(shape: Shape, name: str, value: ArrayLike, size: int | None) -> _Array:
    """Positive numbers, (size,)."""
    found = _numbers(shape, name, value, size)
    if not np.all(found > 0.0):
        raise ArgumentError(f"{name} of {type(shape).__name__}: found {value!r}; expected positive values")
    return found


def _lengths(shape: Cylinder | Capsule) -> tuple[float, float]:
    """Radius and length."""
    return float(_positive(shape, "radius", shape.radius, 1)[0]), float(_positive(shape, "length", shape.length, 1)[0])


def _turned(shape: Box | Cylinder | Capsule, moments: _Array) -> _Array:
    """Inertia with these principal moments, in the link frame."""
    turn = from_rpy(_numbers(shape, "rpy", shape.rpy, 3))
    return np.array(turn @ np.diag(moments) @ turn.T)


def _text(values: ArrayLike) -> str:
    return " ".join(repr(float(value)) for value in np.atleast_1d(np.asarray(values, float)))
