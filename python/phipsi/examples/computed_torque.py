"""Track a planned motion with computed torque, and plot the joint torques against their limits (needs matplotlib)."""

from typing import Any

import numpy as np
import phipsi
from numpy.typing import NDArray

Array = NDArray[np.float64]

scene = phipsi.load(phipsi.BUNDLED_ARM)
start = np.array([0.3, -0.6, 0.9, 0.1, 0.4, 0.0])  # rad


def desired(t: float) -> tuple[Array, Array, Array]:
    """Desired joint positions, velocities and accelerations."""
    return start + 0.4 * (1 - np.cos(t)), np.full(6, 0.4 * np.sin(t)), np.full(6, 0.4 * np.cos(t))


def controller(t: float, q: Array, qd: Array) -> Array:
    """Joint torques, N m: inverse dynamics of the desired acceleration with a correction of the error."""
    q_desired, qd_desired, qdd_desired = desired(t)
    qdd = qdd_desired + 20.0 * (qd_desired - qd) + 100.0 * (q_desired - q)
    return scene.inverse_dynamics(q, qd, qdd) + scene.damping * qd + scene.friction * np.tanh(qd / 0.01)


path = scene.simulate(start, np.zeros(6), dt=1e-3, duration=3.0, tau=controller)

error = np.abs(path.q[-1] - desired(3.0)[0]).max()
torque = np.array([controller(t, q, qd) for t, q, qd in zip(path.t, path.q, path.qd, strict=True)])
share = np.abs(torque / scene.limits.effort).max(axis=0)
print(f"tracking error {np.degrees(error):.3f} degrees; largest torques {(100 * share).round().astype(int)} % of the limits")
assert error < 1e-3 and share.max() < 1.0

if __name__ == "__main__":
    import matplotlib.pyplot as plt

    figure: Any  # the annotations of matplotlib are incomplete
    axes: Any
    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    axes.plot(path.t, torque, label=scene.joint_names)
    axes.set(xlabel="time, s", ylabel="joint torque, N m")
    axes.legend(ncols=3)
    figure.savefig("computed_torque.png", dpi=150)
    print("written: computed_torque.png and", scene.show(path, to="computed_torque.html"))
