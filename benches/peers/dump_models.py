"""Write the benchmark models in the binary format of pinocchio_bench.

Usage: .venv-peers/bin/python benches/peers/dump_models.py OUT

    OUT/NAME.bin   the Pinocchio model
    OUT/NAME.urdf  for robots, the file of the model, so that both programs read the same one
"""

import argparse
import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin

# In order of size. "floating" adds a free joint at the root link, as for legged robots.
ROBOTS = [
    ("ur5", "ur_description/urdf/ur5_robot.urdf", "fixed"),
    ("panda", "panda_description/urdf/panda.urdf", "fixed"),
    ("anymal", "anymal_b_simple_description/robots/anymal.urdf", "floating"),
    ("g1", "g1_description/urdf/g1_29dof_rev_1_0.urdf", "floating"),
    ("talos", "talos_data/robots/talos_reduced.urdf", "floating"),
]
CHAIN_LENGTHS = (7, 16, 30, 64)

LINK_LENGTH = 0.3  # m
LINK_MASS = 1.0  # kg
LINK_INERTIA = (0.01, 0.01, 0.002)  # kg m^2, principal, about the center of mass


def urdf_path(relative: str) -> Path:
    """The URDF below robots/ of the wheel example-robot-data.

    The wheel contains data and no module. It is found from pinocchio, which is in the same prefix:

        <prefix>/lib/pythonX.Y/site-packages/pinocchio/__init__.py.
    """
    prefix = Path(pin.__file__).resolve().parents[4]
    path = prefix / "share" / "example-robot-data" / "robots" / relative
    if not path.is_file():
        raise FileNotFoundError(f"{path}: has example-robot-data moved its robots?")
    return path


def robot(path: Path, base: str) -> pin.Model:
    """The robot of the URDF. Mimic joints are independent, as in Pinocchio's default."""
    if base == "floating":
        return pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    return pin.buildModelFromUrdf(str(path))


def chain(n: int) -> pin.Model:
    """n equal links, each along z of its frame and rotating about that z.

    Every second joint frame is rotated by 90 degrees about x relative to its parent. Therefore the axes of joints 0
    and 1 are at right angles, those of 1 and 2 coincide, those of 2 and 3 are at right angles, and so on.
    """
    inertia = pin.Inertia(LINK_MASS, np.array([0.0, 0.0, LINK_LENGTH / 2]), np.diag(LINK_INERTIA))
    quarter_turn = pin.utils.rotate("x", np.pi / 2)
    model = pin.Model()
    parent = 0
    for k in range(n):
        rotation = quarter_turn if k % 2 == 1 else np.eye(3)
        offset = np.array([0.0, 0.0, LINK_LENGTH if k > 0 else 0.0])
        parent = model.addJoint(parent, pin.JointModelRZ(), pin.SE3(rotation, offset), f"joint_{k}")
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    return model


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)

    for name, relative, base in ROBOTS:
        path = urdf_path(relative)
        robot(path, base).saveToBinary(str(out / f"{name}.bin"))
        shutil.copyfile(path, out / f"{name}.urdf")
    for n in CHAIN_LENGTHS:
        chain(n).saveToBinary(str(out / f"chain_{n}.bin"))


if __name__ == "__main__":
    main()
