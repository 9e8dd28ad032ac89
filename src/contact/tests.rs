#![allow(clippy::float_cmp)] // exact equality is asserted

use super::energy::{expansion_kept, work};
use super::held::Held;
use super::law::nearest;
use super::{Cone, Effort, Limits, SolveReport, impact, passive};
use nalgebra::{DMatrix, DVector, Vector3};

mod blocks;
mod gram;
mod groups;

/// Pseudorandom numbers in [-1, 1].
pub(super) struct Draw(pub u64);

impl Draw {
    #[allow(clippy::cast_precision_loss)] // 53 bits
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 / (1_u64 << 53) as f64) * 2.0 - 1.0
    }

    pub fn matrix(&mut self, rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |_, _| self.next())
    }

    /// A matrix G of at most the given rank, and velocities in its range with all normals closing.
    pub fn problem(&mut self, contacts: usize, rank: usize) -> (DMatrix<f64>, DVector<f64>) {
        let j = self.matrix(3 * contacts, rank);
        let c = &j * self.matrix(rank, 1).column(0);
        (&j * j.transpose(), c)
    }
}

fn in_the_cones(cone: &Cone, p: &DVector<f64>, least: &[f64]) -> bool {
    (0..cone.len()).all(|i| p[3 * i + 2] >= least[i] && p[3 * i].hypot(p[3 * i + 1]) <= cone.friction[i] * p[3 * i + 2])
}

/// Largest violation of the law over all contacts, relative to the largest velocity and impulse.
fn breach(cone: &Cone, p: &DVector<f64>, c: &DVector<f64>) -> f64 {
    let u = cone.velocities(p, c);
    let (fast, strong) = (c.amax(), p.amax().max(f64::MIN_POSITIVE));
    let mut worst: f64 = 0.0;
    for i in 0..cone.len() {
        let (u, p) = (u.fixed_rows::<3>(3 * i), p.fixed_rows::<3>(3 * i));
        let (slip, drag) = (u[0].hypot(u[1]), p[0].hypot(p[1]));
        worst = worst.max(-u[2] / fast).max((u[2] / fast) * (p[2] / strong));
        let room = (cone.friction[i] * p[2] - drag) / strong;
        worst = worst.max(-room).max((slip / fast) * room);
        let against = (slip * drag + u[0] * p[0] + u[1] * p[1]) / fast / strong;
        worst = worst.max(against);
    }
    worst
}

#[test]
fn one_contact_on_a_block_sticks_or_slides() {
    // A point mass of 2 kg: G = 1/2.
    let g = DMatrix::from_diagonal_element(3, 3, 0.5);
    for (mu, slip) in [(0.3, 1.0), (0.5, 2.0), (0.9, 1.0), (0.0, 1.0), (1.2, 3.0)] {
        let cone = Cone::new(g.clone(), vec![mu]);
        let c = DVector::from_vec(vec![slip, 0.0, -1.5]);
        let (p, solved) = cone.impulses(&c, None, &Limits::beside(&c), Effort::default());
        // p_n = 2 * 1.5; friction reduces the slip by at most mu p_n / 2.
        let drag = (mu * 3.0_f64).min(2.0 * slip);
        assert!(solved.converged && solved.residual <= 1e-10, "{solved:?}");
        assert!((p[2] - 3.0).abs() < 1e-9 && (p[0] + drag).abs() < 1e-9 && p[1].abs() < 1e-9, "mu {mu}: {p}");
    }
}

