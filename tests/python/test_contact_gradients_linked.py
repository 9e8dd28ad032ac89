"""Gradients through contacts between two links, and through contacts of robots with mimic joints and connections: compared
with differences of order four of the simulation inside one mode.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from contact_robots import STEP_OF_GAPS, Robot, Run, ball, contact, parameters
from test_contact_gradients import check, properties, states
from tolerances import CONTACT_GRADIENT, assert_near

import phipsi

#: Differences with respect to a start move contacts below their surface.
pytestmark = pytest.mark.filterwarnings("ignore::phipsi.errors.ContactWarning")

OPEN, STICKING, SLIDING = phipsi.ContactState


# Contacts between two links


def ball_on_a_link(surface: dict[str, Any], friction: float, restitution: float = 0.0, *, point: bool = False) -> Robot:
    """A free ball beside the second link of an arm of two, with a surface fixed on that link."""
    links, joints, parent = {}, [], "world"
    for i, axis in enumerate([(0.2, 1, 0), (1, 0.1, 0.2)]):
        links[f"l{i}"] = parameters(1.5 - 0.5 * i, (0.02, 0.01, 0.1), np.diag([0.03, 0.02, 0.025]))
        joints.append({"name": f"j{i}", "kind": "continuous", "parent": parent, "child": f"l{i}", "xyz": (0, 0, 0.3 * i), "axis": axis})
        parent = f"l{i}"
    links["ball"] = parameters(0.5, (0.01, 0.0, -0.005), np.diag([2e-3, 2.2e-3, 1.9e-3]))
    joints.append({"name": "free", "kind": "floating", "parent": "world", "child": "ball"})
    on = contact("ball", (0.01, 0.005, -0.01), friction, restitution=restitution, radius=0.0 if point else 0.1, other="l1", **surface)
    return Robot(links, {"pair": on}, tuple(joints), floating=False)


TURNED = {"other_xyz": (0.02, -0.01, 0.2), "other_rpy": (0.1, 0.2, 0.3)}
PLANE = {**TURNED, "normal": np.array([0.1, -0.2, 1.0]), "offset": 0.03}
SPHERE = {**TURNED, "other_radius": 0.15}
BOX = {**TURNED, "other_size": (0.3, 0.2, 0.25)}


def ball_states(robot: Robot, count: int, random: np.random.Generator, *, toward: np.ndarray, fast: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """The ball just outside of the surface, in the direction `toward` of the link's frame, and approaching it."""
    scene = robot.build()
    q, qd = np.zeros((count, scene.nq)), random.normal(size=(count, scene.nv)) * fast
    free, moving = scene.q_index("free"), scene.v_index("free")
    for i in range(count):
        q[i] = scene.integrate(scene.neutral(), random.normal(size=scene.nv) * 0.4)
        place = scene.placements(q[i])["l1"]
        along = place[:3, :3] @ (toward / np.linalg.norm(toward) + 0.1 * random.normal(size=3))
        along /= np.linalg.norm(along)
        q[i, free][:3] = place[:3, :3] @ TURNED["other_xyz"] + place[:3, 3] + 0.4 * along
        for _ in range(40):
            gap = scene.contacts.gaps(q[i])[0]
            q[i, free][:3] -= (gap - random.uniform(1e-4, 1e-3)) * along
        # In the axes of the ball.
        turn = scene.placements(q[i])["ball"][:3, :3]
        qd[i, moving][:3] -= turn.T @ along
    gaps = scene.contacts.gaps(q)[:, 0]
    keep = (gaps > 0) & (gaps < 2e-3)
    assert keep.mean() > 0.9
    return q[keep], qd[keep]


