//! Extreme and stiff test cases by name, each with one parameter: problems on which algorithms lose precision, and
//! ill-conditioned problems.
//!
//! Most are well-conditioned: the exact accelerations hardly change for small relative changes of the model parameters.
//! `report::sensitivity` (feature `dense`) measures the conditioning of a case.

use super::DESCRIBED;
use super::blueprint::{AXES, Blueprint, LENGTH, row, slab};
use super::draw::Draw;
use crate::error::Error;
use crate::memory;
use crate::scene::{A_LINK, Inertial, JointKind, Scene};
use crate::spatial::Symmetric3;
use nalgebra::Vector3;

/// A named case for one value of its parameter, with one state. It is deterministic.
#[derive(Debug, Clone)]
pub struct Extreme {
    /// Name, one of [`names`].
    pub name: &'static str,
    /// The parameter with its unit.
    pub parameter: &'static str,
    /// Value of the parameter.
    pub value: f64,
    /// Suggested values of the parameter.
    pub values: &'static [f64],
    /// The scene.
    pub scene: Scene,
    /// Configuration, (nq,). All values of the state except quaternions are exactly representable in f32.
    pub q: Vec<f64>,
    /// Joint velocities, (nv,), rad/s or m/s; none is zero.
    pub qd: Vec<f64>,
    /// Torques or forces, (nv,), N m or N; none is zero.
    pub tau: Vec<f64>,
}

/// Definition of a case: the parameter, and the dependence of the scene on it.
struct Kind {
    name: &'static str,
    parameter: &'static str,
    values: &'static [f64],
    usual: f64,
    /// Admissible values.
    allowed: Allowed,
    /// Default number of joints; `None` if the value is the number of joints.
    bodies: Option<usize>,
    /// Smallest number of joints.
    least: usize,
    make: fn(f64, usize, &mut Draw) -> Blueprint,
    /// Sizes of the joint positions, rad (or m), and of the joint velocities, rad/s (or m/s), of the state.
    state: fn(f64) -> (f64, f64),
}

#[derive(Clone, Copy, PartialEq)]
enum Allowed {
    Positive,
    NotNegative,
    Count,
}

/// Sizes of joint positions and velocities of an ordinary state.
fn ordinary(_: f64) -> (f64, f64) {
    (2.0, 1.0)
}

/// Largest number of joints of a case.
const MOST: usize = 100_000;

const LARGE: &[f64] = &[1.0, 1e3, 1e6, 1e9, 1e12, 1e15];
const SMALL: &[f64] = &[1.0, 1e-3, 1e-6, 1e-9, 1e-12, 1e-15];

