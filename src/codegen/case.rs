//! Reference data of the generated tests: a state of the scene, and the result of its method for that state.

use super::functions::Function;
use super::program::Program;
use crate::error::Error;
use crate::scene::Scene;

/// The arguments of a program at one state, the results of the scene's method, and the scale of these results, to which
/// differences are relative.
pub(super) struct Case {
    pub given: Vec<Vec<f64>>,
    /// All results, one after another.
    pub expected: Vec<f64>,
    pub size: f64,
}

impl Case {
    /// A case in which every joint moves; the same for each call.
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
        // A bias can consist of rounding errors only. It is compared relative to torques that move the joints.
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

/// Values between -1 and 1 that depend on their index only.
fn draw(place: usize) -> f64 {
    #[allow(clippy::cast_precision_loss)] // small
    let angle = (place as f64).mul_add(2.399_963, 0.7);
    angle.sin()
}
