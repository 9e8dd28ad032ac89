"""The commands of `phipsi`."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

import click
from rich.console import Console

from .. import __version__, _core, errors
from .._core import Scene
from .._install import need_pages
from .._load import load
from . import auto_cost, pipeline, sections, terminal
from .progress import Silent, reporter
from .robot import DENSE_CAP, Report
from .sections import accuracy, calls, growth, residuals
from .stability import STABILITY, Stability

#: Message of a command that Ctrl-C ends.
INTERRUPTED = "phipsi: interrupted."
#: Whether mimic joints are coupled.
Mimic: TypeAlias = Literal["couple", "free"]
#: Name of the bundled arm.
BUNDLED = "PUMA 560 (bundled)"

#: Exit codes.
BEYOND, BAD_INPUT = 1, 2


#: Exit code of a command that Ctrl-C ends, as in shells.
STOPPED = 130
#: Largest length of the first sentence of a command, so that none is cut.
LONGEST = 1000
#: Commands for the developers of phipsi.
OF_DEVELOPERS = ("check", "bench")


class BadInput(click.ClickException):
    """Invalid input; one line, exit code 2."""

    exit_code = BAD_INPUT


def _as_options(text: str) -> str:
    """A message in which keyword arguments of load are replaced by options of the commands."""
    text = re.sub(r"\bignore=\(([^)]*)\)", lambda found: " ".join(f"--ignore {name}" for name in re.findall(r"'(\w+)'", found[1])), text)
    text = re.sub(r"\bxacro_arguments=\{'(\w+)': \.\.\.\}", r"--xacro-argument \1=VALUE", text)
    return re.sub(r'\b(mimic|limits|check|contacts)="([\w-]+)"', r"--\1 \2", text.replace("strict=True", "--strict").replace("floating_base=True", "--floating-base"))


def _reading() -> dict[str, Any]:
    """Keywords of load from the options for reading a robot."""
    found = click.get_current_context().meta
    return {
        "strict": found.get(STRICT, False),
        "ignore": found.get(IGNORE, ()),
        "contacts": found.get(CONTACTS),
        "xacro_arguments": dict(found.get(XACRO_ARGUMENTS, ())),
    }


def _load(robot: Path | None, floating_base: bool, mimic: Mimic | None = None) -> tuple[Scene, str, str, list[str]]:
    """Scene, name, source and warnings; prints the first warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = load(
            _core.BUNDLED_ARM if robot is None else str(robot),
            floating_base=floating_base,
            mimic=mimic,
            **_reading(),
        )
    texts = [_as_options(str(one.message)) for one in caught]
    for text in [f"warning: {text}" for text in texts[:3]] + [f"and {len(texts) - 3} more warnings"] * (len(texts) > 3):
        terminal.line(Console(stderr=True), text, "yellow")
    if robot is None:
        return scene, BUNDLED, "assets/puma560.urdf, in the wheel", texts
    return scene, robot.stem, str(robot), texts


ROBOT = click.argument("robot", metavar="[ROBOT.urdf]", required=False, type=click.Path(path_type=Path))
#: Keys of the options for reading a robot in the context of a command.
STRICT, IGNORE, CONTACTS, XACRO_ARGUMENTS = (f"{__name__}.{name}" for name in ("strict", "ignore", "contacts", "xacro_arguments"))


def _keep(key: str) -> Callable[[click.Context, click.Parameter, Any], None]:
    """Callback that stores an option in the context."""
    return lambda context, _, value: context.meta.__setitem__(key, value)


