"""Kinematic quantities: single links, center of mass, momentum about it. Compared with Pinocchio on real robots, 60 digits
and identities.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from conftest import OF_MASS, POINT, random_scene, random_states
from oracle_mpmath import KINDS, STEP, State, Tree, exact, identity, moved, random_tree, rounded, skew
from oracle_pinocchio import SWAP, Oracle, load
from test_pinocchio import bases, robots
from tolerances import EPS, assert_near, assert_same_bits, product, recursion, size

import phipsi
from phipsi.errors import ArgumentError, NotFiniteError, PhipsiError, ShapeError

FRAMES = {
    "local": pin.ReferenceFrame.LOCAL,
    "world": pin.ReferenceFrame.WORLD,
    "local-world-aligned": pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
}
worst: dict[str, float] = {}
"""Largest error of the tests so far compared with Pinocchio, by quantity, in units of n eps of its magnitude."""


def largest(values: np.ndarray) -> float:
    return float(np.max(np.abs(values), initial=0.0))


class Moving(NamedTuple):
    """A robot in one state, and the same in Pinocchio with all derivatives of its kinematics in `data`."""

    scene: phipsi.Scene
    oracle: Oracle
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    scale: float
    """Magnitude of the accelerations of its links, in all frames: of the terms of their sums."""


@functools.cache
def robot(file: str, floating_base: bool) -> Moving:
    scene, _ = load(file, floating_base)
    random = np.random.default_rng(scene.nv)
    q = scene.integrate(scene.neutral(), random.uniform(-np.pi, np.pi, scene.nv))
    qd, qdd = random.uniform(-2.0, 2.0, (2, scene.nv))
    oracle = Oracle(file, floating_base, scene)
    model = oracle.model
    for link in some_links(scene):
        own = model.frames[oracle.frame(link)]
        placement = own.placement * pin.SE3(np.eye(3), np.array(POINT))
        model.addFrame(pin.Frame(f"point of {link}", own.parentJoint, oracle.frame(link), placement, pin.FrameType.OP_FRAME))
    oracle.data = model.createData()
    there = oracle.configuration(q), oracle.there(qd), oracle.there(qdd)
    pin.forwardKinematics(model, oracle.data, *there)
    if scene.nv:
        pin.computeJointJacobiansTimeVariation(model, oracle.data, *there[:2])
    pin.forwardKinematics(model, oracle.data, *there)
    pin.updateFramePlacements(model, oracle.data)
    accelerations = [
        pin.getAcceleration(model, oracle.data, joint, frame).vector for joint in range(model.njoints) for frame in FRAMES.values()
    ]
    return Moving(scene, oracle, q, qd, qdd, max(1.0, largest(np.array(accelerations))))


def some_links(scene: phipsi.Scene) -> list[str]:
    """The root, which is on a fixed base, the last link, and some between, many of them on fixed joints."""
    names = scene.link_names
    return sorted({names[at * (len(names) - 1) // 5] for at in range(6)})


def beside_pinocchio(name: str, found: np.ndarray, expected: np.ndarray, n: int, scale: float) -> None:
    """To n eps of the terms."""
    scale = max(scale, largest(expected))
    assert_near(found, expected, recursion(n, scale))
    off = largest(found - expected) / (max(n, 1) * EPS * scale) if scale else 0.0
    worst[name] = max(worst.get(name, 0.0), off)


@bases
@robots
def test_links_as_pinocchio(file: str, floating_base: bool) -> None:
    scene, oracle, q, qd, qdd, scale = robot(file, floating_base)
    model, data, n = oracle.model, oracle.data, scene.nv
    links = some_links(scene)
    for link in links:
        beside_pinocchio("placement", scene.placement(q, link), data.oMf[oracle.frame(link)].homogeneous, n, 1.0)
        for at, index in ((None, oracle.frame(link)), (POINT, model.getFrameId(f"point of {link}"))):
            for name, frame in FRAMES.items():

                def check(method: str, *arguments: Any, expected: np.ndarray, **more: Any) -> None:
                    given = {"frame": name, "at": at, **more}
                    found = getattr(scene, method)(q, *arguments, link, **given)
                    beside_pinocchio(f"{method} {name} {more.get('kind', '')}", found, expected, n, scale)

                check("velocity", qd, expected=pin.getFrameVelocity(model, data, index, frame).vector[SWAP])
                spatial = pin.getFrameAcceleration(model, data, index, frame).vector[SWAP]
                check("acceleration", qd, qdd, expected=spatial)
                check("acceleration", qd, qdd, expected=spatial, kind="spatial")
                classical = pin.getFrameClassicalAcceleration(model, data, index, frame).vector[SWAP]
                check("acceleration", qd, qdd, expected=classical, kind="classical")
                if n == 0:
                    # Pinocchio terminates the process in this case.
                    assert scene.jacobian(q, link, frame=name).shape == scene.jacobian_rate(q, qd, link, frame=name).shape == (6, 0)
                    continue
                check("jacobian", expected=oracle.here(pin.getFrameJacobian(model, data, index, frame))[SWAP])
                rate = oracle.here(pin.getFrameJacobianTimeVariation(model, data, index, frame))[SWAP]
                check("jacobian_rate", qd, expected=rate)
                check("jacobian_rate_product", qd, expected=rate @ qd)
    all_of_them = np.stack([data.oMf[oracle.frame(link)].homogeneous for link in links])
    beside_pinocchio("placement of several", scene.placement(q, links), all_of_them, n, 1.0)


@bases
@robots
def test_the_center_of_mass_as_pinocchio(file: str, floating_base: bool) -> None:
    scene, oracle, q, qd, qdd, scale = robot(file, floating_base)
    model, n = oracle.model, scene.nv
    if n == 0:
        assert scene.total_mass == scene.kinetic_energy(q, qd) == 0.0 and scene.gravity_torque(q).shape == (0,)
        return
    there = oracle.configuration(q), oracle.there(qd), oracle.there(qdd)
    beside_pinocchio("gravity_torque", scene.gravity_torque(q), oracle.here(pin.computeGeneralizedGravity(model, model.createData(), there[0])), n, 0.0)
    beside_pinocchio("kinetic_energy", scene.kinetic_energy(q, qd), np.float64(oracle.energy(q, qd)[0]), n, 0.0)
    beside_pinocchio("potential_energy", scene.potential_energy(q), np.float64(oracle.energy(q, qd)[1]), n, 0.0)
    assert_near(scene.total_mass, oracle.mass, recursion(len(scene.link_names), oracle.mass))
    if scene.total_mass == 0.0:
        return
    data, other, third = model.createData(), model.createData(), model.createData()
    pin.centerOfMass(model, data, *there)
    beside_pinocchio("center_of_mass", scene.center_of_mass(q), data.com[0], n, 1.0)
    beside_pinocchio("center_of_mass_velocity", scene.center_of_mass_velocity(q, qd), data.vcom[0], n, scale)
    beside_pinocchio("center_of_mass_acceleration", scene.center_of_mass_acceleration(q, qd, qdd), data.acom[0], n, scale)
    jacobian = oracle.here(pin.jacobianCenterOfMass(model, other, there[0]))
    beside_pinocchio("center_of_mass_jacobian", scene.center_of_mass_jacobian(q), jacobian, n, 1.0)
    momentum = oracle.here(pin.ccrba(model, other, *there[:2]))[SWAP]
    beside_pinocchio("centroidal_momentum_matrix", scene.centroidal_momentum_matrix(q), momentum, n, oracle.mass)
    beside_pinocchio("momentum", scene.centroidal_momentum_matrix(q) @ qd, other.hg.vector[SWAP], n, oracle.mass * scale)
    # Its alias computeCentroidalMapTimeVariation does not return the derivative of A in Python: it differs from
    # differences of A by 0.5.
    rate = oracle.here(pin.dccrba(model, third, *there[:2]))[SWAP]
    beside_pinocchio("centroidal_momentum_matrix_rate", scene.centroidal_momentum_matrix_rate(q, qd), rate, n, oracle.mass * scale)


#: Moving quantities, by name: none, only accelerations, one joint, all.
STATES: dict[str, Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]] = {
    "at rest": lambda qd, qdd: (0 * qd, 0 * qdd),
    "starting": lambda qd, qdd: (0 * qd, qdd),
    "one joint": lambda qd, qdd: (np.eye(1, len(qd), len(qd) // 2)[0] * qd, 0 * qdd),
    "moving": lambda qd, qdd: (qd, qdd),
}


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("scene", ["arm", "mixed", "floating"])
def test_identities(request: pytest.FixtureRequest, scene: str, state: str) -> None:
    scene = request.getfixturevalue(scene)
    q, qd, qdd = random_states(scene, 3)
    qd, qdd = STATES[state](qd, qdd)
    n, scale = scene.nv, 1.0
    for link in scene.link_names:
        placement = scene.placement(q, link)
        assert_near(scene.placements(q)[link], placement, product(n, size(placement)))
        for frame in FRAMES:
            given: dict[str, Any] = {"frame": frame, "at": POINT}
            jacobian, rate = scene.jacobian(q, link, **given), scene.jacobian_rate(q, qd, link, **given)
            scale = size(jacobian, rate) * size(qd, qdd) * size(qd)
            velocity, along = scene.velocity(q, qd, link, **given), scene.jacobian_rate_product(q, qd, link, **given)
            assert_near(jacobian @ qd, velocity, product(n, scale))
            assert_near(rate @ qd, along, product(n, scale))
            kind = "classical" if frame == "local-world-aligned" else "spatial"
            acceleration = scene.acceleration(q, qd, qdd, link, kind=kind, **given)
            assert_near(jacobian @ qdd + along, acceleration, product(n, scale))
    mass, matrix = scene.total_mass, scene.centroidal_momentum_matrix(q)
    center, jacobian = scene.center_of_mass(q), scene.center_of_mass_jacobian(q)
    assert_near(mass, sum(scene.link(name).mass for name in scene.link_names if name in moving_links(scene)), product(n, mass))
    scale = size(matrix, center) * size(qd, qdd) * size(qd) * size(center)
    assert_near(mass * jacobian, matrix[3:], product(n, scale))
    assert_near(scene.center_of_mass_velocity(q, qd), jacobian @ qd, product(n, scale))
    about_origin = scene.momentum(q, qd)
    about_center = np.concatenate([about_origin[:3] - np.cross(center, about_origin[3:]), about_origin[3:]])
    assert_near(matrix @ qd, about_center, product(n, scale))
    rate = scene.centroidal_momentum_matrix_rate(q, qd)
    scale *= size(qd)
    assert_near(scene.center_of_mass_acceleration(q, qd, qdd), jacobian @ qdd + rate[3:] @ qd / mass, product(n, scale))
    assert_same_bits(scene.kinetic_energy(q, qd), scene.energy(q, qd).kinetic)
    assert_same_bits(scene.potential_energy(q), scene.energy(q, qd).potential)
    assert_same_bits(scene.gravity_torque(q), scene.bias_torque(q, np.zeros(n)))


def moving_links(scene: phipsi.Scene) -> set[str]:
    """Movable links, by the effect of the configuration on their poses."""
    here, there = (scene.placements(random_states(scene, seed).q) for seed in (0, 1))
    return {name for name in here if not np.array_equal(here[name], there[name])}


class Exact:
    """60 digits in a state, and the derivatives along qd of functions of q."""

    def __init__(self, tree: Tree, q: np.ndarray, qd: np.ndarray) -> None:
        q, qd = exact(q), exact(qd)
        self.tree, self.q, self.qd = tree, q, qd
        self.here = State(tree, q, qd)
        self.ahead, self.back = (State(tree, moved(tree, q, qd, step), qd) for step in (STEP, -STEP))

    def along(self, quantity: Callable[[State], np.ndarray]) -> np.ndarray:
        return rounded((quantity(self.ahead) - quantity(self.back)) / (2 * STEP))


def aligned(state: State, link: str) -> np.ndarray:
    """J of the point in the base frame."""
    lever = state.rotation[link] @ exact(np.array(POINT))
    return np.concatenate([state.angular[link], state.linear[link] - skew(lever) @ state.angular[link]])


def world(state: State, link: str) -> np.ndarray:
    """J of the material point at the origin of the base."""
    return np.concatenate([state.angular[link], state.linear[link] + skew(state.position[link]) @ state.angular[link]])


def center_of_mass(state: State) -> np.ndarray:
    total = sum(exact(np.array(link.mass)) for link in state.links)
    return sum(exact(np.array(link.mass)) * (state.position[link.name] + state.rotation[link.name] @ exact(link.com)) for link in state.links) / total


def centroidal(state: State) -> np.ndarray:
    """A from its definition: contribution of each link to the momentum."""
    found, center = np.zeros((6, state.nv)), center_of_mass(state)
    for link in state.links:
        mass, central = exact(np.array(link.mass)), state.rotation[link.name] @ exact(link.inertia) @ state.rotation[link.name].T
        lever = state.rotation[link.name] @ exact(link.com)
        push = mass * (state.linear[link.name] - skew(lever) @ state.angular[link.name])
        turning = central @ state.angular[link.name] + skew(state.position[link.name] + lever - center) @ push
        found = found + np.concatenate([turning, push])
    return found


@functools.cache
def in_60_digits(seed: int) -> tuple[phipsi.Scene, Exact, np.ndarray, np.ndarray]:
    """A scene, its oracle, and q and qd."""
    random = np.random.default_rng(seed)
    tree = random_tree(random, 5, kinds=tuple(np.roll(KINDS, seed)), most=8, armature=0.3, floating_base=seed % 2 == 1, branching=0.5)
    scene = tree.scene()
    q = scene.integrate(scene.neutral(), random.uniform(-2.5, 2.5, scene.nv))
    qd = random.uniform(-2.0, 2.0, scene.nv)
    return scene, Exact(tree, q, qd), q, qd


@pytest.mark.parametrize("seed", range(6))
def test_links_against_60_digits(seed: int) -> None:
    scene, oracle, q, qd = in_60_digits(seed)
    n = scene.nv
    for link in scene.link_names:
        pose = rounded(oracle.here.placement(link))
        assert_near(scene.placement(q, link), pose, product(n, size(pose)))
        for jacobian, given in (
            (lambda state, link=link: state.jacobian(link), {}),
            (lambda state, link=link: aligned(state, link), {"frame": "local-world-aligned", "at": POINT}),
            (lambda state, link=link: world(state, link), {"frame": "world", "at": POINT}),
        ):
            expected, rate = rounded(jacobian(oracle.here)), oracle.along(jacobian)
            scale = size(expected, rate) * size(qd)
            assert_near(scene.jacobian(q, link, **given), expected, product(n, scale))
            assert_near(scene.velocity(q, qd, link, **given), expected @ qd, product(n, scale))
            assert_near(scene.jacobian_rate(q, qd, link, **given), rate, product(n, scale))
            assert_near(scene.jacobian_rate_product(q, qd, link, **given), rate @ qd, product(n, scale))


@pytest.mark.parametrize("seed", range(6))
def test_the_center_of_mass_against_60_digits(seed: int) -> None:
    scene, oracle, q, qd = in_60_digits(seed)
    n, mass = scene.nv, scene.total_mass
    center, matrix = rounded(center_of_mass(oracle.here)), rounded(centroidal(oracle.here))
    assert_near(scene.center_of_mass(q), center, product(n, size(center)))
    assert_near(scene.center_of_mass_velocity(q, qd), oracle.along(center_of_mass), product(n, size(matrix)))
    assert_near(scene.centroidal_momentum_matrix(q), matrix, product(n, size(matrix)))
    rate = oracle.along(centroidal)
    assert_near(scene.centroidal_momentum_matrix_rate(q, qd), rate, product(n, size(matrix, rate)))
    expected = rate[3:] @ qd / mass + matrix[3:] @ (3 * qd) / mass
    assert_near(scene.center_of_mass_acceleration(q, qd, 3 * qd), expected, product(n, size(matrix, rate) * size(qd)))
    assert_near(scene.kinetic_energy(q, qd), float(oracle.here.energy[0]), product(n, size(float(oracle.here.energy[0]))))

    exact = float(oracle.here.energy[1])
    assert_near(scene.potential_energy(q), exact, product(n, size(exact, mass * 9.81 * size(center))))

    def potential(unit: np.ndarray) -> float:
        ahead, back = (State(oracle.tree, moved(oracle.tree, oracle.q, unit, step), oracle.qd).energy[1] for step in (STEP, -STEP))
        return float((ahead - back) / (2 * STEP))

    expected = np.array([potential(unit) for unit in identity(n)])
    assert_near(scene.gravity_torque(q), expected, product(n, size(expected)))


@pytest.mark.parametrize("far", [1e3, 1e6])
def test_far_from_the_origin_the_momentum_keeps_its_digits(far: float) -> None:
    """In the frame that moves with the robot, errors depend only on the size of the robot."""
    scene = random_scene(2, 9, floating_base=True, kinds=("revolute", "prismatic", "spherical"))
    q, qd, qdd = random_states(scene, 1)
    away = q.copy()
    away[:3] += far
    link = scene.link_names[-1]
    for call in (
        scene.centroidal_momentum_matrix,
        scene.center_of_mass_jacobian,
        lambda q: scene.centroidal_momentum_matrix_rate(q, qd),
        lambda q: scene.center_of_mass_acceleration(q, qd, qdd),
        lambda q: scene.acceleration(q, qd, qdd, link, frame="local-world-aligned", at=POINT, kind="classical"),
        lambda q: scene.jacobian_rate(q, qd, link),
    ):
        expected = call(q)
        assert_near(call(away), expected, product(1, size(expected)))


def test_links_on_the_base_do_not_move_and_are_not_of_the_mass() -> None:
    builder = phipsi.SceneBuilder().link("base", 5.0).link("mast", 3.0).link("arm", 2.0, (1, 0, 0), np.eye(3)).link("hand", 1.0)
    builder.joint("weld", "fixed", "base", "mast", xyz=(0, 0, 1)).joint("turn", "revolute", "mast", "arm")
    builder.joint("grip", "fixed", "arm", "hand", xyz=(2, 0, 0))
    for leave_out in (None, (), ("base_links",)):
        scene = builder.build(leave_out=leave_out)
        assert scene.total_mass == 3.0
        q, qd = np.array([0.5]), np.array([2.0])
        center = np.array([4 / 3 * np.cos(0.5), 4 / 3 * np.sin(0.5), 1.0])
        assert_near(scene.center_of_mass(q), center, product(4, 1.0))
        assert_near(scene.center_of_mass_velocity(q, qd), 2 * np.array([-center[1], center[0], 0]), product(4, 4.0))
        assert_near(scene.center_of_mass_acceleration(q, qd, 0 * qd), -4 * center * (1, 1, 0), product(4, 8.0))
        assert_near(scene.centroidal_momentum_matrix(q)[:, 0], [0, 0, 1 + 2 / 3, -3 * center[1], 3 * center[0], 0], product(4, 8.0))
        for frame in FRAMES:
            assert not scene.jacobian(q, "mast", frame=frame).any()
            for vector in (scene.velocity(q, qd, "mast", frame=frame), scene.acceleration(q, qd, qd, "base", frame=frame)):
                assert_same_bits(vector, np.zeros(6))
        assert_near(scene.placement(q, "mast")[:3, 3], [0, 0, 1], 0.0)
        hand = scene.acceleration(q, qd, 0 * qd, "hand", kind="classical")
        assert_near(hand, [0, 0, 0, -8, 0, 0], product(4, 8.0))
        assert_near(scene.acceleration(q, qd, 0 * qd, "hand"), np.zeros(6), product(4, 8.0))


def test_one_state_in_arrays_has_the_bits_of_one_in_lists(mixed: phipsi.Scene) -> None:
    """Arrays use the fast path, and lists the general one; errors are equal."""
    q, qd, qdd = random_states(mixed, 4)
    calls: dict[str, tuple[Callable[..., Any], int]] = {
        **{name: (getattr(mixed, name), count) for name, count in OF_MASS.items()},
        "gravity_torque": (mixed.gravity_torque, 1),
        "kinetic_energy": (mixed.kinetic_energy, 2),
        "potential_energy": (mixed.potential_energy, 1),
    }
    for name, count in {"placement": 1, "velocity": 2, "acceleration": 3, "jacobian": 1, "jacobian_rate": 2, "jacobian_rate_product": 2}.items():
        calls[name] = (lambda *state, method=getattr(mixed, name): method(*state, mixed.link_names[-1])), count
    for name, count in {"velocity_derivatives": 2, "acceleration_derivatives": 3, "jacobian_derivatives": 1}.items():
        calls[name] = (lambda *state, method=getattr(mixed, name): method(*state, mixed.link_names[-1])), count
    for name, (call, count) in calls.items():
        state = (q, qd, qdd)[:count]
        found = call(*state)
        assert_same_bits(found, call(*(argument.tolist() for argument in state)), name)
        assert found.dtype == np.float64 and isinstance(found, np.float64 if name.endswith("energy") else np.ndarray)
        for at in range(count):
            for value in (np.nan, 1e300):
                broken = [argument.copy() for argument in state]
                broken[at][-1] = value
                assert outcome(call, broken) == outcome(call, [argument.tolist() for argument in broken]), name


def outcome(call: Callable[..., Any], state: Sequence[Any]) -> object:
    """Bytes of a result, or the message of an error."""
    try:
        return np.asarray(call(*state)).tobytes()
    except PhipsiError as error:
        return type(error), str(error)


BROKEN: dict[str, tuple[str, dict[str, Any], type[Exception], str]] = {
    "link": ("velocity", {"link": "hand"}, ArgumentError, 'link: found "hand"; expected one of "base"'),
    "link of placement": ("placement", {"link": "hand"}, ArgumentError, 'link: found "hand"'),
    "one link of several": ("placement", {"link": ["base", "hand"]}, ArgumentError, 'link: found "hand"'),
    "no names": ("placement", {"link": 3}, ArgumentError, "link: found 3; expected the name of a link, or a sequence of names"),
    "frame": ("jacobian", {"frame": "base"}, ArgumentError, 'frame: found "base"; expected one of "local", "world", "local-world-aligned"'),
    "kind": ("acceleration", {"kind": "true"}, ArgumentError, 'kind: found "true"; expected one of "spatial", "classical"'),
    "point": ("jacobian_rate", {"at": (1, 2)}, ShapeError, r"at: found shape \(2,\); expected \(3,\)"),
    "point, NaN": ("jacobian", {"at": (1, np.nan, 2)}, NotFiniteError, "at: found NaN at index 1"),
    "q": ("center_of_mass", {"q": np.zeros(6)}, ShapeError, "q: found shape"),
    "qd": ("jacobian_rate_product", {"qd": np.full(7, np.inf)}, NotFiniteError, "qd: found inf"),
    "qdd": ("acceleration", {"qdd": np.full((2, 7), np.nan)}, NotFiniteError, "qdd: found NaN at index 0 in state 0"),
    "errors": ("centroidal_momentum_matrix", {"errors": "ignore"}, ArgumentError, 'errors: found "ignore"'),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_arguments(arm: phipsi.Scene, case: str) -> None:
    method, replaced, error, message = BROKEN[case]
    state = random_states(arm, 0)
    taken = {"center_of_mass": "", "centroidal_momentum_matrix": "", "placement": "l", "jacobian": "l", "acceleration": "daal"}.get(method, "dl")
    valid: dict[str, Any] = {"q": state.q}
    valid |= {"qd": state.qd} if "d" in taken else {}
    valid |= {"qdd": state.tau} if "a" in taken else {}
    valid |= {"link": "link6"} if "l" in taken else {}
    assert np.isfinite(getattr(arm, method)(**valid)).all()
    with pytest.raises(error, match=message):
        getattr(arm, method)(**(valid | replaced))


def test_links_of_placement_can_be_repeated_and_none(mixed: phipsi.Scene) -> None:
    q = random_states(mixed, 0, (4,)).q
    names = [mixed.link_names[-1], "base", mixed.link_names[-1], mixed.link_names[2]]
    together = mixed.placement(q, names)
    assert together.shape == (4, 4, 4, 4)
    for at, name in enumerate(names):
        assert_near(together[:, at], mixed.placement(q, name), product(mixed.nv, size(together)))
        assert_near(together[:, at], mixed.placements(q)[name], product(mixed.nv, size(together)))
    assert mixed.placement(q, ()).shape == (4, 0, 4, 4)
    assert mixed.placement(q[0], ()).shape == (0, 4, 4)


def test_gravity_torque_takes_what_the_bias_takes(arm: phipsi.Scene) -> None:
    q = random_states(arm, 0, (5,)).q
    out = np.empty((5, 7))
    assert arm.gravity_torque(q, out=out) is out
    assert_same_bits(out, arm.bias_torque(q, np.zeros(7)))
    assert arm.gravity_torque(q, dtype=np.float32).dtype == np.float32


def test_summary(capsys: pytest.CaptureFixture[str]) -> None:
    assert all(np.isfinite(off) for off in worst.values())
    with capsys.disabled():
        print("\nlargest disagreement with Pinocchio, n eps of the size:", ", ".join(f"{name.strip()} {off:.2g}" for name, off in worst.items()))
