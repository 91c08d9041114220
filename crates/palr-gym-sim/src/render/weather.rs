//! Light, fog and tints of a scene, as far as they change from episode to episode.

/// What an episode's weather does to a picture. It never touches the physics.
#[derive(Debug, Clone, PartialEq)]
pub struct Weather {
    /// Where sunlight goes.
    pub sun_direction: [f32; 3],
    /// Brightness of the sun, each colour.
    pub sun: [f32; 3],
    /// Light from everywhere.
    pub ambient: f32,
    /// Fog begins and is complete at these distances.
    pub fog_m: Option<(f32, f32)>,
    /// Its grey.
    pub fog_brightness: f32,
    /// Factors on the colours of geoms, by the names of their materials.
    pub tints: Vec<(&'static str, [f32; 3])>,
}
