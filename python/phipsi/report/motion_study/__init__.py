"""The motion report: error against step and run time, orders and drifts of every fixed-step method, beside the peers installed."""

from __future__ import annotations

from pathlib import Path

from ..files import write_folder, write_page
from . import page, plots
from .collect import Study, collect, to_json

__all__ = ["Study", "collect", "write", "write_markdown"]


def write(found: Study, directory: Path) -> Path:
    """Writes index.html, report.json and the plots into `directory`, made where missing; returns the page's path."""
    drawn = plots.draw(found)
    return write_folder(directory, page.html(found, drawn), ("report.json", to_json(found)), drawn)


def write_markdown(found: Study, path: Path) -> Path:
    """Writes the same page as Markdown, its plots beside it; returns the path."""
    drawn = plots.draw(found)
    return write_page(path, page.markdown(found, drawn, path.stem), drawn)
