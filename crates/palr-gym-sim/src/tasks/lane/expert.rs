//! The controller that serves as the task's expert: a function of the state alone.

use super::{CRUISE_SPEED_MPS, NO_LEAD_GAP_M, STEERING_LIMIT_RAD, View, WHEELBASE_M};

/// Acceleration wanted for each m/s below cruising speed (1/s).
const SPEED_GAIN: f64 = 1.2;
/// The intelligent driver model (Treiber, Hennecke, Helbing 2000): gap at rest, headway, greatest
/// acceleration, comfortable deceleration.
const IDM_GAP_M: f64 = 2.5;
const IDM_HEADWAY_S: f64 = 1.0;
const IDM_ACCELERATION: f64 = 2.0;
const IDM_DECELERATION: f64 = 2.5;
const SMALLEST_GAP_M: f64 = 0.3;
/// From here down the brake is used; above, drag slows the car enough.
const COASTING: f64 = -0.3;
/// What the whole pedal does (m/s²), and the throttle that holds a speed (per m/s). Measured.
const FULL_THROTTLE: f64 = 2.8;
const FULL_BRAKE: f64 = 3.5;
const HOLDING_THROTTLE: f64 = 0.07;
const MOST_THROTTLE: f64 = 0.75;

/// Throttle or brake, and steering, each within ±1.
pub(super) fn act(view: &View) -> [f32; 2] {
    let speed = view.velocity_along_mps.hypot(view.velocity_across_mps);
    let mut acceleration = SPEED_GAIN * (CRUISE_SPEED_MPS - speed);
    if view.lead_gap_m < NO_LEAD_GAP_M {
        acceleration = acceleration.min(follow(speed, view.lead_gap_m, view.lead_speed_mps));
    }
    let pedal = if acceleration > COASTING {
        acceleration / FULL_THROTTLE + HOLDING_THROTTLE * speed
    } else {
        acceleration / FULL_BRAKE
    };
    // Pure pursuit: the circle through the rear axle and the point looked at.
    let [x, y] = view.look_ahead_m;
    let curvature = 2.0 * y.atan2(x).sin() / x.hypot(y);
    let steering = (curvature * WHEELBASE_M).atan() / STEERING_LIMIT_RAD;
    // Positive turns right.
    [pedal.clamp(-1.0, MOST_THROTTLE) as f32, (-steering).clamp(-1.0, 1.0) as f32]
}

fn follow(speed: f64, gap_m: f64, lead_speed: f64) -> f64 {
    let braking = 2.0 * (IDM_ACCELERATION * IDM_DECELERATION).sqrt();
    let wanted_gap =
        IDM_GAP_M + (speed * IDM_HEADWAY_S + speed * (speed - lead_speed) / braking).max(0.0);
    let (pace, nearness) = (speed / CRUISE_SPEED_MPS, wanted_gap / gap_m.max(SMALLEST_GAP_M));
    IDM_ACCELERATION * (1.0 - pace.powi(4) - nearness * nearness)
}
