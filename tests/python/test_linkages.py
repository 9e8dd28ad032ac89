"""Linkages described with few digits keep the mobility of the intended linkage and warn; with strict=True they are
rigid.
"""

from __future__ import annotations

from operator import attrgetter
import pickle
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import phipsi
import pytest
from phipsi.errors import ArgumentError, ConstraintError, LinkageWarning, SceneError
from tolerances import FAR, size

ROD = np.diag([4e-3, 4e-3, 1e-3])


def turned(axis: np.ndarray, angle: float) -> np.ndarray:
    """The rotation about an axis."""
    x, y, z = axis / np.linalg.norm(axis)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew


class Drawing:
    """A builder whose joints have errors `error`: rad about random axes, and m in random directions if lengths have
    errors too.
    """

    def __init__(self, error: float, lengths: bool = False, seed: int = 1) -> None:
        self.builder, self.error, self.lengths = phipsi.SceneBuilder().link("ground"), error, lengths
        self.random = np.random.default_rng(seed)

    def add(self, name: str, parent: str, xyz: tuple[float, float, float], kind: str = "continuous", axis: tuple[float, float, float] = (0, 1, 0),
            turn: float = 0.0) -> None:  # fmt: skip
        about, along = self.random.normal(size=(2, 3))
        rotation = turned(np.array([0, 0, 1.0]), turn) @ turned(about, self.error)
        at = np.array(xyz, dtype=float) + (self.error * along / np.linalg.norm(along) if self.lengths else 0.0)
        self.builder.link(name, mass=1.0, com=(0.02, 0.01, 0.05), inertia=ROD)
        self.builder.joint(
            name,
            kind,
            parent,
            name,
            xyz=at,
            rotation=rotation,
            axis=axis,
            **({"lower": -9, "upper": 9, "velocity": 9, "effort": 9} if kind == "prismatic" else {}),
        )


def four_bar(error: float, kind: str = "axis") -> tuple[phipsi.SceneBuilder, list[float], int]:
    """A crank and rocker that passes no singular position."""
    drawing = Drawing(error)
    drawing.add("crank", "ground", (0, 0, 0))
    drawing.add("coupler", "crank", (0, 0, 0.2))
    drawing.add("rocker", "ground", (0.45, 0, 0))
    axis = {"axis": (0, 1, 0)} if kind == "axis" else {}
    builder = drawing.builder.connect("pin", kind, "coupler", "rocker", xyz=(0, 0, 0.5), other_xyz=(0, 0, 0.4), **axis)
    return builder, [0.4, 0.6, 0.3], 1


def slider_crank(error: float) -> tuple[phipsi.SceneBuilder, list[float], int]:
    drawing = Drawing(error)
    drawing.add("crank", "ground", (0, 0, 0))
    drawing.add("rod", "crank", (0, 0, 0.2))
    drawing.add("piston", "ground", (0, 0, 0), "prismatic", (1, 0, 0))
    builder = drawing.builder.connect("pin", "axis", "rod", "piston", xyz=(0, 0, 0.6), other_xyz=(0, 0, 0), axis=(0, 1, 0))
    return builder, [0.5, 1.2, 0.6], 1


def three_cranks(error: float) -> tuple[phipsi.SceneBuilder, list[float], int]:
    """A parallelogram with a third crank whose lengths have errors too: one redundant constraint in the plane."""
    drawing = Drawing(error, lengths=True)
    for i, at in enumerate((0.0, 0.3, 0.6)):
        drawing.add(f"crank{i}", "ground", (at, 0, 0))
    drawing.add("bar", "crank0", (0, 0, 0.2))
    for i, at in enumerate((0.3, 0.6), start=1):
        drawing.builder.connect(f"pin{i}", "axis", "bar", f"crank{i}", xyz=(at, 0, 0), other_xyz=(0, 0, 0.2), axis=(0, 1, 0))
    return drawing.builder, [0.5, -0.5, 0.5, 0.5], 1


