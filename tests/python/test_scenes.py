"""The extreme scenes: reproducible, errors by name, and three of them compared with 60 digits from the definitions."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from oracle_mpmath import Joint, Link, State, Tree, rounded
from tolerances import square_root

import phipsi
from phipsi import _core, scenes


def description(scene: phipsi.Scene) -> object:
    return scene.__reduce__()[1]


@pytest.mark.parametrize("name", scenes.names())
def test_every_case_is_the_same_from_the_same_arguments(name: str) -> None:
    case, again, other = scenes.extreme(name), scenes.extreme(name), scenes.extreme(name, seed=1)
    assert case.name == name
    assert case.parameter
    assert len(case.values) >= 4
    assert description(case.scene) == description(again.scene)
    for one, same, different in zip(case[1:4], again[1:4], other[1:4], strict=True):
        np.testing.assert_array_equal(one, same)
        assert np.all(one != 0.0)
        assert not np.array_equal(one, different)
    assert case.q.shape == (case.scene.nq,)
    assert case.qd.shape == case.tau.shape == (case.scene.nv,)


@pytest.mark.parametrize("name", scenes.names())
def test_every_value_of_the_sweep_has_accelerations(name: str) -> None:
    for value in scenes.extreme(name).values:
        if name == "long-chain" and value > 1000:
            continue
        case = scenes.extreme(name, value)
        assert case.value == value
        exact = None
        if name == "zero-inertia" and value == 0.0:
            with pytest.raises(phipsi.errors.SingularJointError) as caught:
                case.scene.forward_dynamics(case.q, case.qd, case.tau)
            assert caught.value.joint == case.scene.joint_names[-1]
            with pytest.raises(phipsi.errors.SingularJointError):
                _core.Exact(case.scene, "forward dynamics", case.q, case.qd, case.tau)
            continue
        exact = _core.Exact(case.scene, "forward dynamics", case.q, case.qd, case.tau).toarray()
        assert exact.shape == (case.scene.nv,)
        assert np.all(np.isfinite(exact))
        assert np.any(exact != 0.0)


def test_the_seed_draws_the_masses() -> None:
    first, second = (description(scenes.extreme("log-uniform-masses", seed=seed).scene) for seed in (0, 1))
    assert first != second


def test_sizes() -> None:
    assert scenes.extreme("heavy-tip", bodies=20).scene.nv == 20
    assert scenes.extreme("long-chain", 37).scene.nv == 37
    assert scenes.chain(5).nv == 5


def test_unknown_names_are_refused_with_those_there_are() -> None:
    assert scenes.extreme("spin").name == "spin"
    with pytest.raises(phipsi.errors.ArgumentError) as caught:
        scenes.extreme("spinn")
    assert caught.value.argument == "name"
    assert all(name in str(caught.value) for name in scenes.names())


@pytest.mark.parametrize(
    ("argument", "call"),
    [
        ("value", lambda: scenes.extreme("heavy-tip", -1.0)),
        ("value", lambda: scenes.extreme("heavy-tip", float("nan"))),
        ("value", lambda: scenes.extreme("spin", float("inf"))),
        ("value", lambda: scenes.extreme("long-chain", 2.5)),
        ("bodies", lambda: scenes.extreme("long-chain", bodies=3)),
        ("bodies", lambda: scenes.extreme("heavy-tip", bodies=1)),
    ],
)
def test_bad_values_are_refused_by_name(argument: str, call: object) -> None:
    with pytest.raises(phipsi.errors.ArgumentError) as caught:
        call()  # type: ignore[operator]
    assert caught.value.argument == argument


@pytest.mark.parametrize("value", [1e39, 1e160, 1e300])
def test_a_state_that_overflows_is_refused(value: float) -> None:
    """States are exact in float32."""
    with pytest.raises(phipsi.errors.NotFiniteError, match=r"qd \(result; the arguments overflow\)"):
        scenes.extreme("spin", value)
    assert np.isfinite(scenes.extreme("spin", 1e38).qd).all()


def tree_of(scene: phipsi.Scene) -> Tree:
    """The oracle's tree for a scene, from its constants."""
    _, gravity, floating, _, links, joints, *_ = scene.__reduce__()[1][0]
    assert not floating
    found = []
    for name, inertial in links:
        mass, center, (xx, xy, xz, yy, yz, zz) = inertial or (0.0, (0.0,) * 3, (0.0,) * 6)
        found.append(Link(name, mass, np.array(center), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])))
    return Tree(
        tuple(found),
        tuple(
            Joint(
                name,
                kind,
                parent,
                child,
                np.array(lever),
                np.reshape(rotation, (3, 3)),
                np.array(axis),
                pitch,
                numbers[0],
            )  # fmt: skip
            for name, kind, pitch, parent, child, (rotation, lever), axis, numbers, _, _, _ in joints
        ),
        tuple(gravity),
    )


