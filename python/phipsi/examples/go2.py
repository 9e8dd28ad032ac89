"""A Unitree Go2 trots over the floor: paths of the feet, inverse kinematics, PD control and friction (needs example-robot-data)."""

import numpy as np
import phipsi
from phipsi import tasks
from phipsi.examples import robot

PERIOD, STEPS, PERIODS = 0.4, 200, 8  # s, of the gait; steps of the simulation in a period
HEIGHT, LIFT, STRIDE, RADIUS = 0.28, 0.08, 0.12, 0.022  # m: of the trunk, of a swinging foot; length of a step; radius of a foot

builder = phipsi.load(robot("go2_description/urdf/go2.urdf"), floating_base=True).to_builder()
for foot in ("FL", "FR", "RL", "RR"):
    builder.contact(foot, f"{foot}_foot", radius=RADIUS, friction=0.9)
scene = builder.build()
stance = np.array([0, 0, HEIGHT, 0, 0, 0, 1, *[0.0, 0.8, -1.6] * 4])  # position and quaternion of the trunk, then the joints

# One period: diagonal feet move together, half of the time on the floor.
gait: list[tasks.Task] = [tasks.Pose("base", np.tile(scene.placement(stance, "base"), (STEPS, 1, 1)))]
for foot, shift in (("FL", 0.0), ("RR", 0.0), ("FR", 0.5), ("RL", 0.5)):
    part = (np.arange(STEPS) / STEPS + shift) % 1.0
    swings = part < 0.5
    x, y, _ = scene.placement(stance, f"{foot}_foot")[:3, 3]
    forward = STRIDE * np.where(swings, -0.5 * np.cos(2 * np.pi * part), 1.5 - 2 * part)
    up = RADIUS + LIFT * np.where(swings, np.sin(2 * np.pi * part) ** 2, 0.0)
    gait.append(tasks.Position(f"{foot}_foot", np.stack([x + forward, np.full(STEPS, y), up], axis=-1)))
cycle = scene.inverse_kinematics(gait, stance, follow=True)
assert np.all(cycle.reached)

kp, kd = (np.array([0.0] * 6 + [gain] * 12) for gain in (150.0, 4.0))  # the trunk has no motor
targets = np.tile(cycle.q, (PERIODS, 1))
path = scene.simulate(cycle.q[0], np.zeros(18), dt=PERIOD / STEPS, steps=len(targets), pd=phipsi.PD(kp, kd, stance), targets=targets)

speed = path.q[-1, 0] / path.t[-1]
print(f"trotted {path.q[-1, 0]:.2f} m in {path.t[-1]:.1f} s; height of the trunk {path.q[:, 2].min():.3f} to {path.q[:, 2].max():.3f} m")
assert 0.15 < speed < 0.35 and path.q[:, 2].min() > 0.24 and np.abs(path.q[:, 3:5]).max() < 0.1

if __name__ == "__main__":
    print("written:", scene.show(path, to="go2.html"))
