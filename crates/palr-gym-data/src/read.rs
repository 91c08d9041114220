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
use std::path::Path;

use hdf5_metno::types::{FixedAscii, FixedUnicode, TypeDescriptor, VarLenAscii, VarLenUnicode};
use hdf5_metno::{Dataset, File, H5Type};
use ndarray::{Array1, Array2};

use crate::demonstrations::{Arrays, Demonstrations, check_shapes};
use crate::error::DataError;
use crate::source::Source;

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

impl Demonstrations {
    /// Reads and checks a file in D4RL's layout, or a folder in Minari's.
    ///
    /// # Errors
    /// [`DataError`]: `Read` for what the system or HDF5 refuses, `NotHdf5`, `Damaged`, `Missing`,
    /// `Type`, `Flag`, and those of [`Demonstrations::new`].
    pub fn read(path: &Path) -> Result<Self, DataError> {
        if path.is_dir() {
            return Self::gather(&Source::open(path)?, path);
        }
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
        let arrays = Arrays {
            observations: observations.matrix()?,
            actions: actions.matrix()?,
            rewards: Array1::from_vec(rewards.floats()?),
            terminals: terminals.flags()?,
            timeouts: timeouts.flags()?,
        };
        Self::new(path, env_id(&file), arrays)
    }
}

impl Demonstrations {
    /// All episodes of a recording.
    fn gather(source: &Source, path: &Path) -> Result<Self, DataError> {
        let shape = source.shape();
        let (mut observations, mut actions, mut rewards) = (Vec::new(), Vec::new(), Vec::new());
        let (mut terminals, mut timeouts) = (Vec::new(), Vec::new());
        for index in 0..shape.lengths.len() {
            let episode = source.read(index, usize::MAX)?;
            observations.extend(episode.observations.iter().map(|&value| value as f32));
            actions.extend_from_slice(&episode.actions);
            rewards.extend(episode.rewards.iter().map(|&value| value as f32));
            let is_last = |row: usize| row + 1 == episode.len();
            terminals.extend((0..episode.len()).map(|row| is_last(row) && episode.terminated));
            timeouts.extend((0..episode.len()).map(|row| is_last(row) && episode.timed_out));
        }
        let n = rewards.len();
        let matrix = |name: &str, width: usize, values: Vec<f32>| {
            Array2::from_shape_vec((n, width), values)
                .map_err(|error| unreadable(path, name, &error))
        };
        let arrays = Arrays {
            observations: matrix("observations", shape.observation_size, observations)?,
            actions: matrix("actions", shape.action_size, actions)?,
            rewards: Array1::from_vec(rewards),
            terminals: Array1::from_vec(terminals),
            timeouts: Array1::from_vec(timeouts),
        };
        Self::new(path, source.env_id().map(str::to_owned), arrays)
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

    /// `[N, width]`; the shape has been checked.
    fn matrix(&self) -> Result<Array2<f32>, DataError> {
        let width = self.shape.get(1).copied().unwrap_or(1);
        Array2::from_shape_vec((self.shape[0], width), self.floats()?)
            .map_err(|error| unreadable(self.path, self.name, &error))
    }

    /// Every value, row-major. HDF5 narrows float64, piece by piece.
    fn floats(&self) -> Result<Vec<f32>, DataError> {
        match self.descriptor()? {
            TypeDescriptor::Float(_) => self.values(),
            other => Err(self.mistyped(&other, FLOATS)),
        }
    }

    /// Read as numbers: a bool's byte in a damaged file may be neither 0 nor 1.
    fn flags(&self) -> Result<Array1<bool>, DataError> {
        match self.descriptor()? {
            TypeDescriptor::Boolean
            | TypeDescriptor::Enum(_)
            | TypeDescriptor::Integer(_)
            | TypeDescriptor::Unsigned(_)
            | TypeDescriptor::Float(_) => {}
            other => return Err(self.mistyped(&other, FLAGS)),
        }
        let flag = |(row, value): (usize, f64)| match value {
            0.0 => Ok(false),
            1.0 => Ok(true),
            value => Err(DataError::Flag {
                path: self.path.into(),
                dataset: self.name,
                row,
                value: value.to_string(),
            }),
        };
        self.values::<f64>()?.into_iter().enumerate().map(flag).collect()
    }

    fn values<T: H5Type>(&self) -> Result<Vec<T>, DataError> {
        self.dataset.read_raw().map_err(|error| unreadable(self.path, self.name, &error))
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
