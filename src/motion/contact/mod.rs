//! Steps of scenes with contacts: a semi-implicit step of order 1 whose impulses satisfy the contact law at its end
//! (time stepping of J. J. Moreau).
//!
//! ```text
//! v_free = v + h a,  a = M^-1 (tau - bias)    springs, damping, friction and control law as in the implicit Euler step
//! impacts:   Poisson's hypothesis for contacts that rebound, limited so that the kinetic energy does not increase, at
//!            the start of a part of the step ([`division`]), else at v + h a/2;  v_free += M^-1 J* p
//! contact:   0 <= u_n + max(gap, 0)/h  perpendicular to  p_n >= 0,  Coulomb friction on u_t,
//!            u = J (v_free + M^-1 J* p)
//!            v' = v_free + M^-1 J* p,  q' = q exp(h v')
//! projection: least-energy displacement that removes the penetration left by rounding and curvature
//! ```
//!
//! With connections or coupled joints, `v_free` and the responses to impulses are those on the connections
//! ([`closed`]).
//!
//! Free joints are integrated in axes that are fixed during the step: in rotating body axes, a rolling body would gain
//! speed.
//!
//! `smoothing` replaces the law by a relaxed one.
//!
//! `backward` differentiates a step in the modes of its contacts, and `reverse` sums the gradients over all steps.

mod at;
mod backward;
mod closed;
mod control;
mod division;
mod faults;
mod free_axes;
mod gap;
mod lanes;
mod laws;
mod moves;
mod pairs;
mod parts;
mod project;
mod reach;
mod record;
mod report;
mod reverse;
mod shaped;
mod shapes;
mod smoothing;
mod step;
mod stepper;
mod switching;

pub use crate::contact::ContactState;
pub(super) use lanes::{Touching, finish_contacts};
pub use report::ContactReport;
pub(super) use report::{RECORD, begin, width};
pub use reverse::{ContactId, ModeChange, ShapeGradients};
pub(super) use reverse::{ContactReverse, check_reproduced};
pub(super) use shapes::Shapes;
pub(super) use smoothing::Smoothing;
pub(super) use stepper::{ContactStepper, record};
pub(super) use switching::Switching;
