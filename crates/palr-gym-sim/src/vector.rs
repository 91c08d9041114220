//! N environments that step together.

use std::sync::Arc;

use palr_gym_core::{AutoresetMode, EnvSpec, OutOfBounds};
use rayon::prelude::*;

use crate::env::{Env, Transition};
use crate::error::SimError;
use crate::tasks::Task;

/// The threads on which simulations run, shared by all sessions of a process.
///
/// Environments are handed out to threads piece by piece, so a thread that the system holds up
/// does not hold up the others; which thread steps an environment changes no bit of the result.
#[derive(Debug, Clone)]
pub struct SimulationThreads {
    pool: Arc<rayon::ThreadPool>,
}

impl SimulationThreads {
    /// Starts `threads` of them.
    ///
    /// # Errors
    /// [`SimError::Threads`] if the system refuses.
    pub fn start(threads: usize) -> Result<Self, SimError> {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|index| format!("sim-{index}"))
            .build()
            .map(|pool| Self { pool: Arc::new(pool) })
            .map_err(|error| SimError::Threads { threads, message: error.to_string() })
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// Runs `job` on one of the threads, jobs of one caller in order, and returns at once.
    pub fn spawn(&self, job: impl FnOnce() + Send + 'static) {
        self.pool.spawn_fifo(job);
    }

    /// Runs `job` on one of the threads and waits for it.
    pub fn run<R: Send>(&self, job: impl FnOnce() -> R + Send) -> R {
        self.pool.install(job)
    }
}

/// How a vector of environments treats ends and actions.
#[derive(Debug, Clone, Copy, Default)]
pub struct VectorOptions {
    /// What happens to an environment whose episode has ended.
    pub autoreset_mode: AutoresetMode,
    /// What happens to an action outside the action space.
    pub out_of_bounds: OutOfBounds,
}

/// What a step returns for N environments, in row-major order. The buffers are reused.
#[derive(Debug, Clone, Default)]
pub struct StepFrame {
    /// `[num_envs, observation_size]`.
    pub observations: Vec<f64>,
    /// `[num_envs]`.
    pub rewards: Vec<f64>,
    /// `[num_envs]`.
    pub terminated: Vec<bool>,
    /// `[num_envs]`.
    pub truncated: Vec<bool>,
    /// `[num_envs, info_names]`; NaN in rows that this step reset.
    pub info: Vec<f64>,
    /// `[num_envs, observation_size]`; SAME_STEP only, and valid only in the rows whose episode
    /// this step ended.
    pub final_observations: Vec<f64>,
}

/// One environment in the vector, with what autoreset needs to know.
struct Slot {
    env: Env,
    /// The episode has ended and a reset is due.
    is_over: bool,
}

/// N environments of one kind.
pub struct VectorEnv {
    spec: Arc<EnvSpec>,
    slots: Vec<Slot>,
    options: VectorOptions,
    threads: SimulationThreads,
    clipped: Vec<f32>,
    was_reset: bool,
}

/// The rows of a [`StepFrame`] that belong to one environment.
struct Row<'a> {
    observation: &'a mut [f64],
    reward: &'a mut f64,
    terminated: &'a mut bool,
    truncated: &'a mut bool,
    info: &'a mut [f64],
    final_observation: Option<&'a mut [f64]>,
}

impl VectorEnv {
    /// `num_envs` environments of `spec`, never reset.
    ///
    /// # Errors
    /// [`SimError::Scene`] or [`SimError::Memory`].
    pub fn new(
        task: &'static dyn Task,
        spec: EnvSpec,
        num_envs: usize,
        options: VectorOptions,
        threads: SimulationThreads,
    ) -> Result<Self, SimError> {
        let slots = (0..num_envs)
            .map(|_| Env::new(task, &spec).map(|env| Slot { env, is_over: false }))
            .collect::<Result<_, _>>()?;
        let spec = Arc::new(spec);
        Ok(Self { spec, slots, options, threads, clipped: Vec::new(), was_reset: false })
    }

    /// What the environments are.
    #[must_use]
    pub fn spec(&self) -> &Arc<EnvSpec> {
        &self.spec
    }

    /// Number of environments.
    #[must_use]
    pub fn len(&self) -> usize {
        self.slots.len()
    }

    /// True for a vector without environments.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// The environments, in order.
    pub fn envs(&self) -> impl ExactSizeIterator<Item = &Env> {
        self.slots.iter().map(|slot| &slot.env)
    }

    /// Starts new episodes.
    ///
    /// `seeds`: none (generators go on), one (environment i gets seed + i, as in Gymnasium's
    /// vector environments) or one for each. `indices`: which environments, ascending; empty
    /// means all.
    ///
    /// # Errors
    /// [`SimError::SeedCount`] or [`SimError::EnvIndex`]; then nothing was reset.
    pub fn reset(&mut self, seeds: &[u64], indices: &[usize]) -> Result<(), SimError> {
        let num_envs = self.len();
        if seeds.len() > 1 && seeds.len() != num_envs {
            return Err(SimError::SeedCount { got: seeds.len(), num_envs });
        }
        let mut previous = None;
        for &got in indices {
            if got >= num_envs || previous.is_some_and(|previous| got <= previous) {
                return Err(SimError::EnvIndex { got, previous, num_envs });
            }
            previous = Some(got);
        }
        let is_chosen = |index: &usize| indices.is_empty() || indices.binary_search(index).is_ok();
        let seed_of = |index: usize| match *seeds {
            [] => None,
            [seed] => Some(seed.wrapping_add(index as u64)),
            _ => Some(seeds[index]),
        };
        let reset = |(index, slot): (usize, &mut Slot)| {
            slot.env.reset(seed_of(index));
            slot.is_over = false;
        };
        // Environments that were never reset have no observation yet: give them one.
        let was_reset = std::mem::replace(&mut self.was_reset, true);
        let slots = &mut self.slots;
        self.threads.run(|| {
            slots
                .par_iter_mut()
                .enumerate()
                .filter(|(index, _)| !was_reset || is_chosen(index))
                .for_each(reset);
        });
        Ok(())
    }

