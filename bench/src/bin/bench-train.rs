//! What a training step costs: CPU seconds of all threads, the run's own bookkeeping included.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, bail};
use clap::Parser;
use palr_gym_bench::{cpu_s, report};
use palr_gym_core::random::Generator;
use palr_gym_trainer::learning::{LockstepRun, TrainConfig, TrainingSet, train_lockstep};
use serde::Serialize;
use serde_json::json;

/// What `palr-gym` allocates with.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const ROWS: usize = 30_000;
const EPISODE_ROWS: usize = 1000;

#[derive(Debug, Parser)]
#[command(about = "Measures what a training step costs")]
struct Cli {
    /// Such as bc, palr-exact, palr-pool or palr-lockstep10: five seeds with two stacks each, of which
    /// the cost of one is told.
    #[arg(long)]
    method: String,
    /// hopper-w2 or ant-w4.
    #[arg(long)]
    setting: String,
    /// Steps to measure.
    #[arg(long)]
    steps: u64,
    /// Steps before the clock starts, which also fill a pool; --steps must be a multiple [default: as many
    /// as are measured].
    #[arg(long)]
    warm_up: Option<u64>,
}

#[derive(Debug, Serialize)]
struct Cost {
    cpu_s_per_step: f64,
    steps: u64,
}

/// Numbers of the right sizes: what a step costs does not depend on them.
fn data(setting: &str) -> anyhow::Result<TrainingSet> {
    let (frame_size, frame_stack, action_size) = match setting {
        "hopper-w2" => (5, 2, 3),
        "hopper-w4" => (5, 4, 3),
        "ant-w2" => (13, 2, 8),
        "ant-w4" => (13, 4, 8),
        _ => bail!("no setting {setting}; expected hopper or ant, with -w2 or -w4"),
    };
    let observation_size = frame_size * frame_stack;
    let mut generator = Generator::from_seed(0);
    let mut normals =
        |n: usize| -> Vec<f32> { (0..n).map(|_| generator.standard_normal() as f32).collect() };
    // Before the observations: runs with other stacks share them.
    let actions: Vec<f32> =
        normals(ROWS * action_size).iter().map(|value| (0.7 * value).tanh()).collect();
    let observations = normals(ROWS * observation_size);
    let mut past_actions = actions.clone();
    past_actions.rotate_right(action_size);
    let set =
        TrainingSet::new(&observations, observation_size, actions, past_actions, action_size)?;
    Ok(set.with_frame_stack(frame_stack)?.with_episodes(&[EPISODE_ROWS; ROWS / EPISODE_ROWS])?)
}

fn main() -> anyhow::Result<()> {
    let cli = Cli::parse();
    let (algorithm, weights) = match cli.method.split_once('-') {
        Some((algorithm, weights)) => (algorithm, weights),
        None => (cli.method.as_str(), "exact"),
    };
    let (weights, is_lockstep) =
        if weights == "lockstep10" { ("exact", true) } else { (weights, false) };
    let warm_up = cli.warm_up.unwrap_or(cli.steps);
    anyhow::ensure!(
        warm_up > 0 && cli.steps.is_multiple_of(warm_up),
        "--steps {} is no multiple of --warm-up {warm_up}",
        cli.steps
    );
    // A pool is full before the clock starts; its size changes what a step costs only by caches.
    let pool_size = warm_up.min(64);
    let config = |seed: u64| {
        TrainConfig::from_json(json!({
            "algorithm": algorithm,
            "steps": warm_up + cli.steps,
            "log_every": warm_up,
            "checkpoint_every": 4 * (warm_up + cli.steps),
            "metric_rows": 2,
            "seed": seed,
            "batch_seed": 0,
            "palr": {"weights": weights, "pool_size": pool_size},
        }))
    };
    let seeds = if is_lockstep { 5 } else { 1 };
    let configs: Vec<TrainConfig> = (0..seeds).map(config).collect::<Result<_, _>>()?;
    let (task, _) = cli.setting.split_once('-').context("a setting is TASK-wN")?;
    let sets = match is_lockstep {
        true => vec![data(&format!("{task}-w2"))?, data(&format!("{task}-w4"))?],
        false => vec![data(&cli.setting)?],
    };
    let folder = std::env::current_dir()?.join("run");
    let places: Vec<(&TrainConfig, &TrainingSet, PathBuf)> = sets
        .iter()
        .flat_map(|data| configs.iter().map(move |config| (config, data)))
        .enumerate()
        .map(|(i, (config, data))| (config, data, folder.join(i.to_string())))
        .collect();
    let mut runs = Vec::new();
    for (config, data, run_folder) in &places {
        std::fs::create_dir_all(run_folder)?;
        runs.push(LockstepRun { config, data, held_out: None, run_folder });
    }
    let last = runs.len() - 1;
    let (mut started, mut spent) = (0.0, 0.0);
    train_lockstep(&runs, false, &AtomicBool::new(false), |place, progress| {
        let now = cpu_s().unwrap_or(f64::NAN);
        if place == last && progress.step == warm_up {
            started = now;
        } else if place == last {
            spent = now - started;
        }
        ControlFlow::Continue(())
    })?;
    let steps = cli.steps * runs.len() as u64;
    report(&Cost { cpu_s_per_step: spent / steps as f64, steps })?;
    Ok(())
}
