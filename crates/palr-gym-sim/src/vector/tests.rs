//! Vector semantics. Equality with Gymnasium itself is tested from Python.

use palr_gym_core::random::Generator;

use super::*;
use crate::tasks::resolve;

fn vector(env_id: &str, num_envs: usize, threads: usize, options: VectorOptions) -> VectorEnv {
    let (task, spec) = resolve(env_id).unwrap();
    let threads = SimulationThreads::start(threads).unwrap();
    VectorEnv::new(task, spec, num_envs, options, threads).unwrap()
}

fn with_mode(autoreset_mode: AutoresetMode) -> VectorOptions {
    VectorOptions { autoreset_mode, ..VectorOptions::default() }
}

/// Actions of environment `index`, the same whatever vector it is in.
fn actions(index: usize, step: usize, size: usize) -> Vec<f32> {
    let mut generator = Generator::from_seed_and_stream(index as u64, step as u64);
    (0..size).map(|_| generator.uniform(-1.0, 1.0) as f32).collect()
}

#[test]
fn bits_do_not_depend_on_the_number_of_environments_or_threads() {
    for task in crate::tasks::TASKS {
        let name = format!("{}-{}-w2", task.spec().name, task.spec().masks().last().unwrap());
        let mut wide = vector(&name, 7, 3, with_mode(AutoresetMode::NextStep));
        wide.reset(&[40], &[]).unwrap();
        let mut narrow: Vec<VectorEnv> =
            (0..7).map(|_| vector(&name, 1, 1, with_mode(AutoresetMode::NextStep))).collect();
        for (i, vector) in narrow.iter_mut().enumerate() {
            vector.reset(&[40 + i as u64], &[]).unwrap();
        }
        let (mut frame, mut one) = (StepFrame::default(), StepFrame::default());
        let (size, action_size) = (wide.spec().observation_size(), wide.spec().action_size());
        let mut ends = 0;
        for step in 0..120 {
            let rows: Vec<f32> = (0..7).flat_map(|i| actions(i, step, action_size)).collect();
            wide.step(&rows, &mut frame).unwrap();
            for (i, vector) in narrow.iter_mut().enumerate() {
                vector.step(&actions(i, step, action_size), &mut one).unwrap();
                let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
                assert_eq!(
                    bits(&frame.observations[i * size..(i + 1) * size]),
                    bits(&one.observations)
                );
                assert_eq!(frame.rewards[i].to_bits(), one.rewards[0].to_bits());
                assert_eq!(frame.terminated[i], one.terminated[0]);
                ends += usize::from(one.terminated[0]);
            }
        }
        assert!(ends > 0 || !["hopper", "walker2d"].contains(&task.spec().name));
    }
}

#[test]
fn next_step_autoreset_ignores_one_action_and_pays_nothing() {
    let mut vector = vector("hopper", 1, 1, with_mode(AutoresetMode::NextStep));
    vector.reset(&[0], &[]).unwrap();
    let mut frame = StepFrame::default();
    while !frame.terminated.first().copied().unwrap_or(false) {
        vector.step(&[1.0, -1.0, 1.0], &mut frame).unwrap();
    }
    let last = frame.observations.clone();
    vector.step(&[1.0, -1.0, 1.0], &mut frame).unwrap();
    assert_ne!(frame.observations, last);
    assert_eq!((frame.rewards[0], frame.terminated[0], frame.truncated[0]), (0.0, false, false));
    assert!(frame.info.iter().all(|value| value.is_nan()));
}

#[test]
fn same_step_autoreset_hands_out_the_final_observation_beside_the_new_one() {
    let mut next = vector("hopper-w2", 1, 1, with_mode(AutoresetMode::NextStep));
    let mut same = vector("hopper-w2", 1, 1, with_mode(AutoresetMode::SameStep));
    let (mut a, mut b) = (StepFrame::default(), StepFrame::default());
    next.reset(&[3], &[]).unwrap();
    same.reset(&[3], &[]).unwrap();
    while !a.terminated.first().copied().unwrap_or(false) {
        next.step(&[1.0, -1.0, 1.0], &mut a).unwrap();
        same.step(&[1.0, -1.0, 1.0], &mut b).unwrap();
    }
    assert!(b.terminated[0]);
    assert_eq!((&b.final_observations, &b.info), (&a.observations, &a.info));
    next.step(&[0.0; 3], &mut a).unwrap();
    assert_eq!(b.observations, a.observations);
}

