"""Sensors of an observer: predicted readings and their derivatives by the state and by the torque noise of the step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arguments import numbers, whole
from ..errors import ArgumentError, ShapeError, of_argument
from ._chi_square import chi_square_quantile

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["Accelerometer", "Contact", "Encoder", "Gyro", "Prediction", "Sensor", "TorqueSensor"]

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
        Number of steps between the time of a reading and the step that receives it, at most 10,000.
    gate : float
        Probability with which a correct component of a reading is processed, above 0 and at most 1. A component whose
        squared difference from the prediction, divided by its variance, exceeds the chi-square quantile of this
        probability is rejected as an outlier, for instance 0.999. One, the default: none is rejected.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi.estimation import Encoder, Sensor
    >>> isinstance(Encoder(noise=1e-4, delay=2), Sensor)
    True
    """

    #: Name of the kind in compiled code; None in the base class.
    _kind: ClassVar[str | None] = None

    noise: ArrayLike
    name: str = ""
    delay: int = 0
    gate: float = 1.0

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
        """Predict the reading at a state, and its derivatives by the state and by the torque noise of the step.

        Observers compute the same predictions in compiled code, without this method.

        Parameters
        ----------
        scene : phipsi.Scene
            The robot.
        groups : (2, nv) ndarray
            First and last degree of freedom of the joint of each degree of freedom. The scene determines them too.
        state : tuple of ndarray
            (q, qd, qdd), (..., nq) and (..., nv); qdd is None if the reading does not depend on it.
        tau : (..., nv) ndarray
            Joint torques, N m or N.

        Returns
        -------
        prediction : Prediction
            Predicted reading and its derivatives.

        Raises
        ------
        ArgumentError, ShapeError, NotFiniteError
            An unknown link or joint, or an invalid state.

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
        qdd = np.full(scene.nv, np.nan) if state[2] is None else state[2]
        named = zip(("q", "qd", "qdd", "tau"), (state[0], state[1], qdd, tau), strict=True)
        given = [numbers(name, array) for name, array in named]
        batch = np.broadcast_shapes(*(array.shape[:-1] for array in given))
        flat = [
            np.ascontiguousarray(np.broadcast_to(array, (*batch, array.shape[-1]))).reshape(-1, array.shape[-1])
            for array in given
        ]
        found, (by_qdd, by_noise) = scene._sensor_prediction(self._compiled(scene), flat[:3], flat[3])
        value, of_q, of_qd, of_qdd, of_noise = (array.reshape(*batch, *array.shape[1:]) for array in found)
        return Prediction(value, of_q, of_qd, of_qdd if by_qdd else None, of_noise if by_noise else None)

    def _compiled(self, scene: Scene) -> tuple[Any, ...]:
        """Arguments of the sensor in compiled code: kind, name, joints, mount, noise, delay, bias with growth, gate."""
        size, noise = self.size(scene), numbers(f"noise of {self.name!r}", self.noise)
        if noise.ndim > 1:
            raise of_argument(
                ShapeError, f"noise of {self.name!r}", f"found shape {noise.shape}; expected () or ({size},)"
            )
        delay = whole(f"delay of {self.name!r}", self.delay, 0, "a whole number of steps, zero or more")
        joints, mount = self._source()
        bias = float(getattr(self, "bias", 0.0)), float(getattr(self, "bias_walk", 0.0))
        gate = numbers(f"gate of {self.name!r}", self.gate)
        if gate.ndim or not 0.0 < gate <= 1.0:
            found = f"found {self.gate!r}; expected a probability above 0 and at most 1, for instance 0.999"
            raise of_argument(ArgumentError, f"gate of {self.name!r}", found)
        largest = math.inf if gate == 1.0 else math.sqrt(chi_square_quantile(float(gate), 1.0))
        return self._kind, self.name, joints, mount, noise.reshape(-1).tolist(), delay, bias, largest

    def _source(self) -> tuple[list[str] | None, tuple[Any, ...] | None]:
        """Names of the joints, and link with position and axes."""
        return None, None

    @property
    def biases(self) -> tuple[float, float] | None:
        """Initial standard deviation of the bias and its growth per square root of a second; None without bias."""
        return None


def _size_of(scene: Scene, joints: Sequence[str] | None, what: str) -> int:
    """Number of the given joints, which have one axis; by default of all joints of one axis."""
    count = 0
    for joint in scene.joint_names if joints is None else joints:
        at = scene.q_index(joint)
        if at.stop - at.start == 1:
            count += 1
        elif joints is not None:
            raise of_argument(
                ArgumentError,
                what,
                f"found the joint {joint!r}, which has {at.stop - at.start} coordinates; expected joints of one",
            )
    return count


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

    _kind: ClassVar[str | None] = "encoder"

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
        return _size_of(scene, self.joints, "Encoder.joints")

    def _source(self) -> tuple[list[str] | None, tuple[Any, ...] | None]:
        return None if self.joints is None else list(self.joints), None


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

    _kind: ClassVar[str | None] = "torque"

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
        return _size_of(scene, self.joints, "TorqueSensor.joints")

    def _source(self) -> tuple[list[str] | None, tuple[Any, ...] | None]:
        return None if self.joints is None else list(self.joints), None


@dataclass(frozen=True, kw_only=True)
class _OnLink(Sensor):
    link: str
    xyz: ArrayLike = (0.0, 0.0, 0.0)
    rotation: ArrayLike = field(default_factory=lambda: np.eye(3))

    def size(self, scene: Scene) -> int:
        scene.link(self.link)
        turn = numbers(f"rotation of {self.name!r}", self.rotation)
        if turn.shape != (3, 3) or not np.abs(turn.T @ turn - np.eye(3)).max() <= 1e-9:
            raise of_argument(
                ArgumentError,
                f"rotation of {self.name!r}",
                "found a matrix that is not a rotation; expected the sensor axes as columns in the link frame",
            )
        return 3

    def _source(self) -> tuple[list[str] | None, tuple[Any, ...] | None]:
        position = numbers(f"xyz of {self.name!r}", self.xyz)
        if position.shape != (3,):
            raise of_argument(ShapeError, f"xyz of {self.name!r}", f"found shape {position.shape}; expected (3,)")
        return None, (self.link, position.tolist(), numbers(f"rotation of {self.name!r}", self.rotation).tolist())


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

    _kind: ClassVar[str | None] = "gyro"

    name: str = "gyro"
    bias: float = 0.0
    bias_walk: float = 0.0

    @property
    def biases(self) -> tuple[float, float] | None:
        return (self.bias, self.bias_walk) if self.bias > 0.0 or self.bias_walk > 0.0 else None


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

    _kind: ClassVar[str | None] = "accelerometer"

    name: str = "accelerometer"
    bias: float = 0.0
    bias_walk: float = 0.0

    @property
    def biases(self) -> tuple[float, float] | None:
        return (self.bias, self.bias_walk) if self.bias > 0.0 or self.bias_walk > 0.0 else None


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

    _kind: ClassVar[str | None] = "contact"

    name: str = "contact"
