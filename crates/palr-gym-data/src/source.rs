//! Recordings of either layout, read one episode at a time: a file may be larger than memory.

use std::borrow::Cow;
use std::ops::Range;
use std::path::{Path, PathBuf};

use hdf5_metno::types::{TypeDescriptor, VarLenUnicode};
use hdf5_metno::{Dataset, File, H5Type};
use ndarray::s;

use crate::d4rl::Metadata;
use crate::error::DataError;
use crate::minari::MinariSource;
use crate::read::{env_id, open, unreadable};
use crate::recording::episodes;
use crate::transitions::Episode;

/// Sizes of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SourceShape {
    /// Transitions of each episode.
    pub lengths: Vec<usize>,
    /// Entries of an observation.
    pub observation_size: usize,
    /// Entries of an action.
    pub action_size: usize,
    /// Generalised positions; 0 if they are not there.
    pub nq: usize,
    /// Generalised velocities; 0 if they are not there.
    pub nv: usize,
    /// True if log densities of actions are there.
    pub has_action_log_probs: bool,
    /// True if the observation after the last action of an episode is there.
    pub has_last_observation: bool,
    /// True if observations are float64, not float32.
    pub is_float64: bool,
}

/// A recording on disk.
pub enum Source {
    /// A file in D4RL's layout.
    D4rl(D4rlSource),
    /// A folder in Minari's.
    Minari(MinariSource),
}

impl Source {
    /// Opens a D4RL file, or a Minari data set's folder (or the `data` folder in it).
    ///
    /// # Errors
    /// [`DataError`], naming the file and the data set inside it.
    pub fn open(path: &Path) -> Result<Self, DataError> {
        match path.is_dir() {
            true => Ok(Self::Minari(MinariSource::open(path)?)),
            false => Ok(Self::D4rl(D4rlSource::open(path)?)),
        }
    }

    /// Its sizes.
    #[must_use]
    pub fn shape(&self) -> &SourceShape {
        match self {
            Self::D4rl(source) => &source.shape,
            Self::Minari(source) => source.shape(),
        }
    }

    /// The environment that it says it is from.
    #[must_use]
    pub fn env_id(&self) -> Option<&str> {
        match self {
            Self::D4rl(source) => source.env_id.as_deref(),
            Self::Minari(source) => source.env_id(),
        }
    }

    /// What else it says about itself, sorted by name.
    #[must_use]
    pub fn metadata(&self) -> &[(String, Metadata)] {
        match self {
            Self::D4rl(source) => &source.metadata,
            Self::Minari(source) => source.metadata(),
        }
    }

    /// Reads the episode number `index`, at most `limit` transitions of it.
    ///
    /// Without a last observation, the one before stands in its place.
    ///
    /// # Errors
    /// [`DataError`]. There must be such an episode.
    pub fn read(&self, index: usize, limit: usize) -> Result<Episode<'static>, DataError> {
        match self {
            Self::D4rl(source) => source.read(index, limit),
            Self::Minari(source) => source.read(index, limit),
        }
    }
}

/// A file in D4RL's layout.
pub struct D4rlSource {
    path: PathBuf,
    file: File,
    shape: SourceShape,
    env_id: Option<String>,
    metadata: Vec<(String, Metadata)>,
    episodes: Vec<Range<usize>>,
    terminals: Vec<bool>,
    timeouts: Vec<bool>,
}

