"""A four-bar linkage driven by a motor at its crank: a loop closed by a connection, and the force in its pin."""

import numpy as np
import phipsi
from phipsi.shapes import Box, Cylinder

builder = phipsi.SceneBuilder().link("ground", shape=Box((0.5, 0.06, 0.02), xyz=(0.15, 0, -0.05), color="gray"))


def bar(name: str, parent: str, at: tuple[float, float, float], length: float, color: str) -> None:
    """Add a bar of 1 kg on a hinge about y."""
    body = Box((0.03, 0.02, length), xyz=(0, 0, length / 2), color=color)
    pin = Cylinder(0.022, 0.03, rpy=(np.pi / 2, 0, 0), color="black")
    builder.link(name, 1.0, com=body.xyz, inertia=body.inertia(1.0), shape=[body, pin])
    builder.joint(name, "continuous", parent, name, xyz=at, axis=(0, 1, 0), damping=0.02)


bar("crank", "ground", (0, 0, 0), 0.1, "orange")
bar("coupler", "crank", (0, 0, 0.1), 0.35, "white")
bar("rocker", "ground", (0.3, 0, 0), 0.25, "blue")
# The far ends of coupler and rocker share a hinge.
builder.connect("pin", "axis", "coupler", "rocker", xyz=(0, 0, 0.35), other_xyz=(0, 0, 0.25), axis=(0, 1, 0))
scene = builder.build()

q, _, rank = scene.loops.project([0.0, 1.0, 0.0])  # the nearest state with a closed loop
path = scene.simulate(q, np.zeros(3), dt=1e-3, duration=2.0, tau=[1.5, 0.0, 0.0])

turns = (path.q[-1, 0] - path.q[0, 0]) / (2 * np.pi)
force = np.linalg.norm(scene.loops.dynamics(path.q[-1], path.qd[-1], [1.5, 0.0, 0.0]).forces["pin"][3:])
print(f"{scene.nv - rank} degree of freedom; {turns:.1f} turns of the crank; the pin carries {force:.0f} N at the end")
assert scene.nv - rank == 1 and np.abs(scene.loops.error(path.q)).max() < 1e-9

if __name__ == "__main__":
    print("written:", scene.show(path, to="four_bar.html"))
