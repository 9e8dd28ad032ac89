"""The stability report as one HTML page, and as the Markdown of docs/numerics.md."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from importlib import resources

from ... import scenes
from .. import tables
from ..figure import Plot
from ..style import CSS
from ..tables import Table
from ..text import escape, plural, scientific, time
from .collect import COVARIANCE, NOISE, ROOT, TIMED, Error, Point, Recursion, Stability, Worse, worse

#: The hand-written part, in Markdown.
TEMPLATE = "numerics.md.in"

CAPTIONS = {
    "error-against-tip-mass": "Eight links, the last one heavier and heavier.",
    "error-against-growth": "Eight links, each heavier than the one before it.",
    "error-against-links": "A nearly straight chain; nothing dense is formed beyond 1000 links.",
    "error-against-spin": "Twelve links, rates up to a million radians a second.",
    "error-against-lever": "Eight links, two of the joints further and further apart.",
    "error-against-run-time": (
        "One point a method; filled circles float64, hollow squares float32. A method without a point failed. Times are of one"
        " thread and one state, calls of Scene::evaluate in Rust (the dense methods: with faer), so that peers are not in this plot."
    ),
}


def _caption(found: Stability, plot: Plot) -> str:
    text = CAPTIONS[plot.name]
    if plot.name == "error-against-run-time":
        return text
    return f"{text} Each point is the worst of {len(found.seeds)} states; the grey area is below the sensitivity."


def _value(value: float) -> str:
    """A parameter, such as 1e12 or 0.1."""
    if value == 0.0 or 1e-2 <= value < 1e4:
        return f"{value:g}"
    exponent = math.floor(math.log10(value) + 1e-9)
    return f"{value / 10.0**exponent:g}e{exponent}"


def _error(value: float) -> str:
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e+")


def _numbers(found: Stability, points: Sequence[Point], of: Callable[[Error], float]) -> Table:
    """A row a point: what the problem allows, and the error of every method."""
    head = ("value", "state", "parameters", *found.methods, "root, float32", "covariance, float32")
    rows = []
    for point in points:
        kinds = point.sensitivity
        parameters = max(of(error) for kind, error in kinds.items() if kind != "state")
        errors = [of(point.errors[method, "float64"]) for method in found.methods]
        single = [of(point.errors[method, "float32"]) for method in (ROOT, COVARIANCE)]
        rows.append([_value(point.value), *map(_error, (of(kinds["state"]), parameters, *errors, *single))])
    return head, rows


def _worse_rows(found: Stability, method: str) -> Table:
    """A row a case, peer and norm: how often, and the state where the peer is furthest ahead."""
    grouped: dict[tuple[str, str, str], list[Worse]] = {}
    for row in worse(found, method):
        grouped.setdefault((row.point.name, row.peer, row.norm), []).append(row)
    rows = []
    for (name, peer, norm), group in grouped.items():
        compared = [
            point for point in found.points if point.name == name and point.errors[peer, "float64"].reason is None
        ]
        top = max(group, key=lambda row: math.inf if math.isnan(row.ours) else row.ours / max(row.theirs, 1e-18))
        numbers = map(_error, (top.ours, top.theirs, top.floor))
        rows.append([name, peer, norm, f"{len(group)} of {len(compared)}", _value(top.point.value), *numbers])
    return ("case", "peer", "norm", "states", "furthest at", "phipsi", "the peer", "sensitivity"), rows


def _worse_text(found: Stability, method: str) -> str:
    """A sentence on how the method stands beside the peers, by counts."""
    if not found.peers:
        return f"No peer was compared: the {method} stands beside dense algebra only."
    pairs = [
        (point.errors[method, "float64"], point.errors[peer.name, "float64"])
        for point in found.points
        for peer in found.peers
        if point.errors[peer.name, "float64"].reason is None
    ]
    number = len(worse(found, method))
    ahead = sum(
        ours < 0.5 * theirs and theirs > NOISE[norm]
        for mine, other in pairs
        for norm, ours, theirs in (
            ("max-norm", mine.norm, other.norm),
            ("components", mine.component, other.component),
        )
    )
    versions = ", ".join(dict.fromkeys(peer.version for peer in found.peers))
    return (
        f"Of {2 * len(pairs)} comparisons with {versions} (every case, value, state and peer, in two norms), the {method} has the"
        f" larger error in {number}: more than twice the peer's, above four times the sensitivity, and above"
        f" {NOISE['max-norm']:.0e} (max-norm) or {NOISE['components']:.0e} (component by component). It has less than half of the"
        f" peer's in {ahead}."
    )


def _absent_text(found: Stability) -> str:
    """Which programs were not compared, and why."""
    if not found.absent:
        return "Every peer that this report knows was compared."
    return " ".join(["Not compared:", *found.absent])


def _slower_text(found: Stability) -> str:
    """What the square-root form costs."""
    ratios = []
    for name, value in TIMED:
        by_method = {
            row.method: row.ns
            for row in found.timed
            if (row.name, row.value, row.precision) == (name, value, "float64")
        }
        ratios.append(by_method[ROOT] / by_method[COVARIANCE])
    return (
        f"It is slower: {min(ratios):.1f} to {max(ratios):.1f} times the time of the covariance form here. Times beside Pinocchio's in"
        " C++ are not in this report; `make peers` measures them."
    )


def _beyond(found: Stability) -> list[list[str]]:
    """Where the square-root form misses its aim, in either norm: how often, and the worst."""
    grouped: dict[tuple[str, float, str], list[tuple[float, float]]] = {}
    for point in found.points:
        error = point.errors[ROOT, "float64"]
        norm, component = max(1e-13, 20 * point.floor), max(1e-12, 20 * point.component_floor)
        if not error.norm <= norm:
            grouped.setdefault((point.name, point.value, "max-norm"), []).append((error.norm, norm))
        if not error.component <= component:
            grouped.setdefault((point.name, point.value, "components"), []).append((error.component, component))
    rows = []
    for (name, value, which), group in grouped.items():
        states = sum((point.name, point.value) == (name, value) for point in found.points)
        worst = max(group, key=lambda pair: pair[0] / pair[1])
        rows.append([name, _value(value), which, f"{len(group)} of {states}", _error(worst[0]), _error(worst[1])])
    return rows


BEYOND_HEAD = ("case", "value", "norm", "states", "worst error", "aim there")


def _recursion_rows(found: Stability) -> Table:
    """The worst point of each case for each quantity: the component furthest above what the problem allows."""

    def beyond(row: Recursion) -> float:
        ratio = row.error.component / max(row.sensitivity.component, 1e-15)
        return ratio if math.isfinite(ratio) else 0.0

    rows: dict[tuple[str, str], Recursion] = {}
    for row in found.recursions:
        key = (row.quantity, row.name)
        if not (row.error.component > 1e-13 or row.error.norm > 1e-14):
            continue
        if key not in rows or beyond(row) > beyond(rows[key]):
            rows[key] = row
    head = ("quantity", "case", "value", "max-norm", "sensitivity", "components", "sensitivity")
    return head, [
        [
            row.quantity, row.name, _value(row.value), _error(row.error.norm), _error(row.sensitivity.norm),
            _error(row.error.component), _error(row.sensitivity.component),
        ]
        for row in sorted(rows.values(), key=lambda row: row.quantity)
    ]  # fmt: skip


def _timed_rows(found: Stability) -> Table:
    head = ("case", "precision", "method", "time", "over covariance", "max-norm error")
    rows = []
    for name, value in TIMED:
        for precision in ("float64", "float32"):
            chosen = [row for row in found.timed if (row.name, row.value, row.precision) == (name, value, precision)]
            base = next(row.ns for row in chosen if row.method == COVARIANCE)
            rows += [
                [
                    f"{name}, {_value(value)}",
                    precision,
                    row.method,
                    time(row.ns),
                    f"{row.ns / base:.2f}",
                    _error(row.error.norm),
                ]
                for row in chosen
            ]
    return head, rows


def _failures(found: Stability) -> Table:
    counted: dict[tuple[str, str, str], list[str]] = {}
    for point in found.points:
        for (method, precision), error in point.errors.items():
            if error.reason:
                counted.setdefault((method, precision, error.reason), []).append(f"{point.name} {_value(point.value)}")
    head = ("method", "precision", "reason", "states", "such as")
    return head, [
        [method, precision, reason, str(len(where)), ", ".join(list(dict.fromkeys(where))[:3])]
        for (method, precision, reason), where in counted.items()
    ]


def _parameter(name: str) -> str:
    return scenes.extreme(name).parameter


# Markdown


def markdown(found: Stability, plots: Sequence[Plot], stem: str) -> str:
    """The page as Markdown: the template with the figures put in."""
    text = resources.files(__package__).joinpath(TEMPLATE).read_text(encoding="utf-8")
    cases = []
    for name in found.names:
        points = found.of(name)
        cases.append(
            f"### {name}\n\nValue: {_parameter(name)}. {plural(points[-1].nv, 'degree')} of freedom at the last value.\n"
        )
        cases.append("Max-norm:\n\n" + tables.markdown(_numbers(found, points, lambda error: error.norm)))
        cases.append("Component by component:\n\n" + tables.markdown(_numbers(found, points, lambda error: error.component)))
    pictures = {
        plot.name: f"![{plot.name.replace('-', ' ')}]({stem}-{plot.name}.png)\n\n{_caption(found, plot)}"
        for plot in plots
    }
    first = f"{_worse_text(found, ROOT)} {_absent_text(found)} {_slower_text(found)}"
    parts = {
        "worse-root": f"{first}\n\n" + tables.markdown(_worse_rows(found, ROOT)),
        "worse-covariance": _worse_text(found, COVARIANCE) + "\n\n" + tables.markdown(_worse_rows(found, COVARIANCE)),
        "beyond": tables.markdown((BEYOND_HEAD, _beyond(found))),
        "cases": "\n".join(cases),
        "recursions": tables.markdown(_recursion_rows(found)),
        "timed": tables.markdown(_timed_rows(found)),
        "failures": tables.markdown(_failures(found)),
        "singular": f"    {found.singular}",
        "provenance": _provenance(found),
        **pictures,
    }
    for key, value in parts.items():
        text = text.replace("{{" + key + "}}", value.rstrip("\n"))
    return text


def _provenance(found: Stability) -> str:
    machine = found.machine
    peers = ", ".join(dict.fromkeys(peer.version for peer in found.peers)) or "none"
    commit = f", commit {machine['commit']}" if machine["commit"] else ""
    return (
        f"phipsi {machine['phipsi']}{commit}; {machine['cpu']}, {machine['os']}; NumPy {machine['numpy']}; peers: {peers};"
        f" {found.date}; seeds {found.seeds[0]} to {found.seeds[-1]}{', quick' if found.quick else ''}."
    )


# HTML


def _summary(found: Stability) -> str:
    """The largest error of the two forms over all cases, as the keys at the top."""
    boxes = []
    for method in (ROOT, COVARIANCE):
        errors = [point.errors[method, "float64"] for point in found.points]
        worst = max((error.norm for error in errors if math.isfinite(error.norm)), default=math.nan)
        good = all(point.errors[method, "float64"].norm <= max(1e-13, 20 * point.floor) for point in found.points)
        text = f"largest max-norm error of the {method} over {plural(len(errors), 'state')} in float64"
        boxes.append((scientific(worst), text, good))
    beyond = len({row[0] for row in _beyond(found)})
    text = f"of {len(found.names)} cases where the square-root form misses its aim: 1e-13, component by component 1e-12, or 20 times the sensitivity"
    boxes.append((str(beyond), text, beyond == 0))
    cells = "".join(
        f'<div class="{"" if good else "bad"}"><strong>{top}</strong><span>{text}</span></div>'
        for top, text, good in boxes
    )
    return f'<div class="key">{cells}</div>'


def html(found: Stability, plots: Sequence[Plot]) -> str:
    """The whole page; where phipsi is worse than a peer comes first."""
    figures = "".join(
        f"<figure>{plot.svg}<figcaption>{escape(_caption(found, plot))}</figcaption></figure>" for plot in plots
    )
    first = f"{_worse_text(found, ROOT)} {_absent_text(found)} {_slower_text(found)}"
    sections = [
        (
            "Where phipsi is worse than a peer",
            f"<p>{escape(first)}</p>{tables.html(_worse_rows(found, ROOT), 4)}"
            f"<p>{escape(_worse_text(found, COVARIANCE))}</p>{tables.html(_worse_rows(found, COVARIANCE), 4)}",
        ),
        (
            "Where the square-root form misses its aim",
            "<p>The aim: 1e-13 in the max-norm and 1e-12 component by component, or 20 times the problem's own sensitivity"
            f" where that is larger.</p>{tables.html((BEYOND_HEAD, _beyond(found)), 3)}",
        ),
        (
            "Plots",
            "<p>The grey area is below the problem's sensitivity: the change of the exact answer when the numbers that describe"
            f" the problem move by one unit in the last place.</p>{figures}",
        ),
        ("Error against run time", tables.html(_timed_rows(found), 3)),
    ]
    for name in found.names:
        points = found.of(name)
        sections.append(
            (
                name,
                f"<p>Value: {escape(_parameter(name))}. Under <em>state</em> and <em>parameters</em> the sensitivity.</p>"
                f"<h3>Max-norm</h3>{tables.html(_numbers(found, points, lambda error: error.norm), 1)}"
                "<h3>Component by component</h3>"
                f"{tables.html(_numbers(found, points, lambda error: error.component), 1)}",
            )
        )
    sections += [
        (
            "Inverse dynamics, bias torque, mass matrix",
            "<p>The worst value of each case, where more than 1e-13 is lost in a component.</p>"
            + tables.html(_recursion_rows(found), 2),
        ),
        (
            "What failed",
            f"{tables.html(_failures(found), 99)}<p>The singular case raises: <code>{escape(found.singular)}</code></p>",
        ),
        ("How this was made", f"<p>{escape(_provenance(found))}</p>"),
    ]
    body = "".join(f"<section><h2>{escape(title)}</h2>{text}</section>\n" for title, text in sections)
    wide = "<style>body { max-width: 1280px; } section table { display: block; overflow-x: auto; }</style>"
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>phipsi stability report</title>\n<style>{CSS}</style>{wide}</head>\n<body>\n"
        "<header><h1>Stability</h1><p>Forward dynamics of extreme scenes, against double-double arithmetic</p></header>"
        f"{_summary(found)}\n{body}<footer>all numbers are in <code>stability.json</code> beside this page</footer>\n"
        "</body>\n</html>\n"
    )
