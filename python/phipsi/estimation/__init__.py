"""Estimation: how sure results are, and what moves and pushes a robot."""

from .consistency import consistency_bounds, nees, nis
from .momentum import MomentumObserver, ObservedTorque, alarm_threshold, mean_time_to_alarm
from .motion import ExternalWrench, ObserverEstimate, SmoothedMotion
from .observer import Observer
from .sensors import Accelerometer, Contact, Encoder, Gyro, Sensor, TorqueSensor
from .trajectories import Bands, MotionUncertainty
from .uncertainty import AccelerationVariance, ParameterCovariance

__all__ = [
    "AccelerationVariance",
    "Accelerometer",
    "Bands",
    "Contact",
    "Encoder",
    "ExternalWrench",
    "Gyro",
    "MomentumObserver",
    "MotionUncertainty",
    "ObservedTorque",
    "Observer",
    "ObserverEstimate",
    "ParameterCovariance",
    "Sensor",
    "SmoothedMotion",
    "TorqueSensor",
    "alarm_threshold",
    "consistency_bounds",
    "mean_time_to_alarm",
    "nees",
    "nis",
]
