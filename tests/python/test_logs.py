"""Logs in files, one after the other and on several processes."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from logs import STEP, arm_of_three, fourier

import phipsi
from phipsi.errors import ArgumentError, LogWarning
from phipsi.estimation import Accumulator, _logs, accumulate_logs, read_log

#: A file that says that a worker was lost once.
LOST = "PHIPSI_TEST_LOST"


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[phipsi.Scene, list[Path], dict[str, np.ndarray]]:
    """Three parts of a log."""
    scene, folder = arm_of_three(), tmp_path_factory.mktemp("logs")
    q, qd, qdd = fourier(STEP * np.arange(900))
    tau = scene.inverse_dynamics(q, qd, qdd) + scene.damping * qd + scene.friction * qd / np.sqrt(qd**2 + 0.01**2)
    arrays = {"t": STEP * np.arange(900), "q": q, "qd": qd, "qdd": qdd, "tau": tau + 0.1 * np.random.default_rng(0).standard_normal((900, 3))}
    files = []
    for part in range(3):
        files.append(folder / f"part{part}.npz")
        np.savez(files[-1], **{name: one[300 * part : 300 * part + 300] for name, one in arrays.items()})
    return scene, files, arrays


def same(one: Accumulator, other: Accumulator) -> None:
    found, expected = one.identify(noise=0.1), other.identify(noise=0.1)
    assert found.states == expected.states
    assert np.max(np.abs(found.base.values - expected.base.values) / expected.base.deviations) < 1e-8


def test_files_one_after_the_other_are_one_log(written: tuple[phipsi.Scene, list[Path], dict[str, np.ndarray]]) -> None:
    scene, files, arrays = written
    whole = Accumulator(scene, fit=["damping"]).add(*(arrays[name] for name in ("q", "qd", "qdd", "tau")))
    same(accumulate_logs(scene, files, fit=["damping"]), whole)


def lose(scene: phipsi.Scene, log: str, cutoff: float | None, settings: dict[str, object]) -> Accumulator:
    """Kills its process the first time."""
    flag = Path(os.environ[LOST])
    if not flag.exists():
        flag.touch()
        os._exit(1)
    arrays = read_log(log, scene)
    return Accumulator(scene, **settings).add(*(arrays[name] for name in ("q", "qd", "qdd", "tau")))  # type: ignore[arg-type]


def test_two_processes_and_a_lost_one(written: tuple[phipsi.Scene, list[Path], dict[str, np.ndarray]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, files, _ = written
    alone = accumulate_logs(scene, files)
    monkeypatch.setenv(LOST, str(tmp_path / "lost"))
    monkeypatch.setattr(_logs, "_accumulated", lose)
    with pytest.warns(RuntimeWarning, match="logs: a worker was lost; .* is read again"):
        same(accumulate_logs(scene, files, workers=2), alone)


def test_dask(written: tuple[phipsi.Scene, list[Path], dict[str, np.ndarray]]) -> None:
    distributed = pytest.importorskip("distributed")
    scene, files, _ = written
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None) as cluster, distributed.Client(cluster) as client:
        same(accumulate_logs(scene, files, client=client), accumulate_logs(scene, files))


def write_csv(file: Path, columns: dict[str, Any], separator: str = ",") -> None:
    """Columns of numbers or texts."""
    lines = [separator.join(columns), *(separator.join(map(str, row)) for row in zip(*(np.asarray(one).tolist() for one in columns.values()), strict=True))]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize("named", [True, False])
def test_tables(kind: str, named: bool, written: tuple[phipsi.Scene, list[Path], dict[str, np.ndarray]], tmp_path: Path) -> None:
    scene, _, arrays = written
    columns = {"time": arrays["t"]}
    for name in ("q", "qd", "qdd", "tau"):
        for at, joint in enumerate(scene.joint_names):
            columns[f"{joint}.{name}" if named else f"{name}{at + 1}"] = arrays[name][:, at]
    # Columns in any order.
    columns, file = dict(reversed(list(columns.items()))), tmp_path / f"log.{kind}"
    if kind == "csv":
        write_csv(file, columns)
    else:
        pytest.importorskip("polars").DataFrame(columns).write_parquet(file)
    found = read_log(file, scene)
    for name, expected in arrays.items():
        np.testing.assert_array_equal(found["time" if name == "t" else name], expected)


def test_a_bag(written: tuple[phipsi.Scene, list[Path], dict[str, np.ndarray]], tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    scene, _, arrays = written
    store = get_typestore(Stores.ROS2_HUMBLE)
    message, header, stamp = (store.types[name] for name in ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"))
    names = list(reversed(scene.joint_names))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        to = writer.add_connection("/joint_states", message.__msgtype__, typestore=store)
        for k in range(300):
            nanoseconds = round(arrays["t"][k] * 1e9)
            one = message(
                header=header(stamp=stamp(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9), frame_id=""), name=names,
                position=arrays["q"][k, ::-1].copy(), velocity=np.zeros(0), effort=arrays["tau"][k, ::-1].copy(),
            )  # fmt: skip
            writer.write(to, nanoseconds, store.serialize_cdr(one, message.__msgtype__))
    found = read_log(tmp_path / "bag", scene)
    np.testing.assert_array_equal(found["q"], arrays["q"][:300])
    np.testing.assert_array_equal(found["tau"], arrays["tau"][:300])
    assert np.max(np.abs(found["time"] - arrays["t"][:300])) < 1e-8
    (mcap,) = (tmp_path / "bag").glob("*.mcap")
    assert len(read_log(mcap, scene)["q"]) == 300
    assert accumulate_logs(scene, [tmp_path / "bag"], cutoff=10.0).states == 300


def test_faults_of_each_log_are_reported(written: tuple[phipsi.Scene, list[Path], dict[str, np.ndarray]], tmp_path: Path) -> None:
    scene, files, arrays = written
    np.savez(tmp_path / "degrees.npz", t=arrays["t"], q=arrays["q"], qd=np.degrees(arrays["qd"]), qdd=np.degrees(arrays["qdd"]), tau=arrays["tau"])
    with pytest.warns(LogWarning, match="qd: found a numerical derivative of q that is 0.017"):
        accumulate_logs(scene, [files[0], tmp_path / "degrees.npz"])


def test_what_cannot_be_read(written: tuple[phipsi.Scene, list[Path], dict[str, np.ndarray]], tmp_path: Path) -> None:
    scene = written[0]
    np.savez(tmp_path / "short.npz", q=np.zeros((3, 3)))
    (tmp_path / "broken.npz").write_text("no archive")
    (tmp_path / "log.txt").write_text("0")
    for name, message in {"short.npz": "found no tau", "broken.npz": "expected an .npz with q, qd, qdd and tau", "log.txt": "found 'log.txt'; expected .npz, .csv", "none.npz": "No such file"}.items():
        with pytest.raises(ArgumentError, match=message):
            read_log(tmp_path / name, scene)
    np.savez(tmp_path / "still.npz", q=np.zeros((3, 3)), tau=np.zeros((3, 3)))
    with pytest.raises(ArgumentError, match="log: found neither qd and qdd nor time in"):
        accumulate_logs(scene, [tmp_path / "still.npz"])
    with pytest.raises(ArgumentError, match="logs: found none"):
        accumulate_logs(scene, [])
    with pytest.raises(ArgumentError, match="workers: found 0"):
        accumulate_logs(scene, ["a.npz"], workers=0)
    with pytest.raises(ArgumentError, match="fit: found 'x'"):
        accumulate_logs(scene, ["a.npz"], fit=["x"])


Written = tuple[phipsi.Scene, list[Path], dict[str, np.ndarray]]
FIELDS = {"q": "position", "qd": "velocity", "tau": "effort"}


def check_read(file: Path, scene: phipsi.Scene, arrays: dict[str, np.ndarray], time: float = 1e-12) -> None:
    found = read_log(file, scene)
    for name in FIELDS:
        np.testing.assert_array_equal(found[name], arrays[name])
    assert np.max(np.abs(found["time"] - found["time"][0] - arrays["t"])) < time


@pytest.mark.parametrize("pattern", ["/joint_states/{joint}/{field}", "/joint_states/{field}/{joint}", "{joint}_{field}", "{field}.{joint}", "{kind}:{joint}"])
def test_tables_of_plotjuggler_and_of_ros(pattern: str, written: Written, tmp_path: Path) -> None:
    scene, _, arrays = written
    columns: dict[str, Any] = {"__time": arrays["t"]}
    for at in (2, 0, 1):
        for kind, field in FIELDS.items():
            columns[pattern.format(joint=scene.joint_names[at], field=field, kind=kind)] = arrays[kind][:, at]
    columns["/imu/angular_velocity/x"] = np.ones(900)
    write_csv(tmp_path / "log.csv", columns)
    check_read(tmp_path / "log.csv", scene, arrays)


@pytest.mark.parametrize("pattern", ["/joint_states/{field}[{at}]", "field.{field}{at}", "/joint_states/{field}.{at}"])
@pytest.mark.parametrize("labeled", [True, False])
def test_columns_with_the_indices_of_a_message(pattern: str, labeled: bool, written: Written, tmp_path: Path) -> None:
    """By the names of the joints in the message, which ROS sorts; without them in the order of the scene, with a warning."""
    scene, _, arrays = written
    columns: dict[str, Any] = {"%time": (1e9 * arrays["t"]).round().astype(int) + 1_700_000_000_000_000_000}
    order = [1, 2, 0] if labeled else [0, 1, 2]
    for at, joint in enumerate(order):
        if labeled:
            columns[pattern.format(field="name", at=at)] = [scene.joint_names[joint]] * 900
        for kind, field in FIELDS.items():
            columns[pattern.format(field=field, at=at)] = arrays[kind][:, joint]
    write_csv(tmp_path / "log.csv", columns)
    with pytest.warns(LogWarning) as caught:
        check_read(tmp_path / "log.csv", scene, arrays, 1e-6)
    texts = [str(one.message) for one in caught]
    assert any("time: found a median step of 5e+06, which is 200 Hz in ns; expected s: read as ns" in text for text in texts)
    assert labeled != any("without names of joints; they are read in the order joint1, joint2, joint3" in text for text in texts)
    assert all(one.filename == __file__ for one in caught)


def test_a_table_of_a_spreadsheet(written: Written, tmp_path: Path) -> None:
    """Semicolons, decimal commas, a byte order mark, an empty cell, rows of other topics, times in ms by the name of the column."""
    scene, _, arrays = written
    head = ["Time [ms]", *(f"{joint}.{kind}" for kind in FIELDS for joint in scene.joint_names)]
    rows = [[1e3 * arrays["t"][k], *arrays["q"][k], *arrays["qd"][k], *arrays["tau"][k]] for k in range(20)]
    lines = [";".join(head), *(";".join(repr(float(one)).replace(".", ",") for one in row) for row in rows)]
    lines.insert(3, "7,5" + ";" * 9)
    lines[8] = ";".join(lines[8].split(";")[:-1] + [""])
    (tmp_path / "log.csv").write_text("\ufeff" + "\r\n".join(lines), encoding="utf-8")
    found = read_log(tmp_path / "log.csv", scene)
    np.testing.assert_array_equal(found["q"], arrays["q"][:20])
    assert np.isnan(found["tau"][6, 2]) and np.isnan(found["tau"]).sum() == 1
    assert np.max(np.abs(found["time"] - arrays["t"][:20])) < 1e-12


def test_a_stamp_in_two_columns(written: Written, tmp_path: Path) -> None:
    scene, _, arrays = written
    nanoseconds = (1e9 * arrays["t"]).round().astype(int) + 1_700_000_000_000_000_000
    columns = {"header.stamp.sec": nanoseconds // 10**9, "header.stamp.nanosec": nanoseconds % 10**9}
    columns |= {f"{joint}.{kind}": arrays[kind][:, at] for kind in FIELDS for at, joint in enumerate(scene.joint_names)}
    write_csv(tmp_path / "log.csv", columns)
    check_read(tmp_path / "log.csv", scene, arrays, 1e-6)


def test_faults_of_tables(written: Written, tmp_path: Path) -> None:
    """Each lists what the file has."""
    scene, _, arrays = written
    file = tmp_path / "log.csv"
    columns: dict[str, Any] = {"time": arrays["t"]} | {f"{joint}.q": arrays["q"][:, at] for at, joint in enumerate(scene.joint_names)}
    cases = {
        "found no q, tau in .*, which has: a, b; expected q, tau": {"a": [1, 2], "b": [1, 2]},
        "found no tau in .*, which has: time, joint1.q, joint2.q, joint3.q": columns,
        "found no column q of joint 'joint3' in the columns joint1.q, joint2.q": {f"joint{at}.q": [1, 2] for at in (1, 2)},
        "found the columns 'joint1.q' and '/goal/joint1/position'; expected one of them": columns | {"/goal/joint1/position": arrays["t"]},
        "found 4 columns such as 'position.0.' without names of joints; expected 3": {f"position[{at}]": [1, 2] for at in range(4)},
        "found 'off' in row 1 of column 'joint2.q'; expected numbers": columns | {"joint2.q": ["0", "off", *["1"] * 898]},
        "found 'noon' in row 0 of column 'time'": columns | {"time": ["noon"] * 900} | {f"tau{at}": arrays["t"] for at in (1, 2, 3)},
    }
    for message, given in cases.items():
        write_csv(file, given)
        with pytest.raises(ArgumentError, match=message):
            read_log(file, scene)
    file.write_text("a,b\n1,2,3\n", encoding="utf-8")
    with pytest.raises(ArgumentError, match="found 3 cells in row 1 of .*; expected 2"):
        read_log(file, scene)


def test_names_of_an_archive_order_its_columns(written: Written, tmp_path: Path) -> None:
    """Joints of other robots in it are omitted."""
    scene, _, arrays = written
    order, more = [2, 0, 1], np.full((900, 1), np.nan)
    file = tmp_path / "log.npz"
    given = {name: np.hstack([arrays[name][:, order[:2]], more, arrays[name][:, order[2:]]]) for name in FIELDS}
    names = [scene.joint_names[2], scene.joint_names[0], "gripper", scene.joint_names[1]]
    np.savez(file, t=arrays["t"], joint_names=names, **given)
    check_read(file, scene, arrays)
    for changed, message in {
        "wrist": "log: q: found no joint 'joint3' in the joint_names wrist, joint1, gripper, joint2; expected those of the scene: joint1, joint2, joint3",
        "joint1": "found no joint 'joint3'",
    }.items():
        np.savez(file, t=arrays["t"], joint_names=[changed, *names[1:]], **given)
        with pytest.raises(ArgumentError, match=message):
            read_log(file, scene)
    np.savez(file, t=arrays["t"], joint_names=[*names, "joint1"], **given)
    with pytest.raises(ArgumentError, match="found a joint twice"):
        read_log(file, scene)
    np.savez(file, t=arrays["t"], joint_names=names[:2] + names[3:], **given)
    with pytest.raises(ArgumentError, match=r"log: q: found shape \(900, 4\) for the joint_names joint3, joint1, joint2; expected \(..., 3\)"):
        read_log(file, scene)
    np.savez(file, motion=arrays["q"])
    with pytest.raises(ArgumentError, match="found no q, tau in .*, which has: motion"):
        read_log(file, scene)


@pytest.mark.parametrize(("unit", "length"), [("ns", 1e-9), ("us", 1e-6), ("ms", 1e-3)])
@pytest.mark.parametrize("origin", [0, 1_700_000_000])
def test_times_in_other_units_are_converted_with_a_warning(unit: str, length: float, origin: int, written: Written) -> None:
    """Of every function that takes times."""
    scene, _, arrays = written
    time = (arrays["t"] / length).round().astype(np.int64) + round(origin / length)
    with pytest.warns(LogWarning, match=f"time: found .*; expected s: read as {unit}; .* avoids this warning"):
        found = phipsi.smooth(time, arrays["q"], cutoff=5.0)
    assert np.max(np.abs(found.time - origin - arrays["t"])) < 1e-6
    assert np.max(np.abs(found.qd[50:-50] - arrays["qd"][50:-50])) < 0.1
    offsets = []
    for given in (time, arrays["t"]):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", LogWarning)
            offsets.append(scene.identify(*(arrays[name] for name in ("q", "qd", "qdd", "tau")), time=given).clock_offset)
        assert any(f"read as {unit}" in str(one.message) for one in caught) == (given is time)
    assert abs(offsets[0] - offsets[1]) < 0.1 * STEP


def test_times_that_could_be_in_ms(written: Written) -> None:
    with pytest.warns(LogWarning, match=r"time: found a median step of 5, which is 200 Hz in ms; expected s: 1e-3 \* time if it is in ms"):
        found = phipsi.smooth(1e3 * written[2]["t"] + 1e-4, written[2]["q"], cutoff=5e-3)
    assert found.time[-1] > 4e3


def test_positions_alone_have_little_noise_in_their_accelerations(written: Written, tmp_path: Path) -> None:
    """3e-5 of the variance, or less if the likelihood is for a lower bandwidth; torques pass the same filter."""
    scene, _, arrays = written
    draw = np.random.default_rng(1)
    q = arrays["q"] + 1e-4 * draw.standard_normal(arrays["q"].shape)
    tau = arrays["tau"].copy()
    tau[100:103, 1], tau[:, 2] = np.nan, np.nan
    found, smoothed = _logs.with_derivatives({"time": arrays["t"], "q": q, "tau": tau}, "log")
    assert smoothed is not None
    share = np.var(found["qdd"] - arrays["qdd"], axis=0) / np.var(arrays["qdd"], axis=0)
    assert np.all(smoothed.acceleration_noise**2 < 5e-5 * np.var(found["qdd"], axis=0)) and np.all(share < 0.01)
    # Missing torques stay missing; white noise above the bandwidth is removed.
    np.testing.assert_array_equal(np.isnan(found["tau"]), np.isnan(tau))
    clean = arrays["tau"][:, 0] - 0.1 * np.random.default_rng(0).standard_normal((900, 3))[:, 0]
    assert np.std(found["tau"][50:-50, 0] - clean[50:-50]) < 0.06
    same, none = _logs.with_derivatives(arrays | {"time": arrays["t"]}, "log")
    assert none is None and same["tau"] is arrays["tau"]
