//! How features come into observations, and what happens where there are none. What pictures show
//! is tested where they are drawn, and models where they are run.

use std::sync::atomic::{AtomicBool, Ordering};

use palr_gym_core::{AutoresetMode, OutOfBounds};

use super::*;
use crate::divergence::Divergence;
use crate::render::RenderError;
use crate::tasks::resolve;
use crate::threads::{SimulationThreads, before_exit};
use crate::vector::{StepFrame, VectorEnv, VectorOptions};

/// Means of red, green and blue, unless it is blind.
#[derive(Debug, Default)]
struct Means {
    is_blind: AtomicBool,
}

impl FeatureExtractor for Means {
    fn picture_size_px(&self) -> (u32, u32) {
        (16, 24)
    }

    fn size(&self) -> usize {
        3
    }

    fn crc(&self) -> u32 {
        7
    }

    fn extract(
        &self,
        pictures: &[u8],
        count: usize,
        features: &mut Vec<f32>,
    ) -> Result<(), ExtractorError> {
        if self.is_blind.load(Ordering::Relaxed) {
            return Err(ExtractorError { message: "blind".into() });
        }
        assert_eq!(pictures.len(), count * 16 * 24 * 3);
        features.clear();
        for picture in pictures.chunks_exact(16 * 24 * 3) {
            for channel in 0..3 {
                let plane = picture.iter().skip(channel).step_by(3);
                features.push(plane.map(|&value| f32::from(value)).sum::<f32>() / (16.0 * 24.0));
            }
        }
        Ok(())
    }
}

/// Environments that draw. The threads that drew have ended when it is gone: one that frees its OpenGL
/// context while the test's process exits crashes.
struct Drawing {
    vector: VectorEnv,
    /// Dropped last.
    _ending: Ending,
}

struct Ending;

impl Drop for Ending {
    fn drop(&mut self) {
        before_exit();
    }
}

impl std::ops::Deref for Drawing {
    type Target = VectorEnv;

    fn deref(&self) -> &VectorEnv {
        &self.vector
    }
}

impl std::ops::DerefMut for Drawing {
    fn deref_mut(&mut self) -> &mut VectorEnv {
        &mut self.vector
    }
}

fn vector(
    env_id: &str,
    num_envs: usize,
    threads: usize,
    autoreset_mode: AutoresetMode,
    extractor: &Arc<Means>,
) -> Drawing {
    let (task, spec) = resolve(env_id).unwrap();
    let extractor = Arc::clone(extractor);
    let sight = Sight { extractor: Some(extractor), ..Sight::default() };
    let spec = sight.fit(spec).unwrap();
    let options = VectorOptions { autoreset_mode, out_of_bounds: OutOfBounds::Reject };
    let threads = SimulationThreads::start(threads).unwrap();
    let vector = VectorEnv::seeing(task, spec, num_envs, options, threads, sight).unwrap();
    Drawing { vector, _ending: Ending }
}

/// True on a machine without OpenGL, where these tests have nothing to test. They say so.
fn cannot_draw() -> bool {
    let mut one = vector("lane-w1", 1, 1, AutoresetMode::NextStep, &Arc::default());
    match one.reset(&[0], &[]) {
        Err(error @ SimError::Render(RenderError::NoGl { .. })) => {
            eprintln!("SKIPPED: {error}");
            true
        }
        done => {
            done.unwrap();
            false
        }
    }
}

#[test]
fn features_are_the_same_whatever_the_number_of_threads_and_environments() {
    if cannot_draw() {
        return;
    }
    let play = |num_envs: usize, threads: usize| {
        let mut vector =
            vector("lane-w2", num_envs, threads, AutoresetMode::SameStep, &Arc::default());
        vector.reset(&[4], &[]).unwrap();
        let mut frame = StepFrame::default();
        let mut seen = Vec::new();
        vector.observations_into(&mut seen);
        let mut seen = seen[..6].to_vec();
        for _ in 0..40 {
            vector.step(&vec![1.0; 2 * num_envs], &mut frame).unwrap();
            seen.extend_from_slice(&frame.observations[..6]);
            if frame.terminated[0] {
                seen.extend_from_slice(&frame.final_observations[..6]);
            }
        }
        seen
    };
    let alone = play(1, 1);
    // Zeros before the first frame, and means of bytes from there on.
    assert_eq!(alone[..3], [0.0; 3]);
    assert!(alone[3..6].iter().all(|mean| (1.0..255.0).contains(mean)), "{:?}", &alone[3..6]);
    assert_eq!(alone[3..6], alone[6..9], "the older frame of the next step");
    assert_eq!(play(5, 1), alone);
    assert_eq!(play(7, 3), alone);
}

#[test]
fn an_episode_of_which_nothing_is_seen_is_truncated_and_the_next_begins() {
    if cannot_draw() {
        return;
    }
    let means = Arc::new(Means::default());
    let mut vector = vector("lane-w1", 3, 2, AutoresetMode::NextStep, &means);
    vector.reset(&[0], &[]).unwrap();
    let mut before = Vec::new();
    vector.observations_into(&mut before);
    let mut frame = StepFrame::default();
    means.is_blind.store(true, Ordering::Relaxed);
    vector.step(&[0.5; 6], &mut frame).unwrap();
    assert_eq!(frame.truncated, [true; 3]);
    assert_eq!(frame.terminated, [false; 3]);
    assert_eq!(frame.rewards, [0.0; 3]);
    assert!(frame.info.iter().all(|value| value.is_nan()));
    assert_eq!(frame.observations, before, "those of the step before");
    let reasons: Vec<_> =
        frame.diverged.iter().map(|diverged| (diverged.env_index, diverged.divergence)).collect();
    assert_eq!(reasons, [0, 1, 2].map(|index| (index, Divergence::Unseen)));
    means.is_blind.store(false, Ordering::Relaxed);
    vector.step(&[0.5; 6], &mut frame).unwrap();
    assert_eq!(frame.truncated, [false; 3]);
    assert!(frame.diverged.is_empty());
    assert_ne!(frame.observations, before);
    means.is_blind.store(true, Ordering::Relaxed);
    let error = vector.reset(&[0], &[]).unwrap_err();
    assert_eq!(error.to_string(), "no features of the agent's picture: blind");
}

#[test]
fn a_snapshot_of_other_features_is_refused() {
    let means = Arc::default();
    let mut vector = vector("lane-w1", 1, 1, AutoresetMode::NextStep, &means);
    let snapshot = vector.snapshot(0);
    let mut snapshot = crate::Snapshot::parse(&snapshot).unwrap();
    vector.restore(&snapshot).unwrap();
    // What an extractor with another CRC would have written.
    snapshot.scene_crc ^= 7 ^ 8;
    let error = vector.restore(&snapshot).unwrap_err().to_string();
    assert!(error.contains("the snapshot's scene is"), "{error}");
}

#[test]
fn features_without_an_extractor_are_an_error_and_pixels_need_none() {
    let (_, spec) = resolve("lane-w1").unwrap();
    let error = Sight::default().fit(spec).unwrap_err().to_string();
    assert!(error.contains("there is no feature extractor"), "{error}");
    let (_, spec) = resolve("lane-pixels-w3").unwrap();
    let spec = Sight::default().fit(spec).unwrap();
    assert_eq!(spec.observation_shape(), [144, 48, 3]);
    assert_eq!(spec.observation_size(), 144 * 48 * 3);
    let error = resolve("lane-strict").err().unwrap().to_string();
    assert!(error.contains("-full or -paper or -pixels"), "{error}");
}
