//! The observer against a textbook extended Kalman filter and smoother: dense covariances with subtractions, and
//! derivatives by central differences of the methods of `Scene`.

use super::{ExternalWrench, Mount, Observer, ObserverSettings, Quantity, Sensor};
use crate::error::Error;
use crate::joints::JointKind;
use crate::kinematics::derivatives::{acceleration_derivatives, velocity_derivatives};
use crate::kinematics::{AccelerationKind, Frame, ReferenceFrame, frame_motion};
use crate::model::Model;
use crate::scalar::Dual;
use crate::scene::{Inertial, JointDescription, LinkDescription, Scene, SceneBuilder};
use crate::scenes::draw::Draw;
use crate::spatial::{RigidShift, Symmetric3};
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};

/// Relative error of central differences of fourth order with [`STEP`]: truncation is 1e-16, rounding 1e-11. Over the
/// steps of a filter it grows.
const DIFFERENCES: f64 = 1e-7;
const STEP: f64 = 1e-3;
/// Rounding, relative.
const ROUNDING: f64 = 1e-11;

fn arm(kinds: &[JointKind]) -> Scene {
    let mut draw = Draw::new(3);
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
    let mut parent = "base".to_owned();
    for (k, &kind) in kinds.iter().enumerate() {
        let mut triple = || Vector3::from_fn(|_, _| draw.uniform(-0.3, 0.3));
        let name = format!("link{k}");
        let central = Symmetric3::new([0.02, 0.002, -0.001, 0.03, 0.001, 0.025]);
        let inertial = Inertial { mass: 1.0, center: triple(), central };
        let mut joint = JointDescription::new(format!("j{k}"), kind, parent, &name);
        joint.origin = RigidShift { rotation: *Rotation3::new(3.0 * triple()).matrix(), lever: triple() };
        joint.axis = Vector3::new(0.3, -0.2, 0.9);
        builder = builder.link(LinkDescription { name: name.clone(), inertial: Some(inertial) }).joint(joint);
        parent = name;
    }
    builder.build().unwrap()
}

/// A robot with sensors of all kinds.
struct Case {
    scene: Scene,
    settings: ObserverSettings,
    q: Vec<f64>,
    qd: Vec<f64>,
    tool: String,
    mount: RigidShift<f64>,
}

impl Case {
    fn new(kinds: &[JointKind]) -> Self {
        let scene = arm(kinds);
        let mut draw = Draw::new(7);
        let nv = scene.nv();
        let mut array = |length: usize, size: f64| (0..length).map(|_| draw.uniform(-size, size)).collect::<Vec<_>>();
        let (tangent, qd) = (array(nv, 0.8), array(nv, 1.0));
        let mut q = vec![f64::NAN; scene.nq()];
        scene.integrate(&scene.neutral(), &tangent, &mut q).unwrap();
        let mount = RigidShift {
            rotation: *Rotation3::new(Vector3::new(0.4, -0.9, 0.2)).matrix(),
            lever: Vector3::new(0.1, 0.2, -0.1),
        };
        let tool = format!("link{}", kinds.len() - 1);
        let on_tool = || Mount { link: tool.clone(), offset: mount };
        let sensors = vec![
            Sensor::new("encoder", Quantity::Encoder(None), 1e-2),
            Sensor::new("gyro", Quantity::Gyro(on_tool()), 0.05).with_bias(0.1).with_bias_walk(0.05),
            Sensor::new("accelerometer", Quantity::Accelerometer(on_tool()), 0.5).with_bias(0.2),
            Sensor::new("torque", Quantity::JointTorque(None), 0.3),
            Sensor::new("contact", Quantity::Contact(Mount::from("link1")), 0.4),
        ];
        let wrenches = vec![ExternalWrench {
            link: tool.clone(),
            density: [1.0, 2.0, 1.0, 4.0, 3.0, 5.0],
            correlation_time: 0.5,
            deviation: None,
        }];
        let initial = [vec![0.02; nv], vec![0.1; nv]].concat();
        let torque_noise = vec![0.01; nv];
        let settings = ObserverSettings { dt: 0.01, sensors, torque_noise, wrenches, initial, history: 100 };
        Self { scene, settings, q, qd, tool, mount }
    }

