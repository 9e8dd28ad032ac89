//! Methods of `Scene`: identification of its parameters from logs, and what it needs of compiled code.

#![allow(clippy::needless_pass_by_value)] // PyO3 hands arrays over

use super::interrupts::detached;
use super::object::{Object, imported};
use super::products::{parameters_of, places_of_links};
use super::scene::PyScene;
use crate::estimation::log_smoother::Log;
use crate::estimation::triangle;
use numpy::{
    IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadwriteArray2, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Rough times in one state, ns: of a body with its motion, and of two degrees of freedom.
const BODY: usize = 100;
const PAIR: usize = 30;

#[pymethods]
impl PyScene {
    /// The joint torque regressor Y: torques are linear in the inertial parameters, inverse_dynamics(q, qd, qdd) = Y pi + armature qdd.
    ///
    /// q: (..., nq); qd, qdd: (..., nv); SI units, radians; leading axes broadcast. errors: as in forward_dynamics.
    ///
    /// Entry (i, b, p) is the derivative of torque i by parameter p of the link body_names[b], with what is fixed onto it: the parameters are
    /// (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz), in the axes of the link, I about the link's origin, as in Identification.parameters. It is zero where the link is
    /// not outboard of the joint. Computed in O(N depth).
    ///
    /// Returns (..., nv, bodies, 10).
    ///
    /// Raises ArgumentError for a scene with connections; ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    ///
    /// >>> import phipsi
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> scene.regressor([0.1, 0.2, 0.3], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]).shape
    /// (3, 3, 10)
    #[pyo3(signature = (q, qd, qdd, *, errors="raise"))]
    fn regressor<'py>(
        slf: &Bound<'py, Self>,
        q: &Object<'py>,
        qd: &Object<'py>,
        qdd: &Object<'py>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let py = slf.py();
        imported!(py, "phipsi._arguments", "check_tree")?.call1((slf, "regressor"))?;
        let this = slf.get();
        this.check_dense("regressor", "inverse_dynamics_vjp(..., parameters=True)")?;
        let (nv, links) = (this.scene.nv(), places_of_links(&this.scene)?);
        let (bodies, shape) = (this.scene.model().bodies.len(), [nv, links.len(), 10]);
        let cost = (BODY + PAIR * nv) * this.size();
        this.each(
            py,
            [("q", q), ("qd", qd), ("qdd", qdd)],
            &shape,
            cost,
            errors,
            |scene, scratch, [q, qd, qdd], out| {
                let (regressor, of_bodies) = scratch.for_regressors(scene);
                of_bodies.resize(nv * bodies * 10, 0.0);
                scene.regressor(regressor, q, qd, qdd, of_bodies)?;
                let rows = of_bodies.as_chunks::<10>().0.chunks_exact(bodies.max(1));
                for (to, row) in out.chunks_exact_mut((10 * links.len()).max(1)).zip(rows) {
                    for (to, own) in to.as_chunks_mut::<10>().0.iter_mut().zip(parameters_of(&links, row)) {
                        *to = own;
                    }
                }
                Ok(())
            },
        )
    }

    /// The most probable inertias, and what acts at the joints, from measured motion and torques, with intervals that hold for noise of any spectrum.
    ///
    /// Each body gets inertias that a body can have: maximum a posteriori with a Wishart prior on its second moments of mass, which is convex. Intervals are by the
    /// delete-one-block jackknife over blocks of time, so that they hold where residuals are correlated, which those of real robots are.
    ///
    /// Parameters
    /// ----------
    /// q : (k, nq) array_like
    ///     Positions, rad or m, in the order of time.
    /// qd, qdd : (k, nv) array_like
    ///     Velocities and accelerations, for instance of `phipsi.smooth`.
    /// tau : (k, nv) array_like
    ///     Measured torques, N m or N; NaN where one was not measured. With `transmission`: of the motors, (k, motors).
    /// fit : collection of str
    ///     What is found beside inertias, of "armature", "damping", "friction", "offset", "stribeck" (friction that falls with velocity) and "load" (friction proportional to the
    ///     torque that the joint carries). What is not fitted is the model's: its armature, damping, friction and springs are part of the torques.
    /// noise : array_like, optional
    ///     Standard deviation of the torques, one number or one per torque: the weights. None: that of the residuals of least squares, which takes at least twice as many
    ///     measured torques as there are parameters that they determine.
    /// trust : float
    ///     Weight of the model's own inertias: each parameter is expected within about 1 / sqrt(trust) of them, relatively.
    /// keep : collection of str
    ///     Names of body_names whose inertias stay.
    /// friction_speed : float
    ///     Velocity below which dry friction becomes viscous, rad/s or m/s.
    /// stribeck_speed : float
    ///     Velocity at which the friction of "stribeck" has fallen to 1/e.
    /// time : (k,) array_like, optional
    ///     Times of the rows, s, rising. With them gaps, repeated times, units that disagree, and clocks of q and tau that disagree are found and reported.
    /// transmission : (motors, nv) array_like, optional
    ///     B of motor velocities = B qd, motors = nv: joint torques are B^T times those of the motors. Armature, damping, friction, offsets and noise are then the motors'.
    /// tau_delay : float
    ///     How much later than q the torques are, s; they are shifted back by linear interpolation. Needs `time`.
    /// acceleration_noise : array_like, optional
    ///     Standard deviation of the noise in qdd, (nv,), as `phipsi.smooth(...).acceleration_noise` has it: predicts the bias that it causes.
    /// instruments : tuple of array_like, optional
    ///     (q, qd, qdd) of the trajectory that was commanded: instrumental variables, which remove the bias by noise in the measured motion.
    /// blocks : int
    ///     The number of blocks of time of the jackknife. Each should be longer than half the correlation time of the residuals: where neighboring blocks are correlated, or have fewer than two torques per parameter, they are
    ///     merged, down to eight.
    ///
    /// Returns
    /// -------
    /// phipsi.Identification
    ///     The new scene, parameters, intervals, base parameters, residuals, and the share of each parameter that the data decide.
    ///
    /// Raises
    /// ------
    /// ArgumentError
    ///     Too few measurements, unknown names, times that fall, noise below the rounding of the torques, and bodies of the model without mass.
    /// ShapeError, NotFiniteError
    ///     Arrays of wrong shapes, and numbers that are not finite.
    ///
    /// Warns
    /// -----
    /// LogWarning
    ///     Units and clocks that disagree; gaps and repeated times.
    /// IdentificationWarning
    ///     A predicted bias above 0.2 standard deviations.
    /// InertiaWarning
    ///     Bodies of the model whose inertia no body can have: they start from the nearest that one can have.
    ///
    /// Notes
    /// -----
    /// States are read in blocks: memory does not grow with k. For logs that do not fit into memory: phipsi.estimation.Accumulator.
    #[pyo3(signature = (q, qd, qdd, tau, **how),
           text_signature = "($self, q, qd, qdd, tau, *, fit=(), noise=None, trust=1.0, keep=(), friction_speed=0.01, stribeck_speed=0.1, time=None, transmission=None, tau_delay=0.0, acceleration_noise=None, instruments=None, blocks=20)")]
    fn identify<'py>(
        slf: &Bound<'py, Self>,
        q: &Object<'py>,
        qd: &Object<'py>,
        qdd: &Object<'py>,
        tau: &Object<'py>,
        how: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Object<'py>> {
        imported!(slf.py(), "phipsi.estimation._identify", "identify")?.call((slf, q, qd, qdd, tau), how)
    }

    /// A periodic trajectory that excites the parameters: Fourier series within limits, whose determinant of the information matrix is largest (D-optimal).
    ///
    /// Parameters
    /// ----------
    /// duration : float
    ///     Length of the trajectory, s: one period.
    /// limits : phipsi.Limits, optional
    ///     Limits of position, velocity and torque. None: those of the scene. Where one is infinite, positions stay within 1 rad or 0.2 m of the middle.
    /// harmonics : int
    ///     Frequencies of the series, multiples of 1/duration.
    /// fit : collection of str
    ///     As in identify.
    /// noise : array_like, optional
    ///     Standard deviation of the torques, for the predicted standard deviations; 1 % of the largest torque by default.
    /// rate : float
    ///     Samples per second.
    /// iterations : int
    ///     Steps of the search.
    /// seed : int
    ///     Of its random steps.
    ///
    /// Returns
    /// -------
    /// phipsi.estimation.Excitation
    ///     Times, q, qd, qdd, torques of the model, and the standard deviations that the base parameters will have.
    ///
    /// Raises
    /// ------
    /// ArgumentError
    ///     A scene with joints that are not of one axis, or limits that leave no room.
    #[pyo3(signature = (duration, **how),
           text_signature = "($self, duration, *, limits=None, harmonics=5, fit=(), noise=None, rate=100.0, iterations=300, seed=0)")]
    fn excitation<'py>(
        slf: &Bound<'py, Self>,
        duration: &Object<'py>,
        how: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Object<'py>> {
        imported!(slf.py(), "phipsi.estimation._excitation", "excitation")?.call((slf, duration), how)
    }
}

