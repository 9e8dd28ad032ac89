//! The store of the passes for all bodies, and the scratch of all functions that read it, allocated once.

use super::sweeps::{MassColumns, SweepModel, SweepScratch};
use crate::accuracy::Accuracy;
use crate::algorithm::Chunks;
use crate::filter::pivots::{Evidence, LostPivot, PivotMonitor, first_lost};
use crate::filter::tolerance::Tolerance;
use crate::filter::{Form, System};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{BodyInertia, FirstMoment, Symmetric3};
use nalgebra::{Vector3, Vector6};

/// The number of calls of forward dynamics that needed more than the first form, all lanes of a call counted as one.
/// Calls of [`Scene::forward_dynamics`](crate::Scene::forward_dynamics) whose kernel result is accepted are not
/// counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tally {
    /// Form `auto` recomputed the state in square-root form.
    pub square_root: usize,
    /// The state was recomputed in double-double arithmetic.
    pub refined: usize,
    /// The error estimate of the last form exceeds the tolerance: the scalar is not f64 or has several lanes, a body
    /// has no root, or values overflow.
    pub unresolved: usize,
}

/// The compiled kernels for one state, and the identity of the scene whose constants they hold; none until they are
/// created.
#[derive(Default)]
pub(crate) struct OwnKernels(pub(crate) Option<(u64, Option<Box<dyn Chunks>>)>);

/// A copy has none: kernels are not copied, but created again.
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

/// Scratch of a type that this module does not depend on.
#[derive(Default)]
pub(crate) struct Made(Option<Box<dyn std::any::Any + Send + Sync>>);

impl Made {
    /// The scratch of this scene, created if there is none; [`Made::keep`] puts it back.
    #[allow(clippy::unnecessary_box_returns)] // it is stored in the box
    pub(crate) fn take<S: std::any::Any + Send + Sync>(
        &mut self,
        scene: u64,
        make: impl FnOnce() -> S,
    ) -> Box<(u64, S)> {
        let made = self.0.take().and_then(|made| made.downcast::<(u64, S)>().ok());
        made.filter(|made| made.0 == scene).unwrap_or_else(|| Box::new((scene, make())))
    }

    /// Stores it for the next call.
    pub(crate) fn keep<S: std::any::Any + Send + Sync>(&mut self, made: Box<(u64, S)>) {
        self.0 = Some(made);
    }
}

/// A copy has none and creates its own.
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

/// A model, and its bodies as the passes read them.
pub(crate) type Scene<'a, T> = (&'a Model<T>, &'a SweepModel<T>);

/// The scratch of every algorithm for one state (or one state per lane); initialized with NaN, so that no value is used
/// before it is set.
#[derive(Debug, Clone)]
pub struct Workspace<T: Real> {
    /// The form in which functions with this workspace represent the covariance P.
    pub form: Form,
    /// The largest estimated error that form `auto` accepts, and forward dynamics in square-root form, relative to the
    /// largest entry of a result. None: max(5e-14, 4 n eps) with n degrees of freedom on the longest path to the base,
    /// and 1e-11 for derivatives and products with them. The sensitivity to one unit in the last place of the forces is
    /// accepted in any case.
    pub tolerance: Option<f64>,
    /// Number of rows on the longest path from the base.
    pub(crate) longest_path: usize,
    /// Counts of recomputed states since the creation of this workspace.
    pub tally: Tally,
    /// True if forward dynamics estimates its error in every form, which takes the square-root form 1.5 times as long.
    pub estimates_error: bool,
    /// The accuracy of the last forward dynamics, in lane 0.
    pub accuracy: Accuracy,
    /// The identity of the model that it was created for.
    pub(crate) identity: u64,
    /// The bodies as the passes read them, in the order and the frames of the model.
    pub(crate) sweeps: SweepModel<T>,
    /// The store of the passes: one slot per body.
    pub(crate) store: SweepScratch<T>,
    /// Columns of M.
    pub(crate) columns: MassColumns<T, T>,
    /// Spatial velocities.
    pub(crate) velocity: Vec<Vector6<T>>,
    /// One force or momentum per body.
    pub(crate) z: Vec<Vector6<T>>,
    /// The estimates for a test vector.
    pub(crate) estimates: Vec<T>,
    /// r(k), the composite inertia of everything outboard of joint k.
    pub(crate) composite: Vec<BodyInertia<T>>,
    /// Mass and first moment of r(k).
    pub(crate) first_moment: Vec<FirstMoment<T>>,
    /// The time derivative of r(k) in fixed axes.
    pub(crate) composite_rate: Vec<BodyInertia<T>>,
    /// The bodies that a call needs.
    pub(crate) needed: Vec<bool>,
    /// Zeros, (nv).
    pub(crate) rest: Vec<T>,
    /// Derivatives for a linear system; empty until then.
    pub(crate) matrices: Vec<T>,
    /// Scratch of scenes with connections, and for products with their derivatives; none until it is created.
    pub(crate) connected: Made,
    pub(crate) connected_products: Made,
    /// The kernels that the methods of a scene run; the functions of `dynamics` do not use them.
    pub(crate) kernels: OwnKernels,
    /// For a scene with mimic joints, the evaluator without gravity; none until it is created.
    pub(crate) weightless: Made,
    /// The model and the scratch in double-double arithmetic; none until a state needs them.
    pub(crate) wide: Made,
}

