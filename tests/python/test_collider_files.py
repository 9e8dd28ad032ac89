"""Colliders of files: the pairs that can touch, with friction and margin, are those of MuJoCo; shapes of `<collision>`."""

from __future__ import annotations

import itertools
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mujoco_models import shipped
from tolerances import EPS, assert_near

import phipsi
from phipsi.errors import ArgumentError, MeshWarning, ModelWarning, SceneError

mujoco = pytest.importorskip("mujoco")

import phipsi.mujoco  # noqa: E402

MESH = '<asset><mesh name="wedge" vertex="-0.5 -0.4 -0.3  0.7 0 0  0 0.6 0  0 0 0.5  0.1 0.1 0.05"/></asset>'
KINDS = ('type="sphere" size="0.5"', 'type="capsule" size="0.4 0.3"', 'type="box" size="0.3 0.5 0.4"', 'type="cylinder" size="0.5 0.4"', 'type="mesh" mesh="wedge"')

Touching = dict[frozenset[str], tuple[float, float]]


def read(text: Any, contacts: Any = "all", **options: Any) -> phipsi.Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        return phipsi.load(text, contacts=contacts, **options)


def touching(scene: phipsi.Scene) -> Touching:
    return {frozenset(names): (friction, margin) for names, friction, _, margin in scene._touching()}


def by_mujoco(model: Any, *, planes: bool = False) -> Touching:
    """Pairs that collide in MuJoCo at qpos0, where the geoms overlap, with sliding friction and margin."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = {}
    explicit = {frozenset((int(model.pair_geom1[at]), int(model.pair_geom2[at]))) for at in range(model.npair)}
    for contact in data.contact[: data.ncon]:
        ends = frozenset(map(int, contact.geom))
        if planes and ends not in explicit and not any(model.geom_type[end] == mujoco.mjtGeom.mjGEOM_PLANE for end in ends):
            continue
        names = frozenset(model.geom(end).name or f"geom{end}" for end in ends)
        # MuJoCo raises a friction of zero to 1e-5.
        friction = float(contact.friction[0]) if contact.dim > 1 and contact.friction[0] > 1e-5 else 0.0
        found[names] = (friction, float(contact.includemargin))
    return found


def overlapping(seed: int) -> str:
    """A model whose geoms all overlap at qpos0: welded bodies, bodies with up to three joints, and every rule of contacts."""
    draw = np.random.default_rng(seed)
    names = itertools.count()

    def numbers(size: int, scale: float) -> str:
        return " ".join(f"{value:.17g}" for value in scale * draw.standard_normal(size))

    def geom(kind: str) -> str:
        rules = {
            "friction": f"{draw.choice([0.0, 0.3, 1.0, 1.5])} 0.01 0.001", "condim": draw.choice([1, 3, 3, 4]), "priority": draw.choice([-1, 0, 0, 0, 2]),
            "contype": draw.choice([0, 1, 2, 3, -1, 1 << 30, -(1 << 31)]), "conaffinity": draw.choice([0, 1, 2, 3, -1, 1 << 30, -(1 << 31)]),
            "margin": draw.choice([0.0, 0.02, 0.125]), "gap": 0.0,
        }  # fmt: skip
        rules["gap"] = float(rules["margin"]) / 2 if draw.random() < 0.3 else 0.0
        return f'<geom name="g{next(names)}" {kind} mass="1" ' + " ".join(f'{name}="{value}"' for name, value in rules.items()) + "/>"

    bodies, children = int(draw.integers(4, 9)), dict[int, list[str]]()
    for body in range(bodies, 0, -1):
        parent = int(draw.integers(0, body))
        joints = {0: "", 1: '<joint axis="0 1 0"/>', 2: '<joint axis="0 1 0"/><joint axis="1 0 0" pos="0.1 0 0"/>', 3: '<joint type="ball"/>'}[int(draw.integers(0, 4))]
        if parent == 0 and draw.random() < 0.5:
            joints = "<freejoint/>"
        inner = "".join(geom(f'{draw.choice(KINDS)} pos="{numbers(3, 0.05)}" quat="{numbers(4, 1.0)}"') for _ in range(draw.integers(0, 3)))
        text = f'<body name="b{body}" quat="{numbers(4, 1.0)}">{joints}<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{inner}{"".join(children.get(body, ()))}</body>'
        children.setdefault(parent, []).insert(0, text)
    world = geom(f'type="plane" size="1 1 1" quat="{numbers(4, 1.0)}"') + geom('type="plane" size="1 1 1"') + geom(str(draw.choice(KINDS)))
    count = next(names)
    excludes = "".join(f'<exclude body1="{one}" body2="{two}"/>' for one, two in [draw.choice(["world", *(f"b{i}" for i in range(1, bodies + 1))], 2, replace=False)])
    chosen = {tuple(sorted(draw.choice(count, 2, replace=False).tolist())) for _ in range(3)}
    pairs = "".join(f'<pair geom1="g{i}" geom2="g{j}" friction="{draw.choice([0.2, 0.9])} 0.2 0 0 0" condim="{draw.choice([1, 3])}" margin="0.03"/>' for i, j in chosen)
    flags = f'filterparent="{draw.choice(["enable", "disable"])}" override="{draw.choice(["enable", "disable", "disable"])}"'
    option = f'<option o_margin="0.25" o_friction="0.7 0.7 0.01 0.001 0.001"><flag {flags}/></option>'
    return f"<mujoco>{option}{MESH}<worldbody>{world}{''.join(children.get(0, ()))}</worldbody><contact>{excludes}{pairs}</contact></mujoco>"


@pytest.mark.parametrize("seed", range(60))
def test_pairs_of_random_models_are_those_of_mujoco(seed: int) -> None:
    """contype, conaffinity, parent and child, exclude, pair, priority, condim, margin, gap and override."""
    text = overlapping(seed)
    model = mujoco.MjModel.from_xml_string(text)
    # A plane and a plane do not collide in MuJoCo, and a <pair> of two geoms that cannot move has no effect.
    rigid = {model.geom(geom).name: int(model.body_weldid[model.geom_bodyid[geom]]) for geom in range(model.ngeom)}
    for contacts in ("all", "plane"):
        found, expected = touching(read(text, contacts)), by_mujoco(model, planes=contacts == "plane")
        expected = {names: values for names, values in expected.items() if len({rigid[name] for name in names}) == 2}
        assert found.keys() == expected.keys()
        for names, values in expected.items():
            assert_near(found[names], values, 4 * EPS)
