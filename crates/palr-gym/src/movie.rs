//! Pictures as files: PNG and GIF.

/// How carefully a GIF's colours are chosen: 1 (best) to 30.
const GIF_SPEED: i32 = 10;

/// An animated GIF that is being put together. Pictures are `[height, width, 3]`.
pub struct Movie {
    width_px: u16,
    height_px: u16,
    fps: u32,
    /// Each with a palette of its own.
    frames: Vec<gif::Frame<'static>>,
}

impl Movie {
    pub fn new(width_px: u16, height_px: u16, fps: u32) -> Self {
        Self { width_px, height_px, fps, frames: Vec::new() }
    }

    /// Adds a picture.
    pub fn add(&mut self, rgb: &[u8]) {
        let Self { width_px, height_px, fps, .. } = *self;
        let mut frame = gif::Frame::from_rgb_speed(width_px, height_px, rgb, GIF_SPEED);
        // In hundredths of a second.
        frame.delay = (100.0 / f64::from(fps)).round().max(1.0) as u16;
        self.frames.push(frame);
    }

    /// The file.
    pub fn finish(self) -> anyhow::Result<Vec<u8>> {
        let mut file = Vec::new();
        let mut encoder = gif::Encoder::new(&mut file, self.width_px, self.height_px, &[])?;
        encoder.set_repeat(gif::Repeat::Infinite)?;
        for frame in &self.frames {
            encoder.write_frame(frame)?;
        }
        drop(encoder);
        Ok(file)
    }
}

/// A single picture as a file.
pub fn png(width_px: u32, height_px: u32, rgb: &[u8]) -> anyhow::Result<Vec<u8>> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width_px, height_px);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header()?.write_image_data(rgb)?;
    Ok(file)
}