    /// One axis, spherical and free joints.
    fn all() -> [Self; 2] {
        use JointKind::{Floating, Prismatic, Revolute, Screw, Spherical};
        [Self::new(&[Revolute, Prismatic, Revolute]), Self::new(&[Floating, Spherical, Revolute, Screw { pitch: 0.3 }])]
    }

    /// The frame of the IMU.
    fn frame(&self) -> Frame<f64> {
        self.scene.frame(&(&Mount { link: self.tool.clone(), offset: self.mount }).into()).unwrap()
    }

    fn observer(&self) -> Observer<&Scene> {
        Observer::new(&self.scene, &self.settings, &self.q, &self.qd).unwrap()
    }

    /// Torques and readings near the prediction of the textbook filter, some of them missing.
    fn inputs(&self, k: usize, filter: &Textbook<'_>) -> (Vec<f64>, Vec<f64>) {
        let mut draw = Draw::new(100 + k as u64);
        let tau: Vec<f64> = (0..self.scene.nv()).map(|_| draw.uniform(-3.0, 3.0)).collect();
        let mut readings = filter.predicted(&filter.x, &tau, &vec![0.0; self.scene.nv()]).as_slice().to_vec();
        for reading in &mut readings {
            *reading += draw.uniform(-0.02, 0.02);
        }
        if k == 2 {
            readings[0] = f64::NAN;
        } else if k == 3 {
            readings.fill(f64::NAN);
        }
        (tau, readings)
    }
}

/// q, qd, wrenches and biases.
#[derive(Clone)]
struct State(Vec<f64>, Vec<f64>, Vec<f64>);

/// A covariance-form filter with the same model, order (q, qd, rest, torque noise).
struct Textbook<'a> {
    case: &'a Case,
    x: State,
    p: DMatrix<f64>,
    decay: Vec<f64>,
    walk: Vec<f64>,
}

/// The results of a step that the smoother reads.
struct Step {
    x: State,
    p: DMatrix<f64>,
    flow: DMatrix<f64>,
    next: State,
    next_p: DMatrix<f64>,
    /// Normalized innovation squared of each sensor alone.
    alone: Vec<f64>,
}

/// Derivative of a function of a vector at zero, by central differences of fourth order.
fn differences(size: usize, f: impl Fn(&DVector<f64>) -> DVector<f64>) -> DMatrix<f64> {
    let columns: Vec<DVector<f64>> = (0..size)
        .map(|j| {
            let at = |t: f64| f(&DVector::from_fn(size, |i, _| if i == j { t * STEP } else { 0.0 }));
            ((at(1.0) - at(-1.0)) * 8.0 - (at(2.0) - at(-2.0))) / (12.0 * STEP)
        })
        .collect();
    DMatrix::from_columns(&columns)
}

impl<'a> Textbook<'a> {
    fn new(case: &'a Case) -> Self {
        let settings = &case.settings;
        let decay = (-settings.dt / 0.5_f64).exp();
        let density = settings.wrenches[0].density;
        let stationary = density.map(|d| (0.25 * d).sqrt());
        let deviations = [&settings.initial[..], &stationary, &[0.1; 3], &[0.2; 3]].concat();
        let walk = density.map(|d| (0.25 * d * (1.0 - decay * decay)).sqrt());
        Self {
            case,
            x: State(case.q.clone(), case.qd.clone(), vec![0.0; 12]),
            p: DMatrix::from_diagonal(&DVector::from_vec(deviations).map(|d| d * d)),
            decay: [[decay; 6], [1.0; 6]].concat(),
            walk: [&walk[..], &[0.05 * settings.dt.sqrt(); 3], &[0.0; 3]].concat(),
        }
    }

    fn n(&self) -> usize {
        self.p.nrows()
    }

