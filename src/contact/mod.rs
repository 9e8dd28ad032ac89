//! The cone problem of point contacts with Coulomb friction: impulses from G = J M^-1 J* and free velocities. No robotics.
//!
//! A contact has three rows, in this order: two tangents t1, t2 of its plane, and its normal n out of the ground. With contact velocities u = G p +
//! c, m/s, and impulses p on the robot, N s, the law of each contact is
//!
//! ```text
//! 0 <= u_n  perpendicular to  p_n >= a,     |p_t| <= mu p_n,     u_t = 0  or  p_t = -mu p_n u_t / |u_t|
//! ```
//!
//! with a = 0 but in the second half of an impact. ADMM with De Saxce's correction ([`admm`]) brings the impulses near, Newton's method on Alart and
//! Curnier's function ([`law`]) to rounding. Where G is singular (four points on a rigid foot), single impulses are not unique: they are those of
//! equal springs at the contacts ([`Cone::impulses`]).
//!
//! J. Carpentier, Q. Le Lidec and L. Montaut, From compliant to rigid contact simulation, RSS 2024; P. Alart and A. Curnier, Computer Methods in
//! Applied Mechanics and Engineering 92, 1991, 353-375.

mod admm;
mod energy;
mod law;
mod newton;
#[cfg(test)]
mod tests;
mod told;

pub(crate) use energy::{Impact, impact, passive};
pub(crate) use law::{Cone, Limits};
pub(crate) use told::{Effort, Told};