@pytest.mark.parametrize(("friction", "restitution", "expected"), [(1.5, 0.0, {STICKING}), (0.05, 0.0, {SLIDING}), (0.3, 0.6, set())], ids=["sticks", "slides", "bounces"])
@pytest.mark.parametrize(
    ("surface", "toward"),
    [(PLANE, (0.1, -0.2, 1.0)), (SPHERE, (0.3, 0.5, 1.0)), (BOX, (0.1, 0.1, 1.0)), (BOX, (1.0, 0.1, 0.8)), (BOX, (1.0, 0.75, 0.8))],
    ids=["plane", "sphere", "face", "edge", "corner"],
)
def test_a_ball_on_a_moving_surface_beside_differences(surface: dict[str, Any], toward: Any, friction: float, restitution: float, expected: set[phipsi.ContactState]) -> None:
    random = np.random.default_rng(4)
    robot = ball_on_a_link(surface, friction, restitution)
    q, qd = ball_states(robot, 20, random, toward=np.array(toward))
    nv = robot.build().nv
    check(Run(robot, q, qd, {"dt": 2e-3, "steps": 2, **properties(nv, random)}), 8, expected, rebounds=restitution > 0)


@pytest.mark.parametrize("friction", [1.5, 0.05])
def test_a_plane_of_the_world_in_another_frame_beside_differences(friction: float) -> None:
    """The gradients by normal and offset are those in the second frame."""
    random = np.random.default_rng(12)
    robot = ball(friction)
    robot = robot.with_contact("ground", other_xyz=np.array([0.3, -0.2, 0.4]), other_rpy=np.array([0.1, -0.15, 0.7]))
    q, qd = states(robot, 30, random)
    check(Run(robot, q, qd, {"dt": 3e-3, "steps": 2}), 15, set())


# A gripper with a mimic joint

EDGE = 0.2


def gripper(friction: float, restitution: float = 0.0, points: int = 1) -> Robot:
    """A palm on two joints, two fingers of which the second follows the first, and a free box between them."""
    links = {"arm": parameters(1.0, (0.02, 0.01, 0.1), np.diag([0.022, 0.03, 0.012])), "palm": parameters(0.8, (0.01, 0.0, 0.02), np.diag([4e-3, 3e-3, 2e-3]))}
    joints: list[dict[str, Any]] = [
        {"name": "arm", "kind": "continuous", "parent": "world", "child": "arm", "axis": (0.1, 1, 0.2)},
        {"name": "wrist", "kind": "continuous", "parent": "arm", "child": "palm", "xyz": (0, 0, 0.3), "axis": (1, 0.2, 0.1)},
    ]
    for side, name in ((-1.0, "left"), (1.0, "right")):
        links[name] = parameters(0.4, (0.005, 0.0, 0.01), np.diag([2e-3, 2.4e-3, 1.8e-3]))
        follows = {"mimic": "left", "mimic_multiplier": 0.8, "mimic_offset": 0.003} if name == "right" else {}
        joints.append({"name": name, "kind": "prismatic", "parent": "palm", "child": name, "axis": (-side, 0, 0), "xyz": (side * EDGE / 2, 0, 0.1), **follows})
    links["box"] = parameters(0.5, (0.01, -0.02, 0.01), 0.5 * EDGE**2 / 6 * np.diag([1.0, 1.1, 0.9]))
    joints.append({"name": "free", "kind": "floating", "parent": "world", "child": "box"})
    contacts = {}
    for name in ("left", "right"):
        for i, (y, z) in enumerate([(0.005, -0.01), (0.0, 0.06), (0.06, -0.05)][:points]):
            contacts[f"{name}{i}"] = contact(name, (0, y, z), friction, restitution=restitution, other="box", other_size=(EDGE, EDGE, EDGE))
    return Robot(links, contacts, tuple(joints), floating=False)


