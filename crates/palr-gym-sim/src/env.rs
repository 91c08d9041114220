//! One environment: a task with mask, frame stack, time limit and generator.

use std::hash::{BuildHasher, RandomState};

use palr_gym_core::random::Generator;
use palr_gym_core::{EnvSpec, FrameStack};

use crate::divergence::Divergence;
use crate::error::SimError;
use crate::physics::Physics;
use crate::snapshot::{Reader, SnapshotError, Writer, malformed};
use crate::tasks::Task;

/// Beyond this MuJoCo holds a number for a mistake (`mjMAXVAL`).
const MAX_CONTROL: f32 = 1e10;

/// What a step earned, time limit included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transition {
    /// As the task defines it.
    pub reward: f64,
    /// The task ended the episode.
    pub terminated: bool,
    /// The time limit ended the episode, or the simulation diverged. Can be true together with
    /// `terminated`.
    pub truncated: bool,
    /// Why the simulation is no longer one of the task, if it is not. Then the reward is 0, the info
    /// NaN, and the observation still that of the step before.
    pub divergence: Option<Divergence>,
}

impl Transition {
    /// True if this step ended the episode.
    #[must_use]
    pub fn is_last(&self) -> bool {
        self.terminated || self.truncated
    }
}

/// What a snapshot says of one environment.
pub(crate) struct SavedEnv {
    /// [`Env::saved_len`] numbers.
    values: Vec<f64>,
    generator: Generator,
    elapsed_steps: u32,
}

/// A single environment. It does not reset by itself.
pub struct Env {
    task: &'static dyn Task,
    mask_indices: Vec<usize>,
    physics: Physics,
    generator: Generator,
    stack: FrameStack,
    full_observation: Vec<f64>,
    elapsed_steps: u32,
}

impl Env {
    /// An environment in the model's initial state, with a generator that the system seeds.
    /// [`reset`](Self::reset) starts the first episode.
    ///
    /// # Errors
    /// [`SimError::Scene`] or [`SimError::Memory`].
    pub fn new(task: &'static dyn Task, spec: &EnvSpec) -> Result<Self, SimError> {
        Ok(Self {
            task,
            physics: Physics::new(task.scene())?,
            generator: Generator::from_seed(RandomState::new().hash_one(0)),
            stack: FrameStack::new(spec.mask_indices.len(), spec.env_id.frame_stack),
            full_observation: vec![0.0; spec.task.observation.len()],
            mask_indices: spec.mask_indices.clone(),
            elapsed_steps: 0,
        })
    }

    /// Starts an episode: with a seed from a new generator, without one from where the old
    /// generator stands, as Gymnasium's `reset` does.
    ///
    /// # Errors
    /// [`SimError::Engine`] if MuJoCo fails; then only another reset helps.
    pub fn reset(&mut self, seed: Option<u64>) -> Result<(), SimError> {
        if let Some(seed) = seed {
            self.generator = Generator::from_seed(seed);
        }
        let Self { task, physics, generator, .. } = self;
        physics.reset(|qpos, qvel| task.perturb(generator, qpos, qvel))?;
        self.elapsed_steps = 0;
        self.stack.clear();
        self.observe();
        Ok(())
    }

    /// Puts the simulation into a state, keeping everything else. For tests against other
    /// simulators.
    ///
    /// # Errors
    /// [`SimError::Engine`] if MuJoCo fails.
    pub fn set_state(&mut self, qpos: &[f64], qvel: &[f64]) -> Result<(), SimError> {
        Ok(self.physics.set_state(qpos, qvel)?)
    }

    /// One step. `action` has `action_size` entries, `info` one for each of the task's names.
    pub fn step(&mut self, action: &[f32], info: &mut [f64]) -> Transition {
        let spec = self.task.spec();
        let before_m = self.task.position_m(&self.physics);
        self.elapsed_steps += 1;
        let truncated = self.elapsed_steps >= spec.max_episode_steps;
        if let Some(divergence) = self.simulate(action, spec.frame_skip) {
            info.fill(f64::NAN);
            let divergence = Some(divergence);
            return Transition { reward: 0.0, terminated: false, truncated: true, divergence };
        }
        let outcome = self.task.outcome(&self.physics, before_m, action, info);
        self.observe();
        Transition {
            reward: outcome.reward,
            terminated: outcome.terminated,
            truncated,
            divergence: None,
        }
    }

