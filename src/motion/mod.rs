//! Simulation: time integration of states, with stiff springs and damping as measurement noise.
//!
//! The equations of motion, with s the [displacement](crate::joints::Motion::displacement) of a spring from rest:
//!
//! ```text
//! M(q) dv/dt + bias(q, v) = u - d v - k s(q) + r   (per joint: damping, spring, and torque r of friction and stops)
//! dq/dt = v on the manifold: q(t + h) = q(t) exp(h v) for a constant v
//! ```
//!
//! A *linearly implicit* step computes the acceleration a with damping and springs evaluated at the end of the step,
//! that is, with v + h a for v and s + h v + h^2 a for s:
//!
//! ```text
//! (M + h d + h^2 k) a = u - bias - d v - k (s + h v)
//! ```
//!
//! The diagonal on the left is the covariance of measurement noise, like armature: the filter adds it to the pivot, D =
//! H P^- H* + r + h d + h^2 k, and the step costs as much as an explicit one.
//!
//! Exact friction and stops are a set-valued law: r = -f sign(v) in motion, any torque between -f and f at rest, and
//! any torque away from a stop at the stop. A joint that friction or a stop holds is *stuck*: measurement noise without
//! bound makes its gain zero, so that the filter treats it like a fixed joint, still in O(N). `stops` implements the
//! law, `events` the steps of trees in which a joint sticks, slips or reaches a stop
//! (`closed_stops` those of loops), `division` the substeps of all scenes, and `totals` the works.
//!
//! In scenes with connections, accelerations satisfy J qdd + J' qd = 0, and each step ends with a
//! projection of positions and velocities onto the connections, with the displacement of least kinetic energy.
//!
//! A step of a scene with contacts in which no contact can act is that of the scene without contacts, with the same
//! bits. In the others contacts act by [`Method::Contact`].
//!
//! Wrenches on links ([`Wrenches`]) are joint torques J(q)^T F, evaluated in every stage (`wrenches`).
//!
//! A [`Rollout`] advances a batch of states by many steps; a [`Simulator`] advances it call by call. Both take
//! [`Settings`]: joint properties ([`Properties`]), a control law ([`Gains`]) and a [`Method`]. [`Rollout::gradients`]
//! differentiates a rollout by backpropagation.
//!
//! ```
//! use phipsi::motion::{Method, Records, Rollout, Settings, Torque};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(7)?;
//! let mut settings = Settings::new(&scene, 1e-3); // with springs, damping and friction of the scene
//! settings.method = Method::RungeKutta4;
//! let mut rollout = Rollout::new(&scene, settings, &[0.3; 7], &[0.0; 7])?;
//! let (mut q, mut qd) = ([f64::NAN; 77], [f64::NAN; 77]); // 11 rows: the start, and every tenth step
//! let mut records = Records::new(&mut q, &mut qd).with_every(10);
//! rollout.advance(100, &Torque::Zero, Some(&mut records))?;
//! assert_eq!(q[..7], [0.3; 7]);
//! assert_eq!(&q[70..], rollout.state(0).0);
//! # Ok(())
//! # }
//! ```

mod backward;
mod checked;
mod choice;
mod closed_reverse;
mod closed_steps;
mod closed_stop_reverse;
mod closed_stops;
mod connected;
mod constrained;
mod contact;
mod division;
mod drives;
mod events;
mod faults;
mod friction;
mod friction_curve;
mod gradient;
mod gradient_layout;
mod job;
mod limit_rows;
pub(crate) mod method;
mod modes;
mod population;
pub(crate) mod properties;
mod reversed_substeps;
mod reverser;
pub(crate) mod rollout;
mod runner;
mod scratch;
mod settings;
pub(crate) mod simulator;
mod solver;
mod start;
mod step;
mod step_settings;
mod stepper;
mod stops;
mod torque;
mod totals;
mod touches;
mod works;
mod wrenches;

pub use contact::{ContactId, ContactReport, ContactState, ModeChange, ShapeGradients};
pub use events::StopImpact;
pub use gradient::{ContactGradients, RolloutGradients};
pub use gradient_layout::RecordedRows;
pub use job::Records;
pub use method::{METHODS, Method};
pub use properties::{FRICTION_SPEED, Gains, Properties};
pub use rollout::Rollout;
pub use settings::{Limits, Settings};
pub use simulator::Simulator;
pub use torque::{StepFault, Torque};
pub use totals::Totals;
pub use touches::ShapeContact;
pub use wrenches::{WRENCH_FRAMES, WrenchFrame, Wrenches};

use crate::kinematics::manifold;
