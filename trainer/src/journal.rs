//! Records on disk that survive a crash at any moment.
//!
//! A journal is a file of records, each with its length and checksum. What was appended before a
//! crash, a kill or a full disk is there afterwards; a record that was cut short is not, and the
//! file is truncated to the records before it.

use std::fs::{File, OpenOptions};
use std::io::{BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::error::ClientError;

/// First bytes of every journal; the digit is the format's version.
const MAGIC: &[u8; 8] = b"palrjnl1";
/// Length and checksum before each record.
const HEADER_BYTES: usize = 8;
/// Longer records are taken for damage.
const MAX_RECORD_BYTES: usize = 1 << 30;

/// A journal that is being appended to.
pub struct Journal {
    path: PathBuf,
    file: File,
    /// Bytes in whole records.
    length: u64,
}

/// The records of a journal, one after the other.
pub struct Records {
    reader: BufReader<File>,
    /// Bytes up to the end of the last whole record.
    good: u64,
}

impl Journal {
    /// Starts a journal; there must be none at `path`.
    ///
    /// # Errors
    /// [`ClientError::File`].
    pub fn create(path: &Path) -> Result<Self, ClientError> {
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(path)
            .map_err(|error| ClientError::file(path, error))?;
        let mut journal = Self { path: path.to_path_buf(), file, length: 0 };
        journal.write(MAGIC)?;
        Ok(journal)
    }

    /// Goes on with the journal at `path` after its last whole record, which `records` has
    /// reached.
    ///
    /// # Errors
    /// [`ClientError::File`].
    pub fn resume(path: &Path, records: &Records) -> Result<Self, ClientError> {
        let failed = |error| ClientError::file(path, error);
        let mut file = OpenOptions::new().write(true).open(path).map_err(failed)?;
        file.set_len(records.good).map_err(failed)?;
        file.seek(SeekFrom::End(0)).map_err(failed)?;
        Ok(Self { path: path.to_path_buf(), file, length: records.good })
    }

    /// Appends a record. If it fails, the journal holds what it held before.
    ///
    /// # Errors
    /// [`ClientError::File`].
    pub fn append(&mut self, record: &[u8]) -> Result<(), ClientError> {
        let mut bytes = Vec::with_capacity(HEADER_BYTES + record.len());
        bytes.extend((record.len() as u32).to_le_bytes());
        bytes.extend(crc32fast::hash(record).to_le_bytes());
        bytes.extend(record);
        self.write(&bytes)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), ClientError> {
        if let Err(error) = self.file.write_all(bytes) {
            // A torn record would be dropped on reading anyway; this frees its space at once.
            let _ = self.file.set_len(self.length);
            return Err(ClientError::file(&self.path, format!("cannot write: {error}")));
        }
        self.length += bytes.len() as u64;
        Ok(())
    }
}

impl Records {
    /// Opens the journal at `path`.
    ///
    /// # Errors
    /// [`ClientError::File`] if it cannot be read or is no journal.
    pub fn open(path: &Path) -> Result<Self, ClientError> {
        let failed = |error| ClientError::file(path, error);
        let mut reader = BufReader::new(File::open(path).map_err(failed)?);
        let mut magic = [0; MAGIC.len()];
        if reader.read_exact(&mut magic).is_err() || &magic != MAGIC {
            return Err(ClientError::file(
                path,
                "is no unfinished recording of this version; move it away or choose another name",
            ));
        }
        Ok(Self { reader, good: MAGIC.len() as u64 })
    }
}

impl Iterator for Records {
    type Item = Vec<u8>;

    /// Ends at the end of the file or at the first record that is not whole.
    fn next(&mut self) -> Option<Vec<u8>> {
        let mut word = [0; 4];
        self.reader.read_exact(&mut word).ok()?;
        let length = u32::from_le_bytes(word) as usize;
        self.reader.read_exact(&mut word).ok()?;
        let checksum = u32::from_le_bytes(word);
        if length > MAX_RECORD_BYTES {
            return None;
        }
        let mut record = Vec::new();
        // `take` keeps a wrong length from allocating more than the file holds.
        self.reader.by_ref().take(length as u64).read_to_end(&mut record).ok()?;
        if record.len() != length || crc32fast::hash(&record) != checksum {
            return None;
        }
        self.good += (HEADER_BYTES + length) as u64;
        Some(record)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_survive_a_cut_at_any_byte_and_go_on_from_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        let records: [&[u8]; 3] = [b"first", b"", b"a third, longer record"];
        let mut journal = Journal::create(&path).unwrap();
        for record in records {
            journal.append(record).unwrap();
        }
        drop(journal);
        let whole = std::fs::read(&path).unwrap();
        for cut in MAGIC.len()..=whole.len() {
            std::fs::write(&path, &whole[..cut]).unwrap();
            let mut reader = Records::open(&path).unwrap();
            let kept: Vec<_> = reader.by_ref().collect();
            assert!(records.iter().zip(&kept).all(|(a, b)| a == b));
            assert_eq!(kept.len() == 3, cut == whole.len());
            let mut journal = Journal::resume(&path, &reader).unwrap();
            journal.append(b"resumed").unwrap();
            let again: Vec<_> = Records::open(&path).unwrap().collect();
            assert_eq!(again.len(), kept.len() + 1);
            assert_eq!(again.last().unwrap(), b"resumed");
        }
    }

    #[test]
    fn damage_ends_the_records_before_it_and_foreign_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        let mut journal = Journal::create(&path).unwrap();
        journal.append(b"good").unwrap();
        journal.append(b"damaged").unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        let last = bytes.len() - 1;
        bytes[last] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(Records::open(&path).unwrap().collect::<Vec<_>>(), [b"good"]);
        std::fs::write(&path, b"something else").unwrap();
        assert!(
            Records::open(&path).err().unwrap().to_string().contains("no unfinished recording")
        );
        assert!(Journal::create(&path).is_err());
    }
}
