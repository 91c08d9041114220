//! `palr-gym bench`

use std::time::Duration;

use clap::{Args, Subcommand};

use super::ServerArguments;

/// `palr-gym bench`
#[derive(Debug, Args)]
#[command(after_help = "\
The load is a random policy in one session. Without --server, the server is in this process; its rates
are a little higher then than over a socket.

Examples:
  palr-gym bench step --env hopper-w2 --num-envs 64
  palr-gym bench step --server localhost:7257 --env ant --num-envs 512 --in-flight 2 --json
  palr-gym bench latency --server unix:/tmp/palr-gym.sock --env hopper")]
pub struct BenchArguments {
    /// What to measure.
    #[command(subcommand)]
    pub what: BenchCommand,
}

/// What to measure.
#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    /// Environment steps per second.
    Step(BenchStepArguments),
    /// How long a step takes, there and back.
    Latency(BenchLatencyArguments),
}

/// `palr-gym bench step`
#[derive(Debug, Args)]
pub struct BenchStepArguments {
    /// Environments side by side.
    #[arg(long, value_name = "N", default_value_t = 64)]
    pub num_envs: u32,
    /// Requests under way together; 1 is an agent that looks before it acts.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub in_flight: u32,
    #[command(flatten)]
    pub common: BenchCommonArguments,
}

/// `palr-gym bench latency`
#[derive(Debug, Args)]
pub struct BenchLatencyArguments {
    /// Environments that a step steps.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub num_envs: u32,
    #[command(flatten)]
    pub common: BenchCommonArguments,
}

/// What both measure with.
#[derive(Debug, Args)]
pub struct BenchCommonArguments {
    /// Environment, such as hopper-w2.
    #[arg(long, value_name = "ID")]
    pub env: String,
    /// How long a repeat lasts.
    #[arg(long, value_name = "SECONDS", default_value = "2", value_parser = parse_seconds)]
    pub seconds: Duration,
    /// How often it is measured.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub repeats: u32,
    /// Seed of the environments and of the actions.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

fn parse_seconds(text: &str) -> Result<Duration, String> {
    match text.parse::<f64>() {
        Ok(seconds) if (0.01..=3600.0).contains(&seconds) => Ok(Duration::from_secs_f64(seconds)),
        _ => Err("expected seconds from 0.01 to 3600".into()),
    }
}