@pytest.mark.parametrize(
    ("name", "value"), [("heavy-tip", 1e12), ("growing-masses", 1e2), ("needles", 1e-9), ("near-coincident-axes", 1e-2)]
)
def test_the_square_root_form_is_right_to_60_digits(name: str, value: float) -> None:
    """The double-double reference uses our own recursion; this test is independent of it except for the
    constants of the scene.

    The oracle starts from the constants of the links and joints, so that the difference includes the rounding of the
    builder, which is covered by the sensitivity to the parameters of the model.
    """
    case = scenes.extreme(name, value)
    oracle = State(tree_of(case.scene), case.q, case.qd).forward_dynamics(case.tau, {})
    exact = _core.Exact(case.scene, "forward dynamics", case.q, case.qd, case.tau)
    sensitivity = exact.sensitivity(3)
    assert sensitivity["state"][0] > 0.0
    inherent = max(norm for norm, _ in sensitivity.values())
    scale = float(np.max(np.abs(rounded(oracle))))
    off = float(np.max(np.abs(exact.toarray() - rounded(oracle)))) / scale
    assert off <= square_root(inherent), f"double-double: {off:.1e}"
    norm, components, reason = exact.error("square-root form")
    assert reason is None
    assert norm + off <= square_root(inherent), f"square-root form: {norm:.1e}"
    assert norm == pytest.approx(max(components * np.abs(exact.toarray())) / scale, rel=1e-6)
    if name == "heavy-tip":
        # The test is meaningful only if the covariance form fails it.
        assert exact.error("covariance form")[0] > 1e-8


def test_errors_and_sensitivities_in_both_norms() -> None:
    case = scenes.extreme("heavy-tip", 1e6)
    exact = _core.Exact(case.scene, "forward dynamics", case.q, case.qd, case.tau)
    found = exact.toarray()
    assert exact.difference(found)[0] <= 2.0**-53
    moved = found.copy()
    moved[0] *= 1.0 + 1e-3
    norm, components = exact.difference(moved)
    assert components[0] == pytest.approx(1e-3)
    assert norm == pytest.approx(1e-3 * abs(found[0]) / np.max(np.abs(found)))
    moved[0] = np.nan
    assert np.isnan(exact.difference(moved)[0])
    for quantity, method in itertools.product(_core.QUANTITIES, _core.FORMS):
        of = _core.Exact(case.scene, quantity, case.q, case.qd, case.tau)
        norm, components, reason = of.error(method)
        assert reason is None
        assert norm < 1e-3
        assert len(components) == len(of.toarray())


@pytest.mark.parametrize(
    ("argument", "call"),
    [
        ("quantity", lambda c, e: _core.Exact(c.scene, "torque", c.q, c.qd, c.tau)),
        ("q", lambda c, e: _core.Exact(c.scene, "forward dynamics", c.q[:-1], c.qd, c.tau)),
        ("qd", lambda c, e: _core.Exact(c.scene, "forward dynamics", c.q, c.qd * np.nan, c.tau)),
        ("qdd", lambda c, e: _core.Exact(c.scene, "inverse dynamics", c.q, c.qd, c.tau * np.inf)),
        ("method", lambda c, e: e.error("Gauss")),
        ("found", lambda c, e: e.difference([1.0])),
    ],
)
def test_bad_arguments_of_the_measurement(argument: str, call: object) -> None:
    case = scenes.extreme("heavy-tip", 10.0)
    exact = _core.Exact(case.scene, "forward dynamics", case.q, case.qd, case.tau)
    with pytest.raises(phipsi.errors.PhipsiError) as caught:
        call(case, exact)  # type: ignore[operator]
    assert caught.value.argument == argument
