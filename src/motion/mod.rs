//! Motion: states advanced in time, with stiff joints as measurement noise.
//!
//! The equations of motion, with s the [displacement](crate::joints::Motion::displacement) of a spring from rest:
//!
//! ```text
//! M(q) dv/dt + bias(q, v) = u - d v - k s(q) + r          (joint by joint: damping, spring, and r, the torque of friction and stops)
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
//! Friction and stops are a set-valued law: r = -f sign(v), any torque between -f and f at rest, and any torque away from a stop at the stop. A joint that is held is *locked*:
//! measurement noise without bound makes its gain zero, so the filter passes it as if it were fixed, still in O(N). `stops` has the law, `substeps` the steps in which a joint
//! sticks, slips or meets a stop, and `totals` the works.
//!
//! Scenes with connections move through them: accelerations meet J qdd + J' qd = 0, and a [`Stabilization`] keeps positions and velocities on them.
//!
//! Scenes with contacts move by [`Method::Contact`], and by no other method.
//!
//! A [`Rollout`] is a batch of states through many steps, a [`Simulator`] one that goes on call by call; [`Settings`] is what both need, with what
//! the joints do by themselves ([`Properties`]), a control law ([`Gains`]) and a [`Method`]. [`Rollout::gradients`] goes back through the steps.
//! `Adaptive` (feature `adaptive`) picks its own steps.
//!
//! ```
//! use phipsi::motion::{Method, Records, Rollout, Settings, Torque};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(7)?;
//! let mut settings = Settings::new(&scene, 1e-3); // springs, damping and friction of the scene
//! settings.method = Method::RungeKutta4;
//! let mut rollout = Rollout::new(&scene, settings, &[0.3; 7], &[0.0; 7])?;
//! let (mut q, mut qd) = ([f64::NAN; 77], [f64::NAN; 77]); // 11 rows: the start, and every tenth step
//! let mut records = Records { q: &mut q, qd: &mut qd, contacts: &mut [], every: 10 };
//! rollout.advance(100, &Torque::Zero, Some(&mut records)).map_err(|fault| fault.error)?;
//! assert_eq!(q[..7], [0.3; 7]);
//! assert_eq!(&q[70..], rollout.state(0).0);
//! # Ok(())
//! # }
//! ```

#[cfg(feature = "adaptive")]
pub(crate) mod adaptive;
mod backward;
mod choice;
mod closed_stops;
mod conserve;
mod constrained;
mod contact;
mod faults;
mod gradient;
mod job;
mod limit_rows;
pub(crate) mod manifold;
pub(crate) mod method;
mod modes;
pub(crate) mod properties;
mod reverser;
pub(crate) mod rollout;
mod scratch;
mod settings;
pub(crate) mod simulator;
mod solver;
mod start;
mod step;
mod step_settings;
mod stepper;
mod stops;
mod substeps;
mod torque;
mod totals;
mod works;

#[cfg(feature = "adaptive")]
pub use adaptive::{Adaptive, Failure, Solution, Solver, TorqueLaw};
pub use conserve::Correction;
pub use contact::{ContactReport, ContactState};
pub use gradient::{RecordedRows, RolloutGradients};
pub use method::{METHODS, Method};
pub use properties::{FRICTION_SPEED, Gains, Properties};
pub use rollout::{Records, Rollout};
pub use settings::{Limits, Settings, Stabilization};
pub use simulator::Simulator;
pub use substeps::StopImpact;
pub use torque::{StepFault, Torque};
pub use totals::Totals;
