//! The relaxed law: closed forms of one contact, its definition for several, its limit, and its derivatives.

use super::super::tests::Draw;
use super::super::{Cone, Effort, Limits, Relaxation};
use nalgebra::{DMatrix, DVector, Vector3};

/// J of points of a rigid body of unit mass, with nearly vertical normals: more than two points are redundant.
fn body(draw: &mut Draw, contacts: usize) -> DMatrix<f64> {
    let mut j = DMatrix::zeros(3 * contacts, 6);
    for i in 0..contacts {
        let at = Vector3::new(draw.next(), draw.next(), draw.next());
        let normal = Vector3::new(0.3 * draw.next(), 0.3 * draw.next(), 1.0).normalize();
        let tangent = normal.cross(&Vector3::y()).normalize();
        for (k, axis) in [tangent, normal.cross(&tangent), normal].iter().enumerate() {
            j.row_mut(3 * i + k).columns_mut(0, 3).copy_from(&axis.transpose());
            j.row_mut(3 * i + k).columns_mut(3, 3).copy_from(&(at.cross(axis) * 2.4).transpose());
        }
    }
    j
}

fn solved(cone: &Cone, c: &DVector<f64>, energies: &[Relaxation]) -> DVector<f64> {
    let (p, report) = cone.relaxed(c, None, energies, c.amax());
    assert!(report.converged && report.residual <= 1e-10, "{report:?} for {c}");
    p
}

/// Violation of the law by definition, as velocities relative to the largest one.
fn violation(cone: &Cone, p: &DVector<f64>, c: &DVector<f64>, energies: &[Relaxation]) -> f64 {
    let u = cone.velocities(p, c);
    let of = |i: usize| {
        let (mu, at, of) = (cone.friction[i], 3 * i, energies[i]);
        let normal = (u[at + 2] - of.normal / p[at + 2]).abs();
        if mu == 0.0 {
            return normal;
        }
        let square = (mu * p[at + 2]).powi(2) - p[at].powi(2) - p[at + 1].powi(2);
        assert!(p[at + 2] > 0.0 && square > 0.0);
        let beta = mu * of.tangent / square;
        normal.max((u[at] + beta * p[at]).abs()).max((u[at + 1] + beta * p[at + 1]).abs())
    };
    (0..cone.len()).map(of).fold(0.0, f64::max) / c.amax()
}

#[test]
fn one_contact_without_friction_solves_a_quadratic_equation() {
    let cone = Cone::new(DMatrix::from_diagonal_element(3, 3, 0.5), vec![0.0]);
    for speed in [-1e3, -2.0, -1e-3, 0.0, 1e-3, 2.0, 1e3] {
        for energy in [1e-12, 1e-6, 1e-2, 10.0] {
            let c = DVector::from_vec(vec![0.3, -0.4, speed]);
            let energies = [Relaxation { normal: energy, tangent: energy }];
            let p = solved(&cone, &c, &energies);
            // 0.5 p^2 + c p - e = 0
            let root = (speed * speed + 2.0 * energy).sqrt();
            let expected = if speed > 0.0 { 2.0 * energy / (speed + root) } else { root - speed };
            assert!((p[2] - expected).abs() <= 1e-13 * expected, "{speed} {energy}: {} {expected}", p[2]);
            assert!(p[0] == 0.0 && p[1] == 0.0);
        }
    }
}

#[test]
fn friction_of_one_contact_is_that_of_bisection() {
    let cone = Cone::new(DMatrix::from_diagonal_element(3, 3, 0.5), vec![0.7]);
    for slip in [1e-4, 0.1, 0.9, 1.1, 30.0] {
        for energy in [1e-9, 1e-5, 1e-2] {
            let c = DVector::from_vec(vec![0.6 * slip, 0.8 * slip, -1.0]);
            let energies = [Relaxation { normal: energy, tangent: 3.0 * energy }];
            let p = solved(&cone, &c, &energies);
            let q = 0.7 * p[2];
            // slip = t/2 + mu k t / (q^2 - t^2)
            let (mut low, mut high) = (0.0, q);
            for _ in 0..200 {
                let t = 0.5 * (low + high);
                let found = 0.5 * t + 0.7 * 3.0 * energy * t / ((q - t) * (q + t));
                if found < slip { low = t } else { high = t }
            }
            assert!((p[0] + 0.6 * low).abs() <= 1e-12 * q && (p[1] + 0.8 * low).abs() <= 1e-12 * q, "{slip} {energy}");
        }
    }
}

