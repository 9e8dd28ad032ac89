"""Couplings of joints by polynomials, x = P(y): compared with dense equations whose J and gamma are written out, with
differences, with an integration in the independent coordinate, and with MuJoCo.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.polynomial import polynomial
from tolerances import STEP, assert_near, assert_same_bits, central_difference, size, slope_of_order_4

import phipsi
from phipsi import tasks
from phipsi.errors import ArgumentError, ConstraintError, SceneError, ShapeError
from phipsi.estimation import MotionUncertainty

QUARTIC = (0.1, 0.5, -0.8, 0.4, 0.3)
CUBIC = (-0.2, 1.5, 0.7, -0.6)
SQUARE = (0.05, 0.0, 0.9)


class Coupling(NamedTuple):
    """The coordinate of a joint is a polynomial of that of another."""

    joint: str
    other: str
    polynomial: tuple[float, ...]

    def at(self, y: np.ndarray, order: int = 0) -> np.ndarray:
        return polynomial.polyval(y, polynomial.polyder(self.polynomial, order))


class Case(NamedTuple):
    """A scene, its couplings, the same scene without them, and a configuration near which it is closed."""

    scene: phipsi.Scene
    couplings: tuple[Coupling, ...]
    open: phipsi.Scene
    start: np.ndarray

    def rows(self, q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Errors, J and J' qd of the other connections, then of the couplings."""
        error, jacobian, bias = [*self.open.loops.error(q)], [*self.open.loops.jacobian(q)], [*self.open.loops.bias(q, qd)]
        for of in self.couplings:
            x, y = (self.scene.q_index(name).start for name in of[:2])
            first, second = (self.scene.v_index(name).start for name in of[:2])
            row = np.zeros(self.scene.nv)
            row[first], row[second] = 1.0, -of.at(q[y], 1)
            error.append(q[x] - of.at(q[y]))
            jacobian.append(row)
            bias.append(-of.at(q[y], 2) * qd[second] ** 2)
        return np.array(error), np.array(jacobian), np.array(bias)

    def dynamics(self, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, compliance: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations and forces by M qdd + bias = tau + J^T f, J qdd + J' qd = -compliance f, dense."""
        tree = self.scene.without_constraints()
        _, jacobian, bias = self.rows(q, qd)
        nv, m = self.scene.nv, len(bias)
        matrix = np.block([[tree.mass_matrix(q), -jacobian.T], [jacobian, compliance * np.eye(m)]])
        # The hinge between bars in one plane has dependent rows.
        found = np.linalg.lstsq(matrix, np.concatenate([tau - tree.bias_torque(q, qd), -bias]), rcond=1e-12)[0]
        return found[:nv], found[nv:]

    def state(self, seed: int, count: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States that satisfy the connections; the last is at rest if there are several."""
        random = np.random.default_rng(seed)
        nv = self.scene.nv
        q = np.stack([self.scene.integrate(self.start, 0.2 * random.uniform(-1, 1, nv)) for _ in range(count)])
        found = self.scene.loops.project(q, random.uniform(-1, 1, (count, nv)))
        q, qd, tau = found.q, found.qd, random.uniform(-3, 3, (count, nv))
        assert qd is not None
        if count > 1:
            qd[-1] = 0.0
            return q, qd, tau
        return q[0], qd[0], tau[0]


def case(kinds: tuple[tuple[str, int], ...], couplings: tuple[Coupling, ...], floating: bool = False, start: tuple[float, ...] = (), pinned: bool = False) -> Case:
    """A tree of joints, given by their types and the links that carry them (-1: the base)."""
    random = np.random.default_rng(4)
    builder = phipsi.SceneBuilder().link("base", mass=2.0, inertia=np.diag([0.1, 0.2, 0.15]))
    for k, (kind, carrier) in enumerate(kinds):
        com = (0.02, 0.0, 0.1) if pinned else random.uniform(-0.2, 0.2, 3)
        builder.link(f"l{k}", mass=1.0 + 0.3 * k, com=com, inertia=np.diag([0.02, 0.03, 0.025]))
        where = (0.3 * (carrier < 0) * k, 0.0, 0.3) if pinned else random.uniform(-0.4, 0.4, 3)
        axis = {} if kind == "spherical" else {"axis": (0, 1, 0) if pinned else random.uniform(-1, 1, 3)}
        pitch = {"pitch": 0.1} if kind == "screw" else {}
        builder.joint(f"j{k}", kind, "base" if carrier < 0 else f"l{carrier}", f"l{k}", xyz=where, armature=0.01, **axis, **pitch)
    if pinned:
        builder.connect("pin", "point", "l1", "l2", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.35))
    opened = builder.build(floating_base=floating)
    builder = opened.to_builder()
    for i, of in enumerate(couplings):
        builder.couple(f"c{i}", of.joint, of.other, polynomial=of.polynomial)
    scene = builder.build()
    return Case(scene, couplings, opened, scene.neutral() if not start else np.array(start))


HINGE, SLIDE = "continuous", "prismatic"
CASES: dict[str, Callable[[], Case]] = {
    "leader carries": lambda: case(((HINGE, -1), (HINGE, 0), (HINGE, 1)), (Coupling("j2", "j0", QUARTIC),)),
    "follower carries": lambda: case(((HINGE, -1), (HINGE, 0), (HINGE, 1)), (Coupling("j0", "j2", CUBIC),)),
    "branches": lambda: case(
        ((HINGE, -1), (SLIDE, -1), ("spherical", 0), ("screw", 1), (HINGE, 2)),
        (Coupling("j1", "j0", SQUARE), Coupling("j3", "j0", CUBIC)),
    ),
    "floating": lambda: case(
        ((HINGE, -1), (HINGE, 0), (SLIDE, -1), (HINGE, 2)),
        (Coupling("j1", "j0", QUARTIC), Coupling("j3", "j1", SQUARE)),
        floating=True,
    ),
    "loop": lambda: case(
        ((HINGE, -1), (HINGE, 0), (HINGE, -1), (HINGE, -1)), (Coupling("j3", "j0", CUBIC),), start=(0.5, 0.8, 0.2, 0.7), pinned=True
    ),
}


@pytest.fixture(scope="module", params=CASES)
def given(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]()


# Rows and dynamics at one state


def test_rows_are_those_of_the_polynomial(given: Case) -> None:
    scene = given.scene
    q, qd, _ = given.state(0, 6)
    # Rows are defined off the connections too.
    q = scene.integrate(q, np.random.default_rng(3).uniform(-0.3, 0.3, (6, scene.nv)))
    found = scene.loops.error(q), scene.loops.jacobian(q), scene.loops.bias(q, qd)
    for i in range(6):
        for of_batch, expected in zip(found, given.rows(q[i], qd[i]), strict=True):
            assert_near(of_batch[i], expected, 1e-13 * size(expected))
    couplings = slice(-len(given.couplings), None)
    assert_same_bits(scene.loops.jacobian(q[1]), found[1][1])
    assert np.all(np.abs(found[2][:-1, couplings]).max(0) > 1e-2) and not np.any(found[2][-1])


@pytest.mark.parametrize("form", ["auto", "covariance", "square-root"])
def test_accelerations_and_forces_are_those_of_dense_equations(given: Case, form: Any) -> None:
    """A batch is computed by the kernels, one state by the recursion with all checks."""
    q, qd, tau = given.state(1, 9)
    scene, found = given.scene, given.scene.loops.dynamics(q, qd, tau, form=form)
    forces = np.concatenate([*found.forces.values()], axis=-1)
    for i in range(9):
        qdd, of_rows = given.dynamics(q[i], qd[i], tau[i])
        one = scene.loops.dynamics(q[i], qd[i], tau[i], form=form)
        for result in (found.qdd[i], one.qdd, scene.forward_dynamics(q[i], qd[i], tau[i], form=form)):
            assert_near(result, qdd, 1e-11 * size(qdd))
        assert_near(forces[i], of_rows, 1e-10 * size(of_rows))
    still = given.scene.loops.dynamics(q, 0.0 * qd, tau, form=form).qdd
    assert np.abs(still[:-1] - found.qdd[:-1]).max() > 0.1


def test_compliance_and_inverse_dynamics(given: Case) -> None:
    q, qd, tau = given.state(2)
    scene = given.scene
    m = len(scene.loops.error(q))
    found = scene.loops.dynamics(q, qd, tau, compliance=np.full(m, 0.3))
    qdd, forces = given.dynamics(q, qd, tau, 0.3)
    assert_near(found.qdd, qdd, 1e-11 * size(qdd))
    assert_near(np.concatenate([*found.forces.values()]), forces, 1e-11 * size(forces))
    qdd = scene.forward_dynamics(q, qd, tau)
    inverted = scene.loops.inverse_dynamics(q, qd, qdd)
    load = scene.loops.jacobian(q).T @ np.concatenate([*inverted.forces.values()])
    assert_near(inverted.tau + load, scene.without_constraints().inverse_dynamics(q, qd, qdd), 1e-11 * size(load))
    assert_near(scene.forward_dynamics(q, qd, inverted.tau), qdd, 1e-10 * size(qdd))


def test_derivatives_are_differences_of_dense_equations(given: Case) -> None:
    scene = given.scene
    q, qd, tau = given.state(3)
    found = scene.forward_dynamics_derivatives(q, qd, tau)
    for which in range(3):
        columns = []
        for unit in np.eye(scene.nv):

            def moved(h: float, which: int = which, unit: np.ndarray = unit) -> np.ndarray:
                state = [q, qd, tau]
                state[which] = scene.integrate(q, h * unit) if which == 0 else state[which] + h * unit
                return given.dynamics(*state)[0]

            columns.append(slope_of_order_4(moved, 1e-3))
        expected = np.stack(columns, axis=1)
        assert_near(found[which], expected, 1e-8 * size(expected, found[which]))
    random = np.random.default_rng(2)
    dq, dqd, dtau, cotangent = random.uniform(-1.0, 1.0, (4, scene.nv))
    bound = 1e-12 * size(*found) * scene.nv
    along = sum(matrix @ x for matrix, x in zip(found, (dq, dqd, dtau), strict=True))
    assert_near(scene.forward_dynamics_jvp(q, qd, tau, dq, dqd, dtau), along, bound)
    for one, matrix in zip(scene.forward_dynamics_vjp(q, qd, tau, cotangent)[:3], found, strict=True):
        assert_near(one, cotangent @ matrix, bound)
    # A change along y alone changes J and gamma.
    v = scene.v_index(given.couplings[0].other).start
    assert np.abs(found.dqdd_dq[:, v]).max() > 1e-3 and np.abs(found.dqdd_dqd[:, v]).max() > 1e-3


def test_hessian_products_are_differences_of_gradients(given: Case) -> None:
    scene = given.scene
    q, qd, tau = given.state(4)
    dq, dqd, dtau, cotangent = np.random.default_rng(7).uniform(-1.0, 1.0, (4, scene.nv))

    def gradients(h: float) -> np.ndarray:
        return np.concatenate(scene.forward_dynamics_vjp(scene.integrate(q, h * dq), qd + h * dqd, tau + h * dtau, cotangent)[:3])

    found = np.concatenate(scene.forward_dynamics_hvp(q, qd, tau, cotangent, dq, dqd, dtau)[:3])
    expected = (gradients(STEP) - gradients(-STEP)) / (2 * STEP)
    assert_near(found, expected, central_difference(3e3 * size(expected, gradients(0.0))))
    assert np.any(found)


def test_projection_and_inverse_kinematics_close_the_couplings(given: Case) -> None:
    scene = given.scene
    q, qd, _ = given.state(5)
    far = scene.loops.project(scene.integrate(q, np.full(scene.nv, 0.2)), qd)
    assert_near(given.rows(far.q, qd)[0], np.zeros(len(scene.loops.error(q))), 1e-13)
    assert far.qd is not None
    assert_near(given.rows(far.q, qd)[1] @ far.qd, np.zeros(len(scene.loops.error(q))), 1e-12)
    # Bars in one plane have a dependent row.
    assert far.rank == np.linalg.matrix_rank(given.rows(far.q, qd)[1], tol=1e-9)
    link = scene.body_names[-1]
    wanted = scene.placement(q, link)[:3, 3]
    found = scene.inverse_kinematics([tasks.Position(link, target=wanted)], far.q)
    assert_near(given.rows(found.q, qd)[0], 0.0 * scene.loops.error(q), 1e-9)
    assert_near(scene.placement(found.q, link)[:3, 3], wanted, 1e-6)


def test_variances_are_those_of_the_closed_mechanism(given: Case) -> None:
    q, qd, tau = given.state(6)
    scene, torque = given.scene, np.linspace(0.1, 0.5, given.scene.nv)
    found = scene.forward_dynamics_variance(q, qd, tau, torque=torque)
    matrix = scene.loops.mass_matrix_inverse(q)
    expected = np.einsum("ij,j,ij->i", matrix, torque, matrix)
    assert_near(np.asarray(found), expected, 1e-11 * size(expected))


# Motion of two masses


MASSES, GRAVITY = (1.5, 0.7), 9.81


def masses(**limits: float) -> phipsi.Scene:
    """A vertical slide x = P(y) and a horizontal slide y, with a mass each."""
    builder = phipsi.SceneBuilder().link("ground").link("heavy", mass=MASSES[0]).link("light", mass=MASSES[1])
    builder.joint("x", "prismatic", "ground", "heavy", axis=(0, 0, 1), **limits)  # type: ignore[arg-type]
    builder.joint("y", "prismatic", "ground", "light", axis=(1, 0, 0))
    return builder.couple("cam", "x", "y", polynomial=QUARTIC).build()


CAM = Coupling("x", "y", QUARTIC)


def state_at(y: float, v: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([float(CAM.at(np.array(y))), y]), np.array([float(CAM.at(np.array(y), 1)) * v, v])


def integrated(y: float, v: float, t: np.ndarray) -> np.ndarray:
    """(m1 P'^2 + m2) y'' + m1 P' (P'' y'^2 + g) = 0, by DOP853: y and y' at the times."""
    integrate = pytest.importorskip("scipy.integrate")

    def rates(_: float, state: np.ndarray) -> list[float]:
        slope, curvature = CAM.at(state[0], 1), CAM.at(state[0], 2)
        force = -MASSES[0] * slope * (curvature * state[1] ** 2 + GRAVITY)
        return [state[1], force / (MASSES[0] * slope**2 + MASSES[1])]

    return integrate.solve_ivp(rates, (0.0, t[-1]), [y, v], "DOP853", t_eval=t, rtol=1e-13, atol=1e-13).y


@pytest.mark.parametrize(("method", "bound"), [("rk4", 1e-8), ("dormand-prince-5", 1e-10), ("rosenbrock-3", 1e-6), ("auto", 1e-4)])
def test_motion_is_that_of_the_independent_coordinate(method: Any, bound: float) -> None:
    starts = [(0.3, 0.0), (-0.4, 1.0), (1.2, -0.5)]
    q, qd = (np.array(part) for part in zip(*(state_at(*start) for start in starts), strict=True))
    scene = masses()
    path = scene.simulate(q, qd, dt=1e-3, steps=500, method=method)
    drift, lost = np.abs(scene.loops.error(path.q)).max(), np.ptp(sum(scene.energy(path.q, path.qd)), axis=1).max()
    assert drift < 1e-13 and lost < 30 * bound
    for i, start in enumerate(starts):
        y, v = integrated(*start, path.t)
        assert np.ptp(y) > 0.1
        assert_near(path.q[i, :, 1], y, bound)
        assert_near(path.qd[i, :, 0], CAM.at(y, 1) * v, 10 * bound)
    alone = scene.simulate(q[1], qd[1], dt=1e-3, steps=500, method=method)
    assert_same_bits(alone.q, path.q[1])


@pytest.mark.parametrize("method", ["semi-implicit-euler", "rk4", "implicit-euler", "rosenbrock-2", "auto"])
def test_gradients_of_motion_are_differences(method: Any) -> None:
    scene, (y0, v0) = masses(), (0.4, 0.7)
    torque = np.random.default_rng(0).uniform(-2, 2, (12, 2))
    weights = np.random.default_rng(1).uniform(-1, 1, (2, 13, 2))

    def run(y: float = y0, v: float = v0, tau: np.ndarray = torque, damping: float = 0.3) -> Any:
        q, qd = state_at(y, v)
        return scene.simulate(q, qd, dt=0.02, steps=12, tau_steps=tau, method=method, damping=[damping, 0.0])

    def value(**changed: Any) -> float:
        path = run(**changed)
        return float(np.sum(weights[0] * path.q) + np.sum(weights[1] * path.qd))

    found = run().vjp(*weights)
    slope, curvature = float(CAM.at(np.array(y0), 1)), float(CAM.at(np.array(y0), 2))
    bound = 1e-8 * size(*(np.asarray(part) for part in (found.q, found.qd, found.tau, found.damping)))
    assert_near(found.q @ [slope, 1.0] + found.qd @ [curvature * v0, 0.0], slope_of_order_4(lambda h: value(y=y0 + h), 1e-3), bound)
    assert_near(found.qd @ [slope, 1.0], slope_of_order_4(lambda h: value(v=v0 + h), 1e-3), bound)
    along = np.random.default_rng(2).uniform(-1, 1, torque.shape)
    assert_near(np.sum(found.tau * along), slope_of_order_4(lambda h: value(tau=torque + h * along), 1e-3), bound)
    assert_near(found.damping[0], slope_of_order_4(lambda h: value(damping=0.3 + h), 1e-3), bound)


def test_errors_of_the_start_propagate_along_the_coupling() -> None:
    scene, (y0, v0) = masses(), (0.4, 0.7)
    given: dict[str, Any] = {"dt": 0.01, "steps": 20, "method": "rk4"}

    def end(h: float, k: float) -> np.ndarray:
        path = scene.simulate(*state_at(y0 + h, v0 + k), **given)
        return np.concatenate([path.q[-1], path.qd[-1]])

    along = np.stack([slope_of_order_4(lambda h: np.concatenate(state_at(y0 + h, v0)), 1e-3), slope_of_order_4(lambda h: np.concatenate(state_at(y0, v0 + h)), 1e-3)])
    at_end = np.stack([slope_of_order_4(lambda h: end(h, 0.0), 1e-3), slope_of_order_4(lambda h: end(0.0, h), 1e-3)])
    start = MotionUncertainty(initial=along.T @ np.diag([1e-4, 4e-4]) @ along)
    found = scene.simulate(*state_at(y0, v0), **given, covariance=start).bands.covariance[-1]
    expected = at_end.T @ np.diag([1e-4, 4e-4]) @ at_end
    assert_near(found, expected, 1e-8 * float(np.abs(expected).max()))


def test_a_limit_of_the_follower_stops_both() -> None:
    scene = masses(lower=-10.0, upper=0.15)
    # The impact is that of a step, whose velocity differs by the acceleration times dt.
    path = scene.simulate(*state_at(0.0, 2.0), dt=1e-3, steps=100)
    [stop] = path.stops
    assert (stop.joint, stop.limit) == ("x", "upper") and path.q[:, 0].max() < 0.15 + 1e-10
    assert np.abs(scene.loops.error(path.q)).max() < 1e-10
    # At the time at which P(y) is at the limit in the motion without it.
    y, v = integrated(0.0, 2.0, np.array([0.0, stop.time]))[:, -1]
    assert_near(CAM.at(y), 0.15, 1e-4)
    assert_near(stop.speed, CAM.at(y, 1) * v, 1e-2)
    after = np.searchsorted(path.t, stop.time) + 1
    assert np.all(path.qd[after, 0] <= 1e-9)


# Changed, stored and broken scenes


def test_locked_joints_leave_their_coordinates() -> None:
    scene = CASES["branches"]().scene
    q = scene.neutral()
    first, second = (scene.q_index(name).start for name in ("j0", "j1"))
    q[first], q[second] = 0.5, polynomial.polyval(0.5, SQUARE)
    q[scene.q_index("j3")] = polynomial.polyval(0.5, CUBIC)
    leader = scene.lock(["j0"], q)
    assert np.abs(leader.loops.error(np.delete(q, first))).max() < 1e-13
    for name, polynomial_of in (("j1", SQUARE), ("j3", CUBIC)):
        at = leader.v_index(name).start
        row = leader.loops.jacobian(leader.neutral())[["j1", "j3"].index(name)]
        assert np.array_equal(row, np.eye(leader.nv)[at])
        assert_near(-leader.loops.error(leader.neutral())[["j1", "j3"].index(name)], polynomial.polyval(0.5, polynomial_of), 1e-14)
    follower = scene.lock(["j1"], q)
    # From a configuration near the root of P(y) = x.
    near = q.copy()
    near[first] = 0.05
    moved = scene.lock(["j1"], near)
    for locked in (follower, moved):
        assert_near(-locked.loops.error(locked.neutral())[0], 0.5, 1e-12)
    assert len(scene.lock(["j0", "j1"], q).loops.error(scene.lock(["j0", "j1"], q).neutral())) == 1
    below = q.copy()
    below[second] = -1.0
    with pytest.raises(SceneError, match=r'connection "c0": found no coordinate of joint "j0".*scene.loops.project'):
        scene.lock(["j1"], below)
    with pytest.raises(SceneError, match=r'connection "c0": found an error of'):
        scene.lock(["j0", "j1"], below)


def test_copies_have_the_same_couplings() -> None:
    scene = CASES["branches"]().scene
    q, qd, tau = CASES["branches"]().state(9)
    for other in (pickle.loads(pickle.dumps(scene)), scene.to_builder().build(), scene.with_properties(damping=0.1)):
        assert other.loops.names == scene.loops.names
        assert_same_bits(other.forward_dynamics(q, qd, tau), scene.forward_dynamics(q, qd, tau))
    with pytest.raises(ArgumentError, match="connections"):
        scene.to_urdf()


def test_a_linear_polynomial_is_the_multiplier_and_the_offset() -> None:
    chain = phipsi.scenes.chain(3)
    line = chain.to_builder().couple("c", "j2", "j1", polynomial=(0.1, -2.0)).build()
    gear = chain.to_builder().couple("c", "j2", "j1", multiplier=-2.0, offset=0.1).build()
    q = gear.loops.project([0.4, 0.1, 0.2], [1.0, 0.2, 0.3])
    assert_same_bits(line.forward_dynamics(q.q, q.qd, np.ones(3)), gear.forward_dynamics(q.q, q.qd, np.ones(3)))


@pytest.mark.parametrize(
    ("joints", "options", "error", "message"),
    [
        (("j2", "j1"), {"polynomial": ()}, ShapeError, "polynomial of connection \"cam\""),
        (("j2", "j1"), {"polynomial": np.ones(6)}, ShapeError, "k from 1 to 5"),
        (("j2", "j1"), {"polynomial": np.ones((1, 3))}, ShapeError, "k from 1 to 5"),
        (("j2", "j1"), {"polynomial": (0.0, 1.0, np.nan)}, (SceneError, ArgumentError, phipsi.errors.NotFiniteError), "cam"),
        (("j2", "j1"), {"polynomial": (0.0, 1.0), "offset": 0.0}, SceneError, "multiplier or an offset"),
        (("j2", "j1"), {"polynomial": (0.0, 1.0), "multiplier": 1.0}, SceneError, "multiplier or an offset"),
        (("j2",), {"polynomial": (0.0, 1.0)}, SceneError, "without another joint"),
        (("j2", "j2"), {"polynomial": (0.0, 0.0, 1.0)}, SceneError, "itself"),
    ],
)
def test_broken_polynomials_are_refused(joints: tuple[str, ...], options: dict[str, Any], error: Any, message: str) -> None:
    with pytest.raises(error, match=message):
        phipsi.scenes.chain(3).to_builder().couple("cam", *joints, **options).build()


def test_violated_couplings_are_refused(given: Case) -> None:
    scene = given.scene
    q, qd, tau = given.state(10, 6)
    scene.forward_dynamics(q, qd, tau)
    at, v = scene.q_index(given.couplings[0].joint).start, scene.v_index(given.couplings[0].joint).start
    off = (q.copy(), qd.copy())
    off[0][3, at] += 0.01
    off[1][3, v] += 0.01
    for argument, state in (("q", (off[0], qd)), ("qd", (q, off[1]))):
        with pytest.raises(ConstraintError, match=f'"c0" in state 3: found an error of 1.0e-2 .* at {argument}|state 3.*{argument}'):
            scene.forward_dynamics(*state, tau)
        with pytest.raises(ConstraintError, match=f'"c0": found an error of 1.0e-2 .* at {argument}'):
            scene.forward_dynamics(state[0][3], state[1][3], tau[3])


# MuJoCo

MODEL = """<mujoco><option timestep="1e-3"><flag contact="disable"/></option><default><equality solref="2e-5 1" solimp="0.99999 0.99999 0.001"/></default>
<compiler angle="radian"/><worldbody>
<body><joint name="a" axis="0 1 0" ref="0.2"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.2"/>
<body pos="0 0 0.2"><joint name="b" axis="0 1 0" ref="-0.1"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.4"/></body></body>
<body pos="0.3 0 0"><joint name="c" type="slide" axis="0 0 1" ref="0.05"/><geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.3"/></body>
</worldbody><equality>{}</equality></mujoco>"""


def test_couplings_of_mujoco_are_relative_to_its_reference() -> None:
    mujoco = pytest.importorskip("mujoco")
    text = MODEL.format(
        '<joint name="cam" joint1="b" joint2="a" polycoef="0.1 0.5 -0.8 0.4 0.3"/>'
        '<joint joint1="c" polycoef="0.2 5 6 7 8"/><joint joint1="a" joint2="c" polycoef="0 1 1 0 0" active="false"/>'
    )
    scene, model = phipsi.Scene.from_mujoco(text), mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    assert scene.loops.names == ("cam", "equality 1") and np.allclose(model.qpos0, [0.2, -0.1, 0.05])
    data.qpos[:] = [0.7, 0.4, 0.3]
    mujoco.mj_forward(model, data)
    rows = np.zeros((2, 3))
    for j, unit in enumerate(np.eye(3)):
        out = np.zeros(data.nefc)
        mujoco.mj_mulJacVec(model, data, out, unit)
        rows[:, j] = out[:2]
    assert_near(scene.loops.error(data.qpos), data.efc_pos[:2], 1e-14)
    assert_near(scene.loops.jacobian(data.qpos), rows, 1e-14)
    # At rest; MuJoCo neglects J' qd of these rows.
    data.qpos[:] = scene.loops.project(data.qpos).q
    data.qfrc_applied[:] = tau = np.array([0.3, -0.2, 0.1])
    mujoco.mj_forward(model, data)
    found = scene.forward_dynamics(data.qpos, np.zeros(3), tau)
    assert np.allclose(data.qacc, found, rtol=1e-3, atol=1e-3 * np.abs(found).max())
    assert np.abs(scene.without_constraints().forward_dynamics(data.qpos, np.zeros(3), tau) - found).max() > 1.0
