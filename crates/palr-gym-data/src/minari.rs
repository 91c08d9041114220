//! Minari's layout: a folder with `data/main_data.hdf5` and `data/metadata.json`.
//!
//! A group `episode_<i>` for each episode, with attributes `id`, `total_steps` and perhaps `seed`, and
//!
//! | data set | type | shape |
//! |---|---|---|
//! | `observations` | float32 or float64 | `[T + 1, observation size]` |
//! | `actions` | float32 or float64 | `[T, action size]` |
//! | `rewards` | float64 | `[T]` |
//! | `terminations`, `truncations` | bool | `[T]` |
//! | `infos/qpos`, `infos/qvel` | float64 | `[T, …]` or `[T + 1, …]`, if known |
//! | `infos/action_log_probs` | float64 | `[T]`, if known |
//!
//! `metadata.json` holds the spaces as Minari writes them, and what is under `metadata/` of a file in
//! D4RL's layout as `palr_gym`.

use std::fs;
use std::path::{Path, PathBuf};

use hdf5_metno::{Dataset, File, Group, H5Type};
use ndarray::{ArrayView1, ArrayView2};
use serde_json::{Map, Value, json};

use crate::d4rl::{Metadata, create, group, plain};
use crate::error::DataError;
use crate::read::{open, unreadable};
use crate::source::{SourceShape, is_float64, owned, rows_of};
use crate::transitions::Episode;

const MAIN_FILE: &str = "main_data.hdf5";
const METADATA_FILE: &str = "metadata.json";
/// The version of Minari whose format this is.
const MINARI_VERSION: &str = "0.5.4";
/// Where our own metadata stand in `metadata.json`.
const OWN: &str = "palr_gym";

/// The HDF5 file of the data set in the folder `path`, or in `data` in it; of anything else, `path`.
#[must_use]
pub fn main_file(path: &Path) -> PathBuf {
    let inner = path.join("data");
    match (inner.is_dir(), path.is_dir()) {
        (true, _) => inner.join(MAIN_FILE),
        (false, true) => path.join(MAIN_FILE),
        (false, false) => path.to_path_buf(),
    }
}

/// A data set's folder, open for reading.
pub struct MinariSource {
    path: PathBuf,
    file: File,
    shape: SourceShape,
    env_id: Option<String>,
    metadata: Vec<(String, Metadata)>,
}

