"""Reach: the bundled arm goes to a pose in one second with little torque, found by gradients through the whole motion.

Run it as it stands (phipsi, numpy and scipy): python examples/reach.py

Every step of a rollout has torques of its own. Trajectory.vjp gives the gradient of any function of the rows by all of them, by the adjoint of
every step: here of the squared distance from the goal at the end and of the rates there. SciPy's L-BFGS does the rest. A gradient costs a few times
what the rollout does, however many torques there are (docs/derivative-times.md).
"""

import time

import numpy as np
import phipsi
from scipy.optimize import minimize

STEPS, DT = 100, 0.01

scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
start = np.array([0.0, 0.6, -0.4, 0.0, 0.3, 0.0])
goal = np.array([0.8, 0.2, 0.4, 0.5, -0.4, 0.6])
still = np.zeros(scene.nv)
#: What is looked for is in these units, N m: the joints that carry more get more.
unit = np.array([20.0, 30.0, 15.0, 2.0, 2.0, 1.0])


def rolled_out(torques: np.ndarray) -> phipsi.Trajectory:
    """The motion under torques of every step, beside those that hold the start."""
    tau = scene.gravity_torque(start) + torques.reshape(STEPS, scene.nv) * unit
    # Exact friction holds a joint that starts at rest, and the gradient by its torque is then zero: the plan is made with regularized friction.
    return scene.simulate(start, still, dt=DT, steps=STEPS, tau_steps=tau, method="implicit-euler", friction_speed=0.01)


def cost(torques: np.ndarray) -> tuple[float, np.ndarray]:
    """Distance and rates at the end, and torques, with the gradient by every torque."""
    path = rolled_out(torques)
    away, speed = scene.difference(goal, path.q[-1]), path.qd[-1]
    by_q, by_qd = np.zeros((2, len(path), scene.nv))
    by_q[-1], by_qd[-1] = 2e3 * away, 2e2 * speed
    gradient = path.vjp(by_q, by_qd).tau * unit
    value = 1e3 * away @ away + 1e2 * speed @ speed + DT * torques @ torques
    return value, gradient.ravel() + 2.0 * DT * torques


began = time.perf_counter()
found = minimize(cost, np.zeros(STEPS * scene.nv), jac=True, method="L-BFGS-B", options={"maxiter": 500})
seconds = time.perf_counter() - began
end = rolled_out(found.x)
off, speed = (np.abs(x).max() for x in (scene.difference(goal, end.q[-1]), end.qd[-1]))
print(f"{STEPS * scene.nv} torques, {found.nfev} gradients in {seconds:.2f} s")
print(f"at the end {off:.1e} rad from the goal at {speed:.1e} rad/s; cost {cost(np.zeros(found.x.size))[0]:.3g} -> {found.fun:.3g}")
