//! Compares the set-valued law with dense algebra.

use super::*;
use crate::scenes::draw::Draw;
use nalgebra::{DMatrix, DVector};

/// A control law, or none: soft and stiff, and with one limit or two.
fn drive(random: &mut Draw) -> Option<Drive> {
    let limit =
        |random: &mut Draw| if random.uniform(0.0, 1.0) < 0.8 { random.uniform(0.0, 2.0) } else { f64::INFINITY };
    (random.uniform(0.0, 1.0) < 0.6).then(|| {
        let (offset, slope) = (10.0 * random.uniform(-1.0, 1.0), 10.0_f64.powf(random.uniform(-3.0, 6.0)));
        let (down, up, stall) = (limit(random), limit(random), random.uniform(0.0, 3.0));
        let decline = if random.uniform(0.0, 1.0) < 0.5 { 10.0_f64.powf(random.uniform(-2.0, 3.0)) } else { 0.0 };
        let stall = if decline > 0.0 { stall } else { f64::INFINITY };
        let line = |torque: f64, slope: f64| Line { torque, slope, is_limit: true };
        let limits = [(-down, -stall), (up, stall)]
            .map(|(effort, stall)| [line(effort, 0.0), line(stall, decline), line(0.0, 0.0)]);
        Drive { offset, slope, limits }
    })
}

/// Rows with every combination of friction and stops, inside, at and outside of the stops.
fn row(random: &mut Draw, row: usize) -> (SetValued, f64) {
    let friction = if random.uniform(0.0, 1.0) < 0.6 { random.uniform(0.0, 2.0) } else { 0.0 };
    let stops = random.uniform(0.0, 1.0) < 0.6;
    let lower = if random.uniform(0.0, 1.0) < 0.7 { -0.3 } else { f64::NEG_INFINITY };
    let upper = if random.uniform(0.0, 1.0) < 0.7 { 0.2 } else { f64::INFINITY };
    let places = [lower.max(-1.0), upper.min(1.0), -0.31, 0.0, 0.199];
    let q = places.into_iter().find(|_| random.uniform(0.0, 1.0) < 0.3).unwrap_or(0.1);
    let friction = [friction, 0.7 * friction];
    (SetValued { row, coordinate: row, friction, stops, lower, upper, drives: false }, q)
}

/// True if torque and velocity are a point of the graph of friction and stops, with the torque of the control law.
fn holds(
    (of, q, drive): &(SetValued, f64, Option<Drive>),
    (start, v, h): (f64, f64, f64),
    (torque, tolerance): (f64, f64),
) -> bool {
    let graph = Graph::new(of, (*q, start), h, None);
    let torque = torque - drive.map_or(0.0, |drive| drive.torque(v));
    (0..=graph.count).any(|k| {
        let below = k == 0 || v >= graph.velocities[k - 1] - tolerance;
        let above = k == graph.count || v <= graph.velocities[k] + tolerance;
        below && above && (torque - graph.torques[k]).abs() <= tolerance
    }) || (0..graph.count).any(|k| {
        let bounds = graph.torques[k + 1] - tolerance..=graph.torques[k] + tolerance;
        (v - graph.velocities[k]).abs() <= tolerance && bounds.contains(&torque)
    })
}

/// v' and torques for given pieces: M (v' - v)/h = u + r, by dense algebra.
fn dense(
    m: &DMatrix<f64>,
    u: &DVector<f64>,
    (v, h): (&DVector<f64>, f64),
    graphs: &[Graph],
    pieces: &[Piece],
) -> (DVector<f64>, DVector<f64>) {
    let n = v.len();
    let moving: Vec<usize> = (0..n).filter(|&i| graphs[i].velocity(pieces[i]).is_none()).collect();
    let mut a = DVector::from_fn(n, |i, _| graphs[i].velocity(pieces[i]).map_or(0.0, |(to, _)| (to - v[i]) / h));
    let rest = u - m * &a;
    let line = |i: usize| graphs[i].line(pieces[i]);
    let right = DVector::from_fn(moving.len(), |k, _| {
        let i = moving[k];
        rest[i] + graphs[i].torque(pieces[i]) + line(i).at(v[i])
    });
    let mut own = DMatrix::from_fn(moving.len(), moving.len(), |i, j| m[(moving[i], moving[j])]);
    for (k, &i) in moving.iter().enumerate() {
        own[(k, k)] += h * line(i).slope;
    }
    let solved = own.cholesky().expect("positive definite").solve(&right);
    for (at, &i) in moving.iter().enumerate() {
        a[i] = solved[at];
    }
    (v + &a * h, m * &a - u)
}