/// The impulses of contacts that stick are those of dense algebra; G with dependent rows has no factor, and rows on
/// which no impulse acts are skipped.
#[test]
fn contacts_that_stick_take_one_solve() {
    let mut draw = Draw(11);
    for contacts in 1..6 {
        let (g, c) = draw.problem(contacts, 3 * contacts + 2);
        let held = Held::of(&Cone::new(g.clone(), vec![1e3; contacts])).expect("independent rows");
        let expected = -g.clone().lu().solve(&c).expect("a regular matrix");
        assert!((held.impulses(&c) - &expected).amax() <= 1e-9 * expected.amax(), "{contacts} contacts");
        let normal = |x: &DVector<f64>| DVector::from_fn(contacts, |i, _| x[3 * i + 2]);
        let block = DMatrix::from_fn(contacts, contacts, |i, j| g[(3 * i + 2, 3 * j + 2)]);
        let expected = -block.lu().solve(&normal(&c)).expect("a regular matrix");
        let found = Held::of(&Cone::new(g, vec![0.0; contacts])).expect("independent rows").impulses(&c);
        assert!((normal(&found) - &expected).amax() <= 1e-9 * expected.amax());
        assert_eq!(found.iter().filter(|p| **p != 0.0).count(), contacts);
        let (g, _) = draw.problem(contacts, 3 * contacts - 1);
        assert!(Held::of(&Cone::new(g, vec![0.5; contacts])).is_none());
    }
}

#[test]
fn contacts_that_part_get_nothing() {
    let cone = Cone::new(DMatrix::identity(6, 6), vec![0.5; 2]);
    let c = DVector::from_vec(vec![1.0, -2.0, 0.0, 3.0, 0.0, 0.1]);
    let (p, solved) = cone.impulses(&c, None, &Limits::beside(&c), Effort::default());
    assert_eq!((p, solved), (DVector::zeros(6), SolveReport::nothing()));
}

#[test]
fn random_problems_meet_the_law_regular_and_redundant() {
    let mut draw = Draw(1);
    let (mut unfinished, mut worst) = (0, 0.0_f64);
    for trial in 0..600 {
        let contacts = 1 + trial % 8;
        let rank = if trial % 2 == 0 { 3 * contacts + 2 } else { 2 + (3 * contacts) / 2 };
        let (g, mut c) = draw.problem(contacts, rank);
        for i in 0..contacts {
            // A positive gap keeps the problem solvable; it need not be in the range of G.
            c[3 * i + 2] += 0.1 * draw.next().abs();
        }
        let friction: Vec<f64> = (0..contacts).map(|_| 0.5 * (draw.next() + 1.0)).collect();
        let cone = Cone::new(g, friction);
        let (p, solved) = cone.impulses(&c, None, &Limits::beside(&c), Effort::default());
        assert!(in_the_cones(&cone, &p, &vec![0.0; contacts]), "trial {trial}");
        unfinished += usize::from(!solved.converged);
        if solved.converged {
            worst = worst.max(breach(&cone, &p, &c));
        }
    }
    assert!(unfinished <= 2, "{unfinished} of 600");
    assert!(worst < 1e-7, "{worst:e}");
}

#[test]
fn redundant_contacts_share_evenly() {
    // Four corners of a square under a body that can only move vertically: J has four equal normal rows.
    let mut j = DMatrix::zeros(12, 1);
    for i in 0..4 {
        j[(3 * i + 2, 0)] = 1.0;
    }
    let cone = Cone::new(&j * j.transpose(), vec![0.5; 4]);
    let c = &j * DVector::from_element(1, -2.0);
    let (p, solved) = cone.impulses(&c, None, &Limits::beside(&c), Effort::default());
    assert!(solved.converged, "{solved:?}");
    for i in 0..4 {
        assert!((p[3 * i + 2] - 0.5).abs() < 1e-8, "{p}");
    }
}

#[test]
fn without_friction_there_are_no_tangential_impulses() {
    let mut draw = Draw(7);
    for _ in 0..50 {
        let (g, c) = draw.problem(4, 14);
        let cone = Cone::new(g, vec![0.0; 4]);
        let (p, solved) = cone.impulses(&c, None, &Limits::beside(&c), Effort::default());
        assert!(solved.converged, "{solved:?}");
        assert!((0..4).all(|i| p[3 * i] == 0.0 && p[3 * i + 1] == 0.0));
    }
}

#[test]
fn a_warm_start_is_quicker_and_gives_the_same() {
    let mut draw = Draw(11);
    let (g, c) = draw.problem(6, 20);
    let cone = Cone::new(g, vec![0.6; 6]);
    let limits = Limits::beside(&c);
    let (cold, first) = cone.impulses(&c, None, &limits, Effort::default());
    let (warm, second) = cone.impulses(&c, Some(&cold), &limits, Effort::default());
    assert!(first.converged && second.converged && second.iterations < first.iterations, "{first:?} {second:?}");
    assert!((cold - warm).amax() < 1e-7);
}

