"""Steps on the configuration manifold, and triangular roots of covariances."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["exponential", "joint_groups", "lower_root"]

_Array = NDArray[np.float64]


def joint_groups(scene: Scene) -> NDArray[np.int_]:
    """First and last degree of freedom of the group of each degree of freedom, (2, nv).

    The degrees of freedom of a spherical or free joint form one group; all others are groups of one.
    """
    groups = np.tile(np.arange(scene.nv), (2, 1))
    for joint in scene.joint_names:
        own = scene.v_index(joint)
        if scene.joints[joint].type in ("spherical", "floating"):
            groups[0, own], groups[1, own] = own.start, own.stop - 1
    return groups


def exponential(groups: NDArray[np.int_], x: _Array) -> tuple[_Array, _Array]:
    """Adjoints of the inverses of steps x on the manifold, and right Jacobians of the steps, (..., nv, nv)."""
    nv = x.shape[-1]
    back, right = (np.broadcast_to(np.eye(nv), (*x.shape, nv)).copy() for _ in range(2))
    for first in np.unique(groups[0]):
        last = int(groups[1][first])
        if last == first:
            continue
        own = slice(int(first), last + 1)
        minus = -_bracket(x[..., own])
        term, ad, jacobian = (np.broadcast_to(np.eye(last + 1 - int(first)), minus.shape).copy() for _ in range(3))
        for k in range(1, 100):
            term = term @ minus / k
            ad += term
            jacobian += term / (k + 1)
            if not np.any(np.abs(term) > 1e-17):
                break
        back[..., own, own], right[..., own, own] = ad, jacobian
    return back, right


def _bracket(x: _Array) -> _Array:
    """Matrix ad of a rotation vector, (..., 3), or of a twist (linear, angular), (..., 6)."""

    def skew(a: _Array) -> _Array:
        out = np.zeros((*a.shape, 3))
        out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -a[..., 2], a[..., 1], -a[..., 0]
        return out - np.swapaxes(out, -1, -2)

    if x.shape[-1] == 3:
        return skew(x)
    out = np.zeros((*x.shape, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = skew(x[..., 3:])
    out[..., :3, 3:] = skew(x[..., :3])
    return out


def lower_root(matrix: _Array) -> _Array:
    """Square lower triangular root of matrix @ matrix*, by an orthogonal transformation from the right."""
    rows = matrix.shape[-2]
    triangle = np.swapaxes(np.linalg.qr(np.swapaxes(matrix, -1, -2), mode="r"), -1, -2)
    if triangle.shape[-1] < rows:
        triangle = np.concatenate([triangle, np.zeros((*triangle.shape[:-1], rows - triangle.shape[-1]))], axis=-1)
    return np.asarray(triangle)
