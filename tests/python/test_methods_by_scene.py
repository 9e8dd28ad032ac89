"""Every public method of a scene, with connections, contacts and coupled joints: supported, refused by name, or a
quantity of the tree.
"""

from __future__ import annotations

from pathlib import Path

import methods_by_scene
import phipsi
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "measured" / "methods-by-scene.md"
NAMED = {"connections": "connection", "contacts": "contact", "mimic": "mimic"}


def test_the_table_has_every_public_method() -> None:
    public = {name for name in dir(phipsi.Scene) if not name.startswith("_") and callable(getattr(phipsi.Scene, name))}
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
