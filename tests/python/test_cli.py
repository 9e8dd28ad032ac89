"""The command line: exit codes, one-line errors, help; no times."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import phipsi
import pytest
from click.testing import CliRunner, Result
from phipsi.report import auto_cost, codegen, commands, compare, completion, identify, ik, info, kinds, simulate, view_robot  # noqa: F401  # the others register their commands
from phipsi.report.sections import residuals

#: Two links in series, the second without mass: its joint moves no mass.
MASSLESS_TIP = """
<robot name="r"><link name="base"/><link name="a"><inertial><mass value="1"/><origin xyz="0 0 0.1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="tip"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="j2" type="revolute"><parent link="a"/><child link="tip"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>
"""


def run(*arguments: str) -> Result:
    return CliRunner().invoke(commands.group, list(arguments))


def test_version_names_the_version() -> None:
    result = run("--version")
    assert result.exit_code == 0
    assert phipsi.__version__ in result.output


@pytest.mark.parametrize("command", [[], ["info"], ["view"], ["simulate"], ["identify"], ["ik"], ["report"], ["check"], ["bench"], ["completion"]])
def test_help(command: list[str]) -> None:
    result = run(*command, "--help")
    assert result.exit_code == 0
    assert "Usage:" in result.output


def test_info_of_a_file(tmp_path: Path) -> None:
    robot = tmp_path / "robot.urdf"
    robot.write_text(MASSLESS_TIP.replace('"j1"', '"[red]j1"').replace('lower="-1"', "", 1), encoding="utf-8")
    result = run("info", str(robot), "--floating-base")
    assert result.exit_code == 0, result.output
    assert "8 degrees of freedom (9 coordinates), 3 links, 1 kg moving mass" in result.output
    assert [line.split()[:4] for line in result.output.splitlines() if "j1" in line and "revolute" in line] == [["[red]j1", "revolute", "a", "7"]]
    content = json.loads(run("info", str(robot), "--json").stdout)
    assert (content["nq"], content["nv"], content["mass"], content["file"]) == (2, 2, 1.0, str(robot))
    assert content["joints"][1] | {"name": "j2", "upper": 1.0, "q": [1, 2]} == content["joints"][1]


def test_info_of_a_mujoco_model(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    from mujoco_models import ARM

    (tmp_path / "arm.xml").write_text(ARM)
    result = run("info", str(tmp_path / "arm.xml"), "--json")
    assert result.exit_code == 0, result.output
    assert [joint["name"] for joint in json.loads(result.output)["joints"]] == ["yaw", "pitch", "slide", "roll", "turn"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion(shell: str) -> None:
    result = run("completion", shell)
    assert result.exit_code == 0
    assert "_PHIPSI_COMPLETE" in result.output and f"{shell}_complete" in result.output


def test_bash_completes(tmp_path: Path) -> None:
    """bash can read the script, and the command answers completion requests."""
    if (bash := shutil.which("bash")) is None:
        pytest.skip("no bash")
    script = tmp_path / "completion.bash"
    script.write_text(run("completion", "bash").output)
    assert subprocess.run([bash, "-n", str(script)], check=False, timeout=300).returncode == 0
    asked = {"_PHIPSI_COMPLETE": "bash_complete", "COMP_WORDS": "phipsi sim", "COMP_CWORD": "1"}
    call = [sys.executable, "-c", "from phipsi.cli import main; main()"]
    answer = subprocess.run(call, env=os.environ | asked, capture_output=True, text=True, check=False, timeout=300)
    assert answer.stdout.split() == ["plain,simulate"]


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Torques of the bundled arm with a payload in its hand."""
    scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    loaded = scene.with_payload(scene.body_names[-1], mass=1.5, com=(0.0, 0.0, 0.1), inertia=0.01 * np.eye(3))
    q, qd, qdd = np.random.default_rng(0).uniform(-1, 1, (3, 200, 6))
    tau = loaded.inverse_dynamics(q, qd, qdd) + scene.damping * qd + scene.friction * qd / np.sqrt(qd**2 + 1e-4)
    file = tmp_path_factory.mktemp("measured") / "data.npz"
    np.savez(file, q=q, qd=qd, qdd=qdd, tau=tau)
    (file.parent / "arm.urdf").write_text(phipsi.BUNDLED_ARM)
    return file


