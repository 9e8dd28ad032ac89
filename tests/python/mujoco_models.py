"""MuJoCo models for the tests: typical models of users, and random ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def shipped() -> list[Path]:
    """Robots of Gymnasium, if it is installed."""
    try:
        import gymnasium.envs.mujoco as environments
    except ImportError:
        return []
    return sorted((Path(environments.__file__).parent / "assets").glob("*.xml"))


ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <option gravity="0.3 -0.2 -9.7"/>
  <option><flag contact="disable"/></option>
  <default><default class="rod"><geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.4"/></default></default>
  <worldbody>
    <geom type="plane" size="2 2 0.1"/>
    <body name="shoulder" childclass="rod" pos="0 0.1 0.5" euler="0.2 0.1 -0.4">
      <joint name="yaw" axis="0 0 1" range="-2 2" armature="0.1" damping="0.5" frictionloss="0.2"/>
      <geom/>
      <body name="elbow" pos="0 0 0.4">
        <joint name="pitch" axis="0 1 0.2" pos="0.02 -0.03 0.05" ref="0.3" stiffness="4" springref="0.7"/>
        <joint name="slide" type="slide" axis="1 0 0.5" ref="0.1" range="-0.1 0.2" stiffness="30"/>
        <geom/>
        <body name="tool" pos="0 0 0.4" quat="0.9 0.1 0.3 -0.2">
          <inertial pos="0.01 0.02 0.03" mass="0.7" fullinertia="0.02 0.03 0.025 0.001 -0.002 0.003"/>
          <body name="wrist" pos="0.1 0 0">
            <joint name="roll" axis="1 0 0" pos="0 0.01 0"/>
            <joint name="turn" axis="0 0 1"/>
            <geom/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="yaw" gear="5" forcerange="-3 3" forcelimited="true"/></actuator>
</mujoco>
"""

FLOATING = """
<mujoco>
  <option><flag contact="disable"/></option>
  <default><geom type="box" size="0.1 0.2 0.05" pos="0.02 0.03 -0.01"/></default>
  <worldbody>
    <body name="trunk" pos="1 2 3" euler="30 20 10">
      <freejoint/>
      <geom/>
      <body name="leg" pos="0.2 0 0">
        <joint type="ball" pos="0.01 0.02 0.03" armature="0.02" damping="0.1" stiffness="2"/>
        <geom/>
        <body pos="0 0 -0.3"><joint axis="0 1 0"/><geom size="0.05 0.04 0.2"/></body>
      </body>
      <body name="arm" pos="-0.2 0 0.1"><joint type="slide" axis="0 1 0"/><geom/></body>
    </body>
    <body name="ball" pos="0 0 1"><freejoint/><geom type="sphere" size="0.1" pos="0 0 0"/></body>
    <body name="fixture" pos="0 0 2"><geom/><body pos="0 0 0.3"><joint/><geom/></body></body>
  </worldbody>
</mujoco>
"""


def random_model(seed: int, bodies: int = 8) -> str:
    """A tree with all types of joints, up to three per body, with anchors, references, springs, losses and armature."""
    draw = np.random.default_rng(seed)

    def numbers(size: int, scale: float = 1.0) -> str:
        return " ".join(f"{value:.17g}" for value in scale * draw.standard_normal(size))

    children: list[list[str]] = [[] for _ in range(bodies + 1)]
    for body in range(bodies, 0, -1):
        parent = int(draw.integers(0, body))
        joints = ""
        kind = draw.choice(["ball", "free", "hinges", "none"], p=[0.15, 0.15, 0.6, 0.1])
        if kind == "free" and parent == 0:
            joints = "<freejoint/>"
        elif kind == "ball":
            joints = f'<joint type="ball" pos="{numbers(3, 0.1)}" armature="{draw.uniform(0, 0.1):.17g}" stiffness="{draw.uniform(0, 1):.17g}" damping="0.1"/>'
        elif kind != "none":
            for _ in range(draw.integers(1, 4)):
                of = draw.choice(["hinge", "slide"])
                anchor = f'pos="{numbers(3, 0.1)}"' if draw.random() < 0.5 else ""
                spring = f'stiffness="{draw.uniform(0, 5):.17g}" springref="{draw.uniform(-1, 1):.17g}"' if draw.random() < 0.5 else ""
                losses = f'armature="{draw.uniform(0, 0.2):.17g}" damping="{draw.uniform(0, 1):.17g}"'
                joints += f'<joint type="{of}" axis="{numbers(3)}" ref="{draw.uniform(-1, 1):.17g}" {anchor} {spring} {losses}/>'
        inertia = np.sort(draw.uniform(0.01, 0.02, 3))
        inertial = f'<inertial pos="{numbers(3, 0.1)}" quat="{numbers(4)}" mass="{draw.uniform(0.5, 3):.17g}" diaginertia="{" ".join(map(str, inertia))}"/>'
        # The first child body has the lower number: depth first, as in MuJoCo's numbering.
        text = f'<body name="b{body}" pos="{numbers(3, 0.3)}" quat="{numbers(4)}">{joints}{inertial}{"".join(children[body])}</body>'
        children[parent].insert(0, text)
    return f'<mujoco><compiler angle="radian"/><worldbody>{"".join(children[0])}</worldbody></mujoco>'
