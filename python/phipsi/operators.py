"""The paper's operators at a configuration, as objects: ``f = scene.factor(q)``, then ``f.K``, ``f.phi``, ``f.D.inv()``.

An operator is applied by a sweep, in O(N), and never formed; :meth:`Operator.toarray` forms it, from its definition and not by
the sweep. Products, sums and transposes of operators are operators, so the paper's equations can be typed as they stand:
``(f.I - f.L.T) @ (f.D.inv() @ ((f.I - f.L) @ tau))`` is (4.1). A number in a sum stands for that many identities: ``1 - f.g @ f.H``.

Rows run in the order of qd, base to tip, so phi, psi, K and L are upper triangular here and lower in the paper, which counts
from the tip.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from .errors import ArgumentError, ShapeError

if TYPE_CHECKING:
    from ._core import RawFactor

Array = NDArray[np.float64]


class Operator(ABC):
    """A linear operator of shape (rows, columns), applied without being formed.

    With the factor of a batch it stands for one matrix a configuration; the leading axes broadcast against those of what it
    is applied to. SciPy's solvers take it (``scipy.sparse.linalg.aslinearoperator``) where there is no batch.
    """

    #: So that ``array @ operator`` and ``array - operator`` are refused here, not looped over by NumPy.
    __array_ufunc__ = None
    dtype = np.dtype(np.float64)

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape

    def matvec(self, x: ArrayLike) -> Array:
        """The operator times vectors: x (..., columns) to (..., rows)."""
        return self._apply(x, False)

    def rmatvec(self, x: ArrayLike) -> Array:
        """The transpose times vectors: x (..., rows) to (..., columns)."""
        return self._apply(x, True)

    def _apply(self, x: ArrayLike, transpose: bool) -> Array:
        """The operator, or its transpose, times vectors. A user's own operator has `matvec` and `rmatvec` instead."""
        own = type(self)
        if own.matvec is Operator.matvec or own.rmatvec is Operator.rmatvec:
            raise NotImplementedError(f"{own.__name__}: found no matvec or no rmatvec; expected both, of an operator of one's own")
        return self.rmatvec(x) if transpose else self.matvec(x)

    @abstractmethod
    def toarray(self) -> Array:
        """The matrix, (..., rows, columns), from definitions. ArgumentError beyond 300 degrees of freedom."""

    def inv(self) -> Operator:
        """The inverse, where there is one that a sweep applies: I, D, M, phi, I + K, I - L and their transposes."""
        raise ArgumentError(f"{self}: found no inverse in O(N); expected one of I, D, M, M_inv, phi, I + K, I - L")

    @property
    def T(self) -> Operator:  # noqa: N802 - NumPy's name
        """The transpose."""
        return _Transpose(self)

    def matmat(self, x: ArrayLike) -> Array:
        """The operator times matrices: x (..., columns, k) to (..., rows, k)."""
        columns = np.moveaxis(_core._numbers("x", x), -1, 0)
        batch = self._batch_axes()
        # One axis in front for the columns, then room for the factor's own axes.
        lead = max(batch - (columns.ndim - 2), 0)
        columns = columns.reshape(columns.shape[:1] + (1,) * lead + columns.shape[1:])
        return np.moveaxis(self.matvec(columns), 0, -1)

    #: The operators that it is made of.
    _parts: tuple[Operator, ...] = ()

    def _batch_axes(self) -> int:
        return max((part._batch_axes() for part in self._parts), default=0)

    @overload
    def __matmul__(self, other: Operator) -> Operator: ...
    @overload
    def __matmul__(self, other: ArrayLike) -> Array: ...
    def __matmul__(self, other: Any) -> Any:
        """Composition with an operator; or the product with a vector (1-D) or matrices (2-D and more), as NumPy's ``@``."""
        if isinstance(other, Operator):
            return _Product(self, other)
        x = _core._numbers("x", other)
        if x.ndim == 0:
            raise ShapeError(f"operator @ x: found a scalar; expected a vector ({self.shape[1]},) or matrices")
        return self.matvec(x) if x.ndim == 1 else self.matmat(x)

    def __add__(self, other: Operator | float) -> Operator:
        """The sum; a number stands for that many identities, as in the paper's 1 + K."""
        return self._sum(self, other, 1.0)

    def __radd__(self, other: float) -> Operator:
        return self._sum(other, self, 1.0)

    def __sub__(self, other: Operator | float) -> Operator:
        """The difference; a number stands for that many identities."""
        return self._sum(self, other, -1.0)

    def __rsub__(self, other: float) -> Operator:
        return self._sum(other, self, -1.0)

    def _sum(self, left: object, right: object, sign: float) -> Operator:
        first, second = self._multiple(left), self._multiple(right)
        return NotImplemented if first is None or second is None else _Sum(first, second, sign)

    def _multiple(self, other: object) -> Operator | None:
        """An operator as it is, a number times the identity; None for anything else."""
        if isinstance(other, Operator):
            return other
        if not isinstance(other, int | float | np.number):
            return None
        if self.shape[0] != self.shape[1]:
            raise ShapeError(f"{self} and {other}: found shape {self.shape}; expected a square operator beside a number")
        identity = Identity(self.shape[0])
        return identity if other == 1 else _Scaled(float(other), identity)

    def __neg__(self) -> Operator:
        return _Scaled(-1.0, self)

    def __mul__(self, factor: float) -> Operator:
        return _Scaled(float(factor), self) if isinstance(factor, int | float | np.number) else NotImplemented

    __rmul__ = __mul__

    def __repr__(self) -> str:
        return f"<operator {self} {self.shape[0]} x {self.shape[1]}>"


