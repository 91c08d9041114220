//! The lane task against its design.

use std::sync::Arc;

use mujoco_rs::prelude::MjtObjBase;

use super::super::driving::{QVEL_ROLL, RESET_HEADING_RAD, RESET_OFFSET_BOUND_M};
use super::*;
use crate::env::Env;
use crate::tasks::resolve_scene;

fn env(lead_car_probability: f64) -> Env {
    let options = SceneOptions { lead_car_probability, ..SceneOptions::default() };
    let (task, spec) = resolve_scene("lane", Some(options)).unwrap();
    Env::new(task, &Arc::new(spec)).unwrap()
}

/// Plays one episode and returns (return, steps, terminated, info of the last step).
fn play(
    env: &mut Env,
    seed: u64,
    mut act: impl FnMut(&Env, &mut [f32]),
) -> (f64, usize, bool, [f64; 5]) {
    env.reset(Some(seed)).unwrap();
    let (mut total, mut action, mut info) = (0.0, [0.0; 2], [0.0; 5]);
    for step in 1.. {
        act(env, &mut action);
        let transition = env.step(&action, &mut info);
        total += transition.reward;
        if transition.is_last() {
            return (total, step, transition.terminated, info);
        }
    }
    unreachable!()
}

fn drive(env: &Env, action: &mut [f32]) {
    assert!(env.controller(action));
}

#[test]
fn the_scene_that_is_checked_in_is_the_one_that_is_written() {
    assert_eq!(scene_mjcf(0), include_str!("../../../../../scenes/lane.xml"));
    assert_ne!(scene_mjcf(0), scene_mjcf(1));
}

#[test]
fn addresses_in_the_code_are_those_of_the_scene() {
    let model = SCENE.model().unwrap();
    let joint = |name: &str| model.name_to_id(MjtObjBase::mjOBJ_JOINT, name).unwrap();
    assert_eq!(model.jnt_qposadr()[joint("steer")], QPOS_STEER as i32);
    let rolls = ["fl_roll", "fr_roll", "rl_roll", "rr_roll"];
    let addresses = rolls.map(|name| model.jnt_dofadr()[joint(name)] as usize);
    assert_eq!(addresses, QVEL_ROLL);
    assert_eq!(model.ffi().nuserdata, USERDATA as i64);
    let weight: f64 =
        model.body_subtreemass()[model.name_to_id(MjtObjBase::mjOBJ_BODY, "car").unwrap()];
    assert!((weight - 1022.0).abs() < 1.0, "{weight}");
}

#[test]
fn the_expert_keeps_its_lane_and_its_distance_for_a_thousand_steps() {
    let mut env = env(0.7);
    let (mut returns, mut farthest) = (Vec::new(), 0.0_f64);
    for seed in 0..20 {
        // Four episodes' worth, without the time limit: reset only by the task itself.
        env.reset(Some(seed)).unwrap();
        let (mut total, mut action, mut info) = (0.0, [0.0; 2], [0.0; 5]);
        for step in 0..1000 {
            drive(&env, &mut action);
            let transition = env.step(&action, &mut info);
            assert!(!transition.terminated, "seed {seed}, step {step}: {info:?}");
            farthest = farthest.max(info[2].abs());
            total += if step < 250 { transition.reward } else { 0.0 };
        }
        returns.push(total);
    }
    let mean = returns.iter().sum::<f64>() / 20.0;
    assert!((800.0..1250.0).contains(&mean), "{mean} of {returns:?}");
    assert!(farthest < 1.0, "{farthest}");
}

#[test]
fn random_actions_leave_the_lane_or_get_nowhere() {
    let mut env = env(0.7);
    let mut generator = Generator::from_seed(7);
    let mut ended = 0;
    let total: f64 = (0..20)
        .map(|seed| {
            let (total, _, terminated, _) = play(&mut env, seed, |_, action| {
                action.fill_with(|| generator.uniform(-1.0, 1.0) as f32);
            });
            ended += usize::from(terminated);
            total
        })
        .sum();
    assert!(ended >= 5 && total / 20.0 < 100.0, "{ended} ended, {total}");
}

#[test]
fn leaving_the_lane_costs_a_hundred_and_ends_the_episode() {
    let mut env = env(0.0);
    let (_, steps, terminated, info) =
        play(&mut env, 0, |_, action| action.copy_from_slice(&[0.5, 0.5]));
    assert!(terminated && steps < 250);
    assert_eq!((info[0], info[1]), (0.0, 1.0));
    // To the right, as in CARLA: behind the lane's edge on the right.
    assert!(info[2] < -LANE_KEPT_M && info[2] > -LANE_KEPT_M - 0.5, "{info:?}");
    assert_eq!(info[4], NO_LEAD_GAP_M);
}

