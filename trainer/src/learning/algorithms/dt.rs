//! DT, the decision transformer, imitating: a causal transformer over the window of observations,
//! with a return of 0 before each.
//!
//! # Source
//! Chen et al. (2021) and their public code: GPT-2 with three layers, one head, width 128, an inner
//! width of 512 with ReLU, layer norms before and after, weights from N(0, 0.02²); AdamW with warm-up,
//! decay 1e-4 and gradients clipped to a norm of 0.25. The PALR paper (section D.4) feeds a return of 0
//! and states nothing else.
//!
//! What differs, because a policy here is a function of the stacked observation alone and is compared
//! with others that are: tokens of past actions are left out; positions count within the window, not
//! within the episode; observations before the episode are zeros, as for every method, and not masked;
//! the last token predicts, with the same tanh-Gaussian likelihood as everywhere; there is no dropout.

use burn::tensor::activation::{relu, softmax};
use burn::tensor::{Device, Tensor, TensorData};

use crate::learning::algorithms::{Method, StepReport, state};
use crate::learning::architecture::{Architecture, Kind};
use crate::learning::config::TrainConfig;
use crate::learning::context::Context;
use crate::learning::error::TrainError;
use crate::learning::likelihood;
use crate::learning::network::{Initialization, LayerShape, Layers, Network};
use crate::learning::policy_net::{LOG_STD_RANGE, POLICY, PolicyTensors};
use crate::learning::state::State;

/// Width of a token, and of the representation.
pub const WIDTH: usize = 128;
const INNER_WIDTH: usize = 512;
/// Of layer norms.
pub(crate) const EPSILON: f64 = 1e-5;
/// Added to attention where a token must not look.
pub(crate) const HIDDEN: f32 = -1e9;
/// Keeps clipping finite (torch's constant).
const CLIP_EPSILON: f64 = 1e-6;

/// Places in [`layers`].
pub(crate) const RETURN: usize = 0;
pub(crate) const STATE: usize = 1;
pub(crate) const POSITION: usize = 2;
pub(crate) const NORM_IN: usize = 3;
/// The first of a block's six.
pub(crate) const FIRST_BLOCK: usize = 4;

/// Names of a block's layers: norm, queries with keys and values, their output; norm, inner, outer.
const BLOCKS: [[&str; 6]; 3] = [
    ["norm_1a", "attention_1", "projection_1", "norm_1b", "inner_1", "outer_1"],
    ["norm_2a", "attention_2", "projection_2", "norm_2b", "inner_2", "outer_2"],
    ["norm_3a", "attention_3", "projection_3", "norm_3b", "inner_3", "outer_3"],
];
/// Layers of the transformer.
pub(crate) const DEPTH: usize = BLOCKS.len();

/// The method.
pub struct Dt<'a> {
    context: Context<'a>,
}

impl<'a> Dt<'a> {
    /// For a run of `context`.
    #[must_use]
    pub fn new(context: Context<'a>) -> Self {
        Self { context }
    }
}

/// The layers. A norm is a layer with one input: its weight is the gain.
#[must_use]
pub fn layers(frame_size: usize, frame_stack: usize, action_size: usize) -> Vec<LayerShape> {
    let mut layers = vec![
        LayerShape::new("return", 1, WIDTH),
        LayerShape::new("state", frame_size, WIDTH),
        LayerShape::new("position", frame_stack, WIDTH).without_bias(),
        LayerShape::new("norm_in", 1, WIDTH),
    ];
    for [norm_a, attention, projection, norm_b, inner, outer] in BLOCKS {
        layers.extend([
            LayerShape::new(norm_a, 1, WIDTH),
            LayerShape::new(attention, WIDTH, 3 * WIDTH),
            LayerShape::new(projection, WIDTH, WIDTH),
            LayerShape::new(norm_b, 1, WIDTH),
            LayerShape::new(inner, WIDTH, INNER_WIDTH),
            LayerShape::new(outer, INNER_WIDTH, WIDTH),
        ]);
    }
    layers.extend([
        LayerShape::new("norm_out", 1, WIDTH),
        LayerShape::new("mean", WIDTH, action_size),
        LayerShape::new("log_std", WIDTH, action_size),
    ]);
    layers
}

/// The network before step 1.
#[must_use]
pub fn network(architecture: Architecture, seed: u64) -> Network {
    let Architecture { frame_size, action_size, .. } = architecture;
    let layers = layers(frame_size, architecture.frame_stack(), action_size);
    Network::new(POLICY, layers, Initialization::Transformer, seed, 0)
}

