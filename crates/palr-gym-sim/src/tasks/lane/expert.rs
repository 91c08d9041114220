//! The controller that serves as the task's expert: a function of the state alone.

use super::super::driving::{CRUISE_SPEED_MPS, control};
use super::{NO_LEAD_GAP_M, View};

/// Throttle or brake, and steering, each within ±1.
pub(super) fn act(view: &View) -> [f32; 2] {
    let speed = view.velocity_along_mps.hypot(view.velocity_across_mps);
    let mut acceleration = control::reach(speed, CRUISE_SPEED_MPS);
    if view.lead_gap_m < NO_LEAD_GAP_M {
        acceleration =
            acceleration.min(control::follow(speed, view.lead_gap_m, view.lead_speed_mps));
    }
    control::action(acceleration, speed, view.look_ahead_m)
}
