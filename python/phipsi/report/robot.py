"""Report on one robot: extent of the measurement, common states of all sections, and results."""

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

#: Machine epsilon: the distance from 1 to the next number.
EPS = float(np.finfo(np.float64).eps)
#: Largest number of degrees of freedom for which dense matrices are formed.
DENSE_CAP = 300
AUTO = _core.METHODS[0]
FORWARD = "scene.forward_dynamics(q, qd, tau)"


class Effort(NamedTuple):
    """Extent of the measurement."""

    states: int
    residual_states: int
    repeats: int
    sizes: tuple[int, ...]
    growth_repeats: int

    @staticmethod
    def of(nv: int, quick: bool, count: int | None) -> Effort:
        """Extent for stable medians, or for a quick report."""
        # Composite matrices cost O((6 nv)^3).
        dense = 32 if nv <= 12 else 10 if nv <= 60 else 3
        if quick:
            number = count or 64
            return Effort(number, min(number, dense), 3, (10, 30, 100, 300, 1000, 3000, 10_000), 5)
        number = count or 400
        sizes = tuple(m * 10**k for k in range(1, 5) for m in (1, 2, 5)) + (100_000,)
        return Effort(number, min(number, 4 * dense), 5, sizes, 9)


@dataclass
class Report(Findings):
    """Results for one scene."""

    name: str
    source: str
    scene: Scene
    seed: int = 0
    count: int | None = None
    """Number of random states; None: the default."""
    warnings: Sequence[str] = ()

    @cached_property
    def effort(self) -> Effort:
        """Extent of the measurement."""
        return Effort.of(self.scene.nv, self.quick, self.count)

    @cached_property
    def tree(self) -> Tree:
        """Links and joints."""
        return tree_of(self.scene)

    @cached_property
    def states(self) -> States:
        """Random states. Missing if nothing moves."""
        if self.scene.nv == 0:
            raise Missing("This scene has no degree of freedom, so there is nothing to compute.")
        return draw(self.scene, self.effort.states, self.seed)

    @cached_property
    def solvable(self) -> States:
        """Random states, if forward dynamics can be computed for all of them; otherwise raises its error."""
        drawn = self.states
        self.scene.forward_dynamics(drawn.q, drawn.qd, drawn.tau)
        return drawn

    @cached_property
    def batch(self) -> kinds.Drawn:
        """BATCH of these states, repeated if necessary, for states of every kind: the states of timed calls."""
        q, qd, tau = (values[np.arange(BATCH) % len(self.solvable)] for values in self.solvable.arrays)
        return kinds.of(self.scene, q, qd, tau, np.random.default_rng((self.seed, 2)))

    @cached_property
    def conditions(self) -> Array:
        """cond(M), largest relative to smallest singular value, of each state. Missing for scenes that are too
        large for dense algebra.
        """
        self.needs_dense()
        return np.array([float(np.linalg.cond(self.scene.mass_matrix(one))) for one in self.states.q])

    def needs_dense(self) -> None:
        """Raise Missing if dense matrices are not formed, or nothing moves."""
        if len(self.states) and self.scene.nv > DENSE_CAP:
            raise Missing(
                f"{self.scene.nv} degrees of freedom: this part compares with dense algebra, which is used up to"
                f" {DENSE_CAP} degrees of freedom."
            )

    @property
    def passed(self) -> bool:
        """Whether all residuals are within their bounds."""
        return not self.beyond

    @property
    def beyond(self) -> list[str]:
        """Identities whose residual exceeds its bound."""
        return [row.name for row in self.parts.get("residuals", ()) if not row.passed]

    def call(self, text: str = FORWARD, form: str | None = AUTO, *, batch: bool) -> Any:
        """Time of one call from Python, for one state or a batch; None if it was not measured."""
        rows = (row for row in self.parts.get("calls", ()) if (row.of.call, row.of.form, row.of.batch > 1) == (text, form, batch))
        return next(rows, None)

    def accuracy(self, method: str) -> Any:
        """Row of one method; None if there is none."""
        return next((row for row in self.parts.get("accuracy", ()) if row.method == method), None)

    def head(self) -> dict[str, Any]:
        """Whether all residuals are within their bounds, and the numbers of states."""
        effort = self.effort
        counts = {"count": effort.states, "for_residuals": effort.residual_states, "seed": self.seed, "quick": self.quick}
        return {"passed": self.passed, "states": counts}

    def provenance(self) -> list[tuple[str, str]]:
        """Hardware, states and numbers of timings."""
        effort = self.effort
        passes = (
            f"5 rounds of {effort.repeats} passes over all states in Rust, {effort.growth_repeats} for growth; {TURNS[self.quick]} interleaved"
            " timings of calls from Python"
        )
        random = f"{plural(effort.states, 'state')}, seed {self.seed}{' (quick)' if self.quick else ''}"
        return [*super().provenance(), ("random states", random), ("timings", passes)]


def rust(call: str, form: str | None = None, states: str = kinds.RANDOM) -> Of:
    """A call in Rust with one state."""
    return Of("Rust", call, form, states)


def median(values: Array) -> float:
    """Median of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def spread(values: Sequence[float]) -> float:
    """Largest relative to smallest: about 1 if the time per body does not depend on the number of bodies."""
    return max(values) / min(values)
