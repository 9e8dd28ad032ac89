"""The parts of the page, each from the figures of the report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .. import _core
from . import kinds, measure
from .collect import Report
from .draw import FREE, MERGED, SLIDE, TURN
from .left_out import TURNS, name_of
from .measure import EPS, OperatorGrowth, Residual
from .plots import colour
from .prose import LIMITS
from .structure import Row
from .timing import TURNS as CALL_TURNS
from .text import count, escape, plural, power, scientific, significant, symbols, time

AUTO = _core.METHODS[0]
#: A tree with more rows than this is cut short.
MOST_ROWS = 400


def note(text: str) -> str:
    """Why a part is missing."""
    return f'<p class="note">Not here: {escape(text)}</p>'


def figure(svg: str, caption: str) -> str:
    return f"<figure>{svg}<figcaption>{caption}</figcaption></figure>"


def _facts(pairs: list[tuple[str, str]]) -> str:
    return f'<dl class="facts">{"".join(f"<dt>{key}</dt><dd>{value}</dd>" for key, value in pairs)}</dl>'


def scene(report: Report, skeleton: str, caption: str) -> str:
    """Facts, the figure and the tree."""
    scene, tree = report.scene, report.tree
    kinds = ", ".join(f"{number} {kind}" for kind, number in tree.kinds().items()) or "none"
    fixed = sum(joint.fixed for joint in tree.joints.values())
    gravity = ", ".join(f"{g:g}" for g in scene.gravity)
    facts = [
        ("joints that move", kinds),
        ("fixed joints, merged", count(fixed)),
        ("coordinates", f"{count(scene.nq)} (q), {count(scene.nv)} (qd)"),
        ("links given", count(scene.plan().links)),
        ("moving bodies", count(scene.plan().bodies)),
        ("total mass", f"{significant(tree.mass, 4)} kg"),
        ("gravity", f"({gravity}) m/s²".replace("-", "−")),
        ("source", f"<code>{escape(Path(report.source).name)}</code>"),
    ]
    key = (
        f"Drawn {caption}, seen from slightly above. Dark: links between joints that move; grey: what fixed joints"
        f" add; {_swatch(TURN)}axis of a turning joint, {_swatch(SLIDE)}of a sliding one, {_swatch(FREE)}joint of"
        f" several degrees of freedom; {_swatch('#f8dda6')}mass centre of a link, area as its mass."
    )
    return _facts(facts) + _warnings(report) + figure(skeleton, key) + _tree(report)


def _swatch(ink: str) -> str:
    return f'<span class="swatch" style="background:{ink}"></span>'


def _warnings(report: Report) -> str:
    if not report.warnings:
        return ""
    shown = "".join(f"<br>{escape(text)}" for text in report.warnings[:4])
    more = f"<br>and {len(report.warnings) - 4} more, in report.json" if len(report.warnings) > 4 else ""
    return (
        f'<p class="note small"><strong>{plural(len(report.warnings), "warning")} on reading:</strong>{shown}{more}</p>'
    )


def _tree(report: Report) -> str:
    rows = list(report.tree.rows())
    shown = rows[:MOST_ROWS]
    movable = sum(not row.joint.fixed for row in rows)
    short = " short" if len(shown) <= 14 else ""
    more = f'<p class="soft">and {count(len(rows) - MOST_ROWS)} more joints</p>' if len(rows) > MOST_ROWS else ""
    text = (
        f"<p class='soft small'>{plural(movable, 'joint')} that move and {count(len(rows) - movable)} fixed (grey),"
        " base to tip: a joint hangs on the one above it; with a tick, on the one where the line begins.</p>"
    )
    return (
        f'<h3>Tree of joints</h3>{text}<div class="tree{short}">{_root(report)}{"".join(map(_row, shown))}</div>{more}'
    )


def _root(report: Report) -> str:
    tree = report.tree
    mass = tree.links[tree.root].mass if tree.root in tree.links else 0.0
    weight = f"{significant(mass)} kg" if mass > 0.0 else ""
    return f'<div><span class="dot square"></span><b>{escape(tree.root)}</b><em>{weight}</em></div>'


def _row(row: Row) -> str:
    joint = row.joint
    ink = MERGED if joint.fixed else {"prismatic": SLIDE}.get(joint.kind, TURN)
    ink = FREE if joint.kind in ("floating", "planar", "spherical") else ink
    mass = f"{significant(row.link.mass, 3)} kg" if row.link.mass > 0.0 else ""
    kind = "" if joint.fixed else f"{joint.kind}{_axis(row)}"
    details = " · ".join(text for text in (kind, mass) if text)
    title = escape(f"{joint.name}: {joint.kind}, {joint.parent} to {joint.child}")
    rails = "<i></i>" * (min(row.level, 12) - row.branch) + '<i class="tick"></i>' * row.branch
    return (
        f'<div{" class=fixed" if joint.fixed else ""} title="{title}">{rails}<span class="dot" style="color:{ink}"></span>'
        f"<b>{escape(joint.name)}</b>{_link(row)}<em>{details}</em></div>"
    )


def _link(row: Row) -> str:
    return f"<u>{escape(row.joint.child)}</u>"


def _axis(row: Row) -> str:
    """The axis by its letter where it is one of the frame's."""
    if row.joint.kind not in ("revolute", "continuous", "prismatic", "screw"):
        return ""
    axis = row.joint.axis / (float(np.linalg.norm(row.joint.axis)) or 1.0)
    at = int(np.argmax(np.abs(axis)))
    if abs(abs(axis[at]) - 1.0) > 1e-9:
        return " skew"
    return f" {'−' if axis[at] < 0 else ''}{'xyz'[at]}"


