"""Docstrings in numpydoc form: every public function and method has the sections that apply, and all examples run."""

from __future__ import annotations

import ast
import doctest
import importlib.util
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import phipsi
import pytest
from phipsi import _core

SECTIONS = ("Parameters", "Attributes", "Returns", "Yields", "Raises", "Warns", "See Also", "Notes", "Examples")
#: The packages, beyond numpy, that an example needs.
NEEDS = {
    "Scene.from_mujoco": "mujoco",
    "Scene.from_pinocchio": "pinocchio",
    "Scene.ode": "scipy",
    "Scene.show": "viser",
}
#: Functions and methods with incomplete docstrings. A complete one has to leave the list.
INCOMPLETE: frozenset[str] = frozenset()
STUB = ast.parse(Path(phipsi.__file__).with_name("_core.pyi").read_text(encoding="utf-8"))


def public() -> Iterator[tuple[str, Any]]:
    """Public names of `phipsi` and its modules: functions, and classes with their methods and properties."""
    for name in (*phipsi.__all__, "compile"):
        thing = getattr(phipsi, name)
        for inner in thing.__all__ if inspect.ismodule(thing) else ():
            yield from members(f"{name}.{inner}", getattr(thing, inner))
        yield from members(name, thing)


def members(name: str, thing: Any) -> Iterator[tuple[str, Any]]:
    if inspect.isclass(thing):
        yield name, thing
        fields = getattr(thing, "_fields", ())
        for inner in vars(thing):
            member = getattr(thing, inner, None)
            if not inner.startswith("_") and inner not in fields and (callable(member) or is_property(member)):
                yield f"{name}.{inner}", member
    elif callable(thing) and inspect.isroutine(thing):
        yield name, thing


def is_property(thing: Any) -> bool:
    return isinstance(thing, property) or inspect.isgetsetdescriptor(thing)


ALL = dict(public())
ROUTINES = {name: thing for name, thing in ALL.items() if inspect.isroutine(thing)}


def sections(doc: str) -> dict[str, list[str]]:
    """The lines of each section, by its title; those before the first by ""."""
    found: dict[str, list[str]] = {"": []}
    lines, title = doc.splitlines(), ""
    for line, below in zip(lines, [*lines[1:], ""], strict=True):
        if below and set(below) == {"-"} and len(below) == len(line):
            title = line
            found[title] = []
        elif not (line and set(line) == {"-"}):
            found[title].append(line)
    return found


def entries(lines: list[str]) -> list[str]:
    """The names that a section of parameters describes, in its order."""
    heads = [line.partition(" : ")[0] for line in lines if line and not line.startswith(" ")]
    return [name.lstrip("*") for head in heads for name in head.split(", ")]


def returns_nothing(name: str, thing: Any) -> bool:
    annotation = inspect.signature(thing).return_annotation
    if annotation is inspect.Signature.empty:
        nodes: list[ast.stmt] = STUB.body
        for part in name.split("."):
            named = [node for node in nodes if isinstance(node, ast.ClassDef | ast.FunctionDef)]
            node = next(node for node in named if node.name == part)
            nodes = node.body
        assert isinstance(node, ast.FunctionDef) and node.returns is not None, name
        annotation = ast.unparse(node.returns)
    return annotation in (None, "None")


def faults(name: str, thing: Any) -> list[str]:
    """Deviations of the docstring of a function or method from numpydoc form."""
    found = sections(inspect.getdoc(thing) or "")
    parameters = [one for one in inspect.signature(thing).parameters if one != "self"]
    described = entries(found.get("Parameters", []))
    wrong = [] if described == parameters else [f"Parameters describes {described}; the signature has {parameters}"]
    wrong += [] if "Returns" in found or returns_nothing(name, thing) else ["no section Returns"]
    wrong += [] if ">>> " in "".join(found.get("Examples", [])) else ["no section Examples with an example"]
    order = [SECTIONS.index(title) for title in found if title]
    return wrong + ([] if order == sorted(order) else [f"sections in the order {list(found)[1:]}"])


def test_an_incomplete_docstring_is_found() -> None:
    def both(a: int, b: int) -> int:
        """Sum.

        Parameters
        ----------
        a : int
            First.

        Notes
        -----
        None.

        Returns
        -------
        int
        """
        return a + b

    found = faults("both", both)
    assert len(found) == 3 and "['a']" in found[0] and "Examples" in found[1] and "order" in found[2]


@pytest.mark.parametrize("name", sorted(ROUTINES))
def test_functions_and_methods_have_their_sections(name: str) -> None:
    found = faults(name, ROUTINES[name])
    if name in INCOMPLETE:
        assert found, f"{name} is complete: take it off the list INCOMPLETE"
    else:
        assert not found, f"{name}: {'; '.join(found)}"


def test_docstrings_begin_with_a_sentence_and_compiled_ones_with_one_line() -> None:
    for name in ALL.keys() - INCOMPLETE:
        first, _, _ = (inspect.getdoc(ALL[name]) or "").partition("\n\n")
        is_compiled = hasattr(_core, name.partition(".")[0])
        assert re.search(r"[.;]$", first) and (not is_compiled or "\n" not in first), f"{name}: {first}"


def test_lists_contain_existing_names_only() -> None:
    assert set(ROUTINES) >= INCOMPLETE and set(ROUTINES) >= set(NEEDS)


@pytest.mark.parametrize("name", sorted(name for name, thing in ALL.items() if ">>> " in (inspect.getdoc(thing) or "")))
def test_examples_run(name: str) -> None:
    if name in NEEDS and importlib.util.find_spec(NEEDS[name]) is None:
        pytest.skip(f"{name} needs {NEEDS[name]}")
    example = doctest.DocTestParser().get_doctest(
        inspect.getdoc(ALL[name]) or "", {"np": np, "phipsi": phipsi}, name, None, None
    )
    if all(one.options.get(doctest.SKIP) for one in example.examples):
        pytest.skip(f"{name} has an example that cannot run here")
    report: list[str] = []
    failed, tried = doctest.DocTestRunner(verbose=False).run(example, out=report.append)
    assert tried > 0 and failed == 0, "".join(report)
