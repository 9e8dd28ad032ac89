"""phipsi and the peers with one state per call: loops over states that python_peers.py times.

A loop runs over all states once and returns its last raw result. Work that a caller has to do for every state (set a
context, pass arguments) is in the loop; states were converted to the coordinates of the library before.
"""

import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dynibo
import mujoco
import numpy as np
import pinocchio as pin
import pydrake.all as drake
from problems import GRAVITY, KINDS, Array, Coordinates, Problem


@dataclass(frozen=True)
class Entry:
    """A loop over all states of a problem, and its last result in phipsi's coordinates."""

    operation: str
    library: str
    call: str
    loop: Callable[[], Any]
    ours: Callable[[Any], Array]
    scale: float = 0.0
    """Smallest reference value for relative differences, because the results vanish in static equilibrium."""


class Refused(Exception):
    """The library does not support the model."""


def over(function: Callable[..., Any], states: list[tuple[Any, ...]], **options: Any) -> Callable[[], Any]:
    """One call per state. Options are passed only if there are any, because an empty dictionary costs time."""

    def plain() -> Any:
        for state in states:
            result = function(*state)
        return result

    def with_options() -> Any:
        for state in states:
            result = function(*state, **options)
        return result

    return with_options if options else plain


def rows(*arrays: Array) -> list[tuple[Array, ...]]:
    """Each state as separate arrays."""
    return [tuple(np.array(row) for row in state) for state in zip(*arrays, strict=True)]


def symmetric(upper: Array) -> Array:
    """Pinocchio fills the upper triangle."""
    return np.triu(upper) + np.triu(upper, 1).T


def of_phipsi(problem: Problem) -> Iterator[Entry]:
    scene = problem.scene
    velocity, acceleration = (rows(problem.q, problem.qd, x) for x in (problem.tau, problem.qdd))
    configuration = rows(problem.q)

    def entry(operation: str, call: str, loop: Callable[[], Any]) -> Entry:
        return Entry(operation, "phipsi", call, loop, np.array)

    for form in ("covariance", "auto"):
        loop = over(scene.forward_dynamics, velocity, form=form)
        yield entry("forward_dynamics", f"forward_dynamics, {form}", loop)
    for kind in KINDS:
        states = problem.at(kind)
        alone = float(np.max(np.abs(scene.forward_dynamics(states[0][-1], states[1][-1], np.zeros(scene.nv)))))
        for form in ("covariance", "auto"):
            loop, call = over(scene.forward_dynamics, rows(*states), form=form), f"forward_dynamics, {form}"
            yield Entry(f"forward_dynamics, {kind}", "phipsi", call, loop, np.array, alone)
    yield entry("inverse_dynamics", "inverse_dynamics", over(scene.inverse_dynamics, acceleration))
    yield entry("mass_matrix", "mass_matrix", over(scene.mass_matrix, configuration))
    for form in ("covariance", "auto"):
        loop = over(scene.mass_matrix_inverse, configuration, form=form)
        yield entry("mass_matrix_inverse", f"mass_matrix_inverse, {form}", loop)


def pinocchio_model(problem: Problem) -> tuple[Any, Coordinates]:
    """Its model, with joints in alphabetical order."""
    free = (pin.JointModelFreeFlyer(),) if problem.floating else ()
    model = pin.buildModelFromXML(problem.urdf, *free)
    model.gravity.linear[:] = GRAVITY
    names = list(model.names)[2 if problem.floating else 1 :]
    if model.nq != problem.scene.nq or sorted(names) != sorted(problem.joints):
        raise Refused("other coordinates")
    return model, Coordinates(problem, np.array([names.index(name) for name in problem.joints]))


def pinocchio_arrays(problem: Problem, at: Coordinates) -> tuple[Array, Array, Array, Array]:
    """q, v, tau and a of all states."""
    states = range(len(problem))
    first = problem.q[:, :7] if problem.floating else problem.q[:, :0]
    q = np.hstack([first, np.array([at.positions(state) for state in states])])
    return q, *(np.array([of(state) for state in states]) for of in (at.rates, at.forces, at.accelerations))


