//! The actor: a Gaussian whose mean and deviation a network gives, squashed by tanh.

use crate::expert::mlp::{self, Tape, Wanted};
use crate::learning::network::LayerShape;
use crate::learning::policy_net::LOG_STD_RANGE;

/// The actor's layers: two hidden ones, and a head that gives the means, then the logarithms of the
/// deviations.
#[must_use]
pub fn layers(observation_size: usize, hidden: usize, action_size: usize) -> Vec<LayerShape> {
    vec![
        LayerShape::new("hidden_1", observation_size, hidden),
        LayerShape::new("hidden_2", hidden, hidden),
        LayerShape::new("head", hidden, 2 * action_size),
    ]
}

/// Actions that were drawn, and what their gradients need.
#[derive(Debug, Clone, Default)]
pub struct Drawn {
    tape: Tape,
    action_size: usize,
    /// `[n, action size]`, in (-1, 1) up to rounding.
    pub actions: Vec<f32>,
    /// Log density of each row of actions, `[n]`.
    pub log_density: Vec<f32>,
    /// Standard deviation times noise, `[n, action size]`.
    spread: Vec<f32>,
}

impl Drawn {
    /// Draws tanh(mean + exp(log_std) · `noise`) for each row of `observations`; `noise` is
    /// `[n, action size]`.
    ///
    /// # Source
    /// Haarnoja et al. (2018), appendix C; log(1 - tanh(u)²) = 2 (log 2 - u - softplus(-2u)).
    pub fn draw(
        &mut self,
        layers: &[LayerShape],
        parameters: &[f32],
        observations: &[f32],
        noise: &[f32],
        n: usize,
    ) {
        mlp::forward(layers, parameters, observations, n, &mut self.tape);
        let action_size = noise.len() / n;
        self.action_size = action_size;
        self.actions.resize(n * action_size, 0.0);
        self.spread.resize(n * action_size, 0.0);
        self.log_density.clear();
        let half_log_tau = 0.5 * std::f32::consts::TAU.ln();
        for (row, head) in self.tape.output().chunks_exact(2 * action_size).enumerate() {
            let (means, log_stds) = head.split_at(action_size);
            let mut log_density = 0.0;
            for column in 0..action_size {
                let at = row * action_size + column;
                let log_std = clamped(log_stds[column]);
                let spread = log_std.exp() * noise[at];
                let u = means[column] + spread;
                self.spread[at] = spread;
                self.actions[at] = u.tanh();
                let log_slope = 2.0 * (std::f32::consts::LN_2 - u - softplus(-2.0 * u));
                log_density -= 0.5 * noise[at] * noise[at] + log_std + half_log_tau + log_slope;
            }
            self.log_density.push(log_density);
        }
    }

    /// The gradient of mean(α log π - value) by the actor's parameters, where `value_gradient`,
    /// `[n, action size]`, is that of mean(value) by the actions.
    pub fn gradient(
        &mut self,
        layers: &[LayerShape],
        parameters: &[f32],
        observations: &[f32],
        temperature: f32,
        value_gradient: &[f32],
        flat: &mut [f32],
    ) {
        let action_size = self.action_size;
        let n = self.log_density.len();
        let share = temperature / n as f32;
        let mut head_gradient = vec![0.0; n * 2 * action_size];
        let heads = self.tape.output().chunks_exact(2 * action_size);
        for (row, (head, out)) in
            heads.zip(head_gradient.chunks_exact_mut(2 * action_size)).enumerate()
        {
            for column in 0..action_size {
                let at = row * action_size + column;
                let action = self.actions[at];
                // d log π / d u = 2 tanh(u).
                let gradient = share * 2.0 * action - value_gradient[at] * (1.0 - action * action);
                out[column] = gradient;
                let log_std = head[action_size + column];
                out[action_size + column] = if clamped(log_std) == log_std {
                    gradient * self.spread[at] - share
                } else {
                    0.0
                };
            }
        }
        let wanted = Wanted::Parameters(flat);
        mlp::backward(layers, parameters, observations, &mut self.tape, &head_gradient, wanted);
    }
}

fn clamped(log_std: f32) -> f32 {
    let [low, high] = LOG_STD_RANGE;
    log_std.clamp(low as f32, high as f32)
}

fn softplus(x: f32) -> f32 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}
