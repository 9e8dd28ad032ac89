"""Populations of models: samples of the parameters of a scene that a physical robot can have."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._arguments import whole
from ..errors import ArgumentError, of_argument
from ._bodies import to_moments, to_parameters

if TYPE_CHECKING:
    from .._core import Scene
    from .uncertainty import ParameterCovariance

__all__ = ["sample"]

_Array = NDArray[np.float64]

#: A smaller eigenvalue relative to the largest is a rounding error of zero.
LEAST = 1e-12


def sample(covariance: ParameterCovariance, scene: Scene, number: int, rng: np.random.Generator) -> dict[str, _Array]:
    """Keywords of Scene.simulate with `number` models of these mean and covariance."""
    number = whole("n", number, 1)
    columns = covariance.columns
    errors = rng.normal(size=(number, len(columns)))
    models = {"inertias": _inertias(scene, np.tensordot(errors, columns, 1))}
    of_joints = np.tensordot(errors, covariance._joints(scene.nv), 1)
    for at, name in enumerate(("armature", "damping", "friction", "offset")):
        change, mean = of_joints[..., at], getattr(scene, name, np.zeros(scene.nv))
        if not change.any():
            continue
        if name == "offset":
            text = "found uncertain offsets of friction; expected armature, damping and friction of joints, or the covariance"
            raise of_argument(ArgumentError, "parameters", f"{text} of the bodies alone (Identification.covariance)")
        positive = np.where(mean > 0.0, mean, 1.0)
        models[name] = np.where(mean > 0.0, mean * _factor(change / positive), np.maximum(mean + change, 0.0))
    return models


def _inertias(scene: Scene, change: _Array) -> _Array:
    """Inertial parameters, (number, bodies, 10): those of J^(1/2) f(J^(-1/2) dJ J^(-1/2)) J^(1/2) of the second moments
    of mass J of the bodies and their changes dJ, which are positive definite and J + dJ to first order.
    """
    mean = np.array(scene.inertial_parameters)
    found = np.repeat(mean[None], len(change), axis=0)
    for body, name in enumerate(scene.body_names):
        moved = change[:, body]
        if not moved.any():
            continue
        values, vectors = np.linalg.eigh(to_moments(mean[body]))
        if not values[0] > LEAST * values[-1]:
            text = f"found an uncertain inertia of {name!r} on the bound of what a rigid body can have"
            raise of_argument(ArgumentError, "parameters", f"{text}; expected one inside of it, or no covariance for it")
        root = (vectors * np.sqrt(values)) @ vectors.T
        inverse = (vectors / np.sqrt(values)) @ vectors.T
        relative, axes = np.linalg.eigh(inverse @ to_moments(moved) @ inverse)
        found[:, body] = to_parameters(root @ (axes * _factor(relative)[:, None, :]) @ np.swapaxes(axes, -1, -2) @ root)
    return found


def _factor(change: _Array) -> _Array:
    """The positive factor of a relative change: change + sqrt(1 + change^2), without cancellation."""
    most = np.abs(change) + np.sqrt(1.0 + change**2)
    return np.where(change >= 0.0, most, 1.0 / most)
