//! Pictures of a simulation, drawn off screen.
//!
//! A picture is a function of positions alone: they are copied into the renderer's own data and
//! what is seen follows from them there. So drawing never touches a simulation, a simulation that
//! was restored looks as the original did, and speed does not show in a single frame.
//!
//! # Layout
//! - `gl`: OpenGL contexts by OSMesa or EGL, found at run time; threads draw side by side.
//! - `canvas`: MuJoCo's renderer on such a context; one context a thread and scene, kept while the
//!   thread lives. `frustum`: what its camera cannot see is not drawn.
//! - `weather`: light, fog and tints; `pieces`: which parts of a scene are there.

mod canvas;
mod frustum;
mod gl;
mod pieces;
mod weather;

use std::fmt;

pub use gl::{GlInfo, GlLibrary, prepare_process};
pub use pieces::Pieces;
pub use weather::Weather;

use crate::physics::Physics;

/// The largest side of a picture.
pub const MAX_SIDE_PX: u32 = 2048;
/// Up to this side a picture is drawn at twice its size and averaged.
const MAX_SMOOTH_SIDE_PX: u32 = 1024;

/// Which OpenGL is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GlChoice {
    /// OSMesa, else EGL on the processor.
    #[default]
    Auto,
    /// OSMesa.
    Osmesa,
    /// EGL, on the processor where it can, else on whatever it finds.
    Egl,
    /// None: requests to draw are refused.
    None,
}

impl GlChoice {
    /// Every choice.
    pub const ALL: [Self; 4] = [Self::Auto, Self::Osmesa, Self::Egl, Self::None];

    /// The word for it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Osmesa => "osmesa",
            Self::Egl => "egl",
            Self::None => "none",
        }
    }
}

impl fmt::Display for GlChoice {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// Why there is no picture.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RenderError {
    /// The server was told not to draw.
    #[error("this server draws nothing (--gl none); start it with --gl auto")]
    Disabled,
    /// No library that draws, or none that works.
    #[error(
        "no OpenGL to draw with: {tried}. Install one on the server's machine (apt-get install libosmesa6, or libegl1 where Mesa is 25.1 or newer; without root: scripts/setup.sh gl), or point PALR_GYM_OSMESA at a libOSMesa.so; everything but drawing works without"
    )]
    NoGl {
        /// What was tried, and why it failed.
        tried: String,
    },
    /// The process has drawn by other means already.
    #[error("this process draws with {loaded}; {asked} needs a process of its own")]
    OtherLibrary {
        /// In use.
        loaded: &'static str,
        /// Asked for.
        asked: &'static str,
    },
    /// A thread could not have a context.
    #[error("{library} gives this thread no OpenGL context: {message}")]
    Context {
        /// Which library.
        library: &'static str,
        /// Why.
        message: String,
    },
    /// The library cannot do what MuJoCo needs, or drawing failed.
    #[error("MuJoCo cannot draw with this OpenGL: {message}")]
    Engine {
        /// What MuJoCo said.
        message: String,
    },
    /// A camera that the scene does not have.
    #[error("the scene has no camera {got:?}; expected {}",
        if known.is_empty() { "none to be named".to_owned() } else { known.join(", ") })]
    Camera {
        /// The name asked for.
        got: String,
        /// The names there are.
        known: Vec<String>,
    },
    /// An impossible size.
    #[error("the picture is {width_px} x {height_px} pixels; expected 1 to {MAX_SIDE_PX} each way")]
    Size {
        /// Pixels across.
        width_px: u32,
        /// Pixels down.
        height_px: u32,
    },
}

/// What to draw of a simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct View<'a> {
    /// By its name; `None`: the scene's first camera, or one that sees everything if it has none.
    /// (An environment's first camera is the first that its task names.)
    pub camera: Option<&'a str>,
    /// Pixels across.
    pub width_px: u32,
    /// Pixels down.
    pub height_px: u32,
}

/// Draws: `[height, width, 3]`, row by row from the top, red, green and blue within 0 to 255.
///
/// # Errors
/// Any [`RenderError`].
pub fn draw(
    choice: GlChoice,
    physics: &Physics,
    (weather, pieces): (Option<&Weather>, Option<&Pieces>),
    view: View<'_>,
    picture: &mut Vec<u8>,
) -> Result<(), RenderError> {
    let View { camera, width_px, height_px } = view;
    if [width_px, height_px].iter().any(|side| !(1..=MAX_SIDE_PX).contains(side)) {
        return Err(RenderError::Size { width_px, height_px });
    }
    let is_smooth = width_px.max(height_px) <= MAX_SMOOTH_SIDE_PX;
    let scale = if is_smooth { 2 } else { 1 };
    let (width, height) = ((width_px * scale) as usize, (height_px * scale) as usize);
    canvas::with_canvas(choice, physics.model(), |canvas| {
        canvas.pose(physics, camera)?;
        canvas.set_pieces(pieces);
        canvas.cull(width, height);
        canvas.set_weather(weather);
        let rows = canvas.draw(width, height)?;
        picture.clear();
        if is_smooth {
            average_from_below(rows, width_px as usize, height_px as usize, picture);
        } else {
            picture.extend(rows.chunks_exact(3 * width).rev().flatten());
        }
        Ok(())
    })
}

/// What draws here; `None` until something was drawn.
#[must_use]
pub fn gl_info() -> Option<GlInfo> {
    gl::info()
}

/// From now on, what a thread has of OpenGL is left to the system when the thread ends.
pub(crate) fn leave_contexts() {
    gl::leave();
}

/// The mean of every 2 x 2 pixels, rounded; OpenGL's rows come from below.
fn average_from_below(rows: &[u8], width: usize, height: usize, picture: &mut Vec<u8>) {
    let row_len = 2 * width * 3;
    picture.resize(width * height * 3, 0);
    for (pair, row) in rows.chunks_exact(2 * row_len).rev().zip(picture.chunks_exact_mut(width * 3))
    {
        let (lower, upper) = pair.split_at(row_len);
        let cells = lower.chunks_exact(6).zip(upper.chunks_exact(6));
        for ((a, b), pixel) in cells.zip(row.chunks_exact_mut(3)) {
            for channel in 0..3 {
                let sum = u16::from(a[channel])
                    + u16::from(a[channel + 3])
                    + u16::from(b[channel])
                    + u16::from(b[channel + 3]);
                pixel[channel] = ((sum + 2) / 4) as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests;
