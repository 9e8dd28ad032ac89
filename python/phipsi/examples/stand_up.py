"""A Unitree Go2 stands up on its four feet, by a plan of least effort and its feedback law (needs example-robot-data)."""

import time

import numpy as np
import phipsi
from phipsi import control, tasks
from phipsi.examples import robot

DT, STEPS = 0.02, 50  # s; steps of the plan
LOW, HIGH, RADIUS = 0.12, 0.3, 0.022  # m: of the trunk at the start and at the end; of a foot
FEET = ("FL", "FR", "RL", "RR")

free = phipsi.load(robot("go2_description/urdf/go2.urdf"), floating_base=True)
crouched = np.array([0, 0, LOW, 0, 0, 0, 1, *[0.0, 1.2, -2.6] * 4])  # position and quaternion of the trunk, then the joints
stance = [tasks.Position(f"{foot}_foot", [*free.placement(crouched, f"{foot}_foot")[:2, 3], RADIUS]) for foot in FEET]
crouched = free.inverse_kinematics([tasks.Pose("base", free.placement(crouched, "base")), *stance], crouched).q

# Feet that stay where they are are connections.
builder = free.to_builder()
for foot in FEET:
    builder.connect(foot, "point", f"{foot}_foot", other_xyz=free.placement(crouched, f"{foot}_foot")[:3, 3])
scene = builder.build()

# Torques that hold the crouched robot, on the feet that carry it.
rows = np.concatenate([free.jacobian(crouched, f"{foot}_foot", frame="local-world-aligned")[3:] for foot in FEET])
weight = free.gravity_torque(crouched)
hold = weight - rows.T @ np.linalg.lstsq(rows[:, :6].T, weight[:6], rcond=None)[0]

goal = free.placement(crouched, "base").copy()
goal[2, 3] = HIGH
costs: list[control.Term] = [
    control.Effort(10.0),
    control.State(velocity=1.0),
    control.Terminal(tasks.Pose("base", goal, position=0.005, rotation=0.02)),
    control.Terminal(control.State(velocity=0.1)),
]
begin = time.perf_counter()
plan = scene.optimize(crouched, dt=DT, steps=STEPS, costs=costs, tau=hold, limits=False)
print(f"{plan}, {1e3 * (time.perf_counter() - begin) / plan.iterations:.0f} ms per iteration")

# The law holds the robot on the plan, here from a trunk that moves at the start.
rates = scene.loops.project(crouched, np.r_[0.0, 0.1, 0.0, 0.2, 0.0, 0.0, np.zeros(12)]).qd
assert rates is not None
state, motion = (crouched, rates), [crouched]
for k in range(STEPS):
    moved = scene.simulate(*state, dt=DT / 4, steps=4, tau=plan.policy(k, *state))
    state = moved.q[-1], moved.qd[-1]
    motion.extend(moved.q[1:])
q, t = np.array(motion), DT / 4 * np.arange(4 * STEPS + 1)
print(f"height of the trunk: {q[-1, 2]:.3f} m, planned {plan.q[-1, 2]:.3f} m; largest torque {abs(plan.tau).max():.1f} N m")
assert abs(q[-1, 2] - HIGH) < 0.02 and abs(q[-1, 3:6]).max() < 0.05

if __name__ == "__main__":
    print("written:", scene.show(q, t=t, to="stand_up.html"))
