"""No call panics, hangs or aborts, and a panic would be an error that `except Exception` catches."""

from __future__ import annotations

import copy
import os
import pickle
import re
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import phipsi
from fuzzed_calls import PAIRS, Pair, bar
from phipsi import _core
from phipsi.errors import InternalError, PhipsiError, SimulationError

CALLS = Path(__file__).with_name("fuzzed_calls.py")
DEADLINE = 120
"""Time of one call, s, after which it counts as a call that does not return."""
PLACE = r"src[/\\]python[/\\]panics\.rs:\d+"


def cases(*arguments: str) -> dict[str, str]:
    """Outcomes of the cases of fuzzed_calls.py, by name."""
    found = subprocess.run([sys.executable, CALLS, arguments[0], str(DEADLINE), *arguments[1:]], capture_output=True, text=True, timeout=1800)
    lines = found.stdout.splitlines()
    assert found.returncode == 0, f"{lines[-1:]}\n{found.stderr[-4000:]}"
    faults = [line for line in lines if "FAULT" in line]
    assert not faults, "\n".join(faults)
    return {name.rstrip(":,"): outcome for name, outcome in (line.rsplit(" ", 1) for line in lines)}


def in_process(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process that is ended if it does not return."""
    begin = "import numpy as np, phipsi\nfrom phipsi import _core\nfrom fuzzed_calls import bar\n"
    known = {name: value for name, value in os.environ.items() if name != "RUST_BACKTRACE"}
    given = {**known, "PYTHONPATH": os.pathsep.join(sys.path), **environment}
    return subprocess.run([sys.executable, "-c", begin + code], capture_output=True, text=True, timeout=DEADLINE, env=given, cwd=CALLS.parent)


@pytest.mark.parametrize("first", [0, 10_000, 20_000, 30_000])
def test_random_calls_return_or_raise_an_error_of_phipsi(first: int) -> None:
    found = cases("random", str(first), "250")
    assert len(found) == 250 and sum(outcome == "ok" for outcome in found.values()) > 50
    assert {name.split(": ")[1].split(",")[0] for name in found} >= {"tree", "mimic", "loop", "contact", "loop with contact", "all"}


def test_all_pairs_of_connections_contacts_dead_points_and_overflow_return() -> None:
    found = cases("pairs")
    assert list(found) == [str(pair) for pair in PAIRS]
    # Without numbers that overflow, and away from dead points, a motion is found.
    usual = [str(pair) for pair in PAIRS if not pair.is_dead and not pair.overflow and pair.connection != "weld"]
    assert {found[pair] for pair in usual} == {"ok"}, {pair: found[pair] for pair in usual}
    # Angles of 1e155 rad have no digits left: they close no loop, but can be equal.
    assert {found[str(pair)] for pair in PAIRS if pair.overflow == "q" and pair.connection != "couple"} == {"ConstraintError"}


def test_more_rows_than_degrees_of_freedom_with_a_floor_move_as_without_it() -> None:
    """The linkage of docs/how-to/closed-loops.md above a floor that it does not reach: 5 rows, 3 joints."""

    def builder() -> phipsi.SceneBuilder:
        builder = phipsi.SceneBuilder().link("ground")
        bar(builder, "crank", "ground", (0, 0, 0), 0.2)
        bar(builder, "coupler", "crank", (0, 0, 0.2), 0.4)
        bar(builder, "rocker", "ground", (0.3, 0, 0), 0.3)
        return builder.connect("pin", "axis", "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.3), axis=(0, 1, 0))

    free, above = builder().build(), builder().contact("floor", "coupler", friction=0.5, offset=-1.0).build()
    q, qd, _ = free.loops.project([0.5, 0.8, 0.2], [1.0, 0.0, 0.0])
    paths = [scene.simulate(q, qd, dt=1e-4, steps=200) for scene in (free, above)]
    assert np.abs(paths[0].q[-1] - paths[0].q[0]).max() > 0.01
    assert np.abs(paths[0].q[-1] - paths[1].q[-1]).max() <= 1e-4  # methods of first and higher order
    assert np.abs(above.loops.error(paths[1].q[-1])).max() <= 1e-9


def test_a_rod_near_its_dead_point_in_a_file_with_two_digits_is_no_panic() -> None:
    builder = phipsi.SceneBuilder().link("ground")
    bar(builder, "crank", "ground", (0, 0, 0), 0.2, rpy=(1.57, 0, 0))
    builder.connect("rod", "rod", "crank", xyz=(0, 0, 0.2), other_xyz=(0.002, -0.5, 0))
    scene = builder.build(tolerance=5e-3)
    q, qd, rank = scene.loops.project(scene.neutral(), [0.0])
    assert np.isfinite(scene.forward_dynamics(q, qd, [0.0])).all() and rank in (0, 1)
    assert np.isfinite(scene.loops.mass_matrix_inverse(q)).all()
    assert np.isfinite(scene.simulate(q, qd, dt=1e-3, steps=10).q).all()


@pytest.mark.parametrize("kind", ["point", "axis", "weld", "distance"])
@pytest.mark.parametrize("call", ["forward_dynamics(q, qd, tau)", "loops.project(q, qd)", "simulate(q, qd, dt=1e-3, steps=2)", "loops.mass_matrix_inverse(q)"])
def test_positions_that_overflow_name_the_connection(kind: str, call: str) -> None:
    """A block far away on a slider, connected to the base."""
    found = in_process(f"""
builder = phipsi.SceneBuilder().link("ground")
bar(builder, "block", "ground", (0, 0, 0), 0.2, "prismatic")
bar(builder, "arm", "block", (0, 0, 0.2), 0.2)
length = {{"length": 0.1}} if {kind!r} == "distance" else {{}}
scene = builder.connect("loop", {kind!r}, "arm", xyz=(0.1, 0, 0), **length).build()
q, qd, tau = np.array([1e155, 0.1]), np.zeros(2), np.zeros(2)
try:
    scene.{call}
except phipsi.errors.PhipsiError as error:
    print(type(error).__name__, error)
""")
    assert found.returncode == 0, found.stderr
    assert re.search(r"^(NotFinite|Constraint|Simulation)Error.*(\"loop\"|q|step)", found.stdout), found.stdout


def test_a_stage_that_overflows_ends_the_simulation() -> None:
    """A slider-crank that stiff damping with a large step of explicit methods makes diverge."""
    found = in_process("""
builder = phipsi.SceneBuilder().link("ground")
bar(builder, "crank", "ground", (0, 0, 0), 0.2)
bar(builder, "rod", "crank", (0, 0, 0.2), 0.5)
bar(builder, "slider", "ground", (0, 0, 0), 0.1, "prismatic", axis=(1, 0, 0))
scene = builder.connect("pin", "axis", "rod", "slider", xyz=(0, 0, 0.5), other_xyz=(0, 0, 0), axis=(0, 1, 0)).build()
q, qd, _ = scene.loops.project([0.8, 2.0, 0.3], [3.0, 0.0, 0.0])
count = 0
for damping in (200.0, 500.0, 1e4):
    for dt in (0.01, 0.02, 0.1):
        for method in ("dormand-prince-5", "rk4", "semi-implicit-euler"):
            try:
                assert np.isfinite(scene.simulate(q, qd, dt=dt, steps=200, method=method, damping=damping).q).all()
            except phipsi.errors.SimulationError as error:
                count += bool(str(error)) and np.isfinite(error.trajectory.q).all()
print(count)
""")
    assert found.returncode == 0, found.stderr
    assert int(found.stdout) > 9


@pytest.mark.parametrize("where", ["attached", "detached", "batch"])
def test_a_panic_is_an_internal_error_with_its_place(where: str) -> None:
    code = f"""
phipsi.set_num_threads(4)
for _ in range(2):
    try:
        _core._panic_for_tests({where!r})
    except Exception as error:
        print(type(error) is phipsi.errors.InternalError, isinstance(error, phipsi.errors.PhipsiError), error.place, error)
"""
    found = in_process(code)
    assert found.returncode == 0 and found.stderr == "", found.stderr
    first, second = found.stdout.splitlines()
    assert first == second and re.fullmatch(rf"True True {PLACE}:\d+ internal error: a panic .*{PLACE}:\d+, phipsi .*report it.*", first), first
    assert "panicked at" in in_process(code, RUST_BACKTRACE="1").stderr


def test_panics_of_threads_are_errors_of_their_calls() -> None:
    caught: list[BaseException] = []

    def call(number: int) -> None:
        try:
            _core._panic_for_tests(("attached", "detached")[number % 2])
        except Exception as error:  # noqa: BLE001 - as users do
            caught.append(error)

    threads = [threading.Thread(target=call, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=DEADLINE)
    assert len(caught) == 8 and all(type(error) is InternalError and re.search(PLACE, str(error)) for error in caught)


def test_an_internal_error_is_an_ordinary_exception() -> None:
    with pytest.raises(PhipsiError, match="internal error: a panic") as found:
        _core._panic_for_tests("attached")
    error = found.value
    for again in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert type(again) is InternalError and again.args == error.args and again.place == error.place
    assert "Traceback" not in str(error) and issubclass(InternalError, Exception)


def test_a_panic_in_a_function_of_the_user_is_the_cause_of_the_error_of_the_simulation(arm: phipsi.Scene, capfd: pytest.CaptureFixture[str]) -> None:
    def tau(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        if t > 4.5e-3:
            _core._panic_for_tests("detached")
        return np.zeros(arm.nv)

    with pytest.raises(SimulationError) as found:
        arm.simulate(arm.neutral(), np.zeros(arm.nv), dt=1e-3, steps=20, tau=tau)
    assert isinstance(found.value.__cause__, InternalError) and found.value.step == 5
    assert "resuming a panic" not in capfd.readouterr().err
    # The scene and its scratch memory are usable afterwards.
    assert np.isfinite(arm.simulate(arm.neutral(), np.zeros(arm.nv), dt=1e-3, steps=20).q).all()
