"""Interactive plots of a page; the only file that creates Plotly figures. The page is self-contained."""

from __future__ import annotations

import base64
import gzip
import html
import json
import math
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from .plotting import FAINT, INK, Axis, Chart, Matrix, Panel, Part, Plot, Series, Space, Values

if TYPE_CHECKING:
    from markupsafe import Markup

Json = dict[str, Any]

#: Longer names are shown without their middle part.
LONGEST = 36
#: Plotly's names of symbols that are not filled.
SYMBOLS = {"dash": "line-ew-open", "x": "x-thin-open", "cross": "cross-thin-open"}
#: Markers as text, filled and hollow.
GLYPHS = {"square": ("■", "□"), "diamond": ("◆", "◇"), "triangle-up": ("▲", "△"), "x": ("×", "×"), "cross": ("+", "+")}
#: Space in px: left of a panel for tick labels and the title; below it for tick labels; per line of a title.
LEFT, UNDER, LINE = 64, 26, 17
#: Characters per line of a title on a narrow page.
NARROW = 40
#: Largest number of rows of a matrix with row labels, and of one with exact values in the hover label.
MOST_NAMES, MOST_EXACT = 12, 100


@dataclass
class _Entry:
    """An entry of the legend."""

    name: str
    ink: str
    kind: str
    shown: bool
    glyph: str = ""
    traces: list[int] = field(default_factory=list)


@dataclass
class _Drawing:
    traces: list[Json]
    wide: Json
    narrow: Json
    entries: list[_Entry]


def shortened(name: str) -> str:
    """A name without its middle part if it is long."""
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 13]}…{name[-12:]}"


def _text(name: str) -> str:
    """A name in which tags and entities are escaped, because Plotly interprets them as HTML."""
    return html.escape(shortened(name), quote=False)


