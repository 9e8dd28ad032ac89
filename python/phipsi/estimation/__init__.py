"""Estimation from logs of measurements: smoothing, identification of parameters with intervals, excitation.

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
from ._smooth import Smoothed

__all__ = ["Accumulator", "BaseParameters", "Excitation", "Smoothed", "accumulate_logs", "read_log"]
