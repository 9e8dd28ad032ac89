//! Derivatives of the dynamics compared with central differences in double-double arithmetic, definitions, dense
//! algebra and identities.

mod arguments;
mod coriolis;
mod cost;
mod extremes;
mod forward;
mod inverse;
mod linear;
mod products;
mod support;