impl D4rlSource {
    fn open(path: &Path) -> Result<Self, DataError> {
        let file = open(path)?;
        let width = |name: &'static str, reason: &'static str| -> Result<[usize; 2], DataError> {
            let shape = dataset(path, &file, name, reason)?.shape();
            match shape[..] {
                [rows, width] if width > 0 => Ok([rows, width]),
                _ => Err(DataError::Rank {
                    path: path.into(),
                    dataset: name,
                    got: shape,
                    want: "[N, size]",
                }),
            }
        };
        let [transitions, observation_size] =
            width("observations", "the observation before each action")?;
        let [_, action_size] = width("actions", "the action of each transition")?;
        dataset(path, &file, "rewards", "the reward of each transition")?;
        let flags = |name: &'static str, reason| -> Result<Vec<bool>, DataError> {
            let set = dataset(path, &file, name, reason)?;
            let values: Vec<f64> =
                set.read_raw().map_err(|error| unreadable(path, name, &error))?;
            if values.len() != transitions {
                let (got, want) = (values.len(), transitions);
                return Err(DataError::Length { path: path.into(), dataset: name, got, want });
            }
            let flag = |(row, value): (usize, &f64)| match *value {
                0.0 => Ok(false),
                1.0 => Ok(true),
                value => {
                    let (path, value) = (path.to_path_buf(), value.to_string());
                    Err(DataError::Flag { path, dataset: name, row, value })
                }
            };
            values.iter().enumerate().map(flag).collect()
        };
        let terminals =
            flags("terminals", "which marks the rows with which the task ended an episode")?;
        let timeouts =
            flags("timeouts", "which marks the rows with which the time limit ended an episode")?;
        if transitions == 0 {
            return Err(DataError::NoTransitions { path: path.into() });
        }
        let (episodes, ..) = episodes(&terminals, &timeouts);
        let optional =
            |name: &str| file.link_exists(name).then(|| file.dataset(name).ok()).flatten();
        let has_infos = file.link_exists("infos");
        let info = |name: &str| if has_infos { optional(&format!("infos/{name}")) } else { None };
        let columns =
            |name: &str| info(name).map_or(0, |set| set.shape().get(1).copied().unwrap_or(0));
        let is_float64 = optional("observations").is_some_and(|set| is_float64(&set));
        let shape = SourceShape {
            lengths: episodes.iter().map(ExactSizeIterator::len).collect(),
            observation_size,
            action_size,
            nq: columns("qpos"),
            nv: columns("qvel"),
            has_action_log_probs: info("action_log_probs").is_some(),
            has_last_observation: optional("next_observations").is_some(),
            is_float64,
        };
        let (env_id, metadata) = (env_id(&file), metadata(&file));
        let path = path.to_path_buf();
        Ok(Self { path, file, shape, env_id, metadata, episodes, terminals, timeouts })
    }

    fn read(&self, index: usize, limit: usize) -> Result<Episode<'static>, DataError> {
        let Range { start, end } = self.episodes[index].clone();
        let rows = start..end.min(start.saturating_add(limit));
        let observations = self.rows::<f64>("observations", rows.clone())?;
        let next_observations = match self.shape.has_last_observation {
            true => self.rows("next_observations", rows.clone())?,
            false => {
                let width = self.shape.observation_size;
                let after = rows.start + 1..(rows.end + 1).min(end);
                let mut next = self.rows("observations", after)?;
                if next.len() < observations.len() {
                    next.extend_from_slice(&observations[observations.len() - width..]);
                }
                next
            }
        };
        let optional = |is_there: bool, name: &str| match is_there {
            true => self.rows::<f64>(name, rows.clone()),
            false => Ok(Vec::new()),
        };
        let is_whole = rows.end == end;
        Ok(Episode {
            index: index as u32,
            observations: observations.into(),
            actions: self.rows("actions", rows.clone())?.into(),
            rewards: self.rows("rewards", rows.clone())?.into(),
            next_observations: next_observations.into(),
            qpos: optional(self.shape.nq > 0, "infos/qpos")?.into(),
            qvel: optional(self.shape.nv > 0, "infos/qvel")?.into(),
            action_log_probs: optional(self.shape.has_action_log_probs, "infos/action_log_probs")?
                .into(),
            terminated: is_whole && self.terminals[end - 1],
            timed_out: !is_whole || self.timeouts[end - 1],
        })
    }

    /// Rows of a data set, row-major.
    fn rows<T: H5Type>(&self, name: &str, rows: Range<usize>) -> Result<Vec<T>, DataError> {
        let read = || -> hdf5_metno::Result<Vec<T>> { rows_of(&self.file.dataset(name)?, rows) };
        read().map_err(|error| unreadable(&self.path, name, &error))
    }
}