/// All cases.
#[rustfmt::skip] // a table
const KINDS: [Kind; 18] = [
    Kind { name: "long-chain", parameter: "links", values: &[10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4], usual: 100.0, allowed: Allowed::Count, bodies: None, least: 1, make: long_chain, state: |_| (0.01, 0.1) },
    Kind { name: "heavy-tip", parameter: "mass of the last link, kg", values: LARGE, usual: 1e12, allowed: Allowed::Positive, bodies: Some(8), least: 2, make: heavy_tip, state: ordinary },
    Kind { name: "light-links", parameter: "mass of all links but the last, kg", values: SMALL, usual: 1e-12, allowed: Allowed::Positive, bodies: Some(8), least: 2, make: light_links, state: ordinary },
    Kind { name: "alternating-masses", parameter: "mass of every other link, kg", values: SMALL, usual: 1e-12, allowed: Allowed::Positive, bodies: Some(16), least: 2, make: alternating_masses, state: ordinary },
    Kind { name: "growing-masses", parameter: "mass of a link over that of the one before it", values: &[1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3], usual: 1e3, allowed: Allowed::Positive, bodies: Some(8), least: 2, make: growing_masses, state: ordinary },
    Kind { name: "massless-middle", parameter: "mass of every third link, kg", values: &[1.0, 1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 0.0], usual: 1e-12, allowed: Allowed::NotNegative, bodies: Some(9), least: 3, make: massless_middle, state: ordinary },
    Kind { name: "zero-inertia", parameter: "inertia of the last link about its axis, kg m^2", values: &[1.0, 1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 0.0], usual: 0.0, allowed: Allowed::NotNegative, bodies: Some(6), least: 1, make: zero_inertia, state: ordinary },
    Kind { name: "short-links", parameter: "length of every other link, m", values: SMALL, usual: 1e-6, allowed: Allowed::Positive, bodies: Some(16), least: 2, make: short_links, state: ordinary },
    Kind { name: "near-parallel-axes", parameter: "angle between neighboring axes, rad", values: &[1.0, 1e-2, 1e-4, 1e-6, 1e-8, 1e-12, 0.0], usual: 1e-6, allowed: Allowed::NotNegative, bodies: Some(10), least: 2, make: near_parallel, state: ordinary },
    Kind { name: "near-coincident-axes", parameter: "angle, rad, and distance, m, between two axes with no mass between them", values: &[1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6], usual: 1e-3, allowed: Allowed::Positive, bodies: Some(8), least: 2, make: near_coincident, state: ordinary },
    Kind { name: "needles", parameter: "inertia about the long axis over that across it", values: SMALL, usual: 1e-9, allowed: Allowed::NotNegative, bodies: Some(9), least: 1, make: needles, state: ordinary },
    Kind { name: "prismatic-chain", parameter: "mass of every other link, kg", values: SMALL, usual: 1e-9, allowed: Allowed::Positive, bodies: Some(12), least: 2, make: prismatic, state: ordinary },
    Kind { name: "heavy-leaves", parameter: "mass of the leaves, kg", values: LARGE, usual: 1e9, allowed: Allowed::Positive, bodies: Some(25), least: 3, make: heavy_leaves, state: ordinary },
    Kind { name: "armature", parameter: "armature of every other joint, kg m^2", values: &[0.0, 1e-9, 1e-3, 1.0, 1e3, 1e6, 1e9], usual: 1e6, allowed: Allowed::NotNegative, bodies: Some(12), least: 2, make: armature, state: ordinary },
    Kind { name: "spin", parameter: "rates, rad/s", values: &[1.0, 10.0, 1e2, 1e3, 1e4, 1e5, 1e6], usual: 1e4, allowed: Allowed::NotNegative, bodies: Some(12), least: 1, make: |_, n, _| row(n), state: |value| (2.0, value) },
    Kind { name: "far-base", parameter: "distance of a floating base from the origin, m", values: &[1.0, 1e2, 1e4, 1e6], usual: 1e6, allowed: Allowed::NotNegative, bodies: Some(8), least: 1, make: far_base, state: ordinary },
    Kind { name: "long-lever", parameter: "distance between two joints in the middle, m", values: &[1.0, 1e2, 1e4, 1e6], usual: 1e6, allowed: Allowed::Positive, bodies: Some(8), least: 2, make: long_lever, state: ordinary },
    Kind { name: "log-uniform-masses", parameter: "decades that the masses are drawn from", values: &[0.0, 6.0, 12.0, 18.0, 24.0], usual: 24.0, allowed: Allowed::NotNegative, bodies: Some(30), least: 1, make: log_uniform, state: ordinary },
];

/// The names of the cases.
#[must_use]
pub fn names() -> impl ExactSizeIterator<Item = &'static str> {
    KINDS.iter().map(|kind| kind.name)
}

/// The case named `name`: its scene for the parameter `value` with `bodies` joints, and a state.
///
/// `None` selects the default of the case. `seed` determines the state, and the masses of "log-uniform-masses". The
/// links are `link0`, ... on joints `joint0`, ... in order from the base. For "zero-inertia" with value 0, forward
/// dynamics returns an error for the last joint. O(bodies).
///
/// # Errors
///
/// [`Error::Argument`] for an unknown name, a value outside the domain of the case, and too few or too many bodies;
/// [`Error::NotFinite`] for a value with which the state exceeds the range of f32.
pub fn extreme(name: &str, value: Option<f64>, bodies: Option<usize>, seed: u64) -> Result<Extreme, Error> {
    let kind = KINDS.iter().find(|kind| kind.name == name).ok_or_else(|| {
        let known: Vec<String> = names().map(|name| format!("{name:?}")).collect();
        Error::argument("name", format!("{name:?}"), format!("one of {}", known.join(", ")))
    })?;
    let value = value.unwrap_or(kind.usual);
    kind.allowed.check(kind, value)?;
    let bodies = kind.count(value, bodies)?;
    memory::room("bodies", memory::bytes_of::<[u8; A_LINK + DESCRIBED]>(&[bodies]))?;
    let mut draw = Draw::new(seed);
    let scene = (kind.make)(value, bodies, &mut draw).build()?;
    let (q, qd, tau) = state(&scene, (kind.state)(value), &mut draw, if name == "far-base" { value } else { 0.0 })?;
    for (what, values) in [("q", &q), ("qd", &qd), ("tau", &tau)] {
        scene.check_result(what, values)?;
    }
    Ok(Extreme { name: kind.name, parameter: kind.parameter, value, values: kind.values, scene, q, qd, tau })
}

