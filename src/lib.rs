//! phipsi: articulated-body dynamics as estimation.

pub mod error;
pub mod scalar;
pub mod spatial;