def plan(report: Report) -> str:
    """What was not computed, and why that changes nothing."""
    plan = report.scene.plan()
    intro = f"<p>{plural(plan.links, 'link')} given, {plural(plan.bodies, 'body', 'bodies')} visited by the sweeps.</p>"
    if not plan.items:
        return f"{intro}<p>Nothing could be left out.</p>"
    rows = "".join(
        f"<tr><td>{escape(symbols(item.what))}{_names(item.names)}</td><td class=n>{count(item.count)}</td>"
        f"<td>{escape(symbols(item.why))}</td><td>{escape(symbols(item.saved))}</td>"
        f"<td class=n>{count(item.operations) if item.operations else ''}</td>{_times(report, name_of(item))}</tr>"
        for item in plan.items
    )
    head = (
        "<tr><th>left out</th><th class=n>how many</th><th>why the results are the same</th><th>what it saves</th>"
        "<th class=n>operations</th><th class=n>call</th><th class=n>not left out</th></tr>"
    )
    note = (
        "<p class=small>Operations: what forward dynamics of one state in covariance form does less, where it needs nothing of "
        f"this; a product with a sum is two; in 6-vectors, but for the row of planar scenes. Times: of the same, "
        "<code>forward_dynamics(q, qd, tau, form=\"covariance\")</code> from Python over all states in one call, on one thread, each divided by the"
        " number of states; of calls that share q, a right side of factor.solve beside forward dynamics; of a joint that moves alone, factor.update beside a "
        f"new factor, call by call. Medians of {TURNS} in turns; what is smaller than their noise says nothing.</p>"
    )
    return f"{intro}<table>{head}{rows}</table>{note}"


def _times(report: Report, name: str) -> str:
    times = report.left_out.get(name)
    return f"<td class=n>{time(times.on)}</td><td class=n>{time(times.off)}</td>" if times else "<td></td><td></td>"


def _names(names: tuple[str, ...]) -> str:
    if not names:
        return ""
    text = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
    return f'<br><span class="soft small">{escape(text)}</span>'


def residuals(report: Report) -> str:
    """Every identity, its residual and its bound."""
    if "residuals" in report.missing:
        return note(report.missing["residuals"])
    intro = (
        f"<p>Each identity is evaluated two ways at {plural(report.effort.residual_states, 'random state')}; the"
        " residual is the largest difference over the largest entry. The bound is 64 · nv · eps; where rounding passes"
        " through the inverse of M (marked κ), 64 · cond(M) · eps if that is more. Numbers in brackets are the paper's.</p>"
    )
    head = (
        "<tr><th>identity</th><th class=n>median</th><th class=n>worst</th><th class=n>bound there</th>"
        f"<th class=n></th><th>{power(-18)} … {power(-6)}</th><th></th></tr>"
    )
    return f"{intro}<table>{head}{''.join(map(_residual, report.residuals))}</table>"


