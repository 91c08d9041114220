//! Environments that are light: what they show is who they are.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock, Mutex, PoisonError};

use palr_gym_core::EnvSpec;
use palr_gym_server::ServerError;
use palr_gym_server::dm_env_rpc::{Env, Outcome, Stage};
use palr_gym_sim::{SimError, resolve};

/// What all of them are.
static SPEC: LazyLock<EnvSpec> = LazyLock::new(|| resolve("hopper").expect("a task of ours").1);

/// Numbers its environments, and counts those that are open.
#[derive(Default)]
pub(super) struct FakeStage {
    opened: AtomicU64,
    open: Arc<AtomicUsize>,
}

impl FakeStage {
    pub(super) fn open(&self) -> usize {
        self.open.load(Ordering::Relaxed)
    }
}

pub(super) struct FakeEnv {
    /// Number, seed (-1: none), steps.
    shown: Mutex<[f64; 3]>,
    open: Arc<AtomicUsize>,
}

impl Drop for FakeEnv {
    fn drop(&mut self) {
        self.open.fetch_sub(1, Ordering::Relaxed);
    }
}

impl FakeEnv {
    fn observation(&self, change: impl FnOnce(&mut [f64; 3])) -> Vec<f64> {
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut shown);
        let mut observation = shown.to_vec();
        observation.resize(SPEC.observation_size(), 0.0);
        observation
    }
}

impl Stage for FakeStage {
    type Env = FakeEnv;

    fn check(&self, env_id: &str) -> Result<(), ServerError> {
        if env_id == "hopper" {
            return Ok(());
        }
        Err(ServerError::Internal("unknown".into()))
    }

    async fn open(&self, _: &str) -> Result<FakeEnv, ServerError> {
        let number = self.opened.fetch_add(1, Ordering::Relaxed) + 1;
        self.open.fetch_add(1, Ordering::Relaxed);
        let shown = Mutex::new([number as f64, -1.0, 0.0]);
        Ok(FakeEnv { shown, open: Arc::clone(&self.open) })
    }
}

impl Env for FakeEnv {
    fn spec(&self) -> &EnvSpec {
        &SPEC
    }

    async fn reset(&self, seed: Option<u64>) -> Result<Vec<f64>, ServerError> {
        Ok(self.observation(|shown| {
            shown[1] = seed.map_or(-1.0, |seed| seed as f64);
            shown[2] = 0.0;
        }))
    }

    /// Entries close to a bound end the episode: the first terminates, the second truncates.
    async fn step(&self, action: Vec<f32>) -> Result<Outcome, ServerError> {
        assert_eq!(action.len(), SPEC.action_size());
        if let Some(index) = action.iter().position(|entry| !(-1.0..=1.0).contains(entry)) {
            return Err(SimError::ActionNan { env_index: 0, index, name: "entry" }.into());
        }
        let observation = self.observation(|shown| shown[2] += 1.0);
        let (terminated, truncated) = (action[0] > 0.9, action[1] > 0.9);
        Ok(Outcome { observation, reward: 1.0, terminated, truncated })
    }
}
