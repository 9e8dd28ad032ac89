"""Result of phipsi.load for the MJCF files of public repositories: read, read with warnings, SceneError, crashed; and
the rest position of their servos, compared with MuJoCo's.

Usage: python benches/mjcf_files.py FOLDER [--markdown FILE] [--list FILE]

FOLDER has one folder per repository, with an optional file COMMIT (commit and date) that the page quotes. Each file whose
root element is <mujoco> is read in a separate process. Files that MuJoCo itself does not compile, with or without
their meshes, are counted separately: most are parts that other files include.

Servos: Each model with at least one position servo moves under its controls (those of the first keyframe, else those
that are nearest to zero) by steps of 2 ms, without contacts, in phipsi and in MuJoCo (integrator implicitfast), until
MuJoCo's joints rest; models that do not rest there, which are those with free joints above all, are not compared. The rests agree if no joint differs by more than 0.02 rad or
0.02 m: MuJoCo's limits and friction are springs.
"""

from __future__ import annotations

import argparse
import multiprocessing
import re
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import phipsi
from phipsi._load import root_of
from phipsi._mjcf import compiled
from phipsi.errors import PhipsiError

#: Seconds after which a file counts as crashed.
LIMIT = 60
IGNORE = re.compile(r"ignore=\(([^)]*)\)")
#: Parts of an error or warning: kind in the table, and text by which its message is recognized.
OTHER = {
    "MuJoCo does not compile it": "MuJoCo cannot read it",
    "inertia of a missing mesh": "from which the inertia of body",
    "unequal values at one joint": "expected equal values for all axes",
    "inertia that no body can have": "no body has such an inertia",
    "no mass moves": "have no mass",
    "missing meshes or textures": "found no file",
}


#: Time step and largest duration of the comparison of servos, s; speed of joints at rest; largest difference.
STEP, DURATION, REST, NEAR = 2e-3, 40.0, 1e-4, 0.02


class Result(NamedTuple):
    """Result for one file."""

    file: Path
    outcome: str
    """read, refused (SceneError), crashed or not a model."""
    kinds: tuple[str, ...]
    text: str
    seconds: float = 0.0


def kinds_of(text: str) -> tuple[str, ...]:
    """The kinds of a message: names for `ignore`, or one of OTHER."""
    if found := IGNORE.search(text):
        return tuple(re.findall(r"'(\w+)'", found[1]))
    return next(((kind,) for kind, part in OTHER.items() if part in text), ("others",))


def read(file: Path) -> Result:
    """Read one file."""
    start = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            phipsi.load(file)
        except PhipsiError as error:
            kinds = kinds_of(str(error))
            outcome = "not a model" if kinds == ("MuJoCo does not compile it",) else "refused"
            return Result(file, outcome, kinds, str(error), time.perf_counter() - start)
        except Exception as error:  # noqa: BLE001  # crashes are a result
            return Result(file, "crashed", (type(error).__name__,), f"{type(error).__name__}: {error}")
    texts = [str(one.message) for one in caught]
    kinds = tuple(dict.fromkeys(kind for text in texts for kind in kinds_of(text)))
    return Result(file, "read", kinds, " | ".join(texts), time.perf_counter() - start)


def rest_in_mujoco(file: Path) -> tuple[dict[str, float], dict[str, float], dict[str, float], int] | str:
    """Initial and final coordinates of MuJoCo's joints, its controls, and the number of steps; or why there are none."""
    model, _ = compiled(file, strict=False)
    if not (model.actuator_biasprm[:, 1] < 0.0).any():
        return "no servos"
    kinds = [int(kind) for kind in model.jnt_type]
    if any(kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL) for kind in kinds):
        return "free or spherical joints"
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qvel[:] = 0.0
    else:
        limited = model.actuator_ctrllimited.astype(bool)
        data.ctrl[limited] = np.clip(0.0, *model.actuator_ctrlrange[limited].T)
    names = [model.joint(k).name for k in range(model.njnt)]
    start, calm = dict(zip(names, data.qpos.copy(), strict=True)), 0
    for step in range(1, round(DURATION / STEP) + 1):
        mujoco.mj_step(model, data)
        if not np.isfinite(data.qpos).all() or any(warning.number for warning in data.warning):
            return "unstable in MuJoCo"
        calm = calm + 1 if np.abs(data.qvel).max() < REST else 0
        if calm * STEP >= 1.0:
            controls = {model.actuator(k).name: float(data.ctrl[k]) for k in range(model.nu)}
            return start, dict(zip(names, data.qpos.copy(), strict=True)), controls, step
    return "no rest in MuJoCo"


def settles(file: Path) -> Result:
    """Compare the rest of the servos of one file with MuJoCo's."""
    began = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            scene = phipsi.load(file)
        except PhipsiError:
            return Result(file, "not read", (), "")
        found = rest_in_mujoco(file)
        if isinstance(found, str):
            return Result(file, found, (), "")
        start, rest, controls, steps = found
        names = [name for name in scene.actuators.names if name in controls]
        if not names:
            return Result(file, "no servos of joints", (), "")
        control = {name: controls[name] for name in names}
        try:
            q = scene.neutral()
            for name in set(scene.joint_names) & set(start):
                q[scene.q_index(name)] = start[name]
            path = scene.simulate(q, np.zeros(scene.nv), dt=STEP, steps=steps, control=control, record_every=steps)
        except PhipsiError as error:
            return Result(file, "failed", (type(error).__name__,), str(error))
    away = {name: abs(float(path.q[-1, scene.q_index(name)][0]) - rest[name]) for name in scene.joint_names if name in rest}
    worst = max(away, key=lambda name: away[name])
    outcome = "settled" if away[worst] <= NEAR else "elsewhere"
    return Result(file, outcome, (), f"{worst}: {away[worst]:.2g}, {steps} steps", time.perf_counter() - began)


