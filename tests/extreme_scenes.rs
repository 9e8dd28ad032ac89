//! The extreme scenes by name, and the error of the square-root form compared with the sensitivity of the problems.
//!
//! Run with `PHIPSI_SHOW_RATIOS=1 -- --nocapture` for the table.

#![allow(clippy::float_cmp)] // exact equality is asserted

use crate::common::{ALL_KINDS, Random, Tree, random_state, tolerance};
use phipsi::report::accuracy::Method;
use phipsi::report::sensitivity::{Exact, Quantity, State, sensitivity};
use phipsi::report::stability::forward_error;
use phipsi::scene::{Inertial, SceneBuilder};
use phipsi::scenes::{Extreme, extreme, names};
use phipsi::spatial::Symmetric3;
use phipsi::{Error, Form, Scene, dynamics};

/// Number of joints, limited so that a debug build takes seconds.
const MOST: f64 = 100.0;

/// Number of states of each case, and of trees of each size, limited so that a debug build takes seconds.
const STATES: u64 = if cfg!(debug_assertions) { 1 } else { 8 };
const TREES: usize = if cfg!(debug_assertions) { 1 } else { 2 };

/// Every case at every value of its parameter.
fn sweeps(seed: u64) -> impl Iterator<Item = Extreme> {
    names().flat_map(move |name| {
        let usual = extreme(name, None, None, 0).unwrap();
        let values = usual.values.iter().filter(move |&&value| name != "long-chain" || value <= MOST);
        values.map(move |&value| extreme(name, Some(value), None, seed).unwrap())
    })
}

fn state(case: &Extreme) -> State<'_> {
    State { q: &case.q, qd: &case.qd, u: &case.tau }
}

fn is_singular(case: &Extreme) -> bool {
    case.name == "zero-inertia" && case.value == 0.0
}

#[test]
fn every_case_is_the_same_from_the_same_arguments_and_generic() {
    assert!(names().len() >= 16);
    for case in sweeps(0) {
        let again = extreme(case.name, Some(case.value), None, 0).unwrap();
        assert_eq!(case.scene.source(), again.scene.source(), "{}", case.name);
        assert_eq!((&case.q, &case.qd, &case.tau), (&again.q, &again.qd, &again.tau));
        let other = extreme(case.name, Some(case.value), None, 1).unwrap();
        assert_ne!(case.tau, other.tau, "{}", case.name);
        for numbers in [&case.q, &case.qd, &case.tau] {
            for (i, x) in numbers.iter().enumerate() {
                #[allow(clippy::cast_possible_truncation)] // compared exactly
                let single = f64::from(*x as f32);
                let of_quaternion = case.name == "far-base" && (3..7).contains(&i) && numbers == &case.q;
                assert!(*x != 0.0 && x.is_finite() && (single == *x || of_quaternion), "{}", case.name);
                assert!(!numbers[..i].contains(x), "{}: {x} twice", case.name);
            }
        }
        assert!(case.values.contains(&case.value) && case.values.len() >= 4);
        assert!(case.scene.warnings().is_empty(), "{}: {:?}", case.name, case.scene.warnings());
        assert!(!case.parameter.is_empty());
    }
}

/// The parameter has an effect: neighboring values have different accelerations, or different scenes.
#[test]
fn the_parameter_changes_the_case() {
    for name in names() {
        let usual = extreme(name, None, None, 0).unwrap();
        for pair in usual.values.windows(2) {
            let [a, b] = [pair[0], pair[1]].map(|value| extreme(name, Some(value), None, 0).unwrap());
            assert!(a.scene.source() != b.scene.source() || a.q != b.q || a.qd != b.qd, "{name} at {pair:?}");
        }
    }
}

#[test]
fn sizes_can_be_chosen() {
    for name in names().filter(|&name| name != "long-chain") {
        let case = extreme(name, None, Some(5), 0).unwrap();
        assert_eq!(case.scene.nv(), if name == "far-base" { 11 } else { 5 }, "{name}");
    }
    assert_eq!(extreme("long-chain", Some(10_000.0), None, 0).unwrap().scene.nv(), 10_000);
}

