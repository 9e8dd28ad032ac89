"""A report as files: a folder with its page, its numbers and its plots, or Markdown with the plots beside it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from .figure import Plot


def write_folder(directory: Path, page: str, numbers: tuple[str, object], drawn: Sequence[Plot]) -> Path:
    """Writes index.html, the numbers as JSON under their name, and the plots into `directory`, made where missing; returns the page's path."""
    directory.mkdir(parents=True, exist_ok=True)
    name, content = numbers
    text = json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False)
    (directory / name).write_text(text + "\n", encoding="utf-8")
    for plot in drawn:
        (directory / f"{plot.name}.svg").write_text(plot.svg, encoding="utf-8")
        (directory / f"{plot.name}.png").write_bytes(plot.png)
    index = directory / "index.html"
    index.write_text(page, encoding="utf-8")
    return index


def write_page(path: Path, page: str, drawn: Sequence[Plot]) -> Path:
    """Writes a page in Markdown, its plots beside it under its name; returns the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for plot in drawn:
        (path.parent / f"{path.stem}-{plot.name}.png").write_bytes(plot.png)
    path.write_text(page, encoding="utf-8")
    return path