    fn acceleration(&self, State(q, qd, rest): &State, tau: &[f64], noise: &[f64]) -> Vec<f64> {
        let scene = &self.case.scene;
        let wrench = nalgebra::Vector6::from_row_slice(&rest[..6]);
        let wrenches = scene.body_wrenches([(self.case.tool.as_str(), wrench)]).unwrap();
        let torque: Vec<f64> = tau.iter().zip(noise).map(|(tau, n)| tau + n).collect();
        let mut qdd = vec![f64::NAN; scene.nv()];
        scene.forward_dynamics(&mut scene.workspace(), q, qd, &torque, &wrenches, &mut qdd).unwrap();
        qdd
    }

    /// Readings of all sensors.
    fn predicted(&self, x: &State, tau: &[f64], noise: &[f64]) -> DVector<f64> {
        let (scene, State(q, qd, rest)) = (&self.case.scene, x);
        let qdd = self.acceleration(x, tau, noise);
        let frame = self.case.frame();
        let local = ReferenceFrame::Local;
        let velocity = scene.velocity(q, qd, frame, local).unwrap();
        let acceleration = scene.acceleration(q, qd, &qdd, frame, local, AccelerationKind::Classical).unwrap();
        let placement: Matrix3<f64> = scene.placement(q, frame).unwrap().rotation;
        let proper = acceleration.fixed_rows::<3>(3) - placement.transpose() * scene.model().gravity;
        let contact = scene.velocity(q, qd, "link1", local).unwrap();
        let axes = || scene.joints().iter().filter(|joint| joint.q.len() == 1);
        let mut all: Vec<f64> = axes().map(|joint| q[joint.q.start]).collect();
        all.extend((0..3).map(|i| velocity[i] + rest[6 + i]));
        all.extend((0..3).map(|i| proper[i] + rest[9 + i]));
        all.extend(axes().map(|joint| tau[joint.v.start] + noise[joint.v.start]));
        all.extend((0..3).map(|i| contact[3 + i]));
        DVector::from_vec(all)
    }

    /// The next state, with the growth of wrenches and biases.
    fn next(&self, x: &State, tau: &[f64], noise: &[f64], growth: &[f64]) -> State {
        let (scene, h) = (&self.case.scene, self.case.settings.dt);
        let moved = |velocity: &[f64], h: f64| {
            let step: Vec<f64> = velocity.iter().map(|qd| h * qd).collect();
            let mut q = vec![f64::NAN; scene.nq()];
            scene.integrate(&x.0, &step, &mut q).unwrap();
            q
        };
        let faster = |qdd: &[f64], h: f64| x.1.iter().zip(qdd).map(|(qd, qdd)| qd + h * qdd).collect::<Vec<_>>();
        let start = self.acceleration(x, tau, noise);
        let rest: Vec<f64> =
            x.2.iter().zip(&self.decay).zip(growth).map(|((rest, decay), growth)| decay * rest + growth).collect();
        let mean_rest = x.2.iter().zip(&rest).map(|(before, after)| 0.5 * (before + after)).collect();
        let middle = State(moved(&x.1, 0.5 * h), faster(&start, 0.5 * h), mean_rest);
        let qd = faster(&self.acceleration(&middle, tau, noise), h);
        let mean: Vec<f64> = x.1.iter().zip(&qd).map(|(before, after)| 0.5 * (before + after)).collect();
        State(moved(&mean, h), qd, rest)
    }

    /// x (+) e.
    fn plus(&self, State(q, qd, rest): &State, e: &[f64]) -> State {
        let (scene, nv) = (&self.case.scene, qd.len());
        let mut moved = vec![f64::NAN; scene.nq()];
        scene.integrate(q, &e[..nv], &mut moved).unwrap();
        let add = |x: &[f64], e: &[f64]| x.iter().zip(e).map(|(x, e)| x + e).collect();
        State(moved, add(qd, &e[nv..2 * nv]), add(rest, &e[2 * nv..]))
    }

