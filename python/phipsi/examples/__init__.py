"""Short scripts that show robots: `python -m phipsi.examples` lists them, and `python -m phipsi.examples NAME` runs one."""

from __future__ import annotations

import sys
import sysconfig
from pathlib import Path

__all__ = ["robot"]


def folder() -> Path | None:
    """The folder of robots of the package example-robot-data, from its wheel or from conda, if it is installed."""
    prefixes = Path(sys.prefix), Path(sysconfig.get_path("purelib")) / "cmeel.prefix"
    found = (prefix / "share" / "example-robot-data" / "robots" for prefix in prefixes)
    return next((path for path in found if path.is_dir()), None)


def robot(file: str) -> Path:
    """Path of a robot file of the package example-robot-data.

    Parameters
    ----------
    file : str
        Path below the folder of robots, such as ``"go2_description/urdf/go2.urdf"``.

    Returns
    -------
    pathlib.Path
        The file; its meshes are found by `Scene.show`.

    Raises
    ------
    FileNotFoundError
        If the package is not installed, or has no such file.

    Examples
    --------
    >>> from phipsi.examples import robot
    >>> robot("go2_description/urdf/go2.urdf").name  # doctest: +SKIP
    'go2.urdf'
    """
    robots = folder()
    if robots is None:
        raise FileNotFoundError(f"{file}: found no package example-robot-data, which has this robot; install it with: pip install example-robot-data")
    if not (robots / file).is_file():
        raise FileNotFoundError(f"{file}: found no such file below {robots}; expected a robot of example-robot-data 6 or later: pip install --upgrade example-robot-data")
    return robots / file
