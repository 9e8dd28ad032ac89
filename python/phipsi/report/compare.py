"""The command `phipsi compare`: differences between two robots, on the terminal or as JSON."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from .._compare import Difference
from .._compare import compare as compared
from .commands import BEYOND, COUNT, FLOATING, JSON, MIMIC, SEED, Mimic, _load, check_pages, echo_json, group

#: A robot file.
FILE = click.Path(path_type=Path)


@group.command()
@click.argument("first", metavar="ROBOT.urdf", type=FILE)
@click.argument("second", metavar="OTHER.urdf", type=FILE)
@FLOATING
@MIMIC
@click.option("--states", type=COUNT, default=16, show_default=True, help="Number of random states.")
@SEED
@click.option("--report", "page", type=click.Path(path_type=Path, dir_okay=False), help="Write a page (.html) with both robots and all differences.")
@click.option("--tolerance", type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True), default=1e-9, show_default=True, help="Largest relative difference of equal numbers.")
@JSON
def compare(first: Path, second: Path, floating_base: bool, mimic: Mimic | None, states: int, seed: int, page: Path | None, tolerance: float, as_json: bool) -> None:
    """Compare two robots: joints, masses, frames, limits, and poses and dynamics at random states.

    Differences are listed from the base outward, so that the first one is often the cause of the others.

    Exit codes: 1, the robots differ; 2, invalid input.
    """
    if page is not None:
        check_pages()
    (one, first_name, _, _), (two, second_name, _, _) = (_load(path, floating_base, mimic) for path in (first, second))
    found = compared(one, two, states=states, seed=seed, tolerance=tolerance)
    if page is not None:
        found.report(page, names=(first_name, second_name))
    if as_json:
        echo_json({
            "same": found.same, "locked": found.locked, "note": found.note,
            **{part: [_plain(difference) for difference in getattr(found, part)] for part in ("properties", "poses", "dynamics")},
        })  # fmt: skip
    else:
        click.echo(str(found))
    if not found.same:
        raise SystemExit(BEYOND)


def _plain(difference: Difference) -> dict[str, object]:
    """A difference as JSON has it."""
    relative = difference.relative if np.isfinite(difference.relative) else None
    return difference._asdict() | {"relative": relative}
