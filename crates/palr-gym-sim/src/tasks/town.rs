//! Town: a car drives through streets to a goal, among other vehicles.
//!
//! Stands in for D4RL's `carla-town`, with nothing taken from CARLA. What a driver sees does not tell
//! where the route turns, so that at a junction the same picture comes with different actions: an
//! imitator that only reacts to pictures cannot learn the way. That is the point of the task.
//!
//! # Maps
//! Every episode has a map of its own: the streets that its seed leaves of a grid, and the buildings
//! beside them. All maps are one scene. It holds every piece of every map, each marked with a number;
//! an episode's memory says which map it is, and pictures show that map's pieces. The physics knows
//! flat ground only (beyond the road's edge an episode is over), so it is the same whatever the map:
//! one compiled model, one workbench and one OpenGL context a thread, and a snapshot is the state as
//! ever.

mod expert;
mod map;
mod mjcf;
mod pieces;
mod route;
mod state;
mod traffic;

use palr_gym_core::random::Generator;
use palr_gym_core::task::ObservationEntry as Entry;
use palr_gym_core::{Fidelity, ReferenceReturns, SceneOption, SceneOptions, TaskSpec};

use self::map::Map;
use self::route::{Leg, Route, STREET_M};
use self::state::State;
use self::traffic::{Car, Vehicle};
use super::driving::{
    CAR_HALF_LENGTH_M, END_REWARD, FRAME_SKIP, FRAME_STEP_S, Place, QPOS_STEER, QVEL_YAW,
    REWARD_BOUND, along_and_across, draw_car, from_rear_axle, quaternion, steer_and_pedal, weather,
    wrap_angle, yaw_rad,
};
use super::{Outcome, Task};
use crate::physics::{Physics, Scene, Start};
use crate::render::{Pieces, Weather};

/// From junction to junction.
const BLOCK_M: f64 = 44.0;
/// From the middle of a junction to where its streets begin.
const JUNCTION_M: f64 = 8.0;

/// Further aside than this the car is not on its route, and earns nothing.
const ROUTE_KEPT_M: f64 = 2.5;

/// Where on a street an episode starts.
const RESET_START_M: (f64, f64) = (2.0, STREET_M - 8.0);

/// The demonstrator's speed in turns, and how hard it brakes before them (m/s²).
const TURN_SPEED_MPS: f64 = 3.2;
const TURN_BRAKING: f64 = 1.2;
/// The point that the demonstrator looks at: this far ahead, and further by this many seconds of
/// speed.
const LOOK_AHEAD_M: f64 = 2.5;
const LOOK_AHEAD_S: f64 = 0.45;
/// Stands for a free road.
const NOTHING_AHEAD_M: f64 = 100.0;
/// Before junctions further away than this nobody stops.
const JUNCTION_SEEN_M: f64 = 20.0;
/// Where vehicles wait that are not there: this far north, in a row.
const PARKED_M: f64 = 200.0;
const PARKED_APART_M: f64 = 5.0;

const USERDATA: usize = state::NUMBERS + weather::NUMBERS;

const SPEC: TaskSpec = TaskSpec {
    name: "town",
    description: "A car follows its route through a town with other vehicles.",
    fidelity: Fidelity::Gym4,
    equals: "",
    observation: &[
        Entry::unbounded("distance_to_goal_m"),
        Entry::unbounded("lateral_error_m"),
        Entry::unbounded("heading_error_rad"),
        Entry::unbounded("velocity_along_mps"),
        Entry::unbounded("velocity_across_mps"),
        Entry::unbounded("yaw_rate_rad_per_s"),
        Entry::unbounded("steering_rad"),
        Entry::unbounded("curvature_per_m"),
        Entry::unbounded("turn_distance_m"),
        Entry::unbounded("look_ahead_x_m"),
        Entry::unbounded("look_ahead_y_m"),
        Entry::unbounded("gap_ahead_m"),
        Entry::unbounded("speed_ahead_mps"),
        Entry::unbounded("stop_gap_m"),
    ],
    action_names: &["throttle", "steer"],
    paper_mask: &[],
    strict_mask: &[],
    max_episode_steps: 1000,
    frame_skip: FRAME_SKIP,
    physics_timestep_s: FRAME_STEP_S,
    info_names: &[
        "collision",
        "off_road",
        "goals_reached",
        "distance_to_goal_m",
        "lateral_error_m",
        "velocity_along_mps",
        "gap_ahead_m",
    ],
    reset_info_names: &[],
    expert_observation_size: 14,
    agent_camera: Some("driver"),
    camera_names: &["driver", "chase", "top"],
    // Mean returns over 200 episodes each: scenes/town.reference.json.
    // Mean returns over 200 episodes each: scenes/town.reference.json.
    reference_returns: ReferenceReturns { random: 381.0195, expert: 4025.7335 },
};

static SCENE: Scene =
    Scene::watching(SPEC.name, include_str!("../../../../scenes/town.xml"), "car_hull");

/// The task.
pub(super) struct Town;

