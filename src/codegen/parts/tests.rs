//! Programs in parts give the same results as undivided programs.

use super::{Cut, Given, Part, Source, is_cut, parts};
use crate::codegen::case::Case;
use crate::codegen::program::value;
use crate::codegen::{Function, Program};
use crate::scalar::Operation;
use crate::scene::{Inertial, JointDescription, JointKind, LinkDescription, Scene, SceneBuilder};
use crate::spatial::Symmetric3;
use nalgebra::Vector3;

/// A floating trunk on four legs with three joints each; values and signs differ between the legs.
fn robot() -> Scene {
    let link = |name: &str, mass: f64, side: f64| LinkDescription {
        name: name.to_owned(),
        inertial: Some(Inertial {
            mass,
            center: Vector3::new(0.03, 0.02 * side, -0.1),
            central: Symmetric3::new([0.02, 0.001 * side, 0.003, 0.03, 0.002 * side, 0.01].map(|entry| entry * mass)),
        }),
    };
    let mut builder = SceneBuilder::new().floating_base(true).link(link("trunk", 9.0, 0.3));
    for (leg, (front, side)) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].into_iter().enumerate() {
        let mut parent = "trunk".to_owned();
        for (at, axis) in [Vector3::x(), Vector3::y(), Vector3::y()].into_iter().enumerate() {
            let child = format!("leg {leg} link {at}");
            let offset = if at == 0 {
                Vector3::new(0.4 * front, 0.2 * side, 0.05)
            } else {
                Vector3::new(0.01, 0.07 * side, -0.3)
            };
            let mut joint =
                JointDescription::new(format!("leg {leg} joint {at}"), JointKind::Revolute, &parent, &child);
            joint.axis = axis;
            joint.origin.lever = offset;
            builder = builder.link(link(&child, [1.5, 1.1, 0.7][at], side)).joint(joint);
            parent = child;
        }
    }
    builder.build().expect("the robot is valid")
}

/// The inputs of one call, in the order of their indices.
fn given(program: &Program, arguments: &[f64], kept: &[f64], (part, call): (&Part, usize)) -> Vec<f64> {
    let firsts: Vec<usize> = (program.arguments.iter())
        .scan(0, |next, array| {
            let first = *next;
            *next += array.width();
            Some(first)
        })
        .collect();
    let number = |given: &Given| match given {
        Given::Constants(bits) => f64::from_bits(bits[call]),
        Given::Arguments(array, indices) => arguments[firsts[*array] + indices[call]],
        Given::Kept(slots) => kept[slots[call]],
    };
    part.given.iter().map(number).collect()
}

/// The results of a program in parts, each value computed from its operations; NaN if it is not written.
fn run(program: &Program, cut: &Cut, arguments: &[f64]) -> Vec<Vec<f64>> {
    let mut results: Vec<Vec<f64>> = program.results.iter().map(|array| vec![f64::NAN; array.width()]).collect();
    let (mut kept, mut done) = (vec![f64::NAN; cut.slots], vec![0; cut.parts.len()]);
    for (call, &part) in cut.calls.iter().enumerate() {
        let (of_part, row) = (&cut.parts[part], done[part]);
        let mut numbers = Vec::new();
        for (at, operation) in of_part.operations.iter().enumerate() {
            // Given values are read when they are needed, because the part itself stores some of them.
            let outside = given(program, arguments, &kept, (of_part, row));
            let value = value(operation, |operand| {
                let operand = operand as usize;
                outside.get(operand).copied().unwrap_or_else(|| numbers[operand - outside.len()])
            });
            numbers.push(value);
            for (_, slots) in of_part.keeps.iter().filter(|keep| keep.0 == at) {
                kept[slots[row]] = value;
            }
            for (_, result, indices) in of_part.writes.iter().filter(|write| write.0 == at) {
                results[*result][indices[row]] = value;
            }
        }
        done[part] += 1;
        for &(result, index, source) in &cut.others {
            if let Source::Kept { call: after, slot } = source
                && after == call
            {
                results[result][index] = kept[slot];
            }
        }
    }
    for &(result, index, source) in &cut.others {
        if let Source::Leaf(place) = source {
            results[result][index] = match program.operations[place] {
                Operation::Constant(bits) => f64::from_bits(bits),
                Operation::Argument(index) => arguments[index as usize],
                _ => f64::NAN,
            };
        }
    }
    results
}

/// The results of the undivided program, and of the program in parts.
fn compared(program: &Program, scene: &Scene) -> (Cut, Vec<f64>, Vec<f64>) {
    let arguments = Case::new(scene, program).unwrap().given.concat();
    let cut = parts(program);
    let found = run(program, &cut, &arguments).concat();
    let expected = program.run(&arguments).unwrap();
    (cut, found, expected)
}

#[test]
fn long_programs_in_parts_compute_the_same_bits() {
    let scene = robot();
    for function in [Function::ForwardDynamicsDerivatives, Function::ForwardDynamicsVjp, Function::MassMatrix] {
        let program = Program::new(&scene, &function).unwrap();
        let (cut, found, expected) = compared(&program, &scene);
        assert_eq!(cut.parts.len() > 1, is_cut(&program), "{function:?}");
        assert!(found.iter().zip(&expected).all(|(a, b)| a.to_bits() == b.to_bits()), "{function:?}");
    }
}

#[test]
fn what_legs_repeat_is_one_part() {
    let scene = robot();
    let program = Program::new(&scene, &Function::ForwardDynamicsDerivatives).unwrap();
    let cut = parts(&program);
    let length = |part: &Part| part.operations.len();
    let (all, written): (usize, usize) =
        (cut.calls.iter().map(|&part| length(&cut.parts[part])).sum(), cut.parts.iter().map(length).sum());
    assert!(2 * written < all, "{written} of {all}");
    // Four legs, one after another.
    assert!(cut.runs().iter().any(|run| run.rows.len() == 4));
    assert_eq!(cut.runs().iter().map(|run| run.rows.len()).sum::<usize>(), cut.calls.len());
    // Constants that differ are given values, and constants common to all legs are not in a table.
    let differs = |part: &&Part| {
        part.given.iter().any(|given| matches!(given, Given::Constants(bits) if bits.iter().any(|&x| x != bits[0])))
    };
    assert!(cut.parts.iter().filter(differs).count() > 0);
}

#[test]
fn results_that_nothing_computes_are_written_too() {
    // The mass matrix of two joints without coupling: zeros, and a constant.
    let link = |name: &str| LinkDescription {
        name: name.to_owned(),
        inertial: Some(Inertial {
            mass: 2.0,
            center: Vector3::zeros(),
            central: Symmetric3::new([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]),
        }),
    };
    let joint = |name: &str, child: &str| JointDescription::new(name, JointKind::Revolute, "base", child);
    let scene = SceneBuilder::new()
        .link(link("base"))
        .link(link("left"))
        .link(link("right"))
        .joint(joint("a", "left"))
        .joint(joint("b", "right"))
        .build()
        .unwrap();
    let program = Program::new(&scene, &Function::MassMatrix).unwrap();
    let (cut, found, expected) = compared(&program, &scene);
    assert!(cut.calls.is_empty());
    assert_eq!((found, expected), (vec![1.0, 0.0, 0.0, 1.0], vec![1.0, 0.0, 0.0, 1.0]));
}
