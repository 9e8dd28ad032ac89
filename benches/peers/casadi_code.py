"""Dynamics of one robot by CasADi: the usual recursions with its symbols, in C, compiled by the system's compiler.

Benchmark for phipsi.compile in benches/compiled.py. The recursions are written for speed: constants are folded before
they are combined with symbols, symmetric matrices have one triangle, the free joint is processed as six rows in
sequence, and CasADi eliminates common subexpressions. Derivatives are CasADi's own, by automatic differentiation. A
batch processes as many states at once as fit in a register of this processor.
"""

import ctypes
import subprocess
import time
from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np
import pinocchio as pin

#: Compilers of CasADi's code; vectorized sine and cosine are included.
FLAGS = ("-O3", "-march=native", "-ffast-math", "-fPIC", "-shared", "-w")


def _columns(joint: pin.JointModel) -> tuple[ca.SX, int]:
    """Columns of the joint's motion subspace in its frame, (angular, linear), and the number of its entries in q."""
    name = joint.shortname()
    if name == "JointModelFreeFlyer":
        return ca.SX(np.roll(np.eye(6), 3, axis=0)), 7
    data = joint.createData()
    joint.calc(data, np.zeros(joint.nq))
    # Pinocchio's order is (linear, angular).
    return ca.SX(ca.sparsify(ca.DM(np.roll(np.asarray(data.S).reshape(6, 1), 3, axis=0)))), 1


