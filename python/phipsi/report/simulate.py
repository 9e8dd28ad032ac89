"""The command `phipsi simulate`."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console

from .. import errors
from .._core import Scene
from .._motion import PD, Trajectory
from . import motion, pipeline
from .commands import BEYOND, FLOATING, JSON, KEYFRAME, MIMIC, ROBOT, STOPPED, BadInput, Mimic, _as_options, _load, check_pages, echo_json, folder, group
from .progress import Silent, reporter
from .run import Run, layout, touches, unit
from .states import Array
from .structure import tree_of
from .terminal import line
from .text import plural

METHODS = ("auto", "semi-implicit-euler", "rk4", "dormand-prince-5", "implicit-euler", "rosenbrock-2", "rosenbrock-3")
#: The fields of an energy audit that are works.
WORKS = ("torque", "damping", "friction", "control", "stops", "contacts")
#: Number of rows of a trajectory without --record-every.
ROWS = 2000


@group.command()
@ROBOT
@click.option("-o", "--output", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder for the results.")
@FLOATING
@MIMIC
@click.option(
    "--state", type=click.Path(path_type=Path, dir_okay=False), help="Initial state: JSON or npz with q, qd, tau.  [default: that of --keyframe]"
)
@KEYFRAME
@click.option("--time", "duration", type=float, default=2.0, show_default=True, help="Duration, s.")
@click.option("--dt", type=float, default=1e-3, show_default=True, help="Step size, s.")
@click.option("--method", type=click.Choice(METHODS), default="auto", show_default=True, help="Integration method.")
@click.option("--limits", type=click.Choice(("stop", "report")), help="Whether joint limits are stops.  [default: stop]")
@click.option("--restitution", type=float, default=0.0, show_default=True, help="Coefficient of restitution of the stops.")
@click.option("--accuracy", type=float, help="Error control: largest estimated error of a substep, rad or m.")
@click.option("--record-every", type=click.IntRange(1), help=f"Number of steps per recorded row.  [default: about {ROWS} rows]")
@click.option("--hold", nargs=2, type=float, metavar="KP KD", help="Hold the initial position with a PD control law with these gains; free joints have no gains.")
@click.option(
    "--covariance", "unsure", type=click.Path(path_type=Path, dir_okay=False),
    help="Uncertainties, for error bands: JSON or npz with parameters, joints, initial, torque_noise. `phipsi identify --covariance` writes one.",
)
@click.option("--noise", type=float, help="Density of white torque noise, (N m)^2 s, for error bands.")
@click.option("--check", type=click.Choice(("unscented", "monte-carlo")), help="Compare the error bands with sampled simulations.")
@click.option("--csv", "table", is_flag=True, help="Write the trajectory also as CSV.")
@JSON
def simulate(
    robot: Path | None,
    output: Path,
    floating_base: bool,
    mimic: Mimic | None,
    state: Path | None,
    keyframe: str | None,
    duration: float,
    dt: float,
    method: Any,
    limits: Any,
    restitution: float,
    accuracy: float | None,
    record_every: int | None,
    hold: tuple[float, float] | None,
    unsure: Path | None,
    noise: float | None,
    check: str | None,
    table: bool,
    as_json: bool,
) -> None:
    """Simulate a robot; write a page with the robot in motion and curves over time, and trajectory.npz.

    Damping, friction, stiffness and armature are those of the file. The state file contains q, qd and tau (constant),
    each as a list or, in JSON, as a mapping from joint names: {"q": {"elbow": 0.5}}. Missing joints and keys
    are those of the keyframe, or of the start of the file. Controls of a keyframe are not applied. A state that violates the
    connections of a MuJoCo model is projected onto them. With --covariance or --noise, the page shows 95 % bands of the
    first-order error, and trajectory.npz contains standard deviations. The page reports the energy balance and the estimated error;
    a warning is printed if the integration error exceeds 1 % of the exchanged energy. Ctrl-C stops the simulation and
    writes the completed steps. Without ROBOT.urdf, the bundled arm is used.

    Exit codes: 1, the motion diverged or a joint became singular (the completed steps are written); 2, invalid input;
    130, interrupted.
    """
    check_pages()
    console = Console(stderr=True)
    scene, name, _, _ = _load(robot, floating_base, mimic)
    if not (np.isfinite(dt) and dt > 0.0 and np.isfinite(duration) and duration >= 0.0):
        raise BadInput(f"--time, --dt: found {duration} and {dt}; expected a finite duration and a finite positive step")
    if duration / dt > 1e12:
        raise BadInput(f"--dt: found {duration / dt:.1e} steps; expected at most 1e12")
    steps = round(duration / dt)
    every = record_every or max(1, steps // ROWS)
    code, path, said = 0, None, None
    with folder(output):
        start = motion.read_state(state, scene, keyframe)
        uncertainty = motion.read_uncertainty(unsure, noise, scene)
        if check is not None:
            if uncertainty is None:
                raise BadInput(f"--check: found {check} without uncertainties; expected --covariance or --noise")
            uncertainty = replace(uncertainty, check=check)
        q, qd = start["q"], start["qd"]
        if scene.loops.names:
            nearest = scene.loops.project(q, qd)
            q, qd = nearest.q, np.asarray(nearest.qd)
        law = PD(*_gains(scene, *hold), q) if hold is not None else None
        try:
            with reporter(console) as says, warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                path = scene.simulate(
                    q, qd, dt=dt, steps=steps, tau=start["tau"], method=method, record_every=every, pd=law,
                    limits=limits, restitution=restitution, accuracy=accuracy, progress=says.counter("Simulating"),
                    covariance=uncertainty,
                )  # fmt: skip
        except errors.SimulationError as error:
            code, path, said = BEYOND, error.trajectory, str(error)
            line(console, said, "bold red")
        except errors.SimulationInterrupted as stopped:
            code, path, said = STOPPED, stopped.trajectory, str(stopped)
            line(console, said, "yellow")
        except MemoryError as error:
            raise BadInput(str(error)) from None
        for text in dict.fromkeys(str(one.message) for one in caught):
            line(console, f"warning: {_as_options(text)}", "yellow")
        files = motion.write(path, output, table=table)
        torque = np.zeros_like(path.qd) + start["tau"]
        if hold is not None:
            kp, kd = _gains(scene, *hold)
            torque = torque + kp * scene.difference(path.q, q) - kd * path.qd
        run = Run(False, name, path, tree_of(scene), torque, _error(path) if code == 0 else None)
        page = layout(scene)
        files += pipeline.write(page, pipeline.collect(page, run, Silent()), output)
    if as_json:
        echo_json({"name": name, **_numbers(path), "error": said, "files": map(str, files)})
    else:
        for file in files:
            click.echo(file)
        _tell(name, path)
    if code:
        raise SystemExit(code)


def _gains(scene: Scene, kp: float, kd: float) -> tuple[Array, Array]:
    """Gains for all joints except free joints, which have no motor."""
    has_motor = np.ones(scene.nv)
    for joint in scene.joint_names:
        if scene.joints[joint].type == "floating":
            has_motor[scene.v_index(joint)] = 0.0
    return kp * has_motor, kd * has_motor


def _error(path: Trajectory) -> float | None:
    """Estimated error at the end, if available."""
    if path.estimated_error > 0.0 or path.contacts is not None:
        return None
    try:
        return float(path.error_estimate()[-1])
    except errors.PhipsiError:
        return None


def _numbers(path: Trajectory) -> dict[str, Any]:
    """Values of the simulation: final state, energy, exceeded limits."""
    energy = path.energy()
    about: dict[str, Any] = {"steps": path.steps, "dt": path.dt, "method": path.method, "t": path.t[-1], "q": path.q[-1], "qd": path.qd[-1]}
    about["energy"] = {name: values[[0, -1]] for name, values in (*energy._asdict().items(), ("total", energy.total))}
    if path.bands is not None:
        ratio = None if path.bands.ratio is None else path.bands.ratio[-1]
        about["deviation"] = {"q": path.bands.q[-1], "qd": path.bands.qd[-1], "ratio": ratio}
    about |= {"integrator": path.integrator, "substeps": path.substeps, "stops": path.stops, "energy_audit": path.energy_audit()._asdict()}
    return about | {"drift": path.drift.max(), "violations": path.violations(), "touching": touches(path)}


def _tell(name: str, path: Trajectory) -> None:
    """Print the simulation in one line, and the exceeded limits."""
    total, audit = path.energy().total, path.energy_audit()
    click.echo(
        f"{name}: {plural(path.steps, 'step')} of {path.dt:g} s by {path.integrator}; "
        f"energy from {total[0]:.6g} to {total[-1]:.6g} J"
    )
    works = {kind: float(getattr(audit, kind)) for kind in WORKS if getattr(audit, kind) != 0.0}
    if works:
        click.echo("work: " + ", ".join(f"{kind} {work:.4g} J" for kind, work in works.items()))
    if audit.relative_error > motion.SHARE:
        click.echo(
            f"warning: the integrator's error is {float(audit.remainder):.3g} J, {100 * float(audit.relative_error):.1f} % of the energy exchanged; use a smaller --dt{motion.or_control(path.scene, ' or --accuracy')}",
            err=True,
        )
    if path.bands is not None:
        click.echo(f"largest standard deviations at the end: {path.bands.q[-1].max():.3g} rad or m, {path.bands.qd[-1].max():.3g} rad/s or m/s")
        if (ratio := path.bands.ratio) is not None and not np.isnan(ratio[-1]).all():
            click.echo(f"sampled variance over variance of the bands, at the end: {np.nanmin(ratio[-1]):.3f} to {np.nanmax(ratio[-1]):.3f}")
    if path.stops:
        click.echo(f"{plural(len(path.stops), 'impact')} on joint stops, the first at {path.stops[0].joint}, t = {path.stops[0].time:.4g} s")
    if found := touches(path):
        click.echo(f"{plural(len(found), 'pair')} of shapes touched; largest force {found[0].largest_force:.4g} N: {found[0].first} on {found[0].second}")
    if path.scene.loops.names:
        click.echo(f"largest constraint error of the connections: {path.drift.max():.1e} m or rad")
    for one in path.violations():
        of = unit(path.scene, one.joint, one.limit)
        click.echo(f"limit exceeded: {one.joint}, {one.limit} {one.bound:g}{of}, first at t = {one.time:g} s, worst {one.worst:.4g}{of}")
