"""Texts into files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

__all__ = ["write"]


def write(directory: str | os.PathLike[str], files: Mapping[str, str]) -> None:
    """Writes texts by the names of their files into a directory, which is made where it is not there."""
    into = Path(directory)
    into.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (into / name).parent.mkdir(parents=True, exist_ok=True)
        (into / name).write_text(text, encoding="utf-8")
