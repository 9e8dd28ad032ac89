"""One valid call, then one broken argument per test; and all supported kinds of arrays."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import methods, random_scene, random_states
from tolerances import assert_near, assert_same_bits, product

import phipsi
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError, SingularJointError
from phipsi.estimation import Encoder, Gyro, nees, nis

NAN = np.array([0, 0, np.nan, 0, 0, 0, 0])


def call(scene: phipsi.Scene, **replaced: Any) -> np.ndarray:
    q, qd, tau = random_states(scene, 0)
    return scene.forward_dynamics(**({"q": q, "qd": qd, "tau": tau} | replaced))


def test_the_call_is_valid(arm: phipsi.Scene) -> None:
    assert np.isfinite(call(arm)).all()


BROKEN: dict[str, tuple[dict[str, Any], type[Exception], str]] = {
    "q too short": ({"q": np.zeros(6)}, ShapeError, "q: found shape (6,); expected (..., 7)"),
    "qd too long": ({"qd": np.zeros((2, 8))}, ShapeError, "qd: found shape (2, 8); expected (..., 7)"),
    "tau a number": ({"tau": 1.0}, ShapeError, "tau: found shape (); expected (..., 7)"),
    "axes": (
        {"q": np.zeros((3, 7)), "tau": np.zeros((2, 7))},
        ShapeError,
        "tau: found shape (2, ...); expected leading axes that broadcast with (3, ...) of q, qd",
    ),
    "bool": ({"q": [True] * 7}, ArgumentError, "q: found dtype bool; expected an array of real numbers"),
    "complex": ({"qd": np.zeros(7, complex)}, ArgumentError, "qd: found dtype complex128"),
    "text": ({"tau": ["1"] * 7}, ArgumentError, "tau: found dtype <U1"),
    "object": ({"tau": [None] * 7}, ArgumentError, "tau: found dtype object"),
    "None": ({"q": None}, ArgumentError, "q: found dtype object"),
    "ragged": ({"q": [[1, 2], [3]]}, ArgumentError, "q: found what NumPy cannot read"),
    "NaN": ({"qd": NAN}, NotFiniteError, "qd: found NaN at index 2; expected finite numbers"),
    "infinite": ({"tau": NAN * 0 + np.inf}, NotFiniteError, "tau: found "),
    "form": ({"form": "cholesky"}, ArgumentError, 'form: found "cholesky"; expected one of "auto", "covariance"'),
    "wrenches": ({"wrenches": [1, 2]}, ArgumentError, "wrenches: found an object of type list; expected a dict"),
    "wrench on nothing": ({"wrenches": {"hand": np.zeros(6)}}, ArgumentError, 'wrenches: found "hand"; expected one of "base"'),
    "wrench key": ({"wrenches": {3: np.zeros(6)}}, ArgumentError, "wrenches: found the key 3"),
    "wrench width": ({"wrenches": {"link2": np.zeros(3)}}, ShapeError, 'wrenches["link2"]: found shape (3,); expected (..., 6)'),
    "wrench axes": (
        {"q": np.zeros((3, 7)), "wrenches": {"link2": np.zeros((2, 6))}},
        ShapeError,
        'wrenches["link2"]: found shape (2, ...)',
    ),
    "wrench NaN": (
        {"wrenches": {"base": [0, 0, 0, 0, np.nan, 0]}},
        NotFiniteError,
        'wrenches["base"]: found NaN at index 4',
    ),
    "out a list": ({"out": [0.0] * 7}, ArgumentError, "out: found an object of type list; expected a C-contiguous float64"),
    "out float32": ({"out": np.zeros(7, np.float32)}, ArgumentError, "out: found dtype float32"),
    "out big-endian": ({"out": np.zeros(7, ">f8")}, ArgumentError, "out: found dtype >f8"),
    "out shape": ({"out": np.zeros((1, 7))}, ShapeError, "out: found shape (1, 7); expected (7,)"),
    "out strided": ({"out": np.zeros(14)[::2]}, ArgumentError, "out: found an array with strides [16]"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_one_broken_argument(arm: phipsi.Scene, case: str) -> None:
    replaced, error, message = BROKEN[case]
    with pytest.raises(error, match=re.escape(message)):
        call(arm, **replaced)


def test_out_is_written_and_returned(mixed: phipsi.Scene) -> None:
    q, qd, tau = random_states(mixed, 0, (3,))
    out = np.full((3, mixed.nv), np.nan)
    assert mixed.forward_dynamics(q, qd, tau, out=out) is out
    assert_same_bits(out, mixed.forward_dynamics(q, qd, tau))
    assert mixed.inverse_dynamics(q, qd, tau, out=out) is out
    assert_same_bits(out, mixed.inverse_dynamics(q, qd, tau))
    assert mixed.bias_torque(q, qd, out=out) is out
    assert_same_bits(out, mixed.bias_torque(q, qd))


@pytest.mark.parametrize("leading", [(), (1,), (3,), (20,)])
def test_out_of_a_matrix_is_written_and_returned(mixed: phipsi.Scene, leading: tuple[int, ...]) -> None:
    q, _, _ = random_states(mixed, 0, leading)
    for method in (mixed.mass_matrix, mixed.mass_matrix_inverse):
        out = np.full((*leading, mixed.nv, mixed.nv), np.nan)
        assert method(q, out=out) is out
        assert_same_bits(out, method(q))
        with pytest.raises(ShapeError, match="out: found shape"):
            method(q, out=np.zeros((*leading, mixed.nv)))


def test_out_must_be_writable(arm: phipsi.Scene) -> None:
    out = np.zeros(7)
    out.flags.writeable = False
    with pytest.raises(ArgumentError, match="out: found a read-only array"):
        call(arm, out=out)


@pytest.mark.parametrize("argument", ["q", "qd", "tau"])
def test_out_must_not_be_an_argument(arm: phipsi.Scene, argument: str) -> None:
    shared = np.zeros(7)
    with pytest.raises(ArgumentError, match="out: found memory that is shared with an argument"):
        call(arm, **{argument: shared, "out": shared})


def test_out_must_not_overlap_an_argument(arm: phipsi.Scene) -> None:
    memory = np.zeros(20)
    with pytest.raises(ArgumentError, match="out: found memory that is shared"):
        call(arm, q=memory[:7], out=memory[6:13])
    call(arm, q=memory[:7], out=memory[7:14])
    buffer = bytearray(8 * 20)
    with pytest.raises(ArgumentError, match="out: found memory that is shared"):
        call(arm, q=np.frombuffer(buffer)[:7], out=np.frombuffer(buffer)[3:10])


def test_out_must_not_overlap_a_wrench(arm: phipsi.Scene) -> None:
    memory = np.zeros(8)
    with pytest.raises(ArgumentError, match="out: found memory that is shared"):
        call(arm, wrenches={"link1": memory[2:]}, out=memory[:7])


def test_the_state_of_a_fault_is_told(arm: phipsi.Scene) -> None:
    q, qd, tau = random_states(arm, 0, (4, 5))
    tau[2, 3, 6] = np.inf
    tau[3, 0, 1] = np.nan
    with pytest.raises(NotFiniteError, match=r"tau: found inf at index 6 in state 13.*\(2, 3\) of the batch \(4, 5\)") as found:
        arm.forward_dynamics(q, qd, tau)
    assert (found.value.argument, found.value.index, found.value.state) == ("tau", 6, (2, 3))
    with pytest.raises(NotFiniteError, match="tau: found inf at index 6 in state 3;") as found:
        arm.forward_dynamics(q[2], qd[2], tau[2])
    assert found.value.state == 3
    with pytest.raises(NotFiniteError) as found:
        arm.forward_dynamics(q[0, 0], qd[0, 0], tau[2, 3])
    assert found.value.state is None


def test_a_quaternion_far_from_unit_is_refused(mixed: phipsi.Scene) -> None:
    q = mixed.neutral()
    q[np.flatnonzero(q)[0]] = 1.01
    with pytest.raises(ArgumentError, match=r"q: found a quaternion of norm 1.01 for joint"):
        mixed.mass_matrix(q)


def test_a_singular_joint_is_named() -> None:
    """A point mass on a turntable, lifted about an axis near the first: at elevation 0 it is on the first axis."""
    builder = phipsi.SceneBuilder().link("base").link("table").link("arm", 2.0, (1, 0, 0))
    builder.joint("turn", "revolute", "base", "table")
    builder.joint("lift", "revolute", "table", "arm", xyz=(-1, 0, 0), axis=(0, 1, 0))
    scene = builder.build(gravity=(0, 0, 0))
    q = np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.0], [0.0, 0.0]])
    still = np.zeros(2)
    assert scene.forward_dynamics(q[:2], still, still).shape == (2, 2)
    for evaluate in (lambda q: scene.forward_dynamics(q, still, still), scene.mass_matrix_inverse):
        with pytest.raises(SingularJointError, match=r'"turn".*"table".*in state 2.*armature') as found:
            evaluate(q)
        assert (found.value.joint, found.value.link, found.value.state) == ("turn", "table", 2)
        assert abs(found.value.pivot) < 1e-12
        with pytest.raises(SingularJointError) as found:
            evaluate(q[3])
        assert found.value.state is None


def test_an_overflow_is_an_error(arm: phipsi.Scene) -> None:
    q, qd, tau = random_states(arm, 0)
    with pytest.raises(NotFiniteError, match="bias torque"):
        arm.bias_torque(q, qd * 1e200)


@pytest.mark.parametrize("name", ["hand", "", "joint"])
def test_unknown_links_and_joints(arm: phipsi.Scene, name: str) -> None:
    for batch in ((), (0,)):
        with pytest.raises(ArgumentError, match=f'link: found "{name}"; expected one of "base", "link0"'):
            arm.jacobian(np.zeros((*batch, 7)), name)
    message = f'joint: found "{name}"; expected one of "joint0", "joint1"'
    for index in (arm.q_index, arm.v_index):
        with pytest.raises(ArgumentError, match=message):
            index(name)
    with pytest.raises(ArgumentError, match=message):
        arm.lock([name], arm.neutral())


def test_parts_of_joints_by_name() -> None:
    builder = phipsi.SceneBuilder()
    for name in ("body", "ball", "arm"):
        builder.link(name, mass=1.0, inertia=np.eye(3))
    builder.joint("shoulder", "spherical", "body", "ball")
    builder.joint("elbow", "revolute", "ball", "arm")
    scene = builder.build(floating_base=True)
    q, qd = scene.random_configuration(seed=1), np.arange(10.0)
    linear, angular = (qd[scene.v_index("root_joint", part)] for part in ("linear", "angular"))
    place = scene.placement(q, "body")
    np.testing.assert_array_equal(q[scene.q_index("root_joint", "position")], place[:3, 3])
    assert_near(scene.velocity(q, qd, "body"), np.concatenate([angular, linear]), product(10, 9.0))
    quaternion = q[scene.q_index("root_joint", "quaternion")]
    assert_near(2.0 * np.arccos(abs(quaternion[3])), np.arccos((np.trace(place[:3, :3]) - 1.0) / 2.0), product(20, np.pi))
    assert scene.q_index("shoulder", "quaternion") == scene.q_index("shoulder")
    assert scene.v_index("shoulder", "angular") == scene.v_index("shoulder")
    with pytest.raises(ArgumentError, match='part: found "angular"; expected "position", "quaternion" or none for joint "root_joint"'):
        scene.q_index("root_joint", "angular")
    with pytest.raises(ArgumentError, match='part: found "linear"; expected none for joint "elbow"'):
        scene.v_index("elbow", "linear")


def test_lock_takes_a_list_of_names(arm: phipsi.Scene) -> None:
    assert arm.lock("joint0", arm.neutral()).joint_names == arm.lock(["joint0"], arm.neutral()).joint_names
    for joints in (3, [3], None, {"joint0": 1.0}):
        with pytest.raises(ArgumentError, match="joints: found .* expected a list of joint names"):
            arm.lock(joints, arm.neutral())  # type: ignore[arg-type]
    with pytest.raises(ShapeError, match=r"q: found shape \(1, 7\); expected \(7,\)"):
        arm.lock(["joint0"], np.zeros((1, 7)))


def test_dense_matrices_stop_at_4000() -> None:
    builder = phipsi.SceneBuilder().link("base")
    for k in range(4001):
        builder.link(f"l{k}", 1.0, (1, 0, 0)).joint(f"j{k}", "revolute", "base", f"l{k}")
    scene = builder.build()
    for method, instead in ((scene.mass_matrix, "inverse_dynamics"), (scene.mass_matrix_inverse, "forward_dynamics")):
        with pytest.raises(ArgumentError, match=f"4001 degrees of freedom; expected at most 4000.*{instead}"):
            method(scene.neutral())
    assert scene.forward_dynamics(*random_states(scene, 0)).shape == (4001,)


def test_too_many_states_raise_memory_errors(arm: phipsi.Scene) -> None:
    """Broadcasting can create results larger than the memory from small arguments."""
    tall, wide = np.zeros((2**20, 1, 7)), np.zeros((2**20, 7))
    with pytest.raises(MemoryError):
        arm.bias_torque(tall, wide)
    with pytest.raises(MemoryError):
        arm.energy(tall, wide)
    vast = np.broadcast_to(np.zeros(7), (2**20, 1, 7))[:1]
    assert arm.bias_torque(vast, np.zeros(7)).shape == (1, 1, 7)


def converted(q: np.ndarray) -> dict[str, Any]:
    """The same values in all other array types; the values are exact in float32."""
    raw = np.zeros(8 * q.size + 1, np.uint8)
    unaligned = raw[1:].view(np.float64).reshape(q.shape)
    unaligned[...] = q
    wide = np.zeros((*q.shape[:-1], 2 * q.shape[-1]))
    wide[..., ::2] = q
    frozen = q.copy()
    frozen.flags.writeable = False
    return {
        "list": q.tolist(),
        "tuple": tuple(map(tuple, q)),
        "float32": q.astype(np.float32),
        "longdouble": q.astype(np.longdouble),
        "big-endian": q.astype(">f8"),
        "Fortran": np.asfortranarray(q),
        "strided": wide[..., ::2],
        "reversed": q[::-1].copy()[::-1],
        "unaligned": unaligned,
        "read-only": frozen,
        "masked": np.ma.asarray(q),
    }


def test_all_kinds_of_arrays_are_taken(arm: phipsi.Scene) -> None:
    q, qd, tau = (x.astype(np.float32).astype(np.float64) for x in random_states(arm, 0, (4,)))
    expected = arm.forward_dynamics(q, qd, tau)
    for name, other in converted(q).items():
        assert_same_bits(arm.forward_dynamics(other, qd, tau), expected, name)
    for name, other in converted(tau).items():
        assert_same_bits(arm.forward_dynamics(q, qd, other), expected, name)


@pytest.mark.parametrize("dtype", [np.int8, np.uint16, np.int64, np.float16])
def test_integers_are_taken(arm: phipsi.Scene, dtype: Any) -> None:
    q = np.arange(7)
    assert_same_bits(arm.mass_matrix(q.astype(dtype)), arm.mass_matrix(q.astype(np.float64)))


def test_arguments_are_left_alone(method: str) -> None:
    scene = random_scene(5, 9)
    state = random_states(scene, 0, (3,))
    evaluate, arguments = methods(scene, state)[method]
    before = [argument.copy() for argument in arguments]
    first = evaluate(*arguments)
    for argument, copy in zip(arguments, before, strict=True):
        assert_same_bits(argument, copy)
    for argument in arguments:
        assert not np.shares_memory(first, argument)


def observed(scene: phipsi.Scene, value: object) -> object:
    observer = scene.observer(1e-3, [Encoder(noise=1e-3)], q=scene.neutral(), torque_noise=0.1)
    return observer.step(np.zeros(scene.nv), {"encoder": value})


ONE, SQUARE = np.array([1.0, 2.0, 3.0]), np.eye(3)
#: Calls with one array each, which the other arguments suit; the name of the argument, and the value.
CONVERTED: dict[str, tuple[Callable[[phipsi.Scene, object], object], str, np.ndarray]] = {
    "position": (lambda scene, value: phipsi.pose(value), "xyz", ONE),
    "angles": (lambda scene, value: phipsi.pose(rpy=value), "rpy", ONE),
    "quaternion": (lambda scene, value: phipsi.pose(quat=value), "quat", np.array([0.0, 0.0, 0.0, 1.0])),
    "innovation": (lambda scene, value: nis(value, SQUARE), "error", ONE),
    "covariance": (lambda scene, value: nees(ONE, value), "covariance", SQUARE),
    "torque variance": (lambda scene, value: scene.forward_dynamics_variance(ONE, ONE, ONE, torque=value), "torque", ONE),
    "parameters": (
        lambda scene, value: scene.forward_dynamics_variance(ONE, ONE, ONE, parameters=value), "parameters", np.zeros((3, 10, 10)),
    ),
    "joints": (lambda scene, value: scene.forward_dynamics_variance(ONE, ONE, ONE, joints=value), "joints", np.zeros((3, 4, 4))),
    "damping variance": (
        lambda scene, value: scene.inverse_dynamics_variance(ONE, ONE, ONE, joints={"damping": value}), "joints['damping']", ONE,
    ),
    "target": (
        lambda scene, value: scene.inverse_kinematics(phipsi.tasks.Position(scene.link_names[-1], value), starts=1), "tasks[0].target", ONE,
    ),
    "point": (
        lambda scene, value: scene.inverse_kinematics(phipsi.tasks.Position(scene.link_names[-1], ONE, at=value), starts=1), "tasks[0].at", ONE,
    ),
    "reading": (observed, "readings['encoder']", ONE),
    "sensor noise": (
        lambda scene, value: scene.observer(1e-3, [Encoder(noise=value)], q=ONE, torque_noise=0.1), "noise of 'encoder'", ONE,
    ),
    "rotation of a sensor": (
        lambda scene, value: scene.observer(1e-3, [Gyro(link=scene.link_names[-1], noise=1.0, rotation=value)], q=ONE, torque_noise=0.1),
        "rotation of 'gyro'", SQUARE,
    ),
    "torque noise": (lambda scene, value: scene.observer(1e-3, [], q=ONE, torque_noise=value), "torque_noise", ONE),
    "initial": (lambda scene, value: scene.observer(1e-3, [], q=ONE, torque_noise=0.1, initial=value), "initial", np.ones(6)),
    "torque noise of momentum": (
        lambda scene, value: scene.momentum_observer(1e-3, torque_noise=value, bandwidth=10.0), "torque_noise", ONE,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CONVERTED)
def test_complex_numbers_are_refused_and_lists_are_taken(name: str) -> None:
    """NumPy would drop the imaginary part with a warning, and treat True as 1."""
    scene = phipsi.scenes.chain(3)
    call, argument, value = CONVERTED[name]
    call(scene, value)
    call(scene, value.tolist())
    for wrong, found in ((value + 0j, "complex128"), ((value + 0j).tolist(), "complex128"), (value != 0.0, "bool"), (value.astype(str), "<U32")):
        with pytest.raises(ArgumentError, match=re.escape(f"{argument}: found dtype {found}")) as caught:
            call(scene, wrong)
        assert caught.value.argument == argument


def test_one_name_is_a_list_of_one(arm: phipsi.Scene) -> None:
    last = arm.link_names[-1]
    assert arm.to_c(functions="mass_matrix") == arm.to_c(functions=["mass_matrix"])
    assert arm.placement(arm.neutral(), last).shape == (4, 4)
    assert_same_bits(arm.operational_inverse_inertia(arm.neutral(), last), arm.operational_inverse_inertia(arm.neutral(), [last]))
    with pytest.raises(ArgumentError, match='functions: found .forward.; expected one of forward_dynamics'):
        arm.to_c(functions="forward")
    with pytest.raises(ArgumentError, match="functions: found 'forward'"):
        phipsi.compile(arm, "forward")
    q, qd, qdd = np.random.default_rng(0).uniform(-1, 1, (3, 200, arm.nv))
    tau = arm.inverse_dynamics(q, qd, qdd) + 0.1 * qd
    alone = arm.identify(q, qd, qdd, tau, noise=0.01, fit="damping", keep=arm.body_names[0])
    listed = arm.identify(q, qd, qdd, tau, noise=0.01, fit=["damping"], keep=[arm.body_names[0]])
    assert_same_bits(alone.parameters, listed.parameters)
    for argument, value in (("fit", "dampening"), ("keep", "all")):
        with pytest.raises(ArgumentError, match=f"{argument}: found '{value}'; expected names of"):
            arm.identify(q, qd, qdd, tau, **{argument: value})


@pytest.mark.parametrize("operator", ["solve", "mul", "phi", "K"])
def test_products_that_overflow_are_errors(arm: phipsi.Scene, operator: str) -> None:
    factor = arm.factor(np.full((2, 7), 0.3))
    apply = {"solve": factor.solve, "mul": factor.mul, "phi": factor.phi.matvec, "K": factor.K.matvec}[operator]
    x = np.full((2, 42 if operator == "phi" else 7), 1.0)
    assert np.isfinite(apply(x)).all()
    x[1] = 1.7e308
    with pytest.raises(NotFiniteError, match=r"product with .* \(result; the arguments overflow\)") as found:
        apply(x)
    assert found.value.state == 1