def _placement(joint: pin.JointModel, columns: ca.SX, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Rotation from the frame after the joint to that before it, and the offset."""
    if q.numel() == 7:
        x, y, z, w = (q[i] for i in range(3, 7))
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        return ca.vertcat(*(ca.horzcat(*row) for row in rows)), q[:3]
    axis, along = np.array(ca.DM(columns[:3])).ravel(), columns[3:]
    if not axis.any():
        return ca.SX.eye(3), along * q
    s, c = ca.sin(q[0]), ca.cos(q[0])
    around = ca.DM(pin.skew(axis))
    return ca.SX.eye(3) + s * ca.sparsify(around) + (1 - c) * ca.sparsify(around @ around), ca.SX.zeros(3)


class _Body(NamedTuple):
    parent: int
    rows: slice
    columns: ca.SX
    rotation: ca.SX
    offset: ca.SX
    inertia: ca.SX
    velocity: ca.SX
    bias_acceleration: ca.SX


def _to_child(body: _Body, motion: ca.SX) -> ca.SX:
    angular, linear = motion[:3], motion[3:]
    return ca.vertcat(body.rotation.T @ angular, body.rotation.T @ (linear + ca.cross(angular, body.offset)))


def _to_parent(body: _Body, force: ca.SX) -> ca.SX:
    turned = body.rotation @ force[3:]
    return ca.vertcat(body.rotation @ force[:3] + ca.cross(body.offset, turned), turned)


def _inertia_to_parent(body: _Body, inertia: ca.SX) -> ca.SX:
    r, skew = body.rotation, ca.skew(body.offset)
    moment, coupling, mass = (r @ block @ r.T for block in (inertia[:3, :3], inertia[:3, 3:], inertia[3:, 3:]))
    moment, mass = ca.triu2symm(ca.triu(moment)), ca.triu2symm(ca.triu(mass))
    moved = coupling + skew @ mass
    moment = moment + skew @ coupling.T - moved @ skew
    return ca.blockcat([[ca.triu2symm(ca.triu(moment)), moved], [moved.T, mass]])


def _cross_motion(v: ca.SX, m: ca.SX) -> ca.SX:
    return ca.vertcat(ca.cross(v[:3], m[:3]), ca.cross(v[:3], m[3:]) + ca.cross(v[3:], m[:3]))


def _cross_force(v: ca.SX, f: ca.SX) -> ca.SX:
    return ca.vertcat(ca.cross(v[:3], f[:3]) + ca.cross(v[3:], f[3:]), ca.cross(v[:3], f[3:]))


def _bodies(model: pin.Model, q: ca.SX, qd: ca.SX) -> list[_Body]:
    """Placements, inertias and velocities, base to tip; the first joint of the model is the world."""
    bodies: list[_Body] = []
    for k in range(1, model.njoints):
        joint, fixed, inertia = model.joints[k], model.jointPlacements[k], model.inertias[k]
        columns, count = _columns(joint)
        own, along = _placement(joint, columns, q[joint.idx_q : joint.idx_q + count])
        rotation, offset = ca.SX(fixed.rotation) @ own, ca.SX(fixed.translation) + ca.SX(fixed.rotation) @ along
        mass, center = inertia.mass, pin.skew(inertia.lever)
        matrix = np.block([[inertia.inertia - mass * center @ center, mass * center], [-mass * center, mass * np.eye(3)]])
        rows = slice(joint.idx_v, joint.idx_v + joint.nv)
        body = _Body(model.parents[k] - 1, rows, columns, rotation, offset, ca.SX(ca.sparsify(ca.DM(matrix))), ca.SX(), ca.SX())
        relative = columns @ qd[rows]
        velocity = relative if body.parent < 0 else _to_child(body, bodies[body.parent].velocity) + relative
        bodies.append(body._replace(velocity=velocity, bias_acceleration=_cross_motion(velocity, relative)))
    return bodies


def _base(model: pin.Model) -> ca.SX:
    return ca.SX(np.concatenate([np.zeros(3), -model.gravity.linear]))


def forward_dynamics(model: pin.Model, q: ca.SX, qd: ca.SX, tau: ca.SX) -> ca.SX:
    """Articulated-body recursion."""
    bodies = _bodies(model, q, qd)
    inertia = [body.inertia for body in bodies]
    force = [_cross_force(body.velocity, body.inertia @ body.velocity) for body in bodies]
    kept: list[list[tuple[ca.SX, ca.SX, ca.SX]]] = [[] for _ in bodies]
    for k in reversed(range(len(bodies))):
        body, articulated, bias = bodies[k], inertia[k], force[k] + inertia[k] @ bodies[k].bias_acceleration
        for i in reversed(range(body.columns.shape[1])):
            column = body.columns[:, i]
            gain = articulated @ column
            inverse = 1 / ca.dot(column, gain)
            left = tau[body.rows.start + i] - ca.dot(column, bias)
            kept[k].insert(0, (gain, inverse, left))
            articulated = ca.triu2symm(ca.triu(articulated - (gain * inverse) @ gain.T))
            bias = bias + gain * (inverse * left)
        if body.parent >= 0:
            inertia[body.parent] = inertia[body.parent] + _inertia_to_parent(body, articulated)
            force[body.parent] = force[body.parent] + _to_parent(body, bias)
    accelerations: list[ca.SX] = []
    qdd = ca.SX(model.nv, 1)
    for k, body in enumerate(bodies):
        a = _to_child(body, _base(model) if body.parent < 0 else accelerations[body.parent])
        bias = body.bias_acceleration
        for i, (gain, inverse, left) in enumerate(kept[k]):
            qdd[body.rows.start + i] = inverse * (left - ca.dot(gain, a))
            a = a + body.columns[:, i] * qdd[body.rows.start + i]
        accelerations.append(a + bias)
    return qdd


def inverse_dynamics(model: pin.Model, q: ca.SX, qd: ca.SX, qdd: ca.SX) -> ca.SX:
    """Newton-Euler recursion."""
    bodies = _bodies(model, q, qd)
    accelerations: list[ca.SX] = []
    force: list[ca.SX] = []
    for body in bodies:
        a = _to_child(body, _base(model) if body.parent < 0 else accelerations[body.parent])
        accelerations.append(a + body.columns @ qdd[body.rows] + body.bias_acceleration)
        force.append(body.inertia @ accelerations[-1] + _cross_force(body.velocity, body.inertia @ body.velocity))
    tau = ca.SX(model.nv, 1)
    for k in reversed(range(len(bodies))):
        body = bodies[k]
        tau[body.rows] = body.columns.T @ force[k]
        if body.parent >= 0:
            force[body.parent] = force[body.parent] + _to_parent(body, force[k])
    return tau


def _by_each(result: ca.SX, *numbers: ca.SX) -> ca.SX:
    """Derivatives by automatic differentiation, by row of a vector."""
    return ca.horzcat(*(ca.jacobian(result, by).T for by in numbers))


def forward_dynamics_derivatives(model: pin.Model, q: ca.SX, qd: ca.SX, tau: ca.SX) -> ca.SX:
    """With respect to q, qd and tau, concatenated; each joint has one entry of q."""
    return _by_each(forward_dynamics(model, q, qd, tau), q, qd, tau)


def inverse_dynamics_derivatives(model: pin.Model, q: ca.SX, qd: ca.SX, qdd: ca.SX) -> ca.SX:
    """With respect to q, qd and qdd, likewise."""
    return _by_each(inverse_dynamics(model, q, qd, qdd), q, qd, qdd)


_DRIVER = """
#define _POSIX_C_SOURCE 199309L
#include <cmath>
#include <time.h>
#include <cstddef>
typedef double vector_of_lanes __attribute__((vector_size(8 * LANES)));
struct lane {
    vector_of_lanes x;
    lane() = default;
    lane(double c) { for (int i = 0; i < LANES; i++) x[i] = c; }
    lane(vector_of_lanes v) : x(v) {}
};
static inline lane operator+(lane a, lane b) { return a.x + b.x; }
static inline lane operator-(lane a, lane b) { return a.x - b.x; }
static inline lane operator*(lane a, lane b) { return a.x * b.x; }
static inline lane operator/(lane a, lane b) { return a.x / b.x; }
static inline lane operator-(lane a) { return -a.x; }
static inline lane &operator+=(lane &a, lane b) { a.x += b.x; return a; }
static inline lane &operator-=(lane &a, lane b) { a.x -= b.x; return a; }
static inline lane sin(lane a)
{
    alignas(64) double y[LANES];
    for (int i = 0; i < LANES; i++) y[i] = std::sin(a.x[i]);
    lane out;
    for (int i = 0; i < LANES; i++) out.x[i] = y[i];
    return out;
}
static inline lane cos(lane a)
{
    alignas(64) double y[LANES];
    for (int i = 0; i < LANES; i++) y[i] = std::cos(a.x[i]);
    lane out;
    for (int i = 0; i < LANES; i++) out.x[i] = y[i];
    return out;
}
#define casadi_real lane
namespace lanes {
#include "lanes.inc"
}
#undef casadi_real
#define casadi_real double
namespace one {
using std::sin;
using std::cos;
#include "one.inc"
}
static double work[WORK];
static lane lane_work[WORK];
extern "C" void single(const double *q, const double *qd, const double *u, double *out)
{
    const double *arg[8] = {q, qd, u};
    double *res[8] = {out};
    one::f(arg, res, 0, work, 0);
}
static double now()
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * t.tv_sec + t.tv_nsec;
}
/* The least time of one state, ns, over some turns of these states. */
extern "C" double least(size_t count, const double *q, const double *qd, const double *u, double *out)
{
    double shortest = 1e300;
    for (int turn = 0; turn < 2000; turn++) {
        const double begin = now();
        for (size_t i = 0; i < count; i++) single(q + i * NQ, qd + i * NV, u + i * NV, out);
        const double spent = now() - begin;
        if (spent < shortest) shortest = spent;
    }
    return shortest / count;
}
extern "C" void batch(size_t count, const double *q, const double *qd, const double *u, double *out)
{
    lane a[NQ], b[NV], c[NV], r[OUT];
    for (size_t first = 0; first + LANES <= count; first += LANES) {
        for (int l = 0; l < LANES; l++) {
            for (int i = 0; i < NQ; i++) a[i].x[l] = q[(first + l) * NQ + i];
            for (int i = 0; i < NV; i++) { b[i].x[l] = qd[(first + l) * NV + i]; c[i].x[l] = u[(first + l) * NV + i]; }
        }
        const lane *arg[8] = {a, b, c};
        lane *res[8] = {r};
        lanes::f(arg, res, 0, lane_work, 0);
        for (int l = 0; l < LANES; l++)
            for (int i = 0; i < OUT; i++) out[(first + l) * OUT + i] = r[i].x[l];
    }
}
"""


class Compiled(NamedTuple):
    """A compiled function of one robot: for a multiple of the register width, and for one state."""

    code: ctypes.CDLL
    size: int
    seconds: float
    bytes: int

    def batch(self, q: np.ndarray, qd: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Results of all states, (..., size)."""
        out = np.empty((len(q), self.size))
        self.code.batch(ctypes.c_size_t(len(q)), *_addresses(q, qd, u, out))
        return out

    def least(self, q: np.ndarray, qd: np.ndarray, u: np.ndarray) -> float:
        """The shortest time of one state, ns, in C."""
        self.code.least.restype = ctypes.c_double
        out = np.empty(self.size)
        return float(self.code.least(ctypes.c_size_t(len(q)), *_addresses(q, qd, u, out)))


