"""Stability report of phipsi with other programs, beginning with the cases in which phipsi is less accurate:
docs/measured/numerics.md.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from phipsi import _core, scenes
from phipsi.report import pipeline
from phipsi.report.page import Block, Table
from phipsi.report.pipeline import Layout, Section
from phipsi.report.progress import Reporter
from phipsi.report.stability import STABILITY, Stability
from phipsi.report.stability.measure import COVARIANCE, ROOT, Error, Other, Point, exact_of
from phipsi.report.stability.tables import error, number

import static

from . import programs
from .programs import Peer

#: Results of a peer are shown if its error is below this on the cases below at parameter 1, where nothing is extreme.
AGREEMENT = 1e-10
ORDINARY = ("heavy-tip", "prismatic-chain", "heavy-leaves", "armature", "far-base")
NOT_FINITE = "a result is not finite"
#: Errors below these, max-norm and per component, count as rounding and are not compared.
NOISE = {"max-norm": 1e-15, "components": 1e-14}


def error_of(peer: Peer, case: scenes.Extreme, exact: _core.Exact) -> Error:
    """Error of a peer on one case; or the reason if it does not support it."""
    nan, scene = float("nan"), case.scene
    if peer.gravity is not None:
        # Its gravity cannot be set: the scene and the exact result use its gravity.
        scene = programs.under_gravity(scene, peer.gravity)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            accelerations = peer.solver(scene)(case.q, case.qd, case.tau)
    except programs.Refused as refused:
        return Error(nan, nan, str(refused))
    if not np.all(np.isfinite(accelerations)):
        return Error(nan, nan, NOT_FINITE)
    if peer.gravity is not None:
        exact = exact_of(case._replace(scene=scene))
    return Error.of(*exact.difference(accelerations))


def compared(seed: int = 0) -> tuple[list[Other], list[str]]:
    """Peers of the comparison, and a line on each program that is not included."""
    peers, absent = programs.installed()
    kept, lines = [], list(absent)
    for peer in peers:
        off = _off(peer, seed)
        if off <= AGREEMENT:
            kept.append(Other(peer.name, peer.version, peer.color, partial(error_of, peer)))
        else:
            lines.append(f"{peer.name} ({peer.version}) has an error of {off:.0e} on scenes that are not extreme: omitted.")
    return kept, lines


def _off(peer: Peer, seed: int) -> float:
    """Largest max-norm error of the peer on the ordinary scenes that it supports; infinite if it supports none."""
    errors = []
    for name in ORDINARY:
        case = scenes.extreme(name, 1.0, seed=seed)
        found = error_of(peer, case, exact_of(case))
        if found.reason in (None, NOT_FINITE):
            errors.append(math.inf if found.reason else found.norm)
    return max(errors, default=math.inf)


@dataclass
class Compared(Stability):
    """Stability of phipsi and of its peers."""

    absent: Sequence[str] = ()
    """A line on each program that was not compared: not installed, or wrong on an ordinary scene."""

    def head(self) -> dict[str, Any]:
        """Provenance, including programs that were not compared."""
        return {**super().head(), "not_compared": self.absent}


class Worse(NamedTuple):
    """Cases in which a peer is more accurate."""

    point: Point
    peer: str
    norm: str
    ours: float
    theirs: float
    floor: float


def _pairs(found: Stability, method: str) -> list[Worse]:
    """Errors of the method and of every peer, in both norms."""
    rows = []
    for point in found.points:
        mine, floor = point.errors[method], point.floor
        for peer in found.others:
            other = point.errors[peer.name]
            rows.append(Worse(point, peer.name, "max-norm", mine.norm, other.norm, floor.norm))
            rows.append(Worse(point, peer.name, "components", mine.component, other.component, floor.component))
    return rows


def worse(found: Stability, method: str) -> list[Worse]:
    """Cases in which a peer's error is less than half of the method's, in either norm, if the latter is above rounding
    and 4 times the sensitivity.
    """
    return [
        row for row in _pairs(found, method)
        if (math.isnan(row.ours) and math.isfinite(row.theirs))
        or (row.theirs < 0.5 * row.ours and row.ours > max(NOISE[row.norm], 4.0 * row.floor))
    ]  # fmt: skip


def _table(found: Stability, method: str) -> Table:
    """A row per case, peer and norm: number of states, and the state with the largest ratio."""
    grouped: dict[tuple[str, str, str], list[Worse]] = {}
    for row in worse(found, method):
        grouped.setdefault((row.point.name, row.peer, row.norm), []).append(row)
    rows = []
    for (name, peer, norm), group in grouped.items():
        states = [point for point in found.points if point.name == name and point.errors[peer].reason is None]
        top = max(group, key=lambda row: math.inf if math.isnan(row.ours) else row.ours / max(row.theirs, 1e-18))
        numbers = map(error, (top.ours, top.theirs, top.floor))
        rows.append([name, peer, norm, f"{len(group)} of {len(states)}", number(top.point.value), *numbers])
    return Table(("case", "peer", "norm", "states", "furthest at", "phipsi", "the peer", "sensitivity"), rows, 3)


def _words(found: Stability, method: str) -> str:
    """A sentence that compares the method with the peers, by counts."""
    if not found.others:
        return f"No peer was compared: the {method} is compared with dense algebra only."
    pairs = [row for row in _pairs(found, method) if row.point.errors[row.peer].reason is None]
    ahead = sum(row.ours < 0.5 * row.theirs and row.theirs > NOISE[row.norm] for row in pairs)
    versions = ", ".join(dict.fromkeys(other.version for other in found.others))
    return (
        f"In {len(worse(found, method))} of {len(pairs)} comparisons with {versions} (every case, value, state and peer, in two norms), the error of the {method} is"
        f" larger: more than twice that of the peer, above four times the sensitivity, and above"
        f" {NOISE['max-norm']:.0e} (max-norm) or {NOISE['components']:.0e} (per component). In {ahead} comparisons it is less than half of"
        f" that of the peer."
    )


def _blocks(found: Compared) -> list[Block]:
    absent = " ".join(["Not compared:", *found.absent]) if found.absent else "All supported peers were compared."
    times = "make bench measures times in comparison with Pinocchio in C++; they are not part of this report."
    refusals = (
        "A dash in the column of phipsi is an error: the covariance form detects a pivot below the rounding error and raises, naming the joint, where"
        " the peer returns a result with the given error. It counts as a larger error."
    )
    return [
        f"{_words(found, ROOT)} {absent} {times}", _table(found, ROOT), _words(found, COVARIANCE), _table(found, COVARIANCE), refusals
    ]


WORSE = Section("worse", "Cases in which a peer is more accurate", blocks=_blocks)
COMPARED: Layout[Compared] = Layout(
    "compared", STABILITY.numbers, (WORSE, *STABILITY.sections), (Path(__file__).with_name("templates"),)
)


def collect(reporter: Reporter, *, quick: bool = False, seed: int = 0) -> Compared:
    """Stability report with every installed program."""
    others, absent = compared(seed)
    return pipeline.collect(COMPARED, Compared(quick, seed, others, absent), reporter)


def write(found: Compared, folder: Path | None, markdown: Path | None = None, reporter: Reporter | None = None) -> list[Path]:
    """Write the folder and the Markdown, if requested; return the pages."""
    return pipeline.write(COMPARED, found, folder, markdown, reporter, static.draw)
