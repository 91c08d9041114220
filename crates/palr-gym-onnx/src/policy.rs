//! The policy contract.

use std::time::Duration;

use ort::session::Session;
use ort::session::builder::GraphOptimizationLevel;
use ort::value::{Outlet, TensorElementType, TensorRef, ValueType};

use crate::error::OnnxError;
use crate::inspect::inspect;
use crate::runtime::environment;
use crate::watchdog::Watchdog;

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
    session: Session,
    watchdog: Watchdog,
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
        if model.len() > limits.max_bytes {
            return Err(OnnxError::TooLarge { got: model.len(), limit: limits.max_bytes });
        }
        inspect(model)?;
        let session = open(model)?;
        check_input(session.inputs(), observation_size)?;
        let names: Vec<String> =
            session.outputs().iter().map(|output| output.name().to_owned()).collect();
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
        let watchdog = Watchdog::new(limits.max_inference)
            .map_err(|error| OnnxError::NotOnnx { message: error.to_string() })?;
        let mut policy = Self {
            is_stochastic: has(MEAN) && has(LOG_STD),
            session,
            watchdog,
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
        let failed = |error: ort::Error| OnnxError::Failed { batch, message: error.to_string() };
        let shape = [batch, self.observation_size];
        let input = TensorRef::from_array_view((shape, observations)).map_err(failed)?;
        let (options, watch) = self.watchdog.watch();
        let outputs = match self.session.run_with_options(ort::inputs![input], &*options) {
            Ok(outputs) => outputs,
            Err(_) if watch.is_overdue() => {
                return Err(OnnxError::TooSlow { limit: self.watchdog.limit(), batch });
            }
            Err(error) => return Err(failed(error)),
        };
        let want = [batch as i64, self.action_size as i64];
        let extract = |name: &str| -> Result<Vec<f32>, OnnxError> {
            let wrong = |got: String| OnnxError::Shape {
                what: format!("output {name:?}"),
                got,
                want: format!("float32 {want:?} for a batch of {batch}"),
            };
            let value = outputs.get(name).ok_or_else(|| wrong("missing".into()))?;
            let (shape, values) =
                value.try_extract_tensor::<f32>().map_err(|_| wrong(value.dtype().to_string()))?;
            if shape[..] != want {
                return Err(wrong(format!("float32 {:?}", &shape[..])));
            }
            match values.iter().position(|value| !value.is_finite()) {
                None => Ok(values.to_vec()),
                Some(position) => Err(OnnxError::NotFinite {
                    output: name.to_owned(),
                    row: position / self.action_size,
                    index: position % self.action_size,
                    got: values[position],
                }),
            }
        };
        let is_stochastic = self.is_stochastic;
        let extract_optional = |name| is_stochastic.then(|| extract(name)).transpose();
        Ok(PolicyOutput {
            action: extract(&self.action_output)?,
            mean: extract_optional(MEAN)?,
            log_std: extract_optional(LOG_STD)?,
        })
    }
}

fn open(model: &[u8]) -> Result<Session, OnnxError> {
    let environment = environment()?;
    let not_onnx = |message: String| OnnxError::NotOnnx { message };
    // One thread a session: batching across environments uses cores better than threads inside an
    // operator.
    Session::builder(environment)
        .map_err(|error| not_onnx(error.to_string()))?
        .with_intra_threads(1)
        .map_err(|error| not_onnx(error.to_string()))?
        .with_inter_threads(1)
        .map_err(|error| not_onnx(error.to_string()))?
        .with_optimization_level(GraphOptimizationLevel::All)
        .map_err(|error| not_onnx(error.to_string()))?
        .commit_from_memory(model)
        .map_err(|error| not_onnx(error.to_string()))
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
    let got = match input.dtype() {
        ValueType::Tensor { ty, shape, .. } => {
            let sizes: Vec<String> = shape
                .iter()
                .map(|&size| if size == -1 { "N".into() } else { size.to_string() })
                .collect();
            let dtype = match ty {
                TensorElementType::Float32 => "float32".to_owned(),
                other => other.to_string(),
            };
            format!("{dtype} [{}]", sizes.join(", "))
        }
        other => other.to_string(),
    };
    Err(OnnxError::Shape {
        what: format!("input {:?}", input.name()),
        got,
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
        assert_eq!(error.to_string(), "the policy holds 282313 bytes; at most 100 are allowed");
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
