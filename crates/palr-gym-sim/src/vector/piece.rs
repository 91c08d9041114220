//! A few neighbouring environments: what one thread steps at a time.

use std::sync::Arc;

use palr_gym_core::{AutoresetMode, EnvSpec};

use super::frame::{DivergedEpisode, Row, StepFrame};
use crate::divergence::Divergence;
use crate::env::{Env, Transition};
use crate::error::SimError;
use crate::parts::Part;
use crate::sight::{ExtractorError, Onlooker};

/// One environment in the vector, with what autoreset needs to know.
pub(super) struct Slot {
    pub(super) env: Env,
    /// The episode has ended and a reset is due.
    pub(super) is_over: bool,
    /// The last [`Order::Reset`] reset it.
    pub(super) was_reset: bool,
    /// What the next [`Order::Reset`] means here.
    pub(super) reset_order: Option<ResetOrder>,
}

/// Start a new episode.
#[derive(Debug, Clone, Copy)]
pub(super) struct ResetOrder {
    pub(super) seed: Option<u64>,
}

/// What to do.
#[derive(Debug, Clone, Copy)]
pub(super) enum Order {
    /// Reset the slots that have a [`ResetOrder`].
    Reset,
    /// Step every slot with its rows of the actions.
    Step { steps: usize },
}

/// A few neighbouring environments and their rows of what goes in and comes out.
pub(super) struct Piece {
    pub(super) slots: Vec<Slot>,
    pub(super) order: Order,
    /// `[steps, slots, action_size]`, within bounds or as raw as the options allow.
    pub(super) actions: Vec<f32>,
    pub(super) frame: StepFrame,
    /// Why a reset failed.
    pub(super) failure: Option<SimError>,
    onlooker: Onlooker,
    spec: Arc<EnvSpec>,
    mode: AutoresetMode,
}

impl Piece {
    pub(super) fn new(slots: Vec<Slot>, spec: Arc<EnvSpec>, mode: AutoresetMode) -> Self {
        Self {
            slots,
            order: Order::Reset,
            actions: Vec::new(),
            frame: StepFrame::default(),
            failure: None,
            onlooker: Onlooker::default(),
            spec,
            mode,
        }
    }
}

impl Part for Piece {
    fn work(&mut self) {
        match self.order {
            Order::Reset => {
                for slot in &mut self.slots {
                    if let Some(order) = slot.reset_order.take()
                        && let Err(error) = slot.reset(order.seed)
                    {
                        self.failure = Some(error);
                    }
                }
                if let Some(error) = self.see(|_, _| {}) {
                    self.failure = Some(error.into());
                }
            }
            Order::Step { steps } => {
                let count = self.slots.len();
                self.frame.resize(steps, count, &self.spec, self.mode);
                self.frame.diverged.clear();
                for step in 0..steps {
                    self.step(step);
                }
            }
        }
    }
}

impl Piece {
    /// Step `step` of the frame, of all slots: who has ended begins anew, and what all of them see
    /// is made into observations together.
    fn step(&mut self, step: usize) {
        let action_size = self.spec.action_size();
        let actions = &self.actions[step * self.slots.len() * action_size..];
        for (i, (slot, action)) in
            self.slots.iter_mut().zip(actions.chunks_exact(action_size)).enumerate()
        {
            let divergence = slot.step(action, &mut self.frame.row(step, i));
            if let Some(divergence) = divergence {
                self.frame.diverged.push(DivergedEpisode { step, env_index: i, divergence });
            }
        }
        let _ = self.see(|frame, i| {
            let row = frame.row(step, i);
            row.info.fill(f64::NAN);
            (*row.reward, *row.terminated, *row.truncated) = (0.0, false, true);
            let divergence = Divergence::Unseen;
            frame.diverged.push(DivergedEpisode { step, env_index: i, divergence });
        });
        if self.mode == AutoresetMode::SameStep {
            for (i, slot) in self.slots.iter_mut().enumerate().filter(|(_, slot)| slot.is_over) {
                slot.begin_anew(self.frame.row(step, i));
            }
            // Whose first picture fails begins anew in the next step.
            let _ = self.see(|_, _| {});
        }
        for (i, slot) in self.slots.iter().enumerate() {
            self.frame.row(step, i).observation.copy_from_slice(slot.env.observation());
        }
    }

    /// Brings the features of all new pictures into the stacks; `on_failure` hears of slots of whose
    /// picture there are none, and whose episode is therefore over.
    fn see(&mut self, mut on_failure: impl FnMut(&mut StepFrame, usize)) -> Option<ExtractorError> {
        let Self { slots, frame, onlooker, .. } = self;
        onlooker.see(
            slots,
            |slot| &mut slot.env,
            |i, slot, _| {
                slot.is_over = true;
                on_failure(frame, i);
            },
        )
    }
}

impl Slot {
    pub(super) fn new(env: Env) -> Self {
        Self { env, is_over: false, was_reset: false, reset_order: None }
    }

    fn reset(&mut self, seed: Option<u64>) -> Result<(), SimError> {
        let done = self.env.reset(seed);
        // Where no episode could begin, none can go on.
        self.is_over = done.is_err();
        self.was_reset = done.is_ok();
        done
    }

    /// One step, or the reset that stands for it, but for the observation.
    fn step(&mut self, action: &[f32], row: &mut Row<'_>) -> Option<Divergence> {
        let transition = if self.is_over {
            // NEXT_STEP: this step's action is ignored. (DISABLED never comes here.)
            row.info.fill(f64::NAN);
            let divergence = match self.env.reset(None) {
                Ok(()) => {
                    let info = &mut row.info[..row.reset_info_size];
                    info.copy_from_slice(self.env.reset_info());
                    None
                }
                Err(error) => Some(error.divergence()),
            };
            let truncated = divergence.is_some();
            Transition { reward: 0.0, terminated: false, truncated, divergence }
        } else {
            self.env.step(action, row.info)
        };
        self.is_over = transition.is_last();
        *row.reward = transition.reward;
        *row.terminated = transition.terminated;
        *row.truncated = transition.truncated;
        transition.divergence
    }

    /// SAME_STEP: hands out the last observation and begins a new episode.
    fn begin_anew(&mut self, row: Row<'_>) {
        if let Some(final_observation) = row.final_observation {
            final_observation.copy_from_slice(self.env.observation());
        }
        self.is_over = self.env.reset(None).is_err();
        if let Some(reset_info) = row.reset_info {
            reset_info.copy_from_slice(self.env.reset_info());
        }
    }
}
