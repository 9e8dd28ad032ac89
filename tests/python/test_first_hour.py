"""Names that a new user meets first: star imports, renamed arguments and fields, poses, random configurations, torques of
control functions, gains of floating robots.
"""

from __future__ import annotations

import builtins
import warnings
from pathlib import Path

import numpy as np
import phipsi
import pytest
from phipsi.errors import ArgumentError, MimicWarning, NotFiniteError, ShapeError
from tolerances import EPS, assert_near, size

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


@pytest.mark.parametrize("former", ["connection_names", "connection_rows", "without_connections"])
def test_former_names_of_constraints(arm: phipsi.Scene, former: str) -> None:
    present = {"connection_names": "constraint_names", "connection_rows": "constraint_rows"}.get(former, "without_constraints")
    assert hasattr(arm, present)
    with pytest.raises(AttributeError, match=f"no attribute '{former}'; it was renamed to '{present}'"):
        getattr(arm, former)


def test_a_former_name_of_trajectories(arm: phipsi.Scene) -> None:
    path = arm.simulate(arm.neutral(), np.zeros(arm.nv), dt=1e-3, steps=2)
    assert path.constraint_forces() == {}
    with pytest.raises(AttributeError, match="expected constraint_forces"):
        path.connection_forces  # noqa: B018


def test_an_unknown_attribute_is_named(arm: phipsi.Scene) -> None:
    with pytest.raises(AttributeError, match="^'Scene' object has no attribute 'forward_dynamic'$"):
        arm.forward_dynamic  # type: ignore[attr-defined] # noqa: B018


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


@pytest.mark.parametrize(("arguments", "match"), [({"rng": -1}, "rng: found -1"), ({"rng": "a"}, "rng: found 'a'"), ({"size": -1}, "size: found -1")])
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
    for broken in (phipsi.PD(100.0, 0.1 * gains, q), phipsi.PD(100, gains, q), phipsi.PD(np.float64(100.0), gains, q)):
        with pytest.raises(ArgumentError, match='pd.kp: found one number .* "root_joint" in the air; expected 12 gains'):
            floating.simulate(q, still, dt=1e-3, steps=2, pd=broken)
    with pytest.raises(ArgumentError, match="pd.kd: found one number"):
        floating.simulator(q, still, dt=1e-3, pd=phipsi.PD(gains, 1.0, q))
    with pytest.raises(ArgumentError, match="pd.kp: found one number"):
        floating.ode(pd=phipsi.PD(100.0, gains, q))


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
            assert np.array_equal(getattr(again, name), getattr(path, name))
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
