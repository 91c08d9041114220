//! `palr-gym render`

use std::path::PathBuf;

use clap::Args;
use palr_gym_sim::render::GlChoice;

use super::ServerArguments;
use super::scene::SceneArguments;

/// `palr-gym render`
#[derive(Debug, Args)]
#[command(after_help = "\
The ending of --out chooses the format: .png for a single picture (of the reset, or of --step), .mp4
(H.264) or .gif for an episode. The policy plays on the server; its episode is then played again and drawn.

Examples:
  palr-gym render --env lane --out lane.mp4
  palr-gym render --env town --vehicles 8 --steps 400 --out town.gif
  palr-gym render --env lane --camera chase --weather random --seed 3 --out weather.gif
  palr-gym render --env hopper --policy random --step 20 --out hopper.png
  palr-gym render --session 4b51… --server localhost:7257 --out now.png")]
pub struct RenderArguments {
    /// Environment, such as lane or hopper.
    #[arg(
        long,
        value_name = "ID",
        required_unless_present = "session",
        conflicts_with = "session"
    )]
    pub env: Option<String>,
    /// `expert`, `random`, an ONNX file, or the folder of a training run.
    #[arg(long, value_name = "POLICY", default_value = "expert")]
    pub policy: String,
    /// Sample actions from a stochastic policy instead of taking its mean.
    #[arg(long)]
    pub sampled: bool,
    /// Seed of the episode.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Film at most this many steps.
    #[arg(long, value_name = "N")]
    pub steps: Option<usize>,
    /// Draw a single picture, after this many steps (.png).
    #[arg(long, value_name = "K", default_value_t = 0, conflicts_with = "steps")]
    pub step: usize,
    /// Draw what an open session of a server looks like now (.png).
    #[arg(long, value_name = "SESSION", requires = "server")]
    pub session: Option<String>,
    /// Which environment of the session.
    #[arg(long, value_name = "I", default_value_t = 0, requires = "session")]
    pub env_index: u32,
    /// One of the environment's cameras (`palr-gym envs ID` lists them) [default: the first].
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// Size of the pictures in pixels, WIDTHxHEIGHT.
    #[arg(long, value_name = "WxH", default_value = "480x480", value_parser = size)]
    pub size: (u32, u32),
    /// Pictures a second [default: as many as the environment has steps].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100))]
    pub fps: Option<u32>,
    /// File to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    #[command(flatten)]
    pub scene: SceneArguments,
    #[command(flatten)]
    pub gl: GlArguments,
    #[command(flatten)]
    pub server: ServerArguments,
}

/// What pictures are drawn with.
#[derive(Debug, Clone, Copy, Args)]
pub struct GlArguments {
    /// OpenGL to draw with: `auto` takes OSMesa, else EGL on the processor. Loaded when it is first
    /// needed; without any, all but pictures works.
    #[arg(long = "gl", value_name = "GL", default_value = "auto", value_parser = gl_choice)]
    pub choice: GlChoice,
}

fn gl_choice(text: &str) -> Result<GlChoice, String> {
    let names = || GlChoice::ALL.map(GlChoice::name).join(", ");
    let found = GlChoice::ALL.into_iter().find(|choice| choice.name() == text);
    found.ok_or_else(|| format!("expected one of {}", names()))
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let sides = text
        .split_once('x')
        .and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    sides.ok_or_else(|| "expected WIDTHxHEIGHT, such as 640x480".to_owned())
}
