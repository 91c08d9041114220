//! Where actions come from.

use palr_gym_core::{ActionMode, EnvSpec, tanh_gaussian};
use palr_gym_onnx::{OnnxError, Policy, PolicyLimits, PolicyOutput};

use super::play::{Log, Seats};
use crate::error::ServerError;
use crate::experts::{self, expert, sha256};

/// The policy that a caller asks for.
#[derive(Debug, Clone)]
pub enum PolicyChoice {
    /// Uniform over the action space.
    Random,
    /// The expert that ships for the task.
    Expert,
    /// The caller's own.
    Onnx(bytes::Bytes),
}

/// A policy, ready to act for a batch of environments.
pub enum Actor {
    /// Uniform over the action space.
    Random,
    /// The controller in the task's own code.
    Controller,
    /// A model.
    Model(Box<ModelActor>),
}

/// A model with what it needs beside its weights.
pub struct ModelActor {
    policy: Policy,
    sha256: String,
    action_mode: ActionMode,
    /// True for experts, which see more than the environment shows to others.
    sees_full_observation: bool,
    observations: Vec<f32>,
    observation_size: usize,
}

impl Actor {
    /// Loads the policy that `choice` names for environments of `spec`.
    ///
    /// # Errors
    /// [`ServerError::NoExpert`], [`ServerError::NotStochastic`] or [`ServerError::Policy`].
    pub fn new(
        choice: &PolicyChoice,
        spec: &EnvSpec,
        action_mode: ActionMode,
        limits: PolicyLimits,
    ) -> Result<Self, ServerError> {
        let (model, sees_full_observation): (&[u8], bool) = match choice {
            PolicyChoice::Random => return Ok(Self::Random),
            PolicyChoice::Expert => {
                let task = spec.task.name;
                if experts::has_controller(task) {
                    return match action_mode {
                        ActionMode::Deterministic => Ok(Self::Controller),
                        ActionMode::Sampled => Err(ServerError::NotStochastic { task }),
                    };
                }
                let found = expert(task).ok_or_else(|| ServerError::NoExpert {
                    task,
                    available: experts::available(),
                })?;
                (found.onnx, true)
            }
            PolicyChoice::Onnx(model) => (model, false),
        };
        let observation_size = if sees_full_observation {
            spec.task.expert_observation_size
        } else {
            spec.observation_size()
        };
        let policy = Policy::load(model, observation_size, spec.action_size(), limits)?;
        if action_mode == ActionMode::Sampled {
            policy.require_stochastic()?;
        }
        Ok(Self::Model(Box::new(ModelActor {
            policy,
            sha256: sha256(model),
            action_mode,
            sees_full_observation,
            observations: Vec::new(),
            observation_size,
        })))
    }

    /// SHA-256 of the model; empty where there is none.
    #[must_use]
    pub fn sha256(&self) -> &str {
        match self {
            Self::Random | Self::Controller => "",
            Self::Model(model) => &model.sha256,
        }
    }

    /// Fills the actions of every slot that is playing.
    pub(super) fn act<L: Log>(&mut self, seats: &Seats<L>) -> Result<(), ServerError> {
        match self {
            Self::Random => seats.try_playing(|_, slot| {
                for entry in &mut slot.action {
                    *entry = slot.generator.uniform(-1.0, 1.0) as f32;
                }
                Ok(())
            }),
            Self::Controller => seats.try_playing(|_, slot| {
                if slot.env.controller(&mut slot.action) {
                    Ok(())
                } else {
                    Err(ServerError::Internal("a task lost its controller".into()))
                }
            }),
            Self::Model(model) => model.act(seats),
        }
    }
}

impl ModelActor {
    fn act<L: Log>(&mut self, seats: &Seats<L>) -> Result<(), ServerError> {
        let size = self.observation_size;
        self.observations.clear();
        self.observations.resize(seats.len() * size, 0.0);
        seats.try_playing(|row, slot| {
            let observation = if self.sees_full_observation {
                slot.env.full_observation()
            } else {
                slot.env.observation()
            };
            let row = &mut self.observations[row * size..(row + 1) * size];
            for (entry, &value) in row.iter_mut().zip(observation) {
                *entry = value as f32;
            }
            Ok(())
        })?;
        let output = self
            .policy
            .act(&self.observations, seats.len())
            .map_err(|source| blame(source, seats))?;
        let size = output.action.len() / seats.len();
        seats.try_playing(|row, slot| {
            let range = row * size..(row + 1) * size;
            match (&output, self.action_mode) {
                (
                    PolicyOutput { mean: Some(mean), log_std: Some(log_std), .. },
                    ActionMode::Sampled,
                ) => {
                    slot.action_log_prob = Some(tanh_gaussian::sample(
                        &mut slot.generator,
                        &mean[range.clone()],
                        &log_std[range],
                        &mut slot.action,
                    ));
                }
                _ => {
                    for (entry, &value) in slot.action.iter_mut().zip(&output.action[range]) {
                        *entry = value.clamp(-1.0, 1.0);
                    }
                }
            }
            Ok(())
        })
    }
}

/// Says in which episode and step a policy failed, if the failing row is one of a playing slot.
fn blame<L: Log>(source: OnnxError, seats: &Seats<L>) -> ServerError {
    let failing = match &source {
        OnnxError::NotFinite { row, .. } => Some(*row),
        _ => None,
    };
    let place = seats.find(|index, seat| {
        let slot = &seat.slot;
        let is_it = failing.map_or(slot.is_playing(), |row| row == index);
        is_it.then(|| slot.episode.map(|episode| (episode, slot.length)))
    });
    match place.flatten() {
        Some((episode, step)) => ServerError::PolicyInEpisode { episode, step, source },
        None => ServerError::Policy(source),
    }
}
