"""The Python code of README runs."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

README = Path(__file__).parents[2] / "README.md"


def test_a_visitor_reads_it_in_a_few_minutes() -> None:
    assert len(README.read_text(encoding="utf-8").split()) <= 900


def test_python_block_runs() -> None:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) == 1
    names: dict[str, object] = {}
    exec(compile(blocks[0], str(README), "exec"), names)
    assert np.isfinite(names["path"].q).all() and names["qdd"].shape == names["tau"].shape  # type: ignore[attr-defined]
