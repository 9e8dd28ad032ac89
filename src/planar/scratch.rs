//! What the planar sweeps keep of each body.

use super::model::PlanarModel;
use crate::filter::pivots::Scale;
use crate::scalar::Real;

/// Of one body, in its planar frame unless another is named; forces are (moment, x, y), motions (angular, x, y).
#[derive(Debug, Clone, Copy)]
pub(super) struct Of<T> {
    /// Cosine and sine of the angle to the parent's frame.
    pub turn: [T; 2],
    /// The origin in the parent's frame.
    pub lever: [T; 2],
    /// Angular velocity, and its square.
    pub spin: [T; 2],
    /// Acceleration of the origin (not the spatial one: the velocity product is in it); on the way out, the co-state.
    pub motion: [T; 3],
    /// b(k), then z^-(k), then z^+(k).
    pub force: [T; 3],
    /// P^-(k): moment, moment with x, with y, then xx, xy, yy.
    pub p: [T; 6],
    /// The bound on the terms of P^-.
    pub scale: Scale<T>,
    /// g(k).
    pub gain: [T; 3],
    /// 1 / D(k).
    pub pivot_inverse: T,
}

/// Of one body, in the base's planar frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct OnBase<T> {
    /// Cosine and sine of the body's angle.
    pub turn: [T; 2],
    /// From the parent's origin to the body's.
    pub lever: [T; 2],
    /// r(k): mass, first moment, inertia.
    pub composite: [T; 4],
    /// g(k).
    pub gain: [T; 3],
    /// Lambda^-(k), entries as those of P.
    pub co_state_covariance: [T; 6],
    /// Lambda^+(k) g(k).
    pub spread_gain: [T; 3],
}

/// The scratch of every planar algorithm for one state (or one a lane), with `C` as many columns of `M^-1` side by side as it holds;
/// starts as NaN.
#[derive(Debug, Clone)]
pub struct PlanarScratch<T: Real, C: Real = T> {
    pub(super) of: Vec<Of<T>>,
    /// What M and `M^-1` need beside that.
    pub(super) on_base: Vec<OnBase<T>>,
    /// Minus the co-states of the columns at hand.
    pub(super) columns: Vec<[C; 3]>,
    /// The same where branches part, of columns that belong further out.
    pub(super) parted: Vec<[C; 3]>,
    /// Whether more than one body hangs on each body.
    pub(super) branches: Vec<bool>,
}

impl<T: Real, C: Real> PlanarScratch<T, C> {
    /// Scratch for `model`, about 0.6 kB a body in f64.
    #[must_use]
    pub fn new(model: &PlanarModel<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        let bodies = model.bodies.len();
        let on_base = OnBase {
            turn: [nan; 2],
            lever: [nan; 2],
            composite: [nan; 4],
            gain: [nan; 3],
            co_state_covariance: [nan; 6],
            spread_gain: [nan; 3],
        };
        let of = Of {
            turn: [nan; 2],
            lever: [nan; 2],
            spin: [nan; 2],
            motion: [nan; 3],
            force: [nan; 3],
            p: [nan; 6],
            scale: Scale::filled(nan),
            gain: [nan; 3],
            pivot_inverse: nan,
        };
        let mut children = vec![0_usize; bodies];
        for parent in model.bodies.iter().filter_map(|body| body.parent) {
            children[parent] += 1;
        }
        let columns = vec![[C::from_f64(f64::NAN); 3]; bodies];
        Self {
            of: vec![of; bodies],
            on_base: vec![on_base; bodies],
            parted: columns.clone(),
            columns,
            branches: children.into_iter().map(|count| count > 1).collect(),
        }
    }
}
