"""What a page shows that moves: the robot with a play button, and curves that answer to the mouse. Both are in the page, nothing is loaded."""

from __future__ import annotations

import base64
import gzip
import json
import warnings
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.util import find_spec
from typing import Any

from markupsafe import Markup

from .. import errors
from .._core import Scene
from .pipeline import Missing
from .states import Array

#: What the extra `view` brings.
EXTRA = ("viser", "yourdfpy", "trimesh", "plotly")
#: Above this the page would be too large to open.
MOST_LINKS = 300


def lacking() -> str | None:
    """What has to be installed first; None where all is there."""
    absent = [name for name in EXTRA if find_spec(name) is None]
    return f"found no {', '.join(absent)}; install with: pip install \"phipsi[view]\"" if absent else None


def check(scene: Scene) -> None:
    """Raises Missing where a robot cannot be shown."""
    if (reason := lacking()) is not None:
        raise Missing(reason)
    links = len(scene.link_names)
    if scene.nv == 0 or links > MOST_LINKS:
        raise Missing(f"found {links} links, {scene.nv} degrees of freedom; a robot is shown with up to {MOST_LINKS} links, if any moves")


def robot(scene: Scene, t: Array, q: Array) -> dict[str, Any]:
    """What a template shows of a robot that moves through configurations, (k, nq), at times, (k,), s: a frame, whether its file has shapes, and which are lost."""
    from .. import view
    from ..view import shapes

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", errors.MeshWarning)
        own = shapes.of_file(scene, None)
    motion, times = (q, t) if len(q) > 1 else (q[0], None)
    html = view.page(scene, motion, t=times, shapes=own or shapes.stand_ins(scene))
    # A srcdoc is an attribute: quotes and ampersands alone are special there.
    frame = Markup('<iframe class="robot" title="The robot in motion" srcdoc="{}"></iframe>').format(html)
    return {"frame": frame, "meshes": bool(own), "lost": [str(one.message) for one in caught]}


@cache
def _library() -> str:
    from plotly.offline import get_plotlyjs

    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), 9)).decode()


def library() -> Markup:
    """The script that draws curves, once a page: Plotly, packed, for it is five times as large unpacked."""
    return Markup(
        "<script>window.plots = (async () => {"
        f"const packed = Uint8Array.from(atob('{_library()}'), c => c.charCodeAt(0));"
        "const text = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'))).text();"
        "const script = document.createElement('script'); script.textContent = text; document.head.append(script);"
        "})();</script>"
    )


def curves(name: str, t: Array, panels: Sequence[tuple[str, Mapping[str, Array]]], height: int = 230) -> Markup:
    """Curves over time in panels one under the other, in the element of that id: what is on the axis, and the values by their names.

    A name has one colour and one entry in the legend: a click there hides its curves in all panels.
    """
    import plotly.graph_objects as go
    from plotly.colors import qualitative
    from plotly.io import to_json
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=len(panels), shared_xaxes=True, vertical_spacing=0.035)
    names = list(dict.fromkeys(label for _, values in panels for label in values))
    inks = {label: qualitative.D3[i % len(qualitative.D3)] for i, label in enumerate(names)}
    told: set[str] = set()
    for row, (axis, values) in enumerate(panels, 1):
        for label, value in values.items():
            is_bound = label.startswith("limit")
            line = {"width": 1.0, "dash": "dot", "color": "#8a9199"} if is_bound else {"width": 1.5, "color": inks[label]}
            figure.add_trace(
                go.Scatter(
                    x=t, y=value, name=label, legendgroup=label, showlegend=label not in told and not is_bound, line=line, mode="lines",
                    hoverinfo="skip" if is_bound else None, hovertemplate=None if is_bound else "%{y:.4g}",
                ),
                row=row, col=1,
            )  # fmt: skip
            told.add(label)
        figure.update_yaxes(title_text=axis, row=row, col=1)
    figure.update_xaxes(title_text="time, s", row=len(panels), col=1)
    figure.update_layout(
        margin={"l": 60, "r": 10, "t": 10, "b": 40}, template="plotly_white", hovermode="x unified", font={"size": 12},
        # Above the curves, where a narrow page has room for it.
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0},
    )  # fmt: skip
    # Sizes follow the window.
    content = figure.to_plotly_json() | {"config": {"responsive": True, "displaylogo": False}}
    # The height stands before the script has run, so that nothing below jumps.
    place = '<div class="curves" id="{}" style="height:{}px"></div>'
    return Markup(place + "<script>window.plots.then(() => Plotly.newPlot({}, {}));</script>").format(
        name, height * len(panels) + 60, _script(json.dumps(name)), _script(to_json(content, validate=False))
    )


def _script(text: str) -> Markup:
    """JSON as a script may hold it: nothing in it can end the script."""
    return Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))
