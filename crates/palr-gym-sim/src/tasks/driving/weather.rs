//! The weather of an episode: drawn at its reset, kept as numbers beside its state.

use palr_gym_core::WeatherMode;
use palr_gym_core::random::Generator;

use crate::render::Weather;

/// Numbers in the user data.
pub(in crate::tasks) const NUMBERS: usize = RANGES.len() + 1;
/// What is drawn, each uniformly: where the sun is (azimuth and height, in radians), how bright, and
/// how warm; light from everywhere; where fog is complete (m), beyond which there is none, and its
/// grey; red, green and blue of the ground; brightness of road and markings.
const RANGES: [(f64, f64); 12] = [
    (0.0, std::f64::consts::TAU),
    (0.4, 1.4),
    (0.3, 0.9),
    (0.85, 1.0),
    (0.2, 0.5),
    (30.0, 200.0),
    (0.55, 0.9),
    (0.55, 1.0),
    (0.55, 1.0),
    (0.55, 1.0),
    (0.6, 1.0),
    (0.75, 1.0),
];
/// Fog further away is none.
const FOG_SEEN_M: f64 = 110.0;
/// Where fog begins, as a part of where it is complete.
const FOG_BEGIN: f64 = 0.15;

/// Fills `numbers`: the first says whether there is any weather.
pub(in crate::tasks) fn draw(mode: WeatherMode, generator: &mut Generator, numbers: &mut [f64]) {
    numbers.fill(0.0);
    if mode == WeatherMode::Random {
        numbers[0] = 1.0;
        for (number, (low, high)) in numbers[1..].iter_mut().zip(RANGES) {
            *number = generator.uniform(low, high);
        }
    }
}

/// The weather that `numbers` describe; `None`: as the scene has it.
pub(in crate::tasks) fn read(numbers: &[f64]) -> Option<Weather> {
    let (is_drawn, numbers) = numbers.split_first()?;
    if *is_drawn != 1.0 {
        return None;
    }
    let &[azimuth, height, sun, warmth, ambient, fog_m, fog, red, green, blue, road, marks] =
        numbers
    else {
        return None;
    };
    let sun_direction = [azimuth.cos() * height.cos(), azimuth.sin() * height.cos(), -height.sin()];
    let grey = |brightness: f64| [brightness as f32; 3];
    Some(Weather {
        sun_direction: sun_direction.map(|entry| entry as f32),
        sun: [sun, sun, sun * warmth].map(|entry| entry as f32),
        ambient: ambient as f32,
        fog_m: (fog_m < FOG_SEEN_M).then_some(((FOG_BEGIN * fog_m) as f32, fog_m as f32)),
        fog_brightness: fog as f32,
        tints: vec![
            ("grass", [red, green, blue].map(|entry| entry as f32)),
            ("asphalt", grey(road)),
            ("walk", grey(road)),
            ("edge", grey(marks)),
            ("dash", grey(marks)),
        ],
    })
}
