"""A parameter sweep on a cluster: gains for which the bundled arm settles fastest within its torque limits, distributed
with Dask (needs distributed).

    python -m phipsi.examples sweep                                 two worker processes here (pip install distributed)
    python -m phipsi.examples sweep --address tcp://10.0.0.1:8786   workers of an existing cluster with phipsi installed
    python -m phipsi.examples sweep --workers 0                     in this process, without Dask: the same results

Each joint is controlled by a controller that reads its state every DT seconds: kp = m w^2, kd = 2 zeta m w, with m
the diagonal entry of the mass matrix at the goal; gravity torque and friction are compensated. The grid is over
bandwidth w/(2 pi) and damping ratio zeta; a task is one pair, with one call of Scene.simulate for a batch of initial
states. Gains that are too stiff for the rate of the controller diverge: such a task reports the step and the joint,
and the sweep continues. For this reason method and limits are not the defaults: "semi-implicit-euler" evaluates the
control law once per step, like the controller, where the default would treat it implicitly, like a continuous-time
controller; and joint stops would bound the diverging motion.
"""

import argparse
import sys

import numpy as np
import phipsi

DT, STEPS = 0.004, 500  # s
APART, WITHIN = 0.1, 0.005  # rad: distance of the initial states from the goal; all joints within this distance count as settled
BANDWIDTHS = np.geomspace(0.5, 32.0, 7)  # Hz
RATIOS = np.array([0.25, 0.5, 0.7, 1.0, 1.4, 2.0])


def starts_and_goal(scene, count):
    """A configuration within the joint limits, and several around it."""
    goal = scene.limits.lower + 0.6 * (scene.limits.upper - scene.limits.lower)
    return goal + np.random.default_rng(1).uniform(-APART, APART, (count, scene.nv)), goal


def task(scene, starts, goal, bandwidth, ratio):
    """Settling time of the slowest initial state, s, infinite if one does not settle; largest torque relative to the
    limit; reason of a failure, or "".
    """
    phipsi.set_num_threads(1)  # the workers run in parallel
    m, w = np.diagonal(scene.mass_matrix(goal)), 2 * np.pi * bandwidth
    kp, kd = m * w**2, 2 * ratio * m * w
    holding = scene.bias_torque(goal, np.zeros(scene.nv))
    # Near rest the accelerations cancel; form "auto" would recompute such steps with a precision that is not needed
    # here.
    options = {"tau": holding, "pd": phipsi.PD(kp, kd, goal), "friction": 0.0, "form": "covariance"}
    options |= {"method": "semi-implicit-euler", "limits": "report"}
    try:
        path = scene.simulate(starts, np.zeros_like(starts), dt=DT, steps=STEPS, **options)
    except phipsi.errors.SimulationError as error:
        return np.nan, np.nan, str(error)  # as text, because the exception contains its trajectory
    torque = holding + kp * (goal - path.q) - kd * path.qd
    away = np.abs(path.q - goal).max(axis=(0, 2)) > WITHIN
    settled = np.inf if away[-1] else path.t[len(path) - np.argmax(away[::-1])] if away.any() else 0.0
    return settled, np.max(np.abs(torque) / scene.limits.effort), ""


def here(pairs, arguments):
    """Run all tasks without Dask."""
    for index, pair in pairs.items():
        yield index, task(*arguments, *pair)


