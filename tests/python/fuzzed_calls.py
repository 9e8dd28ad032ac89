"""Calls on small scenes, one after the other, for test_no_panics.py.

``python fuzzed_calls.py random DEADLINE FIRST COUNT`` runs random calls on random scenes, of which FIRST is the first
seed, and ``python fuzzed_calls.py pairs DEADLINE`` a simulation for every combination of what made calls panic. Each
case prints its name before it runs, then its outcome. A case that takes longer than the deadline (in s) ends the process
with the tracebacks of all threads. An exception that is not a PhipsiError, or an InternalError, is a FAULT.
"""

from __future__ import annotations

import faulthandler
import itertools
import sys
import traceback
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

import phipsi
from phipsi.errors import ArgumentError, InternalError, PhipsiError

def pick(random: np.random.Generator, *values: Any) -> Any:
    """One of the values."""
    return values[random.integers(len(values))]


KINDS = ("tree", "mimic", "loop", "contact", "loop with contact", "mimic with contact", "all")
CONNECTIONS = ("point", "axis", "weld", "distance", "rod", "couple")
METHODS = ("auto", "semi-implicit-euler", "rk4", "dormand-prince-5", "implicit-euler", "rosenbrock-2", "rosenbrock-3", "contact")
SIZES = (1.0, 1.0, 1.0, 1.0, 1e3, 1e8, 1e100, 1e155, 1e300)
"""Factors of states, torques and settings."""


def bar(builder: phipsi.SceneBuilder, name: str, parent: str, at: Any, length: float, kind: str = "continuous", **joint: Any) -> None:
    """A bar along z on a joint about y at its lower end."""
    builder.link(name, mass=1.0, com=(0, 0, length / 2), inertia=np.diag([length**2 / 12] * 2 + [1e-3]))
    builder.joint(name, kind, parent, name, xyz=at, **{"axis": (0, 1, 0), **joint})


def fourbar(builder: phipsi.SceneBuilder, random: np.random.Generator) -> tuple[str, str, float, float]:
    """Crank, coupler and rocker, sometimes in line, with rounded angles, or without a coupler; the ends of the loop."""
    tilt = pick(random, 0.0, 0.0, 3.7e-6, 8e-4, 3e-3)
    if random.uniform() < 0.2:
        bar(builder, "crank", "ground", (0, 0, 0), 0.2, rpy=(tilt, 0, 0))
        return "crank", "ground", 0.2, 0.0
    ground = pick(random, 0.3, 0.45, 0.9, 0.2 + 0.4 - 0.3)
    kind = pick(random, *["continuous"] * 6, "prismatic", "spherical")
    bar(builder, "crank", "ground", (0, 0, 0), 0.2)
    bar(builder, "coupler", "crank", (0, 0, 0.2), 0.4, rpy=(tilt, 0, 0))
    bar(builder, "rocker", "ground", (ground, 0, 0), 0.3, kind)
    return "coupler", "rocker", 0.4, 0.3


