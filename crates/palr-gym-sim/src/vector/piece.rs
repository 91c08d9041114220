//! A few neighbouring environments: what one thread steps at a time.

use std::sync::Arc;

use palr_gym_core::{AutoresetMode, EnvSpec};

use super::frame::{DivergedEpisode, Row, StepFrame};
use crate::divergence::Divergence;
use crate::env::{Env, Transition};
use crate::error::SimError;
use crate::parts::Part;

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
            }
            Order::Step { steps } => {
                let count = self.slots.len();
                self.frame.resize(steps, count, &self.spec, self.mode);
                self.frame.diverged.clear();
                let mut actions = self.actions.chunks_exact(self.spec.action_size());
                for step in 0..steps {
                    for (i, (slot, action)) in self.slots.iter_mut().zip(&mut actions).enumerate() {
                        if let Some(divergence) =
                            slot.step(action, self.mode, self.frame.row(step, i))
                        {
                            let diverged = DivergedEpisode { step, env_index: i, divergence };
                            self.frame.diverged.push(diverged);
                        }
                    }
                }
            }
        }
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

    /// One step, or the reset that stands for it.
    fn step(&mut self, action: &[f32], mode: AutoresetMode, row: Row<'_>) -> Option<Divergence> {
        let transition = if self.is_over {
            // NEXT_STEP: this step's action is ignored. (DISABLED never comes here.)
            row.info.fill(f64::NAN);
            let divergence = match self.env.reset(None) {
                Ok(()) => {
                    let info = &mut row.info[..row.reset_info_size];
                    info.copy_from_slice(self.env.reset_info());
                    None
                }
                Err(_) => Some(Divergence::EngineError),
            };
            let truncated = divergence.is_some();
            Transition { reward: 0.0, terminated: false, truncated, divergence }
        } else {
            self.env.step(action, row.info)
        };
        self.is_over = transition.is_last();
        if self.is_over && mode == AutoresetMode::SameStep {
            if let Some(final_observation) = row.final_observation {
                final_observation.copy_from_slice(self.env.observation());
            }
            self.is_over = self.env.reset(None).is_err();
            if let Some(reset_info) = row.reset_info {
                reset_info.copy_from_slice(self.env.reset_info());
            }
        }
        row.observation.copy_from_slice(self.env.observation());
        *row.reward = transition.reward;
        *row.terminated = transition.terminated;
        *row.truncated = transition.truncated;
        transition.divergence
    }
}
