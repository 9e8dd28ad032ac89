"""Log files (npz, csv, parquet, rosbag2, mcap), and their accumulation on several processes or machines."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._install import command
from ..errors import ArgumentError, LogWarning, of_argument, warn
from ._accumulator import Accumulator, _log
from ._checks import checked_time, in_seconds, shifted, warn_of_motion
from ._faults import warn_of_faults
from ._identification import _combinations as combinations_of
from ._smooth import Smoothed, smooth
from ._tables import ALIASES, LABELS, arrays_of, by_names, listed, read_csv, times_of

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["accumulate_logs", "read_log"]

_LOGGER = logging.getLogger("phipsi")
_Array = NDArray[np.float64]

#: Number of attempts to read a log whose process is terminated.
ATTEMPTS = 3
#: Share of the variance of the accelerations that is noise after smoothing. In logs of 10 s with 0.1 N m of noise,
#: shares above 3e-4 bias the estimates by more than 0.2 standard deviations. Least number of torques that are filtered.
NOISE, FEWEST = 3e-5, 10


def read_log(path: str | Path, scene: Scene) -> dict[str, _Array]:
    """Read a log from a file.

    Parameters
    ----------
    path : str or pathlib.Path
        One of: an npz file with the arrays "time" (or "t"), "q", "qd", "qdd" and "tau", and "joint_names" if their
        columns are not in the order of the scene; a csv file (separated by commas, semicolons or tabs) or a parquet
        file (requires polars) with a column of times and columns of each joint, named as "JOINT.q",
        "/topic/JOINT/position" (PlotJuggler), "position[0]" (ROS; with names[0] or in joint order) or "q1"; a rosbag2
        folder or an mcap file with sensor_msgs/JointState messages, of which positions and efforts are read (requires
        rosbags). Velocities are named qd or velocity, accelerations qdd or acceleration, torques tau, effort or torque.
    scene : phipsi.Scene
        The robot, for the names and the order of its joints.

    Returns
    -------
    arrays : dict of str to ndarray
        The arrays of the log: "time", (k,), s; "q", "qd", "qdd" and "tau", (k, nv). "q" and "tau" are always present.

    Raises
    ------
    ArgumentError
        A file that is not a log. The message names the missing array, and the arrays or columns of the file.
    ImportError
        A missing package for this format. The message names it.

    Warns
    -----
    LogWarning
        Times that are not in seconds, which are converted, and columns with indices but without names of joints.

    Examples
    --------
    >>> import numpy as np, phipsi
    >>> import pathlib, tempfile
    >>> scene = phipsi.scenes.chain(2)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "log.npz")
    ...     np.savez(path, t=np.arange(5) * 0.01, q=np.zeros((5, 2)), tau=np.zeros((5, 2)))
    ...     log = phipsi.estimation.read_log(path, scene)
    >>> sorted(log), log["q"].shape
    (['q', 'tau', 'time'], (5, 2))
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind == ".npz":
        return _of_npz(path, scene)
    if kind in (".csv", ".parquet"):
        return _of_table(path, scene)
    if kind == ".mcap" or path.is_dir():
        return _of_bag(path, scene)
    raise of_argument(
        ArgumentError, "log", f"found {path.name!r}; expected .npz, .csv, .parquet, .mcap or a folder of rosbag2"
    )


