"""Towers and walls: many contacts between bodies that rest on each other, whose weights and places are known."""

from __future__ import annotations

import numpy as np
import pytest

import phipsi
from phipsi import shapes

LENGTH, WIDTH, HEIGHT = 0.2, 0.1, 0.06


def wall(rows: int, columns: int, gap: float) -> tuple[phipsi.Scene, np.ndarray, np.ndarray]:
    """A wall of bricks in running bond, with half bricks at the ends of every second row: scene, q and masses."""
    builder = phipsi.SceneBuilder().link("world").collider("ground", shapes.HalfSpace())
    q: list[float] = []
    masses = []
    for row in range(rows):
        halved = columns > 1 and row % 2 == 1
        for column in range(columns + 1 if halved else columns):
            short = halved and column in (0, columns)
            length = LENGTH / 2 if short else LENGTH
            x = column * (LENGTH + gap)
            if halved:
                x -= LENGTH / 4 if column == 0 else 3 * LENGTH / 4 + gap if column == columns else (LENGTH + gap) / 2
            name, mass = f"brick{len(masses)}", length / LENGTH
            builder = builder.link(name, mass=mass, shape=shapes.Box((length, WIDTH, HEIGHT)), collide=True)
            builder = builder.joint(f"of_{name}", "floating", "world", name)
            q += [x, 0.0, HEIGHT * (row + 0.5), 0.0, 0.0, 0.0, 1.0]
            masses.append(mass)
    return builder.build(), np.array(q), np.array(masses)


def test_a_tower_of_thirty_bricks_stands_and_each_carries_those_above() -> None:
    scene, q, _ = wall(30, 1, 0.0)
    path = scene.simulate(q, np.zeros(scene.nv), dt=2e-3, steps=100, record_every=100)
    assert bool(path.contacts.converged) and float(path.contacts.residual) < 1e-10
    assert np.abs(path.q[-1] - q).max() < 1e-9 and np.abs(path.qd[-1]).max() < 1e-9
    # The force between each brick and the one below it is the weight of all bricks from it on.
    touching = path.contacts.shapes
    upper = touching.pair[:, 1]
    loads = np.array([np.abs(touching.force[(upper == k) & (touching.row == 1), 2]).sum() for k in range(1, 31)])
    assert np.allclose(loads, 9.81 * np.arange(30, 0, -1), rtol=1e-6)


@pytest.mark.parametrize(("rows", "columns", "gap"), [(10, 10, 1e-3), (5, 3, 0.0)])
def test_a_wall_stands_on_the_same_contacts_in_each_step(rows: int, columns: int, gap: float) -> None:
    """Which gaps of bodies that fall together are above zero depends on rounding; their forces do not."""
    scene, q, masses = wall(rows, columns, gap)
    at, speed, forces = q, np.zeros(scene.nv), []
    for _ in range(3):
        path = scene.simulate(at, speed, dt=2e-3, steps=1)
        assert bool(path.contacts.converged)
        at, speed = path.q[-1], path.qd[-1]
        touching = path.contacts.shapes
        on_ground = touching.pair[:, 0] == 0
        assert np.isclose(np.abs(touching.force[on_ground, 2]).sum(), 9.81 * masses.sum(), rtol=1e-8)
        forces.append(np.sort(np.abs(touching.force[:, 2])))
    assert np.abs(at - q).max() < 1e-10 and np.abs(speed).max() < 1e-8
    if gap > 0.0:
        assert all(len(force) == len(forces[0]) and np.allclose(force, forces[0], rtol=1e-4, atol=1e-6) for force in forces)