def scene_of(kind: str, random: np.random.Generator) -> phipsi.Scene:
    """A small scene of a kind."""
    builder = phipsi.SceneBuilder().link("ground")
    name, other, here, there = "ground", "ground", 0.0, 0.0
    is_flying = random.uniform() < 0.15
    if is_flying:
        builder.link("frame", mass=1.0, inertia=0.1 * np.eye(3)).joint("frame", "floating", "ground", "frame")
    if "loop" in kind or kind == "all":
        name, other, here, there = fourbar(builder, random)
        for count in range(pick(random, 1, 1, 2, 3)):
            of = pick(random, *CONNECTIONS)
            if of == "couple":
                builder.couple(f"c{count}", name, None if other == "ground" else other, multiplier=random.normal(), offset=pick(random, 0.0, 0.1))
                continue
            given: dict[str, Any] = {"axis": (0, 1, 0)} if of == "axis" else {}
            if of in ("distance", "rod"):
                given["length"] = pick(random, 0.1, 0.3, 0.002)
            if random.uniform() < 0.7:
                given["other_xyz"] = (pick(random, 0.0, 0.002, 0.3), 0, there)
            builder.connect(f"c{count}", of, name, None if other == "ground" else other, xyz=(0, 0, here), **given)
    else:
        parent = "frame" if is_flying else "ground"
        for k in range(random.integers(1, 5)):
            joint = pick(random, "revolute", "revolute", "continuous", "continuous", "prismatic", "screw", "planar", "spherical")
            limits = {"lower": -0.3, "upper": 0.3} if joint in ("revolute", "prismatic") and random.uniform() < 0.5 else {}
            dry = {"friction": pick(random, 0.0, 0.5, 1e6), "damping": pick(random, 0.0, 0.1, 1e6)} if random.uniform() < 0.4 else {}
            bar(builder, f"bar{k}", parent, (0, 0, 0.3), 0.3, joint, pitch=0.2 if joint == "screw" else None, **limits, **dry)
            name = parent = f"bar{k}"
    if "mimic" in kind or kind == "all":
        for follower, multiplier in (("first", 1.0), ("second", pick(random, -1.0, 0.5, 1e3))):
            mimic = {} if follower == "first" else {"mimic": "first", "mimic_multiplier": multiplier, "mimic_offset": 0.1}
            bar(builder, follower, "first" if mimic else "ground", (0.5, 0, 0.2), 0.2, **mimic)
    if "contact" in kind or kind == "all":
        ends = [name if name != "ground" else "crank"] + (["second"] if "mimic" in kind or kind == "all" else [])
        for count, link in enumerate(ends * random.integers(1, 3)):
            builder.contact(
                f"floor{count}", link, xyz=(0, 0.1 * count, pick(random, 0.0, 0.3)), radius=pick(random, 0.0, 0.05), friction=pick(random, 0.0, 0.5, 3.0),
                normal=(0, pick(random, 0.0, 0.1), 1), offset=pick(random, -1.0, -0.05, 0.0, 0.2), restitution=pick(random, 0.0, 0.5, 1.0),
            )  # fmt: skip
    return builder.build(tolerance=pick(random, None, None, 5e-3, 0.1), strict=bool(random.uniform() < 0.1) or None, gravity=pick(random, None, (0.0, 0.0, 0.0)))


def settings(scene: phipsi.Scene, random: np.random.Generator) -> dict[str, Any]:
    """Arguments of simulate: a valid choice most of the time."""

    def some(share: float, values: tuple[Any, ...]) -> Any:
        return pick(random, *values) if random.uniform() < share else None

    size = pick(random, *SIZES)
    given = {
        "method": some(0.7, METHODS),
        "compliance": some(0.2, (0.0, 1e-6, 1.0, size)) if scene.loops.names else None,
        "limits": some(0.4, ("stop", "report")),
        "restitution": some(0.3, (0.0, 0.5, 1.0)),
        "friction_speed": some(0.2, (1e-6, 1e-2, size)),
        "accuracy": some(0.2, (1e-3, 1e-8)),
        "smoothing": some(0.1, (1e-3, 0.1)),
        "tau": some(0.4, (np.full(scene.nv, 3.0), np.full(scene.nv, size), lambda t, q, qd: -size * q[: scene.nv] if len(q) == scene.nv else -size * qd)),
        "damping": some(0.1, (1.0, 1e6, size)),
        "stiffness": some(0.1, (1.0, 1e6, size)),
        "friction": some(0.1, (0.1, 1e6, size)),
        "pd": some(0.1, (phipsi.PD(100.0, 1.0, scene.neutral()[0] if scene.nq else 0.0), phipsi.PD(size, size, 1.0))),
        "record_every": some(0.3, (2, 7)),
        "form": some(0.1, ("covariance",)),
    }
    # With error control, a long time takes as many steps as the motion needs.
    dt = pick(random, 1e-4, 1e-3, 0.02, *((0.3, 1e3) if given["accuracy"] is None else ()))
    return {"dt": dt, "steps": pick(random, 1, 5, 20), **{name: value for name, value in given.items() if value is not None}}


