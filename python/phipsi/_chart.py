"""Rotations by a vector w, |w| < 2 pi: exp(w), the time derivative of w for an angular velocity u in the body frame, and
derivatives.

With W the matrix of w x, t = |w|,

    exp(w) = 1 + sin(t)/t W + (1 - cos t)/t^2 W^2
    dw/dt = B(w) u,       B(w) = 1 + W/2 + c W^2,      c = (1 - (t/2) cot(t/2)) / t^2
    exp(w + d) = exp(w) exp(J(w) d) to first order,    J(w) = B(w)^-1 = 1 - (1 - cos t)/t^2 W + (t - sin t)/t^3 W^2
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "by_quaternion",
    "by_vector",
    "by_vector_derivative",
    "carried_back",
    "carried_back_derivative",
    "carried_back_matrix",
    "rotation",
    "skew",
    "tangent",
]

_Array = NDArray[np.float64]

#: Angle, rad, below which series are used; their omitted terms are below the rounding error.
SMALL = 0.05


def _rotated(w: _Array, u: _Array, once: Any, twice: Any) -> _Array:
    """u + once w x u + twice w x (w x u)."""
    product = np.cross(w, u)
    return np.asarray(u + once * product + twice * np.cross(w, product))


def _second(t: _Array) -> _Array:
    """Coefficient c of an angle."""
    small = t < SMALL
    half = np.where(small, 0.5, 0.5 * t)
    series = 1 / 12 + t**2 / 720 + t**4 / 30240
    return np.where(small, series, (1 - half / np.tan(half)) / np.where(small, 1.0, t) ** 2)


def carried_back(w: _Array, u: _Array) -> _Array:
    """B(w) u: time derivative of the rotation vector w for the angular velocity u in the body frame; (..., 3)."""
    t = np.linalg.norm(w, axis=-1, keepdims=True)
    return _rotated(w, u, 0.5, _second(t))


def by_vector(w: _Array, u: _Array) -> _Array:
    """exp(w) u; (..., 3)."""
    t = np.linalg.norm(w, axis=-1, keepdims=True)
    return _rotated(w, u, np.sinc(t / np.pi), 0.5 * np.sinc(0.5 * t / np.pi) ** 2)


def by_quaternion(quaternion: _Array, u: _Array, sign: float = 1.0) -> _Array:
    """u rotated by a quaternion (x, y, z, w) of any norm, or rotated back with the sign -1; (..., 3)."""
    unit = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return _rotated(unit[..., :3], u, 2.0 * sign * unit[..., 3:], 2.0)


def skew(w: _Array) -> _Array:
    """Matrix of the cross product w x, (..., 3) to (..., 3, 3)."""
    x, y, z = np.moveaxis(w, -1, 0)
    o = np.zeros_like(x)
    return np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)


def rotation(w: _Array) -> _Array:
    """exp(w), (3, 3)."""
    return by_vector(w, np.eye(3)).T


def carried_back_matrix(w: _Array) -> _Array:
    """B(w), (3, 3)."""
    return carried_back(w, np.eye(3)).T


def tangent(w: _Array) -> _Array:
    """J(w), (3, 3): derivative of the rotation exp(w) with respect to w, as a rotation vector in the rotated frame."""
    t = np.linalg.norm(w)
    twice = 1 / 6 - t**2 / 120 + t**4 / 5040 if t < SMALL else (1 - np.sinc(t / np.pi)) / t**2
    return _rotated(w, np.eye(3), -0.5 * np.sinc(0.5 * t / np.pi) ** 2, twice).T


def carried_back_derivative(w: _Array, u: _Array) -> _Array:
    """d(B(w) u)/dw = -U/2 - c (X + W U) + c'/t (w x (w x u)) w*, (3, 3); U and X are the matrices of u x and (w x u)
    x.
    """
    t = float(np.linalg.norm(w))
    c = float(_second(np.asarray(t)))
    if t < SMALL:
        slope = 1 / 360 + t**2 / 7560 + t**4 / 201600
    else:
        half = 0.5 * t
        slope = ((half / np.sin(half) ** 2 - 1 / np.tan(half)) / (2 * t) - 2 * c) / t**2
    product, turn = np.cross(w, u), skew(u)
    through = skew(product) + skew(w) @ turn
    return np.asarray(-0.5 * turn - c * through + slope * np.outer(np.cross(w, product), w))


def by_vector_derivative(w: _Array, u: _Array) -> _Array:
    """d(exp(w) u)/dw = -exp(w) U J(w), (3, 3); U is the matrix of u x."""
    return -rotation(w) @ skew(u) @ tangent(w)
