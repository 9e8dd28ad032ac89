"""Checks of single shapes, and of the argument of the readers of files that omit the shapes that a scene cannot have."""

from __future__ import annotations

import re
from typing import Any

from ._core import SceneBuilder
from .errors import ArgumentError, PhipsiError, of_argument
from .shapes import ColliderShape


def fault(shape: ColliderShape) -> str | None:
    """Description of the fault in the shape of a collider; None for a valid shape."""
    try:
        SceneBuilder().link("base").collider("shape", shape).build()
    except PhipsiError as error:
        return re.sub(r'^(shape of )?collider "shape": (found )?', "", str(error)).partition("; expected")[0]
    return None


def check_contacts(contacts: Any) -> None:
    """Raise ArgumentError unless contacts is "all", "plane" or None."""
    if contacts not in (None, "all", "plane"):
        raise of_argument(ArgumentError, "contacts", f'found {contacts!r}; expected "all", "plane" or None')
