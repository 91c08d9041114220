//! From a recording to a policy that the server evaluates.
#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]

use std::path::Path;
use std::process::{Command, Output, Stdio};

use palr_gym_data::d4rl::{D4rlShape, D4rlWriter};

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
    "--set",
    "metric_rows=32",
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
fn a_run_folder_says_everything_about_its_run_and_is_a_policy() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    std::fs::write(folder.path().join("mine.toml"), "seed = 7\nsteps = 5\n[palr]\nalpha = 3.5\n")
        .unwrap();
    let more = ["--config", "mine.toml", "--set", "palr.weights=pool", "--evaluate-every", "20"];
    let report = succeed(folder.path(), &[TRAIN, &more[..], &["--episodes", "2"]].concat());
    let run = folder.path().join(report["run_folder"].as_str().unwrap());
    let read = |name: &str| std::fs::read_to_string(run.join(name)).unwrap();
    let manifest: serde_json::Value = serde_json::from_str(&read("run.json")).unwrap();
    assert_eq!(manifest["env_id"], "hopper-w2-v0");
    assert_eq!(manifest["data"]["transitions"], 2500);
    assert_eq!(manifest["data"]["sha256"].as_str().unwrap().len(), 64);
    // Flags lie over the file, --set over both.
    let settings = &manifest["settings"];
    for (pointer, want) in [
        ("/seed", serde_json::json!(7)),
        ("/steps", 30.into()),
        ("/palr/alpha", 3.5.into()),
        ("/palr/weights", "pool".into()),
        ("/evaluation/every", 20.into()),
    ] {
        assert_eq!(settings.pointer(pointer), Some(&want), "{pointer}");
    }
    let steps: Vec<u64> = read("evaluations.jsonl")
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()["step"].as_u64())
        .map(Option::unwrap)
        .collect();
    assert_eq!(steps, [20, 30]);
    assert_eq!(report["evaluation"]["step"], 30);
    assert!(!run.join("pending").exists());
    // The settings are a file for --config, and make the same policy.
    let settings = run.join("settings.toml");
    let again = ["train", "--config", settings.to_str().unwrap(), "--out", "again", "--json"];
    succeed(folder.path(), &again);
    let policy = |run: &Path| std::fs::read(run.join("policy.safetensors")).unwrap();
    assert!(policy(&run) == policy(&folder.path().join("again/001")));
    // The folder is a policy, unless it is of another version.
    let evaluate = ["evaluate", "--env", "hopper-w2", "--episodes", "2", "--json", "--policy"];
    let evaluate = [&evaluate[..], &[run.to_str().unwrap()]].concat();
    let evaluation = succeed(folder.path(), &evaluate);
    assert_eq!(evaluation["return_mean"], report["evaluation"]["return_mean"]);
    let other = read("run.json").replace("\"format_version\": 1", "\"format_version\": 2");
    std::fs::write(run.join("run.json"), other).unwrap();
    let said = String::from_utf8(palr_gym(folder.path(), &evaluate).stderr).unwrap();
    assert!(said.contains("has format version 2") && said.contains("reads version 1"), "{said}");
}

/// What the policies and the curves of a run are.
fn left(run: &Path) -> Vec<Vec<u8>> {
    ["policy.safetensors", "policy.onnx", "metrics.jsonl", "evaluations.jsonl"]
        .map(|name| std::fs::read(run.join(name)).unwrap())
        .into()
}

