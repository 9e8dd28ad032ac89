"""Scene.from_mujoco compared with MuJoCo: poses, mass matrix, bias, springs and losses, accelerations; refused
features, by name.
"""

from __future__ import annotations

import sys
import types
import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco_models import ARM, FLOATING, random_model, shipped

from tolerances import assert_near, assert_same_bits, inverse, product, recursion, size

import phipsi
import phipsi.mujoco
from phipsi.errors import ArgumentError, MeshWarning, MimicWarning, ModelWarning, SceneError, ShapeError

MODELS = {"arm": ARM, "floating": FLOATING} | {f"random-{seed}": random_model(seed) for seed in range(12)}
MODELS |= {path.stem: str(path) for path in shipped()}
#: Free joints with properties along the axes of the world, as the armature of unitree h1, h1_2 and r1.
MODELS |= {
    f"free-{name}": FLOATING.replace("<freejoint/>", f'<joint type="free" {text}/>')
    for name, text in (("armature", 'armature="0.3"'), ("all", 'armature="0.7" damping="0.2" frictionloss="0.4" stiffness="2"'))
}


class There:
    """A state of a model, and MuJoCo's results in its own conventions."""

    def __init__(self, source: str, seed: int) -> None:
        self.model = mujoco.MjModel.from_xml_string(source) if source.lstrip().startswith("<") else mujoco.MjModel.from_xml_path(source)
        # swimmer is in test_what_a_scene_has_not_is_refused_by_name.
        self.model.opt.density = self.model.opt.viscosity = 0.0
        self.data = mujoco.MjData(self.model)
        draw = np.random.default_rng(seed)
        mujoco.mj_integratePos(self.model, self.data.qpos, draw.standard_normal(self.model.nv), 1.0)
        self.data.qvel = draw.standard_normal(self.model.nv)
        self.data.qfrc_applied = draw.standard_normal(self.model.nv)
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        mujoco.mj_forward(self.model, self.data)
        mass = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, mass)
        self.mass = mass


@pytest.fixture(params=MODELS, scope="module")
def pair(request: pytest.FixtureRequest) -> tuple[phipsi.Scene, There]:
    there = There(MODELS[request.param], 7)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "source: found .* at the free joint", ModelWarning)
        return phipsi.Scene.from_mujoco(there.model), there


def state(scene: phipsi.Scene, there: There) -> tuple[np.ndarray, np.ndarray]:
    return phipsi.mujoco.to_state(scene, there.data.qpos, there.data.qvel)


def test_bodies_are_where_mujoco_has_them(pair: tuple[phipsi.Scene, There]) -> None:
    scene, there = pair
    places, names = scene.placements(state(scene, there)[0]), phipsi._mjcf.Names(there.model)
    for body in range(there.model.nbody):
        place = places[names.bodies[body]]
        assert_near(place[:3, 3], there.data.xpos[body], recursion(scene.nv, size(there.data.xpos)))
        assert_near(place[:3, :3], there.data.xmat[body].reshape(3, 3), recursion(scene.nv, 1.0))


def test_the_mass_matrix_is_mujocos(pair: tuple[phipsi.Scene, There]) -> None:
    scene, there = pair
    q, _ = state(scene, there)
    # Rows and columns are converted like forces.
    half = phipsi.mujoco.to_forces(scene, q, there.mass)
    assert_near(scene.mass_matrix(q), phipsi.mujoco.to_forces(scene, q, half.T), recursion(scene.nv, size(there.mass)))


def test_the_bias_is_mujocos(pair: tuple[phipsi.Scene, There]) -> None:
    scene, there = pair
    q, qd = state(scene, there)
    # MuJoCo's accelerations are those of the linear velocity in the world frame: if they are zero, those of phipsi
    # are -w x v.
    still = phipsi.mujoco.to_accelerations(scene, q, qd, np.zeros(scene.nv))
    bound = recursion(scene.nv, size(there.data.qfrc_bias))
    assert_near(scene.inverse_dynamics(q, qd, still), phipsi.mujoco.to_forces(scene, q, there.data.qfrc_bias), bound)