impl Allowed {
    fn check(self, kind: &Kind, value: f64) -> Result<(), Error> {
        let (fits, expected) = match self {
            Self::Positive => (value > 0.0 && value.is_finite(), "a positive number"),
            Self::NotNegative => (value >= 0.0 && value.is_finite(), "a number that is zero or positive"),
            Self::Count => (value >= 1.0 && value <= to_float(MOST) && value.fract() == 0.0, "from 1 to 100000 links"),
        };
        if fits {
            return Ok(());
        }
        let expected = format!("{expected} ({}: {})", kind.name, kind.parameter);
        Err(Error::argument("value", value.to_string(), expected))
    }
}

impl Kind {
    /// Number of joints.
    fn count(&self, value: f64, asked: Option<usize>) -> Result<usize, Error> {
        let refuse = |found: usize, expected: String| Err(Error::argument("bodies", found.to_string(), expected));
        match (self.bodies, asked) {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // checked: a whole number up to MOST
            (None, None) => Ok(value as usize),
            (None, Some(found)) => refuse(found, format!("none for {:?}: the value is the number of links", self.name)),
            (Some(usual), None) => Ok(usual),
            (Some(_), Some(found)) if !(self.least..=MOST).contains(&found) => {
                refuse(found, format!("from {} to {MOST} for {:?}", self.least, self.name))
            }
            (Some(_), Some(found)) => Ok(found),
        }
    }
}

/// q, qd and tau.
type Numbers = (Vec<f64>, Vec<f64>, Vec<f64>);

/// A state without zeros and repeated values, exactly representable in f32 (except quaternions, which have unit norm).
fn state(scene: &Scene, (angles, rates): (f64, f64), draw: &mut Draw, distance: f64) -> Result<Numbers, Error> {
    let mut numbers = |size: f64| -> Vec<f64> {
        let one = |draw: &mut Draw| size * draw.uniform(0.1, 1.0) * if draw.coin() { 1.0 } else { -1.0 };
        (0..scene.nv()).map(|_| in_single(one(draw))).collect()
    };
    let mut step = numbers(angles);
    let (qd, tau) = (numbers(rates), numbers(5.0));
    if scene.source().is_floating() {
        for (entry, direction) in step.iter_mut().zip([0.6, -0.64, 0.48]) {
            *entry = direction * distance;
        }
    }
    let mut q = scene.neutral();
    scene.integrate(&scene.neutral(), &step, &mut q)?;
    for joint in scene.joints() {
        let quaternion = joint.quaternion();
        for i in joint.q.clone().filter(|i| !quaternion.as_ref().is_some_and(|range| range.contains(i))) {
            q[i] = in_single(q[i]);
        }
    }
    Ok((q, qd, tau))
}

#[allow(clippy::cast_possible_truncation)] // rounding is the purpose
fn in_single(x: f64) -> f64 {
    f64::from(x as f32)
}

#[allow(clippy::cast_precision_loss)] // a count
fn to_float(count: usize) -> f64 {
    count as f64
}

fn long_chain(_: f64, n: usize, _: &mut Draw) -> Blueprint {
    let mut chain = row(n);
    // No axis is along the chain; the links are, and remain nearly so.
    for (k, part) in chain.parts.iter_mut().enumerate() {
        part.axis = if k % 2 == 0 { Vector3::z() } else { Vector3::y() };
    }
    chain
}

fn heavy_tip(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    row(n).masses(|k| if k + 1 == n { value } else { 1.0 })
}

fn light_links(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    row(n).masses(|k| if k + 1 < n { value } else { 1.0 })
}

fn alternating_masses(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    row(n).masses(|k| alternating(k, n, value))
}

/// `value` for every other part except the last: a light tip would have large accelerations that dominate the error.
fn alternating(k: usize, n: usize, value: f64) -> f64 {
    if (n - 1 - k) % 2 == 1 { value } else { 1.0 }
}

