"""The stub, which editors show, equals help(); its names exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import phipsi
import pytest
from stub_docs import with_docs

STUB = Path(phipsi.__file__).with_name("_core.pyi").read_text(encoding="utf-8")
BUILDER = phipsi.SceneBuilder().link("base").link("a", 1.0).joint("turn", "revolute", "base", "a")
#: Functions that raise for unknown names, with the known names.
CALLS: dict[str, Any] = {
    "_Errors": lambda name: BUILDER.build().mass_matrix([0.0], errors=name),
    "_Form": lambda name: BUILDER.build().factor([0.0], form=name),
    "_Frame": lambda name: BUILDER.build().jacobian([0.0], "a", frame=name),
    "_Kind": lambda name: BUILDER.build().acceleration([0.0], [0.0], [0.0], "a", kind=name),
    "_JointType": lambda name: phipsi.SceneBuilder().joint("turn", name, "base", "a"),
    "_Method": lambda name: BUILDER.build().simulate([0.0], [0.0], dt=0.5, steps=1, method=name),
    "_Switch": lambda name: BUILDER.build(leave_out=[name]),
}


def test_docstrings_of_the_stub_are_those_of_the_module() -> None:
    assert STUB == with_docs(STUB), "make stub writes them anew"


@pytest.mark.parametrize("alias", CALLS)
def test_names_of_the_stub_are_those_of_the_module(alias: str) -> None:
    node = next(node for node in ast.parse(STUB).body if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == alias)
    named = {entry.value for entry in ast.walk(node) if isinstance(entry, ast.Constant)}
    with pytest.raises(phipsi.errors.PhipsiError) as found:
        CALLS[alias]("none")
    known = re.sub(r'^.*expected (one of )?', "", str(found.value)).replace('"', "")
    assert named == set(re.split(r", | or ", known))


@pytest.mark.parametrize("method", ["inverse_kinematics", "estimate"])
def test_covariances_that_were_asked_for_are_not_optional(method: str) -> None:
    """For type checkers."""
    scene = next(node for node in ast.parse(STUB).body if isinstance(node, ast.ClassDef) and node.name == "Scene")
    first, second = (node for node in scene.body if isinstance(node, ast.FunctionDef) and node.name == method)
    arguments = {one.arg: ast.unparse(one.annotation) for one in first.args.kwonlyargs if one.annotation}
    result = ast.unparse(first.returns) if first.returns else ""
    assert arguments["covariance"] == "Literal[True]" and result == f"_{ast.unparse(second.returns)}WithCovariance"  # type: ignore[arg-type]
    source = Path(phipsi.__file__).with_name("tasks.py" if method == "inverse_kinematics" else "_results.py").read_text(encoding="utf-8")
    of_result = next(node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ClassDef) and node.name == result)
    fields = [node for node in of_result.body if isinstance(node, ast.AnnAssign)]
    assert fields and all("None" not in ast.unparse(node.annotation) for node in fields)