def with_derivatives(
    found: dict[str, _Array], source: str, cutoff: ArrayLike | None = None
) -> tuple[dict[str, _Array], Smoothed | None]:
    """Arrays with velocities and accelerations; if they result from smoothing of the positions, the smoothed motion.

    The torques then pass the same filter, at the largest bandwidth of the joints. `cutoff` is in Hz, None: `bandwidth`.
    """
    if "qd" in found and "qdd" in found:
        return found, None
    if "time" not in found:
        lacking = " and ".join(name for name in ("qd", "qdd") if name not in found)
        raise of_argument(ArgumentError, "log", f"found neither {lacking} nor time in {source!r}; expected one of them")
    smoothed = smooth(found["time"], found["q"], cutoff=cutoff)
    if cutoff is None:
        with warnings.catch_warnings():
            # The first call issued the warnings.
            warnings.simplefilter("ignore", LogWarning)
            smoothed = smooth(smoothed.time, found["q"], cutoff=bandwidth(smoothed))
    _LOGGER.info("%s: positions smoothed at %s Hz", source, smoothed.cutoff.round(1).tolist())
    tau = filtered(smoothed.time, found["tau"], float(smoothed.cutoff.max()))
    return found | {"q": smoothed.q, "qd": smoothed.qd, "qdd": smoothed.qdd, "tau": tau}, smoothed


def bandwidth(smoothed: Smoothed) -> _Array:
    """Bandwidths, (n,), Hz, at which noise is a small share of the variance of the accelerations, at most those given.

    Maximum likelihood finds the bandwidth of positions with the smallest error; accelerations then contain noise, which
    biases the estimates. The variance of this noise is noise^2 h (2 pi f)^5 / 18 with the step h.
    """
    step = (smoothed.time[-1] - smoothed.time[0]) / (len(smoothed.time) - 1)
    signal = np.var(smoothed.qdd, axis=0) - smoothed.acceleration_noise**2
    # A joint at rest has no accelerations that noise could bias.
    moving = signal > smoothed.acceleration_noise**2
    hertz = (18.0 * NOISE * np.where(moving, signal, 0.0) / (smoothed.noise**2 * step)) ** 0.2 / (2.0 * np.pi)
    return np.where(moving, np.minimum(smoothed.cutoff, hertz), smoothed.cutoff)


def filtered(time: _Array, tau: _Array, cutoff: float) -> _Array:
    """Torques through the filter of the positions; NaN where they were not measured."""
    seen = np.isfinite(tau)
    scale = np.max(np.abs(np.where(seen, tau, 0.0)), axis=0)
    used = (scale > 0.0) & (seen.sum(axis=0) > FEWEST)
    if not used.any():
        return tau
    found = tau.copy()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)
        # In units of the largest torque, no step has the size of a revolution.
        found[:, used] = smooth(time, tau[:, used] / scale[used], cutoff=cutoff).q * scale[used]
    return np.where(seen, found, np.nan)


def _of_npz(path: Path, scene: Scene) -> dict[str, _Array]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            known = {name: archive[name] for name in archive.files if name in ALIASES or name in LABELS}
            found = archive.files
    except (OSError, ValueError, EOFError, BadZipFile) as error:
        raise of_argument(ArgumentError, "log", f"found {error}; expected an .npz with q, qd, qdd and tau") from None
    arrays = {ALIASES[name]: values for name, values in known.items() if name in ALIASES}
    names = next((known[name] for name in LABELS if name in known), None)
    if names is not None:
        arrays = {
            kind: values if kind == "time" else by_names(f"log: {kind}", names, values, scene, kind == "q")
            for kind, values in arrays.items()
        }
    return _complete(arrays, path, found)


def _of_table(path: Path, scene: Scene) -> dict[str, _Array]:
    columns: dict[str, Any] = read_csv(path) if path.suffix.lower() == ".csv" else _of_parquet(path)
    arrays: dict[str, Any] = dict(arrays_of(columns, scene))
    # Rows of other topics, between the rows of the joints.
    empty = [np.isnan(values).all(axis=1) for values in arrays.values()]
    rows = ~np.logical_and.reduce(empty) if empty else slice(None)
    arrays = {kind: values[rows] for kind, values in arrays.items()}
    if (time := times_of(columns)) is not None:
        arrays["time"] = time[rows]
    return _complete(arrays, path, columns)


