//! Pictures of a session's environments.

use palr_gym_sim::VectorEnv;
use palr_gym_sim::render::{GlChoice, View};

use crate::error::ServerError;

/// How pictures are packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageFormat {
    /// A file for each.
    Png,
    /// Bytes, one picture after the other.
    RawRgb,
}

/// What to draw.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PictureOrder {
    /// With what.
    pub gl: GlChoice,
    /// Which environments, ascending; empty means all.
    pub env_indices: Vec<usize>,
    /// By its name; empty: the first one.
    pub camera: String,
    /// Pixels across.
    pub width_px: u32,
    /// Pixels down.
    pub height_px: u32,
    /// How to pack them.
    pub format: ImageFormat,
}

/// Pictures, all of one size.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Pictures {
    /// Files.
    Png(Vec<Vec<u8>>),
    /// `[count, height, width, 3]`.
    RawRgb {
        /// Number of pictures.
        count: usize,
        /// Pixels down.
        height_px: u32,
        /// Pixels across.
        width_px: u32,
        /// All of them.
        rgb: Vec<u8>,
    },
}

impl PictureOrder {
    /// Bytes of the pictures of `num_envs` environments before they are packed.
    #[must_use]
    pub fn bytes(&self, num_envs: usize) -> usize {
        let count = if self.env_indices.is_empty() { num_envs } else { self.env_indices.len() };
        let side = |pixels: u32| pixels as usize;
        count.saturating_mul(side(self.width_px)).saturating_mul(3 * side(self.height_px))
    }

    /// Draws them all, on this thread.
    ///
    /// # Errors
    /// [`ServerError::Sim`] with what is wrong with the order, or why nothing can be drawn.
    pub fn draw(&self, env: &VectorEnv) -> Result<Pictures, ServerError> {
        let all: Vec<usize>;
        let indices = if self.env_indices.is_empty() {
            all = (0..env.len()).collect();
            &all
        } else {
            env.check_indices(&self.env_indices)?;
            &self.env_indices
        };
        let camera = (!self.camera.is_empty()).then_some(self.camera.as_str());
        let (width_px, height_px) = (self.width_px, self.height_px);
        let view = View { camera, width_px, height_px };
        let (mut picture, mut files, mut rgb) = (Vec::new(), Vec::new(), Vec::new());
        for &index in indices {
            env.draw(index, self.gl, view, &mut picture)?;
            match self.format {
                ImageFormat::Png => files.push(png(width_px, height_px, &picture)?),
                ImageFormat::RawRgb => rgb.extend_from_slice(&picture),
            }
        }
        Ok(match self.format {
            ImageFormat::Png => Pictures::Png(files),
            ImageFormat::RawRgb => {
                Pictures::RawRgb { count: indices.len(), height_px, width_px, rgb }
            }
        })
    }
}

fn png(width_px: u32, height_px: u32, rgb: &[u8]) -> Result<Vec<u8>, ServerError> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width_px, height_px);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    // Nothing can go wrong but the sizes, which were checked by drawing.
    let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(rgb));
    written.map_err(|error| ServerError::Internal(format!("PNG: {error}")))?;
    Ok(file)
}
