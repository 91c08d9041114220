//! Transitions to learn from, the newest of a run.

use std::path::Path;

use palr_gym_core::random::Generator;
use safetensors::tensor::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};

use crate::expert::agent::Batch;
use crate::learning::checkpoint::{read_if_there, write_arrays};
use crate::learning::error::TrainError;

/// The metadata entry of a file that holds a [`Header`].
const HEADER: &str = "palr_gym_replay";

/// What a file's transitions are of.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Header {
    /// Transitions that the run had collected.
    step: u64,
    capacity: usize,
    observation_size: usize,
    action_size: usize,
    next: usize,
    len: usize,
}

/// A ring of transitions.
#[derive(Debug, Clone)]
pub struct Replay {
    observation_size: usize,
    action_size: usize,
    capacity: usize,
    /// Where the next transition goes.
    next: usize,
    len: usize,
    contents: Batch,
}

/// One step of one environment.
#[derive(Debug, Clone, Copy)]
pub struct Transition<'a> {
    /// What was seen.
    pub observation: &'a [f32],
    /// What was done.
    pub action: &'a [f32],
    /// What it brought.
    pub reward: f32,
    /// What was seen then; of the same episode, also where it ended.
    pub next_observation: &'a [f32],
    /// The task ended the episode.
    pub terminated: bool,
}

impl Replay {
    /// An empty ring. Memory is taken as it fills.
    #[must_use]
    pub fn new(observation_size: usize, action_size: usize, capacity: usize) -> Self {
        let contents = Batch::default();
        Self { observation_size, action_size, capacity, next: 0, len: 0, contents }
    }

    /// Writes it to the file at `path`, as that of a run at `step`.
    ///
    /// # Errors
    /// [`TrainError::File`].
    pub fn write(&self, path: &Path, step: u64) -> Result<(), TrainError> {
        let failed = |error: &dyn std::fmt::Display| TrainError::file(path, error);
        let header = serde_json::to_string(&self.header(step)).map_err(|error| failed(&error))?;
        write_arrays(path, (HEADER, header), self.contents.arrays())
    }

    /// What [`Self::write`] left at `path`; false, and nothing changed, if no file is there or it is
    /// of another step or of other sizes.
    ///
    /// # Errors
    /// [`TrainError::File`] if it cannot be read.
    pub fn read(&mut self, path: &Path, step: u64) -> Result<bool, TrainError> {
        let Some(bytes) = read_if_there(path)? else { return Ok(false) };
        let failed = |error: &dyn std::fmt::Display| {
            TrainError::file(
                path,
                format!(
                    "is no replay: {error}. Without the file, the run collects transitions anew"
                ),
            )
        };
        let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(|error| failed(&error))?;
        let header = metadata.metadata().as_ref().and_then(|metadata| metadata.get(HEADER));
        let header = header.ok_or_else(|| failed(&"it has no header"))?;
        let header: Header = serde_json::from_str(header).map_err(|error| failed(&error))?;
        let Header { next, len, .. } = header;
        if header != (Header { next, len, ..self.header(step) }) {
            return Ok(false);
        }
        let tensors = SafeTensors::deserialize(&bytes).map_err(|error| failed(&error))?;
        let mut contents = Batch::default();
        let widths = [self.observation_size, self.action_size, 1, self.observation_size, 1];
        for ((name, array), width) in contents.arrays_mut().into_iter().zip(widths) {
            let view = tensors.tensor(name).map_err(|error| failed(&error))?;
            if view.dtype() != Dtype::F32 || view.shape() != [len * width] {
                let got = format!("{name} is {:?} {:?}", view.dtype(), view.shape());
                return Err(failed(&format!("{got}; expected F32 [{}]", len * width)));
            }
            *array = bytemuck::pod_collect_to_vec(view.data());
        }
        if len > self.capacity || next >= self.capacity || (len < self.capacity && next != len) {
            return Err(failed(&format!("{len} transitions, the next at {next}")));
        }
        (self.contents, self.next, self.len) = (contents, next, len);
        Ok(true)
    }

    fn header(&self, step: u64) -> Header {
        let Self { capacity, observation_size, action_size, next, len, .. } = *self;
        Header { step, capacity, observation_size, action_size, next, len }
    }

