//! Jacobians times vectors and vectors times Jacobians, compared with the dense derivatives, each other, and central
//! differences.

use super::support::{KINDS, State, acceleration, of_accelerations, of_torques, round, torque, trees, widened};
use crate::auto::families::{Case, FAMILIES, STATES, case};
use crate::common::oracle::{D, d};
use crate::common::tolerance::{self, assert_near, assert_near_double, conditioning, size};
use crate::common::{Random, Tree};
use nalgebra::Vector6;
use phipsi::dynamics::derivatives::{
    self, Constants, Directions, Parameters, ProductScratch, inertia, of_body, of_link,
};
use phipsi::scalar::{Real, Traced};
use phipsi::scene::{JointKind, Model, Property, StateModel};
use phipsi::scenes::{extreme, names};
use phipsi::spatial::RigidShift;
use phipsi::{Arguments, Form, Scene, Workspace, dynamics, scenes};

const FORMS: [Form; 3] = [Form::Auto, Form::Covariance, Form::SquareRoot];

/// A direction for all variables, or cotangents.
#[derive(Clone)]
struct Everything<T> {
    /// For q, qd and u, concatenated.
    state: Vec<T>,
    wrenches: Vec<Vector6<T>>,
    parameters: Vec<Parameters<T>>,
    armature: Vec<T>,
    gravity: Vec<T>,
}

impl Everything<f64> {
    fn random(scene: &Scene, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let (nv, bodies) = (scene.nv(), scene.model().bodies.len());
        let mut number = || random.uniform(-1.0, 1.0);
        Self {
            state: (0..3 * nv).map(|_| number()).collect(),
            wrenches: (0..bodies).map(|_| Vector6::from_fn(|_, _| number())).collect(),
            parameters: (0..bodies).map(|_| std::array::from_fn(|_| number())).collect(),
            armature: (0..nv).map(|_| number()).collect(),
            gravity: (0..3).map(|_| number()).collect(),
        }
    }

    fn cast<T: Real>(&self) -> Everything<T> {
        let of = |x: &[f64]| x.iter().map(|&x| T::from_f64(x)).collect();
        Everything {
            state: of(&self.state),
            wrenches: self.wrenches.iter().map(|w| w.map(T::from_f64)).collect(),
            parameters: self.parameters.iter().map(|ten| ten.map(T::from_f64)).collect(),
            armature: of(&self.armature),
            gravity: of(&self.gravity),
        }
    }
}

impl<T: Real<Parameter = T>> Everything<T> {
    fn unknown(model: &Model<T>) -> Self {
        let (nan, nv, bodies) = (T::from_f64(f64::NAN), model.nv(), model.bodies.len());
        Self {
            state: vec![nan; 3 * nv],
            wrenches: vec![Vector6::from_element(nan); bodies],
            parameters: vec![[nan; 10]; bodies],
            armature: vec![nan; nv],
            gravity: vec![nan; 3],
        }
    }

    /// All of it as a direction, or q, qd and u alone.
    fn along(&self, whole: bool) -> Directions<'_, T> {
        let nv = self.armature.len();
        let (q, rest) = self.state.split_at(nv);
        let (qd, u) = rest.split_at(nv);
        let state = Directions { q, qd, u, ..Directions::default() };
        if !whole {
            return state;
        }
        let Self { wrenches, parameters, armature, gravity, .. } = self;
        Directions { wrenches, parameters, armature, gravity, ..state }
    }

    fn numbers(&self) -> Vec<T> {
        let mut all = self.state.clone();
        all.extend(self.wrenches.iter().flat_map(Vector6::iter));
        all.extend(self.parameters.iter().flatten());
        all.extend(&self.armature);
        all.extend(&self.gravity);
        all
    }
}

fn dot(a: &[D], b: &[D]) -> D {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(d(0.0), |sum, (&a, &b)| sum + a * b)
}

fn jvp_of_torques<T: Real<Parameter = T>>(model: &Model<T>, state: &State<T>, along: &Directions<'_, T>) -> Vec<T> {
    let State { q, qd, u, wrenches } = state;
    let mut out = vec![T::from_f64(f64::NAN); model.nv()];
    let (mut workspace, mut scratch) = (Workspace::new(model), ProductScratch::new(model));
    derivatives::inverse_dynamics_jvp(model, &mut workspace, &mut scratch, (q, qd, u), wrenches, along, &mut out);
    out
}

fn vjp_of_torques<T: Real<Parameter = T>>(model: &Model<T>, state: &State<T>, x: &[T]) -> Everything<T> {
    let State { q, qd, u, wrenches } = state;
    let mut all = Everything::unknown(model);
    let Everything { state: out, wrenches: of_wrenches, parameters, armature, gravity } = &mut all;
    let mut constants = Constants { wrenches: of_wrenches, parameters, armature, gravity };
    let (mut workspace, mut scratch) = (Workspace::new(model), ProductScratch::new(model));
    let results = (&mut constants, &mut out[..]);
    derivatives::inverse_dynamics_vjp(model, &mut workspace, &mut scratch, (q, qd, u), wrenches, x, results);
    all
}

