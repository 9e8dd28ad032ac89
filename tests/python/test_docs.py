"""The pages: their Python code runs, their links are valid, and README has the results of the generated pages."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import re
from pathlib import Path

import pytest

import phipsi
import phipsi.mujoco
import phipsi.pinocchio
from method_page import TASKS, public
from method_page import page as methods
from page_script import differences, run, same, script, written
from test_example_scripts import SHORT

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*(path for folder in (".", "benches", "benches/peers") for path in (ROOT / folder).glob("*.md")), *DOCS.rglob("*.md")])
#: Optional packages: a page that needs one is skipped if it is not installed.
OPTIONAL = ("cupy", "distributed", "gymnasium", "jax", "matplotlib", "mujoco", "pinocchio", "pydrake", "scipy", "torch", "viser")


SCRIPTS = {str(page.relative_to(ROOT)): text for page in DOCS.rglob("*.md") if (text := script(page.read_text(encoding="utf-8")))}
HOW_TO = sorted((DOCS / "how-to").glob("*.md"))


def missing(text: str) -> list[str]:
    """Packages of OPTIONAL that a script needs and that are not installed."""
    modules = {name.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import) for name in node.names}
    modules |= {node.module for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom) and node.module}
    needed = {module.removeprefix("phipsi.").partition(".")[0] for module in modules} | ({"viser"} if ".show(" in text else set())
    return [name for name in OPTIONAL if name in needed and importlib.util.find_spec(name) is None]


def anchors(page: Path) -> set[str]:
    """Anchors of the headings on GitHub."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


# A separate process for each page, because JAX and Dask start threads and processes. `make test-jax` and `make
# test-optional` run the pages on JAX, PyTorch and Drake.
@pytest.mark.parametrize("page", sorted(SCRIPTS))
def test_python_blocks_run(page: str, tmp_path: Path) -> None:
    text = SCRIPTS[page]
    if absent := missing(text):
        pytest.skip(f"{page} needs {', '.join(absent)}")
    done = run(text, tmp_path, Path(page).stem)
    assert done.returncode == 0, f"{page}, whose lines these are:\n{done.stdout[-2000:]}{done.stderr[-4000:]}"
    # On the pages of tasks, a reader sees all output.
    wrong = differences((ROOT / page).read_text(encoding="utf-8"), done.stdout, every="how-to" in page)
    assert not wrong, f"python tests/python/page_script.py {page}\n" + "\n".join(wrong)


