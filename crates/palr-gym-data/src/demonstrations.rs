//! The arrays of a data set, and where its episodes lie.

use std::ops::Range;
use std::path::{Path, PathBuf};

use ndarray::{Array1, Array2, ArrayView2, Axis};

use crate::error::DataError;

/// N transitions, one a row, in the order in which they were recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct Arrays {
    /// `[N, D]`: before each action.
    pub observations: Array2<f32>,
    /// `[N, A]`, within [-1, 1].
    pub actions: Array2<f32>,
    /// `[N]`.
    pub rewards: Array1<f32>,
    /// `[N]`: the task ended an episode with this row.
    pub terminals: Array1<bool>,
    /// `[N]`: the time limit ended an episode with this row, or its recording stopped.
    pub timeouts: Array1<bool>,
}

/// A data set that has been checked.
///
/// Invariants: N, D, A ≥ 1; arrays are of equal length; numbers are finite; actions are within
/// [-1, 1]; episodes lie end to end and cover every row.
#[derive(Debug, Clone, PartialEq)]
pub struct Demonstrations {
    source: PathBuf,
    env_id: Option<String>,
    arrays: Arrays,
    episodes: Vec<Range<usize>>,
}

impl Demonstrations {
    /// Checks `arrays`. Errors name `source`, the file that they are from, or what stands for one;
    /// `env_id` is what it says that it holds.
    ///
    /// # Errors
    /// [`DataError::Rank`], [`DataError::NoTransitions`], [`DataError::Length`],
    /// [`DataError::NotFinite`] or [`DataError::ActionOutOfBounds`].
    pub fn new(source: &Path, env_id: Option<String>, arrays: Arrays) -> Result<Self, DataError> {
        check_shapes(
            source,
            [
                ("observations", arrays.observations.shape()),
                ("actions", arrays.actions.shape()),
                ("rewards", arrays.rewards.shape()),
                ("terminals", arrays.terminals.shape()),
                ("timeouts", arrays.timeouts.shape()),
            ],
        )?;
        let rewards = arrays.rewards.view().insert_axis(Axis(1));
        for (dataset, values) in [
            ("observations", arrays.observations.view()),
            ("actions", arrays.actions.view()),
            ("rewards", rewards),
        ] {
            if let Some((row, column, value)) = first_without(values, f32::is_finite) {
                let (path, value) = (source.to_path_buf(), value.to_string());
                return Err(DataError::NotFinite { path, dataset, row, column, value });
            }
        }
        let is_within_bounds = |value: f32| value.abs() <= 1.0;
        if let Some((row, column, value)) = first_without(arrays.actions.view(), is_within_bounds) {
            let (path, value) = (source.to_path_buf(), value.to_string());
            return Err(DataError::ActionOutOfBounds { path, row, column, value });
        }
        let episodes = episodes(&arrays);
        Ok(Self { source: source.to_path_buf(), env_id, arrays, episodes })
    }

    /// Number of transitions, N ≥ 1.
    #[must_use]
    pub fn transitions(&self) -> usize {
        self.arrays.rewards.len()
    }

    /// `[N, D]`: before each action.
    #[must_use]
    pub fn observations(&self) -> &Array2<f32> {
        &self.arrays.observations
    }

    /// `[N, A]`, within [-1, 1].
    #[must_use]
    pub fn actions(&self) -> &Array2<f32> {
        &self.arrays.actions
    }

    /// `[N]`.
    #[must_use]
    pub fn rewards(&self) -> &Array1<f32> {
        &self.arrays.rewards
    }

    /// `[N]`: the task ended an episode with this row.
    #[must_use]
    pub fn terminals(&self) -> &Array1<bool> {
        &self.arrays.terminals
    }

    /// `[N]`: the time limit ended an episode with this row, or its recording stopped.
    #[must_use]
    pub fn timeouts(&self) -> &Array1<bool> {
        &self.arrays.timeouts
    }

    /// The rows of each episode. One ends with each row of `terminals | timeouts`; the last one is
    /// closed at the end of the file, flagged or not.
    #[must_use]
    pub fn episodes(&self) -> &[Range<usize>] {
        &self.episodes
    }

    /// The environment that the data set says it is from; D4RL's own files do not say.
    #[must_use]
    pub fn env_id(&self) -> Option<&str> {
        self.env_id.as_deref()
    }

    /// The file.
    #[must_use]
    pub fn source(&self) -> &Path {
        &self.source
    }
}

/// Checks `observations`, which comes first, `actions`, and what else has one entry a row.
pub(crate) fn check_shapes<'a>(
    source: &Path,
    shapes: impl IntoIterator<Item = (&'static str, &'a [usize])>,
) -> Result<(), DataError> {
    let path = || source.to_path_buf();
    let mut transitions = None;
    for (dataset, shape) in shapes {
        let (is_right, want) = match dataset {
            "observations" => (matches!(shape, [_, width] if *width > 0), "[N, observation size]"),
            "actions" => (matches!(shape, [_, width] if *width > 0), "[N, action size]"),
            _ => (matches!(shape, [_] | [_, 1]), "[N] or [N, 1]"),
        };
        if !is_right {
            return Err(DataError::Rank { path: path(), dataset, got: shape.to_vec(), want });
        }
        match (shape[0], transitions) {
            (0, None) => return Err(DataError::NoTransitions { path: path() }),
            (n, None) => transitions = Some(n),
            (got, Some(want)) if got != want => {
                return Err(DataError::Length { path: path(), dataset, got, want });
            }
            _ => {}
        }
    }
    Ok(())
}

/// Row, column and value of the first entry that is not as it should be.
fn first_without(
    values: ArrayView2<'_, f32>,
    is_right: impl Fn(f32) -> bool,
) -> Option<(usize, usize, f32)> {
    values.rows().into_iter().enumerate().find_map(|(row, entries)| {
        let column = entries.iter().position(|&value| !is_right(value))?;
        Some((row, column, entries[column]))
    })
}

fn episodes(arrays: &Arrays) -> Vec<Range<usize>> {
    let transitions = arrays.rewards.len();
    let flags = arrays.terminals.iter().zip(&arrays.timeouts);
    let mut start = 0;
    let mut episodes = Vec::new();
    for (row, (&terminal, &timeout)) in flags.enumerate() {
        if terminal || timeout || row + 1 == transitions {
            episodes.push(start..row + 1);
            start = row + 1;
        }
    }
    episodes
}
