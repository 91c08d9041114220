//! What an agent sees of a scene where it sees pictures: drawn with which OpenGL, and made into
//! features by whom.
//!
//! Models are not run here: a [`FeatureExtractor`] comes from outside.

use std::fmt::Debug;
use std::sync::Arc;

use palr_gym_core::spec::PIXELS_SIDE;
use palr_gym_core::{EnvSpec, ObservationKind};

use crate::env::Env;
use crate::error::SimError;
use crate::render::GlChoice;

/// Pictures of which features are asked for at once.
const MAX_BATCH: usize = 32;

/// Makes features of pictures.
///
/// Features of a picture must not depend, in any bit, on which other pictures come with it: how
/// environments are spread over threads would show.
pub trait FeatureExtractor: Debug + Send + Sync {
    /// Height and width of the pictures that it wants.
    fn picture_size_px(&self) -> (u32, u32);

    /// Features of a picture.
    fn size(&self) -> usize;

    /// Tells extractors apart in snapshots.
    fn crc(&self) -> u32;

    /// Replaces `features` by those of `count` pictures, `[count, height, width, 3]`:
    /// `[count, size]`, finite.
    ///
    /// # Errors
    /// [`ExtractorError`]; nothing can be said of `features` then.
    fn extract(
        &self,
        pictures: &[u8],
        count: usize,
        features: &mut Vec<f32>,
    ) -> Result<(), ExtractorError>;
}

/// Why there are no features.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no features of the agent's picture: {message}")]
pub struct ExtractorError {
    /// What went wrong.
    pub message: String,
}

/// How pictures become observations.
#[derive(Debug, Clone, Default)]
pub struct Sight {
    /// With what they are drawn.
    pub gl: GlChoice,
    /// Makes features of them, if features are wanted.
    pub extractor: Option<Arc<dyn FeatureExtractor>>,
}

impl Sight {
    /// `spec` with the number of features that the extractor makes.
    ///
    /// # Errors
    /// [`SimError::Extractor`] if features are wanted and there is no extractor.
    pub fn fit(&self, mut spec: EnvSpec) -> Result<EnvSpec, SimError> {
        if let ObservationKind::Features { size } = &mut spec.observation {
            *size = self.extractor()?.size();
        }
        Ok(spec)
    }

    /// The extractor.
    ///
    /// # Errors
    /// [`SimError::Extractor`] if there is none.
    pub(crate) fn extractor(&self) -> Result<&dyn FeatureExtractor, ExtractorError> {
        let missing = || ExtractorError { message: "there is no feature extractor".into() };
        self.extractor.as_deref().ok_or_else(missing)
    }

    /// Height and width of the agent's picture.
    pub(crate) fn picture_size_px(&self, spec: &EnvSpec) -> Result<(u32, u32), ExtractorError> {
        match spec.observation {
            ObservationKind::Features { .. } => Ok(self.extractor()?.picture_size_px()),
            ObservationKind::State | ObservationKind::Pixels => {
                Ok((PIXELS_SIDE as u32, PIXELS_SIDE as u32))
            }
        }
    }

    /// What of it shows in the observations of `spec`.
    pub(crate) fn crc(&self, spec: &EnvSpec) -> u32 {
        match (spec.observation, &self.extractor) {
            (ObservationKind::Features { .. }, Some(extractor)) => extractor.crc(),
            _ => 0,
        }
    }
}

/// Sees for several environments at once: what a thread steps together, it looks at together.
#[derive(Debug, Default)]
pub struct Onlooker {
    /// Pictures whose features are asked for, and these.
    pictures: Vec<u8>,
    features: Vec<f32>,
}

impl Onlooker {
    /// How many of `num_envs` environments one of `threads` threads best looks at together: each
    /// has a share.
    #[must_use]
    pub fn share(num_envs: usize, threads: usize) -> usize {
        num_envs.div_ceil(threads.max(1)).clamp(1, MAX_BATCH)
    }

    /// Brings the features of all new pictures into the stacks of environments that leave that to
    /// others ([`Env::leave_features`]). `unseen` hears of those of whose picture there are none:
    /// their episode is over.
    pub fn see<T>(
        &mut self,
        places: &mut [T],
        env: impl Fn(&mut T) -> &mut Env,
        mut unseen: impl FnMut(usize, &mut T, &ExtractorError),
    ) -> Option<ExtractorError> {
        let Self { pictures, features } = self;
        pictures.clear();
        let mut count = 0;
        for place in &mut *places {
            if let Some(picture) = env(place).pending_picture() {
                pictures.extend_from_slice(picture);
                count += 1;
            }
        }
        if count == 0 {
            return None;
        }
        let together = env(places.first_mut()?).extract(pictures, count, features);
        let size = features.len() / count;
        let (mut row, mut failure) = (0, None);
        for (i, place) in places.iter_mut().enumerate() {
            let one = env(place);
            let Some(picture) = one.pending_picture() else { continue };
            if together.is_ok() {
                one.take_features(&features[row * size..(row + 1) * size]);
                row += 1;
                continue;
            }
            // One of them spoils the rest: who is it?
            match one.extract(picture, 1, features) {
                Ok(()) => one.take_features(features),
                Err(error) => {
                    one.unseen(&error);
                    one.forget_picture();
                    unseen(i, place, &error);
                    failure = Some(error);
                }
            }
        }
        failure
    }
}

#[cfg(test)]
mod tests;
