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

    /// Prepares to draw them.
    ///
    /// # Errors
    /// [`ServerError::Sim`] with the index that `env` has not.
    pub fn begin(&self, env: &VectorEnv) -> Result<Drawing, ServerError> {
        env.check_indices(&self.env_indices)?;
        let indices = match self.env_indices.as_slice() {
            [] => (0..env.len()).collect(),
            chosen => chosen.to_vec(),
        };
        Ok(Drawing { indices, drawn: 0, packed: Packed::of(self.format) })
    }
}

/// Pictures that are being drawn.
#[derive(Debug)]
pub struct Drawing {
    indices: Vec<usize>,
    drawn: usize,
    packed: Packed,
}

#[derive(Debug)]
enum Packed {
    Png(Vec<Vec<u8>>),
    RawRgb(Vec<u8>),
}

impl Packed {
    fn of(format: ImageFormat) -> Self {
        match format {
            ImageFormat::Png => Self::Png(Vec::new()),
            ImageFormat::RawRgb => Self::RawRgb(Vec::new()),
        }
    }
}

impl Drawing {
    /// Draws on, on this thread, until about `pixels` more are there, at least a picture. Tells whether
    /// all are.
    ///
    /// # Errors
    /// [`ServerError::Sim`] with what is wrong with the order, or why nothing can be drawn.
    pub fn go_on(
        &mut self,
        order: &PictureOrder,
        env: &VectorEnv,
        pixels: usize,
    ) -> Result<bool, ServerError> {
        let camera = (!order.camera.is_empty()).then_some(order.camera.as_str());
        let (width_px, height_px) = (order.width_px, order.height_px);
        let view = View { camera, width_px, height_px };
        let mut picture = Vec::new();
        let mut so_far = 0;
        while so_far < pixels
            && let Some(&index) = self.indices.get(self.drawn)
        {
            env.draw(index, order.gl, view, &mut picture)?;
            match &mut self.packed {
                Packed::Png(files) => files.push(png(width_px, height_px, &picture)?),
                Packed::RawRgb(rgb) => rgb.extend_from_slice(&picture),
            }
            self.drawn += 1;
            so_far += picture.len() / 3;
        }
        Ok(self.drawn == self.indices.len())
    }

    /// What was drawn.
    #[must_use]
    pub fn pictures(self, order: &PictureOrder) -> Pictures {
        let (width_px, height_px) = (order.width_px, order.height_px);
        match self.packed {
            Packed::Png(files) => Pictures::Png(files),
            Packed::RawRgb(rgb) => Pictures::RawRgb { count: self.drawn, height_px, width_px, rgb },
        }
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
