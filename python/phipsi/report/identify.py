"""The command `phipsi identify`."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.markup import escape

from ..estimation import Accumulator, accumulate_logs, read_log
from ..estimation._columns import KINDS
from ..estimation._identification import Identification, predicted
from ..estimation._logs import with_derivatives
from . import pipeline, terminal
from .commands import JSON, FLOATING, BadInput, _as_options, _load, _typed_errors, check_pages, echo_json, group
from .identification import REPORT, IdentificationReport
from .progress import Silent

#: Fields of the result in the JSON.
NUMBERS = ("parameters", "deviations", "share", "joints", "joint_deviations", "joint_share", "noise", "before", "after", "known", "blocks", "states", "inflation", "clock_offset")


@group.command()
@click.argument("robot", metavar="ROBOT.urdf", type=click.Path(path_type=Path))
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=click.Path(path_type=Path))
@FLOATING
@click.option("-o", "--output", type=click.Path(path_type=Path, dir_okay=False), help="Write the robot with the estimates as a URDF.")
@click.option("--covariance", type=click.Path(path_type=Path, dir_okay=False), help="Write the covariance of the parameters of bodies and joints as .npz, for phipsi simulate --covariance.")
@click.option("--report", "folder", type=click.Path(path_type=Path, file_okay=False), help="Write a page about the identification into this folder.")
@click.option("--fit", type=click.Choice(KINDS), multiple=True, help="Of the joints, too; may be given several times.")
@click.option("--noise", type=float, help="Standard deviation of the torques, N m or N.  [default: that of the residuals]")
@click.option("--trust", type=float, default=1.0, show_default=True, help="Weight of the model's own inertias.")
@click.option("--keep", multiple=True, metavar="LINK", help="A link whose inertia stays; may be given several times.")
@click.option("--transmission", type=click.Path(path_type=Path, dir_okay=False), help="Matrix of motor velocities by joint velocities, as .npy or text.")
@click.option("--cutoff", type=float, help="Bandwidth of the smoother of positions, Hz.  [default: by the likelihood]")
@click.option("--blocks", type=click.IntRange(4), default=20, show_default=True, help="Blocks of time for the intervals.")
@click.option("--held-out", type=click.FloatRange(0.0, 0.9), default=0.0, show_default=True, help="Share of a single log, at its end, that is not fitted but predicted.")
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes that read several logs.")
@click.option("--scheduler", metavar="ADDRESS", help="Of a Dask cluster, whose workers read the logs.")
@JSON
def identify(
    robot: Path,
    logs: tuple[Path, ...],
    floating_base: bool,
    output: Path | None,
    covariance: Path | None,
    folder: Path | None,
    fit: tuple[str, ...],
    noise: float | None,
    trust: float,
    keep: tuple[str, ...],
    transmission: Path | None,
    cutoff: float | None,
    blocks: int,
    held_out: float,
    workers: int,
    scheduler: str | None,
    as_json: bool,
) -> None:
    """Identify a robot's inertias from logs of measured motion and torques, with intervals.

    LOG: .npz with q, qd, qdd, tau and t, a row per state, in the order of joint_names if it has them; .csv or .parquet (needs polars) with columns time and JOINT.q, JOINT.qd,
    JOINT.qdd, JOINT.tau, or those of PlotJuggler and ROS; .mcap or a folder of rosbag2 with sensor_msgs/JointState (needs rosbags). Without velocities or accelerations positions are smoothed, which takes times. NaN in tau is a torque that was not
    measured. Several logs are accumulated one by one, so that memory does not grow with them. Identified inertias are ones that bodies can have.
    """
    if folder is not None:
        check_pages()
    scene, name, _, _ = _load(robot, floating_base)
    console = Console(stderr=True)
    settings: dict[str, Any] = {"fit": fit, "keep": keep, "blocks": blocks}
    with _typed_errors(), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if transmission is not None:
            settings["transmission"] = _matrix(transmission)
        smoothed = False
        if len(logs) == 1:
            log, smoothed = with_derivatives(read_log(logs[0], scene), str(logs[0]), cutoff)
            fitted = max(1, round((1.0 - held_out) * len(log["q"])))
            arrays = [log[key][:fitted] for key in ("q", "qd", "qdd", "tau")]
            times = log["time"][:fitted] if "time" in log else None
            found = scene.identify(*arrays, time=times, noise=noise, trust=trust, **settings)
        else:
            if held_out:
                raise BadInput("--held-out: found several logs; expected one")
            if "load" in fit:
                raise BadInput("--fit: found load with several logs, which takes two passes; expected one log, or others")
            found = _accumulated(scene, logs, (workers, scheduler), cutoff, settings).identify(noise=noise, trust=trust)
            log, fitted = read_log(logs[0], scene), 0
        if output is not None:
            found.scene.to_urdf(output, name=robot.stem)
        if covariance is not None:
            # savez would append a suffix to the name of a path.
            with covariance.open("wb") as stream:
                root: dict[str, Any] = {**found.parameter_covariance.arrays()}
                np.savez(stream, **root)
        pages = [] if folder is None else _report(name, scene, found, with_derivatives(log, str(logs[0]), cutoff)[0], fitted or len(log["q"]), folder)
    for text in dict.fromkeys(str(one.message) for one in caught if not issubclass(one.category, (DeprecationWarning, PendingDeprecationWarning))):
        terminal.line(console, f"warning: {_as_options(text)}", "yellow")
    if as_json:
        numbers = {field: getattr(found, field) for field in NUMBERS}
        low, high = found.interval()
        about = {"name": name, "links": scene.body_names, "smoothed": smoothed, "file": None if output is None else str(output)}
        base = {key: getattr(found.base, key) for key in ("names", "values", "deviations", "bias", "model")}
        echo_json(about | numbers | {"low": low, "high": high, "base": base, "pages": list(map(str, pages))})
        return
    _show(found, scene.body_names)
    click.echo(f"{name}: {found}")
    if smoothed:
        click.echo("velocities and accelerations are from the smoothed positions")
    for file in [*(one for one in (output, covariance) if one is not None), *pages]:
        click.echo(file)


def _matrix(path: Path) -> Any:
    try:
        return np.load(path, allow_pickle=False) if path.suffix == ".npy" else np.loadtxt(path, ndmin=2, delimiter="," if path.suffix == ".csv" else None)
    except (OSError, ValueError) as error:
        raise BadInput(f"--transmission: found {error}; expected a matrix as .npy, or as text") from None


def _accumulated(scene: Any, logs: tuple[Path, ...], where: tuple[int, str | None], cutoff: float | None, settings: dict[str, Any]) -> Accumulator:
    workers, scheduler = where
    if scheduler is None:
        return accumulate_logs(scene, logs, workers=workers, cutoff=cutoff, **settings)
    try:
        from distributed import Client
    except ImportError:
        raise BadInput("--scheduler: needs Dask; install it with: pip install distributed") from None
    try:
        with Client(scheduler, timeout=10) as client:  # type: ignore[no-untyped-call]
            return accumulate_logs(scene, logs, client=client, cutoff=cutoff, **settings)
    except OSError as error:
        raise of_scheduler(scheduler, error) from None


def of_scheduler(address: str, error: Exception) -> BadInput:
    """The error of a cluster that does not answer."""
    return BadInput(f"--scheduler: found {error} at {address!r}; expected the address of a Dask scheduler, for instance tcp://host:8786")


def _report(name: str, scene: Any, found: Identification, log: dict[str, Any], fitted: int, folder: Path) -> list[Path]:
    q, qd, qdd, tau = (log[key] for key in ("q", "qd", "qdd", "tau"))
    columns = found.columns
    before = predicted(columns, np.append(columns.own[columns.free].ravel(), [extra.model for extra in columns.extras]), q, qd, qdd)
    time = log.get("time", np.arange(len(q), dtype=float))
    page = IdentificationReport(False, name, scene, found, time, tau, found.torques(q, qd, qdd), before, fitted)
    return pipeline.write(REPORT, pipeline.collect(REPORT, page, Silent()), folder)


def _show(found: Identification, links: tuple[str, ...]) -> None:
    console = Console()
    low, high = found.interval()
    half = 0.5 * (high - low)
    marks, of_joints = found.marks()
    title = "Bodies about the link's origin, with intervals of 95 % (* the prior's: the data do not decide; ! reaches below zero)"
    for heads, entries in ((("m, kg", "m cx, kg m", "m cy", "m cz"), (0, 1, 2, 3)), (("Ixx, kg m^2", "Iyy", "Izz"), (4, 6, 9))):
        body = []
        for link, values, bars, mark in zip(links, found.parameters, half, marks, strict=True):
            body.append((escape(link), *(f"{values[at]:.3g} ± {bars[at]:.2g}{mark[at]}" for at in entries)))
        terminal.table(console, title, ("link", *heads), body, 1)
        title = ""
    motors = found.columns.motor_names
    each = [
        (escape(motor), *(f"{value:.3g}" for value in values), *(f"{of[motor]:.4g}{of_joints[kind][motor]}" if motor in of else "" for kind, of in found.joints.items()))
        for motor, *values in zip(motors, found.noise, found.before, found.after, strict=True)
    ]
    terminal.table(console, "Torques, rms", ("motor", "noise", "off before", "off after", *found.joints), each, 1)
