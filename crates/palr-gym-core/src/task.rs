//! The facts of a task, without its physics.

use crate::options::{Fidelity, Mask};

/// Returns between which D4RL normalises.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceReturns {
    /// Return with score 0: the random policy's.
    pub random: f64,
    /// Return with score 100: the expert's.
    pub expert: f64,
}

/// One entry of a full observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObservationEntry {
    /// Unique name, such as `qvel[rootx]`.
    pub name: &'static str,
    /// Values are within ± this; infinity where the task sets no bound.
    pub bound: f64,
}

impl ObservationEntry {
    /// An entry without bounds.
    #[must_use]
    pub const fn unbounded(name: &'static str) -> Self {
        Self { name, bound: f64::INFINITY }
    }

    /// An entry that the task clips to ± `bound`.
    #[must_use]
    pub const fn clipped(name: &'static str, bound: f64) -> Self {
        Self { name, bound }
    }
}

/// What is fixed about a task: names, sizes, masks, limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TaskSpec {
    /// First part of every environment id.
    pub name: &'static str,
    /// One sentence for people.
    pub description: &'static str,
    /// Which definition of the task this is.
    pub fidelity: Fidelity,
    /// The public environment that it equals; empty for a task of our own.
    pub equals: &'static str,
    /// The full observation.
    pub observation: &'static [ObservationEntry],
    /// Actuators, each driven within ±1.
    pub action_names: &'static [&'static str],
    /// The camera whose pictures an agent sees, if it sees pictures: then the mask `pixels` shows
    /// them, and `paper` features of them.
    pub agent_camera: Option<&'static str>,
    /// Indices that the paper's mask keeps, ascending; none where there is no such mask.
    pub paper_mask: &'static [usize],
    /// Indices that hold no velocity, ascending; none where there is no such mask.
    pub strict_mask: &'static [usize],
    /// An episode is truncated after this many steps.
    pub max_episode_steps: u32,
    /// Physics steps in a step.
    pub frame_skip: u32,
    /// Simulated seconds in a physics step.
    pub physics_timestep_s: f64,
    /// Columns of the info that every step reports.
    pub info_names: &'static [&'static str],
    /// Those of them that a reset reports, in the same order; none for `-v4` tasks.
    pub reset_info_names: &'static [&'static str],
    /// Leading entries of the full observation that the task's expert sees.
    pub expert_observation_size: usize,
    /// The scene's cameras, the most useful first.
    pub camera_names: &'static [&'static str],
    /// For normalised scores.
    pub reference_returns: ReferenceReturns,
}

impl TaskSpec {
    /// Simulated seconds in a step.
    #[must_use]
    pub fn control_timestep_s(&self) -> f64 {
        self.physics_timestep_s * f64::from(self.frame_skip)
    }

    /// The masks that the task has.
    pub fn masks(&self) -> impl Iterator<Item = Mask> {
        Mask::ALL.into_iter().filter(|&mask| {
            let shows_pictures = self.agent_camera.is_some() && mask.shows_pictures();
            shows_pictures || !self.mask_indices(mask).is_empty()
        })
    }

    /// Indices into the full observation that `mask` keeps, ascending; none if it shows pictures.
    #[must_use]
    pub fn mask_indices(&self, mask: Mask) -> Vec<usize> {
        match mask {
            Mask::Full => (0..self.observation.len()).collect(),
            Mask::Paper => self.paper_mask.to_vec(),
            Mask::Strict => self.strict_mask.to_vec(),
            Mask::Pixels => Vec::new(),
        }
    }
}
