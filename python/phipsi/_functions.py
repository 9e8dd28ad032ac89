"""The table of functions, which the compiled module holds; and the methods that both kinds of compiled robots have."""

from __future__ import annotations

import re
from operator import attrgetter
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeAlias, TypeVar, get_args, overload

import numpy as np

from ._arguments import has_followers
from ._core import _function_table
from ._results import (
    Accuracy,
    ConstrainedDynamics,
    ForwardDynamicsDerivatives,
    ForwardDynamicsGradients,
    InverseDynamicsDerivatives,
    InverseDynamicsGradients,
)
from .errors import ArgumentError, of_argument

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["FUNCTIONS", "Function", "Functions", "functions_of"]

A = TypeVar("A")
_OfScene = Literal[
    "forward_dynamics",
    "constrained_dynamics",
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
    "contact_gaps",
    "contact_velocities",
    "contact_gram",
]
_Frame = Literal["local", "world", "local-world-aligned"]
_Errors = Literal["raise", "nan"]
#: Functions for to_c and compile: a name, or for one link (name, link) and (name, link, frame).
Function: TypeAlias = (
    _OfScene | tuple[Literal["placement"], str] | tuple[Literal["jacobian"], str] | tuple[Literal["jacobian"], str, _Frame]
)
#: All of them that are of no one link.
FUNCTIONS: tuple[_OfScene, ...] = get_args(_OfScene)
#: The rows of the table (src/algorithm.rs), by their names.
TABLE: dict[str, dict[str, Any]] = {row["name"]: row for row in _function_table()}
#: The functions that code for one robot has: they alone have a number of states below which the scene is faster.
COMPILED = {name: row for name, row in TABLE.items() if row["few"] is not None}
#: The arrays that each takes, and the functions that the scene computes in a form.
ARGUMENTS: dict[str, tuple[str, ...]] = {name: tuple(row["arguments"]) for name, row in COMPILED.items()}
IN_FORM = tuple(name for name, row in COMPILED.items() if row["has_form"])
#: Methods of a scene whose names differ from those of the functions, because they are in a group.
METHODS = {"constrained_dynamics": "loops.dynamics", **{f"contact_{name}": f"contacts.{name}" for name in ("gaps", "velocities", "gram")}}
#: The functions that are computed through the connections of a scene that has some.
THROUGH_CONNECTIONS = ("forward_dynamics", "constrained_dynamics")


def method_of(scene: Scene, function: str) -> Any:
    """The method of a scene that computes a function."""
    return attrgetter(METHODS.get(function, function))(scene)


def functions_of(scene: Scene) -> tuple[_OfScene, ...]:
    """The functions with code for a scene, without those of one link."""
    kinds = {"every", "loops" if scene.loops.names else "trees"}
    if scene.contacts.names:
        is_tree = not scene.loops.names and not has_followers(scene)
        kinds |= {"contacts", "trees with contacts"} if is_tree else {"contacts"}
    return tuple(name for name in FUNCTIONS if COMPILED[name]["scenes"] in kinds)