fn jvp_of_accelerations<T: Real<Parameter = T>>(
    model: &Model<T>,
    form: Form,
    state: &State<T>,
    along: &Directions<'_, T>,
) -> Vec<T> {
    let State { q, qd, u, wrenches } = state;
    let mut out = vec![T::from_f64(f64::NAN); model.nv()];
    let (mut workspace, mut scratch) = (Workspace::new(model).in_form(form), ProductScratch::new(model));
    let state = (&q[..], &qd[..], &u[..]);
    derivatives::forward_dynamics_jvp(model, &mut workspace, &mut scratch, state, wrenches, along, &mut out).unwrap();
    out
}

fn vjp_of_accelerations<T: Real<Parameter = T>>(
    model: &Model<T>,
    form: Form,
    state: &State<T>,
    c: &[T],
) -> Everything<T> {
    let State { q, qd, u, wrenches } = state;
    let mut all = Everything::unknown(model);
    let Everything { state: out, wrenches: of_wrenches, parameters, armature, gravity } = &mut all;
    let mut constants = Constants { wrenches: of_wrenches, parameters, armature, gravity };
    let (mut workspace, mut scratch) = (Workspace::new(model).in_form(form), ProductScratch::new(model));
    let (state, results) = ((&q[..], &qd[..], &u[..]), (&mut constants, &mut out[..]));
    derivatives::forward_dynamics_vjp(model, &mut workspace, &mut scratch, state, wrenches, c, results).unwrap();
    all
}

/// For a model whose inertias were changed, but not their square roots.
fn acceleration_of(model: &Model<D>, state: &State<D>) -> Vec<D> {
    let State { q, qd, u, wrenches } = state;
    let mut workspace = Workspace::new(model).in_form(Form::Covariance);
    let mut out = vec![d(f64::NAN); model.nv()];
    assert!(dynamics::forward_dynamics(model, &mut workspace, q, qd, u, wrenches, &mut out).clear(0));
    out
}

/// A model and a state moved along a direction.
fn moved(model: &Model<D>, state: &State<D>, along: &Everything<D>, h: D) -> (Model<D>, State<D>) {
    let (mut model, mut state, nv) = (model.clone(), state.clone(), model.nv());
    let (v, mut q): (Vec<D>, _) = (along.state[..nv].iter().map(|&v| v * h).collect(), state.q.clone());
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        body.motion.advance(&state.q[body.q..], &v[stage.first_row..], &mut q[body.q..]);
    }
    state.q = q;
    for i in 0..nv {
        state.qd[i] += along.state[nv + i] * h;
        state.u[i] += along.state[2 * nv + i] * h;
        model.system.noise[i] += along.armature[i] * h;
    }
    state.wrenches.resize(model.bodies.len(), Vector6::from_element(d(0.0)));
    for (wrench, change) in state.wrenches.iter_mut().zip(&along.wrenches) {
        *wrench += change * h;
    }
    for (body, change) in model.bodies.iter_mut().zip(&along.parameters) {
        body.inertia = body.inertia.add(&inertia(&change.map(|x| x * h)));
    }
    for i in 0..3 {
        model.gravity[i] += along.gravity[i] * h;
    }
    (model, state)
}

/// Central difference along a direction of all variables.
fn difference(
    model: &Model<D>,
    state: &State<D>,
    along: &Everything<D>,
    f: impl Fn(&Model<D>, &State<D>) -> Vec<D>,
) -> Vec<D> {
    let [ahead, back] = [tolerance::STEP, -tolerance::STEP].map(|h| {
        let (model, state) = moved(model, state, along, d(h));
        f(&model, &state)
    });
    ahead.iter().zip(&back).map(|(&a, &b)| (a - b) * d(0.5 / tolerance::STEP)).collect()
}

/// J v or, `transposed`, w J for three concatenated matrices.
fn dense(three: &[Vec<D>; 3], vector: &[D], transposed: bool) -> Vec<D> {
    let nv = vector.len() / if transposed { 1 } else { 3 };
    if transposed {
        let entry = |matrix: &Vec<D>, j: usize| (0..nv).fold(d(0.0), |sum, i| sum + vector[i] * matrix[i * nv + j]);
        return three.iter().flat_map(|matrix| (0..nv).map(move |j| entry(matrix, j))).collect();
    }
    (0..nv)
        .map(|i| {
            three.iter().enumerate().fold(d(0.0), |sum, (k, matrix)| {
                (0..nv).fold(sum, |sum, j| sum + matrix[i * nv + j] * vector[k * nv + j])
            })
        })
        .collect()
}

