//! Each operator and its transpose as one sweep over the rows.

use super::{Factor, Kind};
use crate::scalar::Real;
use crate::spatial::{Symmetric6, dot};
use nalgebra::Vector6;

/// One row of the system as a separate node: its hinge map, and the next node inward.
#[derive(Clone, Copy)]
struct Node {
    body: usize,
    /// The next row inward, and whether there is a rigid shift in between.
    inward: Option<(usize, bool)>,
    /// True if the body's inertia enters here.
    outermost: bool,
}

/// All rows, base to tip.
fn nodes<T: Real>(factor: &Factor<T>) -> impl DoubleEndedIterator<Item = (usize, Node)> + '_ {
    let stages = &factor.system.stages;
    stages.iter().enumerate().flat_map(move |(body, stage)| {
        (0..stage.rows.count()).map(move |i| {
            let inward = match (i, stage.parent) {
                (0, None) => None,
                (0, Some(parent)) => Some((stages[parent].first_row + stages[parent].rows.count() - 1, true)),
                _ => Some((stage.first_row + i - 1, false)),
            };
            let outermost = i + 1 == stage.rows.count();
            (stage.first_row + i, Node { body, inward, outermost })
        })
    })
}

/// The block of a stacked vector.
fn block<T: Real>(x: &[T], row: usize) -> Vector6<T> {
    Vector6::from_column_slice(&x[6 * row..6 * row + 6])
}

fn put<T: Real>(y: &mut [T], row: usize, value: &Vector6<T>) {
    y[6 * row..6 * row + 6].copy_from_slice(value.as_slice());
}

fn add<T: Real>(y: &mut [T], row: usize, value: &Vector6<T>) {
    let sum = block(y, row) + value;
    put(y, row, &sum);
}

/// y = A x.
pub(super) fn apply<T: Real>(factor: &Factor<T>, kind: Kind, x: &[T], y: &mut [T]) {
    let zero = T::zero();
    match kind {
        Kind::Phi => {
            y.copy_from_slice(x);
            inward(factor, y, |_, z| z);
        }
        Kind::Shifts => {
            y.fill(zero);
            inward(factor, y, |row, _| block(x, row));
        }
        Kind::PhiStrict => {
            y.fill(zero);
            inward(factor, y, |row, z| z + block(x, row));
        }
        Kind::Psi => {
            y.fill(zero);
            // z^-(k) = E (x + A z^-): the state at the inboard side is x plus the state after the measurement.
            inward(factor, y, |row, z| block(x, row) + pass(factor, row, &z));
        }
        Kind::PsiA => {
            y.fill(zero);
            inward(factor, y, |row, z| pass(factor, row, &(block(x, row) + z)));
        }
        Kind::APsi => {
            apply(factor, Kind::Psi, x, y);
            each_block(y, |row, z| pass(factor, row, &z));
        }
        Kind::ClosedLoop => {
            y.copy_from_slice(x);
            each_block(y, |row, z| pass(factor, row, &z));
        }
        Kind::H => {
            for (row, hinge) in factor.hinges.iter().enumerate() {
                y[row] = hinge.project(&block(x, row));
            }
        }
        Kind::Gain => {
            for (row, m) in factor.measured.iter().enumerate() {
                put(y, row, &(m.gain * x[row]));
            }
        }
        Kind::BatchGain => {
            let mut estimate = vec![zero; x.len()];
            factor.solve(x, &mut estimate);
            let mut spread = vec![zero; y.len()];
            apply_transpose(factor, Kind::H, &estimate, &mut spread);
            apply(factor, Kind::R, &spread, y);
        }
        Kind::K => compose(factor, [Kind::H, Kind::PhiStrict, Kind::Gain], x, y, apply),
        Kind::L => compose(factor, [Kind::H, Kind::Psi, Kind::Gain], x, y, apply),
        Kind::Mass => {
            let (nv, mut wide, mut state) = (factor.nv(), vec![zero; 6 * factor.nv()], vec![zero; 6 * factor.nv()]);
            apply_transpose(factor, Kind::H, x, &mut wide);
            apply(factor, Kind::R, &wide, &mut state);
            apply(factor, Kind::H, &state, y);
            for row in 0..nv {
                y[row] += factor.system.noise[row] * x[row];
            }
        }
        symmetric => apply_symmetric(factor, symmetric, x, y),
    }
}

