//! Derivatives of the law in its modes, compared with differences of its solutions.

use super::super::tests::Draw;
use super::super::{Cone, Effort, Limits};
use nalgebra::{DMatrix, DVector};

/// Step of the differences, relative to velocities of order one.
const STEP: f64 = 1e-5;

/// A solution to rounding.
fn solution(cone: &Cone, c: &DVector<f64>, limits: &Limits) -> DVector<f64> {
    let (p, solved) = cone.impulses(c, None, limits, Effort::default());
    assert!(solved.converged, "{solved:?}");
    cone.polished(&p, c, limits).map_or(p, |(p, _)| p)
}

/// Central difference of the solution along `dc`, with an error of order four.
fn difference(cone: &Cone, (c, dc): (&DVector<f64>, &DVector<f64>), limits: &Limits) -> DVector<f64> {
    let at = |part: f64| solution(cone, &(c + dc * (part * STEP)), limits);
    ((at(1.0) - at(-1.0)) * 8.0 - (at(2.0) - at(-2.0))) / (12.0 * STEP)
}

#[test]
fn derivatives_in_a_mode_are_those_of_the_solutions() {
    let (mut draw, mut seen, mut worst) = (Draw(41), [0; 3], 0.0_f64);
    for trial in 0..400 {
        let contacts = 1 + trial % 4;
        let redundant = trial % 2 == 1;
        let rank = if redundant { 2 + 3 * contacts / 2 } else { 3 * contacts + 2 };
        let j = draw.matrix(3 * contacts, rank);
        let c = &j * draw.matrix(rank, 1).column(0) * 2.0;
        let dc: DVector<f64> = &j * draw.matrix(rank, 1).column(0);
        let friction = (0..contacts).map(|_| 0.7 * (draw.next() + 1.0)).collect();
        let cone = Cone::new(&j * j.transpose(), friction);
        let mut limits = Limits::beside(&c);
        if trial % 3 == 0 {
            limits.least.iter_mut().for_each(|least| *least = 0.5 * (draw.next() + 1.0));
        }
        let p = solution(&cone, &c, &limits);
        if !(cone.margins(&p, &c, &limits).iter().all(|&margin| margin > 100.0 * STEP)) {
            continue;
        }
        let modes = cone.modes(&p, &c, &limits);
        for mode in &modes {
            seen[mode.normal as usize] += 1;
        }
        let linear = cone.linearized(&modes, &p, &c);
        let dp = linear.tangent(&dc).expect("a regular matrix");
        // Only J* dp is unique if G is singular.
        let (found, expected) = (j.tr_mul(&dp), j.tr_mul(&difference(&cone, (&c, &dc), &limits)));
        let size = expected.amax().max(j.amax() * p.amax()).max(1.0);
        worst = worst.max((&found - &expected).amax() / size);
        // The adjoint of the same equations, for a function of J* p.
        let bar = &j * draw.matrix(rank, 1).column(0);
        let of = linear.cotangents(&bar).expect("a regular matrix");
        let (along, back) = (bar.dot(&dp), of.velocities.dot(&dc));
        assert!((along - back).abs() <= 1e-7 * (1.0 + along.abs()), "trial {trial}: {along} {back}");
    }
    assert!(worst <= 1e-6, "{worst:e}");
    assert!(seen.iter().all(|&count| count > 50), "{seen:?}");
}

#[test]
fn cotangents_of_friction_and_of_the_bound_are_differences() {
    let (mut draw, mut checked) = (Draw(43), [0; 2]);
    for trial in 0..200 {
        let contacts = 1 + trial % 3;
        let (g, c) = draw.problem(contacts, 3 * contacts + 2);
        let cone = Cone::new(g, (0..contacts).map(|_| 0.4 * (draw.next() + 1.1)).collect());
        let mut limits = Limits::beside(&c);
        limits.least.iter_mut().for_each(|least| *least = 0.3 * (draw.next() + 1.0));
        let p = solution(&cone, &c, &limits);
        if !(cone.margins(&p, &c, &limits).iter().all(|&margin| margin > 100.0 * STEP)) {
            continue;
        }
        let bar = draw.matrix(3 * contacts, 1).column(0).into_owned();
        let of = cone.linearized(&cone.modes(&p, &c, &limits), &p, &c).cotangents(&bar).expect("a regular matrix");
        for i in 0..contacts {
            let rubbed = |mu: f64| {
                let mut other = cone.clone();
                other.friction[i] += mu;
                bar.dot(&solution(&other, &c, &limits))
            };
            let pushed = |more: f64| {
                let mut other = limits.clone();
                other.least[i] += more;
                bar.dot(&solution(&cone, &c, &other))
            };
            let slope = |f: &dyn Fn(f64) -> f64| {
                (8.0 * (f(STEP) - f(-STEP)) - (f(2.0 * STEP) - f(-2.0 * STEP))) / (12.0 * STEP)
            };
            let scale = 1.0 + p.amax();
            let (by_friction, by_bound) = (slope(&rubbed), slope(&pushed));
            assert!((of.friction[i] - by_friction).abs() <= 1e-6 * scale.max(by_friction.abs()), "trial {trial}");
            assert!((of.least[i] - by_bound).abs() <= 1e-6 * scale.max(by_bound.abs()), "trial {trial}");
            checked[0] += usize::from(by_friction.abs() > 1e-3);
            checked[1] += usize::from(by_bound.abs() > 1e-3);
        }
    }
    assert!(checked.iter().all(|&count| count > 30), "{checked:?}");
}

#[test]
fn redundant_contacts_keep_sharing_evenly() {
    // Four corners under a body that can only move vertically: each takes a quarter of a change.
    let mut j = DMatrix::zeros(12, 1);
    for i in 0..4 {
        j[(3 * i + 2, 0)] = 1.0;
    }
    let cone = Cone::new(&j * j.transpose(), vec![0.5; 4]);
    let c = &j * DVector::from_element(1, -2.0);
    let limits = Limits::beside(&c);
    let p = solution(&cone, &c, &limits);
    let linear = cone.linearized(&cone.modes(&p, &c, &limits), &p, &c);
    let dp = linear.tangent(&(&j * DVector::from_element(1, -1.0))).expect("a regular matrix");
    for i in 0..4 {
        assert!((dp[3 * i + 2] - 0.25).abs() < 1e-7, "{dp}");
    }
}

#[test]
fn a_polished_solution_has_the_residual_of_rounding() {
    let (mut draw, mut polished) = (Draw(47), 0);
    for trial in 0..200 {
        let contacts = 1 + trial % 4;
        let (g, c) = draw.problem(contacts, 3 * contacts + 2);
        let cone = Cone::new(g, vec![0.6; contacts]);
        let limits = Limits::beside(&c);
        let (p, _) = cone.impulses(&c, None, &limits, Effort { tolerance: 1e-6, ..Effort::default() });
        let Some((better, residual)) = cone.polished(&p, &c, &limits) else { continue };
        polished += 1;
        assert!(residual <= 10.0 * cone.floor(&better, &c, &limits), "trial {trial}: {residual:e}");
    }
    assert!(polished > 180, "{polished}");
}
