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

SECTIONS = ("Parameters", "Attributes", "Returns", "Yields", "Raises", "Warns", "See Also", "Notes", "Examples")
#: The packages, beyond numpy, that an example needs.
NEEDS = {
    "Scene.from_mujoco": "mujoco",
    "Scene.from_pinocchio": "pinocchio",
    "Scene.ode": "scipy",
    "Scene.show": "viser",
}
#: Functions and methods whose docstrings are not complete yet. A name that is complete has to leave the list.
INCOMPLETE: frozenset[str] = frozenset(
    {
        "Factor.mul",
        "Factor.solve",
        "Factor.update",
        "Ode.centre_at",
        "Ode.configuration",
        "Ode.jacobian",
        "Ode.rhs",
        "Ode.solve",
        "Ode.torque",
        "Operator.inv",
        "Operator.matmat",
        "Operator.matvec",
        "Operator.rmatvec",
        "Operator.toarray",
        "Trajectory.connection_forces",
        "Trajectory.energy",
        "Trajectory.energy_audit",
        "Trajectory.error_estimate",
        "Trajectory.momentum",
        "Trajectory.torques",
        "Trajectory.violations",
        "Trajectory.vjp",
        "load",
        "scenes.chain",
        "scenes.extreme",
        "scenes.names",
    }
)
STUB = ast.parse(Path(phipsi.__file__).with_name("_core.pyi").read_text(encoding="utf-8"))


def public() -> Iterator[tuple[str, Any]]:
    """All that `phipsi` exports: functions, classes with their methods and properties, and the same of its modules."""
    for name in phipsi.__all__:
        thing = getattr(phipsi, name)
        for inner in thing.__all__ if inspect.ismodule(thing) else ():
            yield from members(f"{name}.{inner}", getattr(thing, inner))
        yield from members(name, thing)


def members(name: str, thing: Any) -> Iterator[tuple[str, Any]]:
    if inspect.isclass(thing):
        yield name, thing
        fields = getattr(thing, "_fields", ())
        for inner in vars(thing):
            member = getattr(thing, inner)
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
            node = next(node for node in nodes if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == part)
            nodes = node.body
        assert isinstance(node, ast.FunctionDef) and node.returns is not None, name
        annotation = ast.unparse(node.returns)
    return annotation in (None, "None")


def faults(name: str, thing: Any) -> list[str]:
    """What numpydoc form lacks in the docstring of a function or method."""
    found = sections(inspect.getdoc(thing) or "")
    parameters = [one for one in inspect.signature(thing).parameters if one != "self"]
    described = entries(found.get("Parameters", []))
    wrong = [] if described == parameters else [f"Parameters describes {described}; the signature has {parameters}"]
    wrong += [] if "Returns" in found or returns_nothing(name, thing) else ["no section Returns"]
    wrong += [] if ">>> " in "".join(found.get("Examples", [])) else ["no section Examples with an example"]
    order = [SECTIONS.index(title) for title in found if title]
    return wrong + ([] if order == sorted(order) else [f"sections in the order {list(found)[1:]}"])


def test_a_docstring_that_lacks_something_is_found() -> None:
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


def test_first_lines_are_sentences_of_one_line() -> None:
    for name in ALL.keys() - INCOMPLETE:
        lines = (inspect.getdoc(ALL[name]) or "").splitlines()
        assert lines and re.search(r"[.;]$", lines[0]) and lines[1:2] in ([], [""]), f"{name}: {lines[:2]}"


def test_the_list_of_incomplete_names_has_only_names_that_there_are() -> None:
    assert set(ROUTINES) >= INCOMPLETE and set(ROUTINES) >= set(NEEDS)


@pytest.mark.parametrize("name", sorted(name for name, thing in ALL.items() if ">>> " in (inspect.getdoc(thing) or "")))
def test_examples_run(name: str) -> None:
    if name in NEEDS and importlib.util.find_spec(NEEDS[name]) is None:
        pytest.skip(f"{name} needs {NEEDS[name]}")
    example = doctest.DocTestParser().get_doctest(
        inspect.getdoc(ALL[name]) or "", {"np": np, "phipsi": phipsi}, name, None, None
    )
    report: list[str] = []
    failed, tried = doctest.DocTestRunner(verbose=False).run(example, out=report.append)
    assert tried > 0 and failed == 0, "".join(report)
