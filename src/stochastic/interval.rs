//! Confidence intervals for the entries of a covariance estimated from normal samples of known mean.

use crate::error::Error;
use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};

/// The constants of the interval at one level of confidence and one number of samples: n over the two quantiles of chi
/// squared.
///
/// For samples x and y of two torques scaled to unit variance, (x + y)^2 and (x - y)^2 are independent. Each is a
/// variance times chi squared with one degree of freedom, and x y is a quarter of their difference. Each of the two
/// variances has an exact interval; the interval of the difference follows by the method of variance estimates
/// recovery. On the diagonal the second variance is zero, and the interval is the exact one of chi squared.
#[derive(Debug, Clone, Copy)]
pub struct Quantiles {
    /// n / upper quantile, below one.
    low: f64,
    /// n / lower quantile, above one.
    high: f64,
}

impl Quantiles {
    /// Quantiles for `samples` samples and a confidence between 0 and 1.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for a confidence out of range, or zero samples.
    pub fn new(samples: usize, confidence: f64) -> Result<Self, Error> {
        check_confidence(confidence)?;
        #[allow(clippy::cast_precision_loss)] // a count
        let n = samples as f64;
        let chi_squared =
            ChiSquared::new(n).map_err(|_| Error::argument("samples", samples.to_string(), "at least one"))?;
        let tail = (1.0 - confidence) / 2.0;
        Ok(Self { low: n / chi_squared.inverse_cdf(1.0 - tail), high: n / chi_squared.inverse_cdf(tail) })
    }

    /// (low, high) for a covariance, from the estimates of the two variances and of the covariance.
    #[must_use]
    pub fn interval(&self, (variance, other): (f64, f64), covariance: f64) -> (f64, f64) {
        let unit = (variance * other).sqrt();
        if unit == 0.0 {
            return (covariance, covariance);
        }
        let rho = covariance / unit;
        let (sum, difference) = (1.0 + rho, 1.0 - rho);
        let below = |x: f64| x * (1.0 - self.low);
        let above = |x: f64| x * (self.high - 1.0);
        let half = 0.5 * unit;
        (
            covariance - half * below(sum).hypot(above(difference)),
            covariance + half * above(sum).hypot(below(difference)),
        )
    }
}

/// Student's quantile for the mean of `replicates` independent estimates.
pub(super) fn students_quantile(replicates: usize, confidence: f64) -> Result<f64, Error> {
    check_confidence(confidence)?;
    #[allow(clippy::cast_precision_loss)] // a count
    let freedom = replicates as f64 - 1.0;
    let student = StudentsT::new(0.0, 1.0, freedom)
        .map_err(|_| Error::argument("replicates", replicates.to_string(), "at least 2"))?;
    Ok(student.inverse_cdf(0.5 + confidence / 2.0))
}

fn check_confidence(confidence: f64) -> Result<(), Error> {
    if confidence > 0.0 && confidence < 1.0 {
        return Ok(());
    }
    Err(Error::argument("confidence", confidence.to_string(), "a number between 0 and 1, such as 0.95"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn on_the_diagonal_it_is_that_of_chi_squared() -> Result<(), Error> {
        // 95 % of chi squared with 10 degrees of freedom lies between 3.2470 and 20.4832 (tables).
        let (low, high) = Quantiles::new(10, 0.95)?.interval((3.0, 3.0), 3.0);
        assert!((low - 30.0 / 20.4832).abs() <= 1e-4 && (high - 30.0 / 3.2470).abs() <= 1e-3, "{low} {high}");
        Ok(())
    }

    #[test]
    fn many_samples_give_the_normal_interval() -> Result<(), Error> {
        let n = 1_000_000;
        let (low, high) = Quantiles::new(n, 0.95)?.interval((2.0, 3.0), -1.0);
        let expected = 1.959_964 * ((2.0 * 3.0 + 1.0) / 1e6_f64).sqrt();
        assert!(((high - low) / 2.0 / expected - 1.0).abs() <= 1e-4, "{low} {high}");
        Ok(())
    }

    #[test]
    fn bad_confidences_are_refused() {
        for confidence in [0.0, 1.0, -0.5, f64::NAN] {
            assert!(matches!(Quantiles::new(10, confidence), Err(Error::Argument { .. })));
            assert!(students_quantile(8, confidence).is_err());
        }
        assert!(Quantiles::new(0, 0.95).is_err());
        assert!(students_quantile(1, 0.95).is_err());
    }
}
