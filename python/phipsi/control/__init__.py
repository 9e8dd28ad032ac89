"""Optimal control: plans with feedback laws, model predictive control, constant and time-varying regulators.

>>> import phipsi
>>> from phipsi import control
>>> scene = phipsi.load(phipsi.BUNDLED_ARM)
>>> goal = control.Terminal(phipsi.tasks.Position("link6", (0.5, 0.1, 0.4)))
>>> plan = scene.optimize([0.1] * 6, dt=0.02, steps=50, costs=[control.Effort(10.0), goal])
>>> plan.converged
True
"""

from ._expected import Expected
from ._plan import Iteration, MotionPlan
from ._regulators import Regulator, lqr, tracking
from ._terms import During, Effort, EffortRate, Function, NotPositive, State, Term, Terminal

__all__ = [
    "During",
    "Effort",
    "EffortRate",
    "Expected",
    "Function",
    "Iteration",
    "NotPositive",
    "MotionPlan",
    "Regulator",
    "State",
    "Term",
    "Terminal",
    "lqr",
    "tracking",
]


def __dir__() -> list[str]:
    return __all__
