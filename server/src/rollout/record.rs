//! Collection: every transition, in the order of episodes.

use std::collections::BTreeMap;

use palr_gym_sim::Transition;

use super::actor::Actor;
use super::play::{Log, Observer, Plan, Slot, play};
use crate::error::ServerError;

/// How much to collect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Amount {
    /// Exactly this many transitions; the last episode is cut.
    Transitions(u64),
    /// This many whole episodes.
    Episodes(u32),
}

/// One episode of L transitions. Every list of rows is flat.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EpisodeTransitions {
    /// Counted from 0.
    pub index: u32,
    /// The environment's seed.
    pub seed: u64,
    /// `[L, observation_size]`.
    pub observations: Vec<f64>,
    /// `[L, action_size]`.
    pub actions: Vec<f32>,
    /// `[L]`.
    pub rewards: Vec<f64>,
    /// `[L, observation_size]`.
    pub next_observations: Vec<f64>,
    /// `[L, nq]`, before each action.
    pub qpos: Vec<f64>,
    /// `[L, nv]`, before each action.
    pub qvel: Vec<f64>,
    /// `[L]`, or empty if the policy states no density.
    pub action_log_probs: Vec<f64>,
    /// The task ended it.
    pub terminated: bool,
    /// The time limit ended it.
    pub truncated: bool,
    /// It was cut where the requested number of transitions was reached.
    pub cut: bool,
}

impl EpisodeTransitions {
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

    /// Keeps the first `length` transitions.
    fn cut_to(&mut self, length: usize) {
        let all = self.len();
        if length >= all {
            return;
        }
        let keep = |values: usize| values / all * length;
        self.observations.truncate(keep(self.observations.len()));
        self.actions.truncate(keep(self.actions.len()));
        self.next_observations.truncate(keep(self.next_observations.len()));
        self.qpos.truncate(keep(self.qpos.len()));
        self.qvel.truncate(keep(self.qvel.len()));
        self.action_log_probs.truncate(keep(self.action_log_probs.len()));
        self.rewards.truncate(length);
        (self.terminated, self.truncated, self.cut) = (false, false, true);
    }
}

impl Log for EpisodeTransitions {
    fn before_step(&mut self, slot: &Slot) {
        self.observations.extend_from_slice(slot.env.observation());
        self.actions.extend_from_slice(&slot.action);
        self.qpos.extend_from_slice(slot.env.state().qpos());
        self.qvel.extend_from_slice(slot.env.state().qvel());
        self.action_log_probs.extend(slot.action_log_prob);
    }

    fn after_step(&mut self, slot: &Slot, transition: Transition) {
        self.rewards.push(transition.reward);
        self.next_observations.extend_from_slice(slot.env.observation());
    }
}

struct Collection<'a, F> {
    plan: &'a Plan,
    amount: Amount,
    first_episode: u32,
    /// The next episode to start.
    next: u32,
    /// The next episode to hand out; later ones wait for it.
    due: u32,
    waiting: BTreeMap<u32, EpisodeTransitions>,
    /// Transitions in finished episodes, handed out or waiting.
    finished: u64,
    handed_out: u64,
    on_episode: F,
}

impl<F: FnMut(EpisodeTransitions) -> bool + Sync> Observer for Collection<'_, F> {
    type Log = EpisodeTransitions;

    /// Episodes of unknown length are started only while all that are playing, at their longest,
    /// would still leave room: nothing is played that is sure to be thrown away.
    fn next_episode(&mut self, playing: usize) -> Option<u32> {
        let wants_more = match self.amount {
            Amount::Episodes(episodes) => self.next - self.first_episode < episodes,
            Amount::Transitions(transitions) => {
                let longest = u64::from(self.plan.spec.task.max_episode_steps);
                self.finished + playing as u64 * longest < transitions
            }
        };
        wants_more.then(|| {
            self.next += 1;
            self.next - 1
        })
    }

    fn ended(&mut self, slot: &Slot, transition: Transition, mut log: EpisodeTransitions) -> bool {
        let Some(index) = slot.episode else { return true };
        (log.index, log.seed) = (index, self.plan.seed_of(index));
        (log.terminated, log.truncated) = (transition.terminated, transition.truncated);
        self.finished += log.len() as u64;
        self.waiting.insert(index, log);
        while let Some(mut episode) = self.waiting.remove(&self.due) {
            self.due += 1;
            if let Amount::Transitions(transitions) = self.amount {
                episode.cut_to((transitions - self.handed_out) as usize);
            }
            self.handed_out += episode.len() as u64;
            let is_enough = self.amount == Amount::Transitions(self.handed_out);
            if !(self.on_episode)(episode) || is_enough {
                return false;
            }
        }
        true
    }
}

/// Plays episodes from `first_episode` on and hands each to `on_episode` in order; `false` from
/// there stops.
///
/// # Errors
/// Whatever environments or policy fail with.
pub fn collect(
    plan: &Plan,
    actor: &mut Actor,
    amount: Amount,
    first_episode: u32,
    on_episode: impl FnMut(EpisodeTransitions) -> bool + Sync,
) -> Result<(), ServerError> {
    let mut collection = Collection {
        plan,
        amount,
        first_episode,
        next: first_episode,
        due: first_episode,
        waiting: BTreeMap::new(),
        finished: 0,
        handed_out: 0,
        on_episode,
    };
    play(plan, actor, &mut collection)
}