def accepted(call: Callable[..., Any], given: dict[str, Any]) -> Any:
    """The result of a call without the arguments that the scene does not accept."""
    while True:
        try:
            return call(**given)
        except ArgumentError as error:
            if error.argument not in given:
                raise
            given = {name: value for name, value in given.items() if name != error.argument}


def calls(scene: phipsi.Scene, random: np.random.Generator) -> list[tuple[str, Callable[[], Any]]]:
    """Calls with a state that meets the connections, or is as it was drawn."""
    nv = scene.nv
    away, speed, torque = (pick(random, *SIZES) for _ in range(3))
    q, qd, tau = scene.neutral(), speed * random.normal(size=nv), torque * random.normal(size=nv)
    if random.uniform() < 0.8:
        q = scene.integrate(q, pick(random, 0.0, 0.002, 0.5) * random.normal(size=nv))
    if away > 1.0:
        q = np.where(np.abs(q) < 0.9, q * away, q)
    if scene.loops.names and random.uniform() < 0.8:
        try:
            q, qd, _ = scene.loops.project(q, qd)
        except PhipsiError:
            q = scene.neutral()
    given = settings(scene, random)
    if max(speed, torque) > 1e3:
        given.pop("accuracy", None)  # takes as many substeps as it may until it gives up
    link = scene.link_names[-1]
    step, form = pick(random, 1e-3, 0.02), pick(random, "auto", "covariance", "square-root")

    def simulated() -> None:
        path = accepted(partial(scene.simulate, q, qd), given)
        assert np.isfinite(path.q).all() and np.isfinite(path.qd).all(), "a result that is not finite"

    def stepped() -> None:
        simulator = accepted(partial(scene.simulator, q, qd, dt=step), {name: given[name] for name in given if name in ("method", "limits", "damping", "friction")})
        for _ in range(5):
            simulator.step(tau)
        assert np.isfinite(simulator.q).all() and np.isfinite(simulator.qd).all(), "a result that is not finite"

    def differentiated() -> None:
        path = accepted(partial(scene.simulate, q, qd, dt=step, steps=5, tau=tau), {name: given[name] for name in given if name in ("method", "limits", "smoothing")})
        path.vjp(random.normal(size=path.qd.shape), random.normal(size=path.qd.shape))

    return [
        ("simulate", simulated),
        ("simulator", stepped),
        ("gradients", differentiated),
        ("forward_dynamics", lambda: scene.forward_dynamics(q, qd, tau, form=form)),
        ("derivatives", lambda: scene.forward_dynamics_derivatives(q, qd, tau)),
        ("vjp", lambda: scene.forward_dynamics_vjp(q, qd, tau, qd)),
        ("loops.project", lambda: scene.loops.project(q * away if away < 1e200 else q, qd)),
        ("loops.dynamics", lambda: scene.loops.dynamics(q, qd, tau)),
        ("loops.inverse_dynamics", lambda: scene.loops.inverse_dynamics(q, qd, tau, actuated=scene.joint_names[:1])),
        ("loops.mass_matrix_inverse", lambda: scene.loops.mass_matrix_inverse(q)),
        ("loops.bias", lambda: scene.loops.bias(q, qd)),
        ("operational_inertia", lambda: scene.operational_inertia(q, link)),
        ("inverse_kinematics", lambda: scene.inverse_kinematics(phipsi.tasks.Position(link, away * random.normal(size=3)), q, covariance=True)),
        ("linearize", lambda: scene.linearize(q, qd, tau)),
    ]


