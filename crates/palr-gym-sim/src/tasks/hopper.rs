//! Hopper: one leg that should hop forward. Equals Gymnasium's `Hopper-v4` and
//! `Hopper-v5`.

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
const HEALTHY_HEIGHT_M: (f64, f64) = (0.7, f64::INFINITY);
const HEALTHY_ANGLE_RAD: (f64, f64) = (-0.2, 0.2);
/// Every entry of (qpos, qvel) from the height on.
const HEALTHY_STATE: (f64, f64) = (-100.0, 100.0);

const SPEC: TaskSpec = TaskSpec {
    name: "hopper",
    description: "One leg hops forward without falling.",
    fidelity: Fidelity::Gym4,
    equals: "Gymnasium Hopper-v4",
    observation: &[
        Entry::unbounded("qpos[rootz]"),
        Entry::unbounded("qpos[rooty]"),
        Entry::unbounded("qpos[thigh_joint]"),
        Entry::unbounded("qpos[leg_joint]"),
        Entry::unbounded("qpos[foot_joint]"),
        Entry::clipped("qvel[rootx]", VELOCITY_BOUND),
        Entry::clipped("qvel[rootz]", VELOCITY_BOUND),
        Entry::clipped("qvel[rooty]", VELOCITY_BOUND),
        Entry::clipped("qvel[thigh_joint]", VELOCITY_BOUND),
        Entry::clipped("qvel[leg_joint]", VELOCITY_BOUND),
        Entry::clipped("qvel[foot_joint]", VELOCITY_BOUND),
    ],
    action_names: &["thigh_joint", "leg_joint", "foot_joint"],
    agent_camera: None,
    paper_mask: &[0, 1, 2, 3, 4],
    strict_mask: &[0, 1, 2, 3, 4],
    max_episode_steps: 1000,
    frame_skip: 4,
    physics_timestep_s: 0.002,
    info_names: &["x_position", "x_velocity"],
    reset_info_names: &[],
    camera_names: &["track"],
    expert_observation_size: 11,
    // D4RL's reference scores for hopper.
    reference_returns: ReferenceReturns { random: -20.272305, expert: 3234.3 },
};

/// What `-v5` changed.
const SPEC_GYM5: TaskSpec = TaskSpec {
    fidelity: Fidelity::Gym5,
    equals: "Gymnasium Hopper-v5",
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

static SCENE: Scene = Scene::new(SPEC.name, include_str!("../../../../scenes/hopper.xml"));

/// The task.
pub(super) struct Hopper(pub(super) Fidelity);

impl Task for Hopper {
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

/// qpos[0] is not tested, and velocities are tested unclipped.
fn is_healthy(physics: &Physics) -> bool {
    let (qpos, qvel) = (physics.qpos(), physics.qvel());
    qpos[2..].iter().chain(qvel).all(|&entry| is_within(entry, HEALTHY_STATE.0, HEALTHY_STATE.1))
        && is_within(qpos[1], HEALTHY_HEIGHT_M.0, HEALTHY_HEIGHT_M.1)
        && is_within(qpos[2], HEALTHY_ANGLE_RAD.0, HEALTHY_ANGLE_RAD.1)
}
