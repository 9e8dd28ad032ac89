"""Robots of example-robot-data, which is installed with Pinocchio's wheel."""

import warnings
from pathlib import Path

import phipsi
import pinocchio as pin

ROBOTS = Path(pin.__file__).resolve().parents[4] / "share/example-robot-data/robots"


def load(file: str, floating_base: bool = False) -> phipsi.Scene:
    """The scene of one of its files, without warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return phipsi.Scene.from_urdf(ROBOTS / file, floating_base=floating_base)
