//! HSCIC of uploaded arrays, or of what a policy does on uploaded observations.

use faer::Mat;
use palr_gym_core::random::Generator;
use palr_gym_core::{ActionMode, EnvSpec, tanh_gaussian};
use palr_gym_leakage::{Hscic, HscicConfig, Interval, block_bootstrap, hscic, refuse_constant};
use palr_gym_onnx::{Policy, PolicyLimits};

use crate::error::ServerError;
use crate::experts::{self, expert};
use crate::rollout::PolicyChoice;

/// Rows that a policy sees at once.
const BATCH: usize = 256;

/// What may leak.
pub enum Subject {
    /// `[n, d]`.
    Representation(Mat<f64>),
    /// The actions of a policy.
    Policy(PolicySubject),
}

/// A policy and what it sees.
pub struct PolicySubject {
    /// The policy.
    pub policy: PolicyChoice,
    /// The environment that the observations come from.
    pub spec: EnvSpec,
    /// `[n, observation_size]`.
    pub observations: Mat<f64>,
    /// Sampled or deterministic actions.
    pub action_mode: ActionMode,
    /// What the policy may use.
    pub limits: PolicyLimits,
}

/// An estimate and how far to trust it.
pub struct Leakage {
    /// The estimate, point by point.
    pub hscic: Hscic,
    /// Its interval.
    pub interval: Interval,
}

/// How to estimate.
pub struct LeakageOptions {
    /// Ridge and bandwidth.
    pub config: HscicConfig,
    /// Samples of each episode; empty for one episode.
    pub episode_lengths: Vec<usize>,
    /// Bootstrap resamples.
    pub resamples: usize,
    /// Of sampled actions and of the bootstrap.
    pub seed: u64,
}

/// Estimates leakage. `past_actions` and `given_actions` are `[n, action_size]`.
///
/// # Errors
/// [`ServerError::Leakage`], or whatever the policy fails with.
pub fn estimate(
    subject: Subject,
    past_actions: &Mat<f64>,
    given_actions: &Mat<f64>,
    options: &LeakageOptions,
) -> Result<Leakage, ServerError> {
    refuse_constant("past_action", past_actions.as_ref())?;
    refuse_constant("given_action", given_actions.as_ref())?;
    let representation = match subject {
        // Some of its columns may never vary: units die. A policy that always does the same leaks
        // nothing, and may be asked.
        Subject::Representation(representation) => {
            let columns = representation.ncols();
            let is_varied = |column| {
                let one = representation.as_ref().subcols(column, 1);
                refuse_constant("representation", one).is_ok()
            };
            if columns > 0 && !(0..columns).any(is_varied) {
                refuse_constant("representation", representation.as_ref())?;
            }
            representation
        }
        Subject::Policy(policy) => policy.act(options.seed)?,
    };
    let hscic = hscic(
        representation.as_ref(),
        past_actions.as_ref(),
        given_actions.as_ref(),
        &options.config,
    )?;
    let whole = [hscic.per_point.len()];
    let lengths =
        if options.episode_lengths.is_empty() { &whole[..] } else { &options.episode_lengths };
    let interval = block_bootstrap(&hscic.per_point, lengths, options.resamples, options.seed)?;
    Ok(Leakage { hscic, interval })
}

impl PolicySubject {
    /// What the policy does on each observation, `[n, action_size]`.
    fn act(&self, seed: u64) -> Result<Mat<f64>, ServerError> {
        let spec = &self.spec;
        let (samples, width) = self.observations.shape();
        let size = spec.observation_size();
        if width != size {
            return Err(ServerError::Array {
                field: "policy.observations",
                got: format!("[{samples}, {width}]"),
                want: format!("[n, {size}] for {}", spec.env_id),
            });
        }
        let mut generator = Generator::from_seed(seed);
        let model: &[u8] = match &self.policy {
            PolicyChoice::Random => {
                return Ok(Mat::from_fn(samples, spec.action_size(), |_, _| {
                    generator.uniform(-1.0, 1.0)
                }));
            }
            PolicyChoice::Expert => {
                let task = spec.task.name;
                let missing = || ServerError::NoExpert { task, available: experts::available() };
                expert(task).ok_or_else(missing)?.onnx
            }
            PolicyChoice::Onnx(model) => model,
        };
        let action_size = spec.action_size();
        let mut policy = Policy::load(model, size, action_size, self.limits)?;
        if self.action_mode == ActionMode::Sampled {
            policy.require_stochastic()?;
        }
        let mut actions = Mat::zeros(samples, action_size);
        let mut row = vec![0.0_f32; action_size];
        for start in (0..samples).step_by(BATCH) {
            let count = BATCH.min(samples - start);
            let batch: Vec<f32> = (start..start + count)
                .flat_map(|i| (0..size).map(move |j| (i, j)))
                .map(|at| self.observations[at] as f32)
                .collect();
            let output = policy.act(&batch, count)?;
            for i in 0..count {
                let range = i * action_size..(i + 1) * action_size;
                match (&output.mean, &output.log_std, self.action_mode) {
                    (Some(mean), Some(log_std), ActionMode::Sampled) => {
                        let (mean, log_std) = (&mean[range.clone()], &log_std[range]);
                        tanh_gaussian::sample(&mut generator, mean, log_std, &mut row);
                    }
                    _ => row.copy_from_slice(&output.action[range]),
                }
                for (j, &entry) in row.iter().enumerate() {
                    actions[(start + i, j)] = f64::from(entry.clamp(-1.0, 1.0));
                }
            }
        }
        Ok(actions)
    }
}
