//! The policy contract.

use std::time::Duration;

use ort::value::{Outlet, TensorElementType, ValueType};

use crate::error::OnnxError;
use crate::model::{Limits, Model, describe};

/// Name of the output that holds actions, if there are several.
const ACTION: &str = "action";
/// Name of the output that holds the Gaussian's mean before tanh.
const MEAN: &str = "mean";
/// Name of the output that holds the Gaussian's log standard deviation.
const LOG_STD: &str = "log_std";

/// How much a policy may use.
#[derive(Debug, Clone, Copy)]
pub struct PolicyLimits {
    /// Bytes of the model.
    pub max_bytes: usize,
    /// Wall-clock time of one inference.
    pub max_inference: Duration,
}

impl Default for PolicyLimits {
    /// 32 MiB and ten seconds.
    fn default() -> Self {
        Self { max_bytes: 32 << 20, max_inference: Duration::from_secs(10) }
    }
}

/// What a policy says about a batch of N observations; every number is finite.
#[derive(Debug, Clone, Default)]
pub struct PolicyOutput {
    /// `[N, action_size]`.
    pub action: Vec<f32>,
    /// `[N, action_size]`, if the policy is stochastic: mean of the Gaussian before tanh.
    pub mean: Option<Vec<f32>>,
    /// `[N, action_size]`, if the policy is stochastic: log standard deviation before tanh.
    pub log_std: Option<Vec<f32>>,
}

/// A model that keeps the policy contract: one float32 input `[N, observation_size]`, output
/// `action` `[N, action_size]` (or the only output), optionally `mean` and `log_std`.
///
/// It runs on the calling thread.
pub struct Policy {
    model: Model,
    observation_size: usize,
    action_size: usize,
    action_output: String,
    is_stochastic: bool,
    outputs: String,
}

impl Policy {
    /// Loads `model` and holds it to the contract, with a trial run on zeros.
    ///
    /// # Errors
    /// Any [`OnnxError`].
    pub fn load(
        model: &[u8],
        observation_size: usize,
        action_size: usize,
        limits: PolicyLimits,
    ) -> Result<Self, OnnxError> {
        let PolicyLimits { max_bytes, max_inference } = limits;
        let model = Model::open(model, Limits { max_bytes, max_inference })?;
        check_input(model.inputs(), observation_size)?;
        let names = model.output_names();
        let has = |name: &str| names.iter().any(|output| output == name);
        let action_output = match names.as_slice() {
            [only] => only.clone(),
            _ if has(ACTION) => ACTION.to_owned(),
            _ => {
                return Err(OnnxError::Shape {
                    what: "list of outputs".into(),
                    got: names.join(", "),
                    want: "one output, or one of them named `action`".into(),
                });
            }
        };
        let mut policy = Self {
            is_stochastic: has(MEAN) && has(LOG_STD),
            model,
            observation_size,
            action_size,
            action_output,
            outputs: names.join(", "),
        };
        // Two rows: a model with a fixed batch of one must not pass.
        policy.act(&vec![0.0; 2 * observation_size], 2)?;
        Ok(policy)
    }

    /// True if the policy has `mean` and `log_std`.
    #[must_use]
    pub fn is_stochastic(&self) -> bool {
        self.is_stochastic
    }

    /// Succeeds if actions can be sampled.
    ///
    /// # Errors
    /// [`OnnxError::NotStochastic`].
    pub fn require_stochastic(&self) -> Result<(), OnnxError> {
        if self.is_stochastic {
            Ok(())
        } else {
            Err(OnnxError::NotStochastic { outputs: self.outputs.clone() })
        }
    }

    /// Runs the policy on `observations`, `[batch, observation_size]`.
    ///
    /// # Errors
    /// [`OnnxError::Failed`], [`OnnxError::TooSlow`], [`OnnxError::Shape`] or
    /// [`OnnxError::NotFinite`].
    pub fn act(&mut self, observations: &[f32], batch: usize) -> Result<PolicyOutput, OnnxError> {
        let (is_stochastic, size) = (self.is_stochastic, self.action_size);
        let action_output = &self.action_output;
        self.model.run(&[batch, self.observation_size], observations, |outputs| {
            let extract = |name: &str| outputs.matrix(name, batch, size);
            let extract_optional = |name| is_stochastic.then(|| extract(name)).transpose();
            Ok(PolicyOutput {
                action: extract(action_output)?,
                mean: extract_optional(MEAN)?,
                log_std: extract_optional(LOG_STD)?,
            })
        })
    }
}

