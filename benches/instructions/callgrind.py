"""Programs and their output, and instruction counts by callgrind."""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).resolve().parents[2]
#: Message of valgrind about an unsupported instruction (3.19: vmovq between registers), before the program ends.
UNKNOWN = "Unrecognised instruction"


def fail(message: str) -> NoReturn:
    sys.exit(f"{Path(sys.argv[0]).name}: {message}")


def output(command: list[str], **environment: str) -> str:
    """Output of a command, which must not fail except for an instruction that valgrind does not support."""
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | environment, capture_output=True, text=True, check=False
    )
    if UNKNOWN in done.stderr:
        return done.stderr
    if done.returncode != 0:
        fail(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    return done.stdout + done.stderr


def instructions(program: list[str], arm: str) -> int | None:
    """Instructions of one complete run on this instruction set; None if valgrind cannot run it."""
    with tempfile.TemporaryDirectory() as folder:
        valgrind = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={folder}/out"]
        said = output([*valgrind, *program], PHIPSI_INSTRUCTION_SET=arm)
    if UNKNOWN in said:
        return None
    found = re.search(r"Collected : (\d+)", said)
    if found is None:
        fail(f"callgrind counted nothing:\n{said}")
    return int(found[1])


def a_call(few: list[str], many: list[str], calls: int, arm: str) -> int | None:
    """Instructions per call, from two runs with different numbers of calls."""
    counts = [instructions(program, arm) for program in (few, many)]
    return None if None in counts else round((counts[1] - counts[0]) / calls)  # type: ignore[operator]