/// The scene as MJCF, in which other viewers show the map of the episode with that seed; the others'
/// pieces are in a group that they hide. Seed 0 gives the scene of the task.
#[must_use]
pub fn scene_mjcf(seed: u64) -> String {
    mjcf::town(seed, &Map::draw(&mut Generator::from_seed(seed)))
}

/// The car and what matters around it: the full observation.
struct View {
    distance_to_goal_m: f64,
    /// From the lane's middle, positive to the left.
    lateral_error_m: f64,
    heading_error_rad: f64,
    velocity_along_mps: f64,
    velocity_across_mps: f64,
    yaw_rate_rad_per_s: f64,
    steering_rad: f64,
    curvature_per_m: f64,
    /// To where the route's next turn begins, 0 in one.
    turn_distance_m: f64,
    /// From the rear axle: ahead, and to the left.
    look_ahead_m: [f64; 2],
    /// From bumper to bumper.
    gap_ahead_m: f64,
    speed_ahead_mps: f64,
    /// From the bumper to a junction in which somebody is.
    stop_gap_m: f64,
}

/// The greatest speed this far before a turn.
fn speed_before_turn(distance_m: f64) -> f64 {
    (TURN_SPEED_MPS * TURN_SPEED_MPS + 2.0 * TURN_BRAKING * distance_m.max(0.0)).sqrt()
}

/// The car as others see it.
fn car(physics: &Physics, state: &State) -> Car {
    let (qpos, qvel) = (physics.qpos(), physics.qvel());
    let (begin_m, leg) = state.route.leg_at(state.progress_m);
    Car {
        position_m: [qpos[0], qpos[1]],
        heading_rad: yaw_rad(qpos),
        speed_mps: qvel[0].hypot(qvel[1]),
        leg,
        along_m: state.progress_m - begin_m,
    }
}

impl View {
    fn of(physics: &Physics) -> Self {
        let state = State::read(physics.userdata());
        let (qpos, qvel, route) = (physics.qpos(), physics.qvel(), &state.route);
        let position_m = [qpos[0], qpos[1]];
        let seen = route.project(position_m, state.progress_m);
        let (along_y, along_x) = seen.heading_rad.sin_cos();
        let [velocity_along_mps, velocity_across_mps] = along_and_across(qvel, [along_x, along_y]);
        let reach_m = LOOK_AHEAD_M + LOOK_AHEAD_S * qvel[0].hypot(qvel[1]);
        let target_m = route.place(seen.progress_m + reach_m, 0.0).position_m;
        let ahead = state
            .traffic()
            .iter()
            .filter_map(|vehicle| {
                let Place { position_m, heading_rad } = vehicle.place();
                let speed_mps = vehicle.speed_mps;
                traffic::ahead_on(route, seen.progress_m, position_m, heading_rad, speed_mps)
            })
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let (gap_ahead_m, speed_ahead_mps) = ahead.unwrap_or((NOTHING_AHEAD_M, 0.0));
        let (begin_m, leg) = route.leg_at(seen.progress_m);
        let entry_m = begin_m + STREET_M - seen.progress_m - CAR_HALF_LENGTH_M;
        let must_wait =
            (0.0..JUNCTION_SEEN_M).contains(&entry_m) && traffic::is_taken(state.traffic(), leg);
        Self {
            distance_to_goal_m: route.goal_m() - seen.progress_m,
            lateral_error_m: seen.offset_m,
            heading_error_rad: wrap_angle(yaw_rad(qpos) - seen.heading_rad),
            velocity_along_mps,
            velocity_across_mps,
            yaw_rate_rad_per_s: qvel[QVEL_YAW],
            steering_rad: qpos[QPOS_STEER],
            curvature_per_m: seen.curvature_per_m,
            turn_distance_m: route.turn_distance_m(seen.progress_m),
            look_ahead_m: from_rear_axle(qpos, target_m),
            gap_ahead_m,
            speed_ahead_mps,
            stop_gap_m: if must_wait { entry_m } else { NOTHING_AHEAD_M },
        }
    }

    /// As the full observation has them.
    fn numbers(&self) -> [f64; SPEC.observation.len()] {
        [
            self.distance_to_goal_m,
            self.lateral_error_m,
            self.heading_error_rad,
            self.velocity_along_mps,
            self.velocity_across_mps,
            self.yaw_rate_rad_per_s,
            self.steering_rad,
            self.curvature_per_m,
            self.turn_distance_m,
            self.look_ahead_m[0],
            self.look_ahead_m[1],
            self.gap_ahead_m,
            self.speed_ahead_mps,
            self.stop_gap_m,
        ]
    }

    /// Back from them; `None` for another number of them.
    fn from_numbers(numbers: &[f64]) -> Option<Self> {
        let &[
            distance_to_goal_m,
            lateral_error_m,
            heading_error_rad,
            velocity_along_mps,
            velocity_across_mps,
            yaw_rate_rad_per_s,
            steering_rad,
            curvature_per_m,
            turn_distance_m,
            look_ahead_x_m,
            look_ahead_y_m,
            gap_ahead_m,
            speed_ahead_mps,
            stop_gap_m,
        ] = numbers
        else {
            return None;
        };
        Some(Self {
            distance_to_goal_m,
            lateral_error_m,
            heading_error_rad,
            velocity_along_mps,
            velocity_across_mps,
            yaw_rate_rad_per_s,
            steering_rad,
            curvature_per_m,
            turn_distance_m,
            look_ahead_m: [look_ahead_x_m, look_ahead_y_m],
            gap_ahead_m,
            speed_ahead_mps,
            stop_gap_m,
        })
    }
}

