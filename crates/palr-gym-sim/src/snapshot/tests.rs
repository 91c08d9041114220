//! A snapshot is the whole state, and nothing else passes for one.

use palr_gym_core::random::Generator;
use proptest::prelude::*;

use super::*;
use crate::error::SimError;
use crate::tasks::resolve;
use crate::threads::SimulationThreads;
use crate::vector::{StepFrame, VectorEnv};

fn vector(env_id: &str, num_envs: usize, autoreset_mode: AutoresetMode) -> VectorEnv {
    let (task, spec) = resolve(env_id).unwrap();
    let options = VectorOptions { autoreset_mode, ..VectorOptions::default() };
    VectorEnv::new(task, spec, num_envs, options, SimulationThreads::start(2).unwrap()).unwrap()
}

fn actions(step: usize, count: usize) -> Vec<f32> {
    let mut generator = Generator::from_seed(step as u64);
    (0..count).map(|_| generator.uniform(-1.0, 1.0) as f32).collect()
}

/// Everything that steps return, with NaN equal to itself and without rows that mean nothing.
fn play(vector: &mut VectorEnv, steps: std::ops::Range<usize>) -> Vec<String> {
    let count = vector.len() * vector.spec().action_size();
    let (size, num_envs) = (vector.spec().observation_size(), vector.len());
    let mut frame = StepFrame::default();
    steps
        .map(|step| {
            vector.step(&actions(step, count), &mut frame).unwrap();
            let finals: Vec<_> = (0..num_envs)
                .filter(|&i| frame.terminated[i] || frame.truncated[i])
                .map(|i| frame.final_observations.get(i * size..(i + 1) * size))
                .collect();
            let StepFrame { observations, rewards, terminated, truncated, info, .. } = &frame;
            format!("{observations:?} {rewards:?} {terminated:?} {truncated:?} {info:?} {finals:?}")
        })
        .collect()
}

/// Snapshots after so many steps; what follows is what followed the original.
fn check(env_id: &str, cuts: &[usize]) {
    for mode in [AutoresetMode::NextStep, AutoresetMode::SameStep] {
        let mut original = vector(env_id, 4, mode);
        original.reset(&[3], &[]).unwrap();
        for &cut in cuts {
            original.reset(&[3], &[]).unwrap();
            play(&mut original, 0..cut);
            let snapshot = original.snapshot(7);
            assert_eq!(snapshot.len(), original.snapshot_len());
            let expected = play(&mut original, cut..cut + 40);
            let mut other = vector(env_id, 4, mode);
            let parsed = Snapshot::parse(&snapshot).unwrap();
            assert_eq!((parsed.tag, parsed.was_reset), (7, true));
            other.restore(&parsed).unwrap();
            assert!(other.snapshot(7) == snapshot, "{env_id}");
            assert!(play(&mut other, cut..cut + 40) == expected, "{env_id}, step {cut}");
            // Back in the one that went on meanwhile.
            original.restore(&parsed).unwrap();
            assert!(play(&mut original, cut..cut + 40) == expected, "{env_id}, step {cut}");
        }
    }
}

#[test]
fn what_follows_a_snapshot_is_what_followed_the_original() {
    // Snapshots of every moment, of ends and due resets too.
    let cuts = [0, 1, 17, 18, 19, 20, 21, 22, 23, 24, 25, 60];
    for env_id in
        ["hopper-w3", "walker2d-gym5", "halfcheetah-strict-w2", "ant-w4", "ant-gym5", "toy-w2"]
    {
        check(env_id, &cuts);
    }
}

#[test]
fn what_follows_a_snapshot_of_a_drive_is_what_followed_the_original() {
    // A car's episodes do not end as soon, and its steps take longer.
    check("lane", &[0, 25]);
    check("town", &[25]);
}

#[test]
fn a_vector_that_was_never_reset_stays_so() {
    let mut left = vector("hopper", 1, AutoresetMode::NextStep);
    let snapshot = vector("hopper", 1, AutoresetMode::NextStep).snapshot(0);
    left.reset(&[0], &[]).unwrap();
    left.restore(&Snapshot::parse(&snapshot).unwrap()).unwrap();
    assert_eq!(left.step(&[0.0; 3], &mut StepFrame::default()), Err(SimError::NeverReset));
}

#[test]
fn a_snapshot_of_something_else_is_refused_and_changes_nothing() {
    let mut ours = vector("hopper-w2", 2, AutoresetMode::NextStep);
    ours.reset(&[0], &[]).unwrap();
    let before = ours.snapshot(0);
    for (other, what) in [
        (vector("hopper-w3", 2, AutoresetMode::NextStep), "environment is \"hopper-w3-v0\""),
        (vector("hopper-w2", 3, AutoresetMode::NextStep), "num_envs is 3; expected 2"),
        (vector("hopper-w2", 2, AutoresetMode::SameStep), "autoreset mode is SameStep"),
        (vector("hopper-gym5-w2", 2, AutoresetMode::NextStep), "expected \"hopper-w2-v0\""),
    ] {
        let snapshot = other.snapshot(0);
        let error = ours.restore(&Snapshot::parse(&snapshot).unwrap()).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
        assert_eq!(ours.snapshot(0), before);
    }
}

/// Parses and, as the server would, restores.
fn take(bytes: &[u8], ours: &mut VectorEnv) -> Result<(), SimError> {
    ours.restore(&Snapshot::parse(bytes)?)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_bytes_break_the_reader(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(Snapshot::parse(&bytes).is_err());
    }

    /// Damage behind a right checksum: refused or taken, but never a panic.
    #[test]
    fn no_forgery_breaks_the_reader(
        changes in prop::collection::vec((0..2000usize, any::<u8>()), 0..6), cut in 0..3000usize,
        is_sealed in any::<bool>(),
    ) {
        let mut ours = vector("hopper", 2, AutoresetMode::NextStep);
        ours.reset(&[0], &[]).unwrap();
        let original = ours.snapshot(0);
        let mut bytes = original.clone();
        bytes.truncate(cut.max(16));
        for (at, value) in changes {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        let is_changed = bytes != original;
        if is_sealed {
            seal(&mut bytes);
        }
        let taken = take(&bytes, &mut ours);
        prop_assert!(!is_changed || is_sealed || taken.is_err());
        // Whatever was taken, the environments are good for a reset and a step.
        ours.reset(&[0], &[]).unwrap();
        ours.step(&[0.0; 6], &mut StepFrame::default()).unwrap();
    }

    #[test]
    fn a_forged_state_ends_episodes_at_most(values in prop::collection::vec(any::<f64>(), 40)) {
        let mut ours = vector("hopper", 1, AutoresetMode::NextStep);
        ours.reset(&[0], &[]).unwrap();
        let mut bytes = ours.snapshot(0);
        let begin = bytes.len() - Snapshot::parse(&bytes).unwrap().envs.len();
        for (i, value) in values.iter().enumerate() {
            let at = begin + 8 * i;
            bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
        }
        seal(&mut bytes);
        if take(&bytes, &mut ours).is_ok() {
            for _ in 0..3 {
                ours.step(&[0.0; 3], &mut StepFrame::default()).unwrap();
            }
        }
    }
}
