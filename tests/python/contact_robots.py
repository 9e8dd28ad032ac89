"""Robots with contacts whose links and contacts can be changed by name, and gradients of their simulations by differences
of order four.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import phipsi

EDGES = np.array([0.4, 0.3, 0.2])
STEP = 1e-5
"""Step of the differences: the error of the solves of contacts over it is about 1e-9 of the scale."""
STEP_OF_GAPS = 1e-6
"""Step for what changes gaps, whose derivatives are of the size 1/dt, so that the error of the differences is larger."""


def parameters(mass: float, com: Any, central: np.ndarray) -> np.ndarray:
    """(m, m c, I) about the origin, as in RolloutGradients.parameters."""
    c = np.array(com, dtype=float)
    about = central + mass * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([mass, *(mass * c), about[0, 0], about[0, 1], about[1, 1], about[0, 2], about[1, 2], about[2, 2]])


@dataclass(frozen=True)
class Robot:
    links: dict[str, np.ndarray]
    contacts: dict[str, dict[str, Any]]
    joints: tuple[dict[str, Any], ...] = ()
    floating: bool = True
    gravity: tuple[float, ...] = (0.3, -0.2, -9.81)
    connections: tuple[dict[str, Any], ...] = ()

    def build(self) -> phipsi.Scene:
        builder = phipsi.SceneBuilder()
        if not self.floating:
            builder.link("world")
        for name, of in self.links.items():
            c = of[1:4] / of[0]
            about = of[4:][[[0, 1, 3], [1, 2, 4], [3, 4, 5]]]
            builder.link(name, mass=of[0], com=c, inertia=about - of[0] * (c @ c * np.eye(3) - np.outer(c, c)))
        for joint in self.joints:
            builder.joint(joint["name"], joint["kind"], joint["parent"], joint["child"], **{k: v for k, v in joint.items() if k not in ("name", "kind", "parent", "child")})
        for name, contact in self.contacts.items():
            builder.contact(name, **{k: v for k, v in contact.items() if is_plane(contact) or k not in ("normal", "offset")})
        for connection in self.connections:
            builder.connect(**connection)
        mimic = "couple" if any("mimic" in joint for joint in self.joints) else None
        return builder.build(floating_base=self.floating, gravity=self.gravity, mimic=mimic)

    def with_link(self, name: str, entry: int, more: float) -> Robot:
        changed = self.links[name].copy()
        changed[entry] += more
        return replace(self, links={**self.links, name: changed})

    def with_contact(self, name: str, **changed: Any) -> Robot:
        return replace(self, contacts={**self.contacts, name: {**self.contacts[name], **changed}})


def contact(link: str, xyz: Any, friction: float, **given: Any) -> dict[str, Any]:
    return {"link": link, "xyz": xyz, "friction": friction, "radius": 0.0, "normal": np.array([0, 0, 1.0]), "offset": 0.0, "restitution": 0.0, **given}


def is_plane(of: dict[str, Any]) -> bool:
    return "other_radius" not in of and "other_size" not in of


def block(friction: float, restitution: float = 0.0, corners: tuple[int, ...] = tuple(range(8)), **given: Any) -> Robot:
    central = 2.0 / 12 * np.diag([EDGES[1] ** 2 + EDGES[2] ** 2, EDGES[0] ** 2 + EDGES[2] ** 2, EDGES[0] ** 2 + EDGES[1] ** 2])
    central = central + 1e-3 * np.array([[0, 1, 0.5], [1, 0, -0.7], [0.5, -0.7, 0]])
    sides = {i: np.array([i & 1, i >> 1 & 1, i >> 2 & 1]) - 0.5 for i in corners}
    contacts = {f"corner{i}": contact("block", side * EDGES, friction, restitution=restitution, **given) for i, side in sides.items()}
    return Robot({"block": parameters(2.0, (0.01, -0.02, 0.015), central)}, contacts)


def ball(friction: float, restitution: float = 0.0) -> Robot:
    tilted = np.array([0.2, -0.1, 1.0])
    on = contact("ball", (0.01, 0.005, -0.01), friction, restitution=restitution, radius=0.1, normal=tilted, offset=0.05)
    return Robot({"ball": parameters(0.5, (0.01, 0.0, -0.005), np.diag([2e-3, 2.2e-3, 1.9e-3]))}, {"ground": on})


def quadruped(friction: float, restitution: float = 0.0) -> Robot:
    links = {"trunk": parameters(4.0, (0.01, 0, 0.02), np.diag([0.03, 0.06, 0.07]))}
    joints: list[dict[str, Any]] = []
    contacts = {}
    for side, (x, y) in {"fl": (0.2, 0.12), "fr": (0.2, -0.12), "hl": (-0.2, 0.12), "hr": (-0.2, -0.12)}.items():
        for part, parent, xyz in ((f"{side}_thigh", "trunk", (x, y, 0.0)), (f"{side}_shank", f"{side}_thigh", (0, 0, -0.2))):
            links[part] = parameters(0.4, (0, 0, -0.1), np.diag([2e-3, 2e-3, 3e-4]))
            axis = (0.1, 1, 0) if part.endswith("thigh") else (0, 1, 0.1)
            joints.append({"name": part, "kind": "continuous", "parent": parent, "child": part, "xyz": xyz, "axis": axis})
        contacts[side] = contact(f"{side}_shank", (0, 0, -0.2), friction, radius=0.02, restitution=restitution)
    return Robot(links, contacts, tuple(joints))


def arm(friction: float, restitution: float = 0.0) -> Robot:
    """Three links with stops, whose tip slides on a table."""
    links, joints, parent = {}, [], "world"
    for i, axis in enumerate([(0, 1, 0), (0, 1, 0.2), (0.3, 1, 0)]):
        links[f"l{i}"] = parameters(1.0 - 0.2 * i, (0.01, 0.02, -0.2), np.diag([0.02, 0.02, 0.004]))
        joints.append(
            {"name": f"j{i}", "kind": "revolute", "parent": parent, "child": f"l{i}", "xyz": (0, 0, -0.4 * (i > 0)), "axis": axis,
             "lower": -1.2, "upper": 1.2, "effort": 99, "velocity": 99}
        )  # fmt: skip
        parent = f"l{i}"
    on = contact("l2", (0.0, 0.01, -0.35), friction, radius=0.03, restitution=restitution, offset=-0.9)
    return Robot(links, {"tip": on}, tuple(joints), floating=False)


@dataclass
class Run:
    """A batch of simulations and a random function of all their rows."""

    robot: Robot
    q: np.ndarray
    qd: np.ndarray
    given: dict[str, Any]

    def __post_init__(self) -> None:
        self.scene = self.robot.build()
        self.path = self.scene.simulate(self.q, self.qd, **self.given)
        random = np.random.default_rng(7)
        self.bars = random.uniform(-1, 1, (2, *self.path.qd.shape))
        self.modes = self.modes_of(self.path)
        self.changed = np.zeros(self.q.shape[:-1], dtype=bool)

    @staticmethod
    def modes_of(path: phipsi.Trajectory) -> np.ndarray:
        assert path.contacts is not None
        return np.stack([path.contacts.state[name] for name in path.contacts.state], axis=-1)

    def value(self, robot: Robot, q: np.ndarray, qd: np.ndarray, given: dict[str, Any]) -> np.ndarray:
        path = robot.build().simulate(q, qd, **given)
        self.changed |= (self.modes_of(path) != self.modes).any(axis=(-1, -2))
        moved = self.scene.difference(self.path.q, path.q)
        return np.einsum("...ri,...ri->...", self.bars[0], moved) + np.einsum("...ri,...ri->...", self.bars[1], path.qd)

    @staticmethod
    def slope(at: Callable[[float], np.ndarray], step: float) -> np.ndarray:
        """The derivative, and the difference from that with twice the step: (2, ...)."""
        once, twice, four = ((at(k * step) - at(-k * step)) / (2 * k * step) for k in (1, 2, 4))
        fine, coarse = (4 * once - twice) / 3, (4 * twice - four) / 3
        return np.stack([fine, np.abs(fine - coarse)])

    def all_of(self, changes: list[Callable[[float], np.ndarray]], step: float = STEP) -> np.ndarray:
        return np.stack([self.slope(change, step) for change in changes], axis=-1)

    def compared_states(self, found: phipsi.RolloutGradients) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """As `compared`, of the initial state."""
        robot, q, qd, given, unit = self.robot, self.q, self.qd, self.given, np.eye(self.scene.nv)
        yield "q", found.q, self.all_of([lambda s, e=e: self.value(robot, self.scene.integrate(q, s * e), qd, given) for e in unit], STEP_OF_GAPS)
        yield "qd", found.qd, self.all_of([lambda s, e=e: self.value(robot, q, qd + s * e, given) for e in unit])

    def compared(self) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Name, gradients (..., entries), and differences with their estimated errors (2, ..., entries), of everything that has
        a gradient.
        """
        found = self.path.vjp(*self.bars, parameters=True)
        robot, q, qd, given, unit, all_of = self.robot, self.q, self.qd, self.given, np.eye(self.scene.nv), self.all_of
        yield from self.compared_states(found)
        for name in ("tau", "armature", "damping", "stiffness", "friction"):
            if name in given:
                own = np.zeros(self.scene.nv) + given[name]
                slopes = all_of([lambda s, e=e, name=name, own=own: self.value(robot, q, qd, {**given, name: own + s * e}) for e in unit])
                yield name, getattr(found, name), slopes
        of_links = [
            lambda s, name=name, entry=entry: self.value(robot.with_link(name, entry, s), q, qd, given)
            for name in robot.links
            for entry in range(10)
        ]
        yield "parameters", found.parameters.reshape(*q.shape[:-1], -1), all_of(of_links)
        for entry in ("friction", "restitution", "offset"):
            names = [name for name, of in robot.contacts.items() if (is_plane(of) if entry == "offset" else of[entry] > 0.0)]
            if names:
                of_contacts = [
                    lambda s, name=name, entry=entry: self.value(robot.with_contact(name, **{entry: robot.contacts[name][entry] + s}), q, qd, given)
                    for name in names
                ]
                yield f"contact {entry}", np.stack([getattr(found.contacts[name], entry) for name in names], axis=-1), all_of(of_contacts, STEP_OF_GAPS if entry == "offset" else STEP)
        gradients, turns = [], []
        for name, of in robot.contacts.items():
            if not is_plane(of):
                assert np.isnan(found.contacts[name].normal).all() and np.isnan(found.contacts[name].offset).all()
                continue
            normal = of["normal"] / np.linalg.norm(of["normal"])
            for along in np.linalg.svd(normal[None])[2][1:]:
                gradients.append(found.contacts[name].normal @ along)
                turns.append(
                    lambda s, name=name, along=along, normal=normal: self.value(
                        robot.with_contact(name, normal=np.cos(s) * normal + np.sin(s) * along), q, qd, given
                    )
                )
        if turns:
            yield "contact normal", np.stack(gradients, axis=-1), all_of(turns, STEP_OF_GAPS)
