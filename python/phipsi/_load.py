"""Scenes from robot descriptions of several formats, in one call."""

from __future__ import annotations

import importlib
import logging
import os
import re
import warnings
from collections.abc import Collection, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ._colliders import check_contacts
from ._core import Scene
from ._files import EXPECTED, read
from ._urdf_colliders import with_colliders
from ._xacro import COMMENT, expanded, is_xacro
from .errors import ArgumentError, MimicWarning, SceneError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

#: The root element of a file.
ROOT = re.compile(r"<\s*([A-Za-z_][\w:.-]*)")
#: Suffixes of meshes.
MESHES = (".stl", ".obj", ".dae", ".ply", ".glb", ".gltf", ".off", ".3mf", ".step", ".stp")


def load(
    source: Any,
    *,
    floating_base: bool = False,
    gravity: ArrayLike | None = None,
    strict: bool = False,
    leave_out: Collection[Any] | None = None,
    xacro_arguments: Mapping[str, str] | None = None,
    mimic: bool | Literal["couple", "free"] | None = None,
    ignore: Collection[Any] = (),
    contacts: Literal["all", "plane"] | None = None,
) -> Scene:
    """Load a scene from a robot description; the format is detected from the content.

    Parameters
    ----------
    source : path, str or model
        Path or text of a URDF, of a xacro (needs the package xacro) or of an MJCF model (needs the package
        mujoco); the name of a module of robot_descriptions, such as "ur5e_description"; or a mujoco.MjModel,
        mujoco.MjSpec or pinocchio.Model.
    floating_base : bool
        Whether to add a free joint between the base and the root link of a URDF. Models of MuJoCo and Pinocchio
        define their free joints themselves.
    gravity : array_like, (3,), optional
        Gravity in the base frame, m/s^2; None: that of the model, or (0, 0, -9.81) for a URDF.
    strict : bool
        True to raise SceneError instead of a warning, as in Scene.from_urdf.
    leave_out : collection of str, optional
        Simplifications to use, as in Scene.from_urdf; None: all.
    xacro_arguments : mapping of str to str, optional
        Values of the `<xacro:arg>` elements of a xacro.
    mimic : bool, "couple" or "free", optional
        True or "couple": joints of a URDF with `<mimic>` follow the joint that they name and have no coordinates of
        their own. False or "free": they are independent. None: they are independent, with a MimicWarning for each.
    ignore : collection of str
        Parts of an MJCF model to omit, as in Scene.from_mujoco.
    contacts : {"all", "plane"}, optional
        Which shapes of an MJCF model (as in Scene.from_mujoco) or of the `<collision>` elements of a URDF touch each
        other. "plane": shapes of links touch fixed planes; for a URDF, the plane z = 0 of the base, the collider
        "ground". "all": shapes of links touch each other too. None: no shapes are read.

    Returns
    -------
    Scene
        The scene.

    Raises
    ------
    SceneError
        If the source cannot be read or is not a valid robot description.
    ArgumentError
        If the source has an unsupported type, if an argument does not apply to the format of the source, or if
        xacro_arguments lacks a required argument or contains an unknown one.
    ImportError
        If a package that the format needs is not installed.

    Notes
    -----
    `$(find package)` in a xacro resolves to the folder of that name, or to the folder whose package.xml has
    that name, in the folders above the file, beside them, or in ROS_PACKAGE_PATH or AMENT_PREFIX_PATH;
    otherwise ROS resolves it.

    A collider of a URDF has the name of its link, followed by "/0", "/1", ... if there are several; a mesh stands for
    its convex hull. Its friction and restitution are those of `<contact>` (Bullet) or `<gazebo>`, otherwise 1 and 0;
    the ground has a friction of 0, so that that of the link counts. Links that a joint connects, directly or through
    fixed joints, do not touch each other. Links whose shapes overlap at the neutral configuration do not either, as in
    MoveIt, with a ModelWarning that names them; if the base is fixed, this includes the ground. A MeshWarning names
    shapes without volume and meshes that cannot be found or read, which touch nothing; a ModelWarning names parameters
    of contacts that are not read. strict=True raises SceneError for both.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> scene.nq, scene.joint_names[:2]
    (6, ('joint1', 'joint2'))
    """
    if mimic not in (None, True, False, "couple", "free"):
        raise ArgumentError(f'mimic: found {mimic!r}; expected True ("couple"), False ("free") or None')
    check_contacts(contacts)
    options: dict[str, Any] = {"gravity": gravity, "strict": strict, "leave_out": leave_out}
    package = type(source).__module__.partition(".")[0]
    if package in ("mujoco", "pinocchio"):
        _has_no_use(floating_base, "floating_base", source)
        _has_no_use(xacro_arguments, "xacro_arguments", source)
        _has_no_use(mimic, "mimic", source)
        if package == "mujoco":
            return Scene.from_mujoco(source, **options, ignore=ignore, contacts=contacts)
        _has_no_use(ignore, "ignore", source)
        _has_no_use(contacts, "contacts", source)
        return Scene.from_pinocchio(source, **options)
    if not isinstance(source, str | os.PathLike):
        raise ArgumentError(f"source: found {type(source).__name__}; expected {EXPECTED}")
    if isinstance(source, str):
        # Some editors write a byte order mark.
        source = source.removeprefix("\ufeff")
        if re.fullmatch(r"\w+_description", source) and not Path(source).exists():
            source = described(source)
    text, file = read(source)
    root = root_of(text)
    if file is not None and file.suffix.lower() in MESHES and root not in ("robot", "mujoco"):
        hint = "a mesh is the shape of a link: SceneBuilder.link(shape=phipsi.shapes.Mesh(path))"
        raise SceneError(f"source: found {file.name!r}, a mesh; expected {EXPECTED}; {hint}")
    if root == "mujoco" or (file is not None and file.suffix.lower() == ".mjb"):
        _has_no_use(floating_base, "floating_base", source)
        _has_no_use(xacro_arguments, "xacro_arguments", source)
        _has_no_use(mimic, "mimic", source)
        return Scene.from_mujoco(source, **options, ignore=ignore, contacts=contacts)
    _has_no_use(ignore, "ignore", source)
    if gravity is None:
        del options["gravity"]
    options.update(floating_base=floating_base, mimic="couple" if mimic in (True, "couple") else "free")
    with warnings.catch_warnings():
        if mimic is not None:
            # Independent joints were asked for.
            warnings.simplefilter("ignore", MimicWarning)
        if is_xacro(text):
            text = expanded(source, xacro_arguments)
            scene = _of_file(Scene.from_urdf(text, **options), file)
            return scene if contacts is None else with_colliders(scene, text, file, contacts, strict)
        _has_no_use(xacro_arguments, "xacro_arguments", source)
        return Scene.from_urdf(source, **options, contacts=contacts)


