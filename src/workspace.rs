//! Every per-body array of the sweeps, allocated once.

use crate::accuracy::Accuracy;
use crate::algorithm::Chunks;
use crate::filter::cancellation::weight;
use crate::filter::pivots::{Evidence, LostPivot, PivotMonitor, Scale, first_lost};
use crate::filter::riccati::{Covariances, Measured};
use crate::filter::tolerance::Tolerance;
use crate::filter::{Form, System};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{BodyInertia, RigidShift, Root6, Symmetric3, Symmetric6};
use nalgebra::{Vector3, Vector6};

/// How many calls of the recursion of forward dynamics needed more than their form's first attempt, all lanes of a call counted as one. A
/// call of [`Scene::forward_dynamics`](crate::Scene::forward_dynamics) that the kernels do by themselves is none of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tally {
    /// `auto` went on to the square-root form.
    pub square_root: usize,
    /// The square-root form was in doubt, and double-double arithmetic gave the answer.
    pub refined: usize,
    /// The answer was in doubt and there was nothing better: not f64, several lanes, a body without a root, or an overflow.
    pub in_doubt: usize,
}

/// Compiled kernels of one state, and the scene whose constants they have; none before they are made.
#[derive(Default)]
pub(crate) struct OwnKernels(pub(crate) Option<(u64, Box<dyn Chunks<f64>>)>);

/// A copy has none yet: kernels are not copied, but made again.
impl Clone for OwnKernels {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl std::fmt::Debug for OwnKernels {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("OwnKernels").field(&self.0.as_ref().map(|(scene, _)| scene)).finish()
    }
}

/// Scratch of a kind that this room does not know.
#[derive(Default)]
pub(crate) struct Made(Option<Box<dyn std::any::Any + Send + Sync>>);

impl Made {
    /// What was made for a scene, or made now; [`Made::keep`] puts it back.
    #[allow(clippy::unnecessary_box_returns)] // it is kept in it
    pub(crate) fn take<S: std::any::Any + Send + Sync>(
        &mut self,
        scene: u64,
        make: impl FnOnce() -> S,
    ) -> Box<(u64, S)> {
        let made = self.0.take().and_then(|made| made.downcast::<(u64, S)>().ok());
        made.filter(|made| made.0 == scene).unwrap_or_else(|| Box::new((scene, make())))
    }

    /// Keeps it for the next call.
    pub(crate) fn keep<S: std::any::Any + Send + Sync>(&mut self, made: Box<(u64, S)>) {
        self.0 = Some(made);
    }
}

/// A copy has none yet: it makes its own.
impl Clone for Made {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl std::fmt::Debug for Made {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Made")
    }
}

/// The scratch of every algorithm for one state (or one state a lane); starts as NaN, so that nothing unset is ever used.
#[derive(Debug, Clone)]
pub struct Workspace<T: Real> {
    /// How P is carried by what uses this workspace.
    pub form: Form,
    /// The largest estimated error that form `auto` accepts, relative to the largest entry of a result; forward dynamics in square-root form too. None: max(5e-14, 4 n
    /// eps), n being the number of degrees of freedom on the longest path to the base, and 1e-11 of derivatives and products with them. What one unit in the last place of the
    /// forces makes of the result is accepted all the same.
    pub tolerance: Option<f64>,
    /// Number of rows on the longest path from the base.
    pub(crate) longest_path: usize,
    /// What was not plain sailing, since this workspace was made.
    pub tally: Tally,
    /// Whether forward dynamics is to estimate its error in each form that can, which takes the square-root form half as long again.
    pub estimates_error: bool,
    /// What the last recursion of forward dynamics found of its own accuracy, in lane 0.
    pub accuracy: Accuracy,
    /// Of the model that it was made for.
    pub(crate) identity: u64,
    pub(crate) shift: Vec<RigidShift<T>>,
    pub(crate) velocity: Vec<Vector6<T>>,
    pub(crate) acceleration: Vec<Vector6<T>>,
    /// b(k), then z^-(k), then z^+(k); in inverse dynamics the whole force.
    pub(crate) z: Vec<Vector6<T>>,
    /// b(k), where the digits are watched; after the factor of M was, the co-state nu(k) of its probe.
    pub(crate) bias: Vec<Vector6<T>>,
    pub(crate) co_state: Vec<Vector6<T>>,
    /// Bounds on the terms that form P^-(k).
    pub(crate) scale: Vec<Scale<T>>,
    /// The same of its diagonal, axis by axis; where the covariance form is watched.
    pub(crate) terms: Vec<Vector6<T>>,
    /// P^-(k), then P^+(k).
    pub(crate) p: Vec<Symmetric6<T>>,
    /// The root of P^-(k), then of P^+(k); used by the square-root form only.
    pub(crate) root: Vec<Root6<T>>,
    /// y of the bias, b(k) = L y; used by the square-root form only.
    pub(crate) coordinates: Vec<[T; 6]>,
    pub(crate) measured: Vec<Measured<T>>,
    /// Two more right sides, by which the covariance form is watched, and the innovations of one.
    pub(crate) weights: Vec<T>,
    pub(crate) probe: Vec<T>,
    /// The estimates for a right side that nobody asked for.
    pub(crate) estimates: Vec<T>,
    /// r(k), the inertia of everything outboard of joint k.
    pub(crate) composite: Vec<BodyInertia<T>>,
    /// The rate of r(k) in fixed axes.
    pub(crate) composite_rate: Vec<BodyInertia<T>>,
    /// Bodies that a call needs.
    pub(crate) needed: Vec<bool>,
    /// Rates of zero, (nv).
    pub(crate) rest: Vec<T>,
    /// Derivatives on their way to a linear system; empty until then.
    pub(crate) matrices: Vec<T>,
    /// What methods for scenes whose joints follow each other have made; none before.
    pub(crate) coupled: Made,
    /// The same for scenes with connections.
    pub(crate) connected: Made,
    /// What the methods of a scene run; the functions of `dynamics` do not.
    pub(crate) kernels: OwnKernels,
}

