"""The command `phipsi simulate`: its output, its errors, and the output of failed simulations."""

from __future__ import annotations

import csv
import inspect
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import phipsi
import pytest
from click.testing import CliRunner, Result
from phipsi.report import commands, ik, motion, simulate, view_robot  # noqa: F401  # the others register their commands
from tolerances import assert_near, assert_same_bits


SPRING = """<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="continuous">
<parent link="a"/><child link="b"/><dynamics stiffness="1e9"/></joint></robot>"""


def run(*arguments: object) -> Result:
    return CliRunner().invoke(commands.group, ["simulate", *map(str, arguments)])


def test_the_bundled_arm_from_a_state_file(tmp_path: Path) -> None:
    state = tmp_path / "state.json"
    state.write_text(json.dumps({"q": {"joint2": 0.4}, "qd": [0.1, 0, 0, 0, 0, 0], "tau": {"joint1": 2.0}}))
    result = run("-o", tmp_path / "out", "--state", state, "--time", 0.02, "--csv", "--record-every", 2)
    assert result.exit_code == 0, result.output
    scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    q, qd, tau = np.zeros(6), np.zeros(6), np.zeros(6)
    q[1], qd[0], tau[0] = 0.4, 0.1, 2.0
    path = scene.simulate(q, qd, dt=1e-3, steps=20, tau=tau, method="rk4", record_every=2)
    with np.load(tmp_path / "out" / "trajectory.npz") as found:
        assert_same_bits(found["q"], path.q)
        assert_same_bits(found["qd"], path.qd)
        assert_same_bits(found["t"], path.t)
        assert tuple(found["joint_names"]) == scene.joint_names
    with (tmp_path / "out" / "trajectory.csv").open(newline="") as stream:
        header, *rows = csv.reader(stream)
    assert header[:2] == ["t", "q:joint1"] and header[12] == "qd:joint6" and header[-1] == "tau:joint6"
    assert_same_bits(np.array(rows, dtype=float), np.column_stack([path.t, path.q, path.qd, path.torques()]))
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert 'id="plot-over-time"' in page and 'id="plot-stroboscope"' in page
    # The output is a state file for another simulation, by npz.
    np.savez(tmp_path / "end.npz", q=path.q[-1], qd=path.qd[-1])
    again = run("-o", tmp_path / "again", "--state", tmp_path / "end.npz", "--time", 0.002, "--hold", "10", "1")
    assert again.exit_code == 0, again.output


def test_error_bands(tmp_path: Path) -> None:
    file = tmp_path / "unsure.json"
    file.write_text(json.dumps({"joints": {"damping": 1e-4}, "initial": [1e-6] * 12}))
    result = run("-o", tmp_path / "out", "--time", 0.05, "--covariance", file, "--noise", 0.02, "--check", "monte-carlo", "--record-every", 10)
    assert result.exit_code == 0, result.output
    assert "largest standard deviations at the end" in result.output and "sampled variance" in result.output
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    unsure = phipsi.estimation.MotionUncertainty(joints={"damping": 1e-4}, initial=[1e-6] * 12, torque_noise=0.02)
    with pytest.warns(phipsi.errors.UncertaintyWarning, match="held by friction"):
        path = scene.simulate(scene.neutral(), np.zeros(6), dt=1e-3, steps=50, record_every=10, covariance=unsure)
    with np.load(tmp_path / "out" / "trajectory.npz") as found:
        assert_same_bits(found["covariance"], path.bands.covariance)
        assert_same_bits(found["qd_deviation"], path.bands.qd)
    assert "95 % band of joint1" in (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    held = run("-o", tmp_path / "out", "--time", 0.01, "--noise", 0.001)
    assert "warning: covariance: found joint" in held.output and "--check monte-carlo" in " ".join(held.output.split())
    numbers = json.loads(run("-o", tmp_path / "out", "--time", 0.05, "--noise", 0.02, "--check", "monte-carlo", "--json").stdout)
    assert len(numbers["deviation"]["ratio"]) == 12 and numbers["deviation"]["qd"][1] > 0.0


@pytest.mark.parametrize(
    ("contents", "options", "message"),
    [
        ({"mass": 1.0}, (), "found 'mass'; expected parameters, joints, initial, torque_noise"),
        ({"torque_noise": 1.0}, ("--noise", 1.0), "found 'torque_noise' and --noise"),
        ({"initial": [1.0]}, (), "initial: found shape (1,)"),
        (None, ("--check", "unscented"), "--check: found unscented without uncertainties"),
        (None, ("--noise", 1.0, "--time", 2.0), "--limits report"),
    ],
)
def test_error_bands_of_bad_files(contents: object, options: tuple[object, ...], message: str, tmp_path: Path) -> None:
    file = tmp_path / "unsure.json"
    file.write_text(json.dumps(contents))
    result = run("-o", tmp_path / "out", "--time", 0.01, *(("--covariance", file) if contents is not None else ()), *options)
    assert result.exit_code == 2 and message in " ".join(result.output.split()), result.output


def test_numbers_for_programs(tmp_path: Path) -> None:
    result = run("-o", tmp_path / "out", "--time", 0.02, "--json", "--floating-base")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM, floating_base=True)
    path = scene.simulate(scene.neutral(), np.zeros(12), dt=1e-3, steps=20)
    assert_same_bits(found["q"], path.q[-1])
    assert found["energy"]["total"] == path.energy().total[[0, -1]].tolist()
    assert (found["steps"], found["method"], found["error"], found["violations"]) == (20, "auto", None, [])
    assert found["integrator"] == path.integrator == "rk4"
    assert [Path(file).name for file in found["files"]] == ["trajectory.npz", "index.html"]