def gripper_states(robot: Robot, count: int, random: np.random.Generator, *, slip: float) -> tuple[np.ndarray, np.ndarray]:
    """The box between the fingers, which close; it moves with the palm, and slips with random velocities."""
    scene = robot.build()
    free, moving, left, arm = scene.q_index("free"), scene.v_index("free"), scene.v_index("left"), slice(0, 2)
    q, qd = np.tile(scene.neutral(), (count, 1)), np.zeros((count, scene.nv))
    for i in range(count):
        q[i, arm], qd[i, arm] = random.normal(size=2) * 0.3, random.normal(size=2) * 0.5
        q[i, scene.q_index("left")] = -(0.003 + random.uniform(2e-4, 4e-4)) / 1.8
        place = scene.placements(q[i])
        turn = place["palm"][:3, :3]
        box = 0.5 * (place["left"] + place["right"])[:3, 3] + turn @ (random.normal(size=3) * [5e-5, 1e-3, 1e-3])
        u, _, v = np.linalg.svd(turn @ (np.eye(3) + np.cross(np.eye(3), random.normal(size=3) * 5e-4)))
        q[i, free] = [*box, *quaternion(u @ v)]
        # The velocity of the palm at the box, by differences.
        by = [scene.placements(scene.integrate(q[i], sign * 1e-6 * qd[i]))["palm"] @ np.linalg.inv(place["palm"]) for sign in (1, -1)]
        rate = (by[0] - by[1]) / 2e-6
        own, spin = scene.placements(q[i])["box"][:3, :3], np.array([rate[2, 1], rate[0, 2], rate[1, 0]])
        qd[i, moving] = [*(own.T @ (rate @ [*box, 1.0])[:3]), *(own.T @ spin)] + random.normal(size=6) * slip * [0.3, 1, 1, 0.5, 0.5, 0.5]
        qd[i, left] = random.uniform(0.2, 0.4)
    return q, qd


def quaternion(turn: np.ndarray) -> np.ndarray:
    """(x, y, z, w) of a rotation by less than pi/2."""
    w = 0.5 * np.sqrt(1.0 + np.trace(turn))
    return np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1], 4 * w * w]) / (4 * w)


@pytest.mark.parametrize(
    ("friction", "slip", "restitution", "points", "expected"),
    [(0.4, 0.06, 0.0, 1, {STICKING, SLIDING}), (0.1, 0.3, 0.0, 1, {SLIDING}), (0.4, 0.1, 0.5, 1, set()), (0.0, 0.1, 0.0, 3, set()), (0.2, 0.1, 0.0, 3, {SLIDING})],
    ids=["holds", "slides", "bounces", "three smooth points", "three points"],
)
def test_a_gripper_with_a_mimic_joint_beside_differences(friction: float, slip: float, restitution: float, points: int, expected: set[phipsi.ContactState]) -> None:
    random = np.random.default_rng(6)
    robot = gripper(friction, restitution, points)
    scene = robot.build()
    q, qd = gripper_states(robot, 24, random, slip=slip)
    tau = np.zeros(scene.nv)
    tau[scene.v_index("left")] = 30.0
    # Steps of "contact" are not divided: both fingers share an impact.
    run = Run(robot, q, qd, {"dt": 2e-3, "steps": 2 if points > 1 else 3, "method": "contact", **properties(scene.nv, random), "tau": tau})
    # Six contacts are redundant: their impulses have the accuracy of the solver, and its error over the step is in the differences.
    check(run, 8, expected, rebounds=restitution > 0, sure_share=0.95 if points == 1 else 0.5)
    assert run.path.contacts is not None
    closed = [np.any([run.path.contacts.state[f"{side}{i}"] != OPEN for i in range(points)], axis=0) for side in ("left", "right")]
    assert (closed[0] & closed[1]).any(axis=-1).mean() > 0.5


# Legs that are closed loops


def leg(kind: str, friction: float, restitution: float = 0.0) -> Robot:
    """A floating trunk with a four-bar leg. "rod": thigh, shank and crank on skew axes, and a rod, given twice. "hinge":
    parallel axes, so that three of the five rows of the hinge are dependent.
    """
    links = {"trunk": parameters(3.0, (0.01, 0.02, 0.03), np.diag([0.03, 0.04, 0.05]))}
    joints: list[dict[str, Any]] = []
    skew = np.array([[0.0, 0, 0], [0.1, 0, 0.05], [0, 0, -0.1]]) * (kind == "rod")
    for (name, parent, xyz, length, mass), bend in zip(
        [("thigh", "trunk", (0, 0, 0), 0.3, 0.8), ("shank", "thigh", (0, 0, -0.3), 0.4, 0.5), ("crank", "trunk", (0.1, 0, 0), 0.3, 0.4)], skew, strict=True
    ):
        links[name] = parameters(mass, (0.01, 0, -length / 2), mass * length**2 / 12 * np.diag([1, 1, 0.1]))
        joints.append({"name": name, "kind": "continuous", "parent": parent, "child": name, "xyz": xyz, "axis": np.array([0, 1.0, 0]) + bend})
    tie: dict[str, Any] = {"link": "crank", "other": "shank", "xyz": (0, 0, -0.3)}
    if kind == "rod":
        tie.update(kind="distance", other_xyz=(0.1, 0, 0.02), length=0.06)
        ties = ({**tie, "name": "tie"}, {**tie, "name": "again"})
    else:
        tie.update(kind="axis", axis=(0, 1, 0), other_xyz=(0.1, 0, 0.02))
        ties = ({**tie, "name": "tie"},)
    foot = contact("shank", (0, 0.01, -0.4), friction, radius=0.02, restitution=restitution)
    return Robot(links, {"foot": foot}, tuple(joints), connections=ties)


