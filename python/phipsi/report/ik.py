"""The command `phipsi ik`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from .. import tasks
from .._pose import from_rpy
from .commands import JSON, BEYOND, FLOATING, KEYFRAME, MIMIC, BadInput, Mimic, _load, echo_json, group
from .motion import read_state
from .text import plural


@group.command()
@click.argument("robot", metavar="ROBOT.urdf", type=click.Path(path_type=Path))
@click.argument("link")
@FLOATING
@MIMIC
@click.option("--position", nargs=3, type=float, metavar="X Y Z", help="Target of the origin of the link, m.")
@click.option("--rpy", nargs=3, type=float, metavar="R P Y", help="Target orientation of the link, rad: Rz(Y) Ry(P) Rx(R).")
@click.option("--state", type=click.Path(path_type=Path, dir_okay=False), help="First starting configuration: JSON or npz with q.  [default: that of --keyframe]")
@KEYFRAME
@click.option("--starts", type=click.IntRange(1), default=100, show_default=True, help="Largest number of starting configurations.")
@click.option("--limits/--no-limits", default=True, help="Whether joints stay within their limits.")
@JSON
def ik(
    robot: Path,
    link: str,
    floating_base: bool,
    mimic: Mimic | None,
    position: tuple[float, float, float] | None,
    rpy: tuple[float, float, float] | None,
    state: Path | None,
    keyframe: str | None,
    starts: int,
    limits: bool,
    as_json: bool,
) -> None:
    """Find joint positions that place a LINK at a target.

    Exit codes: 1, the target was not reached (the nearest configuration is printed); 2, invalid input.
    """
    scene, name, _, _ = _load(robot, floating_base, mimic)
    if position is None and rpy is None:
        raise BadInput("--position, --rpy: found neither; expected at least one of them")
    q0 = read_state(state, scene, keyframe)["q"]
    wanted: list[Any] = []
    if position is not None:
        wanted.append(tasks.Position(link, position))
    if rpy is not None:
        wanted.append(tasks.Orientation(link, from_rpy(np.array(rpy))))
    found = scene.inverse_kinematics(wanted, q0, starts=starts, limits=limits)
    joints = {joint: found.q[scene.q_index(joint)] for joint in scene.joint_names}
    if as_json:
        about = {"name": name, "link": link, "joints": {joint: values[0] if len(values) == 1 else values for joint, values in joints.items()}}
        echo_json(about | found._asdict())
    else:
        for joint, values in joints.items():
            click.echo(f"{joint}: {' '.join(f'{value:.9g}' for value in values)}")
        said = "reached" if found.reached else "not reached"
        click.echo(f"{said}: error {found.position_error:.2g} m and {found.rotation_error:.2g} rad, after {plural(int(found.starts), 'start')} and {plural(int(found.iterations), 'iteration')}")
    if not found.reached:
        raise SystemExit(BEYOND)

