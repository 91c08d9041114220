//! Any D4RL file, ours or theirs, read and checked.
//!
//! | data set | types | shape |
//! |---|---|---|
//! | `observations` | float32, float64 | `[N, observation size]` |
//! | `actions` | float32, float64, within [-1, 1] | `[N, action size]` |
//! | `rewards` | float32, float64 | `[N]` or `[N, 1]` |
//! | `terminals`, `timeouts` | bool, or integers and floats that are 0 or 1 | `[N]` or `[N, 1]` |
//! | `metadata/env_id` | string | scalar, if present |
//!
//! Nothing else is looked at, so it may be there or not: `next_observations`, `infos/*`, other
//! `metadata/*`. A folder is read as a data set in Minari's layout ([`crate::minari`]).

use std::fmt::Display;
use std::fs;
use std::io::{self, Read as _};
use std::ops::Range;
use std::path::Path;

use hdf5_metno::types::{FixedAscii, FixedUnicode, TypeDescriptor, VarLenAscii, VarLenUnicode};
use hdf5_metno::{Dataset, File};
use ndarray::{Array1, Array2};

use crate::demonstrations::check_shapes;
use crate::error::DataError;
use crate::minari::MinariSource;
use crate::recording::{BLOCK_ROWS, Outline, Recording, Rows, episodes};
use crate::source::rows_of;

/// The first bytes of every HDF5 file.
const SIGNATURE: &[u8] = b"\x89HDF\r\n\x1a\n";
/// Bytes of a file of another kind that an error quotes.
const START_SIZE: u64 = 24;
/// Longest `metadata/env_id` stored with a fixed length, in bytes.
const ENV_ID_SIZE: usize = 256;

const TIMEOUTS: &str = "which marks the rows with which the time limit ended an episode (without \
     it these ends are unknown, and stacks and past actions would reach across episodes)";
const FLOATS: &str = "float32 or float64";
const FLAGS: &str = "bool, or integers or floats that are 0 or 1";

/// A D4RL file, or a folder in Minari's layout, whose rows are read as they are asked for.
pub struct RecordedFile {
    outline: Outline,
    layout: RowsOf,
}

enum RowsOf {
    D4rl { observations: Dataset, actions: Dataset, rewards: Dataset },
    Minari(MinariSource),
}

impl RecordedFile {
    /// Opens it and checks all but the numbers.
    ///
    /// # Errors
    /// [`DataError`]: `Read` for what the system or HDF5 refuses, `NotHdf5`, `Damaged`, `Missing`,
    /// `Type`, `Flag`, `Rank`, `Length`, `NoTransitions`.
    pub fn open(path: &Path) -> Result<Self, DataError> {
        if path.is_dir() { Self::minari(path) } else { Self::d4rl(path) }
    }

    fn d4rl(path: &Path) -> Result<Self, DataError> {
        let file = open(path)?;
        let column = |name, reason| Column::open(path, &file, name, reason);
        let observations = column("observations", "the observation before each action")?;
        let actions = column("actions", "the action of each transition")?;
        let rewards = column("rewards", "the reward of each transition")?;
        let terminals =
            column("terminals", "which marks the rows with which the task ended an episode")?;
        let timeouts = column("timeouts", TIMEOUTS)?;
        check_shapes(
            path,
            [&observations, &actions, &rewards, &terminals, &timeouts]
                .map(|column| (column.name, column.shape.as_slice())),
        )?;
        for column in [&observations, &actions, &rewards] {
            column.check_floats()?;
        }
        let (episodes, terminated, timed_out) = episodes(&terminals.flags()?, &timeouts.flags()?);
        let outline = Outline {
            source: path.to_path_buf(),
            env_id: env_id(&file),
            observation_size: observations.width(),
            action_size: actions.width(),
            episodes,
            terminated,
            timed_out,
        };
        let layout = RowsOf::D4rl {
            observations: observations.dataset,
            actions: actions.dataset,
            rewards: rewards.dataset,
        };
        Ok(Self { outline, layout })
    }

