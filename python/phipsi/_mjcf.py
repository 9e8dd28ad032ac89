"""MuJoCo models from files, text and specifications: compilation, names of elements, and disabled features."""

from __future__ import annotations

import operator
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ._install import command
from .errors import ArgumentError, MeshWarning, SceneError, of_argument, warn

if TYPE_CHECKING:
    import mujoco

#: Types of joints, as MuJoCo numbers them.
FREE, BALL, SLIDE, HINGE = range(4)
#: Values of mjtEq, mjtTrn and mjtObj.
EQUALITY_CONNECT, EQUALITY_WELD, EQUALITY_JOINT = range(3)
TRANSMISSION_JOINT = (0, 1)
OBJECT_BODY = 1
#: The number of degrees of freedom of a joint, by its type.
WIDTHS = {FREE: 6, BALL: 3, SLIDE: 1, HINGE: 1}
#: MuJoCo's default impedance of constraints, the depth at which they have it, m or rad, and their stiffness per inertia, 1/s^2.
IMPEDANCE, DEPTH, STIFFNESS = 0.95, 0.001, 1.0 / (0.95 * 0.02**2)
#: Description of constraints that are soft.
SOFT = "softer or less damped than MuJoCo's default (solref, solimp)"
#: A group of geoms that neither MuJoCo nor phipsi draws.
HIDDEN = 5


def compiled(source: Any, strict: bool = False) -> tuple[mujoco.MjModel, Path | None]:
    """Compiled model of a file, XML, a specification or a model, and the path of the file, if any.

    Missing mesh and texture files give a MeshWarning (SceneError if strict), if no inertia depends on them.
    """
    try:
        import mujoco
    except ImportError:
        text = f"Scene.from_mujoco: found no package mujoco; install it with: {command('mujoco')}"
        raise ImportError(text) from None
    if isinstance(source, mujoco.MjModel):
        return source, None
    if not isinstance(source, str | os.PathLike | mujoco.MjSpec):
        raise ArgumentError(
            f"source: found {type(source).__name__}; expected a path, XML, mujoco.MjModel or mujoco.MjSpec"
        )
    file = None
    if not isinstance(source, mujoco.MjSpec) and not (isinstance(source, str) and source.lstrip().startswith("<")):
        file = Path(source)
        if not file.is_file():
            raise SceneError(
                f"source: found {str(source)[:100]!r}, which is not a file; expected the path of a model, or XML"
            )
    try:
        if file is not None and file.suffix.lower() == ".mjb":
            return mujoco.MjModel.from_binary_path(str(file)), None
        try:
            model = _compile(source, file)
        except ValueError:
            if not hasattr(mujoco.MjSpec, "attach"):
                # Specifications of the first versions do not give access to all elements that are omitted here.
                raise
            specification = _specification(source, file)
            lost = _omit_lost_files(specification, Path(specification.modelfiledir) if file is None else file.parent)
            if not lost:
                raise
            model = specification.compile()
            _report_lost_files(lost, strict)
    except (ValueError, mujoco.FatalError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"source: MuJoCo cannot read it: {' '.join(str(error).split())}") from None
    return model, None if file is None else file.resolve()


def _compile(source: Any, file: Path | None) -> mujoco.MjModel:
    import mujoco

    if file is not None:
        return mujoco.MjModel.from_xml_path(str(file))
    return mujoco.MjModel.from_xml_string(source) if isinstance(source, str) else source.compile()


def _specification(source: Any, file: Path | None) -> mujoco.MjSpec:
    """A specification that can be modified."""
    import mujoco

    if file is not None:
        return mujoco.MjSpec.from_file(str(file))
    return mujoco.MjSpec.from_string(source) if isinstance(source, str) else source.copy()


def _report_lost_files(lost: list[str], strict: bool) -> None:
    more = f" and {len(lost) - 1} more" if len(lost) > 1 else ""
    text = f"source: found no file {lost[0]}{more}; expected the meshes and textures in the folders that the model names"
    if strict:
        raise SceneError(text)
    warn(f"{text}; they are not drawn and touch nothing; no inertia depends on them", MeshWarning)


