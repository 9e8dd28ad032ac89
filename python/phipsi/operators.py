"""The operators of the spatial Kalman filter at a configuration: ``f = scene.factor(q)``, then ``f.K``, ``f.phi``,
``f.D.inv()``.

An operator is applied by a sweep in O(N) and never formed; :meth:`Operator.toarray` forms the matrix, from its
definition and not by the sweep. Products, sums and transposes of operators are operators, so that the equations
of the paper can be written literally: ``(f.I - f.L.T) @ (f.D.inv() @ ((f.I - f.L) @ tau))`` is (4.1). A scalar
in a sum is a multiple of the identity: ``1 - f.g @ f.H``.

Rows are in the order of qd, from base to tip. Therefore phi, psi, K and L are upper triangular here, and lower
triangular in the paper, which counts from the tip.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from ._operator import Array, Identity, Leaf, Operator

if TYPE_CHECKING:
    from ._core import RawFactor

__all__ = ["Factor", "Identity", "Operator"]


class Factor:
    """Factorization M = (1 + K) D (1 + K*) of the mass matrix at one configuration or a batch (3.1), with its
    operators.

    Returned by :meth:`phipsi.Scene.factor`. The filter sweep runs once; each use costs O(N) per right-hand
    side. States are spatial forces in body frames, with one block of six per degree of freedom, in the order of
    qd.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> f = phipsi.scenes.chain(3).factor([0.1, 0.2, 0.3])
    >>> bool(np.allclose(f.mul(f.solve([1.0, 2.0, 3.0])), [1.0, 2.0, 3.0]))
    True
    """

    def __init__(self, raw: RawFactor) -> None:
        self._raw = raw

    def __copy__(self) -> Factor:
        """A copy that is updated independently. Factors and operators can be pickled: as scene, configurations and
        form.
        """
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
        """Joint accelerations M^-1 tau without bias torque, in O(N), by filter and smoother (4.1).

        Parameters
        ----------
        tau : array_like, (..., nv)
            Joint torques, N m or N.

        Returns
        -------
        array
            Joint accelerations, (..., nv), rad/s^2 or m/s^2.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            If tau has a wrong shape or contains values that are not finite real numbers.

        Examples
        --------
        >>> import phipsi
        >>> phipsi.scenes.chain(3).factor([0.1, 0.2, 0.3]).solve([1.0, 0.0, 0.0]).shape
        (3,)
        """
        return self._raw.apply("M_inv", False, tau)

    def mul(self, a: ArrayLike) -> Array:
        """Product of the mass matrix and a, in O(N) (2.8).

        Parameters
        ----------
        a : array_like, (..., nv)
            Joint accelerations, rad/s^2 or m/s^2.

        Returns
        -------
        array
            Joint torques without bias torque, (..., nv), N m or N.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            If a has a wrong shape or contains values that are not finite real numbers.

        Examples
        --------
        >>> import phipsi
        >>> phipsi.scenes.chain(3).factor([0.1, 0.2, 0.3]).mul([1.0, 0.0, 0.0]).shape
        (3,)
        """
        return self._raw.apply("M", False, a)

    def update(self, q: ArrayLike) -> int:
        """Recompute the factor in place for another configuration; the result is bitwise equal to that of a new factor.

        Parameters
        ----------
        q : array_like, (..., nq)
            Configurations, with the leading axes of the factor.

        Returns
        -------
        int
            Number of recomputed bodies, over all configurations.

        Raises
        ------
        SingularJointError
            If a joint is singular; the error names joint and state.
        ShapeError, NotFiniteError, ArgumentError
            If q is invalid. The factor is unchanged after an error.

        Notes
        -----
        phi of a body depends on its own joint; P, D and g depend on the outboard joints. If only some joints
        differ from the configuration of the factor, only their phi and the bodies inboard of them are
        recomputed. This holds for form="covariance"; "auto" and "square-root" estimate the error
        of the whole factor and recompute all of it. The operators of this factor change with it, but not arrays
        and operators that were computed from them before, such as ``D.inv()``.

        Examples
        --------
        >>> import phipsi
        >>> f = phipsi.scenes.chain(3).factor([0.1, 0.2, 0.3])
        >>> f.update([0.2, 0.2, 0.3])
        3
        """
        return self._raw.update(q)

    @property
    def log_det(self) -> Any:
        """Logarithm of the determinant of M, the sum of log D(k): a scalar, or an array of the shape of the batch."""
        return self._raw.log_det()

    @property
    def I(self) -> Operator:  # noqa: E743, N802 - the paper's letter
        """Identity, nv x nv."""
        return Identity(self.nv)

    @property
    def D(self) -> Operator:  # noqa: N802
        """Hinge inertias D = H P H* + armature, diagonal, nv x nv (3.8)."""
        return Leaf(self._raw, "D")

    @property
    def K(self) -> Operator:  # noqa: N802
        """K = H Phi P H* D^-1, nv x nv (3.8)."""
        return Leaf(self._raw, "K")

    @property
    def L(self) -> Operator:  # noqa: N802
        """L = H Psi P H* D^-1, nv x nv (3.14)."""
        return Leaf(self._raw, "L")

    @property
    def M(self) -> Operator:  # noqa: N802
        """Mass matrix M = H R H* + armature, nv x nv (5.1)."""
        return Leaf(self._raw, "M")

    @property
    def M_inv(self) -> Operator:  # noqa: N802
        """Inverse mass matrix (1 - L*) D^-1 (1 - L), nv x nv (3.3)."""
        return Leaf(self._raw, "M_inv")

    @property
    def H(self) -> Operator:  # noqa: N802
        """Output map from spatial forces to joint torques, nv x 6nv (1.5)."""
        return Leaf(self._raw, "H")

    @property
    def E(self) -> Operator:  # noqa: N802
        """Shifts between neighboring bodies, 6nv x 6nv: phi^-1 = 1 - E."""
        return Leaf(self._raw, "E")

    @property
    def phi(self) -> Operator:
        """Transition matrix with unit diagonal, 6nv x 6nv (1.7)."""
        return Leaf(self._raw, "phi")

    @property
    def Phi(self) -> Operator:  # noqa: N802
        """Phi = phi - 1, 6nv x 6nv (3.4)."""
        return Leaf(self._raw, "Phi")

    @property
    def psi(self) -> Operator:
        """The closed-loop transition matrix Psi = (1 - E A)^-1 E, A = 1 - g H, 6nv x 6nv (3.11)."""
        return Leaf(self._raw, "psi")

    @property
    def Psi(self) -> Operator:  # noqa: N802
        """Same as psi; the capital letter is that of the paper."""
        return self.psi

    @property
    def Q(self) -> Operator:  # noqa: N802
        """Process noise covariance: the body inertias M(k), block diagonal, 6nv x 6nv (1.6)."""
        return Leaf(self._raw, "Q")

    @property
    def R(self) -> Operator:  # noqa: N802
        """State covariance phi Q phi*, 6nv x 6nv (2.3)."""
        return Leaf(self._raw, "R")

    @property
    def P(self) -> Operator:  # noqa: N802
        """Articulated inertia P^-, block diagonal, 6nv x 6nv (3.6)."""
        return Leaf(self._raw, "P")

    @property
    def P_plus(self) -> Operator:  # noqa: N802
        """Articulated inertia P^+ after the measurement update, block diagonal, 6nv x 6nv (3.6)."""
        return Leaf(self._raw, "P_plus")

    @property
    def g(self) -> Operator:
        """Kalman gain P H* D^-1, 6nv x nv (3.10)."""
        return Leaf(self._raw, "g")

    @property
    def G(self) -> Operator:  # noqa: N802
        """Batch Kalman gain R H* M^-1, 6nv x nv (2.2)."""
        return Leaf(self._raw, "G")

    @property
    def A(self) -> Operator:  # noqa: N802
        """Projection A = 1 - g H past the joints, block diagonal, 6nv x 6nv (3.9)."""
        return Leaf(self._raw, "A")

    @property
    def Psi_A(self) -> Operator:  # noqa: N802
        """Psi A, from outboard to outboard sides of the joints, 6nv x 6nv: closed loop of 5.2 (predicted) and 5.5
        (lambda^-).
        """
        return Leaf(self._raw, "Psi_A")

    @property
    def A_Psi(self) -> Operator:  # noqa: N802
        """A Psi, from inboard to inboard sides of the joints, 6nv x 6nv: closed loop of 5.2 (filtered) and 5.5
        (lambda^+).
        """
        return Leaf(self._raw, "A_Psi")

    @property
    def Lambda(self) -> Operator:  # noqa: N802
        """Covariance Lambda^- of the co-states outboard of each row, block diagonal, 6nv x 6nv (5.6)."""
        return Leaf(self._raw, "Lambda")

    @property
    def Lambda_plus(self) -> Operator:  # noqa: N802
        """Covariance Lambda^+ of the co-states inboard of each row, block diagonal, 6nv x 6nv (5.7)."""
        return Leaf(self._raw, "Lambda_plus")

    @property
    def S(self) -> Operator:  # noqa: N802
        """Matrix S of M^-1 = D^-1 H S H* D^-1 + armature D^-2, 6nv x 6nv (6.2)."""
        return Leaf(self._raw, "S")

    def __repr__(self) -> str:
        batch = f", batch {self.batch}" if self.batch else ""
        return f"<phipsi.Factor of {self.nv} degrees of freedom{batch}>"
