//! What was chosen about a scene, as a recording's header has it.

use palr_gym_proto::v1;
use serde::{Deserialize, Serialize};

/// Options of a driving scene as a header has them; null: the default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct SceneRecord {
    weather: Option<String>,
    lead_car_probability: Option<f64>,
    vehicles: Option<u32>,
}

impl SceneRecord {
    pub(super) fn of(options: &v1::SceneOptions) -> Self {
        let weather = match options.weather() {
            v1::Weather::Unspecified => None,
            v1::Weather::Fixed => Some("fixed".to_owned()),
            v1::Weather::Random => Some("random".to_owned()),
        };
        let v1::SceneOptions { lead_car_probability, vehicles, .. } = *options;
        Self { weather, lead_car_probability, vehicles }
    }
}
