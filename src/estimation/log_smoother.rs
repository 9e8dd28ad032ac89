//! Position, velocity and acceleration from a log of positions: a fixed-interval smoother whose process noise is white
//! jerk.
//!
//! The state x = (q, qd, qdd) moves by x(t + h) = F x + w, F = [[1, h, h^2/2], [0, 1, h], [0, 0, 1]], cov w = s Q(h)
//! with Q = [[h^5/20, h^4/8, h^3/6], ., .] and s the density of the jerk. The estimate is the quintic smoothing spline
//! that minimizes sum (y - q)^2 / variance + int q'''^2 dt / s. Covariances are carried as square roots (Potter's
//! update, a triangularization for the prediction), so that a prior that is wide enough to have no weight costs no
//! precision.

use nalgebra::{Matrix3, Matrix6x3, Vector3};

/// Innovations that the start decides: without a prior of the first position there are two.
const FIRST: usize = 2;

/// A root of Q(h) for h = 1, lower triangular; for other h row i is multiplied by sqrt(h) h^(2 - i).
#[rustfmt::skip] // a matrix
const ROOT: Matrix3<f64> = Matrix3::new(
    0.223_606_797_749_978_97, 0.0, 0.0,
    0.559_016_994_374_947_4, 0.144_337_567_297_406_45, 0.0,
    0.745_355_992_499_929_9, 0.577_350_269_189_625_8, 0.333_333_333_333_333_3,
);

/// One coordinate of a log.
#[derive(Debug, Clone, Copy)]
pub struct Log<'a> {
    /// Times, s, not falling.
    pub time: &'a [f64],
    /// Positions; NaN where none was measured.
    pub position: &'a [f64],
    /// Variances of their noise.
    pub variance: &'a [f64],
    /// Density of the jerk, s.
    pub density: f64,
    /// Standard deviations of position, velocity and acceleration at the start, about the first position and zero.
    pub prior: [f64; 3],
}

/// Sums over the innovations e with variance a, of those after the first two: the start decides these.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Likelihood {
    /// Sum of e^2 / a.
    pub squares: f64,
    /// Sum of log a.
    pub logarithms: f64,
    /// Their number.
    pub count: usize,
}

/// An estimate and a root of its covariance.
#[derive(Clone, Copy)]
struct State {
    mean: Vector3<f64>,
    root: Matrix3<f64>,
}

impl Log<'_> {
    /// The innovations, without smoothing.
    #[must_use]
    pub fn likelihood(&self) -> Likelihood {
        let mut found = Likelihood::default();
        self.filter(|innovation| found.add(innovation), |_, _| {});
        found
    }

    /// Position, velocity and acceleration with their variances, six numbers for each time into `out`.
    ///
    /// The log is smoothed forward and backward, and each half is taken from the run that ends there: where a run
    /// starts, its wide prior costs precision.
    pub fn smooth(&self, out: &mut [[f64; 6]]) -> Likelihood {
        let found = self.smooth_forward(out);
        let [time, position, variance] =
            [self.time, self.position, self.variance].map(|values| values.iter().rev().copied().collect::<Vec<f64>>());
        let time: Vec<f64> = time.iter().map(|time| -time).collect();
        let backward = Log { time: &time, position: &position, variance: &variance, ..*self };
        let mut reversed = vec![[0.0; 6]; out.len()];
        backward.smooth_forward(&mut reversed);
        let half = out.len() / 2;
        for (to, [q, qd, qdd, var_q, var_qd, var_qdd]) in out[..half].iter_mut().zip(reversed.into_iter().rev()) {
            *to = [q, -qd, qdd, var_q, var_qd, var_qdd];
        }
        found
    }

    fn smooth_forward(&self, out: &mut [[f64; 6]]) -> Likelihood {
        let mut states = Vec::with_capacity(self.time.len());
        let mut found = Likelihood::default();
        self.filter(|innovation| found.add(innovation), |predicted, filtered| states.push((predicted, filtered)));
        let mut next: Option<(Vector3<f64>, Matrix3<f64>)> = None;
        for k in (0..states.len()).rev() {
            let (_, State { mean, root }) = states[k];
            let (mean, covariance) = match (&next, states.get(k + 1)) {
                (Some(next), Some((predicted, _))) => {
                    smoothed(&states[k].1, predicted, next, (self.time[k + 1] - self.time[k], self.density))
                }
                _ => (mean, root * root.transpose()),
            };
            if let Some(to) = out.get_mut(k) {
                *to = [mean[0], mean[1], mean[2], covariance[(0, 0)], covariance[(1, 1)], covariance[(2, 2)]];
            }
            next = Some((mean, covariance));
        }
        found
    }

    /// Runs forward; reports each innovation with its variance, and the predicted and the filtered state of each time.
    fn filter(&self, mut innovation: impl FnMut([f64; 2]), mut keep: impl FnMut(State, State)) {
        let first = self.position.iter().copied().find(|position| position.is_finite()).unwrap_or(0.0);
        let mean = Vector3::new(first, 0.0, 0.0);
        let mut state = State { mean, root: Matrix3::from_diagonal(&self.prior.into()) };
        // A first position that was measured is where the motion starts, without any prior.
        let mut is_start = self.position.first().is_some_and(|position| position.is_finite());
        if let (true, Some(variance)) = (is_start, self.variance.first()) {
            state.root[(0, 0)] = variance.sqrt();
        }
        let mut before: Option<f64> = None;
        for ((&time, &position), &variance) in self.time.iter().zip(self.position).zip(self.variance) {
            if let Some(before) = before {
                state = predicted(&state, (time - before, self.density));
            }
            let prediction = state;
            if position.is_finite() && !is_start {
                state.update(position, variance, &mut innovation);
            }
            is_start = false;
            keep(prediction, state);
            before = Some(time);
        }
    }
}

