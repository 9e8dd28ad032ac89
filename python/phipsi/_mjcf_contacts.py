"""Contacts of a MuJoCo model: the pairs of geoms that can collide, and the points of a geom that can touch a plane."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ._mjcf import Names, has_constraints, is_disabled, is_soft

if TYPE_CHECKING:
    import mujoco

_Array = NDArray[np.float64]

#: Values of mjtGeom.
PLANE, HFIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = range(8)
#: Geoms whose convex hull is that of spheres and points.
HULLS = (SPHERE, CAPSULE, CYLINDER, BOX, MESH)
#: Number of points on each rim of a cylinder.
OF_RIM = 8


class Pair(NamedTuple):
    """A fixed plane and a geom of a moving body that can collide, and the parameters of their contact."""

    plane: int
    geom: int
    condim: int
    friction: _Array
    """Sliding in two directions, torsional, rolling in two directions, (5,)."""
    solref: _Array
    solimp: _Array
    margin: float
    """Distance at which the contact begins to act, m."""


class Point(NamedTuple):
    """A point or sphere of a body, and the plane that it can touch."""

    name: str
    body: int
    center: _Array
    """In the frame of the body, (3,), m."""
    radius: float
    normal: _Array
    offset: float
    friction: float


class Between(NamedTuple):
    """A sphere of a moving body and a sphere or box of another body, of a <pair>."""

    name: str
    body: int
    center: _Array
    """In the frame of the body, (3,), m."""
    radius: float
    other: int
    """The other body; 0 for the world."""
    origin: _Array
    rotation: _Array
    """Frame of the other geom in its body."""
    shape: dict[str, Any]
    """other_radius or other_size of SceneBuilder.contact."""
    friction: float


class Collisions:
    """The pairs of geoms that can collide according to MuJoCo's filters: those with fixed planes and each <pair> of
    spheres and boxes, which a scene can represent, and whether there are others.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        rigid = model.body_weldid[model.geom_bodyid]
        self._is_plane = (model.geom_type == PLANE) & (rigid == 0)
        self._has_hull = np.isin(model.geom_type, HULLS) & (rigid != 0)

    def with_planes(self) -> list[Pair]:
        """The pairs of a fixed plane and a geom whose convex hull is that of spheres and points."""
        model, found, explicit = self.model, [], set[frozenset[int]]()
        for at in self._explicit():
            ends = int(model.pair_geom1[at]), int(model.pair_geom2[at])
            explicit.add(frozenset(ends))
            if (both := self._ordered(*ends)) is not None:
                found.append(self._given(at, both))
        for one, others in self._filtered():
            for other in others[self._are_read(one, others)].tolist():
                both = self._ordered(one, other)
                if both is not None and frozenset(both) not in explicit:
                    found.append(_combined(model, *both))
        return found

    def between(self) -> list[Pair]:
        """Each <pair> of a sphere of a moving body and a sphere or box of another body: the other geom (as `plane`) and
        the sphere.
        """
        model, found = self.model, []
        for at in self._explicit():
            ends = int(model.pair_geom1[at]), int(model.pair_geom2[at])
            if (both := self._spheres(*ends)) is not None:
                found.append(self._given(at, both))
        return found

    def first_other(self, planes: bool) -> tuple[int, int] | None:
        """The first pair; with `planes`, the first one that is not read; None if there is none."""
        model, read = self.model, set[frozenset[int]]()
        for at in self._explicit():
            ends = int(model.pair_geom1[at]), int(model.pair_geom2[at])
            if not planes or (self._ordered(*ends) is None and self._spheres(*ends) is None):
                return ends
            read.add(frozenset(ends))
        for one, others in self._filtered():
            left = others[~self._are_read(one, others)] if planes else others
            for other in left.tolist():
                if frozenset((one, other)) not in read:
                    return one, other
        return None

    def _explicit(self) -> range:
        """Indices of <pair>."""
        return range(self.model.npair if has_constraints(self.model, "CONTACT") else 0)

    def _given(self, at: int, both: tuple[int, int]) -> Pair:
        """The parameters of a <pair>."""
        model = self.model
        margin = model.pair_margin[at] - (model.pair_gap[at] if _margin_rule()[1] else 0.0)
        given = model.pair_friction[at], model.pair_solref[at], model.pair_solimp[at]
        return Pair(*both, int(model.pair_dim[at]), *given, float(margin))

    def _spheres(self, one: int, other: int) -> tuple[int, int] | None:
        """A sphere or box, and a sphere of a body that moves against it; None for another pair."""
        types, rigid = self.model.geom_type, self.model.body_weldid[self.model.geom_bodyid]
        for surface, sphere in ((one, other), (other, one)):
            if types[sphere] == SPHERE and types[surface] in (SPHERE, BOX) and rigid[sphere] not in (0, rigid[surface]):
                return surface, sphere
        return None

    def _are_read(self, one: int, others: Any) -> Any:
        return (self._is_plane[one] & self._has_hull[others]) | (self._has_hull[one] & self._is_plane[others])

    def _ordered(self, one: int, other: int) -> tuple[int, int] | None:
        """Plane and geom; None for another pair."""
        if self._is_plane[one] and self._has_hull[other]:
            return one, other
        return (other, one) if self._is_plane[other] and self._has_hull[one] else None

    def _filtered(self) -> Iterator[tuple[int, Any]]:
        """Each geom, and those after it with which it can collide."""
        model = self.model
        if not has_constraints(model, "CONTACT"):
            return
        types, affinities, bodies = model.geom_contype, model.geom_conaffinity, model.geom_bodyid
        rigid = model.body_weldid[bodies]
        above = model.body_weldid[model.body_parentid[rigid]]
        filters_parents, excluded = not is_disabled(model, "FILTERPARENT"), model.exclude_signature
        geoms = np.flatnonzero(types | affinities)
        for at, one in enumerate(geoms.tolist()):
            other = geoms[at + 1 :]
            may = ((types[one] & affinities[other]) | (types[other] & affinities[one])) != 0
            may &= rigid[other] != rigid[one]
            if filters_parents:
                # A body does not collide with its parent, unless that is fixed to the world.
                of_parent = ((above[other] == rigid[one]) & (rigid[one] != 0)) | ((above[one] == rigid[other]) & (rigid[other] != 0))
                may &= ~of_parent
            ends = np.sort(np.stack([np.full(len(other), bodies[one]), bodies[other]]), axis=0)
            may &= ~np.isin((ends[0] << 16) + ends[1], excluded)
            yield one, other[may]


