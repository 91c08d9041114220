//! What a command does when its server goes away or falls silent.
#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

struct Server {
    process: Child,
    address: String,
}

impl Server {
    fn start() -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_palr-gym"))
            .args(["serve", "--listen", "127.0.0.1:0", "--json"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let ready: serde_json::Value = serde_json::from_str(&line).unwrap();
        Self { process, address: ready["address"].as_str().unwrap().to_owned() }
    }

    fn signal(&self, signal: &str) {
        let id = self.process.id().to_string();
        assert!(Command::new("kill").args([signal, &id]).status().unwrap().success());
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn collect(folder: &Path, server: &str, more: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_palr-gym"))
        .args(["collect", "--env", "hopper", "--policy", "random", "--transitions", "200000"])
        .args(["--out", "a.hdf5", "--server", server])
        .args(more)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Waits until some episodes are recorded.
fn wait_for_episodes(folder: &Path) {
    let part = folder.join("a.hdf5.part");
    let started = Instant::now();
    while std::fs::metadata(&part).map_or(0, |meta| meta.len()) < 100_000 {
        assert!(started.elapsed() < Duration::from_secs(30), "nothing was recorded");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_killed_server_ends_a_recording_that_then_resumes() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start();
    let recording = collect(folder.path(), &server.address, &[]);
    wait_for_episodes(folder.path());
    server.signal("-KILL");
    let output = recording.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(
        text(&output).contains("are safe in a.hdf5.part, and --resume goes on"),
        "{}",
        text(&output)
    );
    assert!(!folder.path().join("a.hdf5").exists());

    let second = Server::start();
    let output = collect(folder.path(), &second.address, &["--resume", "--json"])
        .wait_with_output()
        .unwrap();
    assert!(output.status.success(), "{}", text(&output));
    let collected: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(collected["transitions"], 200_000);
    assert!(collected["resumed_episodes"].as_u64().unwrap() > 0);
    assert!(!folder.path().join("a.hdf5.part").exists());
}

/// A limit on the size of files stands for a full disk: writing fails in the same place.
#[test]
fn a_full_disk_keeps_what_was_recorded_and_the_recording_resumes() {
    let folder = tempfile::tempdir().unwrap();
    let collect = "collect --env hopper --policy random --transitions 5000 --out a.hdf5";
    let command = |setup: &str, more: &str| {
        let binary = env!("CARGO_BIN_EXE_palr-gym");
        Command::new("sh")
            .args(["-c", &format!("{setup} exec '{binary}' {collect} {more}")])
            .current_dir(folder.path())
            .env_remove("PALR_GYM_SERVER")
            .stdin(Stdio::null())
            .output()
            .unwrap()
    };
    // 512 blocks of 512 bytes; the signal that would end the process is ignored.
    let output = command("trap '' XFSZ; ulimit -f 512;", "");
    assert_eq!(output.status.code(), Some(1));
    let said = text(&output);
    assert!(said.contains("a.hdf5.part: cannot write") && said.contains("are safe"), "{said}");
    assert!(!folder.path().join("a.hdf5").exists());
    let output = command("", "--resume --json");
    assert!(output.status.success(), "{}", text(&output));
    let collected: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(collected["transitions"], 5000);
    assert!(collected["resumed_episodes"].as_u64().unwrap() > 0);
}

#[test]
fn a_server_that_falls_silent_is_given_up_at_the_deadline() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start();
    let recording = collect(folder.path(), &server.address, &["--deadline", "1"]);
    wait_for_episodes(folder.path());
    server.signal("-STOP");
    let stopped = Instant::now();
    let output = recording.wait_with_output().unwrap();
    assert!(stopped.elapsed() < Duration::from_secs(10), "{:?}", stopped.elapsed());
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output).contains("the server said nothing for 1s"), "{}", text(&output));
}

#[test]
fn a_signal_drains_the_server_and_it_exits_with_0() {
    for signal in ["-INT", "-TERM"] {
        let mut server = Server::start();
        server.signal(signal);
        let status = server.process.wait().unwrap();
        assert_eq!(status.code(), Some(0), "{signal}");
    }
}
