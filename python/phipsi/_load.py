"""Scenes of whatever a robot comes as: one call that looks what it is."""

from __future__ import annotations

import importlib
import os
import re
import warnings
from collections.abc import Collection, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ._core import Scene
from ._xacro import COMMENT, expanded, is_xacro
from .errors import ArgumentError, SceneError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

#: The root element of a file.
ROOT = re.compile(r"<\s*([A-Za-z_][\w:.-]*)")
EXPECTED = "a path of URDF, xacro or MJCF, such a text, a name of robot_descriptions, or a model of MuJoCo or Pinocchio"


def load(
    source: Any,
    *,
    floating_base: bool = False,
    gravity: ArrayLike | None = None,
    strict: bool = False,
    leave_out: Collection[Any] | None = None,
    xacro_arguments: Mapping[str, str] | None = None,
    mimic: Literal["couple", "free"] = "free",
    ignore: Collection[Any] = (),
) -> Scene:
    """The scene of a robot, whatever it comes as.

    source: the path or the text of a URDF, a xacro (needs the package xacro) or a MuJoCo model (needs mujoco); the name of a module of
    robot_descriptions, as "ur5e_description", where that package is there; or mujoco.MjModel, mujoco.MjSpec, pinocchio.Model.
    floating_base: puts a free joint under the root link of a URDF; models of MuJoCo and Pinocchio say themselves what floats.
    gravity: (3,), m/s^2; None: (0, 0, -9.81), or what the model says. strict, leave_out: as in Scene.from_urdf.
    xacro_arguments: values of the file's <xacro:arg>. mimic: whether joints of a URDF with <mimic> follow, as in Scene.from_urdf. ignore: parts of a MuJoCo
    model to omit, as in Scene.from_mujoco.

    $(find package) of a xacro is the folder of that name, or the one whose package.xml has it, above or beside the file or in a folder of ROS_PACKAGE_PATH or
    AMENT_PREFIX_PATH; then it is looked up as ROS does.

    Raises as Scene.from_urdf, Scene.from_mujoco and Scene.from_pinocchio do; ImportError where a package is missing; ArgumentError for a source that is none of
    these, for arguments that the source has no use for, and for xacro_arguments that the file does not have or that it needs and that are missing.
    """
    options: dict[str, Any] = {"gravity": gravity, "strict": strict, "leave_out": leave_out}
    package = type(source).__module__.partition(".")[0]
    if package in ("mujoco", "pinocchio"):
        _has_no_use(floating_base, "floating_base", source)
        _has_no_use(xacro_arguments, "xacro_arguments", source)
        _has_no_use(mimic != "free", "mimic", source)
        if package == "mujoco":
            return Scene.from_mujoco(source, **options, ignore=ignore)
        _has_no_use(ignore, "ignore", source)
        return Scene.from_pinocchio(source, **options)
    if not isinstance(source, str | os.PathLike):
        raise ArgumentError(f"source: found {type(source).__name__}; expected {EXPECTED}")
    if isinstance(source, str) and re.fullmatch(r"\w+_description", source) and not Path(source).exists():
        source = described(source)
    text, file = read(source)
    root = root_of(text)
    if root == "mujoco" or (file is not None and file.suffix == ".mjb"):
        _has_no_use(floating_base, "floating_base", source)
        _has_no_use(xacro_arguments, "xacro_arguments", source)
        _has_no_use(mimic != "free", "mimic", source)
        return Scene.from_mujoco(source, **options, ignore=ignore)
    _has_no_use(ignore, "ignore", source)
    if gravity is None:
        del options["gravity"]
    options.update(floating_base=floating_base, mimic=mimic)
    if is_xacro(text):
        return _of_file(Scene.from_urdf(expanded(source, xacro_arguments), **options), file)
    _has_no_use(xacro_arguments, "xacro_arguments", source)
    return Scene.from_urdf(source, **options)


def read(source: str | os.PathLike[str]) -> tuple[str, Path | None]:
    """The text of a source, and its file, if it is one; bytes that are no text are replaced: only the root is looked at here."""
    if isinstance(source, str) and source.lstrip().startswith("<"):
        return source, None
    file = Path(source)
    try:
        return file.read_text(encoding="utf-8", errors="replace"), file
    except OSError as error:
        raise SceneError(f"source: found {str(source)[:100]!r}, which cannot be read ({error.strerror}); expected {EXPECTED}") from None


def root_of(text: str) -> str:
    """Name of the root element; empty where there is none."""
    found = ROOT.search(COMMENT.sub("", text[:100_000]))
    return found[1] if found else ""


def described(name: str) -> str:
    """The file of a module of robot_descriptions."""
    if find_spec("robot_descriptions") is None:
        raise ImportError(f"{name}: found no such file and no package robot_descriptions; install it with: pip install robot_descriptions")
    try:
        module = importlib.import_module(f"robot_descriptions.{name}")
    except ModuleNotFoundError:
        raise SceneError(f"source: found {name!r}; expected a file, or a module of robot_descriptions, which has none of that name") from None
    except Exception as error:  # whatever git says
        raise SceneError(f"source: robot_descriptions cannot fetch {name}: {' '.join(str(error).split())}") from error
    if hasattr(module, "XACRO_PATH") and not hasattr(module, "URDF_PATH"):
        return str(importlib.import_module("robot_descriptions._xacro").get_urdf_path(module))
    for field in ("URDF_PATH", "MJCF_PATH"):
        if hasattr(module, field):
            return str(getattr(module, field))
    raise SceneError(f"source: found the module {name} of robot_descriptions without URDF_PATH, XACRO_PATH and MJCF_PATH; expected one of them")


def _of_file(scene: Scene, file: Path | None) -> Scene:
    """The scene, knowing the file that it was read from."""
    if file is None:
        return scene
    builder = scene.to_builder()
    builder._set_file(file.resolve())
    with warnings.catch_warnings():
        # They were given when it was read.
        warnings.simplefilter("ignore")
        return builder.build()


def _has_no_use(value: Any, argument: str, source: Any) -> None:
    if value:
        kind = repr(str(source)[:60]) if isinstance(source, str | os.PathLike) else type(source).__name__
        raise ArgumentError(f"{argument}: found {value!r} for {kind}, which has no use for it; expected it to be left out")
