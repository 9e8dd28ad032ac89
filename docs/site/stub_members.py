"""An extension of griffe for the API reference: the docstrings of the package and of the stub, as Markdown has them."""

from __future__ import annotations

import re
from typing import Any

import griffe


class StubMembers(griffe.Extension):
    """Methods that the stub has by overloads only become members, with the docstring of the first overload."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Visits all members of the package."""
        self._visit(pkg)

    def _visit(self, owner: griffe.Module | griffe.Class) -> None:
        for name, overloads in owner.overloads.items():
            if name not in owner.members and overloads:
                owner.set_member(name, overloads[0])
        for member in owner.members.values():
            if not member.is_alias:
                if member.docstring is not None:
                    names = [parameter.name for parameter in member.parameters] if isinstance(member, griffe.Function) else []
                    member.docstring.value = as_markdown(member.docstring.value, names)
                if isinstance(member, griffe.Module | griffe.Class):
                    self._visit(member)


def as_markdown(docstring: str, names: list[str]) -> str:
    """A docstring whose sessions are code blocks, whose angle brackets are no HTML, and whose arguments, of these names, are a list."""
    paragraphs: list[str] = []
    listed = False
    for paragraph in docstring.split("\n\n"):
        if paragraph.startswith(">>> "):
            text = re.sub(r" *# doctest: \+SKIP", "", paragraph)
            paragraphs.append(f"```pycon\n{text}\n```")
        elif paragraph.startswith("    "):
            paragraphs.append(paragraph)
        else:
            text = re.sub(r":\w+:`~?([^`]*)`", r"`\1`", paragraph).replace("<", "&lt;")
            if text.startswith("- "):
                paragraphs.append("\n".join(f"    {line}" for line in text.splitlines()) if listed else text)
                continue
            paragraphs += _arguments(" ".join(text.split()), names)
        listed = paragraphs[-1].startswith("- ")
    return "\n\n".join(paragraphs)


def _arguments(text: str, names: list[str]) -> list[str]:
    """A paragraph, as a list from where it says `name: ...` of an argument."""
    if not names:
        return [text]
    name = "(?:" + "|".join(names) + ")"
    parts = re.split(rf"(?:^|(?<=[.;] ))({name}(?:, {name})*(?: and {name})?): ", text)
    if len(parts) == 1:
        return parts
    first, last = parts[0].strip(), re.split(r"(?<=\. )(?=(?:Returns|Raises|Warns) )", parts[-1])
    parts[-1] = last[0]
    items = [f"- {_named(given)}: {said.strip(' ;')}" for given, said in zip(parts[1::2], parts[2::2], strict=True)]
    return [paragraph for paragraph in (first, "\n".join(items), *last[1:]) if paragraph]


def _named(given: str) -> str:
    return re.sub(r"(?!and\b)\w+", r"`\g<0>`", given)
