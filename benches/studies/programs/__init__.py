"""Other programs on the extreme scenes, where they are installed: Pinocchio in both its conventions, MuJoCo, Drake, dynibo.

Their models are built from the same numbers as the scene's: frames of the extreme scenes are parallel at zero configuration, so
that nothing is rounded on the way but the lengths of axes, and the rates and accelerations of a floating base where a peer has
them along the axes of the world. What a peer does not take is refused with its own message.
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


#: Colours in plots, by program.
INKS = {"Pinocchio": "#222222", "MuJoCo": "#b8860b", "Drake": "#56b4e9", "dynibo": "#e377c2"}


class Peer(NamedTuple):
    """A program, and how it is asked."""

    name: str
    version: str
    solver: Callable[[Scene], Solver]
    colour: str = "#555555"
    """In plots."""
    gravity: tuple[float, float, float] | None = None
    """Its gravity, m/s^2, where that cannot be set: it is then given the scene, and compared with the reference, under this one."""


class _Program(NamedTuple):
    """How a program is called, imported and installed, and the peers that it makes."""

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
    """The peers that can be imported; and a line on each program that cannot."""
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
    """The package's; a build of one's own may be of none."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "of unknown version"
