"""Differences between two robots: names, joints, masses, limits, poses and dynamics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ._arguments import whole
from ._core import Scene
from ._install import need_pages
from .errors import ArgumentError, PhipsiError

_Array = NDArray[np.float64]

#: Fields of joints and links that are compared, with their units.
OF_JOINTS = {
    "type": "", "parent": "", "child": "", "xyz": "m", "rotation": "", "axis": "", "pitch": "m/rad", "mimic": "", "lower": "rad or m", "upper": "rad or m", "velocity": "rad/s or m/s",
    "effort": "N m or N", "acceleration": "rad/s^2 or m/s^2", "armature": "kg m^2 or kg", "damping": "N m s/rad or N s/m", "friction": "N m or N", "stiffness": "N m/rad or N/m",
}  # fmt: skip
OF_LINKS = {"mass": "kg", "com": "m", "inertia": "kg m^2"}
#: Differences that a text shows.
MOST = 40


class Difference(NamedTuple):
    """One difference between two robots."""

    where: str
    """The scene, a joint or a link with its name."""
    quantity: str
    """The property that differs, with its unit."""
    first: Any
    """Value of the first robot."""
    second: Any
    """Value of the second robot."""
    relative: float
    """Largest difference relative to the larger value; NaN for texts."""

    def __str__(self) -> str:
        values = " and ".join(text_of(value) for value in (self.first, self.second))
        return f"{self.where}: {self.quantity}: {values}" + (f" (relative difference {self.relative:.2g})" if np.isfinite(self.relative) else "")


@dataclass(frozen=True)
class Comparison:
    """Differences between two robots, returned by phipsi.compare; printed as a list.

    Attributes
    ----------
    properties : tuple of Difference
        Differences of names, joints and links, from the base outward.
    poses : tuple of Difference
        Links whose poses differ at random configurations, from the base outward: largest distance, m, and angle, rad.
    dynamics : tuple of Difference
        Joints whose rows of the mass matrix, gravity torque, bias torque or acceleration differ at random states.
    locked : tuple of str
        Joints that only one of the robots has, or that differ in type: they are locked at neutral for poses and dynamics.
    note : str
        The reason if poses and dynamics could not be compared, otherwise empty.
    scenes : tuple of Scene
        Both robots.
    """

    properties: tuple[Difference, ...]
    poses: tuple[Difference, ...]
    dynamics: tuple[Difference, ...]
    locked: tuple[str, ...]
    note: str
    scenes: tuple[Scene, Scene] = field(repr=False, compare=False)

    def __repr__(self) -> str:
        found = "no difference" if self.same else ", ".join(f"{len(getattr(self, of))} of {of}" for of in ("properties", "poses", "dynamics"))
        return f"<phipsi.Comparison: {found}{f'; first {self.first}' if self.first else ''}>"

    @property
    def same(self) -> bool:
        """Whether no difference was found."""
        return not (self.properties or self.poses or self.dynamics or self.note)

    @property
    def first(self) -> Difference | None:
        """The difference that is nearest to the base, or None."""
        return next(iter((*self.properties, *self.poses, *self.dynamics)), None)

    def report(self, file: str | PathLike[str], *, names: tuple[str, str] = ("first", "second")) -> Path:
        """Write a page with both robots and all differences: the page of `phipsi compare --report`, in one file.

        Parameters
        ----------
        file : path
            File to write, HTML without external resources.
        names : tuple of str, optional
            Names of the robots on the page.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ImportError
            The packages for pages are not installed.

        Examples
        --------
        >>> import phipsi, tempfile
        >>> arm = phipsi.load(phipsi.BUNDLED_ARM)
        >>> found = phipsi.compare(arm, arm.with_payload("flange", 0.5, (0, 0, 0.1)))
        >>> found.report(tempfile.mkdtemp() + "/payload.html", names=("arm", "arm with payload")).name
        'payload.html'
        """
        need_pages()
        from .report.comparison import write_page

        return write_page(Path(fspath(file)), names, self)

    def __str__(self) -> str:
        if self.same:
            return "no difference"
        lines = []
        largest = [max((one for one in self.dynamics if one.quantity == quantity), key=lambda one: one.relative) for quantity in dict.fromkeys(one.quantity for one in self.dynamics)]
        for title, found in (("properties", self.properties), ("poses at random configurations", self.poses), ("dynamics at random states, the largest of each quantity", largest)):
            lines += [f"{title}: {len(found)} difference{'s' * (len(found) != 1)}", *(f"  {one}" for one in found[:MOST])]
            lines += [f"  and {len(found) - MOST} more"] if len(found) > MOST else []
        lines += [f"locked for poses and dynamics: {', '.join(self.locked)}"] if self.locked else []
        return "\n".join([*lines, self.note] if self.note else lines)


def compare(first: Scene, second: Scene, *, states: int = 16, seed: int = 0, tolerance: float = 1e-9) -> Comparison:
    """Compare two robots: joints, masses, frames, limits, and poses and dynamics at random states.

    Parameters
    ----------
    first, second : Scene
        The robots. Joints and links are the same if their names are; the order of q may differ.
    states : int
        Number of random states, at most 10,000, within the limits of the first robot.
    seed : int
        Seed of the random states.
    tolerance : float
        Largest relative difference of equal numbers.

    Returns
    -------
    Comparison
        The differences. `print` lists them.

    Raises
    ------
    ArgumentError
        A number of states or a tolerance that is not positive.

    Notes
    -----
    Joints that only one robot has are locked at their neutral positions, so that the rest can be compared. Poses are
    those of links relative to the base. Two robots whose link frames differ can have the same dynamics.

    Examples
    --------
    >>> import phipsi
    >>> arm = phipsi.load(phipsi.BUNDLED_ARM)
    >>> phipsi.compare(arm, arm).same
    True
    >>> print(phipsi.compare(arm, arm.with_payload("flange", 0.5, (0, 0, 0.1))).first)
    link "flange": mass, kg: 0.03 and 0.53 (relative difference 0.94)
    """
    for name, scene in (("first", first), ("second", second)):
        if not isinstance(scene, Scene):
            raise ArgumentError(f"{name}: found {type(scene).__name__}; expected a scene, for a file phipsi.load(file)")
    states = whole("states", states, 1, "a positive integer", most=10_000)
    if not 0.0 < tolerance < 1.0:
        raise ArgumentError(f"tolerance: found {tolerance!r}; expected a number between 0 and 1")
    properties = tuple(_properties(first, second, tolerance))
    common = [name for name in first.joint_names if name in second.joint_names and first.joint(name).type == second.joint(name).type]
    locked = tuple(dict.fromkeys(name for scene in (first, second) for name in scene.joint_names if name not in common))
    try:
        one, two = (_reduced(scene, common) for scene in (first, second))
        poses, dynamics = _at_states(one, two, common, states, seed, tolerance)
    except PhipsiError as error:
        return Comparison(properties, (), (), locked, f"poses and dynamics were not compared: {error}", (first, second))
    return Comparison(properties, tuple(poses), tuple(dynamics), locked, "", (first, second))


def _properties(first: Scene, second: Scene, tolerance: float) -> Iterator[Difference]:
    """Differences of names, joints and links, from the base outward."""
    for what, names in (("joints", "joint_names"), ("links", "link_names"), ("connections", "loops.names"), ("contacts", "contacts.names"), ("colliders", "collider_names")):
        one, two = attrgetter(names)(first), attrgetter(names)(second)
        if set(one) != set(two):
            yield Difference("scene", f"{what} of one robot only", tuple(sorted(set(one) - set(two))), tuple(sorted(set(two) - set(one))), np.nan)
        elif what == "joints" and one != two:
            yield Difference("scene", "order of the joints in q", one, two, np.nan)
    yield from _of("scene", "gravity, m/s^2", first.gravity, second.gravity, tolerance)
    joints, others = first.joints, second.joints
    for link in first.link_names:
        if link not in second.link_names:
            continue
        one_link, two_link = first.link(link), second.link(link)
        joint = one_link.joint
        if joint is not None and joint in joints and joint in others:
            for field, unit in OF_JOINTS.items():
                yield from _of(f'joint "{joint}"', _with(field, unit), getattr(joints[joint], field), getattr(others[joint], field), tolerance)
        for field, unit in OF_LINKS.items():
            yield from _of(f'link "{link}"', _with(field, unit), getattr(one_link, field), getattr(two_link, field), tolerance)


def _with(field: str, unit: str) -> str:
    return f"{field}, {unit}" if unit else field


def _of(where: str, quantity: str, one: Any, two: Any, tolerance: float) -> Iterator[Difference]:
    """The difference of two values, if there is one."""
    if one is None or two is None or isinstance(one, str) or isinstance(two, str) or (isinstance(one, tuple) and isinstance(one[0], str)):
        if type(one) is not type(two) or one != two:
            yield Difference(where, quantity, one, two, np.nan)
        return
    a, b = np.asarray(one, float), np.asarray(two, float)
    if a.shape != b.shape:
        yield Difference(where, quantity, one, two, np.nan)
        return
    off = np.zeros(a.shape)
    differs = a != b  # infinite limits can be equal
    off[differs] = np.abs(a[differs] - b[differs])
    size = max(float(np.abs(np.where(np.isfinite(a), a, 0.0)).max(initial=0.0)), float(np.abs(np.where(np.isfinite(b), b, 0.0)).max(initial=0.0)))
    relative = float(off.max(initial=0.0)) / size if size > 0.0 else float(off.max(initial=0.0))
    if not relative <= tolerance:
        yield Difference(where, quantity, one, two, relative)


def _reduced(scene: Scene, common: list[str]) -> Scene:
    """The robot with all other joints locked at neutral."""
    rest = [name for name in scene.joint_names if name not in common]
    return scene.lock(rest, scene.neutral()) if rest else scene


def _at_states(first: Scene, second: Scene, common: list[str], states: int, seed: int, tolerance: float) -> tuple[list[Difference], list[Difference]]:
    """Differences of poses and of the dynamics at random states."""
    random = np.random.default_rng(seed)
    q, qd = first.random_configuration(random, size=states), random.uniform(-1.0, 1.0, (states, first.nv))
    if first.loops.names:
        nearest = first.loops.project(q, qd)
        q, qd = nearest.q, np.asarray(nearest.qd)
    other = np.tile(second.neutral(), (states, 1))
    order = np.arange(first.nv)  # index in qd of the second robot, by that of the first
    for name in common:
        other[:, second.q_index(name)] = q[:, first.q_index(name)]
        order[first.v_index(name)] = np.arange(second.nv)[second.v_index(name)]
    tau = random.uniform(-1.0, 1.0, (states, first.nv))

    def moved(values: _Array) -> _Array:
        """Velocities or torques of the second robot."""
        found = np.empty_like(values)
        found[:, order] = values
        return found

    poses = []
    size = max(float(np.abs(first.poses(q)[..., :3, 3]).max(initial=0.0)), 1e-12)
    for link in first.link_names:
        if link not in second.link_names:
            continue
        one, two = first.placement(q, link), second.placement(other, link)
        distance = np.linalg.norm(one[..., :3, 3] - two[..., :3, 3], axis=-1)
        turn = one[..., :3, :3].swapaxes(-1, -2) @ two[..., :3, :3]
        # The sine is accurate for small angles, the cosine for large ones.
        sine = 0.5 * np.linalg.norm(np.stack([turn[..., 2, 1] - turn[..., 1, 2], turn[..., 0, 2] - turn[..., 2, 0], turn[..., 1, 0] - turn[..., 0, 1]], axis=-1), axis=-1)
        angle = np.arctan2(sine, 0.5 * (np.trace(turn, axis1=-2, axis2=-1) - 1.0))
        if not (distance.max() <= tolerance * size and angle.max() <= tolerance):
            at = int(np.argmax(np.maximum(distance / size, angle)))
            far = f"pose, {distance.max():.3g} m and {angle.max():.3g} rad apart; position, m"
            poses.append(Difference(f'link "{link}"', far, one[at, :3, 3], two[at, :3, 3], float(max(distance.max() / size, angle.max()))))
    calls: dict[str, Callable[[Scene, _Array, _Array, _Array], _Array]] = {
        "mass matrix, kg m^2 or kg": lambda scene, q, qd, tau: scene.mass_matrix(q),
        "gravity torque, N m or N": lambda scene, q, qd, tau: scene.gravity_torque(q),
        "bias torque, N m or N": lambda scene, q, qd, tau: scene.bias_torque(q, qd),
        "acceleration, rad/s^2 or m/s^2": lambda scene, q, qd, tau: scene.forward_dynamics(q, qd, tau),
    }
    dynamics = []
    # The joint of each degree of freedom.
    owners = [name for name in first.joint_names for _ in range(*first.v_index(name).indices(first.nv))]
    for quantity, call in calls.items():
        one, two = call(first, q, qd, tau), call(second, other, moved(qd), moved(tau))
        two = two[:, order][..., order] if two.ndim == 3 else two[:, order]
        scale = float(max(np.abs(one).max(initial=0.0), np.abs(two).max(initial=0.0))) or 1.0
        for name in common:
            rows = first.v_index(name)
            off = np.abs(one[:, rows] - two[:, rows]).reshape(states, -1)
            if not off.max() <= tolerance * scale:
                largest = int(np.argmax(off))
                a, b = (values[:, rows].reshape(-1)[largest] for values in (one, two))
                other_joint = owners[largest % first.nv] if one.ndim == 3 else name
                where = f'joint "{name}"' if other_joint == name else f'joints "{name}" and "{other_joint}"'
                dynamics.append(Difference(where, quantity, float(a), float(b), float(off.max() / max(abs(a), abs(b)))))
    return poses, dynamics


def text_of(value: Any) -> str:
    """A value in a line."""
    if value is None or isinstance(value, str):
        return str(value)
    if isinstance(value, tuple) and (not value or isinstance(value[0], str)):
        return ", ".join(map(str, value)) or "none"
    return " ".join(np.array2string(np.asarray(value, float), formatter={"float_kind": lambda number: f"{number:.5g}"}).split())
