"""An arm follows a moving target by model predictive control: at every step it plans the next 0.4 s again, in one iteration."""

import time

import numpy as np
import phipsi
from phipsi import control, tasks

DT, STEPS, RUN = 0.02, 20, 250  # s; steps of a plan; steps of the run

scene = phipsi.load(phipsi.BUNDLED_ARM)


def target(t: float) -> np.ndarray:
    """Position of the target, m."""
    return np.array([0.5, 0.1 + 0.15 * np.sin(2.0 * t), 0.4 + 0.1 * np.cos(2.0 * t)])


def costs(t: float) -> list[control.Term]:
    """The hand at the target within 2 cm costs as much as 20 N m or 1 rad/s."""
    goal = tasks.Position("link6", np.stack([target(t + DT * k) for k in range(STEPS)]), position=0.02)
    end = tasks.Position("link6", target(t + DT * STEPS), position=0.02)
    return [control.Effort(20.0), control.State(velocity=1.0), goal, control.Terminal(end)]


plan = scene.optimize(np.full(6, 0.1), dt=DT, steps=STEPS, costs=costs(0.0))
state, motion, times = (plan.q[0], plan.qd[0]), [plan.q[0]], []
for step in range(RUN):
    moved = scene.simulate(*state, dt=DT, steps=1, tau=plan.policy(0, *state))
    state = moved.q[-1], moved.qd[-1]
    motion.append(state[0])
    begin = time.perf_counter()
    plan = plan.resume(*state, costs=costs(DT * (step + 1)))
    times.append(time.perf_counter() - begin)

q, t = np.array(motion), DT * np.arange(RUN + 1)
distance = np.linalg.norm(scene.placement(q, "link6")[:, :3, 3] - np.array([target(of) for of in t]), axis=1)
print(f"distance from the target after 1 s: {1e3 * np.median(distance[50:]):.0f} mm; {1e-3 / np.median(times):.1f} kHz")
assert np.median(distance[50:]) < 0.03

if __name__ == "__main__":
    print("written:", scene.show(q, t=t, to="follow.html"))
