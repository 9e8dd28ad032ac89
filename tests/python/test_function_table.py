"""The table of functions beside the methods of scenes: names, arguments, shapes of results, and the page that lists them."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import numpy as np
import phipsi
import pytest
from function_page import page
from method_page import member
from phipsi._functions import ARGUMENTS, COMPILED, FUNCTIONS, METHODS, TABLE, method_of, shapes

SCENE = phipsi.scenes.chain(3)
ROWS = [name for name in TABLE if not name.endswith("_watched")]


def test_the_page_is_that_of_the_table() -> None:
    path = Path(__file__).parents[2] / "docs/reference/functions.md"
    assert path.read_text(encoding="utf-8") == page(), "function_page.py writes it anew"


def test_names_for_type_checkers_are_those_of_the_table() -> None:
    assert set(FUNCTIONS) == {name for name, row in COMPILED.items() if not row["of_link"]}
    assert set(ARGUMENTS) == set(COMPILED)
    known = set(TABLE)
    assert all(row["derivative_of"] in {None, *known} for row in TABLE.values())
    assert all(row["watched"] in {None, f"{name}_watched"} for name, row in TABLE.items())


@pytest.mark.parametrize("name", ROWS)
def test_a_row_is_what_the_method_takes_and_gives(name: str) -> None:
    row, method = TABLE[name], member(METHODS.get(name, name))
    parameters = inspect.signature(method).parameters
    positional = [key for key, value in parameters.items() if value.kind is value.POSITIONAL_OR_KEYWORD and key != "self"]
    expected = [*row["arguments"]]
    assert positional == [*(key for key in expected if key != "compliance"), *(["link"] if row["of_link"] else [])]
    assert ("form" in parameters, "dtype" in parameters) == (row["has_form"], row["has_dtype"])
    if name == "constrained_dynamics":
        return
    random = np.random.default_rng(1)
    given = [random.standard_normal(SCENE.nq if key == "q" else SCENE.nv) for key in positional if key != "link"]
    found: Any = method_of(SCENE, name)(*given, *([SCENE.link_names[-1]] if row["of_link"] else []))
    if name == "placements":
        found = np.stack(list(found.values()))
    if isinstance(found, tuple):
        parts = list(found[: len(row["results"])])
    else:
        # Several results in one array are on an axis of their own.
        parts = list(np.moveaxis(found, -3, 0)) if len(row["results"]) > 1 else [found]
    assert [np.shape(part) for part in parts] == shapes((name,), SCENE)
    for key in row["results"] if "derivatives" in name and isinstance(found, tuple) else ():
        # Generated C code has the letters of the matrices, results in Python their names.
        field = {"M": "mass_matrix", "Minv": "mass_matrix_inverse"}.get(key, key)
        assert np.shape(getattr(found, field)) == (SCENE.nv, SCENE.nv)


def test_the_scene_refuses_what_no_row_has() -> None:
    with pytest.raises(phipsi.errors.ArgumentError, match="functions"):
        SCENE.to_c(functions=["coriolis_matrix"])
