//! How a demonstrator drives: longitudinal and lateral control without memory.

use super::{CRUISE_SPEED_MPS, STEERING_LIMIT_RAD, WHEELBASE_M};

/// Acceleration wanted for each m/s below the speed wanted (1/s).
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

/// The acceleration towards a speed on a free road (m/s²).
pub(in crate::tasks) fn reach(speed_mps: f64, wanted_mps: f64) -> f64 {
    SPEED_GAIN * (wanted_mps - speed_mps)
}

/// The acceleration behind something that is `gap_m` ahead and moves at `lead_mps` (m/s²).
pub(in crate::tasks) fn follow(speed_mps: f64, gap_m: f64, lead_mps: f64) -> f64 {
    let braking = 2.0 * (IDM_ACCELERATION * IDM_DECELERATION).sqrt();
    let approach_m = speed_mps * (speed_mps - lead_mps) / braking;
    let wanted_gap_m = IDM_GAP_M + (speed_mps * IDM_HEADWAY_S + approach_m).max(0.0);
    let (pace, nearness) = (speed_mps / CRUISE_SPEED_MPS, wanted_gap_m / gap_m.max(SMALLEST_GAP_M));
    IDM_ACCELERATION * (1.0 - pace.powi(4) - nearness * nearness)
}

/// The action that accelerates so and steers, by pure pursuit, towards a point seen from the rear
/// axle (ahead, and to the left): throttle or brake, and steering, each within ±1.
pub(in crate::tasks) fn action(
    acceleration: f64,
    speed_mps: f64,
    look_ahead_m: [f64; 2],
) -> [f32; 2] {
    let pedal = if acceleration > COASTING {
        acceleration / FULL_THROTTLE + HOLDING_THROTTLE * speed_mps
    } else {
        acceleration / FULL_BRAKE
    };
    // The circle through the rear axle and the point looked at.
    let [x, y] = look_ahead_m;
    let curvature = 2.0 * y.atan2(x).sin() / x.hypot(y);
    let steering = (curvature * WHEELBASE_M).atan() / STEERING_LIMIT_RAD;
    // Positive turns right.
    [pedal.clamp(-1.0, MOST_THROTTLE) as f32, (-steering).clamp(-1.0, 1.0) as f32]
}
