//! The demo, small.
#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]

use std::path::Path;
use std::process::{Command, Stdio};

fn demo(folder: &Path, arguments: &[&str]) -> serde_json::Value {
    let output = Command::new(env!("CARGO_BIN_EXE_palr-gym"))
        .args(["demo", "--json"])
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn a_demo_measures_four_policies_and_resumes_to_the_same_results() {
    let folder = tempfile::tempdir().unwrap();
    let small = ["--transitions", "23000", "--training-rows", "1000", "--held-out-rows", "200"];
    let results = demo(folder.path(), &[&small[..], &["--steps", "2", "--episodes", "2"]].concat());
    let run = folder.path().join("runs/demo/001");
    let players = results["players"].as_array().unwrap();
    let names: Vec<&str> = players.iter().map(|player| player["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["expert", "bc", "palr", "random"]);
    for player in players {
        assert!(player["evaluation"]["score_mean"].is_f64());
        assert!(player["leakage"]["hscic"].as_f64().unwrap() > 0.0);
        assert_eq!(player["leakage"]["samples"], 200);
        assert!(player["leakage"]["episodes"].as_u64().unwrap() >= 20);
        let is_trained = run.join(player["name"].as_str().unwrap()).join("policy.onnx").exists();
        assert_eq!(player["training"].is_object(), is_trained);
    }
    // The expert knows what it does; two steps teach nothing.
    let score = |i: usize| players[i]["evaluation"]["score_mean"].as_f64().unwrap();
    assert!(score(0) > 90.0 && score(1) < 20.0 && score(2) < 20.0 && score(3) < 20.0);
    let svg = std::fs::read_to_string(run.join("figure.svg")).unwrap();
    for text in ["bc", "palr", "expert", "random", "HSCIC", "held-out log-likelihood"] {
        assert!(svg.contains(text), "{text}");
    }
    let read = |name: &str| std::fs::read(run.join(name)).unwrap();
    let before = read("results.json");
    // As if it had been killed while it trained PALR.
    for name in ["results.json", "player-palr.json", "palr/policy.onnx", "palr/metrics.jsonl"] {
        std::fs::remove_file(run.join(name)).unwrap();
    }
    std::fs::remove_file(run.join("palr/checkpoint.safetensors")).unwrap();
    demo(folder.path(), &["--resume"]);
    let without_times = |bytes: &[u8]| {
        let text = String::from_utf8(bytes.to_vec()).unwrap();
        let kept = |line: &&str| {
            !["wall_time_s", "resumed", "was_complete"].iter().any(|name| line.contains(name))
        };
        text.lines().filter(kept).map(str::to_owned).collect::<Vec<_>>()
    };
    assert!(without_times(&read("results.json")) == without_times(&before));
}