/// The state itself, at rest, in static equilibrium, and passive.
fn states(scene: &Scene, seed: u64) -> Vec<State<f64>> {
    let state = State::random(scene, seed);
    let mut rest = State { wrenches: Vec::new(), ..state.clone() };
    rest.qd.fill(0.0);
    rest.u.fill(0.0);
    let (mut held, mut falling) = (rest.clone(), rest.clone());
    scene.bias_torque(&mut scene.workspace(), &rest.q, &rest.qd, &mut held.u).unwrap();
    let mut qdd = vec![f64::NAN; scene.nv()];
    scene.forward_dynamics(&mut scene.workspace(), &rest.q, &rest.qd, &rest.u, &[], &mut qdd).unwrap();
    falling.u = qdd;
    vec![state, rest, held, falling]
}

fn largest(three: &[Vec<D>; 3], more: &[f64]) -> f64 {
    three.iter().map(|matrix| size(&round(matrix))).sum::<f64>() + size(more)
}

#[test]
fn torques_as_dense_derivatives_and_differences() {
    for tree in trees(40) {
        let scene = tree.scene();
        let (model, n) = (scene.model(), 4 * scene.links().len().max(4));
        let wide = widened(&scene);
        for state in states(&scene, 100 + tree.seed) {
            let (v, w) = (Everything::random(&scene, 31 + tree.seed), Everything::random(&scene, 17 + tree.seed));
            let (at, along): (State<D>, Everything<D>) = (state.cast(), v.cast());
            let x: Vec<D> = w.cast::<D>().armature;
            let three = of_torques(&wide, &at);
            let scale = largest(&three, &round(&torque(&wide, &at)));
            // As J v and w J, in double-double arithmetic and in f64.
            let (expected, gradients) = (dense(&three, &along.state, false), dense(&three, &x, true));
            let found = jvp_of_torques(&wide, &at, &along.along(false));
            assert_near_double("J v", &found, &expected, tolerance::double_double(n, scale));
            let found = jvp_of_torques(model, &state, &v.along(false));
            assert_near("J v", &found, &round(&expected), tolerance::product(n, scale));
            let all = vjp_of_torques(&wide, &at, &x);
            assert_near_double("w J", &all.state, &gradients, tolerance::double_double(n, scale));
            let found = vjp_of_torques(model, &state, &w.armature);
            assert_near("w J", &found.numbers(), &round(&all.numbers()), tolerance::product(n, 10.0 * scale));
            // Along all variables, by differences and by the adjoint identity.
            let tangent = jvp_of_torques(&wide, &at, &along.along(true));
            let expected = difference(&wide, &at, &along, torque);
            assert_near_double("along everything", &tangent, &expected, tolerance::difference(n, 10.0 * scale));
            let (one, other) = (dot(&x, &tangent), dot(&all.numbers(), &along.numbers()));
            assert_near_double("identity", &[one], &[other], tolerance::double_double(n, 10.0 * scale));
        }
    }
}

/// Condition number of M at a configuration.
fn condition(scene: &Scene, q: &[f64]) -> f64 {
    let mut mass = vec![f64::NAN; scene.nv() * scene.nv()];
    scene.mass_matrix(&mut scene.workspace(), q, &mut mass).unwrap();
    conditioning(scene.nv(), &mass).number
}

#[test]
fn accelerations_as_dense_derivatives_and_differences() {
    for tree in trees(32) {
        let scene = tree.scene();
        let (model, n) = (scene.model(), 4 * scene.links().len().max(4));
        let wide = widened(&scene);
        for state in states(&scene, 100 + tree.seed) {
            let (v, w) = (Everything::random(&scene, 31 + tree.seed), Everything::random(&scene, 17 + tree.seed));
            let (at, along): (State<D>, Everything<D>) = (state.cast(), v.cast());
            let c: Vec<D> = w.cast::<D>().armature;
            let three = of_accelerations(&wide, Form::Covariance, &at).unwrap();
            let cond = condition(&scene, &state.q);
            let scale = largest(&three, &round(&acceleration(&wide, &at)));
            let (expected, gradients) = (dense(&three, &along.state, false), dense(&three, &c, true));
            let tangent = jvp_of_accelerations(&wide, Form::Covariance, &at, &along.along(false));
            assert_near_double("J v", &tangent, &expected, cond * tolerance::double_double(n, scale));
            let all = vjp_of_accelerations(&wide, Form::Covariance, &at, &c);
            assert_near_double("w J", &all.state, &gradients, cond * tolerance::double_double(n, scale));
            let (numbers, rounded) = (all.numbers(), round(&all.numbers()));
            let whole = jvp_of_accelerations(&wide, Form::Covariance, &at, &along.along(true));
            let expected_whole = difference(&wide, &at, &along, acceleration_of);
            let all_scale = scale.max(size(&round(&expected_whole)));
            let bound = cond * cond * tolerance::difference(n, 10.0 * all_scale);
            assert_near_double("along everything", &whole, &expected_whole, bound);
            let (one, other) = (dot(&c, &whole), dot(&numbers, &along.numbers()));
            let bound = cond * tolerance::double_double(n, 10.0 * all_scale);
            assert_near_double("identity", &[one], &[other], bound);
            for form in FORMS {
                let found = jvp_of_accelerations(model, form, &state, &v.along(false));
                assert_near("J v", &found, &round(&expected), tolerance::inverse(cond, scale));
                let found = vjp_of_accelerations(model, form, &state, &w.armature);
                let bound = tolerance::inverse(cond, scale.max(size(&rounded)));
                assert_near("w J", &found.numbers(), &rounded, bound);
            }
        }
    }
}

