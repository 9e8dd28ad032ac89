//! Methods of `Scene`: identification of its parameters from logs, and what it needs of compiled code.

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

typed_methods! {
    in PyScene;

    /// Joint torque regressor Y: inverse_dynamics(q, qd, qdd) = Y parameters + armature qdd.
    #[doc = parameters!(q qd qdd)]
    #[doc = entries!(errors)]
    #[doc = section!(Returns)]
    /// regressor : (..., nv, bodies, 10) ndarray
    ///     Entry (i, b, p) is the derivative of torque i with respect to parameter p of the link body_names[b] and the
    ///     links fixed to it. The parameters are (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) in the frame of
    ///     the link, moments of inertia about its origin, as in Identification.parameters; kg, kg m and kg m^2.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(N depth). The entries of links that are not outboard of the joint are zero. As in inverse_dynamics, the forces
    /// of connections and contacts are not part of the torques. With joints that follow others, (q, qd, qdd) and the
    /// rows are those of the independent joints; body_names includes the links of the joints that follow.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> scene.regressor([0.1, 0.2, 0.3], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]).shape
    /// (3, 3, 10)
    fn regressor[slf: &Bound<'py, Self>](
        q: &Object<'py>, qd: &Object<'py>, qdd: &Object<'py>; errors: &str = "raise"
    ) -> PyResult<Object<'py>> {
        let py = slf.py();
        let this = slf.get();
        this.check_dense("regressor", "inverse_dynamics_vjp(..., parameters=True)")?;
        let (nv, links) = (this.scene.nv(), places_of_links(&this.scene));
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
}

