"""Sampling-based control of the bundled arm: MPPI (model predictive path integral) with batched simulations.

Run it with phipsi and numpy:

    python -m phipsi.examples mppi

Each cycle draws perturbed torque plans, simulates all of them from the present state in one call of Scene.simulate,
and computes the mean of the plans with weights exp(-cost

temperature) (G. Williams, A. Aldrich and E. Theodorou, J. Guidance Control and Dynamics 40, 2017, 344-357). The first
torques of the mean are applied for one cycle; the rest of the plan is the initial guess of the next one. Task: move
the flange to a point and stop there. The plan is relative to the gravity torque, which is known.
"""

import argparse
import time

import numpy as np
import phipsi

arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
arguments.add_argument("--samples", type=int, default=512, help="plans a cycle")
arguments.add_argument("--cycles", type=int, default=150)
arguments.add_argument("--seed", type=int, default=1)
options = arguments.parse_args()

DT, HOLD, KNOTS = 0.004, 5, 12  # s; number of steps per torque; number of torques in a plan
SPREAD = np.array([25.0, 35.0, 20.0, 3.0, 3.0, 1.0])  # N m, standard deviation of the perturbations
TEMPERATURE = 0.02

scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
random = np.random.default_rng(options.seed)
tip = scene.link_names[-1]
place = lambda q: scene.placements(q)[tip][..., :3, 3]  # noqa: E731

goal = place(np.array([0.9, -0.6, 0.5, 0.0, 0.4, 0.0]))
q, qd = scene.neutral(), np.zeros(scene.nv)
plan = np.zeros((KNOTS, scene.nv))


def rolled_out(q, qd, torques):
    """States after every torque of many plans: q, qd (samples, KNOTS, nv)."""
    path = scene.simulate(
        q, qd, dt=DT, steps=KNOTS * HOLD, tau_steps=np.repeat(torques, HOLD, axis=1), method="implicit-euler", record_every=HOLD
    )
    return path.q[:, 1:], path.qd[:, 1:]


def cost(q, qd, change):
    """Cost of each plan: distance from the goal, speed near it, and torque beyond the gravity torque."""
    distance = np.linalg.norm(place(q) - goal, axis=-1)
    speed = (qd**2).sum(axis=-1)
    along = (distance + 0.02 * speed / (1 + 25 * distance)).mean(axis=-1)
    return along + distance[:, -1] + 1e-3 * ((change / SPREAD) ** 2).mean(axis=(-1, -2))


start, states = time.perf_counter(), 0
print(f"flange {np.linalg.norm(place(q) - goal):.3f} m from its goal; {options.samples} plans of {KNOTS * HOLD} steps a cycle")
for cycle in range(options.cycles):
    holding = scene.bias_torque(q, np.zeros(scene.nv))
    tried = plan + random.normal(size=(options.samples, KNOTS, scene.nv)) * SPREAD
    tried[0] = plan
    tried = np.clip(holding + tried, -scene.limits.effort, scene.limits.effort) - holding
    costs = cost(*rolled_out(q, qd, holding + tried), tried)
    weights = np.exp(-(costs - costs.min()) / TEMPERATURE)
    plan = np.tensordot(weights / weights.sum(), tried, axes=1)
    states += options.samples * KNOTS * HOLD

    moved = scene.simulate(q, qd, dt=DT / 4, steps=4 * HOLD, tau=holding + plan[0], method="rosenbrock-2", record_every=4 * HOLD)
    q, qd = moved.q[-1], moved.qd[-1]
    plan = np.concatenate([plan[1:], np.zeros((1, scene.nv))])
    if cycle % 25 == 24:
        distance, speed = np.linalg.norm(place(q) - goal), np.abs(qd).max()
        print(f"t = {(cycle + 1) * HOLD * DT:4.2f} s: {distance:.4f} m from the goal, fastest joint {speed:.3f} rad/s")

elapsed = time.perf_counter() - start
print(f"{states / elapsed / 1e3:.0f} thousand states per second, {options.cycles / elapsed:.0f} cycles per second")
