//! Workspaces of a thread, reused between calls.

use crate::batch::evaluator::Evaluator;
use crate::dynamics::derivatives::{HessianScratch, RegressorScratch};
use crate::dynamics::operational::OperationalScratch;
use crate::dynamics::{ConstraintScratch, Estimate, EstimateCovariance, EstimateScratch};
use crate::filter::Form;
use crate::scalar::MOST_LANES;
use crate::scene::Scene;
use crate::spatial::{RigidShift, SpatialVector};
use crate::workspace::Workspace;

/// Forces on the bodies of one state.
pub(super) type Forces = Vec<SpatialVector<f64>>;

/// Workspaces of all methods; most of them are allocated on first use.
pub(super) struct Scratch {
    /// Arrays per body of the general recursions; the evaluators have those of the kernels.
    pub workspace: Workspace<f64>,
    /// For estimation only.
    pub estimation: Option<Estimation>,
    /// For operational space only.
    pub operational: Option<OperationalScratch<f64>>,
    /// For closed loops only.
    constraints: Option<ConstraintScratch>,
    /// For Hessians only.
    hessians: Option<HessianScratch>,
    /// For regressors only.
    regressors: Option<RegressorScratch<f64>>,
    /// Evaluator of the vectorized kernels.
    pub evaluator: Option<Evaluator>,
    /// Forces on bodies for one state per lane; empty without wrenches.
    pub forces: Vec<Forces>,
    /// Results of one state, before they are copied to an array.
    pub results: Vec<f64>,
    /// Poses of the links of a call.
    pub placements: Vec<RigidShift<f64>>,
}

impl Scratch {
    pub fn new(scene: &Scene) -> Self {
        Self {
            workspace: Workspace::new(scene.model()),
            estimation: None,
            operational: None,
            constraints: None,
            hessians: None,
            regressors: None,
            evaluator: None,
            forces: vec![Vec::new(); MOST_LANES],
            results: Vec::new(),
            placements: Vec::new(),
        }
    }

    /// Workspaces for a call with connections, in this form.
    pub fn through_connections(
        &mut self,
        scene: &Scene,
        form: Form,
    ) -> (&mut Workspace<f64>, &mut ConstraintScratch, &Forces) {
        self.workspace.form = form;
        let rows = self.constraints.get_or_insert_with(|| scene.constraint_scratch());
        (&mut self.workspace, rows, &self.forces[0])
    }

    /// Workspaces for a call on Hessians.
    pub fn for_hessians(&mut self, scene: &Scene) -> (&mut Workspace<f64>, &mut HessianScratch, &Forces) {
        let hessians = self.hessians.get_or_insert_with(|| scene.hessian_scratch());
        (&mut self.workspace, hessians, &self.forces[0])
    }

    /// For a call on regressors, and the buffer for the results of one state.
    pub fn for_regressors(&mut self, scene: &Scene) -> (&mut RegressorScratch<f64>, &mut Vec<f64>) {
        (self.regressors.get_or_insert_with(|| scene.regressor_scratch()), &mut self.results)
    }
}

/// Workspace of a thread for estimation.
pub(super) struct Estimation {
    pub scratch: EstimateScratch<f64>,
    pub estimate: Estimate<f64>,
    pub covariance: EstimateCovariance<f64>,
    /// Noise of the current state; infinite: not measured.
    pub noise: Vec<f64>,
}

impl Estimation {
    pub fn new(scene: &Scene) -> Self {
        let model = scene.model();
        Self {
            scratch: EstimateScratch::new(model),
            estimate: Estimate::new(model),
            covariance: EstimateCovariance::new(model),
            noise: vec![f64::NAN; model.nv()],
        }
    }
}
