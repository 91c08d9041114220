//! What a training run is: everything that decides its bits.

use serde::{Deserialize, Serialize};

use crate::learning::error::TrainError;

/// Which loss is minimised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Algorithm {
    /// Behaviour cloning: the likelihood alone.
    Bc,
    /// The likelihood, and HSCIC of the representation and the past action given the action.
    Palr,
}

/// Where the regulariser's weight matrix M of a step comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WeightsMode {
    /// From the step's own batch, computed anew each step.
    Exact,
    /// From one of `pool_size` batches drawn once; the likelihood stays on fresh batches.
    Pool,
}

/// Settings of the regulariser.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PalrConfig {
    /// α, the weight of HSCIC in the loss.
    pub alpha: f64,
    /// λ of the ridge regression; enters the kernel matrix as n·λ.
    pub ridge: f64,
    /// σ² of all three kernels, `exp(-d² / σ²)`.
    pub bandwidth_sq: f64,
    /// True: both actions are standardised inside HSCIC (the reference code); false: raw (the
    /// paper's text).
    pub standardize_actions: bool,
    /// Where M comes from.
    pub weights: WeightsMode,
    /// Batches in the pool. Each holds n(n+1) bytes: 1 MiB at a batch of 1024.
    pub pool_size: usize,
}

impl Default for PalrConfig {
    /// α of the paper's Table 8 for most tasks (walker2d: 100), λ and σ² of the reference.
    fn default() -> Self {
        Self {
            alpha: 10.0,
            ridge: 1e-5,
            bandwidth_sq: 1.0,
            standardize_actions: true,
            weights: WeightsMode::Exact,
            pool_size: 512,
        }
    }
}

/// Settings of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Which loss.
    pub algorithm: Algorithm,
    /// Steps of Adam.
    pub steps: u64,
    /// Rows of a step, drawn with replacement.
    pub batch: usize,
    /// Step size of Adam.
    pub learning_rate: f64,
    /// Seeds the initial parameters, and the batches unless `batch_seed` is given.
    pub seed: u64,
    /// Seeds the batches on their own. Runs that share it are not independent replicates.
    pub batch_seed: Option<u64>,
    /// Of the regulariser; used if the algorithm is `palr`, and by the logged HSCIC.
    pub palr: PalrConfig,
    /// Steps between two reports of progress. Does not change the parameters.
    pub log_every: u64,
    /// Steps between two checkpoints. Does not change the parameters.
    pub checkpoint_every: u64,
    /// At most so many rows, evenly spaced, are measured for a report. Does not change the
    /// parameters.
    pub metric_rows: usize,
}

impl Default for TrainConfig {
    /// The reference recipe (PALR paper, Table 7).
    fn default() -> Self {
        Self {
            algorithm: Algorithm::Palr,
            steps: 500_000,
            batch: 1024,
            learning_rate: 3e-4,
            seed: 0,
            batch_seed: None,
            palr: PalrConfig::default(),
            log_every: 1000,
            checkpoint_every: 10_000,
            metric_rows: 1024,
        }
    }
}

impl TrainConfig {
    /// Reads settings; what is not named keeps its default.
    ///
    /// # Errors
    /// [`TrainError::UnknownSetting`] with the nearest name, or [`TrainError::Setting`].
    pub fn from_json(value: serde_json::Value) -> Result<Self, TrainError> {
        let invalid = |error: serde_json::Error| TrainError::Setting { message: error.to_string() };
        let known = serde_json::to_value(Self::default()).map_err(invalid)?;
        refuse_unknown(&value, &known, "")?;
        let config: Self = serde_json::from_value(value).map_err(invalid)?;
        config.validate()?;
        Ok(config)
    }

