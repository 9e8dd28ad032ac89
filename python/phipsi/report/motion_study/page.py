"""The motion report as one HTML page, and the same as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

from .. import tables
from ..figure import Plot
from ..style import CSS
from ..tables import Table
from ..text import escape
from . import figures, horizon, prose, sweep
from .collect import Study
from .plots import file_name
from .prose import flowed
from .reference import FAR
from .timing import BATCH


class Shown(NamedTuple):
    """A table, and the first of its columns that holds numbers."""

    table: Table
    numbers_from: int = 1


class Figure(NamedTuple):
    """A plot by its name, and what it shows and does not show."""

    name: str
    caption: str


Block: TypeAlias = "str | Shown | Figure"


class Section(NamedTuple):
    """A heading, and paragraphs, tables and figures in their order."""

    title: str
    blocks: Sequence[Block]


def _losses(study: Study) -> list[Block]:
    texts = [
        figures.explicit(study),
        prose.NO_INVARIANTS,
        figures.third_order(study),
        figures.adaptive_wins(study),
        *figures.beside_peers(study),
    ]
    if any(peer.program == "Pinocchio" for peer in study.peers):
        texts.append(flowed(prose.PINOCCHIO_TIME))
    if study.absent:
        texts.append(f"Not compared: {' '.join(study.absent)}")
    refused = [f"{result.case.name}: {text}" for result in study.results for text in result.refused]
    if refused:
        texts.append(f"Scenes that a peer does not take: {'; '.join(refused)}.")
    return [text for text in texts if text]


def _if_peers(study: Study, text: str) -> list[Block]:
    return [flowed(text)] if study.peers else []


def _horizon(study: Study) -> list[Block]:
    seen, first = study.horizon, study.results[0]
    agreed, there = figures.error_text(horizon.AGREED), figures.error_text(first.exact.error)
    return [
        flowed(prose.HORIZON, agreed=agreed, horizon=seen.end, end=first.case.time, there=there),
        Figure("horizon", flowed(prose.HORIZON_CAPTION, directions=horizon.DIRECTIONS, moved=horizon.MOVED)),
    ]


def _smooth(study: Study) -> list[Block]:
    pictures = [
        Figure(file_name(result), f"{result.case.name}: {result.case.what}; {result.case.time:g} s.") for result in study.smooth
    ]
    return [flowed(prose.SMOOTH), *_if_peers(study, prose.SMOOTH_PEERS), *pictures]


def _stiff(study: Study) -> list[Block]:
    return [
        flowed(prose.STIFF),
        Figure("work-precision-springs", flowed(prose.SPRINGS_CAPTION)),
        Figure("work-precision-other-stiff", flowed(prose.OTHERS_CAPTION)),
        *_if_peers(study, prose.MUJOCO_DAMPERS),
        figures.ringing(study),
        flowed(prose.LARGEST_STEP),
        Shown(figures.largest_steps(study)),
    ]


def _orders(study: Study) -> list[Block]:
    most = figures.error_text(sweep.RINGING[study.quick])
    return [
        prose.SMOOTH_ORDERS,
        Shown(figures.smooth_orders(study)),
        flowed(prose.STIFF_ORDERS),
        Shown(figures.stiff_orders(study)),
        flowed(prose.RATE_ORDERS),
        Shown(figures.stiff_orders(study, rates=True)),
        "Between soft and stiff, two rods with one spring:",
        Figure("stiffness", flowed(prose.STIFFNESS_CAPTION, far=FAR, most=most)),
    ]


def _drift(study: Study) -> list[Block]:
    return [
        Figure("drift", flowed(prose.DRIFT_CAPTION)),
        prose.DRIFT_ORDERS,
        Shown(figures.drift_orders(study)),
    ]


def sections(study: Study) -> list[Section]:
    """The page's."""
    return [
        Section("Where phipsi loses, and beside the peers", _losses(study)),
        Section("The scenes", [Shown(figures.scenes(study), 2)]),
        Section("How long motion can be compared", _horizon(study)),
        Section("Error against step and run time, smooth scenes", _smooth(study)),
        Section("The same on stiff scenes", _stiff(study)),
        Section("Order of convergence", _orders(study)),
        Section("Drift of energy and momentum", _drift(study)),
        Section("Time of a step", [flowed(prose.TIMES, batch=BATCH), Shown(figures.step_times(study))]),
        Section(
            "The references",
            [
                flowed(prose.REFERENCES, far=FAR),
                *_if_peers(study, prose.REFERENCES_PEERS),
                Shown(figures.references(study), 3),
            ],
        ),
        Section("How this was made", [_provenance(study)]),
    ]


def _provenance(study: Study) -> str:
    machine = study.machine
    commit = f", commit {machine['commit']}" if machine["commit"] else ""
    peers = ", ".join(study.versions) or "none"
    return (
        f"phipsi {machine['phipsi']}{commit}; {machine['cpu']}, {machine['os']}; NumPy {machine['numpy']}; peers: {peers};"
        f" {study.date}{'; quick: fewer steps, tolerances and springs' if study.quick else ''}. {flowed(prose.PROVENANCE)}"
    )


def html(study: Study, plots: Sequence[Plot]) -> str:
    """The whole page."""
    drawn = {plot.name: plot.svg for plot in plots}

    def block(one: Block) -> str:
        if isinstance(one, Shown):
            return tables.html(one.table, one.numbers_from)
        if isinstance(one, Figure):
            return f"<figure>{drawn[one.name]}<figcaption>{escape(one.caption)}</figcaption></figure>"
        return f"<p>{escape(one)}</p>"

    body = "".join(
        f"<section><h2>{escape(section.title)}</h2>{''.join(map(block, section.blocks))}</section>\n" for section in sections(study)
    )
    wide = "<style>body { max-width: 1280px; } section table { display: block; overflow-x: auto; }</style>"
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>phipsi motion report</title>\n<style>{CSS}</style>{wide}</head>\n<body>\n"
        "<header><h1>Motion</h1><p>Fixed-step and adaptive integrators on smooth and stiff scenes, against references far below the"
        " errors shown</p></header>"
        f"\n{body}<footer>all numbers are in <code>report.json</code> beside this page</footer>\n</body>\n</html>\n"
    )


def markdown(study: Study, plots: Sequence[Plot], stem: str) -> str:
    """The page as Markdown; plots are files beside it."""
    files = {plot.name: f"{stem}-{plot.name}.png" for plot in plots}

    def block(one: Block) -> str:
        if isinstance(one, Shown):
            return tables.markdown(one.table).rstrip("\n")
        if isinstance(one, Figure):
            return f"![{one.name.replace('-', ' ')}]({files[one.name]})\n\n{one.caption}"
        return one

    parts = ["# Motion", "This page is generated: `phipsi report --motion --markdown FILE`."]
    for section in sections(study):
        parts += [f"## {section.title}", *map(block, section.blocks)]
    return "\n\n".join(parts) + "\n"
