//! What agents see: the feature extractor, loaded when it is first needed, and the OpenGL that draws
//! for it.

use std::sync::{Arc, OnceLock};

use palr_gym_core::{EnvSpec, ObservationKind, SceneOptions};
use palr_gym_sim::render::GlChoice;
use palr_gym_sim::{ExtractorError, FeatureExtractor, Sight, Task, resolve_scene};
use palr_gym_vision::{Extractor, ExtractorLimits, VisionError};

use crate::error::ServerError;

/// The extractor that ships with the server; `scenes/features/README.md` describes it.
pub const SHIPPED_EXTRACTOR: &[u8] =
    include_bytes!("../../scenes/features/lane-compact-resnet.onnx");

/// An extractor as the simulation knows it.
#[derive(Debug)]
struct Eyes(Arc<Extractor>);

impl FeatureExtractor for Eyes {
    fn picture_size_px(&self) -> (u32, u32) {
        self.0.picture_size_px()
    }

    fn size(&self) -> usize {
        self.0.size()
    }

    fn crc(&self) -> u32 {
        self.0.crc()
    }

    fn extract(
        &self,
        pictures: &[u8],
        count: usize,
        features: &mut Vec<f32>,
    ) -> Result<(), ExtractorError> {
        let extracted = self.0.extract(pictures, count, features);
        extracted.map_err(|error| ExtractorError { message: error.to_string() })
    }
}

/// What agents see.
#[derive(Debug)]
pub struct Vision {
    gl: GlChoice,
    /// Chosen by the operator; else the shipped one.
    chosen: Option<Arc<Extractor>>,
    shipped: OnceLock<Result<Arc<Extractor>, VisionError>>,
}

impl Vision {
    /// Draws with `gl`; the shipped extractor is used unless another is `chosen`.
    #[must_use]
    pub fn new(gl: GlChoice, chosen: Option<Arc<Extractor>>) -> Self {
        Self { gl, chosen, shipped: OnceLock::new() }
    }

    /// The extractor of this server.
    ///
    /// # Errors
    /// [`ServerError::Vision`].
    pub fn extractor(&self) -> Result<&Arc<Extractor>, ServerError> {
        if let Some(chosen) = &self.chosen {
            return Ok(chosen);
        }
        let load = || Extractor::load(SHIPPED_EXTRACTOR, ExtractorLimits::default()).map(Arc::new);
        Ok(self.shipped.get_or_init(load).as_ref().map_err(Clone::clone)?)
    }

    /// The task and environment that an id names, with what it takes to see them.
    ///
    /// # Errors
    /// As by [`resolve_scene`], or [`ServerError::Vision`].
    pub fn resolve(
        &self,
        env_id: &str,
        scene: Option<SceneOptions>,
    ) -> Result<(&'static dyn Task, EnvSpec, Sight), ServerError> {
        let (task, spec) = resolve_scene(env_id, scene)?;
        let mut sight = Sight { gl: self.gl, extractor: None };
        if matches!(spec.observation, ObservationKind::Features { .. }) {
            sight.extractor = Some(Arc::new(Eyes(Arc::clone(self.extractor()?))));
        }
        let spec = sight.fit(spec)?;
        Ok((task, spec, sight))
    }

    /// The extractor, if `spec` shows features.
    #[must_use]
    pub fn extractor_of(&self, spec: &EnvSpec) -> Option<&Extractor> {
        match spec.observation {
            // Whoever has such a spec has loaded it.
            ObservationKind::Features { .. } => self.extractor().ok().map(Arc::as_ref),
            ObservationKind::State | ObservationKind::Pixels => None,
        }
    }
}
