//! Run folders that never mix.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::ClientError;

/// Digits of a run's number.
const DIGITS: usize = 3;
const LOCK: &str = ".lock";

/// A folder that one process has to itself, numbered within its parent: `runs/demo/001`.
#[derive(Debug)]
pub struct Run {
    folder: PathBuf,
    /// Held until the run is dropped, also if the process dies.
    _lock: File,
}

impl Run {
    /// Makes a new folder after the highest number in `parent`.
    ///
    /// # Errors
    /// [`ClientError::File`].
    pub fn create(parent: &Path) -> Result<Self, ClientError> {
        fs::create_dir_all(parent).map_err(|error| ClientError::file(parent, error))?;
        let mut number = numbers(parent)?.last().map_or(1, |last| last + 1);
        loop {
            let folder = parent.join(format!("{number:0DIGITS$}"));
            match fs::create_dir(&folder) {
                Ok(()) => return Self::lock(folder),
                // Another process was quicker.
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => number += 1,
                Err(error) => return Err(ClientError::file(folder, error)),
            }
        }
    }

    /// Takes `folder`, which the caller names, for a new run.
    ///
    /// # Errors
    /// [`ClientError::File`] if it cannot be made or another process has it.
    pub fn at(folder: &Path) -> Result<Self, ClientError> {
        fs::create_dir_all(folder).map_err(|error| ClientError::file(folder, error))?;
        Self::lock(folder.to_path_buf())
    }

    /// Opens the run in `folder`.
    ///
    /// # Errors
    /// [`ClientError::File`] if there is no such folder, or another process has it.
    pub fn open(folder: &Path) -> Result<Self, ClientError> {
        if !folder.is_dir() {
            return Err(ClientError::file(folder, "is no folder; expected that of a run"));
        }
        Self::lock(folder.to_path_buf())
    }

    /// Opens the run with the highest number in `parent`.
    ///
    /// # Errors
    /// [`ClientError::File`] if there is none, or another process has it.
    pub fn open_latest(parent: &Path) -> Result<Self, ClientError> {
        let Some(number) = numbers(parent)?.pop() else {
            return Err(ClientError::file(parent, "holds no run to resume; start one first"));
        };
        Self::lock(parent.join(format!("{number:0DIGITS$}")))
    }

    fn lock(folder: PathBuf) -> Result<Self, ClientError> {
        let path = folder.join(LOCK);
        let failed = |message: String| ClientError::file(&folder, message);
        let lock = OpenOptions::new()
            .create(true)
            .write(true)
            .truncate(false)
            .open(&path)
            .map_err(|error| failed(error.to_string()))?;
        match lock.try_lock() {
            Ok(()) => Ok(Self { folder, _lock: lock }),
            Err(TryLockError::WouldBlock) => {
                Err(failed("another process is at work in this run".into()))
            }
            Err(TryLockError::Error(error)) => Err(failed(error.to_string())),
        }
    }

    /// The folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// A file in the folder.
    #[must_use]
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Writes a value as JSON; the file is whole or absent.
    ///
    /// # Errors
    /// [`ClientError::File`].
    pub fn write_json(&self, name: &str, value: &impl Serialize) -> Result<(), ClientError> {
        let path = self.path(name);
        let partial = self.path(&format!("{name}.writing"));
        let failed = |error: &dyn std::fmt::Display| ClientError::file(&path, error);
        let mut text = serde_json::to_string_pretty(value).map_err(|error| failed(&error))?;
        text.push('\n');
        fs::write(&partial, text).map_err(|error| failed(&error))?;
        fs::rename(&partial, &path).map_err(|error| failed(&error))
    }

    /// Reads a value that was written before; `None` if the file is not there.
    ///
    /// # Errors
    /// [`ClientError::File`] if it cannot be read or understood.
    pub fn read_json<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>, ClientError> {
        let path = self.path(name);
        let failed = |error: &dyn std::fmt::Display| ClientError::file(&path, error);
        match fs::read(&path) {
            Ok(bytes) => serde_json::from_slice(&bytes).map(Some).map_err(|error| failed(&error)),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(failed(&error)),
        }
    }
}

/// The numbers of the runs in `parent`, ascending; none if it does not exist.
fn numbers(parent: &Path) -> Result<Vec<u32>, ClientError> {
    let entries = match fs::read_dir(parent) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(ClientError::file(parent, error)),
    };
    let mut numbers: Vec<u32> = entries
        .filter_map(Result::ok)
        .filter(|entry| entry.path().is_dir())
        .filter_map(|entry| entry.file_name().to_str()?.parse().ok())
        .collect();
    numbers.sort_unstable();
    Ok(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_run_has_a_folder_of_its_own_and_only_one_process_at_a_time() {
        let parent = tempfile::tempdir().unwrap();
        let first = Run::create(parent.path()).unwrap();
        let second = Run::create(parent.path()).unwrap();
        assert!(first.folder().ends_with("001") && second.folder().ends_with("002"));
        let error = Run::open_latest(parent.path()).unwrap_err().to_string();
        assert!(error.contains("another process is at work"), "{error}");
        drop(second);
        assert!(Run::open_latest(parent.path()).unwrap().folder().ends_with("002"));
    }

    #[test]
    fn resuming_nothing_says_so_and_json_survives() {
        let parent = tempfile::tempdir().unwrap();
        let error = Run::open_latest(&parent.path().join("absent")).unwrap_err().to_string();
        assert!(error.contains("holds no run to resume"), "{error}");
        let run = Run::create(parent.path()).unwrap();
        assert_eq!(run.read_json::<Vec<u32>>("a.json").unwrap(), None);
        run.write_json("a.json", &[1, 2]).unwrap();
        assert_eq!(run.read_json::<Vec<u32>>("a.json").unwrap(), Some(vec![1, 2]));
    }
}