def _omit_lost_files(specification: mujoco.MjSpec, folder: Path) -> list[str]:
    """Replace elements whose file is missing, and return the files. Raises SceneError if an inertia is computed from a
    missing mesh.
    """
    import mujoco

    has_file = _Files(specification, folder)
    meshes = {mesh.name: mesh for mesh in specification.meshes if not has_file("meshdir", mesh.file)}
    fields = {field.name: field for field in specification.hfields if not has_file("meshdir", field.file)}
    textures = {
        texture.name: texture
        for texture in specification.textures
        if not all(has_file("texturedir", file) for file in (texture.file, *texture.cubefiles))
    }
    skins = [skin for skin in specification.skins if not has_file("meshdir", skin.file)]
    shapeless = set[str]()
    for geom in specification.geoms:
        lost = meshes.get(geom.meshname) or fields.get(geom.hfieldname)
        if lost is None:
            continue
        if _gives_inertia(specification, geom):
            body = geom.parent.name
            raise SceneError(
                f"source: found no file {lost.file!r}, from which the inertia of body {body!r} is computed; "
                "expected the file, or <inertial> in the body"
            )
        geom.type, geom.size, geom.mass, geom.group = mujoco.mjtGeom.mjGEOM_SPHERE, [0.001, 0.0, 0.0], 0.0, HIDDEN
        geom.meshname = geom.hfieldname = ""
        geom.contype = geom.conaffinity = 0
        shapeless.add(geom.name)
    for material in specification.materials:
        material.textures = ["" if name in textures else name for name in material.textures]
    pairs = [pair for pair in specification.pairs if shapeless & {pair.geomname1, pair.geomname2} - {""}]
    for lost in (*meshes.values(), *fields.values(), *textures.values(), *skins, *pairs):
        # In older versions the elements have the method.
        specification.delete(lost) if hasattr(specification, "delete") else lost.delete()
    return [
        repr(lost.file or "of a texture") for lost in (*meshes.values(), *fields.values(), *skins, *textures.values())
    ]


class _Files:
    """Whether the files of a specification exist."""

    def __init__(self, specification: mujoco.MjSpec, folder: Path) -> None:
        self.specification, self.folder = specification, folder

    def __call__(self, directory: str, file: str) -> bool:
        name = Path(file).name if self.specification.strippath else file
        return not file or (self.folder / getattr(self.specification, directory) / name).is_file()


def _gives_inertia(specification: mujoco.MjSpec, geom: Any) -> bool:
    """Whether the inertia of a moving body is computed from a geom."""
    body, compiler = geom.parent, specification.compiler
    first, last = compiler.inertiagrouprange
    from_geoms = int(compiler.inertiafromgeom)
    if (
        geom.mass == 0.0
        or geom.density == 0.0
        or not first <= geom.group <= last
        or from_geoms == 0
        or (from_geoms == 2 and body.explicitinertial)
    ):
        return False
    while body is not None and body.name != "world":
        if body.joints:
            return True
        body = body.parent
    return False


