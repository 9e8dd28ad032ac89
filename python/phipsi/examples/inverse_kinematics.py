"""Draw a circle with the flange of the bundled arm: forward kinematics, inverse kinematics, and a motion to look at."""

import numpy as np
import phipsi
from phipsi import tasks

scene = phipsi.load(phipsi.BUNDLED_ARM)
guess = np.array([0.3, -0.6, 0.9, 0.1, 0.4, 0.0])  # rad
tool = scene.placement(guess, "flange")  # forward kinematics: homogeneous matrix from flange to base, (4, 4)

angle = np.linspace(0.0, 2.0 * np.pi, 121)
circle = np.tile(tool, (len(angle), 1, 1))
circle[:, 1, 3] += 0.15 * np.sin(angle)
circle[:, 2, 3] += 0.15 * (np.cos(angle) - 1.0)

found = scene.inverse_kinematics(tasks.Pose("flange", circle), guess, follow=True)  # each pose from the solution before
assert np.all(found.reached)
q, t = found.q, np.linspace(0.0, 4.0, len(angle))

error = np.linalg.norm(scene.placement(q, "flange")[:, :3, 3] - circle[:, :3, 3], axis=-1).max()
print(f"{len(q)} poses on the circle, largest error {error:.1e} m, largest step {np.abs(np.diff(q, axis=0)).max():.2f} rad")
assert error <= 1e-8

if __name__ == "__main__":
    print("written:", scene.show(q, t=t, to="inverse_kinematics.html"))
