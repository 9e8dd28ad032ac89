"""Parts of a MuJoCo model that affect the motion and that a scene cannot represent: an error or a warning for each
kind.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ._mjcf import BALL, EQUALITY_CONNECT, EQUALITY_JOINT, EQUALITY_WELD, FREE, SLIDE, SOFT, Names
from ._mjcf import (
    along_world,
    connected,
    equalities,
    field,
    has_constraints,
    has_passive_forces,
    is_disabled,
    is_enabled,
    is_soft,
    joint_actuators,
    stops,
)
from ._mjcf_contacts import Collisions, unsupported
from .errors import ArgumentError, ModelWarning, SceneError, known_names, warn

if TYPE_CHECKING:
    import mujoco

#: Names for the argument `ignore`: features that a scene does not support.
IGNORED = (
    "actuators",
    "armature",
    "contacts",
    "equality",
    "flexes",
    "fluid",
    "friction",
    "gravcomp",
    "keyframes",
    "limits",
    "mocap",
    "nonlinear",
    "plugins",
    "softness",
    "tendons",
)
#: Upper bounds of the density, kg/m^3, and viscosity, Pa s, of air.
AIR = (1.3, 2e-5)
#: Value of mjtSleepPolicy for a tree that sleeps until something touches it.
SLEEP_INIT = 5


class Gap(NamedTuple):
    """A part of a model that a scene cannot represent."""

    name: str
    """Name in the argument `ignore`."""
    found: str
    consequence: str
    is_refused: bool = True
    """Whether omitting the part changes the motion: an error; otherwise a warning."""


def check(model: mujoco.MjModel, names: Names, ignore: Collection[str], strict: bool, collisions: Collisions) -> None:
    """Raise SceneError, or warn, for active parts of a model that cannot be represented, except those in `ignore`."""
    for name in ignore:
        if name not in IGNORED:
            raise ArgumentError(f"ignore: found {name!r}; expected names of {known_names(name, IGNORED)}")
    found: dict[str, list[Gap]] = {}
    for gap in gaps(model, names, ignore, collisions):
        if gap.name not in ignore:
            found.setdefault(gap.name, []).append(gap)
    refused = {name: of for name, of in found.items() if strict or any(gap.is_refused for gap in of)}
    if refused:
        what = "; ".join(_text(of) for of in refused.values())
        raise SceneError(
            f"source: found {what}; expected a model without these features; use ignore={tuple(refused)!r} to omit them"
        )
    for name, of in found.items():
        text = f"source: found {_text(of)}; use ignore={(name,)!r} to suppress this warning, or strict=True to raise an error"
        warn(text, ModelWarning)


def _text(of: list[Gap]) -> str:
    """Description of the first of these, preferably a refused one, and the number of others."""
    first = next((gap for gap in of if gap.is_refused), of[0])
    more = f" and {len(of) - 1} more" if len(of) > 1 else ""
    return f"{first.found}{more}: {first.consequence}"


def gaps(model: mujoco.MjModel, names: Names, ignore: Collection[str], collisions: Collisions) -> Iterator[Gap]:
    """All parts that cannot be represented."""
    if "equality" not in ignore:
        yield from _of_equalities(model, names)
    yield from _of_tendons(model)
    yield from _of_bodies(model, names)
    yield from _of_joints(model, names)
    yield from _of_actuators(model)
    yield from _of_keyframes(model, names)
    for name, found, consequence in unsupported(collisions, names):
        yield Gap(name, found, consequence, False)


def _of_equalities(model: mujoco.MjModel, names: Names) -> Iterator[Gap]:
    moved = {body for body in range(model.nbody) if model.body_mocapid[body] >= 0}
    for at in equalities(model):
        what, kind = f"the equality constraint {names.equalities[at]!r}", int(model.eq_type[at])
        if kind not in (EQUALITY_CONNECT, EQUALITY_WELD, EQUALITY_JOINT):
            yield Gap("equality", what, "only the kinds connect, weld and joint are supported")
            continue
        if kind != EQUALITY_JOINT:
            for body in moved.intersection(connected(model, at)):
                yield Gap(
                    "mocap",
                    f"{what} with the body {names.bodies[body]!r}, which the program moves (mocap)",
                    "a scene fixes it at its initial pose",
                )
        if is_soft(model.eq_solref[at], model.eq_solimp[at]):
            yield Gap(
                "softness",
                f"{what}, which is {SOFT}",
                "connections are rigid",
                False,
            )


def _of_tendons(model: mujoco.MjModel) -> Iterator[Gap]:
    forces = ["armature"]
    forces += ["stiffness", "stiffnesspoly"] * (not is_disabled(model, "SPRING")) + ["damping", "dampingpoly"] * (
        not is_disabled(model, "DAMPER")
    )
    forces += ["frictionloss"] * has_constraints(model, "FRICTIONLOSS")
    acting = [values for name in forces if (values := field(model, f"tendon_{name}")) is not None]
    limited = model.tendon_limited if has_constraints(model, "LIMIT") else np.zeros(model.ntendon)
    for at in range(model.ntendon):
        name = model.tendon(at).name
        what = f"the tendon {name!r}" if name else f"tendon number {at}"
        if any(np.any(values[at]) for values in acting):
            yield Gap("tendons", f"{what}, with springs, losses or armature", "scenes have no tendons")
        elif limited[at]:
            yield Gap(
                "tendons", f"{what}, with limits", "scenes have no tendons, so that the joints are not limited", False
            )


def _of_bodies(model: mujoco.MjModel, names: Names) -> Iterator[Gap]:
    if model.nflex:
        yield Gap("flexes", f"{model.nflex} deformable objects (flex)", "bodies are rigid")
    if has_passive_forces(model) and not is_disabled(model, "GRAVITY"):
        for at in _where(model.body_gravcomp):
            yield Gap(
                "gravcomp",
                f"gravcomp {model.body_gravcomp[at]:g} at the body {names.bodies[at]!r}",
                "gravity acts on all bodies",
            )
    option = model.opt
    if has_passive_forces(model) and (option.density or option.viscosity):
        is_air = option.density <= AIR[0] and option.viscosity <= AIR[1] and not np.any(option.wind)
        wind = f" and wind {option.wind.tolist()}" if np.any(option.wind) else ""
        what = f"a medium of density {option.density:g} and viscosity {option.viscosity:g}{wind}"
        yield Gap("fluid", what, "bodies move in vacuum", not is_air)
    for at in _where(model.body_plugin >= 0):
        yield Gap("plugins", f"a plugin at the body {names.bodies[at]!r}", "plugins are not read")
    asleep = field(model, "tree_sleep_policy")
    for at in [] if asleep is None or not is_enabled(model, "SLEEP") else _where(asleep == SLEEP_INIT):
        first = names.bodies[model.tree_bodyadr[at]]
        yield Gap("contacts", f"the body {first!r}, which sleeps until something touches it", "it moves from the start", False)
    for at in _where(model.body_mocapid >= 0):
        below = np.flatnonzero(model.body_parentid == at)
        if len(below):
            carried = names.bodies[below[0]]
            what = f"the body {names.bodies[at]!r}, which the program moves (mocap) and carries {carried!r}"
            yield Gap("mocap", what, "a scene fixes it at its initial pose")


def _of_joints(model: mujoco.MjModel, names: Names) -> Iterator[Gap]:
    springs, damping = "SPRING", "DAMPER"
    joint_of = model.dof_jntid
    for name, flag, of_dof, consequence in (
        ("jnt_stiffnesspoly", springs, False, "springs are linear"),
        ("jnt_springyield", springs, False, "springs are linear"),
        ("dof_dampingpoly", damping, True, "damping is linear"),
    ):
        for at in [] if is_disabled(model, flag) else _rows(field(model, name)):
            yield Gap("nonlinear", f"{name} at the joint {names.joints[joint_of[at] if of_dof else at]!r}", consequence)
    plastic = field(model, "jnt_plasticadr")
    for at in [] if plastic is None else _where(plastic >= 0):
        yield Gap("nonlinear", f"plasticity at the joint {names.joints[at]!r}", "springs are elastic")
    for at in _where(model.jnt_type == FREE):
        for kind, what in along_world(model, at).items():
            yield Gap(
                kind,
                f"{what} at the free joint {names.joints[at]!r}",
                "MuJoCo applies it along the axes of the world; therefore the joint is read as three slides and a ball joint, whose "
                "linear velocity is in the world frame; without it, it is read as a free joint",
                False,
            )
    if has_constraints(model, "LIMIT"):
        for at in _where((model.jnt_type == BALL) & (model.jnt_limited != 0)):
            yield Gap("limits", f"limits of the ball joint {names.joints[at]!r}", "ball joints have no limits", False)
        low, high = stops(model)
        for at in _where((model.jnt_type >= SLIDE) & (model.jnt_limited != 0) & (low > high)):
            margin, between = model.jnt_margin[at], model.jnt_range[at].tolist()
            what = f"limits of the joint {names.joints[at]!r}, whose margin {margin:g} exceeds half of the range {between}"
            yield Gap("limits", what, "both stops act at once")
        for at in _where((model.jnt_type >= SLIDE) & (model.jnt_limited != 0) & is_soft(model.jnt_solref, model.jnt_solimp)):
            yield Gap("softness", f"limits of the joint {names.joints[at]!r}, which are {SOFT}", "stops are rigid", False)
    if has_constraints(model, "FRICTIONLOSS"):
        for at in _where((model.dof_frictionloss != 0.0) & is_soft(model.dof_solref, model.dof_solimp)):
            yield Gap("softness", f"friction at the joint {names.joints[joint_of[at]]!r}, which is {SOFT}", "friction is exact", False)


def _of_actuators(model: mujoco.MjModel) -> Iterator[Gap]:
    """Armature and damping of actuators, which act without control too; those of hinges and slides are added to the
    joint.
    """
    read = {at for at, _, _ in joint_actuators(model)}
    for at in range(len(model.actuator_trntype)):
        for what in ("armature", "damping", "dampingpoly"):
            values = field(model, f"actuator_{what}")
            if values is None or not np.any(values[at]) or (what != "armature" and is_disabled(model, "DAMPER")):
                continue
            name = model.actuator(at).name if len(model.actuator_trntype) == model.nu else ""
            of = f"the actuator {name!r}" if name else f"actuator number {at}"
            if what == "dampingpoly":
                yield Gap("nonlinear", f"{what} at {of}", "damping is linear")
            elif at not in read:
                yield Gap("actuators", f"{what} at {of}", "it is supported only at actuators of hinge and slide joints")


def _of_keyframes(model: mujoco.MjModel, names: Names) -> Iterator[Gap]:
    """Parts of keyframes beyond the state and the controls."""
    mocap = np.argsort(model.body_mocapid)[model.nbody - model.nmocap :]
    for at, name in enumerate(names.keyframes):
        for what, values, usual in (
            ("time", model.key_time[at], 0.0),
            ("mpos", model.key_mpos[at].reshape(-1, 3), model.body_pos[mocap]),
            ("mquat", model.key_mquat[at].reshape(-1, 4), model.body_quat[mocap]),
        ):
            if np.any(values != usual):
                yield Gap("keyframes", f"{what} of the keyframe {name!r}", "only qpos, qvel, ctrl and act are read", False)


def _where(condition: Any) -> list[int]:
    """Indices of entries that are true or nonzero."""
    return [int(at) for at in np.flatnonzero(condition)]


def _rows(values: Any) -> list[int]:
    """Indices of nonzero rows."""
    return (
        []
        if values is None or not len(values)
        else _where(np.any(np.reshape(values, (len(values), -1)) != 0.0, axis=1))
    )
