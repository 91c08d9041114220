//! Pushes on the actuators while an expert trains, to teach a gait that bears an imitator's errors.
//!
//! The environments get the action and a push; the replay keeps the action, so to the agent the pushes
//! are part of the environment, as in domain randomisation. An imitator errs in one direction for a
//! while, and so do they: each joint's push is a first-order autoregressive process.

use palr_gym_core::random::Generator;

use crate::expert::settings::ExpertSettings;
use crate::learning::noise::Normals;

/// The pushes of all environments.
#[derive(Debug, Clone)]
pub struct Perturbation {
    std: f32,
    /// Correlation of two pushes in a row.
    memory: f32,
    /// `[num_envs, action size]`.
    pushes: Vec<f32>,
}

impl Perturbation {
    /// Pushes as `settings` want them, the first ones 0; none if they have no deviation.
    #[must_use]
    pub fn new(settings: &ExpertSettings, action_size: usize) -> Option<Self> {
        let ExpertSettings { perturbation: std, perturbation_duration, num_envs, .. } = *settings;
        let memory = (1.0 - 1.0 / perturbation_duration) as f32;
        let pushes = vec![0.0; num_envs * action_size];
        (std > 0.0).then_some(Self { std: std as f32, memory, pushes })
    }

    /// The next pushes, x' = m x + √(1 - m²) std n with m = 1 - 1/duration and standard normal n.
    pub fn next(&mut self, generator: &mut Generator) -> &[f32] {
        let fresh = self.std * (1.0 - self.memory * self.memory).sqrt();
        let normals = Normals::new(generator).draw(self.pushes.len(), 1.0);
        for (push, normal) in self.pushes.iter_mut().zip(normals) {
            *push = self.memory * *push + fresh * normal;
        }
        &self.pushes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learning::streams::{Purpose, stream};

    #[test]
    fn pushes_have_the_deviation_and_the_memory_that_were_asked_for() {
        let count = 4_000;
        let settings = ExpertSettings {
            perturbation: 0.3,
            perturbation_duration: 5.0,
            num_envs: 500,
            ..ExpertSettings::default()
        };
        let mut perturbation = Perturbation::new(&settings, 8).expect("a deviation");
        let mut rounds = Vec::new();
        for round in 0..40 {
            let mut generator = stream(3, Purpose::Perturbation, round);
            rounds.push(perturbation.next(&mut generator).to_vec());
        }
        let mean = |values: &mut dyn Iterator<Item = f32>| values.sum::<f32>() / count as f32;
        let [.., before, last] = rounds.as_slice() else { panic!("two rounds") };
        let variance = mean(&mut last.iter().map(|push| push * push));
        let product = mean(&mut last.iter().zip(before).map(|(now, then)| now * then));
        // Five standard errors.
        assert!((variance / 0.09 - 1.0).abs() < 5.0 * (2.0 / count as f32).sqrt(), "{variance}");
        assert!((product / 0.09 - 0.8).abs() < 5.0 * (1.64 / count as f32).sqrt(), "{product}");
        assert!(mean(&mut last.iter().copied()).abs() < 5.0 * 0.3 / (count as f32).sqrt());
        assert!(Perturbation::new(&ExpertSettings::default(), 8).is_none());
    }
}
