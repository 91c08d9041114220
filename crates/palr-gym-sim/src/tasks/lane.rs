//! Lane: a car keeps its lane on a figure eight, behind a car that stops and goes.
//!
//! Stands in for D4RL's `carla-lane`, at the same scale of reward, with nothing taken from CARLA.

mod expert;
mod mjcf;
mod state;
mod track;

use palr_gym_core::random::Generator;
use palr_gym_core::task::ObservationEntry as Entry;
use palr_gym_core::{Fidelity, ReferenceReturns, SceneOption, SceneOptions, TaskSpec};

use self::state::{LeadCar, State};
use self::track::TRACK;
use super::driving::{
    CRUISE_SPEED_MPS, END_REWARD, FRAME_SKIP, FRAME_STEP_S, LANE_WIDTH_M, Place, QPOS_STEER,
    QVEL_YAW, REWARD_BOUND, STEP_S, TWO_HALF_LENGTHS_M, along_and_across, draw_car, from_rear_axle,
    quaternion, steer_and_pedal, weather, wrap_angle, yaw_rad,
};
use super::{Outcome, Task};
use crate::physics::{Physics, Scene, Start};
use crate::render::Weather;

/// The right lane's middle.
const LANE_OFFSET_M: f64 = -LANE_WIDTH_M / 2.0;

const ACROSS_WEIGHT: f64 = 5.0;
/// Further from the lane's middle the car has left it.
const LANE_KEPT_M: f64 = 2.0;

const LEAD_START_M: (f64, f64) = (12.0, 30.0);
const LEAD_TARGETS_MPS: [f64; 4] = [0.0, 2.0, 4.0, 5.5];
const LEAD_TARGET_S: (f64, f64) = (2.0, 5.0);
/// Greatest deceleration and acceleration of the lead car (m/s²).
const LEAD_ACCELERATION: (f64, f64) = (2.5, 1.5);
/// Stands for "no lead car in sight".
const NO_LEAD_GAP_M: f64 = 100.0;
/// A lead car that has fallen behind by more than this is no longer followed.
const LEAD_PASSED_M: f64 = -2.0;
/// Where a lead car waits that is not there.
const PARKED_M: [f64; 3] = [0.0, 200.0, 0.0];

/// The point that the expert looks at: this far ahead, and further by this many seconds of speed.
const LOOK_AHEAD_M: f64 = 3.0;
const LOOK_AHEAD_S: f64 = 0.5;

/// Entries of MuJoCo's user data; see [`state`].
const USERDATA: usize = state::NUMBERS + weather::NUMBERS;

const SPEC: TaskSpec = TaskSpec {
    name: "lane",
    description: "A car keeps its lane and its distance to a car that stops and goes.",
    fidelity: Fidelity::Gym4,
    equals: "",
    observation: &[
        Entry::unbounded("progress_m"),
        Entry::unbounded("lateral_error_m"),
        Entry::unbounded("heading_error_rad"),
        Entry::unbounded("velocity_along_mps"),
        Entry::unbounded("velocity_across_mps"),
        Entry::unbounded("yaw_rate_rad_per_s"),
        Entry::unbounded("steering_rad"),
        Entry::unbounded("curvature_per_m"),
        Entry::unbounded("look_ahead_x_m"),
        Entry::unbounded("look_ahead_y_m"),
        Entry::unbounded("lead_gap_m"),
        Entry::unbounded("lead_speed_mps"),
    ],
    action_names: &["throttle", "steer"],
    agent_camera: Some("driver"),
    paper_mask: &[],
    strict_mask: &[],
    max_episode_steps: 250,
    frame_skip: FRAME_SKIP,
    physics_timestep_s: FRAME_STEP_S,
    info_names: &["collision", "off_lane", "lateral_error_m", "velocity_along_mps", "lead_gap_m"],
    reset_info_names: &[],
    expert_observation_size: 12,
    camera_names: &["driver", "chase", "top"],
    // Mean returns over 200 episodes each: scenes/lane.reference.json.
    reference_returns: ReferenceReturns { random: 5.1195, expert: 918.2557 },
};

static SCENE: Scene =
    Scene::watching(SPEC.name, include_str!("../../../../scenes/lane.xml"), "car_hull");

/// The task.
pub(super) struct Lane;

/// The scene as MJCF with the scenery that `seed` draws. Seed 0 gives the scene of the task.
#[must_use]
pub fn scene_mjcf(seed: u64) -> String {
    mjcf::lane(seed)
}

