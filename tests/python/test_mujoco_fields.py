"""Each field of MjModel that changes accelerations, without contacts and actuation, is supported or refused by name."""

from __future__ import annotations

import copy
import warnings
from collections import defaultdict
from collections.abc import Iterator

import mujoco
import numpy as np
import pytest
from tolerances import EPS, assert_near, inverse, product, size

import phipsi
import phipsi.mujoco
from phipsi.errors import ModelWarning, SceneError

INERTIAL = '<inertial pos=".1 .2 .3" euler=".1 .2 .3" mass="2" diaginertia=".8 .9 1"/>'
MODEL = """<mujoco><compiler angle="radian"/>
<option gravity="0.3 -0.2 -9.7"><flag contact="disable" actuation="disable"/></option>
<worldbody>
 <site name="base" pos="0.1 0.2 0.3" euler=".1 .2 .3"/>
 <body name="trunk" pos="1 2 3" euler=".3 .2 .1"><joint name="free" type="free" damping=".3"/>{inertial}
  <site name="on_trunk" pos=".1 .2 .1" euler=".1 .2 .3"/>
  <body name="leg" pos="0.2 0 0" euler=".3 .1 .2">{inertial}
   <joint name="ball" type="ball" pos="0.01 0.02 0.03" armature="0.02" damping="0.1" stiffness="2" frictionloss="0.1"/>
   <body name="foot" pos="0 .1 -.3" euler=".2 .1 .1">{inertial}
    <joint name="knee" axis="0 1 0.2" pos=".01 .02 .03" ref="0.3" stiffness="4" springref="0.7" damping=".2" armature=".1" frictionloss=".3"
     limited="true" range="-.2 .2" margin=".01"/>
    <joint name="slide" type="slide" axis="1 .1 0" ref="0.1" stiffness="5" springref="0.2" damping=".2" armature=".1" frictionloss=".2"
     limited="true" range="-.2 .2"/>
   </body></body></body>
 <body name="arm" pos="0 1 0" euler=".1 .2 .3"><joint name="shoulder" axis="0 1 0" actuatorfrclimited="true" actuatorfrcrange="-3 3"/>{inertial}
  <site name="on_arm" pos=".1 .2 .1" euler=".2 .2 .3"/>
  <body name="tool" pos=".1 .2 .3" euler=".1 .2 .3"><joint name="elbow" axis="1 1 0"/>{inertial}
   <site name="on_tool" pos=".1 .2 .1" euler=".3 .2 .3"/><geom type="ellipsoid" size=".1 .2 .3" pos=".1 .1 .1"/></body></body>
 <body name="marker" mocap="true" pos="0.5 0.4 0.3"><geom size="0.1"/></body>
</worldbody>
<actuator><motor joint="shoulder" gear="2" armature=".3" damping=".2"/><pid joint="elbow" kp="3" armature=".1"/></actuator>
</mujoco>""".format(inertial=INERTIAL)


def with_(element: str) -> str:
    return MODEL.replace("</mujoco>", f"{element}</mujoco>")


MODELS = {
    "tree": MODEL,
    "connect": with_(
        '<equality><connect body1="tool" body2="leg" anchor=".1 .2 .3"/><joint joint1="elbow" joint2="knee" polycoef=".1 .5 .2 -.1 .3"/></equality>'
    ),
    "weld": with_(
        '<equality><weld body1="tool" body2="leg" relpose=".1 .2 .3 .5 .5 .5 .5" anchor=".1 .1 0"/></equality>'
    ),
    "sites": with_(
        '<equality><connect site1="on_arm" site2="on_trunk"/><weld site1="on_tool" site2="base"/></equality>'
    ),
}
#: Parameters of soft constraints and of MuJoCo's solver: constraints of a scene are rigid, see
#: docs/how-to/read-a-robot.md.
SOFTNESS = {
    "solref",
    "solimp",
    "invweight0",
    "opt.timestep",
    "opt.tolerance",
    "opt.iterations",
    "opt.impratio",
    "opt.noslip_iterations",
}
SOFTNESS |= {"mjENBL_DIAGEXACT", "mjDSBL_REFSAFE", "mjDSBL_WARMSTART", "mjDSBL_ISLAND", "mjENBL_SLEEP", "torquescale"}


