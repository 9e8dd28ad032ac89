"""Criteria of the suites: one function per scenario, with a value for phipsi and for MuJoCo with each softness."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
import phipsi
import phipsi.mujoco

from . import scenarios
from .programs import DEFAULT, Array, Motion, Scenario, compiled, elastic, hard, law, own, scene_of, start, theirs

Value = float | None


class Row(NamedTuple):
    scenario: str
    criterion: str
    values: tuple[Value, Value, Value]
    """phipsi, MuJoCo with its default, MuJoCo hard; None: not applicable."""
    unit: str = ""


class Result(NamedTuple):
    suite: str
    rows: list[Row]


def motions(scenario: Scenario, dt: float) -> tuple[phipsi.Scene, list[Motion]]:
    scene = scene_of(scenario)
    return scene, [own(scenario, scene, dt), *(theirs(scenario, scene, dt, each) for each in (DEFAULT, hard(dt)))]


def rows(scenario: str, found: dict[tuple[str, str], list[Value]]) -> list[Row]:
    return [Row(scenario, criterion, (first, second, third), unit) for (criterion, unit), (first, second, third) in found.items()]


def laws(all_motions: list[list[Motion]]) -> dict[tuple[str, str], list[Value]]:
    """The criteria of ContactBench: the largest of all runs, by program."""
    each = [[law(motion) for motion in program] for program in all_motions]
    return {
        ("Signorini", "J"): [max(one.signorini for one in program) for program in each],
        ("maximal dissipation", "J"): [max(one.dissipation for one in program) for program in each],
        ("penetration", "m"): [max(0.0, *(-float(motion.gaps.min()) for motion in program)) for program in all_motions],
    }


def sliding(dt: float, quick: bool) -> list[Row]:
    _, found = motions(scenarios.sliding_cube(), dt)
    exact = 1.0 / (2 * scenarios.MU * scenarios.G)
    stop: dict[tuple[str, str], list[Value]] = {("distance to the stop, error", "m"): [abs(float(motion.q[-1, 1]) - exact) for motion in found]}
    return rows("sliding cube", {**laws([[motion] for motion in found]), **stop})


def dragged(dt: float, quick: bool) -> list[Row]:
    scenario = scenarios.dragged_cube(dt)
    _, found = motions(scenario, dt)
    assert scenario.force is not None
    exact = dt * float(np.sum(np.maximum(scenario.force[:, 1] - scenarios.MU * scenarios.G, 0.0)))
    speed: dict[tuple[str, str], list[Value]] = {("velocity at the end, error", "m/s"): [abs(float(motion.qd[-1, 1]) - exact) for motion in found]}
    return rows("dragged cube", {**laws([[motion] for motion in found]), **speed})


def energies(scene: phipsi.Scene, motion: Motion) -> Array:
    found = scene.energy(motion.q, motion.qd)
    return np.asarray(found.kinetic + found.potential)


def dropped(dt: float, quick: bool) -> list[Row]:
    runs = [motions(scenarios.dropped_cube(seed), dt) for seed in range(2 if quick else 10)]
    programs = [[found[i] for _, found in runs] for i in range(3)]

    def rise(motion: Motion) -> float:
        total = energies(runs[0][0], motion)
        return float(np.max(total - np.minimum.accumulate(total)))

    gains: dict[tuple[str, str], list[Value]] = {("largest rise of the energy", "J"): [max(map(rise, program)) for program in programs]}
    return rows("dropped cube", {**laws(programs), **gains})


def rolling(dt: float, quick: bool) -> list[Row]:
    scenario = scenarios.rolling()
    scene, found = motions(scenario, dt)
    along = scene.gravity[:2] / np.linalg.norm(scene.gravity[:2])
    # The box slides with friction 0.4, the balls roll; SimBenchmark takes the box and one ball.
    rates = 15.0 - 0.4 * scenarios.G, 15.0 / 1.4

    def error(motion: Motion) -> float:
        time, total = dt * np.arange(len(motion.q)), 0.0
        for at, rate in zip((0, 1), rates, strict=True):
            q, qd = motion.q[:, 7 * at : 7 * at + 7], motion.qd[:, 6 * at : 6 * at + 3]
            x, y, z, w = q[:, 3:].T
            spin = np.stack([x, y, z], axis=1)
            once = 2 * np.cross(spin, qd)
            velocity = qd + w[:, None] * once + np.cross(spin, once)
            total += float(np.mean(np.sum((velocity - np.outer(rate * time, [*along, 0])) ** 2, axis=1)))
        return total

    return rows("rolling", {("mean squared error of the velocities", "(m/s)^2"): [error(motion) for motion in found]})


def bouncing(dt: float, quick: bool) -> list[Row]:
    scenario = scenarios.bouncing()
    scene = scene_of(scenario)
    found = [own(scenario, scene, dt), *(theirs(scenario, scene, dt, each) for each in (DEFAULT, elastic(dt)))]
    first = energies(scene, found[0])[0]
    errors = [float(np.sqrt(np.mean((energies(scene, motion) / first - 1.0) ** 2))) for motion in found]
    return rows("bouncing (hard: no damping)", {("root mean squared error of the energy, relative", ""): [*errors]})


def thousand(dt: float, quick: bool) -> list[Row]:
    scenario = scenarios.thousand_balls()
    ball, steps, every = scene_of(scenario), round(scenario.duration / dt), round(4e-3 / dt)
    heights = [ball.simulate(*start(scenario, ball), dt=dt, steps=steps, record_every=every).q[..., 2].T]
    for softness in (DEFAULT, hard(dt)):
        model = compiled(scenario, dt, softness)
        data = mujoco.MjData(model)
        data.qpos[:], kept = scenario.qpos, []
        for _ in range(steps // every):
            mujoco.mj_step(model, data, nstep=every)
            kept.append(data.qpos[2::7].copy())
        heights.append(np.array(kept))
    errors: list[Value] = [float(np.mean(np.sum(np.maximum(0.1 - height, 0.0) ** 2, axis=1))) for height in heights]
    return rows("thousand balls", {("mean sum of squared penetrations", "m^2"): errors})


def piles(dt: float, quick: bool) -> list[Row]:
    """Rows every 40 ms: pairs are too many for records of every step."""
    found: list[Row] = []
    for side in (2,) if quick else (3, 6) if dt > 2e-3 else (3,):
        scenario, every = scenarios.pile(side), round(0.04 / dt)
        scene, steps = scene_of(scenario), round(scenario.duration / dt)
        path = scene.simulate(*start(scenario, scene), dt=dt, steps=steps, record_every=every)
        states = [(path.q, path.qd)]
        for softness in (DEFAULT, hard(dt)):
            model = compiled(scenario, dt, softness)
            data = mujoco.MjData(model)
            data.qpos[:], kept = scenario.qpos, [(scenario.qpos, scenario.qvel)]
            for _ in range(steps // every):
                mujoco.mj_step(model, data, nstep=every)
                kept.append((data.qpos.copy(), data.qvel.copy()))
            states.append(phipsi.mujoco.to_state(scene, *(np.array(part) for part in zip(*kept, strict=True))))

        def rise(q: Array, qd: Array, scene: phipsi.Scene = scene) -> float:
            energy = scene.energy(q, qd)
            total = np.asarray(energy.kinetic + energy.potential)
            return float(np.max(total - np.minimum.accumulate(total)))

        gaps = [np.minimum(scene.contacts.gaps(q), 0.0) for q, _ in states]
        found += rows(scenario.name, {
            ("mean sum of squared penetrations", "m^2"): [float(np.mean(np.sum(gap**2, axis=1))) for gap in gaps],
            ("largest rise of the energy", "J"): [rise(*state) for state in states],
            ("horizontal momentum", "N s"): [float(np.max(np.abs(scene.momentum(*state)[:, 3:5]))) for state in states],
        })  # fmt: skip
    return found


def standing(dt: float, quick: bool) -> list[Row]:
    scene, found = motions(scenarios.standing(), dt)
    early = round(2.0 / dt)

    def slip(motion: Motion) -> float:
        moved = [scene.placement(motion.q[[early, -1]], foot)[:, :2, 3] for foot in scenarios.FEET]
        return max(float(np.linalg.norm(last - first)) for first, last in moved)

    table: dict[tuple[str, str], list[Value]] = {
        ("height of the trunk after 10 s", "m"): [float(motion.q[-1, 2]) for motion in found],
        ("slip of a foot from 2 s to 10 s", "m"): [slip(motion) for motion in found],
    }
    return rows("ANYmal, PD control", {**laws([[motion] for motion in found]), **table})


def energy(dt: float, quick: bool) -> list[Row]:
    scenario = scenarios.thrown()
    scene = scene_of(scenario)

    def error(motion: Motion) -> float:
        total = energies(scene, motion)
        return float(np.mean((total - total[0]) ** 2))

    table: list[Row] = []
    for order, method, integrator in ((1, "semi-implicit-euler", "EULER"), (4, "auto", "RK4")):
        scenario.options["method"] = method
        found = [error(own(scenario, scene, dt)), error(theirs(scenario, scene, dt, DEFAULT, integrator)), None]
        table += rows("ANYmal, energy", {(f"mean squared error of the energy, order {order}", "J^2"): found})
    return table


def momentum(dt: float, quick: bool) -> list[Row]:
    scene, found = motions(scenarios.colliding(), dt)

    def error(motion: Motion, until: float) -> float:
        p = scene.momentum(motion.q, motion.qd)[:, 3:]
        given = np.concatenate([np.zeros((1, 3)), np.cumsum(motion.root, axis=0)])
        return float(np.max(np.linalg.norm(p - p[0] - given, axis=1)[: round(until / dt) + 1]))

    table: dict[tuple[str, str], list[Value]] = {
        ("momentum minus contact impulses until 0.2 s", "N s"): [error(motion, 0.2) for motion in found],
        ("momentum minus contact impulses until 1 s", "N s"): [error(motion, 1.0) for motion in found],
        ("penetration", "m"): [max(0.0, -float(motion.gaps.min())) for motion in found],
    }
    return rows("ANYmal, momentum", table)


CONTACT_BENCH: dict[str, Callable[[float, bool], list[Row]]] = {"sliding cube": sliding, "dragged cube": dragged, "dropped cube": dropped}
SIM_BENCHMARK: dict[str, Callable[[float, bool], list[Row]]] = {
    "rolling": rolling, "bouncing": bouncing, "thousand balls": thousand, "piles": piles, "ANYmal, PD control": standing, "ANYmal, energy": energy, "ANYmal, momentum": momentum,
}  # fmt: skip
#: Scenarios whose steps are timed, with the number of steps.
TIMED: dict[str, tuple[Callable[[], Scenario], int]] = {
    "sliding cube": (scenarios.sliding_cube, 200),
    "dropped cube": (lambda: scenarios.dropped_cube(0), 200),
    "rolling, 26 bodies": (scenarios.rolling, 50),
    "bouncing, 49 bodies": (scenarios.bouncing, 2000),
    "thousand balls, all": (scenarios.thousand_balls, 200),
    "pile of 27 balls": (lambda: scenarios.pile(3), 100),
    "ANYmal, PD control": (scenarios.standing, 1000),
    "ANYmal, momentum": (scenarios.colliding, 200),
}
