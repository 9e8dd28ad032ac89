//! One state of a scene whose [limbs go side by side](crate::dynamics::lean::Abreast).

use super::arms::{Vectorised, Work};
use super::chunk::{Algorithm, Arguments, Chunks, any_not_finite, is_far, nearness, quaternions};
use crate::dynamics::auto;
use crate::dynamics::lean::{self, Abreast, Places};
use crate::filter::Form;
use crate::scalar::{Fused, Limbs, Real};
use crate::scene::Scene;
use nalgebra::Vector6;

/// Kernels for one state, and those that do whatever these do not, or doubt.
pub(super) struct SideBySide {
    scene: Abreast,
    quaternions: Vec<usize>,
    arguments: [Vec<Limbs>; 3],
    wrenches: Vec<Vector6<Limbs>>,
    results: Vec<Limbs>,
    one_by_one: Box<dyn Chunks<f64>>,
}

/// The kernels of one state, limbs side by side where the scene has limbs that can be.
pub(super) fn kernels(scene: &Scene, one_by_one: Box<dyn Chunks<f64>>) -> Box<dyn Chunks<f64>> {
    // What moves in one plane has numbers of its own.
    let abreast = if scene.planar().is_some() { None } else { Abreast::of(scene.model()) };
    let Some(abreast) = abreast else { return one_by_one };
    let zeros = |count: usize| vec![Limbs::from_f64(0.0); count];
    let (nq, nv) = (abreast.coordinates.len(), abreast.rows.len());
    Box::new(SideBySide {
        quaternions: quaternions(&abreast.model),
        arguments: [zeros(nq), zeros(nv), zeros(nv)],
        wrenches: Vec::new(),
        results: zeros(nv),
        scene: abreast,
        one_by_one,
    })
}

impl Chunks<f64> for SideBySide {
    fn lanes(&self) -> usize {
        1
    }

    fn run(&mut self, algorithm: Algorithm, states: &[Arguments<'_>], out: &mut [f64]) -> u64 {
        let covered = matches!(
            algorithm,
            Algorithm::ForwardDynamics(Form::Auto | Form::Covariance | Form::SquareRoot)
                | Algorithm::InverseDynamics
                | Algorithm::BiasTorque
        );
        if let ([state], true) = (states, covered && !out.is_empty()) {
            self.gather_wrenches(state);
            let run = Run { kernels: self, algorithm, state, out };
            if Fused::within(run) {
                return 0;
            }
        }
        self.one_by_one.run(algorithm, states, out)
    }
}

impl SideBySide {
    /// Forces on bodies; none at all where there are none.
    fn gather_wrenches(&mut self, state: &Arguments<'_>) {
        self.wrenches.clear();
        if state.wrenches.is_empty() {
            return;
        }
        for places in &self.scene.bodies {
            let mut force = Vector6::from_element(Limbs::from_f64(0.0));
            for (lane, &body) in places.iter().enumerate() {
                for (i, number) in force.iter_mut().enumerate() {
                    number.lanes_mut()[lane] = state.wrenches.get(body).map_or(f64::NAN, |given| given[i]);
                }
            }
            self.wrenches.push(force);
        }
    }
}

/// To each lane its limb's numbers.
#[inline(always)]
fn gather(numbers: &mut [Limbs], places: &[Places], given: &[f64]) {
    if given.is_empty() {
        return;
    }
    for (number, places) in numbers.iter_mut().zip(places) {
        for (lane, &place) in number.lanes_mut().iter_mut().zip(places) {
            // Too few are a fault, which is found with what is not finite.
            *lane = given.get(place).copied().unwrap_or(f64::NAN);
        }
    }
}

/// One state, to be run inside an arm; whether its results are in order.
struct Run<'a> {
    kernels: &'a mut SideBySide,
    algorithm: Algorithm,
    state: &'a Arguments<'a>,
    out: &'a mut [f64],
}

impl Work for Run<'_> {
    type Output = bool;

    #[inline(always)]
    fn call(self) -> bool {
        let SideBySide { scene, quaternions, arguments, wrenches, results, .. } = self.kernels;
        let Abreast { model, lean, scratch, coordinates, rows, of_state, .. } = scene;
        let [q, qd, u] = arguments;
        gather(q, coordinates, self.state.q);
        gather(qd, rows, self.state.qd);
        gather(u, rows, self.state.u);
        let numbers = (&**q, &**qd, &**u);
        let scene = (&*model, &*lean);
        let kept = match self.algorithm {
            Algorithm::ForwardDynamics(Form::Auto) => {
                auto::forward_dynamics_seen_abreast(scene, scratch, numbers, wrenches, results)
            }
            Algorithm::ForwardDynamics(Form::SquareRoot) => {
                let (pivots, reach) =
                    lean::forward_dynamics_by_roots::<_, Limbs>(scene, scratch, numbers, wrenches, results);
                pivots.clear_in_every_lane() && reach.clear_together()
            }
            Algorithm::ForwardDynamics(_) => {
                lean::forward_dynamics::<_, Limbs>(scene, scratch, numbers, wrenches, results).clear_in_every_lane()
            }
            _ => {
                let (q, qd, u) = numbers;
                let u = (self.algorithm == Algorithm::InverseDynamics).then_some(u);
                lean::inverse_dynamics::<_, Limbs>(scene, scratch, (q, qd, u), wrenches, results);
                true
            }
        };
        let mut fault = any_not_finite(q) + any_not_finite(results);
        if !self.state.qd.is_empty() {
            fault += any_not_finite(qd);
        }
        if !self.state.u.is_empty() {
            fault += any_not_finite(u);
        }
        for force in wrenches.iter() {
            fault += any_not_finite(force.as_slice());
        }
        for (out, &(row, lane)) in self.out.iter_mut().zip(&*of_state) {
            *out = results[row].lanes()[lane];
        }
        let nearness = nearness(quaternions, q);
        let is_near = (0..Limbs::LANES).all(|lane| !is_far(nearness, lane));
        kept && is_near && fault.lanes().iter().all(|&fault| fault == 0.0)
    }
}
