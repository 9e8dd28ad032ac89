"""Optimal control: the linear-quadratic part against dense least squares with 60 digits, steps against the simulation,
laws against optima from other starts, limits, inequalities, shooting, and the expected cost against sampled runs.
"""

import mpmath as mp
import numpy as np
import pytest

import phipsi
import tolerances
from phipsi import control, estimation, tasks
from phipsi.errors import ArgumentError, ConstraintError, NotFiniteError, PlanWarning, ShapeError

LINKS = 3


def line(seed=0):
    """A row of masses on springs: its dynamics are linear, with a mass matrix that is not diagonal."""
    rng = np.random.default_rng(seed)
    builder, last = phipsi.SceneBuilder().link("base"), "base"
    for i in range(LINKS):
        builder = builder.link(f"l{i}", mass=float(rng.uniform(0.5, 2)))
        spring = {"stiffness": float(rng.uniform(0, 20)), "damping": float(rng.uniform(0, 2))}
        builder = builder.joint(f"j{i}", "prismatic", last, f"l{i}", axis="x", **spring)
        last = f"l{i}"
    return builder.build()


def ball():
    """A spherical joint with a spring, then a hinge with friction."""
    inertia = np.diag([0.1, 0.2, 0.25])
    builder = phipsi.SceneBuilder().link("a").link("b", mass=1, inertia=inertia)
    builder = builder.link("c", mass=1, com=(0, 0, 0.2), inertia=inertia)
    builder = builder.joint("s", "spherical", "a", "b", stiffness=3.0, damping=0.4)
    spring = {"stiffness": 5.0, "damping": 0.2, "friction": 0.3}
    return builder.joint("r", "revolute", "b", "c", axis="x", xyz=(0, 0.1, 0.3), **spring).build()


def pendulum(links, effort):
    """Slender links of 1 m and 1 kg that hang."""
    builder, last = phipsi.SceneBuilder().link("base"), "base"
    for i in range(links):
        builder = builder.link(f"l{i}", mass=1.0, com=(0, 0, -0.5), inertia=np.diag([1 / 12, 1 / 12, 1e-3]))
        xyz = (0, 0, -1.0 if i else 0.0)
        builder = builder.joint(f"j{i}", "revolute", last, f"l{i}", axis="y", xyz=xyz, effort=effort[i])
        last = f"l{i}"
    return builder.build()


def four_bar():
    """A parallelogram: two cranks and a coupler, the third joint closed by a connection."""
    builder, last = phipsi.SceneBuilder().link("base"), "base"
    for i, (x, z) in enumerate([(0, 0), (0, -0.4), (0.6, 0)]):
        builder = builder.link(f"l{i}", mass=1.0, com=(0.1, 0, -0.1), inertia=np.diag([0.02, 0.02, 0.02]))
        builder = builder.joint(f"j{i}", "revolute", last, f"l{i}", axis="y", xyz=(x, 0, z))
        last = f"l{i}"
    return builder.connect("closure", "point", "l2", xyz=(0, 0, 0.4), other_xyz=(0.6, 0, 0)).build()


def coupled():
    """Two hinges, the second of which follows the first, and a third one; with springs and damping."""
    builder, last = phipsi.SceneBuilder().link("a"), "a"
    for i in range(3):
        builder = builder.link(f"l{i}", mass=1.0, com=(0, 0, -0.3), inertia=np.diag([0.05, 0.06, 0.02]))
        spring = {"stiffness": 3.0, "damping": 0.4} | ({"mimic": "j0", "mimic_multiplier": -0.5} if i == 1 else {})
        builder = builder.joint(f"j{i}", "revolute", last, f"l{i}", axis="y", xyz=(0, 0, -0.5), **spring)
        last = f"l{i}"
    return builder.build(mimic="couple")


def leg():
    """A body with a leg, whose foot is 2 cm above the floor."""
    builder = phipsi.SceneBuilder()
    for name in ("body", "shank"):
        builder = builder.link(name, mass=1.0, com=(0, 0, -0.2), inertia=np.diag([0.03, 0.03, 0.01]))
    builder = builder.joint("knee", "revolute", "body", "shank", axis="y", xyz=(0, 0, -0.4), damping=0.1)
    return builder.contact("foot", "shank", xyz=(0, 0, -0.4), friction=0.7, offset=-0.82).build(floating_base=True)


def pusher():
    """A hand that can push a block along a rail."""
    builder = phipsi.SceneBuilder().link("world")
    for name, effort, damping in (("hand", 50.0, 0.0), ("block", 0.0, 2.0)):
        builder = builder.link(name, mass=1.0).joint(name, "prismatic", "world", name, axis="x", effort=effort, damping=damping)
    return builder.contact("touch", "hand", radius=0.05, friction=0.0, other="block", other_radius=0.05).build(gravity=(0, 0, 0))


SMOOTHED = {"leg": leg, "pusher": pusher}
SCENES = {
    "mimic": coupled,
    "arm": lambda: phipsi.load(phipsi.BUNDLED_ARM),
    "floating": lambda: phipsi.load(phipsi.BUNDLED_ARM, floating_base=True),
    "ball": ball,
    "line": line,
    "loop": four_bar,
}

FREE = {"limits": False, "effort": None}


def random_plan(scene, *, steps=3, seed=0, **keywords):
    """The motion and the law of random torques from a random state."""
    rng = np.random.default_rng(seed)
    if scene.loops.names:
        q, qd = scene.neutral(), np.zeros(scene.nv)
    else:
        q = scene.integrate(scene.neutral(), 0.3 * rng.normal(size=scene.nv))
        qd = 0.5 * rng.normal(size=scene.nv)
    given = {"costs": control.Effort(1.0), "tau": rng.normal(size=(steps, scene.nv)), "iterations": 0} | FREE
    return scene.optimize(q, qd, dt=0.02, steps=steps, **(given | keywords))


def linearization(plan):
    (a, b, by_torque, hessian), driven = plan._problem.optimizer.linearization()
    return a, b, by_torque, hessian, driven


@pytest.mark.parametrize("kind", ["arm", "ball", "line", "mimic"])
def test_motion_is_that_of_the_simulation(kind):
    plan = random_plan(SCENES[kind](), steps=30)
    path = plan.trajectory()
    scale = tolerances.product(30 * plan.scene.nv, 1.0 + abs(plan.qd).max())
    assert abs(path.q - plan.q).max() <= scale
    assert abs(path.qd - plan.qd).max() <= scale * 50.0


