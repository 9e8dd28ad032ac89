"""Fails if a test was skipped in every environment of .ci/run without an explanation.

Usage: python .ci/check_skips.py FOLDER, with the files that tests/python/conftest.py writes into PHIPSI_TEST_OUTCOMES.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

#: Pattern of "test: reason" of tests that no environment runs, and why it cannot.
EXPLAINED = {
    r"\[docs/how-to/cuda\.md\]: .* needs cupy": "CuPy needs a GPU; test_codegen_cuda.py runs the kernels on the CPU and compiles them by NVRTC",
    r"^test_docstrings\.py::test_examples_run\[CompiledForCuda\]: ": "the example needs a GPU",
    r"^test_accuracy\.py::.*: nothing moves$": "robots of one rigid body, which has no joint where the base is fixed",
    r"^test_compile_cache\.py::.*: root may write everywhere": "CI on a machine of its own runs as root, on GitHub as another user",
    r"^test_compile_owner\.py::.*: only root gives files away": "the same, the other way round",
    r": no Chromium is installed$": "a machine without the Debian package; .ci/run tries to install it",
    r": no arm-none-eabi-gcc here$": "a machine without the Debian package; .ci/run tries to install it",
}


def skipped(runs: list[dict[str, str]]) -> dict[str, str]:
    """Reason by test that no run ran. A file that was skipped as a whole counts as run if another run ran one of its tests."""
    ran = {test for run in runs for test, reason in run.items() if not reason}
    ran |= {test.partition("::")[0] for test in ran}
    return {test: reason.removeprefix("Skipped: ") for run in runs for test, reason in run.items() if test not in ran}


def main(folder: str) -> int:
    runs = [json.loads(file.read_text(encoding="utf-8")) for file in sorted(Path(folder).glob("*.json"))]
    if not any(reason == "" for run in runs for reason in run.values()):
        print(f"{folder}: found no test that ran; expected files of PHIPSI_TEST_OUTCOMES")
        return 1
    never = skipped(runs)
    faults = 0
    for test, reason in sorted(never.items()):
        why = next((why for pattern, why in EXPLAINED.items() if re.search(pattern, f"{test}: {reason}")), None)
        faults += why is None
        print(f"skipped in each of {len(runs)} runs: {test}: {reason} ({why or 'NOT EXPLAINED'})")
    if faults:
        print(f"{faults} tests never run: install what they need in an environment of .ci/run, or explain them in .ci/check_skips.py")
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