def test_accelerations_are_mujocos(pair: tuple[phipsi.Scene, There]) -> None:
    scene, there = pair
    q, qd = state(scene, there)
    tau = phipsi.mujoco.to_forces(scene, q, there.data.qfrc_applied + there.data.qfrc_passive)
    found = scene.forward_dynamics(q, qd, tau)
    expected = phipsi.mujoco.to_accelerations(scene, q, qd, there.data.qacc_smooth)
    bound = inverse(float(np.linalg.cond(there.mass)), size(expected))
    assert_near(found, expected, bound)
    back = phipsi.mujoco.from_accelerations(scene, q, qd, found)
    assert_near(back, there.data.qacc_smooth, bound)


def test_springs_and_damping_are_mujocos(pair: tuple[phipsi.Scene, There]) -> None:
    scene, there = pair
    q, qd = state(scene, there)
    mass = scene.mass_matrix(q)
    # A step of a microsecond: the change of the velocities is due to the acting forces.
    dt = 1e-6
    path = scene.simulate(q, qd, dt=dt, steps=1, method="semi-implicit-euler", friction=0.0, limits="report")
    acting = mass @ (path.qd[-1] - qd) / dt + scene.bias_torque(q, qd)
    expected = phipsi.mujoco.to_forces(scene, q, there.data.qfrc_passive)
    assert np.max(np.abs(acting - expected), initial=0.0) <= 1e-4 * max(1.0, np.max(np.abs(expected), initial=0.0))


def stopped(seed: int) -> str:
    """A random tree of hinges and slides with stops, dry friction, damping, springs and armature."""
    draw = np.random.default_rng(seed)

    def some(text: str, share: float = 0.5) -> str:
        return text if draw.random() < share else ""

    def joint() -> str:
        is_slide, ref = draw.random() < 0.3, draw.uniform(-0.3, 0.3)
        low, high = draw.uniform(*((0.02, 0.1) if is_slide else (0.3, 0.8)), 2)
        losses = some(f'frictionloss="{draw.uniform(0, 4 if is_slide else 1)}"') + some(f' damping="{draw.uniform(0, 0.5)}"') + some(f' armature="{draw.uniform(0, 0.1)}"')
        spring = some(f'stiffness="{draw.uniform(0, 5)}" springref="{draw.uniform(-0.5, 0.5)}"')
        stops = some(f'range="{ref - low} {ref + high}" margin="{draw.uniform(0, 0.01)}"', 0.7)
        anchor = some(f'pos="{draw.normal(0, 0.05)} 0 {draw.normal(0, 0.05)}"')
        return f'<joint type="{"slide" if is_slide else "hinge"}" axis="{" ".join(map(str, draw.standard_normal(3)))}" ref="{ref}" {losses} {spring} {stops} {anchor}/>'

    def body(depth: int) -> str:
        inside = "".join(joint() for _ in range(draw.integers(1, 3))) + "".join(body(depth - 1) for _ in range(draw.integers(1, 3) if depth else 0))
        inertial = f'<inertial pos="{draw.normal(0, 0.05)} {draw.normal(0, 0.05)} -0.1" mass="{draw.uniform(0.5, 2)}" fullinertia="0.02 0.03 0.025 0.001 0 0.002"/>'
        return f'<body pos="{draw.normal(0, 0.1)} {draw.normal(0, 0.1)} -0.2" euler="{draw.normal()} {draw.normal()} 0">{inertial}{inside}</body>'

    return f'<mujoco><compiler angle="radian"/><option timestep="2e-5" impratio="1000"><flag contact="disable"/></option><worldbody>{body(draw.integers(0, 3))}</worldbody></mujoco>'


@pytest.mark.parametrize("seed", range(8))
def test_motions_with_stops_and_dry_friction_are_those_of_mujoco_with_stiff_constraints(seed: int) -> None:
    """Its constraints are overdamped here: those with critical damping rise at 0.14 of the speed of the impact."""
    model = mujoco.MjModel.from_xml_string(text := stopped(seed))
    for what in ("jnt", "dof"):
        getattr(model, f"{what}_solref")[:], getattr(model, f"{what}_solimp")[:, :2] = [5e-5, 8.0], 0.9999
    data = mujoco.MjData(model)
    data.qvel = np.random.default_rng(seed).standard_normal(model.nv) * np.where(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE, 0.2, 1.0)
    qd = data.qvel.copy()
    for _ in range(12500):
        mujoco.mj_step(model, data)
    scene = phipsi.load(text)
    path = scene.simulate(scene.initial(), qd, dt=2e-4, steps=1250)
    # The error of integration of both.
    assert_near(path.q[-1], data.qpos, 2e-3)


