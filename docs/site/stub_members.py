"""An extension of griffe for the API reference: the docstrings of the package and of the stub, as Markdown has them."""

from __future__ import annotations

import re
from typing import Any

import griffe


class StubMembers(griffe.Extension):
    """Methods that the stub has by overloads only become members, with the docstring of the first overload."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Visits all members of the package."""
        self._aliases = {
            name: " ".join(str(member.value).split()).replace("NDArray[np.", "NDArray[")
            for module in (pkg, *pkg.modules.values())
            for name, member in module.members.items()
            if not member.is_alias and isinstance(member, griffe.Attribute) and str(member.annotation) == "TypeAlias" and name.startswith("_")
        }
        self._visit(pkg)

    def _typed(self, function: griffe.Function) -> None:
        """Replace private names of types in a signature by what they stand for."""

        def public(annotation: Any) -> Any:
            if annotation is None or not re.search(r"\b_[A-Z]\w*", str(annotation)):
                return annotation
            return re.sub(r"\b_[A-Z]\w*", lambda found: self._aliases.get(found[0], found[0].lstrip("_")), str(annotation))

        for parameter in function.parameters:
            parameter.annotation = public(parameter.annotation)
        function.returns = public(function.returns)

    def _visit(self, owner: griffe.Module | griffe.Class) -> None:
        for name, overloads in owner.overloads.items():
            if name not in owner.members and overloads:
                owner.set_member(name, overloads[0])
        for member in owner.members.values():
            if not member.is_alias:
                if member.docstring is not None:
                    names = [parameter.name for parameter in member.parameters] if isinstance(member, griffe.Function) else []
                    member.docstring.value = as_markdown(member.docstring.value, names)
                if isinstance(member, griffe.Function):
                    self._typed(member)
                if isinstance(member, griffe.Module | griffe.Class):
                    self._visit(member)


def as_markdown(docstring: str, names: list[str]) -> str:
    """Convert a docstring to Markdown: numpydoc sections to lists, sessions to code blocks."""
    text, *parts = re.split(r"^(\w+)\n-{3,}\n", docstring, flags=re.MULTILINE)
    paragraphs = _prose(text.rstrip(), names)
    for title, body in zip(parts[::2], parts[1::2], strict=True):
        is_list = title not in ("Notes", "Examples")
        paragraphs += [f"**{title}**", *(_entries(body.rstrip()) if is_list else _prose(body.rstrip(), []))]
    return "\n\n".join(paragraphs)


def _entries(body: str) -> list[str]:
    """Convert the entries of a numpydoc section, each a head and an indented text, to a list."""
    items = []
    for entry in re.split(r"\n(?=\S)", body):
        head, _, text = entry.partition("\n")
        given, colon, kind = head.partition(" : ")
        kind = kind.replace("<", "&lt;").replace("*", r"\*")
        items.append(f"- {_named(given)}{', ' * bool(colon)}{kind}: {' '.join(text.split()).replace('<', '&lt;')}")
    return ["\n".join(items)]


def _prose(text: str, names: list[str]) -> list[str]:
    """Convert text outside of lists: sessions become code blocks, and arguments with these names a list."""
    paragraphs: list[str] = []
    listed = False
    for paragraph in text.split("\n\n"):
        if paragraph.startswith(">>> "):
            session = re.sub(r" *# doctest: \+SKIP", "", paragraph)
            paragraphs.append(f"```pycon\n{session}\n```")
        elif paragraph.startswith("    "):
            paragraphs.append(paragraph)
        else:
            joined = re.sub(r":\w+:`~?([^`]*)`", r"`\1`", paragraph).replace("<", "&lt;")
            if joined.startswith("- "):
                paragraphs.append("\n".join(f"    {line}" for line in joined.splitlines()) if listed else joined)
                continue
            paragraphs += _arguments(" ".join(joined.split()), names)
        listed = paragraphs[-1].startswith("- ")
    return paragraphs


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
    return re.sub(r"(?!and\b)[\w.]+", r"`\g<0>`", given)
