"""Trajectories as tables and files."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _core
from ._motion_parts import PD, ContactMotion, ShapeContacts, StopImpact, no_shapes
from .errors import ArgumentError, of_argument

if TYPE_CHECKING:
    import pandas
    from typing_extensions import Self

    from ._core import Scene

__all__ = ["TrajectoryFiles", "columns"]

_Array = NDArray[np.float64]

#: Version of the archives of Trajectory.save.
FORMAT = 1
#: Fields of a trajectory that are arrays, and those that are numbers or texts.
ARRAYS = ("t", "q", "qd", "armature", "stiffness", "rest", "substeps", "events", "estimated_error")
PLAIN = ("dt", "steps", "method", "record_every", "integrator", "friction_speed", "limits")
#: Fields that are arrays or None.
OPTIONAL = ("inertias", "applied", "control", "activation", "start_activation")
#: Arguments of Scene.simulate in which states differ, that are per contact.
OF_CONTACTS = ("contact_friction", "contact_restitution")
#: Arguments of Scene.simulate that are arrays.
GIVEN = ("tau", "tau_steps", "targets", "target_rates", "damping", "friction", "compliance", *OF_CONTACTS)


def columns(scene: Scene, letter: str) -> list[str]:
    """Labels of the entries of q ("q") or of qd (another letter): the letter, a colon and the joint."""
    index = scene.q_index if letter == "q" else scene.v_index
    names = []
    for joint in scene.joint_names:
        at = index(joint)
        count = at.stop - at.start
        names += [f"{letter}:{joint}"] if count == 1 else [f"{letter}:{joint}[{i}]" for i in range(count)]
    return names


class TrajectoryFiles:
    """Methods of Trajectory that write and read files and tables."""

    scene: Scene
    t: _Array
    q: _Array
    qd: _Array
    given: dict[str, Any] | None
    bands: Any

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the rows of one state as CSV: t, q, qd, and tau and drift if they are known.

        Parameters
        ----------
        path : path
            File. Columns are named "q:JOINT", or "q:JOINT[0]" and so on for joints of several coordinates. Values are
            written exactly.

        Raises
        ------
        ArgumentError
            If the trajectory has batch axes.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> import phipsi
        >>> path = phipsi.scenes.chain(3).simulate([0.3] * 3, [0.0] * 3, dt=1e-3, steps=100)
        >>> file = pathlib.Path(tempfile.mkdtemp()) / "motion.csv"
        >>> path.to_csv(file)
        >>> file.read_text().splitlines()[0][:8]
        't,q:j0,q'
        """
        table = self._table("to_csv")
        with Path(path).open("w", newline="", encoding="utf-8") as stream:
            out = csv.writer(stream)
            out.writerow(table)
            # repr is exact: float(repr(x)) == x.
            out.writerows([repr(float(x)) for x in row] for row in np.column_stack(list(table.values())))

    def to_pandas(self) -> pandas.DataFrame:
        """The rows of one state as a DataFrame with the index t, s, and the columns of to_csv.

        Returns
        -------
        pandas.DataFrame
            One row per recorded row.

        Raises
        ------
        ArgumentError
            If the trajectory has batch axes.
        ImportError
            If pandas is not installed.

        Examples
        --------
        >>> import phipsi
        >>> path = phipsi.scenes.chain(3).simulate([0.3] * 3, [0.0] * 3, dt=1e-3, steps=100)
        >>> path.to_pandas()["q:j0"].max() > 0.3  # doctest: +SKIP
        True
        """
        table = self._table("to_pandas")
        try:
            import pandas
        except ImportError:
            raise ImportError("to_pandas needs pandas; install it with: pip install pandas") from None
        return pandas.DataFrame(table).set_index("t")

    def _table(self, method: str) -> dict[str, _Array]:
        """Columns by name."""
        batch = self.q.shape[:-2]
        if batch:
            raise of_argument(ArgumentError, "trajectory", f"found one of {batch} states; expected one state: {method} has no batch axes, save does")
        table = {"t": self.t}
        parts = [("q", self.q), ("qd", self.qd)]
        if self.has_torques:
            parts.append(("tau", self.torques()))
        for letter, values in parts:
            table |= dict(zip(columns(self.scene, letter), values.T, strict=True))
        if self.scene.loops.names:
            table["drift"] = self.drift
        return table

    # Attributes of Trajectory.
    if TYPE_CHECKING:

        @property
        def drift(self) -> _Array: ...
        @property
        def has_torques(self) -> bool: ...
        def torques(self) -> _Array: ...

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all rows, and what is known of the simulation, as an npz archive that Trajectory.load reads.

        Parameters
        ----------
        path : path
            File, with the suffix .npz. It contains no pickles: t, q, qd and tau (if known) are arrays of these names.

        Raises
        ------
        ArgumentError
            If the suffix is another one, or the trajectory has bands, which are not written.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> import phipsi
        >>> scene = phipsi.scenes.chain(3)
        >>> path = scene.simulate([0.3] * 3, [0.0] * 3, dt=1e-3, steps=100)
        >>> file = pathlib.Path(tempfile.mkdtemp()) / "motion.npz"
        >>> path.save(file)
        >>> bool((phipsi.Trajectory.load(file, scene).q == path.q).all())
        True
        """
        file = Path(path)
        if file.suffix != ".npz":
            raise of_argument(ArgumentError, "path", f"found {file.name!r}; expected a file with the suffix .npz")
        if self.bands is not None:
            raise of_argument(ArgumentError, "path", "found a trajectory with bands; expected one without: pickle writes bands too")
        np.savez(file, **self._archive())

    def _archive(self, compact: bool = False) -> dict[str, Any]:
        """Arrays that load reads, without bands. A compact archive omits gaps, which follow from q, and the arrays of contacts that never touch: thousands, with meshes."""
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__}  # type: ignore[attr-defined]
        arrays: dict[str, Any] = {name: fields[name] for name in ARRAYS}
        about: dict[str, Any] = {"format": FORMAT, "joints": self.scene.joint_names, **{name: fields[name] for name in PLAIN}}
        about["stops"] = [one._asdict() for one in fields["stops"]]
        for name in ("end", "works"):
            for at, value in enumerate(fields[name] or ()):
                arrays[f"{name}/{at}"] = value
        arrays |= {name: fields[name] for name in OPTIONAL if fields[name] is not None}
        if self.has_torques:
            arrays["tau"] = self.torques()
        if fields["contacts"] is not None:
            arrays |= self._of_contacts(fields["contacts"], compact)
        about["given"] = None if self.given is None else self._written(self.given, arrays)
        return {"about": np.array(json.dumps(about)), **arrays}

    def _of_contacts(self, contacts: ContactMotion, compact: bool) -> dict[str, Any]:
        """Arrays of the contacts by their keys in the archive."""
        fields = contacts._asdict()
        of_shapes = {f"shapes/{name}": value for name, value in fields.pop("shapes")._asdict().items() if name != "names"}
        if not compact:
            fields = {name: value for name, value in fields.items() if not isinstance(value, Mapping) or value} | of_shapes
            return {f"contacts/{name}": np.stack(list(value.values())) if isinstance(value, Mapping) else value for name, value in fields.items()}
        touching = [at for at, name in enumerate(self.scene.contacts.names) if any(np.any(fields[part][name]) for part in ("state", "force", "impulse"))]
        arrays: dict[str, Any] = {"contacts/touching": np.array(touching, int)} | {f"contacts/{name}": value for name, value in of_shapes.items()}
        for name, value in fields.items():
            if not isinstance(value, Mapping):
                arrays[f"contacts/{name}"] = value
            elif touching and name != "gap":
                arrays[f"contacts/{name}"] = np.stack([value[self.scene.contacts.names[at]] for at in touching])
        return arrays

    def _written(self, given: dict[str, Any], arrays: dict[str, Any]) -> dict[str, Any]:
        """Arguments of Scene.simulate as JSON; those that are arrays are added to `arrays`."""
        kept = {}
        for name, value in given.items():
            if name == "pd" and value is not None:
                for part, gain in PD(*value)._asdict().items():
                    if isinstance(gain, bool):
                        arrays[f"given/pd/{part}"] = np.array(gain)
                    elif gain is not None:
                        arrays[f"given/pd/{part}"] = _core._numbers(part, gain, self.scene, part == "target")
            elif name == "wrenches" and value is not None:
                arrays |= {f"given/wrenches/{link}": np.asarray(wrench, np.float64) for link, wrench in value.items()}
            elif name in OF_CONTACTS and value is not None:
                arrays[f"given/{name}"] = np.asarray(value, np.float64)
            elif name in GIVEN and value is not None and not isinstance(value, str):
                arrays[f"given/{name}"] = _core._numbers(name, value, *(() if name == "compliance" else (self.scene, name == "targets")))
            else:
                kept[name] = value
        return kept

    @classmethod
    def load(cls, path: str | os.PathLike[str], scene: Scene) -> Self:
        """Read a trajectory that save or the command `phipsi simulate` has written.

        Parameters
        ----------
        path : path
            File.
        scene : Scene
            The scene of the simulation, which the file does not contain.

        Returns
        -------
        Trajectory
            The trajectory, with bit-identical arrays. That of trajectory.npz of `phipsi simulate` has no bands, and its
            contacts that never touch have no slip (NaN).

        Raises
        ------
        ArgumentError
            If the file is not an archive of save, or the joints are not those of the scene.

        Examples
        --------
        >>> import phipsi
        >>> phipsi.Trajectory.load("motion.npz", phipsi.scenes.chain(3))  # doctest: +SKIP
        """
        try:
            with np.load(path, allow_pickle=False) as archive:
                arrays = dict(archive)
            about = json.loads(str(arrays["about"]))
            if about["format"] != FORMAT:
                raise ValueError(f"format {about['format']}")
            return cls(**_fields(about, arrays, scene))
        except (OSError, KeyError, ValueError, TypeError) as error:
            if isinstance(error, ArgumentError):
                raise
            raise of_argument(ArgumentError, "path", f"found {error} in {str(path)!r}; expected an archive of Trajectory.save") from None


def _fields(about: dict[str, Any], arrays: dict[str, _Array], scene: Scene) -> dict[str, Any]:
    """Fields of a trajectory."""
    if tuple(about["joints"]) != scene.joint_names:
        raise of_argument(ArgumentError, "scene", f"found the joints {', '.join(scene.joint_names)}; expected those of the file: {', '.join(about['joints'])}")

    def several(name: str) -> tuple[_Array, ...]:
        return tuple(arrays[f"{name}/{at}"] for at in range(sum(key.startswith(f"{name}/") for key in arrays)))

    contacts, end = None, several("end")
    if "contacts/touching" in arrays:
        arrays |= _all_contacts(arrays, scene)
    if "contacts/residual" in arrays:
        # Archives of versions without smoothing have no bias.
        exact = {f"contacts/{name}": np.zeros_like(arrays["contacts/depth"]) for name in ("bias", "hover", "creep")}
        named = ("gap", "slip", "force", "impulse", "state")
        parts: dict[str, Any] = {name: (exact | arrays)[f"contacts/{name}"] for name in ContactMotion._fields if name not in ("shapes", *named)}
        for name in named:
            parts[name] = dict(zip(scene.contacts.names, arrays.get(f"contacts/{name}", ()), strict=True))
        of_shapes = {name: arrays.get(f"contacts/shapes/{name}") for name in ShapeContacts._fields if name != "names"}
        parts["shapes"] = ShapeContacts(scene.collider_names, **of_shapes) if "contacts/shapes/row" in arrays else no_shapes(scene)  # type: ignore[arg-type]
        contacts = ContactMotion(**parts)
    given = about["given"]
    if given is not None:
        given |= {name: arrays[f"given/{name}"] for name in GIVEN if f"given/{name}" in arrays}
        start = "given/wrenches/"
        wrenches = {name.removeprefix(start): values for name, values in arrays.items() if name.startswith(start)}
        given |= {"wrenches": wrenches} if wrenches else {}
        if "given/pd/kp" in arrays:
            law = PD(*(arrays.get(f"given/pd/{part}") for part in PD._fields))  # type: ignore[arg-type]
            is_flag = law.effort is not None and np.asarray(law.effort).dtype == bool
            given["pd"] = law._replace(effort=bool(law.effort)) if is_flag else law
    stops = [StopImpact(**one | {"state": tuple(one["state"]) if isinstance(one["state"], list) else one["state"]}) for one in about["stops"]]
    return {
        "scene": scene, "given": given, "stops": stops, "contacts": contacts, "end": end or None, "works": several("works"),
        **{name: arrays.get(name) for name in OPTIONAL},
        **{name: arrays[name] for name in ARRAYS}, **{name: about[name] for name in PLAIN},
    }  # fmt: skip


def _all_contacts(arrays: dict[str, _Array], scene: Scene) -> dict[str, _Array]:
    """Arrays of all contacts from those of a compact archive."""
    gaps = np.moveaxis(scene.contacts.gaps(arrays["q"]), -1, 0)
    found: dict[str, Any] = {"contacts/gap": gaps}
    for name, width, kind, missing in (("slip", (3,), float, np.nan), ("force", (3,), float, 0.0), ("impulse", (3,), float, 0.0), ("state", (), np.int8, 0)):
        found[f"contacts/{name}"] = np.full((*gaps.shape, *width), missing, kind)
        if len(arrays["contacts/touching"]):
            found[f"contacts/{name}"][arrays["contacts/touching"]] = arrays[f"contacts/{name}"]
    return found
