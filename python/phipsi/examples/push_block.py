"""A block is pushed for 0.3 s and slides to a goal, turned as requested: the push, found from gradients through contact (needs scipy)."""

import numpy as np
import phipsi
from scipy.optimize import least_squares

MASS, SIZE, FRICTION = 2.0, np.array([0.3, 0.2, 0.1]), 0.4
DT, STEPS, PUSHED = 2e-3, 600, 150

box = phipsi.shapes.Box(SIZE, color="orange")
builder = phipsi.SceneBuilder().link("block", MASS, inertia=box.inertia(MASS), shape=box)
for i, (x, y) in enumerate([(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)]):
    builder.contact(f"corner{i}", "block", xyz=SIZE * [x, y, -0.5], friction=FRICTION)
scene = builder.build(floating_base=True)

start, still = np.array([0, 0, SIZE[2] / 2, 0, 0, 0, 1.0]), np.zeros(6)
goal = np.array([0.7, -0.25, 0.6])  # x, y (m) and the yaw angle (rad) at which the block comes to rest


def slide(push: np.ndarray) -> phipsi.Trajectory:
    """The motion for a force (x, y) and a torque about the vertical, in the axes of the block, during the push."""
    tau = np.zeros((STEPS, 6))
    tau[:PUSHED, [0, 1, 5]] = push
    return scene.simulate(start, still, dt=DT, steps=STEPS, tau_steps=tau)


def missed(push: np.ndarray) -> np.ndarray:
    x, y, *_, qz, qw = slide(push).q[-1]
    return np.array([x, y, 2 * np.arctan2(qz, qw)]) - goal


def slopes(push: np.ndarray) -> np.ndarray:
    """Derivatives of x, y and the yaw angle with respect to the push: one pass backward for each."""
    path = slide(push)
    last = np.zeros((3, len(path), 6))
    # The displacement of a free joint is expressed in the axes of its body: the last rotation turns it.
    last[:2, -1, :3] = scene.placements(path.q[-1])["block"][:2, :3]
    last[2, -1, 5] = 1.0
    return np.stack([path.vjp(row).tau[:PUSHED, [0, 1, 5]].sum(axis=0) for row in last])


# A push that is too weak to move the block has no gradient: begin with one that is strong enough.
first = np.array([15.0, -4.0, 0.4])
found = least_squares(missed, first, jac=slopes, x_scale=[10, 10, 1])
path = slide(found.x)
print(f"from {np.abs(missed(first)).max():.2f} to {np.abs(missed(found.x)).max():.1e} m and rad off the goal in {found.njev} gradients")
print(f"push: {found.x[0]:.2f} N, {found.x[1]:.2f} N and {found.x[2]:.3f} N m for {PUSHED * DT:.1f} s")
assert np.abs(missed(found.x)).max() < 1e-6 and np.abs(path.qd[-1]).max() < 1e-9

if __name__ == "__main__":
    print("written:", scene.show(path, to="push_block.html"))
