"""The motion report as one HTML page, and the same as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from .. import tables
from ..figure import Plot
from ..style import CSS
from ..tables import Table
from ..text import escape
from . import figures, horizon, sweep
from .collect import Study
from .plots import file_name
from .reference import FAR
from .runs import METHODS
from .timing import BATCH


class Shown(NamedTuple):
    """A table, and the first of its columns that holds numbers."""

    table: Table
    numbers_from: int = 1


class Figure(NamedTuple):
    """A plot by its name, and what it shows and does not show."""

    name: str
    caption: str


class Section(NamedTuple):
    """A heading, and paragraphs, tables and figures in their order."""

    title: str
    blocks: Sequence[str | Shown | Figure]


def _losses(study: Study) -> list[str | Shown | Figure]:
    springs = study.of("springs 1e9")
    failing = [method.name for method in METHODS if all(p.failure for p in springs.points[method.name])]
    texts = [
        f"Explicit methods fail on stiff springs unless the step follows them: on springs of 1e9 N m/rad {' and '.join(failing)} fail at every"
        " step tried. The implicit ones are stable at all of them, but do not follow what is faster than the step: a spring that rings is"
        " damped, and the error is then as large as the ringing until the step resolves it.",
        "No method keeps energy or momentum by construction; they drift by an amount that falls with the order.",
        figures.third_order(study),
        figures.adaptive_wins(study),
        *figures.beside_peers(study),
    ]
    if any(peer.program == "Pinocchio" for peer in study.peers):
        texts.append("Pinocchio's time is not shown: its integrators are a loop in Python here. Its aba in C++ is timed by `make peers`.")
    if study.absent:
        texts.append(f"Not compared: {' '.join(study.absent)}")
    refused = [f"{result.case.name}: {text}" for result in study.results for text in result.refused]
    if refused:
        texts.append(f"Scenes that a peer does not take: {'; '.join(refused)}.")
    return [text for text in texts if text]


def _horizon(study: Study) -> list[str | Shown | Figure]:
    seen, case = study.horizon, study.results[0].case
    return [
        f"The double pendulum is chaotic. Two references, DOP853 at a tolerance of 1e-13 and extrapolated rk4, agree to {horizon.AGREED:.0e} rad up to"
        f" {seen.end:g} s: no error can be told from the reference's own much beyond. The diagrams below end at {case.time:g} s, where they"
        f" agree to {figures.error_text(study.results[0].exact.error)} rad.",
        Figure(
            "horizon",
            f"Left: the largest of {horizon.DIRECTIONS} changes of the start by {horizon.MOVED:.0e} (position and rate together), and the difference of the"
            " references, which grows alike. Right: every method at one step; after an error of about 1 rad the curves say nothing. The horizon is of this"
            " start; another start has another.",
        ),
    ]


def _smooth(study: Study) -> list[str | Shown | Figure]:
    blocks: list[str | Shown | Figure] = [
        "Left, error against step: what the method does. Middle and right, error against run time: what it costs. Time is that of a step, the"
        " least of some turns, times the number of steps, on one thread: scene.simulate called from Python once for all steps, with its default"
        " form, and MuJoCo's mj_step in its own compiled loop, without constraints or contacts. MuJoCo takes states one by one, so that its points are the same in"
        " both. Pinocchio's integrators are a loop in Python here, whose time would say nothing of Pinocchio: it is on the left only. DOP853 and"
        " Radau are SciPy's, through scene.ode: their time is mostly Python's. What is not shown: threads, larger batches, float32.",
        "Without springs and damping implicit-euler is semi-implicit-euler, and MuJoCo's implicitfast is its Euler: their curves lie on each other.",
    ]
    for result in study.smooth:
        blocks.append(Figure(file_name(result), f"{result.case.name}: {result.case.what}; {result.case.time:g} s."))
    return blocks


def _stiff(study: Study) -> list[str | Shown | Figure]:
    return [
        "All stiff scenes but two start on the slow manifold: the springs are loaded as the slow motion will have them, so that nothing rings. There"
        " the implicit methods are right to their order at any step, for what they damp is not there. The struck springs start unloaded and ring; the"
        " dampers start at rest.",
        Figure(
            "work-precision-springs",
            "A pendulum of three rods, two of its joints with springs. What is stable lies on the curves of the smooth scenes. Crosses above the line are runs that failed: they diverged, or ended more than"
            " 1 rad away. Errors are of all joints; the stiff ones move little, so that the errors of the slow joint are what is seen.",
        ),
        Figure(
            "work-precision-other-stiff",
            "The same with springs that ring, dampers, masses over six decades, and armatures from a hundred times to none. MuJoCo takes dampers implicitly"
            " with Euler and implicitfast, springs never.",
        ),
        figures.ringing(study),
        "The largest step at which no run fails, of those tried, from 4 ms down by halves (2 ms where springs ring):",
        Shown(figures.largest_steps(study)),
    ]


def _orders(study: Study) -> list[str | Shown | Figure]:
    return [
        "Slopes of log error against log step over the three finest steps whose error is known. On smooth scenes:",
        Shown(figures.smooth_orders(study)),
        "On stiff scenes, between 1 ms and 0.5 ms, and after the stroke over the finest steps. A dash: no two (three) known errors there, most"
        " often because they fall below what the reference knows as soon as the run does not fail. Configurations:",
        Shown(figures.stiff_orders(study)),
        "Rates, where orders reduce for the Rosenbrock methods: the stiff joints' own rates are tiny, and what is left in them of the method's error falls"
        " slowly or not at all. That the Euler steps have order 2 here is owed to the start at rest.",
        Shown(figures.stiff_orders(study, rates=True)),
        "Between soft and stiff, two rods with one spring:",
        Figure(
            "stiffness",
            "h ω is how far the spring turns in a step of 1 ms. On the slow manifold the order of the configuration, which is that of the slow joint, holds at every"
            " stiffness. The order of the rates does not: for rosenbrock-3 it is no clear number from h ω of about 0.3 to 30 and 0 beyond, for rosenbrock-2 it dips"
            " between 10 and 100, though errors of this size are small. Where the spring rings, orders hold up to h ω of about 0.3; from about 2 on the Rosenbrock"
            " methods have order 0, for their error is the ringing that they damp; between, a single number may be anything, of either sign, since the error"
            " changes its sign there. Points beyond the axis are left out."
            f" Errors within {FAR:.0f} times the reference's are not shown either: rk4 passes from failing to less than that within a factor of two in the step."
            f" Springs beyond {figures.error_text(sweep.RINGING[study.quick])} N m/rad are not shown ringing, since a reference would take too long.",
        ),
    ]


def _drift(study: Study) -> list[str | Shown | Figure]:
    return [
        Figure(
            "drift",
            "The largest change over eleven instants of a run, over the largest kinetic energy or over the momentum's size; the grey area is"
            " rounding. It is not shown over long times.",
        ),
        "Slopes of log drift against log step over the three finest steps above rounding:",
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
        Section(
            "Time of a step",
            [f"A state alone, and after the stroke a state of a batch of {BATCH}.", Shown(figures.step_times(study))],
        ),
        Section(
            "The references",
            [
                "An error is the largest component of the difference of configurations on the manifold: joint angles, and for a free joint the vector and the rotation"
                " vector that move one body to the other; never components of quaternions. Rates are not in it. The reference's own error is taken to be its difference from a"
                f" solution of another kind, eps times the largest coordinate at least. An error is shown if it is {FAR:.0f} times that or more. Both solutions rest on"
                " the same accelerations: that these are right, the peers show, whose errors fall to the same reference, and the tests.",
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
        f" {study.date}{'; quick: fewer steps, tolerances and springs' if study.quick else ''}. Times are noisy where other programs share"
        " the machine; errors, orders and drifts are the same in every run."
    )


def html(study: Study, plots: Sequence[Plot]) -> str:
    """The whole page."""
    drawn = {plot.name: plot.svg for plot in plots}

    def block(one: str | Shown | Figure) -> str:
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
        "<header><h1>Motion</h1><p>Fixed-step and adaptive integrators on smooth and stiff scenes, against references far below the errors shown</p></header>"
        f"\n{body}<footer>all numbers are in <code>report.json</code> beside this page</footer>\n</body>\n</html>\n"
    )


def markdown(study: Study, plots: Sequence[Plot], stem: str) -> str:
    """The page as Markdown; plots are files beside it."""
    names = {plot.name for plot in plots}

    def block(one: str | Shown | Figure) -> str:
        if isinstance(one, Shown):
            return tables.markdown(one.table).rstrip("\n")
        if isinstance(one, Figure):
            assert one.name in names
            return f"![{one.name.replace('-', ' ')}]({stem}-{one.name}.png)\n\n{one.caption}"
        return one

    parts = ["# Motion", "This page is generated: `phipsi report --motion --markdown FILE`."]
    for section in sections(study):
        parts += [f"## {section.title}", *map(block, section.blocks)]
    return "\n\n".join(parts) + "\n"
