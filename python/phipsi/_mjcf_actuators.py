"""Actuators of a MuJoCo model as a map from controls to joint torques."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from ._mjcf import Names, compiled, is_disabled, joint_actuators
from .errors import ArgumentError, ModelWarning, NotFiniteError, SceneError, ShapeError, known_names, of_argument, warn

if TYPE_CHECKING:
    import mujoco

    from ._core import Scene

__all__ = ["Actuators", "actuators"]

_Array = NDArray[np.float64]

#: Values of mjtGain and mjtBias without a state: a constant, and one that is affine in length and velocity.
FIXED, AFFINE = 0, 1


class Actuators:
    """Map from controls to joint torques: gain ctrl + bias, clamped, times the gear ratio.

    Created by phipsi.mujoco.actuators.

    Examples
    --------
    >>> import phipsi, phipsi.mujoco  # doctest: +SKIP
    >>> scene = phipsi.load("robot.xml")  # doctest: +SKIP
    >>> motors = phipsi.mujoco.actuators(scene)  # doctest: +SKIP
    >>> path = scene.simulate(q, qd, tau=motors.law({"knee": 0.5}), dt=0.002, steps=500)  # doctest: +SKIP
    """

    def __init__(self, scene: Scene, model: mujoco.MjModel, read: list[tuple[int, int, float]]) -> None:
        names = Names(model)
        at = [actuator for actuator, _, _ in read]
        joints = [joint for _, joint, _ in read]
        self.scene = scene
        #: Names of the actuators, in the order of the controls; unnamed ones are called "actuator0" and so on.
        self.names = tuple(model.actuator(one).name or f"actuator{one}" for one in at)
        #: Name of the joint of each actuator.
        self.joints = tuple(names.joints[joint] for joint in joints)
        #: Gear ratio of each actuator: joint torque per force.
        self.gear = np.array([gear for _, _, gear in read])
        is_clamped = not is_disabled(model, "CLAMPCTRL")
        #: Smallest and largest control of each actuator, (n, 2); controls are clamped to them, as in MuJoCo.
        self.ctrlrange = _bounds(model.actuator_ctrlrange[at], model.actuator_ctrllimited[at] if is_clamped else np.zeros(len(at)))
        #: Smallest and largest force of each actuator before the gear ratio, (n, 2).
        self.forcerange = _bounds(model.actuator_forcerange[at], model.actuator_forcelimited[at])
        #: Controls of each keyframe, (n,), by its name.
        self.keyframes = {name: np.array(ctrl[at]) for name, ctrl in zip(names.keyframes, model.key_ctrl, strict=True)}
        affine = (model.actuator_gaintype[at] == AFFINE)[:, None] | [True, False, False]
        self._gain = np.where(affine, model.actuator_gainprm[at][:, :3], 0.0)
        self._bias = np.where((model.actuator_biastype[at] == AFFINE)[:, None], model.actuator_biasprm[at][:, :3], 0.0)
        self._rows = np.array([scene.v_index(joint).start for joint in self.joints], dtype=np.intp)
        self._columns = np.array([scene.q_index(joint).start for joint in self.joints], dtype=np.intp)
        self._limits = np.tile([-np.inf, np.inf], (scene.nv, 1))
        for joint, row in zip(joints, self._rows, strict=True):
            if model.jnt_actfrclimited[joint]:
                self._limits[row] = model.jnt_actfrcrange[joint]

    def __len__(self) -> int:
        """Number of actuators."""
        return len(self.names)

    def __repr__(self) -> str:
        pairs = ", ".join(f"{name}: {joint}" for name, joint in zip(self.names, self.joints, strict=True))
        return f"<phipsi.mujoco.Actuators: {pairs}>"

    def torques(self, ctrl: Mapping[str, ArrayLike] | ArrayLike, q: ArrayLike | None = None, qd: ArrayLike | None = None) -> _Array:
        """Joint torques of controls.

        Parameters
        ----------
        ctrl : array_like, (..., n), or mapping from names to array_like
            Controls in the order of `names`, or by name; actuators that a mapping does not contain have control 0.
        q : array_like, (..., nq), optional
            Joint positions, for actuators whose force depends on them (position servos); None: neutral.
        qd : array_like, (..., nv), optional
            Joint velocities; None: zero.

        Returns
        -------
        array
            Joint torques, (..., nv), N m or N.

        Raises
        ------
        ArgumentError, ShapeError, NotFiniteError
            An unknown name, a wrong shape, or a control that is not finite.

        Examples
        --------
        >>> phipsi.mujoco.actuators(scene).torques({"knee": 0.5})  # doctest: +SKIP
        """
        scene = self.scene
        u = self._controls(ctrl)
        q = np.asarray(scene.neutral() if q is None else _core._numbers("q", q, scene, True))
        qd = np.zeros(scene.nv) if qd is None else np.asarray(_core._numbers("qd", qd, scene, False))
        for name, value, width in (("q", q, scene.nq), ("qd", qd, scene.nv)):
            if value.shape[-1:] != (width,):
                raise of_argument(ShapeError, name, f"found shape {value.shape}; expected (..., {width})")
        try:
            batch = np.broadcast_shapes(u.shape[:-1], q.shape[:-1], qd.shape[:-1])
        except ValueError:
            text = f"found leading axes {u.shape[:-1]}; expected ones that broadcast with those of q and qd"
            raise of_argument(ShapeError, "ctrl", text) from None
        length, velocity = self.gear * q[..., self._columns], self.gear * qd[..., self._rows]
        (g0, g1, g2), (b0, b1, b2) = self._gain.T, self._bias.T
        force = (g0 + g1 * length + g2 * velocity) * np.clip(u, *self.ctrlrange.T) + b0 + b1 * length + b2 * velocity
        force = self.gear * np.clip(force, *self.forcerange.T)
        tau = np.zeros((*batch, scene.nv))
        for at, row in enumerate(self._rows):
            tau[..., row] += force[..., at]
        return np.asarray(np.clip(tau, *self._limits.T))

    def law(self, ctrl: Mapping[str, ArrayLike] | ArrayLike) -> Any:
        """The torques of constant controls as a function of (t, q, qd), for Scene.simulate(tau=...).

        Parameters
        ----------
        ctrl : array_like, (..., n), or mapping from names to array_like
            Controls, as for torques.

        Returns
        -------
        callable
            Function of (t, q, qd).

        Examples
        --------
        >>> scene.simulate(q, qd, tau=motors.law({"knee": 0.5}), dt=0.002, steps=500)  # doctest: +SKIP
        """
        u = self._controls(ctrl)
        return lambda t, q, qd: self.torques(u, q, qd)

    def _controls(self, ctrl: Any) -> _Array:
        if isinstance(ctrl, Mapping):
            for name in ctrl:
                if name not in self.names:
                    raise of_argument(ArgumentError, "ctrl", f"found {name!r}; expected names of {known_names(name, self.names)}")
            values = [np.asarray(_core._numbers(f"ctrl[{name!r}]", ctrl.get(name, 0.0))) for name in self.names]
            u = np.stack(np.broadcast_arrays(*values), axis=-1) if values else np.zeros(0)
        else:
            u = np.asarray(_core._numbers("ctrl", ctrl))
        if u.shape[-1:] != (len(self),):
            raise of_argument(ShapeError, "ctrl", f"found shape {u.shape}; expected (..., {len(self)})")
        if not np.isfinite(u).all():
            raise of_argument(NotFiniteError, "ctrl", "found NaN or infinity; expected finite controls")
        return u


def _bounds(ranges: Any, limited: Any) -> _Array:
    """Ranges, (n, 2), infinite where they do not act."""
    return np.where(np.asarray(limited, bool)[:, None], ranges, [-np.inf, np.inf])


def actuators(scene: Scene, source: mujoco.MjModel | mujoco.MjSpec | str | os.PathLike[str] | None = None, *, strict: bool = False) -> Actuators:
    """Read the actuators of a MuJoCo model as a map from named controls to joint torques.

    Supported are motors, position and velocity servos, and general actuators with constant or affine gain and bias on
    hinge and slide joints, with gear, ctrlrange and forcerange.

    Parameters
    ----------
    scene : Scene
        Scene of the model.
    source : mujoco.MjModel, mujoco.MjSpec, path or str, optional
        The model; None: the file that the scene was read from.
    strict : bool
        True to raise SceneError for actuators that are not supported, instead of a warning.

    Returns
    -------
    Actuators
        The map.

    Raises
    ------
    ArgumentError
        If the scene has no file and no source is given.
    SceneError
        If the source cannot be read, or with strict.

    Warns
    -----
    ModelWarning
        Actuators with a state (dyntype), muscles, and actuators of tendons, sites, bodies, ball and free joints, which
        are not in the map.

    Examples
    --------
    >>> import phipsi, phipsi.mujoco  # doctest: +SKIP
    >>> scene = phipsi.load("robot.xml")  # doctest: +SKIP
    >>> phipsi.mujoco.actuators(scene).names  # doctest: +SKIP
    ('hip', 'knee')
    """
    if source is None:
        source = scene.file
    if source is None:
        raise of_argument(ArgumentError, "source", "found None, and a scene without a file; expected the MuJoCo model")
    model, _ = compiled(source, strict)
    known = set(scene.joint_names)
    names, read, lost = Names(model), [], []
    on_joint = {at: (joint, gear) for at, joint, gear in joint_actuators(model)}
    for at in range(len(model.actuator_trntype)):
        what = f"the actuator {model.actuator(at).name or f'actuator{at}'!r}"
        if at not in on_joint:
            lost.append(f"{what}, which does not act on a hinge or slide joint")
        elif model.actuator_dyntype[at] != 0:
            lost.append(f"{what}, which has a state (dyntype)")
        elif model.actuator_gaintype[at] not in (FIXED, AFFINE) or model.actuator_biastype[at] not in (FIXED, AFFINE):
            lost.append(f"{what}, whose gain or bias is neither constant nor affine")
        elif names.joints[on_joint[at][0]] not in known:
            lost.append(f"{what}, whose joint {names.joints[on_joint[at][0]]!r} is not a joint of the scene")
        else:
            read.append((at, *on_joint[at]))
    if lost:
        text = f"source: found {lost[0]}" + (f" and {len(lost) - 1} more" if len(lost) > 1 else "")
        if strict:
            raise SceneError(f"{text}; expected motors and servos of hinge and slide joints")
        warn(f"{text}; they are not in the map", ModelWarning)
    if is_disabled(model, "ACTUATION"):
        read = []
    return Actuators(scene, model, read)
