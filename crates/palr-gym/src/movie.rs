//! Pictures as files: PNG, GIF and MP4.

mod mp4;

use std::path::Path;

use mp4::Mp4;

/// How carefully a GIF's colours are chosen: 1 (best) to 30.
const GIF_SPEED: i32 = 10;

/// What a film is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    Gif,
    Mp4,
}

/// A film that is being put together. Pictures are `[height, width, 3]`.
pub enum Movie {
    Gif(Gif),
    Mp4(Box<Mp4>),
}

impl Format {
    /// What a file's ending asks for; `None`: no film.
    pub fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()? {
            "gif" => Some(Self::Gif),
            "mp4" => Some(Self::Mp4),
            _ => None,
        }
    }
}

impl Movie {
    pub fn new(format: Format, width_px: u32, height_px: u32, fps: u32) -> anyhow::Result<Self> {
        Ok(match format {
            Format::Gif => {
                // Sides beyond a GIF's are beyond the server's as well.
                let side = |pixels: u32| u16::try_from(pixels).unwrap_or(u16::MAX);
                Self::Gif(Gif::new(side(width_px), side(height_px), fps))
            }
            Format::Mp4 => {
                Self::Mp4(Box::new(Mp4::new(width_px as usize, height_px as usize, fps)?))
            }
        })
    }

    /// Adds a picture.
    pub fn add(&mut self, rgb: &[u8]) -> anyhow::Result<()> {
        match self {
            Self::Gif(gif) => {
                gif.add(rgb);
                Ok(())
            }
            Self::Mp4(mp4) => mp4.add(rgb),
        }
    }

    /// The file.
    pub fn finish(self) -> anyhow::Result<Vec<u8>> {
        match self {
            Self::Gif(gif) => gif.finish(),
            Self::Mp4(mp4) => mp4.finish(),
        }
    }
}

/// An animated GIF that is being put together.
pub struct Gif {
    width_px: u16,
    height_px: u16,
    fps: u32,
    /// Each with a palette of its own.
    frames: Vec<gif::Frame<'static>>,
}

impl Gif {
    fn new(width_px: u16, height_px: u16, fps: u32) -> Self {
        Self { width_px, height_px, fps, frames: Vec::new() }
    }

    fn add(&mut self, rgb: &[u8]) {
        let Self { width_px, height_px, fps, .. } = *self;
        let mut frame = gif::Frame::from_rgb_speed(width_px, height_px, rgb, GIF_SPEED);
        // In hundredths of a second.
        frame.delay = (100.0 / f64::from(fps)).round().max(1.0) as u16;
        self.frames.push(frame);
    }

    fn finish(self) -> anyhow::Result<Vec<u8>> {
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
