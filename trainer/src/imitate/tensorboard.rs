//! Event files for TensorBoard.
//!
//! A file is a row of TFRecords: length, masked CRC-32C of the length, an `Event` message, masked
//! CRC-32C of the message. Only scalars are written.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use prost::Message;

use crate::error::ClientError;

/// What TensorBoard calls this layout of files.
const FILE_VERSION: &str = "brain.Event:2";
/// The name's beginning is how TensorBoard knows its files; one file a folder is all we need.
const FILE: &str = "events.out.tfevents.palr-gym";

/// `tensorflow.Event`, as far as we use it.
#[derive(Clone, PartialEq, Message)]
struct Event {
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(oneof = "What", tags = "3, 5")]
    what: Option<What>,
}

#[derive(Clone, PartialEq, prost::Oneof)]
enum What {
    #[prost(string, tag = "3")]
    FileVersion(String),
    #[prost(message, tag = "5")]
    Summary(Summary),
}

/// `tensorflow.Summary`.
#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    values: Vec<Value>,
}

/// `tensorflow.Summary.Value`.
#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, tag = "2")]
    simple_value: f32,
}

/// An event file that is being written.
pub struct EventFile {
    path: PathBuf,
    file: BufWriter<File>,
}

impl EventFile {
    /// Starts the file of `folder` anew.
    ///
    /// # Errors
    /// [`ClientError::File`].
    pub fn create(folder: &Path) -> Result<Self, ClientError> {
        fs::create_dir_all(folder).map_err(|error| ClientError::file(folder, error))?;
        let path = folder.join(FILE);
        let file = File::create(&path).map_err(|error| ClientError::file(&path, error))?;
        let mut file = Self { path, file: BufWriter::new(file) };
        file.event(0, What::FileVersion(FILE_VERSION.to_owned()))?;
        Ok(file)
    }

    /// Adds the values of one step, each with its name. A crash of the machine may cost the last.
    ///
    /// # Errors
    /// [`ClientError::File`].
    pub fn write(
        &mut self,
        step: u64,
        scalars: &[(impl AsRef<str>, f64)],
    ) -> Result<(), ClientError> {
        let values = scalars
            .iter()
            .map(|(tag, value)| Value { tag: tag.as_ref().to_owned(), simple_value: *value as f32 })
            .collect();
        self.event(step, What::Summary(Summary { values }))
    }

    fn event(&mut self, step: u64, what: What) -> Result<(), ClientError> {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let step = i64::try_from(step).unwrap_or(i64::MAX);
        let event = Event { wall_time: since.as_secs_f64(), step, what: Some(what) };
        let written = self.file.write_all(&record(&event.encode_to_vec()));
        written
            .and_then(|()| self.file.flush())
            .map_err(|error| ClientError::file(&self.path, error))
    }
}

fn record(message: &[u8]) -> Vec<u8> {
    let length = (message.len() as u64).to_le_bytes();
    let mut record = Vec::with_capacity(message.len() + 16);
    record.extend(length);
    record.extend(masked_checksum(&length).to_le_bytes());
    record.extend(message);
    record.extend(masked_checksum(message).to_le_bytes());
    record
}

/// TensorFlow's way of keeping a checksum of bytes that hold checksums apart from theirs.
fn masked_checksum(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}
