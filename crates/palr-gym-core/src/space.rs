//! Spaces of observations and actions.

/// A box in R^n: what values an observation or action can take, and what each entry is called.
#[derive(Debug, Clone, PartialEq)]
pub struct BoxSpace {
    /// Of one value, outermost dimension first.
    pub shape: Vec<usize>,
    /// Lowest value of each entry, or one for all; may be -infinity.
    pub low: Vec<f64>,
    /// Highest value of each entry, or one for all; may be infinity.
    pub high: Vec<f64>,
    /// Name of each entry, unique; none for pictures.
    pub names: Vec<String>,
}

impl BoxSpace {
    /// Number of entries.
    #[must_use]
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// True for a space without entries, which no task has.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