#[test]
fn disabled_autoreset_refuses_a_step_until_the_ended_environment_is_reset() {
    let mut vector = vector("hopper", 2, 1, with_mode(AutoresetMode::Disabled));
    vector.reset(&[0], &[]).unwrap();
    let mut frame = StepFrame::default();
    let rows = [1.0, -1.0, 1.0, 0.0, 0.0, 0.0];
    while !frame.terminated.first().copied().unwrap_or(false) {
        vector.step(&rows, &mut frame).unwrap();
    }
    let before = frame.clone();
    assert_eq!(vector.step(&rows, &mut frame), Err(SimError::ResetNeeded { env_index: 0 }));
    assert_eq!(frame.observations, before.observations);
    vector.reset(&[], &[0]).unwrap();
    vector.step(&rows, &mut frame).unwrap();
}

#[test]
fn a_refused_step_changes_nothing() {
    let mut left = vector("hopper", 2, 1, VectorOptions::default());
    let mut right = vector("hopper", 2, 1, VectorOptions::default());
    left.reset(&[5], &[]).unwrap();
    right.reset(&[5], &[]).unwrap();
    let (mut a, mut b) = (StepFrame::default(), StepFrame::default());
    for (bad, expected) in [
        (vec![0.0; 5], "actions hold 5 numbers; expected 2 x 3"),
        (vec![0.0, 0.0, 0.0, 0.0, f32::NAN, 0.0], "environment 1 has NaN at index 1 (leg_joint)"),
        (vec![0.0, 0.0, 1.5, 0.0, 0.0, 0.0], "environment 0 has 1.5 at index 2 (foot_joint)"),
        (vec![f32::INFINITY; 6], "environment 0 has inf at index 0"),
    ] {
        let error = left.step(&bad, &mut a).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    assert!(left.reset(&[1, 2, 3], &[]).is_err());
    assert!(left.reset(&[], &[1, 1]).is_err());
    assert!(left.reset(&[], &[2]).is_err());
    left.step(&[0.5; 6], &mut a).unwrap();
    right.step(&[0.5; 6], &mut b).unwrap();
    assert_eq!(a.observations, b.observations);
}

#[test]
fn clip_acts_before_dynamics_and_control_cost_and_raw_does_not() {
    let step = |out_of_bounds, entry: f32| {
        let options = VectorOptions { out_of_bounds, ..VectorOptions::default() };
        let mut vector = vector("hopper", 1, 1, options);
        vector.reset(&[0], &[]).unwrap();
        let mut frame = StepFrame::default();
        vector.step(&[entry; 3], &mut frame).unwrap();
        (frame.observations, frame.rewards[0])
    };
    let bounded = step(OutOfBounds::Reject, 1.0);
    assert_eq!(step(OutOfBounds::Clip, 3.0), bounded);
    // MuJoCo limits the control itself, so only the cost differs: 1e-3 * 3 * (9 - 1).
    let raw = step(OutOfBounds::Raw, 3.0);
    assert_eq!(raw.0, bounded.0);
    assert!((bounded.1 - raw.1 - 0.024).abs() < 1e-8);
}

#[test]
fn stepping_before_the_first_reset_is_refused() {
    let mut vector = vector("ant", 1, 1, VectorOptions::default());
    assert_eq!(vector.step(&[0.0; 8], &mut StepFrame::default()), Err(SimError::NeverReset));
}

#[test]
fn an_open_loop_is_the_same_as_single_steps() {
    for mode in [AutoresetMode::NextStep, AutoresetMode::SameStep] {
        // More environments than pieces, so that pieces have several.
        for (env_id, num_envs, steps) in [("hopper-w2", 3, 50), ("hopper", 300, 24)] {
            let mut single = vector(env_id, num_envs, 2, with_mode(mode));
            let mut open = vector(env_id, num_envs, 2, with_mode(mode));
            single.reset(&[1], &[]).unwrap();
            open.reset(&[1], &[]).unwrap();
            let rows: Vec<f32> = (0..steps)
                .flat_map(|step| (0..num_envs).flat_map(move |i| actions(i, step, 3)))
                .collect();
            let (mut a, mut b) = (StepFrame::default(), StepFrame::default());
            open.step_open_loop(&rows, steps, &mut b).unwrap();
            assert_eq!((b.steps, b.rewards.len()), (steps, steps * num_envs));
            let size = single.spec().observation_size();
            for (step, row) in rows.chunks_exact(num_envs * 3).enumerate() {
                single.step(row, &mut a).unwrap();
                let envs = step * num_envs..(step + 1) * num_envs;
                let wide = envs.start * size..envs.end * size;
                assert_eq!(a.observations, b.observations[wide.clone()]);
                assert_eq!(a.rewards, b.rewards[envs.clone()]);
                assert_eq!(a.terminated, b.terminated[envs.clone()]);
                let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
                assert_eq!(bits(&a.info), bits(&b.info[envs.start * 2..envs.end * 2]));
                if mode == AutoresetMode::SameStep {
                    for (i, _) in a.terminated.iter().enumerate().filter(|(_, ended)| **ended) {
                        let row =
                            |frame: &[f64], i: usize| frame[i * size..(i + 1) * size].to_vec();
                        assert_eq!(
                            row(&a.final_observations, i),
                            row(&b.final_observations, envs.start + i)
                        );
                    }
                }
            }
            assert!(b.terminated.iter().any(|ended| *ended));
            // And both stand at the same place.
            let (mut x, mut y) = (Vec::new(), Vec::new());
            single.observations_into(&mut x);
            open.observations_into(&mut y);
            assert_eq!(x, y);
        }
    }
}

#[test]
fn an_open_loop_without_autoreset_ends_with_the_first_end() {
    let mut single = vector("hopper", 2, 2, with_mode(AutoresetMode::Disabled));
    let mut open = vector("hopper", 2, 2, with_mode(AutoresetMode::Disabled));
    single.reset(&[0], &[]).unwrap();
    open.reset(&[0], &[]).unwrap();
    let row = [1.0, -1.0, 1.0, 0.0, 0.0, 0.0];
    let (mut a, mut b) = (StepFrame::default(), StepFrame::default());
    open.step_open_loop(&row.repeat(100), 100, &mut b).unwrap();
    let mut steps = 0;
    while !a.terminated.first().copied().unwrap_or(false) {
        single.step(&row, &mut a).unwrap();
        steps += 1;
    }
    assert_eq!((b.steps, b.rewards.len(), b.observations.len()), (steps, 2 * steps, 22 * steps));
    assert_eq!(b.observations[22 * (steps - 1)..], a.observations);
    assert!(steps < 100);
}

#[test]
fn a_refused_open_loop_takes_no_step() {
    let mut left = vector("hopper", 1, 1, VectorOptions::default());
    let mut right = vector("hopper", 1, 1, VectorOptions::default());
    left.reset(&[5], &[]).unwrap();
    right.reset(&[5], &[]).unwrap();
    let (mut a, mut b) = (StepFrame::default(), StepFrame::default());
    for bad in [&[0.0, 0.0, 0.0, 0.0, 0.0, 2.0][..], &[0.0; 5], &[]] {
        assert!(left.step_open_loop(bad, 2, &mut a).is_err());
    }
    assert!(left.step_open_loop(&[], 0, &mut a).is_err());
    left.step(&[0.5; 3], &mut a).unwrap();
    right.step(&[0.5; 3], &mut b).unwrap();
    assert_eq!(a.observations, b.observations);
}
