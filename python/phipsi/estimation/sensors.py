"""Sensors of an observer: predicted readings and their derivatives by the state and by the torque noise of the step."""

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
    """Predicted reading of a sensor at a state, and its derivatives."""

    value: _Array
    """Predicted reading without bias, (..., m)."""
    by_q: _Array
    """Derivative by q in its tangent space, (..., m, nv)."""
    by_qd: _Array
    """Derivative by qd, (..., m, nv)."""
    by_qdd: _Array | None = None
    """Derivative by qdd, (..., m, nv); None if the reading does not depend on it. by_q and by_qd are at constant
    qdd."""
    by_noise: _Array | None = None
    """Derivative by the torque noise of the step at constant q, qd and qdd, (..., m, nv)."""


class LinkMotion:
    """Velocity and proper acceleration of a frame on a link, with their derivatives, expressed in that frame."""

    def __init__(
        self,
        scene: Scene,
        groups: NDArray[np.int_],
        state: tuple[_Array, _Array, _Array | None],
        link: str,
        at: ArrayLike,
        rotation: _Array,
    ) -> None:
        q, qd, qdd = state
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = rotation.T
        # Columns are the twists of this frame per unit joint velocity; they are zero for joints that are not inboard of
        # it.
        s = turn @ np.asarray(scene.jacobian(q, link, at=at))
        self.jacobian: _Array = s
        moved = np.cumsum(s * qd[..., None, :], axis=-1)
        # Velocities inboard and outboard of each joint; `groups` holds the first and last degree of freedom of each
        # joint.
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
        #: Acceleration of the origin as a point: a + w x v.
        self.point_acceleration: _Array = (
            acceleration[..., 3:] + _cross3(self.velocity[..., :3, None], self.velocity[..., 3:, None])[..., 0]
        )
        self.point_by_q: _Array = by_q[..., 3:, :] + self._turning(self.velocity_by_q)
        self.point_by_qd: _Array = by_qd[..., 3:, :] + self._turning(s)

    def _turning(self, change: _Array) -> _Array:
        """Derivative of w x v."""
        w, v = self.velocity[..., :3], self.velocity[..., 3:]
        return _cross3(change[..., :3, :], v[..., :, None]) + _cross3(w[..., :, None], change[..., 3:, :])


def _cross3(a: _Array, b: _Array) -> _Array:
    """Cross product along the second-to-last axis. Written out, because numpy.cross spends most of its time on moving
    axes."""
    (a0, a1, a2), (b0, b1, b2) = ([x[..., i, :] for i in range(3)] for x in (a, b))
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-2)


def _cross(a: _Array, b: _Array) -> _Array:
    """Motion cross product, (angular, linear) along the second-to-last axis."""
    w = _cross3(a[..., :3, :], b[..., :3, :])
    return np.concatenate([w, _cross3(a[..., 3:, :], b[..., :3, :]) + _cross3(a[..., :3, :], b[..., 3:, :])], axis=-2)


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """Base class of the sensors.

    Attributes
    ----------
    noise : float or (m,)
        Standard deviation of a reading.
    name : str
        Key of the readings in Observer.step.
    delay : int
        Number of steps between the time of a reading and the step that receives it.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi.estimation import Encoder, Sensor
    >>> isinstance(Encoder(noise=1e-4, delay=2), Sensor)
    True
    """

    noise: ArrayLike
    name: str = ""
    delay: int = 0

    def size(self, scene: Scene) -> int:
        """Number of components m of a reading; each sensor class implements it.

        Parameters
        ----------
        scene : phipsi.Scene
            The robot.

        Returns
        -------
        size : int
            Number of components.

        Examples
        --------
        >>> import phipsi
        >>> phipsi.estimation.Sensor.size(phipsi.estimation.Encoder(noise=1e-4), phipsi.scenes.chain(2))
        Traceback (most recent call last):
        NotImplementedError
        """
        raise NotImplementedError

    def predict(
        self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None], tau: _Array
    ) -> Prediction:
        """Predict the reading at a state; each sensor class implements it.

        Observer.step calls this method.

        Parameters
        ----------
        scene : phipsi.Scene
            The robot.
        groups : (2, nv) ndarray
            First and last degree of freedom of the joint of each degree of freedom.
        state : tuple of ndarray
            (q, qd, qdd), (..., nq) and (..., nv); qdd is None if the reading does not depend on it.
        tau : (..., nv) ndarray
            Joint torques, N m or N.

        Returns
        -------
        prediction : Prediction
            Predicted reading and its derivatives.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> sensor, scene = phipsi.estimation.Encoder(noise=1e-4), phipsi.scenes.chain(2)
        >>> state = (np.zeros(2), np.zeros(2), None)
        >>> phipsi.estimation.Sensor.predict(sensor, scene, np.array([[0, 1], [0, 1]]), state, np.zeros(2))
        Traceback (most recent call last):
        NotImplementedError
        """
        raise NotImplementedError

    @property
    def biases(self) -> tuple[float, float] | None:
        """Initial standard deviation of the bias and its growth per square root of a second; None without bias."""
        return None

    @property
    def needs_acceleration(self) -> bool:
        """Whether the reading depends on qdd."""
        return False


