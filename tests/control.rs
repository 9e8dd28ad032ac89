//! Optimal control from Rust: a minimum, no allocation per iteration, and errors by name.

use phipsi::control::{Cost, Optimizer, Outcome, Problem, Start, Term};
use phipsi::{Error, Scene};

const STEPS: usize = 20;

fn problem(scene: &Scene) -> Problem {
    let nv = scene.nv();
    let effort = Term::Effort { tau: vec![0.0; nv], by_tau: vec![0.5; nv] };
    let goal = Term::State { q: vec![0.5; nv], qd: vec![0.0; nv], by_q: vec![5.0; nv], by_qd: vec![0.5; nv] };
    let costs = vec![
        Cost { term: effort, first: 0, last: STEPS - 1, is_limit: false },
        Cost { term: goal, first: STEPS, last: STEPS, is_limit: false },
    ];
    let mut problem = Problem::new(scene, 0.02, STEPS);
    problem.costs = costs;
    problem.tolerance = 1e-300;
    problem
}

fn solve(optimizer: &mut Optimizer, iterations: usize) -> Outcome {
    optimizer.set_iterations(iterations);
    let (still, tau) = ([0.0; 3], [0.0; 3 * STEPS]);
    optimizer.solve(&Start { q: &still, qd: &still, tau: &tau, states: None }).unwrap()
}

#[test]
fn the_cost_decreases_to_a_minimum() {
    let scene = phipsi::scenes::chain(3).unwrap();
    let mut optimizer = Optimizer::new(&scene, problem(&scene)).unwrap();
    let outcome = solve(&mut optimizer, 50);
    assert!(outcome.converged, "{outcome:?}");
    assert!(outcome.history.windows(2).all(|two| two[1].cost <= two[0].cost), "{outcome:?}");
    let end = &optimizer.motion().q[3 * STEPS..];
    assert!(end.iter().all(|q| (q - 0.5).abs() < 0.4), "{end:?}");
    let (gains, driven) = optimizer.gains();
    assert_eq!((gains.len(), driven), (STEPS * 3 * 6, &[0, 1, 2][..]));
    assert!(gains.iter().all(|gain| gain.is_finite()));
}

#[test]
fn iterations_do_not_allocate() {
    let scene = phipsi::scenes::chain(3).unwrap();
    let mut optimizer = Optimizer::new(&scene, problem(&scene)).unwrap();
    let first = solve(&mut optimizer, 4);
    let [one, more] = [1, 3].map(|iterations| {
        let mut outcome = None;
        let counted = allocation_counter::measure(|| outcome = Some(solve(&mut optimizer, iterations)));
        let history = outcome.map(|outcome: Outcome| outcome.history).unwrap_or_default();
        // The array form allocates.
        assert!(history.len() == iterations && history.iter().all(|each| each.array_stages == 0), "{history:?}");
        counted.count_total
    });
    assert_eq!(one, more);
    assert!(one <= 8, "{one} allocations of a search");
    assert_eq!(solve(&mut optimizer, 4), first);
}

#[test]
fn errors_name_the_argument() {
    let scene = phipsi::scenes::chain(3).unwrap();
    let found = |change: &dyn Fn(&mut Problem)| {
        let mut problem = problem(&scene);
        change(&mut problem);
        Optimizer::new(&scene, problem).unwrap_err().to_string()
    };
    assert!(found(&|problem| problem.dt = -1.0).contains("dt"));
    assert!(found(&|problem| problem.steps = 0).contains("steps"));
    assert!(found(&|problem| problem.costs[0].last = 99).contains("costs[0]"));
    assert!(found(&|problem| problem.effort[0] = vec![1.0; 2]).contains("effort"));
    assert!(found(&|problem| problem.effort = [vec![1.0; 3], vec![-1.0; 3]]).contains("effort"));
    let mut optimizer = Optimizer::new(&scene, problem(&scene)).unwrap();
    let short = optimizer.solve(&Start { q: &[0.0; 2], qd: &[0.0; 3], ..Start::default() });
    assert!(matches!(short, Err(Error::Shape { .. })), "{short:?}");
}