    /// y (-) x.
    fn minus(&self, y: &State, x: &State) -> DVector<f64> {
        let mut e = vec![f64::NAN; x.1.len()];
        self.case.scene.difference(&x.0, &y.0, &mut e).unwrap();
        e.extend(y.1.iter().zip(&x.1).chain(y.2.iter().zip(&x.2)).map(|(y, x)| y - x));
        DVector::from_vec(e)
    }

    /// Applies a correction to a state and the covariance of its error.
    fn corrected(&self, x: &State, change: &DVector<f64>, p: &DMatrix<f64>) -> (State, DMatrix<f64>) {
        let n = self.n();
        let moved = self.plus(x, &change.as_slice()[..n]);
        // x (+) (change + e) = moved (+) J e
        let mut j = DMatrix::identity(p.nrows(), p.nrows());
        let by_e = differences(n, |e| self.minus(&self.plus(x, (change.rows(0, n) + e).as_slice()), &moved));
        j.view_mut((0, 0), (n, n)).copy_from(&by_e);
        (moved, &j * p * j.transpose())
    }

    /// One step; returns the NIS and its number of readings, and what the smoother needs.
    fn step(&mut self, tau: &[f64], readings: &[f64]) -> (f64, usize, Step) {
        let (n, nv) = (self.n(), tau.len());
        let mut p = DMatrix::zeros(n + nv, n + nv);
        p.view_mut((0, 0), (n, n)).copy_from(&self.p);
        for i in 0..nv {
            p[(n + i, n + i)] = self.case.settings.torque_noise[i] / self.case.settings.dt;
        }
        let seen: Vec<usize> = (0..readings.len()).filter(|&i| !readings[i].is_nan()).collect();
        let none = vec![0.0; nv];
        let mut noise = none.clone();
        let (mut nis, mut alone) = (0.0, vec![0.0; 5]);
        if !seen.is_empty() {
            let h = differences(n + nv, |e| {
                self.predicted(&self.plus(&self.x, &e.as_slice()[..n]), tau, &e.as_slice()[n..])
            });
            let h = h.select_rows(&seen);
            let predicted = self.predicted(&self.x, tau, &none);
            let error = DVector::from_iterator(seen.len(), seen.iter().map(|&i| readings[i] - predicted[i]));
            let axes = (readings.len() - 9) / 2;
            let deviations = [vec![1e-2; axes], vec![0.05; 3], vec![0.5; 3], vec![0.3; axes], vec![0.4; 3]].concat();
            let r = DVector::from_iterator(seen.len(), seen.iter().map(|&i| deviations[i] * deviations[i]));
            let s = &h * &p * h.transpose() + DMatrix::from_diagonal(&r);
            let places =
                [0..axes, axes..axes + 3, axes + 3..axes + 6, axes + 6..2 * axes + 6, 2 * axes + 6..2 * axes + 9];
            for (alone, place) in alone.iter_mut().zip(places) {
                let own: Vec<usize> = (0..seen.len()).filter(|&k| place.contains(&seen[k])).collect();
                let (s, error) = (s.select_rows(&own).select_columns(&own), error.select_rows(&own));
                *alone = if own.is_empty() { 0.0 } else { error.dot(&(s.try_inverse().unwrap() * &error)) };
            }
            let inverse = s.clone().try_inverse().unwrap();
            let gain = &p * h.transpose() * &inverse;
            nis = error.dot(&(&inverse * &error));
            let change = &gain * &error;
            p -= &gain * s * gain.transpose();
            noise.copy_from_slice(&change.as_slice()[n..]);
            (self.x, p) = self.corrected(&self.x, &change, &p);
        }
        let x = self.x.clone();
        let still = vec![0.0; self.walk.len()];
        let next = self.next(&x, tau, &noise, &still);
        let flow = differences(n + nv, |e| {
            let noise: Vec<f64> = noise.iter().zip(&e.as_slice()[n..]).map(|(a, b)| a + b).collect();
            self.minus(&self.next(&self.plus(&x, &e.as_slice()[..n]), tau, &noise, &still), &next)
        });
        // The growth acts in the middle of the step through the torques in the middle, without the start.
        let by_growth =
            differences(self.walk.len(), |growth| self.minus(&self.next(&x, tau, &noise, growth.as_slice()), &next));
        let by_growth = by_growth * DMatrix::from_diagonal(&DVector::from_column_slice(&self.walk));
        // The mean of a wrench, given both ends, has a twelfth of the variance of the growth.
        let mut within = by_growth.columns(0, 6) / 3.0_f64.sqrt();
        within.rows_mut(2 * nv, self.walk.len()).fill(0.0);
        let next_p = &flow * &p * flow.transpose() + &by_growth * by_growth.transpose() + &within * within.transpose();
        (self.x, self.p) = (next.clone(), next_p.clone());
        (nis, seen.len(), Step { x, p, flow, next, next_p, alone })
    }
}

