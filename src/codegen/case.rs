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
                let signed = array.name != "compliance";
                given.push(
                    (first..first + array.width()).map(|at| if signed { draw(at) } else { draw(at).abs() }).collect(),
                );
            }
        }
        if !scene.constraints().is_empty() {
            close(scene, &mut given)?;
        }
        let by_scene = |function: &Function| {
            let given: Vec<&[f64]> = given.iter().map(|values| &values[..]).collect();
            function.by_scene(scene, &given)
        };
        let mut expected = by_scene(&program.function)?;
        if program.function.has_margin() {
            // No method returns it.
            expected.extend(program.run(&given.concat())?.last());
        }
        // A bias can consist of rounding errors only. It is compared relative to torques that move the joints.
        let moving = match program.function {
            Function::BiasTorque => Function::InverseDynamics.by_scene(scene, &[&given[0], &given[1], &given[1]])?,
            _ => Vec::new(),
        };
        let size = expected.iter().chain(&moving).fold(0.0, |size: f64, x| size.max(x.abs()));
        Ok(Self { given, expected, size: if size > 0.0 { size } else { 1.0 } })
    }
}

/// Moves q and qd of a case to a state that satisfies the connections, the farthest one from the neutral configuration
/// of several attempts.
fn close(scene: &Scene, given: &mut [Vec<f64>]) -> Result<(), Error> {
    let step: Vec<f64> = (0..scene.nv()).map(draw).collect();
    let (mut workspace, mut scratch) = (scene.workspace(), scene.constraint_scratch());
    let mut closed = Ok(());
    for scale in [1.0, 0.3, 0.1, 0.03, 0.0] {
        let step: Vec<f64> = step.iter().map(|x| x * scale).collect();
        let mut q = vec![f64::NAN; scene.nq()];
        scene.integrate(&scene.neutral(), &step, &mut q)?;
        let mut qd = given.get(1).cloned().unwrap_or_else(|| vec![0.0; scene.nv()]);
        closed = scene.project(&mut workspace, &mut scratch, &mut q, Some(&mut qd)).map(|_| ());
        if closed.is_ok() {
            given[0] = q;
            if let Some(given) = given.get_mut(1) {
                *given = qd;
            }
            break;
        }
    }
    closed
}

/// Values between -1 and 1 that depend on their index only.
fn draw(place: usize) -> f64 {
    #[allow(clippy::cast_precision_loss)] // small
    let angle = (place as f64).mul_add(2.399_963, 0.7);
    angle.sin()
}
