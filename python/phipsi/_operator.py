"""Linear operators that are applied by sweeps: products, sums, multiples and transposes of the operators of a factor."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from .errors import ArgumentError, ShapeError

if TYPE_CHECKING:
    from ._core import RawFactor

__all__ = ["Array", "Diagonal", "Identity", "Leaf", "Operator"]

Array = NDArray[np.float64]


class Operator(ABC):
    """A linear operator of shape (rows, columns), applied without being formed.

    The operators of a batched factor represent one matrix per configuration; the leading axes broadcast against
    those of the argument. Without a batch, SciPy's solvers accept an operator
    (``scipy.sparse.linalg.aslinearoperator``).

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> f = phipsi.scenes.chain(3).factor([0.1, 0.2, 0.3])
    >>> f.L.shape, (f.L @ np.ones(3)).shape
    ((3, 3), (3,))
    >>> bool(np.allclose(f.L.toarray() @ np.ones(3), f.L @ np.ones(3)))
    True
    """

    #: NumPy then raises TypeError for ``array @ operator`` and ``array - operator`` and does not loop over the entries.
    __array_ufunc__ = None
    dtype = np.dtype(np.float64)

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape

    def matvec(self, x: ArrayLike) -> Array:
        """Apply the operator to vectors.

        Parameters
        ----------
        x : array_like, (..., columns)
            Vectors.

        Returns
        -------
        array
            Products, (..., rows).

        Raises
        ------
        ShapeError
            If the last axis of x is not `columns`.

        Examples
        --------
        >>> import phipsi
        >>> f = phipsi.scenes.chain(3).factor([0.1, 0.2, 0.3])
        >>> f.D.matvec([1.0, 0.0, 0.0]).shape
        (3,)
        """
        return self._apply(x, False)

    def rmatvec(self, x: ArrayLike) -> Array:
        """Apply the transpose to vectors.

        Parameters
        ----------
        x : array_like, (..., rows)
            Vectors.

        Returns
        -------
        array
            Products, (..., columns).

        Raises
        ------
        ShapeError
            If the last axis of x is not `rows`.

        Examples
        --------
        >>> import phipsi
        >>> f = phipsi.scenes.chain(3).factor([0.1, 0.2, 0.3])
        >>> f.H.rmatvec([1.0, 0.0, 0.0]).shape
        (18,)
        """
        return self._apply(x, True)

    def _apply(self, x: ArrayLike, transpose: bool) -> Array:
        """Apply the operator or its transpose to vectors. A user-defined operator overrides `matvec` and `rmatvec`
        instead.
        """
        own = type(self)
        if own.matvec is Operator.matvec or own.rmatvec is Operator.rmatvec:
            raise NotImplementedError(f"{own.__name__}: found no matvec or no rmatvec; expected a user-defined operator to override both")
        return self.rmatvec(x) if transpose else self.matvec(x)

    @abstractmethod
    def toarray(self) -> Array:
        """Form the matrix from its definition.

        Returns
        -------
        array
            Matrix, (..., rows, columns).

        Raises
        ------
        ArgumentError
            If the scene has more than 300 degrees of freedom.

        Examples
        --------
        >>> import phipsi
        >>> phipsi.scenes.chain(3).factor([0.1, 0.2, 0.3]).K.toarray().shape
        (3, 3)
        """

    def inv(self) -> Operator:
        """Inverse operator, if a sweep can apply it: of I, D, M, phi, I + K, I - L and their transposes.

        Returns
        -------
        Operator
            The inverse.

        Raises
        ------
        ArgumentError
            If there is no inverse in O(N).

        Examples
        --------
        >>> import phipsi
        >>> f = phipsi.scenes.chain(3).factor([0.1, 0.2, 0.3])
        >>> str((1 + f.K).inv())
        '(I - L)'
        """
        raise ArgumentError(f"{self}: found no inverse in O(N); expected one of I, D, M, M_inv, phi, I + K, I - L")

    @property
    def T(self) -> Operator:  # noqa: N802 - NumPy's name
        """Transpose."""
        return _Transpose(self)

    def matmat(self, x: ArrayLike) -> Array:
        """Apply the operator to the columns of matrices.

        Parameters
        ----------
        x : array_like, (..., columns, k)
            Matrices.

        Returns
        -------
        array
            Products, (..., rows, k).

        Raises
        ------
        ShapeError
            If the last axis but one of x is not `columns`.

        Examples
        --------
        >>> import numpy as np
        >>> import phipsi
        >>> phipsi.scenes.chain(3).factor([0.1, 0.2, 0.3]).M.matmat(np.eye(3)).shape
        (3, 3)
        """
        columns = np.moveaxis(_core._numbers("x", x), -1, 0)
        batch = self._batch_axes()
        # One leading axis for the columns, then the axes of the batch of the factor.
        lead = max(batch - (columns.ndim - 2), 0)
        columns = columns.reshape(columns.shape[:1] + (1,) * lead + columns.shape[1:])
        return np.moveaxis(self.matvec(columns), 0, -1)

    #: Operators that this one is composed of.
    _parts: tuple[Operator, ...] = ()

    def _batch_axes(self) -> int:
        return max((part._batch_axes() for part in self._parts), default=0)

    @overload
    def __matmul__(self, other: Operator) -> Operator: ...
    @overload
    def __matmul__(self, other: ArrayLike) -> Array: ...
    def __matmul__(self, other: Any) -> Any:
        """Compose with an operator, or multiply a vector (1-D) or matrices (2-D and more) like NumPy's ``@``."""
        if isinstance(other, Operator):
            return _Product(self, other)
        x = _core._numbers("x", other)
        if x.ndim == 0:
            raise ShapeError(f"operator @ x: found a scalar; expected a vector ({self.shape[1]},) or matrices")
        return self.matvec(x) if x.ndim == 1 else self.matmat(x)

    def __add__(self, other: Operator | float) -> Operator:
        """Sum; a scalar is a multiple of the identity, as in the paper's 1 + K."""
        return self._sum(self, other, 1.0)

    def __radd__(self, other: float) -> Operator:
        return self._sum(other, self, 1.0)

    def __sub__(self, other: Operator | float) -> Operator:
        """Difference; a scalar is a multiple of the identity."""
        return self._sum(self, other, -1.0)

    def __rsub__(self, other: float) -> Operator:
        return self._sum(other, self, -1.0)

    def _sum(self, left: object, right: object, sign: float) -> Operator:
        first, second = self._multiple(left), self._multiple(right)
        return NotImplemented if first is None or second is None else _Sum(first, second, sign)

    def _multiple(self, other: object) -> Operator | None:
        """The operator itself, or a scalar times the identity; None for any other type."""
        if isinstance(other, Operator):
            return other
        if not isinstance(other, int | float | np.number):
            return None
        if self.shape[0] != self.shape[1]:
            raise ShapeError(f"{self} and {other}: found shape {self.shape}; expected a square operator in a sum with a scalar")
        identity = Identity(self.shape[0])
        return identity if other == 1 else _Scaled(float(other), identity)

    def __neg__(self) -> Operator:
        return _Scaled(-1.0, self)

    def __mul__(self, factor: float) -> Operator:
        return _Scaled(float(factor), self) if isinstance(factor, int | float | np.number) else NotImplemented

    __rmul__ = __mul__

    def __repr__(self) -> str:
        return f"<operator {self} {self.shape[0]} x {self.shape[1]}>"


class Diagonal(Operator):
    """Diagonal operator with entries (..., n)."""

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
        return Diagonal(1.0 / self._entries, f"({self._name})^-1")

    @property
    def T(self) -> Operator:  # noqa: N802
        """Itself."""
        return self

    def _batch_axes(self) -> int:
        return self._entries.ndim - 1

    def __str__(self) -> str:
        return self._name


class Identity(Diagonal):
    """The identity."""

    def __init__(self, size: int) -> None:
        super().__init__(np.ones(size), "I")

    def inv(self) -> Operator:
        """Itself."""
        return self


class Leaf(Operator):
    """Operator of a factor, by its name on the Rust side."""

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
            return Leaf(self._raw, inverses[self._name])
        if self._name == "D":
            return Diagonal(1.0 / self._raw.pivots(), "D^-1")
        if self._name == "phi":
            return Identity(self.shape[0]) - Leaf(self._raw, "E")
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
        if isinstance(left, Identity) and isinstance(leaf, Leaf) and (leaf._name, self._sign) in partner:
            other: Operator = Leaf(leaf._raw, partner[leaf._name, self._sign])
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