    /// Transitions in it.
    #[must_use]
    pub fn len(&self) -> usize {
        self.len
    }

    /// True before the first transition.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Adds a transition, in the place of the oldest if the ring is full.
    pub fn push(&mut self, transition: Transition<'_>) {
        let at = self.next;
        let contents = &mut self.contents;
        put(&mut contents.observations, at, transition.observation);
        put(&mut contents.actions, at, transition.action);
        put(&mut contents.rewards, at, &[transition.reward]);
        put(&mut contents.next_observations, at, transition.next_observation);
        put(&mut contents.continues, at, &[if transition.terminated { 0.0 } else { 1.0 }]);
        self.next = (at + 1) % self.capacity;
        self.len = self.len.max(at + 1);
    }

    /// Draws `n` transitions with replacement into `batch`. The ring must not be empty.
    pub fn draw(&self, generator: &mut Generator, n: usize, batch: &mut Batch) {
        let Batch { observations, actions, rewards, next_observations, continues } = batch;
        for rows in [&mut *observations, actions, rewards, next_observations, continues] {
            rows.clear();
        }
        for _ in 0..n {
            let row = ((generator.next_f64() * self.len as f64) as usize).min(self.len - 1);
            let own = &self.contents;
            take(&own.observations, self.observation_size, row, observations);
            take(&own.actions, self.action_size, row, actions);
            take(&own.rewards, 1, row, rewards);
            take(&own.next_observations, self.observation_size, row, next_observations);
            take(&own.continues, 1, row, continues);
        }
    }
}

fn put(rows: &mut Vec<f32>, at: usize, row: &[f32]) {
    let start = at * row.len();
    if start == rows.len() {
        rows.extend_from_slice(row);
    } else {
        rows[start..start + row.len()].copy_from_slice(row);
    }
}

fn take(rows: &[f32], width: usize, at: usize, out: &mut Vec<f32>) {
    out.extend_from_slice(&rows[at * width..(at + 1) * width]);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(count: usize) -> Replay {
        let mut replay = Replay::new(2, 1, 5);
        for at in 0..count {
            let value = at as f32;
            replay.push(Transition {
                observation: &[value, -value],
                action: &[value + 0.5],
                reward: 10.0 * value,
                next_observation: &[value + 1.0, -value - 1.0],
                terminated: at == 6,
            });
        }
        replay
    }

    #[test]
    fn a_file_holds_all_of_it_for_the_step_that_it_was_written_at() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("replay");
        let mut empty = Replay::new(2, 1, 5);
        assert!(!empty.read(&path, 8).unwrap());
        for count in [3, 5, 8] {
            let whole = filled(count);
            whole.write(&path, 8).unwrap();
            let mut got = Replay::new(2, 1, 5);
            assert!(!got.read(&path, 9).unwrap() && got.is_empty());
            assert!(got.read(&path, 8).unwrap());
            assert_eq!((got.contents, got.next, got.len), (whole.contents, whole.next, whole.len));
        }
        assert!(!Replay::new(2, 1, 6).read(&path, 8).unwrap());
        assert!(!Replay::new(3, 1, 5).read(&path, 8).unwrap());
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
        let error = empty.read(&path, 8).unwrap_err().to_string();
        assert!(error.contains("is no replay"), "{error}");
    }

    #[test]
    fn the_oldest_go_first_and_rows_stay_together() {
        let replay = filled(8);
        assert_eq!(replay.len(), 5);
        let mut batch = Batch::default();
        replay.draw(&mut Generator::from_seed(0), 200, &mut batch);
        for (row, &reward) in batch.rewards.iter().enumerate() {
            let value = reward / 10.0;
            assert!((3.0..=7.0).contains(&value));
            assert_eq!(batch.observations[2 * row..2 * row + 2], [value, -value]);
            assert_eq!(batch.actions[row], value + 0.5);
            assert_eq!(batch.next_observations[2 * row], value + 1.0);
            assert_eq!(batch.continues[row] == 0.0, value == 6.0);
        }
        for value in 3..8 {
            assert!(batch.rewards.contains(&(10.0 * value as f32)));
        }
    }
}