@pytest.mark.parametrize("kind", [*SCENES, *SMOOTHED])
def test_derivatives_are_those_of_the_step(kind):
    scene = (SCENES | SMOOTHED)[kind]()
    costs = [control.Effort(1.0), control.EffortRate(2.0)]
    options = FREE | ({"smoothing": 0.01} if kind in SMOOTHED else {})
    plan = random_plan(scene, costs=costs, **options)
    a, b, by_torque, _, driven = linearization(plan)
    nv = scene.nv
    assert list(driven) == [row for row in range(nv) if kind not in {"floating", "leg"} or row >= 6]

    def after(q, qd, tau, k):
        # Efforts of a floating base move it too, but are no controls.
        moved = scene.optimize(q, qd, dt=0.02, steps=1, costs=control.Effort(1.0), tau=tau[None], iterations=0, **options)
        return np.concatenate([scene.difference(plan.q[k + 1], moved.q[1]), moved.qd[1]])

    for k in (0, 2):
        found = np.zeros((2 * nv, 3 * nv))
        for column in range(3 * nv):
            step = np.zeros(3 * nv)
            step[column] = tolerances.STEP
            ends = [
                after(scene.integrate(plan.q[k], s * step[:nv]), plan.qd[k] + s * step[nv : 2 * nv], plan.tau[k] + s * step[2 * nv :], k)
                for s in ((1.0, -1.0) if not scene.loops.names or column >= nv else (0.0, 0.0))
            ]
            found[:, column] = (ends[0] - ends[1]) / (2.0 * tolerances.STEP)
        bound = 1e3 * tolerances.STEP**2 * abs(found).max()
        assert abs(found[:, 2 * nv :][:, driven] - b[k, : 2 * nv]).max() <= bound
        assert abs(b[k, : 2 * nv] - by_torque[k][:, driven]).max() <= bound
        assert abs(found[:, nv : 2 * nv] - a[k, : 2 * nv, nv : 2 * nv]).max() <= bound
        if not scene.loops.names:
            assert abs(found[:, :nv] - a[k, : 2 * nv, :nv]).max() <= bound
        assert (a[k, 2 * nv :] == 0.0).all()
        assert (b[k, 2 * nv :] == np.eye(len(driven))).all()


def dense_optimum(a, b, weights, x0, goal):
    """The controls of a linear-quadratic problem by one dense least-squares problem with 60 digits.

    `weights` are those of the states of the way, of the controls, of their rate and of the end.
    """
    of_state, of_control, of_rate, of_end = weights
    steps, n, m = b.shape
    with mp.workdps(60):
        state, by = mp.matrix(x0[:, None].tolist()), mp.matrix(n, steps * m)
        normal, right = mp.matrix(steps * m, steps * m), mp.matrix(steps * m, 1)

        def add(row, value, weight):
            used = [j for j in range(steps * m) if row[j] != 0]
            for i in used:
                right[i] -= weight * row[i] * value
                for j in used:
                    normal[i, j] += weight * row[i] * row[j]

        for k in range(steps + 1):
            for i in range(n):
                add(by[i, :], state[i] - mp.mpf(goal[i]), mp.mpf(of_end if k == steps else of_state))
            if k == steps:
                break
            for j in range(m):
                row = mp.matrix(1, steps * m)
                row[k * m + j] = 1
                add(row, mp.mpf(0), mp.mpf(of_control))
                if k > 0 and of_rate:
                    row[(k - 1) * m + j] = -1
                    add(row, mp.mpf(0), mp.mpf(of_rate))
            step, gain = mp.matrix(a[k].tolist()), mp.matrix(b[k].tolist())
            state, by = step * state, step * by
            for i in range(n):
                for j in range(m):
                    by[i, k * m + j] += gain[i, j]
        found = mp.lu_solve(normal, right)
        return np.array([float(entry) for entry in found]).reshape(steps, m)


@pytest.mark.parametrize(("ratio", "rate"), [(1.0, 0.0), (1e6, 0.0), (1e12, 0.0), (1.0, 0.3), (1e6, 0.3)])
def test_linear_quadratic_part_is_dense_least_squares(ratio, rate):
    scene, steps, dt = line(), 8, 0.05
    x0, goal = np.array([0.3, -0.2, 0.1, 0.0, 0.1, 0.0]), np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
    end = 1.0 / np.sqrt(ratio)
    costs = [control.Effort(0.5), control.State(goal[:3], 0.0, 2.0, 2.0)]
    costs.append(control.Terminal(control.State(goal[:3], 0.0, end, end)))
    if rate:
        costs.append(control.EffortRate(1.0 / rate))
    plan = scene.optimize(x0[:3], x0[3:], dt=dt, steps=steps, costs=costs, tolerance=1e-14, **FREE)
    a, b, *_ = linearization(plan)
    weights = (0.25 * dt, 4.0 * dt, rate**2 / dt, ratio)
    exact = dense_optimum(a[:, :6, :6], b[:, :6], weights, x0, goal)
    assert plan.converged
    assert plan.iterations <= 2
    # The covariance form has no correct digit at 1e12: the array form computes the stages in which it cancels.
    assert (plan.history[0].array_stages > 0) == (ratio > 1e6)
    assert abs(plan.tau - exact).max() <= 1e-10 * abs(exact).max()


def test_gains_are_the_change_of_the_optimum():
    scene = line()
    x0 = np.array([0.3, -0.2, 0.1, 0.0, 0.1, 0.0])
    goal = control.State([1.0, 2.0, 3.0], 0.0, 0.1, 0.2)
    given = {"dt": 0.05, "steps": 8, "costs": [control.Effort(0.5), control.Terminal(goal)], "tolerance": 1e-14} | FREE
    plan = scene.optimize(x0[:3], x0[3:], **given)
    for column in range(6):
        moved = x0 + 0.5 * np.eye(6)[column]
        other = scene.optimize(moved[:3], moved[3:], **given)
        bound = tolerances.inverse(1e4, abs(plan.tau).max())
        assert abs(other.tau[0] - (plan.tau[0] - plan.gains[0] @ (moved - x0))).max() <= bound
        assert abs(plan.policy(0, moved[:3], moved[3:]) - other.tau[0]).max() <= bound
    assert abs(plan.gains[0]).max() > 1.0


def reach(scene, **keywords):
    costs = [control.Effort(10.0), control.State(velocity=1.0)]
    costs.append(control.Terminal(tasks.Position("link6", (0.5, 0.1, 0.4), position=0.01)))
    costs.append(control.Terminal(control.State(velocity=0.1)))
    return scene.optimize(np.full(6, 0.1), **({"dt": 0.02, "steps": 30, "costs": costs, "tolerance": 1e-10} | keywords))


@pytest.fixture(scope="module")
def arm():
    return phipsi.load(phipsi.BUNDLED_ARM).with_properties(friction=0.0)


def test_arm_reaches(arm):
    plan = reach(arm)
    assert plan.converged
    assert "converged" in repr(plan)
    assert abs(arm.placement(plan.q[-1], "link6")[:3, 3] - [0.5, 0.1, 0.4]).max() < 0.01
    # The gradient of the cost by the efforts vanishes: no effort changes it to first order.
    rng = np.random.default_rng(0)
    for _ in range(3):
        change = 0.02 * rng.normal(size=plan.tau.shape)
        costs = [reach(arm, tau=plan.tau + s * change, iterations=0, **FREE).cost for s in (1.0, -1.0)]
        assert min(costs) > plan.cost
        assert abs(costs[0] - costs[1]) < 0.01 * (sum(costs) - 2.0 * plan.cost)


