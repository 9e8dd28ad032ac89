"""Every URDF of example-robot-data compared with Pinocchio, with fixed and with floating base."""

from __future__ import annotations

import functools
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from oracle_pinocchio import ROBOTS, Oracle, load, urdf_files
from tolerances import EPS, inverse, recursion, solve

import phipsi
from phipsi.errors import InertiaWarning, LimitWarning, MimicWarning, SceneError, SingularJointError, UnknownTagWarning

STATES = 3
FILES = urdf_files()

EMPTY = "ur_description/urdf/ur3.urdf"
"""A placeholder: a <robot> without links."""

SINGULAR = {
    "romeo_description/urdf/romeo.urdf": "RThumb3",
    "romeo_description/urdf/romeo_laas_small.urdf": "r_gripper_joint",
}
"""Robots with finger joints that move no mass, and the first such joint in a sweep from the tips."""

UNPHYSICAL = {
    "alex_description/urdf/alex_psyonic_hands.urdf",
    "allegro_hand_description/urdf/allegro_left_hand.urdf",
    "allegro_hand_description/urdf/allegro_right_hand.urdf",
    "anymal_b_simple_description/robots/anymal-kinova.urdf",
    "anymal_b_simple_description/robots/anymal.urdf",
    "anymal_c_simple_description/urdf/anymal.urdf",
    "b1_description/urdf/b1-z1.urdf",
    "b1_description/urdf/b1.urdf",
    "go1_description/urdf/go1.urdf",
    "hyq_description/robots/hyq_no_sensors.urdf",
    "icub_description/robots/icub.urdf",
    "icub_description/robots/icub_reduced.urdf",
    "pr2_description/urdf/pr2.urdf",
    "romeo_description/urdf/romeo_laas_small.urdf",
    "romeo_description/urdf/romeo_small.urdf",
    "tiago_description/robots/tiago.urdf",
    "tiago_description/robots/tiago_dual.urdf",
    "tiago_description/robots/tiago_no_hand.urdf",
}
"""Robots with a link whose inertia is physically impossible."""

#: Files whose joints are all locked by limits that were not entered.
LOCKED = {f"double_pendulum_description/urdf/double_pendulum{name}.urdf" for name in ("", "_simple")}

#: Files with unknown elements or attributes, and the first of them.
NOT_UNDERSTOOD = {
    "anymal_b_simple_description/robots/anymal-kinova.urdf": 'attribute command_effort of <limit> of joint "LF_HAA"',
    "anymal_b_simple_description/robots/anymal.urdf": 'attribute command_effort of <limit> of joint "LF_HAA"',
    "panda_description/urdf/panda.urdf": 'attribute D of <dynamics> of joint "panda_joint1"',
    "panda_description/urdf/panda_collision.urdf": 'attribute D of <dynamics> of joint "panda_joint1"',
    "pr2_description/urdf/pr2.urdf": '<turnGravityOff> in <gazebo> of "wide_stereo_gazebo_l_stereo_camera_frame"',
    "so_arm_description/urdf/so101.urdf": '<origin> in link "gripper_frame_link"',
    "tiago_description/robots/tiago_dual.urdf": '<kinematic> in link "suspension_right_link"',
    "tiago_pro_description/robots/tiago_pro.urdf": '<kinematic> in link "suspension_front_right_link"',
}

REAL = [file for file in FILES if file != EMPTY]
REGULAR = [file for file in REAL if file not in SINGULAR]

robots = pytest.mark.parametrize("file", REAL)
regular_robots = pytest.mark.parametrize("file", REGULAR)
bases = pytest.mark.parametrize("floating_base", [False, True], ids=["fixed", "floating"])


class Off(NamedTuple):
    """Difference of phipsi and Pinocchio, and its bound."""

    found: float
    bound: float
    units: float
    """found in units of n eps or cond eps of the magnitude of the quantity."""