def markup(plot: Plot) -> Markup:
    """The plot as an element of a page that ends with `script()`; its legend has one button per name."""
    from markupsafe import Markup

    drawing = _chart(plot) if isinstance(plot, Chart) else _matrix(plot) if isinstance(plot, Matrix) else _space(plot)
    content = {"traces": drawing.traces, "wide": drawing.wide, "narrow": drawing.narrow}
    data = json.dumps(content, allow_nan=False, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")
    entries = drawing.entries if len(drawing.entries) > 1 else []
    buttons = Markup("").join(
        Markup('<button type="button" data-traces="{}" aria-pressed="{}"><i class="{}" style="color:{}" data-ink="{}">{}</i>{}</button>').format(
            json.dumps(one.traces), str(one.shown).lower(), one.kind, one.ink, one.ink, one.glyph, one.name
        )
        for one in entries
    )
    # The heights are set before the script runs, so that the layout does not shift.
    place = '<div class="plot" id="plot-{}" style="--wide:{}px;--narrow:{}px"><div class="canvas"></div><div class="legend">{}</div>'
    head = Markup(place).format(plot.name, drawing.wide["height"], drawing.narrow["height"], buttons)
    return head + Markup('<script type="application/json">') + Markup(data) + Markup("</script></div>")


def _numbers(values: Values | Iterable[float]) -> list[float | None]:
    """Values rounded to the resolution of a screen."""
    return [float(f"{value:.5g}") if math.isfinite(value) else None for value in values]


def _base(height: int) -> Json:
    return {
        "height": height, "margin": {"l": LEFT, "r": 14, "t": 4, "b": 4}, "showlegend": False, "hovermode": "closest",
        "font": {"family": "Helvetica Neue, Helvetica, Arial, Liberation Sans, sans-serif", "size": 12, "color": INK},
        "hoverlabel": {"bgcolor": "#fff", "bordercolor": "#8a9199", "font": {"size": 12, "color": INK}, "align": "left"},
        "paper_bgcolor": "#fff", "plot_bgcolor": "#fff",
    }  # fmt: skip


# Panels


def _chart(chart: Chart) -> _Drawing:
    traces: list[Json] = []
    entries: dict[str, _Entry] = {}
    for at, panel in enumerate(chart.panels):
        for series in panel.series:
            entry = entries.setdefault(series.name, _Entry(series.name, series.ink, _kind(series), True, _glyph(series)))
            entry.traces.append(len(traces))
            traces.append(_trace(series, panel) | _axes_of(at))
    return _Drawing(traces, _panels(chart, chart.columns, False), _panels(chart, 1, True), list(entries.values()))


def _kind(series: Series) -> str:
    """Style of a legend entry: a class of style.css."""
    if series.below:
        return "area"
    if series.mark and not series.line:
        return "hollow" if series.hollow else "mark"
    return "dashed" if series.dash else "line"


def _glyph(series: Series) -> str:
    """Glyph of the markers, if they are not circles."""
    filled, hollow = GLYPHS.get(series.symbol, ("", ""))
    return hollow if series.hollow else filled


def _axes_of(at: int) -> Json:
    return {"xaxis": f"x{at + 1 if at else ''}", "yaxis": f"y{at + 1 if at else ''}"}


def _trace(series: Series, panel: Panel) -> Json:
    trace: Json = {
        "type": "scatter", "name": _text(series.name), "x": _numbers(series.x), "y": _numbers(series.y), "opacity": series.shade,
        "mode": "+".join(word for word, has in (("lines", series.line), ("markers", series.mark)) if has),
    }  # fmt: skip
    if series.line:
        trace["line"] = {"color": series.ink, "width": series.line, "dash": "dash" if series.dash else "solid"}
    if series.mark:
        symbol = SYMBOLS.get(series.symbol, series.symbol)
        trace["marker"] = {"color": series.ink, "size": series.mark, "symbol": symbol, "line": {"color": series.ink, "width": 1.5}}
        if series.hollow:
            trace["marker"]["color"] = "#fff"
        elif symbol == series.symbol:
            trace["marker"]["line"]["width"] = 0
    if series.below:
        trace |= {"fill": "tozeroy", "fillcolor": "rgba(201,206,211,0.45)"}
    if series.told:
        # Not in the template, because a name may contain template syntax.
        trace["meta"] = ", ".join(filter(None, (_text(series.name), _text(series.note))))
        rows = [f"{_text_all(axis.title)}: %{{{letter}:{axis.form}}}{axis.unit}" for letter, axis in (("x", panel.x), ("y", panel.y)) if axis.title]
        trace["hovertemplate"] = "<br>".join(["<b>%{meta}</b>", *rows]) + "<extra></extra>"
    else:
        trace["hoverinfo"] = "skip"
    return trace


def _panels(chart: Chart, columns: int, narrow: bool) -> Json:
    """Layout with that many panels per row."""
    count = len(chart.panels)
    rows = [chart.panels[first : first + columns] for first in range(0, count, columns)]
    above = [24 if any(panel.title for panel in row) else 8 for row in rows]
    below = [8 if chart.linked and row is not rows[-1] else UNDER + LINE * max(len(_lines(p.x, narrow)) for p in row) for row in rows]
    height = sum(above) + sum(below) + chart.height * len(rows)
    layout = _base(height + 8)
    if chart.together:
        layout |= {"hovermode": "x unified"}
    # On a touch screen, dragging scrolls the page.
    layout["dragmode"] = False if narrow else "zoom"
    gap, titles, top = (0.0 if columns == 1 else 0.09 if columns == 2 else 0.075), [], 0.0
    width = (1.0 - gap * (columns - 1)) / columns
    for at, panel in enumerate(chart.panels):
        row, column = divmod(at, columns)
        if column == 0:
            top += above[row] if row == 0 else below[row - 1] + chart.height + above[row]
        span = [1.0 - (top + chart.height) / height, 1.0 - top / height]
        left = column * (width + gap)
        number = "" if at == 0 else str(at + 1)
        is_last = row == len(rows) - 1
        x = _axis(panel.x, narrow) | {"domain": [left, left + width], "anchor": f"y{number}", "showgrid": False}
        if chart.linked:
            x |= {"matches": "x"} if at else {}
            if not is_last:
                x |= {"showticklabels": False, "title": {"text": ""}}
        title = {} if column == 0 or columns == 1 else {"title": {"text": ""}} if panel.y.title == chart.panels[0].y.title else {}
        y = _axis(panel.y, narrow) | {"domain": span, "anchor": f"x{number}"} | title
        layout |= {f"xaxis{number}": x, f"yaxis{number}": y}
        if panel.title:
            titles.append({
                "text": f"<b>{_text(panel.title)}</b>", "xref": "paper", "yref": "paper", "x": left, "y": span[1], "xanchor": "left",
                "yanchor": "bottom", "showarrow": False, "yshift": 3,
            })  # fmt: skip
    return layout | {"annotations": titles}


def _lines(axis: Axis, narrow: bool) -> list[str]:
    """Lines of the title of an x axis."""
    return textwrap.wrap(axis.title, NARROW if narrow else 90)


def _axis(axis: Axis, narrow: bool) -> Json:
    found: Json = {
        "title": {"text": "<br>".join(map(_text_all, _lines(axis, narrow))), "standoff": 6, "font": {"size": 12}}, "linecolor": "#8a9199", "linewidth": 1,
        "ticks": "outside", "ticklen": 4, "tickcolor": "#8a9199", "gridcolor": FAINT, "zeroline": False, "type": "log" if axis.log else "linear",
        "tickfont": {"size": 11, "color": "#555b61"}, "exponentformat": "power",
    }  # fmt: skip
    if axis.low is not None and axis.high is not None:
        found["range"] = [math.log10(end) if axis.log else end for end in (axis.low, axis.high)]
    if axis.ticks is not None:
        found |= {"tickvals": _numbers(value for value, _ in axis.ticks), "ticktext": [_text(name) for _, name in axis.ticks]}
    return found


def _text_all(words: str) -> str:
    return html.escape(words, quote=False)


# A matrix


def _matrix(plot: Matrix) -> _Drawing:
    names, count = [_text(name) for name in plot.names], len(plot.names)
    logs = np.log10(plot.values, where=plot.values > 0.0, out=np.full_like(plot.values, np.nan))
    low, high = int(np.floor(np.nanmin(logs, initial=0.0))), int(np.ceil(np.nanmax(logs, initial=0.0)))
    ticks = range(low, high + 1, max(1, math.ceil((high - low) / 6)))
    trace: Json = {
        "type": "heatmap", "z": [[None if math.isnan(v) else round(v, 3) for v in row] for row in logs], "x": names, "y": names,
        "colorscale": "YlGnBu", "reversescale": True, "xgap": 1 if count <= 40 else 0, "ygap": 1 if count <= 40 else 0, "hoverongaps": False,
        "colorbar": {
            "tickvals": list(ticks), "ticktext": [f"10<sup>{value}</sup>".replace("-", "−") for value in ticks], "thickness": 12, "outlinewidth": 0,
            "title": {"text": plot.label, "side": "right"},
        },
        "hovertemplate": "%{y}, %{x}: 10^%{z:.2f}<extra></extra>",
    }  # fmt: skip
    if count <= MOST_EXACT:
        trace |= {"customdata": [_numbers(row) for row in plot.values], "hovertemplate": "%{y}, %{x}<br>%{customdata:.4~g}<extra></extra>"}
    layouts = []
    for height in (420, 340):
        named = height == 420 and count <= MOST_NAMES and max(map(len, names), default=0) <= 16
        axis: Json = {"type": "category", "showticklabels": named, "ticks": "", "showgrid": False, "zeroline": False, "constrain": "domain"}
        x, y = axis | {"side": "top", "tickangle": -45}, axis | {"autorange": "reversed", "scaleanchor": "x"}
        room = 6.5 * max(map(len, names), default=0)
        margin = {"l": 10 + room, "r": 10, "t": 12 + 0.75 * room, "b": 4} if named else {"l": 4, "r": 4, "t": 8, "b": 4}
        layouts.append(_base(height) | {"xaxis": x, "yaxis": y, "margin": margin, "dragmode": "zoom" if height == 420 else False})
    wide, narrow = layouts
    return _Drawing([trace], wide, narrow, [])


# Space


def _space(plot: Space) -> _Drawing:
    traces: list[Json] = []
    entries: dict[str, _Entry] = {}
    for part in plot.parts:
        kind = "mark" if not part.line else "line"
        entries.setdefault(part.name, _Entry(part.name, f"{part.ink}{round(255 * part.shade):02x}", kind, part.shown)).traces.append(len(traces))
        traces.append(_in_space(part))
    cloud = np.concatenate([part.points for part in plot.parts])
    low, high = np.nanmin(cloud, axis=0), np.nanmax(cloud, axis=0)
    size = float((high - low).max()) or 1.0
    # Keeps a flat figure visible.
    extent = np.maximum(high - low, 0.02 * size)
    hidden: Json = {"visible": False, "showspikes": False}
    axes = {
        f"{letter}axis": hidden | {"range": _numbers([middle - 0.5 * length, middle + 0.5 * length])}
        for letter, middle, length in zip("xyz", 0.5 * (low + high), extent, strict=True)
    }
    eye = plot.toward / np.linalg.norm(plot.toward)
    right = np.cross([0.0, 0.0, 1.0], eye)
    # The center of the box is the center of the picture.
    flat = (cloud - 0.5 * (low + high)) @ np.stack([right, np.cross(eye, right)], axis=-1) / size
    across, high_up = np.maximum(2.0 * np.nanmax(np.abs(flat), axis=0), 0.02)
    layouts = []
    # Scales that fit in width and height, in units of the scene; labels need space beside the figure.
    for height, widest in ((480, 3.2), (380, 1.3)):
        ratio = _numbers(min(1.75 / high_up, widest / across) * extent / size)
        scene = {
            **axes, "aspectmode": "manual", "aspectratio": dict(zip("xyz", ratio, strict=True)), "dragmode": "orbit",
            "camera": {"eye": dict(zip("xyz", _numbers(2.5 * eye), strict=True)), "projection": {"type": "orthographic"}},
        }  # fmt: skip
        layouts.append(_base(height) | {"scene": scene, "margin": {"l": 0, "r": 0, "t": 0, "b": 0}})
    wide, narrow = layouts
    return _Drawing(traces, wide, narrow, list(entries.values()))


def _in_space(part: Part) -> Json:
    words = (("lines", part.line), ("markers", np.any(part.marks)), ("text", len(part.names)))
    trace: Json = {
        "type": "scatter3d", "name": _text(part.name), "mode": "+".join(word for word, has in words if has), "opacity": part.shade,
        **dict(zip("xyz", map(_numbers, part.points.T), strict=True)), "visible": part.shown,
    }  # fmt: skip
    if part.line:
        trace["line"] = {"color": part.ink, "width": part.line}
    if np.any(part.marks):
        sizes = part.marks if isinstance(part.marks, float) else _numbers(part.marks)
        trace["marker"] = {"color": part.ink, "size": sizes, "sizemode": "diameter", "line": {"width": 0}}
    if part.names:
        trace |= {"text": [_rows(name) for name in part.names], "textfont": {"size": 12, "color": INK}, "textposition": "top right"}
    if part.texts:
        trace |= {"hovertext": [_rows(text) for text in part.texts], "hoverinfo": "text"}
    else:
        trace["hoverinfo"] = "skip"
    return trace


def _rows(text: str) -> str:
    """Names on separate lines."""
    return "<br>".join(map(_text, text.split("\n")))


# The script


@cache
def _library() -> str:
    from plotly.offline import get_plotlyjs

    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), 9)).decode()


