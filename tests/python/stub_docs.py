"""Copy the docstrings of the compiled module into the stub `_core.pyi`: `python stub_docs.py STUB...`."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path

from phipsi import _core


def with_docs(stub: str) -> str:
    """The stub with the docstrings of the imported module, for all public names and the first of several overloads."""
    lines = stub.splitlines()
    for node, doc in reversed(list(_documented(ast.parse(stub).body, _core))):
        own, *rest = doc.splitlines()
        indent = " " * (node.col_offset + 4)
        text = [f'"""{own}', *rest, '"""'] if rest else [f'"""{own}"""']
        text = [(indent + line).rstrip() for line in text]
        first = node.body[0]
        if ast.get_docstring(node) is not None:
            lines[first.lineno - 1 : first.end_lineno] = text
        elif isinstance(node, ast.ClassDef):
            lines[first.lineno - 1 : first.lineno - 1] = [*text, ""]
        else:
            lines[first.lineno - 1 : first.lineno] = [lines[first.lineno - 1].removesuffix(" ..."), *text]
    return "\n".join(lines) + "\n"


def _documented(
    nodes: list[ast.stmt], owner: object
) -> Iterator[tuple[ast.ClassDef | ast.FunctionDef, str]]:
    """Classes, functions and methods in the order of the stub, each with its docstring."""
    seen = set()
    for node in nodes:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_") and node.name not in seen:
            seen.add(node.name)
            thing = getattr(owner, node.name)
            yield node, inspect.getdoc(thing) or ""
            if isinstance(node, ast.ClassDef):
                yield from _documented(node.body, thing)


if __name__ == "__main__":
    for path in map(Path, sys.argv[1:]):
        path.write_text(with_docs(path.read_text(encoding="utf-8")), encoding="utf-8")
