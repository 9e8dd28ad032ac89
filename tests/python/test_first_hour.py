"""Names that a new user meets first: star imports, renamed arguments and fields, poses, random configurations, torques of
control functions, gains of floating robots.
"""

from __future__ import annotations

import builtins
import pickle
import re
import subprocess
import sys
import warnings
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import phipsi
import pytest
from phipsi import _glossary
from phipsi.errors import ArgumentError, MimicWarning, NotFiniteError, ShapeError, SimulationError, UnitsWarning
from tolerances import EPS, assert_near, central_difference, product, size

GRIPPER = """<robot name="gripper"><link name="palm"/>{}{}</robot>""".format(
    *(
        f'<link name="{name}"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="{name}_joint" type="prismatic"><parent link="palm"/><child link="{name}"/><axis xyz="0 1 0"/>'
        f'<limit lower="0" upper="0.04" velocity="1" effort="20"/>{mimic}</joint>'
        for name, mimic in (("left", ""), ("right", '<mimic joint="left_joint"/>'))
    )
)


@pytest.fixture(scope="module")
def arm() -> phipsi.Scene:
    return phipsi.load(phipsi.BUNDLED_ARM)


@pytest.fixture(scope="module")
def floating() -> phipsi.Scene:
    return phipsi.load(phipsi.BUNDLED_ARM, floating_base=True)


def test_a_star_import_shadows_no_builtin() -> None:
    names: dict[str, object] = {}
    exec("from phipsi import *", names)
    assert "load" in names and not (set(names) - {"__builtins__"}) & set(vars(builtins)) - {"__doc__", "__name__"}


def test_mimic_is_true_or_false() -> None:
    with pytest.warns(MimicWarning, match='use mimic="couple" to couple it'):
        assert phipsi.load(GRIPPER).nv == 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert phipsi.load(GRIPPER, mimic=True).nv == phipsi.load(GRIPPER, mimic="couple").nv == 1
        assert phipsi.load(GRIPPER, mimic=False).nv == phipsi.load(GRIPPER, mimic="free").nv == 2


def test_another_mimic() -> None:
    with pytest.raises(ArgumentError, match="mimic: found 'both'; expected True"):
        phipsi.load(GRIPPER, mimic="both")  # type: ignore[arg-type]


@pytest.mark.parametrize(("wanted", "closest"), [("flang", "flange"), ("Link3", "link3"), ("linkk6", "link6")])
def test_the_closest_name_comes_first(arm: phipsi.Scene, wanted: str, closest: str) -> None:
    with pytest.raises(ArgumentError, match=f'expected one of "{closest}", '):
        arm.placement(arm.neutral(), wanted)


@pytest.mark.parametrize("former", _glossary.RENAMED)
def test_former_names_of_scenes(arm: phipsi.Scene, former: str) -> None:
    present = _glossary.RENAMED[former]
    assert attrgetter(present)(arm) is not None
    with pytest.raises(AttributeError, match=f"no attribute '{former}'; it was renamed to '{present}'"):
        getattr(arm, former)


def test_a_former_name_of_trajectories(arm: phipsi.Scene) -> None:
    path = arm.simulate(arm.neutral(), np.zeros(arm.nv), dt=1e-3, steps=2)
    assert path.constraint_forces() == {}
    with pytest.raises(AttributeError, match="expected constraint_forces"):
        path.connection_forces  # noqa: B018