#[test]
fn what_cannot_be_built_is_refused() {
    let refused = |name, value, bodies| match extreme(name, value, bodies, 0) {
        Err(Error::Argument { argument, expected, .. }) => (argument, expected),
        other => panic!("{other:?}"),
    };
    let (argument, expected) = refused("no-such-case", None, None);
    assert!(argument == "name" && names().all(|name| expected.contains(name)));
    for value in [f64::NAN, f64::INFINITY, -1.0, 0.0] {
        assert_eq!(refused("heavy-tip", Some(value), None).0, "value");
    }
    for value in [2.5, 0.0, 1e9] {
        assert_eq!(refused("long-chain", Some(value), None).0, "value");
    }
    for bodies in [0, 1, 200_000] {
        assert_eq!(refused("alternating-masses", None, Some(bodies)).0, "bodies");
    }
    assert_eq!(refused("long-chain", None, Some(7)).0, "bodies");
}

/// The joint of a body without inertia about its axis is named, by the checked call and by the reference.
#[test]
fn the_singular_case_names_its_joint() {
    for bodies in [1, 2, 6] {
        let case = extreme("zero-inertia", Some(0.0), Some(bodies), 0).unwrap();
        let mut qdd = vec![f64::NAN; bodies];
        let plain =
            case.scene.forward_dynamics(&mut case.scene.workspace(), &case.q, &case.qd, &case.tau, &[], &mut qdd);
        let exact = Exact::new(&case.scene, Quantity::ForwardDynamics, state(&case)).map(|_| ());
        for result in [plain, exact] {
            let Err(Error::SingularJoint { joint, link, .. }) = result else { panic!("{result:?}") };
            assert_eq!((joint, link), (format!("joint{}", bodies - 1), format!("link{}", bodies - 1)));
        }
    }
}

/// Error of the square-root form in one state, in both norms, in units of its bounds.
struct Measured {
    norm: f64,
    norm_bound: f64,
    /// The component with the largest error relative to its bound, and that bound.
    component: f64,
    component_bound: f64,
}

impl Measured {
    fn new(what: &str, scene: &Scene, state: State<'_>) -> Self {
        let exact = Exact::new(scene, Quantity::ForwardDynamics, state).expect("positive pivots");
        let found = forward_error(scene, Method::Filter(Form::SquareRoot), state, &exact).expect("positive pivots");
        // The largest of all changes: the state, and each kind of parameter.
        let inherent = sensitivity(scene, Quantity::ForwardDynamics, state, 3, 0).unwrap();
        let largest = |of: &dyn Fn(usize) -> f64| (0..inherent.len()).map(of).fold(0.0, f64::max);
        let own = |i: usize| tolerance::square_root_component(largest(&|m| inherent[m].1.components[i]));
        let used = |i: usize| found.components[i] / own(i);
        let worst = (0..found.components.len()).max_by(|&a, &b| used(a).total_cmp(&used(b))).unwrap();
        let all = Self {
            norm: found.norm,
            norm_bound: tolerance::square_root(largest(&|m| inherent[m].1.norm)),
            component: found.components[worst],
            component_bound: own(worst),
        };
        if std::env::var_os("PHIPSI_SHOW_RATIOS").is_some() {
            let beyond = if all.holds() { "" } else { "  BEYOND" };
            let (state, parameters) = (inherent[0].1.norm, largest(&|m| if m == 0 { 0.0 } else { inherent[m].1.norm }));
            eprintln!(
                "{what:<28} norm {:.1e} (state {state:.1e}, parameters {parameters:.1e}, bound {:.1e}); \
                 component {:.1e} (bound {:.1e}){beyond}",
                all.norm, all.norm_bound, all.component, all.component_bound
            );
        }
        all
    }

    fn holds(&self) -> bool {
        self.norm <= self.norm_bound && self.component <= self.component_bound
    }
}

#[test]
fn the_square_root_form_is_right_on_every_case_in_both_norms() {
    for case in (0..STATES).flat_map(sweeps).filter(|case| !is_singular(case)) {
        let what = format!("{} {:e}", case.name, case.value);
        let Measured { norm, norm_bound, component, component_bound } = Measured::new(&what, &case.scene, state(&case));
        assert!(norm <= norm_bound, "{what}: off by {norm:e}, bound {norm_bound:e}");
        assert!(component <= component_bound, "{what}: a component is off by {component:e}, bound {component_bound:e}");
    }
}