@pytest.mark.parametrize("page", HOW_TO, ids=lambda page: page.stem)
def test_a_task_has_a_picture_and_shows_output_instead_of_assertions(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    (shown,) = re.findall(r"!\[[^\]]{10,}\]\((pictures/[\w-]+\.webp|\.\./robots\.webp)\)", text)
    assert page.stem == "index" or (shown == f"pictures/{page.stem}.webp" and 1000 < (page.parent / shown).stat().st_size < 60_000)
    visible = re.sub(r"^<!-- (?:checks|picture)\n.*?^-->$", "", text, flags=re.DOTALL | re.MULTILINE)
    assert not re.findall(r"^ *assert .*", visible, flags=re.MULTILINE)
    assert page.stem == "index" or "```text" in visible


def test_all_guides_have_a_picture() -> None:
    linked = re.findall(r"\]\(([^)#:]+\.md)\)", (DOCS / "how-to" / "index.md").read_text(encoding="utf-8"))
    guides = [DOCS / "how-to" / link for link in linked if "reference" not in link] + [DOCS / f"{name}.md" for name in ("index", "tutorial", "motion", "examples")] + [ROOT / "README.md"]
    without = [page.name for page in guides if not re.search(r"!\[[^\]]{10,}\]\(\S+\.(webp|png)\)", page.read_text(encoding="utf-8"))]
    assert len(guides) > 30 and not without


def test_ten_first_jobs_are_one_page_behind_the_index() -> None:
    """README leads to the index, the index to the page; its example or function is on that page."""
    assert "(docs/how-to/index.md)" in (ROOT / "README.md").read_text(encoding="utf-8")
    jobs = re.findall(r"^\| (.*?) \| \[.*?\]\(([\w-]+\.md)(#[\w-]+)?\) \| (.*) \|$", (DOCS / "how-to" / "index.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert len(jobs) == 10
    for job, page, _, calls in jobs:
        text = (DOCS / "how-to" / page).read_text(encoding="utf-8")
        for name in re.findall(r"(?:scene|phipsi|control)\.(?!control|examples)(\w+)", calls):
            assert name in text, (job, name)
    assert all((ROOT / "python" / "phipsi" / "examples" / f"{name}.py").is_file() for name in ("hopper", "quadruped", "lift", "panda"))


def test_a_page_whose_code_or_output_is_wrong_is_found(tmp_path: Path) -> None:
    page = "# Title\n\n```python\nx = 1\nprint(x, 2.50)\n```\n\n```text\n1 2.5\n```\n\n```sh\nls\n```\n\n<!-- checks\nassert x == 2\n-->\n"
    text = script(page)
    assert text.splitlines()[3] == "x = 1" and text.splitlines()[16] == "assert x == 2" and "ls" not in text
    done = run(text, tmp_path, "wrong")
    assert "AssertionError" in done.stderr and not differences(page, done.stdout, True)
    assert "the page shows\n1 2.9\nfound\n1 2.5" in differences(page.replace("1 2.5\n", "1 2.9\n"), done.stdout, True)[0]
    assert "does not show" in differences(page.replace("```text", "```txt"), done.stdout, True)[0]
    assert written(page.replace("1 2.5\n", "0 2.9\n"), done.stdout) == page


def test_numbers_of_output_agree_within_a_tolerance() -> None:
    assert same("a 1.00 b  [-0. 2]", "a 1.01 b [0. 2]", 0.0) and same("100.0", "101.0", 0.01)
    assert not same("1.00", "1.03", 0.01) and not same("3", "4", 0.1) and not same("a 1", "b 1", 1.0) and not same("1 2", "1", 1.0)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if not link.startswith(("http://", "https://")):
            path, _, anchor = link.partition("#")
            target = (page.parent / path).resolve() if path else page
            assert target.exists(), f"{link}: no such file"
            assert not anchor or anchor in anchors(target), f"{link}: no such heading"


def test_the_reference_has_all_that_is_public() -> None:
    named = re.findall(r"^::: phipsi\.(\S+)$", "\n".join(page.read_text(encoding="utf-8") for page in (DOCS / "reference").glob("*.md")), flags=re.MULTILINE)
    expected = {name for name in (*phipsi.__all__, "compile") if name not in ("__version__", "control", "errors", "estimation", "scenes", "shapes", "tasks")}
    expected |= {name.capitalize() if "." in name else f"Scene.{name}" for name in public()}
    expected |= {f"{module.__name__.removeprefix('phipsi.')}.{name}" for module in (phipsi.control, phipsi.errors, phipsi.estimation, phipsi.scenes) for name in module.__all__} - {"control.Term"}
    shown = {name for name in named if name.partition(".")[0] not in ("jax", "torch", "view")}
    expected |= {f"{module.__name__.removeprefix('phipsi.')}.{name}" for module in (phipsi.mujoco, phipsi.pinocchio, phipsi.shapes, phipsi.tasks) for name in module.__all__} - {"tasks.Task", "shapes.Color", "shapes.Shape", "shapes.ColliderShape"}
    assert len(named) == len(set(named)), "shown twice"
    assert shown == expected


def test_the_index_of_methods_is_complete() -> None:
    assert sorted(name for names in TASKS.values() for name in names) == sorted(public())
    text = (DOCS / "reference" / "methods.md").read_text(encoding="utf-8")
    assert text == methods(), "python tests/python/method_page.py docs/reference/methods.md"
    assert all(len(line.split("|")[2].split()) >= 2 for line in text.splitlines() if line.startswith("| ["))


def test_the_page_of_motion_groups_every_argument() -> None:
    (table,) = re.findall(r"^\| group \| arguments \|\n.*?\n\n", (DOCS / "motion.md").read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    named = re.findall(r"`(\w+)`", table)
    assert sorted(named) == sorted(name for name in inspect.signature(phipsi.Scene.simulate).parameters if name != "self")


def test_the_page_of_examples_shows_all_of_them() -> None:
    page = (DOCS / "examples.md").read_text(encoding="utf-8")
    assert set(re.findall(r"pictures/(\w+)\.webp", page)) == set(SHORT) == {path.stem for path in (DOCS / "pictures").iterdir()}
    assert set(re.findall(r"examples/(\w+)\.py", page)) >= {path.stem for path in (ROOT / "python" / "phipsi" / "examples").glob("[!_]*.py")}


def test_the_benchmark_page_counts_every_kind_of_comparison() -> None:
    """Kinematics can be measured apart from the rest of the page."""
    page = (DOCS / "measured" / "benchmarks.md").read_text(encoding="utf-8")
    stated = re.findall(r"phipsi is slower (?:than a peer )?in (\d+) of (\d+) comparisons", page)
    counts = {name: (lost, of) for name, of, lost in re.findall(r"^\| ((?:C\+\+|Python)[^|]*) \| (\d+) \| (\d+) \|$", page.split("\n### ")[0], flags=re.MULTILINE)}
    assert stated == [tuple(str(sum(int(row[k]) for row in counts.values())) for k in (0, 1)), counts["Python, kinematics"]]


def test_readme_has_the_figures_of_the_generated_pages() -> None:
    specification = importlib.util.spec_from_file_location("readme", ROOT / "benches" / "readme.py")
    assert specification is not None and specification.loader is not None
    readme = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(readme)
    text = readme.README.read_text(encoding="utf-8")
    assert readme.written(text) == text
    package = readme.PACKAGE.read_text(encoding="utf-8")
    assert package == readme.packaged(text), "PACKAGE.md is not README.md's: python benches/readme.py"
    assert all(link.startswith("http") for link in re.findall(r"\]\(([^)]*)\)", package))
    assert "pip install" in package and "make report" not in package and "<!--" not in package


@pytest.mark.parametrize("word", ["LQR", "grasp", "video", "GIF", "keyframe", "SolidWorks"])
def test_words_that_people_search_lead_to_a_page_of_a_task(word: str) -> None:
    """The search of the site finds whole words of the text of a page."""
    found = [page for page in (*HOW_TO, DOCS / "view.md") if re.search(rf"\b{word}s?\b", re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL))]
    assert found