def _pair(_: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    for value in values:
        if "=" not in value:
            raise click.BadParameter(f"found {value!r}; expected NAME=VALUE", param=parameter)
    pairs = tuple((name, value) for name, _, value in (one.partition("=") for one in values))
    click.get_current_context().meta[XACRO_ARGUMENTS] = pairs
    return pairs


def FLOATING(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options for reading a robot; only --floating-base is an argument of the command."""
    for option in (
        click.option("--xacro-argument", multiple=True, metavar="NAME=VALUE", expose_value=False, callback=_pair, help="Value of an <xacro:arg>; repeatable."),
        click.option("--ignore", multiple=True, metavar="PART", expose_value=False, callback=_keep(IGNORE), help="Part of a MuJoCo model to omit; repeatable."),
        click.option("--contacts", type=click.Choice(("all", "plane")), expose_value=False, callback=_keep(CONTACTS), help="Read shapes that touch: all of them, or only planes and links."),
        click.option("--strict", is_flag=True, expose_value=False, callback=_keep(STRICT), help="Raise an error instead of a warning."),
        click.option("--floating-base", is_flag=True, help="Add a free joint between the base and the root link."),
    ):
        command = option(command)
    return command


MIMIC = click.option(
    "--mimic", type=click.Choice(("couple", "free")), help="Whether joints of a URDF with <mimic> are coupled or free.  [default: free, with a warning]"
)
KEYFRAME = click.option("--keyframe", metavar="NAME", help="Keyframe of a MuJoCo model to start from: its positions and velocities.  [default: start of the file]")
SEED = click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the random states.")
COUNT = click.IntRange(1, 100_000)
JSON = click.option("--json", "as_json", is_flag=True, help="Print all values as JSON.")


def echo_json(found: Any) -> None:
    """Print results as JSON."""
    click.echo(json.dumps(pipeline.plain(found), indent=1, allow_nan=False, ensure_ascii=False))


class Commands(click.Group):
    """Commands in two lists, for users and for developers of phipsi. Ctrl-C and errors of the library end each with one
    sentence.
    """

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The first sentence of each command, on as many lines as it needs."""
        names = self.list_commands(ctx)
        width = max(map(len, names))
        for title, is_of_developers in (("Commands", False), ("Commands for developers of phipsi", True)):
            with formatter.section(title):
                shown = [name for name in names if (name in OF_DEVELOPERS) == is_of_developers]
                formatter.write_dl([(name.ljust(width), self.commands[name].get_short_help_str(LONGEST)) for name in shown])

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            terminal.line(Console(stderr=True), INTERRUPTED, "yellow")
            raise SystemExit(STOPPED) from None
        except BrokenPipeError:
            # The reader of the output has ended.
            raise
        except OSError as error:
            text = f"found {str(error.filename)!r} ({error.strerror}); expected a path that can be read or written" if error.filename else str(error)
            raise BadInput(text) from None
        except (errors.PhipsiError, ImportError) as error:
            raise BadInput(_as_options(" ".join(str(error).split()))) from None


@contextmanager
def folder(path: Path) -> Iterator[None]:
    """A folder for results, which is removed again if the work ends early and leaves it empty."""
    made = [one for one in (path, *path.parents) if not one.exists()]
    path.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        for one in made:
            if any(one.iterdir()):
                break
            one.rmdir()
        raise


def check_pages() -> None:
    """Raise BadInput if the packages for pages are not installed."""
    try:
        need_pages()
    except ImportError as error:
        raise BadInput(str(error)) from None


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="phipsi")
def group() -> None:
    """Robot dynamics: show and simulate robots, compute their dynamics, and measure accuracy and speed."""


@group.command()
@ROBOT
@click.option("-o", "--output", type=click.Path(path_type=Path, file_okay=False), help="Folder for the report.  [required]")
@FLOATING
@click.option("--quick", is_flag=True, help="Use fewer states and timings; takes a few seconds.")
@click.option("--states", "count", type=COUNT, help="Number of random states.  [default: 400, quick: 64]")
@SEED
@click.option("--stability", is_flag=True, help="Report on the extreme scenes instead of a robot.")
@JSON
@click.option("--motion", is_flag=True, hidden=True)
def report(
    robot: Path | None,
    output: Path | None,
    floating_base: bool,
    quick: bool,
    count: int | None,
    seed: int,
    stability: bool,
    as_json: bool,
    motion: bool,
) -> None:
    """Write a report on a robot: index.html, a self-contained page, and report.json.

    The first part describes the robot: motion, links and joints, limits and gravity torques, mass matrix, and the
    time of each call. The second part describes the computation: simplifications, error and run time of every
    method, checks of the theory, conditioning, the mass matrix from random forces, and the time as a function of the
    number of bodies. Without ROBOT.urdf, the bundled arm is used.

    With --stability, the report is on the extreme scenes instead: the error of every form and of dense algebra, in
    two norms, compared with the sensitivity of the problems.

    Exit codes: 1, a residual exceeds its bound (the report shows which one); 2, invalid input; 130, interrupted.
    """
    if motion:
        raise BadInput("--motion: found a request for the study of integrators; expected the repository of phipsi: run make motion there")
    if stability:
        if robot is not None or floating_base or count is not None:
            raise click.UsageError("--stability: found ROBOT.urdf, --floating-base or --states; expected none of them, because the scenes are fixed")
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output'.")
    check_pages()
    console = Console(stderr=True)
    if stability:
        with folder(output), reporter(console) as says:
            extreme = pipeline.collect(STABILITY, Stability(quick, seed), says)
            pages = pipeline.write(STABILITY, extreme, output, None, says)
        if as_json:
            echo_json(pipeline.to_json(STABILITY, extreme))
        else:
            click.echo("\n".join(map(str, pages)))
        return
    scene, name, source, texts = _load(robot, floating_base)
    with folder(output), reporter(console) as says:
        found = pipeline.collect(sections.ROBOT, Report(quick, name, source, scene, seed, count, texts), says)
        pages = pipeline.write(sections.ROBOT, found, output, None, says)
    if as_json:
        echo_json(pipeline.to_json(sections.ROBOT, found))
    else:
        click.echo(pages[0])
        terminal.summary(console, found)
    if not found.passed:
        terminal.line(console, f"residual exceeds its bound: {'; '.join(found.beyond)}", "bold red")
        raise SystemExit(BEYOND)


@group.command()
@ROBOT
@FLOATING
@click.option("--states", "count", type=COUNT, default=16, show_default=True, help="Number of random states.")
@SEED
@JSON
def check(robot: Path | None, floating_base: bool, count: int, seed: int, as_json: bool) -> None:
    """Check the identities of the theory on a robot.

    The identities are: factorization compared with faer's LDLT, operators compared with their definitions, M M^-1 =
    1, forward after inverse dynamics, and power. The bound is 64 eps times the number of degrees of freedom, or times
    cond(M) if an inverse is involved. Without ROBOT.urdf, the bundled arm is used.

    Exit codes: 1, a residual exceeds its bound; 2, invalid input, or a robot that cannot be checked.
    """
    console = Console(width=None if Console().is_terminal else 110)
    scene, name, _, _ = _load(robot, floating_base)
    about: dict[str, Any] = {"name": name, "states": count, "seed": seed}
    if scene.nv == 0:
        if as_json:
            echo_json(about | {"passed": True, "residuals": []})
        else:
            click.echo(f"{name}: 0 degrees of freedom, nothing to check")
        return
    drawn = Report(True, name, "", scene, seed, count)
    if scene.nv > DENSE_CAP:
        raise BadInput(f"scene: found {scene.nv} degrees of freedom; expected at most {DENSE_CAP}, because the check uses dense matrices")
    with reporter(Console(stderr=True)) as says:
        rows = residuals.residuals(scene, drawn.states, drawn.conditions, says)
    held = sum(row.passed for row in rows)
    if as_json:
        echo_json(about | {"passed": held == len(rows), "residuals": rows})
    else:
        terminal.residuals(console, rows)
        click.echo(f"{name}: {held} of {len(rows)} identities hold at {count} random states (seed {seed})")
    if held < len(rows):
        raise SystemExit(BEYOND)


@group.command()
@click.argument("robots", metavar="[ROBOT.urdf...]", nargs=-1, type=click.Path(path_type=Path))
@FLOATING
@click.option("--quick", is_flag=True, help="Use fewer timings.")
@SEED
@JSON
def bench(robots: tuple[Path, ...], floating_base: bool, quick: bool, seed: int, as_json: bool) -> None:
    """Measure the time of calls from Python, of each method in Rust, of form auto by kind of state, and by number of
    bodies.

    The first two measurements use the first ROBOT.urdf, or the bundled arm. The time of form auto relative to
    covariance is measured for every given robot, with a fixed and a free base; without a robot, for ur5, panda,
    anymal, g1 and talos if example-robot-data is installed, and for the bundled arm otherwise. The measurements are
    brief and use one thread; `cargo bench` and `make peers` in the repository are more accurate.
    """
    scene, name, _, _ = _load(robots[0] if robots else None, floating_base)
    drawn = Report(quick, name, "", scene, seed, 64)
    found: dict[str, Any] = {"name": name, "machine": drawn.machine, "calls": None, "accuracy": None}
    # Results are printed at once, or at the end as JSON.
    console = Console(quiet=as_json)
    if 0 < scene.nv <= DENSE_CAP:
        found["calls"] = calls.measured(scene, drawn.batch, quick, Silent())
        terminal.calls(console, f"{name}, random states, one thread", found["calls"])
        title = f"{name}, {drawn.effort.states} random states, Scene::evaluate in Rust, one state per call"
        found["accuracy"] = accuracy.accuracy(drawn, Silent())
        terminal.accuracy(console, title, found["accuracy"])
    elif not as_json:
        click.echo(f"{name}: {scene.nv} degrees of freedom; the methods are compared for 1 to {DENSE_CAP}")
    sources: Mapping[str, str | Path] = auto_cost.example_robots() or {BUNDLED: _core.BUNDLED_ARM}
    if robots:
        # Files with equal names in several folders are named by their paths.
        stems = [robot.stem for robot in robots]
        sources = {robot.stem if stems.count(robot.stem) == 1 else str(robot): robot for robot in robots}
    with reporter(Console(stderr=True)) as says:
        each = partial(says.each, "Form auto by kind of state")
        costs = found["auto"] = auto_cost.of_robots(sources, quick=quick, seed=seed, each=each, read=partial(load, **_reading()))
    if costs:
        terminal.auto_costs(console, costs)
    found["growth"] = growth.growth((7, 10, 100, 1000, 10_000), 5, Silent())
    terminal.growth(console, found["growth"])
    if as_json:
        echo_json(found)
        return
    click.echo("See also: cargo bench, make peers; phipsi report -o DIR for error against run time.")
