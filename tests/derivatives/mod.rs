//! Derivatives of the dynamics against central differences in double-double arithmetic, against first principles, dense algebra and identities.

mod arguments;
mod coriolis;
mod cost;
mod extremes;
mod forward;
mod inverse;
mod linear;
mod products;
mod support;