/// The policy on `[n, frame_stack · frame_size]`, standardised. Its representation, `[n, 128]`, is the
/// last hidden state of the newest observation's token.
#[must_use]
pub fn forward(layers: &Layers, observations: Tensor<2>, frame_stack: usize) -> PolicyTensors {
    let [n, columns] = observations.dims();
    let tokens = 2 * frame_stack;
    let device = observations.device();
    let states = observations.reshape([n * frame_stack, columns / frame_stack]);
    let states = layers.linear(STATE, states);
    // Returns are 0: what is left of their token is the bias.
    let returns = layers.bias(RETURN).expand([n * frame_stack, WIDTH]);
    let x = Tensor::cat(vec![returns, states], 1).reshape([n, tokens, WIDTH]);
    let position = layers.weight(POSITION);
    let positions = Tensor::cat(vec![position.clone(), position], 1).reshape([1, tokens, WIDTH]);
    let mut x = norm(layers, NORM_IN, (x + positions).reshape([n * tokens, WIDTH]));
    let mask = mask(tokens, &device);
    for block in 0..DEPTH {
        let at = FIRST_BLOCK + 6 * block;
        let all = layers.linear(at + 1, norm(layers, at, x.clone()));
        let part = |i| all.clone().narrow(1, i * WIDTH, WIDTH).reshape([n, tokens, WIDTH]);
        let scores: Tensor<3> = part(0).matmul(part(1).swap_dims(1, 2));
        let scores = scores.div_scalar((WIDTH as f64).sqrt()) + mask.clone();
        let seen = softmax(scores, 2).matmul(part(2)).reshape([n * tokens, WIDTH]);
        x = x + layers.linear(at + 2, seen);
        let inner = relu(layers.linear(at + 4, norm(layers, at + 3, x.clone())));
        x = x + layers.linear(at + 5, inner);
    }
    let at = FIRST_BLOCK + 6 * DEPTH;
    let last = x.reshape([n, tokens, WIDTH]).narrow(1, tokens - 1, 1).reshape([n, WIDTH]);
    let representation = norm(layers, at, last);
    let [low, high] = LOG_STD_RANGE;
    PolicyTensors {
        mean: layers.linear(at + 1, representation.clone()),
        log_std: layers.linear(at + 2, representation.clone()).clamp(low, high),
        representation,
    }
}

/// Layer norm of each row.
fn norm(layers: &Layers, at: usize, x: Tensor<2>) -> Tensor<2> {
    let centered = x.clone() - x.mean_dim(1);
    let variance = (centered.clone() * centered.clone()).mean_dim(1);
    centered / variance.add_scalar(EPSILON).sqrt() * layers.weight(at) + layers.bias(at)
}

/// What is added to attention, `[tokens, tokens]`: a token sees itself and those before it.
pub(crate) fn mask_values(tokens: usize) -> Vec<f32> {
    let hidden = |i: usize| if i % tokens > i / tokens { HIDDEN } else { 0.0 };
    (0..tokens * tokens).map(hidden).collect()
}

fn mask(tokens: usize, device: &Device) -> Tensor<3> {
    let data = TensorData::new(mask_values(tokens), [1, tokens, tokens]);
    Tensor::from_data(data, &device.clone().inner())
}

/// A step of AdamW: warm-up, clipped gradients, decay of every parameter.
///
/// # Errors
/// [`TrainError::Diverged`].
pub fn descend(
    network: &mut Network,
    mut gradient: Vec<f32>,
    config: &TrainConfig,
    step: u64,
) -> Result<(), TrainError> {
    let dt = &config.dt;
    let squares: f64 = gradient.iter().map(|&entry| f64::from(entry).powi(2)).sum();
    let scale = dt.clip_norm / (squares.sqrt() + CLIP_EPSILON);
    if scale < 1.0 {
        gradient.iter_mut().for_each(|entry| *entry *= scale as f32);
    }
    let warm = (step as f64 / dt.warmup_steps as f64).min(1.0);
    let rate = config.learning_rate * warm;
    let kept = (1.0 - rate * dt.weight_decay) as f32;
    network.parameters.iter_mut().for_each(|parameter| *parameter *= kept);
    network.descend(&gradient, rate, step)
}

impl Method for Dt<'_> {
    fn start(&self) -> State {
        state(vec![network(self.architecture(), self.context.config.seed)])
    }

    fn step(&mut self, state: &mut State) -> Result<Option<StepReport>, TrainError> {
        let Context { config, device, constants, .. } = &self.context;
        let step = state.step + 1;
        let batch = self.context.batch(state.step).tensors(constants);
        let network = &mut state.networks[0];
        let layers = network.tensors(device)?;
        let frame_stack = self.architecture().frame_stack();
        let output = forward(&layers, batch.observations.clone(), frame_stack);
        let (loss, nll) = likelihood::of_batch(&output, &batch)?;
        let report = StepReport::new(nll);
        report.check(step)?;
        descend(network, layers.gradient(&mut loss.backward())?, config, step)?;
        Ok(Some(report))
    }

    fn architecture(&self) -> Architecture {
        self.context.architecture(Kind::Transformer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learning::network::{tensor, values};

    #[test]
    fn a_token_sees_no_later_one_and_every_frame_counts() {
        let tokens = mask_values(3);
        assert_eq!(tokens.iter().filter(|&&entry| entry == HIDDEN).count(), 3);
        assert_eq!((tokens[1], tokens[3], tokens[8]), (HIDDEN, 0.0, 0.0));

        let architecture = Architecture {
            observation_size: 6,
            frame_size: 2,
            action_size: 1,
            kind: Kind::Transformer,
        };
        let device = Device::flex();
        let layers = network(architecture, 3).tensors(&device).unwrap();
        let mean = |observation: [f32; 6]| {
            let output = forward(&layers, tensor(observation.to_vec(), 6, &device), 3);
            assert_eq!(output.representation.dims(), [1, WIDTH]);
            values(output.mean).unwrap()[0]
        };
        let base = mean([0.1, -0.2, 0.3, 0.4, -0.5, 0.6]);
        for changed in 0..6 {
            let mut observation = [0.1, -0.2, 0.3, 0.4, -0.5, 0.6];
            observation[changed] += 1.0;
            assert!((mean(observation) - base).abs() > 1e-5, "{changed}");
        }
    }
}
