//! One state of a scene whose [limbs go side by side](crate::dynamics::lean::Abreast).

use super::arms::{Target, Work};
use super::chunk::{Algorithm, Arguments, Chunks, any_not_finite, is_far, nearness, quaternions};
use crate::dynamics::auto;
use crate::dynamics::lean::{self, Abreast, Places};
use crate::filter::Form;
use crate::scalar::{Limbs, Real};
use crate::scene::Scene;
use nalgebra::Vector6;

/// Kernels for one state, and those that do whatever these do not, or doubt.
pub(super) struct SideBySide {
    scene: Abreast,
    quaternions: Vec<usize>,
    arguments: [Vec<Limbs>; 3],
    wrenches: Vec<Vector6<Limbs>>,
    results: Vec<Limbs>,
    /// What form `auto` estimates its error to be, where these kernels gave the last result.
    error: Option<f64>,
    one_by_one: Box<dyn Chunks<f64>>,
}

impl SideBySide {
    /// Where the scene has limbs that can go side by side; else the other kernels as they came.
    pub fn of(scene: &Scene, one_by_one: Box<dyn Chunks<f64>>) -> Result<Self, Box<dyn Chunks<f64>>> {
        // What moves in one plane has numbers of its own.
        let abreast = if scene.planar().is_some() { None } else { Abreast::of(scene.model()) };
        let Some(abreast) = abreast else { return Err(one_by_one) };
        let zeros = |count: usize| vec![Limbs::from_f64(0.0); count];
        let (nq, nv) = (abreast.coordinates.len(), abreast.rows.len());
        Ok(Self {
            quaternions: quaternions(&abreast.model),
            arguments: [zeros(nq), zeros(nv), zeros(nv)],
            wrenches: Vec::new(),
            results: zeros(nv),
            error: None,
            scene: abreast,
            one_by_one,
        })
    }

    /// As [`Chunks::run`], for these instructions.
    #[inline(always)]
    pub fn run<I: Target>(
        &mut self,
        target: I,
        algorithm: Algorithm,
        states: &[Arguments<'_>],
        out: &mut [f64],
    ) -> u64 {
        let covered = matches!(
            algorithm,
            Algorithm::ForwardDynamics(Form::Auto | Form::Covariance | Form::SquareRoot)
                | Algorithm::InverseDynamics
                | Algorithm::BiasTorque
        );
        if let ([state], true) = (states, covered && !out.is_empty()) {
            self.gather_wrenches(state);
            let run = Run { kernels: self, algorithm, state, out };
            if target.within(run) {
                return 0;
            }
        }
        self.error = None;
        self.one_by_one.run(algorithm, states, out)
    }

    /// As [`Chunks::error`].
    pub fn error(&self) -> f64 {
        self.error.unwrap_or_else(|| self.one_by_one.error(0))
    }

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
        let SideBySide { scene, quaternions, arguments, wrenches, results, error, .. } = self.kernels;
        let Abreast { model, lean, scratch, coordinates, rows, of_state, .. } = scene;
        let [q, qd, u] = arguments;
        gather(q, coordinates, self.state.q);
        gather(qd, rows, self.state.qd);
        gather(u, rows, self.state.u);
        let numbers = (&**q, &**qd, &**u);
        let scene = (&*model, &*lean);
        let kept = match self.algorithm {
            Algorithm::ForwardDynamics(Form::Auto) => {
                *error = auto::forward_dynamics_seen_abreast(scene, scratch, numbers, wrenches, results);
                error.is_some()
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

#[cfg(test)]
mod tests {
    use super::{Algorithm, Arguments, Chunks, Form, SideBySide, Target};
    use crate::scene::{Inertial, JointDescription, JointKind, LinkDescription, Scene, SceneBuilder};
    use crate::spatial::Symmetric3;
    use nalgebra::Vector3;
    use pulp::x86::{V3, V4};

    /// Doubts whatever it is given.
    struct Nothing;

    impl Chunks<f64> for Nothing {
        fn lanes(&self) -> usize {
            1
        }

        fn run(&mut self, _: Algorithm, _: &[Arguments<'_>], _: &mut [f64]) -> u64 {
            u64::MAX
        }

        fn error(&self, _: usize) -> f64 {
            f64::NAN
        }
    }

    /// A trunk that floats with two legs, a hip in each that is not about an axis of the trunk.
    fn biped() -> Scene {
        let link = |name: &str| {
            let central = Symmetric3::new([0.1, 0.01, 0.0, 0.2, 0.02, 0.15]);
            let inertial = Some(Inertial { mass: 1.5, centre: Vector3::new(0.1, -0.05, 0.2), central });
            LinkDescription { name: name.into(), inertial }
        };
        let mut builder = SceneBuilder::new().floating_base(true).link(link("trunk"));
        for side in ["left", "right"] {
            let mut parent = "trunk".to_owned();
            for (k, part) in ["hip", "knee", "ankle"].into_iter().enumerate() {
                let name = format!("{side}_{part}");
                let mut joint = JointDescription::new(format!("{name}_joint"), JointKind::Revolute, &parent, &name);
                joint.axis = if k == 0 { Vector3::new(0.6, 0.8, 0.0) } else { Vector3::y() };
                joint.origin.lever = Vector3::new(0.05, if side == "left" { 0.2 } else { 0.0 }, -0.3);
                builder = builder.link(link(&name)).joint(joint);
                parent = name;
            }
        }
        builder.build().expect("a biped")
    }

    /// Of an ordinary state all that limbs side by side do is kept: nothing is done again one by one.
    #[test]
    fn what_limbs_do_side_by_side_is_kept() {
        // Kernels that are not optimised need more stack than a thread has.
        let check = || {
            check::<V3>();
            check::<V4>();
        };
        std::thread::Builder::new().stack_size(1 << 28).spawn(check).unwrap().join().unwrap();
    }

    fn check<I: Target>() {
        let Some(target) = I::here() else { return };
        let scene = biped();
        let Ok(mut kernels) = SideBySide::of(&scene, Box::new(Nothing)) else { panic!("two legs") };
        let (nq, nv) = (scene.nq(), scene.nv());
        let mut q: Vec<f64> = (0..u32::try_from(nq).unwrap()).map(|i| (f64::from(i) * 1.3).sin()).collect();
        q[3..7].copy_from_slice(&[0.5, -0.5, 0.5, 0.5]);
        let qd: Vec<f64> = (0..u32::try_from(nv).unwrap()).map(|i| (f64::from(i) * 0.7).cos()).collect();
        for algorithm in [
            Algorithm::ForwardDynamics(Form::Auto),
            Algorithm::ForwardDynamics(Form::Covariance),
            Algorithm::ForwardDynamics(Form::SquareRoot),
            Algorithm::InverseDynamics,
            Algorithm::BiasTorque,
        ] {
            let mut out = vec![f64::NAN; nv];
            let state = Arguments { q: &q, qd: &qd, u: &qd, wrenches: &[] };
            let doubt = kernels.run(target, algorithm, &[state], &mut out);
            assert_eq!(doubt, 0, "{algorithm:?}");
            assert!(out.iter().all(|x| x.is_finite()), "{algorithm:?}: {out:?}");
        }
    }
}
