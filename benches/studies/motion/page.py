"""Motion report: its sections with texts, tables and plots."""

from __future__ import annotations

from pathlib import Path

from phipsi.report.page import Block, Figure, flowed
from phipsi.report.pipeline import Layout, Section, provenance
from phipsi.report.progress import Reporter

from . import figures, horizon, plots, prose, sweep
from .collect import Study, results
from .plots import file_name
from .reference import FAR
from .timing import BATCH


def _losses(study: Study) -> list[Block]:
    texts = [
        figures.explicit(study),
        prose.NO_INVARIANTS,
        figures.third_order(study),
        figures.adaptive_wins(study),
        *figures.beside_peers(study),
    ]
    if any(peer.program == "Pinocchio" for peer in study.peers):
        texts.append(flowed(prose.PINOCCHIO_TIME))
    if study.absent:
        texts.append(f"Not compared: {' '.join(study.absent)}")
    refused = [f"{result.case.name}: {text}" for result in study.results for text in result.refused]
    if refused:
        texts.append(f"Scenes that a peer does not support: {'; '.join(refused)}.")
    return [text for text in texts if text]


def _if_peers(study: Study, text: str) -> list[Block]:
    return [flowed(text)] if study.peers else []


def _horizon(study: Study) -> list[Block]:
    seen, first = study.horizon, study.results[0]
    agreed, there = figures.error_text(horizon.AGREED), figures.error_text(first.exact.error)
    return [
        flowed(prose.HORIZON, agreed=agreed, horizon=seen.end, end=first.case.time, there=there),
        Figure("horizon", flowed(prose.HORIZON_CAPTION, directions=horizon.DIRECTIONS, moved=horizon.MOVED)),
    ]


def _smooth(study: Study) -> list[Block]:
    pictures = [
        Figure(file_name(result), f"{result.case.name}: {result.case.what}; {result.case.time:g} s.") for result in study.smooth
    ]
    return [flowed(prose.SMOOTH), *_if_peers(study, prose.SMOOTH_PEERS), *pictures]


def _stiff(study: Study) -> list[Block]:
    return [
        flowed(prose.STIFF),
        Figure("work-precision-springs", flowed(prose.SPRINGS_CAPTION)),
        Figure("work-precision-other-stiff", flowed(prose.OTHERS_CAPTION)),
        *_if_peers(study, prose.MUJOCO_DAMPERS),
        figures.ringing(study),
        flowed(prose.LARGEST_STEP),
        figures.largest_steps(study),
    ]


def _orders(study: Study) -> list[Block]:
    most = figures.error_text(sweep.RINGING[study.quick])
    return [
        prose.SMOOTH_ORDERS,
        figures.smooth_orders(study),
        flowed(prose.STIFF_ORDERS),
        figures.stiff_orders(study),
        flowed(prose.RATE_ORDERS),
        figures.stiff_orders(study, rates=True),
        "Between soft and stiff, two rods with one spring:",
        Figure("stiffness", flowed(prose.STIFFNESS_CAPTION, far=FAR, most=most)),
    ]


def _drift(study: Study) -> list[Block]:
    return [
        Figure("drift", flowed(prose.DRIFT_CAPTION)),
        prose.DRIFT_ORDERS,
        figures.drift_orders(study),
    ]


def _times(study: Study) -> list[Block]:
    return [flowed(prose.TIMES, batch=BATCH), figures.step_times(study)]


def _references(study: Study) -> list[Block]:
    return [flowed(prose.REFERENCES, far=FAR), *_if_peers(study, prose.REFERENCES_PEERS), figures.references(study)]


def _seen(study: Study, reporter: Reporter) -> horizon.Horizon:
    (seen,) = map(horizon.measure, reporter.each("Horizon of comparability", [study.results[0].case]))
    return seen


MOTION: Layout[Study] = Layout(
    "motion",
    "report.json",
    (
        Section("losses", "Cases in which another method is better", blocks=_losses),
        Section("cases", "Scenes", results, blocks=lambda study: [figures.scenes(study)]),
        Section("horizon", "Horizon of comparability", _seen, lambda study: [plots.horizon_plot(study)], _horizon),
        Section("smooth", "Error against step and run time, smooth scenes", plots=plots.smooth, blocks=_smooth),
        Section("stiff", "Error against step and run time, stiff scenes", plots=plots.stiff, blocks=_stiff),
        Section("springs", "Order of convergence", sweep.sweep, lambda study: [plots.stiffness(study)], _orders),
        Section("drift", "Drift of energy and momentum", plots=lambda study: [plots.drift(study)], blocks=_drift),
        Section("times", "Time per step", blocks=_times),
        Section("references", "References", blocks=_references),
        provenance(),
    ),
    templates=(Path(__file__).parents[1] / "templates",),
)
