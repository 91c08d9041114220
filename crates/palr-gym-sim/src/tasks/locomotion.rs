//! What Gymnasium's locomotion tasks share, down to the order of additions.

use palr_gym_core::random::Generator;
use palr_gym_core::{Fidelity, TaskSpec};

use super::Outcome;
use crate::physics::Physics;

/// `weight * sum(square(action))` as NumPy computes it for float32 actions: everything in f32;
/// fewer than eight terms are added left to right, eight pairwise.
///
/// Other lengths do not occur: the tasks have 3, 6 and 8 actuators.
pub(super) fn control_cost(weight: f32, action: &[f32]) -> f32 {
    let sum = match *action {
        [a, b, c, d, e, f, g, h] => {
            ((a * a + b * b) + (c * c + d * d)) + ((e * e + f * f) + (g * g + h * h))
        }
        _ => action.iter().map(|entry| entry * entry).sum(),
    };
    weight * sum
}

/// What hopper and walker2d pay: velocity along the track and an alive bonus of 1, minus the control
/// cost. `-v4` pays the bonus on the failing step too.
pub(super) fn forward_outcome(
    spec: &TaskSpec,
    physics: &Physics,
    before_m: [f64; 2],
    control_cost: f32,
    is_healthy: bool,
    info: &mut [f64],
) -> Outcome {
    const HEALTHY_REWARD: f64 = 1.0;
    let x_position = physics.qpos()[0];
    let x_velocity = (x_position - before_m[0]) / spec.control_timestep_s();
    let cost = f64::from(control_cost);
    let reward = match spec.fidelity {
        Fidelity::Gym4 => {
            info.copy_from_slice(&[x_position, x_velocity]);
            (x_velocity + HEALTHY_REWARD) - cost
        }
        Fidelity::Gym5 => {
            let healthy_reward = if is_healthy { HEALTHY_REWARD } else { 0.0 };
            forward_reset_info(spec, physics, &mut info[..2]);
            info[2..].copy_from_slice(&[x_velocity, x_velocity, -cost, healthy_reward]);
            (x_velocity + healthy_reward) - cost
        }
    };
    Outcome { reward, terminated: !is_healthy }
}

/// What hopper and walker2d report of a reset: only `-v5` does.
pub(super) fn forward_reset_info(spec: &TaskSpec, physics: &Physics, info: &mut [f64]) {
    if spec.fidelity == Fidelity::Gym5 {
        let height_m = physics.qpos()[1] - physics.initial_qpos()[1];
        info.copy_from_slice(&[physics.qpos()[0], height_m]);
    }
}

/// Adds U(-scale, scale) to each entry.
pub(super) fn add_uniform(generator: &mut Generator, scale: f64, values: &mut [f64]) {
    for value in values {
        *value += generator.uniform(-scale, scale);
    }
}

/// Adds scale * N(0, 1) to each entry.
pub(super) fn add_normal(generator: &mut Generator, scale: f64, values: &mut [f64]) {
    for value in values {
        *value += scale * generator.standard_normal();
    }
}

/// Writes `qpos[skip..]`, then qvel clipped to ± `velocity_bound`.
pub(super) fn observe(
    qpos: &[f64],
    skip: usize,
    qvel: &[f64],
    velocity_bound: f64,
    observation: &mut [f64],
) {
    let (positions, velocities) = observation.split_at_mut(qpos.len() - skip);
    positions.copy_from_slice(&qpos[skip..]);
    for (slot, &velocity) in velocities.iter_mut().zip(qvel) {
        // `clamp` keeps NaN, as NumPy's clip does.
        *slot = velocity.clamp(-velocity_bound, velocity_bound);
    }
}

/// True if `low < value < high`; false for NaN.
pub(super) fn is_within(value: f64, low: f64, high: f64) -> bool {
    low < value && value < high
}
