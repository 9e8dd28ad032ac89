"""Actuators of a MuJoCo model, as SceneBuilder stores them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ._mjcf import Names, field, is_disabled, joint_actuators

if TYPE_CHECKING:
    import mujoco

__all__ = ["actuator_tuples"]

#: Values of mjtGain and mjtBias without a state: a constant, and one that is affine in length and velocity.
FIXED, AFFINE = 0, 1
#: Values of mjtDyn: none, an integrator, and two names of a first-order filter.
STATELESS, INTEGRATOR, FILTERS = 0, 1, (2, 3)
#: A range without limits.
ALL = (-np.inf, np.inf)


def actuator_tuples(model: mujoco.MjModel, names: Names) -> list[tuple[Any, ...]]:
    """Actuators for SceneBuilder._set_actuators; those that cannot be represented have a reason and no joint."""
    if is_disabled(model, "ACTUATION"):
        return []
    on_joint = {at: (joint, gear) for at, joint, gear in joint_actuators(model)}
    starts, ends = model.name_actuatoradr.tolist(), model.names
    found, taken = [], set[str]()
    for at, start in enumerate(starts):
        name = ends[start : ends.index(b"\0", start)].decode("utf-8", "replace") or f"actuator{at}"
        while name in taken:
            name += "_"
        taken.add(name)
        reason = _reason(model, at, at in on_joint)
        if reason is None:
            found.append(_tuple(model, names, at, name, *on_joint[at]))
        else:
            found.append((name, "", 1.0, (0.0,) * 3, (0.0,) * 3, (ALL,) * 3, None, {}, reason))
    return found


def _reason(model: mujoco.MjModel, at: int, is_on_joint: bool) -> str | None:
    """Why an actuator cannot be represented, as a relative clause; None if it can be."""
    delay, early, plugin = (field(model, f"actuator_{name}") for name in ("delay", "actearly", "plugin"))
    group, disabled = int(model.actuator_group[at]), int(getattr(model.opt, "disableactuator", 0))
    if not is_on_joint:
        return "which does not act on a hinge or slide joint"
    if 0 <= group <= 30 and disabled >> group & 1:
        return "whose group is disabled"
    if plugin is not None and plugin[at] >= 0:
        return "whose force a plugin computes"
    if model.actuator_dyntype[at] not in (STATELESS, INTEGRATOR, *FILTERS):
        return "whose state is not that of an integrator or filter"
    if model.actuator_gaintype[at] not in (FIXED, AFFINE) or model.actuator_biastype[at] not in (FIXED, AFFINE):
        return "whose gain or bias is neither constant nor affine"
    if (delay is not None and delay[at] > 0.0) or (early is not None and early[at] and model.actuator_dyntype[at] != STATELESS):
        return "which has a delay or actearly"
    return None


def _tuple(model: mujoco.MjModel, names: Names, at: int, name: str, joint: int, gear: float) -> tuple[Any, ...]:
    of_control = int(getattr(model, "actuator_ctrladr", range(model.nu))[at])
    is_affine, dynamics = model.actuator_gaintype[at] == AFFINE, model.actuator_dyntype[at]
    gain = model.actuator_gainprm[at, :3] * ([1.0, 1.0, 1.0] if is_affine else [1.0, 0.0, 0.0])
    bias = model.actuator_biasprm[at, :3] * (model.actuator_biastype[at] == AFFINE)
    control = _range(model.actuator_ctrlrange[of_control], model.actuator_ctrllimited[of_control] and not is_disabled(model, "CLAMPCTRL"))
    force = _range(model.actuator_forcerange[at], model.actuator_forcelimited[at])
    torque = _range(model.jnt_actfrcrange[joint], model.jnt_actfrclimited[joint])
    activation = None
    if dynamics != STATELESS:
        time = np.inf if dynamics == INTEGRATOR else max(float(model.actuator_dynprm[at, 0]), np.finfo(float).tiny)
        activation = time, _range(model.actuator_actrange[at], model.actuator_actlimited[at])
    of_state = int(model.actuator_actadr[at])
    keys = {
        key: (float(ctrl[of_control]), float(act[of_state]) if of_state >= 0 else 0.0)
        for key, ctrl, act in zip(names.keyframes, model.key_ctrl, model.key_act, strict=True)
    }
    return name, names.joints[joint], gear, tuple(gain.tolist()), tuple(bias.tolist()), (control, force, torque), activation, keys, None


def _range(ends: Any, is_limited: Any) -> tuple[float, float]:
    return (float(ends[0]), float(ends[1])) if is_limited else ALL