def apart(file: Path, read: Callable[[Path], Result] = read) -> Result:
    """Read one file in a separate process, which may crash."""
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(False)
    process = context.Process(target=lambda: sender.send(read(file)))
    process.start()
    sender.close()
    try:
        found = (
            receiver.recv() if receiver.poll(LIMIT) else Result(file, "crashed", ("too long",), f"more than {LIMIT} s")
        )
    except EOFError:
        found = Result(file, "crashed", ("process ended",), "the process ended")
    if process.is_alive():
        process.kill()
    process.join(timeout=60)
    return found


def files(folder: Path) -> list[Path]:
    """The MJCF files of a folder."""
    candidates = sorted(file for file in folder.rglob("*") if file.suffix in (".xml", ".mjcf") and file.is_file())
    return [file for file in candidates if root_of(file.read_text(encoding="utf-8", errors="replace")) == "mujoco"]


def table(found: dict[str, list[Result]]) -> list[str]:
    """Rows of Markdown: one per repository, then the kinds of errors and of warnings."""
    lines = [
        "| repository | models | read | read without a warning | SceneError | other errors and crashes | files that MuJoCo does not compile |",
        "| --- |" + " --- |" * 6,
    ]
    for name, results in [*found.items(), ("all", [one for results in found.values() for one in results])]:
        of = Counter(one.outcome for one in results)
        silent = sum(one.outcome == "read" and not one.kinds for one in results)
        lines.append(
            f"| {name} | {len(results) - of['not a model']} | {of['read']} | {silent} | {of['refused']} | {of['crashed']} | {of['not a model']} |"
        )
    lines += ["", "| unsupported part | files with an error | files that are read with a warning |", "| --- | --- | --- |"]
    all_of = [one for results in found.values() for one in results if one.outcome in ("refused", "read")]
    refused, warned = (
        Counter(kind for one in all_of if one.outcome == outcome for kind in one.kinds)
        for outcome in ("refused", "read")
    )
    lines += [
        f"| {kind} | {refused[kind] or ''} | {warned[kind] or ''} |" for kind, _ in (refused + warned).most_common()
    ]
    return lines


def servo_table(found: dict[str, list[Result]]) -> list[str]:
    """Rows of Markdown: how the servos of each repository settle."""
    outcomes = ["settled", "elsewhere", "failed", "crashed"]
    lines = ["| repository | models with servos that rest in MuJoCo | rest as in MuJoCo | rest elsewhere | raise, or take more than 60 s | servos, not compared |", "| --- |" + " --- |" * 5]
    for name, results in [*found.items(), ("all", [one for results in found.values() for one in results])]:
        of = Counter(one.outcome for one in results)
        compared = sum(of[outcome] for outcome in outcomes)
        others = sum(of[reason] for reason in ("free or spherical joints", "no servos of joints", "no rest in MuJoCo", "unstable in MuJoCo"))
        lines.append(f"| {name} | {compared} | {of['settled']} | {of['elsewhere']} | {of['failed'] + of['crashed']} | {others} |")
    return lines


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--markdown", type=Path, help="page to write")
    arguments.add_argument("--list", type=Path, help="file for the outcome and message of each file")
    given = arguments.parse_args()
    found: dict[str, list[Result]] = {}
    for repository in sorted(path for path in given.folder.iterdir() if path.is_dir()):
        commit = repository / "COMMIT"
        name = f"{repository.name} ({commit.read_text().strip()})" if commit.is_file() else repository.name
        found[name] = [apart(file) for file in files(repository)]
    servos = {name: [apart(one.file, settles) for one in results if one.outcome == "read"] for name, results in found.items()}
    lines = [*table(found), "", "## Servos", "", (__doc__ or "").split("Servos: ")[1].strip().replace("\n", " "), "", *servo_table(servos)]
    print("\n".join(lines))
    if given.list is not None:
        rows = [
            f"{one.outcome}\t{','.join(one.kinds)}\t{one.seconds:.2f}\t{one.file}\t{one.text}"
            for results in (*found.values(), *servos.values())
            for one in results
        ]
        given.list.write_text("\n".join(rows) + "\n", encoding="utf-8")
    if given.markdown is not None:
        page = [
            "# MJCF files of public repositories",
            "",
            f"Written by benches/mjcf_files.py, which reads each file with `phipsi.load(file)`, with MuJoCo {mujoco.__version__}. The files are not part of this repository.",
            "",
            "The first table counts files. The second table counts the parts of files that a scene cannot represent: a file with several such parts is counted once for each. The names of parts are those of the argument `ignore` ([read a robot](../how-to/read-a-robot.md#from-mujoco)).",
            "",
            *lines,
        ]
        given.markdown.write_text("\n".join(page) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
