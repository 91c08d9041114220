//! A model under the contract, run on batches of pictures.

use std::fmt;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use palr_gym_onnx::model::describe;
use palr_gym_onnx::{Limits, Model, OnnxError};
use sha2::{Digest, Sha256};

use crate::contract::{CHANNELS, Preprocessing};
use crate::error::VisionError;

/// Pictures of the trial run: alone and in company they must have the same features.
const TRIAL: usize = 3;
/// Features of a picture at most.
const MAX_FEATURES: usize = 1 << 16;

/// How much an extractor may use.
#[derive(Debug, Clone, Copy)]
pub struct ExtractorLimits {
    /// Bytes of the model.
    pub max_bytes: usize,
    /// Wall-clock time of one inference.
    pub max_inference: Duration,
}

impl Default for ExtractorLimits {
    /// 256 MiB, for ResNets of any depth, and a minute.
    fn default() -> Self {
        Self { max_bytes: 256 << 20, max_inference: Duration::from_secs(60) }
    }
}

/// A feature extractor. Any number of threads may use it: each has a session of its own for as long
/// as it extracts, with one thread in it.
pub struct Extractor {
    file: Box<[u8]>,
    limits: Limits,
    preprocessing: Preprocessing,
    sha256: String,
    crc: u32,
    size: usize,
    output: String,
    /// Sessions that nobody uses now, with the room for their input.
    idle: Mutex<Vec<(Model, Vec<f32>)>>,
}

impl fmt::Debug for Extractor {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Extractor").field("name", &self.name()).finish_non_exhaustive()
    }
}

impl Extractor {
    /// Reads and loads a file.
    ///
    /// # Errors
    /// Any [`VisionError`].
    pub fn read(path: &Path, limits: ExtractorLimits) -> Result<Self, VisionError> {
        let file = std::fs::read(path).map_err(|error| VisionError::File {
            path: path.display().to_string(),
            message: error.to_string(),
        })?;
        Self::load(&file, limits)
    }

    /// Loads `file` and holds it to the contract, with a trial run.
    ///
    /// # Errors
    /// Any [`VisionError`].
    pub fn load(file: &[u8], limits: ExtractorLimits) -> Result<Self, VisionError> {
        let ExtractorLimits { max_bytes, max_inference } = limits;
        let limits = Limits { max_bytes, max_inference };
        let mut model = Model::open(file, limits)?;
        let preprocessing = Preprocessing::read(model.metadata())?;
        check_input(&model, &preprocessing)?;
        let [output] = &model.output_names()[..] else {
            let (got, want) = (model.output_names().join(", "), "one output".to_owned());
            return Err(OnnxError::Shape { what: "list of outputs".into(), got, want }.into());
        };
        let output = output.clone();
        // Noise: of a picture of one colour much is the same whatever the model does.
        let mut noise: u32 = 1;
        let pictures: Vec<u8> = std::iter::repeat_with(|| {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (noise >> 24) as u8
        })
        .take(TRIAL * CHANNELS * preprocessing.area())
        .collect();
        let mut input = Vec::new();
        preprocessing.apply(&pictures, &mut input);
        let shape = shape(&preprocessing, TRIAL);
        let (size, together) = model.run(&shape, &input, |outputs| {
            let size = outputs.columns(&output).filter(|size| (1..=MAX_FEATURES).contains(size));
            let size = size.ok_or_else(|| OnnxError::Shape {
                what: format!("output {output:?}"),
                got: "something else".into(),
                want: format!("float32 [N, D] with D of 1 to {MAX_FEATURES}"),
            })?;
            Ok((size, outputs.matrix(&output, TRIAL, size)?))
        })?;
        let extractor = Self {
            file: file.into(),
            limits,
            preprocessing,
            sha256: Sha256::digest(file).iter().map(|byte| format!("{byte:02x}")).collect(),
            crc: crc32fast::hash(file),
            size,
            output,
            idle: Mutex::new(vec![(model, input)]),
        };
        let mut alone = Vec::new();
        let pictures = pictures.chunks_exact(pictures.len() / TRIAL);
        for (picture, expected) in pictures.zip(together.chunks_exact(size)) {
            extractor.extract(picture, 1, &mut alone)?;
            let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect();
            let (got, want): (Vec<u32>, Vec<u32>) = (bits(&alone), bits(expected));
            if got != want {
                return Err(VisionError::Batch);
            }
        }
        // Extremes: what is not finite for them is no use.
        for level in [0, u8::MAX] {
            let picture = vec![level; CHANNELS * extractor.preprocessing.area()];
            extractor.extract(&picture, 1, &mut alone)?;
        }
        Ok(extractor)
    }

    /// What the model is.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.preprocessing.name
    }

    /// SHA-256 of the file, in hexadecimal.
    #[must_use]
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// CRC-32 of the file.
    #[must_use]
    pub fn crc(&self) -> u32 {
        self.crc
    }

    /// Features of a picture, D.
    #[must_use]
    pub fn size(&self) -> usize {
        self.size
    }

    /// Height and width of its pictures.
    #[must_use]
    pub fn picture_size_px(&self) -> (u32, u32) {
        (self.preprocessing.height_px, self.preprocessing.width_px)
    }

    /// Replaces `features` by those of `count` pictures, `[count, height, width, 3]`: `[count, D]`,
    /// all finite.
    ///
    /// # Errors
    /// [`VisionError::Pictures`] or [`VisionError::Model`].
    pub fn extract(
        &self,
        pictures: &[u8],
        count: usize,
        features: &mut Vec<f32>,
    ) -> Result<(), VisionError> {
        let want = count * CHANNELS * self.preprocessing.area();
        if count == 0 || pictures.len() != want {
            return Err(VisionError::Pictures { got: pictures.len(), count, want });
        }
        let idle = self.lock().pop();
        let (mut model, mut input) = match idle {
            Some(idle) => idle,
            None => (Model::open(&self.file, self.limits)?, Vec::new()),
        };
        self.preprocessing.apply(pictures, &mut input);
        let shape = shape(&self.preprocessing, count);
        let done =
            model.run(&shape, &input, |outputs| outputs.matrix(&self.output, count, self.size));
        self.lock().push((model, input));
        *features = done?;
        Ok(())
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<(Model, Vec<f32>)>> {
        // Nothing panics while it holds the lock.
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn shape(preprocessing: &Preprocessing, count: usize) -> [usize; 4] {
    let (height, width) = (preprocessing.height_px as usize, preprocessing.width_px as usize);
    [count, CHANNELS, height, width]
}

fn check_input(model: &Model, preprocessing: &Preprocessing) -> Result<(), OnnxError> {
    let Preprocessing { height_px, width_px, .. } = preprocessing;
    let want = format!("float32 [N, 3, {height_px}, {width_px}]");
    let wrong = |what: String, got: String| OnnxError::Shape { what, got, want: want.clone() };
    match model.inputs() {
        [input] if describe(input) == want => Ok(()),
        [input] => Err(wrong(format!("input {:?}", input.name()), describe(input))),
        inputs => Err(wrong("list of inputs".into(), format!("{} inputs", inputs.len()))),
    }
}

#[cfg(test)]
mod tests;
