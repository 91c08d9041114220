//! A million executions of each target, from a fixed seed.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "a test may stop where it stands")]

use std::alloc::System;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Mutex, PoisonError};

use palr_gym_fuzz::mutate::Mutator;
use palr_gym_fuzz::targets::{decode, dm_env_rpc, snapshot};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// How often, unless the variable says otherwise: a zero more for a long night, a zero less to debug.
const EXECUTIONS: u64 = 1_000_000;
const VARIABLE: &str = "PALR_GYM_FUZZ_EXECUTIONS";
/// What an execution may allocate in all, freed or not: this, and so many bytes for each of its input.
const ALLOWED_BYTES: usize = 256 << 10;
const ALLOWED_TIMES: usize = 64;

/// Allocations are counted for the whole process: where tests share one, they take turns.
static TURN: Mutex<()> = Mutex::new(());

/// Runs a target on mutations of its corpus.
fn run(name: &str, corpus: &[Vec<u8>], target: fn(&[u8])) {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let mut mutator = Mutator::new(0x5eed);
    let mut input = Vec::new();
    for valid in corpus {
        target(valid);
    }
    let executions = std::env::var(VARIABLE).map_or(EXECUTIONS, |text| text.parse().unwrap());
    for execution in 0..executions {
        mutator.mutate(corpus, &mut input);
        let region = Region::new(ALLOCATOR);
        let outcome = catch_unwind(AssertUnwindSafe(|| target(&input)));
        assert!(outcome.is_ok(), "{name}, execution {execution}, panicked on {input:02x?}");
        let allocated = region.change().bytes_allocated;
        let allowed = ALLOWED_BYTES + ALLOWED_TIMES * input.len();
        assert!(
            allocated <= allowed,
            "{name}, execution {execution}, allocated {allocated} bytes for {input:02x?}"
        );
    }
}

#[test]
fn decode_survives_a_million_executions() {
    run("decode", &decode::corpus(), decode::run);
}

#[test]
fn dm_env_rpc_survives_a_million_executions() {
    run("dm_env_rpc", &dm_env_rpc::corpus(), dm_env_rpc::run);
}

#[test]
fn snapshot_survives_a_million_executions() {
    run("snapshot", &snapshot::corpus(), snapshot::run);
}