/// Largest difference of two symmetric matrices, relative to the standard deviations of the second.
fn off(found: &DMatrix<f64>, expected: &DMatrix<f64>) -> f64 {
    let size = DVector::from_fn(expected.nrows(), |i, _| expected[(i, i)].sqrt());
    let mut largest = 0.0_f64;
    for ((i, j), x) in (0..size.len())
        .flat_map(|i| (0..size.len()).map(move |j| (i, j)))
        .zip((0..size.len()).flat_map(|i| (0..size.len()).map(move |j| (i, j))).map(|at| found[at] - expected[at]))
    {
        let relative = x.abs() / (size[i] * size[j]);
        largest = if relative <= largest { largest } else { relative };
    }
    largest
}

/// Largest difference of two states in standard deviations.
fn off_state(filter: &Textbook<'_>, found: &State, expected: &State, p: &DMatrix<f64>) -> f64 {
    filter
        .minus(found, expected)
        .iter()
        .enumerate()
        .map(|(i, e)| e.abs() / p[(i, i)].sqrt())
        .fold(0.0, |a, b| if b <= a { a } else { b })
}

#[test]
fn filter_and_smoother_are_those_of_the_textbook() {
    for case in Case::all() {
        let (mut observer, mut filter, mut steps) = (case.observer(), Textbook::new(&case), Vec::new());
        let n = filter.n();
        let mut covariance = vec![f64::NAN; n * n];
        let mut sums = [0.0; 5];
        for k in 0..8 {
            let (tau, readings) = case.inputs(k, &filter);
            observer.step(&tau, &readings).unwrap();
            let (nis, count, step) = filter.step(&tau, &readings);
            let estimate = observer.estimate(0).unwrap();
            let found = State(estimate.q().to_vec(), estimate.qd().to_vec(), estimate.wrenches_and_biases().to_vec());
            let expected = step.p.view((0, 0), (n, n)).into_owned();
            estimate.covariance(&mut covariance).unwrap();
            assert!(off(&DMatrix::from_row_slice(n, n, &covariance), &expected) <= DIFFERENCES, "step {k}");
            assert!(off_state(&filter, &found, &step.x, &expected) <= DIFFERENCES, "step {k}");
            let (found_nis, found_count) = observer.innovation(0).unwrap();
            assert!((found_nis - nis).abs() <= DIFFERENCES * nis.max(1.0), "step {k}: {found_nis} against {nis}");
            assert_eq!(found_count, count);
            for (sum, ((found, _), alone)) in sums.iter_mut().zip(observer.window(0).1.iter().zip(&step.alone)) {
                *sum += alone;
                assert!((found - *sum).abs() <= DIFFERENCES * sum.max(1.0), "step {k}: {found} against {sum}");
            }
            steps.push(step);
        }
        let smoothed = observer.smooth(0).unwrap();
        let last = steps.last().unwrap();
        let (mut x, mut p) = (last.x.clone(), last.p.view((0, 0), (n, n)).into_owned());
        for k in (0..steps.len()).rev() {
            if k + 1 < steps.len() {
                let step = &steps[k];
                let inverse = step.next_p.clone().try_inverse().unwrap();
                let gain = step.p.rows(0, n) * step.flow.transpose() * inverse;
                let change = &gain * filter.minus(&x, &step.next);
                let own = step.p.view((0, 0), (n, n));
                let own = own + &gain * (&p - &step.next_p) * gain.transpose();
                (x, p) = filter.corrected(&step.x, &change, &own);
            }
            let (nq, nv) = (case.scene.nq(), case.scene.nv());
            let found = State(
                smoothed.q[k * nq..(k + 1) * nq].to_vec(),
                smoothed.qd[k * nv..(k + 1) * nv].to_vec(),
                smoothed.rest[k * 12..(k + 1) * 12].to_vec(),
            );
            // The inverse of P1 amplifies the errors of the differences.
            let covariance = DMatrix::from_row_slice(n, n, &smoothed.covariance[k * n * n..(k + 1) * n * n]);
            assert!(off(&covariance, &p) <= 100.0 * DIFFERENCES, "smoothed step {k}: {}", off(&covariance, &p));
            assert!(off_state(&filter, &found, &x, &p) <= 100.0 * DIFFERENCES, "smoothed step {k}");
        }
    }
}