impl MinariSource {
    /// Opens the data set in `path`, the folder that holds `data`, or `data` itself.
    ///
    /// # Errors
    /// [`DataError`], naming the file and what is missing in it.
    pub fn open(path: &Path) -> Result<Self, DataError> {
        let main = main_file(path);
        let data = main.parent().unwrap_or(path);
        if !main.exists() {
            let message = format!("there is no {MAIN_FILE} in it; expected a Minari data set");
            return Err(unreadable(path, "the folder", &message));
        }
        let about: Value = fs::read(data.join(METADATA_FILE))
            .map_err(|error| error.to_string())
            .and_then(|bytes| serde_json::from_slice(&bytes).map_err(|error| error.to_string()))
            .map_err(|message| unreadable(&data.join(METADATA_FILE), "the file", &message))?;
        let file = open(&main)?;
        let mut lengths = Vec::new();
        while let Ok(group) = file.group(&format!("episode_{}", lengths.len())) {
            let rewards = member(&main, &group, lengths.len(), "rewards")?;
            lengths.push(rewards.size());
        }
        if lengths.iter().sum::<usize>() == 0 {
            return Err(DataError::NoTransitions { path: main });
        }
        let first =
            file.group("episode_0").map_err(|error| unreadable(&main, "episode_0", &error))?;
        let observations = member(&main, &first, 0, "observations")?;
        let actions = member(&main, &first, 0, "actions")?;
        let width = |set: &Dataset, dataset: &'static str| match set.shape()[..] {
            [_, width] if width > 0 => Ok(width),
            _ => Err(DataError::Rank {
                path: main.clone(),
                dataset,
                got: set.shape(),
                want: "[steps, size]",
            }),
        };
        let info = |name: &str| first.dataset(&format!("infos/{name}")).ok();
        let columns =
            |name: &str| info(name).map_or(0, |set| set.shape().get(1).copied().unwrap_or(0));
        let shape = SourceShape {
            lengths,
            observation_size: width(&observations, "observations")?,
            action_size: width(&actions, "actions")?,
            nq: columns("qpos"),
            nv: columns("qvel"),
            has_action_log_probs: info("action_log_probs").is_some(),
            has_last_observation: true,
            is_float64: is_float64(&observations),
        };
        let metadata = own_metadata(&about);
        let text = |name: &str| {
            metadata.iter().find_map(|(other, value)| match value {
                Metadata::Text(text) if other == name => Some(text.clone()),
                _ => None,
            })
        };
        let env_id = text("env_id").or_else(|| gymnasium_id(&about));
        Ok(Self { path: main, file, shape, env_id, metadata })
    }

    /// Its sizes.
    #[must_use]
    pub fn shape(&self) -> &SourceShape {
        &self.shape
    }

    /// The environment that it says it is from, ours or Gymnasium's.
    #[must_use]
    pub fn env_id(&self) -> Option<&str> {
        self.env_id.as_deref()
    }

    /// What we wrote about it, sorted by name.
    #[must_use]
    pub fn metadata(&self) -> &[(String, Metadata)] {
        &self.metadata
    }

    /// Whether the task, and whether the time limit ended episode `index`.
    ///
    /// # Errors
    /// [`DataError`].
    pub fn ends(&self, index: usize) -> Result<(bool, bool), DataError> {
        let name = format!("episode_{index}");
        let group =
            self.file.group(&name).map_err(|error| unreadable(&self.path, &name, &error))?;
        let flag = |dataset: &'static str| -> Result<bool, DataError> {
            let set = member(&self.path, &group, index, dataset)?;
            let flags: Vec<bool> = values(&self.path, &set, dataset, self.shape.lengths[index])?;
            Ok(flags.last().copied().unwrap_or(false))
        };
        Ok((flag("terminations")?, flag("truncations")?))
    }

    /// The first `limit` transitions of episode `index`.
    ///
    /// # Errors
    /// [`DataError`].
    pub fn read(&self, index: usize, limit: usize) -> Result<Episode<'static>, DataError> {
        let name = format!("episode_{index}");
        let group =
            self.file.group(&name).map_err(|error| unreadable(&self.path, &name, &error))?;
        let length = self.shape.lengths[index];
        let taken = length.min(limit);
        let set = |dataset| member(&self.path, &group, index, dataset);
        let rows = |dataset: &'static str, rows: usize, want: usize, width: usize| {
            let set = set(dataset)?;
            let has_width = set.shape().get(1).copied().unwrap_or(1) == width;
            if set.shape().first() != Some(&want) || !has_width {
                let path = self.path.clone();
                let (got, want) = (set.size(), want * width);
                return Err(DataError::Shape { path, index: index as u32, dataset, got, want });
            }
            values::<f64>(&self.path, &set, dataset, rows)
        };
        let size = self.shape.observation_size;
        let observations = rows("observations", taken + 1, length + 1, size)?;
        let actions = rows("actions", taken, length, self.shape.action_size)?;
        let (terminated, truncated) = self.ends(index)?;
        let info = |dataset: &'static str, is_there: bool| match is_there {
            true => values::<f64>(&self.path, &set(dataset)?, dataset, taken),
            false => Ok(Vec::new()),
        };
        let shape = &self.shape;
        let is_whole = taken == length;
        Ok(Episode {
            index: index as u32,
            next_observations: owned(observations[size..].to_vec()),
            observations: owned(observations[..taken * size].to_vec()),
            actions: actions.iter().map(|&value| value as f32).collect(),
            rewards: owned(rows("rewards", taken, length, 1)?),
            qpos: owned(info("infos/qpos", shape.nq > 0)?),
            qvel: owned(info("infos/qvel", shape.nv > 0)?),
            action_log_probs: owned(info("infos/action_log_probs", shape.has_action_log_probs)?),
            terminated: is_whole && terminated,
            timed_out: !is_whole || truncated,
        })
    }
}

