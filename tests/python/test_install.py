"""The command that adds an extra to the present installation."""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
from phipsi import _install


class Distribution:
    """A distribution with the record of pip about its source."""

    requires = ["numpy>=1.23", "viser>=1.1,<2; extra == 'view'", 'plotly>=6; extra == "report"']

    def __init__(self, url: str | None) -> None:
        self.url = url

    def read_text(self, name: str) -> str | None:
        assert name == "direct_url.json"
        return None if self.url is None else json.dumps({"url": self.url, "dir_info": {}})


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Any:
    def as_from(url: str | None) -> None:
        monkeypatch.setattr(metadata, "distribution", lambda name: Distribution(url))
        monkeypatch.setattr(_install, "_clone", lambda: None)

    return as_from


def test_from_a_clone(installed: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed(tmp_path.as_uri())
    assert _install.command("view") == f'pip install "{tmp_path}[view]"'
    monkeypatch.chdir(tmp_path)
    assert _install.command("view", "report") == 'pip install ".[view,report]"'


def test_from_a_wheel(installed: Any, tmp_path: Path) -> None:
    wheel = tmp_path / "phipsi-0.1.0-cp310-abi3-linux_x86_64.whl"
    wheel.write_bytes(b"")
    installed(wheel.as_uri())
    assert _install.command("view") == f'pip install "phipsi[view] @ {wheel.as_uri()}"'


@pytest.mark.parametrize("url", [None, "file:///nonexistent/clone"])
def test_from_a_source_that_is_gone(installed: Any, url: str | None) -> None:
    installed(url)
    assert _install.command("view") == 'pip install "viser>=1.1,<2"'
    assert _install.command("view", "report") == 'pip install "viser>=1.1,<2" "plotly>=6"'


def test_without_metadata(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> Any:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", absent)
    monkeypatch.setattr(_install, "_clone", lambda: None)
    assert _install.command("view") == 'pip install ".[view]", in a clone of phipsi'
