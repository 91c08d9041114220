//! Ant: four legs around a ball. Equals Gymnasium's `Ant-v4` without contact forces.

use palr_gym_core::random::Generator;
use palr_gym_core::task::ObservationEntry as Entry;
use palr_gym_core::{ReferenceReturns, TaskSpec};

use super::locomotion::{add_normal, add_uniform, control_cost, observe};
use super::{Outcome, Task};
use crate::physics::{Physics, Scene};

const RESET_NOISE: f64 = 0.1;
const CONTROL_COST_WEIGHT: f32 = 0.5;
const HEALTHY_REWARD: f64 = 1.0;
const HEALTHY_HEIGHT_M: std::ops::RangeInclusive<f64> = 0.2..=1.0;
/// The torso is the first body after the world.
const TORSO: usize = 1;

const SPEC: TaskSpec = TaskSpec {
    name: "ant",
    description: "Four legs around a ball walk forward without falling or jumping.",
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
    // D4RL's reference scores for ant.
    reference_returns: ReferenceReturns { random: -325.6, expert: 3879.7 },
};

static SCENE: Scene = Scene::new(SPEC.name, include_str!("../../../../scenes/ant.xml"));

/// The task.
pub(super) struct Ant;

impl Task for Ant {
    fn spec(&self) -> &'static TaskSpec {
        &SPEC
    }

    fn scene(&self) -> &'static Scene {
        &SCENE
    }

    fn perturb(&self, generator: &mut Generator, qpos: &mut [f64], qvel: &mut [f64]) {
        add_uniform(generator, RESET_NOISE, qpos);
        add_normal(generator, RESET_NOISE, qvel);
    }

    fn observe(&self, physics: &Physics, observation: &mut [f64]) {
        observe(physics.qpos(), 2, physics.qvel(), f64::INFINITY, observation);
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
        info.copy_from_slice(&[
            x_velocity,
            -cost,
            HEALTHY_REWARD,
            x,
            y,
            // As NumPy's norm on machines whose BLAS fuses multiply and add.
            y.mul_add(y, x * x).sqrt(),
            x_velocity,
            y_velocity,
            x_velocity,
        ]);
        // The bonus is paid on the failing step too.
        Outcome { reward: (x_velocity + HEALTHY_REWARD) - cost, terminated: !is_healthy(physics) }
    }
}

fn is_healthy(physics: &Physics) -> bool {
    let (qpos, qvel) = (physics.qpos(), physics.qvel());
    qpos.iter().chain(qvel).all(|entry| entry.is_finite()) && HEALTHY_HEIGHT_M.contains(&qpos[2])
}
