"""Forward dynamics with connections, compared with Pinocchio's constraintDynamics in one run: one state, and a batch.
Products with its derivatives, compared with those of the tree.

Usage: python benches/closed_loops.py [--markdown FILE]; `make closed-loops`.

Both programs have the same robots with the same feet fixed to the ground, and the same states and torques. Pinocchio
is called from Python with one state per call, with proximal settings 1e-10 and at most ten iterations; it has no
batches, so a batch is a loop in Python. Batches of phipsi run on one thread. Times are the minimum of several
interleaved timings. In addition to random states and torques there are robots in static equilibrium and passive
robots at rest.
"""

import argparse
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import phipsi
import phipsi.pinocchio
import pinocchio as pin
from in_turns import least, write
from robots import ROBOTS
#: File, links that are fixed, and kind of the connections.
CASES = {
    "solo12 on four points": ("solo_description/robots/solo12.urdf", ["FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"], "point"),
    "anymal on four points": ("anymal_c_simple_description/urdf/anymal.urdf", ["LF_FOOT", "RF_FOOT", "LH_FOOT", "RH_FOOT"], "point"),
    "g1 on two feet": ("g1_description/urdf/g1_29dof_rev_1_0.urdf", ["left_ankle_roll_link", "right_ankle_roll_link"], "weld"),
    "talos on two feet": ("talos_data/robots/talos_reduced.urdf", ["leg_left_6_link", "leg_right_6_link"], "weld"),
}
STATES, TURNS = 200, 9


def held(file: str, links: list[str], kind: str) -> phipsi.Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        builder = phipsi.Scene.from_urdf(ROBOTS / file, floating_base=True).to_builder()
        for link in links:
            builder.connect(link, kind, link)
        return builder.build()


