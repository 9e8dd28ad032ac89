"""Everything that the stability report says, measured; and the same as JSON."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ... import _core, errors, scenes
from .. import machine
from ..progress import Reporter
from . import peers

Array = NDArray[np.float64]

COVARIANCE, ROOT, LDLT, CHOLESKY = _core.FORMS
PRECISIONS = ("float64", "float32")
#: Draws of each sensitivity.
DRAWS = 3
#: States of each case at each value.
STATES = 8
#: Beyond this many links --quick does not go; two states, not eight.
QUICK_LINKS = 1000
#: Cases whose methods are timed: name, value.
TIMED = (("heavy-tip", 1.0), ("heavy-tip", 1e9), ("growing-masses", 100.0), ("alternating-masses", 1e-9))
#: A peer's numbers are shown if it is right to this on the cases below at 1, where nothing is extreme.
AGREEMENT = 1e-10
ORDINARY = ("heavy-tip", "prismatic-chain", "heavy-leaves", "armature", "far-base")
NOT_FINITE = "a result is not finite"
#: Errors below these, max-norm and component by component, are rounding: no comparison is made of them.
NOISE = {"max-norm": 1e-15, "components": 1e-14}


class Error(NamedTuple):
    """The error of one method on one case, relative; NaN, with the reason, where it failed."""

    norm: float
    """Largest error over the largest acceleration."""
    component: float
    """Largest error of an acceleration over that acceleration."""
    reason: str | None = None


@dataclass(frozen=True)
class Point:
    """One case at one value."""

    name: str
    value: float
    seed: int
    nv: int
    sensitivity: dict[str, Error]
    """By kind of number, `state` first."""
    errors: dict[tuple[str, str], Error]
    """By method (peers included) and precision."""

    @property
    def floor(self) -> float:
        """The largest of the sensitivities, max-norm."""
        return max(error.norm for error in self.sensitivity.values())

    @property
    def component_floor(self) -> float:
        """The same component by component."""
        return max(error.component for error in self.sensitivity.values())

    @property
    def parameters(self) -> float:
        """The largest sensitivity to a parameter of the model, max-norm."""
        return max(error.norm for kind, error in self.sensitivity.items() if kind != "state")


class Timed(NamedTuple):
    """Time and error of one method on one case."""

    name: str
    value: float
    method: str
    precision: str
    ns: float
    error: Error


class Recursion(NamedTuple):
    """The error of inverse dynamics, bias torque or mass matrix on one case."""

    quantity: str
    name: str
    value: float
    error: Error
    sensitivity: Error


@dataclass
class Stability:
    """What was measured."""

    quick: bool
    seeds: Sequence[int]
    date: str
    machine: dict[str, str | int | None]
    peers: Sequence[peers.Peer]
    points: list[Point] = field(default_factory=list)
    """Every case at every value and seed."""
    timed: list[Timed] = field(default_factory=list)
    recursions: list[Recursion] = field(default_factory=list)
    singular: str = ""
    """What the singular case raised."""
    absent: Sequence[str] = ()
    """A line on each program that was not compared: not installed, or wrong on an ordinary scene."""

    @property
    def methods(self) -> tuple[str, ...]:
        """The forms, dense algebra, and the peers installed."""
        return (*_core.FORMS, *(peer.name for peer in self.peers))

    @property
    def names(self) -> tuple[str, ...]:
        """The cases."""
        return tuple(dict.fromkeys(point.name for point in self.points))

    def of(self, name: str) -> list[Point]:
        """One case in the order of its sweep: the worst over the seeds, of errors and of sensitivities."""
        values = dict.fromkeys(point.value for point in self.points if point.name == name)
        return [_worst_of([p for p in self.points if (p.name, p.value) == (name, value)]) for value in values]


def _worst_of(points: Sequence[Point]) -> Point:
    """The worst of each number; the failures of a method are kept only where it failed at every seed."""

    def worst(errors: Sequence[Error]) -> Error:
        sound = [error for error in errors if error.reason is None]
        if not sound:
            return errors[0]
        return Error(max(error.norm for error in sound), max(error.component for error in sound))

    first = points[0]
    return Point(
        first.name, first.value, first.seed, first.nv,
        {kind: worst([point.sensitivity[kind] for point in points]) for kind in first.sensitivity},
        {key: worst([point.errors[key] for point in points]) for key in first.errors},
    )  # fmt: skip


def collect(reporter: Reporter, *, quick: bool = False, seed: int = 0) -> Stability:
    """Measures every case at every value of its sweep, at eight states from `seed` on.

    With `quick`: two states, chains of up to 1000 links, fewer passes.
    """
    date = datetime.now(timezone.utc).isoformat(timespec="seconds")
    seeds = range(seed, seed + (2 if quick else STATES))
    others, absent = compared(seed)
    found = Stability(quick, seeds, date, machine.describe(), others, absent=absent)
    cases = [
        (one, scenes.extreme(name, value, seed=one))
        for name in scenes.names()
        for value in scenes.extreme(name, seed=seed).values
        if not (quick and name == "long-chain" and value > QUICK_LINKS)
        for one in (seeds if value <= QUICK_LINKS or name != "long-chain" else seeds[:2])
    ]
    tick = reporter.stage("Error of every method", len(cases))
    for one, case in cases:
        if case.name == "zero-inertia" and case.value == 0.0:
            found.singular = _singular(case)
        else:
            found.points.append(_point(case, one, found.peers))
        tick()
    tick = reporter.stage("Error against run time", len(TIMED))
    for name, value in TIMED:
        found.timed += _timed(scenes.extreme(name, value, seed=seed), 200 if quick else 2000)
        tick()
    recursions = [case for one, case in cases if case.scene.nv <= 100 and one < seed + 2]
    tick = reporter.stage("Inverse dynamics, bias and mass matrix", len(recursions))
    for case in recursions:
        found.recursions += _recursions(case)
        tick()
    found.recursions += _falling()
    return found


def _singular(case: scenes.Extreme) -> str:
    try:
        case.scene.forward_dynamics(case.q, case.qd, case.tau)
    except errors.SingularJointError as error:
        return str(error)
    return ""


def _worst(norms: tuple[float, Array], reason: str | None = None) -> Error:
    return Error(norms[0], float(np.max(norms[1], initial=0.0)), reason)


def _point(case: scenes.Extreme, seed: int, others: Sequence[peers.Peer]) -> Point:
    exact = _core.Exact(case.scene, "forward dynamics", case.q, case.qd, case.tau)
    found: dict[tuple[str, str], Error] = {}
    for precision in PRECISIONS:
        for method in _core.FORMS:
            norm, components, reason = exact.error(method, precision)
            found[method, precision] = _worst((norm, components), reason)
    for peer in others:
        found[peer.name, "float64"] = _of_peer(peer, case, exact)
    sensitivity = {kind: _worst(norms) for kind, norms in exact.sensitivity(DRAWS).items()}
    return Point(case.name, case.value, seed, case.scene.nv, sensitivity, found)


def compared(seed: int = 0) -> tuple[list[peers.Peer], list[str]]:
    """The peers to compare with, and a line on each program that is not one of them."""
    others, absent = peers.installed()
    kept, lines = [], list(absent)
    for peer in others:
        off = _off(peer, seed)
        if off <= AGREEMENT:
            kept.append(peer)
        else:
            lines.append(f"{peer.name} ({peer.version}) is off by {off:.0e} on scenes that are not extreme: left out.")
    return kept, lines


def _off(peer: peers.Peer, seed: int) -> float:
    """The peer's largest error on the ordinary scenes that it takes, max-norm; infinite where it takes none."""
    found = []
    for name in ORDINARY:
        case = scenes.extreme(name, 1.0, seed=seed)
        exact = _core.Exact(case.scene, "forward dynamics", case.q, case.qd, case.tau)
        error = _of_peer(peer, case, exact)
        if error.reason in (None, NOT_FINITE):
            found.append(math.inf if error.reason else error.norm)
    return max(found, default=math.inf)


