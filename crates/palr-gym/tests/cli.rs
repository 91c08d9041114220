//! The program as people and scripts meet it.
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

/// Runs a command that must fail with `code` and returns what it says.
#[track_caller]
fn refusal(arguments: &[&str], code: i32) -> String {
    let folder = tempfile::tempdir().unwrap();
    let output = palr_gym(folder.path(), arguments);
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert!(output.stdout.is_empty(), "results go to stdout, errors do not");
    assert!(!text.contains("panicked"), "{text}");
    let left = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(left, 0, "a refused command left files behind");
    text
}

#[test]
fn version_tells_mujocos_too() {
    let output = palr_gym(Path::new("."), &["--version"]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(text, format!("palr-gym {} (MuJoCo 3.17.0)\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn every_command_teaches_its_use() {
    for command in [
        "serve",
        "envs",
        "collect",
        "evaluate",
        "render",
        "leakage",
        "train",
        "expert",
        "data",
        "runs",
        "plot",
        "bench",
        "demo",
        "completions",
    ] {
        let output = palr_gym(Path::new("."), &[command, "--help"]);
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success());
        assert!(text.contains(&format!("Usage: palr-gym {command}")), "{text}");
        let teaches = text.contains(&format!("palr-gym {command} ")) || text.contains("--resume");
        assert!(teaches, "{command} --help shows no example:\n{text}");
    }
    let output = palr_gym(Path::new("."), &["completions", "bash"]);
    assert!(String::from_utf8(output.stdout).unwrap().contains("evaluate"));
}

#[test]
fn wrong_command_lines_and_requests_exit_with_64_and_say_what_was_expected() {
    for (arguments, text) in [
        (&["serv"][..], "'serve'"),
        (&["serve", "--threads", "0"], "0 is not in 1..=65535"),
        (
            &["evaluate", "--env", "hopper", "--server", "nowhere"],
            "expected HOST:PORT or unix:PATH",
        ),
        (&["evaluate", "--env", "hoper"], "did you mean \"hopper\"?"),
        (&["evaluate", "--env", "hopper-w0"], "frame stack of 0; expected 1 to 64"),
        (&["evaluate", "--env", "hopper", "--episodes", "0"], "episodes is 0; expected 1 to"),
        (
            &["collect", "--env", "hopper", "--transitions", "0", "--out", "a.hdf5"],
            "transitions is 0",
        ),
        (&["bench", "step", "--env", "hoper"], "did you mean \"hopper\"?"),
        (&["bench", "step", "--env", "hopper", "--num-envs", "0"], "num_envs is 0; expected 1 to"),
        (&["bench", "latency", "--env", "hopper", "--seconds", "0"], "from 0.01 to 3600"),
        (&["bench", "step", "--env", "hopper", "--in-flight", "65"], "65 is not in 1..=64"),
        (&["envs", "hopper-v9"], "the only version is v0"),
    ] {
        let said = refusal(arguments, 64);
        assert!(said.contains(text), "{arguments:?}: {said}");
    }
}

#[test]
fn what_the_machine_refuses_exits_with_1() {
    let said = refusal(&["evaluate", "--env", "hopper", "--policy", "absent.onnx"], 1);
    assert!(said.contains("absent.onnx") && said.contains("expected `random`, `expert`"), "{said}");
    let said = refusal(&["evaluate", "--env", "hopper", "--server", "127.0.0.1:1"], 1);
    assert!(said.contains("127.0.0.1:1") && said.contains("palr-gym serve"), "{said}");
    let said = refusal(&["collect", "--env", "hopper", "--out", "absent/a.hdf5"], 1);
    assert!(said.contains("absent/a.hdf5"), "{said}");
    let said = refusal(&["demo", "--resume"], 1);
    assert!(said.contains("no run to resume"), "{said}");
}

#[test]
fn a_port_in_use_is_named_with_a_way_out() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let said = refusal(&["serve", "--listen", &address], 1);
    assert!(said.contains(&address) && said.contains("port 0"), "{said}");
}

#[test]
fn results_in_json_are_json_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [
        &["envs", "--json"][..],
        &["envs", "halfcheetah-strict-w3", "--json"],
        &["evaluate", "--env", "hopper", "--policy", "random", "--episodes", "1", "--json"],
        &["collect", "--env", "hopper", "--episodes", "1", "--out", "a.hdf5", "--json"],
    ] {
        let output = palr_gym(folder.path(), arguments);
        let text = String::from_utf8(output.stdout).unwrap();
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert!(value.is_object() || value.is_array(), "{arguments:?}");
    }
}