def state(model: mujoco.MjModel) -> mujoco.MjData:
    """A moving state beyond the limits of all joints."""
    draw, data = np.random.default_rng(3), mujoco.MjData(model)
    step = draw.standard_normal(model.nv)
    mujoco.mj_integratePos(model, data.qpos, step, 1.0)
    data.qvel = draw.standard_normal(model.nv)
    mujoco.mj_forward(model, data)
    return data


class Seen:
    """MuJoCo's results in a state, for quantities that a scene has."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        kinds = mujoco.mjtConstraint
        self.qacc, self.smooth = data.qacc.copy(), data.qacc_smooth.copy()
        self.friction = np.zeros(model.nv)
        self.stops: dict[int, float] = {}
        rows: dict[int, list[float]] = defaultdict(list)
        for kind, at, position, margin, friction in zip(
            data.efc_type, data.efc_id, data.efc_pos, data.efc_margin, data.efc_frictionloss, strict=True
        ):
            if kind == kinds.mjCNSTR_FRICTION_DOF:
                self.friction[at] = friction
            elif kind == kinds.mjCNSTR_LIMIT_JOINT:
                self.stops[int(at)] = float(position - margin)
            elif kind == kinds.mjCNSTR_EQUALITY:
                rows[int(at)].append(float(position))
        # Norms, because frames differ: the number of constraints, the distance and, for a weld, the sine of half the
        # angle.
        self.errors = {
            at: (
                len(values),
                float(np.linalg.norm(values[:3])),
                float(np.linalg.norm(values[3:])) / (model.eq_data[at, 10] or 1.0),
            )
            for at, values in rows.items()
        }

    def numbers(self) -> list[float]:
        """All except the accelerations with constraints."""
        return [*self.smooth, *self.friction, *self.stops.values(), *(x for each in self.errors.values() for x in each)]


def follows(model: mujoco.MjModel, seen: Seen, data: mujoco.MjData) -> None:
    """Assert that the scene of a model has the accelerations, friction, stops and connections of MuJoCo."""
    scene = phipsi.Scene.from_mujoco(model)
    q, qd = phipsi.mujoco.to_state(scene, data.qpos, data.qvel)
    tau = scene.stiffness * scene.difference(q, scene.rest) - scene.damping * qd
    free = scene.without_constraints()
    mass = free.mass_matrix(q)
    expected = phipsi.mujoco.to_accelerations(scene, q, qd, seen.smooth)
    assert_near(free.forward_dynamics(q, qd, tau), expected, inverse(float(np.linalg.cond(mass)), size(expected)))
    assert_near(scene.friction, seen.friction, product(1, size(seen.friction)))
    for name, at in zip(scene.joint_names, range(model.njnt), strict=True):
        joint = scene.joints[name]
        if np.isfinite(joint.lower):
            value = float(q[scene.q_index(name)][0])
            beyond = min(value - joint.lower, joint.upper - value)
            assert_near(beyond if beyond < 0.0 else 0.0, seen.stops.get(at, 0.0), product(1, size(value)))
        else:
            assert at not in seen.stops
    error, first = scene.loops.error(q), 0
    for rows, distance, half_sine in seen.errors.values():
        own = error[first : first + rows]
        assert_near(np.linalg.norm(own[-3:]), distance, product(16, size(distance)))
        assert_near(np.linalg.norm(own[:-3]), 2.0 * half_sine, product(16, 2.0))
        first += rows
    assert first == len(error)


def changed(text: str) -> Iterator[tuple[str, mujoco.MjModel]]:
    """The model with each floating-point and boolean entry of its fields changed, and each flag."""
    base = mujoco.MjModel.from_xml_string(text)
    for owner in ("", "opt."):
        for name in dir(base.opt if owner else base):
            values = getattr(base.opt if owner else base, name)
            if (
                name.startswith("_")
                or (isinstance(values, float) and not owner)
                or not isinstance(values, np.ndarray | float)
            ):
                continue
            if isinstance(values, np.ndarray) and (values.dtype.kind not in "fb" or not values.flags.writeable):
                continue
            for at in np.ndindex(np.shape(values)):
                model = copy.copy(base)
                of = model.opt if owner else model
                if isinstance(values, float):
                    setattr(of, name, values + 0.13)
                else:
                    entries = getattr(of, name)
                    entries[at] = not entries[at] if values.dtype.kind == "b" else entries[at] + 0.13
                    if name.endswith("quat") or name == "jnt_axis":
                        entries[at[0]] /= np.linalg.norm(entries[at[0]])
                    if name == "eq_data" and at[1] in range(6, 10):
                        entries[at[0], 6:10] /= np.linalg.norm(entries[at[0], 6:10])
                yield "torquescale" if name == "eq_data" and at[1] == 10 else f"{owner}{name}", model
    for flags, kind, prefix in (
        ("disableflags", mujoco.mjtDisableBit, "mjDSBL_"),
        ("enableflags", mujoco.mjtEnableBit, "mjENBL_"),
    ):
        # The first two are for other states of the scene; the third needs a separate integrator.
        for name in {name for name in dir(kind) if name.startswith(prefix)} - {
            "mjDSBL_CONTACT",
            "mjDSBL_ACTUATION",
            "mjENBL_IPC",
        }:
            model = copy.copy(base)
            setattr(model.opt, flags, getattr(model.opt, flags) ^ int(getattr(kind, name)))
            yield name, model


@pytest.mark.parametrize("kind", MODELS)
def test_every_field_is_followed_or_refused(kind: str) -> None:
    base = mujoco.MjModel.from_xml_string(MODELS[kind])
    data = state(base)
    there = Seen(base, data)
    follows(base, there, data)
    found: dict[str, set[str]] = defaultdict(set)
    for name, model in changed(MODELS[kind]):
        data = state(model)
        seen = Seen(model, data)
        if not np.all(np.isfinite(seen.qacc)) or np.max(np.abs(seen.qacc - there.qacc)) <= 1e6 * EPS * size(there.qacc):
            continue
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                follows(model, seen, data)
        except (SceneError, ModelWarning) as refusal:
            assert str(refusal).startswith(("source: found ", 'joint "'))
            found["refused"].add(name)
        except AssertionError as error:
            raise AssertionError(f"{name} is not followed: {error}") from error
        else:
            is_soft = len(seen.numbers()) == len(there.numbers()) and np.allclose(
                seen.numbers(), there.numbers(), rtol=1e-12, atol=1e-12
            )
            found["soft" if is_soft else "followed"].add(name)
    unknown = {
        name for name in found["soft"] if name not in SOFTNESS and not any(name.endswith(end) for end in SOFTNESS)
    }
    assert not unknown, f"changes accelerations, and nothing in the scene: {unknown}"
    # The loop covers the expected fields.
    assert found["followed"] >= {
        "body_mass",
        "body_ipos",
        "body_iquat",
        "dof_damping",
        "jnt_axis",
        "jnt_pos",
        "jnt_stiffness",
        "qpos_spring",
        "opt.gravity",
    }
    assert found["refused"] >= {
        "dof_armature",
        "dof_frictionloss",
        "dof_dampingpoly",
        "jnt_stiffnesspoly",
        "opt.density",
        "opt.viscosity",
    }
    if kind == "tree":
        assert found["followed"] >= {
            "actuator_armature",
            "actuator_damping",
            "actuator_gear",
            "jnt_range",
            "jnt_margin",
        }


TOUCHING = """<mujoco><option cone="elliptic" o_margin="0.01">{flag}</option>
<default><geom margin="0.01" gap="0.004" friction="0.4 0.1 0.1"/></default><worldbody>
 <geom name="floor" type="plane" size="1 1 1" pos="0.1 -0.2 0.3" euler="10 -20 0" friction="0.2 0.1 0.1"/>
 <body name="ball" pos="0.1 -0.2 0.398"><freejoint/><geom name="ball" size="0.1" mass="1" solmix="2"/></body>
 <body name="block" pos="0.1 -0.2 0.59"><joint/><joint type="slide"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.2 0.25"/>
  <geom name="block" type="box" size="0.1 0.2 0.095" friction="0.3 0.1 0.1"/></body>
