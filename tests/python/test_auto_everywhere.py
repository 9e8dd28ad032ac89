"""Form `auto` has the same meaning in every call: on the extreme scenes each result is within its tolerance of 60
digits.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from oracle_mpmath import CONTEXT, State, derivative, exact, moved, rounded
from test_scenes import tree_of
from tolerances import accepted

from phipsi import scenes

CASES = {
    "heavy-tip": 1e9,
    "light-links": 1e-9,
    "alternating-masses": 1e-9,
    "growing-masses": 30.0,
    "massless-middle": 1e-12,
    "zero-inertia": 1e-9,
    "short-links": 1e-6,
    "near-coincident-axes": 1e-3,
    "needles": 1e-9,
    "armature": 1e6,
    "long-lever": 1e4,
}
DIRECTIONS = ("dq", "dqd", "dtau")
STEP = CONTEXT.mpf(10) ** -12
"""Step of second differences: of 60 digits, 24 are truncation error and 24 rounding error."""


class Case:
    """An extreme scene with a state, three directions and a cotangent, and the results with 60 digits."""

    def __init__(self, name: str, value: float) -> None:
        extreme = scenes.extreme(name, value)
        self.scene, self.state = extreme.scene, (extreme.q, extreme.qd, extreme.tau)
        self.tree, n = tree_of(extreme.scene), extreme.scene.nv
        random = np.random.default_rng(1)
        self.cotangent, *directions = random.normal(size=(4, n))
        self.directions = dict(zip(DIRECTIONS, directions, strict=True))
        at_state = State(self.tree, extreme.q, extreme.qd)
        self.inverse = at_state.inverse
        self.jacobian = at_state.jacobian(self.scene.link_names[-1])

    def accelerations(self, along: dict[str, object]) -> np.ndarray:
        """Results of the state moved along each direction by that step."""
        q, qd, tau = (exact(x) for x in self.state)
        steps = {name: exact(self.directions[name]) * along.get(name, 0) for name in DIRECTIONS}
        state = State(self.tree, moved(self.tree, q, steps["dq"], 1), qd + steps["dqd"])
        return state.forward_dynamics(tau + steps["dtau"], {})

    @functools.cache
    def along(self, name: str) -> np.ndarray:
        return derivative(lambda h: self.accelerations({name: h}))

    @functools.cache
    def twice(self, name: str) -> object:
        """Second derivative of cotangent . qdd, along a direction and along all three."""

        def change(h: object, k: object) -> object:
            return exact(self.cotangent) @ self.accelerations({other: h * (other == name) + k for other in DIRECTIONS})

        return (change(STEP, STEP) - change(STEP, -STEP) - change(-STEP, STEP) + change(-STEP, -STEP)) / (4 * STEP * STEP)

    def seeds(self, name: str) -> tuple[np.ndarray, ...]:
        """The given direction only."""
        return tuple(self.directions[other] * (other == name) for other in DIRECTIONS)


@functools.cache
def case_of(name: str) -> Case:
    return Case(name, CASES[name])


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return case_of(request.param)


def assert_accepted(found: object, expected: object, size: float | None = None) -> None:
    """Within the tolerance of `auto`, relative to the largest entry or to a scale."""
    expected = np.asarray(expected, dtype=object)
    size = float(np.max(np.abs(rounded(expected)))) if size is None else size
    off = float(np.max(np.abs(rounded(exact(np.asarray(found)) - expected))))
    assert off <= accepted(size), f"{off / size:.1e} of the largest entry"


@pytest.mark.parametrize("name", DIRECTIONS)
def test_products_along_one_direction(case: Case, name: str) -> None:
    assert_accepted(case.scene.forward_dynamics_jvp(*case.state, *case.seeds(name)), case.along(name))


def test_gradients(case: Case) -> None:
    found = case.scene.forward_dynamics_vjp(*case.state, case.cotangent)
    for name, gradient in zip(DIRECTIONS, (found.q, found.qd, found.tau), strict=True):
        direction = case.directions[name]
        expected = exact(case.cotangent) @ case.along(name)
        assert_accepted(gradient @ direction, expected, float(np.max(np.abs(gradient)) * np.sum(np.abs(direction))))


def test_matrices(case: Case) -> None:
    found = case.scene.forward_dynamics_derivatives(*case.state)
    for name, matrix in zip(DIRECTIONS, found, strict=True):
        direction = case.directions[name]
        assert_accepted(matrix @ direction, case.along(name), float(np.max(np.abs(matrix)) * np.sum(np.abs(direction))))
    assert_accepted(found.mass_matrix_inverse, case.inverse)


def test_hessians(case: Case) -> None:
    found = case.scene.forward_dynamics_hvp(*case.state, case.cotangent, *case.directions.values())
    for name, change in zip(DIRECTIONS, (found.q, found.qd, found.tau), strict=True):
        direction = case.directions[name]
        size = float(np.max(np.abs(change)) * np.sum(np.abs(direction)))
        assert_accepted(change @ direction, case.twice(name), size)


def test_the_inverse_mass_matrix_and_the_factor(case: Case) -> None:
    q, right = case.state[0], case.cotangent
    assert_accepted(case.scene.mass_matrix_inverse(q), case.inverse)
    assert_accepted(case.scene.factor(q).solve(right), case.inverse @ exact(right))


def test_operational_space(case: Case) -> None:
    expected = case.jacobian @ case.inverse @ case.jacobian.T
    assert_accepted(case.scene.operational_inverse_inertia(case.state[0], case.scene.link_names[-1]), expected)
