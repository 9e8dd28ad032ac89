"""A gripper closes on a block: two fingers, the same force on both, and the contact forces as arrows."""

import numpy as np
import phipsi
from phipsi.shapes import Box, Cylinder

half, width, squeeze = 0.02, 0.012, 15.0  # half the width of the block and width of a finger, m; force, N
block = Box((2 * half, 0.05, 0.05), xyz=(0, 0, -0.13), color="orange")
palm = Box((0.2, 0.06, 0.03), color="blue")
builder = phipsi.SceneBuilder().link("palm", shape=[palm, Cylinder(0.035, 0.08, xyz=(0, 0, 0.055), color="gray"), block])
for side, name in ((1.0, "left"), (-1.0, "right")):
    pad = Box((width, 0.03, 0.14), xyz=(side * width / 2, 0, -0.085), color="white")
    builder.link(name, 0.1, com=(0, 0, -0.085), inertia=pad.inertia(0.1), shape=pad)
    # Positive coordinates open the gripper.
    builder.joint(f"{name}_finger", "prismatic", "palm", name, axis=(side, 0, 0), lower=0.0, upper=0.08, damping=120.0)
    for i, (y, z) in enumerate([(-0.01, -0.14), (-0.01, -0.12), (0.01, -0.14), (0.01, -0.12)]):
        # The faces of the block are planes of the world.
        builder.contact(f"{name}{i}", name, xyz=(0, y, z), normal=(side, 0, 0), offset=half, friction=0.8)
scene = builder.build()

path = scene.simulate([0.07, 0.07], [0.0, 0.0], dt=1e-3, duration=0.8, tau=[-squeeze, -squeeze])

assert path.contacts is not None
press = sum(path.contacts.force[f"left{i}"][-1, 0] for i in range(4))
print(f"fingers at {1000 * path.q[-1].round(4)} mm; the left one presses with {press:.1f} N")
assert np.allclose(path.q[-1], half, atol=1e-6) and np.isclose(press, squeeze)

if __name__ == "__main__":
    print("written:", scene.show(path, to="gripper.html"))
