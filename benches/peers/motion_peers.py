"""Compare simulation steps with those of MuJoCo and of a loop over Pinocchio, for a chain of seven links, on this
machine.

Usage: .venv-peers/bin/python benches/peers/motion_peers.py [--passes N] [--seconds S] [--states N]

One process, interleaved, in an order that rotates with every pass. Four parts:

    steps     one core. phipsi: a batch, 20 steps per call with the last row recorded, and one step per call. MuJoCo:
    one state in a loop in C, mj_step(nstep=2000) or mujoco.rollout of 2000 steps, whichever is faster. Pinocchio: a
    Python loop over pin.aba.
    rollouts  two cores. 200 steps of every state in one call, every step recorded, compared with mujoco.rollout with
    two threads, into new or given arrays, whichever is faster.
    one       one core, UR5: one state, one torque and one step per call from Python, as in a controller:
    simulator.step(tau) compared with mj_step.
    MPPI      python/phipsi/examples/mppi.py unchanged, on all cores: states per second, including all other work.

Contacts and all constraints are disabled. Before the timing, one step of every integrator must agree to 1e-9 between
the libraries, or with the step from its definition by dense algebra if the two treat springs differently; the same
holds for all rows of the rollouts, and for 100 steps of UR5. Otherwise nothing is reported. Prints tables, writes
target/peers/motion.json.
"""

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NoReturn

import mujoco
import mujoco.rollout
import numpy as np
import phipsi
import pinocchio as pin
from compare import ROOT, Spread, describe_machine, write_report
from contestants import mujoco_model, pinocchio_model
from problems import BATCH_STATES, ONE_STATES, Array, Problem, problem
from python_peers import Timed, nanoseconds, turns, versions

MODEL = "chain_7"
DT = 1e-3  # s
STEPS, ROLLOUT, LOOP = 20, 200, 2000
#: Joint properties, if any: N m/rad, N m s/rad.
STIFFNESS, DAMPING = 10.0, 0.1
#: Number of states whose step is compared, and number of states of the loop over Pinocchio.
COMPARED, FEW = 256, 64
#: Tolerance relative to the largest acceleration (step) or the largest coordinate (rollout).
AGREEMENT = 1e-9
#: Issue 6: speedup of a step and of a rollout; states per second of MPPI.
AIM_STEP, AIM_ROLLOUT, AIM_MPPI = 20.0, 15.0, 1e5
#: Issue 32: at most 2 us per step of simulator, where mj_step takes 2.6.
AIM_ONE = 1.3
ROBOT = "ur5"
FORMS = ("covariance", "auto")
MANY = f"simulate, {STEPS} steps a call"
#: Methods of phipsi and the corresponding ones of MuJoCo, which has none for the last two.
BESIDE = {
    "semi-implicit-euler": "Euler",
    "implicit-euler": "implicitfast",
    "rk4": "RK4",
    "rosenbrock-2": "RK4",
    "rosenbrock-3": "RK4",
}
INTEGRATORS = {
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
}
FORCES = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)


@dataclass
class Contestant(Timed):
    """One call that makes steps; `states` is the product of states and steps."""

    key: tuple[str, ...] = ()
    """Key of comparable calls: part, MuJoCo's integrator, and joint properties."""
    method: str = ""
    form: str = ""
    aim: float | None = None


def fail(message: str) -> NoReturn:
    sys.exit(f"motion_peers.py: {message}")


def contestant(
    library: str,
    call: str,
    key: tuple[str, ...],
    states: int,
    loop: Callable[[], Any],
    threads: int = 1,
    model: str = MODEL,
    **more: Any,
) -> Contestant:
    """Warm up, with the number of threads set before the timing."""

    def measure(seconds: float) -> float:
        phipsi.set_num_threads(threads)
        return nanoseconds(loop, states, seconds)

    loop()
    return Contestant(model, key[0], library, call, states, measure, key=key, **more)


# The same motion in every library


