//! Blocks on their corners in small simulations of one rigid body: redundant contacts whose gaps differ by rounding.

use super::{Draw, breach, in_the_cones, inverse_inertia, rows};
use crate::contact::{Cone, Effort, Limits, impact};
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};

/// A homogeneous block in the base frame; its corners are above the plane z = `ground`.
struct Block {
    corners: Vec<Vector3<f64>>,
    mass: f64,
    inertia: Vector3<f64>,
    ground: f64,
    at: Vector3<f64>,
    turned: Rotation3<f64>,
    linear: Vector3<f64>,
    angular: Vector3<f64>,
}

/// Solves of a motion: their number, iterations in total and at most, and those above the tolerance.
#[derive(Debug, Default)]
struct Solves {
    count: usize,
    iterations: usize,
    most: usize,
    unsolved: usize,
}

impl Block {
    fn new(draw: &mut Draw, edges: [f64; 3], mass: f64, corners: usize, (ground, drop): (f64, f64)) -> Self {
        let half = |i: usize, axis: usize| if i >> axis & 1 == 1 { edges[axis] / 2.0 } else { -edges[axis] / 2.0 };
        let [a, b, c] = edges.map(|edge| edge * edge * mass / 12.0);
        let turning = if corners == 4 { 0.1 } else { 1.0 };
        Self {
            corners: (0..corners).map(|i| Vector3::new(half(i, 0), half(i, 1), half(i, 2))).collect(),
            mass,
            inertia: Vector3::new(b + c, a + c, a + b),
            ground,
            at: Vector3::new(0.0, 0.0, ground + edges[2] / 2.0 + drop),
            turned: Rotation3::identity(),
            linear: Vector3::new(draw.next(), draw.next(), 0.5 * draw.next()),
            angular: Vector3::new(turning * draw.next(), turning * draw.next(), draw.next()),
        }
    }

    fn arms(&self) -> Vec<Vector3<f64>> {
        self.corners.iter().map(|corner| self.turned * corner).collect()
    }

    fn gaps(&self) -> Vec<f64> {
        self.arms().iter().map(|arm| arm[2] + self.at[2] - self.ground).collect()
    }

    /// M^-1, in the base frame.
    fn inverse(&self) -> DMatrix<f64> {
        let mut inverse = DMatrix::identity(6, 6) / self.mass;
        let turned = self.turned.matrix();
        let angular = turned * Matrix3::from_diagonal(&self.inertia.map(f64::recip)) * turned.transpose();
        inverse.view_mut((3, 3), (3, 3)).copy_from(&angular);
        inverse
    }

    fn shift(&mut self, by: &DVector<f64>) {
        self.at += by.fixed_rows::<3>(0);
        self.turned = Rotation3::new(by.fixed_rows::<3>(3).into_owned()) * self.turned;
    }

    /// Displaces the block out of the plane, up to 1e-10.
    fn project(&mut self) {
        for _ in 0..5 {
            let gaps = self.gaps();
            let lowest = gaps.iter().copied().fold(0.0, f64::min);
            if lowest > -1e-10 {
                return;
            }
            let near: Vec<usize> = (0..gaps.len()).filter(|&i| gaps[i] < -lowest).collect();
            let j = self.jacobian(&near);
            let c = DVector::from_fn(3 * near.len(), |i, _| if i % 3 == 2 { gaps[near[i / 3]] } else { 0.0 });
            let cone = Cone::new(&j * self.inverse() * j.transpose(), vec![0.0; near.len()]);
            let (p, _) = cone.solve(&c, None, &Limits::beside(&c), Effort { tolerance: 1e-6, ..Effort::default() });
            let by = self.inverse() * j.transpose() * p;
            self.shift(&by);
        }
    }

    fn jacobian(&self, near: &[usize]) -> DMatrix<f64> {
        let arms = self.arms();
        rows(&near.iter().map(|&i| arms[i]).collect::<Vec<_>>())
    }

