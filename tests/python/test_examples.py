"""The examples run unchanged."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tolerances import assert_same_bits

PAPER = Path(__file__).parents[2] / "python" / "phipsi" / "examples" / "paper.py"
LAST = {"0": 2, "1": 7, "2": 11, "3": 14, "4": 11, "5": 7, "6": 4}
"""The last equation of each section of the paper; 0 is its introduction."""


def test_paper_shows_every_equation() -> None:
    run = subprocess.run([sys.executable, str(PAPER)], capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr
    scenes = run.stdout.split("degrees of freedom")[1:]
    assert len(scenes) == 3
    every = {f"{section}.{i}" for section, last in LAST.items() for i in range(1, last + 1)}
    for scene in scenes:
        shown = set(re.findall(r"^ +(\d\.\d+) +\d\.\de[+-]\d\d  ", scene, flags=re.MULTILINE))
        assert shown == every
        assert scene.count("as printed") >= 15


def test_mppi_brings_the_arm_toward_its_goal() -> None:
    command = [sys.executable, str(PAPER.with_name("mppi.py")), "--samples", "32", "--cycles", "25"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr
    before, after = (float(x) for x in re.findall(r"(\d\.\d+) m from", run.stdout))
    assert after < 0.5 * before
    assert "thousand states per second" in run.stdout


def test_the_rods_stay_on_the_cart() -> None:
    run = subprocess.run([sys.executable, str(PAPER.with_name("balance.py"))], capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr
    angles = [float(x) for x in re.findall(r"starts (\S+) rad", run.stdout)]
    assert len(angles) == 5 and angles[-1] < 0.02 * angles[0]


def test_the_arm_reaches_its_goal_by_gradients() -> None:
    run = subprocess.run([sys.executable, str(PAPER.with_name("reach.py"))], capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr
    off, speed, before, after = (float(x) for x in re.findall(r"(\d\S*) rad from.* at (\S+) rad/s; cost (\S+) -> (\S+)", run.stdout)[0])
    assert off < 5e-3 and speed < 2e-2 and after < 0.01 * before



@pytest.mark.parametrize("name", ["push_block", "push_from_rest", "friction_from_a_slide", "hopper", "inertia_from_a_throw"])
def test_gradients_lead_to_the_goal(name: str, tmp_path: Path) -> None:
    """The examples assert their results; as a script they also write a page, which needs the viewer."""
    command = [sys.executable, "-W", "error", "-c", "import runpy, sys; runpy.run_path(sys.argv[1])", str(PAPER.with_name(f"{name}.py"))]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr
    assert "assert" in PAPER.with_name(f"{name}.py").read_text(encoding="utf-8") and run.stdout and not list(tmp_path.iterdir())


GYM = PAPER.with_name("gymnasium_cart_pole.py")


def test_the_cart_pole_stands_and_falls() -> None:
    pytest.importorskip("gymnasium")
    run = subprocess.run([sys.executable, str(GYM), "--envs", "9", "--actions", "60"], capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr
    one, balancing, other = run.stdout.splitlines()
    assert float(re.findall(r"return (\S+) of 500", one)[0]) > 495 and "9 balancing: mean reward 1.000, 0 fell" in balancing
    assert int(re.findall(r"(\d+) fell", other)[0]) > 0


def test_environments_keep_to_the_rules_of_gymnasium() -> None:
    pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    spec = importlib.util.spec_from_file_location("gymnasium_cart_pole", GYM)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    check_env(module.CartPole(), skip_render_check=True)
    # A batch is as many of them, and restarts those whose episode is over.
    many, one = module.CartPoles(3), module.CartPole()
    state, _ = many.reset(seed=5)
    assert many.observation_space.contains(state)
    push = np.array([[1.0], [0.0], [-1.0]])
    ended = np.zeros(3, dtype=bool)
    one._simulator.reset(state[0, :2], state[0, 2:])
    while not ended.any():
        state, reward, ended, cut, _ = many.step(push)
        alone = one.step(push[0])
        assert_same_bits(state[0], alone[0])
        assert (reward[0], ended[0], cut[0]) == alone[1:4]
    before = state
    state, reward, again, cut, _ = many.step(push)
    assert np.all(np.abs(state[ended]) <= 0.05) and not again[ended].any() and not reward[ended].any()
    assert not np.array_equal(state[~ended], before[~ended])


# In separate processes, because warnings of Dask are ignored there.
SWEEP = [sys.executable, str(PAPER.with_name("sweep.py")), "--starts", "8"]
needs_dask = pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="distributed (Dask) is not installed")
CLUSTER = """
from distributed import LocalCluster

if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        input()
"""


def swept(output: Path, *options: str) -> tuple[dict[str, np.ndarray], str]:
    """Arrays and text of a sweep."""
    run = subprocess.run([*SWEEP, *options, "-o", str(output)], capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr
    assert "42 of 42 tasks" in run.stderr
    with np.load(f"{output}.npz") as arrays:
        return dict(arrays), run.stdout


@pytest.fixture(scope="module")
def direct(tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    """The sweep without Dask."""
    arrays, _ = swept(tmp_path_factory.mktemp("sweep") / "direct", "--workers", "0")
    return arrays


def test_the_sweep_tells_failed_tasks_from_slow_ones(direct: dict[str, np.ndarray]) -> None:
    settling, effort, reasons = direct["settling"], direct["effort"], direct["reasons"]
    failed = reasons != ""
    assert 0 < failed.sum() < failed.size / 2
    assert np.array_equal(np.isnan(settling), failed) and np.array_equal(np.isnan(effort), failed)
    # The stiffest and most damped gains are unstable for a controller of that rate; the softest do not settle in
    # time.
    assert failed[-1, -1] and not failed[0].any()
    assert "motion has diverged" in reasons[-1, -1] and 'joint "joint' in reasons[-1, -1]
    assert np.isinf(settling[0]).all() and np.isfinite(settling).sum() > settling.size / 2
    # As for a second-order system: at the same damping, twice the bandwidth settles faster and needs more torque.
    assert (np.diff(settling[1:5, 2]) < 0).all() and (np.diff(effort[:, 2]) > 0).all()


@needs_dask
@pytest.mark.parametrize("existing", [False, True])
def test_the_sweep_on_two_workers_has_the_same_bits(direct: dict[str, np.ndarray], existing: bool, tmp_path: Path) -> None:
    if not existing:
        arrays, text = swept(tmp_path / "dask", "--workers", "2")
    else:
        script = tmp_path / "cluster.py"
        script.write_text(CLUSTER, encoding="utf-8")
        with subprocess.Popen([sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as cluster:
            assert cluster.stdin is not None and cluster.stdout is not None
            try:
                arrays, text = swept(tmp_path / "dask", "--address", cluster.stdout.readline().strip())
            finally:
                try:
                    cluster.communicate("done\n", timeout=60)
                finally:
                    cluster.kill()
    assert list(arrays) == list(direct)
    for name in ("settling", "effort"):
        assert_same_bits(arrays[name], direct[name])
    assert (arrays["reasons"] == direct["reasons"]).all()
    assert text.count("failed: ") == (direct["reasons"] != "").sum()
