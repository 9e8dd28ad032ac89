"""Page of a report: Jinja2 templates, tables and figures, as HTML or Markdown."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from . import interactive, text
from .plotting import Plot

if TYPE_CHECKING:
    from markupsafe import Markup

    from .pipeline import Layout


class Table(NamedTuple):
    """Rows of text with column titles."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers_from: int = 1
    """Index of the first column with numbers."""


class Figure(NamedTuple):
    """A plot by name, with its caption."""

    name: str
    caption: str


class Heading(NamedTuple):
    """Heading of a part of a section."""

    text: str


class Code(NamedTuple):
    """Verbatim output of a program."""

    text: str


class Facts(NamedTuple):
    """Names and values."""

    pairs: Sequence[tuple[str, str]]


#: A paragraph of text, or one of the other blocks.
Block: TypeAlias = "str | Table | Figure | Heading | Code | Facts"


class Page:
    """Context of the templates of one report."""

    def __init__(self, layout: Layout[Any], found: Any, plots: Sequence[Plot], stem: str = "") -> None:
        import jinja2  # commands without pages do not need it

        self._layout, self._found = layout, found
        self._plots = {plot.name: interactive.markup(plot) for plot in plots}
        folders = [jinja2.FileSystemLoader(layout.templates), jinja2.PackageLoader(__package__, "templates")]
        self._templates = jinja2.Environment(
            loader=jinja2.ChoiceLoader(folders),
            # HTML is escaped. Markdown is not: it contains no names that a user has chosen.
            autoescape=jinja2.select_autoescape(["html"]),
            undefined=jinja2.StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        self._templates.filters.update(FILTERS)
        self._templates.globals.update(
            report=found, parts=found.parts, missing=found.missing, sections=layout.sections, plots=self._plots, script=interactive.script, parted=any(section.part for section in layout.sections),
            show=self._show, stem=stem, numbers=layout.numbers, eps=float(np.finfo(np.float64).eps),
        )  # fmt: skip

    def render(self, name: str) -> str:
        """The page as HTML ("page.html") or as Markdown ("page.md")."""
        self._kind = name.rpartition(".")[2]
        return self._templates.get_template(f"{self._layout.name}/{name}").render().rstrip() + "\n"

    def _markup(self, text: str) -> str:
        from markupsafe import Markup

        return Markup(text) if self._kind == "html" else text.strip("\n")

    def _show(self, key: str) -> str:
        """A section without its title."""
        section = next(one for one in self._layout.sections if one.key == key)
        if section.blocks is not None:
            return self._blocks(section.blocks(self._found))
        shown = section.shown(self._found) if section.shown is not None else None
        return self._markup(self._templates.get_template(f"{self._layout.name}/{key}.{self._kind}").render(shown=shown))

    def _blocks(self, blocks: Sequence[Block]) -> str:
        """Consecutive blocks, without figures that were not drawn."""
        items = [
            ("text" if isinstance(one, str) else type(one).__name__.lower(), one)
            for one in blocks
            if not isinstance(one, Figure) or one.name in self._plots
        ]
        return self._markup(self._templates.get_template(f"blocks.{self._kind}").render(items=items))


def flowed(words: str, **values: object) -> str:
    """A paragraph in one line, with formatted values."""
    return " ".join(words.format(**values).split())


def coded(words: str) -> Markup:
    """Text with the parts between backticks as code."""
    from markupsafe import Markup, escape

    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(words))))


#: Filters of the templates.
FILTERS: dict[str, Callable[..., Any]] = {
    function.__name__: function
    for function in (text.count, text.minus, text.plural, text.rate, text.power, text.scientific, text.signed, text.significant, text.symbols, text.time)
} | {"isfinite": np.isfinite, "log10": np.log10, "coded": coded}
