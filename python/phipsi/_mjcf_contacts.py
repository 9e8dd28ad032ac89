"""Colliders of a MuJoCo model: the shapes of its geoms, the pairs of geoms that can touch, and their parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import shapes
from ._colliders import fault
from ._coordinates import rotation
from ._mjcf import SOFT, Names, field, has_constraints, is_disabled, is_enabled, is_soft
from ._pose import angles

if TYPE_CHECKING:
    import mujoco

    from ._core import SceneBuilder

_Array = NDArray[np.float64]

#: Values of mjtGeom.
PLANE, HFIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH, SDF = range(9)
#: Geoms that have no shape here.
WITHOUT_SHAPE = {ELLIPSOID: "an ellipsoid", SDF: "a signed distance field"}
#: Rotation about z that takes x to y.
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
#: Number of groups of colliders.
GROUPS = 32
#: Space below a height field, relative to its size.
SPACE = 1e-6


class Pairs(NamedTuple):
    """Pairs of geoms that can collide, and the parameters of their contacts."""

    first: Any
    """Index of a geom of each pair, (n,)."""
    second: Any
    condim: Any
    friction: _Array
    """Sliding friction in both directions, (n, 2)."""
    soft: Any
    """Whether the contact is softer or less damped than MuJoCo's default, (n,)."""
    margin: _Array
    """Distance at which the contact begins to act, m, (n,)."""
    adhesion: _Array
    """Force that attracts the geoms, N, (n,)."""
    is_driven: Any
    """Whether a surface moves along its geom, (n,)."""

    def where(self, condition: Any) -> Pairs:
        """The pairs that satisfy a condition, (n,)."""
        return self if condition.all() else Pairs(*(values[condition] for values in self))

    @property
    def sliding(self) -> _Array:
        """Coefficient of friction of each pair, (n,)."""
        return np.where(self.condim > 1, self.friction[:, 0], 0.0)


#: Parameters that scenes do not have: name in `ignore`, condition, description and consequence.
PARAMETERS: tuple[tuple[str, Callable[[Pairs], Any], str, str], ...] = (
    ("contacts", lambda of: of.condim > 3, "condim {of.condim:g} of {contact}", "torsional and rolling friction are not read"),
    (
        "contacts",
        lambda of: (of.condim > 1) & (of.friction[:, 0] != of.friction[:, 1]),
        "friction {of.friction[0]:g} and {of.friction[1]:g} of {contact}",
        "the first is used in both directions",
    ),
    ("contacts", lambda of: of.margin < 0.0, "a margin less gap of {of.margin:g} m of {contact}", "contacts act from a distance of zero"),
    ("contacts", lambda of: of.adhesion != 0.0, "adhesion {of.adhesion:g} N of {contact}", "contacts do not attract"),
    ("contacts", lambda of: of.is_driven, "a surface velocity (surfacevel) of {contact}", "surfaces move with their bodies"),
    ("softness", lambda of: of.soft, f"{{contact}}, which is {SOFT}", "contacts are rigid"),
)


