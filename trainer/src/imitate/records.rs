//! What a run measured, a JSON line each; a resumed run leaves the same lines as a whole one.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::ClientError;
use crate::evaluate::Evaluation;
use crate::imitate::tensorboard::EventFile;
use crate::learning::Progress;
use crate::learning::checkpoint::write_whole;

/// Reports of progress.
pub const METRICS_FILE: &str = "metrics.jsonl";
/// Evaluations.
pub const EVALUATIONS_FILE: &str = "evaluations.jsonl";
const TENSORBOARD: &str = "tensorboard";

/// A line of [`METRICS_FILE`]. NLL in nats.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Steps taken.
    pub step: u64,
    /// Of the step's batch, before the step.
    pub batch_nll: f64,
    /// Of the step's regularised rows, before the step; null where the loss has no such term.
    pub batch_hscic: Option<f64>,
    /// The method's other terms of the step, by name.
    #[serde(default)]
    pub batch_terms: BTreeMap<String, f64>,
    /// On rows of the training set.
    pub training_nll: f64,
    /// Of the representation, on the same rows.
    pub training_hscic: f64,
    /// Of a sampled action of the policy, on the same rows.
    #[serde(default)]
    pub training_action_hscic: f64,
    /// On held-out rows, if there are any.
    pub held_out_nll: Option<f64>,
    /// On the same rows, each weighted by the squared change of its action.
    #[serde(default)]
    pub held_out_change_nll: Option<f64>,
    /// Of the representation, on the same rows.
    pub held_out_hscic: Option<f64>,
    /// Of a sampled action of the policy, on the same rows.
    #[serde(default)]
    pub held_out_action_hscic: Option<f64>,
}

impl From<&Progress> for Metrics {
    fn from(progress: &Progress) -> Self {
        let held_out = progress.held_out.as_ref();
        Self {
            step: progress.step,
            batch_nll: progress.batch_nll,
            batch_hscic: progress.batch_hscic,
            batch_terms: progress
                .batch_terms
                .iter()
                .map(|&(name, value)| (name.to_owned(), value))
                .collect(),
            training_nll: progress.training.nll,
            training_hscic: progress.training.hscic,
            training_action_hscic: progress.training.action_hscic,
            held_out_nll: held_out.map(|measured| measured.nll),
            held_out_change_nll: held_out.and_then(|measured| measured.change_nll),
            held_out_hscic: held_out.map(|measured| measured.hscic),
            held_out_action_hscic: held_out.map(|measured| measured.action_hscic),
        }
    }
}

/// A line of [`EVALUATIONS_FILE`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EvaluationRecord {
    /// Steps that the policy had taken.
    pub step: u64,
    /// Episodes played.
    pub episodes: usize,
    /// Seed of the first.
    pub seed: u64,
    /// Mean undiscounted return.
    pub return_mean: f64,
    /// Its standard error; null for a single episode.
    pub return_standard_error: Option<f64>,
    /// Mean normalised score.
    pub score_mean: f64,
    /// Its standard error; null for a single episode.
    pub score_standard_error: Option<f64>,
    /// Mean length.
    pub length_mean: f64,
}

impl EvaluationRecord {
    /// Of the policy after `step` steps.
    #[must_use]
    pub fn new(step: u64, evaluation: &Evaluation) -> Self {
        Self {
            step,
            episodes: evaluation.episodes.len(),
            seed: evaluation.seed,
            return_mean: evaluation.return_mean,
            return_standard_error: evaluation.return_standard_error,
            score_mean: evaluation.score_mean,
            score_standard_error: evaluation.score_standard_error,
            length_mean: evaluation.length_mean,
        }
    }
}

/// Something that has a step.
pub(crate) trait Stepped {
    fn step(&self) -> u64;
    /// Names and values for TensorBoard.
    fn scalars(&self) -> Vec<(String, f64)>;
}

impl Stepped for Metrics {
    fn step(&self) -> u64 {
        self.step
    }

