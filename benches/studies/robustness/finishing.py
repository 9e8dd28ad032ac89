"""Completed runs: passive and actuated robots of example-robot-data, and robots with PD laws."""

from __future__ import annotations

import numpy as np

import phipsi
from robots import ROBOTS
from . import common
from .common import Array, Finding, Options, Section
from .peer import Peer

#: Constant torque at every joint, N m (N at prismatic joints).
PUSH = 0.3
STEPS = (1e-3, 2e-3)
#: Gains, N m/rad; the derivative gain is that of critical damping for the diagonal entry of the mass matrix.
GAINS = (1e2, 1e3, 1e4, 1e6)
LAWS = ("hold", "sine", "floating")
LAW_STEPS = (1e-4, 1e-3, 4e-3)
#: MuJoCo's integrators with PD laws.
PEERS = ("Euler", "implicitfast", "discrete")
#: Duration of a run with a PD law, and duration of each target, s.
LAW_TIME, HELD = 0.3, 4e-3
#: Amplitude, rad, and angular frequency, rad/s, of the sine.
AMPLITUDE, OMEGA = 0.2, 4 * np.pi


def peer_of(name: str, scene: phipsi.Scene, *, floating: bool = False, actuators: bool = False) -> Peer | None:
    """MuJoCo model of a robot; None if MuJoCo refuses it."""
    text = (ROBOTS / common.files()[name]).read_text(encoding="utf-8")
    try:
        return Peer(text, scene, floating=floating, actuators=actuators)
    except ValueError:
        return None


def real_robots(options: Options) -> Section:
    """Runs of one second with the defaults, from the neutral configuration at rest."""
    scenes = common.robots(options.quick)
    massless = [name for name, scene in scenes.items() if common.lacks_inertia(scene)]
    peers = {name: peer_of(name, scene) for name, scene in scenes.items()}
    kinds = [(push, dt) for push in (0.0, PUSH) for dt in STEPS]
    failures: dict[str, list[str]] = {}
    theirs: dict[str, list[str]] = {}
    finished, peers_finished, substeps, stopped = [], [], 0, set()
    for push, dt in kinds:
        label = f"{'pushed' if push else 'passive'}, {1e3 * dt:g} ms"
        common.progress(f"real robots: {label}")
        ours = theirs_here = 0
        for name, scene in scenes.items():
            q, qd = scene.neutral(), np.zeros(scene.nv)
            found = common.run(scene, q, qd, options.method, dt=dt, duration=1.0, tau=np.full(scene.nv, push))
            if found.trajectory is None:
                failures.setdefault(name, []).append(f"{label} ({found.failure})")
            else:
                ours += 1
                substeps = max(substeps, int(np.max(getattr(found.trajectory, "substeps", 0))))
                if getattr(found.trajectory, "stops", None):
                    stopped.add(name)
            peer = peers[name]
            if peer:
                peer.integrate_with("Euler", dt)
                peer.start(q, qd, push)
                if peer.advance(round(1.0 / dt)):
                    theirs_here += 1
                else:
                    theirs.setdefault(name, []).append(f"{label} (before {peer.data.time:.2g} s)")
        finished.append(ours)
        peers_finished.append(theirs_here)
    refused = [name for name, peer in peers.items() if peer is None]
    repaired = [name for name, peer in peers.items() if peer and peer.repaired]
    aim, runs, count = len(kinds) * (len(scenes) - len(massless)), len(kinds) * len(scenes), len(scenes) - len(refused)
    head = ["runs that finish", *(f"{'pushed' if push else 'passive'}, {1e3 * dt:g} ms" for push, dt in kinds), "all"]
    rows = [
        [f"phipsi, `{options.method}`", *(f"{k} of {len(scenes)}" for k in finished), f"{sum(finished)} of {runs}"],
        ["MuJoCo, Euler", *(f"{k} of {count}" for k in peers_finished), f"{sum(peers_finished)} of {len(kinds) * count}"],
    ]
    text = (
        f"Every URDF file of example-robot-data that loads and has a joint, fixed base, from the neutral configuration at rest, 1 s. *Pushed*: {PUSH:g} N m (N) at every joint. "
        f"A link without inertia at a joint is an error that names the joint, and counts as an error of the file: {', '.join(massless) or 'none'}. "
        f"A run also fails if a joint velocity exceeds {common.SPEED:g} rad/s. MuJoCo reads the same files without shapes and mimic joints; it refuses {len(refused)} ({', '.join(refused) or 'none'}) "
        f"and needs `balanceinertia`, `boundmass` or `boundinertia` for {len(repaired)}.\n\n{common.table(head, rows)}\n\n"
        f"Largest number of substeps of a step: {substeps or 'not reported'}. Robots that reach a joint stop: {len(stopped)}.\n\n"
        f"Failures of phipsi:{common.listed(failures)}\n\nFailures of MuJoCo:{common.listed(theirs)}"
    )
    finding = Finding("real robots, passive and pushed, 1 and 2 ms: runs that finish", f"{sum(finished)} of {runs}", f"{aim}: all but those without inertia", sum(finished) >= aim)
    return Section("Real robots", text, [finding])


