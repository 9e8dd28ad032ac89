"""What both kinds of compiled robots have: names of functions, and the methods."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeAlias, TypeVar, get_args

import numpy as np

from ._results import (
    ForwardDynamicsDerivatives,
    ForwardDynamicsGradients,
    InverseDynamicsDerivatives,
    InverseDynamicsGradients,
)
from .errors import ArgumentError, of_argument

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["FUNCTIONS", "Function", "Functions"]

A = TypeVar("A")
_Results = TypeVar("_Results")
_OfScene = Literal[
    "forward_dynamics",
    "inverse_dynamics",
    "bias_torque",
    "mass_matrix",
    "mass_matrix_inverse",
    "forward_dynamics_derivatives",
    "inverse_dynamics_derivatives",
    "forward_dynamics_jvp",
    "forward_dynamics_vjp",
    "inverse_dynamics_jvp",
    "inverse_dynamics_vjp",
    "placements",
]
_Frame = Literal["local", "world", "local-world-aligned"]
#: What to_c and compile know: a name, or of one link (name, link) and (name, link, frame).
Function: TypeAlias = (
    _OfScene | tuple[Literal["placement"], str] | tuple[Literal["jacobian"], str] | tuple[Literal["jacobian"], str, _Frame]
)
#: All of them that are of no one link.
FUNCTIONS: tuple[_OfScene, ...] = get_args(_OfScene)
#: Those that the scene does in a form.
IN_FORM = (
    "forward_dynamics",
    "mass_matrix_inverse",
    "forward_dynamics_derivatives",
    "forward_dynamics_jvp",
    "forward_dynamics_vjp",
)


class Functions(Generic[A]):
    """Functions of one scene that were compiled, by the names of its methods."""

    scene: Scene
    """The scene that it was compiled from."""
    functions: tuple[Function, ...]
    """What was compiled."""
    dtype: np.dtype[Any]
    """The numbers of the machine code, and of results."""

    def __init__(self, scene: Scene, functions: tuple[Function, ...], dtype: str) -> None:
        self.scene, self.functions, self.dtype = scene, functions, np.dtype(dtype)
        self._numpy: Any = np
        self._rates, self._pairs = (scene.nv,), (scene.nv, scene.nv)

    def __repr__(self) -> str:
        return f"<phipsi.{type(self).__name__} of {self.scene.nv} degrees of freedom, {self.dtype}: {said(self.functions)}>"

    def forward_dynamics(self, q: Any, qd: Any, tau: Any) -> A:
        """Joint accelerations from joint torques, (..., nv), as Scene.forward_dynamics in the form that was compiled."""
        return self._one(("forward_dynamics",), {"q": q, "qd": qd, "tau": tau}, self._rates)

    def inverse_dynamics(self, q: Any, qd: Any, qdd: Any) -> A:
        """Joint torques from joint accelerations, (..., nv), as Scene.inverse_dynamics."""
        return self._one(("inverse_dynamics",), {"q": q, "qd": qd, "qdd": qdd}, self._rates)

    def bias_torque(self, q: Any, qd: Any) -> A:
        """The torques that let no joint accelerate, (..., nv), as Scene.bias_torque."""
        return self._one(("bias_torque",), {"q": q, "qd": qd}, self._rates)

    def mass_matrix(self, q: Any) -> A:
        """The mass matrix, (..., nv, nv), as Scene.mass_matrix."""
        return self._one(("mass_matrix",), {"q": q}, self._pairs)

    def mass_matrix_inverse(self, q: Any) -> A:
        """Its inverse, (..., nv, nv), as Scene.mass_matrix_inverse in the form that was compiled."""
        return self._one(("mass_matrix_inverse",), {"q": q}, self._pairs)

    def forward_dynamics_derivatives(self, q: Any, qd: Any, tau: Any) -> ForwardDynamicsDerivatives:
        """dqdd_dq, dqdd_dqd and Minv, (..., nv, nv) each, as Scene.forward_dynamics_derivatives in form "covariance"."""
        return self._several(("forward_dynamics_derivatives",), {"q": q, "qd": qd, "tau": tau}, 3 * [self._pairs], ForwardDynamicsDerivatives)

    def inverse_dynamics_derivatives(self, q: Any, qd: Any, qdd: Any) -> InverseDynamicsDerivatives:
        """dtau_dq, dtau_dqd and M, (..., nv, nv) each, as Scene.inverse_dynamics_derivatives."""
        return self._several(("inverse_dynamics_derivatives",), {"q": q, "qd": qd, "qdd": qdd}, 3 * [self._pairs], InverseDynamicsDerivatives)

    def forward_dynamics_jvp(self, q: Any, qd: Any, tau: Any, dq: Any, dqd: Any, dtau: Any) -> A:
        """The change of joint accelerations along (dq, dqd, dtau), (..., nv), as Scene.forward_dynamics_jvp in form "covariance"."""
        return self._one(("forward_dynamics_jvp",), {"q": q, "qd": qd, "tau": tau, "dq": dq, "dqd": dqd, "dtau": dtau}, self._rates)

    def forward_dynamics_vjp(self, q: Any, qd: Any, tau: Any, cotangent: Any) -> ForwardDynamicsGradients:
        """The gradients of cotangent . qdd by q, qd and tau, (..., nv) each, as Scene.forward_dynamics_vjp in form "covariance"."""
        return self._several(("forward_dynamics_vjp",), {"q": q, "qd": qd, "tau": tau, "cotangent": cotangent}, 3 * [self._rates], ForwardDynamicsGradients)

    def inverse_dynamics_jvp(self, q: Any, qd: Any, qdd: Any, dq: Any, dqd: Any, dqdd: Any) -> A:
        """The change of joint torques along (dq, dqd, dqdd), (..., nv), as Scene.inverse_dynamics_jvp."""
        return self._one(("inverse_dynamics_jvp",), {"q": q, "qd": qd, "qdd": qdd, "dq": dq, "dqd": dqd, "dqdd": dqdd}, self._rates)

    def inverse_dynamics_vjp(self, q: Any, qd: Any, qdd: Any, cotangent: Any) -> InverseDynamicsGradients:
        """The gradients of cotangent . tau by q, qd and qdd, (..., nv) each, as Scene.inverse_dynamics_vjp."""
        return self._several(("inverse_dynamics_vjp",), {"q": q, "qd": qd, "qdd": qdd, "cotangent": cotangent}, 3 * [self._rates], InverseDynamicsGradients)

    def placements(self, q: Any) -> dict[str, A]:
        """Where every link is, a dict from link names to homogeneous matrices (..., 4, 4), as Scene.placements."""
        links = self.scene.link_names
        all_links = self._run(("placements",), {"q": q}, [(len(links), 4, 4)])
        found: dict[str, A]
        if all_links is None:
            found = self._by_scene(("placements",), {"q": q})
        else:
            found = {link: all_links[0][..., at, :, :].copy() for at, link in enumerate(links)}
        return found

    def placement(self, q: Any, link: str | Iterable[str]) -> A:
        """Where a link is, or several, homogeneous matrices (..., 4, 4) or (..., L, 4, 4), as Scene.placement: each that was compiled as ("placement", link)."""
        if isinstance(link, str):
            return self._one(("placement", link), {"q": q}, (4, 4))
        names = tuple(link)
        several: Any = self._numpy.stack([self._one(("placement", name), {"q": q}, (4, 4)) for name in names], axis=-3) if names else self.scene.placement(q, names)
        found: A = several
        return found

    def jacobian(self, q: Any, link: str, *, frame: _Frame = "local") -> A:
        """The Jacobian of a link, (..., 6, nv), as Scene.jacobian: of a link and a frame that were compiled as ("jacobian", link, frame)."""
        return self._one(("jacobian", link, frame), {"q": q}, (6, self.scene.nv))

    def _one(self, function: tuple[str, ...], given: dict[str, Any], shape: tuple[int, ...]) -> A:
        """A function of one result."""
        found = self._run(function, given, [shape])
        result: A = self._by_scene(function, given) if found is None else found[0]
        return result

    def _several(self, function: tuple[str, ...], given: dict[str, Any], shapes: Sequence[tuple[int, ...]], kind: Callable[..., _Results]) -> _Results:
        """A function of several results, and what they are put into."""
        found = self._run(function, given, shapes)
        return self._by_scene(function, given) if found is None else kind(*found)

    def _run(self, function: tuple[str, ...], given: dict[str, Any], shapes: Sequence[tuple[int, ...]]) -> list[Any] | None:
        """The results, of these shapes after the leading axes; None of what the scene is to do."""
        raise NotImplementedError

    def _by_scene(self, function: tuple[str, ...], given: dict[str, Any]) -> Any:
        """What the scene's own method gives, which says what is wrong."""
        raise NotImplementedError

    def _missing(self, function: tuple[str, ...]) -> Exception:
        return of_argument(ArgumentError, "functions", f"found {said([function])}, which was not compiled; expected one of {said(self.functions)}")


def parts(function: Function) -> tuple[str, ...]:
    """The name, and of one link the link and for Jacobians the frame."""
    if isinstance(function, str):
        return (function,)
    return (*function, "local") if len(function) == 2 and function[0] == "jacobian" else tuple(function)


def symbol(function: Function) -> str:
    """What the code calls it."""
    of = parts(function)
    return "_".join(re.sub(r"[^0-9A-Za-z]", "_", part) for part in of[: 2 if of[2:] == ("local",) else 3])


def said(functions: Iterable[Function | tuple[str, ...]]) -> str:
    """In words."""
    return ", ".join(function if isinstance(function, str) else " ".join(function) for function in functions)
