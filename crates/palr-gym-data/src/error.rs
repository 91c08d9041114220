//! What can go wrong with a data set.

use std::path::PathBuf;

/// Why a data set could not be written or read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DataError {
    /// HDF5 failed: no room, no permission, a broken disk.
    #[error("{}: cannot write {dataset}: {message}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The data set or group inside it.
        dataset: String,
        /// What HDF5 said.
        message: String,
    },
    /// HDF5 failed: no such file, no HDF5 file, or a data set is missing or of another type.
    #[error("{}: cannot read {dataset}: {message}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The data set or group inside it.
        dataset: String,
        /// What HDF5 said.
        message: String,
    },
    /// An episode does not fit the file.
    #[error("{}: episode {index} has {got} values of {dataset}; expected {want}", path.display())]
    Shape {
        /// The file.
        path: PathBuf,
        /// Index of the episode.
        index: u32,
        /// The data set.
        dataset: &'static str,
        /// Values found.
        got: usize,
        /// Values expected.
        want: usize,
    },
    /// Fewer or more transitions than were announced.
    #[error("{}: {got} transitions were written; {want} were announced", path.display())]
    Count {
        /// The file.
        path: PathBuf,
        /// Transitions written.
        got: usize,
        /// Transitions announced.
        want: usize,
    },
}
