"""A block at rest is pushed to a goal, from no push at all: smoothed contacts have the gradient that friction hides (needs scipy)."""

import numpy as np
import phipsi
from scipy.optimize import least_squares

MASS, SIZE, FRICTION = 2.0, np.array([0.3, 0.2, 0.1]), 0.4
DT, STEPS, PUSHED = 2e-3, 500, 150

box = phipsi.shapes.Box(SIZE, color="orange")
builder = phipsi.SceneBuilder().link("block", MASS, inertia=box.inertia(MASS), shape=box)
for i, (x, y) in enumerate([(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)]):
    builder.contact(f"corner{i}", "block", xyz=SIZE * [x, y, -0.5], friction=FRICTION)
scene = builder.build(floating_base=True)
goal = np.array([0.4, -0.15])  # x and y at which the block comes to rest, m


def slide(push: np.ndarray, smoothing: float) -> phipsi.Trajectory:
    """The motion for a horizontal force during the push. A smoothed block at rest has the gap `smoothing`."""
    tau = np.zeros((STEPS, 6))
    tau[:PUSHED, :2] = push
    start = np.array([0, 0, SIZE[2] / 2 + smoothing, 0, 0, 0, 1.0])
    return scene.simulate(start, np.zeros(6), dt=DT, steps=STEPS, tau_steps=tau, smoothing=smoothing)


def missed(push: np.ndarray, smoothing: float) -> np.ndarray:
    return slide(push, smoothing).q[-1, :2] - goal


def slopes(push: np.ndarray, smoothing: float) -> np.ndarray:
    """Derivatives of x and y with respect to the push: one pass backward for each."""
    path = slide(push, smoothing)
    last = np.zeros((2, len(path), 6))
    # The displacement of a free joint is expressed in the axes of its body: the last rotation turns it.
    last[:, -1, :3] = scene.placements(path.q[-1])["block"][:2, :3]
    return np.stack([path.vjp(row).tau[:PUSHED, :2].sum(axis=0) for row in last])


push = np.zeros(2)
# With the exact law, friction holds the block and the gradient is zero: an optimizer ends where it begins.
assert np.abs(slopes(push, 0.0)).max() < 1e-12
for smoothing in (1e-2, 1e-3, 0.0):
    push = least_squares(missed, push, jac=slopes, x_scale=10.0, args=(smoothing,)).x
    off, creep = np.abs(missed(push, 0.0)).max(), slide(push, smoothing).contacts.creep
    print(f"smoothing {smoothing:g} m: push {push.round(2)} N; {off:.1e} m off the goal with the exact law; slip of up to {creep:.3f} m/s in sticking")
assert np.abs(missed(push, 0.0)).max() < 1e-6

if __name__ == "__main__":
    print("written:", scene.show(slide(push, 0.0), to="push_from_rest.html"))
