"""Unpack a source distribution in its folder, and fail if files are missing or superfluous.

Usage: python .ci/check_sdist.py target/sdist/phipsi-1.2.3.tar.gz

The expected files are those in git below the folders in EXPECTED.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
from fnmatch import fnmatch
from pathlib import Path

TREE = Path(__file__).parents[1]

# Patterns of files in git; * matches across folders.
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
# The tests of pages read pictures, which are only in the repository.
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
        print(f"{archive.name}: {file} is superfluous")
    if found != expected:
        sys.exit("change `include` in Cargo.toml or pyproject.toml, or EXPECTED in .ci/check_sdist.py; every file must be in git")
    print(f"{archive.name}: {len(found)} files, {archive.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
