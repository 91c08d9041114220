//! The state of a vector of environments as bytes, and back.
//!
//! Layout (little-endian): magic, version and CRC-32 of all that follows; then what the snapshot is
//! of (environment, scene, MuJoCo version, options, number of environments); then, environment by
//! environment, a fixed number of bytes. Everything is checked before anything is changed, and
//! nothing is allocated on the word of the bytes alone, so they may come from anywhere.

use palr_gym_core::{AutoresetMode, OutOfBounds, SceneOptions, WeatherMode};

use crate::mujoco_log::mujoco_version;
use crate::vector::VectorOptions;

const MAGIC: [u8; 8] = *b"PALRSNAP";
/// Changes with every change of the layout.
const VERSION: u32 = 4;

/// Why bytes are no snapshot, or not one of this vector.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SnapshotError {
    /// Other bytes altogether.
    #[error("these {len} bytes are no snapshot of palr-gym")]
    NotASnapshot {
        /// How many there are.
        len: usize,
    },
    /// Another layout.
    #[error("the snapshot has version {got}; this build reads version {VERSION}")]
    Version {
        /// The version found.
        got: u32,
    },
    /// Some bytes changed on the way.
    #[error("the snapshot is damaged: its checksum is wrong")]
    Checksum,
    /// Too few or too many bytes, or a value that cannot be.
    #[error("the snapshot is malformed: {field} is {got}; expected {want}")]
    Malformed {
        /// Which value.
        field: &'static str,
        /// What it is.
        got: String,
        /// What it should be.
        want: String,
    },
    /// A good snapshot of something else.
    #[error("the snapshot's {what} is {got}; expected {want}")]
    Mismatch {
        /// What differs.
        what: &'static str,
        /// The snapshot's.
        got: String,
        /// Ours.
        want: String,
    },
}

/// A snapshot's head, and its environments still as bytes.
#[derive(Debug, Clone)]
pub struct Snapshot<'a> {
    /// Canonical id.
    pub env_id: &'a str,
    /// Number of environments, each of which has its bytes in the snapshot.
    pub num_envs: usize,
    /// How ends and actions are treated.
    pub options: VectorOptions,
    /// What was chosen about the scene.
    pub scene: SceneOptions,
    /// A byte of the caller's own.
    pub tag: u8,
    /// False: the environments were never reset.
    pub was_reset: bool,
    pub(crate) scene_crc: u32,
    /// The environments, one after the other, all of the same length.
    pub(crate) envs: &'a [u8],
}

impl<'a> Snapshot<'a> {
    /// Reads the head of a snapshot.
    ///
    /// # Errors
    /// Any [`SnapshotError`]; a mismatch here is one of MuJoCo's version.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, SnapshotError> {
        let len = bytes.len();
        let mut reader = Reader { rest: bytes };
        if reader.take("magic", MAGIC.len()).ok() != Some(&MAGIC[..]) {
            return Err(SnapshotError::NotASnapshot { len });
        }
        let got = reader.u32("version")?;
        if got != VERSION {
            return Err(SnapshotError::Version { got });
        }
        if reader.u32("checksum")? != crc32fast::hash(reader.rest) {
            return Err(SnapshotError::Checksum);
        }
        let got = reader.text("mujoco_version")?;
        if got != mujoco_version() {
            return Err(SnapshotError::Mismatch {
                what: "MuJoCo version",
                got: format!("{got:?}"),
                want: format!("{:?}", mujoco_version()),
            });
        }
        let env_id = reader.text("env_id")?;
        let scene_crc = reader.u32("scene")?;
        let options = VectorOptions {
            autoreset_mode: match reader.byte("autoreset_mode")? {
                0 => AutoresetMode::NextStep,
                1 => AutoresetMode::SameStep,
                2 => AutoresetMode::Disabled,
                got => return Err(malformed("autoreset_mode", got, "0 to 2")),
            },
            out_of_bounds: match reader.byte("out_of_bounds")? {
                0 => OutOfBounds::Reject,
                1 => OutOfBounds::Clip,
                2 => OutOfBounds::Raw,
                got => return Err(malformed("out_of_bounds", got, "0 to 2")),
            },
        };
        let [lead_car_probability] = reader.f64_array("lead_car_probability")?;
        let vehicles = reader.u32("vehicles")?;
        let weather = match reader.byte("weather")? {
            0 => WeatherMode::Fixed,
            1 => WeatherMode::Random,
            got => return Err(malformed("weather", got, "0 or 1")),
        };
        let scene = SceneOptions { lead_car_probability, vehicles, weather };
        scene
            .validate()
            .map_err(|error| malformed("scene options", error, "values within range"))?;
        let tag = reader.byte("tag")?;
        let was_reset = reader.flag("was_reset")?;
        let num_envs = reader.u32("num_envs")? as usize;
        let envs = reader.rest;
        if num_envs == 0 || envs.is_empty() || !envs.len().is_multiple_of(num_envs) {
            let want = "as many bytes as environments take";
            return Err(malformed("length", format!("{} bytes", envs.len()), want));
        }
        Ok(Self { env_id, num_envs, options, scene, tag, was_reset, scene_crc, envs })
    }

    /// The head of a snapshot as bytes, to which the environments are to be appended, and then
    /// [`seal`] put on it.
    pub(crate) fn head(&self) -> Vec<u8> {
        let mut writer = Writer { bytes: Vec::new() };
        writer.bytes.extend_from_slice(&MAGIC);
        writer.u32(VERSION);
        writer.u32(0);
        writer.text(mujoco_version());
        writer.text(self.env_id);
        writer.u32(self.scene_crc);
        writer.bytes.push(match self.options.autoreset_mode {
            AutoresetMode::NextStep => 0,
            AutoresetMode::SameStep => 1,
            AutoresetMode::Disabled => 2,
        });
        writer.bytes.push(match self.options.out_of_bounds {
            OutOfBounds::Reject => 0,
            OutOfBounds::Clip => 1,
            OutOfBounds::Raw => 2,
        });
        writer.f64s(&[self.scene.lead_car_probability]);
        writer.u32(self.scene.vehicles);
        writer.bytes.push(match self.scene.weather {
            WeatherMode::Fixed => 0,
            WeatherMode::Random => 1,
        });
        writer.bytes.push(self.tag);
        writer.bytes.push(u8::from(self.was_reset));
        writer.u32(self.num_envs as u32);
        writer.bytes
    }
}

