//! All Rust tests in one program, because each program would link the crate again, with its disk space and time.
//!
//! `cargo test --test all golden::` runs those of one file. Tests that need a separate process are other targets, see
//! Cargo.toml.

#![allow(clippy::disallowed_methods)] // references decompose matrices that are finite and square

#[cfg_attr(not(feature = "dense"), allow(dead_code))] // tests of this feature use the rest
mod common;

mod allocations;
mod auto;
mod changed_scenes;
mod codegen;
mod codegen_languages;
mod constraints;
mod contacts;
mod control;
#[cfg(feature = "dense")]
mod dense_check;
mod derivatives;
mod double_double;
mod equations_table;
mod estimation;
#[cfg(feature = "dense")]
mod extreme_scenes;
mod extremes;
mod forms;
mod golden;
mod inverse_kinematics;
mod kinematic_quantities;
mod lanes;
mod leaving_out;
mod live_terms;
mod metamorphic;
mod mimic;
mod motion;
mod no_panics;
mod operational;
mod operations;
#[cfg(feature = "dense")]
mod paper_section_1;
#[cfg(feature = "dense")]
mod paper_section_2;
#[cfg(feature = "dense")]
mod paper_section_3;
#[cfg(feature = "dense")]
mod paper_section_4;
#[cfg(feature = "dense")]
mod paper_section_5;
#[cfg(feature = "dense")]
mod paper_section_6;
mod peers_chain;
mod plain_methods;
mod properties;
mod reference;
mod rollout_gradients;
mod rust_interface;
mod scene_errors;
mod set_valued;
mod singular_joints;
#[cfg(feature = "stochastic")]
mod stochastic;
mod threads;
#[cfg(feature = "urdf")]
mod urdf;
#[cfg(feature = "urdf")]
mod urdf_notes;

#[test]
fn every_file_of_tests_is_in_a_program() {
    let (here, cargo) = (include_str!("all.rs"), include_str!("../Cargo.toml"));
    for entry in std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/tests")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        let is_rust = path.extension().is_some_and(|suffix| suffix == "rs") || path.join("mod.rs").exists();
        let is_known =
            here.contains(&format!("\nmod {name};")) || cargo.contains(&format!("path = \"tests/{name}.rs\""));
        assert!(!is_rust || is_known, "tests/{name} runs in no program: give it a mod line in tests/all.rs");
    }
}
