//! What of a run survives being killed at any moment, small enough to be kept in a repository.
//!
//! A safetensors file that is whole or absent: networks, their optimisers, the slow copies, the
//! best policy so far, counters and settings. The replay buffer is not in it: a resumed run
//! collects a new one with its policy before it updates anything, so that it goes on well but not
//! to the same bits.

use std::path::Path;

use safetensors::SafeTensors;
use safetensors::tensor::Dtype;
use serde::{Deserialize, Serialize};

use crate::expert::agent::Agent;
use crate::expert::settings::{Change, ExpertSettings};
use crate::learning::checkpoint::{read_if_there, write_arrays};
use crate::learning::error::TrainError;

/// The one key of the file's metadata: its value is [`Header`] as JSON.
const HEADER: &str = "palr_gym_expert_checkpoint";
const VERSION: u32 = 1;
const BEST: &str = "best.actor.parameters";
const AVERAGED_ACTOR: &str = "averaged.actor.parameters";

/// Where a run stands.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Counters {
    /// Transitions collected, those of refilling not counted.
    pub step: u64,
    /// Transitions in the replay buffer.
    pub kept: u64,
    /// Rounds of all environments, those of refilling counted: what noise is drawn from.
    pub rounds: u64,
    /// Times that the run was resumed.
    pub resumed: u32,
    /// Seconds that it has run in all.
    pub wall_time_s: f64,
    /// The best evaluation so far.
    pub best: Option<Best>,
    /// How the run learns otherwise than at its beginning, in order.
    #[serde(default)]
    pub changes: Vec<Change>,
}

/// An evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Best {
    /// Transitions that had been collected.
    pub step: u64,
    /// Mean undiscounted return.
    pub return_mean: f64,
    /// Mean normalised score.
    pub score_mean: f64,
}

#[derive(Serialize, Deserialize)]
struct Header {
    version: u32,
    updates: u64,
    adam_steps: Vec<u64>,
    observation_size: usize,
    action_size: usize,
    counters: Counters,
    settings: ExpertSettings,
}

/// What was read.
pub struct Restored {
    /// As it was.
    pub agent: Agent,
    /// As they were.
    pub counters: Counters,
    /// Parameters of the best policy so far; empty before the first evaluation.
    pub best: Vec<f32>,
    /// Of the run that wrote it.
    pub settings: ExpertSettings,
}

impl Restored {
    /// Goes on by `settings`. The best policy so far is forgotten if evaluations have another number of
    /// episodes there, since the best of few is mostly lucky, and if rewards or heights count otherwise:
    /// no slower, steadier policy would take the place of a fast one.
    #[must_use]
    pub fn continued_by(mut self, settings: &ExpertSettings) -> Self {
        let sought = |settings: &ExpertSettings| {
            (settings.episodes, settings.reward_cap, settings.healthy_z_range)
        };
        if sought(&self.settings) != sought(settings) {
            self.counters.best = None;
            self.best.clear();
        }
        self.counters.changes.extend(self.settings.changes_to(settings, self.counters.step));
        self.agent.follow(settings);
        self
    }
}

/// Replaces the file at `path`.
///
/// # Errors
/// [`TrainError::File`].
pub fn write(
    path: &Path,
    agent: &Agent,
    best: &[f32],
    counters: &Counters,
    settings: &ExpertSettings,
) -> Result<(), TrainError> {
    let failed = |error: &dyn std::fmt::Display| TrainError::file(path, error);
    let header = Header {
        version: VERSION,
        updates: agent.updates,
        adam_steps: agent.networks().iter().map(|network| network.adam.step).collect(),
        observation_size: agent.observation_size(),
        action_size: agent.action_size(),
        counters: counters.clone(),
        settings: settings.clone(),
    };
    let header = serde_json::to_string(&header).map_err(|error| failed(&error))?;
    let mut arrays: Vec<(String, &[f32])> = vec![(BEST.to_owned(), best)];
    for network in agent.networks() {
        let name = network.name;
        arrays.push((format!("{name}.parameters"), &network.parameters));
        arrays.push((format!("{name}.adam.first_moment"), &network.adam.first_moment));
        arrays.push((format!("{name}.adam.second_moment"), &network.adam.second_moment));
    }
    for (network, slow) in agent.critics.iter().zip(&agent.targets) {
        arrays.push((format!("{}.slow", network.name), slow));
    }
    arrays.push((AVERAGED_ACTOR.to_owned(), &agent.averaged_actor));
    write_arrays(path, (HEADER, header), arrays)
}

