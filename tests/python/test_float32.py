"""float32 on request: the results of float64 rounded, dtypes, errors."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import random_states

import phipsi
from phipsi.errors import ArgumentError, BadStateWarning, NotFiniteError, ShapeError

METHODS = ("forward_dynamics", "inverse_dynamics", "bias_torque", "mass_matrix", "mass_matrix_inverse")
Arrays = tuple[np.ndarray, ...]


def call(scene: phipsi.Scene, method: str, seed: int = 0, batch: tuple[int, ...] = ()) -> tuple[Callable[..., Any], Arrays]:
    """The method, and float32 arguments for it."""
    state = [x.astype(np.float32) for x in random_states(scene, seed, batch)]
    return getattr(scene, method), tuple(state[: {"b": 2, "m": 1}.get(method[0], 3)])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("batch", [(), (1,), (37,), (2, 3)])
@pytest.mark.parametrize("given", [np.float32, np.float64])
def test_float32_results_are_those_of_float64_rounded(
    mixed: phipsi.Scene, method: str, batch: tuple[int, ...], given: type
) -> None:
    evaluate, arguments = call(mixed, method, 1, batch)
    arguments = tuple(x.astype(given) for x in arguments)
    if given is np.float64 and method != "mass_matrix":
        # Digits that float32 does not have, in the last argument.
        arguments = (*arguments[:-1], np.nextafter(arguments[-1], np.inf) if len(arguments) > 1 else arguments[-1])
    found, expected = evaluate(*arguments, dtype=np.float32), evaluate(*arguments)
    assert found.dtype == np.float32 and expected.dtype == np.float64
    assert np.array_equal(found, expected.astype(np.float32)) and np.isfinite(found).all()


@pytest.mark.parametrize("form", ["auto", "covariance", "square-root"])
def test_in_every_form_and_at_extreme_mass_ratios(form: Any) -> None:
    case = phipsi.scenes.extreme("heavy-tip", 1e6)
    expected, info = case.scene.forward_dynamics(case.q, case.qd, case.tau, form=form, return_info=True)
    found, same = case.scene.forward_dynamics(case.q, case.qd, case.tau, form=form, return_info=True, dtype="float32")
    assert np.array_equal(found, expected.astype(np.float32)) and same == info
    m = case.scene.mass_matrix_inverse(case.q, form=form)
    assert np.array_equal(case.scene.mass_matrix_inverse(case.q, form=form, dtype="float32"), m.astype(np.float32))


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
    expected = arm.forward_dynamics(*single, dtype=np.float32)
    # The arguments are copied to float64 before results are written.
    assert np.array_equal(arm.forward_dynamics(*single, out=single[2], dtype=np.float32), expected)


def test_wrenches(mixed: phipsi.Scene) -> None:
    q, qd, tau = random_states(mixed, 0, (6,))
    wrenches = {mixed.link_names[-1]: np.arange(6.0), mixed.link_names[3]: np.ones((6, 6))}
    found = mixed.inverse_dynamics(q, qd, tau, wrenches=wrenches, dtype=np.float32)
    assert np.array_equal(found, mixed.inverse_dynamics(q, qd, tau, wrenches=wrenches).astype(np.float32))


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


def test_a_result_that_float32_cannot_hold_is_refused_in_its_state_only(arm: phipsi.Scene) -> None:
    q, qd, tau = random_states(arm, 0, (40,))
    qd[[7, 33]] *= 1e20
    expected = arm.inverse_dynamics(q, qd, tau)
    assert np.abs(expected[[7, 33]]).max() > np.finfo(np.float32).max and np.isfinite(expected).all()
    # An invalid state before or after it does not hide it.
    qd[20, 0] = np.nan
    with pytest.raises(ArgumentError, match=r"tau \(result\): found .* which float32 cannot hold in state 7"):
        arm.inverse_dynamics(q, qd, tau, dtype=np.float32)
    with pytest.warns(BadStateWarning) as caught:
        found = arm.inverse_dynamics(q, qd, tau, dtype=np.float32, errors="nan")
    assert np.isnan(found[[7, 20, 33]]).all()
    others = np.setdiff1d(np.arange(40), [7, 20, 33])
    assert np.array_equal(found[others], expected[others].astype(np.float32))
    warning = caught[0].message
    assert isinstance(warning, BadStateWarning) and list(warning.states) == [7, 20, 33]


def test_the_largest_and_the_smallest_float32_are_results(arm: phipsi.Scene) -> None:
    q, rest = np.zeros(7), np.zeros(7)
    largest = float(np.finfo(np.float32).max)
    unit = arm.inverse_dynamics(q, rest, np.eye(7)[0]) - arm.bias_torque(q, rest)
    for size, fits in [(0.99, True), (1.01, False)]:
        qdd = size * largest / np.abs(unit).max() * np.eye(7)[0]
        if fits:
            found = arm.inverse_dynamics(q, rest, qdd, dtype=np.float32)
            assert np.array_equal(found, arm.inverse_dynamics(q, rest, qdd).astype(np.float32))
        else:
            with pytest.raises(ArgumentError, match="float32 cannot hold"):
                arm.inverse_dynamics(q, rest, qdd, dtype=np.float32)


@pytest.mark.parametrize("method", METHODS)
def test_dtype_is_a_keyword(method: str) -> None:
    parameter = inspect.signature(getattr(phipsi.Scene, method)).parameters["dtype"]
    assert parameter.kind is inspect.Parameter.KEYWORD_ONLY and parameter.default is None
