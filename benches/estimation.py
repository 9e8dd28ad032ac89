"""Identification from logs: what intervals hold, a log of a real arm, memory and time, ranks. Writes docs/measured/identification.md.

Usage, each seeded, with the interpreter that has phipsi (and Pinocchio with example-robot-data, for `rank` and `memory`):

    python benches/estimation.py coverage [--logs 300]      # 95 % intervals over logs with residuals of four spectra
    python benches/estimation.py tx40 FOLDER [--rest FOLDER]  # the log of a Staubli TX40: explained variance of the part that is not fitted and of unseen data, agreement of disjoint segments
    python benches/estimation.py faults [--logs 300]        # faults of logs that no warning reports, and warnings for sound logs
    python benches/estimation.py payload [--logs 150]       # 95 % intervals of a load from two logs, with Pinocchio
    python benches/estimation.py memory [--rows 10000000]   # of a 7-joint arm
    python benches/estimation.py rank [--tx40 FOLDER]       # base parameters against the rank of Pinocchio's regressor

The folder of the TX40 has pos_read_data_first_half.csv.gz, curr_data_first_half.csv.gz and tx40.urdf (thanhndv212/figaroh-examples, Apache-2.0). Every section of the page has the command,
and is written by that command alone.
"""

from __future__ import annotations

import argparse
import gzip
import resource
import sys
import time
import warnings
from itertools import combinations
from pathlib import Path

import numpy as np
import phipsi
from phipsi.estimation import Accumulator
from phipsi.estimation._logs import with_derivatives
from phipsi.estimation._student import student_quantile

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/python"))
PAGE = ROOT / "docs/measured/identification.md"
HEAD = """# Identification, measured

Written by `benches/estimation.py`; the command is above each table. The method is explained in [Identification from logs](../how-to/identification.md).
"""
FIT = ("armature", "damping", "friction")


def write(name: str, text: str) -> None:
    """Replaces a section of the page."""
    begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->\n"
    page = PAGE.read_text(encoding="utf-8") if PAGE.exists() else HEAD
    if begin in page:
        before, rest = page.split(begin)
        page = before + rest.split(end)[1]
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text(page.rstrip() + "\n\n" + begin + text.strip() + "\n" + end, encoding="utf-8")
    print(text)


