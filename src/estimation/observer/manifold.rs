//! Jacobians of steps on the manifold of a spherical or free joint.

/// Number of terms of the exponential series at most; the remainder is at rounding level for steps up to 25 rad.
const TERMS: u32 = 100;

/// Adjoint of the inverse of a step x, exp(-ad x), and the right Jacobian of the step, sum of (-ad x)^k/(k + 1)!, each
/// row by row with a stride of 6. x is a rotation vector (3), or a twist (linear, angular) (6).
pub(super) fn step_jacobians(x: &[f64]) -> [[f64; 36]; 2] {
    let size = x.len();
    let mut minus = [0.0; 36];
    let mut skew = |row: usize, column: usize, a: &[f64]| {
        for (i, j, entry) in [(0, 1, a[2]), (1, 2, a[0]), (2, 0, a[1])] {
            minus[6 * (row + i) + column + j] = entry;
            minus[6 * (row + j) + column + i] = -entry;
        }
    };
    if size == 3 {
        skew(0, 0, x);
    } else {
        skew(0, 0, &x[3..]);
        skew(3, 3, &x[3..]);
        skew(0, 3, &x[..3]);
    }
    let mut unit = [0.0; 36];
    for i in 0..size {
        unit[7 * i] = 1.0;
    }
    let (mut term, mut adjoint, mut right) = (unit, unit, unit);
    for k in 1..=TERMS {
        let mut next = [0.0; 36];
        let mut largest = 0.0_f64;
        for i in 0..size {
            for j in 0..size {
                let product: f64 = (0..size).map(|m| term[6 * i + m] * minus[6 * m + j]).sum();
                let entry = product / f64::from(k);
                next[6 * i + j] = entry;
                largest = largest.max(entry.abs());
                adjoint[6 * i + j] += entry;
                right[6 * i + j] += entry / f64::from(k + 1);
            }
        }
        term = next;
        if !(largest > 1e-17) {
            break;
        }
    }
    [adjoint, right]
}
