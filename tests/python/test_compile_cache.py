"""phipsi.compile: its cache with broken or read-only files, compiler commands, interruption, and pickles."""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import stat
import sys
import threading
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from conftest import PATIENCE, join
from tolerances import assert_same_bits

import phipsi
from phipsi.errors import ArgumentError, CacheWarning

COMPILER = os.environ.get("CC", "cc")
pytestmark = pytest.mark.usefixtures("c_compiler")


@pytest.fixture(scope="module")
def scene() -> phipsi.Scene:
    return phipsi.scenes.chain(2)


def compiled(scene: phipsi.Scene, cache: Path | None, **options: str | None) -> phipsi.Compiled:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return phipsi.compile(scene, ["mass_matrix"], flags=["-O0"], cache=cache, **options)  # type: ignore[call-overload, no-any-return]


def check(scene: phipsi.Scene, fast: phipsi.Compiled) -> None:
    """The machine code works."""
    q = np.linspace(-1, 1, 400).reshape(200, 2)
    code = fast._code["mass_matrix",]
    assert_same_bits(fast.mass_matrix(q), code((q,)))
    assert np.max(np.abs(fast.mass_matrix(q) - scene.mass_matrix(q))) <= 1e-13


@pytest.mark.parametrize("content", [b"", b"\x7fELF", b"no library", None])
def test_a_broken_library_is_built_again(scene: phipsi.Scene, tmp_path: Path, content: bytes | None) -> None:
    first = compiled(scene, tmp_path / "first").library
    # At another path, because a loaded library is not read again.
    whole, library = first.read_bytes(), tmp_path / first.parent.name / first.name
    library.parent.mkdir()
    library.write_bytes(whole[: len(whole) // 2] if content is None else content)
    shutil.copy(first.with_suffix(".sha256"), library.parent)
    check(scene, compiled(scene, tmp_path))
    assert len(library.read_bytes()) == len(whole)
    # And it is available for the next call.
    before = library.stat().st_mtime_ns
    check(scene, compiled(scene, tmp_path))
    assert library.stat().st_mtime_ns == before


def unwritable(tmp_path: Path, kind: str) -> Path:
    """A cache to which no library can be written, even by root."""
    file = tmp_path / "file"
    file.write_text("in the way", encoding="utf-8")
    if kind == "rights":
        tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
        return tmp_path / "cache"
    return file if kind == "a file" else file / "cache"


@pytest.mark.parametrize("kind", ["a file", "below a file", "rights"])
@pytest.mark.parametrize("of", ["cache", "XDG_CACHE_HOME"])
def test_a_cache_that_cannot_be_written_is_replaced(scene: phipsi.Scene, tmp_path: Path, kind: str, of: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if kind == "rights" and os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    cache: Path | None = unwritable(tmp_path, kind)
    if of == "XDG_CACHE_HOME":
        monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
        cache = None
    with pytest.warns(CacheWarning, match=r"^cache: found '.*', which cannot be written \(.*\); the library is built in a temporary directory"):
        fast = phipsi.compile(scene, ["mass_matrix"], flags=["-O0"], cache=cache)
    tmp_path.chmod(stat.S_IRWXU)
    check(scene, fast)
    assert not fast.library.is_relative_to(tmp_path)
    # It is built once per process.
    before = fast.library.stat().st_mtime_ns
    with pytest.warns(CacheWarning):
        again = phipsi.compile(scene, ["mass_matrix"], flags=["-O0"], cache=unwritable(tmp_path, "a file"))
    assert again.library == fast.library and again.library.stat().st_mtime_ns == before


def script(path: Path, text: str) -> Path:
    """A shell script."""
    path.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
    path.chmod(0o755)
    return path


@pytest.mark.parametrize("of", ["CC", "compiler"])
@pytest.mark.parametrize("kind", ["arguments", "launcher", "a path with a space", "quotes"])
def test_commands_of_compilers(scene: phipsi.Scene, tmp_path: Path, kind: str, of: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "with space"
    folder.mkdir()
    launcher = script(folder / "launcher", 'exec "$@"')
    own = script(folder / "own", f'exec {COMPILER} "$@"')
    commands = {"arguments": f"{COMPILER} -pipe", "launcher": f"'{launcher}' {COMPILER}", "a path with a space": str(own), "quotes": f'"{own}" -pipe'}
    if of == "CC":
        monkeypatch.setenv("CC", commands[kind])
        check(scene, compiled(scene, tmp_path))
    else:
        check(scene, compiled(scene, tmp_path, compiler=commands[kind]))


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("no-such-compiler -pipe", "compiler: found no no-such-compiler -pipe; expected a C compiler"),
        ("'unfinished", "compiler: found \"'unfinished\", which is no command"),
        ("{folder}/data", r"compiler: found that .*data cannot be run \(.*\); expected GCC or Clang"),
        ("true", "compiler: found that .*true failed: exit code 0, and no library"),
    ],
)
def test_commands_that_are_none_are_refused(scene: phipsi.Scene, tmp_path: Path, command: str, message: str) -> None:
    data = tmp_path / "data"
    data.write_bytes(b"\x00\x01")
    data.chmod(0o755)
    with pytest.raises(ArgumentError, match=message):
        compiled(scene, tmp_path, compiler=command.format(folder=tmp_path))


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="no groups of processes")
def test_an_interrupted_compiler_ends_and_leaves_no_files(scene: phipsi.Scene, tmp_path: Path, interruptible: None) -> None:
    """With its child processes, which do not receive Ctrl-C."""
    child, cache = tmp_path / "child", tmp_path / "cache"
    text = f"""if [ "$1" = --version ]; then echo 1; exit; fi
touch "${{TMPDIR:-/tmp}}/left-behind"
sleep 1000 & echo $! > {child}.new; mv {child}.new {child}; wait"""
    compiler = script(tmp_path / "compiler", text)

    def interrupt() -> None:
        until = time.monotonic() + PATIENCE
        while not child.exists() and time.monotonic() < until:
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt, daemon=True)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        compiled(scene, cache, compiler=str(compiler))
    join(thread)
    assert child.exists()
    assert [path for path in cache.rglob("*") if path.is_file()] == []
    until = time.monotonic() + PATIENCE
    while is_alive(int(child.read_text())) and time.monotonic() < until:
        time.sleep(0.01)
    assert not is_alive(int(child.read_text()))


