//! Steps of scenes with contacts: a semi-implicit step whose impulses meet the law of contacts at its end (J. J. Moreau's time-stepping), order 1.
//!
//! ```text
//! v_free = v + h a, a = M^-1 (tau - bias) springs, damping, friction and control law at the end of the step, as in the implicit Euler step impact of
//! what rebounds: Poisson's law at v + h a/2, with what it gives kept from raising the kinetic energy; v_free += M^-1 J* p contact 0 <= u_n +
//! max(gap, 0)/h perpendicular to p_n >= 0, Coulomb's friction on u_t, of u = J (v_free + M^-1 J* p); v' = v_free + M^-1 J* p q' = q exp(h v'), and
//! by a least-energy move out of what rounding and curvature leave under the planes
//! ```
//!
//! Free joints are stepped in axes at rest: in their own turning axes a body that rolls would gain speed.

mod kept;
mod project;
mod run;
mod step;

pub use crate::contact::ContactState;
pub use kept::ContactReport;
pub(super) use kept::{RECORD, begin, width};
pub(super) use run::{Toucher, record};