#[test]
fn a_run_killed_or_interrupted_at_any_moment_leaves_what_a_whole_one_leaves() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    let mut train = TRAIN.to_vec();
    train.truncate(train.iter().position(|argument| *argument == "--steps").unwrap());
    train.extend(["--steps", "60", "--log-every", "3", "--set", "checkpoint_every=5"]);
    train.extend(["--weights", "pool", "--set", "palr.pool_size=4", "--evaluate-every", "15"]);
    train.extend(["--episodes", "2", "--set", "metric_rows=32"]);
    succeed(folder.path(), &[&train[..], &["--json", "--out", "whole"]].concat());
    let want = left(&folder.path().join("whole/001"));
    for (signal, code) in [("-KILL", None), ("-INT", Some(130)), ("-TERM", Some(130))] {
        let out = format!("out{signal}");
        let run = folder.path().join(&out).join("001");
        let mut child = Command::new(env!("CARGO_BIN_EXE_palr-gym"))
            .args(&train)
            .args(["--out", &out])
            .current_dir(folder.path())
            .env_remove("PALR_GYM_SERVER")
            .stdin(Stdio::null())
            .stderr(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        // A few reports in, so that there is something to lose.
        let metrics = run.join("metrics.jsonl");
        let lines = || std::fs::read_to_string(&metrics).map_or(0, |text| text.lines().count());
        while lines() < 4 {
            assert!(child.try_wait().unwrap().is_none(), "{signal}: it was too quick");
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        let pid = child.id().to_string();
        assert!(Command::new("kill").args([signal, &pid]).status().unwrap().success());
        let status = child.wait().unwrap();
        assert!(!run.join("policy.onnx").exists(), "{signal}: it was too quick");
        assert_eq!(status.code(), code, "{signal}");
        let resume = ["train", "--json", "--resume", run.to_str().unwrap()];
        succeed(folder.path(), &resume);
        assert!(left(&run) == want, "{signal}");
        // What is complete is left as it is.
        succeed(folder.path(), &resume);
        assert!(left(&run) == want, "{signal}");
    }
}

#[test]
fn a_run_resumes_only_with_what_it_began_with() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    succeed(folder.path(), TRAIN);
    let longer = ["train", "--resume", "--steps", "40", "--json"];
    assert_eq!(succeed(folder.path(), &longer)["step"], 40);
    for (more, text) in [
        (&["--seed", "5"][..], "holds a run with other settings"),
        (&["--steps", "10"], "has 40 steps already; steps is 10"),
        (&["--out", "nowhere"], "holds no run to resume"),
    ] {
        let output = palr_gym(folder.path(), &[&["train", "--resume"], more].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && said.contains(text), "{more:?}: {said}");
    }
    // A refusal changes nothing.
    succeed(folder.path(), &["train", "--resume", "--json"]);
    let collect = ["collect", "--env", "hopper", "--policy", "random", "--transitions", "2600"];
    succeed(folder.path(), &[&collect[..], &["--out", "a.hdf5", "--force", "--json"]].concat());
    let said = String::from_utf8(palr_gym(folder.path(), &longer).stderr).unwrap();
    assert!(said.contains("the data file now has"), "{said}");
}

