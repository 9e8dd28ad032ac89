"""Estimation: identification from logs with intervals, uncertainty of results, observers.

>>> import numpy as np
>>> import phipsi
>>> time = np.arange(0.0, 2.0, 0.01)
>>> phipsi.smooth(time, np.sin(time), cutoff=10.0).qd.shape
(200, 1)
"""

from ._accumulator import Accumulator
from ._base import BaseParameters
from ._excitation import Excitation
from ._logs import accumulate_logs, read_log
from ._payload import DriveGains, Payload
from ._smooth import Smoothed
from .alarms import alarm_threshold, mean_time_to_alarm
from .consistency import consistency_bounds, nees, nis
from .momentum import MomentumObserver, ObservedTorque
from .motion import ExternalWrench, ObserverEstimate, SmoothedMotion
from .noise import MomentumNoise, momentum_noise
from .observer import Observer
from .sensors import Accelerometer, Contact, Encoder, Gyro, Pose, Sensor, TorqueSensor
from .trajectories import Bands, MotionUncertainty
from .uncertainty import AccelerationVariance, ParameterCovariance

__all__ = [
    "AccelerationVariance",
    "Accelerometer",
    "Accumulator",
    "Bands",
    "BaseParameters",
    "Contact",
    "DriveGains",
    "Encoder",
    "Excitation",
    "ExternalWrench",
    "Gyro",
    "MomentumNoise",
    "MomentumObserver",
    "MotionUncertainty",
    "ObservedTorque",
    "Observer",
    "ObserverEstimate",
    "ParameterCovariance",
    "Payload",
    "Pose",
    "Sensor",
    "Smoothed",
    "SmoothedMotion",
    "TorqueSensor",
    "accumulate_logs",
    "alarm_threshold",
    "consistency_bounds",
    "mean_time_to_alarm",
    "momentum_noise",
    "nees",
    "nis",
    "read_log",
]
