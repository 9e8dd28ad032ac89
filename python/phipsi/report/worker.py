"""Ways to the mass matrix, timed in a process of their own: the number of threads is read once a process."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._core import Scene
from .measure import Tick

#: The whole child: it has the parent's modules and answers one line a job.
CHILD = """
import json, pickle, sys
sys.path[:] = pickle.load(sys.stdin.buffer)
scene, q, jobs = pickle.load(sys.stdin.buffer)
from phipsi._core import emergence
for job in jobs:
    print(json.dumps(emergence(scene, q, *job)), flush=True)
"""


class Job(NamedTuple):
    """What `_core.emergence` is asked: samples and seed mean something to the sampling routes only."""

    route: str
    samples: int = 1
    seed: int = 0
    repeats: int = 1


class WorkerError(RuntimeError):
    """The process could not be started, or ended before its work was done."""


def run(
    scene: Scene, q: NDArray[np.float64], jobs: Sequence[Job], threads: int, tick: Tick
) -> list[tuple[float, float]]:
    """(median ns, relative error) of each job, in a process with so many threads."""
    environment = {**os.environ, "RAYON_NUM_THREADS": str(threads)}
    command = [sys.executable or "python3", "-I", "-c", CHILD]
    pipe = subprocess.PIPE
    try:
        child = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, env=environment)
    except OSError as error:
        raise WorkerError(f"a process of {command[0]} could not be started: {error}") from None
    with child:
        try:
            return _talk(
                child, pickle.dumps(sys.path) + pickle.dumps((scene, q, [tuple(job) for job in jobs])), jobs, tick
            )
        except BaseException:
            child.kill()
            raise


def _talk(child: subprocess.Popen[bytes], task: bytes, jobs: Sequence[Job], tick: Tick) -> list[tuple[float, float]]:
    assert child.stdin is not None and child.stdout is not None and child.stderr is not None
    try:
        child.stdin.write(task)
        child.stdin.close()
    except BrokenPipeError:
        pass  # It ended early: what it said is read below.
    answers = []
    for line in child.stdout:
        ns, error = json.loads(line)
        answers.append((float(ns), float(error)))
        tick()
    if len(answers) == len(jobs):
        return answers
    said = child.stderr.read().decode(errors="replace").strip().splitlines() or ["it said nothing"]
    raise WorkerError(f"the process that measures ended after {len(answers)} of {len(jobs)} jobs: {said[-1]}")