/// y = A^T x.
pub(super) fn apply_transpose<T: Real>(factor: &Factor<T>, kind: Kind, x: &[T], y: &mut [T]) {
    let zero = T::zero();
    match kind {
        Kind::Phi => {
            y.copy_from_slice(x);
            outward(factor, y, |_, own, carried| own + carried);
        }
        Kind::Shifts => {
            let mut whole = x.to_vec();
            outward(factor, &mut whole, |row, own, carried| {
                put(y, row, &carried);
                own
            });
        }
        Kind::PhiStrict => {
            // phi^T x; each row keeps the part from further in.
            let mut whole = x.to_vec();
            outward(factor, &mut whole, |row, own, carried| {
                put(y, row, &carried);
                own + carried
            });
        }
        Kind::Psi => {
            // Outboard of a row: x plus A^T times the vector at its inboard side, which is the result.
            let mut whole = x.to_vec();
            outward(factor, &mut whole, |row, own, carried| {
                put(y, row, &carried);
                own + pass_transpose(factor, row, &carried)
            });
        }
        Kind::PsiA => {
            apply_transpose(factor, Kind::Psi, x, y);
            each_block(y, |row, v| pass_transpose(factor, row, &v));
        }
        Kind::APsi => {
            let mut passed = x.to_vec();
            each_block(&mut passed, |row, v| pass_transpose(factor, row, &v));
            apply_transpose(factor, Kind::Psi, &passed, y);
        }
        Kind::ClosedLoop => {
            y.copy_from_slice(x);
            each_block(y, |row, v| pass_transpose(factor, row, &v));
        }
        Kind::H => {
            for (row, hinge) in factor.hinges.iter().enumerate() {
                put(y, row, &hinge.spread_onto(&Vector6::from_element(zero), x[row]));
            }
        }
        Kind::Gain => {
            for (row, m) in factor.measured.iter().enumerate() {
                y[row] = dot(&m.gain, &block(x, row));
            }
        }
        Kind::BatchGain => {
            let mut forces = vec![zero; x.len()];
            apply(factor, Kind::R, x, &mut forces);
            let mut measured = vec![zero; y.len()];
            apply(factor, Kind::H, &forces, &mut measured);
            factor.solve(&measured, y);
        }
        Kind::K => compose(factor, [Kind::Gain, Kind::PhiStrict, Kind::H], x, y, apply_transpose),
        Kind::L => compose(factor, [Kind::Gain, Kind::Psi, Kind::H], x, y, apply_transpose),
        symmetric => apply(factor, symmetric, x, y),
    }
}