def _of_parquet(path: Path) -> dict[str, Any]:
    try:
        import polars
    except ImportError:
        raise ImportError(f"log: parquet is read by polars; install it with: {command('logs')}") from None
    try:
        table = polars.read_parquet(path)
    except Exception as error:
        raise of_argument(ArgumentError, "log", f"found {error}; expected a table") from None
    return {
        name: np.asarray(table[name].cast(polars.Float64).to_numpy(), float)
        if table[name].dtype.is_numeric()
        else list(map(str, table[name]))
        for name in table.columns
    }


def _complete(arrays: dict[str, Any], path: Path, columns: Iterable[str]) -> dict[str, _Array]:
    """The arrays of a log, with times in s; an error that lists what the file has if q or tau is missing."""
    lacking = [name for name in ("q", "tau") if name not in arrays]
    if lacking:
        raise of_argument(
            ArgumentError,
            "log",
            f"found no {', '.join(lacking)} in {str(path)!r}, which has: {listed(columns)}; expected q, tau, and qd and"
            " qdd or time, in a table as JOINT.q, /topic/JOINT/position, position[0] or q1",
        )
    if "time" in arrays:
        arrays["time"] = in_seconds(arrays["time"])
    return {name: np.asarray(values, float) for name, values in arrays.items()}


def _of_bag(path: Path, scene: Scene) -> dict[str, _Array]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise ImportError(f"log: bags are read by rosbags; install it with: {command('logs')}") from None
    joints = list(scene.joint_names)
    rows: list[tuple[float, list[float], list[float]]] = []
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            topics = [one for one in reader.connections if one.msgtype == "sensor_msgs/msg/JointState"]
            for connection, _, raw in reader.messages(connections=topics):
                message: Any = reader.deserialize(raw, connection.msgtype)
                at = {name: place for place, name in enumerate(message.name)}
                if not all(joint in at for joint in joints):
                    continue
                position, effort = (
                    [float(values[at[joint]]) if len(values) > at[joint] else np.nan for joint in joints]
                    for values in (message.position, message.effort)
                )
                rows.append((message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec, position, effort))
    except Exception as error:
        raise of_argument(ArgumentError, "log", f"found {error}; expected a bag of ROS 2") from None
    if not rows:
        raise of_argument(
            ArgumentError,
            "log",
            f"found no sensor_msgs/JointState with the joints {', '.join(joints)} in {str(path)!r}; expected some",
        )
    rows.sort(key=lambda row: row[0])
    time = np.array([row[0] for row in rows])
    return {"time": time - time[0], "q": np.array([row[1] for row in rows]), "tau": np.array([row[2] for row in rows])}


def accumulate_logs(
    scene: Scene,
    logs: Sequence[str | Path],
    *,
    workers: int = 1,
    client: Any = None,
    cutoff: ArrayLike | None = None,
    tau_delay: float = 0.0,
    **settings: Any,
) -> Accumulator:
    """Accumulate many logs on several processes, or on the machines of a Dask cluster.

    Parameters
    ----------
    scene : phipsi.Scene
        The model.
    logs : sequence of str or pathlib.Path
        Files in the order of time, in a format of read_log. If velocities or accelerations are missing, positions are
        smoothed, and torques pass the same filter.
    workers : int, default 1
        Number of processes on this machine.
    client : distributed.Client, optional
        Client of a Dask cluster whose workers have access to the files.
    cutoff : array_like, optional
        Bandwidth, Hz, as in phipsi.smooth. None: by maximum likelihood, reduced until noise is 3e-5 of the variance of
        the accelerations.
    tau_delay : float, default 0
        Delay of the torques relative to q, s, as in Scene.identify.
    **settings
        Keyword arguments of Accumulator.

    Returns
    -------
    accumulator : Accumulator
        The logs, merged in their order. The result does not depend on the number of workers. A log whose worker is
        terminated is read again, up to three times.

    Raises
    ------
    ArgumentError
        No logs, a file that cannot be read, or a log whose worker is terminated three times.

    Examples
    --------
    >>> import numpy as np, phipsi
    >>> import pathlib, tempfile
    >>> scene = phipsi.scenes.chain(2)
    >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "log.npz")
    ...     np.savez(path, q=q, qd=qd, qdd=qdd, tau=scene.inverse_dynamics(q, qd, qdd))
    ...     found = phipsi.estimation.accumulate_logs(scene, [path, path])
    >>> found.states
    100
    """
    if not logs:
        raise of_argument(ArgumentError, "logs", "found none; expected at least one file")
    if not (isinstance(workers, (int, np.integer)) and workers >= 1):
        raise of_argument(ArgumentError, "workers", f"found {workers!r}; expected a whole number, at least 1")
    Accumulator(scene, **settings)
    if tau_delay:
        settings = settings | {"tau_delay": tau_delay}
    if client is not None:
        tasks = [
            client.submit(_accumulated, scene, str(log), cutoff, settings, retries=ATTEMPTS, pure=False) for log in logs
        ]
        parts: Iterable[Accumulator] = client.gather(tasks)
    elif workers == 1 or len(logs) == 1:
        parts = (_accumulated(scene, str(log), cutoff, settings) for log in logs)
    else:
        parts = _on_processes(scene, [str(log) for log in logs], workers, cutoff, settings)
    found: Accumulator | None = None
    for at, part in enumerate(parts, 1):
        _LOGGER.info("log %d of %d: %d states", at, len(logs), part.states)
        found = part if found is None else found.merge(part)
    assert found is not None
    return found