/// Random trees with all types of joints, masses over 24 decades.
fn log_uniform_tree(seed: u64, bodies: usize) -> Scene {
    let tree = Tree { seed, bodies, kinds: &ALL_KINDS, branching: 0.4, armature: 0.0, floating: false }.builder();
    let mut random = Random::new(seed + 1000);
    let mut builder = SceneBuilder::new().gravity(tree.gravity_vector());
    for link in tree.links() {
        let mut link = link.clone();
        let factor = 10f64.powf(random.uniform(-12.0, 12.0));
        link.inertial = link.inertial.map(|Inertial { mass, center, central }| Inertial {
            mass: mass * factor,
            center,
            central: Symmetric3::new(central.entries.map(|entry| entry * factor)),
        });
        builder = builder.link(link);
    }
    tree.joints().iter().fold(builder, |builder, joint| builder.joint(joint.clone())).build().unwrap()
}

/// In the max-norm, and per component: every tree of the test whose estimate exceeds the tolerance is recomputed.
#[test]
fn the_square_root_form_is_right_on_trees_of_masses_over_24_decades() {
    for (seed, bodies) in (0..).zip([1, 2, 3, 5, 8, 13, 20, 30, 45, 60, 90, 130, 200].repeat(TREES)) {
        let scene = log_uniform_tree(seed, bodies);
        let (q, qd, tau) = random_state(&scene, &mut Random::new(seed));
        let what = format!("tree {seed} of {bodies}");
        let found = Measured::new(&what, &scene, State { q: &q, qd: &qd, u: &tau });
        let Measured { norm, norm_bound, component, component_bound } = found;
        assert!(norm <= norm_bound, "{what}: off by {norm:e}, bound {norm_bound:e}");
        assert!(component <= component_bound, "{what}: a component is off by {component:e}, bound {component_bound:e}");
        let mut workspace = scene.workspace().in_form(phipsi::filter::Form::SquareRoot);
        let mut qdd = vec![f64::NAN; scene.nv()];
        let (model, none) = (scene.model(), &[]);
        let monitor = dynamics::forward_dynamics(model, &mut workspace, &q, &qd, &tau, none, &mut qdd);
        assert!(monitor.clear(0), "{what}: positive pivots");
    }
}

/// The sensitivity of known problems: free fall on a prismatic joint, and a problem that is ill-conditioned by
/// design.
#[test]
fn sensitivity_tells_ill_conditioned_problems_apart() {
    let of = |value: f64| {
        let case = extreme("near-coincident-axes", Some(value), None, 0).unwrap();
        sensitivity(&case.scene, Quantity::ForwardDynamics, state(&case), 3, 0).unwrap()
    };
    let (well, ill) = (of(1.0), of(1e-6));
    let axes = |all: &[(&str, phipsi::report::sensitivity::Difference)]| {
        all.iter().find(|(name, _)| *name == "axes").map(|(_, difference)| difference.norm).unwrap()
    };
    assert!(axes(&well) > 0.0 && axes(&well) < 1e-14);
    assert!(axes(&ill) > 1e-12, "{:e}", axes(&ill));
    assert_eq!(of(1e-6)[5].1, ill[5].1, "the same from the same seed");
    let still = extreme("heavy-tip", None, None, 0).unwrap();
    let all = sensitivity(&still.scene, Quantity::ForwardDynamics, state(&still), 3, 0).unwrap();
    assert_eq!(all[6].1.norm, 0.0, "there is no armature to move");
    assert!(all[..5].iter().all(|(_, difference)| difference.norm > 1e-18 && difference.norm < 1e-14));
}

/// The other forms have a loss of precision that the square-root form does not have, and it is measured and not NaN.
#[test]
fn covariance_and_dense_algebra_lose_digits_where_the_problem_does_not() {
    let case = extreme("heavy-tip", Some(1e9), None, 0).unwrap();
    let exact = Exact::new(&case.scene, Quantity::ForwardDynamics, state(&case)).unwrap();
    let error = |method| forward_error(&case.scene, method, state(&case), &exact).unwrap().norm;
    let root = error(Method::Filter(Form::SquareRoot));
    for method in [Method::Filter(Form::Covariance), Method::DenseLdlt, Method::DenseCholesky] {
        assert!(error(method) > 1e3 * root, "{method:?}: {:e} beside {root:e}", error(method));
    }
}
