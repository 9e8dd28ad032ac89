"""Balance a rod on a cart with damping by a linear-quadratic regulator: linearize, compute the gains, simulate."""

import numpy as np
import phipsi
from numpy.typing import NDArray
from phipsi import control
from phipsi.shapes import Box, Capsule

Array = NDArray[np.float64]

rail, cart = Box((2.4, 0.04, 0.03), xyz=(0, 0, -0.09), color="gray"), Box((0.25, 0.14, 0.1), color="blue")
rod = Capsule(0.02, 0.96, xyz=(0, 0, 0.5), color="orange")
builder = phipsi.SceneBuilder().link("rail", shape=rail).link("cart", 1.0, inertia=cart.inertia(1.0), shape=cart)
builder.link("rod", 0.2, com=rod.xyz, inertia=rod.inertia(0.2), shape=rod)
builder.joint("slide", "prismatic", "rail", "cart", axis=(1, 0, 0), damping=0.5)
builder.joint("hinge", "revolute", "cart", "rod", axis=(0, 1, 0), damping=0.01)
scene = builder.build()

A, B_joints, *_ = scene.linearize([0.0, 0.0], [0.0, 0.0], [0.0, 0.0])  # upright, with damping; x = (positions, velocities)
B = B_joints[:, :1]  # a motor at the cart only
gains = control.lqr(A, B, [10.0, 10.0, 1.0, 1.0], [0.1]).gains  # weights of x and of the force; force = -gains x


def force(t: float, q: Array, qd: Array) -> Array:
    """Force on the cart, N."""
    return np.append(-gains @ np.concatenate([q, qd]), 0.0)


path = scene.simulate([-0.5, 0.35], [0.0, 0.0], dt=2e-3, duration=5.0, tau=force)
print(f"from {np.degrees(path.q[0, 1]):.0f} degrees to {np.degrees(path.q[-1, 1]):.3f} degrees; the cart is {1000 * path.q[-1, 0]:.1f} mm from the center")
assert np.linalg.eigvals(A).real.max() > 1.0 > 0.0 > np.linalg.eigvals(A - B @ gains).real.max()
assert np.abs(path.q[-1]).max() < 1e-2

if __name__ == "__main__":
    print("written:", scene.show(path, to="lqr.html"))
