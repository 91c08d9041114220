//! N environments that step together.

mod frame;
mod piece;
mod save;

use std::sync::Arc;

use palr_gym_core::{AutoresetMode, EnvSpec, ObservationKind, OutOfBounds};

use crate::env::Env;
use crate::error::SimError;
use crate::parts::Parts;
use crate::render::{GlChoice, View};
use crate::sight::{Onlooker, Sight};
use crate::tasks::Task;
use crate::threads::SimulationThreads;

pub use frame::{DivergedEpisode, StepFrame};
use piece::{Order, Piece, ResetOrder, Slot};

/// Pieces that a vector is cut into at most: enough for threads to end at the same time, few enough
/// to hand out.
const MAX_PIECES: usize = 256;

/// How a vector of environments treats ends and actions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct VectorOptions {
    /// What happens to an environment whose episode has ended.
    pub autoreset_mode: AutoresetMode,
    /// What happens to an action outside the action space.
    pub out_of_bounds: OutOfBounds,
}

/// How far an open loop has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OpenLoop {
    steps: usize,
    done: usize,
}

/// N environments of one kind.
pub struct VectorEnv {
    task: &'static dyn Task,
    spec: Arc<EnvSpec>,
    options: VectorOptions,
    sight: Sight,
    num_envs: usize,
    /// Neighbouring environments, each piece but the last one with `piece_len` of them.
    pieces: Parts<Piece>,
    piece_len: usize,
    was_reset: bool,
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
        Self::seeing(task, spec, num_envs, options, threads, Sight::default())
    }

    /// The same, with what makes pictures into observations; `spec` fits it ([`Sight::fit`]).
    ///
    /// # Errors
    /// As by [`new`](Self::new), or [`SimError::Extractor`] if an extractor is missing.
    pub fn seeing(
        task: &'static dyn Task,
        spec: EnvSpec,
        num_envs: usize,
        options: VectorOptions,
        threads: SimulationThreads,
        sight: Sight,
    ) -> Result<Self, SimError> {
        let spec = Arc::new(spec);
        let mut piece_len = num_envs.div_ceil(MAX_PIECES).max(1);
        let leaves_features = matches!(spec.observation, ObservationKind::Features { .. });
        if leaves_features {
            // A piece asks for the features of its environments at once; each thread has a share.
            piece_len = piece_len.max(Onlooker::share(num_envs, threads.count()));
        }
        let mut pieces = Vec::with_capacity(num_envs.div_ceil(piece_len));
        for begin in (0..num_envs).step_by(piece_len) {
            // Exactly as much room as there are: a session's memory is that of its environments.
            let mut slots = Vec::with_capacity(piece_len.min(num_envs - begin));
            for _ in 0..slots.capacity() {
                let mut env = Env::seeing(task, &spec, &sight)?;
                if leaves_features {
                    env.leave_features();
                }
                slots.push(Slot::new(env));
            }
            pieces.push(Piece::new(slots, Arc::clone(&spec), options.autoreset_mode));
        }
        let pieces = Parts::new(pieces, threads);
        Ok(Self { task, spec, options, sight, num_envs, pieces, piece_len, was_reset: false })
    }

    /// What the environments are.
    #[must_use]
    pub fn spec(&self) -> &Arc<EnvSpec> {
        &self.spec
    }

    /// How ends and actions are treated.
    #[must_use]
    pub fn options(&self) -> VectorOptions {
        self.options
    }

    /// Number of environments.
    #[must_use]
    pub fn len(&self) -> usize {
        self.num_envs
    }

    /// True once there was a reset.
    #[must_use]
    pub fn was_reset(&self) -> bool {
        self.was_reset
    }

    /// Copies which episodes have ended, `[num_envs]`.
    pub fn is_over_into(&self, is_over: &mut Vec<bool>) {
        is_over.clear();
        for piece in self.pieces.iter() {
            is_over.extend(piece.slots.iter().map(|slot| slot.is_over));
        }
    }

    /// True for a vector without environments.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.num_envs == 0
    }

    /// Shows `look` every environment with its index, in order.
    pub fn for_each_env(&self, mut look: impl FnMut(usize, &Env)) {
        for (i, piece) in self.pieces.iter().enumerate() {
            for (j, slot) in piece.slots.iter().enumerate() {
                look(i * self.piece_len + j, &slot.env);
            }
        }
    }

    /// Draws one environment: `[height, width, 3]`.
    ///
    /// # Errors
    /// [`SimError::EnvIndex`] or [`SimError::Render`].
    pub fn draw(
        &self,
        env_index: usize,
        choice: GlChoice,
        view: View<'_>,
        picture: &mut Vec<u8>,
    ) -> Result<(), SimError> {
        if env_index >= self.num_envs {
            let (got, num_envs) = (env_index, self.num_envs);
            return Err(SimError::EnvIndex { got, previous: None, num_envs });
        }
        let piece = self.pieces.get(env_index / self.piece_len);
        piece.slots[env_index % self.piece_len].env.draw(choice, view, picture)
    }

    /// Checks that `indices` name environments, ascending.
    ///
    /// # Errors
    /// [`SimError::EnvIndex`].
    pub fn check_indices(&self, indices: &[usize]) -> Result<(), SimError> {
        let num_envs = self.num_envs;
        let mut previous = None;
        for &got in indices {
            if got >= num_envs || previous.is_some_and(|previous| got <= previous) {
                return Err(SimError::EnvIndex { got, previous, num_envs });
            }
            previous = Some(got);
        }
        Ok(())
    }

    /// Starts new episodes.
    ///
    /// `seeds`: none (generators go on), one (environment i gets seed + i, as in Gymnasium's
    /// vector environments) or one for each. `indices`: which environments, ascending; empty
    /// means all.
    ///
    /// # Errors
    /// [`SimError::SeedCount`] or [`SimError::EnvIndex`]; then nothing was reset.
    /// [`SimError::Engine`] if MuJoCo failed for one of them; the others were reset.
    pub fn reset(&mut self, seeds: &[u64], indices: &[usize]) -> Result<(), SimError> {
        let num_envs = self.num_envs;
        if seeds.len() > 1 && seeds.len() != num_envs {
            return Err(SimError::SeedCount { got: seeds.len(), num_envs });
        }
        self.check_indices(indices)?;
        // Environments that were never reset have no observation yet: give them one.
        let was_reset = std::mem::replace(&mut self.was_reset, true);
        let is_chosen = |index: usize| {
            !was_reset || indices.is_empty() || indices.binary_search(&index).is_ok()
        };
        let seed_of = |index: usize| match *seeds {
            [] => None,
            [seed] => Some(seed.wrapping_add(index as u64)),
            _ => Some(seeds[index]),
        };
        for (i, mut piece) in self.pieces.iter().enumerate() {
            piece.order = Order::Reset;
            for (j, slot) in piece.slots.iter_mut().enumerate() {
                let index = i * self.piece_len + j;
                slot.was_reset = false;
                slot.reset_order = is_chosen(index).then(|| ResetOrder { seed: seed_of(index) });
            }
        }
        self.pieces.work();
        match self.pieces.iter().find_map(|mut piece| piece.failure.take()) {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }

    /// Copies what the last reset reported, `[num_envs, reset_info_names]`: NaN in the rows of
    /// environments that it left alone.
    pub fn reset_info_into(&self, info: &mut Vec<f64>) {
        let size = self.spec.task.reset_info_names.len();
        info.clear();
        info.resize(self.num_envs * size, f64::NAN);
        if size == 0 {
            return;
        }
        let mut rows = info.chunks_exact_mut(size);
        for piece in self.pieces.iter() {
            for (slot, row) in piece.slots.iter().zip(&mut rows) {
                if slot.was_reset {
                    row.copy_from_slice(slot.env.reset_info());
                }
            }
        }
    }

    /// Copies every current observation, `[num_envs, observation_size]`.
    pub fn observations_into(&self, observations: &mut Vec<f64>) {
        observations.clear();
        self.for_each_env(|_, env| observations.extend_from_slice(env.observation()));
    }

    /// Steps every environment once with its row of `actions`, `[num_envs, action_size]`.
    ///
    /// # Errors
    /// Any of the action errors, [`SimError::ResetNeeded`] or [`SimError::NeverReset`]; then
    /// nothing was stepped.
    pub fn step(&mut self, actions: &[f32], frame: &mut StepFrame) -> Result<(), SimError> {
        self.step_open_loop(actions, 1, frame)
    }

    /// Takes `steps` steps, the k-th with row k of `actions`, `[steps, num_envs, action_size]`:
    /// the same as as many calls of [`step`](Self::step).
    ///
    /// With [`AutoresetMode::Disabled`] the first step in which an episode ends is the last one:
    /// `frame` then holds fewer steps.
    ///
    /// # Errors
    /// As by [`step`](Self::step); then no step was taken.
    pub fn step_open_loop(
        &mut self,
        actions: &[f32],
        steps: usize,
        frame: &mut StepFrame,
    ) -> Result<(), SimError> {
        let mut open_loop = self.begin_open_loop(actions, steps, frame)?;
        while !self.continue_open_loop(actions, &mut open_loop, steps, frame) {}
        Ok(())
    }

    /// Begins what [`step_open_loop`](Self::step_open_loop) does at once: nothing is stepped yet.
    ///
    /// # Errors
    /// As by [`step`](Self::step).
    pub fn begin_open_loop(
        &mut self,
        actions: &[f32],
        steps: usize,
        frame: &mut StepFrame,
    ) -> Result<OpenLoop, SimError> {
        self.check(actions, steps)?;
        frame.resize(steps, self.num_envs, &self.spec, self.options.autoreset_mode);
        frame.diverged.clear();
        Ok(OpenLoop { steps, done: 0 })
    }

    /// Takes up to `max_steps` more steps of an open loop that was begun with the same `actions` and
    /// `frame`. Returns whether it is finished. Nothing else may be asked of the vector meanwhile.
    pub fn continue_open_loop(
        &mut self,
        actions: &[f32],
        open_loop: &mut OpenLoop,
        max_steps: usize,
        frame: &mut StepFrame,
    ) -> bool {
        let row = self.num_envs * self.spec.action_size();
        let OpenLoop { steps, done } = open_loop;
        let end = done.saturating_add(max_steps.max(1)).min(*steps);
        if self.options.autoreset_mode == AutoresetMode::Disabled {
            while *done < end {
                self.take_steps(&actions[*done * row..(*done + 1) * row], *done, 1, frame);
                *done += 1;
                if frame.has_end(*done - 1) {
                    frame.resize(*done, self.num_envs, &self.spec, AutoresetMode::Disabled);
                    return true;
                }
            }
        } else {
            self.take_steps(&actions[*done * row..end * row], *done, end - *done, frame);
            *done = end;
        }
        end == *steps
    }

    /// Gives back the room that open loops have taken; single steps will take less again.
    pub fn release_room(&mut self) {
        for mut piece in self.pieces.iter() {
            piece.actions = Vec::new();
            piece.frame = StepFrame::default();
        }
    }

    /// Takes `steps` steps and writes what they return into the rows of `frame` from `first` on.
    fn take_steps(&mut self, actions: &[f32], first: usize, steps: usize, frame: &mut StepFrame) {
        let clips = self.options.out_of_bounds == OutOfBounds::Clip;
        let (num_envs, action_size) = (self.num_envs, self.spec.action_size());
        for (i, mut piece) in self.pieces.iter().enumerate() {
            let Piece { order, slots, actions: own, .. } = &mut *piece;
            *order = Order::Step { steps };
            own.clear();
            for step in 0..steps {
                let begin = (step * num_envs + i * self.piece_len) * action_size;
                let rows = &actions[begin..begin + slots.len() * action_size];
                if clips {
                    own.extend(rows.iter().map(|entry| entry.clamp(-1.0, 1.0)));
                } else {
                    own.extend_from_slice(rows);
                }
            }
        }
        self.pieces.work();
        for (i, piece) in self.pieces.iter().enumerate() {
            frame.take_in(&piece.frame, first, i * self.piece_len);
        }
        frame.sort_divergences();
    }

    fn check(&self, actions: &[f32], steps: usize) -> Result<(), SimError> {
        let (num_envs, action_size) = (self.num_envs, self.spec.action_size());
        if steps == 0 || actions.len() != steps * num_envs * action_size {
            return Err(SimError::ActionCount { got: actions.len(), num_envs, action_size });
        }
        if !self.was_reset {
            return Err(SimError::NeverReset);
        }
        let rejects = self.options.out_of_bounds == OutOfBounds::Reject;
        let offending =
            actions.iter().position(|entry| entry.is_nan() || (rejects && entry.abs() > 1.0));
        if let Some(position) = offending {
            let (env_index, index) = (position / action_size % num_envs, position % action_size);
            let name = self.spec.task.action_names[index];
            let got = actions[position];
            return Err(if got.is_nan() {
                SimError::ActionNan { env_index, index, name }
            } else {
                SimError::ActionOutOfBounds { env_index, index, name, got }
            });
        }
        if self.options.autoreset_mode == AutoresetMode::Disabled {
            let ended = |(i, piece): (usize, std::sync::MutexGuard<'_, Piece>)| {
                let over = piece.slots.iter().position(|slot| slot.is_over)?;
                Some(i * self.piece_len + over)
            };
            if let Some(env_index) = self.pieces.iter().enumerate().find_map(ended) {
                return Err(SimError::ResetNeeded { env_index });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod divergence_tests;
#[cfg(test)]
mod tests;
