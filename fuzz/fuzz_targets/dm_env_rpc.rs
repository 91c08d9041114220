//! `cargo fuzz run --features libfuzzer dm_env_rpc`
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| palr_gym_fuzz::targets::dm_env_rpc::run(data));
