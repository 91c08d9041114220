//! Ant: four legs around a ball. Equals Gymnasium's `Ant-v4` without contact
//! forces and its `Ant-v5` with them.

use palr_gym_core::random::Generator;
use palr_gym_core::task::ObservationEntry as Entry;
use palr_gym_core::{Fidelity, ReferenceReturns, SceneOptions, TaskSpec};

use super::locomotion::{add_normal, add_uniform, control_cost, observe};
use super::{Outcome, Task};
use crate::physics::{Physics, Scene, Start};

const RESET_NOISE: f64 = 0.1;
const CONTROL_COST_WEIGHT: f32 = 0.5;
const HEALTHY_REWARD: f64 = 1.0;
/// `-v5` only: contact forces (N, N m) count and are shown within ± this.
const CONTACT_FORCE_BOUND: f64 = 1.0;
const CONTACT_COST_WEIGHT: f64 = 5e-4;
const HEALTHY_HEIGHT_M: std::ops::RangeInclusive<f64> = 0.2..=1.0;
/// The torso is the first body after the world.
const TORSO: usize = 1;

const SPEC: TaskSpec = TaskSpec {
    name: "ant",
    description: "Four legs around a ball walk forward without falling or jumping.",
    fidelity: Fidelity::Gym4,
    equals: "Gymnasium Ant-v4",
    observation: &[
        Entry::unbounded("qpos[root.z]"),
        Entry::unbounded("qpos[root.qw]"),
        Entry::unbounded("qpos[root.qx]"),
        Entry::unbounded("qpos[root.qy]"),
        Entry::unbounded("qpos[root.qz]"),
        Entry::unbounded("qpos[hip_1]"),
        Entry::unbounded("qpos[ankle_1]"),
        Entry::unbounded("qpos[hip_2]"),
        Entry::unbounded("qpos[ankle_2]"),
        Entry::unbounded("qpos[hip_3]"),
        Entry::unbounded("qpos[ankle_3]"),
        Entry::unbounded("qpos[hip_4]"),
        Entry::unbounded("qpos[ankle_4]"),
        Entry::unbounded("qvel[root.x]"),
        Entry::unbounded("qvel[root.y]"),
        Entry::unbounded("qvel[root.z]"),
        Entry::unbounded("qvel[root.rx]"),
        Entry::unbounded("qvel[root.ry]"),
        Entry::unbounded("qvel[root.rz]"),
        Entry::unbounded("qvel[hip_1]"),
        Entry::unbounded("qvel[ankle_1]"),
        Entry::unbounded("qvel[hip_2]"),
        Entry::unbounded("qvel[ankle_2]"),
        Entry::unbounded("qvel[hip_3]"),
        Entry::unbounded("qvel[ankle_3]"),
        Entry::unbounded("qvel[hip_4]"),
        Entry::unbounded("qvel[ankle_4]"),
    ],
    action_names: &["hip_4", "ankle_4", "hip_1", "ankle_1", "hip_2", "ankle_2", "hip_3", "ankle_3"],
    agent_camera: None,
    paper_mask: &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12],
    strict_mask: &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12],
    max_episode_steps: 1000,
    frame_skip: 5,
    physics_timestep_s: 0.01,
    info_names: &[
        "reward_forward",
        "reward_ctrl",
        "reward_survive",
        "x_position",
        "y_position",
        "distance_from_origin",
        "x_velocity",
        "y_velocity",
        "forward_reward",
    ],
    reset_info_names: &[],
    camera_names: &["track"],
    expert_observation_size: 27,
    // D4RL's reference scores for ant.
    reference_returns: ReferenceReturns { random: -325.6, expert: 3879.7 },
};

/// `-v4`'s entries, then the force on each body but the world: torque, then force.
const OBSERVATION_GYM5: [Entry; 105] = {
    macro_rules! forces {
        ($($body:literal)*) => {
            [$(
                concat!("cfrc_ext[", $body, ".tx]"),
                concat!("cfrc_ext[", $body, ".ty]"),
                concat!("cfrc_ext[", $body, ".tz]"),
                concat!("cfrc_ext[", $body, ".fx]"),
                concat!("cfrc_ext[", $body, ".fy]"),
                concat!("cfrc_ext[", $body, ".fz]"),
            )*]
        };
    }
    const FORCES: [&str; 78] = forces! {
        "torso" "front_left_leg" "aux_1" "foot_1" "front_right_leg" "aux_2" "foot_2" "back_leg"
        "aux_3" "foot_3" "right_back_leg" "aux_4" "foot_4"
    };
    let mut entries = [Entry::unbounded(""); 105];
    let mut i = 0;
    while i < entries.len() {
        entries[i] = if i < SPEC.observation.len() {
            SPEC.observation[i]
        } else {
            Entry::clipped(FORCES[i - SPEC.observation.len()], CONTACT_FORCE_BOUND)
        };
        i += 1;
    }
    entries
};