class Names:
    """Names of the elements of a model; elements without a name in the file get a unique one.

    Bodies and sites become links and share one set of names; joints, fixed ones included, have a second set.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._links, self._joints = set[str](), set[str]()
        self.bodies = self._complete(_own(model, model.name_bodyadr), "body", self._links)
        self.joints = self._complete(_own(model, model.name_jntadr), "joint", self._joints)
        self.equalities = self._complete(_own(model, model.name_eqadr), "equality ", set())
        self.geoms = self._complete(_own(model, model.name_geomadr), "geom", set())
        self.keyframes = self._complete(_own(model, model.name_keyadr), "key", set())
        #: Names of sites: a site with the name of a body gets another name; unnamed sites stay unnamed.
        self.sites = [
            name and self.link(name if name not in self._links else f"{name}/site")
            for name in _own(model, model.name_siteadr)
        ]

    @staticmethod
    def _complete(own: list[str], kind: str, taken: set[str]) -> list[str]:
        taken.update(own)
        return [name or _fresh(f"{kind}{at}", taken) for at, name in enumerate(own)]

    def link(self, name: str) -> str:
        """A link name that the file does not contain."""
        return _fresh(name, self._links)

    def joint(self, name: str) -> str:
        """A joint name that the file does not contain."""
        return _fresh(name, self._joints)


def _own(model: mujoco.MjModel, addresses: Any) -> list[str]:
    """Names at these addresses; empty if there is none."""
    names = model.names
    return [names[at : names.index(b"\0", at)].decode("utf-8", "replace") for at in addresses.tolist()]


def _fresh(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def link_name(source: mujoco.MjModel | mujoco.MjSpec | str | os.PathLike[str], body: int) -> str:
    """Name of the link of a body; a body without a name in the file gets one, such as "body3".

    Parameters
    ----------
    source : mujoco.MjModel, mujoco.MjSpec, str or path
        Model, as in Scene.from_mujoco.
    body : int
        Index of the body in MuJoCo; 0 is the world.

    Returns
    -------
    name : str
        Name of the link in the scene.

    Raises
    ------
    ArgumentError
        If the model has no body with this index.

    Examples
    --------
    >>> import mujoco, phipsi.mujoco  # doctest: +SKIP
    >>> phipsi.mujoco.link_name("humanoid.xml", 1)  # doctest: +SKIP
    'torso'
    """
    return _at("body", Names(compiled(source)[0]).bodies, body)


def joint_name(source: mujoco.MjModel | mujoco.MjSpec | str | os.PathLike[str], joint: int) -> str:
    """Name of a joint; a joint without a name in the file gets one, such as "joint3".

    Parameters
    ----------
    source : mujoco.MjModel, mujoco.MjSpec, str or path
        Model, as in Scene.from_mujoco.
    joint : int
        Index of the joint in MuJoCo.

    Returns
    -------
    name : str
        Name of the joint in the scene. For a free joint that is read as three slides and a ball joint, the name of the
        ball joint; the slides are called name + "/x", "/y" and "/z".

    Raises
    ------
    ArgumentError
        If the model has no joint with this index.

    Examples
    --------
    >>> import mujoco, phipsi.mujoco  # doctest: +SKIP
    >>> phipsi.mujoco.joint_name("humanoid.xml", 0)  # doctest: +SKIP
    'root'
    """
    return _at("joint", Names(compiled(source)[0]).joints, joint)


def _at(what: str, names: list[str], index: int) -> str:
    try:
        at = operator.index(index)
    except TypeError:
        at = -1
    if not 0 <= at < len(names):
        raise of_argument(ArgumentError, what, f"found {index!r}; expected an integer from 0 to {len(names) - 1}")
    return names[at]


# Disabled features


def is_disabled(model: mujoco.MjModel, *flags: str) -> bool:
    """Whether all of these features are disabled, each a name of mjtDisableBit without mjDSBL_."""
    import mujoco

    # Older versions have one flag for springs and dampers.
    bits: Any = mujoco.mjtDisableBit
    return all(
        model.opt.disableflags & int(getattr(bits, f"mjDSBL_{flag}", None) or bits.mjDSBL_PASSIVE) for flag in flags
    )


def is_enabled(model: mujoco.MjModel, flag: str) -> bool:
    """Whether an optional feature is enabled, a name of mjtEnableBit without mjENBL_."""
    import mujoco

    return bool(model.opt.enableflags & int(getattr(mujoco.mjtEnableBit, f"mjENBL_{flag}")))


def has_constraints(model: mujoco.MjModel, kind: str) -> bool:
    """Whether constraints of a kind are active: EQUALITY, LIMIT, FRICTIONLOSS or CONTACT."""
    return not is_disabled(model, kind) and not is_disabled(model, "CONSTRAINT")


def has_passive_forces(model: mujoco.MjModel) -> bool:
    """Whether passive forces are active: without springs and dampers MuJoCo applies no fluid forces and no gravity
    compensation.
    """
    return not is_disabled(model, "SPRING", "DAMPER")


def equalities(model: mujoco.MjModel) -> list[int]:
    """Active equality constraints, without those between two bodies that cannot move relative to each other."""
    if not has_constraints(model, "EQUALITY"):
        return []
    return [at for at in range(model.neq) if model.eq_active0[at] and not _is_idle(model, at)]


def _is_idle(model: mujoco.MjModel, at: int) -> bool:
    if model.eq_type[at] not in (EQUALITY_CONNECT, EQUALITY_WELD):
        return False
    first, second = connected(model, at)
    return bool(model.body_weldid[first] == model.body_weldid[second])


def connected(model: mujoco.MjModel, at: int) -> tuple[int, int]:
    """The two bodies of an equality constraint of kind connect or weld."""
    ends = int(model.eq_obj1id[at]), int(model.eq_obj2id[at])
    return ends if ties_bodies(model, at) else (int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]]))


def ties_bodies(model: mujoco.MjModel, at: int) -> bool:
    """Whether an equality constraint refers to bodies; otherwise it refers to sites, which the first versions do not
    support.
    """
    types = field(model, "eq_objtype")
    return types is None or bool(types[at] == OBJECT_BODY)


def is_soft(solref: Any, solimp: Any) -> Any:
    """Whether constraints are softer, or bounce more, than with MuJoCo's default parameters, for parameters (..., 2) and
    (..., 5).
    """
    least, most = (np.clip(solimp[..., at], 1e-4, 0.9999) for at in (0, 1))
    width, middle, power = np.maximum(solimp[..., 2], 1e-15), np.clip(solimp[..., 3], 1e-4, 0.9999), np.maximum(solimp[..., 4], 1.0)
    x = np.minimum(DEPTH / width, 1.0)
    rise = np.where(x <= middle, middle * (x / middle) ** power, 1.0 - (1.0 - middle) * ((1.0 - x) / (1.0 - middle)) ** power)
    impedance, first, second = least + rise * (most - least), solref[..., 0], solref[..., 1]
    is_time = first > 0.0
    stiffness = np.where(is_time, 1.0 / (np.where(is_time, first, 1.0) * np.maximum(second, 1e-6)) ** 2, -first) / most
    ratio = 0.5 * np.where(is_time, 2.0 / np.where(is_time, first, 1.0), -second) / np.sqrt(np.maximum(stiffness, 1e-12))
    # MuJoCo replaces parameters of different signs by the default ones.
    is_default = is_time != (second > 0.0)
    return (impedance < 0.99 * IMPEDANCE) | (~is_default & ((stiffness < 0.9 * STIFFNESS) | (ratio < 0.99 * np.sqrt(IMPEDANCE))))


def along_world(model: mujoco.MjModel, joint: int) -> dict[str, str]:
    """Properties of a free joint that MuJoCo applies along the axes of the world: names for the argument `ignore`, and
    their description.
    """
    dofs = slice(model.jnt_dofadr[joint], model.jnt_dofadr[joint] + WIDTHS[FREE])
    acting = {
        "armature": ("armature", model.dof_armature[dofs], True),
        "friction": ("friction", model.dof_frictionloss[dofs], has_constraints(model, "FRICTIONLOSS")),
        "nonlinear": ("stiffness", model.jnt_stiffness[joint : joint + 1], not is_disabled(model, "SPRING")),
    }
    return {name: f"{what} {values.max():g}" for name, (what, values, acts) in acting.items() if acts and np.any(values)}


def stops(model: mujoco.MjModel) -> tuple[Any, Any]:
    """Positions of the joint stops, (njnt,) each: limits reduced by the margin."""
    return model.jnt_range[:, 0] + model.jnt_margin, model.jnt_range[:, 1] - model.jnt_margin


def joint_actuators(model: mujoco.MjModel) -> Iterator[tuple[int, int, float]]:
    """Actuators of hinges and slides: their index, the joint and the gear ratio."""
    outputs = getattr(model, "actuator_outadr", range(model.nu))
    for at, kind in enumerate(model.actuator_trntype.tolist()):
        joint = int(model.actuator_trnid[at, 0])
        if kind in TRANSMISSION_JOINT and model.jnt_type[joint] in (HINGE, SLIDE):
            yield at, joint, float(model.actuator_gear[outputs[at], 0])


def field(model: mujoco.MjModel, name: str) -> Any:
    """A field of the model; None if this version of MuJoCo does not have it."""
    return getattr(model, name, None)
