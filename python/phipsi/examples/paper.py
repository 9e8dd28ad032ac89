"""Rodriguez' paper in order, with every numbered equation typed and checked: ``python -m phipsi.examples paper``.

Each line is one corrected equation: its number, its residual, and its text, which is the evaluated code. The left
side is formed from definitions (``toarray``), the right side is applied by sweeps. If the printed form in the paper
is wrong, a line "as printed" shows its residual. 0.1 and 0.2 are the two definitions in the introduction. ``noise``
is the armature: a covariance of measurement noise, which the paper does not have and which is zero in one of the
scenes.

The scenes are the bundled arm and a small tree without and with armature, for which 5.5, 6.1 and 6.2 need ``across``,
the terms of bodies on different branches. The exit status is 1 if a residual exceeds its bound, or if a misprint has
no effect.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import phipsi
from phipsi.operators import Identity

Array = NDArray[np.float64]

EPS = float(np.finfo(np.float64).eps)
PRINTED_FORM_MARGIN = 1e-3
DRAWS = 2000


class Equation(NamedTuple):
    """A correct equation; the right side printed in the paper, if it is wrong; and the scale of the rounding error."""

    number: str
    left: str
    right: str
    printed: str = ""
    scale: str = ""
    sampled: bool = False


PAPER = {
    "1. Introduction: the spatially random model": [
        Equation("0.1", "f.Q", "body_inertias()", printed="body_inertias(lower_right=1.0)"),
        Equation("0.2", "f.E", "shifts()"),
        Equation("1.1", "x_minus", "f.E @ x_plus + w"),
        Equation("1.2", "x_plus", "x_minus"),
        Equation("1.3", "f.Q", "covariance(W)", sampled=True),
        Equation(
            "1.4",
            "scene.inverse_dynamics(q, qd, qdd)",
            "f.H @ (f.R @ (f.H.T @ qdd)) + noise @ qdd + scene.bias_torque(q, qd)",
            scale="scene.bias_torque(q, qd)",
        ),
        Equation("1.5", "T", "f.H @ (f.phi @ W) + V"),
        Equation("1.6", "np.zeros_like(w)", "W.mean(axis=1)", scale="np.sqrt(np.diag(f.Q.toarray()))", sampled=True),
        Equation("1.7", "inverse(one - f.E)", "f.phi"),
    ],
    "2. Conditional mean estimation": [
        Equation("2.1", "tau - noise @ f.solve(tau - f.H @ (f.phi @ b))", "f.H @ (f.phi @ b + f.G @ (tau - f.H @ (f.phi @ b)))"),
        Equation("2.2", "f.G", "f.phi @ f.Q @ f.phi.T @ f.H.T @ f.M_inv"),
        Equation("2.3", "f.R", "f.phi @ f.Q @ f.phi.T"),
        Equation("2.3", "f.R", "covariance(X)", sampled=True),
        Equation("2.4", "X - f.G @ T", "(one - f.G @ f.H) @ (f.phi @ W) - f.G @ V", scale="X"),
        Equation("2.5", "P", "(one - f.G @ f.H) @ f.R @ (one - f.G @ f.H).T + f.G @ noise @ f.G.T", scale="f.R"),
        Equation("2.5", "P", "covariance(X - f.G @ T)", scale="P", sampled=True),
        Equation("2.6", "P", "(one - f.G @ f.H) @ f.R", scale="f.R"),
        Equation("2.6", "P", "f.R - f.R @ f.H.T @ f.M_inv @ f.H @ f.R", scale="f.R"),
        Equation("2.6", "noise @ f.M_inv @ f.H @ f.R", "f.H @ (one - f.G @ f.H) @ f.R", scale="f.H @ f.R"),
        Equation("2.7", "W_given_T", "f.Q @ f.phi.T @ f.H.T @ f.M_inv @ T"),
        Equation("2.8", "np.linalg.solve(scene.mass_matrix(q), t)", "scene.forward_dynamics(q, qd, tau)"),
        Equation("2.9", "acceleration", "f.phi.T @ (f.H.T @ a)"),
        Equation("2.10", "W_given_T", "f.Q @ (f.phi.T @ (f.H.T @ (f.M_inv @ T)))"),
        Equation("2.11", "covariance(W - W_given_T)", "f.Q - f.Q @ f.phi.T @ f.H.T @ f.M_inv @ f.H @ f.phi @ f.Q", sampled=True),
    ],
    "3. Sequential estimation": [
        Equation("3.1", "f.M", "(f.I + f.K) @ f.D @ (f.I + f.K.T)"),
        Equation("3.2", "inverse(f.I + f.K)", "f.I - f.L"),
        Equation("3.3", "inverse(f.M)", "(f.I - f.L.T) @ f.D.inv() @ (f.I - f.L)"),
        Equation("3.4", "f.R", "r + f.Phi @ r + r @ f.Phi.T"),
        Equation("3.5", "r", "composite_inertias()", printed="composite_inertias(start=0.0)"),
        Equation("3.6", "f.P", "diagonal(f.E @ f.P_plus @ f.E.T) + f.Q"),
        Equation("3.6", "f.D", "f.H @ f.P @ f.H.T + noise"),
        Equation("3.6", "f.P_plus", "f.P - f.P @ f.H.T @ f.D.inv() @ f.H @ f.P", scale="f.P"),
        Equation(
            "3.7",
            "f.R",
            "f.P + f.Phi @ f.P + f.P @ f.Phi.T + f.Phi @ f.P @ f.H.T @ f.D.inv() @ f.H @ f.P @ f.Phi.T",
            printed="f.P_plus + f.Phi @ f.P_plus + f.P_plus @ f.Phi.T + f.Phi @ f.P_plus @ f.H.T @ f.D.inv() @ f.H @ f.P_plus @ f.Phi.T",
        ),
        Equation("3.8", "f.K", "f.H @ f.Phi @ f.P @ f.H.T @ f.D.inv()"),
        Equation("3.9", "f.E", "neighbors(f.Psi)", printed="neighbors(f.Psi_A)"),
        Equation("3.9", "f.A", "one - f.g @ f.H"),
        Equation("3.10", "f.g", "f.P @ f.H.T @ f.D.inv()"),
        Equation("3.11", "f.Psi", "f.E + f.E @ f.A @ f.Psi"),
        Equation("3.12", "f.Psi", "(one - f.Psi @ f.g @ f.H) @ f.Phi", printed="(one - f.g @ f.H) @ f.Phi"),
        Equation("3.12", "f.Psi", "f.Phi @ (one - f.g @ f.H @ f.Psi)"),
        Equation("3.13", "f.I", "(f.I + f.K) @ (f.I - f.L)", scale="f.K"),
        Equation("3.14", "f.L", "f.H @ f.Psi @ f.P @ f.H.T @ f.D.inv()"),
        Equation("3.14", "f.K", "f.L + f.K @ f.L"),
        Equation("3.14", "f.K @ f.L", "f.L @ f.K", scale="f.K"),
    ],
    "4. Filtering and smoothing": [
        Equation("4.1", "a", "(f.I - f.L.T) @ (f.D.inv() @ ((f.I - f.L) @ t))", printed="f.solve(tau)"),
        Equation("4.2", "e_minus", "(f.I - f.L) @ t", printed="(f.I - f.L) @ tau", scale="t"),
        Equation("4.3", "z_minus", "f.Psi @ (f.g @ t)"),
        Equation("4.3", "z_plus", "(one + f.A_Psi) @ (f.g @ t)", printed="f.Psi @ (f.g @ t)"),
        Equation("4.4", "z_minus", "f.E @ z_plus", printed="f.E @ z_plus + b"),
        Equation("4.5", "z_plus", "z_minus + f.g @ e_minus"),
        Equation("4.6", "np.linalg.solve(f.D.toarray(), e_minus)", "f.D.inv() @ e_minus"),
        Equation("4.7", "a", "(f.I - f.L.T) @ e_plus"),
        Equation("4.8", "lambda_plus", "f.Psi.T @ (f.H.T @ e_plus)"),
        Equation("4.8", "lambda_minus", "f.phi.T @ (f.H.T @ a)", printed="f.Psi.T @ (f.H.T @ e_plus)"),
        Equation("4.9", "a", "e_plus - f.g.T @ lambda_plus", printed="e_plus - f.g.T @ lambda_minus"),
        Equation("4.10", "lambda_plus", "f.E.T @ lambda_minus"),
        Equation("4.11", "lambda_minus", "lambda_plus + f.H.T @ a", printed="lambda_plus + f.H.T @ e_plus"),
    ],
    "5. Covariance analysis": [
        Equation("5.1", "f.M", "f.H @ f.R @ f.H.T + noise"),
        Equation("5.1", "f.M", "covariance(T)", sampled=True),
        Equation(
            "5.2", "error_covariance(f.Psi @ f.g)", "f.P + f.Psi_A @ f.P + f.P @ f.Psi_A.T", printed="f.P + f.Psi @ f.P + f.P @ f.Psi.T"
        ),
        Equation("5.2", "covariance(X - f.Psi @ (f.g @ T))", "f.P + f.Psi_A @ f.P + f.P @ f.Psi_A.T", sampled=True),
        Equation(
            "5.2",
            "error_covariance((one + f.A_Psi) @ f.g)",
            "f.P_plus + f.A_Psi @ f.P_plus + f.P_plus @ f.A_Psi.T",
            printed="f.P_plus + f.Psi @ f.P_plus + f.P_plus @ f.Psi.T",
            scale="f.R",
        ),
        Equation(
            "5.2", "covariance(X - (one + f.A_Psi) @ (f.g @ T))", "f.P_plus + f.A_Psi @ f.P_plus + f.P_plus @ f.A_Psi.T", sampled=True
        ),
        Equation("5.3", "trace(error_covariance(f.Psi @ f.g))", "trace(f.P)", printed="trace(f.P_plus)"),
        Equation("5.3", "trace(error_covariance((one + f.A_Psi) @ f.g))", "trace(f.P_plus)", printed="trace(f.P)", scale="trace(f.R)"),
        Equation("5.4", "f.D", "(f.I - f.L) @ f.M @ (f.I - f.L.T)", scale="f.M"),
        Equation("5.4", "f.D", "covariance((f.I - f.L) @ T)", sampled=True),
        Equation("5.5", "f.Phi.T @ f.H.T @ f.M_inv @ f.H @ f.Phi", "f.Psi.T @ f.H.T @ f.D.inv() @ f.H @ f.Psi"),
        Equation(
            "5.5",
            "f.Phi.T @ f.H.T @ f.M_inv @ f.H @ f.Phi",
            "f.Lambda_plus + f.Lambda_plus @ f.A_Psi + f.A_Psi.T @ f.Lambda_plus + across(f.Psi)",
            printed="f.Lambda_plus + f.Lambda_plus @ f.Psi + f.Psi.T @ f.Lambda_plus",
        ),
        Equation(
            "5.5",
            "f.phi.T @ f.H.T @ f.M_inv @ f.H @ f.phi",
            "f.Lambda + f.Lambda @ f.Psi_A + f.Psi_A.T @ f.Lambda + across(f.Psi_A)",
            printed="f.Lambda + f.Lambda @ f.Psi + f.Psi.T @ f.Lambda",
        ),
        Equation("5.5", "f.phi.T @ f.H.T @ f.M_inv @ f.H @ f.phi", "covariance(f.phi.T @ (f.H.T @ (f.M_inv @ T)))", sampled=True),
        Equation("5.6", "f.Lambda", "f.A.T @ f.Lambda_plus @ f.A + f.H.T @ f.D.inv() @ f.H"),
        Equation("5.7", "f.Lambda_plus", "diagonal(f.E.T @ f.Lambda @ f.E)"),
    ],
    "6. Closed-form inertia matrix inverse": [
        Equation(
            "6.1",
            "inverse(f.M)",
            "f.D.inv() + f.g.T @ f.Lambda_plus @ f.g + f.g.T @ f.Psi.T @ (f.A.T @ f.Lambda_plus @ f.g - f.H.T @ f.D.inv())"
            " + (f.g.T @ f.Lambda_plus @ f.A - f.D.inv() @ f.H) @ f.Psi @ f.g + f.g.T @ across(f.Psi) @ f.g",
            printed="f.D.inv() + f.g.T @ f.Lambda @ f.g + f.g.T @ f.Psi.T @ (f.Lambda @ f.g - f.H.T @ f.D.inv())"
            " + (f.g.T @ f.Lambda - f.D.inv() @ f.H) @ f.Psi @ f.g",
        ),
        Equation("6.1", "inverse(f.M)", "scene.mass_matrix_inverse(q)"),
        Equation(
            "6.2",
            "f.S",
            "f.P + f.P @ f.Lambda_plus @ f.P + f.P @ f.Psi.T @ (f.A.T @ f.Lambda_plus @ f.P - one)"
            " + (f.P @ f.Lambda_plus @ f.A - one) @ f.Psi @ f.P + f.P @ across(f.Psi) @ f.P",
            printed="f.P + f.P @ f.Lambda @ f.P + f.P @ f.Psi.T @ (f.Lambda @ f.P - one) + (f.P @ f.Lambda - one) @ f.Psi @ f.P",
            scale="f.P @ f.Lambda_plus @ f.P",
        ),
        Equation("6.2", "inverse(f.M)", "f.D.inv() @ f.H @ f.S @ f.H.T @ f.D.inv() + noise @ f.D.inv() @ f.D.inv()"),
        Equation("6.3", "t", "f.M @ a"),
        Equation("6.4", "a", "f.M_inv @ t"),
    ],
}


class Matrix(phipsi.Operator):
    """A user-defined matrix among the operators of a factor."""

    def __init__(self, entries: Array) -> None:
        super().__init__((entries.shape[0], entries.shape[1]))
        self._entries = entries

    def matvec(self, x: Any) -> Array:
        """Product of the matrix with vectors."""
        return np.asarray(np.asarray(x) @ self._entries.T)

    def rmatvec(self, x: Any) -> Array:
        """Product of the transpose with vectors."""
        return np.asarray(np.asarray(x) @ self._entries)

    def toarray(self) -> Array:
        """The matrix."""
        return self._entries


def block(matrix: Array, i: int, j: int) -> Array:
    """Block (i, j), a view."""
    return matrix[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]


def skew(p: Array) -> Array:
    """p~, with p~ x = p x x."""
    return np.array([[0.0, -p[2], p[1]], [p[2], 0.0, -p[0]], [-p[1], p[0], 0.0]])


def unskew(matrix: Array) -> Array:
    """Vector of a skew-symmetric matrix."""
    return np.array([matrix[2, 1], matrix[0, 2], matrix[1, 0]])


class Paper:
    """Names used in the equations, for one scene at one state."""

    def __init__(self, scene: phipsi.Scene, seed: int) -> None:
        random = np.random.default_rng(seed)
        step, self.qd, self.qdd, self.tau = random.uniform(-1.0, 1.0, (4, scene.nv))
        self.scene, self.q = scene, scene.integrate(scene.neutral(), step)
        self.f = f = scene.factor(self.q)
        self.nv = scene.nv
        self.one = Identity(6 * self.nv)
        self.noise = Matrix(np.diag(np.diag(f.M.toarray() - (f.H @ f.R @ f.H.T).toarray())))
        shifts = f.E.toarray()
        #: The next row toward the base, for each row.
        self.inward = [next((i for i in range(j) if block(shifts, i, j).any()), None) for j in range(self.nv)]
        self.r = self.diagonal(f.R)
        self.condition = float(np.linalg.cond(scene.mass_matrix(self.q)))

        # Generic forces w and b; the torque without the contribution of b(k).
        self.w, self.b = random.uniform(-1.0, 1.0, (2, 6 * self.nv))
        self.x_minus = f.phi @ self.w
        self.x_plus = np.linalg.solve((self.one - f.E).toarray(), self.w)
        self.t = self.tau - scene.bias_torque(self.q, self.qd)
        self.a = np.linalg.solve(scene.mass_matrix(self.q), self.t)
        self.acceleration = np.linalg.solve((self.one - f.E).toarray().T, f.H.toarray().T @ self.a)
        self._filter_and_smoother()

        # Probabilistic model: one column per sample.
        variances, directions = np.linalg.eigh(f.Q.toarray())
        root = directions * np.sqrt(np.maximum(variances, 0.0))
        self.W: Array = root @ random.normal(size=(6 * self.nv, DRAWS))
        self.V: Array = np.sqrt(np.maximum(self.noise.toarray(), 0.0)) @ random.normal(size=(self.nv, DRAWS))
        self.X = f.phi.toarray() @ self.W
        self.T = f.H.toarray() @ self.X + self.V
        cov_xt = f.R.toarray() @ f.H.toarray().T
        self.P = f.R.toarray() - cov_xt @ np.linalg.solve(f.M.toarray(), cov_xt.T)
        self.W_given_T = f.Q.toarray() @ (f.H.toarray() @ f.phi.toarray()).T @ np.linalg.solve(f.M.toarray(), self.T)

    def _filter_and_smoother(self) -> None:
        """4.4 to 4.11 by rows, corrected."""
        shifts, h, g = self.f.E.toarray(), self.f.H.toarray(), self.f.g.toarray()
        self.z_minus, self.z_plus, self.lambda_minus, self.lambda_plus = np.zeros((4, 6 * self.nv))
        self.e_minus = np.zeros(self.nv)
        for k in reversed(range(self.nv)):
            at = slice(6 * k, 6 * k + 6)
            self.z_minus[at] = shifts[at] @ self.z_plus
            self.e_minus[k] = self.t[k] - h[k] @ self.z_minus
            self.z_plus[at] = self.z_minus[at] + g[at, k] * self.e_minus[k]
        self.e_plus = self.e_minus / np.diag(self.f.D.toarray())
        for k in range(self.nv):
            at = slice(6 * k, 6 * k + 6)
            self.lambda_plus[at] = shifts[:, at].T @ self.lambda_minus
            self.lambda_minus[at] = self.lambda_plus[at] + h[k, at] * (self.e_plus[k] - g[at, k] @ self.lambda_plus[at])

    def names(self) -> dict[str, Any]:
        """All names."""
        methods = ("diagonal", "neighbors", "across", "body_inertias", "shifts", "composite_inertias", "error_covariance")
        functions = {name: getattr(self, name) for name in methods}
        return {**vars(self), **functions, "np": np, "inverse": inverse, "covariance": covariance, "trace": trace}

    def _blocks(self, of: Array, keep: Any) -> Matrix:
        kept = np.zeros_like(of)
        for i in range(self.nv):
            for j in range(self.nv):
                if keep(i, j):
                    block(kept, i, j)[:] = block(of, i, j)
        return Matrix(kept)

    def diagonal(self, of: phipsi.Operator) -> Matrix:
        """Diagonal blocks."""
        return self._blocks(of.toarray(), lambda i, j: i == j)

    def neighbors(self, of: phipsi.Operator) -> Matrix:
        """Blocks from each row to the next one inboard."""
        return self._blocks(of.toarray(), lambda i, j: self.inward[j] == i)

    def _path(self, row: int | None) -> Iterator[int]:
        while row is not None:
            yield row
            row = self.inward[row]

    def across(self, transition: phipsi.Operator) -> Matrix:
        """For rows i, j on different branches that meet at c: t(c,i)* Lambda^-(c) t(c,j)."""
        t, outboard = transition.toarray(), self.f.Lambda.toarray()
        total = np.zeros_like(t)
        for i in range(self.nv):
            for j in range(self.nv):
                meet = next((c for c in self._path(i) if c in self._path(j)), None)
                if meet not in (None, i, j):
                    block(total, i, j)[:] = block(t, meet, i).T @ block(outboard, meet, meet) @ block(t, meet, j)
        return Matrix(total)

    def body_inertias(self, lower_right: float | None = None) -> Matrix:
        """Q again, with each M(k) from mass, center of mass and inertia as in the introduction."""
        q = self.f.Q.toarray().copy()
        for k in range(self.nv):
            own = block(q, k, k)
            mass = own[5, 5]
            if mass > 0.0:
                p = skew(unskew(own[:3, 3:] / mass))
                last = (mass if lower_right is None else lower_right) * np.eye(3)
                own[:] = np.block([[own[:3, :3], mass * p], [-mass * p, last]])
        return Matrix(q)

    def shifts(self) -> Matrix:
        """E again, with each phi(k,k-1) from an offset and, because body frames are rotated, a rotation."""
        e = self.f.E.toarray().copy()
        for child, parent in enumerate(self.inward):
            if parent is not None:
                own = block(e, parent, child)
                rotation = own[3:, 3:].copy()
                lever = skew(unskew(own[:3, 3:] @ rotation.T))
                own[:] = np.block([[np.eye(3), lever], [np.zeros((3, 3)), np.eye(3)]]) @ np.kron(np.eye(2), rotation)
        return Matrix(e)

    def composite_inertias(self, start: float = 1.0) -> Matrix:
        """r(k), tip to base; `start` multiplies the inertia of the bodies without children."""
        r, shifts = self.f.Q.toarray().copy(), self.f.E.toarray()
        for k in reversed(range(self.nv)):
            if k not in self.inward:
                block(r, k, k)[:] *= start
            parent = self.inward[k]
            if parent is not None:
                block(r, parent, parent)[:] += block(shifts, parent, k) @ block(r, k, k) @ block(shifts, parent, k).T
        return Matrix(r)

    def error_covariance(self, gain: phipsi.Operator) -> Array:
        """cov(X - gain T), from its definition."""
        gains = gain.toarray()
        left = np.eye(6 * self.nv) - gains @ self.f.H.toarray()
        return np.asarray(left @ self.f.R.toarray() @ left.T + gains @ self.noise.toarray() @ gains.T)


def inverse(of: phipsi.Operator) -> Array:
    """The dense inverse."""
    return np.asarray(np.linalg.inv(of.toarray()), dtype=np.float64)


def covariance(draws: Array) -> Array:
    """Mean of x x* over columns of known mean zero."""
    return np.asarray(draws @ draws.T / draws.shape[1])


def trace(of: phipsi.Operator | Array) -> Array:
    """The trace."""
    return np.array([np.trace(formed(of))])


def formed(value: phipsi.Operator | Array) -> Array:
    """Matrix of an operator from its definition."""
    return value.toarray() if isinstance(value, phipsi.Operator) else np.asarray(value)


def swept(value: phipsi.Operator | Array) -> Array:
    """Matrix of an operator by its sweeps."""
    return value @ np.eye(value.shape[1]) if isinstance(value, phipsi.Operator) else np.asarray(value, dtype=np.float64)


def check(paper: Paper, equation: Equation) -> tuple[float, float, float | None]:
    """Residual, its bound, and the residual of the printed form."""
    names = paper.names()
    left = formed(eval(equation.left, names))  # only the texts above are evaluated
    right = swept(eval(equation.right, names))
    assert left.shape == right.shape, equation
    sizes = [left, right] + ([formed(eval(equation.scale, names))] if equation.scale else [])
    scale = max(float(np.abs(size).max()) for size in sizes)
    residual = float(np.abs(left - right).max()) / scale
    # Rounding; or six standard errors, where a product of two Gaussian variables has at most twice the variance of
    # its factors squared.
    bound = 6.0 * (2.0 / DRAWS) ** 0.5 if equation.sampled else 8.0 * EPS * paper.condition
    if not equation.printed:
        return residual, bound, None
    printed = swept(eval(equation.printed, names))
    return residual, bound, float(np.abs(left - printed).max() / np.abs(left).max())


def tree(armature: float) -> phipsi.Scene:
    """A rotating torso with two arms."""
    builder = phipsi.SceneBuilder().link("base")
    builder.link("torso", mass=3.0, com=(0.02, 0.0, 0.3), inertia=np.diag([0.1, 0.12, 0.05]))
    builder.joint("waist", "revolute", "base", "torso", axis=(0, 0, 1), armature=armature)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        upper, lower = f"{side} upper arm", f"{side} forearm"
        builder.link(upper, mass=1.0, com=(0.02, 0.15 * sign, 0.0), inertia=np.diag([0.01, 0.004, 0.012]))
        builder.link(lower, mass=0.7, com=(0.1, 0.05 * sign, 0.03), inertia=np.diag([0.005, 0.006, 0.004]))
        builder.joint(f"{side} shoulder", "revolute", "torso", upper, xyz=(0, 0.2 * sign, 0.5), axis=(1, 0.3, 0), armature=armature)
        builder.joint(f"{side} elbow", "revolute", upper, lower, xyz=(0, 0.3 * sign, 0.02), axis=(0.2, 0, 1), armature=armature)
    return builder.build()


def main() -> int:
    """Print every equation on every scene; return the number of residuals that exceed their bounds."""
    scenes = {
        "the bundled arm": phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM),
        "a tree": tree(armature=0.0),
        "a tree with armature": tree(armature=0.2),
    }
    failures = 0
    for seed, (name, scene) in enumerate(scenes.items()):
        paper = Paper(scene, seed)
        print(f"\n{name}: {scene.nv} degrees of freedom, condition number of M {paper.condition:.0f}")
        for section, equations in PAPER.items():
            print(f"\n  {section}")
            for equation in equations:
                residual, bound, printed = check(paper, equation)
                wrong = not residual <= bound
                misprint_hidden = printed is not None and not printed > PRINTED_FORM_MARGIN
                failures += wrong + misprint_hidden
                kind = "  sampled" if equation.sampled else ""
                verdict = f"  BEYOND ITS BOUND {bound:.1e}" if wrong else ""
                print(f"  {equation.number:>5}  {residual:7.1e}  {equation.left} = {equation.right}{kind}{verdict}")
                if printed is not None:
                    verdict = "  NOT A MISPRINT HERE" if misprint_hidden else ""
                    print(f"         {printed:7.1e}  as printed: {equation.printed}{verdict}")
    print(f"\n{failures} beyond their bounds" if failures else "\nevery equation holds to rounding (sampled ones to six standard errors)")
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