    fn scalars(&self) -> Vec<(String, f64)> {
        let optional = [
            ("batch/hscic", self.batch_hscic),
            ("held_out/nll", self.held_out_nll),
            ("held_out/change_nll", self.held_out_change_nll),
            ("held_out/hscic", self.held_out_hscic),
            ("held_out/action_hscic", self.held_out_action_hscic),
        ];
        let mut scalars = vec![
            ("batch/nll", self.batch_nll),
            ("training/nll", self.training_nll),
            ("training/hscic", self.training_hscic),
            ("training/action_hscic", self.training_action_hscic),
        ];
        scalars.extend(optional.into_iter().filter_map(|(name, value)| Some((name, value?))));
        let mut scalars: Vec<_> =
            scalars.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        let terms = self.batch_terms.iter();
        scalars.extend(terms.map(|(name, &value)| (format!("batch/{name}"), value)));
        scalars
    }
}

impl Stepped for EvaluationRecord {
    fn step(&self) -> u64 {
        self.step
    }

    fn scalars(&self) -> Vec<(String, f64)> {
        vec![
            ("evaluation/return".into(), self.return_mean),
            ("evaluation/score".into(), self.score_mean),
            ("evaluation/length".into(), self.length_mean),
        ]
    }
}

/// Records of one kind, in the order of their steps, as lines and as events.
pub(crate) struct Track<T> {
    path: PathBuf,
    events: EventFile,
    records: Vec<T>,
}

impl<T: Stepped + Serialize + DeserializeOwned> Track<T> {
    /// Of `file` in `folder`, and of events named `name`; with the records that are there up to step
    /// `kept`.
    pub(crate) fn open(
        folder: &Path,
        file: &str,
        name: &str,
        kept: u64,
    ) -> Result<Self, ClientError> {
        let path = folder.join(file);
        let mut records: Vec<T> = if kept > 0 { read_lines(&path)? } else { Vec::new() };
        records.retain(|record| record.step() <= kept);
        // Derived from the lines, so that a resumed run shows nothing twice.
        let events = EventFile::create(&folder.join(TENSORBOARD).join(name))?;
        let mut track = Self { path, events, records: Vec::new() };
        for record in records {
            track.write_events(&record)?;
            track.records.push(record);
        }
        Ok(track)
    }

    /// What is there, in the order of steps.
    pub(crate) fn records(&self) -> &[T] {
        &self.records
    }

    /// Forgets what came after `step`; events that were shown stay.
    pub(crate) fn forget_after(&mut self, step: u64) -> Result<(), ClientError> {
        self.records.retain(|record| record.step() <= step);
        self.rewrite()
    }

    /// Adds `record` in the place of what was there at its step.
    pub(crate) fn put(&mut self, record: T) -> Result<(), ClientError> {
        let at = self.records.partition_point(|other| other.step() < record.step());
        let is_new = self.records.get(at).is_none_or(|other| other.step() != record.step());
        if is_new {
            self.write_events(&record)?;
            self.records.insert(at, record);
        } else {
            // A repeated step has the same numbers.
            self.records[at] = record;
        }
        let is_last = at + 1 == self.records.len();
        if is_new && is_last { self.append() } else { self.rewrite() }
    }

    fn append(&self) -> Result<(), ClientError> {
        use std::io::Write;
        let failed = |error| ClientError::file(&self.path, error);
        let Some(last) = self.records.last() else { return Ok(()) };
        let line = line(&self.path, last)?;
        let mut options = fs::OpenOptions::new();
        let mut file = options.create(true).append(true).open(&self.path).map_err(failed)?;
        file.write_all(line.as_bytes()).map_err(failed)
    }

    pub(crate) fn rewrite(&self) -> Result<(), ClientError> {
        let lines: Result<String, _> =
            self.records.iter().map(|record| line(&self.path, record)).collect();
        Ok(write_whole(&self.path, lines?.as_bytes())?)
    }

    fn write_events(&mut self, record: &T) -> Result<(), ClientError> {
        self.events.write(record.step(), &record.scalars())
    }
}

fn line(path: &Path, record: &impl Serialize) -> Result<String, ClientError> {
    let mut line = serde_json::to_string(record).map_err(|error| ClientError::file(path, error))?;
    line.push('\n');
    Ok(line)
}