def is_alive(process: int) -> bool:
    """Whether a process runs; a zombie does not."""
    if sys.platform == "linux":
        try:
            return Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] not in "ZX"
        except FileNotFoundError:
            return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.parametrize("options", [{}, {"form": "covariance"}, {"dtype": "float32"}])
def test_compiled_robots_pickle(scene: phipsi.Scene, tmp_path: Path, options: dict[str, str]) -> None:
    link = scene.link_names[-1]
    fast = phipsi.compile(scene, ["forward_dynamics", ("placement", link)], flags=["-O0"], cache=tmp_path, **options)  # type: ignore[call-overload]
    again = pickle.loads(pickle.dumps(fast))
    assert (again.library, again.form, again.dtype, again.functions) == (fast.library, fast.form, fast.dtype, fast.functions)
    q, qd, tau = np.random.default_rng(0).uniform(-1, 1, (3, 300, 2)).astype(fast.dtype)
    assert_same_bits(again.forward_dynamics(q, qd, tau), fast.forward_dynamics(q, qd, tau))
    assert_same_bits(again.placement(q, link), fast.placement(q, link))
    # On another machine, or with an empty cache, it is compiled again.
    shutil.rmtree(tmp_path)
    rebuilt = pickle.loads(pickle.dumps(again))
    assert rebuilt.library == fast.library and rebuilt.library.exists()
    assert_same_bits(rebuilt.forward_dynamics(q, qd, tau), fast.forward_dynamics(q, qd, tau))
