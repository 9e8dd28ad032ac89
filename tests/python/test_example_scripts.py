"""The short examples: each runs in a process of its own, checks its result, and moves."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import re
import subprocess
import sys
from pathlib import Path

import phipsi
import pytest

ROOT = Path(__file__).parents[2]
#: Short examples by name, with the optional packages that they need.
SHORT = {
    "ant": ("mujoco",), "computed_torque": (), "dropped_box": (), "four_bar": (), "gripper": (), "humanoid": (), "inverse_kinematics": (), "lift": (), "lqr": (), "own_urdf": (),
    "quadruped": (), "xacro_snake": ("xacro",),
}  # fmt: skip
RUN = "import runpy, sys; found = runpy.run_path(sys.argv[1]); print('rows', len(found['path'].q if 'path' in found else found['q']))"


@pytest.mark.parametrize("name", SHORT)
def test_short_examples_run(name: str, tmp_path: Path) -> None:
    if absent := [package for package in SHORT[name] if importlib.util.find_spec(package) is None]:
        pytest.skip(f"{name} needs {', '.join(absent)}")
    if name == "ant" and "contacts" not in inspect.signature(phipsi.load).parameters:
        pytest.skip("this version reads no contacts of MJCF")
    command = [sys.executable, "-W", "error", "-c", RUN, str(ROOT / "examples" / f"{name}.py")]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-4000:]
    assert int(re.findall(r"rows (\d+)", run.stdout)[0]) > 100 and not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", SHORT)
def test_short_examples_check_their_results(name: str) -> None:
    tree = ast.parse((ROOT / "examples" / f"{name}.py").read_text(encoding="utf-8"))
    assert any(isinstance(node, ast.Assert) for node in tree.body)
    assert ast.get_docstring(tree) and len((ROOT / "examples" / f"{name}.py").read_text(encoding="utf-8").splitlines()) <= 75