def root_of(text: str) -> str:
    """Name of the root element; empty if there is none."""
    found = ROOT.search(COMMENT.sub("", text[:100_000]))
    return found[1] if found else ""


def described(name: str) -> str:
    """Path of the robot description of a module of robot_descriptions."""
    if find_spec("robot_descriptions") is None:
        raise ImportError(f"source: found {name!r}, which is not a file, and no package robot_descriptions; install it with: pip install robot_descriptions")
    logging.getLogger("phipsi").info("fetching %s with robot_descriptions", name)
    try:
        module = importlib.import_module(f"robot_descriptions.{name}")
    except ModuleNotFoundError:
        raise SceneError(f"source: found {name!r}; expected a file, or a module of robot_descriptions") from None
    except Exception as error:  # git raises many types
        raise SceneError(f"source: robot_descriptions cannot fetch {name}: {' '.join(str(error).split())}") from error
    if hasattr(module, "XACRO_PATH") and not hasattr(module, "URDF_PATH"):
        return str(importlib.import_module("robot_descriptions._xacro").get_urdf_path(module))
    for field in ("URDF_PATH", "MJCF_PATH"):
        if hasattr(module, field):
            return str(getattr(module, field))
    raise SceneError(f"source: found the module {name} of robot_descriptions without URDF_PATH, XACRO_PATH and MJCF_PATH; expected one of them")


def _of_file(scene: Scene, file: Path | None) -> Scene:
    """The scene with the path of the file that it was read from."""
    if file is None:
        return scene
    builder = scene.to_builder()
    builder._set_file(file.resolve())
    with warnings.catch_warnings():
        # The reader has already given these warnings.
        warnings.simplefilter("ignore")
        return builder.build()


def _has_no_use(value: Any, argument: str, source: Any) -> None:
    """Raise ArgumentError if an argument is given that does not apply to the source."""
    if value:
        kind = repr(str(source)[:60]) if isinstance(source, str | os.PathLike) else type(source).__name__
        raise ArgumentError(f"{argument}: found {value!r}, which does not apply to {kind}; expected no value: omit {argument}")
