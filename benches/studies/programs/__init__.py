"""Other programs on the extreme scenes, if they are installed: Pinocchio in both conventions, MuJoCo, Drake, dynibo.

Their models are built from the same values as the scene. The frames of the extreme scenes are parallel at the zero
configuration, so that only the lengths of axes are rounded, and the velocities and accelerations of a floating base
if a peer expresses them in the world frame. If a peer refuses a scene, its message is reported.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from phipsi import Scene
from . import drake, dynibo, mujoco, pinocchio
from .model import Refused, Solver, under_gravity

__all__ = ["INKS", "PROGRAMS", "Peer", "Refused", "Solver", "installed", "under_gravity", "version"]


#: Colors in plots, by program.
INKS = {"Pinocchio": "#222222", "MuJoCo": "#b8860b", "Drake": "#56b4e9", "dynibo": "#e377c2"}


class Peer(NamedTuple):
    """A program, and its forward dynamics."""

    name: str
    version: str
    solver: Callable[[Scene], Solver]
    color: str = "#555555"
    """Color in plots."""
    gravity: tuple[float, float, float] | None = None
    """Gravity of the program, m/s^2, if it cannot be set: the scene and the reference then use it."""


class _Program(NamedTuple):
    """Name, import and installation of a program, and its peers."""

    title: str
    module: str
    package: str
    peers: Callable[[Any, str], list[Peer]]


def _pinocchio(pin: Any, version: str) -> list[Peer]:
    return [
        Peer(f"Pinocchio, {name}", version, partial(pinocchio.solver, pin, convention), ink)
        for name, convention, ink in (("local", pin.Convention.LOCAL, INKS["Pinocchio"]), ("world", pin.Convention.WORLD, "#7f7f7f"))
    ]


PROGRAMS = (
    _Program("Pinocchio", "pinocchio", "pin", _pinocchio),
    _Program("MuJoCo", "mujoco", "mujoco", lambda module, version: [
        Peer("MuJoCo", version, partial(mujoco.solver, module), INKS["MuJoCo"]),
    ]),
    _Program("Drake", "pydrake.all", "drake", lambda module, version: [
        Peer("Drake", version, partial(drake.solver, module), INKS["Drake"]),
    ]),
    _Program("dynibo", "dynibo", "dynibo", lambda module, version: [
        Peer("dynibo", version, partial(dynibo.solver, module), INKS["dynibo"], dynibo.GRAVITY),
    ]),
)  # fmt: skip


def installed() -> tuple[list[Peer], Sequence[str]]:
    """Peers that can be imported; and a line on each program that cannot."""
    found: list[Peer] = []
    absent = []
    for program in PROGRAMS:
        try:
            module = importlib.import_module(program.module)
        except ImportError:
            absent.append(f"{program.title} is not installed (pip install {program.package}).")
        else:
            found += program.peers(module, f"{program.title} {version(program.package)}")
    return found, absent


def version(package: str) -> str:
    """Version of the package; a local build may have none."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "of unknown version"
