"""A quadruped lands on its feet and stands: four legs in a loop, a contact at each foot, a controller for the joints only."""

import numpy as np
import phipsi
from phipsi.shapes import Box, Capsule, Sphere

trunk, foot = Box((0.5, 0.24, 0.12), color="blue"), 0.025  # m
builder = phipsi.SceneBuilder().link("trunk", 8.0, inertia=trunk.inertia(8.0), shape=[trunk, Box((0.1, 0.16, 0.1), xyz=(0.3, 0, 0.02), color="white")])
stance: list[float] = []
for front, side in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
    leg = ("front" if front > 0 else "rear") + ("_left" if side > 0 else "_right")
    thigh, shank = (Capsule(r, 0.2, xyz=(0, 0, -0.1), color=color) for r, color in ((0.03, "white"), (0.02, "gray")))
    ball = Sphere(foot, xyz=(0, 0, -0.2), color="black")
    builder.link(f"{leg}_hip", 0.3, inertia=5e-4 * np.eye(3), shape=Sphere(0.045, color="black"))
    builder.link(f"{leg}_thigh", 0.8, com=(0, 0, -0.1), inertia=thigh.inertia(0.8), shape=thigh)
    builder.link(f"{leg}_shank", 0.3, com=(0, 0, -0.1), inertia=shank.inertia(0.3), shape=[shank, ball])
    builder.joint(f"{leg}_abduction", "revolute", "trunk", f"{leg}_hip", xyz=(0.2 * front, 0.12 * side, 0), axis=(1, 0, 0))
    builder.joint(f"{leg}_flexion", "revolute", f"{leg}_hip", f"{leg}_thigh", xyz=(0, 0.05 * side, 0), axis=(0, 1, 0))
    builder.joint(f"{leg}_knee", "revolute", f"{leg}_thigh", f"{leg}_shank", xyz=(0, 0, -0.2), axis=(0, 1, 0))
    builder.contact(leg, f"{leg}_shank", xyz=(0, 0, -0.2), radius=foot, friction=0.8)
    stance += [0.0, 0.7, -1.4]
scene = builder.build(floating_base=True)

start = np.array([0, 0, 0.45, 0, 0, 0, 1, *stance])  # position and quaternion (x, y, z, w) of the trunk, then the joints
# Only the joints have motors: the gains of the six velocities of the trunk are zero.
kp, kd = (np.array([0.0] * 6 + [gain] * 12) for gain in (120.0, 4.0))
path = scene.simulate(start, np.zeros(scene.nv), dt=1e-3, duration=1.2, pd=phipsi.PD(kp, kd, start))

assert path.contacts is not None
weight = sum(force[-1, 2] for force in path.contacts.force.values())
print(f"standing at {path.q[-1, 2]:.3f} m on four feet that carry {weight:.1f} N of {9.81 * scene.total_mass:.1f} N")
assert np.abs(path.qd[-1]).max() < 0.05 and np.isclose(weight, 9.81 * scene.total_mass, rtol=0.02)

if __name__ == "__main__":
    print("written:", scene.show(path, to="quadruped.html"))
