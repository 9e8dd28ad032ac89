use phipsi::batch::arms::Arm;
use phipsi::batch::chunk::{Algorithm, Arguments};
use phipsi::batch::evaluator::Evaluator;
use phipsi::filter::Form;
use std::hint::black_box;
use std::time::Instant;
fn time(name: &str, per: usize, f: &mut dyn FnMut()) -> f64 {
    let mut best = Vec::new();
    for _ in 0..15 { let t = Instant::now(); for _ in 0..2000 { f(); } best.push(t.elapsed().as_secs_f64()*1e9/2000.0/per as f64); }
    best.sort_by(f64::total_cmp);
    println!("{name:>40} {:8.1} ns a state", best[7]); best[7]
}
fn run(name: &str, arm: Arm, n: usize, scene: &phipsi::Scene, alg: Algorithm) {
    let mut evaluator = Evaluator::on(arm, scene);
    let nv = scene.nv(); let width = scene.width(alg); let n = n.min(evaluator.lanes());
    let mut s = 7u64; let mut draw = || { s = s.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407); (s>>11) as f64/(1u64<<53) as f64*2.0-1.0 };
    let data: Vec<[Vec<f64>;3]> = (0..256).map(|_| { let v: Vec<f64> = (0..nv).map(|_| draw()).collect(); let mut q = scene.neutral(); scene.integrate(&scene.neutral(), &v, &mut q).unwrap(); [q, (0..nv).map(|_| draw()).collect(), (0..nv).map(|_| draw()).collect()]}).collect();
    let (two, one) = match alg { Algorithm::ForwardDynamics(_) | Algorithm::InverseDynamics => (true, true), _ => (false, false) };
    let args: Vec<Arguments> = data.iter().map(|[a,b,c]| Arguments { q: a, qd: if two { b } else { &[] }, u: if one { c } else { &[] }, wrenches: &[] }).collect();
    let mut out = vec![0.0; n*width]; let mut at = 0; let mut doubts = 0;
    time(name, n, &mut || { doubts += black_box(evaluator.run(alg, black_box(&args[at..at+n]), &mut out)).count_ones(); black_box(&mut out); at = (at+n)%256; });
    if doubts > 0 { println!("   {:.3} in doubt", doubts as f64 / (30000.0 * n as f64)); }
}
fn main() {
    let mut scenes = vec![("chain_7".to_string(), phipsi::scenes::chain(7).unwrap())];
    #[cfg(feature = "urdf")]
    for (r, floating) in [("g1", true), ("talos", true)] {
        let path = format!("{}/target/peers/models/{r}.urdf", env!("CARGO_MANIFEST_DIR"));
        if let Ok(b) = phipsi::SceneBuilder::from_urdf_file(&path) { scenes.push((r.into(), b.floating_base(floating).build().unwrap())); }
    }
    for (name, scene) in &scenes {
        println!("{name}"); let nv = scene.nv();
        let (mut w, mut inv, mut m) = (scene.workspace().in_form(Form::Covariance), scene.inverse_scratch(), vec![0.0; nv*nv]);
        let (q, qd, u) = (scene.neutral(), vec![0.3; nv], vec![0.4; nv]);
        let mut qdd = vec![0.0; nv];
        time("plain f64", 1, &mut || { black_box(phipsi::dynamics::forward_dynamics(scene.model(), &mut w, black_box(&q), &qd, &u, &[], &mut qdd)); });
        for (what, alg) in [("fd", Algorithm::ForwardDynamics(Form::Covariance)), ("auto", Algorithm::ForwardDynamics(Form::Auto)), ("root", Algorithm::ForwardDynamics(Form::SquareRoot)), ("id", Algorithm::InverseDynamics), ("M", Algorithm::MassMatrix), ("Minv", Algorithm::MassMatrixInverse(Form::Covariance))] {
            if let Some(only) = std::env::args().nth(1) { if only != "--bench" && only != what { continue; } }
            for (name, arm, n) in [("plain", Arm::Baseline, 1), ("fused", Arm::Avx2, 1), ("avx2", Arm::Avx2, 4), ("avx512", Arm::Avx512, 8)] {
                run(&format!("{what} {n} {name}"), arm, n, scene, alg);
            }
        }
        let _ = (&mut inv, &mut m);
    }
}
