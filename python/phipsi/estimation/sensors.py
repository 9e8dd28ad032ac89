"""Sensors of an observer: what they read at a state, and how that depends on the state and on the torque noise of the step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ArgumentError, of_argument

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["Accelerometer", "Contact", "Encoder", "Gyro", "LinkMotion", "Prediction", "Sensor", "TorqueSensor"]

_Array = NDArray[np.float64]


class Prediction(NamedTuple):
    """What a sensor reads at a state, and its derivatives."""

    value: _Array
    """The predicted reading, (..., m), bias left out."""
    by_q: _Array
    """Derivative by q in its tangent space, (..., m, nv)."""
    by_qd: _Array
    """Derivative by qd, (..., m, nv)."""
    by_qdd: _Array | None = None
    """Derivative by qdd, (..., m, nv), if the reading depends on it; q and qd act through qdd too."""
    by_noise: _Array | None = None
    """Derivative by the torque noise of the step at constant q, qd and qdd, (..., m, nv)."""


class LinkMotion:
    """Velocity and acceleration of a frame on a link, weight included, with their derivatives, in that frame."""

    def __init__(self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None], link: str, at: ArrayLike, rotation: _Array) -> None:
        q, qd, qdd = state
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = rotation.T
        # Columns are the joints' twists as they move this frame; those of joints that do not move it are zero.
        s = turn @ np.asarray(scene.jacobian(q, link, at=at))
        self.jacobian: _Array = s
        moved = np.cumsum(s * qd[..., None, :], axis=-1)
        # The velocity just inboard of each joint, and just outboard of it; `groups` are the first and last degree of freedom of the joint of each.
        first, last = groups
        inboard = np.where(first > 0, moved[..., :, first - 1], 0.0)
        outboard = moved[..., :, last]
        self.velocity: _Array = moved[..., :, -1]
        whole = self.velocity[..., :, None]
        self.velocity_by_q: _Array = _cross(inboard, s)
        if qdd is None:
            return
        weight = np.zeros_like(self.velocity)
        axes = np.asarray(scene.placement(q, link))[..., :3, :3] @ rotation
        weight[..., 3:] = -np.swapaxes(axes, -1, -2) @ scene.gravity
        added = np.cumsum(s * qdd[..., None, :] + _cross(inboard, s * qd[..., None, :]), axis=-1)
        before = weight[..., :, None] + np.where(first > 0, added[..., :, first - 1], 0.0)
        acceleration = weight + added[..., :, -1]
        by_q = _cross(before, s) + _cross(self.velocity_by_q, whole - inboard)
        by_qd = _cross(outboard, s) - _cross(whole - inboard, s)
        #: Of the origin as a point: a + w x v.
        self.point_acceleration: _Array = acceleration[..., 3:] + _cross3(self.velocity[..., :3, None], self.velocity[..., 3:, None])[..., 0]
        self.point_by_q: _Array = by_q[..., 3:, :] + self._turning(self.velocity_by_q)
        self.point_by_qd: _Array = by_qd[..., 3:, :] + self._turning(s)

    def _turning(self, change: _Array) -> _Array:
        """The change of w x v."""
        w, v = self.velocity[..., :3], self.velocity[..., 3:]
        return _cross3(change[..., :3, :], v[..., :, None]) + _cross3(w[..., :, None], change[..., 3:, :])


def _cross3(a: _Array, b: _Array) -> _Array:
    """a x b, vectors along the last axis but one: written out, because numpy.cross takes most of its time to arrange axes."""
    (a0, a1, a2), (b0, b1, b2) = ([x[..., i, :] for i in range(3)] for x in (a, b))
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-2)


def _cross(a: _Array, b: _Array) -> _Array:
    """The motion a x b, (angular, linear) along the last axis but one."""
    w = _cross3(a[..., :3, :], b[..., :3, :])
    return np.concatenate([w, _cross3(a[..., 3:, :], b[..., :3, :]) + _cross3(a[..., :3, :], b[..., 3:, :])], axis=-2)


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """What all sensors have.

    Attributes
    ----------
    noise : float or (m,)
        Standard deviation of a reading.
    name : str
        The key of its readings in Observer.step.
    delay : int
        How many steps after its time a reading arrives.
    """

    noise: ArrayLike
    name: str = ""
    delay: int = 0

    def size(self, scene: Scene) -> int:
        """The number m of its components."""
        raise NotImplementedError

    def predict(self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None], tau: _Array) -> Prediction:
        """What it reads at (q, qd, qdd), under these joint torques."""
        raise NotImplementedError

    @property
    def biases(self) -> tuple[float, float] | None:
        """Standard deviation of the bias at the start and its growth per square root of a second; None if it has none."""
        return None

    @property
    def needs_acceleration(self) -> bool:
        """Whether its reading depends on qdd."""
        return False


def _rows_of(scene: Scene, joints: Sequence[str] | None, what: str) -> tuple[list[int], list[int]]:
    """Coordinates and degrees of freedom of joints of one axis; by default of all of them."""
    coordinates, rows = [], []
    for joint in scene.joint_names if joints is None else joints:
        at, v = scene.q_index(joint), scene.v_index(joint)
        if at.stop - at.start != 1:
            if joints is None:
                continue
            raise of_argument(ArgumentError, what, f"found the joint {joint!r}, which has {at.stop - at.start} coordinates; expected joints of one")
        coordinates.append(at.start)
        rows.append(v.start)
    return coordinates, rows


@dataclass(frozen=True, kw_only=True)
class Encoder(Sensor):
    """Positions of joints of one axis, rad or m.

    Attributes
    ----------
    joints : sequence of str, optional
        Joints that have one; all joints of one axis by default, in the order of joint_names.

    Examples
    --------
    >>> from phipsi.estimation import Encoder
    >>> Encoder(noise=1e-4).name
    'encoder'
    """

    name: str = "encoder"
    joints: Sequence[str] | None = None

    def size(self, scene: Scene) -> int:
        return len(_rows_of(scene, self.joints, "Encoder.joints")[0])

    def predict(self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None], tau: _Array) -> Prediction:
        q = state[0]
        coordinates, rows = _rows_of(scene, self.joints, "Encoder.joints")
        by_q = np.zeros((*q.shape[:-1], len(rows), scene.nv))
        by_q[..., np.arange(len(rows)), rows] = 1.0
        return Prediction(q[..., coordinates], by_q, np.zeros_like(by_q))


@dataclass(frozen=True, kw_only=True)
class TorqueSensor(Sensor):
    """Torques of joints, N m or N: the commanded torque and the torque noise of the step.

    Attributes
    ----------
    joints : sequence of str, optional
        Joints of one axis that have one; all of them by default.

    Examples
    --------
    >>> from phipsi.estimation import TorqueSensor
    >>> TorqueSensor(noise=0.05).name
    'torque'
    """

    name: str = "torque"
    joints: Sequence[str] | None = None

    def size(self, scene: Scene) -> int:
        return len(_rows_of(scene, self.joints, "TorqueSensor.joints")[0])

    def predict(self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None], tau: _Array) -> Prediction:
        rows = _rows_of(scene, self.joints, "TorqueSensor.joints")[1]
        none = np.zeros((*state[0].shape[:-1], len(rows), scene.nv))
        by_noise = none.copy()
        by_noise[..., np.arange(len(rows)), rows] = 1.0
        return Prediction(tau[..., rows], none, none, None, by_noise)


@dataclass(frozen=True, kw_only=True)
class _OnLink(Sensor):
    link: str
    xyz: ArrayLike = (0.0, 0.0, 0.0)
    rotation: ArrayLike = field(default_factory=lambda: np.eye(3))

    def size(self, scene: Scene) -> int:
        scene.link(self.link)
        turn = np.asarray(self.rotation, float)
        if turn.shape != (3, 3) or not np.abs(turn.T @ turn - np.eye(3)).max() <= 1e-9:
            raise of_argument(ArgumentError, f"rotation of {self.name!r}", "found a matrix that is no rotation; expected the sensor's axes as columns in the link's frame")
        return 3

    def _motion(self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None]) -> LinkMotion:
        return LinkMotion(scene, groups, state, self.link, self.xyz, np.asarray(self.rotation, float))


@dataclass(frozen=True, kw_only=True)
class Gyro(_OnLink):
    """Angular velocity of a link in the sensor's axes, rad/s, with a bias that walks.

    Attributes
    ----------
    link : str
        The link that carries it.
    rotation : (3, 3)
        The sensor's axes as columns in the link's frame.
    bias : float
        Standard deviation of the bias at the start, rad/s; zero: no bias.
    bias_walk : float
        Its growth per square root of a second, rad/s/sqrt(s).

    Examples
    --------
    >>> from phipsi.estimation import Gyro
    >>> Gyro(link="hand", noise=1e-3, bias=0.01, bias_walk=1e-4).name
    'gyro'
    """

    name: str = "gyro"
    bias: float = 0.0
    bias_walk: float = 0.0

    @property
    def biases(self) -> tuple[float, float] | None:
        return (self.bias, self.bias_walk) if self.bias > 0.0 or self.bias_walk > 0.0 else None

    def predict(self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None], tau: _Array) -> Prediction:
        motion = self._motion(scene, groups, (state[0], state[1], None))
        return Prediction(motion.velocity[..., :3], motion.velocity_by_q[..., :3, :], motion.jacobian[..., :3, :])


@dataclass(frozen=True, kw_only=True)
class Accelerometer(_OnLink):
    """Acceleration less gravity of a point on a link in the sensor's axes, m/s^2, with a bias that walks.

    The torque noise of a step affects its reading; the observer takes this correlation into account.

    Attributes
    ----------
    link : str
        The link that carries it.
    xyz : (3,)
        Where on the link it is, m.
    rotation : (3, 3)
        The sensor's axes as columns in the link's frame.
    bias : float
        Standard deviation of the bias at the start, m/s^2; zero: no bias.
    bias_walk : float
        Its growth per square root of a second, m/s^2/sqrt(s).

    Examples
    --------
    >>> from phipsi.estimation import Accelerometer
    >>> Accelerometer(link="hand", noise=0.02, bias=0.05).name
    'accelerometer'
    """

    name: str = "accelerometer"
    bias: float = 0.0
    bias_walk: float = 0.0

    @property
    def biases(self) -> tuple[float, float] | None:
        return (self.bias, self.bias_walk) if self.bias > 0.0 or self.bias_walk > 0.0 else None

    @property
    def needs_acceleration(self) -> bool:
        return True

    def predict(self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None], tau: _Array) -> Prediction:
        motion = self._motion(scene, groups, state)
        return Prediction(motion.point_acceleration, motion.point_by_q, motion.point_by_qd, motion.jacobian[..., 3:, :])


@dataclass(frozen=True, kw_only=True)
class Contact(_OnLink):
    """A point of a link that is at rest while it touches the ground: its velocity is zero to within the noise, m/s.

    Its reading is True while it touches; False, None or no reading: nothing is known.

    Attributes
    ----------
    link : str
        The link.
    xyz : (3,)
        The point in the link's frame, m.

    Examples
    --------
    >>> from phipsi.estimation import Contact
    >>> Contact(link="foot", noise=1e-3, xyz=(0, 0, -0.1)).name
    'contact'
    """

    name: str = "contact"

    def predict(self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None], tau: _Array) -> Prediction:
        motion = self._motion(scene, groups, (state[0], state[1], None))
        return Prediction(motion.velocity[..., 3:], motion.velocity_by_q[..., 3:, :], motion.jacobian[..., 3:, :])
