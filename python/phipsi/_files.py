"""Texts into files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from .errors import ArgumentError, of_argument

__all__ = ["write"]


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
