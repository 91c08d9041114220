//! Rows as a learner meets them: masked, stacked, with past actions.
//!
//! What an agent sees online and what a learner is given offline is one definition:
//! [`palr_gym_core::FrameStack`], which the simulation drives step by step and this file row by row.

use std::ops::Range;

use ndarray::Array2;
use palr_gym_core::env_id::MAX_FRAME_STACK;
use palr_gym_core::{EnvId, EnvSpec, Fidelity, FrameStack, Mask, ObservationKind};

use crate::error::DataError;
use crate::recording::{BLOCK_ROWS, Outline, Recording, Rows};
use crate::selection::Selection;

/// Columns of ant's files that hold its 27 entries first and then contact forces: Gymnasium's
/// `Ant-v5`, and D4RL.
const ANT_COLUMNS: &[usize] = &[105, 111];

/// What an agent sees of a task.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct View {
    /// The task's name.
    pub task: String,
    /// As what its data are recorded: as full observations, of which `mask_indices` are kept, or as
    /// the paper's mask shows pictures, of which everything is.
    pub recorded_as: Mask,
    /// Entries of a recorded observation, D: of the task's full one, or features of a picture.
    pub full_observation_size: usize,
    /// Entries of an action, A.
    pub action_size: usize,
    /// Indices into the full observation that the agent sees, d of them.
    pub mask_indices: Vec<usize>,
    /// Observations in a stack, w.
    pub frame_stack: usize,
    /// Which of Gymnasium's definitions of the task.
    pub fidelity: Fidelity,
}

impl From<&EnvSpec> for View {
    fn from(spec: &EnvSpec) -> Self {
        Self {
            task: spec.task.name.to_owned(),
            recorded_as: match spec.observation {
                ObservationKind::State => Mask::Full,
                ObservationKind::Features { .. } | ObservationKind::Pixels => spec.env_id.mask,
            },
            full_observation_size: match spec.observation {
                ObservationKind::State => spec.task.observation.len(),
                ObservationKind::Features { .. } | ObservationKind::Pixels => spec.frame_size(),
            },
            action_size: spec.action_size(),
            mask_indices: match spec.observation {
                ObservationKind::State => spec.mask_indices.clone(),
                ObservationKind::Features { .. } | ObservationKind::Pixels => {
                    (0..spec.frame_size()).collect()
                }
            },
            frame_stack: spec.env_id.frame_stack,
            fidelity: spec.env_id.fidelity,
        }
    }
}

impl View {
    /// Entries of a stacked observation, w·d.
    #[must_use]
    pub fn observation_size(&self) -> usize {
        self.frame_stack * self.mask_indices.len()
    }

    /// True if a recorded row may be a stack, whose last frame is the row's own.
    fn records_stacks(&self) -> bool {
        self.recorded_as != Mask::Full
    }

    /// Checks that the view makes sense and that the data set is of its task, unmasked.
    fn check(&self, outline: &Outline) -> Result<(), DataError> {
        let task = || self.task.clone();
        if self.mask_indices.is_empty() {
            return Err(DataError::EmptyMask { task: task() });
        }
        let size = self.full_observation_size;
        if let Some(&index) = self.mask_indices.iter().find(|&&index| index >= size) {
            return Err(DataError::MaskIndex { task: task(), index, size });
        }
        if !(1..=MAX_FRAME_STACK).contains(&self.frame_stack) {
            let (got, max) = (self.frame_stack, MAX_FRAME_STACK);
            return Err(DataError::FrameStack { task: task(), got, max });
        }
        let path = || outline.source.clone();
        let want =
            EnvId { task: task(), mask: self.recorded_as, fidelity: self.fidelity, frame_stack: 1 };
        // The definitions of a task have columns in common, but not rewards, ends of episodes and
        // bodies: data of one are not those of the other.
        let got = outline.env_id.as_deref();
        let is_other = got.is_some_and(|got| match got.parse::<EnvId>() {
            Ok(named) if self.records_stacks() => EnvId { frame_stack: 1, ..named } != want,
            Ok(named) => named != want,
            // Of Gymnasium's own names, such as `HalfCheetah-v4`, columns tell the task.
            Err(_) => gymnasium_fidelity(got).is_some_and(|fidelity| fidelity != self.fidelity),
        });
        if is_other {
            let (got, want) = (got.unwrap_or_default().to_owned(), want.to_string());
            return Err(DataError::Environment { path: path(), got, task: task(), want });
        }
        let also = if self.task == "ant" { ANT_COLUMNS } else { &[] };
        for (dataset, got, want, also) in [
            ("observations", outline.observation_size, size, also),
            ("actions", outline.action_size, self.action_size, &[]),
        ] {
            // Contact forces that only some files have may be left out of the view, not out of the file.
            let holds_mask = || self.mask_indices.iter().all(|&index| index < got);
            let is_stack = || self.records_stacks() && got > 0 && got.is_multiple_of(want);
            let is_observation = dataset == "observations";
            let will_do =
                || (also.contains(&got) && holds_mask()) || (is_observation && is_stack());
            if got != want && !will_do() {
                let (path, task) = (path(), task());
                return Err(DataError::Columns { path, dataset, got, want, also, task });
            }
        }
        Ok(())
    }
}