#[test]
fn print_config_prints_every_setting_and_does_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let print = ["train", "--env", "hopper-w2", "--data", "a.hdf5", "--print-config"];
    let output = palr_gym(folder.path(), &print);
    let text = String::from_utf8(output.stdout).unwrap();
    for line in ["env = \"hopper-w2\"", "algorithm = \"palr\"", "[palr]", "alpha = 10.0"] {
        assert!(text.lines().any(|other| other == line), "{line}: {text}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn without_data_the_expert_is_recorded_once() {
    let folder = tempfile::tempdir().unwrap();
    let train = ["train", "--env", "hopper-w2", "--algorithm", "bc", "--steps", "1", "--json"];
    let small = ["--batch", "16", "--evaluate-every", "0", "--set", "metric_rows=16"];
    let train = [&train[..], &small].concat();
    succeed(folder.path(), &train);
    let data = folder.path().join("runs/data/hopper-expert-sampled-55000.hdf5");
    let recorded = std::fs::metadata(&data).unwrap().modified().unwrap();
    succeed(folder.path(), &train);
    assert_eq!(std::fs::metadata(&data).unwrap().modified().unwrap(), recorded);
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

    // The three are listed, told apart, and drawn as one curve with a band.
    let runs = succeed(folder.path(), &["runs", "--json"]);
    let seeds = runs.as_array().unwrap().iter().map(|run| &run["manifest"]["settings"]["seed"]);
    assert_eq!(seeds.collect::<Vec<_>>(), [3, 3, 4]);
    assert_eq!(runs[2]["metrics"].as_array().unwrap().len(), 3);
    let table = String::from_utf8(palr_gym(folder.path(), &["runs"]).stdout).unwrap();
    for text in ["runs/train/003", "hopper-w2-v0", "palr", "complete"] {
        assert!(table.contains(text), "{text}: {table}");
    }
    assert!(palr_gym(folder.path(), &["plot", "runs/train"]).status.success());
    let svg = std::fs::read_to_string(folder.path().join("curves.svg")).unwrap();
    assert!(svg.contains("held-out log-likelihood") && svg.contains("hopper-w2-v0: 3 runs"));
    assert!(folder.path().join("curves.png").exists());
    let said = String::from_utf8(palr_gym(folder.path(), &["runs", "absent"]).stderr).unwrap();
    assert!(said.contains("absent: No such file"), "{said}");
}

#[test]
fn what_cannot_be_trained_is_refused_before_a_folder_is_made() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    std::fs::write(folder.path().join("text.hdf5"), "not HDF5").unwrap();
    std::fs::write(folder.path().join("wrong.toml"), "btach = 64").unwrap();
    // What is not written is zero.
    let shape = D4rlShape {
        transitions: 2500,
        observation_size: 11,
        picture: None,
        action_size: 3,
        nq: 6,
        nv: 6,
        has_action_log_probs: false,
    };
    D4rlWriter::create(&folder.path().join("constant.hdf5"), shape, &[]).unwrap();
    for (more, text) in [
        (&["--alpha", "-1"][..], "palr.alpha is -1; expected at least 0"),
        (&["--training-rows", "9000"], "9000 rows"),
        (&["--env", "walker2d-w2"], "holds data of hopper-v0"),
        (&["--env", "hoper-w2"], "did you mean \"hopper\"?"),
        (&["--data", "text.hdf5"], "not an HDF5 file"),
        (&["--data", "absent.hdf5"], "absent.hdf5"),
        (&["--batch", "1"], "batch is 1; expected at least 2"),
        (&["--set", "palr.alhpa=1"], "did you mean `palr.alpha`?"),
        (&["--set", "steps"], "expected KEY=VALUE"),
        (&["--config", "absent.toml"], "absent.toml: No such file"),
        (&["--config", "wrong.toml"], "wrong.toml: there is no setting `btach`"),
        (&["--algorithm", "dagger"], "there is no algorithm \"dagger\""),
        (&["--algorithm", "plar"], "did you mean \"palr\"?"),
        (&["--data", "constant.hdf5"], "column 0 of actions is 0 in all 1500 rows"),
    ] {
        let mut arguments = TRAIN.to_vec();
        // The later of two equal flags would be refused: replace the earlier one.
        if let Some(at) = arguments.iter().position(|argument| *argument == more[0]) {
            arguments.drain(at..at + 2);
        }
        let output = palr_gym(folder.path(), &[&arguments[..], more].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && said.contains(text), "{more:?}: {said}");
        let is_setting =
            ["--alpha", "--batch", "--set", "--config", "--algorithm"].contains(&more[0]);
        if is_setting && !text.contains("absent") {
            assert_eq!(output.status.code(), Some(64), "{more:?}");
        }
        assert!(!folder.path().join("runs").exists(), "{more:?}");
    }
}

#[test]
fn a_grid_makes_a_run_of_each_combination_with_the_bits_that_it_would_have_alone() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    let grid = ["--seeds", "3..4", "--frame-stack", "1,2", "--alpha", "0.5,20"];
    let grid = [TRAIN, &grid, &["--evaluate-every", "20", "--episodes", "2"]].concat();
    let reports = succeed(folder.path(), &grid);
    let setting = |run: &Path, pointer: &str| {
        let manifest = std::fs::read(run.join("run.json")).unwrap();
        let manifest: serde_json::Value = serde_json::from_slice(&manifest).unwrap();
        manifest["settings"].pointer(pointer).unwrap().to_string()
    };
    let folders: Vec<_> =
        (1..=8).map(|i| folder.path().join(format!("runs/train/{i:03}"))).collect();
    let combinations: Vec<_> = folders
        .iter()
        .map(|run| ["/env", "/palr/alpha", "/seed", "/batch_seed"].map(|key| setting(run, key)))
        .collect();
    let mut want = Vec::new();
    for env in ["\"hopper-w1\"", "\"hopper-w2\""] {
        for alpha in ["0.5", "20.0"] {
            want.extend(["3", "4"].map(|seed| [env, alpha, seed, "3"].map(str::to_owned)));
        }
    }
    assert_eq!(combinations, want);
    assert_eq!(reports.as_array().unwrap().len(), 8);
    assert!(reports.as_array().unwrap().iter().all(|run| run["evaluation"]["step"] == 30));
    // The last combination by itself.
    let settings = folders[7].join("settings.toml");
    let alone = ["train", "--config", settings.to_str().unwrap(), "--out", "alone", "--json"];
    succeed(folder.path(), &alone);
    assert!(left(&folders[7]) == left(&folder.path().join("alone/001")));
    assert!(left(&folders[7])[0] != left(&folders[6])[0]);
    // They go on together.
    let mut longer = vec!["train", "--steps", "33", "--json", "--resume"];
    longer.extend(folders[6..].iter().map(|run| run.to_str().unwrap()));
    assert_eq!(succeed(folder.path(), &longer)[1]["step"], 33);
    let wrong = [TRAIN, &["--resume", "runs/train/001", "--alpha", "1,2"]].concat();
    let said = String::from_utf8(palr_gym(folder.path(), &wrong).stderr).unwrap();
    assert!(said.contains("a run that goes on keeps its α"), "{said}");
}