def test_states_that_the_efforts_do_not_reach_lead_to_the_same_minimum(arm):
    plan = reach(arm)
    path = np.linspace(plan.q[0], plan.q[-1], 31)[1:]
    shot = reach(arm, start=(path, np.zeros((30, 6))))
    assert shot.converged
    assert shot.history[-1].defects == 0.0
    assert abs(shot.cost / plan.cost - 1.0) < 1e-8
    assert abs(shot.q - plan.q).max() < 1e-3
    assert abs(shot.trajectory().q - shot.q).max() <= tolerances.product(1000, 1.0)


def test_effort_limits_hold_and_held_controls_have_no_gains():
    scene = pendulum(1, [1.0])
    goal = control.Terminal(control.State([np.pi], 0.0, 0.02, 0.1))
    plan = scene.optimize([0.0], dt=0.05, steps=100, costs=[control.Effort(10.0), goal], tolerance=1e-6)
    assert plan.converged
    assert abs(plan.q[-1] - np.pi).max() < 0.05
    # 1 N m does not hold the link, which needs 4.9: it swings.
    assert plan.q.min() < -0.3
    held = abs(plan.tau[:, 0]) == 1.0
    assert held.any()
    assert (abs(plan.tau) <= 1.0).all()
    assert (plan.gains[held] == 0.0).all()
    assert (plan.gains[~held] != 0.0).any()
    assert abs(plan.policy(40, [1.0], [30.0])) == 1.0


def test_acrobot_swings_up():
    scene = pendulum(2, [0.0, 20.0])
    goal = control.Terminal(control.State([np.pi, 0.0], 0.0, 0.02, 0.1))
    given = {"tau": [0.0, 0.1], "limits": False, "iterations": 200, "tolerance": 1e-3}
    plan = scene.optimize([0.0, 0.0], dt=0.05, steps=60, costs=[control.Effort(5.0), goal], **given)
    assert (plan.tau[:, 0] == 0.0).all()
    assert (plan.gains[:, 0] == 0.0).all()
    assert abs(plan.tau[:, 1]).max() <= 20.0
    assert abs(plan.q[-1] - [np.pi, 0.0]).max() < 0.1


def test_position_limits_hold(arm):
    free = reach(arm, limits=False)
    limit = free.q[:, 1].min() + 0.02
    below = control.NotPositive(control.Function(lambda q, qd, tau: limit - q[:, 1:2], lambda q, qd, tau: (-np.ones((len(q), 1, 1)) * np.eye(6)[1], None, None)))
    costs = [control.Effort(10.0), control.State(velocity=1.0), control.Terminal(tasks.Position("link6", (0.5, 0.1, 0.4), position=0.01))]
    costs += [control.Terminal(control.State(velocity=0.1)), below]
    plan = reach(arm, costs=costs)
    assert plan.converged
    assert plan.cost > free.cost
    assert plan.q[1:, 1].min() >= limit - 1e-6
    assert plan.q[1:, 1].min() < limit + 1e-4
    assert plan.history[-1].violation <= 1e-6


def test_limits_of_the_joints_are_inequalities():
    builder = phipsi.SceneBuilder().link("base").link("l", mass=1.0, com=(0, 0, -0.5), inertia=np.eye(3) * 0.1)
    scene = builder.joint("j", "revolute", "base", "l", axis="y", lower=-1.0, upper=0.6, velocity=1.5, effort=50.0).build()
    goal = control.Terminal(control.State([1.0], 0.0, 0.01, 1.0))
    free = scene.optimize([0.0], dt=0.02, steps=50, costs=[control.Effort(5.0), goal], limits=False)
    plan = scene.optimize([0.0], dt=0.02, steps=50, costs=[control.Effort(5.0), goal])
    assert free.q.max() > 0.9
    assert plan.converged
    assert plan.q.max() <= 0.6 + 1e-6
    assert abs(plan.qd).max() <= 1.5 + 1e-6


def test_functions_are_costs(arm):
    plan = reach(arm)

    def residuals(q, qd, tau):
        return qd

    def derivatives(q, qd, tau):
        return None, np.broadcast_to(np.eye(6), (len(q), 6, 6)), None

    for by in (derivatives, None):
        costs = [control.Effort(10.0), control.Function(residuals, by)]
        costs.append(control.Terminal(tasks.Position("link6", (0.5, 0.1, 0.4), position=0.01)))
        costs.append(control.Terminal(control.Function(lambda q, qd, tau: 10.0 * qd)))
        other = reach(arm, costs=costs)
        assert abs(other.cost / plan.cost - 1.0) < 1e-8


def test_targets_of_each_knot(arm):
    plan = reach(arm)
    path = np.stack([arm.placement(q, "link6")[:3, 3] for q in plan.q])
    costs = [control.Effort(100.0), tasks.Position("link6", path[:-1], position=0.001)]
    follow = arm.optimize(plan.q[0], dt=0.02, steps=30, costs=costs)
    assert abs(np.stack([arm.placement(q, "link6")[:3, 3] for q in follow.q[:-1]]) - path[:-1]).max() < 0.005


def test_rate_of_efforts_is_smooth(arm):
    plain = reach(arm)
    costs = [control.Effort(10.0), control.State(velocity=1.0), control.EffortRate(5.0)]
    costs.append(control.Terminal(tasks.Position("link6", (0.5, 0.1, 0.4), position=0.01)))
    smooth = reach(arm, costs=costs)
    assert smooth.converged
    assert smooth.rate_gains.shape == (30, 6, 6)
    assert abs(np.diff(smooth.tau, axis=0)).max() < 0.5 * abs(np.diff(plain.tau, axis=0)).max()
    before = smooth.tau[4] + 0.1
    assert abs(smooth.policy(5, smooth.q[5], smooth.qd[5], before=before) - smooth.tau[5]).max() > 0.0


def test_connections_hold():
    scene = four_bar()
    goal = control.Terminal(control.State([0.4, -0.4, 0.4], 0.0, 0.02, 0.2))
    plan = scene.optimize(scene.neutral(), dt=0.01, steps=40, costs=[control.Effort(5.0), goal])
    assert plan.converged
    assert abs(scene.loops.error(plan.q)).max() < 1e-3
    assert abs(plan.q[-1] - plan.q[0]).max() > 0.2


