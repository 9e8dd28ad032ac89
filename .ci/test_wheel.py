"""Test a wheel in a temporary environment with NumPy and the packages in NEEDED.

Usage: python .ci/test_wheel.py [--oldest] [--tree FOLDER] WHEEL

--oldest installs the oldest versions that the metadata of the wheel allows. --tree is the folder with tests/python;
default:
this repository.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import venv
import zipfile
from pathlib import Path

NEEDED = ("numpy", "pytest", "hypothesis", "mpmath", "scipy")

# Tests that need no other program and no signals, and that are the same on every system.
TESTS = (
    "arguments",
    "bad_states",
    "batches",
    "builder",
    "calls",
    "changed_scenes",
    "contract",
    "float32",
    "forms",
    "hypothesis",
    "labels",
    "mpmath",
    "ode",
    "operational",
    "operators",
    "physics",
    "pickles",
    "products",
    "rollout_gradients",
    "scenes",
    "simulator",
    "single",
    "stochastic",
    "urdf",
    "urdf_faults",
    "urdf_numbers",
    "urdf_unknown",
)


def oldest(wheel: Path) -> list[str]:
    """The requirements of NEEDED at their lower bounds: ["numpy==1.23", ...]."""
    with zipfile.ZipFile(wheel) as archive:
        (file,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        metadata = archive.read(file).decode()
    bounds = dict(re.findall(r"^Requires-Dist: ([\w-]+) *>=([\d.]+)", metadata, flags=re.MULTILINE))
    return [f"{name}=={bounds[name]}" for name in NEEDED]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--oldest", action="store_true")
    parser.add_argument("--tree", type=Path, default=Path(__file__).parents[1])
    arguments = parser.parse_args()
    wheel, tree = arguments.wheel.resolve(), arguments.tree.resolve()
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        python = str(Path(folder) / ("Scripts/python.exe" if os.name == "nt" else "bin/python"))
        requirements = oldest(wheel) if arguments.oldest else NEEDED
        install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary", ":all:"]
        subprocess.run([*install, str(wheel), *requirements], check=True)
        print(wheel.name, "on Python", sys.version.split()[0], *requirements, flush=True)
        # In the folder of the tests, so that the installed wheel is imported and not the source.
        pytest = [python, "-m", "pytest", "-q", "--rootdir", ".", "-c", "../../pyproject.toml", "-p", "no:cacheprovider"]
        tests = [f"test_{name}.py" for name in TESTS]
        # Nothing is written to the tree, which may be read-only.
        environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1", "HYPOTHESIS_STORAGE_DIRECTORY": str(Path(folder) / "hypothesis")}
        return subprocess.run([*pytest, *tests], cwd=tree / "tests/python", env=environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
