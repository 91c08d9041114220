//! Transitions to learn from, the newest of a run.

use palr_gym_core::random::Generator;

use crate::expert::agent::Batch;

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

    #[test]
    fn the_oldest_go_first_and_rows_stay_together() {
        let mut replay = Replay::new(2, 1, 5);
        for at in 0..8 {
            let value = at as f32;
            replay.push(Transition {
                observation: &[value, -value],
                action: &[value + 0.5],
                reward: 10.0 * value,
                next_observation: &[value + 1.0, -value - 1.0],
                terminated: at == 6,
            });
        }
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