/// For a single joint the inward propagation of its own frame has no effect, and the motion of its parent differs
/// from its own.
#[test]
fn each_kind_alone_and_on_a_turning_parent() {
    for kind in KINDS {
        for bodies in [1, 2, 3] {
            for floating in [false, true] {
                let kinds = [kind];
                let tree = Tree { seed: 7, bodies, kinds: &kinds, branching: 0.0, armature: 0.0, floating };
                let scene = tree.scene();
                let (state, wide) = (State::random(&scene, 5), widened(&scene));
                let (v, w) = (Everything::random(&scene, 3).cast(), Everything::random(&scene, 4).cast::<D>());
                let at = state.cast();
                let three = of_torques(&wide, &at);
                let scale = 10.0 * largest(&three, &round(&torque(&wide, &at)));
                let expected = difference(&wide, &at, &v, torque);
                let tangent = jvp_of_torques(&wide, &at, &v.along(true));
                assert_near_double("tangent", &tangent, &expected, tolerance::difference(8, scale));
                let found = vjp_of_torques(&wide, &at, &w.armature);
                let gradients = dense(&three, &w.armature, true);
                assert_near_double("gradients", &found.state, &gradients, tolerance::double_double(8, scale));
                let (one, other) = (dot(&w.armature, &tangent), dot(&found.numbers(), &v.numbers()));
                assert_near_double("identity", &[one], &[other], tolerance::double_double(8, scale));
            }
        }
    }
}

/// Torques are linear in the parameters: the products of cotangents and parameters sum up to x . tau, except for
/// wrenches and armature.
#[test]
fn torques_are_linear_in_the_parameters() {
    for tree in trees(16) {
        let scene = tree.scene();
        let wide = widened(&scene);
        let at = State { wrenches: Vec::new(), ..State::random(&scene, tree.seed).cast() };
        let x = Everything::random(&scene, 9).cast::<D>().armature;
        let gradients = vjp_of_torques(&wide, &at, &x);
        let own = wide.bodies.iter().map(|body| derivatives::parameters(&body.inertia));
        let mut sum = dot(&gradients.armature, &wide.system.noise);
        for (of_body, ten) in gradients.parameters.iter().zip(own) {
            sum += dot(of_body, &ten);
        }
        let tau = torque(&wide, &at);
        let scale = 10.0 * (size(&round(&tau)) + 1.0);
        assert_near_double("parameters", &[sum], &[dot(&x, &tau)], tolerance::double_double(wide.nv(), scale));
    }
}

/// Parameters of a link and of its body: <Y, T d> = <T* Y, d>, and a body that is a single link has the given
/// parameters.
#[test]
fn parameters_of_links_and_bodies() {
    let scene = trees(8).last().unwrap().scene();
    let mut random = Random::new(2);
    for link in scene.links() {
        let placed = link.placement;
        let [given, cotangent]: [Parameters<f64>; 2] =
            [0, 1].map(|_| std::array::from_fn(|_| random.uniform(-1.0, 1.0)));
        let (of_body, of_link) = (of_body(&placed, &given), of_link(&placed, &cotangent));
        let sum = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (one, other) = (sum(&of_body, &cotangent), sum(&given, &of_link));
        tolerance::assert_close("transposed", one, other, tolerance::product(40, 10.0));
        let same = derivatives::of_body(&RigidShift::identity(), &given);
        assert_near("itself", &same, &given, 0.0);
    }
}