def _accumulated(scene: Scene, log: str, cutoff: ArrayLike | None, settings: dict[str, Any]) -> Accumulator:
    """Accumulator of one log."""
    arrays, smoothed = with_derivatives(read_log(log, scene), log, cutoff)
    if smoothed is not None and settings.get("acceleration_noise") is None:
        settings = settings | {"acceleration_noise": smoothed.acceleration_noise}
    # Only warnings of this process reach the user.
    q, qd, qdd, tau = _log(scene, arrays["q"], arrays["qd"], arrays["qdd"], arrays["tau"])
    time = checked_time(arrays["time"], len(q)) if "time" in arrays else None
    if delay := float(settings.get("tau_delay", 0.0)):
        if time is None:
            raise of_argument(ArgumentError, "tau_delay", f"found {delay} without time in {log!r}; expected time")
        tau = shifted(tau, time, delay)
    accumulator = Accumulator(scene, **_of_accumulator(settings))
    if warn_of_motion(scene, time, q, qd, qdd):
        columns = accumulator.columns
        differences = accumulator.acceleration_noise is None
        used = combinations_of(columns).columns
        warn_of_faults(columns, used, time, (q, qd, qdd, columns.measured(q, tau)), None, differences)
    return accumulator.add(q, qd, qdd, tau)


def _of_accumulator(settings: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in settings.items() if name != "tau_delay"}


def _on_processes(
    scene: Scene, logs: list[str], workers: int, cutoff: ArrayLike | None, settings: dict[str, Any]
) -> Iterator[Accumulator]:
    """Yield the accumulators of all logs in their order."""
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool

    done: dict[int, Accumulator] = {}
    for attempt in range(1 + ATTEMPTS):
        lost = [at for at in range(len(logs)) if at not in done]
        if not lost:
            break
        if attempt == ATTEMPTS:
            raise of_argument(
                ArgumentError,
                "logs",
                f"found a worker that was lost {ATTEMPTS} times, last with {logs[lost[0]]!r}; expected enough memory:"
                " fewer workers, or workers=1",
            )
        # A forked process would inherit locks of other threads; a spawned process does not.
        with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
            tasks = {at: pool.submit(_accumulated, scene, logs[at], cutoff, settings) for at in lost}
            for at, task in tasks.items():
                try:
                    done[at] = task.result()
                except BrokenProcessPool:
                    warn(f"logs: a worker was lost; {logs[at]!r} is read again", RuntimeWarning)
                    break
    for at in range(len(logs)):
        yield done[at]
