//! KF, keyframe-focused imitation: the likelihood, weighted by how badly past actions predict the
//! action.
//!
//! # Source
//! Wen et al. (2021). The paper of PALR says that keyframes are *highly* predictable actions; the
//! method's own paper and code weigh the badly predictable ones up, and so does this.

use burn::tensor::Tensor;

use crate::learning::algorithms::{Method, StepReport, state};
use crate::learning::architecture::{Architecture, Kind};
use crate::learning::config::{KfConfig, KfSchedule, KfTemperature, KfWeighting};
use crate::learning::context::Context;
use crate::learning::error::TrainError;
use crate::learning::likelihood;
use crate::learning::network::{Initialization, LayerShape, Layers, Network, tensor, values};
use crate::learning::policy_net::PolicyNet;
use crate::learning::state::State;
use crate::learning::streams::Purpose;

/// Name of the action predictor's network.
pub const PREDICTOR: &str = "predictor";

/// The method.
pub struct Kf<'a> {
    context: Context<'a>,
    /// Of two stages, once the first is over: the error of each row, and the keyframes' threshold.
    fixed: Option<(Vec<f32>, f32)>,
}

impl<'a> Kf<'a> {
    /// For a run of `context`.
    #[must_use]
    pub fn new(context: Context<'a>) -> Self {
        Self { context, fixed: None }
    }

    /// What the predictor sees of the rows.
    fn history(&self, rows: &[usize]) -> Result<Tensor<2>, TrainError> {
        let Context { config, data, constants, .. } = &self.context;
        let count = config.kf.past_actions;
        Ok(tensor(data.action_history(rows, count)?, count * data.action_size(), constants))
    }

    /// An update of the predictor of the rows' `actions`; returns the errors before it.
    fn update_predictor(
        &self,
        network: &mut Network,
        rows: &[usize],
        actions: Tensor<2>,
        step: u64,
    ) -> Result<Vec<f32>, TrainError> {
        let Context { config, data, device, .. } = &self.context;
        let size = data.action_size();
        let predictor = network.tensors(device)?;
        let difference = predictor.leaky_forward(self.history(rows)?) - actions;
        let errors = values(difference.clone().inner())?;
        let loss = (difference.clone() * difference).mean();
        let gradient = predictor.gradient(&mut loss.backward())?;
        network.descend(&gradient, config.kf.learning_rate, step)?;
        Ok(mean_squares(&errors, size))
    }

    /// The error of every row of the data, and the threshold of keyframes among them.
    fn all_errors(&self, network: &Network) -> Result<(Vec<f32>, f32), TrainError> {
        const PIECE: usize = 4096;
        let Context { config, data, constants, .. } = &self.context;
        let size = data.action_size();
        let predictor: Layers = network.tensors(constants)?;
        let rows: Vec<usize> = (0..data.len()).collect();
        let mut errors = Vec::with_capacity(rows.len());
        for rows in rows.chunks(PIECE) {
            let predicted = values(predictor.leaky_forward(self.history(rows)?))?;
            let actions = data.batch(rows).actions;
            let differences: Vec<f32> =
                predicted.iter().zip(&actions).map(|(p, a)| p - a).collect();
            errors.extend(mean_squares(&differences, size));
        }
        let threshold = threshold(&errors, config.kf.step_share);
        Ok((errors, threshold))
    }
}

/// Mean over each row's entries of their squares.
fn mean_squares(differences: &[f32], size: usize) -> Vec<f32> {
    let rows = differences.chunks_exact(size);
    rows.map(|row| row.iter().map(|x| x * x).sum::<f32>() / size as f32).collect()
}

/// The error that is exceeded by a share of about `share` of all, at least by none.
fn threshold(errors: &[f32], share: f64) -> f32 {
    let mut sorted = errors.to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    let rank = ((sorted.len() as f64 * share) as usize).min(sorted.len() - 1);
    sorted[sorted.len() - 1 - rank]
}