/// The car and what matters around it: the full observation.
struct View {
    progress_m: f64,
    /// From the lane's middle, positive to the left.
    lateral_error_m: f64,
    heading_error_rad: f64,
    velocity_along_mps: f64,
    velocity_across_mps: f64,
    yaw_rate_rad_per_s: f64,
    steering_rad: f64,
    curvature_per_m: f64,
    /// From the rear axle: ahead, and to the left.
    look_ahead_m: [f64; 2],
    /// From bumper to bumper.
    lead_gap_m: f64,
    lead_speed_mps: f64,
}

impl View {
    fn of(physics: &Physics) -> Self {
        let state = State::read(physics);
        let (qpos, qvel) = (physics.qpos(), physics.qvel());
        let position_m = [qpos[0], qpos[1]];
        let seen = TRACK.project(position_m, state.progress_m);
        let [along_x, along_y] = seen.tangent;
        let [velocity_along_mps, velocity_across_mps] = along_and_across(qvel, seen.tangent);
        let speed_mps = qvel[0].hypot(qvel[1]);
        let reach_m = LOOK_AHEAD_M + LOOK_AHEAD_S * speed_mps;
        let target_m = TRACK.place(seen.progress_m + reach_m, LANE_OFFSET_M).position_m;
        let lead = state.lead.and_then(|lead| {
            let gap_m = TRACK.gap_m(lead.progress_m, seen.progress_m) - TWO_HALF_LENGTHS_M;
            (gap_m > LEAD_PASSED_M && gap_m < NO_LEAD_GAP_M).then_some((gap_m, lead.speed_mps))
        });
        let (lead_gap_m, lead_speed_mps) = lead.unwrap_or((NO_LEAD_GAP_M, 0.0));
        Self {
            progress_m: seen.progress_m,
            lateral_error_m: seen.offset_m - LANE_OFFSET_M,
            heading_error_rad: wrap_angle(yaw_rad(qpos) - along_y.atan2(along_x)),
            velocity_along_mps,
            velocity_across_mps,
            yaw_rate_rad_per_s: qvel[QVEL_YAW],
            steering_rad: qpos[QPOS_STEER],
            curvature_per_m: seen.curvature_per_m,
            look_ahead_m: from_rear_axle(qpos, target_m),
            lead_gap_m,
            lead_speed_mps,
        }
    }
}

impl View {
    /// As the full observation has them.
    fn numbers(&self) -> [f64; SPEC.observation.len()] {
        [
            self.progress_m,
            self.lateral_error_m,
            self.heading_error_rad,
            self.velocity_along_mps,
            self.velocity_across_mps,
            self.yaw_rate_rad_per_s,
            self.steering_rad,
            self.curvature_per_m,
            self.look_ahead_m[0],
            self.look_ahead_m[1],
            self.lead_gap_m,
            self.lead_speed_mps,
        ]
    }

    /// Back from them; `None` for another number of them.
    fn from_numbers(numbers: &[f64]) -> Option<Self> {
        let &[
            progress_m,
            lateral_error_m,
            heading_error_rad,
            velocity_along_mps,
            velocity_across_mps,
            yaw_rate_rad_per_s,
            steering_rad,
            curvature_per_m,
            look_ahead_x_m,
            look_ahead_y_m,
            lead_gap_m,
            lead_speed_mps,
        ] = numbers
        else {
            return None;
        };
        Some(Self {
            progress_m,
            lateral_error_m,
            heading_error_rad,
            velocity_along_mps,
            velocity_across_mps,
            yaw_rate_rad_per_s,
            steering_rad,
            curvature_per_m,
            look_ahead_m: [look_ahead_x_m, look_ahead_y_m],
            lead_gap_m,
            lead_speed_mps,
        })
    }
}