/// Floating-point operations of the products, per call on one state: of torques along a direction and back, of
/// accelerations likewise.
fn counted(scene: &Scene) -> [u64; 6] {
    let (model, state) = (scene.model().cast::<Traced>(), State::random(scene, 1).cast::<Traced>());
    let v: Everything<Traced> = Everything::random(scene, 2).cast();
    let State { q, qd, u, wrenches } = &state;
    let (mut workspace, mut scratch) = (Workspace::new(&model).in_form(Form::Covariance), ProductScratch::new(&model));
    let (mut out, mut all) =
        (vec![Traced::from_f64(f64::NAN); model.nv()], vec![Traced::from_f64(f64::NAN); 3 * model.nv()]);
    let along = v.along(false);
    let at = (&q[..], &qd[..], &u[..]);
    let mut counts = Vec::new();
    counts.push(
        Traced::counted(|| {
            dynamics::inverse_dynamics(&model, &mut workspace, q, qd, u, wrenches, &mut out);
        })
        .1,
    );
    counts.push(
        Traced::counted(|| {
            let _ = dynamics::forward_dynamics(&model, &mut workspace, q, qd, u, wrenches, &mut out);
        })
        .1,
    );
    counts.push(
        Traced::counted(|| {
            derivatives::inverse_dynamics_jvp(&model, &mut workspace, &mut scratch, at, wrenches, &along, &mut out);
        })
        .1,
    );
    let mut none = Constants::default();
    counts.push(
        Traced::counted(|| {
            let results = (&mut none, &mut all[..]);
            derivatives::inverse_dynamics_vjp(&model, &mut workspace, &mut scratch, at, wrenches, &v.armature, results);
        })
        .1,
    );
    counts.push(
        Traced::counted(|| {
            derivatives::forward_dynamics_jvp(&model, &mut workspace, &mut scratch, at, wrenches, &along, &mut out)
                .unwrap();
        })
        .1,
    );
    let mut none = Constants::default();
    counts.push(
        Traced::counted(|| {
            let results = (&mut none, &mut all[..]);
            derivatives::forward_dynamics_vjp(&model, &mut workspace, &mut scratch, at, wrenches, &v.armature, results)
                .unwrap();
        })
        .1,
    );
    std::array::from_fn(|i| counts[i].flops())
}

#[test]
fn operations() {
    let branched =
        Tree { seed: 6, bodies: 30, kinds: &[JointKind::Revolute], branching: 0.5, armature: 0.1, floating: true };
    let mixed = Tree { kinds: &KINDS, ..branched };
    let mut shown = vec![("branched, floating".to_owned(), branched.scene()), ("all kinds".to_owned(), mixed.scene())];
    for n in [7, 50] {
        shown.push((format!("chain({n})"), scenes::chain(n).unwrap()));
    }
    for (name, scene) in shown {
        let [of_id, of_fd, id_jvp, id_vjp, fd_jvp, fd_vjp] = counted(&scene);
        if std::env::var_os("PHIPSI_SHOW_RATIOS").is_some() {
            eprintln!(
                "{name}, nv = {}: ID {of_id}, jvp {id_jvp}, vjp {id_vjp}; FD {of_fd}, jvp {fd_jvp}, vjp {fd_vjp}",
                scene.nv()
            );
        }
        let limit = 21 * of_fd / 10;
        assert!(fd_vjp <= limit && fd_jvp <= limit && id_jvp <= of_fd && id_vjp <= of_fd, "{name}");
    }
}

/// O(N): each additional link has the same cost, at any position.
#[test]
fn linear_in_the_length_of_a_chain() {
    let [short, long, twice] = [500, 1000, 2000].map(|n| counted(&scenes::chain(n).unwrap()));
    for i in 0..short.len() {
        assert_eq!(twice[i] - long[i], 2 * (long[i] - short[i]));
    }
}

/// By dual numbers in f64, compared with central differences of the gradients in double-double arithmetic.
#[test]
fn hessians_as_differences_of_gradients() {
    for tree in trees(24) {
        let scene = tree.scene();
        let (model, nv, wide) = (scene.model(), scene.nv(), widened(&scene));
        for state in states(&scene, 100 + tree.seed) {
            let (v, x) = (Everything::random(&scene, 6).state, Everything::random(&scene, 17).armature);
            let direction = [&v[..nv], &v[nv..2 * nv], &v[2 * nv..]];
            // For the state alone.
            let along = Everything {
                wrenches: vec![Vector6::zeros(); model.bodies.len()],
                parameters: vec![[0.0; 10]; model.bodies.len()],
                armature: vec![0.0; nv],
                gravity: vec![0.0; 3],
                state: v.clone(),
            };
            let (at, along, wide_x) = (state.cast(), along.cast(), x.iter().map(|&x| d(x)).collect::<Vec<_>>());
            let cond = condition(&scene, &state.q);
            let State { q, qd, u, wrenches } = &state;
            let given = Arguments { q, qd, u, wrenches, seed: [&x, &[], &[]], ..Arguments::default() };
            let mut found = vec![f64::NAN; 3 * nv];
            let mut scratch = scene.hessian_scratch();
            scene.inverse_dynamics_hvp(&mut scratch, &given, direction, &mut found).unwrap();
            let gradients = |model: &Model<D>, state: &State<D>| vjp_of_torques(model, state, &wide_x).state;
            let expected = round(&difference(&wide, &at, &along, gradients));
            let scale = size(&expected).max(size(&round(&gradients(&wide, &at))));
            assert_near("of torques", &found, &expected, tolerance::product(4 * nv.max(1), scale));
            let mut workspace = scene.workspace().in_form(Form::Covariance);
            scene.forward_dynamics_hvp(&mut workspace, &mut scratch, &given, direction, &mut found).unwrap();
            let form = Form::Covariance;
            let gradients =
                |model: &Model<D>, state: &State<D>| vjp_of_accelerations(model, form, state, &wide_x).state;
            let expected = round(&difference(&wide, &at, &along, gradients));
            let scale = size(&expected).max(size(&round(&gradients(&wide, &at))));
            assert_near("of accelerations", &found, &expected, tolerance::inverse(cond * cond.sqrt(), scale));
        }
    }
}