#[test]
fn an_unfinished_solve_says_so_and_stays_in_the_cones_and_below_the_energy() {
    let mut draw = Draw(3);
    let mut unfinished = 0;
    for _ in 0..200 {
        let (g, u) = draw.problem(8, 18);
        let cone = Cone::new(g, vec![0.8; 8]);
        let effort = Effort { attempts: 1, iterations: 1, ..Effort::default() };
        let restitution = [0.5; 8];
        let hit = impact(&cone.clone().into(), &u, &restitution, effort);
        unfinished += usize::from(!hit.solved.converged);
        assert!(hit.solved.converged || hit.solved.residual > 1e-10);
        assert!((0..8).all(
            |i| hit.impulses[3 * i].hypot(hit.impulses[3 * i + 1]) <= 0.8 * hit.impulses[3 * i + 2] * (1.0 + 1e-14)
        ));
        let terms = u.abs().dot(&hit.impulses.abs()) + 1e-300;
        assert!(hit.work <= 1e-14 * terms, "{} {:?}", hit.work, hit.solved);
    }
    assert!(unfinished > 100, "{unfinished}");
}

#[test]
fn impacts_never_raise_the_energy() {
    let mut draw = Draw(5);
    let mut unfinished = 0;
    for trial in 0..1500 {
        let contacts = 1 + trial % 4;
        let (g, u) = draw.problem(contacts, 3 + trial % 4);
        let cone = Cone::new(g, (0..contacts).map(|_| draw.next().abs() * 1.5).collect());
        // Individual coefficients, or all elastic.
        let restitution: Vec<f64> =
            (0..contacts).map(|_| if trial % 3 == 0 { 1.0 } else { draw.next().abs() }).collect();
        let hit = impact(&cone.clone().into(), &u, &restitution, Effort::default());
        let terms = u.abs().dot(&hit.impulses.abs());
        assert!(hit.work <= 1e-14 * terms, "trial {trial}: {}", hit.work);
        assert!((0.0..=1.0).contains(&hit.expansion_kept));
        unfinished += usize::from(!hit.solved.converged);
        if hit.solved.converged {
            let after = cone.velocities(&hit.impulses, &u);
            assert!((0..contacts).all(|i| after[3 * i + 2] >= -1e-8 * u.amax()), "trial {trial}: {after}");
        }
    }
    assert!(unfinished <= 5, "{unfinished}");
}

#[test]
fn one_contact_without_coupling_bounces_by_newtons_law() {
    let cone = Cone::new(DMatrix::from_diagonal_element(3, 3, 0.25), vec![0.0]);
    for e in [0.0, 0.3, 0.8, 1.0] {
        let u = DVector::from_vec(vec![0.5, 0.0, -2.0]);
        let hit = impact(&cone.clone().into(), &u, &[e], Effort::default());
        let after = cone.velocities(&hit.impulses, &u);
        assert!((after[2] - 2.0 * e).abs() < 1e-9, "e {e}: {after}");
    }
}

#[test]
fn the_nearest_point_is_nearest() {
    let mut draw = Draw(9);
    for _ in 0..2000 {
        let x = Vector3::new(draw.next(), draw.next(), draw.next());
        let mu = draw.next().abs() * 1.5;
        let p = nearest(&x, mu, 0.0);
        assert!(p[2] >= 0.0 && p[0].hypot(p[1]) <= mu * p[2]);
        // Moreau's decomposition: x - p is in the polar cone, perpendicular to p.
        let rest = x - p;
        assert!(rest.dot(&p).abs() < 1e-14 && rest[2] + mu * rest[0].hypot(rest[1]) < 1e-14);
    }
}

