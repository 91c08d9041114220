//! The HDF5 layout of D4RL, written episode by episode.
//!
//! | data set | type | shape |
//! |---|---|---|
//! | `observations`, `next_observations` | float32 | `[N, observation size]` |
//! | ... of pictures | uint8 | `[N, height, width, 3]` |
//! | `actions` | float32 | `[N, action size]` |
//! | `rewards` | float32 | `[N]` |
//! | `terminals`, `timeouts` | bool | `[N]` |
//! | `infos/qpos`, `infos/qvel` | float64 | `[N, nq]`, `[N, nv]`, if known |
//! | `infos/action_log_probs` | float32 | `[N]`, if known |
//! | `metadata/*` | string, int64 | scalar |
//!
//! An episode ends at `terminals | timeouts`; of the two, at most one is set on a row.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use hdf5_metno::types::VarLenUnicode;
use hdf5_metno::{Dataset, File, Group, H5Type};
use ndarray::{ArrayView1, ArrayView2, ArrayView4, s};

use crate::error::DataError;
use crate::transitions::Episode;

/// Rows in a chunk: large enough to compress, small enough to read one episode cheaply.
const CHUNK_ROWS: usize = 1024;
/// Fewer rows where they are as long as pictures.
const CHUNK_ENTRIES: usize = 1 << 20;
/// zlib's level; higher ones shrink little and cost much.
const DEFLATE_LEVEL: u8 = 4;

/// Sizes of a file that is about to be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct D4rlShape {
    /// Number of transitions, N.
    pub transitions: usize,
    /// Entries of an observation.
    pub observation_size: usize,
    /// Height, width and channels of an observation that is a picture.
    pub picture: Option<[usize; 3]>,
    /// Entries of an action.
    pub action_size: usize,
    /// Generalised positions; 0 if unknown.
    pub nq: usize,
    /// Generalised velocities; 0 if unknown.
    pub nv: usize,
    /// True if log densities of actions are known.
    pub has_action_log_probs: bool,
}

/// HDF5's text, or the system's alone where HDF5 wraps a full disk in a page of it.
pub(crate) fn plain(error: &dyn std::fmt::Display) -> String {
    const NO_SPACE: &str = "No space left on device";
    let text = error.to_string();
    if text.contains(NO_SPACE) { NO_SPACE.to_owned() } else { text }
}

/// A value under `metadata/`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Metadata {
    /// A text.
    Text(String),
    /// A number.
    Integer(i64),
}

/// A file that is being written. Equal input gives equal bytes.
pub struct D4rlWriter {
    path: PathBuf,
    file: File,
    shape: D4rlShape,
    observations: Dataset,
    next_observations: Dataset,
    actions: Dataset,
    rewards: Dataset,
    terminals: Dataset,
    timeouts: Dataset,
    qpos: Option<Dataset>,
    qvel: Option<Dataset>,
    action_log_probs: Option<Dataset>,
    written: usize,
}

impl D4rlWriter {
    /// Creates `path`, replacing what was there, with room for `shape`.
    ///
    /// # Errors
    /// [`DataError::Write`].
    pub fn create(
        path: &Path,
        shape: D4rlShape,
        metadata: &[(&str, Metadata)],
    ) -> Result<Self, DataError> {
        let failed = |dataset: &str, error: hdf5_metno::Error| DataError::Write {
            path: path.to_path_buf(),
            dataset: dataset.to_owned(),
            message: plain(&error),
        };
        let file = File::with_options()
            .with_fcpl(|plist| plist.obj_track_times(false))
            .create(path)
            .map_err(|error| failed("the file", error))?;
        let infos = group(&file, "infos").map_err(|error| failed("infos", error))?;
        let n = shape.transitions;
        let matrix = |group: &Group, name: &str, width: usize| {
            create::<f32>(group, name, &[n, width]).map_err(|error| failed(name, error))
        };
        let matrix64 = |name: &str, width: usize| {
            let dataset = || create::<f64>(&infos, name, &[n, width]);
            (width > 0).then(dataset).transpose().map_err(|error| failed(name, error))
        };
        let frames = |name: &str| match shape.picture {
            Some([height, width, channels]) => {
                create::<u8>(&file, name, &[n, height, width, channels])
                    .map_err(|error| failed(name, error))
            }
            None => matrix(&file, name, shape.observation_size),
        };
        let flags =
            |name: &str| create::<bool>(&file, name, &[n]).map_err(|error| failed(name, error));
        let writer = Self {
            path: path.to_path_buf(),
            observations: frames("observations")?,
            next_observations: frames("next_observations")?,
            actions: matrix(&file, "actions", shape.action_size)?,
            rewards: create::<f32>(&file, "rewards", &[n])
                .map_err(|error| failed("rewards", error))?,
            terminals: flags("terminals")?,
            timeouts: flags("timeouts")?,
            qpos: matrix64("qpos", shape.nq)?,
            qvel: matrix64("qvel", shape.nv)?,
            action_log_probs: shape
                .has_action_log_probs
                .then(|| create::<f32>(&infos, "action_log_probs", &[n]))
                .transpose()
                .map_err(|error| failed("infos/action_log_probs", error))?,
            file,
            shape,
            written: 0,
        };
        writer.write_metadata(metadata)?;
        Ok(writer)
    }