/// Some rows of a data set of one or two dimensions, row-major.
pub(crate) fn rows_of<T: H5Type>(set: &Dataset, rows: Range<usize>) -> hdf5_metno::Result<Vec<T>> {
    match set.ndim() {
        1 => Ok(set.read_slice_1d::<T, _>(s![rows])?.into_raw_vec_and_offset().0),
        _ => {
            // HDF5 fills arrays row by row.
            Ok(set.read_slice_2d::<T, _>(s![rows, ..])?.into_raw_vec_and_offset().0)
        }
    }
}

pub(crate) fn is_float64(set: &Dataset) -> bool {
    let descriptor = set.dtype().and_then(|dtype| dtype.to_descriptor());
    matches!(descriptor, Ok(TypeDescriptor::Float(hdf5_metno::types::FloatSize::U8)))
}

fn dataset(
    path: &Path,
    file: &File,
    name: &'static str,
    reason: &'static str,
) -> Result<Dataset, DataError> {
    if !file.link_exists(name) {
        let mut found = file.member_names().unwrap_or_default();
        found.sort();
        return Err(DataError::Missing { path: path.into(), dataset: name, reason, found });
    }
    file.dataset(name).map_err(|error| unreadable(path, name, &error))
}

/// Texts and integers under `metadata/`, sorted by name.
fn metadata(file: &File) -> Vec<(String, Metadata)> {
    let Ok(group) = file.group("metadata") else { return Vec::new() };
    let mut names = group.member_names().unwrap_or_default();
    names.sort();
    let value = |name: &str| {
        let set = group.dataset(name).ok()?;
        let text = || set.read_scalar::<VarLenUnicode>().ok();
        match set.dtype().ok()?.to_descriptor().ok()? {
            TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_) => {
                set.read_scalar::<i64>().ok().map(Metadata::Integer)
            }
            _ => text().map(|text| Metadata::Text(text.to_string())),
        }
    };
    names.into_iter().filter_map(|name| Some((name.clone(), value(&name)?))).collect()
}

/// What of a recording is meant.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Part {
    /// First episode, from 0.
    pub first_episode: usize,
    /// Episodes; none: all that follow.
    pub episodes: Option<usize>,
    /// Transitions at most; the last episode is cut.
    pub transitions: Option<usize>,
}

impl Part {
    /// The episodes of the part, each with how many of its transitions belong to it.
    #[must_use]
    pub fn of(&self, lengths: &[usize]) -> Vec<(usize, usize)> {
        let mut left = self.transitions.unwrap_or(usize::MAX);
        let chosen = lengths.iter().copied().enumerate().skip(self.first_episode);
        chosen
            .take(self.episodes.unwrap_or(usize::MAX))
            .map_while(|(index, length)| {
                let taken = length.min(left);
                left -= taken;
                (taken > 0).then_some((index, taken))
            })
            .collect()
    }
}

/// An episode's lists, owned.
pub(crate) fn owned<T: Clone>(values: Vec<T>) -> Cow<'static, [T]> {
    Cow::Owned(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_takes_whole_episodes_until_its_transitions_are_used_up() {
        let part =
            |first_episode, episodes, transitions| Part { first_episode, episodes, transitions };
        let lengths = [3, 5, 2, 4];
        assert_eq!(part(0, None, None).of(&lengths), [(0, 3), (1, 5), (2, 2), (3, 4)]);
        assert_eq!(part(1, Some(2), None).of(&lengths), [(1, 5), (2, 2)]);
        assert_eq!(part(1, None, Some(6)).of(&lengths), [(1, 5), (2, 1)]);
        assert_eq!(part(1, None, Some(5)).of(&lengths), [(1, 5)]);
        assert_eq!(part(4, None, None).of(&lengths), []);
    }
}
