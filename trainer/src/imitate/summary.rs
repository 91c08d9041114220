//! Runs from outside: found, summed up, brought together as curves.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::Value;

use crate::error::ClientError;
use crate::imitate::manifest::{FILE, Manifest};
use crate::imitate::records::{
    EVALUATIONS_FILE, EvaluationRecord, METRICS_FILE, Metrics, read_lines,
};
use crate::learning::Algorithm;
use crate::learning::train::ONNX_FILE;
use crate::plot::{Panel, Point, Series};

/// Folders deeper than this below a named one are not searched.
const MAX_DEPTH: usize = 4;

/// A run and what it has recorded.
#[derive(Debug, Clone, Serialize)]
pub struct RunSummary {
    /// Its folder.
    pub folder: PathBuf,
    /// What it says of itself.
    pub manifest: Manifest,
    /// True if it left its policy.
    pub is_complete: bool,
    /// In the order of their steps.
    pub metrics: Vec<Metrics>,
    /// In the order of their steps.
    pub evaluations: Vec<EvaluationRecord>,
}

impl RunSummary {
    /// Of the run in `folder`.
    ///
    /// # Errors
    /// [`ClientError::RunFolder`] or [`ClientError::File`].
    pub fn read(folder: &Path) -> Result<Self, ClientError> {
        Ok(Self {
            folder: folder.to_path_buf(),
            manifest: Manifest::read(folder)?,
            is_complete: folder.join(ONNX_FILE).is_file(),
            metrics: read_lines(&folder.join(METRICS_FILE))?,
            evaluations: read_lines(&folder.join(EVALUATIONS_FILE))?,
        })
    }

    /// A setting by its dotted name, as text; numbers and words without quotes.
    #[must_use]
    pub fn setting(&self, name: &str) -> Option<String> {
        let pointer = format!("/{}", name.replace('.', "/"));
        match self.manifest.settings.pointer(&pointer)? {
            Value::Null => None,
            Value::String(text) => Some(text.clone()),
            value => Some(value.to_string()),
        }
    }

    /// False for a setting of another method than the run's: it changes nothing.
    fn heeds(&self, name: &str) -> bool {
        /// The kernels of every HSCIC that is reported.
        const OF_REPORTS: [&str; 3] =
            ["palr.ridge", "palr.bandwidth_sq", "palr.standardize_actions"];
        let Some((table, _)) = name.split_once('.') else { return true };
        let is_table = |algorithm: &Algorithm| algorithm.tables().contains(&table);
        let own = self.setting("algorithm").unwrap_or_default();
        let mut methods = Algorithm::ALL.iter().filter(|method| is_table(method)).peekable();
        methods.peek().is_none()
            || methods.any(|method| method.name() == own)
            || OF_REPORTS.contains(&name)
    }
}

/// Every run in or below `paths`, in the order of their names; a path that is a run itself is one.
///
/// # Errors
/// [`ClientError::File`] for a path that is not there or holds no run, [`ClientError::RunFolder`]
/// for a run that cannot be read.
pub fn find(paths: &[PathBuf]) -> Result<Vec<RunSummary>, ClientError> {
    let mut runs = Vec::new();
    for path in paths {
        let before = runs.len();
        search(path, 0, &mut runs)?;
        if runs.len() == before {
            return Err(ClientError::file(path, "holds no run; expected a folder with run.json"));
        }
    }
    // A run that two paths lead to counts once.
    let mut seen = Vec::new();
    runs.retain(|run| {
        let folder = run.folder.canonicalize().unwrap_or_else(|_| run.folder.clone());
        let is_new = !seen.contains(&folder);
        seen.push(folder);
        is_new
    });
    Ok(runs)
}

fn search(folder: &Path, depth: usize, runs: &mut Vec<RunSummary>) -> Result<(), ClientError> {
    if folder.join(FILE).is_file() {
        runs.push(RunSummary::read(folder)?);
        return Ok(());
    }
    if depth == MAX_DEPTH {
        return Ok(());
    }
    let failed = |error| ClientError::file(folder, error);
    let entries: Result<Vec<_>, _> = std::fs::read_dir(folder).map_err(failed)?.collect();
    let mut folders: Vec<PathBuf> = entries
        .map_err(failed)?
        .into_iter()
        .map(|entry| entry.path())
        .filter(|path| path.is_dir())
        .collect();
    folders.sort_unstable();
    folders.iter().try_for_each(|inner| search(inner, depth + 1, runs))
}

