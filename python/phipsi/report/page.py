"""The page: one HTML file that needs nothing beside itself."""

from __future__ import annotations

from collections.abc import Sequence

from . import emergence_section, sections
from .collect import Report
from .figure import Plot
from .measure import EPS
from .left_out import FORWARD
from .sections import AUTO
from .style import CSS
from .text import count, escape, plural, scientific, significant, time

PARTS = (
    ("scene", "The scene"),
    ("plan", "Left out"),
    ("residuals", "Residuals"),
    ("calls", "What a call takes"),
    ("accuracy", "Error against run time"),
    ("condition", "Condition"),
    ("emergence", "The mass matrix emerges"),
    ("growth", "Growth with size"),
    ("limits", "What the figures do not show"),
    ("provenance", "How this was made"),
)


def page(report: Report, skeleton: str, caption: str, plots: Sequence[Plot]) -> str:
    """The whole page."""
    drawn = {plot.name: plot.svg for plot in plots}
    bodies = {
        "scene": sections.scene(report, skeleton, caption),
        "plan": sections.plan(report),
        "residuals": sections.residuals(report),
        "calls": sections.calls(report),
        "accuracy": sections.accuracy(report, drawn.get("error-against-time")),
        "condition": sections.condition(report, drawn.get("mass-matrix"), drawn.get("error-against-condition")),
        "emergence": emergence_section.emergence(report, drawn.get("emergence"), drawn.get("emergence-slopes")),
        "growth": sections.growth(report, drawn["growth"]),
        "limits": sections.limits(),
        "provenance": sections.provenance(report),
    }
    titles = dict(PARTS)
    parts = "".join(f'<section id="{key}"><h2>{titles[key]}</h2>{body}</section>\n' for key, body in bodies.items())
    links = "".join(f'<a href="#{key}">{title}</a>' for key, title in PARTS)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(report.name)} – phipsi report</title>\n<style>{CSS}</style></head>\n<body>\n"
        f"{_head(report, links)}\n{parts}"
        f"<footer>phipsi {escape(str(report.machine['phipsi']))} · {escape(report.date)} · all numbers are in "
        "<code>report.json</code> beside this page</footer>\n</body>\n</html>\n"
    )


def _head(report: Report, links: str) -> str:
    scene = report.scene
    parts = [
        f"{count(scene.nv)} degrees of freedom",
        plural(scene.plan().bodies, "moving body", "moving bodies"),
        f"{significant(report.tree.mass)} kg",
        "floating base" if report.tree.floating else "fixed base",
    ]
    return (
        f"<header><h1>{escape(report.name)}</h1><p>{' · '.join(parts)}</p></header>"
        f'{_failure(report)}<p class="lead">{_lead(report)}</p>{_key(report)}<nav>{links}</nav>'
    )


def _failure(report: Report) -> str:
    bad = [row for row in report.residuals if not row.passed]
    if not bad:
        return ""
    text = (
        f"{plural(len(bad), 'residual is', 'residuals are')} beyond the bound: see <a href='#residuals'>Residuals</a>."
    )
    return f'<p class="note bad"><strong>{text}</strong></p>'


def _lead(report: Report) -> str:
    """The result in a sentence or two."""
    if report.scene.nv == 0:
        return "Nothing moves in this scene, so there is nothing to compute; its tree and what was left out are below."
    row, dense = report.of(AUTO, "float64"), report.of("dense Cholesky (faer)", "float64")
    one, many = (report.call(FORWARD, AUTO, batch=batch) for batch in (False, True))
    if row is None or one is None or many is None:
        return (
            "Forward dynamics is not possible for this scene:"
            f" {escape(report.missing.get('accuracy', 'every method failed'))}."
        )
    text = (
        f"Forward dynamics called from Python takes {time(one.ns)} for one state, and {time(many.ns)} a state in batches of"
        f" {many.batch}, in form auto on one core"
    )
    if dense is None:
        return f"{text}, with a median error of {scientific(row.median)} against a reference of 31 digits."
    text = f"{text}. In Rust a call of it is {_pace(dense.ns / row.ns)} forming M and its dense Cholesky factor. "
    against = f"Its median error is {scientific(row.median)}, against {scientific(dense.median)} by Cholesky"
    return f"{text}{against}, both measured against a reference of 31 digits."


def _pace(ratio: float) -> str:
    """A ratio of times in words; what noise may hide is not claimed."""
    if 0.93 < ratio < 1.08:
        return "as long as"
    return (
        f"{significant(ratio, 2)} times as fast as" if ratio > 1.0 else f"{significant(1 / ratio, 2)} times as long as"
    )


def _key(report: Report) -> str:
    boxes = []
    row, one = report.of(AUTO, "float64"), report.call(FORWARD, AUTO, batch=False)
    if one is not None:
        boxes.append((time(one.ns), "a call from Python: joint accelerations of one state, form auto, one core", True))
    if row is not None:
        eps = row.median / EPS["float64"]
        boxes.append(
            (
                f"{significant(eps, 2)} eps",
                (
                    f"median error of those accelerations over {plural(len(row.errors), 'random state')} "
                    f"(worst {significant(row.worst / EPS['float64'], 2)} eps); eps = 2.2 × 10⁻¹⁶"
                ),
                True,
            )
        )
    if report.residuals:
        held = sum(row.passed for row in report.residuals)
        text = (
            "identities of the theory hold to rounding on this robot, at"
            f" {plural(report.effort.residual_states, 'random state')}"
        )
        boxes.append((f"{held} of {len(report.residuals)}", text, held == len(report.residuals)))
    if len(boxes) < 3 and report.rank is not None and report.rank < report.scene.nv:
        text = "rank of the mass matrix: some joints move no mass"
        boxes.append((f"{report.rank} of {report.scene.nv}", text, False))
    cells = "".join(
        f'<div class="{"" if good else "bad"}"><strong>{top}</strong><span>{text}</span></div>'
        for top, text, good in boxes
    )
    return f'<div class="key">{cells}</div>' if cells else ""
