//! Independent groups of contacts, compared with one problem and with each group alone.

use super::{Draw, breach};
use crate::contact::{Cone, Cones, ContactState, Effort, Limits, impact};
use nalgebra::{DMatrix, DVector};

/// The contacts of a group, their problem and its free velocities.
type Alone = (Vec<usize>, Cone, DVector<f64>);

/// Three groups of contacts in mixed order, in one problem and alone.
fn problem(draw: &mut Draw) -> (Cone, DVector<f64>, Vec<Alone>) {
    let groups = [vec![0, 3, 5], vec![1], vec![2, 4]];
    let (mut g, mut c, mut friction) = (DMatrix::zeros(18, 18), DVector::zeros(18), vec![0.0; 6]);
    let mut alone = Vec::new();
    for members in groups {
        let n = members.len();
        let (block, mut own) = draw.problem(n, 3 * n + 2);
        for i in 0..n {
            own[3 * i + 2] = own[3 * i + 2].abs() * -0.5;
        }
        let mu: Vec<f64> = (0..n).map(|_| 0.1 * (draw.next() + 1.0)).collect();
        for (a, &i) in members.iter().enumerate() {
            friction[i] = mu[a];
            c.fixed_rows_mut::<3>(3 * i).copy_from(&own.fixed_rows::<3>(3 * a));
            for (b, &j) in members.iter().enumerate() {
                g.view_mut((3 * i, 3 * j), (3, 3)).copy_from(&block.view((3 * a, 3 * b), (3, 3)));
            }
        }
        alone.push((members, Cone::new(block, mu), own));
    }
    (Cone::new(g, friction), c, alone)
}

#[test]
fn groups_are_solved_as_if_alone() {
    let mut draw = Draw(41);
    for trial in 0..40 {
        let (whole, c, alone) = problem(&mut draw);
        let cones = Cones::split(whole.clone());
        let limits = Limits::beside(&c);
        let (p, solved) = cones.impulses(&c, None, &limits, Effort::default());
        let (mut iterations, mut residual) = (0, 0.0_f64);
        for (members, cone, own) in &alone {
            let of = Limits { scale: limits.scale, ..Limits::beside(own) };
            let (expected, report) = cone.impulses(own, None, &of, Effort::default());
            iterations += report.iterations;
            residual = residual.max(report.residual);
            for (at, &i) in members.iter().enumerate() {
                assert_eq!(p.fixed_rows::<3>(3 * i), expected.fixed_rows::<3>(3 * at), "trial {trial}");
            }
        }
        assert_eq!((solved.iterations, solved.residual), (iterations, residual));
        assert!(solved.converged && breach(&whole, &p, &c) <= 1e-7, "trial {trial}: {solved:?}");
        assert_eq!(whole.residual(&p, &c, &limits), residual);
        assert!((cones.response(&p) - whole.g.times(&p)).amax() <= 1e-13 * whole.g.times(&p).amax());
        assert_eq!(cones.states(&p, &c, &limits), whole.states(&p, &c, &limits));
        assert_eq!(cones.whole(), whole);
        assert_eq!(cones.lengths(), whole.lengths);
    }
}

#[test]
fn impacts_of_groups_are_those_of_one_problem() {
    let mut draw = Draw(43);
    for trial in 0..40 {
        let (whole, u, _) = problem(&mut draw);
        let restitution = [0.3, 0.5, 0.0, 0.2, 0.6, 0.4];
        let one = impact(&whole.clone().into(), &u, &restitution, Effort::default());
        let hit = impact(&Cones::split(whole.clone()), &u, &restitution, Effort::default());
        let (one, now) = (whole.velocities(&one.impulses, &u), whole.velocities(&hit.impulses, &u));
        assert!((one - now).amax() <= 1e-6 * u.amax(), "trial {trial}");
        assert!(hit.solved.converged && hit.work <= 1e-14 * u.abs().dot(&hit.impulses.abs()));
    }
}

/// A block exactly at the friction angle: any impulse at the bound, without slip, sticks.
#[test]
fn a_contact_without_slip_sticks_also_at_the_bound_of_friction() {
    for mu in [0.1, 0.3, 0.7, 1.0, 2.5] {
        for mass in [0.01, 1.0, 700.0] {
            let cone = Cone::new(DMatrix::from_diagonal_element(3, 3, 1.0 / mass), vec![mu]);
            let state = |slope: f64| {
                let c = DVector::from_vec(vec![slope, 0.0, -1.0]) * 0.0981;
                let limits = Limits::beside(&c);
                let (p, solved) = cone.impulses(&c, None, &limits, Effort::default());
                assert!(solved.converged);
                cone.states(&p, &c, &limits)[0]
            };
            assert_eq!(state(mu), ContactState::Sticking);
            assert_eq!(state(mu * (1.0 - 1e-12)), ContactState::Sticking);
            assert_eq!(state(mu * (1.0 + 1e-6)), ContactState::Sliding);
        }
    }
}
