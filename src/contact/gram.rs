//! G = J M^-1 J* of coupled contacts: a matrix, or the product W* W of sparse rows if many contacts act on few joints.
//!
//! Newton's method needs (A + B (G + eps))^-1 with 3 x 3 blocks A and B of each contact. With C = A + eps B and G = W* W
//! it is
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
use std::sync::Arc;

/// Rows are kept apart from at least this number on, and if they are more than the joints by this factor.
const MANY: usize = 60;
const MORE: f64 = 1.5;

/// W of one contact.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ContactRows {
    /// The joints that its impulse moves, in the order of the band.
    pub columns: Vec<usize>,
    /// The entries of its three rows in each of these columns.
    pub entries: Vec<Vector3<f64>>,
}

/// W of all contacts.
#[derive(Debug, PartialEq)]
pub(crate) struct WideRows {
    contacts: Vec<ContactRows>,
    columns: usize,
    /// Distance from the diagonal of the entries that couple joints.
    band: usize,
}

/// The matrix G of some contacts.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Gram {
    /// G.
    Dense(DMatrix<f64>),
    /// scale (W* W + compliance) scale.
    Rows { rows: Arc<WideRows>, scale: Option<DVector<f64>>, compliance: f64 },
}

/// True if G of these rows is better kept as W.
pub(crate) fn has_many_rows(rows: usize, columns: usize) -> bool {
    #[allow(clippy::cast_precision_loss)] // counts
    let more = rows as f64 > MORE * columns as f64;
    rows >= MANY && more
}

impl WideRows {
    /// From the columns and entries of each contact; renumbers the columns.
    pub fn new(mut contacts: Vec<ContactRows>, columns: usize) -> Self {
        let (order, band) = narrow(contacts.iter().map(|of| &of.columns[..]), columns);
        for column in contacts.iter_mut().flat_map(|of| &mut of.columns) {
            *column = order[*column];
        }
        Self { contacts, columns, band }
    }

    /// W x.
    fn along_joints(&self, x: impl Fn(usize) -> Vector3<f64>) -> DVector<f64> {
        let mut y = DVector::zeros(self.columns);
        for (i, of) in self.contacts.iter().enumerate() {
            let x = x(i);
            for (&column, entries) in of.columns.iter().zip(&of.entries) {
                y[column] += entries.dot(&x);
            }
        }
        y
    }
}

impl ContactRows {
    /// Its rows of W* y.
    fn times(&self, y: &DVector<f64>) -> Vector3<f64> {
        self.columns.iter().zip(&self.entries).fold(Vector3::zeros(), |sum, (&column, of)| sum + of * y[column])
    }
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
    pub fn of_rows(rows: WideRows) -> Self {
        Self::Rows { rows: Arc::new(rows), scale: None, compliance: 0.0 }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        match self {
            Self::Dense(g) => g.nrows(),
            Self::Rows { rows, .. } => 3 * rows.contacts.len(),
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
        for (i, of) in rows.contacts.iter().enumerate() {
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
                let scale = |i: usize| scale.as_ref().map_or_else(|| Vector3::repeat(1.0), |scale| three(scale, i));
                let mut sizes = DVector::<f64>::zeros(rows.columns);
                for (i, of) in rows.contacts.iter().enumerate() {
                    let p = three(p, i).component_mul(&scale(i)).abs();
                    for (&column, entries) in of.columns.iter().zip(&of.entries) {
                        sizes[column] += entries.abs().dot(&p);
                    }
                }
                for (i, of) in rows.contacts.iter().enumerate() {
                    let each = of.columns.iter().zip(&of.entries);
                    let sum = each.fold(Vector3::zeros(), |sum, (&column, of)| sum + of.abs() * sizes[column]);
                    let own = (sum + three(p, i).component_mul(&scale(i)).abs() * *compliance).component_mul(&scale(i));
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
                let own = &rows.contacts[i].entries;
                let squares = own.iter().fold(Vector3::zeros(), |sum, of| sum + of.component_mul(of));
                let scale = scale.as_ref().map_or_else(|| Vector3::repeat(1.0), |scale| three(scale, i));
                squares.add_scalar(*compliance).component_mul(&scale).component_mul(&scale)
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
            Self::Rows { rows, scale, compliance } => (rows, scale, *compliance),
        };
        let mut wide = DMatrix::zeros(rows.columns, self.len());
        for (i, of) in rows.contacts.iter().enumerate() {
            for (&column, entries) in of.columns.iter().zip(&of.entries) {
                for (row, &entry) in entries.iter().enumerate() {
                    wide[(column, 3 * i + row)] = entry * scale.as_ref().map_or(1.0, |scale| scale[3 * i + row]);
                }
            }
        }
        let mut g = wide.tr_mul(&wide);
        g.fill_lower_triangle_with_upper_triangle();
        for i in 0..g.nrows() {
            let scale = scale.as_ref().map_or(1.0, |scale| scale[i]);
            g[(i, i)] += compliance * scale * scale;
        }
        Cow::Owned(g)
    }

    /// The factor of A + B (G + eps), for blocks of each contact.
    pub(super) fn factor(&self, blocks: &[(Matrix3<f64>, Matrix3<f64>)], eps: f64) -> Option<Factor<'_>> {
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
        let mut matrix = Band::identity(rows.columns, rows.band);
        for (i, ((a, b), of)) in blocks.iter().zip(&rows.contacts).enumerate() {
            let w = scale.map_or(1.0, |scale| scale[3 * i]);
            let inverse = (a + b * (eps + compliance * w * w)).try_inverse()?;
            let weight = inverse * b * (w * w);
            for (&column, entries) in of.columns.iter().zip(&of.entries) {
                let weighted = weight * entries;
                for (&row, entries) in of.columns.iter().zip(&of.entries) {
                    matrix.add(row, column, entries.dot(&weighted));
                }
            }
            own.push((inverse, b * w, w));
        }
        matrix.factorize().then_some(Factor::Rows { rows, own, matrix })
    }
}

/// The factor of A + B (G + eps).
pub(super) enum Factor<'a> {
    Dense(LU<f64, Dyn, Dyn>),
    /// C^-1, B times the scale and the scale of each contact, and the factor of 1 + W C^-1 B W*.
    Rows {
        rows: &'a WideRows,
        own: Vec<(Matrix3<f64>, Matrix3<f64>, f64)>,
        matrix: Band,
    },
}

impl Factor<'_> {
    /// The solution; `None` if the matrix is singular.
    pub fn solve(&self, f: &DVector<f64>) -> Option<DVector<f64>> {
        let (rows, own, matrix) = match self {
            Self::Dense(lu) => return lu.solve(f),
            Self::Rows { rows, own, matrix } => (rows, own, matrix),
        };
        let mut y = rows.along_joints(|i| own[i].0 * three(f, i) * own[i].2);
        matrix.solve(y.as_mut_slice());
        let mut p = DVector::zeros(f.len());
        for (i, ((inverse, b, _), of)) in own.iter().zip(&rows.contacts).enumerate() {
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
