//! Steps a server through our Rust client: sessions side by side, one unless told otherwise, each on
//! a connection and a stream of its own. In a session each answer is awaited before the next request
//! is sent, as an agent must that chooses actions by what it sees.

use std::sync::Arc;
use std::time::Instant;

use clap::Parser;
use futures_util::future::try_join_all;
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
    /// Sessions side by side, each with the whole workload.
    #[arg(long, default_value_t = 1)]
    sessions: usize,
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

/// A session that has been opened and reset, with the actions still to send.
struct Player {
    session: Session,
    actions: Arc<[f32]>,
    row: usize,
    step: usize,
    resetting: u64,
}

impl Player {
    async fn open(cli: &Cli, index: usize, actions: Arc<[f32]>) -> anyhow::Result<Self> {
        let workload = &cli.workload;
        let client = Client::connect(&cli.server).await?;
        let request = v1::OpenSessionRequest {
            env_id: workload.task.clone(),
            num_envs: Some(workload.num_envs as u32),
            ..v1::OpenSessionRequest::default()
        };
        let mut session = Session::open(&client, request).await?;
        session.reset(vec![workload.seed + (index * workload.num_envs) as u64]).await?;
        let row = actions.len() / workload.total_steps();
        Ok(Self { session, actions, row, step: 0, resetting: 0 })
    }

    /// Takes `steps` steps of the session. Returns how many of the environments' did not only reset.
    async fn play(&mut self, steps: usize) -> anyhow::Result<u64> {
        let num_envs = self.session.num_envs() as u64;
        let mut env_steps = 0;
        for _ in 0..steps {
            let actions = &self.actions[self.step * self.row..(self.step + 1) * self.row];
            let answer = self.session.step(actions).await?;
            env_steps += num_envs - self.resetting;
            self.resetting = ended(&answer);
            self.step += 1;
        }
        Ok(env_steps)
    }
}

async fn measure(cli: &Cli) -> anyhow::Result<Measurement> {
    let workload = &cli.workload;
    let action_size = palr_gym_sim::resolve(&workload.task)?.1.action_size();
    let actions: Arc<[f32]> = workload.actions(action_size).into();
    let mut players = Vec::with_capacity(cli.sessions);
    for index in 0..cli.sessions {
        players.push(Player::open(cli, index, Arc::clone(&actions)).await?);
    }
    try_join_all(players.iter_mut().map(|player| player.play(workload.warm_up))).await?;
    let started = Instant::now();
    let played = try_join_all(players.iter_mut().map(|player| player.play(workload.steps))).await?;
    let wall_s = started.elapsed().as_secs_f64();
    for player in players {
        player.session.close().await?;
    }
    let env_steps = played.into_iter().sum();
    Ok(Measurement { env_steps, wall_s, rate: env_steps as f64 / wall_s })
}

// One thread: it has nothing to do but to wait, and the cores belong to the simulation.
#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    report(&measure(&Cli::parse()).await?)?;
    Ok(())
}