    fn minari(path: &Path) -> Result<Self, DataError> {
        let source = MinariSource::open(path)?;
        let shape = source.shape();
        let (mut episodes, mut terminated, mut timed_out) = (Vec::new(), 0, 0);
        let mut start = 0;
        for (index, length) in shape.lengths.iter().enumerate().filter(|(_, length)| **length > 0) {
            let ends = source.ends(index)?;
            terminated += usize::from(ends.0);
            timed_out += usize::from(ends.1);
            episodes.push(start..start + length);
            start += length;
        }
        let outline = Outline {
            source: path.to_path_buf(),
            env_id: source.env_id().map(str::to_owned),
            observation_size: shape.observation_size,
            action_size: shape.action_size,
            episodes,
            terminated,
            timed_out,
        };
        Ok(Self { outline, layout: RowsOf::Minari(source) })
    }

    /// Rows out of episodes, of which each has a group of its own.
    fn rows_of_episodes<'a>(
        &self,
        source: &MinariSource,
        rows: Range<usize>,
    ) -> Result<Rows<'a>, DataError> {
        let (mut observations, mut actions, mut rewards) = (Vec::new(), Vec::new(), Vec::new());
        let lengths = source.shape().lengths.iter().enumerate();
        let groups = lengths.filter(|(_, length)| **length > 0).map(|(index, _)| index);
        for (index, episode) in groups.zip(&self.outline.episodes) {
            let (start, end) = (episode.start.max(rows.start), episode.end.min(rows.end));
            if start >= end {
                continue;
            }
            let read = source.read(index, end - episode.start)?;
            let skipped = start - episode.start;
            let after = |width: usize| skipped * width..;
            let entries = &read.observations[after(self.outline.observation_size)];
            observations.extend(entries.iter().map(|&value| value as f32));
            actions.extend_from_slice(&read.actions[after(self.outline.action_size)]);
            rewards.extend(read.rewards[after(1)].iter().map(|&value| value as f32));
        }
        let Outline { observation_size, action_size, .. } = self.outline;
        self.gathered(
            rows.len(),
            ("observations", observation_size, observations),
            ("actions", action_size, actions),
            rewards,
        )
    }

    fn gathered<'a>(
        &self,
        n: usize,
        observations: (&str, usize, Vec<f32>),
        actions: (&str, usize, Vec<f32>),
        rewards: Vec<f32>,
    ) -> Result<Rows<'a>, DataError> {
        let matrix = |(name, width, values): (&str, usize, Vec<f32>)| {
            Array2::from_shape_vec((n, width), values)
                .map_err(|error| unreadable(&self.outline.source, name, &error))
        };
        Ok(Rows {
            observations: matrix(observations)?.into(),
            actions: matrix(actions)?.into(),
            rewards: Array1::from_vec(rewards).into(),
        })
    }
}

impl Recording for RecordedFile {
    fn outline(&self) -> &Outline {
        &self.outline
    }

    fn rows(&self, rows: Range<usize>) -> Result<Rows<'_>, DataError> {
        let source = &self.outline.source;
        let read = match &self.layout {
            RowsOf::Minari(minari) => self.rows_of_episodes(minari, rows.clone())?,
            RowsOf::D4rl { observations, actions, rewards } => {
                // HDF5 narrows float64, piece by piece.
                let values = |set: &Dataset, name: &'static str| {
                    rows_of::<f32>(set, rows.clone())
                        .map_err(|error| unreadable(source, name, &error))
                };
                let Outline { observation_size, action_size, .. } = self.outline;
                self.gathered(
                    rows.len(),
                    ("observations", observation_size, values(observations, "observations")?),
                    ("actions", action_size, values(actions, "actions")?),
                    values(rewards, "rewards")?,
                )?
            }
        };
        read.check(source, rows.start)?;
        Ok(read)
    }
}

/// A data set that is there.
struct Column<'a> {
    path: &'a Path,
    name: &'static str,
    dataset: Dataset,
    shape: Vec<usize>,
}

impl<'a> Column<'a> {
    fn open(
        path: &'a Path,
        file: &File,
        name: &'static str,
        reason: &'static str,
    ) -> Result<Self, DataError> {
        if !file.link_exists(name) {
            let mut found = file.member_names().unwrap_or_default();
            found.sort();
            return Err(DataError::Missing { path: path.into(), dataset: name, reason, found });
        }
        let dataset = file.dataset(name).map_err(|error| unreadable(path, name, &error))?;
        Ok(Self { path, name, shape: dataset.shape(), dataset })
    }

