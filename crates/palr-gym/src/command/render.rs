//! `palr-gym render`

use std::path::Path;

use anyhow::{Context, bail};
use palr_gym_trainer::film::{FilmOptions, Frame, Look, film, picture};
use palr_gym_trainer::{ClientError, PolicySource};

use super::evaluate::action_mode;
use crate::cli::render::RenderArguments;
use crate::movie::{Format, Movie, png};
use crate::{backend, progress};

/// Draws and writes.
pub async fn run(arguments: RenderArguments) -> anyhow::Result<()> {
    let format = Format::of(&arguments.out);
    let is_movie = format.is_some();
    if !is_movie && arguments.out.extension().is_none_or(|extension| extension != "png") {
        bail!("{}: expected a file ending in .png, .mp4 or .gif", arguments.out.display());
    }
    let (width_px, height_px) = arguments.size;
    let camera = arguments.camera.clone().unwrap_or_default();
    let look = Look { camera, width_px, height_px };
    let client = backend::connect_drawing(&arguments.server, arguments.gl.choice).await?;
    if let Some(session) = &arguments.session {
        if is_movie {
            bail!("--session draws a single picture; expected --out with a file ending in .png");
        }
        let frame = picture(&client, session, arguments.env_index, &look).await?;
        return write(&arguments.out, &png(width_px, height_px, &frame)?);
    }
    let env_id = arguments.env.clone().unwrap_or_default();
    let spec = client.spec(&env_id).await?;
    let steps = if is_movie { arguments.steps } else { Some(arguments.step) };
    let options = FilmOptions {
        env_id,
        policy: PolicySource::parse(&arguments.policy),
        seed: arguments.seed,
        action_mode: action_mode(arguments.sampled),
        scene_options: arguments.scene.options(),
        steps,
        look,
    };
    let length = steps.unwrap_or(spec.max_episode_steps as usize) as u64 + 1;
    let bar = progress::bar("render", length, "pictures");
    let fps = arguments.fps.unwrap_or_else(|| (1.0 / spec.control_timestep_s).round() as u32);
    let new = |format| Movie::new(format, width_px, height_px, fps);
    let mut movie = format.map(new).transpose()?;
    let mut last = Frame::new();
    film(&client, &options, |frame| {
        bar.inc(1);
        if let Some(movie) = &mut movie {
            movie.add(&frame).map_err(|error| ClientError::file(&arguments.out, error))?;
        }
        last = frame;
        Ok(())
    })
    .await?;
    bar.finish_and_clear();
    let bytes = match movie {
        Some(movie) => movie.finish()?,
        None => png(width_px, height_px, &last)?,
    };
    write(&arguments.out, &bytes)
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
    println!("{}: {} bytes", path.display(), bytes.len());
    Ok(())
}
