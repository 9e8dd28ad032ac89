"""Batches: arrays in, arrays out, like contestants.py for one state per call.

phipsi has batches for every algorithm; Pinocchio is called in a loop, and has two batched functions; MuJoCo has
`mujoco.rollout`.
"""

from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import mujoco.rollout
import numpy as np
import pinocchio as pin
from compare import BATCH, INTO_GIVEN
from contestants import Entry, mujoco_model, pinocchio_arrays, pinocchio_model, symmetric
from problems import KINDS, Array, Problem


def of_phipsi(problem: Problem, threads: int = 1) -> Iterator[Entry]:
    """NumPy arrays in and out; the number of threads is that of the process."""
    scene, q, qd, tau, qdd = problem.scene, problem.q, problem.qd, problem.tau, problem.qdd
    library = "phipsi" if threads == 1 else f"phipsi, {threads} threads"

    def entry(operation: str, call: str, loop: Callable[[], Any]) -> Entry:
        return Entry(operation + BATCH, library, call, loop, lambda result: result[-1])

    for form in ("covariance", "auto"):
        loop = lambda form=form: scene.forward_dynamics(q, qd, tau, form=form)  # noqa: E731
        yield entry("forward_dynamics", f"forward_dynamics, {form}", loop)
    for kind in KINDS:
        states = problem.at(kind)
        alone = float(np.max(np.abs(scene.forward_dynamics(states[0][-1], states[1][-1], np.zeros(scene.nv)))))
        for form in ("covariance", "auto"):
            loop = lambda form=form, states=states: scene.forward_dynamics(*states, form=form)  # noqa: E731
            operation = f"forward_dynamics, {kind}{BATCH}"
            yield Entry(operation, library, f"forward_dynamics, {form}", loop, lambda result: result[-1], alone)
    yield entry("inverse_dynamics", "inverse_dynamics", lambda: scene.inverse_dynamics(q, qd, qdd))
    yield entry("mass_matrix", "mass_matrix", lambda: scene.mass_matrix(q))
    for form in ("covariance", "auto"):
        loop = lambda form=form: scene.mass_matrix_inverse(q, form=form)  # noqa: E731
        yield entry("mass_matrix_inverse", f"mass_matrix_inverse, {form}", loop)
    # The pages of a new array of this size are allocated one by one.
    out = np.empty((len(problem), scene.nv, scene.nv))
    yield entry("mass_matrix", f"mass_matrix{INTO_GIVEN}", lambda: scene.mass_matrix(q, out=out))
    inverse = "mass_matrix_inverse"
    yield entry(inverse, f"{inverse}, covariance{INTO_GIVEN}", lambda: scene.mass_matrix_inverse(q, form="covariance", out=out))


def of_pinocchio(problem: Problem) -> Iterator[Entry]:
    """A loop over the rows, as in user code; and its batched functions for two algorithms."""
    model, at = pinocchio_model(problem)
    data, last, nv = model.createData(), len(problem) - 1, model.nv
    q, v, tau, a = pinocchio_arrays(problem, at)

    def looped(function: Callable[..., Array], *arrays: Array, matrix: bool = False) -> Callable[[], Array]:
        def loop() -> Array:
            out = np.empty((len(q), nv, nv) if matrix else (len(q), nv))
            for result, *state in zip(out, *arrays, strict=True):
                result[:] = function(model, data, *state)
            return out

        return loop

    def accelerations(result: Array) -> Array:
        return at.our_accelerations(result[-1], last)

    def forces(result: Array) -> Array:
        return at.our_forces(result[-1], last)

    def matrix(result: Array) -> Array:
        return at.our_matrix(symmetric(result[-1]), last)

    minverse = looped(pin.computeMinverse, q, matrix=True)
    yield Entry("forward_dynamics_batch", "Pinocchio", "loop over pin.aba", looped(pin.aba, q, v, tau), accelerations)
    yield Entry("inverse_dynamics_batch", "Pinocchio", "loop over pin.rnea", looped(pin.rnea, q, v, a), forces)
    yield Entry("mass_matrix_batch", "Pinocchio", "loop over pin.crba", looped(pin.crba, q, matrix=True), matrix)
    yield Entry("mass_matrix_inverse_batch", "Pinocchio", "loop over pin.computeMinverse", minverse, matrix)
    if hasattr(pin, "abaInParallel"):
        columns = [np.asfortranarray(array.T) for array in (q, v, tau, a)]
        for threads in (1, 2):
            pool = pin.ModelPool(model, threads)
            library = "Pinocchio" if threads == 1 else f"Pinocchio, {threads} threads"

            def aba(threads: int = threads, pool: Any = pool) -> Array:
                return pin.abaInParallel(threads, pool, *columns[:3]).T

            def rnea(threads: int = threads, pool: Any = pool) -> Array:
                return pin.rneaInParallel(threads, pool, columns[0], columns[1], columns[3]).T

            yield Entry("forward_dynamics_batch", library, "pin.abaInParallel", aba, accelerations)
            yield Entry("inverse_dynamics_batch", library, "pin.rneaInParallel", rnea, forces)


def of_mujoco(problem: Problem) -> Iterator[Entry]:
    """One step of every state with mujoco.rollout."""
    model, at = mujoco_model(problem)
    every, last = range(len(problem)), len(problem) - 1
    full = np.array([np.concatenate([[0.0], at.base(s), at.positions(s), at.rates(s)]) for s in every])
    forces = np.array([at.forces(s) for s in every])[:, None, :]
    before = at.rates(last)

    def ours(result: tuple[Array, Array]) -> Array:
        after = result[0][-1, -1, -model.nv :]
        return at.our_accelerations((after - before) / model.opt.timestep, last)

    for threads in (1, 2):
        data = [mujoco.MjData(model) for _ in range(threads)]
        pool = mujoco.rollout.Rollout(nthread=0 if threads == 1 else threads)

        def loop(data: list[Any] = data, pool: Any = pool) -> Any:
            return pool.rollout(model, data, full, forces, control_spec=int(mujoco.mjtState.mjSTATE_QFRC_APPLIED))

        library = "MuJoCo" if threads == 1 else f"MuJoCo, {threads} threads"
        yield Entry("forward_dynamics_batch", library, "mujoco.rollout, one step", loop, ours)


BATCHES = {"phipsi": of_phipsi, "Pinocchio": of_pinocchio, "MuJoCo": of_mujoco}
