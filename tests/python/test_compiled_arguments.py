"""Arguments of compiled robots compared with those of the scene: equal signatures, out, errors, and calls of the
scene.
"""

from __future__ import annotations

import inspect
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import random_scene
from method_page import member
from oracle_mpmath import Joint, Link, State, Tree, derivative, exact, identity, moved, rounded
from test_codegen import FUNCTIONS, Recorder, parts, states, states_of_people
from tolerances import assert_near, assert_same_bits, recursion, size

import phipsi
from phipsi._functions import METHODS
from phipsi.errors import ArgumentError, BadStateWarning, NotFiniteError, ShapeError

WITH_OUT = ["forward_dynamics", "inverse_dynamics", "bias_torque", "mass_matrix", "mass_matrix_inverse", "forward_dynamics_derivatives", "inverse_dynamics_derivatives"]
#: Numbers of states that machine code computes, and a few that the scene computes.
BATCHES = [(300,), (20, 15), (3,), ()]


pytestmark = pytest.mark.usefixtures("c_compiler")


@pytest.fixture(scope="module")
def scene() -> phipsi.Scene:
    return random_scene(0, 5)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("compiled")


@pytest.fixture(scope="module")
def fast(scene: phipsi.Scene, cache: Path) -> phipsi.Compiled:
    link = scene.link_names[-1]
    functions = [*FUNCTIONS, ("placement", link), ("placement", scene.link_names[2]), ("jacobian", link)]
    return phipsi.compile(scene, functions, flags=["-O0"], cache=cache)  # type: ignore[arg-type]


def given(scene: phipsi.Scene, function: str, batch: tuple[int, ...], dtype: str = "float64") -> list[np.ndarray]:
    q, qd, u = states(scene, batch)
    others = dict(zip(("dq", "dqd", "du"), np.random.default_rng(1).uniform(-1, 1, (3, *batch, scene.nv)), strict=True))
    return [({"q": q, "qd": qd, "u": u} | others)[name].astype(dtype) for name in FUNCTIONS[function]]


def unwritten(scene: phipsi.Scene, function: str, batch: tuple[int, ...], dtype: str = "float64") -> np.ndarray:
    """An array out filled with NaN."""
    matrices = (3, scene.nv) if function.endswith("derivatives") else (scene.nv,) if "matrix" in function else ()
    return np.full((*batch, *matrices, scene.nv), np.nan, dtype)


@pytest.mark.parametrize("kind", [phipsi.Compiled, phipsi.CompiledForCuda])
@pytest.mark.parametrize("function", [*FUNCTIONS, "constrained_dynamics", "placement", "jacobian"])
def test_signatures_are_those_of_the_scene(kind: type, function: str) -> None:
    """Without form, tolerance and dtype, which are options of compile, and models of states: the code is that of one model."""

    def parameters(method: Any) -> list[tuple[str, Any, Any]]:
        found = list(inspect.signature(method).parameters.values())[1:]
        return [(one.name, one.kind, one.default) for one in found if one.name not in ("form", "tolerance", "dtype", "inertias", "armature")]

    own = parameters(getattr(kind, function))
    assert own and own == parameters(member(METHODS.get(function, function)))


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("function", WITH_OUT)
def test_results_go_into_out(scene: phipsi.Scene, function: str, dtype: str, cache: Path) -> None:
    fast = phipsi.compile(scene, WITH_OUT, dtype=dtype, flags=["-O0"], cache=cache)  # type: ignore[call-overload]
    for batch in BATCHES:
        arguments = given(scene, function, batch, dtype)
        expected, out = getattr(fast, function)(*arguments), unwritten(scene, function, batch, dtype)
        found = getattr(fast, function)(*arguments, out=out)
        assert type(found) is type(expected)
        for one, other in zip(parts(found), parts(expected), strict=True):
            assert np.shares_memory(one, out) and one.dtype == dtype
            assert_same_bits(one, other, f"{function} {batch}")
        if isinstance(found, tuple):
            assert_same_bits(np.stack(found, axis=-3), out)
        else:
            assert found is out