def scissors(error: float) -> tuple[phipsi.SceneBuilder, list[float], int]:
    """A scissor lift of one stage: crossed legs, one on a slider below, the other in a slider of the platform."""
    drawing = Drawing(error)
    drawing.add("leg", "ground", (0, 0, 0))
    drawing.add("foot", "ground", (0, 0, 0), "prismatic", (1, 0, 0))
    drawing.add("other", "foot", (0, 0, 0))
    drawing.add("platform", "other", (0, 0, 0.6))
    drawing.add("block", "platform", (0, 0, 0), "prismatic", (1, 0, 0))
    drawing.builder.connect("middle", "axis", "leg", "other", xyz=(0, 0, 0.3), other_xyz=(0, 0, 0.3), axis=(0, 1, 0))
    drawing.builder.connect("top", "axis", "leg", "block", xyz=(0, 0, 0.6), other_xyz=(0, 0, 0), axis=(0, 1, 0))
    angle = 0.7
    width = 0.6 * np.sin(angle)
    return drawing.builder, [angle, width, -angle, angle, width], 1


def delta(error: float) -> tuple[phipsi.SceneBuilder, list[float], int]:
    """Three arms with forearms of two rods each: the platform translates. Described in a closed configuration: 25
    constraints, 13 of them independent.
    """
    drawing = Drawing(error)
    across = (-0.8, 0.0, 0.6)
    for i in range(3):
        drawing.add(f"arm{i}", "ground", (0.2 * np.cos(2.1 * i), 0.2 * np.sin(2.1 * i), 0), turn=2.1 * i)
        drawing.add(f"elbow{i}", f"arm{i}", (0.3, 0, 0))
        drawing.add(f"rod{i}", f"elbow{i}", (0, 0.04, 0), axis=across)
        drawing.add(f"twin{i}", f"elbow{i}", (0, -0.04, 0), axis=across)
        drawing.add(f"wrist{i}", f"rod{i}", (-0.45, 0, -0.6), axis=across)
        drawing.builder.connect(f"twin{i}", "axis", f"twin{i}", f"wrist{i}", xyz=(-0.45, 0, -0.6), axis=across)
        if i == 0:
            drawing.add("platform", "wrist0", (-0.05, -0.04, 0))
        else:
            drawing.builder.connect(f"wrist{i}", "axis", f"wrist{i}", "platform", xyz=(0, -0.04, 0), axis=(0, 1, 0))
    return drawing.builder, [0.0] * 16, 3


LINKAGES = {
    "four-bar": four_bar,
    "four-bar on a point": lambda error: four_bar(error, "point"),
    "slider-crank": slider_crank,
    "three cranks": three_cranks,
    "scissors": scissors,
    "delta": delta,
}


