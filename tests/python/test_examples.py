"""The examples run as they stand."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

PAPER = Path(__file__).parents[2] / "examples" / "paper.py"
LAST = {"0": 2, "1": 7, "2": 11, "3": 14, "4": 11, "5": 7, "6": 4}
"""The last equation of each section of the paper; 0 is its introduction."""


def test_paper_shows_every_equation() -> None:
    run = subprocess.run([sys.executable, str(PAPER)], capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr
    scenes = run.stdout.split("degrees of freedom")[1:]
    assert len(scenes) == 3
    every = {f"{section}.{i}" for section, last in LAST.items() for i in range(1, last + 1)}
    for scene in scenes:
        shown = set(re.findall(r"^ +(\d\.\d+) +\d\.\de[+-]\d\d  ", scene, flags=re.MULTILINE))
        assert shown == every
        assert scene.count("as printed") >= 15


def test_mppi_brings_the_arm_towards_its_goal() -> None:
    command = [sys.executable, str(PAPER.with_name("mppi.py")), "--samples", "32", "--cycles", "25"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr
    before, after = (float(x) for x in re.findall(r"(\d\.\d+) m from", run.stdout))
    assert after < 0.5 * before
    assert "thousand states a second" in run.stdout
