//! What a run reports while it trains.

use serde::{Deserialize, Serialize};

use crate::imitate::records::Stepped;

/// A line of `metrics.jsonl`: means over what happened since the line before.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExpertMetrics {
    /// Transitions collected.
    pub step: u64,
    /// Updates.
    pub updates: u64,
    /// Undiscounted return of the episodes that ended; null if none did.
    pub training_return: Option<f64>,
    /// Sum of both critics' losses.
    pub critic_loss: f64,
    /// mean(α log π - value).
    pub actor_loss: f64,
    /// Mean value of the policy's actions.
    pub value: f64,
    /// Of the policy, in nats.
    pub entropy: f64,
    /// α.
    pub temperature: f64,
    /// Seconds that the run has taken in all.
    pub wall_time_s: f64,
}

impl Stepped for ExpertMetrics {
    fn step(&self) -> u64 {
        self.step
    }

    fn scalars(&self) -> Vec<(String, f64)> {
        let mut scalars = vec![
            ("training/updates".into(), self.updates as f64),
            ("training/critic_loss".into(), self.critic_loss),
            ("training/actor_loss".into(), self.actor_loss),
            ("training/value".into(), self.value),
            ("training/entropy".into(), self.entropy),
            ("training/temperature".into(), self.temperature),
        ];
        scalars.extend(self.training_return.map(|value| ("training/return".into(), value)));
        scalars
    }
}
