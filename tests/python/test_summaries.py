"""Short texts of results: shapes, counts and errors, and no arrays."""

from __future__ import annotations

import re

import numpy as np
import phipsi
import pytest

SCENE = phipsi.scenes.chain(3)
ZERO = np.zeros(3)
RANDOM = np.random.default_rng(0).normal(size=(3, 40, 3))
TARGET = phipsi.tasks.Position("link2", np.stack([SCENE.placement([0.3, 0.2, 0.1], "link2")[:3, 3], [9.0, 0.0, 0.0]]))


def plan() -> phipsi.control.MotionPlan:
    return SCENE.optimize(ZERO, dt=0.01, steps=5, costs=phipsi.control.Effort(1.0))


RESULTS = {
    "trajectory": lambda: SCENE.simulate(RANDOM[0], ZERO, dt=1e-3, steps=5),
    "energy": lambda: SCENE.simulate(ZERO, ZERO, dt=1e-3, steps=5).energy_audit(),
    "info": lambda: SCENE.forward_dynamics(RANDOM[0], ZERO, ZERO, return_info=True)[1],
    "derivatives": lambda: SCENE.forward_dynamics_derivatives(*RANDOM),
    "gradients": lambda: SCENE.forward_dynamics_vjp(*RANDOM, ZERO),
    "linear": lambda: SCENE.linearize(*RANDOM),
    "inverse kinematics": lambda: SCENE.inverse_kinematics(TARGET),
    "estimate": lambda: SCENE.estimate(ZERO, ZERO, ZERO),
    "identification": lambda: SCENE.identify(*RANDOM, SCENE.inverse_dynamics(*RANDOM), noise=0.1),
    "smoothed": lambda: phipsi.smooth(np.arange(40) * 0.01, RANDOM[0]),
    "plan": plan,
    "expected": lambda: plan().expected(phipsi.estimation.MotionUncertainty(torque_noise=1e-3)),
    "regulator": lambda: phipsi.control.lqr(-np.eye(2), np.eye(2), np.ones(2), np.ones(2)),
    "comparison": lambda: phipsi.compare(SCENE, SCENE.with_payload("link2", 1.0)),
}


@pytest.mark.filterwarnings("ignore::phipsi.errors.LogWarning")
@pytest.mark.parametrize("result", RESULTS)
def test_results_are_shown_in_one_line(result: str) -> None:
    shown = repr(RESULTS[result]())
    assert shown.startswith("<phipsi.") and shown.endswith(">") and "array" not in shown and "\n" not in shown and len(shown) < 300


def test_the_text_has_what_failed() -> None:
    shown = repr(RESULTS["inverse kinematics"]())
    assert "q (2, 3)" in shown and "reached 1 of 2" in shown and re.search(r"position_error up to 8[.\d]* m,", shown)
    assert repr(RESULTS["info"]()).startswith("<phipsi.Accuracy: form 40 covariance, error up to ")
    assert repr(RESULTS["comparison"]()).startswith("<phipsi.Comparison: 3 of properties, 0 of poses, ")
    with pytest.warns(phipsi.errors.BadStateWarning):
        bad = SCENE.forward_dynamics_derivatives([[np.nan] * 3], ZERO, ZERO, errors="nan")
    assert "dqdd_dq (1, 3, 3) with NaN" in repr(bad)
