//! Rows as a learner meets them: masked, stacked, with past actions.
//!
//! What an agent sees online and what a learner is given offline is one definition:
//! [`palr_gym_core::FrameStack`], which the simulation drives step by step and this file row by row.

use ndarray::{Array2, ArrayViewMut1};
use palr_gym_core::env_id::MAX_FRAME_STACK;
use palr_gym_core::{EnvId, EnvSpec, Fidelity, FrameStack, Mask, ObservationKind};

use crate::demonstrations::Demonstrations;
use crate::error::DataError;
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

    /// Checks that the view makes sense and that `demonstrations` are of its task, unmasked.
    fn check(&self, demonstrations: &Demonstrations) -> Result<(), DataError> {
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
        let path = || demonstrations.source().to_path_buf();
        let want =
            EnvId { task: task(), mask: self.recorded_as, fidelity: self.fidelity, frame_stack: 1 };
        // The definitions of a task have columns in common, but not rewards, ends of episodes and
        // bodies: data of one are not those of the other.
        let got = demonstrations.env_id();
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
        for (dataset, values, want, also) in [
            ("observations", demonstrations.observations(), size, also),
            ("actions", demonstrations.actions(), self.action_size, &[]),
        ] {
            let got = values.ncols();
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
    /// The selected rows of `demonstrations` as `view` shows them.
    ///
    /// Stacks and past actions reach back to the beginning of an episode, to rows before the
    /// selection as well, and never beyond.
    ///
    /// # Errors
    /// Those of [`Selection::row_ranges`]; [`DataError::EmptyMask`], [`DataError::MaskIndex`] and
    /// [`DataError::FrameStack`] for a view that makes no sense; [`DataError::Environment`] and
    /// [`DataError::Columns`] for the data of another task.
    pub fn select(
        demonstrations: &Demonstrations,
        view: &View,
        selection: Selection,
    ) -> Result<Self, DataError> {
        view.check(demonstrations)?;
        let ranges = selection.row_ranges(demonstrations)?;
        let episode_lengths: Vec<usize> = ranges.iter().map(ExactSizeIterator::len).collect();
        let n = episode_lengths.iter().sum();
        let mut observations = Array2::zeros((n, view.observation_size()));
        let mut actions = Array2::zeros((n, view.action_size));
        let mut past_actions = Array2::zeros((n, view.action_size));
        let mut stacks = Stacks::new(demonstrations, view);
        let mut slot = 0;
        for range in ranges {
            let episode_start = episode_start(demonstrations, range.start);
            stacks.begin(episode_start, range.start);
            for row in range {
                stacks.push(row, observations.row_mut(slot));
                actions.row_mut(slot).assign(&demonstrations.actions().row(row));
                if row > episode_start {
                    past_actions.row_mut(slot).assign(&demonstrations.actions().row(row - 1));
                }
                slot += 1;
            }
        }
        Ok(Self { observations, actions, past_actions, episode_lengths })
    }

    /// Number of rows, n ≥ 1.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.actions.nrows()
    }
}

/// First row of the episode that `row` is in.
fn episode_start(demonstrations: &Demonstrations, row: usize) -> usize {
    let episodes = demonstrations.episodes();
    episodes[episodes.partition_point(|episode| episode.end <= row)].start
}

/// A frame stack driven by a data set's rows.
struct Stacks<'a> {
    demonstrations: &'a Demonstrations,
    view: &'a View,
    stack: FrameStack,
}

impl<'a> Stacks<'a> {
    fn new(demonstrations: &'a Demonstrations, view: &'a View) -> Self {
        let stack = FrameStack::new(view.mask_indices.len(), view.frame_stack);
        Self { demonstrations, view, stack }
    }

    /// Makes the stack that of `row` just before its own observation.
    fn begin(&mut self, episode_start: usize, row: usize) {
        self.stack.clear();
        // Older rows would be pushed out again.
        let oldest = (row + 1).saturating_sub(self.view.frame_stack).max(episode_start);
        (oldest..row).for_each(|row| self.observe(row));
    }

    fn push(&mut self, row: usize, mut slot: ArrayViewMut1<'_, f32>) {
        self.observe(row);
        for (slot, &entry) in slot.iter_mut().zip(self.stack.stacked()) {
            // It was float32 before, so nothing is lost.
            *slot = entry as f32;
        }
    }

    fn observe(&mut self, row: usize) {
        let observation = self.demonstrations.observations().row(row);
        // Of a recorded stack, the newest frame is the last.
        let first = match self.view.records_stacks() {
            true => observation.len() - self.view.full_observation_size,
            false => 0,
        };
        let indices = self.view.mask_indices.iter();
        self.stack.push(indices.map(|&index| f64::from(observation[first + index])));
    }
}

#[cfg(test)]
mod tests;
