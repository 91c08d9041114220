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
    /// The file is something else.
    #[error("{}: not an HDF5 file: it {content}; expected an HDF5 file in D4RL's layout", path.display())]
    NotHdf5 {
        /// The file.
        path: PathBuf,
        /// What it is: "is empty", "starts with …".
        content: String,
    },
    /// The file begins as HDF5 does, but HDF5 cannot open it.
    #[error(
        "{}: the HDF5 file is cut short or damaged ({size} bytes; HDF5 says: {message}); \
         copy or download it again",
        path.display()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Its size.
        size: u64,
        /// What HDF5 said.
        message: String,
    },
    /// A data set is not there.
    #[error(
        "{}: has no data set {dataset}, {reason}; found {}",
        path.display(),
        list(found)
    )]
    Missing {
        /// The file.
        path: PathBuf,
        /// The data set.
        dataset: &'static str,
        /// What it holds, or why one cannot do without.
        reason: &'static str,
        /// What there is instead, sorted.
        found: Vec<String>,
    },
    /// A data set has a type without that meaning.
    #[error("{}: {dataset} is of type {got}; expected {want}", path.display())]
    Type {
        /// The file.
        path: PathBuf,
        /// The data set.
        dataset: &'static str,
        /// Type found.
        got: String,
        /// Types expected.
        want: &'static str,
    },
    /// A data set has too few or too many dimensions, or no columns.
    #[error("{}: {dataset} has shape {got:?}; expected {want}", path.display())]
    Rank {
        /// The file.
        path: PathBuf,
        /// The data set.
        dataset: &'static str,
        /// Shape found.
        got: Vec<usize>,
        /// Shapes expected.
        want: &'static str,
    },
    /// Data sets disagree about the number of transitions.
    #[error(
        "{}: {dataset} has {got} rows; expected {want}, as many as observations",
        path.display()
    )]
    Length {
        /// The file.
        path: PathBuf,
        /// The data set.
        dataset: &'static str,
        /// Rows found.
        got: usize,
        /// Rows of `observations`.
        want: usize,
    },
    /// No transitions.
    #[error("{}: observations has 0 rows; expected at least 1", path.display())]
    NoTransitions {
        /// The file.
        path: PathBuf,
    },
    /// NaN, infinity, or a number beyond float32.
    #[error(
        "{}: {dataset} holds {value} at row {row}, column {column}; expected finite float32 values",
        path.display()
    )]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// The data set.
        dataset: &'static str,
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// The value, as float32.
        value: String,
    },
    /// An action that no actuator takes.
    #[error(
        "{}: actions holds {value} at row {row}, column {column}; expected values within [-1, 1]",
        path.display()
    )]
    ActionOutOfBounds {
        /// The file.
        path: PathBuf,
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// The value.
        value: String,
    },
    /// A flag that is neither set nor unset.
    #[error("{}: {dataset} holds {value} at row {row}; expected 0 or 1", path.display())]
    Flag {
        /// The file.
        path: PathBuf,
        /// The data set.
        dataset: &'static str,
        /// Row, from 0.
        row: usize,
        /// The value.
        value: String,
    },
    /// The file says that it holds another environment's data.
    #[error(
        "{}: holds data of {got}; expected full single observations of {task}, as of {want}",
        path.display()
    )]
    Environment {
        /// The file.
        path: PathBuf,
        /// `metadata/env_id`.
        got: String,
        /// The view's task.
        task: String,
        /// An id that would do.
        want: String,
    },
    /// Observations or actions of another width than the task's: data of another task, or masked.
    #[error(
        "{}: {dataset} has {got} columns; {task}'s full {} has {want}{}: \
         is this data of another task, or masked already?",
        path.display(),
        dataset.trim_end_matches('s'),
        or(also)
    )]
    Columns {
        /// The file.
        path: PathBuf,
        /// The data set.
        dataset: &'static str,
        /// Columns found.
        got: usize,
        /// Columns expected.
        want: usize,
        /// Other numbers of columns that would do.
        also: &'static [usize],
        /// The view's task.
        task: String,
    },
    /// A view that makes no sense, whatever the file.
    #[error("the view of {task} keeps column {index} of a full observation of {size}")]
    MaskIndex {
        /// The view's task.
        task: String,
        /// The index.
        index: usize,
        /// Entries of the full observation.
        size: usize,
    },
    /// A view of nothing.
    #[error("the view of {task} keeps no columns; expected at least 1 mask index")]
    EmptyMask {
        /// The view's task.
        task: String,
    },
    /// Too shallow or too deep a stack.
    #[error("the view of {task} has a frame stack of {got}; expected 1 to {max}")]
    FrameStack {
        /// The view's task.
        task: String,
        /// Depth asked for.
        got: usize,
        /// Deepest stack.
        max: usize,
    },
    /// A selection of no rows.
    #[error("a selection of 0 rows; expected at least 1")]
    NoRows,
    /// A selection beyond the end of the file.
    #[error(
        "{}: {want} rows from row {start} on were asked for; the file has {transitions}",
        path.display()
    )]
    TooFewRows {
        /// The file.
        path: PathBuf,
        /// First row of the selection.
        start: usize,
        /// Rows asked for.
        want: usize,
        /// Rows in the file.
        transitions: usize,
    },
    /// Held-out rows that the training has seen.
    #[error("held-out rows start at row {start}, within the {training_rows} training rows")]
    HeldOutOverlap {
        /// First held-out row.
        start: usize,
        /// Training rows.
        training_rows: usize,
    },
    /// Too few episodes begin after the training rows, or too short ones.
    #[error(
        "{}: {rows} held-out rows from at least {min_episodes} episodes were asked for; \
         {episodes} episodes with {available} rows begin at or after row {training_rows}, \
         where the training rows end",
        path.display()
    )]
    TooFewHeldOut {
        /// The file.
        path: PathBuf,
        /// Rows asked for.
        rows: usize,
        /// Episodes asked for.
        min_episodes: usize,
        /// Episodes that there are.
        episodes: usize,
        /// Rows in them.
        available: usize,
        /// Training rows.
        training_rows: usize,
    },
}

/// "nothing", or the first few names.
fn list(names: &[String]) -> String {
    const SHOWN: usize = 12;
    match names {
        [] => "nothing".to_owned(),
        names if names.len() <= SHOWN => names.join(", "),
        names => format!("{} and {} more", names[..SHOWN].join(", "), names.len() - SHOWN),
    }
}

/// " (or 105 or 111)", or nothing.
fn or(also: &[usize]) -> String {
    match also {
        [] => String::new(),
        also => {
            let also: Vec<String> = also.iter().map(ToString::to_string).collect();
            format!(" (or {})", also.join(" or "))
        }
    }
}
