//! Optimal control: the filter of the paper, run through time from the end of a motion to its start.
//!
//! The Riccati recursion of a linear-quadratic problem is eq. 3.6 with phi = A*, H = B*, the cost of the controls as
//! the noise of measurements and the cost of the states as process noise. [`Optimizer`] repeats it about the motion
//! that it found before (iterative LQR, with the second derivatives of Gauss and Newton), until the model has no
//! further decrease:
//!
//! ```text
//! minimize  sum over steps k of 1/2 |r(q_k, v_k, u_k)|^2 dt + 1/2 |r(q_N, v_N)|^2
//! subject to  v' = v + dt a(q, v, u),  q' = q exp(dt v'),  lower <= u <= upper,  g(q, v, u) <= 0
//! ```
//!
//! Each residual is an error divided by its standard deviation. Bounds of the efforts hold at every stage; other
//! inequalities are an augmented Lagrangian.
//!
//! ```
//! use phipsi::control::{Cost, Optimizer, Problem, Start, Term};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(3)?;
//! let (steps, nv) = (50, scene.nv());
//! let effort = Term::Effort { tau: vec![0.0; nv], by_tau: vec![0.1; nv] };
//! let goal = Term::State { q: vec![0.5; 3], qd: vec![0.0; 3], by_q: vec![100.0; 3], by_qd: vec![10.0; 3] };
//! let costs = vec![
//!     Cost { term: effort, first: 0, last: steps - 1, is_limit: false },
//!     Cost { term: goal, first: steps, last: steps, is_limit: false },
//! ];
//! let mut problem = Problem::new(&scene, 0.02, steps);
//! problem.costs = costs;
//! let mut optimizer = Optimizer::new(&scene, problem)?;
//! let outcome = optimizer.solve(&Start { q: &[0.0; 3], qd: &[0.0; 3], ..Start::default() })?;
//! assert!(outcome.converged);
//! let reached = &optimizer.motion().q[steps * 3..];
//! assert!(reached.iter().all(|q| (q - 0.5).abs() < 0.02));
//! # Ok(())
//! # }
//! ```

mod array;
mod contacts;
mod costs;
mod dynamics;
mod knot;
mod matrices;
mod optimizer;
mod problem;
mod rollout;
mod rows;
mod stage;

pub use costs::{Cost, Limit, Motion, Residual, Term};
pub use optimizer::Optimizer;
pub use problem::{Iteration, Linearization, Outcome, Problem, Start};