def test_identify(measured: Path, tmp_path: Path) -> None:
    robot = str(measured.parent / "arm.urdf")
    result = run("identify", robot, str(measured), "--noise", "0.001", "-o", str(tmp_path / "found.urdf"), "--covariance", str(tmp_path / "found.npz"))
    assert result.exit_code == 0, result.output
    assert "identification from 200 states" in result.output and str(tmp_path / "found.urdf") in result.output
    result = run("identify", robot, str(measured), "--noise", "0.001", "--fit", "damping", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.output)
    assert max(found["after"]) < 0.01 < max(found["before"])
    assert np.shape(found["low"]) == np.shape(found["parameters"]) == (6, 10) and len(found["base"]["names"]) == len(found["base"]["values"])
    assert list(found["joints"]["damping"]) == list(phipsi.Scene.from_urdf(robot).joint_names)
    # The identified robot reproduces the torques.
    with np.load(measured) as archive:
        arrays = dict(archive)
    written = phipsi.Scene.from_urdf(tmp_path / "found.urdf")
    own = written.damping * arrays["qd"] + written.friction * arrays["qd"] / np.sqrt(arrays["qd"] ** 2 + 1e-4)
    assert np.max(np.abs(written.inverse_dynamics(arrays["q"], arrays["qd"], arrays["qdd"]) + own - arrays["tau"])) < 0.01
    # Its simulation has error bands from the covariance of the estimates.
    state = tmp_path / "state.npz"
    np.savez(state, q=np.full(6, 0.2), qd=np.full(6, 1.0))
    options = ("-o", str(tmp_path / "out"), "--time", "0.05", "--limits", "report", "--state", str(state), "--covariance", str(tmp_path / "found.npz"))
    result = run("simulate", str(tmp_path / "found.urdf"), *options)
    assert result.exit_code == 0 and "largest standard deviations at the end" in result.output, result.output
    with np.load(tmp_path / "out" / "trajectory.npz") as archive:
        assert np.all(archive["qd_deviation"][-1] > 0.0) and np.all(archive["qd_deviation"][-1] < 0.1)


def test_identify_with_a_link_that_is_trusted(measured: Path) -> None:
    robot, log = str(measured.parent / "arm.urdf"), str(measured)
    result = run("identify", robot, log, "--noise", "0.1", "--trust", "link2=1e9", "--json")
    assert result.exit_code == 0, result.output
    own, found = phipsi.Scene.from_urdf(robot).inertial_parameters, np.array(json.loads(result.output)["parameters"])
    assert np.abs(found[1, 0] - own[1, 0]) < 1e-2 < np.abs(found[2, 0] - own[2, 0])
    for given, message in (
        (("link2",), "--trust: found link2; expected one number, or LINK=NUMBER"), (("1", "link2=3"), "--trust: found 1, link2=3; expected one number"),
        (("hand=3",), "trust: found 'hand', no link of body_names"),
    ):  # fmt: skip
        refused = run("identify", robot, log, *(word for one in given for word in ("--trust", one)))
        assert refused.exit_code == 2 and message in " ".join(refused.output.split()), refused.output


