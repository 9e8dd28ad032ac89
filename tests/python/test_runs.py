"""Runs of the tests: each of them ends, also where SIGINT is ignored, and no test is skipped everywhere in silence."""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import OUTCOMES

ROOT = Path(__file__).parents[2]
CONFTEST = Path(__file__).with_name("conftest.py")
#: Methods that wait for ever without an argument.
WAITS = ("communicate", "get", "join", "result", "wait")


def run(folder: Path, source: str, *, name: str = "test_one.py", limit: float = 60.0, **environment: str) -> subprocess.CompletedProcess[str]:
    """Runs pytest on one file with the conftest.py of this folder and another limit of the time."""
    conftest = CONFTEST.read_text(encoding="utf-8")
    assert conftest.count("\nHANGING = 1800\n") == 1
    (folder / "conftest.py").write_text(conftest.replace("\nHANGING = 1800\n", f"\nHANGING = {limit}\n"), encoding="utf-8")
    (folder / name).write_text(source, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", ".", "-c", os.devnull, name]
    return subprocess.run(command, cwd=folder, env={**os.environ, OUTCOMES: "", **environment}, capture_output=True, text=True, timeout=300, check=False)


#: In another environment this has to be installed.
OPTIONAL = """
import os, pytest

def test_that_runs(): pass

@pytest.mark.parametrize("kind", "ab")
def test_with_a_package(kind):
    if os.environ.get("INSTALLED") != "yes":
        pytest.skip(f"{kind} is not installed")

@pytest.mark.xfail
def test_that_fails(): raise ValueError
"""
WHOLE = "import pytest\npytest.importorskip('no_such_package')\n"


@pytest.mark.skipif(not (ROOT / ".ci").is_dir(), reason="not in the source distribution")
@pytest.mark.parametrize("source", [OPTIONAL, WHOLE], ids=["tests", "file"])
def test_a_test_that_no_environment_runs_is_found(source: str, tmp_path: Path) -> None:
    outcomes = tmp_path / "outcomes"

    def checked() -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, ROOT / ".ci/check_skips.py", outcomes], capture_output=True, text=True, timeout=60, check=False)

    assert checked().returncode == 1
    tests = {OUTCOMES: str(outcomes)}
    ended = run(tmp_path, source, **tests)
    run(tmp_path, "def test_another(): pass", name="test_other.py", **tests)
    found = checked()
    assert found.returncode == 1 and "NOT EXPLAINED" in found.stdout, ended.stdout + ended.stderr + found.stdout
    assert ("b is not installed" if source == OPTIONAL else "no_such_package") in found.stdout
    assert "test_that" not in found.stdout
    run(tmp_path, OPTIONAL, INSTALLED="yes", **tests)
    assert checked().returncode == 0


@pytest.mark.parametrize("waiting", ["time.sleep(600)", "threading.Lock().acquire(); lock = threading.Lock(); lock.acquire(); lock.acquire()"])
def test_a_test_that_hangs_ends_the_run_and_is_named(waiting: str, tmp_path: Path) -> None:
    ended = run(tmp_path, f"import threading, time\n\ndef test_that_hangs():\n    {waiting}\n", limit=2.0)
    assert ended.returncode == 1 and "Timeout" in ended.stderr and "test_that_hangs" in ended.stderr, ended.stdout + ended.stderr


@pytest.mark.skipif(os.name == "nt", reason="signals to oneself")
def test_the_handler_of_a_test_is_its_own_where_sigint_is_ignored(tmp_path: Path) -> None:
    source = "import os, pytest, signal, subprocess, sys, time\n\ndef test_interrupts(interruptible):\n    with pytest.raises(KeyboardInterrupt):\n"
    source += "        os.kill(os.getpid(), signal.SIGINT)\n        time.sleep(60)\n\n"
    source += "def test_that_it_is_ignored():\n    assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN\n"
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        ended = run(tmp_path, source)
    finally:
        signal.signal(signal.SIGINT, before)
    assert ended.returncode == 0 and "2 passed" in ended.stdout, ended.stdout + ended.stderr


def endless(source: str) -> list[str]:
    """Calls that wait for a thread, a process or a result without a limit of the time."""
    found = []
    for call in ast.walk(ast.parse(source)):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute) and not any(word.arg == "timeout" for word in call.keywords):
            is_run = ast.unparse(call.func) == "subprocess.run"
            if is_run or (call.func.attr in WAITS and not call.args and not call.keywords):
                found.append(f"line {call.lineno}: {ast.unparse(call)}")
    return found


def test_every_wait_of_a_test_or_benchmark_has_a_timeout() -> None:
    assert len(endless("thread.join()\nevent.wait(timeout=3)\nsubprocess.run(command, check=True)\n' '.join(words)\n")) == 2
    found = {path.name: waits for path in CONFTEST.parent.glob("*.py") if (waits := endless(path.read_text(encoding="utf-8")))}
    # Programs that a benchmark builds or runs may take any time.
    for path in (ROOT / "benches").rglob("*.py"):
        if waits := [wait for wait in endless(path.read_text(encoding="utf-8")) if "subprocess.run(" not in wait]:
            found[path.name] = waits
    assert not found
