//! How many updates of soft actor-critic a second: replay, losses, gradients, optimisers.

use std::time::Instant;

use clap::Parser;
use palr_gym_bench::report;
use palr_gym_core::random::Generator;
use palr_gym_trainer::expert::agent::{Agent, Batch, UpdateNoise};
use palr_gym_trainer::expert::replay::{Replay, Transition};
use palr_gym_trainer::expert::{CriticKind, ExpertSettings};
use palr_gym_trainer::learning::noise::Normals;
use serde::Serialize;

/// What `palr-gym` allocates with.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Sizes of halfcheetah.
const OBSERVATION_SIZE: usize = 17;
const ACTION_SIZE: usize = 6;
/// Transitions to draw from, as many as the reference has.
const TRANSITIONS: usize = 100_000;

#[derive(Debug, Parser)]
#[command(about = "Measures updates of soft actor-critic")]
struct Cli {
    /// sac, or tqc for truncated quantile critics.
    #[arg(long, default_value = "sac")]
    critic: String,
    /// Updates to measure, after a tenth as many to warm up.
    #[arg(long)]
    updates: u64,
}

#[derive(Debug, Serialize)]
struct Rate {
    updates: u64,
    wall_s: f64,
    rate: f64,
}

fn main() -> anyhow::Result<()> {
    let cli = Cli::parse();
    let critic = if cli.critic == "tqc" { CriticKind::Tqc } else { CriticKind::Sac };
    // As the reference does: the actor with every update.
    let settings = ExpertSettings { critic, actor_every: 1, ..ExpertSettings::default() };
    let mut generator = Generator::from_seed(0);
    let mut replay = Replay::new(OBSERVATION_SIZE, ACTION_SIZE, TRANSITIONS);
    let mut normals = |count: usize| -> Vec<f32> {
        (0..count).map(|_| generator.standard_normal() as f32).collect()
    };
    for _ in 0..TRANSITIONS {
        replay.push(Transition {
            observation: &normals(OBSERVATION_SIZE),
            action: &normals(ACTION_SIZE).iter().map(|value| value.tanh()).collect::<Vec<_>>(),
            reward: normals(1)[0],
            next_observation: &normals(OBSERVATION_SIZE),
            terminated: false,
        });
    }
    let mut agent = Agent::new(&settings, OBSERVATION_SIZE, ACTION_SIZE);
    let mut batch = Batch::default();
    let mut update = || -> anyhow::Result<()> {
        replay.draw(&mut generator, settings.batch, &mut batch);
        let mut normals = Normals::new(&mut generator);
        let count = settings.batch * ACTION_SIZE;
        let noise =
            UpdateNoise { present: normals.draw(count, 1.0), next: normals.draw(count, 1.0) };
        agent.update(&batch, &noise)?;
        Ok(())
    };
    for _ in 0..cli.updates / 10 {
        update()?;
    }
    let started = Instant::now();
    for _ in 0..cli.updates {
        update()?;
    }
    let wall_s = started.elapsed().as_secs_f64();
    report(&Rate { updates: cli.updates, wall_s, rate: cli.updates as f64 / wall_s })?;
    Ok(())
}
