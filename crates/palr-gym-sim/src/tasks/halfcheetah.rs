//! Halfcheetah: a planar runner with two legs. Equals Gymnasium's `HalfCheetah-v4` and
//! `HalfCheetah-v5`.

use palr_gym_core::random::Generator;
use palr_gym_core::task::ObservationEntry as Entry;
use palr_gym_core::{Fidelity, ReferenceReturns, SceneOptions, TaskSpec};

use super::locomotion::{add_normal, add_uniform, control_cost, observe};
use super::{Outcome, Task};
use crate::physics::{Physics, Scene, Start};

const RESET_NOISE: f64 = 0.1;
const CONTROL_COST_WEIGHT: f32 = 0.1;

const SPEC: TaskSpec = TaskSpec {
    name: "halfcheetah",
    description: "A planar two-legged runner runs forward; it cannot fall out of an episode.",
    fidelity: Fidelity::Gym4,
    equals: "Gymnasium HalfCheetah-v4",
    observation: &[
        Entry::unbounded("qpos[rootz]"),
        Entry::unbounded("qpos[rooty]"),
        Entry::unbounded("qpos[bthigh]"),
        Entry::unbounded("qpos[bshin]"),
        Entry::unbounded("qpos[bfoot]"),
        Entry::unbounded("qpos[fthigh]"),
        Entry::unbounded("qpos[fshin]"),
        Entry::unbounded("qpos[ffoot]"),
        Entry::unbounded("qvel[rootx]"),
        Entry::unbounded("qvel[rootz]"),
        Entry::unbounded("qvel[rooty]"),
        Entry::unbounded("qvel[bthigh]"),
        Entry::unbounded("qvel[bshin]"),
        Entry::unbounded("qvel[bfoot]"),
        Entry::unbounded("qvel[fthigh]"),
        Entry::unbounded("qvel[fshin]"),
        Entry::unbounded("qvel[ffoot]"),
    ],
    action_names: &["bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot"],
    // Five velocities stay in: the paper's tables disagree about the order of the variables, and
    // these are the indices of its public code. `strict` has none.
    agent_camera: None,
    paper_mask: &[0, 1, 2, 3, 8, 9, 10, 11, 12],
    strict_mask: &[0, 1, 2, 3, 4, 5, 6, 7],
    max_episode_steps: 1000,
    frame_skip: 5,
    physics_timestep_s: 0.01,
    info_names: &["x_position", "x_velocity", "reward_run", "reward_ctrl"],
    reset_info_names: &[],
    camera_names: &["track"],
    expert_observation_size: 17,
    // D4RL's reference scores for halfcheetah.
    reference_returns: ReferenceReturns { random: -280.178953, expert: 12135.0 },
};

/// What `-v5` changed.
const SPEC_GYM5: TaskSpec = TaskSpec {
    fidelity: Fidelity::Gym5,
    equals: "Gymnasium HalfCheetah-v5",
    info_names: &["x_position", "x_velocity", "reward_forward", "reward_ctrl"],
    reset_info_names: &["x_position"],
    ..SPEC
};

static SCENE: Scene = Scene::new(SPEC.name, include_str!("../../../../scenes/halfcheetah.xml"));

/// The task.
pub(super) struct Halfcheetah(pub(super) Fidelity);

impl Task for Halfcheetah {
    fn spec(&self) -> &'static TaskSpec {
        match self.0 {
            Fidelity::Gym4 => &SPEC,
            Fidelity::Gym5 => &SPEC_GYM5,
        }
    }

    fn scene(&self) -> &'static Scene {
        &SCENE
    }

    fn perturb(&self, generator: &mut Generator, _: &SceneOptions, start: &mut Start) {
        add_uniform(generator, RESET_NOISE, &mut start.qpos);
        add_normal(generator, RESET_NOISE, &mut start.qvel);
    }

    fn observe(&self, physics: &Physics, observation: &mut [f64]) {
        observe(physics.qpos(), 1, physics.qvel(), f64::INFINITY, observation);
    }

    fn position_m(&self, physics: &Physics) -> [f64; 2] {
        [physics.qpos()[0], 0.0]
    }

    fn outcome(
        &self,
        physics: &Physics,
        before_m: [f64; 2],
        action: &[f32],
        info: &mut [f64],
    ) -> Outcome {
        let x_position = physics.qpos()[0];
        let x_velocity = (x_position - before_m[0]) / SPEC.control_timestep_s();
        let cost = f64::from(control_cost(CONTROL_COST_WEIGHT, action));
        info.copy_from_slice(&[x_position, x_velocity, x_velocity, -cost]);
        Outcome { reward: x_velocity - cost, terminated: false }
    }

    fn reset_info(&self, physics: &Physics, info: &mut [f64]) {
        if self.0 == Fidelity::Gym5 {
            info[0] = physics.qpos()[0];
        }
    }
}