fn check_input(inputs: &[Outlet], observation_size: usize) -> Result<(), OnnxError> {
    let want = format!("float32 [N, {observation_size}]");
    let [input] = inputs else {
        let names: Vec<&str> = inputs.iter().map(Outlet::name).collect();
        return Err(OnnxError::Shape {
            what: "list of inputs".into(),
            got: format!("{} inputs ({})", inputs.len(), names.join(", ")),
            want: format!("one input, {want}"),
        });
    };
    let is_right = match input.dtype() {
        ValueType::Tensor { ty: TensorElementType::Float32, shape, .. } => match shape[..] {
            [batch, size] => batch == -1 && (size == -1 || size == observation_size as i64),
            _ => false,
        },
        _ => false,
    };
    if is_right {
        return Ok(());
    }
    Err(OnnxError::Shape {
        what: format!("input {:?}", input.name()),
        got: describe(input),
        want: format!("{want} (the batch dimension N must be dynamic)"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOPPER: &[u8] = include_bytes!("../../../scenes/experts/hopper.onnx");

    fn refusal(model: &[u8], observation_size: usize, action_size: usize) -> String {
        Policy::load(model, observation_size, action_size, PolicyLimits::default())
            .err()
            .map(|error| error.to_string())
            .unwrap_or_default()
    }

    #[test]
    fn the_shipped_expert_keeps_the_contract() {
        let mut policy = Policy::load(HOPPER, 11, 3, PolicyLimits::default()).unwrap();
        let observations: Vec<f32> = (0..33).map(|i| (i as f32 * 0.37).sin()).collect();
        let output = policy.act(&observations, 3).unwrap();
        let mean = output.mean.unwrap();
        for (action, mean) in output.action.iter().zip(&mean) {
            assert!((action - mean.tanh()).abs() < 1e-5);
        }
        assert!(output.log_std.unwrap().iter().all(|value| (-20.0..=2.0).contains(value)));
    }

    #[test]
    fn models_outside_the_contract_are_refused_with_what_was_wanted() {
        let error = refusal(HOPPER, 10, 3);
        assert!(error.contains("float32 [N, 11]; expected float32 [N, 10]"), "{error}");
        let error = refusal(HOPPER, 11, 4);
        assert!(error.contains("float32 [2, 3]; expected float32 [2, 4]"), "{error}");
        assert!(refusal(b"not onnx", 11, 3).contains("no ONNX model"));
        assert!(refusal(&HOPPER[..HOPPER.len() / 2], 11, 3).contains("no ONNX model"));
        let limits = PolicyLimits { max_bytes: 100, ..PolicyLimits::default() };
        let error = Policy::load(HOPPER, 11, 3, limits).err().unwrap();
        let expected = format!("the model holds {} bytes; at most 100 are allowed", HOPPER.len());
        assert_eq!(error.to_string(), expected);
    }

    #[test]
    fn an_inference_that_takes_too_long_is_ended_and_the_next_one_is_not() {
        let limits =
            PolicyLimits { max_inference: Duration::from_millis(60), ..PolicyLimits::default() };
        let mut policy = Policy::load(HOPPER, 11, 3, limits).unwrap();
        // About 10¹¹ multiplications.
        let batch = 1 << 20;
        let error = policy.act(&vec![0.1; batch * 11], batch).unwrap_err();
        assert!(matches!(error, OnnxError::TooSlow { .. }), "{error}");
        policy.act(&[0.1; 11], 1).unwrap();
    }

    #[test]
    fn nan_that_an_observation_causes_is_an_error_not_an_action() {
        let mut policy = Policy::load(HOPPER, 11, 3, PolicyLimits::default()).unwrap();
        let mut observations = vec![0.0; 22];
        observations[15] = f32::NAN;
        let error = policy.act(&observations, 2).unwrap_err();
        assert!(matches!(error, OnnxError::NotFinite { row: 1, .. }), "{error}");
    }
}
