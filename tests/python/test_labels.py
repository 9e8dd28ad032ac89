"""Arguments with labels, masks and units: matched by joint, or refused; and objects that are not arrays, refused by
type.
"""

from __future__ import annotations

import collections
import datetime
import re
import types
from typing import Any

import numpy as np
import pytest
from conftest import random_scene, random_states
from tolerances import assert_same_bits

import phipsi
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError

NAMES = tuple(f"joint{k}" for k in range(7))
SHUFFLED = [3, 0, 6, 1, 5, 2, 4]


@pytest.fixture
def state(arm: phipsi.Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return random_states(arm, 0)


def shuffled(values: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """The values and their names in another order."""
    return values[..., SHUFFLED], [NAMES[k] for k in SHUFFLED]


def pandas_series(values: np.ndarray) -> Any:
    pandas = pytest.importorskip("pandas")
    numbers, names = shuffled(values)
    return pandas.Series(numbers, index=names)


def pandas_frame(values: np.ndarray) -> Any:
    pandas = pytest.importorskip("pandas")
    numbers, names = shuffled(np.atleast_2d(values))
    return pandas.DataFrame(numbers, columns=names, index=pandas.date_range("2026-01-01", periods=len(numbers)))


def polars_frame(values: np.ndarray) -> Any:
    polars = pytest.importorskip("polars")
    numbers, names = shuffled(np.atleast_2d(values))
    return polars.DataFrame(numbers, schema=names)


def arrow_table(values: np.ndarray) -> Any:
    pyarrow = pytest.importorskip("pyarrow")
    numbers, names = shuffled(np.atleast_2d(values))
    return pyarrow.table(dict(zip(names, numbers.T, strict=True)))


def xarray_array(values: np.ndarray) -> Any:
    xarray = pytest.importorskip("xarray")
    numbers, names = shuffled(np.atleast_2d(values))
    return xarray.DataArray(numbers, dims=("time", "joint"), coords={"joint": names})


def xarray_dataset(values: np.ndarray) -> Any:
    xarray = pytest.importorskip("xarray")
    numbers, names = shuffled(values)
    return xarray.Dataset({name: float(number) for name, number in zip(names, numbers, strict=True)})


def mapping(values: np.ndarray) -> dict[str, float]:
    numbers, names = shuffled(values)
    return dict(zip(names, numbers.tolist(), strict=True))


def named_tuple(values: np.ndarray) -> Any:
    numbers, names = shuffled(values)
    return collections.namedtuple("State", names)(*numbers)  # noqa: PYI024


ONE = {
    "dict": mapping,
    "proxy": lambda values: types.MappingProxyType(mapping(values)),
    "dict of arrays": lambda values: {name: np.array([number]) for name, number in mapping(values).items()},
    "pandas": pandas_series,
    "xarray dataset": xarray_dataset,
    "named tuple": named_tuple,
}
TABLES = {"pandas": pandas_frame, "polars": polars_frame, "arrow": arrow_table, "xarray": xarray_array}


@pytest.mark.parametrize("kind", ONE)
@pytest.mark.parametrize("argument", ["q", "qd", "tau"])
def test_one_state_by_name(arm: phipsi.Scene, state: Any, kind: str, argument: str) -> None:
    given = dict(zip(("q", "qd", "tau"), state, strict=True))
    expected = arm.forward_dynamics(**given)
    found = arm.forward_dynamics(**(given | {argument: ONE[kind](given[argument])}))
    assert_same_bits(found, expected)


@pytest.mark.parametrize("kind", TABLES)
def test_a_table_is_a_batch_by_name(arm: phipsi.Scene, kind: str) -> None:
    q, qd, tau = random_states(arm, 0, (5,))
    expected = arm.forward_dynamics(q, qd, tau)
    found = arm.forward_dynamics(TABLES[kind](q), TABLES[kind](qd), TABLES[kind](tau))
    assert_same_bits(found, expected)


def test_float32_by_name(arm: phipsi.Scene, state: Any) -> None:
    q, qd, tau = state
    found = arm.forward_dynamics(mapping(q), mapping(qd), mapping(tau), dtype=np.float32)
    assert_same_bits(found, arm.forward_dynamics(q, qd, tau, dtype=np.float32))


def test_every_method_takes_names(arm: phipsi.Scene, state: Any) -> None:
    q, qd, tau = state
    by_name = mapping(q), mapping(qd), mapping(tau)
    assert_same_bits(arm.inverse_dynamics(*by_name), arm.inverse_dynamics(*state))
    assert_same_bits(arm.bias_torque(*by_name[:2]), arm.bias_torque(q, qd))
    assert_same_bits(arm.mass_matrix(by_name[0]), arm.mass_matrix(q))
    assert_same_bits(arm.jacobian(by_name[0], "link3"), arm.jacobian(q, "link3"))
    assert_same_bits(arm.integrate(*by_name[:2]), arm.integrate(q, qd))
    assert_same_bits(arm.momentum(*by_name[:2]), arm.momentum(q, qd))
    assert_same_bits(arm.operational_inverse_inertia(by_name[0], "link3"), arm.operational_inverse_inertia(q, "link3"))
    assert_same_bits(arm.factor(by_name[0]).solve(by_name[2]), arm.factor(q).solve(tau))
    factor = arm.factor(arm.neutral())
    factor.update(by_name[0])  # type: ignore[arg-type]
    assert_same_bits(factor.solve(tau), arm.factor(q).solve(tau))
    assert_same_bits(arm.estimate(*by_name).acceleration, arm.estimate(*state).acceleration)
    assert_same_bits(arm.lock(["joint2"], by_name[0]).neutral(), np.zeros(6))
    assert arm.check(by_name[0]) == arm.check(q)
    assert_same_bits(
        arm.random_model(by_name[0]).sample_torque(3, seed=1), arm.random_model(q).sample_torque(3, seed=1)
    )


def test_simulate_takes_names(arm: phipsi.Scene, state: Any) -> None:
    q, qd, tau = state
    damping, rest = np.arange(1.0, 8.0), 0.1 * np.arange(7.0)
    law = phipsi.PD(np.arange(2.0, 9.0), 1.0, q)
    expected = arm.simulate(q, qd, dt=1e-3, steps=3, tau=tau, damping=damping, stiffness=1.0, rest=rest, pd=law)
    named = phipsi.PD(mapping(np.arange(2.0, 9.0)), 1.0, mapping(q))  # type: ignore[arg-type]
    found = arm.simulate(
        mapping(q), mapping(qd), dt=1e-3, steps=3, tau=mapping(tau), damping=mapping(damping), stiffness=1.0, rest=mapping(rest), pd=named
    )
    assert_same_bits(found.q, expected.q)


def test_equations_for_solvers_take_names(arm: phipsi.Scene, state: Any) -> None:
    pytest.importorskip("scipy")
    q, qd, tau = state
    damping = np.arange(1.0, 8.0)
    ode = arm.ode(tau=mapping(tau), damping=mapping(damping))  # type: ignore[arg-type]
    ode.center_at(mapping(q))  # type: ignore[arg-type]
    other = arm.ode(tau=tau, damping=damping)
    other.center_at(q)
    y = np.concatenate([np.zeros(7), qd])
    assert_same_bits(ode.rhs(0.0, y), other.rhs(0.0, y))


def test_joints_of_several_coordinates_in_a_dict(mixed: phipsi.Scene) -> None:
    q, qd, tau = random_states(mixed, 0)
    by_name = [
        {joint: values[index(joint)] for joint in reversed(mixed.joint_names)}
        for values, index in ((q, mixed.q_index), (qd, mixed.v_index), (tau, mixed.v_index))
    ]
    assert_same_bits(mixed.forward_dynamics(*by_name), mixed.forward_dynamics(q, qd, tau))


def test_one_label_does_not_tell_several_coordinates_apart(mixed: phipsi.Scene) -> None:
    pandas = pytest.importorskip("pandas")
    series = pandas.Series(np.zeros(len(mixed.joint_names)), index=list(mixed.joint_names))
    with pytest.raises(ArgumentError, match=r'q: found .*Series: joint "joint\d+" has \d entries here.*expected .*q\.to_numpy\(\)'):
        mixed.mass_matrix(series)


BY_POSITION = {
    "pandas series": lambda p, v: p.Series(v),
    "pandas frame": lambda p, v: p.DataFrame(v[None]),
    "nullable": lambda p, v: p.Series(v, dtype="Float64"),
    "list of series": lambda p, v: [p.Series(v)],
}


@pytest.mark.parametrize("kind", BY_POSITION)
def test_a_default_index_is_none(arm: phipsi.Scene, state: Any, kind: str) -> None:
    pandas = pytest.importorskip("pandas")
    q = state[0]
    assert_same_bits(arm.mass_matrix(BY_POSITION[kind](pandas, q)).reshape(7, 7), arm.mass_matrix(q))


REFUSED = {
    "shuffled numbers": (lambda p, v: p.Series(v[SHUFFLED], index=SHUFFLED), "its labels are no names"),
    "a slice": (lambda p, v: p.Series(np.r_[0, v])[1:], "its labels are no names"),
    "other names": (lambda p, v: p.Series(v, index=list("abcdefg")), 'without "joint0", .* with names that are not movable joints, "a", "b"'),
    "one missing": (lambda p, v: p.Series(v[:6], index=NAMES[:6]), 'without "joint6"; expected every joint once: "joint0"'),
    "twice": (lambda p, v: p.Series(v, index=("joint0", *NAMES[:6])), 'without "joint6" and with twice "joint0"'),
    "dates": (lambda p, v: p.Series(v, index=p.date_range("2026-01-01", periods=7)), "its labels are no names"),
    "tuples": (lambda p, v: p.Series(v, index=p.MultiIndex.from_product([["a"], NAMES])), "its labels are no names"),
    "an extra column": (lambda p, v: p.DataFrame(np.ones((2, 8)), columns=("time", *NAMES)), 'names that are not movable joints, "time"'),
    "names of rows": (lambda p, v: p.DataFrame(np.ones((7, 7)), index=NAMES), "the names are on another axis"),
    "a list of named": (lambda p, v: [p.Series(v, index=NAMES)], r"q\[0\]: found an object of type pandas.*Series"),
    "missing values": (lambda p, v: p.Series([*v[:6], None], dtype="Float64"), "q: found (dtype object|NaN)"),
    "text": (lambda p, v: p.Series(["1"] * 7), "q: found dtype"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_other_labels_are_refused(arm: phipsi.Scene, state: Any, case: str) -> None:
    pandas = pytest.importorskip("pandas")
    make, message = REFUSED[case]
    with pytest.raises((ArgumentError, NotFiniteError), match=message) as found:
        arm.mass_matrix(make(pandas, state[0]))
    assert found.value.argument.startswith("q")


def test_the_remedy_is_named(arm: phipsi.Scene, state: Any) -> None:
    pandas = pytest.importorskip("pandas")
    series = pandas.Series(state[0][SHUFFLED], index=SHUFFLED)
    with pytest.raises(ArgumentError, match=re.escape("q.to_numpy()")):
        arm.mass_matrix(series)
    arm.mass_matrix(series.to_numpy())


def test_names_where_no_joints_are(arm: phipsi.Scene) -> None:
    pandas = pytest.importorskip("pandas")
    labelled = pandas.Series([0.0, 0.0, -9.81], index=list("xyz"))
    with pytest.raises(ArgumentError, match="gravity: found .*Series: it has labels"):
        phipsi.SceneBuilder().link("base").build(gravity=labelled)
    with pytest.raises(ArgumentError, match="gravity: found an object of type dict"):
        phipsi.SceneBuilder().link("base").build(gravity={"x": 0, "y": 0, "z": 1})  # type: ignore[arg-type]
    # Fields of a tuple are interpreted by position.
    vector = collections.namedtuple("vector", "x y z")  # noqa: PYI024
    assert phipsi.SceneBuilder().link("base").build(gravity=vector(1, 2, 3)).gravity[2] == 3.0
    with pytest.raises(ArgumentError, match=r'wrenches\["link1"\]: found an object of type dict'):
        arm.forward_dynamics(*random_states(arm, 0), wrenches={"link1": {"fx": 1.0}})  # type: ignore[dict-item]


def test_other_tables_are_refused(arm: phipsi.Scene, state: Any) -> None:
    polars = pytest.importorskip("polars")
    with pytest.raises(ArgumentError, match='"column_0"'):
        arm.mass_matrix(polars.DataFrame(state[0][None]))
    with pytest.raises(ArgumentError, match=r"q: found .*LazyFrame.*q\.collect\(\)"):
        arm.mass_matrix(polars.DataFrame(state[0][None], schema=NAMES).lazy())
    assert_same_bits(arm.mass_matrix(polars.Series(state[0])), arm.mass_matrix(state[0]))


def test_dimensions_with_names_elsewhere(arm: phipsi.Scene) -> None:
    xarray = pytest.importorskip("xarray")
    turned = xarray.DataArray(np.ones((7, 7)), dims=("joint", "time"), coords={"joint": list(NAMES)})
    with pytest.raises(ArgumentError, match="the names are on another axis than the last; transpose it"):
        arm.mass_matrix(turned)
    assert arm.mass_matrix(xarray.DataArray(np.ones((2, 7)), dims=("time", "joint"))).shape == (2, 7, 7)


def test_units_are_not_converted(arm: phipsi.Scene, state: Any) -> None:
    units = pytest.importorskip("astropy.units")
    with pytest.raises(ArgumentError, match="q: found .*Quantity: units are not converted"):
        arm.mass_matrix(state[0] * units.deg)


BROKEN_DICTS: dict[str, tuple[Any, type[Exception], str]] = {
    "missing": ({name: 0.0 for name in NAMES[1:]}, ArgumentError, 'q: found an object of type dict without "joint0"; expected every joint once'),
    "unknown": ({name: 0.0 for name in (*NAMES, "elbow")}, ArgumentError, 'with names that are not movable joints, "elbow"'),
    "empty": ({}, ArgumentError, 'without "joint0", "joint1"'),
    "key": ({**dict.fromkeys(NAMES, 0.0), 7: 1.0}, ArgumentError, "q: found the key 7; expected names of joints"),
    "vector": ({**dict.fromkeys(NAMES, 0.0), "joint3": [1.0, 2.0]}, ShapeError, r'q\["joint3"\]: found shape \(2,\)'),
    "None": ({**dict.fromkeys(NAMES, 0.0), "joint3": None}, ArgumentError, r'q\["joint3"\]: found dtype object from None'),
    "NaN": ({**dict.fromkeys(NAMES, 0.0), "joint3": np.nan}, NotFiniteError, "q: found NaN at index 3"),
    "a list of dicts": ([dict.fromkeys(NAMES, 0.0)], ArgumentError, r"q\[0\]: found an object of type dict; expected numbers"),
}


@pytest.mark.parametrize("case", BROKEN_DICTS)
def test_one_broken_dict(arm: phipsi.Scene, case: str) -> None:
    given, error, message = BROKEN_DICTS[case]
    with pytest.raises(error, match=message):
        arm.mass_matrix(given)


def masked(values: np.ndarray, *entries: int) -> Any:
    mask = np.zeros(values.shape, bool)
    mask.reshape(-1)[list(entries)] = True
    return np.ma.MaskedArray(values, mask)


@pytest.mark.parametrize("argument", ["q", "qd", "tau"])
@pytest.mark.parametrize("batch", [(), (20,)])
def test_masked_entries_raise(arm: phipsi.Scene, argument: str, batch: tuple[int, ...]) -> None:
    given: dict[str, Any] = random_states(arm, 0, batch)._asdict()
    expected = arm.forward_dynamics(**given)
    # Without masked entries it is an ordinary array.
    assert_same_bits(arm.forward_dynamics(**(given | {argument: masked(given[argument])})), expected)
    given[argument] = masked(given[argument], 3, 5)
    with pytest.raises(ArgumentError, match=rf"{argument}: found a masked array with 2 of \d+ entries masked, the first at index 3"):
        arm.forward_dynamics(**given)


MASKED = {
    "in a list": lambda q: [masked(q, 2)],
    "a masked number in a list": lambda q: [*q[:6], np.ma.masked],
    "float32": lambda q: masked(q.astype(np.float32), 1),
    "integers": lambda q: masked(np.arange(7), 1),
    "a view": lambda q: masked(np.repeat(q, 2), 2)[::2],
    "all": lambda q: np.ma.masked_all(7),
    "in a dict": lambda q: {**dict.fromkeys(NAMES, 0.0), "joint2": np.ma.masked},
}


@pytest.mark.parametrize("case", MASKED)
def test_masks_are_seen_wherever_they_are(arm: phipsi.Scene, state: Any, case: str) -> None:
    with pytest.raises(ArgumentError, match="found a masked array"):
        arm.mass_matrix(MASKED[case](state[0]))


def test_masks_are_seen_by_every_argument(arm: phipsi.Scene, state: Any) -> None:
    q, qd, tau = state
    calls: list[Any] = [
        lambda x: arm.bias_torque(q, x),
        lambda x: arm.integrate(q, x),
        lambda x: arm.difference(q, x),
        lambda x: arm.lock(["joint1"], x),
        lambda x: arm.factor(q).solve(x),
        lambda x: arm.factor(q).K @ x,
        lambda x: arm.factor(q).I @ x,
        lambda x: arm.factor(q).D.inv() @ x,
        lambda x: arm.simulate(q, qd, dt=1e-3, steps=1, damping=x),
        lambda x: arm.simulate(q, qd, dt=1e-3, steps=1, tau=lambda *_: x),
        lambda x: arm.with_properties(damping=x),
        lambda x: arm.estimate(q, qd, tau, prior_acceleration=x),
        lambda x: arm.ode(tau=x),
    ]
    for call in calls:
        call(masked(np.ones(7)))
        with pytest.raises((ArgumentError, phipsi.errors.SimulationError), match="found a masked array"):
            call(masked(np.ones(7), 1))
    with pytest.raises(ArgumentError, match="gravity: found a masked array"):
        phipsi.SceneBuilder().link("base").build(gravity=masked(np.ones(3), 1))


def test_a_masked_out_is_refused(arm: phipsi.Scene, state: Any) -> None:
    with pytest.raises(ArgumentError, match="out: found a masked array; expected a C-contiguous float64 array"):
        arm.forward_dynamics(*state, out=masked(np.zeros(7)))


@pytest.mark.parametrize("batch", [(), (5,)])
def test_masked_torques_are_not_measured(arm: phipsi.Scene, batch: tuple[int, ...]) -> None:
    q, qd, tau = random_states(arm, 0, batch)
    tau[..., 2] = 1e9
    hidden = masked(tau, *range(2, tau.size, 7))
    expected = arm.estimate(q, qd, tau, noise=0.1, measured=[name for name in NAMES if name != "joint2"], covariance=True)
    for found in (
        arm.estimate(q, qd, hidden, noise=0.1, covariance=True),
        arm.estimate(q, qd, tau, noise=np.ma.MaskedArray(np.full(7, 0.1), np.arange(7) == 2), covariance=True),
    ):
        for one, other in zip(found, expected, strict=True):
            assert_same_bits(one, other)
    assert np.abs(arm.estimate(q, qd, hidden).acceleration).max() < 1e6


def test_masks_of_torques_differ_from_state_to_state(arm: phipsi.Scene) -> None:
    q, qd, tau = random_states(arm, 0, (2,))
    tau[0, 1] = tau[1, 5] = np.nan
    found = arm.estimate(q, qd, np.ma.masked_invalid(tau))
    for at, hidden in ((0, 1), (1, 5)):
        known = [name for name in NAMES if name != f"joint{hidden}"]
        assert_same_bits(found.acceleration[at], arm.estimate(q[at], qd[at], tau[at], measured=known).acceleration)
    with pytest.raises(NotFiniteError, match="tau: found NaN at index 1"):
        arm.estimate(q, qd, tau)


def test_what_is_measured_by_name(arm: phipsi.Scene, state: Any) -> None:
    expected = arm.estimate(*state, measured=["joint1", "joint4"])
    numbers, names = shuffled(np.isin(np.arange(7), [1, 4]))
    found = arm.estimate(*state, measured=numbers[np.argsort(SHUFFLED)])
    assert_same_bits(found.acceleration, expected.acceleration)
    pandas = pytest.importorskip("pandas")
    assert_same_bits(arm.estimate(*state, measured=pandas.Series(numbers, index=names)).acceleration, expected.acceleration)
    with pytest.raises(ArgumentError, match="measured: found .* expected names of joints, or a boolean array"):
        arm.estimate(*state, measured={"joint1": False})  # type: ignore[arg-type]


def generator() -> Any:
    yield from np.zeros(7)


def sparse() -> Any:
    return pytest.importorskip("scipy.sparse").csr_matrix(np.zeros((1, 7)))


NO_ARRAYS: dict[str, tuple[Any, str]] = {
    "generator": (generator, "q: found dtype object from an object of type generator; expected an array of real numbers.*list"),
    "map": (lambda: map(float, range(7)), "from an object of type map;.*list"),
    "set": (lambda: set(range(7)), "from an object of type set"),
    "dict view": (lambda: dict.fromkeys(NAMES, 0.0).values(), "from an object of type dict_values"),
    "sparse matrix": (sparse, r"from an object of type scipy\.sparse.*csr_matrix; .*toarray\(\)"),
    "str": (lambda: "0 0 0 0 0 0 0", "dtype <U13 from an object of type str"),
    "bytes": (lambda: b"0000000", "dtype |S7 from an object of type bytes"),
    "None": (lambda: None, "dtype object from None"),
    "object": (object, "from an object of type object"),
    "datetime": (lambda: [datetime.datetime(2026, 1, 1)] * 7, r"dtype object \(entry 0 is an object of type datetime.datetime\)"),
    "datetime64": (lambda: np.zeros(7, "M8[s]"), r"dtype datetime64\[s\]"),
    "timedelta64": (lambda: np.zeros(7, "m8[s]"), r"dtype timedelta64\[s\]"),
    "complex": (lambda: [1j] * 7, "dtype complex128;"),
    "truth values": (lambda: [True] * 7, "dtype bool;"),
    "object array": (lambda: np.zeros(7, object), "dtype object"),
    "records": (lambda: np.zeros(7, [("a", float)]), r"dtype \[\('a', '<f8'\)\]"),
    "a function": (lambda: len, "from an object of type builtin_function_or_method"),
    "a class": (lambda: float, "from an object of type type"),
    "mixed": (lambda: [0.0, "1", 2.0], r"dtype <U32 \(entry 1 is an object of type str\)"),
    "nested": (lambda: [[0.0] * 7, [0.0] * 6 + [None]], r"dtype object \(entry 6 is None\)"),
}


@pytest.mark.parametrize("case", NO_ARRAYS)
def test_what_is_no_array_is_named(arm: phipsi.Scene, case: str) -> None:
    make, message = NO_ARRAYS[case]
    for call in (arm.mass_matrix, arm.factor, lambda q: arm.simulate(q, np.zeros(7), dt=1e-3, steps=1)):
        with pytest.raises(ArgumentError, match=message) as found:
            call(make())
        assert found.value.argument == "q"


def test_a_list_that_holds_itself(arm: phipsi.Scene) -> None:
    endless: list[Any] = []
    endless.append(endless)
    with pytest.raises(ArgumentError, match="q: found"):
        arm.mass_matrix(endless)


def test_scalars_of_numpy_in_a_list(arm: phipsi.Scene, state: Any) -> None:
    assert_same_bits(arm.mass_matrix(list(state[0])), arm.mass_matrix(state[0]))


def test_a_dict_is_no_list_of_names(arm: phipsi.Scene) -> None:
    with pytest.raises(ArgumentError, match="joints: found .* expected a list of joint names"):
        arm.lock({"joint1": 0.5}, arm.neutral())


def test_subclasses_without_masks_or_units_are_arrays(arm: phipsi.Scene, state: Any) -> None:
    class Mine(np.ndarray):
        pass

    assert_same_bits(arm.forward_dynamics(*(values.view(Mine) for values in state)), arm.forward_dynamics(*state))


def test_a_label_that_is_an_attribute_s_name() -> None:
    """A Series has its labels as attributes, which must not be mistaken for those of its class."""
    pandas = pytest.importorskip("pandas")
    names = ["columns", "dims", "coords", "unit", "mask"]
    builder = phipsi.SceneBuilder().link("base")
    for k, name in enumerate(names):
        builder.link(f"link{k}", 1.0, (0.1, 0.2, 0.3), np.eye(3)).joint(name, "revolute", f"link{k - 1}" if k else "base", f"link{k}")
    scene = builder.build()
    q = np.arange(5.0)
    assert_same_bits(scene.mass_matrix(pandas.Series(q[::-1], index=names[::-1])), scene.mass_matrix(q))
    assert_same_bits(scene.mass_matrix(pandas.DataFrame(q[None, ::-1], columns=names[::-1]))[0], scene.mass_matrix(q))


def test_floating_bases_by_name() -> None:
    scene = random_scene(3, 3, kinds=("revolute",), floating_base=True)
    q, qd, tau = random_states(scene, 0)
    by_name = {joint: q[scene.q_index(joint)] for joint in scene.joint_names}
    assert_same_bits(scene.mass_matrix(by_name), scene.mass_matrix(q))