class Collisions:
    """The geoms of a model that can collide, the pairs that MuJoCo's filters leave, and those that a scene represents:
    with contacts="all" all pairs of geoms that have a shape, with "plane" those with a fixed plane and each <pair>.
    """

    def __init__(self, model: mujoco.MjModel, contacts: str | None) -> None:
        self.model, self.contacts = model, contacts
        self._welded = model.body_weldid[model.geom_bodyid]
        self._moves = np.zeros(model.nbody, bool)
        for body in range(1, model.nbody):
            self._moves[body] = model.body_jntnum[body] or self._moves[model.body_parentid[body]]
        self._is_moved = self._moves[model.geom_bodyid]
        self._is_plane = (model.geom_type == PLANE) & ~self._is_moved
        self._contype, self._conaffinity = (bits.astype(np.int64) & 0xFFFFFFFF for bits in (model.geom_contype, model.geom_conaffinity))
        self._hulls: dict[int, _Array | None] = {}
        #: Pairs that the scene represents, those of <pair> first.
        self.read: list[Pairs] = []
        #: Geoms without a shape that can collide with others.
        self.lost = set[int]()
        #: A pair of geoms that can collide, and that the scene does not represent for another reason.
        self.other: tuple[int, int] | None = None
        for pairs in self._all():
            shaped = self._has_shape[pairs.first] & self._has_shape[pairs.second]
            if contacts is not None and not shaped.all():
                left = pairs.where(~shaped)
                self.lost.update(self.missing.keys() & {*left.first.tolist(), *left.second.tolist()})
            planes = self._is_plane[pairs.first] | self._is_plane[pairs.second]
            wanted = planes if contacts == "plane" and self.read else np.full(len(planes), contacts is not None)
            if self.other is None and not np.all(wanted | ~shaped):
                other = pairs.where(shaped & ~wanted)
                self.other = int(other.first[0]), int(other.second[0])
                if contacts is None:
                    break
            self.read.append(pairs.where(shaped & wanted))

    @cached_property
    def geoms(self) -> Any:
        """Indices of geoms that can collide by their bits or by a <pair>."""
        model = self.model
        if not has_constraints(model, "CONTACT"):
            return np.empty(0, int)
        collide = (self._contype | self._conaffinity) != 0
        collide[model.pair_geom1[: model.npair]] = collide[model.pair_geom2[: model.npair]] = True
        return np.flatnonzero(collide)

    @cached_property
    def missing(self) -> dict[int, str]:
        """Geoms that can collide and have no shape here, with a description of each."""
        found = {}
        for geom in self.geoms.tolist() if self.contacts else ():
            kind, moves = int(self.model.geom_type[geom]), self._is_moved[geom]
            if kind in WITHOUT_SHAPE:
                found[geom] = WITHOUT_SHAPE[kind]
            elif kind in (PLANE, HFIELD) and moves:
                found[geom] = f"a {'plane' if kind == PLANE else 'height field'} on a body that moves"
            elif kind == MESH and self._hull(geom) is None:
                found[geom] = "a mesh whose vertices have no convex hull with a volume"
        return found

    @cached_property
    def _has_shape(self) -> Any:
        has = np.zeros(self.model.ngeom, bool)
        has[self.geoms] = True
        has[list(self.missing)] = False
        return has

    def _all(self) -> Iterator[Pairs]:
        """Pairs that can collide, those of <pair> first."""
        if not len(self.geoms):
            return
        explicit = self._explicit()
        keys = self._key(explicit.first, explicit.second)
        yield explicit.where(self._are_apart(explicit.first, explicit.second))
        # Geoms with equal parameters are of one kind.
        names = "condim", "friction", "priority", "margin", "gap", "solmix", "solref", "solimp", "adhesion", "surfacevel"
        rules = [values.reshape(self.model.ngeom, -1) for name in names if (values := field(self.model, f"geom_{name}")) is not None]
        _, kinds, of = np.unique(np.concatenate(rules, axis=1), axis=0, return_index=True, return_inverse=True)
        of, combined = of.ravel(), cache(lambda kind: self._combined(int(kinds[kind]), kinds))
        for one, others in self._filtered():
            if len(keys):
                others = others[~np.isin(self._key(one, others), keys)]
            _, _, *values = combined(of[one])
            yield Pairs(np.full(len(others), one), others, *(value[of[others]] for value in values))

    def _are_apart(self, one: Any, other: Any) -> Any:
        """Whether geoms can move relative to each other."""
        return (self._welded[one] != self._welded[other]) & (self._is_moved[one] | self._is_moved[other])

    def _key(self, one: Any, other: Any) -> Any:
        return np.minimum(one, other) * np.int64(self.model.ngeom) + np.maximum(one, other)

    def _explicit(self) -> Pairs:
        """Pairs of the elements <pair>."""
        model = self.model
        parameters = model.pair_dim, model.pair_friction[:, :2], model.pair_solref, model.pair_solimp, model.pair_margin, model.pair_gap
        found = self._pairs(model.pair_geom1, model.pair_geom2, *parameters, field(model, "pair_adhesion"))
        sliding = model.pair_solreffriction
        return found._replace(soft=found.soft | (np.any(sliding != 0.0, axis=1) & is_soft(sliding, model.pair_solimp)))

    def _combined(self, one: int, others: Any) -> Pairs:
        """Parameters of the contacts of a geom with others: those of the geom with the higher priority; otherwise the larger
        friction and condim, the mean of solref and solimp, and the sum of adhesions.
        """
        model, count = self.model, len(others)
        ends = np.stack([np.full(count, one), others])
        priority, mix, margins, solref, solimp = (getattr(model, f"geom_{name}")[ends] for name in ("priority", "solmix", "margin", "solref", "solimp"))
        equal, total = (priority[0] == priority[1])[:, None], mix.sum(axis=0)
        # Where the priorities differ, one geom has the whole weight.
        shares = np.divide(mix[0], total, out=np.full(count, 0.5), where=total > 0.0)[:, None]
        weight = np.where(equal, shares, (priority[0] > priority[1])[:, None])
        values = np.concatenate([model.geom_condim[ends][..., None], model.geom_friction[ends][..., [0, 0]]], axis=-1)
        values = np.where(equal, values.max(axis=0), np.where(weight == 1.0, *values))
        is_direct = equal & (solref[:, :, :1] <= 0.0).any(axis=0)
        solref = np.where(is_direct, solref.min(axis=0), weight * solref[0] + (1.0 - weight) * solref[1])
        solimp = weight * solimp[0] + (1.0 - weight) * solimp[1]
        margin = margins.sum(axis=0) if _margin_rule().adds else margins.max(axis=0)
        pulls = field(model, "geom_adhesion")
        adhesion = None if pulls is None else np.where(equal[:, 0], pulls[ends].sum(axis=0), np.where(weight[:, 0] == 1.0, *pulls[ends]))
        return self._pairs(ends[0], others, values[:, 0], values[:, 1:], solref, solimp, margin, model.geom_gap[ends].max(axis=0), adhesion)

    def _pairs(self, first: Any, second: Any, condim: Any, friction: Any, solref: Any, solimp: Any, margin: Any, gap: Any, adhesion: Any) -> Pairs:
        """Pairs with these parameters, or with those of the flag `override`, if it is enabled."""
        option = self.model.opt
        if is_enabled(self.model, "OVERRIDE"):
            margin = np.full(len(first), option.o_margin)
            friction, solref, solimp = (np.broadcast_to(of, (len(first), len(of))) for of in (option.o_friction[:2], option.o_solref, option.o_solimp))
        none, speeds = np.zeros(len(first)), field(self.model, "geom_surfacevel")
        is_driven = none != 0.0 if speeds is None else np.any((speeds[first] != 0.0) | (speeds[second] != 0.0), axis=1)
        distance = margin - gap if _margin_rule().less_gap else margin
        return Pairs(first, second, condim, friction, is_soft(solref, solimp), distance, none if adhesion is None else adhesion, is_driven)

    def _filtered(self) -> Iterator[tuple[int, Any]]:
        """Each geom, and those after it with which it can collide."""
        model, rigid, bodies = self.model, self._welded, self.model.geom_bodyid
        above = model.body_weldid[model.body_parentid[rigid]]
        filters_parents, excluded = not is_disabled(model, "FILTERPARENT"), model.exclude_signature
        geoms = np.flatnonzero(self._contype | self._conaffinity)
        for at, one in enumerate(geoms.tolist()):
            other = geoms[at + 1 :]
            may = self._bits(one, other) & self._are_apart(one, other)
            if filters_parents:
                # A body does not collide with its parent, unless that is fixed to the world.
                may &= ~(((above[other] == rigid[one]) | (above[one] == rigid[other])) & (rigid[one] != 0) & (rigid[other] != 0))
            if len(excluded):
                ends = np.sort(np.stack([np.full(len(other), bodies[one]), bodies[other]]), axis=0)
                may &= ~np.isin((ends[0] << 16) + ends[1], excluded)
            yield one, other[may]

    def _bits(self, one: Any, other: Any) -> Any:
        return ((self._contype[one] & self._conaffinity[other]) | (self._contype[other] & self._conaffinity[one])) != 0

    def raised(self) -> list[int]:
        """Height fields with space below: their underside is above a fixed plane or another height field."""
        import mujoco

        model, used = self.model, np.unique(np.concatenate([ends for of in self.read for ends in of[:2]] or [self.geoms[:0]])).astype(int)
        fields = used[model.geom_type[used] == HFIELD]
        if not len(fields):
            return []
        mujoco.mj_kinematics(model, data := mujoco.MjData(model))
        found = []
        for field in fields.tolist():
            x, y, _, base = model.hfield_size[model.geom_dataid[field]]
            corners = np.array([[x, y, -base], [x, -y, -base], [-x, y, -base], [-x, -y, -base]])
            corners = data.geom_xpos[field] + corners @ data.geom_xmat[field].reshape(3, 3).T
            for below in used[self._is_plane[used] | (model.geom_type[used] == HFIELD)].tolist():
                top = 0.0
                if model.geom_type[below] == HFIELD:
                    number = int(model.geom_dataid[below])
                    at, count = model.hfield_adr[number], model.hfield_nrow[number] * model.hfield_ncol[number]
                    top = model.hfield_size[number, 2] * model.hfield_data[at : at + count].max()
                if np.max((corners - data.geom_xpos[below]) @ data.geom_xmat[below][2::3]) - top > SPACE * max(x, y):
                    found.append(field)
                    break
        return found

    # Into a scene

    def add(self, builder: SceneBuilder, names: Names) -> None:
        """Add the colliders and their rules to a builder."""
        model, geoms = self.model, self.geoms
        if self.contacts == "plane":
            geoms = np.unique(np.concatenate([ends for of in self.read for ends in of[:2]] or [geoms]))
        geoms = geoms[self._has_shape[geoms]]
        # The larger condim counts, which has friction.
        sliding = model.opt.o_friction[0] if is_enabled(model, "OVERRIDE") else model.geom_friction[:, 0]
        own = np.where(model.geom_condim > 1, sliding, 0.0)
        groups, masks = self._groups(geoms)
        for geom in geoms.tolist():
            rules = {"friction": own[geom], "groups": int(groups[geom]), "mask": int(masks[geom])}
            builder.collider(names.geoms[geom], self._shape(geom), link=names.bodies[model.geom_bodyid[geom]], **rules)
        for at, of in enumerate(self.read):
            first, second, friction, margin = of.first, of.second, of.sliding, np.maximum(of.margin, 0.0)
            given = ((groups[first] & masks[second]) | (groups[second] & masks[first])) == 0
            given |= (friction != np.maximum(own[first], own[second])) | (margin > 0.0) | (at == 0)
            for i, j, mu, distance in zip(*(values[given].tolist() for values in (first, second, friction, margin)), strict=True):
                builder.collider_pair(names.geoms[i], names.geoms[j], friction=mu, margin=distance)
        for first, second in sorted(self._apart(set(model.geom_bodyid[geoms].tolist()))):
            builder.exclude(names.bodies[first], names.bodies[second])
        if len(geoms) and is_disabled(model, "FILTERPARENT"):
            builder.collisions_with_parents(True)

    def _groups(self, geoms: Any) -> tuple[Any, Any]:
        """Groups and masks of all geoms as bits. With contacts="plane" each kind of planes is a group, which geoms that are
        no planes can touch.
        """
        if self.contacts == "all":
            return self._contype, self._conaffinity
        planes = geoms[self._is_plane[geoms]]
        groups, masks = np.zeros((2, self.model.ngeom), np.int64)
        _, kinds, of = np.unique(np.stack([self._contype[planes], self._conaffinity[planes]]), axis=1, return_index=True, return_inverse=True)
        for at, kind in enumerate(kinds[:GROUPS]):
            groups[planes[of.ravel() == at]] = 1 << at
            masks |= np.where(self._bits(planes[kind], np.arange(self.model.ngeom)) & ~self._is_plane, 1 << at, 0)
        return groups, masks

    def _apart(self, used: set[int]) -> set[tuple[int, int]]:
        """Pairs of bodies with colliders that do not touch: each <exclude>, and child and parent where the child has several
        joints, between which the scene has links, or the parent is a mocap body, which the scene fixes.
        """
        model = self.model
        apart = {(int(signature) >> 16, int(signature) & 0xFFFF) for signature in model.exclude_signature}
        if not is_disabled(model, "FILTERPARENT"):
            rigid = dict[int, list[int]]()
            for body in used:
                rigid.setdefault(int(model.body_weldid[body]), []).append(body)
            for root, bodies in rigid.items():
                above = int(model.body_weldid[model.body_parentid[root]])
                if above != 0 and (model.body_jntnum[root] > 1 or not self._moves[above]):
                    apart |= {(min(ends), max(ends)) for ends in ((one, other) for one in bodies for other in rigid.get(above, ()))}
        return {ends for ends in apart if used.issuperset(ends)}

    def _shape(self, geom: int) -> shapes.ColliderShape:
        """Shape of a geom in the frame of its body."""
        model, (x, y, z) = self.model, self.model.geom_size[geom].tolist()
        turn, kind = rotation(model.geom_quat[geom][[1, 2, 3, 0]]), model.geom_type[geom]
        place: dict[str, Any] = {"xyz": model.geom_pos[geom], "rpy": angles(turn)}
        if kind == MESH:
            hull = self._hull(geom)
            assert hull is not None
            return shapes.Hull(hull, **place)
        if kind == PLANE:
            return shapes.HalfSpace(**place)
        if kind == SPHERE:
            return shapes.Sphere(x, place["xyz"])
        if kind == BOX:
            return shapes.Box((2.0 * x, 2.0 * y, 2.0 * z), **place)
        if kind != HFIELD:
            return (shapes.Capsule if kind == CAPSULE else shapes.Cylinder)(x, 2.0 * y, **place)
        number = int(model.geom_dataid[geom])
        rows, columns, at = (int(of[number]) for of in (model.hfield_nrow, model.hfield_ncol, model.hfield_adr))
        half, heights = model.hfield_size[number], np.asarray(model.hfield_data[at : at + rows * columns], float)
        # Turned by a quarter, so that the diagonals of the cells are those of MuJoCo: from the smallest x and y.
        place["rpy"] = angles(turn @ QUARTER)
        return shapes.HeightField(half[2] * np.rot90(heights.reshape(rows, columns)), 2.0 * half[[1, 0]], **place)

    def _hull(self, geom: int) -> _Array | None:
        """Vertices of the convex hull of a mesh, (n, 3), in the frame of the geom; None if it has no volume."""
        mesh = int(self.model.geom_dataid[geom])
        if mesh not in self._hulls:
            points = _hull_of_mesh(self.model, mesh)
            self._hulls[mesh] = points if fault(shapes.Hull(points)) is None else None
        return self._hulls[mesh]