fn member(
    path: &Path,
    group: &Group,
    index: usize,
    dataset: &'static str,
) -> Result<Dataset, DataError> {
    if !group.link_exists(dataset.split('/').next().unwrap_or(dataset)) {
        let mut found = group.member_names().unwrap_or_default();
        found.sort();
        let message = format!("there is none in episode_{index}; found {}", found.join(", "));
        return Err(unreadable(path, dataset, &message));
    }
    group
        .dataset(dataset)
        .map_err(|error| unreadable(path, &format!("episode_{index}/{dataset}"), &error))
}

fn values<T: H5Type>(
    path: &Path,
    set: &Dataset,
    dataset: &str,
    rows: usize,
) -> Result<Vec<T>, DataError> {
    rows_of(set, 0..rows).map_err(|error| unreadable(path, dataset, &error))
}

fn own_metadata(about: &Value) -> Vec<(String, Metadata)> {
    let fields = about.get(OWN).and_then(Value::as_object).into_iter().flatten();
    let mut metadata: Vec<_> = fields
        .filter_map(|(name, value)| {
            let value = match value {
                Value::String(text) => Metadata::Text(text.clone()),
                value => Metadata::Integer(value.as_i64()?),
            };
            Some((name.clone(), value))
        })
        .collect();
    metadata.sort_by(|a, b| a.0.cmp(&b.0));
    metadata
}

/// The id in Gymnasium's description of the environment.
fn gymnasium_id(about: &Value) -> Option<String> {
    let spec: Value = serde_json::from_str(about.get("env_spec")?.as_str()?).ok()?;
    Some(spec.get("id")?.as_str()?.to_owned())
}

/// A data set that is being written into a folder of its own.
pub struct MinariWriter {
    data: PathBuf,
    file: File,
    dataset_id: String,
    metadata: Vec<(String, Metadata)>,
    is_float64: bool,
    /// Sizes of an observation and an action.
    sizes: (usize, usize),
    episodes: usize,
    steps: usize,
}

impl MinariWriter {
    /// Creates `folder`, which must not be there, for a data set called `dataset_id`.
    ///
    /// # Errors
    /// [`DataError::Write`].
    pub fn create(
        folder: &Path,
        dataset_id: &str,
        shape: &SourceShape,
        metadata: &[(String, Metadata)],
    ) -> Result<Self, DataError> {
        let data = folder.join("data");
        fs::create_dir_all(&data).map_err(|error| unwritable(folder, "the folder", &error))?;
        let main = data.join(MAIN_FILE);
        let file = File::with_options()
            .with_fcpl(|plist| plist.obj_track_times(false))
            .create(&main)
            .map_err(|error| unwritable(&main, "the file", &error))?;
        Ok(Self {
            data,
            file,
            dataset_id: dataset_id.to_owned(),
            metadata: metadata.to_vec(),
            is_float64: shape.is_float64,
            sizes: (shape.observation_size, shape.action_size),
            episodes: 0,
            steps: 0,
        })
    }

    /// Appends an episode; `seed` is what its environment was reset with, if that is known.
    ///
    /// # Errors
    /// [`DataError::Write`].
    pub fn append(&mut self, episode: &Episode<'_>, seed: Option<i64>) -> Result<(), DataError> {
        let name = format!("episode_{}", self.episodes);
        let failed =
            |error: hdf5_metno::Error| unwritable(&self.data.join(MAIN_FILE), &name, &error);
        self.write(&name, episode, seed).map_err(failed)?;
        self.episodes += 1;
        self.steps += episode.len();
        Ok(())
    }