def random_call(seed: int) -> None:
    """One call on one scene."""
    random = np.random.default_rng(seed)
    kind = pick(random, *KINDS)
    print(kind, end=", ", flush=True)
    all_calls = calls(scene_of(kind, random), random)
    name, call = all_calls[0 if random.uniform() < 0.5 else random.integers(len(all_calls))]
    print(name, end=" ", flush=True)
    call()


class Pair(NamedTuple):
    """A four-bar linkage, or a crank alone, with connections, a floor and numbers that overflow."""

    connection: str
    copies: int
    """Number of times the connection is made: with several, rows outnumber degrees of freedom."""
    is_dead: bool
    """Bars in line, with the tolerance of a file with two digits."""
    has_floor: bool
    overflow: str


PAIRS = list(itertools.starmap(Pair, itertools.product(CONNECTIONS, (1, 3), (False, True), (False, True), ("", "q", "qd", "tau", "stage"))))


def simulated_pair(pair: Pair) -> None:
    """A simulation, and a call of the dynamics."""
    builder = phipsi.SceneBuilder().link("ground")
    tilt, away = (7.963e-4, 0.002) if pair.is_dead else (0.0, 0.0)
    bar(builder, "crank", "ground", (0, 0, 0), 0.2)
    bar(builder, "coupler", "crank", (0, 0, 0.2), 0.4, rpy=(tilt, 0, 0))
    bar(builder, "rocker", "ground", (away, 0, 0) if pair.is_dead else (0.3, 0, 0), 0.6 if pair.is_dead else 0.3)
    for copy in range(pair.copies):
        if pair.connection == "couple":
            builder.couple(f"c{copy}", "rocker", "crank")
        else:
            given: dict[str, Any] = {"axis": (0, 1, 0)} if pair.connection == "axis" else {}
            at = {"other_xyz": (0, 0, 0.6 if pair.is_dead else 0.3)} if pair.connection != "weld" else {}
            builder.connect(f"c{copy}", pair.connection, "coupler", "rocker", xyz=(0, 0, 0.4), **given, **at)
    if pair.has_floor:
        builder.contact("floor", "coupler", xyz=(0, 0, 0.2), friction=0.5, offset=-1.0)
    scene = builder.build(tolerance=5e-3 if pair.is_dead else None)
    q, qd, tau, dt = scene.neutral(), np.zeros(3), np.zeros(3), 1e-3
    if not pair.is_dead:
        q, qd, _ = scene.loops.project([0.5, 0.8, 0.2], [1.0, 0.0, 0.0])
    if pair.overflow == "q":
        q = q + 1e155
    elif pair.overflow == "qd":
        qd = np.full(3, 1e200)
    elif pair.overflow == "tau":
        tau = np.full(3, 1e300)
    elif pair.overflow == "stage":
        dt = 1e100
    scene.simulate(q, qd, tau=tau, dt=dt, steps=3)
    scene.forward_dynamics(q, qd, tau)


def outcome(call: Callable[[Any], None], of: Any) -> str:
    """The outcome of a case: ok, the name of the error, or FAULT with its words."""
    try:
        call(of)
    except BaseException as error:  # also the exception of a panic
        if isinstance(error, PhipsiError) and not isinstance(error, InternalError):
            return type(error).__name__
        where = traceback.extract_tb(error.__traceback__)[-1]
        return f"FAULT {type(error).__name__}: {' '.join(str(error).split())[:300]} ({where.filename}:{where.lineno})"
    return "ok"


def main(kind: str, deadline: str, first: str = "0", count: str = "0") -> None:
    """Runs the cases of a kind."""
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    cases = PAIRS if kind == "pairs" else range(int(first), int(first) + int(count))
    for case in cases:
        print(case, end=": ", flush=True)
        faulthandler.dump_traceback_later(float(deadline), exit=True)
        print(outcome(simulated_pair if kind == "pairs" else random_call, case), flush=True)
    faulthandler.cancel_dump_traceback_later()


if __name__ == "__main__":
    main(*sys.argv[1:])