/// Random contacts, redundant and independent, with small and large energies: the law holds, from any start with the
/// same impulses.
#[test]
fn several_contacts_satisfy_the_law_and_have_one_solution() {
    let (mut draw, mut steps, mut count) = (Draw(17), 0, 0);
    for trial in 0..600 {
        let contacts = 1 + trial % 8;
        let j = if trial % 2 == 0 { draw.matrix(3 * contacts, 3 * contacts + 2) } else { body(&mut draw, contacts) };
        let mut c = &j * draw.matrix(j.ncols(), 1).column(0);
        // Some contacts are far away.
        for i in 0..contacts {
            let far = draw.next();
            c[3 * i + 2] += if far > 0.5 { 10_f64.powf(4.0 * far - 2.0) } else { 0.0 };
        }
        let most = [0.0, 0.3, 0.8][trial % 3];
        let cone = Cone::new(&j * j.transpose(), (0..contacts).map(|_| most * 0.5 * (draw.next() + 1.0)).collect());
        let energies: Vec<_> = (0..contacts)
            .map(|_| {
                let normal = 10_f64.powf(3.0 * draw.next() - 4.0);
                Relaxation { normal, tangent: normal * 10_f64.powf(draw.next()) }
            })
            .collect();
        let (p, report) = cone.relaxed(&c, None, &energies, c.amax());
        (steps, count) = (steps + report.iterations, count + 1);
        assert!(report.converged, "trial {trial}: {report:?}");
        // The distance from the cone cancels in the definition.
        assert!(violation(&cone, &p, &c, &energies) <= 1e-8, "trial {trial}: {}", violation(&cone, &p, &c, &energies));
        let start =
            DVector::from_fn(3 * contacts, |i, _| if i % 3 == 2 { 10_f64.powf(3.0 * draw.next()) } else { 0.0 });
        let (other, report) = cone.relaxed(&c, Some(&start), &energies, c.amax());
        assert!(report.converged, "trial {trial}: {report:?}");
        assert!((&p - &other).amax() <= 1e-6 * p.amax(), "trial {trial}: {p} {other}");
    }
    assert!(steps <= 25 * count, "{steps} steps of {count} solves");
}

#[test]
fn small_energies_give_the_exact_law() {
    let mut draw = Draw(19);
    for trial in 0..60 {
        let contacts = 1 + trial % 4;
        let (g, c) = draw.problem(contacts, 3 * contacts + 2);
        let cone = Cone::new(g, (0..contacts).map(|_| 0.3 * (draw.next() + 1.0)).collect());
        let limits = Limits::beside(&c);
        let (exact, _) = cone.impulses(&c, None, &limits, Effort::default());
        let mut before = f64::INFINITY;
        for part in [1e-4, 1e-6, 1e-8, 1e-10] {
            let energies = vec![Relaxation { normal: part, tangent: part }; contacts];
            let p = solved(&cone, &c, &energies);
            let residual = cone.residual(&p, &c, &limits);
            assert!(residual < before, "trial {trial}: {residual} after {before}");
            before = residual;
            if part < 1e-9 {
                assert!((&p - &exact).amax() <= 1e-3 * exact.amax().max(1.0), "trial {trial}: {p} {exact}");
            }
        }
        assert!(before <= 1e-4, "trial {trial}: {before}");
    }
}

#[test]
fn derivatives_are_those_of_the_solutions() {
    const STEP: f64 = 1e-4;
    let mut draw = Draw(23);
    for trial in 0..80 {
        let contacts = 1 + trial % 4;
        let j = if trial % 2 == 0 { draw.matrix(3 * contacts, 3 * contacts + 2) } else { body(&mut draw, contacts) };
        let c = &j * draw.matrix(j.ncols(), 1).column(0);
        let cone = Cone::new(
            &j * j.transpose(),
            (0..contacts).map(|i| if i == 3 { 0.0 } else { 0.2 * (draw.next() + 1.5) }).collect(),
        );
        let energy = [1e-1, 1e-2][trial / 2 % 2];
        let energies = vec![Relaxation { normal: energy, tangent: 2.0 * energy }; contacts];
        let p = solved(&cone, &c, &energies);
        let bar = draw.matrix(3 * contacts, 1).column(0).into_owned();
        let of = cone.linearized_relaxed(&p, &c, &energies).cotangents(&bar).expect("a regular matrix");
        let slope = |f: &dyn Fn(f64) -> DVector<f64>| {
            let g = |x: f64| bar.dot(&f(x));
            (8.0 * (g(STEP) - g(-STEP)) - (g(2.0 * STEP) - g(-2.0 * STEP))) / (12.0 * STEP)
        };
        let check = |name: &str, found: f64, f: &dyn Fn(f64) -> DVector<f64>| {
            let expected = slope(f);
            assert!((found - expected).abs() <= 1e-6 * (1.0 + expected.abs()), "{trial} {name}: {found} {expected}");
        };
        let dc = draw.matrix(3 * contacts, 1).column(0).into_owned();
        check("velocities", of.velocities.dot(&dc), &|x| solved(&cone, &(&c + &dc * x), &energies));
        for i in 0..contacts {
            if cone.friction[i] > 0.0 {
                check("friction", of.friction[i], &|x| {
                    let mut other = cone.clone();
                    other.friction[i] += x;
                    solved(&other, &c, &energies)
                });
            }
            check("energy", of.energy[i], &|x| {
                let mut other = energies.clone();
                other[i].normal *= 1.0 + x;
                other[i].tangent *= 1.0 + x;
                solved(&cone, &c, &other)
            });
        }
    }
}
