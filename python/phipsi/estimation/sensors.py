"""Sensors of an observer: predicted readings and their derivatives by the state and by the torque noise of the step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arguments import numbers, whole
from ..errors import ArgumentError, NotFiniteError, ShapeError, of_argument
from ._chi_square import chi_square_quantile

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["Accelerometer", "Contact", "Encoder", "Gyro", "Pose", "Prediction", "Sensor", "TorqueSensor"]

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
        """Arguments of the sensor in compiled code: kind, name, joints, mount, noise, delay, bias, gate, covariance."""
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
        return self._kind, self.name, joints, mount, noise.reshape(-1).tolist(), delay, bias, largest, None

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


@dataclass(frozen=True, kw_only=True)
class Pose(_OnLink):
    """Pose of a frame on a link in the base frame, for instance from a camera or motion capture.

    The error of a reading is (rotation vector, position) of the measured frame in the axes of the sensor frame: the
    rotation R exp(e) and the position p + R e. All its components are processed, or none if one is beyond the gate.

    Attributes
    ----------
    link : str
        Link that carries the frame.
    xyz : (3,)
        Origin of the frame in the link frame, m.
    rotation : (3, 3)
        Axes of the frame as columns in the link frame.
    noise : (6,) or float
        Standard deviations of the error (rotation, position), rad and m; with `covariance`, a factor of its deviations,
        one by default.
    covariance : (6, 6), optional
        Covariance of the error (rotation, position), rad^2 and m^2.

    Examples
    --------
    >>> import numpy as np, phipsi
    >>> from phipsi.estimation import Pose
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> tool, q = scene.link_names[-1], np.full(6, 0.4)
    >>> camera = Pose(link=tool, noise=[1e-3, 1e-3, 1e-3, 2e-4, 2e-4, 2e-4])
    >>> observer = scene.observer(0.01, [camera], q=q + 0.05, torque_noise=0.01, initial=(0.1, 0.1))
    >>> for _ in range(5):
    ...     estimate = observer.step(scene.gravity_torque(q), {"pose": scene.placement(q, tool)})
    >>> bool(np.abs(estimate.q - q).max() < 5e-3)
    True
    """

    _kind: ClassVar[str | None] = "pose"

    noise: ArrayLike = 1.0
    name: str = "pose"
    covariance: ArrayLike | None = None

    def size(self, scene: Scene) -> int:
        """Number of components m of the error of a reading.

        Parameters
        ----------
        scene : phipsi.Scene
            The robot.

        Returns
        -------
        size : int
            Six.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> phipsi.estimation.Pose(link=scene.link_names[-1], noise=1e-3).size(scene)
        6
        """
        super().size(scene)
        return 6

    def _compiled(self, scene: Scene) -> tuple[Any, ...]:
        *given, noise, delay, bias, largest, _ = super()._compiled(scene)
        covariance = np.eye(6)
        if self.covariance is not None:
            covariance = numbers(f"covariance of {self.name!r}", self.covariance)
            if covariance.shape != (6, 6):
                found = f"found shape {covariance.shape}; expected (6, 6)"
                raise of_argument(ShapeError, f"covariance of {self.name!r}", found)
        elif len(noise) == 6:
            # In the compiled code, errors are in units of their deviations.
            covariance, noise = np.diag(np.square(noise)), [1.0]
        return *given, noise, delay, bias, largest, covariance.tolist()

    def _vector(self, reading: ArrayLike) -> _Array:
        """Rotation vector and position, (..., 6), of poses (..., 4, 4); NaN for poses with a NaN."""
        pose = numbers(f"readings[{self.name!r}]", reading)
        if pose.shape[-2:] != (4, 4):
            found = f"found shape {pose.shape}; expected (..., 4, 4), as of Scene.placement"
            raise of_argument(ShapeError, f"readings[{self.name!r}]", found)
        known = np.asarray(~np.isnan(pose).any(axis=(-1, -2)))
        if np.isinf(pose).any():
            found = "found an infinity; expected finite poses, or NaN for missing ones"
            raise of_argument(NotFiniteError, f"readings[{self.name!r}]", found)
        r = np.where(known[..., None, None], pose[..., :3, :3], np.eye(3))
        if not np.all(np.abs(np.swapaxes(r, -1, -2) @ r - np.eye(3)) <= 1e-6) or not np.all(np.linalg.det(r) > 0.0):
            found = "found a matrix whose axes are no rotation; expected poses (4, 4)"
            raise of_argument(ArgumentError, f"readings[{self.name!r}]", found)
        # The quaternion (x, y, z, w) is the eigenvector of the largest eigenvalue (Bar-Itzhack).
        axis = np.stack([r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]], axis=-1)
        trace = np.einsum("...ii->...", r)[..., None, None]
        matrix = np.zeros((*r.shape[:-2], 4, 4))
        matrix[..., :3, :3] = r + np.swapaxes(r, -1, -2) - trace * np.eye(3)
        matrix[..., :3, 3] = matrix[..., 3, :3] = axis
        matrix[..., 3, 3] = trace[..., 0, 0]
        quaternion = np.linalg.eigh(matrix)[1][..., :, 3]
        quaternion = quaternion * np.where(quaternion[..., 3:] < 0.0, -1.0, 1.0)
        sine = np.linalg.norm(quaternion[..., :3], axis=-1, keepdims=True)
        angle = 2.0 * np.arctan2(sine, quaternion[..., 3:])
        turned = quaternion[..., :3] * np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 2.0)
        vector = np.concatenate([turned, pose[..., :3, 3]], axis=-1)
        return np.asarray(np.where(known[..., None], vector, np.nan))