def _combined(model: mujoco.MjModel, plane: int, geom: int) -> Pair:
    """Parameters of the contact of two geoms: those of the geom with the higher priority; otherwise the larger friction
    and condim, and the mean of solref and solimp.
    """
    ends = [plane, geom]
    adds, less_gap = _margin_rule()
    margin = model.geom_margin[ends].sum() if adds else model.geom_margin[ends].max()
    margin -= model.geom_gap[ends].max() if less_gap else 0.0
    priorities = model.geom_priority[ends]
    by = [ends[int(priorities.argmax())]] if priorities[0] != priorities[1] else ends
    weights = model.geom_solmix[by]
    weights = weights / weights.sum() if weights.sum() > 0.0 else np.full(len(by), 1.0 / len(by))
    solref = model.geom_solref[by]
    solref = weights @ solref if np.all(solref[:, 0] > 0.0) else solref.min(axis=0)
    friction = model.geom_friction[by].max(axis=0)[[0, 0, 1, 2, 2]]
    return Pair(plane, geom, int(model.geom_condim[by].max()), friction, solref, weights @ model.geom_solimp[by], float(margin))


@cache
def _margin_rule() -> tuple[bool, bool]:
    """Whether this version of MuJoCo adds the margins of two geoms (older ones take the larger one), and whether the
    gap is subtracted.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="plane" size="1 1 1" margin="0.25"/><body><freejoint/>'
        '<geom size="0.1" margin="0.5" gap="0.125"/></body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = float(data.contact[0].includemargin)
    return found > 0.55, found in (0.625, 0.375)


def points(model: mujoco.MjModel, names: Names) -> list[Point]:
    """The points of moving geoms that can touch a fixed plane. Points that no joint moves are omitted."""
    import mujoco

    found = Collisions(model).with_planes()
    if not found:
        return []
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    planes = {pair.plane: (data.geom_xmat[pair.plane].reshape(3, 3)[:, 2].copy(), data.geom_xpos[pair.plane].copy()) for pair in found}
    can_move = _Movable(model)
    made = []
    for pair in found:
        plane, geom = pair.plane, pair.geom
        normal, origin = planes[plane]
        name = model.geom(geom).name or f"geom{geom}"
        if len(planes) > 1:
            name = f"{name} on {model.geom(plane).name or f'geom{plane}'}"
        centers, radius = _hull(model, geom)
        body = int(model.geom_bodyid[geom])
        friction = float(pair.friction[0]) if pair.condim > 1 else 0.0
        kept = [center for center in centers if can_move(body, center, radius, normal)]
        for at, center in enumerate(kept):
            own = f"{name}/{at}" if len(kept) > 1 else name
            made.append(Point(own, body, center, radius, normal, float(normal @ origin) + pair.margin, friction))
    taken = set[str]()
    for at, point in enumerate(made):
        name = point.name
        while name in taken:
            name += "_"
        taken.add(name)
        made[at] = point._replace(name=name)
    return made


def pairs(model: mujoco.MjModel) -> list[Between]:
    """The contacts of each <pair> of spheres and boxes of bodies that move against each other. `margin` enlarges the
    sphere.
    """
    import mujoco

    made = []
    for pair in Collisions(model).between():
        surface, sphere = pair.plane, pair.geom
        first, second = (model.geom(geom).name or f"geom{geom}" for geom in (sphere, surface))
        size, turn = model.geom_size[surface], np.empty(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[surface])
        shape = {"other_radius": float(size[0])} if model.geom_type[surface] == SPHERE else {"other_size": 2.0 * size}
        radius, friction = float(model.geom_size[sphere][0]) + pair.margin, float(pair.friction[0]) if pair.condim > 1 else 0.0
        bodies = int(model.geom_bodyid[sphere]), int(model.geom_bodyid[surface])
        frame = model.geom_pos[surface], turn.reshape(3, 3)
        made.append(Between(f"{first} on {second}", bodies[0], model.geom_pos[sphere], radius, bodies[1], *frame, shape, friction))
    return made


def _hull(model: mujoco.MjModel, geom: int) -> tuple[_Array, float]:
    """Centers in the frame of the body, (n, 3), and radius of the spheres whose convex hull is that of the geom."""
    import mujoco

    size, kind, radius = model.geom_size[geom], model.geom_type[geom], 0.0
    if kind == SPHERE:
        own, radius = np.zeros((1, 3)), size[0]
    elif kind == CAPSULE:
        own, radius = np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]]), size[0]
    elif kind == BOX:
        own = size * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    elif kind == CYLINDER:
        angles = 2.0 * np.pi * np.arange(OF_RIM) / OF_RIM
        rim = size[0] * np.stack([np.cos(angles), np.sin(angles), np.zeros(OF_RIM)], axis=-1)
        own = np.concatenate([rim - [0.0, 0.0, size[1]], rim + [0.0, 0.0, size[1]]])
    else:
        own = _hull_of_mesh(model, int(model.geom_dataid[geom]))
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    return model.geom_pos[geom] + own @ turn.reshape(3, 3).T, float(radius)


def _hull_of_mesh(model: mujoco.MjModel, mesh: int) -> _Array:
    """Vertices of the convex hull of a mesh; all vertices if MuJoCo has not computed the hull."""
    first, count, at = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh], model.mesh_graphadr[mesh]
    vertices = np.asarray(model.mesh_vert[first : first + count], float)
    if at < 0:
        return np.unique(vertices, axis=0)
    # The graph is: number of vertices, number of faces, addresses of the edges, indices of the vertices, ...
    number = model.mesh_graph[at]
    return np.asarray(vertices[model.mesh_graph[at + 2 + number : at + 2 + 2 * number]])


class _Movable:
    """Whether joints can move the point of a sphere that is nearest to a plane, in one of two configurations."""

    def __init__(self, model: mujoco.MjModel) -> None:
        import mujoco

        self._model, self._states = model, []
        for scale in (0.3, 0.7):
            data = mujoco.MjData(model)
            mujoco.mj_integratePos(model, data.qpos, np.cos(np.arange(model.nv, dtype=float)), scale)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            self._states.append(data)

    def __call__(self, body: int, center: _Array, radius: float, normal: _Array) -> bool:
        import mujoco

        jacobian = np.zeros((3, self._model.nv))
        for data in self._states:
            point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ center - radius * normal
            mujoco.mj_jac(self._model, data, jacobian, None, point, body)
            if np.abs(jacobian).max(initial=0.0) > 1e-9:
                return True
        return False


def unsupported(model: mujoco.MjModel, names: Names, planes: bool) -> Iterator[tuple[str, str, str]]:
    """Collisions that a scene does not represent: name in `ignore`, what was found, and the consequence. planes: those
    with fixed planes are read.
    """
    collisions = Collisions(model)
    if (other := collisions.first_other(planes)) is not None:
        first, second = (names.bodies[model.geom_bodyid[end]] for end in other)
        consequence = "they can pass through each other, because only contacts with fixed planes and each <pair> of spheres and boxes are read"
        if not planes:
            consequence = 'bodies can pass through each other, because contacts of a file are read only with contacts="plane"'
        elif {ELLIPSOID, PLANE} <= set(model.geom_type[list(other)].tolist()):
            consequence = "contacts of ellipsoids are not read"
        yield "contacts", f"geoms that collide, of {first!r} and {second!r} for instance", consequence
    for pair in [*collisions.with_planes(), *collisions.between()] if planes else []:
        plane, geom = (model.geom(end).name or f"geom{end}" for end in (pair.plane, pair.geom))
        what = f"the contact of {plane!r} and {geom!r}"
        if pair.condim > 3:
            yield "contacts", f"condim {pair.condim} of {what}", "torsional and rolling friction are not read"
        if pair.condim > 1 and pair.friction[0] != pair.friction[1]:
            yield "contacts", f"friction {pair.friction[0]:g} and {pair.friction[1]:g} of {what}", "the first is used in both directions"
        if is_soft(pair.solref, pair.solimp):
            yield "softness", f"{what}, which is softer than MuJoCo's default (solref, solimp)", "contacts are rigid"
