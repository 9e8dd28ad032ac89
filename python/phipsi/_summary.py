"""Short texts of results: shapes, counts and largest errors in place of arrays."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

__all__ = ["short", "summarized"]

C = TypeVar("C", bound=type)
#: Names that a text lists.
MOST = 8
#: Units of numbers, where a name stands for one.
UNITS = {"position_error": " m", "rotation_error": " rad", "kinetic": " J", "potential": " J"}


def summarized(kind: C) -> C:
    """Decorator of a class of results whose repr is `short`."""
    kind.__repr__ = short  # type: ignore[assignment]
    return kind


def short(result: Any) -> str:
    """Each field: its shape; how many entries hold; the largest error."""
    values: dict[str, Any] = vars(result) if not hasattr(result, "_asdict") else result._asdict()
    fields = (f"{name} {_text(name, value)}" for name, value in values.items() if value is not None)
    return f"<phipsi.{type(result).__name__}: {', '.join(fields)}>"


def _text(name: str, value: Any) -> str:
    if hasattr(value, "_fields"):
        return type(value).__name__
    if isinstance(value, dict | tuple):
        names = [str(one) for one in value][:MOST] if isinstance(value, dict) else []
        return f"{{{', '.join(names)}{', ...' * (len(value) > MOST)}}}" if names or not value else f"of {len(value)}"
    value = value[()] if isinstance(value, np.ndarray) and not value.ndim else value
    if not isinstance(value, np.ndarray):  # also arrays of JAX and PyTorch, whose values need not be known
        shape = getattr(value, "shape", ())
        return str(tuple(shape)) if shape else f"{value:.3g}{UNITS.get(name, '')}" if isinstance(value, float | np.floating) else str(value)
    if value.dtype.kind == "b":
        return f"{np.count_nonzero(value)} of {value.size}"
    if value.dtype.kind in "UT":
        return " and ".join(f"{count} {one}" for one, count in zip(*np.unique(value, return_counts=True), strict=True))
    is_finite = value.dtype.kind != "f" or not np.isnan(value).any()
    if is_finite and value.size and ("error" in name or "residual" in name):
        return f"up to {value.max():.2g}{UNITS.get(name, '')}"
    return f"{value.shape}{'' if is_finite else ' with NaN'}"
