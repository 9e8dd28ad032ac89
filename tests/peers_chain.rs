//! The chain of the benches is that of Pinocchio: its accelerations, from Pinocchio 4.1.0 (C++, ABA in
//! local convention), as printed by `benches/peers/pinocchio_bench --accelerations`.
#![allow(clippy::cast_precision_loss)] // small indices

use crate::common::tolerance::{assert_near, inverse};
use phipsi::scenes;

#[test]
fn chain_of_seven_moves_as_pinocchios() {
    let peer = [
        4.432_779_133_563_46,
        99.999_999_999_999_7,
        -116.124_229_951_201,
        102.422_545_759_974,
        -93.084_378_570_728_1,
        91.485_986_695_787_7,
        -200.0,
    ];
    let wave = |start: f64, step: f64| -> Vec<f64> { (0..7_u8).map(|i| start + step * f64::from(i)).collect() };
    let scene = scenes::chain(7).unwrap();
    let mut qdd = [f64::NAN; 7];
    scene
        .forward_dynamics(&mut scene.workspace(), &wave(0.3, 0.1), &wave(0.5, -0.05), &wave(1.0, -0.2), &[], &mut qdd)
        .unwrap();
    // The harness measured a condition number of 4e3 for this chain.
    assert_near("qdd", &qdd, &peer, inverse(4e3, 200.0));
}
