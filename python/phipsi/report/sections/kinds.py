"""Forward dynamics in typical states: time of form auto, and its accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ... import _core, errors
from ..._core import Scene
from .. import auto_cost, kinds
from ..kinds import Drawn
from ..pipeline import Section
from ..progress import Reporter
from ..robot import FORWARD, Report, median
from ..timing import Of


def kind_errors(scene: Scene, drawn: Drawn, kind: str, count: int) -> dict[str, tuple[float, float]]:
    """Median and largest error of the first `count` states, from Python, by form ("auto" and "covariance"); empty if
    they raise.

    The error of a state is the largest error of an acceleration, compared with double-double arithmetic,
    relative to the largest acceleration or to the largest acceleration from the bias torque alone, whichever is
    larger: in static equilibrium the accelerations vanish.
    """
    q, qd, tau = (values[:count] for values in kinds.state(scene, drawn, kind))
    try:
        exact = _core.reference(scene, q, qd, tau).toarray()
        alone = scene.forward_dynamics(q, qd, np.zeros_like(tau))
        answers = {form: scene.forward_dynamics(q, qd, tau, form=form) for form in auto_cost.FORMS}  # type: ignore[call-overload]
    except errors.PhipsiError:
        return {}
    scale = np.maximum(np.abs(exact), np.abs(alone)).max(axis=1)
    found = {}
    for form, values in answers.items():
        off = np.abs(values - exact).max(axis=1)
        relative = np.divide(off, scale, out=np.zeros_like(off), where=off > 0.0)
        found[form] = median(relative), float(relative.max())
    return found


def _collect(report: Report, reporter: Reporter) -> list[dict[str, Any]]:
    if "calls" in report.missing:
        return []
    rows = []
    for kind in reporter.each("Form auto by kind of state", kinds.KINDS):
        errors_of = kind_errors(report.scene, report.batch, kind, report.effort.states)
        for cost in auto_cost.of_kind(report.scene, report.batch, kind, report.quick):
            for form, ns, ratio in (("auto", cost.auto, cost.ratio), ("covariance", cost.covariance, 1.0)):
                middle, worst = errors_of.get(form, (None, None))
                about = {"meaning": kinds.MEANING[kind], "ns_per_state": ns, "ns_over_covariance": ratio, "error_median": middle}
                rows.append({"of": Of("Python", FORWARD, form, kind, cost.batch), **about, "error_max": worst})
    return rows


def _shown(report: Report) -> Sequence[dict[str, Any]]:
    """One row per kind that was measured in every form and size: auto and covariance, one state per call and a
    batch.
    """
    found = []
    for kind, meaning in kinds.MEANING.items():
        mine = {(row["of"].form, row["of"].batch > 1): row for row in report.parts["kinds"] if row["of"].states == kind}
        if len(mine) == 4:
            one, many, covariance = mine["auto", False], mine["auto", True], mine["covariance", True]
            found.append({"kind": kind, "meaning": meaning, "one": one, "many": many, "covariance": covariance})
    return found


SECTION = Section("kinds", "Forward dynamics in typical states", _collect, shown=_shown, empty=[])