/// What `-v5` changed.
const SPEC_GYM5: TaskSpec = TaskSpec {
    fidelity: Fidelity::Gym5,
    equals: "Gymnasium Ant-v5",
    observation: &OBSERVATION_GYM5,
    info_names: &[
        "x_position",
        "y_position",
        "distance_from_origin",
        "x_velocity",
        "y_velocity",
        "reward_forward",
        "reward_ctrl",
        "reward_contact",
        "reward_survive",
    ],
    reset_info_names: &["x_position", "y_position", "distance_from_origin"],
    ..SPEC
};

static SCENE: Scene = Scene::new(SPEC.name, include_str!("../../../../scenes/ant.xml"));

/// The task.
pub(super) struct Ant(pub(super) Fidelity);

impl Task for Ant {
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
        let (state, forces) = observation.split_at_mut(SPEC.observation.len());
        observe(physics.qpos(), 2, physics.qvel(), f64::INFINITY, state);
        // Not those of the world. Only `-v5` shows forces, so elsewhere there is no room for any.
        for (slot, force) in forces.iter_mut().zip(physics.contact_forces()[1..].as_flattened()) {
            *slot = force.clamp(-CONTACT_FORCE_BOUND, CONTACT_FORCE_BOUND);
        }
    }

    /// The torso's frame, not qpos: after a step the frame lags by one integration, and the
    /// reward is defined on it.
    fn position_m(&self, physics: &Physics) -> [f64; 2] {
        let [x, y, _] = physics.body_position_m(TORSO);
        [x, y]
    }

    fn outcome(
        &self,
        physics: &Physics,
        before_m: [f64; 2],
        action: &[f32],
        info: &mut [f64],
    ) -> Outcome {
        let [x, y] = self.position_m(physics);
        let x_velocity = (x - before_m[0]) / SPEC.control_timestep_s();
        let y_velocity = (y - before_m[1]) / SPEC.control_timestep_s();
        let cost = f64::from(control_cost(CONTROL_COST_WEIGHT, action));
        let is_healthy = is_healthy(physics);
        let reward = match self.0 {
            Fidelity::Gym4 => {
                info.copy_from_slice(&[
                    x_velocity,
                    -cost,
                    HEALTHY_REWARD,
                    x,
                    y,
                    distance_m(x, y),
                    x_velocity,
                    y_velocity,
                    x_velocity,
                ]);
                // The bonus is paid on the failing step too.
                (x_velocity + HEALTHY_REWARD) - cost
            }
            Fidelity::Gym5 => {
                let contact_cost = CONTACT_COST_WEIGHT * sum_of_squares(physics.contact_forces());
                let healthy_reward = if is_healthy { HEALTHY_REWARD } else { 0.0 };
                self.reset_info(physics, &mut info[..3]);
                info[3..].copy_from_slice(&[
                    x_velocity,
                    y_velocity,
                    x_velocity,
                    -cost,
                    -contact_cost,
                    healthy_reward,
                ]);
                (x_velocity + healthy_reward) - (cost + contact_cost)
            }
        };
        Outcome { reward, terminated: !is_healthy }
    }

    fn needs_contact_forces(&self) -> bool {
        self.0 == Fidelity::Gym5
    }

    fn reset_info(&self, physics: &Physics, info: &mut [f64]) {
        if self.0 == Fidelity::Gym5 {
            let (x, y) = (physics.qpos()[0], physics.qpos()[1]);
            info.copy_from_slice(&[x, y, distance_m(x, y)]);
        }
    }
}

/// As NumPy's norm on machines whose BLAS fuses multiply and add.
fn distance_m(x: f64, y: f64) -> f64 {
    y.mul_add(y, x * x).sqrt()
}

/// Σ clip(force, ±1)² over all bodies in the order of NumPy's sum: eight running sums over whole
/// blocks of eight, added pairwise, then the rest one by one.
fn sum_of_squares(forces: &[[f64; 6]]) -> f64 {
    let square = |force: &f64| {
        let clipped = force.clamp(-CONTACT_FORCE_BOUND, CONTACT_FORCE_BOUND);
        clipped * clipped
    };
    let forces = forces.as_flattened();
    let (blocks, rest) = forces.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for (i, block) in blocks.iter().enumerate() {
        for (sum, force) in sums.iter_mut().zip(block) {
            // The first block is where NumPy's sums begin: 0 + x could change the sign of a zero,
            // but squares have none.
            *sum = if i == 0 { square(force) } else { *sum + square(force) };
        }
    }
    let [a, b, c, d, e, f, g, h] = sums;
    let blocks = ((a + b) + (c + d)) + ((e + f) + (g + h));
    rest.iter().fold(blocks, |sum, force| sum + square(force))
}

fn is_healthy(physics: &Physics) -> bool {
    let (qpos, qvel) = (physics.qpos(), physics.qvel());
    qpos.iter().chain(qvel).all(|entry| entry.is_finite()) && HEALTHY_HEIGHT_M.contains(&qpos[2])
}
