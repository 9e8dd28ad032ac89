"""A box falls onto the floor, tumbles, and comes to rest: a link with a shape, a contact at each corner, `simulate`."""

import itertools

import numpy as np
import phipsi

mass, size = 2.0, np.array([0.4, 0.3, 0.2])  # kg, m
box = phipsi.shapes.Box(size, color="orange")
builder = phipsi.SceneBuilder().link("box", mass, inertia=box.inertia(mass), shape=box)
for i, corner in enumerate(itertools.product((-0.5, 0.5), repeat=3)):
    builder.contact(f"corner{i}", "box", xyz=corner * size, friction=0.5, restitution=0.2)
scene = builder.build(floating_base=True)

# The position (x, y, z) and the quaternion (x, y, z, w) of the box; its linear, then its angular velocity.
q = scene.integrate([0, 0, 0.6, 0, 0, 0, 1], [0, 0, 0, 0.5, 0.3, 0.2])
path = scene.simulate(q, [0.8, 0, 0, 0, 2.0, 0], dt=1e-3, duration=1.5)

rest = path.q[-1]
print(f"at rest after 1.5 s at x = {rest[0]:.2f} m; the center is {100 * rest[2]:.1f} cm above the floor")
contacts = path.contacts
assert contacts is not None and np.abs(path.qd[-1]).max() < 1e-6
assert np.isclose(sum(force[-1, 2] for force in contacts.force.values()), mass * 9.81)

if __name__ == "__main__":
    print("written:", scene.show(path, to="dropped_box.html"))
