"""Maximum a posteriori parameters from accumulated measurements, and their intervals.

Torques are linear in the parameters x: ten per body (mass, first moments, inertia about the link origin) and the
fitted motor parameters. With rows W and measured torques y, both divided by their standard deviations, x minimizes

    1/2 |y - W x|^2 + 1/2 sum over bodies trust (tr(J0^-1 J) - log det J) + 1/2 sum over motors w (x/x0 - log(x/x0))

The 4x4 matrix J, linear in x, holds the second moments of mass of a body. A body is physically consistent if J is
positive definite, which the logarithm ensures. The second sum is a Wishart prior; its mode J0 is the body of the model.
The weight `trust` is the same for all bodies, or one of each. The third is a gamma distribution of armature, damping
and friction with the mode x0 of the model and the weight w = trust (1 if each body has its own). If the model has none,
x0 is a tenth of the value that alone would explain the torques, and w at most 1.
The function is convex. _most_probable minimizes it in coordinates z relative to the prior, J = L Z L^T with J0 = L L^T,
in which the mode of the prior is Z = 1. A parameter of either sign is the difference of two positive ones.

Rows of a log whose residuals are correlated in time count less than as many independent ones. The rows of each motor
are therefore divided by the square root of n/n_eff, the variance of the scores of blocks of time over that of
independent residuals. Otherwise the first term would outweigh the prior where the data say little.

Intervals do not assume independent residuals. With the Hessian H at the minimum, deletion of block g of the log changes
the estimate by d_g = -(H - B_g)^-1 s_g, with the information B_g and the score s_g of the block. The covariance is the
sum of the delete-one-block jackknife, (G - 1)/G sum (d_g - mean)(d_g - mean)^T, and of the contribution of the prior,
H^-1 P H^-1 with the part P of H from the prior. For independent residuals this sum is H^-1.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .._arguments import numbers, whole
from .._install import need_pages
from ..errors import ArgumentError, IdentificationWarning, PhipsiError, ShapeError, of_argument, warn
from ._accumulator import Accumulator, _halved, merged_triangles
from ._base import BaseParameters, Combinations, combinations
from ._checks import checked_time
from ._columns import ASYMMETRIC, PROPERTIES, SIGNED, Columns, Extra, flattened
from ._faults import BEYOND, Clock, beyond_bodies, warn_of_bodies
from ._most_probable import most_probable
from ._problem import UNKNOWN, Problem
from ._student import student_quantile
from ._values import each, positive
from .uncertainty import ParameterCovariance

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["Identification", "solved"]

_Array = NDArray[np.float64]

#: Share of the variance from the data below which the interval of a parameter is the interval of the prior; and the
#: bias, in standard deviations, above which a warning is raised.
DECIDED, BIAS = 0.9, 0.2
#: Smallest and largest weight of the prior, and of the prior of a body if each has its own: with smaller weights beside
#: larger ones the minimum is not found.
WEIGHTS, OF_EACH = (1e-15, 1e15), (1e-6, 1e9)
#: With fewer blocks, intervals assume independent residuals.
FEWEST_BLOCKS = 4
#: Neighboring blocks are merged if the correlation of their scores exceeds the first number, or if they have fewer
#: torques per parameter than the second, until the third number of blocks is reached.
CORRELATED, ROWS, FEWEST_LONG = 0.1, 2.0, 8
#: Weight of the prior with which it is checked whether possible bodies explain the torques.
FLAT = 1e-4


@dataclass(frozen=True, eq=False)
class Identification:
    """Parameters of a robot, estimated from measured torques."""

    columns: Columns = field(repr=False)
    """The linear model."""
    own: _Array = field(repr=False)
    """All parameters in the order of the columns."""
    own_root: _Array = field(repr=False)
    """Root L of the covariance L L^T of all parameters, (parameters, columns)."""
    scene: Scene
    """The robot with the estimates. The inertia of a body belongs to its link in body_names; links fixed to it have
    none."""
    parameters: _Array
    """(m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) of each link of body_names, (bodies, 10); I about the link
    origin, in the link frame."""
    covariance: _Array
    """Covariance of the parameters of the bodies alone, (10 bodies, 10 bodies), from data and prior; zero for kept
    bodies. The parameters of joints and their correlation with the bodies are not part of it: give this object itself
    as `parameters` of Scene.forward_dynamics_variance and others."""
    root: _Array
    """Root L of the covariance L L^T of the parameters of the bodies, (bodies, 10, columns)."""
    share: _Array
    """Share of the variance of each parameter that comes from the data, (bodies, 10). Below 0.9 the interval is the
    interval of the prior; NaN for kept bodies."""
    joints: dict[str, dict[str, float]]
    """Estimates of each kind in `fit` by the name of the joint or motor. The motor "joint5+joint6" has the sum of two
    joint velocities."""
    joint_deviations: dict[str, dict[str, float]]
    """Standard deviations of `joints`."""
    joint_share: dict[str, dict[str, float]]
    """Share of the variance of each of `joints` that comes from the data. Below 0.9 the estimate and its interval are
    those of the prior."""
    base: BaseParameters
    """Base parameters by least squares without the prior, with their intervals."""
    noise: _Array
    """Standard deviation of the torques, (nv,), N m or N: as given, or of the residuals, at least 1.5e-11 of the
    torques; NaN for motors without measured torques."""
    before: _Array
    """Root mean square of measured minus model torques, (nv,), N m or N; NaN for motors without measured torques."""
    after: _Array
    """Root mean square of measured minus estimated torques, (nv,), N m or N."""
    known: int
    """Number of combinations of parameters that the motion determines. It is the number of base parameters if the
    motion excites all joints."""
    blocks: int
    """Number of time blocks of the jackknife; 1 if there are too few states, in which case intervals assume independent
    residuals."""
    states: int
    """Number of states."""
    inflation: _Array
    """n / n_eff of the torques of each motor, (motors,), at least 1: the number of states that count as one, because
    their residuals are correlated in time. The prior is weighed against n_eff states. 1 without a jackknife."""
    clock_offset: float = float("nan")
    """Delay of the torques relative to q, s, estimated from the residuals; NaN without times."""
    clock_deviation: float = float("nan")
    """Standard deviation of `clock_offset`, s, by blocks of time; NaN without times."""
    outliers: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """Number of torques of each motor that were not used, (motors,), because they are outliers."""

    def __repr__(self) -> str:
        rms = [float(np.nanmax(of, initial=0.0)) for of in (self.before, self.after)]
        known = f"{len(self.parameters)} bodies from {self.states} states, {self.known} combinations of parameters known"
        return f"<phipsi.Identification: {known}, residual of torques up to {rms[1]:.3g} (before {rms[0]:.3g})>"

    @property
    def parameter_covariance(self) -> ParameterCovariance:
        """Covariance of the parameters of bodies and joints, which Scene.forward_dynamics_variance, Scene.simulate and
        Scene.momentum_observer use for this object."""
        return ParameterCovariance._of_root(self.columns, self.own_root)

    @property
    def deviations(self) -> _Array:
        """Standard deviations of the parameters, (bodies, 10); zero for kept bodies.

        Parameters that the data do not determine have about the standard deviations of the prior.
        """
        return np.asarray(np.sqrt(np.sum(self.root**2, axis=2)))

    def interval(self, level: float = 0.95) -> tuple[_Array, _Array]:
        """Confidence intervals of the parameters.

        Parameters
        ----------
        level : float, default 0.95
            Probability that the interval contains the parameter.

        Returns
        -------
        lower, upper : (bodies, 10) ndarray
            Ends of the intervals.

        Raises
        ------
        ArgumentError
            A level that is not between 0 and 1.

        Notes
        -----
        The part of the variance that comes from the data has Student's distribution with blocks - 1 degrees of freedom
        (Welch and Satterthwaite). If `share` is below 0.9, the data say little about the parameter, and the interval
        is mostly the assumption about how far robots differ from their models.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> found = scene.identify(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd), noise=0.01)
        >>> lower, upper = found.interval(0.95)
        >>> lower.shape, bool((lower < upper).all())
        ((2, 10), True)
        """
        half = self._quantile(level, self.share) * self.deviations
        return self.parameters - half, self.parameters + half

    def joint_interval(self, level: float = 0.95) -> dict[str, dict[str, tuple[float, float]]]:
        """Confidence intervals of the parameters of joints and motors.

        Parameters
        ----------
        level : float, default 0.95
            Probability that the interval contains the parameter.

        Returns
        -------
        intervals : dict
            (lower, upper) of each kind in `fit` by the name of the joint or motor, as `joints`.

        Raises
        ------
        ArgumentError
            A level that is not between 0 and 1.

        Notes
        -----
        As `interval`: if `joint_share` is below 0.9, the interval is the interval of the prior.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> tau = scene.inverse_dynamics(q, qd, qdd) + 0.3 * qd
        >>> found = scene.identify(q, qd, qdd, tau, fit=["damping"], noise=0.01)
        >>> lower, upper = found.joint_interval()["damping"]["j0"]
        >>> lower < 0.3 < upper
        True
        """
        return {
            kind: {
                name: (value - half, value + half)
                for name, value in values.items()
                for half in [float(self._quantile(level, shares[name])) * self.joint_deviations[kind][name]]
            }
            for kind, values in self.joints.items()
            for shares in [self.joint_share[kind]]
        }

    def _quantile(self, level: float, share: ArrayLike) -> _Array:
        """Half width of an interval in standard deviations."""
        share = np.nan_to_num(share)
        with np.errstate(divide="ignore"):
            degrees = np.where(share > 0.0, max(self.blocks - 1, 1) / share**2, np.inf)
        return student_quantile(level, np.full_like(degrees, np.inf) if self.blocks < FEWEST_BLOCKS else degrees)

    def marks(self, level: float = 0.95) -> tuple[NDArray[np.str_], dict[str, dict[str, str]]]:
        """Marks of estimates for tables: "*" for intervals of the prior, "!" for intervals that reach below zero.

        Parameters
        ----------
        level : float, default 0.95
            Level of the intervals.

        Returns
        -------
        bodies : (bodies, 10) ndarray of str
            Marks of the parameters: "", "*", "!" or "*!". "!" for mass and diagonal entries of the inertia, which are
            positive: the interval is that of a normal distribution, which allows negative values.
        joints : dict
            Marks of `joints`; "!" for armature, damping, Coulomb friction and friction by load, and for Stribeck
            friction and asymmetries with which the friction of a joint is below zero.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> found = scene.identify(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd), noise=0.01)
        >>> str(found.marks()[0][0, 0])  # the mass of the first link has no effect
        '*!'
        """
        below = (self.interval(level)[0] < 0.0) & np.isin(np.arange(10), (0, 4, 6, 9))
        bodies = np.char.add(np.where(self.share < DECIDED, "*", ""), np.where(below, "!", ""))
        joints = {
            kind: {
                name: "*" * (self.joint_share[kind][name] < DECIDED)
                + "!" * (lower < 0.0 if kind not in SIGNED else _least(self.columns, self.joints, kind, name) < 0.0)
                for name, (lower, _) in intervals.items()
            }
            for kind, intervals in self.joint_interval(level).items()
        }
        return bodies, joints

    def torques(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> _Array:
        """Predict measured torques, with friction, offsets and the transmission.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (..., nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.

        Returns
        -------
        torques : (..., motors) ndarray
            Motor torques, N m or N; without a transmission, joint torques.

        Raises
        ------
        ShapeError, NotFiniteError
            An invalid argument. The message names it.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> tau = scene.inverse_dynamics(q, qd, qdd)
        >>> found = scene.identify(q, qd, qdd, tau, noise=0.01)
        >>> bool(np.abs(found.torques(q, qd, qdd) - tau).max() < 0.01)
        True
        """
        batch, states = flattened(self.scene, q, qd, qdd)
        return predicted(self.columns, self.own, *states).reshape(*batch, self.columns.motors)

    def torques_variance(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> _Array:
        """Variances of the predicted torques, caused by the errors of all parameters of bodies and joints.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (..., nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.

        Returns
        -------
        variances : (..., motors) ndarray
            Variances of `torques`, (N m)^2 or N^2. A measured torque differs from the prediction by the noise too:
            its variance is larger by noise**2.

        Raises
        ------
        ShapeError, NotFiniteError
            An invalid argument. The message names it.

        Notes
        -----
        diag(W L L^T W^T) with the rows W of the state and the root L of the covariance of all parameters, which
        contains the correlation of the parameters of joints with those of bodies. Torques are linear in the
        parameters: nothing is approximate.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> tau = scene.inverse_dynamics(q, qd, qdd) + 0.3 * qd
        >>> found = scene.identify(q, qd, qdd, tau, fit=["damping"], noise=0.01)
        >>> bool(np.all(found.torques_variance(q, qd, qdd) < 0.01**2))
        True
        """
        batch, states = flattened(self.scene, q, qd, qdd)
        return predicted(self.columns, self.own_root, *states).reshape(*batch, self.columns.motors)

    def explained_variance(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, tau: ArrayLike) -> _Array:
        """Share of the variance of measured torques that the prediction explains.

        Parameters
        ----------
        q : (k, nq) array_like
            Joint positions, rad or m, of states that were not used for the identification: the share of those that
            were used is larger.
        qd : (k, nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (k, nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        tau : (k, motors) array_like
            Measured motor torques, N m or N; NaN: not measured.

        Returns
        -------
        shares : (motors,) ndarray
            1 - mean((tau - torques)^2) / var(tau) of each motor; NaN for motors without measured torques. Negative if
            the prediction is worse than a constant.

        Raises
        ------
        ShapeError, NotFiniteError
            An invalid argument. The message names it.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 100, 2))
        >>> tau = scene.inverse_dynamics(q, qd, qdd)
        >>> found = scene.identify(q[:50], qd[:50], qdd[:50], tau[:50], noise=0.01)
        >>> bool(np.all(found.explained_variance(q[50:], qd[50:], qdd[50:], tau[50:]) > 0.999))
        True
        """
        measured, torques = self._measured_and_predicted((q, qd, qdd, tau))
        seen = np.isfinite(measured)
        count = np.maximum(seen.sum(axis=0), 1)
        off = np.where(seen, measured - torques, 0.0)
        spread = np.where(seen, measured - np.where(seen, measured, 0.0).sum(axis=0) / count, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = 1.0 - np.sum(off**2, axis=0) / np.sum(spread**2, axis=0)
        return np.asarray(np.where(seen.any(axis=0), shares, np.nan))

    def _measured_and_predicted(self, log: tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike]) -> tuple[_Array, _Array]:
        """Measured torques as the rows determine them, and predicted ones, (k, motors)."""
        q, qd, qdd, tau = log
        torques, measured = self.torques(q, qd, qdd), numbers("tau", tau)
        if measured.shape != torques.shape or torques.ndim != 2:
            expected = f"expected (k, {torques.shape[-1]}), as many states as q has"
            raise of_argument(ShapeError, "tau", f"found shape {measured.shape}; {expected}")
        return self.columns.measured(np.broadcast_to(numbers("q", q), (len(torques), self.scene.nq)), measured), torques

    def residuals(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, tau: ArrayLike) -> _Array:
        """Measured minus predicted torques.

        Parameters
        ----------
        q : (k, nq) array_like
            Joint positions, rad or m.
        qd : (k, nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (k, nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        tau : (k, motors) array_like
            Measured motor torques, N m or N; NaN: not measured.

        Returns
        -------
        residuals : (k, motors) ndarray
            tau - torques, N m or N; NaN where a torque was not measured. With connections, as far as the torques act on
            motions that these allow. `report` draws them over time and speed, with their autocorrelation.

        Raises
        ------
        ShapeError, NotFiniteError
            An invalid argument. The message names it.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> tau = scene.inverse_dynamics(q, qd, qdd)
        >>> found = scene.identify(q, qd, qdd, tau, noise=0.01)
        >>> bool(np.abs(found.residuals(q, qd, qdd, tau)).max() < 0.01)
        True
        """
        measured, torques = self._measured_and_predicted((q, qd, qdd, tau))
        return np.asarray(measured - torques)

    def sample(self, n: int, *, seed: np.random.Generator | int | None = None) -> dict[str, _Array]:
        """Sample models from the uncertainty of the identification, which a physical robot can have.

        Parameters
        ----------
        n : int
            Number of models.
        seed : numpy.random.Generator or int, optional
            Generator or seed; None: unpredictable.

        Returns
        -------
        models : dict of str to array
            Keywords of Scene.simulate of `scene`, as ParameterCovariance.sample returns them.

        Raises
        ------
        ArgumentError
            As ParameterCovariance.sample.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> tau = scene.inverse_dynamics(q, qd, qdd) + 0.2 * qd
        >>> found = scene.identify(q, qd, qdd, tau, fit=["damping"], noise=0.01)
        >>> {name: values.shape for name, values in found.sample(100, seed=0).items()}
        {'inertias': (100, 2, 10), 'damping': (100, 2)}
        """
        return ParameterCovariance(self.scene, self).sample(n, seed=seed)

    def report(
        self,
        file: str | Path,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        tau: ArrayLike,
        *,
        time: ArrayLike | None = None,
        fitted: int | None = None,
    ) -> Path:
        """Write a page with plots: the page of `phipsi identify --report`, in one file.

        It has measured and predicted torques, residuals over time and speed with their autocorrelation and spectrum,
        and the parameters with intervals.

        Parameters
        ----------
        file : str or Path
            File to write, HTML without external resources. Its name without suffix is the title.
        q : (k, nq) array_like
            Joint positions of a log, rad or m.
        qd : (k, nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (k, nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        tau : (k, motors) array_like
            Measured motor torques, N m or N; NaN: not measured.
        time : (k,) array_like, optional
            Times of the states, s; their indices if not given.
        fitted : int, optional
            Number of states, at the beginning of the log, that were used for the identification; the explained variance
            of the others is listed apart. None: all.

        Returns
        -------
        file : Path
            The file.

        Raises
        ------
        ArgumentError, ShapeError, NotFiniteError
            An invalid argument. The message names it.
        ImportError
            The packages for pages are not installed.

        Examples
        --------
        >>> import numpy as np, phipsi, tempfile
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 200, 2))
        >>> tau = scene.inverse_dynamics(q, qd, qdd) + 0.1 * qd
        >>> found = scene.identify(q[:150], qd[:150], qdd[:150], tau[:150], fit=["damping"], noise=0.01)
        >>> folder = tempfile.mkdtemp()
        >>> found.report(f"{folder}/arm.html", q, qd, qdd, tau, fitted=150).name
        'arm.html'
        """
        need_pages()
        # Reports import this module.
        from ..report.identification import IdentificationReport, write_page

        self._measured_and_predicted((q, qd, qdd, tau))
        _, states = flattened(self.scene, q, qd, qdd)
        count = len(states[0])
        times = None if time is None else checked_time(time, count)
        fitted = count if fitted is None else whole("fitted", fitted, 1)
        if fitted > count:
            expected = f"expected at most {count}, the number of states"
            raise of_argument(ArgumentError, "fitted", f"found {fitted}; {expected}")
        log = (*states, numbers("tau", tau))
        return write_page(Path(file), IdentificationReport.of(Path(file).stem, self, log, times, fitted))

    def undecided(self) -> list[tuple[str, str]]:
        """Parameters whose intervals are the intervals of the prior.

        Returns
        -------
        parameters : list of (str, str)
            Link and parameter, for instance ("link1", "m*cx"), then joint or motor and kind, for instance ("joint1",
            "armature"); also those of joints that did not move, which `joints` does not have.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> found = scene.identify(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd), noise=0.01)
        >>> (scene.body_names[0], "m") in found.undecided()
        True
        """
        entries = ("m", "m*cx", "m*cy", "m*cz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
        names = self.scene.body_names
        bodies = [(names[body], entries[entry]) for body, entry in np.argwhere(self.share < DECIDED)]
        return bodies + [
            (extra.name, extra.kind)
            for extra in self.columns.extras
            if self.joint_share[extra.kind].get(extra.name, 0.0) < DECIDED
        ]

    def __str__(self) -> str:
        """Return a summary of a few lines."""
        decided, total = int(np.sum(self.share >= DECIDED)), int(np.sum(np.isfinite(self.share)))
        lines = [
            f"identification from {self.states} states: {self.known} combinations of parameters determined",
            (
                f"intervals by a jackknife of {self.blocks} blocks"
                if self.blocks >= FEWEST_BLOCKS
                else "intervals for independent residuals: too few states for a jackknife"
            ),
            (
                f"{decided} of {total} parameters of bodies are determined by the data; the intervals of the others are"
                " those of the prior"
            ),
        ]
        if self.columns.extras:
            of_joints = sum(one >= DECIDED for shares in self.joint_share.values() for one in shares.values())
            lines.append(f"{of_joints} of {len(self.columns.extras)} parameters of joints are determined by the data")
        if self.outliers.any():
            lines.append(f"{int(self.outliers.sum())} torques were not used, because they are outliers")
        if (below := int(np.sum(np.char.find(self.marks()[0][:, 0], "!") >= 0))) > 0:
            masses = f"{below} of {len(self.parameters)} intervals of masses"
            lines.append(f"{masses} reach below zero, so that they are too wide")
        if np.nanmax(self.inflation) >= 2.0:
            motor = int(np.nanargmax(self.inflation))
            lines.append(
                f"residuals are correlated in time: {self.inflation[motor]:.2g} states of"
                f" {self.columns.motor_names[motor]} count as one"
            )
        ratios = self.base.bias / self.base.deviations
        if np.isfinite(ratios).any():
            worst = float(np.nanmax(np.abs(ratios)))
            lines.append(f"predicted bias by noise in the accelerations: at most {worst:.2g} standard deviations")
        if np.isfinite(self.clock_offset):
            spread = f"{1e3 * self.clock_offset:.3g} +- {1e3 * self.clock_deviation:.2g} ms"
            lines.append(f"torques are {spread} later than positions")
        return "\n".join(lines)


def predicted(columns: Columns, own: _Array, q: _Array, qd: _Array, qdd: _Array, chunk: int = 4096) -> _Array:
    """Motor torques for given parameters, or their variances for a root of the covariance of the parameters, (k,
    motors)."""
    found = np.empty((len(q), columns.motors))
    for begin in range(0, len(q), chunk):
        part = slice(begin, begin + chunk)
        rows, known = columns.rows(q[part], qd[part], qdd[part])
        for motor, (block, used) in enumerate(zip(rows, columns.used, strict=True)):
            torques = block @ own[used]
            found[part, motor] = known[:, motor] + torques if own.ndim == 1 else np.sum(torques**2, axis=1)
    return found


def checked_mass(total_mass: Any) -> tuple[float, float]:
    """Total mass and its standard deviation, kg."""
    given = numbers("total_mass", total_mass)
    if given.shape != (2,) or not (np.isfinite(given).all() and np.all(given > 0.0)):
        expected = "expected the mass of all links of body_names and its standard deviation, kg,"
        expected += " for instance (18.4, 0.1)"
        raise of_argument(ArgumentError, "total_mass", f"found {total_mass}; {expected}")
    return float(given[0]), float(given[1])


#: Message of the error for weights of links.
REFUSED = "found {least}; expected finite numbers above zero, one for each link of body_names"


def checked_trust(scene: Scene, trust: Any, keep: Collection[str] = ()) -> tuple[_Array, float]:
    """Weight of the prior of each body of body_names, (bodies,), and of joint parameters that the scene has."""
    names, scalar = scene.body_names, np.ndim(trust) == 0 and not isinstance(trust, Mapping)
    if isinstance(trust, Mapping):
        for name in trust:
            if name not in names or name in keep:
                other = f"{name!r}, {'a link in keep' if name in keep else 'no link of body_names'}"
                raise of_argument(ArgumentError, "trust", f"found {other}; expected names of links to identify")
        trust = [trust.get(name, 1.0) for name in names]
    if scalar:
        found = np.full(len(names), positive("trust", trust))
    else:
        found = each("trust", trust, len(names), REFUSED, positive=True)
    low, high = WEIGHTS if scalar else OF_EACH
    if len(beyond := found[(found < low) | (found > high)]):
        expected = f"expected {'a weight' if scalar else 'weights'} of {low:g} to {high:g}"
        raise of_argument(ArgumentError, "trust", f"found {beyond[0]:g}; {expected}")
    return found, float(trust) if scalar else 1.0


def solved(
    accumulator: Accumulator,
    noise: ArrayLike | None,
    trust: Any,
    *,
    total_mass: Any = None,
    clock: Clock = Clock(float("nan"), float("nan")),
    outliers: NDArray[np.intp] | None = None,
    check: bool = True,
) -> Identification:
    """Identify the parameters from all states of an accumulator."""
    problem = Problem(accumulator)
    columns = problem.columns
    of_bodies, of_joints = checked_trust(columns.scene, trust, columns.keep)
    weights = problem.deviation() if noise is None else problem.checked_noise(noise)
    # This call merges blocks that are too short.
    base = base_parameters(problem, weights)
    inflation = _inflation(problem, weights)
    tempered = weights * np.sqrt(inflation)
    rows, target = problem.least_squares(tempered)
    triangle = merged_triangles([np.column_stack([rows @ problem.to_own, target])])
    with_mass = triangle
    if total_mass is not None:
        # Knowledge beside the log, as the prior.
        mass, deviation = checked_mass(total_mass)
        own_masses = np.zeros(columns.width)
        own_masses[: 10 * problem.bodies : 10] = 1.0
        row = np.append(own_masses @ problem.to_own, mass - np.sum(columns.own[columns.kept, 0]))
        with_mass = merged_triangles([triangle, row[None] / deviation])
    # Trust in the model is no trust in the parameters that it lacks.
    of_extras = np.where(problem.lacking, min(of_joints, 1.0), of_joints)
    prior = np.concatenate([of_bodies[columns.free], of_extras])
    z, root = most_probable(with_mass[:, :-1], with_mass[:, -1], prior, problem.bodies)
    own = problem.to_own @ z
    by_data, by_prior = _columns_of_covariance(problem, tempered, own, root)
    parameters, own_root = columns.own.copy(), np.concatenate([by_data, by_prior], axis=1)
    full = np.zeros((len(parameters), 10, by_data.shape[1] + by_prior.shape[1]))
    share = np.full(parameters.shape, np.nan)
    for at, body in enumerate(columns.free):
        part = slice(10 * at, 10 * at + 10)
        parameters[body] = own[part]
        full[body] = own_root[part]
        share[body] = np.sum(by_data[part] ** 2, axis=1) / np.sum(full[body] ** 2, axis=1)
    joints: dict[str, dict[str, float]] = {kind: {} for kind in columns.fit}
    spread: dict[str, dict[str, float]] = {kind: {} for kind in columns.fit}
    shares: dict[str, dict[str, float]] = {kind: {} for kind in columns.fit}
    for at in problem.fitted:
        extra = columns.extras[at - 10 * problem.bodies]
        joints[extra.kind][extra.name] = float(own[at])
        variance = float(np.sum(own_root[at] ** 2))
        spread[extra.kind][extra.name] = float(np.sqrt(variance))
        shares[extra.kind][extra.name] = float(np.sum(by_data[at] ** 2)) / variance
    singular = np.linalg.svd(triangle[:, :-1], compute_uv=False)
    blocks = len(problem.blocks) if len(problem.blocks) >= FEWEST_BLOCKS else 1
    found = Identification(
        columns,
        own,
        own_root,
        _scene(columns, parameters, joints),
        parameters,
        _squared(full),
        full,
        share,
        joints,
        spread,
        shares,
        base,
        weights,
        problem.residual(problem.to_own @ problem.model),
        problem.residual(own),
        int(np.sum(singular > UNKNOWN * singular[0])) if singular.size else 0,
        blocks,
        accumulator.states,
        inflation,
        clock.offset,
        clock.deviation,
        np.zeros(columns.motors, dtype=np.intp) if outliers is None else outliers,
    )
    if check:
        _check_bodies(problem, weights, found)
    _warn_of_bias(found)
    return found


def _squared(root: _Array) -> _Array:
    """Covariance L L^T of a root L, (bodies, 10, columns)."""
    flat = root.reshape(-1, root.shape[2])
    return np.asarray(flat @ flat.T)


def _check_bodies(problem: Problem, weights: _Array, found: Identification) -> None:
    """Warn if the residuals of possible bodies exceed those of least squares, with a prior of almost no weight."""
    independent = np.zeros(problem.columns.width)
    independent[_combinations(problem.columns).columns] = found.base.values
    free, after = problem.residual(independent), found.after
    if beyond_bodies(weights, free, after).max(initial=0.0) <= BEYOND:
        return
    rows, target = problem.least_squares(weights)
    try:
        flat = np.full(problem.to_own.shape[1] - 9 * problem.bodies, FLAT)
        z, _ = most_probable(rows @ problem.to_own, target, flat, problem.bodies)
        after = problem.residual(problem.to_own @ z)
    except PhipsiError:
        pass
    if (beyond := beyond_bodies(weights, free, after)).max(initial=0.0) > BEYOND:
        warn_of_bodies(problem.columns.motor_names, beyond, free, after)


def _warn_of_bias(found: Identification) -> None:
    with np.errstate(invalid="ignore"):
        ratios = np.abs(found.base.bias) / found.base.deviations
    if not np.isfinite(ratios).any() or float(np.nanmax(ratios)) <= BIAS:
        return
    worst = int(np.nanargmax(ratios))
    text = (
        f"acceleration_noise: predicts a bias of {ratios[worst]:.2g} standard deviations of"
        f" {found.base.names[worst]!r}, {int(np.sum(ratios > BIAS))} of {len(ratios)} above {BIAS}"
    )
    fix = "give instruments=(q, qd, qdd) of the commanded trajectory, or smooth with a lower cutoff"
    warn(f"{text}; {fix}", IdentificationWarning)


def _columns_of_covariance(problem: Problem, weights: _Array, own: _Array, root: _Array) -> tuple[_Array, _Array]:
    """Columns of a root of the covariance of all parameters: from the data, and from the prior."""
    whole = problem.rows(problem.whole, weights)
    scaled = problem.to_own @ root
    left, right = whole.left @ scaled, whole.right @ scaled
    information = left.T @ (left if problem.projections is not None else right)
    values, vectors = np.linalg.eigh(information)
    # Share of the prior in the Hessian, which is the identity in these coordinates.
    by_prior = scaled @ vectors * np.sqrt(np.clip(1.0 - values, 0.0, 1.0))
    if len(problem.blocks) < FEWEST_BLOCKS:
        return scaled @ vectors * np.sqrt(np.clip(values, 0.0, 1.0)), by_prior
    moved: list[_Array] = []
    for block in problem.blocks:
        rows = problem.rows(block.triangles, weights)
        of_block = (rows.left @ scaled).T
        moved.append(
            np.asarray(
                np.linalg.solve(
                    np.eye(len(information)) - of_block @ (rows.right @ scaled),
                    of_block @ (rows.target - rows.right @ own),
                ),
                float,
            )
        )
    return scaled @ _jackknife(moved), by_prior


def _jackknife(moved: list[_Array]) -> _Array:
    """Columns of a root of the jackknife covariance, from the change of the estimate by deletion of each block."""
    changes = np.array(moved).T
    return np.asarray(np.sqrt((len(moved) - 1) / len(moved)) * (changes - changes.mean(axis=1, keepdims=True)))


class _LeastSquares(NamedTuple):
    """Least squares of the base parameters."""

    root: _Array
    """Root of the inverse of the information, (base, rank)."""
    values: _Array
    """Estimates, (base,)."""
    own: _Array
    """The same as parameters in the order of the columns; the others are zero."""
    determined: NDArray[np.bool_]
    """True for estimates that the log determines, (base,)."""


def _least_squares(problem: Problem, weights: _Array) -> _LeastSquares:
    at = _combinations(problem.columns).columns
    rows, target = problem.least_squares(weights)
    scale = np.linalg.norm(rows[:, at], axis=0)
    determined = scale > 0.0
    scale = np.where(determined, scale, 1.0)
    orthogonal, singular, right = np.linalg.svd(rows[:, at] / scale, full_matrices=False)
    kept = singular > UNKNOWN * singular.max(initial=0.0)
    # Whitening: the estimates are root @ orthogonal^T @ target.
    root: _Array = right[kept].T / singular[kept] / scale[:, None]
    determined &= np.sum(right[kept] ** 2, axis=0) > 1.0 - 1e-6
    own = np.zeros(problem.columns.width)
    own[at] = values = root @ (orthogonal.T[kept] @ target)
    return _LeastSquares(root, values, own, determined)


def _inflation(problem: Problem, weights: _Array) -> _Array:
    """n/n_eff of each motor, (motors,), at least 1: how many rows of a log count as one.

    The score of a block is that of the columns of the motor in coordinates in which its information is the identity.
    Its expected square for independent residuals takes into account that the residuals are those of a fit.
    """
    columns, motors = problem.columns, range(problem.columns.motors)
    if len(problem.blocks) < FEWEST_BLOCKS:
        return np.ones(columns.motors)
    at = _combinations(columns).columns
    fit = _least_squares(problem, weights)
    roots = []
    for motor in motors:
        rows = problem.rows(problem.whole, weights, motor).left
        _, singular, right = np.linalg.svd(rows, full_matrices=False)
        kept = singular > UNKNOWN * singular.max(initial=0.0)
        roots.append(right[kept].T / singular[kept])
    # Squares of the scores, their expectation, squares of the residuals, and their number.
    sums = np.zeros((4, columns.motors))
    for block in problem.blocks:
        for motor in motors:
            part = problem.rows(block.triangles, weights, motor)
            left, right = part.left @ roots[motor], part.right[:, at] @ fit.root
            residual = part.target - part.right @ fit.own
            sums[0, motor] += np.sum((left.T @ residual) ** 2)
            sums[1, motor] += np.sum(left**2) - np.sum((left.T @ right) ** 2)
            sums[2, motor] += np.sum(residual**2)
            sums[3, motor] += block.counts[motor] - np.sum(right**2)
    if columns.connected:
        # Connections mix the residuals of all motors.
        sums = np.broadcast_to(sums.sum(axis=1, keepdims=True), sums.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = sums[0] / sums[1] * sums[3] / sums[2]
    return np.where(np.isfinite(found) & (sums[1] > 0.0) & (sums[3] > 0.0), np.maximum(found, 1.0), 1.0)


def base_parameters(problem: Problem, weights: _Array) -> BaseParameters:
    """Estimate base parameters by least squares, with their covariance and predicted bias."""
    columns = problem.columns
    found: Combinations = _combinations(columns)
    at, count = found.columns, len(found.columns)
    root, values, own, determined = _least_squares(problem, weights)

    def scores() -> Iterator[tuple[_Array, _Array, _Array]]:
        """Yield the whitened columns, left and right, and the score of each block."""
        for block in problem.blocks:
            part = problem.rows(block.triangles, weights)
            of_block = (part.left[:, at] @ root).T
            yield of_block, part.right[:, at] @ root, of_block @ (part.target - part.right @ own)

    torques = float(np.sum(problem.counts))
    while len(problem.blocks) >= 2 * FEWEST_LONG and (
        torques < ROWS * root.shape[1] * len(problem.blocks)
        or _correlation([score for _, _, score in scores()]) > CORRELATED
    ):
        problem.blocks = _halved(problem.blocks)
    moved: list[_Array] = []
    for of_block, right_of_block, score in scores():
        remaining = np.eye(root.shape[1]) - of_block @ right_of_block
        moved.append(np.asarray(np.linalg.lstsq(remaining, score, rcond=None)[0], float))
    by_data = root @ _jackknife(moved) if len(moved) >= FEWEST_BLOCKS else root
    covariance = by_data @ by_data.T
    covariance[~determined, ~determined] = np.inf
    model = columns.own[columns.free].ravel()
    model = found.matrix @ np.append(model, [extra.model for extra in columns.extras])
    names = columns.names()
    degrees = float(len(moved) - 1) if len(moved) >= FEWEST_BLOCKS else np.inf
    bias = (
        _bias(problem, weights, (at, root, values))
        if problem.accumulator.acceleration_noise is not None
        else np.full(count, np.nan)
    )
    return BaseParameters(
        tuple(names[i] for i in at), found.matrix, tuple(names), values, np.asarray(model), covariance, degrees, bias
    )


def _correlation(scores: list[_Array]) -> float:
    """Correlation of the scores of neighboring blocks; about -1 / blocks if they are independent."""
    all_scores = np.array(scores)
    total = float(np.sum(all_scores**2))
    return float(np.sum(all_scores[1:] * all_scores[:-1])) / total if total > 0.0 else 0.0


def _combinations(columns: Columns) -> Combinations:
    """Independent combinations of the columns; cached."""
    if "_combinations" not in columns.__dict__:
        columns.__dict__["_combinations"] = combinations(columns)
    found: Combinations = columns.__dict__["_combinations"]
    return found


def _bias(problem: Problem, weights: _Array, estimate: tuple[NDArray[np.intp], _Array, _Array]) -> _Array:
    """Predicted bias of the base parameters, -(B + X)^-1 X x; zero with instruments.

    B is the information of the motion, and X is the information that acceleration noise adds. The measurements give B +
    X and the biased x' = (B + X)^-1 B x, so that the bias is -B^-1 X x'. The noise also affects torques that are not
    part of the columns, for instance the torques of known armatures.
    """
    at, root, values = estimate
    if problem.projections is not None:
        return np.zeros(len(at))
    parts = []
    for noise, weight, used, count in zip(
        problem.accumulator._noise, weights, problem.columns.used, problem.counts, strict=True
    ):
        if count and len(noise):
            whole = np.zeros((len(noise), problem.columns.width + 1))
            whole[:, np.append(used, problem.columns.width)] = noise / weight
            parts.append(whole[:, np.append(at, problem.columns.width)])
    if not parts:
        return np.zeros(len(at))
    changes = np.concatenate(parts)
    added, known = changes[:, :-1], changes[:, -1]
    scaled = added @ root
    return np.asarray(
        -root
        @ np.linalg.lstsq(np.eye(root.shape[1]) - scaled.T @ scaled, scaled.T @ (added @ values + known), rcond=None)[0]
    )


def _scene(columns: Columns, parameters: _Array, joints: dict[str, dict[str, float]]) -> Scene:
    """Scene with the estimated parameters."""
    values = columns.scene.inertial_parameters.copy()
    values[columns.free] = parameters[columns.free]
    scene = columns.scene.with_inertial_parameters(values)
    properties: dict[str, dict[str, float]] = {}
    shared: list[str] = []
    lacking: list[str] = []
    for extra in columns.extras:
        value = joints.get(extra.kind, {}).get(extra.name)
        if value is None:
            continue
        of_joint = columns.of_joint(extra)
        if of_joint is None:
            (lacking if extra.kind in ASYMMETRIC else shared).append(f"{extra.kind} of {extra.name}")
            continue
        joint, factor = of_joint
        properties.setdefault(PROPERTIES[extra.kind], {})[joint] = value * factor
        if extra.kind == "stribeck":
            properties.setdefault("stribeck_speed", {})[joint] = columns.stribeck
    texts = [f"transmission: a scene has no {', '.join(shared)}, which acts on several joints"] if shared else []
    if lacking:
        texts.append(f"fit: a scene has no {', '.join(lacking)}; its friction is the same in both directions")
    for text in texts:
        warn(f"{text}; Identification.torques includes it, Identification.scene does not", IdentificationWarning)
    _bound_stribeck(columns, joints, properties)
    return scene.with_properties(**properties) if properties else scene


def _bound_stribeck(
    columns: Columns, joints: dict[str, dict[str, float]], properties: dict[str, dict[str, float]]
) -> None:
    """Raise Stribeck friction to the value at which the friction of a joint at rest is zero, which a scene requires."""
    scene, texts = columns.scene, []
    for joint in dict.fromkeys([*properties.get("friction", {}), *properties.get("stribeck", {})]):
        at = scene.v_index(joint).start
        dry = properties.get("friction", {}).get(joint, float(scene.friction[at]))
        stribeck = properties.get("stribeck", {}).get(joint, float(scene.friction_terms[1][at]))
        if dry + stribeck < 0.0:
            properties.setdefault("stribeck", {})[joint] = -dry
            texts.append(f"{joint!r} of {stribeck:.3g} with friction {dry:.3g}")
    if texts:
        found = f"fit: found stribeck of {', '.join(texts)}, with which friction at rest is below zero"
        expected = "expected a sum of zero, as Identification.scene has, or more: check stribeck_speed and fit"
        warn(f"{found}; {expected}; Identification.torques has the estimate", IdentificationWarning)


def _least(columns: Columns, joints: dict[str, dict[str, float]], kind: str, name: str) -> float:
    """Least friction or damping of a motor with its estimate of a signed kind; zero for offsets."""
    base = {"stribeck": "friction", **ASYMMETRIC}.get(kind)
    if base is None:
        return 0.0
    value, total = joints[kind][name], joints.get(base, {}).get(name)
    if total is None:
        # Not fitted: that of the scene.
        rows = next(extra.rows for extra in columns.extras if (extra.kind, extra.name) == (kind, name))
        joint, factor = columns.of_joint(Extra(base, name, rows, 0.0)) or ("", 1.0)
        own = getattr(columns.scene, base)
        total = float(own[columns.scene.v_index(joint).start]) / factor if joint else 0.0
    return total + (value if kind == "stribeck" else -abs(value))