def states(scene: phipsi.Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    q = scene.integrate(scene.neutral(), random.uniform(-0.05, 0.05, (STATES, scene.nv)))
    found = scene.loops.project(q, random.uniform(-0.2, 0.2, (STATES, scene.nv)))
    return found.q, found.qd, random.uniform(-5.0, 5.0, (STATES, scene.nv))


def held_at_rest(scene: phipsi.Scene, q: np.ndarray) -> np.ndarray:
    """Joint torques, without those of the base, for static equilibrium."""
    still = np.zeros((len(q), scene.nv))
    motors = np.ones(scene.nv, dtype=bool)
    motors[:6] = False
    return scene.loops.inverse_dynamics(q, still, still, actuated=motors).tau


def theirs(scene: phipsi.Scene, file: str, links: list[str], kind: str, at: tuple[np.ndarray, ...]) -> Callable[[int], np.ndarray]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = pin.buildModelFromUrdf(str(ROBOTS / file), pin.JointModelFreeFlyer())
    data = model.createData()
    kinds = {"point": pin.ContactType.CONTACT_3D, "weld": pin.ContactType.CONTACT_6D}
    contacts = pin.StdVec_RigidConstraintModel()
    for link in links:
        frame = model.frames[model.getFrameId(link)]
        there = pin.SE3(scene.placement(scene.neutral(), link))
        contacts.append(pin.RigidConstraintModel(kinds[kind], model, frame.parentJoint, frame.placement, 0, there, pin.ReferenceFrame.LOCAL))
    datas = pin.StdVec_RigidConstraintData()
    for contact in contacts:
        datas.append(contact.createData())
    pin.initConstraintDynamics(model, data, contacts, datas)
    proximal = pin.ProximalSettings(1e-10, 1e-10, 1e-10, 10)
    own = [phipsi.pinocchio.from_state(scene, model, q, qd) for q, qd in zip(at[0], at[1], strict=True)]
    # Torques and accelerations have the order and the frames of the velocities.
    forces = [phipsi.pinocchio.from_state(scene, model, q, tau)[1] for q, tau in zip(at[0], at[2], strict=True)]

    def run(i: int) -> np.ndarray:
        return pin.constraintDynamics(model, data, *own[i], forces[i], contacts, datas, proximal)

    def back(i: int) -> np.ndarray:
        return phipsi.pinocchio.to_state(scene, model, own[i][0], run(i))[1]

    run.back = back  # type: ignore[attr-defined]
    return run


def products() -> list[str]:
    """Times of the products through one rod from the tip of a chain to the world, and of the tree alone."""
    lines = ["| joints | vjp, us | tree, us | ratio | jvp, us | tree, us | ratio | hvp, us | tree, us | ratio |", "| --- " * 10 + "|"]
    for joints in (10, 40, 160):
        tree = phipsi.scenes.chain(joints)
        builder = tree.to_builder()
        builder.connect("rod", "distance", tree.link_names[-1], xyz=(0.0, 0.0, 0.1), other_xyz=(0.3, 0.2, 0.4))
        scene = builder.build()
        random = np.random.default_rng(0)
        q, qd = scene.loops.project(random.uniform(-0.3, 0.3, joints), random.uniform(-0.5, 0.5, joints))[:2]
        tau, *seeds = random.uniform(-1.0, 1.0, (5, joints))
        times = []
        for name, needed in (("vjp", seeds[:1]), ("jvp", seeds[:3]), ("hvp", seeds)):
            calls = [getattr(of, f"forward_dynamics_{name}") for of in (scene, tree)]
            ours, alone = least(TURNS, *(lambda call=call, needed=needed: [call(q, qd, tau, *needed) for _ in range(20)] for call in calls))
            times.append(f"{5e4 * ours:.1f} | {5e4 * alone:.1f} | {ours / alone:.1f}")
        lines.append(f"| {joints} | {' | '.join(times)} |")
        print(lines[-1], flush=True)
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--markdown", type=Path)
    given = parser.parse_args()
    phipsi.set_num_threads(1)
    lines = [
        "| robot | joints, rows | largest difference | one state, us | Pinocchio, us | ratio | in batches, us per state | ratio | static equilibrium | passive | tree alone, us |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, (file, links, kind) in CASES.items():
        scene = held(file, links, kind)
        at = states(scene)
        other = theirs(scene, file, links, kind, at)
        qdd = scene.forward_dynamics(*at)
        apart = max(float(np.max(np.abs(qdd[i] - other.back(i)))) for i in range(20)) / float(np.max(np.abs(qdd)))  # type: ignore[attr-defined]
        tree = scene.without_constraints()
        still = np.zeros_like(at[1])
        rest, limp = (at[0], still, held_at_rest(scene, at[0])), (at[0], still, still)
        one, their, batch, at_rest, fallen, alone = least(
            TURNS,
            lambda scene=scene, at=at: [scene.forward_dynamics(at[0][i], at[1][i], at[2][i]) for i in range(STATES)],
            lambda other=other: [other(i) for i in range(STATES)],
            lambda scene=scene, at=at: scene.forward_dynamics(*at),
            lambda scene=scene, at=rest: scene.forward_dynamics(*at),
            lambda scene=scene, at=limp: scene.forward_dynamics(*at),
            lambda tree=tree, at=at: [tree.forward_dynamics(at[0][i], at[1][i], at[2][i]) for i in range(STATES)],
        )
        one, their, batch, at_rest, fallen, alone = (1e6 * seconds / STATES for seconds in (one, their, batch, at_rest, fallen, alone))
        rows = len(scene.loops.error(at[0][0]))
        lines.append(
            f"| {name} | {scene.nv}, {rows} | {apart:.0e} | {one:.1f} | {their:.1f} | {their / one:.1f} | {batch:.1f} | {their / batch:.1f} | {at_rest:.1f} | {fallen:.1f} | {alone:.1f} |"
        )
        print(lines[-1], flush=True)
    how = "Both programs connect the feet of the same robots to the ground, in the same states. The difference is relative to the largest acceleration. Batches run on one thread."
    write(
        given.markdown,
        "Closed loops: times",
        [
            f"Written by `make closed-loops` (benches/closed_loops.py), on one thread. {how}",
            "Pinocchio is called from Python, with at most ten proximal iterations; it has no batches. `static equilibrium` and `passive` are batches of robots at rest, us per state: with the joint torques of static equilibrium, and with zero torques.",
        ],
        [*lines, "", "Products with the derivatives of forward dynamics through one rod from the tip of a chain to the world, one state per call, compared with the same chain without the rod:", "", *products()],
        "loops between two links, many constraints (the cost m^3 matters above some tens of rows), threads, the square-root form. `tree alone` is forward dynamics of the same robot without its connections.",
    )


if __name__ == "__main__":
    main()
