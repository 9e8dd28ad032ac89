"""A Talos humanoid squats and swings its arms: legs by inverse kinematics, PD control, flat feet on the floor (needs example-robot-data)."""

import numpy as np
import phipsi
from phipsi import tasks
from phipsi.examples import robot

PERIOD, PERIODS, DEPTH, DT = 1.6, 2, 0.2, 2e-3  # s; m, of the squat; s

builder = phipsi.load(robot("talos_data/robots/talos_reduced.urdf"), floating_base=True).to_builder()
soles = ("left_sole_link", "right_sole_link")
for sole in soles:
    for i, (x, y) in enumerate(((-0.1, -0.06), (-0.1, 0.06), (0.1, -0.06), (0.1, 0.06))):
        builder.contact(f"{sole}{i}", sole, xyz=(x, y, 0.0), friction=0.8)
scene = builder.build()

# One period: the pelvis moves down and up, the trunk turns, and the arms swing against each other.
phase = np.linspace(0.0, 2 * np.pi, int(PERIOD / DT), endpoint=False)
q = np.tile(scene.neutral(), (len(phase), 1))
swing = np.sin(phase)
angles = {"torso_1_joint": 0.4 * swing}
for side, sign in (("left", 1.0), ("right", -1.0)):
    angles |= {f"leg_{side}_{joint}_joint": np.full_like(phase, angle) for joint, angle in ((3, -0.4), (4, 0.8), (5, -0.4))}
    angles |= {f"arm_{side}_1_joint": -0.2 * sign + 0 * phase, f"arm_{side}_2_joint": 0.3 * sign + 0 * phase, f"arm_{side}_4_joint": -1.4 + 0.3 * sign * swing}
for joint, angle in angles.items():
    q[:, scene.q_index(joint)] = angle[:, None]
q[:, 2] = -scene.placement(q[0], soles[0])[2, 3]  # the soles on the floor
pelvis = scene.placement(q, "base_link")
pelvis[:, 2, 3] -= DEPTH * (1.0 - np.cos(phase)) / 2
legs = [tasks.Pose("base_link", pelvis), *(tasks.Pose(sole, scene.placement(q[0], sole)) for sole in soles)]
cycle = scene.inverse_kinematics(legs, q, starts=1)
assert np.all(cycle.reached)

kp = np.where(np.arange(scene.nv) < 6, 0.0, 5000.0)  # the pelvis has no motor
targets = np.tile(cycle.q, (PERIODS, 1))
path = scene.simulate(cycle.q[0], np.zeros(scene.nv), dt=DT, steps=len(targets), pd=phipsi.PD(kp, kp / 20, q[0]), targets=targets)

tilt = 2 * np.degrees(np.linalg.norm(path.q[:, 3:5], axis=1).max())
print(f"pelvis between {path.q[:, 2].min():.2f} and {path.q[:, 2].max():.2f} m, tilted by at most {tilt:.1f} degrees")
assert np.ptp(path.q[:, 2]) > 0.9 * DEPTH and tilt < 5.0

if __name__ == "__main__":
    print("written:", scene.show(path, to="talos.html"))