def test_states_go_there_and_back(pair: tuple[phipsi.Scene, There]) -> None:
    scene, there = pair
    q, qd = state(scene, there)
    qpos, qvel = phipsi.mujoco.from_state(scene, q, qd)
    assert np.array_equal(qpos, there.data.qpos)
    assert_near(qvel, there.data.qvel, product(scene.nv, size(qvel)))
    many = np.stack([there.data.qpos] * 3)
    assert np.array_equal(phipsi.mujoco.to_state(scene, many, there.data.qvel)[1], np.stack([qd] * 3))
    forces = phipsi.mujoco.to_forces(scene, q, there.data.qfrc_applied)
    assert_near(phipsi.mujoco.from_forces(scene, q, forces), there.data.qfrc_applied, product(scene.nv, size(forces)))


def test_joints_keep_names_order_and_numbers() -> None:
    scene = phipsi.Scene.from_mujoco(ARM)
    assert scene.joint_names == ("yaw", "pitch", "slide", "roll", "turn")
    assert scene.gravity.tolist() == [0.3, -0.2, -9.7]
    yaw = scene.joints["yaw"]
    assert (yaw.type, yaw.lower, yaw.upper, yaw.armature, yaw.damping, yaw.friction, yaw.effort) == ("revolute", -2, 2, 0.1, 0.5, 0.2, 15)
    pitch = scene.joints["pitch"]
    assert (pitch.type, pitch.stiffness) == ("continuous", 4.0)
    assert scene.rest[scene.q_index("pitch")] == pytest.approx(0.7)
    assert scene.body_names == ("shoulder", "elbow/pitch", "elbow", "wrist/roll", "wrist")
    assert np.all(phipsi.Scene.from_mujoco(ARM, gravity=(0, 0, 0)).gravity == 0.0)


