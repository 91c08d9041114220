//! `palr-gym demo`

use std::path::PathBuf;

use clap::Args;

/// `palr-gym demo`
#[derive(Debug, Args)]
#[command(after_help = "\
Records demonstrations of the expert, trains behaviour cloning and PALR on them side by side, and
measures expert, both policies and chance: return, score, held-out likelihood, leakage. A few minutes.

Each run has a folder of its own, OUT/001, OUT/002 and so on, with the data, a run's folder for each
method, results.json and a figure. --resume finishes the newest one, interrupted or not.")]
pub struct DemoArguments {
    /// Folder of runs.
    #[arg(long, value_name = "OUT", default_value = "runs/demo")]
    pub out: PathBuf,
    /// Environment as which the policies see the data; its task must have an expert.
    #[arg(long, value_name = "ID", default_value = "hopper-w2")]
    pub env: String,
    /// Transitions to collect.
    #[arg(long, value_name = "N", default_value_t = 55_000)]
    pub transitions: u64,
    /// Transitions to train on.
    #[arg(long, value_name = "N", default_value_t = 30_000)]
    pub training_rows: usize,
    /// Later transitions to hold out, over at least 20 episodes.
    #[arg(long, value_name = "N", default_value_t = 2_000)]
    pub held_out_rows: usize,
    /// Steps of Adam for each method.
    #[arg(long, value_name = "N", default_value_t = 20_000)]
    pub steps: u64,
    /// α of PALR.
    #[arg(long, value_name = "α", default_value_t = 10.0, allow_negative_numbers = true)]
    pub alpha: f64,
    /// Episodes to evaluate each policy on.
    #[arg(long, value_name = "N", default_value_t = 20)]
    pub episodes: u32,
    /// Seed of everything.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Finish the newest run.
    #[arg(long)]
    pub resume: bool,
    /// Print the results as JSON.
    #[arg(long)]
    pub json: bool,
}