#[test]
fn derivatives_of_link_motions_are_those_of_dual_numbers() {
    for case in Case::all() {
        let (scene, model) = (&case.scene, case.scene.model());
        let nv = scene.nv();
        let frame = case.frame();
        let qdd: Vec<f64> = case.qd.iter().map(|x| 2.0 * x + 0.3).collect();
        let (mut of_velocity, mut of_acceleration) = (vec![f64::NAN; 12 * nv], vec![f64::NAN; 18 * nv]);
        let (local, kind) = (ReferenceFrame::Local, AccelerationKind::Classical);
        velocity_derivatives(model, (&case.q, &case.qd), &frame, local, &mut of_velocity);
        let state = (&*case.q, &*case.qd, &*qdd);
        acceleration_derivatives(model, state, &frame, (local, kind), &mut of_acceleration);
        let dual: Model<Dual<f64>> = model.cast();
        let constant = |x: &[f64]| x.iter().map(|&value| Dual { value, tangent: 0.0 }).collect::<Vec<_>>();
        for row in 0..nv {
            for by_rate in [false, true] {
                let (mut q, mut qd) = (constant(&case.q), constant(&case.qd));
                if by_rate {
                    qd[row].tangent = 1.0;
                } else {
                    let mut unit = vec![0.0; nv];
                    unit[row] = 1.0;
                    let mut rates = vec![0.0; scene.nq()];
                    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
                        let (at, own) = (body.q..body.q + body.motion.nq(), &unit[stage.first_row..]);
                        body.motion.coordinate_rates(&case.q[at.clone()], own, &mut rates[at]);
                    }
                    q.iter_mut().zip(&rates).for_each(|(q, &rate)| q.tangent = rate);
                }
                let found = frame_motion(&dual, &q, &qd, Some(&constant(&qdd)), &frame.cast());
                let acceleration = found.acceleration_in(local, kind);
                for i in 0..6 {
                    let at = (6 * usize::from(by_rate) + i) * nv + row;
                    assert!((found.velocity[i].tangent - of_velocity[at]).abs() <= ROUNDING, "velocity by {row}");
                    let off = (acceleration[i].tangent - of_acceleration[at]).abs();
                    assert!(off <= 100.0 * ROUNDING, "acceleration by {row}");
                }
            }
        }
    }
}

/// The estimate of a robot, with its covariance.
fn result(observer: &Observer<&Scene>, robot: usize) -> Vec<f64> {
    let estimate = observer.estimate(robot).unwrap();
    let mut covariance = vec![f64::NAN; estimate.size() * estimate.size()];
    estimate.covariance(&mut covariance).unwrap();
    [estimate.q(), estimate.qd(), estimate.wrenches_and_biases(), &covariance].concat()
}