impl Task for Town {
    fn spec(&self) -> &'static TaskSpec {
        &SPEC
    }

    fn scene(&self) -> &'static Scene {
        &SCENE
    }

    fn scene_options(&self) -> &'static [SceneOption] {
        &[SceneOption::Vehicles, SceneOption::Weather]
    }

    fn perturb(&self, generator: &mut Generator, options: &SceneOptions, start: &mut Start) {
        let map = Map::draw(generator);
        let (from, heading) = traffic::draw_way(&map, generator);
        let progress_m = generator.uniform(RESET_START_M.0, RESET_START_M.1);
        let leg = Leg { from, heading, out: heading };
        let place = |aside_m| leg.place(progress_m, aside_m);
        let (Place { position_m, heading_rad }, speed_mps) = draw_car(generator, place, start);
        let route = Route::draw(&map, from, heading, generator);
        let car = Car { position_m, heading_rad, speed_mps, leg, along_m: progress_m };
        let vehicles = traffic::draw(&map, &car, generator);
        let count = options.vehicles as usize;
        let state = State { map, route, progress_m, goals_reached: 0.0, vehicles, count };
        state.write(&mut start.userdata);
        // From a stream of its own, of which the episode's draws know nothing.
        let mut sky = Generator::from_seed(generator.next_u64());
        weather::draw(options.weather, &mut sky, &mut start.userdata[state::NUMBERS..]);
        place_vehicles(&state, &mut start.mocap_pos, &mut start.mocap_quat);
    }

    fn weather(&self, physics: &Physics) -> Option<Weather> {
        weather::read(physics.userdata().get(state::NUMBERS..)?)
    }

    fn pieces(&self, physics: &Physics) -> Option<Pieces> {
        Some(pieces::of_map(&State::read_map(physics.userdata())))
    }

    fn controls(&self, action: &[f32], controls: &mut [f64]) {
        steer_and_pedal(action, controls);
    }

    fn advance(&self, generator: &mut Generator, physics: &mut Physics) {
        let mut state = State::read(physics.userdata());
        let position_m = [physics.qpos()[0], physics.qpos()[1]];
        state.progress_m = state.route.project(position_m, state.progress_m).progress_m;
        if state.progress_m >= state.route.goal_m() {
            // On to the next goal, from the street of this one.
            let (begin_m, Leg { from, heading, .. }) = state.route.last();
            state.route = Route::draw(&state.map, from, heading, generator);
            state.progress_m -= begin_m;
            state.goals_reached += 1.0;
        }
        let car = car(physics, &state);
        traffic::advance(&mut state, &car, generator);
        state.write(physics.userdata_mut());
        let mut positions_m = [[0.0; 3]; traffic::MAX_VEHICLES];
        let mut quaternions = [[0.0; 4]; traffic::MAX_VEHICLES];
        place_vehicles(&state, &mut positions_m, &mut quaternions);
        physics.set_mocap(&positions_m, &quaternions);
    }

    fn observe(&self, physics: &Physics, observation: &mut [f64]) {
        observation.copy_from_slice(&View::of(physics).numbers());
    }

    fn position_m(&self, physics: &Physics) -> [f64; 2] {
        [physics.qpos()[0], physics.qpos()[1]]
    }

    fn outcome(&self, physics: &Physics, _: [f64; 2], _: &[f32], info: &mut [f64]) -> Outcome {
        let (state, view) = (State::read(physics.userdata()), View::of(physics));
        let has_collided = physics.has_touched();
        let is_off_road = !state.map.is_on_road(self.position_m(physics));
        info.copy_from_slice(&[
            f64::from(u8::from(has_collided)),
            f64::from(u8::from(is_off_road)),
            state.goals_reached,
            view.distance_to_goal_m,
            view.lateral_error_m,
            view.velocity_along_mps,
            view.gap_ahead_m,
        ]);
        let is_on_route = view.lateral_error_m.abs() <= ROUTE_KEPT_M;
        let pace = if is_on_route { view.velocity_along_mps } else { 0.0 };
        let terminated = has_collided || is_off_road;
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

fn place_vehicles(state: &State, positions_m: &mut [[f64; 3]], quaternions: &mut [[f64; 4]]) {
    let slots = positions_m.iter_mut().zip(quaternions);
    for (k, (position_m, orientation)) in slots.enumerate() {
        let Place { position_m: [x, y], heading_rad } =
            state.traffic().get(k).map_or_else(|| parked(k), Vehicle::place);
        *position_m = [x, y, 0.0];
        *orientation = quaternion(heading_rad);
    }
}

/// Where vehicle `k` waits while it is not there.
fn parked(k: usize) -> Place {
    Place { position_m: [k as f64 * PARKED_APART_M, PARKED_M], heading_rad: 0.0 }
}

#[cfg(test)]
mod tests;
