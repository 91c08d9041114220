//! What of a run survives being killed at any moment.
//!
//! A checkpoint is a safetensors file that is whole or absent: parameters, Adam's moments, and the
//! step. Random numbers follow from the step ([`mod@crate::learning::train`]), so that this is
//! everything that later steps depend on besides settings and data, which are compared.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::Write;
use std::path::Path;

use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView, serialize};
use serde::{Deserialize, Serialize};

use crate::learning::adam::Adam;
use crate::learning::config::TrainConfig;
use crate::learning::error::TrainError;

/// The one key of the file's metadata: its value is [`Header`] as JSON.
const HEADER: &str = "palr_gym_checkpoint";
const VERSION: u32 = 1;

/// A run between two steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Checkpoint {
    /// The policy's flat vector.
    pub parameters: Vec<f32>,
    /// Moments, and the number of steps taken.
    pub adam: Adam,
}

#[derive(Serialize, Deserialize)]
struct Header {
    version: u32,
    step: u64,
    data_fingerprint: u32,
    config: TrainConfig,
}

impl Checkpoint {
    /// Before step 1.
    #[must_use]
    pub fn new(parameters: Vec<f32>) -> Self {
        let adam = Adam::new(parameters.len());
        Self { parameters, adam }
    }

    /// Replaces the file at `path`.
    ///
    /// # Errors
    /// [`TrainError::File`].
    pub fn write(
        &self,
        path: &Path,
        config: &TrainConfig,
        data_fingerprint: u32,
    ) -> Result<(), TrainError> {
        let failed = |error: &dyn std::fmt::Display| TrainError::file(path, error);
        let step = self.adam.step;
        let header = Header { version: VERSION, step, data_fingerprint, config: config.clone() };
        let header = serde_json::to_string(&header).map_err(|error| failed(&error))?;
        let arrays = [
            ("parameters", &self.parameters),
            ("adam.first_moment", &self.adam.first_moment),
            ("adam.second_moment", &self.adam.second_moment),
        ];
        let views = arrays.map(|(name, array)| {
            let bytes = bytemuck::cast_slice(array);
            TensorView::new(Dtype::F32, vec![array.len()], bytes).map(|view| (name, view))
        });
        let views: Vec<_> =
            views.into_iter().collect::<Result<_, _>>().map_err(|error| failed(&error))?;
        let metadata = HashMap::from([(HEADER.to_owned(), header)]);
        let bytes = serialize(views, Some(metadata)).map_err(|error| failed(&error))?;
        write_whole(path, &bytes)
    }

    /// The file at `path`, if there is one.
    ///
    /// # Errors
    /// [`TrainError::File`] if it cannot be read, or is of a run with other data, other settings
    /// or another number of parameters.
    pub fn read(
        path: &Path,
        config: &TrainConfig,
        data_fingerprint: u32,
        parameter_count: usize,
    ) -> Result<Option<Self>, TrainError> {
        let bytes = match fs::read(path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(TrainError::file(path, error)),
        };
        let failed = |error: &dyn std::fmt::Display| {
            TrainError::file(path, format!("is no checkpoint of this version: {error}"))
        };
        let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(|error| failed(&error))?;
        let header = metadata.metadata().as_ref().and_then(|metadata| metadata.get(HEADER));
        let header = header.ok_or_else(|| failed(&"it has no header"))?;
        let header: Header = serde_json::from_str(header).map_err(|error| failed(&error))?;
        if header.version != VERSION {
            return Err(failed(&format!("version {}", header.version)));
        }
        if header.data_fingerprint != data_fingerprint {
            return Err(TrainError::file(path, "is of a run with other training data"));
        }
        if !config.continues(&header.config) {
            let message = "is of a run with other settings; those that may change on resuming are \
                steps, log_every, checkpoint_every and metric_rows";
            return Err(TrainError::file(path, message));
        }
        let tensors = SafeTensors::deserialize(&bytes).map_err(|error| failed(&error))?;
        let array = |name: &str| -> Result<Vec<f32>, TrainError> {
            let view = tensors.tensor(name).map_err(|error| failed(&error))?;
            if view.dtype() != Dtype::F32 || view.shape() != [parameter_count] {
                let got = format!("{name} is {:?} {:?}", view.dtype(), view.shape());
                return Err(failed(&format!("{got}; expected F32 [{parameter_count}]")));
            }
            Ok(bytemuck::pod_collect_to_vec(view.data()))
        };
        let adam = Adam {
            first_moment: array("adam.first_moment")?,
            second_moment: array("adam.second_moment")?,
            step: header.step,
        };
        Ok(Some(Self { parameters: array("parameters")?, adam }))
    }
}