class States(NamedTuple):
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    tau: np.ndarray
    wrenches: dict[str, np.ndarray]

    def at(self, i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        return self.q[i], self.qd[i], self.qdd[i], self.tau[i], {link: w[i] for link, w in self.wrenches.items()}


def states_of(scene: phipsi.Scene, floating_base: bool) -> States:
    """Random states: angles in a full turn, uniform quaternions, a wrench on every third link, including merged
    ones.
    """
    random = np.random.default_rng(len(scene.link_names))
    q = random.uniform(-np.pi, np.pi, (STATES, scene.nq))
    if floating_base:
        quaternion = random.normal(size=(STATES, 4))
        q[:, :3] = random.uniform(-1.0, 1.0, (STATES, 3))
        q[:, 3:7] = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    qd, qdd, tau = random.uniform(-2.0, 2.0, (3, STATES, scene.nv))
    wrenches = {link: random.uniform(-3.0, 3.0, (STATES, 6)) for link in scene.link_names[::3]}
    return States(q, qd, qdd, 5.0 * tau, wrenches)


@functools.cache
def pair(file: str, floating_base: bool) -> tuple[phipsi.Scene, Oracle, States]:
    scene, _ = load(file, floating_base)
    return scene, Oracle(file, floating_base, scene), states_of(scene, floating_base)


def largest(*values: np.ndarray) -> float:
    """Largest absolute entry; NaN if there is one, 0 without entries."""
    return max((float(np.max(np.abs(v), initial=0.0)) for v in values), key=lambda x: (np.isnan(x), x))


def in_units(found: float, unit: float) -> float:
    return 0.0 if found == 0.0 else (found / unit if unit > 0.0 else np.inf)


def recursions_apart(n: int, found: np.ndarray, expected: np.ndarray, scale: float = 0.0) -> Off:
    """Difference in units of n eps; the scale is that of the results over the states, or the given one if it is
    larger.
    """
    assert found.shape == expected.shape
    off, scale = largest(found - expected), max(scale, largest(expected))
    return Off(off, recursion(n, scale), in_units(off, max(n, 1) * EPS * scale))


def inverses_apart(
    bound: Callable[[float, float], float], conditions: list[float], found: np.ndarray, expected: np.ndarray
) -> Off:
    """Difference in units of cond eps, for the worst state."""
    assert found.shape == expected.shape
    states = []
    for condition, one, other in zip(conditions, found, expected, strict=True):
        off, scale = largest(one - other), largest(other)
        states.append(Off(off, bound(condition, scale), in_units(off, condition * EPS * scale)))
    return max(states, key=lambda state: (np.isnan(state.units), state.units))


@functools.cache
def recursions(file: str, floating_base: bool) -> dict[str, Off]:
    """Quantities without a solve: by name, in units of n eps."""
    scene, oracle, states = pair(file, floating_base)
    n = scene.nv
    q, qd, qdd, _, wrenches = states

    def there(method: Callable[..., object], *arguments: np.ndarray) -> np.ndarray:
        return np.stack([np.asarray(method(*each)) for each in zip(*arguments, strict=True)])

    torque = np.stack(
        [oracle.inverse_dynamics(q, qd, qdd, wrenches) for q, qd, qdd, _, wrenches in map(states.at, range(STATES))]
    )
    here, expected = scene.placements(q), [oracle.placements(each) for each in q]
    assert set(here) == set(expected[0])
    names = list(here)
    placements = np.stack([np.stack([at[name] for name in names]) for at in expected])
    jacobians = np.stack([np.stack([oracle.jacobian(each, name) for each in q]) for name in names])
    energy, energies = scene.energy(q, qd), there(oracle.energy, q, qd)
    reach = max(1.0, largest(placements[..., :3, 3]))
    weight = oracle.mass * float(np.linalg.norm(scene.gravity)) * reach
    return {
        "RNEA": recursions_apart(n, scene.inverse_dynamics(q, qd, qdd, wrenches=wrenches), torque),
        "bias": recursions_apart(n, scene.bias_torque(q, qd), there(oracle.bias_torque, q, qd)),
        "CRBA": recursions_apart(n, scene.mass_matrix(q), there(oracle.mass_matrix, q)),
        "placements": recursions_apart(n, np.stack([here[name] for name in names], axis=1), placements),
        "Jacobian": recursions_apart(n, np.stack([scene.jacobian(q, name) for name in names]), jacobians),
        "kinetic energy": recursions_apart(n, energy.kinetic, energies[:, 0]),
        "potential energy": recursions_apart(n, energy.potential, energies[:, 1], weight),
        "momentum": recursions_apart(n, scene.momentum(q, qd), there(oracle.momentum, q, qd)),
    }


@functools.cache
def inverses(file: str, floating_base: bool) -> dict[str, Off]:
    """Quantities that involve the inverse of M: by name, in units of cond(M) eps."""
    scene, oracle, states = pair(file, floating_base)
    q, qd, _, tau, wrenches = states
    masses = [oracle.mass_matrix(each) for each in q]
    conditions = [float(np.linalg.cond(m)) if m.size else 1.0 for m in masses]
    accelerations = np.stack(
        [oracle.forward_dynamics(q, qd, tau, wrenches) for q, qd, _, tau, wrenches in map(states.at, range(STATES))]
    )
    inverse_here = scene.mass_matrix_inverse(q)
    inverse_there = np.stack([oracle.mass_matrix_inverse(each) for each in q])
    by_numpy = np.stack([np.linalg.inv(m) for m in masses])
    qdd = scene.forward_dynamics(q, qd, tau, wrenches=wrenches)
    return {
        "ABA": inverses_apart(inverse, conditions, qdd, accelerations),
        "M^-1": inverses_apart(inverse, conditions, inverse_here, inverse_there),
        "M^-1 by NumPy": inverses_apart(solve, conditions, inverse_here, by_numpy),
    }


def assert_within(offs: dict[str, Off]) -> None:
    bad = [f"{name}: {off.found:.3g} apart, {off.units:.3g} units, bound {off.bound:.3g}"
           for name, off in offs.items() if not off.found <= off.bound]
    assert not bad, "; ".join(bad)


@bases
@robots
def test_without_a_solve_as_pinocchio(file: str, floating_base: bool) -> None:
    """RNEA, bias, CRBA, forward kinematics, Jacobians, energies and momentum: to n eps, including singular models."""
    assert_within(recursions(file, floating_base))


@bases
@regular_robots
def test_through_the_inverse_as_pinocchio(file: str, floating_base: bool) -> None:
    """ABA and M^-1: to cond(M) eps."""
    assert_within(inverses(file, floating_base))


@bases
@pytest.mark.parametrize("file", SINGULAR)
def test_a_joint_that_moves_no_mass_is_named(file: str, floating_base: bool) -> None:
    scene, _, (q, qd, _, tau, _) = pair(file, floating_base)
    calls: list[Callable[[], object]] = [
        lambda: scene.forward_dynamics(q, qd, tau),
        lambda: scene.mass_matrix_inverse(q),
        lambda: scene.factor(q),
    ]
    for call in calls:
        with pytest.raises(SingularJointError, match=f'"{SINGULAR[file]}"') as caught:
            call()
        assert (caught.value.joint, caught.value.state) == (SINGULAR[file], 0)


@bases
def test_the_empty_stub_raises(floating_base: bool) -> None:
    with pytest.raises(SceneError, match=r"ur3\.urdf.*without links"):
        load(EMPTY, floating_base)


@robots
def test_unphysical_inertias_warn_by_link_and_raise_when_strict(file: str) -> None:
    """Exactly 18 of the files, which have 17 names."""
    scene, caught = load(file, False)
    named = [
        re.search(r'link "([^"]+)"', str(warning.message)) for warning in caught if warning.category is InertiaWarning
    ]
    assert bool(named) == (file in UNPHYSICAL)
    links = [found.group(1) for found in named if found]
    assert len(links) == len(named)
    assert len(set(links)) == len(links) and set(links) <= set(scene.link_names)
    inertias = inertias_of(file)
    for link in links:
        assert not is_physical(inertias[link], slack=0.0), link
    for link in set(inertias) - set(links):
        assert is_physical(inertias[link], slack=ROUNDED), link
    if file in UNPHYSICAL:
        with pytest.raises(SceneError, match="strict") as error:
            load(file, False, strict=True)
        assert f'link "{links[0]}"' in str(error.value)
    elif file not in {*NOT_UNDERSTOOD, *LOCKED}:
        assert load(file, False, strict=True)[0].nv == scene.nv


@robots
def test_what_is_not_understood_is_one_warning_and_raises_when_strict(file: str) -> None:
    texts = [str(warning.message) for warning in load(file, False)[1] if warning.category is UnknownTagWarning]
    assert len(texts) == (file in NOT_UNDERSTOOD)
    if texts:
        assert f"ignored: {NOT_UNDERSTOOD[file]} (line " in texts[0]
        with pytest.raises(SceneError, match="strict"):
            load(file, False, strict=True)


ROUNDED = 1e-4
"""Relative tolerance of the triangle inequality for inertias with few digits; that of phipsi is smaller."""


def inertias_of(file: str) -> dict[str, np.ndarray]:
    """Link name to rotational inertia, read by the standard library's parser."""
    inertias = {}
    for link in ET.parse(ROBOTS / file).getroot().iter("link"):
        found = link.find("inertial/inertia")
        if found is not None:
            xx, xy, xz, yy, yz, zz = (float(found.get(key, "0")) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
            inertias[link.get("name", "")] = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return inertias


def is_physical(inertia: np.ndarray, slack: float) -> bool:
    """Whether no principal inertia is negative or larger than the sum of the others, by NumPy's eigenvalues."""
    low, middle, high = np.linalg.eigvalsh(inertia)
    return bool(low >= -slack * high and low + middle >= high * (1.0 - slack))


@pytest.mark.parametrize("file", REAL)
def test_mimic_joints_warn_by_name(file: str) -> None:
    scene, caught = load(file, False)
    text = [str(warning.message) for warning in caught if warning.category is MimicWarning]
    movable = set(scene.joint_names)
    expected = {}
    for joint in ET.parse(ROBOTS / file).getroot().findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None and joint.get("name") in movable:
            expected[joint.get("name")] = mimic.get("joint")
    assert len(text) == len(expected)
    for joint, leader in expected.items():
        assert any(f'joint "{joint}": mimics "{leader}"' in message for message in text), joint
    assert {warning.category for warning in caught} <= {InertiaWarning, LimitWarning, MimicWarning, UnknownTagWarning}


@pytest.mark.parametrize("file", REAL)
def test_joints_whose_limits_are_all_zero_warn_by_name(file: str) -> None:
    scene, caught = load(file, False)
    texts = [str(warning.message) for warning in caught if warning.category is LimitWarning]
    assert [text for text in texts if "locked in simulations" in text] == texts and len(texts) == (file in LOCKED)
    for text in texts:
        assert text.startswith('joints "joint1", "joint2" with limits each of zero for lower, upper, effort and velocity')
        with pytest.raises(SceneError, match="strict"):
            load(file, False, strict=True)


def test_summary(capsys: pytest.CaptureFixture[str]) -> None:
    """Loads 68 of 69 files in both programs, and prints the largest differences of all."""
    loaded = {floating_base: 0 for floating_base in (False, True)}
    for floating_base in loaded:
        for file in FILES:
            try:
                pair(file, floating_base)
            except SceneError:
                assert file == EMPTY
            else:
                loaded[floating_base] += 1
    assert len(FILES) == 69
    assert loaded == {False: 68, True: 68}
    assert len(UNPHYSICAL) == 18 and len({file.rsplit("/", 1)[-1] for file in UNPHYSICAL}) == 17

    def worst(measure: Callable[[str, bool], dict[str, Off]], files: list[str], name: str) -> str:
        offs = [(measure(file, base)[name].units, file, base) for file in files for base in (False, True)]
        units, file, base = max(offs, key=lambda off: (np.isnan(off[0]), off[0]))
        assert np.isfinite(units)
        return f"{units:.2g} {{}} ({file.rsplit('/', 1)[-1]}, {'floating' if base else 'fixed'})"

    parts = [f"{name} {worst(recursions, REAL, name).format('n eps')}" for name in ("RNEA", "CRBA")]
    parts += [f"{name} {worst(inverses, REGULAR, name).format('cond eps')}" for name in ("ABA", "M^-1")]
    others = [f"{name} {worst(recursions, REAL, name).format('n eps')}" for name in recursions(REAL[0], True)]
    others.append(f"M^-1 beside NumPy's {worst(inverses, REGULAR, 'M^-1 by NumPy').format('cond eps')}")
    with capsys.disabled():
        print(
            f"\nexample-robot-data: loaded {loaded[True]} of {len(FILES)}, fixed and floating; "
            f"largest disagreement with Pinocchio: {', '.join(parts)}"
        )
        print(f"and of the rest: {', '.join(o for o in others if o not in parts)}")
