"""Read your own URDF with meshes, look at its properties, and let it move: robots/crane/crane.urdf."""

from pathlib import Path

import numpy as np
import phipsi

scene = phipsi.load(Path(__file__).parent / "robots" / "crane" / "crane.urdf")
for name, joint in scene.joints.items():
    print(f"{name}: {joint.type} from {joint.parent} to {joint.child}, {joint.lower:g} to {joint.upper:g}")

# Where is the hook, and what do the motors hold?
q = np.array([0.4, -0.5, 0.2])  # rad, rad, m
hook = scene.placement(q, "hook")
print(f"hook at {hook[:3, 3].round(3)} m; holding torques {scene.gravity_torque(q).round(1)} N m, N m, N")
path = scene.simulate(q, [0.0, 0.0, 0.0], dt=1e-3, duration=2.0, pd=phipsi.PD(2e4, 2e3, [-0.6, -0.9, 0.5]))
assert np.allclose(path.q[-1], [-0.6, -0.9, 0.5], atol=0.05)

if __name__ == "__main__":
    print("written:", scene.show(path, to="own_urdf.html"))
