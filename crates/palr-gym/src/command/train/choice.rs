//! What `--alpha auto` came to.

use std::path::Path;

use palr_gym_trainer::ClientError;
use palr_gym_trainer::imitate::Outcome;
use palr_gym_trainer::imitate::choice::{Choice, choose};

/// In the folder of runs.
const FILE: &str = "alpha.json";

/// Chooses, and leaves the choice beside the runs.
pub(super) fn of_runs(outcomes: &[Outcome], out: &Path) -> anyhow::Result<Vec<Choice>> {
    let folders: Vec<&Path> = outcomes.iter().map(|outcome| outcome.run_folder.as_path()).collect();
    let choices = choose(&folders)?;
    let path = out.join(FILE);
    let text = serde_json::to_string_pretty(&choices)? + "\n";
    std::fs::write(&path, text).map_err(|error| ClientError::file(path, error))?;
    Ok(choices)
}

pub(super) fn print(choice: &Choice) {
    println!("{} {}: α = {}", choice.env_id, choice.algorithm, choice.alpha);
    for candidate in &choice.candidates {
        println!(
            "  α {:>7}: log-likelihood where held-out actions change {:.4}",
            candidate.alpha, -candidate.change_nll
        );
    }
}
