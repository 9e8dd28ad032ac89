//! What the tests that are written beside the code compare with: a state of the scene, and what its method gives there.

use super::arrays::arguments;
use super::program::{Function, Program};
use crate::error::Error;
use crate::scene::Scene;

/// The arguments of a program at one state, what the scene's method gives there, and the size of such numbers, by which differences are measured.
pub(super) struct Case {
    pub given: Vec<Vec<f64>>,
    /// All results, one after another.
    pub expected: Vec<f64>,
    pub size: f64,
}

impl Case {
    /// A case with every joint moving, the same whenever it is asked for.
    pub fn new(scene: &Scene, program: &Program) -> Result<Self, Error> {
        let nv = scene.nv();
        let mut given = Vec::new();
        for (index, array) in arguments(program).iter().enumerate() {
            let first = index * nv;
            if array.name == "q" {
                let step: Vec<f64> = (first..first + nv).map(draw).collect();
                let mut q = vec![f64::NAN; array.width];
                scene.integrate(&scene.neutral(), &step, &mut q)?;
                given.push(q);
            } else {
                given.push((first..first + array.width).map(draw).collect());
            }
        }
        let expected = by_scene(scene, program.function, &given)?;
        let mut size = expected.iter().fold(0.0, |size: f64, x| size.max(x.abs()));
        if program.function == Function::BiasTorque {
            // A bias can be nothing but rounding: measured by torques that move the joints.
            given.push((2 * nv..3 * nv).map(draw).collect());
            let moving = by_scene(scene, Function::InverseDynamics, &given)?;
            size = moving.iter().fold(size, |size, x| size.max(x.abs()));
            given.pop();
        }
        Ok(Self { given, expected, size: if size > 0.0 { size } else { 1.0 } })
    }
}

/// What the scene's own method gives.
fn by_scene(scene: &Scene, function: Function, given: &[Vec<f64>]) -> Result<Vec<f64>, Error> {
    let (mut workspace, mut out) = (scene.workspace(), vec![f64::NAN; function.width(scene.nv())]);
    match function {
        Function::ForwardDynamics => {
            scene.forward_dynamics(&mut workspace, &given[0], &given[1], &given[2], &[], &mut out)?;
        }
        Function::InverseDynamics => {
            scene.inverse_dynamics(&mut workspace, &given[0], &given[1], &given[2], &[], &mut out)?;
        }
        Function::BiasTorque => scene.bias_torque(&mut workspace, &given[0], &given[1], &mut out)?,
        Function::MassMatrix => scene.mass_matrix(&mut workspace, &given[0], &mut out)?,
        Function::MassMatrixInverse => {
            scene.mass_matrix_inverse(&mut workspace, &mut scene.inverse_scratch(), &given[0], &mut out)?;
        }
    }
    Ok(out)
}

/// Numbers between -1 and 1 that depend on their place only.
fn draw(place: usize) -> f64 {
    #[allow(clippy::cast_precision_loss)] // small
    let angle = (place as f64).mul_add(2.399_963, 0.7);
    angle.sin()
}
