"""One plain float64 state uses a fast path to the kernel, whose results equal those of the general path.

`dtype=np.float64` requests the default dtype and uses the general path.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import at_once, random_scene, random_states
from tolerances import assert_same_bits

import phipsi

Evaluate = Callable[..., np.ndarray]

FORMS = ("auto", "covariance", "square-root")
#: Name, keywords, and number of arguments of q, qd and u.
CALLS: list[tuple[str, dict[str, Any], int]] = [
    *(("forward_dynamics", {"form": form}, 3) for form in FORMS),
    ("inverse_dynamics", {}, 3),
    ("bias_torque", {}, 2),
    ("mass_matrix", {}, 1),
    *(("mass_matrix_inverse", {"form": form}, 1) for form in FORMS),
]
WITH_OUT = ("forward_dynamics", "inverse_dynamics")


@pytest.fixture(params=CALLS, ids=lambda call: "-".join([call[0], *call[1].values()]))
def evaluate(request: pytest.FixtureRequest) -> Callable[[phipsi.Scene], tuple[Evaluate, int]]:
    """A method with its keywords, and its number of arrays."""
    name, keywords, count = request.param

    def of(scene: phipsi.Scene) -> tuple[Evaluate, int]:
        return (lambda *arguments, **more: getattr(scene, name)(*arguments, **keywords, **more)), count

    return of


def outcome(call: Callable[[], np.ndarray]) -> Any:
    """The result, or all properties of an error."""
    try:
        return call()
    except phipsi.errors.PhipsiError as error:
        return type(error), str(error), vars(error)


def same(evaluate: Evaluate, *arguments: Any, what: str, out: Any = None) -> None:
    """The fast path has the results and errors of the general path."""
    given = {} if out is None else {"out": out}
    short = outcome(lambda: evaluate(*arguments, **given))
    short = short.copy() if isinstance(short, np.ndarray) else short
    long = outcome(lambda: evaluate(*arguments, **given, dtype=np.float64))
    if isinstance(long, np.ndarray):
        assert isinstance(short, np.ndarray), (what, short)
        assert_same_bits(short, long, what)
    else:
        assert repr(short) == repr(long), what


@pytest.mark.parametrize("scene", ["arm", "mixed", "floating", "welded"])
def test_same_bits(scene: str, evaluate: Any, request: pytest.FixtureRequest) -> None:
    scene = request.getfixturevalue(scene)
    call, count = evaluate(scene)
    for seed in range(3):
        same(call, *random_states(scene, seed)[:count], what=f"state {seed}")


@pytest.mark.parametrize("joints", [1, 13, 18, 38, 39, 64, 65, 90])
def test_same_bits_for_any_size(joints: int, evaluate: Any) -> None:
    """On both sides of the sizes at which arrays are borrowed, and the GIL is released."""
    scene = random_scene(7, joints, kinds=("revolute", "prismatic"))
    call, count = evaluate(scene)
    same(call, *random_states(scene, 0)[:count], what=f"{joints} joints")


def test_results_are_arrays_of_their_own(arm: phipsi.Scene, evaluate: Any) -> None:
    call, count = evaluate(arm)
    first = call(*random_states(arm, 0)[:count])
    kept = first.copy()
    second = call(*random_states(arm, 1)[:count])
    assert_same_bits(first, kept)
    assert not np.shares_memory(first, second)
    for result in (first, second):
        assert type(result) is np.ndarray
        assert result.dtype == np.float64
        assert result.flags.c_contiguous and result.flags.owndata and result.flags.writeable


def forms_of(numbers: np.ndarray) -> dict[str, Any]:
    """One state in all array types, and invalid states."""
    strided, unaligned = np.zeros(2 * numbers.size), np.zeros(8 * numbers.size + 1, np.uint8)
    strided[::2] = numbers
    unaligned[1:].view(np.float64)[...] = numbers
    frozen = numbers.copy()
    frozen.flags.writeable = False
    return {
        "list": numbers.tolist(),
        "float32": numbers.astype(np.float32),
        "integers": numbers.astype(np.int64),
        "big-endian": numbers.astype(">f8"),
        "strided": strided[::2],
        "reversed": numbers[::-1],
        "unaligned": unaligned[1:].view(np.float64),
        "read-only": frozen,
        "masked": np.ma.asarray(numbers),
        "one state": numbers[None],
        "two states": np.stack([numbers, numbers]),
        "no state": numbers[None][:0],
        "column": numbers[:, None],
        "short": numbers[:-1],
        "long": np.append(numbers, 0.0),
        "empty": numbers[:0],
        "a number": 1.0,
        "a NumPy number": np.float64(1.0),
        "0-d": np.array(1.0),
        "None": None,
        "text": "q",
        "bool": numbers > 0,
        "complex": numbers.astype(complex),
        "object": numbers.astype(object),
    }


@pytest.mark.parametrize("kind", forms_of(np.arange(7.0)))
def test_all_kinds_of_arguments(arm: phipsi.Scene, evaluate: Any, kind: str) -> None:
    call, count = evaluate(arm)
    state = random_states(arm, 4)[:count]
    for at in range(count):
        changed: list[Any] = list(state)
        changed[at] = forms_of(state[at])[kind]
        same(call, *changed, what=f"argument {at}: {kind}")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
def test_numbers_that_are_refused(mixed: phipsi.Scene, evaluate: Any, value: float) -> None:
    """Not finite, overflow, or a quaternion far from unit: the same error, and the next call succeeds."""
    call, count = evaluate(mixed)
    state = random_states(mixed, 5)[:count]
    expected = call(*state)
    for at in range(count):
        for entry in range(state[at].size):
            changed = [argument.copy() for argument in state]
            changed[at][entry] = value
            same(call, *changed, what=f"argument {at}, entry {entry}")
    assert_same_bits(call(*state), expected)


def test_a_singular_joint() -> None:
    """A point mass on the axis of a turntable."""
    builder = phipsi.SceneBuilder().link("base").link("table").link("arm", 2.0, (1, 0, 0))
    builder.joint("turn", "revolute", "base", "table")
    builder.joint("lift", "revolute", "table", "arm", xyz=(-1, 0, 0), axis=(0, 1, 0))
    scene = builder.build(gravity=(0, 0, 0))
    still = np.zeros(2)
    with pytest.raises(phipsi.errors.SingularJointError):
        scene.forward_dynamics(still, still, still)
    for form in FORMS:
        same(lambda *x, form=form, **more: scene.forward_dynamics(*x, form=form, **more), still, still, still, what=form)
        same(lambda q, form=form, **more: scene.mass_matrix_inverse(q, form=form, **more), still, what=form)


@pytest.mark.parametrize("method", WITH_OUT)
def test_out_is_written_and_returned(mixed: phipsi.Scene, method: str) -> None:
    call, state = getattr(mixed, method), random_states(mixed, 6)
    out = np.full(mixed.nv, np.nan)
    assert call(*state, out=out) is out
    assert_same_bits(out, call(*state, dtype=np.float64))


@pytest.mark.parametrize("method", WITH_OUT)
@pytest.mark.parametrize("kind", ["list", "float32", "big-endian", "shape", "long", "strided", "read-only", "unaligned"])
def test_out_that_is_refused(arm: phipsi.Scene, method: str, kind: str) -> None:
    out = {**forms_of(np.zeros(7)), "shape": np.zeros((1, 7))}[kind]
    call, state = getattr(arm, method), random_states(arm, 0)
    with pytest.raises(phipsi.errors.PhipsiError, match="out: found"):
        call(*state, out=out)
    same(call, *state, out=out, what=kind)


@pytest.mark.parametrize("method", WITH_OUT)
@pytest.mark.parametrize("at", [0, 1, 2])
def test_out_that_overlaps_an_argument(arm: phipsi.Scene, method: str, at: int) -> None:
    call = getattr(arm, method)
    memory = np.zeros(20)
    changed = list(random_states(arm, 0))
    changed[at] = memory[:7]
    with pytest.raises(phipsi.errors.ArgumentError, match="out: found memory that is shared with an argument"):
        call(*changed, out=memory[6:13])
    same(call, *changed, out=memory[6:13], what="overlapping")
    same(call, *changed, out=memory[7:14], what="beside")


@pytest.mark.parametrize("form", ["", "Auto", "cholesky"])
def test_unknown_forms(arm: phipsi.Scene, form: str) -> None:
    q, qd, tau = random_states(arm, 0)
    same(lambda *x, **more: arm.forward_dynamics(*x, form=form, **more), q, qd, tau, what=form)
    same(lambda *x, **more: arm.mass_matrix_inverse(*x, form=form, **more), q, what=form)


def test_arguments_are_left_alone(mixed: phipsi.Scene, evaluate: Any) -> None:
    call, count = evaluate(mixed)
    state = random_states(mixed, 8)[:count]
    before = [argument.copy() for argument in state]
    result = call(*state)
    for argument, copy in zip(state, before, strict=True):
        assert_same_bits(argument, copy)
        assert not np.shares_memory(result, argument)


def test_threads_take_turns(arm: phipsi.Scene) -> None:
    """Each thread has its own states; every other state raises while the rest continue."""
    rounds, failed = 300, []

    def work(seed: int) -> None:
        q, qd, tau = random_states(arm, seed)
        broken = np.full(7, np.nan)
        expected = arm.forward_dynamics(q, qd, tau, dtype=np.float64)
        for _ in range(rounds):
            if not np.array_equal(arm.forward_dynamics(q, qd, tau), expected):
                failed.append(seed)
            if outcome(lambda: arm.forward_dynamics(q, broken, tau))[0] is not phipsi.errors.NotFiniteError:
                failed.append(seed)

    at_once(work, 4)
    assert not failed
