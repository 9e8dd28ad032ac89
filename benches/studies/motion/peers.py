"""MuJoCo and Pinocchio, compared with scene.simulate for the same scenes and steps.

MuJoCo has its own integrators (`mj_step`, constraints disabled), with springs and armature in its model. Pinocchio
has none: `aba` is used in the same integrators, written here in Python with `pin.integrate`. For a free joint, rk4
transforms velocities by the derivative of the exponential map, as in phipsi; without this its order would be lower.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..programs import PROGRAMS, version
from ..programs.model import Refused, World, read
from ..programs.mujoco import load as load_mujoco
from ..programs.mujoco import quiet
from ..programs.pinocchio import load as load_pinocchio
from .cases import Case
from .runs import ROWS, Path, Runner

Array = NDArray[np.float64]

#: Coordinates or velocities beyond this value count as divergence; MuJoCo would reset the state at 1e10.
DIVERGED = 1e9


class Peer(NamedTuple):
    """A method of another program."""

    name: str
    program: str
    stages: int
    order: int
    runner: Callable[[Case], Runner]
    timed: bool
    """Whether its loop over the steps is compiled."""


def _failed(q: Sequence[Array], qd: Sequence[Array], steps: int) -> Path:
    return Path(np.array(q), np.array(qd), f"diverged before step {steps}")


def _sound(*values: Array) -> bool:
    return all(bool(np.all(np.abs(value) <= DIVERGED)) for value in values)


def _mujoco(mujoco: Any, integrator: str, case: Case) -> Runner:
    origin = read(case.scene)
    model = load_mujoco(mujoco, origin, moving=True)
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    data = mujoco.MjData(model)

    def state() -> tuple[Array, Array]:
        q, qd = np.array(data.qpos), np.array(data.qvel)
        if origin.floating:
            q[3:7] = q[[4, 5, 6, 3]]
            if _sound(q, qd):
                qd[:3] = World.of(q, qd).rotation.T @ qd[:3]
        return q, qd

    def run(dt: float, steps: int) -> Path:
        mujoco.mj_resetData(model, data)
        model.opt.timestep = dt
        data.qpos[:], data.qvel[:] = case.q, case.qd
        if origin.floating:
            data.qpos[3:7] = case.q[[6, 3, 4, 5]]
            data.qvel[:3] = World.of(case.q, case.qd).rotation @ case.qd[:3]
        q, qd = [case.q], [case.qd]
        with quiet(mujoco):
            for row in range(1, ROWS + 1):
                mujoco.mj_step(model, data, steps // ROWS)
                at, rate = state()
                if not _sound(at, rate):
                    return _failed(q, qd, row * (steps // ROWS))
                q.append(at)
                qd.append(rate)
        return Path(np.array(q), np.array(qd))

    return run


def _pinocchio(pin: Any, integrator: str, case: Case) -> Runner:
    model = load_pinocchio(pin, case.scene)
    data = model.createData()
    springs, dampers = np.array(case.scene.stiffness), np.array(case.scene.damping)
    floating = model.nq != model.nv
    offset = model.nq - model.nv

    def acceleration(q: Array, qd: Array) -> Array:
        # Springs are at rest at zero, at joints with one axis.
        tau = -springs * q[offset:] - dampers * qd
        return np.array(pin.aba(model, data, q, qd, tau))

    def carried_back(q: Array, u: Array, qd: Array) -> Array:
        if not floating:
            return qd
        return np.asarray(np.linalg.solve(pin.dIntegrate(model, q, u, pin.ArgumentPosition.ARG1), qd))

    def euler(q: Array, qd: Array, h: float) -> tuple[Array, Array]:
        qd = qd + h * acceleration(q, qd)
        return pin.integrate(model, q, h * qd), qd

    def rk4(q: Array, qd: Array, h: float) -> tuple[Array, Array]:
        u, rates, slopes = np.zeros_like(qd), [], []
        v = qd
        for ahead in (0.5, 0.5, 1.0, 0.0):
            at = pin.integrate(model, q, u)
            rates.append(carried_back(q, u, v))
            slopes.append(acceleration(at, v))
            u, v = ahead * h * rates[-1], qd + ahead * h * slopes[-1]
        weigh = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0
        return pin.integrate(model, q, h * (weigh @ np.array(rates))), qd + h * (weigh @ np.array(slopes))

    step = {"euler": euler, "rk4": rk4}[integrator]

    def run(dt: float, steps: int) -> Path:
        at, rate = case.q, case.qd
        q, qd = [at], [rate]
        every = steps // ROWS
        with np.errstate(all="ignore"):
            for i in range(1, steps + 1):
                at, rate = step(at, rate, dt)
                if not _sound(at, rate):
                    return _failed(q, qd, i)
                if i % every == 0:
                    q.append(at)
                    qd.append(rate)
        return Path(np.array(q), np.array(qd))

    return run


#: Program, name here, stages, order on smooth motion, implementation, its name there, whether compiled.
METHODS = (
    ("MuJoCo", "MuJoCo Euler", 1, 1, _mujoco, "EULER", True),
    ("MuJoCo", "MuJoCo implicitfast", 1, 1, _mujoco, "IMPLICITFAST", True),
    ("MuJoCo", "MuJoCo RK4", 4, 4, _mujoco, "RK4", True),
    ("Pinocchio", "Pinocchio semi-implicit", 1, 1, _pinocchio, "euler", False),
    ("Pinocchio", "Pinocchio rk4", 4, 4, _pinocchio, "rk4", False),
)


def installed() -> tuple[list[Peer], list[str], list[str]]:
    """Peers that can be imported, their versions, and a line on each that cannot."""
    found: list[Peer] = []
    versions: list[str] = []
    absent: list[str] = []
    for program in PROGRAMS:
        mine = [row for row in METHODS if row[0] == program.title]
        if not mine:
            continue
        try:
            module = importlib.import_module(program.module)
        except ImportError:
            absent.append(f"{program.title} is not installed (pip install {program.package}).")
            continue
        versions.append(f"{program.title} {version(program.package)}")
        for title, name, stages, order, make, integrator, timed in mine:
            found.append(Peer(name, title, stages, order, partial(make, module, integrator), timed))
    return found, versions, absent


__all__ = ["Peer", "Refused", "installed"]