#[test]
fn an_expansion_that_would_raise_the_energy_is_cut_to_where_it_does_not() {
    // 2 kg at 3 m/s against the ground: 6 N s stop it, 6 more restore its energy, 10 more would increase it.
    let cone = Cone::new(DMatrix::from_diagonal_element(3, 3, 0.5), vec![0.0]);
    let of = |p: f64| DVector::from_vec(vec![0.0, 0.0, p]);
    let u = of(-3.0);
    assert!(expansion_kept(&cone.clone().into(), &u, &of(6.0), &of(6.0)) >= 1.0);
    let kept = expansion_kept(&cone.clone().into(), &u, &of(6.0), &of(10.0));
    assert!((kept - 0.6).abs() < 1e-15, "{kept}");
    assert!(work(&cone.clone().into(), &u, &(of(6.0) + of(10.0) * kept)).abs() < 1e-14);
    // Without compression: up to the impulse that restores the energy.
    assert!((expansion_kept(&cone.clone().into(), &u, &of(0.0), &of(20.0)) - 0.6).abs() < 1e-15);
    let (p, kept) = passive(&cone.clone().into(), &u, of(24.0));
    assert!((kept - 0.5).abs() < 1e-15 && (p[2] - 12.0).abs() < 1e-14);
}

/// J of points on a rigid body with horizontal contact planes.
fn rows(points: &[Vector3<f64>]) -> DMatrix<f64> {
    let mut j = DMatrix::zeros(3 * points.len(), 6);
    for (i, at) in points.iter().enumerate() {
        let turning = [[0.0, at[2], -at[1]], [-at[2], 0.0, at[0]], [at[1], -at[0], 0.0]];
        for (row, turning) in turning.iter().enumerate() {
            j[(3 * i + row, row)] = 1.0;
            for (axis, entry) in turning.iter().enumerate() {
                j[(3 * i + row, 3 + axis)] = *entry;
            }
        }
    }
    j
}

/// The points of a square grid under a box, slightly tilted.
#[allow(clippy::cast_precision_loss)] // a few points
fn grid(side: usize, tilt: f64) -> Vec<Vector3<f64>> {
    let part = |k: usize| k as f64 / (side - 1) as f64 - 0.5;
    (0..side * side)
        .map(|i| Vector3::new(0.4 * part(i % side), 0.3 * part(i / side), -0.1))
        .map(|at| at + Vector3::new(0.0, 0.0, tilt * at[0]))
        .collect()
}

/// Inverse inertia of a box for linear and angular velocities, scaled by mass.
fn inverse_inertia(mass: f64) -> [f64; 6] {
    [1.0, 1.0, 1.0, 46.0, 30.0, 24.0].map(|one| one / mass)
}

/// A box that lands on the points of a grid with different gaps: no motion lets all of them stick.
fn landing(draw: &mut Draw, side: usize, mu: f64) -> (Cone, DVector<f64>) {
    let points = grid(side, 1e-3 * draw.next());
    let j = rows(&points);
    let mut c = &j * draw.matrix(6, 1).column(0);
    for i in 0..points.len() {
        c[3 * i + 2] += 0.02 * draw.next().abs() - 1.0;
    }
    let inverse = DMatrix::from_diagonal(&DVector::from_column_slice(&inverse_inertia(2.0)));
    (Cone::new(&j * inverse * j.transpose(), vec![mu; points.len()]), c)
}

/// Two boxes, one on the other and on the ground, with different masses.
fn stack(draw: &mut Draw, masses: [f64; 2], mu: f64) -> (Cone, DVector<f64>) {
    let (under, on) = (rows(&grid(2, 0.0)), rows(&grid(2, 0.0).iter().map(|at| -at * 0.9).collect::<Vec<_>>()));
    let mut j = DMatrix::zeros(24, 12);
    j.view_mut((0, 0), (12, 6)).copy_from(&under);
    j.view_mut((12, 0), (12, 6)).copy_from(&-on);
    j.view_mut((12, 6), (12, 6)).copy_from(&under);
    let inverse = DVector::from_iterator(12, masses.into_iter().flat_map(inverse_inertia));
    let mut motion = draw.matrix(12, 1);
    (motion[2], motion[8]) = (motion[2] - 0.01, motion[8] - 0.02);
    let mut c = (&j * motion).column(0).into_owned();
    for i in 0..8 {
        c[3 * i + 2] += 1e-3 * draw.next().abs();
    }
    (Cone::new(&j * DMatrix::from_diagonal(&inverse) * j.transpose(), vec![mu; 8]), c)
}

