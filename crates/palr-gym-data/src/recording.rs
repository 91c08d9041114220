//! What a data set holds, and its rows as they are asked for: a file may be larger than memory.

use std::ops::Range;
use std::path::{Path, PathBuf};

use ndarray::{ArrayView2, Axis, CowArray, Ix1, Ix2};

use crate::error::DataError;

/// Rows that are in memory at a time where a whole data set passes through.
pub const BLOCK_ROWS: usize = 1 << 16;

/// Where a data set is from, its sizes, and where its episodes lie.
///
/// Invariants: there is an episode; episodes lie end to end from row 0 on, none is empty.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    /// The file, or what stands for one.
    pub source: PathBuf,
    /// The environment that the data set says it is from; D4RL's own files do not say.
    pub env_id: Option<String>,
    /// Entries of an observation, ≥ 1.
    pub observation_size: usize,
    /// Entries of an action, ≥ 1.
    pub action_size: usize,
    /// The rows of each episode.
    pub episodes: Vec<Range<usize>>,
    /// Episodes that the task ended.
    pub terminated: usize,
    /// Episodes that the time limit ended, or whose recording stopped.
    pub timed_out: usize,
}

impl Outline {
    /// Number of transitions, N ≥ 1.
    #[must_use]
    pub fn transitions(&self) -> usize {
        self.episodes.last().map_or(0, |episode| episode.end)
    }

    /// First row of the episode that `row` is in; `row` < N.
    #[must_use]
    pub fn episode_start(&self, row: usize) -> usize {
        self.episodes[self.episodes.partition_point(|episode| episode.end <= row)].start
    }
}

/// Episodes that end with each row of `terminals | timeouts`; the last one is closed at the end of the
/// data, flagged or not. With them: how many the task and the time limit ended.
pub(crate) fn episodes(terminals: &[bool], timeouts: &[bool]) -> (Vec<Range<usize>>, usize, usize) {
    let transitions = terminals.len();
    let (mut episodes, mut start, mut terminated, mut timed_out) = (Vec::new(), 0, 0, 0);
    for (row, (&terminal, &timeout)) in terminals.iter().zip(timeouts).enumerate() {
        if terminal || timeout || row + 1 == transitions {
            episodes.push(start..row + 1);
            start = row + 1;
        }
        terminated += usize::from(terminal);
        timed_out += usize::from(timeout);
    }
    (episodes, terminated, timed_out)
}

/// Consecutive transitions, one a row.
#[derive(Debug, Clone, PartialEq)]
pub struct Rows<'a> {
    /// `[n, D]`: before each action.
    pub observations: CowArray<'a, f32, Ix2>,
    /// `[n, A]`, within [-1, 1].
    pub actions: CowArray<'a, f32, Ix2>,
    /// `[n]`.
    pub rewards: CowArray<'a, f32, Ix1>,
}

impl Rows<'_> {
    /// Checks the numbers; errors name `source` and count rows from `first_row` on.
    pub(crate) fn check(&self, source: &Path, first_row: usize) -> Result<(), DataError> {
        for (dataset, values) in [
            ("observations", self.observations.view()),
            ("actions", self.actions.view()),
            ("rewards", self.rewards.view().insert_axis(Axis(1))),
        ] {
            if let Some((row, column, value)) = first_without(values, f32::is_finite) {
                let (path, value) = (source.to_path_buf(), value.to_string());
                let row = first_row + row;
                return Err(DataError::NotFinite { path, dataset, row, column, value });
            }
        }
        let is_within_bounds = |value: f32| value.abs() <= 1.0;
        if let Some((row, column, value)) = first_without(self.actions.view(), is_within_bounds) {
            let (path, value) = (source.to_path_buf(), value.to_string());
            return Err(DataError::ActionOutOfBounds { path, row: first_row + row, column, value });
        }
        Ok(())
    }
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

/// A data set, in memory or on disk.
pub trait Recording {
    /// What it holds.
    fn outline(&self) -> &Outline;

    /// Some of its rows, which must be there; finite, actions within [-1, 1].
    ///
    /// # Errors
    /// [`DataError::Read`], [`DataError::NotFinite`] or [`DataError::ActionOutOfBounds`].
    fn rows(&self, rows: Range<usize>) -> Result<Rows<'_>, DataError>;

    /// All rows, in order, [`BLOCK_ROWS`] at a time, each block with its first row's number.
    ///
    /// # Errors
    /// Those of [`rows`](Self::rows) and of `visit`.
    fn for_each_block(
        &self,
        visit: &mut dyn FnMut(usize, &Rows<'_>) -> Result<(), DataError>,
    ) -> Result<(), DataError> {
        let transitions = self.outline().transitions();
        for start in (0..transitions).step_by(BLOCK_ROWS) {
            let end = transitions.min(start + BLOCK_ROWS);
            visit(start, &self.rows(start..end)?)?;
        }
        Ok(())
    }
}
