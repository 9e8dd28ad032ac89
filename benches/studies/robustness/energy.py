"""Energy: passive robots do not gain energy, and a free spinning body conserves it."""

from __future__ import annotations

import numpy as np

import mujoco
import phipsi
from . import common
from .common import Array, Finding, Options, Section
from .peer import INTEGRATORS

#: Step, s, duration, s, and random poses of each robot in passive runs.
STEP, DURATION, POSES = 1e-3, 1.0, 16
#: Robots shown in the table of passive runs: those with the largest rises.
SHOWN = 10
#: Spin, rad/s, duration, s, and recorded rows of the free body.
SPINS, SPIN_TIME, SPIN_ROWS = (30.0, 300.0), 60.0, 600
#: Principal moments of inertia, kg m^2, and direction of the spin.
MOMENTS, DIRECTION = np.array([0.01, 0.02, 0.03]), np.ones(3) / np.sqrt(3)
#: Position of the center of mass in the second body, m; it is at the origin in the first.
OFFSET = np.array([0.1, 0.05, 0.0])
#: Target of the relative errors of energy and momentum.
AIM = 1e-6


def passive(options: Options) -> Section:
    """Largest gain of energy in passive runs, and the remainder of the energy audit."""
    rows, gaining, failed, audited = [], 0, dict[str, list[str]](), False
    for name, scene in common.robots(options.quick).items():
        if common.lacks_inertia(scene):
            continue
        common.progress(f"passive energy: {name}")
        found = common.run(scene, common.random_poses(scene, POSES), np.zeros((POSES, scene.nv)), options.method, dt=STEP, duration=DURATION, rows=1000)
        if found.trajectory is None:
            failed[name] = [found.failure]
            continue
        energy = found.trajectory.energy()
        rise, scale = common.energy_rise(energy.kinetic, energy.potential + energy.spring)
        share = float(np.max(rise / scale))
        audit = getattr(found.trajectory, "energy_audit", None)
        remainder = None if audit is None else float(np.max(np.abs(audit().remainder) / scale))
        audited |= audit is not None
        gaining += not share <= common.RISE
        rows.append((name, share, remainder))
    rows.sort(key=lambda row: -row[1])
    shown = [[name, f"{100 * share:.2g} %", "not reported" if remainder is None else f"{100 * remainder:.2g} %"] for name, share, remainder in rows[:SHOWN]]
    remainders = [remainder for _, _, remainder in rows if remainder is not None]
    text = (
        f"Every robot with inertia at all joints, friction and damping of its file, {POSES} random poses at rest, no torque, {DURATION:g} s at {1e3 * STEP:g} ms with `{options.method}`. *Gain*: largest rise of total energy between any two "
        f"rows, as a share of the largest kinetic energy or of the range of the potential energy, whichever is larger, and at least {common.LEAST_RANGE:g} J. *Remainder*: that of the energy audit, the integrator's own error, as the same share. "
        f"The {min(SHOWN, len(rows))} largest gains of {len(rows)} robots:\n\n{common.table(['robot', 'gain', 'remainder'], shown)}\n\n"
        f"Largest remainder of all: {f'{100 * max(remainders):.2g} %' if audited else 'not reported'}. Failures:{common.listed(failed)}"
    )
    finding = Finding(
        f"passive runs that gain more than {100 * common.RISE:g} % energy, of {len(rows)} robots", f"{gaining} ({len(failed)} failed)", "0", gaining + len(failed) == 0
    )
    return Section("Energy of passive robots", text, [finding])


def body(com: Array) -> phipsi.Scene:
    """A free body without gravity."""
    builder = phipsi.SceneBuilder().link("body", 1.0, com=com, inertia=np.diag(MOMENTS))
    return builder.build(floating_base=True, gravity=(0, 0, 0))


def spun(options: Options, com: Array, spin: float) -> tuple[float, float, int]:
    """Relative errors of energy and angular momentum about the center of mass of phipsi's default, and the largest number of substeps."""
    scene = body(com)
    rate = spin * DIRECTION
    # The center of mass is at rest: the origin of the frame moves with -omega x com.
    qd = np.r_[-np.cross(rate, com), rate]
    found = common.run(scene, scene.neutral(), qd, options.method, dt=STEP, duration=SPIN_TIME, rows=SPIN_ROWS).trajectory
    if found is None:
        return np.inf, np.inf, 0
    energy, momentum = found.energy().kinetic, found.momentum()
    about_com = momentum[:, :3] - np.cross(scene.center_of_mass(found.q), momentum[:, 3:])
    off = np.linalg.norm(about_com - about_com[0], axis=-1) / np.linalg.norm(about_com[0])
    return float(np.max(np.abs(energy / energy[0] - 1))), float(np.max(off)), int(np.max(getattr(found, "substeps", 0)))


def peer_spun(integrator: str, spin: float) -> tuple[float, float]:
    """The same errors of MuJoCo, center of mass at the origin."""
    inertia = " ".join(map(str, MOMENTS))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 0" timestep="{STEP}"/><worldbody><body><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="{inertia}"/></body></worldbody></mujoco>'
    )
    model.opt.integrator = INTEGRATORS[integrator]
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    data = mujoco.MjData(model)
    data.qvel[3:] = spin * DIRECTION
    energies, momenta = [], []
    for _ in range(SPIN_ROWS + 1):
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
        energies.append(0.5 * np.sum(MOMENTS * data.qvel[3:] ** 2))
        momenta.append(rotation.reshape(3, 3) @ (MOMENTS * data.qvel[3:]))
        mujoco.mj_step(model, data, nstep=round(SPIN_TIME / STEP / SPIN_ROWS))
    energy, momentum = np.array(energies), np.array(momenta)
    off = np.linalg.norm(momentum - momentum[0], axis=-1) / np.linalg.norm(momentum[0])
    return float(np.max(np.abs(energy / energy[0] - 1))), float(np.max(off))


def spinning(options: Options) -> Section:
    """A free rigid body that spins fast about an axis that is not principal."""
    rows, findings = [], []
    for spin in SPINS:
        common.progress(f"spinning body: {spin:g} rad/s")
        errors = 0.0
        for where, com in (("at the origin", np.zeros(3)), ("offset", OFFSET)):
            energy, momentum, substeps = spun(options, com, spin)
            errors = max(errors, energy, momentum)
            rows.append([f"{spin:g} rad/s, phipsi `{options.method}`, center of mass {where}", common.relative(energy), common.relative(momentum), str(substeps or "not reported")])
        for integrator in INTEGRATORS:
            energy, momentum = peer_spun(integrator, spin)
            rows.append([f"{spin:g} rad/s, MuJoCo {integrator}", common.relative(energy), common.relative(momentum), "1"])
        findings.append(Finding(f"spinning body, {spin:g} rad/s, 1 ms, 60 s: relative error of energy and momentum", common.relative(errors), f"{AIM:g}", errors <= AIM))
    text = (
        f"A free body of 1 kg with principal moments of {', '.join(map(str, MOMENTS))} kg m^2, no gravity, spinning about the diagonal of its principal axes with its center of mass at rest, "
        f"{SPIN_TIME:g} s at {1e3 * STEP:g} ms. Offset: the center of mass is at ({', '.join(map(str, OFFSET))}) m in the frame of the free joint. Errors: largest over {SPIN_ROWS} rows, relative; the momentum is the angular one about the center of mass.\n\n"
        + common.table(["", "energy", "momentum", "substeps"], rows)
    )
    return Section("Free spinning body", text, findings)