/// Checks that all solves end within a number of factorizations; returns the number of solves that report no
/// convergence.
fn all_end(problems: impl Iterator<Item = (Cone, DVector<f64>)>, most: usize) -> usize {
    let mut unfinished = 0;
    for (trial, (cone, c)) in problems.enumerate() {
        let (p, solved) = cone.impulses(&c, None, &Limits::beside(&c), Effort::default());
        assert!(in_the_cones(&cone, &p, &vec![0.0; cone.len()]), "trial {trial}");
        assert!(
            solved.residual < 1e-6 && solved.iterations < most,
            "trial {trial}, mu {}: {solved:?}",
            cone.friction[0]
        );
        unfinished += usize::from(!solved.converged);
    }
    unfinished
}

const FRICTIONS: [f64; 6] = [0.0, 0.1, 1.0, 3.0, 10.0, 1000.0];

#[test]
fn boxes_land_on_4_to_16_points_with_any_friction() {
    let mut draw = Draw(13);
    for mu in FRICTIONS {
        let unfinished = all_end((0..60).map(|trial| landing(&mut draw, 2 + trial % 3, mu)), 600);
        assert!(unfinished <= 2, "mu {mu}: {unfinished} of 60");
    }
}

#[test]
fn stacks_of_masses_that_differ_by_ten_thousand_with_any_friction() {
    let mut draw = Draw(17);
    for mu in FRICTIONS {
        let of = |trial: usize| if trial.is_multiple_of(2) { [1.0, 1e4] } else { [1e4, 1.0] };
        let unfinished = all_end((0..60).map(|trial| stack(&mut draw, of(trial), mu)), 1500);
        assert!(unfinished <= 2, "mu {mu}: {unfinished} of 60");
    }
}

#[test]
fn random_problems_with_any_friction() {
    let mut draw = Draw(19);
    for (mu, most) in FRICTIONS.into_iter().zip([50, 50, 300, 600, 900, 4000]) {
        let mut problem = |trial: usize| {
            let contacts = 1 + trial % 8;
            let rank = if trial.is_multiple_of(2) { 3 * contacts + 2 } else { 2 + (3 * contacts) / 2 };
            let (g, mut c) = draw.problem(contacts, rank);
            for i in 0..contacts {
                c[3 * i + 2] += 0.1 * draw.next().abs();
            }
            (Cone::new(g, vec![mu; contacts]), c)
        };
        let unfinished = all_end((0..120).map(&mut problem), most);
        assert_eq!(unfinished, 0, "mu {mu}");
    }
}

#[test]
fn friction_beyond_a_thousand_holds_what_a_thousand_holds() {
    let mut draw = Draw(29);
    for mu in [1e4, 1e6] {
        for _ in 0..40 {
            let (cone, c) = landing(&mut draw, 2, mu);
            let (p, solved) = cone.impulses(&c, None, &Limits::beside(&c), Effort::default());
            assert!(solved.residual < 1e-5 && solved.iterations < 8000, "mu {mu}: {solved:?}");
            assert!(in_the_cones(&cone, &p, &[0.0; 4]));
        }
    }
}

#[test]
fn a_friction_that_never_lets_go_is_a_joint() {
    // With all normals closing and no contact separating, impulses stop the points: u = 0.
    let mut draw = Draw(23);
    let mut held = 0;
    for _ in 0..100 {
        let (cone, mut c) = landing(&mut draw, 2, 1000.0);
        for i in 0..4 {
            c[3 * i + 2] = -1.0;
        }
        let (p, solved) = cone.impulses(&c, None, &Limits::beside(&c), Effort::default());
        assert!(solved.residual < 1e-6, "{solved:?}");
        held += usize::from((0..4).all(|i| p[3 * i + 2] > 0.0) && cone.velocities(&p, &c).amax() < 0.1);
    }
    assert!(held > 50, "{held}");
}
