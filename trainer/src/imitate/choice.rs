//! α, chosen by held-out data alone.
//!
//! A policy that copies its past action predicts the expert well wherever the expert goes on with
//! what it did, which is nearly everywhere, and badly where the expert changes its mind. The
//! likelihood of held-out actions with each row weighted by ‖a_t - a_{t-1}‖²
//! ([`Metrics::held_out_change_nll`]) asks about the latter only; what the regulariser costs
//! elsewhere does not count against it there, and what it costs there does. The α whose policies
//! have the highest one is chosen. `docs/alpha.md` says more.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::error::ClientError;
use crate::imitate::manifest::Manifest;
use crate::imitate::records::{METRICS_FILE, Metrics, read_lines};
use crate::imitate::settings::algorithm;

/// The last reports of a run, as a share, are what it is judged by.
const JUDGED: f64 = 0.25;

/// What was chosen for one environment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Choice {
    /// Canonical id.
    pub env_id: String,
    /// As settings name it.
    pub algorithm: String,
    /// The setting that α is.
    pub setting: String,
    /// The best value; of equals, the largest.
    pub alpha: f64,
    /// Every value, ascending.
    pub candidates: Vec<Candidate>,
}

/// A value of α and what speaks for it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// The value.
    pub alpha: f64,
    /// Mean negative log-likelihood of held-out rows weighted by the squared change of their
    /// action, over the last quarter of each run's reports and over its runs; in nats.
    pub change_nll: f64,
    /// The runs with it.
    pub runs: Vec<PathBuf>,
}

/// Chooses among the α of the runs in `folders`, for each environment and method by itself.
///
/// # Errors
/// [`ClientError::RunFolder`] for a folder that holds no run, or one without held-out rows or of a
/// method without α; [`ClientError::File`].
pub fn choose(folders: &[&Path]) -> Result<Vec<Choice>, ClientError> {
    let mut choices: Vec<Choice> = Vec::new();
    for &folder in folders {
        let wrong = |message: &str| ClientError::RunFolder {
            path: folder.into(),
            message: message.to_owned(),
        };
        let Manifest { env_id, settings, .. } = Manifest::read(folder)?;
        let algorithm = algorithm(&settings)?;
        let setting = algorithm.alpha_setting().ok_or_else(|| wrong("has a method without α"))?;
        let pointer = format!("/{}", setting.replace('.', "/"));
        let alpha = settings.pointer(&pointer).and_then(Value::as_f64);
        let alpha = alpha.ok_or_else(|| wrong("does not say its α"))?;
        let change_nll = judged(&read_lines(&folder.join(METRICS_FILE))?)
            .ok_or_else(|| wrong("reports nothing on held-out rows whose action changes"))?;
        let is_of =
            |choice: &&mut Choice| choice.env_id == env_id && choice.algorithm == algorithm.name();
        let choice = match choices.iter_mut().find(is_of) {
            Some(choice) => choice,
            None => {
                choices.push(Choice {
                    env_id,
                    algorithm: algorithm.name().to_owned(),
                    setting: setting.to_owned(),
                    alpha,
                    candidates: Vec::new(),
                });
                let last = choices.len() - 1;
                &mut choices[last]
            }
        };
        match choice.candidates.iter_mut().find(|candidate| candidate.alpha == alpha) {
            Some(candidate) => {
                let n = candidate.runs.len() as f64;
                candidate.change_nll = (n * candidate.change_nll + change_nll) / (n + 1.0);
                candidate.runs.push(folder.into());
            }
            None => {
                let runs = vec![folder.into()];
                choice.candidates.push(Candidate { alpha, change_nll, runs });
            }
        }
    }
    for choice in &mut choices {
        choice.candidates.sort_by(|a, b| a.alpha.total_cmp(&b.alpha));
        // The last of equals.
        let best =
            choice.candidates.iter().rev().min_by(|a, b| a.change_nll.total_cmp(&b.change_nll));
        choice.alpha = best.map_or(choice.alpha, |best| best.alpha);
    }
    Ok(choices)
}

/// Mean over the last reports.
fn judged(metrics: &[Metrics]) -> Option<f64> {
    let count = ((metrics.len() as f64 * JUDGED).ceil() as usize).max(1);
    let last = &metrics[metrics.len().saturating_sub(count)..];
    let values: Option<Vec<f64>> = last.iter().map(|metrics| metrics.held_out_change_nll).collect();
    let values = values.filter(|values| !values.is_empty())?;
    Some(values.iter().sum::<f64>() / values.len() as f64)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::imitate::manifest::{FILE, FORMAT_VERSION};

    /// A run's folder as far as the choice looks into it.
    fn run(parent: &Path, name: &str, alpha: f64, change_nll: &[f64]) -> PathBuf {
        let folder = parent.join(name);
        std::fs::create_dir_all(&folder).unwrap();
        let manifest = json!({
            "format_version": FORMAT_VERSION, "kind": "imitation", "env_id": "toy-w2-v0",
            "started_at_unix_s": 0,
            "versions": {"palr_gym": "", "git_revision": null, "server": "", "mujoco": ""},
            "data": {"sha256": "", "transitions": 1, "env_id": null},
            "settings": {"algorithm": "palr", "palr": {"alpha": alpha}},
        });
        std::fs::write(folder.join(FILE), manifest.to_string()).unwrap();
        let lines = change_nll.iter().enumerate().map(|(step, value)| {
            json!({
                "step": step, "batch_nll": 0.0, "batch_hscic": null, "training_nll": 0.0,
                "training_hscic": 0.0, "held_out_nll": 0.0, "held_out_hscic": 0.0,
                "held_out_change_nll": value,
            })
        });
        let text: String = lines.map(|line| format!("{line}\n")).collect();
        std::fs::write(folder.join(METRICS_FILE), text).unwrap();
        folder
    }

    #[test]
    fn the_best_where_actions_change_is_chosen_and_of_equals_the_largest() {
        let parent = tempfile::tempdir().unwrap();
        let run = |name, alpha, nll: &[f64]| run(parent.path(), name, alpha, nll);
        // The last two of eight reports count; early ones do not.
        let low = run("a", 0.1, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0, 7.0]);
        let middle = [run("b", 10.0, &[9.0, 2.0]), run("c", 10.0, &[9.0, 4.0])];
        let equal = run("d", 100.0, &[3.0]);
        let high = run("e", 1000.0, &[3.1]);
        let all = [&low, &high, &middle[0], &middle[1], &equal].map(PathBuf::as_path);
        let [choice] = <[Choice; 1]>::try_from(choose(&all).unwrap()).unwrap();
        let candidates: Vec<_> =
            choice.candidates.iter().map(|c| (c.alpha, c.change_nll)).collect();
        assert_eq!(candidates, [(0.1, 6.0), (10.0, 3.0), (100.0, 3.0), (1000.0, 3.1)]);
        assert_eq!((choice.alpha, choice.setting.as_str()), (100.0, "palr.alpha"));
        let empty = run("f", 1.0, &[]);
        let error = choose(&[empty.as_path()]).unwrap_err().to_string();
        assert!(error.contains("reports nothing on held-out rows"), "{error}");
    }
}
