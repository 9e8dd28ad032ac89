"""Tables and pages, as HTML and as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from .text import escape

#: Head and rows.
Table = tuple[Sequence[str], list[list[str]]]


def markdown(table: Table) -> str:
    """The table as Markdown."""
    head, rows = table
    if not rows:
        return "None.\n"
    lines = [" | ".join(head), " | ".join("---" for _ in head), *(" | ".join(row) for row in rows)]
    return "\n".join(f"| {line} |" for line in lines) + "\n"


def html(table: Table, numbers_from: int) -> str:
    """The table as HTML, columns of numbers from that one on."""
    head, rows = table
    if not rows:
        return "<p>None.</p>"

    def cells(row: Sequence[str], tag: str) -> str:
        return "".join(
            f"<{tag}{' class=n' if at >= numbers_from else ''}>{escape(cell)}</{tag}>" for at, cell in enumerate(row)
        )

    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    return f"<table><thead><tr>{cells(head, 'th')}</tr></thead><tbody>{body}</tbody></table>"
