"""Linear model of measured torques: tau = W x + known, with the parameters of bodies and motors in x.

Each row belongs to a motor. With motor velocities = B qd, joint torques are B^T times motor torques, so that W = B^-T Y
for the bodies (Y: Scene.regressor). The columns of motor i are armature (B qdd)_i, damping (B qd)_i, Coulomb friction
s_i = smooth sign of (B qd)_i, offset 1, Stribeck friction s_i exp(-(v/vs)^2), and load-dependent friction s_i |model
torque|. Without a transmission, B is the identity and the motors are the degrees of freedom. Speeds of friction are
those of joints: for motor i they are multiplied by the norm of row i of B. Friction that differs between the
directions of motion has the further columns |s_i| and |(B qd)_i|: half of the difference of Coulomb friction and of
damping between positive and negative velocities. Damping and Coulomb friction of joint j, in
addition to those of motors, are the columns B^-T e_j qd_j and B^-T e_j s_j.

With connections, whose forces are unknown, the rows are multiplied by the projector P = U U* on the motions of the
motors that the connections allow: P tau = P (W x + known).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .._arguments import names_of
from .._friction import TERMS, opposing
from ..errors import ArgumentError, ShapeError, of_argument
from ._allowed import allowed_motions, on_connections

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["KINDS", "PROPERTIES", "Columns", "Extra"]

_Array = NDArray[np.float64]

#: Motor parameters, each with the property of a scene.
PROPERTIES = {
    "armature": "armature",
    "damping": "damping",
    "friction": "friction",
    "offset": "friction_offset",
    "stribeck": "stribeck",
    "load": "load_friction",
}
#: Parameters of joints beside those of motors, with a transmission.
OF_JOINTS = {"joint_damping": "damping", "joint_friction": "friction"}
PROPERTIES |= OF_JOINTS
#: Half differences of the friction of both directions, with the friction that they differ from. A scene has none.
ASYMMETRIC = {"friction_asymmetry": "friction", "damping_asymmetry": "damping"}
KINDS = (*PROPERTIES, *ASYMMETRIC)
#: Parameters of either sign.
SIGNED = ("offset", "stribeck", *ASYMMETRIC)
#: Maximum condition number of a transmission.
CONDITION = 1e8


def per_joint(kind: str, ratio: float) -> float:
    """Property of a joint per parameter of its motor, for the velocity of the motor per velocity of the joint."""
    return {"offset": ratio, "friction": abs(ratio), "stribeck": abs(ratio), "load": 1.0}.get(kind, ratio**2)


class Extra(NamedTuple):
    """Parameter of a motor."""

    kind: str
    name: str
    rows: tuple[int, ...]
    """Rows that the parameter affects; several rows for a joint with several degrees of freedom."""
    model: float
    """Value in the scene; zero if the scene does not have the parameter."""


class Parts(NamedTuple):
    """Columns at some states."""

    of_bodies: _Array
    """The regressor, (k, motors x bodies x 10)."""
    of_motors: list[_Array]
    """Motor columns of each row of torques, (k, number)."""
    known: _Array
    """Torques that do not depend on the parameters, (k, motors)."""


class Columns:
    """The columns of W for a scene."""

    def __init__(
        self,
        scene: Scene,
        fit: Collection[str] = (),
        keep: Collection[str] = (),
        friction_speed: float = 0.01,
        stribeck_speed: float = 0.1,
        transmission: ArrayLike | None = None,
        load: Scene | None = None,
    ) -> None:
        fit, keep = names_of(fit), names_of(keep)
        for name in fit:
            if name not in KINDS:
                raise of_argument(ArgumentError, "fit", f"found {name!r}; expected names of {', '.join(KINDS)}")
        for name in keep:
            if name not in scene.body_names:
                raise of_argument(ArgumentError, "keep", f"found {name!r}; expected names of scene.body_names")
        for argument, value in (("friction_speed", friction_speed), ("stribeck_speed", stribeck_speed)):
            # The square of the speed is used.
            if not (value > 0.0 and 0.0 < value * value < np.inf):
                raise of_argument(ArgumentError, argument, f"found {value}; expected a finite speed above zero")
        self.scene, self.fit, self.keep, self.load = scene, tuple(dict.fromkeys(fit)), tuple(keep), load
        self.slow, self.stribeck = float(friction_speed), float(stribeck_speed)
        if transmission is None and (of_joints := [name for name in fit if name in OF_JOINTS]):
            other = f"expected {OF_JOINTS[of_joints[0]]!r}, which without a transmission is that of the joints"
            raise of_argument(ArgumentError, "fit", f"found {of_joints[0]!r} without a transmission; {other}")
        self.own = scene.inertial_parameters
        is_kept = [[kind not in fit] for kind in ("offset", "stribeck", "stribeck", "load")]
        #: Friction that is not fitted: Coulomb friction, and the other terms.
        self._coulomb = np.where("friction" in fit, 0.0, scene.friction)
        self._terms = np.where(is_kept, scene.friction_terms, [[0.0], [0.0], [1.0], [0.0]])
        self.free = [at for at, name in enumerate(scene.body_names) if name not in keep]
        self.kept = [at for at in range(len(scene.body_names)) if at not in self.free]
        self.transmission = None if transmission is None else _checked_transmission(scene, transmission)
        self.inverse = None if self.transmission is None else np.linalg.inv(self.transmission)
        #: Velocity of each motor at joint velocities of one.
        self.ratios = np.ones(scene.nv) if self.transmission is None else np.linalg.norm(self.transmission, axis=1)
        self.motors = scene.nv
        #: Joints that no motor moves alone. Friction of the other joints is not separate from that of their motors.
        self.beside = np.zeros(scene.nv, dtype=bool)
        if self.transmission is not None:
            single = self.transmission[np.count_nonzero(self.transmission, axis=1) == 1]
            self.beside = ~np.any(single, axis=0)
        if "joint_friction" in fit:
            self._coulomb = np.where(self.beside, 0.0, self._coulomb)
        #: True if torques are determined only as far as they act on motions that the connections allow.
        self.connected = bool(scene.loops.names)
        self.motor_names = self._names()
        self.extras = [] if not self.fit else list(self._extras())
        self.width = 10 * len(self.free) + len(self.extras)
        if not self.width:
            raise of_argument(
                ArgumentError,
                "keep",
                "found all bodies, and no joint parameters in fit; expected at least one parameter to identify",
            )
        self.used = self._used()
        #: Body columns of each row, as indices into the flattened regressor, (motors x bodies x 10).
        free = np.array([10 * body + entry for body in self.free for entry in range(10)], dtype=np.intp)
        size = 10 * len(scene.body_names)
        self.chosen = [motor * size + free[used[used < len(free)]] for motor, used in enumerate(self.used)]

    def _names(self) -> list[str]:
        joints = [""] * self.scene.nv
        for joint in self.scene.joint_names:
            of = self.scene.v_index(joint)
            for at in range(of.start, of.stop):
                joints[at] = joint if of.stop - of.start == 1 else f"{joint}[{at - of.start}]"
        if self.transmission is None:
            return joints
        return ["+".join(name for name, entry in zip(joints, row, strict=True) if entry) for row in self.transmission]

    def _extras(self) -> Iterator[Extra]:
        scene, terms = self.scene, dict(zip(TERMS, self.scene.friction_terms, strict=True))
        values = {kind: terms[name] if name in terms else getattr(scene, name) for kind, name in PROPERTIES.items()}
        values |= dict.fromkeys(ASYMMETRIC, np.zeros(scene.nv))
        for kind in self.fit:
            if self.transmission is None:
                for joint in scene.joint_names:
                    of = scene.v_index(joint)
                    # A floating base does not have motor parameters.
                    if scene.joints[joint].type != "floating":
                        yield Extra(
                            kind,
                            joint,
                            tuple(range(of.start, of.stop)),
                            float(values[kind][of][0]),
                        )
                continue
            if kind in OF_JOINTS:
                assert self.inverse is not None
                for joint in scene.joint_names:
                    at = scene.v_index(joint).start
                    if self.beside[at]:
                        rows = tuple(int(motor) for motor in np.flatnonzero(self.inverse[at]))
                        yield Extra(kind, joint, rows, float(values[kind][at]))
                continue
            for at, row in enumerate(self.transmission):
                (entries,) = np.nonzero(row)
                model = 0.0
                if len(entries) == 1:
                    model = float(values[kind][entries[0]]) / per_joint(kind, float(row[entries[0]]))
                yield Extra(kind, self.motor_names[at], (at,), model)

    def _used(self) -> list[NDArray[np.intp]]:
        """Structurally nonzero columns of each row: bodies outboard of its joints, and its motor."""
        scene, names = self.scene, self.scene.body_names
        if self.connected:
            return [np.arange(self.width, dtype=np.intp)] * self.motors
        # Two states suffice: an entry that is zero at both is structurally zero.
        draw = np.random.default_rng(0)
        q = scene.integrate(np.broadcast_to(scene.neutral(), (2, scene.nq)), draw.uniform(-1, 1, (2, scene.nv)))
        rows = scene.regressor(q, *draw.uniform(-1, 1, (2, 2, scene.nv)))
        touched = np.any(rows != 0.0, axis=(0, 3))
        if self.inverse is not None:
            touched = (np.abs(self.inverse.T) @ touched.astype(float)) > 0.0
        found = []
        for row in range(self.motors):
            bodies = [at for at, body in enumerate(self.free) if touched[row, body]]
            columns = [10 * at + entry for at in bodies for entry in range(10)]
            columns += [10 * len(self.free) + at for at, extra in enumerate(self.extras) if row in extra.rows]
            found.append(np.array(columns, dtype=np.intp))
        assert len(names) == touched.shape[1]
        return found

    def names(self) -> list[str]:
        """Names of the columns."""
        entries = ("m", "m*cx", "m*cy", "m*cz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
        bodies = [f"{self.scene.body_names[at]}.{entry}" for at in self.free for entry in entries]
        return bodies + [f"{extra.name}.{extra.kind}" for extra in self.extras]

    def states(self, count: int, largest: float, draw: np.random.Generator) -> tuple[_Array, _Array, _Array]:
        """Random states, with velocities and accelerations that the connections allow."""
        scene = self.scene
        q = scene.integrate(np.broadcast_to(scene.neutral(), (count, scene.nq)), draw.uniform(-largest, largest, (count, scene.nv)))
        qd, qdd = draw.standard_normal((2, count, scene.nv))
        return on_connections(scene, q, qd) if self.connected else (q, qd, qdd)

    def projector(self, q: _Array) -> _Array | None:
        """The projector P, (k, motors, motors); None without connections."""
        if not self.connected:
            return None
        motions = allowed_motions(self.scene, q, self.transmission)
        return motions @ np.swapaxes(motions, -1, -2)

    def measured(self, q: _Array, tau: _Array) -> _Array:
        """Measured motor torques as the rows determine them, (k, motors).

        With connections, P tau: of a state in which one torque was not measured, none is known.
        """
        projector = self.projector(q)
        return tau if projector is None else np.einsum("kij,kj->ki", projector, tau)

    def to_joints(self, torques: _Array) -> _Array:
        """Joint torques from motor torques, (..., motors)."""
        return torques if self.transmission is None else torques @ self.transmission

    def to_motors(self, torques: _Array) -> _Array:
        """Motor torques from joint torques, (k, nv)."""
        return torques if self.inverse is None else torques @ self.inverse

    def rates(self, qd: _Array) -> _Array:
        """Motor velocities from joint velocities, (k, nv)."""
        return qd if self.transmission is None else qd @ self.transmission.T

    def of_motors(
        self, q: _Array, qd: _Array, qdd: _Array, kinds: Collection[str] | None = None
    ) -> dict[str, _Array]:
        """Motor columns of each kind, of those in `fit` by default, (k, motors), and columns of joints,
        (k, nv)."""
        v = self.rates(qd)
        sliding = v / np.sqrt(v**2 + (self.slow * self.ratios) ** 2)
        found: dict[str, _Array] = {}
        for kind in self.fit if kinds is None else kinds:
            if kind == "armature":
                found[kind] = self.rates(qdd)
            elif kind == "damping":
                found[kind] = v
            elif kind == "friction":
                found[kind] = sliding
            elif kind == "offset":
                found[kind] = np.ones_like(v)
            elif kind == "stribeck":
                found[kind] = sliding * np.exp(-((v / (self.stribeck * self.ratios)) ** 2))
            elif kind == "friction_asymmetry":
                found[kind] = np.abs(sliding)
            elif kind == "damping_asymmetry":
                found[kind] = np.abs(v)
            elif kind == "joint_damping":
                found[kind] = qd
            elif kind == "joint_friction":
                found[kind] = qd / np.sqrt(qd**2 + self.slow**2)
            else:
                load = self.scene if self.load is None else self.load
                found[kind] = sliding * np.abs(self.to_motors(load.inverse_dynamics(q, qd, qdd)))
        return found

    def of_extras(self, q: _Array, qd: _Array, qdd: _Array) -> _Array:
        """Columns of the motor parameters, (k, motors, extras)."""
        kinds, found = self.of_motors(q, qd, qdd), np.zeros((len(q), self.motors, len(self.extras)))
        for at, extra in enumerate(self.extras):
            if extra.kind in OF_JOINTS:
                assert self.inverse is not None
                joint = self.scene.v_index(extra.name).start
                found[:, :, at] = kinds[extra.kind][:, joint, None] * self.inverse[joint]
                continue
            rows = list(extra.rows)
            found[:, rows, at] = kinds[extra.kind][:, rows]
        return found

    def of_joint(self, extra: Extra) -> tuple[str, float] | None:
        """Joint of a motor parameter and the property of the joint per parameter; None if a scene has no such property,
        or if the motor moves several joints."""
        if extra.kind not in PROPERTIES:
            return None
        if self.transmission is None or extra.kind in OF_JOINTS:
            return extra.name, 1.0
        row = self.transmission[extra.rows[0]]
        (entries,) = np.nonzero(row)
        if len(entries) != 1:
            return None
        return self.scene.joint_names[int(entries[0])], per_joint(extra.kind, float(row[entries[0]]))

    def known(self, q: _Array, qd: _Array, qdd: _Array) -> _Array:
        """Motor torques that do not depend on the parameters: springs, and joint properties not in `fit`, (k,
        motors)."""
        scene = self.scene
        found = scene.stiffness * scene.difference(np.broadcast_to(scene.rest, q.shape), q)
        for name, column in {"armature": qdd, "damping": qd}.items():
            if name not in self.fit:
                known = getattr(scene, name)
                if f"joint_{name}" in self.fit:
                    known = np.where(self.beside, 0.0, known)
                found = found + known * column
        direction = qd / np.sqrt(qd**2 + self.slow**2)
        load = scene.inverse_dynamics(q, qd, qdd) if self._terms[3].any() else None
        return self.to_motors(found + opposing(scene, qd, direction, load, self._coulomb, self._terms))

    def regressor(self, q: _Array, qd: _Array, qdd: _Array) -> _Array:
        """Regressor W of all bodies, (k, motors, bodies, 10)."""
        rows = self.scene.regressor(q, qd, qdd)
        return rows if self.inverse is None else np.einsum("ji,kjbp->kibp", self.inverse, rows)

    def rows(self, q: _Array, qd: _Array, qdd: _Array) -> tuple[list[_Array], _Array]:
        """Nonzero columns of each row, (k, used), and torques that do not depend on the parameters, (k, motors)."""
        parts = self.parts(q, qd, qdd)
        return [
            np.concatenate([parts.of_bodies[:, chosen], own], axis=1)
            for chosen, own in zip(self.chosen, parts.of_motors, strict=True)
        ], parts.known

    def parts(self, q: _Array, qd: _Array, qdd: _Array) -> Parts:
        """Return the columns as in `rows`, without copies: `chosen[i]` indexes the body columns of row i."""
        of_bodies = self.regressor(q, qd, qdd)
        projector = self.projector(q)
        known = self.known(q, qd, qdd)
        if self.kept:
            known = known + np.einsum("kibp,bp->ki", of_bodies[:, :, self.kept], self.own[self.kept])
        extras, bodies = self.of_extras(q, qd, qdd), 10 * len(self.free)
        if projector is not None:
            size = of_bodies.shape[2:]
            of_bodies = (projector @ of_bodies.reshape(len(q), self.motors, -1)).reshape(len(q), self.motors, *size)
            of_motors = list(np.moveaxis(projector @ extras, 1, 0))
            known = np.einsum("kij,kj->ki", projector, known)
            of_bodies = np.ascontiguousarray(of_bodies).reshape(len(q), -1)
            return Parts(of_bodies, [np.ascontiguousarray(own) for own in of_motors], known)
        of_motors = [
            np.ascontiguousarray(extras[:, motor, used[used >= bodies] - bodies])
            for motor, used in enumerate(self.used)
        ]
        return Parts(of_bodies.reshape(len(q), -1), of_motors, known)

    def sensitivity(self, q: _Array, qd: _Array, qdd: _Array, joint: int) -> list[_Array]:
        """Derivative of the columns and, as last column, of the known torques by the acceleration of one degree of
        freedom.

        Both are linear in the acceleration.
        """
        ahead = qdd.copy()
        ahead[:, joint] += 1.0
        (rows, known), (rows_here, known_here) = self.rows(q, qd, ahead), self.rows(q, qd, qdd)
        off = known - known_here
        return [
            np.column_stack([one - other, off[:, motor]])
            for motor, (one, other) in enumerate(zip(rows, rows_here, strict=True))
        ]

    def same_as(self, other: Columns) -> bool:
        """Return whether both objects have the same columns."""
        mine, its = self.transmission, other.transmission
        alike = (mine is None) == (its is None) and (mine is None or its is None or np.array_equal(mine, its))
        return (
            alike
            and self.names() == other.names()
            and np.array_equal(self.own, other.own)
            and (self.slow, self.stribeck) == (other.slow, other.stribeck)
        )


def flattened(
    scene: Scene, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike
) -> tuple[tuple[int, ...], tuple[_Array, _Array, _Array]]:
    """Leading axes of states, broadcast, and the states with one leading axis."""
    q, qd, qdd = (
        np.asarray(_core._numbers(*one))
        for one in (("q", q, scene, True), ("qd", qd, scene), ("qdd", qdd, scene))
    )
    try:
        batch = np.broadcast_shapes(q.shape[:-1], qd.shape[:-1], qdd.shape[:-1])
    except ValueError:
        raise of_argument(
            ShapeError,
            "q",
            f"found leading axes {q.shape[:-1]}, {qd.shape[:-1]} and {qdd.shape[:-1]}; expected ones that broadcast",
        ) from None
    q, qd, qdd = (np.broadcast_to(one, (*batch, one.shape[-1])).reshape(-1, one.shape[-1]) for one in (q, qd, qdd))
    return batch, (q, qd, qdd)


def _checked_transmission(scene: Scene, transmission: ArrayLike) -> _Array:
    found = np.array(_core._numbers("transmission", transmission))
    if found.shape != (scene.nv, scene.nv):
        raise of_argument(
            ShapeError,
            "transmission",
            f"found shape {found.shape}; expected ({scene.nv}, {scene.nv}): motor velocities = transmission @ qd",
        )
    if not np.all(np.isfinite(found)) or not np.linalg.cond(found) < CONDITION:
        raise of_argument(
            ArgumentError,
            "transmission",
            "found a matrix that is not finite or has no inverse; expected motors that move all joints",
        )
    several = [joint for joint in scene.joint_names if scene.v_index(joint).stop - scene.v_index(joint).start != 1]
    if several:
        raise of_argument(
            ArgumentError,
            "transmission",
            f"found a scene with joint {several[0]!r} of several degrees of freedom; expected joints of one axis, or no"
            " transmission",
        )
    return found