def test_contacts_that_the_plan_touches_are_named(arm):
    plain = reach(arm)
    far = arm.to_builder().contact("hand", "link6", friction=0.5, offset=-100.0).build()
    assert (reach(far).tau == plain.tau).all()
    near = arm.to_builder().contact("hand", "link6", friction=0.5, offset=0.45).build()
    with pytest.warns(PlanWarning, match="contact 'hand' .* mm below its surface"):
        plan = reach(near)
    assert (plan.tau == plain.tau).all()
    ball = phipsi.shapes.Sphere(0.08, (0.414, -0.104, 0.363))
    builder = arm.to_builder().collider("hand", phipsi.shapes.Sphere(0.05), link="link6")
    shapes = builder.collider("ball", ball).build()
    goal = control.Terminal(tasks.Position("link6", (0.35, -0.35, 0.3), position=0.01))
    costs = [control.Effort(10.0), control.State(velocity=1.0), goal]
    given = {"dt": 0.02, "steps": 30, "iterations": 40}
    with pytest.warns(PlanWarning, match="shapes 'hand' and 'ball' that overlap"):
        shapes.optimize(np.full(6, 0.1), costs=costs, **given)
    costs.append(tasks.Distance(("hand", "ball"), 0.03, position=0.0005))
    around = shapes.optimize(np.full(6, 0.1), costs=costs, **given)
    assert shapes.distances(around.q).distance.min() > 0.0


def test_model_predictive_loop_follows(arm):
    rng = np.random.default_rng(3)

    def costs(target):
        goal = tasks.Position("link6", target, position=0.02)
        return [control.Effort(20.0), control.State(velocity=1.0), goal, control.Terminal(goal)]

    target = np.array([0.5, 0.1, 0.4])
    plan = arm.optimize(np.full(6, 0.1), dt=0.02, steps=20, costs=costs(target))
    q, qd = plan.q[0], plan.qd[0]
    for _ in range(60):
        tau = plan.policy(0, q, qd) + 0.05 * rng.normal(size=6)
        moved = arm.simulate(q, qd, dt=0.02, steps=1, tau=tau)
        q, qd = moved.q[-1], moved.qd[-1]
        plan = plan.resume(q, qd, costs=costs(target))
    assert plan.iterations == 1
    assert abs(arm.placement(q, "link6")[:3, 3] - target).max() < 0.02
    assert (plan.q[0] == q).all()


def test_plans_through_connections_do_not_depend_on_earlier_calls():
    """The steps of a plan drift from the connections by more than other calls accept: the kernels know."""

    def pinned():
        arm = phipsi.load(phipsi.BUNDLED_ARM)
        length = np.linalg.norm(arm.placement(np.full(6, 0.5), "link6")[:3, 3] - [0.3, 0.3, 0.0])
        return arm.to_builder().connect("rod", "distance", "link6", other_xyz=(0.3, 0.3, 0.0), length=length).build().with_properties(damping=0.0)

    used, fresh = pinned(), pinned()
    q = np.full(6, 0.5)
    used.forward_dynamics(np.stack([q] * 4), np.zeros((4, 6)), np.zeros((4, 6)))
    given = {"dt": 0.05, "steps": 20, "costs": [control.Effort(10.0), control.State(qd=[2.0, *[0.0] * 5], velocity=[0.1, *[np.inf] * 5])]} | FREE
    with pytest.warns(PlanWarning, match="error of the connections"):
        plans = [scene.optimize(q, **given) for scene in (used, fresh)]
    assert abs(used.loops.error(plans[0].q)).max() > 1e-3
    assert (plans[0].q == plans[1].q).all() and (plans[0].gains == plans[1].gains).all()


def test_smoothed_contacts_are_found():
    """A block that the first motion does not touch is pushed to its goal, also by the exact law."""
    scene = pusher()
    goal = control.Terminal(control.State([0.0, 0.5], position=[np.inf, 0.01], velocity=0.1))
    given = {"dt": 0.02, "steps": 50, "costs": [control.Effort(30.0), goal], "limits": False}
    # Nothing leads to the block, which no motor moves.
    apart = scene.optimize([0.0, 0.3], **given)
    assert apart.q[-1, 1] == 0.3
    plan = scene.optimize([0.0, 0.3], **given, smoothing=0.01)
    assert plan.converged and abs(plan.q[-1, 1] - 0.5) < 0.02
    q, qd = plan.q[0], plan.qd[0]
    for k in range(50):
        path = scene.simulate(q, qd, dt=0.02, steps=1, tau=plan.policy(k, q, qd), limits="report")
        q, qd = path.q[-1], path.qd[-1]
    assert abs(q[1] - 0.5) < 0.05
    with pytest.raises(ArgumentError, match="smoothing"):
        plan.trajectory()


def test_a_leg_lands_and_stands():
    """With contacts that act, weight is carried: the body stays up with the torques of a plan, and only with contacts."""
    scene = leg()
    start = np.array(scene.neutral())
    start[2] = 0.05
    goal = control.State([0, 0, 0, 0, 0, 0, 1, 0], position=0.05, velocity=0.5)
    given = {"dt": 0.01, "steps": 40, "costs": [control.Effort(10.0), goal], "limits": False}
    plan = scene.optimize(start, **given, smoothing=0.005)
    assert -0.04 < plan.q[-1, 2] < 0.06
    with pytest.warns(PlanWarning, match="contact 'foot'"):
        assert scene.optimize(start, **given).q[-1, 2] < -0.3


@pytest.mark.parametrize(("make", "words"), [(coupled, "follow others"), (four_bar, "connected"), (line, "without contacts")])
def test_contacts_that_cannot_be_smoothed(make, words):
    scene = make()
    with pytest.raises(ArgumentError, match=f"smoothing.*{words}"):
        scene.optimize(scene.neutral(), dt=0.02, steps=3, costs=control.Effort(1.0), limits=False, smoothing=0.01)


def test_expected_cost_is_the_mean_of_noisy_runs(arm):
    plan = reach(arm, **FREE)
    runs, bodies, dt = 2000, len(arm.body_names), plan.dt
    covariance = np.zeros((bodies, 10, 10))
    covariance[:, 0, 0] = (0.02 * arm.inertial_parameters[:, 0]) ** 2
    unsure = estimation.MotionUncertainty(parameters=covariance, torque_noise=1e-3, initial=np.full(12, 1e-6))
    stated = plan.expected(unsure)
    rng = np.random.default_rng(0)
    q = arm.integrate(np.broadcast_to(plan.q[0], (runs, 6)), 1e-3 * rng.normal(size=(runs, 6)))
    qd = 1e-3 * rng.normal(size=(runs, 6))
    models = np.repeat(np.array(arm.inertial_parameters)[None], runs, axis=0)
    models[:, :, 0] *= 1.0 + 0.02 * rng.normal(size=(runs, bodies))
    damping = np.broadcast_to(arm.damping, (6,))
    armature = np.broadcast_to(arm.armature + dt * damping, (runs, 6))
    cost = np.zeros(runs)
    for k in range(len(plan.tau)):
        deviation = np.concatenate([arm.difference(plan.q[k], q), qd - plan.qd[k]], axis=1)
        tau = plan.tau[k] - deviation @ plan.gains[k].T
        cost += 0.5 * dt * (((tau / 10.0) ** 2).sum(1) + (qd**2).sum(1))
        noisy = tau + np.sqrt(1e-3 / dt) * rng.normal(size=(runs, 6)) - damping * qd
        qd = qd + dt * arm.forward_dynamics(q, qd, noisy, inertias=models, armature=armature)
        q = arm.integrate(q, dt * qd)
    hand = arm.placement(q, "link6")[:, :3, 3] - [0.5, 0.1, 0.4]
    cost += 0.5 * (((hand / 0.01) ** 2).sum(1) + ((qd / 0.1) ** 2).sum(1))
    error = cost.std() / np.sqrt(runs)
    # First order: a few percent of the excess are of higher order.
    excess = stated.cost - plan.cost
    assert excess > 20.0 * error
    assert abs(cost.mean() - stated.cost) <= tolerances.SIGMAS * error + 0.05 * excess
    assert 0.97 < cost.mean() / stated.cost < 1.03
    ends = arm.difference(plan.q[-1], q).std(axis=0) / stated.q[-1]
    assert abs(ends - 1.0).max() <= tolerances.SIGMAS / np.sqrt(2.0 * runs) + 0.02


