//! Compares the set-valued law with dense algebra.

use super::*;
use crate::scenes::draw::Draw;
use nalgebra::{DMatrix, DVector};

/// Rows with every combination of friction and stops, inside, at and outside of the stops.
fn row(random: &mut Draw, row: usize) -> (SetValued, f64) {
    let friction = if random.uniform(0.0, 1.0) < 0.6 { random.uniform(0.0, 2.0) } else { 0.0 };
    let stops = random.uniform(0.0, 1.0) < 0.6;
    let lower = if random.uniform(0.0, 1.0) < 0.7 { -0.3 } else { f64::NEG_INFINITY };
    let upper = if random.uniform(0.0, 1.0) < 0.7 { 0.2 } else { f64::INFINITY };
    let places = [lower.max(-1.0), upper.min(1.0), -0.31, 0.0, 0.199];
    let q = places.into_iter().find(|_| random.uniform(0.0, 1.0) < 0.3).unwrap_or(0.1);
    (SetValued { row, coordinate: row, friction, stops, lower, upper }, q)
}

/// True if torque and velocity are a point of the graph.
fn holds(graph: &Graph, v: f64, torque: f64, tolerance: f64) -> bool {
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
    let right = DVector::from_fn(moving.len(), |i, _| rest[moving[i]] + graphs[moving[i]].torque(pieces[moving[i]]));
    let own = DMatrix::from_fn(moving.len(), moving.len(), |i, j| m[(moving[i], moving[j])]);
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
    for case in 0..400 {
        let n = 1 + case % 8;
        let root = DMatrix::from_fn(n, n, |i, _| random.uniform(-1.5, 1.5) * if i % 3 == 2 { 1e-4 } else { 1.0 });
        let m = &root * root.transpose() + DMatrix::from_diagonal_element(n, n, 1e-9);
        let u = DVector::from_fn(n, |_, _| 3.0 * random.uniform(-1.5, 1.5));
        let v = DVector::from_fn(n, |i, _| if i % 2 == 0 { random.uniform(-1.5, 1.5) } else { 0.0 });
        let h = 1e-3;
        let rows: Vec<_> = (0..n).map(|i| row(&mut random, i)).collect();
        let graphs: Vec<Graph> = rows.iter().enumerate().map(|(i, (of, q))| Graph::new(of, (*q, v[i]), h)).collect();
        let mut pieces: Vec<Piece> = graphs.iter().enumerate().map(|(i, graph)| graph.piece(v[i])).collect();
        let settled = settle(&mut pieces, |pieces, found| {
            let (next, torque) = dense(&m, &u, (&v, h), &graphs, pieces);
            for (i, &piece) in pieces.iter().enumerate() {
                let value = if matches!(piece, Piece::At(_)) { torque[i] } else { next[i] };
                found.extend(graphs[i].contradicted(piece, value, 1e-9).map(|piece| (i, piece)));
            }
        });
        let (next, torque) = dense(&m, &u, (&v, h), &graphs, &pieces);
        assert!(settled, "case {case}");
        for i in 0..n {
            let tolerance = 1e-7 * (1.0 + u.amax() + torque.amax());
            assert!(
                holds(&graphs[i], next[i], torque[i], tolerance),
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
    let of = SetValued { row: 0, coordinate: 0, friction: 0.0, stops: true, lower: 0.0, upper: 1.0 };
    let graph = Graph::new(&of, (0.0, 0.0), 1e-3);
    let mut pieces = [graph.piece(0.0)];
    let settled = settle(&mut pieces, |pieces, found| {
        // M = -1, u = 1: a free joint moves down, and a stuck joint would need a pulling stop.
        let value = if pieces[0] == Piece::At(0) { -1.0 } else { -1e-3 };
        found.extend(graph.contradicted(pieces[0], value, 1e-12).map(|piece| (0, piece)));
    });
    assert!(!settled && pieces == [Piece::At(0)]);
}

/// Velocities of the vertical pieces increase and torques decrease: the law is monotone.
#[test]
fn graphs_are_monotone() {
    let mut random = Draw::new(3);
    for _ in 0..1000 {
        let ((of, q), v) = (row(&mut random, 0), random.uniform(-1.5, 1.5));
        let graph = Graph::new(&of, (q, v), 1e-3);
        let (velocities, torques) = (&graph.velocities[..graph.count], &graph.torques[..=graph.count]);
        assert!(velocities.windows(2).all(|pair| pair[0] < pair[1]), "{graph:?}");
        assert!(torques.windows(2).all(|pair| pair[0] >= pair[1]), "{graph:?}");
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