class _Diagonal(Operator):
    """A diagonal, (..., n)."""

    def __init__(self, entries: Array, name: str) -> None:
        super().__init__((entries.shape[-1], entries.shape[-1]))
        self._entries = entries
        self._name = name

    def _apply(self, x: ArrayLike, transpose: bool) -> Array:
        vector = _core._numbers("x", x)
        if vector.shape[-1:] != self.shape[1:]:
            raise ShapeError(f"x: found shape {vector.shape}; expected (..., {self.shape[1]})")
        return np.asarray(self._entries * vector)

    def toarray(self) -> Array:
        return np.asarray(self._entries[..., :, None] * np.eye(self.shape[0]))

    def inv(self) -> Operator:
        return _Diagonal(1.0 / self._entries, f"({self._name})^-1")

    @property
    def T(self) -> Operator:  # noqa: N802
        """Itself."""
        return self

    def _batch_axes(self) -> int:
        return self._entries.ndim - 1

    def __str__(self) -> str:
        return self._name


class Identity(_Diagonal):
    """The identity."""

    def __init__(self, size: int) -> None:
        super().__init__(np.ones(size), "I")

    def inv(self) -> Operator:
        """Itself."""
        return self


class _Leaf(Operator):
    """One operator of a factor, by the name that the compiled half knows."""

    def __init__(self, raw: RawFactor, name: str) -> None:
        super().__init__(raw.shape(name))
        self._raw = raw
        self._name = name

    def _apply(self, x: ArrayLike, transpose: bool) -> Array:
        return self._raw.apply(self._name, transpose, x)

    def toarray(self) -> Array:
        return self._raw.dense(self._name)

    def _batch_axes(self) -> int:
        return len(self._raw.batch)

    def inv(self) -> Operator:
        inverses = {"M": "M_inv", "M_inv": "M"}
        if self._name in inverses:
            return _Leaf(self._raw, inverses[self._name])
        if self._name == "D":
            return _Diagonal(1.0 / self._raw.pivots(), "D^-1")
        if self._name == "phi":
            return Identity(self.shape[0]) - _Leaf(self._raw, "E")
        return super().inv()

    def __str__(self) -> str:
        return self._name


class _Transpose(Operator):
    def __init__(self, base: Operator) -> None:
        super().__init__((base.shape[1], base.shape[0]))
        self._base, self._parts = base, (base,)

    def _apply(self, x: ArrayLike, transpose: bool) -> Array:
        return self._base._apply(x, not transpose)

    def toarray(self) -> Array:
        return np.swapaxes(self._base.toarray(), -1, -2)

    def inv(self) -> Operator:
        return self._base.inv().T

    @property
    def T(self) -> Operator:  # noqa: N802
        return self._base

    def __str__(self) -> str:
        return f"{self._base}*"


class _Product(Operator):
    def __init__(self, left: Operator, right: Operator) -> None:
        if left.shape[1] != right.shape[0]:
            raise ShapeError(f"{left} @ {right}: found shapes {left.shape} and {right.shape}; expected equal inner sizes")
        super().__init__((left.shape[0], right.shape[1]))
        self._parts = left, right

    def _apply(self, x: ArrayLike, transpose: bool) -> Array:
        last, first = reversed(self._parts) if transpose else self._parts
        return last._apply(first._apply(x, transpose), transpose)

    def toarray(self) -> Array:
        left, right = self._parts
        return np.asarray(left.toarray() @ right.toarray())

    def inv(self) -> Operator:
        left, right = self._parts
        return right.inv() @ left.inv()

    def __str__(self) -> str:
        return " ".join(map(str, self._parts))


