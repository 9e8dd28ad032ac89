"""Time of kinematics from Python, one state per call, compared with Pinocchio in the same run, in docs/measured/benchmarks.md.

Usage: python benches/kinematics.py [--quick] [--page FILE]

Needs the packages of the tests (pin, example-robot-data): run it with .venv, after make test. One thread. The calls of
all quantities of a robot are timed in turn. A quantity is timed only if both programs agree on it. Prints the section
of the page, or replaces it in FILE, including its part of the counts; `make bench` does that too.
"""

import argparse
import importlib.metadata
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import phipsi
from phipsi.report import kinds
from phipsi.report.timing import in_turns, looped, one_by_one

ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT / "benches" / "peers"), str(ROOT / "tests" / "python")]
from compare import PEERS, describe_machine  # noqa: E402
from oracle_pinocchio import SWAP, Oracle, load  # noqa: E402
from robots import FILES  # noqa: E402

#: Largest difference of the results, relative to the largest entry.
AGREEMENT = 1e-10

Array = np.ndarray
#: A quantity: its name, the calls of phipsi and of Pinocchio, and Pinocchio's result in phipsi's conventions.
Pair = tuple[str, Callable[..., Any], str, Callable[..., Any], Callable[[Any], Array]]


def pairs(scene: phipsi.Scene, oracle: Oracle, link: str) -> list[Pair]:
    """The quantities, of q, qd and qdd. Results of Pinocchio that are written to `data` are not converted to arrays."""
    model, data, frame, local = oracle.model, oracle.data, oracle.frame(link), pin.ReferenceFrame.LOCAL
    frames = [oracle.frame(name) for name in scene.link_names]

    def pose(q: Array, qd: Array, qdd: Array) -> Any:
        pin.forwardKinematics(model, data, q)
        return pin.updateFramePlacement(model, data, frame)

    def velocity(q: Array, qd: Array, qdd: Array) -> Any:
        pin.forwardKinematics(model, data, q, qd)
        return pin.getFrameVelocity(model, data, frame, local)

    def velocity_derivatives(q: Array, qd: Array, qdd: Array) -> Any:
        pin.computeForwardKinematicsDerivatives(model, data, q, qd, qdd)
        return pin.getFrameVelocityDerivatives(model, data, frame, local)

    def acceleration_derivatives(q: Array, qd: Array, qdd: Array) -> Any:
        pin.computeForwardKinematicsDerivatives(model, data, q, qd, qdd)
        return pin.getFrameAccelerationDerivatives(model, data, frame, local)

    def hessian(q: Array, qd: Array, qdd: Array) -> Any:
        pin.computeJointKinematicHessians(model, data, q)
        return pin.getFrameKinematicHessian(model, data, frame, local)

    def rows(*matrices: Array) -> Array:
        return np.array([oracle.here(matrix)[SWAP] for matrix in matrices])

    return [
        ("Pose of one link", lambda q, qd, qdd: scene.placement(q, link), "forwardKinematics, updateFramePlacement", pose, lambda found: found.homogeneous),
        ("Poses of all links", lambda q, qd, qdd: scene.poses(q), "framesForwardKinematics", lambda q, qd, qdd: pin.framesForwardKinematics(model, data, q),
         lambda _: np.array([data.oMf[index].homogeneous for index in frames])),
        ("Velocity of one link", lambda q, qd, qdd: scene.velocity(q, qd, link), "forwardKinematics, getFrameVelocity", velocity, lambda found: found.vector[SWAP]),
        ("Jacobian of one link", lambda q, qd, qdd: scene.jacobian(q, link), "computeFrameJacobian",
         lambda q, qd, qdd: pin.computeFrameJacobian(model, data, q, frame, local), lambda found: rows(found)[0]),
        ("Derivatives of its velocity", lambda q, qd, qdd: scene.velocity_derivatives(q, qd, link),
         "computeForwardKinematicsDerivatives, getFrameVelocityDerivatives", velocity_derivatives, lambda found: rows(*found)),
        ("Derivatives of its acceleration", lambda q, qd, qdd: scene.acceleration_derivatives(q, qd, qdd, link),
         "computeForwardKinematicsDerivatives, getFrameAccelerationDerivatives", acceleration_derivatives, lambda found: rows(*found[1:])),
        ("Derivatives of its Jacobian", lambda q, qd, qdd: scene.jacobian_derivatives(q, link), "computeJointKinematicHessians, getFrameKinematicHessian", hessian,
         lambda found: np.ravel(found).reshape(6, model.nv, model.nv, order="F")[np.ix_(SWAP, oracle.v_order, oracle.v_order)]),
    ]  # fmt: skip


def of_robot(name: str, quick: bool) -> list[dict[str, Any]]:
    """Times of the quantities of the link with the most joints between it and the base, ns."""
    scene, _ = load(*FILES[name])
    oracle = Oracle(*FILES[name], scene)
    states = one_by_one(kinds.state(scene, kinds.draw(scene, 16, 0), kinds.RANDOM))
    link = max(scene.link_names, key=lambda link: np.count_nonzero(np.any(scene.jacobian(states[0][0], link), axis=0)))
    theirs = [(oracle.configuration(q), oracle.there(qd), oracle.there(qdd)) for q, qd, qdd in states]
    all_pairs = pairs(scene, oracle, link)
    for what, ours, _, peer, result in all_pairs:
        for state, there in zip(states, theirs, strict=True):
            found, expected = np.asarray(ours(*state)), result(peer(*there))
            error = np.max(np.abs(found - expected)) / np.max(np.abs(expected))
            if not error <= AGREEMENT:
                sys.exit(f"kinematics.py: {name}, {what}: the results differ by {error:.1e} of the largest entry")
    calls = [looped(*call) for _, ours, _, peer, _ in all_pairs for call in ((ours, states), (peer, theirs))]
    times = in_turns(calls, quick) / len(states)
    return [
        {"robot": name, "quantity": what, "peer_call": call, "ours": times[:, 2 * k].tolist(), "peer": times[:, 2 * k + 1].tolist()}
        for k, (what, _, call, _, _) in enumerate(all_pairs)
    ]


def measure(quick: bool) -> dict[str, Any]:
    """All robots, and the machine."""
    phipsi.set_num_threads(1)
    machine = describe_machine(os.getloadavg()[0]) | {
        "instructions": next((name for name in ("avx512vl", "avx2") if name in Path("/proc/cpuinfo").read_text()), "") if Path("/proc/cpuinfo").exists() else "",
        "python": sys.version.split()[0],
        "versions": {name: importlib.metadata.version(name) for name in ("pin", "numpy")},
    }
    rows = [row for name in FILES for row in of_robot(name, quick)]
    return {"machine": machine, "quick": quick, "command": f"benches/kinematics.py{' --quick' if quick else ''}", "rows": rows}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer turns")
    parser.add_argument("--page", type=Path, metavar="FILE", help="replace the section in this page")
    options = parser.parse_args()
    from kinematics_page import section, with_kinematics

    measured = measure(options.quick)
    PEERS.mkdir(parents=True, exist_ok=True)
    (PEERS / "kinematics.json").write_text(json.dumps(measured, indent=1) + "\n")
    if options.page is None:
        print(section(measured))
    else:
        options.page.write_text(with_kinematics(options.page.read_text(encoding="utf-8"), measured), encoding="utf-8")


if __name__ == "__main__":
    main()
