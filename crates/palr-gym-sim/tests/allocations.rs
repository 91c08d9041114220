//! In the steady state a step allocates nothing, autoresets included, on any thread.
//!
//! The only test of this file: the allocator counts for the whole process.
#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]

use std::alloc::System;

use palr_gym_core::{AutoresetMode, OutOfBounds};
use palr_gym_sim::tasks::TASKS;
use palr_gym_sim::{SimulationThreads, StepFrame, VectorEnv, VectorOptions, resolve};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const STEPS: usize = 60;
/// Plays in which threads may set something up.
const BUSY: usize = 4;

#[test]
fn a_step_allocates_nothing() {
    let threads = SimulationThreads::start(3).unwrap();
    for task in TASKS {
        for autoreset_mode in [AutoresetMode::NextStep, AutoresetMode::SameStep] {
            let env_id = format!("{}-full-w3", task.spec().name);
            let (task, spec) = resolve(&env_id).unwrap();
            let row = 12 * spec.action_size();
            let options = VectorOptions { autoreset_mode, out_of_bounds: OutOfBounds::Clip };
            let mut vector = VectorEnv::new(task, spec, 12, options, threads.clone()).unwrap();
            vector.reset(&[0], &[]).unwrap();
            let actions: Vec<f32> =
                (0..row * STEPS).map(|i| ((i * 37 % 41) as f32 - 20.0) / 19.0).collect();
            let (mut frame, mut ends) = (StepFrame::default(), 0);
            let mut play = |vector: &mut VectorEnv| {
                for actions in actions.chunks_exact(row) {
                    vector.step(actions, &mut frame).unwrap();
                    ends += frame.terminated.iter().filter(|ended| **ended).count();
                }
            };
            // Buffers grow to their size in the first step, and a thread sets up its workbench when it
            // first has a part of the work, which on a busy machine may be late.
            play(&mut vector);
            let mut measured = || {
                let region = Region::new(ALLOCATOR);
                play(&mut vector);
                region.change()
            };
            let mut change = measured();
            for _ in 0..BUSY {
                if change.allocations > 0 {
                    change = measured();
                }
            }
            let name = vector.spec().task.name;
            assert_eq!((change.allocations, change.reallocations), (0, 0), "{name}: {change:?}");
            assert!(ends > 0 || !["hopper", "walker2d"].contains(&name), "{name}: no reset");
        }
    }
}
