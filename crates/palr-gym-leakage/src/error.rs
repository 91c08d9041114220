//! Why leakage cannot be estimated.

/// What is wrong with the samples or the settings.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LeakageError {
    /// Arrays that should have one row for each sample have different numbers of rows.
    #[error("{name} has {got} rows, {first} has {want}; expected one row a sample in each")]
    Length {
        /// The array.
        name: &'static str,
        /// Its rows.
        got: usize,
        /// The array that it is compared with.
        first: &'static str,
        /// That array's rows.
        want: usize,
    },
    /// One sample says nothing about dependence.
    #[error("{got} samples; expected at least 2")]
    TooFew {
        /// How many there are.
        got: usize,
    },
    /// An array without columns.
    #[error("{name} has no columns; expected at least 1")]
    NoColumns {
        /// The array.
        name: &'static str,
    },
    /// NaN or an infinity.
    #[error("{name} has {value} at row {row}, column {column}; expected finite numbers")]
    NotFinite {
        /// The array.
        name: &'static str,
        /// Where.
        row: usize,
        /// Where.
        column: usize,
        /// What.
        value: f64,
    },
    /// A column that has one value only: it depends on nothing, or was never filled.
    #[error(
        "column {column} of {name} is {value} in all {samples} samples; expected values that vary"
    )]
    Constant {
        /// The array.
        name: &'static str,
        /// Which.
        column: usize,
        /// The value.
        value: f64,
        /// How many.
        samples: usize,
    },
    /// A setting outside its range.
    #[error("{name} is {got}; expected a positive, finite number")]
    NotPositive {
        /// The setting.
        name: &'static str,
        /// Its value.
        got: f64,
    },
    /// The regularised kernel matrix could not be factored: the ridge is too small for f64.
    #[error("the kernel matrix of {name} is singular with ridge {ridge}; choose a larger ridge")]
    Singular {
        /// The array.
        name: &'static str,
        /// The ridge.
        ridge: f64,
    },
    /// Blocks that do not cover the samples.
    #[error("blocks hold {got} samples; expected {want}")]
    Blocks {
        /// Samples in all blocks.
        got: usize,
        /// Samples.
        want: usize,
    },
}
