//! What the driving tasks have in common: the car, its scene's furniture, weather, a demonstrator's
//! control.

pub(super) mod control;
pub(super) mod mesh;
pub(super) mod mjcf;
pub(super) mod weather;

use std::f64::consts::{PI, TAU};

use palr_gym_core::random::Generator;

use crate::physics::Start;

pub(super) const LANE_WIDTH_M: f64 = 3.5;
pub(super) const WHEELBASE_M: f64 = 2.6;
pub(super) const WHEEL_RADIUS_M: f64 = 0.32;
pub(super) const CAR_HALF_LENGTH_M: f64 = 1.9;
/// From one car's middle to the other's when their bumpers touch.
pub(super) const TWO_HALF_LENGTHS_M: f64 = 2.0 * CAR_HALF_LENGTH_M;
pub(super) const STEERING_LIMIT_RAD: f64 = 0.61;
/// 20 km/h.
pub(super) const CRUISE_SPEED_MPS: f64 = 5.56;
/// Simulated seconds in a physics step.
pub(super) const FRAME_STEP_S: f64 = 0.01;
/// Physics steps in a step.
pub(super) const FRAME_SKIP: u32 = 5;
pub(super) const STEP_S: f64 = FRAME_STEP_S * FRAME_SKIP as f64;

/// A reward is within ± this, but for an end.
pub(super) const REWARD_BOUND: f64 = 5.0;
/// For a collision, or for leaving what is to be kept to.
pub(super) const END_REWARD: f64 = -100.0;

const RESET_OFFSET_M: f64 = 0.2;
pub(super) const RESET_OFFSET_BOUND_M: f64 = 0.5;
pub(super) const RESET_HEADING_RAD: f64 = 0.035;
const RESET_AT_REST_PROBABILITY: f64 = 0.5;

/// Addresses in qpos and qvel; the tasks' tests hold them to their scenes.
pub(super) const QPOS_STEER: usize = 7;
pub(super) const QVEL_YAW: usize = 5;
pub(super) const QVEL_ROLL: [usize; 4] = [9, 12, 14, 16];

/// A place on a road and the direction of travel there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    pub(super) position_m: [f64; 2],
    pub(super) heading_rad: f64,
}

/// The car's heading.
pub(super) fn yaw_rad(qpos: &[f64]) -> f64 {
    let (w, x, y, z) = (qpos[3], qpos[4], qpos[5], qpos[6]);
    (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
}

/// A turn about the vertical.
pub(super) fn quaternion(heading_rad: f64) -> [f64; 4] {
    [(heading_rad / 2.0).cos(), 0.0, 0.0, (heading_rad / 2.0).sin()]
}

/// The same angle in (-π, π].
pub(super) fn wrap_angle(angle_rad: f64) -> f64 {
    PI - (PI - angle_rad).rem_euclid(TAU)
}

/// A point as the rear axle sees it: ahead, and to the left.
pub(super) fn from_rear_axle(qpos: &[f64], target_m: [f64; 2]) -> [f64; 2] {
    let (sin, cos) = yaw_rad(qpos).sin_cos();
    let from_rear = [
        target_m[0] - (qpos[0] - WHEELBASE_M / 2.0 * cos),
        target_m[1] - (qpos[1] - WHEELBASE_M / 2.0 * sin),
    ];
    [from_rear[0] * cos + from_rear[1] * sin, from_rear[1] * cos - from_rear[0] * sin]
}

/// The car's velocity along a direction, and across it to the left.
pub(super) fn along_and_across(qvel: &[f64], [along_x, along_y]: [f64; 2]) -> [f64; 2] {
    [qvel[0] * along_x + qvel[1] * along_y, qvel[1] * along_x - qvel[0] * along_y]
}

/// Begins an episode a little aside and askew of where `place` says, given how far aside to the left;
/// at rest, or on its way. Tells where the car is and how fast.
pub(super) fn draw_car(
    generator: &mut Generator,
    place: impl FnOnce(f64) -> Place,
    start: &mut Start,
) -> (Place, f64) {
    let aside_m = (RESET_OFFSET_M * generator.standard_normal())
        .clamp(-RESET_OFFSET_BOUND_M, RESET_OFFSET_BOUND_M);
    let Place { position_m, heading_rad } = place(aside_m);
    let heading_rad = heading_rad + RESET_HEADING_RAD * generator.standard_normal();
    let is_at_rest = generator.next_f64() < RESET_AT_REST_PROBABILITY;
    let speed_mps = generator.uniform(0.0, CRUISE_SPEED_MPS) * f64::from(u8::from(!is_at_rest));
    place_car(position_m, heading_rad, speed_mps, start);
    (Place { position_m, heading_rad }, speed_mps)
}

/// Puts the car there, with its wheels rolling.
fn place_car(position_m: [f64; 2], heading_rad: f64, speed_mps: f64, start: &mut Start) {
    start.qpos[..2].copy_from_slice(&position_m);
    // The scene's own height is where the car is drawn; its springs carry it from the ground.
    start.qpos[2] = 0.0;
    start.qpos[3..7].copy_from_slice(&quaternion(heading_rad));
    start.qvel[0] = speed_mps * heading_rad.cos();
    start.qvel[1] = speed_mps * heading_rad.sin();
    for wheel in QVEL_ROLL {
        start.qvel[wheel] = speed_mps / WHEEL_RADIUS_M;
    }
}

/// What an action asks of throttles, brakes and steering.
pub(super) fn steer_and_pedal(action: &[f32], controls: &mut [f64]) {
    let (pedal, steer) = (f64::from(action[0]), f64::from(action[1]));
    let (throttle, brake) = (pedal.max(0.0), (-pedal).max(0.0));
    controls[..2].fill(throttle);
    controls[2..6].fill(brake);
    controls[6] = -steer * STEERING_LIMIT_RAD;
}