def test_out_is_written_by_the_machine_code(scene: phipsi.Scene, fast: phipsi.Compiled, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scene is not called for valid arguments, and out is not copied; several results are not all copied at
    once.
    """
    asked: list[tuple[str, int]] = []
    monkeypatch.setattr(fast, "scene", Recorder(scene, asked))
    before = phipsi.get_num_threads()
    try:
        for threads, count in ((1, 300), (2, 5000)):
            phipsi.set_num_threads(threads)
            for function in WITH_OUT:
                arguments, out = given(scene, function, (count,)), unwritten(scene, function, (count,))
                getattr(fast, function)(*arguments, out=out)
                expected = parts(getattr(scene, function)(*arguments))
                stacked = np.stack(expected, axis=-3) if len(expected) > 1 else expected[0]
                assert_near(out, stacked, 1e-10 * size(stacked))
    finally:
        phipsi.set_num_threads(before)
    assert asked == []


BROKEN: dict[str, Any] = {
    "dtype": lambda out: out.astype(np.float32),
    "shape": lambda out: out[:-1],
    "more axes": lambda out: out[None],
    "strides": lambda out: np.repeat(out, 2, axis=-1)[..., ::2],
    "order": lambda out: np.asfortranarray(out),
    "a list": lambda out: out.tolist(),
    "masked": lambda out: np.ma.masked_array(out),
}


@pytest.mark.parametrize("broken", BROKEN)
@pytest.mark.parametrize("function", ["forward_dynamics", "mass_matrix", "inverse_dynamics_derivatives"])
@pytest.mark.parametrize("count", [300, 3])
def test_a_broken_out_is_refused_as_by_the_scene(scene: phipsi.Scene, fast: phipsi.Compiled, function: str, broken: str, count: int) -> None:
    arguments, out = given(scene, function, (count,)), BROKEN[broken](unwritten(scene, function, (count,)))
    with pytest.raises((ArgumentError, ShapeError)) as expected:
        getattr(scene, function)(*arguments, out=out)
    with pytest.raises(type(expected.value)) as told:
        getattr(fast, function)(*arguments, out=out)
    assert str(told.value) == str(expected.value) and str(told.value).startswith("out: ")


def test_out_that_may_not_be_written_is_refused(scene: phipsi.Scene, fast: phipsi.Compiled) -> None:
    q, qd, u = given(scene, "forward_dynamics", (300,))
    out = np.empty_like(qd)
    out.flags.writeable = False
    with pytest.raises(ArgumentError, match="out: found a read-only array"):
        fast.forward_dynamics(q, qd, u, out=out)


def test_out_that_overlaps_an_argument_is_refused(scene: phipsi.Scene, fast: phipsi.Compiled) -> None:
    q, qd, u = given(scene, "forward_dynamics", (300,))
    before = u.copy()
    with pytest.raises(ArgumentError, match="out: found memory that is shared with an argument"):
        fast.forward_dynamics(q, qd, u, out=u)
    # The same for an array that is converted.
    both = np.zeros((301, scene.nv))
    with pytest.raises(ArgumentError, match="out: found memory that is shared with an argument"):
        fast.forward_dynamics(q, both[1], u, out=both[:-1])
    assert_same_bits(u, before)


@pytest.mark.parametrize("count", [300, 3])
def test_derivatives_in_float32_have_an_out_of_that(scene: phipsi.Scene, cache: Path, count: int) -> None:
    """The message does not depend on the scene."""
    fast = phipsi.compile(scene, ["inverse_dynamics_derivatives"], dtype="float32", flags=["-O0"], cache=cache)
    arguments = given(scene, "inverse_dynamics_derivatives", (count,), "float32")
    with pytest.raises(ArgumentError, match="out: found float64 .*float32"):
        fast.inverse_dynamics_derivatives(*arguments, out=unwritten(scene, "inverse_dynamics_derivatives", (count,)))


@pytest.mark.parametrize("function", FUNCTIONS)
def test_bad_states_become_nan_as_by_the_scene(scene: phipsi.Scene, fast: phipsi.Compiled, function: str) -> None:
    for batch, bad in (((300,), (7,)), ((20, 15), (19, 14)), ((4,), (2,))):
        arguments = given(scene, function, batch)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            fine = parts(getattr(fast, function)(*arguments, errors="nan"))
        arguments[0][bad] = np.inf
        with pytest.warns(BadStateWarning) as expected:
            by_scene = parts(getattr(scene, function)(*arguments, errors="nan"))
        with pytest.warns(BadStateWarning) as told:
            found = parts(getattr(fast, function)(*arguments, errors="nan"))
        assert str(told[0].message) == str(expected[0].message)
        assert told[0].message.states == (bad if len(bad) == 1 else (bad,))  # type: ignore[union-attr]
        good = np.ones(batch, bool)
        good[bad] = False
        for one, other, before in zip(found, by_scene, fine, strict=True):
            assert np.isnan(one[bad]).all() and not np.isnan(before).any()
            assert_same_bits(one[good], other[good], function)


def test_bad_states_become_nan_in_out(scene: phipsi.Scene, fast: phipsi.Compiled) -> None:
    q, qd, u = given(scene, "forward_dynamics", (300,))
    qd[3, 1] = np.nan
    out = np.empty_like(qd)
    with pytest.warns(BadStateWarning, match="1 of 300"):
        assert fast.forward_dynamics(q, qd, u, out=out, errors="nan") is out
    assert np.isnan(out[3]).all() and np.isnan(out).sum() == scene.nv


def test_bad_placements_of_several_links_are_told_once(scene: phipsi.Scene, fast: phipsi.Compiled) -> None:
    (q,) = given(scene, "placements", (300,))
    links = [scene.link_names[-1], scene.link_names[2]]
    assert_near(fast.placement(q, links), scene.placement(q, links), recursion(scene.nv, 4.0))
    q[9, 0] = np.nan
    with pytest.warns(BadStateWarning, match="1 of 300") as told:
        found = fast.placement(q, links, errors="nan")
    assert len(told) == 1 and np.isnan(found[9]).all() and not np.isnan(found[10]).any()


@pytest.mark.parametrize("function", [*FUNCTIONS, "placement", "jacobian"])
@pytest.mark.parametrize("count", [300, 3])
def test_errors_that_are_neither_are_refused(scene: phipsi.Scene, fast: phipsi.Compiled, function: str, count: int) -> None:
    one_link = function in ("placement", "jacobian")
    arguments: list[Any] = [*given(scene, "placements" if one_link else function, (count,)), *([scene.link_names[-1]] if one_link else [])]
    with pytest.raises(ArgumentError, match="errors: found .?ignore"):
        getattr(fast, function)(*arguments, errors="ignore")


def test_what_no_code_was_compiled_for_is_done_by_the_scene(scene: phipsi.Scene, fast: phipsi.Compiled) -> None:
    link = scene.link_names[-1]
    q, qd, u, dq, dqd, du = given(scene, "forward_dynamics_jvp", (300,))
    wrenches = {link: np.ones(6)}
    for function in ("forward_dynamics", "inverse_dynamics", "forward_dynamics_derivatives", "inverse_dynamics_derivatives"):
        expected, found = (parts(getattr(of, function)(q, qd, u, wrenches=wrenches)) for of in (scene, fast))
        for one, other in zip(found, expected, strict=True):
            assert_same_bits(one, other, function)
    qdd, accuracy = fast.forward_dynamics(q, qd, u, return_info=True)
    assert_same_bits(qdd, scene.forward_dynamics(q, qd, u, return_info=True)[0])
    assert np.shape(accuracy.error) == (300,)
    changed = fast.forward_dynamics_jvp(q, qd, u, dq, dqd, du, dgravity=np.array([0.0, 0.0, 1.0]), darmature=np.ones(scene.nv))
    assert_same_bits(changed, scene.forward_dynamics_jvp(q, qd, u, dq, dqd, du, dgravity=np.array([0.0, 0.0, 1.0]), darmature=np.ones(scene.nv)))
    gradients = fast.inverse_dynamics_vjp(q, qd, u, dq, parameters=True)
    assert gradients.armature is not None and fast.inverse_dynamics_vjp(q, qd, u, dq).armature is None
    assert_same_bits(fast.jacobian(q, link, at=np.ones(3)), scene.jacobian(q, link, at=np.ones(3)))


def test_a_wrench_on_no_link_is_refused(scene: phipsi.Scene, fast: phipsi.Compiled) -> None:
    q, qd, u = given(scene, "forward_dynamics", (300,))
    with pytest.raises(ArgumentError, match="nowhere"):
        fast.forward_dynamics(q, qd, u, wrenches={"nowhere": np.ones(6)})


def test_arrays_that_are_no_plain_numbers_are_read(scene: phipsi.Scene, fast: phipsi.Compiled, tmp_path: Path) -> None:
    """Read-only, memory-mapped, strided, float32 and Fortran-ordered arrays: read as by the scene."""
    q, qd, u = given(scene, "forward_dynamics", (300,))
    expected = scene.forward_dynamics(q, qd, u)
    locked, mapped = qd.copy(), np.memmap(tmp_path / "u", np.float64, "w+", shape=u.shape)
    locked.flags.writeable = False
    mapped[:] = u
    strided = np.repeat(q, 2, axis=0)[::2]
    for arguments in ((q, locked, u), (q, qd, mapped), (strided, qd, u), (np.asfortranarray(q), qd, u), (q.tolist(), qd, u)):
        assert_near(fast.forward_dynamics(*arguments), expected, 1e-12 * size(expected))


def test_robots_without_joints_have_results_too(cache: Path) -> None:
    builder = phipsi.SceneBuilder()
    builder.link("base", 1.0, np.zeros(3), np.eye(3))
    scene = builder.build()
    fast = phipsi.compile(scene, ["forward_dynamics", "placements"], flags=["-O0"], cache=cache)
    for count in (300, 0):
        nothing = np.zeros((count, 0))
        assert fast.forward_dynamics(nothing, nothing, nothing).shape == (count, 0)
        assert fast.placements(nothing)["base"].shape == (count, 4, 4)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_no_states_have_no_results(scene: phipsi.Scene, fast: phipsi.Compiled, function: str) -> None:
    expected, found = (parts(getattr(of, function)(*given(scene, function, (0,)))) for of in (scene, fast))
    assert [part.shape for part in found] == [part.shape for part in expected]


def test_a_masked_array_is_refused(scene: phipsi.Scene, fast: phipsi.Compiled) -> None:
    q, qd, u = given(scene, "forward_dynamics", (300,))
    hidden = np.ma.masked_array(qd, mask=np.zeros_like(qd, bool))
    hidden[3, 0] = np.ma.masked
    for of in (scene, fast):
        with pytest.raises(ArgumentError, match="qd: .*mask"):
            of.forward_dynamics(q, hidden, u)


# --- Error estimates of derivatives and products.

WATCHED = ["forward_dynamics_derivatives", "forward_dynamics_jvp", "forward_dynamics_vjp"]


def heavy_tip(ratio: float) -> Tree:
    """Eight rods in series, more than the tip has degrees of freedom; the last has that multiple of the mass."""
    links = [Link("base", 1.0, np.zeros(3), np.eye(3))]
    joints = []
    for i in range(8):
        mass = ratio if i == 7 else 1.0
        links.append(Link(f"rod{i}", mass, np.array([0.25, 0.0, 0.0]), mass * np.diag([0.01, 0.02, 0.03])))
        axis = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]][i % 2])
        joints.append(Joint(f"joint{i}", "revolute", links[i].name, f"rod{i}", xyz=np.array([0.5 * (i > 0), 0.0, 0.0]), axis=axis))
    return Tree(tuple(links), tuple(joints))


def in_60_digits(tree: Tree, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> list[np.ndarray]:
    """dqdd/dq, dqdd/dqd and M^-1 in one state."""
    n, at_q, rates = tree.nv, exact(q), exact(qd)
    here = State(tree, q, qd)
    qdd = here.forward_dynamics(exact(tau), {})
    by_q = [derivative(lambda h, e=e: State(tree, moved(tree, at_q, e, h), rates).inverse_dynamics(qdd, {})) for e in identity(n)]
    by_qd = [derivative(lambda h, e=e: State(tree, at_q, rates + e * h).inverse_dynamics(qdd, {})) for e in identity(n)]
    return [-here.inverse @ np.stack(by_q, axis=1), -here.inverse @ np.stack(by_qd, axis=1), here.inverse]


@pytest.mark.parametrize("bent", [0.0, 1.0], ids=["stretched out", "bent"])
def test_derivatives_keep_their_digits_against_60(bent: float, cache: Path) -> None:
    """A heavy tip: straight at rest, and bent in motion. The covariance form alone has a visible loss of precision."""
    tree = heavy_tip(1e7)
    scene = tree.scene()
    random = np.random.default_rng(2)
    q, qd, tau, *along = random.uniform(-1, 1, (7, 8))
    q, qd, tau = bent * q, bent * qd, bent * tau
    matrices = in_60_digits(tree, q, qd, tau)
    fast, loses = (phipsi.compile(scene, WATCHED, form=form, flags=["-O0"], cache=cache) for form in (None, "covariance"))  # type: ignore[arg-type]
    batch = [np.tile(values, (130, 1)) for values in (q, qd, tau)]
    expected = {
        "forward_dynamics_derivatives": [rounded(matrix) for matrix in matrices],
        "forward_dynamics_jvp": [rounded(sum(matrix @ exact(change) for matrix, change in zip(matrices, along[:3], strict=True)))],
        "forward_dynamics_vjp": [rounded(exact(along[3]) @ matrix) for matrix in matrices],
    }
    directions: dict[str, Any] = {"forward_dynamics_derivatives": [], "forward_dynamics_jvp": along[:3], "forward_dynamics_vjp": along[3:]}
    lost = 0.0
    for function, right in expected.items():
        scale = max(float(np.max(np.abs(part))) for part in right)
        for of in (fast, loses):
            found = parts(getattr(of, function)(*batch, *directions[function]))
            off = max(float(np.max(np.abs(one - other))) for one, other in zip(found, right, strict=True)) / scale
            if of is fast:
                assert off < 1e-12, function
            lost = max(lost, off)
    assert lost > 1e-11


@pytest.mark.parametrize("function", WATCHED)
def test_of_the_states_of_people_none_is_handed_over(function: str, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Random, at rest, static equilibrium, passive, one joint moving; out also receives the results of the scene."""
    arm, heavy = phipsi.scenes.chain(5), phipsi.scenes.extreme("heavy-tip", 1e9).scene
    for scene, most in ((arm, 0), (heavy, 140)):
        asked: list[tuple[str, int]] = []
        q, qd, tau = (np.tile(part, (7, 1)) for part in states_of_people(scene, 0))
        more = {"forward_dynamics_jvp": [q, qd, tau], "forward_dynamics_vjp": [tau + 1.0]}.get(function, [])
        fast = phipsi.compile(scene, [function], flags=["-O0"], cache=cache)  # type: ignore[list-item]
        expected = parts(getattr(scene, function)(q, qd, tau, *more))
        monkeypatch.setattr(fast, "scene", Recorder(scene, asked))
        for out in (None, unwritten(scene, function, (140,))) if function.endswith("derivatives") else (None,):
            found = parts(getattr(fast, function)(q, qd, tau, *more, **({} if out is None else {"out": out})))
            for one, other in zip(found, expected, strict=True):
                assert_near(one, other, 1e-11 * size(*expected))
        assert all(count <= most for _, count in asked) and bool(asked) == (most > 0)


def test_what_is_not_finite_is_told_beside_the_watch(cache: Path) -> None:
    scene = phipsi.scenes.chain(3)
    fast = phipsi.compile(scene, ["forward_dynamics_jvp"], flags=["-O0"], cache=cache)
    q, qd, tau, dq, dqd, dtau = given(scene, "forward_dynamics_jvp", (300,))
    dtau[200, 1] = np.nan
    with pytest.raises(NotFiniteError, match="dtau: .*state 200|state 200"):
        fast.forward_dynamics_jvp(q, qd, tau, dq, dqd, dtau)
