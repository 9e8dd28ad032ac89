"""The command `phipsi identify`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.markup import escape

from .._identify import JOINTS, Identification
from . import terminal
from .commands import JSON, FLOATING, BadInput, _load, _typed_errors, echo_json, group

NEEDED = ("q", "qd", "tau")


@group.command()
@click.argument("robot", metavar="ROBOT.urdf", type=click.Path(path_type=Path))
@click.argument("data", metavar="DATA.npz", type=click.Path(path_type=Path, dir_okay=False))
@FLOATING
@click.option("-o", "--output", type=click.Path(path_type=Path, dir_okay=False), help="Write the identified robot as a URDF.")
@click.option("--fit", type=click.Choice(JOINTS), multiple=True, help="Property of the joints to identify too; repeatable.")
@click.option("--noise", type=float, help="Standard deviation of the torques, N m or N.  [default: estimated from the residuals]")
@click.option("--trust", type=float, default=1.0, show_default=True, help="Weight of the parameters of the model.")
@click.option("--keep", multiple=True, metavar="LINK", help="Link whose inertia is not identified; repeatable.")
@JSON
def identify(
    robot: Path,
    data: Path,
    floating_base: bool,
    output: Path | None,
    fit: tuple[str, ...],
    noise: float | None,
    trust: float,
    keep: tuple[str, ...],
    as_json: bool,
) -> None:
    """Identify the inertial parameters of a robot from measured motion and torques.

    DATA.npz contains q, qd, qdd and tau with one row per measured state; without qdd it also contains times t, and
    qdd is computed from qd by differences. NaN in tau marks a torque that was not measured. The identified inertias
    are physically possible; parameters that the motion does not determine stay near those of the model.
    """
    scene, name, _, _ = _load(robot, floating_base)
    measured, by_differences = _read(data)
    with _typed_errors():
        found = scene.identify(**measured, fit=fit, noise=noise, trust=trust, keep=keep)  # type: ignore[arg-type]
        if output is not None:
            found.scene.to_urdf(output, name=robot.stem)
    if as_json:
        numbers = {field: getattr(found, field) for field in Identification._fields if field != "scene"}
        about = {"name": name, "links": scene.body_names, "by_differences": by_differences, "file": None if output is None else str(output)}
        echo_json(about | numbers)
        return
    _tell(found, scene.body_names, scene.joint_names, [scene.v_index(joint) for joint in scene.joint_names])
    states, unknowns = len(measured["q"]), 10 * (len(scene.body_names) - len(keep)) + sum(map(len, found.joints.values()))
    click.echo(f"{name}: {states} states determine {found.known} combinations of {unknowns} parameters; the others are those of the model")
    if by_differences:
        click.echo("accelerations were computed from qd by differences, because DATA.npz has no qdd")
    if output is not None:
        click.echo(output)


def _read(data: Path) -> tuple[dict[str, Any], bool]:
    """Arrays of a file, and whether accelerations were computed from joint velocities."""
    try:
        with np.load(data, allow_pickle=False) as archive:
            arrays = {name: np.asarray(archive[name], float) for name in archive.files if name in ("t", "q", "qd", "qdd", "tau")}
    except (OSError, ValueError, EOFError) as error:
        raise BadInput(f"DATA.npz: found {error}; expected an .npz with q, qd, qdd and tau") from None
    if missing := [name for name in NEEDED if name not in arrays]:
        raise BadInput(f"DATA.npz: found no {', '.join(missing)} in {str(data)!r}; expected q, qd, qdd (or t) and tau")
    times = arrays.pop("t", None)
    if "qdd" in arrays:
        return arrays, False
    rates = arrays["qd"]
    if times is None or times.ndim != 1 or rates.shape[:1] != times.shape or len(times) < 3 or not np.all(np.diff(times) > 0.0):
        raise BadInput("DATA.npz: found neither qdd nor ascending times t, (k,); expected one of them")
    return arrays | {"qdd": np.gradient(rates, times, axis=0)}, True


def _tell(found: Identification, links: tuple[str, ...], joints: tuple[str, ...], rows: list[slice]) -> None:
    console = Console()
    body = [
        (escape(link), f"{m:.4g}", f"{dm:.2g}", *(f"{value / m:.4g}" for value in h), *(f"{value:.4g}" for value in moments))
        for link, (m, *h), moments, dm in zip(links, found.parameters[:, :4], found.parameters[:, [4, 6, 9]], found.deviations[:, 0], strict=True)
    ]
    terminal.table(console, "Bodies (moments of inertia about the origin of the link)", ("link", "mass, kg", "+-", "x, m", "y", "z", "Ixx, kg m^2", "Iyy", "Izz"), body, 1)
    each = [
        (escape(joint), *(f"{np.sqrt(np.mean(values[at] ** 2)):.3g}" for values in (found.noise, found.before, found.after)),
         *(f"{of.get(joint, np.nan):.4g}" for of in found.joints.values()))
        for joint, at in zip(joints, rows, strict=True)
    ]  # fmt: skip
    terminal.table(console, "Torques, rms", ("joint", "noise", "residual before", "residual after", *found.joints), each, 1)