/// y = A x for block diagonal and other symmetric operators.
fn apply_symmetric<T: Real>(factor: &Factor<T>, kind: Kind, x: &[T], y: &mut [T]) {
    match kind {
        Kind::Q => {
            y.fill(T::zero());
            for (row, node) in nodes(factor).filter(|(_, node)| node.outermost) {
                put(y, row, &factor.inertia[node.body].mul_motion(&block(x, row)));
            }
        }
        Kind::R => {
            let mut co_states = vec![T::zero(); x.len()];
            apply_transpose(factor, Kind::Phi, x, &mut co_states);
            let mut forces = vec![T::zero(); x.len()];
            apply_symmetric(factor, Kind::Q, &co_states, &mut forces);
            apply(factor, Kind::Phi, &forces, y);
        }
        Kind::P => diagonal_blocks(&factor.force_covariances().minus, x, y),
        Kind::PFiltered => diagonal_blocks(&factor.force_covariances().plus, x, y),
        Kind::Lambda => diagonal_blocks(&factor.co_state_covariances().minus, x, y),
        Kind::LambdaPlus => diagonal_blocks(&factor.co_state_covariances().plus, x, y),
        Kind::S => {
            // With u = P x and v = Psi u: S x = u - v + P Psi* (H* D^-1 H v - x).
            let mut u = vec![T::zero(); x.len()];
            diagonal_blocks(&factor.force_covariances().minus, x, &mut u);
            let mut v = u.clone();
            apply(factor, Kind::Psi, &u, &mut v);
            let mut w: Vec<T> = x.iter().map(|&x| -x).collect();
            for (row, (hinge, m)) in factor.hinges.iter().zip(&factor.measured).enumerate() {
                let scaled = hinge.project(&block(&v, row)) * m.pivot_inverse;
                let spread = hinge.spread_onto(&block(&w, row), scaled);
                put(&mut w, row, &spread);
            }
            let mut co_states = vec![T::zero(); x.len()];
            apply_transpose(factor, Kind::Psi, &w, &mut co_states);
            diagonal_blocks(&factor.force_covariances().minus, &co_states, y);
            for ((y, u), v) in y.iter_mut().zip(u).zip(v) {
                *y += u - v;
            }
        }
        Kind::D => {
            for (row, pivot) in factor.pivots().enumerate() {
                y[row] = pivot * x[row];
            }
        }
        _ => factor.solve(x, y),
    }
}

/// The product of three operators, applied from the last to the first.
fn compose<T: Real>(
    factor: &Factor<T>,
    kinds: [Kind; 3],
    x: &[T],
    y: &mut [T],
    one: fn(&Factor<T>, Kind, &[T], &mut [T]),
) {
    let mut first = vec![T::zero(); 6 * factor.nv()];
    let mut second = first.clone();
    one(factor, kinds[2], x, &mut first);
    one(factor, kinds[1], &first, &mut second);
    one(factor, kinds[0], &second, y);
}

fn diagonal_blocks<T: Real>(blocks: &[Symmetric6<T>], x: &[T], y: &mut [T]) {
    for (row, p) in blocks.iter().enumerate() {
        put(y, row, &p.mul_vector(&block(x, row)));
    }
}

/// Replaces every block by a function of it.
fn each_block<T: Real>(y: &mut [T], of: impl Fn(usize, Vector6<T>) -> Vector6<T>) {
    for row in 0..y.len() / 6 {
        let value = of(row, block(y, row));
        put(y, row, &value);
    }
}

/// Tip to base: y(inward) += phi send(row, y(row)).
fn inward<T: Real>(factor: &Factor<T>, y: &mut [T], send: impl Fn(usize, Vector6<T>) -> Vector6<T>) {
    for (row, node) in nodes(factor).rev() {
        if let Some((next, shifted)) = node.inward {
            let sent = send(row, block(y, row));
            add(y, next, &if shifted { factor.shift[node.body].force_to_parent(&sent) } else { sent });
        }
    }
}

/// Base to tip: y(row) = take(row, y(row), phi^T y(inward)).
fn outward<T: Real>(
    factor: &Factor<T>,
    y: &mut [T],
    mut take: impl FnMut(usize, Vector6<T>, Vector6<T>) -> Vector6<T>,
) {
    for (row, node) in nodes(factor) {
        let carried = match node.inward {
            Some((next, true)) => factor.shift[node.body].motion_to_child(&block(y, next)),
            Some((next, false)) => block(y, next),
            None => Vector6::from_element(T::zero()),
        };
        let taken = take(row, block(y, row), carried);
        put(y, row, &taken);
    }
}

/// A x = x - g H x.
fn pass<T: Real>(factor: &Factor<T>, row: usize, x: &Vector6<T>) -> Vector6<T> {
    x - factor.measured[row].gain * factor.hinges[row].project(x)
}

/// A^T x = x - H^T g^T x.
fn pass_transpose<T: Real>(factor: &Factor<T>, row: usize, x: &Vector6<T>) -> Vector6<T> {
    factor.hinges[row].spread_onto(x, -dot(&factor.measured[row].gain, x))
}
