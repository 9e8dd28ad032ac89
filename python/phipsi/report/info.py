"""The command `phipsi info`: properties of a robot, on the terminal or as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.markup import escape

from .._core import Scene
from .._friction import TERMS
from . import terminal
from .commands import JSON, FLOATING, MIMIC, ROBOT, Mimic, _load, echo_json, group


@group.command()
@ROBOT
@FLOATING
@MIMIC
@JSON
def info(robot: Path | None, floating_base: bool, mimic: Mimic | None, as_json: bool) -> None:
    """Show the properties of a robot: its mass, its joints with their limits in the order of q, and its links.

    Without ROBOT.urdf, the bundled arm is used.
    """
    scene, name, _, texts = _load(robot, floating_base, mimic)
    found = about(scene) | {"name": name, "warnings": texts}
    if as_json:
        echo_json(found)
        return
    click.echo(f"{name}: {scene.nv} degrees of freedom ({scene.nq} coordinates), {len(scene.link_names)} links, {scene.total_mass:.4g} kg moving mass")
    if scene.keyframes:
        click.echo(f"keyframes: {', '.join(scene.keyframes)}")
    rows = [
        (
            escape(joint["name"]), joint["type"], escape(joint["child"]), _span(joint["q"]), joint["unit"],
            *(_number(joint[key]) for key in ("lower", "upper", "velocity", "effort")),
        )
        for joint in found["joints"]
    ]  # fmt: skip
    console = Console(width=None if Console().is_terminal else 110)
    heads = ("joint", "type", "child", "in q", "unit", "lower", "upper", "speed, unit/s", "effort, N m or N")
    terminal.table(console, "", heads, rows, 3)
    click.echo()
    links = [(escape(link.name), escape(link.joint or "-"), f"{link.mass:.4g}", *(f"{x:.4g}" for x in link.com)) for link in scene.links.values()]
    terminal.table(console, "", ("link", "joint", "mass, kg", "com x, m", "y", "z"), links, 2)


def about(scene: Scene) -> dict[str, Any]:
    """Counts, mass, gravity, and the movable joints in the order of q."""
    joints = scene.joints
    moving = [joints[name] for name in scene.joint_names]
    return {
        "file": None if scene.file is None else str(scene.file),
        "nq": scene.nq,
        "nv": scene.nv,
        "mass": scene.total_mass,
        "gravity": scene.gravity,
        "keyframes": scene.keyframes,
        "links": scene.link_names,
        "link_properties": [{"name": link.name, "parent": link.parent, "joint": link.joint, "mass": link.mass, "com": link.com} for link in scene.links.values()],
        "joints": [
            {
                "name": joint.name, "type": joint.type, "unit": _unit(joint.type), "parent": joint.parent, "child": joint.child,
                "q": _ends(scene.q_index(joint.name)), "v": _ends(scene.v_index(joint.name)),
                "lower": joint.lower, "upper": joint.upper, "velocity": joint.velocity, "effort": joint.effort,
                "armature": joint.armature, "damping": joint.damping, "friction": joint.friction, "stiffness": joint.stiffness,
                **{term: getattr(joint, term) for term in TERMS},
            }
            for joint in moving
        ],
    }  # fmt: skip


def _unit(kind: str) -> str:
    """Unit of the coordinates of a joint."""
    return {"prismatic": "m", "planar": "m, m, rad", "floating": "m, 1", "spherical": "1"}.get(kind, "rad")


def _ends(at: slice) -> tuple[int, int]:
    return at.start, at.stop


def _span(ends: tuple[int, int]) -> str:
    """First and last index, or the only one."""
    first, behind = ends
    return str(first) if behind == first + 1 else f"{first} to {behind - 1}"


def _number(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else "-"
