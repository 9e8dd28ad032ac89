"""The Jacobian of Scene.ode: compared with derivatives of the right-hand side from its definitions with 60 digits, and
in implicit methods.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from conftest import random_scene, random_states
from oracle_mpmath import CONTEXT, KINDS, State, Tree, derivative, exact, identity, mpf, of_quaternion, random_tree, rounded, skew, unit, zeros
from tolerances import STEP, assert_near, central_difference, inverse, product, size

import phipsi
from phipsi import _chart
from phipsi.errors import ArgumentError, NotFiniteError, SimulationError

Laws = dict[str, np.ndarray | float]


def turned(q: np.ndarray, w: np.ndarray) -> np.ndarray:
    """The quaternion q times that of the rotation vector w."""
    t = CONTEXT.sqrt(w @ w)
    v, s = (w / t * CONTEXT.sin(t / 2), CONTEXT.cos(t / 2)) if t else (w / 2, mpf(1))
    q = unit(q)
    return np.append(q[3] * v + s * q[:3] + skew(q[:3]) @ v, q[3] * s - q[:3] @ v)


def vector_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Rotation vector from one quaternion to the other, the shorter one."""
    between = turned(b, zeros(3))
    a = unit(a)
    v = a[3] * between[:3] - between[3] * a[:3] - skew(a[:3]) @ between[:3]
    s = a[3] * between[3] + a[:3] @ between[:3]
    v, s = (-v, -s) if s < 0 else (v, s)
    length = CONTEXT.sqrt(v @ v)
    return v / length * (2 * CONTEXT.atan2(length, s)) if length else 2 * v