impl<T: Real> Workspace<T> {
    /// Scratch for the recursions of `model`, about 1 kB a body in f64; that of a scene's methods is [`Scene::workspace`]'s.
    ///
    /// [`Scene::workspace`]: crate::Scene::workspace
    pub fn new(model: &Model<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        let bodies = model.bodies.len();
        let vectors = || vec![Vector6::from_element(nan); bodies];
        let inertias = || {
            let first_moment = Vector3::from_element(nan);
            vec![BodyInertia { mass: nan, first_moment, rotational: Symmetric3::new([nan; 6]) }; bodies]
        };
        Self {
            form: Form::default(),
            tolerance: None,
            longest_path: model.longest_path(),
            tally: Tally::default(),
            estimates_error: false,
            accuracy: Accuracy::unknown(Form::default()),
            identity: model.identity(),
            shift: vec![RigidShift::filled(nan); bodies],
            velocity: vectors(),
            acceleration: vectors(),
            z: vectors(),
            bias: vectors(),
            co_state: vectors(),
            scale: vec![Scale::filled(nan); bodies],
            terms: vectors(),
            p: vec![Symmetric6::filled(nan); bodies],
            root: vec![Root6::filled(nan); bodies],
            coordinates: vec![[nan; 6]; bodies],
            measured: vec![Measured::filled(nan); model.nv()],
            weights: (0..2 * model.nv()).map(|row| T::from_f64(weight(row))).collect(),
            probe: vec![nan; model.nv()],
            estimates: vec![nan; model.nv()],
            composite: inertias(),
            composite_rate: inertias(),
            needed: vec![false; bodies],
            rest: vec![T::zero(); model.nv()],
            matrices: Vec::new(),
            coupled: Made::default(),
            connected: Made::default(),
            kernels: OwnKernels::default(),
        }
    }

    /// The other probe in the place of the first, for a second look.
    pub(crate) fn exchange_probes(&mut self) {
        let (first, second) = self.weights.split_at_mut(self.measured.len());
        first.swap_with_slice(second);
    }

    /// The tolerance, and the length that the usual one depends on.
    pub(crate) fn accepted_error(&self) -> Tolerance {
        Tolerance { given: self.tolerance, rows: self.longest_path }
    }

    /// The square of what the covariance form accepts, in units of eps^2.
    pub(crate) fn accepted_square(&self) -> T {
        let epsilon = T::epsilon().lane(0);
        T::from_f64((self.accepted_error().of_covariance(epsilon) / epsilon).powi(2))
    }

    /// The same scratch for another form.
    #[must_use]
    pub fn in_form(mut self, form: Form) -> Self {
        self.form = form;
        self
    }

    /// The arrays of the Riccati recursion.
    #[inline(always)]
    pub(crate) fn covariances(&mut self) -> Covariances<'_, T> {
        Covariances { shift: &self.shift, p: &mut self.p, scale: &mut self.scale, measured: &mut self.measured }
    }

    /// Whether every pivot D of the last sweep is positive and finite (lane 0): of roots they are sums of squares.
    pub(crate) fn pivots_are_positive(&self) -> bool {
        self.measured.iter().all(|row| row.pivot.lane(0) > 0.0 && row.pivot.lane(0).is_finite())
    }

    /// The verdict on a sweep: the lost pivot furthest from the base, if one was lost.
    ///
    /// Costs nothing where the monitor is clear; else O(N) for each pivot in doubt.
    pub fn lost_pivot(&self, model: &Model<T>, monitor: &PivotMonitor<T>) -> Option<LostPivot> {
        self.lost_pivot_of(model, &model.system, monitor)
    }

    /// The same of a sweep with other measurement noise than the model's.
    pub(crate) fn lost_pivot_of(
        &self,
        model: &Model<T>,
        system: &System<T>,
        monitor: &PivotMonitor<T>,
    ) -> Option<LostPivot> {
        if (0..T::LANES).all(|lane| monitor.clear(lane)) {
            return None;
        }
        let of_roots: Vec<Symmetric6<T>>;
        let p = if monitor.of_roots {
            of_roots = self.root.iter().map(Root6::to_symmetric).collect();
            &of_roots
        } else {
            &self.p
        };
        let evidence = Evidence { shift: &self.shift, p, measured: &self.measured, scale: &self.scale };
        first_lost(system, &evidence, monitor, |k| model.bodies[k].inertia_terms)
    }
}
