//! What one episode holds.

use std::borrow::Cow;

/// One episode of L transitions. Lists of rows are flat, row-major.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Episode<'a> {
    /// Counted from 0.
    pub index: u32,
    /// `[L, observation_size]`: before each action.
    pub observations: Cow<'a, [f64]>,
    /// `[L, action_size]`.
    pub actions: Cow<'a, [f32]>,
    /// `[L]`.
    pub rewards: Cow<'a, [f64]>,
    /// `[L, observation_size]`: after each action, the last one included.
    pub next_observations: Cow<'a, [f64]>,
    /// `[L, nq]`: generalised positions before each action.
    pub qpos: Cow<'a, [f64]>,
    /// `[L, nv]`: generalised velocities before each action.
    pub qvel: Cow<'a, [f64]>,
    /// `[L]`: log density of each action; empty if unknown.
    pub action_log_probs: Cow<'a, [f64]>,
    /// The task ended it.
    pub terminated: bool,
    /// The time limit ended it, or the recording stopped.
    pub timed_out: bool,
}

impl Episode<'_> {
    /// Number of transitions.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rewards.len()
    }

    /// True without transitions.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rewards.is_empty()
    }
}