    fn write(
        &self,
        name: &str,
        episode: &Episode<'_>,
        seed: Option<i64>,
    ) -> hdf5_metno::Result<()> {
        let group = group(&self.file, name)?;
        let attribute = |name: &str, value: i64| {
            group
                .new_attr::<i64>()
                .create(name)
                .and_then(|attribute| attribute.write_scalar(&value))
        };
        attribute("id", self.episodes as i64)?;
        attribute("total_steps", episode.len() as i64)?;
        if let Some(seed) = seed {
            attribute("seed", seed)?;
        }
        let (observation_size, action_size) = self.sizes;
        let last = episode.next_observations.len().saturating_sub(observation_size);
        let observations: Vec<f64> =
            [&episode.observations, &episode.next_observations[last..]].concat();
        if self.is_float64 {
            matrix(&group, "observations", &observations, observation_size)?;
        } else {
            let narrow: Vec<f32> = observations.iter().map(|&value| value as f32).collect();
            matrix(&group, "observations", &narrow, observation_size)?;
        }
        matrix(&group, "actions", &episode.actions, action_size)?;
        column(&group, "rewards", &episode.rewards)?;
        let flags = |is_set: bool| {
            let mut flags = vec![false; episode.len()];
            flags.last_mut().into_iter().for_each(|last| *last = is_set);
            flags
        };
        column(&group, "terminations", &flags(episode.terminated))?;
        column(&group, "truncations", &flags(episode.timed_out && !episode.terminated))?;
        let infos = [("qpos", &episode.qpos), ("qvel", &episode.qvel)];
        let has_infos = infos.iter().any(|(_, values)| !values.is_empty());
        if !has_infos && episode.action_log_probs.is_empty() {
            return Ok(());
        }
        let folder = crate::d4rl::group(&group, "infos")?;
        for (name, values) in infos.into_iter().filter(|(_, values)| !values.is_empty()) {
            matrix(&folder, name, values, values.len() / episode.len())?;
        }
        if !episode.action_log_probs.is_empty() {
            column(&folder, "action_log_probs", &episode.action_log_probs)?;
        }
        Ok(())
    }

    /// Writes the description and closes the files.
    ///
    /// # Errors
    /// [`DataError::Write`].
    pub fn finish(self) -> Result<(), DataError> {
        let main = self.data.join(MAIN_FILE);
        self.file.flush().map_err(|error| unwritable(&main, "the file", &error))?;
        let size = fs::metadata(&main).map_or(0, |metadata| metadata.len());
        let (observation_size, action_size) = self.sizes;
        let dtype = if self.is_float64 { "float64" } else { "float32" };
        let own: Map<String, Value> = self
            .metadata
            .iter()
            .map(|(name, value)| {
                let value = match value {
                    Metadata::Text(text) => json!(text),
                    Metadata::Integer(value) => json!(value),
                };
                (name.clone(), value)
            })
            .collect();
        let about = json!({
            "total_episodes": self.episodes,
            "total_steps": self.steps,
            "data_format": "hdf5",
            "jpeg_encoding": false,
            "observation_space": unbounded(dtype, observation_size),
            "action_space": bounded(action_size),
            "dataset_id": self.dataset_id,
            "minari_version": MINARI_VERSION,
            "dataset_size": (size as f64 / 1e5).round() / 10.0,
            OWN: own,
        });
        let path = self.data.join(METADATA_FILE);
        let text =
            serde_json::to_string(&about).map_err(|error| unwritable(&path, "the file", &error))?;
        fs::write(&path, text).map_err(|error| unwritable(&path, "the file", &error))
    }
}

/// A box without bounds, as Minari writes one: Python's JSON knows infinity.
fn unbounded(dtype: &str, size: usize) -> String {
    let list = |entry: &str| vec![entry; size].join(", ");
    let (low, high) = (list("-Infinity"), list("Infinity"));
    format!(
        r#"{{"type": "Box", "dtype": "{dtype}", "shape": [{size}], "low": [{low}], "high": [{high}]}}"#
    )
}

/// The box of all actions.
fn bounded(size: usize) -> String {
    json!({
        "type": "Box",
        "dtype": "float32",
        "shape": [size],
        "low": vec![-1.0; size],
        "high": vec![1.0; size],
    })
    .to_string()
}

fn matrix<T: H5Type>(
    group: &Group,
    name: &str,
    values: &[T],
    width: usize,
) -> hdf5_metno::Result<()> {
    let rows = values.len() / width.max(1);
    let view = ArrayView2::from_shape((rows, width), values)
        .map_err(|error| hdf5_metno::Error::from(error.to_string()))?;
    create::<T>(group, name, &[rows, width])?.write(view)
}

fn column<T: H5Type>(group: &Group, name: &str, values: &[T]) -> hdf5_metno::Result<()> {
    create::<T>(group, name, &[values.len()])?.write(ArrayView1::from(values))
}

fn unwritable(path: &Path, dataset: &str, error: &dyn std::fmt::Display) -> DataError {
    DataError::Write { path: path.into(), dataset: dataset.to_owned(), message: plain(error) }
}
