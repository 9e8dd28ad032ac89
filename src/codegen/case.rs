//! Reference data of the generated tests: a state of the scene, and the result of its method there.

use super::functions::Function;
use super::program::Program;
use crate::error::Error;
use crate::scene::Scene;

/// The arguments of a program at one state, what the scene's method gives there, and the size of such numbers, by
/// which differences are measured.
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
        for (index, array) in program.arguments.iter().enumerate() {
            let first = index * nv;
            if array.name == "q" {
                let step: Vec<f64> = (first..first + nv).map(draw).collect();
                let mut q = vec![f64::NAN; array.width()];
                scene.integrate(&scene.neutral(), &step, &mut q)?;
                given.push(q);
            } else {
                given.push((first..first + array.width()).map(draw).collect());
            }
        }
        let by_scene = |function: &Function| {
            let given: Vec<&[f64]> = given.iter().map(|values| &values[..]).collect();
            function.by_scene(scene, program.tolerance, &given)
        };
        let expected = by_scene(&program.function)?;
        // A bias can be nothing but rounding: it is measured by torques that move the joints.
        let moving = match program.function {
            Function::BiasTorque => {
                Function::InverseDynamics.by_scene(scene, None, &[&given[0], &given[1], &given[1]])?
            }
            _ => Vec::new(),
        };
        let size = expected.iter().chain(&moving).fold(0.0, |size: f64, x| size.max(x.abs()));
        Ok(Self { given, expected, size: if size > 0.0 { size } else { 1.0 } })
    }
}

/// Numbers between -1 and 1 that depend on their place only.
fn draw(place: usize) -> f64 {
    #[allow(clippy::cast_precision_loss)] // small
    let angle = (place as f64).mul_add(2.399_963, 0.7);
    angle.sin()
}
