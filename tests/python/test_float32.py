"""float32 on request: dtypes, precision, errors, and bitwise equality in any batch."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import random_scene, random_states
from tolerances import assert_near, in_float32, inverse, product

import phipsi
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError

METHODS = ("forward_dynamics", "inverse_dynamics", "bias_torque", "mass_matrix", "mass_matrix_inverse")
Arrays = tuple[np.ndarray, ...]


def call(scene: phipsi.Scene, method: str, seed: int = 0, batch: tuple[int, ...] = ()) -> tuple[Callable[..., Any], Arrays]:
    """The method, and float32 arguments for it."""
    state = [x.astype(np.float32) for x in random_states(scene, seed, batch)]
    return getattr(scene, method), tuple(state[: {"b": 2, "m": 1}.get(method[0], 3)])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("batch", [(), (1,), (37,), (2, 3)])
def test_float32_is_float64_rounded_to_its_digits(mixed: phipsi.Scene, method: str, batch: tuple[int, ...]) -> None:
    evaluate, arguments = call(mixed, method, 1, batch)
    found = evaluate(*arguments, dtype=np.float32)
    expected = evaluate(*arguments)
    assert found.dtype == np.float32 and expected.dtype == np.float64
    m = mixed.mass_matrix(arguments[0].astype(np.float64))
    condition = float(np.max(np.linalg.cond(m)))
    scale = float(np.abs(expected).max()) + (float(np.abs(arguments[-1]).max()) if len(arguments) == 3 else 0.0)
    bound = inverse(condition, scale) if method in ("forward_dynamics", "mass_matrix_inverse") else product(mixed.nv, scale)
    assert_near(found, expected, in_float32(bound))


@pytest.mark.parametrize("method", METHODS)
def test_a_batch_has_the_bits_of_its_states(mixed: phipsi.Scene, method: str) -> None:
    evaluate, arguments = call(mixed, method, 2, (35,))
    together = evaluate(*arguments, dtype="float32")
    for i, found in enumerate(together):
        one = evaluate(*(argument[i] for argument in arguments), dtype="float32")
        # A zero may differ in its sign.
        assert np.array_equal(found + np.float32(0), one + np.float32(0))


@pytest.mark.parametrize("dtype", [None, float, np.float64, "float64", "d", np.dtype(np.float64)])
def test_float64_is_the_default(arm: phipsi.Scene, dtype: Any) -> None:
    q = random_states(arm, 0).q
    found = arm.mass_matrix(q, dtype=dtype)
    assert found.dtype == np.float64 and np.array_equal(found, arm.mass_matrix(q))
    # The dtype of the arguments has no effect.
    assert arm.mass_matrix(q.astype(np.float32)).dtype == np.float64


@pytest.mark.parametrize("dtype", [np.float32, "float32", "f", np.dtype(np.float32)])
def test_every_name_of_float32(arm: phipsi.Scene, dtype: Any) -> None:
    assert arm.mass_matrix(np.zeros(7), dtype=dtype).dtype == np.float32


@pytest.mark.parametrize("dtype", [np.float16, int, ">f4", ">f8", "complex64", "nonsense", 7, "?", np.longdouble])
@pytest.mark.parametrize("method", METHODS)
def test_other_dtypes_are_refused(arm: phipsi.Scene, method: str, dtype: Any) -> None:
    evaluate, arguments = call(arm, method)
    with pytest.raises(ArgumentError, match=r"dtype: found .*; expected numpy.float64 or numpy.float32"):
        evaluate(*arguments, dtype=dtype)


def test_all_kinds_of_arrays_are_taken(arm: phipsi.Scene) -> None:
    q, qd, tau = (x.astype(np.float32) for x in random_states(arm, 0, (9,)))
    expected = arm.forward_dynamics(q, qd, tau, dtype=np.float32)
    for other in (q.astype(np.float64), q.tolist(), np.asfortranarray(q), q.astype(">f4"), np.repeat(q, 2, 1)[:, ::2]):
        assert np.array_equal(arm.forward_dynamics(other, qd, tau, dtype=np.float32), expected)


def test_broadcasting_and_no_states(mixed: phipsi.Scene) -> None:
    q, qd = random_states(mixed, 0, (3, 1)).q, random_states(mixed, 1, (4,)).qd
    found = mixed.bias_torque(q, qd, dtype=np.float32)
    assert found.shape == (3, 4, mixed.nv)
    assert np.array_equal(found[2, 3], mixed.bias_torque(q[2, 0], qd[3], dtype=np.float32))
    assert mixed.mass_matrix(np.zeros((0, mixed.nq)), dtype=np.float32).shape == (0, mixed.nv, mixed.nv)


def test_out_has_the_dtype_asked_for(arm: phipsi.Scene) -> None:
    state = random_states(arm, 0, (5,))
    out = np.empty((5, 7), np.float32)
    assert arm.forward_dynamics(*state, out=out, dtype=np.float32) is out
    assert np.array_equal(out, arm.forward_dynamics(*state, dtype=np.float32))
    with pytest.raises(ArgumentError, match="out: found dtype float64; expected a C-contiguous float32 array"):
        arm.forward_dynamics(*state, out=np.empty((5, 7)), dtype=np.float32)  # type: ignore[call-overload]
    single = [x.astype(np.float32) for x in state]
    with pytest.raises(ArgumentError, match="overlaps no argument"):
        arm.forward_dynamics(*single, out=single[2], dtype=np.float32)


def test_wrenches(mixed: phipsi.Scene) -> None:
    q, qd, tau = random_states(mixed, 0, (6,))
    wrenches = {mixed.link_names[-1]: np.arange(6.0), mixed.link_names[3]: np.ones((6, 6))}
    found = mixed.inverse_dynamics(q, qd, tau, wrenches=wrenches, dtype=np.float32)
    expected = mixed.inverse_dynamics(q, qd, tau, wrenches=wrenches)
    assert_near(found, expected, in_float32(product(mixed.nv, float(np.abs(expected).max()))))


def test_errors_name_the_state(mixed: phipsi.Scene) -> None:
    q, qd, tau = random_states(mixed, 0, (40,))
    qd[33, 2] = np.nan
    with pytest.raises(NotFiniteError, match="qd: found NaN at index 2 in state 33"):
        mixed.forward_dynamics(q, qd, tau, dtype=np.float32)
    qd[33] = 1e20
    with pytest.raises(ArgumentError, match=r"tau \(result\): found .* which float32 cannot hold in state 33"):
        mixed.bias_torque(q, qd, dtype=np.float32)
    with pytest.raises(ShapeError, match="tau"):
        mixed.forward_dynamics(q, np.zeros(mixed.nv), tau[:, 1:], dtype=np.float32)


def test_numbers_beyond_float32_are_not_finite(arm: phipsi.Scene) -> None:
    q = np.zeros((2, 7))
    q[1, 3] = 1e300
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "overflow", RuntimeWarning)  # a NumPy error that versions before 1.24 do not have
        with pytest.raises(NotFiniteError, match="q: found inf at index 3"):
            arm.mass_matrix(q, dtype=np.float32)


def test_states_in_doubt_are_float64_rounded() -> None:
    case = phipsi.scenes.extreme("heavy-tip", 1e9)
    single = [x.astype(np.float32) for x in (case.q, case.qd, case.tau)]
    expected = case.scene.forward_dynamics(*single)
    assert np.array_equal(case.scene.forward_dynamics(*single, dtype=np.float32), expected.astype(np.float32))
    ordinary = random_scene(3, 9)
    state = [x.astype(np.float32) for x in random_states(ordinary, 0, (5,))]
    found = ordinary.forward_dynamics(*state, form="square-root", dtype=np.float32)
    assert np.array_equal(found, ordinary.forward_dynamics(*state, form="square-root").astype(np.float32))


@pytest.mark.parametrize("method", METHODS)
def test_dtype_is_a_keyword(method: str) -> None:
    parameter = inspect.signature(getattr(phipsi.Scene, method)).parameters["dtype"]
    assert parameter.kind is inspect.Parameter.KEYWORD_ONLY and parameter.default is None
