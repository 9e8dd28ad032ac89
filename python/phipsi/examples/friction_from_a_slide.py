"""The friction of a floor and the mass distribution of a puck, from one recorded slide, by gradients through contact (needs scipy)."""

import numpy as np
import phipsi
from scipy.optimize import least_squares

DT, STEPS = 2e-3, 250
LEGS = {"left": (-0.06, -0.05), "right": (-0.06, 0.05), "front": (0.1, 0.0)}


def puck(friction: float, yaw_inertia: float) -> phipsi.Scene:
    """A puck on three points, 0.8 kg."""
    builder = phipsi.SceneBuilder().link("puck", 0.8, inertia=np.diag([2e-3, 2e-3, yaw_inertia]))
    for leg, (x, y) in LEGS.items():
        builder.contact(leg, "puck", xyz=(x, y, -0.02), friction=friction)
    return builder.build(floating_base=True)


start, launch = np.array([0, 0, 0.02, 0, 0, 0, 1.0]), np.array([1.6, 0.3, 0, 0, 0, 9.0])


def slide(given: np.ndarray) -> phipsi.Trajectory:
    return puck(*given).simulate(start, launch, dt=DT, steps=STEPS)


# The record: the positions of the puck in every tenth step, with an error of 0.2 mm and 2 mrad.
true = np.array([0.27, 3.1e-3])
path = slide(true)
noise = np.random.default_rng(1).normal(0, [2e-4, 2e-4, 0, 0, 0, 2e-3], (STEPS // 10, 6))
record = path.scene.integrate(path.q[10::10], noise)
sigma = np.array([2e-4, 2e-4, 2e-3])


def residuals(given: np.ndarray) -> np.ndarray:
    path = slide(given)
    return (path.scene.difference(record, path.q[10::10])[:, [0, 1, 5]] / sigma).ravel()


def slopes(given: np.ndarray) -> np.ndarray:
    """Derivatives of all residuals; a batch of equal states, one per residual, propagates them backward together."""
    path = slide(given)
    count = STEPS // 10
    rows = np.zeros((count, 3, STEPS + 1, 6))
    for i in range(count):
        for j, row in enumerate((0, 1, 5)):
            rows[i, j, 10 * (i + 1), row] = 1.0 / sigma[j]
    keywords = {"dt": DT, "steps": STEPS}
    found = path.scene.simulate_vjp(path.q, path.qd, rows, np.zeros_like(rows), parameters=True, **keywords)
    by_friction = sum(contact.friction for contact in found.contacts.values())
    return np.stack([by_friction, found.parameters[..., 0, 9]], axis=-1).reshape(-1, 2)  # the last of the ten is Izz


found = least_squares(residuals, [0.35, 2e-3], jac=slopes, x_scale=[0.1, 1e-3])
deviation = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
for name, value, spread, expected in zip(("friction", "yaw inertia"), found.x, deviation, true, strict=True):
    print(f"{name}: {value:.4g} +- {spread:.1g}, in the simulation of the record {expected:.4g}")
assert found.success and np.all(np.abs(found.x - true) < 4 * deviation) and np.all(deviation < 0.02 * true)

if __name__ == "__main__":
    print("written:", path.scene.show(path, to="friction_from_a_slide.html"))
