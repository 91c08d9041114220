//! What of a run survives being killed at any moment.
//!
//! A checkpoint is a safetensors file that is whole or absent: of each network its parameters and
//! Adam's moments, and the numbers of steps. Random numbers follow from the step ([`mod@crate::learning::train`]), so that this is
//! everything that later steps depend on besides settings and data, which are compared.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::Write;
use std::path::Path;

use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView, serialize};
use serde::{Deserialize, Serialize};

use crate::learning::config::TrainConfig;
use crate::learning::error::TrainError;
use crate::learning::network::Network;
use crate::learning::state::State;

/// The one key of the file's metadata: its value is [`Header`] as JSON.
const HEADER: &str = "palr_gym_checkpoint";
const VERSION: u32 = 2;
/// The method's other numbers.
const SCALARS: &str = "scalars";

#[derive(Serialize, Deserialize)]
struct Header {
    version: u32,
    step: u64,
    /// Of each network's optimiser.
    adam_steps: Vec<u64>,
    data_fingerprint: u32,
    config: TrainConfig,
}

/// Of one network.
fn arrays(network: &Network) -> [(String, &Vec<f32>); 3] {
    let name = network.name;
    [
        (format!("{name}.parameters"), &network.parameters),
        (format!("{name}.adam.first_moment"), &network.adam.first_moment),
        (format!("{name}.adam.second_moment"), &network.adam.second_moment),
    ]
}

/// Replaces the file at `path` by `state`.
///
/// # Errors
/// [`TrainError::File`].
pub fn write(
    state: &State,
    path: &Path,
    config: &TrainConfig,
    data_fingerprint: u32,
) -> Result<(), TrainError> {
    let failed = |error: &dyn std::fmt::Display| TrainError::file(path, error);
    let header = Header {
        version: VERSION,
        step: state.step,
        adam_steps: state.networks.iter().map(|network| network.adam.step).collect(),
        data_fingerprint,
        config: config.clone(),
    };
    let header = serde_json::to_string(&header).map_err(|error| failed(&error))?;
    let mut views = Vec::new();
    for (name, array) in state.networks.iter().flat_map(arrays) {
        let bytes = bytemuck::cast_slice(array);
        let view = TensorView::new(Dtype::F32, vec![array.len()], bytes);
        views.push((name, view.map_err(|error| failed(&error))?));
    }
    let scalars = bytemuck::cast_slice(&state.scalars);
    let view = TensorView::new(Dtype::F64, vec![state.scalars.len()], scalars);
    views.push((SCALARS.to_owned(), view.map_err(|error| failed(&error))?));
    let metadata = HashMap::from([(HEADER.to_owned(), header)]);
    let bytes = serialize(views, Some(metadata)).map_err(|error| failed(&error))?;
    write_whole(path, &bytes)
}

/// Replaces the file at `path` with `arrays` and `header`, a text, as the metadata entry `key`.
///
/// # Errors
/// [`TrainError::File`].
pub(crate) fn write_arrays<'a, N: AsRef<str> + Ord + std::fmt::Display>(
    path: &Path,
    (key, header): (&str, String),
    arrays: impl IntoIterator<Item = (N, &'a [f32])>,
) -> Result<(), TrainError> {
    let failed = |error: &dyn std::fmt::Display| TrainError::file(path, error);
    let views = arrays.into_iter().map(|(name, array)| {
        let view = TensorView::new(Dtype::F32, vec![array.len()], bytemuck::cast_slice(array))?;
        Ok::<_, safetensors::SafeTensorError>((name, view))
    });
    let views: Vec<_> = views.collect::<Result<_, _>>().map_err(|error| failed(&error))?;
    let metadata = HashMap::from([(key.to_owned(), header)]);
    write_whole(path, &serialize(views, Some(metadata)).map_err(|error| failed(&error))?)
}

/// The bytes of the file at `path`, if there is one.
///
/// # Errors
/// [`TrainError::File`] if it cannot be read.
pub(crate) fn read_if_there(path: &Path) -> Result<Option<Vec<u8>>, TrainError> {
    match fs::read(path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(TrainError::file(path, error)),
    }
}

