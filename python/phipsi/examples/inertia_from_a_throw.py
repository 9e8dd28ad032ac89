"""All ten inertial parameters of a tool from one throw: the force of the hand is measured, and a camera sees the flight (needs scipy)."""

import numpy as np
import phipsi
from scipy.optimize import least_squares

DT, STEPS, EVERY, THROWN = 2e-3, 300, 10, 75  # the hand acts for 75 steps; one image in 10 steps
START, REST = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]), np.zeros(6)
#: Points of the tool that the camera follows, m, and the error of their positions.
MARKERS, SIGMA = np.array([[0.18, 0.0, 0.01], [-0.05, 0.03, 0.02], [-0.05, -0.03, -0.02]]), 5e-4
LOWER = np.tril_indices(4)

# Force and moment of the hand at the handle in the frame of the tool, N and N m.
wrench = np.zeros((STEPS, 6))
wrench[:THROWN] = np.sin(np.pi * np.arange(THROWN) / THROWN)[:, None] * [4.0, 2.0, 36.0, 0.08, -0.3, 0.15]


def factor(given: np.ndarray) -> np.ndarray:
    """L with L L* = [[m, m c*], [m c, S]], where S is the integral of r r* over the mass: each body has such a factor."""
    entries = np.zeros((4, 4))
    entries[LOWER] = given
    return entries


def mass_distribution(given: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, center of mass c and inertia about it, from the entries of the factor."""
    moments = factor(given) @ factor(given).T
    mass, com = moments[0, 0], moments[0, 1:] / moments[0, 0]
    about_com = moments[1:, 1:] - mass * np.outer(com, com)
    return mass, com, np.trace(about_com) * np.eye(3) - about_com


def parameters(given: np.ndarray) -> np.ndarray:
    """The ten parameters: m, m c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the origin."""
    moments = factor(given) @ factor(given).T
    inertia = np.trace(moments[1:, 1:]) * np.eye(3) - moments[1:, 1:]
    return np.concatenate([moments[0], inertia[np.tril_indices(3)]])


def entries(mass: float, com: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """The entries of the factor."""
    moments = mass * np.outer([1, *com], [1, *com])
    moments[1:, 1:] += 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return np.linalg.cholesky(moments)[LOWER]


def throw(given: np.ndarray, steps: int) -> phipsi.Trajectory:
    mass, com, inertia = mass_distribution(given)
    scene = phipsi.SceneBuilder().link("tool", mass, com=com, inertia=inertia).build(floating_base=True)
    return scene.simulate(START, REST, dt=DT, steps=steps, tau_steps=wrench[:steps])


def seen(path: phipsi.Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """The markers in every image, (images, 3, 3), and their derivatives by position and rotation of the tool."""
    pose = path.scene.placement(path.q[EVERY::EVERY], "tool")[:, None]
    turn, place = pose[..., :3, :3], pose[..., :3, 3]
    turned = turn @ np.cross(np.eye(3), MARKERS[:, None]).swapaxes(-1, -2)
    points = (turn @ MARKERS[..., None])[..., 0] + place
    return points, np.concatenate([np.broadcast_to(turn, turned.shape), turned], axis=-1)


def residuals(given: np.ndarray, steps: int) -> np.ndarray:
    return ((seen(throw(given, steps))[0] - record[: steps // EVERY]) / SIGMA).ravel()


def by_parameters(given: np.ndarray, steps: int) -> np.ndarray:
    """Derivatives of all residuals by the ten parameters.

    A batch of equal states, one per residual, propagates the derivatives backward together.
    """
    path = throw(given, steps)
    by_pose = seen(path)[1] / SIGMA
    rows = np.zeros((*by_pose.shape[:-1], steps + 1, 6))
    for i, of_image in enumerate(by_pose):
        rows[i, :, :, EVERY * (i + 1)] = of_image
    of_run = {"dt": DT, "steps": steps, "tau_steps": wrench[:steps]}
    found = path.scene.simulate_vjp(path.q, path.qd, rows, np.zeros_like(rows), parameters=True, **of_run)
    assert found.parameters is not None
    return found.parameters[..., 0, :].reshape(-1, 10)


def slopes(given: np.ndarray, steps: int) -> np.ndarray:
    """Derivatives of all residuals by the entries of the factor, through I = tr(S) 1 - S."""
    by_all = by_parameters(given, steps)
    xx, xy, yy, xz, yz, zz = by_all[:, 4:].T
    by_moments = np.zeros((len(by_all), 4, 4))
    by_moments[:, 0, 0] = by_all[:, 0]
    by_moments[:, 0, 1:] = by_moments[:, 1:, 0] = 0.5 * by_all[:, 1:4]
    for i, own in ((1, yy + zz), (2, xx + zz), (3, xx + yy)):
        by_moments[:, i, i] = own
    for i, j, own in ((1, 2, xy), (1, 3, xz), (2, 3, yz)):
        by_moments[:, i, j] = by_moments[:, j, i] = -0.5 * own
    return (2 * by_moments @ factor(given))[:, LOWER[0], LOWER[1]]


# The throw that the camera records.
inertia = np.array([[1.1e-3, 1e-4, -3e-4], [1e-4, 4.6e-3, 5e-5], [-3e-4, 5e-5, 4.4e-3]])
true = (0.9, np.array([0.035, 0.004, 0.006]), inertia)
path = throw(entries(*true), STEPS)
record = seen(path)[0]
record += np.random.default_rng(3).normal(0, SIGMA, record.shape)

# The guess: a light rod whose center of mass is near its middle. It has to explain the first images, then all.
given = entries(0.7, np.array([0.06, 0, 0]), np.diag([1.5e-3, 7e-3, 7e-3]))
for steps, most in ((150, 50), (STEPS, 100)):
    found = least_squares(residuals, given, jac=slopes, x_scale="jac", args=(steps,), max_nfev=most)
    given = found.x
    print(f"{steps // EVERY} images: {found.nfev} simulations, mean square error {2 * found.cost / found.fun.size:.2f} sigma^2")

slope = by_parameters(given, STEPS)
deviation = np.sqrt(np.diag(np.linalg.inv(slope.T @ slope)))
found_ten, true_ten = parameters(given), parameters(entries(*true))
for name, value, spread, expected in zip("m mcx mcy mcz Ixx Ixy Iyy Ixz Iyz Izz".split(), found_ten, deviation, true_ten, strict=True):
    print(f"{name}: {value:.3g} +- {spread:.1g}, in the simulation of the record {expected:.3g}")
assert found.success and np.all(np.abs(found_ten - true_ten) < 4 * deviation) and deviation[0] < 1e-3

if __name__ == "__main__":
    print("written:", path.scene.show(path, to="inertia_from_a_throw.html"))
