//! What an agent that sees pictures costs without any simulation: drawing, or features of what was
//! drawn.

use std::path::PathBuf;
use std::sync::{Arc, Barrier};
use std::thread;
use std::time::Instant;

use clap::{Parser, Subcommand};
use palr_gym_bench::{Seen, cpu_s, report};
use palr_gym_sim::render::{GlChoice, View, prepare_process};
use palr_gym_sim::{Env, resolve};
use palr_gym_vision::{Extractor, ExtractorLimits};

#[derive(Debug, Parser)]
#[command(about = "Measures drawing and features")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Draws lane's driver picture, 48 x 48 pixels.
    Render {
        /// Pictures of each thread.
        #[arg(long)]
        pictures: usize,
        /// Threads, each with a context of its own.
        #[arg(long, default_value_t = 1)]
        threads: usize,
    },
    /// Makes features of pictures on one thread.
    Features {
        /// The model.
        #[arg(long)]
        extractor: PathBuf,
        /// Pictures in a batch.
        #[arg(long, default_value_t = 32)]
        batch: usize,
        /// Batches.
        #[arg(long)]
        batches: usize,
    },
}

fn main() -> anyhow::Result<()> {
    // Else Mesa starts threads of its own.
    prepare_process();
    palr_gym_sim::mujoco_log::route_to_log();
    let seen = match Cli::parse().command {
        Command::Render { pictures, threads } => render(pictures, threads)?,
        Command::Features { extractor, batch, batches } => {
            let extractor = Extractor::read(&extractor, ExtractorLimits::default())?;
            features(&extractor, batch, batches)?
        }
    };
    report(&seen)?;
    Ok(())
}

fn render(pictures: usize, threads: usize) -> anyhow::Result<Seen> {
    // Before the first and after the last picture that counts.
    let (begin, end) = (Barrier::new(threads + 1), Barrier::new(threads + 1));
    thread::scope(|scope| {
        let drawn: Vec<_> = (0..threads)
            .map(|_| {
                let (begin, end) = (&begin, &end);
                scope.spawn(move || -> anyhow::Result<()> {
                    let drawn = (|| {
                        let (task, spec) = resolve("lane")?;
                        let mut env = Env::new(task, &Arc::new(spec))?;
                        // The same picture on each, so that each has the same to do.
                        env.reset(Some(0))?;
                        let view = View { camera: Some("driver"), width_px: 48, height_px: 48 };
                        let mut picture = Vec::new();
                        // The first pictures compile shaders.
                        for _ in 0..20 {
                            env.draw(GlChoice::Auto, view, &mut picture)?;
                        }
                        anyhow::Ok((env, view, picture))
                    })();
                    begin.wait();
                    let drawn = drawn.and_then(|(env, view, mut picture)| {
                        for _ in 0..pictures {
                            env.draw(GlChoice::Auto, view, &mut picture)?;
                        }
                        Ok(())
                    });
                    end.wait();
                    drawn
                })
            })
            .collect();
        begin.wait();
        let (started, before) = (Instant::now(), cpu_s()?);
        end.wait();
        let seen = Seen::new(pictures * threads, started.elapsed(), cpu_s()? - before);
        for thread in drawn {
            thread.join().map_err(|_| anyhow::anyhow!("a thread panicked"))??;
        }
        Ok(seen)
    })
}

fn features(extractor: &Extractor, batch: usize, batches: usize) -> anyhow::Result<Seen> {
    let (height_px, width_px) = extractor.picture_size_px();
    let bytes = batch * (height_px * width_px * 3) as usize;
    let pictures: Vec<u8> = (0..bytes).map(|i| (i * 7919 % 251) as u8).collect();
    let mut features = Vec::new();
    for _ in 0..(batches / 10).max(1) {
        extractor.extract(&pictures, batch, &mut features)?;
    }
    let (started, before) = (Instant::now(), cpu_s()?);
    for _ in 0..batches {
        extractor.extract(&pictures, batch, &mut features)?;
    }
    Ok(Seen::new(batch * batches, started.elapsed(), cpu_s()? - before))
}
