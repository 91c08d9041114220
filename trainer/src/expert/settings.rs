//! What decides a run.

use std::cmp::Ordering;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::expert::critic::CriticKind;
use crate::learning::config::from_json;
use crate::learning::error::TrainError;

/// Everything that can be chosen about the training of an expert.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExpertSettings {
    /// Environment id; the expert sees what it shows.
    pub env: String,
    /// How the critics estimate returns.
    pub critic: CriticKind,
    /// Transitions to collect in all.
    pub steps: u64,
    /// Of everything that is random.
    pub seed: u64,
    /// Environments side by side.
    pub num_envs: usize,
    /// Updates for each transition.
    pub updates_per_step: f64,
    /// Transitions of an update.
    pub batch: usize,
    /// Transitions that are kept; the oldest go first.
    pub replay: usize,
    /// Transitions of uniformly random actions before the first update.
    pub learning_starts: u64,
    /// Transitions that a resumed run without its replay collects before it updates anything, at
    /// most as many as the interrupted run kept. Few of them are all alike, and undo what was
    /// learned: ant collapsed after 200 000 and went on after 1 000 000.
    pub refill: u64,
    /// Of Adam, for all networks and the temperature.
    pub learning_rate: f64,
    /// γ.
    pub discount: f64,
    /// The most that a step's reward counts for in what is learnt; none: no limit. An expert that gains
    /// nothing by going faster learns to fall less.
    #[serde(default)]
    pub reward_cap: Option<f64>,
    /// Least and greatest height of the torso, the first number of a full observation, beyond which what
    /// is learnt takes the episode for ended; none: only where the task ends it. Narrower than the task's
    /// own, it teaches to keep a distance from its ends.
    #[serde(default)]
    pub healthy_z_range: Option<[f64; 2]>,
    /// Share of the critics that enters their slow copies with each update.
    pub polyak: f64,
    /// Updates of the critics for each one of the actor.
    pub actor_every: u64,
    /// Share of the actor that enters its slow copy with each of its updates. The copy is what is
    /// evaluated and exported; 1: the actor itself.
    #[serde(default = "whole")]
    pub actor_average: f64,
    /// Width of the two hidden layers of each network.
    pub hidden: usize,
    /// Quantiles of each critic.
    pub quantiles: usize,
    /// Quantiles for each critic that are dropped, the highest of all.
    pub dropped_quantiles: usize,
    /// α before the first update.
    pub initial_temperature: f64,
    /// Entropy that the temperature aims at, in nats; none: -(action size).
    pub target_entropy: Option<f64>,
    /// Standard deviation of the pushes that are added to the actions on their way to the environments,
    /// not to those that are learnt from; 0: none. They are to teach a gait that bears errors.
    #[serde(default)]
    pub perturbation: f64,
    /// Steps that a push lasts: two pushes in a row have the correlation 1 - 1/this.
    #[serde(default = "whole")]
    pub perturbation_duration: f64,
    /// Steps after which an episode is cut while it is learnt from, as by a time limit; none: where the
    /// task ends it. A start is a rare thing in long episodes, and badly learnt.
    #[serde(default)]
    pub episode_steps: Option<u64>,
    /// Transitions between two reports.
    pub log_every: u64,
    /// Transitions between two evaluations.
    pub evaluate_every: u64,
    /// Episodes of an evaluation.
    pub episodes: u32,
    /// Transitions between two checkpoints.
    pub checkpoint_every: u64,
}

/// A setting that a resumed run changed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Transitions that had been collected.
    pub step: u64,
    /// Which setting.
    pub name: String,
    /// Its value until then.
    pub before: Value,
    /// Its value from then on.
    pub after: Value,
}

/// Settings that say how long a run is, how it reports and how it begins anew, not how it learns.
const OF_THE_PROCESS: [&str; 6] =
    ["steps", "refill", "log_every", "evaluate_every", "episodes", "checkpoint_every"];

fn whole() -> f64 {
    1.0
}

/// The settings as TOML.
///
/// # Errors
/// [`TrainError::Setting`], which no settings cause.
pub fn to_toml(settings: &ExpertSettings) -> Result<String, TrainError> {
    toml::to_string(settings).map_err(|error| TrainError::Setting { message: error.to_string() })
}

impl Default for ExpertSettings {
    /// The recipe of Kuznetsov et al. (2020), smaller (two critics of 256-256 instead of five of
    /// 512-512-512, the actor with every other update), for a machine on which a simulated step is much
    /// cheaper than an update.
    fn default() -> Self {
        Self {
            env: "hopper".into(),
            critic: CriticKind::Tqc,
            steps: 8_000_000,
            seed: 0,
            num_envs: 16,
            updates_per_step: 0.25,
            batch: 256,
            replay: 1_000_000,
            learning_starts: 10_000,
            refill: 1_000_000,
            learning_rate: 3e-4,
            discount: 0.99,
            reward_cap: None,
            healthy_z_range: None,
            polyak: 0.005,
            actor_every: 2,
            actor_average: whole(),
            hidden: 256,
            quantiles: 25,
            dropped_quantiles: 2,
            initial_temperature: 1.0,
            target_entropy: None,
            perturbation: 0.0,
            perturbation_duration: whole(),
            episode_steps: None,
            log_every: 5_000,
            evaluate_every: 50_000,
            episodes: 10,
            checkpoint_every: 20_000,
        }
    }
}

