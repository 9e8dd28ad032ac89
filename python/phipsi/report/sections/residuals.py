"""Identities of the theory, each evaluated in two ways, with bounds of the difference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ... import _core
from ..._core import Scene
from ..pipeline import Section
from ..progress import Reporter
from ..robot import EPS, Report
from ..states import Array, States

#: Bound of the residuals in units of eps times size or condition number.
SLACK = 64.0


@dataclass(frozen=True)
class Residual:
    """One identity over all states."""

    name: str
    median: float
    worst: float
    bound: float
    """Bound at the state with the largest residual relative to its bound."""
    worst_in_bounds: float
    """Largest residual relative to its bound."""
    bound_grows_with_condition: bool
    """Whether the bound is 64 cond(M) eps; otherwise 64 nv eps."""

    @property
    def passed(self) -> bool:
        """Whether the identity holds; false for NaN."""
        return self.worst_in_bounds <= 1.0

    @property
    def _marks(self) -> tuple[float, ...]:
        """Median, maximum and bound on a logarithmic scale from 1e-18 to 1e-6, in 182 units."""
        values = np.array([self.median, self.worst, self.bound])
        decades = np.log10(np.maximum(np.where(np.isfinite(values), values, 1.0), 1e-30)) + 18.0
        return tuple(4.0 + 182.0 * np.clip(decades, 0.0, 12.0) / 12.0)


def residuals(scene: Scene, states: States, conditions: Array, reporter: Reporter) -> list[Residual]:
    """Every identity at every state, with its bound; `conditions`: cond(M) of each state."""
    values: dict[str, list[float]] = {}
    grows: dict[str, bool] = {}
    for q, qd, tau in reporter.each("Residuals", list(zip(*states.arrays, strict=True))):
        for name, value, through_inverse in _core.residuals(scene, q, qd, tau):
            values.setdefault(name, []).append(value)
            grows[name] = through_inverse
    by_size = np.full(len(states), SLACK * scene.nv * EPS)
    # cond(M) of a small matrix can be below its size; then the bound for sums of nv terms applies.
    by_condition = np.maximum(by_size, SLACK * conditions * EPS)
    return [residual(name, np.array(v), by_condition if grows[name] else by_size, grows[name]) for name, v in values.items()]


def residual(name: str, values: Array, bounds: Array, through_inverse: bool) -> Residual:
    """One identity from its residuals and bounds at all states."""
    ratios = values / bounds
    # argmax returns the index of a NaN, if there is one.
    at = int(np.argmax(ratios))
    return Residual(name, float(np.median(values)), float(values.max()), float(bounds[at]), float(ratios[at]), through_inverse)


def _collect(report: Report, reporter: Reporter) -> list[Residual]:
    report.needs_dense()
    few = report.solvable.first(report.effort.residual_states)
    return residuals(report.scene, few, report.conditions[: len(few)], reporter)


SECTION = Section("residuals", "Checks of the theory", _collect, empty=[])