def test_identify_from_rates_alone(measured: Path, tmp_path: Path) -> None:
    scene, t = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM), np.linspace(0, 2, 1001)
    turns = np.outer(t, [5.0, 6.0, 7.0, 8.0, 9.0, 10.0])
    q, qd, qdd = np.sin(turns), turns[1] / t[1] * np.cos(turns), -((turns[1] / t[1]) ** 2) * np.sin(turns)
    arrays = {"q": q, "qd": qd, "tau": scene.inverse_dynamics(q, qd, qdd) + scene.damping * qd + scene.friction * qd / np.sqrt(qd**2 + 1e-4)}
    file, robot = tmp_path / "rates.npz", str(measured.parent / "arm.urdf")
    np.savez(file, **arrays)
    refused = run("identify", robot, str(file))
    assert refused.exit_code == 2 and "found neither qdd nor time" in refused.output
    np.savez(file, t=t, **arrays)
    smoothed = run("identify", robot, str(file))
    assert "velocities and accelerations are from the smoothed positions" in smoothed.output, smoothed.output
    page = run("identify", robot, str(file), "--held-out", "0.3", "--report", str(tmp_path / "page"))
    assert page.exit_code == 0, page.output
    text = (tmp_path / "page/index.html").read_text(encoding="utf-8")
    for title in ("How well torques are explained", "Measured and predicted torques", "Parameters with intervals", "Base parameters", "Spectrum of the residuals", "Unidentifiable parameters"):
        assert title in text
    assert "Not here:" not in text and "explained, held out" in text
    numbers = json.loads((tmp_path / "page/identification.json").read_text(encoding="utf-8"))
    assert min(numbers["explained_held_out"]) > 0.99 and numbers["states"] == 701


def test_identify_from_several_logs(measured: Path, tmp_path: Path) -> None:
    robot = str(measured.parent / "arm.urdf")
    both = run("identify", robot, str(measured), str(measured), "--noise", "0.001", "--fit", "damping", "--json")
    assert both.exit_code == 0, both.output
    assert json.loads(both.output)["states"] == 400
    for option, value, message in (("--held-out", "0.2", "--held-out: found several logs"), ("--fit", "load", "--fit: found load with several logs")):
        refused = run("identify", robot, str(measured), str(measured), option, value)
        assert refused.exit_code == 2 and message in refused.output


def test_identify_with_a_transmission(measured: Path, tmp_path: Path) -> None:
    robot = str(measured.parent / "arm.urdf")
    np.savetxt(tmp_path / "B.txt", np.eye(6))
    result = run("identify", robot, str(measured), "--noise", "0.001", "--fit", "damping", "--transmission", str(tmp_path / "B.txt"), "--json")
    assert result.exit_code == 0, result.output
    refused = run("identify", robot, str(measured), "--transmission", str(tmp_path / "none.npy"))
    assert refused.exit_code == 2 and "--transmission: found" in refused.output


