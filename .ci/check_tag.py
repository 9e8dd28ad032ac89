"""Check that a tag is "v" and the version of Cargo.toml and CITATION.cff, and that CHANGELOG.md has the date of that
version.

Usage: python .ci/check_tag.py v1.2.3
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

TREE = Path(__file__).parents[1]


def main(tag: str) -> None:
    found = re.search(r'^version = "(.*)"$', (TREE / "Cargo.toml").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert found, 'Cargo.toml has no line version = "..."'
    version = found[1]
    if tag != f"v{version}":
        sys.exit(f"tag: found {tag}, expected v{version}: change the version in Cargo.toml, or tag another commit")
    if f"\nversion: {version}\n" not in (TREE / "CITATION.cff").read_text(encoding="utf-8"):
        sys.exit(f"CITATION.cff: expected the line version: {version}: write it")
    heading = re.search(rf"^## {re.escape(version)}, (.*)$", (TREE / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    if not heading or not re.fullmatch(r"\d{4}-\d\d-\d\d", heading[1]):
        sys.exit(f"CHANGELOG.md: found {heading[0] if heading else 'no heading'}, expected ## {version}, YYYY-MM-DD: write the date")


if __name__ == "__main__":
    main(sys.argv[1])
