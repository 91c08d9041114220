//! Why an extractor was refused or failed.

use palr_gym_onnx::OnnxError;

use crate::contract::MAX_SIDE_PX;

/// Why there are no features.
#[derive(Debug, Clone, thiserror::Error)]
pub enum VisionError {
    /// The file cannot be read.
    #[error("feature extractor {path}: {message}")]
    File {
        /// Its path.
        path: String,
        /// What the system said.
        message: String,
    },
    /// The model cannot be used, or failed.
    #[error("feature extractor: {0}")]
    Model(OnnxError),
    /// What the metadata must say is missing or makes no sense.
    #[error("feature extractor: its metadata have {key} = {got}; expected {want}")]
    Metadata {
        /// Which entry.
        key: &'static str,
        /// What it is.
        got: String,
        /// What it should be.
        want: &'static str,
    },
    /// Pictures of an impossible size.
    #[error(
        "feature extractor: it wants pictures of {height_px} x {width_px} pixels (height x width); expected 1 to {MAX_SIDE_PX} each way"
    )]
    Size {
        /// Pixels down.
        height_px: u64,
        /// Pixels across.
        width_px: u64,
    },
    /// The same picture has other features in other company.
    #[error(
        "feature extractor: the features of a picture depend on the other pictures of its batch; export it in evaluation mode"
    )]
    Batch,
    /// Other bytes than so many pictures have.
    #[error("feature extractor: {got} bytes for {count} pictures; expected {want}")]
    Pictures {
        /// Bytes received.
        got: usize,
        /// Pictures.
        count: usize,
        /// Bytes that they have.
        want: usize,
    },
}

impl From<OnnxError> for VisionError {
    fn from(error: OnnxError) -> Self {
        Self::Model(error)
    }
}