def of_pinocchio(problem: Problem) -> Iterator[Entry]:
    model, at = pinocchio_model(problem)
    data, last = model.createData(), len(problem) - 1
    q, v, tau, a = pinocchio_arrays(problem, at)
    forward, inverse, configuration = (
        [(model, data, *state) for state in rows(*arrays)] for arrays in ((q, v, tau), (q, v, a), (q,))
    )

    def accelerations(result: Array) -> Array:
        return at.our_accelerations(result, last)

    def matrix(result: Array) -> Array:
        return at.our_matrix(symmetric(result), last)

    library = "Pinocchio"
    yield Entry("forward_dynamics", library, "pin.aba", over(pin.aba, forward), accelerations)
    yield Entry("inverse_dynamics", library, "pin.rnea", over(pin.rnea, inverse), lambda r: at.our_forces(r, last))
    yield Entry("mass_matrix", library, "pin.crba", over(pin.crba, configuration), matrix)
    yield Entry("mass_matrix_inverse", library, "pin.computeMinverse", over(pin.computeMinverse, configuration), matrix)


def mujoco_model(problem: Problem) -> tuple[Any, Coordinates]:
    """From the same URDF, with fixed links fused (its default), without contacts, limits and other constraints."""
    specification = mujoco.MjSpec.from_string(problem.urdf)
    if problem.floating:
        specification.worldbody.first_body().add_freejoint()
    try:
        model = specification.compile()
    except ValueError as error:
        raise Refused(str(error)) from None
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.opt.gravity[:] = GRAVITY
    names = [model.joint(index).name for index in range(model.njnt)][1 if problem.floating else 0 :]
    if sorted(names) != sorted(problem.joints):
        raise Refused("other joints")
    at = np.array([names.index(name) for name in problem.joints])
    return model, Coordinates(problem, at, world="linear")


STATE = mujoco.mjtState.mjSTATE_QPOS | mujoco.mjtState.mjSTATE_QVEL | mujoco.mjtState.mjSTATE_QFRC_APPLIED


def of_mujoco(problem: Problem) -> Iterator[Entry]:
    model, at = mujoco_model(problem)
    data, last = mujoco.MjData(model), len(problem) - 1
    states = [
        np.concatenate([at.base(state), at.positions(state), at.rates(state), at.forces(state)])
        for state in range(len(problem))
    ]
    accelerations = [at.accelerations(state) for state in range(len(problem))]
    signature = int(STATE)

    def after(function: Callable[[Any, Any], None]) -> Callable[[], Array]:
        def loop() -> Array:
            for state in states:
                mujoco.mj_setState(model, data, state, signature)
                function(model, data)
            return np.array(data.qacc)

        return loop

    def inverse() -> Array:
        for state, acceleration in zip(states, accelerations, strict=True):
            mujoco.mj_setState(model, data, state, signature)
            data.qacc[:] = acceleration
            mujoco.mj_inverse(model, data)
        return np.array(data.qfrc_inverse)

    def ours(result: Array) -> Array:
        return at.our_accelerations(result, last)

    library = "MuJoCo"
    yield Entry("forward_dynamics", library, "mj_step", after(mujoco.mj_step), ours)
    yield Entry("forward_dynamics", library, "mj_forward", after(mujoco.mj_forward), ours)
    yield Entry("inverse_dynamics", library, "mj_inverse", inverse, lambda result: at.our_forces(result, last))


def root_link(urdf: str) -> str:
    """The root link."""
    robot = ET.fromstring(urdf)
    carried = {child.get("link") for child in robot.iter("child")}
    return next(link.get("name", "") for link in robot.findall("link") if link.get("name") not in carried)


def drake_plant(problem: Problem) -> tuple[Any, Coordinates]:
    """A continuous-time plant from the same URDF."""
    plant = drake.MultibodyPlant(time_step=0.0)
    plant.mutable_gravity_field().set_gravity_vector(GRAVITY)
    try:
        [instance] = drake.Parser(plant).AddModelsFromString(problem.urdf, "urdf")
        root = root_link(problem.urdf)
        if not problem.floating and root != "world":  # the link that it welds itself
            plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(root, instance))
        plant.Finalize()
    except RuntimeError as error:
        raise Refused(str(error)) from None
    starts = np.array([plant.GetJointByName(name).velocity_start() for name in problem.joints])
    return plant, Coordinates(problem, starts - problem.first, angular_first=True, world="linear angular")