def joints(springs: bool) -> dict[str, float]:
    """Options of Scene.simulate."""
    return {"stiffness": STIFFNESS, "damping": DAMPING} if springs else {}


def mujoco_of(model: Problem, integrator: str, springs: bool) -> Any:
    """Its model; raises if the joints are not in phipsi's order."""
    made, at = mujoco_model(model)
    if model.floating or not np.array_equal(at.at, np.arange(model.scene.nv)):
        fail(f"{model.name}: MuJoCo's joints are in another order")
    made.opt.integrator, made.opt.timestep = INTEGRATORS[integrator], DT
    if springs:
        made.jnt_stiffness[:], made.dof_damping[:] = STIFFNESS, DAMPING
        made.qpos_spring[:] = model.scene.neutral()
    return made


def full_states(q: Array, qd: Array) -> Array:
    """States in the layout of mujoco.rollout: time, positions, velocities."""
    return np.hstack([np.zeros((len(q), 1)), q, qd])


class Pinocchio:
    """Integrators with pin.aba, one state at a time, as in user code."""

    def __init__(self, model: Problem, springs: bool) -> None:
        self.model, at = pinocchio_model(model)
        if not np.array_equal(at.at, np.arange(self.model.nv)):
            fail(f"{model.name}: Pinocchio's joints are in another order")
        self.data, self.none = self.model.createData(), np.zeros(self.model.nv)
        self.springs = springs
        if springs:  # the implicit step adds a diagonal to M, like armature
            self.model.armature[:] = DT * DAMPING + DT**2 * STIFFNESS

    def step(self, method: str, q: Array, v: Array) -> tuple[Array, Array]:
        if method == "rk4":
            return self.runge_kutta(q, v)
        tau = -DAMPING * v - STIFFNESS * (q + DT * v) if self.springs else self.none
        v = v + DT * pin.aba(self.model, self.data, q, v, tau)
        return q + DT * v, v

    def runge_kutta(self, q: Array, v: Array) -> tuple[Array, Array]:
        def rate(q: Array, v: Array) -> tuple[Array, Array]:
            return v, pin.aba(self.model, self.data, q, v, self.none).copy()

        v1, a1 = rate(q, v)
        v2, a2 = rate(q + 0.5 * DT * v1, v + 0.5 * DT * a1)
        v3, a3 = rate(q + 0.5 * DT * v2, v + 0.5 * DT * a2)
        v4, a4 = rate(q + DT * v3, v + DT * a3)
        return q + DT / 6 * (v1 + 2 * v2 + 2 * v3 + v4), v + DT / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def dense_step(model: Problem, springs: bool, *, springs_at_end: bool) -> tuple[Array, Array]:
    """An Euler step by its definition. MuJoCo's implicitfast evaluates damping at the end of the step and
    springs at its start; phipsi evaluates both at the end.
    """
    scene, q, v = model.scene, model.q[:COMPARED], model.qd[:COMPARED]
    k, d = (STIFFNESS, DAMPING) if springs else (0.0, 0.0)
    ahead = DT if springs_at_end else 0.0
    matrix = scene.mass_matrix(q) + (DT * d + DT * ahead * k) * np.eye(scene.nv)
    force = -scene.bias_torque(q, v) - d * v - k * (q - scene.neutral() + ahead * v)
    after = v + DT * np.linalg.solve(matrix, force[..., None])[..., 0]
    return q + DT * after, after


# Agreement


def off(found: tuple[Array, Array], expected: tuple[Array, Array], start: tuple[Array, Array]) -> float:
    """Largest difference relative to the largest change of a step, separately for positions and velocities."""
    return max(
        float(np.max(np.abs(a - b)) / np.max(np.abs(b - c))) for a, b, c in zip(found, expected, start, strict=True)
    )