def _rows_of(scene: Scene, joints: Sequence[str] | None, what: str) -> tuple[list[int], list[int]]:
    """Indices in q and in qd of the given joints of one axis; by default of all joints of one axis."""
    coordinates, rows = [], []
    for joint in scene.joint_names if joints is None else joints:
        at, v = scene.q_index(joint), scene.v_index(joint)
        if at.stop - at.start != 1:
            if joints is None:
                continue
            raise of_argument(
                ArgumentError,
                what,
                f"found the joint {joint!r}, which has {at.stop - at.start} coordinates; expected joints of one",
            )
        coordinates.append(at.start)
        rows.append(v.start)
    return coordinates, rows


@dataclass(frozen=True, kw_only=True)
class Encoder(Sensor):
    """Positions of joints of one axis, rad or m.

    Attributes
    ----------
    joints : sequence of str, optional
        Joints with an encoder; by default all joints of one axis, in the order of joint_names.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi.estimation import Encoder
    >>> Encoder(noise=1e-4).name
    'encoder'
    """

    name: str = "encoder"
    joints: Sequence[str] | None = None

    def size(self, scene: Scene) -> int:
        """Number of components m of a reading.

        Parameters
        ----------
        scene : phipsi.Scene
            The robot.

        Returns
        -------
        size : int
            Number of components.

        Examples
        --------
        >>> import phipsi
        >>> phipsi.estimation.Encoder(noise=1e-4).size(phipsi.scenes.chain(2))
        2
        """
        return len(_rows_of(scene, self.joints, "Encoder.joints")[0])

    def predict(
        self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None], tau: _Array
    ) -> Prediction:
        """Predict the joint positions at a state.

        Observer.step calls this method.

        Parameters
        ----------
        scene : phipsi.Scene
            The robot.
        groups : (2, nv) ndarray
            First and last degree of freedom of the joint of each degree of freedom.
        state : tuple of ndarray
            (q, qd, qdd), (..., nq) and (..., nv); qdd is None if the reading does not depend on it.
        tau : (..., nv) ndarray
            Joint torques, N m or N.

        Returns
        -------
        prediction : Prediction
            Predicted reading and its derivatives.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> sensor = phipsi.estimation.Encoder(noise=1e-4)
        >>> groups = np.array([[0, 1], [0, 1]])     # joints of one axis
        >>> state = (np.array([0.1, 0.2]), np.array([1.0, 0.0]), None)
        >>> sensor.predict(scene, groups, state, np.array([0.5, 0.0])).value
        array([0.1, 0.2])
        """
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
        Joints of one axis with a torque sensor; all joints of one axis by default.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi.estimation import TorqueSensor
    >>> TorqueSensor(noise=0.05).name
    'torque'
    """

    name: str = "torque"
    joints: Sequence[str] | None = None

    def size(self, scene: Scene) -> int:
        """Number of components m of a reading.

        Parameters
        ----------
        scene : phipsi.Scene
            The robot.

        Returns
        -------
        size : int
            Number of components.

        Examples
        --------
        >>> import phipsi
        >>> phipsi.estimation.TorqueSensor(noise=0.05).size(phipsi.scenes.chain(2))
        2
        """
        return len(_rows_of(scene, self.joints, "TorqueSensor.joints")[0])

    def predict(
        self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None], tau: _Array
    ) -> Prediction:
        """Predict the joint torques at a state.

        Observer.step calls this method.

        Parameters
        ----------
        scene : phipsi.Scene
            The robot.
        groups : (2, nv) ndarray
            First and last degree of freedom of the joint of each degree of freedom.
        state : tuple of ndarray
            (q, qd, qdd), (..., nq) and (..., nv); qdd is None if the reading does not depend on it.
        tau : (..., nv) ndarray
            Joint torques, N m or N.

        Returns
        -------
        prediction : Prediction
            Predicted reading and its derivatives.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> sensor = phipsi.estimation.TorqueSensor(noise=0.05)
        >>> groups = np.array([[0, 1], [0, 1]])     # joints of one axis
        >>> state = (np.array([0.1, 0.2]), np.array([1.0, 0.0]), None)
        >>> sensor.predict(scene, groups, state, np.array([0.5, 0.0])).value
        array([0.5, 0. ])
        """
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
            raise of_argument(
                ArgumentError,
                f"rotation of {self.name!r}",
                "found a matrix that is not a rotation; expected the sensor axes as columns in the link frame",
            )
        return 3

    def _motion(
        self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None]
    ) -> LinkMotion:
        return LinkMotion(scene, groups, state, self.link, self.xyz, np.asarray(self.rotation, float))


@dataclass(frozen=True, kw_only=True)
class Gyro(_OnLink):
    """Angular velocity of a link in the sensor frame, rad/s, with a random-walk bias.

    Attributes
    ----------
    link : str
        Link that the sensor is mounted on.
    rotation : (3, 3)
        Sensor axes as columns in the link frame.
    bias : float
        Initial standard deviation of the bias, rad/s; zero: no bias.
    bias_walk : float
        Growth of that standard deviation per square root of a second, rad/s/sqrt(s).

    Examples
    --------
    >>> import phipsi
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

    def predict(
        self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None], tau: _Array
    ) -> Prediction:
        """Predict the angular velocity at a state, in the sensor frame.

        Observer.step calls this method.

        Parameters
        ----------
        scene : phipsi.Scene
            The robot.
        groups : (2, nv) ndarray
            First and last degree of freedom of the joint of each degree of freedom.
        state : tuple of ndarray
            (q, qd, qdd), (..., nq) and (..., nv); qdd is None if the reading does not depend on it.
        tau : (..., nv) ndarray
            Joint torques, N m or N.

        Returns
        -------
        prediction : Prediction
            Predicted reading and its derivatives.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> sensor = phipsi.estimation.Gyro(link="link1", noise=1e-3)
        >>> groups = np.array([[0, 1], [0, 1]])     # joints of one axis
        >>> state = (np.array([0.1, 0.2]), np.array([1.0, 0.0]), None)
        >>> sensor.predict(scene, groups, state, np.array([0.5, 0.0])).value.shape
        (3,)
        """
        motion = self._motion(scene, groups, (state[0], state[1], None))
        return Prediction(motion.velocity[..., :3], motion.velocity_by_q[..., :3, :], motion.jacobian[..., :3, :])


