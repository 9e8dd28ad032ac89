"""Dry friction: wrong results without an error, and arms in static equilibrium by friction."""

from __future__ import annotations

import numpy as np

import phipsi
from robots import load
from . import common
from .common import Finding, Options, Section
from .finishing import peer_of

#: Step of the runs, s; the reference has a step smaller by the factor.
STEP, FINER = 1e-3, 32
#: Duration, s, and random poses of each robot.
DURATION, POSES = 0.3, 8
#: Reference: friction regularized at this speed, rad/s, by this method at this step, s (at 1e-4 rad/s the reference itself is
#: wrong by 1e-2 in a pose of tiago_pro: its error falls as the speed to the power 0.8); and the tolerance of SciPy's
#: Radau, which verifies it.
SPEED, REFERENCE, REFERENCE_STEP, TOLERANCE = 1e-6, "rosenbrock-3", 2e-6, 1e-7
#: A run is wrong if its error exceeds this value, rad or m; it is silent if the estimate is below a third of the
#: error.
WRONG, TOLD = 1e-2, 1 / 3
#: Robots that friction keeps at rest, by name and file.
HELD = {
    "panda": "panda_description/urdf/panda.urdf",
    "allegro_right_hand": "allegro_hand_description/urdf/allegro_right_hand.urdf",
    "talos_left_arm": "talos_data/robots/talos_left_arm.urdf",
    "talos_reduced": "talos_data/robots/talos_reduced.urdf",
}
#: Friction relative to the gravity torque, and additional friction at joints without gravity torque, relative to the
#: largest one.
FACTOR, FLOOR = 1.5, 1e-6
HELD_TIME, HELD_POSES = 10.0, 3


def silent_errors(options: Options) -> Section:
    """Error of the default with the friction of the file, compared with two references and with the error estimate."""
    rows, wrong, silent, failed, runs, worst = [], 0, 0, 0, 0, 0.0
    for name, scene in common.robots(options.quick).items():
        if not np.any(scene.friction > 0):
            continue
        common.progress(f"friction: {name}")
        q, qd = common.random_poses(scene, POSES), np.zeros((POSES, scene.nv))
        exact = common.run(scene, q, qd, REFERENCE, dt=REFERENCE_STEP, duration=DURATION, friction_speed=SPEED, **common.NO_STOPS).trajectory
        check = scene.ode(friction_speed=SPEED).solve(q[0], qd[0], (0, DURATION), method="Radau", rtol=TOLERANCE, atol=TOLERANCE, t_eval=[DURATION])
        fine = common.run(scene, q, qd, options.method, dt=STEP / FINER, duration=DURATION).trajectory
        cells, estimates, stops = [], [], 0
        for arguments, reference in ((common.NO_STOPS, exact), ({}, fine)):
            found = common.run(scene, q, qd, options.method, dt=STEP, duration=DURATION, **arguments).trajectory
            runs += POSES
            if found is None or reference is None:
                cells.append("failed" if found is None else "reference failed")
                failed += POSES
                continue
            errors, estimate = common.distance(scene, reference.q[:, -1], found.q[:, -1]), estimated(found)
            cells.append(f"{np.max(errors):.1e}")
            estimates.append(np.nan if estimate is None else float(np.max(estimate)))
            wrong += int(np.sum(~(errors <= WRONG)))
            silent += int(np.sum(~(errors <= WRONG) & ~((0.0 if estimate is None else estimate) >= TOLD * errors)))
            worst, stops = max(worst, float(np.max(errors))), len(getattr(found, "stops", None) or ())
        told = f"{np.max(estimates):.1e}" if estimates and not np.any(np.isnan(estimates)) else "not reported"
        uncertainty = "" if exact is None else f"{common.distance(scene, exact.q[0, -1], check.q[-1]):.1e}"
        rows.append([name, f"{np.max(scene.friction):g}", *cells, told, uncertainty, str(stops)])
    text = (
        f"Every robot whose file has dry friction, {POSES} random poses at rest, no torque, {DURATION:g} s at {1e3 * STEP:g} ms with `{options.method}`; differences at the end, rad or m, the largest of the poses. "
        f"*Without stops*: compared with `{REFERENCE}` at {REFERENCE_STEP:g} s, friction regularized at {SPEED:g} rad/s; *uncertainty*: difference of that from SciPy's Radau at {TOLERANCE:g}, in one pose. "
        f"*Defaults*: compared with the same method at a step {FINER} times smaller. *Estimate*: the larger `error_estimate()` of the two. *Stops*: impacts on joint limits in the runs with defaults.\n\n"
        + common.table(["robot", "largest friction, N m", "without stops", "defaults", "estimate", "uncertainty", "stops"], rows)
    )
    quantity = f"file's friction, {DURATION:g} s: runs wrong by more than {WRONG:g} without an error or an estimate"
    found_text = f"{silent} of {runs} ({wrong} wrong, {failed} failed or without a reference, largest error {worst:.1e})"
    return Section("Errors with dry friction", text, [Finding(quantity, found_text, "0", silent + failed == 0)])


def estimated(trajectory: phipsi.Trajectory) -> np.ndarray | None:
    """The error estimate at the last row, (...); None in versions without one."""
    estimate = getattr(trajectory, "error_estimate", None)
    return None if estimate is None else np.asarray(estimate())[..., -1]


def held_arms(options: Options) -> Section:
    """Drift of arms at rest whose friction exceeds the gravity torque at every joint."""
    rows, drifts = [], []
    for name, file in HELD.items():
        if options.quick and name == "talos_reduced":
            continue
        common.progress(f"held arms: {name}")
        scene, drift, theirs = load(file), 0.0, 0.0
        peer = peer_of(name, scene)
        for q in common.random_poses(scene, HELD_POSES):
            torque = np.abs(scene.gravity_torque(q))
            friction = FACTOR * torque + FLOOR * np.max(torque)
            found = common.run(scene, q, np.zeros(scene.nv), options.method, dt=STEP, duration=HELD_TIME, friction=friction).trajectory
            drift = max(drift, np.inf if found is None else float(np.max(common.distance(scene, q, found.q))))
            if peer:
                peer.integrate_with("Euler", STEP)
                peer.model.dof_frictionloss[peer.v_there] = friction[peer.v_here]
                peer.start(q, np.zeros(scene.nv))
                moved = peer.rows(round(HELD_TIME / STEP), 100)
                theirs = max(theirs, np.inf if moved is None else float(np.max(common.distance(scene, q, moved[0]))))
        rows.append([name, common.relative(drift) if drift else "0", common.relative(theirs) if peer else "refused"])
        drifts.append((name, drift))
    text = (
        f"{HELD_POSES} random poses at rest, no torque, {HELD_TIME:g} s at {1e3 * STEP:g} ms. Friction of each joint: {FACTOR:g} times its gravity torque there, plus {FLOOR:g} of the largest gravity torque, "
        f"so that the arm is in static equilibrium. Drift: largest distance from the start, rad or m, of the poses. phipsi: `{options.method}`; MuJoCo: Euler with `frictionloss`.\n\n"
        + common.table(["robot", "phipsi", "MuJoCo"], rows)
    )
    found_text = ", ".join(f"{name} {common.relative(drift)}" if drift else f"{name} 0" for name, drift in drifts)
    return Section("Arms in static equilibrium by friction", text, [Finding("arm held by dry friction, 10 s: drift", found_text, "exactly 0", not any(drift for _, drift in drifts))])