impl Likelihood {
    fn add(&mut self, [innovation, variance]: [f64; 2]) {
        self.count += 1;
        if self.count > FIRST {
            self.squares += innovation * innovation / variance;
            self.logarithms += variance.ln();
        }
    }
}

impl State {
    /// Potter's update by a measurement of the position.
    fn update(&mut self, position: f64, variance: f64, innovation: &mut impl FnMut([f64; 2])) {
        let first = self.root.row(0).transpose();
        let (total, off) = (first.norm_squared() + variance, position - self.mean[0]);
        innovation([off, total]);
        let with_first = self.root * first;
        self.mean += with_first / total * off;
        self.root -= with_first * first.transpose() / (total + (total * variance).sqrt());
    }
}

/// A root of the covariance of the jerk over a step.
fn noise_root((step, density): (f64, f64)) -> Matrix3<f64> {
    let unit = (density * step).sqrt();
    Matrix3::from_diagonal(&Vector3::new(unit * step * step, unit * step, unit)) * ROOT
}

fn transition(step: f64) -> Matrix3<f64> {
    Matrix3::new(1.0, step, 0.5 * step * step, 0.0, 1.0, step, 0.0, 0.0, 1.0)
}

/// One step ahead; the root is lower triangular.
fn predicted(state: &State, (step, density): (f64, f64)) -> State {
    let moved = transition(step);
    let mut columns = Matrix6x3::zeros();
    columns.fixed_rows_mut::<3>(0).copy_from(&(moved * state.root).transpose());
    columns.fixed_rows_mut::<3>(3).copy_from(&noise_root((step, density)).transpose());
    State { mean: moved * state.mean, root: columns.qr().r().transpose() }
}

/// The smoothed state from the filtered one, the prediction from it and the smoothed state of the next time: `P = (1 -
/// G F) P (1 - G F)* + G (s Q + P_next) G*`.
///
/// With the roots S of P and L of the prediction and C = L^-1 F S, which is at most 1, the gain is G = S C* L^-1: its
/// products are formed without G, which would cost the square of the condition of L.
fn smoothed(
    filtered: &State,
    prediction: &State,
    (next_mean, next_covariance): &(Vector3<f64>, Matrix3<f64>),
    (step, density): (f64, f64),
) -> (Vector3<f64>, Matrix3<f64>) {
    let divided = |a: Matrix3<f64>| prediction.root.solve_lower_triangular_unchecked(&a);
    let contraction = divided(transition(step) * filtered.root);
    let back = filtered.root * contraction.transpose();
    let off = next_mean - prediction.mean;
    let mean = filtered.mean + back * prediction.root.solve_lower_triangular_unchecked(&off);
    let kept = filtered.root - back * contraction;
    let noise = back * divided(noise_root((step, density)));
    // `L^-1 P_next L^-*`: `P_next L^-*` is the transpose of `L^-1 P_next`.
    let scaled = divided(divided(*next_covariance).transpose());
    (mean, kept * kept.transpose() + noise * noise.transpose() + back * scaled * back.transpose())
}

#[cfg(test)]
mod tests {
    use super::Log;

    /// A motion without jerk is reproduced, with a gap, and its variances are those of least squares where the density
    /// is small: sigma^2 / k in the mean.
    #[test]
    fn a_parabola_stays() {
        let time: Vec<f64> = (0..50).map(|k| 0.01 * f64::from(k) + 0.002 * f64::from(k % 3)).collect();
        let mut position: Vec<f64> = time.iter().map(|t| 3.0 + 2.0 * t - 5.0 * t * t).collect();
        for missing in &mut position[20..30] {
            *missing = f64::NAN;
        }
        let log =
            Log { time: &time, position: &position, variance: &[1e-4; 50], density: 1e-3, prior: [1e3, 1e4, 1e6] };
        let mut out = [[f64::NAN; 6]; 50];
        let likelihood = log.smooth(&mut out);
        assert_eq!((likelihood.count, log.likelihood()), (39, likelihood));
        for (t, [q, qd, qdd, var_q, var_qd, var_qdd]) in time.iter().zip(out) {
            assert!((q - (3.0 + 2.0 * t - 5.0 * t * t)).abs() <= 1e-8, "{q}");
            assert!((qd - (2.0 - 10.0 * t)).abs() <= 1e-7 && (qdd + 10.0).abs() <= 1e-6, "{qd} {qdd}");
            assert!(var_q > 0.0 && var_q <= 1e-4 && var_qd > 0.0 && var_qdd > 0.0);
        }
    }
}
