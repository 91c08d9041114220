//! An environment: a task as one agent sees it.

use crate::env_id::EnvId;
use crate::scene_options::SceneOptions;
use crate::space::BoxSpace;
use crate::task::TaskSpec;

/// A task with mask and frame stack chosen.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvSpec {
    /// Canonical id.
    pub env_id: EnvId,
    /// The task's facts.
    pub task: &'static TaskSpec,
    /// Indices into the full observation that the agent sees, ascending.
    pub mask_indices: Vec<usize>,
    /// What was chosen about the scene.
    pub scene: SceneOptions,
}

impl EnvSpec {
    /// `task` as `env_id` asks for it, its scene as it is by default.
    #[must_use]
    pub fn new(env_id: EnvId, task: &'static TaskSpec) -> Self {
        let mask_indices = task.mask_indices(env_id.mask);
        Self { env_id, task, mask_indices, scene: SceneOptions::default() }
    }

    /// Entries of a stacked observation.
    #[must_use]
    pub fn observation_size(&self) -> usize {
        self.mask_indices.len() * self.env_id.frame_stack
    }

    /// Entries of an action.
    #[must_use]
    pub fn action_size(&self) -> usize {
        self.task.action_names.len()
    }

    /// The stacked observation's space. The newest observation's entries bear their plain names,
    /// older ones their age: `qpos[rootz][t-1]`.
    #[must_use]
    pub fn observation_space(&self) -> BoxSpace {
        let frame_stack = self.env_id.frame_stack;
        let entries = || {
            (0..frame_stack).rev().flat_map(|age| {
                self.mask_indices.iter().map(move |&index| (age, &self.task.observation[index]))
            })
        };
        BoxSpace {
            low: entries().map(|(_, entry)| -entry.bound).collect(),
            high: entries().map(|(_, entry)| entry.bound).collect(),
            names: entries()
                .map(|(age, entry)| match age {
                    0 => entry.name.to_owned(),
                    _ => format!("{}[t-{age}]", entry.name),
                })
                .collect(),
        }
    }

    /// The action space: every actuator within ±1.
    #[must_use]
    pub fn action_space(&self) -> BoxSpace {
        BoxSpace {
            low: vec![-1.0; self.action_size()],
            high: vec![1.0; self.action_size()],
            names: self.task.action_names.iter().map(|&name| name.to_owned()).collect(),
        }
    }
}
