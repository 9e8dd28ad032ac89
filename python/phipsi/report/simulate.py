"""The command `phipsi simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console

from .. import errors
from .._motion import PD, Trajectory
from . import motion, pipeline
from .commands import BEYOND, FLOATING, ROBOT, BadInput, _load, _typed_errors, group
from .progress import Silent, reporter
from .run import RUN, Run
from .structure import tree_of
from .terminal import line

#: The exit code of a run that was stopped, as shells have it.
STOPPED = 130
METHODS = ("semi-implicit-euler", "rk4", "implicit-euler", "rosenbrock-2", "rosenbrock-3")
#: Rows of a trajectory, unless --record-every says otherwise.
ROWS = 2000


@group.command()
@ROBOT
@click.option("-o", "--output", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder for the results.")
@FLOATING
@click.option(
    "--state", type=click.Path(path_type=Path, dir_okay=False), help="The start: JSON or npz with q, qd, tau.  [default: neutral, at rest]"
)
@click.option("--time", "duration", type=float, default=2.0, show_default=True, help="How long, s.")
@click.option("--dt", type=float, default=1e-3, show_default=True, help="The step, s.")
@click.option("--method", type=click.Choice(METHODS), default="rk4", show_default=True, help="How steps are made.")
@click.option("--record-every", type=click.IntRange(1), help=f"A row after so many steps.  [default: about {ROWS} rows]")
@click.option("--hold", nargs=2, type=float, metavar="KP KD", help="Hold the start with a control law of these gains.")
@click.option("--csv", "table", is_flag=True, help="The trajectory as CSV, too.")
def simulate(
    robot: Path | None,
    output: Path,
    floating_base: bool,
    state: Path | None,
    duration: float,
    dt: float,
    method: Any,
    record_every: int | None,
    hold: tuple[float, float] | None,
    table: bool,
) -> None:
    """Simulate a robot: a page with the robot in motion and curves over time, and trajectory.npz.

    Damping, friction, stiffness and armature are those of the file. The state file has q, qd and tau (held throughout), each a
    list or, in JSON, a mapping from joint names: {"q": {"elbow": 0.5}}. Limits are reported, never enforced. Ctrl-C stops
    and writes what was computed. Without ROBOT.urdf, the bundled arm.

    Exit code 1: the motion diverged or a pivot was lost (what came before is written); 2: bad input; 130: stopped.
    """
    console = Console(stderr=True)
    scene, name, _, _ = _load(robot, floating_base)
    if not (np.isfinite(dt) and dt > 0.0 and np.isfinite(duration) and duration >= 0.0):
        raise BadInput(f"--time, --dt: found {duration} and {dt}; expected finite times, the step positive")
    if duration / dt > 1e12:
        raise BadInput(f"--dt: found {duration / dt:.1e} steps; expected at most 1e12")
    steps = round(duration / dt)
    every = record_every or max(1, steps // ROWS)
    code, path = 0, None
    with _typed_errors():
        start = motion.read_state(state, scene) if state is not None else {}
        q, qd = start.get("q", scene.neutral()), start.get("qd", np.zeros(scene.nv))
        if "q" not in start and scene.connection_names:
            # The nearest to neutral that closes the loops; a start that was given is taken as it is, or refused.
            closed = scene.project(q, qd)
            q, qd = closed.q, np.asarray(closed.qd)
        law = PD(hold[0], hold[1], q) if hold is not None else None
        output.mkdir(parents=True, exist_ok=True)
        try:
            with reporter(console) as says:
                path = scene.simulate(
                    q, qd, dt=dt, steps=steps, tau=start.get("tau"), method=method, record_every=every, pd=law,
                    progress=says.counter("Simulating"),
                )  # fmt: skip
        except errors.SimulationError as error:
            code, path = BEYOND, error.trajectory
            line(console, str(error), "bold red")
        except errors.SimulationInterrupted as stopped:
            code, path = STOPPED, stopped.trajectory
            line(console, str(stopped), "yellow")
        except MemoryError as error:
            raise BadInput(str(error)) from None
        files = motion.write(path, output, table=table)
        torque = np.zeros_like(path.qd) + start.get("tau", 0.0)
        if hold is not None:
            torque = torque + hold[0] * scene.difference(path.q, q) - hold[1] * path.qd
        files += pipeline.write(RUN, pipeline.collect(RUN, Run(False, name, path, tree_of(scene), torque), Silent()), output)
        for file in files:
            click.echo(file)
    _tell(name, path)
    if code:
        raise SystemExit(code)


def _tell(name: str, path: Trajectory) -> None:
    """The run in a line, and the limits that it broke."""
    total = path.energy().total
    click.echo(
        f"{name}: {path.steps} steps of {path.dt:g} s by {path.method}; "
        f"energy from {total[0]:.6g} to {total[-1]:.6g} J"
    )
    for found in path.violations():
        click.echo(
            f"beyond its limit: {found.joint}, {found.limit} {found.bound:g}, first at t = {found.time:g} s, "
            f"worst {found.worst:.4g} (not enforced)"
        )