/// Names of settings that differ between `runs`, but for seeds and files: what a comparison is
/// about.
#[must_use]
pub fn differing_settings(runs: &[RunSummary]) -> Vec<String> {
    const NOT_COMPARED: &[&str] = &["seed", "batch_seed", "data", "env", "algorithm"];
    let mut names: Vec<String> = Vec::new();
    for run in runs {
        leaves(&run.manifest.settings, "", &mut names);
    }
    let differs = |name: &String| {
        let first = runs.first().and_then(|run| run.setting(name));
        runs.iter().any(|run| run.setting(name) != first)
    };
    names.retain(|name| !NOT_COMPARED.contains(&name.as_str()) && differs(name));
    names
}

fn leaves(value: &Value, prefix: &str, names: &mut Vec<String>) {
    let Some(object) = value.as_object() else { return };
    for (key, inner) in object {
        let name = format!("{prefix}{key}");
        if inner.is_object() {
            leaves(inner, &format!("{name}."), names);
        } else if !names.contains(&name) {
            names.push(name);
        }
    }
}

/// Runs that differ in their seed only, under one label.
#[derive(Debug, Clone)]
pub struct RunGroup {
    /// Environment, algorithm and the settings that groups differ in.
    pub label: String,
    /// At least one.
    pub runs: Vec<RunSummary>,
}

/// Brings together what differs in its seed only.
#[must_use]
pub fn group(runs: Vec<RunSummary>) -> Vec<RunGroup> {
    let names = differing_settings(&runs);
    let one_env = runs.windows(2).all(|pair| pair[0].manifest.env_id == pair[1].manifest.env_id);
    let one_data =
        runs.windows(2).all(|pair| pair[0].manifest.data.sha256 == pair[1].manifest.data.sha256);
    let mut groups: Vec<RunGroup> = Vec::new();
    for run in runs {
        let mut parts = Vec::new();
        if !one_env {
            parts.push(run.manifest.env_id.clone());
        }
        parts.push(run.setting("algorithm").unwrap_or_default());
        let heeded = |name: &&String| run.heeds(name);
        let told = |name: &String| Some(format!("{name}={}", run.setting(name)?));
        parts.extend(names.iter().filter(heeded).filter_map(told));
        if !one_data {
            let sha256 = &run.manifest.data.sha256;
            parts.push(format!("data={}", &sha256[..sha256.len().min(8)]));
        }
        let label = parts.join(" ");
        match groups.iter_mut().find(|group| group.label == label) {
            Some(group) => group.runs.push(run),
            None => groups.push(RunGroup { label, runs: vec![run] }),
        }
    }
    groups
}

/// Mean and standard error over the runs at each step that all of them have; of one run, its own
/// numbers with the errors that they come with.
fn curve(group: &RunGroup, values: impl Fn(&RunSummary) -> Vec<(u64, f64, Option<f64>)>) -> Series {
    let mut at: BTreeMap<u64, Vec<(f64, Option<f64>)>> = BTreeMap::new();
    for run in &group.runs {
        for (step, value, error) in values(run) {
            at.entry(step).or_default().push((value, error));
        }
    }
    let n = group.runs.len();
    let points = at.into_iter().filter(|(_, values)| values.len() == n).map(|(step, values)| {
        let mean = values.iter().map(|(value, _)| value).sum::<f64>() / n as f64;
        let squares: f64 = values.iter().map(|(value, _)| (value - mean).powi(2)).sum();
        let error = match values.as_slice() {
            [(_, error)] => *error,
            _ => Some((squares / (n - 1) as f64 / n as f64).sqrt()),
        };
        let y_interval = error.map(|error| (mean - error, mean + error));
        Point { y_interval, ..Point::new(step as f64, mean) }
    });
    Series { label: group.label.clone(), points: points.collect(), is_curve: true }
}

