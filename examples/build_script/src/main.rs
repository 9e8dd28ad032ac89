//! Holds the robot that build.rs compiled, and lets it fall.

/// The robot: its functions, and f64 and f32 as their numbers. Not all of it is used here.
#[allow(dead_code)]
mod robot {
    include!(concat!(env!("OUT_DIR"), "/src/dynamics.rs"));

    mod numbers {
        include!(concat!(env!("OUT_DIR"), "/src/numbers.rs"));
    }
}

fn main() {
    let q = [0.3; robot::NQ];
    let rest = [0.0; robot::NV];
    let held = robot::bias_torque(&q, &rest);
    println!("torques that hold it: {held:.3?}");
    let still = robot::forward_dynamics(&q, &rest, &held);
    assert!(still.iter().all(|qdd: &f64| qdd.abs() < 1e-9), "it is held: {still:?}");
    println!("accelerations without them: {:.3?}", robot::forward_dynamics(&q, &rest, &rest));
}
