"""Motion study: error against step and run time, orders and drifts of every fixed-step method, compared with the
installed peers.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from phipsi.report import pipeline
from phipsi.report.progress import Reporter
from phipsi.report.timing import threads

import static

from . import peers
from .collect import Study
from .page import MOTION

__all__ = ["MOTION", "Study", "collect", "to_json", "write"]


def collect(reporter: Reporter, *, quick: bool = False) -> Study:
    """Measure every case. With `quick`: fewer steps, tolerances and springs."""
    with threads(1):
        return pipeline.collect(MOTION, Study(quick, *peers.installed()), reporter)


def to_json(study: Study) -> dict[str, Any]:
    """All values; None for failed runs, with the reason."""
    return pipeline.to_json(MOTION, study)


def write(study: Study, folder: Path | None, markdown: Path | None = None, reporter: Reporter | None = None) -> list[Path]:
    """Write the folder and the Markdown, if requested; return the pages."""
    return pipeline.write(MOTION, study, folder, markdown, reporter, static.draw)