def _hull_of_mesh(model: mujoco.MjModel, mesh: int) -> _Array:
    """Vertices of the convex hull of a mesh; all vertices if MuJoCo has not computed the hull."""
    first, count, at = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh], model.mesh_graphadr[mesh]
    vertices = np.asarray(model.mesh_vert[first : first + count], float)
    if at < 0:
        return np.unique(vertices, axis=0)
    # The graph is: number of vertices, number of faces, addresses of the edges, indices of the vertices, ...
    number = model.mesh_graph[at]
    return np.asarray(vertices[model.mesh_graph[at + 2 + number : at + 2 + 2 * number]])


class _Rule(NamedTuple):
    """How this version of MuJoCo combines margins and gaps."""

    adds: bool
    """Whether margins of two geoms are added; older versions take the larger one."""
    less_gap: bool
    """Whether the gap is subtracted."""


@cache
def _margin_rule() -> _Rule:
    import mujoco

    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="plane" size="1 1 1" margin="0.25"/><body><freejoint/>'
        '<geom size="0.1" margin="0.5" gap="0.125"/></body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = float(data.contact[0].includemargin)
    return _Rule(found > 0.55, found in (0.625, 0.375))


def unsupported(collisions: Collisions, names: Names) -> Iterator[tuple[str, str, str]]:
    """Collisions that a scene does not represent: name in `ignore`, what was found, and the consequence."""
    if collisions.other is not None:
        first, second = (names.bodies[collisions.model.geom_bodyid[end]] for end in collisions.other)
        consequence = 'they can pass through each other, because contacts="plane" reads only contacts with fixed planes and each <pair>: use contacts="all"'
        if collisions.contacts is None:
            consequence = 'bodies can pass through each other, because contacts of a file are read only with contacts="all" or contacts="plane"'
        yield "contacts", f"geoms that collide, of {first!r} and {second!r} for instance", consequence
    for geom in sorted(collisions.lost):
        yield "contacts", f"the geom {names.geoms[geom]!r}, {collisions.missing[geom]}", "it touches nothing"
    for geom in collisions.raised():
        yield "contacts", f"the height field {names.geoms[geom]!r} with space below", "it fills the space below, and moves what is there above it"
    for name, condition, found, consequence in PARAMETERS:
        these = [pairs.where(at) for pairs in collisions.read if (at := condition(pairs)).any()]
        if these:
            first, more = Pairs(*(values[0] for values in these[0])), sum(len(pairs.first) for pairs in these) - 1
            contact = f"the contact of {names.geoms[first.first]!r} and {names.geoms[first.second]!r}" + f" (and of {more} more pairs)" * (more > 0)
            yield name, found.format(of=first, contact=contact), consequence
