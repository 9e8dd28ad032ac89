"""The command that installs an optional part of phipsi into the current installation."""

from __future__ import annotations

import json
import re
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote, urlparse

__all__ = ["command", "need_pages"]


def command(*extras: str) -> str:
    """The pip command that adds extras to this installation.

    phipsi is not on a package index. An installation from a clone or a wheel is extended from the same source if it
    still exists; otherwise the command installs the packages of the extras.

    Parameters
    ----------
    *extras : str
        Names of extras, as in pyproject.toml.

    Returns
    -------
    str
        The command.

    Examples
    --------
    >>> from phipsi._install import command
    >>> command("view").startswith("pip install ")
    True
    """
    wanted = f"[{','.join(extras)}]"
    try:
        own = metadata.distribution("phipsi")
    except metadata.PackageNotFoundError:
        own = None
    source = (own and _source(own)) or _clone()
    if source is not None and source.is_file():
        return f'pip install "phipsi{wanted} @ {source.as_uri()}"'
    if source is not None:
        return f'pip install "{"." if source == Path.cwd() else source}{wanted}"'
    packages = [] if own is None else _packages(own, extras)
    return f"pip install {' '.join(packages)}" if packages else f'pip install ".{wanted}", in a clone of phipsi'


def need_pages() -> None:
    """Raise ImportError if the packages for pages are not installed."""
    if absent := [name for name in ("plotly", "jinja2") if find_spec(name) is None]:
        raise ImportError(f"found no {', '.join(absent)}, which pages need; install with: {command('report')}")


def _source(own: metadata.Distribution) -> Path | None:
    """The folder or the wheel that phipsi was installed from, if pip recorded it and it still exists."""
    try:
        url = urlparse(str(json.loads(own.read_text("direct_url.json") or "{}").get("url", "")))
    except (OSError, ValueError, AttributeError):
        return None
    path = Path(unquote(url.path))
    return path if url.scheme == "file" and path.exists() else None


def _clone() -> Path | None:
    """The clone that this module is a part of, if it is one."""
    root = Path(__file__).resolve().parents[2]
    return root if (root / "pyproject.toml").is_file() and (root / "python" / "phipsi").is_dir() else None


def _packages(own: metadata.Distribution, extras: tuple[str, ...]) -> list[str]:
    """The requirements of the extras, as arguments of a shell command."""
    found = []
    for requirement in own.requires or []:
        name, _, marker = requirement.partition(";")
        if any(re.search(rf"""extra\s*==\s*['"]{re.escape(extra)}['"]""", marker) for extra in extras):
            found.append(f'"{name.strip()}"')
    return found
