//! An environment: a task as one agent sees it.

use crate::env_id::EnvId;
use crate::options::Mask;
use crate::scene_options::SceneOptions;
use crate::space::BoxSpace;
use crate::task::TaskSpec;

/// Both sides of the pictures that the mask `pixels` shows.
pub const PIXELS_SIDE: usize = 48;
/// Red, green and blue.
const CHANNELS: usize = 3;
/// Pixels are within 0 and this.
const BRIGHTEST: f64 = 255.0;

/// What the entries of an observation are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ObservationKind {
    /// Entries of the full observation.
    State,
    /// What a feature extractor makes of the agent's picture.
    Features {
        /// Entries of one picture's features; 0 as long as no extractor is known.
        size: usize,
    },
    /// The agent's picture: `[PIXELS_SIDE, PIXELS_SIDE, 3]`, integers within 0 and 255.
    Pixels,
}

/// A task with mask and frame stack chosen.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvSpec {
    /// Canonical id.
    pub env_id: EnvId,
    /// The task's facts.
    pub task: &'static TaskSpec,
    /// What observations are made of.
    pub observation: ObservationKind,
    /// Indices into the full observation that the agent sees, ascending; none if it sees pictures.
    pub mask_indices: Vec<usize>,
    /// What was chosen about the scene.
    pub scene: SceneOptions,
}

impl EnvSpec {
    /// `task` as `env_id` asks for it, its scene as it is by default.
    #[must_use]
    pub fn new(env_id: EnvId, task: &'static TaskSpec) -> Self {
        let observation = match (env_id.mask, task.agent_camera) {
            (Mask::Pixels, Some(_)) => ObservationKind::Pixels,
            (Mask::Paper, Some(_)) => ObservationKind::Features { size: 0 },
            _ => ObservationKind::State,
        };
        let mask_indices = task.mask_indices(env_id.mask);
        Self { env_id, task, observation, mask_indices, scene: SceneOptions::default() }
    }

    /// True if observations are pictures or made of them.
    #[must_use]
    pub fn shows_pictures(&self) -> bool {
        self.observation != ObservationKind::State
    }

    /// Entries of an observation before it is stacked.
    #[must_use]
    pub fn frame_size(&self) -> usize {
        match self.observation {
            ObservationKind::State => self.mask_indices.len(),
            ObservationKind::Features { size } => size,
            ObservationKind::Pixels => PIXELS_SIDE * PIXELS_SIDE * CHANNELS,
        }
    }

    /// Entries of a stacked observation.
    #[must_use]
    pub fn observation_size(&self) -> usize {
        self.frame_size() * self.env_id.frame_stack
    }

    /// Shape of a stacked observation. Pictures lie one below the other, the oldest at the top, so
    /// that a stack is a picture too.
    #[must_use]
    pub fn observation_shape(&self) -> Vec<usize> {
        match self.observation {
            ObservationKind::State | ObservationKind::Features { .. } => {
                vec![self.observation_size()]
            }
            ObservationKind::Pixels => {
                vec![self.env_id.frame_stack * PIXELS_SIDE, PIXELS_SIDE, CHANNELS]
            }
        }
    }

    /// Entries of an action.
    #[must_use]
    pub fn action_size(&self) -> usize {
        self.task.action_names.len()
    }

    /// The stacked observation's space. The newest observation's entries bear their plain names,
    /// older ones their age: `qpos[rootz][t-1]`. The entries of pictures have none.
    #[must_use]
    pub fn observation_space(&self) -> BoxSpace {
        let shape = self.observation_shape();
        let frame: Vec<(String, f64)> = match self.observation {
            ObservationKind::State => {
                let entry = |&index: &usize| &self.task.observation[index];
                let entries = self.mask_indices.iter().map(entry);
                entries.map(|entry| (entry.name.to_owned(), entry.bound)).collect()
            }
            ObservationKind::Features { size } => {
                (0..size).map(|index| (format!("feature[{index}]"), f64::INFINITY)).collect()
            }
            ObservationKind::Pixels => {
                return BoxSpace { shape, low: vec![0.0], high: vec![BRIGHTEST], names: vec![] };
            }
        };
        let entries = || {
            let ages = (0..self.env_id.frame_stack).rev();
            ages.flat_map(|age| frame.iter().map(move |(name, bound)| (age, name, bound)))
        };
        BoxSpace {
            shape,
            low: entries().map(|(.., bound)| -bound).collect(),
            high: entries().map(|(.., bound)| *bound).collect(),
            names: entries()
                .map(|(age, name, _)| match age {
                    0 => name.clone(),
                    _ => format!("{name}[t-{age}]"),
                })
                .collect(),
        }
    }

    /// The action space: every actuator within ±1.
    #[must_use]
    pub fn action_space(&self) -> BoxSpace {
        BoxSpace {
            shape: vec![self.action_size()],
            low: vec![-1.0; self.action_size()],
            high: vec![1.0; self.action_size()],
            names: self.task.action_names.iter().map(|&name| name.to_owned()).collect(),
        }
    }
}