/// Hessian products of a state with its own model are those of the scene of that model.
#[test]
fn hessians_of_a_model_are_those_of_its_scene() {
    for tree in trees(12) {
        let (scene, mut random) = (tree.scene(), Random::new(tree.seed));
        let (nv, State { q, qd, u, wrenches }) = (scene.nv(), State::random(&scene, tree.seed));
        let heavier = |ten: &[f64]| {
            let factor = random.uniform(0.5, 2.0);
            ten.iter().map(|number| factor * number).collect::<Vec<_>>()
        };
        let inertias: Vec<f64> = scene.inertial_parameters().chunks_exact(10).flat_map(heavier).collect();
        let armature = vec![0.2; nv];
        let own = scene.with_inertial_parameters(&inertias).unwrap();
        let names: Vec<String> = scene.joints().iter().map(|joint| joint.name.clone()).collect();
        let own = own.with_properties(names.iter().map(|name| (&**name, Property::Armature, 0.2))).unwrap();
        let v = Everything::random(&scene, 6).state;
        let (direction, x) = ([&v[..nv], &v[nv..2 * nv], &v[2 * nv..]], &v[nv..2 * nv]);
        let of_scene =
            Arguments { q: &q, qd: &qd, u: &u, wrenches: &wrenches, seed: [x, &[], &[]], ..Arguments::default() };
        let of_model = Arguments { model: StateModel { inertias: &inertias, armature: &armature }, ..of_scene };
        let of = |scene: &Scene, state: &Arguments<'_>| {
            let (mut torques, mut scratch) = (vec![f64::NAN; 3 * nv], scene.hessian_scratch());
            scene.inverse_dynamics_hvp(&mut scratch, state, direction, &mut torques).unwrap();
            FORMS.map(|form| {
                let (mut workspace, mut out) = (scene.workspace().in_form(form), vec![f64::NAN; 3 * nv]);
                scene.forward_dynamics_hvp(&mut workspace, &mut scratch, state, direction, &mut out).unwrap();
                (torques.clone(), out)
            })
        };
        let condition = condition(&own, &q);
        for ((torques, rates), (of_torques, of_rates)) in of(&scene, &of_model).iter().zip(&of(&own, &of_scene)) {
            assert_near("of torques", torques, of_torques, tolerance::product(4 * nv, size(of_torques)));
            assert_near("of accelerations", rates, of_rates, tolerance::inverse(condition, size(of_rates)));
        }
        let light = StateModel { inertias: &[-1.0; 10], armature: &[] };
        let wrong = Arguments { model: light, ..of_scene };
        let mut out = vec![f64::NAN; 3 * nv];
        let refused = scene.inverse_dynamics_hvp(&mut scene.hessian_scratch(), &wrong, direction, &mut out);
        assert!(refused.unwrap_err().to_string().contains("inertias"));
    }
}

/// A joint without inertia about its axis is named by every product; products of torques have no singular pivots.
#[test]
fn a_lost_pivot_is_told() {
    let scene = scenes::chain(3).unwrap();
    let mut model = scene.model().clone();
    for body in &mut model.bodies[2..] {
        body.inertia = inertia(&[0.0; 10]);
        body.inertia_terms = Vector6::zeros();
    }
    model.inertia_roots[2] = Some(phipsi::spatial::BodyRoot::zero());
    let state = State { q: vec![0.1; 3], qd: vec![0.2; 3], u: vec![0.3; 3], wrenches: Vec::new() };
    let State { q, qd, u, .. } = &state;
    for form in FORMS {
        let (mut workspace, mut scratch) = (Workspace::new(&model).in_form(form), ProductScratch::new(&model));
        let (mut out, at) = (vec![f64::NAN; 9], (&q[..], &qd[..], &u[..]));
        let results = (&mut Constants::default(), &mut out[..]);
        let lost = derivatives::forward_dynamics_vjp(&model, &mut workspace, &mut scratch, at, &[], qd, results);
        assert_eq!(lost.unwrap_err().stage, 2);
        let along = Directions { q: qd, qd, u: qd, ..Directions::default() };
        let out = &mut out[..3];
        let lost = derivatives::forward_dynamics_jvp(&model, &mut workspace, &mut scratch, at, &[], &along, out);
        assert_eq!(lost.unwrap_err().stage, 2);
    }
    assert!(vjp_of_torques(&model, &state, qd).numbers().iter().all(|x| x.is_finite()));
}

