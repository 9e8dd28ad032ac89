//! G = J M^-1 J* of coupled contacts: a matrix, or the product W* W of sparse rows if many contacts act on few joints.
//!
//! Newton's method needs (A + B (G + eps))^-1 with 3 x 3 blocks A and B of each contact. With C = A + eps B and G = W*
//! W it is
//!
//! ```text
//! p = C^-1 (f - B W* y),     (1 + W C^-1 B W*) y = W C^-1 f
//! ```
//!
//! a system of the size of the joints instead of the contacts: a wall of bricks has four or more rows of contacts for
//! each degree of freedom. Joints that have no contact in common are not coupled in it, and with neighbors next to each
//! other it is a band.

use super::band::{Band, narrow};
use nalgebra::{DMatrix, DVector, Dyn, LU, Matrix3, Vector3};
use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::Arc;

/// Rows are kept apart from at least this number on, and if they are more than the joints by this factor.
const MANY: usize = 60;
const MORE: f64 = 1.5;

/// The joints that the impulse of each contact moves, numbered so that joints with a common contact are near each
/// other.
#[derive(Debug, PartialEq)]
pub(crate) struct RowPattern {
    pub contacts: Vec<Vec<usize>>,
    joints: usize,
    /// Distance from the diagonal of the entries that couple joints.
    band: usize,
}

/// W of all contacts.
#[derive(Debug, PartialEq)]
pub(crate) struct WideRows {
    pattern: Arc<RowPattern>,
    /// The entries of the three rows of each contact, for each of its joints.
    entries: Vec<Vec<Vector3<f64>>>,
}

/// W of one contact.
#[derive(Debug, Clone, Copy)]
struct ContactRows<'a> {
    joints: &'a [usize],
    entries: &'a [Vector3<f64>],
}

/// The matrix G of some contacts.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Gram {
    /// G.
    Dense(DMatrix<f64>),
    /// scale (W* W + compliance) scale.
    Rows { rows: Arc<WideRows>, scale: Option<DVector<f64>>, compliance: f64 },
}

impl RowPattern {
    /// The pattern of contacts that move the given joints; `None` if their G is better kept as a matrix.
    pub fn of_many(mut contacts: Vec<Vec<usize>>) -> Option<Self> {
        if 3 * contacts.len() < MANY {
            return None;
        }
        let mut number = HashMap::new();
        for joint in contacts.iter_mut().flatten() {
            let next = number.len();
            *joint = *number.entry(*joint).or_insert(next);
        }
        let joints = number.len();
        #[allow(clippy::cast_precision_loss)] // counts
        let is_many = 3.0 * contacts.len() as f64 > MORE * joints as f64;
        if !is_many {
            return None;
        }
        let (order, band) = narrow(contacts.iter().map(|of| &of[..]), joints);
        contacts.iter_mut().flatten().for_each(|joint| *joint = order[*joint]);
        Some(Self { contacts, joints, band })
    }
}

impl WideRows {
    fn each(&self) -> impl Iterator<Item = ContactRows<'_>> {
        let of = |(joints, entries)| ContactRows { joints, entries };
        self.pattern.contacts.iter().map(|of| &of[..]).zip(self.entries.iter().map(|of| &of[..])).map(of)
    }

    /// W x.
    fn along_joints(&self, x: impl Fn(usize) -> Vector3<f64>) -> DVector<f64> {
        let mut y = DVector::zeros(self.pattern.joints);
        for (i, of) in self.each().enumerate() {
            let x = x(i);
            for (joint, entries) in of.each() {
                y[joint] += entries.dot(&x);
            }
        }
        y
    }
}

impl<'a> ContactRows<'a> {
    fn each(self) -> impl Iterator<Item = (usize, &'a Vector3<f64>)> {
        self.joints.iter().copied().zip(self.entries)
    }

    /// Its rows of W* y.
    fn times(self, y: &DVector<f64>) -> Vector3<f64> {
        self.each().fold(Vector3::zeros(), |sum, (joint, of)| sum + of * y[joint])
    }
}

/// The scale of the rows of a contact.
fn scale_of(scale: Option<&DVector<f64>>, i: usize) -> f64 {
    scale.map_or(1.0, |scale| scale[3 * i])
}

fn three(x: &DVector<f64>, i: usize) -> Vector3<f64> {
    x.fixed_rows::<3>(3 * i).into_owned()
}

