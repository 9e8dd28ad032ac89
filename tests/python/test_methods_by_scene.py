"""Every public method of a scene, with connections, contacts and coupled joints: supported, refused by name, or a
quantity of the tree.
"""

from __future__ import annotations

from pathlib import Path

import capabilities
import method_page
import methods_by_scene
import phipsi
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "measured" / "methods-by-scene.md"
NAMED = {"connections": "connection", "contacts": "contact", "mimic": "mimic"}


def test_the_table_has_every_public_method() -> None:
    public = {name for name in method_page.public() if callable(method_page.member(name))}
    assert public == set(methods_by_scene.CALLS) | methods_by_scene.WITHOUT_STATE
    assert not set(methods_by_scene.CALLS) & methods_by_scene.WITHOUT_STATE and set(methods_by_scene.EXPECTED) <= set(methods_by_scene.CALLS)


def test_the_page_is_that_of_the_table() -> None:
    assert PAGE.read_text(encoding="utf-8") == methods_by_scene.page(), "python tests/python/methods_by_scene.py docs/measured/methods-by-scene.md writes it"


@pytest.mark.parametrize("kind", methods_by_scene.KINDS)
@pytest.mark.parametrize("name", methods_by_scene.CALLS)
def test_methods_do_what_the_table_says(name: str, kind: str) -> None:
    found, message = methods_by_scene.outcome(name, kind)
    assert found == methods_by_scene.expected(name, kind), message
    if found == "error":
        assert NAMED[kind] in message


@pytest.mark.parametrize("far", [False, True], ids=["alone", "far-contact"])
@pytest.mark.parametrize("kind", capabilities.KINDS)
@pytest.mark.parametrize("capability", capabilities.CELLS)
def test_cells_of_the_table_of_capabilities(capability: str, kind: str, far: bool, request: pytest.FixtureRequest) -> None:
    word, _, reason = capabilities.outcome(capability, kind, far).partition(": ")
    check, case = capabilities.CELLS[capability], capabilities.Case(kind, far)
    if word == "holds":
        check(case)
    elif word == "refused":
        with pytest.raises(phipsi.errors.ArgumentError, match=reason):
            check(case)
    else:
        request.applymarker(pytest.mark.xfail(reason=reason, raises=AssertionError, strict=True))
        check(case)
