"""Dry friction of the joints of a scene, with the terms of SceneBuilder.joint beside Coulomb friction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import ArgumentError, of_argument

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["TERMS", "check_coulomb", "opposing", "transmitted"]

_Array = NDArray[np.float64]

#: Arguments of SceneBuilder.joint, in the order of Scene.friction_terms.
TERMS = ("friction_offset", "stribeck", "stribeck_speed", "load_friction")


def check_coulomb(scene: Scene, function: str) -> None:
    """Raise ArgumentError if the scene has friction that `function` does not represent."""
    torques = {name: values for name, values in zip(TERMS, scene.friction_terms, strict=True) if name != "stribeck_speed"}
    for name, values in torques.items():
        if values.any():
            joint = next(joint for joint in scene.joint_names if values[scene.v_index(joint)].any())
            zero = ", ".join(f"{term}=0" for term in torques)
            raise of_argument(ArgumentError, function, f"found {name} at the joint {joint!r}; expected Coulomb friction alone: use scene.with_properties({zero})")


def opposing(
    scene: Scene,
    v: _Array,
    direction: _Array,
    load: _Array | None = None,
    coulomb: ArrayLike | None = None,
    terms: _Array | None = None,
) -> _Array:
    """Friction that opposes the motion, (..., nv), for directions from -1 to 1, and the torques that reach the bodies;
    None: without the friction by load. Coulomb friction and the other terms are those of the scene if not given.
    """
    offset, stribeck, speed, share = scene.friction_terms if terms is None else terms
    dry = (scene.friction if coulomb is None else coulomb) + stribeck * np.exp(-((v / speed) ** 2))
    by_load = 0.0 if load is None or not share.any() else share * np.abs(load)
    return np.asarray(offset + direction * (dry + by_load))


def transmitted(scene: Scene, u: _Array, v: _Array, direction: _Array, coulomb: ArrayLike | None = None) -> _Array:
    """Torques that reach the bodies, (..., nv), beside all other joint torques u."""
    w = u - opposing(scene, v, direction, coulomb=coulomb)
    return np.asarray(w / (1.0 + direction * scene.friction_terms[3] * np.sign(w)))