fn growing_masses(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    row(n).masses(|k| value.powi(i32::try_from(k).unwrap_or(i32::MAX)))
}

fn massless_middle(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    // Never the last link, because its joint would then move no mass.
    let light = |k: usize| k % 3 == 1 && k + 1 < n;
    let mut chain = row(n).masses(|k| if light(k) { value } else { 1.0 });
    for part in &mut chain.parts {
        part.inertial = part.inertial.filter(|inertial| inertial.mass > 0.0);
    }
    chain
}

fn zero_inertia(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    let mut chain = row(n);
    if let Some(last) = chain.parts.last_mut() {
        // The axis of a rod is its own axis of symmetry.
        last.axis = Vector3::x();
        last.inertial = Some(Inertial {
            mass: 1.0,
            center: Vector3::new(0.5 * LENGTH, 0.0, 0.0),
            central: Symmetric3::new([value, 0.0, 0.0, value + 0.02, 0.0, value + 0.02]),
        });
    }
    chain
}

fn short_links(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    let mut chain = row(n);
    let length = |k: usize| if k % 2 == 1 { value } else { LENGTH };
    for (k, part) in chain.parts.iter_mut().enumerate() {
        part.inertial = Some(slab(1.0, length(k)));
        part.lever[0] = k.checked_sub(1).map_or(0.0, length);
    }
    chain
}

fn near_parallel(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    let mut chain = row(n);
    for (k, part) in chain.parts.iter_mut().enumerate() {
        let (sine, cosine) = value.sin_cos();
        part.axis = [
            Vector3::z(),
            Vector3::new(0.0, sine, cosine),
            Vector3::new(0.6 * sine, 0.8 * sine, cosine),
            Vector3::new(-sine, 0.0, cosine),
        ][k % 4];
    }
    chain
}

fn near_coincident(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    let mut chain = row(n);
    for (k, part) in chain.parts.iter_mut().enumerate() {
        // Pairs of joints; only the second of each pair carries mass.
        if k % 2 == 1 {
            part.axis = Vector3::from(AXES[(k - 1) % 3]) + Vector3::from(AXES[k % 3]) * value;
            part.lever = Vector3::new(0.0, value, 0.0);
        } else if k + 1 < n {
            part.inertial = None;
        }
    }
    chain
}

fn needles(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    let mut chain = row(n);
    for (k, part) in chain.parts.iter_mut().enumerate() {
        // Every third joint rotates about the long axis of its link.
        if k % 3 == 2 {
            part.axis = Vector3::x();
        }
        let across = 0.02;
        part.inertial = Some(Inertial {
            mass: 1.0,
            center: Vector3::new(0.5 * LENGTH, 0.0, 0.0),
            central: Symmetric3::new([value * across, 0.0, 0.0, across, 0.0, across]),
        });
    }
    chain
}

fn prismatic(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    let mut chain = row(n).masses(|k| alternating(k, n, value));
    for part in &mut chain.parts {
        part.kind = JointKind::Prismatic;
    }
    chain
}

fn heavy_leaves(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    // A rotating hub with arms of two links, the outer ones heavy.
    let mut tree = row(n).masses(|k| if k > 0 && k % 2 == 0 { value } else { 1.0 });
    let arms = to_float((n - 1).div_ceil(2));
    for (k, part) in tree.parts.iter_mut().enumerate().skip(1) {
        if k % 2 == 1 {
            let turn = std::f64::consts::TAU * to_float((k - 1) / 2) / arms;
            part.parent = Some(0);
            part.lever = Vector3::new(turn.cos(), turn.sin(), 0.1 * turn) * LENGTH;
        }
    }
    tree
}

fn armature(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    let mut chain = row(n);
    for part in chain.parts.iter_mut().step_by(2) {
        part.armature = value;
    }
    chain
}

fn far_base(_: f64, n: usize, _: &mut Draw) -> Blueprint {
    Blueprint { floating: true, ..row(n) }
}

fn long_lever(value: f64, n: usize, _: &mut Draw) -> Blueprint {
    let mut chain = row(n);
    chain.parts[n / 2].lever = Vector3::new(value, 0.0, 0.0);
    chain
}

fn log_uniform(value: f64, n: usize, draw: &mut Draw) -> Blueprint {
    let masses: Vec<f64> = (0..n).map(|_| 10f64.powf(value * draw.uniform(-0.5, 0.5))).collect();
    row(n).masses(|k| masses[k])
}