class _Sum(Operator):
    def __init__(self, left: Operator, right: Operator, sign: float) -> None:
        if left.shape != right.shape:
            raise ShapeError(f"{left} and {right}: found shapes {left.shape} and {right.shape}; expected equal shapes")
        super().__init__(left.shape)
        self._parts, self._sign = (left, right), sign

    def _apply(self, x: ArrayLike, transpose: bool) -> Array:
        left, right = (part._apply(x, transpose) for part in self._parts)
        return np.asarray(left + self._sign * right)

    def toarray(self) -> Array:
        left, right = (part.toarray() for part in self._parts)
        return np.asarray(left + self._sign * right)

    def inv(self) -> Operator:
        """(1 + K)^-1 = 1 - L (3.2, 3.13) and the other way round, and of their transposes."""
        left, right = self._parts
        transposed = isinstance(right, _Transpose)
        leaf = right._base if isinstance(right, _Transpose) else right
        partner = {("K", 1.0): "L", ("L", -1.0): "K", ("E", -1.0): "Phi"}
        if isinstance(left, Identity) and isinstance(leaf, _Leaf) and (leaf._name, self._sign) in partner:
            other: Operator = _Leaf(leaf._raw, partner[leaf._name, self._sign])
            other = other.T if transposed else other
            return left - other if leaf._name == "K" else left + other
        return super().inv()

    def __str__(self) -> str:
        left, right = self._parts
        return f"({left} {'+' if self._sign > 0 else '-'} {right})"


class _Scaled(Operator):
    def __init__(self, factor: float, base: Operator) -> None:
        super().__init__(base.shape)
        self._factor, self._base, self._parts = factor, base, (base,)

    def _apply(self, x: ArrayLike, transpose: bool) -> Array:
        return np.asarray(self._factor * self._base._apply(x, transpose))

    def toarray(self) -> Array:
        return np.asarray(self._factor * self._base.toarray())

    def inv(self) -> Operator:
        return _Scaled(1.0 / self._factor, self._base.inv())

    def __str__(self) -> str:
        return f"{self._factor:g} {self._base}"