/// Which definition a name of Gymnasium's means; none for other names and versions.
fn gymnasium_fidelity(name: &str) -> Option<Fidelity> {
    let (task, version) = name.rsplit_once("-v")?;
    let is_task = ["Hopper", "Walker2d", "HalfCheetah", "Ant"].contains(&task);
    match version {
        "4" if is_task => Some(Fidelity::Gym4),
        "5" if is_task => Some(Fidelity::Gym5),
        _ => None,
    }
}

/// Rows of a data set as a learner meets them.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    /// `[n, w·d]`: masked and stacked, oldest first, zeros before an episode's first observation;
    /// not standardised.
    pub observations: Array2<f32>,
    /// `[n, A]`: what the expert did.
    pub actions: Array2<f32>,
    /// `[n, A]`: what the expert did one step before; zeros at the first step of an episode.
    pub past_actions: Array2<f32>,
    /// How many of the rows each episode gave, in order; they sum to n.
    pub episode_lengths: Vec<usize>,
}

impl Samples {
    /// The selected rows of a data set as `view` shows them. No others are read, but for those that
    /// stacks and past actions reach back to: the beginning of an episode at most.
    ///
    /// # Errors
    /// Those of [`Selection::row_ranges`] and [`Recording::rows`]; [`DataError::EmptyMask`],
    /// [`DataError::MaskIndex`] and [`DataError::FrameStack`] for a view that makes no sense;
    /// [`DataError::Environment`] and [`DataError::Columns`] for the data of another task.
    pub fn select(
        recording: &dyn Recording,
        view: &View,
        selection: Selection,
    ) -> Result<Self, DataError> {
        view.check(recording.outline())?;
        let ranges = selection.row_ranges(recording.outline())?;
        let episode_lengths: Vec<usize> = ranges.iter().map(ExactSizeIterator::len).collect();
        let n = episode_lengths.iter().sum();
        let mut samples = Self {
            observations: Array2::zeros((n, view.observation_size())),
            actions: Array2::zeros((n, view.action_size)),
            past_actions: Array2::zeros((n, view.action_size)),
            episode_lengths,
        };
        let mut slot = 0;
        for range in ranges {
            for start in range.clone().step_by(BLOCK_ROWS) {
                let rows = start..range.end.min(start + BLOCK_ROWS);
                slot = samples.fill(recording, view, rows, slot)?;
            }
        }
        Ok(samples)
    }

    /// All rows' stacked observations, block by block, `[n, w·d]` each.
    ///
    /// # Errors
    /// As [`select`](Self::select).
    pub fn for_each_block_of_observations(
        recording: &dyn Recording,
        view: &View,
        visit: &mut dyn FnMut(&[f32]),
    ) -> Result<(), DataError> {
        let outline = recording.outline();
        view.check(outline)?;
        for episode in &outline.episodes {
            for start in episode.clone().step_by(BLOCK_ROWS) {
                let rows = start..episode.end.min(start + BLOCK_ROWS);
                let mut block = Self {
                    observations: Array2::zeros((rows.len(), view.observation_size())),
                    actions: Array2::zeros((rows.len(), view.action_size)),
                    past_actions: Array2::zeros((rows.len(), view.action_size)),
                    episode_lengths: vec![rows.len()],
                };
                block.fill(recording, view, rows, 0)?;
                visit(block.observations.as_slice().unwrap_or_default());
            }
        }
        Ok(())
    }

    /// Puts `rows`, which are of one episode, into the slots from `slot` on; tells the next one.
    fn fill(
        &mut self,
        recording: &dyn Recording,
        view: &View,
        rows: Range<usize>,
        slot: usize,
    ) -> Result<usize, DataError> {
        let episode_start = recording.outline().episode_start(rows.start);
        // A stack reaches back over w - 1 rows, a past action over one.
        let reach = (view.frame_stack - 1).max(1);
        let first = rows.start.saturating_sub(reach).max(episode_start);
        let read = recording.rows(first..rows.end)?;
        let mut stack = FrameStack::new(view.mask_indices.len(), view.frame_stack);
        for row in first..rows.end {
            let at = row - first;
            push(&mut stack, view, &read, at);
            let Some(offset) = row.checked_sub(rows.start) else { continue };
            for (entry, &value) in
                self.observations.row_mut(slot + offset).iter_mut().zip(stack.stacked())
            {
                // It was float32 before, so nothing is lost.
                *entry = value as f32;
            }
            self.actions.row_mut(slot + offset).assign(&read.actions.row(at));
            if row > episode_start {
                self.past_actions.row_mut(slot + offset).assign(&read.actions.row(at - 1));
            }
        }
        Ok(slot + rows.len())
    }

    /// Number of rows, n ≥ 1.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.actions.nrows()
    }
}

fn push(stack: &mut FrameStack, view: &View, rows: &Rows<'_>, at: usize) {
    let observation = rows.observations.row(at);
    // Of a recorded stack, the newest frame is the last.
    let first = match view.records_stacks() {
        true => observation.len() - view.full_observation_size,
        false => 0,
    };
    stack.push(view.mask_indices.iter().map(|&index| f64::from(observation[first + index])));
}

#[cfg(test)]
mod tests;