def test_what_it_reads(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(ARM)
    spec = mujoco.MjSpec.from_string(ARM)
    binary = tmp_path / "arm.MJB"
    mujoco.mj_saveModel(mujoco.MjModel.from_xml_string(ARM), str(binary), None)
    scenes = [phipsi.Scene.from_mujoco(source) for source in (file, str(file), spec, binary)] + [phipsi.load(source) for source in (file, ARM, spec, binary)]
    mass = phipsi.Scene.from_mujoco(ARM).mass_matrix(np.zeros(5))
    assert all(np.array_equal(scene.mass_matrix(np.zeros(5)), mass) for scene in scenes)
    assert [scene.file for scene in scenes[:4]] == [file, file, None, None]


def with_(element: str) -> str:
    return FLOATING.replace("</mujoco>", f"{element}</mujoco>")


REFUSED = {
    "equality": (
        with_('<tendon><fixed name="rope"><joint joint="knee" coef="1"/></fixed></tendon><equality><tendon name="length" tendon1="rope"/></equality>')
        .replace('<joint axis="0 1 0"/>', '<joint name="knee" axis="0 1 0"/>'),
        "equality constraint 'length'",
    ),
    "tendons": (
        with_('<tendon><spatial name="rope" stiffness="3"><site site="a"/><site site="b"/></spatial></tendon>').replace(
            '<body name="arm" pos="-0.2 0 0.1">', '<site name="a"/><body name="arm" pos="-0.2 0 0.1"><site name="b"/>'
        ),
        "tendon 'rope'",
    ),
    "gravcomp": (FLOATING.replace('name="arm"', 'name="arm" gravcomp="0.5"'), "gravcomp 0.5 at the body 'arm'"),
    "fluid": (with_('<option density="1000"/>'), "medium of density 1000"),
    "nonlinear": (FLOATING.replace('<joint axis="0 1 0"/>', '<joint name="knee" axis="0 1 0" stiffness="2 1"/>'), "stiffnesspoly at the joint 'knee'"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_a_scene_has_not_is_refused_by_name(what: str) -> None:
    text, message = REFUSED[what]
    with pytest.raises(SceneError, match=message) as caught:
        phipsi.Scene.from_mujoco(text)
    assert f"ignore=({what!r},)" in str(caught.value)
    # And read on request.
    assert phipsi.Scene.from_mujoco(text, ignore=(what,)).nv == phipsi.Scene.from_mujoco(FLOATING).nv


def test_a_tendon_that_only_drives_is_no_obstacle() -> None:
    text = ARM.replace("</mujoco>", '<tendon><fixed name="both"><joint joint="roll" coef="1"/><joint joint="turn" coef="1"/></fixed></tendon></mujoco>')
    assert phipsi.Scene.from_mujoco(text).nv == 5


def test_inactive_constraints_are_no_obstacle() -> None:
    assert phipsi.Scene.from_mujoco(REFUSED["equality"][0].replace('<tendon name="length"', '<tendon name="length" active="false"')).nv == 18


def test_an_ignored_tie_of_joints_is_known_as_mimic() -> None:
    text = ARM.replace("</mujoco>", '<equality><joint joint1="slide" joint2="pitch" polycoef="0.2 0.5 0 0 0"/></equality></mujoco>')
    with pytest.warns(MimicWarning, match="slide"):
        scene = phipsi.Scene.from_mujoco(text, ignore=["equality"])
    mimic = scene.joints["slide"].mimic
    assert mimic is not None
    # slide - 0.1 = 0.2 + 0.5 (pitch - 0.3)
    assert (mimic.joint, mimic.multiplier, mimic.offset) == ("pitch", 0.5, pytest.approx(0.15))


def test_switched_off_gravity_springs_and_dampers_are_off() -> None:
    text = ARM.replace('<option gravity="0.3 -0.2 -9.7"/>', '<option><flag gravity="disable" spring="disable" damper="disable"/></option>')
    scene = phipsi.Scene.from_mujoco(text)
    assert not np.any(scene.gravity) and not np.any(scene.stiffness) and not np.any(scene.damping)
    assert np.any(phipsi.Scene.from_mujoco(ARM).damping)


def test_unequal_numbers_of_one_joint_are_refused() -> None:
    model = mujoco.MjModel.from_xml_string(FLOATING)
    model.dof_armature[6] = 3.0
    with pytest.raises(SceneError, match=r"dof_armature \[3.0, .*\] at the joint 'joint1'"):
        phipsi.Scene.from_mujoco(model)


def test_the_armature_of_a_free_joint_has_inertia_and_no_weight() -> None:
    """Read as three slides and a ball joint, with a warning; a free joint without armature on request."""
    text = FLOATING.replace("<freejoint/>", '<joint name="root" type="free" armature="0.3"/>', 1)
    with pytest.warns(ModelWarning, match="armature 0.3 at the free joint 'root'.*three slides and a ball joint"):
        scene = phipsi.Scene.from_mujoco(text)
    assert scene.joint_names[:4] == ("root/x", "root/y", "root/z", "root")
    assert [scene.joint(name).type for name in scene.joint_names[:4]] == ["prismatic"] * 3 + ["spherical"]
    assert [scene.joint(name).armature for name in scene.joint_names[:4]] == [0.3] * 4
    free = phipsi.Scene.from_mujoco(text, ignore=["armature"])
    assert (free.joint("root").type, free.joint("root").armature) == ("floating", 0.0)
    # The energies differ by that of the armature, and gravity does not act on it.
    data = There(text, 3).data
    energies = [of.energy(*phipsi.mujoco.to_state(of, data.qpos, data.qvel)) for of in (scene, free)]
    assert_near(energies[0].kinetic - energies[1].kinetic, 0.15 * np.sum(data.qvel[:6] ** 2), product(scene.nv, size(energies[0].kinetic)))
    assert_near(energies[0].potential, energies[1].potential, product(scene.nv, size(energies[1].potential)))


def test_names_that_a_file_does_not_give() -> None:
    model = mujoco.MjModel.from_xml_string(FLOATING)
    scene = phipsi.Scene.from_mujoco(model)
    assert [phipsi.mujoco.joint_name(model, joint) for joint in range(model.njnt)] == list(scene.joint_names)
    assert "joint1" in scene.joint_names
    places, data = scene.placements(scene.neutral()), mujoco.MjData(model)
    data.qpos[:] = phipsi.mujoco.from_state(scene, scene.neutral())[0]
    mujoco.mj_kinematics(model, data)
    for body in range(model.nbody):
        assert_near(places[phipsi.mujoco.link_name(FLOATING, np.int64(body))][:3, 3], data.xpos[body], recursion(scene.nv, size(data.xpos)))
    for wrong in (-1, model.nbody, 1.5, "arm"):
        with pytest.raises(ArgumentError, match=rf"body: found {wrong!r}; expected an integer from 0 to {model.nbody - 1}"):
            phipsi.mujoco.link_name(model, wrong)


@pytest.mark.parametrize(
    ("source", "kind", "message"),
    [
        (3, ArgumentError, "source: found int"),
        ("<mujoco><worldbody><bdy/></worldbody></mujoco>", SceneError, "MuJoCo cannot read it.*bdy"),
        ("missing.xml", SceneError, "'missing.xml', which is not a file"),
        (mujoco.MjSpec.from_string('<mujoco><worldbody><body><joint/></body></worldbody></mujoco>'), SceneError, "MuJoCo cannot read it: .*mass and inertia"),
    ],
)
def test_what_is_no_model(source: object, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message):
        phipsi.Scene.from_mujoco(source)


def test_an_unknown_name_to_ignore() -> None:
    with pytest.raises(ArgumentError, match="ignore: found 'contact'; expected names of contacts, actuators"):
        phipsi.Scene.from_mujoco(ARM, ignore=["contact"])


@pytest.mark.parametrize("call", ["to_state", "from_state"])
def test_states_of_another_length(call: str) -> None:
    scene = phipsi.Scene.from_mujoco(ARM)
    with pytest.raises(ShapeError, match=r"q(pos)?: found shape \(4,\); expected \(..., 5\)"):
        getattr(phipsi.mujoco, call)(scene, np.zeros(4))


def test_states_that_do_not_broadcast() -> None:
    scene = phipsi.Scene.from_mujoco(FLOATING)
    with pytest.raises(ShapeError, match=r"q: found leading axes \(2,\).*\(3,\)"):
        phipsi.mujoco.to_state(scene, np.tile(scene.neutral(), (2, 1)), np.zeros((3, scene.nv)))


def test_a_motion_is_mujocos() -> None:
    """One second of both, each with its own RK4."""
    there = There(FLOATING, 3)
    there.model.opt.timestep, there.model.opt.integrator = 1e-3, mujoco.mjtIntegrator.mjINT_RK4
    there.data.qfrc_applied[:] = 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = phipsi.Scene.from_mujoco(there.model)
    q, qd = state(scene, there)
    path = scene.simulate(q, qd, dt=1e-3, steps=200, method="rk4", record_every=200)
    for _ in range(200):
        mujoco.mj_step(there.model, there.data)
    expected, rates = state(scene, there)
    assert np.max(np.abs(path.q[-1] - expected)) < 1e-6
    assert np.max(np.abs(path.qd[-1] - rates)) < 1e-5


NAMED = """<mujoco><option><flag contact="disable"/></option><worldbody><site name="floor"/>
  <body><joint/><geom size=".1"/><site name="body1" pos="1 2 3" euler="0 0 90"/><site/>
    <body name="body1"><joint name="joint0"/><joint axis="1 0 0" name="x"/><geom size=".1"/>
      <body name="body1/joint0"><joint/><geom size=".1"/><site name="arm"/></body></body>
    <body name="arm" pos="0 0 1"><geom size=".1"/></body></body>
  <body name="b"><joint name="arm/fixed"/><geom size=".1"/></body></worldbody>
  <equality><connect body1="b" body2="body1" anchor="0 0 0"/><connect name="equality 0" body1="b" body2="arm" anchor="0 0 0"/></equality></mujoco>"""


def test_made_up_names_do_not_clash_with_names_of_the_file() -> None:
    scene = phipsi.load(NAMED)
    assert scene.joint_names == ("joint0_", "joint0", "x", "joint3", "arm/fixed")
    assert set(scene.link_names) == {"world", "floor", "body1_", "body1/site", "body1/joint0_", "body1", "body1/joint0", "arm/site", "arm", "b"}
    assert scene.loops.names == ("equality 0_", "equality 0")


def test_sites_are_links() -> None:
    """MuJoCo's contacts; they do not affect the motion."""
    model = mujoco.MjModel.from_xml_string(NAMED)
    scene, data = phipsi.load(model), mujoco.MjData(model)
    data.qpos[:] = np.random.default_rng(0).standard_normal(model.nq)
    mujoco.mj_forward(model, data)
    placements = scene.placements(data.qpos)
    for site, name in ((0, "floor"), (1, "body1/site"), (3, "arm/site")):
        assert_near(placements[name][:3, 3], data.site_xpos[site], recursion(scene.nv, size(data.site_xpos)))
        assert_near(placements[name][:3, :3], data.site_xmat[site].reshape(3, 3), recursion(scene.nv, 1.0))
    assert scene.nv == model.nv and scene.total_mass == pytest.approx(model.body_mass.sum())


def test_actuators_with_several_controls() -> None:
    text = ARM.replace("</actuator>", '<pid joint="roll" kp="3" forcelimited="true" forcerange="-2 2" gear="3"/><motor joint="turn" forcelimited="true" forcerange="-1 1"/></actuator>')
    scene = phipsi.load(text)
    assert (scene.joints["yaw"].effort, scene.joints["roll"].effort, scene.joints["turn"].effort) == (15.0, 6.0, 1.0)


def test_margins_move_stops() -> None:
    text = ARM.replace('range="-2 2"', 'range="-2 2" margin="0.25"')
    assert (phipsi.load(text).joints["yaw"].lower, phipsi.load(text).joints["yaw"].upper) == (-1.75, 1.75)
    text = text.replace('margin="0.25"', 'margin="2.5"')
    with pytest.raises(SceneError, match=r"limits of the joint 'yaw', whose margin 2.5 .*ignore=\('limits',\)"):
        phipsi.load(text)
    assert phipsi.load(text, ignore=["limits"]).joints["yaw"].type == "continuous"


def test_constraints_between_bodies_that_cannot_move_apart_are_none() -> None:
    text = FLOATING.replace('<body name="fixture"', '<body name="pole"/><body name="fixture"')
    scene = phipsi.load(text.replace("</mujoco>", '<equality><weld body1="pole" body2="fixture"/></equality></mujoco>'))
    assert scene.loops.names == ()


def test_models_are_read_in_linear_time() -> None:
    """Counts interpreter steps, because times vary."""

    def steps(count: int) -> int:
        arms = "".join(f'<body><joint name="j{at}"/><geom size=".1" contype="0" conaffinity="0"/></body>' for at in range(count))
        motors = "".join(f'<motor joint="j{at}" forcelimited="true" forcerange="-1 1"/>' for at in range(count))
        model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{arms}</worldbody><actuator>{motors}</actuator></mujoco>")
        seen = 0

        def trace(frame: types.FrameType, event: str, argument: object) -> object:
            nonlocal seen
            frame.f_trace_opcodes = True
            seen += 1
            return trace

        before = sys.gettrace()
        sys.settrace(trace)  # type: ignore[arg-type]
        try:
            phipsi.load(model)
        finally:
            sys.settrace(before)
        return seen

    steps(5)
    assert steps(80) <= 2.2 * steps(40)


MESHES = """<mujoco><compiler meshdir="parts"/><option><flag contact="disable"/></option>
  <asset><mesh name="shell" file="shell.stl"/><texture name="wood" type="2d" file="wood.png"/><material name="wood" texture="wood"/></asset>
  <worldbody><geom type="mesh" mesh="shell" material="wood"/><body name="arm"><joint name="hinge"/>
  <inertial pos="0 0 1" mass="2" diaginertia="1 1 1"/><geom name="part" type="mesh" mesh="shell"/></body></worldbody></mujoco>"""


def test_missing_meshes_that_no_inertia_depends_on(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(MESHES)
    with pytest.warns(MeshWarning, match="found no file 'shell.stl' and 1 more"):
        scene = phipsi.load(file)
    assert (scene.total_mass, scene.file) == (2.0, file.resolve())
    with pytest.raises(SceneError, match="found no file 'shell.stl' and 1 more"):
        phipsi.load(file, strict=True)
    specification = mujoco.MjSpec.from_file(str(file))
    with pytest.warns(MeshWarning, match="found no file 'shell.stl' and 1 more"):
        assert phipsi.load(specification).total_mass == 2.0
    # The caller's specification is unchanged.
    assert [mesh.file for mesh in specification.meshes] == ["shell.stl"]
    # For a body without <inertial> the mesh determines the inertia, unless it has no mass.
    without = MESHES.replace('<inertial pos="0 0 1" mass="2" diaginertia="1 1 1"/>', "{}")
    file.write_text(without.format(""))
    with pytest.raises(SceneError, match="found no file 'shell.stl', from which the inertia of body 'arm' is computed"):
        phipsi.load(file)
    file.write_text(without.format('<geom size=".1"/>').replace('name="part"', 'name="part" density="0"'))
    with pytest.warns(MeshWarning):
        assert phipsi.load(file).total_mass == pytest.approx(1000.0 * 4.0 / 3.0 * np.pi * 0.1**3)


KEYS = """<keyframe><key name="home" qpos="{}"/><key qvel="{}" ctrl="{}"/><key name="both" qpos="{}" qvel="{}"/></keyframe>"""


def with_keys(text: str, seed: int = 0) -> str:
    """A model with keyframes of random states: positions alone, velocities alone, and both."""
    model, draw = mujoco.MjModel.from_xml_string(text), np.random.default_rng(seed)
    qpos, qvel = np.tile(model.qpos0, (2, 1)), draw.standard_normal((2, model.nv))
    for q in qpos:
        mujoco.mj_integratePos(model, q, draw.standard_normal(model.nv), 1.0)
    numbers = [" ".join(map(repr, row.tolist())) for row in (qpos[0], qvel[0], np.ones(model.nu), qpos[1], qvel[1])]
    return text.replace("</mujoco>", KEYS.format(*numbers) + "</mujoco>")


@pytest.mark.parametrize("text", [ARM, FLOATING, MODELS["free-all"], random_model(3), random_model(5)])
def test_a_scene_starts_where_mujoco_starts(text: str) -> None:
    model = mujoco.MjModel.from_xml_string(with_keys(text))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "source: found .* at the free joint", ModelWarning)
        scene = phipsi.load(model)
    data, names = mujoco.MjData(model), phipsi._mjcf.Names(model)
    assert scene.keyframes == ("home", "key1", "both")
    for at, keyframe in enumerate((None, *scene.keyframes)):
        mujoco.mj_resetData(model, data) if keyframe is None else mujoco.mj_resetDataKeyframe(model, data, at - 1)
        mujoco.mj_forward(model, data)
        places = scene.placements(scene.initial(keyframe))
        for body, name in enumerate(names.bodies):
            assert_near(places[name][:3, 3], data.xpos[body], recursion(scene.nv, size(data.xpos)))
            assert_near(places[name][:3, :3], data.xmat[body].reshape(3, 3), recursion(scene.nv, 1.0))
        q, qd = phipsi.mujoco.to_state(scene, data.qpos, data.qvel)
        assert_same_bits(scene.initial(keyframe), q)
        assert_same_bits(scene.initial_velocity(keyframe), qd)
        if keyframe is not None:
            assert_same_bits(scene.initial(np.int64(at - 1)), q)
    assert np.any(scene.initial() != scene.neutral()) and np.any(scene.initial_velocity("both"))


def test_quaternions_of_a_start_have_any_length_as_in_mujoco() -> None:
    model = mujoco.MjModel.from_xml_string(FLOATING)
    model.qpos0[3:7] *= 1.3
    mujoco.mj_kinematics(model, data := mujoco.MjData(model))
    scene = phipsi.load(model)
    assert_near(scene.placement(scene.initial(), "trunk")[:3, :3], data.body("trunk").xmat.reshape(3, 3), recursion(scene.nv, 1.0))


@pytest.mark.parametrize("name", ["Home", 3, -1, 0.5])
def test_an_unknown_keyframe_lists_the_names(name: object) -> None:
    scene = phipsi.load(with_keys(ARM))
    for call in (scene.initial, scene.initial_velocity):
        with pytest.raises(ArgumentError, match=f'keyframe: found .*{name}.*; expected one of "home", "key1", "both"'):
            call(name)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="keyframe: found .*; expected none, because the scene has no keyframes"):
        phipsi.load(ARM).initial(name)  # type: ignore[arg-type]


def test_parts_of_keyframes_that_are_not_read_are_named() -> None:
    text = """<mujoco><worldbody><body name="target" mocap="true" pos="0 0 1"/><body><joint name="j"/><geom size=".1" contype="0"/></body></worldbody>
      <actuator><general joint="j" dyntype="integrator"/></actuator><keyframe><key name="k" qpos="1" {}/><key name="plain" qpos="0.5" ctrl="1"/></keyframe></mujoco>"""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert phipsi.load(text.format("")).initial("k") == 1.0
    assert phipsi.load(text.format('act="1"')).actuators.keyframe_activations["k"] == 1.0
    for part, given in (("time", 'time="2"'), ("mpos", 'mpos="0 0 2"'), ("mquat", 'mquat="0 1 0 0"')):
        with pytest.warns(ModelWarning, match=rf"{part} of the keyframe 'k': only qpos, qvel, ctrl and act are read; use ignore=\('keyframes',\)"):
            scene = phipsi.load(text.format(given))
        assert scene.initial("k") == 1.0
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            phipsi.load(text.format(given), ignore=["keyframes"])
