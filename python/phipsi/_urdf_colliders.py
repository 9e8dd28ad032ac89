"""Colliders of a URDF: the shapes of its `<collision>` elements, their friction, and the ground."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from . import shapes
from ._colliders import check_contacts, fault
from ._coordinates import rotation
from ._files import SEARCHED, find
from ._files import read as text_of
from ._pose import angles
from .errors import ArgumentError, MeshWarning, ModelWarning, SceneError, warn

if TYPE_CHECKING:
    from ._core import Scene

#: Name of the ground.
GROUND = "ground"
#: Groups of the ground and of links that touch only the ground, as bits.
OF_GROUND, OF_LINKS = 1, 2
#: Depth at which shapes overlap, m.
DEPTH = 1e-6
#: Elements of Bullet and Gazebo that are read, and their largest values.
READ = {"lateral_friction": "friction", "mu1": "friction", "mu": "friction", "restitution": "restitution", "restitution_coefficient": "restitution"}
LARGEST = {"friction": np.finfo(float).max, "restitution": 1.0}
#: Elements of Bullet and Gazebo that are not read; mu2 only if it differs from mu1.
UNREAD = ("rolling_friction", "spinning_friction", "stiffness", "damping", "contact_cfm", "contact_erp", "mu2", "fdir1", "kp", "kd")
#: Largest number of names in a message.
LISTED = 6


def read(scene: Scene, source: str | PathLike[str], contacts: str, strict: bool) -> Scene:
    """The scene of a URDF with colliders, for its path or text."""
    check_contacts(contacts)
    return with_colliders(scene, *text_of(source), contacts, strict)


def with_colliders(scene: Scene, text: str, file: Path | None, contacts: str, strict: bool) -> Scene:
    """The scene of a URDF with colliders: for contacts="plane" all links touch the ground, for "all" also each other."""
    try:
        robot = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise SceneError(f"source: the shapes cannot be read: {error}; expected XML whose prefixes are declared") from None
    reader = _Reader(robot, set(scene.link_names), file or Path("urdf").absolute())
    builder, carriers = scene.to_builder(), dict[str, str | None]({GROUND: None})
    rules: dict[str, Any] = {"groups": OF_LINKS, "mask": OF_GROUND} if contacts == "plane" else {}
    names = {GROUND}
    # Of two shapes the larger friction counts: on the ground, that of the link.
    builder.collider(GROUND, shapes.HalfSpace(), friction=0.0, groups=OF_GROUND, mask=OF_GROUND | OF_LINKS)
    for link, found in reader.links():
        for at, shape in enumerate(found):
            name = link if len(found) == 1 else f"{link}/{at}"
            while name in names:
                name += "_"
            names.add(name)
            carriers[name] = link
            builder.collider(name, shape, link=link, **reader.values(link), **rules)
    for ends in _jointed(scene, {link for link in carriers.values() if link is not None}) if contacts == "all" else ():
        builder.exclude(*ends)
    reader.report(strict)
    made = _built(builder)
    if not made._touching():
        return made
    is_fixed = all(joint.parent is not None for joint in scene.joints.values())
    near = made.distances(made.neutral(), limit=0.0)
    overlaps = [of for of, distance in zip(near.pairs, near.distance, strict=True) if distance < -DEPTH and (is_fixed or GROUND not in of)]
    if not overlaps:
        return made
    pairs = sorted({tuple(carriers.get(name) or GROUND for name in of) for of in overlaps})
    for first, second in pairs:
        builder.exclude(*(None if name == GROUND else name for name in (first, second)))
    shown = ", ".join(f"{first!r} and {second!r}" for first, second in pairs[:LISTED]) + f" and {len(pairs) - LISTED} more pairs" * (len(pairs) > LISTED)
    warn(f"source: found shapes that overlap at the neutral configuration, of {shown}; these links do not touch each other", ModelWarning)
    return _built(builder)


def _built(builder: Any) -> Scene:
    with warnings.catch_warnings():
        # The reader has already given these warnings.
        warnings.simplefilter("ignore")
        built: Scene = builder.build()
        return built


def _jointed(scene: Scene, used: set[str]) -> Iterator[tuple[str, str]]:
    """Pairs of links with shapes that a joint connects, directly or through fixed joints."""
    root = {joint.child: joint.parent for joint in scene.joints.values() if joint.type == "fixed" and joint.parent is not None}

    def rigid(link: str) -> str:
        while link in root:
            link = root[link]
        return link

    attached = dict[str, list[str]]()
    for link in used:
        attached.setdefault(rigid(link), []).append(link)
    for joint in scene.joints.values():
        if joint.type != "fixed" and joint.parent is not None:
            yield from ((first, second) for first in attached.get(rigid(joint.parent), ()) for second in attached.get(joint.child, ()))


class _Reader:
    """Reads shapes and their friction, and collects elements that cannot be read."""

    def __init__(self, robot: ElementTree.Element, known: set[str], file: Path) -> None:
        self._robot, self._known, self._file = robot, known, file
        self._lost, self._unread = list[str](), list[str]()
        self._vertices: dict[tuple[Path, str], Any] = {}
        self._of_links = dict[str, list[ElementTree.Element]]()
        for link in robot.findall("link"):
            self._of_links.setdefault(link.get("name", ""), []).extend(link.findall("contact"))
        for element in robot.iter("gazebo"):
            self._of_links.setdefault(element.get("reference", ""), []).append(element)

    def links(self) -> Iterator[tuple[str, list[shapes.ColliderShape]]]:
        """Links and their shapes."""
        for link in self._robot.findall("link"):
            name, found = link.get("name", ""), list[shapes.ColliderShape]()
            for collision in link.findall("collision") if name in self._known else ():
                try:
                    shape = self._shape(collision)
                    reason = fault(shape)
                except (OSError, ValueError) as error:
                    reason = str(error)
                if reason is None:
                    found.append(shape)
                else:
                    self._lost.append(f"{name}: {reason}")
            if found:
                yield name, found

    def _shape(self, collision: ElementTree.Element) -> shapes.ColliderShape:
        place, geometry = dict[str, Any](), next(iter(collision.find("geometry") or ()), None)
        if (origin := collision.find("origin")) is not None:
            place = {"xyz": _numbers(origin, "xyz", "0 0 0"), "rpy": _numbers(origin, "rpy", "0 0 0")}
            if "quat_xyzw" in origin.attrib:
                place["rpy"] = angles(rotation(_numbers(origin, "quat_xyzw", "")))
        match geometry.tag if geometry is not None else None:
            case "box":
                return shapes.Box(_numbers(geometry, "size", ""), **place)
            case "sphere":
                return shapes.Sphere(_number(geometry, "radius"), place.get("xyz", shapes.ORIGIN))
            case "cylinder":
                return shapes.Cylinder(_number(geometry, "radius"), _number(geometry, "length"), **place)
            case "capsule":
                return shapes.Capsule(_number(geometry, "radius"), _number(geometry, "length"), **place)
            case "mesh":
                return shapes.Hull(self._hull(geometry), **place)
        raise ValueError("found no <geometry> with box, sphere, cylinder, capsule or mesh")

    def _hull(self, mesh: Any) -> Any:
        """Vertices of a mesh, (n, 3)."""
        file = find(mesh.get("filename", ""), self._file)
        if (file, mesh.get("scale", "")) not in self._vertices:
            scale = np.abs(_numbers(mesh, "scale", "1 1 1"))
            points = shapes.vertices_of(shapes.Mesh(file, scale)) * np.sign(_numbers(mesh, "scale", "1 1 1"))
            self._vertices[file, mesh.get("scale", "")] = points
        return self._vertices[file, mesh.get("scale", "")]

    def values(self, link: str) -> dict[str, Any]:
        """Friction and restitution of a link, as keyword arguments of SceneBuilder.collider."""
        found = dict[str, float]()
        for element in (inner for of in self._of_links.get(link, ()) for inner in of.iter()):
            try:
                value = float(element.get("value") or element.text or "")
            except ValueError:
                value = np.nan
            if (kind := READ.get(element.tag)) is not None and 0.0 <= value <= LARGEST[kind]:
                found[kind] = value
            elif kind is not None or (element.tag in UNREAD and not (element.tag == "mu2" and value == found.get("friction"))):
                self._unread.append(f"<{element.tag}> of {link!r}")
        return found

    def report(self, strict: bool) -> None:
        """Warn, or raise SceneError, for elements that cannot be read."""
        for found, kind, text in (
            (self._lost, MeshWarning, f"they touch nothing; expected shapes with a volume, and files relative to the URDF or in a folder of {', '.join(SEARCHED)}"),
            (self._unread, ModelWarning, "they are not read: friction has one coefficient, from 0, and restitution one from 0 to 1"),
        ):
            if not found:
                continue
            what = "shapes" if kind is MeshWarning else "parameters of contacts"
            more = f", and {len(found) - 1} more" if len(found) > 1 else ""
            message = f"source: found {what} that cannot be represented: {found[0]}{more}; {text}"
            if strict:
                raise SceneError(message)
            warn(message, kind)


def _numbers(element: Any, name: str, default: str) -> Any:
    count = len(default.split()) or {"size": 3}.get(name, 4)
    try:
        found = np.array([float(part) for part in element.get(name, default).split()])
    except ValueError:
        found = np.empty(0)
    if len(found) != count or not np.isfinite(found).all():
        raise ArgumentError(f"{name} of <{element.tag}>: found {element.get(name)!r}; expected {count} finite numbers")
    return found


def _number(element: Any, name: str) -> float:
    try:
        return float(element.get(name, ""))
    except ValueError:
        raise ArgumentError(f"{name} of <{element.tag}>: found {element.get(name)!r}; expected a number") from None
