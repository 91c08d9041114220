//! Normalised scores and what a set of episodes says together.

use crate::random::Generator;
use crate::task::ReferenceReturns;

/// D4RL's normalised score: 0 is a random policy, 100 an expert.
///
/// ```
/// use palr_gym_core::{score::normalized_score, ReferenceReturns};
/// let reference = ReferenceReturns { random: -20.0, expert: 80.0 };
/// assert_eq!(normalized_score(30.0, reference), 50.0);
/// ```
#[must_use]
pub fn normalized_score(episode_return: f64, reference: ReferenceReturns) -> f64 {
    100.0 * (episode_return - reference.random) / (reference.expert - reference.random)
}

/// Arithmetic mean; NaN of nothing.
#[must_use]
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Standard error of the mean, from the sample deviation (n - 1); NaN for fewer than two values.
#[must_use]
pub fn standard_error(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    if values.len() < 2 {
        return f64::NAN;
    }
    let center = mean(values);
    let variance = values.iter().map(|value| (value - center).powi(2)).sum::<f64>() / (n - 1.0);
    (variance / n).sqrt()
}

/// Mean of the middle half: a quarter of the weight is trimmed at each end, values at the edges
/// counting in part when n is not divisible by four. NaN of nothing.
#[must_use]
pub fn interquartile_mean(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    interquartile_mean_of_sorted(&sorted)
}

fn interquartile_mean_of_sorted(sorted: &[f64]) -> f64 {
    let n = sorted.len() as f64;
    let (low, high) = (0.25 * n, 0.75 * n);
    let (sum, weight) = sorted.iter().enumerate().fold((0.0, 0.0), |(sum, weight), (i, value)| {
        let i = i as f64;
        let share = ((i + 1.0).min(high) - i.max(low)).max(0.0);
        (sum + share * value, weight + share)
    });
    sum / weight
}

/// Resamples of the bootstrap.
const RESAMPLES: usize = 2000;

/// 95 % percentile-bootstrap interval of the interquartile mean. The resamples are seeded: equal
/// values give equal intervals.
#[must_use]
pub fn interquartile_mean_interval(values: &[f64]) -> (f64, f64) {
    if values.is_empty() {
        return (f64::NAN, f64::NAN);
    }
    let mut generator = Generator::from_seed(0);
    let mut resample = vec![0.0; values.len()];
    let mut means: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            for slot in &mut resample {
                let index = (generator.next_f64() * values.len() as f64) as usize;
                *slot = values[index];
            }
            resample.sort_by(f64::total_cmp);
            interquartile_mean_of_sorted(&resample)
        })
        .collect();
    means.sort_by(f64::total_cmp);
    let at = |quantile: f64| means[(quantile * (RESAMPLES - 1) as f64).round() as usize];
    (at(0.025), at(0.975))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn standard_error_matches_a_worked_example() {
        // Sample variance of 2, 4, 4, 4, 5, 5, 7, 9 is 32 / 7.
        let got = standard_error(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]);
        assert!((got - (32.0_f64 / 7.0 / 8.0).sqrt()).abs() < 1e-15, "{got}");
        assert!(standard_error(&[1.0]).is_nan());
    }

    #[test]
    fn interquartile_mean_drops_a_quarter_at_each_end() {
        assert_eq!(interquartile_mean(&[100.0, 1.0, 2.0, -50.0]), 1.5);
        // n = 6: 1.5 values go at each end, so the second and the fifth count half.
        let got = interquartile_mean(&[0.0, 1.0, 2.0, 3.0, 4.0, 100.0]);
        assert!((got - (0.5 + 2.0 + 3.0 + 2.0) / 3.0).abs() < 1e-15, "{got}");
        assert_eq!(interquartile_mean(&[7.0]), 7.0);
    }

    #[test]
    fn bootstrap_interval_of_a_normal_sample_is_as_wide_as_theory_says() {
        let mut generator = Generator::from_seed(5);
        let values: Vec<f64> = (0..400).map(|_| generator.standard_normal()).collect();
        let (low, high) = interquartile_mean_interval(&values);
        let center = interquartile_mean(&values);
        assert!(low < center && center < high);
        // The 25 %-trimmed mean of N(0, 1) has asymptotic variance 1.195 / n (from its influence
        // function, integrated numerically).
        let width = 2.0 * 1.96 * (1.195_f64 / 400.0).sqrt();
        assert!(((high - low) / width - 1.0).abs() < 0.15, "{} against {width}", high - low);
    }
}
