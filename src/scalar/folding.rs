//! Algebraic simplification of traced operations: constant folding, removal of zeros and ones, signs moved into sums.

use super::Real;
use super::recording::{Operation as O, Traced, push};

/// The operands of a commutative operation in canonical order.
pub(super) fn sorted(a: Traced, b: Traced) -> (u32, u32) {
    let (a, b) = (a.place(), b.place());
    (a.min(b), a.max(b))
}

/// a + b.
pub(super) fn sum(a: Traced, b: Traced) -> Traced {
    match (a.value(), b.value()) {
        (Some(a), Some(b)) => return Traced::constant(a + b),
        (Some(0.0), _) => return b,
        (_, Some(0.0)) => return a,
        _ => {}
    }
    if let Some(b) = b.negated() {
        return difference(a, b);
    }
    if let Some(a) = a.negated() {
        return difference(b, a);
    }
    let (a, b) = sorted(a, b);
    push(O::Sum(a, b))
}

/// -a.
pub(super) fn negative(a: Traced) -> Traced {
    match (a.value(), a.negated()) {
        (Some(a), _) => Traced::constant(-a),
        (_, Some(a)) => a,
        _ => push(O::Negative(a.place())),
    }
}

/// a - b.
pub(super) fn difference(a: Traced, b: Traced) -> Traced {
    match (a.value(), b.value()) {
        (Some(a), Some(b)) => return Traced::constant(a - b),
        (Some(0.0), _) => return negative(b),
        (_, Some(0.0)) => return a,
        _ if a == b => return Traced::constant(0.0),
        _ => {}
    }
    match b.negated() {
        Some(b) => sum(a, b),
        None => push(O::Difference(a.place(), b.place())),
    }
}

/// a b.
pub(super) fn product(a: Traced, b: Traced) -> Traced {
    match (a.value(), b.value()) {
        (Some(a), Some(b)) => return Traced::constant(a * b),
        (Some(0.0), _) | (_, Some(0.0)) => return Traced::constant(0.0),
        (Some(1.0), _) => return b,
        (_, Some(1.0)) => return a,
        (Some(-1.0), _) => return negative(b),
        (_, Some(-1.0)) => return negative(a),
        _ => {}
    }
    match (a.negated(), b.negated()) {
        (Some(a), Some(b)) => product(a, b),
        (Some(a), None) => negative(product(a, b)),
        (None, Some(b)) => negative(product(a, b)),
        (None, None) => {
            let (a, b) = sorted(a, b);
            push(O::Product(a, b))
        }
    }
}

/// a / b.
pub(super) fn quotient(a: Traced, b: Traced) -> Traced {
    match (a.value(), b.value()) {
        (Some(a), Some(b)) => Traced::constant(a / b),
        (_, Some(1.0)) => a,
        _ => push(O::Quotient(a.place(), b.place())),
    }
}

/// True if a product with `x` needs no multiplication.
fn is_trivial(x: Traced) -> bool {
    x.is(0.0) || x.is(1.0) || x.is(-1.0)
}

/// a b + c.
pub(super) fn product_sum(a: Traced, b: Traced, c: Traced) -> Traced {
    with_product(c, (a, b), false)
}

/// a - b c.
pub(super) fn minus_product(a: Traced, b: Traced, c: Traced) -> Traced {
    with_product(a, (b, c), true)
}

/// c + a b, or with `subtracts` c - a b.
fn with_product(c: Traced, (a, b): (Traced, Traced), subtracts: bool) -> Traced {
    if let (Some(a), Some(b), Some(c)) = (a.value(), b.value(), c.value()) {
        return Traced::constant(if subtracts { Real::minus_product(c, a, b) } else { Real::mul_add(a, b, c) });
    }
    let is_one_factor = is_trivial(a) || is_trivial(b) || (a.value().is_some() && b.value().is_some());
    match (a.negated(), b.negated()) {
        _ if c.is(0.0) && subtracts => negative(product(a, b)),
        _ if c.is(0.0) => product(a, b),
        _ if is_one_factor && subtracts => difference(c, product(a, b)),
        _ if is_one_factor => sum(product(a, b), c),
        (Some(a), Some(b)) => with_product(c, (a, b), subtracts),
        (Some(a), None) => with_product(c, (a, b), !subtracts),
        (None, Some(b)) => with_product(c, (a, b), !subtracts),
        (None, None) => {
            let (a, b) = sorted(a, b);
            push(if subtracts { O::MinusProduct(a, b, c.place()) } else { O::ProductSum(a, b, c.place()) })
        }
    }
}