def _of_peer(peer: peers.Peer, case: scenes.Extreme, exact: _core.Exact) -> Error:
    nan = float("nan")
    scene = case.scene
    if peer.gravity is not None:
        # Its own gravity cannot be set: the same scene under that, and the exact answer to that.
        scene = peers.under_gravity(scene, peer.gravity)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            accelerations = peer.solver(scene)(case.q, case.qd, case.tau)
    except peers.Refused as refused:
        return Error(nan, nan, str(refused))
    if not np.all(np.isfinite(accelerations)):
        return Error(nan, nan, NOT_FINITE)
    if peer.gravity is not None:
        exact = _core.Exact(scene, "forward dynamics", case.q, case.qd, case.tau)
    return _worst(exact.difference(accelerations))


def _timed(case: scenes.Extreme, repeats: int) -> list[Timed]:
    exact = _core.Exact(case.scene, "forward dynamics", case.q, case.qd, case.tau)
    rows = []
    for precision in PRECISIONS:
        for method in _core.FORMS:
            norm, components, reason = exact.error(method, precision)
            # The least of some medians: other load only ever adds time.
            ns = min(exact.time(method, precision, repeats) for _ in range(5))
            rows.append(Timed(case.name, case.value, method, precision, ns, _worst((norm, components), reason)))
    return rows


