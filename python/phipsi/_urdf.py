"""Export of scenes as URDF."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ._mjcf_geoms import Geoms, of_element
from ._pose import angles
from ._xacro import expanded_again
from ._results import Joint
from ._urdf_colliders import GROUND
from .errors import ArgumentError, ModelWarning, of_argument, warn
from .shapes import has_text, texts_of

if TYPE_CHECKING:
    from ._core import Scene

_Array = NDArray[np.float64]

#: Joint types of URDF, and "spherical", which only phipsi reads.
KINDS = ("fixed", "revolute", "continuous", "prismatic", "planar", "floating", "spherical")
#: Limits that URDF 1.2 added.
ADDED = ("acceleration", "deceleration", "jerk")
#: Properties of a free joint that URDF cannot store if floating_base=True creates the joint.
LOSSES = ("armature", "damping", "friction", "stiffness", "friction_offset", "stribeck", "load_friction")
#: Solids of URDF and the names of their lengths.
SOLIDS = {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "length"), "capsule": ("radius", "length")}


def to_urdf(scene: Scene, path: str | os.PathLike[str] | None, name: str) -> str:
    """Implementation of Scene.to_urdf."""
    if scene.loops.names:
        names = ", ".join(map(repr, scene.loops.names[:8]))
        raise of_argument(ArgumentError, "scene", f"found connections ({names}), which URDF cannot represent; expected a tree: use scene.without_constraints()")
    if scene.contacts.names:
        names = ", ".join(map(repr, scene.contacts.names[:8]))
        raise of_argument(ArgumentError, "scene", f"found contacts ({names}), which URDF cannot represent; expected none: use scene.without_contacts()")
    if scene.keyframes or np.any(scene.initial() != scene.neutral()) or np.any(scene.initial_velocity()):
        warn("scene: found a start or keyframes, which URDF cannot represent; they are not written", ModelWarning)
    robot = ElementTree.Element("robot", name=name)
    shapes, materials = _shapes(scene)
    _add_colliders(scene, shapes)
    robot.extend(materials)
    for link in scene.links.values():
        element = _child(robot, "link", name=link.name)
        element.extend(shapes.get(link.name, []))
        if link.mass == 0.0 and not np.any(link.inertia):
            continue
        inertial = _child(element, "inertial")
        _child(inertial, "origin", xyz=_text(link.com))
        _child(inertial, "mass", value=_text(link.mass))
        entries = {f"i{'xyz'[i]}{'xyz'[j]}": _text(link.inertia[i, j]) for i in range(3) for j in range(i, 3)}
        _child(inertial, "inertia", **entries)
    is_new = any(np.isfinite(getattr(joint, what)) for joint in scene.joints.values() for what in ADDED)
    for joint in scene.joints.values():
        if joint.parent is None:
            _check_root(joint)
        else:
            _joint(robot, joint, is_new)
    _add_actuators(scene, robot)
    if is_new:
        robot.set("version", "1.2")
    elif any(True for _ in robot.iter("capsule")) or any("quat_xyzw" in origin.attrib for origin in robot.iter("origin")):
        robot.set("version", "1.1")
    ElementTree.indent(robot)
    text = f'<?xml version="1.0"?>\n{ElementTree.tostring(robot, encoding="unicode")}\n'
    if path is not None:
        Path(path).write_text(text, encoding="utf-8")
    return text


def _shapes(scene: Scene) -> tuple[dict[str, list[ElementTree.Element]], list[ElementTree.Element]]:
    """Shapes of links by name, and materials: of a URDF or xacro file that still exists, of the text, and of the builder;
    relative mesh paths of a file become absolute.
    """
    texts: list[tuple[Path | None, str | None]] = [*texts_of(scene)]
    if (file := scene.file) is not None and file.is_file() and not has_text(scene):
        texts.insert(0, (file, expanded_again(file, file.read_text(encoding="utf-8", errors="replace"))))
    shapes: dict[str, list[ElementTree.Element]] = {}
    materials: list[ElementTree.Element] = []
    for source, text in texts:
        try:
            robot = ElementTree.fromstring(text or "<none/>")
        except ElementTree.ParseError:
            continue
        if robot.tag == "mujoco":
            _add_geoms(shapes, *of_element(robot, source))
        if robot.tag != "robot":
            continue
        for mesh in robot.iter("mesh"):
            name = mesh.get("filename", "")
            if source is not None and name and "://" not in name:
                mesh.set("filename", str((source.parent / name).resolve()))
        for link in robot.findall("link"):
            shapes.setdefault(link.get("name", ""), []).extend(shape for shape in link if shape.tag in ("visual", "collision"))
        materials += robot.findall("material")
    return shapes, materials


def _add_geoms(shapes: dict[str, list[ElementTree.Element]], geoms: Geoms, prefix: str) -> None:
    """Add a <visual> element for each geom of a MuJoCo model; warn of those that URDF cannot represent."""
    lost = dict[str, int]()
    for geom in geoms.shapes:
        if geom.kind not in SOLIDS:
            lost[geom.kind] = lost.get(geom.kind, 0) + 1
            continue
        element = ElementTree.Element("visual")
        _child(element, "origin", xyz=_text(geom.origin), rpy=_text(angles(np.array(geom.rotation))))
        _child(_child(element, "geometry"), geom.kind, **_solid(geom.kind, geom.lengths))
        _child(_child(element, "material", name=""), "color", rgba=_text(geom.color))
        shapes.setdefault(prefix + geom.link, []).append(element)
    if lost:
        counts = ", ".join(f"{count} of kind {kind!r}" for kind, count in lost.items())
        warn(f"scene: found shapes of a MuJoCo model ({counts}), which have no URDF element or file; they are not written", ModelWarning)


def _solid(kind: str, lengths: Sequence[float]) -> dict[str, str]:
    """Attributes of a solid."""
    return {"size": _text(lengths)} if kind == "box" else dict(zip(SOLIDS[kind], map(_text, lengths), strict=True))


def _add_colliders(scene: Scene, shapes: dict[str, list[ElementTree.Element]]) -> None:
    """Add the colliders of links of which the file has no <collision>; warn of those that URDF cannot represent."""
    known, lost = {link for link, found in shapes.items() if any(one.tag == "collision" for one in found)}, []
    for name, link, (turn, origin), (kind, numbers, _), friction, restitution, *_ in scene._collisions()[0]:
        if link in known or (name, link, kind) == (GROUND, None, "half space"):
            continue
        if link is None or kind not in SOLIDS:
            lost.append(name)
            continue
        element = ElementTree.Element("collision")
        _child(element, "origin", xyz=_text(origin), rpy=_text(angles(np.reshape(turn, (3, 3)))))
        _child(_child(element, "geometry"), kind, **_solid(kind, numbers))
        found = shapes.setdefault(link, [])
        found.append(element)
        if not any(one.tag == "contact" for one in found):
            contact = ElementTree.Element("contact")
            for what, value in (("lateral_friction", friction), ("restitution", restitution)):
                _child(contact, what, value=_text(value))
            found.append(contact)
    if lost:
        more = f" and {len(lost) - 8} more" if len(lost) > 8 else ""
        warn(f"scene: found colliders ({', '.join(map(repr, lost[:8]))}{more}), which URDF cannot represent; they are not written", ModelWarning)


def _add_actuators(scene: Scene, robot: ElementTree.Element) -> None:
    """Add a transmission for each motor whose control is limited by the effort of its joint alone; warn of the others."""
    lost = list(scene.actuators.unsupported)
    for one in scene.actuators:
        most = scene.joints[one.joint].effort / abs(one.gear) if one.gear else np.inf
        if one.kind != "motor" or one.ctrlrange != (-most, most) or np.isfinite([one.forcerange, one.torquerange]).any():
            lost.append(one.name)
            continue
        element = _child(robot, "transmission", name=one.name)
        _child(element, "type").text = "transmission_interface/SimpleTransmission"
        _child(element, "joint", name=one.joint)
        _child(_child(element, "actuator", name=one.name), "mechanicalReduction").text = _text(one.gear)
    if lost:
        more = f" and {len(lost) - 8} more" if len(lost) > 8 else ""
        warn(f"scene: found actuators ({', '.join(map(repr, lost[:8]))}{more}), which URDF cannot represent; they are not written", ModelWarning)


def _check_root(joint: Joint) -> None:
    """Check that the free joint of a floating base has no losses: it is not written, because floating_base=True creates
    it on reading.
    """
    for what in LOSSES:
        if (value := getattr(joint, what)) != 0.0:
            raise ArgumentError(f"scene: found {what} {value:g} at the free joint {joint.name!r} of the base; expected 0, because URDF cannot store it")


def _joint(robot: ElementTree.Element, joint: Joint, is_new: bool) -> None:
    if joint.type not in KINDS:
        raise ArgumentError(f"scene: found joint {joint.name!r} of type {joint.type!r}, which URDF cannot represent; expected one of {', '.join(KINDS)}")
    is_bounded = bool(np.isfinite(joint.lower) or np.isfinite(joint.upper))
    # Other programs expect limits at revolute joints.
    kind = "continuous" if joint.type == "revolute" and not is_bounded else joint.type
    element = _child(robot, "joint", name=joint.name, type=kind)
    _child(element, "parent", link=str(joint.parent))
    _child(element, "child", link=joint.child)
    _child(element, "origin", xyz=_text(joint.xyz), rpy=_text(angles(joint.rotation)))
    if joint.axis is not None:
        _child(element, "axis", xyz=_text(joint.axis))
    # URDF 1.2 requires both.
    bounds = {"lower": joint.lower, "upper": joint.upper} if is_bounded or (is_new and kind == "prismatic") else {}
    bounds |= {what: value for what in ("effort", "velocity", "acceleration", "jerk") if np.isfinite(value := getattr(joint, what))}
    # The default is the limit of the acceleration.
    if joint.deceleration != joint.acceleration:
        bounds["deceleration"] = joint.deceleration
    if bounds:
        _child(element, "limit", **{what: _text(value) for what, value in bounds.items()})
    dynamics = {what: _text(value) for what in LOSSES if (value := getattr(joint, what)) != 0.0}
    if "stribeck" in dynamics:
        dynamics["stribeck_speed"] = _text(joint.stribeck_speed)
    if "stiffness" in dynamics:
        if len(joint.rest) != 1:
            raise ArgumentError(f"scene: found a spring at joint {joint.name!r} with {len(joint.rest)} coordinates; expected springs only at joints with one coordinate, because URDF cannot represent others")
        dynamics["rest"] = _text(joint.rest)
    if dynamics:
        # Other programs refuse the element without a standard attribute.
        _child(element, "dynamics", **{"damping": _text(joint.damping), **dynamics})
    if joint.mimic is not None:
        ratio, offset = _text(joint.mimic.multiplier), _text(joint.mimic.offset)
        _child(element, "mimic", joint=joint.mimic.joint, multiplier=ratio, offset=offset)


def _child(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, attributes)


def _text(numbers: Any) -> str:
    """Values with all significant digits."""
    return " ".join(repr(float(number)) for number in np.atleast_1d(numbers))