def test_an_unknown_attribute_is_named(arm: phipsi.Scene) -> None:
    with pytest.raises(AttributeError, match="Scene' object has no attribute 'forward_dynamic'$"):
        arm.forward_dynamic  # type: ignore[attr-defined] # noqa: B018


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: phipsi.Scene("robot.urdf"), TypeError, r"cannot create 'Scene' instances; use phipsi.load\(file\)"),
        (lambda: phipsi.simulate(1), AttributeError, r"no attribute 'simulate'; it is a method of a scene: phipsi.load\(file\).simulate"),
        (lambda: phipsi.rnea, AttributeError, "module 'phipsi' has no attribute 'rnea'; use 'inverse_dynamics' of a scene"),
        (lambda: phipsi.pinoccio, AttributeError, "module 'phipsi' has no attribute 'pinoccio'$"),
        (lambda: phipsi.compare("one.urdf", "other.urdf"), ArgumentError, r"first: found str; expected a scene, for a file phipsi.load\(file\)"),
        (lambda: phipsi.scenes.chain(1).optimize([0.0], dt=0.1, steps=2, costs=[]), ArgumentError, "costs: found none; expected terms"),
    ],
)
def test_first_mistakes_lead_to_the_right_call(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call()


def test_a_module_that_is_not_imported_is_named() -> None:
    done = subprocess.run([sys.executable, "-c", "import phipsi; phipsi.pinocchio"], capture_output=True, text=True, check=False, timeout=120)
    assert "AttributeError: module 'phipsi' has no attribute 'pinocchio'; write import phipsi.pinocchio" in done.stderr


def test_former_names_of_fields(arm: phipsi.Scene) -> None:
    q, zero = np.full(6, 0.3), np.zeros(6)
    inverse, forward = arm.inverse_dynamics_derivatives(q, zero, zero), arm.forward_dynamics_derivatives(q, zero, zero)
    assert inverse.M is inverse.mass_matrix
    assert_near(inverse.mass_matrix @ forward.mass_matrix_inverse, np.eye(6), 1e4 * EPS)
    with pytest.raises(AttributeError, match="expected mass_matrix_inverse"):
        forward.Minv  # noqa: B018


def test_a_pose_from_roll_pitch_yaw() -> None:
    roll, pitch, yaw = 0.3, -0.4, 2.0
    x, y, z = (phipsi.pose(rpy=angles)[:3, :3] for angles in ((roll, 0, 0), (0, pitch, 0), (0, 0, yaw)))
    found = phipsi.pose((1, 2, 3), rpy=(roll, pitch, yaw))
    assert_near(found[:3, :3], z @ y @ x, 16 * EPS)
    assert_near(z @ [1, 0, 0], [np.cos(yaw), np.sin(yaw), 0], 4 * EPS)
    assert found[:, 3].tolist() == [1, 2, 3, 1] and found[3].tolist() == [0, 0, 0, 1]


def test_a_pose_from_a_quaternion_is_that_of_a_free_joint(floating: phipsi.Scene) -> None:
    q = floating.random_configuration(1)
    assert_near(phipsi.pose(q[:3], quat=q[3:7]), floating.placement(q, "base"), 16 * EPS)
    many = phipsi.pose(np.zeros((4, 1, 3)), quat=floating.random_configuration(1, size=5)[:, 3:7])
    assert many.shape == (4, 5, 4, 4)


@pytest.mark.parametrize(
    ("arguments", "error", "match"),
    [
        ({"xyz": [1, 2]}, ShapeError, "xyz: found shape"),
        ({"rpy": [1, 2]}, ShapeError, "rpy: found shape"),
        ({"rpy": [0, 0, np.nan]}, NotFiniteError, "rpy"),
        ({"quat": [0, 0, 0, 1.1]}, ArgumentError, "quat: found norm 1.1; expected 1"),
        ({"quat": [0, 0, 0, 1], "rpy": [0, 0, 0]}, ArgumentError, "found rpy and quat; expected one of them"),
        ({"xyz": np.zeros((2, 3)), "rpy": np.zeros((3, 3))}, ShapeError, "rpy: found leading axes"),
    ],
)
def test_a_broken_pose(arguments: dict[str, object], error: type[Exception], match: str) -> None:
    with pytest.raises(error, match=match):
        phipsi.pose(**arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("lower", "upper", "low", "high"),
    [(0.3, 0.3, 0.3, 0.3), (-1.0, None, -1.0, 2.0 * np.pi - 1.0), (None, -5.0, -5.0 - 2.0 * np.pi, -5.0), (-1e9, 0.5, 0.5 - 2.0 * np.pi, 0.5), (-1e9, 1e9, -np.pi, np.pi)],
)
def test_random_configurations_within_limits(lower: float | None, upper: float | None, low: float, high: float) -> None:
    """Equal and one-sided limits too; limits beyond 20 rad mean that there is none."""
    builder = phipsi.SceneBuilder().link("base").link("arm", 1.0, (0, 0, 1))
    q = builder.joint("hinge", "revolute", "base", "arm", lower=lower, upper=upper).build().random_configuration(0, size=1000)
    assert np.all((low <= q) & (q <= high)) and np.ptp(q) >= 0.98 * (high - low)


def test_random_configurations(floating: phipsi.Scene) -> None:
    q = floating.random_configuration(3, size=(500, 2))
    assert q.shape == (500, 2, 13)
    joints = q[..., 7:]
    assert np.all((floating.limits.lower[6:] <= joints) & (joints <= floating.limits.upper[6:])) and np.all(np.ptp(joints, axis=(0, 1)) > 1.0)
    assert_near(np.linalg.norm(q[..., 3:7], axis=-1), np.ones((500, 2)), 8 * EPS)
    # Uniform rotations: every entry of the rotation matrix has mean 0 and variance 1/3; five standard deviations of 1000 draws.
    turns = floating.placement(q, "base")[..., :3, :3].reshape(-1, 9)
    assert np.all(np.abs(turns.mean(axis=0)) < 5 * np.sqrt(1 / 3 / 1000)) and np.all(np.abs((turns**2).mean(axis=0) - 1 / 3) < 5 * np.sqrt(4 / 45 / 1000))
    assert np.array_equal(q, floating.random_configuration(np.random.default_rng(3), size=(500, 2)))
    assert floating.random_configuration().shape == (13,)


@pytest.mark.parametrize(("arguments", "match"), [({"seed": -1}, "seed: found -1"), ({"seed": "a"}, "seed: found 'a'"), ({"size": -1}, "size: found -1")])
def test_a_broken_argument_of_random_configurations(arm: phipsi.Scene, arguments: dict[str, object], match: str) -> None:
    with pytest.raises(ArgumentError, match=match):
        arm.random_configuration(**arguments)  # type: ignore[arg-type]


def test_the_base_of_a_scene(arm: phipsi.Scene, floating: phipsi.Scene) -> None:
    assert ", fixed base," in repr(arm) and ", floating base," in repr(floating)
    inertia = np.eye(3)
    builder = phipsi.SceneBuilder().link("world").link("ball", mass=1.0, inertia=inertia).link("box", mass=1.0, inertia=inertia)
    builder.joint("free", "floating", "world", "ball").joint("hinge", "revolute", "ball", "box")
    assert ", floating base," in repr(builder.build())
    builder.link("door", mass=1.0, inertia=inertia).joint("post", "revolute", "world", "door")
    assert ", fixed and floating bases," in repr(builder.build())


@pytest.mark.parametrize(("steps", "every"), [(20, 1), (21, 4), (20, 4), (3, 10), (0, 1)])
def test_torques_of_a_function_are_recorded(arm: phipsi.Scene, steps: int, every: int) -> None:
    """Rows equal those of the same torques given as an array, although the function returns one array that it changes."""
    plan, buffer = np.random.default_rng(0).normal(size=(max(steps, 1), 6)), np.empty(6)

    def tau(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        buffer[:] = plan[round(t / 1e-3)]
        return buffer

    start = np.full(6, 0.3), np.zeros(6)
    path = arm.simulate(*start, dt=1e-3, steps=steps, record_every=every, tau=tau)
    expected = arm.simulate(*start, dt=1e-3, steps=steps, record_every=every, tau_steps=plan[:steps])
    assert np.array_equal(path.q, expected.q) and np.array_equal(path.torques(), expected.torques())
    assert path.applied is not None and path.applied.shape == (len(path), 6) and expected.applied is None


def test_torques_of_a_function_for_a_batch(arm: phipsi.Scene) -> None:
    q = np.linspace(0.1, 0.3, 18).reshape(3, 6)
    path = arm.simulate(q, np.zeros(6), dt=1e-3, steps=4, tau=lambda t, q, qd: {"joint%d" % i: float(i) for i in range(1, 7)})
    assert path.applied is not None and np.array_equal(path.applied, np.broadcast_to(np.arange(1.0, 7.0), (3, 5, 6)))


def test_a_function_that_fails_leaves_the_torques_before(arm: phipsi.Scene) -> None:
    def tau(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        if t > 4.5e-3:
            raise RuntimeError("enough")
        return np.full(6, t)

    with pytest.raises(phipsi.errors.SimulationError) as found:
        arm.simulate(np.full(6, 0.3), np.zeros(6), dt=1e-3, steps=10, tau=tau)
    assert_near(found.value.trajectory.applied[:, 0], [0.0, 1e-3, 2e-3, 3e-3, 4e-3, 4e-3], 4 * EPS)


def test_long_work_is_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    scene = phipsi.scenes.chain(2)
    with caplog.at_level("INFO", "phipsi"):
        phipsi.compile(scene, functions=["mass_matrix"], cache=tmp_path)
        q = np.random.default_rng(0).normal(size=(50, 2))
        np.savez(tmp_path / "log.npz", q=q, qd=q, qdd=q, tau=scene.inverse_dynamics(q, q, q))
        phipsi.estimation.accumulate_logs(scene, [tmp_path / "log.npz"])
    said = [record.getMessage() for record in caplog.records if record.name == "phipsi"]
    assert said[0].startswith("compiling ") and said[1].startswith("compiled in ") and said[2] == "log 1 of 1: 50 states"


def test_one_gain_for_a_floating_robot(floating: phipsi.Scene) -> None:
    q, still = floating.neutral(), np.zeros(12)
    gains = np.r_[np.zeros(6), np.full(6, 100.0)]
    assert len(floating.simulate(q, still, dt=1e-3, steps=2, pd=phipsi.PD(gains, 0.1 * gains, q), limits="report")) == 3
    for one in (phipsi.PD(100.0, 0.1 * gains, q), phipsi.PD(100, 10.0, q), phipsi.PD(np.float64(100.0), 0.1 * gains, q)):
        # The free joint has no motor.
        paths = [floating.simulate(q, still, dt=1e-3, steps=2, pd=law, limits="report") for law in (one, phipsi.PD(gains, 0.1 * gains, q))]
        assert np.array_equal(paths[0].q, paths[1].q) and paths[0].qd[-1, 2] < 0.0
        assert np.array_equal(*(floating.ode(pd=law).rhs(0.0, np.full(24, 0.1)) for law in (one, phipsi.PD(gains, 0.1 * gains, q))))


def saved(path: phipsi.Trajectory, folder: Path) -> phipsi.Trajectory:
    path.save(folder / "motion.npz")
    return phipsi.Trajectory.load(folder / "motion.npz", path.scene)


def test_a_saved_trajectory_is_the_same(arm: phipsi.Scene, tmp_path: Path) -> None:
    law = phipsi.PD(50.0, 5.0, np.full(6, 0.2))
    q = np.linspace(0.1, 0.4, 12).reshape(2, 6)
    for given in ({"pd": law, "tau": {f"joint{i}": 1.0 for i in range(1, 7)}}, {"tau": lambda t, q, qd: -q}, {"tau_steps": np.ones((40, 6)), "friction": 0.1}):
        path = arm.simulate(q, np.ones(6), dt=1e-3, steps=40, record_every=4, **given)
        again = saved(path, tmp_path)
        for name in ("t", "q", "qd", "substeps", "events", "estimated_error"):
            assert np.array_equal(getattr(again, name), getattr(path, name), equal_nan=True)
        assert np.array_equal(again.torques(), path.torques()) and again.stops == path.stops and repr(again) == repr(path)
        assert all(np.array_equal(*pair) for pair in zip(again.energy_audit(), path.energy_audit(), strict=True))
        if path.applied is None:
            assert np.array_equal(again.vjp(again.qd).q, path.vjp(path.qd).q)


def test_contacts_of_a_saved_trajectory(tmp_path: Path) -> None:
    builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3)).contact("a/b", "ball", friction=0.5, radius=0.1)
    scene = builder.build(floating_base=True)
    path = scene.simulate([0, 0, 0.11, 0, 0, 0, 1], [1, 0, 0, 0, 0, 0], dt=1e-3, steps=100)
    again = saved(path, tmp_path)
    assert path.contacts is not None and again.contacts is not None
    assert np.array_equal(again.contacts.force["a/b"], path.contacts.force["a/b"]) and np.array_equal(again.contacts.state["a/b"], path.contacts.state["a/b"])
    assert again.contacts.residual == path.contacts.residual


def test_a_trajectory_as_a_table(arm: phipsi.Scene, tmp_path: Path) -> None:
    path = arm.simulate(np.full(6, 0.3), np.zeros(6), dt=1e-3, steps=10, tau=lambda t, q, qd: -q)
    path.to_csv(tmp_path / "motion.csv")
    header, *rows = (tmp_path / "motion.csv").read_text().splitlines()
    assert header.split(",")[:2] == ["t", "q:joint1"] and header.split(",")[-1] == "tau:joint6"
    assert np.array_equal(np.array([row.split(",") for row in rows], float), np.column_stack([path.t, path.q, path.qd, path.torques()]))
    pytest.importorskip("pandas")
    table = path.to_pandas()
    assert np.array_equal(table["qd:joint2"], path.qd[:, 1]) and np.array_equal(table.index, path.t)


def test_a_table_of_a_batch(arm: phipsi.Scene, tmp_path: Path) -> None:
    path = arm.simulate(np.zeros((2, 6)), np.zeros(6), dt=1e-3, steps=1)
    with pytest.raises(ArgumentError, match=r"found one of \(2,\) states; expected one state: to_csv has no batch axes, save does"):
        path.to_csv(tmp_path / "motion.csv")


def test_an_archive_with_another_suffix(arm: phipsi.Scene, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="path: found 'motion.dat'; expected a file with the suffix .npz"):
        arm.simulate(np.zeros(6), np.zeros(6), dt=1e-3, steps=1).save(tmp_path / "motion.dat")


def test_an_archive_of_another_robot(arm: phipsi.Scene, tmp_path: Path) -> None:
    arm.simulate(np.zeros(6), np.zeros(6), dt=1e-3, steps=1).save(tmp_path / "motion.npz")
    with pytest.raises(ArgumentError, match="scene: found the joints j0, j1; expected those of the file: joint1"):
        phipsi.Trajectory.load(tmp_path / "motion.npz", phipsi.scenes.chain(2))


def test_another_archive(arm: phipsi.Scene, tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", q=np.zeros(3))
    with pytest.raises(ArgumentError, match="expected an archive of Trajectory.save"):
        phipsi.Trajectory.load(tmp_path / "other.npz", arm)


def test_configurations_without_coordinates() -> None:
    """Their number does not determine the time."""
    scene = phipsi.SceneBuilder().link("base").build()
    assert scene.random_configuration(size=(10**7, 10**7)).shape == (10**7, 10**7, 0)


def late(value: object) -> object:
    """A control function that returns an unsuitable value from the fourth step on."""
    return lambda t, q, qd: np.zeros(6) if t < 2.5e-3 else value


WRONG_TORQUES: dict[str, tuple[object, int, str]] = {
    "length": (late(np.zeros(5)), 3, r"ShapeError: tau\(t, q, qd\): found shape \(5,\); expected \(6,\)"),
    "batch": (late(np.zeros((4, 6))), 3, r"ShapeError: tau\(t, q, qd\): found shape \(4, 6\); expected \(6,\)"),
    "nothing": (late(None), 3, r"ArgumentError: tau\(t, q, qd\): found dtype object from None"),
    "two arguments": (lambda t, q: np.zeros(6), 0, r"the call failed \(.*\); expected a function of \(t, q, qd\) that returns .* shape \(6,\)"),
    "an error inside": (lambda t, q, qd: np.zeros(6) + None, 0, r"TypeError: unsupported operand"),
}


@pytest.mark.parametrize("way", ["simulate", "ode"])
@pytest.mark.parametrize("case", WRONG_TORQUES)
def test_wrong_torques_of_a_function_keep_the_motion(arm: phipsi.Scene, case: str, way: str) -> None:
    tau, step, message = WRONG_TORQUES[case]
    start = np.full(6, 0.3), np.zeros(6)
    with pytest.raises(SimulationError, match=message) as found:
        if way == "simulate":
            arm.simulate(*start, dt=1e-3, steps=10, tau=tau)
        else:
            arm.ode(tau=tau).solve(*start, (0.0, 0.01), max_step=1e-3)
    error = found.value
    assert error.step >= step if way == "ode" else error.step == step
    assert len(error.trajectory) == error.step + 1 and np.isfinite(error.trajectory.q).all()


def test_torques_of_steps_for_one_state_are_no_batch(arm: phipsi.Scene) -> None:
    """They would be one robot for each step."""
    start, torques = (np.full(6, 0.3), np.zeros(6)), np.zeros((10, 6))
    with pytest.raises(ArgumentError, match="tau: found one row for each of 10 steps, of one state; expected tau_steps="):
        arm.simulate(*start, dt=1e-3, steps=10, tau=torques)
    assert arm.simulate(*start, dt=1e-3, steps=10, tau_steps=torques).q.shape == (11, 6)
    assert arm.simulate(*start, dt=1e-3, steps=9, tau=torques).q.shape == (10, 10, 6)
    assert arm.simulate(np.full((10, 6), 0.3), start[1], dt=1e-3, steps=10, tau=torques).q.shape == (10, 11, 6)
    assert arm.simulate(*start, dt=1e-3, steps=10, tau=torques[None]).q.shape == (1, 10, 11, 6)
    law = phipsi.PD(1.0, 1.0, np.zeros((10, 6)))
    assert arm.simulate(*start, dt=1e-3, steps=10, tau=torques, pd=law).q.shape == (10, 11, 6)


def test_a_step_of_seconds_warns(arm: phipsi.Scene) -> None:
    start = np.full(6, 0.3), np.zeros(6)
    with pytest.warns(UnitsWarning, match="dt: found steps of 1 s, which do not resolve .* expected a step in s, for instance 1e-3"):
        arm.simulate(*start, dt=1, steps=0)
    with pytest.warns(UnitsWarning, match="dt: found steps of 2 s"):
        arm.simulator(*start, dt=2)
    arm.simulate(*start, dt=0.5, steps=0)
    arm.simulate(*start, dt=1.0, steps=0, accuracy=1e-6)


def test_an_error_that_was_not_computed_is_nan(arm: phipsi.Scene) -> None:
    start = np.full(6, 0.3), np.zeros(6)
    assert np.isnan(arm.simulate(*start, dt=1e-3, steps=3).estimated_error)
    assert np.isnan(arm.simulate(np.full((2, 6), 0.3), start[1], dt=1e-3, steps=3, method="dormand-prince-5").estimated_error).all()
    assert np.isnan(arm.ode().solve(*start, (0.0, 0.01)).estimated_error)
    assert 0.0 < arm.simulate(*start, dt=1e-3, steps=3, accuracy=1e-6).estimated_error < 1e-4


def test_properties_are_read_only(floating: phipsi.Scene) -> None:
    """A change of a copy would have no effect."""
    joint, link = floating.joints["joint2"], floating.links["link2"]
    arrays = [getattr(floating, name) for name in ("damping", "friction", "stiffness", "rest", "armature", "gravity")]
    arrays += [*floating.limits, joint.xyz, joint.rotation, joint.axis, joint.rest, link.com, link.inertia]
    for array in arrays:
        assert isinstance(array, np.ndarray)
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 5.0
    own = floating.damping.copy()[6:]
    own[0] = 5.0
    assert floating.with_properties(damping=dict(zip(floating.joint_names[1:], own))).damping[6] == 5.0


GLOSSARY = [line.split("|")[1:3] for line in (Path(__file__).parents[2] / "docs" / "glossary.md").read_text(encoding="utf-8").splitlines() if line.startswith("| ") and "|---" not in line][1:]


def test_names_of_the_glossary_lead_to_those_of_a_scene(arm: phipsi.Scene) -> None:
    """docs/glossary.md lists names of other libraries."""
    seen = 0
    for elsewhere, here in GLOSSARY:
        attribute = re.match(r" \[?`scene\.(\w+)", here)
        for name in re.findall(r"`([A-Za-z_]\w*)`", elsewhere) if attribute else ():
            if not hasattr(type(arm), name):
                seen += 1
                with pytest.raises(AttributeError, match=f"no attribute '{name}'; use '{attribute[1]}'"):
                    getattr(arm, name)
    assert seen > 20


@pytest.mark.parametrize(("name", "attribute"), [("crba", "mass_matrix"), ("gravity_compensation", "gravity_torque"), ("forwardKinematics", "placement"), ("massMatrix", "mass_matrix"), ("ndof", "nv")])
def test_names_of_other_libraries_lead_to_those_of_a_scene(arm: phipsi.Scene, name: str, attribute: str) -> None:
    assert hasattr(arm, attribute)
    with pytest.raises(AttributeError, match=f"no attribute '{name}'; use '{attribute}'"):
        getattr(arm, name)


def test_every_hint_names_what_exists() -> None:
    assert all(hasattr(phipsi.Scene, name) for name in _glossary.METHODS)
    names = [name for names in _glossary.METHODS.values() for name in names]
    assert len(set(names)) == len(names)


def test_names_elsewhere_are_no_attributes(arm: phipsi.Scene) -> None:
    known = dir(arm)
    assert "forward_dynamics" in known and "crba" not in known and not hasattr(phipsi.Scene, "crba")
    with pytest.raises(AttributeError) as error:
        arm.crba  # type: ignore[attr-defined] # noqa: B018
    assert error.value.name == "crba" and error.value.obj is arm
    assert repr(vars(phipsi.Scene)["crba"]) == "use 'mass_matrix'"


def test_calls_of_methods_take_the_fast_path_of_cpython(arm: phipsi.Scene) -> None:
    """A class with its own lookup of attributes creates an object of the method for each call."""
    assert "__getattribute__" not in vars(phipsi.Scene) and not hasattr(phipsi.Scene, "__getattr__")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda arm: arm.simulate(np.zeros(6), np.zeros(6), T=1.0), r"Scene.simulate\(\) got an unexpected keyword argument 'T'; use 'duration' or 'steps'"),
        (lambda arm: arm.simulate(np.zeros(6), np.zeros(6), dt=1e-3, dampin=1.0), "'dampin'; use 'damping'"),
        (lambda arm: arm.simulate(np.zeros(6), np.zeros(6), dt=1e-3, kp=10.0), "'kp'; use 'pd'"),
        (lambda arm: arm.simulator(np.zeros(6), dt=1e-3, integrator="rk4"), "'integrator'; use 'method'"),
        (lambda arm: arm.with_payload("link6", 1.0, cog=(0, 0, 0)), "'cog'; use 'com'"),
        (lambda arm: phipsi.SceneBuilder().link("a", 1.0, cog=(0, 0, 0)), "'cog'; use 'com'"),
        (lambda arm: phipsi.SceneBuilder().joint("a", "revolute", "b", "c", origin=(0, 0, 0)), "'origin'; use 'xyz'"),
        (lambda arm: arm.with_payload("link6", 1.0, xyzzy=1), "'xyzzy'$"),
    ],
)
def test_unknown_keywords_lead_to_known_ones(arm: phipsi.Scene, call: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        call(arm)


def test_a_diverged_simulation_does_not_recommend_the_method_in_use() -> None:
    scene = phipsi.scenes.chain(3)
    given = {"dt": 1e-2, "steps": 2000, "tau": lambda t, q, qd: 1e3 * qd}
    for method, message in {"rk4": 'or method="auto"', "auto": "or set accuracy=1e-6"}.items():
        with pytest.raises(phipsi.errors.SimulationError, match=f"the motion has diverged; take a smaller dt, {message}$"):
            scene.simulate(np.zeros(3), np.full(3, 0.1), method=method, **given)
    with pytest.raises(phipsi.errors.SimulationError, match="or smaller gains and torques$"):
        scene.simulate(np.zeros(3), np.full(3, 0.1), accuracy=1e-6, **given)


SQUARE = '<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="9" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="continuous"><parent link="a"/><child link="b"/><mimc/></joint></robot>'


@pytest.mark.parametrize(
    "call",
    [
        lambda arm: phipsi.load(SQUARE),
        lambda arm: phipsi.load(SQUARE, mimic=True),
        lambda arm: phipsi.Scene.from_urdf(SQUARE),
        lambda arm: arm.simulate(np.full(6, 9.0), np.zeros(6), dt=1e-3, steps=0),
        lambda arm: phipsi.smooth(np.r_[np.arange(0, 1, 0.01), 9.0], np.zeros(101), noise=1.0, cutoff=1.0),
        lambda arm: arm.identify(*np.random.default_rng(0).normal(size=(4, 60, 6)), time=np.r_[np.arange(59) * 0.01, 9.0], noise=1.0),
        lambda arm: arm.mass_matrix(np.full(6, np.nan), errors="nan"),
    ],
)
def test_warnings_are_at_the_line_of_the_user(arm: phipsi.Scene, call: Any) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call(arm)
    assert caught and all(one.filename == __file__ for one in caught), [(one.filename, str(one.message)) for one in caught]


def test_groups_of_methods(arm: phipsi.Scene) -> None:
    """A group holds its scene, also in a pickle, and is as read-only as it."""
    scene = arm.to_builder().couple("gear", "joint3", "joint2").contact("tip", "link6", friction=0.5).build()
    assert repr(scene.loops) == "<phipsi.Loops: connections: 1, rows: 1>" and repr(scene.contacts) == "<phipsi.Contacts: 1>"
    loops, contacts = pickle.loads(pickle.dumps((scene.loops, scene.contacts)))
    assert loops.names == ("gear",) and contacts.names == ("tip",)
    assert loops.error([0.0, 0.1, 0.3, 0.0, 0.0, 0.0]).round(12) == 0.2
    with pytest.raises(AttributeError):
        scene.loops = loops  # type: ignore[misc]
    with pytest.raises(TypeError, match=r"Loops.error\(\) got an unexpected keyword argument 'Q'"):
        scene.loops.error(Q=0)  # type: ignore[call-arg]