@dataclass(frozen=True, kw_only=True)
class Accelerometer(_OnLink):
    """Proper acceleration of a point on a link in the sensor frame, m/s^2, with a random-walk bias.

    The proper acceleration is the acceleration minus gravity. The torque noise of a step affects the reading; the
    observer takes this correlation into account.

    Attributes
    ----------
    link : str
        Link that the sensor is mounted on.
    xyz : (3,)
        Position of the sensor in the link frame, m.
    rotation : (3, 3)
        Sensor axes as columns in the link frame.
    bias : float
        Initial standard deviation of the bias, m/s^2; zero: no bias.
    bias_walk : float
        Growth of that standard deviation per square root of a second, m/s^2/sqrt(s).

    Examples
    --------
    >>> import phipsi
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

    def predict(
        self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None], tau: _Array
    ) -> Prediction:
        """Predict the proper acceleration at a state, in the sensor frame.

        Observer.step calls this method.

        Parameters
        ----------
        scene : phipsi.Scene
            The robot.
        groups : (2, nv) ndarray
            First and last degree of freedom of the joint of each degree of freedom.
        state : tuple of ndarray
            (q, qd, qdd), (..., nq) and (..., nv); qdd is None if the reading does not depend on it.
        tau : (..., nv) ndarray
            Joint torques, N m or N.

        Returns
        -------
        prediction : Prediction
            Predicted reading and its derivatives.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> sensor = phipsi.estimation.Accelerometer(link="link1", noise=0.02)
        >>> groups = np.array([[0, 1], [0, 1]])     # joints of one axis
        >>> state = (np.zeros(2), np.zeros(2), np.zeros(2))
        >>> sensor.predict(scene, groups, state, np.array([0.5, 0.0])).value.shape
        (3,)
        """
        motion = self._motion(scene, groups, state)
        return Prediction(motion.point_acceleration, motion.point_by_q, motion.point_by_qd, motion.jacobian[..., 3:, :])


@dataclass(frozen=True, kw_only=True)
class Contact(_OnLink):
    """Contact of a point on a link with the ground: the point has zero velocity within the noise, m/s.

    The reading is True during contact. With False, None or no reading, the velocity is not constrained.

    Attributes
    ----------
    link : str
        The link.
    xyz : (3,)
        Position of the point in the link frame, m.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi.estimation import Contact
    >>> Contact(link="foot", noise=1e-3, xyz=(0, 0, -0.1)).name
    'contact'
    """

    name: str = "contact"

    def predict(
        self, scene: Scene, groups: NDArray[np.int_], state: tuple[_Array, _Array, _Array | None], tau: _Array
    ) -> Prediction:
        """Predict the velocity of the contact point at a state, in the sensor frame.

        Observer.step calls this method.

        Parameters
        ----------
        scene : phipsi.Scene
            The robot.
        groups : (2, nv) ndarray
            First and last degree of freedom of the joint of each degree of freedom.
        state : tuple of ndarray
            (q, qd, qdd), (..., nq) and (..., nv); qdd is None if the reading does not depend on it.
        tau : (..., nv) ndarray
            Joint torques, N m or N.

        Returns
        -------
        prediction : Prediction
            Predicted reading and its derivatives.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> sensor = phipsi.estimation.Contact(link="link1", noise=1e-3)
        >>> groups = np.array([[0, 1], [0, 1]])     # joints of one axis
        >>> state = (np.array([0.1, 0.2]), np.array([1.0, 0.0]), None)
        >>> sensor.predict(scene, groups, state, np.array([0.5, 0.0])).value.shape
        (3,)
        """
        motion = self._motion(scene, groups, (state[0], state[1], None))
        return Prediction(motion.velocity[..., 3:], motion.velocity_by_q[..., 3:, :], motion.jacobian[..., 3:, :])
