//! From a recording to a policy that the server evaluates.
#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]

use std::path::Path;
use std::process::{Command, Output, Stdio};

fn palr_gym(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_palr-gym"))
        .args(arguments)
        .current_dir(folder)
        .env_remove("PALR_GYM_SERVER")
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

#[track_caller]
fn succeed(folder: &Path, arguments: &[&str]) -> serde_json::Value {
    let output = palr_gym(folder, arguments);
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {text}");
    serde_json::from_slice(&output.stdout).unwrap()
}

const TRAIN: &[&str] = &[
    "train",
    "--env",
    "hopper-w2",
    "--data",
    "a.hdf5",
    "--training-rows",
    "1500",
    "--held-out-rows",
    "200",
    "--batch",
    "64",
    "--steps",
    "30",
    "--log-every",
    "10",
    "--json",
];

fn record(folder: &Path) {
    let collect = ["collect", "--env", "hopper", "--policy", "random", "--transitions", "2500"];
    succeed(folder, &[&collect[..], &["--out", "a.hdf5", "--json"]].concat());
}

#[test]
fn a_recording_becomes_a_policy_that_the_server_evaluates_and_measures() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    for more in [&["--algorithm", "bc"][..], &["--alpha", "10", "--weights", "pool"], &[]] {
        let report = succeed(folder.path(), &[TRAIN, more].concat());
        assert_eq!((&report["is_complete"], &report["step"]), (&true.into(), &30.into()));
        let policy = report["policy"].as_str().unwrap();
        let evaluate = ["evaluate", "--env", "hopper-w2", "--episodes", "2", "--json", "--policy"];
        succeed(folder.path(), &[&evaluate[..], &[policy]].concat());
        let leakage = ["leakage", "--env", "hopper-w2", "--data", "a.hdf5", "--rows", "100"];
        let measured =
            succeed(folder.path(), &[&leakage[..], &["--json", "--policy", policy]].concat());
        assert!(measured["hscic"].as_f64().unwrap() > 0.0);
        let metrics = Path::new(report["run_folder"].as_str().unwrap()).join("metrics.jsonl");
        let lines = std::fs::read_to_string(folder.path().join(metrics)).unwrap();
        assert_eq!(lines.lines().count(), 3);
    }
}

#[test]
fn equal_seeds_give_equal_policies_and_other_seeds_do_not() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    let policy = |seed: &str| {
        let report = succeed(folder.path(), &[TRAIN, &["--seed", seed]].concat());
        std::fs::read(folder.path().join(report["policy"].as_str().unwrap())).unwrap()
    };
    let first = policy("3");
    assert!(first == policy("3"));
    assert!(first != policy("4"));
}

#[test]
fn what_cannot_be_trained_is_refused_before_a_folder_is_made() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    std::fs::write(folder.path().join("text.hdf5"), "not HDF5").unwrap();
    for (more, text) in [
        (&["--alpha", "-1"][..], "palr.alpha is -1; expected at least 0"),
        (&["--training-rows", "9000"], "9000 rows"),
        (&["--env", "walker2d-w2"], "holds data of hopper-v0"),
        (&["--env", "hoper-w2"], "did you mean \"hopper\"?"),
        (&["--data", "text.hdf5"], "not an HDF5 file"),
        (&["--data", "absent.hdf5"], "absent.hdf5"),
        (&["--batch", "1"], "batch is 1; expected at least 2"),
    ] {
        let mut arguments = TRAIN.to_vec();
        // The later of two equal flags would be refused: replace the earlier one.
        if let Some(at) = arguments.iter().position(|argument| *argument == more[0]) {
            arguments.drain(at..at + 2);
        }
        let output = palr_gym(folder.path(), &[&arguments[..], more].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && said.contains(text), "{more:?}: {said}");
        assert!(!folder.path().join("runs").exists(), "{more:?}");
    }
}
