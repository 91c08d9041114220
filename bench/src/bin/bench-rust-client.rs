//! Steps a server through our Rust client: one session on one stream, each answer awaited before
//! the next request is sent, as an agent must that chooses actions by what it sees.

use std::time::Instant;

use clap::Parser;
use palr_gym_bench::{Measurement, Workload, report};
use palr_gym_proto::v1;
use palr_gym_trainer::session::Session;
use palr_gym_trainer::{Client, ServerAddress};

#[derive(Debug, Parser)]
#[command(about = "Measures a server with the Rust client")]
struct Cli {
    #[command(flatten)]
    workload: Workload,
    /// The server: HOST:PORT or unix:PATH.
    #[arg(long)]
    server: ServerAddress,
}

/// Environments whose episode this step ended; the next step will only reset them.
fn ended(answer: &v1::StepResponse) -> u64 {
    let flags = |tensor: &Option<v1::Tensor>| {
        tensor.as_ref().map(|tensor| tensor.data.clone()).unwrap_or_default()
    };
    flags(&answer.terminated)
        .iter()
        .zip(&flags(&answer.truncated))
        .filter(|(terminated, truncated)| **terminated | **truncated != 0)
        .count() as u64
}

async fn measure(cli: &Cli) -> anyhow::Result<Measurement> {
    let workload = &cli.workload;
    let client = Client::connect(&cli.server).await?;
    let request = v1::OpenSessionRequest {
        env_id: workload.task.clone(),
        num_envs: Some(workload.num_envs as u32),
        ..v1::OpenSessionRequest::default()
    };
    let mut session = Session::open(&client, request).await?;
    let space = session.spec().action_space.clone().unwrap_or_default();
    let action_size: i64 = space.shape.iter().product();
    let actions = workload.actions(action_size as usize);
    let mut rows = actions.chunks_exact(workload.num_envs * action_size as usize);
    session.reset(vec![workload.seed]).await?;
    let mut resetting = 0;
    for actions in rows.by_ref().take(workload.warm_up) {
        resetting = ended(&session.step(actions).await?);
    }
    let started = Instant::now();
    let mut env_steps = 0;
    for actions in rows {
        let answer = session.step(actions).await?;
        env_steps += workload.num_envs as u64 - resetting;
        resetting = ended(&answer);
    }
    let wall_s = started.elapsed().as_secs_f64();
    session.close().await?;
    Ok(Measurement { env_steps, wall_s, rate: env_steps as f64 / wall_s })
}

// One thread: it has nothing to do but to wait, and the cores belong to the simulation.
#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    report(&measure(&Cli::parse()).await?)?;
    Ok(())
}
