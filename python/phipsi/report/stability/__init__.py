"""The stability report: the error of every form, of dense algebra and of the peers installed, on the extreme scenes."""

from __future__ import annotations

from pathlib import Path

from ..files import write_folder, write_page
from . import page, plots
from .collect import Stability, collect, to_json

__all__ = ["Stability", "collect", "write", "write_markdown"]


def write(found: Stability, directory: Path) -> Path:
    """Writes index.html, stability.json and the plots into `directory`, made where missing; returns the page's path."""
    drawn = plots.draw(found)
    return write_folder(directory, page.html(found, drawn), ("stability.json", to_json(found)), drawn)


def write_markdown(found: Stability, path: Path) -> Path:
    """Writes the page on numerics as Markdown, its plots beside it; returns the path."""
    drawn = plots.draw(found)
    return write_page(path, page.markdown(found, drawn, path.stem), drawn)