/// The records of a file of JSON lines; none if there is no file. A line that a kill cut short is
/// not one.
///
/// # Errors
/// [`ClientError::File`] for a line before the last that cannot be understood.
pub fn read_lines<T: DeserializeOwned>(path: &Path) -> Result<Vec<T>, ClientError> {
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(ClientError::file(path, error)),
    };
    let count = text.lines().count();
    let mut records = Vec::with_capacity(count);
    for (index, line) in text.lines().enumerate() {
        match serde_json::from_str(line) {
            Ok(record) => records.push(record),
            Err(_) if index + 1 == count => break,
            Err(error) => {
                return Err(ClientError::file(path, format!("line {}: {error}", index + 1)));
            }
        }
    }
    Ok(records)
}

/// Writes reports of progress.
pub struct Recorder {
    metrics: Track<Metrics>,
}

impl Recorder {
    /// For the run in `folder`: a new one, or one that goes on after `kept` steps. What was reported
    /// after them will be reported again, at other steps if `log_every` changed.
    ///
    /// # Errors
    /// [`ClientError::File`].
    pub fn open(folder: &Path, kept: Option<u64>) -> Result<Self, ClientError> {
        let metrics = Track::open(folder, METRICS_FILE, "training", kept.unwrap_or(0))?;
        if kept.is_some() {
            // Also drops a torn last line, after which nothing may be appended.
            metrics.rewrite()?;
        }
        Ok(Self { metrics })
    }

    /// Records a report.
    ///
    /// # Errors
    /// [`ClientError::File`].
    pub fn metrics(&mut self, metrics: &Metrics) -> Result<(), ClientError> {
        self.metrics.put(metrics.clone())
    }
}

/// Writes evaluations.
pub(crate) struct EvaluationRecorder {
    track: Track<EvaluationRecord>,
}

impl EvaluationRecorder {
    pub(crate) fn open(folder: &Path) -> Result<Self, ClientError> {
        let track = Track::open(folder, EVALUATIONS_FILE, "evaluation", u64::MAX)?;
        if !track.records.is_empty() {
            track.rewrite()?;
        }
        Ok(Self { track })
    }

    pub(crate) fn put(&mut self, record: EvaluationRecord) -> Result<(), ClientError> {
        self.track.put(record)
    }

    pub(crate) fn has(&self, step: u64) -> bool {
        self.track.records.iter().any(|record| record.step == step)
    }

    pub(crate) fn last(&self) -> Option<&EvaluationRecord> {
        self.track.records.last()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(step: u64, score_mean: f64) -> EvaluationRecord {
        EvaluationRecord {
            step,
            episodes: 2,
            seed: 0,
            return_mean: 1.0 / 3.0,
            return_standard_error: None,
            score_mean,
            score_standard_error: Some(0.1),
            length_mean: 9.0,
        }
    }

    #[test]
    fn lines_are_in_the_order_of_their_steps_whenever_they_come_and_a_torn_one_is_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(EVALUATIONS_FILE);
        let mut recorder = EvaluationRecorder::open(folder.path()).unwrap();
        for step in [10, 30, 20, 30] {
            recorder.put(record(step, f64::from(step as u32))).unwrap();
        }
        let whole = fs::read_to_string(&path).unwrap();
        let steps = |text: &str| text.matches("\"step\":").count();
        assert_eq!(steps(&whole), 3);
        fs::write(&path, format!("{whole}{{\"step\":40,")).unwrap();
        let mut recorder = EvaluationRecorder::open(folder.path()).unwrap();
        assert!(recorder.has(30) && !recorder.has(40));
        recorder.put(record(40, 4.0)).unwrap();
        let read: Vec<EvaluationRecord> = read_lines(&path).unwrap();
        assert_eq!(read.iter().map(|record| record.step).collect::<Vec<_>>(), [10, 20, 30, 40]);
        assert_eq!(read[1], record(20, 20.0));
        fs::write(&path, "{}\n{}\n").unwrap();
        let error = read_lines::<EvaluationRecord>(&path).unwrap_err().to_string();
        assert!(error.contains("line 1: missing field"), "{error}");
    }
}