</worldbody><contact><pair geom1="ball" geom2="block" friction="0.4 0.4 0 0 0" margin="0.02"/></contact></mujoco>"""


def motion(model: mujoco.MjModel) -> np.ndarray:
    """Accelerations of MuJoCo in a moving state with contacts."""
    data = mujoco.MjData(model)
    data.qvel = np.random.default_rng(3).standard_normal(model.nv)
    mujoco.mj_forward(model, data)
    return np.array(data.qacc)


def parts(model: mujoco.MjModel) -> str:
    """All that a scene knows about contacts, and its gravity."""
    scene = phipsi.load(model, contacts="all")
    return repr((scene._collisions(), scene._touching(), scene.gravity.tolist()))


@pytest.mark.parametrize("flag", ["", '<flag override="enable"/>'])
def test_every_field_of_contacts_is_followed_or_refused(flag: str) -> None:
    base = mujoco.MjModel.from_xml_string(text := TOUCHING.format(flag=flag))
    there, own = motion(base), parts(base)
    found: dict[str, set[str]] = defaultdict(set)
    for name, model in changed(text):
        if not name.startswith(("geom_", "pair_", "opt.", "mj")):
            continue
        qacc = motion(model)
        if not np.all(np.isfinite(qacc)) or np.max(np.abs(qacc - there)) <= 1e6 * EPS * size(there):
            continue
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                warnings.simplefilter("error", ModelWarning)
                found["soft" if parts(model) == own else "followed"].add(name)
        except (SceneError, ModelWarning):
            found["refused"].add(name)
    unknown = {name for name in found["soft"] if not any(name.endswith(end) for end in (*SOFTNESS, "solmix"))}
    assert not unknown, f"changes accelerations, and nothing in the scene: {unknown}"
    assert found["followed"] >= {"geom_size", "geom_pos", "geom_quat"} | ({"opt.o_margin"} if flag else {"geom_margin", "geom_friction", "pair_margin"})
    # Of friction of a <pair> and of `override`, one direction changes.
    assert ("opt.o_friction" if flag else "pair_friction") in found["refused"]


def joint(name: str, attributes: str) -> str:
    return MODEL.replace(f'<joint name="{name}"', f'<joint {attributes} name="{name}"')


TENDON = '<tendon><spatial name="rope" {}><site site="on_arm"/><site site="on_trunk"/></spatial></tendon>'
#: Parts that act only if the compiler knows them: the name for `ignore`, whether it only warns, and the model.
PARTS = {
    "gravcomp": ("gravcomp", False, MODEL.replace('<body name="tool"', '<body name="tool" gravcomp="1"')),
    "water": ("fluid", False, with_('<option density="1000"/>')),
    "wind": ("fluid", False, with_('<option density="1.2" wind="5 0 0"/>')),
    "air": ("fluid", True, with_('<option density="1.225" viscosity="1.8e-5"/>')),
    "weld to a mocap body": ("mocap", False, with_('<equality><weld body1="marker" body2="tool"/></equality>')),
    "on a mocap body": (
        "mocap",
        False,
        MODEL.replace('<geom size="0.1"/>', '<geom size="0.1"/><body><joint/><geom size=".1"/></body>'),
    ),
    "stiff tendon": ("tendons", False, with_(TENDON.format('stiffness="3"'))),
    "damped tendon": ("tendons", False, with_(TENDON.format('damping="3"'))),
    "dry tendon": ("tendons", False, with_(TENDON.format('frictionloss="3"'))),
    "heavy tendon": ("tendons", False, with_(TENDON.format('armature="3"'))),
    "limited tendon": ("tendons", True, with_(TENDON.format('limited="true" range="0 0.1"'))),
    "limited ball": ("limits", True, joint("ball", 'limited="true" range="0 0.5"')),
    "armature of a free joint": ("armature", True, joint("free", 'armature=".5"')),
    "friction of a free joint": ("friction", True, joint("free", 'frictionloss=".5"')),
    "stiffness of a free joint": ("nonlinear", True, joint("free", 'stiffness=".5"')),
    "actuator of a tendon": (
        "actuators",
        False,
        with_(TENDON.format("") + '<actuator><motor tendon="rope" armature=".1"/></actuator>'),
    ),
    "equality of tendons": (
        "equality",
        False,
        with_(TENDON.format("") + '<equality><tendon tendon1="rope"/></equality>'),
    ),
    "soft equality": (
        "softness",
        True,
        with_('<equality><connect body1="tool" body2="leg" anchor=".1 .2 .3" solref="-100 -1"/></equality>'),
    ),
    "contacts": ("contacts", True, MODEL.replace('contact="disable" ', "")),
    "sleeping body": ("contacts", True, MODEL.replace("<flag ", '<flag sleep="enable" ').replace('name="trunk"', 'name="trunk" sleep="init"')),
    "soft limits": ("softness", True, joint("elbow", 'limited="true" range="-1 1" solreflimit="0.1 1"')),
    "limits of a small impedance": ("softness", True, joint("elbow", 'limited="true" range="-1 1" solimplimit="0 0.8 0.03"')),
    "limits that bounce": ("softness", True, joint("elbow", 'limited="true" range="-1 1" solreflimit="-10000 -1"')),
    "soft friction": ("softness", True, joint("knee", 'solreffriction="0.5 1"')),
}


@pytest.mark.parametrize("part", PARTS)
def test_parts_that_scenes_do_not_have(part: str) -> None:
    """Refused or warned about by name; read without a warning if ignored; refused if strict."""
    name, warns, text = PARTS[part]
    if warns:
        with pytest.warns(ModelWarning, match=rf"ignore=\('{name}',\)"):
            phipsi.load(text)
        with pytest.raises(SceneError, match=rf"ignore=\('{name}',\)"):
            phipsi.load(text, strict=True)
    else:
        with pytest.raises(SceneError, match=rf"ignore=\('{name}',\)"):
            phipsi.load(text)
    assert phipsi.load(text, ignore=[name]).nv >= phipsi.load(MODEL).nv
    assert phipsi.load(text, ignore=[name], strict=True).nv >= phipsi.load(MODEL).nv


def test_a_message_names_all_that_is_to_be_ignored() -> None:
    text = PARTS["wind"][2].replace('<body name="tool"', '<body name="tool" gravcomp="1"')
    with pytest.raises(SceneError, match=r"ignore=\('gravcomp', 'fluid'\)"):
        phipsi.load(text)
    assert phipsi.load(text, ignore=("gravcomp", "fluid")).nv == phipsi.load(MODEL).nv


@pytest.mark.parametrize("what", ["armature", "friction", "stiffness"])
def test_an_ignored_property_of_a_free_joint_is_none(what: str) -> None:
    name, _, text = PARTS[f"{what} of a free joint"]
    free = phipsi.load(text, ignore=[name]).joints["free"]
    assert (free.type, getattr(free, what)) == ("floating", 0.0)


@pytest.mark.parametrize("flags", ['gravity="disable"', 'spring="disable" damper="disable"'])
def test_gravity_compensation_that_is_switched_off(flags: str) -> None:
    assert phipsi.load(PARTS["gravcomp"][2].replace("<flag ", f"<flag {flags} ")).nv == phipsi.load(MODEL).nv


def test_a_weld_without_torques_is_a_point() -> None:
    scene = phipsi.load(with_('<equality><weld name="pin" body1="tool" body2="leg" torquescale="0"/></equality>'))
    assert len(scene.loops.error(scene.neutral())) == 3


def bodies(first: str, second: str, extra: str = "", flags: str = "") -> str:
    return f"""<mujoco><option><flag {flags}/></option><worldbody><body name="a"><joint/><geom size=".1" {first}/>
        <body name="b"><joint/><geom size=".1"/><body name="c"><joint/><geom size=".1" {second}/></body></body></body></worldbody>{extra}</mujoco>"""


@pytest.mark.parametrize(
    ("text", "collides"),
    [
        (bodies("", ""), True),
        (bodies("", "").replace('<body name="c"><joint/>', '<body name="c">'), False),
        (bodies('contype="0" conaffinity="0"', ""), False),
        (bodies('contype="2" conaffinity="0"', 'contype="0" conaffinity="2"'), True),
        (bodies('contype="2" conaffinity="0"', 'contype="4" conaffinity="4"'), False),
        (bodies("", "", '<contact><exclude body1="a" body2="c"/></contact>'), False),
        (bodies("", "", flags='contact="disable"'), False),
        (bodies("", "", flags='constraint="disable"'), False),
        (bodies('contype="0" conaffinity="0"', "", flags='filterparent="disable"'), True),
        (
            bodies(
                'name="x" contype="0" conaffinity="0"', 'name="y"', '<contact><pair geom1="x" geom2="y"/></contact>'
            ),
            True,
        ),
    ],
)
def test_contacts_are_reported_where_mujoco_finds_them(text: str, collides: bool) -> None:
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert (data.ncon > 0) == collides
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        phipsi.load(model)
    assert [warning.category for warning in caught] == [ModelWarning] * collides
