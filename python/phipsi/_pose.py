"""Poses as homogeneous matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arguments import vectors
from ._coordinates import rotation
from .errors import ArgumentError, NotFiniteError, ShapeError, of_argument

__all__ = ["pose"]

#: Largest deviation of the norm of a quaternion from 1.
LARGEST_DEVIATION = 1e-3


def pose(xyz: ArrayLike = (0.0, 0.0, 0.0), *, rpy: ArrayLike | None = None, quat: ArrayLike | None = None) -> NDArray[np.float64]:
    """Homogeneous matrix of a position and an orientation, for instance the target of phipsi.tasks.Pose.

    Parameters
    ----------
    xyz : array_like, (..., 3)
        Position of the origin, m.
    rpy : array_like, (..., 3), optional
        Roll, pitch and yaw, rad, as in a URDF: the rotation Rz(yaw) Ry(pitch) Rx(roll).
    quat : array_like, (..., 4), optional
        Quaternion (x, y, z, w), instead of rpy. It is normalized if its norm differs from 1 by at most 1e-3.

    Returns
    -------
    array
        Poses, (..., 4, 4). Without rpy and quat the rotation is the identity.

    Raises
    ------
    ShapeError, NotFiniteError
        If an argument has a wrong shape, or is not finite.
    ArgumentError
        If both rpy and quat are given, or the norm of a quaternion is not 1.

    Examples
    --------
    >>> import phipsi
    >>> phipsi.pose((0.5, 0.0, 0.4), rpy=(0.0, 0.0, 3.0)).shape
    (4, 4)
    >>> bool((phipsi.pose(quat=(0, 0, 0, 1)) == phipsi.pose()).all())
    True
    """
    if rpy is not None and quat is not None:
        raise of_argument(ArgumentError, "quat", "found rpy and quat; expected one of them")
    place = _finite("xyz", vectors("xyz", xyz, 3))
    if quat is not None:
        of = _finite("quat", vectors("quat", quat, 4))
        norm = np.linalg.norm(of, axis=-1)
        if not np.all(np.abs(norm - 1.0) <= LARGEST_DEVIATION):
            worst = float(np.ravel(norm)[np.argmax(np.abs(norm - 1.0))])
            raise of_argument(ArgumentError, "quat", f"found norm {worst:.6g}; expected 1: divide the quaternion (x, y, z, w) by its norm")
        turn = rotation(of)
    else:
        turn = from_rpy(np.zeros(3) if rpy is None else _finite("rpy", vectors("rpy", rpy, 3)))
    try:
        batch = np.broadcast_shapes(place.shape[:-1], turn.shape[:-2])
    except ValueError:
        name = "rpy" if quat is None else "quat"
        raise of_argument(ShapeError, name, f"found leading axes {turn.shape[:-2]}; expected ones that broadcast with {place.shape[:-1]} of xyz") from None
    found = np.zeros((*batch, 4, 4))
    found[..., :3, :3], found[..., :3, 3], found[..., 3, 3] = turn, place, 1.0
    return found


def from_rpy(rpy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrix Rz(yaw) Ry(pitch) Rx(roll), (..., 3) to (..., 3, 3)."""
    (a, b, c), (d, e, f) = np.moveaxis(np.cos(rpy), -1, 0), np.moveaxis(np.sin(rpy), -1, 0)
    rows = [[c * b, c * e * d - f * a, c * e * a + f * d], [f * b, f * e * d + c * a, f * e * a - c * d], [-e, b * d, b * a]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def angles(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Roll, pitch and yaw of Rz(yaw) Ry(pitch) Rx(roll), rad; the yaw is zero if the pitch is a right angle."""
    level = np.hypot(rotation[0, 0], rotation[1, 0])
    pitch = np.arctan2(-rotation[2, 0], level)
    if level < 1e-15:
        return np.array([np.arctan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0])
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    # Near a right angle the roll is inaccurate; the yaw of what it leaves compensates for its error.
    across, along = rotation[:2, 1:] @ [np.cos(roll), -np.sin(roll)]
    return np.array([roll, pitch, np.arctan2(-across, along)])


def _finite(name: str, value: NDArray[np.float64]) -> NDArray[np.float64]:
    if not np.isfinite(value).all():
        raise of_argument(NotFiniteError, name, f"found {value.tolist()}; expected finite numbers")
    return value