HEDGED = {
    "ball": (ball, [control.Effort(3.0)], {}),
    "loop": (four_bar, [control.Effort(3.0)], {}),
    "mimic": (coupled, [control.Effort(3.0)], {}),
    "rate": (ball, [control.Effort(3.0), control.EffortRate(30.0)], {}),
    "clamped": (lambda: pendulum(2, (4.0, 4.0)), [control.Effort(3.0)], {"effort": True}),
}


def unsure_of(scene):
    covariance = np.zeros((len(scene.inertial_parameters), 10, 10))
    covariance[:, 0, 0] = (0.1 * scene.inertial_parameters[:, 0]) ** 2
    return estimation.MotionUncertainty(parameters=covariance, torque_noise=2e-3, initial=np.full(2 * scene.nv, 1e-4))


@pytest.mark.parametrize("kind", HEDGED)
def test_the_expected_cost_is_least(kind):
    """Its derivatives along changes of the torques, with rollouts and new laws, vanish."""
    make, costs, options = HEDGED[kind]
    scene = make()
    q, steps = scene.neutral(), 12
    change = np.linspace(0.5, 0.2, scene.nv)
    goal = scene.loops.project(scene.integrate(q, change)).q if scene.loops.names else scene.integrate(q, change)
    costs = [*costs, control.State(goal, position=1.0, velocity=3.0), control.Terminal(control.State(goal, position=0.03, velocity=0.1))]
    given = {"dt": 0.05, "steps": steps, "costs": costs, "tolerance": 1e-9} | FREE | options
    unsure = unsure_of(scene)
    plain = scene.optimize(q, **given)
    found = scene.optimize(q, **given, uncertainty=unsure)
    assert found.converged and found.cost > plain.cost
    assert found.expected(unsure).cost < plain.expected(unsure).cost

    def slopes(plan):
        rng = np.random.default_rng(1)
        inside = np.abs(plan.tau) < 0.999 * plan.effort[1]
        for _ in range(4):
            way = rng.normal(size=plan.tau.shape) * inside
            ends = [scene.optimize(q, **given | {"iterations": 0}, tau=plan.tau + sign * 1e-4 * way).expected(unsure).cost for sign in (1, -1)]
            yield (ends[0] - ends[1]) / 2e-4

    before, after = (np.linalg.norm(list(slopes(plan))) for plan in (plain, found))
    assert after < 0.02 * before


def test_the_expected_cost_of_linear_motion_is_that_of_any_motion():
    """Where noise acts alike everywhere, the motion of least cost is that of least expected cost."""
    scene = line()
    given = {"dt": 0.05, "steps": 10, "costs": [control.Effort(1.0), control.Terminal(control.State(0.3, position=0.01))]}
    plain = scene.optimize(np.zeros(3), **given, **FREE)
    found = scene.optimize(np.zeros(3), **given, **FREE, uncertainty=estimation.MotionUncertainty(torque_noise=0.1))
    assert np.abs(found.q - plain.q).max() < 1e-9


def test_least_expected_cost_with_other_masses(arm):
    """The mean cost of the closed loop with a heavier and with a lighter hand, by simulation."""
    covariance, spread = np.zeros((6, 10, 10)), 0.4
    covariance[-1, 0, 0] = spread**2
    loaded = np.array(arm.inertial_parameters)
    loaded[-1, 0] += 1.0
    arm = arm.with_inertial_parameters(loaded)
    target = (0.5, 0.1, 0.4)
    costs = [control.Effort(50.0), control.Terminal(tasks.Position("link6", target, position=0.005))]
    given = {"dt": 0.02, "steps": 50, "costs": [*costs, control.Terminal(control.State(velocity=0.1))]} | FREE

    def cost_with(plan, change):
        parameters = np.array(arm.inertial_parameters)
        parameters[-1, 0] += change
        changed = arm.with_inertial_parameters(parameters)
        q, qd, cost = plan.q[0], plan.qd[0], 0.0
        for k in range(len(plan.tau)):
            tau = plan.tau[k] - plan.gains[k] @ np.concatenate([arm.difference(plan.q[k], q), qd - plan.qd[k]])
            cost += 0.01 * ((tau / 50.0) ** 2).sum()
            path = changed.simulate(q, qd, dt=0.02, steps=1, tau=tau, method="implicit-euler", limits="report")
            q, qd = path.q[-1], path.qd[-1]
        hand = arm.placement(q, "link6")[:3, 3] - target
        return cost + 0.5 * (((hand / 0.005) ** 2).sum() + ((qd / 0.1) ** 2).sum())

    means = []
    for uncertainty in (None, covariance):
        plan = arm.optimize(np.full(6, 0.1), **given, uncertainty=uncertainty)
        mean = 0.5 * (cost_with(plan, spread) + cost_with(plan, -spread))
        excess = plan.expected(covariance).cost - plan.cost
        # First order.
        assert abs(mean - plan.cost - excess) < 0.1 * excess
        means.append(mean)
    assert means[1] < 0.99 * means[0]


def test_expected_cost_is_that_of_the_plan_after_others_were_made_from_it(arm):
    goals = [[control.Effort(5.0), control.State(velocity=3.0), control.Terminal(tasks.Position("link6", at, position=0.01))] for at in ([0.5, 0.1, 0.4], [0.1, 0.5, 0.2])]
    unsure = estimation.MotionUncertainty(torque_noise=1e-3)

    def made():
        return arm.optimize(np.full(6, 0.1), dt=0.02, steps=20, costs=goals[0])

    plan = made()
    before = plan.expected(unsure)
    other = plan.resume(plan.q[1] + 0.3, plan.qd[1], costs=goals[1])
    after = plan.expected(unsure)
    assert (after.cost, *(of.tobytes() for of in after[1:])) == (before.cost, *(of.tobytes() for of in before[1:]))
    # Without costs those of the plan are meant, also if another plan with other targets was made from it.
    again, wanted = plan.resume(plan.q[1], plan.qd[1]), made().resume(plan.q[1], plan.qd[1])
    assert (again.q == wanted.q).all()
    assert again.cost == wanted.cost
    assert (other.resume(other.q[1], other.qd[1]).q == made().resume(plan.q[1] + 0.3, plan.qd[1], costs=goals[1]).resume(other.q[1], other.qd[1]).q).all()