def rate_of(w: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Time derivative of w for a body with angular velocity u: the solution r of J(w) r = u."""
    t = CONTEXT.sqrt(w @ w)
    if not t:
        return u
    s = skew(w)
    j = identity(3) - s * ((1 - CONTEXT.cos(t)) / t**2) + (s @ s) * ((t - CONTEXT.sin(t)) / t**3)
    return np.array(CONTEXT.lu_solve(CONTEXT.matrix(j.tolist()), CONTEXT.matrix(u.tolist())).T.tolist()[0], dtype=object)


def right_side(tree: Tree, center: np.ndarray, laws: Laws, tau: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """dy/dt for y = (x, v), from the definitions, with 60 digits."""
    center = exact(center)
    given = {name: exact(np.broadcast_to(value, (len(center) if name in ("rest", "target") else tree.nv,))) for name, value in laws.items()}

    def away(rest: np.ndarray, q: np.ndarray) -> np.ndarray:
        found, at_q, at_v = zeros(tree.nv), 0, 0
        for joint in tree.order:
            a, b = rest[at_q : at_q + joint.nq], q[at_q : at_q + joint.nq]
            here = found[at_v : at_v + joint.nv]
            if joint.kind == "floating":
                here[:3] = of_quaternion(b[3:]).T @ (b[:3] - a[:3])
            if joint.kind in ("spherical", "floating"):
                here[-3:] = vector_between(a[-4:], b[-4:])
            else:
                here[:] = b - a
            at_q, at_v = at_q + joint.nq, at_v + joint.nv
        return found

    def f(y: np.ndarray) -> np.ndarray:
        x, v = y[: tree.nv], y[tree.nv :]
        q, rates, at_q, at_v = center.copy(), v.copy(), 0, 0
        for joint in tree.order:
            here, own = q[at_q : at_q + joint.nq], slice(at_v, at_v + joint.nv)
            if joint.kind == "floating":
                here[:3] = here[:3] + of_quaternion(here[3:]) @ x[own][:3]
                rates[own][:3] = of_quaternion(turned(exact([0.0, 0.0, 0.0, 1.0]), x[own][3:])) @ v[own][:3]
            if joint.kind in ("spherical", "floating"):
                here[-4:] = turned(here[-4:], x[own][-3:])
                rates[own][-3:] = rate_of(x[own][-3:], v[own][-3:])
            else:
                here[:] = here + x[own]
            at_q, at_v = at_q + joint.nq, at_v + joint.nv
        u = tau(q, v) - given["damping"] * v - given["stiffness"] * away(given["rest"], q)
        speed = given["friction_speed"]
        u = u - given["friction"] * v / np.array([CONTEXT.sqrt(a * a + b * b) for a, b in zip(v, speed, strict=True)], dtype=object)
        u = u + given["kd"] * (given["target_rate"] - v) - given["kp"] * away(given["target"], q)
        return np.concatenate([rates, State(tree, q, v).forward_dynamics(u, {})])

    return f


def laws_of(scene: phipsi.Scene, random: np.random.Generator) -> Laws:
    """All forces, with arbitrary rest and target."""
    near = [scene.integrate(scene.neutral(), random.uniform(-1.0, 1.0, scene.nv)) for _ in range(2)]
    names = ("damping", "stiffness", "friction", "kp", "kd")
    laws: Laws = {name: random.uniform(0.1, 2.0, scene.nv) for name in names}
    return {**laws, "rest": near[0], "target": near[1], "target_rate": random.normal(size=scene.nv), "friction_speed": 0.5}


def ode_of(scene: phipsi.Scene, laws: Laws, tau: object) -> phipsi.Ode:
    pd = phipsi.PD(laws["kp"], laws["kd"], laws["target"], laws["target_rate"])
    own = {name: laws[name] for name in ("damping", "stiffness", "friction", "rest", "friction_speed")}
    return scene.ode(tau=tau, pd=pd, **own)  # type: ignore[arg-type]


def columns(f: Callable[[np.ndarray], np.ndarray], y: np.ndarray) -> np.ndarray:
    y = exact(y)
    return rounded(np.stack([derivative(lambda by, i=i: f(y + identity(len(y))[i] * by)) for i in range(len(y))], axis=1))  # type: ignore[misc]


@pytest.mark.parametrize("turn", [0.0, 0.02, 0.9], ids=["at the center", "beside it", "turned"])
@pytest.mark.parametrize(
    ("seed", "kinds", "floating_base"),
    [*((k, (kind,), False) for k, kind in enumerate(KINDS) if kind != "fixed"), (20, KINDS, False), (21, KINDS, True)],
    ids=[*(kind for kind in KINDS if kind != "fixed"), "mixed", "on a floating base"],
)
def test_the_jacobian_is_that_at_sixty_digits(seed: int, kinds: tuple[str, ...], floating_base: bool, turn: float) -> None:
    random = np.random.default_rng(seed)
    tree = random_tree(random, 2 if len(kinds) == 1 else 5, kinds=kinds, armature=0.2, floating_base=floating_base)
    scene = tree.scene()
    laws = laws_of(scene, random)
    tau, center = random.normal(size=scene.nv), random_states(scene, seed).q
    ode = ode_of(scene, laws, tau)
    ode.center_at(center)
    y = np.concatenate([turn * random.uniform(-1, 1, scene.nv), random.uniform(-2.0, 2.0, scene.nv)])
    f = right_side(tree, ode.center, laws, lambda q, v: exact(tau))
    condition = float(np.linalg.cond(scene.mass_matrix(ode.configuration(y[: scene.nv]))))
    found, expected = ode.jacobian(0.0, y), columns(f, y)
    value = rounded(f(exact(y)))
    assert_near(ode.rhs(0.0, y), value, inverse(condition, size(value)))
    assert_near(found, expected, inverse(condition, size(expected, value)))
    # Joints on different branches are independent; no other entry is zero and could hide a term.
    assert np.count_nonzero(found[scene.nv :]) > 0.3 * found[scene.nv :].size


def differences(ode: phipsi.Ode, y: np.ndarray) -> np.ndarray:
    return np.stack([(ode.rhs(0.25, y + e) - ode.rhs(0.25, y - e)) / (2 * STEP) for e in STEP * np.eye(len(y))], axis=1)


def test_universal_joints_have_it_too() -> None:
    scene = random_scene(8, 3, kinds=("universal", "revolute"), armature=0.2)
    random = np.random.default_rng(8)
    ode = ode_of(scene, laws_of(scene, random), random.normal(size=scene.nv))
    ode.center_at(random_states(scene, 8).q)
    y = random.uniform(-1.0, 1.0, 2 * scene.nv)
    expected = differences(ode, y)
    assert_near(ode.jacobian(0.25, y), expected, 100 * central_difference(size(expected)))


def test_a_function_for_tau_is_differentiated_by_itself_only() -> None:
    scene = random_scene(4, 5, floating_base=True, armature=0.2)
    laws = laws_of(scene, np.random.default_rng(1))
    gain = np.random.default_rng(2).normal(size=(scene.nv, scene.nv))
    seen = []

    def tau(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        seen.append(t)
        return gain @ v - 3.0 * scene.difference(scene.neutral(), q)

    ode = ode_of(scene, laws, tau)
    ode.center_at(random_states(scene, 5).q)
    y = np.random.default_rng(3).uniform(-0.5, 0.5, 2 * scene.nv)
    found = ode.jacobian(0.25, y)
    assert set(seen) == {0.25} and len(seen) == 1 + 4 * scene.nv
    expected = differences(ode, y)
    assert_near(found, expected, 100 * central_difference(size(expected)))
    alike = ode_of(scene, laws, lambda t, q, v: 0.3)
    assert_near(alike.jacobian(0.0, y), ode_of(scene, laws, np.full(scene.nv, 0.3)).jacobian(0.0, y), 0.0)
    constant = np.random.default_rng(4).normal(size=scene.nv)
    held = ode_of(scene, laws, lambda t, q, v: constant).jacobian(0.0, y)
    assert_near(held, ode_of(scene, laws, constant).jacobian(0.0, y), 0.0)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.0499, 0.0501, 1.0, 3.0, 6.0])
def test_derivatives_of_the_chart_at_any_angle(angle: float) -> None:
    random = np.random.default_rng(7)
    axis, u = random.normal(size=(2, 3))
    w = angle / np.linalg.norm(axis) * axis

    def exponential(w: np.ndarray) -> np.ndarray:
        return of_quaternion(turned(exact([0.0, 0.0, 0.0, 1.0]), w)) @ exact(u)

    # The coordinates are singular at a full turn.
    bound = product(4, size(u)) / (2 * np.pi - angle) ** 2
    rate = columns(lambda w: rate_of(w, exact(u)), w)
    assert_near(_chart.carried_back_derivative(w, u), rate, 30 * bound)
    assert_near(_chart.by_vector_derivative(w, u), columns(exponential, w), bound)
    assert_near(_chart.carried_back_matrix(w) @ u, rounded(rate_of(exact(w), exact(u))), bound)
    assert_near(_chart.tangent(w) @ _chart.carried_back_matrix(w), np.eye(3), bound)


@pytest.mark.parametrize("method", ["Radau", "BDF"])
def test_implicit_methods_take_it_and_ask_less_often(method: str) -> None:
    integrate = pytest.importorskip("scipy.integrate")
    scene = random_scene(6, 2, kinds=("spherical", "revolute"), armature=0.2)
    q, qd, tau = random_states(scene, 1)
    ode = scene.ode(tau=tau, damping=5.0, stiffness=200.0, friction=0.1, friction_speed=0.5)
    ode.center_at(q)
    y = np.concatenate([np.zeros(scene.nv), qd])
    asked: list[float] = []

    def counted(t: float, y: np.ndarray) -> np.ndarray:
        asked.append(t)
        return ode.rhs(t, y)

    options = {"method": method, "rtol": 1e-6, "atol": 1e-8}
    exactly = integrate.solve_ivp(counted, (0.0, 0.05), y, jac=ode.jacobian, **options)
    fewer = len(asked)
    by_differences = integrate.solve_ivp(counted, (0.0, 0.05), y, **options)
    assert by_differences.success and exactly.success
    # SciPy does not count the calls for its differences.
    assert exactly.njev > 0 and fewer + len(y) <= len(asked) - fewer
    assert_near(exactly.y[:, -1], by_differences.y[:, -1], 1e-4 * size(by_differences.y))
    found = ode.solve(q, qd, (0.0, 0.05), method=method, rtol=1e-6, atol=1e-8)
    other = ode.solve(q, qd, (0.0, 0.05), rtol=1e-10, atol=1e-11)
    assert_near(scene.difference(other.q[-1], found.q[-1]), np.zeros(scene.nv), 1e-4)
    assert_near(found.qd[-1], other.qd[-1], 1e-4 * size(other.qd))


STIFF = {"kp": [1e6, 1e6], "kd": [1e4, 1e4], "target": [0.3, -0.2]}


def test_the_steps_of_a_stiff_solution_are_bounded() -> None:
    """Explicit methods follow the fastest gain; the bound raises with the completed rows, and suggests an implicit
    method.
    """
    scene = phipsi.scenes.chain(2)
    ode, start = scene.ode(pd=tuple(STIFF.values())), (scene.neutral(), np.zeros(2))
    reached: list[tuple[float, float]] = []
    with pytest.raises(SimulationError, match=r'^step 50 \(t = 0\.0.*DOP853: found max_steps steps before the end, 10 s; expected method="Radau"') as found:
        ode.solve(*start, (0.0, 10.0), max_steps=50, progress=lambda t, end: reached.append((t, end)))
    assert found.value.step == 50 and len(found.value.trajectory.t) == 51
    assert [t for t, _ in reached] == found.value.trajectory.t[1:].tolist()
    assert {end for _, end in reached} == {10.0}
    path = ode.solve(*start, (0.0, 10.0), method="Radau", max_steps=2000)
    assert_near(path.q[-1], STIFF["target"], 1e-6)
    # The last step may be the one that the bound permits.
    assert ode.solve(*start, (0.0, 10.0), method="Radau", max_steps=path.steps).steps == path.steps


@pytest.mark.parametrize("most", [0, -1, 1.5, True, None])
def test_a_bound_that_is_none_is_refused(most: object) -> None:
    with pytest.raises(ArgumentError, match="max_steps: found .*; expected a whole number, at least 1"):
        phipsi.scenes.chain(2).ode().solve(np.zeros(2), np.zeros(2), (0.0, 1.0), max_steps=most)  # type: ignore[arg-type]


def test_a_trial_step_that_overflows_keeps_the_rows_before() -> None:
    scene = phipsi.scenes.chain(2)
    ode = scene.ode(pd=([1e9, 1e9], [1e7, 1e7], STIFF["target"]))
    with pytest.raises(SimulationError, match="DOP853: forward dynamics .*overflow") as found:
        ode.solve(scene.neutral(), np.zeros(2), (0.0, 10.0))
    assert len(found.value.trajectory.t) == found.value.step + 1
    assert isinstance(found.value.__cause__, NotFiniteError)
