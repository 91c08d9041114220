//! Why a model was refused or failed.

use std::time::Duration;

/// Why a model cannot be used, with what was found and what was wanted.
#[derive(Debug, Clone, thiserror::Error)]
pub enum OnnxError {
    /// ONNX Runtime's shared library is not to be found or too old.
    #[error(
        "ONNX Runtime cannot be loaded (tried {tried}): {message}; run scripts/setup.sh, or set PALR_GYM_ONNXRUNTIME to the path of libonnxruntime.so, version 1.31 or later"
    )]
    RuntimeMissing {
        /// The paths that were tried.
        tried: String,
        /// What the loader said.
        message: String,
    },
    /// More bytes than are allowed.
    #[error("the model holds {got} bytes; at most {limit} are allowed")]
    TooLarge {
        /// Size of the file.
        got: usize,
        /// The limit.
        limit: usize,
    },
    /// The bytes are no ONNX model, or one that ONNX Runtime cannot run.
    #[error("the model is no ONNX model that can be run: {message}")]
    NotOnnx {
        /// What was wrong.
        message: String,
    },
    /// A tensor's values lie in another file.
    #[error(
        "the model keeps tensor {tensor:?} in an external file; export it with all weights inside"
    )]
    ExternalData {
        /// The tensor's name.
        tensor: String,
    },
    /// Inputs or outputs are not those of the contract.
    #[error("the model's {what} is {got}; expected {want}")]
    Shape {
        /// Which part.
        what: String,
        /// What it is.
        got: String,
        /// What the contract asks for.
        want: String,
    },
    /// Sampling was asked of a policy that is deterministic.
    #[error(
        "the model has no outputs `mean` and `log_std` (it has {outputs}); sampled actions need both"
    )]
    NotStochastic {
        /// The outputs there are.
        outputs: String,
    },
    /// The model computed something that is no number.
    #[error(
        "the model's output {output:?} has {got} at row {row}, index {index}; expected finite numbers"
    )]
    NotFinite {
        /// Name of the output.
        output: String,
        /// Row of the batch.
        row: usize,
        /// Entry in the row.
        index: usize,
        /// NaN or an infinity.
        got: f32,
    },
    /// An inference did not end in time.
    #[error("the model took longer than {limit:?} for one batch of {batch} observations")]
    TooSlow {
        /// The limit.
        limit: Duration,
        /// Rows in the batch.
        batch: usize,
    },
    /// ONNX Runtime failed on a model that it had accepted.
    #[error("the model failed on a batch of {batch} observations: {message}")]
    Failed {
        /// Rows in the batch.
        batch: usize,
        /// What ONNX Runtime said.
        message: String,
    },
}