/// What is in the file at `path`, if there is one.
///
/// # Errors
/// [`TrainError::File`] if it cannot be read or is no checkpoint of this version.
pub fn read(path: &Path) -> Result<Option<Restored>, TrainError> {
    let Some(bytes) = read_if_there(path)? else { return Ok(None) };
    let failed = |error: &dyn std::fmt::Display| {
        TrainError::file(path, format!("is no expert's checkpoint of this version: {error}"))
    };
    let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(|error| failed(&error))?;
    let header = metadata.metadata().as_ref().and_then(|metadata| metadata.get(HEADER));
    let header = header.ok_or_else(|| failed(&"it has no header"))?;
    // Before all else: other versions have other fields.
    let value: serde_json::Value = serde_json::from_str(header).map_err(|error| failed(&error))?;
    match value.get("version").and_then(serde_json::Value::as_u64) {
        Some(version) if version == u64::from(VERSION) => {}
        version => return Err(failed(&format!("version {version:?}"))),
    }
    let header = Header::deserialize(value).map_err(|error| failed(&error))?;
    header.settings.validate().map_err(|error| failed(&error))?;
    let tensors = SafeTensors::deserialize(&bytes).map_err(|error| failed(&error))?;
    let array = |name: &str, want: Option<usize>| -> Result<Vec<f32>, TrainError> {
        let view = tensors.tensor(name).map_err(|error| failed(&error))?;
        let length = view.shape().first().copied().unwrap_or(0);
        let is_wanted = want.is_none_or(|want| want == length);
        if view.dtype() != Dtype::F32 || view.shape().len() != 1 || !is_wanted {
            let got = format!("{name} is {:?} {:?}", view.dtype(), view.shape());
            return Err(failed(&format!("{got}; expected F32 [{want:?}]")));
        }
        Ok(bytemuck::pod_collect_to_vec(view.data()))
    };
    let mut agent = Agent::new(&header.settings, header.observation_size, header.action_size);
    agent.updates = header.updates;
    let networks = agent.networks_mut();
    if header.adam_steps.len() != networks.len() {
        return Err(failed(&format!("it has {} networks", header.adam_steps.len())));
    }
    for (network, step) in networks.into_iter().zip(header.adam_steps) {
        let (name, length) = (network.name, Some(network.parameters.len()));
        network.parameters = array(&format!("{name}.parameters"), length)?;
        network.adam.first_moment = array(&format!("{name}.adam.first_moment"), length)?;
        network.adam.second_moment = array(&format!("{name}.adam.second_moment"), length)?;
        network.adam.step = step;
    }
    for (network, slow) in agent.critics.iter().zip(&mut agent.targets) {
        *slow = array(&format!("{}.slow", network.name), Some(slow.len()))?;
    }
    let length = agent.actor.parameters.len();
    agent.averaged_actor = match tensors.tensor(AVERAGED_ACTOR) {
        // Of a run before there was one.
        Err(_) => agent.actor.parameters.clone(),
        Ok(_) => array(AVERAGED_ACTOR, Some(length))?,
    };
    let best = array(BEST, None)?;
    if !best.is_empty() && best.len() != agent.actor.parameters.len() {
        return Err(failed(&format!("{BEST} has {} numbers", best.len())));
    }
    Ok(Some(Restored { agent, counters: header.counters, best, settings: header.settings }))
}
