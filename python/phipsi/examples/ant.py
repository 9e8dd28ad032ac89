"""An ant from an MJCF file lands on its floor: robots/ant.xml, with its geoms as colliders (needs mujoco)."""

from pathlib import Path

import numpy as np
import phipsi

scene = phipsi.load(Path(__file__).parent / "robots" / "ant.xml", contacts="plane")
print(f"{scene.nv - 6} joints, {len(scene.collider_names)} colliders: {', '.join(scene.collider_names[:3])}, ...")

start = scene.neutral()
start[2] = 1.0  # m, height of the torso
stance = start.copy()
for i in range(1, 5):
    start[scene.q_index(f"ankle_{i}")] = stance[scene.q_index(f"ankle_{i}")] = np.radians(55)
kp, kd = (np.array([0.0] * 6 + [gain] * (scene.nv - 6)) for gain in (150.0, 8.0))  # the torso has no motor
path = scene.simulate(start, np.zeros(scene.nv), dt=1e-3, duration=1.5, pd=phipsi.PD(kp, kd, stance))

assert path.contacts is not None
touching = path.contacts.shapes
on_floor = touching.row == len(path) - 1  # the floor is the first collider of each pair: the force on it
weight = -touching.force[on_floor, 2].sum()
print(f"standing at {path.q[-1, 2]:.3f} m; the floor carries {weight:.1f} N of {9.81 * scene.total_mass:.1f} N")
assert np.isclose(weight, 9.81 * scene.total_mass, rtol=0.02) and np.abs(path.qd[-1]).max() < 0.05

if __name__ == "__main__":
    print("written:", scene.show(path, to="ant.html"))