class Functions(Generic[A]):
    """Compiled functions of one scene: methods with the arguments of those of the scene, except form and dtype, which are fixed."""

    scene: Scene
    """The scene that it was compiled from."""
    functions: tuple[Function, ...]
    """The functions that were compiled."""
    dtype: np.dtype[Any]
    """The type of the code and of the results."""

    def __init__(self, scene: Scene, functions: tuple[Function, ...], dtype: str) -> None:
        self.scene, self.functions, self.dtype = scene, functions, np.dtype(dtype)
        self._numpy: Any = np

    def __repr__(self) -> str:
        return f"<phipsi.{type(self).__name__} of {self.scene.nv} degrees of freedom, {self.dtype}: {said(self.functions)}>"

    @overload
    def forward_dynamics(
        self, q: Any, qd: Any, tau: Any, *, wrenches: Any = None, out: A | None = None, errors: _Errors = "raise", return_info: Literal[False] = False
    ) -> A: ...
    @overload
    def forward_dynamics(
        self, q: Any, qd: Any, tau: Any, *, wrenches: Any = None, out: A | None = None, errors: _Errors = "raise", return_info: Literal[True]
    ) -> tuple[A, Accuracy]: ...
    def forward_dynamics(
        self, q: Any, qd: Any, tau: Any, *, wrenches: Any = None, out: A | None = None, errors: _Errors = "raise", return_info: bool = False
    ) -> A | tuple[A, Accuracy]:
        """Joint accelerations from joint torques, (..., nv), as Scene.forward_dynamics in the form that was compiled."""
        more = None if wrenches is None and return_info is False else {"wrenches": wrenches, "return_info": return_info}
        found: A | tuple[A, Accuracy] = self._run(("forward_dynamics",), (q, qd, tau), out, errors, more)
        return found

    def inverse_dynamics(self, q: Any, qd: Any, qdd: Any, *, wrenches: Any = None, out: A | None = None, errors: _Errors = "raise") -> A:
        """Joint torques from joint accelerations, (..., nv), as Scene.inverse_dynamics."""
        found: A = self._run(("inverse_dynamics",), (q, qd, qdd), out, errors, None if wrenches is None else {"wrenches": wrenches})
        return found

    def bias_torque(self, q: Any, qd: Any, *, out: A | None = None, errors: _Errors = "raise") -> A:
        """Joint torques at which no joint accelerates, (..., nv), as Scene.bias_torque."""
        found: A = self._run(("bias_torque",), (q, qd), out, errors)
        return found

    def mass_matrix(self, q: Any, *, out: A | None = None, errors: _Errors = "raise") -> A:
        """The mass matrix, (..., nv, nv), as Scene.mass_matrix."""
        found: A = self._run(("mass_matrix",), (q,), out, errors)
        return found

    def mass_matrix_inverse(self, q: Any, *, out: A | None = None, errors: _Errors = "raise") -> A:
        """The inverse of the mass matrix, (..., nv, nv), as Scene.mass_matrix_inverse in the form that was compiled."""
        found: A = self._run(("mass_matrix_inverse",), (q,), out, errors)
        return found

    def forward_dynamics_derivatives(
        self, q: Any, qd: Any, tau: Any, *, wrenches: Any = None, out: A | None = None, errors: _Errors = "raise"
    ) -> ForwardDynamicsDerivatives:
        """dqdd_dq, dqdd_dqd and mass_matrix_inverse, (..., nv, nv) each, as Scene.forward_dynamics_derivatives in the form that was compiled. out: (..., 3, nv, nv), of which they are views."""
        found = self._run(("forward_dynamics_derivatives",), (q, qd, tau), out, errors, None if wrenches is None else {"wrenches": wrenches})
        return found if isinstance(found, ForwardDynamicsDerivatives) else ForwardDynamicsDerivatives(*found)

    def inverse_dynamics_derivatives(
        self, q: Any, qd: Any, qdd: Any, *, wrenches: Any = None, out: A | None = None, errors: _Errors = "raise"
    ) -> InverseDynamicsDerivatives:
        """dtau_dq, dtau_dqd and mass_matrix, (..., nv, nv) each, as Scene.inverse_dynamics_derivatives. out: (..., 3, nv, nv), of which they are views."""
        found = self._run(("inverse_dynamics_derivatives",), (q, qd, qdd), out, errors, None if wrenches is None else {"wrenches": wrenches})
        return found if isinstance(found, InverseDynamicsDerivatives) else InverseDynamicsDerivatives(*found)

    def forward_dynamics_jvp(
        self,
        q: Any,
        qd: Any,
        tau: Any,
        dq: Any,
        dqd: Any,
        dtau: Any,
        *,
        wrenches: Any = None,
        dwrenches: Any = None,
        dparameters: Any = None,
        darmature: Any = None,
        dgravity: Any = None,
        errors: _Errors = "raise",
    ) -> A:
        """The change of joint accelerations along (dq, dqd, dtau), (..., nv), as Scene.forward_dynamics_jvp in the form that was compiled."""
        more = _changes(wrenches, dwrenches, dparameters, darmature, dgravity)
        found: A = self._run(("forward_dynamics_jvp",), (q, qd, tau, dq, dqd, dtau), None, errors, more)
        return found

    def forward_dynamics_vjp(
        self, q: Any, qd: Any, tau: Any, cotangent: Any, *, wrenches: Any = None, parameters: bool = False, errors: _Errors = "raise"
    ) -> ForwardDynamicsGradients:
        """The gradients of cotangent . qdd by q, qd and tau, (..., nv) each, as Scene.forward_dynamics_vjp in the form that was compiled."""
        more = None if wrenches is None and parameters is False else {"wrenches": wrenches, "parameters": parameters}
        found = self._run(("forward_dynamics_vjp",), (q, qd, tau, cotangent), None, errors, more)
        return found if isinstance(found, ForwardDynamicsGradients) else ForwardDynamicsGradients(*found)

    def inverse_dynamics_jvp(
        self,
        q: Any,
        qd: Any,
        qdd: Any,
        dq: Any,
        dqd: Any,
        dqdd: Any,
        *,
        wrenches: Any = None,
        dwrenches: Any = None,
        dparameters: Any = None,
        darmature: Any = None,
        dgravity: Any = None,
        errors: _Errors = "raise",
    ) -> A:
        """The change of joint torques along (dq, dqd, dqdd), (..., nv), as Scene.inverse_dynamics_jvp."""
        more = _changes(wrenches, dwrenches, dparameters, darmature, dgravity)
        found: A = self._run(("inverse_dynamics_jvp",), (q, qd, qdd, dq, dqd, dqdd), None, errors, more)
        return found

    def inverse_dynamics_vjp(
        self, q: Any, qd: Any, qdd: Any, cotangent: Any, *, wrenches: Any = None, parameters: bool = False, errors: _Errors = "raise"
    ) -> InverseDynamicsGradients:
        """The gradients of cotangent . tau by q, qd and qdd, (..., nv) each, as Scene.inverse_dynamics_vjp."""
        more = None if wrenches is None and parameters is False else {"wrenches": wrenches, "parameters": parameters}
        found = self._run(("inverse_dynamics_vjp",), (q, qd, qdd, cotangent), None, errors, more)
        return found if isinstance(found, InverseDynamicsGradients) else InverseDynamicsGradients(*found)

    def placements(self, q: Any, *, errors: _Errors = "raise") -> dict[str, A]:
        """Poses of all links, a dict from link names to homogeneous matrices (..., 4, 4), as Scene.placements."""
        found: Any = self._run(("placements",), (q,), None, errors)
        return found if isinstance(found, dict) else {link: found[..., at, :, :].copy() for at, link in enumerate(self.scene.link_names)}

    def placement(self, q: Any, link: str | Iterable[str], *, errors: _Errors = "raise") -> A:
        """Pose of a link, or of several: homogeneous matrices (..., 4, 4) or (..., L, 4, 4), as Scene.placement: each that was compiled as ("placement", link)."""
        found: A
        if isinstance(link, str):
            found = self._run(("placement", link), (q,), None, errors)
        else:
            found = self._several_placements(q, tuple(link), errors)
        return found

    def contact_gaps(self, q: Any, *, errors: _Errors = "raise") -> A:
        """Distance of each contact from its plane, (..., contacts), as Scene.contacts.gaps."""
        found: A = self._run(("contact_gaps",), (q,), None, errors)
        return found

    def contact_velocities(self, q: Any, qd: Any, *, errors: _Errors = "raise") -> A:
        """Velocity of the point of each contact in the base frame, (..., contacts, 3), as Scene.contacts.velocities."""
        found: A = self._run(("contact_velocities",), (q, qd), None, errors)
        return found

    def contact_gram(self, q: Any, *, errors: _Errors = "raise") -> A:
        """J M^-1 J^T of the points of all contacts, (..., contacts, 3, contacts, 3), as Scene.contacts.gram in the form that was compiled."""
        found: A = self._run(("contact_gram",), (q,), None, errors)
        return found

    def _several_placements(self, q: Any, links: tuple[str, ...], errors: _Errors) -> Any:
        """(..., L, 4, 4)."""
        one_by_one = [self._run(("placement", link), (q,), None, errors) for link in links]
        return self._numpy.stack(one_by_one, axis=-3) if links else self.scene.placement(q, links, errors=errors)

    def jacobian(self, q: Any, link: str, *, frame: _Frame = "local", at: Any = None, errors: _Errors = "raise") -> A:
        """The Jacobian of a link, (..., 6, nv), as Scene.jacobian: of a link and a frame that were compiled as ("jacobian", link, frame)."""
        found: A = self._run(("jacobian", link, frame), (q,), None, errors, None if at is None else {"at": at})
        return found

    def constrained_dynamics(
        self, q: Any, qd: Any, tau: Any, *, compliance: Any = None, wrenches: Any = None, errors: _Errors = "raise"
    ) -> ConstrainedDynamics:
        """Joint accelerations and constraint forces with connections, as Scene.loops.dynamics in the form that was compiled."""
        return self._through_connections((q, qd, tau), compliance, wrenches, errors)

    def _through_connections(self, state: tuple[Any, ...], compliance: Any, wrenches: Any, errors: _Errors) -> ConstrainedDynamics:
        """The results of compiled code or of the scene."""
        raise self._missing(("constrained_dynamics",))

    def _run(self, function: tuple[str, ...], given: tuple[Any, ...], out: A | None = None, errors: _Errors = "raise", more: dict[str, Any] | None = None) -> Any:
        """The results of compiled code, or of the method of the scene. more: arguments of that method for which there is no compiled code."""
        raise NotImplementedError

    def _missing(self, function: tuple[str, ...]) -> Exception:
        return of_argument(ArgumentError, "functions", f"found {said([function])}, which was not compiled; expected one of {said(self.functions)}")


