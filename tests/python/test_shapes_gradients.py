"""Gradients of shapes that touch: compared with differences inside a mode, closed forms, and contacts of named points."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import phipsi
import pytest
from phipsi import shapes
from test_shapes_scenes import quaternion
from test_shapes_touch import at, free

G, STEPS = 9.81, 20
OPEN, STICKING, SLIDING = phipsi.ContactState
CORNERS = np.array(list(itertools.product((-0.1, 0.1), repeat=3)))
LYING = (np.pi / 2, 0, 0)


def above(body: Any, ground: Any, friction: float = 0.4) -> phipsi.Scene:
    builder = phipsi.SceneBuilder().link("world").collider("ground", ground, friction=friction)
    return free("body", body, friction=friction, builder=builder).build()


def turned(turn: Any, height: float, velocity: Any, turning: Any) -> tuple[np.ndarray, np.ndarray]:
    """A start at a height above the origin; linear velocity in the base frame, angular velocity in that of the body."""
    q = np.r_[0.0, 0.0, height, quaternion(np.asarray(turn, float))]
    place = phipsi.pose(q[:3], quat=q[3:])[:3, :3]
    return q, np.r_[place.T @ velocity, turning]


def beside(x: float, y: float, radius: float) -> np.ndarray:
    """A ball that touches the edge, or the corner, of a box at the origin."""
    return np.r_[x, y, np.sqrt(radius**2 - x**2 - y**2), 0, 0, 0, 1]


TILT = np.radians(60.0)
CORNER = np.array([np.pi / 4, 0.3, 0.1])
LOWEST = -float((CORNERS @ (phipsi.pose((0, 0, 0), quat=quaternion(CORNER))[2, :3])).min())
BOX, HULL = shapes.Box((0.2, 2, 0.2), xyz=(-0.1, 0, -0.1)), shapes.Hull(CORNERS * [1, 10, 1] + [-0.1, 0, -0.1])
TIP = shapes.Box((0.2, 0.2, 0.2), xyz=(-0.1, -0.1, -0.1))
CASES = {
    "a ball on an edge of a box": (shapes.Sphere(0.1), BOX, beside(0.03, 0.0, 0.1), [0.2, 0.6, -0.063, 0, 2, 0.4]),
    "a ball on an edge of a hull": (shapes.Sphere(0.1), HULL, beside(0.03, 0.0, 0.1), [0.2, 0.6, -0.063, 0, 2, 0.4]),
    "a ball on a corner of a box": (shapes.Sphere(0.1), TIP, beside(0.03, 0.02, 0.1), [0.2, 0.2, -0.108, 0, 2, 0.4]),
    "a ball on a corner of a hull": (shapes.Sphere(0.1), shapes.Hull(CORNERS - 0.1), beside(0.03, 0.02, 0.1), [0.2, 0.2, -0.108, 0, 2, 0.4]),
    "a ball on a ball": (shapes.Sphere(0.1), shapes.Sphere(0.2), beside(0.05, 0.02, 0.3), [0.2, 0.6, -0.1, 0, 2, 0.4]),
    "a ball on a capsule": (shapes.Sphere(0.1), shapes.Capsule(0.2, 1.0, rpy=LYING), beside(0.05, 0.0, 0.3), [0.2, 0.6, -0.04, 0, 2, 0.4]),
    "a ball on a cylinder": (shapes.Sphere(0.1), shapes.Cylinder(0.2, 1.0, rpy=LYING), beside(0.05, 0.0, 0.3), [0.2, 0.6, -0.04, 0, 2, 0.4]),
    "a capsule on an edge": (shapes.Capsule(0.1, 0.3, rpy=LYING), HULL, beside(0.03, 0.0, 0.1), [0.2, 0.6, -0.063, 0, 2, 0]),
    "a rolling coin": (shapes.Cylinder(0.1, 0.02), shapes.HalfSpace(), *turned([TILT, 0, 0], 0.1 * np.sin(TILT) + 0.01 * np.cos(TILT), [0.5, 0.1, 0], [0.1, 0.2, -5.0])),
    "a corner on a plane": (shapes.Box((0.2, 0.2, 0.2)), shapes.HalfSpace(), *turned(CORNER, LOWEST, [0.5, 0.1, 0], [0.1, 0.2, 0.3])),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_gradients_by_velocities_are_differences_inside_a_mode(name: str) -> None:
    """Velocities that differ leave the contacts closed. Two features that touch have the derivative of their geometry."""
    body, ground, q, qd = CASES[name]
    scene, qd = above(body, ground), np.asarray(qd, float)
    draw = np.random.default_rng(0)
    bar = draw.standard_normal((2, 6))
    cotangents = [np.zeros((STEPS + 1, 6)), np.zeros((STEPS + 1, 6))]
    cotangents[0][-1], cotangents[1][-1] = bar
    path = scene.simulate(q, qd, dt=1e-3, steps=STEPS)
    assert len(path.contacts.shapes.row) >= STEPS
    found = path.vjp(*cotangents).qd

    def end(along: np.ndarray) -> float:
        other = scene.simulate(q, qd + along, dt=1e-3, steps=STEPS)
        return bar[0] @ scene.difference(path.q[-1], other.q[-1]) + bar[1] @ other.qd[-1]

    scale = np.abs(found).max()
    # A line does not leave its direction: a capsule beside an edge touches in one point, and in two only parallel to it.
    for i in (0, 1, 2, 4) if body[1:3] == (0.3, (0.0, 0.0, 0.0)) else range(6):
        along = np.eye(6)[i]
        slopes = [(end(h * along) - end(-h * along)) / (2 * h) for h in (1e-3, 5e-4)]
        assert abs((4 * slopes[1] - slopes[0]) / 3 - found[i]) < 2e-5 * scale, i


def named(friction: float) -> tuple[phipsi.Scene, phipsi.Scene]:
    """A cube on the ground, with a shape and with four points."""
    builder = phipsi.SceneBuilder().link("cube", mass=1.0, inertia=np.eye(3) / 150)
    points = builder.build(floating_base=True).to_builder()
    for i, (x, y) in enumerate([(-0.1, -0.1), (-0.1, 0.1), (0.1, -0.1), (0.1, 0.1)]):
        points.contact(f"corner{i}", "cube", xyz=(x, y, -0.1), friction=friction)
    shape = builder.collider("ground", shapes.HalfSpace(), friction=friction).collider("cube", shapes.Box((0.2, 0.2, 0.2)), link="cube", friction=friction)
    return shape.build(floating_base=True), points.build()


def test_gradients_margins_and_modes_of_a_pair_are_those_of_named_points() -> None:
    """A cube that slides and stops: v - mu g t."""
    shape, points = named(0.4)
    kept: dict[str, Any] = {"dt": 1e-3, "steps": 80}
    q, qd = at((0, 0, 0.1)), np.array([0.25, 0, 0, 0, 0, 0])
    bar = np.zeros((81, 6))
    bar[:, 0] = np.linspace(1, 2, 81)
    of_shape, of_points = (scene.simulate(q, qd, **kept).vjp(bar, bar) for scene in (shape, points))
    pair = ("ground", "cube")
    assert list(of_shape.contacts) == [pair]
    corners = list(of_points.contacts.values())
    assert abs(of_shape.contacts[pair].friction - sum(corner.friction for corner in corners)) < 1e-8 and of_shape.contacts[pair].friction < -1.0
    assert abs(of_shape.contacts[pair].margin - min(corner.margin for corner in corners)) < 1e-9
    assert np.isnan(of_shape.contacts[pair].offset) and np.isnan(of_shape.contacts[pair].normal).all()
    changes, expected = of_shape.mode_changes, of_points.mode_changes
    assert {change.contact for change in changes} == {pair}
    assert [(change.step, change.before, change.after) for change in changes] == [(change.step, change.before, change.after) for change in expected]
    assert [(change.before, change.after) for change in changes] == [(SLIDING, STICKING)] * 4
    # A landing.
    changes, expected = (scene.simulate(q + 1e-4 * np.eye(7)[2], qd, **kept).vjp(bar, bar).mode_changes for scene in (shape, points))
    assert [change[1:] for change in changes] == [change[1:] for change in expected]
    assert [(change.before, change.after) for change in changes] == [(OPEN, SLIDING)] * 4 + [(SLIDING, STICKING)] * 4


def test_states_of_a_batch_have_their_own_pairs() -> None:
    """The friction of a pair has no effect on a state in which it cannot touch."""
    shape, _ = named(0.2)
    q = np.stack([at((0, 0, 0.1)), at((0, 0, 5.0))])
    qd = np.zeros((2, 6))
    qd[:, 0] = 1.0
    bar = np.zeros((2, 11, 6))
    bar[:, -1, 0] = 1.0
    found = shape.simulate(q, qd, dt=1e-3, steps=10).vjp(cotangent_qd=bar).contacts["ground", "cube"]
    assert np.allclose(found.friction, [-G * 0.01, 0.0], rtol=0, atol=1e-9)
    assert np.isinf(found.margin[1]) and found.margin[0] < 0.1 and found.normal.shape == (2, 3)