#[test]
fn readings_that_arrive_later_are_processed_at_their_time() {
    let (case, mut delayed) = (Case::new(&[JointKind::Revolute; 3]), Case::new(&[JointKind::Revolute; 3]));
    delayed.settings.sensors[1].delay = 2;
    let filter = Textbook::new(&case);
    let inputs: Vec<_> = (0..9).map(|k| case.inputs(k, &filter)).collect();
    let (mut prompt, mut late) = (case.observer(), delayed.observer());
    let gyro = late.readings_of("gyro").unwrap();
    for (k, (tau, readings)) in inputs.iter().enumerate() {
        let mut given = readings.clone();
        given[gyro.clone()].fill(f64::NAN);
        if k >= 2 {
            given[gyro.clone()].copy_from_slice(&inputs[k - 2].1[gyro.clone()]);
        }
        late.step(tau, &given).unwrap();
        assert_eq!(late.innovation(0).is_some(), k >= 2);
        let mut known = readings.clone();
        if k + 2 >= inputs.len() {
            known[gyro.clone()].fill(f64::NAN);
        }
        prompt.step(tau, &known).unwrap();
    }
    assert_eq!(result(&late, 0), result(&prompt, 0));
}

#[test]
fn robots_are_independent_and_threads_change_nothing() {
    let case = Case::new(&[JointKind::Revolute; 3]);
    let filter = Textbook::new(&case);
    let count = 9;
    let (q, qd) = (case.q.repeat(count), case.qd.repeat(count));
    let mut all = Observer::new(&case.scene, &case.settings, &q, &qd).unwrap();
    let mut alone: Vec<_> = (0..count).map(|_| case.observer()).collect();
    for k in 0..4 {
        let inputs: Vec<_> = (0..count).map(|robot| case.inputs(k + 7 * robot, &filter)).collect();
        let tau: Vec<f64> = inputs.iter().flat_map(|input| input.0.clone()).collect();
        let readings: Vec<f64> = inputs.iter().flat_map(|input| input.1.clone()).collect();
        all.step(&tau, &readings).unwrap();
        for (observer, (tau, readings)) in alone.iter_mut().zip(&inputs) {
            observer.step(tau, readings).unwrap();
        }
    }
    for (robot, observer) in alone.iter().enumerate() {
        assert_eq!(result(&all, robot), result(observer, 0));
        assert_eq!(all.smooth(robot), observer.smooth(0));
    }
}

#[test]
fn an_error_leaves_the_observer_as_it_was() {
    let case = Case::new(&[JointKind::Revolute; 3]);
    let filter = Textbook::new(&case);
    let (mut observer, mut other) = (case.observer(), case.observer());
    for k in 0..5 {
        let (tau, readings) = case.inputs(k, &filter);
        let mut infinite = readings.clone();
        infinite[4] = f64::INFINITY;
        let error = observer.step(&tau, &infinite).unwrap_err().error;
        assert!(matches!(&error, Error::NotFinite { argument, index: 1, .. } if argument == "readings of 'gyro'"));
        // Readings that are finite and overflow.
        infinite[4] = f64::MAX;
        assert!(matches!(observer.step(&tau, &infinite).unwrap_err().error, Error::NotFinite { .. }));
        observer.step(&tau, &readings).unwrap();
        other.step(&tau, &readings).unwrap();
    }
    assert_eq!(result(&observer, 0), result(&other, 0));
    assert_eq!(observer.window(0), other.window(0));
}

