"""Maximum a posteriori second moments of mass with a Wishart prior, by a primal-dual interior-point method.

The variables z are the entries on and above the diagonal of a symmetric 4x4 matrix Z for each body, then positive
numbers x. The function

    1/2 |target - triangle z|^2 + 1/2 sum trust (tr Z - log det Z) + 1/2 sum trust (x - log x)

is convex, with a weight `trust` of each body and each x. Let S = trust/2 + the gradient of the first term, as matrices.
The gradient of the function is zero if Z S = trust/2 1, and x s = trust/2. The method keeps Z and S positive definite,
linearizes Z S = max(mu, trust/2) 1 in Nesterov-Todd scaling, and decreases mu to the least trust/2. Because both
matrices are updated, the number of steps hardly depends on the distance between start and minimum. Newton's method on Z
alone needs thousands of steps if a body is far from its prior.

mu is the same for all variables, and each stops at its own trust/2. Products that are proportional to the weights on the
whole path, mu trust, would first move variables of large weight to mu times their prior, far from the minimum: with
weights that differ by 1e6 such a path does not return within the steps below.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import PhipsiError

__all__ = ["BASIS", "COLUMNS", "ROWS", "most_probable"]

_Array = NDArray[np.float64]

#: Indices on and above the diagonal of a symmetric 4x4 matrix; basis of symmetric matrices, and its normalized form.
ROWS, COLUMNS = np.triu_indices(4)
BASIS = np.array(
    [[[float({a, b} == {i, j}) for b in range(4)] for a in range(4)] for i, j in zip(ROWS, COLUMNS, strict=True)]
)
ORTHONORMAL = BASIS / np.linalg.norm(BASIS, axis=(1, 2), keepdims=True)
#: Maximum number of steps. Robots need 10 to 60. Torques that contradict every physically consistent body by more than
#: about 1e5 standard deviations can need more.
STEPS = 300
#: Smallest factor of mu per step, the same after a shortened step, and share of the distance to a singular matrix that
#: a step covers at most.
FALL, CAUTIOUS, WITHIN = 0.1, 0.5, 0.95
#: Step lengths, in standard deviations of the result, that end the iteration at the last mu: unconditionally, and if
#: rounding prevents further reduction.
TIGHT, LOOSE = 1e-9, 1e-2


class _Blocks(NamedTuple):
    """Symmetric matrix, or root of one, of each body, and scalar of each other variable."""

    bodies: _Array
    rest: _Array

    @classmethod
    def of(cls, y: _Array, bodies: int) -> _Blocks:
        """Return the blocks with the coordinates y in the orthonormal basis."""
        return cls(np.einsum("bi,ijk->bjk", y[: 10 * bodies].reshape(-1, 10), ORTHONORMAL), y[10 * bodies :])

    def coordinates(self) -> _Array:
        """Inverse of `of`."""
        return np.concatenate([np.einsum("bjk,ijk->bi", self.bodies, ORTHONORMAL).ravel(), self.rest])

    def to_z(self) -> _Array:
        """Derivative of z by y in Z + U Y U^T and x + u^2 y, with these blocks as roots U."""
        found = np.zeros((10 * len(self.bodies) + len(self.rest),) * 2)
        for at, root in enumerate(self.bodies):
            part = slice(10 * at, 10 * at + 10)
            found[part, part] = (root @ ORTHONORMAL @ root.T)[:, ROWS, COLUMNS].T
        rest = np.arange(10 * len(self.bodies), len(found))
        found[rest, rest] = self.rest**2
        return found

    def z(self) -> _Array:
        """Variables z, with these blocks as roots."""
        return np.concatenate([(self.bodies @ _transposed(self.bodies))[:, ROWS, COLUMNS].ravel(), self.rest**2])

    def squares(self) -> _Blocks:
        """Blocks U^T U and u^2, with these blocks as roots."""
        return _Blocks(_transposed(self.bodies) @ self.bodies, self.rest**2)


def _transposed(matrices: _Array) -> _Array:
    return np.swapaxes(matrices, 1, 2)


class _Scaling:
    """Nesterov-Todd scaling: roots U with Z = U Lambda U^T and S = U^-T Lambda U^-1, Lambda diagonal."""

    def __init__(self, primal: _Blocks, dual: _Blocks) -> None:
        left, values, right = np.linalg.svd(_transposed(dual.bodies) @ primal.bodies)
        self.values = _Blocks(values, primal.rest * dual.rest)
        self._halves = np.sqrt(values)
        self.root = _Blocks(
            primal.bodies @ _transposed(right) / self._halves[:, None, :], np.sqrt(primal.rest / dual.rest)
        )
        self._dual = _Blocks(dual.bodies @ left / self._halves[:, None, :], np.sqrt(dual.rest / primal.rest))

    def mean(self, last: _Blocks, mu: float) -> float:
        """Mean of the eigenvalues of Z S, and of x s, of the variables with `last` below mu; zero if there are none."""
        found = np.concatenate([self.values.bodies[last.bodies < mu].ravel(), self.values.rest[last.rest < mu]])
        return float(np.mean(found**2)) if found.size else 0.0

    def diagonal(self, power: int) -> _Blocks:
        """Power of Lambda, as matrices."""
        return _Blocks(self.values.bodies[:, :, None] ** power * np.eye(4), self.values.rest**power)

    def relative(self, change: _Blocks) -> _Array:
        """Eigenvalues of a change of Z or S relative to the matrix itself."""
        scaled = change.bodies / (self._halves[:, :, None] * self._halves[:, None, :])
        return np.concatenate([np.linalg.eigvalsh(scaled).ravel(), change.rest / self.values.rest])

    def moved(self, length: float, primal: _Blocks, dual: _Blocks) -> tuple[_Blocks, _Blocks]:
        """Roots of Z and S after a step that keeps both positive definite."""
        found = []
        for root, change in ((self.root, primal), (self._dual, dual)):
            grown = np.linalg.cholesky(self.diagonal(1).bodies + length * change.bodies)
            found.append(_Blocks(root.bodies @ grown, root.rest * np.sqrt(self.values.rest + length * change.rest)))
        return found[0], found[1]


def most_probable(triangle: _Array, target: _Array, trust: _Array, bodies: int) -> tuple[_Array, _Array]:
    """Return the minimizer, (n,), and a root R, (n, n), of the inverse Hessian R R^T at the minimum.

    `trust` are the weights of the priors, (bodies + others,).
    """
    size, last = triangle.shape[1], _Blocks(0.5 * trust[:bodies], 0.5 * trust[bodies:])
    each = np.concatenate([np.repeat(last.bodies, 10), last.rest])
    primal = _Blocks(np.tile(np.eye(4), (bodies, 1, 1)), np.ones(size - 10 * bodies))
    dual = _start(triangle.T @ (triangle @ primal.z() - target), bodies, each)
    lowest_mu, before, fall, mu = float(each.min()), np.inf, FALL, np.inf
    for _ in range(STEPS):
        scaling = _Scaling(primal, dual)
        mu = max(lowest_mu, fall * scaling.mean(last, mu))
        product = _Blocks(np.maximum(mu, last.bodies)[:, None, None], np.maximum(mu, last.rest))
        scaled = triangle @ scaling.root.to_z()
        center = scaling.diagonal(-1)
        center = _Blocks(product.bodies * center.bodies, product.rest * center.rest)
        pull = each * scaling.root.squares().coordinates() - center.coordinates()
        # A least-squares problem instead of the normal equations, to avoid squaring the condition number.
        rows = np.concatenate([scaled, np.eye(size)])
        orthogonal, upper = np.linalg.qr(rows)
        y = np.linalg.solve(upper, orthogonal.T @ np.concatenate([target - triangle @ primal.z(), -pull]))
        change = _Blocks.of(y, bodies)
        own = scaling.diagonal(1)
        other = _Blocks(center.bodies - own.bodies - change.bodies, center.rest - own.rest - change.rest)
        lowest = min(float(scaling.relative(one).min(initial=0.0)) for one in (change, other))
        length = 1.0 if lowest >= -WITHIN else -WITHIN / lowest
        primal, dual = scaling.moved(length, change, other)
        fall = FALL if length > 0.5 else CAUTIOUS
        moved = float(np.linalg.norm(rows @ y))
        # The iteration also ends if rounding prevents shorter steps.
        if mu == lowest_mu and length == 1.0 and (moved <= TIGHT or (moved <= LOOSE and moved > 0.25 * before)):
            return primal.z(), _root_of_covariance(triangle, primal, 2.0 * each)
        before = moved
    found = (
        f"no minimum in {STEPS} steps (Z S is at {mu:.1e} on the way to {lowest_mu:.1e}, the last step {moved:.1e}"
        " standard deviations)"
    )
    expected = "torques in N m or N with the signs of inverse_dynamics, or noise=... of about the size of the residuals"
    raise PhipsiError(f"identify: found {found}; expected {expected}")


def _start(gradient: _Array, bodies: int, least: _Array) -> _Blocks:
    """Initial root of S, with the norm of the gradient of each body."""
    norms = np.linalg.norm(gradient[: 10 * bodies].reshape(-1, 10), axis=1)
    roots = np.sqrt(least[: 10 * bodies : 10] + norms)[:, None, None] * np.eye(4)
    return _Blocks(roots, np.sqrt(least[10 * bodies :] + np.abs(gradient[10 * bodies :])))


def _root_of_covariance(triangle: _Array, root: _Blocks, trust: _Array) -> _Array:
    """Root of the inverse Hessian with respect to z."""
    # In coordinates in which the second derivative of all priors is 1/2.
    scaled = root.to_z() / np.sqrt(trust)
    _, singular, right = np.linalg.svd(triangle @ scaled)
    variances = np.full(len(right), 2.0)
    variances[: len(singular)] = 1.0 / (singular**2 + 0.5)
    return np.asarray(scaled @ right.T * np.sqrt(variances))