#[test]
fn more_runs_than_a_server_evaluates_at_once_take_turns() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    let many = ["--seeds", "0..11", "--evaluate-every", "30", "--episodes", "2"];
    let reports = succeed(folder.path(), &[TRAIN, &many].concat());
    let reports = reports.as_array().unwrap();
    assert_eq!(reports.len(), 12);
    assert!(reports.iter().all(|run| run["evaluation"]["step"] == 30), "{reports:?}");
}

#[test]
fn alpha_auto_names_a_value_by_held_out_rows_alone() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    let auto = [TRAIN, &["--alpha", "auto:0,1000", "--evaluate-every", "0"]].concat();
    let report = succeed(folder.path(), &auto);
    let [choice] = &report["choices"].as_array().unwrap()[..] else { panic!("{report}") };
    let nll = |at: usize| choice["candidates"][at]["change_nll"].as_f64().unwrap();
    let best = if nll(0) < nll(1) { 0.0 } else { 1000.0 };
    assert_eq!(choice["alpha"].as_f64(), Some(best));
    let left = std::fs::read(folder.path().join("runs/train/alpha.json")).unwrap();
    let left: serde_json::Value = serde_json::from_slice(&left).unwrap();
    assert_eq!(&left, &report["choices"]);
    let blind: Vec<&str> = auto.iter().map(|arg| if *arg == "200" { "0" } else { arg }).collect();
    let said = String::from_utf8(palr_gym(folder.path(), &blind).stderr).unwrap();
    assert!(said.contains("held_out.rows is 0; --alpha auto chooses by held-out rows"), "{said}");
}

#[test]
fn a_run_that_goes_on_with_other_reports_leaves_no_old_ones_between_them() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    let every = ["--set", "checkpoint_every=12", "--evaluate-every", "0"];
    let train: Vec<&str> = TRAIN.iter().map(|arg| if *arg == "10" { "5" } else { arg }).collect();
    succeed(folder.path(), &[&train[..], &every].concat());
    let run = folder.path().join("runs/train/001");
    let steps = || -> Vec<u64> {
        let text = std::fs::read_to_string(run.join("metrics.jsonl")).unwrap();
        let step = |line| serde_json::from_str::<serde_json::Value>(line).unwrap()["step"].as_u64();
        text.lines().map(|line| step(line).unwrap()).collect()
    };
    assert_eq!(steps(), [5, 10, 15, 20, 25, 30]);
    // As if it had been killed after step 30, before the checkpoint there.
    let killed = ["train", "--steps", "24", "--json", "--config"];
    let settings = run.join("settings.toml");
    let killed = [&killed[..], &[settings.to_str().unwrap(), "--out", "killed"]].concat();
    succeed(folder.path(), &killed);
    let checkpoint = folder.path().join("killed/001/checkpoint.safetensors");
    std::fs::copy(checkpoint, run.join("checkpoint.safetensors")).unwrap();
    succeed(folder.path(), &["train", "--resume", "--log-every", "9", "--json"]);
    assert_eq!(steps(), [5, 10, 15, 20, 27, 30]);
}
