"""Colliders of a MuJoCo model: the shapes of its geoms, the pairs of geoms that can touch, and their parameters."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import shapes
from ._colliders import fault
from ._coordinates import rotation
from ._mjcf import Names, has_constraints, is_disabled, is_enabled, is_soft
from ._pose import angles

if TYPE_CHECKING:
    import mujoco

    from ._core import SceneBuilder

_Array = NDArray[np.float64]

#: Values of mjtGeom.
PLANE, HFIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH, SDF = range(9)
#: Geoms that have no shape here, whether they move or not.
WITHOUT_SHAPE = {ELLIPSOID: "an ellipsoid", SDF: "a signed distance field"}
#: Geoms that have a shape if no joint moves them.
GROUND = {PLANE: "a plane on a body that moves", HFIELD: "a height field on a body that moves"}
#: Number of groups of colliders.
GROUPS = 32


class Pairs(NamedTuple):
    """Pairs of geoms that can collide, and the parameters of their contacts."""

    first: Any
    """Index of a geom of each pair, (n,)."""
    second: Any
    condim: Any
    friction: _Array
    """Sliding friction in both directions, (n, 2)."""
    solref: _Array
    solimp: _Array
    margin: _Array
    """Distance at which the contact begins to act, m, (n,)."""

    def where(self, condition: Any) -> Pairs:
        """Those that satisfy a condition, (n,)."""
        return Pairs(*(values[condition] for values in self))

    @property
    def sliding(self) -> _Array:
        """Coefficient of friction of each pair, (n,)."""
        return np.where(self.condim > 1, self.friction[:, 0], 0.0)


class Collisions:
    """The geoms of a model that can collide, the pairs that MuJoCo's filters leave, and those that a scene represents:
    with contacts="all" all pairs of geoms that have a shape, with "plane" those with a fixed plane and each <pair>.
    """

    def __init__(self, model: mujoco.MjModel, contacts: str | None) -> None:
        self.model, self.contacts = model, contacts
        self.welded = model.body_weldid[model.geom_bodyid]
        moves = np.zeros(model.nbody, bool)
        for body in range(1, model.nbody):
            moves[body] = model.body_jntnum[body] or moves[model.body_parentid[body]]
        self.is_moved = moves[model.geom_bodyid]
        self.contype, self.conaffinity = (bits.astype(np.int64) & 0xFFFFFFFF for bits in (model.geom_contype, model.geom_conaffinity))
        self._hulls: dict[int, _Array | None] = {}

    @cached_property
    def geoms(self) -> Any:
        """Indices of geoms that can collide by their bits or by a <pair>."""
        model = self.model
        if not has_constraints(model, "CONTACT"):
            return np.empty(0, int)
        collide = (self.contype | self.conaffinity) != 0
        collide[model.pair_geom1[: model.npair]] = collide[model.pair_geom2[: model.npair]] = True
        return np.flatnonzero(collide)

    @cached_property
    def missing(self) -> dict[int, str]:
        """Geoms that can collide and have no shape here, and what they are."""
        found = {}
        for geom in self.geoms.tolist() if self.contacts else ():
            kind, moves = int(self.model.geom_type[geom]), self.is_moved[geom]
            if kind in WITHOUT_SHAPE or (kind in GROUND and moves):
                found[geom] = WITHOUT_SHAPE.get(kind) or GROUND[kind]
            elif kind == MESH and self._hull(geom) is None:
                found[geom] = "a mesh whose vertices have no convex hull with a volume"
        return found

    @cached_property
    def _has_shape(self) -> Any:
        has = np.zeros(self.model.ngeom, bool)
        has[self.geoms] = True
        has[list(self.missing)] = False
        return has

    @cached_property
    def _is_plane(self) -> Any:
        return (self.model.geom_type == PLANE) & ~self.is_moved

    def all(self) -> Iterator[tuple[Pairs, Any]]:
        """Pairs that can collide, those of <pair> first, and which of them the scene represents, (n,)."""
        if not len(self.geoms):
            return
        explicit = self._explicit()
        keys = self._key(explicit.first, explicit.second)
        explicit = explicit.where(self.is_moved[explicit.first] | self.is_moved[explicit.second])
        explicit = explicit.where(self.welded[explicit.first] != self.welded[explicit.second])
        yield explicit, self._are_shapes(explicit)
        for one, others in self._filtered():
            pairs = self._combined(one, others[~np.isin(self._key(one, others), keys)])
            planes = self._is_plane[pairs.first] | self._is_plane[pairs.second]
            yield pairs, self._are_shapes(pairs) & (planes | (self.contacts == "all"))

    def _are_shapes(self, pairs: Pairs) -> Any:
        return self._has_shape[pairs.first] & self._has_shape[pairs.second] & (self.contacts is not None)

    def _key(self, one: Any, other: Any) -> Any:
        return np.minimum(one, other) * np.int64(self.model.ngeom) + np.maximum(one, other)

    def _explicit(self) -> Pairs:
        """Those of <pair>."""
        model, rule = self.model, _margin_rule()
        margin = model.pair_margin - (model.pair_gap if rule.less_gap else 0.0)
        if is_enabled(model, "OVERRIDE"):
            margin = np.full(model.npair, model.opt.o_margin) - (model.pair_gap if rule.less_gap else 0.0)
        pairs = Pairs(model.pair_geom1, model.pair_geom2, model.pair_dim, model.pair_friction[:, :2], model.pair_solref, model.pair_solimp, margin)
        return self._overridden(pairs)

    def _combined(self, one: int, others: Any) -> Pairs:
        """Parameters of the contacts of a geom with others: those of the geom with the higher priority; otherwise the larger
        friction and condim, and the mean of solref and solimp.
        """
        model, rule, count = self.model, _margin_rule(), len(others)
        ends = np.stack([np.full(count, one), others])
        margins = model.geom_margin[ends]
        margin = margins.sum(axis=0) if rule.adds else margins.max(axis=0)
        if is_enabled(model, "OVERRIDE"):
            margin = np.full(count, model.opt.o_margin)
        if rule.less_gap:
            margin = margin - model.geom_gap[ends].max(axis=0)
        priority, mix = model.geom_priority[ends], model.geom_solmix[ends]
        equal, total = priority[0] == priority[1], mix.sum(axis=0)
        # Where the priorities differ, one geom has the whole weight.
        shares = np.divide(mix[0], total, out=np.full(count, 0.5), where=total > 0.0)
        weight = np.where(equal, shares, priority[0] > priority[1])[:, None]
        of_first = weight[:, 0] == 1.0
        condim, friction, solref, solimp = model.geom_condim[ends], model.geom_friction[ends][..., [0, 0]], model.geom_solref[ends], model.geom_solimp[ends]
        mean = weight * solref[0] + (1.0 - weight) * solref[1]
        is_direct = equal & (solref[:, :, 0] <= 0.0).any(axis=0)
        pairs = Pairs(
            ends[0],
            others,
            np.where(equal, condim.max(axis=0), np.where(of_first, *condim)),
            np.where(equal[:, None], friction.max(axis=0), np.where(of_first[:, None], *friction)),
            np.where(is_direct[:, None], solref.min(axis=0), mean),
            weight * solimp[0] + (1.0 - weight) * solimp[1],
            margin,
        )
        return self._overridden(pairs)

    def _overridden(self, pairs: Pairs) -> Pairs:
        """With the friction and the softness of the flag `override`, if it is enabled."""
        option = self.model.opt
        if not is_enabled(self.model, "OVERRIDE"):
            return pairs
        friction, solref, solimp = (np.broadcast_to(values, (len(pairs.first), len(values))) for values in (option.o_friction[:2], option.o_solref, option.o_solimp))
        return pairs._replace(friction=friction, solref=solref, solimp=solimp)

    def _filtered(self) -> Iterator[tuple[int, Any]]:
        """Each geom, and those after it with which it can collide."""
        model, rigid, bodies = self.model, self.welded, self.model.geom_bodyid
        above = model.body_weldid[model.body_parentid[rigid]]
        filters_parents, excluded = not is_disabled(model, "FILTERPARENT"), model.exclude_signature
        geoms = np.flatnonzero(self.contype | self.conaffinity)
        for at, one in enumerate(geoms.tolist()):
            other = geoms[at + 1 :]
            may = self._bits(one, other) & (rigid[other] != rigid[one]) & (self.is_moved[other] | self.is_moved[one])
            if filters_parents:
                # A body does not collide with its parent, unless that is fixed to the world.
                may &= ~(((above[other] == rigid[one]) | (above[one] == rigid[other])) & (rigid[one] != 0) & (rigid[other] != 0))
            ends = np.sort(np.stack([np.full(len(other), bodies[one]), bodies[other]]), axis=0)
            may &= ~np.isin((ends[0] << 16) + ends[1], excluded)
            yield one, other[may]

    def _bits(self, one: Any, other: Any) -> Any:
        return ((self.contype[one] & self.conaffinity[other]) | (self.contype[other] & self.conaffinity[one])) != 0

    # Into a scene

    def add(self, builder: SceneBuilder, names: Names) -> None:
        """Add the colliders and their rules to a builder."""
        model, read = self.model, [pairs.where(of) for pairs, of in self.all()]
        geoms = self.geoms if self.contacts == "all" else np.unique(np.concatenate([ends for of in read for ends in of[:2]] or [self.geoms]))
        geoms = geoms[self._has_shape[geoms]]
        # The larger condim counts, which has friction.
        own = np.where(model.geom_condim > 1, model.geom_friction[:, 0], 0.0)
        groups, masks = self._groups(geoms)
        for geom in geoms.tolist():
            rules = {"friction": own[geom], "groups": int(groups[geom]), "mask": int(masks[geom])}
            builder.collider(names.geoms[geom], self._shape(geom), link=names.bodies[model.geom_bodyid[geom]], **rules)
        for at, of in enumerate(read):
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
            return self.contype, self.conaffinity
        planes = geoms[self._is_plane[geoms]]
        groups, masks = np.zeros((2, self.model.ngeom), np.int64)
        _, kinds, of = np.unique(np.stack([self.contype[planes], self.conaffinity[planes]]), axis=1, return_index=True, return_inverse=True)
        for at, kind in enumerate(kinds[:GROUPS]):
            groups[planes[of.ravel() == at]] = 1 << at
            masks |= np.where(self._bits(planes[kind], np.arange(self.model.ngeom)) & ~self._is_plane, 1 << at, 0)
        return groups, masks

    def _apart(self, used: set[int]) -> set[tuple[int, int]]:
        """Pairs of bodies with colliders that do not touch: each <exclude>, and child and parent where the child has several
        joints, between which the scene has links.
        """
        model = self.model
        apart = {(int(signature) >> 16, int(signature) & 0xFFFF) for signature in model.exclude_signature}
        if not is_disabled(model, "FILTERPARENT"):
            rigid = dict[int, list[int]]()
            for body in used:
                rigid.setdefault(int(model.body_weldid[body]), []).append(body)
            for root, bodies in rigid.items():
                above = int(model.body_weldid[model.body_parentid[root]])
                if model.body_jntnum[root] > 1 and above != 0:
                    apart |= {(min(ends), max(ends)) for ends in ((one, other) for one in bodies for other in rigid.get(above, ()))}
        return {ends for ends in apart if used.issuperset(ends)}

    def _shape(self, geom: int) -> shapes.ColliderShape:
        """Shape of a geom in the frame of its body."""
        model, (x, y, z) = self.model, self.model.geom_size[geom].tolist()
        turn, kind = rotation(model.geom_quat[geom][[1, 2, 3, 0]]), model.geom_type[geom]
        if kind == MESH:
            hull = self._hull(geom)
            assert hull is not None
            return shapes.Hull(model.geom_pos[geom] + hull @ turn.T)
        place: dict[str, Any] = {"xyz": model.geom_pos[geom], "rpy": angles(turn)}
        if kind == PLANE:
            return shapes.HalfSpace(**place)
        if kind == SPHERE:
            return shapes.Sphere(x, place["xyz"])
        if kind == BOX:
            return shapes.Box((2.0 * x, 2.0 * y, 2.0 * z), **place)
        if kind != HFIELD:
            return (shapes.Capsule if kind == CAPSULE else shapes.Cylinder)(x, 2.0 * y, **place)
        field = int(model.geom_dataid[geom])
        rows, columns, at = (int(of[field]) for of in (model.hfield_nrow, model.hfield_ncol, model.hfield_adr))
        half, heights = model.hfield_size[field], np.asarray(model.hfield_data[at : at + rows * columns], float)
        return shapes.HeightField(half[2] * heights.reshape(rows, columns), 2.0 * half[:2], **place)

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


def unsupported(model: mujoco.MjModel, names: Names, contacts: str | None) -> Iterator[tuple[str, str, str]]:
    """Collisions that a scene does not represent: name in `ignore`, what was found, and the consequence."""
    collisions = Collisions(model, contacts)
    lost, other, condims, frictions, gaps, soft = set[int](), *(_Example() for _ in range(5))
    for pairs, read in collisions.all():
        shapeless = [end for ends in (pairs.first, pairs.second) for end in np.unique(ends).tolist() if end in collisions.missing]
        lost.update(shapeless if contacts else ())
        passing = pairs.where(~read)
        other.add(passing.where(~np.isin([passing.first, passing.second], [*lost]).any(axis=0)))
        if contacts is None and other.count:
            break
        kept = pairs.where(read)
        condims.add(kept.where(kept.condim > 3))
        frictions.add(kept.where((kept.condim > 1) & (kept.friction[:, 0] != kept.friction[:, 1])))
        gaps.add(kept.where(kept.margin < 0.0))
        soft.add(kept.where(is_soft(kept.solref, kept.solimp)))
    if other.first is not None:
        first, second = (names.bodies[model.geom_bodyid[end]] for end in (other.first.first[0], other.first.second[0]))
        consequence = 'bodies can pass through each other, because contacts of a file are read only with contacts="all" or contacts="plane"'
        if contacts is not None:
            consequence = 'they can pass through each other, because contacts="plane" reads only contacts with fixed planes and each <pair>: use contacts="all"'
        yield "contacts", f"geoms that collide, of {first!r} and {second!r} for instance", consequence
    for geom in sorted(lost):
        yield "contacts", f"the geom {names.geoms[geom]!r}, {collisions.missing[geom]}", "it touches nothing"
    if condims.first is not None:
        yield "contacts", f"condim {condims.first.condim[0]} of {condims.text(names)}", "torsional and rolling friction are not read"
    if frictions.first is not None:
        one, two = frictions.first.friction[0].tolist()
        yield "contacts", f"friction {one:g} and {two:g} of {frictions.text(names)}", "the first is used in both directions"
    if gaps.first is not None:
        yield "contacts", f"a gap that exceeds the margin by {-gaps.first.margin[0]:g} m, of {gaps.text(names)}", "contacts act from a distance of zero"
    if soft.first is not None:
        yield "softness", f"{soft.text(names)}, which is softer than MuJoCo's default (solref, solimp)", "contacts are rigid"


class _Example:
    """The first of some pairs, and their number."""

    def __init__(self) -> None:
        self.first: Pairs | None = None
        self.count = 0

    def add(self, pairs: Pairs) -> None:
        self.count += len(pairs.first)
        if self.first is None and len(pairs.first):
            self.first = pairs

    def text(self, names: Names) -> str:
        assert self.first is not None
        one, two = (names.geoms[int(ends[0])] for ends in self.first[:2])
        more = f" (and of {self.count - 1} more pairs)" if self.count > 1 else ""
        return f"the contact of {one!r} and {two!r}{more}"