/// All rows are on their graphs at the end, for arbitrary initial pieces and also for inertias that differ by 1e8.
#[test]
fn all_rows_meet_their_law() {
    let mut random = Draw::new(7);
    for case in 0..800 {
        let n = 1 + case % 8;
        let root = DMatrix::from_fn(n, n, |i, _| random.uniform(-1.5, 1.5) * if i % 3 == 2 { 1e-4 } else { 1.0 });
        let m = &root * root.transpose() + DMatrix::from_diagonal_element(n, n, 1e-9);
        let u = DVector::from_fn(n, |_, _| 3.0 * random.uniform(-1.5, 1.5));
        let v = DVector::from_fn(n, |i, _| if i % 2 == 0 { random.uniform(-1.5, 1.5) } else { 0.0 });
        let h = 1e-3;
        let rows: Vec<_> = (0..n)
            .map(|i| {
                let (of, q) = row(&mut random, i);
                (of, q, if case < 400 { None } else { drive(&mut random) })
            })
            .collect();
        let graph =
            |(i, (of, q, drive)): (usize, &(SetValued, f64, Option<Drive>))| Graph::new(of, (*q, v[i]), h, *drive);
        let graphs: Vec<Graph> = rows.iter().enumerate().map(graph).collect();
        let mut pieces: Vec<Piece> = graphs.iter().enumerate().map(|(i, graph)| graph.piece(v[i])).collect();
        let settled = settle(&mut pieces, |pieces, found| {
            let (next, torque) = dense(&m, &u, (&v, h), &graphs, pieces);
            for (i, &piece) in pieces.iter().enumerate() {
                let value = if matches!(piece, Piece::At(_)) { torque[i] } else { next[i] };
                found.extend(graphs[i].contradicted(piece, value, [1e-9; 2]).map(|piece| (i, piece)));
            }
        });
        let (next, torque) = dense(&m, &u, (&v, h), &graphs, &pieces);
        assert!(settled, "case {case}");
        for i in 0..n {
            let tolerance = 1e-7 * (1.0 + u.amax() + torque.amax());
            assert!(
                holds(&rows[i], (v[i], next[i], h), (torque[i], tolerance)),
                "case {case}, row {i}: {} {}",
                next[i],
                torque[i]
            );
        }
    }
}

/// With a negative pivot there is no solution: the joint is treated as stuck, and the caller is informed.
#[test]
fn an_indefinite_matrix_is_reported() {
    let of =
        SetValued { row: 0, coordinate: 0, friction: [0.0; 2], stops: true, lower: 0.0, upper: 1.0, drives: false };
    let graph = Graph::new(&of, (0.0, 0.0), 1e-3, None);
    let mut pieces = [graph.piece(0.0)];
    let settled = settle(&mut pieces, |pieces, found| {
        // M = -1, u = 1: a free joint moves down, and a stuck joint would need a pulling stop.
        let value = if pieces[0] == Piece::At(0) { -1.0 } else { -1e-3 };
        found.extend(graph.contradicted(pieces[0], value, [1e-12; 2]).map(|piece| (0, piece)));
    });
    assert!(!settled && pieces == [Piece::At(0)]);
}

/// Velocities of the vertical pieces increase and torques decrease: the law is monotone.
#[test]
fn graphs_are_monotone() {
    let mut random = Draw::new(3);
    for _ in 0..1000 {
        let ((of, q), v) = (row(&mut random, 0), random.uniform(-1.5, 1.5));
        let graph = Graph::new(&of, (q, v), 1e-3, drive(&mut random));
        let velocities = &graph.velocities[..graph.count];
        assert!(velocities.windows(2).all(|pair| pair[0] < pair[1]), "{graph:?}");
        for (k, v) in velocities.iter().enumerate() {
            let [below, above] = [k, k + 1].map(|k| graph.torques[k] + graph.lines[k].at(*v));
            let rounding = 1e-13 * (1.0 + [k, k + 1].map(|k| graph.lines[k].slope * v.abs()).into_iter().sum::<f64>());
            assert!(below >= above - rounding, "{graph:?}");
            assert!(graph.holds[k].is_some() || (below - above).abs() <= rounding, "{graph:?}");
        }
    }
}

/// A joint outside of a stop accelerates slowly, moves back, and does not pass the stop.
#[test]
fn a_joint_outside_returns_without_a_jump() {
    let (mut outside, mut v, h) = (1.0, 0.0, 1e-3);
    for step in 0..2000 {
        let Bound { velocity, .. } = returning(outside, v, h);
        assert!(velocity - v <= 1.0001 * h * AT_MOST / RETURN, "step {step}");
        outside -= h * velocity;
        v = velocity;
        assert!(outside >= -1e-15);
        if outside <= 0.0 {
            return;
        }
    }
    panic!("still {outside} outside after two seconds");
}