@dataclass
class Closed(Run):
    """States that satisfy connections; gradients by the state are compared along the motions that keep them satisfied."""

    def compared_states(self, found: phipsi.RolloutGradients) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        robot, scene, q, qd, given = self.robot, self.scene, self.q, self.qd, self.given
        _, sizes, rows = np.linalg.svd(scene.loops.jacobian(q))
        rank = int((sizes[0] > 1e-9).sum())
        free = np.moveaxis(rows[:, rank:], 1, 0)

        def moved(s: float, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            q_s, qd_s, *_ = scene.loops.project(scene.integrate(q, s * along), qd)
            return q_s, qd_s

        changes: list[Callable[[float], np.ndarray]] = [lambda s, e=e: self.value(robot, *moved(s, e), given) for e in free]
        turning = np.stack([self.slope(lambda s, e=e: moved(s, e)[1], STEP_OF_GAPS)[0] for e in free])
        own = np.einsum("kbi,bi->bk", free, found.q) + np.einsum("kbi,bi->bk", turning, found.qd)
        yield "q", own, self.all_of(changes, STEP_OF_GAPS)
        yield "qd", np.einsum("kbi,bi->bk", free, found.qd), self.all_of([lambda s, e=e: self.value(robot, q, qd + s * e, given) for e in free])


def leg_states(robot: Robot, count: int, random: np.random.Generator, *, fast: float = 0.5, fall: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """The foot just above the ground, closed, and falling."""
    scene = robot.build()
    bent = scene.neutral()
    bent[7:] = [-0.4, 0.7, -0.35]
    bent = scene.loops.project(bent)[0]
    q = scene.integrate(np.tile(bent, (count, 1)), random.normal(size=(count, scene.nv)) * 0.1)
    qd = random.normal(size=(count, scene.nv)) * fast
    qd[:, 2] -= fall
    q = scene.loops.project(q)[0]
    for _ in range(3):
        q[:, 2] += random.uniform(1e-4, 2e-3, count) - scene.contacts.gaps(q)[:, 0]
    return q, scene.loops.project(q, qd)[1]


@pytest.mark.parametrize(("friction", "restitution", "expected"), [(0.8, 0.0, {STICKING, SLIDING}), (0.1, 0.0, {SLIDING}), (0.4, 0.6, set())], ids=["sticks", "slides", "bounces"])
@pytest.mark.parametrize("kind", ["rod", "hinge"])
def test_a_closed_leg_beside_differences(kind: str, friction: float, restitution: float, expected: set[phipsi.ContactState]) -> None:
    random = np.random.default_rng(8)
    robot = leg(kind, friction, restitution)
    q, qd = leg_states(robot, 30, random)
    nv = robot.build().nv
    check(Closed(robot, q, qd, {"dt": 3e-3, "steps": 3, **properties(nv, random)}), 12, expected, rebounds=restitution > 0)


def test_large_corrections_of_a_loop_are_differentiated() -> None:
    random = np.random.default_rng(9)
    robot = leg("rod", 0.3)
    q, qd = leg_states(robot, 20, random, fast=3.0)
    run = Closed(robot, q, qd, {"dt": 1.5e-2, "steps": 2, **properties(robot.build().nv, random)})
    # The step without projection leaves the loop by this much.
    open_by = np.abs(run.scene.loops.error(run.scene.integrate(run.path.q[:, 0], 1.5e-2 * run.path.qd[:, 1])))
    assert np.median(open_by) > 1e-4
    check(run, 8, set())