impl<T: Real> Workspace<T> {
    /// Scratch for the recursions of `model`, about 2 kB per body in f64. The methods of a scene use the one of
    /// [`Scene::workspace`].
    ///
    /// [`Scene::workspace`]: crate::Scene::workspace
    pub fn new(model: &Model<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        let (bodies, sweeps) = (model.bodies.len(), SweepModel::general(model));
        let mut columns = MassColumns::new();
        if T::LANES == 1 {
            columns.prepare(model, &sweeps);
        }
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
            store: SweepScratch::new(model, &sweeps),
            sweeps,
            columns,
            velocity: vectors(),
            z: vectors(),
            estimates: vec![nan; model.nv()],
            composite: inertias(),
            first_moment: vec![FirstMoment { mass: nan, moment: Vector3::from_element(nan) }; bodies],
            composite_rate: inertias(),
            needed: vec![false; bodies],
            rest: vec![T::zero(); model.nv()],
            matrices: Vec::new(),
            connected: Made::default(),
            connected_products: Made::default(),
            kernels: OwnKernels::default(),
            weightless: Made::default(),
            wide: Made::default(),
        }
    }

    /// The tolerance, with the path length that its default depends on.
    pub(crate) fn accepted_error(&self) -> Tolerance {
        Tolerance { given: self.tolerance, rows: self.longest_path }
    }

    /// The same scratch for another form.
    #[must_use]
    pub fn in_form(mut self, form: Form) -> Self {
        self.form = form;
        self
    }

    /// The bodies as the passes read them, and their store.
    #[inline(always)]
    pub(crate) fn passes<'a>(&'a mut self, model: &'a Model<T>) -> (Scene<'a, T>, &'a mut SweepScratch<T>) {
        ((model, &self.sweeps), &mut self.store)
    }

    /// True if every pivot D of the last factor is positive and finite (lane 0): in square-root form they are sums of
    /// squares.
    #[cfg_attr(not(feature = "dense"), allow(dead_code))]
    pub(crate) fn pivots_are_positive(&self) -> bool {
        self.store.measured.iter().all(|row| row.pivot.lane(0) > 0.0 && row.pivot.lane(0).is_finite())
    }

    /// The lost pivot furthest from the base, if a pivot of the last factor was lost.
    ///
    /// Without cost if the monitor is clear; otherwise O(N) for each pivot below the bound of its terms.
    pub fn lost_pivot(&self, model: &Model<T>, monitor: &PivotMonitor<T>) -> Option<LostPivot> {
        self.lost_pivot_of(model, &model.system, monitor)
    }

    /// The same for a factor with other measurement noise than that of the model.
    pub(crate) fn lost_pivot_of(
        &self,
        model: &Model<T>,
        system: &System<T>,
        monitor: &PivotMonitor<T>,
    ) -> Option<LostPivot> {
        if (0..T::LANES).all(|lane| monitor.clear(lane)) {
            return None;
        }
        let (mut p, mut scale) = (Vec::new(), Vec::new());
        let mut measured = self.store.measured.clone();
        for body in self.sweeps.swept() {
            let (of_roots, load) = (monitor.of_roots, self.sweeps.load(body));
            p.push(self.store.filtered_covariance((system, body, load), &mut measured, of_roots, |_, _| {}));
            scale.push(self.store.scale((body, load), of_roots));
        }
        let evidence = Evidence { shift: &self.store.shifts, p: &p, measured: &self.store.measured, scale: &scale };
        first_lost(system, &evidence, monitor, |k| model.bodies[k].inertia_terms)
    }
}