LINKAGE = """<mujoco><option timestep="0.001"/><worldbody>
<body name="crank"><joint name="crank" axis="0 1 0"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.2"/>
<body name="coupler" pos="0 0 0.2"><joint name="coupler" axis="0 1 0"/><geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/></body></body>
</worldbody><equality><connect name="pin" body1="coupler" anchor="0.3 0 0"/></equality></mujoco>"""


def test_forces_of_connections_are_in_the_page_and_beside_it(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (tmp_path / "linkage.xml").write_text(LINKAGE, encoding="utf-8")
    result = run(tmp_path / "linkage.xml", "-o", tmp_path / "out", "--time", 0.05)
    assert result.exit_code == 0, result.output
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "Green: the forces of connections on their links" in page and "force of connections, N" in page
    scene = phipsi.load(tmp_path / "linkage.xml")
    with np.load(tmp_path / "out" / "trajectory.npz") as found:
        q, qd, force = found["q"], found["qd"], found["force"]
        assert force.shape == found["force_at"].shape == (51, 1, 3) and tuple(found["force_names"]) == ("pin",)
    # Newton, for both bodies: the pin and the joint of the crank carry them; the moments of the pin and of the
    # weights about that joint accelerate them.
    qdd = scene.forward_dynamics(q, qd, np.zeros_like(qd))
    free = scene.without_constraints()
    turning = free.inverse_dynamics(q, qd, qdd)[:, 0]
    moment = np.cross([0.3, 0.0, 0.2], force[:, 0])[:, 1]
    assert_near(turning[0], moment[0], 1e-9)


def test_a_floating_base_moves_and_breaks_no_limit(tmp_path: Path) -> None:
    result = run("-o", tmp_path, "--floating-base", "--time", 0.01, "--method", "rosenbrock-2")
    assert result.exit_code == 0, result.output
    with np.load(tmp_path / "trajectory.npz") as found:
        assert found["q"].shape == (11, 13)


def test_limits_broken_are_told(tmp_path: Path) -> None:
    state = tmp_path / "state.json"
    state.write_text('{"q": {"joint2": 3.0}}')
    result = run("-o", tmp_path, "--state", state, "--time", 0.002, "--limits", "report")
    assert result.exit_code == 0
    assert "limit exceeded: joint2, upper 0.785398 rad, first at t = 0 s" in result.output


def test_what_diverges_exits_with_1_and_keeps_its_rows(tmp_path: Path) -> None:
    robot, state = tmp_path / "spring.urdf", tmp_path / "state.json"
    robot.write_text(SPRING)
    state.write_text('{"q": [0.1]}')
    result = run(robot, "-o", tmp_path / "out", "--state", state, "--time", 1, "--method", "rk4")
    assert result.exit_code == 1
    assert "diverged" in result.output and '"j"' in result.output
    with np.load(tmp_path / "out" / "trajectory.npz") as found:
        assert np.all(np.isfinite(found["q"])) and 0 < len(found["q"]) < 1001
    assert run(robot, "-o", tmp_path / "out", "--state", state, "--time", 0.1).exit_code == 0


STATES = {
    "not JSON": ("{", "expected a state as JSON"),
    "a list": ("[1]", "expected an object"),
    "unknown key": ('{"x": [1]}', "expected q, qd, tau"),
    "unknown joint": ('{"q": {"elbow": 1}}', "elbow"),
    "length": ('{"q": [1, 2]}', r"found shape (2,); expected (6,)"),
    "words": ('{"q": {"joint1": "far"}}', "joint1"),
    "not finite": ('{"q": [NaN, 0, 0, 0, 0, 0]}', "NaN"),
}


@pytest.mark.parametrize("case", STATES)
def test_bad_state_files_are_one_line_and_exit_with_2(case: str, tmp_path: Path) -> None:
    text, words = STATES[case]
    state = tmp_path / "state.json"
    state.write_text(text)
    result = run("-o", tmp_path / "out", "--state", state, "--time", 0.01)
    assert result.exit_code == 2, result.output
    assert result.output.startswith("Error: ") and len(result.output.strip().splitlines()) == 1
    assert words in result.output


@pytest.mark.parametrize(
    "options",
    [("--dt", "0"), ("--dt", "nan"), ("--time", "-1"), ("--method", "euler"), ("--time", "1e300"), ("--state", "missing.json")],
)
def test_bad_options_exit_with_2(options: tuple[str, str], tmp_path: Path) -> None:
    result = run("-o", tmp_path, *options)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output


def test_the_command_is_installed() -> None:
    done = subprocess.run([sys.executable, "-m", "phipsi.cli", "--help"], capture_output=True, text=True, check=True, timeout=300)
    assert "simulate" in done.stdout


def test_one_method_is_the_default_everywhere() -> None:
    """In Python, step by step, for gradients and on the command line."""
    calls = (phipsi.Scene.simulate, phipsi.Scene.simulator, phipsi.Scene.simulate_vjp)
    option = next(one for one in simulate.simulate.params if one.name == "method")
    assert {inspect.signature(call).parameters["method"].default for call in calls} == {option.default} == {"auto"}


def test_fingers_that_follow(tmp_path: Path) -> None:
    file = tmp_path / "gripper.urdf"
    joint = '<joint name="{0}" type="prismatic"><parent link="palm"/><child link="{0}"/><axis xyz="0 {1} 0"/><limit lower="0" upper="1" effort="1" velocity="1"/>{2}</joint>'
    link = '<link name="{0}"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    fingers = [("left", 1, ""), ("right", -1, '<mimic joint="left"/>')]
    file.write_text(
        '<robot name="g"><link name="palm"/>' + "".join((link + joint).format(*finger) for finger in fingers) + "</robot>", encoding="utf-8"
    )
    result = run(file, "--mimic", "couple", "-o", tmp_path / "run", "--time", 0.05)
    assert result.exit_code == 0, result.output
    assert "mimics" not in result.output
    with np.load(tmp_path / "run" / "trajectory.npz") as found:
        assert found["q"].shape[1] == 1 and list(found["joint_names"]) == ["left"]


def test_connections_of_a_mujoco_model(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    file = tmp_path / "linkage.xml"
    bar = '<body name="{0}" pos="{1}"><joint name="{0}" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 {2}" size="0.01"/>{3}</body>'
    coupler = bar.format("coupler", "0 0 0.2", 0.3, "")
    file.write_text(
        "<mujoco><worldbody>" + bar.format("crank", "0 0 0", 0.2, coupler) + bar.format("rocker", "0 0 0.3", 0.2, "")
        + '</worldbody><equality><connect name="pin" body1="coupler" body2="rocker" anchor="0 0 0.3"/></equality></mujoco>',
        encoding="utf-8",
    )  # fmt: skip
    result = run(file, "-o", tmp_path / "run", "--time", 0.05, "--csv")
    assert result.exit_code == 0, result.output
    assert "largest constraint error of the connections:" in result.output
    with np.load(tmp_path / "run" / "trajectory.npz") as found:
        assert found["drift"].max() < 1e-9
    assert (tmp_path / "run" / "trajectory.csv").read_text(encoding="utf-8").splitlines()[0].endswith(",drift")


def test_the_trajectory_can_be_loaded_and_read_as_a_log(tmp_path: Path) -> None:
    result = run("-o", tmp_path, "--time", 0.05, "--hold", "50", "5", "--record-every", 5)
    assert result.exit_code == 0, result.output
    scene, file = phipsi.load(phipsi.BUNDLED_ARM), tmp_path / "trajectory.npz"
    path = phipsi.Trajectory.load(file, scene)
    expected = scene.simulate(scene.neutral(), np.zeros(6), dt=1e-3, steps=50, record_every=5, pd=phipsi.PD(50.0, 5.0, scene.neutral()))
    assert_same_bits(path.q, expected.q)
    assert_same_bits(path.torques(), expected.torques())
    assert_same_bits(path.vjp(path.qd).q, expected.vjp(expected.qd).q)
    log = phipsi.estimation.read_log(file, scene)
    assert_same_bits(log["tau"], expected.torques())


def test_the_trajectory_with_bands_can_be_loaded_without_them(tmp_path: Path) -> None:
    assert run("-o", tmp_path, "--time", 0.02, "--noise", 0.02).exit_code == 0
    path = phipsi.Trajectory.load(tmp_path / "trajectory.npz", phipsi.load(phipsi.BUNDLED_ARM))
    assert path.bands is None and len(path) == 21


def test_contacts_that_never_touch_take_no_room(tmp_path: Path) -> None:
    """A tower of 20 spheres, of which the lowest touch the ground."""
    pytest.importorskip("mujoco")
    file = tmp_path / "box.xml"
    spheres = "".join(f'<geom type="sphere" size="0.01" pos="{x} {y} {z}"/>' for x in (0, 0.1) for y in (0, 0.1) for z in range(5))
    file.write_text(f'<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 0.0101"><freejoint/>{spheres}</body></worldbody></mujoco>', encoding="utf-8")
    result = run(file, "--contacts", "plane", "-o", tmp_path, "--time", 0.02)
    assert result.exit_code == 0, result.output
    assert "4 pairs of shapes touched; largest force" in result.output
    scene = phipsi.load(file, contacts="plane")
    path = phipsi.Trajectory.load(tmp_path / "trajectory.npz", scene)
    expected = scene.simulate(scene.initial(), np.zeros(6), dt=1e-3, steps=20)
    assert len(scene.collider_names) == 21 and path.contacts is not None and expected.contacts is not None
    found, wanted = path.contacts.shapes, expected.contacts.shapes
    assert found.names == wanted.names == scene.collider_names and 0 < len(found.pairs()) == len(wanted.pairs()) <= 4
    for part in ("state", "row", "pair", "point", "normal", "gap", "force", "impulse"):
        assert_same_bits(getattr(found, part), getattr(wanted, part))
    with np.load(tmp_path / "trajectory.npz") as archive:
        assert archive["force_at"].shape == archive["force"].shape == (21, 4, 3) and list(archive["force_names"]) == [""] * 4
    assert (tmp_path / "trajectory.npz").stat().st_size < 40_000
    view = CliRunner().invoke(commands.group, ["view", str(file), "--contacts", "plane", "--motion", str(tmp_path / "trajectory.npz"), "-o", str(tmp_path / "page.html")])
    assert view.exit_code == 0, view.output


def test_named_contacts_that_never_touch_take_no_room(tmp_path: Path) -> None:
    """Beside shapes that touch."""
    builder = phipsi.SceneBuilder().link("body", 1.0, inertia=np.eye(3))
    for at in range(20):
        builder.contact(f"ball {at}", "body", xyz=(0.1 * (at % 3), 0.1 * (at % 2), 0.5 * (at // 6)), radius=0.01, friction=0.5)
    builder.collider("foot", phipsi.shapes.Sphere(0.01), link="body").collider("ground", phipsi.shapes.HalfSpace())
    scene = builder.build(floating_base=True)
    path = scene.simulate([0, 0, 0.0101, 0, 0, 0, 1], np.zeros(6), dt=1e-3, steps=20)
    assert motion.write(path, tmp_path, table=False) == [tmp_path / "trajectory.npz"]
    found = phipsi.Trajectory.load(tmp_path / "trajectory.npz", scene)
    assert path.contacts is not None and found.contacts is not None
    touching = [name for name in scene.contacts.names if path.contacts.state[name].any()]
    assert 0 < len(touching) <= 6 and found.contacts.shapes.pairs() == [("foot", "ground")]
    for name in scene.contacts.names:
        for part in ("gap", "force", "impulse", "state"):
            assert_same_bits(getattr(found.contacts, part)[name], getattr(path.contacts, part)[name])
        assert np.isnan(found.contacts.slip[name]).all() == (name not in touching)
    with np.load(tmp_path / "trajectory.npz") as archive:
        # The weight is above the first ball and the foot.
        pressed = [name for name in touching if np.any(path.contacts.force[name])]
        assert sorted(archive["force_names"]) == ["", *sorted(pressed)] and archive["force_at"].shape == (21, len(pressed) + 1, 3)


BILLIARDS = """<mujoco><option gravity="0 0 -9.81"/><worldbody><geom name="floor" type="plane" size="1 1 1"/>
<geom name="wall" type="box" size="0.1 1 1" pos="1 0 0"/><geom name="far" type="box" size="0.1 1 1" pos="-9 0 0"/>
<body name="a" pos="0 0 0.1"><freejoint/><geom name="ball" size="0.1" mass="1"/></body>
<body name="b" pos="0.5 0 0.1"><freejoint/><geom name="block" type="box" size="0.1 0.1 0.1" mass="2"/></body></worldbody></mujoco>"""


def test_the_page_names_the_shapes_that_touched(tmp_path: Path) -> None:
    """With the largest force and the times of the first and the last contact."""
    pytest.importorskip("mujoco")
    (file := tmp_path / "billiards.xml").write_text(BILLIARDS, encoding="utf-8")
    (state := tmp_path / "state.json").write_text(json.dumps({"qd": [3.0, *[0.0] * 11]}))
    result = run(file, "--contacts", "all", "--state", state, "-o", tmp_path / "out", "--time", 0.2, "--dt", 0.002, "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)["touching"]
    assert told == json.loads((tmp_path / "out" / "run.json").read_text(encoding="utf-8"))["contacts"]
    times = {frozenset((one["first"], one["second"])): (one["begin"], one["end"]) for one in told}
    assert {frozenset(("floor", "ball")), frozenset(("floor", "block")), frozenset(("ball", "block"))} == set(times)
    # The ball slides 0.3 m: 0.3 = 3 t - g t^2 / 2. Steps of order 1.
    hit = (3.0 - np.sqrt(3.0**2 - 2.0 * 9.81 * 0.3)) / 9.81
    assert abs(times[frozenset(("ball", "block"))][0] - hit) < 3e-3
    forces = [one["largest_force"] for one in told]
    assert forces == sorted(forces, reverse=True) and all(np.isfinite(forces))
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    section = page[page.index('<section id="contacts">') :].partition("</section>")[0]
    assert "3 pairs of shapes touch" in section and "first contact" in section
    for one in told:
        assert all(f">{text}</td>" in section for text in (one["first"], one["second"], f"{one['largest_force']:.4g} N", f"{one['end']:.4g} s"))
    assert "far" not in section and "wall" not in section
    # A scene without colliders has no such section.
    assert run("-o", tmp_path / "arm", "--time", 0.01).exit_code == 0
    assert 'id="contacts"' not in (tmp_path / "arm" / "index.html").read_text(encoding="utf-8")


def test_files_name_their_joints(tmp_path: Path) -> None:
    """States and motions are read in the order of joint_names."""
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    order = [3, 0, 5, 1, 2, 4]
    q, names = np.linspace(0.1, 0.6, 6), [scene.joint_names[at] for at in order]
    state = tmp_path / "state.npz"
    np.savez(state, q=q[order], joint_names=names)
    result = run("-o", tmp_path, "--time", 0.0, "--state", state)
    assert result.exit_code == 0, result.output
    with np.load(tmp_path / "trajectory.npz") as found:
        assert_same_bits(found["q"][0], q)
    np.savez(state, q=q[order], joint_names=["x", *names[1:]])
    wrong = run("-o", tmp_path, "--state", state)
    assert wrong.exit_code == 2 and "found no joint 'joint4' in the joint_names x, joint1" in " ".join(wrong.output.split())
    np.savez(tmp_path / "motion.npz", t=[0.0, 0.1], q=np.stack([q[order]] * 2), joint_names=["x", *names[1:]])
    view = CliRunner().invoke(commands.group, ["view", "--motion", str(tmp_path / "motion.npz"), "-o", str(tmp_path / "page.html")])
    assert view.exit_code == 2 and "--motion: found no joint 'joint4'" in view.output


STANDING = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/><body name="trunk" pos="0 0 0.5"><freejoint/><geom name="ball" size="0.1"/>
<body name="leg"><joint name="knee" axis="0 1 0" ref="0.4"/><geom size="0.05" pos="0 0 -0.2" contype="0" conaffinity="0"/></body></body></worldbody>
<keyframe><key name="low" qpos="0 0 0.3 1 0 0 0 0.7" qvel="1 0 0 0 0 0 2"/></keyframe></mujoco>"""


@pytest.mark.parametrize("keyframe", [None, "low"])
def test_a_model_starts_at_its_own_start(tmp_path: Path, keyframe: str | None) -> None:
    """Not at q = 0, with the ball inside of the floor."""
    mujoco = pytest.importorskip("mujoco")
    (file := tmp_path / "standing.xml").write_text(STANDING, encoding="utf-8")
    chosen = () if keyframe is None else ("--keyframe", keyframe)
    result = run(file, "-o", tmp_path / "out", "--contacts", "plane", "--time", 0.01, *chosen)
    assert result.exit_code == 0 and "deep" not in result.output, result.output
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_string(STANDING))
    if keyframe is not None:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    scene = phipsi.load(file, contacts="plane")
    q, qd = phipsi.mujoco.to_state(scene, data.qpos, data.qvel)
    with np.load(tmp_path / "out" / "trajectory.npz") as found:
        assert_same_bits(found["q"][0], q)
        assert_same_bits(found["qd"][0], qd)
    # A state file wins; missing joints and keys are those of the keyframe.
    (state := tmp_path / "state.json").write_text('{"q": {"knee": 0.1}}')
    again = run(file, "-o", tmp_path / "again", "--time", 0.01, "--ignore", "contacts", "--state", state, *chosen)
    assert again.exit_code == 0, again.output
    q[-1] = 0.1
    with np.load(tmp_path / "again" / "trajectory.npz") as found:
        assert_same_bits(found["q"][0], q)
        assert_same_bits(found["qd"][0], qd)


def test_an_unknown_keyframe_and_a_start_inside_of_the_floor(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (file := tmp_path / "standing.xml").write_text(STANDING.replace("0 0 0.3 1", "0 0 0.04 1"), encoding="utf-8")
    wrong = run(file, "-o", tmp_path / "out", "--contacts", "plane", "--keyframe", "high")
    assert wrong.exit_code == 2 and 'keyframe: found "high"; expected one of "low"' in wrong.output
    inside = run(file, "-o", tmp_path / "out", "--contacts", "plane", "--keyframe", "low", "--time", 0.01)
    assert inside.exit_code == 0 and 'colliders "floor" and "ball" 0.060000 m deep' in " ".join(inside.output.split())


def test_inverse_kinematics_and_views_begin_at_a_keyframe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco")
    pytest.importorskip("viser")
    (file := tmp_path / "standing.xml").write_text(STANDING, encoding="utf-8")
    scene = phipsi.load(file, ignore=["contacts"])
    for keyframe, chosen in ((None, []), ("low", ["--keyframe", "low"])):
        q, read = scene.initial(keyframe), [str(file), "--ignore", "contacts", *chosen]
        target = map(str, scene.placement(q, "leg")[:3, 3])
        result = CliRunner().invoke(commands.group, ["ik", *read[:1], "leg", *read[1:], "--position", *target, "--starts", "1", "--json"])
        assert result.exit_code == 0, result.output
        assert_near(np.array(json.loads(result.stdout)["q"]), q, 1e-15)
        shown: list[np.ndarray] = []
        monkeypatch.setattr(phipsi.view.player.picture, "write", lambda _, motion, *__, shown=shown: shown.append(motion.q))
        result = CliRunner().invoke(commands.group, ["view", *read, "-o", str(tmp_path / "page.png")])
        assert result.exit_code == 0, result.output
        assert_same_bits(shown[0], q[None])
    both = CliRunner().invoke(commands.group, ["view", str(file), "--ignore", "contacts", "--keyframe", "low", "--motion", "missing.npz"])
    assert both.exit_code == 2 and "--keyframe: found a keyframe and --motion" in both.output