def distinct(scenes: dict[str, phipsi.Scene]) -> list[str]:
    """Names without those whose mass matrix has the size and trace of an earlier one, and without those that lack inertia."""
    kept: dict[tuple[int, float], str] = {}
    for name, scene in scenes.items():
        mass = scene.mass_matrix(scene.integrate(scene.neutral(), np.full(scene.nv, 0.3)))
        if not common.lacks_inertia(scene):
            kept.setdefault((scene.nv, round(float(np.trace(mass)), 6)), name)
    return list(kept.values())


def targets(scene: phipsi.Scene, q: Array, law: str, joints: Array) -> list[tuple[float, Array, Array]]:
    """Targets of a law, each with its duration."""
    if law != "sine":
        return [(LAW_TIME, q, np.zeros(scene.nv))]
    pieces = []
    for k in range(round(LAW_TIME / HELD)):
        phase = OMEGA * k * HELD
        pieces.append((HELD, scene.integrate(q, AMPLITUDE * np.sin(phase) * joints), AMPLITUDE * OMEGA * np.cos(phase) * joints))
    return pieces


def under_law(scene: phipsi.Scene, q: Array, law: phipsi.PD, pieces: list[tuple[float, Array, Array]], method: str, dt: float) -> bool:
    """Whether all parts of a run complete."""
    qd = np.zeros(scene.nv)
    for duration, target, rate in pieces:
        found = common.run(scene, q, qd, method, dt=dt, duration=duration, rows=5, pd=law._replace(target=target, target_rate=rate))
        if found.trajectory is None:
            return False
        q, qd = found.trajectory.q[-1], found.trajectory.qd[-1]
    return True


def peer_under_law(peer: Peer, q: Array, law: phipsi.PD, pieces: list[tuple[float, Array, Array]], integrator: str, dt: float) -> bool:
    kp, kd = np.asarray(law.kp), np.asarray(law.kd)
    peer.integrate_with(integrator, dt)
    peer.set_gains(kp, kd)
    peer.start(q, np.zeros(len(kp)))
    for duration, target, rate in pieces:
        peer.set_target(kp, kd, target, rate)
        if not peer.advance(round(duration / dt)):
            return False
    return True


def pd_laws(options: Options) -> Section:
    """Failures with PD laws from soft to stiff."""
    scenes = common.robots(options.quick)
    names = distinct(scenes)
    counts: dict[str, list[int]] = {}
    failed: dict[str, list[str]] = {}
    runs = theirs = 0

    def add(row: str, column: int, finished: bool) -> None:
        counts.setdefault(row, [0] * len(LAW_STEPS))[column] += not finished

    for name in names:
        common.progress(f"PD laws: {name}")
        for law in LAWS:
            floating = law == "floating"
            scene = common.robots(options.quick, floating)[name] if floating else scenes[name]
            # Velocity of one at the joints and zero at the floating base.
            joints = np.r_[np.zeros(6), np.ones(scene.nv - 6)] if floating else np.ones(scene.nv)
            pose = common.random_poses(scenes[name], 1)[0]
            q = np.r_[scene.neutral()[:7], pose] if floating else pose
            mass = np.diag(scene.mass_matrix(q))
            peer = peer_of(name, scene, floating=floating, actuators=True)
            pieces = targets(scene, q, law, joints)
            for gain in GAINS:
                gains = phipsi.PD(gain * joints, 2 * np.sqrt(gain * mass) * joints, q)
                runs, theirs = runs + 1, theirs + bool(peer)
                for column, dt in enumerate(LAW_STEPS):
                    finished = under_law(scene, q, gains, pieces, options.method, dt)
                    add("phipsi", column, finished)
                    add(f"phipsi, {law}", column, finished)
                    if not finished:
                        failed.setdefault(name, []).append(f"{law}, {gain:g}, {1e3 * dt:g} ms")
                    for integrator in PEERS if peer else ():
                        finished = peer_under_law(peer, q, gains, pieces, integrator, dt)
                        add(f"MuJoCo {integrator}", column, finished)
                        add(f"MuJoCo {integrator}, {law}", column, finished)

    def size(row: str) -> int:
        return (runs if row.startswith("phipsi") else theirs) // (len(LAWS) if "," in row else 1)

    rows = [[row, *(f"{count} of {size(row)}" for count in values)] for row, values in sorted(counts.items(), key=lambda item: (item[0][0] != "p", item[0]))]
    text = (
        f"{len(names)} robots: files of the same kinematics and masses count once, and those without inertia are omitted. Gains of {', '.join(f'{gain:g}' for gain in GAINS)} N m/rad at every joint, "
        "damping critical for the diagonal of the mass matrix, random start in the middle half of the limits, "
        f"{LAW_TIME:g} s. *Hold*: the target is the start. *Sine*: {AMPLITUDE:g} rad at {OMEGA / 2 / np.pi:g} Hz in phase at all joints, the target renewed every {1e3 * HELD:g} ms. "
        f"*Floating*: hold with a floating base without gains. phipsi: `{options.method}`; MuJoCo: affine actuators.\n\n"
        f"{common.table(['runs that fail', *(f'{1e3 * dt:g} ms' for dt in LAW_STEPS)], rows)}\n\nFailures of phipsi:"
        + common.listed(failed)
    )
    total = counts["phipsi"]
    return Section("PD laws", text, [Finding(f"PD laws, {runs} runs at 0.1, 1 and 4 ms: failures", ", ".join(map(str, total)), "0", sum(total) == 0)])