def our_step(model: Problem, method: str, form: str, springs: bool) -> tuple[Array, Array]:
    path = model.scene.simulate(
        model.q[:COMPARED], model.qd[:COMPARED], dt=DT, steps=1, method=method, form=form, **joints(springs)
    )
    return path.q[:, -1], path.qd[:, -1]


def mujoco_step(model: Problem, integrator: str, springs: bool) -> tuple[Array, Array]:
    made = mujoco_of(model, integrator, springs)
    full = full_states(model.q[:COMPARED], model.qd[:COMPARED])
    with mujoco.rollout.Rollout(nthread=0) as pool:
        rows, _ = pool.rollout(made, mujoco.MjData(made), full, nstep=1)
    return rows[:, -1, 1 : 1 + made.nq], rows[:, -1, 1 + made.nq :]


def pinocchio_step(model: Problem, method: str, springs: bool) -> tuple[Array, Array]:
    peer = Pinocchio(model, springs)
    after = [peer.step(method, model.q[i], model.qd[i]) for i in range(COMPARED)]
    return np.array([q for q, _ in after]), np.array([v for _, v in after])


def agreement(model: Problem) -> dict[str, float]:
    """Compare the step of every integrator with that of MuJoCo or with dense algebra; exit if two differ."""
    start = model.q[:COMPARED], model.qd[:COMPARED]
    found: dict[str, float] = {}
    reference = mujoco_step(model, "RK4", False)
    for springs in (False, True):
        with_them = ", springs" if springs else ""
        ours, theirs = (dense_step(model, springs, springs_at_end=at_end) for at_end in (True, False))
        for integrator in ("implicitfast",) if springs else ("Euler", "implicitfast"):
            found[f"MuJoCo, {integrator}{with_them}"] = off(mujoco_step(model, integrator, springs), theirs, start)
        for method in ("implicit-euler",) if springs else ("implicit-euler", "semi-implicit-euler"):
            for form in FORMS:
                name = f"phipsi, {method}, {form}{with_them}"
                found[name] = off(our_step(model, method, form, springs), ours, start)
        found[f"Pinocchio, Euler{with_them}"] = off(pinocchio_step(model, "euler", springs), ours, start)
    for form in FORMS:
        found[f"phipsi, rk4, {form}"] = off(our_step(model, "rk4", form, False), reference, start)
    found["Pinocchio, rk4"] = off(pinocchio_step(model, "rk4", False), reference, start)
    for name, error in found.items():
        if not error <= AGREEMENT:
            fail(
                f"{name}: one step is off by {error:.1e} of what it changes, more than {AGREEMENT:g}; nothing is timed"
            )
    # MuJoCo has no such methods: only the agreement of the motion is checked here; tests/motion checks their
    # orders.
    for method in ("rosenbrock-2", "rosenbrock-3"):
        error = off(our_step(model, method, "covariance", False), reference, start)
        if not error <= 1e-3:
            fail(f"phipsi, {method}: one step is off from RK4's by {error:.1e}; nothing is timed")
    return found


def rows_agree(model: Problem, ours: phipsi.Trajectory, theirs: Array, call: str) -> float:
    """All rows of a rollout."""
    nq = model.scene.nq
    pairs = ((ours.q[:, 1:], theirs[..., 1 : 1 + nq]), (ours.qd[:, 1:], theirs[..., 1 + nq :]))
    error = max(float(np.max(np.abs(a - b)) / np.max(np.abs(b))) for a, b in pairs)
    if not error <= AGREEMENT:
        fail(f"{call}: a row of the rollout is off by {error:.1e}, more than {AGREEMENT:g}; nothing is timed")
    return error


# The contestants