    fn write_metadata(&self, metadata: &[(&str, Metadata)]) -> Result<(), DataError> {
        let group =
            group(&self.file, "metadata").map_err(|error| self.failed("metadata", &error))?;
        for (name, value) in metadata {
            let failed = |error: &dyn std::fmt::Display| self.failed(name, error);
            match value {
                Metadata::Text(text) => {
                    let text = VarLenUnicode::from_str(text).map_err(|error| failed(&error))?;
                    scalar(&group, name, &text)
                }
                Metadata::Integer(value) => scalar(&group, name, value),
            }
            .map_err(|error| failed(&error))?;
        }
        Ok(())
    }

    /// Appends an episode.
    ///
    /// # Errors
    /// [`DataError::Shape`] if its lists do not fit the file, [`DataError::Count`] if there is no
    /// room, [`DataError::Write`].
    pub fn append(&mut self, episode: &Episode<'_>) -> Result<(), DataError> {
        let length = episode.len();
        let D4rlShape { observation_size, action_size, nq, nv, .. } = self.shape;
        let log_prob_count = if self.shape.has_action_log_probs { length } else { 0 };
        for (dataset, got, want) in [
            ("observations", episode.observations.len(), length * observation_size),
            ("next_observations", episode.next_observations.len(), length * observation_size),
            ("actions", episode.actions.len(), length * action_size),
            ("infos/qpos", episode.qpos.len(), length * nq),
            ("infos/qvel", episode.qvel.len(), length * nv),
            ("infos/action_log_probs", episode.action_log_probs.len(), log_prob_count),
        ] {
            if got != want {
                let (path, index) = (self.path.clone(), episode.index);
                return Err(DataError::Shape { path, index, dataset, got, want });
            }
        }
        if self.written + length > self.shape.transitions {
            return Err(self.miscounted(self.written + length));
        }
        let narrow = |values: &[f64]| values.iter().map(|&value| value as f32).collect::<Vec<_>>();
        let mut terminals = vec![false; length];
        let mut timeouts = vec![false; length];
        if let (Some(terminal), Some(timeout)) = (terminals.last_mut(), timeouts.last_mut()) {
            *terminal = episode.terminated;
            *timeout = episode.timed_out && !episode.terminated;
        }
        for (dataset, values) in [
            (&self.observations, &episode.observations),
            (&self.next_observations, &episode.next_observations),
        ] {
            match self.shape.picture {
                Some(picture) => self.write_pictures(dataset, values, picture)?,
                None => self.write_rows(dataset, &narrow(values), observation_size)?,
            }
        }
        self.write_rows(&self.actions, &episode.actions, action_size)?;
        self.write_column(&self.rewards, &narrow(&episode.rewards))?;
        self.write_column(&self.terminals, &terminals)?;
        self.write_column(&self.timeouts, &timeouts)?;
        for (dataset, values, width) in
            [(&self.qpos, &episode.qpos, nq), (&self.qvel, &episode.qvel, nv)]
        {
            if let Some(dataset) = dataset {
                self.write_rows(dataset, values, width)?;
            }
        }
        if let Some(dataset) = &self.action_log_probs {
            self.write_column(dataset, &narrow(&episode.action_log_probs))?;
        }
        self.written += length;
        Ok(())
    }

