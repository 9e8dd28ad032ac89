"""What is known of one robot: how much is measured, the states that all sections share, and what they have found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from .. import _core
from .._core import Scene
from . import kinds
from .pipeline import Findings, Missing
from .states import Array, States, draw
from .structure import Tree, tree_of
from .text import plural
from .timing import BATCH, TURNS, Of

#: Unit roundoff by precision: the distance from 1 to the next number.
EPS = {"float64": float(np.finfo(np.float64).eps), "float32": float(np.finfo(np.float32).eps)}
PRECISIONS = tuple(EPS)
#: Beyond this many degrees of freedom nothing dense is built.
DENSE_CAP = 300
AUTO = _core.METHODS[0]
FORWARD = "scene.forward_dynamics(q, qd, tau)"


class Effort(NamedTuple):
    """How much is measured."""

    states: int
    residual_states: int
    repeats: int
    sizes: tuple[int, ...]
    growth_repeats: int

    @staticmethod
    def of(nv: int, quick: bool, count: int | None) -> Effort:
        """Enough for steady medians, or enough to look at."""
        # The composite matrices cost the cube of 6 nv.
        dense = 32 if nv <= 12 else 10 if nv <= 60 else 3
        if quick:
            number = count or 64
            return Effort(number, min(number, dense), 3, (10, 30, 100, 300, 1000, 3000, 10_000), 5)
        number = count or 400
        sizes = tuple(m * 10**k for k in range(1, 5) for m in (1, 2, 5)) + (100_000,)
        return Effort(number, min(number, 4 * dense), 5, sizes, 9)


@dataclass
class Report(Findings):
    """What was measured on one scene."""

    name: str
    source: str
    scene: Scene
    seed: int = 0
    count: int | None = None
    """Random states; None: as many as are usual."""
    warnings: Sequence[str] = ()

    @cached_property
    def effort(self) -> Effort:
        """How much is measured."""
        return Effort.of(self.scene.nv, self.quick, self.count)

    @cached_property
    def tree(self) -> Tree:
        """Links and joints."""
        return tree_of(self.scene)

    @cached_property
    def states(self) -> States:
        """The random states. Missing where nothing moves."""
        if self.scene.nv == 0:
            raise Missing("Nothing moves in this scene: it has no degree of freedom, so there is nothing to compute.")
        return draw(self.scene, self.tree, self.effort.states, self.seed)

    @cached_property
    def solvable(self) -> States:
        """The same where forward dynamics can be had at all of them; raises what it raises."""
        drawn = self.states
        self.scene.forward_dynamics(drawn.q, drawn.qd, drawn.tau)
        return drawn

    @cached_property
    def batch(self) -> kinds.Drawn:
        """BATCH of these, over and over if need be, to make states of every kind of: what calls are timed at."""
        q, qd, tau = (values[np.arange(BATCH) % len(self.solvable)] for values in self.solvable.arrays)
        return kinds.of(self.scene, q, qd, tau, np.random.default_rng((self.seed, 2)))

    @cached_property
    def conditions(self) -> Array:
        """cond(M), largest over smallest singular value, of each state. Missing for scenes too large for dense algebra."""
        self.needs_dense()
        return np.array([float(np.linalg.cond(self.scene.mass_matrix(one))) for one in self.states.q])

    def needs_dense(self) -> None:
        """Missing where nothing dense is built, or nothing moves."""
        if len(self.states) and self.scene.nv > DENSE_CAP:
            raise Missing(
                f"{self.scene.nv} degrees of freedom: nothing dense is built beyond {DENSE_CAP}, and this part compares with"
                " dense algebra."
            )

    @property
    def passed(self) -> bool:
        """Whether no residual is beyond its bound."""
        return not self.beyond

    @property
    def beyond(self) -> list[str]:
        """The identities whose residual is beyond its bound."""
        return [row.name for row in self.parts.get("residuals", ()) if not row.passed]

    def call(self, text: str = FORWARD, form: str | None = AUTO, *, batch: bool) -> Any:
        """The time of one call from Python, of one state or of a batch; None where it was not measured."""
        rows = (row for row in self.parts.get("calls", ()) if (row.of.call, row.of.form, row.of.batch > 1) == (text, form, batch))
        return next(rows, None)

    def accuracy(self, method: str, precision: str = "float64") -> Any:
        """The row of one method in one precision; None where there is none."""
        rows = (row for row in self.parts.get("accuracy", ()) if (row.method, row.precision) == (method, precision))
        return next(rows, None)

    def head(self) -> dict[str, Any]:
        """Whether all residuals hold, and of how many states."""
        effort = self.effort
        counts = {"count": effort.states, "for_residuals": effort.residual_states, "seed": self.seed, "quick": self.quick}
        return {"passed": self.passed, "states": counts}

    def provenance(self) -> list[tuple[str, str]]:
        """Machine, states and passes."""
        effort = self.effort
        passes = (
            f"5 rounds of {effort.repeats} over all states in Rust, {effort.growth_repeats} for growth; calls from Python"
            f" {TURNS[self.quick]} turns"
        )
        random = f"{plural(effort.states, 'state')}, seed {self.seed}{' (quick)' if self.quick else ''}"
        return [*super().provenance(), ("random states", random), ("passes timed", passes)]


def rust(call: str, form: str | None = None, states: str = kinds.RANDOM) -> Of:
    """A call in Rust, one state."""
    return Of("Rust", call, form, states)


def median(values: Array) -> float:
    """The median of the numbers that are finite; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def spread(values: Sequence[float]) -> float:
    """Largest over smallest: about 1 where the work of a body does not depend on how many there are."""
    return max(values) / min(values)