    /// Refuses values that no run can have.
    ///
    /// # Errors
    /// [`TrainError::Setting`].
    pub fn validate(&self) -> Result<(), TrainError> {
        let palr = &self.palr;
        check(palr.alpha.is_finite() && palr.alpha >= 0.0, "palr.alpha", palr.alpha, "at least 0")?;
        check(self.batch >= 2, "batch", self.batch, "at least 2")?;
        check(self.steps >= 1, "steps", self.steps, "at least 1")?;
        // The number of a step is one half of a generator's stream.
        check(u32::try_from(self.steps).is_ok(), "steps", self.steps, "below 2^32")?;
        check(self.log_every >= 1, "log_every", self.log_every, "at least 1")?;
        check(self.checkpoint_every >= 1, "checkpoint_every", self.checkpoint_every, "at least 1")?;
        check(self.metric_rows >= 2, "metric_rows", self.metric_rows, "at least 2")?;
        check(palr.pool_size >= 1, "palr.pool_size", palr.pool_size, "at least 1")?;
        check(
            u32::try_from(palr.pool_size).is_ok(),
            "palr.pool_size",
            palr.pool_size,
            "below 2^32",
        )?;
        for (name, got) in [
            ("learning_rate", self.learning_rate),
            ("palr.ridge", palr.ridge),
            ("palr.bandwidth_sq", palr.bandwidth_sq),
        ] {
            check(got.is_finite() && got > 0.0, name, got, "a positive number")?;
        }
        Ok(())
    }

    /// The seed of the batches.
    #[must_use]
    pub fn batch_seed(&self) -> u64 {
        self.batch_seed.unwrap_or(self.seed)
    }

    /// True if a run with `other` can be continued with these settings: they may differ in what
    /// does not change the parameters of a step.
    #[must_use]
    pub fn continues(&self, other: &Self) -> bool {
        let bits = |config: &Self| Self {
            steps: 1,
            log_every: 1,
            checkpoint_every: 1,
            metric_rows: 2,
            batch_seed: Some(config.batch_seed()),
            ..config.clone()
        };
        bits(self) == bits(other)
    }
}

fn check(
    is_right: bool,
    name: &str,
    got: impl std::fmt::Display,
    want: &str,
) -> Result<(), TrainError> {
    if is_right {
        return Ok(());
    }
    Err(TrainError::Setting { message: format!("{name} is {got}; expected {want}") })
}

/// Compares keys with those of `known`, the settings with every key.
fn refuse_unknown(
    value: &serde_json::Value,
    known: &serde_json::Value,
    prefix: &str,
) -> Result<(), TrainError> {
    let (Some(value), Some(known)) = (value.as_object(), known.as_object()) else {
        return Ok(());
    };
    for (key, inner) in value {
        let name = format!("{prefix}{key}");
        let Some(known) = known.get(key) else {
            let nearest = palr_gym_core::nearest::nearest(key, known.keys().map(String::as_str));
            return Err(TrainError::UnknownSetting {
                name,
                nearest: nearest.map(|nearest| format!("{prefix}{nearest}")),
            });
        };
        refuse_unknown(inner, known, &format!("{name}."))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn refusal(value: serde_json::Value) -> String {
        TrainConfig::from_json(value).unwrap_err().to_string()
    }

    #[test]
    fn what_is_not_named_keeps_its_default() {
        assert_eq!(TrainConfig::from_json(json!({})).unwrap(), TrainConfig::default());
        let config = TrainConfig::from_json(json!({"palr": {"weights": "pool"}})).unwrap();
        assert_eq!((config.palr.weights, config.palr.alpha), (WeightsMode::Pool, 10.0));
        let whole = serde_json::to_value(&config).unwrap();
        assert_eq!(TrainConfig::from_json(whole).unwrap(), config);
    }

    #[test]
    fn wrong_settings_are_refused_with_what_was_wanted() {
        let cases = [
            (json!({"palr": {"alpha": -1.0}}), "palr.alpha is -1; expected at least 0"),
            (json!({"batch": 1}), "batch is 1; expected at least 2"),
            (json!({"learning_rate": 0.0}), "learning_rate is 0; expected a positive number"),
            (json!({"btach": 8}), "there is no setting `btach`; did you mean `batch`?"),
            (json!({"palr": {"alhpa": 1}}), "did you mean `palr.alpha`?"),
            (json!({"xyzzyxyzzy": 1}), "there is no setting `xyzzyxyzzy`"),
            (json!({"algorithm": "dagger"}), "unknown variant `dagger`"),
        ];
        for (value, want) in cases {
            let got = refusal(value);
            assert!(got.contains(want), "{got}");
        }
    }

    #[test]
    fn a_run_continues_only_with_the_settings_that_decide_its_bits() {
        let config = TrainConfig { seed: 3, ..TrainConfig::default() };
        let other = TrainConfig { steps: 9, log_every: 7, batch_seed: Some(3), ..config.clone() };
        assert!(other.continues(&config));
        assert!(!TrainConfig { seed: 4, ..config.clone() }.continues(&config));
        assert!(!TrainConfig { batch_seed: Some(4), ..config.clone() }.continues(&config));
    }
}