def on_workers(pairs, arguments, workers, address):
    """Run all tasks with Dask, in the order of completion; scene and arrays are pickled."""
    from distributed import Client, LocalCluster, as_completed

    def fanned_out(client):
        shared = client.scatter(arguments, broadcast=True, hash=False)
        futures = {client.submit(task, *shared, *pair, pure=False): index for index, pair in pairs.items()}
        for future, result in as_completed(futures, with_results=True):
            yield futures[future], result

    if address:
        with Client(address) as client:
            yield from fanned_out(client)
    else:
        with (
            LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            yield from fanned_out(client)


def as_table(settling, effort, reasons):
    lines = ["bandwidth, Hz | damping ratio " + "".join(f"{ratio:>9.2f}" for ratio in RATIOS)]
    for i, bandwidth in enumerate(BANDWIDTHS):
        cells = []
        for j in range(len(RATIOS)):
            time = "never" if np.isinf(settling[i, j]) else f"{settling[i, j]:.3f} s"
            cells.append("failed" if reasons[i, j] else time + ("*" if effort[i, j] > 1 else " "))
        lines.append(f"{bandwidth:13.2f} |               " + "".join(f"{cell:>9}" for cell in cells))
    return "\n".join([*lines, "time until the slowest start has settled; * with more torque than the motors have"])


def draw(path, settling, effort):
    """A heat map, if matplotlib is installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return
    figure = Figure(figsize=(5.6, 3.8), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(np.where(np.isfinite(settling), settling, np.nan), origin="lower", aspect="auto", cmap="viridis_r")
    for i, j in np.ndindex(settling.shape):
        mark = "failed" if np.isnan(settling[i, j]) else "never" if np.isinf(settling[i, j]) else "*" if effort[i, j] > 1 else ""
        axes.text(j, i, mark, ha="center", va="center", fontsize=7)
    axes.set_xticks(range(len(RATIOS)), [f"{ratio:g}" for ratio in RATIOS])
    axes.set_yticks(range(len(BANDWIDTHS)), [f"{bandwidth:g}" for bandwidth in BANDWIDTHS])
    axes.set(xlabel="damping ratio", ylabel="bandwidth, Hz", title="* more torque than the motors have")
    figure.colorbar(image, label="settling time, s")
    figure.savefig(path, dpi=150)
    print(f"written: {path}")


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--workers", type=int, default=2, help="processes; 0: here, without Dask; default: %(default)s")
    arguments.add_argument("--address", help="of a Dask scheduler, instead of processes of our own")
    arguments.add_argument("--starts", type=int, default=64, help="states of each batch; default: %(default)s")
    arguments.add_argument("-o", "--output", help="NAME: NAME.npz, and NAME.png if matplotlib is there")
    options = arguments.parse_args()
    if options.workers < 0 or options.starts < 1:
        arguments.error("--workers must not be negative, --starts at least 1")

    scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    shared = [scene, *starts_and_goal(scene, options.starts)]
    shape = len(BANDWIDTHS), len(RATIOS)
    pairs = {(i, j): (BANDWIDTHS[i], RATIOS[j]) for i, j in np.ndindex(shape)}
    settling, effort, reasons = np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, "", dtype=object)
    direct = options.workers == 0 and not options.address
    results = here(pairs, shared) if direct else on_workers(pairs, shared, options.workers, options.address)
    for done, (index, result) in enumerate(results, start=1):
        settling[index], effort[index], reasons[index] = result
        print(f"\r{done} of {len(pairs)} tasks", end="" if done < len(pairs) else "\n", file=sys.stderr, flush=True)

    print(as_table(settling, effort, reasons))
    for (i, j), reason in np.ndenumerate(reasons):
        if reason:
            print(f"failed: {BANDWIDTHS[i]:g} Hz, ratio {RATIOS[j]:g}: {reason}")
    allowed = np.where(effort <= 1, settling, np.inf)
    i, j = np.unravel_index(np.argmin(allowed), shape)
    if np.isfinite(allowed[i, j]):
        print(f"fastest within the motors' torque: {BANDWIDTHS[i]:g} Hz, damping ratio {RATIOS[j]:g}, {allowed[i, j]:.3f} s")
    else:
        print("no gains settle within the motors' torque")
    if options.output:
        np.savez(
            f"{options.output}.npz",
            bandwidths=BANDWIDTHS,
            ratios=RATIOS,
            settling=settling,
            effort=effort,
            reasons=reasons.astype(str),
        )
        draw(f"{options.output}.png", settling, effort)


if __name__ == "__main__":
    main()