@pytest.mark.parametrize("iterations", [0, 1, 3])
def test_resuming_is_a_new_search_from_the_shifted_torques(arm, iterations):
    # The inequalities of the limits had multipliers in the search before.
    costs = [control.Effort(10.0), control.EffortRate(100.0), control.Terminal(tasks.Position("link6", (0.3, 0.1, 0.4)))]
    given = {"dt": 0.02, "steps": 10, "costs": costs}
    plan = arm.optimize(np.full(6, 0.1), **given)
    assert abs(plan.qd / arm.limits.velocity).max() > 0.999
    for _ in range(2):
        found = plan.resume(plan.q[1], plan.qd[1], iterations=iterations)
        wanted = arm.optimize(plan.q[1], plan.qd[1], tau=plan.shift()[2], iterations=iterations, **given)
        for name in ("q", "qd", "tau", "gains", "rate_gains"):
            tolerances.assert_same_bits(getattr(found, name), getattr(wanted, name))


@pytest.mark.parametrize("limits", [False, True])
def test_inequalities_are_no_part_of_the_expected_cost(limits):
    # A mass on a rail is linear, so that the expectation of its cost is exact: that of sampled runs.
    builder = phipsi.SceneBuilder().link("w").link("m", mass=1.0).joint("j", "prismatic", "w", "m", axis="x", lower=-1, upper=0.2)
    scene, steps, dt = builder.build(gravity=(0, 0, 0)), 40, 0.02
    costs = [control.Effort(1.0), control.State([0.5], position=0.3, velocity=1.0), control.Terminal(control.State([0.5], position=0.05, velocity=0.1))]
    slow = control.NotPositive(control.Function(lambda q, qd, tau: qd - 0.4))
    plan = scene.optimize([0.0], dt=dt, steps=steps, costs=costs if limits else [*costs, slow], limits=limits)
    assert plan.converged
    assert abs(plan.q.max() - 0.2) < 1e-6 if limits else abs(plan.qd.max() - 0.4) < 1e-5
    found = plan.expected(estimation.MotionUncertainty(initial=[1e-4, 1e-4], torque_noise=1e-4))
    # x = Phi z + ... of independent unit z: the deviations of each step for each of the causes.
    a, b = np.array([[1.0, dt], [0.0, 1.0]]), np.array([dt * dt, dt])
    x, excess = np.zeros((2, 2 + steps)), 0.0
    x[:, :2] = 1e-2 * np.eye(2)
    for k in range(steps):
        u = -plan.gains[k] @ x
        excess += 0.5 * dt * (np.sum(u**2) + np.sum((x[0] / 0.3) ** 2) + np.sum(x[1] ** 2))
        x = a @ x + np.outer(b, u[0])
        x[:, 2 + k] += b * np.sqrt(1e-4 / dt)
    excess += 0.5 * (np.sum((x[0] / 0.05) ** 2) + np.sum((x[1] / 0.1) ** 2))
    assert abs(found.cost - plan.cost - excess) <= tolerances.product(steps, plan.cost)


def test_uncertainty_needs_a_search(arm):
    unsure = estimation.MotionUncertainty(torque_noise=1e-3)
    with pytest.raises(ArgumentError, match="iterations"):
        reach(arm, uncertainty=unsure, iterations=0)
    with pytest.raises(ArgumentError, match="uncertainty"):
        reach(arm, uncertainty=estimation.MotionUncertainty(torque_noise=1e-3, check=100))


def test_regulators_solve_their_riccati_equations(arm):
    q, zero = np.full(6, 0.3), np.zeros(6)
    system = arm.linearize(q, zero, arm.gravity_torque(q))
    weights, efforts = np.linspace(1.0, 10.0, 12), np.linspace(0.1, 1.0, 6)
    found = control.lqr(system.A, system.B, weights, efforts)
    value, gains = found.value, found.gains
    rest = system.A.T @ value + value @ system.A - gains.T @ np.diag(efforts) @ gains + np.diag(weights)
    assert abs(rest).max() <= tolerances.inverse(np.linalg.cond(value), abs(value).max())
    assert abs(gains - (system.B.T @ value) / efforts[:, None]).max() <= tolerances.product(12, abs(gains).max())
    assert (found.poles.real < 0.0).all()
    assert (control.lqr(system.A, system.B, 2.0, 0.5).gains == control.lqr(system.A, system.B, np.full(12, 2.0), 0.5 * np.eye(6)).gains).all()
    held = control.lqr(system.A, system.B, weights, efforts, dt=0.001)
    assert (abs(held.poles) < 1.0).all()
    assert abs(held.gains / gains - 1.0).max() > 1e-4
    assert abs(held.gains - gains).max() < 0.1 * abs(gains).max()


def exact_gains(a, b, q, r, value, dt):
    """Gains of the Riccati equation at 60 digits: Newton's method from a stabilizing value, and the step of the system
    by the exponential function.
    """
    with mp.workdps(60):
        a, b, q, r, x = (mp.matrix(np.asarray(of).tolist()) for of in (a, b, q, r, value))
        n, m = a.rows, b.cols
        if dt is not None:
            whole = mp.zeros(n + m)
            whole[:n, :n], whole[:n, n:] = dt * a, dt * b
            whole = mp.expm(whole)
            a, b, q, r = whole[:n, :n], whole[:n, n:], dt * q, dt * r
        for _ in range(5):
            gains = mp.inverse(r) * b.T * x if dt is None else mp.inverse(r + b.T * x * b) * b.T * x * a
            closed = np.array((a - b * gains).tolist())
            one = np.eye(n, dtype=int)
            left = np.kron(closed.T, closed.T) - np.eye(n * n, dtype=int) if dt is not None else np.kron(closed.T, one) + np.kron(one, closed.T)
            right = np.array((q + gains.T * r * gains).tolist()).reshape(-1)
            x = mp.matrix(np.array(mp.lu_solve(mp.matrix(left.tolist()), mp.matrix((-right).tolist()))).reshape(n, n).tolist())
        return np.array(gains.tolist(), dtype=float)


def cheap_controls():
    """A chain whose controls are cheap: gains are large, and the step of the equation is far from the identity."""
    scene = phipsi.scenes.chain(4)
    q = np.full(4, 0.3)
    system = scene.linearize(q, np.zeros(4), scene.gravity_torque(q))
    return system.A, system.B, np.repeat([10.0, 40.0], 4), np.full(4, 1e-4)


def slow_and_fast():
    """One control moves three slow motions: the closed loop has poles from -2e-2 to -6e6."""
    a = [[-0.0224563, 0.00025205, 0.00232172], [0.00449017, -0.02323443, -0.00040573], [0.0056609, 0.00123511, -0.02163162]]
    return np.array(a), np.array([[58.36269379], [24.56505952], [-17.02326887]]), np.array([1.63250539e4, 8.20210638e2, 1.58328203e-3]), np.array([1.7e-6])


