//! Recordings copied, whole or in part, from either layout to either; episode by episode.

use std::fs;
use std::path::{Path, PathBuf};

use crate::d4rl::{D4rlShape, D4rlWriter, Metadata};
use crate::error::DataError;
use crate::minari::MinariWriter;
use crate::source::{Part, Source};

/// Layouts of recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// One HDF5 file.
    D4rl,
    /// A folder.
    Minari,
}

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Copied {
    /// Episodes.
    pub episodes: usize,
    /// Transitions.
    pub transitions: usize,
}

/// Copies `part` of the recording at `from` to `to`, which must not be there; it is whole or absent
/// afterwards. `extra` metadata are added. `dataset_id` is the name in Minari's layout.
///
/// # Errors
/// [`DataError`].
pub fn copy(
    from: &Path,
    to: &Path,
    layout: Layout,
    part: &Part,
    dataset_id: &str,
    extra: &[(String, Metadata)],
) -> Result<Copied, DataError> {
    let source = Source::open(from)?;
    if to.exists() {
        return Err(refused(to, "it is there already; remove it or name another"));
    }
    let shape = source.shape();
    let chosen = part.of(&shape.lengths);
    let transitions: usize = chosen.iter().map(|(_, length)| length).sum();
    if transitions == 0 {
        return Err(DataError::NoRows);
    }
    if layout == Layout::Minari && !shape.has_last_observation {
        let (path, dataset) = (from.to_path_buf(), "next_observations");
        let reason = "whose last row of an episode ends its observations in Minari's layout";
        return Err(DataError::Missing { path, dataset, reason, found: Vec::new() });
    }
    let mut metadata = source.metadata().to_vec();
    // A part is not what was asked for then: nothing may take it for a finished recording.
    for (name, _) in &mut metadata {
        if name == "request" {
            *name = "source_request".to_owned();
        }
    }
    for (name, value) in extra {
        metadata.retain(|(other, _)| other != name);
        metadata.push((name.clone(), value.clone()));
    }
    metadata.sort_by(|a, b| a.0.cmp(&b.0));
    let partial = partial(to);
    remove(&partial)?;
    let write = || match layout {
        Layout::D4rl => {
            let shape = D4rlShape {
                transitions,
                observation_size: shape.observation_size,
                picture: None,
                action_size: shape.action_size,
                nq: shape.nq,
                nv: shape.nv,
                has_action_log_probs: shape.has_action_log_probs,
            };
            let borrowed: Vec<_> =
                metadata.iter().map(|(name, value)| (name.as_str(), value.clone())).collect();
            let mut writer = D4rlWriter::create(&partial, shape, &borrowed)?;
            for &(index, length) in &chosen {
                writer.append(&source.read(index, length)?)?;
            }
            writer.finish()
        }
        Layout::Minari => {
            let mut writer = MinariWriter::create(&partial, dataset_id, shape, &metadata)?;
            let seed = metadata.iter().find_map(|(name, value)| match value {
                Metadata::Integer(seed) if name == "seed" => Some(*seed),
                _ => None,
            });
            for &(index, length) in &chosen {
                let seed = seed.map(|seed| seed.wrapping_add(index as i64));
                writer.append(&source.read(index, length)?, seed)?;
            }
            writer.finish()
        }
    };
    let done = write()
        .and_then(|()| fs::rename(&partial, to).map_err(|error| refused(to, &error.to_string())));
    if done.is_err() {
        // What was half written is of no use; the first error is what counts.
        let _ = remove(&partial);
    }
    done.map(|()| Copied { episodes: chosen.len(), transitions })
}

fn partial(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".writing");
    name.into()
}

fn remove(path: &Path) -> Result<(), DataError> {
    let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    match removed {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(refused(path, &error.to_string()))
        }
        _ => Ok(()),
    }
}

fn refused(path: &Path, message: &str) -> DataError {
    DataError::Write {
        path: path.into(),
        dataset: "the recording".into(),
        message: message.to_owned(),
    }
}
