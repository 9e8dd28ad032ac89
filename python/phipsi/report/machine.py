"""Hardware and software of a measurement."""

from __future__ import annotations

import os
import platform
import subprocess
from pathlib import Path

import numpy as np

from .. import __version__


def describe() -> dict[str, str | int | None]:
    """Processor, system and versions; None if unknown."""
    repository = _repository()
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "os": f"{platform.system()} {platform.release()} ({platform.machine()})",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "phipsi": __version__,
        "commit": _output(repository, "git", "rev-parse", "--short=12", "HEAD"),
        "compiler": _output(repository, "rustc", "--version"),
    }


def _cpu() -> str | None:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    if platform.system() == "Darwin":
        return _output(Path.cwd(), "sysctl", "-n", "machdep.cpu.brand_string")
    return platform.processor() or None


def _repository() -> Path | None:
    """Checkout of phipsi that contains this installation, if any."""
    for folder in Path(__file__).resolve().parents:
        manifest = folder / "Cargo.toml"
        if manifest.is_file() and 'name = "phipsi"' in manifest.read_text(errors="replace"):
            return folder
    return None


def _output(folder: Path | None, *command: str) -> str | None:
    """First line of the output of a command in a folder; None without a folder, and if the command fails."""
    if folder is None:
        return None
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip().splitlines()[0] if done.stdout.strip() else None