/// Rotates rows (m, width) into the upper triangle of (width, width), in place.
#[pyfunction]
#[pyo3(name = "_rotate_rows", signature = (triangle, rows, /))]
pub(super) fn rotate_rows(
    py: Python<'_>,
    mut triangle: PyReadwriteArray2<'_, f64>,
    rows: PyReadonlyArray2<'_, f64>,
) -> PyResult<()> {
    let (width, rows) = (triangle.shape()[1], rows.as_slice()?);
    let triangle = triangle.as_slice_mut()?;
    detached(py, || triangle::rotate_in(triangle, rows, width))
}

/// The same for rows of chosen entries of wider rows, (m, stride), followed by given ones, (m, width - chosen).
#[pyfunction]
#[pyo3(name = "_rotate_chosen", signature = (triangle, wide, chosen, last, /))]
pub(super) fn rotate_chosen(
    py: Python<'_>,
    mut triangle: PyReadwriteArray2<'_, f64>,
    wide: PyReadonlyArray2<'_, f64>,
    chosen: Vec<usize>,
    last: PyReadonlyArray2<'_, f64>,
) -> PyResult<()> {
    let (stride, lasts) = (wide.shape()[1], last.shape()[1]);
    let (wide, last, triangle) = (wide.as_slice()?, last.as_slice()?, triangle.as_slice_mut()?);
    detached(py, || triangle::rotate_chosen(triangle, (wide, stride), &chosen, (last, lasts)))
}