#[test]
fn leakage_is_estimated_on_what_was_collected() {
    let folder = tempfile::tempdir().unwrap();
    let collect = ["collect", "--env", "hopper", "--policy", "random", "--episodes", "25"];
    let out = ["--out", "a.hdf5"];
    assert!(palr_gym(folder.path(), &[&collect[..], &out].concat()).status.success());
    let leakage = |more: &[&str]| {
        let data = ["leakage", "--data", "a.hdf5", "--rows", "200", "--json"];
        palr_gym(folder.path(), &[&data[..], more].concat())
    };
    let output = leakage(&["--env", "hopper-w2", "--policy", "random"]);
    let value: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let (hscic, interval) = (value["hscic"].as_f64().unwrap(), &value["hscic_interval"]);
    assert!(interval[0].as_f64().unwrap() <= hscic && hscic <= interval[1].as_f64().unwrap());
    assert_eq!((&value["samples"], &value["is_by_episode"]), (&200.into(), &true.into()));
    for (more, text) in [
        (&["--env", "walker2d-w2", "--policy", "random"][..], "holds data of hopper-v0"),
        (&["--env", "hopper", "--policy", "random", "--slice", "900000"], "900000"),
        (&["--env", "hopper", "--policy", "random", "--ridge", "0"], "ridge is 0"),
        (&["--env", "hopper-w2", "--policy", "expert"], "expected float32 [N, 10]"),
    ] {
        let output = leakage(more);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && said.contains(text), "{more:?}: {said}");
    }
}

#[test]
fn a_recording_is_described_and_its_faults_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let collect = ["collect", "--env", "hopper", "--policy", "random", "--episodes", "25"];
    assert!(
        palr_gym(folder.path(), &[&collect[..], &["--out", "a.hdf5"]].concat()).status.success()
    );
    let output = palr_gym(folder.path(), &["data", "info", "a.hdf5", "--json"]);
    let info: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&info["episodes"], &info["terminated"]), (&25.into(), &25.into()));
    assert_eq!((&info["observation_size"], &info["action_size"]), (&11.into(), &3.into()));
    // Uniform actions are without memory, and a random policy scores next to nothing.
    assert!(info["normalized_score"]["mean"].as_f64().unwrap() < 5.0);
    assert!(info["actions"][0]["lag_1_correlation"].as_f64().unwrap().abs() < 0.2);
    assert!(palr_gym(folder.path(), &["data", "verify", "a.hdf5"]).status.success());
    let text = palr_gym(folder.path(), &["data", "info", "a.hdf5"]).stdout;
    assert!(String::from_utf8(text).unwrap().contains("25 ended by the task, 0 by the time limit"));

    let shape = palr_gym_data::D4rlShape {
        transitions: 30,
        observation_size: 11,
        picture: None,
        action_size: 3,
        nq: 6,
        nv: 6,
        has_action_log_probs: false,
    };
    // What is not written is zero.
    palr_gym_data::D4rlWriter::create(&folder.path().join("zero.hdf5"), shape, &[]).unwrap();
    let output = palr_gym(folder.path(), &["data", "verify", "zero.hdf5"]);
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("WRONG 3 entries of the action never vary"), "{text}");
    let output = palr_gym(folder.path(), &["data", "info", "a.hdf5", "--env", "hoper"]);
    assert_eq!(output.status.code(), Some(64));
}
