"""Module structure of the Rust crate: a module uses only modules above it, and no files import each other in a circle.

Imports are followed through re-exports to the file that defines the name; those of unit tests do not count.
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

import pytest

SRC = Path(__file__).parents[2] / "src"

#: From top to bottom: each module uses only those before it.
ROOMS = (
    "error",
    "interrupt",
    "memory",
    "setters",
    "decompositions",
    "scalar",
    "spatial",
    "filter",
    "contact",
    "accuracy",
    "collision",
    "joints",
    "model",
    "kinematics",
    "algorithm",
    "scene",
    "scenes",
    "dynamics",
    "batch",
    "estimation",
    "operators",
    "api",
    "codegen",
    "inverse_kinematics",
    "stochastic",
    "motion",
    "control",
    "report",
    "plan",
    "python",
)
#: Largest number of files in one module that import each other.
LARGEST_CIRCLE = 1

Module = tuple[str, ...]
USE = re.compile(r"^[ \t]*(pub(?:\([^)]*\))? )?use ([^;]+);", re.MULTILINE)


def code(file: Path) -> str:
    """Code of a file without comments and unit tests."""
    text = re.split(r"#\[cfg\([^\n]*test[^\n]*\)\]\nmod tests", file.read_text(encoding="utf-8"))[0]
    return "\n".join(line for line in text.splitlines() if not line.strip().startswith("//"))


def names(prefix: list[str], tree: str) -> list[list[str]]:
    """Paths of an import tree, as `a::{b, c::{d, e}}`."""
    head, brace, rest = tree.strip().partition("{")
    parts = prefix + [part.strip() for part in head.split(" as ")[0].split("::") if part.strip()]
    if not brace:
        return [parts[:-1] if parts[-1:] == ["self"] and len(parts) > 1 else parts]
    found, depth, begin = [], 0, 0
    inner = rest[: rest.rindex("}")] + ","
    for at, letter in enumerate(inner):
        depth += (letter == "{") - (letter == "}")
        if letter == "," and depth == 0:
            if inner[begin:at].strip():
                found += names(parts, inner[begin:at])
            begin = at + 1
    return found


class Crate:
    """Imported files of each file."""

    def __init__(self) -> None:
        self.files: dict[Module, Path] = {}
        for file in sorted(SRC.rglob("*.rs")):
            parts = file.relative_to(SRC).with_suffix("").parts
            self.files[() if parts == ("lib",) else parts[:-1] if parts[-1] == "mod" else parts] = file
        self.exported: dict[Module, dict[str, list[str]]] = defaultdict(dict)
        used: dict[Module, list[list[str]]] = defaultdict(list)
        for module, file in self.files.items():
            text = code(file)
            for visible, tree in USE.findall(text):
                for path in names([], tree):
                    target = self.absolute(module, path)
                    if target is None:
                        continue
                    if visible:
                        self.exported[module][path[-1]] = target
                    else:
                        used[module].append(target)
            used[module] += [[part for part in path.split("::") if part] for path in re.findall(r"crate::([\w:]+)", USE.sub("", text))]
        self.imports = {
            module: {target for path in used[module] if (target := self.defining(path)) not in (None, module, ())} for module in self.files
        }

    def absolute(self, module: Module, path: list[str]) -> list[str] | None:
        """A path from the root of the crate; None for another crate."""
        if path[0] == "crate":
            return path[1:]
        if path[0] == "self":
            return [*module, *path[1:]]
        base = list(module)
        while path and path[0] == "super":
            base, path = base[:-1], path[1:]
        return [*base, *path] if len(base) < len(module) or (*module, path[0]) in self.files else None

    def defining(self, path: list[str], seen: frozenset[tuple[Module, str]] = frozenset()) -> Module | None:
        """File that defines a name."""
        for length in range(len(path), -1, -1):
            module = tuple(path[:length])
            if module not in self.files:
                continue
            if length < len(path) and (name := path[length]) in self.exported[module] and (module, name) not in seen:
                return self.defining([*self.exported[module][name], *path[length + 1 :]], seen | {(module, name)})
            return module
        return None

    def reaches(self, module: Module) -> set[Module]:
        """Files that this one imports, directly or indirectly."""
        found: set[Module] = set()
        ahead = [module]
        while ahead:
            new = self.imports[ahead.pop()] - found
            found |= new
            ahead += new
        return found


@pytest.fixture(scope="module")
def crate() -> Crate:
    if not SRC.is_dir():
        pytest.skip("the sources are not here")
    return Crate()


def test_every_room_has_its_place(crate: Crate) -> None:
    assert {module[0] for module in crate.files if module} == set(ROOMS)
    assert sum(len(targets) for targets in crate.imports.values()) > 300


def test_a_room_uses_only_rooms_above_it(crate: Crate) -> None:
    wrong = [
        f"{'::'.join(module)} uses {'::'.join(target)}"
        for module, targets in crate.imports.items()
        for target in targets
        if module and ROOMS.index(target[0]) > ROOMS.index(module[0])
    ]
    assert not wrong, wrong


def test_no_circle_of_files(crate: Crate) -> None:
    reached = {module: crate.reaches(module) for module in crate.files}
    circles = {frozenset(other for other in reached[module] if module in reached[other]) for module in crate.files}
    wrong = [sorted("::".join(module) for module in circle) for circle in circles if len(circle) > LARGEST_CIRCLE]
    assert not wrong, wrong
