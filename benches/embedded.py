"""Flash, stack and instructions per call of generated C code on a Cortex-M4F, counted by an emulator.

Usage: python benches/embedded.py [--markdown FILE]; `make embedded`. Needs arm-none-eabi-gcc with newlib, and
qemu-system-arm (Debian: gcc-arm-none-eabi, libnewlib-arm-none-eabi, qemu-system-arm).

Flash is the text section of the object file with constants; stack is the compiler's value for the function itself.
Instructions are those of QEMU, which counts one nanosecond per instruction, read from the timer of the processor
around a loop.
"""

import argparse
import re
import subprocess
import tempfile
from pathlib import Path

import phipsi
from in_turns import write
from robots import load

EXAMPLE = Path(__file__).resolve().parents[1] / "examples/cortex_m"
#: File, and whether it has a floating base.
CASES = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", False),
    "panda": ("panda_description/urdf/panda.urdf", False),
    "solo12": ("solo_description/robots/solo12.urdf", True),
}
#: Inputs and outputs of each function.
FUNCTIONS = {"forward_dynamics": "q, v, v, out", "inverse_dynamics": "q, v, v, out", "bias_torque": "q, v, out"}
CHIP = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
FLAGS = ["-std=c99", "-ffp-contract=fast", "-fno-math-errno", "-ffunction-sections", *CHIP]
LINKED = ["-T", str(EXAMPLE / "memory.ld"), "-nostartfiles", "-Wl,--gc-sections", "--specs=rdimon.specs", "-DSEMIHOSTING"]
LEVELS = ("-Os", "-O2")
#: External symbols that the code may use.
ASKED = {"sinf", "cosf", "sqrtf"}
CALLS = 200

LOOP = """
#include "robot.h"
#include <stdint.h>
#include <stdio.h>
/* The timer of the processor counts down, 25 MHz. */
#define CONTROL (*(volatile uint32_t *)0xE000E010)
#define RELOAD (*(volatile uint32_t *)0xE000E014)
#define NOW (*(volatile uint32_t *)0xE000E018)
int main(void)
{{
    static float q[ROBOT_NQ] = {{{neutral}}}, v[ROBOT_NV], out[ROBOT_NV + 1];
    RELOAD = 0xFFFFFF;
    NOW = 0;
    CONTROL = 5;
    const uint32_t begin = NOW;
    for (int i = 0; i < {calls}; i++) {{
        for (int k = {angles}; k < ROBOT_NQ; k++) q[k] += 0.01f * (float)(k + 1);
        for (int k = 0; k < ROBOT_NV; k++) v[k] += 0.02f * (float)(k + 1);
        robot_{function}({given});
    }}
    const uint32_t end = NOW;
    printf("%lu\\n", (unsigned long)((begin - end) & 0xFFFFFF));
    return out[0] != out[0];
}}
"""


def run(*command: str | Path) -> str:
    """Output of a command."""
    return subprocess.run([str(part) for part in command], check=True, capture_output=True, text=True).stdout


def measured(scene: phipsi.Scene, function: str, level: str, into: Path) -> tuple[int, int, int]:
    """Flash and stack, bytes, and instructions per call."""
    scene.to_c(into, functions=[function], dtype="float32")
    code = into / "robot.o"
    run("arm-none-eabi-gcc", *FLAGS, level, "-fstack-usage", "-c", into / "robot.c", "-o", code)
    asked = {line.split()[-1] for line in run("arm-none-eabi-nm", "-u", code).splitlines()}
    assert asked <= ASKED, asked - ASKED
    flash = int(run("arm-none-eabi-size", code).splitlines()[1].split()[0])
    # One function, whose stack the compiler reports; several would have to be added.
    (stack,) = re.findall(r"\t(\d+)\tstatic$", (into / "robot.su").read_text(), re.MULTILINE)
    angles = 7 if scene.nq > scene.nv else 0
    neutral = ", ".join(f"{x}f" for x in scene.neutral())
    text = LOOP.format(neutral=neutral, calls=CALLS, angles=angles, function=function, given=FUNCTIONS[function])
    (into / "loop.c").write_text(text)
    run("arm-none-eabi-gcc", *FLAGS, level, *LINKED, into / "loop.c", EXAMPLE / "startup.c", code, "-lm", "-o", into / "loop.elf")
    board = ["-machine", "mps2-an386", "-cpu", "cortex-m4", "-display", "none", "-monitor", "none", "-serial", "none"]
    host = ["-icount", "shift=0", "-semihosting-config", "enable=on,target=native"]
    ticks = int(run("qemu-system-arm", *board, *host, "-kernel", into / "loop.elf"))
    return flash, int(stack), 40 * ticks // CALLS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--markdown", type=Path)
    given = parser.parse_args()
    columns = [f"flash {level}, bytes | stack {level}, bytes | instructions {level}" for level in LEVELS]
    lines = [f"| robot | function | {' | '.join(columns)} |", f"| --- | --- |{' --- | --- | --- |' * len(LEVELS)}"]
    for name, (file, floating_base) in CASES.items():
        scene = load(file, floating_base)
        for function in FUNCTIONS:
            with tempfile.TemporaryDirectory() as directory:
                figures = [measured(scene, function, level, Path(directory)) for level in LEVELS]
            cells = [" | ".join(f"{x}" for x in figure) for figure in figures]
            lines.append(f"| {name} | {function.replace('_', ' ')} | {' | '.join(cells)} |")
            print(lines[-1], flush=True)
    compiler = run("arm-none-eabi-gcc", "--version").splitlines()[0]
    write(
        given.markdown,
        "Robots on a microcontroller: flash and stack",
        [
            f"Written by `make embedded` (benches/embedded.py): the C code of each function in float, compiled for a Cortex-M4F by {compiler}, `{' '.join(FLAGS)}`. The functions call only `sinf`, `cosf` and `sqrtf` and allocate "
            "nothing: RAM is the stack and the arrays of the caller.",
            "",
            f"Flash is the size of the function with its constants; stack is the compiler's value for the function itself. Instructions are the mean of {CALLS} calls, including `sinf` and `cosf` of newlib, counted by QEMU, which "
            "does not model the timing of a Cortex-M4. Nothing was run on a chip.",
        ],
        lines,
        "flash and stack of `sinf` and `cosf` themselves, which a program contains once, and cycles: a chip has wait states for its flash, and needs up to 14 cycles for a division or a square root.",
    )


if __name__ == "__main__":
    main()
