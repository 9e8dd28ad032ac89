"""Measurements of the stability report: errors compared with double-double arithmetic, sensitivities, times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from ... import _core, errors, scenes
from ..pipeline import Findings
from ..progress import Reporter
from ..states import Array

AUTO, COVARIANCE, ROOT, LDLT, CHOLESKY = _core.FORMS
#: Forms of derivatives.
DERIVED_FORMS: tuple[Literal["auto", "covariance", "square-root"], ...] = ("auto", "covariance", "square-root")
#: Number of random perturbations for each sensitivity.
DRAWS = 3
#: Number of states of each case at each value.
STATES = 8
#: Largest number of links with --quick, and with eight instead of two states.
QUICK_LINKS = 1000
#: Cases whose methods are timed: name, value.
TIMED = (("heavy-tip", 1.0), ("heavy-tip", 1e9), ("growing-masses", 100.0), ("alternating-masses", 1e-9))
#: Accuracy targets of the square-root form, max-norm and per component; or that multiple of the sensitivity, if it is larger.
AIMS, TIMES = (1e-13, 1e-12), 20.0


class Error(NamedTuple):
    """Relative error of one method on one case; NaN, with the reason, if it failed."""

    norm: float
    """Largest error relative to the largest acceleration."""
    component: float
    """Largest error of an acceleration relative to that acceleration."""
    reason: str | None = None

    @staticmethod
    def of(norm: float, components: Array, reason: str | None = None) -> Error:
        """From the max-norm and the components."""
        return Error(norm, float(np.max(components, initial=0.0)), reason)


def worst(found: Sequence[Error]) -> Error:
    """Largest value of each norm; a failure only if all failed."""
    sound = [error for error in found if error.reason is None]
    return Error(max(error.norm for error in sound), max(error.component for error in sound)) if sound else found[0]


class Other(NamedTuple):
    """Another program that computes the same scenes."""

    name: str
    version: str
    color: str
    error: Callable[[scenes.Extreme, _core.Exact], Error]
    """Its error on a case, compared with the exact result."""


@dataclass(frozen=True)
class Point:
    """One case at one value."""

    name: str
    value: float
    seed: int
    degrees_of_freedom: int
    sensitivity: dict[str, Error]
    """By kind of value, `state` first."""
    errors: dict[str, Error]
    """By method, including other programs."""

    @property
    def floor(self) -> Error:
        """The largest of the sensitivities."""
        return worst(list(self.sensitivity.values()))

    @property
    def parameters(self) -> Error:
        """The largest sensitivity to a parameter of the model."""
        return worst([error for kind, error in self.sensitivity.items() if kind != "state"])

    @property
    def aim(self) -> Error:
        """Accuracy target of the square-root form."""
        return Error(max(AIMS[0], TIMES * self.floor.norm), max(AIMS[1], TIMES * self.floor.component))

    def json(self) -> dict[str, Any]:
        """Errors as rows."""
        rows = [{"method": method, **error._asdict()} for method, error in self.errors.items()]
        about = {key: getattr(self, key) for key in ("name", "value", "seed", "degrees_of_freedom", "sensitivity")}
        return {**about, "errors": rows}


class Timed(NamedTuple):
    """Time and error of one method on one case."""

    case: str
    value: float
    method: str
    ns: float
    norm: float
    component: float
    reason: str | None


class Derived(NamedTuple):
    """Error of the derivative of accelerations with respect to q on one case, in every form."""

    case: str
    value: float
    errors: dict[str, Error]
    sensitivity: Error


class Recursion(NamedTuple):
    """The error of inverse dynamics, bias torque or mass matrix on one case."""

    quantity: str
    case: str
    value: float
    norm: float
    component: float
    reason: str | None
    sensitivity: Error


@dataclass
class Stability(Findings):
    """Results for the extreme scenes, each case at every value of its parameter; `quick`: two states, and chains of up
    to 1000 links.
    """

    seed: int = 0
    others: Sequence[Other] = ()
    """Programs for the comparison."""

    @property
    def seeds(self) -> range:
        """Seeds of the states of each case."""
        return range(self.seed, self.seed + (2 if self.quick else STATES))

    @cached_property
    def scenes(self) -> list[tuple[int, scenes.Extreme]]:
        """Every case at every value and seed."""
        return [
            (one, scenes.extreme(name, value, seed=one))
            for name in scenes.names()
            for value in scenes.extreme(name, seed=self.seed).values
            if not (self.quick and name == "long-chain" and value > QUICK_LINKS)
            for one in (self.seeds if value <= QUICK_LINKS or name != "long-chain" else self.seeds[:2])
        ]

    @property
    def points(self) -> list[Point]:
        """Errors and sensitivities, without singular scenes."""
        points: list[Point] = self.parts["cases"]
        return points

    @property
    def methods(self) -> tuple[str, ...]:
        """Forms, dense algebra, and other programs."""
        return (*_core.FORMS, *(other.name for other in self.others))

    @property
    def names(self) -> tuple[str, ...]:
        """The cases."""
        return tuple(dict.fromkeys(point.name for point in self.points))

    def of(self, name: str) -> list[Point]:
        """One case in the order of its parameter: the maximum over the seeds of errors and sensitivities."""
        values = dict.fromkeys(point.value for point in self.points if point.name == name)
        return [_merged([p for p in self.points if (p.name, p.value) == (name, value)]) for value in values]

    def timed(self, name: str, value: float) -> list[Timed]:
        """Every method on one case."""
        return [row for row in self.parts["timed"] if (row.case, row.value) == (name, value)]

    def head(self) -> dict[str, Any]:
        """States, and programs of the comparison."""
        return {"quick": self.quick, "seeds": list(self.seeds), "peers": [other.version for other in self.others]}

    def keeps(self, method: str) -> bool:
        """Whether the method meets the target in all cases in the max-norm."""
        return all(point.errors[method].norm <= point.aim.norm for point in self.points)

    def largest(self, method: str) -> float:
        """Largest error of the method in the max-norm, without failures."""
        return worst([point.errors[method] for point in self.points]).norm

    @property
    def missed(self) -> set[str]:
        """Cases in which the square-root form misses its target in either norm."""
        roots = [(point, point.errors[ROOT]) for point in self.points]
        return {point.name for point, own in roots if not (own.norm <= point.aim.norm and own.component <= point.aim.component)}

    def provenance(self) -> list[tuple[str, str]]:
        """Hardware, states and programs."""
        compared = ", ".join(dict.fromkeys(other.version for other in self.others)) or "none"
        seeds = f"{self.seeds[0]} to {self.seeds[-1]}{' (quick)' if self.quick else ''}"
        return [*super().provenance(), ("seeds", seeds), ("programs compared", compared)]


def _merged(points: Sequence[Point]) -> Point:
    first = points[0]
    return Point(
        first.name, first.value, first.seed, first.degrees_of_freedom,
        {kind: worst([point.sensitivity[kind] for point in points]) for kind in first.sensitivity},
        {key: worst([point.errors[key] for point in points]) for key in first.errors},
    )  # fmt: skip


def exact_of(case: scenes.Extreme, quantity: str = "forward dynamics") -> _core.Exact:
    """Result in double-double arithmetic."""
    return _core.Exact(case.scene, quantity, case.q, case.qd, case.tau)


def _is_singular(case: scenes.Extreme) -> bool:
    return case.name == "zero-inertia" and case.value == 0.0


def cases(found: Stability, reporter: Reporter) -> list[Point]:
    """Error of every method on every case that is not singular."""
    chosen = [(case, seed) for seed, case in found.scenes if not _is_singular(case)]
    return [_point(case, seed, found.others) for case, seed in reporter.each("Error of every method", chosen)]


def _point(case: scenes.Extreme, seed: int, others: Sequence[Other]) -> Point:
    exact = exact_of(case)
    errors_of = {method: Error.of(*exact.error(method)) for method in _core.FORMS}
    errors_of |= {other.name: other.error(case, exact) for other in others}
    sensitivity = {kind: Error.of(*norms) for kind, norms in exact.sensitivity(DRAWS).items()}
    return Point(case.name, case.value, seed, case.scene.nv, sensitivity, errors_of)


def singular(found: Stability, _: Reporter) -> str:
    """The message of the error that the singular case raises."""
    case = next(case for _, case in found.scenes if _is_singular(case))
    try:
        case.scene.forward_dynamics(case.q, case.qd, case.tau)
    except errors.SingularJointError as error:
        return str(error)
    return ""


def timed(found: Stability, reporter: Reporter) -> list[Timed]:
    """Time and error of every form on a few cases."""
    rows = []
    for name, value in reporter.each("Error against run time", TIMED):
        exact = exact_of(scenes.extreme(name, value, seed=found.seed))
        for method in _core.FORMS:
            # Minimum of several medians, because other load only increases times.
            ns = min(exact.time(method, 200 if found.quick else 2000) for _ in range(5))
            rows.append(Timed(name, value, method, ns, *Error.of(*exact.error(method))))
    return rows


def recursions(found: Stability, reporter: Reporter) -> list[Recursion]:
    """Error of the other recursions, for scenes of moderate size, and of inverse dynamics in free fall."""
    small = [case for seed, case in found.scenes if case.scene.nv <= 100 and seed < found.seed + 2]
    chosen = [(quantity, case) for case in small for quantity in _core.QUANTITIES[1:4]]
    return [_recursion(*one) for one in reporter.each("Inverse dynamics, bias and mass matrix", [*chosen, *_falling()])]


def _recursion(quantity: str, case: scenes.Extreme) -> Recursion:
    exact = exact_of(case, quantity)
    sensitivity = worst([Error.of(*norms) for norms in exact.sensitivity(DRAWS).values()])
    return Recursion(quantity, case.name, case.value, *Error.of(*exact.error(ROOT)), sensitivity)


def derivatives(found: Stability, reporter: Reporter) -> list[Derived]:
    """Error of the derivative of accelerations with respect to q, in every form, for scenes of moderate size."""
    small = [case for seed, case in found.scenes if case.scene.nv <= 30 and seed < found.seed + 2 and not _is_singular(case)]
    return [_derived(case) for case in reporter.each("Derivatives of forward dynamics", small)]


def _derived(case: scenes.Extreme) -> Derived:
    exact = exact_of(case, _core.QUANTITIES[4])
    sensitivity = worst([Error.of(*norms) for norms in exact.sensitivity(DRAWS).values()])
    return Derived(case.name, case.value, {form: _derived_in(form, case, exact) for form in DERIVED_FORMS}, sensitivity)


def _derived_in(form: Literal["auto", "covariance", "square-root"], case: scenes.Extreme, exact: _core.Exact) -> Error:
    try:
        by_q = case.scene.forward_dynamics_derivatives(case.q, case.qd, case.tau, form=form).dqdd_dq
    except errors.PhipsiError as error:
        return Error(float("nan"), float("nan"), str(error))
    return Error.of(*exact.difference(by_q.ravel()))


def _falling() -> list[tuple[str, scenes.Extreme]]:
    """A floating base in free fall with a small additional acceleration: gravity cancels in inverse dynamics."""
    falls = []
    case = scenes.extreme("far-base", 1.0)
    fall = np.zeros(case.scene.nv)
    fall[:3] = case.scene.placements(case.q)["base"][:3, :3].T @ case.scene.gravity
    for small in (1.0, 1e-3, 1e-6, 1e-9, 1e-12):
        state = {"qd": 1e-3 * np.sqrt(small) * case.qd, "tau": fall + small * case.tau}
        falls.append(("inverse dynamics", case._replace(name="free fall", value=small, **state)))
    return falls
