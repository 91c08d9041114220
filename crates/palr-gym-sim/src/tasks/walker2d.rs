//! Walker2d: two legs that should walk forward. Equals Gymnasium's `Walker2d-v4` and
//! `Walker2d-v5`.

use palr_gym_core::random::Generator;
use palr_gym_core::task::ObservationEntry as Entry;
use palr_gym_core::{Fidelity, ReferenceReturns, SceneOptions, TaskSpec};

use super::locomotion::{
    add_uniform, control_cost, forward_outcome, forward_reset_info, is_within, observe,
};
use super::{Outcome, Task};
use crate::physics::{Physics, Scene, Start};

/// Velocities are observed within ± this (m/s, rad/s).
const VELOCITY_BOUND: f64 = 10.0;
const RESET_NOISE: f64 = 5e-3;
const CONTROL_COST_WEIGHT: f32 = 1e-3;
const HEALTHY_HEIGHT_M: (f64, f64) = (0.8, 2.0);
const HEALTHY_ANGLE_RAD: (f64, f64) = (-1.0, 1.0);

const SPEC: TaskSpec = TaskSpec {
    name: "walker2d",
    description: "Two legs walk forward without falling.",
    fidelity: Fidelity::Gym4,
    equals: "Gymnasium Walker2d-v4",
    observation: &[
        Entry::unbounded("qpos[rootz]"),
        Entry::unbounded("qpos[rooty]"),
        Entry::unbounded("qpos[thigh_joint]"),
        Entry::unbounded("qpos[leg_joint]"),
        Entry::unbounded("qpos[foot_joint]"),
        Entry::unbounded("qpos[thigh_left_joint]"),
        Entry::unbounded("qpos[leg_left_joint]"),
        Entry::unbounded("qpos[foot_left_joint]"),
        Entry::clipped("qvel[rootx]", VELOCITY_BOUND),
        Entry::clipped("qvel[rootz]", VELOCITY_BOUND),
        Entry::clipped("qvel[rooty]", VELOCITY_BOUND),
        Entry::clipped("qvel[thigh_joint]", VELOCITY_BOUND),
        Entry::clipped("qvel[leg_joint]", VELOCITY_BOUND),
        Entry::clipped("qvel[foot_joint]", VELOCITY_BOUND),
        Entry::clipped("qvel[thigh_left_joint]", VELOCITY_BOUND),
        Entry::clipped("qvel[leg_left_joint]", VELOCITY_BOUND),
        Entry::clipped("qvel[foot_left_joint]", VELOCITY_BOUND),
    ],
    action_names: &[
        "thigh_joint",
        "leg_joint",
        "foot_joint",
        "thigh_left_joint",
        "leg_left_joint",
        "foot_left_joint",
    ],
    agent_camera: None,
    paper_mask: &[0, 1, 2, 3, 4, 5, 6, 7],
    strict_mask: &[0, 1, 2, 3, 4, 5, 6, 7],
    max_episode_steps: 1000,
    frame_skip: 4,
    physics_timestep_s: 0.002,
    info_names: &["x_position", "x_velocity"],
    reset_info_names: &[],
    camera_names: &["track"],
    expert_observation_size: 17,
    // D4RL's reference scores for walker2d.
    reference_returns: ReferenceReturns { random: 1.629008, expert: 4592.3 },
};

/// What `-v5` changed.
const SPEC_GYM5: TaskSpec = TaskSpec {
    fidelity: Fidelity::Gym5,
    equals: "Gymnasium Walker2d-v5",
    info_names: &[
        "x_position",
        "z_distance_from_origin",
        "x_velocity",
        "reward_forward",
        "reward_ctrl",
        "reward_survive",
    ],
    reset_info_names: &["x_position", "z_distance_from_origin"],
    ..SPEC
};

static SCENE: Scene = Scene::new(SPEC.name, include_str!("../../../../scenes/walker2d.xml"));
/// Both feet as sticky as the left one is in `-v4`.
static SCENE_GYM5: Scene =
    Scene::new(SPEC.name, include_str!("../../../../scenes/walker2d-gym5.xml"));

/// The task.
pub(super) struct Walker2d(pub(super) Fidelity);

impl Task for Walker2d {
    fn spec(&self) -> &'static TaskSpec {
        match self.0 {
            Fidelity::Gym4 => &SPEC,
            Fidelity::Gym5 => &SPEC_GYM5,
        }
    }

    fn scene(&self) -> &'static Scene {
        match self.0 {
            Fidelity::Gym4 => &SCENE,
            Fidelity::Gym5 => &SCENE_GYM5,
        }
    }

    fn perturb(&self, generator: &mut Generator, _: &SceneOptions, start: &mut Start) {
        add_uniform(generator, RESET_NOISE, &mut start.qpos);
        add_uniform(generator, RESET_NOISE, &mut start.qvel);
    }

    fn observe(&self, physics: &Physics, observation: &mut [f64]) {
        observe(physics.qpos(), 1, physics.qvel(), VELOCITY_BOUND, observation);
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
        let cost = control_cost(CONTROL_COST_WEIGHT, action);
        forward_outcome(self.spec(), physics, before_m, cost, is_healthy(physics), info)
    }

    fn reset_info(&self, physics: &Physics, info: &mut [f64]) {
        forward_reset_info(self.spec(), physics, info);
    }
}

fn is_healthy(physics: &Physics) -> bool {
    let qpos = physics.qpos();
    is_within(qpos[1], HEALTHY_HEIGHT_M.0, HEALTHY_HEIGHT_M.1)
        && is_within(qpos[2], HEALTHY_ANGLE_RAD.0, HEALTHY_ANGLE_RAD.1)
}
