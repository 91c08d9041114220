//! The policies that ship with the server: models, and controllers in the tasks' own code.

use std::fmt::Write;

use palr_gym_sim::tasks::TASKS;
use sha2::{Digest, Sha256};

/// An expert policy. It always sees the full observation.
#[derive(Debug, Clone, Copy)]
pub struct Expert {
    /// The task that it plays.
    pub task: &'static str,
    /// The model, under the policy contract.
    pub onnx: &'static [u8],
    /// Mean return of its deterministic actions, as its model card states it.
    pub card_return: f64,
}

/// Where the model cards stand in the source tree.
pub const MODEL_CARD: &str = "scenes/experts/README.md";

/// Where controllers are described.
pub const CONTROLLER_CARD: &str = "scenes/README.md";

/// Every model, in alphabetical order of tasks.
pub const EXPERTS: [Expert; 5] = [
    Expert {
        task: "ant",
        onnx: include_bytes!("../../scenes/experts/ant.onnx"),
        card_return: 5623.0,
    },
    Expert {
        task: "halfcheetah",
        onnx: include_bytes!("../../scenes/experts/halfcheetah.onnx"),
        card_return: 11723.3,
    },
    Expert {
        task: "hopper",
        onnx: include_bytes!("../../scenes/experts/hopper.onnx"),
        card_return: 3206.8,
    },
    Expert {
        task: "toy",
        onnx: include_bytes!("../../scenes/experts/toy.onnx"),
        card_return: 399.3,
    },
    Expert {
        task: "walker2d",
        onnx: include_bytes!("../../scenes/experts/walker2d.onnx"),
        card_return: 4461.9,
    },
];

/// The expert of a task.
#[must_use]
pub fn expert(task: &str) -> Option<&'static Expert> {
    EXPERTS.iter().find(|expert| expert.task == task)
}

/// What is known of a task's expert.
#[derive(Debug, Clone, PartialEq)]
pub struct About {
    /// Of the model; empty for a controller.
    pub sha256: String,
    /// Mean return of its deterministic actions.
    pub card_return: f64,
    /// Where this is stated in the source tree.
    pub model_card: &'static str,
}

/// True if the task's expert is a controller in its own code.
#[must_use]
pub fn has_controller(task: &str) -> bool {
    TASKS.iter().any(|known| known.spec().name == task && known.has_controller())
}

/// What is known of the expert of a task; `None` if it has none.
#[must_use]
pub fn about(task: &str) -> Option<About> {
    if let Some(expert) = expert(task) {
        let sha256 = sha256(expert.onnx);
        return Some(About { sha256, card_return: expert.card_return, model_card: MODEL_CARD });
    }
    let known = TASKS.iter().find(|known| known.spec().name == task && known.has_controller())?;
    Some(About {
        sha256: String::new(),
        card_return: known.spec().reference_returns.expert,
        model_card: CONTROLLER_CARD,
    })
}

/// The tasks that have a model, for people.
#[must_use]
pub fn available() -> String {
    EXPERTS.map(|expert| expert.task).join(", ")
}

/// SHA-256 of a model, in hexadecimal.
#[must_use]
pub fn sha256(model: &[u8]) -> String {
    Sha256::digest(model).iter().fold(String::new(), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
mod tests {
    use palr_gym_onnx::{Policy, PolicyLimits};

    use super::*;

    #[test]
    fn every_expert_plays_its_task_and_is_the_file_its_card_describes() {
        for expert in &EXPERTS {
            let (_, spec) = palr_gym_sim::resolve(expert.task).unwrap();
            let policy = Policy::load(
                expert.onnx,
                spec.observation_size(),
                spec.action_size(),
                PolicyLimits::default(),
            );
            assert!(policy.unwrap().is_stochastic());
            let card = std::fs::read_to_string(
                std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(MODEL_CARD),
            );
            assert!(card.unwrap().contains(&sha256(expert.onnx)), "{}", expert.task);
        }
    }
}
