"""The motion report: error against step and run time, orders and drifts of every fixed-step method, beside the peers installed."""

from __future__ import annotations

import json
from pathlib import Path

from . import page, plots
from .collect import Study, collect, to_json

__all__ = ["Study", "collect", "write", "write_markdown"]


def write(found: Study, directory: Path) -> Path:
    """Writes index.html, report.json and the plots into `directory`, made where missing; returns the page's path."""
    directory.mkdir(parents=True, exist_ok=True)
    text = json.dumps(to_json(found), indent=1, allow_nan=False, ensure_ascii=False)
    (directory / "report.json").write_text(text + "\n", encoding="utf-8")
    drawn = plots.draw(found)
    for plot in drawn:
        (directory / f"{plot.name}.svg").write_text(plot.svg, encoding="utf-8")
        (directory / f"{plot.name}.png").write_bytes(plot.png)
    index = directory / "index.html"
    index.write_text(page.html(found, drawn), encoding="utf-8")
    return index


def write_markdown(found: Study, path: Path) -> Path:
    """Writes the same page as Markdown, its plots beside it; returns the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn = plots.draw(found)
    for plot in drawn:
        (path.parent / f"{path.stem}-{plot.name}.png").write_bytes(plot.png)
    path.write_text(page.markdown(found, drawn, path.stem), encoding="utf-8")
    return path