@pytest.fixture(scope="module")
def mobile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mobile manipulator, and a log of its arm alone, as a table of positions and torques."""
    builder = phipsi.SceneBuilder().link("floor")
    joints = {"drive": "prismatic", "steer": "continuous", "shoulder": "revolute", "elbow": "revolute"}
    parent = "floor"
    for at, (name, kind) in enumerate(joints.items()):
        builder.link(f"{name}_link", 3.0 - 0.5 * at, (0.05, 0.02, 0.1), np.diag([0.03, 0.02, 0.01]))
        rest = {"lower": -2.0, "upper": 2.0} if kind != "continuous" else {}
        builder.joint(name, kind, parent, f"{name}_link", xyz=(0.1, 0, 0.2), axis=(0, 0, 1) if at < 2 else (0, 1, 0.1), damping=0.3, friction=0.4, **rest)
        parent = f"{name}_link"
    folder = tmp_path_factory.mktemp("mobile")
    scene = builder.build()
    scene.to_urdf(folder / "robot.urdf", name="mobile")
    arm = scene.lock(["drive", "steer"], scene.neutral())
    t = np.arange(3000) * 0.005
    turns = np.outer(t, [2.0, 3.1])
    q, qd, qdd = np.sin(turns), turns[1] / t[1] * np.cos(turns), -((turns[1] / t[1]) ** 2) * np.sin(turns)
    tau = arm.inverse_dynamics(q, qd, qdd) + arm.damping * qd + arm.friction * qd / np.sqrt(qd**2 + 0.03**2)
    draw = np.random.default_rng(0)
    q, tau = q + 1e-4 * draw.standard_normal(q.shape), np.roll(tau, 4, axis=0) + 0.02 * draw.standard_normal(tau.shape)
    lines = ["time,shoulder.q,elbow.q,shoulder.tau,elbow.tau", *(",".join(map(repr, map(float, row))) for row in np.column_stack([t, q, tau])[4:])]
    (folder / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def test_identify_an_arm_of_a_mobile_manipulator(mobile: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From a table, without polars."""
    monkeypatch.setitem(sys.modules, "polars", None)
    robot, log = str(mobile / "robot.urdf"), str(mobile / "log.csv")
    refused = run("identify", robot, log)
    assert refused.exit_code == 2 and "found no column q of joint 'drive'" in refused.output and "--lock" in refused.output
    given = ("--fit", "damping", "--fit", "friction", "--tau-delay", "0.02", "--friction-speed", "0.03", "--held-out", "0.4")
    found = {}
    for name, option in {"lock": ("--lock", "drive=0.5", "--lock", "steer"), "joint": ("--joint", "shoulder", "--joint", "elbow")}.items():
        result = run("identify", robot, log, *option, *given, "--json")
        assert result.exit_code == 0, result.output
        found[name] = json.loads(result.stdout)
    # The drive lifts nothing: its place does not matter.
    np.testing.assert_allclose(found["lock"]["after"], found["joint"]["after"], rtol=1e-6)
    numbers = found["joint"]
    assert list(numbers["joints"]["friction"]) == ["shoulder", "elbow"]
    np.testing.assert_allclose(list(numbers["joints"]["friction"].values()), 0.4, rtol=0.1)
    assert min(numbers["explained_held_out"]) > 0.99 and min(numbers["explained"]) > 0.99
    assert abs(numbers["clock_offset"]) < 5 * numbers["clock_deviation"] < 0.005
    assert len(numbers["cutoff"]) == 2 and np.isfinite(numbers["base"]["bias"]).all()


def test_identify_prints_the_bandwidth_and_the_explained_variance(mobile: Path) -> None:
    robot, log = str(mobile / "robot.urdf"), str(mobile / "log.csv")
    given = ("--joint", "shoulder", "--joint", "elbow", "--fit", "damping", "--fit", "friction", "--friction-speed", "0.03")
    late = run("identify", robot, log, *given)
    assert late.exit_code == 0 and re.search(r"tau: found torques that lag q by (19|20)[.\d]* \+- ", late.output), late.output
    result = run("identify", robot, log, *given, "--tau-delay", "0.02", "--held-out", "0.3")
    assert re.search(r"with a bandwidth in Hz of shoulder [\d.]+, elbow [\d.]+; torques at [\d.]+ Hz", result.output), result.output
    assert "LogWarning" not in result.output and "tau: found" not in result.output and "held out" in result.output and "predicted bias by noise in the accelerations" in result.output
    several = run("identify", robot, log, log, *given, "--tau-delay", "0.02", "--json")
    assert several.exit_code == 0 and json.loads(several.stdout)["states"] == 2 * 2996, several.output
    slow = run("identify", robot, log, *given, "--tau-delay", "0.02", "--cutoff", "4")
    assert "in Hz of shoulder 4, elbow 4; torques at 4 Hz" in slow.output


def test_identify_with_wrong_joints(mobile: Path) -> None:
    robot, log = str(mobile / "robot.urdf"), str(mobile / "log.csv")
    for options, message in (
        (("--lock", "wheel"), "--lock: found 'wheel'; expected one of drive, steer, shoulder, elbow"),
        (("--joint", "wheel"), "--joint: found 'wheel'"),
        (("--lock", "drive=far"), "--lock: found 'far' for 'drive'; expected a number"),
        (("--joint", "drive", "--lock", "drive"), "--lock: found 'drive', which --joint names too"),
    ):
        refused = run("identify", robot, log, *options)
        assert refused.exit_code == 2 and message in refused.output, refused.output


