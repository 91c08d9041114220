//! `palr-gym leakage`

use palr_gym_data::HeldOut;
use palr_gym_trainer::PolicySource;
use palr_gym_trainer::leakage::{LeakageOptions, estimate};

use super::evaluate::action_mode;
use crate::cli::LeakageArguments;
use crate::{backend, output};

/// Estimates and prints.
pub async fn run(arguments: LeakageArguments) -> anyhow::Result<()> {
    let client = backend::connect(&arguments.server).await?;
    let held_out = match arguments.slice {
        Some(start) => HeldOut::slice(start, arguments.rows),
        None => HeldOut::spread(arguments.rows, arguments.min_episodes),
    };
    let options = LeakageOptions {
        env_id: arguments.env,
        policy: PolicySource::parse(&arguments.policy),
        data: arguments.data,
        selection: held_out.after(arguments.training_rows),
        action_mode: action_mode(!arguments.deterministic),
        ridge: arguments.ridge,
        bandwidth_sq: arguments.bandwidth_sq,
        seed: arguments.seed,
    };
    let leakage = estimate(&client, &options).await?;
    if arguments.json {
        return output::json(&leakage);
    }
    let (low, high) = leakage.hscic_interval;
    let blocks = if leakage.is_by_episode { "whole episodes" } else { "moving blocks" };
    let row = vec![
        leakage.policy,
        leakage.env_id,
        leakage.action_mode,
        leakage.samples.to_string(),
        leakage.episodes.to_string(),
        format!("{:.3e}", leakage.hscic),
        format!("[{low:.3e}, {high:.3e}] over {blocks}"),
    ];
    let header = ["policy", "environment", "actions", "samples", "episodes", "HSCIC", "95 %"];
    println!("{}", output::table(&header, vec![row], 3));
    Ok(())
}