def of_drake(problem: Problem) -> Iterator[Entry]:
    plant, at = drake_plant(problem)
    context, last = plant.CreateDefaultContext(), len(problem) - 1
    every = range(len(problem))
    # The quaternion comes first here.
    states = [np.concatenate([np.roll(at.base(s), -3), at.positions(s), at.rates(s)]) for s in every]
    forces, accelerations = ([of(s) for s in every] for of in (at.forces, at.accelerations))
    fixed = plant.get_applied_generalized_force_input_port().FixValue(context, forces[0])
    result, external = plant.get_generalized_acceleration_output_port(), drake.MultibodyForces(plant)

    def forward() -> Array:
        for state, force in zip(states, forces, strict=True):
            plant.SetPositionsAndVelocities(context, state)
            fixed.GetMutableData().get_mutable_value().SetFromVector(force)
            found = result.Eval(context)
        return found

    def inverse() -> Array:
        for state, acceleration in zip(states, accelerations, strict=True):
            plant.SetPositionsAndVelocities(context, state)
            plant.CalcForceElementsContribution(context, external)  # gravity
            found = plant.CalcInverseDynamics(context, acceleration, external)
        return found

    def matrix() -> Array:
        for state in states:
            plant.SetPositionsAndVelocities(context, state)
            found = plant.CalcMassMatrix(context)
        return found

    try:
        result.Eval(context)
    except RuntimeError as error:
        raise Refused(str(error)) from None
    library = "Drake"
    yield Entry(
        "forward_dynamics", library, "generalized_acceleration", forward, lambda r: at.our_accelerations(r, last)
    )
    yield Entry("inverse_dynamics", library, "CalcInverseDynamics", inverse, lambda r: at.our_forces(r, last))
    yield Entry("mass_matrix", library, "CalcMassMatrix", matrix, lambda r: at.our_matrix(r, last))


def breadth_first(urdf: str) -> list[str]:
    """The movable joints in dynibo's order, which has no function for their names."""
    joints = ET.fromstring(urdf).findall("joint")
    queue, order = [root_link(urdf)], []
    while queue:
        link = queue.pop(0)
        for joint in joints:
            if joint.find("parent").get("link") == link:
                queue.append(joint.find("child").get("link"))
                if joint.get("type") != "fixed":
                    order.append(joint.get("name"))
    return order


def of_dynibo(problem: Problem) -> Iterator[Entry]:
    kind = dynibo.FloatingRobot if problem.floating else dynibo.Robot
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(problem.urdf, encoding="utf-8")
        try:
            robot = kind.from_urdf(path)
        except dynibo.DyniboError as error:
            raise Refused(str(error)) from None
    names = breadth_first(problem.urdf)
    order = np.array([names.index(name) for name in problem.joints])
    at = Coordinates(problem, order, angular_first=True, world="linear angular")
    first, last = problem.first, len(problem) - 1

    def base(state: int) -> tuple[Any, ...]:
        if not first:
            return ()
        x, y, z, qw, qx, qy, qz = at.base(state)
        rates, accelerations = at.rates(state), at.accelerations(state)
        velocity, acceleration = (
            dynibo.Twist(angular=tuple(twist[:3]), linear=tuple(twist[3:6])) for twist in (rates, accelerations)
        )
        frame = dynibo.Pose(translation=(x, y, z), rotation_xyzw=(qx, qy, qz, qw))
        return (dynibo.BaseState(frame=frame, velocity=velocity, acceleration=acceleration),)

    every = range(len(problem))
    configuration = [(*base(s), at.positions(s)) for s in every]
    rates = [np.array(at.rates(s)[first:]) for s in every]
    forward = [(*configuration[s], rates[s], at.forces(s)) for s in every]
    inverse = [(*configuration[s], rates[s], np.array(at.accelerations(s)[first:])) for s in every]

    def accelerations(result: Any) -> Array:
        return at.our_accelerations(np.array(result), last)

    def matrix(result: Any) -> Array:
        return at.our_matrix(np.reshape(result, (at.problem.scene.nv,) * 2, order="F"), last)

    library = "dynibo"
    yield Entry("forward_dynamics", library, "forward_dynamics", over(robot.forward_dynamics, forward), accelerations)
    yield Entry("inverse_dynamics", library, "inverse_dynamics", over(robot.inverse_dynamics, inverse),
                lambda result: at.our_forces(np.array(result), last))  # fmt: skip
    yield Entry("mass_matrix", library, "mass_matrix", over(robot.mass_matrix, configuration), matrix)


ONE_STATE = {
    "phipsi": of_phipsi,
    "Pinocchio": of_pinocchio,
    "MuJoCo": of_mujoco,
    "Drake": of_drake,
    "dynibo": of_dynibo,
}