/// Writes the checksum of a finished snapshot.
pub(crate) fn seal(bytes: &mut [u8]) {
    let begin = MAGIC.len() + 2 * size_of::<u32>();
    let checksum = crc32fast::hash(&bytes[begin..]);
    bytes[begin - size_of::<u32>()..begin].copy_from_slice(&checksum.to_le_bytes());
}

pub(crate) fn malformed(
    field: &'static str,
    got: impl ToString,
    want: impl ToString,
) -> SnapshotError {
    SnapshotError::Malformed { field, got: got.to_string(), want: want.to_string() }
}

/// Values to bytes.
pub(crate) struct Writer {
    pub(crate) bytes: Vec<u8>,
}

impl Writer {
    pub(crate) fn u32(&mut self, value: u32) {
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    pub(crate) fn u128(&mut self, value: u128) {
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    pub(crate) fn f64s(&mut self, values: &[f64]) {
        for value in values {
            self.bytes.extend_from_slice(&value.to_le_bytes());
        }
    }

    fn text(&mut self, text: &str) {
        // Ids and versions are short.
        self.bytes.push(text.len() as u8);
        self.bytes.extend_from_slice(text.as_bytes());
    }
}

/// Bytes to values, never beyond their end.
pub(crate) struct Reader<'a> {
    pub(crate) rest: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, field: &'static str, count: usize) -> Result<&'a [u8], SnapshotError> {
        let (taken, rest) = self
            .rest
            .split_at_checked(count)
            .ok_or_else(|| malformed(field, "cut off", format!("{count} bytes")))?;
        self.rest = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], SnapshotError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(field, N)?);
        Ok(array)
    }

    pub(crate) fn byte(&mut self, field: &'static str) -> Result<u8, SnapshotError> {
        self.array::<1>(field).map(|[byte]| byte)
    }

    pub(crate) fn flag(&mut self, field: &'static str) -> Result<bool, SnapshotError> {
        match self.byte(field)? {
            0 => Ok(false),
            1 => Ok(true),
            got => Err(malformed(field, got, "0 or 1")),
        }
    }

    pub(crate) fn u32(&mut self, field: &'static str) -> Result<u32, SnapshotError> {
        self.array(field).map(u32::from_le_bytes)
    }

    pub(crate) fn u128(&mut self, field: &'static str) -> Result<u128, SnapshotError> {
        self.array(field).map(u128::from_le_bytes)
    }

    /// Fills `values`.
    pub(crate) fn f64s(
        &mut self,
        field: &'static str,
        values: &mut [f64],
    ) -> Result<(), SnapshotError> {
        let bytes = self.take(field, size_of_val(values))?;
        let (chunks, _) = bytes.as_chunks();
        for (value, chunk) in values.iter_mut().zip(chunks) {
            *value = f64::from_le_bytes(*chunk);
        }
        Ok(())
    }

    fn f64_array<const N: usize>(
        &mut self,
        field: &'static str,
    ) -> Result<[f64; N], SnapshotError> {
        let mut values = [0.0; N];
        self.f64s(field, &mut values)?;
        Ok(values)
    }

    fn text(&mut self, field: &'static str) -> Result<&'a str, SnapshotError> {
        let len = usize::from(self.byte(field)?);
        let bytes = self.take(field, len)?;
        std::str::from_utf8(bytes).map_err(|_| malformed(field, "no UTF-8", "text"))
    }
}

#[cfg(test)]
mod tests;
