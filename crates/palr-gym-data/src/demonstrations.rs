//! The arrays of a data set that is in memory.

use std::ops::Range;
use std::path::Path;

use ndarray::{Array1, Array2, s};

use crate::error::DataError;
use crate::recording::{Outline, Recording, Rows, episodes};

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
/// [-1, 1].
#[derive(Debug, Clone, PartialEq)]
pub struct Demonstrations {
    outline: Outline,
    observations: Array2<f32>,
    actions: Array2<f32>,
    rewards: Array1<f32>,
}

impl Demonstrations {
    /// Checks `arrays`. Errors name `source`, the file that they are from, or what stands for one;
    /// `env_id` is what it says that it holds.
    ///
    /// # Errors
    /// [`DataError::Rank`], [`DataError::NoTransitions`], [`DataError::Length`],
    /// [`DataError::NotFinite`] or [`DataError::ActionOutOfBounds`].
    pub fn new(source: &Path, env_id: Option<String>, arrays: Arrays) -> Result<Self, DataError> {
        let Arrays { observations, actions, rewards, terminals, timeouts } = arrays;
        check_shapes(
            source,
            [
                ("observations", observations.shape()),
                ("actions", actions.shape()),
                ("rewards", rewards.shape()),
                ("terminals", terminals.shape()),
                ("timeouts", timeouts.shape()),
            ],
        )?;
        let (episodes, terminated, timed_out) = episodes(&terminals.to_vec(), &timeouts.to_vec());
        let outline = Outline {
            source: source.to_path_buf(),
            env_id,
            observation_size: observations.ncols(),
            action_size: actions.ncols(),
            episodes,
            terminated,
            timed_out,
        };
        let demonstrations = Self { outline, observations, actions, rewards };
        demonstrations.view(0..demonstrations.outline.transitions()).check(source, 0)?;
        Ok(demonstrations)
    }

    fn view(&self, rows: Range<usize>) -> Rows<'_> {
        Rows {
            observations: self.observations.slice(s![rows.clone(), ..]).into(),
            actions: self.actions.slice(s![rows.clone(), ..]).into(),
            rewards: self.rewards.slice(s![rows]).into(),
        }
    }
}

impl Recording for Demonstrations {
    fn outline(&self) -> &Outline {
        &self.outline
    }

    fn rows(&self, rows: Range<usize>) -> Result<Rows<'_>, DataError> {
        Ok(self.view(rows))
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