def _recursions(case: scenes.Extreme) -> list[Recursion]:
    return [
        _recursion(quantity, case.name, case.value, case.scene, (case.q, case.qd, case.tau))
        for quantity in _core.QUANTITIES[1:]
    ]


def _recursion(
    quantity: str, name: str, value: float, scene: _core.Scene, state: tuple[Array, Array, Array]
) -> Recursion:
    exact = _core.Exact(scene, quantity, *state)
    norm, components, reason = exact.error(ROOT)
    sensitivity = exact.sensitivity(DRAWS)
    worst = Error(
        max(norms[0] for norms in sensitivity.values()),
        max(float(np.max(norms[1], initial=0.0)) for norms in sensitivity.values()),
    )
    return Recursion(quantity, name, value, _worst((norm, components), reason), worst)


def _falling() -> list[Recursion]:
    """A floating base that falls freely but for a small acceleration: gravity against it cancels in inverse dynamics."""
    rows = []
    case = scenes.extreme("far-base", 1.0)
    scene, q = case.scene, case.q
    turned = scene.placements(q)["base"][:3, :3]
    fall = np.zeros(scene.nv)
    fall[:3] = turned.T @ scene.gravity
    for small in (1.0, 1e-3, 1e-6, 1e-9, 1e-12):
        state = (q, 1e-3 * np.sqrt(small) * case.qd, fall + small * case.tau)
        rows.append(_recursion("inverse dynamics", "free fall", small, scene, state))
    return rows


class Worse(NamedTuple):
    """Where a peer does better."""

    point: Point
    peer: str
    norm: str
    ours: float
    theirs: float
    floor: float


def worse(found: Stability, method: str) -> list[Worse]:
    """Where a peer's error is less than half of the method's, in either norm, which is above rounding and 4 times the sensitivity."""
    rows = []
    for point in found.points:
        error = point.errors[method, "float64"]
        for peer in found.peers:
            other = point.errors[peer.name, "float64"]
            for norm, ours, theirs, floor in (
                ("max-norm", error.norm, other.norm, point.floor),
                ("components", error.component, other.component, point.component_floor),
            ):
                failed = math.isnan(ours) and math.isfinite(theirs)
                if failed or (theirs < 0.5 * ours and ours > max(NOISE[norm], 4.0 * floor)):
                    rows.append(Worse(point, peer.name, norm, ours, theirs, floor))
    return rows


def number(value: float) -> float | None:
    """A number that JSON can hold; None for NaN and infinities."""
    return float(value) if math.isfinite(value) else None


def _error_json(error: Error) -> dict[str, Any]:
    return {"norm": number(error.norm), "component": number(error.component), "reason": error.reason}


def to_json(found: Stability) -> dict[str, Any]:
    """All numbers; None where a method failed, with the reason."""
    return {
        "format": 1,
        "date": found.date,
        "machine": found.machine,
        "quick": found.quick,
        "seeds": list(found.seeds),
        "peers": [peer.version for peer in found.peers],
        "not_compared": list(found.absent),
        "singular": found.singular,
        "cases": [
            {
                "name": point.name,
                "value": point.value,
                "seed": point.seed,
                "degrees_of_freedom": point.nv,
                "sensitivity": {kind: _error_json(error) for kind, error in point.sensitivity.items()},
                "errors": [
                    {"method": method, "precision": precision, **_error_json(error)}
                    for (method, precision), error in point.errors.items()
                ],
            }
            for point in found.points
        ],
        "timed": [
            {"case": row.name, "value": row.value, "method": row.method, "precision": row.precision,
             "ns": row.ns, **_error_json(row.error)}
            for row in found.timed
        ],
        "recursions": [
            {"quantity": row.quantity, "case": row.name, "value": row.value, **_error_json(row.error),
             "sensitivity": _error_json(row.sensitivity)}
            for row in found.recursions
        ],
    }  # fmt: skip