    /// What the last reset reports, `reset_info_names` entries, while no step has been taken.
    pub fn reset_info(&self, info: &mut [f64]) {
        self.task.reset_info(&self.physics, info);
    }

    /// Numbers in a snapshot: simulation, full observation, stack.
    fn saved_len(&self) -> usize {
        self.physics.saved_len() + self.full_observation.len() + self.stack.stacked().len()
    }

    /// Bytes in a snapshot.
    pub(crate) fn snapshot_len(&self) -> usize {
        self.saved_len() * size_of::<f64>() + 2 * size_of::<u128>() + size_of::<u32>()
    }

    /// Appends [`snapshot_len`](Self::snapshot_len) bytes.
    pub(crate) fn save(&self, writer: &mut Writer) {
        let mut values = Vec::with_capacity(self.saved_len());
        self.physics.save(&mut values);
        values.extend_from_slice(&self.full_observation);
        values.extend_from_slice(self.stack.stacked());
        writer.f64s(&values);
        let (state, increment) = self.generator.state();
        writer.u128(state);
        writer.u128(increment);
        writer.u32(self.elapsed_steps);
    }

    /// What [`save`](Self::save) wrote, checked.
    pub(crate) fn read(&self, reader: &mut Reader<'_>) -> Result<SavedEnv, SnapshotError> {
        let mut values = vec![0.0; self.saved_len()];
        reader.f64s("state", &mut values)?;
        let (state, increment) = (reader.u128("generator")?, reader.u128("generator")?);
        let generator = Generator::from_state(state, increment)
            .ok_or_else(|| malformed("generator", increment, "an odd increment"))?;
        let elapsed_steps = reader.u32("elapsed_steps")?;
        let max = self.task.spec().max_episode_steps;
        if elapsed_steps > max {
            return Err(malformed("elapsed_steps", elapsed_steps, format!("at most {max}")));
        }
        Ok(SavedEnv { values, generator, elapsed_steps })
    }

    /// Goes on from where `saved` was.
    ///
    /// # Errors
    /// [`SimError::Engine`] if MuJoCo fails.
    pub(crate) fn restore(&mut self, saved: SavedEnv) -> Result<(), SimError> {
        let (physics, observations) = saved.values.split_at(self.physics.saved_len());
        let (full, stack) = observations.split_at(self.full_observation.len());
        self.physics.restore(physics)?;
        self.full_observation.copy_from_slice(full);
        self.stack.restore(stack);
        self.generator = saved.generator;
        self.elapsed_steps = saved.elapsed_steps;
        Ok(())
    }

    fn simulate(&mut self, action: &[f32], frame_skip: u32) -> Option<Divergence> {
        // Actuators with limits would clamp it in silence, while its cost overflows.
        if action.iter().any(|entry| entry.abs() > MAX_CONTROL) {
            return Some(Divergence::BadControl);
        }
        let done = if self.task.needs_contact_forces() {
            self.physics.step_with_contact_forces(action, frame_skip)
        } else {
            self.physics.step(action, frame_skip)
        };
        match done {
            Ok(()) => self.physics.divergence(),
            Err(error) => {
                tracing::warn!(task = self.task.spec().name, "{error}; the episode is truncated");
                Some(Divergence::EngineError)
            }
        }
    }

    fn observe(&mut self) {
        self.task.observe(&self.physics, &mut self.full_observation);
        self.stack.push(self.mask_indices.iter().map(|&index| self.full_observation[index]));
    }

    /// The masked, stacked observation.
    #[must_use]
    pub fn observation(&self) -> &[f64] {
        self.stack.stacked()
    }

    /// The whole observation, for experts only: an agent must never see it.
    #[must_use]
    pub fn full_observation(&self) -> &[f64] {
        &self.full_observation
    }

    /// The simulation's state.
    #[must_use]
    pub fn physics(&self) -> &Physics {
        &self.physics
    }
}
