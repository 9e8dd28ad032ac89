"""Files: texts of and into files, and the files of meshes."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from .errors import ArgumentError, SceneError, of_argument

__all__ = ["EXPECTED", "SEARCHED", "find", "read", "write"]

#: Variables with folders for `package://` and `model://`, in addition to the folders above the URDF.
SEARCHED = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "GZ_SIM_RESOURCE_PATH")


#: Sources of scenes.
EXPECTED = "a path or text of URDF, xacro or MJCF, a module name of robot_descriptions, or a model of MuJoCo or Pinocchio"


def read(source: str | os.PathLike[str]) -> tuple[str, Path | None]:
    """Text of a source, and its path if it is a file. Undecodable bytes are replaced: only elements are read from it."""
    if isinstance(source, str) and source.lstrip().startswith("<"):
        return source, None
    file = Path(source)
    try:
        return file.read_text(encoding="utf-8", errors="replace"), file
    except OSError as error:
        raise SceneError(f"source: found {str(source)[:100]!r}, which cannot be read ({error.strerror}); expected {EXPECTED}") from None


def write(directory: str | os.PathLike[str], files: Mapping[str, str]) -> None:
    """Write texts by the names of their files into a directory, which is created if it does not exist.

    The name of a file is refused, because a directory of that name would be created.
    """
    into = Path(directory)
    known = {Path(name).suffix for name in files} - {""}
    if into.suffix in known and not into.is_dir():
        expected = f"a directory for the files {', '.join(files)}: {str(into.parent)!r} with name={into.stem!r}"
        raise of_argument(ArgumentError, "directory", f"found {str(into)!r}, the name of a file; expected {expected}")
    into.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (into / name).parent.mkdir(parents=True, exist_ok=True)
        (into / name).write_text(text, encoding="utf-8")


def find(name: str, urdf: Path) -> Path:
    """File of a mesh: an absolute path, a path relative to the URDF, or in a package above it or in a folder of the
    environment variables.
    """
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
    # The robot may be outside of its package.
    candidates += [folder / inside for folder in list(above)[:3]]
    for file in candidates:
        if file.is_file():
            return file
    raise FileNotFoundError(f"no file {name!r}")