impl Task for Lane {
    fn spec(&self) -> &'static TaskSpec {
        &SPEC
    }

    fn scene(&self) -> &'static Scene {
        &SCENE
    }

    fn scene_options(&self) -> &'static [SceneOption] {
        &[SceneOption::LeadCarProbability, SceneOption::Weather]
    }

    fn perturb(&self, generator: &mut Generator, options: &SceneOptions, start: &mut Start) {
        let progress_m = generator.uniform(0.0, TRACK.length_m());
        let place = |aside_m| TRACK.place(progress_m, LANE_OFFSET_M + aside_m);
        draw_car(generator, place, start);
        // Drawn whether used or not, so that a seed means the same start with and without one.
        let is_led = generator.next_f64() < options.lead_car_probability;
        let lead = LeadCar {
            progress_m: progress_m + generator.uniform(LEAD_START_M.0, LEAD_START_M.1),
            speed_mps: generator.uniform(0.0, CRUISE_SPEED_MPS),
            target_speed_mps: CRUISE_SPEED_MPS,
            until_s: 0.0,
        };
        let state = State { progress_m, lead: is_led.then_some(lead) };
        state.write(&mut start.userdata);
        // From a stream of its own, of which the episode's draws know nothing.
        let mut sky = Generator::from_seed(generator.next_u64());
        weather::draw(options.weather, &mut sky, &mut start.userdata[state::NUMBERS..]);
        place_lead(&state, &mut start.mocap_pos, &mut start.mocap_quat);
    }

    fn weather(&self, physics: &Physics) -> Option<Weather> {
        weather::read(physics.userdata().get(state::NUMBERS..)?)
    }

    fn controls(&self, action: &[f32], controls: &mut [f64]) {
        steer_and_pedal(action, controls);
    }

    fn advance(&self, generator: &mut Generator, physics: &mut Physics) {
        let mut state = State::read(physics);
        let position_m = [physics.qpos()[0], physics.qpos()[1]];
        state.progress_m = TRACK.project(position_m, state.progress_m).progress_m;
        if let Some(lead) = &mut state.lead {
            let time_s = physics.time_s();
            if time_s >= lead.until_s {
                let choice = (generator.next_f64() * LEAD_TARGETS_MPS.len() as f64) as usize;
                lead.target_speed_mps = LEAD_TARGETS_MPS[choice.min(LEAD_TARGETS_MPS.len() - 1)];
                lead.until_s = time_s + generator.uniform(LEAD_TARGET_S.0, LEAD_TARGET_S.1);
            }
            lead.speed_mps += (lead.target_speed_mps - lead.speed_mps)
                .max(-LEAD_ACCELERATION.0 * STEP_S)
                .min(LEAD_ACCELERATION.1 * STEP_S);
            lead.progress_m =
                (lead.progress_m + lead.speed_mps * STEP_S).rem_euclid(TRACK.length_m());
        }
        state.write(physics.userdata_mut());
        let (mut position, mut quaternion) = ([[0.0; 3]], [[0.0; 4]]);
        place_lead(&state, &mut position, &mut quaternion);
        physics.set_mocap(&position, &quaternion);
    }

    fn observe(&self, physics: &Physics, observation: &mut [f64]) {
        observation.copy_from_slice(&View::of(physics).numbers());
    }

    fn position_m(&self, physics: &Physics) -> [f64; 2] {
        [physics.qpos()[0], physics.qpos()[1]]
    }

    fn outcome(&self, physics: &Physics, _: [f64; 2], _: &[f32], info: &mut [f64]) -> Outcome {
        let view = View::of(physics);
        let has_collided = physics.has_touched();
        let is_off_lane = view.lateral_error_m.abs() > LANE_KEPT_M;
        info.copy_from_slice(&[
            f64::from(u8::from(has_collided)),
            f64::from(u8::from(is_off_lane)),
            view.lateral_error_m,
            view.velocity_along_mps,
            view.lead_gap_m,
        ]);
        let pace = view.velocity_along_mps - ACROSS_WEIGHT * view.velocity_across_mps.abs();
        let terminated = has_collided || is_off_lane;
        let end = if terminated { END_REWARD } else { 0.0 };
        Outcome { reward: pace.clamp(-REWARD_BOUND, REWARD_BOUND) + end, terminated }
    }

    fn has_controller(&self) -> bool {
        true
    }

    fn controller(&self, observation: &[f64], action: &mut [f32]) -> bool {
        let Some(view) = View::from_numbers(observation) else { return false };
        action.copy_from_slice(&expert::act(&view));
        true
    }
}

fn place_lead(state: &State, positions_m: &mut [[f64; 3]], quaternions: &mut [[f64; 4]]) {
    let (position_m, heading_rad) = match state.lead {
        Some(lead) => {
            let Place { position_m: [x, y], heading_rad } =
                TRACK.place(lead.progress_m, LANE_OFFSET_M);
            ([x, y, 0.0], heading_rad)
        }
        None => (PARKED_M, 0.0),
    };
    positions_m[0] = position_m;
    quaternions[0] = quaternion(heading_rad);
}

#[cfg(test)]
mod tests;