impl From<DMatrix<f64>> for Gram {
    fn from(g: DMatrix<f64>) -> Self {
        Self::Dense(g)
    }
}

impl Gram {
    /// G = W* W, from the entries of the three rows of each contact for each of its joints.
    pub fn of_rows(pattern: &Arc<RowPattern>, entries: Vec<Vec<Vector3<f64>>>) -> Self {
        let rows = Arc::new(WideRows { pattern: Arc::clone(pattern), entries });
        Self::Rows { rows, scale: None, compliance: 0.0 }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        match self {
            Self::Dense(g) => g.nrows(),
            Self::Rows { rows, .. } => 3 * rows.entries.len(),
        }
    }

    /// G p.
    pub fn times(&self, p: &DVector<f64>) -> DVector<f64> {
        let (rows, scale, compliance) = match self {
            Self::Dense(g) => return g * p,
            Self::Rows { rows, scale, compliance } => (rows, scale.as_ref(), *compliance),
        };
        let scaled = scale.map_or(Cow::Borrowed(p), |scale| Cow::Owned(p.component_mul(scale)));
        let y = rows.along_joints(|i| three(&scaled, i));
        let mut product = DVector::zeros(p.len());
        for (i, of) in rows.each().enumerate() {
            product.fixed_rows_mut::<3>(3 * i).copy_from(&of.times(&y));
        }
        product.axpy(compliance, &scaled, 1.0);
        if let Some(scale) = scale {
            product.component_mul_assign(scale);
        }
        product
    }

    /// Adds the sums of the absolute values of the terms of G p.
    pub fn add_sizes(&self, p: &DVector<f64>, terms: &mut DVector<f64>) {
        match self {
            Self::Dense(g) => {
                for (column, p) in g.column_iter().zip(p) {
                    for (term, g) in terms.iter_mut().zip(&column) {
                        *term += (g * p).abs();
                    }
                }
            }
            Self::Rows { rows, scale, compliance } => {
                let scale = |i: usize| scale_of(scale.as_ref(), i);
                let mut sizes = DVector::<f64>::zeros(rows.pattern.joints);
                for (i, of) in rows.each().enumerate() {
                    let p = (three(p, i) * scale(i)).abs();
                    for (joint, entries) in of.each() {
                        sizes[joint] += entries.abs().dot(&p);
                    }
                }
                for (i, of) in rows.each().enumerate() {
                    let sum = of.each().fold(Vector3::zeros(), |sum, (joint, of)| sum + of.abs() * sizes[joint]);
                    let own = (sum + (three(p, i) * scale(i)).abs() * *compliance) * scale(i);
                    terms.fixed_rows_mut::<3>(3 * i).zip_apply(&own, |term, own| *term += own);
                }
            }
        }
    }

    /// The diagonal entries of a contact.
    pub fn diagonal(&self, i: usize) -> Vector3<f64> {
        match self {
            Self::Dense(g) => Vector3::from_fn(|row, _| g[(3 * i + row, 3 * i + row)]),
            Self::Rows { rows, scale, compliance } => {
                let own = &rows.entries[i];
                let squares = own.iter().fold(Vector3::zeros(), |sum, of| sum + of.component_mul(of));
                let scale = scale_of(scale.as_ref(), i);
                squares.add_scalar(*compliance) * scale * scale
            }
        }
    }

    /// G, which is not scaled, with a compliance added to its diagonal.
    pub fn softer(&self, more: f64) -> Self {
        let mut softer = self.clone();
        match &mut softer {
            Self::Dense(g) => (0..g.nrows()).for_each(|i| g[(i, i)] += more),
            Self::Rows { compliance, .. } => *compliance += more,
        }
        softer
    }

    /// w G w for a positive w, equal for the rows of a contact.
    pub fn scaled(&self, w: &DVector<f64>) -> Self {
        match self {
            Self::Dense(g) => Self::Dense(DMatrix::from_fn(w.len(), w.len(), |i, j| w[i] * g[(i, j)] * w[j])),
            Self::Rows { rows, scale, compliance } => {
                let scale = scale.as_ref().map_or_else(|| w.clone(), |scale| scale.component_mul(w));
                Self::Rows { rows: Arc::clone(rows), scale: Some(scale), compliance: *compliance }
            }
        }
    }

