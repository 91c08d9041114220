//! What can be chosen about the scene of a driving task.

use clap::{Args, ValueEnum};
use palr_gym_proto::v1;

/// Options of a driving scene; the server refuses what the task does not have.
#[derive(Debug, Clone, Copy, Args)]
#[command(next_help_heading = "Driving scenes")]
pub struct SceneArguments {
    /// Light, fog and colours [default: fixed].
    #[arg(long, value_enum)]
    pub weather: Option<WeatherChoice>,
    /// lane: probability of a car ahead, 0 to 1 [default: 0.7].
    #[arg(long, value_name = "P")]
    pub lead_car_probability: Option<f64>,
    /// town: other vehicles, 0 to 8 [default: 4].
    #[arg(long, value_name = "N")]
    pub vehicles: Option<u32>,
}

/// Weather of a driving scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum WeatherChoice {
    /// Always the same clear day.
    Fixed,
    /// Drawn at each reset.
    Random,
}

impl SceneArguments {
    /// For the wire; nothing if nothing is chosen.
    pub fn options(&self) -> Option<v1::SceneOptions> {
        let Self { weather, lead_car_probability, vehicles } = *self;
        let weather = match weather {
            None => v1::Weather::Unspecified,
            Some(WeatherChoice::Fixed) => v1::Weather::Fixed,
            Some(WeatherChoice::Random) => v1::Weather::Random,
        };
        let options = v1::SceneOptions { lead_car_probability, weather: weather.into(), vehicles };
        (options != v1::SceneOptions::default()).then_some(options)
    }
}
