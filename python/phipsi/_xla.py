"""Compiled functions as operations of XLA, which calls them without Python: the C code of their handlers, and their registration with JAX."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from importlib import metadata
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ._batches import Entry
from ._install import command

__all__ = ["Target", "flags", "registered", "source"]

#: States that are computed before their results are checked.
BLOCK = 64
#: The common part of all handlers. An extension of the call frame asks for the version of the interface instead of results.
COMMON = """

#include <stdio.h>
#include "xla/ffi/api/c_api.h"

typedef int xla_run(size_t count, NUMBER *const *at, NUMBER *margins);

static XLA_FFI_Error *xla_failed(const XLA_FFI_CallFrame *call, const char *message) {
    XLA_FFI_Error_Create_Args of = {XLA_FFI_Error_Create_Args_STRUCT_SIZE, NULL, message, XLA_FFI_Error_Code_INVALID_ARGUMENT};
    return call->api->XLA_FFI_Error_Create(&of);
}

static XLA_FFI_Error *xla_serve(XLA_FFI_CallFrame *call, xla_run *run, const char *name, size_t reads, size_t writes, const size_t *widths) {
    const XLA_FFI_Extension_Base *asked = call->extension_start;
    if (asked != NULL && asked->type == XLA_FFI_Extension_Metadata) {
        XLA_FFI_Metadata *told = ((const XLA_FFI_Metadata_Extension *)asked)->metadata;
        told->api_version.major_version = XLA_FFI_API_MAJOR;
        told->api_version.minor_version = XLA_FFI_API_MINOR;
        return NULL;
    }
    const int raises = call->attrs.size == 1 && *(const int32_t *)((const XLA_FFI_Scalar *)call->attrs.attrs[0])->value;
    const XLA_FFI_Buffer *first = call->args.args[0];
    size_t count = 1;
    for (int64_t axis = 0; axis + 1 < first->rank; axis++) count *= (size_t)first->dims[axis];
    NUMBER margins[BLOCK], *at[ARRAYS];
    for (size_t begin = 0; begin < count; begin += BLOCK) {
        const size_t states = count - begin < BLOCK ? count - begin : BLOCK;
        for (size_t i = 0; i < reads + writes; i++) {
            const XLA_FFI_Buffer *array = i < reads ? call->args.args[i] : call->rets.rets[i - reads];
            at[i] = (NUMBER *)array->data + begin * widths[i];
        }
        for (size_t k = 0; k < states; k++) margins[k] = 0;
        int failed = run(states, at, margins);
        for (size_t k = 0; k < states; k++) failed |= !(margins[k] >= 0);
        for (size_t k = 0; failed && k < states; k++) {
            NUMBER *one[ARRAYS];
            for (size_t i = 0; i < reads + writes; i++) one[i] = at[i] + k * widths[i];
            const int is_bad = run(1, one, margins + k);
            if (!is_bad && margins[k] >= 0) continue;
            if (raises) {
                char message[512];
                const char *why = is_bad ? "found a number that is not finite, or a quaternion that is not of unit norm; expected finite arguments, with which the results are finite"
                                         : "found an estimated error above the tolerance; expected less: pass the scene in place of its code, which computes such states in another form";
                snprintf(message, sizeof message, "%s: state %zu: %s; or errors=\\"nan\\"", name, begin + k, why);
                return xla_failed(call, message);
            }
            for (size_t i = reads; i < reads + writes; i++)
                for (size_t j = 0; j < widths[i]; j++) one[i][j] = (NUMBER)NAN;
        }
    }
    return NULL;
}
"""


class Target(NamedTuple):
    """A compiled function as an operation: its name for XLA, the numbers per state of its arguments, and the shapes of its results."""

    name: str
    reads: tuple[int, ...]
    results: tuple[tuple[int, ...], ...]
    dtype: np.dtype[Any]


def _ffi() -> Any:
    try:
        from jax import ffi
    except ImportError as error:
        raise ImportError(f"jax: found no jax.ffi; expected JAX 0.5 or later: {command('jax')}") from error
    return ffi


def flags() -> list[str]:
    """Flags of the compiler for the header of XLA, which JAX brings."""
    return [f"-I{_ffi().include_dir()}"]


def source(handlers: Sequence[Entry], dtype: str) -> str:
    """C code of the handlers, which follows that of the functions. Its first line names the JAX whose header it needs."""
    most = max((len(of.reads) + len(of.results) for of in handlers), default=1)
    number = "double" if dtype == "float64" else "float"
    text = f"\n/* Entrys of XLA, for jaxlib {metadata.version('jaxlib')}. */\n#include <math.h>\n#define NUMBER {number}\n#define BLOCK {BLOCK}\n#define ARRAYS {most}{COMMON}"
    for of in handlers:
        widths = [*of.reads, *map(prod, of.results)]
        at = ", ".join(f"at[{i}]" for i in range(len(widths)))
        also = f" | {of.margin}(count, at[0], margins)" if of.margin else ""
        text += f"""
static int xla_{of.batch}(size_t count, NUMBER *const *at, NUMBER *margins) {{
    (void)margins;
    return {of.batch}(count, {at}{", margins" if of.margin == "" else ""}){also};
}}
XLA_FFI_Error *{handler(of.batch)}(XLA_FFI_CallFrame *call) {{
    static const size_t widths[] = {{{", ".join(map(str, widths))}}};
    return xla_serve(call, xla_{of.batch}, "{of.name}", {len(of.reads)}, {len(of.results)}, widths);
}}
"""
    return text


def handler(batch: str) -> str:
    """The name of the handler of a function of batches."""
    return f"{batch}_xla"


_REGISTERED: set[str] = set()


def registered(code: ctypes.CDLL, library: Path, of: Entry, dtype: np.dtype[Any]) -> Target:
    """The operation of a function of a library, which JAX knows from now on."""
    name = f"phipsi-{library.parent.name}-{of.batch}"
    if name not in _REGISTERED:
        ffi = _ffi()
        ffi.register_ffi_target(name, ffi.pycapsule(getattr(code, handler(of.batch))), platform="cpu")
        _REGISTERED.add(name)
    return Target(name, of.reads, of.results, dtype)
