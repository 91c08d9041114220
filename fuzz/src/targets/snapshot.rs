//! Snapshots: taken up or refused, and a refusal changes nothing.

use std::cell::RefCell;

use palr_gym_sim::snapshot::Snapshot;
use palr_gym_sim::{SimulationThreads, VectorEnv, VectorOptions, mujoco_log, resolve};

/// Where the checksum stands, and what follows is what it is of.
const CHECKSUM: std::ops::Range<usize> = 12..16;
const TAG: u8 = 3;

/// Environments that a thread restores into, over and over, and what they were at last.
struct Bench {
    env: VectorEnv,
    last: Vec<u8>,
}

thread_local! {
    static BENCH: RefCell<Bench> = RefCell::new(Bench::new());
}

impl Bench {
    fn new() -> Self {
        mujoco_log::route_to_log();
        let env = vector();
        let last = env.snapshot(TAG);
        Self { env, last }
    }
}

fn vector() -> VectorEnv {
    let (task, spec) = resolve("hopper-w2").expect("a task of ours");
    let threads = SimulationThreads::start(1).expect("a thread");
    let mut env =
        VectorEnv::new(task, spec, 2, VectorOptions::default(), threads).expect("environments");
    env.reset(&[5], &[]).expect("a reset");
    env
}

/// The last byte of an input says whether the checksum is made right again, so that what it
/// protects is tried as well.
pub fn run(data: &[u8]) {
    let Some((choice, data)) = data.split_last() else { return };
    let mut bytes = data.to_vec();
    if choice % 4 != 0 && bytes.len() > CHECKSUM.end {
        let checksum = crc32fast::hash(&bytes[CHECKSUM.end..]);
        bytes[CHECKSUM].copy_from_slice(&checksum.to_le_bytes());
    }
    let Ok(snapshot) = Snapshot::parse(&bytes) else { return };
    BENCH.with_borrow_mut(|Bench { env, last }| {
        if env.restore(&snapshot).is_ok() {
            *last = env.snapshot(TAG);
            let again = Snapshot::parse(last).expect("our own bytes");
            env.restore(&again).expect("our own state");
        }
        assert_eq!(env.snapshot(TAG), *last, "a refusal, or a second time, changed something");
    });
}

/// Snapshots in the middle of an episode and at its beginning.
#[must_use]
pub fn corpus() -> Vec<Vec<u8>> {
    mujoco_log::route_to_log();
    let mut env = vector();
    let mut frame = palr_gym_sim::StepFrame::default();
    let mut inputs = vec![[env.snapshot(TAG), vec![1]].concat()];
    for step in 0..10 {
        let action = (step as f32 - 5.0) / 6.0;
        env.step(&[action; 6], &mut frame).expect("a step");
    }
    inputs.push([env.snapshot(TAG), vec![1]].concat());
    inputs.push([env.snapshot(TAG), vec![0]].concat());
    inputs
}
