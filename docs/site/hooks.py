"""Hooks of MkDocs: pages of the repository outside docs/ become pages of the site, and notebooks too.

A page links to `../python/phipsi/examples/balance.py` or `../benches/README.md` as the files lie in the repository, so that the links work wherever the
repository is read. Here those files are pages, and links to them are turned to these.
"""

from __future__ import annotations

import importlib.util
import os
import re
from pathlib import Path, PurePosixPath
from typing import Any

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
#: Files outside docs/ that are pages of the site, by the page that they become.
TEXTS = {
    "CONTRIBUTING.md": "project/contributing.md",
    "CHANGELOG.md": "project/changes.md",
    "benches/README.md": "project/benches.md",
    "benches/peers/README.md": "project/peers.md",
    "README.md": "project/readme.md",
}
EXAMPLES = {f"python/phipsi/examples/{path.name}": f"examples/{path.stem}.md" for path in sorted((ROOT / "python/phipsi/examples").glob("[!_]*.py"))}
NOTEBOOKS = {f"docs/notebooks/{path.name}": f"notebooks/{path.stem}.md" for path in sorted((ROOT / "docs/notebooks").glob("*.ipynb"))}
PAGES = {**TEXTS, **EXAMPLES, **NOTEBOOKS}
LINK = re.compile(r"(?<=\]\()([^)\s#]+)(?=[)#])")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that are not in docs/."""
    for source, page in TEXTS.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    for source, page in EXAMPLES.items():
        files.append(File.generated(config, page, content=_example(ROOT / source)))
    for source, page in NOTEBOOKS.items():
        files.append(File.generated(config, page, content=_notebook(ROOT / source)))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Turns links to files of the repository to the pages that these are."""
    back = {own: source for source, own in PAGES.items()}
    here = PurePosixPath(back.get(page.file.src_uri, f"docs/{page.file.src_uri}")).parent
    folder = PurePosixPath(page.file.src_uri).parent

    def turned(found: re.Match[str]) -> str:
        link = found[1]
        if re.match(r"\w+:", link):
            return link
        file = os.path.normpath(here / link)
        target = PAGES.get(file) or (file.removeprefix("docs/") if file.startswith("docs/") else None)
        return link if target is None else os.path.relpath(target, folder)

    if page.file.src_uri == "reference/methods.md":
        # On GitHub a row leads to the page, here to the method.
        markdown = re.sub(r"\[`(\w+)`\]\(([\w-]+\.md)\)", r"[`\1`](\2#phipsi.Scene.\1)", markdown)
    if page.file.src_uri in ("index.md", "tutorial.md"):
        page.meta["hide"] = ["navigation"]  # sections of one page
    # Code and embedded pages have no links.
    parts = re.split(r"(^```.*?^```$|^<iframe [^\n]*$)", markdown, flags=re.DOTALL | re.MULTILINE)
    return "".join(part if part.startswith(("```", "<iframe ")) else LINK.sub(turned, part) for part in parts)


def on_post_build(config: MkDocsConfig) -> None:
    """Ends the build where a page asks another host for something."""
    for page in Path(config.site_dir).rglob("*.html"):
        for tag in re.findall(r"<(?:script|link|img|iframe|source)\b[^>]*>", page.read_text(encoding="utf-8")):
            if re.search(r"""\b(?:src|href)=["']?(?:https?:)?//""", tag):
                raise PluginError(f"{page}: {tag} asks another host; expected files of the site only")


def _example(path: Path) -> str:
    """A page of an example: what its docstring begins with, and the file."""
    text = path.read_text(encoding="utf-8")
    title, _, rest = text.removeprefix('"""').partition("\n")
    return f"# {path.name}\n\n{title}\n\n```sh\npython -m phipsi.examples {path.stem}\n```\n\n````python\n{text}````\n"


def _notebook(path: Path) -> str:
    """A page of a notebook, run where phipsi can be imported."""
    notebook = nbformat.read(path, as_version=4)
    if runs := importlib.util.find_spec("phipsi") is not None:
        from nbclient import NotebookClient

        NotebookClient(notebook, timeout=300, kernel_name="python3", extra_arguments=["--IPKernelApp.log_level=40"]).execute()
    note = "" if runs else "\n\nNot run: phipsi could not be imported where this page was made.\n\n"
    about = f"[{path.name}]({path.name}){{download}} is the notebook itself."
    cells = [_cell(cell) for cell in notebook.cells]
    return "\n\n".join([cells[0], about + note, *cells[1:]]) + "\n"


def _cell(cell: Any) -> str:
    if cell.cell_type == "markdown":
        return str(cell.source)
    return "\n\n".join([f"```python\n{cell.source}\n```", *(_output(output) for output in cell.get("outputs", []))])


def _output(output: Any) -> str:
    if output.output_type == "stream":
        return f"```text\n{output.text.rstrip()}\n```"
    data = output.get("data", {})
    # The page of a robot rather than its picture.
    if data.get("text/html", "").startswith("<iframe"):
        # In one line, so that Markdown passes it on as it is.
        return str(data["text/html"]).replace("\n", "&#10;")
    if "image/png" in data:
        return f'<img alt="what the cell draws" src="data:image/png;base64,{data["image/png"].strip()}">'
    if "text/html" in data:
        return str(data["text/html"])
    return f"```text\n{data['text/plain']}\n```"
