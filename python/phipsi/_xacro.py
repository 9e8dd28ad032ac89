"""Expansion of xacro files to URDF: their arguments, and the packages that they refer to."""

from __future__ import annotations

import difflib
import importlib
import os
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from .errors import ArgumentError, MeshWarning, SceneError, warn

COMMENT = re.compile("<!--.*?-->", re.DOTALL)
#: Name of a declared argument.
DECLARED = re.compile(r"""<xacro:arg\b[^>]*?\bname\s*=\s*["']([^"']+)["']""")
#: A macro: attributes, in which a value may contain ">", and body.
MACRO = re.compile(r"""<xacro:macro\b((?:[^>"']|"[^"]*"|'[^']*')*)>(.*?)</xacro:macro>""", re.DOTALL)
ATTRIBUTE = re.compile(r"""\b(name|params)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
#: Parameters of a macro: names, with an expression as default.
PARAMETER = re.compile(r"""(\*{0,2}[\w.-]+)(?::?=(?:'[^']*'|"[^"]*"|\^\|?|\$\{[^}]*\}|\S)*)?""")
#: Largest number of macros in a message.
LISTED = 6
#: The name of a package, in its package.xml.
PACKAGE = re.compile(r"<name>\s*([^<]*?)\s*</name>")
#: The environment variables that list folders of packages.
SEARCHED = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
#: The arguments that files were expanded with, for their shapes; None if they were expanded with different ones.
_arguments: dict[Path, dict[str, str] | None] = {}
#: xacro stores its state in global variables.
_one_at_a_time = threading.Lock()


def is_xacro(text: str) -> bool:
    """Whether a text contains xacro elements; expanded files may contain the namespace only."""
    return "<xacro:" in COMMENT.sub("", text)


def expanded(source: str | os.PathLike[str], arguments: Mapping[str, str] | None = None) -> str:
    """URDF of a xacro file or text."""
    try:
        import xacro
    except ImportError:
        raise ImportError("source: found a xacro and no package xacro; install it with: pip install xacro") from None
    given = _Arguments({name: str(value) for name, value in (arguments or {}).items()})
    file = None if isinstance(source, str) and source.lstrip().startswith("<") else Path(source)
    failed: Exception | None = None
    with _one_at_a_time, _finding(file):
        xacro.all_includes.clear()
        try:
            if file is None:
                xacro.init_stacks(None)
                document = xacro.parse(source)
                xacro.process_doc(document, mappings=given)
            else:
                document = xacro.process_file(os.fspath(file), mappings=given)
        except Exception as error:  # xacro raises exceptions of any type
            failed = error
        texts = (
            [str(source)]
            if file is None
            else [path.read_text(encoding="utf-8", errors="replace") for path in map(Path, (file, *xacro.all_includes)) if path.is_file()]
        )
    known = given.asked.union(*(DECLARED.findall(COMMENT.sub("", text)) for text in texts))
    for name in arguments or {}:
        # After an error, files may be missing that declare more arguments.
        if name not in known and (failed is None or difflib.get_close_matches(name, known, 1, 0.8)):
            raise ArgumentError(
                f"xacro_arguments: found {name!r}, which the file does not have; {_closest(name, known)}"
            )
    if failed is not None:
        _raise_of(failed, given.missing)
    if not document.getElementsByTagName("link"):
        _refuse_macros(texts)
    if file is not None:
        used = {name: str(value) for name, value in (arguments or {}).items()}
        _arguments[file.resolve()] = used if _arguments.setdefault(file.resolve(), used) == used else None
    return str(document.toxml())


def _refuse_macros(texts: list[str]) -> None:
    """Raise SceneError for a xacro without links if it defines macros: those of the file, which no other macro calls, come first."""
    found: dict[str, str] = {}
    bodies = ""
    for text in texts:
        for attributes, body in MACRO.findall(COMMENT.sub("", text)):
            given = {name: one or other for name, one, other in ATTRIBUTE.findall(attributes)}
            if "name" in given:
                # Older files name a macro with its prefix.
                found.setdefault(given["name"].removeprefix("xacro:"), given.get("params", ""))
            bodies += body
    if not found:
        return
    called = set(re.findall(r"<xacro:([\w.-]+)", bodies))
    names = [name for name in found if name not in called] or list(found)
    shown = [f"{name}({', '.join(_parameters(found[name]))})" for name in names[:LISTED]]
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    raise SceneError(
        f"source: found a xacro that defines macros and no links; expected a file that includes it and calls one of them,"
        f" as <xacro:{names[0]} .../>: {'; '.join(shown)}{more}"
    )


def _parameters(text: str) -> list[str]:
    """Names of the parameters of a macro, with ... for those that have a default."""
    return [f"{match[1]}=..." if "=" in match[0] else match[1] for match in PARAMETER.finditer(text)]


def expanded_again(file: Path, text: str) -> str | None:
    """URDF of the file of a scene, for its shapes; None, with a MeshWarning, for a xacro with unknown arguments."""
    if not is_xacro(text):
        return text
    arguments = _arguments.get(file.resolve(), {})
    if arguments is None:
        reason = "it was read with different arguments"
    else:
        try:
            return expanded(file, arguments)
        except (SceneError, ArgumentError, ImportError) as error:
            reason = "it needs arguments" if isinstance(error, ArgumentError) else str(error).removeprefix("source: ")
    warn(
        f"shapes of the xacro {file.name!r} are omitted, because it cannot be expanded again: {reason}",
        MeshWarning,
    )
    return None


class _Arguments(dict[str, str]):
    """Values of arguments, and the names that xacro has requested."""

    def __init__(self, values: Mapping[str, str]) -> None:
        super().__init__(values)
        self.asked: set[str] = set()
        self.missing: str | None = None

    def __contains__(self, name: object) -> bool:
        self.asked.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.asked.add(name)
        return super().__getitem__(name)

    def __missing__(self, name: str) -> str:
        self.missing = name
        raise KeyError(name)


def _closest(name: str, known: set[str]) -> str:
    if not known:
        return "expected none: it has no <xacro:arg>"
    like = difflib.get_close_matches(name, known, 1, 0.4)
    return f"expected {like[0]!r}?" if like else f"expected names of {', '.join(map(repr, sorted(known)))}"


def _raise_of(error: Exception, missing: str | None) -> NoReturn:
    """Raise the error of phipsi for an exception of xacro; causes of XacroException are in its attribute exc."""
    if missing is not None:
        raise ArgumentError(
            f"xacro_arguments: found none for {missing!r}, which the file needs; "
            f"expected xacro_arguments={{{missing!r}: ...}}"
        ) from None
    causes: list[BaseException] = [error]
    while (cause := getattr(causes[-1], "exc", None) or causes[-1].__cause__) is not None and cause not in causes:
        causes.append(cause)
    for cause in causes:
        if isinstance(cause, _NoPackage):
            raise SceneError(f"source: {cause}") from None
    raise SceneError(
        f"source: xacro cannot expand it: {type(error).__name__}: {' '.join(str(error).split())}"
    ) from None


class _NoPackage(Exception):
    """A package that is not found."""


@contextmanager
def _finding(file: Path | None) -> Iterator[None]:
    """Resolve $(find package) in folders before ROS does."""
    try:
        substitution: Any = importlib.import_module("xacro.substitution_args")
    except ImportError:  # xacro of ROS 1 resolves packages differently
        yield
        return
    by_ros: Callable[[str], str] = substitution._eval_find

    def find(package: str) -> str:
        if (folder := _package(package, file)) is not None:
            return str(folder)
        try:
            return by_ros(package)
        except Exception:  # ImportError without ROS, otherwise an exception of ROS
            where = "above or beside the file" if file is not None else "anywhere, as the source is text"
            variables = " or ".join(SEARCHED)
            raise _NoPackage(
                f"found $(find {package}), and no folder {package!r} {where}; "
                f"expected the folder that contains it in the environment variable {variables}"
            ) from None

    substitution._eval_find = substitution._eval_dict["find"] = find
    try:
        yield
    finally:
        substitution._eval_find = substitution._eval_dict["find"] = by_ros


def _package(name: str, file: Path | None) -> Path | None:
    """Folder of a package: above or beside a file, or in the folders of the environment variables."""
    above = list(file.resolve().parents) if file is not None else []
    for folder in above:
        if _is_package(folder, name):
            return folder
    listed = [
        Path(folder) for variable in SEARCHED for folder in os.environ.get(variable, "").split(os.pathsep) if folder
    ]
    for folder in (*listed, *above):
        for candidate in (folder, folder / name, folder / "share" / name):
            if _is_package(candidate, name) and candidate.is_dir():
                return candidate
    return None


def _is_package(folder: Path, name: str) -> bool:
    """Whether a folder has the name, or contains a package.xml with the name."""
    manifest = folder / "package.xml"
    if manifest.is_file() and (found := PACKAGE.search(manifest.read_text(encoding="utf-8", errors="replace"))):
        return found[1] == name
    return folder.name == name
