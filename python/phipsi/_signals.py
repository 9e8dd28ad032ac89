"""Exceptions that signal handlers raise."""

from __future__ import annotations

import signal
from types import CodeType
from typing import Any

__all__ = ["by_handler"]


def by_handler(error: BaseException) -> bool:
    """Whether a signal handler raised the exception, for instance within a function that a simulation calls.

    Python runs handlers between any two instructions, so that only the frames of the exception distinguish them from
    errors of the function.
    """
    codes = {_code(signal.getsignal(number)) for number in signal.valid_signals()} - {None}
    frames = error.__traceback__
    while frames is not None:
        if frames.tb_frame.f_code in codes:
            return True
        frames = frames.tb_next
    return False


def _code(handler: Any) -> CodeType | None:
    """Code of a handler written in Python: a function, a method, a partial function or an object with __call__."""
    handler = getattr(handler, "func", handler)
    code = getattr(handler, "__code__", None) or getattr(getattr(type(handler), "__call__", None), "__code__", None)
    return code if isinstance(code, CodeType) else None