methods_in_python! {
    /// Most probable inertial and joint parameters from measured motion and torques, with confidence intervals.
    #[doc = section!(Parameters)]
    /// q : (k, nq) array_like
    ///     Joint positions of k measured states in the order of time, rad or m.
    /// qd : (k, nv) array_like
    ///     Joint velocities, rad/s or m/s, for instance of phipsi.smooth.
    /// qdd : (k, nv) array_like
    ///     Joint accelerations, rad/s^2 or m/s^2.
    /// tau : (k, nv) array_like
    ///     Measured joint torques, N m or N; NaN: not measured. With `transmission`: motor torques, (k, motors).
    /// fit : collection of str, optional
    ///     Joint parameters to identify too: "armature", "damping", "friction", "offset", "stribeck" (friction that
    ///     decreases with speed) and "load" (friction proportional to the joint torque), and "friction_asymmetry" and
    ///     "damping_asymmetry", half of the difference of "friction" and "damping" between positive and negative
    ///     velocities. With `transmission` these are parameters of motors, and "joint_damping" and "joint_friction" are
    ///     parameters of joints, if no motor moves them alone. Other parameters keep the values of the scene.
    /// noise : float or (nv,) array_like, optional
    ///     Standard deviation of the torques, N m or N. None: estimated from the residuals of least squares, which
    ///     needs at least twice as many measured torques as parameters.
    /// trust : float, dict of float or (bodies,) array_like, default 1
    ///     Weight of the parameters of the scene: each parameter is expected within about 1 / sqrt(trust) of them,
    ///     relatively. It does not apply to joint parameters that the scene lacks. A dict has the weights of links of
    ///     body_names, an array those of all, from 1e-6 to 1e9; other links and parameters of joints then have 1.
    /// keep : collection of str, optional
    ///     Names in body_names whose inertias remain.
    /// friction_speed : float, default 0.01
    ///     Speed of a joint below which friction is viscous, rad/s or m/s. For a motor it is multiplied by the norm of
    ///     its row of `transmission`.
    /// stribeck_speed : float, default 0.1
    ///     Speed of a joint at which the friction of "stribeck" has decreased to 1/e, rad/s or m/s; of a motor likewise.
    /// time : (k,) array_like, optional
    ///     Times of the rows, s, increasing. With times, gaps, repeated times, inconsistent units and a delay of up to
    ///     1 s between the clocks of q and tau are detected, and the delay has a standard deviation.
    /// transmission : (motors, nv) array_like, optional
    ///     Matrix B of motor velocities = B qd, with motors = nv: joint torques are B^T times motor torques. Armature,
    ///     damping, friction, offsets and noise then are those of the motors.
    /// tau_delay : float, default 0
    ///     Delay of the torques relative to q, s. They are shifted by linear interpolation; requires `time`.
    /// acceleration_noise : (nv,) array_like, optional
    ///     Standard deviation of the noise in qdd, as phipsi.smooth(...).acceleration_noise, for the prediction of the
    ///     bias that it causes.
    /// instruments : tuple of (q, qd, qdd), optional
    ///     Commanded trajectory, used as instrumental variables. They remove the bias caused by noise in the measured
    ///     motion.
    /// blocks : int, default 20
    ///     Number of time blocks of the jackknife. Neighboring blocks are merged, down to eight blocks, if their
    ///     residuals are correlated or if they have fewer than two torques per parameter.
    /// total_mass : (float, float), optional
    ///     Mass of all links of body_names together and its standard deviation, kg, for instance of scales.
    /// outliers : float, optional
    ///     Number of standard deviations beyond which a torque is not used, at least 2, for instance 5. The standard
    ///     deviation is a robust one, of the median of the absolute residuals, and identification and rejection
    ///     alternate. None: all torques are used. Not for scenes with connections.
    #[doc = section!(Returns)]
    /// identification : Identification
    ///     The new scene, parameters, intervals, base parameters, residuals, and for each parameter the share that the
    ///     data determine.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     Too few measurements, unknown names, decreasing times, noise below the rounding of the torques, bodies of
    ///     the scene without mass.
    /// ShapeError, NotFiniteError
    ///     Invalid arrays.
    #[doc = section!(Warns)]
    /// LogWarning
    ///     Inconsistent units or clocks, gaps, repeated times; torques of another unit or sign than the model's, of
    ///     exchanged joints or without gravity; accelerations by differences; friction or armature that is not fitted;
    ///     torques that no bodies of positive mass explain. Each names the joint, the numbers found and expected, and
    ///     the fix.
    /// IdentificationWarning
    ///     A predicted bias above 0.2 standard deviations; parameters that a scene does not have, such as asymmetric
    ///     friction and friction at rest below zero.
    /// InertiaWarning
    ///     A body of the scene whose inertia no rigid body can have. The iteration starts from the nearest one that
    ///     can.
    #[doc = section!(Notes)]
    /// Maximum a posteriori with a Wishart prior on the second moments of mass of each body: convex, and every body
    /// receives an inertia that a rigid body can have. With connections, whose forces are unknown, the measured torques
    /// enter as far as they act on motions that the connections allow: the torque of a joint without motor is 0, a state
    /// with a torque that was not measured is omitted, and `noise` is one number. With joints that follow others, q, qd,
    /// qdd and tau are those of the independent joints. Contacts are ignored: give torques of a robot that touches
    /// nothing. Intervals come from the delete-one-block jackknife, which is
    /// valid for correlated residuals. The memory does not grow with k. phipsi.estimation.Accumulator reads logs that
    /// do not fit into memory.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM).with_properties(damping=0.0, friction=0.0)
    /// >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 6))
    /// >>> tau = scene.with_payload("link6", 1.0).inverse_dynamics(q, qd, qdd)
    /// >>> found = scene.identify(q, qd, qdd, tau, noise=0.01)
    /// >>> bool((found.after < 1e-3).all())     # N m
    /// True
    #[pyo3(text_signature = "($self, q, qd, qdd, tau, *, fit=(), noise=None, trust=1.0, keep=(), \
                  friction_speed=0.01, \
                  stribeck_speed=0.1, time=None, transmission=None, tau_delay=0.0, \
                  acceleration_noise=None, instruments=None, blocks=20, total_mass=None, outliers=None)")]
    fn identify(q, qd, qdd, tau) = "phipsi.estimation._identify", "identify";

    /// Periodic joint trajectory within limits that excites the parameters: a D-optimal Fourier series.
    #[doc = section!(Parameters)]
    /// duration : float
    ///     Length of the trajectory, one period, s.
    /// limits : Limits, optional
    ///     Limits of positions, velocities, accelerations, jerk and torques, of which the trajectory uses 90 %. None:
    ///     those of the scene. A position without a limit stays within 1 rad or 0.2 m of its neutral value.
    /// harmonics : int, default 5
    ///     Number of frequencies of the series, multiples of 1 / duration.
    /// fit : collection of str, optional
    ///     Joint parameters to identify too, as in identify.
    /// noise : float or (nv,) array_like, optional
    ///     Standard deviation of the torques, N m or N, for the information that the search maximizes and for the
    ///     predicted standard deviations. None: 1 % of the limit of effort; without a limit, of the largest torque of
    ///     the first random motion.
    /// rate : float, default 100
    ///     Samples per second.
    /// iterations : int, default 300
    ///     Number of steps of the search.
    /// seed : int, default 0
    ///     Seed of its random steps.
    #[doc = section!(Returns)]
    /// excitation : Excitation
    ///     Times, q, qd, qdd, the torques of the scene, the predicted standard deviations of the base parameters, and
    ///     the noise.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     A scene with joints of several axes, or limits that no trajectory meets.
    #[doc = section!(Notes)]
    /// Bayesian D-optimality: the log-determinant of the information of the whole trajectory about the base parameters,
    /// with rows divided by `noise`, plus the information of the prior of `identify`. The motion is as large as the
    /// limits allow. Bodies without mass and joint parameters that the scene lacks have no prior.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    /// >>> found = scene.excitation(4.0, iterations=5, rate=25.0)
    /// >>> found.q.shape
    /// (100, 6)
    #[pyo3(text_signature = "($self, duration, *, limits=None, harmonics=5, fit=(), noise=None, \
                  rate=100.0, iterations=300, seed=0)")]
    fn excitation(duration) = "phipsi.estimation._excitation", "excitation";
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
