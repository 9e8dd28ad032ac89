"""The command `phipsi codegen`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .._compile import FUNCTIONS, Function
from .commands import FLOATING, MIMIC, ROBOT, Mimic, _load, _typed_errors, group


#: Functions of one link, and the frames of a Jacobian.
OF_LINKS, FRAMES = ("placement", "jacobian"), ("local", "world", "local-world-aligned")
KNOWN = f"{', '.join(FUNCTIONS)}, placement:LINK, jacobian:LINK, jacobian:LINK:FRAME"


def _read(ctx: click.Context, param: click.Parameter, given: tuple[str, ...]) -> tuple[Function, ...]:
    """Functions by their names; of a link NAME:LINK, and jacobian:LINK:FRAME."""
    functions: list[Any] = []
    for said in given:
        name, colon, link = said.partition(":")
        before, _, frame = link.rpartition(":")
        if name in FUNCTIONS and not colon:
            functions.append(name)
        elif name == "jacobian" and before and frame in FRAMES:
            functions.append((name, before, frame))
        elif name in OF_LINKS and link:
            functions.append((name, link))
        else:
            raise click.BadParameter(f"{said!r} is none of {KNOWN}; FRAME is one of {', '.join(FRAMES)}.", ctx, param)
    return tuple(functions)


@group.command()
@ROBOT
@FLOATING
@MIMIC
@click.option("-o", "--output", "directory", type=click.Path(path_type=Path, file_okay=False), default=Path("generated"), show_default=True, help="Where the files go.")
@click.option("--lang", type=click.Choice(["c"]), default="c", show_default=True, help="The language: C99.")
@click.option("--name", default="robot", show_default=True, help="What files and functions begin with.")
@click.option(
    "--functions",
    "-f",
    callback=_read,
    multiple=True,
    help=f"What to write; again for more: {KNOWN}.  [default: all that are of no one link]",
)
@click.option("--float32", "is_single", is_flag=True, help="float in place of double.")
def codegen(
    robot: Path | None,
    floating_base: bool,
    mimic: Mimic,
    directory: Path,
    lang: str,
    name: str,
    functions: tuple[Function, ...],
    is_single: bool,
) -> None:
    """Write the dynamics of one robot as code that needs no library: sources, a header, a test with reference values, a Makefile.

    Without ROBOT.urdf, the bundled arm. `make test` in the directory compiles and runs the test.
    """
    del lang  # there is one
    scene, said, _, _ = _load(robot, floating_base, mimic)
    with _typed_errors():
        files = scene.to_c(directory, name=name, functions=functions or None, dtype="float32" if is_single else "float64")
    for file in files:
        click.echo(f"written: {directory / file}")
    click.echo(f"{said}: {scene.nv} degrees of freedom; make -C {directory} test")