    fn write_rows<T: H5Type>(
        &self,
        dataset: &Dataset,
        values: &[T],
        width: usize,
    ) -> Result<(), DataError> {
        let rows = values.len() / width.max(1);
        let view = ArrayView2::from_shape((rows, width), values)
            .map_err(|error| self.failed(&dataset.name(), &error))?;
        dataset
            .write_slice(view, s![self.written..self.written + rows, ..])
            .map_err(|error| self.failed(&dataset.name(), &error))
    }

    fn write_pictures(
        &self,
        dataset: &Dataset,
        values: &[f64],
        [height, width, channels]: [usize; 3],
    ) -> Result<(), DataError> {
        let rows = values.len() / (height * width * channels).max(1);
        let bytes: Vec<u8> = values.iter().map(|&value| value as u8).collect();
        let view = ArrayView4::from_shape((rows, height, width, channels), &bytes)
            .map_err(|error| self.failed(&dataset.name(), &error))?;
        dataset
            .write_slice(view, s![self.written..self.written + rows, .., .., ..])
            .map_err(|error| self.failed(&dataset.name(), &error))
    }

    fn write_column<T: H5Type>(&self, dataset: &Dataset, values: &[T]) -> Result<(), DataError> {
        dataset
            .write_slice(ArrayView1::from(values), s![self.written..self.written + values.len()])
            .map_err(|error| self.failed(&dataset.name(), &error))
    }

    /// Flushes and closes the file.
    ///
    /// # Errors
    /// [`DataError::Count`] if transitions are missing, [`DataError::Write`].
    pub fn finish(self) -> Result<(), DataError> {
        if self.written != self.shape.transitions {
            return Err(self.miscounted(self.written));
        }
        self.file.flush().map_err(|error| self.failed("the file", &error))
    }

    fn miscounted(&self, got: usize) -> DataError {
        DataError::Count { path: self.path.clone(), got, want: self.shape.transitions }
    }

    fn failed(&self, dataset: &str, error: &dyn std::fmt::Display) -> DataError {
        DataError::Write {
            path: self.path.clone(),
            dataset: dataset.trim_start_matches('/').to_owned(),
            message: plain(error),
        }
    }
}

// Objects hold no time of creation, so that equal input gives equal bytes.

pub(crate) fn group(parent: &Group, name: &str) -> hdf5_metno::Result<Group> {
    parent.create_group_builder().obj_track_times(false).create(name)
}

/// What a file says about itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Summary {
    /// Rows.
    pub transitions: u64,
    /// Ends of episodes, `terminals | timeouts`.
    pub episodes: usize,
    /// `metadata/request`, if there is one.
    pub request: Option<String>,
}

/// Reads what a file says about itself, without its rows.
///
/// # Errors
/// [`DataError::Read`].
pub fn summarize(path: &Path) -> Result<Summary, DataError> {
    let failed = |dataset: &str, error: hdf5_metno::Error| DataError::Read {
        path: path.to_path_buf(),
        dataset: dataset.to_owned(),
        message: error.to_string(),
    };
    let file = File::open(path).map_err(|error| failed("the file", error))?;
    let flags = |name: &str| {
        file.dataset(name)
            .and_then(|dataset| dataset.read_raw::<bool>())
            .map_err(|error| failed(name, error))
    };
    let (terminals, timeouts) = (flags("terminals")?, flags("timeouts")?);
    let request = file
        .dataset("metadata/request")
        .and_then(|dataset| dataset.read_scalar::<VarLenUnicode>())
        .ok()
        .map(|text| text.to_string());
    Ok(Summary {
        transitions: terminals.len() as u64,
        episodes: terminals.iter().zip(&timeouts).filter(|(a, b)| **a || **b).count(),
        request,
    })
}

