//! VIB, the variational information bottleneck: φ is a sample of a Gaussian that is kept near the
//! standard normal.
//!
//! # Source
//! Alemi et al. (2017): spread softplus(ρ - 5), divergence summed over φ and averaged over the
//! batch, one reparameterised sample in training. The PALR paper (section D.3) states β only.

use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};

use crate::learning::algorithms::{Method, StepReport, state};
use crate::learning::architecture::{Architecture, Kind};
use crate::learning::context::Context;
use crate::learning::error::TrainError;
use crate::learning::likelihood;
use crate::learning::network::{scalar, tensor};
use crate::learning::noise::Normals;
use crate::learning::policy_net::{PolicyNet, PolicyShape, PolicyTensors, REPRESENTATION_SIZE};
use crate::learning::state::State;
use crate::learning::streams::{Purpose, stream};

/// Name of the fixed samples that a finished policy averages over.
pub const NOISE: &str = "noise";
/// Shift of the spread before softplus (the public code's constant).
pub(crate) const SPREAD_SHIFT: f64 = 5.0;

/// The method.
pub struct Vib<'a> {
    context: Context<'a>,
}

impl<'a> Vib<'a> {
    /// For a run of `context`.
    #[must_use]
    pub fn new(context: Context<'a>) -> Self {
        Self { context }
    }

    fn training_shape(&self) -> PolicyShape {
        let data = self.context.data;
        let plain = PolicyShape::plain(data.observation_size(), data.action_size());
        PolicyShape { is_bottleneck: true, ..plain }
    }
}

/// Mean and standard deviation of the bottleneck, `[n, 64]` each, from what the encoder makes.
#[must_use]
pub fn bottleneck(encoded: Tensor<2>) -> (Tensor<2>, Tensor<2>) {
    let mean = encoded.clone().narrow(1, 0, REPRESENTATION_SIZE);
    let x = encoded.narrow(1, REPRESENTATION_SIZE, REPRESENTATION_SIZE) - SPREAD_SHIFT;
    // softplus, keeping the digits of small values and finite for large ones.
    let std = relu(x.clone()) + x.abs().neg().exp().log1p();
    (mean, std)
}

/// KL of N(mean, std²) from N(0, I): summed over φ, averaged over samples.
#[must_use]
pub fn divergence(mean: Tensor<2>, std: Tensor<2>) -> Tensor<1> {
    let [n, _] = mean.dims();
    let terms = mean.clone() * mean + std.clone() * std.clone() - std.log().mul_scalar(2.0) - 1.0;
    terms.sum().div_scalar(2.0 * n as f64)
}

/// The policy averaged over fixed samples of the bottleneck, `[samples, 64]`; its representation is
/// the bottleneck's mean.
#[must_use]
pub fn forward_samples(
    policy: &PolicyNet,
    observations: Tensor<2>,
    samples: &[f32],
    device: &Device,
) -> PolicyTensors {
    let (representation, std) = bottleneck(policy.encode(observations));
    let rows = samples.chunks_exact(REPRESENTATION_SIZE);
    let share = 1.0 / rows.len() as f64;
    let mut total: Option<(Tensor<2>, Tensor<2>)> = None;
    for sample in rows {
        let sample = tensor(sample.to_vec(), REPRESENTATION_SIZE, device);
        let output = policy.decode(representation.clone() + std.clone() * sample);
        total = Some(match total {
            None => (output.mean, output.log_std),
            Some((mean, log_std)) => (mean + output.mean, log_std + output.log_std),
        });
    }
    match total {
        Some((mean, log_std)) => PolicyTensors {
            representation,
            mean: mean.mul_scalar(share),
            log_std: log_std.mul_scalar(share),
        },
        None => policy.decode(representation),
    }
}

impl Method for Vib<'_> {
    fn start(&self) -> State {
        state(vec![self.training_shape().network(self.context.config.seed)])
    }

    fn step(&mut self, state: &mut State) -> Result<Option<StepReport>, TrainError> {
        let Context { config, device, constants, .. } = &self.context;
        let step = state.step + 1;
        let batch = self.context.batch(state.step);
        let noise = self.context.noise(state.step).draw(batch.n * REPRESENTATION_SIZE, 1.0);
        let noise = tensor(noise, REPRESENTATION_SIZE, constants);
        let batch = batch.tensors(constants);
        let network = &mut state.networks[0];
        let policy = PolicyNet::new(self.training_shape(), &network.parameters, device)?;
        let (mean, std) = bottleneck(policy.encode(batch.observations.clone()));
        let output = policy.decode(mean.clone() + std.clone() * noise);
        let (likelihood, nll) = likelihood::of_batch(&output, &batch)?;
        let divergence = divergence(mean, std);
        let report = StepReport::new(nll).with("divergence", scalar(&divergence)?);
        report.check(step)?;
        let loss = likelihood + divergence.mul_scalar(config.vib.beta);
        network.descend(&policy.gradient(&loss)?, config.learning_rate, step)?;
        Ok(Some(report))
    }

    fn architecture(&self) -> Architecture {
        self.context.architecture(match self.context.config.vib.policy_samples {
            0 => Kind::Plain,
            samples => Kind::Sampled(samples),
        })
    }

    /// Without samples, the policy is a plain one whose φ is the bottleneck's mean.
    fn acting_parameters(&self, state: &State) -> Vec<f32> {
        let Context { config, .. } = &self.context;
        let parameters = &state.networks[0].parameters;
        let samples = config.vib.policy_samples;
        if samples > 0 {
            let mut generator = stream(config.seed, Purpose::Policy, 0);
            let noise = Normals::new(&mut generator).draw(samples * REPRESENTATION_SIZE, 1.0);
            return parameters.iter().copied().chain(noise).collect();
        }
        let [first, second, ..] = self.training_shape().layers();
        let (before, rest) = parameters.split_at(first.len());
        let (encoder, after) = rest.split_at(second.len());
        // Of each row of the weight, and of the bias, the half that makes the mean.
        let means = encoder.chunks_exact(2 * REPRESENTATION_SIZE);
        let means = means.flat_map(|row| &row[..REPRESENTATION_SIZE]);
        before.iter().chain(means).chain(after).copied().collect()
    }
}
