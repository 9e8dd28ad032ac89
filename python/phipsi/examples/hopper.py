"""A hopper jumps to a given height with the least effort: the force of its leg, found from gradients through contact (needs scipy)."""

import numpy as np
import phipsi
from scipy.optimize import brentq, minimize

DT, STEPS, KNOTS = 1e-3, 300, 12
PUSH, HEIGHT = 240, 0.8  # steps in which the leg pushes, and the height of the body at the apex of the flight, m

body, foot = phipsi.shapes.Box((0.2, 0.2, 0.15), color="blue"), phipsi.shapes.Sphere(0.05, color="orange")
builder = phipsi.SceneBuilder().link("ground").link("body", 3.0, inertia=body.inertia(3.0), shape=body)
builder.joint("rail", "prismatic", "ground", "body", axis=(0, 0, 1), lower=-10, upper=10)
builder.link("foot", 0.3, inertia=foot.inertia(0.3), shape=foot)
builder.joint("leg", "prismatic", "body", "foot", axis=(0, 0, -1), lower=0.1, upper=0.5, damping=4.0)
builder.contact("ground", "foot", radius=0.05, friction=0.8)
scene = builder.build()

# Crouched: the leg is 0.2 m long and carries the body.
start, still = np.array([0.25, 0.2]), np.zeros(2)
weight = 3.0 * 9.81


def jump(forces: np.ndarray) -> phipsi.Trajectory:
    """The motion for forces of the leg, constant between knots, in units of the weight."""
    tau = np.zeros((STEPS, 2))
    tau[:PUSH, 1] = np.repeat(forces * weight, PUSH // KNOTS)
    return scene.simulate(start, still, dt=DT, steps=STEPS, tau_steps=tau)


def too_low(forces: np.ndarray) -> float:
    """The height of the body at the apex of its flight, from its height and velocity at the end, minus the requested one."""
    path = jump(forces)
    return path.q[-1, 0] + path.qd[-1, 0] * abs(path.qd[-1, 0]) / (2 * 9.81) - HEIGHT


def slopes(forces: np.ndarray) -> np.ndarray:
    path = jump(forces)
    by_q, by_qd = np.zeros((2, len(path), 2))
    by_q[-1, 0], by_qd[-1, 0] = 1.0, abs(path.qd[-1, 0]) / 9.81
    return path.vjp(by_q, by_qd).tau[:PUSH, 1].reshape(KNOTS, -1).sum(axis=1) * weight


first = np.full(KNOTS, 1.8)
found = minimize(
    lambda forces: forces @ forces,
    first,
    jac=lambda forces: 2 * forces,
    method="SLSQP",
    bounds=[(0.0, 5.0)] * KNOTS,
    constraints={"type": "eq", "fun": too_low, "jac": slopes},
    options={"maxiter": 100},
)
path = jump(found.x)
# The same height with a constant force.
same = brentq(lambda force: too_low(np.full(KNOTS, force)), 1.8, 4.0)
print(f"{found.message}: {found.nit} iterations, {1e3 * abs(too_low(found.x)):.1e} mm off the height")
print("leg force over the weight:", found.x.round(2))
print(f"effort {found.fun:.1f}, with a constant force {KNOTS * same**2:.1f}")
assert found.success and abs(too_low(found.x)) < 1e-6 and found.fun < KNOTS * same**2
# The flight to the apex.
flight = scene.simulate(path.q[-1], path.qd[-1], dt=DT, steps=250)
assert abs(flight.q[:, 0].max() - HEIGHT) < 0.02

if __name__ == "__main__":
    print("written:", scene.show(path, to="hopper.html"))
