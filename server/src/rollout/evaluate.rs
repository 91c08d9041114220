//! Evaluation: returns and scores.

use std::time::Instant;

use palr_gym_core::score::{
    interquartile_mean, interquartile_mean_interval, mean, normalized_score, standard_error,
};
use palr_gym_sim::Transition;

use super::actor::Actor;
use super::play::{Observer, Plan, Slot, play};
use crate::error::ServerError;

/// One finished episode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EpisodeResult {
    /// Counted from 0.
    pub index: u32,
    /// The environment's seed.
    pub seed: u64,
    /// Undiscounted.
    pub episode_return: f64,
    /// After D4RL.
    pub normalized_score: f64,
    /// Steps.
    pub length: u32,
    /// The task ended it.
    pub terminated: bool,
    /// The time limit ended it.
    pub truncated: bool,
}

/// What all episodes say together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EvaluationSummary {
    /// How many.
    pub episodes: u32,
    /// Mean return.
    pub return_mean: f64,
    /// Standard error of the mean return.
    pub return_standard_error: f64,
    /// Mean normalised score.
    pub score_mean: f64,
    /// Standard error of the mean score.
    pub score_standard_error: f64,
    /// Interquartile mean of the scores.
    pub score_interquartile_mean: f64,
    /// Its 95 % bootstrap interval.
    pub score_interquartile_mean_interval: (f64, f64),
    /// Mean length.
    pub length_mean: f64,
    /// Environment steps in all episodes.
    pub steps: u64,
    /// Seconds from the first reset to the end of the last episode.
    pub wall_time_s: f64,
    /// Environments side by side.
    pub num_envs: usize,
}

struct Evaluation<'a, F> {
    plan: &'a Plan,
    episodes: u32,
    started: u32,
    results: Vec<EpisodeResult>,
    on_episode: F,
}

impl<F: FnMut(EpisodeResult) -> bool + Sync> Observer for Evaluation<'_, F> {
    type Log = ();

    fn next_episode(&mut self, _playing: usize) -> Option<u32> {
        let index = self.started;
        (index < self.episodes).then(|| {
            self.started += 1;
            index
        })
    }

    fn ended(&mut self, slot: &Slot, transition: Transition, (): ()) -> bool {
        let Some(index) = slot.episode else { return true };
        let result = EpisodeResult {
            index,
            seed: self.plan.seed_of(index),
            episode_return: slot.episode_return,
            normalized_score: normalized_score(
                slot.episode_return,
                self.plan.spec.task.reference_returns,
            ),
            length: slot.length,
            terminated: transition.terminated,
            truncated: transition.truncated,
        };
        self.results.push(result);
        (self.on_episode)(result)
    }
}

/// Plays `episodes` episodes and hands each to `on_episode` as it ends; `false` from there stops.
///
/// # Errors
/// Whatever environments or policy fail with; [`ServerError::Cancelled`] if it was stopped.
pub fn evaluate(
    plan: &Plan,
    actor: &mut Actor,
    episodes: u32,
    on_episode: impl FnMut(EpisodeResult) -> bool + Sync,
) -> Result<EvaluationSummary, ServerError> {
    let started = Instant::now();
    let mut evaluation = Evaluation { plan, episodes, started: 0, results: Vec::new(), on_episode };
    play(plan, actor, &mut evaluation)?;
    let wall_time_s = started.elapsed().as_secs_f64();
    let mut results = evaluation.results;
    if results.len() != episodes as usize {
        return Err(ServerError::Cancelled);
    }
    // Sums in the order of episodes, not of their ends.
    results.sort_by_key(|result| result.index);
    let column = |of: fn(&EpisodeResult) -> f64| results.iter().map(of).collect::<Vec<f64>>();
    let returns = column(|result| result.episode_return);
    let scores = column(|result| result.normalized_score);
    let lengths = column(|result| f64::from(result.length));
    Ok(EvaluationSummary {
        episodes,
        return_mean: mean(&returns),
        return_standard_error: standard_error(&returns),
        score_mean: mean(&scores),
        score_standard_error: standard_error(&scores),
        score_interquartile_mean: interquartile_mean(&scores),
        score_interquartile_mean_interval: interquartile_mean_interval(&scores),
        length_mean: mean(&lengths),
        steps: results.iter().map(|result| u64::from(result.length)).sum(),
        wall_time_s,
        num_envs: plan.num_envs,
    })
}
