"""Viewer for robots in a browser, `scene.show`, and self-contained pages. Needs phipsi[view].

>>> scene.show(path)                      # doctest: +SKIP
>>> scene.show(path, to="motion.html")    # doctest: +SKIP
"""

from .._install import command

try:
    import trimesh  # noqa: F401
    import viser  # noqa: F401
    import yourdfpy  # noqa: F401
except ImportError as missing:
    raise ImportError(f"the viewer needs {missing.name}; install it with: {command('view')}") from missing

from .player import Viewer, page, show

__all__ = ["Viewer", "page", "show"]