/// Errors of arguments contain their names.
#[test]
fn bad_arguments_are_named() {
    let scene = scenes::chain(3).unwrap();
    let mut workspace = scene.workspace();
    let (q, three, two) = ([0.1; 3], [0.2; 3], [0.3; 2]);
    let nan = [0.1, f64::NAN, 0.3];
    let (mut one, mut all) = ([0.0; 3], [0.0; 9]);
    let direction = [&three[..], &three, &three];
    scene.forward_dynamics_jvp(&mut workspace, &q, &three, &three, &[], direction, &mut one).unwrap();
    scene.forward_dynamics_vjp(&mut workspace, &q, &three, &three, &[], &three, &mut all).unwrap();
    let named = |result: Result<(), phipsi::Error>, name: &str| {
        let message = result.unwrap_err().to_string();
        assert!(message.contains(name), "{message}");
    };
    let bad = [&three[..], &two, &three];
    named(scene.inverse_dynamics_jvp(&mut workspace, &q, &three, &three, &[], bad, &mut one), "dqd");
    let bad = [&three[..], &three, &nan];
    named(scene.forward_dynamics_jvp(&mut workspace, &q, &three, &three, &[], bad, &mut one), "dtau");
    named(scene.inverse_dynamics_jvp(&mut workspace, &q, &three, &three, &[], bad, &mut one), "dqdd");
    named(scene.inverse_dynamics_vjp(&mut workspace, &q, &three, &three, &[], &nan, &mut all), "cotangent");
    named(scene.forward_dynamics_vjp(&mut workspace, &q, &three, &three, &[], &three, &mut one), "out");
    named(scene.forward_dynamics_gradients(&mut workspace, &q, &three, &three, &[], &three, &mut all), "out");
    let mut hessian = scenes::chain(4).unwrap().hessian_scratch();
    let state = Arguments { q: &q, qd: &three, u: &three, seed: [&three, &[], &[]], ..Arguments::default() };
    named(scene.inverse_dynamics_hvp(&mut hessian, &state, direction, &mut all), "scratch");
    let mut third = [0.1; 3 + 3 + 3 + 16 * 3];
    let along = |third: &[f64], workspace: &mut Workspace<f64>| {
        let state = Arguments { seed: [&three, &three, third], ..state };
        scene.inverse_dynamics_along(workspace, &state, &mut [0.0; 3])
    };
    along(&third, &mut workspace).unwrap();
    named(along(&three, &mut workspace), "dqdd");
    for (at, name) in [(2, "dqdd"), (5, "darmature"), (8, "dgravity"), (9, "dwrenches"), (56, "dparameters")] {
        third[at] = f64::NAN;
        named(along(&third, &mut workspace), name);
        third[at] = 0.1;
    }
}

/// The methods along all variables, as the functions of the recursion.
#[test]
fn methods_along_constants_are_the_recursion() {
    for tree in trees(8) {
        let scene = tree.scene();
        let v = Everything::random(&scene, tree.seed);
        let along = v.along(true);
        let mut third = along.u.to_vec();
        third.extend(along.armature.iter().chain(along.gravity));
        third.extend(along.wrenches.iter().flat_map(Vector6::iter));
        third.extend(along.parameters.as_flattened());
        for state in states(&scene, tree.seed) {
            let State { q, qd, u, wrenches } = &state;
            let given = Arguments { q, qd, u, wrenches, seed: [along.q, along.qd, &third], ..Arguments::default() };
            let (mut found, mut workspace) = (vec![f64::NAN; scene.nv()], scene.workspace().in_form(Form::Covariance));
            scene.inverse_dynamics_along(&mut workspace, &given, &mut found).unwrap();
            let expected = jvp_of_torques(scene.model(), &state, &along);
            assert_near("of torques", &found, &expected, tolerance::product(4 * scene.nv().max(1), size(&expected)));
            scene.forward_dynamics_along(&mut workspace, &given, &mut found).unwrap();
            let expected = jvp_of_accelerations(scene.model(), Form::Covariance, &state, &along);
            let allowed = tolerance::inverse(condition(&scene, q), size(&expected));
            assert_near("of accelerations", &found, &expected, allowed);
        }
    }
}

