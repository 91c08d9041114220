//! One environment: a task with mask, frame stack, time limit and generator.

use std::hash::{BuildHasher, RandomState};

use palr_gym_core::random::Generator;
use palr_gym_core::{EnvSpec, FrameStack};

use crate::divergence::Divergence;
use crate::error::SimError;
use crate::physics::Physics;
use crate::tasks::Task;

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

    fn simulate(&mut self, action: &[f32], frame_skip: u32) -> Option<Divergence> {
        match self.physics.step(action, frame_skip) {
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