@pytest.mark.parametrize("system", [cheap_controls, slow_and_fast])
@pytest.mark.parametrize("dt", [None, 0.01])
def test_regulators_of_far_apart_weights_are_exact_to_rounding(system, dt):
    a, b, q, r = system()
    found = control.lqr(a, b, q, r, dt=dt)
    wanted = exact_gains(a, b, np.diag(q), np.diag(r), found.value, dt)
    tolerances.assert_near(found.gains, wanted, tolerances.inverse(np.linalg.cond(found.value), abs(wanted).max()))


def test_regulators_that_rounding_does_not_determine_are_refused():
    # An equation whose solution has no digit in double precision, and an undamped motion that no cost sees.
    random = np.random.default_rng(1)
    a, b = 1e-4 * random.normal(size=(7, 7)), 1e2 * random.normal(size=(7, 1))
    with pytest.raises(ArgumentError, match="A, B: found a system that these controls do not stabilize"):
        control.lqr(a, b, 10.0 ** np.linspace(-10, 10, 7), 1e-9)
    with pytest.raises(ArgumentError, match="A, B: found a system that these controls do not stabilize"):
        control.lqr([[0.0, 1.0], [-1.0, 0.0]], [[0.0], [1.0]], 0.0, 1.0)
    # A step over which the motion grows beyond all numbers.
    with pytest.raises(ArgumentError, match="A, B: found a system that these controls do not stabilize"):
        control.lqr([[5.0]], [[1.0]], 1.0, 1.0, dt=1000.0)


def test_regulators_of_no_states_and_of_no_cost():
    assert control.lqr(np.zeros((0, 0)), np.zeros((0, 2)), 1.0, 1.0).gains.shape == (2, 0)
    assert (control.lqr([[-1.0]], [[1.0]], 0.0, 1.0).gains == 0.0).all()
    assert (control.lqr([[-1.0]], [[1.0]], 0.0, 1.0, dt=0.1).gains == 0.0).all()


def test_constant_path_has_the_gains_of_the_steady_regulator(arm):
    q, zero = np.full(6, 0.3), np.zeros((2001, 6))
    tau = np.repeat(arm.gravity_torque(q)[None], 2000, axis=0)
    plan = control.tracking(arm, np.repeat(q[None], 2001, axis=0), zero, tau, dt=0.001, position=0.1, velocity=1.0, effort=5.0)
    a, b, *_ = linearization(plan)
    steady = plan.gains[0]
    closed = a[0] - b[0] @ steady
    assert (abs(np.linalg.eigvals(closed)) < 1.0).all()
    system = arm.linearize(q, np.zeros(6), tau[0])
    found = control.lqr(system.A, system.B, np.repeat([100.0, 1.0], 6), np.full(6, 0.04))
    assert abs(steady - found.gains).max() < 0.05 * abs(found.gains).max()


def test_shift_and_file(arm, tmp_path):
    plan = reach(arm)
    q, qd, tau = plan.shift(3)
    assert (q[:-3] == plan.q[4:]).all()
    assert (qd[:-3] == plan.qd[4:]).all()
    assert (tau[:-3] == plan.tau[3:]).all()
    assert (tau[-3:] == plan.tau[-1]).all()
    plan.save(tmp_path / "plan.npz")
    saved = np.load(tmp_path / "plan.npz")
    assert all((saved[name] == getattr(plan, name)).all() for name in ("t", "q", "qd", "tau", "gains", "cost"))


def test_results_have_the_same_bits_on_any_number_of_threads(arm):
    first = reach(arm)
    phipsi.set_num_threads(2)
    try:
        second = reach(arm)
    finally:
        phipsi.set_num_threads(None)
    assert (first.tau == second.tau).all()
    assert (first.gains == second.gains).all()


EFFORT = control.Effort(1.0)

WRONG = [
    ({"dt": 0.0}, ArgumentError, "dt"),
    ({"dt": np.nan}, ArgumentError, "dt"),
    ({"steps": 0}, ArgumentError, "steps"),
    ({"costs": [EFFORT, 3.0]}, ArgumentError, r"costs\[1\]"),
    ({"costs": [control.Effort(-1.0)]}, ArgumentError, r"costs\[0\].deviation"),
    ({"costs": [control.Effort([1.0, 2.0])]}, ShapeError, r"costs\[0\].deviation"),
    ({"costs": [control.Effort(1.0, np.zeros((3, 6)))]}, ShapeError, r"costs\[0\].tau"),
    ({"costs": [control.State(np.zeros(5), position=1.0)]}, ShapeError, r"costs\[0\].q"),
    ({"costs": [control.State(np.full(6, np.nan), position=1.0)]}, NotFiniteError, r"costs\[0\]"),
    ({"costs": [control.During(EFFORT, 5, 3)]}, ArgumentError, r"costs\[0\]"),
    ({"costs": [control.During(EFFORT, 0, 99)]}, ArgumentError, r"costs\[0\]"),
    ({"costs": [control.Terminal(EFFORT)]}, ArgumentError, r"costs\[0\]"),
    ({"costs": [control.Terminal(control.During(EFFORT, 0, 1))]}, ArgumentError, r"costs\[0\]"),
    ({"costs": [control.NotPositive(EFFORT)]}, ArgumentError, r"costs\[0\]"),
    ({"costs": [control.Function(3.0)]}, ArgumentError, r"costs\[0\].residuals"),
    ({"costs": [control.Function(lambda q, qd, tau: q[0])]}, ShapeError, r"costs\[0\].residuals"),
    ({"costs": [control.Function(lambda q, qd, tau: q, lambda q, qd, tau: (q, q))]}, ShapeError, r"costs\[0\].derivatives"),
    ({"costs": [tasks.Position("nowhere", (0, 0, 0))]}, ValueError, "nowhere"),
    ({"costs": [tasks.Position("link6", np.zeros((3, 3)))]}, ShapeError, r"costs\[0\]"),
    ({"tau": np.zeros((3, 6))}, ShapeError, "tau"),
    ({"tau": np.full(6, np.inf)}, NotFiniteError, "tau"),
    ({"start": 3}, ArgumentError, "start"),
    ({"start": (np.zeros((3, 6)), np.zeros((3, 6)))}, ShapeError, "start"),
    ({"start": (np.full((10, 6), np.nan), np.zeros((10, 6)))}, NotFiniteError, "^start: "),
    ({"uncertainty": estimation.MotionUncertainty(initial=np.full(12, np.nan))}, NotFiniteError, "^initial: "),
    ({"effort": -1.0}, ArgumentError, "effort"),
    ({"effort": np.zeros(4)}, ShapeError, "effort"),
    ({"effort": np.array([np.ones(6), -np.ones(6)])}, ArgumentError, "effort"),
    ({"iterations": -1}, ArgumentError, "iterations"),
    ({"tolerance": 0.0}, ArgumentError, "tolerance"),
    ({"friction_speed": 0.0}, ArgumentError, "friction_speed"),
    ({"q0": np.zeros(5)}, ShapeError, "q0"),
    ({"qd0": np.full(6, np.nan)}, NotFiniteError, "qd0"),
]


