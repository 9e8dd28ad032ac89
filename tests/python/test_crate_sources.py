"""Rules of the Rust sources that no compiler checks: messages for Rust programs, and types that can grow."""

from __future__ import annotations

import re
from pathlib import Path

SRC = Path(__file__).parents[2] / "src"
FILES = sorted(file for file in SRC.rglob("*.rs") if file.relative_to(SRC).parts[0] != "python")

STRING = re.compile(r'"(?:\\.|[^"\\])*"', re.DOTALL)
#: A keyword argument with a value, a constant, or a method of a class: syntax of Python.
PYTHON = re.compile(r'\b[a-z_]+=(?:\\"|[0-9{]|True\b|False\b|None\b)|\b(?:True|False)\b|\bphipsi\.[a-z]|\b[A-Z][a-z]+\w*\.[a-z_]+')

#: Enums whose variants cannot grow, because they are defined by mathematics, or which no program can name.
CLOSED = {"Axis", "CompiledFor", "HingeMap", "Motion", "Operation", "Rows", "StopCondition"}


def code(file: Path) -> str:
    """Code without comments and unit tests; the lines keep their numbers."""
    text = re.split(r"#\[cfg\([^\n]*test[^\n]*\)\]\nmod tests", file.read_text(encoding="utf-8"))[0]
    return re.sub(r"(?m)^\s*//.*$", "", text)


def outside_of_languages(text: str) -> str:
    """Replaces the arguments of `in_language`, which has a text for each language, by blanks."""
    while (found := re.search(r"\bin_language\(", text)) is not None:
        depth, end = 1, found.end()
        while depth:
            if text[end] == '"' and (literal := STRING.match(text, end)):
                end = literal.end()
                continue
            depth += {"(": 1, ")": -1}.get(text[end], 0)
            end += 1
        text = text[: found.start()] + re.sub(r"[^\n]", " ", text[found.start() : end]) + text[end:]
    return text


# XML and generated code have equals signs of their own.
MESSAGES = [file for file in FILES if file.relative_to(SRC).parts[:2] != ("scene", "urdf") and "codegen" not in file.parts]


def test_messages_have_python_syntax_only_beside_that_of_rust() -> None:
    # in_language(rust, python) has a text for each language.
    found = [
        (str(file.relative_to(SRC)), literal)
        for file in MESSAGES
        for literal in STRING.findall(outside_of_languages(code(file)))
        if PYTHON.search(literal) and "<" not in literal
    ]
    assert found == []


def test_enums_and_structs_with_setters_can_grow() -> None:
    enums, structs, with_setters = {}, {}, set()
    for file in FILES:
        text = code(file)
        with_setters |= set(re.findall(r"\bsetters!\((\w+)", text))
        declared = re.findall(r"((?:^[ \t]*#\[[^\n]*\]\n)*)^[ \t]*pub (enum|struct) (\w+)", text, re.MULTILINE)
        for attributes, kind, name in declared:
            (enums if kind == "enum" else structs)[name] = "non_exhaustive" in attributes
    assert len(enums) > 20 and len(with_setters) > 8
    assert {name for name, grows in enums.items() if not grows} == CLOSED
    assert [name for name in with_setters if not structs[name]] == []


def test_public_tables_can_grow() -> None:
    # The length of an array is part of its type.
    arrays = [
        (file.name, name)
        for file in FILES
        for name in re.findall(r"^\s*pub (?:const|static) (\w+): \[", code(file), re.MULTILINE)
    ]
    assert arrays == [("kind.rs", "PLAIN")]  # hidden
