"""Identification on a Dask cluster of two machines: time with one and two workers, and with one that is killed. Writes a section of docs/measured/identification.md.

Usage, as root on Linux, with the interpreter that has phipsi and distributed:

    python benches/dask_workers.py [--logs 16] [--rows 60000]

Each worker is a process in a network namespace of its own, with an own address on a bridge, and one processor. Scheduler, workers and client exchange everything by TCP, as
between machines; the logs are files that all of them can read.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import distributed
import numpy as np
import phipsi
from estimation import FIT, table, write
from phipsi.estimation import Accumulator, accumulate_logs

BRIDGE, SCHEDULER = "phipsi-br", "10.77.0.1"
MACHINES = {"phipsi-a": "10.77.0.2", "phipsi-b": "10.77.0.3"}
ENVIRONMENT = os.environ | {"RAYON_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True)


@contextmanager
def network() -> Iterator[None]:
    """A bridge with the scheduler's address, and one namespace per machine."""
    ip("link", "add", BRIDGE, "type", "bridge")
    try:
        ip("address", "add", f"{SCHEDULER}/24", "dev", BRIDGE)
        ip("link", "set", BRIDGE, "up")
        for name, address in MACHINES.items():
            ip("netns", "add", name)
            ip("link", "add", f"{name}-out", "type", "veth", "peer", "name", "eth0", "netns", name)
            ip("link", "set", f"{name}-out", "master", BRIDGE, "up")
            ip("-n", name, "address", "add", f"{address}/24", "dev", "eth0")
            for link in ("lo", "eth0"):
                ip("-n", name, "link", "set", link, "up")
        yield
    finally:
        for name in MACHINES:
            subprocess.run(["ip", "netns", "delete", name], check=False)
        ip("link", "delete", BRIDGE)


@contextmanager
def process(*command: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process that ends with the block; its output is in a file for errors."""
    with tempfile.NamedTemporaryFile(prefix="phipsi-dask-", suffix=".log") as log:
        started = subprocess.Popen(command, env=ENVIRONMENT, stdout=log, stderr=subprocess.STDOUT)
        try:
            yield started
        except Exception:
            print(Path(log.name).read_text(encoding="utf-8", errors="replace"), file=sys.stderr)
            raise
        finally:
            started.kill()
            started.wait(timeout=60)


@contextmanager
def cluster(names: list[str]) -> Iterator[tuple[distributed.Client, dict[str, subprocess.Popen[bytes]]]]:
    """A scheduler, one worker per name and a client."""
    modules = [sys.executable, "-m", "distributed.cli.dask_scheduler"], [sys.executable, "-m", "distributed.cli.dask_worker"]
    with process(*modules[0], "--host", SCHEDULER, "--port", "8786", "--no-dashboard", "--no-show"):
        address, workers = f"tcp://{SCHEDULER}:8786", {}
        stack = []
        try:
            for at, name in enumerate(names):
                processor = str(at % (os.cpu_count() or 1))
                command = ["ip", "netns", "exec", name, "taskset", "-c", processor, *modules[1], address, "--host", MACHINES[name], "--nthreads", "1", "--no-nanny", "--no-dashboard"]
                stack.append(process(*command))
                workers[name] = stack[-1].__enter__()
            with distributed.Client(address, timeout=60) as client:
                client.wait_for_workers(len(names), timeout=120)
                # Imports are not part of the time.
                client.run(phipsi.get_num_threads)
                yield client, workers
        finally:
            for one in reversed(stack):
                one.__exit__(None, None, None)


def written(folder: Path, scene: phipsi.Scene, logs: int, rows: int) -> list[Path]:
    """Files of motion and torques, each with another noise."""
    base = 2 * np.pi * np.outer(np.arange(rows) / 1000.0, [0.11, 0.13, 0.17, 0.19, 0.23, 0.29, 0.31][: scene.nv])
    rates = 1000.0 * base[1]
    files = []
    for at in range(logs):
        q, qd, qdd = np.sin(base + at), rates * np.cos(base + at), -(rates**2) * np.sin(base + at)
        tau = scene.inverse_dynamics(q, qd, qdd) + 0.1 * np.random.default_rng(at).standard_normal(q.shape)
        files.append(folder / f"log{at}.npz")
        np.savez(files[-1], q=q, qd=qd, qdd=qdd, tau=tau, t=np.arange(rows) / 1000.0)
    return files


def same(one: Accumulator, other: Accumulator) -> bool:
    """True if both have the same estimates to the last bit."""
    return np.array_equal(one.identify().parameters, other.identify().parameters)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=16)
    parser.add_argument("--rows", type=int, default=60_000)
    given = parser.parse_args()
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    cases: list[list[str]] = []
    with tempfile.TemporaryDirectory() as folder, network():
        files = written(Path(folder), scene, given.logs, given.rows)
        alone = accumulate_logs(scene, files, fit=FIT)
        seconds = 0.0
        for title, names, killed in (("one worker", ["phipsi-a"], False), ("two workers", list(MACHINES), False), ("two workers, one killed", list(MACHINES), True)):
            with cluster(names) as (client, workers), warnings.catch_warnings():
                if killed:
                    # After a third of the time of the run before, with logs done, in progress and waiting.
                    threading.Timer(seconds / 3.0, workers["phipsi-b"].kill).start()
                before, begun = client.run(time.process_time), time.perf_counter()
                found = accumulate_logs(scene, files, client=client, fit=FIT)
                seconds = time.perf_counter() - begun
                processor = [f"{after - before[worker]:.1f}" for worker, after in client.run(time.process_time).items()]
            cases.append([title, f"{seconds:.1f}", ", ".join(processor), "yes" if same(found, alone) else "NO"])
    load_average = Path("/proc/loadavg").read_text(encoding="utf-8").split()[0]
    write("dask", f"""
## Two machines

`python benches/dask_workers.py --logs {given.logs} --rows {given.rows}`: {given.logs} logs of {given.rows:,} states of the bundled arm through `accumulate_logs(client=...)`. Scheduler, client and workers are processes
that communicate by TCP; each worker has a network namespace with its own address and one processor. The worker that is killed (SIGKILL, a third of the way) loses the results that it holds; the scheduler gives
these logs and its unfinished one to the other worker. Other processes use the machine too, so that times do not halve; the processor times show how the logs are divided. The load average of the machine was {load_average}.

{table(["workers", "time, s", "processor time of each worker at the end, s", "estimate identical to that of one process"], cases)}
""")


if __name__ == "__main__":
    main()