def _residual(row: Residual) -> str:
    mark = '<span class="ok">✓ holds</span>' if row.passed else '<span class="fail">✗ beyond</span>'
    figures = numbers(*map(scientific, (row.median, row.worst, row.bound)), "κ" if row.through_inverse else "")
    cells = f"<td>{escape(symbols(row.name))}</td>{figures}<td>{_strip(row)}</td><td>{mark}</td>"
    return f"<tr{'' if row.passed else ' class=bad'}>{cells}</tr>"


def numbers(*values: str) -> str:
    """Cells of numbers."""
    return "".join(f"<td class=n>{value}</td>" for value in values)


def heads(*titles: str) -> str:
    """Heads of columns of numbers."""
    return "".join(f"<th class=n>{title}</th>" for title in titles)


def _strip(row: Residual) -> str:
    """Median to worst as a line, the bound as a tick, on a scale of powers of ten."""

    def at(value: float) -> float:
        decades = np.log10(max(value, 1e-30)) + 18.0 if np.isfinite(value) else 12.0
        return 4.0 + 182.0 * min(max(decades, 0.0), 12.0) / 12.0

    def line(x1: float, x2: float, y1: float, y2: float, style: str) -> str:
        return f'<line x1="{x1:.1f}" x2="{x2:.1f}" y1="{y1}" y2="{y2}" {style}/>'

    pale, ink = 'stroke="#d9dde1"', "#1a7f4b" if row.passed else "#b3261e"
    middle, worst, bound = at(row.median), at(row.worst), at(row.bound)
    marks = [line(4.0, 186.0, 7, 7, pale), *(line(4 + 45.5 * k, 4 + 45.5 * k, 5, 9, pale) for k in range(5))]
    marks.append(line(middle, worst, 7, 7, f'stroke="{ink}" stroke-width="3"'))
    marks.append(f'<circle cx="{middle:.1f}" cy="7" r="3.2" fill="{ink}"/>')
    marks.append(line(bound, bound, 1, 13, 'stroke="#22262a" stroke-width="1.6"'))
    return f'<svg class="strip" viewBox="0 0 190 14" aria-hidden="true">{"".join(marks)}</svg>'


def accuracy(report: Report, plot: str | None) -> str:
    """The plot and the table of methods."""
    if plot is None:
        return note(report.missing.get("accuracy", "Every method failed on every state."))
    states = plural(report.effort.states, "random state")
    caption = (
        f"Joint accelerations of {states}, by every method in float32 (hollow squares) and float64 (filled circles)."
        " Large marks: median; bar: worst state; faint dots: every state. The dashed line is one unit of rounding."
        " Left and low is better. Error and time are of the same calls: <code>Scene::evaluate</code> in Rust, one state a call."
    )
    titles = ("call in Rust, one state", "against auto, float64", "median error", "worst error", "digits lost", "failed")
    first = report.of(AUTO, "float64")
    rows = [f"<tr><th>method</th><th>precision</th>{heads(*titles)}</tr>"]
    for row in report.accuracy:
        ink = colour(row.method, _core.METHODS)
        hollow = " hollow" if row.precision == "float32" else ""
        swatch = f'<span class="swatch{hollow}" style="background:{ink};color:{ink}"></span>'
        figures = numbers(
            time(row.ns),
            f"{significant(row.ns / first.ns, 3)} ×" if first else "",
            scientific(row.median),
            scientific(row.worst),
            _digits(row.digits_lost),
            str(row.failed),
        )
        rows.append(f"<tr><td>{swatch}{escape(symbols(row.method))}</td><td>{row.precision}</td>{figures}</tr>")
    return f"{figure(plot, caption)}<table>{''.join(rows)}</table>{_digits_note()}"


def _digits(lost: float) -> str:
    return f"{max(lost, 0.0):.1f}" if np.isfinite(lost) else "all"


