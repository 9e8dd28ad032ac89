"""Robots of example-robot-data, which is installed with Pinocchio's wheel."""

import warnings
from pathlib import Path

import phipsi
import pinocchio as pin

ROBOTS = Path(pin.__file__).resolve().parents[4] / "share/example-robot-data/robots"

#: Robots of several benches: file, and whether it has a floating base.
FILES = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", False),
    "panda": ("panda_description/urdf/panda.urdf", False),
    "solo12": ("solo_description/robots/solo12.urdf", True),
    "anymal": ("anymal_b_simple_description/robots/anymal.urdf", True),
    "g1": ("g1_description/urdf/g1_29dof_rev_1_0.urdf", True),
    "talos": ("talos_data/robots/talos_reduced.urdf", True),
}


def load(file: str, floating_base: bool = False) -> phipsi.Scene:
    """The scene of one of its files, without warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return phipsi.Scene.from_urdf(ROBOTS / file, floating_base=floating_base)
