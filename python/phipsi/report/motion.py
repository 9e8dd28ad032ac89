"""Trajectories as files and as one picture: reading of state files, npz and CSV output, stroboscopic picture."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .. import _core, errors
from .._core import Scene
from .._forces import of_motion
from .._motion import Trajectory
from ..estimation import MotionUncertainty, ParameterCovariance
from ..estimation._tables import by_names
from .draw import View, segments
from .plotting import COLORS, Part, Space
from .states import Array
from .structure import Tree

#: Keys of a state file.
KEYS = ("q", "qd", "tau")
#: Keys of a file of uncertainties.
UNCERTAINTY_KEYS = ("parameters", "joints", "initial", "torque_noise")
#: Keys of ParameterCovariance.arrays, in place of "parameters".
ROOT_KEYS = ("root", "fit", "friction_speed", "stribeck_speed", "transmission")
#: Largest integration error, relative to the exchanged energy, without a warning.
SHARE = 0.01
#: Number of poses in a stroboscopic picture.
FLASHES = 9


def read_state(path: Path | None, scene: Scene, keyframe: str | None = None) -> dict[str, Array]:
    """q, qd and tau of a state file, JSON or npz; q and qd of the start or of a keyframe, and zeros, for missing keys.

    In JSON each value is a list, or a mapping from joint names to a number or a list. Lists are in the order of the key
    joint_names, if there is one. Raises ArgumentError with file and key.
    """
    state = {"q": scene.initial(keyframe), "qd": scene.initial_velocity(keyframe), "tau": np.zeros(scene.nv)}
    given = {} if path is None else dict(_read(path, "a state", (*KEYS, "joint_names")))
    names = given.pop("joint_names", None)
    for key, value in given.items():
        name, usual = f"{path}: {key}", state[key]
        if names is not None and not isinstance(value, Mapping):
            value = by_names(name, names, value, scene, key == "q")
        if isinstance(value, Mapping):
            indices = scene.q_index if key == "q" else scene.v_index
            value = {joint: usual[indices(joint)] for joint in scene.joint_names} | dict(value)
        state[key] = _core._numbers(name, value, scene, key == "q")
        if state[key].shape != usual.shape:
            raise errors.ShapeError(f"{name}: found shape {state[key].shape}; expected {usual.shape}")
    return state


def read_uncertainty(path: Path | None, torque_noise: float | None, scene: Scene) -> MotionUncertainty | None:
    """Uncertainty of a simulation from a file, JSON or npz, and from a density of torque noise; None without both.

    Raises ArgumentError with file and key.
    """
    given = {} if path is None else dict(_read(path, "uncertainties", (*UNCERTAINTY_KEYS, *ROOT_KEYS)))
    of_root = {name: given.pop(name) for name in ROOT_KEYS if name in given}
    if of_root:
        if "parameters" in given or "root" not in of_root:
            found = f"{path}: found {next(iter(of_root))!r} {'and' if 'parameters' in given else 'without'}"
            other = "parameters" if "parameters" in given else "root"
            raise errors.ArgumentError(f"{found} {other!r}; expected parameters, or all arrays of phipsi identify")
        given["parameters"] = ParameterCovariance.from_arrays(scene, of_root)
    if torque_noise is not None:
        if "torque_noise" in given:
            raise errors.ArgumentError(f"{path}: found 'torque_noise' and --noise; expected one of them")
        given["torque_noise"] = torque_noise
    return MotionUncertainty(**given) if given else None


def _read(path: Path, what: str, keys: tuple[str, ...]) -> Mapping[str, Any]:
    """Contents of a file, JSON or npz, with these keys."""
    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as archive:
                found: Any = {key: archive[key] for key in archive.files}
        else:
            found = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, EOFError) as error:
        raise errors.ArgumentError(f"{path}: found {error}; expected {what} as JSON or .npz") from None
    if not isinstance(found, Mapping):
        raise errors.ArgumentError(f"{path}: found a {type(found).__name__}; expected an object with {', '.join(keys)}")
    for key in found:
        if key not in keys:
            raise errors.ArgumentError(f"{path}: found {key!r}; expected {', '.join(keys)}")
    return found


def write(path: Trajectory, folder: Path, *, table: bool) -> list[Path]:
    """Write trajectory.npz, and trajectory.csv if `table` is set; return the files."""
    scene = path.scene
    archive = folder / "trajectory.npz"
    found = path._archive(compact=True) | {"dt": path.dt, "method": path.method}
    if scene.loops.names:
        found["drift"] = path.drift
    if path.bands is not None:
        found |= {"q_deviation": path.bands.q, "qd_deviation": path.bands.qd, "covariance": path.bands.covariance}
    if (forces := of_motion(path, np.arange(len(path)))) is not None:
        # Arrows are drawn where a force acts.
        acts = np.any(forces.force != 0.0, axis=(0, 2))
        names = np.array(forces.names)[acts]
        found |= {"force_at": forces.at[:, acts], "force": forces.force[:, acts], "force_names": names}
    np.savez_compressed(archive, joint_names=np.array(scene.joint_names), **found)
    files = [archive]
    if table:
        files.append(folder / "trajectory.csv")
        path.to_csv(files[-1])
    return files


def stroboscope(path: Trajectory, tree: Tree, flashes: int = FLASHES) -> Space:
    """The robot at equidistant times, with links as lines between joints, from light to dark, and the paths of its
    tips.
    """
    at, dense = (np.unique(np.linspace(0, len(path) - 1, count).round().astype(int)) for count in (flashes, 400))
    bones = [(str(joint.parent), joint.child) for joint in tree.joints.values() if joint.parent in tree.links]
    tips = [link for link in tree.links if not tree.children.get(link)] or [tree.root]
    frozen, flown = path.scene.placements(path.q[at]), path.scene.placements(path.q[dense])
    origins = {name: placement[:, :3, 3] for name, placement in frozen.items()}
    parts = [Part("paths of the tips", COLORS[2], np.concatenate([_apart(flown[tip][:, :3, 3]) for tip in tips]), line=2.0)]
    for i, shade in enumerate(np.linspace(0.25, 1.0, len(at))):
        lines = segments([(origins[one][i], origins[other][i]) for one, other in bones])
        if len(lines):
            parts.append(Part(f"t = {path.t[at[i]]:.3g} s", COLORS[0], lines, line=2.0 + 3.0 * shade, shade=float(shade)))
    return Space("stroboscope", parts, View.best(np.concatenate(list(origins.values()))).toward)


def or_control(scene: Scene, text: str) -> str:
    """A text that suggests error control, which scenes with colliders do not have."""
    return "" if scene.collider_names else text


def _apart(line: Array) -> Array:
    """A line that is not connected with the next one."""
    return np.vstack([line, np.full(3, np.nan)])
