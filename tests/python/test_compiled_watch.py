"""Error estimates of compiled derivatives and products of forward dynamics: on the extreme scenes each result is within
the tolerance of form `auto` of 60 digits, and the margins report where precision is lost.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from oracle_mpmath import exact
from test_auto_everywhere import CASES, DIRECTIONS, Case, assert_accepted, case_of
from test_codegen import Recorder, parts, states_of_people
from tolerances import assert_near, size

import phipsi

COMPILER = os.environ.get("CC", "cc")
PRODUCTS = ["forward_dynamics_derivatives", "forward_dynamics_jvp", "forward_dynamics_vjp"]
pytestmark = pytest.mark.usefixtures("c_compiler")


@pytest.fixture(autouse=True)
def _small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("phipsi._compile.FEW", dict.fromkeys(phipsi._compile.FEW, 16))


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("compiled")


def in_batch(*arrays: np.ndarray) -> list[np.ndarray]:
    """Enough equal states for the machine code."""
    return [np.tile(array, (17, 1)) for array in arrays]


@pytest.mark.parametrize("name", CASES)
def test_extreme_scenes_against_60_digits(name: str, cache: Path) -> None:
    case = case_of(name)
    fast = phipsi.compile(case.scene, PRODUCTS, flags=["-O0"], cache=cache)
    matrices = fast.forward_dynamics_derivatives(*in_batch(*case.state))
    gradients = fast.forward_dynamics_vjp(*in_batch(*case.state, case.cotangent))
    for at, direction_name in enumerate(DIRECTIONS):
        direction, expected = case.directions[direction_name], case.along(direction_name)
        assert_accepted(fast.forward_dynamics_jvp(*in_batch(*case.state, *case.seeds(direction_name)))[5], expected)
        matrix = matrices[at][5]
        assert_accepted(matrix @ direction, expected, float(np.max(np.abs(matrix)) * np.sum(np.abs(direction))))
        gradient = (gradients.q, gradients.qd, gradients.tau)[at][5]
        scale = float(np.max(np.abs(gradient)) * np.sum(np.abs(direction)))
        assert_accepted(gradient @ direction, exact(case.cotangent) @ expected, scale)
    assert_accepted(matrices.mass_matrix_inverse[5], case.inverse)


def margins(case: Case, into: Path) -> list[float]:
    """The margin of the factor, and the margins of the three functions."""
    names = ["factor_watched", *(f"{name}_watched" for name in PRODUCTS)]
    case.scene.to_c(into, functions=names)  # type: ignore[arg-type]
    subprocess.run([COMPILER, "-std=c99", "-O0", "-shared", "-fPIC", "robot.c", "-lm", "-o", "robot.so"], cwd=into, check=True, timeout=300)
    code, nv, found = ctypes.CDLL(str(into / "robot.so")), case.scene.nv, []
    others = {PRODUCTS[0]: [], PRODUCTS[1]: [*case.directions.values()], PRODUCTS[2]: [case.cotangent]}
    results = {PRODUCTS[0]: [nv * nv] * 3, PRODUCTS[1]: [nv], PRODUCTS[2]: [nv] * 3}
    for name in names:
        function = name.removesuffix("_watched")
        given = [*case.state[: 1 if function == "factor" else 3], *others.get(function, [])]
        out = [np.full(width, np.nan) for width in [*results.get(function, []), 1]]
        getattr(code, f"robot_{name}")(*(np.ascontiguousarray(x).ctypes.data_as(ctypes.c_void_p) for x in (*given, *out)))
        found.append(float(out[-1][0]))
    return found


def test_columns_are_watched_and_not_the_factor_alone(tmp_path: Path) -> None:
    """In some scenes the products with M^-1 lose precision, and the factor does not."""
    found = {name: margins(case_of(name), tmp_path / name) for name in CASES}
    assert np.isfinite([*found.values()]).all()
    alone = [name for name, (factor, *columns) in found.items() if factor >= 0 and min(columns) < 0]
    assert alone, found
    # No function accepts a factor that has lost precision.
    assert all(max(columns) < 0 for factor, *columns in found.values() if factor < 0)


def test_ordinary_states_are_not_recomputed(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = phipsi.scenes.chain(5)
    fast = phipsi.compile(scene, PRODUCTS, flags=["-O0"], cache=cache)
    q, qd, tau = states_of_people(scene, 0)
    # Straight chains are at the limit of precision.
    q[4:8] += 0.1
    directions = np.random.default_rng(0).uniform(-1, 1, (3, 20, scene.nv))
    given = {PRODUCTS[0]: (), PRODUCTS[1]: tuple(directions), PRODUCTS[2]: (directions[0],)}
    expected = {name: getattr(scene, name)(q, qd, tau, *given[name]) for name in PRODUCTS}
    asked: list[tuple[str, int]] = []
    monkeypatch.setattr(fast, "scene", Recorder(scene, asked))
    for name in PRODUCTS:
        out = np.empty((20, 3, scene.nv, scene.nv)) if name == PRODUCTS[0] else None
        options = {} if out is None else {"out": out}
        found = parts(getattr(fast, name)(q, qd, tau, *given[name], **options))
        for one, other in zip(found, parts(expected[name]), strict=True):
            assert_near(one, other, 1e-10 * size(*parts(expected[name])))
    assert asked == []