/// Steps that the run of the file at `path` has taken, if there is one.
///
/// # Errors
/// [`TrainError::File`] if it cannot be read.
pub fn steps_taken(path: &Path) -> Result<Option<u64>, TrainError> {
    let bytes = match fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(TrainError::file(path, error)),
    };
    let step = SafeTensors::read_metadata(&bytes).ok().and_then(|(_, metadata)| {
        let header = metadata.metadata().as_ref()?.get(HEADER)?;
        serde_json::from_str::<serde_json::Value>(header).ok()?.get("step")?.as_u64()
    });
    match step {
        Some(step) => Ok(Some(step)),
        None => Err(TrainError::file(path, "is no checkpoint of this version")),
    }
}

/// Replaces the file at `path`: at every moment it holds the old bytes or the new, also if the
/// machine stops.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), TrainError> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".writing");
    let partial = Path::new(&partial);
    let write = || -> std::io::Result<()> {
        let mut file = File::create(partial)?;
        file.write_all(bytes)?;
        // Otherwise the name could reach the disk before the bytes do.
        file.sync_all()?;
        fs::rename(partial, path)?;
        match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => File::open(folder)?.sync_all(),
            _ => Ok(()),
        }
    };
    write().map_err(|error| TrainError::file(path, format!("cannot write: {error}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checkpoint() -> Checkpoint {
        let adam = Adam { first_moment: vec![0.1, -0.0], second_moment: vec![1e-40, 3.0], step: 7 };
        Checkpoint { parameters: vec![1.5, f32::MIN_POSITIVE], adam }
    }

    #[test]
    fn what_was_written_is_read_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint");
        let config = TrainConfig::default();
        assert_eq!(Checkpoint::read(&path, &config, 5, 2).unwrap(), None);
        checkpoint().write(&path, &config, 5).unwrap();
        checkpoint().write(&path, &config, 5).unwrap();
        let read = Checkpoint::read(&path, &config, 5, 2).unwrap().unwrap();
        assert_eq!(read, checkpoint());
        assert_eq!(read.adam.first_moment[1].to_bits(), (-0.0_f32).to_bits());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn checkpoints_of_other_runs_and_damaged_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint");
        let config = TrainConfig::default();
        checkpoint().write(&path, &config, 5).unwrap();
        let refusal = |config: &TrainConfig, fingerprint, count| {
            Checkpoint::read(&path, config, fingerprint, count).unwrap_err().to_string()
        };
        assert!(refusal(&config, 6, 2).contains("other training data"));
        assert!(refusal(&config, 5, 3).contains("expected F32 [3]"));
        let other = TrainConfig { learning_rate: 1e-3, ..config.clone() };
        assert!(refusal(&other, 5, 2).contains("other settings"));
        let longer = TrainConfig { steps: 9, ..config.clone() };
        assert!(Checkpoint::read(&path, &longer, 5, 2).unwrap().is_some());
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
        assert!(refusal(&config, 5, 2).contains("is no checkpoint"));
        fs::write(&path, b"").unwrap();
        assert!(refusal(&config, 5, 2).contains("is no checkpoint"));
    }
}