/// The state in the file at `path`, if there is one. `fresh` is the method's state before step 1.
///
/// # Errors
/// [`TrainError::File`] if it cannot be read, or is of a run with other data, other settings or
/// other networks.
pub fn read(
    path: &Path,
    config: &TrainConfig,
    data_fingerprint: u32,
    fresh: &State,
) -> Result<Option<State>, TrainError> {
    let Some(bytes) = read_if_there(path)? else { return Ok(None) };
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
    let array = |name: &str, dtype: Dtype, want: usize| -> Result<&[u8], TrainError> {
        let view = tensors.tensor(name).map_err(|error| failed(&error))?;
        if view.dtype() != dtype || view.shape() != [want] {
            let got = format!("{name} is {:?} {:?}", view.dtype(), view.shape());
            return Err(failed(&format!("{got}; expected {dtype:?} [{want}]")));
        }
        Ok(view.data())
    };
    let mut state = fresh.clone();
    state.step = header.step;
    let (got, want) = (header.adam_steps.len(), state.networks.len());
    if got != want {
        return Err(failed(&format!("it has {got} networks; expected {want}")));
    }
    for (network, step) in state.networks.iter_mut().zip(header.adam_steps) {
        let [parameters, first_moment, second_moment] = arrays(network).map(|(name, _)| {
            array(&name, Dtype::F32, network.parameters.len()).map(bytemuck::pod_collect_to_vec)
        });
        network.parameters = parameters?;
        network.adam.first_moment = first_moment?;
        network.adam.second_moment = second_moment?;
        network.adam.step = step;
    }
    let scalars = array(SCALARS, Dtype::F64, state.scalars.len())?;
    state.scalars = bytemuck::pod_collect_to_vec(scalars);
    Ok(Some(state))
}

/// Steps that the run of the file at `path` has taken, if there is one.
///
/// # Errors
/// [`TrainError::File`] if it cannot be read.
pub fn steps_taken(path: &Path) -> Result<Option<u64>, TrainError> {
    let Some(bytes) = read_if_there(path)? else { return Ok(None) };
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
    use crate::learning::network::{Initialization, LayerShape};

    fn fresh(width: usize) -> State {
        let network = |name, number| {
            let layers = vec![LayerShape::new("layer", 1, width)];
            Network::new(name, layers, Initialization::Uniform, 0, number)
        };
        State { step: 0, networks: vec![network("a", 0), network("b", 1)], scalars: vec![0.0] }
    }

    fn later() -> State {
        let mut state = fresh(1);
        let network = &mut state.networks[1];
        network.parameters = vec![1.5, f32::MIN_POSITIVE];
        network.adam.first_moment = vec![0.1, -0.0];
        network.adam.second_moment = vec![1e-40, 3.0];
        network.adam.step = 35;
        state.step = 7;
        state.scalars[0] = 0.1 + 0.2;
        state
    }

    #[test]
    fn what_was_written_is_read_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint");
        let config = TrainConfig::default();
        assert_eq!(read(&path, &config, 5, &fresh(1)).unwrap(), None);
        write(&later(), &path, &config, 5).unwrap();
        write(&later(), &path, &config, 5).unwrap();
        let got = read(&path, &config, 5, &fresh(1)).unwrap().unwrap();
        assert_eq!(got, later());
        let zero = got.networks[1].adam.first_moment[1];
        assert_eq!(zero.to_bits(), (-0.0_f32).to_bits());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn checkpoints_of_other_runs_and_damaged_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint");
        let config = TrainConfig::default();
        write(&later(), &path, &config, 5).unwrap();
        let refusal = |config: &TrainConfig, fingerprint, fresh: &State| {
            read(&path, config, fingerprint, fresh).unwrap_err().to_string()
        };
        assert!(refusal(&config, 6, &fresh(1)).contains("other training data"));
        assert!(refusal(&config, 5, &fresh(2)).contains("expected F32 [4]"));
        let mut fewer = fresh(1);
        fewer.networks.pop();
        assert!(refusal(&config, 5, &fewer).contains("it has 2 networks; expected 1"));
        let other = TrainConfig { learning_rate: 1e-3, ..config.clone() };
        assert!(refusal(&other, 5, &fresh(1)).contains("other settings"));
        let longer = TrainConfig { steps: 9, ..config.clone() };
        assert!(read(&path, &longer, 5, &fresh(1)).unwrap().is_some());
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
        assert!(refusal(&config, 5, &fresh(1)).contains("is no checkpoint"));
        fs::write(&path, b"").unwrap();
        assert!(refusal(&config, 5, &fresh(1)).contains("is no checkpoint"));
    }
}
