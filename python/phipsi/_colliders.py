"""Checks of single shapes, for readers of files that omit the shapes that a scene cannot have."""

from __future__ import annotations

from ._core import SceneBuilder
from .errors import PhipsiError
from .shapes import ColliderShape


def fault(shape: ColliderShape) -> str | None:
    """Description of the fault in the shape of a collider; None for a valid shape."""
    try:
        SceneBuilder().link("base").collider("shape", shape).build()
    except PhipsiError as error:
        return str(error).partition("found ")[2].partition("; expected")[0] or str(error)
    return None