pub(crate) fn create<T: H5Type>(
    group: &Group,
    name: &str,
    shape: &[usize],
) -> hdf5_metno::Result<Dataset> {
    let mut chunk = shape.to_vec();
    let row: usize = shape[1..].iter().product();
    chunk[0] = chunk[0].clamp(1, (CHUNK_ENTRIES / row.max(1)).clamp(1, CHUNK_ROWS));
    group
        .new_dataset_builder()
        .obj_track_times(false)
        .chunk(chunk)
        .shuffle()
        .deflate(DEFLATE_LEVEL)
        .empty::<T>()
        .shape(shape)
        .create(name)
}

fn scalar<T: H5Type>(group: &Group, name: &str, value: &T) -> hdf5_metno::Result<()> {
    group
        .new_dataset_builder()
        .obj_track_times(false)
        .empty::<T>()
        .create(name)?
        .write_scalar(value)
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use super::*;

    const SHAPE: D4rlShape = D4rlShape {
        transitions: 5,
        observation_size: 2,
        picture: None,
        action_size: 1,
        nq: 3,
        nv: 1,
        has_action_log_probs: true,
    };

    fn episode(index: u32, length: usize, terminated: bool) -> Episode<'static> {
        let ramp = |count: usize| Cow::Owned((0..count).map(|i| i as f64).collect::<Vec<_>>());
        Episode {
            index,
            observations: ramp(length * 2),
            actions: Cow::Owned(vec![0.5; length]),
            rewards: ramp(length),
            next_observations: ramp(length * 2),
            qpos: ramp(length * 3),
            qvel: ramp(length),
            action_log_probs: ramp(length),
            terminated,
            timed_out: true,
        }
    }

    fn write(path: &Path) {
        let metadata =
            [("env_id", Metadata::Text("hopper-v0".into())), ("seed", Metadata::Integer(3))];
        let mut writer = D4rlWriter::create(path, SHAPE, &metadata).unwrap();
        writer.append(&episode(0, 2, true)).unwrap();
        writer.append(&episode(1, 3, false)).unwrap();
        writer.finish().unwrap();
    }

    /// What HDF5's other readers see is tested from Python with h5py.
    #[test]
    fn episodes_lie_end_to_end_and_end_with_one_flag() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.hdf5");
        write(&path);
        let file = File::open(&path).unwrap();
        let flags = |name: &str| file.dataset(name).unwrap().read_raw::<bool>().unwrap();
        assert_eq!(flags("terminals"), [false, true, false, false, false]);
        assert_eq!(flags("timeouts"), [false, false, false, false, true]);
        let rewards = file.dataset("rewards").unwrap().read_raw::<f32>().unwrap();
        assert_eq!(rewards, [0.0, 1.0, 0.0, 1.0, 2.0]);
        assert_eq!(file.dataset("infos/qpos").unwrap().shape(), [5, 3]);
        let summary = summarize(&path).unwrap();
        assert_eq!(summary, Summary { transitions: 5, episodes: 2, request: None });
        assert_eq!(file.dataset("metadata/seed").unwrap().read_scalar::<i64>().unwrap(), 3);
    }

    #[test]
    fn equal_input_gives_equal_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let (first, second) = (folder.path().join("a.hdf5"), folder.path().join("b.hdf5"));
        write(&first);
        // HDF5's time stamps count seconds.
        std::thread::sleep(std::time::Duration::from_millis(1100));
        write(&second);
        assert!(std::fs::read(first).unwrap() == std::fs::read(second).unwrap());
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.hdf5");
        let mut writer = D4rlWriter::create(&path, SHAPE, &[]).unwrap();
        let mut wrong = episode(7, 2, true);
        wrong.actions.to_mut().pop();
        let error = writer.append(&wrong).unwrap_err().to_string();
        assert!(error.contains("episode 7 has 1 values of actions; expected 2"), "{error}");
        assert!(matches!(
            writer.append(&episode(0, 6, true)),
            Err(DataError::Count { got: 6, .. })
        ));
        writer.append(&episode(0, 2, true)).unwrap();
        assert!(matches!(writer.finish(), Err(DataError::Count { got: 2, want: 5, .. })));
    }
}
