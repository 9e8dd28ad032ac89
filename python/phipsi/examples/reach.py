"""The bundled arm moves to a pose in one second with small torques: gradients of the whole simulation (needs scipy).

Run it with phipsi, numpy and scipy:

    python -m phipsi.examples reach

Every step of a simulation has separate torques. Trajectory.vjp computes the gradient of any function of the rows with
respect to all of them, by the adjoint of every step: here of the squared final distance from the goal and the final
joint velocities. SciPy's L-BFGS minimizes it. The time of a gradient is a small multiple of that of the simulation,
independent of the number of torques (docs/measured/derivative-times.md).
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
#: Units of the variables, N m: larger for joints with larger loads.
unit = np.array([20.0, 30.0, 15.0, 2.0, 2.0, 1.0])


def rolled_out(torques: np.ndarray) -> phipsi.Trajectory:
    """The motion for torques of every step, in addition to those of static equilibrium."""
    tau = scene.gravity_torque(start) + torques.reshape(STEPS, scene.nv) * unit
    # Exact friction keeps a joint at rest, where the gradient with respect to its torque is zero; therefore the plan
    # uses regularized friction.
    return scene.simulate(start, still, dt=DT, steps=STEPS, tau_steps=tau, method="implicit-euler", friction_speed=0.01)


def cost(torques: np.ndarray) -> tuple[float, np.ndarray]:
    """Final distance and velocities, and torques, with the gradient with respect to every torque."""
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