@contextmanager
def expecting_warnings(error: float) -> Iterator[list[warnings.WarningMessage]]:
    """Catches LinkageWarnings; there is one if the description is inaccurate."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield caught
    assert all(issubclass(one.category, LinkageWarning) for one in caught)
    assert len(caught) == (1 if error else 0), [str(one.message) for one in caught]


def tolerance_of(error: float) -> float | None:
    """The default tolerance if the error of the description is within it."""
    return None if error < 1e-5 else 5e-3


def moved(name: str, error: float) -> tuple[np.ndarray, np.ndarray, phipsi.Trajectory]:
    """A motion of a linkage: initial state, initial accelerations, and trajectory."""
    builder, q, mobility = LINKAGES[name](error)
    with expecting_warnings(error):
        scene = builder.build(tolerance=tolerance_of(error))
        wanted = np.cos(np.arange(scene.nv))
        at, qd, rank = scene.loops.project(q, wanted)
        assert rank == scene.nv - mobility, (name, error)
        tau = 0.1 * np.sin(1.0 + np.arange(scene.nv))
        found = scene.loops.dynamics(at, qd, tau)
        assert found.rank == scene.nv - mobility
        assert np.array_equal(found.qdd, scene.forward_dynamics(at, qd, tau))
        assert np.max(np.abs(scene.loops.error(at))) <= 20 * max(error, FAR)
        path = scene.simulate(at, qd, dt=1e-3, steps=100, tau=tau, record_every=50)
        simulator = scene.simulator(at, qd, dt=1e-3)
        simulator.step(tau, steps=100)
        assert np.array_equal(simulator.q, path.q[-1])
        # The errors of dependent constraints are in the result.
        assert path.drift.max() <= 50 * max(error, FAR)
        inverse = scene.loops.mass_matrix_inverse(at)
        assert np.linalg.matrix_rank(inverse, 1e-9 * np.max(np.abs(inverse))) == mobility
    return np.concatenate([at, qd]), found.qdd, path


@pytest.mark.parametrize("name", LINKAGES)
def test_motion_tends_to_that_of_the_exact_linkage(name: str) -> None:
    start, qdd, path = moved(name, 0.0)
    assert np.max(np.abs(start[len(start) // 2 :])) > 0.1
    off = []
    for error in (1e-3, 1e-5, 3e-7, 1e-9):
        other, accelerations, motion = moved(name, error)
        relative = [
            np.max(np.abs(other - start)),
            np.max(np.abs(accelerations - qdd)) / size(qdd),
            np.max(np.abs(motion.q - path.q)),
            np.max(np.abs(motion.qd - path.qd)) / size(path.qd),
        ]
        print(f"{name} {error:.0e}: " + " ".join(f"{value:.1e}" for value in relative))
        off.append(max(relative))
        # At most the error of the description, and rounding.
        assert max(relative) <= 100 * error + 100 * FAR


def test_strict_takes_the_drawing_as_exact() -> None:
    builder, q, _ = four_bar(3.7e-6)
    strict = builder.build(strict=True)
    assert strict.loops.tolerance == 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            found = strict.loops.project(q, [1.0, 0.0, 0.0])
        except ConstraintError as error:
            assert error.connections == ("pin",)
        else:
            assert found.rank == 3 and np.max(np.abs(found.qd)) <= 1e-6
    assert builder.build(tolerance=0.0).loops.tolerance == 0.0


def test_the_warning_names_joint_row_and_angle() -> None:
    builder = phipsi.SceneBuilder().link("ground")
    for name, parent, xyz, rpy in (
        ("crank", "ground", (0, 0, 0), (0, 0, 0)),
        ("coupler", "crank", (0, 0, 0.2), (3.7e-6, 0, 0)),
        ("rocker", "ground", (0.45, 0, 0), (0, 0, 0)),
    ):
        builder.link(name, mass=1.0, com=(0, 0, 0.1), inertia=ROD).joint(name, "continuous", parent, name, xyz=xyz, rpy=rpy, axis=(0, 1, 0))
    scene = builder.connect("pin", "axis", "coupler", "rocker", xyz=(0, 0, 0.5), other_xyz=(0, 0, 0.4), axis=(0, 1, 0)).build()
    with pytest.warns(LinkageWarning) as caught:
        at = scene.loops.project([0.4, 0.6, 0.3], [1.0, 0, 0])
        scene.forward_dynamics(at.q, at.qd, np.zeros(3))
    text = str(caught[0].message)
    assert len(caught) == 1
    for part in ('connection "pin"', "row ", '"crank"', '"coupler"', "3.7e-6 rad", "treated as parallel", "3.0e-5", "strict=True"):
        assert part in text, text
    # Once per scene.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene.loops.project([0.4, 0.6, 0.3], [1.0, 0, 0])


def test_axes_that_miss_by_more_than_the_tolerance_are_named() -> None:
    builder, q, _ = four_bar(1e-3)
    scene = builder.build()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            scene.loops.project(q, [1.0, 0, 0])
        except ConstraintError:
            scene.loops.error(q)
            scene.loops.dynamics(q, np.zeros(3), np.zeros(3), compliance=1.0)
    texts = [str(one.message) for one in caught if issubclass(one.category, LinkageWarning)]
    assert any("more than the tolerance" in text and "tolerance=" in text for text in texts), texts


URDF = """<robot name="four-bar"><link name="ground"/>{}</robot>"""
LINK = '<link name="{0}"><inertial><origin xyz="0 0 0.1"/><mass value="1"/><inertia ixx="0.004" iyy="0.004" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>'
JOINT = '<joint name="{0}" type="continuous"><parent link="{1}"/><child link="{0}"/><origin xyz="{2}" rpy="{3}"/><axis xyz="{4}"/></joint>'


@pytest.mark.parametrize(
    ("angle", "tolerance"),
    [("1.5708", 2e-4), ("-1.5708", 2e-4), ("1.57", 5e-3), ("-1.571", 2e-3), ("1.570796", 3e-5), ("1.5707963267948966", 3e-5)],
)
def test_right_angles_of_a_file(angle: str, tolerance: float) -> None:
    # The frames of coupler and rocker are rotated about x, and their axes are y of the ground up to rounding.
    axis = "0 0 -1" if angle.startswith("1") else "0 0 1"
    text = "".join(LINK.format(name) for name in ("crank", "coupler", "rocker"))
    text += JOINT.format("crank", "ground", "0 0 0", "0 0 0", "0 1 0")
    text += JOINT.format("coupler", "crank", "0 0 0.2", f"{angle} 0 0", axis)
    text += JOINT.format("rocker", "ground", "0.45 0 0", f"{angle} 0 0", axis)
    tree = phipsi.Scene.from_urdf(URDF.format(text))
    up = -1.0 if axis == "0 0 1" else 1.0
    ends = {"xyz": (0, up * 0.5, 0), "other_xyz": (0, up * 0.4, 0), "axis": (0, 0, 1)}
    builder = tree.to_builder().connect("pin", "axis", "coupler", "rocker", **ends)
    scene = builder.build()
    assert scene.loops.tolerance == tolerance and pickle.loads(pickle.dumps(scene)).loops.tolerance == tolerance
    exact = four_bar_of_angles()
    wanted = exact.loops.project([0.4, 0.6, 0.3], [1.0, 0.0, 0.0])
    error = abs(abs(float(angle)) - np.pi / 2)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = scene.loops.project([0.4, 0.6, 0.3], [1.0, 0.0, 0.0])
        path = scene.simulate(found.q, found.qd, dt=1e-3, steps=200)
    assert len(caught) == (1 if error > 1e-9 else 0)
    assert found.rank == 2
    assert np.max(np.abs(found.q - wanted.q)) <= 10 * error + FAR * 10 and np.max(np.abs(found.qd - wanted.qd)) <= 10 * error + FAR * 10
    assert np.max(np.abs(path.q[-1] - exact.simulate(wanted.q, wanted.qd, dt=1e-3, steps=200).q[-1])) <= 10 * error + 1000 * FAR
    assert path.drift.max() <= 10 * error + FAR


def four_bar_of_angles() -> phipsi.Scene:
    """The linkage of the file with exact angles."""
    builder = phipsi.SceneBuilder().link("ground")
    for name, parent, xyz in (("crank", "ground", (0, 0, 0)), ("coupler", "crank", (0, 0, 0.2)), ("rocker", "ground", (0.45, 0, 0))):
        inertia, com = (np.diag([4e-3, 4e-3, 1e-3]), (0, 0, 0.1))
        if name != "crank":
            # As in the file, in rotated frames.
            turn = turned(np.array([1.0, 0, 0]), np.pi / 2)
            inertia, com = turn @ inertia @ turn.T, tuple(turn @ np.array(com))
        builder.link(name, mass=1.0, com=com, inertia=inertia).joint(name, "continuous", parent, name, xyz=xyz, axis=(0, 1, 0))
    return builder.connect("pin", "axis", "coupler", "rocker", xyz=(0, 0, 0.5), other_xyz=(0, 0, 0.4), axis=(0, 1, 0)).build()


@pytest.mark.parametrize("error", [0.0, 3.7e-6, 1e-3])
def test_rows_that_give_way(error: float) -> None:
    builder, q, _ = four_bar(error)
    exact, scene = four_bar(0.0)[0].build(), builder.build(tolerance=5e-3)
    # A small compliance preserves the mobility of an inaccurate linkage.
    compliance = 1e-3
    found = scene.loops.project(q, [1.0, 0.0, 0.0], compliance=1e-4)
    assert found.rank == 5 and np.max(np.abs(found.qd)) > 0.1
    path = scene.simulate(found.q, found.qd, dt=1e-3, steps=200, compliance=compliance)
    assert np.max(np.abs(path.qd[-1])) > 0.05 and path.drift.max() <= 0.05
    simulator = scene.simulator(found.q, found.qd, dt=1e-3, compliance=compliance)
    again = pickle.loads(pickle.dumps(simulator))
    for one in (simulator, again):
        one.step(steps=200)
        assert np.array_equal(one.q, path.q[-1])
    # With nearly zero compliance, the constraints are satisfied.
    held, tight = exact.loops.project(q, [1.0, 0.0, 0.0]), exact.loops.project(q, [1.0, 0.0, 0.0], compliance=1e-12)
    assert np.max(np.abs(tight.q - held.q)) <= 1e-8 and np.max(np.abs(tight.qd - held.qd)) <= 1e-8
    ends = [exact.simulate(held.q, held.qd, dt=1e-3, steps=200, **options).q[-1] for options in ({}, {"compliance": 1e-12})]
    assert np.max(np.abs(ends[1] - ends[0])) <= 1e-6
    assert set(path.constraint_forces()) == {"pin"} and np.all(np.isfinite(path.constraint_forces()["pin"]))


def test_projection_with_compliance_is_a_least_squares_estimate() -> None:
    builder, q, _ = four_bar(0.0)
    scene, compliance = builder.build(), np.array([0.5, 0.5, 1.0, 2.0, 3.0])
    found = scene.loops.project(q, [1.0, 2.0, 3.0], compliance=compliance)
    assert np.max(np.abs(scene.loops.error(found.q))) > 1e-3
    # Velocities are nearest by kinetic energy plus (J v)^2 / (2 compliance).
    mass, jacobian = scene.mass_matrix(found.q), scene.loops.jacobian(found.q)
    expected = np.linalg.solve(mass + jacobian.T @ np.diag(1 / compliance) @ jacobian, mass @ np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(found.qd, expected, rtol=1e-10)
    many = scene.loops.project(np.stack([q, q]), compliance=np.stack([compliance, 10 * compliance]))
    assert np.array_equal(many.q[0], found.q) and np.max(np.abs(scene.loops.error(many.q[1]))) > np.max(
        np.abs(scene.loops.error(found.q))
    )
    for options, message in (
        ({"compliance": -1.0}, "zero or above"),
        ({"compliance": np.nan}, "finite"),
        ({"compliance": np.ones(3)}, "5"),
    ):
        with pytest.raises((ArgumentError, phipsi.errors.ShapeError, phipsi.errors.NotFiniteError), match=message):
            scene.loops.project(q, **options)
        with pytest.raises((ArgumentError, phipsi.errors.ShapeError, phipsi.errors.NotFiniteError), match=message):
            scene.simulate(q, np.zeros(3), dt=1e-3, steps=1, **options)


@pytest.mark.parametrize("tolerance", [-1e-6, 0.2, np.nan, np.inf])
def test_broken_tolerances_are_refused(tolerance: float) -> None:
    builder, _, _ = four_bar(0.0)
    assert builder.build(tolerance=0.1).loops.tolerance == 0.1
    with pytest.raises(SceneError, match="tolerance"):
        builder.build(tolerance=tolerance)


def test_singular_positions_keep_their_lower_rank() -> None:
    """An exact parallelogram, stretched: three of four constraints are independent there only up to the accuracy of the
    position.
    """
    builder = phipsi.SceneBuilder().link("ground")
    for name, parent, xyz in (("crank", "ground", (0, 0, 0)), ("bar", "crank", (0, 0, 0.2)), ("rocker", "ground", (0.3, 0, 0))):
        builder.link(name, mass=1.0, com=(0, 0, 0.1), inertia=ROD).joint(name, "continuous", parent, name, xyz=xyz, axis=(0, 1, 0))
    scene = builder.connect("pin", "point", "bar", "rocker", xyz=(0.3, 0, 0), other_xyz=(0, 0, 0.2)).build()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for away in (1e-7, 1e-6, 1e-5, 1e-3, 0.1):
            angle = np.pi / 2 - away
            found = scene.loops.project([angle, -angle, angle], [1.0, -1.0, 1.0])
            assert found.rank == 2 or away < 1e-6
            assert np.allclose(found.qd, [1.0, -1.0, 1.0], atol=1e-6)


@pytest.mark.parametrize("call", ["loops.dynamics", "loops.project", "simulate", "simulator"])
def test_compliance_needs_connections(call: str) -> None:
    scene = phipsi.scenes.chain(2)
    given: dict[str, dict[str, object]] = {
        "loops.dynamics": {"qd": np.zeros(2), "tau": np.zeros(2)}, "loops.project": {}, "simulate": {"qd": np.zeros(2), "dt": 1e-3, "steps": 1}, "simulator": {"dt": 1e-3},
    }  # fmt: skip
    with pytest.raises(phipsi.errors.ArgumentError, match="compliance: found a value for a scene without connections"):
        attrgetter(call)(scene)(np.zeros(2), **given[call], compliance=1e-3)
