"""Three rods on a cart are kept upright by a force on the cart only: a linear-quadratic regulator.

Run it with phipsi and numpy:

    python -m phipsi.examples balance

Scene.linearize computes A and B for small deviations from the upright equilibrium; phipsi.control.lqr computes the
gains K of u = -K x, and the nonlinear scene is simulated with this controller from a perturbed initial state.
The deviation is computed by Scene.difference, so that the same code balances robots with spherical joints or a
floating base.
"""

import numpy as np
import phipsi
from phipsi import control

RODS, LENGTH, SECONDS, DT = 3, 0.5, 8.0, 0.004

builder = phipsi.SceneBuilder().link("rail").link("cart", mass=2.0)
builder.joint("slide", "prismatic", "rail", "cart", axis=(1, 0, 0), damping=0.5)
for k in range(RODS):
    builder.link(f"rod{k}", mass=0.4, com=(0, 0, LENGTH / 2), inertia=np.diag([0.4 * LENGTH**2 / 12] * 2 + [1e-4]))
    place = (0, 0, LENGTH if k else 0)
    builder.joint(f"hinge{k}", "revolute", f"rod{k - 1}" if k else "cart", f"rod{k}", xyz=place, axis=(0, 1, 0), damping=0.002)
scene = builder.build()
n = scene.nv
pushed = scene.v_index("slide")

# Upright and at rest, where no torque is needed. Only the cart is actuated. The system includes the damping of the joints.
upright, still = scene.neutral(), np.zeros(n)
a, b = scene.linearize(upright, still, scene.bias_torque(upright, still))
b = b[:, pushed]
regulator = control.lqr(a, b, [1.0] + [10.0] * RODS + [1.0] * n, [0.01])
gains = regulator.gains
fastest, slowest = np.linalg.eigvals(a).real.max(), regulator.poles.real.max()
print(f"{n} degrees of freedom, one force; upright falls at {fastest:.1f}/s, balanced it settles at {slowest:.1f}/s")


def force(t, q, qd):
    """u = -K x on the cart, zero on the hinges."""
    x = np.concatenate([scene.difference(np.broadcast_to(upright, q.shape), q), qd], axis=-1)
    tau = np.zeros_like(qd)
    tau[..., pushed] = -x @ gains.T
    return tau


# Many initial states in one call.
random = np.random.default_rng(1)
starts = scene.integrate(upright, random.uniform(-0.03, 0.03, (32, n)))
path = scene.simulate(starts, np.zeros((32, n)), dt=DT, steps=round(SECONDS / DT), tau=force, record_every=25)
angles = np.abs(path.q[..., 1:]).max(axis=(0, -1))
for seconds in (0, 1, 2, 4, 8):
    at = np.searchsorted(path.t, seconds - 1e-9)
    print(f"t = {path.t[at]:4.1f} s: largest angle of {len(starts)} starts {angles[at]:.2e} rad")
