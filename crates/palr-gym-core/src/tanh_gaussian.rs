//! The distribution of stochastic policies: a Gaussian squashed by tanh.

use crate::random::Generator;

/// The largest f32 below 1. In f32, tanh rounds to 1 from about 9 on; an action of exactly ±1 has
/// no finite density, so samples stay below.
const LARGEST: f32 = 1.0 - f32::EPSILON / 2.0;

/// Draws `tanh(mean + exp(log_std) * N(0, 1))` into `action` and returns its log density.
///
/// # Shapes
/// All three slices have one entry for each actuator.
///
/// # Source
/// Change of variables with log(1 - tanh(u)²) = 2 (log 2 - u - softplus(-2u)), which keeps its
/// digits where tanh saturates.
pub fn sample(generator: &mut Generator, mean: &[f32], log_std: &[f32], action: &mut [f32]) -> f64 {
    let half_log_tau = 0.5 * std::f64::consts::TAU.ln();
    let mut log_density = 0.0;
    for ((slot, &mean), &log_std) in action.iter_mut().zip(mean).zip(log_std) {
        let (mean, log_std) = (f64::from(mean), f64::from(log_std));
        let noise = generator.standard_normal();
        let u = mean + log_std.exp() * noise;
        *slot = (u.tanh() as f32).clamp(-LARGEST, LARGEST);
        log_density += -0.5 * noise * noise - log_std - half_log_tau - log_slope(u);
    }
    log_density
}

/// log(1 - tanh(u)²).
fn log_slope(u: f64) -> f64 {
    let softplus = |x: f64| x.max(0.0) + (-x.abs()).exp().ln_1p();
    2.0 * (std::f64::consts::LN_2 - u - softplus(-2.0 * u))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn density_integrates_to_one_over_the_actions() {
        // By substitution the integral over a in (-1, 1) is one over u; check the slope itself
        // against the derivative of tanh, and its tail against the known asymptote.
        for u in [-3.0_f64, -0.5, 0.0, 0.7, 2.5] {
            let expected = (1.0 - u.tanh().powi(2)).ln();
            assert!((log_slope(u) - expected).abs() < 1e-12, "{u}");
        }
        // 1 - tanh(u)² -> 4 exp(-2u).
        assert!((log_slope(30.0) - (4.0_f64.ln() - 60.0)).abs() < 1e-12);
    }

    #[test]
    fn no_sample_is_exactly_one_and_moments_are_right() {
        let mut generator = Generator::from_seed(1);
        let mut action = [0.0];
        sample(&mut generator, &[50.0], &[0.0], &mut action);
        assert!(action[0] < 1.0 && action[0] > 0.999_999);
        let us: Vec<f64> = (0..20_000)
            .map(|_| {
                sample(&mut generator, &[0.3], &[-1.0], &mut action);
                f64::from(action[0]).atanh()
            })
            .collect();
        let mean = crate::score::mean(&us);
        assert!((mean - 0.3).abs() < 4.0 * (-1.0_f64).exp() / 20_000_f64.sqrt(), "{mean}");
    }
}
