"""The report on a scene: figures, plots and one HTML page."""

from __future__ import annotations

from pathlib import Path

from .. import _core
from . import draw, emergence_plots, page, plots
from .collect import Report, collect, to_json
from .figure import Plot
from .files import write_folder
from .progress import Reporter, Silent

__all__ = ["Report", "collect", "to_json", "write"]


def write(report: Report, directory: Path, reporter: Reporter | None = None) -> Path:
    """Writes index.html, report.json and the plots into `directory`, made where missing; returns the page's path."""
    drawn = _plots(report, reporter or Silent())
    q, caption = draw.pose(report.scene, report.tree)
    skeleton = draw.skeleton(report.scene, report.tree, q)
    index = write_folder(directory, page.page(report, skeleton, caption, drawn), ("report.json", to_json(report)), drawn)
    (directory / "skeleton.svg").write_text(skeleton, encoding="utf-8")
    return index


def _plots(report: Report, reporter: Reporter) -> list[Plot]:
    drawn = []
    tick = reporter.stage("Drawing", 6)
    if any(row.failed < len(row.errors) for row in report.accuracy):
        drawn.append(plots.error_against_time(report.accuracy, _core.METHODS))
        tick()
        if report.conditions.size:
            drawn.append(plots.error_against_condition(report.accuracy, report.conditions, _core.METHODS))
            tick()
    if report.mass_matrix is not None:
        drawn.append(plots.mass_matrix(report.mass_matrix))
        tick()
    if report.emergence is not None and report.emergence.sampled:
        drawn.append(emergence_plots.error_against_time(report.emergence))
        tick()
        drawn.append(emergence_plots.error_against_samples(report.emergence))
        tick()
    drawn.append(plots.growth(report.growth))
    tick()
    return drawn