/// Sum of e^2 / a, sum of log a, and number of the innovations of a log of one coordinate.
#[pyfunction]
#[pyo3(name = "_log_likelihood", signature = (time, position, variance, density, prior, /))]
pub(super) fn log_likelihood(
    py: Python<'_>,
    time: PyReadonlyArray1<'_, f64>,
    position: PyReadonlyArray1<'_, f64>,
    variance: PyReadonlyArray1<'_, f64>,
    density: f64,
    prior: [f64; 3],
) -> PyResult<(f64, f64, usize)> {
    let (time, position, variance) = (time.as_slice()?, position.as_slice()?, variance.as_slice()?);
    let found = detached(py, || Log { time, position, variance, density, prior }.likelihood())?;
    Ok((found.squares, found.logarithms, found.count))
}

/// Position, velocity and acceleration of a log of one coordinate with their variances, (k, 6).
#[pyfunction]
#[pyo3(name = "_smooth_log", signature = (time, position, variance, density, prior, /))]
pub(super) fn smooth_log<'py>(
    py: Python<'py>,
    time: PyReadonlyArray1<'py, f64>,
    position: PyReadonlyArray1<'py, f64>,
    variance: PyReadonlyArray1<'py, f64>,
    density: f64,
    prior: [f64; 3],
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (time, position, variance) = (time.as_slice()?, position.as_slice()?, variance.as_slice()?);
    let out = detached(py, || {
        let mut out = vec![[0.0; 6]; time.len()];
        Log { time, position, variance, density, prior }.smooth(&mut out);
        out.into_flattened()
    })?;
    out.into_pyarray(py).reshape([time.len(), 6])
}