def rows_of(scene: Scene) -> dict[str, slice]:
    """The rows of each connection."""
    return {name: scene.loops.rows(name) for name in scene.loops.names}


def row_count(scene: Scene) -> int:
    """The number of rows of all connections."""
    return max((rows.stop for rows in rows_of(scene).values()), default=0)


def shapes(function: tuple[str, ...], scene: Scene) -> list[tuple[int, ...]]:
    """The shapes of the results of one state."""
    lengths = {"nq": scene.nq, "nv": scene.nv, "links": len(scene.link_names), "rows": row_count(scene)}
    lengths["contacts"] = len(scene.contacts.names)
    results: dict[str, tuple[str | int, ...]] = TABLE[function[0]]["results"]
    return [tuple(axis if isinstance(axis, int) else lengths[axis] for axis in axes) for axes in results.values()]


def _changes(wrenches: Any, dwrenches: Any, dparameters: Any, darmature: Any, dgravity: Any) -> dict[str, Any] | None:
    """The constants that change along a direction, if any are given."""
    if wrenches is dwrenches is dparameters is darmature is dgravity is None:
        return None
    return {"wrenches": wrenches, "dwrenches": dwrenches, "dparameters": dparameters, "darmature": darmature, "dgravity": dgravity}


def parts(function: Function) -> tuple[str, ...]:
    """The name, and of one link the link and for Jacobians the frame."""
    if isinstance(function, str):
        return (function,)
    return (*function, "local") if len(function) == 2 and function[0] == "jacobian" else tuple(function)


def symbol(function: Function) -> str:
    """The name of a function in the code."""
    of = parts(function)
    return "_".join(re.sub(r"[^0-9A-Za-z]", "_", part) for part in of[: 2 if of[2:] == ("local",) else 3])


def said(functions: Iterable[Function | tuple[str, ...]]) -> str:
    """The names of functions in messages."""
    return ", ".join(function if isinstance(function, str) else " ".join(function) for function in functions)
