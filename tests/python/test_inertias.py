"""Scene.with_inertias: links with other inertial parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tolerances import assert_same_bits

import phipsi
from phipsi.errors import ArgumentError, InertiaWarning, NotFiniteError, ShapeError

SCENE = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
LINK = SCENE.body_names[2]


def test_it_is_the_scene_built_with_them() -> None:
    inertia = np.array([[0.3, 0.01, 0.02], [0.01, 0.3, 0.03], [0.02, 0.03, 0.3]])
    found = SCENE.with_inertias({LINK: (7.0, (0.1, 0.2, 0.3), inertia)})
    link = found.links[LINK]
    assert (link.mass, link.com.tolist(), link.inertia.tolist()) == (7.0, [0.1, 0.2, 0.3], inertia.tolist())
    others = {name: (one.mass, one.com, one.inertia) for name, one in SCENE.links.items() if one.mass}
    again = found.with_inertias(others)
    q = np.linspace(-1, 1, 6)
    assert_same_bits(again.mass_matrix(q), SCENE.mass_matrix(q))
    assert not np.array_equal(found.mass_matrix(q), SCENE.mass_matrix(q))


def test_a_point_mass_and_a_mere_frame() -> None:
    found = SCENE.with_inertias({LINK: (2.0, (0, 0, 0.1), None)})
    assert not np.any(found.links[LINK].inertia)
    q = np.linspace(-1, 1, 6)
    less = SCENE.with_inertias({LINK: (0.0, (0, 0, 0), None)})
    assert less.total_mass == pytest.approx(SCENE.total_mass - SCENE.links[LINK].mass)
    assert_same_bits(less.with_payload(LINK, 2.0, (0, 0, 0.1)).mass_matrix(q), found.mass_matrix(q))


def test_an_inertia_that_no_body_can_have_is_told() -> None:
    with pytest.warns(InertiaWarning, match=LINK):
        SCENE.with_inertias({LINK: (1.0, (0, 0, 0), np.diag([1.0, 0.1, 0.1]))})


@pytest.mark.parametrize(
    ("links", "kind", "message"),
    [
        ({"nowhere": (1.0, (0, 0, 0), None)}, ArgumentError, "nowhere"),
        ({LINK: (-1.0, (0, 0, 0), None)}, ArgumentError, f'mass of link "{LINK}": found -1'),
        ({LINK: (float("nan"), (0, 0, 0), None)}, ArgumentError, "mass of link"),
        ({LINK: (1.0, (0, 0), None)}, ShapeError, f'com of link "{LINK}"'),
        ({LINK: (1.0, (0, 0, np.inf), None)}, NotFiniteError, "com of link"),
        ({LINK: (1.0, (0, 0, 0), np.eye(2))}, ShapeError, "inertia of link"),
        ({LINK: 1.0}, ArgumentError, "from names of links to"),
        ([LINK], ArgumentError, "a dict from names of links to"),
    ],
)
def test_bad_arguments(links: Any, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message):
        SCENE.with_inertias(links)
