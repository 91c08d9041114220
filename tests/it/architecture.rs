//! The house plan of ARCHITECTURE.md, as far as a program can check it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand};

/// Crate → crates of ours that it may depend on.
const ARROWS: &[(&str, &[&str])] = &[
    ("palr-gym-proto", &[]),
    ("palr-gym-core", &[]),
    ("palr-gym-onnx", &[]),
    ("palr-gym-vision", &["palr-gym-onnx"]),
    ("palr-gym-data", &["palr-gym-core"]),
    ("palr-gym-leakage", &["palr-gym-core"]),
    ("palr-gym-sim", &["palr-gym-core"]),
    (
        "palr-gym-server",
        &[
            "palr-gym-core",
            "palr-gym-data",
            "palr-gym-leakage",
            "palr-gym-onnx",
            "palr-gym-proto",
            "palr-gym-sim",
            "palr-gym-vision",
        ],
    ),
    ("palr-gym-trainer", &["palr-gym-core", "palr-gym-data", "palr-gym-proto"]),
    (
        "palr-gym",
        &[
            "palr-gym-core",
            "palr-gym-data",
            "palr-gym-leakage",
            "palr-gym-proto",
            "palr-gym-server",
            "palr-gym-sim",
            "palr-gym-trainer",
            "palr-gym-vision",
        ],
    ),
];

/// Longest source file without a stated reason.
const MAX_LINES: usize = 500;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

fn metadata() -> Metadata {
    MetadataCommand::new().manifest_path(root().join("Cargo.toml")).no_deps().exec().unwrap()
}

/// Every file of ours in these folders that ends in one of these ways, but what programs write.
fn files(folders: &[&str], endings: &[&str]) -> Vec<PathBuf> {
    const WRITTEN_BY_PROGRAMS: [&str; 4] = ["_proto", "generated", "node_modules", "dist"];
    fn walk(folder: &Path, endings: &[&str], found: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let is_ours = WRITTEN_BY_PROGRAMS.iter().all(|name| !path.ends_with(name));
            if path.is_dir() && is_ours {
                walk(&path, endings, found);
            } else if path.extension().is_some_and(|ending| endings.iter().any(|of| ending == *of))
            {
                found.push(path);
            }
        }
    }
    let mut found = Vec::new();
    for folder in folders {
        walk(&root().join(folder), endings, &mut found);
    }
    assert!(found.len() > 40, "the walk found only {} files", found.len());
    found
}

/// Every Rust file of ours.
fn sources() -> Vec<PathBuf> {
    files(&["bench", "crates", "fuzz", "proto", "server", "tests", "trainer"], &["rs"])
}

#[test]
fn crates_depend_only_along_the_arrows_of_the_plan() {
    let allowed: BTreeMap<&str, BTreeSet<&str>> =
        ARROWS.iter().map(|(from, to)| (*from, to.iter().copied().collect())).collect();
    for package in metadata().workspace_packages() {
        let name = package.name.as_str();
        if ["palr-gym-tests", "palr-gym-bench", "palr-gym-fuzz"].contains(&name) {
            continue;
        }
        let allowed = allowed.get(name).unwrap_or_else(|| panic!("{name} is not in the plan"));
        for dependency in &package.dependencies {
            if dependency.path.is_some() && dependency.kind == DependencyKind::Normal {
                assert!(
                    allowed.contains(dependency.name.as_str()),
                    "{name} -> {}",
                    dependency.name
                );
            }
        }
    }
}

#[test]
fn the_trainer_reaches_environments_only_through_grpc() {
    let output = std::process::Command::new(env!("CARGO"))
        .args(["tree", "--offline", "-p", "palr-gym-trainer", "-e", "normal,build"])
        .args(["--prefix", "none", "--format", "{p}"])
        .current_dir(root())
        .output()
        .unwrap();
    let tree = String::from_utf8(output.stdout).unwrap();
    let reached: BTreeSet<&str> =
        tree.lines().filter_map(|line| line.split_whitespace().next()).collect();
    assert!(reached.contains("tonic"), "{}", String::from_utf8_lossy(&output.stderr));
    for forbidden in ["mujoco-rs", "palr-gym-sim", "palr-gym-server", "ort"] {
        assert!(!reached.contains(forbidden), "the trainer reaches {forbidden}");
    }
}

#[test]
fn grpc_statuses_are_spoken_only_in_the_service_files() {
    let server = root().join("server/src");
    for path in sources().iter().filter(|path| path.starts_with(&server)) {
        let relative = path.strip_prefix(&server).unwrap();
        let may_speak = relative.starts_with("services") || relative == Path::new("status.rs");
        let text = std::fs::read_to_string(path).unwrap();
        let speaks = text.lines().any(|line| {
            !line.trim_start().starts_with("//") && line.contains("tonic::Status")
                || line.starts_with("use tonic::") && line.contains("Status")
        });
        assert!(may_speak || !speaks, "{}", relative.display());
    }
}

#[test]
fn unsafe_code_stays_in_the_ffi_modules_with_a_reason_at_each_block() {
    const FFI: &[&str] = &[
        "bench/src/bare.rs",
        "crates/palr-gym-sim/src/guard.rs",
        "crates/palr-gym-sim/src/render/canvas.rs",
        "crates/palr-gym-sim/src/render/gl.rs",
        "crates/palr-gym-sim/src/render/gl/egl.rs",
        "crates/palr-gym-sim/src/render/gl/osmesa.rs",
    ];
    let keyword = concat!("un", "safe {");
    for path in sources() {
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        for (i, line) in lines.iter().enumerate().filter(|(_, line)| line.contains(keyword)) {
            let relative = path.strip_prefix(root()).unwrap();
            assert!(FFI.contains(&relative.to_str().unwrap()), "{}: {line}", relative.display());
            assert!(lines[i.saturating_sub(3)..i].iter().any(|line| line.contains("// SAFETY:")));
        }
    }
}

#[test]
fn source_files_are_small_enough_to_hold_in_the_head() {
    let others = ["bench", "client-py", "examples", "proto", "scripts", "tests"];
    for path in sources().into_iter().chain(files(&others, &["proto", "py", "ts"])) {
        let count = std::fs::read_to_string(&path).unwrap().lines().count();
        assert!(count <= MAX_LINES, "{} has {count} lines", path.display());
    }
}
