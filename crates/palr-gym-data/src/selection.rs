//! Training rows and held-out rows.

use std::ops::Range;

use crate::error::DataError;
use crate::recording::Outline;

/// Which rows of a data set are meant.
///
/// ```
/// use palr_gym_data::{HeldOut, Selection};
/// let training = Selection::first(30_000);
/// let held_out = HeldOut::spread(2_000, 20).after(30_000);
/// # assert_eq!((training, held_out), (
/// #     Selection::First { rows: 30_000 },
/// #     Selection::HeldOut { training_rows: 30_000, held_out: HeldOut::default() },
/// # ));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Selection {
    /// The first rows: the paper's training split, which takes 30 000.
    First {
        /// Rows, ≥ 1.
        rows: usize,
    },
    /// Rows that a training on the first `training_rows` has not seen.
    HeldOut {
        /// Rows from 0 on that are out of the question; 0 if there was no training.
        training_rows: usize,
        /// Which of the rest.
        held_out: HeldOut,
    },
}

/// Which rows are held out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HeldOut {
    /// Rows spread evenly over the episodes that begin after the training rows, and over early and
    /// late parts of episodes: one run of consecutive rows in each chosen episode, runs of equal
    /// length where episodes are long enough. As few episodes as will do, none of which the
    /// training has seen. Without chance: equal files give equal rows.
    Spread {
        /// Rows, ≥ `min_episodes`.
        rows: usize,
        /// Episodes at least. Consecutive rows depend on each other, episodes do not: an interval
        /// needs 20 or more of them.
        min_episodes: usize,
    },
    /// Consecutive rows. The paper's are 2 000 from row 900 000 on, which are few episodes.
    Slice {
        /// First row.
        start: usize,
        /// Rows, ≥ 1.
        rows: usize,
    },
}

impl Default for HeldOut {
    /// 2 000 rows, as many as the paper's, spread over at least 20 episodes.
    fn default() -> Self {
        Self::spread(2_000, 20)
    }
}

impl HeldOut {
    /// [`HeldOut::Spread`].
    #[must_use]
    pub const fn spread(rows: usize, min_episodes: usize) -> Self {
        Self::Spread { rows, min_episodes }
    }

    /// [`HeldOut::Slice`].
    #[must_use]
    pub const fn slice(start: usize, rows: usize) -> Self {
        Self::Slice { start, rows }
    }

    /// The selection, for a training on the first `training_rows` rows.
    #[must_use]
    pub const fn after(self, training_rows: usize) -> Selection {
        Selection::HeldOut { training_rows, held_out: self }
    }
}

impl Selection {
    /// [`Selection::First`].
    #[must_use]
    pub const fn first(rows: usize) -> Self {
        Self::First { rows }
    }

    /// The rows, ascending, as ranges of which each lies in another episode.
    ///
    /// # Errors
    /// [`DataError::NoRows`], [`DataError::TooFewRows`], [`DataError::HeldOutOverlap`] or
    /// [`DataError::TooFewHeldOut`].
    pub fn row_ranges(self, outline: &Outline) -> Result<Vec<Range<usize>>, DataError> {
        match self {
            Self::First { rows } => consecutive(outline, 0, rows),
            Self::HeldOut { training_rows, held_out: HeldOut::Slice { start, rows } } => {
                if start < training_rows {
                    return Err(DataError::HeldOutOverlap { start, training_rows });
                }
                consecutive(outline, start, rows)
            }
            Self::HeldOut { training_rows, held_out: HeldOut::Spread { rows, min_episodes } } => {
                spread(outline, training_rows, rows, min_episodes)
            }
        }
    }
}

/// `want` rows from `start` on, cut where episodes end.
fn consecutive(
    outline: &Outline,
    start: usize,
    want: usize,
) -> Result<Vec<Range<usize>>, DataError> {
    let transitions = outline.transitions();
    let end = match start.checked_add(want) {
        _ if want == 0 => return Err(DataError::NoRows),
        Some(end) if end <= transitions => end,
        _ => {
            let path = outline.source.clone();
            return Err(DataError::TooFewRows { path, start, want, transitions });
        }
    };
    let cut = |episode: &Range<usize>| episode.start.max(start)..episode.end.min(end);
    Ok(outline.episodes.iter().map(cut).filter(|range| !range.is_empty()).collect())
}

fn spread(
    outline: &Outline,
    training_rows: usize,
    rows: usize,
    min_episodes: usize,
) -> Result<Vec<Range<usize>>, DataError> {
    if rows == 0 {
        return Err(DataError::NoRows);
    }
    let episodes = &outline.episodes;
    let unseen = &episodes[episodes.partition_point(|episode| episode.start < training_rows)..];
    let chosen = (min_episodes.max(1)..=unseen.len().min(rows))
        .map(|count| evenly(unseen, count))
        .find(|chosen| chosen.iter().map(ExactSizeIterator::len).sum::<usize>() >= rows);
    let Some(chosen) = chosen else {
        return Err(DataError::TooFewHeldOut {
            path: outline.source.clone(),
            rows,
            min_episodes,
            episodes: unseen.len(),
            available: unseen.iter().map(ExactSizeIterator::len).sum(),
            training_rows,
        });
    };
    let lengths = share(&chosen, rows);
    let last = chosen.len().saturating_sub(1).max(1);
    let run = |(i, (episode, length)): (usize, (&Range<usize>, usize))| {
        // From the start of the first episode to the end of the last.
        let start = episode.start + (episode.len() - length) * i / last;
        start..start + length
    };
    Ok(chosen.iter().zip(lengths).enumerate().map(run).collect())
}

/// `count` ≤ `episodes.len()` episodes, each from the middle of as many equal parts.
fn evenly(episodes: &[Range<usize>], count: usize) -> Vec<Range<usize>> {
    (0..count).map(|i| episodes[(2 * i + 1) * episodes.len() / (2 * count)].clone()).collect()
}

/// How many of `rows` each episode gives: at least one, all as many where none is too short.
fn share(episodes: &[Range<usize>], rows: usize) -> Vec<usize> {
    let mut by_length: Vec<usize> = (0..episodes.len()).collect();
    by_length.sort_by_key(|&i| episodes[i].len());
    let mut lengths = vec![0; episodes.len()];
    let mut rest = rows;
    for (done, i) in by_length.into_iter().enumerate() {
        lengths[i] = episodes[i].len().min(rest / (episodes.len() - done));
        rest -= lengths[i];
    }
    lengths
}

#[cfg(test)]
mod tests;
