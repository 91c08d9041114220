//! What can go wrong in training.

use std::path::PathBuf;

/// Why a run cannot start, go on or be saved.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// Statistics that cannot be had.
    #[error(transparent)]
    Standardize(#[from] palr_gym_core::standardize::StandardizeError),
    /// A setting that no run can have.
    #[error("{message}")]
    Setting {
        /// What was got and what was wanted.
        message: String,
    },
    /// A setting that does not exist.
    #[error("there is no setting `{name}`{}", nearest.as_deref().map(|nearest| format!("; did you mean `{nearest}`?")).unwrap_or_default())]
    UnknownSetting {
        /// As it was written.
        name: String,
        /// The setting that may have been meant.
        nearest: Option<String>,
    },
    /// An array of the data is too long, too short or empty.
    #[error("{name} has {got} numbers; expected {want}")]
    Length {
        /// Which array.
        name: &'static str,
        /// Its length.
        got: usize,
        /// What was wanted.
        want: String,
    },
    /// A number of the data is not finite.
    #[error("{name} is {value} in row {row}, column {column}; expected finite numbers")]
    NotFinite {
        /// Which array.
        name: &'static str,
        /// From 0.
        row: usize,
        /// From 0.
        column: usize,
        /// The number.
        value: f32,
    },
    /// A column of the data that tells nothing.
    #[error("column {column} of {name} is {value} in all {rows} rows; expected actions that vary")]
    Constant {
        /// Which array.
        name: &'static str,
        /// From 0.
        column: usize,
        /// The number.
        value: f32,
        /// Rows.
        rows: usize,
    },
    /// Training and held-out data, or a file, have different sizes.
    #[error("{what} has size {got}; expected {want}")]
    Size {
        /// Which size.
        what: &'static str,
        /// As found.
        got: usize,
        /// As wanted.
        want: usize,
    },
    /// The kernel matrix of the actions has no Cholesky factor, not even in double precision.
    #[error("the kernel matrix of the actions is singular with ridge {ridge}; use a larger one")]
    Singular {
        /// λ.
        ridge: f64,
    },
    /// A number left the finite ones. The last checkpoint is not replaced.
    #[error(
        "{tensor} is {value} at step {step}; the last checkpoint is kept. Try a smaller learning_rate or regulariser"
    )]
    Diverged {
        /// Step, from 1.
        step: u64,
        /// A term of the loss, a layer, or the gradient of one.
        tensor: String,
        /// What it is, or one of its numbers.
        value: f64,
    },
    /// A file.
    #[error("{}: {message}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// What is wrong and what to do.
        message: String,
    },
    /// One of several runs that train together.
    #[error("run {}: {cause}", run_folder.display())]
    OneOfMany {
        /// Of the run.
        run_folder: PathBuf,
        /// What is wrong with it.
        cause: Box<TrainError>,
    },
    /// The tensor library failed.
    #[error("the tensor library failed: {0}")]
    Tensor(String),
}

impl TrainError {
    pub(crate) fn file(path: impl Into<PathBuf>, message: impl std::fmt::Display) -> Self {
        Self::File { path: path.into(), message: message.to_string() }
    }
}