/// Largest errors of form `auto`, by the methods, relative to the largest entry: along a random direction, and
/// of the gradients with respect to q, qd and tau; none if a pivot is singular even in double-double
/// arithmetic.
fn errors_of_auto(scene: &Scene, state: &State<f64>) -> Option<[f64; 4]> {
    let (nv, wide) = (scene.nv(), scene.model().cast::<D>());
    let (v, c) = (Everything::random(scene, 3), Everything::random(scene, 4).armature);
    let State { q, qd, u, wrenches } = state;
    let exact_state: State<D> = state.cast();
    let (mut workspace, mut scratch) = (Workspace::new(&wide).in_form(Form::SquareRoot), ProductScratch::new(&wide));
    let at = (&exact_state.q[..], &exact_state.qd[..], &exact_state.u[..]);
    let (along, wide_c): (Everything<D>, Vec<D>) = (v.cast(), c.iter().map(|&x| d(x)).collect());
    let mut tangent = vec![d(f64::NAN); nv];
    let (along, wrenches_of) = (along.along(false), &exact_state.wrenches);
    derivatives::forward_dynamics_jvp(&wide, &mut workspace, &mut scratch, at, wrenches_of, &along, &mut tangent)
        .ok()?;
    let mut gradients = vec![d(f64::NAN); 3 * nv];
    let results = (&mut Constants::default(), &mut gradients[..]);
    derivatives::forward_dynamics_vjp(&wide, &mut workspace, &mut scratch, at, wrenches_of, &wide_c, results).ok()?;
    let (tangent, gradients) = (round(&tangent), round(&gradients));
    if !tangent.iter().chain(&gradients).all(|x| x.is_finite()) {
        return None;
    }
    let mut own = scene.workspace();
    let (mut found, mut all) = (vec![f64::NAN; nv], vec![f64::NAN; 3 * nv]);
    let direction = [&v.state[..nv], &v.state[nv..2 * nv], &v.state[2 * nv..]];
    scene.forward_dynamics_jvp(&mut own, q, qd, u, wrenches, direction, &mut found).unwrap();
    scene.forward_dynamics_vjp(&mut own, q, qd, u, wrenches, &c, &mut all).unwrap();
    let inverse = size(&gradients[2 * nv..]);
    let error = |found: &[f64], exact: &[f64]| {
        let off: Vec<f64> = found.iter().zip(exact).map(|(a, b)| a - b).collect();
        let scale = if size(exact) <= tolerance::NOTHING * inverse { inverse } else { size(exact) };
        if size(&off) == 0.0 { 0.0 } else { size(&off) / scale }
    };
    let part = |i: usize| i * nv..(i + 1) * nv;
    let [by_q, by_qd, by_tau] = [0, 1, 2].map(|i| error(&all[part(i)], &gradients[part(i)]));
    let mut product = vec![f64::NAN; 3 * nv];
    scene.inverse_dynamics_vjp(&mut own, q, qd, u, wrenches, &all[2 * nv..], &mut product).unwrap();
    if std::env::var_os("PHIPSI_SHOW_RATIOS").is_some() {
        let off: Vec<f64> = product[2 * nv..].iter().zip(&c).map(|(a, b)| a - b).collect();
        eprintln!("M x - c {:.1e}", size(&off) / size(&c));
    }
    Some([error(&found, &tangent), by_q, by_qd, by_tau])
}

fn shown(errors: &[f64]) -> String {
    errors.iter().map(|error| format!("{error:.1e}")).collect::<Vec<_>>().join(" ")
}

/// Compared with the dense derivatives of `auto`.
#[test]
fn extreme_scenes_keep_what_is_promised() {
    let mut worst = Vec::new();
    for (number, family) in FAMILIES.iter().enumerate() {
        for base in [Some(case(number)), case(number).on_a_free_base(1)].into_iter().flatten() {
            for name in STATES {
                let Some(Case { scene, q, qd, tau, wrenches, .. }) = base.in_state(name) else { continue };
                let Some(found) = errors_of_auto(&scene, &State { q, qd, u: tau, wrenches }) else { continue };
                worst.push((found.into_iter().fold(0.0, f64::max), format!("{family}, {name}: {}", shown(&found))));
            }
        }
    }
    for name in names() {
        for &value in extreme(name, None, None, 0).unwrap().values {
            if (name == "zero-inertia" && value == 0.0) || (name == "long-chain" && value > 40.0) {
                continue;
            }
            let case = extreme(name, Some(value), None, 1).unwrap();
            let state = State { q: case.q, qd: case.qd, u: case.tau, wrenches: Vec::new() };
            let Some(found) = errors_of_auto(&case.scene, &state) else { continue };
            worst.push((found.into_iter().fold(0.0, f64::max), format!("{name} {value:e}: {}", shown(&found))));
        }
    }
    worst.sort_by(|a, b| b.0.total_cmp(&a.0));
    if std::env::var_os("PHIPSI_SHOW_RATIOS").is_some() {
        for (_, told) in worst.iter().take(40) {
            eprintln!("{told}");
        }
    }
    let (error, told) = &worst[0];
    assert!(*error <= tolerance::CANCELLED_DERIVATIVES, "{told}");
}
