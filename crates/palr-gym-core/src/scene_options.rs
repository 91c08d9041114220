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

/// Most vehicles beside the car that is driven.
pub const MAX_VEHICLES: u32 = 8;

/// Something that can be chosen about a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SceneOption {
    /// [`SceneOptions::lead_car_probability`].
    LeadCarProbability,
    /// [`SceneOptions::vehicles`].
    Vehicles,
    /// [`SceneOptions::weather`].
    Weather,
}

impl SceneOption {
    /// Every option.
    pub const ALL: [Self; 3] = [Self::LeadCarProbability, Self::Vehicles, Self::Weather];

    /// Its name, as in protocol and Python.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::LeadCarProbability => "lead_car_probability",
            Self::Vehicles => "vehicles",
            Self::Weather => "weather",
        }
    }
}

/// Choices about a driving scene. Tasks without such a scene know only the default.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneOptions {
    /// With which probability an episode has a car ahead, in [0, 1].
    pub lead_car_probability: f64,
    /// How many other vehicles drive about, at most [`MAX_VEHICLES`].
    pub vehicles: u32,
    /// How light, fog and colours come about.
    pub weather: WeatherMode,
}

impl Default for SceneOptions {
    fn default() -> Self {
        Self { lead_car_probability: 0.7, vehicles: 4, weather: WeatherMode::Fixed }
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
    /// Too many vehicles.
    #[error("vehicles is {got}; expected 0 to {MAX_VEHICLES}")]
    Vehicles {
        /// The number found.
        got: u32,
    },
    /// The task's scene has nothing of the kind.
    #[error("task {task:?} has no scene option {name:?}; expected some of {available:?}")]
    NotOfTask {
        /// The task.
        task: &'static str,
        /// The option.
        name: &'static str,
        /// Those that it has.
        available: Vec<&'static str>,
    },
    /// The task has no such scene.
    #[error("task {task:?} has no scene options; expected a driving task, or none set")]
    NoScene {
        /// The task.
        task: &'static str,
    },
}

impl SceneOptions {
    /// True if `option` is not what it is by default.
    #[must_use]
    pub fn chooses(&self, option: SceneOption) -> bool {
        let default = Self::default();
        match option {
            SceneOption::LeadCarProbability => {
                self.lead_car_probability.to_bits() != default.lead_car_probability.to_bits()
            }
            SceneOption::Vehicles => self.vehicles != default.vehicles,
            SceneOption::Weather => self.weather != default.weather,
        }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first value that is out of range.
    pub fn validate(&self) -> Result<(), SceneOptionsError> {
        let got = self.lead_car_probability;
        if !(0.0..=1.0).contains(&got) {
            return Err(SceneOptionsError::LeadCarProbability { got });
        }
        if self.vehicles > MAX_VEHICLES {
            return Err(SceneOptionsError::Vehicles { got: self.vehicles });
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

    #[test]
    fn there_is_room_for_eight_vehicles() {
        for (vehicles, is_good) in [(0, true), (8, true), (9, false), (u32::MAX, false)] {
            let options = SceneOptions { vehicles, ..SceneOptions::default() };
            assert_eq!(options.validate().is_ok(), is_good, "{vehicles}");
        }
    }

    #[test]
    fn an_option_counts_as_chosen_once_it_is_not_the_default() {
        let default = SceneOptions::default();
        assert!(SceneOption::ALL.iter().all(|&option| !default.chooses(option)));
        for (options, chosen) in [
            (
                SceneOptions { lead_car_probability: 0.1, ..default },
                SceneOption::LeadCarProbability,
            ),
            (SceneOptions { vehicles: 0, ..default }, SceneOption::Vehicles),
            (SceneOptions { weather: WeatherMode::Random, ..default }, SceneOption::Weather),
        ] {
            for option in SceneOption::ALL {
                assert_eq!(options.chooses(option), option == chosen, "{option:?}");
            }
        }
    }
}
