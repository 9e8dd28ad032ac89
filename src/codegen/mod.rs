//! Code generation for one robot: the sweeps run once on a scalar that records its operations, and the recorded
//! operations are written in C, Rust or CUDA.
//!
//! One mechanism removes the operations on zeros and ones, aligned axes, absent gravity and unused outputs: constants
//! are folded, and operations that change nothing are omitted.
//!
//! ```
//! use phipsi::codegen::{Function, Program};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(2)?;
//! let program = Program::new(&scene, &Function::InverseDynamics)?;
//! let mut tau = [f64::NAN; 2];
//! scene.inverse_dynamics(&mut scene.workspace(), &[0.1, 0.2], &[0.3, 0.4], &[0.5, 0.6], &[], &mut tau)?;
//! let found = program.run(&[0.1, 0.2, 0.3, 0.4, 0.5, 0.6])?;
//! assert!((found[0] - tau[0]).abs() < 1e-12 && (found[1] - tau[1]).abs() < 1e-12);
//! # Ok(())
//! # }
//! ```

mod c;
mod case;
mod circle;
mod coupled;
mod cuda;
mod functions;
mod lanes;
mod parts;
mod pieces;
mod program;
mod reference;
mod rust;
mod rust_texts;
mod syntax;
mod tracing;
mod width;

pub use c::{Sources, sources, sources_accepting};
pub use cuda::cuda_sources;
pub use functions::{Array, FUNCTIONS, Function, WATCHED};
pub use program::Program;
pub(crate) use program::count;
pub use rust::rust_sources;
pub use width::Width;
