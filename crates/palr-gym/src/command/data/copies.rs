//! `palr-gym data slice` and `palr-gym data convert`

use palr_gym_data::copy::copy;
use palr_gym_data::d4rl::Metadata;
use palr_gym_data::{Copied, Layout, Part};
use palr_gym_trainer::ClientError;
use palr_gym_trainer::imitate::data::sha256;
use palr_gym_trainer::learning::TrainError;
use serde_json::json;

use crate::cli::data::DataConvertArguments;
use crate::output;

/// Copies and says what.
pub fn run(arguments: &DataConvertArguments, part: &Part) -> anyhow::Result<()> {
    let DataConvertArguments { from, to, id, json } = arguments;
    let layout = match to.extension().and_then(|extension| extension.to_str()) {
        Some("hdf5" | "h5") => Layout::D4rl,
        _ => Layout::Minari,
    };
    let name = || to.file_name().map(|name| name.to_string_lossy().into_owned());
    let id = id.clone().or_else(name).unwrap_or_default();
    if layout == Layout::Minari && !is_minari_id(&id) {
        let message = format!(
            "{id:?} is no name of a Minari data set; expected one that ends in -vN, such as \
             hopper-expert-v0 (or an OUT that ends in .hdf5, for D4RL's layout)"
        );
        return Err(ClientError::from(TrainError::Setting { message }).into());
    }
    let extra = [
        ("source_sha256".to_owned(), Metadata::Text(sha256(from)?)),
        ("source_part".to_owned(), Metadata::Text(describe(part))),
    ];
    let Copied { episodes, transitions } = copy(from, to, layout, part, &id, &extra)?;
    if *json {
        return output::json(&json!({
            "path": to, "episodes": episodes, "transitions": transitions,
        }));
    }
    println!("{}: {transitions} transitions in {episodes} episodes", to.display());
    Ok(())
}

fn is_minari_id(id: &str) -> bool {
    let Some((name, version)) = id.rsplit_once("-v") else { return false };
    let is_name = |text: &str| {
        !text.is_empty() && text.chars().all(|c| c.is_ascii_alphanumeric() || "-_./".contains(c))
    };
    is_name(name) && !version.is_empty() && version.chars().all(|c| c.is_ascii_digit())
}

fn describe(part: &Part) -> String {
    if *part == Part::default() {
        return "all of it".to_owned();
    }
    let all = |count: Option<usize>| count.map_or_else(|| "all".to_owned(), |n| n.to_string());
    let Part { first_episode, episodes, transitions } = part;
    let (episodes, transitions) = (all(*episodes), all(*transitions));
    format!("from episode {first_episode} on, episodes: {episodes}, transitions: {transitions}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_minari_data_sets_end_in_a_version() {
        for name in ["hopper-expert-v0", "mujoco/hopper/expert-v12", "a-v1"] {
            assert!(is_minari_id(name), "{name}");
        }
        for name in ["hopper", "hopper-v", "-v0", "hop per-v0", "hopper-v0x"] {
            assert!(!is_minari_id(name), "{name}");
        }
    }
}
