//! The parts of the Rust code that are the same for every robot.

/// Words that no crate can be called by.
#[rustfmt::skip]
pub(super) const RESERVED: [&str; 57] = [
    "Self", "_", "abstract", "alloc", "as", "async", "await", "become", "box", "break", "const", "continue",
    "core", "crate", "do", "dyn", "else", "enum", "extern", "false", "final", "fn", "for", "gen", "if", "impl",
    "in", "let", "loop", "macro", "match", "mod", "move", "mut", "override", "priv", "proc_macro", "pub", "ref",
    "return", "self", "static", "std", "struct", "super", "test", "trait", "true", "try", "type", "typeof",
    "unsafe", "unsized", "use", "virtual", "where", "while",
];

pub(super) const LIBRARY: &str = include_str!("templates/lib.rs.in");

/// The trait that all functions are generic over.
pub(super) const NUMBER: &str = include_str!("templates/number.rs.in");

/// f64 and f32 by the standard library.
pub(super) const NUMBERS: &str = include_str!("templates/numbers.rs.in");

/// Lanes of scalars.
pub(super) const LANES: &str = include_str!("templates/lanes.rs.in");

/// The functions that all tests use.
pub(super) const TEST: &str = include_str!("templates/reference.rs.in");
