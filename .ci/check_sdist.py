"""Unpacks a source distribution beside itself, and fails where it has too much or too little: python .ci/check_sdist.py target/sdist/phipsi-1.2.3.tar.gz

What it should have is what git has of the folders below. Built again from what it unpacks to, it is the same module.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
from fnmatch import fnmatch
from pathlib import Path

TREE = Path(__file__).parents[1]

# Of files that git has; * goes across folders.
EXPECTED = (
    "CHANGELOG.md",
    "Cargo.lock",
    "Cargo.toml",
    "LICENSE-*",
    "PACKAGE.md",
    "README.md",
    "assets/*",
    "benches/*.py",
    "benches/*.rs",
    "docs/*.md",
    "examples/*",
    "pyproject.toml",
    "python/*",
    "src/*",
    "tests/*",
)
# The tests of pages read pictures, which are in the repository only.
LEFT_OUT = ("tests/python/test_docs.py",)
MADE = ("PKG-INFO",)


def main(archive: Path) -> None:
    name = archive.name.removesuffix(".tar.gz")
    shutil.rmtree(archive.parent / name, ignore_errors=True)
    with tarfile.open(archive) as packed:
        found = {member.name.removeprefix(f"{name}/") for member in packed.getmembers() if member.isfile()}
        packed.extractall(archive.parent, filter="data")
    files = subprocess.run(["git", "ls-files"], cwd=TREE, capture_output=True, text=True, check=True).stdout.split("\n")
    expected = {file for file in files if any(fnmatch(file, pattern) for pattern in EXPECTED)} - set(LEFT_OUT) | set(MADE)
    for file in sorted(expected - found):
        print(f"{archive.name}: {file} is missing")
    for file in sorted(found - expected):
        print(f"{archive.name}: {file} is too much")
    if found != expected:
        sys.exit("change `include` of Cargo.toml or pyproject.toml, or EXPECTED of .ci/check_sdist.py; git must have every file")
    print(f"{archive.name}: {len(found)} files, {archive.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