class Factor:
    """M = (1 + K) D (1 + K*) at one configuration or a batch of them (3.1), and the operators it is made of.

    Made by :meth:`phipsi.Scene.factor`. The sweep is done once; every use is O(N) a right-hand side. States are spatial forces
    in body frames, one block of six a degree of freedom, in the order of qd.
    """

    def __init__(self, raw: RawFactor) -> None:
        self._raw = raw

    def __copy__(self) -> Factor:
        """A factor that is updated by itself; factors and operators pickle, as scene, configurations and form."""
        return Factor(copy.copy(self._raw))

    @property
    def nv(self) -> int:
        """Number of degrees of freedom."""
        return self._raw.nv

    @property
    def batch(self) -> tuple[int, ...]:
        """Leading axes of the configurations."""
        return self._raw.batch

    def solve(self, tau: ArrayLike) -> Array:
        """M^-1 tau by filter and smoother (4.1): (..., nv) to (..., nv), N m to rad/s^2. No bias enters."""
        return self._raw.apply("M_inv", False, tau)

    def mul(self, a: ArrayLike) -> Array:
        """M a by sweeps (2.8): (..., nv) to (..., nv), rad/s^2 to N m."""
        return self._raw.apply("M", False, a)

    def update(self, q: ArrayLike) -> int:
        """Moves the factor to the configuration q, (..., nq) with the leading axes it was made with, to the bits of a new one.

        A body's phi depends on its own joint, its P, D and g on the joints that it carries: where only some joints differ from the factor's
        configuration, only their phi and what carries them is computed. So it is for form="covariance"; "auto" and
        "square-root" judge the factor as a whole and compute it anew. Operators of this factor follow, but not what was computed
        from them (arrays, and ``D.inv()``, which holds numbers).

        Returns how many bodies were computed anew, over all configurations.

        Raises SingularJointError, naming joint and state; ShapeError, NotFiniteError or ArgumentError for a bad q. The factor is as it was then.
        """
        return self._raw.update(q)

    @property
    def log_det(self) -> Any:
        """log det M = sum of log D(k): a number, or an array of the batch's shape."""
        return self._raw.log_det()

    @property
    def I(self) -> Operator:  # noqa: E743, N802 - the paper's letter
        """The identity, nv x nv."""
        return Identity(self.nv)

    @property
    def D(self) -> Operator:  # noqa: N802
        """Hinge inertia D = H P H* + armature, diagonal, nv x nv (3.8)."""
        return _Leaf(self._raw, "D")

    @property
    def K(self) -> Operator:  # noqa: N802
        """K = H Phi P H* D^-1, nv x nv (3.8)."""
        return _Leaf(self._raw, "K")

    @property
    def L(self) -> Operator:  # noqa: N802
        """L = H Psi P H* D^-1, nv x nv (3.14)."""
        return _Leaf(self._raw, "L")

    @property
    def M(self) -> Operator:  # noqa: N802
        """The mass matrix H R H* + armature, nv x nv (5.1)."""
        return _Leaf(self._raw, "M")

    @property
    def M_inv(self) -> Operator:  # noqa: N802
        """Its inverse (1 - L*) D^-1 (1 - L), nv x nv (3.3)."""
        return _Leaf(self._raw, "M_inv")

    @property
    def H(self) -> Operator:  # noqa: N802
        """The state-to-output map, nv x 6nv (1.5)."""
        return _Leaf(self._raw, "H")

    @property
    def E(self) -> Operator:  # noqa: N802
        """The shifts between neighbours alone, 6nv x 6nv: phi^-1 = 1 - E."""
        return _Leaf(self._raw, "E")

    @property
    def phi(self) -> Operator:
        """The transition matrix with the identity diagonal, 6nv x 6nv (1.7)."""
        return _Leaf(self._raw, "phi")

    @property
    def Phi(self) -> Operator:  # noqa: N802
        """Phi = phi - 1, 6nv x 6nv (3.4)."""
        return _Leaf(self._raw, "Phi")

    @property
    def psi(self) -> Operator:
        """The closed-loop transition matrix Psi = (1 - E A)^-1 E, A = 1 - g H, 6nv x 6nv (3.11)."""
        return _Leaf(self._raw, "psi")

    @property
    def Psi(self) -> Operator:  # noqa: N802
        """The same as psi, by the paper's capital."""
        return self.psi

    @property
    def Q(self) -> Operator:  # noqa: N802
        """Process noise: the bodies' inertias M(k), block diagonal, 6nv x 6nv (1.6)."""
        return _Leaf(self._raw, "Q")

    @property
    def R(self) -> Operator:  # noqa: N802
        """State covariance phi Q phi*, 6nv x 6nv (2.3)."""
        return _Leaf(self._raw, "R")

    @property
    def P(self) -> Operator:  # noqa: N802
        """Articulated inertia P^-, block diagonal, 6nv x 6nv (3.6)."""
        return _Leaf(self._raw, "P")

    @property
    def P_plus(self) -> Operator:  # noqa: N802
        """Articulated inertia P^+ after the measurement, block diagonal, 6nv x 6nv (3.6)."""
        return _Leaf(self._raw, "P_plus")

    @property
    def g(self) -> Operator:
        """Kalman gain P H* D^-1, 6nv x nv (3.10)."""
        return _Leaf(self._raw, "g")

    @property
    def G(self) -> Operator:  # noqa: N802
        """Batch Kalman gain R H* M^-1, 6nv x nv (2.2)."""
        return _Leaf(self._raw, "G")

    @property
    def A(self) -> Operator:  # noqa: N802
        """A = 1 - g H, block diagonal, 6nv x 6nv: what a measurement lets pass (3.9)."""
        return _Leaf(self._raw, "A")

    @property
    def Psi_A(self) -> Operator:  # noqa: N802
        """Psi A, from outboard side to outboard side, 6nv x 6nv: the closed loop of 5.2 (predicted) and 5.5 (lambda^-)."""
        return _Leaf(self._raw, "Psi_A")

    @property
    def A_Psi(self) -> Operator:  # noqa: N802
        """A Psi, from inboard side to inboard side, 6nv x 6nv: the closed loop of 5.2 (filtered) and 5.5 (lambda^+)."""
        return _Leaf(self._raw, "A_Psi")

    @property
    def Lambda(self) -> Operator:  # noqa: N802
        """Covariance Lambda^- of the co-states outboard of each row, block diagonal, 6nv x 6nv (5.6)."""
        return _Leaf(self._raw, "Lambda")

    @property
    def Lambda_plus(self) -> Operator:  # noqa: N802
        """Covariance Lambda^+ of the co-states inboard of each row, block diagonal, 6nv x 6nv (5.7)."""
        return _Leaf(self._raw, "Lambda_plus")

    @property
    def S(self) -> Operator:  # noqa: N802
        """S of M^-1 = D^-1 H S H* D^-1 + armature D^-2, 6nv x 6nv (6.2)."""
        return _Leaf(self._raw, "S")

    def __repr__(self) -> str:
        batch = f", batch {self.batch}" if self.batch else ""
        return f"<phipsi.Factor of {self.nv} degrees of freedom{batch}>"
