"""Stability maps: each method on a chain of three with stiff gains, extreme mass ratios and strong friction, at steps
from 1e-6 to 0.1 s.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

import phipsi
from . import common
from .common import Array, Finding, Options, Section
from .peer import INTEGRATORS, Peer

METHODS = ("rk4", "semi-implicit-euler", "implicit-euler", "rosenbrock-2", "rosenbrock-3")
STEPS = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
#: Largest number of steps of a run, and its longest duration, s.
MOST_STEPS, LONGEST = 3000, 1.0
#: A cell is accurate if the error at the end is below this, rad.
ACCURATE = 1e-3
#: A reference is known if two solutions differ by less than this, rad.
KNOWN = ACCURATE / 10
LENGTH, LINK_MASS = 0.3, 1.0
#: Speed of the regularized friction in the two references, rad/s.
SLOW = (1e-6, 1e-5)
LEGEND = "`a` accurate, `d` damped or inaccurate, but stable, `F` failed, `?` stable without a known reference, `-` the method does not take this"


@dataclass
class Problem:
    """One column of a map: a chain, its initial state, and arguments of the runs."""

    scene: phipsi.Scene
    q: Array
    qd: Array
    law: phipsi.PD | None = None
    friction: float = 0.0
    reference: dict[float, Array] = field(default_factory=dict)
    """Configuration by time, s, where it is known."""

    def arguments(self) -> dict[str, Any]:
        found: dict[str, Any] = {"pd": self.law} if self.law else {}
        return found | ({"friction": self.friction} if self.friction else {})

    def solve(self) -> None:
        """Compute the reference: SciPy's Radau twice, with different tolerances or different speeds of regularized
        friction.
        """
        times = sorted({duration(dt) for dt in STEPS})
        solutions = []
        for tolerance, speed in ((1e-9, SLOW[0]), (1e-7, SLOW[1])):
            more = self.arguments() | ({"friction_speed": speed} if self.friction else {})
            try:
                solved = self.scene.ode(**more).solve(self.q, self.qd, (0, times[-1]), method="Radau", rtol=tolerance, atol=tolerance, t_eval=times)
            except phipsi.errors.SimulationError as error:
                common.progress(f"no reference: {error}")
                return
            solutions.append(solved.q)
        apart = common.distance(self.scene, *solutions)
        self.reference = {time: q for time, q, off in zip(times, solutions[0], apart, strict=True) if off <= KNOWN}

    def judged(self, dt: float, q: Array, qd: Array) -> str:
        """Letter of a completed run, from its rows."""
        energy = self.scene.energy(q, qd)
        potential = np.asarray(energy.potential)
        if self.law:
            potential = potential + 0.5 * np.sum(np.asarray(self.law.kp) * self.scene.difference(np.asarray(self.law.target), q) ** 2, axis=-1)
        rise, scale = common.energy_rise(np.asarray(energy.kinetic), potential)
        if not rise <= common.RISE * scale:
            return "F"
        reference = self.reference.get(duration(dt))
        if reference is None:
            return "?"
        return "a" if common.distance(self.scene, reference, q[-1]) <= ACCURATE else "d"

    def ours(self, method: str, dt: float) -> str:
        try:
            found = common.run(self.scene, self.q, self.qd, method, dt=dt, duration=duration(dt), rows=100, **self.arguments()).trajectory
        except phipsi.errors.ArgumentError:
            return "-"
        return "F" if found is None else self.judged(dt, found.q, found.qd)

    def peer(self) -> Peer | None:
        """MuJoCo's model, with the law as springs and dampers; None if MuJoCo refuses the masses."""
        try:
            peer = Peer(self.scene.to_urdf(), self.scene)
        except ValueError:
            return None
        if peer.repaired:
            return None
        model = peer.model
        model.dof_frictionloss[:] = self.friction
        if self.law:
            model.jnt_stiffness[peer.v_there], model.dof_damping[peer.v_there] = np.asarray(self.law.kp)[peer.v_here], np.asarray(self.law.kd)[peer.v_here]
            model.qpos_spring[peer.q_there] = np.asarray(self.law.target)[peer.q_here]
        return peer

    def theirs(self, peer: Peer | None, integrator: str, dt: float) -> str:
        if peer is None:
            return "-"
        peer.integrate_with(integrator, dt)
        peer.start(self.q, self.qd)
        steps = round(duration(dt) / dt)
        found = peer.rows(steps, max(1, steps // 100))
        return "F" if found is None else self.judged(dt, *found)


def duration(dt: float) -> float:
    """Duration of the runs with a step size, s."""
    return float(f"{min(LONGEST, MOST_STEPS * dt):g}")


def chain(tip: float = LINK_MASS) -> phipsi.Scene:
    """Three rods that rotate about y, x and y; the last one has mass `tip`."""
    builder = phipsi.SceneBuilder().link("base")
    for k, mass in enumerate((LINK_MASS, LINK_MASS, tip)):
        inertia = mass * LENGTH**2 / 12 * np.diag([1.0, 1.0, 0.05])
        builder.link(f"rod{k}", mass, com=(0, 0, -LENGTH / 2), inertia=inertia)
        axis, parent = (k % 2, 1 - k % 2, 0), f"rod{k - 1}" if k else "base"
        builder.joint(f"joint{k}", "continuous", parent, f"rod{k}", axis=axis, xyz=(0, 0, -LENGTH if k else 0))
    return builder.build()


def gains(value: float) -> Problem:
    """Gains at the first and the last joint, with critical damping; the joint between them is passive."""
    scene, q = chain(), np.array([0.3, 0.8, -0.4])
    where = np.array([1.0, 0.0, 1.0])
    mass = np.diag(scene.mass_matrix(q))
    return Problem(scene, q, np.zeros(3), law=phipsi.PD(value * where, 2 * np.sqrt(value * mass) * where, q))


def mass_ratio(value: float) -> Problem:
    return Problem(chain(value * LINK_MASS), np.array([0.3, 0.8, -0.4]), np.zeros(3))


def friction(value: float) -> Problem:
    return Problem(chain(), np.array([0.3, 0.8, -0.4]), np.array([1.0, -1.0, 1.0]), friction=value)


FAMILIES = {
    "gains, N m/rad": (gains, [10.0**k for k in range(2, 11)]),
    "mass of the last link over the others'": (mass_ratio, [10.0**k for k in range(0, 13, 2)]),
    "dry friction, N m": (friction, [10.0**k for k in range(0, 7)]),
}


def maps(options: Options) -> Section:
    """One table per family: a letter per step for each method and value."""
    texts, counts = [], dict.fromkeys("adF?-", 0)
    programs = list(dict.fromkeys((options.method, *METHODS)))
    for family, (make, values) in FAMILIES.items():
        chosen = values[::3] if options.quick else values
        columns = []
        for value in chosen:
            common.progress(f"stability map: {family} {value:g}")
            problem = make(value)
            problem.solve()
            peer = problem.peer()
            column = {f"phipsi `{method}`": "".join(problem.ours(method, dt) for dt in STEPS) for method in programs}
            column |= {f"MuJoCo {integrator}": "".join(problem.theirs(peer, integrator, dt) for dt in STEPS) for integrator in INTEGRATORS}
            columns.append(column)
            for letter in column[f"phipsi `{options.method}`"]:
                counts[letter] += 1
        rows = [[program, *(f"`{column[program]}`" for column in columns)] for program in columns[0]]
        texts.append(common.table([family, *(f"{value:.0e}".replace("e+0", "e").replace("e+", "e") for value in chosen)], rows))
    total = sum(counts.values())
    text = (
        f"A chain of three rods of {LENGTH:g} m and {LINK_MASS:g} kg under gravity. A cell has one letter for each step of {', '.join(f'{dt:g}' for dt in STEPS)} s: {LEGEND}. "
        f"Accurate: the error at the end is at most {ACCURATE:g} rad. Failed: an error, divergence, or a gain of energy of more than {100 * common.RISE:g} %. "
        f"Runs last {LONGEST:g} s, or {MOST_STEPS} steps if these are shorter. References are two solutions of SciPy's Radau that agree to {KNOWN:g} rad. "
        "Gains hold the first and the last joint at the start, with critical damping; MuJoCo has them as joint springs and dampers. With friction all joints start at 1 rad/s; without a method for exact friction, the default `friction_speed` applies.\n\n"
        + "\n\n".join(texts)
    )
    finding = Finding(
        f"stability map: cells of `{options.method}` that fail", f"{counts['F']} of {total} ({counts['a']} accurate, {counts['d']} damped)", "0", counts["F"] == 0
    )
    return Section("Stability map", text, [finding])
