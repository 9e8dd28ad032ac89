"""The command `phipsi codegen`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .._functions import FUNCTIONS, Function
from ..errors import known_names
from .commands import FLOATING, MIMIC, ROBOT, Mimic, _load, group

#: Method that writes each language, and command that runs its test.
LANGUAGES = {
    "c": ("to_c", "make -C {} test"),
    "rust": ("to_rust", "cargo test --manifest-path {}/Cargo.toml"),
    "cuda": ("to_cuda", "make -C {0} test on a GPU, make -C {0} test-c without"),
}


#: Functions of one link, and frames of a Jacobian.
OF_LINKS, FRAMES = ("placement", "jacobian"), ("local", "world", "local-world-aligned")
KNOWN = f"{', '.join(FUNCTIONS)}, placement:LINK, jacobian:LINK, jacobian:LINK:FRAME"


def _read(ctx: click.Context, param: click.Parameter, given: tuple[str, ...]) -> tuple[Function, ...]:
    """Functions from their names; NAME:LINK for functions of a link, jacobian:LINK:FRAME for a Jacobian in a frame."""
    functions: list[Any] = []
    for text in given:
        name, colon, link = text.partition(":")
        before, _, frame = link.rpartition(":")
        if name in FUNCTIONS and not colon:
            functions.append(name)
        elif name == "jacobian" and before and frame in FRAMES:
            functions.append((name, before, frame))
        elif name in OF_LINKS and link:
            functions.append((name, link))
        else:
            raise click.BadParameter(f"found {text!r}; expected {KNOWN}; FRAME is one of {', '.join(FRAMES)}.", ctx, param)
    return tuple(functions)


@group.command()
@ROBOT
@FLOATING
@MIMIC
@click.option("-o", "--output", "directory", type=click.Path(path_type=Path, file_okay=False), default=Path("generated"), show_default=True, help="Output folder.")
@click.option("--lang", type=click.Choice(tuple(LANGUAGES)), default="c", show_default=True, help="Language: C99, Rust (no_std), or CUDA.")
@click.option("--name", default="robot", show_default=True, help="Prefix of the names of files and functions.")
@click.option(
    "--functions",
    "-f",
    callback=_read,
    multiple=True,
    help=f"Function to write; repeatable: {KNOWN}.  [default: all except those of one link]",
)
@click.option("--float32", "is_single", is_flag=True, help="float instead of double in C and CUDA; Rust code is generic.")
@click.option("--batches", is_flag=True, help="Write also functions for batches of states in C; Rust and CUDA code always has them.")
def codegen(
    robot: Path | None,
    floating_base: bool,
    mimic: Mimic | None,
    directory: Path,
    lang: str,
    name: str,
    functions: tuple[Function, ...],
    is_single: bool,
    batches: bool,
) -> None:
    """Write the dynamics of one robot as code without dependencies: sources, a test with reference values, and build
    files.

    Without ROBOT.urdf, the bundled arm is used. The last line of the output shows how to compile and run the test.
    """
    for flag, given, languages in (("--float32", is_single, ("c", "cuda")), ("--batches", batches, ("c",))):
        if given and lang not in languages:
            raise click.UsageError(f"{flag} is for --lang {' and '.join(languages)}, not {lang}.")
    options: dict[str, Any] = {"dtype": "float32"} if is_single else {}
    if batches:
        options["batches"] = True
    write, test = LANGUAGES[lang]
    scene, said, _, _ = _load(robot, floating_base, mimic)
    for _, link, *_ in (function for function in functions if isinstance(function, tuple)):
        if link not in scene.link_names:
            frames = f"jacobian:LINK:FRAME with a frame of {', '.join(FRAMES)}"
            raise click.BadParameter(f"found the link {link!r}; expected {known_names(link, scene.link_names)}; or {frames}", param_hint="'--functions' / '-f'")
    files = getattr(scene, write)(directory, name=name, functions=functions or None, **options)
    for file in files:
        click.echo(f"written: {directory / file}")
    click.echo(f"{said}: {scene.nv} degrees of freedom; {test.format(directory)}")
