//! Motion: states advanced in time, with stiff joints as measurement noise.
//!
//! The equations of motion, with s the [displacement](crate::joints::Motion::displacement) of a spring from rest:
//!
//! ```text
//! M(q) dv/dt + bias(q, v) = u - d v - f v / sqrt(v^2 + v0^2) - k s(q)          (joint by joint: damping, friction, spring)
//! dq/dt = v on the manifold: q(t + h) = q(t) exp(h v) for a constant v
//! ```
//!
//! A *linearly implicit* step solves for the acceleration a with damping and springs taken at its end: with v + h a for v and
//! s + h v + h^2 a for s,
//!
//! ```text
//! (M + h d + h^2 k) a = u - bias - d v - k (s + h v)
//! ```
//!
//! The diagonal on the left is the covariance of measurement noise, as armature is: the filter takes it in the pivot,
//! D = H P^- H* + r + h d + h^2 k, and the step costs what an explicit one does.
//!
//! [`properties`] is what joints do by themselves, [`method`] the coefficients of the methods, [`manifold`] configurations,
//! `conserve` the momentum of floating trees, `step` one step in any scalar, `stepper` states in lanes through many steps, [`rollout`] a batch of them on
//! threads, [`simulator`] one that goes on step by step. `backward` is one step backward, `reverser` states backward through many, `gradient` a batch of them:
//! [`Rollout::gradients`].

#[cfg(feature = "adaptive")]
pub(crate) mod adaptive;
mod backward;
mod conserve;
mod gradient;
pub(crate) mod manifold;
pub(crate) mod method;
pub(crate) mod properties;
mod reverser;
pub(crate) mod rollout;
pub(crate) mod simulator;
mod step;
mod stepper;

#[cfg(feature = "adaptive")]
pub use adaptive::{Adaptive, Failure, Solution, Solver, TorqueLaw};
pub use conserve::Correction;
pub use gradient::{RecordedRows, RolloutGradients};
pub use method::{METHODS, Method};
pub use properties::{FRICTION_SPEED, Gains, Properties};
pub use rollout::{Records, Rollout, Settings, StepFault, Torque};
pub use simulator::Simulator;
