"""The notebooks run from top to bottom, and are stored with output: text and pictures, without the pages of robots, which take megabytes.

``python tests/python/test_notebooks.py`` runs all notebooks and stores their output.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from page_script import same

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs" / "notebooks").glob("*.ipynb"))
NEEDED = ("ipykernel", "matplotlib", "nbclient", "nbformat", "scipy", "viser")
RUN = """
import sys, nbformat
from nbclient import NotebookClient

notebook = nbformat.read(sys.argv[1], as_version=4)
NotebookClient(notebook, timeout=300, kernel_name="python3", coalesce_streams=True).execute()
nbformat.write(notebook, sys.argv[2])
"""


def executed(path: Path, folder: Path) -> list[dict[str, Any]]:
    """Cells of a notebook after a run."""
    command = [sys.executable, "-c", RUN, str(path), str(folder / "run.ipynb")]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stderr[-4000:]
    found: list[dict[str, Any]] = json.loads((folder / "run.ipynb").read_text(encoding="utf-8"))["cells"]
    return found


def kept(cell: dict[str, Any]) -> list[dict[str, Any]]:
    """Outputs of a cell without pages."""
    return [output | ({"data": {kind: value for kind, value in output["data"].items() if kind != "text/html"}} if "data" in output else {}) for output in cell["outputs"]]


def texts(outputs: list[dict[str, Any]]) -> list[str]:
    """Texts of printed outputs, and kinds of the others."""
    return ["".join(output["text"]) if "text" in output else " ".join(sorted(set(output["data"]) - {"text/html"})) for output in outputs]


def test_there_are_notebooks() -> None:
    assert [path.stem for path in NOTEBOOKS] == ["balance", "first_steps", "learn", "see_a_robot"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run_and_store_what_they_show(path: Path, tmp_path: Path) -> None:
    if absent := [name for name in NEEDED if importlib.util.find_spec(name) is None]:
        pytest.skip(f"notebooks need {', '.join(absent)}")
    stored = json.loads(path.read_text(encoding="utf-8"))["cells"]
    for cell, ran in zip(stored, executed(path, tmp_path), strict=True):
        if cell["cell_type"] == "code":
            shown, came = texts(cell["outputs"]), texts(ran["outputs"])
            # Errors of rounding and of finite differences depend on the machine.
            assert len(shown) == len(came) and all(same(*both, 0.2) for both in zip(shown, came, strict=True)), "".join(cell["source"]) + "\npython tests/python/test_notebooks.py"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_stored_notebooks_have_pictures_and_no_pages(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    outputs = [output for cell in json.loads(text)["cells"] if cell["cell_type"] == "code" for output in cell["outputs"]]
    assert any("image/png" in output.get("data", {}) for output in outputs) and not any("text/html" in output.get("data", {}) for output in outputs)
    assert len(text) < 300_000


def test_a_notebook_displays_robots_and_nothing_else(tmp_path: Path) -> None:
    if absent := [name for name in NEEDED if importlib.util.find_spec(name) is None]:
        pytest.skip(f"notebooks need {', '.join(absent)}")
    cells = [cell for cell in executed(NOTEBOOKS[-1], tmp_path) if cell["cell_type"] == "code"]
    assert len(cells) == 3
    for cell in cells:
        (output,) = cell["outputs"]
        assert set(output["data"]) == {"image/png", "text/html", "text/plain"} and "".join(output["data"]["text/html"]).startswith("<iframe title=")


if __name__ == "__main__":
    for notebook in NOTEBOOKS:
        content = json.loads(notebook.read_text(encoding="utf-8"))
        with tempfile.TemporaryDirectory() as directory:
            ran_cells = executed(notebook, Path(directory))
        code = [(cell, ran) for cell, ran in zip(content["cells"], ran_cells, strict=True) if cell["cell_type"] == "code"]
        for number, (cell, ran) in enumerate(code, 1):
            cell["outputs"], cell["execution_count"] = kept(ran), number
        notebook.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(f"written: {notebook}")
