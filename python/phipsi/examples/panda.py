"""A Panda arm grasps a block and puts it down elsewhere: inverse kinematics, PD control, friction at the fingers (needs example-robot-data)."""

import warnings

import numpy as np
import phipsi
from phipsi import tasks
from phipsi.examples import robot
from phipsi.shapes import Box

SIDE, MASS, DT = 0.05, 0.2, 2e-3  # m, kg, s

# The file has attributes of other programs, and its second finger follows the first.
warnings.simplefilter("ignore", phipsi.errors.UnknownTagWarning)
builder = phipsi.load(robot("panda_description/urdf/panda.urdf"), mimic=True).to_builder()
cube = Box((SIDE, SIDE, SIDE), color="orange")
builder.link("block", MASS, inertia=cube.inertia(MASS), shape=cube).joint("block", "floating", "panda_link0", "block")
for i, (x, y) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
    builder.contact(f"floor{i}", "block", xyz=(x * SIDE / 2, y * SIDE / 2, -SIDE / 2), friction=0.8)
    for side in ("left", "right"):  # the corners of the rubber tips, on the faces of the block
        tip = (0.008 * x, 0.0, 0.045 + 0.008 * y)
        builder.contact(f"{side}{i}", f"panda_{side}finger", xyz=tip, friction=1.0, other="block", other_size=(SIDE, SIDE, SIDE))
scene = builder.build(mimic="couple")
finger, block = scene.q_index("panda_finger_joint1"), scene.q_index("block")

# Times, s; positions of the hand, m; opening of each finger, m.
pick, place, above = np.array([0.5, 0.2, 0.03]), np.array([0.5, -0.2, 0.03]), np.array([0, 0, 0.25])
times = np.array([0.0, 0.6, 1.0, 1.7, 2.6, 3.2, 3.6, 4.2, 5.0])
points = np.array([pick + above, pick, pick, pick + above, place + above, place, place, place + above, pick + above])
opening = np.array([0.04, 0.04, 0.0, 0.0, 0.0, 0.0, 0.04, 0.04, 0.04])
t = np.arange(0.0, times[-1], DT)
part = np.searchsorted(times, t, side="right") - 1
s = (t - times[part]) / np.diff(times)[part]
s = (3.0 - 2.0 * s) * s**2  # starts and ends at rest
hand = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (len(t), 1, 1))  # points down
hand[:, :3, 3] = points[part] + s[:, None] * np.diff(points, axis=0)[part]

start = scene.neutral()
start[:7] = [0.4, -0.2, 0.0, -2.2, 0.0, 2.0, 1.2]
start[block][:3] = *pick[:2], SIDE / 2
targets = scene.inverse_kinematics(tasks.Pose("panda_hand_tcp", hand), start, follow=True).q
targets[:, finger] = (opening[part] + s * np.diff(opening)[part])[:, None]

kp = np.array([2000.0] * 4 + [500.0] * 3 + [1000.0] + [0.0] * 6)  # the block has no motor
weight = scene.gravity_torque(targets)
weight[:, scene.v_index("block")] = 0.0
path = scene.simulate(targets[0], np.zeros(scene.nv), dt=DT, steps=len(t), pd=phipsi.PD(kp, kp / 15, start), targets=targets, tau_steps=weight)

ends = path.q[:, block][np.array([0, np.searchsorted(path.t, 2.0), len(t)]), :3]
print(f"the block at the start {ends[0].round(3)}, in the hand {ends[1].round(3)}, at the end {ends[2].round(3)} m")
assert ends[1, 2] > 0.2 and np.allclose(ends[2], [*place[:2], SIDE / 2], atol=0.01)

if __name__ == "__main__":
    print("written:", scene.show(path, to="panda.html"))
