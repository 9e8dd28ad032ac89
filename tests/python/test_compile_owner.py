"""phipsi.compile loads only libraries that no other user could have written."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import phipsi
from phipsi.errors import ArgumentError

pytestmark = pytest.mark.skipif(os.name != "posix", reason="owners and modes are those of POSIX")


def compiled(cache: Path | None) -> Path:
    return phipsi.compile(phipsi.scenes.chain(2), ["mass_matrix"], flags=["-O0"], cache=cache).library


@pytest.mark.parametrize("up", [0, 1, 2])
def test_a_library_that_others_can_write_is_not_loaded(up: int, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    library = compiled(cache)
    assert compiled(cache) == library
    path = (library, library.parent, cache)[up]
    path.chmod(0o777)
    with pytest.raises(ArgumentError, match=r"^cache: found .*rwxrwxrwx.*chmod go-w"):
        compiled(cache)
    path.chmod(0o755)
    assert compiled(cache) == library


def test_a_cache_where_each_deletes_only_their_own_serves(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    cache.mkdir()
    cache.chmod(0o1777)
    assert compiled(cache).is_relative_to(cache)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away")
def test_a_library_of_another_user_is_not_loaded(tmp_path: Path) -> None:
    library = compiled(tmp_path)
    os.chown(library, 12345, -1)
    with pytest.raises(ArgumentError, match=r"^cache: found .* of user 12345"):
        compiled(tmp_path)


def test_a_relative_cache_of_the_environment_is_ignored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", "caches")
    monkeypatch.chdir(tmp_path)
    assert compiled(None).is_relative_to(tmp_path / ".cache" / "phipsi")
    assert not (tmp_path / "caches").exists()