def _digits_note() -> str:
    eps64, eps32 = scientific(EPS["float64"]), scientific(EPS["float32"])
    return (
        '<p class="soft small">Error: largest error of an acceleration over the largest acceleration of the state.'
        f" Digits lost: log₁₀ of the median error over eps ({eps64} in float64, {eps32} in float32), 0 where it is"
        " below one unit. Failed: states where the method met a pivot that is not positive; they do not enter the"
        " errors.</p>"
    )


def calls(report: Report) -> str:
    """What every public call takes from Python, and what form auto costs in the states that robots are in."""
    if "calls" in report.missing:
        return note(report.missing["calls"])
    batches = sorted({row.batch for row in report.calls if row.batch > 1}, reverse=True)
    head = f"<tr><th>call from Python</th><th>form</th>{heads('one state a call', f'in a batch of {batches[0]}')}</tr>"
    ones = [row for row in report.calls if row.batch == 1]
    rows = "".join(
        f"<tr><td><code>{escape(row.call)}</code></td><td>{row.form or ''}</td>"
        f"{numbers(time(row.ns), _batch_time(report, row.call, row.form, batches[0]))}</tr>"
        for row in ones
    )
    text = (
        "<p>Medians of whole calls as a program makes them from Python, at random states, on one thread; of a batch, the time of the call"
        " over the number of its states. Without <code>form</code>, forward_dynamics and mass_matrix_inverse are in form auto.</p>"
    )
    return f"{text}<table>{head}{rows}</table>{_kinds(report)}"


def _batch_time(report: Report, call: str, form: str | None, usual: int) -> str:
    row = report.call(call, form, batch=True)
    if row is None:
        return ""
    return time(row.ns) if row.batch == usual else f"{time(row.ns)} (of {row.batch})"


def _kinds(report: Report) -> str:
    """Forward dynamics in form auto and covariance at every kind of state: times and errors."""
    if not report.costs:
        return ""
    times = {(row.kind, row.batch > 1): row for row in report.costs}
    errors_of = {(row.kind, row.form): row for row in report.kind_errors}
    found = []
    for kind, meaning in kinds.MEANING.items():
        one, many = times.get((kind, False)), times.get((kind, True))
        if one is None or many is None:
            continue
        errors = [errors_of.get((kind, form)) for form in ("auto", "covariance")]
        cells = numbers(
            time(one.auto),
            f"{one.ratio:.2f} ×",
            time(many.auto),
            f"{many.ratio:.2f} ×",
            *(scientific(error.worst) if error else "" for error in errors),
        )
        found.append(f'<tr><td>{kind}<br><span class="soft small">{escape(meaning)}</span></td>{cells}</tr>')
    titles = heads(
        "auto, one state a call",
        "over covariance",
        f"auto, batch of {report.costs[-1].batch}",
        "over covariance",
        "worst error, auto",
        "worst error, covariance",
    )
    text = (
        "<p>Robots are rarely in random states. Forward dynamics from Python, as above, at the same configurations held against"
        " gravity, let go, falling, and with one joint moving. Errors are the largest of a state over its largest acceleration,"
        " or over that of the bias torque alone where this is more: of what is held still, nothing is left to compare with.</p>"
    )
    return f"<h3>The states that robots are in</h3>{text}<table><tr><th>state</th>{titles}</tr>{''.join(found)}</table>"


def condition(report: Report, matrix: str | None, scatter: str | None) -> str:
    """Condition number of M, the picture of M, and error against it."""
    values = report.conditions
    if not values.size:
        return note(report.missing.get("condition", ""))
    low, middle, high = float(values.min()), float(np.median(values)), float(values.max())
    digits = np.log10(middle) if np.isfinite(middle) else np.inf
    words = (
        f"A condition number of {scientific(middle)} puts {digits:.1f} digits at risk in a method that works on M"
        " itself."
    )
    if report.rank is not None and report.rank < report.scene.nv:
        words = f"M has rank {report.rank} of {report.scene.nv} at the first state: it cannot be inverted."
    spread = numbers(*map(scientific, (low, middle, high)))
    table = (
        f"<table><tr><th>cond(M) over the states</th>{heads('smallest', 'median', 'largest')}</tr>"
        f"<tr><td>largest over smallest singular value</td>{spread}</tr></table>"
    )
    lost = "".join(
        f"<tr><td>{escape(symbols(row.method))}</td>{numbers(_digits(row.digits_lost), _digits(row.digits_lost_worst))}</tr>"
        for row in report.accuracy
        if row.precision == "float64"
    )
    if lost:
        titles = heads("median state", "worst state")
        lost = f"<table><tr><th>digits lost, float64</th>{titles}</tr>{lost}</table>"
    picture = (
        figure(matrix, "The mass matrix at the first state. White: zero, or less than eps times the largest entry.")
        if matrix
        else ""
    )
    text = f'<div class="two"><div><p>{words} The filter never forms M.</p>{table}{lost}</div>{picture}</div>'
    if scatter is None:
        return text
    return text + figure(
        scatter, "Each dot a state, float64: what the condition number costs. The dashed line is one unit of rounding."
    )


