//! What can be chosen about a scene that is more than a robot on a floor.

/// How light, fog and colours come about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum WeatherMode {
    /// Always the same clear day.
    #[default]
    Fixed,
    /// Drawn anew for each episode. The physics is the same.
    Random,
}

/// Choices about a driving scene. Tasks without such a scene know only the default.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneOptions {
    /// With which probability an episode has a car ahead, in [0, 1].
    pub lead_car_probability: f64,
    /// How light, fog and colours come about.
    pub weather: WeatherMode,
}

impl Default for SceneOptions {
    fn default() -> Self {
        Self { lead_car_probability: 0.7, weather: WeatherMode::Fixed }
    }
}

/// Why options do not fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneOptionsError {
    /// No probability.
    #[error("lead_car_probability is {got}; expected a number within [0, 1]")]
    LeadCarProbability {
        /// The number found.
        got: f64,
    },
    /// The task has no such scene.
    #[error("task {task:?} has no scene options; expected a driving task, or none set")]
    NoScene {
        /// The task.
        task: &'static str,
    },
}

impl SceneOptions {
    /// Checks every value.
    ///
    /// # Errors
    /// The first value that is out of range.
    pub fn validate(&self) -> Result<(), SceneOptionsError> {
        let got = self.lead_car_probability;
        if !(0.0..=1.0).contains(&got) {
            return Err(SceneOptionsError::LeadCarProbability { got });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probabilities_are_probabilities() {
        for (value, is_good) in
            [(0.0, true), (0.7, true), (1.0, true), (-0.1, false), (1.1, false), (f64::NAN, false)]
        {
            let options = SceneOptions { lead_car_probability: value, ..SceneOptions::default() };
            assert_eq!(options.validate().is_ok(), is_good, "{value}");
        }
        assert_eq!(SceneOptions::default().validate(), Ok(()));
    }
}
