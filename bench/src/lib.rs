//! What `make bench` runs on the Rust side. `bench/README.md` says what is compared and why that
//! is fair.
//!
//! # Layout
//! - `bin/bench-limit.rs`: bare physics, the upper limit of any server.
//! - `bin/bench-in-process.rs`: our environments without a server.
//! - `bin/bench-rust-client.rs`: steps a server through our Rust client.
//! - `bin/bench-start.rs`: how long a server takes to be healthy.
//! - `bin/bench-echo.rs`: a server that answers steps without taking any.
//! - `bin/bench-train.rs`: what a step of imitation learning costs; `bin/bench-sac.rs`: updates of
//!   soft actor-critic.
//! - `bin/bench-collect-limit.rs`: bare physics and inference, the upper limit of recording.
//! - `bin/bench-see.rs`: drawing, and features of pictures; `bin/bench-see-limit.rs`, on [`bare`]: the
//!   same, and stepping, without any of ours.
//! - here: the work that all of them are given, and how they report.
//!
//! Every program measures once and prints one line of JSON; `bench/run.py` repeats, interleaves
//! and compares.
#![allow(clippy::print_stdout, reason = "the result goes to whoever started the program")]

pub mod bare;

use std::time::Duration;

use anyhow::Context;
use clap::Args;
use palr_gym_core::random::Generator;
use serde::Serialize;

/// What every contender steps: the same environments from the same seeds with the same actions.
#[derive(Debug, Clone, Args)]
pub struct Workload {
    /// Task, such as hopper.
    #[arg(long)]
    pub task: String,
    /// Environments side by side.
    #[arg(long, default_value_t = 64)]
    pub num_envs: usize,
    /// Environment i is reset with this + i. Actions are drawn from it too.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Steps of all environments before the clock starts.
    #[arg(long, default_value_t = 100)]
    pub warm_up: usize,
    /// Steps of all environments while it runs.
    #[arg(long, default_value_t = 1000)]
    pub steps: usize,
}

impl Workload {
    /// Steps of all environments, warm-up included.
    #[must_use]
    pub fn total_steps(&self) -> usize {
        self.warm_up + self.steps
    }

    /// Uniformly random actions, `[total_steps, num_envs, action_size]`: bit for bit what
    /// `numpy.random.default_rng(seed).uniform(-1, 1, shape).astype(numpy.float32)` gives the
    /// Python contenders.
    #[must_use]
    pub fn actions(&self, action_size: usize) -> Vec<f32> {
        let mut generator = Generator::from_seed(self.seed);
        let count = self.total_steps() * self.num_envs * action_size;
        (0..count).map(|_| generator.uniform(-1.0, 1.0) as f32).collect()
    }
}

/// What a contender did while the clock ran.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Measurement {
    /// Environment steps. Steps that only reset (NEXT_STEP) are not counted.
    pub env_steps: u64,
    /// Seconds from the first to the last.
    pub wall_s: f64,
    /// Environment steps per second.
    pub rate: f64,
}

/// Pictures that were drawn, or of which features were made, while the clock ran.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Seen {
    /// How many.
    pub pictures: usize,
    /// Seconds from the first to the last.
    pub wall_s: f64,
    /// CPU seconds of all threads.
    pub cpu_s: f64,
    /// Pictures per second.
    pub rate: f64,
    /// Pictures per CPU second.
    pub rate_per_cpu_s: f64,
}

impl Seen {
    /// `pictures` in `wall`, which took `cpu_s`.
    #[must_use]
    pub fn new(pictures: usize, wall: Duration, cpu_s: f64) -> Self {
        let (count, wall_s) = (pictures as f64, wall.as_secs_f64());
        Self { pictures, wall_s, cpu_s, rate: count / wall_s, rate_per_cpu_s: count / cpu_s }
    }
}

/// CPU seconds of all threads of this process so far, to a hundredth.
///
/// # Errors
/// Where there is no /proc.
pub fn cpu_s() -> anyhow::Result<f64> {
    const TICKS_PER_S: f64 = 100.0;
    let text = std::fs::read_to_string("/proc/self/stat")?;
    // The program's name may hold spaces; it ends with the last parenthesis.
    let (_, rest) = text.rsplit_once(')').context("/proc/self/stat has no name")?;
    let fields: Vec<&str> = rest.split_whitespace().collect();
    let ticks = |index: usize| -> anyhow::Result<f64> {
        Ok(fields.get(index).context("/proc/self/stat is too short")?.parse()?)
    };
    Ok((ticks(11)? + ticks(12)?) / TICKS_PER_S)
}

/// Prints `result` as the program's one line of output.
///
/// # Errors
/// None that a plain struct can cause.
pub fn report(result: &impl Serialize) -> serde_json::Result<()> {
    println!("{}", serde_json::to_string(result)?);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn actions_are_what_numpy_draws() {
        let workload =
            Workload { task: "hopper".into(), num_envs: 1, seed: 0, warm_up: 1, steps: 1 };
        // numpy.random.default_rng(0).uniform(-1, 1, (2, 1, 3)).astype(numpy.float32)
        let want = [0.27392337, -0.46042657, -0.918053, -0.96694475, 0.6265405, 0.82551116];
        assert_eq!(workload.actions(3), want);
    }
}
