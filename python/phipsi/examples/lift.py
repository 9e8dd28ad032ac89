"""A gripper lifts a block: the second finger follows the first, and friction alone holds the block."""

import numpy as np
import phipsi
from phipsi.shapes import Box, Cylinder

edge, width, squeeze, height = 0.04, 0.012, 15.0, 0.12  # edge of the block, width of a finger, m; force on the fingers, N; m
block, hand = Box((edge, edge, edge), color="orange"), Box((0.16, 0.05, 0.03), color="blue")
table = Box((0.4, 0.3, 0.02), xyz=(0, 0, -edge / 2 - 0.01), color="gray")
builder = phipsi.SceneBuilder().link("world", shape=table)
builder.link("hand", 0.8, inertia=hand.inertia(0.8), shape=[hand, Cylinder(0.03, 0.08, xyz=(0, 0, 0.055), color="gray")])
builder.joint("lift", "prismatic", "world", "hand", xyz=(0, 0, 0.13), axis=(0, 0, 1))
for side, name, mimic in ((-1.0, "left", None), (1.0, "right", "left")):
    pad = Box((width, 0.03, 0.14), xyz=(side * width / 2, 0, -0.08), color="white")
    builder.link(name, 0.1, com=(0, 0, -0.08), inertia=pad.inertia(0.1), shape=pad)
    # Positive coordinates open the gripper.
    builder.joint(name, "prismatic", "hand", name, axis=(side, 0, 0), lower=0.0, upper=0.07, damping=60.0, mimic=mimic)
    for i, (y, z) in enumerate([(-0.01, -0.14), (-0.01, -0.12), (0.01, -0.14), (0.01, -0.12)]):
        builder.contact(f"{name}{i}", name, xyz=(0, y, z), friction=0.6, other="block", other_size=(edge, edge, edge))
builder.link("block", 0.3, inertia=block.inertia(0.3), shape=block).joint("block", "floating", "world", "block")
for i, (x, y) in enumerate([(-1, -1), (-1, 1), (1, -1), (1, 1)]):
    builder.contact(f"corner{i}", "block", xyz=(x * edge / 2, y * edge / 2, -edge / 2), friction=0.6, offset=-edge / 2)
scene = builder.build(mimic="couple")

q, tau = scene.neutral(), np.zeros(scene.nv)
q[scene.q_index("left")] = 0.05
tau[scene.v_index("left")] = -squeeze
stiffness = np.zeros(scene.nv)
stiffness[scene.v_index("lift")] = 2000.0
simulator = scene.simulator(q, dt=1e-3, pd=phipsi.PD(stiffness, stiffness / 15, q))
rows = [q]
for n in range(2000):
    # Grip in the first half second; then raise the hand by a feedforward force along a smooth path.
    s = np.clip((n - 500) / 1000, 0.0, 1.0)
    tau[scene.v_index("lift")] = 2000.0 * height * s**2 * (3 - 2 * s) + (1.0 + 0.3 * (s > 0)) * 9.81
    simulator.step(tau)
    if n % 20 == 19:
        rows.append(simulator.q)
q, t = np.array(rows), np.arange(len(rows)) * 0.02

raised = q[-1, scene.q_index("block")][2]
contacts = simulator.contacts
assert contacts is not None
held = sum(contacts.force[f"{name}{i}"][2] for name in ("left", "right") for i in range(4))
print(f"the block is {1000 * raised:.1f} mm above the table; friction carries {-held:.2f} N of {0.3 * 9.81:.2f} N")
assert abs(raised - height) < 2e-3 and np.isclose(-held, 0.3 * 9.81, rtol=1e-3)
assert np.abs(scene.contacts.velocities(simulator.q, simulator.qd)[:8]).max() < 1e-6

if __name__ == "__main__":
    print("written:", scene.show(q, t=t, to="lift.html"))
