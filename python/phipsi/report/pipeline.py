"""Pipeline of all reports: sections measure and draw, templates format; the output is a page, Markdown and JSON."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np

from .. import errors
from . import machine
from .page import Block, Facts, Page
from .plotting import Plot
from .progress import Reporter, Silent


class Missing(Exception):
    """A section is not available; the message gives the reason and is shown in its place."""


@dataclass
class Findings:
    """Common data of all reports, and the results of the sections."""

    quick: bool
    parts: dict[str, Any] = field(default_factory=dict, kw_only=True)
    """Results by section, in JSON form: rows, or a mapping."""
    missing: dict[str, str] = field(default_factory=dict, kw_only=True)
    """Reasons why a section, or a part of one, is empty."""
    date: str = field(default_factory=lambda: datetime.now(timezone.utc).isoformat(timespec="seconds"), kw_only=True)
    machine: dict[str, str | int | None] = field(default_factory=machine.describe, kw_only=True)

    def head(self) -> dict[str, Any]:
        """Entries of the JSON in addition to the sections."""
        return {}

    def provenance(self) -> list[tuple[str, str]]:
        """Hardware, software and date of the measurement."""
        known = {key: "unknown" if value is None else str(value) for key, value in self.machine.items()}
        commit = f", commit {known['commit']}" if self.machine["commit"] else ""
        facts = [
            ("processor", f"{known['cpu']}, {known['cores']} cores available"),
            ("system", known["os"]),
            ("phipsi", known["phipsi"] + commit),
            ("compiler", known["compiler"]),
            ("Python, NumPy", f"{known['python']}, {known['numpy']}"),
            ("date", self.date),
        ]
        return [fact for fact in facts if fact[1] != "unknown"]


F = TypeVar("F", bound=Findings)
#: A section of a report can be used in every report with more data.
C = TypeVar("C", bound=Findings, contravariant=True)


@dataclass(frozen=True)
class Section(Generic[C]):
    """A part of a report. The page shows its template, which is named after its key, or its blocks."""

    key: str
    title: str
    collect: Callable[[C, Reporter], Any] | None = None
    """Measures; raises Missing or an error of phipsi if the section is not available."""
    plots: Callable[[C], Iterable[Plot]] | None = None
    blocks: Callable[[C], Sequence[Block]] | None = None
    """None: the section has a template."""
    shown: Callable[[C], Any] | None = None
    """Additional values for its template that are not in the JSON."""
    empty: Any = None
    """Value in the JSON if the section is missing."""
    part: str = ""
    """Title of the part of the page that begins with this section, if any."""


@dataclass(frozen=True)
class Layout(Generic[C]):
    """A kind of report."""

    name: str
    """Folder of its templates. It contains page.html, and page.md if the report has Markdown."""
    numbers: str
    """File name of its JSON; empty for a page in one file."""
    sections: Sequence[Section[C]]
    templates: Sequence[Path] = ()
    """Folders of templates in addition to those in the package."""


def provenance() -> Section[Any]:
    """The last section of every report."""
    return Section("provenance", "Hardware, software and settings", blocks=lambda found: [Facts(found.provenance())])


def collect(layout: Layout[F], found: F, reporter: Reporter) -> F:
    """Measure all sections in order; the reasons for missing sections are stored in `missing`."""
    for section in layout.sections:
        if section.collect is not None:
            found.parts[section.key] = section.empty
            try:
                found.parts[section.key] = section.collect(found, reporter)
            except (Missing, errors.PhipsiError) as reason:
                found.missing[section.key] = str(reason)
    return found


def to_json(layout: Layout[F], found: F) -> dict[str, Any]:
    """All values of a report; None for failed methods and missing parts."""
    about = {"format": 1, "date": found.date, "machine": found.machine, "missing": found.missing}
    shown = {section.key: found.parts[section.key] for section in layout.sections if section.key in found.parts}
    content: dict[str, Any] = plain(about | found.head() | shown)
    return content


def plain(value: Any) -> Any:
    """A value in JSON form. Rows become mappings of their fields and properties, including those of `of`; NaN and
    infinities become None.
    """
    if hasattr(value, "json"):
        value = value.json()
    if dataclasses.is_dataclass(value) or hasattr(value, "_asdict"):
        kind = type(value)
        names = value._fields if hasattr(value, "_asdict") else [one.name for one in dataclasses.fields(value)]
        names = [*names, *(name for name, member in vars(kind).items() if isinstance(member, property))]
        value = {name: getattr(value, name) for name in names if not name.startswith("_")}
    if isinstance(value, Mapping):
        row: dict[str, Any] = {}
        for key, item in value.items():
            row |= (plain(item) or {}) if key == "of" else {str(key).rstrip("_"): plain(item)}
        return row
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def draw(layout: Layout[F], found: F, reporter: Reporter | None = None) -> list[Plot]:
    """Plots of all sections that are available."""
    drawing = [section for section in layout.sections if section.plots is not None and section.key not in found.missing]
    return [plot for section in (reporter or Silent()).each("Drawing", drawing) for plot in section.plots(found)]  # type: ignore[misc]


#: Renders a plot as PNG for pages in Markdown.
Drawer: TypeAlias = "Callable[[Plot], bytes]"


def html(layout: Layout[F], found: F, plots: list[Plot] | None = None) -> str:
    """The page, in one file."""
    return Page(layout, found, draw(layout, found) if plots is None else plots).render("page.html")


def write(
    layout: Layout[F], found: F, folder: Path | None, markdown: Path | None = None, reporter: Reporter | None = None,
    drawer: Drawer | None = None,
) -> list[Path]:
    """Write index.html and the JSON into the folder, and Markdown with plots, each if requested; return the pages.

    Markdown needs a drawer.
    """
    plots = draw(layout, found, reporter)
    pages = []
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(to_json(layout, found), indent=1, allow_nan=False, ensure_ascii=False)
        (folder / layout.numbers).write_text(text + "\n", encoding="utf-8")
        pages.append(folder / "index.html")
        pages[-1].write_text(html(layout, found, plots), encoding="utf-8")
    if markdown is not None:
        assert drawer is not None
        markdown.parent.mkdir(parents=True, exist_ok=True)
        for plot in plots:
            (markdown.parent / f"{markdown.stem}-{plot.name}.png").write_bytes(drawer(plot))
        pages.append(markdown)
        markdown.write_text(Page(layout, found, plots, markdown.stem).render("page.md"), encoding="utf-8")
    return pages
