//! `cargo fuzz run --features libfuzzer snapshot`
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| palr_gym_fuzz::targets::snapshot::run(data));
