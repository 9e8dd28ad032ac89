//! M^-1 in form `auto` for the same scenes: if the sweeps of batches and of calls from Python accept the
//! covariance form, its precision is sufficient.

use super::families::{Case, FAMILIES, case};
use super::{double, error, from_environment, sensitivity_of};
use crate::common::tolerance;
use phipsi::Workspace;
use phipsi::dynamics;
use phipsi::dynamics::InverseScratch;
use phipsi::filter::Form;
use phipsi::scalar::{DoubleDouble, Real};
use phipsi::scene::Model;
use phipsi::{Algorithm, Arguments};

/// The square-root form in double-double arithmetic; none if a pivot is singular even there.
fn reference(case: &Case) -> Option<Vec<DoubleDouble>> {
    let model: Model<DoubleDouble> = case.scene.model().cast();
    let mut out = double(&vec![f64::NAN; model.nv() * model.nv()]);
    let (mut workspace, mut scratch) = (Workspace::new(&model).in_form(Form::SquareRoot), InverseScratch::new(&model));
    let pivots = dynamics::mass_matrix_inverse(&model, &mut workspace, &mut scratch, &double(&case.q), &mut out);
    (pivots.clear(0) && out.iter().all(|x| x.lane(0).is_finite())).then_some(out)
}

#[derive(Default, Clone)]
struct Row {
    scenes: usize,
    kept: usize,
    /// Errors of accepted cases, and of the covariance form in all cases.
    worst: [f64; 2],
}

#[test]
fn the_inverse_that_is_kept_in_covariance_form_has_its_digits() {
    let (first, count) = (from_environment("PHIPSI_AUTO_FIRST", 0), from_environment("PHIPSI_AUTO_SCENES", 440));
    let (mut rows, mut failures) = (vec![Row::default(); FAMILIES.len()], Vec::new());
    for number in first..first + count {
        let case = case(number);
        let Some(expected) = reference(&case) else { continue };
        let row = &mut rows[number % FAMILIES.len()];
        let state = [Arguments { q: &case.q, ..Arguments::default() }];
        let mut evaluator = case.scene.evaluator();
        let mut inverse = |form| {
            let mut out = vec![f64::NAN; expected.len()];
            (evaluator.run(Algorithm::MassMatrixInverse(form), &state, &mut out) == 0, out)
        };
        let ((kept, found), (_, alone)) = (inverse(Form::Auto), inverse(Form::Covariance));
        let [found, alone] = [found, alone].map(|out| error(&double(&out), &expected));
        row.scenes += 1;
        row.worst[1] = row.worst[1].max(alone);
        if !kept {
            continue;
        }
        row.kept += 1;
        row.worst[0] = row.worst[0].max(found);
        if found <= tolerance::KEPT {
            continue;
        }
        let sensitivity = sensitivity_of(&case, &expected, reference);
        if !(found <= tolerance::kept(sensitivity)) {
            failures.push(format!(
                "scene {number}, {}: {found:.1e}, sensitivity {sensitivity:.1e}",
                FAMILIES[number % FAMILIES.len()]
            ));
        }
    }
    println!("| family | scenes | kept | worst of those | covariance form |\n|---|---|---|---|---|");
    for (name, Row { scenes, kept, worst: [of_kept, of_all] }) in FAMILIES.iter().zip(&rows) {
        println!("| {name} | {scenes} | {kept} | {of_kept:.0e} | {of_all:.0e} |");
    }
    assert!(failures.is_empty(), "{} missed of {count}:\n{}", failures.len(), failures.join("\n"));
    let of = |family: &str| &rows[FAMILIES.iter().position(|&name| name == family).expect("a family")];
    let chains = of("equal chains");
    assert!(chains.kept * 10 >= chains.scenes * 9, "{} of {} kept", chains.kept, chains.scenes);
    let heavy = of("heavy tip");
    assert!(heavy.kept < heavy.scenes && heavy.worst[1] > 1e-6, "{} of {} kept", heavy.kept, heavy.scenes);
}