    /// Copies every current observation, `[num_envs, observation_size]`.
    pub fn observations_into(&self, observations: &mut Vec<f64>) {
        observations.clear();
        for slot in &self.slots {
            observations.extend_from_slice(slot.env.observation());
        }
    }

    /// Steps every environment once with its row of `actions`, `[num_envs, action_size]`.
    ///
    /// # Errors
    /// Any of the action errors, [`SimError::ResetNeeded`] or [`SimError::NeverReset`]; then
    /// nothing was stepped.
    pub fn step(&mut self, actions: &[f32], frame: &mut StepFrame) -> Result<(), SimError> {
        self.check(actions)?;
        let clip = self.options.out_of_bounds == OutOfBounds::Clip;
        if clip {
            self.clipped.clear();
            self.clipped.extend(actions.iter().map(|entry| entry.clamp(-1.0, 1.0)));
        }
        let actions = if clip { self.clipped.as_slice() } else { actions };
        let mode = self.options.autoreset_mode;
        frame.resize(self.slots.len(), &self.spec, mode);
        let action_size = self.spec.action_size();
        let rows = frame.rows(&self.spec);
        let slots = &mut self.slots;
        self.threads.run(|| {
            slots
                .par_iter_mut()
                .zip(actions.par_chunks_exact(action_size))
                .zip(rows)
                .for_each(|((slot, action), row)| slot.step(action, mode, row));
        });
        Ok(())
    }

    fn check(&self, actions: &[f32]) -> Result<(), SimError> {
        let (num_envs, action_size) = (self.slots.len(), self.spec.action_size());
        if actions.len() != num_envs * action_size {
            return Err(SimError::ActionCount { got: actions.len(), num_envs, action_size });
        }
        if !self.was_reset {
            return Err(SimError::NeverReset);
        }
        let rejects = self.options.out_of_bounds == OutOfBounds::Reject;
        let offending =
            actions.iter().position(|entry| entry.is_nan() || (rejects && entry.abs() > 1.0));
        if let Some(position) = offending {
            let (env_index, index) = (position / action_size, position % action_size);
            let name = self.spec.task.action_names[index];
            let got = actions[position];
            return Err(if got.is_nan() {
                SimError::ActionNan { env_index, index, name }
            } else {
                SimError::ActionOutOfBounds { env_index, index, name, got }
            });
        }
        if self.options.autoreset_mode == AutoresetMode::Disabled
            && let Some(env_index) = self.slots.iter().position(|slot| slot.is_over)
        {
            return Err(SimError::ResetNeeded { env_index });
        }
        Ok(())
    }
}

impl StepFrame {
    fn resize(&mut self, num_envs: usize, spec: &EnvSpec, mode: AutoresetMode) {
        let observation_count = num_envs * spec.observation_size();
        self.observations.resize(observation_count, 0.0);
        self.rewards.resize(num_envs, 0.0);
        self.terminated.resize(num_envs, false);
        self.truncated.resize(num_envs, false);
        self.info.resize(num_envs * spec.task.info_names.len(), 0.0);
        let has_final = mode == AutoresetMode::SameStep;
        self.final_observations.resize(if has_final { observation_count } else { 0 }, 0.0);
    }

    fn rows(&mut self, spec: &EnvSpec) -> impl IndexedParallelIterator<Item = Row<'_>> {
        let size = spec.observation_size();
        let finals: Vec<_> = if self.final_observations.is_empty() {
            self.rewards.iter().map(|_| None).collect()
        } else {
            self.final_observations.chunks_exact_mut(size).map(Some).collect()
        };
        self.observations
            .par_chunks_exact_mut(size)
            .zip(&mut self.rewards)
            .zip(&mut self.terminated)
            .zip(&mut self.truncated)
            .zip(self.info.par_chunks_exact_mut(spec.task.info_names.len()))
            .zip(finals)
            .map(|(((((observation, reward), terminated), truncated), info), final_observation)| {
                Row { observation, reward, terminated, truncated, info, final_observation }
            })
    }
}

impl Slot {
    fn step(&mut self, action: &[f32], mode: AutoresetMode, row: Row<'_>) {
        let transition = if self.is_over {
            // NEXT_STEP: this step's action is ignored. (DISABLED never comes here.)
            self.env.reset(None);
            row.info.fill(f64::NAN);
            Transition { reward: 0.0, terminated: false, truncated: false }
        } else {
            self.env.step(action, row.info)
        };
        self.is_over = transition.is_last();
        if self.is_over && mode == AutoresetMode::SameStep {
            if let Some(final_observation) = row.final_observation {
                final_observation.copy_from_slice(self.env.observation());
            }
            self.env.reset(None);
            self.is_over = false;
        }
        row.observation.copy_from_slice(self.env.observation());
        *row.reward = transition.reward;
        *row.terminated = transition.terminated;
        *row.truncated = transition.truncated;
    }
}

#[cfg(test)]
mod tests;
