//! What a training run is: everything that decides its bits.

mod defaults;
mod methods;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

pub use self::defaults::defaults;
pub use self::methods::{
    ActionSource, DtConfig, FcaConfig, KfConfig, KfSchedule, KfTemperature, KfWeighting,
    MineConfig, PalrActConfig, PalrConfig, PrimeJunction, PrimenetConfig, RapConfig, VibConfig,
    WeightsMode,
};
use crate::learning::error::TrainError;

/// Which method learns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Algorithm {
    /// Behaviour cloning: the likelihood alone.
    Bc,
    /// Keyframe-focused: the likelihood, weighted by how badly past actions predict the action.
    Kf,
    /// A second network's guess from the last observation joins the policy.
    Primenet,
    /// Residual action prediction: memory is learnt by predicting changes of the action.
    Rap,
    /// Fighting copycat agents: an adversary predicts the past action from the representation.
    Fca,
    /// The likelihood, and a neural estimate of mutual information with the past action.
    Mine,
    /// The likelihood, and HSCIC of the representation and the past action given the action.
    Palr,
    /// PALR with the policy's action in the place of its representation.
    PalrAct,
    /// The variational information bottleneck.
    Vib,
    /// The decision transformer, imitating.
    Dt,
    /// The decision transformer with PALR's regulariser on its last hidden state.
    DtPalr,
}

impl Algorithm {
    /// Every method, in the order of the paper.
    pub const ALL: [Self; 11] = [
        Self::Bc,
        Self::Kf,
        Self::Primenet,
        Self::Rap,
        Self::Fca,
        Self::Mine,
        Self::Palr,
        Self::PalrAct,
        Self::Vib,
        Self::Dt,
        Self::DtPalr,
    ];

    /// As settings name it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Bc => "bc",
            Self::Kf => "kf",
            Self::Primenet => "primenet",
            Self::Rap => "rap",
            Self::Fca => "fca",
            Self::Mine => "mine",
            Self::Palr => "palr",
            Self::PalrAct => "palr_act",
            Self::Vib => "vib",
            Self::Dt => "dt",
            Self::DtPalr => "dt_palr",
        }
    }

    /// The tables of settings that decide what it does, besides the settings that all methods share.
    #[must_use]
    pub fn tables(self) -> &'static [&'static str] {
        match self {
            Self::Bc => &[],
            Self::Kf => &["kf"],
            Self::Primenet => &["primenet"],
            Self::Rap => &["rap"],
            Self::Fca => &["fca"],
            Self::Mine => &["mine"],
            Self::Palr => &["palr"],
            Self::PalrAct => &["palr", "palr_act"],
            Self::Vib => &["vib"],
            Self::Dt => &["dt"],
            Self::DtPalr => &["dt", "palr"],
        }
    }

    /// Name of the one setting that the paper tunes for each task, the method's α; none for
    /// methods without one.
    #[must_use]
    pub fn alpha_setting(self) -> Option<&'static str> {
        match self {
            Self::Bc | Self::Primenet | Self::Rap | Self::Dt => None,
            Self::Kf => Some("kf.temperature"),
            Self::Fca => Some("fca.alpha"),
            Self::Mine => Some("mine.alpha"),
            Self::Palr | Self::PalrAct | Self::DtPalr => Some("palr.alpha"),
            Self::Vib => Some("vib.beta"),
        }
    }
}

/// Which rows observations are standardised by. Whoever makes a
/// [`TrainingSet`](crate::learning::TrainingSet) keeps to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StatisticsRows {
    /// Those that are trained on (the reference code).
    Training,
    /// All of the data set's (the paper's text).
    All,
}