def script() -> Markup:
    """Script that draws all plots of a page, at its end: Plotly, compressed to a fifth of its size, and a few lines."""
    from markupsafe import Markup

    return Markup("<script>") + Markup(DRAW.replace("DARK", json.dumps(DARK)).replace("PACKED", _library())) + Markup("</script>")


#: Colors on a dark page, by those on a white one.
DARK = {
    "#fff": "#16181c", INK: "#d3d7db", FAINT: "#3c4148", "#6b7279": "#a3abb3", "#555b61": "#a3abb3", "#4d4d4d": "#b9bec4", "#0072b2": "#58aee6", "#aa3377": "#dd7ab3",
    "#009e73": "#2fc39b", "#d55e00": "#f08a3c",
}  # fmt: skip
#: A click on a name hides it; a double click hides all others. Printed pages are white.
DRAW = """
window.plots = (async () => {
const night = matchMedia('screen and (prefers-color-scheme: dark)'), darker = DARK;
const inked = color => night.matches ? darker[color.slice(0, 7)] === undefined ? color : darker[color.slice(0, 7)] + color.slice(7) : color;
const colored = json => night.matches ? json.replace(/"(#(?:[0-9a-f]{6}(?:[0-9a-f]{2})?|fff))"/g, (_, color) => '"' + inked(color) + '"') : json;
const packed = Uint8Array.from(atob('PACKED'), c => c.charCodeAt(0));
const text = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'))).text();
const script = document.createElement('script'); script.textContent = text; document.head.append(script);
const narrow = matchMedia('(max-width: 760px)');
const config = {responsive: true, displaylogo: false, scrollZoom: false, modeBarButtonsToRemove: ['select2d', 'lasso2d', 'autoScale2d', 'resetCameraLastSave3d']};
for (const place of document.querySelectorAll('.plot')) {
  const json = place.querySelector('script').textContent, canvas = place.querySelector('.canvas');
  const names = [...place.querySelectorAll('.legend button')];
  let figure = JSON.parse(colored(json));
  const draw = () => Plotly.react(canvas, figure.traces, narrow.matches ? figure.narrow : figure.wide, {...config, displayModeBar: narrow.matches ? false : 'hover'});
  const color = () => {
    for (const mark of place.querySelectorAll('.legend i')) mark.style.color = inked(mark.dataset.ink);
  };
  color();
  const show = (name, on) => {
    name.setAttribute('aria-pressed', on);
    return Plotly.restyle(canvas, {visible: on}, JSON.parse(name.dataset.traces));
  };
  const shown = name => name.getAttribute('aria-pressed') === 'true';
  for (const name of names) {
    name.addEventListener('click', () => show(name, !shown(name)));
    name.addEventListener('dblclick', () => {
      const others = names.filter(other => other !== name), alone = !others.some(shown);
      for (const other of others) show(other, alone);
      show(name, true);
    });
  }
  narrow.addEventListener('change', draw);
  night.addEventListener('change', async () => {
    figure = JSON.parse(colored(json));
    color();
    await draw();
    for (const name of names) show(name, shown(name));
  });
  await draw();
}
})();
"""
