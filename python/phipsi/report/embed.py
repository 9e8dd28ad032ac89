"""The robot in motion within a page, with a play button. The page is self-contained."""

from __future__ import annotations

import warnings
from importlib.util import find_spec
from typing import Any

from .. import errors
from .._core import Scene
from .._install import command
from .._motion import Trajectory
from .pipeline import Missing
from .states import Array

#: Packages of the extra `view`.
EXTRA = ("viser", "yourdfpy", "trimesh")
#: Largest number of links; larger pages would be too large to open.
MOST_LINKS = 300


def lacking() -> str | None:
    """Packages that have to be installed first; None if there are none."""
    absent = [name for name in EXTRA if find_spec(name) is None]
    return f"found no {', '.join(absent)}; install with: {command('view')}" if absent else None


def check(scene: Scene) -> None:
    """Raise Missing if the robot cannot be shown."""
    if (reason := lacking()) is not None:
        raise Missing(reason)
    links = len(scene.link_names)
    if scene.nv == 0 or links > MOST_LINKS:
        raise Missing(f"found {links} links, {scene.nv} degrees of freedom; expected at most {MOST_LINKS} links, and at least one degree of freedom")


def robot(scene: Scene, motion: Trajectory | Array, t: Array | None = None) -> dict[str, Any]:
    """Values for a template that shows a robot in motion, or at configurations, (k, nq), at times, (k,), s: an iframe,
    True if the file has shapes, and a list of missing shapes.
    """
    from markupsafe import Markup

    from .. import view
    from ..view import shapes

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", errors.MeshWarning)
        own = shapes.of_file(scene, None)
    html = view.page(scene, motion, t=t, shapes=[*(own or shapes.stand_ins(scene)), *shapes.of_colliders(scene, fixed_only=True)])
    # srcdoc is an attribute, in which only quotes and ampersands are special.
    frame = Markup('<iframe class="robot" title="The robot in motion" srcdoc="{}"></iframe>').format(html)
    acts = "contacts" if scene.contacts.names or scene.collider_names else "connections" if scene.loops.names else None
    return {"frame": frame, "meshes": bool(own), "lost": [str(one.message) for one in caught], "acts": acts if isinstance(motion, Trajectory) else None}
