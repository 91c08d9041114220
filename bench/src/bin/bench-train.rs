//! What a training step costs: CPU seconds of all threads, the run's own bookkeeping included.

use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, bail};
use clap::Parser;
use palr_gym_bench::report;
use palr_gym_core::random::Generator;
use palr_gym_trainer::learning::{TrainConfig, TrainingSet, train};
use serde::Serialize;
use serde_json::json;

const ROWS: usize = 30_000;

#[derive(Debug, Parser)]
#[command(about = "Measures what a training step costs")]
struct Cli {
    /// Such as bc, palr-exact or palr-pool.
    #[arg(long)]
    method: String,
    /// hopper-w2 or ant-w4.
    #[arg(long)]
    setting: String,
    /// Steps to measure, after as many to warm up, or more to fill a pool.
    #[arg(long)]
    steps: u64,
}

#[derive(Debug, Serialize)]
struct Cost {
    cpu_s_per_step: f64,
    steps: u64,
}

/// Numbers of the right sizes: what a step costs does not depend on them.
fn data(setting: &str) -> anyhow::Result<TrainingSet> {
    let (observation_size, frame_stack, action_size) = match setting {
        "hopper-w2" => (5 * 2, 2, 3),
        "ant-w4" => (13 * 4, 4, 8),
        _ => bail!("no setting {setting}; expected hopper-w2 or ant-w4"),
    };
    let mut generator = Generator::from_seed(0);
    let mut normals =
        |n: usize| -> Vec<f32> { (0..n).map(|_| generator.standard_normal() as f32).collect() };
    let observations = normals(ROWS * observation_size);
    let actions: Vec<f32> =
        normals(ROWS * action_size).iter().map(|value| (0.7 * value).tanh()).collect();
    let mut past_actions = actions.clone();
    past_actions.rotate_right(action_size);
    let set =
        TrainingSet::new(&observations, observation_size, actions, past_actions, action_size)?;
    Ok(set.with_frame_stack(frame_stack)?)
}

/// CPU seconds of this process, all threads; in ticks of a hundredth.
fn cpu_s() -> anyhow::Result<f64> {
    const TICKS_PER_S: f64 = 100.0;
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    // The name, the only field with spaces, ends with the last parenthesis.
    let (_, fields) = stat.rsplit_once(')').context("/proc/self/stat has another form")?;
    let ticks = fields.split_whitespace().skip(11).take(2).map(str::parse::<u64>);
    Ok(ticks.sum::<Result<u64, _>>()? as f64 / TICKS_PER_S)
}

fn main() -> anyhow::Result<()> {
    let cli = Cli::parse();
    let (algorithm, weights) = match cli.method.split_once('-') {
        Some((algorithm, weights)) => (algorithm, weights),
        None => (cli.method.as_str(), "exact"),
    };
    // A pool is full before the clock starts; its size changes what a step costs only by caches.
    let pool_size = cli.steps.min(64);
    let config = TrainConfig::from_json(json!({
        "algorithm": algorithm,
        "steps": 2 * cli.steps,
        "log_every": cli.steps,
        "checkpoint_every": 4 * cli.steps,
        "metric_rows": 2,
        "palr": {"weights": weights, "pool_size": pool_size},
    }))?;
    let folder = std::env::current_dir()?.join("run");
    std::fs::create_dir_all(&folder)?;
    let mut started = 0.0;
    let mut spent = 0.0;
    let is_stopped = AtomicBool::new(false);
    train(&config, &data(&cli.setting)?, None, &folder, false, &is_stopped, |progress| {
        let now = cpu_s().unwrap_or(f64::NAN);
        if progress.step == cli.steps {
            started = now;
        } else {
            spent = now - started;
        }
        ControlFlow::Continue(())
    })?;
    report(&Cost { cpu_s_per_step: spent / cli.steps as f64, steps: cli.steps })?;
    Ok(())
}