def steps(model: Problem) -> Iterator[Contestant]:
    """One core."""
    cases = [(method, False) for method in BESIDE] + [("implicit-euler", True)]
    for method, springs in cases:
        key = ("steps", BESIDE[method], "springs" if springs else "")
        for count in (STEPS, 1):
            for form in FORMS:
                options = {"dt": DT, "steps": count, "record_every": count, "method": method, "form": form} | joints(
                    springs
                )

                def simulate(options: dict[str, Any] = options) -> Any:
                    return model.scene.simulate(model.q, model.qd, **options)

                aim = AIM_STEP if count > 1 and not method.startswith("rosenbrock") else None
                call, work = MANY if count > 1 else "simulate, 1 step a call", len(model) * count
                yield contestant("phipsi", call, key, work, simulate, method=method, form=form, aim=aim)
        if method.startswith("rosenbrock"):
            continue
        yield from mujoco_steps(model, key, springs)
        peer = Pinocchio(model, springs)

        def loop(peer: Pinocchio = peer, method: str = method) -> None:
            for state in range(FEW):
                peer.step(method, model.q[state], model.qd[state])

        yield contestant("Pinocchio", "Python loop over pin.aba", key, FEW, loop)


def mujoco_steps(model: Problem, key: tuple[str, ...], springs: bool) -> Iterator[Contestant]:
    """Cost without Python: a loop in C over one state, by two functions."""
    made = mujoco_of(model, key[1], springs)
    full = full_states(model.q[:1], model.qd[:1])
    data, other = mujoco.MjData(made), mujoco.MjData(made)
    pool = mujoco.rollout.Rollout(nthread=0)
    rows, sensors = np.empty((1, LOOP, full.shape[1])), np.empty((1, LOOP, 0))

    def stepped() -> None:
        mujoco.mj_setState(made, data, full[0], int(mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_step(made, data, nstep=LOOP)

    def rolled() -> None:
        pool.rollout(made, other, full, nstep=LOOP, state=rows, sensordata=sensors)

    yield contestant("MuJoCo", f"mj_step(nstep={LOOP})", key, LOOP, stepped)
    yield contestant("MuJoCo", f"mujoco.rollout, {LOOP} steps", key, LOOP, rolled)
    if not np.array_equal(np.concatenate([data.qpos, data.qvel]), rows[0, -1, 1:]):
        fail(f"MuJoCo, {key[1]}: its two loops end in different states; nothing is timed")


def rollouts(model: Problem, found: dict[str, float]) -> Iterator[Contestant]:
    """Two cores; each case with MuJoCo's call first, whose rows ours must equal."""
    torques = np.random.default_rng(2).uniform(-1.0, 1.0, (len(model), ROLLOUT, model.scene.nv))
    work = len(model) * ROLLOUT
    full = full_states(model.q, model.qd)
    rows, sensors = np.empty((len(model), ROLLOUT, full.shape[1])), np.empty((len(model), ROLLOUT, 0))
    pool = mujoco.rollout.Rollout(nthread=2)
    cases = (("semi-implicit-euler", ""), ("semi-implicit-euler", "a torque a step"), ("implicit-euler", "springs"))
    for method, what in cases:
        key = ("rollouts", BESIDE[method], what)
        springs, driven = what == "springs", what == "a torque a step"
        made = mujoco_of(model, key[1], springs)
        data = [mujoco.MjData(made) for _ in range(2)]
        control = (torques,) if driven else ()
        forces = {"control_spec": FORCES} if driven else {"nstep": ROLLOUT}
        for into, arrays in (("new arrays", {}), ("given arrays", {"state": rows, "sensordata": sensors})):

            def rolled(
                made: Any = made, data: Any = data, control: Any = control, options: Any = forces | arrays
            ) -> Any:
                return pool.rollout(made, data, full, *control, **options)

            yield contestant("MuJoCo", f"mujoco.rollout, 2 threads, {into}", key, work, rolled)
        for every in (1, ROLLOUT):
            for form in FORMS:
                options = {"dt": DT, "steps": ROLLOUT, "record_every": every, "method": method, "form": form}
                options |= joints(springs) | ({"tau_steps": torques} if driven else {})

                def simulate(options: dict[str, Any] = options) -> Any:
                    return model.scene.simulate(model.q, model.qd, **options)

                call = "simulate, 2 threads, " + ("every step recorded" if every == 1 else "the last row only")
                if every == 1 and not springs:
                    name = f"rollout, {method}, {form}" + (f", {what}" if what else "")
                    found[name] = rows_agree(model, simulate(), rows, f"{call}, {form}")
                aim = AIM_ROLLOUT if every == 1 else None
                yield contestant("phipsi", call, key, work, simulate, 2, method=method, form=form, aim=aim)


def one_by_one(model: Problem, found: dict[str, float]) -> Iterator[Contestant]:
    """One state, one torque and one step per call."""
    made = mujoco_of(model, "Euler", False)
    data, start = mujoco.MjData(made), full_states(model.q[:1], model.qd[:1])[0]
    torques = list(model.tau)

    def mujoco_steps(count: int = LOOP) -> Array:
        mujoco.mj_setState(made, data, start, int(mujoco.mjtState.mjSTATE_FULLPHYSICS))
        for step in range(count):
            data.qfrc_applied = torques[step % len(torques)]
            mujoco.mj_step(made, data)
        return np.concatenate([data.qpos, data.qvel])

    key = ("one", "Euler", "")
    expected = mujoco_steps(100)
    for form in FORMS:
        simulator = model.scene.simulator(model.q[0], model.qd[0], dt=DT, method="semi-implicit-euler", form=form)

        def our_steps(count: int = LOOP, simulator: phipsi.Simulator = simulator) -> Array:
            simulator.reset(model.q[0], model.qd[0])
            for step in range(count):
                simulator.step(torques[step % len(torques)])
            return np.concatenate([simulator.q, simulator.qd])

        name = f"{model.name}, 100 steps of simulator, {form}"
        found[name] = float(np.max(np.abs(our_steps(100) - expected)) / np.max(np.abs(expected)))
        if not found[name] <= AGREEMENT:
            fail(f"{name}: off by {found[name]:.1e}, more than {AGREEMENT:g}; nothing is timed")
        yield contestant(
            "phipsi", "simulator.step(tau)", key, LOOP, our_steps, model=model.name, method="semi-implicit-euler", form=form, aim=AIM_ONE
        )
    yield contestant("MuJoCo", "qfrc_applied = tau; mj_step", key, LOOP, mujoco_steps, model=model.name)


def mppi(runs: int, cycles: int) -> dict[str, Any]:
    """States per second, as printed by the example, with the default number of threads."""
    command = [sys.executable, "python/phipsi/examples/mppi.py", "--cycles", str(cycles)]
    environment = {name: value for name, value in os.environ.items() if name != "RAYON_NUM_THREADS"}
    rates = []
    for _ in range(runs):
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        rate = re.search(r"(\d+) thousand states per second", done.stdout)
        if done.returncode or not rate:
            fail(f"python/phipsi/examples/mppi.py: {done.stderr.strip() or 'found no rate in its output'}")
        rates.append(1e3 * float(rate[1]))
    return {"command": " ".join(["python", *command[1:]]), "states_a_second": asdict(Spread.of(rates)), "aim": AIM_MPPI}


# Results


def row_of(one: Contestant) -> dict[str, Any]:
    part, integrator, what = one.key
    method = one.method or integrator
    return {
        "part": part, "model": one.model, "library": one.library, "call": one.call, "method": method, "form": one.form,
        "joints": what, "states": one.states, "ns": asdict(Spread.of(one.ns)),
    }  # fmt: skip


def pairs_of(timed: Sequence[Contestant]) -> list[dict[str, Any]]:
    """Each call of phipsi compared with the fastest one of each library; the ratio is computed within a pass."""
    pairs = []
    for ours in timed:
        if ours.library != "phipsi":
            continue
        peers = [one for one in timed if one.key == ours.key and one.library != "phipsi"]
        for library in dict.fromkeys(one.library for one in peers):
            calls = [one for one in peers if one.library == library]
            # With a Python loop, only one of our calls with the same method is compared.
            if library == "Pinocchio" and (ours.call != MANY or ours.method.startswith("rosenbrock")):
                continue
            theirs = min(calls, key=lambda one: Spread.of(one.ns).median)
            ratios = [b / a for a, b in zip(ours.ns, theirs.ns, strict=True)]
            pairs.append(
                {
                    **row_of(ours), "peer": library, "peer_call": theirs.call, "integrator": theirs.key[1],
                    "peer_ns": asdict(Spread.of(theirs.ns)), "ratio": asdict(Spread.of(ratios)),
                    "ratio_of_best": min(theirs.ns) / min(ours.ns),
                    "aim": ours.aim if library == "MuJoCo" else None,
                }
            )  # fmt: skip
    return pairs


def plain(spread: dict[str, Any], digits: int) -> str:
    values = [f"{spread[name]:.{digits}f}" for name in ("median", "min", "max")]
    return f"{values[0]} ({values[1]} to {values[2]})"


def print_table(report: dict[str, Any]) -> None:
    header = ("part", "method", "form", "joints", "call", "ns", "beside", "ns", "ratio", "of the best", "aim")
    cells = [header]
    for pair in report["pairs"]:
        beside = f"{pair['peer']}, {pair['integrator']}: {pair['peer_call']}"
        if pair["peer"] == "Pinocchio":
            beside = f"Pinocchio: {pair['peer_call']}"
        cells.append(
            (
                pair["part"], pair["method"], pair["form"], pair["joints"] or "-", pair["call"], plain(pair["ns"], 0),
                beside, plain(pair["peer_ns"], 0), plain(pair["ratio"], 1), f"{pair['ratio_of_best']:.1f}",
                f"{pair['aim']:g}" if pair["aim"] else "-",
            )
        )  # fmt: skip
    widths = [max(len(line[column]) for line in cells) for column in range(len(header))]
    for line in cells:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())
    print(
        f"\nns per state and step: median (minimum to maximum) of {report['passes']} passes; ratios within a pass, and of the best."
    )
    rate = report["mppi"]["states_a_second"]
    print(f"python/phipsi/examples/mppi.py: {plain(rate, 0)} states per second, aim {AIM_MPPI:g}")
    print(f"agreement: one step, and all rows of rollouts, within {max(report['agreement'].values()):.1e}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--passes", type=int, default=9, help="default: %(default)s")
    parser.add_argument("--seconds", type=float, default=0.1, help="at least, a call and pass; default: %(default)s")
    parser.add_argument("--states", type=int, default=BATCH_STATES, help="of a batch; default: %(default)s")
    options = parser.parse_args()
    if options.passes < 1 or options.seconds < 0 or options.states < COMPARED:
        parser.error(f"--passes must be at least 1, --seconds not negative, --states at least {COMPARED}")

    machine = describe_machine(os.getloadavg()[0]) | {"python": sys.version.split()[0], "versions": versions()}
    model = problem(MODEL, options.states)
    found = agreement(model)
    timed = [*steps(model), *rollouts(model, found), *one_by_one(problem(ROBOT, ONE_STATES), found)]
    # Separate, so that each has its neighbors in time: a pass over the rollouts takes many seconds.
    for part in ("steps", "rollouts", "one"):
        print(f"{part}: {options.passes} passes", file=sys.stderr)
        turns([one for one in timed if one.key[0] == part], options.passes, options.seconds)
    print("mppi", file=sys.stderr)
    report = {
        "machine": machine, "passes": options.passes, "command": sys.argv, "model": MODEL, "dt": DT,
        "states": options.states, "agreement": found, "rows": [row_of(one) for one in timed], "pairs": pairs_of(timed),
        "mppi": mppi(min(options.passes, 5), max(5, min(100, round(1000 * options.seconds)))),
    }  # fmt: skip
    print_table(report)
    write_report("motion.json", report)


if __name__ == "__main__":
    main()