    /// Entries of a row; the shape has been checked.
    fn width(&self) -> usize {
        self.shape.get(1).copied().unwrap_or(1)
    }

    fn check_floats(&self) -> Result<(), DataError> {
        match self.descriptor()? {
            TypeDescriptor::Float(_) => Ok(()),
            other => Err(self.mistyped(&other, FLOATS)),
        }
    }

    /// Read as numbers: a bool's byte in a damaged file may be neither 0 nor 1.
    fn flags(&self) -> Result<Vec<bool>, DataError> {
        match self.descriptor()? {
            TypeDescriptor::Boolean
            | TypeDescriptor::Enum(_)
            | TypeDescriptor::Integer(_)
            | TypeDescriptor::Unsigned(_)
            | TypeDescriptor::Float(_) => {}
            other => return Err(self.mistyped(&other, FLAGS)),
        }
        let mut flags = Vec::with_capacity(self.shape[0]);
        for start in (0..self.shape[0]).step_by(BLOCK_ROWS) {
            let rows = start..self.shape[0].min(start + BLOCK_ROWS);
            let values = rows_of::<f64>(&self.dataset, rows)
                .map_err(|error| unreadable(self.path, self.name, &error))?;
            for value in values {
                flags.push(match value {
                    0.0 => false,
                    1.0 => true,
                    value => {
                        let (path, dataset, row) = (self.path.into(), self.name, flags.len());
                        let value = value.to_string();
                        return Err(DataError::Flag { path, dataset, row, value });
                    }
                });
            }
        }
        Ok(flags)
    }

    fn descriptor(&self) -> Result<TypeDescriptor, DataError> {
        self.dataset
            .dtype()
            .and_then(|dtype| dtype.to_descriptor())
            .map_err(|error| unreadable(self.path, self.name, &error))
    }

    fn mistyped(&self, got: &TypeDescriptor, want: &'static str) -> DataError {
        let (path, dataset, got) = (self.path.into(), self.name, got.to_string());
        DataError::Type { path, dataset, got, want }
    }
}

pub(crate) fn unreadable(path: &Path, dataset: &str, error: &dyn Display) -> DataError {
    DataError::Read { path: path.into(), dataset: dataset.to_owned(), message: error.to_string() }
}

pub(crate) fn open(path: &Path) -> Result<File, DataError> {
    let start = start_of(path).map_err(|error| unreadable(path, "the file", &error))?;
    File::open(path).map_err(|error| {
        if !start.starts_with(SIGNATURE) {
            return DataError::NotHdf5 { path: path.into(), content: describe(&start) };
        }
        // Somebody is writing it, perhaps.
        if error.to_string().contains("lock file") {
            return unreadable(path, "the file", &error);
        }
        let size = fs::metadata(path).map_or(0, |metadata| metadata.len());
        DataError::Damaged { path: path.into(), size, message: error.to_string() }
    })
}

/// The first bytes, enough to tell what a file is.
fn start_of(path: &Path) -> io::Result<Vec<u8>> {
    let mut start = Vec::new();
    fs::File::open(path)?.take(START_SIZE).read_to_end(&mut start)?;
    Ok(start)
}

/// What a reader may recognise: the page of a failed download, the pointer of a large file store.
fn describe(start: &[u8]) -> String {
    if start.is_empty() {
        "is empty".to_owned()
    } else {
        format!("starts with {:?}", String::from_utf8_lossy(start))
    }
}

/// `metadata/env_id`; `None` if it is absent or no text.
pub(crate) fn env_id(file: &File) -> Option<String> {
    let dataset = file.dataset("metadata/env_id").ok()?;
    let fixed = || dataset.read_scalar::<FixedUnicode<ENV_ID_SIZE>>().map(|text| text.to_string());
    let ascii = || dataset.read_scalar::<VarLenAscii>().map(|text| text.to_string());
    let fixed_ascii =
        || dataset.read_scalar::<FixedAscii<ENV_ID_SIZE>>().map(|text| text.to_string());
    dataset
        .read_scalar::<VarLenUnicode>()
        .map(|text| text.to_string())
        .or_else(|_| ascii())
        .or_else(|_| fixed())
        .or_else(|_| fixed_ascii())
        .ok()
}

#[cfg(test)]
mod tests;
