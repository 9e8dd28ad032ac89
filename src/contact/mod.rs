//! The cone problem of point contacts with Coulomb friction: impulses from G = J M^-1 J* and free velocities. No robotics.
//!
//! A contact has three rows, in this order: two tangents t1, t2 of its plane, and its normal n out of the ground. With contact velocities u = G p +
//! c, m/s, and impulses p on the robot, N s, the law of each contact is
//!
//! ```text
//! 0 <= u_n  perpendicular to  p_n >= a,     |p_t| <= mu p_n,     u_t = 0  or  p_t = -mu p_n u_t / |u_t|
//! ```
//!
//! with a = 0 but in the second half of an impact. Newton's method on Alart and Curnier's function ([`law`], [`newton`]) ends a solve at rounding, from the
//! impulses of the step before most of the time. Where it does not, an interior method ([`interior`]) brings the impulses near, or a curve that
//! is followed past its turns ([`path`]). Where G is singular (four points on a rigid foot), single impulses are not unique: they are those of
//! equal springs at the contacts ([`Cone::impulses`]).
//!
//! P. Alart and A. Curnier, Computer Methods in Applied Mechanics and Engineering 92, 1991, 353-375.

mod energy;
mod interior;
mod law;
mod newton;
mod path;
mod report;
mod scaled;
mod solve;
#[cfg(test)]
mod tests;

pub(crate) use energy::{Impact, expansion_kept, impact, passive};
pub use law::ContactState;
pub(crate) use law::{Cone, Limits};
pub(crate) use report::{Effort, SolveReport};
