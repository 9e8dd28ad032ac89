"""Logs in files, one after the other and on several processes."""

from __future__ import annotations

import os
from pathlib import Path

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
    arrays = {"t": STEP * np.arange(900), "q": q, "qd": qd, "qdd": qdd, "tau": scene.inverse_dynamics(q, qd, qdd) + 0.1 * np.random.default_rng(0).standard_normal((900, 3))}
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


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize("named", [True, False])
def test_tables(kind: str, named: bool, written: tuple[phipsi.Scene, list[Path], dict[str, np.ndarray]], tmp_path: Path) -> None:
    polars = pytest.importorskip("polars")
    scene, _, arrays = written
    columns = {"time": arrays["t"]}
    for name in ("q", "qd", "qdd", "tau"):
        for at, joint in enumerate(scene.joint_names):
            columns[f"{joint}.{name}" if named else f"{name}{at + 1}"] = arrays[name][:, at]
    # Columns in any order.
    table = polars.DataFrame(dict(reversed(list(columns.items()))))
    file = tmp_path / f"log.{kind}"
    table.write_csv(file) if kind == "csv" else table.write_parquet(file)
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
