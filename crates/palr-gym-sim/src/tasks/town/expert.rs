//! The roaming demonstrator: a function of the state alone, which tells it where its route goes.

use super::super::driving::{CRUISE_SPEED_MPS, control};
use super::{NOTHING_AHEAD_M, View, speed_before_turn};

/// How much nearer than the driver model's distance at rest the car stops before a junction.
const LINE_SLACK_M: f64 = 1.5;

/// Throttle or brake, and steering, each within ±1.
pub(super) fn act(view: &View) -> [f32; 2] {
    let speed = view.velocity_along_mps.hypot(view.velocity_across_mps);
    let wanted = CRUISE_SPEED_MPS.min(speed_before_turn(view.turn_distance_m));
    let mut acceleration = control::reach(speed, wanted);
    if view.gap_ahead_m < NOTHING_AHEAD_M {
        acceleration =
            acceleration.min(control::follow(speed, view.gap_ahead_m, view.speed_ahead_mps));
    }
    if view.stop_gap_m < NOTHING_AHEAD_M {
        let gap_m = view.stop_gap_m + LINE_SLACK_M;
        acceleration = acceleration.min(control::follow(speed, gap_m, 0.0));
    }
    control::action(acceleration, speed, view.look_ahead_m)
}
