"""The robot in a page, with a play button. All is in the page, nothing is loaded."""

from __future__ import annotations

import warnings
from importlib.util import find_spec
from typing import Any

from markupsafe import Markup

from .. import errors
from .._core import Scene
from .._motion import Trajectory
from .pipeline import Missing
from .states import Array

#: What the extra `view` brings.
EXTRA = ("viser", "yourdfpy", "trimesh")
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


def robot(scene: Scene, motion: Trajectory | Array, t: Array | None = None) -> dict[str, Any]:
    """What a template shows of a robot in motion, or at configurations, (k, nq), at times, (k,), s: a frame, whether its file has shapes, and which are lost."""
    from .. import view
    from ..view import shapes

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", errors.MeshWarning)
        own = shapes.of_file(scene, None)
    html = view.page(scene, motion, t=t, shapes=own or shapes.stand_ins(scene))
    # A srcdoc is an attribute: quotes and ampersands alone are special there.
    frame = Markup('<iframe class="robot" title="The robot in motion" srcdoc="{}"></iframe>').format(html)
    acts = "contacts" if scene.contact_names else "connections" if scene.connection_names else None
    return {"frame": frame, "meshes": bool(own), "lost": [str(one.message) for one in caught], "acts": acts if isinstance(motion, Trajectory) else None}