#[test]
fn windows_end_and_a_sensor_can_be_left_out() {
    let case = Case::new(&[JointKind::Revolute; 3]);
    let (mut observer, filter) = (case.observer(), Textbook::new(&case));
    let (tau, readings) = case.inputs(0, &filter);
    let tau = vec![0.0; tau.len()];
    for _ in 0..super::WINDOW {
        observer.step(&tau, &readings).unwrap();
    }
    let (steps, sums) = observer.window(0);
    assert_eq!((steps, sums[0].1, sums[1].1), (super::WINDOW, 3 * super::WINDOW, 3 * super::WINDOW));
    let without = observer.window_without(0, 1).unwrap();
    assert_eq!(without[1], (0.0, 0));
    assert!(without[0].0 > 0.0 && without[0].1 == 3 * super::WINDOW);
    observer.step(&tau, &readings).unwrap();
    assert_eq!(observer.window(0).0, 1);
    let error = observer.window_without(0, 9).unwrap_err();
    assert!(error.to_string().contains("sensor: found 9; expected an index below 5"), "{error}");
}

#[test]
fn steps_do_not_allocate() {
    let mut case = Case::new(&[JointKind::Revolute; 6]);
    case.settings.history = 3;
    let filter = Textbook::new(&case);
    let inputs: Vec<_> = (0..10).map(|k| case.inputs(k, &filter)).collect();
    let mut observer = case.observer();
    for (k, (tau, readings)) in inputs.iter().enumerate() {
        let seen = allocation_counter::measure(|| observer.step(tau, readings).unwrap());
        assert!(k < 5 || seen.count_total == 0, "step {k}: {} allocations", seen.count_total);
    }
}

#[test]
fn settings_are_refused_by_name() {
    let case = Case::new(&[JointKind::Revolute; 3]);
    let refused = |change: &dyn Fn(&mut ObserverSettings), expected: &str| {
        let mut settings = case.settings.clone();
        change(&mut settings);
        let error = Observer::new(&case.scene, &settings, &case.q, &case.qd).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    };
    refused(&|s| s.dt = f64::NAN, "dt: found NaN");
    refused(&|s| s.torque_noise[1] = -1.0, "torque_noise: found -1");
    refused(&|s| s.initial = vec![0.1; 2], "initial: found shape (2,)");
    refused(&|s| s.sensors[1].name = "encoder".into(), "sensors: found two sensors with the name 'encoder'");
    refused(&|s| s.sensors[1].noise = vec![0.1; 2], "noise of 'gyro': found [0.1, 0.1]");
    refused(&|s| s.sensors[0].noise = vec![0.0], "noise of 'encoder'");
    refused(&|s| s.sensors[0].delay = 10_001, "delay of 'encoder': found 10001; expected at most 10000 steps");
    refused(&|s| s.sensors[0].bias = 1.0, "bias of 'encoder'");
    refused(&|s| s.sensors[1].gate = 0.0, "gate of 'gyro': found 0; expected standard deviations");
    refused(&|s| s.sensors[1].quantity = Quantity::Pose("link1".into(), Box::default()), "covariance of 'gyro'");
    refused(&|s| s.sensors[1].bias_walk = -1.0, "bias of 'gyro': found -1");
    refused(&|s| s.sensors[1].quantity = Quantity::Gyro("nowhere".into()), "nowhere");
    refused(&|s| s.sensors[0].quantity = Quantity::Encoder(Some(vec!["knee".into()])), "knee");
    refused(&|s| s.wrenches.push(s.wrenches[0].clone()), "wrenches: found two");
    refused(&|s| s.wrenches[0].correlation_time = 0.0, "correlation_time: found 0");
    let error = Observer::new(&case.scene, &case.settings, &case.q[1..], &case.qd).map(|_| ()).unwrap_err();
    assert!(error.to_string().contains("q: found shape (2,)"), "{error}");
    let mut observer = case.observer();
    assert!(observer.estimate(0).is_none() && observer.innovation(0).is_none());
    assert!(observer.smooth(0).unwrap_err().to_string().contains("step() before smooth()"));
    let error = observer.step(&[0.0; 2], &[0.0; 15]).unwrap_err().error;
    assert!(error.to_string().contains("tau: found shape (2,)"), "{error}");
    let error = observer.step(&[0.0; 3], &[0.0; 2]).unwrap_err().error;
    assert!(error.to_string().contains("readings: found shape (2,); expected (15,)"), "{error}");
}