def growth(report: Report, plot: str) -> str:
    """The plot of time a body, and its flatness in words."""
    rows = report.growth
    spreads = {kind: measure.spread([getattr(row, kind) for row in rows]) for kind in ("forward", "covariance", "inverse")}
    flat = (
        f"{spreads['forward']:.2f} for forward dynamics in form auto, {spreads['covariance']:.2f} in form covariance and"
        f" {spreads['inverse']:.2f} for inverse dynamics"
    )
    reach = f"From {count(rows[0].bodies)} to {count(rows[-1].bodies)} bodies the time a body"
    words = f"<p>{reach} stays within a factor of {flat}: the work is O(N).</p>"
    if max(spreads.values()) > 2.0:
        words = (
            f"<p>{reach} varies by a factor of {flat}; O(N) work would keep it near"
            " 1, and caches, states that auto does again, and other load on the machine move it.</p>"
        )
    caption = (
        f"Chains of equal links, <code>Scene::evaluate</code> in Rust, one state a call, least of {measure.GROWTH_ROUNDS} rounds'"
        " medians. This does not depend on the robot of this page."
    )
    return words + figure(plot, caption) + _operators(report.operators)


def _operators(rows: Sequence[OperatorGrowth]) -> str:
    """The table of applying each operator."""
    worst = max(rows, key=lambda row: row.spread)
    titles = heads(*(f"{count(bodies)} bodies" for bodies in measure.OPERATOR_SIZES), "largest over smallest")
    lines = "".join(
        f"<tr><td>{symbols(row.name)}</td>"
        + numbers(*(f"{ns:.3g}" for ns in (*row.ns, row.spread)))
        + "</tr>"
        for row in rows
    )
    words = (
        "<p>Applying an operator of the paper is a sweep, and never forms a matrix. Nanoseconds a body of <code>Operator::apply</code> in"
        f" Rust, operator by operator; a star is the transpose. From {count(measure.OPERATOR_SIZES[0])} to {count(measure.OPERATOR_SIZES[-1])} bodies the least steady,"
        f" {symbols(worst.name)}, varies by a factor of {worst.spread:.2f}.</p>"
    )
    return f"{words}<details><summary>All operators</summary><table><tr><th>operator</th>{titles}</tr>{lines}</table></details>"


def limits() -> str:
    """What the figures do not show."""
    return f'<p class="columns">{LIMITS}</p>'


def provenance(report: Report) -> str:
    """Machine, versions and seed."""
    machine = report.machine
    facts = [
        ("processor", f"{escape(str(machine['cpu'] or 'unknown'))}, {machine['cores']} cores seen"),
        ("system", escape(str(machine["os"]))),
        (
            "phipsi",
            escape(str(machine["phipsi"]))
            + (f", commit {escape(str(machine['commit']))}" if machine["commit"] else ""),
        ),
        ("compiler", escape(str(machine["compiler"] or "unknown"))),
        ("Python, NumPy", f"{escape(str(machine['python']))}, {escape(str(machine['numpy']))}"),
        ("date", escape(report.date)),
        ("random states", f"{count(report.effort.states)}, seed {report.seed}{' (quick)' if report.quick else ''}"),
        (
            "passes timed",
            (
                f"{measure.ROUNDS} rounds of {report.effort.repeats} over all states in Rust, {report.effort.growth_repeats}"
                f" for growth; calls from Python {CALL_TURNS[report.quick]} turns"
            ),
        ),
    ]
    return _facts(facts)