def _addresses(*arrays: np.ndarray) -> list[ctypes.c_void_p]:
    return [ctypes.c_void_p(array.ctypes.data) for array in arrays]


def compiled(model: pin.Model, function: str, directory: Path, lanes: int) -> Compiled:
    """Generate, compile and load a function of this module for one robot; the time includes all of it."""
    begin = time.perf_counter()
    q, qd, u = ca.SX.sym("q", model.nq), ca.SX.sym("qd", model.nv), ca.SX.sym("u", model.nv)
    result = ca.cse(ca.densify(ca.vec(globals()[function](model, q, qd, u))))
    f = ca.Function("f", [q, qd, u], [result])
    for name in ("lanes", "one"):
        generator = ca.CodeGenerator(f"{name}.inc", {"casadi_real": "lane" if name == "lanes" else "double", "with_header": False, "avoid_stack": False})
        generator.add(f)
        # The lines that belong to a separate file.
        lines = [line for line in generator.dump().splitlines() if not line.startswith(('extern "C"', "#ifdef __cplusplus", "#include"))]
        (directory / f"{name}.inc").write_text("\n".join(lines))
    sizes = {"LANES": lanes, "NQ": model.nq, "NV": model.nv, "OUT": result.numel(), "WORK": max(1, f.sz_w())}
    (directory / "robot.cpp").write_text(_DRIVER)
    library = directory / f"{function}.so"
    subprocess.run(["c++", *FLAGS, *(f"-D{name}={value}" for name, value in sizes.items()), "robot.cpp", "-o", str(library)], cwd=directory, check=True)
    seconds = time.perf_counter() - begin
    return Compiled(ctypes.CDLL(str(library)), result.numel(), seconds, library.stat().st_size)
