"""Estimation compared with the joint Gaussian of (X, W, T, a, y) conditioned on y with NumPy, with 60 digits, and by
sampling.
"""

from __future__ import annotations

import functools
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import phipsi
import pytest
from conftest import KINDS, random_scene, random_states
from oracle_mpmath import CONTEXT, State, exact, random_tree, rounded, skew
from tolerances import assert_near, assert_same_bits, inverse, product, sampling

MEANS = ("acceleration", "torque", "force", "process")
COVARIANCES = ("acceleration_variance", "torque_variance", "force_covariance", "process_covariance")
SEEDS = range(12)
ROOT = Path(__file__).parents[2]


class Case:
    """A scene with all types of joints, a state, and torques measured with zero, finite and infinite noise."""

    def __init__(self, seed: int, noises: str = "mixed") -> None:
        random = np.random.default_rng(100 + seed)
        kinds = tuple(np.roll(KINDS, seed))[:6]
        self.has_armature = seed % 2 == 1
        self.scene = random_scene(
            seed, 5, kinds=kinds, branching=0.0 if seed % 3 == 0 else 0.5, armature=0.3 * self.has_armature,
            floating_base=seed % 4 == 3,
        )  # fmt: skip
        n = self.scene.nv
        self.q, self.qd, self.y = random_states(self.scene, seed)
        self.s = float(random.choice([0.25, 1.0, 30.0]))
        levels = {"mixed": [0.0, 0.5, 20.0, np.inf], "none": [np.inf], "exact": [0.0]}[noises]
        self.noise = np.array([levels[i % len(levels)] for i in random.permutation(n)])
        self.prior = random.uniform(-3.0, 3.0, n) if seed % 3 else None
        self.wrenches = {link: random.uniform(-3.0, 3.0, 6) for link in self.scene.link_names[::2]} if seed % 2 else None

    def estimate(self, **replaced: Any) -> phipsi.Estimate:
        keywords = {
            "noise": self.noise, "prior_acceleration": self.prior, "acceleration_variance": self.s,
            "wrenches": self.wrenches, "covariance": True,
        }  # fmt: skip
        return self.scene.estimate(self.q, self.qd, self.y, **(keywords | replaced))

    @functools.cached_property
    def a0(self) -> np.ndarray:
        return np.zeros(self.scene.nv) if self.prior is None else self.prior

    @functools.cached_property
    def matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """phi, Q, H, r, M from their definitions."""
        factor, m = self.scene.factor(self.q), self.scene.mass_matrix(self.q)
        phi, noise, h = factor.phi.toarray(), factor.Q.toarray(), factor.H.toarray()
        armature = np.diag(m - h @ phi @ noise @ phi.T @ h.T) if self.has_armature else np.zeros(len(m))
        return phi, noise, h, armature, m

    @functools.cached_property
    def bias(self) -> np.ndarray:
        """b of every row; its value is tested with 60 digits below."""
        return self.estimate(measured=[], prior_acceleration=None).process.reshape(-1)

    def model(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Map from (W, v) to (X, W, T, a), and mean and covariance of (W, v)."""
        phi, noise, h, armature, m = self.matrices
        n = len(m)
        to_torque = np.hstack([h @ phi, np.eye(n)])
        through = np.vstack(
            [
                np.hstack([phi, np.zeros((6 * n, n))]),
                np.hstack([np.eye(6 * n), np.zeros((6 * n, n))]),
                to_torque,
                np.linalg.solve(m, to_torque),
            ]
        )
        mean = np.concatenate([self.bias + noise @ (phi.T @ (h.T @ self.a0)), armature * self.a0])
        covariance = np.zeros((7 * n, 7 * n))
        covariance[: 6 * n, : 6 * n] = self.s * noise
        covariance[6 * n :, 6 * n :] = np.diag(self.s * armature)
        return through, mean, covariance

    def conditional(self) -> tuple[np.ndarray, np.ndarray, float, np.ndarray, np.ndarray, float]:
        """Means and covariance of (X, W, T, a) given y, log density of y, the magnitudes of both, and the condition
        number.
        """
        m = self.matrices[-1]
        n = len(m)
        through, mean, covariance = self.model()
        z, prior = through @ mean, through @ covariance @ through.T
        # a = M^-1 (T - H phi b): the bias is known and causes no acceleration.
        z[13 * n :] = through[13 * n :] @ (mean - np.concatenate([self.bias, np.zeros(n)]))
        measured = np.flatnonzero(np.isfinite(self.noise))
        at = 12 * n + measured
        variance = prior[np.ix_(at, at)] + np.diag(self.noise[measured])
        off = self.y[measured] - z[at]
        weighted = np.linalg.solve(variance, off)
        gain = np.linalg.solve(variance, prior[at]).T
        density = -0.5 * (off @ weighted + np.linalg.slogdet(2.0 * np.pi * variance)[1])
        conditions = [np.linalg.cond(m), np.linalg.cond(variance) if len(at) else 1.0]
        sizes = np.abs(z) + np.abs(prior[:, at]) @ np.abs(weighted)
        return z + prior[:, at] @ weighted, prior - gain @ prior[at], density, sizes, np.abs(prior), max(conditions)


@functools.cache
def case_of(seed: int, noises: str = "mixed") -> Case:
    return Case(seed, noises)


@pytest.fixture(params=SEEDS)
def case(request: pytest.FixtureRequest) -> Case:
    return case_of(request.param)


def blocks(matrix: np.ndarray) -> np.ndarray:
    """The 6 x 6 diagonal blocks."""
    n = len(matrix) // 6
    return np.stack([matrix[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i in range(n)])


def test_the_cases_cover_everything() -> None:
    cases = [case_of(seed) for seed in SEEDS]
    assert any("root_joint" in case.scene.joint_names for case in cases)
    text = " ".join(repr(case.scene) for case in cases)
    assert all(kind in text for kind in KINDS if kind not in ("fixed", "continuous"))
    assert {(case.prior is None, case.wrenches is None) for case in cases} == {(a, b) for a in (0, 1) for b in (0, 1)}
    for case in cases:
        assert {0.0, np.inf} < set(case.noise)


@pytest.mark.parametrize("noises", ["mixed", "none", "exact"])
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("method", ["sequential", "batch"])
def test_it_is_the_conditional_gaussian(seed: int, noises: str, method: str) -> None:
    case = case_of(seed, noises)
    n = case.scene.nv
    found = case.estimate(method=method)
    means, covariance, density, sizes, prior, condition = case.conditional()
    split = np.split(np.arange(14 * n), [6 * n, 12 * n, 13 * n])
    parts = dict(zip(("force", "process", "torque", "acceleration"), split, strict=True))
    for name in MEANS:
        at = parts[name]
        scale = float(np.max(sizes[at], initial=0.0))
        assert_near(getattr(found, name).reshape(-1), means[at], inverse(condition, scale))
    for name, part in zip(COVARIANCES, ("acceleration", "torque", "force", "process"), strict=True):
        at = parts[part]
        expected = covariance[np.ix_(at, at)]
        expected = blocks(expected) if len(at) == 6 * n else np.diag(expected)
        assert_near(getattr(found, name), expected, inverse(condition, float(prior[np.ix_(at, at)].max())))
    assert_near(found.log_likelihood, density, inverse(condition, 1.0 + abs(density)))
    assert max(float(np.abs(getattr(found, name)).max()) for name in ("acceleration", "torque", "force")) > 0.0


def test_batch_is_sequential(case: Case) -> None:
    one, other = case.estimate(), case.estimate(method="batch")
    condition = case.conditional()[-1]
    sizes = {name: float(np.abs(getattr(case.estimate(measured=[]), name)).max()) for name in (*MEANS, *COVARIANCES)}
    for name in (*MEANS, *COVARIANCES):
        found, expected = getattr(one, name), getattr(other, name)
        assert_near(found, expected, inverse(condition, max(sizes[name], float(np.abs(expected).max()))))
    assert_near(one.log_likelihood, other.log_likelihood, inverse(condition, 1.0 + abs(other.log_likelihood)))


def test_the_parts_belong_together(case: Case) -> None:
    """X = phi W, T = H X + r a, and E(T|y) is inverse dynamics at E(a|y)."""
    found = case.estimate()
    phi, _, h, armature, m = case.matrices
    n, force, process = case.scene.nv, found.force.reshape(-1), found.process.reshape(-1)
    size = float(np.max(np.abs(phi) @ np.abs(process)))
    assert_near(force, phi @ process, product(6 * n, size))
    reached = h @ force + armature * found.acceleration
    assert_near(found.torque, reached, inverse(float(np.linalg.cond(m)), size))
    torque = case.scene.inverse_dynamics(case.q, case.qd, found.acceleration, wrenches=case.wrenches)
    assert_near(found.torque, torque, product(6 * n, size))


@pytest.mark.parametrize("seed", SEEDS)
def test_all_measured_exactly_is_forward_dynamics(seed: int) -> None:
    case = case_of(seed, "exact")
    found = case.estimate(prior_acceleration=None)
    expected = case.scene.forward_dynamics(case.q, case.qd, case.y, wrenches=case.wrenches)
    assert np.all(found.acceleration_variance == 0.0) and np.all(found.torque_variance == 0.0)
    condition = float(np.linalg.cond(case.scene.mass_matrix(case.q)))
    assert_near(found.acceleration, expected, inverse(condition, float(np.abs(expected).max())))
    assert_near(found.torque, case.y, inverse(condition, float(np.abs(found.force).max() + np.abs(case.y).max())))
    # Independent of the prior.
    again = case.estimate(prior_acceleration=np.full(case.scene.nv, 2.0))
    scale = float(np.max(sum(np.abs(e.acceleration) for e in (again, found)))) + 2.0
    assert_near(again.acceleration, found.acceleration, inverse(condition, scale))


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_measured_is_the_prior(seed: int) -> None:
    case = case_of(seed, "none")
    found = case.estimate()
    phi, noise, _, _, m = case.matrices
    n, s = case.scene.nv, case.s
    assert np.all(found.acceleration == case.a0)
    torque = case.scene.inverse_dynamics(case.q, case.qd, case.a0, wrenches=case.wrenches)
    r = phi @ noise @ phi.T
    size = float(np.max(np.abs(phi) @ np.abs(found.process.reshape(-1))))
    assert_near(found.torque, torque, product(6 * n, size))
    condition = float(np.linalg.cond(m))
    inverse_of = np.diag(np.linalg.inv(m))
    assert_near(found.acceleration_variance, s * inverse_of, inverse(condition, s * float(inverse_of.max())))
    assert_near(found.torque_variance, s * np.diag(m), product(6 * n, s * float(np.abs(r).max())))
    assert_near(found.force_covariance, s * blocks(r), product(6 * n, s * float(np.abs(r).max())))
    assert_near(found.process_covariance, s * blocks(noise), product(6, s * float(np.abs(noise).max())))
    assert found.log_likelihood == 0.0


def test_an_unmeasured_acceleration_keeps_its_prior(case: Case) -> None:
    found, prior = case.estimate(), case.estimate(measured=[])
    unknown = np.isinf(case.noise)
    assert np.all(found.acceleration[unknown] == case.a0[unknown])
    assert np.all(found.acceleration_variance[unknown] == prior.acceleration_variance[unknown])
    # Information about its torque, by contrast, is available, and about the others.
    assert np.any(found.torque[unknown] != prior.torque[unknown])
    assert np.all(found.torque_variance <= prior.torque_variance)
    assert np.any(found.torque_variance[unknown] < 0.999 * prior.torque_variance[unknown])
    assert np.all(found.torque_variance[unknown] > 0.0)


@pytest.mark.parametrize("seed", range(0, 12, 2))
def test_h_p_is_zero(seed: int) -> None:
    """H P = 0 (after 2.6): exactly if H selects a component, up to rounding for a screw."""
    case = case_of(seed)
    assert not case.has_armature
    found = case.estimate()
    h = case.matrices[2]
    screws = 0
    for row in np.flatnonzero(case.noise == 0.0):
        along = h[row, 6 * row : 6 * row + 6]
        missed = along @ found.force_covariance[row]
        if np.count_nonzero(along) == 1:
            assert np.all(missed == 0.0)
            assert np.all(found.force_covariance[row] @ along == 0.0)
        else:
            screws += 1
            assert_near(missed, np.zeros(6), inverse(case.conditional()[-1], case.s * 10.0))
        assert np.abs(found.force_covariance[row]).max() > 0.0
    noisy = np.flatnonzero(case.noise > 0.0)
    assert all(np.any(h[i, 6 * i : 6 * i + 6] @ found.force_covariance[i] != 0.0) for i in noisy)


def test_noise_and_variance_in_other_units(case: Case) -> None:
    """Both times 4: the means are bitwise equal, covariances are 4 times as large."""
    one, other = case.estimate(), case.estimate(noise=4.0 * case.noise, acceleration_variance=4.0 * case.s)
    for name in MEANS:
        assert_same_bits(getattr(other, name), getattr(one, name), name)
    for name in COVARIANCES:
        assert_same_bits(getattr(other, name), 4.0 * getattr(one, name), name)


@pytest.mark.parametrize("noise", [1e-9, 1e-3, 1.0, 1e6, 1e12])
def test_variances_over_all_sizes_of_noise(noise: float) -> None:
    """The variance of a torque is that of the sensor or of the model, whichever is smaller, with the full relative
    precision of the smaller one.
    """
    for seed in (0, 1, 3):
        case = case_of(seed)
        n = case.scene.nv
        found = case.estimate(noise=noise)
        phi, _, h, armature, m = case.matrices
        told = np.linalg.inv(case.s * m + noise * np.eye(n))
        # noise s M (s M + noise)^-1, without a difference.
        expected = np.diag(noise * case.s * m @ told)
        condition = float(np.linalg.cond(case.s * m + noise * np.eye(n)) * np.linalg.cond(m))
        bound = inverse(condition, float(min(noise, case.s * np.abs(phi).max() ** 2 * np.abs(m).max())))
        assert_near(found.torque_variance, expected, bound)
        assert np.all(found.torque_variance > 0.0)


def draws(case: Case, samples: int) -> tuple[np.ndarray, ...]:
    """Samples of (X, W, T, a, y) from the model: W = mean + sqrt(s) L e with L L^T = Q."""
    random = np.random.default_rng(7)
    phi, _, h, armature, m = case.matrices
    n = case.scene.nv
    _, mean, covariance = case.model()
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    both = mean + random.normal(size=(samples, 7 * n)) @ root.T
    w, v = both[:, : 6 * n], both[:, 6 * n :]
    x = w @ phi.T
    torque = x @ h.T + v
    a = np.linalg.solve(m, (torque - h @ (phi @ case.bias)).T).T
    finite = np.where(np.isfinite(case.noise), case.noise, 0.0)
    y = torque + np.sqrt(finite) * random.normal(size=(samples, n))
    return x, w, torque, a, np.where(np.isfinite(case.noise), y, np.nan)


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_errors_have_the_covariance_that_is_claimed(seed: int) -> None:
    case, samples = case_of(seed), 4000
    n = case.scene.nv
    x, w, torque, a, y = draws(case, samples)
    found = case.scene.estimate(
        case.q, case.qd, y, noise=case.noise, prior_acceleration=case.prior, acceleration_variance=case.s,
        wrenches=case.wrenches,
    )  # fmt: skip
    claimed = case.estimate()
    errors = {
        "acceleration_variance": (found.acceleration - a)[..., None],
        "torque_variance": (found.torque - torque)[..., None],
        "force_covariance": found.force - x.reshape(samples, n, 6),
        "process_covariance": found.process - w.reshape(samples, n, 6),
    }
    for name, error in errors.items():
        covariance = np.asarray(getattr(claimed, name)).reshape(n, error.shape[-1], -1)
        seen = np.einsum("kni,knj->nij", error, error) / samples
        variances = np.einsum("nii->ni", covariance)
        # Rounding is visible if a variance is zero: the square root in the samples has eigenvalues of rounding
        # magnitude.
        floor = 10.0 * inverse(case.conditional()[-1], float(np.abs(getattr(found, name.split("_")[0])).max()))
        spread = np.sqrt(np.abs(variances[:, :, None] * variances[:, None, :]) + covariance**2)
        off = np.abs(seen - covariance)
        assert np.all(off <= sampling(samples, spread) + floor * (floor + np.sqrt(np.abs(variances).max()))), name
        mean = np.abs(error.mean(axis=0))
        assert np.all(mean <= sampling(samples, np.sqrt(np.abs(variances))) + floor), name
        assert np.abs(covariance).max() > 0.0


@pytest.mark.parametrize("seed", [1, 2, 4, 9])
def test_against_sixty_digits(seed: int) -> None:
    """Joint space from M and the Newton-Euler bias; forces by their magnitudes, which are independent of the frame."""
    random = np.random.default_rng(seed)
    tree = random_tree(
        random, 6, armature=0.3 * (seed % 2), branching=0.5, floating_base=seed == 4,
        kinds=("revolute", "prismatic", "continuous", "screw", "planar", "spherical"),
    )  # fmt: skip
    scene = tree.scene()
    n = scene.nv
    q, qd, y = random_states(scene, seed)
    a0, s = random.uniform(-2.0, 2.0, n), 3.0
    noise = np.array([[0.0, 0.5, np.inf][i % 3] for i in random.permutation(n)])
    found = scene.estimate(q, qd, y, noise=noise, prior_acceleration=a0, acceleration_variance=s, covariance=True)

    state = State(tree, q, qd)
    m, inverse_of = state.mass_matrix, state.inverse
    prior = state.inverse_dynamics(a0, {})
    rows = [i for i in range(n) if np.isfinite(noise[i])]
    variance = CONTEXT.matrix([[s * m[i, j] + (CONTEXT.mpf(noise[i]) if i == j else 0) for j in rows] for i in rows])
    told = np.array((variance**-1).tolist(), dtype=object).reshape(len(rows), len(rows))
    weighted = told @ (exact(y)[rows] - prior[rows])
    a = exact(a0)
    a[rows] += s * weighted
    torque = prior + s * (m[:, rows] @ weighted)
    of_torque = np.array([s * m[i, i] - s * s * (m[i, rows] @ told @ m[rows, i]) for i in range(n)])
    of_a = np.array([s * inverse_of[i, i] for i in range(n)])
    of_a[rows] -= s * s * np.diag(told)
    density = -(weighted @ (exact(y)[rows] - prior[rows]) + CONTEXT.log(CONTEXT.det(2 * CONTEXT.pi * variance))) / 2

    condition = float(np.linalg.cond(rounded(m)))
    for name, expected, scale in (
        ("acceleration", a, np.abs(rounded(a)).max()),
        ("torque", torque, np.abs(found.force).max()),
        ("torque_variance", of_torque, s * np.abs(found.force_covariance).max() + s * np.abs(rounded(m)).max()),
        ("acceleration_variance", of_a, s * rounded(np.diag(inverse_of)).max()),
        ("log_likelihood", density, 1.0 + abs(float(density))),
    ):
        off = rounded(exact(np.atleast_1d(getattr(found, name))) - np.atleast_1d(expected))
        assert np.all(np.abs(off) <= inverse(condition, float(scale))), name

    # Newton-Euler for each link at the estimated accelerations, summed over the links outboard of each joint.
    wrench = {}
    for link in state.links:
        mass, lever, central, _ = state._inertia(link)
        name = link.name
        omega, alpha = state.angular[name] @ state.qd, state.angular_bias[name] + state.angular[name] @ a
        origin = state.linear_bias[name] + state.linear[name] @ a
        center = origin + skew(alpha) @ lever + skew(omega) @ (skew(omega) @ lever)
        force = mass * (center - state.gravity)
        wrench[name] = (central @ alpha + skew(omega) @ (central @ omega), force, state.position[name] + lever)

    def outboard(link: str) -> list[str]:
        return [link] + [below for joint in tree.order if joint.parent == link for below in outboard(joint.child)]

    for joint in tree.order:
        if joint.nv == 0:
            continue
        at = state.position[joint.child]
        moving = [wrench[link] for link in outboard(joint.child)]
        force = sum((f for _, f, _ in moving), exact(np.zeros(3)))
        moment = sum((t + skew(p - at) @ f for t, f, p in moving), exact(np.zeros(3)))
        block = found.force[scene.v_index(joint.name).stop - 1]
        for part, expected in ((block[:3], moment), (block[3:], force)):
            bound = inverse(condition, float(np.abs(found.force).max()))
            assert abs(np.linalg.norm(part) - float(CONTEXT.sqrt(expected @ expected))) <= bound
        own, (turn, push, point) = found.process[scene.v_index(joint.name).stop - 1], wrench[joint.child]
        turn = turn + skew(point - at) @ push
        if [below for below in tree.order if below.parent == joint.child and below.nv == 0]:
            continue
        for part, expected in ((own[:3], turn), (own[3:], push)):
            bound = inverse(condition, float(np.abs(found.force).max()))
            assert abs(np.linalg.norm(part) - float(CONTEXT.sqrt(expected @ expected))) <= bound


def test_the_page_shows_what_the_example_prints(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(ROOT / "python" / "phipsi" / "examples" / "torque_fusion.py"))
    printed = capsys.readouterr().out
    assert len(printed.splitlines()) == 15
    assert printed in (ROOT / "docs" / "estimation.md").read_text(encoding="utf-8")