impl ExpertSettings {
    /// The defaults for a task.
    #[must_use]
    pub fn for_task(env: &str) -> Self {
        let defaults = Self { env: env.to_owned(), ..Self::default() };
        // Kuznetsov et al. drop more where overestimation hurts most. On ant, the lower of two means
        // is as quick and steadier; its actor still jumps, and the mean of its last thousand does not.
        match env.split('-').next() {
            Some("hopper") => Self { dropped_quantiles: 5, ..defaults },
            Some("halfcheetah") => Self { dropped_quantiles: 0, ..defaults },
            Some("ant") => Self { critic: CriticKind::Sac, actor_average: 1e-3, ..defaults },
            _ => defaults,
        }
    }

    /// Refuses what no run can have.
    ///
    /// # Errors
    /// [`TrainError::Setting`].
    pub fn validate(&self) -> Result<(), TrainError> {
        let refuse = |message: String| Err(TrainError::Setting { message });
        let counts = [
            ("steps", self.steps),
            ("num_envs", self.num_envs as u64),
            ("batch", self.batch as u64),
            ("replay", self.replay as u64),
            ("learning_starts", self.learning_starts),
            ("actor_every", self.actor_every),
            ("hidden", self.hidden as u64),
            ("quantiles", self.quantiles as u64),
            ("log_every", self.log_every),
            ("evaluate_every", self.evaluate_every),
            ("episode_steps", self.episode_steps.unwrap_or(1)),
            ("episodes", u64::from(self.episodes)),
            ("checkpoint_every", self.checkpoint_every),
        ];
        if let Some((name, _)) = counts.iter().find(|(_, value)| *value == 0) {
            return refuse(format!("{name} is 0; expected at least 1"));
        }
        let positive = [
            ("updates_per_step", self.updates_per_step),
            ("learning_rate", self.learning_rate),
            ("initial_temperature", self.initial_temperature),
        ];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return refuse(format!("{name} is {value}; expected a finite number above 0"));
            }
        }
        let shares = [
            ("discount", self.discount),
            ("polyak", self.polyak),
            ("actor_average", self.actor_average),
        ];
        for (name, value) in shares {
            if !(value > 0.0 && value <= 1.0) {
                return refuse(format!("{name} is {value}; expected a number in (0, 1]"));
            }
        }
        for (name, value) in
            [("target_entropy", self.target_entropy), ("reward_cap", self.reward_cap)]
        {
            if let Some(value) = value.filter(|&value| !(value as f32).is_finite()) {
                return refuse(format!(
                    "{name} is {value}; expected a finite single-precision number"
                ));
            }
        }
        if let Some([least, greatest]) = self.healthy_z_range
            && least.partial_cmp(&greatest) != Some(Ordering::Less)
        {
            return refuse(format!(
                "healthy_z_range is [{least}, {greatest}]; expected the lower height first"
            ));
        }
        // Actions are in [-1, 1]: a wider push is as good as one that always reaches an end.
        if !(0.0..=10.0).contains(&self.perturbation) {
            let value = self.perturbation;
            return refuse(format!("perturbation is {value}; expected a number from 0 to 10"));
        }
        if !(self.perturbation_duration.is_finite() && self.perturbation_duration >= 1.0) {
            let value = self.perturbation_duration;
            return refuse(format!("perturbation_duration is {value}; expected at least 1 step"));
        }
        if self.dropped_quantiles >= self.quantiles {
            return refuse(format!(
                "dropped_quantiles is {}; expected fewer than the {} quantiles",
                self.dropped_quantiles, self.quantiles
            ));
        }
        if (self.replay as u64) < self.learning_starts.max(self.batch as u64) {
            return refuse(format!(
                "replay is {}; expected at least learning_starts ({}) and batch ({})",
                self.replay, self.learning_starts, self.batch
            ));
        }
        Ok(())
    }

    /// What changes about learning when a run with these settings goes on with `next` after `step`
    /// transitions.
    #[must_use]
    pub fn changes_to(&self, next: &Self, step: u64) -> Vec<Change> {
        let (Ok(Value::Object(old)), Ok(Value::Object(new))) =
            (serde_json::to_value(self), serde_json::to_value(next))
        else {
            return Vec::new();
        };
        let pairs = old.into_iter().zip(new.into_iter().map(|(_, value)| value));
        let differing = pairs.filter(|((name, before), after)| {
            before != after && !OF_THE_PROCESS.contains(&name.as_str())
        });
        differing.map(|((name, before), after)| Change { step, name, before, after }).collect()
    }

    /// The settings that a run began with which has these after `changes`.
    ///
    /// # Errors
    /// [`TrainError::Setting`] if a change is of no setting's kind.
    pub fn before(&self, changes: &[Change]) -> Result<Self, TrainError> {
        let failed = |error: serde_json::Error| TrainError::Setting { message: error.to_string() };
        let mut value = serde_json::to_value(self).map_err(failed)?;
        for Change { name, before, .. } in changes.iter().rev() {
            value[name] = before.clone();
        }
        from_json(value)
    }

    /// True if a run with `other` can go on with these: how long it runs, how it reports, how much it
    /// collects and how it learns from there on may differ; what it is and what its networks are, not.
    #[must_use]
    pub fn continues(&self, other: &Self) -> bool {
        let reporting = Self {
            steps: self.steps,
            refill: self.refill,
            log_every: self.log_every,
            evaluate_every: self.evaluate_every,
            episodes: self.episodes,
            checkpoint_every: self.checkpoint_every,
            num_envs: self.num_envs,
            updates_per_step: self.updates_per_step,
            replay: self.replay,
            learning_rate: self.learning_rate,
            reward_cap: self.reward_cap,
            healthy_z_range: self.healthy_z_range,
            actor_every: self.actor_every,
            actor_average: self.actor_average,
            target_entropy: self.target_entropy,
            perturbation: self.perturbation,
            perturbation_duration: self.perturbation_duration,
            episode_steps: self.episode_steps,
            ..other.clone()
        };
        *self == reporting
    }
}
