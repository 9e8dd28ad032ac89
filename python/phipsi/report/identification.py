"""The page of an identification: measured and predicted torques, residuals, parameters with intervals, and what cannot be known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .._core import Scene
from ..estimation._identification import DECIDED, Identification, predicted
from .page import Block, Figure, Table
from .pipeline import Findings, Layout, Section, html, provenance
from .plotting import COLORS, GRAY, Axis, Chart, Panel, Series
from .states import Array

#: Rows that curves show, and base parameters that the page lists.
MOST_ROWS, MOST_BASE = 1500, 200
#: Pieces of the residual that its spectrum is averaged over; points of a residual, bins of speed that it is averaged over,
#: least number of states of a bin, and lags of its autocorrelation.
PIECES = 8
POINTS, BINS, OF_BIN, LAGS = 600, 24, 5, 200


@dataclass
class IdentificationReport(Findings):
    """An identification, and the log that it is compared with."""

    name: str
    model: Any
    """The scene before."""
    found: Identification
    time: Array
    """Times of the rows, (k,), s; their indices where the log has none."""
    measured: Array
    """Measured torques, (k, motors)."""
    predicted: Array
    """Torques of the identified parameters."""
    before: Array
    """Torques of the model."""
    speeds: Array
    """Velocities of the motors, (k, motors)."""
    held_out: int
    """The first row that was not fitted; k where all were."""
    level: float = 0.95

    @classmethod
    def of(cls, name: str, found: Identification, log: tuple[Array, Array, Array, Array], time: Array | None, held_out: int) -> IdentificationReport:
        """The report of an identification and a log q, qd, qdd, tau."""
        (q, qd, qdd, tau), columns = log, found.columns
        model = np.append(columns.own[columns.free].ravel(), [extra.model for extra in columns.extras])
        time = np.arange(len(q), dtype=float) if time is None else time
        before = predicted(columns, model, q, qd, qdd)
        return cls(False, name, columns.scene, found, time, columns.measured(q, tau), found.torques(q, qd, qdd), before, columns.rates(qd), held_out)

    def head(self) -> dict[str, Any]:
        found = self.found
        low, high = found.interval(self.level)
        return {
            "name": self.name, "states": found.states, "known": found.known, "blocks": found.blocks, "noise": found.noise, "parameters": found.parameters, "low": low, "high": high,
            "share": found.share, "joints": found.joints, "explained": self.explained(slice(0, self.held_out)),
            "explained_held_out": self.explained(slice(self.held_out, None)) if self.held_out < len(self.time) else None,
        }  # fmt: skip

    @property
    def motors(self) -> list[str]:
        return self.found.columns.motor_names

    def explained(self, rows: slice, predicted: Array | None = None) -> Array:
        """The share of the variance of measured torques that is explained, (motors,)."""
        measured, off = self.measured[rows], self.measured[rows] - (self.predicted if predicted is None else predicted)[rows]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(1.0 - np.nanmean(off**2, axis=0) / np.nanvar(measured, axis=0))


def _torques(report: IdentificationReport) -> Chart:
    rows = _chosen(len(report.time), MOST_ROWS)
    fitted, held = rows[rows < report.held_out], rows[rows >= report.held_out]
    panels = []
    for motor, name in enumerate(report.motors):
        series = [
            Series("measured", GRAY, report.time[rows], report.measured[rows, motor], line=1.2),
            Series("identified, fitted part", COLORS[0], report.time[fitted], report.predicted[fitted, motor], line=1.4),
        ]
        if len(held):
            series.append(Series("identified, held-out part", COLORS[2], report.time[held], report.predicted[held, motor], line=1.4))
        series.append(Series("model before", COLORS[4], report.time[rows], report.before[rows, motor], line=1.0, dash=True))
        panels.append(Panel(Axis("time, s", form=".4~g", unit=" s"), Axis(force_unit(report.found.scene, [name]), form=".4~g"), series, name))
    return Chart("torques", panels, height=170, linked=True)


def _chosen(count: int, most: int) -> Any:
    """Indices of some of the rows, equidistant."""
    return np.unique(np.linspace(0, count - 1, most).round().astype(int))


def _residuals(report: IdentificationReport) -> Chart:
    """Of each motor: over time, its autocorrelation, and over the speed of the motor with the mean of bins."""
    off, panels = report.measured - report.predicted, []
    step = float(np.median(np.diff(report.time))) if len(off) > 1 else 1.0
    rows = _chosen(len(off), POINTS)
    for motor, name in enumerate(report.motors):
        own, speed = off[:, motor], report.speeds[:, motor]
        seen = np.isfinite(own)
        if not seen.any():
            continue
        y, series = Axis(force_unit(report.found.scene, [name]), form=".3~g"), [Series("residual", COLORS[0], report.time[rows], own[rows], line=0.8)]
        panels.append(Panel(Axis("time, s", form=".4~g", unit=" s"), y, series, name))
        values, bound = _autocorrelation(own)
        ends = [0.0, step * (len(values) - 1)]
        series = [Series("autocorrelation", COLORS[1], step * np.arange(len(values), dtype=float), values, line=1.3)]
        series += [Series("95 % of white noise", GRAY, ends, [sign * bound] * 2, line=1.0, dash=True, told=False) for sign in (-1.0, 1.0)]
        panels.append(Panel(Axis("lag, s", form=".4~g", unit=" s"), Axis("", -1.05, 1.05, form=".3~g"), series))
        series = [Series("residual", COLORS[0], speed[rows], own[rows], mark=3.0, shade=0.4)]
        # Bins of equal numbers of states.
        order = np.argsort(speed[seen])
        bins = [part for part in np.array_split(order, BINS) if len(part) >= OF_BIN]
        if bins:
            middle, mean = (np.array([float(np.mean(of[seen][part])) for part in bins]) for of in (speed, own))
            series.append(Series("mean by speed", COLORS[2], middle, mean, line=2.0, mark=5.0))
        panels.append(Panel(Axis("speed, rad/s or m/s", form=".3~g"), Axis("", form=".3~g"), series))
    return Chart("residuals", panels, columns=3, height=170)


def _autocorrelation(values: Array) -> tuple[Array, float]:
    """Autocorrelation of values about their mean, NaN omitted, and its bound for white noise."""
    seen = np.isfinite(values)
    rest = np.where(seen, values - np.mean(values[seen]), 0.0)
    lags = range(min(LAGS, max(1, len(values) // 4)))
    squares = float(rest @ rest) or 1.0
    return np.array([rest[: len(rest) - lag] @ rest[lag:] for lag in lags]) / squares, 1.96 / float(np.sqrt(seen.sum()))


def _fit(report: IdentificationReport) -> Sequence[Block]:
    found, fitted = report.found, slice(0, report.held_out)
    held = report.held_out < len(report.time)
    columns = [found.noise, found.before, found.after, report.explained(fitted, report.before), report.explained(fitted)]
    torque = force_unit(found.scene, report.motors)
    heads = ["motor", f"noise, {torque}", f"rms off before, {torque}", f"rms off after, {torque}", "explained before", "explained"]
    if held:
        columns.append(report.explained(slice(report.held_out, None)))
        heads.append("explained, held out")
    rows = [(name, *(f"{value:.3g}" for value in values)) for name, *values in zip(report.motors, *columns, strict=True)]
    blocks: list[Block] = [Table(heads, rows, 1)]
    if held:
        blocks.append(f"The last {len(report.time) - report.held_out} of {len(report.time)} states were not fitted: the held-out part shows how well other motions are predicted.")
    if np.isfinite(found.clock_offset):
        blocks.append(f"The residuals indicate that the torques lag the positions by {1e3 * found.clock_offset:.3g} ms.")
    return blocks


def units(scene: Scene, name: str) -> dict[str, str]:
    """Units of the parameters of a joint or motor by kind; a name of several joints is that of a motor that rotates."""
    moves = scene.joint(name).type == "prismatic" if name in scene.joint_names else False
    force, rate = ("N", "m/s") if moves else ("N m", "rad/s")
    of_rate = "N s/m" if moves else "N m s/rad"
    return {
        "armature": "kg" if moves else "kg m²", "damping": of_rate, "stiffness": "N/m" if moves else "N m/rad", "friction": force, "offset": force, "stribeck": force,
        "stribeck_speed": rate, "load": "",
    }  # fmt: skip


def force_unit(scene: Scene, motors: Sequence[str]) -> str:
    """Unit of the torques or forces of motors."""
    return " or ".join(dict.fromkeys(units(scene, motor)["friction"] for motor in motors))


def with_unit(scene: Scene, kind: str, names: Sequence[str]) -> str:
    """A kind of parameter of joints or motors with its unit."""
    return ", ".join(filter(None, (kind, " or ".join(dict.fromkeys(units(scene, name).get(kind, "") for name in names)))))


#: Units of the ten parameters of a body.
OF_BODIES = ("kg", "kg m", "kg m", "kg m", "kg m²", "kg m²", "kg m²", "kg m²", "kg m²", "kg m²")


def _of_base(name: str) -> str:
    """Unit of a base parameter, by the name of its first parameter."""
    entry = name.rpartition(".")[2]
    return "kg" if entry == "m" else "kg m" if entry.startswith("m*c") else "kg m²" if entry.startswith("I") else ""


def _with_bar(value: float, low: float, high: float) -> str:
    return f"{value:.4g} ± {0.5 * (high - low):.2g}"


def _parameters(report: IdentificationReport) -> Sequence[Block]:

    found, model = report.found, report.model.inertial_parameters
    low, high = found.interval(report.level)
    (marks, of_joints), intervals = found.marks(report.level), found.joint_interval(report.level)
    names = ("m", "m cx", "m cy", "m cz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
    rows = []
    for body, link in enumerate(found.scene.body_names):
        for at, entry in enumerate(names):
            share = found.share[body, at]
            by = "kept" if not np.isfinite(share) else _by_data(share, marks[body, at])
            rows.append((link if at == 0 else "", f"{entry}, {OF_BODIES[at]}", f"{model[body, at]:.4g}", _with_bar(found.parameters[body, at], low[body, at], high[body, at]), by))
    blocks: list[Block] = [
        f"Intervals of {100 * report.level:g} %, about the link's origin. The last column is the share of the variance that the data decide: below {DECIDED} the interval is that of the prior. \"Too wide\": the interval reaches below zero, where the parameter cannot be.",
        Table(("link", "parameter", "model", "identified", "decided by data"), rows, 2),
    ]
    if any(found.joints.values()):
        each = [
            (motor, with_unit(found.scene, kind, [motor]), _with_bar(value, *intervals[kind][motor]), _by_data(found.joint_share[kind][motor], of_joints[kind][motor]))
            for kind, values in found.joints.items()
            for motor, value in values.items()
        ]
        blocks.append(Table(("motor", "kind", "identified", "decided by data"), each, 2))
    return blocks


def _by_data(share: float, mark: str) -> str:
    return f"{share:.2f}" + (", prior" if "*" in mark else "") + (", too wide" if "!" in mark else "")


def _base(report: IdentificationReport) -> Sequence[Block]:
    base = report.found.base
    low, high = base.interval(report.level)
    rows = []
    for at in range(min(len(base.names), MOST_BASE)):
        bias = "" if not np.isfinite(base.bias[at]) else f"{base.bias[at] / base.deviations[at]:.2g}"
        rows.append((base.combination(at), _of_base(base.names[at]) or "SI", f"{base.model[at]:.4g}", _with_bar(base.values[at], low[at], high[at]), bias))
    return [
        f"Torques depend on {len(base.names)} combinations of the parameters alone. These are their least-squares estimates, without the prior. The last column is the predicted bias by noise in the accelerations, in standard deviations.",
        Table(("combination", "unit", "model", "identified", "bias"), rows, 2),
    ]


def _spectrum(report: IdentificationReport) -> Chart:
    off = np.nan_to_num(report.measured - report.predicted)
    length = len(off) // PIECES
    steps = np.diff(report.time)
    step = float(np.median(steps)) if len(steps) else 1.0
    window = np.hanning(length)[:, None]
    power = np.mean([np.abs(np.fft.rfft(window * off[at * length : (at + 1) * length], axis=0)) ** 2 for at in range(PIECES)], axis=0)
    power = 2.0 * step * power / np.sum(window**2)
    frequency = np.asarray(np.fft.rfftfreq(length, step), float)
    series = [Series(name, COLORS[at % len(COLORS)], frequency[1:], np.maximum(power[1:, at], 1e-300), line=1.3) for at, name in enumerate(report.motors)]
    high, low = float(power[1:].max()), float(power[1:].min())
    y = Axis.powers("power spectral density, (N m)²/Hz", max(low, 1e-9 * high) / 2, 2 * high)
    return Chart("spectrum", [Panel(Axis.powers("frequency, Hz", float(frequency[1]), float(frequency[-1])), y, series)], height=300)


def _spectra(report: IdentificationReport) -> list[Chart]:
    return [_spectrum(report)] if len(report.time) >= 16 * PIECES and np.any(report.measured != report.predicted) else []


def _unknown(report: IdentificationReport) -> Sequence[Block]:
    found = report.found
    undecided: dict[str, list[str]] = {}
    for link, entry in found.undecided():
        undecided.setdefault(link, []).append(entry)
    total = found.columns.width
    count = sum(map(len, undecided.values()))
    blocks: list[Block] = [
        f"Of {found.columns.width} parameters the motion determines {found.known} combinations; {count} of {total} single parameters of bodies and joints are not decided by the data. "
        "No experiment at the joints can separate them: they appear in torques only together with others. Their intervals are those of the prior.",
    ]
    if undecided:
        blocks.append(Table(("link", "not decided by the data"), [(link, ", ".join(entries)) for link, entries in undecided.items()], 2))
    infinite = [name for name, deviation in zip(found.base.names, found.base.deviations, strict=True) if not np.isfinite(deviation)]
    if infinite:
        blocks.append(f"This log does not determine, but another one could: {', '.join(infinite)}. Scene.excitation plans one.")
    return blocks


REPORT: Layout[IdentificationReport] = Layout(
    "identification",
    "identification.json",
    (
        Section("fit", "How well torques are explained", blocks=_fit),
        Section("torques", "Measured and predicted torques", plots=lambda report: [_torques(report)], blocks=lambda _: [Figure("torques", "A click on a name hides its curve.")]),
        Section(
            "residuals", "Residuals", plots=lambda report: [_residuals(report)],
            blocks=lambda _: [Figure("residuals", "Measured minus identified torques: over time, their autocorrelation, and over speed. A mean that depends on speed is a wrong friction model: a step at zero is dry friction, a peak there Stribeck friction, a slope damping, and a different size on either side asymmetric friction.")],
        ),
        Section("parameters", "Parameters with intervals", blocks=_parameters),
        Section("base", "Base parameters", blocks=_base),
        Section(
            "spectrum", "Spectrum of the residuals", plots=_spectra,
            blocks=lambda _: [Figure("spectrum", "White residuals are flat. Peaks are missing parts of the model; intervals take both into account.")],
        ),
        Section("unknown", "Unidentifiable parameters", blocks=_unknown),
        provenance(),
    ),
)  # fmt: skip


def write_page(file: Path, report: IdentificationReport) -> Path:
    """Write the page as one file."""
    file.write_text(html(replace(REPORT, numbers=""), report), encoding="utf-8")
    return file
