"""The command `phipsi view`."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from ..estimation._tables import by_names
from . import embed
from .commands import FLOATING, KEYFRAME, MIMIC, ROBOT, BadInput, Mimic, _load, group


@group.command()
@ROBOT
@FLOATING
@MIMIC
@KEYFRAME
@click.option("--motion", type=click.Path(path_type=Path, dir_okay=False), help="trajectory.npz of `phipsi simulate`, or another npz file with t and q.")
@click.option("-o", "--output", type=click.Path(path_type=Path, dir_okay=False), help="Write a self-contained page (.html) or a picture (.png, .webp) instead of starting a server.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port of the server.  [default: any free port]")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address of the server; 0.0.0.0 makes the viewer accessible from other machines.")
@click.option("--browser/--no-browser", default=True, help="Whether to open a browser.")
def view(robot: Path | None, floating_base: bool, mimic: Mimic | None, keyframe: str | None, motion: Path | None, output: Path | None, port: int, host: str, browser: bool) -> None:
    """Show a robot in the browser, with one slider per joint, or a trajectory with a play button.

    Meshes are read from the folder of the URDF, a package above it, or a folder of ROS_PACKAGE_PATH or
    AMENT_PREFIX_PATH. A robot without shapes is drawn as capsules that represent its inertia. The command runs until
    Ctrl-C. Without ROBOT.urdf, the bundled arm is used.
    """
    if (reason := embed.lacking()) is not None:
        raise BadInput(reason)
    scene, name, _, _ = _load(robot, floating_base, mimic)
    t = forces = None
    q = scene.initial(keyframe)
    if motion is not None:
        if keyframe is not None:
            raise BadInput("--keyframe: found a keyframe and --motion; expected one of them")
        try:
            with np.load(motion, allow_pickle=False) as archive:
                t, q, names = archive["t"], archive["q"], archive["joint_names"] if "joint_names" in archive else None
                if "force" in archive and archive["force"].shape[1]:
                    forces = archive["force_at"], archive["force"]
        except (OSError, ValueError, KeyError, EOFError) as error:
            raise BadInput(f"--motion: found {error}; expected an .npz with t, (k,), and q, (k, nq)") from None
        if names is not None:
            q = by_names("--motion", names, q, scene, True)
    if output is not None:
        click.echo(scene.show(q, t=t, forces=forces, to=output, title=name))
        return
    viewer = scene.show(q, t=t, forces=forces, port=port, host=host, title=name, browser=browser)
    click.echo(f"{name}: {viewer.url} (stop with Ctrl-C)")
    try:
        while not viewer._closed.wait(0.5):
            pass
    finally:
        viewer.close()
