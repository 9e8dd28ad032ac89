"""The report on a scene: figures, plots and one HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .._core import Scene
from . import pipeline
from .progress import Reporter
from .robot import Report
from .sections import ROBOT

__all__ = ["Report", "collect", "to_json", "write"]


def collect(
    scene: Scene,
    reporter: Reporter,
    *,
    name: str,
    source: str,
    warnings: Sequence[str] = (),
    quick: bool = False,
    count: int | None = None,
    seed: int = 0,
) -> Report:
    """Measures a scene; what it cannot have is noted in `missing`."""
    return pipeline.collect(ROBOT, Report(quick, name, source, scene, seed, count, warnings), reporter)


def to_json(report: Report) -> dict[str, Any]:
    """All numbers of a report; None where a method failed, and where a part is missing."""
    return pipeline.to_json(ROBOT, report)


def write(report: Report, directory: Path, reporter: Reporter | None = None) -> Path:
    """Writes index.html, report.json and the plots into `directory`, made where missing; returns the page's path."""
    return pipeline.write(ROBOT, report, directory, reporter=reporter)[0]
