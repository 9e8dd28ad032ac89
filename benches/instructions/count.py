"""Count the instructions of every algorithm with callgrind, and fail if one needs more than before: `make
instructions`.

Usage: python3 benches/instructions/count.py [--update] [--binary PATH]

Each case (a scene of tests/common/gate.rs and an algorithm) runs twice, with different numbers of calls; the
difference belongs to the calls alone. Counts are compared with those of expected.json in this folder: more than 3 %
above is a failure, more than 3 % below is reported. They depend on the compiler: with another rustc than the one in
expected.json nothing is compared. --update rewrites the file.

Instruction sets: baseline and avx2 (valgrind does not support AVX-512); one state, and with avx2 also four, which
fill a register.
"""

import argparse
import concurrent.futures
import json
import os
import re
import shutil
from pathlib import Path

from callgrind import ROOT, a_call, fail, output

EXPECTED = Path(__file__).with_name("expected.json")
#: Numbers of calls of the shorter and of the longer run.
REPEATS = (4, 24)
#: (instruction set, states per call).
RUNS = (("baseline", 1), ("avx2", 1), ("avx2", 4))
SLACK = 0.03


def built() -> str:
    """Path of the bench, after building it."""
    command = ["cargo", "bench", "--locked", "--no-run", "--features", "urdf,parallel,dense,stochastic,avx512"]
    found = re.search(r"\(([^)]*instructions-[0-9a-f]+)\)", output([*command, "--bench", "instructions"]))
    if found is None:
        fail("cargo does not say where it put the bench")
    return str(ROOT / found[1])


def of_case(binary: str, arm: str, case: str, states: int) -> int | None:
    """Instructions per call; None if valgrind does not support one of them."""
    few, many = ([binary, "count", *case.split(), str(states), str(repeats)] for repeats in REPEATS)
    return a_call(few, many, REPEATS[1] - REPEATS[0], arm)


def counted(binary: str) -> dict[str, int | None]:
    """Instructions per call, by case; None if valgrind does not support one of them."""
    listed = output([binary, "list"]).splitlines()
    cases = [(arm, case, states) for arm, states in RUNS for case in listed]
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        counts = pool.map(lambda case: of_case(binary, *case), cases)
    return {f"{arm}/{states}/{case.replace(' ', '/')}": count for (arm, case, states), count in zip(cases, counts, strict=True)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--update", action="store_true", help="write expected.json from what is counted now")
    parser.add_argument("--binary", help="the bench where it is built already")
    options = parser.parse_args()
    if shutil.which("valgrind") is None:
        fail("valgrind is not here (Debian: apt-get install valgrind)")
    compiler = output(["rustc", "--version"]).strip()
    stored = json.loads(EXPECTED.read_text(encoding="utf-8")) if EXPECTED.exists() else {}
    if not options.update and stored.get("rustc") != compiler:
        print(f"skipped: expected.json was counted with {stored.get('rustc')}, this is {compiler}; --update counts anew")
        return
    counts = counted(options.binary or built())
    if options.update:
        content = {"rustc": compiler, "instructions a call": counts}
        EXPECTED.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        print(f"written: {EXPECTED}")
        return
    expected = stored["instructions a call"]
    if expected.keys() != counts.keys():
        fail(f"not the cases of expected.json: {', '.join(sorted(expected.keys() ^ counts.keys()))}; run with --update")
    worse = 0
    for case, count in counts.items():
        if count is None or expected[case] is None:
            print(f"{case:56} not compared: valgrind lacks an instruction of it, here or where it was counted")
            continue
        ratio = count / expected[case]
        mark = "MORE" if ratio > 1 + SLACK else "less" if ratio < 1 - SLACK else ""
        worse += mark == "MORE"
        print(f"{case:56} {count:8} of {expected[case]:8} {100 * ratio - 100:+6.1f} % {mark}")
    if worse:
        fail(
            f"{worse} of {len(counts)} take over {SLACK:.0%} more instructions than before. Find out why; if it is worth it, "
            "run benches/instructions/count.py --update and say why in the commit."
        )
    print("no algorithm takes more instructions than before; --update keeps what became less")


if __name__ == "__main__":
    main()
