"""Comparison of two robots: each property is found by name, and equal robots have no difference."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import phipsi
import pytest
from click.testing import CliRunner
from phipsi.report import compare as command  # noqa: F401  # registers the command
from phipsi.report.commands import group

ARM = phipsi.load(phipsi.BUNDLED_ARM)


def altered(old: str, new: str) -> phipsi.Scene:
    assert old in phipsi.BUNDLED_ARM, old
    return phipsi.load(phipsi.BUNDLED_ARM.replace(old, new, 1))


def test_a_robot_is_the_same_as_itself_in_every_form(tmp_path: Path) -> None:
    ARM.to_urdf(tmp_path / "arm.urdf")
    for other in (ARM, phipsi.load(tmp_path / "arm.urdf"), ARM.to_builder().build()):
        found = phipsi.compare(ARM, other)
        assert found.same and found.first is None and str(found) == "no difference"
    # Infinite limits, a free joint.
    free = phipsi.load(phipsi.BUNDLED_ARM, floating_base=True)
    assert phipsi.compare(free, phipsi.load(phipsi.BUNDLED_ARM, floating_base=True)).same


def coupled(slope: float, more: float = 0.0) -> phipsi.Scene:
    return ARM.with_properties(armature=ARM.armature + more).to_builder().couple("gear", "joint4", "joint5", polynomial=(0.1, slope, 0.2)).build()


def test_random_states_are_on_the_connections() -> None:
    """Forward dynamics refuses other states; a robot whose connections differ does not meet them."""
    found = phipsi.compare(coupled(0.5), coupled(0.5))
    assert found.same and found.note == ""
    heavy = coupled(0.5, 0.3)
    found = phipsi.compare(coupled(0.5), heavy)
    assert not found.note and {one.quantity for one in found.dynamics} == {"mass matrix, kg m^2 or kg", "acceleration, rad/s^2 or m/s^2"}
    assert 'connection "gear"' in phipsi.compare(coupled(0.5), coupled(0.6)).note


@pytest.mark.parametrize(
    ("other", "where", "quantity", "has_dynamics"),
    [
        (ARM.with_payload("flange", 0.5, (0, 0, 0.1)), 'link "flange"', "mass, kg", True),
        (ARM.with_properties(armature={"joint2": 5.0}), 'joint "joint2"', "armature, kg m^2 or kg", True),
        (ARM.with_properties(damping={"joint3": 1.0}), 'joint "joint3"', "damping, N m s/rad or N s/m", False),
        (ARM.with_inertias({"link4": (0.82, (0, 0, -0.02), 0.01 * np.eye(3))}), 'link "link4"', "com, m", True),
        (phipsi.load(phipsi.BUNDLED_ARM, gravity=(0, 0, -1.62)), "scene", "gravity, m/s^2", True),
    ],
)  # fmt: skip
def test_the_first_difference_is_named(other: phipsi.Scene, where: str, quantity: str, has_dynamics: bool) -> None:
    found = phipsi.compare(ARM, other)
    assert found.first is not None and (found.first.where, found.first.quantity) == (where, quantity)
    assert bool(found.dynamics) == has_dynamics and not found.poses and not found.locked and not found.note
    assert str(found.first) in str(found) and found.first.relative > 0.0


def test_the_entry_of_the_mass_matrix_is_named() -> None:
    other = ARM.with_payload("flange", 0.5, (0, 0, 0.1))
    found = [difference for difference in phipsi.compare(ARM, other).dynamics if difference.quantity.startswith("mass matrix")]
    assert found
    for difference in found:
        row, column = (re.findall(r'"(\w+)"', difference.where) * 2)[:2]
        # The same states as in compare.
        entries = [ARM.mass_matrix(q)[ARM.v_index(row), ARM.v_index(column)].item() for q in ARM.random_configuration(np.random.default_rng(0), size=16)]
        assert difference.first in entries, (row, column)


def test_a_moved_frame_changes_all_poses_outboard_of_it() -> None:
    builder = phipsi.SceneBuilder().link("base")
    other = phipsi.SceneBuilder().link("base")
    for scene, x in ((builder, 0.3), (other, 0.3 + 1e-6)):
        parent = "base"
        for i in range(3):
            scene.link(f"l{i}", mass=1.0, com=(0.1, 0, 0), inertia=0.01 * np.eye(3)).joint(f"j{i}", "revolute", parent, f"l{i}", xyz=(x if i == 1 else 0.3, 0, 0), axis="y")
            parent = f"l{i}"
    found = phipsi.compare(builder.build(), other.build())
    assert found.first is not None and found.first.where == 'joint "j1"' and found.first.quantity == "xyz, m"
    assert [one.where for one in found.poses] == ['link "l1"', 'link "l2"']
    assert "1e-06 m and 0 rad apart" in found.poses[0].quantity
    assert phipsi.compare(builder.build(), other.build(), tolerance=1e-3).same


def test_joints_in_another_order_have_the_same_dynamics() -> None:
    def tree(names: str) -> phipsi.Scene:
        builder = phipsi.SceneBuilder().link("base")
        for name in names:
            at = "abc".index(name)
            builder.link(name, mass=1.0 + at, com=(0, 0, 0.1 * at + 0.1), inertia=0.02 * np.eye(3))
            builder.joint(f"j{name}", "spherical" if name == "b" else "revolute", "base", name, xyz=(at, 0, 0), **({} if name == "b" else {"axis": "x"}))
        return builder.build(floating_base=True)

    found = phipsi.compare(tree("abc"), tree("cba"))
    assert [one.quantity for one in found.properties] == ["order of the joints in q"]
    assert not found.poses and not found.dynamics


def test_a_joint_of_one_robot_only_is_locked() -> None:
    other = ARM.lock(["joint5"], ARM.neutral())
    found = phipsi.compare(ARM, other)
    assert found.locked == ("joint5",) and found.first is not None and found.first.first == ("joint5",) and found.first.second == ()
    assert not found.poses and not found.dynamics, str(found)


def test_invalid_arguments() -> None:
    with pytest.raises(phipsi.errors.ArgumentError, match="states: found 0; expected a positive integer"):
        phipsi.compare(ARM, ARM, states=0)
    with pytest.raises(phipsi.errors.ArgumentError, match="tolerance: found nan; expected a number between 0 and 1"):
        phipsi.compare(ARM, ARM, tolerance=np.nan)


def test_the_command(tmp_path: Path) -> None:
    ARM.to_urdf(tmp_path / "arm.urdf")
    ARM.with_payload("flange", 0.5, (0, 0, 0.1)).to_urdf(tmp_path / "loaded.urdf")
    run = CliRunner()
    same = run.invoke(group, ["compare", str(tmp_path / "arm.urdf"), str(tmp_path / "arm.urdf")])
    assert same.exit_code == 0 and same.output == "no difference\n"
    differs = run.invoke(group, ["compare", str(tmp_path / "arm.urdf"), str(tmp_path / "loaded.urdf")])
    assert differs.exit_code == 1 and 'link "flange": mass, kg: 0.03 and 0.53' in differs.output
    content = json.loads(run.invoke(group, ["compare", str(tmp_path / "arm.urdf"), str(tmp_path / "loaded.urdf"), "--json"]).stdout)
    assert not content["same"] and content["properties"][0]["first"] == 0.03 and content["dynamics"]
    assert run.invoke(group, ["compare", str(tmp_path / "arm.urdf"), str(tmp_path / "none.urdf")]).exit_code == 2


def test_the_page(tmp_path: Path) -> None:
    pytest.importorskip("jinja2")
    ARM.to_urdf(tmp_path / "arm.urdf")
    ARM.lock(["joint5"], ARM.neutral()).to_urdf(tmp_path / "locked.urdf")
    page = tmp_path / "page.html"
    done = CliRunner().invoke(group, ["compare", str(tmp_path / "arm.urdf"), str(tmp_path / "locked.urdf"), "--report", str(page)])
    assert done.exit_code == 1, done.output
    text = page.read_text(encoding="utf-8")
    assert "arm and locked" in text and "1 joint of one robot only, locked at neutral here and for the dynamics: joint5." in text
    assert "joints of one robot only" in text and "http://" not in re.sub(r"srcdoc=\".*?\"", "", text, flags=re.DOTALL)
    same = phipsi.compare(ARM, ARM).report(tmp_path / "same.html", names=("one", "other"))
    assert "The robots are the same within the tolerance." in same.read_text(encoding="utf-8")