/// Score, held-out likelihood and leakage of the representation over steps, each with a band of ±
/// one standard error over the seeds of a group. Panels that no run has numbers for are left out.
#[must_use]
pub fn panels(groups: &[RunGroup]) -> Vec<Panel> {
    let metric = |of: fn(&Metrics) -> Option<f64>| {
        move |run: &RunSummary| -> Vec<(u64, f64, Option<f64>)> {
            let point = |metrics: &Metrics| Some((metrics.step, of(metrics)?, None));
            run.metrics.iter().filter_map(point).collect()
        }
    };
    let score = |run: &RunSummary| {
        let point = |record: &EvaluationRecord| {
            (record.step, record.score_mean, record.score_standard_error)
        };
        run.evaluations.iter().map(point).collect()
    };
    let likelihood = metric(|metrics| metrics.held_out_nll.map(|nll| -nll));
    let hscic = metric(|metrics| metrics.held_out_hscic);
    let panel = |title: &str, y_label: &str, is_y_log, series: Vec<Series>| Panel {
        title: title.into(),
        x_label: "steps".into(),
        y_label: y_label.into(),
        is_y_log,
        series,
    };
    let all = [
        panel("evaluation", "score ± SE", false, groups.iter().map(|g| curve(g, score)).collect()),
        panel(
            "held-out log-likelihood",
            "nats ± SE",
            false,
            groups.iter().map(|g| curve(g, likelihood)).collect(),
        ),
        panel(
            "leakage of the representation, held out",
            "HSCIC ± SE",
            true,
            groups.iter().map(|g| curve(g, hscic)).collect(),
        ),
    ];
    let has_points = |panel: &Panel| panel.series.iter().any(|series| !series.points.is_empty());
    all.into_iter().filter(has_points).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::imitate::data::DataIdentity;
    use crate::imitate::manifest::{FORMAT_VERSION, Versions};

    fn run(seed: u64, alpha: f64, scores: &[f64]) -> RunSummary {
        let evaluation = |(i, score): (usize, &f64)| EvaluationRecord {
            step: 10 * (i as u64 + 1),
            episodes: 5,
            seed: 0,
            return_mean: 0.0,
            return_standard_error: None,
            score_mean: *score,
            score_standard_error: Some(0.5),
            length_mean: 1.0,
        };
        RunSummary {
            folder: "run".into(),
            manifest: Manifest {
                format_version: FORMAT_VERSION,
                kind: "imitation".into(),
                env_id: "hopper-w2-v0".into(),
                started_at_unix_s: 0,
                versions: Versions {
                    palr_gym: String::new(),
                    git_revision: None,
                    server: String::new(),
                    mujoco: String::new(),
                },
                data: DataIdentity { sha256: String::new(), transitions: 1, env_id: None },
                settings: json!({"algorithm": "palr", "seed": seed, "palr": {"alpha": alpha}}),
            },
            is_complete: true,
            metrics: Vec::new(),
            evaluations: scores.iter().enumerate().map(evaluation).collect(),
        }
    }

    #[test]
    fn seeds_come_together_and_settings_set_apart() {
        let runs = vec![run(0, 1.0, &[1.0, 2.0]), run(0, 5.0, &[9.0]), run(1, 1.0, &[3.0])];
        assert_eq!(differing_settings(&runs), ["palr.alpha"]);
        let groups = group(runs);
        assert_eq!(groups[0].label, "palr palr.alpha=1.0");
        assert_eq!((groups.len(), groups[0].runs.len()), (2, 2));
        let panels = panels(&groups);
        // Nothing was measured but scores; step 20 is known of one seed only.
        assert_eq!(panels.len(), 1);
        let want = Point { y_interval: Some((1.0, 3.0)), ..Point::new(10.0, 2.0) };
        assert_eq!(panels[0].series[0].points, [want]);
        let alone = Point { y_interval: Some((8.5, 9.5)), ..Point::new(10.0, 9.0) };
        assert_eq!(panels[0].series[1].points, [alone]);
    }

    #[test]
    fn a_label_leaves_out_the_settings_of_other_methods() {
        let of = |algorithm: &str, alpha: f64, ridge: f64| {
            let mut run = run(0, alpha, &[1.0]);
            run.manifest.settings["algorithm"] = json!(algorithm);
            run.manifest.settings["palr"]["ridge"] = json!(ridge);
            run
        };
        let labels = |runs| group(runs).into_iter().map(|group| group.label).collect::<Vec<_>>();
        let runs = vec![of("bc", 10.0, 0.1), of("dt_palr", 1000.0, 0.1), of("bc", 5.0, 0.1)];
        assert_eq!(labels(runs), ["bc", "dt_palr palr.alpha=1000.0"]);
        // What every HSCIC is measured with does set runs apart.
        let runs = vec![of("bc", 10.0, 0.1), of("bc", 10.0, 0.2)];
        assert_eq!(labels(runs), ["bc palr.ridge=0.1", "bc palr.ridge=0.2"]);
    }

    #[test]
    fn folders_without_runs_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = find(&[folder.path().to_path_buf()]).unwrap_err().to_string();
        assert!(error.contains("holds no run"), "{error}");
        assert!(find(&[folder.path().join("absent")]).is_err());
    }
}