@pytest.mark.parametrize("at", range(len(WRONG)))
def test_wrong_calls_name_the_argument(arm, at):
    change, error, text = WRONG[at]
    given = {"q0": np.zeros(6), "dt": 0.02, "steps": 10, "costs": EFFORT}
    assert arm.optimize(**given).converged
    with pytest.raises(error, match=text):
        arm.optimize(**(given | change))


WRONG_MEASUREMENTS = [
    ({"qd": np.full(6, np.nan)}, NotFiniteError, "^qd: found NaN"),
    ({"qd": np.zeros(5)}, ShapeError, "^qd: "),
    ({"qd": 0.0}, ShapeError, "^qd: "),
    ({"q": np.full(6, np.inf)}, NotFiniteError, "^q: found inf"),
    ({"q": np.zeros((2, 6))}, ShapeError, "^q: "),
]


@pytest.mark.parametrize("at", range(len(WRONG_MEASUREMENTS)))
def test_wrong_measurements_are_refused_by_the_law_and_by_resuming(arm, at):
    change, error, text = WRONG_MEASUREMENTS[at]
    plan = reach(arm, costs=[control.Effort(1.0), control.EffortRate(10.0)], steps=5)
    given = {"q": plan.q[1], "qd": plan.qd[1]} | change
    with pytest.raises(error, match=text):
        plan.policy(1, **given)
    with pytest.raises(error, match=text):
        plan.resume(**given)


def test_wrong_torques_of_the_step_before_are_refused(arm):
    plan = reach(arm, costs=[control.Effort(1.0), control.EffortRate(10.0)], steps=5)
    for before, error in ((np.full(6, np.nan), NotFiniteError), ([1.0], ShapeError)):
        with pytest.raises(error, match="^before: "):
            plan.policy(1, plan.q[1], plan.qd[1], before=before)


WRONG_PATHS = [
    ({"q": np.full((6, 6), np.nan)}, NotFiniteError, "^q: "),
    ({"qd": np.zeros((5, 6))}, ShapeError, "^qd: "),
    ({"tau": np.full((5, 6), np.inf)}, NotFiniteError, "^tau: "),
    ({"tau": np.zeros(6)}, ShapeError, "^"),
    ({"position": -1.0}, ArgumentError, "^position: "),
    ({"velocity": np.nan}, ArgumentError, "^velocity: "),
    ({"effort": [1.0, 2.0]}, ShapeError, "^effort: "),
    ({"end": 0.0}, ArgumentError, "^end: "),
    ({"dt": np.nan}, ArgumentError, "^dt: "),
]


@pytest.mark.parametrize("at", range(len(WRONG_PATHS)))
def test_wrong_paths_name_the_argument(arm, at):
    change, error, text = WRONG_PATHS[at]
    zero = {"q": np.zeros((6, 6)), "qd": np.zeros((6, 6)), "tau": np.zeros((5, 6))}
    given = zero | {"dt": 0.01, "position": 0.1, "velocity": 1.0, "effort": 5.0}
    assert control.tracking(arm, **given).gains.shape == (5, 6, 12)
    with pytest.raises(error, match=text):
        control.tracking(arm, **(given | change))


@pytest.mark.parametrize("name", ["A", "B", "Q", "R"])
@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_numbers_of_a_regulator_that_are_not_finite_are_named(name, wrong):
    given = {"A": np.zeros((1, 1)), "B": np.ones((1, 1)), "Q": 1.0, "R": 1.0}
    with pytest.raises(NotFiniteError, match=f"^{name}: "):
        control.lqr(**(given | {name: np.full((1, 1), wrong)}))


@pytest.mark.parametrize("effort", [50.0, np.full(12, 50.0), np.array([np.full(12, -50.0), np.full(12, 50.0)])])
def test_a_floating_base_has_no_control(effort):
    scene = phipsi.load(phipsi.BUNDLED_ARM, floating_base=True)
    plan = scene.optimize(scene.neutral(), dt=0.02, steps=5, costs=[EFFORT, control.State(velocity=0.1)], effort=effort, limits=False)
    assert (plan.tau[:, :6] == 0.0).all()
    assert (plan.gains[:, :6] == 0.0).all()
    assert (plan.tau[:, 6:] != 0.0).any()


def test_nothing_that_moves_has_a_plan():
    scene = phipsi.SceneBuilder().link("only", 1.0).build()
    plan = scene.optimize([], dt=0.1, steps=3, costs=EFFORT)
    assert plan.converged
    assert plan.q.shape == (4, 0)
    assert plan.gains.shape == (3, 0, 0)
    assert plan.cost == 0.0


def test_inequalities_that_cannot_hold_are_said(arm):
    above = control.NotPositive(control.Function(lambda q, qd, tau: 0.3 - q[:, 1:2]))
    plan = reach(arm, costs=[control.Effort(10.0), above], steps=5)
    assert not plan.converged
    assert "inequalities" in plan.reason
    assert "not converged" in repr(plan)
    assert plan.history[-1].violation > 0.01


def test_wrong_scenes_are_refused_by_name():
    ground = phipsi.SceneBuilder().link("base").link("l", mass=1.0, inertia=np.eye(3)).joint("j", "prismatic", "base", "l", axis="z")
    with pytest.raises(ArgumentError, match="stribeck"):
        ground.build().with_properties(friction=1.0, stribeck=1.0).optimize([1.0], dt=0.02, steps=5, costs=EFFORT)
    scene = four_bar()
    with pytest.raises(ConstraintError, match="closure"):
        scene.optimize([0.4, 0.0, 0.0], dt=0.02, steps=5, costs=EFFORT)


def test_exceptions_of_functions_are_those_of_the_caller(arm):
    calls = []

    def residuals(q, qd, tau):
        calls.append(len(q))
        if len(calls) > 3:
            raise RuntimeError("the caller's own")
        return q

    with pytest.raises(RuntimeError, match="the caller's own"):
        arm.optimize(np.zeros(6), dt=0.02, steps=5, costs=[EFFORT, control.Function(residuals)])


def test_resuming_with_other_terms_is_refused(arm):
    plan = reach(arm)
    with pytest.raises(ArgumentError, match="costs"):
        plan.resume(plan.q[1], plan.qd[1], costs=[control.State(velocity=1.0)])
    with pytest.raises(ArgumentError, match="costs: found 1 terms; expected 4"):
        plan.resume(plan.q[1], plan.qd[1], costs=[control.Effort(10.0)])
    with pytest.raises(ArgumentError, match="k"):
        plan.policy(30, plan.q[0], plan.qd[0])
