//! The contract: what a model's metadata say of its pictures.
//!
//! | key | value |
//! |---|---|
//! | `palr_gym.contract` | `image-features-1` |
//! | `palr_gym.name` | what the model is |
//! | `palr_gym.size` | height and width of its pictures, in pixels |
//! | `palr_gym.scale` | input = (pixel · scale - mean) / std, pixels within 0 to 255 |
//! | `palr_gym.mean` | of red, green and blue |
//! | `palr_gym.std` | of red, green and blue, each above 0 |
//!
//! The graph has one input, float32 `[N, 3, height, width]` with N free, and one output, float32
//! `[N, D]`. Several numbers in a value are separated by spaces.

use std::collections::BTreeMap;

use crate::error::VisionError;

/// The largest side of a picture.
pub const MAX_SIDE_PX: u64 = 1024;
/// Red, green and blue.
pub const CHANNELS: usize = 3;

const CONTRACT: &str = "image-features-1";
/// Values of a pixel's channel.
const LEVELS: usize = 256;

/// What lies between pixels and a model's input.
#[derive(Debug, Clone, PartialEq)]
pub struct Preprocessing {
    /// What the model is.
    pub name: String,
    /// Pixels down.
    pub height_px: u32,
    /// Pixels across.
    pub width_px: u32,
    /// `[3][256]`: the input that each value of each channel becomes.
    table: Vec<f32>,
}

impl Preprocessing {
    /// Reads a model's metadata.
    ///
    /// # Errors
    /// [`VisionError::Metadata`] or [`VisionError::Size`].
    pub fn read(metadata: &BTreeMap<String, String>) -> Result<Self, VisionError> {
        let get = |key: &'static str, want: &'static str| {
            let missing = || VisionError::Metadata { key, got: "nothing".into(), want };
            metadata.get(key).map(String::as_str).ok_or_else(missing)
        };
        let want = CONTRACT;
        let got = get("palr_gym.contract", want)?;
        if got != CONTRACT {
            return Err(VisionError::Metadata { key: "palr_gym.contract", got: quoted(got), want });
        }
        let name = get("palr_gym.name", "what the model is")?.to_owned();
        let want = "two whole numbers, height and width";
        let text = get("palr_gym.size", want)?;
        let [height_px, width_px] = numbers::<u64, 2>(text).ok_or_else(|| {
            VisionError::Metadata { key: "palr_gym.size", got: quoted(text), want }
        })?;
        if [height_px, width_px].iter().any(|side| !(1..=MAX_SIDE_PX).contains(side)) {
            return Err(VisionError::Size { height_px, width_px });
        }
        let finite = |key, want, is_good: fn(f64) -> bool| {
            let text = get(key, want)?;
            numbers::<f64, CHANNELS>(text)
                .filter(|values| values.iter().all(|&value| value.is_finite() && is_good(value)))
                .ok_or_else(|| VisionError::Metadata { key, got: quoted(text), want })
        };
        let want = "a number above 0";
        let text = get("palr_gym.scale", want)?;
        let [scale] = numbers::<f64, 1>(text)
            .filter(|[scale]| scale.is_finite() && *scale > 0.0)
            .ok_or_else(|| VisionError::Metadata {
            key: "palr_gym.scale",
            got: quoted(text),
            want,
        })?;
        let mean = finite("palr_gym.mean", "three numbers", |_| true)?;
        let std = finite("palr_gym.std", "three numbers above 0", |value| value > 0.0)?;
        let table = mean
            .iter()
            .zip(std)
            .flat_map(|(mean, std)| {
                (0..LEVELS).map(move |level| ((level as f64 * scale - mean) / std) as f32)
            })
            .collect();
        Ok(Self { name, height_px: height_px as u32, width_px: width_px as u32, table })
    }

    /// Pixels of a picture.
    #[must_use]
    pub fn area(&self) -> usize {
        self.height_px as usize * self.width_px as usize
    }

    /// Replaces `input` by `pictures`, `[count, height, width, 3]`, as the model wants them:
    /// `[count, 3, height, width]`.
    pub fn apply(&self, pictures: &[u8], input: &mut Vec<f32>) {
        input.clear();
        input.reserve(pictures.len());
        for picture in pictures.chunks_exact(CHANNELS * self.area()) {
            for (channel, table) in self.table.chunks_exact(LEVELS).enumerate() {
                let plane = picture.iter().skip(channel).step_by(CHANNELS);
                input.extend(plane.map(|&level| table[usize::from(level)]));
            }
        }
    }
}

/// As much of a stranger's text as is worth quoting.
fn quoted(text: &str) -> String {
    format!("{:?}", text.chars().take(64).collect::<String>())
}

/// Exactly N numbers.
fn numbers<T: std::str::FromStr, const N: usize>(text: &str) -> Option<[T; N]> {
    let values: Option<Vec<T>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    values?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metadata(changes: &[(&str, Option<&str>)]) -> BTreeMap<String, String> {
        let mut metadata: BTreeMap<String, String> = [
            ("palr_gym.contract", "image-features-1"),
            ("palr_gym.name", "test"),
            ("palr_gym.size", "2 3"),
            ("palr_gym.scale", "0.00392156862745098"),
            ("palr_gym.mean", "0.485 0.456 0.406"),
            ("palr_gym.std", "0.229 0.224 0.225"),
        ]
        .map(|(key, value)| (key.to_owned(), value.to_owned()))
        .into();
        for (key, value) in changes {
            match value {
                Some(value) => metadata.insert((*key).to_owned(), (*value).to_owned()),
                None => metadata.remove(*key),
            };
        }
        metadata
    }

    #[test]
    fn pixels_become_what_torchvision_makes_of_them() {
        let preprocessing = Preprocessing::read(&metadata(&[])).unwrap();
        let picture: Vec<u8> = (0..18).map(|value| value * 14).collect();
        let mut input = Vec::new();
        preprocessing.apply(&picture, &mut input);
        // ToTensor, then Normalize, in float64.
        let (mean, std) = ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]);
        for channel in 0..3 {
            for pixel in 0..6 {
                let unit = f64::from(picture[pixel * 3 + channel]) / 255.0;
                let expected = (unit - mean[channel]) / std[channel];
                assert!((f64::from(input[channel * 6 + pixel]) - expected).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn metadata_that_make_no_sense_are_refused_with_what_was_wanted() {
        for (key, value, expected) in [
            ("palr_gym.contract", None, "palr_gym.contract = nothing; expected image-features-1"),
            ("palr_gym.contract", Some("image-features-9"), "= \"image-features-9\"; expected"),
            ("palr_gym.name", None, "palr_gym.name = nothing"),
            ("palr_gym.size", Some("48"), "= \"48\"; expected two whole numbers, height and width"),
            ("palr_gym.size", Some("0 48"), "pictures of 0 x 48 pixels"),
            (
                "palr_gym.size",
                Some("48 10000"),
                "48 x 10000 pixels (height x width); expected 1 to",
            ),
            ("palr_gym.scale", Some("0"), "palr_gym.scale = \"0\"; expected a number above 0"),
            ("palr_gym.mean", Some("0 0 NaN"), "= \"0 0 NaN\"; expected three numbers"),
            ("palr_gym.std", Some("1 0 1"), "= \"1 0 1\"; expected three numbers above 0"),
        ] {
            let error = Preprocessing::read(&metadata(&[(key, value)])).unwrap_err().to_string();
            assert!(error.contains(expected), "{key}: {error}");
        }
    }
}