    /// G as a matrix.
    pub fn dense(&self) -> Cow<'_, DMatrix<f64>> {
        let (rows, scale, compliance) = match self {
            Self::Dense(g) => return Cow::Borrowed(g),
            Self::Rows { rows, scale, compliance } => (rows, scale.as_ref(), *compliance),
        };
        let mut wide = DMatrix::zeros(rows.pattern.joints, self.len());
        for (i, of) in rows.each().enumerate() {
            for (joint, entries) in of.each() {
                for (row, &entry) in entries.iter().enumerate() {
                    wide[(joint, 3 * i + row)] = entry * scale_of(scale, i);
                }
            }
        }
        let mut g = wide.tr_mul(&wide);
        g.fill_lower_triangle_with_upper_triangle();
        for i in 0..g.nrows() {
            let scale = scale_of(scale, i / 3);
            g[(i, i)] += compliance * scale * scale;
        }
        Cow::Owned(g)
    }

    /// The factor of A + B (G + eps), for blocks of each contact.
    pub(super) fn factor(&self, blocks: &[Blocks], eps: f64) -> Option<Factor> {
        let (rows, scale, compliance) = match self {
            Self::Dense(g) => {
                let mut matrix = DMatrix::zeros(g.nrows(), g.nrows());
                for (i, (a, b)) in blocks.iter().enumerate() {
                    add_rows(g, i, (&(a + b * eps), b), &mut matrix);
                }
                return Some(Factor::Dense(matrix.lu()));
            }
            Self::Rows { rows, scale, compliance } => (rows, scale.as_ref(), *compliance),
        };
        let mut own = Vec::with_capacity(blocks.len());
        let mut matrix = Band::identity(rows.pattern.joints, rows.pattern.band);
        for (i, ((a, b), of)) in blocks.iter().zip(rows.each()).enumerate() {
            let w = scale_of(scale, i);
            let inverse = (a + b * (eps + compliance * w * w)).try_inverse()?;
            let weight = inverse * b * (w * w);
            for (column, entries) in of.each() {
                let weighted = weight * entries;
                for (row, entries) in of.each() {
                    matrix.add(row, column, entries.dot(&weighted));
                }
            }
            own.push((inverse, b * w, w));
        }
        matrix.factorize().then(|| Factor::Rows { rows: Arc::clone(rows), own, matrix })
    }
}

/// The blocks A and B of a contact.
pub(super) type Blocks = (Matrix3<f64>, Matrix3<f64>);

/// The factor of A + B (G + eps).
pub(super) enum Factor {
    Dense(LU<f64, Dyn, Dyn>),
    /// C^-1, B times the scale and the scale of each contact, and the factor of 1 + W C^-1 B W*.
    Rows {
        rows: Arc<WideRows>,
        own: Vec<(Matrix3<f64>, Matrix3<f64>, f64)>,
        matrix: Band,
    },
}

impl Factor {
    /// The solution; `None` if the matrix is singular.
    pub fn solve(&self, f: &DVector<f64>) -> Option<DVector<f64>> {
        let (rows, own, matrix) = match self {
            Self::Dense(lu) => return lu.solve(f),
            Self::Rows { rows, own, matrix } => (rows, own, matrix),
        };
        let mut y = rows.along_joints(|i| own[i].0 * three(f, i) * own[i].2);
        matrix.solve(y.as_mut_slice());
        let mut p = DVector::zeros(f.len());
        for (i, ((inverse, b, _), of)) in own.iter().zip(rows.each()).enumerate() {
            p.fixed_rows_mut::<3>(3 * i).copy_from(&(inverse * (three(f, i) - b * of.times(&y))));
        }
        p.iter().all(|p| p.is_finite()).then_some(p)
    }
}

/// Sets the rows A + B G of a contact for its blocks A and B.
pub(super) fn add_rows(g: &DMatrix<f64>, i: usize, (a, b): (&Matrix3<f64>, &Matrix3<f64>), matrix: &mut DMatrix<f64>) {
    let at = 3 * i;
    for j in 0..matrix.ncols() {
        let own = b * g.fixed_view::<3, 1>(at, j);
        matrix.fixed_view_mut::<3, 1>(at, j).copy_from(&own);
    }
    let mut own = matrix.fixed_view_mut::<3, 3>(at, at);
    own += a;
}