def test_identify_without_torques(measured: Path, tmp_path: Path) -> None:
    file = tmp_path / "short.npz"
    np.savez(file, q=np.zeros((3, 6)), qd=np.zeros((3, 6)))
    refused = run("identify", str(measured.parent / "arm.urdf"), str(file))
    assert refused.exit_code == 2 and "found no tau" in refused.output


def test_ik(measured: Path) -> None:
    robot = str(measured.parent / "arm.urdf")
    result = run("ik", robot, "link6", "--position", "0.5", "0.1", "0.3", "--rpy", "0.1", "0.2", "0.3", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.output)
    scene = phipsi.Scene.from_urdf(robot)
    place = scene.placement(np.array(list(found["joints"].values())), "link6")
    roll, pitch, yaw = np.arctan2(place[2, 1], place[2, 2]), -np.arcsin(place[2, 0]), np.arctan2(place[1, 0], place[0, 0])
    assert np.allclose(place[:3, 3], [0.5, 0.1, 0.3], atol=1e-8) and np.allclose([roll, pitch, yaw], [0.1, 0.2, 0.3], atol=1e-8)
    assert "reached: error" in run("ik", robot, "link6", "--position", "0.5", "0.1", "0.3").output


def test_ik_out_of_reach_exits_with_1(measured: Path) -> None:
    result = run("ik", str(measured.parent / "arm.urdf"), "link6", "--position", "9", "0", "0")
    assert result.exit_code == 1 and "not reached: error" in result.output


def test_ik_without_a_goal_exits_with_2(measured: Path) -> None:
    result = run("ik", str(measured.parent / "arm.urdf"), "link6")
    assert result.exit_code == 2 and "--position, --rpy: found neither" in result.output


def test_the_package_is_the_command() -> None:
    done = subprocess.run([sys.executable, "-m", "phipsi", "info", "--json"], capture_output=True, text=True, check=True, timeout=300)
    assert json.loads(done.stdout)["joints"][0]["name"] == "joint1"


def test_check_of_the_bundled_arm_holds() -> None:
    result = run("check", "--states", "3")
    assert result.exit_code == 0, result.output
    assert "FAIL" not in result.output
    assert "at 3 random states" in result.output


