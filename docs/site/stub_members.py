"""An extension of griffe for the API reference: the docstrings of the package and of the stub, as Markdown has them."""

from __future__ import annotations

import re
from typing import Any

import griffe


class StubMembers(griffe.Extension):
    """Methods that the stub has by overloads only become members, with the docstring of the first overload."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Goes through all that was read."""
        self._visit(pkg)

    def _visit(self, owner: griffe.Module | griffe.Class) -> None:
        for name, overloads in owner.overloads.items():
            if name not in owner.members and overloads:
                owner.set_member(name, overloads[0])
        for member in owner.members.values():
            if not member.is_alias:
                if member.docstring is not None:
                    member.docstring.value = as_markdown(member.docstring.value)
                if isinstance(member, griffe.Module | griffe.Class):
                    self._visit(member)


def as_markdown(docstring: str) -> str:
    """A docstring whose sessions are code blocks, and whose angle brackets are no HTML."""
    paragraphs = []
    for paragraph in docstring.split("\n\n"):
        if paragraph.startswith(">>> "):
            text = re.sub(r" *# doctest: \+SKIP", "", paragraph)
            paragraphs.append(f"```pycon\n{text}\n```")
        elif paragraph.startswith("    "):
            paragraphs.append(paragraph)
        else:
            text = re.sub(r":\w+:`~?([^`]*)`", r"`\1`", paragraph)
            paragraphs.append(text.replace("<", "&lt;"))
    return "\n\n".join(paragraphs)
