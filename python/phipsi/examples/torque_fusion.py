"""Torque-sensor fusion on the bundled arm: six joints, two without torque sensors, noise of 0.5 N m in the other four.

Run it with phipsi and numpy:

    python -m phipsi.examples torque_fusion

The true torques have two sources. First, the model itself: accelerations drawn from N(a0, s M^-1) around the planned
ones; then the estimated standard deviations are correct. Second, a motion that is independent of the model: a plan
that is tracked with errors of 0.5 rad/s^2 in each joint, independent of its inertia. Then the standard deviations are
as accurate as the given prior, and the last two rows show the result without a plan, when the two joints are assumed
to move at constant speed.
"""

import numpy as np
import phipsi

SENSOR = 0.5  # N m, standard deviation
MISSING = ("joint2", "joint5")
INSTANTS = 4000

scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
measured = [name for name in scene.joint_names if name not in MISSING]
has_sensor = np.isin(scene.joint_names, measured)
random = np.random.default_rng(1987)

# The plan: each joint oscillates by 0.5 to 1 rad with a period of 3 to 6 s about the middle of its range.
t = np.linspace(0.0, 60.0, INSTANTS)[:, None]
amplitude, rate, phase = random.uniform([[0.5], [1.05], [0.0]], [[1.0], [2.1], [6.28]], (3, scene.nv))
middle = (scene.limits.lower + scene.limits.upper) / 2
q = middle + amplitude * np.sin(rate * t + phase)
qd = amplitude * rate * np.cos(rate * t + phase)
plan = -amplitude * rate**2 * np.sin(rate * t + phase)


def sense(torque):
    """Sensor readings; NaN without a sensor."""
    return np.where(has_sensor, torque + SENSOR * random.normal(size=torque.shape), np.nan)


def fuse(torque, s, prior=None):
    return scene.estimate(
        q, qd, torque, noise=SENSOR**2, measured=measured, prior_acceleration=prior, acceleration_variance=s, covariance=True
    )


def within(estimate, truth, joints, sigmas):
    """Percentage of the true torques within that many estimated standard deviations of the estimate."""
    off = np.abs(estimate.torque - truth)[:, joints]
    return 100.0 * np.mean(off <= sigmas * np.sqrt(estimate.torque_variance[:, joints]))


def error(estimate, truth, joints):
    """Root mean square error of the torques, N m."""
    return np.sqrt(np.mean((estimate.torque - truth)[:, joints] ** 2))


# 1. True torques from the model: around the planned ones with covariance s M.
s = 1.0  # (rad/s^2)^2 for one kg m^2
root = np.linalg.cholesky(scene.mass_matrix(q))
drawn = scene.inverse_dynamics(q, qd, plan) + np.sqrt(s) * (root @ random.normal(size=(INSTANTS, scene.nv, 1)))[..., 0]
seen = sense(drawn)
from_model = fuse(seen, s, plan)

print("One instant, truth drawn from the model (N m)")
print(f"{'joint':8}{'true':>9}{'measured':>10}{'estimate':>10}{'sigma':>8}")
for i, name in enumerate(scene.joint_names):
    said = f"{seen[0, i]:10.2f}" if has_sensor[i] else f"{'-':>10}"
    sigma = np.sqrt(from_model.torque_variance[0, i])
    print(f"{name:8}{drawn[0, i]:9.2f}{said}{from_model.torque[0, i]:10.2f}{sigma:8.2f}")

# 2. True torques from a motion: each joint deviates from its plan by 0.5 rad/s^2. The closest value in the model is
# s = 0.25 times a typical inertia: s M^-1 has one parameter, and six would be needed.
real = scene.inverse_dynamics(q, qd, plan + 0.5 * random.normal(size=plan.shape))
seen = sense(real)
matched = 0.25 * np.mean(1.0 / np.diagonal(scene.mass_matrix_inverse(q), axis1=-2, axis2=-1))
with_plan, as_if_locked, wide = fuse(seen, matched, plan), fuse(seen, matched), fuse(seen, 16 * matched)

print(f"\nOver {INSTANTS} instants: rms error (N m), and true torques within one and two claimed sigmas (68.3, 95.4 wanted)")
print(f"{'truth':8}{'prior':15}{'s':>5}  {'four with a sensor':23}{'joint2, without':23}joint5, without")
for truth, prior, variance, estimate, torque in (
    ("model", "plan", s, from_model, drawn),
    ("motion", "plan", matched, with_plan, real),
    ("motion", "none (locked)", matched, as_if_locked, real),
    ("motion", "none (locked)", 16 * matched, wide, real),
):
    line = f"{truth:8}{prior:15}{variance:5.2f}"
    for joints in (has_sensor, scene.v_index("joint2"), scene.v_index("joint5")):
        shares = " ".join(f"{within(estimate, torque, joints, k):5.1f}" for k in (1, 2))
        line += f"{error(estimate, torque, joints):7.3f} {shares} %  "
    print(line.rstrip())