def test_check_beyond_the_bound_exits_with_1(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(residuals, "SLACK", 1e-9)
    result = run("check", "--states", "2")
    assert result.exit_code == 1
    assert "FAIL" in result.output


def test_check_of_a_floating_base() -> None:
    assert run("check", "--states", "2", "--floating-base").exit_code == 0


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Output for two robots."""
    folder = tmp_path_factory.mktemp("bench")
    for name in ("first", "second"):
        (folder / f"{name}.urdf").write_text(phipsi.BUNDLED_ARM, encoding="utf-8")
    result = run("bench", "--quick", str(folder / "first.urdf"), str(folder / "second.urdf"))
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize("command", [("check", "--states", "2"), ("bench", "--quick"), ("report", "--quick", "--states", "4")])
def test_figures_for_programs(command: tuple[str, ...], tmp_path: Path) -> None:
    """The standard output contains only JSON, with the values of the tables."""
    options = ["-o", str(tmp_path)] if command[0] == "report" else []
    result = run(*command, *options, "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    if command[0] == "bench":
        assert found["calls"][0]["call"].startswith("scene.forward_dynamics") and found["growth"]["rows"]
        return
    assert found["passed"] is True
    rows = found["residuals"]
    assert rows and all(row["passed"] and row["worst"] <= row["bound"] for row in rows)


def test_bench_names_every_method(bench: str) -> None:
    for method in phipsi._core.METHODS:
        assert method in bench


def test_bench_times_public_calls_auto_first(bench: str) -> None:
    assert "call from Python" in bench and "Scene::evaluate in Rust" in bench
    lines = [line for line in bench.splitlines() if line.startswith("scene.forward_dynamics")]
    assert [line.split()[3] for line in lines] == ["auto", "covariance", "square-root"]
    for call in ("inverse_dynamics", "bias_torque", "mass_matrix", "mass_matrix_inverse"):
        assert f"scene.{call}(" in bench


def test_bench_has_the_states_that_robots_are_in(bench: str) -> None:
    assert bench.count("form auto relative to covariance") == 2
    heads = [line.split() for line in bench.splitlines() if line.startswith("state ")]
    assert heads == [["state", "first", "second"]] * 2
    for base in ("fixed base", "free base"):
        for kind in kinds.KINDS:
            rows = [line for line in bench.splitlines() if line.startswith(f"{base}, {kind} ")]
            found = [row.removeprefix(f"{base}, {kind} ").split() for row in rows]
            assert any(len(cells) == 2 and all(float(cell) > 0.0 for cell in cells) for cells in found), kind


@pytest.mark.parametrize("command", [("check",), ("bench",), ("report", "-o", "out")])
def test_bad_files_are_one_line_and_exit_with_2(command: tuple[str, ...], tmp_path: Path) -> None:
    malformed, noise = tmp_path / "malformed.urdf", tmp_path / "noise.urdf"
    malformed.write_text("<robot name='r'><link name='a'>")
    noise.write_bytes(bytes(range(256)) * 40)
    for path in (tmp_path / "missing.urdf", malformed, noise, tmp_path):
        result = run(command[0], str(path), *command[1:])
        assert result.exit_code == 2, result.output
        assert result.output.startswith("Error: ")
        assert len(result.output.strip().splitlines()) == 1
        assert "Traceback" not in result.output


def test_singular_scenes_cannot_be_checked(tmp_path: Path) -> None:
    path = tmp_path / "massless.urdf"
    path.write_text(MASSLESS_TIP)
    result = run("check", str(path))
    assert result.exit_code == 2
    assert "j2" in result.output


def test_bad_options_exit_with_2() -> None:
    assert run("check", "--states", "0").exit_code == 2
    assert run("report").exit_code == 2


@pytest.mark.parametrize("command", [("report", "--quick", "-o", "{}"), ("compare", "{robot}", "{robot}", "--report", "{}"), ("codegen", "-o", "{}"), ("view", "-o", "{}.html")])
def test_output_that_cannot_be_made_exits_with_2(command: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (robot := tmp_path / "arm.urdf").write_text(phipsi.BUNDLED_ARM)
    result = run(*(part.format(tmp_path / "file" / "out", robot=robot) for part in command))
    assert result.exit_code == 2
    assert re.fullmatch(r"Error: found '.*out(\.html)?' \(Not a directory\); expected a path that can be read or written\n", result.output), result.output


def test_a_state_that_is_not_there_exits_with_2(tmp_path: Path) -> None:
    result = run("simulate", "-o", str(tmp_path / "out"), "--state", str(tmp_path / "none.json"))
    assert result.exit_code == 2 and "none.json' (No such file or directory); expected" in result.output
    assert not (tmp_path / "out").exists()


def test_a_function_of_an_unknown_link_lists_links_and_frames() -> None:
    result = run("codegen", "-f", "jacobian:flange:moon")
    assert result.exit_code == 2
    assert "found the link 'flange:moon'; expected flange, base, link1" in result.output and "a frame of local, world, local-world-aligned" in result.output


def test_help_lists_the_commands_for_developers_apart() -> None:
    of_users, of_developers = run("--help").output.split("Commands for developers of phipsi:")
    assert {"info", "simulate", "report"} <= set(of_users.split()) and not {"check", "bench"} & set(of_users.split("Commands:")[1].split())
    assert {"check", "bench"} <= set(of_developers.split())


def test_info_lists_links_and_units(tmp_path: Path) -> None:
    robot = tmp_path / "robot.urdf"
    robot.write_text(MASSLESS_TIP.replace("[red]", ""), encoding="utf-8")
    lines = run("info", str(robot)).output.splitlines()
    assert any("unit" in line and "effort, N m or N" in line for line in lines)
    assert ["a", "j1", "1", "0", "0", "0.1"] in [line.split() for line in lines]
    content = json.loads(run("info", str(robot), "--json").stdout)
    assert content["links"] == ["base", "a", "tip"] and content["joints"][0]["unit"] == "rad"
    assert content["link_properties"][1] == {"name": "a", "parent": "base", "joint": "j1", "mass": 1.0, "com": [0.0, 0.0, 0.1]}


@pytest.mark.parametrize("command", ["info", "ik", "codegen", "check"])
def test_commands_without_pages_need_no_extra(command: str, tmp_path: Path) -> None:
    """With click and rich alone; the commands for pages name what is missing and how to install it."""
    (tmp_path / "arm.urdf").write_text(phipsi.BUNDLED_ARM)
    arguments = {
        "info": ["info"],
        "ik": ["ik", "arm.urdf", "flange", "--position", "0.4", "0.2", "0.5"],
        "codegen": ["codegen", "-o", "out", "-f", "mass_matrix"],
        "check": ["check", "--states", "2"],
    }[command]
    script = (
        "import builtins, sys, importlib.util as u\n"
        "load, known = builtins.__import__, u.find_spec\n"
        "def only(name, *rest):\n"
        "    if name.split('.')[0] in ('plotly', 'jinja2', 'markupsafe', 'viser', 'scipy'):\n"
        "        raise ModuleNotFoundError(name)\n"
        "    return load(name, *rest)\n"
        "builtins.__import__ = only\n"
        "u.find_spec = lambda name, *rest: None if name in ('plotly', 'jinja2') else known(name, *rest)\n"
        "import phipsi.cli\n"
        "phipsi.cli.main()\n"
    )

    def called(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=False, cwd=tmp_path, timeout=300)

    done = called(*arguments)
    assert done.returncode == 0, done.stderr
    if command == "info":
        for page in (["report", "-o", "pages"], ["simulate", "-o", "pages"]):
            refused = called(*page)
            assert refused.returncode == 2 and "found no plotly, jinja2" in refused.stderr and "pip install" in refused.stderr
        assert not (tmp_path / "pages").exists()


@pytest.mark.parametrize("command", [["report", "-o", "out/page"], ["simulate", "-o", "out/page"], ["check"], ["info"], ["bench"]])
def test_ctrl_c_exits_with_130_and_one_sentence(command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    for module, name in ((commands.pipeline, "collect"), (simulate, "_gains"), (residuals, "residuals"), (info, "about"), (commands.calls, "measured")):
        monkeypatch.setattr(module, name, interrupted)
    result = run(*command, *(["--hold", "1", "1"] if command[0] == "simulate" else []))
    assert result.exit_code == 130
    assert result.stderr.splitlines()[-1] == "phipsi: interrupted."
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["click", "rich"])
def test_without_a_requirement_the_message_names_it(name: str) -> None:
    script = (
        "import sys, importlib.util as u\n"
        "known = u.find_spec\n"
        f"u.find_spec = lambda name, *rest: None if name == {name!r} else known(name, *rest)\n"
        "import phipsi.cli\n"
        "phipsi.cli.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 2
    assert f"found no {name}; install with: pip install {name}" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_library_needs_numpy_alone() -> None:
    script = (
        "import builtins, sys\n"
        "load = builtins.__import__\n"
        "def only(name, *rest):\n"
        "    if name.split('.')[0] in ('click', 'rich', 'plotly', 'jinja2', 'markupsafe', 'scipy'):\n"
        "        raise ModuleNotFoundError(name)\n"
        "    return load(name, *rest)\n"
        "builtins.__import__ = only\n"
        "import phipsi, phipsi.cli\n"
        "print(phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM).nv)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=300)
    assert done.stdout.split() == ["6"]


def test_the_command_is_installed() -> None:
    done = subprocess.run([sys.executable, "-m", "phipsi.cli", "--version"], capture_output=True, text=True, check=True, timeout=300)
    assert phipsi.__version__ in done.stdout


CONTACTS = '<mujoco><worldbody><geom size="1"/><body name="arm"><joint/><geom size="1"/></body></worldbody>{}</mujoco>'
TENDON = '<tendon><fixed name="rope" stiffness="2"><joint joint="hinge" coef="1"/></fixed></tendon>'


def test_messages_suggest_options_that_the_command_takes(tmp_path: Path) -> None:
    """All suggestions in messages of load."""
    pytest.importorskip("mujoco")
    robot = tmp_path / "robot.xml"
    robot.write_text(CONTACTS.format(""), encoding="utf-8")
    result = run("info", str(robot))
    assert result.exit_code == 0 and "use --ignore contacts to suppress this warning, or --strict to raise an error" in " ".join(result.output.split())
    assert "warning" not in run("info", str(robot), "--ignore", "contacts").output
    strict = run("info", str(robot), "--strict")
    assert strict.exit_code == 2 and "--ignore contacts" in strict.output
    robot.write_text(CONTACTS.format(TENDON).replace("<joint/>", '<joint name="hinge"/>').replace('<body name="arm">', '<body name="arm" gravcomp="1">'), encoding="utf-8")
    for command in (["info"], ["check"], ["simulate", "-o", str(tmp_path)], ["report", "-o", str(tmp_path)]):
        refused = run(*command, str(robot))
        assert refused.exit_code == 2 and "--ignore tendons --ignore gravcomp" in refused.output
    assert run("info", str(robot), "--ignore", "tendons", "--ignore", "gravcomp").exit_code == 0
    wrong = run("info", str(robot), "--ignore", "tendon")
    assert wrong.exit_code == 2 and "ignore: found 'tendon'; expected names of" in " ".join(wrong.output.split())


def test_arguments_of_a_xacro(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    robot = tmp_path / "robot.urdf.xacro"
    robot.write_text(MASSLESS_TIP.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ').replace('mass value="1"', 'mass value="$(arg mass)"').replace("</robot>", '<xacro:if value="false"/></robot>'))
    missing = run("info", str(robot))
    assert missing.exit_code == 2 and "--xacro-argument mass=VALUE" in missing.output
    assert run("info", str(robot), "--xacro-argument", "mass=2").exit_code == 0
    unknown = run("info", str(robot), "--xacro-argument", "mass=2", "--xacro-argument", "mas=2")
    assert unknown.exit_code == 2 and "expected 'mass'?" in unknown.output
    wrong = run("info", str(robot), "--xacro-argument", "mass")
    assert wrong.exit_code == 2 and "expected NAME=VALUE" in wrong.output


def test_bench_reads_every_format_of_a_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the options for reading it; the base of a MuJoCo model is that of its file."""
    pytest.importorskip("mujoco")
    file = tmp_path / "robot.xml"
    # The option is needed.
    file.write_text(
        '<mujoco><worldbody><body name="b"><joint name="j" axis="0 1 0"/><geom type="sphere" size="0.1" pos="0 0 -0.5" />'
        '<site name="s"/></body></worldbody><option density="1000"/></mujoco>',
        encoding="utf-8",
    )
    seen = []
    monkeypatch.setattr(commands, "DENSE_CAP", 0)
    monkeypatch.setattr(auto_cost, "measured", lambda scene, drawn, quick: seen.append(scene.joint_names) or [])
    monkeypatch.setattr(commands.growth, "growth", lambda *_: [])
    monkeypatch.setattr(commands.terminal, "growth", lambda *_: None)
    monkeypatch.setattr(commands.terminal, "auto_costs", lambda *_: None)
    result = run("bench", "--strict", "--ignore", "fluid", str(file))
    assert result.exit_code == 0, result.output
    assert seen == [("j",)]
