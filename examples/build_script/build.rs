//! Reads a URDF and writes the dynamics of that robot as Rust, which src/main.rs includes.

use std::path::Path;

/// Writes src/dynamics.rs and src/numbers.rs of the robot into a directory.
pub fn generate(urdf: &Path, directory: &Path) -> Result<(), Box<dyn std::error::Error>> {
    use phipsi::codegen::{Function, rust_sources};

    let scene = phipsi::SceneBuilder::from_urdf_file(urdf)?.build()?;
    for (file, text) in rust_sources(&scene, "robot", &[Function::ForwardDynamics, Function::BiasTorque])? {
        let path = directory.join(file);
        std::fs::create_dir_all(path.parent().unwrap_or(directory))?;
        std::fs::write(path, text)?;
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let urdf = Path::new("../../assets/puma560.urdf");
    println!("cargo::rerun-if-changed={}", urdf.display());
    generate(urdf, Path::new(&std::env::var("OUT_DIR")?))
}