    /// One step of Moreau's time stepping; checks the impulses.
    fn step(&mut self, h: f64, mu: f64, kept: &mut [f64], solves: &mut Solves) {
        let (inverse, gaps, count) = (self.inverse(), self.gaps(), self.corners.len());
        let turned = self.turned.matrix();
        let spin = turned * Matrix3::from_diagonal(&self.inertia) * turned.transpose() * self.angular;
        let mut free = DVector::zeros(6);
        free.fixed_rows_mut::<3>(0).copy_from(&(self.linear - Vector3::new(0.0, 0.0, 9.81 * h)));
        let bias = inverse.view((3, 3), (3, 3)) * self.angular.cross(&spin);
        free.fixed_rows_mut::<3>(3).copy_from(&(self.angular - bias * h));
        let all: Vec<usize> = (0..count).collect();
        let ends = |velocity: &DVector<f64>| {
            let u = self.jacobian(&all) * velocity;
            gaps.iter().enumerate().map(|(i, gap)| gap.max(0.0) + h * u[3 * i + 2]).collect::<Vec<f64>>()
        };
        let end = ends(&free);
        let mut near: Vec<usize> = (0..count).filter(|&i| gaps[i] <= 0.0 || end[i] <= 0.0).collect();
        let mut after = free.clone();
        while !near.is_empty() {
            let j = self.jacobian(&near);
            let mut c = &j * &free;
            let scale = c.amax();
            for (at, &i) in near.iter().enumerate() {
                c[3 * at + 2] += gaps[i].max(0.0) / h;
            }
            let cone = Cone::new(&j * &inverse * j.transpose(), vec![mu; near.len()]);
            let limits = Limits { scale: scale.max(c.amax()), ..Limits::beside(&c) };
            let warm = DVector::from_fn(c.len(), |i, _| kept[3 * near[i / 3] + i % 3]);
            let (p, solved) = cone.impulses(&c, Some(&warm), &limits, Effort::default());
            solves.count += 1;
            solves.iterations += solved.iterations;
            solves.most = solves.most.max(solved.iterations);
            if solved.residual <= 1e-10 {
                assert!(in_the_cones(&cone, &p, &limits.least));
                assert!(breach(&cone, &p, &c) <= 1e-8, "{:e} {solved:?}", breach(&cone, &p, &c));
            } else {
                solves.unsolved += 1;
            }
            kept.fill(0.0);
            for (i, p) in p.iter().enumerate() {
                kept[3 * near[i / 3] + i % 3] = *p;
            }
            after = &free + &inverse * j.transpose() * p;
            let end = ends(&after);
            let late: Vec<usize> = (0..count).filter(|i| !near.contains(i) && end[*i] < -1e-12).collect();
            if late.is_empty() {
                break;
            }
            near.extend(late);
            near.sort_unstable();
        }
        (self.linear, self.angular) = (after.fixed_rows::<3>(0).into(), after.fixed_rows::<3>(3).into());
        self.shift(&(after * h));
        self.project();
    }
}

/// Blocks at rest, sliding and dropped, whose corners have gaps from 1e-16 to 1e-7 m: few solves need many iterations,
/// and nearly all reach the tolerance.
#[test]
fn blocks_on_four_and_eight_corners_take_few_iterations() {
    let mut draw = Draw(31);
    for edges in [[0.4, 0.3, 0.2], [0.1, 0.1, 0.1], [1.7, 0.9, 0.05]] {
        for (corners, mu, ground, h) in
            [(4, 0.3, 0.0, 1e-2), (8, 0.3, 1e3, 1e-3), (8, 0.8, 1e3, 1e-2), (4, 0.8, 0.0, 1e-3), (8, 5.0, 0.0, 1e-2)]
        {
            let mut solves = Solves::default();
            for trial in 0..6 {
                let drop = if trial > 3 { 0.05 * edges[0] } else { 0.0 };
                let mut block = Block::new(&mut draw, edges, 2.0, corners, (ground, drop));
                let mut kept = vec![0.0; 3 * corners];
                for _ in 0..if h < 5e-3 { 250 } else { 60 } {
                    block.step(h, mu, &mut kept, &mut solves);
                }
                assert!(block.gaps().iter().copied().fold(0.0, f64::min) >= -1e-9);
            }
            let case = format!("{edges:?} {corners} {mu} {ground} {h}: {solves:?}");
            assert!(solves.count > 100 && solves.unsolved == 0, "{case}");
            assert!(solves.iterations <= 8 * solves.count && solves.most <= 500, "{case}");
        }
    }
}

/// The impulses of redundant contacts that stick in an impact are linear in the velocities, up to rounding errors of G
/// over the compliance.
#[test]
fn rebounds_of_redundant_contacts_depend_smoothly_on_velocities() {
    let mut draw = Draw(37);
    for trial in 0..40 {
        let at = [(0.2, 0.15), (-0.2, 0.15), (0.2, -0.15), (-0.2, -0.15)];
        let j = rows(&at.map(|(x, y)| Vector3::new(x, y, -0.1)));
        let inverse = DMatrix::from_diagonal(&DVector::from_column_slice(&inverse_inertia(2.0)));
        let cone = Cone::new(&j * inverse * j.transpose(), vec![3.0; 4]);
        let (mut start, by) = (0.2 * draw.matrix(6, 1), draw.matrix(6, 1));
        start[2] = -1.0;
        let hit = |k: f64| {
            let u = &j * (&start + &by * (1e-3 * k)).column(0);
            impact(&cone.clone().into(), &u, &[0.2, 0.4, 0.6, 0.8], Effort::default()).impulses
        };
        let (before, now, after) = (hit(-1.0), hit(0.0), hit(1.0));
        let bend = (&before - &now * 2.0 + &after).amax();
        assert!(bend <= 5e-9 * now.amax(), "trial {trial}: {:e}", bend / now.amax());
    }
}
