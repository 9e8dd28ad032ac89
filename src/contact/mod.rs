//! The friction cone problem of point contacts: impulses from the Delassus matrix G = J M^-1 J* and free velocities.
//! This module contains no robotics.
//!
//! A contact has three rows, in this order: two tangents t1, t2 of its plane, and its normal n toward the free side.
//! For contact velocities u = G p + c, m/s, and impulses p on the robot, N s, the law of each contact is
//!
//! ```text
//! 0 <= u_n  perpendicular to  p_n >= a,     |p_t| <= mu p_n,     u_t = 0  or  p_t = -mu p_n u_t / |u_t|
//! ```
//!
//! with a = 0 except in the expansion phase of an impact. Newton's method on the function of Alart and Curnier
//! ([`law`], [`newton`]), started from the impulses of the previous step, usually converges to rounding. Otherwise an
//! interior-point method ([`interior`]) or continuation along a curve ([`path`]) provides a better start. If G is
//! singular (four points on a rigid foot), individual impulses are not unique; the solver returns those of equal
//! springs at the contacts ([`Cone::impulses`]). Contacts that G does not couple are solved in groups ([`Cones`]).
//!
//! A relaxed law ([`relaxed`]) makes the impulses smooth functions of the velocities.
//!
//! P. Alart and A. Curnier, Computer Methods in Applied Mechanics and Engineering 92, 1991, 353-375.

mod band;
mod energy;
mod gram;
mod groups;
mod held;
mod implicit;
mod interior;
mod law;
mod newton;
mod path;
mod relaxed;
mod report;
mod scaled;
mod solve;
#[cfg(test)]
mod tests;

pub(crate) use energy::{Impact, expansion_kept, impact, passive};
pub(crate) use gram::{Gram, RowPattern};
pub(crate) use groups::Cones;
pub(crate) use implicit::{LawCotangents, Mode, Turning};
pub use law::ContactState;
pub(crate) use law::{Cone, Limits};
pub(crate) use relaxed::Relaxation;
pub(crate) use report::{Effort, SolveReport};
