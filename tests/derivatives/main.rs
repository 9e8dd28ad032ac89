//! Derivatives of the dynamics against central differences in double-double arithmetic, against first principles, dense algebra and identities.

#[path = "../common/mod.rs"]
mod common;
#[path = "common.rs"]
mod support;

mod arguments;
mod coriolis;
mod cost;
mod extremes;
#[allow(dead_code)] // some of it is for other tests
#[path = "../auto/families.rs"]
mod families;
mod forward;
mod inverse;
mod linear;
mod products;
