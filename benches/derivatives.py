"""Time of derivatives and of kinematic quantities from Python, compared with Pinocchio in the same run, as a Markdown page.

Usage: python benches/derivatives.py [--quick] [--markdown FILE]

Needs the packages of the tests (pin, example-robot-data): run it with .venv, after make test. One thread. The calls
of a row are timed in turn.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import complex_step
import exact_jacobian
import numpy as np
import pinocchio as pin

import phipsi
from phipsi.report import kinds
from phipsi.report.timing import in_turns, looped, one_by_one

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "python"))
from oracle_mpmath import State, derivative, exact, moved, random_tree, rounded  # noqa: E402
from oracle_pinocchio import Oracle, load  # noqa: E402

#: File of example-robot-data, and whether it has a floating base.
ROBOTS = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", False),
    "panda": ("panda_description/urdf/panda.urdf", False),
    "g1": ("g1_description/urdf/g1_29dof_rev_1_0.urdf", True),
    "talos": ("talos_data/robots/talos_reduced.urdf", True),
}
BATCH = 256
#: Numbers of links of the chains.
CHAINS = (7, 100, 1000, 10_000, 100_000)

HEAD = """# Time of derivatives

Written by `make derivatives`: calls from Python on one thread, medians of interleaved timings, us per state. Pinocchio is the wheel `pin`; the times of both programs include the call from Python. Pinocchio has no batches and is called in a
loop; calls of phipsi in batches write into an existing array `out`. Times differ between machines, ratios by a few percent. The quantities are described in [derivatives.md](../derivatives.md) and
[products.md](../products.md). The page does not show states with a loss of precision, which form "auto" recomputes in double-double arithmetic.
"""

Call = Callable[[], object]


def medians(calls: dict[str, Call], quick: bool) -> dict[str, float]:
    """Time of one run of each, us, timed in turn."""
    times = in_turns(list(calls.values()), quick)
    return dict(zip(calls, np.median(times, axis=0) / 1000.0, strict=True))


def table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def beside_pinocchio(quick: bool) -> str:
    """Matrices of robots by kind of state."""
    rows = []
    for name, (file, floating) in ROBOTS.items():
        scene, _ = load(file, floating)
        oracle = Oracle(file, floating, scene)
        model, data = oracle.model, oracle.data
        drawn = kinds.draw(scene, BATCH, 0)
        out = np.empty((BATCH, 3, scene.nv, scene.nv))
        for kind in (kinds.RANDOM, kinds.REST, kinds.HELD, kinds.FALLING, kinds.MOVING):
            batch = kinds.state(scene, drawn, kind)
            few = one_by_one(batch)
            theirs = [(oracle.configuration(q), oracle.there(qd), oracle.there(u)) for q, qd, u in few]
            pairs = {
                "dtau": (scene.inverse_dynamics_derivatives, lambda *state: pin.computeRNEADerivatives(model, data, *state)),  # noqa: B023
                "dqdd": (scene.forward_dynamics_derivatives, lambda *state: pin.computeABADerivatives(model, data, *state)),  # noqa: B023
            }
            row = [f"{name}, {kind}"]
            for ours, other in pairs.values():
                found = medians(
                    {
                        "one": looped(ours, few),
                        "pin": looped(other, theirs),
                        "batch": lambda: ours(*batch, out=out),  # noqa: B023
                    },
                    quick,
                )
                one, peer, many = found["one"] / len(few), found["pin"] / len(few), found["batch"] / BATCH
                row += [f"{one:.2f}", f"{many:.2f}", f"{peer:.2f}", f"{peer / one:.1f}", f"{peer / many:.1f}"]
            rows.append(row)
    head = ["", "dtau, one", "batches", "pin", "one", "batches", "dqdd, one", "batches", "pin", "one", "batches"]
    return "Matrices: us per state, and ratio of Pinocchio's time to phipsi's, for one state per call and for batches of " + f"{BATCH}.\n\n{table(head, rows)}"


def for_control(quick: bool) -> str:
    scene, _ = load(*ROBOTS["g1"])
    q, qd, tau = (argument[0] for argument in kinds.state(scene, kinds.draw(scene, 1, 0), kinds.HELD))
    found = medians({"linearize": lambda: scene.linearize(q, qd, tau)}, quick)
    return f"A and B of g1 with a floating base (`scene.linearize`), one state: {found['linearize']:.1f} us."


def products(quick: bool) -> str:
    """Gradients compared with forward dynamics, and the growth of both."""
    scenes = {name: load(*ROBOTS[name])[0] for name in ("g1", "talos")}
    scenes.update({f"chain of {n}": phipsi.scenes.chain(n) for n in CHAINS})
    rows = []
    for name, scene in scenes.items():
        random = np.random.default_rng(1)
        q = scene.integrate(scene.neutral(), random.uniform(-1, 1, scene.nv))
        qd, tau, c = random.uniform(-1, 1, (3, scene.nv))
        calls: dict[str, Call] = {
            "FD": lambda: scene.forward_dynamics(q, qd, tau, form="covariance"),  # noqa: B023
            "vjp": lambda: scene.forward_dynamics_vjp(q, qd, tau, c, form="covariance"),  # noqa: B023
            "FD auto": lambda: scene.forward_dynamics(q, qd, tau),  # noqa: B023
            "vjp auto": lambda: scene.forward_dynamics_vjp(q, qd, tau, c),  # noqa: B023
            "jvp auto": lambda: scene.forward_dynamics_jvp(q, qd, tau, qd, tau, c),  # noqa: B023
        }
        found = medians(calls, quick)
        per_joint = 1000.0 * found["vjp"] / scene.nv
        ratios = [found["vjp"] / found["FD"], found["vjp auto"] / found["FD auto"]]
        rows.append([name, *(f"{found[call]:.2f}" for call in calls), *(f"{ratio:.2f}" for ratio in ratios), f"{per_joint:.0f}"])
    head = ["one state, us", "FD, covariance", "vjp, covariance", "FD, auto", "vjp, auto", "jvp, auto", "vjp / FD, covariance", "auto", "vjp, ns a joint"]
    return "Gradients of c . qdd with respect to q, qd and tau (`forward_dynamics_vjp`), compared with forward dynamics.\n\n" + table(head, rows)


def trajectories(quick: bool) -> str:
    """A simulation and its gradient, for 1024 states of seven joints."""
    scene = phipsi.scenes.chain(7)
    random = np.random.default_rng(1)
    q, tau = random.uniform(-1, 1, (1024, 7)), random.uniform(-1, 1, (1024, 200, 7))
    rows = []
    for method in ("semi-implicit-euler", "rk4", "implicit-euler", "rosenbrock-2", "rosenbrock-3"):
        row = [method]
        for every in (1, 200):
            run = lambda: scene.simulate(q, np.zeros_like(q), tau_steps=tau, dt=1e-3, steps=200, method=method, record_every=every)  # noqa: B023, E731
            path = run()
            cotangent = np.ones_like(path.qd)
            calls: dict[str, Call] = {
                "run": run,
                "back": lambda: path.vjp(cotangent, cotangent),  # noqa: B023
                "inertias": lambda: path.vjp(cotangent, cotangent, parameters=True),  # noqa: B023
            }
            found = {name: time / 1000.0 for name, time in medians(calls, quick).items()}
            row += [f"{found['run']:.0f}", f"{found['back']:.0f}", f"{found['inertias']:.0f}", f"{(found['run'] + found['back']) / found['run']:.1f}"]
        rows.append(row)
    head = ["ms", "run, all rows", "gradient", "inertias too", "both / run", "run, last row", "gradient", "inertias too", "both / run"]
    text = "Gradients of a function of a trajectory (`Trajectory.vjp`) with respect to the initial state, the torques of every step and the joint properties: chain of 7, 1024 states, 200 steps."
    return f"{text}\n\n{table(head, rows)}"


def error_against_time(quick: bool) -> str:
    """dqdd/dq by every method that is available from Python, compared with 60 digits."""
    tree = random_tree(np.random.default_rng(7), 7, kinds=("revolute",), branching=0.0)
    scene, random = tree.scene(), np.random.default_rng(1)
    q, qd, tau = random.uniform(-1, 1, (3, BATCH, scene.nv))
    unit = np.eye(scene.nv)
    first = [exact(values[0]) for values in (q, qd, tau)]
    along = [
        derivative(lambda by: State(tree, moved(tree, first[0], exact(one), by), first[1]).forward_dynamics(first[2], {}))  # noqa: B023
        for one in unit
    ]
    truth = rounded(np.stack(along, axis=-1))

    def differences(q: np.ndarray, qd: np.ndarray, tau: np.ndarray, step: float, central: bool) -> np.ndarray:
        def at(by: float) -> np.ndarray:
            return np.asarray(scene.forward_dynamics(scene.integrate(q[:, None], by * unit), qd[:, None], tau[:, None]))

        behind = at(-step) if central else scene.forward_dynamics(q, qd, tau)[:, None]
        return np.asarray(np.swapaxes(at(step) - behind, -1, -2) / (2 * step if central else step))

    arm = complex_step.Arm(scene)
    eps = float(np.finfo(np.float64).eps)
    ways: dict[str, Callable[..., np.ndarray]] = {
        "analytic, all three matrices": lambda q, qd, tau: scene.forward_dynamics_derivatives(q, qd, tau)[0],
        "columns by `forward_dynamics_jvp`": lambda q, qd, tau: np.swapaxes(
            scene.forward_dynamics_jvp(q[:, None], qd[:, None], tau[:, None], unit, 0 * unit, 0 * unit), -1, -2
        ),
        "rows by `forward_dynamics_vjp`": lambda q, qd, tau: scene.forward_dynamics_vjp(q[:, None], qd[:, None], tau[:, None], unit).q,
        "complex steps (plain NumPy, `benches/complex_step.py`)": arm.by_configuration,
        "central differences": lambda q, qd, tau: differences(q, qd, tau, eps ** (1 / 3), central=True),
        "one-sided differences": lambda q, qd, tau: differences(q, qd, tau, eps**0.5, central=False),
    }
    found = medians({name: lambda way=way: way(q, qd, tau) for name, way in ways.items()}, quick)
    rows = []
    for name, way in ways.items():
        error = np.max(np.abs(way(q[:1], qd[:1], tau[:1])[0] - truth)) / np.max(np.abs(truth))
        rows.append([name, f"{found[name] / BATCH:.2f}", f"{error:.1e}"])
    text = f"Error against time: dqdd/dq of a random arm of seven, batches of {BATCH}; the error is the largest error of an entry relative to the largest entry, for one state, compared with 60 digits (mpmath)."
    return f"{text}\n\n{table(['', 'us per state', 'error'], rows)}"


def in_rosenbrock_steps(_: bool) -> str:
    text = (
        "Rosenbrock steps with the exact Jacobian (`benches/exact_jacobian.py`), which `simulate` does not use: largest error of q and qd of a chain of seven links with springs and dampers"
        f" (N m/rad, N m s/rad) after {exact_jacobian.STEPS} steps. The exact Jacobian needs all derivative matrices and a dense factorization per stage, the other one only forward dynamics."
    )
    return f"{text}\n\n{table(['', 'springs and damping', 'exact'], exact_jacobian.rows())}"


def kinematic_quantities(quick: bool) -> str:
    scene, _ = load(*ROBOTS["ur5"])
    many = kinds.state(scene, kinds.draw(scene, BATCH, 0), kinds.FALLING)
    link = scene.body_names[-1]
    calls: dict[str, Callable[..., object]] = {
        f"placement of {link}": lambda q, qd, tau: scene.placement(q, link),
        f"velocity of {link}": lambda q, qd, tau: scene.velocity(q, qd, link),
        f"Jacobian of {link}": lambda q, qd, tau: scene.jacobian(q, link),
        "rate of that Jacobian": lambda q, qd, tau: scene.jacobian_rate(q, qd, link),
        "gravity torque": lambda q, qd, tau: scene.gravity_torque(q),
        "Coriolis matrix": lambda q, qd, tau: scene.coriolis_matrix(q, qd),
        "center of mass": lambda q, qd, tau: scene.center_of_mass(q),
        "its Jacobian": lambda q, qd, tau: scene.center_of_mass_jacobian(q),
        "centroidal momentum matrix": lambda q, qd, tau: scene.centroidal_momentum_matrix(q),
        "its rate": lambda q, qd, tau: scene.centroidal_momentum_matrix_rate(q, qd),
        "energy": lambda q, qd, tau: scene.energy(q, qd),
    }
    one = tuple(argument[0] for argument in many)
    runs: dict[str, Call] = {f"{name}, {len(state[0].shape)}": lambda call=call, state=state: call(*state) for name, call in calls.items() for state in (one, many)}
    simulator = scene.simulator(one[0], one[1], dt=1e-5)
    runs["step"] = lambda: simulator.step(one[2])
    found = medians(runs, quick)
    rows = [[name, f"{found[f'{name}, 1']:.2f}", f"{found[f'{name}, 2'] / BATCH:.3f}"] for name in calls]
    rows.append(["a step of `simulator`, auto", f"{found['step']:.2f}", ""])
    return f"Kinematic quantities, ur5: one state, and batches of {BATCH}.\n\n" + table(["us per state", "one", "batches"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer turns")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the page, like make derivatives")
    options = parser.parse_args()
    phipsi.set_num_threads(1)
    parts = [part(options.quick) for part in (beside_pinocchio, for_control, error_against_time, products, trajectories, in_rosenbrock_steps, kinematic_quantities)]
    page = "\n\n".join([HEAD.strip(), *parts])
    if options.markdown is None:
        print(page)
    else:
        options.markdown.write_text(f"{page}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
