//! Forward dynamics of one state, in covariance form, with one simplification turned off or none: for callgrind, whose counts do not
//! depend on what else the machine does (docs/leaving-out.md).
//!
//! `leaving_out SWITCH|none rest|moving weight|weightless CALLS [tilted]`: the last with axes tilted from those of their parents.

use nalgebra::Vector3;
use phipsi::scene::{JointDescription, JointKind, LinkDescription, SceneBuilder, Simplifications};
use phipsi::{Algorithm, Arguments, Error, Form, Scene, scenes};
use std::hint::black_box;

/// The benches' chain of seven with a weld on every link, a second link on the base, and a planar joint at the tip.
fn scene(simplifications: Simplifications, gravity: [f64; 3], kind: &str) -> Result<Scene, Error> {
    let chain = scenes::chain(7)?.source().clone();
    let rod = chain.links()[1].inertial;
    let mut builder = SceneBuilder::new().gravity(gravity).simplifications(simplifications);
    for link in chain.links() {
        builder = builder.link(link.clone());
    }
    for joint in chain.joints() {
        let mut joint = joint.clone();
        if kind == "tilted" {
            let [x, y, z] = joint.axis.into();
            joint.axis += Vector3::new(z, x, y) * 0.5;
        }
        builder = builder.joint(joint);
    }
    let mut parts = vec![("column".to_owned(), JointKind::Fixed, "base".to_owned())];
    parts.extend((0..7).map(|k| (format!("weld{k}"), JointKind::Fixed, format!("link{k}"))));
    parts.push(("sledge".to_owned(), JointKind::Planar, "link6".to_owned()));
    for (name, kind, parent) in parts {
        let mut joint = JointDescription::new(format!("to {name}"), kind, parent, name.clone());
        joint.origin.lever = [0.1, 0.0, 0.1].into();
        builder = builder.link(LinkDescription { name, inertial: rod }).joint(joint);
    }
    builder.build()
}

fn main() -> Result<(), Error> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let given = |i: usize| arguments.get(i).map_or("", String::as_str);
    let switch = Simplifications::SWITCHES.iter().copied().find(|(name, _)| *name == given(0));
    let simplifications = switch.map_or_else(Simplifications::all, |(_, switch)| Simplifications::all_but(switch));
    let gravity = if given(2) == "weightless" { [0.0; 3] } else { [0.0, 0.0, -9.81] };
    let calls: usize = given(3).parse().unwrap_or(1000);
    let scene = scene(simplifications, gravity, given(4))?;
    let rate = if given(1) == "rest" { 0.0 } else { 0.3 };
    let (mut q, qd, tau) = (vec![0.4; scene.nq()], vec![rate; scene.nv()], vec![1.0; scene.nv()]);
    let (mut evaluator, mut qdd) = (scene.evaluator(), vec![f64::NAN; scene.nv()]);
    let algorithm = Algorithm::ForwardDynamics(Form::Covariance);
    for _ in 0..calls {
        q[0] += 1e-3;
        let state = Arguments { q: black_box(&q), qd: &qd, u: &tau, wrenches: &[], ..Arguments::default() };
        scene.evaluate(&mut evaluator, algorithm, &[state], &mut qdd).map_err(|fault| fault.error)?;
        black_box(&qdd);
    }
    println!("qdd of the first joint: {}", qdd[0]);
    Ok(())
}
