"""The command `phipsi identify`."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.markup import escape

from .._core import Scene
from ..estimation import Accumulator, accumulate_logs, read_log
from ..estimation._checks import shifted
from ..estimation._columns import KINDS
from ..estimation._identification import Identification
from ..estimation._logs import with_derivatives
from . import pipeline, terminal
from .commands import JSON, FLOATING, BadInput, _as_options, _load, check_pages, echo_json, group
from .identification import REPORT, IdentificationReport, force_unit, with_unit
from .progress import Silent

#: Fields of the result in the JSON.
NUMBERS = ("parameters", "deviations", "share", "joints", "joint_deviations", "joint_share", "noise", "before", "after", "known", "blocks", "states", "inflation", "clock_offset", "clock_deviation")


@group.command()
@click.argument("robot", metavar="ROBOT.urdf", type=click.Path(path_type=Path))
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=click.Path(path_type=Path))
@FLOATING
@click.option("-o", "--output", type=click.Path(path_type=Path, dir_okay=False), help="Write the robot with the estimates as a URDF.")
@click.option("--covariance", type=click.Path(path_type=Path, dir_okay=False), help="Write the covariance of the parameters of bodies and joints as .npz, for phipsi simulate --covariance.")
@click.option("--report", "folder", type=click.Path(path_type=Path, file_okay=False), help="Write a page about the identification into this folder.")
@click.option("--fit", type=click.Choice(KINDS), multiple=True, help="Of the joints, too; may be given several times.")
@click.option("--noise", type=float, help="Standard deviation of the torques, N m or N.  [default: that of the residuals]")
@click.option("--trust", "trusts", multiple=True, metavar="[LINK=]WEIGHT", help="Weight of the model's own inertias, or of that of a link; may be given for several links.  [default: 1]")
@click.option("--keep", multiple=True, metavar="LINK", help="A link whose inertia stays; may be given several times.")
@click.option("--transmission", type=click.Path(path_type=Path, dir_okay=False), help="Matrix of motor velocities by joint velocities, as .npy or text.")
@click.option("--lock", "locked", multiple=True, metavar="JOINT[=Q]", help="A joint that does not move, at Q in rad or m; may be given several times.  [default: its neutral position]")
@click.option("--joint", "joints", multiple=True, metavar="JOINT", help="A joint of the log; all others are locked; may be given several times.")
@click.option("--friction-speed", type=float, default=0.01, show_default=True, help="Speed below which friction is viscous, rad/s or m/s.")
@click.option("--stribeck-speed", type=float, default=0.1, show_default=True, help="Speed at which Stribeck friction has decreased to 1/e, rad/s or m/s.")
@click.option("--tau-delay", type=float, default=0.0, show_default=True, help="Delay of the torques relative to the positions, s.")
@click.option("--cutoff", type=float, help="Bandwidth of the smoother of positions and of the filter of torques, Hz.  [default: by likelihood and noise, printed]")
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
    trusts: tuple[str, ...],
    keep: tuple[str, ...],
    transmission: Path | None,
    locked: tuple[str, ...],
    joints: tuple[str, ...],
    friction_speed: float,
    stribeck_speed: float,
    tau_delay: float,
    cutoff: float | None,
    blocks: int,
    held_out: float,
    workers: int,
    scheduler: str | None,
    as_json: bool,
) -> None:
    """Identify a robot's inertias from logs of measured motion and torques, with intervals.

    LOG: .npz with q, qd, qdd, tau and t, a row per state, in the order of joint_names if it has them; .csv, or .parquet (needs polars), with columns time and JOINT.q, JOINT.qd,
    JOINT.qdd, JOINT.tau, or those of PlotJuggler and ROS; .mcap or a folder of rosbag2 with sensor_msgs/JointState (needs rosbags). Without velocities or accelerations positions are smoothed, which takes times, and torques pass the same filter; the noise of the accelerations then predicts the bias of the estimates. --joint and --lock are for logs of some of the joints, such as the arm of a mobile manipulator. NaN in tau is a torque that was not
    measured. Several logs are accumulated one by one, so that memory does not grow with them. Identified inertias are ones that bodies can have.
    """
    if folder is not None:
        check_pages()
    scene, name, _, _ = _load(robot, floating_base)
    scene = _locked(scene, locked, joints)
    console, trust = Console(stderr=True), _trust(trusts)
    settings: dict[str, Any] = {"fit": fit, "keep": keep, "blocks": blocks, "friction_speed": friction_speed, "stribeck_speed": stribeck_speed, "tau_delay": tau_delay}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if transmission is not None:
            settings["transmission"] = _matrix(transmission)
        log, smoothed = with_derivatives(read_log(logs[0], scene), str(logs[0]), cutoff)
        fitted = len(log["q"])
        if len(logs) == 1:
            fitted = max(1, round((1.0 - held_out) * fitted))
            arrays = [log[key][:fitted] for key in ("q", "qd", "qdd", "tau")]
            times = log["time"][:fitted] if "time" in log else None
            noisy = None if smoothed is None else smoothed.acceleration_noise
            found = scene.identify(*arrays, time=times, noise=noise, trust=trust, acceleration_noise=noisy, **settings)
        else:
            if held_out:
                raise BadInput("--held-out: found several logs; expected one")
            if "load" in fit:
                raise BadInput("--fit: found load with several logs, which takes two passes; expected one log, or others")
            # All logs pass the filter of the first one.
            used = None if smoothed is None else smoothed.cutoff
            found = _accumulated(scene, logs, (workers, scheduler), used, settings).identify(noise=noise, trust=trust)
        if output is not None:
            found.scene.to_urdf(output, name=robot.stem)
        if covariance is not None:
            # savez would append a suffix to the name of a path.
            with covariance.open("wb") as stream:
                root: dict[str, Any] = {**found.parameter_covariance.arrays()}
                np.savez(stream, **root)
        shown = _shown(name, found, log, fitted, tau_delay)
        pages = [] if folder is None else pipeline.write(REPORT, pipeline.collect(REPORT, shown, Silent()), folder)
    for text in dict.fromkeys(str(one.message) for one in caught if not issubclass(one.category, (DeprecationWarning, PendingDeprecationWarning))):
        terminal.line(console, f"warning: {_as_options(text)}", "yellow")
    if as_json:
        numbers = {field: getattr(found, field) for field in NUMBERS}
        low, high = found.interval()
        about = {"name": name, "links": scene.body_names, "smoothed": smoothed is not None, "file": None if output is None else str(output)}
        about |= {"cutoff": None if smoothed is None else smoothed.cutoff, "explained": shown.explained(slice(0, fitted))}
        about |= {"explained_held_out": shown.explained(slice(fitted, None)) if held_out else None}
        base = {key: getattr(found.base, key) for key in ("names", "values", "deviations", "bias", "model")}
        echo_json(about | numbers | {"low": low, "high": high, "base": base, "pages": list(map(str, pages))})
        return
    _show(found, scene.body_names, shown)
    click.echo(f"{name}: {found}")
    if smoothed is not None:
        hertz = ", ".join(f"{joint} {value:.3g}" for joint, value in zip(_axes(scene), smoothed.cutoff, strict=True))
        click.echo(f"velocities and accelerations are from the smoothed positions, with a bandwidth in Hz of {hertz}; torques at {smoothed.cutoff.max():.3g} Hz")
    for file in [*(one for one in (output, covariance) if one is not None), *pages]:
        click.echo(file)


def _trust(given: tuple[str, ...]) -> float | dict[str, float]:
    """One weight, or weights by link."""
    named = dict(one.rpartition("=")[::2] for one in given)
    try:
        weights = {link: float(weight) for link, weight in named.items()}
        if "" in weights and len(given) > 1:
            raise ValueError
    except ValueError:
        raise BadInput(f"--trust: found {', '.join(given)}; expected one number, or LINK=NUMBER for each of some links") from None
    return weights.get("", 1.0) if "" in weights or not weights else weights


def _matrix(path: Path) -> Any:
    try:
        return np.load(path, allow_pickle=False) if path.suffix == ".npy" else np.loadtxt(path, ndmin=2, delimiter="," if path.suffix == ".csv" else None)
    except (OSError, ValueError) as error:
        raise BadInput(f"--transmission: found {error}; expected a matrix as .npy, or as text") from None


def _accumulated(scene: Scene, logs: tuple[Path, ...], where: tuple[int, str | None], cutoff: Any, settings: dict[str, Any]) -> Accumulator:
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


def _locked(scene: Scene, locked: tuple[str, ...], joints: tuple[str, ...]) -> Scene:
    """The scene with locked joints: those of --lock, and all but those of --joint."""
    places = dict(one.partition("=")[::2] for one in locked)
    for option, names in (("--lock", tuple(places)), ("--joint", joints)):
        if unknown := [joint for joint in names if joint not in scene.joint_names]:
            raise BadInput(f"{option}: found {unknown[0]!r}; expected one of {', '.join(scene.joint_names)}")
    if both := [joint for joint in joints if joint in places]:
        raise BadInput(f"--lock: found {both[0]!r}, which --joint names too; expected one of them")
    still = [joint for joint in scene.joint_names if joint in places or (joints and joint not in joints)]
    q = scene.neutral()
    for joint, value in places.items():
        at = scene.q_index(joint)
        if not value:
            continue
        try:
            if at.stop - at.start != 1:
                raise ValueError
            q[at.start] = float(value)
        except ValueError:
            raise BadInput(f"--lock: found {value!r} for {joint!r}; expected a number, rad or m, of a joint of one axis") from None
    return scene.lock(still, q) if still else scene


def _axes(scene: Scene) -> list[str]:
    """Names of the coordinates of q."""
    of = {joint: scene.q_index(joint) for joint in scene.joint_names}
    return [joint if at.stop - at.start == 1 else f"{joint}[{row}]" for joint, at in of.items() for row in range(at.stop - at.start)]


def _shown(name: str, found: Identification, log: dict[str, Any], fitted: int, delay: float) -> IdentificationReport:
    """The identification and the first log, with predicted torques."""
    q, qd, qdd, tau = (log[key] for key in ("q", "qd", "qdd", "tau"))
    if delay:
        tau = shifted(tau, log["time"], delay)
    return IdentificationReport.of(name, found, (q, qd, qdd, tau), log.get("time"), fitted)


def _show(found: Identification, links: tuple[str, ...], shown: IdentificationReport) -> None:
    console = Console()
    low, high = found.interval()
    half = 0.5 * (high - low)
    marks, of_joints = found.marks()
    title = "Bodies about the link's origin, with intervals of 95 % (* the prior's: the data do not decide; ! reaches below zero)"
    for heads, entries in ((("m, kg", "m cx, kg m", "m cy, kg m", "m cz, kg m"), (0, 1, 2, 3)), (("Ixx, kg m^2", "Iyy, kg m^2", "Izz, kg m^2"), (4, 6, 9))):
        body = []
        for link, values, bars, mark in zip(links, found.parameters, half, marks, strict=True):
            body.append((escape(link), *(f"{values[at]:.3g} ± {bars[at]:.2g}{mark[at]}" for at in entries)))
        terminal.table(console, title, ("link", *heads), body, 1)
        title = ""
    motors = found.columns.motor_names
    torque = force_unit(found.scene, motors)
    shares, explained = ["explained"], [shown.explained(slice(0, shown.held_out))]
    if shown.held_out < len(shown.time):
        shares.append("held out")
        explained.append(shown.explained(slice(shown.held_out, None)))
    each = [(escape(motor), *(f"{value:.3g}" for value in values)) for motor, *values in zip(motors, found.noise, found.before, found.after, *explained, strict=True)]
    terminal.table(console, "Torques: rms, and explained share of their variance", ("motor", f"noise, {torque}", f"off before, {torque}", f"off after, {torque}", *shares), each, 1)
    if found.joints:
        names = dict.fromkeys([*motors, *(name for of in found.joints.values() for name in of)])
        each = [
            (escape(name), *(f"{of[name]:.4g} ± {2 * found.joint_deviations[kind][name]:.2g}{of_joints[kind][name]}" if name in of else "" for kind, of in found.joints.items()))
            for name in names
        ]
        terminal.table(console, "Motors and joints, with two standard deviations", ("name", *(with_unit(found.scene, kind, list(of)) for kind, of in found.joints.items())), each, 1)