#[test]
fn driving_into_the_lead_car_ends_the_episode() {
    let mut env = env(1.0);
    // The expert's steering with the throttle down.
    let hits = (0..20)
        .filter(|&seed| {
            let (total, _, terminated, info) = play(&mut env, seed, |env, action| {
                drive(env, action);
                action[0] = 1.0;
            });
            if info[0] == 1.0 {
                // Along the middle line: in a bend the lane's own way is up to a tenth longer.
                assert!(terminated && info[4] < 1.0 && info[1] == 0.0, "{seed}: {total} {info:?}");
            }
            info[0] == 1.0
        })
        .count();
    assert!(hits >= 15, "{hits} of 20");
}

#[test]
fn an_episode_is_truncated_after_its_limit() {
    let mut env = env(0.0);
    let (_, steps, terminated, _) = play(&mut env, 3, drive);
    assert_eq!((steps, terminated), (250, false));
}

#[test]
fn resets_are_drawn_as_designed() {
    let mut env = env(0.7);
    let (mut at_rest, mut led) = (0, 0);
    for seed in 0..400 {
        env.reset(Some(seed)).unwrap();
        let view = View::from_numbers(env.full_observation()).unwrap();
        assert!(view.lateral_error_m.abs() <= RESET_OFFSET_BOUND_M + 0.01);
        assert!(view.heading_error_rad.abs() < 5.0 * RESET_HEADING_RAD);
        let speed = view.velocity_along_mps.hypot(view.velocity_across_mps);
        assert!(speed < CRUISE_SPEED_MPS);
        at_rest += usize::from(speed == 0.0);
        if view.lead_gap_m < NO_LEAD_GAP_M {
            led += 1;
            let distance_m = view.lead_gap_m + TWO_HALF_LENGTHS_M;
            assert!(
                (LEAD_START_M.0 - 0.1..LEAD_START_M.1 + 0.1).contains(&distance_m),
                "{distance_m}"
            );
        }
    }
    // Binomial: four deviations are 40 and 37.
    assert!((160..=240).contains(&at_rest), "{at_rest}");
    assert!((243..=317).contains(&led), "{led}");
}

#[test]
fn the_reward_is_the_pace_along_the_lane_within_its_bounds() {
    let mut env = env(0.0);
    env.reset(Some(1)).unwrap();
    let mut info = [0.0; 5];
    for _ in 0..200 {
        let mut action = [0.0; 2];
        drive(&env, &mut action);
        let transition = env.step(&action, &mut info);
        // From the simulation's own state, by hand.
        let (qpos, qvel) = (env.state().qpos(), env.state().qvel());
        let nearest = (0..track::SAMPLES)
            .min_by(|&a, &b| {
                let far = |i| {
                    let [x, y] = TRACK.sample_m(i, 0.0);
                    let heading = TRACK
                        .place(i as f64 * TRACK.length_m() / track::SAMPLES as f64, 0.0)
                        .heading_rad;
                    (x - qpos[0]).hypot(y - qpos[1])
                        + 100.0 * (1.0 - (heading - yaw_rad(qpos)).cos())
                };
                far(a).total_cmp(&far(b))
            })
            .unwrap();
        let [ax, ay] = TRACK.sample_m(nearest + track::SAMPLES - 1, 0.0);
        let [bx, by] = TRACK.sample_m(nearest + 1, 0.0);
        let norm = (bx - ax).hypot(by - ay);
        let (tx, ty) = ((bx - ax) / norm, (by - ay) / norm);
        let along = qvel[0] * tx + qvel[1] * ty;
        let across = (qvel[1] * tx - qvel[0] * ty).abs();
        let expected = (along - 5.0 * across).clamp(-5.0, 5.0);
        assert!((transition.reward - expected).abs() < 0.05, "{} {expected}", transition.reward);
    }
}

#[test]
fn reference_scores_are_those_of_the_episodes_beside_the_scene() {
    let text = include_str!("../../../../../scenes/lane.reference.json");
    let stored: serde_json::Value = serde_json::from_str(text).unwrap();
    let number = |policy: &str, name: &str| stored[policy][name].as_f64().unwrap();
    assert!((SPEC.reference_returns.expert - number("expert", "mean")).abs() < 0.01);
    assert!((SPEC.reference_returns.random - number("random", "mean")).abs() < 0.01);
    let mut env = env(0.7);
    for seed in 0..4 {
        let mut generator = Generator::from_seed_and_stream(seed, 1);
        let random = play(&mut env, seed, |_, action| {
            action.fill_with(|| generator.uniform(-1.0, 1.0) as f32);
        });
        let expert = play(&mut env, seed, drive);
        for (policy, (got, ..)) in [("random", random), ("expert", expert)] {
            let expected = stored[policy]["returns"][seed as usize].as_f64().unwrap();
            // Other processors may round differently; another task would be far off.
            assert!((got - expected).abs() < 1.0, "{policy}, seed {seed}: {got} {expected}");
        }
    }
}