def table(head: list[str], rows: list[list[str]]) -> str:
    """As Markdown."""
    return "\n".join("| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *rows])


# Intervals


def coverage(logs: int) -> None:
    """Of base parameters, over logs of one motion with other residuals."""
    from logs import NOISES, STEP, arm_of_three, fourier, residuals

    scene, rows = arm_of_three(), []
    for seconds in (10, 40):
        count = round(seconds / STEP)
        motion = fourier(STEP * np.arange(count))
        q, qd, qdd = motion
        tau = scene.inverse_dynamics(q, qd, qdd) + scene.damping * qd + scene.friction * qd / np.sqrt(qd**2 + 0.01**2)
        white = Accumulator(scene, fit=FIT, block_length=count).add(*motion, tau).identify(noise=0.3).base.deviations
        for number, kind in enumerate(NOISES):
            draw, held, lower, assumed = np.random.default_rng([number, seconds]), [], [], []
            for _ in range(logs):
                found = Accumulator(scene, fit=FIT, block_length=-(-count // 20)).add(*motion, tau + 0.3 * residuals(kind, count, 3, draw)).identify(noise=0.3).base
                off = np.abs(found.values - found.model)
                held.append(off <= student_quantile(0.95, found.degrees) * found.deviations)
                lower.append(off <= student_quantile(0.683, found.degrees) * found.deviations)
                assumed.append(off <= 1.96 * white)
            shares = 100 * np.mean(held, axis=1)
            mean, error = np.mean(shares), 1.96 * np.std(shares) / np.sqrt(logs)
            worst = 100 * np.mean(held, axis=0).min()
            aim = "93 to 97" if seconds == 10 else "94 to 96"
            rows.append([f"{seconds} s", kind, f"{100 * np.mean(assumed):.0f}", f"{mean:.1f} ± {error:.1f}", aim, f"{100 * np.mean(lower):.1f}", f"{worst:.0f}"])
            print(rows[-1], flush=True)
    text = table(["log", "residuals", "95 %, if residuals were independent", "95 % intervals", "aim", "68.3 % intervals", "lowest parameter"], rows)
    base = len(found.values)
    write("coverage", f"""
## Coverage of intervals

`python benches/estimation.py coverage --logs {logs}`: share of the {base} base parameters of a 3-joint arm (with armature, damping and friction) that are within their intervals, in %, over {logs} logs at
{1 / STEP:.0f} Hz with residuals of a stated spectrum; ± is a 95 % confidence interval of the mean over logs. The third column is the coverage of intervals sigma² (W^T W)^-1, which most programs report.

{text}
""")


# A real arm


def tx40_log(folder: Path, part: str = "first_half") -> tuple[phipsi.Scene, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Scene, transmission, times, positions of the joints, and torques of the motors at the joints' side of their gears."""
    def read(name: str) -> np.ndarray:
        with gzip.open(folder / name, "rt") as file:
            return np.loadtxt(file, delimiter=",", skiprows=1)

    ratio = np.array([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
    gears = np.diag(ratio)
    gears[5, 4] = 32.0
    q = np.linalg.solve(gears, read(f"pos_read_data_{part}.csv.gz").T).T
    q[:, 1] -= np.pi / 2
    q[:, 2] += np.pi / 2
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = phipsi.Scene.from_urdf(folder / "tx40.urdf")
        link = scene.links["link_6"]
        # No body has the inertia of the file: zero.
        scene = scene.with_inertias({"link_6": (link.mass, link.com, 2e-4 * np.eye(3))})
    return scene, gears / ratio[:, None], 2e-4 * np.arange(len(q)), q, read(f"curr_data_{part}.csv.gz") * ratio


#: Explained variance of joints 1 to 6 in the 22,500 rows of the source's log that follow, by the fit of the first 22,500
#: with the same settings (2026-11).
UNSEEN = (0.994, 0.980, 0.987, 0.983, 0.940, 0.920)


def explained(found: phipsi.Identification, transmission: np.ndarray, motion: tuple[np.ndarray, ...], measured: np.ndarray) -> np.ndarray:
    """Share of the variance of the torques of the joints: B^T times those of the motors."""
    at_joints, predicted = measured @ transmission, found.torques(*motion) @ transmission
    return 1.0 - np.mean((at_joints - predicted) ** 2, axis=0) / np.var(at_joints, axis=0)


def tx40(folder: Path, rest: Path | None) -> None:
    scene, transmission, times, positions, currents = tx40_log(folder)
    motion = phipsi.smooth(times, positions, cutoff=40.0)
    torque = phipsi.smooth(times, currents, cutoff=40.0).q
    inner = slice(500, -500, 25)
    q, qd, qdd, filtered, raw = (one[inner] for one in (motion.q, motion.qd, motion.qdd, torque, currents))
    half = len(q) // 2

    def identified(rows: slice, blocks: int = 20) -> phipsi.Identification:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", phipsi.errors.IdentificationWarning)
            return scene.identify(q[rows], qd[rows], qdd[rows], filtered[rows], fit=FIT, transmission=transmission, friction_speed=0.02, blocks=blocks)

    third = len(q) // 3
    parts = {
        "second half, fit of the first": (slice(0, half), slice(half, None)), "first half, fit of the second": (slice(half, None), slice(0, half)),
        "last third, fit of the first": (slice(0, third), slice(2 * third, None)), "first third, fit of the last": (slice(2 * third, None), slice(0, third)),
    }  # fmt: skip
    rows = []
    for name, (fit, other) in parts.items():
        found = identified(fit)
        for kind, measured in (("filtered", filtered), ("raw", raw)):
            shares = explained(found, transmission, (q[other], qd[other], qdd[other]), measured[other])
            rows.append([f"{kind} torque, {name}", *(f"{value:.3f}" for value in shares)])
    by_default, smoothed = with_derivatives({"time": times, "q": positions, "tau": currents}, "tx40")
    assert smoothed is not None
    arrays = [by_default[name][500:-500] for name in ("q", "qd", "qdd", "tau")]
    half = len(arrays[0]) // 2
    for name, fit, other in (("second half, fit of the first", slice(0, half), slice(half, None)), ("first half, fit of the second", slice(half, None), slice(0, half))):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", phipsi.errors.IdentificationWarning)
            of_half = scene.identify(*(one[fit] for one in arrays), fit=FIT, transmission=transmission)
        motion_of_half = (arrays[0][other], arrays[1][other], arrays[2][other])
        shares = explained(of_half, transmission, motion_of_half, arrays[3][other])
        rows.append([f"defaults of `phipsi identify`, {name}", *(f"{value:.3f}" for value in shares)])
    half = len(q) // 2
    if rest is None:
        rows.append(["**unseen data**: filtered torque, 4.5 s later", *(f"{value:.3f}" for value in UNSEEN)])
        source = "The last row is not measured by this command, because the repository does not hold these data (`--rest FOLDER` reads them): it is an earlier measurement with the same settings; another one, with independent code, has 0.92 and 0.93 for joints 5 and 6"
    else:
        _, _, times, positions, currents = tx40_log(rest, "second_half")
        unseen, torque = phipsi.smooth(times, positions, cutoff=40.0), phipsi.smooth(times, currents, cutoff=40.0).q
        shares = explained(identified(slice(None)), transmission, tuple(one[inner] for one in (unseen.q, unseen.qd, unseen.qdd)), torque[inner])
        rows.append(["**unseen data**: filtered torque, 4.5 s later", *(f"{value:.3f}" for value in shares)])
        source = "The last row is of the rest of the source's log, with the fit of the whole first part"
    rows.insert(0, ["aim, unseen data", ".99", ".975", ".98", ".98", ".915", ".92"])
    first = table(["explained variance", *(f"joint {at}" for at in range(1, 7))], rows)
    agreement = []
    for segments in (2, 3, 4):
        row = [str(segments)]
        for blocks in (20, 10):
            bounds = np.linspace(0, len(q), segments + 1).astype(int)
            parts = [identified(slice(int(a), int(b)), blocks).base for a, b in zip(bounds[:-1], bounds[1:], strict=True)]
            held = []
            for one, other in combinations(parts, 2):
                spread = np.sqrt(one.deviations**2 + other.deviations**2)
                held.append(np.abs(one.values - other.values) <= student_quantile(0.95, 2 * one.degrees) * spread)
            row.append(f"{100 * np.mean(held):.0f}")
        agreement.append(row)
    second = table(["segments", "20 blocks, %", "10 blocks, %"], agreement)
    write("tx40", f"""
## A real arm: Staubli TX40

`python benches/estimation.py tx40 FOLDER`: {times[-1]:.1f} s at 5 kHz, positions smoothed at 40 Hz and torques through the same filter, every 25th row; armature, damping and friction of the motors, of which the sixth
moves by the sum of joints 5 and 6. Explained variance of a part of the log that was not fitted, by the fit of another part. The halves are neighboring {0.5 * times[-1]:.1f} s of one motion, and the thirds are {times[-1] / 3:.1f} s apart, so that the shares of halves
are higher than on unseen data, above all those of joints 5 and 6. **Expect the last row of another log.** {source}.

{first}

Estimates of disjoint segments of the log, all pairs: share of the {len(found.base.values)} base parameters whose difference is within its 95 % interval (aim: at least 94).

{second}

One arm and {times[-1]:.1f} s of motion: the shares are of dependent parameters.
""")


# Faults of logs


def faults(count: int) -> None:
    """Silent faults, and warnings for sound logs, with Clopper-Pearson bounds."""
    from logs import ENCODER, FIT, NOISES, ROBOTS, gross_faults, recorded

    def warned(scene: phipsi.Scene, log: dict[str, np.ndarray], fit: tuple[str, ...]) -> bool:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            scene.identify(**log, fit=fit)
        return any(one.category is phipsi.errors.LogWarning for one in caught)

    def bounds(found: int, total: int) -> str:
        from scipy.stats import beta

        low = 0.0 if found == 0 else beta.ppf(0.025, found, total - found + 1)
        high = beta.ppf(0.975, found + 1, total - found)
        return f"{found} of {total} (95 %: {100 * low:.2g} to {100 * high:.2g} %)"

    scenes = {name: build() for name, build in ROBOTS.items()}
    silent: dict[str, list[bool]] = {}
    for scene in scenes.values():
        for seed in range(count // 20):
            for name, model, log, fit in gross_faults(scene, 1000 + seed):
                silent.setdefault(name, []).append(not warned(model, log, fit))
    false = []
    for seed in range(count // len(scenes)):
        for scene in scenes.values():
            log = recorded(scene, 5000 + seed, kind=NOISES[seed % 4], noise=(0.005, 0.02, 0.1, 0.3, 0.5)[seed % 5], seconds=(10.0, 20.0, 40.0)[seed % 3])
            if seed % 2:
                smoothed = phipsi.smooth(log["time"], log["q"] + ENCODER * np.random.default_rng(seed).standard_normal(log["q"].shape), cutoff=6.0)
                log |= {"q": smoothed.q, "qd": smoothed.qd, "qdd": smoothed.qdd}
            false.append(warned(scene, log, (FIT, (*FIT, "armature"), (*FIT, "offset"))[seed % 3]))
    text = table(["log", "silent, or with a warning"], [
        *([name, bounds(sum(of), len(of))] for name, of in silent.items()),
        ["**all ten faults**, silent", bounds(sum(map(sum, silent.values())), sum(map(len, silent.values())))],
        ["**sound logs**, with a warning", bounds(sum(false), len(false))],
    ])  # fmt: skip
    write("faults", f"""
## Faults of logs

`python benches/estimation.py faults --logs {count}`: logs of {len(scenes)} robots (3, 4 and 6 joints) whose bodies are up to 15 % and 1 cm off those of the model, at other joints in each log. Sound logs have residuals of the four spectra
above, of 0.5 to 50 % of the torques, over 10 to 40 s, with exact or smoothed motion.

{text}
""")


# Loads


def payload(logs: int) -> None:
    """Intervals of a load from a log with and one without it, for a robot whose links and friction the model does not have."""
    from logs import COM, INERTIA, LINK, MASS, fourier, loaded_arm, stribeck

    scene, torques = loaded_arm()
    origin = INERTIA + MASS * (COM @ COM * np.eye(3) - np.outer(COM, COM))
    truth = np.array([MASS, *MASS * COM, *(origin[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))])
    frictions = {"as fitted": lambda qd: 2.0 * qd + 3.0 * qd / np.sqrt(qd**2 + 0.01**2), "Stribeck and asymmetric, not fitted": stribeck}
    instants, rows = 0.01 * np.arange(1000), []
    for motions, seed in (("same", 2), ("different", 7)):
        both = [fourier(instants), fourier(instants, seed=seed)]
        for name, friction in frictions.items():
            exact = [torques(motion, bool(at)) + friction(motion[1]) for at, motion in enumerate(both)]
            draw, held, off, stated = np.random.default_rng(1), [], [], []
            for _ in range(logs):
                empty, loaded = (
                    Accumulator(scene, fit=["damping", "friction"], block_length=50).add(*motion, tau + 0.3 * draw.standard_normal(tau.shape))
                    for motion, tau in zip(both, exact, strict=True)
                )
                found = loaded.identify_payload(LINK, without=empty)
                low, high = found.interval(0.95)
                held.append((low <= truth) & (truth <= high))
                off.append(found.mass - MASS)
                stated.append(found.deviations[0])
            rows.append([motions, name, f"{100 * np.mean(held):.1f}", f"{1e3 * np.sqrt(np.mean(np.square(off))):.0f}", f"{1e3 * np.mean(stated):.0f}"])
    text = table(["motions of both logs", "friction", "95 % intervals that contain the truth, %", "rms error of the mass, g", "stated deviation, g"], rows)
    write("payload", f"""
## Loads from two logs

`python benches/estimation.py payload --logs {logs}`: ten parameters of a load of {MASS} kg on an arm of three joints, from {logs} pairs of logs of 10 s at 100 Hz with noise of 0.3 N m. Torques are those of Pinocchio's recursion for links that are up to 20 % and
3 cm off those of the model. Errors of friction cancel if both logs have the same motion; otherwise the intervals are wider.

{text}
""")


# Memory and time


def memory(rows: int) -> None:
    from robots import load

    scene = load("panda_description/urdf/panda.urdf")
    scene = scene.lock([name for name in scene.joint_names if "finger" in name], np.zeros(scene.nq))
    draw, count = np.random.default_rng(0), 65_536
    start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    base = 2 * np.pi * np.outer(np.arange(count) / 1000.0, [0.11, 0.13, 0.17, 0.19, 0.23, 0.29, 0.31])
    rates = base[1]  # rad per sample
    q, qd, qdd = np.sin(base), 1000 * rates * np.cos(base), -((1000 * rates) ** 2) * np.sin(base)
    tau = scene.inverse_dynamics(q, qd, qdd) + 0.1 * draw.standard_normal(q.shape)
    accumulator = Accumulator(scene, fit=FIT)
    begun, processor = time.perf_counter(), time.process_time()
    added = 0
    while added < rows:
        some = min(count, rows - added)
        accumulator.add(q[:some], qd[:some], qdd[:some], tau[:some])
        added += some
    adding, processor = time.perf_counter() - begun, time.process_time() - processor
    found = accumulator.identify()
    whole = time.perf_counter() - begun
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    load_average = Path("/proc/loadavg").read_text().split()[0] if Path("/proc/loadavg").exists() else "unknown"
    text = table(["", "measured", "aim"], [
        ["memory of the process, MB", f"{most:.0f} (of which {start:.0f} before the log)", "200"],
        ["time, s", f"{whole:.0f} ({processor:.0f} s of processor time for the rows, {whole - adding:.1f} s for the identification)", "60"],
    ])  # fmt: skip
    write("memory", f"""
## Memory and time

`python benches/estimation.py memory --rows {rows}`: {rows:,} states of a 7-joint arm (panda, fingers locked), armature, damping and friction, {scene.nv} torques per state, in chunks of {count:,}, on {phipsi.get_num_threads()} threads;
{found.known} combinations of parameters determined. The load average of the machine was {load_average}.

{text}
""")


# Ranks


def rank(folder: Path | None) -> None:
    import pinocchio as pin
    from phipsi.estimation._base import combinations as of
    from phipsi.estimation._columns import Columns
    from robots import ROBOTS, load

    files = {"UR5": "ur_description/urdf/ur5_robot.urdf", "panda": "panda_description/urdf/panda.urdf", "g1": "g1_description/urdf/g1_29dof_rev_1_0.urdf"}
    cases = [(name, ROBOTS / file, load(file, floating), floating) for name, file in files.items() for floating in (False, True)]
    if folder is not None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            cases.append(("TX40", folder / "tx40.urdf", phipsi.Scene.from_urdf(folder / "tx40.urdf"), False))
    rows = []
    for name, file, scene, floating in cases:
        model = pin.buildModelFromUrdf(str(file), pin.JointModelFreeFlyer()) if floating else pin.buildModelFromUrdf(str(file))
        data, draw = model.createData(), np.random.default_rng(0)
        stacked = []
        for _ in range(max(60, 12 * model.njoints // 4)):
            q = pin.integrate(model, pin.neutral(model), draw.uniform(-2, 2, model.nv))
            stacked.append(pin.computeJointTorqueRegressor(model, data, q, *draw.standard_normal((2, model.nv))).copy())
        matrix = np.concatenate(stacked)
        norms = np.linalg.norm(matrix, axis=0)
        singular = np.linalg.svd(matrix[:, norms > 0] / norms[norms > 0], compute_uv=False)
        theirs = int(np.sum(singular > 1e-9 * singular[0]))
        found = len(of(Columns(scene)).columns)
        gap = f"{singular[theirs - 1]:.0e} to {singular[theirs]:.0e}" if theirs < len(singular) else "full"
        rows.append([name + (", floating base" if floating else ""), str(10 * len(scene.body_names)), str(found), str(theirs), gap])
    text = table(["robot", "parameters", "base parameters", "rank of Pinocchio's regressor", "singular values about the gap"], rows)
    where = " --tx40 FOLDER" if folder is not None else ""
    write("rank", f"""
## Base parameters

`python benches/estimation.py rank{where}`: against the rank of `computeJointTorqueRegressor` of Pinocchio {pin.__version__}, stacked at random states.

{text}
""")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("coverage").add_argument("--logs", type=int, default=300)
    real = commands.add_parser("tx40")
    real.add_argument("folder", type=Path)
    real.add_argument("--rest", type=Path, help="folder with pos_read_data_second_half.csv.gz and curr_data_second_half.csv.gz, and tx40.urdf")
    commands.add_parser("payload").add_argument("--logs", type=int, default=150)
    commands.add_parser("faults").add_argument("--logs", type=int, default=300)
    commands.add_parser("memory").add_argument("--rows", type=int, default=10_000_000)
    commands.add_parser("rank").add_argument("--tx40", type=Path)
    given = parser.parse_args()
    if given.command == "coverage":
        coverage(given.logs)
    elif given.command == "tx40":
        tx40(given.folder, given.rest)
    elif given.command == "faults":
        faults(given.logs)
    elif given.command == "payload":
        payload(given.logs)
    elif given.command == "memory":
        memory(given.rows)
    else:
        rank(given.tx40)


if __name__ == "__main__":
    main()
