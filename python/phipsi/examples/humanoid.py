"""A humanoid stands on flat feet and raises its arms: capsules, a contact at each corner of the feet, stiff PD control."""

import numpy as np
import phipsi
from phipsi.shapes import Box, Capsule, Shape, Sphere

builder = phipsi.SceneBuilder()
target: dict[str, float] = {}


def limb(name: str, parent: str, at: tuple[float, float, float], mass: float, shape: Capsule | Box, axes: str, more: tuple[Shape, ...] = ()) -> None:
    """Add a link on one revolute joint per letter of `axes`."""
    for letter in axes:
        is_last = letter == axes[-1]
        link = name if is_last else f"{name}_{letter}"
        if is_last:
            builder.link(link, mass, com=shape.xyz, inertia=shape.inertia(mass), shape=[shape, *more])
        else:
            builder.link(link, 0.1, inertia=1e-3 * np.eye(3))
        axis = {"x": (1, 0, 0), "y": (0, 1, 0)}[letter]
        builder.joint(f"{name}_{letter}", "revolute", parent, link, xyz=at, axis=axis)
        target[f"{name}_{letter}"] = 0.0
        parent, at = link, (0.0, 0.0, 0.0)


pelvis, chest = Box((0.16, 0.3, 0.14), color="blue"), Box((0.2, 0.36, 0.42), xyz=(0, 0, 0.25), color="white")
builder.link("pelvis", 10.0, inertia=pelvis.inertia(10.0), shape=pelvis)
limb("chest", "pelvis", (0, 0, 0.07), 22.0, chest, "y", (Sphere(0.11, xyz=(0, 0, 0.6), color="gray"),))
for side, name in ((1, "left"), (-1, "right")):
    limb(f"{name}_thigh", "pelvis", (0, 0.1 * side, -0.05), 7.0, Capsule(0.07, 0.34, xyz=(0, 0, -0.2), color="white"), "xy")
    limb(f"{name}_shank", f"{name}_thigh", (0, 0, -0.4), 4.0, Capsule(0.05, 0.34, xyz=(0, 0, -0.2), color="blue"), "y")
    limb(f"{name}_foot", f"{name}_shank", (0, 0, -0.4), 1.0, Box((0.24, 0.1, 0.06), xyz=(0.05, 0, -0.03), color="black"), "xy")
    for i, (x, y) in enumerate([(-0.07, -0.05), (-0.07, 0.05), (0.17, -0.05), (0.17, 0.05)]):
        builder.contact(f"{name}{i}", f"{name}_foot", xyz=(x, y, -0.06), friction=0.9)
    limb(f"{name}_arm", "chest", (0, 0.24 * side, 0.42), 2.5, Capsule(0.045, 0.26, xyz=(0, 0, -0.15), color="blue"), "xy")
    limb(f"{name}_forearm", f"{name}_arm", (0, 0, -0.3), 1.5, Capsule(0.038, 0.24, xyz=(0, 0, -0.14), color="white"), "y")
    target |= {f"{name}_arm_x": 1.2 * side, f"{name}_forearm_y": -0.8}
scene = builder.build(floating_base=True)

q = scene.neutral()
q[2] = 0.911  # m, height of the pelvis: the feet are 1 mm above the floor
goal = q.copy()
for joint, angle in target.items():
    goal[scene.q_index(joint)] = angle
kp, kd = (np.array([0.0] * 6 + [gain] * (scene.nv - 6)) for gain in (3000.0, 150.0))  # the pelvis has no motor
path = scene.simulate(q, np.zeros(scene.nv), dt=2e-3, duration=1.2, pd=phipsi.PD(kp / 4, kd, goal))

tilt = 2 * np.linalg.norm(path.q[-1, 3:6])
print(f"standing: pelvis at {path.q[-1, 2]:.3f} m, tilted by {np.degrees(tilt):.1f} degrees")
assert path.q[-1, 2] > 0.88 and tilt < 0.1 and np.abs(path.qd[-1]).max() < 0.2

if __name__ == "__main__":
    print("written:", scene.show(path, to="humanoid.html"))
