"""The plots of the stability report: error against the parameter of a case, and against run time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ... import _core
from ..plotting import COLORS, GRAY, Axis, Chart, Panel, Plot, Series, level
from ..text import power
from .measure import AUTO, COVARIANCE, ROOT, TIMED, Point, Stability

ERROR = "relative error of accelerations"
#: Plots against a parameter: file; case, title of the axis, caption.
SWEEPS = {
    "error-against-tip-mass": ("heavy-tip", "mass of the last of 8 links, kg (the others 1 kg)", "Eight links; the mass of the last one increases."),
    "error-against-growth": ("growing-masses", "ratio of the masses of consecutive links (8 links)", "Eight links with increasing masses."),
    "error-against-links": ("long-chain", "links of a nearly straight chain", "A nearly straight chain; dense matrices are formed for at most 1000 links."),
    "error-against-spin": ("spin", "joint velocities, rad/s", "Twelve links with joint velocities up to 1e6 rad/s."),
    "error-against-lever": ("long-lever", "distance between two joints in the middle, m", "Eight links; the distance of two joints increases."),
}


def draw(found: Stability) -> list[Plot]:
    """All plots."""
    return [*(_sweep(found, name, case, label) for name, (case, label, _) in SWEEPS.items()), _against_time(found)]


def _inks(found: Stability) -> dict[str, str]:
    """A color per method. auto is not drawn: its errors equal the errors of the form that it selects."""
    return dict(zip((form for form in _core.FORMS if form != AUTO), COLORS, strict=False)) | {other.name: other.color for other in found.others}


def _sweep(found: Stability, name: str, case: str, label: str) -> Chart:
    """Error of every method against the parameter: left in the max-norm, right per component."""
    points = found.of(case)
    values = [point.value for point in points]
    reach = max(values) / min(values)
    x = Axis.powers(label, min(values) / 1.6, max(values) * max(1.6, reach**0.08), form=".3~g")
    every = [_curves(found, points, norm) for norm in (0, 1)]
    sizes = np.concatenate([np.asarray(one.y, dtype=float) for series in every for one in series])
    sizes = sizes[np.isfinite(sizes) & (sizes > 0.0)]
    # Errors above ten are equally useless.
    y = Axis.powers(ERROR, max(sizes.min() / 3.0, 1e-18), min(sizes.max() * 4.0, 10.0))
    titles = ("max-norm", "per component")
    return Chart(name, [Panel(x, y, series, title) for series, title in zip(every, titles, strict=True)], 2)


def _curves(found: Stability, points: Sequence[Point], norm: int) -> list[Series]:
    x = [point.value for point in points]
    floor = [float(point.floor[norm] or 0.0) for point in points]
    series = [Series("sensitivity of the problem", GRAY, x, floor, line=1.0, dash=True, below=True)]
    for method, ink in _inks(found).items():
        y = np.array([float(point.errors[method][norm] or 0.0) for point in points])
        y = np.where(np.isfinite(y), np.maximum(y, 1e-18), np.nan)
        thick = method in (ROOT, COVARIANCE)
        series.append(Series(method, ink, x, y, line=2.0 if thick else 1.2, mark=7 if thick else 5))
    return series


def _against_time(found: Stability) -> Chart:
    """Time per state against error, one point per method, one panel per case."""
    return Chart("error-against-run-time", [_timed(found, name, value) for name, value in TIMED], 2, 240)


def _timed(found: Stability, name: str, value: float) -> Panel:
    inks = {method: ink for method, ink in _inks(found).items() if method in _core.FORMS}
    rows = found.timed(name, value)
    times = [1e-9 * row.ns for row in rows]
    x = Axis.times("median time per state", min(times) / 1.25, max(times) * 1.25)
    floor = next(point for point in found.of(name) if point.value == value).floor.norm
    series = [level("sensitivity of the problem", floor, x)]
    for row in rows:
        if row.method != AUTO and math.isfinite(row.norm):
            series.append(Series(row.method, inks[row.method], [1e-9 * row.ns], [max(row.norm, 1e-18)], mark=9))
    title = f"{name}, {f'{value:g}' if 1e-2 <= value < 1e4 else power(round(math.log10(value)))}"
    return Panel(x, Axis.powers(ERROR, 1e-17, 1e2), series, title)