/// Settings of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Which method.
    pub algorithm: Algorithm,
    /// Steps of Adam.
    pub steps: u64,
    /// Rows of a step, drawn with replacement.
    pub batch: usize,
    /// Step size of the policy's Adam.
    pub learning_rate: f64,
    /// Which rows observations are standardised by.
    pub statistics: StatisticsRows,
    /// Seeds the initial parameters, and the batches unless `batch_seed` is given.
    pub seed: u64,
    /// Seeds the batches on their own. Runs that share it are not independent replicates.
    pub batch_seed: Option<u64>,
    /// Of HSCIC; its kernels are also those of the logged HSCIC, whatever the method.
    pub palr: PalrConfig,
    /// Used if the algorithm is `palr_act`.
    pub palr_act: PalrActConfig,
    /// Used if the algorithm is `kf`.
    pub kf: KfConfig,
    /// Used if the algorithm is `primenet`.
    pub primenet: PrimenetConfig,
    /// Used if the algorithm is `rap`.
    pub rap: RapConfig,
    /// Used if the algorithm is `fca`.
    pub fca: FcaConfig,
    /// Used if the algorithm is `mine`.
    pub mine: MineConfig,
    /// Used if the algorithm is `vib`.
    pub vib: VibConfig,
    /// Used if the algorithm is `dt` or `dt_palr`.
    pub dt: DtConfig,
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
            statistics: StatisticsRows::Training,
            seed: 0,
            batch_seed: None,
            palr: PalrConfig::default(),
            palr_act: PalrActConfig::default(),
            kf: KfConfig::default(),
            primenet: PrimenetConfig::default(),
            rap: RapConfig::default(),
            fca: FcaConfig::default(),
            mine: MineConfig::default(),
            vib: VibConfig::default(),
            dt: DtConfig::default(),
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
        let config: Self = from_json(value)?;
        config.validate()?;
        Ok(config)
    }

    /// Refuses values that no run can have.
    ///
    /// # Errors
    /// [`TrainError::Setting`].
    pub fn validate(&self) -> Result<(), TrainError> {
        check(self.batch >= 2, "batch", self.batch, "at least 2")?;
        check(self.steps >= 1, "steps", self.steps, "at least 1")?;
        // The number of a step is one half of a generator's stream.
        check(u32::try_from(self.steps).is_ok(), "steps", self.steps, "below 2^32")?;
        check(self.log_every >= 1, "log_every", self.log_every, "at least 1")?;
        check(self.checkpoint_every >= 1, "checkpoint_every", self.checkpoint_every, "at least 1")?;
        check(self.metric_rows >= 2, "metric_rows", self.metric_rows, "at least 2")?;
        positive("learning_rate", self.learning_rate)?;
        self.palr.validate()?;
        self.kf.validate()?;
        self.primenet.validate()?;
        self.rap.validate()?;
        self.fca.validate()?;
        self.mine.validate()?;
        self.vib.validate()?;
        self.dt.validate()?;
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

fn positive(name: &str, got: f64) -> Result<(), TrainError> {
    check(got.is_finite() && got > 0.0, name, got, "a positive number")
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

/// Settings from JSON.
///
/// # Errors
/// [`TrainError::Setting`] with the name of the setting whose value is of a wrong kind.
pub fn from_json<T: DeserializeOwned>(value: serde_json::Value) -> Result<T, TrainError> {
    serde_path_to_error::deserialize(value).map_err(|error| {
        let message = format!("{}: {}", error.path(), error.inner());
        TrainError::Setting { message }
    })
}

/// Compares keys with those of `known`, the settings with every key.
pub(crate) fn refuse_unknown(
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
            (json!({"palr": {"alpha": "x"}}), "palr.alpha: invalid type: string \"x\""),
            (json!({"batch": 1}), "batch is 1; expected at least 2"),
            (json!({"learning_rate": 0.0}), "learning_rate is 0; expected a positive number"),
            (json!({"btach": 8}), "there is no setting `btach`; did you mean `batch`?"),
            (json!({"palr": {"alhpa": 1}}), "did you mean `palr.alpha`?"),
            (json!({"xyzzyxyzzy": 1}), "there is no setting `xyzzyxyzzy`"),
            (json!({"algorithm": "dagger"}), "algorithm: unknown variant `dagger`"),
            (json!({"kf": {"step_share": 1.0}}), "kf.step_share is 1; expected a share"),
            (json!({"kf": {"temprature": 1.0}}), "did you mean `kf.temperature`?"),
            (json!({"mine": {"ema_decay": 1.0}}), "mine.ema_decay is 1; expected 0 to below 1"),
            (json!({"fca": {"inner_updates": 0}}), "fca.inner_updates is 0; expected 1 to 1000"),
            (json!({"primenet": {"junction": "end"}}), "unknown variant `end`"),
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
