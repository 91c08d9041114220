//! Adam, on the flat vector of parameters.

use pulp::{Arch, Simd};

/// Decay of the first moment (torch's default).
const BETA_1: f32 = 0.9;
/// Decay of the second moment (torch's default).
const BETA_2: f32 = 0.999;
/// Added to the root of the second moment (torch's default).
const EPSILON: f32 = 1e-8;

/// The optimiser's state; together with the parameters it decides every later step.
#[derive(Debug, Clone, PartialEq)]
pub struct Adam {
    /// Mean of gradients.
    pub first_moment: Vec<f32>,
    /// Mean of squared gradients.
    pub second_moment: Vec<f32>,
    /// Steps taken.
    pub step: u64,
}

impl Adam {
    /// The state before step 1.
    #[must_use]
    pub fn new(parameter_count: usize) -> Self {
        let zeros = vec![0.0; parameter_count];
        Self { first_moment: zeros.clone(), second_moment: zeros, step: 0 }
    }

    /// One step against `gradient`. All slices have the same length.
    ///
    /// # Source
    /// Kingma and Ba (2015), algorithm 1, with ε outside of the bias correction as in torch.
    pub fn update(&mut self, parameters: &mut [f32], gradient: &[f32], learning_rate: f64) {
        self.step += 1;
        let correction = |beta: f32| 1.0 - f64::from(beta).powf(self.step as f64);
        let rate = (learning_rate / correction(BETA_1)) as f32;
        let root = (1.0 / correction(BETA_2).sqrt()) as f32;
        let moments = [&mut self.first_moment[..], &mut self.second_moment[..]];
        descend(parameters, gradient, moments, rate, root);
    }
}

/// Wider vectors change no bit: each number is computed as before.
#[pulp::with_simd(descend = Arch::new())]
#[inline(always)]
fn descend_with_simd<'a, S: Simd>(
    _simd: S,
    parameters: &'a mut [f32],
    gradient: &'a [f32],
    moments: [&'a mut [f32]; 2],
    rate: f32,
    root: f32,
) {
    let [first, second] = moments;
    let moments = first.iter_mut().zip(second);
    for ((parameter, gradient), (first, second)) in parameters.iter_mut().zip(gradient).zip(moments)
    {
        *first = BETA_1 * *first + (1.0 - BETA_1) * gradient;
        *second = BETA_2 * *second + (1.0 - BETA_2) * gradient * gradient;
        *parameter -= rate * *first / (second.sqrt() * root + EPSILON);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_those_of_the_published_algorithm_in_double_precision() {
        let gradient = |parameter: f64, t: f64| parameter * 3.0 + (t * 1.7).sin() * 1e-2;
        let mut parameters = [0.5_f32, -2.0];
        let mut adam = Adam::new(2);
        let mut exact = [(0.5_f64, 0.0, 0.0), (-2.0, 0.0, 0.0)];
        for t in 1..=200 {
            let t = f64::from(t);
            let gradients = parameters.map(|p| gradient(f64::from(p), t) as f32);
            adam.update(&mut parameters, &gradients, 3e-3);
            for (p, m, v) in &mut exact {
                let g = gradient(*p, t);
                *m = 0.9 * *m + 0.1 * g;
                *v = 0.999 * *v + 0.001 * g * g;
                let m_hat = *m / (1.0 - 0.9_f64.powf(t));
                let v_hat = *v / (1.0 - 0.999_f64.powf(t));
                *p -= 3e-3 * m_hat / (v_hat.sqrt() + 1e-8);
            }
            for (got, (want, ..)) in parameters.iter().zip(exact) {
                assert!((f64::from(*got) - want).abs() < 2e-6, "{t}: {got} {want}");
            }
        }
        assert_eq!(adam.step, 200);
    }
}