/// Weights of a batch's samples from their errors of prediction.
///
/// Softmax's sum to 1. Those of the step function are divided by n; the original takes the sum,
/// which Adam cannot tell apart. `threshold` is that of all rows; without it, it is the batch's own.
#[must_use]
pub fn weights(errors: &[f32], config: &KfConfig, batch_threshold: Option<f32>) -> Vec<f32> {
    match config.weighting {
        KfWeighting::Softmax => {
            let factor = match config.temperature_use {
                KfTemperature::Multiplies => config.temperature,
                KfTemperature::Divides => 1.0 / config.temperature,
            };
            let scaled = |error: &f32| f64::from(*error) * factor;
            let highest = errors.iter().map(scaled).fold(f64::NEG_INFINITY, f64::max);
            let powers: Vec<f64> =
                errors.iter().map(|error| (scaled(error) - highest).exp()).collect();
            let sum: f64 = powers.iter().sum();
            powers.iter().map(|power| (power / sum) as f32).collect()
        }
        KfWeighting::Step => {
            let threshold = batch_threshold.unwrap_or_else(|| threshold(errors, config.step_share));
            let one = 1.0 / errors.len() as f64;
            let weight = |error: &f32| if *error > threshold { config.step_weight } else { 1.0 };
            errors.iter().map(|error| (weight(error) * one) as f32).collect()
        }
    }
}

impl Method for Kf<'_> {
    fn start(&self) -> State {
        let Context { config, data, .. } = &self.context;
        let size = data.action_size();
        let [first, second] = config.kf.hidden_sizes;
        let layers = vec![
            LayerShape::new("predictor_1", config.kf.past_actions * size, first),
            LayerShape::new("predictor_2", first, second),
            LayerShape::new("predictor_3", second, size),
        ];
        state(vec![
            self.architecture().policy_shape().network(config.seed),
            Network::new(PREDICTOR, layers, Initialization::Uniform, config.seed, 1),
        ])
    }

    fn step(&mut self, state: &mut State) -> Result<Option<StepReport>, TrainError> {
        let Context { config, device, constants, data, .. } = &self.context;
        let step = state.step + 1;
        let rows = self.context.rows(Purpose::Batch, state.step);
        let batch = data.batch(&rows).tensors(constants);
        let [policy_network, predictor] = &mut state.networks[..] else {
            return Ok(None);
        };
        let (errors, fixed_threshold) = match config.kf.schedule {
            KfSchedule::Joint => {
                let actions = &batch.actions;
                let errors = self.update_predictor(predictor, &rows, actions.clone(), step)?;
                for _ in 1..config.kf.inner_updates {
                    self.update_predictor(predictor, &rows, actions.clone(), step)?;
                }
                (errors, None)
            }
            KfSchedule::TwoStage if predictor.adam.step < config.kf.predictor_steps => {
                let rows = self.context.rows(Purpose::Predictor, predictor.adam.step);
                let actions = tensor(data.batch(&rows).actions, data.action_size(), constants);
                self.update_predictor(predictor, &rows, actions, step)?;
                return Ok(None);
            }
            KfSchedule::TwoStage => {
                if self.fixed.is_none() {
                    self.fixed = Some(self.all_errors(predictor)?);
                }
                let (errors, threshold) = self.fixed.get_or_insert_default();
                (rows.iter().map(|&row| errors[row]).collect(), Some(*threshold))
            }
        };
        let shape = self.architecture().policy_shape();
        let policy = PolicyNet::new(shape, &policy_network.parameters, device)?;
        let output = policy.forward(batch.observations.clone());
        let weights = tensor(weights(&errors, &config.kf, fixed_threshold), 1, constants);
        let (loss, nll) = likelihood::of_weighted_batch(&output, &batch, weights)?;
        let mean_error = errors.iter().map(|&error| f64::from(error)).sum::<f64>();
        let report =
            StepReport::new(nll).with("prediction_error", mean_error / errors.len() as f64);
        report.check(step)?;
        policy_network.descend(&policy.gradient(&loss)?, config.learning_rate, step)?;
        Ok(Some(report))
    }

    fn architecture(&self) -> Architecture {
        self.context.architecture(Kind::Plain)
    }
}
