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
from phipsi import examples
from phipsi.examples import __main__ as command

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "python" / "phipsi" / "examples"
#: The package of robots, which has no module.
ROBOTS = "example-robot-data"
#: Short examples by name, with the optional packages that they need.
SHORT = {
    "ant": ("mujoco",), "computed_torque": (), "dropped_box": (), "follow": (), "four_bar": (), "go2": (ROBOTS,), "gripper": (), "humanoid": (), "inverse_kinematics": (), "lift": (), "lqr": (), "own_urdf": (),
    "panda": (ROBOTS,), "quadruped": (), "stand_up": (ROBOTS,), "talos": (ROBOTS,), "xacro_snake": ("xacro",),
}  # fmt: skip
RUN = "import runpy, sys; found = runpy.run_path(sys.argv[1]); print('rows', len(found['path'].q if 'path' in found else found['q']))"


@pytest.mark.parametrize("name", SHORT)
def test_short_examples_run(name: str, tmp_path: Path) -> None:
    if absent := [package for package in SHORT[name] if not (examples.folder() if package == ROBOTS else importlib.util.find_spec(package))]:
        pytest.skip(f"{name} needs {', '.join(absent)}")
    if name == "ant" and "contacts" not in inspect.signature(phipsi.load).parameters:
        pytest.skip("this version reads no contacts of MJCF")
    command = [sys.executable, "-W", "error", "-c", RUN, str(FOLDER / f"{name}.py")]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-4000:]
    assert int(re.findall(r"rows (\d+)", run.stdout)[0]) > 100 and not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", SHORT)
def test_short_examples_check_their_results(name: str) -> None:
    tree = ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))
    assert any(isinstance(node, ast.Assert) for node in tree.body)
    assert ast.get_docstring(tree) and len((FOLDER / f"{name}.py").read_text(encoding="utf-8").splitlines()) <= 75


def test_the_command_lists_runs_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    assert command.main([]) == 0
    listed = capsys.readouterr().out
    assert all(f"{name} " in listed for name in SHORT) and "--picture FILE" in listed and "__init__" not in listed
    assert command.main(["dropped_box", "--source"]) == 0
    assert capsys.readouterr().out == (FOLDER / "dropped_box.py").read_text(encoding="utf-8")
    assert command.main(["quadrupet"]) == command.WRONG
    assert "found no such example; did you mean quadruped?" in capsys.readouterr().err
    assert command.main(["lqr", "--pictures", "a.webp"]) == command.WRONG
    assert capsys.readouterr().err == "lqr: found '--pictures'; expected no argument, --picture FILE or --source\n"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(examples, "folder", lambda: None)
    assert command.main(["go2"]) == 1
    assert "pip install example-robot-data" in capsys.readouterr().err
    if importlib.util.find_spec("viser") and importlib.util.find_spec("trimesh"):
        assert command.main(["inverse_kinematics", "--picture", "arm.png"]) == 0
        assert capsys.readouterr().out == "written: arm.png\n" and (tmp_path / "arm.png").stat().st_size > 1000
        assert command.main(["inverse_kinematics", "--picture", "arm.gif"]) == 1
        assert "to: found 'arm.gif'; expected a path that ends in .html" in capsys.readouterr().err


def test_robots_are_found_by_name() -> None:
    if examples.folder() is None:
        pytest.skip("example-robot-data is not installed")
    assert examples.robot("go2_description/urdf/go2.urdf").is_file()
    with pytest.raises(FileNotFoundError, match="go9.urdf: found no such file below .*robots; expected a robot of example-robot-data"):
        examples.robot("go2_description/urdf/go9.urdf")


def test_the_list_of_examples_names_the_packages_that_each_needs() -> None:
    for name, path in command.scripts().items():
        source = path.read_text(encoding="utf-8")
        imported = {word.partition(".")[0] for word in re.findall(r"^(?:from|import) ([\w.]+)", source, flags=re.MULTILINE)} - set(sys.stdlib_module_names)
        needed = (imported - {"numpy", "phipsi", "__future__"}) | set(SHORT.get(name, ()))
        assert all(f"(needs {package})" in command.summary(path) for package in needed), (name, needed)
